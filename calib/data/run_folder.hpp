#pragma once
#include <string>
#include <vector>

namespace taut {

/// A folder that holds one finished run, and in which the next one is made without touching it:
///
///   folder/...               the run that is finished: whatever it consists of, and the list of that in .files
///   folder/.next/...         files of the run that is being made
///   folder/.next/.publish    all are there, and they are about to take the old ones' places
///   folder/.resume/...       what an interrupted run had evaluated
///   folder/.lock             held by the process that writes
///
/// publish() writes the list of what is to come and to go, which is the moment at which the new run takes the old one's
/// place; whoever opens the folder next, after a kill in between, moves what was not moved yet. Files that no run wrote
/// stay.
class RunFolder {
 public:
  /// What stands in a folder; one kind does not take the other's place.
  enum class Kind { fit, simulation };
  /// Makes the folder and takes its lock. Throws InputError when it cannot be made or written, when another process is
  /// at work there, when it holds a run of the other kind, or no run but an experiment.toml or data.csv of
  /// someone's own.
  explicit RunFolder(std::string path, Kind kind = Kind::fit);
  ~RunFolder();
  RunFolder(const RunFolder&) = delete;
  RunFolder& operator=(const RunFolder&) = delete;

  const std::string& path() const { return path_; }  ///< as it was given
  std::string next() const;                          ///< where the new run's files are written; empty at first
  std::string resume() const;                        ///< for what an interrupted run leaves behind
  bool finished() const;                             ///< a run stands in the folder, and it is whole

  /// Puts what stands in next() in the place of the run before, or of those of its files that have the same names.
  /// Throws InputError when the list cannot be written: the old run stays then.
  enum class Publish { whole, part };
  void publish(Publish what = Publish::whole);  ///< see Publish
  /// Says of the run in next() that parts of it are missing.
  void mark_unfinished() const;
  void forget_resume();  ///< nothing is left to go on with

 private:
  std::string path_;
  int lock_ = -1;
  bool made_ = false;  ///< the folder was not there before
};

/// Before a finished run is read: finishes what a killed publish() left. Throws InputError, with a remedy, when nothing
/// finished stands there.
void settle_run_folder(const std::string& path);

}  // namespace taut

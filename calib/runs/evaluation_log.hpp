#pragma once
#include <atomic>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/fit/protocol.hpp"

namespace taut {

/// The predictions that a run has made so far, on disk. A run that was interrupted, killed even, goes through the same
/// calls again and is answered from here until it comes to what it had not done: the result is that of a run without
/// the interruption, to the bit. A section is one protocol's sequence of calls ("fit", "variant linear").
///
/// The file is written record by record, each with a checksum; a torn last one is cut off. Protocols whose predictions
/// start from what they found before have their state beside it.
class EvaluationLog {
 public:
  /// Opens or makes `folder`. What was logged under another fingerprint (other inputs, another program) is discarded.
  /// Throws InputError when the folder cannot be used.
  EvaluationLog(std::string folder, const std::string& fingerprint);
  ~EvaluationLog();
  EvaluationLog(const EvaluationLog&) = delete;
  EvaluationLog& operator=(const EvaluationLog&) = delete;

  /// One call of a protocol and its answer.
  struct Entry {
    Params p;
    std::vector<int> free;
    Prediction prediction;
    int factorisations = 0;  ///< that it took
    bool fresh = false;      ///< nothing that was predicted before had a part in it
  };
  /// A call of a section, as an earlier run made it; null: it did not come so far.
  const Entry* find(const std::string& section, size_t call) const;
  bool discarded() const { return discarded_; }  ///< something was there under another fingerprint
  size_t known() const { return known_; }        ///< calls of all sections that an earlier run left

  /// Adds a call. What a full disk does not take is made again the next time; the run goes on.
  void add(const std::string& section, size_t call, const Entry& entry);
  /// Keeps what the prediction after the first `calls` calls starts from.
  void keep_state(const std::string& section, size_t calls, const std::string& state);
  /// The last state that was kept, with its number of calls.
  std::optional<std::pair<size_t, std::string>> state(const std::string& section) const;

 private:
  void read(const std::string& fingerprint);
  std::string state_file(const std::string& section) const;

  std::string folder_;
  int file_ = -1;
  std::map<std::string, std::vector<Entry>> entries_;
  size_t known_ = 0, added_ = 0;
  bool discarded_ = false;
};

/// A protocol whose calls are answered from a log as far as it goes, and added to it from there on. Calls that end
/// because `stop` was raised are not added.
class LoggedProtocol final : public Protocol {
 public:
  /// All references have to outlive it.
  LoggedProtocol(Protocol& protocol, EvaluationLog& log, std::string section, const std::atomic<bool>* stop);

  const ParameterTable& parameters() const override { return protocol_.parameters(); }
  const Params& nominal() const override { return protocol_.nominal(); }
  int row_count() const override { return protocol_.row_count(); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override;
  /// The next prediction starts afresh.
  std::vector<Alternative> alternatives(const Params& p) override;
  void follow(const Params& at, const std::vector<int>& rows) override;
  void begin_search() override { protocol_.begin_search(); }
  void end_search() override { protocol_.end_search(); }
  int factorisations() const override { return answered_ + protocol_.factorisations(); }

 private:
  Prediction answer(const Params& p, const std::vector<int>& free, bool fresh, const std::function<Prediction()>& ask);
  void keep_state(double seconds);

  Protocol& protocol_;
  EvaluationLog& log_;
  std::string section_;
  const std::atomic<bool>* stop_;
  std::optional<std::pair<size_t, std::string>> kept_;  ///< what an earlier run left
  size_t calls_ = 0;
  size_t known_ = 0;                            ///< calls that the log answers
  bool live_ = false;                           ///< the protocol itself has been asked
  bool fresh_ = true;                           ///< nothing was predicted since the beginning or the last forget()
  int answered_ = 0;                            ///< factorisations of the answered calls
  double since_state_ = 0, state_seconds_ = 0;  ///< [s] of predictions since the last state; that one took
};

}  // namespace taut

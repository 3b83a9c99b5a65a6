#pragma once
#include <string>

#include "experiments/cli/commands.hpp"

namespace taut {

/// Progress on stderr: one animated line on a terminal, plain lines otherwise, nothing when quiet.
class Progress {
 public:
  explicit Progress(bool quiet);
  ~Progress();
  void say(const std::string& line);   ///< a step that stays
  void show(const std::string& line);  ///< a state that is replaced by the next; skipped when not on a terminal
 private:
  void clear();
  bool quiet_, terminal_, shown_ = false;
};

/// Name of the folder of an experiment.toml, or of another file without its extension.
std::string experiment_name(const std::string& path);
/// runs/<name of the experiment>, or what --out says.
std::string run_folder(const CommandOptions& options);
/// Whether Ctrl-C or the like was seen.
bool interrupted(const CommandOptions& options);

}  // namespace taut

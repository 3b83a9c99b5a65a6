#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/benches/experiment.hpp"

namespace taut {

/// Reads and checks an experiment file of any kind of bench. Paths in it are relative to it. Throws InputError with
/// file, line, what is wrong, what is allowed and the nearest known name.
Experiment read_experiment(const std::string& path);
/// The same of a text that need not be a file; `path` is what messages call it, and what paths in it are beside.
Experiment read_experiment_text(const std::string& path, std::string_view text);

/// A file that an experiment is read from, and the name of its copy in a run folder.
struct RunInput {
  std::string path, copy;
  std::optional<std::string> text = {};  ///< what it holds, where it is no file
};
/// The experiment's own file first, then readings and mesh.
std::vector<RunInput> inputs_of(const Experiment& experiment);
/// The experiment with its inputs taken from the copies in `folder`.
Experiment read_copies(const std::string& folder);

}  // namespace taut

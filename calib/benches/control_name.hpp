#pragma once
#include <string>
#include <string_view>

#include "calib/benches/experiment.hpp"

namespace taut {

/// The id of the control that the text of a key means: an id ("mass"), the column that sets it ("mass_g"), or
/// "retraction" where one column shortens cables, whatever that is called ("winch_mm"). Throws InputError with what is
/// allowed.
std::string control_named(TableReader& table, std::string_view key, const Experiment& experiment);

}  // namespace taut

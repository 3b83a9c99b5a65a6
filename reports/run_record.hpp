#pragma once
#include <string>

#include "calib/data/files.hpp"
#include "calib/runs/run_record.hpp"

namespace taut {

/// fit.json, schema in README: `schema`, `parameters` (a list of id, value, unit, standard_error, interval95 as [lower,
/// upper] with null for an open end, verdict, ...), `shares` (what mesh and contact gap add to each parameter:
/// `source`, `bias` and its `error` in the order of `parameters`), `fit`, `readings`, `curves`, `variants`,
/// `provenance`. SI units; NaN is null.
std::string to_json(const RunRecord& record);
/// The reverse. Throws InputError naming path and key when the file is not a fit.json of this schema.
RunRecord read_run(const std::string& folder);

}  // namespace taut

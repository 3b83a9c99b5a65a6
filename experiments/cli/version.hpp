#pragma once
#include <string>
#include <utility>
#include <vector>

namespace taut {

std::string version();
/// Commit that this binary was built from, "unknown" outside a repository.
std::string commit();
/// Libraries it was built with: name, version.
std::vector<std::pair<std::string, std::string>> library_versions();
/// Processor, cores and system, for provenance.
std::string machine_description();
/// Now in UTC, ISO 8601.
std::string utc_now();

}  // namespace taut

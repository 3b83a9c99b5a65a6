#pragma once
#include <string>

namespace taut {

std::string version();
/// Commit that this binary was built from, "unknown" outside a repository.
std::string commit();

}  // namespace taut

#include "experiments/cli/version.hpp"

namespace taut {

std::string version() {
  return TAUT_VERSION;
}
std::string commit() {
  return TAUT_COMMIT;
}

}  // namespace taut

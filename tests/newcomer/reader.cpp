// Opens an experiment file with the installed library and says how large it is.
#include <cstdio>

#include "calib/runs/open_bench.hpp"
#include "sim/core/error.hpp"

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  try {
    std::printf("%s\n", taut::open_bench(argv[1])->size_text().c_str());
  } catch (const taut::InputError& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
  return 0;
}

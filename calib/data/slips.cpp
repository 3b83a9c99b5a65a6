#include "calib/data/slips.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>

namespace taut {

std::string slip_of(double ratio, double tolerance) {
  struct Slip {
    double factor;
    const char* words;
  };
  constexpr std::array<Slip, 5> slips{{{10, "a slipped decimal point or a wrong unit?"},
                                       {100, "a slipped decimal point or a wrong unit?"},
                                       {1000, "a wrong unit?"},
                                       {25.4, "inches?"},
                                       {9.81, "a mass for a force?"}}};
  if (std::abs(ratio + 1) < tolerance) return "the same with the other sign";
  for (const bool inverse : {false, true}) {
    const double r = inverse ? 1 / ratio : ratio;
    const Slip* nearest = nullptr;
    for (const Slip& slip : slips) {
      const auto off = [&](const Slip& s) { return std::abs(r / s.factor - 1); };
      if (off(slip) < tolerance && (nearest == nullptr || off(slip) < off(*nearest))) nearest = &slip;
    }
    if (nearest != nullptr)
      return fmt::format("{} {}: {}", inverse ? "smaller by" : "larger by", nearest->factor, nearest->words);
  }
  return "";
}

}  // namespace taut

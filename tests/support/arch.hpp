#pragma once
#include <fmt/format.h>

#include <string>
#include <vector>

#include "tests/support/static_bench.hpp"

// A shallow arch that snaps through: over a range of loads it has two equilibria.
namespace taut::test {

/// 100 x 2 mm, rising by 6 mm, as a mesh file with the groups strip, left and right.
inline std::string arch_msh() {
  constexpr int n = 24;
  std::string nodes, elements;
  int count = 0;
  for (int i = 0; i <= n; ++i) {
    const double s = 2.0 * i / n - 1;
    for (int j = 0; j < 2; ++j)
      nodes += fmt::format("{} {} {} 0\n", 2 * i + j + 1, 100.0 * i / n, 2.0 * j + 6 * (1 - s * s));
  }
  for (int i = 0; i < n; ++i) {
    const int a = 2 * i + 1;
    elements += fmt::format("{} 2 2 1 1 {} {} {}\n", ++count, a, a + 2, a + 3);
    elements += fmt::format("{} 2 2 1 1 {} {} {}\n", ++count, a, a + 3, a + 1);
  }
  elements += fmt::format("{} 1 2 2 2 1 2\n{} 1 2 3 3 {} {}\n", count + 1, count + 2, 2 * n + 1, 2 * n + 2);
  return fmt::format(
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 1 \"strip\"\n1 2 \"left\"\n1 3 \"right\"\n"
      "$EndPhysicalNames\n$Nodes\n{}\n{}$EndNodes\n$Elements\n{}\n{}$EndElements\n",
      2 * (n + 1), nodes, count + 2, elements);
}

inline const std::string arch_toml = R"(title = "An arch"
data = "simulated"
[geometry]
kind = "msh"
file = "arch.msh"
unit = "mm"
dimension = 2
thickness = "30 mm"
plane = "strain"
[materials.strip]
E = "1 MPa"
nu = 0.2
[[support]]
on = "left"
fix = ["x", "y"]
[[support]]
on = "right"
fix = ["x", "y"]
[[load]]
id = "push"
point = ["50 mm", "8 mm"]
direction = [0, -1]
column = "push_mN"
[[channel]]
id = "drop"
point = ["50 mm", "8 mm"]
direction = [0, -1]
column = "drop_mm"
noise = { absolute = "0.02 mm" }
[bench]
file = "bench.csv"
[fit]
mesh_share = false
[fit.free.E_strip]
lower = "100 kPa"
upper = "10 MPa"
)";

/// Readings of the arch's drop [mm] under loads [mN].
inline std::string arch_csv(const std::vector<std::pair<double, double>>& readings) {
  std::string csv = "push_mN,drop_mm\n";
  for (const auto& [push, drop] : readings) csv += fmt::format("{},{}\n", push, drop);
  return csv;
}

/// The arch under these loads [mN]; its readings are all zero.
inline StaticReplay arch_bench(const TemporaryFolder& folder, const std::vector<double>& loads) {
  folder.write("arch.msh", arch_msh());
  std::vector<std::pair<double, double>> readings;
  for (double load : loads) readings.emplace_back(load, 0);
  return bench_of(experiment_in(folder, arch_toml, arch_csv(readings)));
}

}  // namespace taut::test

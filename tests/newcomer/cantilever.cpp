// A foam cantilever, 100 x 20 x 30 mm, calibrated with the installed library: three loads on its tip, the drops that
// were read, and the Young's modulus that explains them. The readings are made up: Timoshenko's F (L^3/3EI + L/kGA) at
// 100 kPa.
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "calib/benches/static_protocol.hpp"
#include "calib/fit/fit.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"

int main() {
  using namespace taut;
  const std::vector<double> load{0.01, 0.02, 0.03}, drop{0.00172, 0.00344, 0.00515};  // [N], [m]

  SceneBuilder builder(rectangle(graded(0.1, 20), graded(0.02, 4), 2, "foam"), Plane::stress, 0.03);
  builder.add_solid("foam", "neo_hookean", {{"E", 50e3}, {"nu", 0.3}});
  builder.fix("xmin", {0, 1});
  ParameterSpec pull{"pull", "F", "N"};
  pull.meaning = "load on the tip";
  const int control = builder.declare(std::move(pull), 0);
  const Eigen::Vector2d down(0, -1);
  builder.add_force("xmax", down, control);

  std::vector<NamedChannel> channels(1);
  channels[0] = {"drop", make_linear_channel(mean_weights(builder.mesh(), builder.mesh().select("xmax"), down))};
  std::vector<StaticRow> rows;
  std::vector<Measurement> readings;
  for (size_t i = 0; i < load.size(); ++i) {
    rows.push_back({{load[i]}});
    readings.push_back({static_cast<int>(i), drop[i], 2e-5, static_cast<int>(i)});
  }
  StaticProtocol bench(builder.build(), std::move(channels), {control}, {}, rows, {});

  const FreeParameter E{bench.parameters().index("E_foam"), 50e3, 1e3, 1e8};
  const FitResult result = fit(bench, readings, {E}, {});
  const ParameterEstimate& found = result.parameters.front();
  std::printf("E = %.2f kPa +- %.2f kPa, chi squared %.2f for %d degrees of freedom: %s\n", found.value / 1e3,
              found.standard_error / 1e3, result.chi_squared, result.dof, std::string(name_of(found.verdict)).c_str());
  return result.status == FitStatus::converged ? 0 : 1;
}

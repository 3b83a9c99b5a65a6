#include <algorithm>

#include "calib/benches/model.hpp"
#include "calib/benches/static_bench.hpp"
#include "sim/mesh/weights.hpp"

namespace taut {

/// Whether surfaces are within the distance at which the contact barrier sets in.
bool StaticBench::touches(const StaticProtocol::Condition& condition) const {
  if (!replay().smallest_distance || !model().parameters().contains("contact_gap")) return false;
  const double gap = condition.p[model().parameters().index("contact_gap")];
  return replay().smallest_distance(condition.u, gap) < gap;
}

std::vector<int> StaticBench::slipped_rows() const {
  std::vector<int> rows;
  for (const StaticProtocol::Condition& condition : model().conditions()) {
    const bool known = condition.report.status == SolveStatus::converged && condition.u.size() > 0;
    if (known && condition.report.slipped) rows.insert(rows.end(), condition.rows.begin(), condition.rows.end());
  }
  return rows;
}

std::vector<TangentStiffness> StaticBench::tangent_stiffness() const {
  std::vector<TangentStiffness> found;
  const StaticProtocol& protocol = model();
  const Mesh& mesh = protocol.scene().model->mesh();
  const Setup setup = setup_of(experiment_, experiment_.mesh, trials_);
  for (const LoadSettings& load : setup.loads) {
    const bool force = load.quantity == Quantity::force || load.quantity == Quantity::mass;
    if (!force || load.column.empty() || mesh.dimension() != experiment_.geometry.dimension) continue;
    const Eigen::VectorXd direction = vector_of(load.direction);
    const Eigen::VectorXd weights = load.point.empty()
                                        ? mean_weights(mesh, mesh.select(load.on), direction)
                                        : point_weights(mesh, locate(mesh, vector_of(load.point)), direction);
    const int index = protocol.parameters().index(load.id);
    const double newtons = load.quantity == Quantity::mass ? experiment_.gravity : 1;  // of one unit of the control
    for (const StaticProtocol::Condition& condition : protocol.conditions()) {
      const auto known = std::find(condition.sensitivity_of.begin(), condition.sensitivity_of.end(), index);
      if (condition.report.status != SolveStatus::converged || known == condition.sensitivity_of.end()) continue;
      const double slope = weights.dot(condition.sensitivities.col(known - condition.sensitivity_of.begin()));
      found.push_back({protocol.describe(condition), load.id, newtons / slope, condition.controls, touches(condition),
                       condition.report.slipped});
    }
  }
  return found;
}

}  // namespace taut

#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/benches/static_replay.hpp"
#include "calib/studies/study_store.hpp"
#include "sim/core/numbers.hpp"
#include "sim/robots/simulation.hpp"

namespace taut {

/// What a run of a solver came to, as independent looks at its last state say. From good to bad.
enum class Outcome {
  converged,  ///< an answer at once
  cut_back,   ///< an answer, after load or time steps were halved
  locked,     ///< an answer that is too stiff by more than 10 %
  elsewhere,  ///< another answer than the refined path's, which may slip itself, or an error above the map's tolerance
  saddle,     ///< not a minimum: nothing would stay there
  diverged,   ///< stalled, or no end within the iterations allowed
  inverted,   ///< elements turned inside out
  intersected,  ///< something passed through something
};
std::string_view name_of(Outcome outcome);  ///< "cut back", as in charts and their store

/// One run: a cell of a map.
struct StabilityRun {
  Outcome outcome = Outcome::converged;
  int iterations = 0;  ///< of Newton's method; right-hand sides of explicit methods
  int factorisations = 0;
  double error = not_a_number;  ///< relative, of what the map compares; NaN: no reference
};

/// A table of runs over two axes, once for each method.
struct StabilityMap {
  std::string id;                 ///< "retraction_load"
  std::string title;              ///< what varies, as the begin of a sentence
  std::string setting;            ///< which mesh, what is held: for the subtitle
  std::string x_label, y_label;   ///< with units
  std::vector<std::string> x, y;  ///< values along the axes, as text
  std::vector<std::string> methods = {};
  std::string elsewhere = "slipped: another answer";  ///< what Outcome::elsewhere is in this map, for people
  bool shows_error = false;                           ///< the error belongs into the cells too
  std::function<StabilityRun(size_t method, size_t x, size_t y)> run = {};

  size_t cells() const { return methods.size() * x.size() * y.size(); }  ///< runs of the whole map
  /// Number of a cell.
  size_t cell(size_t method, size_t i, size_t j) const { return (method * y.size() + j) * x.size() + i; }
};

/// What a static solve came to: `equilibrium` after its solve() to `p` with `options`. `reference` are the
/// displacements of the refined path, empty without one, of which `error` is the largest difference relative to their
/// largest; above `tolerance` it is another answer. Crossings are looked for where `contact`, in 2D.
StabilityRun judge(Equilibrium& equilibrium, const EquilibriumOptions& options, const Params& p,
                   const Eigen::VectorXd& reference, double tolerance, bool contact);

/// The maps of a bench experiment at rest, the most telling ones first, as far as it has what they need: retraction
/// over load (cables), stiffness ratio over load steps (two materials) or load over load steps (one), Poisson's ratio
/// over elements, contact gap over element size (contact), perturbed starts over load steps. On a mesh of at most some
/// 1500 unknowns. Throws InputError for an experiment with recordings.
std::vector<StabilityMap> stability_maps(const Experiment& experiment, const Trials& trials);

/// The maps of a simulation over time: time step over stiffness ratio (two materials), time step over mass ratio. Over
/// a short while from the first touch of what flies freely, or from the start where nothing does. Throws InputError for
/// a quasi-static one.
std::vector<StabilityMap> stability_maps(const Simulation& simulation);

/// The runs of all maps, by StabilityMap::cell(): those of the store, then new ones, map by map, until the budget is
/// used up; a run that has begun is finished. What was not run is empty.
std::vector<std::vector<std::optional<StabilityRun>>> run_stability(const std::vector<StabilityMap>& maps,
                                                                    const StudyOptions& options);

}  // namespace taut

// Tendons that rub: what friction leaves of their tensions, and the derivatives of an equilibrium with it.
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "calib/models/block_factors.hpp"
#include "calib/models/rod.hpp"
#include "calib/models/rod_element.hpp"

namespace taut {

using namespace rod;

/// A piece of tendon in the world.
struct Rod::Run {
  Eigen::Index element = 0, value = 0;
  double length = 0, part = 0;  ///< of the piece at rest [m], of its element
  RodReading direction;         ///< unit length
  Vector12 force;               ///< gradient by the unknowns of its element's nodes, per unit of tension
};

/// By how much each piece's direction, in its middle, is turned against that where its tendon is pulled.
struct Rod::Turning {
  VectorXd angle;
  MatrixXd change;  ///< a column of each piece: by how much where the unknowns change like a column of `dx`
  VectorXd left(double friction) const { return (-friction * angle).array().exp(); }  ///< of the tension
};

/// At a state with held tensions: what these do to it, and it to what friction leaves of them.
struct Rod::Feedback {
  std::vector<Run> runs;
  std::vector<Eigen::Index> pulling;   ///< pieces of tendons with a tension
  MatrixXd by_left;                    ///< H^-1 times the derivative of the gradient by what is left in each of these
  VectorXd by_angle;                   ///< derivative of what is left in each piece
  Eigen::PartialPivLU<MatrixXd> loop;  ///< 1 + (derivative by the state of what is left in these) by_left

  /// How what is left in the pulling ones changes with all angles.
  MatrixXd left_by(const Turning& turning) const {
    return (turning.change * by_angle.asDiagonal())(Eigen::all, pulling).transpose();
  }
};

VectorXd Rod::gradient_by_friction(const RodState& x, const Values& values) const {
  const std::vector<Run> runs = runs_of(x);
  const Turning turning = turning_of(runs, MatrixXd(unknowns(), 0));
  return pulled(runs, values, -turning.angle.cwiseProduct(turning.left(values[friction()])));
}

std::optional<Eigen::MatrixXd> Rod::solve_linear(const RodState& x, const Values& values,
                                                 const Eigen::MatrixXd& B) const {
  const std::optional<BlockFactors> factors = factors_at(x, values);
  if (!factors) return std::nullopt;
  MatrixXd dx = factors->solve(B);
  if (values[friction()] == 0) return dx;
  const Feedback feedback = feedback_of(x, values, [&](MatrixXd b) { return factors->solve(std::move(b)); });
  dx -= feedback.by_left * feedback.loop.solve(feedback.left_by(turning_of(feedback.runs, dx)));
  if (!dx.allFinite()) return std::nullopt;
  return dx;
}

std::vector<Rod::Run> Rod::runs_of(const RodState& x) const {
  std::vector<Run> runs(static_cast<size_t>(pieces_));
  for (size_t i = 0; i < sections_.size(); ++i) {
    const Section& section = sections_[i];
    if (section.pieces.empty()) continue;
    const RodElement e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], section.length);
    const Matrix36 turned = e.middle_turns();
    const Matrix612 strains = e.slopes();
    for (const Piece& piece : section.pieces) {
      // The way along the tendon per arc length, (r_b - r_a)/l + R_m (k x c + c'), with its derivatives.
      const Vector3d beside = cross(e.k, piece.eyelet) + piece.slope;
      const Matrix36 turns = times(Matrix3d(-e.middle() * cross_matrix(beside)), turned);
      const Matrix312 bends =
          times(Matrix3d(-e.middle() * cross_matrix(piece.eyelet)), Matrix312(strains.bottomRows<3>()));
      Matrix312 slopes_of_way = bends;
      for (int r = 0; r < 3; ++r) {
        slopes_of_way(r, r) -= 1 / section.length;
        slopes_of_way(r, r + 6) += 1 / section.length;
        for (int c = 0; c < 3; ++c) {
          slopes_of_way(r, c + 3) += turns(r, c);
          slopes_of_way(r, c + 9) += turns(r, c + 3);
        }
      }
      const Vector3d way = (x.r[i + 1] - x.r[i]) / section.length + e.middle() * beside;
      const double length = way.norm();
      const Vector3d direction = way / length;
      Run& run = runs[static_cast<size_t>(piece.index)];
      run.element = static_cast<Eigen::Index>(i);
      run.value = piece.value;
      run.part = piece.part;
      run.length = piece.part * section.length;
      run.direction.node = static_cast<int>(i);
      run.direction.value = direction;
      run.direction.slopes =
          times(Matrix3d((Matrix3d::Identity() - outer(direction, direction)) / length), slopes_of_way);
      run.force = run.length * (slopes_of_way.transpose() * direction);
    }
  }
  return runs;
}

Rod::Turning Rod::turning_of(const std::vector<Run>& runs, const MatrixXd& dx) const {
  Turning turning{VectorXd::Zero(pieces_), MatrixXd::Zero(dx.cols(), pieces_)};
  Eigen::Index before = -1;  // the piece from which the next one turns
  bool first = false;        // it is its tendon's first
  MatrixXd change_before;    // of its direction
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    const Run& run = runs[static_cast<size_t>(i)];
    const bool begins = i == 0 || runs[static_cast<size_t>(i - 1)].value != run.value;
    if (begins) before = -1;
    // A tendon that ends a hair beyond a node has not turned there.
    if (!begins && (run.part < 0.01 || before < 0)) {
      turning.angle[i] = turning.angle[i - 1];
      turning.change.col(i) = turning.change.col(i - 1);
    }
    if (run.part < 0.01) continue;
    MatrixXd change = run.direction.change(dx);
    if (before >= 0) {
      const Run& last = runs[static_cast<size_t>(before)];
      const Vector3d &from = last.direction.value, &to = run.direction.value;
      const double cosine = from.dot(to), sine = cross(from, to).norm();
      const double angle = std::atan2(sine, cosine);
      VectorXd changes = VectorXd::Zero(dx.cols());
      // Where a path is straight the angle has a kink; its slopes are zero there.
      if (sine > 1e-12)
        changes =
            -(change.transpose() * (from - cosine * to) + change_before.transpose() * (to - cosine * from)) / sine;
      if (first) {  // as much turned before its middle
        const double share = last.length / (last.length + run.length);
        turning.angle[before] = share * angle;
        turning.change.col(before) = share * changes;
      }
      turning.angle[i] = turning.angle[before] + angle;
      turning.change.col(i) = turning.change.col(before) + changes;
    }
    first = before < 0;
    before = i;
    change_before = std::move(change);
  }
  return turning;
}

/// How the gradient changes where more is left of the tension of each piece, a row, than nothing.
MatrixXd Rod::pulled(const std::vector<Run>& runs, const Values& values, const MatrixXd& more) const {
  MatrixXd gradients = MatrixXd::Zero(unknowns() + 6, more.cols());
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    const Run& run = runs[static_cast<size_t>(i)];
    gradients.middleRows<12>(6 * run.element) += values[run.value] * run.force * more.row(i);
  }
  return gradients.bottomRows(unknowns());
}

Rod::Feedback Rod::feedback_of(const RodState& x, const Values& values,
                               const std::function<MatrixXd(MatrixXd)>& by_hessian) const {
  Feedback feedback;
  feedback.runs = runs_of(x);
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    if (values[feedback.runs[static_cast<size_t>(i)].value] != 0) feedback.pulling.push_back(i);
  }
  const Eigen::Index n = static_cast<Eigen::Index>(feedback.pulling.size());
  MatrixXd one = MatrixXd::Zero(pieces_, n);
  for (Eigen::Index i = 0; i < n; ++i) one(feedback.pulling[static_cast<size_t>(i)], i) = 1;
  feedback.by_left = by_hessian(pulled(feedback.runs, values, one));
  const Turning turning = turning_of(feedback.runs, feedback.by_left);
  feedback.by_angle = -values[friction()] * turning.left(values[friction()]);
  feedback.loop.compute(MatrixXd::Identity(n, n) + feedback.left_by(turning));
  return feedback;
}

Eigen::VectorXd Rod::tension_left(const RodState& x, double friction) const {
  return turning_of(runs_of(x), MatrixXd(unknowns(), 0)).left(friction);
}

/// An equilibrium with the tensions that friction leaves there, from `x` on: these are taken from the state before, and
/// where that does not settle them quickly, by Newton's method for the tensions.
std::string Rod::settle(RodState& x, const Values& values, int& factorisations) const {
  std::string problem = solve(x, values, factorisations);
  if (values[friction()] == 0) return problem;
  double last = std::numeric_limits<double>::infinity();  // the last change
  for (int repetition = 0; problem.empty() && repetition < 50; ++repetition) {
    if (x.left.size() == 0) x.left = VectorXd::Ones(pieces_);
    VectorXd change = tension_left(x, values[friction()]) - x.left;
    const double most = change.lpNorm<Eigen::Infinity>();
    // What a thin rod's state is rounded to keeps it above what is negligible, see solve().
    if (most < 1e-12 || (most < 1e-8 && most > 0.5 * last)) return "";
    if (most > 0.2 * last) {
      ++factorisations;
      const std::optional<BlockFactors> factors = factors_at(x, values);
      if (!factors) return "the equilibrium is not stable";
      const Feedback feedback = feedback_of(x, values, [&](MatrixXd b) { return factors->solve(std::move(b)); });
      change(feedback.pulling) = feedback.loop.solve(change(feedback.pulling).eval()).eval();
    }
    x.left = (x.left + change).cwiseMax(0).cwiseMin(1);
    last = most;
    problem = solve(x, values, factorisations);
  }
  return problem.empty() ? "the friction of its tendons does not settle" : problem;
}

}  // namespace taut

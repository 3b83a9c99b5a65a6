#include "sim/core/dense.hpp"

#include <Eigen/QR>
#include <Eigen/SVD>
#include <limits>

namespace taut {

SingularValues singular_values(const Eigen::MatrixXd& A) {
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(A, Eigen::ComputeThinU | Eigen::ComputeThinV);
  return {svd.matrixU(), svd.singularValues(), svd.matrixV()};
}

Eigen::VectorXd minimum_norm_solution(const Eigen::MatrixXd& A, const Eigen::VectorXd& b) {
  const SingularValues svd = singular_values(A);
  if (svd.s.size() == 0) return Eigen::VectorXd::Zero(A.cols());
  const double seen = svd.s[0] * std::numeric_limits<double>::epsilon() * static_cast<double>(svd.s.size());
  Eigen::VectorXd along = svd.U.transpose() * b;
  for (Eigen::Index i = 0; i < along.size(); ++i) along[i] = svd.s[i] > seen ? along[i] / svd.s[i] : 0.0;
  return svd.V * along;
}

Eigen::VectorXd bounded_least_squares(const Eigen::MatrixXd& A, const Eigen::VectorXd& b, const Eigen::VectorXd& lower,
                                      const Eigen::VectorXd& upper) {
  const Eigen::Index n = A.cols();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(n).cwiseMax(lower).cwiseMin(upper);
  std::vector<bool> free(static_cast<size_t>(n), true);
  for (Eigen::Index round = 0; round < 10 * n + 10; ++round) {
    std::vector<Eigen::Index> those;
    for (Eigen::Index j = 0; j < n; ++j) {
      if (free[static_cast<size_t>(j)]) those.push_back(j);
    }
    Eigen::VectorXd way = Eigen::VectorXd::Zero(n);
    if (!those.empty()) {
      const Eigen::MatrixXd of_those = A(Eigen::all, those);
      const Eigen::VectorXd way_of_those = minimum_norm_solution(of_those, b - A * x);
      way(those) = way_of_those;
    }
    // On that way to the first bound that it meets; that one stays there.
    double fraction = 1;
    Eigen::Index met = -1;
    for (Eigen::Index j = 0; j < n; ++j) {
      const double room = (way[j] < 0 ? lower[j] : upper[j]) - x[j];
      if (way[j] == 0 || std::abs(room) >= fraction * std::abs(way[j])) continue;
      fraction = room / way[j];
      met = j;
    }
    x += fraction * way;
    if (met >= 0) {
      x[met] = way[met] < 0 ? lower[met] : upper[met];
      free[static_cast<size_t>(met)] = false;
      continue;
    }
    // Of those at a bound, the one that is drawn inwards most is free again.
    const Eigen::VectorXd residual = A * x - b;
    double most = 1e-9 * residual.norm();
    for (Eigen::Index j = 0; j < n; ++j) {
      const double length = A.col(j).norm();
      if (free[static_cast<size_t>(j)] || lower[j] == upper[j] || length == 0) continue;
      const double inwards = (x[j] == lower[j] ? -1 : 1) * A.col(j).dot(residual) / length;
      if (!(inwards > most)) continue;
      most = inwards;
      met = j;
    }
    if (met < 0) break;
    free[static_cast<size_t>(met)] = true;
  }
  return x;
}

Eigen::VectorXd least_squares(const Eigen::MatrixXd& A, const Eigen::VectorXd& b) {
  return A.colPivHouseholderQr().solve(b);
}

Eigen::Index rank_of(const Eigen::MatrixXd& A, double threshold) {
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
  qr.setThreshold(threshold);
  return qr.rank();
}

}  // namespace taut

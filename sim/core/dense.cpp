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

Eigen::VectorXd least_squares(const Eigen::MatrixXd& A, const Eigen::VectorXd& b) {
  return A.colPivHouseholderQr().solve(b);
}

Eigen::Index rank_of(const Eigen::MatrixXd& A, double threshold) {
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
  qr.setThreshold(threshold);
  return qr.rank();
}

}  // namespace taut

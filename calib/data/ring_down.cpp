#include "calib/data/ring_down.hpp"

#include <fmt/format.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

struct Linear {
  Eigen::Vector4d coefficients;  ///< offset, drift, a, b
  double squares = 0;
};

/// The four numbers in which y is linear, for given others.
Linear linear_part(const Eigen::ArrayXd& t, const Eigen::VectorXd& y, double w, double decay) {
  Eigen::MatrixXd A(t.size(), 4);
  const Eigen::ArrayXd envelope = (-decay * t).exp();
  A.col(0).setOnes();
  A.col(1) = t.matrix();
  A.col(2) = (envelope * (w * t).cos()).matrix();
  A.col(3) = (envelope * (w * t).sin()).matrix();
  Linear result;
  result.coefficients = least_squares(A, y);
  result.squares = (y - A * result.coefficients).squaredNorm();
  return result;
}

}  // namespace

double RingDown::damping_ratio() const {
  return decay / std::hypot(2 * M_PI * frequency, decay);
}

RingDown ring_down(const std::vector<double>& times, const std::vector<double>& values) {
  const size_t count = times.size();
  if (count < 8 || values.size() != count)
    throw InputError(fmt::format("frequency and decay need 8 samples or more, there are {}; take more of them", count));
  for (size_t i = 0; i < count; ++i) {
    if (!std::isfinite(times[i]) || !std::isfinite(values[i]) || (i > 0 && !(times[i] > times[i - 1])))
      throw InputError(
          fmt::format("frequency and decay need finite samples at ascending times; sample {} is not", i + 1));
  }
  const Eigen::ArrayXd t = Eigen::Map<const Eigen::ArrayXd>(times.data(), static_cast<Eigen::Index>(count)) - times[0];
  const Eigen::VectorXd y = Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(count));
  const double span = times.back() - times.front();

  double w = 0, decay = 0, best = std::numeric_limits<double>::infinity();
  const auto improves = [&](double other_w, double other_decay) {
    const double squares = linear_part(t, y, other_w, other_decay).squares;
    if (squares >= best) return false;
    best = squares;
    w = other_w;
    decay = other_decay;
    return true;
  };
  // Where to start: the best of a grid, fine enough for the width 1 / span of a peak.
  const int cycles = static_cast<int>(count) / 3;
  for (int i = 8; i <= 8 * cycles; ++i) {
    // That the motion decays by e^-1 over the span, or e^-3.
    for (double periods : {0.5, 3.0}) improves(2 * M_PI * i / (8 * span), 2 * periods / span);
  }
  // Down along one axis after the other, with ever smaller steps.
  for (double step = 0.5 / span; step > 1e-9 / span;) {
    bool better = false;
    for (const auto& [dw, dd] : {std::pair{step, 0.0}, {-step, 0.0}, {0.0, step}, {0.0, -step}})
      better = improves(w + dw, decay + dd) || better;
    if (!better) step *= 0.5;
  }
  const Linear last = linear_part(t, y, w, decay);
  RingDown result;
  result.frequency = w / (2 * M_PI);
  result.decay = decay;
  result.offset = last.coefficients[0];
  result.drift = last.coefficients[1];
  result.amplitude = std::hypot(last.coefficients[2], last.coefficients[3]);
  result.rms = std::sqrt(last.squares / static_cast<double>(count));
  return result;
}

}  // namespace taut

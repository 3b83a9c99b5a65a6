#pragma once
#include <Eigen/Core>
#include <cmath>

namespace taut {

/// A number with its first and second derivatives with respect to N variables.
template <int N>
struct Jet {
  using Gradient = Eigen::Matrix<double, N, 1>;  ///< first derivatives
  using Hessian = Eigen::Matrix<double, N, N>;   ///< second derivatives
  double v = 0;
  Gradient g = Gradient::Zero();
  Hessian H = Hessian::Zero();

  Jet() = default;
  Jet(double value) : v(value) {}  ///< a constant
  /// The index-th of the variables.
  static Jet variable(double value, int index) {
    Jet x(value);
    x.g[index] = 1;
    return x;
  }
  /// f(x) of one number by its value and derivatives there.
  Jet with(double f, double df, double ddf) const {
    Jet y(f);
    y.g = df * g;
    y.H = df * H + ddf * (g * g.transpose());
    return y;
  }
  /// As for numbers, by the chain rule.
  /// @{
  friend Jet operator+(const Jet& a, const Jet& b) {
    Jet c(a.v + b.v);
    c.g = a.g + b.g;
    c.H = a.H + b.H;
    return c;
  }
  friend Jet operator-(const Jet& a, const Jet& b) {
    Jet c(a.v - b.v);
    c.g = a.g - b.g;
    c.H = a.H - b.H;
    return c;
  }
  friend Jet operator*(const Jet& a, const Jet& b) {
    Jet c(a.v * b.v);
    c.g = a.v * b.g + b.v * a.g;
    const Hessian cross = a.g * b.g.transpose();
    c.H = a.v * b.H + b.v * a.H + cross + cross.transpose();
    return c;
  }
  friend Jet operator+(const Jet& a, double b) {
    Jet c = a;
    c.v += b;
    return c;
  }
  friend Jet operator+(double a, const Jet& b) { return b + a; }
  friend Jet operator-(const Jet& a, double b) { return a + (-b); }
  friend Jet operator-(double a, const Jet& b) { return a + (-1.0) * b; }
  friend Jet operator*(double a, const Jet& b) {
    Jet c(a * b.v);
    c.g = a * b.g;
    c.H = a * b.H;
    return c;
  }
  friend Jet operator*(const Jet& a, double b) { return b * a; }
  friend Jet operator/(const Jet& a, double b) { return (1 / b) * a; }
  friend Jet operator/(const Jet& a, const Jet& b) {
    return a * b.with(1 / b.v, -1 / (b.v * b.v), 2 / (b.v * b.v * b.v));
  }
  friend Jet operator/(double a, const Jet& b) { return b.with(a / b.v, -a / (b.v * b.v), 2 * a / (b.v * b.v * b.v)); }
  friend Jet log(const Jet& x) { return x.with(std::log(x.v), 1 / x.v, -1 / (x.v * x.v)); }
  friend Jet sqrt(const Jet& x) {
    const double root = std::sqrt(x.v);
    return x.with(root, 0.5 / root, -0.25 / (root * x.v));
  }
  friend Jet tanh(const Jet& x) {
    const double t = std::tanh(x.v);
    return x.with(t, 1 - t * t, -2 * t * (1 - t * t));
  }
  friend Jet sin(const Jet& x) { return x.with(std::sin(x.v), std::cos(x.v), -std::sin(x.v)); }
  friend Jet cos(const Jet& x) { return x.with(std::cos(x.v), -std::sin(x.v), -std::cos(x.v)); }
  /// @}
};

/// The number itself.
inline double value_of(double x) {
  return x;
}
/// Without its derivatives.
template <int N>
double value_of(const Jet<N>& x) {
  return x.v;
}

}  // namespace taut

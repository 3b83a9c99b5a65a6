#pragma once
#include <Eigen/Core>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

namespace taut {

/// What a number of a model is, declared once, next to the energy that uses it. Bounds, help texts, checks and
/// tables all come from here.
struct ParameterSpec {
  std::string id;                                           ///< unique in a model, e.g. "E_silicone"
  std::string symbol;                                       ///< as in formulas, e.g. "E"
  std::string unit;                                         ///< SI, e.g. "Pa"; "1" for a pure number
  double lower = -std::numeric_limits<double>::infinity();  ///< smallest physical value
  double upper = std::numeric_limits<double>::infinity();   ///< largest physical value
  std::string meaning;                                      ///< one phrase for a person
  bool logarithmic =
      false;  ///< a modulus or stiffness: positive, known by its order of magnitude, fitted as its logarithm
  bool may_be_zero = false;  ///< an angle or a shift: zero is a value like any other, and no sign of knowing it badly
};

/// Values of all parameters of a model, in the order of their table, SI units. Shape: (table.size()).
using Params = Eigen::VectorXd;

/// The numbers on which a model's energy depends besides the positions: material parameters theta and controls c
/// (loads, gravity, prescribed displacements) alike. One table for both lets load stepping, warm starts and
/// sensitivities share one mechanism.
class ParameterTable {
 public:
  /// Adds a parameter and returns its index. Throws std::logic_error when the id exists.
  int declare(ParameterSpec spec);
  /// Index of a parameter; throws InputError naming the nearest id when there is none.
  int index(std::string_view id) const;
  bool contains(std::string_view id) const;                                   ///< whether it was declared
  int size() const { return static_cast<int>(specs_.size()); }                ///< number of parameters
  const ParameterSpec& operator[](int index) const { return specs_[index]; }  ///< what was declared
  std::vector<std::string> ids() const;                                       ///< in the order of the table
  /// Throws InputError naming parameter, value and bounds when `value` is not finite or outside its bounds.
  void check(int index, double value) const;

 private:
  std::vector<ParameterSpec> specs_;
};

}  // namespace taut

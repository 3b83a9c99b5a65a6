#pragma once
#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace taut {

/// A length with its extension lines, shown on one side of a body. [m]
struct DimensionLine {
  /// Of the body.
  enum Side { below, above, left, right } side;
  double from, to;  ///< along the side
  double body;      ///< across it: where the extension lines begin
  std::string name;
};

/// An upright length inside a body, in a part of it that is free from `left` to `right`. [m]
struct InnerLine {
  double left, right;
  double place;  ///< where it stands, as a fraction of the way; farther right where there is little room for its number
  double from, to;
  std::string name;
};

/// What the drawing of a plane specimen shows beside its outline, in the frame of its mesh. [m]
struct ShapeDrawing {
  /// An enlarged part: what lies between `lower` and `upper`.
  struct Detail {
    std::string title;
    Eigen::Vector2d lower, upper;
    std::vector<DimensionLine> lines;
  };

  std::string summary;  ///< "4 cells"
  std::vector<DimensionLine> lines;
  std::vector<InnerLine> inner;
  std::optional<std::pair<double, double>> axis;  ///< y = 0 between these x
  std::optional<Detail> detail;                   ///< a part of it, enlarged
};

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

namespace taut {

/// A plane body as a chain of beams sees it: soft spans in a row along an axis, between stiff pieces or, of a body that
/// is all soft, one span from face to face. Lengths in metres.
struct Spine {
  /// A soft piece.
  struct Span {
    double begin, length, height;  ///< begin: from the origin along the axis
  };
  /// The lips of a span's two neighbours, alike on both sides of the axis.
  struct Lips {
    double length;        ///< from the stiff piece to the end face
    double thickness;     ///< of the smaller end face
    double inner, outer;  ///< its edges' distances from the axis
  };

  std::string clamped, loaded;  ///< tags of its two ends
  Eigen::Vector2d origin = Eigen::Vector2d::Zero(), along = Eigen::Vector2d::UnitX();
  double end = 0;     ///< of the loaded face, from the origin along the axis
  std::string soft;   ///< region of the spans
  std::string stiff;  ///< of the pieces that follow on the spans; own cables have a point at either end of each span
  std::vector<Span> spans;
  std::optional<Lips> lips;
};

}  // namespace taut

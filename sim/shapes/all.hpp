#pragma once
#include <tuple>

#include "sim/shapes/finger.hpp"
#include "sim/shapes/grid.hpp"
#include "sim/shapes/mesh_file.hpp"
#include "sim/shapes/outlines.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "sim/shapes/push_puppet_3d.hpp"
#include "sim/shapes/revolved.hpp"
#include "sim/shapes/sheet.hpp"
#include "sim/shapes/twist.hpp"

namespace taut {

/// The list of specimens, in the order in which messages name them.
using AllShapes = std::tuple<Box, Rectangle, Boxes, Polygons, Disc, Revolved, PushPuppet, PushPuppet3d, Finger,
                             TwistModule, Sheet, MeshFile>;

}  // namespace taut

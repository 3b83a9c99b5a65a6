#pragma once
#include <string>

#include "reports/simulation_record.hpp"

namespace taut {

/// Stored states that an animation shows, as its JSON: positions of the surface's nodes and of the lines' points as
/// whole numbers of steps from an origin (a step is 1e-4 of the window's largest side), the first frame as such and
/// each other as its difference to the one before. Frames are thinned out evenly, first and last kept, until the frames
/// take at most `budget` bytes. In millimetres:
///
///   dimension, window {lower, upper}, step, regions [{name, colour}], nodes (mesh numbers, in the frames' order),
///   loops [{region, points}] or triangles [a, b, c, ...] with triangle_regions, lines [{name, colour, count}],
///   obstacles [[x, y, ...]], ground [[x0, y0, x1, y1, ...]] (strokes; one list, or one per frame where grounds move),
///   round (the same of what is not plane), sample {name, unit, decimals, seconds, values}, series [{id, meaning, unit,
///   control, values}] (`seconds`: of one unit of the sample variable, 0 where it is no time; of equilibria over
///   "time" the sample variable is the control that drives them), shown, stored (numbers of frames), frames [[...],
///   ...]
///
/// Text in it is safe inside a script element.
std::string animation_json(const SimulationRecord& record, size_t budget = 4'500'000);

/// The animation as a piece of a page: style, canvas, script and data; nothing is loaded from anywhere. Once per page.
std::string animation_fragment(const SimulationRecord& record);

/// animation.html: the fragment as a page of its own.
std::string animation_html(const SimulationRecord& record);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "reports/section.hpp"

namespace taut {

/// What report.js draws from, as a piece of the page of a run: the record's readings and shapes and the numbers of the
/// page's figures in one block of JSON, and the script. Without JavaScript it shows nothing. The JSON holds
///
///   figures {name: its CSV text}, before (what stands before their titles), load {label, unit}, channels [{id, label,
///   unit}] (of the CSVs), readings {line, trial, channel, series, setting, measured, sigma, fitted, excluded, shape: a
///   list each} in the channel's unit, `shape` an index into shapes or -1, shapes {axes, lower, step, regions [{name,
///   colour}], triangles, triangle_regions, states [{label, row, column, areas [[loop, ...]], cables, lines, contacts
///   [{at, force [N], places}]}]}: points x0, y0, x1, y1, ... in whole steps [mm] from `lower` [mm], stored (shapes in
///   the record; there are fewer states where they are thinned out to `budget` bytes). In space (triangles) points have
///   three coordinates, states have no areas and lines but `points`, those of the surface, from the second state on as
///   differences to the state before.
///
/// Pages of shapes in space hold three.js, too.
///
/// Text in it is safe inside a script element. Used inside reports/ only.
std::string interactive(const RunRecord& record, const std::vector<Section>& sections, size_t budget = 1'000'000);

/// The JSON alone.
std::string page_data(const RunRecord& record, const std::vector<Section>& sections, size_t budget = 1'000'000);

/// JSON inside a page: nothing in it ends its script element.
std::string within_script(std::string json);

}  // namespace taut

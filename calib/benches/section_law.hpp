#pragma once

namespace taut {

/// What a section of a rod resists stretching and bending with; see calib/models/rod.hpp.
enum class SectionLaw { linear, neo_hookean };

}  // namespace taut

#include "reports/section.hpp"

#include "reports/html.hpp"

namespace taut {

std::vector<Figure> draw(std::vector<Section>& sections, const std::string& folder) {
  std::vector<Figure> drawn;
  for (Section& section : sections) {
    for (plot::Drawing& drawing : section.figures) {
      plot::draw(drawing, folder);
      drawn.push_back(drawing.figure);
    }
  }
  return drawn;
}

std::string html_of(const std::vector<Section>& sections, size_t largest_inline) {
  std::string out;
  for (const Section& section : sections) {
    out += section.html;
    for (const plot::Drawing& drawing : section.figures) {
      if (!drawing.figure.svg.empty()) out += html::figure(drawing.figure, largest_inline);
    }
  }
  return out;
}

}  // namespace taut

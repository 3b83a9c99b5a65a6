#pragma once
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "reports/figures.hpp"

namespace taut {

/// A piece of a page: html, and figures below it. A page is the list of its sections, functions of a record that return
/// nothing where the record has nothing to say. Used inside reports/ only.
struct Section {
  std::string html;
  std::vector<plot::Drawing> figures = {};
};
/// What a page is a list of.
template <class Record>
using MakeSection = std::optional<Section> (*)(const Record& record);

/// A section of html alone; nothing without it.
inline std::optional<Section> html_section(std::string html) {
  return html.empty() ? std::nullopt : std::optional(Section{std::move(html)});
}

/// A section of html, which may be empty, and a figure where there is one.
inline std::optional<Section> with_figure(std::string html, std::optional<plot::Drawing> figure) {
  Section section{std::move(html)};
  if (figure) section.figures.push_back(std::move(*figure));
  return section.html.empty() && section.figures.empty() ? std::nullopt : std::optional(std::move(section));
}

/// The section of a figure that stands without text.
template <auto figure, class Record>
std::optional<Section> alone(const Record& record) {
  return with_figure("", figure(record));
}

/// `before` stands before the title of every figure.
template <class Record>
std::vector<Section> sections_of(const Record& record, std::span<const MakeSection<Record>> page,
                                 const std::string& before) {
  std::vector<Section> sections;
  for (const MakeSection<Record> make : page) {
    std::optional<Section> section = make(record);
    if (!section) continue;
    for (plot::Drawing& drawing : section->figures) drawing.figure.title = before + drawing.figure.title;
    sections.push_back(std::move(*section));
  }
  return sections;
}

/// Draws all figures into `folder`/figures and returns them. What gnuplot cannot draw is left out, see
/// undrawn_figures().
std::vector<Figure> draw(std::vector<Section>& sections, const std::string& folder);

/// The sections one after the other; figures that are not drawn yet are left out, those of more than `largest_inline`
/// bytes are linked to.
std::string html_of(const std::vector<Section>& sections, size_t largest_inline = std::string::npos);

}  // namespace taut

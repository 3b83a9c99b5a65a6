#include "reports/html.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string_view>

#include "reports/page_texts.hpp"
#include "sim/core/units.hpp"

namespace taut::html {
namespace {

void remove_between(std::string& text, const std::string& begin, const std::string& end) {
  for (size_t at = text.find(begin); at != std::string::npos; at = text.find(begin, at)) {
    const size_t stop = text.find(end, at);
    if (stop == std::string::npos) return;
    text.erase(at, stop + end.size() - at);
  }
}

/// The text between two marks from `at` on; "" where they are not.
std::string text_between(const std::string& text, size_t at, const std::string& begin, const std::string& end) {
  const size_t from = text.find(begin, at);
  const size_t to = from == std::string::npos ? from : text.find(end, from + begin.size());
  return to == std::string::npos ? "" : text.substr(from + begin.size(), to - from - begin.size());
}

/// Gives every heading an id and links to headings and figures; a page of a few parts needs none.
std::string with_contents(std::string body) {
  const std::string heading = "<h2>", drawn = "<figure id=\"";
  std::string links;
  size_t first = std::string::npos, parts = 0;
  for (size_t at = 0; at < body.size();) {
    const size_t h2 = body.find(heading, at), fig = body.find(drawn, at), next = std::min(h2, fig);
    if (next == std::string::npos) break;
    first = std::min(first, next);
    std::string id, text;
    if (next == h2) {
      id = fmt::format("part-{}", ++parts);
      text = text_between(body, next, heading, "</h2>");
      body.replace(next, heading.size(), fmt::format("<h2 id=\"{}\">", id));
    } else {
      id = text_between(body, next, drawn, "\"");
      text = text_between(body, next, "data-title=\"", "\"");
      for (const std::string said : {"SIMULATED DATA: ", "Simulation: "}) {  // above the page
        if (!text.starts_with(said)) continue;
        text.erase(0, said.size());
        if (!text.empty() && text[0] >= 'a' && text[0] <= 'z') text[0] = static_cast<char>(text[0] - 'a' + 'A');
      }
    }
    links += fmt::format("<li><a href=\"#{}\">{}</a></li>\n", id, text);
    at = next + 1;
  }
  if (parts < 2) return body;
  return body.insert(first, "<nav aria-label=\"Contents\"><details open><summary>Contents</summary><ul>\n" + links +
                                "</ul></details></nav>\n");
}

}  // namespace

std::string page(const std::string& title, const std::string& body) {
  const std::string whole = with_contents(body);
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n<style>{}</style>\n"
      "</head>\n<body>\n<main>\n{}</main>\n</body>\n</html>\n",
      escaped(title), page_text("page.css"), whole);
}

std::string paragraph(const std::string& text, const std::string& kind) {
  return fmt::format("<p{}>{}</p>\n", kind.empty() ? "" : fmt::format(" class=\"{}\"", kind), escaped(text));
}

std::string figure(const Figure& figure, size_t largest) {
  const std::string picture = figure.svg.size() <= largest ? inlined(figure.svg, figure.name, figure.title)
                                                           : fmt::format("<img src=\"figures/{}.png\" alt=\"{}\">\n",
                                                                         escaped(figure.name), escaped(figure.title));
  return fmt::format(
      "<figure id=\"figure-{}\" data-title=\"{}\">\n<div class=\"picture\">\n{}</div>\n<figcaption>{}</figcaption>\n"
      "</figure>\n",
      escaped(figure.name), escaped(figure.title), picture, escaped(figure.caption));
}

std::string escaped(const std::string& text) {
  static const std::map<char, std::string> written = {
      {'&', "&amp;"}, {'<', "&lt;"}, {'>', "&gt;"}, {'"', "&quot;"}, {'\'', "&#39;"}};
  std::string out;
  for (const char c : text) out += written.contains(c) ? written.at(c) : std::string(1, c);
  return out;
}

std::string bare_number(double value) {
  return std::isfinite(value) ? with_unit(value, "1") : "not known";
}

std::string list(const std::vector<std::string>& texts) {
  std::string out = "<ul>\n";
  for (const std::string& text : texts) out += "<li>" + escaped(text) + "</li>\n";
  return out + "</ul>\n";
}

std::string table(const Cells& header, const std::vector<Cells>& rows) {
  const auto is_number = [&](size_t column) { return column < header.size() && header[column].starts_with('#'); };
  const bool has_head = std::ranges::any_of(header, [](const std::string& text) { return !text.empty(); });
  const auto cell = [&](const char* scope, size_t column, const std::string& html) {
    const std::string attributes =
        std::string(is_number(column) ? " class=\"n\"" : "") + (*scope != 0 ? fmt::format(" scope=\"{}\"", scope) : "");
    return fmt::format("<{0}{1}>{2}</{0}>", *scope != 0 ? "th" : "td", attributes, html);
  };
  // What scrolls sideways has to be reached by keyboards.
  std::string out = "<div class=\"scroll\" tabindex=\"0\"><table>\n";
  if (has_head) {
    out += "<thead><tr>";
    for (size_t c = 0; c < header.size(); ++c) out += cell("col", c, escaped(header[c].substr(is_number(c) ? 1 : 0)));
    out += "</tr></thead>\n";
  }
  out += "<tbody>\n";
  for (const Cells& row : rows) {
    out += "<tr>";
    for (size_t c = 0; c < row.size(); ++c) {
      std::string text = escaped(row[c]);
      if (row[c].starts_with('`')) text = "<code>" + text.substr(1) + "</code>";
      if (row[c].starts_with('~')) text = "<s>" + text.substr(1) + "</s>";
      // What a row is about: its first cell where that has no head of its own.
      const bool names_row = c == 0 && row.size() > 1 && (!has_head || header[0].empty());
      out += cell(names_row ? "row" : "", c, text);
    }
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string inlined(const std::string& svg, const std::string& name, const std::string& title) {
  const size_t begin = svg.find("<svg");
  const size_t inside = begin == std::string::npos ? begin : svg.find('>', begin);
  if (inside == std::string::npos) return "";
  const std::string tag = svg.substr(begin, inside - begin);
  const size_t box_at = tag.find("viewBox=\"");
  const std::string box =
      box_at == std::string::npos ? "" : tag.substr(box_at + 9, tag.find('"', box_at + 9) - box_at - 9);
  std::string body = svg.substr(inside + 1);
  remove_between(body, "<title>", "</title>");
  remove_between(body, "<desc>", "</desc>");

  // gnuplot gives the same ids in every figure, and repeats some of them within one.
  std::map<std::string, int> seen;
  std::string out;
  size_t done = 0;
  for (size_t at = 0; at < body.size(); ++at) {
    for (const std::string_view kind : {" id='", " id=\"", "href='#", "href=\"#", "url(#", "url('#"}) {
      if (body.compare(at, kind.size(), kind) != 0) continue;
      const size_t name_begin = at + kind.size(), name_end = body.find_first_of("'\")", name_begin);
      if (name_end == std::string::npos) break;
      const std::string id = body.substr(name_begin, name_end - name_begin);
      out += body.substr(done, name_begin - done) + name + "-" + id;
      if (kind.starts_with(" id") && ++seen[id] > 1) out += fmt::format("-{}", seen[id]);
      done = at = name_end;
      break;
    }
  }
  out += body.substr(done);
  return fmt::format("<svg viewBox=\"{}\" role=\"img\" aria-label=\"{}\">\n{}", escaped(box), escaped(title), out);
}

}  // namespace taut::html

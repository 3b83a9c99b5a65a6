#include "reports/html.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string_view>

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

}  // namespace

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string bare_number(double value) {
  return std::isfinite(value) ? with_unit(value, "1") : "not known";
}

std::string table(const std::vector<std::string>& header, const std::vector<std::vector<std::string>>& rows) {
  const auto is_number = [&](size_t column) { return column < header.size() && header[column].starts_with('#'); };
  std::string out = "<div class=\"scroll\"><table>\n";
  if (std::ranges::any_of(header, [](const std::string& text) { return !text.empty(); })) {
    out += "<thead><tr>";
    for (size_t c = 0; c < header.size(); ++c) {
      out += is_number(c) ? "<th class=\"n\">" + escaped(header[c].substr(1)) : "<th>" + escaped(header[c]);
      out += "</th>";
    }
    out += "</tr></thead>\n";
  }
  out += "<tbody>\n";
  for (const std::vector<std::string>& row : rows) {
    out += "<tr>";
    for (size_t c = 0; c < row.size(); ++c) {
      const bool code = row[c].starts_with('`');
      out += is_number(c) ? "<td class=\"n\">" : "<td>";
      out += code ? "<code>" + escaped(row[c].substr(1)) + "</code>" : escaped(row[c]);
      out += "</td>";
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

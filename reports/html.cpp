#include "reports/html.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <regex>

#include "calib/units.hpp"

namespace taut::html {
namespace {

/// The value of an attribute in an opening tag, or "".
std::string attribute(const std::string& tag, const std::string& name) {
  std::smatch found;
  const std::regex pattern("\\s" + name + "=['\"]([^'\"]*)['\"]");
  return std::regex_search(tag, found, pattern) ? found[1].str() : "";
}

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

std::string bare_number(double value) { return std::isfinite(value) ? with_unit(value, "1") : "not known"; }

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
  const std::string box = attribute(svg.substr(begin, inside - begin), "viewBox");
  std::string body = svg.substr(inside + 1);
  remove_between(body, "<title>", "</title>");
  remove_between(body, "<desc>", "</desc>");

  // gnuplot gives the same ids in every figure, and repeats some of them within one.
  std::map<std::string, int> seen;
  std::string out;
  static const std::regex pattern(R"(\b(id=['"]|href=['"]#|url\(['"]?#)([^'")]+))");
  auto rest = body.cbegin();
  for (std::sregex_iterator it(body.cbegin(), body.cend(), pattern), end; it != end; ++it) {
    const std::string kind = (*it)[1].str(), id = (*it)[2].str();
    out.append(rest, it->prefix().second);
    out += kind + name + "-" + id;
    if (kind.starts_with("id") && ++seen[id] > 1) out += fmt::format("-{}", seen[id]);
    rest = it->suffix().first;
  }
  out.append(rest, body.cend());
  return fmt::format("<svg viewBox=\"{}\" role=\"img\" aria-label=\"{}\">\n{}", escaped(box), escaped(title), out);
}

}  // namespace taut::html

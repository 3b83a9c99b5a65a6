#include "reports/html.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string_view>

#include "sim/core/units.hpp"

namespace taut::html {
namespace {

const char* const kStyle = R"(
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; color: #222;
  background: #fff; margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 60rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-bottom: .2rem; border-bottom: 1px solid #ddd; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 46rem; }
li { max-width: 46rem; }
.origin { color: #666; margin-bottom: 1rem; }
.banner { background: #d55e00; color: #fff; font-weight: 600; padding: .6rem 1rem; border-radius: .3rem;
  margin: 0 0 1rem; max-width: none; }
.answer { background: #f1f6fa; border-left: .35rem solid #0072b2; padding: .8rem 1rem; margin: 1rem 0; }
.answer p { max-width: none; margin: .25rem 0; }
.answer .number { font-size: 1.2rem; font-weight: 600; }
.warning { border-left: .35rem solid #d55e00; padding: .2rem 0 .2rem .8rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; }
th, td { text-align: left; vertical-align: top; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e6e6e6; }
th { border-bottom: 2px solid #bbb; font-weight: 600; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.hash { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: .75rem; overflow-wrap: anywhere; }
figure { margin: 1.6rem 0; }
figure svg, figure img { width: 100%; height: auto; display: block; }
figcaption { margin-top: .6rem; color: #555; font-size: .92rem; max-width: 46rem; }
code, pre { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: .85em; overflow-wrap: anywhere; }
pre { background: #f6f6f6; padding: .8rem; overflow-x: auto; }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; } h2 { break-after: avoid; }
  .scroll { overflow: visible; } table { font-size: 8pt; } figure, tr, .answer { break-inside: avoid; } .banner { color: #000; border: 2px solid #d55e00; } #motion { display: none; } }
)";

void remove_between(std::string& text, const std::string& begin, const std::string& end) {
  for (size_t at = text.find(begin); at != std::string::npos; at = text.find(begin, at)) {
    const size_t stop = text.find(end, at);
    if (stop == std::string::npos) return;
    text.erase(at, stop + end.size() - at);
  }
}

}  // namespace

std::string page(const std::string& title, const std::string& body) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n<style>{}</style>\n"
      "</head>\n<body>\n{}</body>\n</html>\n",
      escaped(title), kStyle, body);
}

std::string paragraph(const std::string& text, const std::string& kind) {
  return fmt::format("<p{}>{}</p>\n", kind.empty() ? "" : fmt::format(" class=\"{}\"", kind), escaped(text));
}

std::string figure(const Figure& figure, size_t largest) {
  const std::string picture = figure.svg.size() <= largest ? inlined(figure.svg, figure.name, figure.title)
                                                           : fmt::format("<img src=\"figures/{}.png\" alt=\"{}\">\n",
                                                                         escaped(figure.name), escaped(figure.title));
  return fmt::format("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n", picture, escaped(figure.caption));
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
  const auto cell = [&](const char* tag, size_t column, const std::string& html) {
    return fmt::format("<{0}{1}>{2}</{0}>", tag, is_number(column) ? " class=\"n\"" : "", html);
  };
  std::string out = "<div class=\"scroll\"><table>\n";
  if (std::ranges::any_of(header, [](const std::string& text) { return !text.empty(); })) {
    out += "<thead><tr>";
    for (size_t c = 0; c < header.size(); ++c) out += cell("th", c, escaped(header[c].substr(is_number(c) ? 1 : 0)));
    out += "</tr></thead>\n";
  }
  out += "<tbody>\n";
  for (const Cells& row : rows) {
    out += "<tr>";
    for (size_t c = 0; c < row.size(); ++c) {
      std::string text = escaped(row[c]);
      if (row[c].starts_with('`')) text = "<code>" + text.substr(1) + "</code>";
      if (row[c].starts_with('~')) text = "<s>" + text.substr(1) + "</s>";
      out += cell("td", c, text);
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

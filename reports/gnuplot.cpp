#include "reports/gnuplot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "sim/core/error.hpp"

namespace taut::plot {
namespace {

constexpr double kCharacter = 7.3;  // average width of a character at the base size [px]
constexpr double kSample = 34;      // width of the mark before a line of the legend [px]

/// A round number (1, 2 or 5 times a power of ten) near `step`.
double round_step(double step) {
  const double power = std::pow(10.0, std::floor(std::log10(step)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (factor * power >= 0.75 * step) return factor * power;
  }
  return 10 * power;
}

std::string number(double value) {
  return std::isfinite(value) ? fmt::format("{:.10g}", value) : "NaN";
}

/// Places of tics on a logarithmic axis, and what stands there.
std::vector<std::pair<std::string, double>> logarithmic_tics(const Axis& a) {
  std::vector<std::pair<std::string, double>> tics;
  if (a.high / a.low < 5) {  // too narrow for 1, 2, 5
    for (double tic = std::ceil(a.low / a.step) * a.step; tic <= a.high; tic += a.step)
      tics.emplace_back(fmt::format("{:.6g}", tic), tic);
    return tics;
  }
  const bool wide = a.high / a.low > 300;
  for (double power = std::pow(10.0, std::floor(std::log10(a.low))); power <= a.high; power *= 10) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      const double tic = factor * power;
      if (tic < a.low * (1 - 1e-9) || tic > a.high * (1 + 1e-9) || (wide && factor != 1)) continue;
      tics.emplace_back(fmt::format("{:g}", tic), tic);
    }
  }
  return tics;
}

/// Range and tics of one axis.
std::string scale_of(char axis, const Axis& a) {
  const std::string range = fmt::format("set {0}range [{1}:{2}]\n", axis, number(a.low), number(a.high));
  if (a.logarithmic) return range + fmt::format("set logscale {}\n", axis) + named_tics(axis, logarithmic_tics(a));
  const double first = std::ceil(a.low / a.step - 1e-9) * a.step;
  return range + fmt::format("unset logscale {0}\nset {0}tics autofreq {1},{2}\n", axis, number(first), number(a.step));
}

struct Stroke {
  double x0, y0, x1, y1;
};

/// Lines of a legend's mark of this width, from its left end [px].
std::vector<Stroke> strokes_of(LegendEntry::Kind kind, double width) {
  const double middle = width / 2;
  switch (kind) {
    case LegendEntry::line:
    case LegendEntry::dashes:
      return {{0, 0, width, 0}};
    case LegendEntry::bar_along_x:
      return {{0, 0, width, 0}, {0, -4, 0, 4}, {width, -4, width, 4}};
    case LegendEntry::bar_along_y:
      return {{middle, -7, middle, 7}, {middle - 4, -7, middle + 4, -7}, {middle - 4, 7, middle + 4, 7}};
    case LegendEntry::hatch: {
      std::vector<Stroke> strokes = {{0, 4, width, 4}};
      for (double x = 4; x < width; x += 6) strokes.push_back({x, 4, x - 5, -5});
      return strokes;
    }
    default:
      return {};
  }
}

bool has_mark(const LegendEntry& entry) {
  return entry.kind != LegendEntry::heading && entry.kind != LegendEntry::text;
}

}  // namespace

std::string colour(size_t i) {
  static const std::array<const char*, 7> okabe_ito = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                       "#56b4e9", "#e69f00", "#000000"};
  return okabe_ito[i % okabe_ito.size()];
}

std::string ordered_colour(size_t i, size_t count) {
  static const std::array<std::array<double, 3>, 5> viridis = {
      {{122, 209, 81}, {34, 168, 132}, {42, 120, 142}, {65, 68, 135}, {68, 1, 84}}};
  const double place = count < 2 ? 2.0 : 4.0 * static_cast<double>(i) / static_cast<double>(count - 1);
  const size_t k = std::min<size_t>(static_cast<size_t>(place), 3);
  const double t = place - static_cast<double>(k);
  std::string text = "#";
  for (size_t c = 0; c < 3; ++c) {
    text += fmt::format("{:02x}", static_cast<int>(std::lround((1 - t) * viridis[k][c] + t * viridis[k + 1][c])));
  }
  return text;
}

std::string region_colour(std::string_view name, size_t i) {
  static const std::array<const char*, 4> others = {"#cfe3c4", "#e3c9dc", "#d9d4cc", "#c9dfe8"};
  return name == "foam" ? "#f7dfa4" : name == "plastic" ? "#9db8cc" : others[i % others.size()];
}

int symbol(size_t i) {
  // circle, square, triangle, diamond, inverted triangle, pentagon, plus, cross, star
  static const std::array<int, 9> symbols = {6, 4, 8, 12, 10, 14, 1, 2, 3};
  return symbols[i % symbols.size()];
}

std::string literal(std::string_view text) {
  std::string out = "'";
  for (const char c : text)
    out += c == '\'' ? std::string("''") : std::string(1, static_cast<unsigned char>(c) < 0x20 ? ' ' : c);
  return out + "'";
}

size_t length_of(std::string_view utf8) {
  return static_cast<size_t>(std::ranges::count_if(utf8, [](char c) { return (c & 0xC0) != 0x80; }));
}

std::string shortened(const std::string& text, size_t length) {
  if (length_of(text) <= length) return text;
  size_t bytes = 0;
  for (size_t characters = 0; bytes < text.size(); ++bytes) {
    if ((text[bytes] & 0xC0) != 0x80 && ++characters == length) break;
  }
  return text.substr(0, bytes) + "…";
}

std::string plotted(const std::string& block, const std::string& style, const std::string& colour,
                    const std::string& columns) {
  return fmt::format("{} using {} with {} {} rgb '{}'", block, columns, style,
                     style.starts_with("filledcurves") ? "fc" : "lc", colour);
}

std::string named_tics(char axis, const std::vector<std::pair<std::string, double>>& names) {
  std::string text;
  for (const auto& [name, place] : names)
    text += fmt::format("{}{} {}", text.empty() ? "" : ", ", literal(name), number(place));
  return fmt::format("set {}tics ({})\n", axis, text);
}

std::string horizontal_line(double y, const std::string& colour, const std::string& more) {
  return fmt::format("set arrow from graph 0, {0} to graph 1, {0} nohead lw 1.5 {1}lc rgb '{2}'\n", first(y), more,
                     colour);
}

std::string vertical_line(double x, const std::string& colour, const std::string& more) {
  return fmt::format("set arrow from {0}, graph 0 to {0}, graph 1 nohead lw 1.5 {1}lc rgb '{2}'\n", first(x), more,
                     colour);
}

std::string shade(const std::string& from, const std::string& to, const std::string& fill, const std::string& colour) {
  return fmt::format("set object rectangle from {} to {} behind fs {} noborder fc rgb '{}'\n", from, to, fill, colour);
}

std::string first(double value) {
  return fmt::format("first {:.10g}", value);
}

std::string outer_labels(Axis& x, Axis& y, bool lowest, bool leftmost) {
  if (!lowest) x.label.clear();
  if (!leftmost) y.label.clear();
  return fmt::format("set format x '{}'\nset format y '{}'\n", lowest ? "%g" : "", leftmost ? "%g" : "");
}

Axis axis_over(std::vector<double> values, std::string label, int tics, bool with_zero) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  const bool at_zero = std::ranges::find(values, 0.0) != values.end();  // something to see there: leave room around it
  if (with_zero) values.push_back(0);
  Axis axis{std::move(label)};
  if (values.empty()) return axis;
  const auto [low, high] = std::ranges::minmax(values);
  double span = high - low;
  const double size = std::max(std::abs(low), std::abs(high));
  if (span <= 1e-6 * size) span = size > 0 ? 0.2 * size : 1;
  const double room = 0.06 * span;
  axis.low = with_zero && low == 0 && !at_zero ? 0 : std::min(low, high - span / 2) - room;
  axis.high = with_zero && high == 0 && !at_zero ? 0 : std::max(high, low + span / 2) + room;
  if (axis.high <= axis.low) axis.high = axis.low + 1;
  axis.step = round_step((axis.high - axis.low) / std::max(tics, 1));
  return axis;
}

Axis logarithmic_axis_over(const std::vector<double>& values, std::string label) {
  Axis axis{std::move(label), 1, 10, 0.2, true};
  double low = 0, high = 0;
  for (const double value : values) {
    if (!std::isfinite(value) || value <= 0) continue;
    low = low == 0 ? value : std::min(low, value);
    high = std::max(high, value);
  }
  if (low > 0) {
    axis.low = low / 1.2;
    axis.high = high * 1.2;
    axis.step = round_step((axis.high - axis.low) / 6);
  }
  return axis;
}

double to_one_scale(Axis& x, Axis& y, double across, double least, double most) {
  const double tall = std::clamp(across * (y.high - y.low) / (x.high - x.low), least, most);
  const double scale = std::max((x.high - x.low) / across, (y.high - y.low) / tall);
  for (const auto& [axis, pixels] : {std::pair(&x, across), std::pair(&y, tall)}) {
    const double middle = (axis->low + axis->high) / 2;
    axis->low = middle - scale * pixels / 2;
    axis->high = middle + scale * pixels / 2;
  }
  return tall;
}

double legend_width(const std::vector<LegendEntry>& entries, double limit) {
  double width = 90;
  for (const LegendEntry& entry : entries) {
    width = std::max(width, (has_mark(entry) ? kSample : 0) + kCharacter * static_cast<double>(length_of(entry.label)));
  }
  return std::min(width, limit);
}

Page::Page(double width, double height, const std::string& title, const std::string& subtitle, bool simulated)
    : width_(width), height_(height) {
  marks_ += fmt::format("set label {} at screen {} font ',16' tc rgb '{}'\n", literal(title), screen(16, height - 22),
                        kBlack);
  marks_ += fmt::format("set label {} at screen {} font ',12' tc rgb '{}'\n",
                        literal(shortened(subtitle, static_cast<size_t>((width - 30) / kCharacter))),
                        screen(16, height - 44), kGrey);
  if (simulated) {
    marks_ += fmt::format("set label 'SIMULATED DATA' at screen {} right font ',16' tc rgb '#d55e00'\n",
                          screen(width - 16, height - 22));
  }
}

std::string Page::screen(double x, double y) const {
  return fmt::format("{:.5f},{:.5f}", x / width_, y / height_);
}

std::string Page::data(const Rows& rows) {
  const std::string name = fmt::format("$d{}", ++block_count_);
  blocks_ += name + " << END\n";
  for (const std::vector<double>& row : rows) {
    for (size_t i = 0; i < row.size(); ++i) blocks_ += (i == 0 ? "" : " ") + number(row[i]);
    blocks_ += '\n';  // an empty row separates lines
  }
  blocks_ += "END\n";
  return name;
}

void Page::add(Plots& plots, const Rows& rows, const std::string& style, const std::string& colour,
               const std::string& columns) {
  if (!rows.empty()) plots.push_back(plotted(data(rows), style, colour, columns));
}

void Page::mark(const LegendEntry& entry, double left, double y) {
  constexpr double width = kSample - 10;
  for (const Stroke& s : strokes_of(entry.kind, width)) {
    marks_ +=
        fmt::format("set arrow from screen {} to screen {} nohead lw 2 lc rgb '{}' {}\n", screen(left + s.x0, y + s.y0),
                    screen(left + s.x1, y + s.y1), entry.colour, entry.kind == LegendEntry::dashes ? "dt (6,4)" : "");
  }
  if (entry.kind == LegendEntry::band || entry.kind == LegendEntry::area) {
    const std::string fill = entry.kind == LegendEntry::band ? "transparent solid 0.25 noborder"
                                                             : fmt::format("solid 1 border lc rgb '{}'", kBlack);
    marks_ += fmt::format("set object rectangle from screen {} to screen {} fs {} fc rgb '{}'\n", screen(left, y - 6),
                          screen(left + width, y + 6), fill, entry.colour);
  } else if (entry.kind == LegendEntry::arrow) {
    marks_ +=
        fmt::format("set arrow from screen {} to screen {} head filled size screen {:.5f},18 lw 2.5 lc rgb '{}'\n",
                    screen(left, y), screen(left + width, y), 10 / width_, entry.colour);
  } else if (entry.kind == LegendEntry::point) {
    marks_ += fmt::format("set label '' at screen {} point pt {} ps 0.9 lw 1.4 lc rgb '{}'\n",
                          screen(left + width / 2, y), entry.symbol, entry.colour);
  }
}

void Page::legend(double left, double top, const std::vector<LegendEntry>& entries) {
  const size_t longest = static_cast<size_t>((width_ - left - kSample) / kCharacter);
  double y = top;
  for (const LegendEntry& entry : entries) {
    if (entry.kind == LegendEntry::heading && y != top) y -= 0.5 * kLegendRow;
    mark(entry, left, y);
    marks_ += fmt::format("set label {} at screen {} font ',12' tc rgb '{}'\n",
                          literal(shortened(entry.label, longest + (has_mark(entry) ? 0 : 4))),
                          screen(has_mark(entry) ? left + kSample : left, y),
                          entry.kind == LegendEntry::heading ? kBlack : kGrey);
    y -= kLegendRow;
  }
}

void Page::panel(const Box& box, const Axis& x, const Axis& y, const std::string& title, Plots plots,
                 const std::string& extra) {
  if (plots.empty()) plots.push_back("NaN");
  panels_ += fmt::format("set lmargin at screen {:.5f}\nset rmargin at screen {:.5f}\n", box.left / width_,
                         box.right / width_);
  panels_ += fmt::format("set bmargin at screen {:.5f}\nset tmargin at screen {:.5f}\n", box.bottom / height_,
                         box.top / height_);
  panels_ += scale_of('x', x) + scale_of('y', y);
  panels_ += fmt::format("set xlabel {}\nset ylabel {}\n", literal(x.label), literal(y.label));
  panels_ += fmt::format("set label {} at screen {} font ',13' tc rgb '{}'\n", literal(title),
                         screen(box.left, box.top + 12), kBlack);
  panels_ += extra + "plot ";
  for (size_t i = 0; i < plots.size(); ++i) {
    panels_ += fmt::format("{}{} notitle", i == 0 ? "" : ", \\\n  ", plots[i]);
  }
  panels_ += "\nunset label\nunset arrow\nunset object\n";
}

std::string Page::script(const std::string& name) const {
  std::string text = fmt::format(
      "# Draws {0}.svg, {0}.pdf and {0}.png into the current folder: gnuplot {0}.gp\n"
      "# The numbers are those of {0}.csv.\nset encoding utf8\n",
      name);
  text += blocks_;
  text += "do for [format in 'svg pdf png'] {\nreset\n";
  text += fmt::format(
      "if (format eq 'svg') {{ set terminal svg size {0},{1} font 'sans-serif,13' noenhanced background 'white' }}\n"
      "if (format eq 'pdf') {{ set terminal pdfcairo size {2}in,{3}in font 'Sans,13' fontscale 0.56 noenhanced "
      "background 'white' }}\n"
      "if (format eq 'png') {{ set terminal pngcairo size {4},{5} font 'Sans,13' fontscale 1.13 linewidth 1.5 "
      "pointscale 1.5 noenhanced background 'white' }}\n",
      width_, height_, width_ / 96, height_ / 96, std::lround(1.5 * width_), std::lround(1.5 * height_));
  text += fmt::format("set output '{}.'.format\n", name);
  text +=
      "set border 3 lc rgb '#6b6b6b'\nset tics nomirror out scale 0.6\nset grid lc rgb '#dddddd' lw 1 dt solid\n"
      "set style fill transparent solid 0.22 noborder\nset format '%g'\nset errorbars 0.7\nset pointintervalbox "
      "0\nunset key\n"
      "set xlabel offset 0,0.2\nset ylabel offset -0.6,0\nset multiplot\n";
  text += marks_ + panels_;
  return text + "unset multiplot\nset output\n}\n";
}

}  // namespace taut::plot

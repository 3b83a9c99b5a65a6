#include "reports/gnuplot.hpp"

#include <fmt/format.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "sim/core/error.hpp"

namespace taut::plot {
namespace {

constexpr double kCharacter = 7.3;  // average width of a character at the base size [px]
constexpr double kRow = 19;         // height of a line of the legend [px]
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

/// "set xtics ..." for one axis.
std::string tics(char axis, const Axis& a) {
  std::string text = fmt::format("set {0}range [{1}:{2}]\n", axis, number(a.low), number(a.high));
  if (!a.logarithmic) {
    const double first = std::ceil(a.low / a.step - 1e-9) * a.step;
    return text +
           fmt::format("unset logscale {0}\nset {0}tics autofreq {1},{2}\n", axis, number(first), number(a.step));
  }
  text += fmt::format("set logscale {0}\nset {0}tics (", axis);
  const bool wide = a.high / a.low > 300;
  bool any = false;
  if (a.high / a.low < 5) {  // too narrow for 1, 2, 5
    for (double tic = std::ceil(a.low / a.step) * a.step; tic <= a.high; tic += a.step) {
      text += fmt::format("{}'{:.6g}' {}", any ? ", " : "", tic, number(tic));
      any = true;
    }
    return text + ")\n";
  }
  for (double power = std::pow(10.0, std::floor(std::log10(a.low))); power <= a.high; power *= 10) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      const double tic = factor * power;
      if (tic < a.low * (1 - 1e-9) || tic > a.high * (1 + 1e-9) || (wide && factor != 1)) continue;
      text += fmt::format("{}'{:g}' {}", any ? ", " : "", tic, number(tic));
      any = true;
    }
  }
  return text + ")\n";
}

std::string shell_quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : text) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return out + "'";
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
  for (const char c : text) {
    if (c == '\'') {
      out += "''";
    } else {
      out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
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
  }
  return axis;
}

double legend_width(const std::vector<LegendEntry>& entries, double limit) {
  double width = 90;
  for (const LegendEntry& entry : entries) {
    const double sample = entry.kind == LegendEntry::heading || entry.kind == LegendEntry::text ? 0 : kSample;
    width = std::max(width, sample + kCharacter * static_cast<double>(length_of(entry.label)));
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

std::string Page::data(const std::vector<std::vector<double>>& rows) {
  const std::string name = fmt::format("$d{}", ++block_count_);
  blocks_ += name + " << END\n";
  for (const std::vector<double>& row : rows) {
    for (size_t i = 0; i < row.size(); ++i) blocks_ += (i == 0 ? "" : " ") + number(row[i]);
    blocks_ += '\n';  // an empty row separates lines
  }
  blocks_ += "END\n";
  return name;
}

void Page::legend(double left, double top, const std::vector<LegendEntry>& entries) {
  const size_t longest = static_cast<size_t>((width_ - left - kSample) / kCharacter);
  double y = top;
  for (const LegendEntry& entry : entries) {
    const bool marked = entry.kind != LegendEntry::heading && entry.kind != LegendEntry::text;
    if (entry.kind == LegendEntry::heading && y != top) y -= 0.5 * kRow;
    const double x0 = left, x1 = left + kSample - 10, middle = (x0 + x1) / 2;
    const auto arrow = [&](double ax, double ay, double bx, double by, const char* more) {
      marks_ += fmt::format("set arrow from screen {} to screen {} nohead lw 2 lc rgb '{}' {}\n", screen(ax, ay),
                            screen(bx, by), entry.colour, more);
    };
    switch (entry.kind) {
      case LegendEntry::heading:
      case LegendEntry::text:
        break;
      case LegendEntry::line:
        arrow(x0, y, x1, y, "");
        break;
      case LegendEntry::dashes:
        arrow(x0, y, x1, y, "dt (6,4)");
        break;
      case LegendEntry::band:
        marks_ += fmt::format(
            "set object rectangle from screen {} to screen {} fs transparent solid 0.25 noborder fc rgb '{}'\n",
            screen(x0, y - 6), screen(x1, y + 6), entry.colour);
        break;
      case LegendEntry::area:
        marks_ +=
            fmt::format("set object rectangle from screen {} to screen {} fs solid 1 border lc rgb '{}' fc rgb '{}'\n",
                        screen(x0, y - 6), screen(x1, y + 6), kBlack, entry.colour);
        break;
      case LegendEntry::hatch:
        arrow(x0, y + 4, x1, y + 4, "");
        for (double x = x0 + 4; x < x1; x += 6) arrow(x, y + 4, x - 5, y - 5, "");
        break;
      case LegendEntry::arrow:
        marks_ +=
            fmt::format("set arrow from screen {} to screen {} head filled size screen {:.5f},18 lw 2.5 lc rgb '{}'\n",
                        screen(x0, y), screen(x1, y), 10 / width_, entry.colour);
        break;
      case LegendEntry::point:
        marks_ += fmt::format("set label '' at screen {} point pt {} ps 0.9 lw 1.4 lc rgb '{}'\n", screen(middle, y),
                              entry.symbol, entry.colour);
        break;
      case LegendEntry::bar_along_x:
        arrow(x0, y, x1, y, "");
        arrow(x0, y - 4, x0, y + 4, "");
        arrow(x1, y - 4, x1, y + 4, "");
        break;
      case LegendEntry::bar_along_y:
        arrow(middle, y - 7, middle, y + 7, "");
        arrow(middle - 4, y - 7, middle + 4, y - 7, "");
        arrow(middle - 4, y + 7, middle + 4, y + 7, "");
        break;
    }
    marks_ +=
        fmt::format("set label {} at screen {} font ',12' tc rgb '{}'\n",
                    literal(shortened(entry.label, longest + (marked ? 0 : 4))),
                    screen(marked ? left + kSample : left, y), entry.kind == LegendEntry::heading ? kBlack : kGrey);
    y -= kRow;
  }
}

void Page::panel(const Box& box, const Axis& x, const Axis& y, const std::string& title, std::vector<std::string> plots,
                 const std::string& extra) {
  if (plots.empty()) plots.push_back("NaN");
  panels_ += fmt::format("set lmargin at screen {:.5f}\nset rmargin at screen {:.5f}\n", box.left / width_,
                         box.right / width_);
  panels_ += fmt::format("set bmargin at screen {:.5f}\nset tmargin at screen {:.5f}\n", box.bottom / height_,
                         box.top / height_);
  panels_ += tics('x', x) + tics('y', y);
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

void run_gnuplot(const std::string& folder, const std::string& name) {
  const std::string script = (std::filesystem::path(folder) / (name + ".gp")).string();
  const std::string command =
      fmt::format("CDPATH= cd -- {} && gnuplot -d {} 2>&1", shell_quoted(folder), shell_quoted(name + ".gp"));
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) throw InputError(fmt::format("{}: gnuplot could not be started; free some memory", script));
  std::string output;
  std::array<char, 4096> block{};
  while (const size_t n = fread(block.data(), 1, block.size(), pipe)) output.append(block.data(), n);
  const int status = pclose(pipe);
  if (WIFEXITED(status) && WEXITSTATUS(status) == 127) {
    throw InputError(
        "gnuplot was not found, and it draws the figures; install it (Debian and Ubuntu: apt-get install gnuplot-nox) "
        "and run 'taut report' on the run folder, the fit itself is safe");
  }
  bool complete = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  for (const char* format : {".svg", ".pdf", ".png"}) {
    std::error_code error;
    const auto size = std::filesystem::file_size(std::filesystem::path(folder) / (name + format), error);
    complete = complete && !error && size > 0;
  }
  if (complete) return;
  // gnuplot's own sentence is the line that names the script.
  std::string reason = "no message";
  const size_t at = output.find(".gp\" line");
  if (at != std::string::npos) {
    const size_t begin = output.rfind('\n', at) == std::string::npos ? 0 : output.rfind('\n', at) + 1;
    reason = output.substr(begin, output.find('\n', at) - begin);
  } else if (!output.empty()) {
    reason = output.substr(0, output.find('\n'));
  }
  throw InputError(
      fmt::format("{}: gnuplot failed ({}); it needs its svg, pdfcairo and pngcairo terminals (Debian and Ubuntu: "
                  "apt-get install gnuplot-nox), then run 'taut report' on the run folder",
                  script, shortened(reason, 160)));
}

}  // namespace taut::plot

#include "experiments/cli/topics.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <regex>
#include <sstream>
#include <stdexcept>

#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr std::string_view experiments = "experiments/README.md";

bool is_key(std::string_view line) {
  return line.starts_with("**`");
}

/// Number of # of a heading; 0: it is none.
size_t level_of(std::string_view line) {
  const size_t level = std::min(line.find_first_not_of('#'), line.size());
  return level < line.size() && line[level] == ' ' ? level : 0;
}

std::vector<std::string> lines_of(const Topic& topic) {
  std::istringstream document{std::string(documents().at(topic.document))};
  std::vector<std::string> lines;
  for (std::string line; std::getline(document, line);) {
    if (lines.empty()) {
      if (!line.starts_with(topic.begin)) continue;
    } else {
      const size_t level = level_of(line), own = level_of(lines.front());
      if ((level > 0 && (own == 0 || level <= own)) || (own == 0 && is_key(line))) break;
    }
    lines.push_back(line);
  }
  if (lines.empty()) throw std::logic_error(fmt::format("{} has no part '{}'", topic.document, topic.begin));
  return lines;
}

/// Text without pictures, and with what links, code and emphasis are around.
std::string plain(std::string_view markdown) {
  static const std::regex picture(R"(!\[[^\]]*\]\([^)]*\))"), link(R"(\[([^\]`]+)\]\([^)]*\))"), mark(R"(\*\*|`)");
  std::string text = std::regex_replace(std::string(trimmed(markdown)), picture, "");
  return std::regex_replace(std::regex_replace(text, link, "$1"), mark, "");
}

std::vector<std::string> cells_of(std::string_view line) {
  std::vector<std::string> cells;
  for (size_t begin = 1, end; (end = line.find('|', begin)) != std::string_view::npos; begin = end + 1)
    cells.push_back(plain(line.substr(begin, end - begin)));
  return cells;
}

/// Widths of columns that fit into `width`: the widest ones give way, down to their longest word.
std::vector<size_t> column_widths(const std::vector<std::vector<std::string>>& rows, size_t width) {
  std::vector<size_t> widths(rows.front().size(), 1), least = widths;
  for (const std::vector<std::string>& row : rows) {
    for (size_t i = 0; i < std::min(row.size(), widths.size()); ++i) {
      widths[i] = std::max(widths[i], row[i].size());
      for (const std::string& word : wrapped(row[i], 1)) least[i] = std::max(least[i], word.size());
    }
  }
  const size_t gaps = 2 * (widths.size() - 1);
  while (std::accumulate(widths.begin(), widths.end(), gaps) > width) {
    size_t widest = widths.size();
    for (size_t i = 0; i < widths.size(); ++i) {
      if (widths[i] > least[i] && (widest == widths.size() || widths[i] > widths[widest])) widest = i;
    }
    if (widest == widths.size()) break;
    --widths[widest];
  }
  return widths;
}

std::string table_text(const std::vector<std::vector<std::string>>& rows, size_t width) {
  const std::vector<size_t> widths = column_widths(rows, width);
  std::string text;
  for (const std::vector<std::string>& row : rows) {
    std::vector<std::vector<std::string>> cells;
    size_t height = 1;
    for (size_t i = 0; i < widths.size(); ++i) {
      cells.push_back(i < row.size() ? wrapped(row[i], widths[i]) : std::vector<std::string>{});
      height = std::max(height, cells.back().size());
    }
    for (size_t k = 0; k < height; ++k) {
      std::string line;
      for (size_t i = 0; i < widths.size(); ++i)
        line += fmt::format("{:<{}}  ", k < cells[i].size() ? cells[i][k] : "", widths[i]);
      text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
    }
    if (&row == &rows.front())
      text += std::string(std::accumulate(widths.begin(), widths.end(), 2 * (widths.size() - 1)), '-') + "\n";
  }
  return text;
}

}  // namespace

const std::vector<Topic>& all_topics() {
  static const std::vector<Topic> all{
      {"scope", "what taut models and what not", "README.md", "## What it models"},
      {"start", "how to begin, and benches without readings", experiments, "## A start"},
      {"experiment-file", "tables and keys of an experiment", experiments, "## The experiment file"},
      {"simulation-file", "tables and keys of a simulation", experiments, "## Simulations"},
      {"trajectory-optimisation", "controls over time that reach goals", experiments, "### Trajectory optimisation"},
      {"material-points", "stress-strain curves without a mesh", experiments, "## Material points"},
      {"units", "how quantities are written", experiments, "## Units"},
      {"channels", "what a bench may measure", experiments, "**`[[channel]]`**"},
      {"push-puppet", "dimensions of the module", experiments, "## The push-puppet module"},
      {"finger", "dimensions of the finger", experiments, "## The finger"},
      {"twist", "dimensions of the twisting module", experiments, "## The twisting module"},
      {"sheet", "dimensions of the sheet", experiments, "## The sheet"},
      {"charts", "what `taut chart` draws", experiments, "## Charts"},
      {"run-folder", "what a run writes, and how it goes on", experiments, "## The run folder"},
      {"tuning", "the retraction for a wanted stiffness", experiments, "## Tuning"},
      {"planning", "which rows to measure next", experiments, "## Planning"},
      {"ensembles", "posterior, bootstrap, other starts; on several machines", experiments, "## Ensembles"},
      {"scoring", "any simulator's predictions against a rig", experiments, "## Scoring simulators"},
      {"exporting", "a module for other simulators", experiments, "## Exporting"},
      {"comparing-runs", "two calibrations, or one done again", experiments, "## Comparing runs"},
      {"python", "the Python package", experiments, "## Python"},
      {"exit-codes", "what the command returns", experiments, "## Exit codes"},
      {"verdicts", "how well the readings determine a parameter", experiments, "## Verdicts"},
      {"intervals", "what an interval counts", experiments, "## Intervals"},
      {"misfit", "what would explain one", experiments, "## What would explain a misfit"},
      {"glossary", "words of our own", "CONTRIBUTING.md", "## Words of the house"},
  };
  return all;
}

std::vector<Block> blocks_of(const Topic& topic) {
  std::vector<Block> blocks;
  bool goes_on = false;  // a paragraph or item does so until a blank line or something else
  for (const std::string& line : lines_of(topic)) {
    const bool table = line.starts_with('|');
    if (trimmed(line).empty()) {
      goes_on = false;
    } else if (table) {
      if (blocks.empty() || blocks.back().kind != Block::table || !goes_on) blocks.push_back({Block::table, "", {}});
      goes_on = true;
      if (line.find_first_not_of("|-: ") != std::string::npos) blocks.back().rows.push_back(cells_of(line));
    } else if (line.starts_with("    ") && !goes_on) {
      blocks.push_back({Block::code, line.substr(4)});
    } else if (const size_t level = level_of(line); level > 0) {
      blocks.push_back({Block::heading, plain(line.substr(level))});
    } else if (goes_on && !is_key(line) && !line.starts_with("- ")) {
      blocks.back().text += " " + std::string(trimmed(line));
    } else {
      goes_on = true;
      blocks.push_back(line.starts_with("- ") ? Block{Block::item, line.substr(2)} : Block{Block::paragraph, line});
    }
  }
  for (Block& block : blocks) {
    if (block.kind == Block::paragraph || block.kind == Block::item) block.text = plain(block.text);
  }
  std::erase_if(blocks, [](const Block& block) { return block.kind == Block::paragraph && block.text.empty(); });
  return blocks;
}

std::vector<std::string> wrapped(std::string_view text, size_t width) {
  std::vector<std::string> lines;
  std::istringstream words{std::string(text)};
  for (std::string word; words >> word;) {
    if (lines.empty() || lines.back().size() + 1 + word.size() > width)
      lines.push_back(word);
    else
      lines.back() += " " + word;
  }
  return lines;
}

std::string as_text(const std::vector<Block>& blocks, size_t width) {
  std::string text;
  for (size_t i = 0; i < blocks.size(); ++i) {
    const Block& block = blocks[i];
    const bool close =
        i > 0 && block.kind == blocks[i - 1].kind && (block.kind == Block::item || block.kind == Block::code);
    if (i > 0 && !close) text += "\n";
    switch (block.kind) {
      case Block::heading:
        text += block.text + "\n" + std::string(block.text.size(), '=') + "\n";
        break;
      case Block::paragraph:
        text += join(wrapped(block.text, width), "\n") + "\n";
        break;
      case Block::item:
        text += "- " + join(wrapped(block.text, width - 2), "\n  ") + "\n";
        break;
      case Block::code:
        text += "    " + block.text + "\n";
        break;
      case Block::table:
        text += table_text(block.rows, width);
        break;
    }
  }
  return text;
}

}  // namespace taut

#include "experiments/cli/manual.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <sstream>

#include "experiments/cli/commands.hpp"
#include "experiments/cli/topics.hpp"
#include "experiments/cli/version.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// An option as the tables have it.
struct Option {
  std::string name, letter, value, what;  ///< "--quiet", "-q" or "", "DIR" or "", what it does
  bool repeated = false;
};

std::vector<Option> list_options(const Command& command) {
  namespace po = boost::program_options;
  CommandOptions unused;
  const po::options_description table = options_of(command, unused);
  std::vector<Option> list;
  for (const auto& entry : table.options()) {
    const std::string letter = entry->canonical_display_name(po::command_line_style::allow_dash_for_short);
    const bool takes = entry->semantic()->max_tokens() > 0;
    list.push_back({"--" + entry->long_name(), letter.size() == 2 ? letter : "", takes ? entry->format_parameter() : "",
                    entry->description(), entry->semantic()->is_composing()});
  }
  return list;
}

std::vector<std::string> words_of(std::string text, char separator) {
  std::vector<std::string> words;
  std::istringstream stream(text);
  for (std::string word; std::getline(stream, word, separator);) words.push_back(word);
  return words;
}

std::string replaced(std::string text, const std::vector<std::pair<char, std::string_view>>& table) {
  std::string result;
  for (char c : text) {
    const auto found = std::ranges::find(table, c, &std::pair<char, std::string_view>::first);
    result += found == table.end() ? std::string(1, c) : std::string(found->second);
  }
  return result;
}

// ---- man page

/// Text that roff takes as it is.
std::string roff(const std::string& text) {
  return (text.starts_with('.') ? "\\&" : "") + replaced(text, {{'\\', "\\e"},
                                                                {'-', "\\-"},
                                                                {'\'', "\\(aq"},
                                                                {'`', "\\(ga"},
                                                                {'^', "\\(ha"},
                                                                {'~', "\\(ti"},
                                                                {'"', "\\(dq"}});
}

std::string roff_table(const std::vector<std::vector<std::string>>& rows) {
  std::string page;
  for (size_t k = 1; k < rows.size(); ++k) {
    page += ".TP\n.B " + roff(rows[k].front()) + "\n";
    std::vector<std::string> rest;
    for (size_t i = 1; i < rows[k].size(); ++i) {
      if (!rows[k][i].empty()) rest.push_back((i > 1 ? rows.front()[i] + ": " : "") + rows[k][i]);
    }
    page += roff(join(rest, "; ")) + "\n";
  }
  return page;
}

/// The text of a topic, its heading left out.
std::string roff_topic(const std::vector<Block>& blocks) {
  std::string page;
  for (size_t i = 1; i < blocks.size(); ++i) {
    const Block& block = blocks[i];
    switch (block.kind) {
      case Block::heading:
        page += ".SS " + roff(block.text) + "\n";
        break;
      case Block::paragraph:
        page += ".PP\n" + roff(block.text) + "\n";
        break;
      case Block::item:
        page += ".IP \\(bu 2\n" + roff(block.text) + "\n";
        break;
      case Block::code:
        page += ".PP\n.EX\n" + roff(block.text) + "\n.EE\n";
        break;
      case Block::table:
        page += roff_table(block.rows);
        break;
    }
  }
  return page;
}

std::string roff_command(const Command& command) {
  std::string page =
      fmt::format(".SS taut {} {} [options]\n{}\n", command.name, roff(command.arguments), roff(command.summary));
  for (const Option& option : list_options(command)) {
    page += ".TP\n.B " + roff(option.letter.empty() ? option.name : option.letter + ", " + option.name);
    page += (option.value.empty() ? "" : " " + roff(option.value)) + "\n" + roff(option.what) + "\n";
  }
  return page + ".PP\nExamples:\n.PP\n.EX\n" + roff(command.examples) + ".EE\n";
}

const Topic& topic(std::string_view name) {
  return *std::ranges::find(all_topics(), name, &Topic::name);
}

// ---- completion

/// What completes a word of this name: "folder", "toml", "csv", "nothing" or the words that it may be.
std::string filler(const std::string& name, bool of_option) {
  if (name.ends_with("DIR") || name.ends_with("FOLDER")) return "folder";
  if (name.find('|') != std::string::npos) return join(words_of(name, '|'), " ");
  if (!of_option) return "toml";
  return name == "FILE" ? "csv" : "nothing";
}

std::string names_for_help() {
  std::vector<std::string> names;
  for (const Topic& topic : all_topics()) names.push_back(topic.name);
  for (const Command& command : all_commands()) names.push_back(command.name);
  return join(names, " ");
}

/// In single quotes of a shell.
std::string in_quotes(const std::string& text) {
  return "'" + replaced(text, {{'\'', "'\\''"}}) + "'";
}

std::string bash_case(const Command& command) {
  std::string names, values = " ", places;
  for (const Option& option : list_options(command)) {
    names += (names.empty() ? "" : " ") + option.name;
    if (!option.value.empty()) values += option.name + ":" + filler(option.value, true) + " ";
  }
  for (const std::string& argument : words_of(command.arguments, ' '))
    places += " " + in_quotes(filler(argument, false));
  return fmt::format("    {}) options={} values={} places=({}) ;;\n", command.name, in_quotes(names), in_quotes(values),
                     places.substr(1));
}

constexpr std::string_view bash_script = R"(# Completion of taut for bash; made by `taut help bash`.
_taut() {
  local cur=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} options='' values='' kind i place=0
  local -a places=()
  COMPREPLY=()
  [[ $cur == = ]] && cur=''
  [[ $before == = ]] && before=${COMP_WORDS[COMP_CWORD - 2]}
  if ((COMP_CWORD == 1)); then
    COMPREPLY=($(compgen -W '@COMMANDS@ help --help --version' -- "$cur"))
    return
  fi
  case ${COMP_WORDS[1]} in
@CASES@    help) places=('@TOPICS@') ;;
    *) return ;;
  esac
  for ((i = 2; i < COMP_CWORD; ++i)); do  # which of the arguments it is
    if [[ ${COMP_WORDS[i]} != -* ]]; then
      ((++place))
    elif [[ $values == *" ${COMP_WORDS[i]}:"* ]]; then
      [[ ${COMP_WORDS[i + 1]} == = ]] && ((++i))
      ((++i))
    fi
  done
  if [[ $values == *" $before:"* ]]; then
    kind=${values#*" $before:"} kind=${kind%% *}
  elif [[ $cur == -* ]]; then
    kind=$options
  else
    kind=${places[place]}
  fi
  cur=${cur//[\'\"\\]/}
  case $kind in
    nothing | '') ;;
    folder) mapfile -t COMPREPLY < <(compgen -d -- "$cur") ;;
    toml | csv) mapfile -t COMPREPLY < <(compgen -f -X "!*.$kind" -- "$cur"; compgen -d -- "$cur") ;;
    *) COMPREPLY=($(compgen -W "$kind" -- "$cur")) ;;
  esac
  case $kind in folder | toml | csv) compopt -o filenames 2> /dev/null ;; esac
}
complete -F _taut taut
)";

/// ":NAME:what completes it"
std::string zsh_action(const std::string& name, bool of_option) {
  const std::string kind = filler(name, of_option);
  const std::string action = kind == "folder"                  ? "_files -/"
                             : kind == "nothing"               ? " "
                             : kind == "toml" || kind == "csv" ? "_files -g \"*." + kind + "\""
                                                               : "(" + kind + ")";
  return ":" + replaced(name, {{':', "\\:"}}) + ":" + action;
}

std::string zsh_case(const Command& command) {
  std::string text = fmt::format("    {})\n      _arguments", command.name);
  for (const Option& option : list_options(command)) {
    const std::string what = "[" + replaced(option.what, {{'[', "\\["}, {']', "\\]"}}) + "]";
    const std::string value = option.value.empty() ? "" : zsh_action(option.value, true);
    const std::string name = option.value.empty() ? option.name : option.name + "=";
    if (!option.letter.empty()) text += " \\\n        " + in_quotes("(" + option.name + ")" + option.letter + what);
    text += " \\\n        " + in_quotes((option.repeated         ? "*"
                                         : option.letter.empty() ? ""
                                                                 : "(" + option.letter + ")") +
                                        name + what + value);
  }
  const std::vector<std::string> arguments = words_of(command.arguments, ' ');
  for (size_t i = 0; i < arguments.size(); ++i)
    text += " \\\n        " + in_quotes(fmt::format("{}{}", i + 1, zsh_action(arguments[i], false)));
  return text + "\n      ;;\n";
}

constexpr std::string_view zsh_script = R"(#compdef taut
# Completion of taut for zsh; made by `taut help zsh`.
_taut() {
  local -a commands=(@COMMANDS@
  )
  if ((CURRENT == 2)); then
    commands+=('help:what a command or a topic is')
    _describe command commands
    return
  fi
  local command=$words[2]
  shift words
  ((CURRENT--))
  case $command in
@CASES@    help)
      local -a topics=(@TOPICS@
      )
      ((CURRENT == 2)) || return
      _describe topic topics
      _describe command commands
      ;;
  esac
}
_taut "$@"
)";

std::string filled(std::string_view form, const std::string& commands, const std::string& cases,
                   const std::string& topics) {
  std::string text(form);
  for (const auto& [place, content] : {std::pair{"@COMMANDS@", commands}, {"@CASES@", cases}, {"@TOPICS@", topics}})
    text.replace(text.find(place), std::string_view(place).size(), content);
  return text;
}

}  // namespace

std::string man_page() {
  std::string page = fmt::format(".TH TAUT 1 \"\" \"taut {}\" \"User Commands\"\n", roff(version()));
  page += ".SH NAME\ntaut \\- characterisation and calibration of soft\\-rigid robot modules\n.SH SYNOPSIS\n";
  for (const Command& command : all_commands())
    page += fmt::format(".B taut {}\n{} [options]\n.br\n", command.name, roff(command.arguments));
  page += ".B taut help\n[TOPIC]\n.br\n.B taut \\-\\-version\n";
  const std::vector<Block> readme = blocks_of({"", "", "README.md", "# taut"});
  page += ".SH DESCRIPTION\n" + roff(readme.at(1).text) + "\n.SH COMMANDS\n";
  for (const Command& command : all_commands()) page += roff_command(command);
  page += ".SS taut help [TOPIC]\nShows a command's help, or a part of the documentation. Topics:\n";
  for (const Topic& one : all_topics())
    page += fmt::format(".TP\n.B {}\n{}\n", roff(one.name), roff(std::string(one.about)));
  page += ".SH EXIT STATUS\n" + roff_topic(blocks_of(topic("exit-codes")));
  page += ".SH FILES\n" + roff_topic(blocks_of(topic("run-folder")));
  return page + ".SH SEE ALSO\n.BR gnuplot (1)\n";
}

std::string bash_completion() {
  std::vector<std::string> names;
  std::string cases;
  for (const Command& command : all_commands()) {
    names.push_back(command.name);
    cases += bash_case(command);
  }
  return filled(bash_script, join(names, " "), cases, names_for_help());
}

std::string zsh_completion() {
  std::string commands, cases, topics;
  for (const Command& command : all_commands()) {
    commands += "\n    " + in_quotes(command.name + ":" + command.summary);
    cases += zsh_case(command);
  }
  for (const Topic& topic : all_topics())
    topics += "\n        " + in_quotes(topic.name + ":" + std::string(topic.about));
  return filled(zsh_script, commands, cases, topics);
}

}  // namespace taut

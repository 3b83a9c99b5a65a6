#pragma once
#include <string>

// What is made of the tables of commands and options at build time; a new command or option needs nothing here.
namespace taut {

/// The man page taut(1): `taut help man`.
std::string man_page();
/// Completion of command lines: `taut help bash`, `taut help zsh`. What a word may be follows from its name in the
/// usage: a DIR or FOLDER is a folder, "one|other" one of these, another argument a .toml file; an option's FILE is a
/// CSV file.
std::string bash_completion();
std::string zsh_completion();

}  // namespace taut

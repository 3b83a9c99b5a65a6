#include <fcntl.h>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>
#include <optional>
#include <system_error>

#include "experiments/cli/commands.hpp"
#include "experiments/cli/manual.hpp"
#include "experiments/cli/mpi.hpp"
#include "experiments/cli/topics.hpp"
#include "experiments/cli/version.hpp"
#include "reports/report.hpp"
#include "sim/core/error.hpp"
#include "sim/core/text_encoding.hpp"
#include "sim/solve/cholesky.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;

std::atomic<bool> stop_requested{false};

void on_interrupt(int) {
  if (stop_requested.exchange(true)) std::_Exit(exit_interrupted);  // a second Ctrl-C does not wait
}

void print_help(std::ostream& out) {
  out << "taut " << version() << ": characterisation and calibration of soft-rigid robot modules\n\nexamples:\n";
  for (const Command& command : all_commands()) out << command.examples.substr(0, command.examples.find('\n') + 1);
  out << "\ncommands:\n";
  for (const Command& command : all_commands()) out << fmt::format("  {:<8} {}\n", command.name, command.summary);
  out << "\ntopics of `taut help TOPIC`:\n";
  for (const Topic& topic : all_topics()) out << fmt::format("  {:<15} {}\n", topic.name, topic.about);
  out << "\n`taut COMMAND --help` tells a command's options. Data go to stdout, progress to stderr.\n"
         "exit codes: 0 done, 1 internal fault or out of memory, 2 wrong usage or input, 3 a simulation failed, 4 the "
         "fit did not "
         "converge or a search found nothing, 5 what was compared differs, 6 figures could not be drawn (all else is "
         "there), 130 interrupted\n";
}

/// What the words after the command's name ask for; prints the help and returns nullopt where that is asked for.
std::optional<CommandOptions> parse(const Command& command, const std::vector<std::string>& words) {
  CommandOptions options;
  options.stop = &stop_requested;
  options.command_line = "taut " + command.name;
  for (const std::string& word : words)
    options.command_line += word.find(' ') == std::string::npos ? " " + word : " '" + word + "'";
  const po::options_description visible = options_of(command, options);
  po::options_description all;
  std::vector<std::string> given;
  all.add(visible).add_options()("positional", po::value(&given));
  po::positional_options_description places;
  places.add("positional", command.several ? -1 : static_cast<int>(command.positional.size()));
  po::variables_map values;
  po::store(po::command_line_parser(words).options(all).positional(places).run(), values);
  if (values.count("help") != 0) {
    std::cout << command.summary << "\n\nexamples:\n"
              << command.examples << "\nusage: taut " << command.name << " " << command.arguments << " [options]\n\n"
              << visible;
    return std::nullopt;
  }
  po::notify(values);
  for (size_t i = 0; i < given.size(); ++i) {
    if (i < command.positional.size())
      options.*command.positional[i] = given[i];
    else
      options.further.push_back(given[i]);
  }
  if ((options.*command.positional.back()).empty())
    throw InputError(
        fmt::format("taut {0}: {1} is missing; usage: taut {0} {1} [options]", command.name, command.arguments));
  if (options.threads < 0 || options.threads > 1024)
    throw InputError("--threads: a whole number from 1 to 1024 belongs here");
  return options;
}

/// Characters of a line on the terminal; of other outputs 80.
size_t line_width() {
  winsize size{};
  const bool known = ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return known ? std::clamp<size_t>(size.ws_col, 40, 100) : 80;
}

/// What `taut help NAME` shows of a topic or command, or what the build makes of their tables (manual.hpp).
void help_on(const std::string& name) {
  std::vector<std::string> commands, topics;
  for (const Command& command : all_commands()) {
    if (command.name == name) return static_cast<void>(parse(command, {"--help"}));
    commands.push_back(command.name);
  }
  for (const Topic& topic : all_topics()) {
    if (topic.name == name) {
      std::cout << as_text(blocks_of(topic), line_width());
      return;
    }
    topics.push_back(topic.name);
  }
  using Made = std::pair<std::string_view, std::string (*)()>;
  for (const auto& [kind, make] : {Made{"man", man_page}, {"bash", bash_completion}, {"zsh", zsh_completion}}) {
    if (name == kind) {
      std::cout << make();
      return;
    }
  }
  std::vector<std::string> all = topics;
  all.insert(all.end(), commands.begin(), commands.end());
  throw InputError(fmt::format("taut help: '{}' is no topic{}; topics: {}; commands: {}", name, did_you_mean(name, all),
                               join(topics), join(commands)));
}

/// What is left to say when a command has done its work: figures that it could not draw.
int with_figures(int code) {
  const std::string why = undrawn_figures();
  if (why.empty()) return code;
  std::cerr << "taut: " << why << "\n";
  return code == exit_ok ? exit_figures : code;
}

int run(const std::vector<std::string>& arguments) {
  if (arguments.empty() || arguments[0] == "--help" || arguments[0] == "-h" ||
      arguments == std::vector<std::string>{"help"}) {
    print_help(std::cout);
    return arguments.empty() ? exit_input : exit_ok;
  }
  if (arguments[0] == "help") {
    if (arguments.size() > 2) throw InputError("taut help: one topic or command at a time");
    help_on(arguments[1]);
    return exit_ok;
  }
  if (arguments[0] == "--version") {
    std::cout << "taut " << version() << " (" << commit() << ")\n";
    return exit_ok;
  }
  std::vector<std::string> names;
  for (const Command& command : all_commands()) {
    names.push_back(command.name);
    if (command.name != arguments[0]) continue;
    auto options = parse(command, {arguments.begin() + 1, arguments.end()});
    if (!options) return exit_ok;
    if (reserve_blas_buffers(1) < 1) throw std::bad_alloc();
    if ((options->messages = mpi_messages()) != nullptr) {
      if (!command.together)
        throw InputError(fmt::format("taut {}: is the work of one process; start it without mpirun", command.name));
      options->quiet = options->quiet || options->messages->rank() > 0;
    }
    return with_figures(command.run(*options));
  }
  throw InputError(fmt::format("unknown command '{}'{}; commands: {}", arguments[0], did_you_mean(arguments[0], names),
                               join(names)));
}

/// On one line, and without the middle of what is too long to be read: messages quote what files hold, whatever that
/// is.
std::string readable(std::string_view text) {
  constexpr size_t most = 1500, end = 300;
  const std::string message = on_one_line(text);
  if (message.size() <= most) return message;
  return message.substr(0, most - end) + " ... " + message.substr(message.size() - end);
}

int out_of_memory() {
  std::cerr << "taut: out of memory; use a coarser mesh or fewer threads\n";
  return exit_internal;
}

/// What nobody may throw, out of a thread or a destructor; memory that is gone can do that anywhere.
[[noreturn]] void on_terminate() {
  try {
    if (const std::exception_ptr error = std::current_exception()) std::rethrow_exception(error);
    std::fputs("taut: internal fault: ended without a reason\n", stderr);
  } catch (const std::bad_alloc&) {
    std::fputs("taut: out of memory; use a coarser mesh or fewer threads\n", stderr);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "taut: internal fault: %s\n", error.what());
  } catch (...) {
    std::fputs("taut: internal fault of an unknown kind\n", stderr);
  }
  std::_Exit(exit_internal);
}

/// Errors of the system: a stream that takes no more is said by end_output(), a thread that cannot be started is
/// memory.
int system_failure(const std::system_error& error) {
  if (error.code() == std::errc::resource_unavailable_try_again || error.code() == std::errc::not_enough_memory)
    return out_of_memory();
  if (dynamic_cast<const std::filesystem::filesystem_error*>(&error) != nullptr) {
    std::cerr << "taut: " << readable(error.what()) << "\n";
    return exit_input;
  }
  if (std::ferror(stdout) == 0) std::cerr << "taut: the system refuses something: " << error.what() << "\n";
  return exit_input;
}

/// Runs the command and turns what it throws into one sentence and an exit code.
int guarded(const std::vector<std::string>& arguments) {
  try {
    return run(arguments);
  } catch (const InputError& error) {
    std::cerr << "taut: " << readable(error.what()) << "\n";
    return exit_input;
  } catch (const po::error& error) {
    std::cerr << "taut: " << readable(error.what()) << "; `taut --help` tells what is allowed\n";
    return exit_input;
  } catch (const std::bad_alloc&) {
    return out_of_memory();
  } catch (const std::system_error& error) {
    return system_failure(error);
  } catch (const std::exception& error) {
    std::cerr << "taut: internal fault: " << error.what() << "\n";
    return exit_internal;
  }
}

/// Standard streams that the caller closed would be given to the next files that are opened, which then got what is
/// printed. In their place stands a device that takes nothing.
void hold_standard_streams() {
  for (int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(stream, F_GETFD) == -1 && open("/dev/full", stream == STDIN_FILENO ? O_RDONLY : O_WRONLY) == -1)
      std::_Exit(exit_internal);
  }
}

/// Whether all that was printed has arrived. A reader that has seen enough (`taut replay | head`) is no error to tell.
int end_output(int code) {
  std::cout.flush();
  errno = 0;
  const bool lost = std::fflush(stdout) != 0 || std::ferror(stdout) != 0 || !std::cout;
  if (!lost) return code;
  if (errno != EPIPE)
    std::cerr << "taut: what was printed could not be written to standard output; files of the run are complete\n";
  return code == exit_ok ? exit_input : code;
}

}  // namespace
}  // namespace taut

int main(int argc, char** argv) {
  taut::hold_standard_streams();
  for (int signal : {SIGINT, SIGTERM, SIGHUP}) {
    if (std::signal(signal, taut::on_interrupt) == SIG_IGN) std::signal(signal, SIG_IGN);  // nohup asked for that
  }
  std::signal(SIGXFSZ, SIG_IGN);  // a file that may not grow is an error of its write
  std::signal(SIGPIPE, SIG_IGN);  // a reader that ends early must not end a run
  std::set_terminate(taut::on_terminate);
  taut::use_one_blas_thread();
  return taut::leave_mpi(taut::end_output(taut::guarded({argv + 1, argv + argc})));
}

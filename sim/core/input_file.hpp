#pragma once
#include <string>

namespace taut {

/// Refuses what is no ordinary file before anything is read of it: what is not there, folders, pipes, sockets and
/// devices (which may never end, or wait for ever), files that the kernel makes up (/proc, /sys), and files of more
/// than `most` bytes. Throws InputError with the path.
void check_input_file(const std::string& path, double most = 2e9);

/// All bytes of a file that check_input_file() lets pass; one that grows meanwhile is read up to `most`. InputError.
std::string read_input_file(const std::string& path, double most = 2e9);

}  // namespace taut

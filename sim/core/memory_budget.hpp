#pragma once
#include <string>

namespace taut {

/// Bytes that this process may still take: the least of what the machine has left (MemAvailable), what `ulimit -v`
/// leaves of its address space, and what the memory limits of its control groups leave. Infinite where nothing says so.
double available_memory();

/// "3.2 GB"
std::string in_bytes(double bytes);

/// Throws InputError "WHAT about 40 GB of memory, and 8 GB are free; REMEDY" when these bytes are more than 0.9 of what
/// is free, so that nothing is begun that the machine cannot hold.
void require_memory(double bytes, const std::string& what, const std::string& remedy);

}  // namespace taut

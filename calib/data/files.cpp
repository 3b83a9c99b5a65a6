#include "calib/data/files.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <openssl/evp.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Calls `use` with each piece of a file's content.
template <class Use>
void for_each_block(const std::string& path, Use&& use) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) {
    throw InputError(fmt::format("{}: is a folder, a file is needed; name a file in it", path));
  }
  std::ifstream file(path, std::ios::binary);
  if (!file) throw InputError(fmt::format("{}: cannot be read ({}); check the path", path, std::strerror(errno)));
  char block[1 << 16];
  while (file.read(block, sizeof block) || file.gcount() > 0) use(block, static_cast<size_t>(file.gcount()));
  if (file.bad()) throw InputError(fmt::format("{}: reading failed half-way; check the disk", path));
}

[[noreturn]] void cannot_write(const std::string& path, int error) {
  throw InputError(fmt::format("{}: cannot be written ({}); choose a folder that you may write to and that has room",
                               path, std::strerror(error)));
}

}  // namespace

void write_file(const std::string& path, const std::string& text) {
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  if (!folder.empty()) {
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    if (error) cannot_write(path, error.value());
  }
  static std::atomic<unsigned> count = 0;
  const std::string temporary = fmt::format("{}.{}-{}.tmp", path, getpid(), count++);
  const int file = open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (file < 0) cannot_write(path, errno);
  const auto give_up = [&](int error) {
    unlink(temporary.c_str());
    cannot_write(path, error);
  };
  size_t written = 0;
  int error = 0;
  while (written < text.size() && error == 0) {
    const ssize_t n = write(file, text.data() + written, text.size() - written);
    if (n >= 0) {
      written += static_cast<size_t>(n);
    } else if (errno != EINTR) {
      error = errno;
    }
  }
  if (error == 0 && fsync(file) != 0 && errno != EINVAL) error = errno;  // EINVAL: a file system without fsync
  if (close(file) != 0 && error == 0) error = errno;
  if (error != 0) give_up(error);
  if (std::rename(temporary.c_str(), path.c_str()) != 0) give_up(errno);
}

std::string read_file(const std::string& path) {
  std::string text;
  for_each_block(path, [&](const char* block, size_t size) { text.append(block, size); });
  return text;
}

std::string sha256_of(const std::string& path) {
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), EVP_MD_CTX_free);
  if (!context || EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) != 1) {
    throw std::runtime_error("SHA-256 is not available from OpenSSL");
  }
  for_each_block(path, [&](const char* block, size_t size) { EVP_DigestUpdate(context.get(), block, size); });
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned length = 0;
  EVP_DigestFinal_ex(context.get(), digest, &length);
  std::string text;
  for (unsigned i = 0; i < length; ++i) text += fmt::format("{:02x}", digest[i]);
  return text;
}

}  // namespace taut

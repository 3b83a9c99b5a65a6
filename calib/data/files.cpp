#include "calib/data/files.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <openssl/evp.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"

namespace taut {
namespace {

[[noreturn]] void cannot_write(const std::string& path, int error) {
  throw InputError(fmt::format("{}: cannot be written ({}); choose a folder that you may write to and that has room",
                               path, std::strerror(error)));
}

void make_folder_of(const std::string& path) {
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  std::error_code error;
  if (!folder.empty()) std::filesystem::create_directories(folder, error);
  if (error) cannot_write(path, error.value());
}

/// Writes all of a text and waits until it is on the disk. Returns the error's number, 0: none.
int write_out(int file, const std::string& text) {
  size_t written = 0;
  while (written < text.size()) {
    const ssize_t n = write(file, text.data() + written, text.size() - written);
    if (n < 0 && errno != EINTR) return errno;
    written += static_cast<size_t>(std::max<ssize_t>(n, 0));
  }
  return fsync(file) == 0 || errno == EINVAL ? 0 : errno;  // EINVAL: a file system without fsync
}

/// Where the last whole line of a file ends.
off_t end_of_lines(int file) {
  off_t end = lseek(file, 0, SEEK_END);
  for (char last = 0; end > 0 && pread(file, &last, 1, end - 1) == 1 && last != '\n';) --end;
  return end;
}

}  // namespace

void write_file(const std::string& path, const std::string& text) {
  make_folder_of(path);
  static std::atomic<unsigned> count = 0;
  const std::string temporary = fmt::format("{}.{}-{}.tmp", path, getpid(), count++);
  const int file = open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (file < 0) cannot_write(path, errno);
  const auto give_up = [&](int error) {
    unlink(temporary.c_str());
    cannot_write(path, error);
  };
  int error = write_out(file, text);
  if (close(file) != 0 && error == 0) error = errno;
  if (error != 0) give_up(error);
  if (std::rename(temporary.c_str(), path.c_str()) != 0) give_up(errno);
}

void append_line(const std::string& path, const std::string& header, const std::string& line) {
  make_folder_of(path);
  const int file = open(path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (file < 0) cannot_write(path, errno);
  flock(file, LOCK_EX);  // lasts until the file is closed
  const off_t end = end_of_lines(file);
  int error = ftruncate(file, end) == 0 ? write_out(file, (end == 0 ? header + "\n" : "") + line + "\n") : errno;
  if (error != 0 && ftruncate(file, end) != 0) error = errno;
  close(file);
  if (error != 0) cannot_write(path, error);
}

std::string read_file(const std::string& path) {
  return read_input_file(path);
}

std::string sha256_of(const std::string& path) {
  return sha256_of_text(read_file(path));
}

std::string sha256_of_text(const std::string& text) {
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), EVP_MD_CTX_free);
  if (!context || EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) != 1) {
    throw std::runtime_error("SHA-256 is not available from OpenSSL");
  }
  EVP_DigestUpdate(context.get(), text.data(), text.size());
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned length = 0;
  EVP_DigestFinal_ex(context.get(), digest, &length);
  std::string hex;
  for (unsigned i = 0; i < length; ++i) hex += fmt::format("{:02x}", digest[i]);
  return hex;
}

}  // namespace taut

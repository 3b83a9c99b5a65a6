#include "sim/core/text_encoding.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <string_view>

#include "sim/core/error.hpp"

namespace taut {
namespace {

using namespace std::string_view_literals;

/// Code points of the bytes 0x80 to 0x9F in cp1252; the five that it leaves open are the control characters of Latin-1.
constexpr std::array<char16_t, 32> kWindows = {0x20AC, 0x81,   0x201A, 0x0192, 0x201E, 0x2026, 0x2020, 0x2021,
                                               0x02C6, 0x2030, 0x0160, 0x2039, 0x0152, 0x8D,   0x017D, 0x8F,
                                               0x90,   0x2018, 0x2019, 0x201C, 0x201D, 0x2022, 0x2013, 0x2014,
                                               0x02DC, 0x2122, 0x0161, 0x203A, 0x0153, 0x9D,   0x017E, 0x0178};

void append_cp1252(unsigned char byte, std::string& text) {
  const unsigned code = byte >= 0x80 && byte < 0xA0 ? kWindows[byte - 0x80u] : byte;
  if (code >= 0x800) {
    text += static_cast<char>(0xE0 | (code >> 12));
    text += static_cast<char>(0x80 | ((code >> 6) & 0x3F));
  } else {
    text += static_cast<char>(0xC0 | (code >> 6));
  }
  text += static_cast<char>(0x80 | (code & 0x3F));
}

/// Length of the UTF-8 character that `text` begins with; 0 where it begins with none.
size_t utf8_length(std::string_view text) {
  const auto byte = [&](size_t i) { return i < text.size() ? static_cast<unsigned char>(text[i]) : 0u; };
  const auto follows = [&](size_t i) { return (byte(i) & 0xC0) == 0x80; };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  if (first >= 0xC2 && first < 0xE0) return follows(1) ? 2 : 0;
  if (first >= 0xE0 && first < 0xF0) {
    const bool overlong = first == 0xE0 && byte(1) < 0xA0, surrogate = first == 0xED && byte(1) >= 0xA0;
    return follows(1) && follows(2) && !overlong && !surrogate ? 3 : 0;
  }
  if (first >= 0xF0 && first < 0xF5) {
    const bool overlong = first == 0xF0 && byte(1) < 0x90, beyond = first == 0xF4 && byte(1) >= 0x90;
    return follows(1) && follows(2) && follows(3) && !overlong && !beyond ? 4 : 0;
  }
  return 0;
}

void refuse_what_is_no_text(std::string_view bytes, const std::string& path) {
  const auto refuse = [&](size_t at, std::string_view what, std::string_view remedy) {
    throw InputError(fmt::format("{}, line {}, byte {}: {}; {}", path,
                                 1 + std::ranges::count(bytes.substr(0, at), '\n'), at, what, remedy));
  };
  constexpr auto sheet = "save the sheet as 'CSV UTF-8' and name that file"sv;
  constexpr auto text = "save it as UTF-8 (a table as 'CSV UTF-8')"sv;
  if (bytes.starts_with("PK\x03\x04"sv))
    refuse(0, "this is a zip archive, perhaps a workbook (.xlsx, .ods), and no text", sheet);
  if (bytes.starts_with("\xD0\xCF\x11\xE0"sv)) refuse(0, "this is a workbook of Excel (.xls) and no text", sheet);
  if (bytes.starts_with("\xFF\xFE"sv) || bytes.starts_with("\xFE\xFF"sv)) refuse(0, "this is text in UTF-16", text);
  if (const size_t zero = bytes.find('\0'); zero != std::string_view::npos)
    refuse(zero, "there is a zero byte, so this is UTF-16 or no text at all", text);
}

}  // namespace

std::string DecodedText::remark() const {
  if (cp1252_line == 0) return "";
  return fmt::format("not UTF-8 in line {}: such bytes taken as cp1252 (Windows)", cp1252_line);
}

DecodedText decoded(std::string bytes, const std::string& path) {
  refuse_what_is_no_text(bytes, path);
  DecodedText result;
  const std::string_view all = bytes;
  std::string text;
  int line = 1;
  for (size_t i = 0; i < all.size();) {
    if (all[i] == '\n') ++line;
    if (const size_t length = utf8_length(all.substr(i)); length > 0) {
      text.append(all, i, length);
      i += length;
      continue;
    }
    if (result.cp1252_line == 0) result.cp1252_line = line;
    append_cp1252(static_cast<unsigned char>(all[i++]), text);
  }
  result.text = std::move(text);
  return result;
}

std::string on_one_line(std::string_view text) {
  std::string line;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x20 && byte != 0x7F)
      line += c;
    else
      line += c == '\n' ? "\\n" : c == '\t' ? "\\t" : fmt::format("\\x{:02X}", byte);
  }
  return line;
}

}  // namespace taut

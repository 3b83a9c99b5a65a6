# cmake -DROOT=... -DDOCUMENTS="a.md;b.md" -DHEADER=declares/it.hpp -DFUNCTION=documents -DOUT=documents.cpp -P embed.cmake:
# the texts of files as a table of the program; a document with an absolute path is called by its name alone.
set(code "// Made by cmake/embed.cmake.\n#include \"${HEADER}\"\n\n")
# More than the 65536 characters of which the standard is sure, which GCC and Clang are, too.
string(APPEND code "#pragma GCC diagnostic push\n#pragma GCC diagnostic ignored \"-Woverlength-strings\"\nnamespace taut {\n\n")
string(APPEND code "const std::map<std::string_view, std::string_view>& ${FUNCTION}() {\n")
string(APPEND code "  static const std::map<std::string_view, std::string_view> all{\n")
foreach(document IN LISTS DOCUMENTS)
  cmake_path(ABSOLUTE_PATH document BASE_DIRECTORY ${ROOT} OUTPUT_VARIABLE path)
  if(IS_ABSOLUTE ${document})
    cmake_path(GET document FILENAME document)
  endif()
  file(READ ${path} text)
  string(APPEND code "      {\"${document}\", R\"taut(${text})taut\"},\n")
endforeach()
file(WRITE ${OUT} "${code}  };\n  return all;\n}\n\n}  // namespace taut\n#pragma GCC diagnostic pop\n")

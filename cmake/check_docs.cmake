# cmake -DWARNINGS=... -P check_docs.cmake: fails where Doxygen had a warning that counts (see docs.cmake).
file(STRINGS ${WARNINGS} warnings)
list(FILTER warnings EXCLUDE REGEX "\\(variable\\) of (struct|class) .* is not documented")
list(LENGTH warnings count)
if(count GREATER 0)
  list(JOIN warnings "\n" text)
  message(NOTICE "${text}")
  message(FATAL_ERROR "${count} warnings of Doxygen")
endif()

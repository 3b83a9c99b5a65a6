# `cmake --build build/release --target docs`: HTML pages of the installed headers, in docs/html of the build folder. What has
# no documentation is an error, but for members of plain data: their names and their struct may say all.
find_package(Doxygen QUIET)
if(NOT DOXYGEN_FOUND)
  add_custom_target(docs COMMAND ${CMAKE_COMMAND} -E echo "Doxygen is missing: run `experiments/install docs`, then cmake --preset again"
                         COMMAND ${CMAKE_COMMAND} -E false VERBATIM)
  return()
endif()
set(DOXYGEN_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/docs)
set(DOXYGEN_STRIP_FROM_INC_PATH ${PROJECT_SOURCE_DIR})
set(DOXYGEN_FILE_PATTERNS *.hpp)
set(DOXYGEN_EXCLUDE_PATTERNS */*_of.hpp)  # bodies of templates, which are not installed
set(DOXYGEN_USE_MDFILE_AS_MAINPAGE ${PROJECT_SOURCE_DIR}/CONTRIBUTING.md)
set(DOXYGEN_JAVADOC_AUTOBRIEF YES)
set(DOXYGEN_DISTRIBUTE_GROUP_DOC YES)
set(DOXYGEN_BUILTIN_STL_SUPPORT YES)
set(DOXYGEN_HAVE_DOT NO)
set(DOXYGEN_TOC_INCLUDE_HEADINGS 2)
set(DOXYGEN_WARN_LOGFILE ${PROJECT_BINARY_DIR}/docs_warnings.txt)
set(DOXYGEN_QUIET YES)
doxygen_add_docs(docs CONTRIBUTING.md sim calib reports)
add_custom_command(TARGET docs POST_BUILD VERBATIM
                   COMMAND ${CMAKE_COMMAND} -DWARNINGS=${DOXYGEN_WARN_LOGFILE} -P ${PROJECT_SOURCE_DIR}/cmake/check_docs.cmake)

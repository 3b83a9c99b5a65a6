# The Python package `taut` (TAUT_PYTHON=ON): in the build folder as python/taut, installed where the interpreter looks.
# Debian's Python, to which Debian's NumPy belongs, unless a virtual environment is active or -DPython_EXECUTABLE=... names another.
if(NOT DEFINED Python_EXECUTABLE AND NOT DEFINED ENV{VIRTUAL_ENV} AND NOT DEFINED ENV{CONDA_PREFIX} AND EXISTS /usr/bin/python3)
  set(Python_EXECUTABLE /usr/bin/python3)
endif()
find_package(Python 3.9 REQUIRED COMPONENTS Interpreter Development.Module)
find_package(pybind11 2.10 CONFIG REQUIRED)

set(python_package ${PROJECT_BINARY_DIR}/python/taut)
file(GLOB python_sources CONFIGURE_DEPENDS experiments/python/*.cpp)
pybind11_add_module(_taut MODULE NO_EXTRAS ${python_sources})
target_link_libraries(_taut PRIVATE taut_version taut_reports)
target_compile_options(_taut PRIVATE $<$<CONFIG:Release>:-O1>)
set_target_properties(_taut PROPERTIES LIBRARY_OUTPUT_DIRECTORY ${python_package})

file(GLOB python_files CONFIGURE_DEPENDS experiments/python/src/taut/*)
foreach(file IN LISTS python_files)
  get_filename_component(name ${file} NAME)
  list(APPEND python_copies ${python_package}/${name})
  add_custom_command(OUTPUT ${python_package}/${name} COMMAND ${CMAKE_COMMAND} -E copy ${file} ${python_package}/${name}
                     DEPENDS ${file} VERBATIM)
endforeach()
add_custom_target(taut_python ALL DEPENDS ${python_copies})
add_dependencies(taut_python _taut)

# lib/python3.11/dist-packages is what Debian's Python looks at below /usr/local, site-packages what others do.
execute_process(COMMAND ${Python_EXECUTABLE} -c "import sys, sysconfig
debian = 'deb_system' in sysconfig.get_scheme_names() and sys.prefix == sys.base_prefix
print('lib/python%d.%d/%s-packages' % (*sys.version_info[:2], 'dist' if debian else 'site'))"
                OUTPUT_VARIABLE python_folder OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
set(TAUT_PYTHON_DIR ${python_folder} CACHE STRING "Where the Python package is installed, below the prefix")
install(TARGETS _taut DESTINATION ${TAUT_PYTHON_DIR}/taut COMPONENT python)
install(FILES ${python_files} DESTINATION ${TAUT_PYTHON_DIR}/taut COMPONENT python)

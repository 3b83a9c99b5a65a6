# The Python package `taut` (TAUT_PYTHON=ON): in the build folder as python/taut, installed where the interpreter looks; the
# target `wheel` packs it for this Python on this system (Debian's python3-wheel).
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

# A wheel of the same files. It needs taut's libraries as Debian has them, which its platform tag says as well as one can.
execute_process(COMMAND ${Python_EXECUTABLE} -c "import sys, sysconfig
print('cp%d%d-cp%d%d-' % (*sys.version_info[:2], *sys.version_info[:2]) + sysconfig.get_platform().replace('-', '_').replace('.', '_'))"
                OUTPUT_VARIABLE wheel_tag OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
set(wheel_about ${PROJECT_BINARY_DIR}/wheel_about)
file(WRITE ${wheel_about}/METADATA "Metadata-Version: 2.1
Name: taut
Version: ${PROJECT_VERSION}
Summary: ${PROJECT_DESCRIPTION}
License: MIT
Requires-Python: >=3.9
Requires-Dist: numpy
")
file(WRITE ${wheel_about}/WHEEL "Wheel-Version: 1.0
Generator: taut
Root-Is-Purelib: false
Tag: ${wheel_tag}
")
set(wheel_root ${PROJECT_BINARY_DIR}/wheel_root)
add_custom_target(wheel
                  COMMAND ${CMAKE_COMMAND} -E rm -rf ${wheel_root} ${PROJECT_BINARY_DIR}/taut-${PROJECT_VERSION}-${wheel_tag}.whl
                  COMMAND ${CMAKE_COMMAND} -E copy_directory ${python_package} ${wheel_root}/taut
                  COMMAND ${CMAKE_COMMAND} -E rm -rf ${wheel_root}/taut/__pycache__
                  COMMAND ${CMAKE_COMMAND} -E copy_directory ${wheel_about} ${wheel_root}/taut-${PROJECT_VERSION}.dist-info
                  COMMAND ${Python_EXECUTABLE} -m wheel pack ${wheel_root} --dest-dir ${PROJECT_BINARY_DIR}
                  VERBATIM)
add_dependencies(wheel taut_python)

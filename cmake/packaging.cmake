# What `cmake --install` puts where, and the Debian packages made of it: `taut` (the command) and `libtaut-dev` (archives,
# headers, find_package(taut) and pkg-config).
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/taut)
install(TARGETS taut COMPONENT command)
# Man page and completion, which the command makes of its own tables.
foreach(made man=man/man1/taut.1 bash=bash-completion/completions/taut zsh=zsh/site-functions/_taut)
  string(REGEX MATCH "^(.*)=(.*)/.*$" matched ${made})
  set(kind ${CMAKE_MATCH_1})
  set(folder ${CMAKE_MATCH_2})
  string(REPLACE "${kind}=" share/ file ${made})
  add_custom_command(TARGET taut POST_BUILD BYPRODUCTS ${file} COMMAND ${CMAKE_COMMAND} -E make_directory share/${folder}
                     COMMAND taut help ${kind} > ${file} VERBATIM)
  install(FILES ${PROJECT_BINARY_DIR}/${file} DESTINATION ${CMAKE_INSTALL_DATADIR}/${folder} COMPONENT command)
endforeach()
# Where Debian's zsh looks below /usr; below /usr/local it is site-functions.
install(FILES ${PROJECT_BINARY_DIR}/share/zsh/site-functions/_taut DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/vendor-completions
        COMPONENT command)
add_custom_target(manual ALL DEPENDS ${manual_files})
install(TARGETS taut_sim taut_calib taut_reports EXPORT taut-targets ARCHIVE COMPONENT development)
# Includes start at the root of the sources, so the headers get a root of their own. Those that read TOML stay at home.
foreach(layer sim calib reports)
  install(DIRECTORY ${layer} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/taut COMPONENT development FILES_MATCHING PATTERN "*.hpp"
          PATTERN "*_of.hpp" EXCLUDE)  # bodies of templates, for the sources that instantiate them
  set_target_properties(taut_${layer} PROPERTIES EXPORT_NAME ${layer})
  target_include_directories(taut_${layer} PUBLIC $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/taut>)
endforeach()
install(EXPORT taut-targets NAMESPACE taut:: DESTINATION ${package_dir} COMPONENT development)
configure_package_config_file(cmake/taut-config.cmake.in taut-config.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(taut-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/taut-config.cmake ${PROJECT_BINARY_DIR}/taut-config-version.cmake
        DESTINATION ${package_dir} COMPONENT development)

# For builds without CMake, found from where the .pc file lies. Debian's Ceres, CHOLMOD and SUNDIALS have no .pc files of their own.
file(RELATIVE_PATH TAUT_PC_PREFIX /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
set(TAUT_PC_CFLAGS "-I${CHOLMOD_INCLUDE_DIR}")
set(TAUT_PC_LIBS "-Wl,--push-state,--no-as-needed ${OPENBLAS_LIBRARY} -Wl,--pop-state -lceres -lglog ${CHOLMOD_LIBRARY} -lsundials_cvodes -lsundials_arkode -lsundials_nvecserial -ltomlplusplus -lcrypto -ldl -lpthread")
if(TAUT_GMSH)
  string(APPEND TAUT_PC_LIBS " ${GMSH_LIBRARY}")
endif()
configure_file(cmake/taut.pc.in taut.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/taut.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT development)

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME taut)
set(CPACK_PACKAGE_CONTACT "the taut team")
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_ALL command development)  # the Python package is installed by CMake only
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMMAND_PACKAGE_NAME taut)
set(CPACK_DEBIAN_COMMAND_PACKAGE_SECTION science)
set(CPACK_DEBIAN_COMMAND_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_COMMAND_PACKAGE_DEPENDS "gnuplot-nox | gnuplot, fonts-dejavu-core")
set(CPACK_COMPONENT_COMMAND_DESCRIPTION "${PROJECT_DESCRIPTION}: the command")
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_NAME libtaut-dev)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_DEPENDS
    "libeigen3-dev, libfmt-dev, libtomlplusplus-dev, libceres-dev, libsuitesparse-dev, libopenblas-pthread-dev, libsundials-dev, libssl-dev, libgmsh-dev")
set(CPACK_COMPONENT_DEVELOPMENT_DESCRIPTION "${PROJECT_DESCRIPTION}: libraries and headers")
include(CPack)

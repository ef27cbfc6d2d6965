# The functions with which a CMakeLists.txt has xacro files expanded.

# xacro_add_xacro_file(INPUT [OUTPUT] [INORDER] [REMAP NAME:=VALUE …] [DEPENDS FILE …])
# Sets XACRO_OUTPUT_FILE. Without OUTPUT, it is INPUT without .xacro, in the build folder.
function(xacro_add_xacro_file input)
  cmake_parse_arguments(given "INORDER" "" "REMAP;DEPENDS" ${ARGN})
  get_filename_component(input "${input}" ABSOLUTE)
  set(output ${given_UNPARSED_ARGUMENTS})
  if(NOT output)
    file(RELATIVE_PATH output "${CMAKE_CURRENT_SOURCE_DIR}" "${input}")
    string(REGEX REPLACE "\\.xacro$" "" output "${output}")
  endif()
  get_filename_component(output "${output}" ABSOLUTE BASE_DIR "${CMAKE_CURRENT_BINARY_DIR}")
  get_filename_component(folder "${output}" DIRECTORY)
  file(MAKE_DIRECTORY "${folder}")
  add_custom_command(
    OUTPUT "${output}"
    COMMAND xacro -o "${output}" "${input}" ${given_REMAP}
    DEPENDS "${input}" ${given_DEPENDS}
    WORKING_DIRECTORY "${CMAKE_CURRENT_SOURCE_DIR}")
  set(XACRO_OUTPUT_FILE "${output}" PARENT_SCOPE)
endfunction()

# xacro_install(TARGET FILE … [DESTINATION FOLDER]): FOLDER in share/PACKAGE, also of the devel space.
function(xacro_install target)
  cmake_parse_arguments(given "" "DESTINATION" "" ${ARGN})
  set(files ${given_UNPARSED_ARGUMENTS})
  set(share "${CATKIN_PACKAGE_SHARE_DESTINATION}/${given_DESTINATION}")
  file(MAKE_DIRECTORY "${CATKIN_DEVEL_PREFIX}/${share}")
  add_custom_target("${target}_in_devel" ALL
    COMMAND "${CMAKE_COMMAND}" -E copy_if_different ${files} "${CATKIN_DEVEL_PREFIX}/${share}"
    DEPENDS ${files})
  install(FILES ${files} DESTINATION "${share}")
endfunction()

# xacro_add_files(FILE … [INORDER] [TARGET NAME] [INSTALL [DESTINATION FOLDER]] [REMAP …] [DEPENDS …])
function(xacro_add_files)
  cmake_parse_arguments(given "INORDER;INSTALL" "TARGET;DESTINATION" "REMAP;DEPENDS" ${ARGN})
  foreach(input ${given_UNPARSED_ARGUMENTS})
    xacro_add_xacro_file("${input}" REMAP ${given_REMAP} DEPENDS ${given_DEPENDS})
    list(APPEND outputs "${XACRO_OUTPUT_FILE}")
  endforeach()
  if(NOT given_TARGET)
    set(given_TARGET "${PROJECT_NAME}_xacro_files")
  endif()
  add_custom_target("${given_TARGET}" ALL DEPENDS ${outputs})
  if(given_INSTALL)
    xacro_install("${given_TARGET}" ${outputs} DESTINATION "${given_DESTINATION}")
  endif()
endfunction()

# Run at every build (cmake -P): writes dosui_build_info.f90 anew only when the git hash changed.
# Needs INPUT, OUTPUT, SOURCE_DIR, VERSION, COMPILER, FLAGS, BUILD_TYPE.
execute_process(COMMAND git -C ${SOURCE_DIR} describe --always --dirty --abbrev=12 --exclude *
  OUTPUT_VARIABLE GIT_HASH OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
if(NOT GIT_HASH)
  set(GIT_HASH unknown)
endif()
foreach(name COMPILER FLAGS)   # a Fortran string on lines of at most 60 characters
  string(REPLACE "'" "''" text "${${name}}")
  string(REGEX REPLACE "(............................................................)"
    "\\1'// &\n    '" ${name} "${text}")
endforeach()
configure_file(${INPUT} ${OUTPUT} @ONLY)

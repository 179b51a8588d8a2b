# Target dosui_flags: the compiler's flags for dosui's sources; dosui_test_flags: the same, but a
# warning is no error, because tests may be looser and pFUnit's generated code is not ours.
add_library(dosui_flags INTERFACE)
add_library(dosui_test_flags INTERFACE)

if(CMAKE_Fortran_COMPILER_ID STREQUAL "GNU")
  # Lines only where nobody steps through variables (tests/run.sh): a fifth less to compile.
  option(DOSUI_DEBUG_LINES_ONLY "Debug information tells lines, but no variables" OFF)
  set(CMAKE_Fortran_FLAGS_DEBUG "-g -Og" CACHE STRING "" FORCE)
  if(DOSUI_DEBUG_LINES_ONLY)
    set(CMAKE_Fortran_FLAGS_DEBUG "-g1 -Og" CACHE STRING "" FORCE)
  endif()
  set(CMAKE_Fortran_FLAGS_RELEASE "-O3" CACHE STRING "" FORCE)
  set(checks -fcheck=all,no-array-temps -finit-real=snan -ffpe-trap=invalid,zero,overflow -fbacktrace)
  set(warnings -std=f2008 -Wall -Wextra -Wimplicit-interface)
  target_compile_options(dosui_flags INTERFACE
    $<$<COMPILE_LANGUAGE:Fortran>:-std=f2008 $<$<CONFIG:Debug>:${warnings} ${checks} -Werror>>)
  target_compile_options(dosui_test_flags INTERFACE
    $<$<COMPILE_LANGUAGE:Fortran>:$<$<CONFIG:Debug>:${checks}>>
    # The library is what is tested; its tests compile seven times faster so, and run as fast.
    $<$<COMPILE_LANGUAGE:Fortran>:$<$<CONFIG:Release>:-O0>>)
  if(DOSUI_NATIVE)
    target_compile_options(dosui_flags INTERFACE $<$<COMPILE_LANGUAGE:Fortran>:-march=native>)
  endif()
  set(flags_debug "-std=f2008 ${checks}")
  set(flags_release "-std=f2008")
elseif(CMAKE_Fortran_COMPILER_ID MATCHES "^Intel")
  target_compile_options(dosui_flags INTERFACE
    $<$<COMPILE_LANGUAGE:Fortran>:-stand f08 -fp-model precise
    $<$<CONFIG:Debug>:-warn all -check all -fpe0 -traceback>>)
  if(DOSUI_NATIVE)
    target_compile_options(dosui_flags INTERFACE $<$<COMPILE_LANGUAGE:Fortran>:-xHost>)
  endif()
else()
  message(STATUS "dosui: no flags known for the compiler ${CMAKE_Fortran_COMPILER_ID}")
endif()

# The flags as text, for the result file and --version.
string(TOUPPER "${CMAKE_BUILD_TYPE}" build_type_upper)
string(TOLOWER "${CMAKE_BUILD_TYPE}" build_type_lower)
string(REPLACE ";" " " DOSUI_FLAGS_TEXT "${CMAKE_Fortran_FLAGS} \
${CMAKE_Fortran_FLAGS_${build_type_upper}} ${flags_${build_type_lower}}")
if(DOSUI_NATIVE)
  string(APPEND DOSUI_FLAGS_TEXT " -march=native")
endif()
string(STRIP "${DOSUI_FLAGS_TEXT}" DOSUI_FLAGS_TEXT)

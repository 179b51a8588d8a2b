# MPI with mpi_f08, parallel HDF5 with its Fortran modules, METIS with 32-bit indices, PETSc.
set(dosui_debian_hint "On Debian: apt install")

find_package(MPI COMPONENTS C Fortran)
if(NOT MPI_Fortran_FOUND)
  message(FATAL_ERROR "dosui needs MPI for Fortran. ${dosui_debian_hint} libopenmpi-dev openmpi-bin")
endif()
if(NOT MPI_Fortran_HAVE_F08_MODULE)
  message(FATAL_ERROR "dosui needs the module mpi_f08, which this MPI (${MPI_Fortran_COMPILER}) lacks")
endif()

set(HDF5_PREFER_PARALLEL ON)
find_package(HDF5 COMPONENTS Fortran)
if(NOT HDF5_FOUND OR NOT HDF5_IS_PARALLEL)
  message(FATAL_ERROR "dosui needs parallel HDF5 with Fortran modules (found: '${HDF5_VERSION}', \
parallel: '${HDF5_IS_PARALLEL}'). ${dosui_debian_hint} libhdf5-openmpi-dev; elsewhere set HDF5_ROOT")
endif()
add_library(dosui_hdf5 INTERFACE)
target_include_directories(dosui_hdf5 SYSTEM INTERFACE ${HDF5_Fortran_INCLUDE_DIRS})
target_link_libraries(dosui_hdf5 INTERFACE ${HDF5_Fortran_LIBRARIES})

find_library(METIS_LIBRARY metis HINTS ENV METIS_ROOT PATH_SUFFIXES lib lib64)
find_path(METIS_INCLUDE_DIR metis.h HINTS ENV METIS_ROOT PATH_SUFFIXES include include/metis)
if(NOT METIS_LIBRARY OR NOT METIS_INCLUDE_DIR)
  message(FATAL_ERROR "dosui needs METIS 5. ${dosui_debian_hint} libmetis-dev; elsewhere set METIS_ROOT \
or CMAKE_PREFIX_PATH")
endif()
file(STRINGS ${METIS_INCLUDE_DIR}/metis.h metis_width REGEX "^ *#define +IDXTYPEWIDTH")
if(metis_width AND NOT metis_width MATCHES "32")
  message(FATAL_ERROR "dosui needs METIS with 32-bit indices, but ${METIS_INCLUDE_DIR}/metis.h says: \
${metis_width}")
endif()
add_library(dosui_metis INTERFACE)
target_link_libraries(dosui_metis INTERFACE ${METIS_LIBRARY})

# PETSc with real double precision and 32-bit indices; its C functions only.
find_library(PETSC_LIBRARY NAMES petsc_real petsc HINTS ENV PETSC_DIR PATH_SUFFIXES lib lib64
  $ENV{PETSC_ARCH}/lib)
if(NOT PETSC_LIBRARY)
  message(FATAL_ERROR "dosui needs PETSc. ${dosui_debian_hint} libpetsc-real-dev; elsewhere set \
PETSC_DIR or CMAKE_PREFIX_PATH")
endif()
file(REAL_PATH ${PETSC_LIBRARY} petsc_real_path)
get_filename_component(petsc_lib_dir ${petsc_real_path} DIRECTORY)
file(GLOB petsc_roots /usr/lib/petscdir/petsc3*/*-real /usr/lib/petscdir/*)
find_path(PETSC_INCLUDE_DIR petscmat.h HINTS ENV PETSC_DIR ${petsc_lib_dir}/.. ${petsc_roots}
  PATH_SUFFIXES include)
find_path(PETSC_CONF_DIR petscconf.h HINTS $ENV{PETSC_DIR}/$ENV{PETSC_ARCH} ${PETSC_INCLUDE_DIR}/..
  PATH_SUFFIXES include)
if(NOT PETSC_INCLUDE_DIR OR NOT PETSC_CONF_DIR)
  message(FATAL_ERROR "dosui needs the headers of PETSc (${PETSC_LIBRARY}); set PETSC_DIR")
endif()
add_library(dosui_petsc INTERFACE)
target_include_directories(dosui_petsc SYSTEM INTERFACE ${PETSC_INCLUDE_DIR} ${PETSC_CONF_DIR})
target_link_libraries(dosui_petsc INTERFACE ${PETSC_LIBRARY} MPI::MPI_C)

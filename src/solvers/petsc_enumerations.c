/* Values of PETSc's enumerations from its own headers: they differ between versions. */
#include <petscmat.h>

const int dosui_petsc_insert_values = INSERT_VALUES;
const int dosui_petsc_initial_matrix = MAT_INITIAL_MATRIX;
const int dosui_petsc_reuse_matrix = MAT_REUSE_MATRIX;
const int dosui_petsc_factor_lu = MAT_FACTOR_LU;

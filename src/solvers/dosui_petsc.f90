!! Binding of the part of PETSc (3.17 or later, real double, 32-bit indices) that dosui uses.
!!
!! The C functions are bound directly: they need neither PETSc's Fortran modules, which belong to
!! one compiler version, nor its preprocessor macros. Every function returns an error code, 0 for
!! success. PETSc starts with the first solver, so that scenes without one never touch it.
module dosui_petsc
  use, intrinsic :: iso_c_binding, only: c_char, c_double, c_int, c_null_char, c_null_ptr, &
                                                                            c_ptr, c_size_t
  implicit none
  private

  public :: petsc_start, petsc_stop, petsc_world, petsc_set_options
  public :: mat_create, mat_set_sizes, mat_set_block_size, mat_set_type, mat_set_pattern, &
            mat_set_values, mat_mult, mat_destroy, mat_create_nest, mat_nest_rows, mat_convert, &
            mat_set_near_null_space
  public :: rigid_body_modes, null_space_destroy
  public :: vec_create_parallel, vec_create_serial, vec_place_array, vec_reset_array, vec_destroy
  public :: ksp_create, ksp_set_prefix, ksp_set_operators, ksp_set_tolerances, &
            ksp_set_from_options, ksp_set_up, ksp_solve, ksp_reason, ksp_iterations, ksp_residual, &
            ksp_get_pc, &
            ksp_destroy, ksp_set_nonzero_guess
  public :: pc_set_split, has_umfpack, has_hypre

  ! of petsc_enumerations.c
  integer(c_int), bind(c, name='dosui_petsc_insert_values'), protected, public :: insert_values
  !! equal places are summed all the same
  integer(c_int), bind(c, name='dosui_petsc_initial_matrix'), protected, public :: initial_matrix
  integer(c_int), bind(c, name='dosui_petsc_reuse_matrix'), protected, public :: reuse_matrix
  integer(c_int), bind(c, name='dosui_petsc_factor_lu'), protected :: factor_lu

  type(c_ptr), bind(c, name='PETSC_COMM_WORLD') :: petsc_world
  logical :: is_started = .false.

  interface
    integer(c_int) function options_set_value(options, name, value) &
      bind(c, name='PetscOptionsSetValue')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: options
      ! allow(C071)
      character(kind=c_char), intent(in) :: name(*), value(*)
    end function options_set_value
    integer(c_int) function options_insert_string(options, text) &
      bind(c, name='PetscOptionsInsertString')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: options
      ! allow(C071)
      character(kind=c_char), intent(in) :: text(*)
    end function options_insert_string
    integer(c_int) function initialize_no_arguments() bind(c, name='PetscInitializeNoArguments')
      import :: c_int
      implicit none
    end function initialize_no_arguments
    integer(c_int) function finalize() bind(c, name='PetscFinalize')
      import :: c_int
      implicit none
    end function finalize

    integer(c_int) function mat_create(comm, mat) bind(c, name='MatCreate')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: comm
      type(c_ptr), intent(out) :: mat
    end function mat_create
    integer(c_int) function mat_set_sizes(mat, rows, columns, all_rows, all_columns) &
      bind(c, name='MatSetSizes')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: mat
      integer(c_int), value :: rows, columns, all_rows, all_columns
    end function mat_set_sizes
    integer(c_int) function mat_set_block_size(mat, size) bind(c, name='MatSetBlockSize')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: mat
      integer(c_int), value :: size
    end function mat_set_block_size
    integer(c_int) function mat_set_type_c(mat, name) bind(c, name='MatSetType')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: mat
      ! allow(C071)
      character(kind=c_char), intent(in) :: name(*)
    end function mat_set_type_c
    integer(c_int) function mat_set_pattern(mat, n, row, column) &
      bind(c, name='MatSetPreallocationCOO')
      import :: c_int, c_ptr, c_size_t
      implicit none
      type(c_ptr), value :: mat
      integer(c_size_t), value :: n
      ! allow(C071)
      integer(c_int), intent(inout) :: row(*), column(*)
    end function mat_set_pattern
    integer(c_int) function mat_set_values(mat, values, mode) bind(c, name='MatSetValuesCOO')
      import :: c_int, c_ptr, c_double
      implicit none
      type(c_ptr), value :: mat
      ! allow(C071)
      real(c_double), intent(in) :: values(*)   !! [unit of the matrix]
      integer(c_int), value :: mode
    end function mat_set_values
    integer(c_int) function mat_mult(mat, x, y) bind(c, name='MatMult')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: mat, x, y
    end function mat_mult
    integer(c_int) function mat_destroy(mat) bind(c, name='MatDestroy')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), intent(inout) :: mat
    end function mat_destroy
    integer(c_int) function mat_create_nest(comm, n_row, rows, n_column, columns, blocks, mat) &
      bind(c, name='MatCreateNest')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: comm
      integer(c_int), value :: n_row
      type(c_ptr), value :: rows
      integer(c_int), value :: n_column
      type(c_ptr), value :: columns
      ! allow(C071)
      type(c_ptr), intent(in) :: blocks(*)
      type(c_ptr), intent(out) :: mat
    end function mat_create_nest
    integer(c_int) function mat_nest_rows(mat, rows, columns) bind(c, name='MatNestGetISs')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: mat
      ! allow(C071,C072)
      type(c_ptr), intent(inout) :: rows(*)
      type(c_ptr), value :: columns
    end function mat_nest_rows
    integer(c_int) function mat_convert_c(mat, name, reuse, new) bind(c, name='MatConvert')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: mat
      ! allow(C071)
      character(kind=c_char), intent(in) :: name(*)
      integer(c_int), value :: reuse
      type(c_ptr), intent(inout) :: new
    end function mat_convert_c
    integer(c_int) function mat_set_near_null_space(mat, space) bind(c, name='MatSetNearNullSpace')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: mat, space
    end function mat_set_near_null_space
    integer(c_int) function rigid_body_modes(coordinates, space) &
      bind(c, name='MatNullSpaceCreateRigidBody')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: coordinates
      type(c_ptr), intent(out) :: space
    end function rigid_body_modes
    integer(c_int) function null_space_destroy(space) bind(c, name='MatNullSpaceDestroy')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), intent(inout) :: space
    end function null_space_destroy

    integer(c_int) function vec_create_parallel(comm, block_size, n, n_all, array, vec) &
      bind(c, name='VecCreateMPIWithArray')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: comm
      integer(c_int), value :: block_size, n, n_all
      type(c_ptr), value :: array
      type(c_ptr), intent(out) :: vec
    end function vec_create_parallel
    integer(c_int) function vec_create_serial(comm, block_size, n, array, vec) &
      bind(c, name='VecCreateSeqWithArray')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: comm
      integer(c_int), value :: block_size, n
      type(c_ptr), value :: array
      type(c_ptr), intent(out) :: vec
    end function vec_create_serial
    integer(c_int) function vec_place_array(vec, array) bind(c, name='VecPlaceArray')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: vec, array
    end function vec_place_array
    integer(c_int) function vec_reset_array(vec) bind(c, name='VecResetArray')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: vec
    end function vec_reset_array
    integer(c_int) function vec_destroy(vec) bind(c, name='VecDestroy')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), intent(inout) :: vec
    end function vec_destroy

    integer(c_int) function ksp_create(comm, ksp) bind(c, name='KSPCreate')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: comm
      type(c_ptr), intent(out) :: ksp
    end function ksp_create
    integer(c_int) function ksp_set_prefix_c(ksp, prefix) bind(c, name='KSPSetOptionsPrefix')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: ksp
      ! allow(C071)
      character(kind=c_char), intent(in) :: prefix(*)
    end function ksp_set_prefix_c
    integer(c_int) function ksp_set_operators(ksp, matrix, for_preconditioner) &
      bind(c, name='KSPSetOperators')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp, matrix, for_preconditioner
    end function ksp_set_operators
    integer(c_int) function ksp_set_tolerances(ksp, relative, absolute, divergence, iterations) &
      bind(c, name='KSPSetTolerances')
      import :: c_int, c_ptr, c_double
      implicit none
      type(c_ptr), value :: ksp
      real(c_double), value :: relative, absolute, divergence   !! [-], [unit of the residual], [-]
      integer(c_int), value :: iterations
    end function ksp_set_tolerances
    integer(c_int) function ksp_set_from_options(ksp) bind(c, name='KSPSetFromOptions')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
    end function ksp_set_from_options
    integer(c_int) function ksp_set_up(ksp) bind(c, name='KSPSetUp')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
    end function ksp_set_up
    integer(c_int) function ksp_solve(ksp, right_side, solution) bind(c, name='KSPSolve')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp, right_side, solution
    end function ksp_solve
    integer(c_int) function ksp_set_nonzero_guess(ksp, is_nonzero) &
      bind(c, name='KSPSetInitialGuessNonzero')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
      integer(c_int), value :: is_nonzero
    end function ksp_set_nonzero_guess
    integer(c_int) function ksp_reason(ksp, reason) bind(c, name='KSPGetConvergedReason')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
      integer(c_int), intent(out) :: reason
    end function ksp_reason
    integer(c_int) function ksp_iterations(ksp, n) bind(c, name='KSPGetIterationNumber')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
      integer(c_int), intent(out) :: n
    end function ksp_iterations
    integer(c_int) function ksp_residual(ksp, norm) bind(c, name='KSPGetResidualNorm')
      import :: c_int, c_ptr, c_double
      implicit none
      type(c_ptr), value :: ksp
      real(c_double), intent(out) :: norm   !! [unit of the residual]
    end function ksp_residual
    integer(c_int) function solver_type_get(solver, matrix, factor, has_solver, has_matrix, &
                                            create) &
      bind(c, name='MatSolverTypeGet')
      import :: c_int, c_ptr, c_char
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: solver(*), matrix(*)
      integer(c_int), value :: factor
      integer(c_int), intent(out) :: has_solver, has_matrix
      type(c_ptr), intent(out) :: create
    end function solver_type_get
    integer(c_int) function has_external_package(package, has) &
      bind(c, name='PetscHasExternalPackage')
      import :: c_int, c_char
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: package(*)
      integer(c_int), intent(out) :: has
    end function has_external_package
    integer(c_int) function ksp_get_pc(ksp, pc) bind(c, name='KSPGetPC')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), value :: ksp
      type(c_ptr), intent(out) :: pc
    end function ksp_get_pc
    integer(c_int) function ksp_destroy(ksp) bind(c, name='KSPDestroy')
      import :: c_int, c_ptr
      implicit none
      type(c_ptr), intent(inout) :: ksp
    end function ksp_destroy
    integer(c_int) function pc_set_split_c(pc, name, indices) bind(c, name='PCFieldSplitSetIS')
      import :: c_int, c_ptr, c_char
      implicit none
      type(c_ptr), value :: pc
      ! allow(C071)
      character(kind=c_char), intent(in) :: name(*)
      type(c_ptr), value :: indices
    end function pc_set_split_c
  end interface

contains

  subroutine petsc_start(status)
    !! Starts PETSc on all ranks, once. It neither catches signals nor reads options from outside,
    !! and hands errors back instead of printing them. Collective.
    integer, intent(out) :: status   !! 0: it runs

    status = 0
    if (is_started) return
    status = int(options_set_value(c_null_ptr, '-no_signal_handler'//c_null_char, &
                                   '1'//c_null_char))
    if (status == 0) status = int(options_set_value(c_null_ptr, '-skip_petscrc'//c_null_char, &
                                                    '1'//c_null_char))
    if (status == 0) status = int(initialize_no_arguments())
    is_started = status == 0
  end subroutine petsc_start

  subroutine petsc_stop()
    !! Ends PETSc if it was started; before MPI ends. Collective.
    integer(c_int) :: status

    if (.not. is_started) return
    is_started = .false.
    status = finalize()
    if (status /= 0) return   ! the run is over, nobody is left to care
  end subroutine petsc_stop

  subroutine petsc_set_options(options, status)
    !! Adds options, written as on PETSc's command line. Those of the environment's PETSC_OPTIONS
    !! win, so that experts can try others.
    character(len=*), intent(in) :: options
    integer, intent(out) :: status
    character(len=4096) :: environment
    integer :: length, found

    status = int(options_insert_string(c_null_ptr, options//c_null_char))
    call get_environment_variable('PETSC_OPTIONS', environment, length, found)
    if (status == 0 .and. found == 0 .and. length > 0) then
      status = int(options_insert_string(c_null_ptr, environment(1:length)//c_null_char))
    end if
  end subroutine petsc_set_options

  logical function has_umfpack()
    !! Was PETSc built with UMFPACK? It is faster than PETSc's own factorisation.
    integer(c_int) :: status, has_solver, has_matrix
    type(c_ptr) :: create

    status = solver_type_get('umfpack'//c_null_char, 'seqaij'//c_null_char, factor_lu, &
                             has_solver, has_matrix, create)
    has_umfpack = status == 0 .and. has_solver /= 0 .and. has_matrix /= 0
  end function has_umfpack

  logical function has_hypre()
    !! Was PETSc built with hypre? Its BoomerAMG suits the heads of large steps.
    integer(c_int) :: status, has

    status = has_external_package('hypre'//c_null_char, has)
    has_hypre = status == 0 .and. has /= 0
  end function has_hypre

  integer(c_int) function mat_set_type(mat, name) result(status)
    !! Sets a matrix' type.
    type(c_ptr), intent(in) :: mat
    character(len=*), intent(in) :: name

    status = mat_set_type_c(mat, name//c_null_char)
  end function mat_set_type

  integer(c_int) function mat_convert(mat, name, reuse, new) result(status)
    !! Copies a matrix into one of another type.
    type(c_ptr), intent(in) :: mat
    character(len=*), intent(in) :: name
    integer(c_int), intent(in) :: reuse   !! initial_matrix or reuse_matrix
    type(c_ptr), intent(inout) :: new

    status = mat_convert_c(mat, name//c_null_char, reuse, new)
  end function mat_convert

  integer(c_int) function ksp_set_prefix(ksp, prefix) result(status)
    !! The prefix of a solver's options.
    type(c_ptr), intent(in) :: ksp
    character(len=*), intent(in) :: prefix

    status = ksp_set_prefix_c(ksp, prefix//c_null_char)
  end function ksp_set_prefix

  integer(c_int) function pc_set_split(pc, name, indices) result(status)
    !! Names one field of a split preconditioner and its rows.
    type(c_ptr), intent(in) :: pc
    character(len=*), intent(in) :: name
    type(c_ptr), intent(in) :: indices

    status = pc_set_split_c(pc, name//c_null_char, indices)
  end function pc_set_split
end module dosui_petsc

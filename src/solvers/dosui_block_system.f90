!! A 2 x 2 block system K u - Q p = f, D u + C p = r on all ranks, solved by PETSc.
!!
!! Small systems are factorised; every rank does so for itself, which repeats itself bit for bit.
!! Large ones are solved by GMRES with a block lower-triangular preconditioner: algebraic multigrid
!! for K, which knows the rigid-body modes, and for an approximation of the Schur complement.
!! Either block may be missing (rigid skeletons, dry scenes).
module dosui_block_system
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_loc, c_null_ptr, c_ptr, c_size_t, &
                                                                            c_associated
  use, intrinsic :: ieee_exceptions, only: ieee_usual, ieee_get_halting_mode, &
                                                                ieee_set_halting_mode, ieee_set_flag
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_petsc, only: has_hypre, has_umfpack, initial_matrix, insert_values, ksp_create, &
                         ksp_destroy, ksp_get_pc, ksp_iterations, ksp_reason, ksp_residual, &
                         ksp_set_from_options, ksp_set_nonzero_guess, ksp_set_operators, &
                         ksp_set_prefix, ksp_set_tolerances, ksp_set_up, ksp_solve, &
                         mat_convert, mat_create, mat_create_nest, mat_destroy, mat_mult, &
                         mat_nest_rows, mat_set_block_size, mat_set_near_null_space, &
                         mat_set_pattern, mat_set_sizes, mat_set_type, mat_set_values, &
                         null_space_destroy, pc_set_split, petsc_set_options, petsc_start, &
                         petsc_world, reuse_matrix, rigid_body_modes, vec_create_parallel, &
                         vec_create_serial, vec_destroy, vec_place_array, vec_reset_array
  use dosui_text, only: to_text
  implicit none
  private

  integer, parameter, public :: block_u = 1, block_p = 2
  integer, parameter :: iteration_limit = 500
  integer, parameter :: refinements = 4   !! of a direct solution
  real(wp), parameter :: refined = 1.0e-9_wp   !! residual of a direct solution [-]
  ! Squares of smaller ones underflow: a body that comes to rest must not look singular.
  real(c_double), parameter :: negligible = 1.0e-140_c_double   !! residual [-]
  real(wp), parameter :: error_tolerance = 0.1_wp        !! of an error's own solution [-]
  real(wp), parameter :: largest_amplification = 1.0e4_wp   !! that is believed [-]
  real(wp), parameter :: least_share = 1.0e-6_wp   !! of one kind of unknowns, to count [-]
  real(wp), parameter :: margin = 5.0_wp      !! for other right sides than that of the set-up [-]
  integer, parameter :: corrections = 3       !! of one solution by its error
  integer, parameter :: setups_between = 50   !! of dynamic systems, whose errors are small
  integer, parameter :: reason_iterations = -3   !! KSP_DIVERGED_ITS

  type :: block_t
    !! One block: its entries' matrix, and, of C, the one for the preconditioner.
    type(c_ptr) :: mat = c_null_ptr
    logical :: is_set = .false.
  end type block_t

  type, public :: block_system_t
    !! All procedures are collective.
    integer :: n(2) = 0                  !! rows of this rank: displacements, pressures
    integer :: first(2) = 0              !! the first of them among all ranks' [from 0]
    integer :: n_all(2) = 0              !! rows of all ranks
    logical :: is_direct = .true.
    logical :: is_dynamic = .false.      !! K is diagonal
    integer :: n_iteration = 0           !! of all solves so far
    integer :: most_iterations = 0       !! of one solve
    integer :: n_solve = 0
    integer :: n_setup = 0               !! factorisations or multigrid set-ups
    logical :: has_failed = .false.      !! the last solve
    type(block_t), private :: block(2, 2)
    type(block_t), private :: schur      !! approximates C + D K^-1 Q
    type(c_ptr), private :: nest = c_null_ptr, smooth_nest = c_null_ptr, whole = c_null_ptr
    type(c_ptr), private :: ksp = c_null_ptr, right = c_null_ptr, left = c_null_ptr
    real(c_double), pointer, contiguous, private :: coordinates(:) => null()
    integer, private :: dimension = 0          ! of the nodes' space, once they have coordinates
    type(communicator_t), private :: comm
    logical, private :: is_current = .false.
    real(wp) :: amplification = 1.0_wp   !! relative error over residual, iterations only [-]
  contains
    procedure :: init => system_init
    procedure :: set_pattern => system_set_pattern
    procedure :: set_values => system_set_values
    procedure :: set_schur => system_set_schur
    procedure :: set_coordinates => system_set_coordinates
    procedure :: prepare => system_prepare
    procedure :: solve => system_solve
    procedure :: multiply => system_multiply
    procedure :: clear => system_clear
    procedure, private :: make_matrix
    procedure, private :: build_solver
  end type block_system_t

contains

  subroutine system_init(self, comm, n_u, n_p, is_direct, is_dynamic, err)
    !! Gives the system its size on this rank; entries follow.
    class(block_system_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_u, n_p        !! rows of this rank
    logical, intent(in) :: is_direct       !! factorise
    logical, intent(in) :: is_dynamic      !! K is diagonal
    type(error_t), intent(inout) :: err
    integer(i8) :: total(2), before(2)
    integer :: status

    call self%clear()
    call petsc_start(status)
    if (status /= 0) call err%set('PETSc did not start (code '//to_text(status)//')')
    call comm%agree(err)
    if (err%failed()) return
    self%comm = comm
    self%n = [n_u, n_p]
    total = [comm%sum(int(n_u, i8)), comm%sum(int(n_p, i8))]
    before = [comm%prefix_sum(int(n_u, i8)), comm%prefix_sum(int(n_p, i8))]
    if (any(total > int(huge(1), i8))) then
      call err%set('the system has more than '//to_text(huge(1))//' unknowns of one kind')
      return
    end if
    self%n_all = int(total)
    self%first = int(before)
    self%is_direct = is_direct
    self%is_dynamic = is_dynamic
  end subroutine system_init

  subroutine make_matrix(self, row_block, column_block, row, column, mat, status)
    !! A matrix with the given entries; those with a negative row or column are left out.
    class(block_system_t), intent(in) :: self
    integer, intent(in) :: row_block, column_block
    integer, intent(in) :: row(:), column(:)   !! global numbers from 0
    type(c_ptr), intent(inout) :: mat
    integer, intent(out) :: status
    integer(c_int), allocatable :: i(:), j(:)

    i = row
    j = column
    status = mat_create(petsc_world, mat)
    if (status == 0) status = mat_set_sizes(mat, self%n(row_block), self%n(column_block), &
                                            self%n_all(row_block), self%n_all(column_block))
    if (status == 0) status = mat_set_type(mat, 'aij')
    if (status == 0) status = mat_set_pattern(mat, int(size(i), c_size_t), i, j)
  end subroutine make_matrix

  subroutine system_set_pattern(self, row_block, column_block, row, column, err)
    !! Places of the entries of one block; the same place may come several times, on any rank, and
    !! is summed. Negative places are left out.
    class(block_system_t), intent(inout) :: self
    integer, intent(in) :: row_block, column_block
    integer, intent(in) :: row(:), column(:)   !! global numbers from 0
    type(error_t), intent(inout) :: err
    integer :: status

    call self%make_matrix(row_block, column_block, row, column, &
                          self%block(row_block, column_block)%mat, status)
    self%block(row_block, column_block)%is_set = .true.
    if (row_block == block_p .and. column_block == block_p .and. self%n_all(1) > 0 .and. &
        .not. (self%is_direct .or. self%is_dynamic)) then
      if (status == 0) call self%make_matrix(row_block, column_block, row, column, self%schur%mat, &
                                             status)
      self%schur%is_set = .true.
    end if
    call report('the pattern of a matrix', status, err)
  end subroutine system_set_pattern

  subroutine system_set_values(self, row_block, column_block, values, err)
    !! Values of the entries, in the order of `set_pattern`.
    class(block_system_t), intent(inout) :: self
    integer, intent(in) :: row_block, column_block
    real(wp), intent(in) :: values(:)   !! [units of the block]
    type(error_t), intent(inout) :: err
    integer :: status

    status = mat_set_values(self%block(row_block, column_block)%mat, values, insert_values)
    call report('the entries of a matrix', status, err)
    self%is_current = .false.
  end subroutine system_set_values

  subroutine system_set_schur(self, values, err)
    !! Values that approximate the Schur complement of the pressures, on the pattern of C. Only
    !! iterative solutions use them.
    class(block_system_t), intent(inout) :: self
    real(wp), intent(in) :: values(:)   !! [unit of C]
    type(error_t), intent(inout) :: err
    integer :: status

    if (.not. self%schur%is_set) return
    status = mat_set_values(self%schur%mat, values, insert_values)
    call report('the entries of a matrix', status, err)
    self%is_current = .false.
  end subroutine system_set_schur

  subroutine system_set_coordinates(self, dimension, coordinates, err)
    !! Positions of the nodes whose displacements are the unknowns, for the rigid-body modes.
    class(block_system_t), intent(inout) :: self
    integer, intent(in) :: dimension
    real(wp), intent(in) :: coordinates(:)   !! (n_u) [m or any unit of length]
    type(error_t), intent(inout) :: err
    type(c_ptr) :: vec, space
    integer :: status

    self%dimension = dimension
    if (self%is_direct .or. dimension == 1) return
    if (associated(self%coordinates)) deallocate (self%coordinates)
    allocate (self%coordinates(max(1, self%n(block_u))))
    self%coordinates(1:self%n(block_u)) = coordinates
    call make_vector(self%comm%size, dimension, self%n(block_u), self%n_all(block_u), &
                     self%coordinates, vec, status)
    if (status == 0) status = mat_set_block_size(self%block(1, 1)%mat, dimension)
    if (status == 0) status = rigid_body_modes(vec, space)
    if (status == 0) status = mat_set_near_null_space(self%block(1, 1)%mat, space)
    if (status == 0) status = null_space_destroy(space)
    if (status == 0) status = vec_destroy(vec)
    call report('the rigid-body modes', status, err)
  end subroutine system_set_coordinates

  subroutine make_vector(n_rank, block_size, n, n_all, values, vec, status)
    !! A vector on an array of ours.
    integer, intent(in) :: n_rank, block_size, n, n_all
    real(c_double), intent(in), target, contiguous :: values(:)
    type(c_ptr), intent(out) :: vec
    integer, intent(out) :: status

    if (n_rank == 1) then
      status = vec_create_serial(petsc_world, block_size, n, c_loc(values), vec)
    else
      status = vec_create_parallel(petsc_world, block_size, n, n_all, c_loc(values), vec)
    end if
  end subroutine make_vector

  subroutine system_prepare(self, err)
    !! Factorises, or sets up the multigrids, if entries have changed.
    class(block_system_t), intent(inout) :: self
    type(error_t), intent(inout) :: err
    logical :: halting(size(ieee_usual))
    integer :: status

    if (self%is_current .or. err%failed()) return
    call be_lenient(halting)
    status = 0
    if (.not. c_associated(self%ksp)) call self%build_solver(status)
    if (status == 0 .and. self%is_direct .and. c_associated(self%nest)) then
      status = mat_convert(self%nest, 'aij', reuse_matrix, self%whole)
    end if
    if (status == 0) status = ksp_set_up(self%ksp)
    call be_strict(halting)
    self%n_setup = self%n_setup + 1
    self%is_current = status == 0
    call report('the set-up of the linear solver', status, err)
  end subroutine system_prepare

  subroutine build_solver(self, status)
    !! The solver and what it sees: a single block, or the nest of all four.
    class(block_system_t), intent(inout) :: self
    integer, intent(out) :: status
    type(c_ptr) :: operator, for_preconditioner, rows(2), pc, blocks(4)
    character(len=:), allocatable :: prefix
    integer :: alone
    logical :: is_split

    alone = 0
    if (self%n_all(block_p) == 0) alone = block_u
    if (self%n_all(block_u) == 0) alone = block_p
    is_split = alone == 0 .and. .not. self%is_direct
    status = 0
    if (alone > 0) then
      operator = self%block(alone, alone)%mat
      for_preconditioner = operator
    else
      ! row by row
      blocks = [self%block(1, 1)%mat, self%block(1, 2)%mat, self%block(2, 1)%mat, &
                self%block(2, 2)%mat]
      status = mat_create_nest(petsc_world, 2, c_null_ptr, 2, c_null_ptr, blocks, self%nest)
      operator = self%nest
      for_preconditioner = operator
      if (self%is_direct) then
        if (status == 0) status = mat_convert(self%nest, 'aij', initial_matrix, self%whole)
        operator = self%whole
        for_preconditioner = operator
      else
        if (.not. self%is_dynamic) blocks(4) = self%schur%mat
        if (status == 0) status = mat_create_nest(petsc_world, 2, c_null_ptr, 2, c_null_ptr, &
                                                  blocks, self%smooth_nest)
        for_preconditioner = self%smooth_nest
      end if
    end if
    prefix = 'dosui_'//trim(merge('direct ', merge('split  ', merge('elastic', 'water  ', &
                                               alone == block_u), alone == 0), self%is_direct))//'_'
    if (status == 0) then
      call petsc_set_options(solver_options(prefix, self%is_direct, self%is_dynamic, is_split, &
                                            alone, self%comm%size, self%dimension), status)
    end if
    if (status == 0) status = ksp_create(petsc_world, self%ksp)
    if (status == 0) status = ksp_set_prefix(self%ksp, prefix)
    if (status == 0) status = ksp_set_operators(self%ksp, operator, for_preconditioner)
    if (status == 0) status = ksp_set_from_options(self%ksp)
    if (is_split) then
      rows = c_null_ptr
      if (status == 0) status = mat_nest_rows(self%smooth_nest, rows, c_null_ptr)
      if (status == 0) status = ksp_get_pc(self%ksp, pc)
      if (status == 0) status = pc_set_split(pc, 'u', rows(1))
      if (status == 0) status = pc_set_split(pc, 'p', rows(2))
    end if
  end subroutine build_solver

  function solver_options(prefix, is_direct, is_dynamic, is_split, alone, n_rank, dimension) &
    result(options)
    !! PETSc's options for the solver.
    character(len=*), intent(in) :: prefix
    logical, intent(in) :: is_direct, is_dynamic, is_split
    integer, intent(in) :: alone
    integer, intent(in) :: n_rank
    integer, intent(in) :: dimension   !! of the nodes' space
    character(len=:), allocatable :: options, factor

    if (is_direct) then
      options = '-'//prefix//'ksp_type fgmres -'//prefix//'ksp_norm_type unpreconditioned'
      factor = prefix
      if (n_rank > 1) then
        options = options//' -'//prefix//'pc_type redundant'
        factor = prefix//'redundant_'
        options = options//' -'//factor//'ksp_type preonly'
      end if
      options = options//' -'//factor//'pc_type lu'// &
                ' -'//factor//'pc_factor_mat_solver_type '// &
                trim(merge('umfpack', 'petsc  ', has_umfpack()))
    else if (is_split .and. is_dynamic) then
      ! K is diagonal, so that the Schur complement can be had as a matrix
      options = '-'//prefix//'ksp_type fgmres -'//prefix//'pc_type fieldsplit'// &
                ' -'//prefix//'pc_fieldsplit_type schur'// &
                ' -'//prefix//'pc_fieldsplit_schur_fact_type full'// &
                ' -'//prefix//'pc_fieldsplit_schur_precondition selfp'// &
                ' -'//prefix//'fieldsplit_u_ksp_type preonly'// &
                ' -'//prefix//'fieldsplit_u_pc_type jacobi'// &
                ' -'//prefix//'fieldsplit_p_ksp_type preonly'// &
                water_options(prefix//'fieldsplit_p_', is_dynamic)
    else if (is_split) then
      options = '-'//prefix//'ksp_type fgmres -'//prefix//'ksp_gmres_restart 60'// &
                ' -'//prefix//'pc_type fieldsplit'// &
                ' -'//prefix//'pc_fieldsplit_type multiplicative'// &
                ' -'//prefix//'pc_fieldsplit_off_diag_use_amat'
      options = options//elastic_options(prefix//'fieldsplit_u_', dimension)// &
                water_options(prefix//'fieldsplit_p_', is_dynamic)
      options = options//' -'//prefix//'fieldsplit_u_ksp_type preonly'// &
                ' -'//prefix//'fieldsplit_p_ksp_type preonly'
    else if (alone == block_u) then
      options = '-'//prefix//'ksp_type cg -'//prefix//'ksp_norm_type unpreconditioned'// &
                elastic_options(prefix, dimension)
    else
      options = '-'//prefix//'ksp_type bcgs '//water_options(prefix, is_dynamic)
    end if
  end function solver_options

  function elastic_options(prefix, dimension) result(options)
    !! Smoothed aggregation for the skeleton. In plane problems W-cycles and leaving weak couplings
    !! out keep the iterations from growing with the system (1e3 to 1e5 particles: 11 to 13 instead
    !! of 12 to 20); in space they hardly grow, and V-cycles are cheaper.
    character(len=*), intent(in) :: prefix
    integer, intent(in) :: dimension
    character(len=:), allocatable :: options

    options = ' -'//prefix//'pc_type gamg'// &
              ' -'//prefix//'mg_levels_ksp_max_it 2 -'//prefix//'mg_levels_pc_type jacobi'// &
              ' -'//prefix//'pc_gamg_square_graph 0'// &
              ' -'//prefix//'pc_gamg_aggressive_coarsening 0'
    if (dimension == 2) then
      options = options//' -'//prefix//'pc_gamg_threshold 0.02 -'//prefix//'pc_mg_cycle_type w'
    else
      options = options//' -'//prefix//'pc_gamg_threshold 0 -'//prefix//'pc_mg_cycle_type v'
    end if
  end function elastic_options

  function water_options(prefix, is_dynamic) result(options)
    !! Multigrid for heads. In steps longer than the diffusion time of a cell the operator is all
    !! Laplacian and not symmetric: BoomerAMG, if there, halves the iterations of smoothed
    !! aggregation then (4e4 particles: 24 instead of 50).
    character(len=*), intent(in) :: prefix
    logical, intent(in) :: is_dynamic   !! short steps
    character(len=:), allocatable :: options

    if (has_hypre() .and. .not. is_dynamic) then
      options = ' -'//prefix//'pc_type hypre -'//prefix//'pc_hypre_type boomeramg'// &
                ' -'//prefix//'pc_hypre_boomeramg_coarsen_type HMIS'// &
                ' -'//prefix//'pc_hypre_boomeramg_interp_type ext+i'// &
                ' -'//prefix//'pc_hypre_boomeramg_P_max 4'
    else
      options = ' -'//prefix//'pc_type gamg -'//prefix//'mg_levels_pc_type jacobi'
    end if
  end function water_options

  subroutine system_solve(self, right_side, solution, tolerance, is_guess, err)
    !! Solves for displacements, then pressures of this rank in one array. Fails by value when the
    !! solver does not converge; the solution is then not to be used.
    !!
    !! Iterations reduce a residual, and errors may be many times as large. After a set-up the error
    !! is therefore estimated (and mended); residuals are reduced by so much more until the next.
    class(block_system_t), intent(inout) :: self
    real(wp), intent(in), target, contiguous :: right_side(:)   !! (n_u + n_p) [units of the rows]
    real(wp), intent(inout), target, contiguous :: solution(:)  !! likewise [units of the unknowns]
    real(wp), intent(in) :: tolerance
    !! relative error of displacements and pressures; of direct solutions, the residual's [-]
    logical, intent(in) :: is_guess     !! `solution` comes with a first guess
    type(error_t), intent(inout) :: err
    logical :: is_new
    real(wp) :: least   ! residual

    is_new = .not. self%is_current
    call self%prepare(err)
    if (err%failed()) return
    if (self%is_dynamic .and. self%n_setup > 1) is_new = is_new .and. &
                                                         mod(self%n_setup, setups_between) == 0
    if (is_new) self%amplification = 1.0_wp
    least = tolerance
    if (.not. (is_new .or. self%is_direct)) least = tolerance/(margin*self%amplification)
    call iterate(self, right_side, solution, least, is_guess, err)
    if (is_new .and. .not. (self%is_direct .or. err%failed())) then
      call mend_error(self, right_side, solution, tolerance, err)
    end if
  end subroutine system_solve

  subroutine mend_error(self, right_side, solution, tolerance, err)
    !! Estimates the error of an iterative solution from its residual, takes it off, and keeps how
    !! many times larger than the residual it is. Collective.
    class(block_system_t), intent(inout) :: self
    real(wp), intent(in), contiguous :: right_side(:)
    real(wp), intent(inout), contiguous :: solution(:)
    real(wp), intent(in) :: tolerance   !! of the error, relative [-]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: residual(:), error(:)
    real(wp) :: sums(6)   ! squares: right side, residual, then solution and error of each block
    real(wp) :: largest
    integer :: k, n_u, n

    n_u = self%n(block_u)
    n = sum(self%n)
    allocate (residual(n), error(n))
    do k = 1, corrections
      call self%multiply(solution(1:n), residual, err)
      residual = right_side(1:n) - residual
      error = 0.0_wp
      call iterate(self, residual, error, error_tolerance, .false., err)
      if (err%failed()) return
      sums = [sum(right_side(1:n)**2), sum(residual**2), sum(solution(1:n_u)**2), &
              sum(error(1:n_u)**2), sum(solution(n_u + 1:n)**2), sum(error(n_u + 1:)**2)]
      call self%comm%sum_array(sums)
      if (.not. minval(sums(1:2)) > negligible) return
      if (.not. sum(sums(3:6:2)) > 0.0_wp) return
      largest = sqrt(max(sums(4)/max(sums(3), least_share**2*sums(5)), &
                         sums(6)/max(sums(5), least_share**2*sums(3))))
      self%amplification = min(largest_amplification, &
                               max(self%amplification, largest/sqrt(sums(2)/sums(1))))
      solution(1:n) = solution(1:n) + error
      if (largest <= tolerance/error_tolerance) return   ! what is left is an error's error
    end do
  end subroutine mend_error

  subroutine iterate(self, right_side, solution, tolerance, is_guess, err)
    !! One run of the solver, down to a residual. Collective.
    class(block_system_t), intent(inout) :: self
    real(wp), intent(in), target, contiguous :: right_side(:)
    real(wp), intent(inout), target, contiguous :: solution(:)
    real(wp), intent(in) :: tolerance   !! of the residual, relative to the right side [-]
    logical, intent(in) :: is_guess
    type(error_t), intent(inout) :: err
    logical :: halting(size(ieee_usual))
    integer :: status, n
    integer(c_int) :: reason, iterations
    real(c_double) :: residual
    real(wp) :: square

    n = sum(self%n)
    status = 0
    if (.not. c_associated(self%right)) then
      call make_vector(self%comm%size, 1, n, sum(self%n_all), right_side, self%right, status)
      if (status == 0) call make_vector(self%comm%size, 1, n, sum(self%n_all), solution, &
                                        self%left, status)
    else
      status = vec_place_array(self%right, c_loc(right_side))
      if (status == 0) status = vec_place_array(self%left, c_loc(solution))
    end if
    if (status == 0) status = ksp_set_tolerances(self%ksp, tolerance, negligible, &
                                                 1.0e5_c_double, merge(refinements, &
                                                                   iteration_limit, self%is_direct))
    if (status == 0) status = ksp_set_nonzero_guess(self%ksp, merge(1, 0, is_guess))
    call be_lenient(halting)
    if (status == 0) status = ksp_solve(self%ksp, self%right, self%left)
    call be_strict(halting)
    reason = 0
    iterations = 0
    if (status == 0) status = ksp_reason(self%ksp, reason)
    if (status == 0) status = ksp_iterations(self%ksp, iterations)
    if (status == 0) status = ksp_residual(self%ksp, residual)
    if (status == 0) status = vec_reset_array(self%right)
    if (status == 0) status = vec_reset_array(self%left)
    call report('the linear solution', status, err)
    self%has_failed = status /= 0 .or. reason < 0
    self%n_iteration = self%n_iteration + iterations
    self%most_iterations = max(self%most_iterations, int(iterations))
    self%n_solve = self%n_solve + 1
    if (err%failed()) return
    if (reason == reason_iterations .and. self%is_direct) then
      ! refined as far as round-off lets it
      square = self%comm%sum(sum(right_side(1:n)**2))
      self%has_failed = .not. residual <= max(refined*sqrt(square), negligible)
      if (.not. self%has_failed) return
      call err%set('the linear system is singular: is the body held by its mechanical conditions?')
    else if (reason < 0) then
      call err%set('the linear solver stopped: '//reason_text(int(reason))//' after '// &
                   to_text(int(iterations))//' iterations')
    end if
  end subroutine iterate

  subroutine system_multiply(self, x, y, err)
    !! y = A x.
    class(block_system_t), intent(inout) :: self
    real(wp), intent(in), target, contiguous :: x(:)      !! (n_u + n_p) [units of the unknowns]
    real(wp), intent(inout), target, contiguous :: y(:)   !! likewise [units of the rows]
    type(error_t), intent(inout) :: err
    type(c_ptr) :: in, out, operator
    integer :: status

    operator = self%nest
    if (self%n_all(block_p) == 0) operator = self%block(block_u, block_u)%mat
    if (self%n_all(block_u) == 0) operator = self%block(block_p, block_p)%mat
    associate (n => sum(self%n), n_all => sum(self%n_all))
      call make_vector(self%comm%size, 1, n, n_all, x, in, status)
      if (status == 0) call make_vector(self%comm%size, 1, n, n_all, y, out, status)
    end associate
    if (status == 0) status = mat_mult(operator, in, out)
    if (status == 0) status = vec_destroy(in)
    if (status == 0) status = vec_destroy(out)
    call report('a product', status, err)
  end subroutine system_multiply

  subroutine system_clear(self)
    !! Gives everything back to PETSc.
    class(block_system_t), intent(inout) :: self
    integer :: i, j, status

    if (c_associated(self%ksp)) status = ksp_destroy(self%ksp)
    if (c_associated(self%right)) status = vec_destroy(self%right)
    if (c_associated(self%left)) status = vec_destroy(self%left)
    if (c_associated(self%whole)) status = mat_destroy(self%whole)
    if (c_associated(self%nest)) status = mat_destroy(self%nest)
    if (c_associated(self%smooth_nest)) status = mat_destroy(self%smooth_nest)
    if (c_associated(self%schur%mat)) status = mat_destroy(self%schur%mat)
    do j = 1, 2
      do i = 1, 2
        if (c_associated(self%block(i, j)%mat)) status = mat_destroy(self%block(i, j)%mat)
        self%block(i, j)%is_set = .false.
      end do
    end do
    self%schur%is_set = .false.
    if (associated(self%coordinates)) deallocate (self%coordinates)
    self%is_current = .false.
  end subroutine system_clear

  pure function reason_text(reason) result(text)
    !! What PETSc's reasons mean.
    integer, intent(in) :: reason
    character(len=:), allocatable :: text

    select case (reason)
    case (-3)
      text = 'no convergence'
    case (-4)
      text = 'the residual grows'
    case (-5, -6)
      text = 'breakdown of the Krylov space'
    case (-9)
      text = 'not a number in the residual'
    case (-10, -8)
      text = 'the matrix is indefinite'
    case (-11)
      text = 'the preconditioner cannot be set up (singular matrix?)'
    case default
      text = 'reason '//to_text(reason)
    end select
  end function reason_text

  subroutine report(what, status, err)
    !! Turns PETSc's error codes into ours.
    character(len=*), intent(in) :: what
    integer, intent(in) :: status
    type(error_t), intent(inout) :: err

    if (status /= 0) call err%set('PETSc failed in '//what//' (code '//to_text(status)//')')
  end subroutine report

  subroutine be_lenient(halting)
    !! Libraries may divide by zero or overflow on their way; this is no error of ours.
    logical, intent(out) :: halting(:)

    call ieee_get_halting_mode(ieee_usual, halting)
    call ieee_set_halting_mode(ieee_usual, .false.)
  end subroutine be_lenient

  subroutine be_strict(halting)
    !! Traps are set again as they were.
    logical, intent(in) :: halting(:)

    call ieee_set_flag(ieee_usual, .false.)
    call ieee_set_halting_mode(ieee_usual, halting)
  end subroutine be_strict
end module dosui_block_system

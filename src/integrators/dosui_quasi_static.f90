!! Quasi-static steps: skeleton and water solved together without inertia, by TR-BDF2 with an
!! estimate of its error (Bank et al. 1985; Hosea & Shampine 1996).
!!
!! Momentum holds at every stage; the water content c with dc/dt = F(p) is stepped:
!!     c_g = c_n + a (F_n + F_g)                        a = g dt/2, g = 2 - sqrt(2)
!!     c_1 = (c_g/g - (1 - g)^2/g c_n)/(2 - g) + a F_1
!! Loads that come at once are answered by a solution without flow (a = 0): the undrained state.
!! All stages solve for increments from the state at t_n, so that one update of the particles by
!! the explicit step's own kernels makes a step. With finite strains every stage is solved by
!! Newton's iterations, at the end of which the state is that of the stage.
module dosui_quasi_static
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, nsig
  use dosui_error, only: error_t
  use dosui_finite_state, only: finite_start_t, refresh_finite
  use dosui_force_balance, only: close_rest
  use dosui_implicit_system, only: add_hourglass_forces, elastic_tangent, implicit_system_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: compressibility_at, content_change, mean_saturation, &
                              saturation_at, wet_masses
  use dosui_progress_watch, only: progress_watch_t
  use dosui_scene, only: table_t
  use dosui_seepage, only: seepage_t
  use dosui_skeleton_step, only: gather_forces, gather_loads, update_particles, zero_velocities
  use dosui_small_state, only: small_start_t
  use dosui_state_check, only: describe_particle, place_of
  use dosui_text, only: to_text
  use dosui_time_control, only: step_limit_t
  use dosui_topology, only: refresh_storage
  use dosui_trouble, only: describe_trouble
  use dosui_water_balance, only: add_to_balance
  use dosui_water_step, only: add_sources, prepare_flow, set_surface_data, water_rate
  implicit none
  private

  real(wp), parameter :: gamma = 2.0_wp - sqrt(2.0_wp)
  real(wp), parameter :: error_constant = (-3.0_wp*gamma**2 + 4.0_wp*gamma - 2.0_wp)/ &
                         (12.0_wp*(2.0_wp - gamma))
  real(wp), parameter :: first_fraction = 1.0e-5_wp   !! of the run: the first step [-]
  real(wp), parameter :: first_load = 1.0e-2_wp       !! likewise of dry soils that yield [-]
  real(wp), parameter :: reject_above = 1.5_wp        !! error over what is allowed [-]
  real(wp), parameter :: largest_growth = 2.0_wp, least_growth = 0.3_wp, safety = 0.9_wp
  real(wp), parameter :: worthwhile = 1.25_wp         !! growth that pays for a new factorisation
  real(wp), parameter :: scale_share = 0.01_wp        !! of the largest pressure, in the norm [-]
  real(wp), parameter :: noise_share = 1.0e-7_wp      !! of the pressures: no error is smaller [-]
  real(wp), parameter :: estimate_tolerance = 1.0e-3_wp   !! of the error's own solution [-]
  integer, parameter :: attempts = 40                 !! at one step: the first may be far too large
  integer, parameter :: solver_attempts = 12          !! of them that fail for the solver
  integer, parameter :: newton_limit = 25             !! iterations of one stage
  integer, parameter :: halvings = 10                 !! of an iteration that would crush a particle
  real(wp), parameter :: newton_tolerance = 1.0e-8_wp   !! last increments over all [-]
  real(wp), parameter :: kink_tolerance = 1.0e-7_wp   !! likewise of small strains, with kinks [-]
  real(wp), parameter :: still = 1.0e-4_wp
  !! of a cell: finite motions are not told apart below this times the tolerance, as logarithms
  !! round off against 1 [-]
  real(wp), parameter :: stiff_share = 1.0e-3_wp      !! of elasticity, after a failed attempt [-]
  integer, parameter :: stiff_steps = 10              !! that keep it
  character(len=*), parameter :: by_accuracy = 'accuracy'   !! limits a step
  integer, parameter :: patience = 8                  !! iterations without a smaller residual
  real(wp), parameter :: worthwhile_fall = 0.9_wp     !! of the residual, to count as smaller [-]
  real(wp), parameter :: swing = 0.7_wp               !! least growth of increments that swing [-]
  real(wp), parameter :: least_relaxation = 0.125_wp  !! of their damping [-]

  type, public :: quasi_static_t
    type(implicit_system_t) :: system
    integer :: n_rejected = 0
    integer :: n_failed = 0          !! solutions that did not converge
    integer :: n_newton = 0          !! iterations so far
    real(wp), private :: stiffening = 0.0_wp   !! share of elasticity in tangents [-]
    integer, private :: n_stiff = 0            !! steps in a row with it
    type(progress_watch_t), private :: watch
    character(len=:), allocatable, private :: trouble   !! where the last failed attempt had it
    logical, private :: is_rough = .false.   !! the next step meets jumps of heads or suctions
    logical, private :: is_moved = .false.   !! the state is not that of the step's start
    type(finite_start_t), private :: start   !! of the present step, finite strains only
    type(small_start_t), private :: small_start   !! likewise, nonlinear small strains
    type(seepage_t), private :: seepage      !! surfaces that choose between head and flux
    real(wp), allocatable :: corner(:)   !! times at which a table changes its slope [s]
    real(wp), allocatable, private :: inflow(:)   !! of the last attempt, for the balance [m3]
  contains
    procedure :: init => quasi_static_init
    procedure :: settle => quasi_static_settle
    procedure :: step => quasi_static_step
    procedure :: describe => quasi_static_describe
    procedure, private :: attempt
    procedure, private :: handle_failure
    procedure, private :: newton_attempt
    procedure, private :: newton
    procedure, private :: take_start
    procedure, private :: move_from_start
    procedure, private :: water_residual
    procedure, private :: force_residual
    procedure, private :: report_forces
    procedure, private :: advance_within
  end type quasi_static_t

  type :: stage_t
    !! A stage of a step that Newton's iterations solve, and how they get on.
    real(wp) :: time = 0.0_wp        !! at its end [s]
    real(wp) :: a = 0.0_wp           !! weight of the flow there [s]
    real(wp), allocatable :: supply(:)     !! of the particles [m3]
    real(wp), allocatable :: start(:)      !! their pressures at the step's start [Pa]
    real(wp), allocatable :: held(:, :)    !! prescribed motion of nodes since then [m]
    logical :: has_held = .false.          !! it is still to come
    real(wp), allocatable :: force(:, :)   !! unbalanced [N]
    real(wp), allocatable :: water(:)      !! missing [m3]
    real(wp), allocatable :: step(:, :), pressure_step(:)   !! the last increment [m], [Pa]
    logical :: damps = .false.       !! swinging increments
    logical :: searches = .false.    !! goes back where the residual grows
    logical :: is_falling = .false.  !! the residual
    real(wp) :: relaxation = 1.0_wp, relaxed = 1.0_wp   !! next and last share of an increment [-]
    real(wp) :: residual = huge(1.0_wp), last_residual = huge(1.0_wp)   !! [-]
    real(wp) :: least_residual = huge(1.0_wp)                           !! [-]
    real(wp) :: motion_change = 0.0_wp, water_change = 0.0_wp   !! last increments over all [-]
    real(wp) :: change = 0.0_wp, last_change = huge(1.0_wp)     !! the larger of them [-]
  end type stage_t

contains

  subroutine quasi_static_init(self, model, err)
    !! Assembles the equations. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :), pressure(:), supply(:)
    integer :: c, n

    if (model%finite) then   ! what follows from the deformation gradients
      call refresh_finite(model, err)
      if (err%failed()) return
    end if
    if (model%unsaturated) then
      n = model%particles%count
      call prepare_linearisation(model, model%clock%time, &
                                 model%particles%field(model%p%pore_pressure)%values(1, 1:n))
    end if
    if (allocated(model%tangent) .and. .not. model%finite) then
      ! stiffness before the first increment
      call allocate_increments(model, motion, pressure, supply)
      call self%small_start%take(model)
      model%clock%dt = 1.0_wp
      call self%small_start%move(model, motion, err)
      if (err%failed()) return
    end if
    call model%timers%start(model%phase%assembly)
    call self%system%build(model, .false., err)
    call model%timers%stop(model%phase%assembly)
    self%corner = [real(wp) ::]
    do c = 1, size(model%scene%mechanical_condition)
      call add_corners(model%scene%mechanical_condition(c)%pattern%factor)
    end do
    do c = 1, size(model%scene%hydraulic_condition)
      call add_corners(model%scene%hydraulic_condition(c)%pattern%factor)
    end do
    self%is_rough = model%unsaturated .and. .not. model%clock%time > 0.0_wp
    call self%watch%init(model%scene%time%end_time, model%clock%time)
    if (.not. model%next_dt > 0.0_wp) then
      model%next_dt = merge(first_fraction, first_load, model%coupled)*model%scene%time%end_time
    end if

  contains

    subroutine add_corners(table)
      !! Adds the times of a table.
      type(table_t), intent(in) :: table

      if (allocated(table%time)) self%corner = [self%corner, table%time]
    end subroutine add_corners
  end subroutine quasi_static_init

  subroutine quasi_static_settle(self, model, err)
    !! Equilibrium with the loads of the present time while the water stays where it is. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :), pressure(:), before(:)
    type(error_t) :: failure
    logical :: changed

    if (model%rigid) return
    call zero_velocities(model)
    model%clock%dt = 1.0_wp
    if (model%finite .or. model%nonlinear) call self%take_start(model)
    do
      call allocate_increments(model, motion, pressure, before)
      failure = error_t()
      call find_settlement(self, model, motion, pressure, failure)
      if (.not. failure%failed()) exit
      if (model%finite .or. model%nonlinear) call self%move_from_start(model, 0.0_wp*motion, err)
      if (.not. err%failed()) call turn_safe(self, model, failure%message, changed, err)
      if (err%failed()) return
      if (changed) cycle
      if (allocated(self%trouble)) failure%message = failure%message//'; '//self%trouble
      call err%set('no equilibrium at t = '//to_text(model%clock%time, 6)//' s: '//failure%message)
      return
    end do
    if (.not. (model%finite .or. model%nonlinear)) then
      model%relaxing = .true.
      call move(model, motion, err)
      model%relaxing = .false.
      if (err%failed()) return
    end if
    call zero_velocities(model)
    if (model%coupled) then
      before = model%particles%field(model%p%pore_pressure)%values(1, 1:size(pressure))
      call add_pressure(model, pressure)
    end if
    call self%report_forces(model, model%clock%time, motion)
    if (.not. model%coupled) return
    if (model%finite) call wet_masses(model, before, before + pressure)
    model%pressure_scale = max(model%pressure_scale, root_mean_square(model, pressure))
  end subroutine quasi_static_settle

  subroutine find_settlement(self, model, motion, pressure, err)
    !! Increments of `settle`. With Newton's iterations the state, but for the pressures, is that of
    !! the end. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: motion(:, :)   !! of the nodes [m]
    real(wp), intent(inout) :: pressure(:)    !! of the particles [Pa]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: held(:, :), supply(:)

    allocate (held, mold=motion)
    allocate (supply, mold=pressure)
    held = 0.0_wp
    supply = 0.0_wp
    if (model%finite .or. model%nonlinear) then
      model%relaxing = .true.
      call self%newton(model, model%clock%time, 0.0_wp, supply, .false., motion, pressure, err)
      model%relaxing = .false.
      return
    end if
    call gather_forces(model)
    call model%timers%start(model%phase%solver)
    call self%system%solve(model, 0.0_wp, model%nodal(2 + ndim:, :), model%clock%time, held, &
                           .false., supply, direct_tolerance(self), .false., motion, pressure, &
                           err)
    call model%timers%stop(model%phase%solver)
  end subroutine find_settlement

  subroutine quasi_static_step(self, model, err)
    !! One accepted step, after as many attempts as it takes; advances the clock. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(error_t) :: failure
    real(wp), allocatable :: motion(:, :), pressure(:)
    real(wp) :: error_norm, growth
    integer :: k, failures
    logical :: changed, is_done

    failures = 0
    is_done = .false.
    call self%seepage%start_step(model)
    if (model%unsaturated) call refresh_storage(model)   ! it follows the pressures
    do k = 1, attempts
      call choose_step(self, model)
      failure = error_t()
      if (model%finite .or. model%nonlinear) then
        call self%newton_attempt(model, motion, pressure, error_norm, failure)
      else
        call self%attempt(model, motion, pressure, error_norm, failure)
      end if
      if (failure%failed()) then
        call self%handle_failure(model, failure, failures, err)
        if (err%failed()) return
        cycle
      end if
      call review_surfaces(self, model, pressure, changed, err)
      if (err%failed()) return
      if (changed) then
        call self%watch%reject()
        cycle
      end if
      growth = largest_growth
      if (error_norm > 0.0_wp) growth = safety*error_norm**(-1.0_wp/3.0_wp)
      growth = min(largest_growth, max(least_growth, growth))
      is_done = error_norm <= reject_above .or. model%scene%time%time_step > 0.0_wp
      if (is_done) exit
      self%n_rejected = self%n_rejected + 1
      call self%watch%reject()
      model%next_dt = growth*model%clock%dt
    end do
    if (.not. is_done) then
      call give_up(self, model, 'no step is accurate enough down to dt = '// &
                   to_text(model%clock%dt, 6)//' s', err)
      return
    end if
    call accept(self, model, motion, pressure, err)
    self%is_rough = .false.
    if (failures == 0 .and. allocated(self%trouble)) deallocate (self%trouble)
    if (growth > 1.0_wp .and. growth < worthwhile) growth = 1.0_wp
    model%next_dt = max(growth, merge(1.0_wp, 0.0_wp, error_norm <= 1.0_wp))*model%clock%dt
    call model%clock%advance()
    self%n_stiff = self%n_stiff + 1
    if (self%n_stiff >= stiff_steps) self%stiffening = 0.0_wp
    call self%watch%accept(model%clock%time, model%clock%limit%name == by_accuracy)
    if (self%watch%is_stuck()) call give_up(self, model, 'no progress', err)
  end subroutine quasi_static_step

  subroutine choose_step(self, model)
    !! The clock's step for the next attempt.
    class(quasi_static_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    type(step_limit_t) :: limits(1)

    limits(1)%name = by_accuracy
    limits(1)%dt = model%next_dt
    if (.not. (model%coupled .or. model%nonlinear)) limits(1)%dt = model%scene%time%end_time
    call model%clock%choose_step(model%scene%time, limits)
    call stop_at_corner(self, model)
    call model%clock%round_step()
  end subroutine choose_step

  subroutine handle_failure(self, model, failure, failures, err)
    !! After an attempt without solution: direct solutions, or a smaller step, or the end.
    !! Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(in) :: failure
    integer, intent(inout) :: failures    !! of this step
    type(error_t), intent(inout) :: err
    logical :: turned

    self%n_failed = self%n_failed + 1
    call turn_safe(self, model, failure%message, turned, err)
    if (err%failed() .or. turned) return
    failures = failures + 1
    call self%watch%fail(model%clock%dt)
    if (.not. self%stiffening > 0.0_wp .and. model%materials%is_nonlinear() .and. &
        .not. model%rigid) then
      self%stiffening = stiff_share   ! once more, with the same step
      self%n_stiff = 0
      return
    end if
    self%stiffening = 0.0_wp
    if (.not. (model%coupled .or. model%nonlinear) .or. failures == solver_attempts .or. &
        self%watch%is_stuck()) then
      call give_up(self, model, failure%message, err)
      return
    end if
    model%next_dt = 0.25_wp*model%clock%dt
    call model%log%warning('steps had no solution and were repeated with a smaller dt', &
                           ': at t = '//to_text(model%clock%time, 6)//' s with dt = '// &
                           to_text(model%next_dt, 3)//' s ('//failure%message//')')
  end subroutine handle_failure

  subroutine give_up(self, model, reason, err)
    !! Ends a run that gets nowhere: why, where, and what it usually means. The model is left with
    !! the state of the last step. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: reason
    type(error_t), intent(inout) :: err
    type(error_t) :: ignored
    real(wp), allocatable :: motion(:, :), pressure(:), supply(:)
    character(len=:), allocatable :: text

    text = 'the quasi-static steps end at t = '//to_text(model%clock%time)//' s: '//reason
    if (allocated(self%trouble)) text = text//'; '//self%trouble
    call err%set(text//' ('//self%watch%describe()//')')
    if (.not. self%is_moved) return
    call allocate_increments(model, motion, pressure, supply)
    call self%move_from_start(model, motion, ignored)
    self%is_moved = .false.
  end subroutine give_up

  subroutine review_surfaces(self, model, pressure, changed, err)
    !! Surface points that choose between head and flux, after an attempt. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! increments [Pa]
    logical, intent(out) :: changed       !! any point: the attempt does not count
    type(error_t), intent(inout) :: err

    changed = .false.
    if (.not. model%switching) return
    associate (start => model%particles%field(model%p%pore_pressure)%values)
      call self%seepage%review(model, model%clock%time + model%clock%dt, &
                               start(1, 1:size(pressure)) + pressure, changed)
    end associate
    if (.not. changed .or. model%finite .or. model%nonlinear) return
    call self%system%build(model, .false., err)
  end subroutine review_surfaces

  function quasi_static_describe(self) result(text)
    !! Repeated steps and linear solutions so far, for the closing summary.
    class(quasi_static_t), intent(in) :: self
    character(len=:), allocatable :: text

    associate (system => self%system%system)
      text = 'steps repeated '//to_text(self%n_rejected)//' for accuracy, '// &
             to_text(self%n_failed)//' for the solver; '//newton_iterations(self%n_newton)// &
             trim(merge('direct   ', 'iterative', system%is_direct))//' solutions '// &
             to_text(system%n_solve)//', set-ups '//to_text(system%n_setup)
      if (.not. system%is_direct) text = text//', iterations '//to_text(system%n_iteration)// &
                                         ' (at most '//to_text(system%most_iterations)//')'
    end associate
  end function quasi_static_describe

  pure function newton_iterations(n) result(text)
    !! Newton's iterations for the closing summary, if there were any.
    integer, intent(in) :: n
    character(len=:), allocatable :: text

    text = ''
    if (n > 0) text = 'Newton''s iterations '//to_text(n)//'; '
  end function newton_iterations

  subroutine turn_safe(self, model, message, turned, err)
    !! After a solution that failed: equations that are more likely to be solved, if there are any.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: message   !! why
    logical, intent(out) :: turned
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: what

    call self%system%turn_safe(model, turned, what)
    if (.not. turned) return
    call model%log%warning(message//'; '//what//' from now on')
    call self%system%build(model, .false., err)
  end subroutine turn_safe

  subroutine stop_at_corner(self, model)
    !! Ends a step where a table changes its slope, and halves the one before.
    class(quasi_static_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp) :: way

    associate (t => model%clock%time, dt => model%clock%dt)
      if (.not. any(self%corner > t*(1.0_wp + 1.0e-12_wp))) return
      way = minval(self%corner, mask=self%corner > t*(1.0_wp + 1.0e-12_wp)) - t
      if (way <= 1.0e-6_wp*dt .or. way >= 2.0_wp*dt) return
      model%clock%dt = merge(way, 0.5_wp*way, way <= dt*(1.0_wp + 1.0e-9_wp))
      model%clock%limit%name = 'corner of a time table'
      model%clock%is_even = .false.
    end associate
  end subroutine stop_at_corner

  subroutine attempt(self, model, motion, pressure, error_norm, err)
    !! Increments of one step and their estimated error over the allowed one.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(inout) :: motion(:, :)   !! of the nodes [m]
    real(wp), allocatable, intent(inout) :: pressure(:)    !! of the particles [Pa]
    real(wp), intent(out) :: error_norm                    !! [-]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: supply(:), held(:, :), start(:), flow(:, :), content(:), force(:, :)
    real(wp), dimension(size(model%balance%inflow), 3) :: inflow
    real(wp) :: t, dt, a
    logical :: has_held

    t = model%clock%time
    dt = model%clock%dt
    a = 0.5_wp*gamma*dt
    error_norm = 0.0_wp
    call allocate_increments(model, motion, pressure, supply)
    allocate (held, mold=motion)
    allocate (force, mold=motion)
    force = 0.0_wp
    if (.not. model%coupled) then
      call solve_stage(t + dt, .false.)
      return
    end if
    associate (n => model%particles%count)
      start = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
      allocate (flow(n, 3))
    end associate
    call find_flow(model, t, start, flow(:, 1), inflow(:, 1))
    call find_flow(model, t + gamma*dt, start, flow(:, 2), inflow(:, 2))
    supply = a*(flow(:, 1) + flow(:, 2))
    call solve_stage(t + gamma*dt, .false.)
    if (err%failed()) return
    call find_flow(model, t + gamma*dt, start + pressure, flow(:, 2), inflow(:, 2))
    content = a*(flow(:, 1) + flow(:, 2))
    call find_flow(model, t + dt, start, flow(:, 3), inflow(:, 3))
    supply = content/(gamma*(2.0_wp - gamma)) + a*flow(:, 3)
    motion = motion/gamma   ! a guess for the whole step
    pressure = pressure/gamma
    call solve_stage(t + dt,.not. self%system%system%is_direct)
    if (err%failed()) return
    call find_flow(model, t + dt, start + pressure, flow(:, 3), inflow(:, 3))
    self%inflow = a*((inflow(:, 1) + inflow(:, 2))/(gamma*(2.0_wp - gamma)) + inflow(:, 3))
    call estimate_error(self, model, a, content_error(dt, flow), start, pressure, error_norm, err)

  contains

    subroutine solve_stage(time, is_guess)
      !! Increments at a time, from `supply` and the forces on the old state.
      real(wp), intent(in) :: time
      logical, intent(in) :: is_guess   !! motion and pressure hold a first guess

      has_held = .false.
      held = 0.0_wp
      if (.not. model%rigid) then
        call zero_velocities(model)
        model%clock%time = time
        call gather_forces(model)
        model%clock%time = t
        force = model%nodal(2 + ndim:, :)
        call self%system%unknowns%prescribe(model, t, time, held, has_held)
      end if
      call check_residual(model, force, supply, err)
      if (err%failed()) return
      call model%timers%start(model%phase%solver)
      call self%system%solve(model, a, force, time, held, has_held, supply, &
                             direct_tolerance(self), is_guess, motion, pressure, err)
      call model%timers%stop(model%phase%solver)
    end subroutine solve_stage
  end subroutine attempt

  subroutine newton_attempt(self, model, motion, pressure, error_norm, err)
    !! As `attempt`, by Newton's iterations. The flow of a stage belongs to its own places. The
    !! state (but for the pressures) is then that of the step's end or of a failed iteration; the
    !! next attempt starts from where this one did.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(inout) :: motion(:, :)   !! of the nodes [m]
    real(wp), allocatable, intent(inout) :: pressure(:)    !! of the particles [Pa]
    real(wp), intent(out) :: error_norm                    !! [-]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: supply(:), start(:), flow(:, :), content(:)
    real(wp), dimension(size(model%balance%inflow), 3) :: inflow
    real(wp) :: t, dt, a

    t = model%clock%time
    dt = model%clock%dt
    a = 0.5_wp*gamma*dt
    error_norm = 0.0_wp
    call allocate_increments(model, motion, pressure, supply)
    if (self%is_moved) call self%move_from_start(model, motion, err)   ! a step that was rejected
    call self%take_start(model)
    self%is_moved = .true.
    if (.not. model%coupled) then
      call self%newton(model, t + dt, a, supply, .false., motion, pressure, err)
      return
    end if
    associate (n => model%particles%count)
      start = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
      allocate (flow(n, 3))
    end associate
    call find_flow(model, t, start, flow(:, 1), inflow(:, 1))
    if (self%is_rough) then   ! backward Euler's step does not turn jumps around
      call self%newton(model, t + dt, dt, supply, .false., motion, pressure, err)
      if (err%failed()) return
      call find_flow(model, t + dt, start + pressure, flow(:, 3), inflow(:, 3))
      self%inflow = dt*inflow(:, 3)
      call estimate_error(self, model, dt, 0.5_wp*dt*(flow(:, 3) - flow(:, 1)), start, pressure, &
                          error_norm, err)
      return
    end if
    supply = a*flow(:, 1)
    call self%newton(model, t + gamma*dt, a, supply, .false., motion, pressure, err)
    if (err%failed()) return
    call find_flow(model, t + gamma*dt, start + pressure, flow(:, 2), inflow(:, 2))
    content = a*(flow(:, 1) + flow(:, 2))
    supply = content/(gamma*(2.0_wp - gamma))
    motion = motion/gamma   ! a guess for the whole step
    pressure = pressure/gamma
    call self%newton(model, t + dt, a, supply, .true., motion, pressure, err)
    if (err%failed()) return
    call find_flow(model, t + dt, start + pressure, flow(:, 3), inflow(:, 3))
    self%inflow = a*((inflow(:, 1) + inflow(:, 2))/(gamma*(2.0_wp - gamma)) + inflow(:, 3))
    call estimate_error(self, model, a, content_error(dt, flow), start, pressure, error_norm, err)
  end subroutine newton_attempt

  subroutine newton(self, model, time, a, supply, is_guess, motion, pressure, err)
    !! Solves one stage by Newton's iterations, from the guess that motion and pressure may hold:
    !! forces are in balance, and water content changes by supply + a F. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time       !! at the end of the stage [s]
    real(wp), intent(in) :: a          !! weight of the flow there [s]
    real(wp), intent(in) :: supply(:)  !! of the particles [m3]
    logical, intent(in) :: is_guess    !! motion and pressure are near the solution, not zero
    real(wp), intent(inout) :: motion(:, :)   !! since the start [m]
    real(wp), intent(inout) :: pressure(:)    !! since the start [Pa]
    type(error_t), intent(inout) :: err
    type(stage_t) :: stage
    integer :: k, n_idle

    call open_stage(self, model, time, a, supply, is_guess, motion, stage)
    call self%move_from_start(model, motion, err)
    call evaluate(self, model, stage, motion, pressure, err)
    n_idle = 0
    do k = 1, newton_limit
      if (err%failed()) return
      call find_increment(self, model, stage, pressure, err)
      if (err%failed()) exit
      call relax_increment(stage)
      stage%water_change = model%comm%maximum(maxval(abs(stage%pressure_step)))
      if (model%unsaturated) then
        call stay_near_kinks(model, stage%start + pressure, stage%pressure_step)
      end if
      call self%advance_within(model, stage%step, stage%pressure_step, motion, pressure, err)
      call measure_change(self, model, stage, motion, pressure)
      call adapt_relaxation(stage, k)
      if (stage%change <= merge(kink_tolerance, newton_tolerance, stage%damps) .and. &
          .not. err%failed()) return
      call evaluate(self, model, stage, motion, pressure, err)
      if (stage%searches .and. .not. stage%has_held) then
        call go_back_while_worse(self, model, stage, motion, pressure, err)
      end if
      stage%has_held = .false.
      n_idle = n_idle + 1
      if (stage%residual < worthwhile_fall*stage%least_residual .or. k == 1) then
        stage%least_residual = stage%residual
        n_idle = 0
      end if
      if (n_idle >= patience .and. stage%damps) exit
    end do
    if (.not. err%failed()) then
      call err%set('Newton''s iterations do not converge (last change '// &
                   to_text(stage%change, 3)//')')
    end if
    call note_trouble(self, model, stage%force, stage%pressure_step, &
                      stage%water_change > stage%motion_change)
  end subroutine newton

  subroutine open_stage(self, model, time, a, supply, is_guess, motion, stage)
    !! What Newton's iterations of a stage start with.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time, a          !! as of `newton` [s]
    real(wp), intent(in) :: supply(:)        !! [m3]
    logical, intent(in) :: is_guess
    real(wp), intent(inout) :: motion(:, :)  !! [m]
    type(stage_t), intent(out) :: stage
    integer :: n

    n = model%particles%count
    stage%time = time
    stage%a = a
    stage%supply = supply
    allocate (stage%held, stage%step, mold=motion)
    allocate (stage%water(n), stage%pressure_step(n), stage%start(n), source=0.0_wp)
    if (model%coupled) then
      stage%start = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
    end if
    stage%held = 0.0_wp
    stage%step = 0.0_wp
    if (.not. model%rigid) then
      call self%system%unknowns%prescribe(model, model%clock%time, time, stage%held, stage%has_held)
    end if
    if (is_guess) then   ! else the first iteration distributes it over the body
      if (stage%has_held) then
        motion = merge(stage%held, motion, self%system%unknowns%is_held)
        call self%system%unknowns%expand(model, motion)
      end if
      stage%has_held = .false.
    end if
    stage%damps = model%nonlinear
    stage%searches = stage%damps .and. .not. model%unsaturated
  end subroutine open_stage

  subroutine find_increment(self, model, stage, pressure, err)
    !! Builds the equations at the trial state and solves them for an increment. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(in) :: pressure(:)   !! since the start [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: none(size(stage%held, 1), size(stage%held, 2)), t

    none = 0.0_wp
    call model%timers%start(model%phase%assembly)
    call add_pressure(model, pressure)   ! its forces turn with the body
    t = model%clock%time
    model%clock%time = stage%time
    if (model%unsaturated) then
      call prepare_linearisation(model, stage%time, stage%start + pressure)
    end if
    if (self%stiffening > 0.0_wp) call stiffen(model, self%stiffening)
    call self%system%build(model, .false., err)
    model%clock%time = t
    call add_pressure(model, -pressure)
    if (model%finite .and. model%coupled .and. .not. err%failed()) then
      ! what is stored and flows belongs to the places that the system was just built for
      call self%water_residual(model, stage%time, stage%a, stage%supply, stage%start, pressure, &
                               stage%water, err)
      stage%residual = residual_norm(self, model, stage%force, stage%water)
    end if
    call model%timers%stop(model%phase%assembly)
    call model%timers%start(model%phase%solver)
    call self%system%solve(model, stage%a, stage%force, stage%time, &
                           merge(stage%held, none, stage%has_held), stage%has_held, stage%water, &
                           direct_tolerance(self), .false., stage%step, stage%pressure_step, err)
    call model%timers%stop(model%phase%solver)
    self%n_newton = self%n_newton + 1
  end subroutine find_increment

  subroutine relax_increment(stage)
    !! Less of an increment while they swing about a kink of suction.
    type(stage_t), intent(inout) :: stage

    stage%is_falling = stage%residual <= (1.0_wp - 0.5_wp*stage%relaxed)*stage%last_residual
    stage%last_residual = stage%residual
    if (.not. stage%damps .or. stage%searches) return
    if (stage%is_falling) stage%relaxation = min(1.0_wp, 4.0_wp*stage%relaxation)
    stage%step = stage%relaxation*stage%step
    stage%pressure_step = stage%relaxation*stage%pressure_step
    stage%relaxed = stage%relaxation
  end subroutine relax_increment

  subroutine measure_change(self, model, stage, motion, pressure)
    !! The last increments over all of them. Collective.
    class(quasi_static_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(in) :: motion(:, :)   !! since the start [m]
    real(wp), intent(in) :: pressure(:)    !! likewise [Pa]
    real(wp) :: scale

    associate (displacement => model%particles%field(model%p%displacement)%values)
      scale = model%comm%maximum(max(maxval(abs(motion)), maxval(abs(displacement)))) + &
              merge(still, newton_tolerance, model%finite)*model%scene%grid_spacing
    end associate
    stage%motion_change = model%comm%maximum(maxval(abs(stage%step)))/scale
    stage%change = stage%motion_change
    if (.not. model%coupled) return
    scale = model%comm%maximum(maxval(abs(stage%start + pressure))) + model%pressure_scale + &
            newton_tolerance*self%system%pressure
    stage%water_change = stage%water_change/scale
    stage%change = max(stage%change, stage%water_change)
  end subroutine measure_change

  subroutine adapt_relaxation(stage, k)
    !! Increments that neither shrink nor bring the residual down are damped.
    type(stage_t), intent(inout) :: stage
    integer, intent(in) :: k   !! iterations done

    if (.not. stage%damps .or. stage%searches) return
    stage%change = stage%change/stage%relaxation
    stage%relaxation = min(1.0_wp, 2.0_wp*stage%relaxation)
    if (k > 2 .and. stage%change > swing*stage%last_change .and. .not. stage%is_falling) then
      stage%relaxation = max(least_relaxation, 0.25_wp*stage%relaxation)
    end if
    stage%last_change = stage%change
  end subroutine adapt_relaxation

  subroutine evaluate(self, model, stage, motion, pressure, err)
    !! Unbalanced forces and missing water of the trial state at hand, and their norm. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(in) :: motion(:, :)   !! since the start [m]
    real(wp), intent(in) :: pressure(:)    !! likewise [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: t

    stage%residual = huge(1.0_wp)
    if (err%failed()) return
    call add_pressure(model, pressure)
    t = model%clock%time
    model%clock%time = stage%time
    call self%force_residual(model, stage%start + pressure, motion, stage%force)
    model%clock%time = t
    call add_pressure(model, -pressure)
    if (model%coupled) then
      call self%water_residual(model, stage%time, stage%a, stage%supply, stage%start, pressure, &
                               stage%water, err)
    end if
    call check_residual(model, stage%force, stage%water, err)
    if (err%failed()) return
    stage%residual = residual_norm(self, model, stage%force, stage%water)
  end subroutine evaluate

  subroutine go_back_while_worse(self, model, stage, motion, pressure, err)
    !! Half of an increment, a quarter, ... where the whole of it makes the residual larger.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(inout) :: motion(:, :)   !! since the start [m]
    real(wp), intent(inout) :: pressure(:)    !! likewise [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: share

    share = 1.0_wp
    do while (stage%residual > stage%last_residual .and. share > least_relaxation .and. &
              .not. err%failed())
      share = 0.5_wp*share
      motion = motion - share*stage%step
      pressure = pressure - share*stage%pressure_step
      call self%move_from_start(model, motion, err)
      call evaluate(self, model, stage, motion, pressure, err)
    end do
  end subroutine go_back_while_worse

  subroutine check_residual(model, force, water, err)
    !! Says where forces or flows are not finite numbers before a solver hears of it. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: force(:, :)   !! of nodes [N]
    real(wp), intent(in) :: water(:)      !! of particles [m3]
    type(error_t), intent(inout) :: err
    integer :: k

    if (.not. abs(sum(force)) <= huge(1.0_wp)) then
      do k = 1, size(force, 2)
        if (all(abs(force(:, k)) <= huge(1.0_wp))) cycle
        call err%set('the force on the body at '// &
                     place_of(model, model%grid%origin + model%grid%spacing* &
                              real(model%grid%node_index(:, k), wp))// &
                     ' is not a finite number: see loads and sources')
      end do
    end if
    if (.not. abs(sum(water)) <= huge(1.0_wp)) then
      do k = 1, size(water)
        if (abs(water(k)) <= huge(1.0_wp)) cycle
        call err%set(describe_particle(model, 'takes up water that is not a finite number', k, &
                                       .true.))
      end do
    end if
    call model%comm%agree(err)
  end subroutine check_residual

  real(wp) function residual_norm(self, model, force, water) result(norm)
    !! Unbalanced forces of free nodes and missing water, in the units of the system [-].
    !! Collective.
    class(quasi_static_t), intent(in) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: force(:, :)   !! [N]
    real(wp), intent(in) :: water(:)      !! [m3]
    real(wp) :: squares
    integer :: k

    squares = sum((water/self%system%volume)**2)
    if (.not. model%rigid) then
      do k = 1, size(force, 2)
        if (.not. model%grid%node_map%is_owned(k)) cycle
        squares = squares + sum((force(:, k)/self%system%force)**2, &
                                mask=.not. self%system%unknowns%is_held(:, k))
      end do
    end if
    norm = sqrt(model%comm%sum(squares))
  end function residual_norm

  subroutine note_trouble(self, model, force, pressure_step, by_water)
    !! Keeps where the worst residual of an attempt without solution is. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: force(:, :)        !! unbalanced [N]
    real(wp), intent(in) :: pressure_step(:)   !! last change [Pa]
    logical, intent(in) :: by_water            !! pressures change more than the skeleton moves
    real(wp), allocatable :: before(:, :)

    if (model%rigid) then
      call describe_trouble(model, force, spread(spread(.true., 1, size(force, 1)), 2, &
                                                 size(force, 2)), pressure_step, .true., before, &
                            self%trouble)
      return
    end if
   if (allocated(self%small_start%stress) .and. .not. model%finite) before = self%small_start%stress
    call describe_trouble(model, force,.not. self%system%unknowns%is_held, pressure_step, &
                          by_water, before, self%trouble)
  end subroutine note_trouble

  subroutine stiffen(model, share)
    !! Mixes elasticity into the tangents: bodies that yield all over have no other resistance.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: share   !! of elasticity [-]
    real(wp) :: tangent(nsig, nsig)
    integer :: p

    if (.not. allocated(model%tangent)) return
    do p = 1, model%particles%count
      call elastic_tangent(model, p, tangent)
      model%tangent(:, :, p) = (1.0_wp - share)*model%tangent(:, :, p) + share*tangent
    end do
  end subroutine stiffen

  pure subroutine stay_near_kinks(model, pressure, step)
    !! Kernel: limits an iteration's changes of pressure where they cross the kink of the retention
    !! curve: beyond it, storage and conductivity are not those that the change was computed with.
    !! Pores that fill stop at zero pressure, suctions at most double or grow by gamma_w/alpha.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: pressure(:)     !! of the particles, before the step [Pa]
    real(wp), intent(inout) :: step(:)      !! [Pa]
    real(wp) :: suction, most
    integer :: p

    do p = 1, size(step)
      associate (curve => model%retention(model%material(p)))
        if (.not. curve%is_active) cycle
        suction = max(0.0_wp, -pressure(p))
        most = suction + max(suction, curve%unit_weight/curve%alpha)
        step(p) = max(step(p), -most - pressure(p))
        if (suction > 0.0_wp) step(p) = min(step(p), suction)
      end associate
    end do
  end subroutine stay_near_kinks

  subroutine prepare_linearisation(model, time, pressure)
    !! Heads, relative conductivities and surface data that the equations are linearised at.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time          !! [s]
    real(wp), intent(in) :: pressure(:)   !! of the particles [Pa]

    call set_surface_data(model, time)
    call prepare_flow(model, pressure)
  end subroutine prepare_linearisation

  subroutine take_start(self, model)
    !! Keeps the state that a step starts from.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    if (model%finite) then
      call self%start%take(model)
    else if (.not. model%rigid) then
      call self%small_start%take(model)
    end if
  end subroutine take_start

  subroutine move_from_start(self, model, motion, err)
    !! Puts the model where a motion of the nodes since the start brings it. Collective.
    class(quasi_static_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! [m]
    type(error_t), intent(inout) :: err

    if (model%finite) then
      call self%start%move(model, motion, err)
    else if (.not. model%rigid) then
      call self%small_start%move(model, motion, err)
    end if
  end subroutine move_from_start

  subroutine water_residual(self, model, time, a, supply, start, pressure, water, err)
    !! Water that a stage's trial state lacks: supply + a F - stored - squeezed [m3]. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time, a            !! of the stage [s]
    real(wp), intent(in) :: supply(:)          !! [m3]
    real(wp), intent(in) :: start(:)           !! pressures at the step's start [Pa]
    real(wp), intent(in) :: pressure(:)        !! since then [Pa]
    real(wp), intent(inout) :: water(:)
    type(error_t), intent(inout) :: err
    real(wp) :: stored(size(water)), pores(size(water))

    if (model%finite .and. .not. model%unsaturated) then
      call find_flow(model, time, start, water)
      call self%system%stored(model, a, pressure, stored, err)
      water = supply + a*water - stored - model%filling* &
              (model%particles%field(model%p%volume)%values(1, 1:size(water)) - self%start%volume)
      return
    end if
    call find_flow(model, time, start + pressure, water)
    call self%system%stored_by_projection(pressure, stored)
    pores = 1.0_wp
    if (model%finite) pores = 0.5_wp + 0.5_wp*self%start%porosity*self%start%volume/ &
                              (model%particles%field(model%p%porosity)%values(1, 1:size(water))* &
                               model%particles%field(model%p%volume)%values(1, 1:size(water)))
    water = supply + a*water - stored - model%weight* &
            (pores*content_change(model, start, start + pressure) - &
             model%storage%compressibility*pressure)
    if (model%rigid) return
    if (model%finite) then   ! mean pores, mean saturation: the difference of their product
      water = water - model%filling*mean_saturation(model, start, start + pressure)* &
              (model%particles%field(model%p%volume)%values(1, 1:size(water)) - self%start%volume)
    else
      water = water - model%weight*model%volume_strain* &
              mean_saturation(model, start, start + pressure)
    end if
  end subroutine water_residual

  subroutine force_residual(self, model, pressure, motion, force)
    !! Complete nodal forces of a trial state, whose pressures are at hand [N]. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)               !! of the particles [Pa]
    real(wp), intent(in) :: motion(:, :)              !! of the nodes since the start [m]
    real(wp), allocatable, intent(inout) :: force(:, :)
    real(wp), allocatable :: velocity(:, :)

    if (model%rigid) then
      force = 0.0_wp*motion
      return
    end if
    associate (field => model%surface%field(model%s%velocity))
      velocity = field%values
      field%values = 0.0_wp   ! the dashpots of penalty walls belong to dynamics
      if (model%finite) then
        call gather_loads(model)
        force = model%nodal(2 + ndim:, :)
        call self%system%internal_forces(model, pressure*saturation_at(model, pressure), force)
      else
        call gather_forces(model)
        force = model%nodal(2 + ndim:, :)
      end if
      field%values = velocity
    end associate
    call add_hourglass_forces(model, motion, force)
    call self%system%unknowns%fold(model, force)
  end subroutine force_residual

  subroutine advance_within(self, model, step, pressure_step, motion, pressure, err)
    !! Adds an increment, or as large a part of it as leaves every particle a volume. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: step(:, :), pressure_step(:)   !! increments [m], [Pa]
    real(wp), intent(inout) :: motion(:, :), pressure(:)      !! since the start [m], [Pa]
    type(error_t), intent(inout) :: err
    type(error_t) :: failure
    integer :: k

    do k = 1, halvings
      failure = error_t()
      call self%move_from_start(model, motion + step, failure)
      if (.not. failure%failed()) exit
      step = 0.5_wp*step
      pressure_step = 0.5_wp*pressure_step
    end do
    if (failure%failed()) err = failure
    motion = motion + step
    pressure = pressure + pressure_step
  end subroutine advance_within

  pure function content_error(dt, flow) result(content)
    !! 2 k dt (F_n/g - F_g/(g (1 - g)) + F_1/(1 - g)) [m3].
    real(wp), intent(in) :: dt            !! [s]
    real(wp), intent(in) :: flow(:, :)    !! F of the particles at the three times [m3/s]
    real(wp) :: content(size(flow, 1))

    content = 2.0_wp*error_constant*dt*(flow(:, 1)/gamma - flow(:, 2)/(gamma*(1.0_wp - gamma)) + &
                                        flow(:, 3)/(1.0_wp - gamma))
  end function content_error

  subroutine estimate_error(self, model, a, content, start, pressure, error_norm, err)
    !! Error of the pressures: that of the content put through the system, in a norm relative to the
    !! excess pressures. A body at rest has none of these; its error is the noise that solutions
    !! leave on the pressures themselves.
    !!
    !! Where pores empty or fill and surfaces switch, flows jump, and the pressures of saturated
    !! pores, which store next to nothing, with them: such an estimate is as large at any step. What
    !! lasts are errors of the water content. An estimate that is too large is therefore put through
    !! the system once more, as what it stores (Hairer & Wanner 1996, IV.8), and at last for the
    !! time of a first step: errors that die away within it do not count.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: a                        !! weight of the flow in the system [s]
    real(wp), intent(in) :: content(:)               !! error of the water content [m3]
    real(wp), intent(in) :: start(:), pressure(:)    !! at t_n, and its increment [Pa]
    real(wp), intent(out) :: error_norm
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :), error_pressure(:), supply(:), excess(:)
    real(wp) :: allowed, first

    error_norm = 0.0_wp
    call allocate_increments(model, motion, error_pressure, supply)
    call solve_error(self, model, a, content, motion, error_pressure, err)
    if (err%failed()) return
    excess = start + pressure - &
             model%particles%field(model%p%start_pressure)%values(1, 1:size(pressure))
    allowed = root_mean_square(model, excess)
    model%pressure_scale = max(model%pressure_scale, allowed)
    allowed = model%scene%time%relative_tolerance*(allowed + scale_share*model%pressure_scale) + &
              noise_share*root_mean_square(model, start + pressure)
    if (.not. allowed > 0.0_wp) return
    error_norm = root_mean_square(model, error_pressure)/allowed
    if (.not. (model%unsaturated .or. model%switching)) return
    first = first_fraction*model%scene%time%end_time
    if (error_norm > 1.0_wp) call keep_what_lasts(a)
    if (error_norm > 1.0_wp .and. first > a) call keep_what_lasts(first)

  contains

    subroutine keep_what_lasts(weight)
      !! Of the error: what is left of it after some time.
      real(wp), intent(in) :: weight   !! [s]

      if (err%failed()) return
      call stored_water(self, model, start + pressure, motion, error_pressure, supply)
      call solve_error(self, model, weight, supply, motion, error_pressure, err)
      if (err%failed()) return
      error_norm = min(error_norm, root_mean_square(model, error_pressure)/allowed)
    end subroutine keep_what_lasts
  end subroutine estimate_error

  subroutine solve_error(self, model, a, supply, motion, pressure, err)
    !! Motions and pressures that water supplied without any load brings.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: a                    !! weight of the flow [s]
    real(wp), intent(in) :: supply(:)            !! [m3]
    real(wp), intent(inout) :: motion(:, :)      !! [m]
    real(wp), intent(inout) :: pressure(:)       !! [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: zero(size(motion, 1), size(motion, 2))

    zero = 0.0_wp
    call model%timers%start(model%phase%solver)
    call self%system%solve(model, a, zero, model%clock%time, zero, .false., supply, &
                           max(estimate_tolerance, self%system%tolerance), .false., motion, &
                           pressure, err, without_loads=.true.)
    call model%timers%stop(model%phase%solver)
  end subroutine solve_error

  subroutine stored_water(self, model, state, motion, pressure, stored)
    !! Water that small changes of motions and pressures store.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: state(:)         !! pressures that are changed [Pa]
    real(wp), intent(in) :: motion(:, :)     !! change [m]
    real(wp), intent(in) :: pressure(:)      !! likewise [Pa]
    real(wp), intent(inout) :: stored(:)     !! [m3]
    real(wp) :: squeezed(size(stored))

    call self%system%stored_by_projection(pressure, stored)
    if (model%unsaturated) stored = stored + model%weight*pressure* &
                                    (compressibility_at(model, state) - &
                                     model%storage%compressibility)
    if (model%rigid) return
    call self%system%volume_change(motion, squeezed)
    stored = stored + squeezed
  end subroutine stored_water

  subroutine accept(self, model, motion, pressure, err)
    !! Puts the increments of a step on particles and surface points.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    real(wp), intent(in) :: pressure(:)    !! increments [Pa]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: before(:)

    if (model%finite) then
      call finish_finite(self, model)
    else if (model%nonlinear) then
      self%is_moved = .false.   ! the state is there already
    else if (size(motion) > 0 .and. .not. model%rigid) then
      call zero_velocities(model)
      call move(model, motion/model%clock%dt, err)
    end if
    if (model%coupled) then
      before = model%particles%field(model%p%pore_pressure)%values(1, 1:size(pressure))
      call add_pressure(model, pressure)
    end if
    call self%report_forces(model, model%clock%time + model%clock%dt, motion)
    if (.not. model%coupled) return
    call add_to_balance(model, self%inflow, before, before + pressure)
    call wet_masses(model, before, before + pressure)
  end subroutine accept

  subroutine report_forces(self, model, time, motion)
    !! Forces of walls in an equilibrium that has been found, with its loads and masses. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time           !! of the equilibrium [s]
    real(wp), intent(in) :: motion(:, :)   !! of the nodes that led to it [m]
    real(wp), allocatable :: force(:, :), pressure(:)
    real(wp) :: now

    now = model%clock%time
    call model%reactions%want(time, model%clock%dt, int(model%clock%step, i8) + &
                              merge(1_i8, 0_i8, time > now))
    if (.not. model%reactions%is_wanted) return
    allocate (force, mold=motion)
    allocate (pressure(model%particles%count), source=0.0_wp)
    if (model%coupled) pressure = model%particles%field(model%p%pore_pressure)% &
                                  values(1, 1:size(pressure))
    model%clock%time = time
    call self%force_residual(model, pressure, motion, force)
    model%clock%time = now
    call close_rest(model, force)
  end subroutine report_forces

  subroutine finish_finite(self, model)
    !! Velocities and volume changes of a step that is accepted; the state is there already.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    integer :: n, m

    n = model%particles%count
    m = model%surface%count
    self%is_moved = .false.
    associate (field => model%particles%field, h => model%p)
      field(h%velocity)%values(:, 1:n) = (field(h%displacement)%values(:, 1:n) - &
                                          self%start%displacement)/model%clock%dt
      if (model%coupled) model%volume_strain = &
        (1.0_wp - self%start%volume/field(h%volume)%values(1, 1:n))
    end associate
    associate (field => model%surface%field, h => model%s)
      field(h%velocity)%values(:, 1:m) = (field(h%displacement)%values(:, 1:m) - &
                                          self%start%surface_displacement)/model%clock%dt
    end associate
  end subroutine finish_finite

  subroutine move(model, velocity, err)
    !! Moves particles and surface points with the nodes.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: velocity(:, :)   !! of the nodes over the clock's step [m/s]
    type(error_t), intent(inout) :: err

    model%velocity_old = 0.0_wp
    model%velocity = velocity
    call update_particles(model, err)
  end subroutine move

  subroutine add_pressure(model, pressure)
    !! Adds increments to the particles' pressures.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! [Pa]

    if (.not. model%coupled) return
    associate (values => model%particles%field(model%p%pore_pressure)%values, &
               n => model%particles%count)
      values(1, 1:n) = values(1, 1:n) + pressure(1:n)
    end associate
  end subroutine add_pressure

  subroutine find_flow(model, time, pressure, flow, inflow)
    !! F: water that flows into each particle per time [m3/s].
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time          !! of the surfaces' heads and fluxes [s]
    real(wp), intent(in) :: pressure(:)   !! [Pa]
    real(wp), intent(out) :: flow(:)
    real(wp), intent(out), optional :: inflow(:)    !! through surfaces, for the balance [m3/s]
    real(wp) :: through(size(model%balance%inflow))

    call model%timers%start(model%phase%water)
    call set_surface_data(model, time)
    call water_rate(model, pressure, flow)
    call add_sources(model, time, flow, through)
    if (present(inflow)) inflow = through
    flow = flow*model%weight
    call model%timers%stop(model%phase%water)
  end subroutine find_flow

  subroutine allocate_increments(model, motion, pressure, supply)
    !! Zero increments.
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: motion(:, :), pressure(:), supply(:)

    allocate (motion(ndim, model%grid%n_node), source=0.0_wp)
    allocate (pressure(model%particles%count), supply(model%particles%count), source=0.0_wp)
  end subroutine allocate_increments

  real(wp) function root_mean_square(model, values) result(norm)
    !! Weighted by volume, over all ranks.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: values(:)   !! of the particles
    real(wp) :: sums(2)

    sums = [sum(model%weight*values**2), sum(model%weight)]
    call model%comm%sum_array(sums)
    norm = sqrt(sums(1)/sums(2))
  end function root_mean_square

  pure real(wp) function direct_tolerance(self) result(tolerance)
    !! Factorised systems are solved to round-off, others to the scene's tolerance.
    class(quasi_static_t), intent(in) :: self

    tolerance = self%system%tolerance
    if (self%system%system%is_direct) tolerance = 1.0e-13_wp
  end function direct_tolerance
end module dosui_quasi_static

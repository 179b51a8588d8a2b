!! Quasi-static steps: skeleton and water solved together without inertia, by TR-BDF2 with an
!! estimate of its error [Bank1985, Hosea1996].
!!
!! Momentum holds at every stage; the water content c with dc/dt = F(p) is stepped:
!!     c_g = c_n + a (F_n + F_g)                        a = g dt/2, g = 2 - sqrt(2)
!!     c_1 = (c_g/g - (1 - g)^2/g c_n)/(2 - g) + a F_1
!! Loads that come at once are answered by a solution without flow (a = 0): the undrained state.
!! All stages solve for increments from the state at t_n (`dosui_stage_solver`); how these move the
!! skeleton is the formulation's business.
module dosui_quasi_static
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_force_balance, only: close_rest
  use dosui_integrator, only: integrator_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: add_pressure, wet_masses
  use dosui_progress_watch, only: n_watch_memory, progress_watch_t
  use dosui_seepage, only: seepage_t
  use dosui_skeleton_step, only: zero_velocities
  use dosui_stage_solver, only: stage_solver_t
  use dosui_state_check, only: check_state
  use dosui_step_error, only: content_error, estimate_error, first_fraction, gamma, &
                              root_mean_square
  use dosui_text, only: to_text
  use dosui_time_control, only: step_limit_t
  use dosui_topology, only: refresh_storage
  use dosui_water_balance, only: add_to_balance
  use dosui_water_step, only: find_flow
  implicit none
  private

  real(wp), parameter :: first_load = 1.0e-2_wp   !! of the run: first step of dry soils that yield
  real(wp), parameter :: reject_above = 1.5_wp        !! error over what is allowed [-]
  real(wp), parameter :: largest_growth = 2.0_wp, least_growth = 0.3_wp, safety = 0.9_wp
  real(wp), parameter :: worthwhile = 1.25_wp         !! growth that pays for a new factorisation
  integer, parameter :: attempts = 40                 !! at one step: the first may be far too large
  integer, parameter :: solver_attempts = 12          !! of them that fail for the solver
  real(wp), parameter :: stiff_share = 1.0e-3_wp      !! of elasticity, after a failed attempt [-]
  integer, parameter :: stiff_steps = 10              !! that keep it
  character(len=*), parameter :: by_accuracy = 'accuracy'   !! limits a step

  type, extends(integrator_t), public :: quasi_static_t
    type(stage_solver_t) :: solver
    integer :: n_rejected = 0
    integer :: n_failed = 0          !! solutions that did not converge
    integer, private :: n_stiff = 0            !! steps in a row with stiffened tangents
    type(progress_watch_t), private :: watch
    logical, private :: is_rough = .false.   !! the next step meets jumps of heads or suctions
    type(seepage_t), private :: seepage      !! surfaces that choose between head and flux
    real(wp), allocatable :: corner(:)   !! times at which a table changes its slope [s]
    real(wp), allocatable, private :: inflow(:)   !! of the last attempt, for the balance [m3]
  contains
    procedure :: init => quasi_static_init
    procedure :: start => quasi_static_start
    procedure :: settle => quasi_static_settle
    procedure :: choose_step => quasi_static_choose_step
    procedure :: step => quasi_static_step
    procedure :: describe => quasi_static_describe
    procedure :: announce => quasi_static_announce
    procedure :: memory => quasi_static_memory
    procedure :: recall => quasi_static_recall
    procedure, private :: attempt
    procedure, private :: handle_failure
    procedure, private :: report_forces
  end type quasi_static_t

contains

  subroutine quasi_static_init(self, model, err)
    !! Assembles the equations. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer :: c

    call self%solver%init(model, err)
    if (err%failed()) return
    self%corner = [real(wp) ::]
    do c = 1, size(model%scene%mechanical_condition)
      self%corner = [self%corner, model%scene%mechanical_condition(c)%pattern%corners(ndim)]
    end do
    do c = 1, size(model%scene%hydraulic_condition)
      self%corner = [self%corner, model%scene%hydraulic_condition(c)%pattern%corners(ndim)]
    end do
    self%is_rough = model%unsaturated .and. .not. model%clock%time > 0.0_wp
    call self%watch%init(model%scene%time%end_time, model%clock%time)
    if (.not. model%next_dt > 0.0_wp) then
      model%next_dt = merge(first_fraction, first_load, model%coupled)*model%scene%time%end_time
    end if
  end subroutine quasi_static_init

  subroutine quasi_static_start(self, model, err)
    !! Equilibrium with the loads of the start. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call self%settle(model, err)
    if (.not. err%failed()) call check_state(model, err)
  end subroutine quasi_static_start

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
    do
      call allocate_increments(model, motion, pressure, before)
      call self%solver%open_step(model, err)
      if (err%failed()) return
      failure = error_t()
      model%relaxing = .true.
      call self%solver%solve(model, model%clock%time, 0.0_wp, before, .false., motion, pressure, &
                             failure)
      model%relaxing = .false.
      if (.not. failure%failed()) exit
      if (model%is_interrupted) err = failure
      if (model%is_interrupted) return
      call self%solver%go_back(model, err)
      if (.not. err%failed()) call self%solver%turn_safe(model, failure%message, changed, err)
      if (err%failed()) return
      if (changed) cycle
      if (allocated(self%solver%trouble)) then
        failure%message = failure%message//'; '//self%solver%trouble
      end if
      call err%set('no equilibrium at t = '//to_text(model%clock%time, 6)//' s: '//failure%message)
      return
    end do
    model%relaxing = .true.
    call self%solver%close_step(model, motion, err)
    model%relaxing = .false.
    if (err%failed()) return
    call zero_velocities(model)
    if (model%coupled) then
      before = model%particles%field(model%p%pore_pressure)%values(1, 1:size(pressure))
      call add_pressure(model, pressure)
    end if
    call self%report_forces(model, model%clock%time, motion)
    if (.not. model%coupled) return
    if (self%solver%formulation%follows_places) call wet_masses(model, before, before + pressure)
    model%scales%pressure_scale = max(model%scales%pressure_scale, &
                                      root_mean_square(model, pressure))
  end subroutine quasi_static_settle

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
      call self%choose_step(model)
      failure = error_t()
      call self%attempt(model, motion, pressure, error_norm, failure)
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
    if (failures == 0 .and. allocated(self%solver%trouble)) deallocate (self%solver%trouble)
    if (growth > 1.0_wp .and. growth < worthwhile) growth = 1.0_wp
    model%next_dt = max(growth, merge(1.0_wp, 0.0_wp, error_norm <= 1.0_wp))*model%clock%dt
    call model%clock%advance()
    self%n_stiff = self%n_stiff + 1
    if (self%n_stiff >= stiff_steps) self%solver%stiffening = 0.0_wp
    call self%watch%accept(model%clock%time, model%clock%limit%name == by_accuracy)
    if (self%watch%is_stuck()) call give_up(self, model, 'no progress', err)
  end subroutine quasi_static_step

  subroutine quasi_static_choose_step(self, model)
    !! The clock's step for the next attempt.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(step_limit_t) :: limits(1)

    limits(1)%name = by_accuracy
    limits(1)%dt = model%next_dt
    if (.not. (model%coupled .or. model%nonlinear)) limits(1)%dt = model%scene%time%end_time
    call model%clock%choose_step(model%scene%time, limits)
    call stop_at_corner(self, model)
    call model%clock%round_step()
  end subroutine quasi_static_choose_step

  subroutine quasi_static_announce(self, model)
    !! Nothing: errors will choose the steps.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model

    associate (not_used => self, nor => model)
    end associate
  end subroutine quasi_static_announce

  pure function quasi_static_memory(self) result(values)
    !! The watch, stiffened tangents and the equations.
    class(quasi_static_t), intent(in) :: self
    real(wp), allocatable :: values(:)   !! [several units]

    values = [self%watch%memory(), real(self%n_stiff, wp), self%solver%stiffening, &
              self%solver%system%memory()]
  end function quasi_static_memory

  subroutine quasi_static_recall(self, model, values, err)
    !! Goes on watching, stiffening and solving as before. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: values(:)   !! as from `memory` [several units]
    type(error_t), intent(inout) :: err

    associate (n => n_watch_memory)
      call self%watch%recall(values(:n))
      self%n_stiff = nint(values(n + 1))
      self%solver%stiffening = values(n + 2)
      call self%solver%system%recall(model, values(n + 3:), err)
    end associate
  end subroutine quasi_static_recall

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
    call self%solver%turn_safe(model, failure%message, turned, err)
    if (err%failed() .or. turned) return
    failures = failures + 1
    call self%watch%fail(model%clock%dt)
    if (.not. self%solver%stiffening > 0.0_wp .and. model%materials%is_nonlinear() .and. &
        .not. model%rigid) then
      self%solver%stiffening = stiff_share   ! once more, with the same step
      self%n_stiff = 0
      return
    end if
    self%solver%stiffening = 0.0_wp
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
    character(len=:), allocatable :: text

    text = 'the quasi-static steps end at t = '//to_text(model%clock%time)//' s: '//reason
    if (allocated(self%solver%trouble)) text = text//'; '//self%solver%trouble
    call err%set(text//' ('//self%watch%describe()//')')
    call self%solver%go_back(model, ignored)
  end subroutine give_up

  subroutine review_surfaces(self, model, pressure, changed, err)
    !! Surface points that choose between head and flux, after an attempt. Collective.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! increments [Pa]
    logical, intent(out) :: changed       !! any point: the attempt does not count
    type(error_t), intent(inout) :: err

    changed = .false.
    if (.not. model%water%switching) return
    associate (start => model%particles%field(model%p%pore_pressure)%values)
      call self%seepage%review(model, model%clock%time + model%clock%dt, &
                               start(1, 1:size(pressure)) + pressure, changed)
    end associate
    if (changed .and. self%solver%formulation%is_linear) then
      call self%solver%system%build(model, .false., err)
    end if
  end subroutine review_surfaces

  function quasi_static_describe(self) result(text)
    !! Repeated steps and linear solutions so far, for the closing summary.
    class(quasi_static_t), intent(in) :: self
    character(len=:), allocatable :: text

    associate (system => self%solver%system%system)
      text = 'steps repeated '//to_text(self%n_rejected)//' for accuracy, '// &
             to_text(self%n_failed)//' for the solver; '// &
             newton_iterations(self%solver%n_newton)// &
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
    !! Increments of one step and their estimated error over the allowed one. Stages that need
    !! Newton's iterations leave the model in the state of the step's end, but for the pressures, or
    !! of a failed iteration; the next attempt starts from where this one did.
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
    call self%solver%open_step(model, err)
    if (.not. model%coupled) then
      call self%solver%solve(model, t + dt, a, supply, .false., motion, pressure, err)
      return
    end if
    associate (n => model%particles%count)
      start = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
      allocate (flow(n, 3))
    end associate
    call find_flow(model, t, start, flow(:, 1), inflow(:, 1))
    if (self%is_rough) then   ! backward Euler's step does not turn jumps around
      call self%solver%solve(model, t + dt, dt, supply, .false., motion, pressure, err)
      if (err%failed()) return
      call find_flow(model, t + dt, start + pressure, flow(:, 3), inflow(:, 3))
      self%inflow = dt*inflow(:, 3)
      call estimate_error(self%solver%system, model, dt, 0.5_wp*dt*(flow(:, 3) - flow(:, 1)), &
                          start, pressure, error_norm, err)
      return
    end if
    call self%solver%solve(model, t + gamma*dt, a, a*flow(:, 1), .false., motion, pressure, err)
    if (err%failed()) return
    call find_flow(model, t + gamma*dt, start + pressure, flow(:, 2), inflow(:, 2))
    content = a*(flow(:, 1) + flow(:, 2))
    motion = motion/gamma   ! a guess for the whole step
    pressure = pressure/gamma
    call self%solver%solve(model, t + dt, a, content/(gamma*(2.0_wp - gamma)), .true., motion, &
                           pressure, err)
    if (err%failed()) return
    call find_flow(model, t + dt, start + pressure, flow(:, 3), inflow(:, 3))
    self%inflow = a*((inflow(:, 1) + inflow(:, 2))/(gamma*(2.0_wp - gamma)) + inflow(:, 3))
    call estimate_error(self%solver%system, model, a, content_error(dt, flow), start, pressure, &
                        error_norm, err)
  end subroutine attempt

  subroutine accept(self, model, motion, pressure, err)
    !! Puts the increments of a step on particles and surface points.
    class(quasi_static_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    real(wp), intent(in) :: pressure(:)    !! increments [Pa]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: before(:)

    call self%solver%close_step(model, motion, err)
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
    real(wp), allocatable :: force(:, :)

    call model%reactions%want(time, model%clock%dt, int(model%clock%step, i8) + &
                              merge(1_i8, 0_i8, time > model%clock%time))
    if (.not. model%reactions%is_wanted) return
    allocate (force, mold=motion)
    call self%solver%find_forces(model, time, force, motion)
    call close_rest(model, force)
  end subroutine report_forces

  subroutine allocate_increments(model, motion, pressure, supply)
    !! Zero increments.
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: motion(:, :), pressure(:), supply(:)

    allocate (motion(ndim, model%grid%n_node), source=0.0_wp)
    allocate (pressure(model%particles%count), supply(model%particles%count), source=0.0_wp)
  end subroutine allocate_increments
end module dosui_quasi_static

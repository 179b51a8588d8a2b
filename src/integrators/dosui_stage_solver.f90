!! One stage of an implicit step: the motion and the pressures at which forces are in balance and
!! the water's content has changed by supply + a F. Linear equations take one solution, others
!! Newton's iterations, which damp, search and go back where soils yield and pores empty.
module dosui_stage_solver
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_formulation, only: formulation_t, stage_data_t
  use dosui_hourglass, only: elastic_tangent
  use dosui_implicit_system, only: implicit_system_t
  use dosui_interruption, only: look_for_interruption
  use dosui_model, only: model_t
  use dosui_pore_water, only: add_pressure
  use dosui_rigid_skeleton, only: rigid_skeleton_t
  use dosui_skeleton_step, only: zero_velocities
  use dosui_small_strain, only: small_strain_t
  use dosui_state_check, only: describe_particle, place_of
  use dosui_text, only: to_text
  use dosui_total_lagrangian, only: total_lagrangian_t
  use dosui_trouble, only: describe_trouble
  use dosui_water_step, only: find_flow, prepare_flow, set_surface_data
  implicit none
  private

  integer, parameter :: newton_limit = 25             !! iterations of one stage ...
  integer, parameter :: start_limit = 100             !! ... of a start, which has no smaller step
  integer, parameter :: halvings = 10                 !! of an iteration that would crush a particle
  real(wp), parameter :: newton_tolerance = 1.0e-8_wp   !! last increments over all [-]
  real(wp), parameter :: kink_tolerance = 1.0e-7_wp   !! likewise of small strains, with kinks [-]
  integer, parameter :: patience = 8                  !! iterations without a smaller residual
  real(wp), parameter :: worthwhile_fall = 0.9_wp     !! of the residual, to count as smaller [-]
  real(wp), parameter :: swing = 0.7_wp               !! least growth of increments that swing [-]
  real(wp), parameter :: least_relaxation = 0.125_wp  !! of their damping [-]

  type, public :: stage_solver_t
    type(implicit_system_t) :: system
    class(formulation_t), allocatable :: formulation
    integer :: n_newton = 0               !! iterations so far
    real(wp) :: stiffening = 0.0_wp       !! share of elasticity in tangents [-]
    character(len=:), allocatable :: trouble   !! where the last stage without solution had it
    logical, private :: is_moved = .false.     !! the state is not that of the step's start
  contains
    procedure :: init => solver_init
    procedure :: open_step => solver_open_step
    procedure :: solve => solver_solve
    procedure :: close_step => solver_close_step
    procedure :: go_back => solver_go_back
    procedure :: find_forces => solver_find_forces
    procedure :: turn_safe => solver_turn_safe
    procedure :: tolerance => solver_tolerance
  end type stage_solver_t

  type, extends(stage_data_t) :: stage_t
    !! A stage that Newton's iterations solve, and how they get on.
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

  subroutine solver_init(self, model, err)
    !! Takes the formulation that the model asks for, and assembles the equations. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    if (allocated(self%formulation)) deallocate (self%formulation)
    if (model%rigid) then
      allocate (rigid_skeleton_t :: self%formulation)
    else if (model%finite) then
      allocate (total_lagrangian_t :: self%formulation)
    else
      allocate (small_strain_t :: self%formulation)
    end if
    call self%formulation%linearise(model, err)
    if (err%failed()) return
    if (model%unsaturated) then   ! where the body is now
      call linearise_flow(model, model%clock%time, model%particles%field(model%p%pore_pressure)% &
                          values(1, 1:model%particles%count))
    end if
    call model%timers%start(model%phase%assembly)
    call self%system%build(model, .false., err)
    call model%timers%stop(model%phase%assembly)
  end subroutine solver_init

  subroutine solver_open_step(self, model, err)
    !! Motions count from the present state, or from where a step that was rejected began.
    !! Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call self%go_back(model, err)
    call self%formulation%take_start(model)
    self%is_moved = .not. self%formulation%is_linear
  end subroutine solver_open_step

  subroutine solver_close_step(self, model, motion, err)
    !! Accepts a step of the clock's length: the model has the state at its end, but for the
    !! pressures. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! (ndim, n_node) since the start [m]
    type(error_t), intent(inout) :: err

    if (self%formulation%is_linear) call self%formulation%move_to(model, motion, err)
    call self%formulation%accept(model)
    self%is_moved = .false.
  end subroutine solver_close_step

  subroutine solver_go_back(self, model, err)
    !! Gives the model the state of the step's start, if it has another. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :)

    if (.not. self%is_moved) return
    allocate (motion, mold=model%skeleton%velocity)
    motion = 0.0_wp
    call self%formulation%move_to(model, motion, err)
    self%is_moved = .false.
  end subroutine solver_go_back

  subroutine solver_find_forces(self, model, time, force, motion)
    !! Forces on the nodes in the state at hand with the loads of some time. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time                     !! [s]
    real(wp), intent(inout) :: force(:, :)           !! (ndim, n_node) [N]
    real(wp), intent(in), optional :: motion(:, :)   !! (ndim, n_node) since the start [m]
    real(wp) :: now

    now = model%clock%time
    model%clock%time = time
    call self%formulation%find_forces(self%system, model, force, motion)
    model%clock%time = now
  end subroutine solver_find_forces

  subroutine solver_solve(self, model, time, a, supply, is_guess, motion, pressure, err)
    !! Solves one stage, from the guess that motion and pressure may hold: forces are in balance,
    !! and water content changes by supply + a F. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time       !! at the end of the stage [s]
    real(wp), intent(in) :: a          !! weight of the flow there [s]
    real(wp), intent(in) :: supply(:)  !! of the particles [m3]
    logical, intent(in) :: is_guess    !! motion and pressure are near the solution, not zero
    real(wp), intent(inout) :: motion(:, :)   !! (ndim, n_node) since the start [m]
    real(wp), intent(inout) :: pressure(:)    !! of the particles since the start [Pa]
    type(error_t), intent(inout) :: err
    type(stage_t) :: stage
    integer :: n

    n = model%particles%count
    stage%time = time
    stage%flow_weight = a
    stage%supply = supply
    allocate (stage%start(n), source=0.0_wp)
    if (model%coupled) stage%start = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
    if (self%formulation%is_linear) then
      call solve_linear(self, model, stage, is_guess, motion, pressure, err)
    else
      call solve_nonlinear(self, model, stage, is_guess, motion, pressure, err)
    end if
  end subroutine solver_solve

  subroutine solve_linear(self, model, stage, is_guess, motion, pressure, err)
    !! The equations are those of the start: its forces under the loads of the stage, and the flow
    !! of its pressures with the heads of the stage. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    logical, intent(in) :: is_guess
    real(wp), intent(inout) :: motion(:, :)   !! [m]
    real(wp), intent(inout) :: pressure(:)    !! [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: flow(size(pressure))

    associate (a => stage%flow_weight)
      if (model%coupled .and. a > 0.0_wp) then
        call find_flow(model, stage%time, stage%start, flow)
        stage%supply = stage%supply + a*flow
      end if
      allocate (stage%held, stage%force, mold=motion)
      stage%held = 0.0_wp
      stage%force = 0.0_wp
      if (.not. model%rigid) then
        call zero_velocities(model)
        call self%find_forces(model, stage%time, stage%force)
        call self%system%unknowns%prescribe(model, model%clock%time, stage%time, stage%held, &
                                            stage%has_held)
      end if
      call check_residual(model, stage%force, stage%supply, err)
      if (err%failed()) return
      call model%timers%start(model%phase%solver)
      call self%system%solve(model, a, stage%force, stage%time, stage%held, stage%has_held, &
                             stage%supply, self%tolerance(), &
                             is_guess .and. .not. self%system%system%is_direct, motion, pressure, &
                             err)
      call model%timers%stop(model%phase%solver)
    end associate
  end subroutine solve_linear

  subroutine solve_nonlinear(self, model, stage, is_guess, motion, pressure, err)
    !! Newton's iterations. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    logical, intent(in) :: is_guess    !! motion and pressure are near the solution, not zero
    real(wp), intent(inout) :: motion(:, :)   !! since the start [m]
    real(wp), intent(inout) :: pressure(:)    !! since the start [Pa]
    type(error_t), intent(inout) :: err
    integer :: k, n_idle

    call open_stage(self, model, is_guess, motion, stage)
    call self%formulation%move_to(model, motion, err)
    call evaluate(self, model, stage, motion, pressure, err)
    n_idle = 0
    do k = 1, merge(start_limit, newton_limit, model%relaxing)
      if (model%relaxing) call look_for_interruption(model, err)
      if (err%failed()) return
      call find_increment(self, model, stage, pressure, err)
      if (err%failed()) exit
      call relax_increment(stage)
      stage%water_change = model%comm%maximum(maxval(abs(stage%pressure_step)))
      if (model%unsaturated) then
        call stay_near_kinks(model, stage%start + pressure, stage%pressure_step)
      end if
      call advance_within(self, model, stage%step, stage%pressure_step, motion, pressure, err)
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
  end subroutine solve_nonlinear

  subroutine open_stage(self, model, is_guess, motion, stage)
    !! What Newton's iterations of a stage start with.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_guess
    real(wp), intent(inout) :: motion(:, :)  !! [m]
    type(stage_t), intent(inout) :: stage
    integer :: n

    n = model%particles%count
    allocate (stage%held, stage%step, stage%force, mold=motion)
    allocate (stage%water(n), stage%pressure_step(n), source=0.0_wp)
    stage%held = 0.0_wp
    stage%step = 0.0_wp
    if (.not. model%rigid) then
      call self%system%unknowns%prescribe(model, model%clock%time, stage%time, stage%held, &
                                          stage%has_held)
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
    class(stage_solver_t), intent(inout) :: self
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
      call linearise_flow(model, stage%time, stage%start + pressure)
    end if
    if (self%stiffening > 0.0_wp) call stiffen(model, self%stiffening)
    call self%system%build(model, .false., err)
    model%clock%time = t
    call add_pressure(model, -pressure)
    if (self%formulation%follows_places .and. model%coupled .and. .not. err%failed()) then
      ! what is stored and flows belongs to the places that the system was just built for
      call self%formulation%find_missing_water(self%system, model, stage, pressure, &
                                               stage%water, err)
      stage%residual = residual_norm(self, model, stage%force, stage%water)
    end if
    call model%timers%stop(model%phase%assembly)
    call model%timers%start(model%phase%solver)
    call self%system%solve(model, stage%flow_weight, stage%force, stage%time, &
                           merge(stage%held, none, stage%has_held), stage%has_held, stage%water, &
                           self%tolerance(), .false., stage%step, stage%pressure_step, err)
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
    class(stage_solver_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(in) :: motion(:, :)   !! since the start [m]
    real(wp), intent(in) :: pressure(:)    !! likewise [Pa]
    real(wp) :: scale

    associate (displacement => model%particles%field(model%p%displacement)%values)
      scale = model%comm%maximum(max(maxval(abs(motion)), maxval(abs(displacement)))) + &
              self%formulation%least_motion*model%scene%grid_spacing
    end associate
    stage%motion_change = model%comm%maximum(maxval(abs(stage%step)))/scale
    stage%change = stage%motion_change
    if (.not. model%coupled) return
    scale = model%comm%maximum(maxval(abs(stage%start + pressure))) + &
            model%scales%pressure_scale + &
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
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(stage_t), intent(inout) :: stage
    real(wp), intent(in) :: motion(:, :)   !! since the start [m]
    real(wp), intent(in) :: pressure(:)    !! likewise [Pa]
    type(error_t), intent(inout) :: err

    stage%residual = huge(1.0_wp)
    if (err%failed()) return
    call add_pressure(model, pressure)
    call self%find_forces(model, stage%time, stage%force, motion)
    call add_pressure(model, -pressure)
    if (model%coupled) then
      call self%formulation%find_missing_water(self%system, model, stage, pressure, &
                                               stage%water, err)
    end if
    call check_residual(model, stage%force, stage%water, err)
    if (err%failed()) return
    stage%residual = residual_norm(self, model, stage%force, stage%water)
  end subroutine evaluate

  subroutine go_back_while_worse(self, model, stage, motion, pressure, err)
    !! Half of an increment, a quarter, ... where the whole of it makes the residual larger.
    class(stage_solver_t), intent(inout) :: self
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
      call self%formulation%move_to(model, motion, err)
      call evaluate(self, model, stage, motion, pressure, err)
    end do
  end subroutine go_back_while_worse

  subroutine advance_within(self, model, step, pressure_step, motion, pressure, err)
    !! Adds an increment, or as large a part of it as leaves every particle a volume. Collective.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: step(:, :), pressure_step(:)   !! increments [m], [Pa]
    real(wp), intent(inout) :: motion(:, :), pressure(:)      !! since the start [m], [Pa]
    type(error_t), intent(inout) :: err
    type(error_t) :: failure
    integer :: k

    do k = 1, halvings
      failure = error_t()
      call self%formulation%move_to(model, motion + step, failure)
      if (.not. failure%failed()) exit
      step = 0.5_wp*step
      pressure_step = 0.5_wp*pressure_step
    end do
    if (failure%failed()) err = failure
    motion = motion + step
    pressure = pressure + pressure_step
  end subroutine advance_within

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
    class(stage_solver_t), intent(in) :: self
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
    class(stage_solver_t), intent(inout) :: self
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
    call self%formulation%start_stress(before)
    call describe_trouble(model, force,.not. self%system%unknowns%is_held, pressure_step, &
                          by_water, before, self%trouble)
  end subroutine note_trouble

  subroutine stiffen(model, share)
    !! Mixes elasticity into the tangents: bodies that yield all over have no other resistance.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: share   !! of elasticity [-]
    real(wp) :: tangent(nsig, nsig)
    integer :: p

    if (.not. allocated(model%skeleton%tangent)) return
    do p = 1, model%particles%count
      call elastic_tangent(model, p, tangent)
      model%skeleton%tangent(:, :, p) = (1.0_wp - share)*model%skeleton%tangent(:, :, p) + &
                                        share*tangent
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
      associate (curve => model%water%retention(model%material(p)))
        if (.not. curve%is_active) cycle
        suction = max(0.0_wp, -pressure(p))
        most = suction + max(suction, curve%unit_weight/curve%alpha)
        step(p) = max(step(p), -most - pressure(p))
        if (suction > 0.0_wp) step(p) = min(step(p), suction)
      end associate
    end do
  end subroutine stay_near_kinks

  subroutine linearise_flow(model, time, pressure)
    !! Heads, relative conductivities and surface data that the equations are linearised at.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time          !! [s]
    real(wp), intent(in) :: pressure(:)   !! of the particles [Pa]

    call set_surface_data(model, time)
    call prepare_flow(model, pressure)
  end subroutine linearise_flow

  subroutine solver_turn_safe(self, model, message, turned, err)
    !! After a solution that failed: equations that are more likely to be solved, if there are any.
    class(stage_solver_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: message   !! why
    logical, intent(out) :: turned
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: what

    call self%system%turn_safe(model, turned, what)
    if (.not. turned) return
    call model%log%warning(message//'; '//what//' from now on')
    call self%system%build(model, .false., err)
  end subroutine solver_turn_safe

  pure real(wp) function solver_tolerance(self) result(tolerance)
    !! Factorised systems are solved to round-off, others to the scene's tolerance [-].
    class(stage_solver_t), intent(in) :: self

    tolerance = self%system%tolerance
    if (self%system%system%is_direct) tolerance = 1.0e-13_wp
  end function solver_tolerance
end module dosui_stage_solver

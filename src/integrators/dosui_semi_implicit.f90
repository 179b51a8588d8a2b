!! Semi-implicit steps: explicit momentum, implicit pressure (incremental projection).
!!
!! Forces with the pressures of t_n give a trial motion v*; the pressures then change so that the
!! water's continuity holds with the motion they cause:
!!     v* = v + dt M^-1 f(p_n)
!!     (S - dt VL + dt^2 D M^-1 Q) dp = dt F(p_n) - dt VPD v*
!!     v  = v* + dt M^-1 Q dp
!! The step is limited by the skeleton's wave only, for any conductivity and any K_w. Without p_n
!! in v* the projection would leak like a conductivity dt gamma_w/rho, so it is there.
!!
!! Nodes that v* drives into rigid walls are held there in the projection, too; the others are free,
!! and stopped if the new pressures drive them in. A wall that new pressures pull at lets go in the
!! next step, when they are part of v*.
module dosui_semi_implicit
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: n_volume, ndim, nsig, volume_slot
  use dosui_cell_average, only: cell_sums
  use dosui_error, only: error_t
  use dosui_explicit, only: cut_share, damping_limit, fastest_particle
  use dosui_extended_nodes, only: held_components, inertia_forces
  use dosui_force_balance, only: book_held_by_walls, book_reactions, book_rigid_wall, want_forces
  use dosui_implicit_system, only: implicit_system_t
  use dosui_inertial_integrator, only: inertial_integrator_t
  use dosui_model, only: balance_t, model_t
  use dosui_rigid_walls, only: correct_friction, meet_walls
  use dosui_seepage, only: seepage_t
  use dosui_skeleton_step, only: book_wall_impulse, finish_forces, gather_forces, &
                                 light_node_mass, meet_one_by_one, update_nodes, update_particles
  use dosui_state_check, only: check_state, note_fault
  use dosui_text, only: to_text
  use dosui_time_control, only: step_limit_t
  use dosui_water_balance, only: add_to_balance
  use dosui_water_step, only: add_sources, set_surface_data, water_rate
  implicit none
  private

  real(wp), parameter :: direct_tolerance = 1.0e-12_wp   !! of a factorised solution [-]
  real(wp), parameter :: wall_share = 0.6_wp   !! of the wave's limit, measured [-]
  integer, parameter :: attempts = 6                     !! at one step

  type, extends(inertial_integrator_t), public :: semi_implicit_t
    type(implicit_system_t) :: system
    integer(i8) :: n_step = 0_i8        !! steps chosen
    integer :: n_failed = 0             !! linear solutions that did not converge
    logical, private :: is_built = .false.
    integer, private :: rebuilds = -1   !! of the geometry that the equations belong to
    logical, allocatable, private :: by_walls(:, :)   !! components that rigid walls hold
    real(wp), allocatable, private :: taken(:, :)     !! velocities that they took from v* [m/s]
  contains
    procedure :: choose_step => semi_implicit_choose_step
    procedure :: advance => semi_implicit_advance
    procedure :: describe => semi_implicit_describe
  end type semi_implicit_t

contains

  subroutine semi_implicit_advance(self, model, err)
    !! Advances the state by the clock's step, or by half of it as often as the linear solver fails.
    !! Collective.
    class(semi_implicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(error_t) :: failure
    type(balance_t) :: start
    real(wp), allocatable :: before(:), pressure(:), expected(:), rate(:), inflow(:)
    type(seepage_t) :: seepage
    logical, allocatable :: by_walls(:, :)
    logical :: changed
    integer :: k, n

    n = model%particles%count
    start = model%balance
    do k = 1, attempts
      failure = error_t()
      call want_forces(model)
      call gather_forces(model)   ! damping has changed those of an attempt that failed
      model%balance = start   ! impulses of walls in an attempt that failed do not count
      if (allocated(by_walls)) deallocate (by_walls)
      if (allocated(model%scene%rigid_wall)) then
        allocate (by_walls(ndim, model%grid%n_node), source=.false.)
        if (allocated(self%taken)) deallocate (self%taken)
        allocate (self%taken(ndim, model%grid%n_node), source=0.0_wp)
      end if
      call update_nodes(model, by_walls, self%taken)
      call note_fault(model)   ! before a solver hears of it
      if (model%comm%any(model%fault%failed())) call check_state(model, err)
      if (err%failed()) return
      if (allocated(by_walls)) call note_contacts(self, model, by_walls)
      call find_pressure(self, model, pressure, expected, failure)
      if (.not. failure%failed()) exit
      self%n_failed = self%n_failed + 1
      if (k == attempts) then
        call err%set('semi-implicit step at t = '//to_text(model%clock%time)//' s: '// &
                     failure%message)
        return
      end if
      model%clock%dt = 0.5_wp*model%clock%dt
      call model%log%warning('semi-implicit steps had no solution and were repeated with half '// &
                             'of dt', ': at t = '//to_text(model%clock%time, 6)//' s with dt = '// &
                             to_text(model%clock%dt, 3)//' s ('//failure%message//')')
    end do
    associate (values => model%particles%field(model%p%pore_pressure)%values)
      before = values(1, 1:n)
      values(1, 1:n) = before + pressure
    end associate
    call update_particles(model, err)
    if (model%p%unmet_volume > 0) call note_unmet(model, expected)
    if (model%reactions%is_wanted) call report_forces(self, model, pressure)
    allocate (rate(n), source=0.0_wp)   ! the balance needs the flow with the new pressures
    allocate (inflow(size(model%balance%inflow)))
    call water_rate(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n), rate)
    call add_sources(model, model%clock%time + model%clock%dt, rate, inflow)
    call add_to_balance(model, model%clock%dt*inflow, before, before + pressure)
    if (.not. model%water%switching) return
    call seepage%start_step(model)
    call seepage%review(model, model%clock%time + model%clock%dt, before + pressure, changed)
  end subroutine semi_implicit_advance

  subroutine report_forces(self, model, pressure)
    !! Forces of walls in the step. Collective.
    class(semi_implicit_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! changes of the pressures [Pa]
    real(wp) :: push(ndim, model%grid%n_node)

    if (model%skeleton%lifted) call report_lifted(model, pressure)
    call self%system%pressure_forces(model, pressure, push)
    call finish_forces(model, push)
  end subroutine report_forces

  subroutine report_lifted(model, pressure)
    !! What penalty walls add to the forces of the changes of the pressures. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! [Pa]
    real(wp) :: mean(model%grid%n_cell), stress(nsig, model%grid%n_cell)
    integer :: a

    call cell_sums(size(pressure), model%mesh%cell, model%mesh%water_weight, pressure, &
                   size(mean), mean)
    call model%mesh%average%group_means(model%comm, model%grid, 1, mean)
    stress = 0.0_wp
    do a = 1, n_volume
      stress(volume_slot(a), :) = -mean
    end do
    call book_reactions(model, stress)
  end subroutine report_lifted

  subroutine note_contacts(self, model, by_walls)
    !! Which components rigid walls hold; others than before need new equations. Collective.
    class(semi_implicit_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    logical, intent(in) :: by_walls(:, :)
    logical :: is_new

    is_new = .not. allocated(self%by_walls)
    if (.not. is_new) is_new = size(self%by_walls) /= size(by_walls)
    if (.not. is_new) is_new = any(self%by_walls .neqv. by_walls)
    if (model%comm%any(is_new)) self%is_built = .false.
    self%by_walls = by_walls
  end subroutine note_contacts

  subroutine note_unmet(model, expected)
    !! Volume changes that the pressures of this step did not know: of nodes that walls have stopped
    !! or braked after the projection. The next step's pressures answer them.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: expected(:)   !! volume changes of the projection [m3]

    associate (unmet => model%particles%field(model%p%unmet_volume)%values, n => size(expected))
      unmet(1, 1:n) = model%mesh%water_weight(1:n)*model%water%volume_strain(1:n) - expected
    end associate
  end subroutine note_unmet

  subroutine find_pressure(self, model, pressure, expected, err)
    !! Changes of the pressures, and the nodal velocities with them.
    class(semi_implicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: pressure(:)   !! of the particles [Pa]
    real(wp), allocatable, intent(out) :: expected(:)   !! their volume changes [m3]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :), none(:, :), supply(:), squeezed(:)
    integer :: n

    n = model%particles%count
    call prepare(self, model, err)
    if (err%failed()) return
    allocate (motion(ndim, model%grid%n_node), none(ndim, model%grid%n_node), source=0.0_wp)
    allocate (pressure(n), supply(n), squeezed(n), source=0.0_wp)
    call find_supply(model, supply)
    call self%system%volume_change(model%clock%dt*model%skeleton%velocity, squeezed)
    supply = supply - squeezed
    if (model%p%unmet_volume > 0) then
      supply = supply - model%particles%field(model%p%unmet_volume)%values(1, 1:n)
    end if
    call model%timers%start(model%phase%solver)
    call self%system%solve(model, model%clock%dt, none, model%clock%time, none, .false., supply, &
                           merge(direct_tolerance, self%system%tolerance, &
                                 self%system%system%is_direct), .false., motion, pressure, err, &
                           without_loads=.true.)
    call model%timers%stop(model%phase%solver)
    if (err%failed()) return
    allocate (expected(n), source=0.0_wp)
    call self%system%volume_change(motion, expected)
    expected = expected + squeezed
    model%skeleton%velocity = model%skeleton%velocity + motion/model%clock%dt
    if (allocated(model%scene%rigid_wall)) call meet_again(self, model, pressure, motion)
  end subroutine find_pressure

  subroutine meet_again(self, model, pressure, motion)
    !! Friction and stops of rigid walls under the changes of the pressures. Collective.
    class(semi_implicit_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! their changes [Pa]
    real(wp), intent(in) :: motion(:, :)  !! what they add to the nodes' motion [m]
    real(wp), allocatable :: change(:, :)   ! of momenta in the time of a step, likewise [N]
    real(wp), allocatable :: push(:, :), before(:, :), mass(:, :), known(:, :)
    logical, allocatable :: held(:, :)   ! with an extension
    integer, allocatable :: plate(:, :)
    integer :: i, k

    allocate (push(ndim, model%grid%n_node))
    call self%system%pressure_forces(model, pressure, push)
    allocate (mass(1, model%grid%n_node))
    mass(1, :) = max(model%skeleton%nodal(1, :), model%skeleton%inertia)
    if (model%mesh%extension%is_on) then
      call held_components(model, model%clock%time + model%clock%dt, .false., held, known, plate)
      held = held .or. self%by_walls
      call model%mesh%extension%fold(model%comm, model%grid, ndim, push, held)
      call model%mesh%extension%fold(model%comm, model%grid, 1, mass)
      change = motion/model%clock%dt**2
      call inertia_forces(model, held, change)
      where (self%by_walls) push = push - change   ! the mass beside moves
    end if
    if (model%reactions%is_wanted) call book_held_by_walls(model, push)
    do i = 1, model%grid%n_node
      if (model%grid%node_map%is_owned(i)) then
        where (self%by_walls(:, i)) model%balance%wall_impulse = &
          model%balance%wall_impulse - model%clock%dt*push(:, i)
        if (.not. model%skeleton%nodal(1, i) > light_node_mass(model)) then
          where (.not. self%by_walls(:, i)) model%balance%lost_impulse = &
            model%balance%lost_impulse - model%clock%dt*push(:, i)
        end if
      end if
      push(:, i) = push(:, i)*model%clock%dt/max(mass(1, i), light_node_mass(model))
    end do
    before = model%skeleton%velocity
    call correct_friction(model%scene%rigid_wall, model%grid, self%taken, push, self%by_walls, &
                          model%skeleton%velocity)
    call meet_walls(model%scene%rigid_wall, model%grid, model%skeleton%velocity)
    if (model%mesh%extension%is_on) then
      call model%mesh%extension%expand(model%comm, model%grid, ndim, model%skeleton%velocity, held)
      call meet_walls(model%scene%rigid_wall, model%grid, model%skeleton%velocity)
    end if
    call book_wall_impulse(model, before)
    if (.not. model%reactions%is_wanted) return
    model%skeleton%velocity = before   ! once more, wall by wall
    do k = 1, size(model%scene%rigid_wall)
      before = model%skeleton%velocity
      call correct_friction(model%scene%rigid_wall(k:k), model%grid, self%taken, push, &
                            self%by_walls, model%skeleton%velocity)
      if (model%mesh%extension%is_on) call model%mesh%extension%expand(model%comm, model%grid, &
                                                                       ndim, &
                                                                      model%skeleton%velocity, held)
      call book_rigid_wall(model, k, model%clock%dt, before)
    end do
    call meet_one_by_one(model, model%clock%dt, held=held)
    if (model%mesh%extension%is_on) call meet_one_by_one(model, model%clock%dt)
  end subroutine meet_again

  subroutine prepare(self, model, err)
    !! The equations for the geometry and the step at hand.
    class(semi_implicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call model%timers%start(model%phase%assembly)
    if (.not. self%is_built .or. self%rebuilds /= model%decomposition%rebuilds) then
      call self%system%build(model, .true., err, self%by_walls)
      self%is_built = .not. err%failed()
      self%rebuilds = model%decomposition%rebuilds
    end if
    if (.not. err%failed()) call self%system%set_step(model%clock%dt, err)
    call model%timers%stop(model%phase%assembly)
  end subroutine prepare

  subroutine find_supply(model, supply)
    !! Water that flows into each particle in the step at the pressures of t_n [m3].
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: supply(:)
    real(wp), allocatable :: pressure(:)
    real(wp) :: inflow(size(model%balance%inflow))
    integer :: n

    call model%timers%start(model%phase%water)
    n = size(supply)
    pressure = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
    call set_surface_data(model, model%clock%time + model%clock%dt)
    call water_rate(model, pressure, supply)
    call add_sources(model, model%clock%time + model%clock%dt, supply, inflow)
    supply = model%clock%dt*model%mesh%water_weight*supply
    call model%timers%stop(model%phase%water)
  end subroutine find_supply

  subroutine semi_implicit_choose_step(self, model)
    !! Step from the skeleton's wave, its damping and the particles' speed. Collective.
    class(semi_implicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(step_limit_t) :: limits(4)
    real(wp) :: speed

    associate (courant => model%scene%time%courant, h => model%scene%grid_spacing)
      limits(1)%name = 'skeleton wave speed'
      limits(1)%dt = cut_share(model)*courant* &
                     h/sqrt(model%scales%skeleton_modulus/model%scales%density)
      if (model%skeleton%lifted) then
        limits(4)%name = 'walls off the grid lines'
        limits(4)%dt = wall_share*limits(1)%dt
      end if
      limits(2)%name = 'viscous damping'
      limits(2)%dt = courant*damping_limit(model)
      if (model%updated) then
        speed = fastest_particle(model)
        limits(3)%name = 'particle speed'
        if (speed > 0.0_wp) limits(3)%dt = courant*h/speed
      end if
    end associate
    call model%clock%choose_step(model%scene%time, limits)
    call model%clock%round_step()
    self%n_step = self%n_step + 1_i8
  end subroutine semi_implicit_choose_step

  function semi_implicit_describe(self) result(text)
    !! Linear solutions so far, for the closing summary.
    class(semi_implicit_t), intent(in) :: self
    character(len=:), allocatable :: text

    associate (system => self%system%system)
      text = 'steps repeated '//to_text(self%n_failed)//' of '//to_text(self%n_step)// &
             ' for the solver; '// &
             trim(merge('direct   ', 'iterative', system%is_direct))//' solutions '// &
             to_text(system%n_solve)//', set-ups '//to_text(system%n_setup)
      if (.not. system%is_direct) text = text//', iterations '//to_text(system%n_iteration)// &
                                         ' (at most '//to_text(system%most_iterations)//')'
    end associate
  end function semi_implicit_describe
end module dosui_semi_implicit

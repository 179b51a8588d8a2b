!! The skeleton's part of an explicit step: particles to grid, nodal update, grid to particles.
module dosui_skeleton_step
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: axis, n_volume, ndim, nshear, nsig, voigt_slot, volume_slot
  use dosui_cell_average, only: cell_sums, cell_tensor_sums, cell_trace_sums
  use dosui_damping, only: damp_forces, damping_at, damping_none
  use dosui_error, only: error_t
  use dosui_extended_nodes, only: fold_nodal, held_components, solve_nodal
  use dosui_finite_strain, only: carried_area
  use dosui_force_balance, only: begin_forces, book_reactions, book_rigid_wall, book_sources, &
                                 book_surface_forces, book_wall_shifts, close_step, &
                                 keep_undamped
  use dosui_grid_to_particle, only: grid_to_particles
  use dosui_model, only: model_t
  use dosui_moving_loads, only: add_moving_loads
  use dosui_particle_to_grid, only: particles_to_grid
  use dosui_pore_water, only: bearing_pressure
  use dosui_rigid_walls, only: meet_walls, rest_on_walls
  use dosui_stress_update, only: update_stress, update_volume
  implicit none
  private

  real(wp), parameter :: light_node = 1.0e-6_wp   !! of a full cell's mass [-]

  public :: book_wall_impulse, finish_forces, flip_share, gather_forces, gather_loads, &
            light_node_mass, meet_one_by_one, nodal_accelerations, start_forces, update_nodes, &
            update_particles, zero_velocities

contains

  subroutine gather_forces(model)
    !! Nodal mass, momentum and force of particles and surfaces, complete on every rank.
    type(model_t), intent(inout) :: model
    real(wp) :: gravity(ndim), shaking(ndim)

    call model%timers%start(model%phase%to_grid)
    gravity = model%scene%gravity/model%scene%mechanics%density_scaling
    shaking = 0.0_wp
    if (model%scene%base_motion%is_given) then
      shaking = model%scene%base_motion%acceleration* &
                model%scene%base_motion%pattern%at(spread(0.0_wp, 1, ndim), model%clock%time)
    end if
    if (model%reactions%is_wanted) call begin_forces(model, gravity, shaking)
    gravity = gravity - shaking
    if (model%skeleton%centred) then
      call spread_centred(model, gravity)
    else if (model%skeleton%averaged) then
      call spread_averaged(model, gravity)
    else
      call spread_pointwise(model, gravity)
    end if
    if (model%sources%has_force) call add_body_forces(model)
    call add_surface_forces(model)
    call model%timers%stop(model%phase%to_grid)
    call model%timers%start(model%phase%halo)
    call model%grid%node_map%sum_copies(model%comm, 1 + 2*ndim, model%skeleton%nodal)
    call model%timers%stop(model%phase%halo)
    call shift_weight(model)
  end subroutine gather_forces

  subroutine shift_weight(model)
    !! Weight and initial stresses of parts of cells act where these have them. Collective.
    type(model_t), intent(inout) :: model

    if (.not. allocated(model%skeleton%shift)) return
    model%skeleton%nodal(2 + ndim:, :) = model%skeleton%nodal(2 + ndim:, :) + model%skeleton%shift
    if (model%reactions%is_wanted) call book_wall_shifts(model)
  end subroutine shift_weight

  subroutine gather_loads(model)
    !! Nodal forces of weight, formulas and surfaces alone, complete on every rank.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: none(:)

    if (model%reactions%is_wanted) then
      call begin_forces(model, model%scene%gravity, spread(0.0_wp, 1, ndim))
    end if
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      allocate (none(n), source=0.0_wp)
      call particles_to_grid(model%grid, n, model%mesh%patch, field(h%position)%values, &
                             field(h%velocity)%values, field(h%mass)%values, none, &
                             field(h%effective_stress)%values, model%scene%gravity, &
                             model%skeleton%nodal)
    end associate
    if (model%sources%has_force) call add_body_forces(model)
    call add_surface_forces(model)
    call model%grid%node_map%sum_copies(model%comm, 1 + 2*ndim, model%skeleton%nodal)
    call shift_weight(model)
  end subroutine gather_loads

  subroutine spread_centred(model, gravity)
    !! Particles to grid: mean stresses through the cells' gradients, deviations at particles.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: gravity(ndim)   !! [m/s2]
    real(wp), allocatable :: stress(:, :), pressure(:), bearing(:)
    integer :: a

    allocate (stress(nsig, model%grid%n_cell), pressure(model%grid%n_cell))
    pressure = 0.0_wp
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      call cell_tensor_sums(n, model%mesh%cell, model%mesh%weight, &
                            field(h%effective_stress)%values, &
                            model%grid%n_cell, stress)
      call model%mesh%average%cell_means(model%comm, model%grid, nsig, stress)
    end associate
    if (model%coupled) call mean_cell_pressures(model, pressure)
    if (model%mesh%quadrature%has_ragged) then
      call take_ragged(model, pressure, stress, bearing)
      call spread_particles(model, gravity, cell_stress=stress, pore_pressure=bearing)
    else
      call spread_particles(model, gravity, cell_stress=stress)
    end if
    do a = 1, n_volume
      stress(volume_slot(a), :) = stress(volume_slot(a), :) - pressure
    end do
    call model%mesh%quadrature%forces(model%grid, model%mesh%average%cell_weight, stress, &
                                      model%skeleton%nodal(2 + ndim:, :))
    if (.not. model%skeleton%lifted) return
    if (model%mesh%quadrature%has_groups) then   ! lifts act on whole groups
      do a = 1, nsig
        stress(a, :) = model%mesh%average%cell_weight*stress(a, :)
      end do
      call model%mesh%average%group_means(model%comm, model%grid, nsig, stress)
    end if
    if (model%reactions%is_wanted) call book_reactions(model, stress)
    associate (field => model%surface%field, h => model%s, m => model%surface%count)
      call model%skeleton%surface_forces%react(field(h%area)%values(1, 1:m), &
                                               field(h%normal)%values(:, 1:m), stress, &
                                               model%skeleton%nodal(2 + ndim:, :))
    end associate
  end subroutine spread_centred

  subroutine take_ragged(model, pressure, stress, bearing)
    !! Mean stresses of ragged cells go to their particles, as in `spread_averaged`.
    type(model_t), intent(in) :: model
    real(wp), intent(inout) :: pressure(:)    !! of the cells; of ragged ones 0 on return [Pa]
    real(wp), intent(inout) :: stress(:, :)   !! (nsig, n_cell) likewise [Pa]
    real(wp), allocatable, intent(out) :: bearing(:)   !! of particles, compression positive [Pa]
    real(wp), allocatable :: mean(:)
    integer :: a, p

    mean = pressure
    do a = 1, n_volume
      mean = mean - stress(volume_slot(a), :)*(1.0_wp/n_volume)
    end do
    allocate (bearing(model%particles%count), source=0.0_wp)
    do p = 1, size(bearing)
      if (model%mesh%quadrature%is_ragged(model%mesh%cell(p))) bearing(p) = mean(model%mesh%cell(p))
    end do
    where (model%mesh%quadrature%is_ragged) pressure = 0.0_wp
    do a = 1, nsig
      where (model%mesh%quadrature%is_ragged) stress(a, :) = 0.0_wp
    end do
  end subroutine take_ragged

  subroutine spread_averaged(model, gravity)
    !! Particles to grid: mean normal stress and pressure of the cells, at the particles (B-bar).
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: gravity(ndim)   !! [m/s2]
    real(wp), allocatable :: mean(:), pressure(:)

    allocate (mean(model%grid%n_cell), pressure(model%grid%n_cell))
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      call cell_trace_sums(n, model%mesh%cell, model%mesh%weight, &
                           field(h%effective_stress)%values, &
                           model%grid%n_cell, mean)
      call model%mesh%average%cell_means(model%comm, model%grid, 1, mean)
      mean = mean/real(n_volume, wp)
      if (model%coupled) then
        call mean_cell_pressures(model, pressure)
        mean = mean - pressure
      end if
    end associate
    call spread_particles(model, gravity, cell_mean_stress=mean)
  end subroutine spread_averaged

  subroutine mean_cell_pressures(model, pressure)
    !! Means of the pore pressure over cells or their groups, compression positive [Pa].
    type(model_t), intent(inout) :: model
    real(wp), intent(out) :: pressure(:)

    if (model%unsaturated) then
      call cell_sums(model%particles%count, model%mesh%cell, model%mesh%water_weight, &
                     bearing_pressure(model), model%grid%n_cell, pressure)
    else
      call cell_sums(model%particles%count, model%mesh%cell, model%mesh%water_weight, &
                     model%particles%field(model%p%pore_pressure)%values, model%grid%n_cell, &
                     pressure)
    end if
    call model%mesh%average%group_means(model%comm, model%grid, 1, pressure)
  end subroutine mean_cell_pressures

  subroutine spread_pointwise(model, gravity)
    !! Particles to grid without averages: every particle's own stress and pressure.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: gravity(ndim)   !! [m/s2]
    real(wp), allocatable :: pressure(:, :)

    if (model%unsaturated) then
      pressure = bearing_pressure(model)
      call spread_particles(model, gravity, pore_pressure=pressure(1, :))
    else if (model%coupled) then
      associate (pore_pressure => model%particles%field(model%p%pore_pressure)%values)
        call spread_particles(model, gravity, pore_pressure=pore_pressure(1, :))
      end associate
    else
      call spread_particles(model, gravity)
    end if
  end subroutine spread_pointwise

  subroutine spread_particles(model, gravity, cell_stress, cell_mean_stress, pore_pressure)
    !! Particles to grid, with or without an affine field; stresses as `particles_to_grid` has them.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: gravity(ndim)   !! [m/s2]
    real(wp), intent(in), optional :: cell_stress(:, :), cell_mean_stress(:), pore_pressure(:)

    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      if (h%affine > 0) then
        call particles_to_grid(model%grid, n, model%mesh%patch, field(h%position)%values, &
                               field(h%velocity)%values, field(h%mass)%values, model%mesh%weight, &
                               field(h%effective_stress)%values, gravity, model%skeleton%nodal, &
                               affine=field(h%affine)%values, pore_pressure=pore_pressure, &
                               cell=model%mesh%cell, cell_mean_stress=cell_mean_stress, &
                               cell_stress=cell_stress)
      else
        call particles_to_grid(model%grid, n, model%mesh%patch, field(h%position)%values, &
                               field(h%velocity)%values, field(h%mass)%values, model%mesh%weight, &
                               field(h%effective_stress)%values, gravity, model%skeleton%nodal, &
                               pore_pressure=pore_pressure, cell=model%mesh%cell, &
                               cell_mean_stress=cell_mean_stress, cell_stress=cell_stress)
      end if
    end associate
  end subroutine spread_particles

  subroutine add_body_forces(model)
    !! Forces that the scene gives as formulas.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: force(:, :)

    associate (n => model%particles%count, &
               position => model%particles%field(model%p%position)%values)
      call model%sources%add_forces(model%grid, n, model%mesh%patch, position, model%mesh%weight, &
                                    model%clock%time, model%skeleton%nodal(2 + ndim:, :))
      if (.not. model%reactions%is_wanted) return
      allocate (force(ndim, model%grid%n_node), source=0.0_wp)
      call model%sources%add_forces(model%grid, n, model%mesh%patch, position, model%mesh%weight, &
                                    model%clock%time, force)
    end associate
    call book_sources(model, force)
  end subroutine add_body_forces

  subroutine add_surface_forces(model)
    !! Tractions and penalty walls.
    type(model_t), intent(inout) :: model
    integer :: place

    place = model%s%current_position
    if (model%reactions%is_wanted) call book_surface_forces(model, place)
    associate (field => model%surface%field, h => model%s, n => model%surface%count)
      call model%skeleton%surface_forces%apply(model%comm, model%scene%mechanical_condition, &
                                               model%clock%time, field(h%area)%values(1, 1:n), &
                                               field(place)%values(:, 1:n), &
                                               field(h%normal)%values(:, 1:n), &
                                               field(h%displacement)%values(:, 1:n), &
                                               field(h%velocity)%values(:, 1:n), &
                                               model%skeleton%nodal(2 + ndim:, :))
    end associate
    if (model%updated) call add_moving_loads(model)
  end subroutine add_surface_forces

  subroutine update_nodes(model, is_held, taken)
    !! Nodal velocities after the step, with damping, conditions on nodes and rigid walls.
    type(model_t), intent(inout) :: model
    logical, intent(inout), optional :: is_held(:, :)   !! as from `meet_walls`
    real(wp), intent(inout), optional :: taken(:, :)    !! likewise [m/s]
    logical, allocatable :: held(:, :)
    real(wp), allocatable :: known(:, :)
    integer, allocatable :: plate(:, :)

    call model%timers%start(model%phase%nodes)
    if (model%mesh%extension%is_on) then
      call held_components(model, model%clock%time + model%clock%dt, .false., held, known, plate)
      call fold_nodal(model, held)
    end if
    if (model%skeleton%damping_kind /= damping_none) then
      if (model%reactions%is_wanted) call keep_undamped(model)
      call damp_forces(model%skeleton%damping_kind, &
                       damping_at(model%skeleton%damping_kind, model%skeleton%damping, &
                                  model%skeleton%damping_start, &
                                  model%clock%time), model%grid%n_node, model%skeleton%nodal)
    end if
    if (model%mesh%extension%is_on) then
      call solve_nodal(model, model%clock%dt, model%clock%time + model%clock%dt, .false., held, &
                       known, plate, light_node_mass(model))
    else
      call advance_velocities(model%grid%n_node, model%clock%dt, light_node_mass(model), &
                              model%skeleton%inertia, model%skeleton%nodal, &
                              model%skeleton%velocity_old, model%skeleton%velocity)
      call model%skeleton%nodal_conditions%apply(model%comm, model%grid, &
                                                model%clock%time + model%clock%dt, model%clock%dt, &
                                          max(model%skeleton%nodal(1, :), model%skeleton%inertia), &
                                               model%skeleton%velocity_old, model%skeleton%velocity)
    end if
    if (allocated(model%scene%rigid_wall)) call meet_rigid_walls(model, held, is_held, taken)
    call model%timers%stop(model%phase%nodes)
  end subroutine update_nodes

  subroutine meet_rigid_walls(model, held, is_held, taken)
    !! Stops nodes at rigid walls. Books the impulse that these give, and what nodes do not get
    !! that particles hardly touch. Nodes that follow others do so again; then walls stop them.
    type(model_t), intent(inout) :: model
    logical, allocatable, intent(in) :: held(:, :)      !! by conditions on nodes, with an extension
    logical, intent(inout), optional :: is_held(:, :)   !! as from `meet_walls`
    real(wp), intent(inout), optional :: taken(:, :)    !! likewise [m/s]
    real(wp), allocatable :: before(:, :)
    integer :: i

    before = model%skeleton%velocity
    if (model%reactions%is_wanted) then
      call meet_one_by_one(model, model%clock%dt, is_held, taken, held)
    else
      call meet_walls(model%scene%rigid_wall, model%grid, model%skeleton%velocity, is_held, taken)
    end if
    if (model%mesh%extension%is_on) then
      call model%mesh%extension%expand(model%comm, model%grid, ndim, model%skeleton%velocity, held)
      do i = 1, model%grid%n_node   ! they meet walls once more
        if (.not. model%mesh%extension%follows(i)) cycle
        if (present(is_held)) is_held(:, i) = .false.
        if (present(taken)) taken(:, i) = 0.0_wp
      end do
      if (model%reactions%is_wanted) then
        call meet_one_by_one(model, model%clock%dt, is_held, taken)
      else
        call meet_walls(model%scene%rigid_wall, model%grid, model%skeleton%velocity, is_held, taken)
      end if
    end if
    if (model%relaxing) return
    call book_wall_impulse(model, before)
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      if (model%skeleton%nodal(1, i) > light_node_mass(model)) cycle
      model%balance%lost_impulse = model%balance%lost_impulse - &
                                   model%clock%dt*model%skeleton%nodal(2 + ndim:, i)
    end do
  end subroutine meet_rigid_walls

  subroutine meet_one_by_one(model, dt, is_held, taken, held)
    !! As `meet_walls`, and books the force of every wall: with what its nodes lead, where held
    !! components are given.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: dt                          !! [s]
    logical, intent(inout), optional :: is_held(:, :)   !! as from `meet_walls`
    real(wp), intent(inout), optional :: taken(:, :)    !! likewise [m/s]
    logical, intent(in), optional :: held(:, :)         !! by conditions on nodes
    real(wp), allocatable :: before(:, :)
    integer :: k

    do k = 1, size(model%scene%rigid_wall)
      before = model%skeleton%velocity
      call meet_walls(model%scene%rigid_wall(k:k), model%grid, model%skeleton%velocity, &
                      is_held, taken)
      if (present(held)) call model%mesh%extension%expand(model%comm, model%grid, ndim, &
                                                          model%skeleton%velocity, held)
      call book_rigid_wall(model, k, dt, before)
      if (.not. present(is_held)) cycle
      where (is_held .and. model%reactions%holder == 0) model%reactions%holder = k
    end do
  end subroutine meet_one_by_one

  subroutine finish_forces(model, push)
    !! After a step whose forces are wanted: what the walls' are.
    type(model_t), intent(inout) :: model
    real(wp), intent(in), optional :: push(:, :)   !! later forces on nodes [N]

    call close_step(model, model%clock%dt, flip_share(model), light_node_mass(model), push)
  end subroutine finish_forces

  subroutine start_forces(model)
    !! Forces before the first step: of a body that begins to move. Collective.
    type(model_t), intent(inout) :: model
    real(wp), parameter :: second = 1.0_wp   ! accelerations are velocities after it [s]
    logical, allocatable :: held(:, :)
    real(wp), allocatable :: known(:, :)
    integer, allocatable :: plate(:, :)

    call model%reactions%want(model%clock%time, second, 0_i8)
    if (.not. model%reactions%is_wanted) return
    call gather_forces(model)
    model%skeleton%nodal(2:1 + ndim, :) = 0.0_wp
    if (model%mesh%extension%is_on) then
      call held_components(model, model%clock%time + second, .true., held, known, plate)
      call fold_nodal(model, held)
      call solve_nodal(model, second, model%clock%time + second, .true., held, known, plate, &
                       light_node_mass(model))
    else
      call advance_velocities(model%grid%n_node, second, light_node_mass(model), &
                              model%skeleton%inertia, &
                              model%skeleton%nodal, model%skeleton%velocity_old, &
                              model%skeleton%velocity)
      call model%skeleton%nodal_conditions%apply(model%comm, model%grid, &
                                                 model%clock%time, second, &
                                          max(model%skeleton%nodal(1, :), model%skeleton%inertia), &
                                             model%skeleton%velocity_old, model%skeleton%velocity, &
                                                 at_rest=.true.)
    end if
    if (allocated(model%scene%rigid_wall)) then
      call meet_one_by_one(model, second, held=held)
      if (model%mesh%extension%is_on) call meet_one_by_one(model, second)
    end if
    call close_step(model, second, flip_share(model), light_node_mass(model), at_start=.true.)
  end subroutine start_forces

  pure real(wp) function flip_share(model) result(flip)
    !! Share of the nodes' increments in the particles' new velocities, where it is the same for all
    !! nodes [-].
    type(model_t), intent(in) :: model

    flip = 0.0_wp
    if (model%scene%mechanics%transfer == 'flip') flip = 1.0_wp
    if (model%scene%mechanics%transfer == 'blend') flip = model%scene%mechanics%flip_fraction
    if (model%scene%mechanics%transfer /= 'aflip') return
    if (.not. allocated(model%skeleton%node_filter_time)) flip = exp(-model%clock%dt/ &
                                                                     model%skeleton%filter_time)
  end function flip_share

  subroutine book_wall_impulse(model, before)
    !! The impulse of rigid walls that changed nodal velocities.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: before(:, :)   !! (ndim, n_node) velocities without the walls [m/s]
    integer :: i

    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      model%balance%wall_impulse = model%balance%wall_impulse + &
                           model%skeleton%nodal(1, i)*(model%skeleton%velocity(:, i) - before(:, i))
    end do
  end subroutine book_wall_impulse

  subroutine nodal_accelerations(model, acceleration)
    !! Accelerations of nodes at rest under the forces at hand; held nodes stay where they are.
    type(model_t), intent(inout) :: model
    real(wp), intent(out) :: acceleration(:, :)   !! (ndim, n_node) [m/s2]

    if (model%mesh%extension%is_on) then
      call accelerate_extended(model, acceleration)
      return
    end if
    call advance_velocities(model%grid%n_node, 1.0_wp, light_node_mass(model), &
                            model%skeleton%inertia, model%skeleton%nodal, &
                            model%skeleton%velocity_old, acceleration)
    call model%skeleton%nodal_conditions%apply(model%comm, model%grid, &
                                               model%clock%time, 1.0_wp, &
                                          max(model%skeleton%nodal(1, :), model%skeleton%inertia), &
                                          model%skeleton%velocity_old, acceleration, at_rest=.true.)
    if (allocated(model%scene%rigid_wall)) then
      call rest_on_walls(model%scene%rigid_wall, model%grid, acceleration)
    end if
  end subroutine nodal_accelerations

  subroutine accelerate_extended(model, acceleration)
    !! As `nodal_accelerations`, where nodes follow others: the accelerations of the restricted
    !! masses, so that the operator stays self-adjoint in the masses.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: acceleration(:, :)   !! (ndim, n_node) [m/s2]
    logical, allocatable :: held(:, :)
    real(wp), allocatable :: known(:, :), velocity(:, :)
    integer, allocatable :: plate(:, :)

    call held_components(model, model%clock%time, .true., held, known, plate)
    if (allocated(model%scene%rigid_wall)) then
      acceleration = 1.0_wp   ! what walls hold comes out as 0
      call rest_on_walls(model%scene%rigid_wall, model%grid, acceleration)
      where (.not. abs(acceleration) > 0.0_wp)
        held = .true.
        plate = 0
        known = 0.0_wp
      end where
    end if
    velocity = model%skeleton%velocity
    model%skeleton%nodal(2:1 + ndim, :) = 0.0_wp
    call fold_nodal(model, held)
    call solve_nodal(model, 1.0_wp, model%clock%time, .true., held, known, plate, &
                     light_node_mass(model))
    acceleration = model%skeleton%velocity
    model%skeleton%velocity = velocity
    if (allocated(model%scene%rigid_wall)) then   ! of walls along no axis
      call rest_on_walls(model%scene%rigid_wall, model%grid, acceleration)
    end if
  end subroutine accelerate_extended

  pure real(wp) function light_node_mass(model) result(mass)
    !! Nodes with no more than this keep their velocity [kg].
    type(model_t), intent(in) :: model

    mass = light_node*model%scales%density*model%grid%spacing**ndim
  end function light_node_mass

  pure subroutine advance_velocities(n, dt, least_mass, inertia, nodal, velocity_old, velocity)
    !! Kernel: v = p/m, v + dt f/m. A node that particles hardly touch keeps its velocity, since
    !! f/m would be a quotient of vanishing numbers; massless nodes rest. Nodes at the edge of cut
    !! cells carry forces of more volume than mass: they accelerate with more inertia than theirs.
    integer, intent(in) :: n
    real(wp), intent(in) :: dt            !! [s]
    real(wp), intent(in) :: least_mass    !! [kg]
    real(wp), intent(in) :: inertia(n)    !! least inertia [kg]
    real(wp), intent(in) :: nodal(1 + 2*ndim, n)
    real(wp), intent(out) :: velocity_old(ndim, n), velocity(ndim, n)   !! [m/s]
    real(wp) :: inverse
    integer :: i

    do i = 1, n
      inverse = 0.0_wp
      if (nodal(1, i) > tiny(1.0_wp)*1.0e20_wp) inverse = 1.0_wp/nodal(1, i)
      velocity_old(:, i) = nodal(2:1 + ndim, i)*inverse
      velocity(:, i) = velocity_old(:, i)
      if (nodal(1, i) > least_mass) then
        velocity(:, i) = velocity_old(:, i) + dt*nodal(2 + ndim:, i)/max(nodal(1, i), inertia(i))
      end if
    end do
  end subroutine advance_velocities

  subroutine update_particles(model, err)
    !! Velocities, displacements, strains, stresses and volumes of particles; surface points.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: cell_strain(:), shift(:, :)
    integer :: n_inverted, first
    logical :: closes

    call model%timers%start(model%phase%to_particles)
    call move_particles(model)
    call model%timers%stop(model%phase%to_particles)
    call model%timers%start(model%phase%stress)
    if (model%skeleton%centred) then
      call find_cell_strains(model, cell_strain, shift)
    else if (model%skeleton%averaged) then
      allocate (cell_strain(model%grid%n_cell))
      call cell_trace_sums(model%particles%count, model%mesh%cell, model%mesh%weight, &
                           model%skeleton%strain_increment, model%grid%n_cell, cell_strain)
      call model%mesh%average%cell_means(model%comm, model%grid, 1, cell_strain)
    end if
    call find_volume_strain(model, cell_strain)
    if (model%updated .and. model%p%deformation > 0 .and. .not. model%relaxing) then
      call follow_deformation(model, shift)
    end if
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      if (h%state > 0) then
        call update_with(field(h%state)%values)
      else
        call update_with(model%skeleton%no_state)
      end if
      if (model%updated) then
        call update_volume(n, model%skeleton%strain_increment, field(h%volume)%values, &
                           field(h%porosity)%values, n_inverted, cell=model%mesh%cell, &
                           cell_volume_strain=cell_strain, first=first, &
                           needs_pores=model%coupled, closes=closes)
        if (n_inverted > 0 .and. model%inverted == 0) then
          model%inverted = first
          model%pores_close = closes
        end if
      end if
    end associate
    call model%timers%stop(model%phase%stress)
    call move_surface(model)

  contains

    subroutine update_with(state)
      !! Stresses with these state variables. A trial motion towards an equilibrium turns nothing.
      real(wp), intent(inout) :: state(:, :)
      real(wp), allocatable :: spin(:, :)

      if (.not. model%relaxing .and. allocated(model%skeleton%spin)) then
        call move_alloc(model%skeleton%spin, spin)
      end if
      call update_stress(model%materials, model%particles%count, model%material, &
                         model%skeleton%strain_increment, &
                         model%particles%field(model%p%effective_stress)%values, state, err, &
                         cell=model%mesh%cell, cell_volume_strain=cell_strain, cell_shift=shift, &
                         spin=spin, tangent=model%skeleton%tangent)
      if (allocated(spin)) call move_alloc(spin, model%skeleton%spin)
    end subroutine update_with
  end subroutine update_particles

  subroutine follow_deformation(model, shift)
    !! Deformation gradients after the step, with the strains that stresses get.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(in) :: shift(:, :)   !! of the cells, if there are any [-]
    real(wp) :: strain(nsig)
    integer :: p

    associate (f => model%particles%field(model%p%deformation)%values)
      do p = 1, model%particles%count
        strain = model%skeleton%strain_increment(:, p)
        if (allocated(shift)) strain = strain + shift(:, model%mesh%cell(p))
        f(:, p) = reshape(matmul(deformation(strain, model%skeleton%spin(:, p)), &
                                 reshape(f(:, p), [ndim, ndim])), [ndim*ndim])
      end do
    end associate
  end subroutine follow_deformation

  subroutine move_particles(model)
    !! Grid to particles, with or without an affine field.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: share(:, :)
    real(wp) :: flip
    logical :: moves

    moves = model%updated .and. .not. model%relaxing
    flip = flip_share(model)
    if (allocated(model%skeleton%node_filter_time)) then
      share = spread(exp(-model%clock%dt/model%skeleton%node_filter_time), 1, 1)
      ! what nodes that follow lose of their momentum others have: only shares that follow, too,
      ! keep the sum
      call model%mesh%extension%expand(model%comm, model%grid, 1, share)
      model%skeleton%node_share = share(1, :)
    end if
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      if (h%affine > 0) then   ! an absent node_share is no share
        call grid_to_particles(model%grid, n, model%mesh%patch, model%clock%dt, flip, &
                               model%skeleton%velocity_old, model%skeleton%velocity, moves, &
                               field(h%position)%values, field(h%velocity)%values, &
                               field(h%displacement)%values, model%skeleton%strain_increment, &
                               affine=field(h%affine)%values, spin=model%skeleton%spin, &
                               share=model%skeleton%node_share)
      else
        call grid_to_particles(model%grid, n, model%mesh%patch, model%clock%dt, flip, &
                               model%skeleton%velocity_old, model%skeleton%velocity, moves, &
                               field(h%position)%values, field(h%velocity)%values, &
                               field(h%displacement)%values, model%skeleton%strain_increment, &
                               spin=model%skeleton%spin)
      end if
    end associate
  end subroutine move_particles

  subroutine find_volume_strain(model, cell_strain)
    !! Volume change of the step as the water sees it: that of the cell's group, or the particle's
    !! own. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(in) :: cell_strain(:)
    real(wp), allocatable :: water_strain(:)
    integer :: p, d

    if (.not. model%coupled) return
    if (allocated(cell_strain)) then
      water_strain = cell_strain
      if (model%skeleton%centred .and. model%mesh%quadrature%has_groups) then
        water_strain = model%mesh%average%cell_weight*cell_strain
        call model%mesh%average%group_means(model%comm, model%grid, 1, water_strain)
      end if
    end if
    do p = 1, model%particles%count
      if (allocated(cell_strain)) then
        model%water%volume_strain(p) = water_strain(model%mesh%cell(p))
        cycle
      end if
      model%water%volume_strain(p) = 0.0_wp
      do d = 1, n_volume
        model%water%volume_strain(p) = model%water%volume_strain(p) + &
                                       model%skeleton%strain_increment(volume_slot(d), p)
      end do
    end do
  end subroutine find_volume_strain

  subroutine find_cell_strains(model, volume_strain, shift)
    !! Volume strains of cells from their own gradients, and what brings the mean of the particles'
    !! strains to that of their cell.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: volume_strain(:)   !! (n_cell) [-]
    real(wp), allocatable, intent(out) :: shift(:, :)        !! (nsig, n_cell) [-]
    real(wp), allocatable :: mean(:, :)
    integer :: a, c

    allocate (volume_strain(model%grid%n_cell), source=0.0_wp)
    allocate (shift(nsig, model%grid%n_cell), mean(nsig, model%grid%n_cell))
    call model%mesh%quadrature%strains(model%grid, model%clock%dt, model%skeleton%velocity, shift)
    if (model%skeleton%lifted) call lift_walls(model, shift)
    do a = 1, n_volume
      volume_strain = volume_strain + shift(volume_slot(a), :)
    end do
    call cell_tensor_sums(model%particles%count, model%mesh%cell, model%mesh%weight, &
                          model%skeleton%strain_increment, model%grid%n_cell, mean)
    call model%mesh%average%cell_means(model%comm, model%grid, nsig, mean)
    shift = shift - mean
    if (.not. model%mesh%quadrature%has_ragged) return
    do c = 1, model%grid%n_cell
      if (.not. model%mesh%quadrature%is_ragged(c)) cycle
      shift(:, c) = 0.0_wp
      volume_strain(c) = 0.0_wp
      do a = 1, n_volume
        volume_strain(c) = volume_strain(c) + mean(volume_slot(a), c)
      end do
    end do
  end subroutine find_cell_strains

  subroutine lift_walls(model, strain)
    !! Takes the motion against penalty walls out of the cells' strains. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: strain(:, :)    !! (nsig, n_cell) [-]
    real(wp), allocatable :: lift(:, :)
    integer :: c

    allocate (lift(nsig, model%grid%n_cell), source=0.0_wp)
    associate (field => model%surface%field, h => model%s, m => model%surface%count)
      call model%skeleton%surface_forces%lift(model%clock%time + model%clock%dt, model%relaxing, &
                                              field(h%area)%values(1, 1:m), &
                                      field(h%normal)%values(:, 1:m), model%skeleton%velocity, lift)
    end associate
    call model%mesh%average%group_sums(model%comm, model%grid, nsig, lift)
    do c = 1, model%grid%n_cell
      if (model%mesh%quadrature%has_groups) then
        strain(:, c) = strain(:, c) + lift(:, c)* &
                       (model%clock%dt*model%mesh%average%group_inverse(c))
      else if (model%mesh%quadrature%measure(c) > 0.0_wp) then
        strain(:, c) = strain(:, c) + lift(:, c)*(model%clock%dt/model%mesh%quadrature%measure(c))
      end if
    end do
  end subroutine lift_walls

  subroutine move_surface(model)
    !! Surface points follow the grid.
    type(model_t), intent(inout) :: model

    associate (field => model%surface%field, h => model%s, n => model%surface%count)
      call model%skeleton%surface_forces%point_velocity(model%skeleton%velocity, &
                                                        field(h%velocity)%values(:, 1:n))
      field(h%displacement)%values(:, 1:n) = field(h%displacement)%values(:, 1:n) + &
                                             model%clock%dt*field(h%velocity)%values(:, 1:n)
      if (model%updated .and. .not. model%relaxing) then
        field(h%position)%values(:, 1:n) = field(h%position)%values(:, 1:n) + &
                                           model%clock%dt*field(h%velocity)%values(:, 1:n)
        call stretch_surface(model)
      end if
    end associate
  end subroutine move_surface

  subroutine stretch_surface(model)
    !! Areas along the normals follow the particles around, as J F^-T does with them (Nanson's
    !! formula). The grid's own gradient would hear of nodes that hardly have mass. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: sums(:, :)   ! of nodes: weight, increments of strain and of rotation
    real(wp) :: around(1 + nsig + nshear)
    integer :: k, p

    allocate (sums(1 + nsig + nshear, model%grid%n_node))
    call gather_strains(model, sums)
    associate (field => model%surface%field, h => model%s, cell => model%mesh%surface_cell)
      do p = 1, model%surface%count
        if (cell(p) == 0) cycle
        around = 0.0_wp
        do k = 1, 2**ndim
          around = around + sums(:, model%grid%cell_node(k, cell(p)))
        end do
        if (.not. around(1) > 0.0_wp) cycle
        around = around/around(1)
        field(h%outward_area)%values(:, p) = carried_area(deformation(around(2:1 + nsig), &
                                                                      around(2 + nsig:)), &
                                                          field(h%outward_area)%values(:, p))
      end do
    end associate
  end subroutine stretch_surface

  subroutine gather_strains(model, sums)
    !! Strains and rotations of the step around the surface's nodes. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(out) :: sums(:, :)   !! (weight, strain, rotation; n_node)
    real(wp), allocatable :: cell_sums(:, :)
    logical, allocatable :: is_wanted(:)   ! cells that touch the surface's nodes
    integer :: c, k, p

    allocate (is_wanted(model%grid%n_cell))
    do c = 1, model%grid%n_cell
      is_wanted(c) = any(model%mesh%surface_node(model%grid%cell_node(:, c)))
    end do
    allocate (cell_sums(size(sums, 1), model%grid%n_cell), source=0.0_wp)
    do p = 1, model%particles%count
      c = model%mesh%cell(p)
      if (.not. is_wanted(c)) cycle
      cell_sums(:, c) = cell_sums(:, c) + &
                        model%mesh%weight(p)*[1.0_wp, model%skeleton%strain_increment(:, p), &
                                              model%skeleton%spin(:, p)]
    end do
    sums = 0.0_wp
    do c = 1, model%grid%n_cell
      if (.not. cell_sums(1, c) > 0.0_wp) cycle
      do k = 1, 2**ndim
        associate (node => model%grid%cell_node(k, c))
          sums(:, node) = sums(:, node) + cell_sums(:, c)
        end associate
      end do
    end do
    call model%grid%node_map%sum_copies(model%comm, size(sums, 1), sums)
  end subroutine gather_strains

  pure function deformation(strain, rotation) result(f)
    !! I + L dt from increments as `grid_to_particles` gives them [-].
    real(wp), intent(in) :: strain(nsig), rotation(nshear)
    real(wp) :: f(ndim, ndim)
    integer :: a, b

    do b = 1, ndim
      do a = 1, ndim
        f(a, b) = strain(voigt_slot(a, b))
        if (a == b) then
          f(a, b) = f(a, b) + 1.0_wp
        else
          f(a, b) = 0.5_wp*f(a, b) + rotation(voigt_slot(a, b) - 3)* &
                    merge(1.0_wp, -1.0_wp, axis(b) == mod(axis(a), 3) + 1)
        end if
      end do
    end do
  end function deformation

  subroutine zero_velocities(model)
    !! Stops all motion.
    type(model_t), intent(inout) :: model

    model%particles%field(model%p%velocity)%values = 0.0_wp
    if (model%p%affine > 0) model%particles%field(model%p%affine)%values = 0.0_wp
    model%surface%field(model%s%velocity)%values = 0.0_wp
  end subroutine zero_velocities
end module dosui_skeleton_step

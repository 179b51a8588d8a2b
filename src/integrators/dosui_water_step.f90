!! The water's part of an explicit step: pressures from flow and volume change.
module dosui_water_step
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_cell_average, only: cell_sums
  use dosui_ghosts, only: gather_field
  use dosui_head_operator, only: kind_head
  use dosui_model, only: model_t
  use dosui_pore_water, only: saturation_at, wet_masses
  use dosui_super_time_stepping, only: stage_coefficients, stage_t
  use dosui_water_balance, only: add_to_balance, inflow_rate
  implicit none
  private

  public :: find_flow, add_sources, update_pressure, head_of_particles, darcy_velocity, &
            water_rate, prepare_flow, set_surface_data, surface_elevation, soil_conductivities

contains

  pure real(wp) function elevation_of(position, density, gravity, unit_weight) result(elevation)
    !! Elevation e with gamma_w grad e = -rho_w g, so that water at rest has one head [m].
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp), intent(in) :: density          !! of water [kg/m3]
    real(wp), intent(in) :: gravity(ndim)    !! [m/s2]
    real(wp), intent(in) :: unit_weight      !! gamma_w [N/m3]

    elevation = -density*dot_product(gravity, position)/unit_weight
  end function elevation_of

  subroutine surface_elevation(model, elevation)
    !! Elevation of all surface points, ghosts too [m].
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: elevation(:)   !! (points) [m]
    integer :: p, handle

    handle = model%s%current_position
    allocate (elevation(model%surface%count + model%surface%ghost_count))
    do p = 1, size(elevation)
      elevation(p) = elevation_of(model%surface%field(handle)%values(:, p), &
                                  model%scene%water%density, model%scene%gravity, &
                                  model%scene%water%unit_weight)
    end do
  end subroutine surface_elevation

  subroutine set_surface_data(model, time)
    !! Heads and fluxes that surfaces prescribe at a time.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time   !! [s]
    real(wp), allocatable :: elevation(:)
    integer :: place, n, p

    place = model%s%current_position
    call surface_elevation(model, elevation)
    n = size(elevation)
    associate (field => model%surface%field, conditions => model%water%hydraulic_conditions)
      call conditions%set_time(model%scene%hydraulic_condition, time, &
                               model%scene%water%unit_weight, elevation, &
                               field(place)%values(:, 1:n), &
                               field(model%s%normal)%values(:, 1:n))
      if (allocated(model%water%inertia_flux)) then
        do p = 1, n   ! the head drives what is prescribed and what inertia takes in
          if (conditions%kind(p) == kind_head) cycle
          if (conditions%condition(p) == 0) conditions%datum(p) = 0.0_wp
          conditions%datum(p) = conditions%datum(p) + model%water%inertia_flux(p)
        end do
      end if
      if (.not. model%unsaturated) return
      if (allocated(model%water%point_relative)) deallocate (model%water%point_relative)
      allocate (model%water%point_relative(n), source=1.0_wp)
      do p = 1, n
        if (conditions%kind(p) /= kind_head) cycle
        associate (retention => model%water%retention(nint(field(model%s%material)%values(1, p))))
          model%water%point_relative(p) = &
            retention%relative_conductivity(model%scene%water%unit_weight* &
                                            (conditions%datum(p) - elevation(p)))
        end associate
      end do
    end associate
  end subroutine set_surface_data

  subroutine set_elevation(model)
    !! Elevation of owned particles and ghosts.
    type(model_t), intent(inout) :: model
    integer :: p

    if (.not. model%updated) return
    do p = 1, model%particles%count
      model%water%elevation(p) = &
        elevation_of(model%particles%field(model%p%position)%values(:, p), &
                     model%scene%water%density, model%scene%gravity, model%scene%water%unit_weight)
    end do
  end subroutine set_elevation

  subroutine head_of_particles(model, head)
    !! Total head h = u/gamma_w + e of owned particles and ghosts [m].
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: head(:)   !! (particles and ghosts) [m]
    integer :: n

    n = model%particles%count
    allocate (head(n + model%particles%ghost_count))
    call set_heads(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n), head)
  end subroutine head_of_particles

  subroutine set_heads(model, pressure, head)
    !! Heads from pressures, and the ghosts' from their owners.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)     !! of owned particles [Pa]
    real(wp), intent(inout) :: head(:)      !! of owned particles and ghosts [m]
    integer :: n

    n = model%particles%count
    head(1:n) = pressure(1:n)/model%scene%water%unit_weight + model%water%elevation(1:n)
    call model%water%particle_map%gather(model%comm, 1, head)
  end subroutine set_heads

  subroutine water_rate(model, pressure, rate)
    !! Inflow per volume -div w of owned particles at given pressures [1/s].
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)     !! [Pa]
    real(wp), intent(inout) :: rate(:)   !! (particles) [1/s]
    real(wp), allocatable :: flux(:, :)

    call prepare_flow(model, pressure)
    if (model%scene%water%operator == 'two_pass') then
      allocate (flux(ndim, size(model%water%head)))
      call model%water%two_pass%flux(model%water%head, model%water%hydraulic_conditions%datum, flux)
      call model%water%particle_map%gather(model%comm, ndim, flux)
      call model%water%two_pass%divergence(flux, rate)
    else if (model%unsaturated) then
      call model%water%head_operator%apply_relative(model%water%head, &
                                                    model%water%hydraulic_conditions%datum, &
                                                 model%water%relative, model%water%point_relative, &
                                                    rate)
    else
      call model%water%head_operator%apply(model%water%head, &
                                           model%water%hydraulic_conditions%datum, rate)
    end if
  end subroutine water_rate

  subroutine prepare_flow(model, pressure)
    !! Heads and relative conductivities of owned particles and ghosts at given pressures.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)     !! of owned particles [Pa]
    integer :: p

    call set_heads(model, pressure, model%water%head)
    if (.not. model%unsaturated) return
    if (allocated(model%water%relative)) then
      if (size(model%water%relative) /= size(model%water%head)) deallocate (model%water%relative)
    end if
    if (.not. allocated(model%water%relative)) then
      allocate (model%water%relative(size(model%water%head)), source=1.0_wp)
    end if
    do p = 1, model%particles%count
      model%water%relative(p) = &
        model%water%retention(model%material(p))%relative_conductivity(pressure(p))
    end do
    call model%water%particle_map%gather(model%comm, 1, model%water%relative)
  end subroutine prepare_flow

  subroutine add_sources(model, time, rate, inflow)
    !! Adds the water that formulas supply to the rates of water content, and finds the inflow of
    !! all surfaces and sources for the balance, at the heads of the last `water_rate`.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: time           !! [s]
    real(wp), intent(inout) :: rate(:)     !! of owned particles [1/s]
    real(wp), intent(out) :: inflow(:)     !! as from `inflow_rate` [m3/s]
    real(wp), allocatable :: supply(:)
    real(wp) :: supplied
    integer :: n

    n = model%particles%count
    supplied = 0.0_wp
    if (model%sources%has_water) then
      allocate (supply(n), source=0.0_wp)
      call model%sources%add_water(n, model%particles%field(model%p%position)%values, time, supply)
      rate(1:n) = rate(1:n) + supply
      supplied = dot_product(model%mesh%water_weight(1:n), supply)
    end if
    call inflow_rate(model, supplied, inflow)
  end subroutine add_sources

  subroutine find_flow(model, time, pressure, flow, inflow)
    !! F: water that flows into each particle per time [m3/s].
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time          !! of the surfaces' heads and fluxes [s]
    real(wp), intent(in) :: pressure(:)   !! [Pa]
    real(wp), intent(out) :: flow(:)   !! (particles) [m3/s]
    real(wp), intent(out), optional :: inflow(:)    !! through surfaces, for the balance [m3/s]
    real(wp) :: through(size(model%balance%inflow))

    call model%timers%start(model%phase%water)
    call set_surface_data(model, time)
    call water_rate(model, pressure, flow)
    call add_sources(model, time, flow, through)
    if (present(inflow)) inflow = through
    flow = flow*model%mesh%water_weight
    call model%timers%stop(model%phase%water)
  end subroutine find_flow

  subroutine pressure_rate(model, drained, pressure, rate, inflow)
    !! Rate of the pressures: storage times du/dt = inflow - volume change [Pa/s].
    !!
    !! Where bodies move and the water takes several sub-steps, the inflow meets the true storage
    !! n/K_w, and only the volume change the projected one. What the grid cannot balance then flows
    !! off within a step. In a tip with few particles, whose rows of the head operator are far from
    !! symmetric, the projection's unequal storages would turn eigenvalues by 50 degrees off the
    !! real axis; super-time-stepping grows from 25 degrees on.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: drained
    real(wp), intent(in) :: pressure(:)     !! [Pa]
    real(wp), intent(inout) :: rate(:)
    real(wp), intent(out) :: inflow(:)      !! for the balance [m3/s]
    real(wp), allocatable :: flow(:)        ! what comes in [1/s]
    integer :: n

    n = model%particles%count
    rate(1:n) = 0.0_wp
    inflow = 0.0_wp
    allocate (flow(n), source=0.0_wp)
    if (drained) then
      call water_rate(model, pressure, flow)
      call add_sources(model, model%clock%time + 0.5_wp*model%clock%dt, flow, inflow)
    end if
    if (.not. model%rigid) then
      rate(1:n) = -saturation_at(model, pressure(1:n))*model%water%volume_strain(1:n)/model%clock%dt
      if (drained .and. allocated(model%water%inertia_strain)) then
        flow = flow + model%water%inertia_strain(1:n)/model%clock%dt
      end if
    end if
    if (.not. (model%updated .and. drained .and. max(model%water%substeps, &
                                                     model%water%stages) > 1)) then
      rate(1:n) = rate(1:n) + flow
      flow = 0.0_wp
    end if
    call fill_stores(model, rate)
    rate(1:n) = rate(1:n) + flow/model%water%storage%compressibility
  end subroutine pressure_rate

  subroutine fill_stores(model, rate)
    !! Turns rates of water content [1/s] into rates of pressure [Pa/s], in place. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: rate(:)
    real(wp), allocatable :: sums(:), block(:)
    integer :: n

    n = model%particles%count
    if (model%water%storage%projected) then
      allocate (sums(model%grid%n_cell), block(model%grid%n_block))
      call cell_sums(n, model%mesh%cell, model%mesh%water_weight, rate, &
                     model%grid%n_cell, sums)
      call model%mesh%average%block_means(model%comm, model%grid, 1, sums, block)
      call model%mesh%average%group_means(model%comm, model%grid, 1, sums)
      call model%water%storage%pressure_rate(n, model%mesh%cell, model%grid%cell_block, sums, &
                                             block, rate)
    else
      rate(1:n) = rate(1:n)/model%water%storage%compressibility
    end if
  end subroutine fill_stores

  subroutine update_pressure(model, drained)
    !! Pressures after a step: Euler sub-steps or the stages of super-time-stepping.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: drained   !! false: the water stays where it is
    real(wp), allocatable :: pressure(:), rate(:), inflow(:), total(:)
    integer :: n, k, n_step

    call model%timers%start(model%phase%water)
    n = model%particles%count
    allocate (inflow(size(model%balance%inflow)), total(size(model%balance%inflow)), source=0.0_wp)
    allocate (pressure(n), rate(n))
    pressure = model%particles%field(model%p%pore_pressure)%values(1, 1:n)
    call set_elevation(model)
    if (model%updated) then   ! pressures on surfaces are heads above the points' new places
      call gather_field(model%comm, model%surface, model%water%surface_map, model%s%position)
    end if
    call set_surface_data(model, model%clock%time + model%clock%dt)
    if (drained .and. model%water%stages > 0) then
      call super_step(model, pressure, total)
    else
      n_step = merge(model%water%substeps, 1, drained)
      do k = 1, n_step
        call pressure_rate(model, drained, pressure, rate, inflow)
        pressure = pressure + model%clock%dt/real(n_step, wp)*rate
        total = total + model%clock%dt/real(n_step, wp)*inflow
      end do
    end if
    if (drained .and. model%scene%water%operator == 'two_pass') call hold_heads(model, pressure)
    associate (now => model%particles%field(model%p%pore_pressure)%values)
      if (drained) call add_to_balance(model, total, now(1, 1:n), pressure)
      call wet_masses(model, now(1, 1:n), pressure)
      now(1, 1:n) = pressure
    end associate
    call model%timers%stop(model%phase%water)
  end subroutine update_pressure

  subroutine super_step(model, pressure, inflow)
    !! One step of the model in RKL2 stages, the volume change held constant.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: pressure(:)   !! [Pa]
    real(wp), intent(out) :: inflow(:)       !! of the step, for the balance [m3]
    type(stage_t), allocatable :: stage(:)
    real(wp), allocatable :: start(:), before(:), rate(:), first_rate(:), next(:)
    real(wp), dimension(size(inflow)) :: first_inflow, inflow_before, inflow_now, inflow_next
    integer :: j

    stage = stage_coefficients(model%water%stages)
    start = pressure
    before = pressure
    inflow_before = 0.0_wp   ! takes the same course from nothing
    allocate (rate(size(pressure)), first_rate(size(pressure)))
    call pressure_rate(model, .true., start, first_rate, first_inflow)
    pressure = start + stage(1)%mu_t*model%clock%dt*first_rate
    inflow = stage(1)%mu_t*model%clock%dt*first_inflow
    do j = 2, model%water%stages
      call pressure_rate(model, .true., pressure, rate, inflow_now)
      next = stage(j)%mu*pressure + stage(j)%nu*before + &
             (1.0_wp - stage(j)%mu - stage(j)%nu)*start + &
             model%clock%dt*(stage(j)%mu_t*rate + stage(j)%gamma_t*first_rate)
      inflow_next = stage(j)%mu*inflow + stage(j)%nu*inflow_before + &
                    model%clock%dt*(stage(j)%mu_t*inflow_now + stage(j)%gamma_t*first_inflow)
      before = pressure
      pressure = next
      inflow_before = inflow
      inflow = inflow_next
    end do
  end subroutine super_step

  subroutine hold_heads(model, pressure)
    !! The literal operator sets heads on the centres of surface particles.
    type(model_t), intent(in) :: model
    real(wp), intent(inout) :: pressure(:)
    integer :: i

    do i = 1, model%water%two_pass%n_row
      if (model%water%two_pass%held_by(i) == 0) cycle
      pressure(i) = (model%water%hydraulic_conditions%datum(model%water%two_pass%held_by(i)) - &
                     model%water%elevation(i))*model%scene%water%unit_weight
    end do
  end subroutine hold_heads

  subroutine soil_conductivities(model, soil, point_soil)
    !! Conductivities that the scene gives to the soils of particles and of surface points, ghosts
    !! too: they tell where another soil begins. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: soil(:), point_soil(:)   !! [m/s]

    associate (k => model%scene%material%hydraulic_conductivity%constant, &
               n => model%particles%count)
      allocate (soil(n + model%particles%ghost_count), source=k(1))
      allocate (point_soil(model%surface%count + model%surface%ghost_count), source=k(1))
      if (model%s%material == 0) return   ! all alike
      soil(1:n) = k(nint(model%particles%field(model%p%material)%values(1, 1:n)))
      call model%water%particle_map%gather(model%comm, 1, soil)
      point_soil = k(nint(model%surface%field(model%s%material)%values(1, 1:size(point_soil))))
    end associate
  end subroutine soil_conductivities

  subroutine darcy_velocity(model, flux)
    !! Darcy velocity of owned particles for output, from first-order MLS gradients of the head
    !! that see the surfaces' heads and fluxes [m/s].
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: flux(:, :)   !! (ndim, n) [m/s]
    real(wp), allocatable :: head(:), conductivity(:), soil(:), point_soil(:)
    integer :: particle_place, surface_place   ! handles of positions
    integer :: n

    if (model%updated) then
      call gather_field(model%comm, model%particles, model%water%particle_map, model%p%position)
      call gather_field(model%comm, model%surface, model%water%surface_map, model%s%position)
    end if
    particle_place = model%p%current_position
    surface_place = model%s%current_position
    call head_of_particles(model, head)
    conductivity = model%particles%field(model%p%conductivity)%values(1, :)
    if (model%unsaturated) then
      n = model%particles%count
      call prepare_flow(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n))
      conductivity(1:n) = conductivity(1:n)*model%water%relative(1:n)
    end if
    allocate (flux(ndim, model%particles%count))
    if (model%scene%water%operator == 'two_pass') then
      call model%water%two_pass%flux(head, model%water%hydraulic_conditions%datum, flux)
    else
      call soil_conductivities(model, soil, point_soil)
      call model%water%head_operator%flux(model%particles%field(particle_place)%values, &
                                          conductivity, soil, model%scales%spacing, &
                                          model%scene%water%support_radius, &
                                          model%surface%field(surface_place)%values, &
                                     model%surface%field(model%s%normal)%values, point_soil, head, &
                                          model%water%hydraulic_conditions%datum, flux)
    end if
  end subroutine darcy_velocity
end module dosui_water_step

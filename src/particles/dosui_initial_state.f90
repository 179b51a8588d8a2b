!! Initial pore pressures, effective stresses and velocities of regions.
module dosui_initial_state
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt6
  use dosui_particle_fields, only: particle_handles_t
  use dosui_point_set, only: point_set_t
  use dosui_scene, only: initial_state_t, region_t, scene_t
  use dosui_seeding, only: lattice_parity
  use dosui_shapes, only: region_bounds, shape_contains
  implicit none
  private

  public :: apply_initial_state, geostatic_density, initial_stress_change

  real(wp), parameter :: pi = acos(-1.0_wp)

contains

  subroutine apply_initial_state(scene, particles, handles)
    !! Applies the scene's initial states in order; later ones override earlier ones.
    type(scene_t), intent(in) :: scene
    type(point_set_t), intent(inout) :: particles
    type(particle_handles_t), intent(in) :: handles
    integer :: k, p, r

    do k = 1, size(scene%initial_state)
      r = findloc(scene%region%name == scene%initial_state(k)%region, .true., dim=1)
      do p = 1, particles%count
        if (r > 0) then
          if (.not. shape_contains(scene%region(r), &
                                   particles%field(handles%position)%values(:, p), 0.0_wp)) cycle
        end if
        call set_particle(scene, scene%initial_state(k), particles, handles, p)
      end do
    end do
  end subroutine apply_initial_state

  subroutine set_particle(scene, state, particles, handles, p)
    !! Initial state of one particle.
    type(scene_t), intent(in) :: scene
    type(initial_state_t), intent(in) :: state
    type(point_set_t), intent(inout) :: particles
    type(particle_handles_t), intent(in) :: handles
    integer, intent(in) :: p
    real(wp) :: position(ndim), stress(6), foot, head
    integer :: m

    position = particles%field(handles%position)%values(:, p)
    m = nint(particles%field(handles%material)%values(1, p))
    if (handles%pore_pressure > 0) particles%field(handles%pore_pressure)%values(1, p) = &
      initial_pressure(scene, state, position)
    stress = initial_stress(scene, state, m, handles%pore_pressure > 0, position)
    particles%field(handles%effective_stress)%values(1:nsig, p) = stress(voigt6)
    if (state%mode_number > 0) then
      call bar_ends(scene%region, foot, head)
      particles%field(handles%velocity)%values(ndim, p) = &
        state%mode_amplitude*sin(0.5_wp*pi*real(2*state%mode_number - 1, wp)* &
                                 (position(ndim) - foot)/(head - foot))
    end if
  end subroutine set_particle

  pure function initial_stress(scene, state, m, is_wet, position) result(stress)
    !! Initial effective stress at a position, xx yy zz xy yz zx, tension positive [Pa].
    type(scene_t), intent(in) :: scene
    type(initial_state_t), intent(in) :: state
    integer, intent(in) :: m        !! material
    logical, intent(in) :: is_wet   !! grains have buoyancy
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp) :: stress(6)

    stress = 0.0_wp
    if (state%effective_stress == 'given') then
      stress = state%effective_stress_value
    else if (state%effective_stress == 'geostatic') then
      ! gravity points down, so this is negative (compression) below the surface
      stress(3) = geostatic_density(scene, m, is_wet)*scene%gravity(ndim)* &
                  max(state%surface_level - position(ndim), 0.0_wp)
      stress(1:2) = state%lateral_ratio*stress(3)
    end if
  end function initial_stress

  pure real(wp) function geostatic_density(scene, m, is_wet) result(density)
    !! Density whose weight makes geostatic stresses, under water that of buoyant grains [kg/m3].
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: m        !! material
    logical, intent(in) :: is_wet   !! grains have buoyancy

    associate (material => scene%material(m))
      density = (1.0_wp - material%porosity%constant)*material%solid_density%constant
      if (is_wet) density = density - (1.0_wp - material%porosity%constant)*scene%water%density
    end associate
  end function geostatic_density

  pure function initial_stress_change(scene, m, is_wet, position, way) result(change)
    !! How much the initial effective stress of a particle would differ some way off; 0 if it has
    !! none [Pa].
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: m                 !! its material
    logical, intent(in) :: is_wet            !! grains have buoyancy
    real(wp), intent(in) :: position(ndim)   !! of the particle [m]
    real(wp), intent(in) :: way(ndim)        !! [m]
    real(wp) :: change(nsig), stress(6)
    integer :: k, r

    change = 0.0_wp
    do k = size(scene%initial_state), 1, -1   ! the last one that it has
      r = findloc(scene%region%name == scene%initial_state(k)%region, .true., dim=1)
      if (r > 0) then
        if (.not. shape_contains(scene%region(r), position, 0.0_wp)) cycle
      end if
      associate (state => scene%initial_state(k))
        stress = initial_stress(scene, state, m, is_wet, position + way) - &
                 initial_stress(scene, state, m, is_wet, position)
      end associate
      change = stress(voigt6)
      return
    end do
  end function initial_stress_change

  pure subroutine bar_ends(regions, foot, head)
    !! Elevations of the lowest and the highest point of all regions [m].
    type(region_t), intent(in) :: regions(:)
    real(wp), intent(out) :: foot, head
    real(wp) :: low(ndim), high(ndim)
    integer :: r

    foot = huge(1.0_wp)
    head = -huge(1.0_wp)
    do r = 1, size(regions)
      call region_bounds(regions(r), low, high)
      foot = min(foot, low(ndim))
      head = max(head, high(ndim))
    end do
  end subroutine bar_ends

  pure real(wp) function initial_pressure(scene, state, position) result(pressure)
    !! Initial pore pressure at a position, compression positive [Pa].
    type(scene_t), intent(in) :: scene
    type(initial_state_t), intent(in) :: state
    real(wp), intent(in) :: position(ndim)   !! [m]
    integer :: r

    select case (state%pore_pressure)
    case ('hydrostatic')
      pressure = -scene%water%density*scene%gravity(ndim)*(state%water_level - position(ndim))
    case ('given')
      pressure = state%pore_pressure_value
    case ('checkerboard')
      pressure = state%pore_pressure_value
      do r = 1, size(scene%region)
        if (.not. shape_contains(scene%region(r), position, 0.0_wp)) cycle
        if (lattice_parity(scene, scene%region(r), position) == 1) pressure = -pressure
        exit
      end do
    case default
      pressure = 0.0_wp
    end select
  end function initial_pressure
end module dosui_initial_state

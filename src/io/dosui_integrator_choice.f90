!! Which integrator suits a scene, and how many steps each would take.
!!
!! The choice needs the scene only, no particles: it decides what is set up. It asks first whether
!! inertia matters: initial velocities, loads that change as fast as waves travel, runs shorter than
!! a few wave travels, large deformation. If not, quasi-static steps win by orders of magnitude.
!! Otherwise pressures are made implicit when the water would force much smaller steps than the
!! skeleton. The first integrator in this order that the table of `dosui_capabilities` allows is
!! taken.
module dosui_integrator_choice
  use dosui_kinds, only: wp
  use dosui_capabilities, only: any_scene, obstacle
  use dosui_dimension, only: ndim
  use dosui_integrator_traits, only: explicit, integrators, integrator_traits_t, quasi_static, &
                                     semi_implicit, traits_of
  use dosui_materials, only: material_set_t
  use dosui_ratios, only: bounded_ratio
  use dosui_scene, only: name_length, scene_t
  use dosui_table, only: table_t
  use dosui_seeding, only: region_spacing
  use dosui_shapes, only: region_bounds
  implicit none
  private

  real(wp), parameter :: slow = 100.0_wp         !! wave travels after which inertia is forgotten
  real(wp), parameter :: implicit_cost = 8.0_wp  !! of a semi-implicit step, in explicit steps
  real(wp), parameter :: spectral_factor = 4.3_wp   !! dx^2 times the head operator's largest
  !! eigenvalue over its conductivity, on a lattice with R = 2.4 dx [-]

  public :: resolve_integrator

contains

  subroutine resolve_integrator(scene)
    !! Estimates the steps of a scene without problems, and puts the integrator that suits it in the
    !! place of 'auto'.
    type(scene_t), intent(inout) :: scene
    type(material_set_t) :: materials
    type(integrator_traits_t) :: given
    real(wp) :: travel
    integer :: k

    call scene%prepare_materials(materials, uniform=.true.)
    call estimate_steps(scene, materials, travel)
    given = traits_of(scene%integrator)
    scene%choice%is_automatic = .not. given%stands()
    scene%choice%reason = 'as the scene says'
    if (scene%choice%is_automatic) call choose(scene, travel)
    do k = 1, size(integrators)
      if (len(obstacle(scene, trim(integrators(k)))) > 0) scene%choice%steps(k) = 0.0_wp
    end do
  end subroutine resolve_integrator

  subroutine choose(scene, travel)
    !! The first integrator that does not refuse the scene, in the order of what suits it.
    type(scene_t), intent(inout) :: scene
    real(wp), intent(in) :: travel   !! of a wave through the body [s]
    character(len=name_length) :: order(size(integrators))
    character(len=:), allocatable :: inertia, reason, hindrance, refused
    type(integrator_traits_t) :: chosen
    integer :: k

    order(:2) = [character(len=name_length) :: explicit, semi_implicit]
    if (scene%choice%steps_of(explicit) > &
        implicit_cost*scene%choice%steps_of(semi_implicit)) order(:2) = order(2:1:-1)
    order(3) = quasi_static
    inertia = why_inertia(scene, travel)
    reason = inertia
    if (len(inertia) == 0) then
      order = cshift(order, -1)
      reason = 'nothing in the scene has inertia'
    end if
    hindrance = ''
    refused = ''
    do k = 1, size(order)
      hindrance = obstacle(scene, trim(order(k)))
      if (len(hindrance) == 0) exit
      if (hindrance == any_scene) hindrance = 'deformation = '''//trim(scene%deformation)//''''
      refused = refused//'; '//trim(order(k))//' does not go with: '//hindrance
    end do
    k = min(k, size(order))   ! the checks have let pass scenes only that one of them can run
    chosen = traits_of(order(k))
    if (chosen%projects()) reason = reason//', and the water would force small steps'
    scene%integrator = order(k)
    scene%choice%reason = reason//refused
  end subroutine choose

  subroutine estimate_steps(scene, materials, travel)
    !! Steps of each integrator, and the time a wave of the skeleton takes through the body.
    type(scene_t), intent(inout) :: scene
    type(material_set_t), intent(in) :: materials
    real(wp), intent(out) :: travel   !! [s]
    real(wp) :: modulus, density, drained, undrained, diffusion, low(ndim), high(ndim), water, &
                corner(ndim), opposite(ndim), spacing, resolved, projected, static
    type(integrator_traits_t) :: of_one
    integer :: k

    drained = 0.0_wp     ! speeds squared
    undrained = 0.0_wp
    diffusion = 0.0_wp   ! largest k K_w/(gamma_w n)
    do k = 1, size(scene%material)
      associate (material => scene%material(k))
        density = scene%mixture_density(k)
        water = scene%water_modulus(k)
        diffusion = max(diffusion, material%hydraulic_conductivity%constant*water/ &
                        scene%water%unit_weight)
        if (material%rigid) cycle
        modulus = materials%item(k)%model%constrained_modulus()
        drained = max(drained, modulus/(density*scene%mechanics%density_scaling))
        undrained = max(undrained, (modulus + water)/(density*scene%mechanics%density_scaling))
      end associate
    end do
    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do k = 1, size(scene%region)
      call region_bounds(scene%region(k), corner, opposite)
      low = min(low, corner)
      high = max(high, opposite)
    end do
    travel = 0.0_wp
    if (drained > 0.0_wp) travel = maxval(high - low)/sqrt(drained)
    spacing = minval([(region_spacing(scene, scene%region(k)), k=1, size(scene%region))])
    associate (t => scene%time, h => scene%grid_spacing)
      projected = bounded_ratio(t%end_time*sqrt(drained)/t%courant, h)
      resolved = bounded_ratio(t%end_time*sqrt(undrained)/t%courant, h)
      if (scene%water%stepping == 'single' .or. .not. drained > 0.0_wp) then
        resolved = resolved + bounded_ratio(0.5_wp*t%end_time*diffusion*spectral_factor/t%courant, &
                                            spacing**2)
      end if
      ! measured: 34 and 68 steps to T = 1 at 1e-3 and 1e-4
      static = 68.0_wp*(1.0e-4_wp/t%relative_tolerance)**0.3_wp
      if (scene%water_mode == 'none') static = 1.0_wp
      if (allocated(t%output_times)) static = static + real(size(t%output_times), wp)
      if (t%output_interval > 0.0_wp) static = static + bounded_ratio(t%end_time, t%output_interval)
    end associate
    do k = 1, size(integrators)
      of_one = traits_of(integrators(k))
      scene%choice%steps(k) = merge(resolved, static, of_one%has_inertia())
      if (of_one%projects()) scene%choice%steps(k) = projected
    end do
  end subroutine estimate_steps

  function why_inertia(scene, travel) result(reason)
    !! Why inertia matters; empty if it does not.
    type(scene_t), intent(in) :: scene
    real(wp), intent(in) :: travel   !! of a wave through the body [s]
    character(len=:), allocatable :: reason
    integer :: k

    reason = ''
    if (all(scene%material%rigid)) return
    if (scene%deformation == 'updated') reason = 'large deformation'
    if (scene%base_motion%is_given) reason = 'the base is shaken'
    if (any(scene%mechanical_condition%kind == 'absorbing')) reason = 'waves are let out'
    do k = 1, size(scene%region)
      if (any(abs(scene%region(k)%velocity) > 0.0_wp) .or. &
          abs(scene%region(k)%spin) > 0.0_wp) reason = 'the body has an initial velocity'
    end do
    do k = 1, size(scene%initial_state)
      if (scene%initial_state(k)%mode_number > 0) reason = 'the body has an initial velocity'
    end do
    do k = 1, size(scene%mechanical_condition)
      if (is_fast(scene%mechanical_condition(k)%pattern%factor)) then
        reason = 'loads change as fast as waves travel'
      end if
    end do
    if (scene%time%end_time < slow*travel) reason = 'the run is as short as waves travel'

  contains

    pure logical function is_fast(table)
      !! Does a table change within a few wave travels?
      type(table_t), intent(in) :: table
      integer :: n

      is_fast = .false.
      if (.not. allocated(table%argument)) return
      n = size(table%argument)
      if (n < 2) return
      is_fast = any(table%argument(2:n) - table%argument(1:n - 1) < slow*travel .and. &
                    abs(table%value(2:n) - table%value(1:n - 1)) > 0.0_wp)
    end function is_fast
  end function why_inertia
end module dosui_integrator_choice

!! Which integrator suits a scene, and how many steps each would take.
!!
!! The choice needs the scene only, no particles: it decides what is set up. It asks first whether
!! inertia matters: initial velocities, loads that change as fast as waves travel, runs shorter than
!! a few wave travels, large deformation. If not, quasi-static steps win by orders of magnitude.
!! Otherwise pressures are made implicit when the water would force much smaller steps than the
!! skeleton.
module dosui_integrator_choice
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_materials, only: material_set_t
  use dosui_scene, only: name_length, scene_t, table_t
  use dosui_shapes, only: region_bounds
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: slow = 100.0_wp         !! wave travels after which inertia is forgotten
  real(wp), parameter :: implicit_cost = 8.0_wp  !! of a semi-implicit step, in explicit steps
  real(wp), parameter :: spectral_factor = 4.3_wp   !! dx^2 times the head operator's largest
  !! eigenvalue over its conductivity, on a lattice with R = 2.4 dx [-]

  type, public :: integrator_choice_t
    character(len=name_length) :: name = 'explicit'
    character(len=:), allocatable :: reason
    real(wp) :: explicit_steps = 0.0_wp        !! estimates for the whole run [-]
    real(wp) :: semi_implicit_steps = 0.0_wp   !! [-]
    real(wp) :: quasi_static_steps = 0.0_wp    !! 0: not possible in this scene [-]
  contains
    procedure :: describe => choice_describe
    procedure :: describe_others => choice_describe_others
  end type integrator_choice_t

  public :: choose_integrator

contains

  subroutine choose_integrator(scene, materials, spacing, choice)
    !! The scene's integrator, or the one that suits it.
    type(scene_t), intent(in) :: scene
    type(material_set_t), intent(in) :: materials
    real(wp), intent(in) :: spacing        !! smallest particle spacing [m]
    type(integrator_choice_t), intent(out) :: choice
    real(wp) :: travel
    character(len=:), allocatable :: inertia

    call estimate_steps(scene, materials, spacing, choice, travel)
    choice%name = scene%integrator
    choice%reason = 'as the scene says'
    if (scene%integrator /= 'auto') return
    if (scene%deformation == 'finite') then
      choice%name = 'quasi_static'
      choice%reason = 'finite strains have no other'
      return
    end if
    inertia = why_inertia(scene, travel)
    if (scene%water%operator == 'two_pass' .and. scene%water_mode /= 'none') then
      choice%name = 'explicit'
      choice%reason = 'the two_pass operator has no other'
    else if (has_rigid_walls(scene)) then
      choice%name = 'explicit'
      choice%reason = 'rigid walls; semi_implicit if the scene says so'
    else if (len(inertia) == 0) then
      choice%name = 'quasi_static'
      choice%reason = 'nothing in the scene has inertia'
    else if (scene%water_mode == 'none') then
      choice%name = 'explicit'
      choice%reason = inertia//', and there is no water'
    else if (choice%explicit_steps > implicit_cost*choice%semi_implicit_steps .and. &
             .not. any(scene%material%rigid) .and. all(scene%material%retention == 'none')) then
      choice%name = 'semi_implicit'
      choice%reason = inertia//', and the water would force small steps'
    else
      choice%name = 'explicit'
      choice%reason = inertia
    end if
  end subroutine choose_integrator

  pure logical function has_rigid_walls(scene) result(has_walls)
    !! May bodies meet walls?
    type(scene_t), intent(in) :: scene

    has_walls = .false.
    if (allocated(scene%rigid_wall)) has_walls = size(scene%rigid_wall) > 0
  end function has_rigid_walls

  subroutine estimate_steps(scene, materials, spacing, choice, travel)
    !! Steps of each integrator, and the time a wave of the skeleton takes through the body.
    type(scene_t), intent(in) :: scene
    type(material_set_t), intent(in) :: materials
    real(wp), intent(in) :: spacing
    type(integrator_choice_t), intent(inout) :: choice
    real(wp), intent(out) :: travel   !! [s]
    real(wp) :: modulus, density, drained, undrained, diffusion, low(ndim), high(ndim), water, &
                corner(ndim), opposite(ndim)
    integer :: k

    drained = 0.0_wp     ! speeds squared
    undrained = 0.0_wp
    diffusion = 0.0_wp   ! largest k K_w/(gamma_w n)
    do k = 1, size(scene%material)
      associate (material => scene%material(k))
        density = scene%mixture_density(k)
        water = scene%water_modulus(k)
        diffusion = max(diffusion, material%hydraulic_conductivity*water/scene%water%unit_weight)
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
    associate (t => scene%time, h => scene%grid_spacing)
      choice%semi_implicit_steps = t%end_time*sqrt(drained)/(h*t%courant)
      choice%explicit_steps = t%end_time*sqrt(undrained)/(h*t%courant)
      if (scene%water%stepping == 'single' .or. .not. drained > 0.0_wp) then
        choice%explicit_steps = choice%explicit_steps + &
                                t%end_time*diffusion*spectral_factor/(2.0_wp*spacing**2*t%courant)
      end if
      ! measured: 34 and 68 steps to T = 1 at 1e-3 and 1e-4
      choice%quasi_static_steps = 68.0_wp*(1.0e-4_wp/t%relative_tolerance)**0.3_wp
      if (scene%water_mode == 'none') choice%quasi_static_steps = 1.0_wp
      if (allocated(t%output_times)) choice%quasi_static_steps = choice%quasi_static_steps + &
                                                                 real(size(t%output_times), wp)
      if (t%output_interval > 0.0_wp) choice%quasi_static_steps = choice%quasi_static_steps + &
                                                                  t%end_time/t%output_interval
      if (scene%deformation == 'updated') choice%quasi_static_steps = 0.0_wp
    end associate
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
      if (.not. allocated(table%time)) return
      n = size(table%time)
      if (n < 2) return
      is_fast = any(table%time(2:n) - table%time(1:n - 1) < slow*travel .and. &
                    abs(table%value(2:n) - table%value(1:n - 1)) > 0.0_wp)
    end function is_fast
  end function why_inertia

  function choice_describe(self) result(text)
    !! The choice, its reason, and the steps of all integrators.
    class(integrator_choice_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = trim(self%name)//' ('//self%reason//'); about '// &
           to_text(self%explicit_steps, 2)//' explicit, '// &
           to_text(self%semi_implicit_steps, 2)//' semi-implicit'
    if (self%quasi_static_steps > 0.0_wp) then
      text = text//', '//to_text(self%quasi_static_steps, 2)//' quasi-static'
    end if
    text = text//' steps'
  end function choice_describe

  function choice_describe_others(self) result(text)
    !! What the integrators beside explicit would take.
    class(integrator_choice_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = 'semi_implicit would take '//to_text(self%semi_implicit_steps, 2)
    if (self%quasi_static_steps > 0.0_wp) then
      text = text//', quasi_static '//to_text(self%quasi_static_steps, 2)
    end if
  end function choice_describe_others
end module dosui_integrator_choice

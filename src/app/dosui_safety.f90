!! The safety factor of a body at rest, by reducing its strength [Zienkiewicz1975]: the
!! largest F for which soils with c/F and tan(phi)/F still carry weight, loads and the
!! initial pore pressures.
module dosui_safety
  use dosui_kinds, only: wp
  use dosui_equilibrium, only: find_geostatic_equilibrium
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_point_set, only: point_set_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: find_safety_factor

  real(wp), parameter :: resolution = 1.01_wp   !! the F that fails over the F that holds [-]
  real(wp), parameter :: largest = 64.0_wp       !! factors beyond are not looked for [-]

contains

  subroutine find_safety_factor(model, err)
    !! Looks for the factor and prints every trial. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(point_set_t) :: particles, surface   ! before the first trial
    real(wp) :: holds, fails, factor
    logical, allocatable :: has_strength(:), is_kept(:)   ! of the materials
    integer :: n_iteration, m
    character(len=:), allocatable :: remains   ! how much is not carried: said by the factor
    logical :: stands

    associate (soil => model%materials%item)
      has_strength = [(soil(m)%model%has_strength(), m=1, size(soil))]
      is_kept = [(soil(m)%model%is_nonlinear, m=1, size(soil))] .and. .not. has_strength
    end associate
    if (.not. any(has_strength)) then
      call err%set('--safety needs a material that can fail: model = ''mohr_coulomb'' or '// &
                   '''drucker_prager''')
      return
    end if
    do m = 1, size(is_kept)
      if (is_kept(m)) call model%log%warning('--safety weakens cohesion and friction angles; '// &
                                             trim(model%scene%material(m)%name)//' ('// &
                                             trim(model%scene%material(m)%model)//') keeps its '// &
                                             'strength')
    end do
    particles = model%particles
    surface = model%surface
    holds = 0.0_wp
    fails = huge(1.0_wp)
    factor = 1.0_wp
    do while (fails > resolution*holds)
      call model%materials%reduce_strength(factor)
      model%particles = particles
      model%surface = surface
      n_iteration = 0
      call find_geostatic_equilibrium(model, n_iteration, stands, err, remains)
      if (err%failed()) return
      call model%log%info('strength / '//factor_text(factor)//merge(' holds', ' fails', stands)// &
                          ' ('//to_text(n_iteration)//' iterations)')
      if (stands) holds = factor
      if (.not. stands) fails = factor
      if (holds >= largest .or. fails <= 1.0_wp/largest) exit
      factor = sqrt(holds)*sqrt(fails)
      if (fails > largest) factor = 2.0_wp*holds
      if (.not. holds > 0.0_wp) factor = 0.5_wp*fails
    end do
    if (holds >= largest) then
      call model%log%info('safety factor above '//factor_text(holds))
    else if (.not. holds > 0.0_wp) then
      call model%log%info('safety factor below '//factor_text(fails)//': is the body held?')
    else
      call model%log%info('safety factor between '//factor_text(holds)//' and '//factor_text(fails))
    end if
  end subroutine find_safety_factor

  pure function factor_text(factor) result(text)
    !! A factor as precise as it is found.
    real(wp), intent(in) :: factor
    character(len=:), allocatable :: text

    text = to_text(anint(1.0e4_wp*factor)/1.0e4_wp)
  end function factor_text
end module dosui_safety

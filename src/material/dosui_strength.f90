!! What soils with cohesion and friction share.
module dosui_strength
  use dosui_kinds, only: wp
  use dosui_isotropic_model, only: elastic_key, n_elastic
  use dosui_key_visitor, only: key, key_t
  use dosui_scalar_function, only: scalar_function_t
  implicit none
  private

  public :: check_dilation, flatter, strength_key

  real(wp), parameter, public :: degree = acos(-1.0_wp)/180.0_wp   !! [rad]

  ! constants of all these models, after the elastic ones and before their own
  integer, parameter, public :: cohesion = n_elastic + 1, friction_angle = n_elastic + 2, &
                                dilation_angle = n_elastic + 3, tensile_strength = n_elastic + 4
  integer, parameter, public :: n_strength = n_elastic + 4

contains

  pure function strength_key(k) result(described)
    !! What is known about the key of a constant of elasticity or strength.
    integer, intent(in) :: k   !! index of the constant
    type(key_t) :: described

    select case (k)
    case (cohesion)
      described = key('cohesion', 'c; with friction_angle = 0 the undrained strength', unit='Pa', &
                      range='>= 0')
    case (friction_angle)
      described = key('friction_angle', 'angle of friction', unit='deg', range='>= 0 and < 90')
    case (dilation_angle)
      described = key('dilation_angle', 'psi, not above friction_angle', unit='deg', &
                      range='>= 0 and < 90')
    case (tensile_strength)
      described = key('tensile_strength', 'largest principal (mohr_coulomb) or mean '// &
                      '(drucker_prager) tension', unit='Pa', range='>= 0', fallback='unlimited')
    case default
      described = elastic_key(k)
    end select
  end function strength_key

  pure real(wp) function flatter(angle, factor)
    !! The angle whose tangent is that of another one over a factor [rad].
    real(wp), intent(in) :: angle    !! [rad]
    real(wp), intent(in) :: factor   !! F [-]

    flatter = angle
    if (abs(factor - 1.0_wp) > 0.0_wp) flatter = atan(tan(angle)/factor)
  end function flatter

  pure subroutine check_dilation(constant, key, message)
    !! Dilation beyond friction: such a soil gives work when it is sheared.
    type(scalar_function_t), intent(in) :: constant(:)      !! of the soil
    character(len=:), allocatable, intent(out) :: key       !! which
    character(len=:), allocatable, intent(out) :: message   !! why not; '': they fit

    key = 'dilation_angle'
    message = ''
    associate (dilation => constant(dilation_angle), friction => constant(friction_angle))
      if (dilation%varies() .or. friction%varies()) return
      if (dilation%constant > friction%constant) then
        message = 'must not exceed friction_angle (such a soil gives work when it is sheared)'
      end if
    end associate
  end subroutine check_dilation
end module dosui_strength

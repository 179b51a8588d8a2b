!! What soils with cohesion and friction share.
module dosui_strength
  use dosui_kinds, only: wp
  use dosui_scalar_function, only: scalar_function_t
  implicit none
  private

  public :: check_dilation, flatter

  real(wp), parameter, public :: degree = acos(-1.0_wp)/180.0_wp   !! [rad]

contains

  pure real(wp) function flatter(angle, factor)
    !! The angle whose tangent is that of another one over a factor [rad].
    real(wp), intent(in) :: angle    !! [rad]
    real(wp), intent(in) :: factor   !! F [-]

    flatter = angle
    if (abs(factor - 1.0_wp) > 0.0_wp) flatter = atan(tan(angle)/factor)
  end function flatter

  pure subroutine check_dilation(dilation, friction, message)
    !! Dilation beyond friction: such a soil gives work when it is sheared.
    type(scalar_function_t), intent(in) :: dilation, friction   !! angles [deg]
    character(len=:), allocatable, intent(out) :: message       !! '' if all is well

    message = ''
    if (dilation%varies() .or. friction%varies()) return
    if (dilation%constant > friction%constant) then
      message = 'must not exceed friction_angle (such a soil gives work when it is sheared)'
    end if
  end subroutine check_dilation
end module dosui_strength

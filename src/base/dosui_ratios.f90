!! Quotients that do not overflow: estimates of what nobody has checked yet.
module dosui_ratios
  use dosui_kinds, only: wp
  implicit none
  private

  public :: bounded_ratio

contains

  pure elemental real(wp) function bounded_ratio(a, b) result(ratio)
    !! a/b, at most 1e30: products of a few do not overflow, either [of units of a over b].
    real(wp), intent(in) :: a, b   !! [any units]
    real(wp), parameter :: most = 1.0e30_wp

    ratio = most
    if (abs(b) > abs(a)/most) ratio = a/b
  end function bounded_ratio
end module dosui_ratios

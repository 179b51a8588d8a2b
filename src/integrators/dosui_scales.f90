!! The part of a model that knows how large its quantities are.
module dosui_scales
  use dosui_kinds, only: wp
  implicit none
  private

  type, public :: scales_t
    !! Sizes that tolerances and step limits refer to.
    real(wp) :: density = 0.0_wp              !! mean inertial density of the body [kg/m3]
    real(wp) :: stiffest = 0.0_wp             !! largest undrained modulus M + K_w/n [Pa]
    real(wp) :: stiffest_now = 0.0_wp         !! likewise with the present porosities [Pa]
    real(wp) :: skeleton_modulus = 0.0_wp     !! largest drained modulus M [Pa]
    real(wp) :: spacing = 0.0_wp              !! smallest particle spacing [m]
    real(wp) :: pressure_scale = 0.0_wp       !! largest mean excess pressure so far [Pa]
  end type scales_t
end module dosui_scales

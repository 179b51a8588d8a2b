!! Kinetic damping (Cundall 1976; Topping & Khan 1994): whenever the kinetic energy has passed a
!! peak all velocities are set to zero, until the peaks are negligible. It finds an equilibrium
!! without any damping constant.
module dosui_relaxation
  use dosui_kinds, only: wp
  implicit none
  private

  real(wp), parameter :: peak_tolerance = 1.0e-14_wp   !! of the largest peak so far [-]

  type, public :: relaxation_t
    !! Watches the kinetic energy of a body that settles into equilibrium.
    real(wp) :: last = 0.0_wp       !! kinetic energy of the last step [J]
    real(wp) :: peak = 0.0_wp       !! largest since the last reset [J]
    real(wp) :: largest = 0.0_wp    !! largest of all [J]
    integer :: n_peak = 0           !! resets so far
  contains
    procedure :: passed_peak => relaxation_passed_peak
    procedure :: settled => relaxation_settled
  end type relaxation_t

contains

  logical function relaxation_passed_peak(self, kinetic_energy) result(passed)
    !! Takes the kinetic energy of a step; true when the caller must now zero all velocities.
    class(relaxation_t), intent(inout) :: self
    real(wp), intent(in) :: kinetic_energy   !! [J]

    passed = kinetic_energy < self%last
    self%last = kinetic_energy
    self%peak = max(self%peak, kinetic_energy)
    self%largest = max(self%largest, kinetic_energy)
    if (.not. passed) return
    self%n_peak = self%n_peak + 1
    self%last = 0.0_wp
  end function relaxation_passed_peak

  logical function relaxation_settled(self) result(settled)
    !! Was the last peak negligible? To be asked right after a peak; starts the next one.
    class(relaxation_t), intent(inout) :: self

    settled = self%peak <= peak_tolerance*self%largest
    self%peak = 0.0_wp
  end function relaxation_settled
end module dosui_relaxation

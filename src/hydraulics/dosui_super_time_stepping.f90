!! RKL2: s stages of a Runge-Kutta-Legendre scheme of second order for diffusion, stable up to
!! dt = (s^2 + s - 2)/4 times the explicit limit [Meyer2014].
module dosui_super_time_stepping
  use dosui_kinds, only: wp
  implicit none
  private

  public :: stages_needed, stage_coefficients

  type, public :: stage_t
    !! Y_j = mu Y_(j-1) + nu Y_(j-2) + (1 - mu - nu) Y_0 + dt (mu_t M(Y_(j-1)) + gamma_t M(Y_0)).
    real(wp) :: mu = 0.0_wp, nu = 0.0_wp, mu_t = 0.0_wp, gamma_t = 0.0_wp   !! [-]
  end type stage_t

contains

  pure integer function stages_needed(ratio) result(s)
    !! Smallest odd number of stages that is stable for dt = ratio x explicit limit.
    real(wp), intent(in) :: ratio   !! dt over the explicit limit [-]

    s = 3
    do while (0.25_wp*real(s*s + s - 2, wp) < ratio)
      s = s + 2
    end do
  end function stages_needed

  pure function stage_coefficients(s) result(stages)
    !! The s stages, eqs. 15-18 of [Meyer2014].
    integer, intent(in) :: s
    type(stage_t) :: stages(s)
    real(wp) :: b(0:s), a(0:s), w1
    integer :: j

    w1 = 4.0_wp/real(s*s + s - 2, wp)
    b(0:min(2, s)) = 1.0_wp/3.0_wp
    do j = 3, s
      b(j) = real(j*j + j - 2, wp)/real(2*j*(j + 1), wp)
    end do
    a = 1.0_wp - b
    stages(1)%mu_t = b(1)*w1
    do j = 2, s
      stages(j)%mu = real(2*j - 1, wp)/real(j, wp)*b(j)/b(j - 1)
      stages(j)%nu = -real(j - 1, wp)/real(j, wp)*b(j)/b(j - 2)
      stages(j)%mu_t = stages(j)%mu*w1
      stages(j)%gamma_t = -a(j - 1)*stages(j)%mu_t
    end do
  end function stage_coefficients
end module dosui_super_time_stepping

!! Isotropic linear elasticity: sigma = lambda tr(epsilon) I + 2 G epsilon.
module dosui_linear_elastic
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_isotropic_model, only: isotropic_model_t, poisson_ratio, young_modulus
  use dosui_principal, only: elastic_matrix
  implicit none
  private

  type, extends(isotropic_model_t), public :: linear_elastic_t
  contains
    procedure :: init => linear_elastic_init
    procedure :: prepare => linear_elastic_prepare
    procedure :: return_stress => linear_elastic_return_stress
  end type linear_elastic_t

contains

  pure subroutine linear_elastic_init(self, young, poisson)
    !! A material with these constants, which has no state.
    class(linear_elastic_t), intent(inout) :: self
    real(wp), intent(in) :: young     !! E, drained [Pa]
    real(wp), intent(in) :: poisson   !! nu, drained, -1 < nu < 1/2 [-]

    call self%set_elasticity(young, poisson)
    if (allocated(self%state_names)) deallocate (self%state_names, self%state_units)
  end subroutine linear_elastic_init

  pure subroutine linear_elastic_prepare(self)
    !! As `init`, from the constants.
    class(linear_elastic_t), intent(inout) :: self

    call self%init(self%constant(young_modulus)%constant, self%constant(poisson_ratio)%constant)
  end subroutine linear_elastic_prepare

  subroutine linear_elastic_return_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Adds the stress increments of a batch of points; needs no state. Numbers cannot fail.
    class(linear_elastic_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)   !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)   !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)   !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! for 2 x shear [Pa]
    integer :: p

    if (present(tangent)) tangent = spread(elastic_matrix(self%lambda, self%shear), 3, n)
    if (err%failed() .or. size(state, 1) > 0) return   ! it has no state
    call add_elastic_stress(self%lambda, self%shear, n, strain_increment, stress)
    if (are_numbers(nsig*n, stress)) return
    do p = 1, n
      if (.not. all(ieee_is_finite(stress(:, p)))) then
        call self%explain('linear elasticity: no numbers', strain_increment(:, p), stress(:, p), &
                          state(:, p), err)
      end if
    end do
  end subroutine linear_elastic_return_stress

  pure subroutine add_elastic_stress(lambda, shear, n, strain_increment, stress)
    !! Kernel: normal components lambda tr + 2 G epsilon, shear components G gamma.
    real(wp), intent(in) :: lambda, shear
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)
    real(wp), intent(inout) :: stress(nsig, n)
    real(wp) :: volumetric
    integer :: p, s

    do p = 1, n
      volumetric = lambda*(strain_increment(1, p) + strain_increment(2, p) + &
                           strain_increment(3, p))
      do s = 1, 3
        stress(s, p) = stress(s, p) + volumetric + 2.0_wp*shear*strain_increment(s, p)
      end do
      stress(4:, p) = stress(4:, p) + shear*strain_increment(4:, p)
    end do
  end subroutine add_elastic_stress

  pure logical function are_numbers(m, values)
    !! Kernel: is the sum finite? Eight sums, so that none waits for the one before.
    integer, intent(in) :: m
    real(wp), intent(in) :: values(m)
    real(wp) :: total(8)
    integer :: i

    total = 0.0_wp
    do i = 1, m - 7, 8
      total = total + values(i:i + 7)
    end do
    are_numbers = ieee_is_finite(sum(total) + sum(values(m - mod(m, 8) + 1:m)))
  end function are_numbers
end module dosui_linear_elastic

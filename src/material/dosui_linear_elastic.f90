!! Isotropic linear elasticity: sigma = lambda tr(epsilon) I + 2 G epsilon.
module dosui_linear_elastic
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_material_model, only: material_model_t
  implicit none
  private

  type, extends(material_model_t), public :: linear_elastic_t
    real(wp) :: lambda = 0.0_wp   !! first Lame constant [Pa]
    real(wp) :: shear = 0.0_wp    !! G [Pa]
  contains
    procedure :: init => linear_elastic_init
    procedure :: update_stress => linear_elastic_update_stress
    procedure :: tangent => linear_elastic_tangent
    procedure :: constrained_modulus => linear_elastic_constrained_modulus
    procedure :: shear_modulus => linear_elastic_shear_modulus
    procedure :: bulk_modulus => linear_elastic_bulk_modulus
  end type linear_elastic_t

contains

  pure subroutine linear_elastic_init(self, young_modulus, poisson_ratio)
    class(linear_elastic_t), intent(inout) :: self
    real(wp), intent(in) :: young_modulus   !! E, drained [Pa]
    real(wp), intent(in) :: poisson_ratio   !! nu, drained, -1 < nu < 1/2 [-]

    self%shear = young_modulus/(2.0_wp*(1.0_wp + poisson_ratio))
    self%lambda = 2.0_wp*self%shear*poisson_ratio/(1.0_wp - 2.0_wp*poisson_ratio)
  end subroutine linear_elastic_init

  subroutine linear_elastic_update_stress(self, n, strain_increment, stress, state, err)
    !! Adds the stress increments of a batch of points; needs no state and cannot fail.
    class(linear_elastic_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)
    real(wp), intent(inout) :: stress(nsig, n)
    real(wp), intent(inout) :: state(:, :)
    type(error_t), intent(inout) :: err

    if (err%failed() .or. size(state, 1) > 0) return   ! it has no state
    call add_elastic_stress(self%lambda, self%shear, n, strain_increment, stress)
  end subroutine linear_elastic_update_stress

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

  subroutine linear_elastic_tangent(self, stress, state, tangent)
    !! The elastic matrix, the same at every stress.
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)
    real(wp), intent(in) :: state(:)
    real(wp), intent(out) :: tangent(nsig, nsig)
    integer :: s

    tangent = 0.0_wp
    if (size(stress) + size(state) < nsig) return   ! it depends on neither
    tangent(1:3, 1:3) = self%lambda
    do s = 1, nsig
      tangent(s, s) = self%shear
      if (s <= 3) tangent(s, s) = self%lambda + 2.0_wp*self%shear
    end do
  end subroutine linear_elastic_tangent

  pure real(wp) function linear_elastic_constrained_modulus(self) result(modulus)
    !! M = K + 4 G/3 [Pa].
    class(linear_elastic_t), intent(in) :: self

    modulus = self%lambda + 2.0_wp*self%shear
  end function linear_elastic_constrained_modulus

  pure real(wp) function linear_elastic_shear_modulus(self) result(modulus)
    !! G [Pa].
    class(linear_elastic_t), intent(in) :: self

    modulus = self%shear
  end function linear_elastic_shear_modulus

  pure real(wp) function linear_elastic_bulk_modulus(self) result(modulus)
    !! K [Pa].
    class(linear_elastic_t), intent(in) :: self

    modulus = self%lambda + 2.0_wp*self%shear/3.0_wp
  end function linear_elastic_bulk_modulus
end module dosui_linear_elastic

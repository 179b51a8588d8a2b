!! Models with constant isotropic elasticity: sigma = lambda tr(epsilon) I + 2 G epsilon.
module dosui_isotropic_model
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_material_model, only: material_model_t
  use dosui_principal, only: elastic_matrix
  implicit none
  private

  integer, parameter, public :: plastic_strain = 1
  !! state variable of soils that yield: plastic shear strain [-]
  integer, parameter, public :: opened = 2
  !! of those that carry no tension: opened volume over volume [-]

  type, abstract, extends(material_model_t), public :: isotropic_model_t
    real(wp) :: lambda = 0.0_wp   !! first Lame constant [Pa]
    real(wp) :: shear = 0.0_wp    !! G [Pa]
  contains
    procedure :: set_elasticity => isotropic_model_set_elasticity
    procedure :: name_plastic_state => isotropic_model_name_plastic_state
    procedure :: tangent => isotropic_model_tangent
    procedure :: constrained_modulus => isotropic_model_constrained_modulus
    procedure :: shear_modulus => isotropic_model_shear_modulus
    procedure :: bulk_modulus => isotropic_model_bulk_modulus
  end type isotropic_model_t

contains

  pure subroutine isotropic_model_set_elasticity(self, young_modulus, poisson_ratio)
    !! Lame's constants from the engineer's.
    class(isotropic_model_t), intent(inout) :: self
    real(wp), intent(in) :: young_modulus   !! E, drained [Pa]
    real(wp), intent(in) :: poisson_ratio   !! nu, drained, -1 < nu < 1/2 [-]

    self%shear = young_modulus/(2.0_wp*(1.0_wp + poisson_ratio))
    self%lambda = 2.0_wp*self%shear*poisson_ratio/(1.0_wp - 2.0_wp*poisson_ratio)
  end subroutine isotropic_model_set_elasticity

  pure subroutine isotropic_model_name_plastic_state(self, can_open)
    !! Names the state variables of a soil that yields.
    class(isotropic_model_t), intent(inout) :: self
    logical, intent(in) :: can_open   !! remembers what must close before it carries anything

    self%is_nonlinear = .true.
    if (can_open) then
      self%state_strains = [opened]
      self%state_names = [character(len=32) :: 'plastic_shear_strain', 'opened_volume']
      self%state_units = [character(len=8) :: '-', '-']
    else
      self%state_names = [character(len=32) :: 'plastic_shear_strain']
      self%state_units = [character(len=8) :: '-']
    end if
  end subroutine isotropic_model_name_plastic_state

  subroutine isotropic_model_tangent(self, stress, state, tangent)
    !! The elastic matrix, the same at every stress.
    class(isotropic_model_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)   !! effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)   !! [units of `state_units`]
    real(wp), intent(out) :: tangent(nsig, nsig)   !! for 2 x shear [Pa]

    tangent = 0.0_wp
    if (size(stress) + size(state) < nsig) return   ! it depends on neither
    tangent = elastic_matrix(self%lambda, self%shear)
  end subroutine isotropic_model_tangent

  pure real(wp) function isotropic_model_constrained_modulus(self) result(modulus)
    !! M = K + 4 G/3 [Pa].
    class(isotropic_model_t), intent(in) :: self

    modulus = self%lambda + 2.0_wp*self%shear
  end function isotropic_model_constrained_modulus

  pure real(wp) function isotropic_model_shear_modulus(self) result(modulus)
    !! G [Pa].
    class(isotropic_model_t), intent(in) :: self

    modulus = self%shear
  end function isotropic_model_shear_modulus

  pure real(wp) function isotropic_model_bulk_modulus(self) result(modulus)
    !! K [Pa].
    class(isotropic_model_t), intent(in) :: self

    modulus = self%lambda + 2.0_wp*self%shear/3.0_wp
  end function isotropic_model_bulk_modulus
end module dosui_isotropic_model

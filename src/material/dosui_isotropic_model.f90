!! Models with constant isotropic elasticity: sigma = lambda tr(epsilon) I + 2 G epsilon.
module dosui_isotropic_model
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_key_visitor, only: key, key_t
  use dosui_material_model, only: material_model_t
  use dosui_principal, only: elastic_matrix
  use dosui_shared_keys, only: shared_key
  implicit none
  private

  public :: elastic_key

  integer, parameter, public :: plastic_strain = 1
  !! state variable of soils that yield: plastic shear strain [-]
  integer, parameter, public :: opened = 2
  !! of those that carry no tension: opened volume over volume [-]

  ! constants of all these models, before their own ones
  integer, parameter, public :: young_modulus = 1, poisson_ratio = 2
  integer, parameter, public :: n_elastic = 2

  type, abstract, extends(material_model_t), public :: isotropic_model_t
    real(wp) :: lambda = 0.0_wp   !! first Lame constant [Pa]
    real(wp) :: shear = 0.0_wp    !! G [Pa]
  contains
    procedure :: set_elasticity => isotropic_model_set_elasticity
    procedure :: name_plastic_state => isotropic_model_name_plastic_state
    procedure :: declare => isotropic_model_declare
    procedure :: key_of => isotropic_model_key_of
    procedure :: elastic_tangent => isotropic_model_elastic_tangent
    procedure :: constrained_modulus => isotropic_model_constrained_modulus
    procedure :: shear_modulus => isotropic_model_shear_modulus
    procedure :: bulk_modulus => isotropic_model_bulk_modulus
  end type isotropic_model_t

contains

  subroutine isotropic_model_declare(self)
    !! Elastic constants; models with more of them make room themselves.
    class(isotropic_model_t), intent(inout) :: self

    if (.not. allocated(self%constant)) allocate (self%constant(n_elastic))
  end subroutine isotropic_model_declare

  pure function isotropic_model_key_of(self, k) result(described)
    !! Keys of the elastic constants.
    class(isotropic_model_t), intent(in) :: self
    integer, intent(in) :: k
    type(key_t) :: described

    associate (not_used => self%shear)
    end associate
    described = elastic_key(k)
  end function isotropic_model_key_of

  pure function elastic_key(k) result(described)
    !! What is known about the key of an elastic constant.
    integer, intent(in) :: k   !! index of the constant
    type(key_t) :: described

    if (k == young_modulus) then
      described = key('young_modulus', 'drained Young''s modulus; needed unless rigid', unit='Pa', &
                      range='> 0', required=.true.)
    else
      described = shared_key('poisson_ratio')
    end if
  end function elastic_key

  pure subroutine isotropic_model_set_elasticity(self, young, poisson)
    !! Lame's constants from the engineer's.
    class(isotropic_model_t), intent(inout) :: self
    real(wp), intent(in) :: young     !! E, drained [Pa]
    real(wp), intent(in) :: poisson   !! nu, drained, -1 < nu < 1/2 [-]

    self%shear = young/(2.0_wp*(1.0_wp + poisson))
    self%lambda = 2.0_wp*self%shear*poisson/(1.0_wp - 2.0_wp*poisson)
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

  subroutine isotropic_model_elastic_tangent(self, stress, state, tangent)
    !! The elastic matrix, the same at every stress.
    class(isotropic_model_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)   !! effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)   !! [units of `state_units`]
    real(wp), intent(out) :: tangent(nsig, nsig)   !! for 2 x shear [Pa]

    tangent = 0.0_wp
    if (size(stress) + size(state) < nsig) return   ! it depends on neither
    tangent = elastic_matrix(self%lambda, self%shear)
  end subroutine isotropic_model_elastic_tangent

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

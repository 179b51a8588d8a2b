!! What every constitutive model of the soil skeleton offers.
module dosui_material_model
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_text, only: to_text
  implicit none
  private

  type, abstract, public :: material_model_t
    !! A constitutive model with its constants. Models see batches of points, so that the choice
    !! of the model costs nothing per point; they own the meaning of their state variables.
    character(len=32), allocatable :: state_names(:)   !! set by models that have state variables
    character(len=8), allocatable :: state_units(:)    !! likewise, '-' for numbers
    integer, allocatable :: state_tensors(:)
    !! first indices of symmetric tensors among the state variables, nsig components each in the
    !! order of stresses: they turn with the material
    integer, allocatable :: state_strains(:)
    !! state variables that are volume strains which the next elastic trial starts from
    logical :: is_nonlinear = .false.   !! stresses are no linear function of strains
    logical :: is_in_cauchy = .false.
    !! finite strains: all laws are in Cauchy stresses. Else elasticity is constant and relates
    !! Kirchhoff stresses to logarithmic strains, strengths limit Cauchy stresses, stresses are
    !! homogeneous in strength and strain, and state variables are strains.
  contains
    procedure(update_stress_interface), deferred :: update_stress
    procedure(tangent_interface), deferred :: tangent
    procedure(modulus_interface), deferred :: shear_modulus
    procedure(modulus_interface), deferred :: bulk_modulus
    procedure :: constrained_modulus => material_model_constrained_modulus
    procedure :: explain => material_model_explain
    procedure :: n_state => material_model_n_state
    procedure :: state_name => material_model_state_name
    procedure :: state_unit => material_model_state_unit
    procedure :: start_state => material_model_start_state
  end type material_model_t

  abstract interface
    subroutine update_stress_interface(self, n, strain_increment, stress, state, err, tangent)
      !! Adds the stress increments of a batch of points. Increments up to 0.1 from admissible
      !! states do not fail unless the soil cannot exist afterwards (closed pores). A point that
      !! fails is explained and stays as it is.
      import :: material_model_t, wp, nsig, error_t
      implicit none
      class(material_model_t), intent(in) :: self
      integer, intent(in) :: n                              !! points
      real(wp), intent(in) :: strain_increment(nsig, n)     !! tension positive, 2 x shear [-]
      real(wp), intent(inout) :: stress(nsig, n)            !! effective, tension positive [Pa]
      real(wp), intent(inout) :: state(:, :)   !! (n_state, n) of the model [units of `state_units`]
      type(error_t), intent(inout) :: err
      real(wp), intent(out), optional :: tangent(nsig, nsig, n)
      !! derivative of the new stress with respect to the increment, 2 x shear [Pa]
    end subroutine update_stress_interface

    subroutine tangent_interface(self, stress, state, tangent)
      !! Elastic derivative of the stress with respect to the strain at one point.
      import :: material_model_t, wp, nsig
      implicit none
      class(material_model_t), intent(in) :: self
      real(wp), intent(in) :: stress(nsig)             !! effective, tension positive [Pa]
      real(wp), intent(in) :: state(:)   !! of the model, more may follow [units of `state_units`]
      real(wp), intent(out) :: tangent(nsig, nsig)     !! for 2 x shear strains [Pa]
    end subroutine tangent_interface

    pure real(wp) function modulus_interface(self) result(modulus)
      !! A modulus of the drained skeleton, the largest the model can have [Pa].
      import :: material_model_t, wp
      implicit none
      class(material_model_t), intent(in) :: self
    end function modulus_interface
  end interface

contains

  pure real(wp) function material_model_constrained_modulus(self) result(modulus)
    !! M = K + 4 G/3 [Pa].
    class(material_model_t), intent(in) :: self

    modulus = self%bulk_modulus() + 4.0_wp*self%shear_modulus()/3.0_wp
  end function material_model_constrained_modulus

  subroutine material_model_explain(self, what, strain, stress, state, err)
    !! An error value that tells what failed, and from which state.
    class(material_model_t), intent(in) :: self
    character(len=*), intent(in) :: what       !! the model and what happened
    real(wp), intent(in) :: strain(nsig)       !! increment, 2 x shear [-]
    real(wp), intent(in) :: stress(nsig)       !! before, effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)           !! before; more may follow [units of `state_units`]
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: text
    integer :: k

    if (err%failed()) return
    text = what
    if (.not. all(ieee_is_finite([strain, stress, state]))) then
      text = what(:index(what, ':'))//' strains, stresses or state variables are no numbers'
    end if
    text = text//'; strain increment'//list_of(strain, '-')//', effective stress before'// &
           list_of(stress, 'Pa')
    do k = 1, min(2, self%n_state())
      text = text//', '//trim(self%state_name(k))//' '//to_text(state(k), 6)
    end do
    call err%set(text)

  contains

    pure function list_of(values, unit) result(list)
      real(wp), intent(in) :: values(:)
      character(len=*), intent(in) :: unit
      character(len=:), allocatable :: list
      integer :: i

      list = ''
      do i = 1, size(values)
        list = list//' '//to_text(values(i), 6)
      end do
      if (unit /= '-') list = list//' '//unit
    end function list_of
  end subroutine material_model_explain

  pure integer function material_model_n_state(self) result(n_state)
    !! State variables per point.
    class(material_model_t), intent(in) :: self

    n_state = 0
    if (allocated(self%state_names)) n_state = size(self%state_names)
  end function material_model_n_state

  pure function material_model_state_unit(self, index) result(unit)
    !! Unit of a state variable, blank for an index the model does not have.
    class(material_model_t), intent(in) :: self
    integer, intent(in) :: index   !! 1 ... n_state
    character(len=8) :: unit

    unit = ''
    if (index >= 1 .and. index <= self%n_state()) unit = self%state_units(index)
  end function material_model_state_unit

  subroutine material_model_start_state(self, porosity, stress, state)
    !! State variables of a point before anything happens: zero, unless a model knows better.
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: porosity          !! [-]
    real(wp), intent(in) :: stress(nsig)      !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:)   !! of the model, more may follow [units of `state_units`]

    state = 0.0_wp
    if (self%n_state() > size(state) .or. .not. porosity < 1.0_wp .or. size(stress) < 3) return
  end subroutine material_model_start_state

  pure function material_model_state_name(self, index) result(name)
    !! Name of a state variable for output, blank for an index the model does not have.
    class(material_model_t), intent(in) :: self
    integer, intent(in) :: index   !! 1 ... n_state
    character(len=32) :: name

    name = ''
    if (index >= 1 .and. index <= self%n_state()) name = self%state_names(index)
  end function material_model_state_name
end module dosui_material_model

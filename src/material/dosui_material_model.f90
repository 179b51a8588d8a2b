!! What every constitutive model of the soil skeleton offers, and what all of them share: constants
!! that may vary with place.
!!
!! A model is a file that extends `material_model_t`, and a line in dosui_materials. It declares its
!! constants with their keys, derives from their values what it computes with (`prepare`), and
!! returns stresses (`return_stress`) and elastic tangents (`elastic_tangent`) of points with
!! uniform constants. Constants that are formulas of place are state variables after the model's
!! own ones, which nothing changes; here each point gets a model with the values of its place.
module dosui_material_model
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_key_visitor, only: in_range, key_t, key_visitor_t, name_length
  use dosui_scalar_function, only: scalar_function_t
  use dosui_text, only: to_text
  implicit none
  private

  type, abstract, public :: material_model_t
    !! A constitutive model with its constants. Models see batches of points, so that the choice
    !! of the model costs nothing per point; they own the meaning of their state variables.
    type(scalar_function_t), allocatable :: constant(:)   !! in the order of the model's keys
    character(len=name_length), allocatable, private :: name(:)   !! of the constants' keys
    integer, allocatable, private :: varying(:)           !! those that are formulas
    real(wp) :: strength_reduction = 1.0_wp   !! F: strengths are divided by it [-]
    real(wp) :: band_width = 1.0_wp           !! of shear bands: the grid's spacing [m]
    real(wp) :: porosity = 0.3_wp             !! initial, that moduli are estimated for [-]
    character(len=32), allocatable :: state_names(:)   !! set by models that have state variables
    character(len=8), allocatable :: state_units(:)    !! likewise, '-' for numbers
    integer, allocatable :: state_tensors(:)
    !! first indices of symmetric tensors among the state variables, nsig components each in the
    !! order of stresses: they turn with the material
    integer, allocatable :: state_strains(:)
    !! state variables that are volume strains which the next elastic trial starts from
    integer :: mean_state = 0, mean_of = 0
    !! a state variable that is the mean of another one around the point before the step, set from
    !! outside; 0: there is none
    real(wp) :: mean_variance = 0.0_wp   !! of that mean's weights in each direction [m2]
    logical :: is_nonlinear = .false.   !! stresses are no linear function of strains
    logical :: is_in_cauchy = .false.
    !! finite strains: all laws are in Cauchy stresses. Else elasticity is constant and relates
    !! Kirchhoff stresses to logarithmic strains, strengths limit Cauchy stresses, stresses are
    !! homogeneous in strength and strain, and state variables are strains.
  contains
    procedure(declare_interface), deferred :: declare
    procedure(key_interface), deferred :: key_of
    procedure(prepare_interface), deferred :: prepare
    procedure(return_stress_interface), deferred :: return_stress
    procedure(elastic_tangent_interface), deferred :: elastic_tangent
    procedure(modulus_interface), deferred :: shear_modulus
    procedure(modulus_interface), deferred :: bulk_modulus
    procedure :: constrained_modulus => material_model_constrained_modulus
    procedure :: visit_options => material_model_visit_options
    procedure :: check => material_model_check
    procedure :: has_strength => material_model_has_strength
    procedure :: follows_finite_strains => material_model_follows_finite_strains
    procedure :: start_state => material_model_start_state
    procedure :: name_constants => material_model_name_constants
    procedure :: index_of => material_model_index_of
    procedure :: vary => material_model_vary
    procedure :: vary_like => material_model_vary_like
    procedure :: varies => material_model_varies
    procedure :: update_stress => material_model_update_stress
    procedure :: tangent => material_model_tangent
    procedure :: moduli => material_model_moduli
    procedure :: place_values => material_model_place_values
    procedure :: represent => material_model_represent
    procedure :: start_point => material_model_start_point
    procedure :: take_own_mean => material_model_take_own_mean
    procedure :: explain => material_model_explain
    procedure :: n_state => material_model_n_state
    procedure :: state_name => material_model_state_name
    procedure :: state_unit => material_model_state_unit
    procedure, private :: n_own_state => material_model_n_own_state
    procedure, private :: take_place => material_model_take_place
  end type material_model_t

  abstract interface
    subroutine declare_interface(self)
      !! Allocates the constants with their defaults.
      import :: material_model_t
      implicit none
      class(material_model_t), intent(inout) :: self
    end subroutine declare_interface

    pure function key_interface(self, k) result(key)
      !! What is known about the key of a constant; it applies unless the model says otherwise.
      import :: key_t, material_model_t
      implicit none
      class(material_model_t), intent(in) :: self
      integer, intent(in) :: k   !! index of the constant
      type(key_t) :: key
    end function key_interface

    pure subroutine prepare_interface(self)
      !! Derives what the model computes with from its constants, strengths reduced, and names its
      !! state variables.
      import :: material_model_t
      implicit none
      class(material_model_t), intent(inout) :: self
    end subroutine prepare_interface

    subroutine return_stress_interface(self, n, strain_increment, stress, state, err, tangent)
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
    end subroutine return_stress_interface

    subroutine elastic_tangent_interface(self, stress, state, tangent)
      !! Elastic derivative of the stress with respect to the strain at one point.
      import :: material_model_t, wp, nsig
      implicit none
      class(material_model_t), intent(in) :: self
      real(wp), intent(in) :: stress(nsig)             !! effective, tension positive [Pa]
      real(wp), intent(in) :: state(:)   !! of the model, more may follow [units of `state_units`]
      real(wp), intent(out) :: tangent(nsig, nsig)     !! for 2 x shear strains [Pa]
    end subroutine elastic_tangent_interface

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

  subroutine material_model_visit_options(self, visitor, applies)
    !! Shows the keys of choices that a model has beside its constants: none.
    class(material_model_t), intent(inout) :: self
    class(key_visitor_t), intent(inout) :: visitor
    logical, intent(in) :: applies   !! is this the model of the material?

    associate (not_used => self%band_width, neither => visitor, nor => applies)
    end associate
  end subroutine material_model_visit_options

  pure subroutine material_model_check(self, key, message)
    !! Constants that do not fit each other: none. Where they vary, each point is checked.
    class(material_model_t), intent(in) :: self
    character(len=:), allocatable, intent(out) :: key       !! which
    character(len=:), allocatable, intent(out) :: message   !! why not; '': they fit

    associate (not_used => self%band_width)
    end associate
    key = ''
    message = ''
  end subroutine material_model_check

  pure logical function material_model_has_strength(self) result(has_strength)
    !! Does `strength_reduction` weaken the soil?
    class(material_model_t), intent(in) :: self

    associate (not_used => self%band_width)
    end associate
    has_strength = .false.
  end function material_model_has_strength

  pure logical function material_model_follows_finite_strains(self) result(follows)
    !! Do the state variables follow the deformation gradient of finite strains?
    class(material_model_t), intent(in) :: self

    associate (not_used => self%band_width)
    end associate
    follows = .true.
  end function material_model_follows_finite_strains

  pure integer function material_model_index_of(self, name) result(k)
    !! Index of the constant with a key, 0: the model has none of that name.
    class(material_model_t), intent(in) :: self
    character(len=*), intent(in) :: name

    k = findloc(self%name == name, .true., dim=1)
  end function material_model_index_of

  subroutine material_model_name_constants(self)
    !! Notes the names of the constants that have been declared.
    class(material_model_t), intent(inout) :: self
    type(key_t) :: key
    integer :: k

    if (allocated(self%name)) deallocate (self%name)
    allocate (self%name(size(self%constant)))
    do k = 1, size(self%constant)
      key = self%key_of(k)
      self%name(k) = key%name
    end do
  end subroutine material_model_name_constants

  ! ---------------------------------------------------------------- constants that vary with place

  subroutine material_model_vary(self)
    !! Makes constants that are formulas state variables, after the model has been prepared.
    class(material_model_t), intent(inout) :: self
    type(key_t) :: key
    character(len=32), allocatable :: names(:)
    character(len=8), allocatable :: units(:)
    integer :: k, j, n

    if (.not. any(self%constant%varies())) return
    self%varying = pack([(k, k=1, size(self%constant))], self%constant%varies())
    n = 0
    if (allocated(self%state_names)) n = size(self%state_names)
    allocate (names(n + size(self%varying)), units(n + size(self%varying)))
    if (n > 0) names(:n) = self%state_names
    if (n > 0) units(:n) = self%state_units
    do j = 1, size(self%varying)
      key = self%key_of(self%varying(j))
      names(n + j) = key%name
      units(n + j) = key%unit
    end do
    call move_alloc(names, self%state_names)
    call move_alloc(units, self%state_units)
  end subroutine material_model_vary

  subroutine material_model_vary_like(self, other)
    !! Takes the constants of another model with the same first ones, which vary as there.
    class(material_model_t), intent(inout) :: self
    class(material_model_t), intent(in) :: other

    self%constant = other%constant
    self%varying = other%varying
    self%state_names = other%state_names
    self%state_units = other%state_units
  end subroutine material_model_vary_like

  pure logical function material_model_varies(self) result(varies)
    !! Does any constant vary with place?
    class(material_model_t), intent(in) :: self

    varies = allocated(self%varying)
  end function material_model_varies

  pure integer function material_model_n_own_state(self) result(n)
    !! State variables without the constants that vary.
    class(material_model_t), intent(in) :: self

    n = self%n_state()
    if (allocated(self%varying)) n = n - size(self%varying)
  end function material_model_n_own_state

  pure subroutine material_model_take_place(self, whole, state)
    !! Makes a copy of a model that varies the uniform one of a point.
    class(material_model_t), intent(inout) :: self
    class(material_model_t), intent(in) :: whole   !! that varies
    real(wp), intent(in) :: state(:)   !! of the point, more may follow [units of `state_units`]
    integer :: j, m

    m = whole%n_own_state()
    do j = 1, size(whole%varying)
      call self%constant(whole%varying(j))%set(state(m + j))
    end do
    if (allocated(self%varying)) deallocate (self%varying)
    call self%prepare()
    self%mean_state = whole%mean_state
    self%mean_of = whole%mean_of
  end subroutine material_model_take_place

  subroutine material_model_update_stress(self, n, strain_increment, stress, state, err, tangent)
    !! As `return_stress`, with the constants of each point's place.
    class(material_model_t), intent(in) :: self
    integer, intent(in) :: n                              !! points
    real(wp), intent(in) :: strain_increment(nsig, n)     !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)            !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)                !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)
    !! derivative of the new stress with respect to the increment, 2 x shear [Pa]
    class(material_model_t), allocatable :: local
    integer :: m, p

    if (.not. allocated(self%varying)) then
      call self%return_stress(n, strain_increment, stress, state, err, tangent)
      return
    end if
    allocate (local, source=self)
    m = self%n_own_state()
    do p = 1, n
      call local%take_place(self, state(:, p))
      if (present(tangent)) then
        call local%return_stress(1, strain_increment(:, p:p), stress(:, p:p), state(:m, p:p), err, &
                                 tangent(:, :, p:p))
      else
        call local%return_stress(1, strain_increment(:, p:p), stress(:, p:p), state(:m, p:p), err)
      end if
    end do
  end subroutine material_model_update_stress

  subroutine material_model_tangent(self, stress, state, tangent)
    !! As `elastic_tangent`, with the constants of the point's place.
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)             !! effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)                 !! more may follow [units of `state_units`]
    real(wp), intent(out) :: tangent(nsig, nsig)     !! for 2 x shear strains [Pa]
    class(material_model_t), allocatable :: local

    if (.not. allocated(self%varying)) then
      call self%elastic_tangent(stress, state, tangent)
      return
    end if
    allocate (local, source=self)
    call local%take_place(self, state)
    call local%elastic_tangent(stress, state, tangent)
  end subroutine material_model_tangent

  pure subroutine material_model_moduli(self, state, bulk, shear)
    !! The moduli of a point of a material that varies.
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: state(:)         !! more may follow [units of `state_units`]
    real(wp), intent(out) :: bulk, shear     !! K and G, the largest the point can have [Pa]
    class(material_model_t), allocatable :: local

    allocate (local, source=self)
    call local%take_place(self, state)
    bulk = local%bulk_modulus()
    shear = local%shear_modulus()
  end subroutine material_model_moduli

  pure function material_model_place_values(self, state) result(values)
    !! The constants of a point that vary [units of theirs].
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: state(:)     !! more may follow [units of `state_units`]
    real(wp), allocatable :: values(:)
    integer :: m

    m = self%n_own_state()
    values = state(m + 1:m + size(self%varying))
  end function material_model_place_values

  subroutine material_model_represent(self, values)
    !! Takes constants that stand for the whole material where one value must do.
    class(material_model_t), intent(inout) :: self
    real(wp), intent(in) :: values(:)    !! as from `place_values` [units of theirs]

    self%constant(self%varying)%constant = values
    call self%prepare()
    call self%vary()
  end subroutine material_model_represent

  pure subroutine material_model_take_own_mean(self, state)
    !! Where all points are as this one its own value is the mean around it.
    class(material_model_t), intent(in) :: self
    real(wp), intent(inout) :: state(:)   !! [units of `state_units`]

    if (self%mean_state > 0) state(self%mean_state) = state(self%mean_of)
  end subroutine material_model_take_own_mean

  subroutine material_model_start_point(self, place, porosity, stress, state, message)
    !! State variables of a point before anything happens, and the constants of its place.
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: place(:)          !! for formulas, the local origin added [m]
    real(wp), intent(in) :: porosity          !! [-]
    real(wp), intent(in) :: stress(nsig)      !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:)       !! more may follow [units of `state_units`]
    character(len=:), allocatable, intent(out) :: message
    !! a constant that is out of range there; unallocated: none is
    class(material_model_t), allocatable :: local
    type(key_t) :: key
    character(len=:), allocatable :: name
    real(wp) :: value
    integer :: m, j

    m = self%n_own_state()
    state = 0.0_wp
    if (.not. allocated(self%varying)) then
      call self%start_state(porosity, stress, state(:m))
      return
    end if
    do j = 1, size(self%varying)
      value = self%constant(self%varying(j))%at(place)
      key = self%key_of(self%varying(j))
      if (.not. (ieee_is_finite(value) .and. in_range(value, key%range))) then
        message = key%name//' is '//to_text(value, 6)//', must be '//trim(key%range)
        return
      end if
      state(m + j) = value
    end do
    allocate (local, source=self)
    call local%take_place(self, state)
    call local%check(name, message)
    if (len(message) > 0) then
      message = name//' '//message
      return
    end if
    deallocate (message)
    call local%start_state(porosity, stress, state(:m))
  end subroutine material_model_start_point

  ! ---------------------------------------------------------------- states

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
    !! The model's own state variables before anything happens: zero, unless it knows better.
    class(material_model_t), intent(in) :: self
    real(wp), intent(in) :: porosity          !! [-]
    real(wp), intent(in) :: stress(nsig)      !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:)   !! own ones [units of `state_units`]

    state = 0.0_wp
    associate (not_used => self%band_width + porosity + stress(1))
    end associate
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

!! The one place that knows the names of all constitutive models, and the set of a scene's.
module dosui_materials
  use dosui_kinds, only: wp
  use dosui_cam_clay, only: cam_clay_t
  use dosui_dafalias_manzari, only: dafalias_manzari_t
  use dosui_drucker_prager, only: drucker_prager_t
  use dosui_key_visitor, only: key_t, name_length
  use dosui_linear_elastic, only: linear_elastic_t
  use dosui_material_model, only: material_model_t
  use dosui_mohr_coulomb, only: mohr_coulomb_t
  implicit none
  private

  public :: create_model, model_index

  character(len=*), parameter, public :: model_names(5) = &
                                         [character(len=16) :: 'linear_elastic', 'mohr_coulomb', &
                                                   'drucker_prager', 'cam_clay', 'dafalias_manzari']

  type, public :: material_holder_t
    !! One material; particles refer to it by its index in the set.
    class(material_model_t), allocatable :: model
  end type material_holder_t

  type, public :: soil_key_t
    !! A key that one model or several have.
    character(len=name_length) :: name = ''
    type(key_t) :: described                      !! as the first model has it; it does not apply
    integer :: place(size(model_names)) = 0       !! index among each model's constants, 0: none
  end type soil_key_t

  type, public :: soil_catalogue_t
    !! All models with default constants, and the keys that they have together, in the order of
    !! the models that bring them first.
    type(material_holder_t), allocatable :: model(:)
    type(soil_key_t), allocatable :: key(:)
  contains
    procedure :: init => soil_catalogue_init
    procedure :: bringer => soil_catalogue_bringer
  end type soil_catalogue_t

  type, public :: material_set_t
    type(material_holder_t), allocatable :: item(:)   !! in the order of the scene
  contains
    procedure :: reduce_strength => material_set_reduce_strength
    procedure :: n_state => material_set_n_state
    procedure :: is_nonlinear => material_set_is_nonlinear
  end type material_set_t

contains

  subroutine create_model(name, model)
    !! A model with the defaults of its constants; unallocated if there is none of that name. A new
    !! model adds its line here, and its name above.
    character(len=*), intent(in) :: name
    class(material_model_t), allocatable, intent(out) :: model

    select case (name)
    case ('linear_elastic')
      allocate (linear_elastic_t :: model)
    case ('mohr_coulomb')
      allocate (mohr_coulomb_t :: model)
    case ('drucker_prager')
      allocate (drucker_prager_t :: model)
    case ('cam_clay')
      allocate (cam_clay_t :: model)
    case ('dafalias_manzari')
      allocate (dafalias_manzari_t :: model)
    case default   ! none
    end select
    if (.not. allocated(model)) return
    call model%declare()
    call model%name_constants()
  end subroutine create_model

  pure integer function model_index(name) result(m)
    !! Number of a model, 0: there is none of that name.
    character(len=*), intent(in) :: name

    m = findloc(model_names == name, .true., dim=1)
  end function model_index

  subroutine soil_catalogue_init(self)
    !! Asks all models for their keys.
    class(soil_catalogue_t), intent(inout) :: self
    type(key_t) :: described   ! of one model
    type(soil_key_t), allocatable :: all(:)
    integer :: m, k, j, n

    if (allocated(self%key)) return
    allocate (self%model(size(model_names)))
    n = 0
    do m = 1, size(model_names)
      call create_model(trim(model_names(m)), self%model(m)%model)
      n = n + size(self%model(m)%model%constant)
    end do
    allocate (all(n))
    n = 0
    do m = 1, size(model_names)
      do k = 1, size(self%model(m)%model%constant)
        described = self%model(m)%model%key_of(k)
        j = findloc(all(:n)%name == described%name, .true., dim=1)
        if (j == 0) then
          n = n + 1
          j = n
          all(j)%name = described%name
          all(j)%described = described
          all(j)%described%applies = .false.
        end if
        all(j)%place(m) = k
      end do
    end do
    allocate (self%key(n))
    do j = 1, n
      self%key(j) = all(j)
      if (len_trim(all(j)%described%only) > 0) cycle
      self%key(j)%described%only = owners(all(j)%place > 0)
    end do
  end subroutine soil_catalogue_init

  pure integer function soil_catalogue_bringer(self, j) result(m)
    !! The model that brings a key first.
    class(soil_catalogue_t), intent(in) :: self
    integer, intent(in) :: j   !! of the key

    m = findloc(self%key(j)%place > 0, .true., dim=1)
  end function soil_catalogue_bringer

  pure function owners(owns) result(text)
    !! The condition that a key of some models has a meaning under, '' if all have it.
    logical, intent(in) :: owns(:)   !! of the models
    character(len=:), allocatable :: text
    integer :: m, left

    text = ''
    if (all(owns)) return
    text = 'model = '
    left = count(owns)
    do m = 1, size(owns)
      if (.not. owns(m)) cycle
      left = left - 1
      text = text//"'"//trim(model_names(m))//"'"
      if (left > 1) text = text//', '
      if (left == 1) text = text//' or '
    end do
  end function owners

  subroutine material_set_reduce_strength(self, factor)
    !! Divides the strengths of all soils by a factor, those that they had first.
    class(material_set_t), intent(inout) :: self
    real(wp), intent(in) :: factor   !! F [-]
    integer :: k

    do k = 1, size(self%item)
      self%item(k)%model%strength_reduction = factor
      call self%item(k)%model%prepare()
      call self%item(k)%model%vary()
    end do
  end subroutine material_set_reduce_strength

  pure integer function material_set_n_state(self) result(n_state)
    !! State variables per particle that the neediest material asks for.
    class(material_set_t), intent(in) :: self
    integer :: k

    n_state = 0
    do k = 1, size(self%item)
      n_state = max(n_state, self%item(k)%model%n_state())
    end do
  end function material_set_n_state

  pure logical function material_set_is_nonlinear(self) result(is_nonlinear)
    !! Has any material a stress that is no linear function of strain?
    class(material_set_t), intent(in) :: self
    integer :: k

    is_nonlinear = any([(self%item(k)%model%is_nonlinear, k=1, size(self%item))])
  end function material_set_is_nonlinear
end module dosui_materials

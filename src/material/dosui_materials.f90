!! The materials of a scene: the one place that knows the names of all constitutive models.
module dosui_materials
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_linear_elastic, only: linear_elastic_t
  use dosui_material_model, only: material_model_t
  use dosui_scene, only: material_t
  implicit none
  private

  public :: create_material

  type, public :: material_holder_t
    !! One material; particles refer to it by its index in the set.
    class(material_model_t), allocatable :: model
  end type material_holder_t

  type, public :: material_set_t
    type(material_holder_t), allocatable :: item(:)   !! in the order of the scene
  contains
    procedure :: init => material_set_init
    procedure :: n_state => material_set_n_state
  end type material_set_t

contains

  subroutine material_set_init(self, materials, err)
    !! Creates the models of all materials.
    class(material_set_t), intent(inout) :: self
    type(material_t), intent(in) :: materials(:)
    type(error_t), intent(inout) :: err
    integer :: k

    if (allocated(self%item)) deallocate (self%item)
    allocate (self%item(size(materials)))
    do k = 1, size(materials)
      call create_material(materials(k), self%item(k)%model, err)
    end do
  end subroutine material_set_init

  pure integer function material_set_n_state(self) result(n_state)
    !! State variables per particle that the neediest material asks for.
    class(material_set_t), intent(in) :: self
    integer :: k

    n_state = 0
    do k = 1, size(self%item)
      n_state = max(n_state, self%item(k)%model%n_state())
    end do
  end function material_set_n_state

  subroutine create_material(material, model, err)
    !! Creates the model that a material of the scene names. A new model adds its case here.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(error_t), intent(inout) :: err
    type(linear_elastic_t) :: elastic

    select case (material%model)
    case ('linear_elastic')
      if (.not. (material%poisson_ratio > -1.0_wp .and. material%poisson_ratio < 0.5_wp)) then
        call err%set('material '''//trim(material%name)//''': poisson_ratio must lie between '// &
                     '-1 and 0.5')
      end if
      if (.not. (material%young_modulus > 0.0_wp .or. material%rigid)) then
        call err%set('material '''//trim(material%name)//''': young_modulus must be positive')
      end if
      if (err%failed()) return
      call elastic%init(material%young_modulus, material%poisson_ratio)
      allocate (model, source=elastic)
    case default
      call err%set('material '''//trim(material%name)//''': unknown model '''// &
                   trim(material%model)//''' (known: linear_elastic)')
    end select
  end subroutine create_material
end module dosui_materials

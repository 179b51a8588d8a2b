!! The materials of a scene: the one place that knows the names of all constitutive models.
module dosui_materials
  use dosui_kinds, only: wp
  use dosui_cam_clay, only: cam_clay_t
  use dosui_dafalias_manzari, only: dafalias_manzari_t
  use dosui_drucker_prager, only: drucker_prager_t
  use dosui_error, only: error_t
  use dosui_linear_elastic, only: linear_elastic_t
  use dosui_material_model, only: material_model_t
  use dosui_mohr_coulomb, only: mohr_coulomb_t
  use dosui_scene, only: material_t
  implicit none
  private

  public :: create_material, follows_finite_strains, has_strength, keeps_strength, weakened

  real(wp), parameter :: degree = acos(-1.0_wp)/180.0_wp

  type, public :: material_holder_t
    !! One material; particles refer to it by its index in the set.
    class(material_model_t), allocatable :: model
  end type material_holder_t

  type, public :: material_set_t
    type(material_holder_t), allocatable :: item(:)   !! in the order of the scene
  contains
    procedure :: init => material_set_init
    procedure :: n_state => material_set_n_state
    procedure :: is_nonlinear => material_set_is_nonlinear
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

  elemental function weakened(material, factor) result(weaker)
    !! A material whose strength is divided by a factor: c/F and tan(phi)/F, before and after
    !! softening, and the dilation and the tensile strength with them.
    type(material_t), intent(in) :: material
    real(wp), intent(in) :: factor   !! F [-]
    type(material_t) :: weaker

    weaker = material
    weaker%cohesion = material%cohesion/factor
    weaker%residual_cohesion = material%residual_cohesion/factor
    weaker%friction_angle = flatter(material%friction_angle)
    weaker%residual_friction_angle = flatter(material%residual_friction_angle)
    weaker%dilation_angle = flatter(material%dilation_angle)
    if (material%tensile_strength < huge(1.0_wp)) then
      weaker%tensile_strength = material%tensile_strength/factor
    end if

  contains

    pure real(wp) function flatter(angle)
      real(wp), intent(in) :: angle   ! [deg]

      flatter = atan(tan(degree*angle)/factor)/degree
    end function flatter
  end function weakened

  pure elemental logical function follows_finite_strains(material) result(follows)
    !! Does all that a material remembers turn with the body? Fabric tensors do not.
    type(material_t), intent(in) :: material

    follows = material%model /= 'dafalias_manzari'
  end function follows_finite_strains

  pure elemental logical function has_strength(material) result(has)
    !! Does a material have the cohesion and friction angle that `weakened` divides?
    type(material_t), intent(in) :: material

    has = material%model == 'mohr_coulomb' .or. material%model == 'drucker_prager'
  end function has_strength

  pure elemental logical function keeps_strength(material) result(keeps)
    !! Does a material fail by constants that `weakened` leaves?
    type(material_t), intent(in) :: material

    keeps = material%model == 'cam_clay' .or. material%model == 'dafalias_manzari'
  end function keeps_strength

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

  subroutine create_material(material, model, err)
    !! Creates the model that a material of the scene names. A new model adds its case here.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(error_t), intent(inout) :: err
    type(linear_elastic_t) :: elastic

    if (material%model /= 'cam_clay' .and. material%model /= 'dafalias_manzari') then
      if (.not. (material%poisson_ratio > -1.0_wp .and. material%poisson_ratio < 0.5_wp)) then
        call err%set('material '''//trim(material%name)//''': poisson_ratio must lie between '// &
                     '-1 and 0.5')
      end if
      if (.not. (material%young_modulus > 0.0_wp .or. material%rigid)) then
        call err%set('material '''//trim(material%name)//''': young_modulus must be positive')
      end if
    end if
    call check_constants(material, err)
    if (err%failed()) return
    select case (material%model)
    case ('linear_elastic')
      call elastic%init(material%young_modulus, material%poisson_ratio)
      allocate (model, source=elastic)
    case ('mohr_coulomb')
      call create_mohr_coulomb(material, model)
    case ('drucker_prager')
      call create_drucker_prager(material, model)
    case ('cam_clay')
      call create_cam_clay(material, model)
    case ('dafalias_manzari')
      call create_dafalias_manzari(material, model)
    case default
      call err%set('material '''//trim(material%name)//''': unknown model '''// &
                   trim(material%model)//''' (known: linear_elastic, mohr_coulomb, '// &
                   'drucker_prager, cam_clay, dafalias_manzari)')
    end select
  end subroutine create_material

  subroutine check_constants(material, err)
    !! Constants that fit each other.
    type(material_t), intent(in) :: material
    type(error_t), intent(inout) :: err

    select case (material%model)
    case ('mohr_coulomb', 'drucker_prager')
      if (material%dilation_angle > material%friction_angle) then
        call err%set('material '''//trim(material%name)//''': dilation_angle must not exceed '// &
                     'friction_angle (such a soil gives work when it is sheared)')
      end if
    case ('cam_clay')
      if (.not. material%swelling_index < material%compression_index) then
        call err%set('material '''//trim(material%name)//''': swelling_index must be below '// &
                     'compression_index')
      end if
    case default   ! every value fits
    end select
  end subroutine check_constants

  subroutine create_mohr_coulomb(material, model)
    !! Planes of strength from the scene's constants.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(mohr_coulomb_t) :: soil

    soil%cohesion = material%cohesion
    soil%friction = degree*material%friction_angle
    soil%dilation = degree*material%dilation_angle
    soil%tensile_strength = material%tensile_strength
    soil%softening_strain = material%softening_in_force()
    soil%residual_cohesion = material%residual_cohesion
    soil%residual_friction = degree*material%residual_friction_angle
    call soil%init(material%young_modulus, material%poisson_ratio)
    allocate (model, source=soil)
  end subroutine create_mohr_coulomb

  subroutine create_drucker_prager(material, model)
    !! The cone from the scene's constants.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(drucker_prager_t) :: soil

    call soil%init(material%young_modulus, material%poisson_ratio, material%cohesion, &
                   degree*material%friction_angle, degree*material%dilation_angle, &
                   material%tensile_strength, trim(material%cone))
    allocate (model, source=soil)
  end subroutine create_drucker_prager

  subroutine create_cam_clay(material, model)
    !! Modified Cam-clay from the scene's constants.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(cam_clay_t) :: soil

    soil%ratio = material%critical_state_ratio
    soil%compression = material%compression_index
    soil%swelling = material%swelling_index
    soil%poisson_ratio = material%poisson_ratio
    soil%over_consolidation = material%over_consolidation_ratio
    soil%least_pressure = material%least_pressure
    soil%reference_pressure = material%reference_pressure
    call soil%init()
    allocate (model, source=soil)
  end subroutine create_cam_clay

  subroutine create_dafalias_manzari(material, model)
    !! The sand from the scene's constants.
    type(material_t), intent(in) :: material
    class(material_model_t), allocatable, intent(out) :: model
    type(dafalias_manzari_t) :: soil

    soil%stiffness = material%shear_modulus_number
    soil%poisson_ratio = material%poisson_ratio
    soil%ratio = material%critical_state_ratio
    soil%extension = material%extension_ratio
    soil%critical_void_ratio = material%critical_void_ratio
    soil%critical_slope = material%critical_slope
    soil%critical_exponent = material%critical_exponent
    soil%yield_ratio = material%yield_ratio
    soil%hardening = material%hardening_number
    soil%hardening_void = material%hardening_void_factor
    soil%bounding_exponent = material%bounding_exponent
    soil%dilatancy = material%dilatancy_number
    soil%dilatancy_exponent = material%dilatancy_exponent
    soil%fabric_limit = material%fabric_limit
    soil%fabric_rate = material%fabric_rate
    soil%atmosphere = material%atmospheric_pressure
    soil%smallest_pressure = material%smallest_pressure
    soil%tolerance = material%substep_tolerance
    soil%reference_pressure = material%reference_pressure
    soil%reference_void_ratio = material%porosity/(1.0_wp - material%porosity)
    call soil%init()
    allocate (model, source=soil)
  end subroutine create_dafalias_manzari
end module dosui_materials

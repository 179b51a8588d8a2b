!! Properties of materials that vary with place, on the particles.
module dosui_place_properties
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_key_visitor, only: in_range
  use dosui_model, only: model_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: conductivity_range, density_range, porosity_range
  use dosui_text, only: to_text, vector_text
  implicit none
  private

  public :: check_properties, choose_representatives, start_states

contains

  subroutine check_properties(model, problems)
    !! Are densities, porosities and conductivities in range at every particle? Collective.
    type(model_t), intent(inout) :: model
    character(len=:), allocatable, intent(inout) :: problems   !! the first that is not
    type(error_t) :: err
    integer :: m, p

    if (.not. any(model%scene%material%varies())) return
    do p = 1, model%particles%count
      m = nint(model%particles%field(model%p%material)%values(1, p))
      associate (material => model%scene%material(m))
        call check(material%solid_density, 'solid_density', density_range)
        call check(material%porosity, 'porosity', porosity_range)
        call check(material%hydraulic_conductivity, 'hydraulic_conductivity', conductivity_range)
      end associate
    end do
    call model%comm%agree(err)
    if (err%failed()) problems = err%message

  contains

    subroutine check(property, key, range)
      !! The value of one property where the particle is.
      type(scalar_function_t), intent(in) :: property
      character(len=*), intent(in) :: key, range
      real(wp) :: value

      if (.not. property%varies()) return
      associate (place => model%particles%field(model%p%position)%values(:, p) + &
                 model%scene%local_origin)
        value = property%at(place)
        if (ieee_is_finite(value) .and. in_range(value, range)) return
        call err%set('material '''//trim(model%scene%material(m)%name)//''': '//key//' is '// &
                     to_text(value, 6)//', must be '//trim(range)//', at '// &
                     vector_text(place)//' m')
      end associate
    end subroutine check
  end subroutine check_properties

  subroutine start_states(model, problems)
    !! State variables that follow from initial stresses, porosities and places. Collective.
    type(model_t), intent(inout) :: model
    character(len=:), allocatable, intent(inout) :: problems   !! a constant that is out of range
    character(len=:), allocatable :: message
    type(error_t) :: err
    integer :: m, p

    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        m = nint(field(h%material)%values(1, p))
        associate (place => field(h%position)%values(:, p) + model%scene%local_origin)
          call model%materials%item(m)%model%start_point( &
            place, field(h%porosity)%values(1, p), field(h%effective_stress)%values(:, p), &
            field(h%state)%values(:, p), message)
          if (allocated(message)) call err%set('material '''//trim(model%scene%material(m)%name)// &
                                               ''': '//message//' at '//vector_text(place)//' m')
        end associate
      end do
    end associate
    call model%comm%agree(err)
    if (err%failed()) problems = err%message
  end subroutine start_states

  subroutine choose_representatives(model)
    !! Gives materials that vary the constants of their stiffest particle, for what is estimated
    !! from the largest modulus. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: values(:)
    real(wp) :: bulk, shear, stiffest
    integer :: m, p, best, owner

    do m = 1, size(model%materials%item)
      if (.not. model%materials%item(m)%model%varies()) cycle
      stiffest = -1.0_wp
      best = 0
      associate (field => model%particles%field, h => model%p, &
                 soil => model%materials%item(m)%model)
        do p = 1, model%particles%count
          if (nint(field(h%material)%values(1, p)) /= m) cycle
          call soil%moduli(field(h%state)%values(:, p), bulk, shear)
          if (bulk + 4.0_wp/3.0_wp*shear > stiffest) best = p
          stiffest = max(stiffest, bulk + 4.0_wp/3.0_wp*shear)
        end do
        call model%comm%maximum_location(stiffest, owner)
        values = soil%place_values(field(h%state)%values(:, max(1, best)))
        if (model%comm%rank /= owner .or. best == 0) values = 0.0_wp
        call model%comm%sum_array(values)
        if (stiffest > 0.0_wp) call soil%represent(values)
      end associate
    end do
  end subroutine choose_representatives
end module dosui_place_properties

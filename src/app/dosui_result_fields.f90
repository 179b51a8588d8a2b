!! The fields of a result file, computed from the model: names, units and values in SI.
module dosui_result_fields
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, axis, voigt6
  use dosui_model, only: model_t
  use dosui_pore_water, only: saturation_at
  use dosui_result_file, only: result_field_t
  use dosui_water_step, only: head_of_particles, darcy_velocity
  implicit none
  private

  public :: result_fields, field_values, field_width, points_in_space

contains

  function result_fields(model) result(fields)
    !! What is written for every particle; dry scenes write no water, soils their own state.
    type(model_t), intent(in) :: model
    type(result_field_t), allocatable :: fields(:)
    integer :: m, k

    fields = [result_field_t('displacement', 'm', 3), result_field_t('velocity', 'm/s', 3), &
              result_field_t('effective_stress', 'Pa', 6), result_field_t('porosity', '-', 1), &
              result_field_t('volume', 'm3', 1), result_field_t('material', '-', 1), &
              result_field_t('rank', '-', 1)]
    if (model%coupled) then
      fields = [result_field_t('pore_pressure', 'Pa', 1), result_field_t('head', 'm', 1), &
                result_field_t('darcy_velocity', 'm/s', 3), fields]
    end if
    if (model%unsaturated) fields = [fields, result_field_t('saturation', '-', 1)]
    if (model%finds_surface) fields = [fields, result_field_t('surface', '-', 1)]
    if (model%p%state == 0) return
    do m = 1, size(model%materials%item)
      associate (material => model%materials%item(m)%model)
        do k = 1, material%n_state()
          if (field_width(trim(material%state_name(k)), fields) > 0) cycle
          fields = [fields, result_field_t(trim(material%state_name(k)), &
                                           trim(material%state_unit(k)), 1)]
        end do
      end associate
    end do
  end function result_fields

  pure integer function field_width(name, fields) result(width)
    !! Components of a result field; 0 when the scene has no such field.
    character(len=*), intent(in) :: name
    type(result_field_t), intent(in) :: fields(:)   !! of the scene's result
    integer :: k

    width = 0
    do k = 1, size(fields)
      if (fields(k)%name == name) width = fields(k)%n_components
    end do
  end function field_width

  subroutine field_values(model, name, values)
    !! Values of a result field on the owned particles, (components, n). Collective for heads.
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(out) :: values(:, :)   !! (components, n) [unit of the field]
    real(wp), allocatable :: head(:), flux(:, :)
    integer :: handle, n

    n = model%particles%count
    select case (name)
    case ('head')
      call head_of_particles(model, head)
      values = reshape(head(1:n) + model%scene%head_at_origin(), [1, n])
    case ('darcy_velocity')
      call darcy_velocity(model, flux)
      values = vectors_in_space(n, flux)
    case ('displacement', 'velocity')
      handle = model%particles%handle(name)
      values = vectors_in_space(n, model%particles%field(handle)%values)
    case ('effective_stress')
      allocate (values(6, n), source=0.0_wp)
      values(voigt6, :) = model%particles%field(model%p%effective_stress)%values(1:nsig, 1:n)
    case ('saturation')
      values = reshape(saturation_at(model, &
                                     model%particles%field(model%p%pore_pressure)%values(1, 1:n)), &
                       [1, n])
    case ('rank')
      allocate (values(1, n), source=real(model%comm%rank, wp))
    case ('porosity')   ! dry bodies may be denser than their grains
      values = max(0.0_wp, model%particles%field(model%p%porosity)%values(:, 1:n))
    case default
      handle = model%particles%handle(name)
      if (handle > 0) then
        values = model%particles%field(handle)%values(1:1, 1:n)
      else
        call state_values(model, name, values)
      end if
    end select
  end subroutine field_values

  subroutine state_values(model, name, values)
    !! A state variable of the materials; 0 in materials that do not have it.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(out) :: values(:, :)
    integer :: place(size(model%materials%item)), m, k, p

    place = 0
    do m = 1, size(place)
      do k = 1, model%materials%item(m)%model%n_state()
        if (model%materials%item(m)%model%state_name(k) == name) place(m) = k
      end do
    end do
    allocate (values(1, model%particles%count), source=0.0_wp)
    do p = 1, model%particles%count
      if (place(model%material(p)) == 0) cycle
      values(1, p) = model%particles%field(model%p%state)%values(place(model%material(p)), p)
    end do
  end subroutine state_values

  function vectors_in_space(n, vectors) result(in_space)
    !! Vectors of the scene's dimension as 3-D vectors; z is always the last component.
    integer, intent(in) :: n
    real(wp), intent(in) :: vectors(:, :)   !! (ndim, >= n)
    real(wp), allocatable :: in_space(:, :)

    allocate (in_space(3, n), source=0.0_wp)
    in_space(axis, :) = vectors(1:ndim, 1:n)
  end function vectors_in_space

  function points_in_space(model) result(points)
    !! Positions of the owned particles as 3-D points, in the scene's own coordinates [m].
    type(model_t), intent(in) :: model
    real(wp), allocatable :: points(:, :)
    integer :: d

    points = vectors_in_space(model%particles%count, &
                              model%particles%field(model%p%current_position)%values)
    do d = 1, ndim
      points(axis(d), :) = points(axis(d), :) + model%scene%local_origin(d)
    end do
  end function points_in_space
end module dosui_result_fields

!! Histories that a scene asks for: values at a point, surface means, settlements, domain sums.
module dosui_probes
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_history, only: history_t
  use dosui_model, only: model_t
  use dosui_result_fields, only: field_values, field_width
  use dosui_result_file, only: result_field_t
  use dosui_scene, only: probe_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: check_probes, add_probe_columns, probe_value

  real(wp), parameter :: fit_radius = 2.4_wp   !! of a point probe's fit, in particle spacings [-]

contains

  subroutine check_probes(probes, fields, problems)
    !! Names fields that this scene does not have; one problem a line.
    type(probe_t), intent(in) :: probes(:)
    type(result_field_t), intent(in) :: fields(:)   !! of the scene's result
    character(len=:), allocatable, intent(inout) :: problems
    integer :: k, width

    do k = 1, size(probes)
      if (probes(k)%kind == 'settlement') cycle
      width = field_width(trim(probes(k)%field), fields)
      if (width == 0) then
        problems = problems//"&probe '"//trim(probes(k)%name)//"': no field '"// &
                   trim(probes(k)%field)//"' in this scene"//new_line('a')
      else if (probes(k)%component > width) then
        problems = problems//"&probe '"//trim(probes(k)%name)//"': component "// &
                   to_text(probes(k)%component)//" of '"//trim(probes(k)%field)// &
                   "' must be in 1 ... "//to_text(width)//new_line('a')
      end if
    end do
  end subroutine check_probes

  subroutine add_probe_columns(probes, fields, history, err)
    !! One history column a probe.
    type(probe_t), intent(in) :: probes(:)
    type(result_field_t), intent(in) :: fields(:)   !! of the scene's result
    type(history_t), intent(inout) :: history
    type(error_t), intent(inout) :: err
    character(len=16) :: unit
    integer :: k, j, column

    do k = 1, size(probes)
      unit = 'm'
      do j = 1, size(fields)
        if (fields(j)%name == probes(k)%field .and. probes(k)%kind /= 'settlement') then
          unit = fields(j)%unit
        end if
      end do
      if (probes(k)%kind == 'domain_sum') unit = trim(unit)//' m3'
      call history%add_column(trim(probes(k)%name), trim(unit), column, err)
    end do
  end subroutine add_probe_columns

  real(wp) function probe_value(model, probe) result(value)
    !! The probe's value now, the same on all ranks. Collective.
    type(model_t), intent(inout) :: model
    type(probe_t), intent(in) :: probe
    real(wp), allocatable :: values(:, :)

    if (probe%kind == 'settlement') then
      value = settlement(model, probe%surface)
      return
    end if
    call field_values(model, trim(probe%field), values)
    select case (probe%kind)
    case ('point')
      value = value_at_point(model, probe%position, values(probe%component, :))
    case ('surface_mean')
      value = surface_mean(model, probe%surface, values(probe%component, :))
    case default
      associate (volume => model%particles%field(model%p%volume)%values)
        value = model%comm%sum(sum(values(probe%component, :)*volume(1, 1:size(values, 2))))
      end associate
    end select
  end function probe_value

  integer function surface_index(model, name) result(index)
    !! Place of a named surface in the scene.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: name

    index = findloc(model%scene%surface%name == name, .true., dim=1)
  end function surface_index

  real(wp) function settlement(model, surface) result(mean)
    !! Mean downward displacement of a surface, weighted with area [m].
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: surface
    real(wp) :: sums(2)
    integer :: p, wanted

    wanted = surface_index(model, surface)
    sums = 0.0_wp
    associate (s => model%surface)
      do p = 1, s%count
        if (nint(s%field(model%s%surface)%values(1, p)) /= wanted) cycle
        sums(1) = sums(1) + s%field(model%s%area)%values(1, p)
        sums(2) = sums(2) - s%field(model%s%area)%values(1, p)* &
                  s%field(model%s%displacement)%values(ndim, p)
      end do
    end associate
    call model%comm%sum_array(sums)
    mean = sums(2)/max(sums(1), tiny(1.0_wp))
  end function settlement

  real(wp) function surface_mean(model, surface, values) result(mean)
    !! Area mean over a surface of the value of the nearest particle on the same rank.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: surface
    real(wp), intent(in) :: values(:)
    real(wp) :: sums(2)
    integer :: p, nearest, wanted, d
    real(wp), allocatable :: distance(:)

    wanted = surface_index(model, surface)
    sums = 0.0_wp
    allocate (distance(size(values)))
    do p = 1, model%surface%count
      if (nint(model%surface%field(model%s%surface)%values(1, p)) /= wanted) cycle
      if (size(values) == 0) cycle
      distance = 0.0_wp
      do d = 1, ndim
        distance = distance + (model%particles%field(model%p%position)%values(d, 1:size(values)) - &
                               model%surface%field(model%s%position)%values(d, p))**2
      end do
      nearest = minloc(distance, dim=1)
      sums(1) = sums(1) + model%surface%field(model%s%area)%values(1, p)
      sums(2) = sums(2) + model%surface%field(model%s%area)%values(1, p)*values(nearest)
    end do
    call model%comm%sum_array(sums)
    mean = sums(2)/max(sums(1), tiny(1.0_wp))
  end function surface_mean

  real(wp) function value_at_point(model, point, values) result(value)
    !! Weighted linear least squares fit of the particles around a point, evaluated there; the
    !! mean of the neighbours where they do not span all directions, NaN-free 0 without any.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: point(ndim)   !! [m]
    real(wp), intent(in) :: values(:)
    integer, parameter :: m = ndim + 1
    real(wp) :: sums((m + 1)*m), basis(m), weight, distance
    real(wp) :: matrix(m, m), right(m)
    integer :: p, i
    logical :: regular

    sums = 0.0_wp
    do p = 1, size(values)
      basis(1) = 1.0_wp
      basis(2:) = (model%particles%field(model%p%position)%values(1:ndim, p) - point)/model%spacing
      distance = norm2(basis(2:))/fit_radius
      if (distance >= 1.0_wp) cycle
      weight = (1.0_wp - distance)**4*(1.0_wp + 4.0_wp*distance)
      do i = 1, m
        sums((i - 1)*m + 1:i*m) = sums((i - 1)*m + 1:i*m) + weight*basis(i)*basis
      end do
      sums(m*m + 1:) = sums(m*m + 1:) + weight*basis*values(p)
    end do
    call model%comm%sum_array(sums)
    matrix = reshape(sums(1:m*m), [m, m])
    right = sums(m*m + 1:)
    value = 0.0_wp
    if (.not. matrix(1, 1) > 0.0_wp) return
    value = right(1)/matrix(1, 1)
    call eliminate(matrix, right, regular)
    if (regular) value = right(1)
  end function value_at_point

  pure subroutine eliminate(matrix, right, regular)
    !! Solves a small symmetric positive definite system by elimination.
    real(wp), intent(inout) :: matrix(:, :), right(:)
    logical, intent(out) :: regular
    real(wp) :: factor, largest
    integer :: i, j, m

    m = size(right)
    largest = matrix(1, 1)
    regular = .true.
    do i = 1, m
      if (.not. matrix(i, i) > 1.0e-6_wp*largest) then
        regular = .false.
        return
      end if
      do j = i + 1, m
        factor = matrix(j, i)/matrix(i, i)
        matrix(j, :) = matrix(j, :) - factor*matrix(i, :)
        right(j) = right(j) - factor*right(i)
      end do
    end do
    do i = m, 1, -1
      right(i) = (right(i) - dot_product(matrix(i, i + 1:), right(i + 1:)))/matrix(i, i)
    end do
  end subroutine eliminate
end module dosui_probes

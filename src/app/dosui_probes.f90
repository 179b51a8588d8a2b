!! Histories that a scene asks for: values at a point, surface means, settlements, domain sums,
!! run-outs.
module dosui_probes
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, axis
  use dosui_error, only: error_t
  use dosui_ghosts, only: find_ghosts
  use dosui_head_operator, only: kind_head
  use dosui_index_map, only: index_map_t
  use dosui_least_squares, only: eliminate
  use dosui_model, only: model_t
  use dosui_neighbours, only: build_neighbours
  use dosui_point_set, only: point_set_t
  use dosui_result_fields, only: field_values, field_width
  use dosui_result_file, only: result_field_t
  use dosui_scene, only: probe_t
  use dosui_seeding, only: region_spacing
  use dosui_surface_sets, only: index_of, set_holds
  use dosui_text, only: to_text
  use dosui_water_step, only: set_surface_data, surface_elevation
  implicit none
  private

  public :: check_probes, probe_unit, probe_value, points_in_reach

  real(wp), parameter :: fit_radius = 2.4_wp   !! of a point probe's fit, in particle spacings [-]
  integer, parameter :: n_fit = ndim + 1                !! unknowns of a fit
  integer, parameter :: n_sum = n_fit*(n_fit + 1)       !! of its equations

contains

  subroutine check_probes(probes, fields, problems)
    !! Names fields that this scene does not have; one problem a line.
    type(probe_t), intent(in) :: probes(:)
    type(result_field_t), intent(in) :: fields(:)   !! of the scene's result
    character(len=:), allocatable, intent(inout) :: problems
    integer :: k, width

    do k = 1, size(probes)
      if (.not. has_field(probes(k))) cycle
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

  pure function probe_unit(probe, fields) result(unit)
    !! Unit of its history.
    type(probe_t), intent(in) :: probe
    type(result_field_t), intent(in) :: fields(:)   !! of the scene's result
    character(len=16) :: unit
    integer :: k

    unit = 'm'
    if (has_field(probe)) then
      k = findloc(fields%name == probe%field, .true., dim=1)
      if (k > 0) unit = fields(k)%unit
    end if
    if (probe%kind == 'domain_sum') unit = trim(unit)//' m3'
  end function probe_unit

  real(wp) function probe_value(model, probe) result(value)
    !! The probe's value now, the same on all ranks [unit of its field]. Collective.
    type(model_t), intent(inout) :: model
    type(probe_t), intent(in) :: probe
    real(wp), allocatable :: values(:, :)

    if (probe%kind == 'settlement') then
      value = settlement(model, probe%surface)
      return
    end if
    if (probe%kind == 'surface_mean') then
      value = mean_over_surface(model, probe)
      return
    end if
    if (probe%kind == 'run_out') then
      value = run_out(model, probe)
      return
    end if
    call field_values(model, trim(probe%field), values)
    select case (probe%kind)
    case ('point')
      value = value_at_point(model, probe%position, values(probe%component, :))
    case default
      associate (volume => model%particles%field(model%p%volume)%values)
        value = model%comm%sum(sum(values(probe%component, :)*volume(1, 1:size(values, 2))))
      end associate
    end select
  end function probe_value

  pure logical function has_field(probe)
    !! Does a probe measure a field of the result file?
    type(probe_t), intent(in) :: probe

    has_field = probe%kind /= 'settlement' .and. probe%kind /= 'run_out'
  end function has_field

  real(wp) function run_out(model, probe) result(distance)
    !! The smallest distance within which a fraction of the mass lies [m]. Particles are as wide as
    !! a square or cube of their volume, so that the distance is continuous in their places and
    !! masses: a block of length L has f L, not the place of some particle. Found by bisection,
    !! which needs no order of the particles: the same on any number of ranks. Collective.
    type(model_t), intent(in) :: model
    type(probe_t), intent(in) :: probe
    integer, parameter :: halvings = 60
    real(wp), parameter :: round_off = 1.0e-12_wp   ! of the mass: gaps between bodies have no slope
    real(wp) :: place(model%particles%count), half(model%particles%count)
    real(wp) :: low, high, wanted
    integer :: k, n

    n = model%particles%count
    associate (field => model%particles%field, h => model%p)
      place = distances(probe, field(h%position)%values(:, 1:n))
      half = 0.5_wp*field(h%volume)%values(1, 1:n)**(1.0_wp/ndim)
      low = huge(1.0_wp)
      high = -huge(1.0_wp)
      if (n > 0) then
        low = minval(place - half)
        high = maxval(place + half)
      end if
      low = model%comm%minimum(low)
      high = model%comm%maximum(high)
      wanted = model%comm%sum(sum(field(h%mass)%values(1, 1:n)))*(probe%fraction - round_off)
      do k = 1, halvings
        distance = 0.5_wp*(low + high)
        if (model%comm%sum(mass_within(n, distance, place, half, field(h%mass)%values)) >= &
            wanted) then
          high = distance
        else
          low = distance
        end if
      end do
    end associate
    distance = high
  end function run_out

  pure function distances(probe, position) result(distance)
    !! Along the probe's direction, or horizontal ones from its position [m].
    type(probe_t), intent(in) :: probe
    real(wp), intent(in) :: position(:, :)
    real(wp) :: distance(size(position, 2))
    real(wp) :: length
    integer :: p

    length = norm2(probe%direction)
    do p = 1, size(distance)
      if (length > 0.0_wp) then
        distance(p) = dot_product(position(:, p) - probe%position, probe%direction)/length
      else
        distance(p) = norm2(position(:ndim - 1, p) - probe%position(:ndim - 1))
      end if
    end do
  end function distances

  pure real(wp) function mass_within(n, distance, place, half, mass) result(within)
    !! Kernel: mass of particles up to a distance, each spread over its width.
    integer, intent(in) :: n
    real(wp), intent(in) :: distance, place(n), half(n)   !! [m]
    real(wp), intent(in) :: mass(n)                       !! [kg]
    integer :: p

    within = 0.0_wp
    do p = 1, n
      within = within + mass(p)*min(1.0_wp, max(0.0_wp, 0.5_wp + &
                                                0.5_wp*(distance - place(p))/half(p)))
    end do
  end function mass_within

  subroutine find_points(model, name, points)
    !! This rank's points of a named surface.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: name
    integer, allocatable, intent(out) :: points(:)
    integer :: wanted, p

    wanted = index_of(model%scene, name)
    points = pack([(p, p=1, model%surface%count)], &
                  [(set_holds(model%surface%field(model%s%surface)%values(:, p), wanted), &
                    p=1, model%surface%count)])
  end subroutine find_points

  real(wp) function settlement(model, surface) result(mean)
    !! Mean downward displacement of a surface, weighted with area [m].
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: surface
    integer, allocatable :: points(:)

    call find_points(model, surface, points)
    associate (displacement => model%surface%field(model%s%displacement)%values)
      mean = area_mean(model, points, -displacement(ndim, points), spread(.true., 1, size(points)))
    end associate
  end function settlement

  real(wp) function area_mean(model, points, values, is_known) result(mean)
    !! Integral over surface points over their area, as far as values are known; 0 if none is.
    !! Collective.
    type(model_t), intent(in) :: model
    integer, intent(in) :: points(:)      !! of this rank
    real(wp), intent(in) :: values(:)     !! at these points
    logical, intent(in) :: is_known(:)
    real(wp) :: sums(2)

    associate (area => model%surface%field(model%s%area)%values(1, :))
      sums(1) = sum(area(points), mask=is_known)
      sums(2) = sum(area(points)*values, mask=is_known)
    end associate
    call model%comm%sum_array(sums)
    mean = sums(2)/max(sums(1), tiny(1.0_wp))
  end function area_mean

  real(wp) function mean_over_surface(model, probe) result(mean)
    !! Area mean over a surface. Displacements and velocities are those of the surface points
    !! themselves, which follow the grid's nodes; heads and pressures are the given ones where
    !! points have a head; all else comes from fits of the particles. Collective.
    type(model_t), intent(inout) :: model
    type(probe_t), intent(in) :: probe
    integer, allocatable :: points(:)
    real(wp), allocatable :: values(:, :), here(:)
    logical, allocatable :: is_known(:)
    integer :: d, handle

    call find_points(model, probe%surface, points)
    if (probe%field == 'displacement' .or. probe%field == 'velocity') then
      allocate (here(size(points)), source=0.0_wp)
      handle = model%surface%handle(trim(probe%field))
      d = findloc(axis, probe%component, dim=1)   ! 0: out of a 1-D or 2-D scene
      if (d > 0) here = model%surface%field(handle)%values(d, points)
      mean = area_mean(model, points, here, spread(.true., 1, size(points)))
      return
    end if
    call field_values(model, trim(probe%field), values)
    call fit_at_points(model, probe%surface, points, values(probe%component, :), here, is_known)
    if (probe%field == 'head' .or. probe%field == 'pore_pressure') then
      call take_given_heads(model, points, probe%field == 'head', here, is_known)
    end if
    mean = area_mean(model, points, here, is_known)
  end function mean_over_surface

  subroutine take_given_heads(model, points, as_head, values, is_known)
    !! Heads that surface points have now, as heads [m] or as pressures [Pa].
    type(model_t), intent(inout) :: model
    integer, intent(in) :: points(:)
    logical, intent(in) :: as_head
    real(wp), intent(inout) :: values(:)
    logical, intent(inout) :: is_known(:)
    real(wp), allocatable :: elevation(:)
    integer :: k

    call set_surface_data(model, model%clock%time)
    call surface_elevation(model, elevation)
    associate (conditions => model%water%hydraulic_conditions)
      do k = 1, size(points)
        if (conditions%kind(points(k)) /= kind_head) cycle
        is_known(k) = .true.
        values(k) = conditions%datum(points(k))
        if (.not. as_head) values(k) = model%scene%water%unit_weight* &
                                       (values(k) - elevation(points(k)))
      end do
    end associate
  end subroutine take_given_heads

  subroutine fit_at_points(model, surface, points, values, fitted, is_known)
    !! Fits of the particles around surface points, as for a point probe, evaluated there. Only
    !! particles of the surface's own material count. Particles of all ranks take part: points
    !! visit the ranks around them as ghosts, and their sums come home. Collective.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: surface
    integer, intent(in) :: points(:)                !! of this rank
    real(wp), intent(in) :: values(:)               !! of particles
    real(wp), allocatable, intent(out) :: fitted(:)
    logical, allocatable, intent(out) :: is_known(:)   !! some particle is near
    type(point_set_t) :: visitors
    type(index_map_t) :: map
    integer, allocatable :: start(:), near(:), own(:)
    real(wp), allocatable :: sums(:, :), x(:, :)
    real(wp) :: spacing
    integer :: k, n, place, r, s

    s = index_of(model%scene, surface)
    r = findloc(model%scene%region%name == model%scene%surface(s)%region, .true., dim=1)
    spacing = region_spacing(model%scene, model%scene%region(r))
    own = pack([(k, k=1, size(values))], model%scene%material(model%material)%name == &
               model%scene%region(r)%material)
    x = model%particles%field(model%p%position)%values(:, own)
    place = visitors%add('position', 'm', ndim, .false., .true., .false., .false.)
    call visitors%resize(size(points))
    visitors%id = int(points, i8)
    visitors%field(place)%values = model%surface%field(model%s%position)%values(:, points)
    call find_ghosts(model%comm, visitors, place, size(own), x, fit_radius*spacing, map)
    n = size(points) + visitors%ghost_count
    call build_neighbours(n, visitors%field(place)%values(:, 1:n), size(own), x, &
                          fit_radius*spacing, start, near, skip_self=.false.)
    allocate (sums(n_sum, n), source=0.0_wp)
    do k = 1, n
      associate (list => near(start(k):start(k + 1) - 1))
        sums(:, k) = fit_sums(visitors%field(place)%values(:, k), spacing, x(:, list), &
                              values(own(list)))
      end associate
    end do
    call map%scatter_add(model%comm, n_sum, sums)
    allocate (fitted(size(points)), is_known(size(points)))
    do k = 1, size(points)
      fitted(k) = fitted_value(sums(:, k))
      is_known(k) = sums(1, k) > 0.0_wp
    end do
  end subroutine fit_at_points

  real(wp) function value_at_point(model, point, values) result(value)
    !! Fit of the particles around a point, evaluated there. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: point(ndim)   !! [m]
    real(wp), intent(in) :: values(:)     !! of particles
    real(wp) :: sums(n_sum)

    associate (x => model%particles%field(model%p%position)%values(:, 1:size(values)))
      sums = fit_sums(point, model%scales%spacing, x, values)
    end associate
    call model%comm%sum_array(sums)
    value = fitted_value(sums)
  end function value_at_point

  integer function points_in_reach(model, point) result(n)
    !! Particles that a point probe sees, of all ranks. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: point(ndim)   !! [m]
    integer :: p

    n = 0
    do p = 1, model%particles%count
      associate (x => model%particles%field(model%p%position)%values(:, p))
        if (norm2(x - point) < fit_radius*model%scales%spacing) n = n + 1
      end associate
    end do
    n = model%comm%sum(n)
  end function points_in_reach

  pure function fit_sums(point, spacing, position, values) result(sums)
    !! Kernel: matrix and right-hand side of a weighted linear least squares fit about a point.
    real(wp), intent(in) :: point(ndim)                     !! [m]
    real(wp), intent(in) :: spacing                         !! of particles [m]
    real(wp), intent(in) :: position(:, :), values(:)       !! of particles [m]
    real(wp) :: sums(n_sum)
    real(wp) :: basis(n_fit), weight, distance
    integer :: p, i

    sums = 0.0_wp
    basis(1) = 1.0_wp
    do p = 1, size(values)
      basis(2:) = (position(:, p) - point)/spacing
      distance = norm2(basis(2:))/fit_radius
      if (distance >= 1.0_wp) cycle
      weight = (1.0_wp - distance)**4*(1.0_wp + 4.0_wp*distance)
      do i = 1, n_fit
        sums((i - 1)*n_fit + 1:i*n_fit) = sums((i - 1)*n_fit + 1:i*n_fit) + weight*basis(i)*basis
      end do
      sums(n_fit**2 + 1:) = sums(n_fit**2 + 1:) + weight*basis*values(p)
    end do
  end function fit_sums

  pure real(wp) function fitted_value(sums) result(value)
    !! The fit at its point; the mean of the neighbours where they do not span all directions,
    !! NaN-free 0 without any.
    real(wp), intent(in) :: sums(:)   !! as from `fit_sums`
    real(wp) :: matrix(n_fit, n_fit), right(n_fit)
    logical :: regular

    matrix = reshape(sums(1:n_fit**2), [n_fit, n_fit])
    right = sums(n_fit**2 + 1:)
    value = 0.0_wp
    if (.not. matrix(1, 1) > 0.0_wp) return
    value = right(1)/matrix(1, 1)
    call eliminate(matrix, right, regular)
    if (regular) value = right(1)
  end function fitted_value
end module dosui_probes

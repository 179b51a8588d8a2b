!! Bodies far from the origin of their coordinates keep their digits: the scene is computed about a
!! point near them, a node of its grid, that results add again.
!!
!! Differences of coordinates are exact, but coordinates as written are decimals, of which
!! 5000000.05 is not a double: its distance from 5000000 would be 0.0499999998 and corners would
!! miss their grid lines. The distance is therefore rounded to the decimals that the
!! coordinate had, if that changes it by no more than the coordinate was rounded to begin with.
module dosui_local_origin
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: hole_t, region_t, scene_t
  use dosui_shapes, only: region_bounds
  implicit none
  private

  public :: choose_local_origin, move_to_origin, distance_from, scene_bounds, resolved_to

  real(wp), parameter :: far_away = 16.0_wp        !! of the bodies' largest side [-]
  real(wp), parameter :: far_cells = 2.0_wp**16    !! from the grid's origin [-]
  integer, parameter :: digits_written = 15        !! of decimals that a double tells apart
  real(wp), parameter :: resolution = 1.0e-6_wp    !! of a cell that coordinates resolve [-]
  real(wp), parameter :: same_phase = 1.0e-6_wp    !! of lattices, in spacings [-]

contains

  pure real(wp) function resolved_to(spacing) result(limit)
    !! Largest coordinate at which doubles lie close enough for cells of this size [m].
    real(wp), intent(in) :: spacing   !! [m]

    limit = resolution*spacing/epsilon(1.0_wp)
  end function resolved_to

  pure subroutine scene_bounds(scene, low, high)
    !! Bounds of all regions [m].
    type(scene_t), intent(in) :: scene
    real(wp), intent(out) :: low(ndim), high(ndim)   !! [m]
    real(wp) :: lowest(ndim), highest(ndim)
    integer :: r

    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do r = 1, size(scene%region)
      if (scene%region(r)%shape == 'stl' .and. .not. allocated(scene%region(r)%body)) cycle
      call region_bounds(scene%region(r), lowest, highest)
      low = min(low, lowest)
      high = max(high, highest)
    end do
  end subroutine scene_bounds

  pure subroutine choose_local_origin(scene, low, high)
    !! Where the scene is computed: at its own origin if the bodies lie near it, else at a node of
    !! the grid near their middle. A grid whose own origin is far gets one nearby.
    type(scene_t), intent(inout) :: scene
    real(wp), intent(in) :: low(ndim), high(ndim)   !! of all bodies [m]
    real(wp) :: middle, side, node
    integer :: d

    scene%local_origin = 0.0_wp
    if (.not. scene%grid_spacing > 0.0_wp .or. .not. all(low < high)) return
    side = maxval(high - low)
    do d = 1, ndim
      middle = 0.5_wp*low(d) + 0.5_wp*high(d)
      node = as_written(scene%grid_origin(d) + scene%grid_spacing* &
                        anint((middle - scene%grid_origin(d))/scene%grid_spacing), &
                        abs(scene%grid_origin(d)))
      if (abs(middle) > far_away*side .or. abs(middle) > far_cells*scene%grid_spacing) then
        scene%local_origin(d) = node
        scene%grid_origin(d) = 0.0_wp
      else if (abs(middle - scene%grid_origin(d)) > far_cells*scene%grid_spacing) then
        scene%grid_origin(d) = node
      end if
    end do
  end subroutine choose_local_origin

  pure elemental real(wp) function distance_from(origin, coordinate) result(distance)
    !! A coordinate as seen from an origin; 'no limit' (huge) stays so [m].
    real(wp), intent(in) :: origin, coordinate   !! [m]

    distance = coordinate
    if (.not. abs(origin) > 0.0_wp .or. abs(coordinate) >= huge(1.0_wp)) return
    distance = as_written(coordinate - origin, max(abs(coordinate), abs(origin)))
  end function distance_from

  pure elemental real(wp) function as_written(value, largest) result(decimal)
    !! The value rounded to the last decimal that numbers of the given size are written with, if
    !! it lies within their round-off of that.
    real(wp), intent(in) :: value
    real(wp), intent(in) :: largest   !! of the numbers it came from
    real(wp) :: scale
    integer :: decimals

    decimal = value
    if (.not. largest >= 1.0_wp) return
    decimals = digits_written - 1 - int(log10(largest))
    if (decimals < 1) return
    scale = 10.0_wp**decimals
    decimal = anint(value*scale)/scale
    if (abs(decimal - value) > spacing(largest)) decimal = value
  end function as_written

  subroutine move_to_origin(scene)
    !! Gives all coordinates of the scene from its local origin. Those of triangulated bodies and of
    !! particles of files are their readers' business.
    type(scene_t), intent(inout) :: scene
    integer :: k

    if (.not. any(abs(scene%local_origin) > 0.0_wp)) return
    associate (origin => scene%local_origin)
      do k = 1, size(scene%region)
        call move_region(scene, scene%region(k))
      end do
      do k = 1, size(scene%surface)
        scene%surface(k)%box_min = distance_from(origin, scene%surface(k)%box_min)
        scene%surface(k)%box_max = distance_from(origin, scene%surface(k)%box_max)
      end do
      do k = 1, size(scene%probe)
        scene%probe(k)%position = distance_from(origin, scene%probe(k)%position)
      end do
      do k = 1, size(scene%barrier)
        if (.not. allocated(scene%barrier(k)%vertices)) cycle
        call move_points(origin, scene%barrier(k)%vertices)
      end do
      if (allocated(scene%rigid_wall)) then
        do k = 1, size(scene%rigid_wall)
          scene%rigid_wall(k)%position = distance_from(origin, scene%rigid_wall(k)%position)
        end do
      end if
      call move_holes(origin, scene%hole)
      scene%domain_min = distance_from(origin, scene%domain_min)
      scene%domain_max = distance_from(origin, scene%domain_max)
    end associate
    call move_levels(scene)
  end subroutine move_to_origin

  pure subroutine move_region(scene, region)
    !! Shape, holes and lattice of a region. Lattices repeat, so that of an unturned region is
    !! counted from near the body, too.
    type(scene_t), intent(in) :: scene
    type(region_t), intent(inout) :: region

    associate (origin => scene%local_origin)
      region%box_min = distance_from(origin, region%box_min)
      region%box_max = distance_from(origin, region%box_max)
      region%centre = distance_from(origin, region%centre)
      region%cut_min = distance_from(origin, region%cut_min)
      region%cut_max = distance_from(origin, region%cut_max)
      if (allocated(region%vertices)) call move_points(origin, region%vertices)
      if (allocated(region%hole)) call move_holes(origin, region%hole)
      region%pivot = distance_from(origin, region%pivot)
    end associate
    if (abs(region%shape_angle) > 0.0_wp .or. abs(region%lattice_angle) > 0.0_wp .or. &
        abs(region%spin) > 0.0_wp) return
    call bring_near(scene, region)
  end subroutine move_region

  pure subroutine bring_near(scene, region)
    !! Moves the pivot of an unturned region by whole spacings of its lattice to the local origin.
    type(scene_t), intent(in) :: scene
    type(region_t), intent(inout) :: region
    real(wp) :: step, phase(ndim)

    step = region%particle_spacing
    if (.not. step > 0.0_wp) step = scene%grid_spacing/real(max(1, region%particles_per_cell), wp)
    if (.not. step > 0.0_wp) return
    phase = region%pivot/step
    where (abs(phase - anint(phase)) > same_phase)
      region%pivot = region%pivot - step*anint(phase)
    else where
      region%pivot = 0.0_wp
    end where
  end subroutine bring_near

  pure subroutine move_points(origin, points)
    !! A list of points.
    real(wp), intent(in) :: origin(ndim)
    real(wp), intent(inout) :: points(:, :)   !! (ndim, n) [m]
    integer :: k

    do k = 1, size(points, 2)
      points(:, k) = distance_from(origin, points(:, k))
    end do
  end subroutine move_points

  pure subroutine move_holes(origin, holes)
    !! Polygons that are cut out.
    real(wp), intent(in) :: origin(ndim)
    type(hole_t), intent(inout) :: holes(:)
    integer :: k

    do k = 1, size(holes)
      if (allocated(holes(k)%vertices)) call move_points(origin, holes(k)%vertices)
    end do
  end subroutine move_holes

  pure subroutine move_level(pattern, origin, value, datum)
    !! A level of water that nothing varies moves itself; of others the datum does.
    type(scalar_function_t), intent(in) :: pattern
    real(wp), intent(in) :: origin          !! [m]
    real(wp), intent(inout) :: value, datum !! [m]

    if (allocated(pattern%formula) .or. allocated(pattern%factor%argument)) then
      datum = origin
    else
      value = distance_from(origin, value)
    end if
  end subroutine move_level

  subroutine move_levels(scene)
    !! Levels of water and ground, heads, and the places of formulas.
    type(scene_t), intent(inout) :: scene
    real(wp) :: level, head
    integer :: k, d

    level = scene%local_origin(ndim)
    head = scene%head_at_origin()
    do k = 1, size(scene%initial_state)
      associate (state => scene%initial_state(k))
        state%water_level = distance_from(level, state%water_level)
        state%surface_level = distance_from(level, state%surface_level)
      end associate
    end do
    do k = 1, size(scene%mechanical_condition)
      associate (condition => scene%mechanical_condition(k))
        condition%pattern%origin(:ndim) = scene%local_origin
        if (condition%kind == 'reservoir') call move_level(condition%pattern, level, &
                                                           condition%value(1), condition%datum)
      end associate
    end do
    do k = 1, size(scene%hydraulic_condition)
      associate (condition => scene%hydraulic_condition(k))
        condition%pattern%origin(:ndim) = scene%local_origin
        if (condition%kind == 'head' .or. condition%kind == 'reservoir') then
          call move_level(condition%pattern, head, condition%value, condition%datum)
        end if
      end associate
    end do
    do d = 1, size(scene%source%force)
      scene%source%force(d)%origin(:ndim) = scene%local_origin
    end do
    scene%source%water%origin(:ndim) = scene%local_origin
  end subroutine move_levels
end module dosui_local_origin

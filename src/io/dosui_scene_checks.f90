!! What can be wrong with a scene although every single value is allowed.
module dosui_scene_checks
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, axis
  use dosui_expression, only: expression_t
  use dosui_name_index, only: name_index_t
  use dosui_namelist, only: namelist_t
  use dosui_problems, only: problems_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_shapes, only: shape_contains
  use dosui_scene, only: axis_name, region_t, scene_t, name_length
  use dosui_scene_keys, only: group_size
  use dosui_table, only: named_table_t, table_t
  use dosui_text, only: lower_case, nearest_name, to_text
  implicit none
  private

  public :: check_scene, check_body_faces

  real(wp), parameter :: unit_tolerance = 1.0e-3_wp   !! of the length of a unit vector [-]

  type, public :: checker_t
    !! Finds the line of what a check complains about.
    type(namelist_t), pointer :: namelist => null()   !! not a copy: it may hold millions of values
    type(problems_t) :: problems
  contains
    procedure :: complain => checker_complain
    procedure :: has => checker_has
  end type checker_t

contains

  subroutine check_scene(scene, namelist, problems)
    !! All checks that need no particles. Corners of clockwise polygons are put in counter-clockwise
    !! order.
    type(scene_t), intent(inout) :: scene
    type(namelist_t), intent(in), target :: namelist
    type(problems_t), intent(inout) :: problems
    type(checker_t) :: checker

    checker%namelist => namelist
    checker%problems = problems
    call check_names(checker, scene)
    call check_references(checker, scene)
    call check_named_tables(checker, scene)
    call check_times(checker, scene)
    call check_domain(checker, scene)
    call check_period(checker, scene)
    call check_regions(checker, scene)
    call check_holes(checker, scene)
    call check_surfaces(checker, scene)
    call check_states(checker, scene)
    call check_conditions(checker, scene)
    call check_water(checker, scene)
    call check_starts(checker, scene)
    call check_transfer(checker, scene)
    call check_soils(checker, scene)
    call check_sources(checker, scene)
    call check_suction(checker, scene)
    call check_barriers(checker, scene)
    call check_rigid_walls(checker, scene)
    call check_shaking(checker, scene)
    call check_output(checker, scene)
    call check_verification(checker, scene)
    problems = checker%problems
  end subroutine check_scene

  subroutine checker_complain(self, group, instance, key, reason, nearest)
    !! Adds a problem at the line of a key, or of its group if the key is not given.
    class(checker_t), intent(inout) :: self
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    character(len=*), intent(in) :: key, reason
    character(len=*), intent(in), optional :: nearest
    integer :: g, k

    g = self%namelist%find(group, instance)
    k = 0
    if (g > 0) k = self%namelist%group(g)%find(key)
    if (k > 0) then
      associate (given => self%namelist%group(g)%key(k))
        call self%problems%add(self%namelist%file, given%line, group, key, given%shown(), reason, &
                               nearest)
      end associate
    else if (g > 0) then
      call self%problems%add(self%namelist%file, self%namelist%group(g)%line, group, key, '', &
                             reason, nearest)
    else
      call self%problems%add(self%namelist%file, 0, group, key, '', reason, nearest)
    end if
  end subroutine checker_complain

  pure logical function checker_has(self, group, instance, key) result(has)
    !! Is a key given in this instance of a group?
    class(checker_t), intent(in) :: self
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: instance
    integer :: g

    has = .false.
    g = self%namelist%find(group, instance)
    if (g > 0) has = self%namelist%group(g)%find(key) > 0
  end function checker_has

  ! ---------------------------------------------------------------- names

  subroutine check_names(checker, scene)
    !! Two things of one name.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=name_length), allocatable :: names(:)
    integer :: k

    names = scene%table%name
    do k = 1, size(names)   ! formulas do not know capitals
      names(k) = lower_case(names(k))
    end do
    call check_distinct(checker, 'table', names)
    names = scene%material%name
    call check_distinct(checker, 'material', names)
    names = scene%region%name
    call check_distinct(checker, 'region', names)
    names = scene%surface%name
    call check_distinct(checker, 'surface', names)
    names = scene%probe%name
    call check_distinct(checker, 'probe', names)
  end subroutine check_names

  subroutine check_distinct(checker, group, names)
    !! Names of the instances of a group must differ.
    type(checker_t), intent(inout) :: checker
    character(len=*), intent(in) :: group
    character(len=*), intent(in) :: names(:)
    type(name_index_t) :: index
    integer :: k, first, g

    call index%add_all(names)
    do k = 2, size(names)
      if (names(k) == '') cycle
      first = index%find(names(k))
      if (first == k) cycle
      g = checker%namelist%find(group, first)
      call checker%complain(group, k, 'name', 'the name is taken already (line '// &
                            to_text(checker%namelist%group(g)%line)//')')
    end do
  end subroutine check_distinct

  subroutine check_references(checker, scene)
    !! Names of things that do not exist.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=name_length), allocatable :: used(:), known(:)

    used = scene%region%material
    known = scene%material%name
    call check_known(checker, 'region', 'material', used, known)
    known = scene%region%name
    used = scene%initial_state%region
    call check_known(checker, 'initial_state', 'region', used, known)
    used = scene%surface%region
    call check_known(checker, 'surface', 'region', used, known)
    known = scene%surface%name
    used = scene%mechanical_condition%surface
    call check_known(checker, 'mechanical_condition', 'surface', used, known)
    used = scene%hydraulic_condition%surface
    call check_known(checker, 'hydraulic_condition', 'surface', used, known)
    used = scene%probe%surface
    call check_known(checker, 'probe', 'surface', used, known)
  end subroutine check_references

  subroutine check_known(checker, group, key, used, known)
    !! The names used in a key must be known.
    type(checker_t), intent(inout) :: checker
    character(len=*), intent(in) :: group, key
    character(len=*), intent(in) :: used(:), known(:)
    character(len=:), allocatable :: nearest
    type(name_index_t) :: index
    integer :: k

    nearest = ''
    call index%add_all(known)
    do k = 1, size(used)
      if (used(k) == '') cycle
      if (index%find(used(k)) > 0) cycle
      nearest = nearest_name(trim(used(k)), known)
      if (len(nearest) > 0) nearest = "'"//nearest//"'"
      call checker%complain(group, k, key, 'unknown '//key, nearest)
    end do
  end subroutine check_known

  ! ---------------------------------------------------------------- times and tables

  subroutine check_times(checker, scene)
    !! Output times within the run; tables of the conditions.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: k

    associate (time => scene%time)
      if (time%end_time > 0.0_wp .and. any(time%output_times > time%end_time)) then
        call checker%complain('time', 1, 'output_times', 'must be > 0 and <= end_time = '// &
                              to_text(time%end_time)//' [s]')
      end if
      if (.not. is_increasing(time%output_times)) then
        call checker%complain('time', 1, 'output_times', 'must increase strictly')
      end if
      if (time%time_step > time%largest_step) then
        call checker%complain('time', 1, 'time_step', 'must be <= largest_step = '// &
                              to_text(time%largest_step)//' [s]')
      end if
    end associate
    do k = 1, size(scene%mechanical_condition)
      call check_pattern(checker, scene, 'mechanical_condition', k, 'formula', &
                         scene%mechanical_condition(k)%pattern)
    end do
    do k = 1, size(scene%hydraulic_condition)
      call check_pattern(checker, scene, 'hydraulic_condition', k, 'formula', &
                         scene%hydraulic_condition(k)%pattern)
    end do
  end subroutine check_times

  subroutine check_pattern(checker, scene, group, instance, key, pattern)
    !! A table and a formula that can be read.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    character(len=*), intent(in) :: key   !! of the formula
    type(scalar_function_t), intent(in) :: pattern
    type(scalar_function_t) :: trial
    character(len=:), allocatable :: message

    call check_table(checker, group, instance, 'factor_times', 'factor_values', pattern%factor)
    trial = pattern
    call trial%prepare([axis_name(axis), 't'], message, scene%table)
    if (allocated(message)) call checker%complain(group, instance, key, message)
  end subroutine check_pattern

  subroutine check_named_tables(checker, scene)
    !! Names that formulas can call, and entries.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(expression_t) :: expression
    character(len=:), allocatable :: message
    integer :: k

    do k = 1, size(scene%table)
      associate (table => scene%table(k))
        call check_table(checker, 'table', k, 'arguments', 'values', table%table_t)
        if (.not. (allocated(table%file) .or. checker%has('table', k, 'arguments'))) then
          call checker%complain('table', k, '', 'needs arguments and values, or a file')
        else if (allocated(table%file) .and. checker%has('table', k, 'arguments')) then
          call checker%complain('table', k, 'arguments', &
                                'have no meaning beside file: leave one of them away')
        end if
        if (len_trim(table%name) == 0) cycle   ! missing
        call expression%parse(trim(table%name)//'(1)', [axis_name, 't'], message, &
                              [named_table_t(name=table%name)])
        if (.not. (allocated(message) .or. expression%uses(table%name))) message = ''   ! sin(1)
        if (allocated(message)) then
          call checker%complain('table', k, 'name', 'must be a letter, then letters, digits '// &
                                'and _, and no function or variable that formulas have already')
        end if
      end associate
    end do
  end subroutine check_named_tables

  subroutine check_table(checker, group, instance, arguments, values, table)
    !! Both columns, of one length, with increasing arguments.
    type(checker_t), intent(inout) :: checker
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    character(len=*), intent(in) :: arguments, values   !! keys
    type(table_t), intent(in) :: table

    if (checker%has(group, instance, arguments) .neqv. checker%has(group, instance, values)) then
      call checker%complain(group, instance, &
                            arguments, &
                            arguments//' and '//values//' belong together: one is missing')
    end if
    if (allocated(table%argument)) then
      if (.not. is_increasing(table%argument)) then
        call checker%complain(group, instance, arguments, 'must increase strictly')
      end if
      if (allocated(table%value)) then
        if (size(table%argument) /= size(table%value)) then
          call checker%complain(group, instance, values, 'needs as many values as '//arguments// &
                                ' has ('//to_text(size(table%argument))//'), has '// &
                                to_text(size(table%value)))
        end if
      end if
    end if
  end subroutine check_table

  pure logical function is_increasing(values)
    !! Is every value greater than the one before?
    real(wp), intent(in) :: values(:)

    is_increasing = all(values(2:) > values(:size(values) - 1))
  end function is_increasing

  ! ---------------------------------------------------------------- shapes

  subroutine check_domain(checker, scene)
    !! Lower corner below the upper one.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene

    if (.not. all(scene%domain_min < scene%domain_max)) then
      call checker%complain('grid', 1, 'domain_max', 'must be above domain_min')
    end if
  end subroutine check_domain

  subroutine check_period(checker, scene)
    !! Whole cells, a grid through which nothing moves, and no wall that would not repeat.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    real(wp) :: cells(ndim)
    integer :: k

    if (.not. any(scene%grid_period > 0.0_wp) .or. .not. scene%grid_spacing > 0.0_wp) return
    cells = scene%grid_period/scene%grid_spacing
    if (any(scene%grid_period > 0.0_wp .and. &
            (cells < 1.5_wp .or. abs(cells - anint(cells)) > 1.0e-6_wp*cells))) then
      call checker%complain('grid', 1, 'period', 'must be two or more whole grid spacings')
    end if
    do k = 1, group_size(scene, 'rigid_wall')
      if (any(scene%grid_period > 0.0_wp .and. abs(scene%rigid_wall(k)%normal) > 0.0_wp)) then
        call checker%complain('rigid_wall', k, 'normal', &
                              'must be perpendicular to the axes with a period in &grid')
      end if
    end do
  end subroutine check_period

  subroutine check_regions(checker, scene)
    !! Boxes, polygons, circles, spheres and bodies of files.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(inout) :: scene
    integer :: r

    do r = 1, size(scene%region)
      associate (region => scene%region(r))
        if (ndim == 1 .and. abs(region%shape_angle) > 0.0_wp) then
          call checker%complain('region', r, 'shape_angle', 'has no meaning in 1-D')
        end if
        if (ndim == 1 .and. abs(region%lattice_angle) > 0.0_wp) then
          call checker%complain('region', r, 'lattice_angle', 'has no meaning in 1-D')
        end if
        if (allocated(region%particle_file)) then
          if (region%jitter > 0.0_wp) call checker%complain('region', r, 'jitter', &
                                                        'moves particles of lattices, not of files')
          if (abs(region%lattice_angle) > 0.0_wp) then
            call checker%complain('region', r, 'lattice_angle', &
                                  'turns a lattice; this region takes its particles from a file')
          end if
        end if
        if (ndim == 1 .and. abs(region%spin) > 0.0_wp) then
          call checker%complain('region', r, 'spin', 'has no meaning in 1-D')
        end if
        if (region%shape == 'box') then
          if (checker%has('region', r, 'box_min') .and. checker%has('region', r, 'box_max') .and. &
              .not. all(region%box_min < region%box_max)) then
            call checker%complain('region', r, 'box_max', 'must be above box_min everywhere')
          end if
        else if (region%shape == 'polygon') then
          if (ndim /= 2) then
            call checker%complain('region', r, 'shape', 'a polygon needs a scene in 2-D')
          else if (allocated(region%vertices)) then
            call check_polygon(checker, scene, r)
          end if
        else if (region%shape == 'circle' .or. region%shape == 'sphere') then
          if (ndim /= merge(2, 3, region%shape == 'circle')) then
            call checker%complain('region', r, 'shape', 'a '//trim(region%shape)//' needs a '// &
                                  'scene in '//merge('2-D', '3-D', region%shape == 'circle'))
          else if (region%radius > 0.0_wp) then
            call check_cuts(checker, region, r)
          end if
        else if (region%shape == 'stl' .and. ndim /= 3) then
          call checker%complain('region', r, 'shape', 'a triangulated surface needs a scene in 3-D')
        end if
      end associate
    end do
  end subroutine check_regions

  subroutine check_holes(checker, scene)
    !! Holes that lie in their regions, which get copies with clockwise corners.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(inout) :: scene
    integer :: k, n, r

    do r = 1, size(scene%region)
      allocate (scene%region(r)%hole(0))
    end do
    do k = 1, group_size(scene, 'hole')
      if (ndim /= 2) then
        call checker%complain('hole', k, '', 'needs a scene in 2-D')
        cycle
      end if
      r = findloc(scene%region%name == scene%hole(k)%region, .true., dim=1)
      if (r == 0) then
        if (scene%hole(k)%region /= '') call checker%complain('hole', k, 'region', &
                                                              'no &region is called so')
        cycle
      end if
      if (.not. allocated(scene%hole(k)%vertices)) cycle
      n = size(scene%hole(k)%vertices, 2)
      if (n < 3) then
        call checker%complain('hole', k, 'vertices', 'a polygon needs at least 3 corners')
      else if (.not. is_simple(scene%hole(k)%vertices)) then
        call checker%complain('hole', k, 'vertices', &
                              'the polygon crosses or touches itself, or two corners coincide')
      else
        if (polygon_area(scene%hole(k)%vertices) > 0.0_wp) then
          scene%hole(k)%vertices(:, 2:n) = scene%hole(k)%vertices(:, n:2:-1)
        end if
        if (.not. scene%region(r)%shape == '') then
          if (.not. lies_within(scene%region(r), scene%hole(k)%vertices)) then
            call checker%complain('hole', k, 'vertices', 'a corner lies outside the region or '// &
                                  'in an earlier hole')
            cycle
          end if
        end if
        scene%region(r)%hole = [scene%region(r)%hole, scene%hole(k)]
      end if
    end do
  end subroutine check_holes

  pure logical function lies_within(region, vertices) result(within)
    !! Do all corners lie in the region, as it is before turning?
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n) [m]
    type(region_t) :: unturned
    integer :: k

    within = .true.
    if (region%shape == 'polygon' .and. .not. allocated(region%vertices)) return
    unturned = region
    unturned%shape_angle = 0.0_wp
    do k = 1, size(vertices, 2)
      within = within .and. shape_contains(unturned, vertices(:, k), 0.0_wp)
    end do
  end function lies_within

  subroutine check_cuts(checker, region, r)
    !! Cuts that leave a part of the circle or sphere.
    type(checker_t), intent(inout) :: checker
    type(region_t), intent(in) :: region
    integer, intent(in) :: r
    real(wp) :: nearest(ndim)

    if (.not. all(region%cut_min < region%cut_max)) then
      call checker%complain('region', r, 'cut_max', 'must be above cut_min everywhere')
      return
    end if
    nearest = min(max(region%centre, region%cut_min), region%cut_max)
    if (norm2(nearest - region%centre) >= region%radius) then
      call checker%complain('region', r, 'cut_min', 'the cuts leave nothing of the '// &
                            trim(region%shape))
    end if
  end subroutine check_cuts

  subroutine check_polygon(checker, scene, r)
    !! A simple polygon with an inside; clockwise corners are turned round.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(inout) :: scene
    integer, intent(in) :: r
    integer :: n

    n = size(scene%region(r)%vertices, 2)
    if (n < 3) then
      call checker%complain('region', r, 'vertices', 'a polygon needs at least 3 corners')
      return
    end if
    if (.not. is_simple(scene%region(r)%vertices)) then
      call checker%complain('region', r, 'vertices', &
                            'the polygon crosses or touches itself, or two corners coincide')
      return
    end if
    if (polygon_area(scene%region(r)%vertices) > 0.0_wp) return
    if (any(scene%surface%region == scene%region(r)%name .and. &
            scene%surface%face(1:4) == 'edge')) then
      call checker%complain('region', r, 'vertices', 'must be counter-clockwise (from x '// &
                            'towards z), because surfaces count its edges')
    end if
    scene%region(r)%vertices(:, 2:n) = scene%region(r)%vertices(:, n:2:-1)
  end subroutine check_polygon

  pure real(wp) function polygon_area(vertices) result(area)
    !! Area of a polygon, negative if its corners are clockwise [m2].
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n)
    integer :: k, next, last

    last = size(vertices, 1)
    area = 0.0_wp
    do k = 1, size(vertices, 2)
      next = modulo(k, size(vertices, 2)) + 1
      area = area + 0.5_wp*(vertices(1, k)*vertices(last, next) - &
                            vertices(1, next)*vertices(last, k))
    end do
  end function polygon_area

  pure logical function is_simple(vertices)
    !! Does no edge of a polygon cross or touch another one, beside the corners of neighbours?
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n)
    real(wp) :: edge(ndim), back(ndim)
    integer :: i, j, n

    n = size(vertices, 2)
    is_simple = .false.
    do i = 1, n
      edge = vertices(:, modulo(i, n) + 1) - vertices(:, i)
      back = vertices(:, modulo(i - 2, n) + 1) - vertices(:, i)
      if (.not. norm2(edge) > 0.0_wp) return
      ! a spike: the edges on both sides of a corner lie on each other
      if (abs(turn(back, edge)) <= 1.0e-12_wp*norm2(edge)*norm2(back) .and. &
          dot_product(edge, back) > 0.0_wp) return
      do j = i + 2, n
        if (i == 1 .and. j == n) cycle
        if (segments_meet(vertices(:, i), vertices(:, modulo(i, n) + 1), vertices(:, j), &
                          vertices(:, modulo(j, n) + 1))) return
      end do
    end do
    is_simple = .true.
  end function is_simple

  pure logical function segments_meet(a, b, c, d) result(meet)
    !! Have the segments ab and cd a point in common?
    real(wp), intent(in) :: a(ndim), b(ndim), c(ndim), d(ndim)
    real(wp) :: side(4)

    side = [turn(b - a, c - a), turn(b - a, d - a), turn(d - c, a - c), turn(d - c, b - c)]
    meet = .false.
    if (any(max(a, b) < min(c, d)) .or. any(max(c, d) < min(a, b))) return
    meet = side(1)*side(2) <= 0.0_wp .and. side(3)*side(4) <= 0.0_wp
  end function segments_meet

  pure real(wp) function turn(a, b)
    !! Is b to the left (> 0) or to the right (< 0) of a, in the x-z plane?
    real(wp), intent(in) :: a(ndim), b(ndim)

    turn = a(1)*b(ndim) - a(ndim)*b(1)
  end function turn

  subroutine check_surfaces(checker, scene)
    !! Faces that the region has; cutting boxes.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=name_length), allocatable :: faces(:)
    character(len=:), allocatable :: nearest
    type(name_index_t) :: regions
    integer :: s, r

    nearest = ''
    call regions%add_all(scene%region%name)
    do s = 1, size(scene%surface)
      associate (surface => scene%surface(s))
        if (.not. all(surface%box_min < surface%box_max)) then
          call checker%complain('surface', s, 'box_max', 'must be above box_min everywhere')
        end if
        r = regions%find(surface%region)
        if (r == 0 .or. surface%face == '') cycle
        if (surface%face == 'free') then
          call check_free_surface(checker, scene, s)
          cycle
        end if
        if (scene%region(r)%shape == '' .or. scene%region(r)%shape == 'stl') cycle
        if (scene%region(r)%shape == 'polygon' .and. &
            .not. allocated(scene%region(r)%vertices)) cycle
        call list_faces(scene, r, faces)
        faces = [character(len=name_length) :: faces, 'free']
        if (any(faces == surface%face)) cycle
        nearest = nearest_name(trim(surface%face), faces)
        if (len(nearest) > 0) nearest = "'"//nearest//"'"
        if (scene%region(r)%shape == 'polygon') nearest = ''
        call checker%complain('surface', s, 'face', 'the region has the faces '//listed(faces), &
                              nearest)
      end associate
    end do
  end subroutine check_surfaces

  subroutine check_free_surface(checker, scene, s)
    !! One a region, whole, and not held by anything.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: s
    integer :: c

    associate (surface => scene%surface(s))
      if (any(scene%surface(:s - 1)%face == 'free' .and. &
              scene%surface(:s - 1)%region == surface%region)) then
        call checker%complain('surface', s, 'face', 'its region has a free surface already')
      end if
      if (any(surface%box_min > -huge(1.0_wp)) .or. any(surface%box_max < huge(1.0_wp))) then
        call checker%complain('surface', s, 'box_min', 'a free surface is no part of a face')
      end if
      do c = 1, size(scene%mechanical_condition)
        if (scene%mechanical_condition(c)%surface /= surface%name .or. &
            scene%mechanical_condition(c)%kind == '') cycle
        if (scene%mechanical_condition(c)%is_load()) cycle
        call checker%complain('mechanical_condition', c, 'kind', 'nothing holds or moves a '// &
                              'free surface: name the face, or take a &rigid_wall')
      end do
    end associate
  end subroutine check_free_surface

  subroutine check_body_faces(scene, namelist, problems)
    !! Faces of bodies that came from files after all other checks.
    type(scene_t), intent(in) :: scene
    type(namelist_t), intent(in), target :: namelist
    type(problems_t), intent(inout) :: problems
    type(checker_t) :: checker
    character(len=name_length), allocatable :: faces(:)
    integer :: s, r, k

    checker%namelist => namelist
    checker%problems = problems
    do s = 1, size(scene%surface)
      r = findloc(scene%region%name == scene%surface(s)%region, .true., dim=1)
      if (r == 0 .or. scene%surface(s)%face == '') cycle
      if (.not. allocated(scene%region(r)%body)) cycle
      faces = pack(scene%region(r)%solid, scene%region(r)%solid /= '')
      faces = [character(len=name_length) :: faces, &
               ('face'//to_text(k), k=1, scene%region(r)%body%n_face), 'all ', 'free']
      if (any(faces == scene%surface(s)%face)) cycle
      call checker%complain('surface', s, 'face', 'the region has the faces '//listed(faces)// &
                            ' (--check of a scene without this surface tells where)')
    end do
    problems = checker%problems
  end subroutine check_body_faces

  subroutine list_faces(scene, r, faces)
    !! Names of the faces of a region.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    character(len=name_length), allocatable, intent(out) :: faces(:)
    character(len=1), parameter :: axes(3) = ['x', 'y', 'z']
    integer :: k

    if (scene%region(r)%shape == 'polygon') then
      allocate (faces(size(scene%region(r)%vertices, 2) + 1))
      do k = 1, size(faces) - 1
        faces(k) = 'edge'//to_text(k)
      end do
    else if (scene%region(r)%shape == 'circle' .or. scene%region(r)%shape == 'sphere') then
      allocate (faces(0))
      associate (region => scene%region(r))
        do k = 1, ndim
          if (region%cut_min(k) > region%centre(k) - region%radius) then
            faces = [character(len=name_length) :: faces, axes(merge(3, k, k == ndim))//'-']
          end if
          if (region%cut_max(k) < region%centre(k) + region%radius) then
            faces = [character(len=name_length) :: faces, axes(merge(3, k, k == ndim))//'+']
          end if
        end do
      end associate
      faces = [character(len=name_length) :: faces, 'round', 'all']
    else
      allocate (faces(2*ndim + 1))
      do k = 1, ndim
        faces(2*k - 1) = axes(merge(3, k, k == ndim))//'-'
        faces(2*k) = axes(merge(3, k, k == ndim))//'+'
      end do
    end if
    if (allocated(scene%region(r)%hole)) then
      do k = 1, size(scene%region(r)%hole)
        faces = [character(len=name_length) :: 'hole'//to_text(k), faces]
      end do
    end if
    faces(size(faces)) = 'all'
  end subroutine list_faces

  pure function listed(names) result(text)
    !! Names with commas between them; long lists are cut.
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: text
    integer :: k

    text = trim(names(1))
    do k = 2, size(names)
      if (k > 6 .and. k < size(names)) cycle
      if (k == size(names) .and. k > 7) text = text//', ...'
      text = text//', '//trim(names(k))
    end do
  end function listed

  ! ---------------------------------------------------------------- states and conditions

  subroutine check_states(checker, scene)
    !! Initial states that need gravity or a box.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    logical :: is_weightless
    integer :: k

    is_weightless = .not. abs(scene%gravity(ndim)) > 0.0_wp
    do k = 1, size(scene%initial_state)
      associate (state => scene%initial_state(k))
        if (state%pore_pressure == 'hydrostatic' .and. is_weightless) then
          call checker%complain('initial_state', k, 'pore_pressure', &
                                'needs gravity in &scene with a last component /= 0')
        end if
        if (state%effective_stress == 'geostatic' .and. is_weightless) then
          call checker%complain('initial_state', k, 'effective_stress', &
                                'needs gravity in &scene with a last component /= 0')
        end if
        if (state%mode_number > 0 .and. size(scene%region) > 0) then
          if (scene%region(1)%shape /= 'box') then
            call checker%complain('initial_state', k, 'mode_number', &
                                  'needs a box as the first region')
          end if
        end if
      end associate
    end do
    if (scene%mechanics%damping == 'local' .and. scene%mechanics%damping_coefficient >= 1.0_wp) then
      call checker%complain('mechanics', 1, 'damping_coefficient', &
                            'local damping must be < 1 [-]')
    end if
  end subroutine check_states

  subroutine check_conditions(checker, scene)
    !! Two hydraulic conditions, or two walls, on one surface.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(name_index_t) :: wet, walls
    integer :: k, first

    associate (condition => scene%hydraulic_condition)
      do k = 1, size(condition)
        if (condition(k)%surface == '') cycle
        first = wet%find(condition(k)%surface)
        if (first == 0) call wet%add(condition(k)%surface, k)
        if (first > 0) call complain_of_second(checker, 'hydraulic_condition', k, first)
      end do
    end associate
    associate (condition => scene%mechanical_condition)
      do k = 1, size(condition)
        if (condition(k)%surface == '' .or. condition(k)%is_load()) cycle
        first = walls%find(condition(k)%surface)
        if (first == 0) call walls%add(condition(k)%surface, k)
        if (first > 0) call complain_of_second(checker, 'mechanical_condition', k, first)
      end do
    end associate
  end subroutine check_conditions

  subroutine complain_of_second(checker, group, second, first)
    !! Says that a surface has a condition already.
    type(checker_t), intent(inout) :: checker
    character(len=*), intent(in) :: group
    integer, intent(in) :: second, first
    integer :: g

    g = checker%namelist%find(group, first)
    call checker%complain(group, second, 'surface', 'has such a condition already (line '// &
                          to_text(checker%namelist%group(g)%line)//')')
  end subroutine complain_of_second

  subroutine check_water(checker, scene)
    !! Water groups in a dry scene.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=*), parameter :: reason = &
                                   'has a meaning only with water = ''coupled'' in &scene'
    integer :: k

    if (scene%water_mode /= 'none') return
    if (checker%namelist%count('water') > 0) call checker%complain('water', 1, '', reason)
    do k = 1, group_size(scene, 'hydraulic_condition')
      call checker%complain('hydraulic_condition', k, '', reason)
    end do
    do k = 1, size(scene%probe)
      select case (scene%probe(k)%field)
      case ('pore_pressure', 'head', 'darcy_velocity')
        call checker%complain('probe', k, 'field', reason)
      case default
      end select
    end do
  end subroutine check_water

  subroutine check_shaking(checker, scene)
    !! What shaken bases need.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene

    if (checker%namelist%count('base_motion') == 0) return
    call check_pattern(checker, scene, 'base_motion', 1, 'formula', scene%base_motion%pattern)
    if (any(abs(scene%base_motion%acceleration) > 0.0_wp)) then
      if (all(scene%material%rigid)) call checker%complain('base_motion', 1, '', 'moves '// &
                                                           'nothing: all materials are rigid')
    else if (checker%has('base_motion', 1, 'file') .or. &
             checker%has('base_motion', 1, 'formula') .or. &
             checker%has('base_motion', 1, 'factor_times')) then
      call checker%complain('base_motion', 1, 'acceleration', 'must not be zero')
    end if
    if (scene%mechanics%density_scaling > 1.0_wp) then
      call checker%complain('mechanics', 1, 'density_scaling', 'does not go with &base_motion')
    end if
    if (allocated(scene%base_motion%file) .and. &
        allocated(scene%base_motion%pattern%factor%argument)) then
      call checker%complain('base_motion', 1, 'file', 'takes the place of factor_times: '// &
                            'give one of them')
    end if
  end subroutine check_shaking

  subroutine check_rigid_walls(checker, scene)
    !! Walls that have a side.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: k

    do k = 1, group_size(scene, 'rigid_wall')
      if (checker%has('rigid_wall', k, 'normal') .and. &
          .not. norm2(scene%rigid_wall(k)%normal) > 0.0_wp) then
        call checker%complain('rigid_wall', k, 'normal', 'must not be zero')
      end if
    end do
  end subroutine check_rigid_walls

  subroutine check_barriers(checker, scene)
    !! Chains and polygons that can be barriers.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: k, n, least

    least = merge(3, 2, ndim == 3)
    do k = 1, group_size(scene, 'barrier')
      if (ndim == 1) call checker%complain('barrier', k, '', 'needs dimension = 2 or 3')
      if (scene%water_mode == 'none') then
        call checker%complain('barrier', k, '', 'has a meaning only with water = ''coupled''')
      end if
      if (.not. allocated(scene%barrier(k)%vertices)) cycle
      associate (vertices => scene%barrier(k)%vertices)
        n = size(vertices, 2)
        if (n < least) then
          call checker%complain('barrier', k, 'vertices', 'needs at least '//to_text(least)// &
                                ' points')
        else if (any(norm2(vertices(:, 2:) - vertices(:, :n - 1), dim=1) <= 0.0_wp)) then
          call checker%complain('barrier', k, 'vertices', 'has two equal points in a row')
        else if (ndim == 3 .and. .not. is_flat(vertices)) then
          call checker%complain('barrier', k, 'vertices', 'must be corners of a flat convex '// &
                                'polygon, in order')
        end if
      end associate
    end do
  end subroutine check_barriers

  pure logical function is_flat(vertices) result(flat)
    !! Do all corners of a polygon in space turn the same way about one normal?
    real(wp), intent(in) :: vertices(:, :)   !! (3, n)
    real(wp) :: before(3), after(3), turn(3), normal(3)
    integer :: k, n

    n = size(vertices, 2)
    flat = size(vertices, 1) == 3
    if (.not. flat) return
    do k = 1, n
      before = vertices(:, modulo(k, n) + 1) - vertices(:, k)
      after = vertices(:, modulo(k + 1, n) + 1) - vertices(:, modulo(k, n) + 1)
      turn = [before(2)*after(3) - before(3)*after(2), before(3)*after(1) - before(1)*after(3), &
              before(1)*after(2) - before(2)*after(1)]
      if (k == 1) normal = turn
      flat = flat .and. norm2(turn) > 0.0_wp .and. &
             dot_product(turn, normal) >= (1.0_wp - 1.0e-6_wp)*norm2(turn)*norm2(normal)
    end do
  end function is_flat

  subroutine check_suction(checker, scene)
    !! What free levels of water and suction need.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    logical :: falls, is_literal, is_unsaturated
    integer :: k

    falls = scene%gravity(ndim) < 0.0_wp .and. &
            all(.not. abs(scene%gravity(:ndim - 1)) > 0.0_wp)
    is_literal = scene%water%operator == 'two_pass'
    do k = 1, size(scene%hydraulic_condition)
      if (.not. scene%hydraulic_condition(k)%may_switch()) cycle
      if (.not. falls) call checker%complain('hydraulic_condition', k, 'kind', &
                                             'needs gravity along -z in &scene')
      if (is_literal) call checker%complain('hydraulic_condition', k, 'kind', &
                                            'needs operator = ''compact'' in &water')
    end do
    do k = 1, size(scene%mechanical_condition)
      if (scene%mechanical_condition(k)%kind == 'reservoir' .and. .not. falls) then
        call checker%complain('mechanical_condition', k, 'kind', &
                              'needs gravity along -z in &scene')
      end if
    end do
    is_unsaturated = any(scene%material%retention /= 'none') .and. scene%water_mode /= 'none'
    if (.not. is_unsaturated) return
    if (is_literal) call checker%complain('water', 1, 'operator', &
                                          'retention needs operator = ''compact''')
  end subroutine check_suction

  subroutine check_starts(checker, scene)
    !! One equilibrium before the clock starts.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene

    if (scene%time%geostatic_start .and. scene%time%undrained_start) then
      call checker%complain('time', 1, 'undrained_start', 'does not go with geostatic_start')
    end if
  end subroutine check_starts

  subroutine check_transfer(checker, scene)
    !! A key of a transfer that 'auto' did not choose.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene

    if (scene%mechanics%transfer == 'aflip') return
    if (.not. scene%mechanics%filter_time > 0.0_wp) return
    call checker%complain('mechanics', 1, 'filter_time', 'has a meaning only with transfer = '// &
                          '''aflip'', which deformation = ''updated'' takes by default')
  end subroutine check_transfer

  subroutine check_soils(checker, scene)
    !! Constants of soils that fit each other.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: key, message
    integer :: k

    do k = 1, size(scene%material)
      if (scene%material(k)%rigid .or. .not. allocated(scene%material(k)%soil)) cycle
      call scene%material(k)%soil%check(key, message)
      if (len(message) > 0) call checker%complain('material', k, key, message)
    end do
    call check_variation(checker, scene)
  end subroutine check_soils

  subroutine check_variation(checker, scene)
    !! What properties that vary with place do not go with.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    logical :: is_geostatic
    integer :: k

    is_geostatic = any(scene%initial_state%effective_stress == 'geostatic')
    do k = 1, size(scene%material)
      associate (material => scene%material(k))
        if (material%conductivity_law == 'kozeny_carman') then
          if (material%porosity%varies() .or. material%hydraulic_conductivity%varies()) then
            call checker%complain('material', k, 'conductivity_law', 'kozeny_carman needs one '// &
                                  'initial porosity and hydraulic_conductivity, not formulas')
          end if
        end if
        if (is_geostatic .and. material%solid_density%varies()) call complain('solid_density')
        if (is_geostatic .and. material%porosity%varies()) call complain('porosity')
      end associate
    end do

  contains

    subroutine complain(key)
      !! Geostatic stresses are formulas of one density.
      character(len=*), intent(in) :: key

      call checker%complain('material', k, key, 'must be a number where effective_stress = '// &
                            '''geostatic'': with a formula, take geostatic_start in &time')
    end subroutine complain
  end subroutine check_variation

  subroutine check_sources(checker, scene)
    !! Formulas that can be read.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: d

    do d = 1, ndim
      call check_pattern(checker, scene, 'source', 1, 'force_'//axis_name(axis(d)), &
                         scene%source%force(axis(d)))
    end do
    if (.not. scene%source%water%varies()) return
    if (scene%water_mode == 'none') then
      call checker%complain('source', 1, 'water', &
                            'has a meaning only with water = ''coupled'' in &scene')
    end if
    call check_pattern(checker, scene, 'source', 1, 'water', scene%source%water)
  end subroutine check_sources

  ! ---------------------------------------------------------------- output and verification

  subroutine check_output(checker, scene)
    !! Names that can be part of a file name.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: k

    if (len(scene%output%name) == 0) then
      call checker%complain('output', 1, 'name', 'must not be empty')
    else if (index(scene%output%name, '/') > 0) then
      call checker%complain('output', 1, 'name', 'must not contain / (use directory)')
    end if
    do k = 1, size(scene%probe)
      if (index(scene%probe(k)%name, '/') > 0) then
        call checker%complain('probe', k, 'name', 'must not contain /')
      else if (scene%probe(k)%name == '.') then
        call checker%complain('probe', k, 'name', 'must not be . alone')
      end if
      if (scene%probe(k)%kind == 'run_out' .and. ndim == 1 .and. &
          .not. norm2(scene%probe(k)%direction) > 0.0_wp) then
        call checker%complain('probe', k, 'direction', 'is required: 1-D has no horizontal one')
      end if
    end do
  end subroutine check_output

  subroutine check_verification(checker, scene)
    !! What the exact solutions need.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    logical :: needs_load

    associate (verification => scene%verification)
      if (verification%case == '') return
      if (checker%has('verification', 1, 'direction') .and. &
          .not. abs(norm2(verification%direction) - 1.0_wp) <= unit_tolerance) then
        call checker%complain('verification', 1, 'direction', 'must have the length 1 [-]')
      end if
      needs_load = verification%case == 'terzaghi' .or. verification%case == 'mandel'
      if (needs_load .and. .not. abs(verification%load) > 0.0_wp) then
        call checker%complain('verification', 1, 'load', "must not be 0 with case = '"// &
                              trim(verification%case)//"'")
      end if
      if (scene%water_mode == 'none' .and. verification%case /= 'bar') then
        call checker%complain('verification', 1, 'case', 'needs water = ''coupled'' in &scene')
      end if
    end associate
  end subroutine check_verification
end module dosui_scene_checks

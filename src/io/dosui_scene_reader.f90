!! From namelist text to a scene. Everything that is wrong is collected, so that the user hears it
!! all at once.
module dosui_scene_reader
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, axis
  use dosui_combination_checks, only: check_combinations
  use dosui_communicator, only: communicator_t
  use dosui_directories, only: absolute_path, directory_problem
  use dosui_error, only: error_t
  use dosui_integrator_choice, only: resolve_integrator
  use dosui_key_visitor, only: choice_of, in_range, key_t, key_visitor_t, n_choice, name_length, &
                               present_choice
  use dosui_local_origin, only: choose_local_origin, distance_from, move_to_origin, scene_bounds
  use dosui_namelist, only: namelist_t, namelist_group_t, read_bytes, read_text_file, &
                            decimal_comma
  use dosui_numbers, only: text_as_real
  use dosui_point_file, only: parse_points
  use dosui_problems, only: problems_t
  use dosui_property_estimates, only: estimate_properties
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: axis_name, base_motion_t, region_t, scene_t
  use dosui_scene_checks, only: check_body_faces, check_scene
  use dosui_scene_dimension, only: scene_dimension
  use dosui_scene_echo, only: write_echo
  use dosui_scene_warnings, only: find_warnings
  use dosui_scene_limits, only: check_coordinates, check_reach, check_sizes
  use dosui_scene_keys, only: group_t, scene_groups, allocate_group, visit_group, collect_keys
  use dosui_shapes, only: shape_contains, shape_measure, spatial, turned
  use dosui_stl_file, only: parse_stl
  use dosui_table, only: named_table_t, table_t
  use dosui_text, only: lower_case, nearest_name, to_text
  implicit none
  private

  public :: read_scene, parse_scene

  character(len=*), parameter :: renaming = ' (dosui-post rename FILE rewrites a scene)'
  real(wp), parameter :: volume_tolerance = 0.01_wp   !! of what particles fill [-]

  type, extends(key_visitor_t) :: reader_t
    !! Takes the values of one group instance from the namelist.
    character(len=:), allocatable :: file
    type(namelist_group_t), pointer :: group => null()
    logical, allocatable :: is_known(:)                     !! of the keys of the group
    character(len=name_length), allocatable :: key_names(:) !! of keys that could be given ...
    integer :: n_key_name = 0                               !! ... the first so many
    type(key_t), allocatable :: all_keys(:)                 !! of all groups, once they are needed
    type(named_table_t), allocatable :: table(:)            !! functions of formulas
    type(problems_t) :: problems
  contains
    procedure :: real => read_real
    procedure :: property => read_property
    procedure :: integer => read_integer
    procedure :: long => read_long
    procedure :: logical => read_logical
    procedure :: choice => read_choice
    procedure :: name => read_name
    procedure :: text => read_text
    procedure :: vector => read_vector
    procedure :: list => read_list
    procedure :: points => read_points
    procedure :: open_key
    procedure :: complain
    procedure :: has_count
    procedure :: one_real
    procedure :: one_text
  end type reader_t

  type :: facets_t
    !! The triangles of a file before they are a body.
    real(wp), allocatable :: corners(:, :, :)      !! (3, 3, n) [m]
    integer, allocatable :: solid(:), line(:)      !! (n)
    character(len=:), allocatable :: message       !! what is wrong with it, '' if nothing
  end type facets_t

contains

  ! ---------------------------------------------------------------- the whole scene

  subroutine read_scene(comm, path, scene, problems, err, directory, only_check)
    !! Reads a scene: root reads the text, all ranks parse it, so all find the same problems.
    !! Collective. The error is set when there are problems.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(scene_t), intent(out) :: scene
    type(problems_t), intent(inout) :: problems
    type(error_t), intent(inout) :: err
    character(len=*), intent(in), optional :: directory   !! replaces that of the scene
    logical, intent(in), optional :: only_check   !! no result will want the scene's echo
    character(len=:), allocatable :: text, reason, stem
    type(error_t) :: read_error
    type(namelist_t), target :: namelist

    if (comm%is_root()) call read_text_file(path, text, read_error)
    call comm%agree(read_error)
    if (read_error%failed()) then
      call problems%add(path, 0, '', '', '', read_error%message)
      call err%set(read_error%message)
      return
    end if
    call comm%broadcast(text)
    stem = ''
    if (comm%is_root()) stem = default_name(absolute_path(path))
    call comm%broadcast(stem)
    call parse_groups(text, path, scene, problems, namelist, stem, directory, only_check, comm)
    scene%base_motion%is_given = any(abs(scene%base_motion%acceleration) > 0.0_wp)
    if (allocated(scene%base_motion%file)) call read_motion(comm, path, scene%base_motion, problems)
    if (problems%count() == 0) call check_coordinates(scene, namelist, problems)
    call read_bodies(comm, path, scene, namelist, problems)
    call read_particles(comm, path, scene, problems)
    reason = ''
    if (comm%is_root() .and. allocated(scene%output%directory)) then
      reason = directory_problem(scene%output%directory)
    end if
    call comm%broadcast(reason)
    if (len(reason) > 0) call problems%add(path, 0, 'output', 'directory', &
                                           "'"//scene%output%directory//"'", reason)
    if (problems%count() == 0) call estimate_properties(scene, namelist, problems)
    if (problems%count() == 0) call resolve_integrator(scene)
    if (problems%count() == 0) call check_sizes(comm, scene, namelist, problems)
    if (problems%count() == 0) call check_reach(scene, namelist, problems)
    if (problems%count() > 0) call err%set(path//': '//to_text(problems%count())//' problem(s)')
    if (.not. err%failed()) call find_warnings(scene, namelist)
  end subroutine read_scene

  subroutine read_table(comm, path, table, table_file, names, message)
    !! The entries of a table from its file. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path         !! of the scene
    class(table_t), intent(inout) :: table
    character(len=*), intent(in) :: table_file
    character(len=*), intent(in) :: names(2)     !! of its columns, for messages
    character(len=:), allocatable, intent(out) :: message   !! '' if all is well
    character(len=:), allocatable :: text
    type(error_t) :: read_error

    message = ''
    if (comm%is_root()) call read_text_file(beside(path, table_file), text, read_error)
    call comm%agree(read_error)
    if (read_error%failed()) then
      message = read_error%message
      return
    end if
    call comm%broadcast(text)
    call table%parse(text, names, message)
  end subroutine read_table

  subroutine read_motion(comm, path, motion, problems)
    !! The table of the base's motion from its file. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path      !! of the scene
    type(base_motion_t), intent(inout) :: motion
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable :: message

    call read_table(comm, path, motion%pattern%factor, motion%file, ['time  ', 'factor'], message)
    if (len(message) > 0) call problems%add(path, 0, 'base_motion', 'file', &
                                            "'"//motion%file//"'", message)
  end subroutine read_motion

  subroutine read_tables(comm, path, tables, namelist, problems)
    !! Named tables from their files. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path      !! of the scene
    type(named_table_t), intent(inout) :: tables(:)
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable :: message
    integer :: k, g

    do k = 1, size(tables)
      if (.not. allocated(tables(k)%file)) cycle
      call read_table(comm, path, tables(k), tables(k)%file, ['argument', 'value   '], message)
      if (len(message) == 0) cycle
      g = namelist%find('table', k)
      associate (given => namelist%group(g)%key(namelist%group(g)%find('file')))
        call problems%add(path, given%line, 'table', 'file', given%shown(), message)
      end associate
    end do
  end subroutine read_tables

  subroutine read_bodies(comm, path, scene, namelist, problems)
    !! Triangulated surfaces of regions from their files, in the scene's place. Then the place of
    !! all bodies is known, and the scene moves to its local origin. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path      !! of the scene
    type(scene_t), intent(inout) :: scene
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    type(facets_t) :: facets(size(scene%region))
    character(len=:), allocatable :: message
    integer :: r, g, k

    if (ndim < 3 .or. .not. any(scene%region%shape == 'stl')) then
      if (problems%count() == 0) call settle_origin(scene, facets)
      return
    end if
    do r = 1, size(scene%region)
      if (scene%region(r)%shape /= 'stl' .or. .not. allocated(scene%region(r)%stl_file)) cycle
      call read_facets(comm, path, scene%region(r), facets(r))
    end do
    if (problems%count() == 0) call settle_origin(scene, facets)
    do r = 1, size(scene%region)
      if (.not. allocated(facets(r)%message)) cycle
      message = facets(r)%message
      if (len(message) == 0) call make_body(facets(r), scene%local_origin, scene%region(r), message)
      if (len(message) == 0) cycle
      if (allocated(scene%region(r)%body)) deallocate (scene%region(r)%body)
      g = namelist%find('region', r)
      k = namelist%group(g)%find('stl_file')
      call problems%add(path, namelist%group(g)%key(k)%line, 'region', 'stl_file', &
                        namelist%group(g)%key(k)%shown(), message)
    end do
    call check_body_faces(scene, namelist, problems)
  end subroutine read_bodies

  subroutine read_facets(comm, path, region, facets)
    !! The triangles of a region's file, scaled and turned. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path      !! of the scene
    type(region_t), intent(inout) :: region
    type(facets_t), intent(out) :: facets
    character(len=:), allocatable :: text
    type(error_t) :: read_error
    integer :: t, k

    if (comm%is_root()) call read_bytes(beside(path, region%stl_file), text, read_error)
    call comm%agree(read_error)
    if (read_error%failed()) then
      facets%message = read_error%message
      return
    end if
    call comm%broadcast(text)
    call parse_stl(text, facets%corners, facets%solid, facets%line, region%solid, facets%message)
    do k = 1, size(region%solid)
      if (len(facets%message) > 0) exit
      if (region%solid(k) == 'all' .or. region%solid(k) == 'free' .or. &
          index(region%solid(k), 'face') == 1) then
        facets%message = "its solid '"//trim(region%solid(k))// &
                         "' has the name of a face: rename it"
      end if
    end do
    if (len(facets%message) > 0) return
    facets%corners = facets%corners*region%stl_scale
    if (.not. abs(region%shape_angle) > 0.0_wp) return
    do t = 1, size(facets%line)
      do k = 1, 3
        facets%corners(axis, k, t) = region%pivot + turned(facets%corners(axis, k, t) - &
                                                           region%pivot, region%shape_angle)
      end do
    end do
  end subroutine read_facets

  subroutine settle_origin(scene, facets)
    !! Chooses the local origin for the bodies that a scene holds and files bring, and moves there.
    type(scene_t), intent(inout) :: scene
    type(facets_t), intent(in) :: facets(:)   !! of the regions
    real(wp) :: low(ndim), high(ndim)
    integer :: r, d

    call scene_bounds(scene, low, high)
    do r = 1, size(facets)
      if (.not. allocated(facets(r)%corners)) cycle
      do d = 1, ndim
        low(d) = min(low(d), minval(facets(r)%corners(axis(d), :, :)))
        high(d) = max(high(d), maxval(facets(r)%corners(axis(d), :, :)))
      end do
    end do
    call choose_local_origin(scene, low, high)
    call move_to_origin(scene)
  end subroutine settle_origin

  subroutine make_body(facets, origin, region, message)
    !! A region's body from its triangles, divided into faces.
    type(facets_t), intent(inout) :: facets
    real(wp), intent(in) :: origin(ndim)       !! of the scene [m]
    type(region_t), intent(inout) :: region
    character(len=:), allocatable, intent(out) :: message   !! '' if all is well
    integer :: d

    do d = 1, ndim
      facets%corners(axis(d), :, :) = distance_from(origin(d), facets%corners(axis(d), :, :))
    end do
    allocate (region%body)
    call region%body%init(facets%corners, facets%solid, facets%line, message, spatial(origin))
    if (len(message) == 0) call region%body%split(region%stl_face_angle)
  end subroutine make_body

  pure function beside(path, file) result(found)
    !! A path that is meant from the folder of another file.
    character(len=*), intent(in) :: path, file
    character(len=:), allocatable :: found

    found = file
    if (index(file, '/') /= 1) found = path(:index(path, '/', back=.true.))//file
  end function beside

  subroutine read_particles(comm, path, scene, problems)
    !! The particles of regions that take them from files. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path      !! of the scene, for messages
    type(scene_t), intent(inout) :: scene
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable :: text, message
    integer, allocatable :: line(:)
    type(error_t) :: read_error
    integer :: r, p

    do r = 1, size(scene%region)
      associate (region => scene%region(r))
        if (.not. allocated(region%particle_file)) cycle
        if (comm%is_root()) call read_text_file(beside(path, region%particle_file), text, &
                                                read_error)
        call comm%agree(read_error)
        if (read_error%failed()) then
          message = read_error%message
          read_error = error_t()
        else
          call comm%broadcast(text)
          call parse_points(text, region%particle, region%particle_volume, line, message)
          if (len(message) == 0 .and. problems%count() == 0) then
            do p = 1, size(line)
              region%particle(:, p) = distance_from(scene%local_origin, region%particle(:, p))
            end do
            call check_particles(region, line, message)
          end if
        end if
        if (len(message) > 0) call problems%add(path, 0, 'region', 'particle_file', &
                                                "'"//region%particle_file//"'", message)
      end associate
    end do
  end subroutine read_particles

  subroutine check_particles(region, line, message)
    !! Do the particles of a file lie in their region, and do their volumes fill it?
    type(region_t), intent(in) :: region
    integer, intent(in) :: line(:)      !! of the file
    character(len=:), allocatable, intent(inout) :: message
    integer :: p
    real(wp) :: filled

    do p = 1, size(line)
      if (shape_contains(region, region%particle(:, p), 0.0_wp)) cycle
      message = 'line '//to_text(line(p))//": lies outside the region '"//trim(region%name)//"'"
      return
    end do
    if (.not. allocated(region%particle_volume)) return
    filled = sum(region%particle_volume)/shape_measure(region)
    if (.not. abs(filled - 1.0_wp) <= volume_tolerance) then
      message = 'its volumes make up '//to_text(filled)//' of the region''s'
    end if
  end subroutine check_particles

  subroutine parse_scene(text, file, scene, problems, stem, directory)
    !! A scene from its text; all lists of the scene but that of rigid walls are allocated in any
    !! case.
    character(len=*), intent(in) :: text
    character(len=*), intent(in) :: file        !! for messages
    type(scene_t), intent(out) :: scene
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in), optional :: stem        !! default name of the files
    character(len=*), intent(in), optional :: directory   !! replaces that of the scene
    type(namelist_t), target :: namelist

    call parse_groups(text, file, scene, problems, namelist, stem, directory)
  end subroutine parse_scene

  subroutine parse_groups(text, file, scene, problems, namelist, stem, directory, only_check, comm)
    !! As `parse_scene`; keeps what was scanned, with its lines. With a communicator collective, and
    !! tables have the entries of their files.
    character(len=*), intent(in) :: text, file
    type(scene_t), intent(out) :: scene
    type(problems_t), intent(inout) :: problems
    type(namelist_t), intent(inout), target :: namelist
    character(len=*), intent(in), optional :: stem, directory
    logical, intent(in), optional :: only_check   !! no echo
    type(communicator_t), intent(in), optional :: comm
    type(group_t), allocatable :: groups(:)
    integer :: g

    scene%file = file
    scene%text = text
    groups = scene_groups()
    call namelist%scan(text, file, problems)
    call check_groups(namelist, groups, problems)
    do g = 1, size(groups)
      call allocate_group(scene, groups(g)%name, 0)
    end do
    if (is_of_another_dimension(namelist, problems)) return
    do g = 1, size(groups)
      call allocate_group(scene, groups(g)%name, namelist%count(groups(g)%name))
      call read_groups(namelist, groups(g)%name, scene, problems)
      if (groups(g)%name == 'table' .and. present(comm)) then   ! before the formulas that call them
        call read_tables(comm, file, scene%table, namelist, problems)
      end if
    end do
    if (.not. allocated(scene%time%output_times)) allocate (scene%time%output_times(0))
    if (.not. allocated(scene%title)) scene%title = ''
    if (.not. allocated(scene%output%name)) then
      scene%output%name = default_name(file)
      if (present(stem)) scene%output%name = stem
    end if
    if (.not. allocated(scene%output%directory)) scene%output%directory = '.'
    if (present(directory)) scene%output%directory = directory
    scene%shape_function = scene%shape_function_in_force()
    scene%mechanics%transfer = scene%transfer_in_force()
    call check_scene(scene, namelist, problems)
    call check_combinations(scene, namelist, problems)
    if (problems%count() == 0) call scene%prepare_functions()
    if (present(only_check)) then
      if (only_check) return
    end if
    call write_echo(scene, scene%echo)
  end subroutine parse_groups

  subroutine check_groups(namelist, groups, problems)
    !! Unknown, repeated and missing groups.
    type(namelist_t), intent(in) :: namelist
    type(group_t), intent(in) :: groups(:)
    type(problems_t), intent(inout) :: problems
    character(len=name_length) :: names(size(groups))
    character(len=:), allocatable :: nearest
    integer :: g, k

    nearest = ''
    do g = 1, size(groups)
      names(g) = groups(g)%name
    end do
    do k = 1, namelist%n_group
      associate (group => namelist%group(k))
        g = findloc(names == group%name, .true., dim=1)
        if (g == 0) then
          nearest = nearest_name(group%name, names)
          if (len(nearest) > 0) nearest = '&'//nearest
          call problems%add(namelist%file, group%line, group%name, '', '', 'unknown group', nearest)
        else if (.not. groups(g)%is_repeatable .and. namelist%find(group%name, 1) /= k) then
          call problems%add(namelist%file, group%line, group%name, '', '', &
                            'group is given twice (first in line '// &
                            to_text(namelist%group(namelist%find(group%name, 1))%line)//')')
        end if
      end associate
    end do
    do g = 1, size(groups)
      if (groups(g)%is_required .and. namelist%count(groups(g)%name) == 0) then
        call problems%add(namelist%file, 0, groups(g)%name, '', '', 'group is missing')
      end if
    end do
  end subroutine check_groups

  logical function is_of_another_dimension(namelist, problems) result(is_other)
    !! Is the scene for one of the other executables?
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    integer :: g, k, dimension

    dimension = scene_dimension(namelist, ndim)
    is_other = dimension /= ndim
    if (.not. is_other) return
    g = namelist%find('scene', 1)
    k = namelist%group(g)%find('dimension')
    associate (key => namelist%group(g)%key(k))
      call problems%add(namelist%file, key%line, 'scene', 'dimension', key%shown(), &
                        'this is dosui'//to_text(ndim)//'d; run dosui'//to_text(dimension)// &
                        'd, or dosui, which chooses')
    end associate
  end function is_of_another_dimension

  subroutine read_groups(namelist, name, scene, problems)
    !! All instances of a group; only the first of one that cannot be repeated.
    type(namelist_t), intent(in), target :: namelist
    character(len=*), intent(in) :: name
    type(scene_t), intent(inout) :: scene
    type(problems_t), intent(inout) :: problems
    type(reader_t) :: reader
    integer :: instance, slot, n

    reader%file = namelist%file
    reader%problems = problems
    reader%table = scene%table
    allocate (reader%key_names(16))
    n = namelist%count(name)
    if (.not. is_repeatable(name)) n = min(n, 1)
    do instance = 1, n
      slot = namelist%find(name, instance)
      reader%group => namelist%group(slot)
      reader%is_known = spread(.false., 1, reader%group%n_key)
      reader%n_key_name = 0
      call visit_group(reader, scene, name, instance)
      call check_unknown_keys(reader)
    end do
    problems = reader%problems
  end subroutine read_groups

  pure logical function is_repeatable(name)
    !! May a group of this name be given several times?
    character(len=*), intent(in) :: name
    type(group_t), allocatable :: groups(:)
    integer :: g

    is_repeatable = .false.
    groups = scene_groups()
    do g = 1, size(groups)
      if (groups(g)%name == name) is_repeatable = groups(g)%is_repeatable
    end do
  end function is_repeatable

  subroutine check_unknown_keys(reader)
    !! Keys that no visit asked for.
    type(reader_t), intent(inout) :: reader
    integer :: k, j

    do k = 1, reader%group%n_key
      if (reader%is_known(k)) cycle
      if (.not. allocated(reader%all_keys)) call collect_keys(reader%all_keys)
      associate (name => reader%group%key(k)%name, keys => reader%all_keys)
        do j = 1, size(keys)
          if (keys(j)%name == name) exit
          if (keys(j)%former == name .and. keys(j)%group == reader%group%name) exit
        end do
        if (j > size(keys)) then
          call reader%complain(k, '', 'unknown key', &
                               nearest_name(name, reader%key_names(:reader%n_key_name)))
        else if (keys(j)%former == name) then
          call reader%complain(k, '', 'is called '//keys(j)%name//' now'//renaming)
        else
          call reader%complain(k, '', 'unknown key here; it belongs to &'//keys(j)%group)
        end if
      end associate
    end do
  end subroutine check_unknown_keys

  pure function default_name(path) result(name)
    !! Stem of the files: a scene in its own folder, scene.nml, is named after the folder, and
    !! scene_2d.nml after folder_2d; every other file after itself.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: name
    character(len=:), allocatable :: folder
    integer :: slash

    slash = index(path, '/', back=.true.)
    name = path(slash + 1:)
    if (index(name, '.', back=.true.) > 1) name = name(:index(name, '.', back=.true.) - 1)
    folder = ''
    if (slash > 1) folder = path(index(path(:slash - 1), '/', back=.true.) + 1:slash - 1)
    if (verify(folder, '.') == 0) return
    if (name == 'scene') name = folder
    if (index(name, 'scene_') == 1) name = folder//name(6:)
  end function default_name

  ! ---------------------------------------------------------------- one key

  subroutine open_key(self, key, slot)
    !! Place of a key in the group, 0 if there is nothing to read from it.
    class(reader_t), intent(inout) :: self
    type(key_t), intent(in) :: key
    integer, intent(out) :: slot
    character(len=name_length), allocatable :: more(:)

    if (self%n_key_name == size(self%key_names)) then
      allocate (more(2*self%n_key_name))
      more(:self%n_key_name) = self%key_names
      call move_alloc(more, self%key_names)
    end if
    self%n_key_name = self%n_key_name + 1
    self%key_names(self%n_key_name) = key%name
    slot = self%group%find(key%name)
    if (slot == 0) then
      if (key%is_required .and. key%applies .and. .not. key%is_undecided) then
        call self%problems%add(self%file, self%group%line, self%group%name, key%name, '', &
                               'key is missing'//unit_text(key))
      end if
      return
    end if
    self%is_known(slot) = .true.
    if (key%is_undecided) then
      slot = 0
    else if (.not. key%applies) then
      call self%complain(slot, self%group%key(slot)%shown(), &
                         'has a meaning only with '//trim(key%only))
      slot = 0
    else if (self%group%key(slot)%n_value == 0) then
      slot = 0   ! the scan has complained already
    end if
  end subroutine open_key

  subroutine complain(self, slot, value, reason, nearest, line)
    !! Adds a problem of a key.
    class(reader_t), intent(inout) :: self
    integer, intent(in) :: slot
    character(len=*), intent(in) :: value, reason
    character(len=*), intent(in), optional :: nearest
    integer, intent(in), optional :: line   !! default: that of the key

    associate (key => self%group%key(slot))
      if (present(line)) then
        call self%problems%add(self%file, line, self%group%name, key%name, value, reason, nearest)
      else
        call self%problems%add(self%file, key%line, self%group%name, key%name, value, reason, &
                               nearest)
      end if
    end associate
  end subroutine complain

  pure function unit_text(key) result(text)
    !! The unit in brackets after a blank, '' if there is none.
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text

    text = ''
    if (len_trim(key%unit) > 0) text = ' ['//trim(key%unit)//']'
  end function unit_text

  logical function has_count(self, slot, n)
    !! Has the key so many values (n) or, given by elements, at most so many? Complains if not.
    class(reader_t), intent(inout) :: self
    integer, intent(in) :: slot, n
    character(len=:), allocatable :: number

    associate (key => self%group%key(slot))
      has_count = key%n_value == n
      if (key%is_indexed) has_count = key%n_value <= n
      if (has_count) return
      number = decimal_comma(key, .false.)
      if (len(number) > 0 .and. key%n_value > n) then
        call self%complain(slot, key%shown(), 'decimal comma? write '//number)
      else if (n == 1) then
        call self%complain(slot, key%shown(), 'needs one value, has '//to_text(key%n_value))
      else
        call self%complain(slot, key%shown(), 'needs '//to_text(n)//' values, has '// &
                           to_text(key%n_value))
      end if
    end associate
  end function has_count

  subroutine one_real(self, slot, element, x, key)
    !! One real of a key, if it is given and allowed.
    class(reader_t), intent(inout) :: self
    integer, intent(in) :: slot, element
    real(wp), intent(inout) :: x
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: reason
    real(wp) :: candidate

    associate (value => self%group%key(slot)%value(element))
      if (.not. value%is_given) return
      candidate = 0.0_wp
      call value%to_real(candidate, reason)
      if (len(reason) == 0 .and. .not. in_range(candidate, key%range)) then
        reason = 'must be '//trim(key%range)
      end if
      if (len(reason) == 0) then
        x = candidate
      else
        call self%complain(slot, value%shown(), reason//unit_text(key), line=value%line)
      end if
    end associate
  end subroutine one_real

  subroutine one_text(self, slot, key, text, is_good)
    !! The one text of a key.
    class(reader_t), intent(inout) :: self
    integer, intent(in) :: slot
    type(key_t), intent(in) :: key
    character(len=:), allocatable, intent(out) :: text
    logical, intent(out) :: is_good
    character(len=:), allocatable :: reason

    text = ''
    is_good = self%has_count(slot, 1)
    if (.not. is_good) return
    associate (value => self%group%key(slot)%value(1))
      call value%to_name(text, reason)
      text = trim(adjustl(text))
      if (len(reason) == 0 .and. len(text) > key%longest) then
        reason = 'is longer than '//to_text(key%longest)//' characters'
      end if
      if (len(reason) == 0 .and. len(text) == 0 .and. key%is_required) reason = 'must not be empty'
      is_good = len(reason) == 0
      if (.not. is_good) call self%complain(slot, value%shown(), reason)
    end associate
  end subroutine one_text

  ! ---------------------------------------------------------------- the visits

  subroutine read_real(self, value, key)
    class(reader_t), intent(inout) :: self
    real(wp), intent(inout) :: value
    type(key_t), intent(in) :: key
    integer :: slot

    call self%open_key(key, slot)
    if (slot == 0) return
    if (self%has_count(slot, 1)) call self%one_real(slot, 1, value, key)
  end subroutine read_real

  subroutine read_property(self, value, key)
    class(reader_t), intent(inout) :: self
    type(scalar_function_t), intent(inout) :: value
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: message, reason
    real(wp) :: constant
    integer :: slot

    call self%open_key(key, slot)
    if (slot == 0) return
    if (.not. self%has_count(slot, 1)) return
    associate (given => self%group%key(slot)%value(1))
      call text_as_real(given%text, constant, reason)
      if (given%is_quoted .and. len(reason) > 0) then
        call value%parse(given%text, axis_name(axis), message, self%table)
        if (.not. (allocated(message) .or. value%varies() .or. &
                   in_range(value%constant, key%range))) message = 'must be '//trim(key%range)
        if (allocated(message)) call self%complain(slot, given%shown(), message//unit_text(key))
      else
        constant = value%constant
        call self%one_real(slot, 1, constant, key)
        call value%set(constant)
      end if
    end associate
  end subroutine read_property

  subroutine read_integer(self, value, key)
    class(reader_t), intent(inout) :: self
    integer, intent(inout) :: value
    type(key_t), intent(in) :: key
    integer(i8) :: candidate

    candidate = int(value, i8)
    call read_whole(self, int(huge(value), i8), candidate, key)
    value = int(candidate)
  end subroutine read_integer

  subroutine read_long(self, value, key)
    class(reader_t), intent(inout) :: self
    integer(i8), intent(inout) :: value
    type(key_t), intent(in) :: key

    call read_whole(self, huge(value), value, key)
  end subroutine read_long

  subroutine read_whole(self, largest, value, key)
    !! An integer whose size is at most the largest.
    class(reader_t), intent(inout) :: self
    integer(i8), intent(in) :: largest
    integer(i8), intent(inout) :: value
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: reason
    integer(i8) :: candidate
    integer :: slot

    call self%open_key(key, slot)
    if (slot == 0) return
    if (.not. self%has_count(slot, 1)) return
    associate (given => self%group%key(slot)%value(1))
      candidate = 0_i8
      call given%to_long(candidate, reason)
      if (len(reason) == 0 .and. abs(candidate) > largest) reason = 'is too large'
      if (len(reason) == 0 .and. .not. in_range(real(candidate, wp), key%range)) then
        reason = 'must be '//trim(key%range)
      end if
      if (len(reason) == 0) then
        value = candidate
      else
        call self%complain(slot, given%shown(), reason)
      end if
    end associate
  end subroutine read_whole

  subroutine read_logical(self, value, key)
    class(reader_t), intent(inout) :: self
    logical, intent(inout) :: value
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: reason
    integer :: slot

    call self%open_key(key, slot)
    if (slot == 0) return
    if (.not. self%has_count(slot, 1)) return
    associate (given => self%group%key(slot)%value(1))
      call given%to_logical(value, reason)
      if (len(reason) > 0) call self%complain(slot, given%shown(), reason)
    end associate
  end subroutine read_logical

  subroutine read_name(self, value, key)
    class(reader_t), intent(inout) :: self
    character(len=name_length), intent(inout) :: value
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text
    integer :: slot
    logical :: is_good

    call self%open_key(key, slot)
    if (slot == 0) return
    if (len_trim(key%choices) > 0) then
      call self%choice(slot, key, value)
    else
      call self%one_text(slot, key, text, is_good)
      if (is_good) value = text
    end if
  end subroutine read_name

  subroutine read_choice(self, slot, key, value)
    !! A text that must be one of the choices; '' if it is none of them, so that keys that depend
    !! on the choice are undecided.
    class(reader_t), intent(inout) :: self
    integer, intent(in) :: slot
    type(key_t), intent(in) :: key
    character(len=name_length), intent(inout) :: value
    character(len=name_length) :: names(n_choice(key%choices))
    character(len=:), allocatable :: text, list, renamed
    integer :: k
    logical :: is_good

    call self%one_text(slot, key, text, is_good)
    value = ''
    if (.not. is_good) return
    do k = 1, size(names)
      names(k) = choice_of(key%choices, k)
    end do
    if (any(names == lower_case(text))) then
      value = lower_case(text)
      return
    end if
    renamed = present_choice(key%former_choices, lower_case(text))
    if (len(renamed) > 0) then
      call self%complain(slot, self%group%key(slot)%shown(), 'is called '''//renamed// &
                         ''' now'//renaming)
      return
    end if
    list = ''
    do k = 1, size(names)
      if (k > 1 .and. k < size(names)) list = list//', '
      if (k > 1 .and. k == size(names)) list = list//' or '
      list = list//"'"//trim(names(k))//"'"
    end do
    text = nearest_name(text, names)
    if (len(text) > 0) text = "'"//text//"'"
    call self%complain(slot, self%group%key(slot)%shown(), 'must be '//list, text)
  end subroutine read_choice

  subroutine read_text(self, value, key)
    class(reader_t), intent(inout) :: self
    character(len=:), allocatable, intent(inout) :: value
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text
    integer :: slot
    logical :: is_good

    call self%open_key(key, slot)
    if (slot == 0) return
    call self%one_text(slot, key, text, is_good)
    if (is_good) value = text
  end subroutine read_text

  subroutine read_vector(self, value, key)
    class(reader_t), intent(inout) :: self
    real(wp), intent(inout) :: value(:)
    type(key_t), intent(in) :: key
    integer :: slot, k

    call self%open_key(key, slot)
    if (slot == 0) return
    if (.not. self%has_count(slot, size(value))) return
    do k = 1, self%group%key(slot)%n_value
      call self%one_real(slot, k, value(k), key)
    end do
  end subroutine read_vector

  subroutine read_list(self, value, key)
    class(reader_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: number
    integer :: slot, k, n_problem

    call self%open_key(key, slot)
    if (slot == 0) return
    n_problem = self%problems%count()
    associate (given => self%group%key(slot))
      number = decimal_comma(given, .true.)
      if (len(number) > 0) then
        call self%complain(slot, given%shown(), 'decimal comma? write '//number)
      else if (.not. all(given%value(:given%n_value)%is_given)) then
        call self%complain(slot, given%shown(), 'elements are left out')
      else
        allocate (value(given%n_value), source=0.0_wp)
        do k = 1, given%n_value
          call self%one_real(slot, k, value(k), key)
        end do
      end if
    end associate
    if (self%problems%count() > n_problem .and. allocated(value)) deallocate (value)
  end subroutine read_list

  subroutine read_points(self, value, key)
    class(reader_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:, :)
    type(key_t), intent(in) :: key
    real(wp), allocatable :: list(:)
    integer :: slot

    call read_list(self, list, key)
    if (.not. allocated(list)) return
    if (mod(size(list), ndim) /= 0) then
      slot = self%group%find(key%name)
      call self%complain(slot, self%group%key(slot)%shown(), &
                         'needs '//to_text(ndim)//' values for each point, has '// &
                         to_text(size(list)))
    else
      value = reshape(list, [ndim, size(list)/ndim])
    end if
  end subroutine read_points
end module dosui_scene_reader

!! The one table of every group and key of a scene: name, unit, allowed range or choices, meaning,
!! and the component of `scene_t` that it sets.
!!
!! The table is executable: `visit_group` shows a visitor every key of a group together with its
!! variable. Reading, echo, template and documentation are visitors, so they cannot disagree.
!! Defaults are those of the types in dosui_scene.
module dosui_scene_keys
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_key_visitor, only: key, key_t, key_visitor_t, name_length, real_text, restart_free
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: scene_t
  use dosui_text, only: to_text
  use dosui_run_keys, only: visit_scene, visit_grid, visit_time, visit_water, visit_mechanics, &
                            visit_solver, visit_output, visit_probe, visit_verification
  use dosui_soil_keys, only: visit_material
  use dosui_body_keys, only: visit_region, visit_hole, visit_initial_state, visit_surface, &
                             visit_barrier, visit_rigid_wall
  use dosui_condition_keys, only: visit_named_table, visit_mechanical_condition, &
                                  visit_hydraulic_condition, visit_source, visit_base_motion
  implicit none
  private

  public :: scene_groups, group_size, allocate_group, visit_group, collect_keys

  type, public :: group_t
    !! What is known about a group.
    character(len=:), allocatable :: name
    character(len=:), allocatable :: description
    logical :: is_required = .false.
    logical :: is_repeatable = .false.
    logical :: is_free = .false.   !! a restart may change all of its keys
  end type group_t

  type, extends(key_visitor_t) :: collector_t
    !! Lists the keys with their kinds and defaults.
    character(len=:), allocatable :: group
    logical :: is_free = .false.           !! is the group?
    type(key_t), allocatable :: key(:)
  contains
    procedure :: real => collect_real
    procedure :: property => collect_property
    procedure :: integer => collect_integer
    procedure :: long => collect_long
    procedure :: logical => collect_logical
    procedure :: name => collect_name
    procedure :: text => collect_text
    procedure :: vector => collect_vector
    procedure :: list => collect_list
    procedure :: points => collect_points
  end type collector_t

contains

  ! ---------------------------------------------------------------- groups

  pure function scene_groups() result(groups)
    !! All groups in the order in which a scene is best written.
    type(group_t), allocatable :: groups(:)
    character(len=12), parameter :: free_group(4) = [character(len=12) :: &
                                                     'probe', 'solver', 'output', 'verification']
    integer :: g

    allocate (groups(21))
    groups(1) = group_t('scene', 'What is computed, and how.', .true., .false.)
    groups(2) = group_t('grid', 'The background grid and the domain. Memory and time follow '// &
                        'the particles: a large domain costs nothing. Bodies far from the '// &
                        'origin (site coordinates) are computed about a node near them and '// &
                        'keep their digits: coordinates may be as large as 4.5e9 spacings, '// &
                        'and bodies reach 1048568 cells from the middle of all.', .true., .false.)
    groups(3) = group_t('time', 'End of the run, output times and the time step.', .true., .false.)
    groups(4) = group_t('table', 'A function of one number, given by its values at some, for '// &
                        'the formulas of all other groups: `name = ''flood''` makes '// &
                        'flood(t) a function of time there, `name = ''stiffness''` '// &
                        'stiffness(z) one of the elevation.', .false., .true.)
    groups(5) = group_t('material', 'A soil. Regions refer to it by its name. Values of the '// &
                        'kind ''real or formula'' may be formulas of x, y, z (those of the '// &
                        'dimension) in quotes, such as ''1e6 + 2e5*(10 - z)'': every particle '// &
                        'has the value of its first place, which is a field of the results, '// &
                        'too. Steps and memory are estimated from the largest value.', &
                        .true., .true.)
    groups(6) = group_t('water', 'The pore water and its operator; only with '// &
                        '`water = ''coupled''` in &scene.', .false., .false.)
    groups(7) = group_t('mechanics', 'How the skeleton''s motion is computed.', .false., .false.)
    groups(8) = group_t('region', 'A shape filled with particles of one material on a regular '// &
                        'lattice.', .true., .true.)
    groups(9) = group_t('hole', 'A polygon that is cut out of a region. 2-D only.', .false., .true.)
    groups(10) = group_t('initial_state', 'Pore pressure, effective stress and velocity at t = '// &
                         '0; the last group for a region sets its pressures and stresses, '// &
                         'what it does not name to zero. Without it everything is zero.', &
                         .false., .true.)
    groups(11) = group_t('surface', 'A named part of the boundary of a region, for conditions '// &
                         'and probes. Surfaces may overlap: the conditions of all act, loads '// &
                         'add up. Two walls, or two different hydraulic conditions, on one '// &
                         'point are an error; probes take nothing away.', .false., .true.)
    groups(12) = group_t('mechanical_condition', 'Walls and loads on a surface. Surfaces '// &
                         'without one are free of traction.', .false., .true.)
    groups(13) = group_t('hydraulic_condition', 'Head, pressure or flux on a surface. Surfaces '// &
                         'without one let no water through.', .false., .true.)
    groups(14) = group_t('barrier', 'An interior surface that water does not pass, a sheet '// &
                         'pile say: particles do not see each other through it. It has no '// &
                         'stiffness.', .false., .true.)
    groups(15) = group_t('rigid_wall', 'A rigid half-space outside all bodies: they may meet '// &
                         'it, slide on it and leave it. Explicit and semi-implicit steps, the '// &
                         'latter with walls along axes only.', .false., .true.)
    groups(16) = group_t('source', 'Body forces and water sources as formulas of x, y, z and t '// &
                         '(those of the dimension), with + - * / ^, pi, sin cos tan atan exp '// &
                         'log sqrt abs sinh cosh tanh step min max and every &table.', &
                         .false., .false.)
    groups(17) = group_t('base_motion', 'Shaking of the base: the scene is computed in a frame '// &
                         'that moves with it, so displacements and velocities are relative.', &
                         .false., .false.)
    groups(18) = group_t('probe', 'A value whose history is written to the result file.', &
                         .false., .true.)
    groups(19) = group_t('solver', 'Linear systems of the implicit integrators.', .false., .false.)
    groups(20) = group_t('output', 'Names and intervals of the files.', .false., .false.)
    groups(21) = group_t('verification', 'The exact solution that `dosui-post verify` compares '// &
                         'with.', .false., .false.)
    do g = 1, size(groups)
      groups(g)%is_free = any(free_group == groups(g)%name)
    end do
  end function scene_groups

  pure integer function group_size(scene, group) result(n)
    !! How many instances of a group a scene holds; 1 for a group that cannot be repeated.
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group

    select case (group)
    case ('table')
      n = size(scene%table)
    case ('material')
      n = size(scene%material)
    case ('region')
      n = size(scene%region)
    case ('initial_state')
      n = size(scene%initial_state)
    case ('surface')
      n = size(scene%surface)
    case ('mechanical_condition')
      n = size(scene%mechanical_condition)
    case ('hydraulic_condition')
      n = size(scene%hydraulic_condition)
    case ('hole')
      n = 0
      if (allocated(scene%hole)) n = size(scene%hole)
    case ('barrier')
      n = 0
      if (allocated(scene%barrier)) n = size(scene%barrier)
    case ('rigid_wall')
      n = 0
      if (allocated(scene%rigid_wall)) n = size(scene%rigid_wall)
    case ('probe')
      n = size(scene%probe)
    case default
      n = 1
    end select
  end function group_size

  subroutine allocate_group(scene, group, n)
    !! Makes n instances of a group with defaults; nothing for a group that cannot be repeated.
    type(scene_t), intent(inout) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: n

    select case (group)
    case ('table')
      if (allocated(scene%table)) deallocate (scene%table)
      allocate (scene%table(n))
    case ('material')
      if (allocated(scene%material)) deallocate (scene%material)
      allocate (scene%material(n))
      call scene%catalogue%init()
    case ('region')
      if (allocated(scene%region)) deallocate (scene%region)
      allocate (scene%region(n))
    case ('initial_state')
      if (allocated(scene%initial_state)) deallocate (scene%initial_state)
      allocate (scene%initial_state(n))
    case ('surface')
      if (allocated(scene%surface)) deallocate (scene%surface)
      allocate (scene%surface(n))
    case ('mechanical_condition')
      if (allocated(scene%mechanical_condition)) deallocate (scene%mechanical_condition)
      allocate (scene%mechanical_condition(n))
    case ('hydraulic_condition')
      if (allocated(scene%hydraulic_condition)) deallocate (scene%hydraulic_condition)
      allocate (scene%hydraulic_condition(n))
    case ('hole')
      if (allocated(scene%hole)) deallocate (scene%hole)
      allocate (scene%hole(n))
    case ('barrier')
      if (allocated(scene%barrier)) deallocate (scene%barrier)
      allocate (scene%barrier(n))
    case ('rigid_wall')   ! none: not allocated, so that nobody pays for walls
      if (allocated(scene%rigid_wall)) deallocate (scene%rigid_wall)
      if (n > 0) allocate (scene%rigid_wall(n))
    case ('probe')
      if (allocated(scene%probe)) deallocate (scene%probe)
      allocate (scene%probe(n))
    case default   ! a component of the scene
    end select
  end subroutine allocate_group

  subroutine visit_group(visitor, scene, group, instance)
    !! Shows a visitor all keys of one instance of a group.
    class(key_visitor_t), intent(inout) :: visitor
    type(scene_t), intent(inout) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance   !! 1 for groups that cannot be repeated

    select case (group)
    case ('scene')
      call visit_scene(visitor, scene)
    case ('grid')
      call visit_grid(visitor, scene)
    case ('time')
      call visit_time(visitor, scene%time)
    case ('table')
      call visit_named_table(visitor, scene%table(instance))
    case ('material')
      call visit_material(visitor, scene%material(instance), scene%catalogue, &
                          scene%water_mode == 'none')
    case ('water')
      call visit_water(visitor, scene%water)
    case ('mechanics')
      call visit_mechanics(visitor, scene%mechanics)
    case ('region')
      call visit_region(visitor, scene%region(instance))
    case ('initial_state')
      call visit_initial_state(visitor, scene%initial_state(instance), scene%water_mode == 'none')
    case ('surface')
      call visit_surface(visitor, scene%surface(instance))
    case ('mechanical_condition')
      call visit_mechanical_condition(visitor, scene%mechanical_condition(instance))
    case ('hydraulic_condition')
      call visit_hydraulic_condition(visitor, scene%hydraulic_condition(instance))
    case ('hole')
      call visit_hole(visitor, scene%hole(instance))
    case ('barrier')
      call visit_barrier(visitor, scene%barrier(instance))
    case ('rigid_wall')
      call visit_rigid_wall(visitor, scene%rigid_wall(instance))
    case ('source')
      call visit_source(visitor, scene%source)
    case ('base_motion')
      call visit_base_motion(visitor, scene%base_motion)
    case ('probe')
      call visit_probe(visitor, scene%probe(instance))
    case ('solver')
      call visit_solver(visitor, scene%solver)
    case ('output')
      call visit_output(visitor, scene%output)
    case ('verification')
      call visit_verification(visitor, scene%verification)
    case default   ! no such group
    end select
  end subroutine visit_group

  ! ---------------------------------------------------------------- collecting the table

  subroutine collect_keys(keys)
    !! All keys of all groups, with kinds and defaults.
    type(key_t), allocatable, intent(out) :: keys(:)
    type(group_t), allocatable :: groups(:)
    type(collector_t) :: collector
    type(scene_t) :: scene
    integer :: g

    groups = scene_groups()
    allocate (collector%key(0))
    do g = 1, size(groups)
      collector%group = groups(g)%name
      collector%is_free = groups(g)%is_free
      call allocate_group(scene, groups(g)%name, 1)
      call visit_group(collector, scene, groups(g)%name, 1)
    end do
    call move_alloc(collector%key, keys)
  end subroutine collect_keys

  subroutine append(self, key, kind, default)
    !! Adds a key to the list.
    type(collector_t), intent(inout) :: self
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: kind, default
    type(key_t), allocatable :: more(:)
    integer :: k, n

    n = size(self%key)
    allocate (more(n + 1))
    do k = 1, n
      more(k) = self%key(k)
    end do
    more(n + 1) = key
    more(n + 1)%group = self%group
    if (self%is_free) more(n + 1)%restart = restart_free
    more(n + 1)%kind = kind
    more(n + 1)%default = default
    if (len(default) == 0 .and. len_trim(key%fallback) == 0 .and. kind /= 'text') then
      more(n + 1)%fallback = 'none'
    end if
    call move_alloc(more, self%key)
  end subroutine append

  subroutine collect_real(self, value, key)
    class(collector_t), intent(inout) :: self
    real(wp), intent(inout) :: value
    type(key_t), intent(in) :: key

    call append_real(self, value, key, 'real')
  end subroutine collect_real

  subroutine collect_property(self, value, key)
    class(collector_t), intent(inout) :: self
    type(scalar_function_t), intent(inout) :: value
    type(key_t), intent(in) :: key

    call append_real(self, value%constant, key, 'real or formula')
  end subroutine collect_property

  subroutine append_real(self, value, key, kind)
    !! Adds a key with a real default; huge ones mean that there is no limit.
    type(collector_t), intent(inout) :: self
    real(wp), intent(in) :: value
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: kind

    call append(self, key, kind, real_text(value))
    if (len(real_text(value)) == 0) self%key(size(self%key))%fallback = 'unlimited'
  end subroutine append_real

  subroutine collect_integer(self, value, key)
    class(collector_t), intent(inout) :: self
    integer, intent(inout) :: value
    type(key_t), intent(in) :: key

    if (value == huge(value)) then
      call append(self, key, 'integer', '')
    else
      call append(self, key, 'integer', to_text(value))
    end if
  end subroutine collect_integer

  subroutine collect_long(self, value, key)
    class(collector_t), intent(inout) :: self
    integer(i8), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (value == huge(value)) then
      call append(self, key, 'integer', '')
    else
      call append(self, key, 'integer', to_text(value))
    end if
  end subroutine collect_long

  subroutine collect_logical(self, value, key)
    class(collector_t), intent(inout) :: self
    logical, intent(inout) :: value
    type(key_t), intent(in) :: key

    call append(self, key, 'logical', '.'//to_text(value)//'.')
  end subroutine collect_logical

  subroutine collect_name(self, value, key)
    class(collector_t), intent(inout) :: self
    character(len=name_length), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (len_trim(value) == 0) then
      call append(self, key, 'text', '')
    else
      call append(self, key, 'text', "'"//trim(value)//"'")
    end if
  end subroutine collect_name

  subroutine collect_text(self, value, key)
    class(collector_t), intent(inout) :: self
    character(len=:), allocatable, intent(inout) :: value
    type(key_t), intent(in) :: key

    if (allocated(value)) then
      call append(self, key, 'text', "'"//value//"'")
    else
      call append(self, key, 'text', '')
    end if
  end subroutine collect_text

  subroutine collect_vector(self, value, key)
    class(collector_t), intent(inout) :: self
    real(wp), intent(inout) :: value(:)
    type(key_t), intent(in) :: key

    if (size(value) == ndim) then
      call append_real(self, value(1), key, 'vector')
    else
      call append_real(self, value(1), key, to_text(size(value))//' reals')
    end if
  end subroutine collect_vector

  subroutine collect_list(self, value, key)
    class(collector_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:)
    type(key_t), intent(in) :: key

    if (.not. allocated(value)) call append(self, key, 'list', '')
  end subroutine collect_list

  subroutine collect_points(self, value, key)
    class(collector_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:, :)
    type(key_t), intent(in) :: key

    if (.not. allocated(value)) call append(self, key, 'points', '')
  end subroutine collect_points
end module dosui_scene_keys

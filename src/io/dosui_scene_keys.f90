!! The one table of every group and key of a scene: name, unit, allowed range or choices, meaning,
!! and the component of `scene_t` that it sets.
!!
!! The table is executable: `visit_group` shows a visitor every key of a group together with its
!! variable. Reading, echo, template and documentation are visitors, so they cannot disagree.
!! Defaults are those of the types in dosui_scene.
module dosui_scene_keys
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, axis
  use dosui_key_visitor, only: key, key_t, key_visitor_t, name_length, real_text, restart_content, &
                               restart_free, restart_later
  use dosui_materials, only: model_index, model_names, soil_catalogue_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: scene_t, region_t, material_t, water_t, mechanics_t, initial_state_t, &
                         surface_t, mechanical_condition_t, hydraulic_condition_t, probe_t, &
                         barrier_t, base_motion_t, hole_t, rigid_wall_t, &
                         solver_t, source_t, time_t, output_t, verification_t, &
                         axis_name, conductivity_range, density_range, porosity_range
  use dosui_table, only: named_table_t, table_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: scene_groups, group_size, allocate_group, visit_group, collect_keys

  character(len=*), parameter :: or_unlimited = 'unlimited'

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

  ! ---------------------------------------------------------------- the table

  subroutine visit_scene(v, scene)
    !! Keys of &scene.
    class(key_visitor_t), intent(inout) :: v
    type(scene_t), intent(inout) :: scene
    integer :: dimension

    dimension = ndim
    call v%text(scene%title, &
                key('title', 'one line about the scene', longest=1000, restart=restart_free))
    call v%integer(dimension, &
                   key('dimension', 'space dimensions: (z), (x, z) or (x, y, z); z is up', &
                       range='>= 1 and <= 3', required=.true.))
    call v%name(scene%water_mode, &
                key('water', 'pore water: none (dry soil), or coupled with the skeleton', &
                    choices='none coupled', former_choices='saturated coupled'))
    call v%name(scene%integrator, &
                key('integrator', 'explicit: all waves resolved; semi_implicit: waves of the '// &
                    'skeleton only; quasi_static: no inertia, steps by accuracy; auto: what '// &
                    'suits the scene', choices='explicit semi_implicit quasi_static auto'))
    call v%name(scene%deformation, &
               key('deformation', 'small_strain: the geometry stays as it is; finite: the grid '// &
                    'deforms with the body (quasi_static); updated: particles move through '// &
                    'the grid', choices='small_strain finite updated'))
    call v%name(scene%leaving_particles, &
                key('leaving_particles', 'what happens when a particle leaves the domain: stop '// &
                    'with an error, or remove and count it', choices='stop remove', &
                    restart=restart_free))
    call v%vector(scene%gravity, &
                  key('gravity', 'acceleration; z is up, so its last component is negative', &
                      unit='m/s2'))
  end subroutine visit_scene

  subroutine visit_grid(v, scene)
    !! Keys of &grid.
    class(key_visitor_t), intent(inout) :: v
    type(scene_t), intent(inout) :: scene

    call v%real(scene%grid_spacing, &
                key('spacing', 'edge length of the cells', unit='m', range='> 0', required=.true.))
    call v%vector(scene%grid_origin, key('origin', 'position of one node of the grid', unit='m'))
    call v%vector(scene%grid_period, &
                  key('period', 'the skeleton repeats after this length along each axis (0: it '// &
                      'does not): its sides move as one, for columns, layers and slopes of '// &
                      'endless extent; water needs its own conditions on these sides, or '// &
                      'does not flow through them', unit='m', range='>= 0'))
    call v%name(scene%shape_function, &
                key('shape_function', 'linear hats, GIMP (uniform; cpgimp: domains stretch '// &
                    'with the particles, with deformation = ''updated'' only) or quadratic '// &
                    'B-splines; auto: gimp with deformation = ''updated'', where particles '// &
                    'cross cells, else linear', choices='auto linear gimp cpgimp bspline'))
    call v%vector(scene%domain_min, &
                  key('domain_min', 'particles more than a hundredth of a cell below have left '// &
                      'the domain', unit='m', &
                      restart=restart_free))
    call v%vector(scene%domain_max, &
                  key('domain_max', 'particles more than a hundredth of a cell above have left '// &
                      'the domain', unit='m', &
                      restart=restart_free))
  end subroutine visit_grid

  subroutine visit_time(v, time)
    !! Keys of &time.
    class(key_visitor_t), intent(inout) :: v
    type(time_t), intent(inout) :: time

    call v%real(time%end_time, &
                key('end_time', 'end of the run', unit='s', range='> 0', required=.true., &
                    restart=restart_free))
    call v%real(time%output_interval, &
                key('output_interval', 'time between outputs; 0: only output_times and the end', &
                    unit='s', range='>= 0', restart=restart_free))
    call v%list(time%output_times, &
                key('output_times', 'times of output, besides the start and the end', unit='s', &
                    range='> 0', restart=restart_free))
    call v%real(time%courant, &
                key('courant', 'fraction of the stability limit that a step takes', unit='-', &
                    range='> 0 and <= 1', restart=restart_free))
    call v%real(time%time_step, &
                key('time_step', 'fixed step; 0: chosen from the stability limits', unit='s', &
                    range='>= 0', restart=restart_free))
    call v%real(time%largest_step, &
                key('largest_step', 'no step is longer', unit='s', range='> 0', &
                    restart=restart_free))
    call v%logical(time%geostatic_start, &
                   key('geostatic_start', 'bring the initial effective stresses into '// &
                       'equilibrium with weight, loads and the initial pore pressures before '// &
                       'the clock starts; displacements count from there'))
    call v%logical(time%undrained_start, &
                   key('undrained_start', 'settle into the undrained equilibrium under the '// &
                       'loads at t = 0 before the clock starts'))
    call v%long(time%maximum_steps, &
                key('maximum_steps', 'the run ends after so many steps', range='>= 1', &
                    fallback=or_unlimited, restart=restart_free))
    call v%real(time%relative_tolerance, &
                key('relative_tolerance', 'quasi_static: error of the pressures that a step '// &
                    'may make, relative to their size', unit='-', range='> 0 and <= 0.1', &
                    restart=restart_free))
  end subroutine visit_time

  subroutine visit_material(v, material, catalogue, is_dry)
    !! Keys of &material.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    type(soil_catalogue_t), intent(inout) :: catalogue
    logical, intent(in) :: is_dry

    call v%name(material%name, key('name', 'what regions call it', required=.true.))
    call v%name(material%model, &
                key('model', 'constitutive model', choices=all_models()))
    call v%logical(material%rigid, &
                   key('rigid', 'the skeleton does not move: pure seepage'))
    call visit_soil(v, material, catalogue)
    call v%property(material%solid_density, &
                    key('solid_density', 'density of the grains', unit='kg/m3', &
                        range=density_range))
    call v%property(material%porosity, &
                    key('porosity', 'initial volume of voids per volume', unit='-', &
                        range=porosity_range))
    call v%property(material%hydraulic_conductivity, &
                    key('hydraulic_conductivity', 'Darcy''s k; 0: undrained', unit='m/s', &
                        range=conductivity_range, only='water = ''coupled'' in &scene', &
                        applies=.not. is_dry))
    call v%name(material%conductivity_law, &
                key('conductivity_law', 'constant, or following the porosity n of bodies that '// &
                    'deform much: n^3/(1 - n)^2 over its first value', &
                    choices='constant kozeny_carman', only='water = ''coupled'' in &scene', &
                    applies=.not. is_dry))
    call visit_retention(v, material, is_dry)
  end subroutine visit_material

  pure function all_models() result(choices)
    !! Names of the constitutive models with blanks between them.
    character(len=:), allocatable :: choices
    integer :: m

    choices = trim(model_names(1))
    do m = 2, size(model_names)
      choices = choices//' '//trim(model_names(m))
    end do
  end function all_models

  subroutine visit_soil(v, material, catalogue)
    !! Keys of &material that the constitutive models bring: those of its own model, and the
    !! others', which mean nothing here.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    type(soil_catalogue_t), intent(inout) :: catalogue
    type(key_t) :: described
    integer :: m, j, chosen

    call material%choose_soil()
    chosen = model_index(material%model)
    do m = 1, size(catalogue%model)
      do j = 1, size(catalogue%key)
        if (catalogue%bringer(j) /= m) cycle
        associate (place => catalogue%key(j)%place, of_others => catalogue%key(j)%described)
          if (is_owned(place)) then
            described = material%soil%key_of(place(chosen))
            described%is_required = described%is_required .and. .not. material%rigid
            described%only = of_others%only
            call v%property(material%soil%constant(place(chosen)), described)
          else
            of_others%is_undecided = chosen == 0
            call v%property(catalogue%model(m)%model%constant(place(m)), of_others)
          end if
        end associate
      end do
      if (m == chosen) then
        call material%soil%visit_options(v, .true.)
      else
        call catalogue%model(m)%model%visit_options(v, .false.)
      end if
    end do

  contains

    pure logical function is_owned(place)
      !! Has the chosen model a key?
      integer, intent(in) :: place(:)   !! of the models

      is_owned = .false.
      if (chosen > 0) is_owned = place(chosen) > 0
    end function is_owned
  end subroutine visit_soil

  subroutine visit_retention(v, material, is_dry)
    !! Keys of &material on partial saturation.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    logical, intent(in) :: is_dry
    character(len=*), parameter :: only = 'retention = ''van_genuchten'''
    logical :: applies

    call v%name(material%retention, &
                key('retention', 'none: saturated at any pressure; van_genuchten: suction '// &
                    'empties the pores, Mualem''s relative conductivity', &
                    choices='none van_genuchten', only='water = ''coupled'' in &scene', &
                    applies=.not. is_dry))
    applies = material%retention == 'van_genuchten' .and. .not. is_dry
    call v%real(material%retention_alpha, &
                key('retention_alpha', 'alpha of van Genuchten: 1 over the suction head that '// &
                    'empties the pores', unit='1/m', range='> 0', required=.true., only=only, &
                    applies=applies))
    call v%real(material%retention_exponent, &
                key('retention_exponent', 'n of van Genuchten; m is 1 - 1/n', unit='-', &
                    range='> 1 and <= 20', only=only, applies=applies))
    call v%real(material%residual_saturation, &
                key('residual_saturation', 'S_r: what no suction takes out', unit='-', &
                    range='>= 0 and < 1', only=only, applies=applies))
    call v%real(material%least_conductivity, &
                key('least_conductivity', 'floor of the conductivity over that of the '// &
                    'saturated soil', unit='-', range='>= 0 and <= 1', only=only, applies=applies))
  end subroutine visit_retention

  subroutine visit_water(v, water)
    !! Keys of &water.
    class(key_visitor_t), intent(inout) :: v
    type(water_t), intent(inout) :: water

    call v%real(water%density, key('density', 'density', unit='kg/m3', range='> 0'))
    call v%real(water%bulk_modulus, &
                key('bulk_modulus', 'K_w; lower values stand for a little trapped air', unit='Pa', &
                    range='> 0'))
    call v%real(water%unit_weight, &
                key('unit_weight', 'gamma_w that k and heads refer to', unit='N/m3', range='> 0'))
    call v%name(water%operator, &
                key('operator', 'compact: quadratic MLS with boundary points; two_pass: the '// &
                    'published MLS-SPH recipe, first order at best', choices='compact two_pass'))
    call v%real(water%support_radius, &
                key('support_radius', 'radius of the neighbourhoods, in particle spacings', &
                    unit='-', range='>= 1.5 and <= 4'))
    call v%real(water%rebuild_displacement, &
                key('rebuild_displacement', 'neighbourhoods are built anew when a particle has '// &
                    'moved so far, in particle spacings', unit='-', range='> 0 and <= 1', &
                    restart=restart_free))
    call v%logical(water%fluid_inertia, &
                   key('fluid_inertia', 'Darcy''s law with the water''s inertia at the '// &
                       'skeleton''s acceleration, as the literature''s u-p form has it; with '// &
                       'integrator = ''explicit'' only', &
                       only='operator = ''compact''', applies=water%operator == 'compact', &
                       undecided=water%operator == ''))
    call v%real(water%cell_storage, &
                key('cell_storage', 'pressure-projection storage inside a cell, tau_i', unit='-', &
                    range='>= 0', only='operator = ''compact''', &
                    applies=water%operator == 'compact', undecided=water%operator == ''))
    call v%real(water%block_storage, &
                key('block_storage', 'pressure-projection storage inside 2 x 2 (x 2) cells, '// &
                    'tau_m', unit='-', range='>= 0', only='operator = ''compact''', &
                    applies=water%operator == 'compact', undecided=water%operator == ''))
    call v%name(water%stepping, &
                key('stepping', 'pressure steps within a mechanical step: one, several, RKL2 '// &
                    'super-time-stepping, or chosen from the limits', &
                    choices='auto single subcycle rkl2', restart=restart_free))
  end subroutine visit_water

  subroutine visit_mechanics(v, mechanics)
    !! Keys of &mechanics.
    class(key_visitor_t), intent(inout) :: v
    type(mechanics_t), intent(inout) :: mechanics

    call v%name(mechanics%transfer, &
                key('transfer', 'how velocities pass between particles and grid; auto: aflip '// &
                    'with deformation = ''updated'', where losses a step would shorten '// &
                    'run-outs, else apic', choices='auto aflip apic flip pic blend'))
    call v%real(mechanics%filter_time, &
                key('filter_time', 'in which velocities that the grid does not see fade; 0: '// &
                    'of each particle, 2 spacings over its speed of shear waves, at most '// &
                    'sqrt(spacing/gravity)/3', unit='s', range='>= 0', &
                    only='transfer = ''aflip''', &
                    applies=mechanics%transfer == 'aflip' .or. mechanics%transfer == 'auto', &
                    undecided=mechanics%transfer == ''))
    call v%real(mechanics%flip_fraction, &
                key('flip_fraction', 'share of FLIP, the rest is PIC', unit='-', &
                    range='>= 0 and <= 1', only='transfer = ''blend''', &
                    applies=mechanics%transfer == 'blend', undecided=mechanics%transfer == '', &
                    restart=restart_free))
    call v%logical(mechanics%average_volume_change, &
                   key('average_volume_change', 'volume change of skeleton and water averaged '// &
                       'over the cell (B-bar)'))
    call v%name(mechanics%coupling_gradient, &
                key('coupling_gradient', 'where the volume change for the water is evaluated', &
                    choices='auto particle cell_centre'))
    call v%name(mechanics%damping, &
                key('damping', 'viscous: force -c m v; local: -c |force| against the velocity; '// &
                    'fading: viscous with c = b/t, for loads at the start', &
                    choices='none viscous local fading', restart=restart_free))
    call v%real(mechanics%damping_coefficient, &
                key('damping_coefficient', 'c: viscous [1/s], local [-]; b: fading [-]; '// &
                    'negative: from the scene''s lowest frequency, 0.3 and 3', &
                    only='damping = ''viscous'', ''local'' or ''fading''', &
                    applies=mechanics%damping /= 'none', undecided=mechanics%damping == '', &
                    restart=restart_free))
    call v%real(mechanics%density_scaling, &
                key('density_scaling', 'factor on inertia only, for quasi-static runs', unit='-', &
                    range='>= 1'))
    call v%real(mechanics%penalty, &
                key('penalty', 'stiffness of walls that no grid line follows, in modulus '// &
                    'per spacing: the undrained one, at most 1000 times the drained', &
                    unit='-', range='> 0'))
  end subroutine visit_mechanics

  subroutine visit_region(v, region)
    !! Keys of &region.
    class(key_visitor_t), intent(inout) :: v
    type(region_t), intent(inout) :: region

    call v%name(region%name, key('name', 'what surfaces and initial states call it', &
                                 required=.true.))
    call v%name(region%material, key('material', 'name of a &material', required=.true.))
    call v%name(region%shape, &
                key('shape', 'box, polygon or circle (2-D), sphere or triangles of a file (3-D)', &
                    choices='box polygon circle sphere stl'))
    call v%vector(region%box_min, &
                  key('box_min', 'lower corner before turning', unit='m', required=.true., &
                      only='shape = ''box''', applies=region%shape == 'box', &
                      undecided=region%shape == ''))
    call v%vector(region%box_max, &
                  key('box_max', 'upper corner before turning', unit='m', required=.true., &
                      only='shape = ''box''', applies=region%shape == 'box', &
                      undecided=region%shape == ''))
    call v%points(region%vertices, &
                  key('vertices', 'corners x1, z1, x2, z2, ... of a simple polygon; edge1 runs '// &
                      'from the first to the second, counter-clockwise', unit='m', &
                      required=.true., only='shape = ''polygon''', &
                      applies=region%shape == 'polygon', undecided=region%shape == ''))
    call v%vector(region%centre, &
                  key('centre', 'of the circle or sphere before turning', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%real(region%radius, &
                key('radius', 'of the circle or sphere', unit='m', range='> 0', required=.true., &
                    only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                    undecided=region%shape == ''))
    call v%vector(region%cut_min, &
                  key('cut_min', 'only the part of the circle or sphere above this corner: a '// &
                      'half, quarter or eighth', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%vector(region%cut_max, &
                  key('cut_max', 'only the part below this corner', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%text(region%stl_file, &
                key('stl_file', 'a closed surface of triangles (STL, text or binary); a path '// &
                    'from the scene''s folder. Its faces are called by the names of '// &
                    'its solids, and face1, face2, ...: the start and --check list them', &
                    longest=1000, required=.true., only='shape = ''stl''', &
                    applies=region%shape == 'stl', undecided=region%shape == '', &
                    restart=restart_content))
    call v%real(region%stl_scale, &
                key('stl_scale', 'unit of the file, e.g. 1e-3 for mm', unit='m', range='> 0', &
                    only='shape = ''stl''', applies=region%shape == 'stl', &
                    undecided=region%shape == ''))
    call v%real(region%stl_face_angle, &
                key('stl_face_angle', 'neighbouring triangles whose normals differ by more '// &
                    'belong to different faces', unit='deg', range='>= 0 and <= 180', &
                    only='shape = ''stl''', applies=region%shape == 'stl', &
                    undecided=region%shape == ''))
    call v%text(region%particle_file, &
                key('particle_file', 'a table (CSV) of particles, a path from the scene''s '// &
                    'folder, takes the place of the lattice: x, (y,) z [m] and, if given, '// &
                    'volume [m3; m2 in 2-D, m in 1-D] in each line; a first line with names '// &
                    'picks these columns; # begins a comment. The shape still tells the faces', &
                    longest=1000, restart=restart_content))
    call v%real(region%particle_spacing, &
                key('particle_spacing', 'of the lattice; 0: grid spacing / particles_per_cell, '// &
                    'or the mean one of particle_file', unit='m', range='>= 0'))
    call v%integer(region%particles_per_cell, &
                   key('particles_per_cell', 'particles per cell and direction', &
                       range='>= 1 and <= 100', only='particle_spacing = 0', &
                       applies=.not. region%particle_spacing > 0.0_wp .and. &
                       .not. allocated(region%particle_file)))
    call v%real(region%jitter, &
                key('jitter', 'largest random shift of a particle in each direction, in '// &
                    'particle spacings', unit='-', range='>= 0 and < 0.5'))
    call v%integer(region%jitter_seed, key('jitter_seed', 'another number, other shifts'))
    call v%real(region%shape_angle, &
                key('shape_angle', 'turn of the shape about pivot, from x towards z', unit='deg', &
                    range='>= -360 and <= 360'))
    call v%real(region%lattice_angle, &
                key('lattice_angle', 'turn of the particle lattice about pivot, from x towards z', &
                    unit='deg', range='>= -360 and <= 360'))
    call v%vector(region%pivot, key('pivot', 'centre of both turns', unit='m'))
    call v%vector(region%velocity, key('velocity', 'initial velocity', unit='m/s'))
    call v%real(region%spin, &
                key('spin', 'initial angular velocity about pivot, from x towards z, added to '// &
                    'velocity', unit='rad/s'))
  end subroutine visit_region

  pure logical function is_round(region)
    !! Is the region's shape a circle or a sphere?
    type(region_t), intent(in) :: region

    is_round = region%shape == 'circle' .or. region%shape == 'sphere'
  end function is_round

  subroutine visit_initial_state(v, state, is_dry)
    !! Keys of &initial_state.
    class(key_visitor_t), intent(inout) :: v
    type(initial_state_t), intent(inout) :: state
    logical, intent(in) :: is_dry

    call v%name(state%region, &
                key('region', 'name of a &region', fallback='every region'))
    call v%name(state%pore_pressure, &
                key('pore_pressure', 'zero, hydrostatic about water_level (suction above '// &
                    'it), a given value, or a checkerboard of both signs', &
                    choices='zero hydrostatic given checkerboard', &
                    only='water = ''coupled'' in &scene', applies=.not. is_dry))
    call v%real(state%water_level, &
                key('water_level', 'elevation of zero pressure', unit='m', &
                    only='pore_pressure = ''hydrostatic''', &
                    applies=state%pore_pressure == 'hydrostatic', &
                    undecided=state%pore_pressure == ''))
    call v%real(state%pore_pressure_value, &
                key('pore_pressure_value', 'pressure, or amplitude of the checkerboard; '// &
                    'compression positive', unit='Pa', &
                    only='pore_pressure = ''given'' or ''checkerboard''', &
                    applies=state%pore_pressure == 'given' .or. &
                    state%pore_pressure == 'checkerboard', &
                    undecided=state%pore_pressure == ''))
    call v%name(state%effective_stress, &
                key('effective_stress', 'zero, given, or geostatic: the weight of the '// &
                    'particle''s own soil, under water in scenes with water, below '// &
                    'surface_level; for layers of different weight, deeper water or '// &
                    'sloping ground add geostatic_start in &time', &
                    choices='zero geostatic given'))
    call v%real(state%surface_level, &
                key('surface_level', 'elevation of zero effective stress', unit='m', &
                    only='effective_stress = ''geostatic''', &
                    applies=state%effective_stress == 'geostatic', &
                    undecided=state%effective_stress == ''))
    call v%real(state%lateral_ratio, &
                key('lateral_ratio', 'K_0: horizontal over vertical effective stress', unit='-', &
                    range='>= 0', only='effective_stress = ''geostatic''', &
                    applies=state%effective_stress == 'geostatic', &
                    undecided=state%effective_stress == ''))
    call v%vector(state%effective_stress_value, &
                  key('effective_stress_value', 'xx, yy, zz, xy, yz, zx; tension positive', &
                      unit='Pa', only='effective_stress = ''given''', &
                      applies=state%effective_stress == 'given', &
                      undecided=state%effective_stress == ''))
    call v%integer(state%mode_number, &
                   key('mode_number', 'm of the initial velocity v_z = a sin(pi (2 m - 1) z / '// &
                       '(2 H)) of a bar, H high over all regions; 0: none', &
                       range='>= 0 and <= 1000'))
    call v%real(state%mode_amplitude, &
                key('mode_amplitude', 'a of that velocity', unit='m/s', only='mode_number > 0', &
                    applies=state%mode_number > 0))
  end subroutine visit_initial_state

  subroutine visit_surface(v, surface)
    !! Keys of &surface.
    class(key_visitor_t), intent(inout) :: v
    type(surface_t), intent(inout) :: surface

    call v%name(surface%name, key('name', 'what conditions and probes call it', required=.true.))
    call v%name(surface%region, key('region', 'name of a &region', required=.true.))
    call v%name(surface%face, &
                key('face', 'face of the unturned box (x-, x+, y-, y+, z-, z+), edge of a '// &
                    'polygon (edge1, edge2, ...), round of a circle or sphere, whose cuts are '// &
                    'called like a box''s faces, or all; free: what no other surface names '// &
                    '(but for those that only probes use), '// &
                    'with deformation = ''updated'' also what comes to be as bodies tear, '// &
                    'spread and meet', required=.true.))
    call v%vector(surface%box_min, &
                  key('box_min', 'only the part of the face above this corner', unit='m'))
    call v%vector(surface%box_max, &
                  key('box_max', 'only the part of the face below this corner', unit='m'))
  end subroutine visit_surface

  subroutine visit_mechanical_condition(v, condition)
    !! Keys of &mechanical_condition.
    class(key_visitor_t), intent(inout) :: v
    type(mechanical_condition_t), intent(inout) :: condition
    character(len=*), parameter :: no_wall = 'a kind other than ''roller'', ''fixed'' and '// &
                                   '''absorbing'''
    integer :: n
    logical :: has_value

    call v%name(condition%surface, key('surface', 'name of a &surface', required=.true.))
    call v%name(condition%kind, &
                key('kind', 'roller: no normal motion; fixed: none at all; velocity, '// &
                    'normal_velocity: prescribed; traction, pressure: loads; reservoir: '// &
                    'pressure of water with a free level; absorbing: lets waves out (dashpots '// &
                    'of Lysmer and Kuhlemeyer); plate: rigid, '// &
                    'frictionless, one normal velocity and a total force', required=.true., &
                    choices='roller fixed velocity normal_velocity traction pressure reservoir '// &
                    'absorbing plate'))
    call v%name(condition%imposition, &
                key('imposition', 'of walls: on grid nodes, by springs on the true surface, or '// &
                    'nodes where the grid follows the surface', choices='auto nodes penalty', &
                    only='a wall or plate', applies=.not. condition%is_load()))
    has_value = condition%kind /= 'roller' .and. condition%kind /= 'fixed' .and. &
                condition%kind /= 'absorbing'
    n = ndim
    if (condition%kind == 'pressure' .or. condition%kind == 'plate' .or. &
        condition%kind == 'reservoir' .or. condition%kind == 'normal_velocity') n = 1
    call v%vector(condition%value(1:n), &
                  key('value', 'velocity [m/s] and traction [Pa]: a vector; normal_velocity '// &
                      '[m/s]: outward; pressure: into the body [Pa]; reservoir: elevation of '// &
                      'its level [m]; plate: total force into '// &
                      'the body [N; N/m in 2-D, Pa in 1-D]', only=no_wall, &
                      applies=has_value, &
                      required=.true., undecided=condition%kind == ''))
    call visit_table(v, condition%pattern%factor, no_wall, has_value)
    call visit_formula(v, condition%pattern%formula, 'a given load', &
                       condition%is_load() .and. has_value)
  end subroutine visit_mechanical_condition

  subroutine visit_hydraulic_condition(v, condition)
    !! Keys of &hydraulic_condition.
    class(key_visitor_t), intent(inout) :: v
    type(hydraulic_condition_t), intent(inout) :: condition
    character(len=*), parameter :: has_no_value = 'a kind other than ''no_flow'' and '// &
                                   '''seepage_face'''
    logical :: has_value

    call v%name(condition%surface, key('surface', 'name of a &surface', required=.true.))
    call v%name(condition%kind, &
                key('kind', 'total head, pore pressure, outward Darcy flux, or none; '// &
                    'reservoir: the head of its level below it, a seepage face above; '// &
                    'seepage_face: water '// &
                    'may leave at zero pressure, none enters; rainfall: enters as far as it '// &
                    'can without ponding', required=.true., &
                    choices='head pressure flux no_flow reservoir seepage_face rainfall'))
    has_value = condition%kind /= 'no_flow' .and. condition%kind /= 'seepage_face'
    call v%real(condition%value, &
                key('value', 'head [m], pressure [Pa], flux [m/s], outward positive, elevation '// &
                    'of the reservoir''s level [m], or rain on a level plane [m/s]', &
                    only=has_no_value, applies=has_value, required=.true., &
                    undecided=condition%kind == ''))
    call visit_table(v, condition%pattern%factor, has_no_value, has_value)
    call visit_formula(v, condition%pattern%formula, has_no_value, has_value)
  end subroutine visit_hydraulic_condition

  subroutine visit_formula(v, formula, only, applies)
    !! The key of a formula of place and time.
    class(key_visitor_t), intent(inout) :: v
    character(len=:), allocatable, intent(inout) :: formula
    character(len=*), intent(in) :: only
    logical, intent(in) :: applies

    call v%text(formula, &
                key('formula', 'a further factor on value, a formula of x, y, z [m] and t [s] '// &
                    'as in &source', unit='-', longest=1000, only=only, applies=applies, &
                    fallback='1 everywhere'))
  end subroutine visit_formula

  subroutine visit_base_motion(v, motion)
    !! Keys of &base_motion.
    class(key_visitor_t), intent(inout) :: v
    type(base_motion_t), intent(inout) :: motion

    call v%vector(motion%acceleration, &
                  key('acceleration', 'of the base, times the factors below', unit='m/s2', &
                      fallback='none'))
    call visit_table(v, motion%pattern%factor, '', .true.)
    call v%text(motion%file, &
                key('file', 'a file with a time [s] and a factor in each line, a path from '// &
                    'the scene''s folder, takes the place of factor_times and '// &
                    'factor_values; # begins a comment', longest=1000, restart=restart_content))
    call visit_formula(v, motion%pattern%formula, '', .true.)
  end subroutine visit_base_motion

  subroutine visit_hole(v, hole)
    !! Keys of &hole.
    class(key_visitor_t), intent(inout) :: v
    type(hole_t), intent(inout) :: hole

    call v%name(hole%region, key('region', 'name of the &region that it is cut out of; it '// &
                                 'turns with it', required=.true.))
    call v%points(hole%vertices, &
                  key('vertices', 'corners x1, z1, x2, z2, ... of a simple polygon within the '// &
                      'region; its edges are the face hole1 of the region, those of the '// &
                      'region''s next hole hole2, ...', unit='m', required=.true.))
  end subroutine visit_hole

  subroutine visit_barrier(v, barrier)
    !! Keys of &barrier.
    class(key_visitor_t), intent(inout) :: v
    type(barrier_t), intent(inout) :: barrier

    call v%name(barrier%name, key('name', 'what messages call it', required=.true.))
    call v%points(barrier%vertices, &
                  key('vertices', '2-D: a chain of points x1, z1, x2, z2, ...; 3-D: corners of '// &
                      'a flat convex polygon, in order', unit='m', required=.true.))
  end subroutine visit_barrier

  subroutine visit_rigid_wall(v, wall)
    !! Keys of &rigid_wall.
    class(key_visitor_t), intent(inout) :: v
    type(rigid_wall_t), intent(inout) :: wall

    call v%name(wall%name, key('name', 'what messages call it', required=.true.))
    call v%vector(wall%position, key('position', 'a point of its plane', unit='m', required=.true.))
    call v%vector(wall%normal, key('normal', 'from the wall towards the bodies, of any length', &
                                   unit='-', required=.true.))
    call v%name(wall%kind, key('kind', 'frictional: slides, with Coulomb''s friction; rough: '// &
                               'what touches it sticks', choices='frictional rough'))
    call v%real(wall%friction, &
                key('friction', 'tangent of the angle of friction between soil and wall', &
                    unit='-', range='>= 0', only='kind = ''frictional''', &
                    applies=.not. wall%is_rough()))
  end subroutine visit_rigid_wall

  subroutine visit_named_table(v, table)
    !! Keys of &table.
    class(key_visitor_t), intent(inout) :: v
    type(named_table_t), intent(inout) :: table

    call v%name(table%name, &
                key('name', 'what formulas call it: a letter, then letters, digits and _', &
                    required=.true.))
    call v%list(table%argument, &
                key('arguments', 'where its values are known, strictly increasing: times [s], '// &
                    'elevations [m], or what formulas call it with', only='no file', &
                    applies=.not. allocated(table%file)))
    call v%list(table%value, &
                key('values', 'of the function there: linear between, constant before the '// &
                    'first and after the last', only='no file', &
                    applies=.not. allocated(table%file)))
    call v%text(table%file, &
                key('file', 'a file with an argument and a value in each line, a path from the '// &
                    'scene''s folder, in the place of arguments and values; # begins a '// &
                    'comment', longest=1000, restart=restart_content))
  end subroutine visit_named_table

  subroutine visit_table(v, table, only, applies)
    !! The two keys of a factor over time.
    class(key_visitor_t), intent(inout) :: v
    type(table_t), intent(inout) :: table
    character(len=*), intent(in) :: only
    logical, intent(in) :: applies

    call v%list(table%argument, &
                key('factor_times', 'times of factor_values, strictly increasing', unit='s', &
                    only=only, applies=applies, restart=restart_later))
    call v%list(table%value, &
                key('factor_values', 'factors on value: linear between the times, constant '// &
                    'before and after', unit='-', only=only, applies=applies, &
                    fallback='1 at all times', restart=restart_later))
  end subroutine visit_table

  subroutine visit_source(v, source)
    !! Keys of &source.
    class(key_visitor_t), intent(inout) :: v
    type(source_t), intent(inout) :: source
    character(len=18), parameter :: scenes(3) = [character(len=18) :: 'dimension = 2 or 3', &
                                                                                'dimension = 3', '']
    integer :: d

    do d = 1, 3
      call v%text(source%force(d)%formula, &
                  key('force_'//axis_name(d), 'formula of the body force along '// &
                      axis_name(d)//', beside gravity', unit='N/m3', longest=1000, &
                      only=trim(scenes(d)), applies=any(axis == d)))
    end do
    call v%text(source%water%formula, &
                key('water', 'formula of the water supplied per volume of soil', unit='1/s', &
                    longest=1000))
  end subroutine visit_source

  subroutine visit_probe(v, probe)
    !! Keys of &probe.
    class(key_visitor_t), intent(inout) :: v
    type(probe_t), intent(inout) :: probe
    logical :: is_field, is_surface

    call v%name(probe%name, key('name', 'name of the history', required=.true.))
    call v%name(probe%kind, &
                key('kind', 'value at a point, mean over a surface (integral over area, at the '// &
                    'surface itself), mean downward displacement '// &
                    'of a surface, volume integral, or the distance within which a fraction '// &
                    'of the mass lies', required=.true., &
                    choices='point surface_mean settlement domain_sum run_out'))
    is_field = probe%kind /= 'settlement' .and. probe%kind /= 'run_out'
    is_surface = probe%kind == 'surface_mean' .or. probe%kind == 'settlement'
    call v%name(probe%field, &
                key('field', 'a field of the result file, e.g. pore_pressure', &
                    only='a kind other than ''settlement'' and ''run_out''', &
                    applies=is_field, required=.true., &
                    undecided=probe%kind == ''))
    call v%integer(probe%component, &
                   key('component', 'of a vector or stress field, as in the result file', &
                       range='>= 1 and <= 6', &
                       only='a kind other than ''settlement'' and ''run_out''', &
                       applies=is_field))
    call v%name(probe%surface, &
                key('surface', 'name of a &surface', &
                    only='kind = ''surface_mean'' or ''settlement''', &
                    applies=is_surface, required=.true., undecided=probe%kind == ''))
    call v%vector(probe%position, &
                  key('position', 'where, or where distances of a run-out count from', &
                      unit='m', only='kind = ''point'' or ''run_out''', &
                      applies=probe%kind == 'point' .or. probe%kind == 'run_out', &
                      required=.true., undecided=probe%kind == ''))
    call v%vector(probe%direction, &
                  key('direction', 'of a run-out, of any length; 0: the horizontal distance '// &
                      'from the vertical through the position', unit='-', &
                      only='kind = ''run_out''', applies=probe%kind == 'run_out', &
                      undecided=probe%kind == ''))
    call v%real(probe%fraction, &
                key('fraction', 'of the mass that lies within the run-out; single foremost '// &
                    'particles depend on chance: 0.95 and 0.99 do not', unit='-', &
                    range='> 0 and <= 1', only='kind = ''run_out''', &
                    applies=probe%kind == 'run_out', undecided=probe%kind == ''))
  end subroutine visit_probe

  subroutine visit_solver(v, solver)
    !! Keys of &solver.
    class(key_visitor_t), intent(inout) :: v
    type(solver_t), intent(inout) :: solver

    call v%name(solver%linear, &
                key('linear', 'direct: factorised on every rank; iterative: Krylov method with '// &
                    'multigrid; auto: direct for small systems', choices='auto direct iterative'))
    call v%real(solver%tolerance, &
                key('tolerance', 'relative error of an iterative solution''s displacements and '// &
                    'pressures; the residual is brought down as far as that takes', &
                    unit='-', range='> 0 and <= 1e-2'))
  end subroutine visit_solver

  subroutine visit_output(v, output)
    !! Keys of &output.
    class(key_visitor_t), intent(inout) :: v
    type(output_t), intent(inout) :: output

    call v%text(output%name, &
                key('name', 'stem of the files', longest=200, restart=restart_content, &
                    fallback='name of the scene''s folder or file'))
    call v%text(output%directory, &
                key('directory', 'where the files go', longest=4000, restart=restart_content, &
                    fallback='the working directory'))
    call v%real(output%history_interval, &
                key('history_interval', 'time between entries of the histories; 0: every step '// &
                    'of implicit runs, about 1000 entries of explicit ones', unit='s', &
                    range='>= 0'))
    call v%long(output%checkpoint_steps, &
                key('checkpoint_steps', 'steps between checkpoints; 0: none', range='>= 0'))
    call v%real(output%checkpoint_minutes, &
                key('checkpoint_minutes', 'wall time between checkpoints; 0: none', unit='min', &
                    range='>= 0'))
    call v%logical(output%checkpoint_at_outputs, &
                   key('checkpoint_at_outputs', 'a checkpoint at every output, the start and '// &
                       'the end included; all are kept, as <name>.restart.<step>.h5'))
    call v%real(output%progress_seconds, &
                key('progress_seconds', 'wall time between lines of progress', unit='s', &
                    range='>= 0'))
  end subroutine visit_output

  subroutine visit_verification(v, verification)
    !! Keys of &verification.
    class(key_visitor_t), intent(inout) :: v
    type(verification_t), intent(inout) :: verification

    call v%name(verification%case, &
                key('case', 'name of the exact solution', required=.true., &
                    choices='terzaghi mandel cryer de_leeuw hydrostatic bar drainage'))
    call v%real(verification%load, &
                key('load', 'pressure q [Pa]; Mandel: force F [N/m]'))
    call v%real(verification%length, &
                key('length', 'drainage length H, half width or radius a', unit='m', range='> 0', &
                    required=.true.))
    call v%vector(verification%drained, &
                  key('drained', 'a point of the drained surface', unit='m', required=.true.))
    call v%vector(verification%direction, &
                  key('direction', 'unit vector from the drained surface into the body', unit='-', &
                      required=.true.))
  end subroutine visit_verification

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
    if (len(real_text(value)) == 0) self%key(size(self%key))%fallback = or_unlimited
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

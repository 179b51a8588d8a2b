!! From a scene to a model that is ready to run.
module dosui_setup
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_barriers, only: barrier_faces
  use dosui_boundary_points, only: seed_boundary_points
  use dosui_capabilities, only: moving_wall, reason_against, wall
  use dosui_communicator, only: communicator_t
  use dosui_damping, only: automatic_damping, damping_kind_of, damping_none, damping_viscous, &
                           fastest_damping
  use dosui_error, only: error_t
  use dosui_initial_state, only: apply_initial_state
  use dosui_integrator_traits, only: traits_of
  use dosui_model, only: model_t
  use dosui_particle_fields, only: field_needs_t, register_particle_fields, &
                                   register_surface_fields
  use dosui_place_properties, only: check_properties, choose_representatives, start_states
  use dosui_retention, only: retention_t
  use dosui_resolution, only: warn_of_loose_nodes, warn_of_thin_regions, &
                              warn_of_unseen_cells
  use dosui_scene, only: material_t, name_length, rigid_wall_t, scene_t
  use dosui_seeding, only: region_spacing, seed_regions
  use dosui_surface_overlaps, only: check_overlaps, warn_of_overlaps
  use dosui_surface_report, only: describe_surfaces
  use dosui_text, only: to_text
  use dosui_topology, only: build_geometry, distribute, join_parts
  use dosui_transfer_filter, only: set_filter_times
  implicit none
  private

  public :: setup_model, seed_model, finish_setup, describe_model

  real(wp), parameter :: many_steps = 1.0e8_wp   !! of an explicit run: a warning
  real(wp), parameter :: lossy_steps = 1000.0_wp   !! with a transfer that damps in each: likewise

contains

  subroutine setup_model(model, comm, scene)
    !! Takes over the scene and registers the fields that it needs; no particle exists yet.
    type(model_t), intent(inout) :: model
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    integer :: k, n
    logical :: affine, filtered
    type(field_needs_t) :: needs

    model%comm = comm
    model%scene = scene
    call model%log%init(comm%is_root())
    model%coupled = scene%water_mode == 'coupled'
    model%rigid = all(scene%material%rigid)
    model%updated = scene%deformation == 'updated'
    model%finds_surface = model%updated .and. any(scene%surface%face == 'free')
    model%skeleton%averaged = scene%mechanics%average_volume_change .and. .not. model%rigid
    model%finite = scene%deformation == 'finite'
    model%skeleton%centred = model%skeleton%averaged .and. &
                             scene%mechanics%coupling_gradient /= 'particle'
    call prepare_conditions(model)
    n = size(scene%hydraulic_condition)
    allocate (model%water%condition_surface(n))
    allocate (model%balance%inflow(n + 2), source=0.0_wp)
    do k = 1, n
      model%water%condition_surface(k) = findloc(scene%surface%name == &
                                                scene%hydraulic_condition(k)%surface, .true., dim=1)
    end do
    model%scales%spacing = minval([(region_spacing(scene, scene%region(k)), k=1, &
                                    size(scene%region))])
    if (model%coupled .and. allocated(scene%barrier)) then
      if (size(scene%barrier) > 0) model%water%barrier = barrier_faces(scene%barrier, &
                                                                       model%scales%spacing)
    end if
    filtered = scene%mechanics%transfer == 'aflip' .and. .not. model%rigid
    affine = filtered .or. (scene%mechanics%transfer == 'apic' .and. .not. model%rigid)
    call scene%prepare_materials(model%materials)
    call model%sources%init(model%scene%source)
    if (.not. model%rigid) call prepare_reactions(model)
    model%nonlinear = model%unsaturated .or. &
                      (model%materials%is_nonlinear() .and. .not. model%rigid)
    model%traits = traits_of(scene%integrator)
    model%water%inertia_drives = model%coupled .and. .not. model%rigid .and. &
                           scene%water%fluid_inertia .and. scene%water%operator == 'compact' .and. &
                                 model%traits%is_explicit()
    needs = field_needs_t(coupled=model%coupled, affine=affine, filtered=filtered, &
                          updated=model%updated, finite=model%finite, &
                          adaptive=model%traits%solves_skeleton, &
                          projected=model%traits%projects() .and. &
                          model%reactions%n > model%reactions%n_surface, &
                          switching=model%water%switching, unsaturated=model%unsaturated, &
                          layered=model%coupled .and. has_layers(scene%material), &
                          finds_surface=model%finds_surface, n_state=model%materials%n_state(), &
                          n_surface=size(scene%surface), &
                          inertia=model%water%inertia_drives, &
                          following=model%updated .and. scene%shape_function == 'cpgimp', &
                          triangulated=any(scene%region%shape == 'stl'))
    call register_particle_fields(model%particles, model%p, needs)
    call register_surface_fields(model%surface, model%s, needs)
    call add_timers(model)
    call model%clock%init(scene%time)
  end subroutine setup_model

  pure logical function has_layers(material)
    !! Are there soils of several conductivities?
    type(material_t), intent(in) :: material(:)

    has_layers = maxval(material%hydraulic_conductivity%constant) > &
                 minval(material%hydraulic_conductivity%constant) .or. &
                 any(material%hydraulic_conductivity%varies())
  end function has_layers

  subroutine prepare_reactions(model)
    !! The walls whose forces are reported.
    type(model_t), intent(inout) :: model
    type(rigid_wall_t), allocatable :: walls(:)

    allocate (walls(0))
    if (allocated(model%scene%rigid_wall)) walls = model%scene%rigid_wall
    call model%reactions%init(model%scene%surface, model%scene%mechanical_condition, walls)
  end subroutine prepare_reactions

  subroutine prepare_conditions(model)
    !! Weights of reservoirs' water, and what suction does in each material.
    type(model_t), intent(inout) :: model
    integer :: k

    do k = 1, size(model%scene%mechanical_condition)
      associate (condition => model%scene%mechanical_condition(k))
        condition%water_weight = -model%scene%water%density*model%scene%gravity(ndim)
      end associate
    end do
    model%water%switching = model%coupled .and. any(model%scene%hydraulic_condition%may_switch())
    allocate (model%water%retention(size(model%scene%material)))
    do k = 1, size(model%scene%material)
      associate (material => model%scene%material(k))
        model%water%retention(k) = retention_t(is_active=material%retention == 'van_genuchten', &
                                               alpha=material%retention_alpha, &
                                               n=material%retention_exponent, &
                                               residual=material%residual_saturation, &
                                               least=material%least_conductivity, &
                                               unit_weight=model%scene%water%unit_weight)
      end associate
    end do
    model%unsaturated = model%coupled .and. any(model%water%retention%is_active)
  end subroutine prepare_conditions

  subroutine add_timers(model)
    !! Names the phases of a run.
    type(model_t), intent(inout) :: model

    model%phase%rebuild = model%timers%add('geometry')
    model%phase%to_grid = model%timers%add('particles to grid')
    model%phase%halo = model%timers%add('grid halo exchange')
    model%phase%nodes = model%timers%add('nodal update')
    model%phase%to_particles = model%timers%add('grid to particles')
    model%phase%stress = model%timers%add('stress')
    model%phase%water = model%timers%add('water')
    model%phase%assembly = model%timers%add('assembly')
    model%phase%solver = model%timers%add('linear solver')
    model%phase%output = model%timers%add('output')
  end subroutine add_timers

  subroutine seed_model(model, problems, err)
    !! Seeds particles and surface points, sets initial states and distributes all. Problems of
    !! the scene come back one a line. Collective.
    type(model_t), intent(inout) :: model
    character(len=:), allocatable, intent(inout) :: problems
    type(error_t), intent(inout) :: err

    call model%particles%resize(0)
    call model%surface%resize(0)
    call seed_regions(model%comm, model%scene, model%particles, model%p, problems)
    call seed_boundary_points(model%comm, model%scene, model%surface, model%s, problems)
    if (len(problems) == 0) call check_overlaps(model, problems)
    if (len(problems) > 0) return
    call apply_initial_state(model%scene, model%particles, model%p)
    call check_properties(model, problems)
    if (model%p%state > 0 .and. len(problems) == 0) call start_states(model, problems)
    if (len(problems) > 0) return
    if (model%p%start_pressure > 0) then
      model%particles%field(model%p%start_pressure)%values = &
        model%particles%field(model%p%pore_pressure)%values
    end if
    if (model%finite) call start_undeformed(model)
    if (model%p%deformation > 0) call start_gradients(model)
    if (model%updated) model%surface%field(model%s%outward_area)%values = outward_areas(model)
    model%particles%field(model%p%mass)%values = model%particles%field(model%p%mass)%values* &
                                                 model%scene%mechanics%density_scaling
    call distribute(model, err)
  end subroutine seed_model

  subroutine start_undeformed(model)
    !! Deformation gradients and volumes of the reference configuration.
    type(model_t), intent(inout) :: model
    integer :: a

    associate (field => model%surface%field, h => model%s)
      field(h%deformation)%values = 0.0_wp
      field(h%reference_area)%values = outward_areas(model)
      do a = 1, ndim
        field(h%deformation)%values(a + (a - 1)*ndim, :) = 1.0_wp
      end do
    end associate
    associate (field => model%particles%field, h => model%p)
      field(h%reference_volume)%values = field(h%volume)%values
    end associate
  end subroutine start_undeformed

  subroutine start_gradients(model)
    !! Deformation gradients of particles before any deformation.
    type(model_t), intent(inout) :: model
    integer :: a

    associate (f => model%particles%field(model%p%deformation)%values)
      f = 0.0_wp
      do a = 1, ndim
        f(a + (a - 1)*ndim, :) = 1.0_wp
      end do
    end associate
  end subroutine start_gradients

  pure function outward_areas(model) result(area)
    !! Areas of the surface points along their normals [m2].
    type(model_t), intent(in) :: model
    real(wp), allocatable :: area(:, :)

    associate (field => model%surface%field, h => model%s)
      area = field(h%normal)%values*spread(field(h%area)%values(1, :), 1, ndim)
    end associate
  end function outward_areas

  subroutine finish_setup(model, err)
    !! Derives moduli, density and damping, and builds the geometry. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    real(wp) :: movement

    call choose_representatives(model)
    call find_moduli(model)
    call find_impedances(model)
    call choose_damping(model)
    movement = model%decomposition%movement   ! of a restart: its geometry is that of the last build
    call build_geometry(model, err)
    if (model%traits%solves_water .and. .not. err%failed()) call join_parts(model, err)
    if (model%clock%step == 0 .and. .not. err%failed()) call set_filter_times(model)
    model%decomposition%movement = movement
    if (model%traits%solves_water .and. .not. err%failed()) call check_walls(model, err)
    call model%comm%agree(err)
  end subroutine finish_setup

  subroutine find_impedances(model)
    !! What absorbing surfaces oppose to waves: rho c of the material of their region, water and
    !! skeleton moving together.
    type(model_t), intent(inout) :: model
    real(wp) :: density, modulus
    integer :: c, m, r, s

    associate (scene => model%scene)
      do c = 1, size(scene%mechanical_condition)
        if (scene%mechanical_condition(c)%kind /= 'absorbing') cycle
        s = findloc(scene%surface%name == scene%mechanical_condition(c)%surface, .true., dim=1)
        r = findloc(scene%region%name == scene%surface(s)%region, .true., dim=1)
        m = findloc(scene%material%name == scene%region(r)%material, .true., dim=1)
        associate (stiff => model%materials%item(m)%model)
          density = scene%mixture_density(m)*scene%mechanics%density_scaling
          modulus = stiff%constrained_modulus() + scene%water_modulus(m)
          scene%mechanical_condition(c)%impedance = sqrt(density* &
                                                         [modulus, stiff%shear_modulus()])
        end associate
      end do
    end associate
  end subroutine find_impedances

  subroutine check_walls(model, err)
    !! Walls off the grid lines that the integrator and the deformation cannot have. Collective.
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: feature, reason
    integer :: c

    reason = ''
    do c = 1, size(model%scene%mechanical_condition)
      associate (condition => model%scene%mechanical_condition(c))
        if (condition%is_load()) cycle
        feature = wall
        if (condition%moves_wall()) feature = moving_wall
        reason = reason_against(feature, model%traits%name, model%scene%deformation)
        if (len(reason) == 0) cycle
        if (model%comm%any(any(model%skeleton%by_force(c, :)))) then
          call err%set('surface '''//trim(condition%surface)//''' is off the grid lines: '//reason)
        end if
      end associate
    end do
  end subroutine check_walls

  subroutine find_moduli(model)
    !! Largest drained and undrained modulus, and the mean density of the undeformed body.
    type(model_t), intent(inout) :: model
    real(wp) :: sums(2), modulus, undrained
    integer :: m

    if (.not. model%scales%density > 0.0_wp) then   ! a restart has it from its checkpoint
      associate (set => model%particles)
        sums(1) = sum(set%field(model%p%mass)%values(1, 1:set%count))
        sums(2) = sum(set%field(model%p%volume)%values(1, 1:set%count))
      end associate
      call model%comm%sum_array(sums)
      model%scales%density = sums(1)/sums(2)
    end if
    model%scales%skeleton_modulus = 0.0_wp
    model%scales%stiffest = 0.0_wp
    do m = 1, size(model%scene%material)
      if (model%scene%material(m)%rigid) cycle
      modulus = model%materials%item(m)%model%constrained_modulus()
      undrained = modulus + model%scene%water_modulus(m)
      model%scales%skeleton_modulus = max(model%scales%skeleton_modulus, modulus)
      model%scales%stiffest = max(model%scales%stiffest, undrained)
    end do
  end subroutine find_moduli

  subroutine choose_damping(model)
    !! The scene's damping coefficient, or one from the lowest frequency of the drained body.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: position(:, :)
    real(wp) :: low(ndim), high(ndim), wave_speed, length
    integer :: d

    model%skeleton%damping_kind = damping_kind_of(trim(model%scene%mechanics%damping))
    model%skeleton%damping = model%scene%mechanics%damping_coefficient
    if (model%skeleton%damping_kind == damping_none) return
    associate (field => model%particles%field, n => model%particles%count)
      position = field(model%p%position)%values(:, 1:n)
      ! undeformed, and rounded below, so that a restart finds the same length
      if (model%updated) position = position - field(model%p%displacement)%values(:, 1:n)
    end associate
    do d = 1, ndim
      low(d) = model%comm%minimum(minval(position(d, :)))
      high(d) = model%comm%maximum(maxval(position(d, :)))
    end do
    length = maxval(high - low)/model%scene%grid_spacing
    length = (0.1_wp*anint(10.0_wp*length) + 1.0_wp)*model%scene%grid_spacing
    wave_speed = sqrt(model%scales%skeleton_modulus/model%scales%density)
    model%skeleton%damping_start = fastest_damping(wave_speed, length)
    if (model%skeleton%damping >= 0.0_wp) return
    model%skeleton%damping = automatic_damping(model%skeleton%damping_kind, wave_speed, length)
  end subroutine choose_damping

  subroutine describe_model(model)
    !! What will be computed, and how it is spread over the ranks.
    type(model_t), intent(inout) :: model
    integer(i8) :: n, m
    integer :: linear, isolated, smallest, k

    n = model%comm%sum(int(model%particles%count, i8))
    m = model%comm%sum(int(model%surface%count, i8))
    smallest = model%comm%minimum(model%particles%count)
    call model%log%info('scene        '//model%scene%file)
    if (len(model%scene%title) > 0) call model%log%info('title        '//model%scene%title)
    call describe_bodies(model)
    call model%log%info('particles    '//to_text(n)//' ('//to_text(ndim)//'-D), surface points '// &
                        to_text(m))
    call model%log%info('ranks        '//to_text(model%comm%size)//', imbalance '// &
                        to_text(model%decomposition%partition%imbalance)//', bricks of cells '// &
                        to_text(model%decomposition%partition%n_brick)//', cut faces '// &
                        to_text(model%decomposition%partition%edge_cut))
    call model%log%info('integrator   '//trim(model%traits%name)//' ('// &
                        model%scene%choice%reason//'); '//model%scene%choice%describe())
    do k = 1, model%scene%warnings%count()
      call model%log%warning(model%scene%warnings%text(k))
    end do
    if (model%traits%is_explicit() .and. &
        model%scene%choice%steps_of(model%traits%name) > many_steps) then
      call model%log%warning('so many explicit steps take very long: '// &
                             model%scene%choice%describe())
    end if
    call warn_of_lossy_transfer(model)
    if (smallest == 0 .and. model%comm%size > 1) then
      call model%log%warning('some ranks hold no particle: fewer ranks would do')
    end if
    if (model%skeleton%damping_kind > 0) then
      call model%log%info('damping      '//trim(model%scene%mechanics%damping)//' '// &
                          to_text(model%skeleton%damping)// &
                          merge(' 1/s', ' [-]', model%skeleton%damping_kind == damping_viscous))
    end if
    call describe_surfaces(model)
    call warn_of_lost_loads(model)
    call warn_of_overlaps(model)
    call warn_of_thin_regions(model)
    call warn_of_loose_nodes(model)
    call warn_of_unseen_cells(model)
    if (.not. model%coupled) return
    linear = model%comm%sum(model%water%head_operator%n_linear)
    isolated = model%comm%sum(model%water%head_operator%n_isolated)
    if (linear + isolated > 0) then
      call model%log%warning('degenerate neighbourhoods: '//to_text(linear)// &
                             ' particles exchange water pairwise, '//to_text(isolated)// &
                             ' not at all')
    end if
  end subroutine describe_model

  subroutine warn_of_lossy_transfer(model)
    !! Transfers that take something from moving bodies every step, whatever its length.
    type(model_t), intent(inout) :: model
    real(wp) :: steps

    if (.not. model%updated .or. model%rigid) return
    steps = model%scene%choice%steps_of(model%traits%name)
    if (.not. steps > lossy_steps) return
    select case (model%scene%mechanics%transfer)
    case ('apic', 'pic', 'blend')
      call model%log%warning('&mechanics transfer = '''// &
                             trim(model%scene%mechanics%transfer)//''' damps with every step, '// &
                             'and there are about '//to_text(steps, 2)//': run-outs depend on '// &
                             'the step; aflip damps with time')
    case default
    end select
  end subroutine warn_of_lossy_transfer

  subroutine describe_bodies(model)
    !! Bodies of files and their faces, so that surfaces can name them.
    type(model_t), intent(inout) :: model
    integer, parameter :: most_faces = 60   ! of a body
    character(len=name_length + 6) :: solid
    integer :: r, f

    do r = 1, size(model%scene%region)
      if (.not. allocated(model%scene%region(r)%body)) cycle
      associate (region => model%scene%region(r), body => model%scene%region(r)%body)
        call model%log%info('body         '//trim(region%name)//': '//region%stl_file//', '// &
                            to_text(body%n_triangle)//' triangles, '// &
                            to_text(body%volume, 6)//' m3, faces '//to_text(body%n_face))
        if (body%was_inside_out) then
          call model%log%warning(region%stl_file//' is inside out: all triangles are turned round')
        end if
        do f = 1, min(body%n_face, most_faces)
          solid = region%solid(body%solid(findloc(body%face, f, dim=1)))
          if (solid /= '') solid = " of '"//trim(solid)//"'"
          call model%log%info('face         '//to_text(f)//trim(solid)//': '// &
                              body%describe_face(f))
        end do
        if (body%n_face > most_faces) then
          call model%log%info('face         '//to_text(most_faces + 1)//' ... '// &
                              to_text(body%n_face)//' are not listed')
        end if
      end associate
    end do
  end subroutine describe_bodies

  subroutine warn_of_lost_loads(model)
    !! Loaded points that reach no node.
    type(model_t), intent(inout) :: model
    integer :: dropped

    dropped = model%comm%sum(model%skeleton%surface_forces%n_dropped)
    if (dropped > 0) call model%log%warning(to_text(dropped)// &
                                            ' loaded surface points find no grid node with mass')
  end subroutine warn_of_lost_loads
end module dosui_setup

!! Who owns which particle, and everything that depends on where particles are: grid, conditions,
!! ghosts and the water's stencils. Small-strain scenes build it once.
module dosui_topology
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, nsig, nshear
  use dosui_barriers, only: cut_neighbours, cut_points
  use dosui_centred_weights, only: centre_weights
  use dosui_cell_average, only: cell_sums
  use dosui_cut_weight, only: build_shift
  use dosui_error, only: error_t
  use dosui_fluid_inertia, only: find_mobility, forget_inertia_flow
  use dosui_ghosts, only: find_ghosts
  use dosui_head_operator, only: kind_head
  use dosui_keys, only: pack_key
  use dosui_particle_moduli, only: find_moduli_of
  use dosui_model, only: model_t
  use dosui_neighbours, only: build_neighbours
  use dosui_moving_loads, only: build_moving_loads
  use dosui_nodal_conditions, only: point_on_grid_plane
  use dosui_outer_pressure, only: is_pressure
  use dosui_particle_to_grid, only: particles_to_grid
  use dosui_partition, only: partition_bricks
  use dosui_point_set, only: cell_order, point_set_t
  use dosui_pore_water, only: compressibility_at
  use dosui_seeding, only: grid_reach
  use dosui_shape_functions, only: shape_kind_of, shape_shift
  use dosui_sort, only: binary_search
  use dosui_surface_renewal, only: renew_surface
  use dosui_surface_sets, only: index_of, set_holds, set_width, sets_meet, wall_set
  use dosui_text, only: to_text
  use dosui_transfer_filter, only: spread_filter_times
  use dosui_water_step, only: set_surface_data, soil_conductivities
  implicit none
  private

  public :: distribute, build_geometry, build_water, join_parts, needs_rebuild, &
            refresh_storage, refresh_weights

  real(wp), parameter :: inward = 1.0e-3_wp          !! surface points lie in the cell inside [h]
  real(wp), parameter :: imbalance_limit = 1.2_wp    !! repartition above this
  real(wp), parameter :: stiffest_walls = 1.0e3_wp   !! penalty walls over the drained modulus [-]
  real(wp), parameter :: least_stretch = 0.2_wp      !! of GIMP domains that follow [-]
  real(wp), parameter :: largest_stretch = 1.5_wp    !! likewise [-]
  integer(i8), parameter :: bricks_per_rank = 64_i8  !! aimed at

contains

  subroutine distribute(model, err, as_built)
    !! Gives every particle and surface point to the owner of its brick of cells, and sorts them by
    !! patch. The next build starts from the present positions, or, `as_built`, as after a restart
    !! on other ranks, from those of the last one. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    logical, intent(in), optional :: as_built
    real(wp), allocatable :: inside(:, :)
    logical :: anew

    anew = .true.
    if (present(as_built)) anew = .not. as_built
    if (model%updated) call check_reach(model, err)
    if (err%failed()) return
    if ((model%updated .or. model%finite) .and. anew) then
      call copy_field(model%particles, model%p%position, model%p%water_position)
      call copy_field(model%surface, model%s%position, model%s%water_position)
      if (model%updated) call turn_surfaces(model)
      if (model%p%half_domain > 0) call stretch_domains(model)
    end if
    if (.not. allocated(model%decomposition%brick_key) .or. &
        is_unbalanced(model)) call partition(model, err)
    if (err%failed()) return
    call send_home(model, model%particles, model%particles%field(model%p%build_position)%values)
    call inward_positions(model, inside)
    call send_home(model, model%surface, inside)
    if (model%finds_surface .and. anew) then
      call renew_surface(model, changes=model%clock%step > 0_i8)
      call inward_positions(model, inside)
      call send_home(model, model%surface, inside)
    end if
    call sort_points(model)
  end subroutine distribute

  pure subroutine stretch_domains(model)
    !! Half domains of the particles: the first one times |F_aa|, within limits and what patches
    !! of three nodes hold (cpGIMP: [Wallstedt2008]; the corners stay along the axes:
    !! [Charlton2017]).
    type(model_t), intent(inout) :: model
    real(wp) :: stretch
    integer :: a, p

    associate (f => model%particles%field(model%p%deformation)%values, &
               half => model%particles%field(model%p%half_domain)%values)
      do p = 1, model%particles%count
        do a = 1, ndim
          stretch = min(max(abs(f(a + (a - 1)*ndim, p)), least_stretch), largest_stretch)
          half(a, p) = min(0.5_wp, 0.5_wp*model%scales%spacing/model%scene%grid_spacing*stretch)
        end do
      end do
    end associate
  end subroutine stretch_domains

  subroutine check_reach(model, err)
    !! Stops before a particle is so far away that the numbers of cells end. Collective.
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: text
    real(wp) :: reach
    integer :: p, d

    reach = grid_reach(model%scene)
    associate (position => model%particles%field(model%p%position)%values)
      do p = 1, model%particles%count
        if (all(abs(position(:, p)) <= reach .and. &
                abs(position(:, p) - model%scene%grid_origin) <= reach)) cycle
        text = 'particle '//to_text(model%particles%id(p))//' is beyond the grid''s reach of '// &
               to_text(reach, 3)//' m in step '//to_text(model%clock%step)//', t = '// &
               to_text(model%clock%time)//' s, at ('
        do d = 1, ndim
          text = text//to_text(position(d, p) + model%scene%local_origin(d))// &
                 merge(') m', ',  ', d == ndim)
        end do
        call err%set(text//': give domain_min and domain_max in &grid, and leaving_particles = '// &
                     '''remove'' in &scene to go on without')
        exit
      end do
    end associate
    call model%comm%agree(err)
  end subroutine check_reach

  subroutine turn_surfaces(model)
    !! Normals and areas that surface points have now; walls keep theirs.
    type(model_t), intent(inout) :: model
    real(wp) :: size_now, walls(set_width(size(model%scene%surface)))
    integer :: p

    walls = wall_set(model%scene)
    associate (field => model%surface%field, h => model%s)
      do p = 1, model%surface%count
        if (field(h%surface)%values(1, p) < 0.0_wp) cycle   ! a barrier
        if (sets_meet(field(h%surface)%values(:, p), walls)) cycle
        size_now = norm2(field(h%outward_area)%values(:, p))
        if (.not. size_now > 0.0_wp) cycle
        field(h%area)%values(1, p) = size_now
        field(h%normal)%values(:, p) = field(h%outward_area)%values(:, p)/size_now
      end do
    end associate
  end subroutine turn_surfaces

  subroutine sort_points(model)
    !! Particles by patch and surface points by cell.
    type(model_t), intent(inout) :: model
    integer, allocatable :: order(:)
    real(wp) :: shift

    shift = shape_shift(shape_kind_of(trim(model%scene%shape_function_in_force())))* &
            model%scene%grid_spacing
    associate (set => model%particles)
      call cell_order(set%count, set%field(model%p%build_position)%values, set%id, &
                      model%scene%grid_origin + shift, model%scene%grid_spacing, order)
      call set%reorder(order)
    end associate
    associate (set => model%surface)
      call cell_order(set%count, &
                      set%field(model%s%build_position)%values, set%id, &
                      model%scene%grid_origin, model%scene%grid_spacing, order)
      call set%reorder(order)
    end associate
  end subroutine sort_points

  subroutine join_parts(model, err)
    !! Brings particles to the owner of the first cell of their group, and builds the geometry again
    !! if any moved: no cell, group and block of cells is then shared by ranks, which implicit
    !! integrators need. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: place(:, :)
    logical :: moves
    integer :: p

    if (.not. model%skeleton%centred .or. model%comm%size == 1) return
    if (.not. (model%mesh%quadrature%exact .and. model%mesh%quadrature%has_groups)) return
    allocate (place(ndim, model%particles%count))
    do p = 1, model%particles%count
      place(:, p) = cell_centre(model, model%mesh%quadrature%group(model%mesh%cell(p)))
    end do
    moves = .not. is_home(model, place)
    if (.not. model%comm%any(moves)) return
    call send_home(model, model%particles, place)
    call sort_points(model)
    call build_geometry(model, err)
  end subroutine join_parts

  pure function cell_centre(model, cell) result(centre)
    !! Centre of a cell of the grid [m].
    type(model_t), intent(in) :: model
    integer, intent(in) :: cell
    real(wp) :: centre(ndim)

    centre = model%grid%origin + &
             model%grid%spacing*(real(model%grid%cell_base(:, cell), wp) + 0.5_wp)
  end function cell_centre

  logical function is_home(model, position)
    !! Are all positions in bricks of this rank, or of none?
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: position(:, :)   !! [m]
    integer(i8), allocatable :: key(:)
    integer :: p, place

    is_home = .true.
    key = brick_keys(model, size(position, 2), position)
    do p = 1, size(key)
      place = binary_search(model%decomposition%brick_key, key(p))
      if (place > 0) is_home = is_home .and. &
                               model%decomposition%brick_rank(place) == model%comm%rank
    end do
  end function is_home

  pure subroutine copy_field(set, source, destination)
    !! Copies a field of all owned points.
    type(point_set_t), intent(inout) :: set
    integer, intent(in) :: source, destination   !! handles

    set%field(destination)%values(:, 1:set%count) = set%field(source)%values(:, 1:set%count)
  end subroutine copy_field

  logical function is_unbalanced(model) result(unbalanced)
    !! Does a rank hold many more particles than the mean? Collective.
    type(model_t), intent(in) :: model
    real(wp) :: mean

    mean = real(model%comm%sum(int(model%particles%count, i8)), wp)/real(model%comm%size, wp)
    unbalanced = real(model%comm%maximum(model%particles%count), wp) > &
                 max(imbalance_limit, 1.1_wp*model%decomposition%partition%imbalance)*mean
  end function is_unbalanced

  subroutine partition(model, err)
    !! Divides the occupied bricks among the ranks.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: key(:)
    real(wp), allocatable :: weight(:)
    integer(i8) :: total
    real(wp) :: per_brick, per_cell

    total = model%comm%sum(int(model%particles%count, i8))
    per_cell = max(1.0_wp, (model%scene%grid_spacing/model%scales%spacing)**ndim)
    per_brick = real(total, wp)/real(bricks_per_rank*model%comm%size, wp)
    ! whole blocks of 2 cells, so that no block is shared, unless there are too few of them
    associate (edge => model%decomposition%brick_edge)
      edge = max(1, int((per_brick/per_cell)**(1.0_wp/ndim)))
      if (model%traits%solves_water) edge = max(2, edge)
      if (edge > 1) edge = edge - mod(edge, 2)
    end associate
    key = brick_keys(model, model%particles%count, &
                     model%particles%field(model%p%build_position)%values)
    allocate (weight(size(key)), source=1.0_wp)
    call partition_bricks(model%comm, key, weight, model%decomposition%brick_key, &
                          model%decomposition%brick_rank, &
                          model%decomposition%partition, err)
  end subroutine partition

  function brick_keys(model, n, position) result(key)
    !! Brick of each position.
    type(model_t), intent(in) :: model
    integer, intent(in) :: n
    real(wp), intent(in) :: position(:, :)   !! [m]
    integer(i8), allocatable :: key(:)
    integer :: p

    allocate (key(n))
    do p = 1, n
      key(p) = pack_key(floor((position(:, p) - model%scene%grid_origin)/ &
                              (model%scene%grid_spacing*model%decomposition%brick_edge)))
    end do
  end function brick_keys

  subroutine send_home(model, set, position)
    !! Points go to the owner of their brick; those in bricks without owner stay.
    type(model_t), intent(inout) :: model
    type(point_set_t), intent(inout) :: set
    real(wp), intent(in) :: position(:, :)   !! [m]
    integer, allocatable :: destination(:)
    integer(i8), allocatable :: key(:)
    integer :: p, place

    key = brick_keys(model, set%count, position)
    allocate (destination(set%count))
    do p = 1, set%count
      place = binary_search(model%decomposition%brick_key, key(p))
      destination(p) = model%comm%rank
      if (place > 0) destination(p) = model%decomposition%brick_rank(place)
    end do
    call set%migrate(model%comm, destination)
  end subroutine send_home

  subroutine inward_positions(model, inside)
    !! Positions a little inside the surface, to tell a surface point's cell.
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: inside(:, :)
    integer :: p

    allocate (inside(ndim, model%surface%count))
    associate (position => model%surface%field(model%s%build_position)%values, &
               normal => model%surface%field(model%s%normal)%values)
      do p = 1, model%surface%count
        inside(:, p) = position(:, p) - inward*model%scene%grid_spacing*normal(:, p)
      end do
    end associate
  end subroutine inward_positions

  subroutine build_geometry(model, err)
    !! Builds grid, conditions and stencils from the positions at the last `distribute`: a restart
    !! calls it with the stored ones and gets the same. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: inside(:, :), area(:, :), normal(:, :)
    real(wp) :: margin
    integer :: n, n_lost, handle

    call model%timers%start(model%phase%rebuild)
    if (model%finite) then   ! a restart has a deformed surface
      area = model%surface%field(model%s%area)%values
      normal = model%surface%field(model%s%normal)%values
      call straighten_surface(model)
    end if
    n = model%particles%count
    handle = model%p%build_position
    margin = 0.0_wp
    if (model%updated) then
      margin = moving_margin(model)
    else if (model%skeleton%centred .and. .not. is_fitted(model)) then
      ! parts of cells look for others, and ranks want to know what these find
      margin = merge(2.0_wp, 4.0_wp, model%comm%size == 1)*model%scene%grid_spacing
    end if
    call inward_positions(model, inside)
    call model%grid%build(model%comm, model%scene%grid_spacing, model%scene%grid_origin, &
                          shape_kind_of(trim(model%scene%shape_function_in_force())), n, &
                          model%particles%field(handle)%values(:, 1:n), margin, &
                          model%surface%count, inside, &
                          nint(model%scene%grid_period/model%scene%grid_spacing))
    model%grid%half_domain = min(0.5_wp, 0.5_wp*model%scales%spacing/model%scene%grid_spacing)
    if (model%p%half_domain > 0) then
      model%grid%domain = model%particles%field(model%p%half_domain)%values(:, 1:n)
    end if
    call allocate_arrays(model)
    call model%grid%locate(n, model%particles%field(model%p%position)%values(:, 1:n), &
                           model%mesh%patch, &
                           model%mesh%cell, n_lost)
    if (n_lost > 0) call err%set('particles lie outside the background grid')
    call locate_surface(model, inside)
    call build_conditions(model, handle)
    if (model%finite) call find_filling(model)
    call refresh_weights(model)
    call build_shift(model)
    call find_least_inertia(model)
    if (model%finite) then
      handle = model%p%current_position
      model%surface%field(model%s%area)%values = area
      model%surface%field(model%s%normal)%values = normal
    end if
    call spread_filter_times(model)
    if (model%coupled) then
      if (allocated(model%water%inertia_flux)) deallocate (model%water%inertia_flux)
      call build_water(model, handle)
      call find_mobility(model)
      call forget_inertia_flow(model)
    end if
    model%decomposition%rebuilds = model%decomposition%rebuilds + 1
    model%decomposition%movement = 0.0_wp
    call model%timers%stop(model%phase%rebuild)
  end subroutine build_geometry

  pure subroutine straighten_surface(model)
    !! Areas and normals of the surface points before any deformation.
    type(model_t), intent(inout) :: model
    integer :: p

    associate (field => model%surface%field, h => model%s)
      do p = 1, model%surface%count
        associate (reference => field(h%reference_area)%values(:, p))
          field(h%area)%values(1, p) = norm2(reference)
          field(h%normal)%values(:, p) = reference/max(norm2(reference), tiny(1.0_wp))
        end associate
      end do
    end associate
  end subroutine straighten_surface

  pure real(wp) function moving_margin(model) result(margin)
    !! No particle moves farther between two builds, with a step to spare [m].
    type(model_t), intent(in) :: model

    margin = 0.0_wp
    if (model%updated) margin = 2.0_wp*model%scene%water%rebuild_displacement*model%scales%spacing
  end function moving_margin

  subroutine allocate_arrays(model)
    !! Arrays that follow the numbers of particles and nodes.
    type(model_t), intent(inout) :: model
    integer :: n

    n = model%particles%count
    if (allocated(model%mesh%patch)) then
      deallocate (model%mesh%patch, model%mesh%cell, model%mesh%surface_cell, &
                  model%skeleton%nodal, model%skeleton%velocity_old, &
                  model%skeleton%velocity, model%skeleton%strain_increment, model%material, &
                  model%skeleton%no_state)
    end if
    if (allocated(model%skeleton%spin)) deallocate (model%skeleton%spin)
    if (allocated(model%water%volume_strain)) deallocate (model%water%volume_strain)
    if (allocated(model%mesh%weight)) deallocate (model%mesh%weight)
    allocate (model%mesh%weight(n), source=0.0_wp)
    allocate (model%mesh%patch(n), model%mesh%cell(n), &
              model%mesh%surface_cell(model%surface%count), source=0)
    allocate (model%skeleton%nodal(1 + 2*ndim, model%grid%n_node), source=0.0_wp)
    allocate (model%skeleton%velocity_old(ndim, model%grid%n_node), source=0.0_wp)
    allocate (model%skeleton%velocity(ndim, model%grid%n_node), source=0.0_wp)
    allocate (model%skeleton%strain_increment(nsig, n), source=0.0_wp)
    allocate (model%skeleton%no_state(0, n))
    if (allocated(model%skeleton%tangent)) deallocate (model%skeleton%tangent)
    if (model%traits%solves_skeleton .and. .not. model%rigid .and. &
        (model%materials%is_nonlinear() .or. model%finite)) then
      allocate (model%skeleton%tangent(nsig, nsig, n), source=0.0_wp)
    end if
    if (model%coupled) allocate (model%water%volume_strain(n), source=0.0_wp)
    if (model%updated) allocate (model%skeleton%spin(nshear, n), source=0.0_wp)
    model%material = nint(model%particles%field(model%p%material)%values(1, 1:n))
  end subroutine allocate_arrays

  subroutine locate_surface(model, inside)
    !! Cells of the surface points, and in updated scenes the nodes of all ranks' such cells.
    !! Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: inside(:, :)
    integer, allocatable :: patch(:)
    real(wp), allocatable :: touches(:, :)
    integer :: n_lost, p

    allocate (patch(model%surface%count), source=0)
    call model%grid%locate(model%surface%count, inside, patch, model%mesh%surface_cell, n_lost)
    if (.not. model%updated) return
    allocate (touches(1, model%grid%n_node), source=0.0_wp)
    do p = 1, model%surface%count
      if (model%mesh%surface_cell(p) == 0) cycle
      touches(1, model%grid%cell_node(:, model%mesh%surface_cell(p))) = 1.0_wp
    end do
    call model%grid%node_map%sum_copies(model%comm, 1, touches)
    model%mesh%surface_node = touches(1, :) > 0.5_wp
  end subroutine locate_surface

  subroutine build_conditions(model, handle)
    !! Conditions on nodes, tractions and walls.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle   !! positions that the geometry is built from
    real(wp), allocatable :: nodal(:, :), held(:, :), edge(:, :, :)
    integer, allocatable :: patch(:), cell(:)
    logical, allocatable :: at_points(:, :)   ! conditions whose forces surface points spread
    logical, allocatable :: is_filled(:), is_barred(:, :)
    integer :: n, m, n_lost, surface_handle

    n = model%particles%count
    m = model%surface%count
    surface_handle = model%s%build_position
    allocate (patch(n), cell(n), source=0)
    call model%grid%locate(n, model%particles%field(handle)%values(:, 1:n), patch, cell, n_lost)
    call choose_imposition(model, surface_handle)
    if (model%updated) then
      call hold_nodes_of_points(model, surface_handle)
      is_barred = model%skeleton%nodal_conditions%bars(model%grid%n_node)
    end if
    call model%grid%find_ends(model%comm, n, cell, model%particles%field(handle)%values(:, 1:n), &
                              moving_margin(model), is_barred)
    if (model%skeleton%centred) call build_quadrature(model, handle, surface_handle, cell)
    associate (field => model%surface%field, h => model%s)
      allocate (nodal(1 + 2*ndim, model%grid%n_node))
      call particles_to_grid(model%grid, n, patch, model%particles%field(handle)%values, &
                             model%particles%field(model%p%velocity)%values, &
                             model%particles%field(model%p%mass)%values, &
                             model%particles%field(model%p%volume)%values, &
                             model%particles%field(model%p%effective_stress)%values, &
                             model%scene%gravity, nodal)
      call model%grid%node_map%sum_copies(model%comm, 1 + 2*ndim, nodal)
      call build_extension(model, n, patch, cell, handle)
      if (h%edge > 0) edge = reshape(field(h%edge)%values(:, 1:m), [ndim, max(ndim - 1, 1), m])
      if (h%held > 0) held = field(h%held)%values(:, 1:m)
      at_points = model%skeleton%by_force
      if (model%updated) at_points = at_points .and. &
                                     .not. spread(is_pressure(model%scene%mechanical_condition), &
                                                  2, m)
      if (model%mesh%quadrature%exact .and. .not. model%mesh%quadrature%fitted) then
        is_filled = model%mesh%quadrature%part > 0.0_wp
      end if
      call model%skeleton%surface_forces%init(model%comm, model%scene%mechanical_condition, &
                                              model%grid, m, &
                                              model%mesh%surface_cell, &
                                              field(surface_handle)%values(:, 1:m), &
                                              field(h%normal)%values(:, 1:m), &
                                              field(h%area)%values(1, 1:m), nodal(1, :), &
                                              model%scales%density, &
                                              wall_modulus(model), model%scene%mechanics%penalty, &
                                              at_points, is_filled, held, edge)
      if (model%mesh%quadrature%exact .and. .not. model%mesh%quadrature%fitted) then
        call hold_nodes_of_parts(model)
      else if (.not. model%updated) then
        call hold_nodes_of_points(model, surface_handle)
      end if
    end associate
    if (model%updated) call build_moving_loads(model, surface_handle, cell)
    model%skeleton%lifted = model%skeleton%centred .and. &
                            model%comm%any(model%skeleton%surface_forces%has_lifts())
  end subroutine build_conditions

  subroutine hold_nodes_of_points(model, handle)
    !! Conditions on nodes beside surface points. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle   !! positions of the surface points

    associate (field => model%surface%field, m => model%surface%count)
      call model%skeleton%nodal_conditions%init(model%comm, model%scene%mechanical_condition, &
                                                model%grid, m, model%mesh%surface_cell, &
                                                field(handle)%values(:, 1:m), &
                                                field(model%s%normal)%values(:, 1:m), &
                                                model%skeleton%on_nodes)
    end associate
  end subroutine hold_nodes_of_points

  subroutine hold_nodes_of_parts(model)
    !! Conditions on nodes where pieces of surface are cut by the cells: the part in each cell holds
    !! that cell's nodes, also where a body ends a little beyond a node. Collective.
    type(model_t), intent(inout) :: model
    integer, allocatable :: point(:), part(:)
    real(wp), allocatable :: position(:, :)
    real(wp) :: hat
    integer :: i, k, q

    associate (forces => model%skeleton%surface_forces)
      point = pack(spread([(k, k=1, forces%n_point)], 1, forces%n_part), forces%cell > 0)
      part = pack(spread([(k, k=1, forces%n_part)], 2, forces%n_point), forces%cell > 0)
      allocate (position(ndim, size(point)))
      do q = 1, size(point)   ! hats give a part's middle
        position(:, q) = 0.0_wp
        hat = sum(forces%weight(:, part(q), point(q)))
        do i = 1, 2**ndim
          position(:, q) = position(:, q) + forces%weight(i, part(q), point(q))/hat* &
                           real(model%grid%corner_index(i, forces%cell(part(q), point(q))), wp)
        end do
        position(:, q) = model%grid%origin + model%grid%spacing*position(:, q)
      end do
      call model%skeleton%nodal_conditions%init(model%comm, model%scene%mechanical_condition, &
                                                model%grid, &
                                                size(point), [(forces%cell(part(q), point(q)), &
                                                               q=1, size(point))], position, &
                                             model%surface%field(model%s%normal)%values(:, point), &
                                                model%skeleton%on_nodes(:, point))
    end associate
  end subroutine hold_nodes_of_parts

  subroutine build_extension(model, n, patch, cell, handle)
    !! Nodes that the body hardly touches follow others, unless particles move through the grid:
    !! what nodes project away there in every step makes run-outs depend on the number of steps.
    !! Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: n, patch(n), cell(n)   !! of the particles where the geometry is built
    integer, intent(in) :: handle                 !! their positions
    real(wp), allocatable :: nodal(:, :), cells(:, :), amount(:), none(:), filling(:)
    logical, allocatable :: wanted(:)
    integer :: c, p

    if (model%updated) return
    allocate (amount(n), none(n), cells(2, model%grid%n_cell), nodal(1 + 2*ndim, model%grid%n_node))
    none = 0.0_wp
    cells = 0.0_wp
    associate (field => model%particles%field, h => model%p)
      do p = 1, n
        if (model%finite) then   ! masses change with the water
          amount(p) = field(h%reference_volume)%values(1, p)
        else
          amount(p) = field(h%volume)%values(1, p)
        end if
        amount(p) = amount(p)/model%grid%spacing**ndim
        cells(:, cell(p)) = cells(:, cell(p)) + [1.0_wp, amount(p)]
      end do
      call particles_to_grid(model%grid, n, patch, field(handle)%values, field(h%velocity)%values, &
                             amount, none, field(h%effective_stress)%values, model%scene%gravity, &
                             nodal)
    end associate
    call model%grid%node_map%sum_copies(model%comm, 1 + 2*ndim, nodal)
    call model%grid%cell_map%sum_copies(model%comm, 2, cells)
    filling = cells(2, :)
    if (model%skeleton%centred) filling = model%mesh%quadrature%part/model%grid%spacing**ndim
    allocate (wanted(model%grid%n_node), source=.false.)
    do p = 1, n
      wanted(model%grid%patch_node(:, patch(p))) = .true.
    end do
    do c = 1, model%grid%n_cell
      if (filling(c) > 0.0_wp) wanted(model%grid%cell_node(:, c)) = .true.
    end do
    call model%mesh%extension%init(model%comm, model%grid, filling, cells(1, :) > 0.5_wp, &
                                   nodal(1, :), &
                                   wanted)
  end subroutine build_extension

  pure real(wp) function wall_modulus(model) result(modulus)
    !! The modulus that penalty walls resist: the stiffest one that steps see, as far as the
    !! skeleton can tell. Springs as stiff as real water would hold what leans a little
    !! altogether [Pa].
    type(model_t), intent(in) :: model

    modulus = min(model%scales%stiffest, stiffest_walls*model%scales%skeleton_modulus)
    if (model%traits%projects()) modulus = model%scales%skeleton_modulus
  end function wall_modulus

  subroutine build_quadrature(model, handle, surface_handle, cell)
    !! Measures and gradients of cells. In small-strain scenes groups of cells stand for their
    !! members in the blocks of the water's storage.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle, surface_handle   !! positions
    integer, intent(in) :: cell(:)                  !! of the particles there
    logical, allocatable :: cuts(:)
    integer :: p, n

    n = model%particles%count
    if (.not. model%updated) then
      call model%mesh%quadrature%init_from_shapes(model%comm, model%grid, model%scene%region, &
                                                  n, cell)
      if (model%mesh%quadrature%has_groups) then
        model%grid%cell_block = model%grid%cell_block(model%mesh%quadrature%group)
      end if
      return
    end if
    allocate (cuts(model%surface%count))
    do p = 1, model%surface%count
      cuts(p) = .not. lies_on_nodes(model, surface_handle, p)
    end do
    call model%mesh%quadrature%init_from_particles(model%comm, model%grid, n, cell, &
                                                   model%particles%field(handle)%values(:, 1:n), &
                                               model%surface%count, model%mesh%surface_cell, cuts, &
                                                   finds_ragged=model%traits%is_explicit())
  end subroutine build_quadrature

  subroutine find_least_inertia(model)
    !! Half of what the cells around a node would give it if they were evenly filled, where
    !! surfaces cut cells; none elsewhere. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: inertia(:, :)
    integer :: c, i, node

    allocate (inertia(1, model%grid%n_node), source=0.0_wp)
    if (model%mesh%quadrature%exact .and. .not. model%mesh%quadrature%fitted) then
      do c = 1, model%grid%n_cell
        if (.not. model%grid%cell_map%is_owned(c)) cycle
        do i = 1, 2**ndim
          node = model%grid%cell_node(i, c)
          inertia(1, node) = inertia(1, node) + &
                             0.5_wp*model%scales%density*model%mesh%quadrature%part(c)/2**ndim
        end do
      end do
      call model%grid%node_map%sum_copies(model%comm, 1, inertia)
    end if
    model%skeleton%inertia = inertia(1, :)
  end subroutine find_least_inertia

  logical function is_fitted(model) result(fitted)
    !! Do all surfaces lie on planes of grid nodes? Collective.
    type(model_t), intent(in) :: model
    integer :: p

    fitted = .true.
    do p = 1, model%surface%count
      if (model%surface%field(model%s%surface)%values(1, p) < 0.0_wp) cycle   ! a barrier
      fitted = fitted .and. lies_on_nodes(model, model%s%position, p)
    end do
    fitted = model%comm%all(fitted)
  end function is_fitted

  pure logical function lies_on_nodes(model, handle, p)
    !! Does a surface point lie on a plane of grid nodes along its surface?
    type(model_t), intent(in) :: model
    integer, intent(in) :: handle   !! positions of the surface points
    integer, intent(in) :: p

    lies_on_nodes = point_on_grid_plane(model%surface%field(handle)%values(:, p), &
                                        model%surface%field(model%s%normal)%values(:, p), &
                                        model%scene%grid_origin, model%scene%grid_spacing)
  end function lies_on_nodes

  subroutine find_filling(model)
    !! Factors by which undeformed particles fill their cells; they keep them. Collective.
    type(model_t), intent(inout) :: model

    associate (n => model%particles%count, &
               volume => model%particles%field(model%p%reference_volume)%values)
      if (allocated(model%skeleton%filling)) deallocate (model%skeleton%filling)
      allocate (model%skeleton%filling(n), source=1.0_wp)
      if (.not. model%skeleton%centred) return
      call model%mesh%quadrature%weigh(model%comm, model%grid, n, model%mesh%cell, volume, &
                                       model%skeleton%filling)
      model%skeleton%filling = model%skeleton%filling/volume(1, 1:n)
    end associate
  end subroutine find_filling

  subroutine refresh_weights(model)
    !! Weights of the particles in integrals and cell means. Collective.
    type(model_t), intent(inout) :: model

    associate (n => model%particles%count, &
               volume => model%particles%field(model%p%volume)%values)
      if (model%finite) then
        model%mesh%weight = model%skeleton%filling*volume(1, 1:n)
      else if (model%skeleton%centred) then
        call model%mesh%quadrature%weigh(model%comm, model%grid, n, model%mesh%cell, volume, &
                                         model%mesh%weight)
      else
        model%mesh%weight = volume(1, 1:n)
      end if
      call set_water_weights()
      if (model%skeleton%outer_pressure%acts) model%skeleton%pressed_volume = volume(1, 1:n)
      if (model%skeleton%averaged .or. model%coupled) then
        call set_average(model%mesh%quadrature%group)
      end if
    end associate

  contains

    subroutine set_water_weights()
      !! In small strains means of the water are those of the cells' centroids.
      real(wp) :: centre(ndim, model%grid%n_cell)

      if (.not. model%coupled) return
      model%mesh%water_weight = model%mesh%weight
      if (.not. (model%skeleton%centred .and. model%mesh%quadrature%exact)) return
      if (model%finite .or. model%rigid) return
      call model%mesh%quadrature%find_centres(model%grid, centre)
      call centre_weights(model%comm, model%grid, model%particles%count, model%mesh%cell, &
                          model%particles%field(model%p%position)%values, centre, &
                          model%mesh%water_weight)
    end subroutine set_water_weights

    subroutine set_average(group)
      !! Weights of cells, and of groups where there are any.
      integer, allocatable, intent(in) :: group(:)

      if (model%skeleton%centred .and. model%mesh%quadrature%has_groups) then
        call model%mesh%average%set_weights(model%comm, model%grid, model%particles%count, &
                                            model%mesh%cell, &
                                            model%mesh%weight, group)
      else
        call model%mesh%average%set_weights(model%comm, model%grid, model%particles%count, &
                                            model%mesh%cell, &
                                            model%mesh%weight)
      end if
    end subroutine set_average
  end subroutine refresh_weights

  subroutine choose_imposition(model, handle)
    !! Conditions of motion go to nodes where the surface lies on a plane of nodes, to
    !! penalty walls elsewhere.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle   !! positions of the surface points
    integer :: surface(size(model%scene%mechanical_condition)), p, c, m
    logical :: fitted

    m = model%surface%count
    do c = 1, size(surface)
      surface(c) = index_of(model%scene, model%scene%mechanical_condition(c)%surface)
    end do
    if (allocated(model%skeleton%on_nodes)) deallocate (model%skeleton%on_nodes, &
                                                        model%skeleton%by_force)
    allocate (model%skeleton%on_nodes(size(model%scene%mechanical_condition), m), source=.false.)
    allocate (model%skeleton%by_force(size(model%scene%mechanical_condition), m), source=.false.)
    do p = 1, m
      fitted = lies_on_nodes(model, handle, p)
      do c = 1, size(model%scene%mechanical_condition)
        associate (condition => model%scene%mechanical_condition(c))
          if (.not. set_holds(model%surface%field(model%s%surface)%values(:, p), surface(c))) cycle
          if (condition%is_load()) then
            model%skeleton%by_force(c, p) = .true.
          else
            model%skeleton%on_nodes(c, p) = condition%imposition == 'nodes' .or. &
                                            (condition%imposition == 'auto' .and. fitted)
            model%skeleton%by_force(c, p) = .not. model%skeleton%on_nodes(c, p)
          end if
        end associate
      end do
    end do
  end subroutine choose_imposition

  subroutine build_water(model, handle)
    !! Ghosts, neighbourhoods, stencils and storage of the water.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle   !! positions that the geometry is built from
    integer, allocatable :: row_start(:), neighbour(:), point_start(:), point_neighbour(:)
    integer, allocatable :: patch(:), barrier(:)
    logical, allocatable :: has_head(:)
    real(wp), allocatable :: soil(:), point_soil(:)
    real(wp) :: radius
    integer :: n, n_local, m, m_local, surface_handle

    n = model%particles%count
    m = model%surface%count
    surface_handle = model%s%water_position
    radius = model%scene%water%support_radius*model%scales%spacing
    call follow_porosity(model)
    call model%water%head_operator%clear()
    call find_ghosts(model%comm, model%surface, surface_handle, n, &
                     model%particles%field(handle)%values(:, 1:n), radius, model%water%surface_map)
    call find_ghosts(model%comm, model%particles, handle, n, &
                     model%particles%field(handle)%values(:, 1:n), radius, model%water%particle_map)
    n_local = n + model%particles%ghost_count
    m_local = m + model%surface%ghost_count
    call set_all_elevations(model, n_local)
    associate (x => model%particles%field(handle)%values, &
               k => model%particles%field(model%p%conductivity)%values, &
               xs => model%surface%field(surface_handle)%values, field => model%surface%field)
      call build_neighbours(n, x(:, 1:n), n_local, x(:, 1:n_local), radius, row_start, neighbour, &
                            skip_self=.true.)
      call build_neighbours(n, x(:, 1:n), m_local, xs(:, 1:m_local), radius, point_start, &
                            point_neighbour, skip_self=.false.)
      if (allocated(model%water%barrier)) then
        barrier = nint(max(-field(model%s%surface)%values(1, 1:m_local), 0.0_wp))
        call cut_neighbours(model%water%barrier, x(:, 1:n), x(:, 1:n_local), row_start, neighbour)
        call cut_points(model%water%barrier, barrier, x(:, 1:n), xs(:, 1:m_local), &
                        field(model%s%normal)%values(:, 1:m_local), point_start, point_neighbour)
      end if
      patch = nint(field(model%s%patch)%values(1, 1:m_local))
      allocate (has_head(m_local), source=.false.)
      if (model%water%switching) has_head = field(model%s%has_head)%values(1, 1:m_local) > 0.5_wp
      call model%water%hydraulic_conditions%init(model%scene%hydraulic_condition, &
                                                 model%water%condition_surface, m_local, &
                                              field(model%s%surface)%values(:, 1:m_local), has_head)
      call set_surface_data(model, model%clock%time)
      if (model%scene%water%operator == 'two_pass') then
        call model%water%two_pass%build(n, x(:, 1:n_local), &
                                        k(1, 1:n_local), &
                                        row_start, neighbour, model%scales%spacing, &
                                        model%scene%water%support_radius, xs(:, 1:m_local), &
                                        field(model%s%normal)%values(:, 1:m_local), patch, &
                                  model%water%hydraulic_conditions%kind == kind_head, point_start, &
                                        point_neighbour)
      end if
      call model%water%head_operator%build(n, n_local, x(:, 1:n_local), k(1, 1:n_local), &
                                           row_start, neighbour, model%scales%spacing, &
                                      model%scene%water%support_radius, m_local, xs(:, 1:m_local), &
                                           field(model%s%normal)%values(:, 1:m_local), patch, &
                                           model%water%hydraulic_conditions%kind, point_start, &
                                           point_neighbour)
      call soil_conductivities(model, soil, point_soil)
      call model%water%surface_flux%build(model%comm, model%water%head_operator, x(:, 1:n_local), &
                                          k(1, 1:n_local), soil, model%scales%spacing, &
                                        model%scene%water%support_radius, model%water%surface_map, &
                                     xs(:, 1:m_local), field(model%s%normal)%values(:, 1:m_local), &
                                          point_soil, model%water%hydraulic_conditions%kind, &
                                          model%water%hydraulic_conditions%kind == kind_head .or. &
                                         model%water%hydraulic_conditions%may_switch, point_start, &
                                          point_neighbour)
    end associate
    model%water%largest_row_sum = model%comm%maximum(model%water%head_operator%largest_row_sum())
    call refresh_storage(model)
  end subroutine build_water

  subroutine follow_porosity(model)
    !! Conductivities of soils with Kozeny and Carman's law: k ~ n^3/(1 - n)^2.
    type(model_t), intent(inout) :: model
    real(wp) :: first, factor
    integer :: p

    if (all(model%scene%material%conductivity_law /= 'kozeny_carman')) return
    associate (porosity => model%particles%field(model%p%porosity)%values, &
               conductivity => model%particles%field(model%p%conductivity)%values)
      do p = 1, model%particles%count
        associate (material => model%scene%material(model%material(p)))
          if (material%conductivity_law /= 'kozeny_carman') cycle
          first = material%porosity%constant
          factor = (porosity(1, p)/first)**3*((1.0_wp - first)/(1.0_wp - porosity(1, p)))**2
          conductivity(1, p) = material%hydraulic_conductivity%constant*factor
        end associate
      end do
    end associate
  end subroutine follow_porosity

  subroutine set_all_elevations(model, n_local)
    !! Elevations of owned particles (ghosts get whole heads from their owners).
    type(model_t), intent(inout) :: model
    integer, intent(in) :: n_local
    integer :: p, handle

    handle = model%p%current_position
    if (allocated(model%water%head)) deallocate (model%water%head, model%water%elevation)
    allocate (model%water%head(n_local), model%water%elevation(n_local), source=0.0_wp)
    do p = 1, model%particles%count
      model%water%elevation(p) = -model%scene%water%density* &
                                 dot_product(model%scene%gravity, &
                                             model%particles%field(handle)%values(:, p))/ &
                                 model%scene%water%unit_weight
    end do
  end subroutine set_all_elevations

  subroutine refresh_storage(model)
    !! Storage coefficients of particles, cells and blocks, and the water's explicit limit. In
    !! updated scenes they follow porosities and the particles' cells, step by step. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: compressibility(:), softness(:), cells(:, :), blocks(:, :), sums(:)
    real(wp) :: tau_cell, tau_block, row_sum, modulus, least
    real(wp) :: bulk, shear
    logical :: plain   ! no projection
    integer :: n, p

    n = model%particles%count
    allocate (compressibility(n), softness(n))
    associate (pressure => model%particles%field(model%p%pore_pressure)%values)
      compressibility = compressibility_at(model, pressure(1, 1:n))
    end associate
    model%scales%stiffest_now = 0.0_wp
    do p = 1, n
      modulus = 0.0_wp
      softness(p) = 0.0_wp
      if (.not. model%rigid) then
        call find_moduli_of(model, p, bulk, shear)
        modulus = bulk + 4.0_wp*shear/3.0_wp
        softness(p) = 1.0_wp/modulus
      end if
      if (model%updated) then
        model%scales%stiffest_now = max(model%scales%stiffest_now, &
                                        modulus + 1.0_wp/compressibility(p))
      end if
    end do
    if (model%updated) model%scales%stiffest_now = model%comm%maximum(model%scales%stiffest_now)
    allocate (cells(1, model%grid%n_cell), blocks(1, model%grid%n_block))
    plain = model%rigid .or. model%scene%water%operator == 'two_pass'   ! it holds heads afterwards
    tau_cell = merge(0.0_wp, model%scene%water%cell_storage, plain)
    tau_block = merge(0.0_wp, model%scene%water%block_storage, plain)
    allocate (sums(model%grid%n_cell))
    call means(compressibility, cells, blocks)
    associate (cell_a => cells(1, :), block_a => blocks(1, :))
      block
        real(wp), allocatable :: cell_s(:, :), block_s(:, :)
        cell_s = cells
        block_s = blocks
        call means(softness, cell_s, block_s)
        call model%water%storage%init(tau_cell, tau_block, compressibility, cell_a, cell_s(1, :), &
                                      block_a, block_s(1, :))
      end block
    end associate
    least = 1.0_wp
    if (n > 0) least = minval(compressibility)
    least = model%comm%minimum(least)
    row_sum = max(model%water%largest_row_sum, tiny(1.0_wp)*1.0e9_wp)
    model%water%diffusion_limit = 2.0_wp*model%scene%water%unit_weight*least/row_sum

  contains

    subroutine means(values, cell_means, block_means)
      !! Volume-weighted means over cells or their groups, and over blocks.
      real(wp), intent(in) :: values(:)
      real(wp), intent(inout) :: cell_means(:, :), block_means(:, :)

      call cell_sums(n, model%mesh%cell, model%mesh%water_weight, values, model%grid%n_cell, sums)
      call model%mesh%average%block_means(model%comm, model%grid, 1, sums, block_means)
      call model%mesh%average%group_means(model%comm, model%grid, 1, sums)
      cell_means(1, :) = sums
    end subroutine means
  end subroutine refresh_storage

  logical function needs_rebuild(model) result(needed)
    !! Has a particle moved so far since the last build that the geometry is stale? Collective.
    !!
    !! The way is bounded by the sum of the steps' largest nodal velocities, so that most steps
    !! need no look at the particles.
    type(model_t), intent(inout) :: model
    real(wp) :: fastest, limit

    needed = .false.
    if (.not. model%updated) return
    if (model%traits%solves_water) then
      needed = .true.   ! its equations want every cell whole on one rank
      return
    end if
    fastest = 0.0_wp
    if (model%grid%n_node > 0) fastest = sqrt(maxval(sum(model%skeleton%velocity**2, dim=1)))
    model%decomposition%movement = model%decomposition%movement + &
                                   model%clock%dt*model%comm%maximum(fastest)
    limit = model%scene%water%rebuild_displacement*model%scales%spacing
    needed = .not. model%decomposition%movement < limit
  end function needs_rebuild
end module dosui_topology

!! The balance of forces on the bodies: reactions of walls against loads, weight and inertia.
!!
!! The parts are booked where an integrator makes them, in steps that get a row of the histories
!! only (`reactions_t%is_wanted`):
!!
!! * tractions, penalty walls and absorbing surfaces: the forces that they put on the nodes;
!! * walls and plates on nodes: what their nodes' inertia takes beside all other forces there, or
!!   without inertia what is left over there;
!! * rigid walls: the momentum that they give to nodes, over the step.
!!
!! Stresses and pore pressures are inner forces: their sum is zero, so that loads, weight and walls
!! must make up the particles' change of momentum. What is missing shows an error.
module dosui_force_balance
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_cut_weight, only: add_wall, find_group_centres
  use dosui_extended_nodes, only: inertia_forces
  use dosui_model, only: model_t
  use dosui_reactions, only: moment_axis, n_moment, n_total, of_damping, of_inertia, &
                             of_light_nodes, of_loads, of_shaking, of_sources, of_weight
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private

  real(wp), parameter :: round_off = 1.0e-13_wp   !! of all forces, and of momenta over the step [-]

  public :: want_forces, begin_forces, book_sources, book_surface_forces, book_loads, &
            book_reactions, book_wall_shifts, keep_undamped, book_rigid_wall, &
            book_held_by_walls, close_step, close_rest, force_row

contains

  subroutine want_forces(model)
    !! Before a step: are its forces wanted?
    type(model_t), intent(inout) :: model

    call model%reactions%want(model%clock%time + model%clock%dt, model%clock%dt, &
                              int(model%clock%step, i8) + 1_i8)
  end subroutine want_forces

  subroutine begin_forces(model, gravity, shaking)
    !! Begins a sum, before forces go to the nodes. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: gravity(ndim)   !! [m/s2]
    real(wp), intent(in) :: shaking(ndim)   !! of the base [m/s2]

    call model%reactions%clear(model%grid%n_node)
    model%reactions%gravity = gravity
    model%reactions%shaking = -shaking
    model%reactions%momentum = momentum_of(model)
    call find_centres(model)
  end subroutine begin_forces

  pure function momentum_of(model) result(momentum)
    !! Momentum of this rank's particles [kg m/s].
    type(model_t), intent(in) :: model
    real(wp) :: momentum(ndim)
    integer :: p

    momentum = 0.0_wp
    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        momentum = momentum + field(h%mass)%values(1, p)*field(h%velocity)%values(:, p)
      end do
    end associate
  end function momentum_of

  pure real(wp) function sum_of_momenta(model) result(total)
    !! Sum of the magnitudes of the particles' momenta [kg m/s].
    type(model_t), intent(in) :: model
    integer :: p

    total = 0.0_wp
    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        total = total + field(h%mass)%values(1, p)*norm2(field(h%velocity)%values(:, p))
      end do
    end associate
  end function sum_of_momenta

  subroutine find_centres(model)
    !! Centres of the surfaces that hold, where their points were at the start. Collective.
    type(model_t), intent(inout) :: model
    real(wp) :: sums((1 + ndim)*model%reactions%n_surface), place(ndim), area
    logical :: has(model%reactions%n_surface)
    integer :: c, k, p, slot

    sums = 0.0_wp
    associate (field => model%surface%field, h => model%s, walls => model%reactions)
      do p = 1, model%surface%count
        has = .false.
        do c = 1, size(walls%wall_of)
          if (walls%wall_of(c) == 0) cycle
          if (model%skeleton%on_nodes(c, p) .or. &
              model%skeleton%by_force(c, p)) has(walls%wall_of(c)) = .true.
        end do
        if (.not. any(has)) cycle
        place = field(h%position)%values(:, p) - model%scene%grid_origin
        if (model%updated) place = place - field(h%displacement)%values(:, p)
        area = field(h%area)%values(1, p)
        if (model%finite) area = norm2(field(h%reference_area)%values(:, p))
        do k = 1, size(has)
          if (.not. has(k)) cycle
          slot = (1 + ndim)*(k - 1) + 1
          sums(slot) = sums(slot) + area
          sums(slot + 1:slot + ndim) = sums(slot + 1:slot + ndim) + area*place
        end do
      end do
      call model%comm%sum_array(sums)
      do k = 1, size(has)
        slot = (1 + ndim)*(k - 1) + 1
        if (.not. sums(slot) > 0.0_wp) cycle
        walls%centre(:, k) = model%scene%grid_origin + sums(slot + 1:slot + ndim)/sums(slot)
      end do
    end associate
  end subroutine find_centres

  subroutine book_sources(model, force)
    !! Body forces by formulas.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: force(:, :)   !! (ndim, n_node) of this rank's particles [N]

    call model%reactions%add_nodes(0, of_sources, force, force)
  end subroutine book_sources

  subroutine book_surface_forces(model, place_field)
    !! Loads, penalty walls and absorbing surfaces. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: place_field   !! the positions that patterns are taken at
    real(wp), allocatable :: force(:, :), place(:, :)
    integer :: c

    if (.not. model%comm%any(any(model%skeleton%by_force))) return
    call node_places(model, place)
    allocate (force(ndim, model%grid%n_node))
    do c = 1, size(model%scene%mechanical_condition)
      force = 0.0_wp
      associate (field => model%surface%field, h => model%s, n => model%surface%count)
        call model%skeleton%surface_forces%apply(model%comm, model%scene%mechanical_condition, &
                                                 model%clock%time, field(h%area)%values(1, 1:n), &
                                                 field(place_field)%values(:, 1:n), &
                                                 field(h%normal)%values(:, 1:n), &
                                                 field(h%displacement)%values(:, 1:n), &
                                                 field(h%velocity)%values(:, 1:n), force, only=c)
      end associate
      call model%reactions%add_nodes(model%reactions%wall_of(c), of_loads, place, force)
    end do
  end subroutine book_surface_forces

  subroutine book_loads(model, force)
    !! Loads that reach the nodes by another way. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: force(:, :)   !! (ndim, n_node) this rank's part [N]
    real(wp), allocatable :: whole(:, :)
    integer :: i

    whole = force
    call model%grid%node_map%scatter_add(model%comm, ndim, whole)
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) whole(:, i) = 0.0_wp
    end do
    call model%reactions%add_nodes(0, of_loads, whole, whole)
  end subroutine book_loads

  subroutine book_reactions(model, stress)
    !! The part of penalty walls that the stress in their cells makes. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: stress(:, :)   !! (nsig, n_cell) total [Pa]
    real(wp), allocatable :: force(:, :), place(:, :)
    integer :: c

    call node_places(model, place)
    allocate (force(ndim, model%grid%n_node))
    do c = 1, size(model%scene%mechanical_condition)
      if (model%reactions%wall_of(c) == 0) cycle
      force = 0.0_wp
      associate (field => model%surface%field, h => model%s, m => model%surface%count)
        call model%skeleton%surface_forces%react(field(h%area)%values(1, 1:m), &
                                              field(h%normal)%values(:, 1:m), stress, force, only=c)
      end associate
      call model%reactions%add_nodes(model%reactions%wall_of(c), 0, place, force)
    end do
  end subroutine book_reactions

  subroutine book_wall_shifts(model)
    !! The part of penalty walls that is constant where surfaces cut cells (`dosui_cut_weight`).
    !! Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: force(:, :), place(:, :)
    real(wp) :: centre(ndim, model%grid%n_cell)
    integer :: c

    if (.not. model%skeleton%lifted .or. model%finite) return
    call node_places(model, place)
    call find_group_centres(model, centre)
    allocate (force(ndim, model%grid%n_node))
    do c = 1, size(model%scene%mechanical_condition)
      if (model%reactions%wall_of(c) == 0) cycle
      force = 0.0_wp
      call add_wall(model, c, centre, force)
      call model%reactions%add_nodes(model%reactions%wall_of(c), 0, place, force)
    end do
  end subroutine book_wall_shifts

  subroutine node_places(model, place)
    !! Where the nodes are [m]. With finite strains they move as the surface's points around them
    !! have. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: place(:, :)
    real(wp), allocatable :: moved(:, :)
    real(wp) :: share
    integer :: i, k, node, p

    allocate (place(ndim, model%grid%n_node))
    do i = 1, model%grid%n_node
      place(:, i) = model%grid%origin + model%grid%spacing*model%grid%node_index(:, i)
    end do
    if (.not. model%finite) return
    allocate (moved(1 + ndim, model%grid%n_node), source=0.0_wp)
    associate (spread => model%skeleton%surface_forces, displacement => model%s%displacement)
      do p = 1, model%surface%count
        do k = 1, spread%n_part
          do i = 1, size(spread%node, 1)
            node = spread%node(i, k, p)
            if (node == 0) cycle
            share = spread%weight(i, k, p)*norm2(model%surface%field(model%s%reference_area)% &
                                                 values(:, p))
            moved(:, node) = moved(:, node) + share* &
                             [1.0_wp, model%surface%field(displacement)%values(:, p)]
          end do
        end do
      end do
    end associate
    call model%grid%node_map%sum_copies(model%comm, 1 + ndim, moved)
    do i = 1, model%grid%n_node
      if (moved(1, i) > 0.0_wp) place(:, i) = place(:, i) + moved(2:, i)/moved(1, i)
    end do
  end subroutine node_places

  subroutine keep_undamped(model)
    !! Complete nodal forces before damping.
    type(model_t), intent(inout) :: model

    model%reactions%undamped = model%skeleton%nodal(2 + ndim:, :)
  end subroutine keep_undamped

  subroutine book_rigid_wall(model, wall, dt, before)
    !! The force that changed nodal velocities at a rigid wall.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: wall            !! number of the rigid wall
    real(wp), intent(in) :: dt             !! [s]
    real(wp), intent(in) :: before(:, :)   !! (ndim, n_node) velocities without it [m/s]
    real(wp) :: force(ndim)
    integer :: i

    associate (reactions => model%reactions)
      do i = 1, model%grid%n_node
        if (.not. model%grid%node_map%is_owned(i)) cycle
        force = max(model%skeleton%nodal(1, i), &
                    model%skeleton%inertia(i))*(model%skeleton%velocity(:, i) - before(:, i))/dt
        if (.not. any(abs(force) > 0.0_wp)) cycle
        call reactions%add(reactions%n_surface + wall, place_of(model, i), force)
        reactions%by_walls(:, i) = reactions%by_walls(:, i) + force
      end do
    end associate
  end subroutine book_rigid_wall

  subroutine book_held_by_walls(model, push)
    !! What rigid walls take of forces on components that they hold.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: push(:, :)     !! (ndim, n_node) [N]
    real(wp) :: force(ndim)
    integer :: a, i

    associate (reactions => model%reactions)
      do i = 1, model%grid%n_node
        if (.not. model%grid%node_map%is_owned(i)) cycle
        do a = 1, ndim
          if (reactions%holder(a, i) == 0) cycle
          force = 0.0_wp
          force(a) = -push(a, i)
          call reactions%add(reactions%n_surface + reactions%holder(a, i), place_of(model, i), &
                             force)
          reactions%by_walls(a, i) = reactions%by_walls(a, i) + force(a)
        end do
      end do
    end associate
  end subroutine book_held_by_walls

  pure function place_of(model, node) result(place)
    !! Where a node of the grid is [m].
    type(model_t), intent(in) :: model
    integer, intent(in) :: node
    real(wp) :: place(ndim)

    place = model%grid%origin + model%grid%spacing*model%grid%node_index(:, node)
  end function place_of

  subroutine close_step(model, dt, flip, least_mass, push, at_start)
    !! Reactions on nodes, damping and inertia of a step whose nodal velocities are final and
    !! whose particles have got theirs. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: dt                         !! [s]
    real(wp), intent(in) :: flip                       !! share of FLIP in the particles' [-]
    real(wp), intent(in) :: least_mass                 !! of nodes that forces move [kg]
    real(wp), intent(in), optional :: push(:, :)       !! forces that came later [N]
    logical, intent(in), optional :: at_start          !! particles have not moved yet
    real(wp), dimension(ndim) :: undamped, force, inertia, rest, more
    integer :: holder(ndim, model%grid%n_node)
    real(wp) :: share(model%grid%n_node)    ! of FLIP in the particles' momentum [-]
    real(wp) :: inverse, carried   ! mass in the particles' momentum [kg]
    real(wp), allocatable :: change(:, :)   ! of momenta, where nodes follow others
    real(wp), allocatable :: later(:, :)    ! `push` there
    integer :: a, c, i
    logical :: is_held

    call model%skeleton%nodal_conditions%holders(holder)
    share = flip
    if (allocated(model%skeleton%node_share)) share = model%skeleton%node_share
    if (model%mesh%extension%is_on) then
      change = (model%skeleton%velocity - spread(share, 1, ndim)*model%skeleton%velocity_old)/dt
      call inertia_forces(model, holder > 0, change)
      change = change - spread((1.0_wp - share)/dt, 1, ndim)*model%skeleton%nodal(2:1 + ndim, :)
      if (present(push)) then
        later = push
        call model%mesh%extension%fold(model%comm, model%grid, ndim, later, holder > 0)
      end if
    end if
    associate (reactions => model%reactions, total => model%reactions%total)
      call add_weight(model)
      total(:, of_inertia) = (momentum_of(model) - reactions%momentum)/dt
      if (.not. present(at_start)) reactions%noise = sum_of_momenta(model)/dt
      do i = 1, model%grid%n_node
        if (.not. model%grid%node_map%is_owned(i)) cycle
        force = model%skeleton%nodal(2 + ndim:, i)
        undamped = force
        if (allocated(reactions%undamped)) undamped = reactions%undamped(:, i)
        more = 0.0_wp
        if (present(push)) more = push(:, i)
        if (allocated(later)) more = later(:, i)
        if (allocated(reactions%by_walls)) more = more + reactions%by_walls(:, i)
        inverse = 0.0_wp
        if (model%skeleton%nodal(1, i) > tiny(1.0_wp)*1.0e20_wp) inverse = &
          1.0_wp/model%skeleton%nodal(1, i)
        inertia = (model%skeleton%velocity(:, i) - share(i)*model%skeleton%velocity_old(:, i) - &
                   (1.0_wp - share(i))*model%skeleton%nodal(2:1 + ndim, i)*inverse)/dt
        carried = model%skeleton%nodal(1, i)
        if (present(at_start)) carried = 0.0_wp
        if (allocated(change)) then
          inertia = change(:, i)
          if (present(at_start)) total(:, of_inertia) = total(:, of_inertia) + inertia
        else
          total(:, of_inertia) = total(:, of_inertia) + &
                                 (max(model%skeleton%nodal(1, i), &
                                      model%skeleton%inertia(i)) - carried)*inertia
          inertia = max(model%skeleton%nodal(1, i), model%skeleton%inertia(i))*inertia
        end if
        reactions%gross = reactions%gross + norm2(inertia)
        do a = 1, ndim
          is_held = holder(a, i) > 0
          if (is_held) then   ! nodes that do not move are not damped; those of plates may move
            if (.not. model%skeleton%nodal_conditions%plate(holder(a, i))) force(a) = undamped(a)
          end if
          rest = 0.0_wp
          rest(a) = inertia(a) - force(a) - more(a)
          if (is_held) then
            c = model%skeleton%nodal_conditions%condition(holder(a, i))
            call reactions%add(reactions%wall_of(c), place_of(model, i), rest)
          else if (.not. model%skeleton%nodal(1, i) > least_mass) then
            total(:, of_light_nodes) = total(:, of_light_nodes) + rest
            reactions%gross = reactions%gross + abs(rest(a))
          end if
        end do
        total(:, of_damping) = total(:, of_damping) + force - undamped
        reactions%gross = reactions%gross + norm2(force - undamped)
      end do
      call end_sum(model)
    end associate
  end subroutine close_step

  subroutine close_rest(model, force)
    !! Reactions on nodes of a body without inertia, from all other nodal forces. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: force(:, :)   !! (ndim, n_node) complete [N]
    integer :: holder(ndim, model%grid%n_node)
    real(wp), allocatable :: place(:, :)
    real(wp) :: rest(ndim)
    integer :: a, c, i

    call model%skeleton%nodal_conditions%holders(holder)
    call add_weight(model)
    call node_places(model, place)
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      do a = 1, ndim
        if (holder(a, i) == 0) cycle
        rest = 0.0_wp
        rest(a) = -force(a, i)
        c = model%skeleton%nodal_conditions%condition(holder(a, i))
        call model%reactions%add(model%reactions%wall_of(c), place(:, i), rest)
      end do
    end do
    call end_sum(model)
  end subroutine close_rest

  subroutine add_weight(model)
    !! Weight, and what the base's motion makes of the masses.
    type(model_t), intent(inout) :: model
    real(wp) :: mass
    integer :: p

    mass = 0.0_wp
    do p = 1, model%particles%count
      mass = mass + model%particles%field(model%p%mass)%values(1, p)
    end do
    associate (reactions => model%reactions)
      reactions%total(:, of_weight) = mass*reactions%gravity
      reactions%total(:, of_shaking) = mass*reactions%shaking
      reactions%gross = reactions%gross + mass*(norm2(reactions%gravity) + &
                                                norm2(reactions%shaking))
    end associate
  end subroutine add_weight

  subroutine end_sum(model)
    !! The sum waits for its row.
    type(model_t), intent(inout) :: model

    model%reactions%is_wanted = .false.
    model%reactions%is_known = .true.
    if (allocated(model%reactions%undamped)) deallocate (model%reactions%undamped)
  end subroutine end_sum

  function force_row(model) result(row)
    !! Forces and moments of every wall, and what is missing in the balance, for the histories;
    !! keeps the balance for the closing summary [units of the columns]. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: row(:)
    real(wp), allocatable :: sums(:)
    real(wp) :: missing
    integer :: k, n

    n = model%reactions%n
    allocate (row(0))
    if (n == 0) return
    associate (reactions => model%reactions)
      if (.not. model%comm%all(reactions%is_known)) then
        row = [(ieee_value(1.0_wp, ieee_quiet_nan), k=1, reactions%n_column())]
        return
      end if
      sums = [reactions%force, reactions%moment, reactions%total, reactions%noise, reactions%gross]
      call model%comm%sum_array(sums)
      reactions%row_total(:, :n_total) = reshape(sums(n*(ndim + 3) + 1:size(sums) - 2), &
                                                 [ndim, n_total])
      reactions%row_total(:, n_total + 1) = sum(reshape(sums(:ndim*n), [ndim, n]), dim=2)
      missing = norm2(sum(reactions%row_total, dim=2) - &
                      2.0_wp*reactions%row_total(:, of_inertia))
      reactions%row_error = 0.0_wp
      associate (noise => sums(size(sums) - 1), gross => sums(size(sums)))
        if (missing > round_off*(gross + noise)) reactions%row_error = missing/gross
      end associate
      reactions%row_time = model%clock%time
      reactions%largest_error = max(reactions%largest_error, reactions%row_error)
      reactions%is_known = .false.
      do k = 1, n
        row = [row, sums(ndim*(k - 1) + 1:ndim*k), &
               sums(ndim*n + 3*(k - 1) + moment_axis(:n_moment))]
      end do
      row = [row, reactions%row_error]
    end associate
  end function force_row
end module dosui_force_balance

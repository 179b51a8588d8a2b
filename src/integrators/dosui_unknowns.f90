!! The unknowns of implicit steps: displacements of free nodes and pressures of particles, numbered
!! over all ranks, with the conditions of motion built in.
!!
!! Held and empty nodes keep a row of their own with a one on the diagonal. The nodes of a rigid
!! plate share one unknown, the row of the first of them. Components of nodes that follow others
!! (`dosui_nodal_extension`) are sums of unknowns, unless a condition holds them: conditions win.
module dosui_unknowns
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_model, only: model_t
  implicit none
  private

  integer, parameter :: no_row = -1

  type, public :: unknowns_t
    integer :: n_u = 0, n_p = 0             !! rows of this rank
    integer :: n_moving = 0                 !! of n_u: unknowns, not empty, held or following
    integer, allocatable :: own_row(:, :)   !! (ndim, n_node) row of a component, from 0
    integer, allocatable :: row(:, :)       !! likewise: the unknown it follows, -1: none
    real(wp), allocatable :: sign(:, :)     !! likewise: component = sign*unknown [-]
    logical, allocatable :: is_held(:, :)   !! likewise: by a condition of motion
    integer, allocatable :: own_node(:)     !! owned nodes in the order of rows
    integer, allocatable :: particle_row(:) !! of owned and ghost particles, from 0
    integer, allocatable :: plate_row(:)    !! (plates) shared unknown, -1: no node
    logical :: extends = .false.            !! components follow several unknowns, on any rank
    logical, allocatable :: follows(:, :)   !! (ndim, n_node) with `extends`: such components
    integer, allocatable :: start(:)   !! (ndim*n_node + 1) likewise: unknowns of each component ...
    integer, allocatable :: source(:)  !! ... from 0
    real(wp), allocatable :: share(:)  !! ... component = sum of share*unknown [-]
    logical, allocatable, private :: plate_is_mine(:)   !! its row is this rank's
  contains
    procedure :: build => unknowns_build
    procedure :: to_rows => unknowns_to_rows
    procedure :: to_nodes => unknowns_to_nodes
    procedure :: to_unknowns => unknowns_to_unknowns
    procedure :: prescribe => unknowns_prescribe
    procedure :: fold => unknowns_fold
    procedure :: expand => unknowns_expand
    procedure :: reduce => unknowns_reduce
    procedure, private :: follow
    procedure, private :: number_nodes
    procedure, private :: number_plates
  end type unknowns_t

contains

  subroutine unknowns_build(self, model, is_empty)
    !! Numbers everything for the geometry at hand. Collective.
    class(unknowns_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_empty(:, :)   !! (ndim, n_node) no stiffness holds this component
    integer(i8) :: first
    real(wp), allocatable :: number(:)
    integer :: p, n

    n = model%particles%count
    self%n_p = 0
    if (model%coupled) then
      self%n_p = n
      first = model%comm%prefix_sum(int(n, i8))
      allocate (number(n + model%particles%ghost_count))
      do p = 1, n
        number(p) = real(first + p - 1, wp)   ! exact below 2**53
      end do
      call model%water%particle_map%gather(model%comm, 1, number)
      self%particle_row = nint(number)
    end if
    self%n_u = 0
    self%n_moving = 0
    if (model%rigid) return
    call self%number_nodes(model)
    self%is_held = is_empty
    self%row = merge(no_row, self%own_row, is_empty)
    self%sign = merge(0.0_wp, 1.0_wp, is_empty)
    call self%number_plates(model)
    self%extends = model%mesh%extension%is_on
    if (self%extends) call self%follow(model)
    self%n_moving = count(self%row(:, self%own_node) == self%own_row(:, self%own_node))
  end subroutine unknowns_build

  subroutine follow(self, model)
    !! The unknowns that components of nodes follow. Collective.
    class(unknowns_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: strip(:, :)   ! rows and signs of the sources' components
    logical, allocatable :: is_constrained(:, :)
    integer :: a, k, i, n, r, s, pass

    associate (extension => model%mesh%extension)
      allocate (is_constrained(ndim, model%grid%n_node), source=.false.)
      associate (set => model%skeleton%nodal_conditions)
        do k = 1, set%n_constraint
          is_constrained(set%direction(k), set%node(k)) = .true.
        end do
      end associate
      self%follows = spread(extension%follows, 1, ndim) .and. .not. is_constrained
      where (self%follows)
        self%row = no_row
        self%sign = 0.0_wp
        self%is_held = .false.
      end where
      allocate (strip(2*ndim, extension%n_strip), source=0.0_wp)
      do s = 1, extension%n_strip
        if (extension%strip_node(s) == 0) cycle
        strip(:ndim, s) = real(self%row(:, extension%strip_node(s)), wp)
        strip(ndim + 1:, s) = self%sign(:, extension%strip_node(s))
      end do
      call extension%complete_strip(model%comm, 2*ndim, strip)
      if (allocated(self%start)) deallocate (self%start, self%source, self%share)
      allocate (self%start(ndim*model%grid%n_node + 1))
      do pass = 1, 2   ! counts, then fills
        n = 0
        do i = 1, model%grid%n_node
          r = extension%row_of(i)
          do a = 1, ndim
            if (pass == 1) self%start(ndim*(i - 1) + a) = n + 1
            if (self%follows(a, i)) then
              if (r == 0) cycle
              do k = extension%row_start(r), extension%row_start(r + 1) - 1
                s = extension%source(k)
                if (nint(strip(a, s)) == no_row) cycle
                n = n + 1
                if (pass == 1) cycle
                self%source(n) = nint(strip(a, s))
                self%share(n) = extension%weight(k)*strip(ndim + a, s)
              end do
            else if (self%row(a, i) /= no_row) then
              n = n + 1
              if (pass == 1) cycle
              self%source(n) = self%row(a, i)
              self%share(n) = self%sign(a, i)
            end if
          end do
        end do
        if (pass == 2) exit
        self%start(ndim*model%grid%n_node + 1) = n + 1
        allocate (self%source(n), self%share(n))
      end do
    end associate
  end subroutine follow

  pure subroutine unknowns_reduce(self, node, row, share)
    !! The unknowns of a list of nodes, and what each component has of them.
    class(unknowns_t), intent(in) :: self
    integer, intent(in) :: node(:)
    integer, allocatable, intent(out) :: row(:)          !! (n) from 0, -1: none
    real(wp), allocatable, intent(out) :: share(:, :)
    !! (n, ndim*nodes); not allocated if every component follows its own unknown, by its sign [-]
    integer :: k, i, a, n, place, column
    integer, allocatable :: longer(:)

    if (self%extends) then
      if (any(self%follows(:, node))) then
        n = 0
        do i = 1, size(node)
          n = n + self%start(ndim*node(i) + 1) - self%start(ndim*(node(i) - 1) + 1)
        end do
        allocate (longer(n), share(n, ndim*size(node)))
        share = 0.0_wp
        n = 0
        do i = 1, size(node)
          do a = 1, ndim
            column = ndim*(node(i) - 1) + a
            do k = self%start(column), self%start(column + 1) - 1
              place = findloc(longer(:n), self%source(k), dim=1)
              if (place == 0) then
                n = n + 1
                longer(n) = self%source(k)
                place = n
              end if
              share(place, ndim*(i - 1) + a) = share(place, ndim*(i - 1) + a) + self%share(k)
            end do
          end do
        end do
        row = longer(:n)
        share = share(:n, :)
        return
      end if
    end if
    row = reshape(self%row(:, node), [ndim*size(node)])
  end subroutine unknowns_reduce

  subroutine unknowns_fold(self, model, force)
    !! Complete nodal forces go to the nodes that others follow, and leave these nothing; conditions
    !! keep their own. Forces on held components are then the reactions. Collective.
    class(unknowns_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: force(:, :)   !! (ndim, n_node) [N]
    real(wp), allocatable :: folded(:, :)
    logical, allocatable :: keeps(:, :)

    if (.not. self%extends) return
    keeps = spread(model%mesh%extension%follows, 1, ndim) .and. .not. self%follows
    folded = merge(0.0_wp, force, keeps)
    call model%mesh%extension%fold(model%comm, model%grid, ndim, folded)
    force = merge(force, folded, keeps)
  end subroutine unknowns_fold

  subroutine unknowns_expand(self, model, motion)
    !! Nodes that follow others move with them, but for components that conditions hold. Collective.
    class(unknowns_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: motion(:, :)   !! (ndim, n_node), complete elsewhere [m]
    real(wp), allocatable :: expanded(:, :)

    if (.not. self%extends) return
    expanded = motion
    call model%mesh%extension%expand(model%comm, model%grid, ndim, expanded)
    motion = merge(expanded, motion, self%follows)
  end subroutine unknowns_expand

  subroutine number_nodes(self, model)
    !! Rows of all nodes of this rank, ghosts too.
    class(unknowns_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: number(:)
    integer(i8) :: first
    integer :: k, a

    self%own_node = pack([(k, k=1, model%grid%n_node)], &
                         model%grid%node_map%is_owned(1:model%grid%n_node))
    self%n_u = ndim*size(self%own_node)
    first = model%comm%prefix_sum(int(size(self%own_node), i8))
    allocate (number(model%grid%n_node), source=0.0_wp)
    do k = 1, size(self%own_node)
      number(self%own_node(k)) = real(first + k - 1, wp)
    end do
    call model%grid%node_map%gather(model%comm, 1, number)
    if (allocated(self%own_row)) deallocate (self%own_row)
    allocate (self%own_row(ndim, model%grid%n_node))
    do k = 1, model%grid%n_node
      do a = 1, ndim
        self%own_row(a, k) = ndim*nint(number(k)) + a - 1
      end do
    end do
  end subroutine number_nodes

  subroutine number_plates(self, model)
    !! Held components, and the unknowns that plates share. Later conditions win.
    class(unknowns_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    integer :: k, slot, node, a

    associate (set => model%skeleton%nodal_conditions)
      if (allocated(self%plate_row)) deallocate (self%plate_row, self%plate_is_mine)
      allocate (self%plate_row(size(set%plate_condition)), source=huge(1))
      allocate (self%plate_is_mine(size(set%plate_condition)), source=.false.)
      do k = 1, set%n_constraint
        self%is_held(set%direction(k), set%node(k)) = .not. set%plate(k)
      end do
      ! a node that a later condition holds does not lend its row
      do k = 1, set%n_constraint
        node = set%node(k)
        a = set%direction(k)
        if (self%is_held(a, node) .or. .not. set%plate(k)) cycle
        if (self%row(a, node) == no_row) cycle
        slot = findloc(set%plate_condition, set%condition(k), dim=1)
        self%plate_row(slot) = min(self%plate_row(slot), self%own_row(a, node))
      end do
      do slot = 1, size(self%plate_row)
        self%plate_row(slot) = model%comm%minimum(self%plate_row(slot))
        if (self%plate_row(slot) == huge(1)) self%plate_row(slot) = no_row
      end do
      do k = 1, set%n_constraint
        node = set%node(k)
        a = set%direction(k)
        if (self%is_held(a, node)) then
          self%row(a, node) = no_row
          self%sign(a, node) = 0.0_wp
        else if (set%plate(k) .and. self%row(a, node) /= no_row) then
          slot = findloc(set%plate_condition, set%condition(k), dim=1)
          self%plate_is_mine(slot) = self%plate_is_mine(slot) .or. &
                                     (self%own_row(a, node) == self%plate_row(slot) .and. &
                                      model%grid%node_map%is_owned(node))
          self%row(a, node) = self%plate_row(slot)
          self%sign(a, node) = set%outward(k)   ! the shared unknown is the motion outward
        end if
      end do
    end associate
  end subroutine number_plates

  subroutine unknowns_to_rows(self, model, force, time, rows, without_loads)
    !! Right-hand side of this rank's displacement rows from complete nodal forces; plates add
    !! their own load. Collective.
    class(unknowns_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: force(:, :)    !! (ndim, n_node) [N]
    real(wp), intent(in) :: time           !! of the plates' loads [s]
    real(wp), intent(inout) :: rows(:)     !! (n_u) [N]
    logical, intent(in), optional :: without_loads   !! of the plates
    real(wp), allocatable :: plate(:), folded(:, :)
    real(wp) :: load
    integer :: k, a, node, slot, first

    rows(1:self%n_u) = 0.0_wp
    folded = force
    call self%fold(model, folded)
    allocate (plate(size(self%plate_row)), source=0.0_wp)
    do k = 1, size(self%own_node)
      node = self%own_node(k)
      do a = 1, ndim
        if (self%row(a, node) == no_row) cycle
        slot = findloc(self%plate_row, self%row(a, node), dim=1)
        if (slot > 0) then
          plate(slot) = plate(slot) + self%sign(a, node)*folded(a, node)
        else
          rows(ndim*(k - 1) + a) = folded(a, node)
        end if
      end do
    end do
    if (size(plate) == 0) return
    call model%comm%sum_array(plate)
    first = 0
    if (size(self%own_node) > 0) first = self%own_row(1, self%own_node(1))
    do slot = 1, size(plate)
      if (.not. self%plate_is_mine(slot)) cycle
      load = model%skeleton%nodal_conditions%wall( &
             model%skeleton%nodal_conditions%plate_condition(slot))%force(time)
      if (present(without_loads)) load = merge(0.0_wp, load, without_loads)
      rows(self%plate_row(slot) - first + 1) = plate(slot) - load
    end do
  end subroutine unknowns_to_rows

  subroutine unknowns_to_nodes(self, model, rows, motion)
    !! Nodal values of this rank's rows, on all nodes; held components keep what they have.
    !! Collective.
    class(unknowns_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: rows(:)            !! (n_u) [m or any unit of a motion]
    real(wp), intent(inout) :: motion(:, :)    !! (ndim, n_node) [unit of the rows]
    real(wp), allocatable :: plate(:)
    integer :: k, a, node, slot, first

    allocate (plate(size(self%plate_row)), source=0.0_wp)
    first = 0
    if (size(self%own_node) > 0) first = self%own_row(1, self%own_node(1))
    do slot = 1, size(plate)
      if (self%plate_is_mine(slot)) plate(slot) = rows(self%plate_row(slot) - first + 1)
    end do
    if (size(plate) > 0) call model%comm%sum_array(plate)
    do k = 1, size(self%own_node)
      node = self%own_node(k)
      do a = 1, ndim
        if (self%row(a, node) == no_row) cycle
        slot = findloc(self%plate_row, self%row(a, node), dim=1)
        if (slot > 0) then
          motion(a, node) = self%sign(a, node)*plate(slot)
        else
          motion(a, node) = rows(ndim*(k - 1) + a)
        end if
      end do
    end do
    call model%grid%node_map%gather(model%comm, ndim, motion)
    call self%expand(model, motion)
  end subroutine unknowns_to_nodes

  pure subroutine unknowns_to_unknowns(self, motion, rows)
    !! This rank's rows that stand for given nodal values; held components have none.
    class(unknowns_t), intent(in) :: self
    real(wp), intent(in) :: motion(:, :)    !! (ndim, n_node) [m or any unit of a motion]
    real(wp), intent(inout) :: rows(:)      !! (n_u) [unit of the motion]
    integer :: k, a, node

    do k = 1, size(self%own_node)
      node = self%own_node(k)
      do a = 1, ndim
        rows(ndim*(k - 1) + a) = 0.0_wp
        ! of a plate the node whose row it is
        if (self%row(a, node) == self%own_row(a, node)) then
          rows(ndim*(k - 1) + a) = self%sign(a, node)*motion(a, node)
        end if
      end do
    end do
  end subroutine unknowns_to_unknowns

  subroutine unknowns_prescribe(self, model, from, to, motion, any_motion)
    !! Displacements of held nodes between two times, and of those that follow them; zero elsewhere.
    !! Collective.
    class(unknowns_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: from, to         !! [s]
    real(wp), intent(out) :: motion(:, :)    !! (ndim, n_node) [m]
    logical, intent(out) :: any_motion       !! on any rank
    integer :: k

    motion = 0.0_wp
    associate (set => model%skeleton%nodal_conditions)
      do k = 1, set%n_constraint
        if (.not. self%is_held(set%direction(k), set%node(k))) cycle
        motion(set%direction(k), set%node(k)) = set%way(k, from, to)
      end do
    end associate
    any_motion = model%comm%any(any(abs(motion) > 0.0_wp))
    if (any_motion) call self%expand(model, motion)
  end subroutine unknowns_prescribe
end module dosui_unknowns

!! The sparse background grid: the nodes, patches, cells and blocks that particles can touch.
!!
!! Integer coordinates count grid spacings from the origin: node I sits at origin + I h, cell C
!! spans nodes C to C + 1, block B holds the cells 2 B and 2 B + 1 in each direction. A patch is
!! the set of `width` nodes per direction above a base node; for linear hats patches are cells.
!! Everything is sorted by packed key, so nothing depends on the order of the particles.
!!
!! A periodic grid repeats after some cells: nodes a period apart are one node, with the least
!! coordinate that is not negative. Cells and patches stay where the particles are.
module dosui_grid
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_index_map, only: index_map_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_shape_functions, only: n_group, patch_weights, shape_linear, shape_shift, shape_width
  use dosui_sort, only: sort_permutation, unique_sorted, binary_search
  implicit none
  private

  ! Coordinates that still leave room for neighbours inside the keys' 21 bits.
  real(wp), parameter :: largest_coordinate = 2.0_wp**20 - 8.0_wp

  integer, parameter :: n_recent = 4096   ! a power of two

  type, public :: grid_t
    !! The part of the background grid that this rank's particles can touch.
    real(wp) :: spacing = 0.0_wp                   !! h [m]
    real(wp) :: origin(ndim) = 0.0_wp              !! position of node (0, 0, 0) [m]
    integer :: shape_kind = shape_linear
    integer :: width = 2                           !! nodes per direction and particle
    real(wp) :: half_domain = 0.25_wp              !! GIMP: half a particle's side over h [-]
    real(wp), allocatable :: domain(:, :)
    !! (ndim, particles) likewise of each particle, where domains follow the deformation [-]
    integer :: period(ndim) = 0                    !! cells after which nodes repeat, 0: never
    integer :: n_node = 0, n_patch = 0, n_cell = 0, n_block = 0
    integer(i8), allocatable :: node_key(:), patch_key(:), cell_key(:), block_key(:)
    integer, allocatable :: node_index(:, :)       !! (ndim, n_node) integer coordinates
    integer, allocatable :: patch_node(:, :)       !! (width**ndim, n_patch) nodes, x fastest
    integer, allocatable :: patch_base(:, :)       !! (ndim, n_patch) coordinates of the base node
    integer, allocatable :: patch_fold(:, :)       !! (ndim, n_patch) -1, 0 or 1: end of the body
    integer, allocatable :: cell_node(:, :)        !! (2**ndim, n_cell) corner nodes, x fastest
    integer, allocatable :: cell_base(:, :)        !! (ndim, n_cell) integer coordinates
    integer, allocatable :: cell_block(:)          !! (n_cell) block of each cell
    type(index_map_t) :: node_map, cell_map, block_map   !! entries shared with other ranks
  contains
    procedure :: build => grid_build
    procedure :: locate => grid_locate
    procedure :: weigh => grid_weigh
    procedure :: corner_index => grid_corner_index
    procedure :: find_ends => grid_find_ends
    procedure :: memory_bytes => grid_memory_bytes
  end type grid_t

contains

  subroutine grid_build(self, comm, spacing, origin, shape_kind, n, position, margin, n_extra, &
                        extra_position, period)
    !! Finds everything within +-margin of the positions, and its copies on other ranks.
    !! Collective. Positions too far from the origin (2**20 spacings) are left out; `locate`
    !! counts them as lost.
    class(grid_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: spacing                          !! [m]
    real(wp), intent(in) :: origin(ndim)                     !! [m]
    integer, intent(in) :: shape_kind
    integer, intent(in) :: n                                 !! particles
    real(wp), intent(in) :: position(ndim, n)                !! [m]
    real(wp), intent(in) :: margin                           !! way a particle may move [m]
    integer, intent(in) :: n_extra                           !! points that need cells only
    real(wp), intent(in) :: extra_position(ndim, n_extra)    !! e.g. surface points [m]
    integer, intent(in), optional :: period(ndim)            !! in cells, 0: the grid is endless
    integer(i8), allocatable :: keys(:)

    self%period = 0
    if (present(period)) self%period = period
    self%spacing = spacing
    self%origin = origin
    self%shape_kind = shape_kind
    self%width = shape_width(shape_kind)

    call touched_keys(n, position, origin, spacing, margin, 0.0_wp, self%cell_key)
    call touched_keys(n_extra, extra_position, origin, spacing, margin, 0.0_wp, keys)
    self%cell_key = united(self%cell_key, keys)
    if (self%width == 2) then
      self%patch_key = self%cell_key
    else
      call touched_keys(n, position, origin, spacing, margin, shape_shift(shape_kind), &
                        self%patch_key)
    end if
    self%node_key = united(grown(self%cell_key, 1), grown(self%patch_key, self%width - 1))
    if (any(self%period > 0)) self%node_key = wrapped_keys(self%node_key, self%period)
    call link_nodes(self)
    call link_blocks(self)
    call find_shared(self, comm)
    if (allocated(self%patch_fold)) deallocate (self%patch_fold)
    allocate (self%patch_fold(ndim, self%n_patch), source=0)
  end subroutine grid_build

  subroutine touched_keys(n, position, origin, spacing, margin, shift, keys)
    !! Sorted keys of floor(x/h - shift) for all x within +-margin of the positions. A small table
    !! of recent keys stops most repetitions, so that sorted particles leave little to sort.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n), origin(ndim), spacing, margin, shift
    integer(i8), allocatable, intent(out) :: keys(:)
    integer(i8), allocatable :: found(:), sorted(:)
    integer, allocatable :: order(:)
    integer(i8) :: recent(0:n_recent - 1)
    integer :: p, n_found, low(ndim), high(ndim), last_low(ndim), last_high(ndim)

    allocate (found(1024))
    n_found = 0
    recent = -huge(1_i8)
    last_low = huge(1)
    last_high = huge(1)
    do p = 1, n
      if (.not. all(abs(position(:, p) - origin) + margin < largest_coordinate*spacing)) cycle
      low = floor((position(:, p) - margin - origin)/spacing - shift)
      high = floor((position(:, p) + margin - origin)/spacing - shift)
      if (all(low == last_low .and. high == last_high)) cycle
      last_low = low
      last_high = high
      call add_range(low, high, recent, found, n_found)
    end do
    call sort_permutation(found(1:n_found), order)
    sorted = found(order)
    keys = unique_sorted(sorted)
  end subroutine touched_keys

  pure subroutine add_range(low, high, recent, found, n_found)
    !! Appends the keys of all integer coordinates from low to high that are not recent.
    integer, intent(in) :: low(ndim), high(ndim)
    integer(i8), intent(inout) :: recent(0:n_recent - 1)
    integer(i8), allocatable, intent(inout) :: found(:)
    integer, intent(inout) :: n_found
    integer(i8), allocatable :: longer(:)
    integer(i8) :: key
    integer :: k, d, slot, ijk(ndim)

    ijk = low
    do k = 1, product(high - low + 1)
      key = pack_key(ijk)
      slot = int(iand(ieor(ieor(key, ishft(key, -15)), ishft(key, -36)), n_recent - 1_i8))
      if (recent(slot) /= key) then
        recent(slot) = key
        if (n_found == size(found)) then
          allocate (longer(2*n_found))
          longer(1:n_found) = found
          call move_alloc(longer, found)
        end if
        n_found = n_found + 1
        found(n_found) = key
      end if
      do d = 1, ndim
        ijk(d) = ijk(d) + 1
        if (ijk(d) <= high(d)) exit
        ijk(d) = low(d)
      end do
    end do
  end subroutine add_range

  pure function united(a, b) result(c)
    !! Union of two sorted sets of keys.
    integer(i8), intent(in) :: a(:), b(:)
    integer(i8), allocatable :: c(:)
    integer(i8), allocatable :: merged(:)
    integer :: i, j, k

    allocate (merged(size(a) + size(b)))
    i = 1
    j = 1
    k = 0
    do while (i <= size(a) .or. j <= size(b))
      k = k + 1
      if (j > size(b)) then
        merged(k) = a(i)
      else if (i > size(a)) then
        merged(k) = b(j)
      else
        merged(k) = min(a(i), b(j))
      end if
      if (i <= size(a)) then
        if (a(i) == merged(k)) i = i + 1
      end if
      if (j <= size(b)) then
        if (b(j) == merged(k)) j = j + 1
      end if
    end do
    c = merged(1:k)
  end function united

  pure integer(i8) function step_key(direction) result(step)
    !! What a key grows by when one coordinate grows by 1.
    integer, intent(in) :: direction
    integer :: unit(ndim)

    unit = 0
    unit(direction) = 1
    step = pack_key(unit) - pack_key(0*unit)
  end function step_key

  pure function grown(keys, reach) result(grown_keys)
    !! The sorted keys and all those up to `reach` above them in every direction.
    integer(i8), intent(in) :: keys(:)
    integer, intent(in) :: reach
    integer(i8), allocatable :: grown_keys(:)
    integer :: d, k

    grown_keys = keys
    do d = 1, ndim
      do k = 1, reach
        grown_keys = united(grown_keys, grown_keys + step_key(d))
      end do
    end do
  end function grown

  subroutine link_nodes(self)
    !! Coordinates of all entries, and the nodes of patches and cells.
    class(grid_t), intent(inout) :: self

    self%n_node = size(self%node_key)
    self%n_patch = size(self%patch_key)
    self%n_cell = size(self%cell_key)
    call unpack_keys(self%node_key, self%node_index)
    call unpack_keys(self%patch_key, self%patch_base)
    call unpack_keys(self%cell_key, self%cell_base)
    if (any(self%period > 0)) then
      call link_wrapped_corners(self%patch_base, self%width, self%period, self%node_key, &
                                self%patch_node)
      call link_wrapped_corners(self%cell_base, 2, self%period, self%node_key, self%cell_node)
    else
      call link_corners(self%patch_key, self%width, self%node_key, self%patch_node)
      call link_corners(self%cell_key, 2, self%node_key, self%cell_node)
    end if
  end subroutine link_nodes

  pure subroutine unpack_keys(keys, coordinates)
    integer(i8), intent(in) :: keys(:)
    integer, allocatable, intent(out) :: coordinates(:, :)
    integer :: k, ijk(3)

    allocate (coordinates(ndim, size(keys)))
    do k = 1, size(keys)
      ijk = unpack_key(keys(k))
      coordinates(:, k) = ijk(1:ndim)
    end do
  end subroutine unpack_keys

  pure function wrapped(coordinates, period) result(inside)
    !! The same node in the first period.
    integer, intent(in) :: coordinates(ndim), period(ndim)
    integer :: inside(ndim)

    inside = coordinates
    where (period > 0) inside = modulo(coordinates, max(period, 1))
  end function wrapped

  function wrapped_keys(keys, period) result(inside)
    !! Sorted keys of the same nodes in the first period.
    integer(i8), intent(in) :: keys(:)
    integer, intent(in) :: period(ndim)
    integer(i8), allocatable :: inside(:)
    integer, allocatable :: order(:)
    integer :: k, ijk(3)

    allocate (inside(size(keys)))
    do k = 1, size(keys)
      ijk = unpack_key(keys(k))
      inside(k) = pack_key(wrapped(ijk(1:ndim), period))
    end do
    call sort_permutation(inside, order)
    inside = unique_sorted(inside(order))
  end function wrapped_keys

  pure subroutine link_wrapped_corners(base, width, period, node_key, corner)
    !! As `link_corners`, where the grid repeats.
    integer, intent(in) :: base(:, :)         !! (ndim, n) coordinates
    integer, intent(in) :: width, period(ndim)
    integer(i8), intent(in) :: node_key(:)
    integer, allocatable, intent(out) :: corner(:, :)
    integer :: c, k, d, offset(ndim)

    allocate (corner(width**ndim, size(base, 2)))
    do c = 1, width**ndim
      offset = [(mod((c - 1)/width**(d - 1), width), d=1, ndim)]
      do k = 1, size(base, 2)
        corner(c, k) = binary_search(node_key, pack_key(wrapped(base(:, k) + offset, period)))
      end do
    end do
  end subroutine link_wrapped_corners

  pure function grid_corner_index(self, corner, cell) result(coordinates)
    !! Integer coordinates of a cell's corner where the cell is; those of a periodic grid's node
    !! may lie a period away.
    class(grid_t), intent(in) :: self
    integer, intent(in) :: corner   !! x fastest
    integer, intent(in) :: cell
    integer :: coordinates(ndim), d

    coordinates = self%cell_base(:, cell) + [(merge(1, 0, btest(corner - 1, d - 1)), d=1, ndim)]
  end function grid_corner_index

  pure subroutine link_corners(base_key, width, node_key, corner)
    !! Finds the width**ndim nodes above each base. Both lists are sorted and all corners are in
    !! the list of nodes, so that one walk along both lists serves each corner.
    integer(i8), intent(in) :: base_key(:), node_key(:)
    integer, intent(in) :: width
    integer, allocatable, intent(out) :: corner(:, :)
    integer(i8) :: step
    integer :: c, d, k, node

    allocate (corner(width**ndim, size(base_key)))
    do c = 1, width**ndim
      step = 0_i8
      do d = 1, ndim
        step = step + mod((c - 1)/width**(d - 1), width)*step_key(d)
      end do
      node = 1
      do k = 1, size(base_key)
        do while (node_key(node) < base_key(k) + step)
          node = node + 1
        end do
        corner(c, k) = node
      end do
    end do
  end subroutine link_corners

  subroutine link_blocks(self)
    !! The block of 2**ndim cells that each cell belongs to.
    class(grid_t), intent(inout) :: self
    integer(i8), allocatable :: keys(:)
    integer, allocatable :: order(:)
    integer :: k

    allocate (keys(self%n_cell))
    do k = 1, self%n_cell
      keys(k) = pack_key((self%cell_base(:, k) - modulo(self%cell_base(:, k), 2))/2)
    end do
    call sort_permutation(keys, order)
    self%block_key = unique_sorted(keys(order))
    self%n_block = size(self%block_key)
    if (allocated(self%cell_block)) deallocate (self%cell_block)
    allocate (self%cell_block(self%n_cell))
    do k = 1, self%n_cell
      self%cell_block(k) = binary_search(self%block_key, keys(k))
    end do
  end subroutine link_blocks

  subroutine find_shared(self, comm)
    !! Finds nodes, cells and blocks that other ranks hold, too. Collective. Only entries inside
    !! the bounding box of another rank's cells (and its fringe) have to be looked up.
    class(grid_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer(i8), allocatable :: send(:), boxes(:)
    integer, allocatable :: n_send(:), n_receive(:), low(:, :), high(:, :), block(:, :)
    logical, allocatable :: repeats(:, :)
    integer :: own_box(2*ndim), k, r, n_box

    allocate (n_send(0:comm%size - 1), source=merge(2*ndim, 0, self%n_cell > 0))
    allocate (send(sum(n_send)))
    own_box = [minval(self%cell_base, dim=2), maxval(self%cell_base, dim=2)]
    do k = 1, size(send), 2*ndim
      send(k:k + 2*ndim - 1) = own_box
    end do
    call comm%exchange(send, n_send, boxes, n_receive)

    allocate (low(ndim, comm%size), high(ndim, comm%size))
    repeats = spread(self%period > 0, 2, comm%size)   ! their nodes may be a period away
    n_box = 0
    k = 0
    do r = 0, comm%size - 1
      if (n_receive(r) == 0) cycle
      if (r /= comm%rank) then
        n_box = n_box + 1
        low(:, n_box) = int(boxes(k + 1:k + ndim))
        high(:, n_box) = int(boxes(k + ndim + 1:k + 2*ndim))
      end if
      k = k + 2*ndim
    end do
    call self%node_map%init_shared(comm, self%node_key, &
                                   inside(self%node_index, merge(-huge(1), low(:, :n_box) - 1, &
                                                                 repeats(:, :n_box)), &
                                          merge(huge(1), high(:, :n_box) + 2, &
                                                repeats(:, :n_box))))
    call self%cell_map%init_shared(comm, self%cell_key, &
                                   inside(self%cell_base, low(:, :n_box), high(:, :n_box)))
    call unpack_keys(self%block_key, block)
    call self%block_map%init_shared(comm, self%block_key, &
                                    inside(2*block, low(:, :n_box) - 1, high(:, :n_box)))
  end subroutine find_shared

  pure function inside(coordinates, low, high) result(is_inside)
    !! Do the coordinates lie in any of the boxes?
    integer, intent(in) :: coordinates(:, :)   !! (ndim, n)
    integer, intent(in) :: low(:, :), high(:, :)   !! (ndim, n_box) corners of the boxes
    logical, allocatable :: is_inside(:)
    integer :: b, k, own_low(ndim), own_high(ndim)

    allocate (is_inside(size(coordinates, 2)), source=.false.)
    own_low = minval(coordinates, dim=2)
    own_high = maxval(coordinates, dim=2)
    do b = 1, size(low, 2)
      if (any(low(:, b) > own_high .or. high(:, b) < own_low)) cycle
      do k = 1, size(is_inside)
        if (all(coordinates(:, k) >= low(:, b) .and. coordinates(:, k) <= high(:, b))) then
          is_inside(k) = .true.
        end if
      end do
    end do
  end function inside

  subroutine grid_locate(self, n, position, patch, cell, n_lost)
    !! Finds the patch and cell of each position: those given are kept where they still hold.
    class(grid_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    integer, intent(inout) :: patch(n)          !! last known patch or 0; 0 when not in the grid
    integer, intent(inout) :: cell(n)           !! last known cell or 0; 0 when not in the grid
    integer, intent(out) :: n_lost              !! positions that have no patch or no cell

    if (self%width == 2) then
      call locate_bases(n, position, self%origin, self%spacing, 0.0_wp, self%n_cell, &
                        self%cell_base, self%cell_key, cell, n_lost)
      patch = cell
    else
      call locate_bases(n, position, self%origin, self%spacing, shape_shift(self%shape_kind), &
                        self%n_patch, self%patch_base, self%patch_key, patch, n_lost)
      call locate_bases(n, position, self%origin, self%spacing, 0.0_wp, self%n_cell, &
                        self%cell_base, self%cell_key, cell, n_lost)
      n_lost = count(patch == 0 .or. cell == 0)
    end if
  end subroutine grid_locate

  pure subroutine grid_weigh(self, first, n, patch, position, n_groups, weight, gradient)
    !! Weights and gradients at the nodes of the patches of particles first, first + 1, ...
    class(grid_t), intent(in) :: self
    integer, intent(in) :: first                  !! number of the first particle
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)     !! [m]
    integer, intent(in) :: n_groups               !! of group_count
    real(wp), intent(out) :: weight(n_group, n_groups, n)            !! [-]
    real(wp), intent(out) :: gradient(n_group, n_groups, ndim, n)    !! [1/m]

    if (allocated(self%domain)) then
      call patch_weights(self%shape_kind, self%half_domain, self%origin, self%spacing, n, patch, &
                         position, self%n_patch, self%patch_base, self%patch_fold, n_groups, &
                         weight, gradient, self%domain(:, first:first + n - 1))
    else
      call patch_weights(self%shape_kind, self%half_domain, self%origin, self%spacing, n, patch, &
                         position, self%n_patch, self%patch_base, self%patch_fold, n_groups, &
                         weight, gradient)
    end if
  end subroutine grid_weigh

  subroutine grid_find_ends(self, comm, n, cell, position, margin, barred)
    !! Finds the patches on whose one side all cells are empty, and stay so while particles move by
    !! no more than the margin: weights of a folded patch that a particle has moved through are
    !! negative. None moves through a plane of nodes that walls at rest hold. Collective.
    class(grid_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)           !! of the particles
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    real(wp), intent(in) :: margin           !! [m]
    logical, intent(in), optional :: barred(:, :)
    !! (ndim, n_node) components that walls at rest hold, across themselves
    real(wp) :: local(ndim)
    real(wp), allocatable :: occupied(:, :)  ! cells below and above each node, per direction
    real(wp), allocatable :: entered(:, :)   ! likewise cells that particles may enter
    logical, allocatable :: is_open(:)       ! particles may pass the node in one direction
    integer, allocatable :: plane(:)         ! nodes of a patch beside its centre, likewise
    integer :: p, c, d, k, centre
    logical :: below, above, open

    if (self%width == 2) return
    allocate (occupied(2*ndim, self%n_node), entered(2*ndim, self%n_node), source=0.0_wp)
    do p = 1, n
      if (cell(p) == 0) cycle
      local = (position(:, p) - self%origin)/self%spacing - self%cell_base(:, cell(p))
      do c = 1, 2**ndim
        do d = 1, ndim
          k = merge(2*d - 1, 2*d, btest(c - 1, d - 1))
          occupied(k, self%cell_node(c, cell(p))) = 1.0_wp
          if (.not. margin > 0.0_wp) cycle
          if (merge(1.0_wp - local(d), local(d), btest(c - 1, d - 1))*self%spacing > margin) cycle
          entered(4*d - 1 - k, self%cell_node(c, cell(p))) = 1.0_wp   ! the other side
        end do
      end do
    end do
    call self%node_map%sum_copies(comm, 2*ndim, occupied)
    call self%node_map%sum_copies(comm, 2*ndim, entered)
    centre = (self%width**ndim + 1)/2
    do d = 1, ndim
      is_open = any(occupied > 0.5_wp, dim=1)
      if (present(barred)) is_open = is_open .and. .not. barred(d, :)
      plane = pack([(k, k=1, self%width**ndim)], &
                   [(mod((k - 1)/self%width**(d - 1), self%width) == self%width/2, &
                     k=1, self%width**ndim)])
      do p = 1, self%n_patch
        open = any(is_open(self%patch_node(plane, p)))
        below = is_taken(2*d - 1)
        above = is_taken(2*d)
        self%patch_fold(d, p) = merge(1, 0, below .and. .not. above) - &
                                merge(1, 0, above .and. .not. below)
      end do
    end do

  contains

    pure logical function is_taken(side)
      !! Are there particles on this side of the patch's centre, or may there be?
      integer, intent(in) :: side

      is_taken = occupied(side, self%patch_node(centre, p)) > 0.5_wp .or. &
                 (open .and. entered(side, self%patch_node(centre, p)) > 0.5_wp)
    end function is_taken
  end subroutine grid_find_ends

  pure subroutine locate_bases(n, position, origin, spacing, shift, n_base, base, key, found, &
                               n_lost)
    !! Kernel: index of floor(x/h - shift) among the bases. An index that still fits is kept; the
    !! last one found is tried before a search, because neighbours in memory are neighbours.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n), origin(ndim), spacing, shift
    integer, intent(in) :: n_base, base(ndim, n_base)
    integer(i8), intent(in) :: key(n_base)
    integer, intent(inout) :: found(n)
    integer, intent(out) :: n_lost
    real(wp) :: local(ndim)
    integer :: p, last

    n_lost = 0
    last = 0
    do p = 1, n
      ! A division, as in grid_build: a product with 1/h could round across a grid line.
      local = (position(:, p) - origin)/spacing - shift
      if (found(p) >= 1 .and. found(p) <= n_base) then
        if (all(local >= base(:, found(p)) .and. local < base(:, found(p)) + 1)) cycle
      end if
      if (last > 0) then
        if (all(local >= base(:, last) .and. local < base(:, last) + 1)) then
          found(p) = last
          cycle
        end if
      end if
      found(p) = 0
      if (all(abs(local) < largest_coordinate)) then
        found(p) = binary_search(key, pack_key(floor(local)))
      end if
      if (found(p) == 0) n_lost = n_lost + 1
      last = found(p)
    end do
  end subroutine locate_bases

  pure real(wp) function grid_memory_bytes(self) result(bytes)
    !! Memory of the grid's own arrays on this rank [B].
    class(grid_t), intent(in) :: self
    integer :: per_node, per_patch, per_cell

    per_node = 8 + 4*ndim
    per_patch = 8 + 4*(ndim + self%width**ndim)
    per_cell = 8 + 4*(ndim + 2**ndim + 1)
    bytes = real(per_node, wp)*self%n_node + real(per_patch, wp)*self%n_patch + &
            real(per_cell, wp)*self%n_cell + 8.0_wp*self%n_block
  end function grid_memory_bytes
end module dosui_grid

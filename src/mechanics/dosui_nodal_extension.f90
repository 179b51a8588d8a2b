!! Nodes that a body hardly touches follow those that it fills: the conforming extension.
!!
!! A node is well-posed if its share sum N_i(x_p) V_p of the particles' volumes is at least about
!! half of A_i = sum W_c/2^d, what the filled parts W_c of the cells around would give it if they
!! were evenly filled, and if one of these cells is not just a sliver. All others follow a linear
!! fit through well-posed nodes k around them, u_j = sum E_jk u_k. Sums over k of E_jk are 1, of
!! E_jk x_k x_j: linear fields, hence rigid motions and uniform strains, are reproduced. Sources
!! come by whole shells of equal distance until they span all directions, so there are no ties to
!! break; they are connected with j through filled cells. Aggregated unfitted elements [Badia2018]
!! with the averaged extension of [Burman2022].
!!
!! Cells, particles and kernels know nothing of it. What others do:
!!
!!     call extension%init(…)                     at every build of the geometry; collective
!!     if (extension%is_on) then                  the same on all ranks; else nothing to do
!!       call extension%fold(…, forces, held)     E^T: complete forces, masses x velocities, …
!!       call extension%solve(…, forces, held)    M_r^-1 of folded ones, M_r = E^T diag(m) E
!!       call extension%expand(…, motion, held)   E: before motions are used
!!     end if
!!
!! Conditions on nodes win over the extension, component by component: what they hold does not
!! follow, but may lead.
!!
!! The mass is restricted exactly, not lumped: with negative weights row sums would make transfers
!! amplify. M_r is diagonal but for the sources of other nodes (the strip), where conjugate
!! gradients start with D^-1 b, D = E^T m: the sum of the residual is then 0 in every iterate, and
!! linear momentum exact however early they stop.
!!
!! Implicit systems take the rows themselves: `row_of(i)` is the row r of a node that follows, 0 if
!! it is its own unknown; its sources are `strip_key(source(k))` (a node's key; `strip_node` is its
!! number in this rank's grid, 0 if it has none there) with weights `weight(k)`,
!! k = row_start(r) … row_start(r + 1) - 1. Rows of nodes that the caller wants are there, others'
!! nodes included; `complete_strip` brings the sources' values (numbers of unknowns, too) from
!! their owners, those outside this rank's grid included, `add_strip` sums values back.
module dosui_nodal_extension
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_index_map, only: index_map_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_least_squares, only: eliminate
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  ! Odd numbers, so that round-off does not decide about lattices. Larger shares make longer steps
  ! in 3-D (0.80 instead of 0.66 h/c with 8 particles a cell), not in 2-D.
  real(wp), parameter :: least_share = merge(0.6503_wp, 0.5003_wp, ndim == 3)   !! s [-]
  real(wp), parameter :: least_part = 0.1003_wp   !! of a cell that makes nodes well-posed [-]
  real(wp), parameter :: no_part = 1.0e-12_wp     !! of a cell that is empty [-]
  real(wp), parameter :: lumped_share = 0.05_wp   !! least E^T m over the diagonal of M_r [-]
  real(wp), parameter :: solver_tolerance = 1.0e-13_wp   !! of masses times velocities [-]
  integer, parameter :: iteration_limit = 100
  integer, parameter :: n_column = 2*ndim         !! velocities and accelerations at a time
  integer, parameter :: window_reach = 2          !! nodes that are looked at first
  integer, parameter :: window_distance = 8       !! |q|^2 of whole shells in it
  integer, parameter :: last_distance = merge(27, 18, ndim == 3)   !! |q|^2, where fits end
  integer, parameter :: last_reach = merge(5, 4, ndim == 3)

  integer, parameter :: row_done = 0, row_missing = 1   !! neighbours that this rank may not know

  type, public :: nodal_extension_t
    logical :: is_on = .false.               !! a node follows others, on any rank
    logical, allocatable :: follows(:)       !! (n_node) is no unknown of its own
    integer, allocatable :: row_of(:)        !! (n_node) its row, 0: none here
    integer :: n_row = 0                     !! rows of owned and of wanted nodes
    integer, allocatable :: row_node(:)      !! (n_row)
    logical, allocatable :: row_is_owned(:)  !! (n_row)
    integer, allocatable :: row_start(:)     !! (n_row + 1) into source and weight
    integer, allocatable :: source(:)        !! places in the strip, by key
    real(wp), allocatable :: weight(:)       !! E_jk [-]
    integer :: n_strip = 0                   !! sources that this rank knows
    integer(i8), allocatable :: strip_key(:) !! (n_strip) sorted
    integer, allocatable :: strip_node(:)    !! (n_strip) nodes, 0: not in this rank's grid
    logical, allocatable :: strip_is_owned(:)   !! (n_strip) this rank owns the node
    logical, allocatable :: in_strip(:)      !! (n_node) leads others
    type(index_map_t) :: strip_map           !! copies of the strip; owners are not the nodes'
    integer :: n_follow = 0    !! nodes that follow, on all ranks
    integer :: n_short = 0     !! of them: without neighbours in some direction
    integer :: n_orphan = 0    !! ill-posed nodes that nothing leads: they stay free
    integer :: first_short(ndim) = 0, first_orphan(ndim) = 0   !! coordinates of one, if there are
    integer :: n_solve = 0, n_iteration = 0, most_iterations = 0
  contains
    procedure :: init => nodal_extension_init
    procedure :: fold => nodal_extension_fold
    procedure :: expand => nodal_extension_expand
    procedure :: solve => nodal_extension_solve
    procedure :: mass_product => nodal_extension_mass_product
    procedure :: complete_strip
    procedure :: add_strip
  end type nodal_extension_t

  type :: node_table_t
    !! What is known of nodes: those of the grid, then others that ranks told of.
    integer :: n_grid = 0
    integer(i8), allocatable :: extra_key(:)   !! sorted
    logical, allocatable :: is_well(:)         !! (n_grid + extra)
    integer, allocatable :: cells(:)           !! likewise: filled cells around, a bit for each
  end type node_table_t

  type :: fit_t
    !! Sources of one node.
    integer :: n = 0
    logical :: is_short = .false.
    integer, allocatable :: place(:)      !! in the table of nodes
    integer, allocatable :: q(:, :)       !! (ndim, n) from the node [spacings]
    real(wp), allocatable :: weight(:)
  end type fit_t

contains

  ! ---------------------------------------------------------------- construction

  subroutine nodal_extension_init(self, comm, grid, filling, is_occupied, amount, wanted)
    !! Finds the well-posed nodes and what the others follow. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: filling(grid%n_cell)       !! W_c over a cell's volume [-]
    logical, intent(in) :: is_occupied(grid%n_cell)    !! holds a particle of any rank
    real(wp), intent(in) :: amount(grid%n_node)
    !! sum N_i V_p, complete, over a cell's volume [-]
    logical, intent(in) :: wanted(grid%n_node)
    !! nodes whose rows this rank needs; owned ones with particles or filled cells have theirs
    type(node_table_t) :: table
    type(fit_t), allocatable :: fit(:)
    real(wp), allocatable :: around(:, :)
    logical, allocatable :: needs_row(:)
    integer, allocatable :: row_node(:)
    integer :: i

    self%n_solve = 0
    self%n_iteration = 0
    self%most_iterations = 0
    call look_around(comm, grid, filling, is_occupied, around)
    call find_well_posed(comm, grid, amount, around, table)
    allocate (needs_row(grid%n_node))
    do i = 1, grid%n_node
      needs_row(i) = around(1, i) > 0.0_wp .or. amount(i) > 0.0_wp
      needs_row(i) = needs_row(i) .and. (wanted(i) .or. grid%node_map%is_owned(i)) .and. &
                     .not. table%is_well(i)
    end do
    self%is_on = comm%any(any(needs_row))
    if (.not. self%is_on) then
      call clear(self, grid%n_node)
      return
    end if
    row_node = pack([(i, i=1, grid%n_node)], needs_row)
    call find_fits(comm, grid, row_node, table, fit)
    call keep_fits(self, comm, grid, row_node, table, fit)
  end subroutine nodal_extension_init

  subroutine clear(self, n_node)
    !! Every node is its own unknown.
    class(nodal_extension_t), intent(inout) :: self
    integer, intent(in) :: n_node

    self%follows = spread(.false., 1, n_node)
    self%row_of = spread(0, 1, n_node)
    self%n_row = 0
    self%n_strip = 0
    self%n_follow = 0
    self%n_short = 0
    self%n_orphan = 0
  end subroutine clear

  subroutine look_around(comm, grid, filling, is_occupied, around)
    !! For every node: A_i over a cell's volume; filled cells, a bit for each; cells that make it
    !! well-posed. Cells too small for that do so where no larger one is beside. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: filling(:)
    logical, intent(in) :: is_occupied(:)
    real(wp), allocatable, intent(out) :: around(:, :)   !! (3, n_node)
    real(wp), allocatable :: lone(:, :)
    integer :: c, k, node

    allocate (around(3, grid%n_node), lone(1, grid%n_node), source=0.0_wp)
    do c = 1, grid%n_cell
      if (.not. grid%cell_map%is_owned(c)) cycle
      if (.not. filling(c) > no_part) cycle
      do k = 1, 2**ndim
        node = grid%cell_node(k, c)
        around(1, node) = around(1, node) + filling(c)/2**ndim
        around(2, node) = around(2, node) + real(2**(2**ndim - k), wp)
        if (is_occupied(c) .and. filling(c) >= least_part) then
          around(3, node) = around(3, node) + 1.0_wp
        end if
      end do
    end do
    call grid%node_map%sum_copies(comm, 3, around)
    do c = 1, grid%n_cell
      if (.not. grid%cell_map%is_owned(c)) cycle
      if (.not. (is_occupied(c) .and. filling(c) > no_part)) cycle
      if (any(around(3, grid%cell_node(:, c)) > 0.5_wp)) cycle
      lone(1, grid%cell_node(:, c)) = lone(1, grid%cell_node(:, c)) + 1.0_wp
    end do
    call grid%node_map%sum_copies(comm, 1, lone)
    around(3, :) = around(3, :) + lone(1, :)
  end subroutine look_around

  subroutine find_well_posed(comm, grid, amount, around, table)
    !! Owners decide, so that round-off does not divide the ranks. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: amount(:)      !! as `init` has it
    real(wp), intent(in) :: around(:, :)   !! from `look_around`
    type(node_table_t), intent(out) :: table
    real(wp), allocatable :: well(:, :)
    integer :: i

    allocate (well(1, grid%n_node), source=0.0_wp)
    do i = 1, grid%n_node
      if (around(3, i) > 0.5_wp .and. amount(i) >= least_share*around(1, i)) well(1, i) = 1.0_wp
    end do
    call grid%node_map%gather(comm, 1, well)
    table%n_grid = grid%n_node
    table%is_well = well(1, :) > 0.5_wp
    table%cells = nint(around(2, :))
    allocate (table%extra_key(0))
  end subroutine find_well_posed

  subroutine find_fits(comm, grid, row_node, table, fit)
    !! Sources and weights of nodes. Collective, since ranks tell each other of nodes beside theirs.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: row_node(:)
    type(node_table_t), intent(inout) :: table
    type(fit_t), allocatable, intent(out) :: fit(:)
    integer(i8), allocatable :: asked(:)
    integer, allocatable :: box(:, :)      ! of the ranks' nodes
    integer :: known(size(row_node))       ! windows of this reach are known altogether
    integer :: reach(size(row_node)), status(size(row_node)), r

    allocate (fit(size(row_node)))
    known = merge(last_reach, 0, comm%size == 1)
    status = row_missing
    reach = window_reach
    if (comm%size > 1) call share_boxes(comm, grid, box)
    do
      allocate (asked(0))
      do r = 1, size(row_node)
        if (status(r) == row_done) cycle
        call find_fit(grid, table, row_node(r), known(r), reach(r), fit(r), status(r))
        if (status(r) == row_done) cycle
        call ask_window(grid, table, row_node(r), reach(r), asked)
        known(r) = reach(r)
      end do
      if (.not. comm%any(size(asked) > 0)) exit
      call ask_owners(comm, grid, box, asked, table, fit)
      deallocate (asked)
    end do
  end subroutine find_fits

  subroutine find_fit(grid, table, node, known, reach, fit, status)
    !! One node's sources: in a small window, or a larger one where that is not enough.
    type(grid_t), intent(in) :: grid
    type(node_table_t), intent(in) :: table
    integer, intent(in) :: node
    integer, intent(in) :: known         !! neighbours up to here are known if they exist
    integer, intent(inout) :: reach      !! of the window; that of the last try on return
    type(fit_t), intent(inout) :: fit
    integer, intent(out) :: status
    integer, allocatable :: place(:), q(:, :)
    logical :: is_complete, spans

    do
      call connected(grid, table, node, reach, place, q, is_complete)
      status = row_missing
      if (.not. is_complete .and. known < reach) return
      call take_shells(place, q, merge(window_distance, last_distance, reach < last_reach), &
                       fit, spans)
      status = row_done
      if (spans .or. reach == last_reach) exit
      reach = last_reach
    end do
    if (.not. spans) call take_nearest(place, q, fit)
    call find_weights(fit)
  end subroutine find_fit

  subroutine connected(grid, table, node, reach, place, q, is_complete)
    !! Well-posed nodes of a window that filled cells within it connect with its centre, by key.
    !! A centre without filled cells is connected with all nodes beside it.
    type(grid_t), intent(in) :: grid
    type(node_table_t), intent(in) :: table
    integer, intent(in) :: node, reach
    integer, allocatable, intent(out) :: place(:)   !! in the table
    integer, allocatable, intent(out) :: q(:, :)    !! (ndim, n) from the centre
    logical, intent(out) :: is_complete             !! no filled cell leads to an unknown node
    integer :: window((2*reach + 1)**ndim), queue((2*reach + 1)**ndim)
    logical :: is_reached((2*reach + 1)**ndim)
    integer :: first, last, here, cells, bit, k, there, offset(ndim), low(ndim), centre, n

    call find_window(grid, table, node, reach, window)
    is_complete = .true.
    is_reached = .false.
    centre = (size(window) + 1)/2
    queue(1) = centre
    is_reached(centre) = .true.
    first = 1
    last = 1
    do while (first <= last)
      here = queue(first)
      first = first + 1
      cells = table%cells(window(here))
      if (here == centre .and. cells == 0) cells = 2**(2**ndim) - 1
      offset = offset_of(here, reach)
      do bit = 0, 2**ndim - 1
        if (.not. btest(cells, bit)) cycle
        low = offset - 1 + bits_of(bit)      ! lowest corner of that cell
        if (any(low < -reach .or. low >= reach)) cycle
        do k = 0, 2**ndim - 1
          there = slot_of(low + bits_of(k), reach)
          if (window(there) == 0) then
            is_complete = .false.
          else if (.not. is_reached(there)) then
            is_reached(there) = .true.
            last = last + 1
            queue(last) = there
          end if
        end do
      end do
    end do
    n = 0
    do k = 1, size(window)
      if (is_reached(k)) is_reached(k) = table%is_well(window(k))
      if (is_reached(k)) n = n + 1
    end do
    allocate (place(n), q(ndim, n))
    n = 0
    do k = 1, size(window)
      if (.not. is_reached(k)) cycle
      n = n + 1
      place(n) = window(k)
      q(:, n) = offset_of(k, reach)
    end do
  end subroutine connected

  pure function bits_of(k) result(offset)
    !! Corner k of a cell, counted from 0.
    integer, intent(in) :: k
    integer :: offset(ndim), d

    offset = [(merge(1, 0, btest(k, d - 1)), d=1, ndim)]
  end function bits_of

  pure function offset_of(slot, reach) result(offset)
    !! Place in a window, x fastest, as coordinates from its centre.
    integer, intent(in) :: slot, reach
    integer :: offset(ndim), d

    offset = [(mod((slot - 1)/(2*reach + 1)**(d - 1), 2*reach + 1) - reach, d=1, ndim)]
  end function offset_of

  pure integer function slot_of(offset, reach) result(slot)
    !! Inverse of `offset_of`.
    integer, intent(in) :: offset(ndim), reach
    integer :: d

    slot = 1
    do d = 1, ndim
      slot = slot + (offset(d) + reach)*(2*reach + 1)**(d - 1)
    end do
  end function slot_of

  subroutine find_window(grid, table, node, reach, window)
    !! Places in the table of all nodes around one, 0 where none is known.
    type(grid_t), intent(in) :: grid
    type(node_table_t), intent(in) :: table
    integer, intent(in) :: node, reach
    integer, intent(out) :: window(:)
    integer(i8) :: key
    integer :: k, i

    i = 0
    do k = 1, size(window)
      key = key_beside(grid, node, offset_of(k, reach))
      ! neighbours along x follow each other
      if (i > 0 .and. i < grid%n_node) then
        if (grid%node_key(i + 1) == key) then
          i = i + 1
          window(k) = i
          cycle
        end if
      end if
      i = binary_search(grid%node_key, key)
      window(k) = i
      if (i > 0 .or. size(table%extra_key) == 0) cycle
      window(k) = binary_search(table%extra_key, key)
      if (window(k) > 0) window(k) = window(k) + table%n_grid
    end do
  end subroutine find_window

  pure integer(i8) function key_beside(grid, node, offset) result(key)
    !! Key of a node some spacings away; a periodic grid has it in its first period.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node, offset(ndim)
    integer :: coordinates(ndim)

    coordinates = grid%node_index(:, node) + offset
    where (grid%period > 0) coordinates = modulo(coordinates, max(grid%period, 1))
    key = pack_key(coordinates)
  end function key_beside

  subroutine take_shells(place, q, farthest, fit, spans)
    !! Nodes by whole shells of equal distance until they span all directions.
    integer, intent(in) :: place(:), q(:, :)
    integer, intent(in) :: farthest      !! largest |q|^2
    type(fit_t), intent(inout) :: fit
    logical, intent(out) :: spans
    integer :: distance(size(place)), axes(ndim, ndim), shell, rank, k

    distance = [(sum(q(:, k)**2), k=1, size(place))]
    spans = .false.
    do shell = 1, farthest
      if (.not. any(distance == shell)) cycle
      call find_span(pack_columns(q, distance <= shell), rank, axes)
      spans = rank == ndim
      if (.not. spans) cycle
      call take(place, q, distance <= shell, fit)
      fit%is_short = .false.
      return
    end do
  end subroutine take_shells

  subroutine take_nearest(place, q, fit)
    !! Where nodes around do not span all directions: whole shells until they span as many as all
    !! nodes near do, the nearest shell if there are none near.
    integer, intent(in) :: place(:), q(:, :)
    type(fit_t), intent(inout) :: fit
    integer :: distance(size(place)), axes(ndim, ndim), shell, most, rank, k

    distance = [(sum(q(:, k)**2), k=1, size(place))]
    fit%n = 0
    if (size(place) == 0) return
    if (minval(distance) > last_distance) return
    call find_span(pack_columns(q, distance <= window_distance), most, axes)
    do shell = minval(distance), last_distance
      call find_span(pack_columns(q, distance <= shell), rank, axes)
      if (rank >= most) exit
    end do
    call take(place, q, distance <= shell, fit)
    fit%is_short = .true.
  end subroutine take_nearest

  subroutine take(place, q, chosen, fit)
    !! Copies the chosen nodes.
    integer, intent(in) :: place(:), q(:, :)
    logical, intent(in) :: chosen(:)
    type(fit_t), intent(inout) :: fit

    fit%place = pack(place, chosen)
    fit%q = pack_columns(q, chosen)
    fit%n = size(fit%place)
  end subroutine take

  pure function pack_columns(q, chosen) result(columns)
    integer, intent(in) :: q(:, :)
    logical, intent(in) :: chosen(:)
    integer, allocatable :: columns(:, :)
    integer :: d

    allocate (columns(ndim, count(chosen)))
    do d = 1, ndim
      columns(d, :) = pack(q(d, :), chosen)
    end do
  end function pack_columns

  pure subroutine find_span(q, rank, axes)
    !! How many directions the differences of points span, and points, counted from the first, that
    !! do. Integers, so that there is no doubt.
    integer, intent(in) :: q(:, :)
    integer, intent(out) :: rank
    integer, intent(out) :: axes(ndim, ndim)   !! differences to the first point
    integer :: k, difference(ndim)

    rank = 0
    axes = 0
    do k = 2, size(q, 2)
      if (rank == ndim) return
      difference = q(:, k) - q(:, 1)
      axes(:, rank + 1) = difference
      if (gram_determinant(axes(:, 1:rank + 1)) > 0) then
        rank = rank + 1
      else
        axes(:, rank + 1) = 0
      end if
    end do
  end subroutine find_span

  pure integer function gram_determinant(axes) result(determinant)
    !! Of one to three vectors of integers; 0 if they are dependent.
    integer, intent(in) :: axes(:, :)   !! (ndim, n)
    integer :: gram(3, 3), a, b

    gram = 0
    do a = 1, 3
      gram(a, a) = 1
    end do
    do b = 1, size(axes, 2)
      do a = 1, size(axes, 2)
        gram(a, b) = sum(axes(:, a)*axes(:, b))
      end do
    end do
    determinant = gram(1, 1)*(gram(2, 2)*gram(3, 3) - gram(2, 3)*gram(3, 2)) - &
                  gram(1, 2)*(gram(2, 1)*gram(3, 3) - gram(2, 3)*gram(3, 1)) + &
                  gram(1, 3)*(gram(2, 1)*gram(3, 2) - gram(2, 2)*gram(3, 1))
  end function gram_determinant

  subroutine find_weights(fit)
    !! Weights |q|^-4 of a least-squares fit, linear in the directions that the sources span and
    !! constant across, at the point of their span next to the node.
    type(fit_t), intent(inout) :: fit
    integer :: axes(ndim, ndim), rank, k, a
    real(wp) :: basis(ndim, ndim), at_node(ndim), nearness
    real(wp), allocatable :: matrix(:, :), right(:), point(:, :)
    logical :: regular

    if (allocated(fit%weight)) deallocate (fit%weight)
    allocate (fit%weight(fit%n))
    if (fit%n == 0) return
    call find_span(fit%q, rank, axes)
    if (rank == ndim) then
      basis = 0.0_wp
      do a = 1, ndim
        basis(a, a) = 1.0_wp
      end do
      at_node = 0.0_wp
    else   ! orthonormal axes (Gram and Schmidt), and where the node is in them
      basis = real(axes, wp)
      do a = 1, rank
        do k = 1, a - 1
          basis(:, a) = basis(:, a) - dot_product(basis(:, a), basis(:, k))*basis(:, k)
        end do
        basis(:, a) = basis(:, a)/norm2(basis(:, a))
      end do
      at_node(1:rank) = -matmul(real(fit%q(:, 1), wp), basis(:, 1:rank))
    end if
    allocate (point(rank + 1, fit%n), matrix(rank + 1, rank + 1), right(rank + 1), source=0.0_wp)
    do k = 1, fit%n
      point(1, k) = 1.0_wp
      if (rank == ndim) then
        point(2:, k) = real(fit%q(:, k), wp)
      else
        point(2:, k) = matmul(real(fit%q(:, k) - fit%q(:, 1), wp), basis(:, 1:rank)) - &
                       at_node(1:rank)
      end if
      nearness = 1.0_wp/real(sum(fit%q(:, k)**2), wp)**2
      do a = 1, rank + 1
        matrix(:, a) = matrix(:, a) + nearness*point(:, k)*point(a, k)
      end do
    end do
    right(1) = 1.0_wp
    call eliminate(matrix, right, regular)
    if (.not. regular) then   ! spans what integers say, but hardly: constant
      right = 0.0_wp
      right(1) = 1.0_wp
      point(2:, :) = 0.0_wp
    end if
    do k = 1, fit%n
      fit%weight(k) = dot_product(point(:, k), right)/real(sum(fit%q(:, k)**2), wp)**2
    end do
    fit%weight = fit%weight/sum(fit%weight)
  end subroutine find_weights

  ! ---------------------------------------------------------------- nodes of other ranks

  subroutine share_boxes(comm, grid, box)
    !! Lowest and highest coordinates of every rank's nodes; empty ones have none. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, allocatable, intent(out) :: box(:, :)   !! (2 ndim, ranks)
    integer(i8), allocatable :: send(:), received(:)
    integer :: own(2*ndim), n_send(0:comm%size - 1)
    integer, allocatable :: n_received(:)
    integer :: r

    own(:ndim) = huge(1)
    own(ndim + 1:) = -huge(1)
    if (grid%n_node > 0) own = [minval(grid%node_index, dim=2), maxval(grid%node_index, dim=2)]
    n_send = 2*ndim
    send = [(int(own, i8), r=1, comm%size)]
    call comm%exchange(send, n_send, received, n_received)
    box = reshape(int(received), [2*ndim, comm%size])
  end subroutine share_boxes

  subroutine ask_window(grid, table, node, reach, asked)
    !! Appends the keys of a window that are not known.
    type(grid_t), intent(in) :: grid
    type(node_table_t), intent(in) :: table
    integer, intent(in) :: node, reach
    integer(i8), allocatable, intent(inout) :: asked(:)
    integer :: window((2*reach + 1)**ndim), k, n
    integer(i8) :: more((2*reach + 1)**ndim)

    call find_window(grid, table, node, reach, window)
    n = 0
    do k = 1, size(window)
      if (window(k) > 0) cycle
      n = n + 1
      more(n) = key_beside(grid, node, offset_of(k, reach))
    end do
    asked = [asked, more(:n)]
  end subroutine ask_window

  subroutine send_keys(comm, box, keys, received, n_received)
    !! Sends keys to the ranks whose boxes hold them. Collective.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: box(:, :)
    integer(i8), intent(in) :: keys(:)
    integer(i8), allocatable, intent(out) :: received(:)
    integer, allocatable, intent(out) :: n_received(:)
    integer(i8), allocatable :: send(:)
    integer :: n_send(0:comm%size - 1), r, k, ijk(3), n, pass

    do pass = 1, 2   ! counts, then writes
      if (pass == 2) allocate (send(sum(n_send)))
      n = 0
      do r = 0, comm%size - 1
        n_send(r) = 0
        if (r == comm%rank) cycle
        do k = 1, size(keys)
          ijk = unpack_key(keys(k))
          if (any(ijk(:ndim) < box(:ndim, r + 1) .or. ijk(:ndim) > box(ndim + 1:, r + 1))) cycle
          n = n + 1
          n_send(r) = n_send(r) + 1
          if (pass == 2) send(n) = keys(k)
        end do
      end do
    end do
    call comm%exchange(send, n_send, received, n_received)
  end subroutine send_keys

  subroutine ask_owners(comm, grid, box, asked, table, fit)
    !! Learns of other ranks' nodes; places in fits at hand follow the longer table. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: box(:, :)
    integer(i8), intent(in) :: asked(:)
    type(node_table_t), intent(inout) :: table
    type(fit_t), intent(inout) :: fit(:)
    integer(i8), allocatable :: keys(:), received(:), reply(:), answer(:), joined(:)
    integer, allocatable :: order(:), n_received(:), n_reply(:), n_answer(:), cells(:), to(:)
    logical, allocatable :: is_well(:)
    integer :: r, k, i, n, m, first

    call sort_permutation(asked, order)
    keys = unique_sorted(asked(order))
    call send_keys(comm, box, keys, received, n_received)
    allocate (reply(3*size(received)), n_reply(0:comm%size - 1))
    n = 0
    first = 0
    do r = 0, comm%size - 1
      n_reply(r) = 0
      do k = first + 1, first + n_received(r)
        i = binary_search(grid%node_key, received(k))
        if (i == 0) cycle
        if (.not. grid%node_map%is_owned(i)) cycle
        reply(n + 1:n + 3) = [received(k), merge(1_i8, 0_i8, table%is_well(i)), &
                              int(table%cells(i), i8)]
        n = n + 3
        n_reply(r) = n_reply(r) + 3
      end do
      first = first + n_received(r)
    end do
    call comm%exchange(reply(:n), n_reply, answer, n_answer)
    n = size(table%extra_key)
    m = size(answer)/3
    joined = [table%extra_key, answer(1::3)]
    is_well = [table%is_well(table%n_grid + 1:), answer(2::3) == 1_i8]
    cells = [table%cells(table%n_grid + 1:), int(answer(3::3))]
    call sort_permutation(joined, order)
    table%extra_key = joined(order)
    table%is_well = [table%is_well(:table%n_grid), is_well(order)]
    table%cells = [table%cells(:table%n_grid), cells(order)]
    allocate (to(n + m))
    do k = 1, n + m
      to(order(k)) = k
    end do
    do r = 1, size(fit)
      do k = 1, fit(r)%n
        if (fit(r)%place(k) > table%n_grid) fit(r)%place(k) = table%n_grid + &
                                                              to(fit(r)%place(k) - table%n_grid)
      end do
    end do
  end subroutine ask_owners

  ! ---------------------------------------------------------------- rows and strip

  subroutine keep_fits(self, comm, grid, row_node, table, fit)
    !! Fits become rows, their sources the strip. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: row_node(:)
    type(node_table_t), intent(in) :: table
    type(fit_t), intent(in) :: fit(:)
    real(wp) :: mark(1, grid%n_node)
    integer, allocatable :: strip_of(:)
    integer :: r, k, n, place
    integer(i8) :: counts(3), key, first(2)

    self%follows = spread(.false., 1, grid%n_node)
    mark = 0.0_wp
    counts = 0_i8
    first = huge(first)
    do r = 1, size(row_node)
      if (fit(r)%n > 0) mark(1, row_node(r)) = 1.0_wp
      if (.not. grid%node_map%is_owned(row_node(r))) cycle
      key = grid%node_key(row_node(r))
      if (fit(r)%n == 0) then
        counts(3) = counts(3) + 1_i8
        first(2) = min(first(2), key)
        cycle
      end if
      counts(1) = counts(1) + 1_i8
      if (.not. fit(r)%is_short) cycle
      counts(2) = counts(2) + 1_i8
      first(1) = min(first(1), key)
    end do
    call grid%node_map%gather(comm, 1, mark)
    self%follows = mark(1, :) > 0.5_wp
    self%n_follow = int(comm%sum(counts(1)))
    self%n_short = int(comm%sum(counts(2)))
    self%n_orphan = int(comm%sum(counts(3)))
    self%first_short = coordinates_of(comm%minimum(first(1)), self%n_short)
    self%first_orphan = coordinates_of(comm%minimum(first(2)), self%n_orphan)
    call build_strip(self, comm, grid, table, fit, strip_of)
    self%n_row = count(fit%n > 0)
    if (allocated(self%row_node)) deallocate (self%row_node, self%row_start, self%source, &
                                              self%weight, self%row_is_owned)
    n = sum(fit%n)
    allocate (self%row_node(self%n_row), self%row_start(self%n_row + 1), self%source(n), &
              self%weight(n), self%row_is_owned(self%n_row))
    self%row_of = spread(0, 1, grid%n_node)
    self%row_start(1) = 1
    n = 0
    do r = 1, size(row_node)
      if (fit(r)%n == 0) cycle
      n = n + 1
      self%row_node(n) = row_node(r)
      self%row_is_owned(n) = grid%node_map%is_owned(row_node(r))
      self%row_of(row_node(r)) = n
      do k = 1, fit(r)%n
        place = self%row_start(n) + k - 1
        self%source(place) = strip_of(fit(r)%place(k))
        self%weight(place) = fit(r)%weight(k)
      end do
      self%row_start(n + 1) = self%row_start(n) + fit(r)%n
    end do
  end subroutine keep_fits

  pure function coordinates_of(key, n) result(place)
    !! Coordinates of the first of n nodes; 0 if there is none.
    integer(i8), intent(in) :: key
    integer, intent(in) :: n
    integer :: place(ndim), all(3)

    place = 0
    if (n == 0) return
    all = unpack_key(key)
    place = all(1:ndim)
  end function coordinates_of

  subroutine build_strip(self, comm, grid, table, fit, strip_of)
    !! The sources: all of this rank's nodes that any rank's rows use, and others' in its own rows.
    !! Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    type(node_table_t), intent(in) :: table
    type(fit_t), intent(in) :: fit(:)
    integer, allocatable, intent(out) :: strip_of(:)   !! place in the strip of the table's nodes
    real(wp) :: mark(1, grid%n_node)
    logical, allocatable :: is_used(:)
    integer(i8), allocatable :: keys(:), received(:)
    integer, allocatable :: order(:), n_received(:), box(:, :), place(:)
    integer :: r, k, i, n

    allocate (is_used(size(table%is_well)), source=.false.)
    do r = 1, size(fit)
      do k = 1, fit(r)%n
        is_used(fit(r)%place(k)) = .true.
      end do
    end do
    mark(1, :) = merge(1.0_wp, 0.0_wp, is_used(:grid%n_node))
    if (comm%size > 1) then
      call share_boxes(comm, grid, box)
      call send_keys(comm, box, pack(table%extra_key, is_used(grid%n_node + 1:)), received, &
                     n_received)
      do k = 1, size(received)
        i = binary_search(grid%node_key, received(k))
        if (i == 0) cycle
        if (grid%node_map%is_owned(i)) mark(1, i) = 1.0_wp
      end do
      call grid%node_map%sum_copies(comm, 1, mark)
    end if
    is_used(:grid%n_node) = mark(1, :) > 0.5_wp
    self%in_strip = is_used(:grid%n_node)
    n = count(is_used)
    place = pack([(k, k=1, size(is_used))], is_used)
    keys = [pack(grid%node_key, is_used(:grid%n_node)), &
            pack(table%extra_key, is_used(grid%n_node + 1:))]
    call sort_permutation(keys, order)
    self%n_strip = n
    self%strip_key = keys(order)
    allocate (strip_of(size(is_used)), source=0)
    if (allocated(self%strip_node)) deallocate (self%strip_node, self%strip_is_owned)
    allocate (self%strip_node(n), source=0)
    allocate (self%strip_is_owned(n), source=.false.)
    do k = 1, n
      strip_of(place(order(k))) = k
      if (place(order(k)) > grid%n_node) cycle
      self%strip_node(k) = place(order(k))
      self%strip_is_owned(k) = grid%node_map%is_owned(self%strip_node(k))
    end do
    call self%strip_map%init_shared(comm, self%strip_key, spread(.true., 1, n))
  end subroutine build_strip

  ! ---------------------------------------------------------------- use

  subroutine complete_strip(self, comm, width, values)
    !! Brings values of the strip from the nodes' owners to all copies. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width
    real(wp), intent(inout) :: values(width, self%n_strip)   !! [any unit]
    integer :: s

    if (comm%size == 1) return
    do s = 1, self%n_strip
      if (.not. self%strip_is_owned(s)) values(:, s) = 0.0_wp
    end do
    call self%add_strip(comm, width, values)
  end subroutine complete_strip

  subroutine add_strip(self, comm, width, values)
    !! Sums the ranks' parts of the strip, on all copies. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width
    real(wp), intent(inout) :: values(width, self%n_strip)   !! [any unit]

    call self%strip_map%sum_copies(comm, width, values)
  end subroutine add_strip

  subroutine nodal_extension_fold(self, comm, grid, width, values, is_held)
    !! E^T: what components that follow have goes to their sources, and leaves them 0. Held ones
    !! keep theirs. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: width    !! a multiple of ndim if components are held
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete: forces [N], momenta [kg m/s], masses [kg]
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp) :: strip(width, self%n_strip), given(width)
    integer :: i, k, r, s

    if (.not. self%is_on) return
    strip = 0.0_wp
    do r = 1, self%n_row
      if (.not. self%row_is_owned(r)) cycle
      given = values(:, self%row_node(r))
      if (present(is_held)) where (columns(width, is_held(:, self%row_node(r)))) given = 0.0_wp
      do k = self%row_start(r), self%row_start(r + 1) - 1
        s = self%source(k)
        strip(:, s) = strip(:, s) + self%weight(k)*given
      end do
    end do
    call self%add_strip(comm, width, strip)
    do s = 1, self%n_strip
      if (self%strip_node(s) == 0) cycle
      values(:, self%strip_node(s)) = values(:, self%strip_node(s)) + strip(:, s)
    end do
    do i = 1, grid%n_node
      if (.not. self%follows(i)) cycle
      if (present(is_held)) then
        where (.not. columns(width, is_held(:, i))) values(:, i) = 0.0_wp
      else
        values(:, i) = 0.0_wp
      end if
    end do
  end subroutine nodal_extension_fold

  subroutine nodal_extension_expand(self, comm, grid, width, values, is_held)
    !! E: components that follow get their values; held ones keep theirs. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width    !! a multiple of ndim if components are held
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete on nodes that do not follow [m or any unit of a motion]
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp) :: strip(width, self%n_strip), total(width)
    integer :: k, r, s

    if (.not. self%is_on) return
    do s = 1, self%n_strip
      if (self%strip_node(s) > 0) strip(:, s) = values(:, self%strip_node(s))
    end do
    call self%complete_strip(comm, width, strip)
    do r = 1, self%n_row
      total = 0.0_wp
      do k = self%row_start(r), self%row_start(r + 1) - 1
        total = total + self%weight(k)*strip(:, self%source(k))
      end do
      if (present(is_held)) then
        where (columns(width, is_held(:, self%row_node(r)))) total = values(:, self%row_node(r))
      end if
      values(:, self%row_node(r)) = total
    end do
    call grid%node_map%gather(comm, width, values)
  end subroutine nodal_extension_expand

  pure function columns(width, components)
    !! Flags of a node's components, for several vectors one after the other.
    integer, intent(in) :: width
    logical, intent(in) :: components(ndim)
    logical :: columns(width)
    integer :: k

    columns = [(components(mod(k - 1, ndim) + 1), k=1, width)]
  end function columns

  subroutine nodal_extension_mass_product(self, comm, grid, width, mass, values)
    !! M_r = E^T diag(m) E times values of the nodes that do not follow; the others' are 0 on
    !! return. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width
    real(wp), intent(in) :: mass(grid%n_node)   !! complete [kg]
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! motions on entry [m/s or m/s2], [kg m/s or N] on return
    integer :: i

    call self%expand(comm, grid, width, values)
    do i = 1, grid%n_node
      values(:, i) = mass(i)*values(:, i)
    end do
    call self%fold(comm, grid, width, values)
  end subroutine nodal_extension_mass_product

  subroutine nodal_extension_solve(self, comm, grid, width, mass, values, is_held)
    !! M_r^-1: folded momenta become velocities, folded forces accelerations, of all nodes, those
    !! that follow included. Nodes without mass get 0. Held components are what they are given as,
    !! and the mass beside moves with them. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width    !! one or two vectors of ndim components, one after the other
    real(wp), intent(in) :: mass(grid%n_node)               !! of particles, complete [kg]
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete [kg m/s or N] on entry, [m/s or m/s2] on return
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp), dimension(n_column, self%n_strip) :: x, is_free
    real(wp) :: own(self%n_strip), row_mass(n_column, self%n_row), inverse
    integer :: i, k, n, s

    do i = 1, grid%n_node
      if (self%follows(i)) cycle
      if (self%is_on) then
        if (self%in_strip(i)) cycle
      end if
      inverse = 0.0_wp
      if (mass(i) > tiny(1.0_wp)*1.0e20_wp) inverse = 1.0_wp/mass(i)
      do k = 1, width
        if (present(is_held)) then
          if (is_held(mod(k - 1, ndim) + 1, i)) cycle
        end if
        values(k, i) = values(k, i)*inverse
      end do
    end do
    if (.not. self%is_on) return
    x = 0.0_wp
    is_free = 0.0_wp
    own = 0.0_wp
    do s = 1, self%n_strip
      if (self%strip_node(s) == 0) cycle
      x(:width, s) = values(:, self%strip_node(s))
      own(s) = mass(self%strip_node(s))
      is_free(:width, s) = 1.0_wp
      if (.not. present(is_held)) cycle
      where (columns(width, is_held(:, self%strip_node(s)))) is_free(:width, s) = 0.0_wp
    end do
    do n = 1, self%n_row
      row_mass(:, n) = mass(self%row_node(n))
      if (.not. present(is_held)) cycle
      where (columns(n_column, is_held(:, self%row_node(n)))) row_mass(:, n) = 0.0_wp
    end do
    call solve_strip(self, comm, own, row_mass, is_free, x, present(is_held))
    do s = 1, self%n_strip
      if (self%strip_node(s) > 0) values(:, self%strip_node(s)) = x(:width, s)
    end do
    call self%expand(comm, grid, width, values, is_held)
  end subroutine nodal_extension_solve

  subroutine solve_strip(self, comm, own, row_mass, is_free, x, has_held)
    !! The equations of the strip, by conjugate gradients. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(inout) :: own(self%n_strip)   !! masses of the nodes [kg]
    real(wp), intent(in) :: row_mass(n_column, self%n_row)
    !! masses of the components that follow [kg]
    real(wp), intent(inout) :: is_free(n_column, self%n_strip)   !! 1: unknown, 0: held
    real(wp), intent(inout) :: x(n_column, self%n_strip)
    !! right side on unknowns and values where held; solution on return
    logical, intent(in) :: has_held
    real(wp), dimension(n_column, self%n_strip) :: r, z, p, q, inverse
    real(wp) :: sums(2*n_column), before(n_column), first(n_column), factor(n_column)
    integer :: iteration

    call self%complete_strip(comm, n_column, x)
    call self%complete_strip(comm, 1, own)
    call self%complete_strip(comm, n_column, is_free)
    r = is_free*x
    x = x - r          ! what is held
    call invert_lumped(self, comm, own, row_mass, is_free, inverse)
    z = inverse*r
    sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, r, z)
    if (has_held) then
      call multiply(x, q)
      r = is_free*(r - q)
    end if
    p = inverse*r      ! after this the residual's sum is 0
    x = x + p
    call multiply(p, q)
    r = is_free*(r - q)
    p = inverse*r
    sums(n_column + 1:) = product_of(self%n_strip, self%strip_is_owned, r, p)
    call comm%sum_array(sums)
    first = sums(:n_column)
    before = sums(n_column + 1:)
    self%n_solve = self%n_solve + 1
    do iteration = 1, iteration_limit
      if (all(before <= solver_tolerance**2*first)) exit
      call multiply(p, q)
      sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, p, q)
      call comm%sum_array(sums(:n_column))
      factor = 0.0_wp
      where (sums(:n_column) > 0.0_wp) factor = before/sums(:n_column)
      call advance(self%n_strip, factor, is_free, inverse, p, q, x, r, z)
      sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, r, z)
      call comm%sum_array(sums(:n_column))
      factor = 0.0_wp
      where (before > 0.0_wp) factor = sums(:n_column)/before
      before = sums(:n_column)
      call turn(self%n_strip, factor, z, p)
      self%n_iteration = self%n_iteration + 1
      self%most_iterations = max(self%most_iterations, iteration)
    end do

  contains

    subroutine multiply(a, b)
      !! b = M_r a on the strip, complete on all copies.
      real(wp), intent(in) :: a(n_column, self%n_strip)
      real(wp), intent(out) :: b(n_column, self%n_strip)

      call start_product(self%n_strip, self%strip_is_owned, own, a, b)
      call add_followers(self%n_row, self%row_is_owned, self%row_start, size(self%source), &
                         self%source, self%weight, row_mass, self%n_strip, a, b)
      call self%add_strip(comm, n_column, b)
    end subroutine multiply
  end subroutine solve_strip

  pure function product_of(n, is_owned, a, b) result(products)
    !! Kernel: this rank's part of the scalar products.
    integer, intent(in) :: n
    logical, intent(in) :: is_owned(n)
    real(wp), intent(in) :: a(n_column, n), b(n_column, n)
    real(wp) :: products(n_column)
    integer :: k

    products = 0.0_wp
    do k = 1, n
      if (is_owned(k)) products = products + a(:, k)*b(:, k)
    end do
  end function product_of

  pure subroutine advance(n, factor, is_free, inverse, p, q, x, r, z)
    !! Kernel: one step along a direction.
    integer, intent(in) :: n
    real(wp), intent(in) :: factor(n_column)
    real(wp), dimension(n_column, n), intent(in) :: is_free, inverse, p, q
    real(wp), dimension(n_column, n), intent(inout) :: x, r, z
    integer :: k

    do k = 1, n
      x(:, k) = x(:, k) + factor*p(:, k)
      r(:, k) = r(:, k) - factor*is_free(:, k)*q(:, k)
      z(:, k) = inverse(:, k)*r(:, k)
    end do
  end subroutine advance

  pure subroutine turn(n, factor, z, p)
    !! Kernel: the next direction.
    integer, intent(in) :: n
    real(wp), intent(in) :: factor(n_column), z(n_column, n)
    real(wp), intent(inout) :: p(n_column, n)
    integer :: k

    do k = 1, n
      p(:, k) = z(:, k) + factor*p(:, k)
    end do
  end subroutine turn

  pure subroutine start_product(n, is_owned, own, a, b)
    !! Kernel: the nodes' own masses times a.
    integer, intent(in) :: n
    logical, intent(in) :: is_owned(n)
    real(wp), intent(in) :: own(n), a(n_column, n)
    real(wp), intent(out) :: b(n_column, n)
    integer :: k

    do k = 1, n
      if (is_owned(k)) then
        b(:, k) = own(k)*a(:, k)
      else
        b(:, k) = 0.0_wp
      end if
    end do
  end subroutine start_product

 pure subroutine add_followers(n_row, row_is_owned, row_start, n_source, source, weight, row_mass, &
                                n_strip, a, b)
    !! Kernel: adds E^T m E a of the nodes that follow.
    integer, intent(in) :: n_row, n_source, n_strip
    logical, intent(in) :: row_is_owned(n_row)
    integer, intent(in) :: row_start(n_row + 1), source(n_source)
    real(wp), intent(in) :: weight(n_source)
    real(wp), intent(in) :: row_mass(n_column, n_row)   !! [kg]
    real(wp), intent(in) :: a(n_column, n_strip)
    real(wp), intent(inout) :: b(n_column, n_strip)
    real(wp) :: total(n_column)
    integer :: k, row

    do row = 1, n_row
      if (.not. row_is_owned(row)) cycle
      total = 0.0_wp
      do k = row_start(row), row_start(row + 1) - 1
        total = total + weight(k)*a(:, source(k))
      end do
      total = row_mass(:, row)*total
      do k = row_start(row), row_start(row + 1) - 1
        b(:, source(k)) = b(:, source(k)) + weight(k)*total
      end do
    end do
  end subroutine add_followers

  subroutine invert_lumped(self, comm, own, row_mass, is_free, inverse)
    !! 1/(E^T m), or of the diagonal of M_r where that is much larger; 0 where held. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: own(self%n_strip)                 !! masses of the strip's nodes [kg]
    real(wp), intent(in) :: row_mass(n_column, self%n_row)    !! of components that follow [kg]
    real(wp), intent(in) :: is_free(n_column, self%n_strip)
    real(wp), intent(out) :: inverse(n_column, self%n_strip)  !! [1/kg]
    real(wp) :: lumped(2*ndim, self%n_strip)   ! E^T m and the diagonal of M_r
    integer :: a, k, r, s

    lumped = 0.0_wp
    do r = 1, self%n_row
      if (.not. self%row_is_owned(r)) cycle
      do k = self%row_start(r), self%row_start(r + 1) - 1
        s = self%source(k)
        lumped(:ndim, s) = lumped(:ndim, s) + self%weight(k)*row_mass(:ndim, r)
        lumped(ndim + 1:, s) = lumped(ndim + 1:, s) + self%weight(k)**2*row_mass(:ndim, r)
      end do
    end do
    call self%add_strip(comm, 2*ndim, lumped)
    do s = 1, self%n_strip
      do a = 1, ndim
        lumped(a, s) = lumped(a, s) + own(s)
        lumped(ndim + a, s) = lumped(ndim + a, s) + own(s)
        if (.not. lumped(a, s) > lumped_share*lumped(ndim + a, s)) then
          lumped(a, s) = lumped(ndim + a, s)
        end if
        lumped(ndim + a, s) = 0.0_wp
        if (lumped(a, s) > tiny(1.0_wp)*1.0e20_wp) lumped(ndim + a, s) = 1.0_wp/lumped(a, s)
      end do
      do k = 1, n_column
        inverse(k, s) = is_free(k, s)*lumped(ndim + mod(k - 1, ndim) + 1, s)
      end do
    end do
  end subroutine invert_lumped
end module dosui_nodal_extension

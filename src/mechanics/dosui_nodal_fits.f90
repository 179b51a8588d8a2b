!! Which nodes a body fills, and linear fits through them for those that it hardly touches.
module dosui_nodal_fits
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_least_squares, only: eliminate
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  public :: look_around, find_well_posed, find_fits, share_boxes, send_keys

  ! Odd numbers, so that round-off does not decide about lattices. Larger shares make longer steps
  ! in 3-D (0.80 instead of 0.66 h/c with 8 particles a cell), not in 2-D.
  real(wp), parameter :: least_share = merge(0.6503_wp, 0.5003_wp, ndim == 3)   !! s [-]
  real(wp), parameter :: least_part = 0.1003_wp   !! of a cell that makes nodes well-posed [-]
  real(wp), parameter :: no_part = 1.0e-12_wp     !! of a cell that is empty [-]
  integer, parameter :: window_reach = 2          !! nodes that are looked at first
  integer, parameter :: window_distance = 8       !! |q|^2 of whole shells in it
  integer, parameter :: last_distance = merge(27, 18, ndim == 3)   !! |q|^2, where fits end
  integer, parameter :: last_reach = merge(5, 4, ndim == 3)
  integer, parameter :: row_done = 0, row_missing = 1   !! neighbours that this rank may not know

  type, public :: node_table_t
    !! What is known of nodes: those of the grid, then others that ranks told of.
    integer :: n_grid = 0
    integer(i8), allocatable :: extra_key(:)   !! sorted
    logical, allocatable :: is_well(:)         !! (n_grid + extra)
    integer, allocatable :: cells(:)           !! likewise: filled cells around, a bit for each
  end type node_table_t

  type, public :: fit_t
    !! Sources of one node.
    integer :: n = 0
    logical :: is_short = .false.
    integer, allocatable :: place(:)      !! in the table of nodes
    integer, allocatable :: q(:, :)       !! (ndim, n) from the node [spacings]
    real(wp), allocatable :: weight(:)    !! [-]
  end type fit_t

contains

  subroutine look_around(comm, grid, filling, is_occupied, around)
    !! For every node: A_i over a cell's volume; filled cells, a bit for each; cells that make it
    !! well-posed. Cells too small for that do so where no larger one is beside. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: filling(:)   !! (n_cell) over a cell's volume [-]
    logical, intent(in) :: is_occupied(:)
    real(wp), allocatable, intent(out) :: around(:, :)   !! (3, n_node) [-]
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
    real(wp), intent(in) :: amount(:)      !! (n_node) sum N_i V_p over a cell's volume [-]
    real(wp), intent(in) :: around(:, :)   !! from `look_around` [-]
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
end module dosui_nodal_fits

!! Neighbour lists by sparse bins: cost follows the points, not the box they lie in.
module dosui_neighbours
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_keys, only: pack_key, unpack_key
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  public :: build_neighbours

  type :: bins_t
    !! Points sorted into cubes as wide as the radius.
    integer(i8), allocatable :: key(:)     !! of occupied bins, sorted
    integer, allocatable :: start(:)       !! first entry of each bin in `point`
    integer, allocatable :: point(:)       !! points by bin, increasing within a bin
  end type bins_t

contains

  subroutine build_neighbours(n_row, row_position, n_point, position, radius, row_start, &
                              neighbour, skip_self)
    !! For every row the points nearer than the radius, in an order that depends on positions and
    !! indices only.
    integer, intent(in) :: n_row
    real(wp), intent(in) :: row_position(ndim, n_row)   !! [m]
    integer, intent(in) :: n_point
    real(wp), intent(in) :: position(ndim, n_point)     !! [m]
    real(wp), intent(in) :: radius                      !! [m]
    integer, allocatable, intent(out) :: row_start(:)   !! (n_row + 1)
    integer, allocatable, intent(out) :: neighbour(:)
    logical, intent(in) :: skip_self                    !! rows are the first points
    type(bins_t) :: rows, points
    integer, allocatable :: count(:)
    integer :: bin, n_candidate, r, first
    integer, allocatable :: candidate(:)
    real(wp), allocatable :: candidate_position(:, :)

    rows = sorted_into_bins(n_row, row_position, radius)
    points = sorted_into_bins(n_point, position, radius)
    allocate (row_start(n_row + 1), count(n_row), candidate(0), candidate_position(ndim, 0))
    do bin = 1, size(rows%key)
      call collect_candidates(points, rows%key(bin), position, candidate, candidate_position, &
                              n_candidate)
      call count_near(rows%start(bin + 1) - rows%start(bin), rows%point(rows%start(bin)), n_row, &
                      row_position, n_candidate, candidate_position, radius**2, skip_self, count)
    end do
    first = 1
    do r = 1, n_row
      row_start(r) = first
      first = first + count(r)
    end do
    row_start(n_row + 1) = first
    allocate (neighbour(first - 1))
    do bin = 1, size(rows%key)
      call collect_candidates(points, rows%key(bin), position, candidate, candidate_position, &
                              n_candidate)
      call list_near(rows%start(bin + 1) - rows%start(bin), rows%point(rows%start(bin)), n_row, &
                     row_position, n_candidate, candidate, candidate_position, radius**2, &
                     skip_self, row_start, neighbour)
    end do
  end subroutine build_neighbours

  function sorted_into_bins(n, position, width) result(bins)
    !! Sorts points into bins.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)
    real(wp), intent(in) :: width   !! [m]
    type(bins_t) :: bins
    integer(i8), allocatable :: key(:), sorted(:)
    integer :: p, bin

    allocate (key(n))
    do p = 1, n
      key(p) = pack_key(floor(position(:, p)/width))
    end do
    call sort_permutation(key, bins%point)
    sorted = key(bins%point)
    bins%key = unique_sorted(sorted)
    allocate (bins%start(size(bins%key) + 1))
    bin = 0
    do p = 1, n
      if (p > 1) then
        if (sorted(p) == sorted(p - 1)) cycle
      end if
      bin = bin + 1
      bins%start(bin) = p
    end do
    bins%start(size(bins%key) + 1) = n + 1
  end function sorted_into_bins

  subroutine collect_candidates(points, key, position, candidate, candidate_position, n)
    !! Points in a bin and the bins around it.
    type(bins_t), intent(in) :: points
    integer(i8), intent(in) :: key
    real(wp), intent(in) :: position(:, :)
    integer, allocatable, intent(inout) :: candidate(:)
    real(wp), allocatable, intent(inout) :: candidate_position(:, :)
    integer, intent(out) :: n
    integer :: ijk(3), offset(ndim), k, d, bin, first, last, digit

    ijk = unpack_key(key)
    n = 0
    do k = 0, 3**ndim - 1
      digit = k
      do d = 1, ndim
        offset(d) = mod(digit, 3) - 1
        digit = digit/3
      end do
      bin = binary_search(points%key, pack_key(ijk(1:ndim) + offset))
      if (bin == 0) cycle
      first = points%start(bin)
      last = points%start(bin + 1) - 1
      if (n + last - first + 1 > size(candidate)) then
        call grow(2*(n + last - first + 1), candidate, candidate_position)
      end if
      candidate(n + 1:n + last - first + 1) = points%point(first:last)
      candidate_position(:, n + 1:n + last - first + 1) = position(:, points%point(first:last))
      n = n + last - first + 1
    end do
  end subroutine collect_candidates

  subroutine grow(n, candidate, candidate_position)
    !! Makes room for n candidates.
    integer, intent(in) :: n
    integer, allocatable, intent(inout) :: candidate(:)
    real(wp), allocatable, intent(inout) :: candidate_position(:, :)
    integer, allocatable :: more(:)
    real(wp), allocatable :: more_positions(:, :)

    allocate (more(n), source=0)
    allocate (more_positions(ndim, n), source=0.0_wp)
    more(1:size(candidate)) = candidate
    more_positions(:, 1:size(candidate)) = candidate_position
    call move_alloc(more, candidate)
    call move_alloc(more_positions, candidate_position)
  end subroutine grow

  pure subroutine count_near(n, row, n_row, row_position, n_candidate, candidate_position, &
                             radius_squared, skip_self, count)
    !! Kernel: how many candidates are near each row of a bin.
    integer, intent(in) :: n, n_row, n_candidate
    integer, intent(in) :: row(n)
    real(wp), intent(in) :: row_position(ndim, n_row)
    real(wp), intent(in) :: candidate_position(ndim, n_candidate)
    real(wp), intent(in) :: radius_squared
    logical, intent(in) :: skip_self
    integer, intent(inout) :: count(n_row)
    integer :: k, c, found
    real(wp) :: x(ndim)

    do k = 1, n
      x = row_position(:, row(k))
      found = 0
      do c = 1, n_candidate
        if (sum((candidate_position(:, c) - x)**2) < radius_squared) found = found + 1
      end do
      if (skip_self) found = found - 1
      count(row(k)) = found
    end do
  end subroutine count_near

  pure subroutine list_near(n, row, n_row, row_position, n_candidate, candidate, &
                            candidate_position, radius_squared, skip_self, row_start, neighbour)
    !! Kernel: lists the candidates near each row of a bin.
    integer, intent(in) :: n, n_row, n_candidate
    integer, intent(in) :: row(n)
    real(wp), intent(in) :: row_position(ndim, n_row)
    integer, intent(in) :: candidate(n_candidate)
    real(wp), intent(in) :: candidate_position(ndim, n_candidate)
    real(wp), intent(in) :: radius_squared
    logical, intent(in) :: skip_self
    integer, intent(in) :: row_start(n_row + 1)
    integer, intent(inout) :: neighbour(:)
    integer :: k, c, next
    real(wp) :: x(ndim)

    do k = 1, n
      x = row_position(:, row(k))
      next = row_start(row(k))
      do c = 1, n_candidate
        if (sum((candidate_position(:, c) - x)**2) >= radius_squared) cycle
        if (skip_self .and. candidate(c) == row(k)) cycle
        neighbour(next) = candidate(c)
        next = next + 1
      end do
    end do
  end subroutine list_near
end module dosui_neighbours

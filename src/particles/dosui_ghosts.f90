!! Ghost points: copies of other ranks' points that lie near this rank's own.
!!
!! Space is divided into bins as wide as the radius. A distributed directory (bin -> rank) learns
!! which ranks want a bin and which have points in it, and tells the latter whom to send to.
module dosui_ghosts
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_index_map, only: index_map_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_point_set, only: point_set_t
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  public :: find_ghosts, gather_field

contains

  subroutine find_ghosts(comm, set, position_handle, n_wanting, wanting, radius, map)
    !! Fetches the points of a set that lie in bins next to this rank's wanting positions, and
    !! gathers all their halo fields and identities. Collective.
    type(communicator_t), intent(in) :: comm
    type(point_set_t), intent(inout) :: set
    integer, intent(in) :: position_handle              !! field of the set that holds positions
    integer, intent(in) :: n_wanting
    real(wp), intent(in) :: wanting(ndim, n_wanting)    !! e.g. own particles [m]
    real(wp), intent(in) :: radius                      !! [m]
    type(index_map_t), intent(inout) :: map
    integer, allocatable :: to_rank(:), index(:)
    integer(i8), allocatable :: id(:, :)
    integer :: n_ghost, k, n

    call match_bins(comm, bins_around(n_wanting, wanting, radius), set%count, &
                    set%field(position_handle)%values, radius, to_rank, index)
    call map%init_halo(comm, set%count, to_rank, index, n_ghost)
    call set%resize(set%count, n_ghost)
    n = set%count + n_ghost
    allocate (id(1, n))
    id(1, :) = set%id(1:n)
    call map%gather_longs(comm, 1, id)
    set%id(1:n) = id(1, :)
    do k = 1, size(set%field)
      if (set%field(k)%halo) call gather_field(comm, set, map, k)
    end do
  end subroutine find_ghosts

  subroutine gather_field(comm, set, map, handle)
    !! Brings one halo field of the ghosts up to date.
    type(communicator_t), intent(in) :: comm
    type(point_set_t), intent(inout) :: set
    type(index_map_t), intent(inout) :: map
    integer, intent(in) :: handle

    call map%gather(comm, set%field(handle)%width, set%field(handle)%values)
  end subroutine gather_field

  subroutine find_bins(n, position, width, keys)
    !! Bin of each position.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    real(wp), intent(in) :: width
    integer(i8), allocatable, intent(out) :: keys(:)
    integer :: p

    allocate (keys(n))
    do p = 1, n
      keys(p) = pack_key(floor(position(:, p)/width))
    end do
  end subroutine find_bins

  function bins_around(n, position, width) result(keys)
    !! Distinct bins that hold a position or touch one that does.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)
    real(wp), intent(in) :: width
    integer(i8), allocatable :: keys(:), around(:), own(:)
    integer, allocatable :: order(:)
    integer :: k, b, d, digit, ijk(3), offset(ndim)

    call find_bins(n, position, width, own)
    call sort_permutation(own, order)
    own = unique_sorted(own(order))
    allocate (around(size(own)*3**ndim))
    do b = 1, size(own)
      ijk = unpack_key(own(b))
      do k = 0, 3**ndim - 1
        digit = k
        do d = 1, ndim
          offset(d) = mod(digit, 3) - 1
          digit = digit/3
        end do
        around((b - 1)*3**ndim + k + 1) = pack_key(ijk(1:ndim) + offset)
      end do
    end do
    call sort_permutation(around, order)
    keys = unique_sorted(around(order))
  end function bins_around

  subroutine match_bins(comm, wanted, n, position, width, to_rank, index)
    !! Which own points go to which ranks: those in bins that other ranks want.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: wanted(:)      !! bins, sorted
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    real(wp), intent(in) :: width
    integer, allocatable, intent(out) :: to_rank(:), index(:)
    integer(i8), allocatable :: own(:), bins(:), reply(:)
    integer, allocatable :: order(:), start(:)
    integer :: k, b, p, total, pass, bin

    call find_bins(n, position, width, own)
    call sort_permutation(own, order)
    bins = unique_sorted(own(order))
    allocate (start(size(bins) + 1))
    bin = 0
    do p = 1, n
      if (p > 1) then
        if (own(order(p)) == own(order(p - 1))) cycle
      end if
      bin = bin + 1
      start(bin) = p
    end do
    start(size(bins) + 1) = n + 1
    call ask_who_wants(comm, wanted, bins, reply)
    do pass = 1, 2
      if (pass == 2) allocate (to_rank(total), index(total))
      total = 0
      do k = 1, size(reply), 2
        b = binary_search(bins, reply(k))
        do p = start(b), start(b + 1) - 1
          total = total + 1
          if (pass == 1) cycle
          to_rank(total) = int(reply(k + 1))
          index(total) = order(p)
        end do
      end do
    end do
  end subroutine match_bins

  subroutine ask_who_wants(comm, wanted, owned, reply)
    !! Pairs (own bin, other rank that wants it).
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: wanted(:), owned(:)
    integer(i8), allocatable, intent(out) :: reply(:)
    integer(i8), allocatable :: wanted_here(:), owned_here(:), pairs(:), grouped(:)
    integer, allocatable :: wanted_count(:), owned_count(:), count(:), order(:), wanter(:)
    integer(i8), allocatable :: sorted(:)
    integer :: rank, k, first, n, pass, p

    call send_to_directory(comm, wanted, wanted_here, wanted_count)
    call send_to_directory(comm, owned, owned_here, owned_count)
    allocate (wanter(size(wanted_here)))
    first = 0
    do rank = 0, comm%size - 1
      wanter(first + 1:first + wanted_count(rank)) = rank
      first = first + wanted_count(rank)
    end do
    call sort_permutation(wanted_here, order)
    sorted = wanted_here(order)
    ! Replies in the order of the owners, so they are grouped by rank already.
    allocate (count(0:comm%size - 1), source=0)
    do pass = 1, 2
      if (pass == 2) allocate (pairs(2*n))
      n = 0
      k = 0
      do rank = 0, comm%size - 1
        do p = 1, owned_count(rank)
          k = k + 1
          first = lower_bound(sorted, owned_here(k))
          do while (first <= size(sorted))
            if (sorted(first) /= owned_here(k)) exit
            if (wanter(order(first)) /= rank) then
              n = n + 1
              if (pass == 1) count(rank) = count(rank) + 2
              if (pass == 2) pairs(2*n - 1:2*n) = [owned_here(k), int(wanter(order(first)), i8)]
            end if
            first = first + 1
          end do
        end do
      end do
    end do
    call move_alloc(pairs, grouped)
    call comm%exchange(grouped, count, reply, owned_count)
  end subroutine ask_who_wants

  subroutine send_to_directory(comm, keys, arrived, arrived_count)
    !! Sends keys to the ranks that keep the directory of them.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: keys(:)
    integer(i8), allocatable, intent(out) :: arrived(:)
    integer, allocatable, intent(out) :: arrived_count(:)
    integer, allocatable :: count(:), order(:)
    integer(i8), allocatable :: rank_of(:)
    integer :: k

    allocate (rank_of(size(keys)))
    allocate (count(0:comm%size - 1), source=0)
    do k = 1, size(keys)
      rank_of(k) = modulo(keys(k)/7_i8 + ishft(keys(k), -21), int(comm%size, i8))
      count(rank_of(k)) = count(rank_of(k)) + 1
    end do
    call sort_permutation(rank_of, order)
    call comm%exchange(keys(order), count, arrived, arrived_count)
  end subroutine send_to_directory

  pure integer function lower_bound(sorted, key) result(first)
    !! First entry that is not below the key; one past the end when there is none.
    integer(i8), intent(in) :: sorted(:)
    integer(i8), intent(in) :: key
    integer :: low, high, middle

    low = 1
    high = size(sorted) + 1
    do while (low < high)
      middle = low + (high - low)/2
      if (sorted(middle) < key) then
        low = middle + 1
      else
        high = middle
      end if
    end do
    first = low
  end function lower_bound
end module dosui_ghosts

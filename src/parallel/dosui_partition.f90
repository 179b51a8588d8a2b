!! Which rank owns which brick of cells: METIS on the graph of occupied bricks.
module dosui_partition
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_keys, only: pack_key, unpack_key, key_in_range
  use dosui_metis, only: metis_partition
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  public :: partition_bricks

  type, public :: partition_statistics_t
    !! How good a partition is.
    real(wp) :: imbalance = 1.0_wp   !! weight of the heaviest rank over the mean [-]
    integer :: edge_cut = 0          !! faces between bricks of different ranks
    integer :: n_brick = 0           !! bricks of all ranks
    integer :: n_idle = 0            !! ranks that own none
  end type partition_statistics_t

  real(wp), parameter :: weight_total = 1.0e9_wp      !! of METIS's integer weights, below 2**31
  real(wp), parameter :: small_imbalance = 1.05_wp    !! METIS's own tolerance is 1.03

contains

  subroutine partition_bricks(comm, brick_key, weight, owner_key, owner_rank, statistics, err)
    !! Divides the bricks so that ranks carry nearly equal weights with few faces between them.
    !! Collective. Bricks are coarse, hence few: rank 0 divides them and tells the others. With
    !! fewer bricks than ranks, the last ranks own nothing.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: brick_key(:)                 !! of local bricks, may repeat
    real(wp), intent(in) :: weight(:)                       !! cost of each, not negative [any unit]
    integer(i8), allocatable, intent(out) :: owner_key(:)   !! all bricks, sorted
    integer, allocatable, intent(out) :: owner_rank(:)      !! their owners
    type(partition_statistics_t), intent(out) :: statistics
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: key(:), keys(:)
    real(wp), allocatable :: sums(:), weights(:), total(:)
    integer, allocatable :: send_count(:), recv_count(:)

    allocate (owner_key(0), owner_rank(0))
    if (.not. all(weight >= 0.0_wp .and. weight <= huge(1.0_wp))) then
      call err%set('partition: the weight of a brick is negative or not a number')
    end if
    call comm%agree(err)
    if (err%failed()) return
    call sum_by_key(brick_key, weight, key, sums)
    allocate (send_count(0:comm%size - 1), source=0)
    send_count(0) = size(key)
    call comm%exchange(key, send_count, keys, recv_count)
    call comm%exchange(sums, send_count, weights, recv_count)
    allocate (total(0))
    if (comm%is_root()) then
      call sum_by_key(keys, weights, owner_key, total)
      deallocate (owner_rank)
      allocate (owner_rank(size(owner_key)))
      call divide(owner_key, total, comm%size, owner_rank, statistics)
    end if
    call broadcast_partition(comm, owner_key, owner_rank, statistics)
  end subroutine partition_bricks

  subroutine sum_by_key(key, weight, unique, total)
    !! Adds the weights of equal keys, in their order.
    integer(i8), intent(in) :: key(:)
    real(wp), intent(in) :: weight(:)
    integer(i8), allocatable, intent(out) :: unique(:)   !! sorted
    real(wp), allocatable, intent(out) :: total(:)
    integer, allocatable :: order(:)
    integer :: k, n

    call sort_permutation(key, order)
    unique = unique_sorted(key(order))
    allocate (total(size(unique)), source=0.0_wp)
    n = min(1, size(unique))
    do k = 1, size(order)
      if (key(order(k)) /= unique(n)) n = n + 1
      total(n) = total(n) + weight(order(k))
    end do
  end subroutine sum_by_key

  subroutine broadcast_partition(comm, owner_key, owner_rank, statistics)
    !! Root's result for all ranks.
    type(communicator_t), intent(in) :: comm
    integer(i8), allocatable, intent(inout) :: owner_key(:)
    integer, allocatable, intent(inout) :: owner_rank(:)
    type(partition_statistics_t), intent(inout) :: statistics

    call comm%broadcast(statistics%imbalance)
    call comm%broadcast(statistics%edge_cut)
    call comm%broadcast(statistics%n_brick)
    call comm%broadcast(statistics%n_idle)
    if (.not. comm%is_root()) then
      deallocate (owner_key, owner_rank)
      allocate (owner_key(statistics%n_brick), owner_rank(statistics%n_brick))
    end if
    call comm%broadcast(owner_key)
    call comm%broadcast(owner_rank)
  end subroutine broadcast_partition

  subroutine divide(key, weight, n_rank, owner, statistics)
    !! Serial partition of the brick graph. METIS can fail, leave parts empty or balance badly on
    !! graphs of few or very unequal bricks; cutting the sorted bricks into intervals then serves.
    integer(i8), intent(in) :: key(:)           !! sorted
    real(wp), intent(in) :: weight(:)
    integer, intent(in) :: n_rank
    integer, intent(out) :: owner(:)            !! from 0
    type(partition_statistics_t), intent(out) :: statistics
    type(partition_statistics_t) :: by_metis
    integer, allocatable :: start(:), adjacency(:), metis_owner(:)
    logical :: is_done

    call face_neighbours(key, start, adjacency)
    call cut_intervals(weight, n_rank, owner)
    statistics = judge(weight, n_rank, owner, start, adjacency)
    if (n_rank == 1 .or. size(key) <= n_rank .or. size(adjacency) == 0) return
    allocate (metis_owner(size(key)))
    call metis_partition(start, adjacency, integer_weights(weight), n_rank, metis_owner, is_done)
    if (.not. is_done) return
    by_metis = judge(weight, n_rank, metis_owner, start, adjacency)
    if (by_metis%n_idle > 0) return
    if (by_metis%imbalance > max(small_imbalance, statistics%imbalance)) return
    if (by_metis%edge_cut >= statistics%edge_cut .and. &
        by_metis%imbalance >= statistics%imbalance) return
    owner = metis_owner
    statistics = by_metis
  end subroutine divide

  pure function integer_weights(weight) result(whole)
    !! Weights for METIS: positive integers whose sum stays below 2**31.
    real(wp), intent(in) :: weight(:)
    integer :: whole(size(weight))
    real(wp) :: largest, scale
    integer :: k

    largest = maxval(weight)
    scale = 0.0_wp
    if (largest > 0.0_wp) scale = weight_total/sum(weight/largest)
    do k = 1, size(weight)
      whole(k) = 1
      if (scale > 0.0_wp) whole(k) = max(1, nint(scale*(weight(k)/largest)))
    end do
  end function integer_weights

  subroutine face_neighbours(key, start, adjacency)
    !! Graph of the bricks that share a face.
    integer(i8), intent(in) :: key(:)                      !! sorted
    integer, allocatable, intent(out) :: start(:)          !! (n+1) from 0
    integer, allocatable, intent(out) :: adjacency(:)      !! from 0
    integer, allocatable :: found(:)
    integer :: k, d, side, other, n, ijk(3)

    allocate (start(size(key) + 1), found(6*size(key)))
    n = 0
    do k = 1, size(key)
      start(k) = n
      do d = 1, 3
        do side = -1, 1, 2
          ijk = unpack_key(key(k))
          ijk(d) = ijk(d) + side
          if (.not. key_in_range(ijk)) cycle
          other = binary_search(key, pack_key(ijk))
          if (other == 0) cycle
          n = n + 1
          found(n) = other - 1
        end do
      end do
    end do
    start(size(key) + 1) = n
    adjacency = found(:n)
  end subroutine face_neighbours

  pure subroutine cut_intervals(weight, n_rank, owner)
    !! Cuts the sorted bricks (layers from bottom to top) into intervals of nearly equal weight; no
    !! rank is left without a brick if there are enough of them.
    real(wp), intent(in) :: weight(:)
    integer, intent(in) :: n_rank
    integer, intent(out) :: owner(:)     !! from 0
    real(wp) :: largest, total, before, middle
    integer :: k, n, wanted, lowest, highest

    n = size(weight)
    if (n == 0) return
    largest = maxval(weight)
    if (.not. largest > 0.0_wp) largest = 1.0_wp
    total = sum(weight/largest)
    before = 0.0_wp
    highest = 0
    do k = 1, n
      middle = before + 0.5_wp*weight(k)/largest
      before = before + weight(k)/largest
      wanted = 0
      if (total > 0.0_wp) wanted = int(middle/total*real(n_rank, wp))
      lowest = min(n_rank, n) - 1 - (n - k)     ! bricks left must serve the ranks left
      owner(k) = max(lowest, min(wanted, highest, n_rank - 1))
      highest = owner(k) + 1
    end do
  end subroutine cut_intervals

  pure function judge(weight, n_rank, owner, start, adjacency) result(statistics)
    !! Balance and cut of a partition.
    real(wp), intent(in) :: weight(:)
    integer, intent(in) :: n_rank
    integer, intent(in) :: owner(:)
    integer, intent(in) :: start(:), adjacency(:)
    type(partition_statistics_t) :: statistics
    real(wp) :: load(0:n_rank - 1), largest
    integer :: n_owned(0:n_rank - 1)
    integer :: k, e

    load = 0.0_wp
    n_owned = 0
    largest = 1.0_wp
    if (size(weight) > 0) largest = max(maxval(weight), tiny(1.0_wp))
    statistics%n_brick = size(weight)
    do k = 1, size(weight)
      load(owner(k)) = load(owner(k)) + weight(k)/largest
      n_owned(owner(k)) = n_owned(owner(k)) + 1
      do e = start(k) + 1, start(k + 1)
        if (owner(adjacency(e) + 1) > owner(k)) statistics%edge_cut = statistics%edge_cut + 1
      end do
    end do
    statistics%n_idle = count(n_owned == 0)
    if (sum(load) > 0.0_wp) statistics%imbalance = maxval(load)*real(n_rank, wp)/sum(load)
  end function judge
end module dosui_partition

!! Which rank owns which brick of cells: METIS on the graph of occupied bricks.
module dosui_partition
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_metis, only: metis_partition
  use dosui_sort, only: binary_search, sort_permutation, unique_sorted
  implicit none
  private

  public :: partition_bricks

  type, public :: partition_statistics_t
    real(wp) :: imbalance = 1.0_wp   !! heaviest rank over mean [-]
    integer :: edge_cut = 0          !! cut faces between bricks
    integer :: n_brick = 0
  end type partition_statistics_t

contains

  subroutine partition_bricks(comm, brick_key, weight, owner_key, owner_rank, statistics, err)
    !! Divides the bricks so that ranks carry equal weights. Collective; the bricks are few, so
    !! rank 0 does it and tells the others. With fewer bricks than ranks some ranks own nothing.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: brick_key(:)               !! keys of local bricks, may repeat
    real(wp), intent(in) :: weight(:)                     !! cost of each
    integer(i8), allocatable, intent(out) :: owner_key(:) !! sorted keys of all bricks
    integer, allocatable, intent(out) :: owner_rank(:)    !! their owners
    type(partition_statistics_t), intent(out) :: statistics
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: keys(:)
    real(wp), allocatable :: weights(:), total(:), load(:)
    integer, allocatable :: count(:), recv_count(:), order(:)
    integer :: k, place, header(1)

    allocate (count(0:comm%size - 1), source=0)
    count(0) = size(brick_key)
    call comm%exchange(brick_key, count, keys, recv_count)
    call comm%exchange(weight, count, weights, recv_count)
    allocate (total(0))
    if (comm%is_root()) then
      call sort_permutation(keys, order)
      owner_key = unique_sorted(keys(order))
      deallocate (total)
      allocate (total(size(owner_key)), source=0.0_wp)
      do k = 1, size(keys)
        place = binary_search(owner_key, keys(k))
        total(place) = total(place) + weights(k)
      end do
      allocate (owner_rank(size(owner_key)))
      call divide(owner_key, total, comm%size, owner_rank, statistics%edge_cut, err)
      header(1) = size(owner_key)
    end if
    call comm%agree(err)
    call comm%broadcast(header)
    if (.not. comm%is_root()) then
      deallocate (total)
      allocate (owner_key(header(1)), owner_rank(header(1)), total(header(1)))
    end if
    call comm%broadcast(owner_key)
    call comm%broadcast(owner_rank)
    call comm%broadcast(total)
    statistics%n_brick = header(1)
    allocate (load(0:comm%size - 1), source=0.0_wp)
    do k = 1, size(owner_key)
      load(owner_rank(k)) = load(owner_rank(k)) + total(k)
    end do
    if (sum(load) > 0.0_wp) statistics%imbalance = maxval(load)*real(comm%size, wp)/sum(load)
  end subroutine partition_bricks

  subroutine divide(key, weight, n_rank, owner, edge_cut, err)
    !! Serial partition of the brick graph; neighbours share a face.
    integer(i8), intent(in) :: key(:)
    real(wp), intent(in) :: weight(:)
    integer, intent(in) :: n_rank
    integer, intent(out) :: owner(:)
    integer, intent(out) :: edge_cut
    type(error_t), intent(inout) :: err
    integer, allocatable :: start(:), adjacency(:), load(:)
    integer :: n, k, d, side, ijk(3), other, n_edge
    logical :: ok

    n = size(key)
    edge_cut = 0
    owner = 0
    if (n_rank == 1 .or. n == 0) return
    if (n <= n_rank) then   ! METIS may leave parts empty and others double: one brick each instead
      owner = [(k - 1, k=1, n)]
      return
    end if
    allocate (start(n + 1), adjacency(6*n))
    n_edge = 0
    do k = 1, n
      start(k) = n_edge
      do d = 1, 3
        do side = -1, 1, 2
          ijk = unpack_key(key(k))
          ijk(d) = ijk(d) + side
          other = binary_search(key, pack_key(ijk))
          if (other == 0) cycle
          n_edge = n_edge + 1
          adjacency(n_edge) = other - 1
        end do
      end do
    end do
    start(n + 1) = n_edge
    load = max(1, nint(weight/max(sum(weight), tiny(1.0_wp))*1.0e8_wp))
    call metis_partition(start, adjacency(1:n_edge), load, n_rank, owner, edge_cut, ok)
    if (.not. ok) call err%set('METIS could not partition the bricks of cells')
  end subroutine divide
end module dosui_partition

!! Moves rows of data to the ranks that shall own them.
module dosui_migration
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_sort, only: sort_permutation
  implicit none
  private

  public :: migrate_rows

contains

  subroutine migrate_rows(comm, destination, real_rows, int_rows)
    !! Sends every row to its destination. Afterwards: rows that stayed, in order, then arrivals by
    !! rank and in the sender's order. Collective.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: destination(:)                       !! rank of each row
    real(wp), allocatable, intent(inout) :: real_rows(:, :)     !! (reals, rows)
    integer(i8), allocatable, intent(inout) :: int_rows(:, :)   !! (integers, rows)
    real(wp), allocatable :: real_recv(:), real_kept(:, :)
    integer(i8), allocatable :: int_recv(:), int_kept(:, :)
    integer, allocatable :: stay(:), go(:), order(:), count(:), recv_count(:)
    integer :: k, nr, ni, n_arrived

    nr = size(real_rows, 1)
    ni = size(int_rows, 1)
    stay = pack([(k, k=1, size(destination))], destination == comm%rank)
    go = pack([(k, k=1, size(destination))], destination /= comm%rank)
    call sort_permutation(int(destination(go), i8), order)
    go = go(order)
    allocate (count(0:comm%size - 1), source=0)
    do k = 1, size(go)
      count(destination(go(k))) = count(destination(go(k))) + 1
    end do
    call comm%exchange(reshape(real_rows(:, go), [nr*size(go)]), nr*count, real_recv, recv_count)
    call comm%exchange(reshape(int_rows(:, go), [ni*size(go)]), ni*count, int_recv, recv_count)
    n_arrived = sum(recv_count)/max(ni, 1)
    allocate (real_kept(nr, size(stay) + n_arrived), int_kept(ni, size(stay) + n_arrived))
    real_kept(:, 1:size(stay)) = real_rows(:, stay)
    int_kept(:, 1:size(stay)) = int_rows(:, stay)
    real_kept(:, size(stay) + 1:) = reshape(real_recv, [nr, n_arrived])
    int_kept(:, size(stay) + 1:) = reshape(int_recv, [ni, n_arrived])
    call move_alloc(real_kept, real_rows)
    call move_alloc(int_kept, int_rows)
  end subroutine migrate_rows
end module dosui_migration

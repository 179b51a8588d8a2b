!! Moves rows of data to the ranks that shall own them.
module dosui_migration
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_sort, only: sort_permutation
  use dosui_text, only: to_text
  implicit none
  private

  public :: migrate_rows

contains

  subroutine migrate_rows(comm, destination, real_rows, int_rows, err)
    !! Sends every row to its destination. Afterwards: the rows that stayed, in their order, then
    !! the arrivals by rank and in the sender's order. Collective.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: destination(:)                       !! (n) rank of each row
    real(wp), allocatable, intent(inout) :: real_rows(:, :)     !! (nr, n) replaced [any unit]
    integer(i8), allocatable, intent(inout) :: int_rows(:, :)   !! (ni, n) replaced
    type(error_t), intent(inout), optional :: err
      !! a destination that does not exist; nothing has moved then. Without it that aborts.
    type(error_t) :: trouble
    integer, allocatable :: stays(:), leaves(:), send_count(:), recv_count(:)
    real(wp), allocatable :: real_send(:), real_recv(:)
    integer(i8), allocatable :: int_send(:), int_recv(:)
    integer :: nr, ni, n_arrived

    call check_destinations(comm, destination, trouble)
    if (trouble%failed()) then
      if (.not. present(err)) call comm%abort(trouble%message)
      if (present(err)) call err%set(trouble%message)
      return
    end if
    nr = size(real_rows, 1)
    ni = size(int_rows, 1)
    call sort_out(comm, destination, stays, leaves, send_count)
    allocate (real_send(nr*size(leaves)), int_send(ni*size(leaves)))
    call pick_reals(nr, size(destination), real_rows, size(leaves), leaves, real_send)
    call pick_longs(ni, size(destination), int_rows, size(leaves), leaves, int_send)
    recv_count = arriving(comm, send_count)
    n_arrived = sum(recv_count)
    call comm%exchange(real_send, nr*send_count, real_recv, recv_count)
    call comm%exchange(int_send, ni*send_count, int_recv, recv_count)
    call replace_reals(nr, stays, n_arrived, real_recv, real_rows)
    call replace_longs(ni, stays, n_arrived, int_recv, int_rows)
  end subroutine migrate_rows

  subroutine check_destinations(comm, destination, err)
    !! All rows must go to ranks that exist. Collective.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: destination(:)
    type(error_t), intent(inout) :: err
    integer :: k

    do k = 1, size(destination)
      if (destination(k) >= 0 .and. destination(k) < comm%size) cycle
      call err%set('migration: rank '//to_text(destination(k))//' does not exist (row '// &
                   to_text(k)//' of rank '//to_text(comm%rank)//')')
      exit
    end do
    call comm%agree(err)
  end subroutine check_destinations

  subroutine sort_out(comm, destination, stays, leaves, send_count)
    !! Which rows stay, and which leave, these ordered by destination.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: destination(:)
    integer, allocatable, intent(out) :: stays(:), leaves(:)
    integer, allocatable, intent(out) :: send_count(:)   !! (0:size-1) rows
    integer(i8), allocatable :: to_rank(:)
    integer, allocatable :: order(:)
    integer :: k, n_stay, n_leave

    n_leave = count(destination /= comm%rank)
    allocate (stays(size(destination) - n_leave), leaves(n_leave), to_rank(n_leave))
    allocate (send_count(0:comm%size - 1), source=0)
    n_stay = 0
    n_leave = 0
    do k = 1, size(destination)
      if (destination(k) == comm%rank) then
        n_stay = n_stay + 1
        stays(n_stay) = k
      else
        n_leave = n_leave + 1
        leaves(n_leave) = k
        to_rank(n_leave) = int(destination(k), i8)
        send_count(destination(k)) = send_count(destination(k)) + 1
      end if
    end do
    call sort_permutation(to_rank, order)
    leaves = leaves(order)
  end subroutine sort_out

  function arriving(comm, send_count) result(recv_count)
    !! Rows that come from every rank.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: send_count(0:)
    integer, allocatable :: recv_count(:)
    integer, allocatable :: one_each(:), count_of_counts(:)

    allocate (one_each(0:comm%size - 1), source=1)
    call comm%exchange(send_count, one_each, recv_count, count_of_counts)
  end function arriving

  pure subroutine pick_reals(nr, n_row, rows, n, row, buffer)
    !! Kernel: copies listed rows into a buffer.
    integer, intent(in) :: nr, n_row, n
    integer, intent(in) :: row(n)
    real(wp), intent(in) :: rows(nr, n_row)
    real(wp), intent(inout) :: buffer(nr, n)
    integer :: k

    do k = 1, n
      buffer(:, k) = rows(:, row(k))
    end do
  end subroutine pick_reals

  pure subroutine pick_longs(ni, n_row, rows, n, row, buffer)
    !! Kernel: copies listed rows into a buffer.
    integer, intent(in) :: ni, n_row, n
    integer, intent(in) :: row(n)
    integer(i8), intent(in) :: rows(ni, n_row)
    integer(i8), intent(inout) :: buffer(ni, n)
    integer :: k

    do k = 1, n
      buffer(:, k) = rows(:, row(k))
    end do
  end subroutine pick_longs

  subroutine replace_reals(nr, stays, n_arrived, arrived, rows)
    !! Rows that stayed, then arrivals.
    integer, intent(in) :: nr, n_arrived
    integer, intent(in) :: stays(:)
    real(wp), intent(in) :: arrived(nr, n_arrived)
    real(wp), allocatable, intent(inout) :: rows(:, :)
    real(wp), allocatable :: new(:, :)
    integer :: k

    allocate (new(nr, size(stays) + n_arrived))
    do k = 1, size(stays)
      new(:, k) = rows(:, stays(k))
    end do
    do k = 1, n_arrived
      new(:, size(stays) + k) = arrived(:, k)
    end do
    call move_alloc(new, rows)
  end subroutine replace_reals

  subroutine replace_longs(ni, stays, n_arrived, arrived, rows)
    !! Rows that stayed, then arrivals.
    integer, intent(in) :: ni, n_arrived
    integer, intent(in) :: stays(:)
    integer(i8), intent(in) :: arrived(ni, n_arrived)
    integer(i8), allocatable, intent(inout) :: rows(:, :)
    integer(i8), allocatable :: new(:, :)
    integer :: k

    allocate (new(ni, size(stays) + n_arrived))
    do k = 1, size(stays)
      new(:, k) = rows(:, stays(k))
    end do
    do k = 1, n_arrived
      new(:, size(stays) + k) = arrived(:, k)
    end do
    call move_alloc(new, rows)
  end subroutine replace_longs
end module dosui_migration

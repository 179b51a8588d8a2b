!! Rows of datasets that all ranks write, copy and sum, each its share of them.
module dosui_result_rows
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_checksum, only: checksum_t
  use dosui_communicator, only: communicator_t
  use dosui_sort, only: sort_permutation
  use dosui_hdf5, only: hid_t, hdf5_open_dataset, hdf5_close_dataset, hdf5_write_rows, &
                        hdf5_read_rows
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private

  public :: plan_redistribution, write_columns, write_sequence, write_nan, share, copy_reals, &
            copy_integers, copy_column, sum_reals, sum_integers, checksums_of_rows

  integer, parameter :: copy_rows = 1000000   !! rows a rank holds while copying

contains

  subroutine plan_redistribution(comm, n, id, outgoing, send_count, order, sorted_id)
    !! Every rank gets an interval of ids; intervals of rising rank, of about equal size.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n
    integer(i8), intent(in) :: id(n)
    integer, allocatable, intent(out) :: outgoing(:)     !! own points ordered by receiving rank
    integer, allocatable, intent(out) :: send_count(:)   !! (0:size-1)
    integer, allocatable, intent(out) :: order(:)        !! arrived points by increasing id
    integer(i8), allocatable, intent(out) :: sorted_id(:)
    integer(i8), allocatable :: send(:), arrived(:)
    integer, allocatable :: next(:), arrived_count(:)
    integer(i8) :: first_id, last_id, block
    integer :: i, rank

    first_id = comm%minimum(minval([huge(1_i8), id]))
    last_id = comm%maximum(maxval([-huge(1_i8), id]))
    block = 1_i8
    if (last_id >= first_id) block = (last_id - first_id)/comm%size + 1_i8
    allocate (send_count(0:comm%size - 1), source=0)
    allocate (next(0:comm%size - 1), source=1)
    do i = 1, n
      rank = int((id(i) - first_id)/block)
      send_count(rank) = send_count(rank) + 1
    end do
    do rank = 1, comm%size - 1
      next(rank) = next(rank - 1) + send_count(rank - 1)
    end do
    allocate (outgoing(n), send(n))
    do i = 1, n
      rank = int((id(i) - first_id)/block)
      outgoing(next(rank)) = i
      send(next(rank)) = id(i)
      next(rank) = next(rank) + 1
    end do
    call comm%exchange(send, send_count, arrived, arrived_count)
    allocate (order(size(arrived)), sorted_id(size(arrived)))
    call sort_permutation(arrived, order)
    do i = 1, size(arrived)
      sorted_id(i) = arrived(order(i))
    end do
  end subroutine plan_redistribution

  subroutine write_columns(comm, dataset, first_row, width, n, values, outgoing, send_count, &
                           order, checksum, err)
    !! Sends the rows of one field to their ranks and writes them there; the values are used up.
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row          !! of this rank in the file
    integer, intent(in) :: width, n
    real(wp), allocatable, intent(inout) :: values(:, :)   !! (width, n) [unit of the dataset]
    integer, intent(in) :: outgoing(n), send_count(0:), order(:)
    type(checksum_t), intent(inout) :: checksum   !! of what this rank writes
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: send(:), arrived(:), sorted(:, :)
    integer, allocatable :: arrived_count(:)
    integer :: j

    ! one component after the other, in place where possible: little memory is in flight
    if (size(order) /= n) allocate (sorted(width, size(order)))
    do j = 1, width
      send = values(j, outgoing)
      call comm%exchange(send, send_count, arrived, arrived_count)
      if (allocated(sorted)) then
        sorted(j, :) = arrived(order)
      else
        values(j, :) = arrived(order)
      end if
    end do
    if (allocated(sorted)) call move_alloc(sorted, values)
    call checksum%add_reals(width*size(order), values)
    call hdf5_write_rows(dataset, first_row, width, size(order), values, err)
  end subroutine write_columns

  subroutine write_sequence(comm, dataset, first_row, n, err)
    !! Writes 0, 1, …, n - 1 from a row on; every rank its share, block by block.
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row, n
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: number(:)
    integer(i8) :: first, last, row
    integer :: i, m

    call share(n, comm%rank, comm%size, first, last)
    allocate (number(int(min(int(copy_rows, i8), last - first + 1_i8))))
    do row = first, last, int(copy_rows, i8)
      m = int(min(int(copy_rows, i8), last - row + 1_i8))
      do i = 1, m
        number(i) = row + i - 2_i8
      end do
      call hdf5_write_rows(dataset, first_row + row - 1_i8, m, number, err)
    end do
  end subroutine write_sequence

  subroutine write_nan(dataset, first_row, last_row, err)
    !! Marks rows of a history as unused.
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row, last_row
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: nan(:)
    integer(i8) :: row
    integer :: n

    n = int(min(int(copy_rows, i8), max(0_i8, last_row - first_row + 1_i8)))
    allocate (nan(n))
    nan = ieee_value(1.0_wp, ieee_quiet_nan)
    do row = first_row, last_row, int(max(1, n), i8)
      call hdf5_write_rows(dataset, row, int(min(int(n, i8), last_row - row + 1_i8)), nan, err)
    end do
  end subroutine write_nan

  pure subroutine share(n, rank, n_rank, first, last)
    !! The contiguous part of 1, …, n that falls to a rank.
    integer(i8), intent(in) :: n
    integer, intent(in) :: rank, n_rank
    integer(i8), intent(out) :: first, last
    integer(i8) :: part, rest

    part = n/n_rank
    rest = mod(n, int(n_rank, i8))
    first = rank*part + min(int(rank, i8), rest) + 1_i8
    last = first + part - 1_i8
    if (rank < rest) last = last + 1_i8
  end subroutine share

  subroutine copy_reals(comm, source, destination, width, n_row, err)
    !! Copies the first rows of a dataset, every rank its share.
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: source, destination
    integer, intent(in) :: width
    integer(i8), intent(in) :: n_row
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: buffer(:, :)
    integer(i8) :: first, last, row
    integer :: m

    call share(n_row, comm%rank, comm%size, first, last)
    allocate (buffer(width, int(min(int(copy_rows, i8), last - first + 1_i8))))
    do row = first, last, int(copy_rows, i8)
      m = int(min(int(copy_rows, i8), last - row + 1_i8))
      call hdf5_read_rows(source, row, width, m, buffer, err)
      call hdf5_write_rows(destination, row, width, m, buffer, err)
    end do
  end subroutine copy_reals

  subroutine copy_integers(comm, source, destination, n_row, err)
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: source, destination
    integer(i8), intent(in) :: n_row
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: buffer(:)
    integer(i8) :: first, last, row
    integer :: m

    call share(n_row, comm%rank, comm%size, first, last)
    allocate (buffer(int(min(int(copy_rows, i8), last - first + 1_i8))))
    do row = first, last, int(copy_rows, i8)
      m = int(min(int(copy_rows, i8), last - row + 1_i8))
      call hdf5_read_rows(source, row, m, buffer, err)
      call hdf5_write_rows(destination, row, m, buffer, err)
    end do
  end subroutine copy_integers

  subroutine copy_column(source, group, name, n, err)
    !! Copies the first rows of a history to the dataset of this name in a group.
    integer(hid_t), intent(in) :: source, group
    character(len=*), intent(in) :: name
    integer, intent(in) :: n
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: column(:)
    integer(hid_t) :: dataset

    allocate (column(n))
    call hdf5_open_dataset(group, name, dataset, err)
    call hdf5_read_rows(source, 1_i8, n, column, err)
    call hdf5_write_rows(dataset, 1_i8, n, column, err)
    call hdf5_close_dataset(dataset, err)
  end subroutine copy_column

  subroutine sum_reals(dataset, width, first, last, checksum, err)
    !! Adds rows of a dataset.
    integer(hid_t), intent(in) :: dataset
    integer, intent(in) :: width
    integer(i8), intent(in) :: first, last
    type(checksum_t), intent(inout) :: checksum
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: buffer(:, :)
    integer(i8) :: row
    integer :: m

    allocate (buffer(width, int(min(int(copy_rows, i8), max(0_i8, last - first + 1_i8)))), &
              source=0.0_wp)
    do row = first, last, int(copy_rows, i8)
      m = int(min(int(copy_rows, i8), last - row + 1_i8))
      call hdf5_read_rows(dataset, row, width, m, buffer, err)
      call checksum%add_reals(width*m, buffer)
    end do
  end subroutine sum_reals

  subroutine sum_integers(dataset, first, last, checksum, err)
    !! Adds rows of a dataset.
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first, last
    type(checksum_t), intent(inout) :: checksum
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: buffer(:)
    integer(i8) :: row
    integer :: m

    allocate (buffer(int(min(int(copy_rows, i8), max(0_i8, last - first + 1_i8)))), source=0_i8)
    do row = first, last, int(copy_rows, i8)
      m = int(min(int(copy_rows, i8), last - row + 1_i8))
      call hdf5_read_rows(dataset, row, m, buffer, err)
      call checksum%add(m, buffer)
    end do
  end subroutine sum_integers

  pure function checksums_of_rows(n_column, n, values) result(sums)
    !! One checksum a row of the histories.
    integer, intent(in) :: n_column, n
    real(wp), intent(in) :: values(:, :)   !! (column, row) [units of the columns]
    integer(i8) :: sums(n)
    type(checksum_t) :: checksum
    integer :: k

    do k = 1, n
      checksum = checksum_t()
      call checksum%add(n_column, values(:n_column, k))
      sums(k) = checksum%value()
    end do
  end function checksums_of_rows
end module dosui_result_rows

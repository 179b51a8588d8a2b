!! Communication between ranks. Reductions of reals add in rank order, so that repeated runs agree
!! bit for bit.
module dosui_communicator
  use, intrinsic :: iso_fortran_env, only: error_unit
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_is_nan
  use mpi_f08, only: MPI_Comm, MPI_COMM_WORLD, MPI_CHARACTER, MPI_INTEGER, MPI_INTEGER8, &
                     MPI_LOGICAL, MPI_REAL8, MPI_SUM, MPI_MAX, MPI_MIN, MPI_LOR, MPI_LAND, &
                     MPI_Init, MPI_Initialized, MPI_Finalize, MPI_Finalized, MPI_Abort, &
                     MPI_Comm_rank, MPI_Comm_size, MPI_Barrier, MPI_Bcast, MPI_Gather, &
                     MPI_Allgather, MPI_Allreduce, MPI_Exscan, MPI_Alltoall, MPI_Alltoallv, &
                     MPI_Comm_split_type, MPI_Comm_free, MPI_COMM_TYPE_SHARED, MPI_INFO_NULL
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  implicit none
  private

  public :: parallel_start, parallel_stop

  type, public :: communicator_t
    !! A group of ranks. Everything but `is_root` and `abort` is collective.
    type(MPI_Comm) :: handle
    integer :: rank = 0      !! of this process, counted from 0
    integer :: size = 1      !! ranks
  contains
    procedure :: init => communicator_init
    procedure :: is_root => communicator_is_root
    procedure :: ranks_on_node => communicator_ranks_on_node
    procedure :: barrier => communicator_barrier
    generic :: sum => sum_real, sum_integer, sum_long
    procedure :: sum_array => communicator_sum_array
    generic :: maximum => maximum_real, maximum_integer, maximum_long
    generic :: minimum => minimum_real, minimum_integer, minimum_long
    procedure :: maximum_location => communicator_maximum_location
    procedure :: any => communicator_any
    procedure :: all => communicator_all
    procedure :: prefix_sum => communicator_prefix_sum
    procedure :: gather_int => communicator_gather_int
    generic :: broadcast => broadcast_text, broadcast_reals, broadcast_longs, &
      broadcast_integers, broadcast_real, broadcast_long, broadcast_integer, broadcast_logical
    generic :: exchange => exchange_reals, exchange_longs, exchange_integers
    procedure :: agree => communicator_agree
    procedure :: abort => communicator_abort
    procedure, private :: sum_real, sum_integer, sum_long
    procedure, private :: maximum_real, maximum_integer, maximum_long
    procedure, private :: minimum_real, minimum_integer, minimum_long
    procedure, private :: broadcast_text, broadcast_reals, broadcast_longs, broadcast_integers
    procedure, private :: broadcast_real, broadcast_long, broadcast_integer, broadcast_logical
    procedure, private :: exchange_reals, exchange_longs, exchange_integers
  end type communicator_t

contains

  ! ---------------------------------------------------------------- start and stop

  subroutine parallel_start(comm, err)
    !! Starts MPI, unless the caller has, and gives the communicator of all ranks.
    type(communicator_t), intent(out) :: comm
    type(error_t), intent(inout) :: err
    logical :: is_started
    integer :: status

    call MPI_Initialized(is_started)
    if (.not. is_started) then
      call MPI_Init(status)
      if (status /= 0) then
        call err%set('MPI could not be started')
        return
      end if
    end if
    call comm%init(MPI_COMM_WORLD)
  end subroutine parallel_start

  subroutine parallel_stop()
    !! Ends MPI; all ranks together.
    logical :: is_stopped

    call MPI_Finalized(is_stopped)
    if (.not. is_stopped) call MPI_Finalize()
  end subroutine parallel_stop

  subroutine communicator_init(self, handle)
    !! Wraps an MPI communicator (which may be the one in `self`).
    class(communicator_t), intent(inout) :: self
    type(MPI_Comm), intent(in) :: handle

    self%handle = handle
    call MPI_Comm_rank(handle, self%rank)
    call MPI_Comm_size(handle, self%size)
  end subroutine communicator_init

  pure logical function communicator_is_root(self) result(is_root)
    !! Is this the rank that writes messages?
    class(communicator_t), intent(in) :: self

    is_root = self%rank == 0
  end function communicator_is_root

  integer function communicator_ranks_on_node(self) result(n)
    !! Ranks that share this rank's memory, itself included.
    class(communicator_t), intent(in) :: self
    type(MPI_Comm) :: node

    call MPI_Comm_split_type(self%handle, MPI_COMM_TYPE_SHARED, self%rank, MPI_INFO_NULL, node)
    call MPI_Comm_size(node, n)
    call MPI_Comm_free(node)
  end function communicator_ranks_on_node

  subroutine communicator_barrier(self)
    !! Waits for all ranks.
    class(communicator_t), intent(in) :: self

    call MPI_Barrier(self%handle)
  end subroutine communicator_barrier

  ! ---------------------------------------------------------------- sums

  real(wp) function sum_real(self, x) result(total)
    !! Sum over the ranks, added in rank order.
    class(communicator_t), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: values(1)

    values(1) = x
    call self%sum_array(values)
    total = values(1)
  end function sum_real

  subroutine communicator_sum_array(self, values)
    !! Sums over the ranks, entry by entry, added in rank order; the same on all ranks.
    class(communicator_t), intent(in) :: self
    real(wp), intent(inout) :: values(:)   !! [any unit]
    real(wp), allocatable :: partial(:, :), total(:)
    integer :: n, rank

    n = size(values)
    if (self%size == 1 .or. n == 0) return
    allocate (total(n))
    total = values
    if (self%is_root()) then
      allocate (partial(n, 0:self%size - 1))
    else
      allocate (partial(0, 0))
    end if
    call MPI_Gather(total, n, MPI_REAL8, partial, n, MPI_REAL8, 0, self%handle)
    if (self%is_root()) then
      total = partial(:, 0)
      do rank = 1, self%size - 1
        total = total + partial(:, rank)
      end do
    end if
    call MPI_Bcast(total, n, MPI_REAL8, 0, self%handle)
    values = total
  end subroutine communicator_sum_array

  integer function sum_integer(self, x) result(total)
    !! Sum over the ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(in) :: x

    call MPI_Allreduce(x, total, 1, MPI_INTEGER, MPI_SUM, self%handle)
  end function sum_integer

  integer(i8) function sum_long(self, x) result(total)
    !! Sum over the ranks.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(in) :: x

    call MPI_Allreduce(x, total, 1, MPI_INTEGER8, MPI_SUM, self%handle)
  end function sum_long

  integer(i8) function communicator_prefix_sum(self, n) result(before)
    !! Sum over the ranks below this one.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(in) :: n

    before = 0_i8
    call MPI_Exscan(n, before, 1, MPI_INTEGER8, MPI_SUM, self%handle)
    if (self%rank == 0) before = 0_i8
  end function communicator_prefix_sum

  ! ---------------------------------------------------------------- extremes

  real(wp) function maximum_real(self, x) result(most)
    !! Largest value of all ranks; not a number as soon as one rank's value is not.
    class(communicator_t), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: mine(2), extreme(2)

    mine = [x, 0.0_wp]
    if (ieee_is_nan(x)) mine = [-huge(x), 1.0_wp]
    call MPI_Allreduce(mine, extreme, 2, MPI_REAL8, MPI_MAX, self%handle)
    most = extreme(1)
    if (extreme(2) > 0.0_wp) most = ieee_value(most, ieee_quiet_nan)
  end function maximum_real

  integer function maximum_integer(self, x) result(most)
    !! Largest value of all ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(in) :: x

    call MPI_Allreduce(x, most, 1, MPI_INTEGER, MPI_MAX, self%handle)
  end function maximum_integer

  integer(i8) function maximum_long(self, x) result(most)
    !! Largest value of all ranks.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(in) :: x

    call MPI_Allreduce(x, most, 1, MPI_INTEGER8, MPI_MAX, self%handle)
  end function maximum_long

  real(wp) function minimum_real(self, x) result(least)
    !! Smallest value of all ranks; not a number as soon as one rank's value is not.
    class(communicator_t), intent(in) :: self
    real(wp), intent(in) :: x

    least = -self%maximum(-x)
  end function minimum_real

  integer function minimum_integer(self, x) result(least)
    !! Smallest value of all ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(in) :: x

    call MPI_Allreduce(x, least, 1, MPI_INTEGER, MPI_MIN, self%handle)
  end function minimum_integer

  integer(i8) function minimum_long(self, x) result(least)
    !! Smallest value of all ranks.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(in) :: x

    call MPI_Allreduce(x, least, 1, MPI_INTEGER8, MPI_MIN, self%handle)
  end function minimum_long

  subroutine communicator_maximum_location(self, x, rank_of_max)
    !! Largest value of all ranks and the lowest rank that has it. A value that is not a number
    !! counts as larger than any other, so that it is not overlooked.
    class(communicator_t), intent(in) :: self
    real(wp), intent(inout) :: x             !! in: of this rank, out: the largest [any unit]
    integer, intent(out) :: rank_of_max
    real(wp) :: most
    integer :: candidate

    most = self%maximum(x)
    candidate = self%size
    if (ieee_is_nan(most)) then
      if (ieee_is_nan(x)) candidate = self%rank
    else if (x >= most) then
      candidate = self%rank
    end if
    rank_of_max = self%minimum(candidate)
    x = most
  end subroutine communicator_maximum_location

  logical function communicator_any(self, flag) result(is_any)
    !! Is it true on any rank?
    class(communicator_t), intent(in) :: self
    logical, intent(in) :: flag

    call MPI_Allreduce(flag, is_any, 1, MPI_LOGICAL, MPI_LOR, self%handle)
  end function communicator_any

  logical function communicator_all(self, flag) result(is_all)
    !! Is it true on all ranks?
    class(communicator_t), intent(in) :: self
    logical, intent(in) :: flag

    call MPI_Allreduce(flag, is_all, 1, MPI_LOGICAL, MPI_LAND, self%handle)
  end function communicator_all

  ! ---------------------------------------------------------------- gather and broadcast

  function communicator_gather_int(self, n) result(all_n)
    !! The numbers of all ranks, on all ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(in) :: n
    integer :: all_n(0:self%size - 1)

    call MPI_Allgather(n, 1, MPI_INTEGER, all_n, 1, MPI_INTEGER, self%handle)
  end function communicator_gather_int

  subroutine broadcast_text(self, text)
    !! Root's text for all ranks; a text that root has not allocated arrives as ''.
    class(communicator_t), intent(in) :: self
    character(len=:), allocatable, intent(inout) :: text
    integer :: n

    n = 0
    if (self%is_root() .and. allocated(text)) n = len(text)
    call MPI_Bcast(n, 1, MPI_INTEGER, 0, self%handle)
    call broadcast_characters(self, 0, n, text)
  end subroutine broadcast_text

  subroutine broadcast_characters(self, root, n, text)
    !! The n characters of one rank for all ranks.
    type(communicator_t), intent(in) :: self
    integer, intent(in) :: root, n
    character(len=:), allocatable, intent(inout) :: text
    character(len=:), allocatable :: buffer

    allocate (character(len=n) :: buffer)
    if (n > 0) then
      if (self%rank == root) buffer = text
      call MPI_Bcast(buffer, n, MPI_CHARACTER, root, self%handle)
    end if
    call move_alloc(buffer, text)
  end subroutine broadcast_characters

  subroutine broadcast_reals(self, values)
    !! Root's values for all ranks.
    class(communicator_t), intent(in) :: self
    real(wp), intent(inout), contiguous :: values(:)   !! the same size everywhere

    call MPI_Bcast(values, size(values), MPI_REAL8, 0, self%handle)
  end subroutine broadcast_reals

  subroutine broadcast_longs(self, values)
    !! Root's values for all ranks.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(inout), contiguous :: values(:)   !! the same size everywhere

    call MPI_Bcast(values, size(values), MPI_INTEGER8, 0, self%handle)
  end subroutine broadcast_longs

  subroutine broadcast_integers(self, values)
    !! Root's values for all ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(inout), contiguous :: values(:)   !! the same size everywhere

    call MPI_Bcast(values, size(values), MPI_INTEGER, 0, self%handle)
  end subroutine broadcast_integers

  subroutine broadcast_real(self, x)
    !! Root's value for all ranks.
    class(communicator_t), intent(in) :: self
    real(wp), intent(inout) :: x

    call MPI_Bcast(x, 1, MPI_REAL8, 0, self%handle)
  end subroutine broadcast_real

  subroutine broadcast_long(self, x)
    !! Root's value for all ranks.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(inout) :: x

    call MPI_Bcast(x, 1, MPI_INTEGER8, 0, self%handle)
  end subroutine broadcast_long

  subroutine broadcast_integer(self, x)
    !! Root's value for all ranks.
    class(communicator_t), intent(in) :: self
    integer, intent(inout) :: x

    call MPI_Bcast(x, 1, MPI_INTEGER, 0, self%handle)
  end subroutine broadcast_integer

  subroutine broadcast_logical(self, flag)
    !! Root's flag for all ranks.
    class(communicator_t), intent(in) :: self
    logical, intent(inout) :: flag

    call MPI_Bcast(flag, 1, MPI_LOGICAL, 0, self%handle)
  end subroutine broadcast_logical

  ! ---------------------------------------------------------------- exchange

  subroutine exchange_reals(self, send, send_count, recv, recv_count)
    !! Every rank sends a piece of its values to every rank.
    class(communicator_t), intent(in) :: self
    real(wp), intent(in), contiguous :: send(:)              !! ordered by receiving rank
    integer, intent(in) :: send_count(0:)                    !! (0:size-1) values for each rank
    real(wp), allocatable, intent(out) :: recv(:)            !! ordered by sending rank
    integer, allocatable, intent(out) :: recv_count(:)       !! (0:size-1) values of each rank
    integer :: send_count_mpi(self%size), send_offset(self%size), recv_offset(self%size)

    call plan_exchange(self, send_count, send_count_mpi, send_offset, recv_count, recv_offset)
    allocate (recv(sum(recv_count)))
    call MPI_Alltoallv(send, send_count_mpi, send_offset, MPI_REAL8, &
                       recv, recv_count, recv_offset, MPI_REAL8, self%handle)
  end subroutine exchange_reals

  subroutine exchange_longs(self, send, send_count, recv, recv_count)
    !! Every rank sends a piece of its values to every rank.
    class(communicator_t), intent(in) :: self
    integer(i8), intent(in), contiguous :: send(:)           !! ordered by receiving rank
    integer, intent(in) :: send_count(0:)                    !! (0:size-1) values for each rank
    integer(i8), allocatable, intent(out) :: recv(:)         !! ordered by sending rank
    integer, allocatable, intent(out) :: recv_count(:)       !! (0:size-1) values of each rank
    integer :: send_count_mpi(self%size), send_offset(self%size), recv_offset(self%size)

    call plan_exchange(self, send_count, send_count_mpi, send_offset, recv_count, recv_offset)
    allocate (recv(sum(recv_count)))
    call MPI_Alltoallv(send, send_count_mpi, send_offset, MPI_INTEGER8, &
                       recv, recv_count, recv_offset, MPI_INTEGER8, self%handle)
  end subroutine exchange_longs

  subroutine exchange_integers(self, send, send_count, recv, recv_count)
    !! Every rank sends a piece of its values to every rank.
    class(communicator_t), intent(in) :: self
    integer, intent(in), contiguous :: send(:)               !! ordered by receiving rank
    integer, intent(in) :: send_count(0:)                    !! (0:size-1) values for each rank
    integer, allocatable, intent(out) :: recv(:)             !! ordered by sending rank
    integer, allocatable, intent(out) :: recv_count(:)       !! (0:size-1) values of each rank
    integer :: send_count_mpi(self%size), send_offset(self%size), recv_offset(self%size)

    call plan_exchange(self, send_count, send_count_mpi, send_offset, recv_count, recv_offset)
    allocate (recv(sum(recv_count)))
    call MPI_Alltoallv(send, send_count_mpi, send_offset, MPI_INTEGER, &
                       recv, recv_count, recv_offset, MPI_INTEGER, self%handle)
  end subroutine exchange_integers

  subroutine plan_exchange(self, send_count, send_count_mpi, send_offset, recv_count, recv_offset)
    !! How much arrives from every rank, and where each piece begins.
    type(communicator_t), intent(in) :: self
    integer, intent(in) :: send_count(0:)
    integer, intent(out) :: send_count_mpi(0:self%size - 1), send_offset(0:self%size - 1)
    integer, allocatable, intent(out) :: recv_count(:)
    integer, intent(out) :: recv_offset(0:self%size - 1)
    integer :: rank

    allocate (recv_count(0:self%size - 1))
    send_count_mpi = send_count(0:self%size - 1)
    call MPI_Alltoall(send_count_mpi, 1, MPI_INTEGER, recv_count, 1, MPI_INTEGER, self%handle)
    send_offset(0) = 0
    recv_offset(0) = 0
    do rank = 1, self%size - 1
      send_offset(rank) = send_offset(rank - 1) + send_count_mpi(rank - 1)
      recv_offset(rank) = recv_offset(rank - 1) + recv_count(rank - 1)
    end do
  end subroutine plan_exchange

  ! ---------------------------------------------------------------- errors

  subroutine communicator_agree(self, err)
    !! If any rank has failed, all ranks get the message of the lowest one that has.
    class(communicator_t), intent(in) :: self
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: text
    integer :: first, n

    first = self%size
    if (err%failed()) first = self%rank
    first = self%minimum(first)
    if (first == self%size) return
    n = 0
    if (self%rank == first) then
      text = err%message
      n = len(text)
    end if
    call MPI_Bcast(n, 1, MPI_INTEGER, first, self%handle)
    call broadcast_characters(self, first, n, text)
    call err%clear()
    call err%set(text)
  end subroutine communicator_agree

  subroutine communicator_abort(self, message)
    !! Ends all ranks at once with exit status 1; any rank may call it alone.
    class(communicator_t), intent(in) :: self
    character(len=*), intent(in) :: message

    write (error_unit, '(a)') 'error: '//message
    flush (error_unit)
    call MPI_Abort(self%handle, 1)
  end subroutine communicator_abort
end module dosui_communicator

!! Distributed index sets: which local entries are shared with, or ghosts of, other ranks.
!!
!! Every entry has one owner. `gather` copies the owner's values to all ghosts, `scatter_add` adds
!! the ghosts' contributions to the owner, in rank order. Buffers are kept between calls.
module dosui_index_map
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_sort, only: binary_search, sort_permutation
  implicit none
  private

  type, public :: index_map_t
    integer :: n_neighbour = 0
    integer, allocatable :: neighbour(:)                    !! ranks, increasing
    integer, allocatable :: send_start(:), send_index(:)    !! owner side, CSR by neighbour
    integer, allocatable :: recv_start(:), recv_index(:)    !! ghost side, CSR by neighbour
    logical, allocatable :: is_owned(:)                     !! (n_local)
    real(wp), allocatable, private :: send_buffer(:), recv_buffer(:)
  contains
    procedure :: init_shared => index_map_init_shared
    procedure :: init_halo => index_map_init_halo
    procedure :: gather => index_map_gather
    procedure :: scatter_add => index_map_scatter_add
    procedure :: n_shared => index_map_n_shared
  end type index_map_t

contains

  subroutine index_map_init_shared(self, comm, key, candidate)
    !! Entries with equal keys on several ranks are one entity, owned by the lowest of them.
    !! Collective: a distributed directory (key -> rank) finds who else has a key.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key(:)          !! sorted, distinct on this rank
    logical, intent(in) :: candidate(:)        !! may be shared; others are not looked up
    integer(i8), allocatable :: owner_reply(:), ghost_reply(:)
    integer, allocatable :: owner_count(:), ghost_count(:)
    integer :: k

    if (allocated(self%is_owned)) deallocate (self%is_owned)
    allocate (self%is_owned(size(key)), source=.true.)
    call ask_directory(comm, pack(key, candidate), owner_reply, owner_count, ghost_reply, &
                       ghost_count)
    call set_lists(self, comm, [(binary_search(key, ghost_reply(k)), k=1, size(ghost_reply))], &
                   ghost_count, [(binary_search(key, owner_reply(k)), k=1, size(owner_reply))], &
                   owner_count)
    self%is_owned(self%recv_index) = .false.
  end subroutine index_map_init_shared

  subroutine ask_directory(comm, key, owned, owned_count, ghosts, ghost_count)
    !! For the keys of this rank that others have too: those owned elsewhere (`ghosts`, grouped by
    !! owner), and those owned here (`owned`, grouped by the rank that has a ghost of it).
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key(:)
    integer(i8), allocatable, intent(out) :: owned(:), ghosts(:)
    integer, allocatable, intent(out) :: owned_count(:), ghost_count(:)   !! (0:size-1)
    integer(i8), allocatable :: asked(:), pair(:), answer(:)
    integer, allocatable :: asked_count(:), count(:), answer_count(:), rank_of(:), order(:)
    integer(i8), allocatable :: send(:)
    integer :: rank, k

    call group_by_rank(comm, key, [(directory_rank(comm, key(k)), k=1, size(key))], send, count)
    call comm%exchange(send, count, asked, asked_count)
    allocate (rank_of(size(asked)))
    k = 0
    do rank = 0, comm%size - 1
      rank_of(k + 1:k + asked_count(rank)) = rank
      k = k + asked_count(rank)
    end do
    call sort_permutation(asked, order)
    ! Answers are triples (key, owner, ghost rank), sent to both the owner and the ghost.
    allocate (answer(0), answer_count(0))
    call collect_pairs(asked, rank_of, order, answer, answer_count)
    call group_triples(comm, answer, answer_count, send, count)
    call comm%exchange(send, count, pair, asked_count)
    ghosts = pack(pair(1::3), int(pair(3::3)) == comm%rank)
    rank_of = int(pack(pair(2::3), int(pair(3::3)) == comm%rank))
    call group_by_rank(comm, ghosts, rank_of, send, ghost_count)
    ghosts = sorted_in_groups(send, ghost_count)
    owned = pack(pair(1::3), int(pair(2::3)) == comm%rank)
    rank_of = int(pack(pair(3::3), int(pair(2::3)) == comm%rank))
    call group_by_rank(comm, owned, rank_of, send, owned_count)
    owned = sorted_in_groups(send, owned_count)
  end subroutine ask_directory

  pure integer function directory_rank(comm, key) result(rank)
    !! The rank that knows who has a key.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key

    rank = int(modulo(ieor(key, ishft(key, -21))*31_i8 + ishft(key, -42), int(comm%size, i8)))
  end function directory_rank

  pure subroutine collect_pairs(key, rank_of, order, triple, destination)
    !! All (key, owner, ghost) triples of keys that several ranks asked for, each twice: for the
    !! owner and for the ghost.
    integer(i8), intent(in) :: key(:)
    integer, intent(in) :: rank_of(:)
    integer, intent(in) :: order(:)
    integer(i8), allocatable, intent(inout) :: triple(:)
    integer, allocatable, intent(inout) :: destination(:)
    integer :: first, last, k, n, pass

    do pass = 1, 2
      n = 0
      first = 1
      do while (first <= size(key))
        last = first
        do while (last < size(key))
          if (key(order(last + 1)) /= key(order(first))) exit
          last = last + 1
        end do
        do k = first + 1, last   ! stable sort: the lowest rank comes first
          if (pass == 2) then
            triple(6*n + 1:6*n + 3) = [key(order(k)), int(rank_of(order(first)), i8), &
                                       int(rank_of(order(k)), i8)]
            triple(6*n + 4:6*n + 6) = triple(6*n + 1:6*n + 3)
            destination(2*n + 1:2*n + 2) = [rank_of(order(first)), rank_of(order(k))]
          end if
          n = n + 1
        end do
        first = last + 1
      end do
      if (pass == 1) then
        deallocate (triple, destination)
        allocate (triple(6*n), destination(2*n))
      end if
    end do
  end subroutine collect_pairs

  subroutine group_by_rank(comm, key, rank_of, grouped, count)
    !! Keys grouped by rank, keeping their order.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key(:)
    integer, intent(in) :: rank_of(:)
    integer(i8), allocatable, intent(out) :: grouped(:)
    integer, allocatable, intent(out) :: count(:)   !! (0:size-1)
    integer, allocatable :: order(:)
    integer :: k

    call sort_permutation(int(rank_of, i8), order)
    grouped = key(order)
    allocate (count(0:comm%size - 1), source=0)
    do k = 1, size(rank_of)
      count(rank_of(k)) = count(rank_of(k)) + 1
    end do
  end subroutine group_by_rank

  subroutine group_triples(comm, triple, destination, grouped, count)
    !! Triples grouped by destination; counts are in numbers, not triples.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: triple(:)
    integer, intent(in) :: destination(:)
    integer(i8), allocatable, intent(out) :: grouped(:)
    integer, allocatable, intent(out) :: count(:)   !! (0:size-1)
    integer, allocatable :: order(:)
    integer :: k

    call sort_permutation(int(destination, i8), order)
    allocate (grouped(size(triple)))
    allocate (count(0:comm%size - 1), source=0)
    do k = 1, size(destination)
      grouped(3*k - 2:3*k) = triple(3*order(k) - 2:3*order(k))
      count(destination(k)) = count(destination(k)) + 3
    end do
  end subroutine group_triples

  function sorted_in_groups(key, count) result(sorted)
    !! Sorts the keys of every rank's group, so that both sides of a message agree on its order.
    integer(i8), intent(in) :: key(:)
    integer, intent(in) :: count(:)
    integer(i8), allocatable :: sorted(:)
    integer, allocatable :: order(:)
    integer :: k, first

    sorted = key
    first = 1
    do k = 1, size(count)
      call sort_permutation(key(first:first + count(k) - 1), order)
      sorted(first:first + count(k) - 1) = key(first - 1 + order)
      first = first + count(k)
    end do
  end function sorted_in_groups

  subroutine index_map_init_halo(self, comm, n_owned, send_to_rank, send_index, n_ghost)
    !! Ghosts are appended behind the owned entries, by sending rank and in the sender's order.
    !! Collective.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_owned
    integer, intent(in) :: send_to_rank(:)     !! destination of each entry to send
    integer, intent(in) :: send_index(:)       !! owned entry to send
    integer, intent(out) :: n_ghost
    integer(i8), allocatable :: grouped(:), arrived(:)
    integer, allocatable :: count(:), arrived_count(:)
    integer :: k

    call group_by_rank(comm, int(send_index, i8), send_to_rank, grouped, count)
    call comm%exchange(grouped, count, arrived, arrived_count)
    n_ghost = size(arrived)
    call set_lists(self, comm, [(n_owned + k, k=1, n_ghost)], arrived_count, int(grouped), count)
    if (allocated(self%is_owned)) deallocate (self%is_owned)
    allocate (self%is_owned(n_owned + n_ghost), source=.true.)
    self%is_owned(n_owned + 1:) = .false.
  end subroutine index_map_init_halo

  subroutine set_lists(self, comm, recv_index, recv_count, send_index, send_count)
    !! Turns counts by rank into lists by neighbour.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: recv_index(:), recv_count(0:), send_index(:), send_count(0:)
    integer :: rank, k

    self%neighbour = pack([(rank, rank=0, comm%size - 1)], recv_count > 0 .or. send_count > 0)
    self%n_neighbour = size(self%neighbour)
    self%send_index = send_index
    self%recv_index = recv_index
    if (allocated(self%send_start)) deallocate (self%send_start, self%recv_start)
    allocate (self%send_start(self%n_neighbour + 1), self%recv_start(self%n_neighbour + 1))
    self%send_start(1) = 1
    self%recv_start(1) = 1
    do k = 1, self%n_neighbour
      self%send_start(k + 1) = self%send_start(k) + send_count(self%neighbour(k))
      self%recv_start(k + 1) = self%recv_start(k) + recv_count(self%neighbour(k))
    end do
  end subroutine set_lists

  subroutine reserve(buffer, n)
    !! Grows a buffer when it is too small.
    real(wp), allocatable, intent(inout) :: buffer(:)
    integer, intent(in) :: n

    if (allocated(buffer)) then
      if (size(buffer) >= n) return
      deallocate (buffer)
    end if
    allocate (buffer(n))
  end subroutine reserve

  subroutine index_map_gather(self, comm, width, values)
    !! Copies the owners' values to the ghosts.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! reals per entry
    real(wp), intent(inout) :: values(width, *)

    if (self%n_neighbour == 0) return
    call reserve(self%send_buffer, width*size(self%send_index))
    call reserve(self%recv_buffer, width*size(self%recv_index))
    call pack_rows(width, size(self%send_index), self%send_index, values, self%send_buffer)
    call comm%swap_neighbours(self%neighbour, width, self%send_buffer, self%send_start, &
                              self%recv_buffer, self%recv_start)
    call unpack_rows(width, size(self%recv_index), self%recv_index, self%recv_buffer, values)
  end subroutine index_map_gather

  subroutine index_map_scatter_add(self, comm, width, values)
    !! Adds the ghosts' values to the owners', in rank order. Ghosts keep their partial values.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! reals per entry
    real(wp), intent(inout) :: values(width, *)

    if (self%n_neighbour == 0) return
    call reserve(self%recv_buffer, width*size(self%recv_index))
    call reserve(self%send_buffer, width*size(self%send_index))
    call pack_rows(width, size(self%recv_index), self%recv_index, values, self%recv_buffer)
    call comm%swap_neighbours(self%neighbour, width, self%recv_buffer, self%recv_start, &
                              self%send_buffer, self%send_start)
    call add_rows(width, size(self%send_index), self%send_index, self%send_buffer, values)
  end subroutine index_map_scatter_add

  pure subroutine pack_rows(width, n, index, values, buffer)
    !! Kernel: picks rows into a buffer.
    integer, intent(in) :: width, n
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: values(width, *)
    real(wp), intent(inout) :: buffer(width, *)
    integer :: k

    do k = 1, n
      buffer(:, k) = values(:, index(k))
    end do
  end subroutine pack_rows

  pure subroutine unpack_rows(width, n, index, buffer, values)
    !! Kernel: puts rows of a buffer in their places.
    integer, intent(in) :: width, n
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: buffer(width, *)
    real(wp), intent(inout) :: values(width, *)
    integer :: k

    do k = 1, n
      values(:, index(k)) = buffer(:, k)
    end do
  end subroutine unpack_rows

  pure subroutine add_rows(width, n, index, buffer, values)
    !! Kernel: adds rows of a buffer, neighbour by neighbour.
    integer, intent(in) :: width, n
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: buffer(width, *)
    real(wp), intent(inout) :: values(width, *)
    integer :: k

    do k = 1, n
      values(:, index(k)) = values(:, index(k)) + buffer(:, k)
    end do
  end subroutine add_rows

  pure integer function index_map_n_shared(self) result(n)
    !! Entries that are exchanged in one gather, sent and received.
    class(index_map_t), intent(in) :: self

    n = size(self%send_index) + size(self%recv_index)
  end function index_map_n_shared
end module dosui_index_map

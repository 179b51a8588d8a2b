!! Distributed index sets: which local entries are shared with, or ghosts of, other ranks.
!!
!! Every entry has one owner. `gather` copies the owner's values to all ghosts, `scatter_add` adds
!! the ghosts' values to the owner's in rank order. Both are point-to-point, one message for each
!! neighbour; ranks without neighbours pass through. Buffers are kept between calls.
module dosui_index_map
  use mpi_f08, only: MPI_Comm, MPI_Request, MPI_REAL8, MPI_INTEGER8, MPI_STATUSES_IGNORE, &
                     MPI_Irecv, MPI_Isend, MPI_Waitall
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  use dosui_sort, only: sort_permutation
  implicit none
  private

  integer, parameter :: message_tag = 7101

  type, public :: index_map_t
    !! The entries of one index set (nodes, cells, points) that this rank exchanges.
    integer :: n_local = 0                   !! entries of this rank, owned and ghosts
    integer :: n_neighbour = 0
    integer, allocatable :: neighbour(:)     !! (n_neighbour) ranks, increasing
    integer, allocatable :: send_start(:)    !! (n_neighbour+1) into send_index
    integer, allocatable :: send_index(:)    !! owned entries, neighbour by neighbour
    integer, allocatable :: recv_start(:)    !! (n_neighbour+1) into recv_index
    integer, allocatable :: recv_index(:)    !! ghost entries, neighbour by neighbour
    logical, allocatable :: is_owned(:)      !! (n_local)
    real(wp), allocatable, private :: owned_buffer(:), ghost_buffer(:)
    integer(i8), allocatable, private :: owned_keys(:), ghost_keys(:)
    type(MPI_Request), allocatable, private :: request(:)   !! (2*n_neighbour)
  contains
    procedure :: init_shared => map_init_shared
    procedure :: init_halo => map_init_halo
    procedure :: gather => map_gather
    procedure :: gather_longs => map_gather_longs
    procedure :: scatter_add => map_scatter_add
    procedure :: scatter_min => map_scatter_min
    procedure :: sum_copies => map_sum_copies
    procedure, private :: to_owners
    procedure :: n_shared => map_n_shared
  end type index_map_t

contains

  ! ---------------------------------------------------------------- construction

  subroutine map_init_shared(self, comm, key, candidate)
    !! Entries with equal keys on several ranks are one shared entity, owned by the lowest of these
    !! ranks. Collective. Only candidates are looked up (on a rank chosen by the key itself); the
    !! ranks that share an entry must all name it as a candidate.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key(:)          !! sorted, each once
    logical, intent(in) :: candidate(:)        !! (size(key)) may other ranks have this entry?
    integer(i8), allocatable :: asked(:), answer(:)
    integer, allocatable :: entry(:), ask_count(:), partner(:), shared(:), recv_count(:)
    logical, allocatable :: is_ghost(:), is_mine(:)
    integer :: k

    call pose_questions(comm, key, candidate, entry, asked, ask_count)
    call ask_directory(comm, asked, ask_count, answer, recv_count)
    shared = [(entry(int(answer(k))), k=1, size(answer) - 1, 2)]
    partner = [(int(answer(k)), k=2, size(answer), 2)]
    is_ghost = partner < comm%rank
    is_mine = partner > comm%rank
    call set_lists(comm, pack(partner, is_mine), pack(shared, is_mine), self%send_index, ask_count)
    call set_lists(comm, pack(partner, is_ghost), pack(shared, is_ghost), self%recv_index, &
                   recv_count)
    call set_neighbours(self, ask_count, recv_count)
    self%n_local = size(key)
    if (allocated(self%is_owned)) deallocate (self%is_owned)
    allocate (self%is_owned(self%n_local), source=.true.)
    do k = 1, size(self%recv_index)
      self%is_owned(self%recv_index(k)) = .false.
    end do
  end subroutine map_init_shared

  subroutine pose_questions(comm, key, candidate, entry, asked, ask_count)
    !! The candidates' keys, ordered by the directory rank that knows about them. Alone, a rank has
    !! nothing to ask.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: key(:)
    logical, intent(in) :: candidate(:)
    integer, allocatable, intent(out) :: entry(:)         !! local entry of each question
    integer(i8), allocatable, intent(out) :: asked(:)     !! its key
    integer, allocatable, intent(out) :: ask_count(:)     !! (0:size-1)
    integer, allocatable :: order(:), candidates(:)
    integer(i8), allocatable :: of_rank(:)
    integer :: k, n

    n = 0
    if (comm%size > 1) n = count(candidate)
    allocate (candidates(n), of_rank(n))
    allocate (ask_count(0:comm%size - 1), source=0)
    if (n > 0) candidates = pack([(k, k=1, size(key))], candidate)
    do k = 1, n
      of_rank(k) = int(directory_rank(key(candidates(k)), comm%size), i8)
      ask_count(of_rank(k)) = ask_count(of_rank(k)) + 1
    end do
    call sort_permutation(of_rank, order)
    entry = candidates(order)
    asked = key(entry)
  end subroutine pose_questions

  pure integer function directory_rank(key, n_rank) result(rank)
    !! The rank that knows who holds a key: a hash, so that neighbouring keys spread evenly.
    integer(i8), intent(in) :: key
    integer, intent(in) :: n_rank
    integer(i8), parameter :: prime = 2147483647_i8
    integer(i8) :: hash

    hash = mod(iand(key, huge(key)), prime)
    hash = mod(ieor(hash, iand(ishft(key, -21), prime))*48271_i8, prime)
    hash = ieor(hash, ishft(hash, -15))
    rank = int(mod(hash, int(n_rank, i8)))
  end function directory_rank

  subroutine ask_directory(comm, asked, ask_count, answer, answer_count)
    !! Who else holds the keys? Answers are pairs: number of the question among those to the same
    !! directory rank, shifted to this rank's numbering; and the other holder. Of a key's holders
    !! the lowest rank hears of all others, the others hear of the lowest.
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: asked(:)
    integer, intent(in) :: ask_count(0:)
    integer(i8), allocatable, intent(out) :: answer(:)
    integer, allocatable, intent(out) :: answer_count(:)
    integer(i8), allocatable :: held(:), reply(:)
    integer, allocatable :: held_count(:), reply_count(:)
    integer :: rank, k, before, offset

    if (comm%size == 1) then
      allocate (answer(0), answer_count(0:0))
      answer_count = 0
      return
    end if
    call comm%exchange(asked, ask_count, held, held_count)
    call write_replies(comm%size, held, held_count, reply, reply_count)
    call comm%exchange(reply, reply_count, answer, answer_count)
    before = 0
    offset = 0
    do rank = 0, comm%size - 1
      do k = before + 1, before + answer_count(rank), 2
        answer(k) = answer(k) + offset
      end do
      before = before + answer_count(rank)
      offset = offset + ask_count(rank)
    end do
  end subroutine ask_directory

  subroutine write_replies(n_rank, held, held_count, reply, reply_count)
    !! The directory's work: finds equal keys among the questions and tells the ranks about each
    !! other.
    integer, intent(in) :: n_rank
    integer(i8), intent(in) :: held(:)         !! keys asked about, by asking rank
    integer, intent(in) :: held_count(0:)      !! (0:n_rank-1)
    integer(i8), allocatable, intent(out) :: reply(:)     !! pairs by rank
    integer, allocatable, intent(out) :: reply_count(:)   !! (0:n_rank-1) numbers, two for a pair
    integer, allocatable :: order(:), rank_of(:), number_of(:), next(:)
    integer :: rank, k, first, last, pass, n

    n = size(held)
    allocate (rank_of(n), number_of(n))
    n = 0
    do rank = 0, n_rank - 1
      do k = 1, held_count(rank)
        rank_of(n + k) = rank
        number_of(n + k) = k
      end do
      n = n + held_count(rank)
    end do
    call sort_permutation(held, order)   ! stable: holders of a key appear in rank order
    allocate (reply_count(0:n_rank - 1), next(0:n_rank - 1))
    do pass = 1, 2                       ! counts, then writes
      if (pass == 1) next = 0
      if (pass == 2) call start_replies(next, reply_count, reply)
      first = 1
      do while (first <= n)
        last = last_equal(held, order, first)
        do k = first + 1, last
          call tell(order(first), order(k))
          call tell(order(k), order(first))
        end do
        first = last + 1
      end do
    end do

  contains

    subroutine tell(listener, other)
      !! Tells one holder of a key about another one.
      integer, intent(in) :: listener, other
      integer :: to

      to = rank_of(listener)
      if (pass == 2) then
        reply(next(to) + 1) = int(number_of(listener), i8)
        reply(next(to) + 2) = int(rank_of(other), i8)
      end if
      next(to) = next(to) + 2
    end subroutine tell
  end subroutine write_replies

  subroutine start_replies(next, reply_count, reply)
    !! Turns counts into places to write.
    integer, intent(inout) :: next(0:)              !! in: counts, out: numbers before each rank's
    integer, intent(out) :: reply_count(0:)
    integer(i8), allocatable, intent(out) :: reply(:)
    integer :: rank, before

    allocate (reply(sum(next)))
    before = 0
    do rank = 0, size(next) - 1
      reply_count(rank) = next(rank)
      next(rank) = before
      before = before + reply_count(rank)
    end do
  end subroutine start_replies

  pure integer function last_equal(key, order, first) result(last)
    !! The last of the sorted keys that equals the one at `first`.
    integer(i8), intent(in) :: key(:)
    integer, intent(in) :: order(:), first

    last = first
    do while (last < size(order))
      if (key(order(last + 1)) /= key(order(first))) exit
      last = last + 1
    end do
  end function last_equal

  subroutine set_lists(comm, partner, entry, index, partner_count)
    !! Entries ordered by partner rank, then by local number: as keys are sorted, both sides of a
    !! message agree on its order.
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: partner(:), entry(:)
    integer, allocatable, intent(out) :: index(:)
    integer, allocatable, intent(out) :: partner_count(:)   !! (0:size-1)
    integer(i8), allocatable :: sort_key(:)
    integer, allocatable :: order(:)
    integer :: k

    allocate (partner_count(0:comm%size - 1), source=0)
    allocate (sort_key(size(entry)), index(size(entry)))
    do k = 1, size(entry)
      sort_key(k) = ishft(int(partner(k), i8), 31) + int(entry(k), i8)
      partner_count(partner(k)) = partner_count(partner(k)) + 1
    end do
    call sort_permutation(sort_key, order)
    do k = 1, size(entry)
      index(k) = entry(order(k))
    end do
  end subroutine set_lists

  subroutine set_neighbours(self, send_count, recv_count)
    !! Neighbours are the ranks to which anything is sent or from which anything comes.
    class(index_map_t), intent(inout) :: self
    integer, intent(in) :: send_count(0:), recv_count(0:)
    integer :: rank, k

    self%neighbour = pack([(rank, rank=0, size(send_count) - 1)], &
                          send_count > 0 .or. recv_count > 0)
    self%n_neighbour = size(self%neighbour)
    if (allocated(self%send_start)) deallocate (self%send_start)
    if (allocated(self%recv_start)) deallocate (self%recv_start)
    if (allocated(self%request)) deallocate (self%request)
    allocate (self%send_start(self%n_neighbour + 1), self%recv_start(self%n_neighbour + 1))
    allocate (self%request(2*self%n_neighbour))
    self%send_start(1) = 1
    self%recv_start(1) = 1
    do k = 1, self%n_neighbour
      rank = self%neighbour(k)
      self%send_start(k + 1) = self%send_start(k) + send_count(rank)
      self%recv_start(k + 1) = self%recv_start(k) + recv_count(rank)
    end do
  end subroutine set_neighbours

  subroutine map_init_halo(self, comm, n_owned, send_to_rank, send_index, n_ghost)
    !! Owned entries 1...n_owned are followed by ghosts, ordered by sending rank and within it as
    !! the sender listed them. Collective.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_owned
    integer, intent(in) :: send_to_rank(:)   !! another rank for each entry to send
    integer, intent(in) :: send_index(:)     !! the owned entry; may occur once for each rank
    integer, intent(out) :: n_ghost
    integer(i8), allocatable :: grouped(:), arrived(:)
    integer, allocatable :: order(:), send_count(:), recv_count(:)
    integer :: k

    allocate (send_count(0:comm%size - 1), source=0)
    do k = 1, size(send_to_rank)
      send_count(send_to_rank(k)) = send_count(send_to_rank(k)) + 1
    end do
    call sort_permutation(int(send_to_rank, i8), order)
    self%send_index = send_index(order)
    grouped = int(self%send_index, i8)
    call comm%exchange(grouped, send_count, arrived, recv_count)
    n_ghost = size(arrived)
    self%recv_index = [(n_owned + k, k=1, n_ghost)]
    call set_neighbours(self, send_count, recv_count)
    self%n_local = n_owned + n_ghost
    if (allocated(self%is_owned)) deallocate (self%is_owned)
    allocate (self%is_owned(self%n_local), source=.true.)
    self%is_owned(n_owned + 1:) = .false.
  end subroutine map_init_halo

  ! ---------------------------------------------------------------- exchange

  subroutine map_gather(self, comm, width, values)
    !! Copies the owners' values to the ghosts.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! numbers of each entry
    real(wp), intent(inout) :: values(width, self%n_local)   !! may be longer [any unit]

    if (self%n_neighbour == 0) return
    call reserve(self%owned_buffer, width*size(self%send_index))
    call reserve(self%ghost_buffer, width*size(self%recv_index))
    call pick(width, size(self%send_index), self%send_index, self%n_local, values, &
              self%owned_buffer)
    call swap_reals(comm%handle, self%n_neighbour, self%neighbour, width, &
                    self%send_start, self%owned_buffer, self%recv_start, self%ghost_buffer, &
                    self%request)
    call put(width, size(self%recv_index), self%recv_index, self%ghost_buffer, self%n_local, &
             values)
  end subroutine map_gather

  subroutine map_scatter_add(self, comm, width, values)
    !! Adds the ghosts' values to the owners', in rank order (the owner's own value first). The
    !! ghosts keep their partial values.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! numbers of each entry
    real(wp), intent(inout) :: values(width, self%n_local)   !! may be longer [any unit]

    if (self%n_neighbour == 0) return
    call self%to_owners(comm, width, values)
    call add(width, size(self%send_index), self%send_index, self%owned_buffer, self%n_local, &
             values)
  end subroutine map_scatter_add

  subroutine map_sum_copies(self, comm, width, values)
    !! Gives owners and ghosts the sum of all copies.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! numbers of each entry
    real(wp), intent(inout) :: values(width, self%n_local)   !! may be longer [any unit]

    call self%scatter_add(comm, width, values)
    call self%gather(comm, width, values)
  end subroutine map_sum_copies

  subroutine map_scatter_min(self, comm, width, values)
    !! Gives the owners the least of their own and the ghosts' values.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                    !! numbers of each entry
    real(wp), intent(inout) :: values(width, self%n_local)   !! may be longer [any unit]
    integer :: k

    if (self%n_neighbour == 0) return
    call self%to_owners(comm, width, values)
    do k = 1, size(self%send_index)
      values(:, self%send_index(k)) = min(values(:, self%send_index(k)), &
                                          self%owned_buffer((k - 1)*width + 1:k*width))
    end do
  end subroutine map_scatter_min

  subroutine to_owners(self, comm, width, values)
    !! Sends the ghosts' values; they arrive in `owned_buffer`, in the order of `send_index`.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width
    real(wp), intent(in) :: values(width, self%n_local)

    call reserve(self%owned_buffer, width*size(self%send_index))
    call reserve(self%ghost_buffer, width*size(self%recv_index))
    call pick(width, size(self%recv_index), self%recv_index, self%n_local, values, &
              self%ghost_buffer)
    call swap_reals(comm%handle, self%n_neighbour, self%neighbour, width, &
                    self%recv_start, self%ghost_buffer, self%send_start, self%owned_buffer, &
                    self%request)
  end subroutine to_owners

  subroutine map_gather_longs(self, comm, width, values)
    !! Copies the owners' 64-bit integers to the ghosts.
    class(index_map_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width                      !! numbers of each entry
    integer(i8), intent(inout) :: values(width, self%n_local)   !! may be longer
    integer :: k

    if (self%n_neighbour == 0) return
    call reserve_longs(self%owned_keys, width*size(self%send_index))
    call reserve_longs(self%ghost_keys, width*size(self%recv_index))
    do k = 1, size(self%send_index)
      self%owned_keys((k - 1)*width + 1:k*width) = values(:, self%send_index(k))
    end do
    call swap_longs(comm%handle, self%n_neighbour, self%neighbour, width, &
                    self%send_start, self%owned_keys, self%recv_start, self%ghost_keys, &
                    self%request)
    do k = 1, size(self%recv_index)
      values(:, self%recv_index(k)) = self%ghost_keys((k - 1)*width + 1:k*width)
    end do
  end subroutine map_gather_longs

  pure integer function map_n_shared(self) result(n)
    !! Entries of this rank that are sent or received in one gather.
    class(index_map_t), intent(in) :: self

    n = 0
    if (allocated(self%send_index)) n = size(self%send_index) + size(self%recv_index)
  end function map_n_shared

  subroutine swap_reals(comm, n_neighbour, neighbour, width, out_start, out, in_start, in, request)
    !! Sends a piece of `out` to each neighbour and receives a piece of `in`; empty pieces are not
    !! posted. Buffers are whole and contiguous, and dummies, so that no copy is made of them.
    type(MPI_Comm), intent(in) :: comm
    integer, intent(in) :: n_neighbour, width
    integer, intent(in) :: neighbour(n_neighbour)
    integer, intent(in) :: out_start(n_neighbour + 1), in_start(n_neighbour + 1)
    real(wp), intent(inout), asynchronous :: out(width*(out_start(n_neighbour + 1) - 1))
    real(wp), intent(inout), asynchronous :: in(width*(in_start(n_neighbour + 1) - 1))
    type(MPI_Request), intent(inout) :: request(2*n_neighbour)
    integer :: k, n, n_request

    n_request = 0
    do k = 1, n_neighbour
      n = width*(in_start(k + 1) - in_start(k))
      if (n == 0) cycle
      n_request = n_request + 1
      call MPI_Irecv(in(width*(in_start(k) - 1) + 1), n, MPI_REAL8, neighbour(k), message_tag, &
                     comm, request(n_request))
    end do
    do k = 1, n_neighbour
      n = width*(out_start(k + 1) - out_start(k))
      if (n == 0) cycle
      n_request = n_request + 1
      call MPI_Isend(out(width*(out_start(k) - 1) + 1), n, MPI_REAL8, neighbour(k), message_tag, &
                     comm, request(n_request))
    end do
    call MPI_Waitall(n_request, request, MPI_STATUSES_IGNORE)
  end subroutine swap_reals

  subroutine swap_longs(comm, n_neighbour, neighbour, width, out_start, out, in_start, in, request)
    !! As `swap_reals`, for 64-bit integers.
    type(MPI_Comm), intent(in) :: comm
    integer, intent(in) :: n_neighbour, width
    integer, intent(in) :: neighbour(n_neighbour)
    integer, intent(in) :: out_start(n_neighbour + 1), in_start(n_neighbour + 1)
    integer(i8), intent(inout), asynchronous :: out(width*(out_start(n_neighbour + 1) - 1))
    integer(i8), intent(inout), asynchronous :: in(width*(in_start(n_neighbour + 1) - 1))
    type(MPI_Request), intent(inout) :: request(2*n_neighbour)
    integer :: k, n, n_request

    n_request = 0
    do k = 1, n_neighbour
      n = width*(in_start(k + 1) - in_start(k))
      if (n == 0) cycle
      n_request = n_request + 1
      call MPI_Irecv(in(width*(in_start(k) - 1) + 1), n, MPI_INTEGER8, neighbour(k), &
                     message_tag, comm, request(n_request))
    end do
    do k = 1, n_neighbour
      n = width*(out_start(k + 1) - out_start(k))
      if (n == 0) cycle
      n_request = n_request + 1
      call MPI_Isend(out(width*(out_start(k) - 1) + 1), n, MPI_INTEGER8, neighbour(k), &
                     message_tag, comm, request(n_request))
    end do
    call MPI_Waitall(n_request, request, MPI_STATUSES_IGNORE)
  end subroutine swap_longs

  ! ---------------------------------------------------------------- buffers

  pure subroutine reserve(buffer, n)
    !! Grows a buffer when it is too small.
    real(wp), allocatable, intent(inout) :: buffer(:)
    integer, intent(in) :: n

    if (allocated(buffer)) then
      if (size(buffer) >= n) return
      deallocate (buffer)
    end if
    allocate (buffer(n))
  end subroutine reserve

  pure subroutine reserve_longs(buffer, n)
    !! Grows a buffer when it is too small.
    integer(i8), allocatable, intent(inout) :: buffer(:)
    integer, intent(in) :: n

    if (allocated(buffer)) then
      if (size(buffer) >= n) return
      deallocate (buffer)
    end if
    allocate (buffer(n))
  end subroutine reserve_longs

  pure subroutine pick(width, n, index, n_local, values, buffer)
    !! Kernel: copies listed entries into a buffer.
    integer, intent(in) :: width, n, n_local
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: values(width, n_local)
    real(wp), intent(inout) :: buffer(width, n)
    integer :: k

    do k = 1, n
      buffer(:, k) = values(:, index(k))
    end do
  end subroutine pick

  pure subroutine put(width, n, index, buffer, n_local, values)
    !! Kernel: copies a buffer into listed entries.
    integer, intent(in) :: width, n, n_local
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: buffer(width, n)
    real(wp), intent(inout) :: values(width, n_local)
    integer :: k

    do k = 1, n
      values(:, index(k)) = buffer(:, k)
    end do
  end subroutine put

  pure subroutine add(width, n, index, buffer, n_local, values)
    !! Kernel: adds a buffer to listed entries, which may repeat.
    integer, intent(in) :: width, n, n_local
    integer, intent(in) :: index(n)
    real(wp), intent(in) :: buffer(width, n)
    real(wp), intent(inout) :: values(width, n_local)
    integer :: k

    do k = 1, n
      values(:, index(k)) = values(:, index(k)) + buffer(:, k)
    end do
  end subroutine add
end module dosui_index_map

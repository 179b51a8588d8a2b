!! A 64-bit checksum of 8-byte words that ranks compute in parts.
!!
!! Every word is added (exclusive or) to a state, which then makes a step of Marsaglia's xorshift
!! generator [Marsaglia2003], an invertible linear map of period 2**64 - 1. A change of up to 8
!! adjacent bytes always changes the checksum, any other change all but once in 2**64 times. Because
!! the map is linear, the state after two parts follows from theirs: checksums do not depend on the
!! ranks.
module dosui_checksum
  use dosui_kinds, only: wp, i8
  use dosui_communicator, only: communicator_t
  implicit none
  private

  public :: combine_checksums

  integer(i8), parameter :: salt = 7640891576956012809_i8   ! so that zeros fit no zeros

  type, public :: checksum_t
    !! The state after some words.
    integer(i8), private :: state = 0_i8
    integer(i8), private :: n = 0_i8       !! words
  contains
    procedure :: add_integers => checksum_add_integers
    procedure :: add_reals => checksum_add_reals
    generic :: add => add_integers, add_reals
    procedure :: add_text => checksum_add_text
    procedure :: add_zeros => checksum_add_zeros
    procedure :: value => checksum_value
  end type checksum_t

contains

  pure subroutine checksum_add_integers(self, n, words)
    !! Kernel: adds words.
    class(checksum_t), intent(inout) :: self
    integer, intent(in) :: n
    integer(i8), intent(in) :: words(n)
    integer(i8) :: state
    integer :: k

    state = self%state
    do k = 1, n
      state = step(ieor(state, words(k)))
    end do
    self%state = state
    self%n = self%n + n
  end subroutine checksum_add_integers

  pure subroutine checksum_add_reals(self, n, numbers)
    !! Kernel: adds the bits of numbers.
    class(checksum_t), intent(inout) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: numbers(n)   !! [any unit]
    integer(i8) :: state
    integer :: k

    state = self%state
    do k = 1, n
      state = step(ieor(state, transfer(numbers(k), 0_i8)))
    end do
    self%state = state
    self%n = self%n + n
  end subroutine checksum_add_reals

  pure subroutine checksum_add_text(self, text)
    !! Adds a text and its length; a last word that it does not fill ends with zero bytes.
    class(checksum_t), intent(inout) :: self
    character(len=*), intent(in) :: text
    character(len=8) :: piece
    integer :: k

    call self%add(1, [len(text, kind=i8)])
    do k = 1, len(text), 8
      piece = repeat(achar(0), 8)
      piece(:min(8, len(text) - k + 1)) = text(k:min(k + 7, len(text)))
      call self%add(1, [transfer(piece, 0_i8)])
    end do
  end subroutine checksum_add_text

  pure subroutine checksum_add_zeros(self, n)
    !! Adds words that are zero.
    class(checksum_t), intent(inout) :: self
    integer(i8), intent(in) :: n

    call go_on(self%state, n)
    self%n = self%n + n
  end subroutine checksum_add_zeros

  pure elemental integer(i8) function checksum_value(self) result(value)
    !! The checksum: state and number of words, so that leading zeros count, too.
    class(checksum_t), intent(in) :: self

    value = step(ieor(step(ieor(self%state, self%n)), salt))
  end function checksum_value

  pure elemental integer(i8) function step(state) result(next)
    !! One step of the generator.
    integer(i8), intent(in) :: state

    next = ieor(state, ishft(state, 13))
    next = ieor(next, ishft(next, -7))
    next = ieor(next, ishft(next, 17))
  end function step

  pure subroutine go_on(state, n)
    !! The state after n more words that are zero, by repeated squaring of the map.
    integer(i8), intent(inout) :: state
    integer(i8), intent(in) :: n
    integer(i8) :: column(0:63)   ! of the map's power: images of single bits
    integer(i8) :: rest
    integer :: b

    column = [(step(ishft(1_i8, b)), b=0, 63)]
    rest = n
    do while (rest > 0_i8)
      if (btest(rest, 0)) state = image(column, state)
      rest = ishft(rest, -1)
      if (rest > 0_i8) column = [(image(column, column(b)), b=0, 63)]
    end do
  end subroutine go_on

  pure integer(i8) function image(column, word)
    !! Product of a matrix of bits and a word.
    integer(i8), intent(in) :: column(0:63)
    integer(i8), intent(in) :: word
    integer :: b

    image = 0_i8
    do b = 0, 63
      if (btest(word, b)) image = ieor(image, column(b))
    end do
  end function image

  subroutine combine_checksums(comm, sums)
    !! Makes checksums of the ranks' words, one rank's after the other's, from those of each rank's
    !! own. All ranks get them. Collective.
    type(communicator_t), intent(in) :: comm
    type(checksum_t), intent(inout) :: sums(:)
    integer(i8), allocatable :: arrived(:), states(:)
    integer, allocatable :: arrived_count(:)
    integer :: send_count(0:comm%size - 1)
    integer(i8) :: before, total
    integer :: k, rank

    allocate (states(size(sums)))
    do k = 1, size(sums)
      before = comm%prefix_sum(sums(k)%n)
      total = comm%sum(sums(k)%n)
      call go_on(sums(k)%state, total - before - sums(k)%n)
      states(k) = sums(k)%state
      sums(k)%n = total
    end do
    send_count = 0
    send_count(0) = size(states)
    call comm%exchange(states, send_count, arrived, arrived_count)
    if (comm%is_root()) then
      states = 0_i8
      do rank = 0, comm%size - 1
        states = ieor(states, arrived(rank*size(sums) + 1:(rank + 1)*size(sums)))
      end do
    end if
    call comm%broadcast(states)
    sums%state = states
  end subroutine combine_checksums
end module dosui_checksum

!! Reproducible random numbers that depend on a point's identity only, not on ranks or order.
module dosui_random
  use dosui_kinds, only: wp, i8
  implicit none
  private

  public :: hash_uniform

  integer(i8), parameter :: modulus = 2147483647_i8   !! 2**31 - 1, prime

contains

  pure real(wp) function hash_uniform(seed, id, stream) result(number)
    !! Uniform number in [0, 1) for a seed, an identity and a stream (for example a direction) [-].
    !!
    !! Rounds of multiplicative congruential mixing with xor shifts; products stay below 2**62, so
    !! that nothing overflows.
    integer, intent(in) :: seed
    integer(i8), intent(in) :: id
    integer, intent(in) :: stream
    integer(i8) :: state, word(4)
    integer :: k

    word = [int(seed, i8), iand(id, modulus), ishft(id, -31), int(stream, i8)]
    state = 88172645_i8
    do k = 1, 4
      state = mod(ieor(state, iand(word(k)*2654435761_i8, modulus)) + 1_i8, modulus)
      state = mod(state*48271_i8 + 11_i8, modulus)
      state = ieor(state, ishft(state, -15))
      state = mod(state*69621_i8 + 7919_i8, modulus)
      state = ieor(state, ishft(state, -13))
      state = mod(state*39373_i8 + 1013_i8, modulus)
    end do
    number = real(state, wp)/real(modulus, wp)
  end function hash_uniform
end module dosui_random

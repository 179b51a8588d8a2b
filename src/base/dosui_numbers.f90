!! The one reader of numbers in text: scenes, options, tables, motions and triangles.
!!
!! Fortran's own list-directed read is not used on what a user wrote: it takes '/', ',', '2*3',
!! 'nan' and cut exponents in silence.
module dosui_numbers
  use dosui_kinds, only: wp, i8
  use dosui_text, only: lower_case
  implicit none
  private

  public :: text_as_real, text_as_integer, is_special

  integer, parameter :: longest_number = 100   !! characters; a double needs 24
  integer, parameter :: longest_exponent = 8   !! digits
  integer, parameter :: exact_digits = 15      !! a double holds any integer of so many
  integer, parameter :: exact_power = 22       !! 10**22 is the largest power a double holds exactly
  integer, parameter :: largest_power = 308    !! of ten in the range of doubles
  integer, parameter :: smallest_power = -307  !! where doubles still have all their digits
  real(wp), parameter :: power_of_ten(0:exact_power) = [1e0_wp, 1e1_wp, 1e2_wp, 1e3_wp, 1e4_wp, &
                                                        1e5_wp, 1e6_wp, 1e7_wp, 1e8_wp, 1e9_wp, &
                                                        1e10_wp, 1e11_wp, 1e12_wp, 1e13_wp, &
                                                        1e14_wp, 1e15_wp, 1e16_wp, 1e17_wp, &
                                                        1e18_wp, 1e19_wp, 1e20_wp, 1e21_wp, 1e22_wp]
  character(len=*), parameter :: digits = '0123456789'
  character(len=*), parameter :: digits_of_huge = '17976931348623157'

contains

  pure subroutine text_as_real(word, x, reason)
    !! A word as a real: a sign, digits with a point, an exponent of e or d. The reason is '' if it
    !! is one, and x is left alone if it is none. What is closer to zero than doubles are exact for
    !! is zero; what is too large is found by its digits: reading it would trap.
    character(len=*), intent(in) :: word
    real(wp), intent(inout) :: x   !! [any unit]
    character(len=:), allocatable, intent(out) :: reason
    integer(i8) :: mantissa
    integer :: n_digit, n_after, exponent, first, status
    logical :: is_number
    real(wp) :: magnitude

    reason = ''
    call take_apart(word, mantissa, n_digit, n_after, exponent, first, is_number)
    if (len(word) > longest_number) then
      reason = 'is too long for a number: it has more than 100 characters'
    else if (is_special(word)) then
      reason = 'must be a finite number'
    else if (.not. is_number) then
      reason = 'must be a number'
    else if (n_digit == 0 .or. exponent + n_digit - 1 - n_after < smallest_power) then
      x = 0.0_wp
    else if (exponent + n_digit - 1 - n_after > largest_power .or. &
             (exponent + n_digit - 1 - n_after == largest_power .and. &
              exceeds_huge(word(first:)))) then
      reason = 'is too large'
    else if (n_digit <= exact_digits .and. abs(exponent - n_after) <= exact_power) then
      ! both factors are exact, so that the result is the nearest double
      if (exponent >= n_after) magnitude = real(mantissa, wp)*power_of_ten(exponent - n_after)
      if (exponent < n_after) magnitude = real(mantissa, wp)/power_of_ten(n_after - exponent)
      x = magnitude
      if (word(1:1) == '-') x = -magnitude
    else
      read (word, *, iostat=status) magnitude
      if (status == 0) x = magnitude
      if (status /= 0) reason = 'must be a number'
    end if
  end subroutine text_as_real

  pure subroutine take_apart(word, mantissa, n_digit, n_after, exponent, first, is_number)
    !! Digits and exponent of a number.
    character(len=*), intent(in) :: word
    integer(i8), intent(out) :: mantissa   !! the first 15 digits as an integer, without the point
    integer, intent(out) :: n_digit        !! without zeros in front
    integer, intent(out) :: n_after        !! digits after the point
    integer, intent(out) :: exponent
    integer, intent(out) :: first          !! place of the first digit that is not 0
    logical, intent(out) :: is_number
    integer :: k, n, digit
    logical :: has_point

    mantissa = 0_i8
    n_digit = 0
    n_after = 0
    exponent = 0
    first = 1
    n = 0
    has_point = .false.
    is_number = .false.
    k = 1
    if (scan(word, '+-') == 1) k = 2
    do k = k, len(word)
      if (word(k:k) == '.') then
        if (has_point) return
        has_point = .true.
        cycle
      end if
      digit = index(digits, word(k:k)) - 1
      if (digit < 0) exit
      n = n + 1
      if (has_point) n_after = n_after + 1
      if (n_digit == 0 .and. digit > 0) first = k
      if (n_digit > 0 .or. digit > 0) n_digit = n_digit + 1
      if (n_digit <= exact_digits) mantissa = 10_i8*mantissa + digit
    end do
    if (n == 0) return
    if (k <= len(word)) call take_exponent(word(k:), exponent, is_number)
    if (k > len(word)) is_number = .true.
  end subroutine take_apart

  pure subroutine take_exponent(word, exponent, is_number)
    !! 'e-3', 'd+05', 'E7'.
    character(len=*), intent(in) :: word
    integer, intent(out) :: exponent
    logical, intent(out) :: is_number
    integer :: first, k

    exponent = 0
    is_number = .false.
    if (scan(word(1:1), 'eEdD') == 0) return
    first = 2
    if (scan(word(2:), '+-') == 1) first = 3
    if (first > len(word) .or. len(word) - first + 1 > longest_exponent) return
    if (verify(word(first:), digits) /= 0) return
    do k = first, len(word)
      exponent = 10*exponent + index(digits, word(k:k)) - 1
    end do
    if (word(2:2) == '-') exponent = -exponent
    is_number = .true.
  end subroutine take_exponent

  pure logical function exceeds_huge(word)
    !! Is d.ddd * 10**308 beyond the range of doubles?
    character(len=*), intent(in) :: word   !! from its first digit that is not 0
    character(len=len(digits_of_huge)) :: leading
    integer :: k, n

    leading = repeat('0', len(leading))
    n = 0
    do k = 1, len(word)
      if (word(k:k) == '.') cycle
      if (n == len(leading) .or. index(digits, word(k:k)) == 0) exit
      n = n + 1
      leading(n:n) = word(k:k)
    end do
    exceeds_huge = leading > digits_of_huge
  end function exceeds_huge

  pure subroutine text_as_integer(word, n, reason)
    !! A word as an integer; the reason is '' if it is one, and n is left alone if it is none.
    character(len=*), intent(in) :: word
    integer, intent(inout) :: n
    character(len=:), allocatable, intent(out) :: reason
    integer(i8) :: value
    integer :: first, k

    reason = 'must be an integer'
    first = 1
    if (scan(word, '+-') == 1) first = 2
    if (first > len(word)) return
    if (verify(word(first:), digits) /= 0) return
    reason = 'is too large'
    value = 0_i8
    do k = first, len(word)
      value = 10_i8*value + index(digits, word(k:k)) - 1
      if (value > int(huge(n), i8)) return
    end do
    reason = ''
    n = int(value)
    if (word(1:1) == '-') n = -n
  end subroutine text_as_integer

  pure logical function is_special(word)
    !! Is a word the name of a number that is none?
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: name

    is_special = .false.
    if (scan(word, 'nNiI') == 0) return
    name = lower_case(word(merge(2, 1, scan(word, '+-') == 1):))
    select case (name)
    case ('nan', 'inf', 'infinity', '-nan', '1.#inf', '1.#qnan')
      is_special = .true.
    case default
      is_special = index(name, 'nan(') == 1
    end select
  end function is_special
end module dosui_numbers

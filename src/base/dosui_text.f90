!! Small tools for text: numbers as text, names and their nearest known spelling.
module dosui_text
  use dosui_kinds, only: wp, i8
  implicit none
  private

  public :: to_text, vector_text, lower_case, nearest_name, starts_with

  interface to_text
    !! A value as text without blanks around it.
    module procedure text_of_integer
    module procedure text_of_long
    module procedure text_of_real
    module procedure text_of_logical
  end interface to_text

  integer, parameter :: all_digits = 17   !! significant digits that identify any real(wp)

contains

  pure function text_of_integer(x) result(text)
    !! An integer as text.
    integer, intent(in) :: x
    character(len=:), allocatable :: text

    text = text_of_long(int(x, i8))
  end function text_of_integer

  pure function text_of_long(x) result(text)
    !! A 64-bit integer as text.
    integer(i8), intent(in) :: x
    character(len=:), allocatable :: text
    character(len=24) :: buffer

    write (buffer, '(i0)') x
    text = trim(buffer)
  end function text_of_long

  pure function text_of_logical(x) result(text)
    !! A logical as text.
    logical, intent(in) :: x
    character(len=:), allocatable :: text

    if (x) then
      text = 'true'
    else
      text = 'false'
    end if
  end function text_of_logical

  pure function text_of_real(x, digits) result(text)
    !! The shortest text that reads back as x: '0.025', '1.25e-3', '1e9', 'nan', 'inf'.
    real(wp), intent(in) :: x   !! [any unit]
    integer, intent(in), optional :: digits   !! at most so many significant digits (then rounded)
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    character(len=16) :: layout
    real(wp) :: again
    integer :: n, most

    if (.not. is_finite(x)) then
      text = text_of_special(x)
      return
    end if
    if (.not. present(digits)) then
      text = text_of_decimal(x)
      if (len(text) > 0) return
    end if
    most = all_digits
    if (present(digits)) most = max(1, min(all_digits, digits))
    ! rounding the largest numbers up could overflow on reading back
    n = 1
    if (abs(x) > 1.0e307_wp) n = most
    do n = n, most
      write (layout, '(a, i0, a)') '(es32.', n - 1, 'e3)'
      write (buffer, layout) x
      if (n == most) exit
      read (buffer, *) again
      if (.not. (again < x .or. again > x)) exit
    end do
    text = tidy(adjustl(buffer))
  end function text_of_real

  pure function text_of_decimal(x) result(text)
    !! The shortest text of a real that is a decimal of at most 15 digits, as numbers of scenes
    !! are; '' for others. A quotient of two numbers that doubles hold exactly is the double
    !! nearest to that decimal, which is what reading it gives.
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    integer, parameter :: exact_power = 22   ! of ten, in a double
    real(wp), parameter :: most = 1.0e15_wp
    character(len=15) :: buffer
    character(len=:), allocatable :: sign_text
    real(wp) :: scale, whole
    integer(i8) :: number
    integer :: power, first

    text = ''
    sign_text = ''
    if (x < 0.0_wp) sign_text = '-'
    if (.not. abs(x) > 0.0_wp) then
      if (sign(1.0_wp, x) > 0.0_wp) text = '0'
      return
    end if
    scale = 1.0_wp
    do power = 0, exact_power
      if (.not. abs(x) < most/scale) return
      whole = anint(abs(x)*scale)
      if (.not. abs(whole/scale - abs(x)) > 0.0_wp) exit
      scale = scale*10.0_wp
    end do
    if (power > exact_power .or. .not. whole < most .or. .not. whole > 0.0_wp) return
    number = int(whole, i8)
    first = len(buffer) + 1
    do while (number > 0_i8)
      first = first - 1
      buffer(first:first) = achar(iachar('0') + int(mod(number, 10_i8)))
      number = number/10_i8
    end do
    text = sign_text//assembled(without_trailing_zeros(buffer(first:)), &
                                len(buffer) - first - power)
  end function text_of_decimal

  pure function vector_text(x) result(text)
    !! Components in brackets, 6 digits each; round-off beside the others is 0.
    real(wp), intent(in) :: x(:)   !! [any unit]
    character(len=:), allocatable :: text
    real(wp), parameter :: round_off = 1.0e-12_wp
    integer :: d

    text = '('
    do d = 1, size(x)
      if (d > 1) text = text//', '
      if (abs(x(d)) <= round_off*maxval(abs(x))) then
        text = text//'0'
      else
        text = text//text_of_real(x(d), 6)
      end if
    end do
    text = text//')'
  end function vector_text

  pure function tidy(scientific) result(text)
    !! '1.2500E-003' becomes '1.25e-3', '2.5E-002' becomes '0.025'.
    character(len=*), intent(in) :: scientific   !! in the layout esw.de3
    character(len=:), allocatable :: text
    character(len=:), allocatable :: sign, mantissa
    integer :: e, exponent

    e = index(scientific, 'E')
    read (scientific(e + 1:), *) exponent
    mantissa = scientific(:e - 1)
    sign = ''
    if (mantissa(1:1) == '-') then
      sign = '-'
      mantissa = mantissa(2:)
    end if
    mantissa = mantissa(1:1)//mantissa(3:)      ! digits only: d.ddd without the point
    text = sign//assembled(without_trailing_zeros(mantissa), exponent)
  end function tidy

  pure function assembled(digits, exponent) result(text)
    !! The number d.ddd * 10**exponent, with an exponent if it would be long without.
    character(len=*), intent(in) :: digits
    integer, intent(in) :: exponent
    character(len=:), allocatable :: text

    if (exponent >= -2 .and. exponent <= 5) then
      text = fixed_point(digits, exponent)
    else if (len(digits) == 1) then
      text = digits//'e'//text_of_integer(exponent)
    else
      text = digits(1:1)//'.'//digits(2:)//'e'//text_of_integer(exponent)
    end if
  end function assembled

  pure function fixed_point(digits, exponent) result(text)
    !! The number d.ddd * 10**exponent without an exponent.
    character(len=*), intent(in) :: digits
    integer, intent(in) :: exponent
    character(len=:), allocatable :: text

    if (exponent < 0) then
      text = '0.'//repeat('0', -exponent - 1)//digits
    else if (len(digits) <= exponent + 1) then
      text = digits//repeat('0', exponent + 1 - len(digits))
    else
      text = digits(:exponent + 1)//'.'//digits(exponent + 2:)
    end if
  end function fixed_point

  pure function without_trailing_zeros(digits) result(text)
    !! '1250' becomes '125'; one digit always stays.
    character(len=*), intent(in) :: digits
    character(len=:), allocatable :: text
    integer :: n

    n = len(digits)
    do while (n > 1)
      if (digits(n:n) /= '0') exit
      n = n - 1
    end do
    text = digits(:n)
  end function without_trailing_zeros

  pure logical function is_finite(x) result(finite)
    !! Neither infinite nor not-a-number; by its bits, because comparing a NaN may trap.
    real(wp), intent(in) :: x
    integer(i8), parameter :: exponent_mask = 2047_i8*2_i8**52
    integer(i8) :: bits

    bits = transfer(x, bits)
    finite = iand(bits, exponent_mask) /= exponent_mask
  end function is_finite

  pure function text_of_special(x) result(text)
    !! 'nan', 'inf' or '-inf'.
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    integer(i8), parameter :: fraction_mask = 2_i8**52 - 1_i8
    integer(i8) :: bits

    bits = transfer(x, bits)
    if (iand(bits, fraction_mask) /= 0_i8) then
      text = 'nan'
    else if (bits < 0_i8) then
      text = '-inf'
    else
      text = 'inf'
    end if
  end function text_of_special

  pure function lower_case(text) result(lower)
    !! ASCII capitals made small.
    character(len=*), intent(in) :: text
    character(len=len(text)) :: lower
    integer :: k

    lower = text
    do k = 1, len(text)
      if (text(k:k) >= 'A' .and. text(k:k) <= 'Z') lower(k:k) = achar(iachar(text(k:k)) + 32)
    end do
  end function lower_case

  pure logical function starts_with(text, beginning) result(starts)
    !! Does a text begin with these characters?
    character(len=*), intent(in) :: text, beginning

    starts = .false.
    if (len(text) >= len(beginning)) starts = text(:len(beginning)) == beginning
  end function starts_with

  pure function nearest_name(word, names) result(name)
    !! The known name that is most likely meant, '' if none is near: at most max(1, length/3)
    !! characters changed, left out, added or swapped; capitals do not count.
    character(len=*), intent(in) :: word
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: name
    integer :: k, distance, best

    name = ''
    best = max(1, len_trim(word)/3) + 1
    best = min(best, len_trim(word))      ! nothing of the word left is no resemblance
    do k = 1, size(names)
      distance = edit_distance(lower_case(trim(word)), lower_case(trim(names(k))))
      if (distance < best) then
        best = distance
        name = trim(names(k))
      end if
    end do
  end function nearest_name

  pure integer function edit_distance(a, b) result(distance)
    !! Damerau-Levenshtein distance (optimal string alignment).
    character(len=*), intent(in) :: a, b
    integer :: d(-1:len(a), -1:len(b))   ! row and column -1 only keep the subscripts legal
    integer :: i, j, change

    d(-1, :) = len(a) + len(b)
    d(:, -1) = len(a) + len(b)
    do i = 0, len(a)
      d(i, 0) = i
    end do
    do j = 0, len(b)
      d(0, j) = j
    end do
    do j = 1, len(b)
      do i = 1, len(a)
        change = 1
        if (a(i:i) == b(j:j)) change = 0
        d(i, j) = min(d(i - 1, j) + 1, d(i, j - 1) + 1, d(i - 1, j - 1) + change)
        if (i > 1 .and. j > 1) then
          if (a(i:i) == b(j - 1:j - 1) .and. a(i - 1:i - 1) == b(j:j)) then
            d(i, j) = min(d(i, j), d(i - 2, j - 2) + 1)
          end if
        end if
      end do
    end do
    distance = d(len(a), len(b))
  end function edit_distance
end module dosui_text

!! Comparisons behind the assertions, on flattened arrays of the widest kinds.
!!
!! A NaN never compares: it is recognised by its bits, so that the check works where invalid
!! operations trap, and signalling NaN of uninitialised values are reported instead of crashing.
module funit_compare
  use, intrinsic :: iso_fortran_env, only: real64, int64
  use funit_state, only: SourceLocation, report_failure
  implicit none
  private

  public :: compare_integers, compare_reals, compare_logicals, compare_strings

  integer(int64), parameter :: mantissa_mask = 2_int64**52 - 1
  integer(int64), parameter :: exponent_mask = 2047_int64*2_int64**52

contains

  subroutine compare_integers(relation, expected, expected_shape, actual, actual_shape, &
                              message, location)
    !! Does `expected relation actual` hold for every element? One expected value serves all.
    character(len=*), intent(in) :: relation   !! '==', '/=', '<', '<=', '>' or '>='
    integer(int64), intent(in) :: expected(:), actual(:)
    integer, intent(in) :: expected_shape(:), actual_shape(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location
    integer(int64) :: e, a
    integer :: k
    logical :: holds

    if (.not. same_shape(expected_shape, actual_shape, message, location)) return
    do k = 1, size(actual)
      e = expected(merge(1, k, size(expected_shape) == 0))
      a = actual(k)
      select case (relation)
      case ('==')
        holds = e == a
      case ('/=')
        holds = e /= a
      case ('<')
        holds = e < a
      case ('<=')
        holds = e <= a
      case ('>')
        holds = e > a
      case ('>=')
        holds = e >= a
      case default
        holds = .false.
      end select
      if (.not. holds) then
        call report_failure(location, &
                            relation_text(relation, integer_text(e), integer_text(a))// &
                            place_text(k, actual_shape), message)
        return
      end if
    end do
  end subroutine compare_integers

  subroutine compare_reals(relation, expected, expected_shape, actual, actual_shape, tolerance, &
                           message, location)
    !! As `compare_integers`; equal means not further apart than the tolerance.
    character(len=*), intent(in) :: relation
    real(real64), intent(in) :: expected(:), actual(:), tolerance
    integer, intent(in) :: expected_shape(:), actual_shape(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location
    character(len=:), allocatable :: text
    real(real64) :: worst
    integer :: k, first, n_bad

    if (.not. same_shape(expected_shape, actual_shape, message, location)) return
    first = 0
    n_bad = 0
    worst = 0.0_real64
    do k = 1, size(actual)
      associate (e => expected(merge(1, k, size(expected_shape) == 0)), a => actual(k))
        if (reals_hold(relation, e, a, tolerance)) cycle
        n_bad = n_bad + 1
        if (first == 0) first = k
        if (is_finite(e) .and. is_finite(a)) worst = max(worst, abs(0.5_real64*a - 0.5_real64*e))
      end associate
    end do
    if (first == 0) return
    associate (e => expected(merge(1, first, size(expected_shape) == 0)), a => actual(first))
      text = relation_text(relation, real_text(e), real_text(a))//place_text(first, actual_shape)
    end associate
    if (relation == '==') text = text//'; tolerance '//real_text(tolerance)
    if (worst < 0.25_real64*huge(worst)) text = text//'; difference '//real_text(2*worst)
    if (size(actual) > 1) then
      text = text//' at most, '//integer_text(int(n_bad, int64))//' of '// &
             integer_text(size(actual, kind=int64))//' elements fail'
    end if
    call report_failure(location, text, message)
  end subroutine compare_reals

  logical function reals_hold(relation, e, a, tolerance) result(holds)
    character(len=*), intent(in) :: relation
    real(real64), intent(in) :: e, a, tolerance

    holds = .false.
    if (is_nan(e) .or. is_nan(a) .or. is_nan(tolerance)) return
    select case (relation)
    case ('==')
      if (is_finite(e) .and. is_finite(a)) then
        holds = abs(a - e) <= tolerance
      else
        holds = transfer(e, 0_int64) == transfer(a, 0_int64)
      end if
    case ('/=')
      holds = e < a .or. e > a
    case ('<')
      holds = e < a
    case ('<=')
      holds = e <= a
    case ('>')
      holds = e > a
    case ('>=')
      holds = e >= a
    end select
  end function reals_hold

  subroutine compare_logicals(expected, expected_shape, actual, actual_shape, message, location)
    logical, intent(in) :: expected(:), actual(:)
    integer, intent(in) :: expected_shape(:), actual_shape(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location
    character(len=5), parameter :: word(0:1) = ['false', 'true ']
    integer :: k
    logical :: e

    if (.not. same_shape(expected_shape, actual_shape, message, location)) return
    do k = 1, size(actual)
      e = expected(merge(1, k, size(expected_shape) == 0))
      if (e .neqv. actual(k)) then
        call report_failure(location, 'expected '//trim(word(merge(1, 0, e)))//', found '// &
                            trim(word(merge(1, 0, actual(k))))//place_text(k, actual_shape), &
                            message)
        return
      end if
    end do
  end subroutine compare_logicals

  subroutine compare_strings(expected, actual, message, location)
    !! Blanks before and after the text do not count (pFUnit's default).
    character(len=*), intent(in) :: expected, actual
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (trim(adjustl(expected)) == trim(adjustl(actual))) return
    call report_failure(location, 'expected "'//trim(adjustl(expected))//'", found "'// &
                        trim(adjustl(actual))//'"', message)
  end subroutine compare_strings

  logical function same_shape(expected, actual, message, location)
    !! Shapes must agree unless the expected value is a scalar.
    integer, intent(in) :: expected(:), actual(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    same_shape = .true.
    if (size(expected) == 0) return
    same_shape = all(expected == actual)
    if (.not. same_shape) then
      call report_failure(location, 'expected shape '//list_text(expected)//', found shape '// &
                          list_text(actual), message)
    end if
  end function same_shape

  function relation_text(relation, e, a) result(text)
    character(len=*), intent(in) :: relation, e, a
    character(len=:), allocatable :: text

    if (relation == '==') then
      text = 'expected '//e//', found '//a
    else
      text = 'not true: '//e//' '//relation//' '//a
    end if
  end function relation_text

  function place_text(k, actual_shape) result(text)
    !! ' at (2, 5)' for element k of an array.
    integer, intent(in) :: k, actual_shape(:)
    character(len=:), allocatable :: text
    integer :: place(size(actual_shape)), rest, i

    text = ''
    if (size(actual_shape) == 0) return
    rest = k - 1
    do i = 1, size(actual_shape)
      place(i) = mod(rest, actual_shape(i)) + 1
      rest = rest/actual_shape(i)
    end do
    text = ' at '//list_text(place)
  end function place_text

  function list_text(values) result(text)
    integer, intent(in) :: values(:)
    character(len=:), allocatable :: text
    integer :: i

    text = '('
    do i = 1, size(values)
      if (i > 1) text = text//', '
      text = text//integer_text(int(values(i), int64))
    end do
    text = text//')'
  end function list_text

  function integer_text(value) result(text)
    integer(int64), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer

    write (buffer, '(i0)') value
    text = trim(buffer)
  end function integer_text

  function real_text(value) result(text)
    real(real64), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=32) :: buffer

    if (is_nan(value)) then
      text = 'NaN'
    else
      write (buffer, '(es24.16e3)') value
      text = trim(adjustl(buffer))
    end if
  end function real_text

  logical function is_nan(value)
    real(real64), intent(in) :: value

    is_nan = .not. is_finite(value) .and. iand(transfer(value, 0_int64), mantissa_mask) /= 0_int64
  end function is_nan

  logical function is_finite(value)
    real(real64), intent(in) :: value

    is_finite = iand(transfer(value, 0_int64), exponent_mask) /= exponent_mask
  end function is_finite
end module funit_compare

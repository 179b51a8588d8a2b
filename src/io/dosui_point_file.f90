!! Particles from a table of text (CSV): a place in each line and, if known, a volume.
module dosui_point_file
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_fields, only: field_name, find_fields, line_limit, most_fields, next_line, text_start
  use dosui_numbers, only: is_special, text_as_real
  use dosui_sort, only: sort_permutation
  use dosui_text, only: lower_case, to_text
  implicit none
  private

  public :: parse_points

  real(wp), parameter :: largest = 1.0e15_wp         !! coordinate [m], volume [m3]
  real(wp), parameter :: smallest_part = 1.0e-6_wp   !! of the mean volume [-]
  character(len=1), parameter :: name_of(3) = ['x', 'y', 'z']

contains

  subroutine parse_points(text, position, volume, line_number, message)
    !! The particles of a file. Columns are parted by commas, semicolons, blanks or tabs; a first
    !! line with names picks x, (y,) z and volume among others; without one they come in this order.
    character(len=*), intent(in) :: text
    real(wp), allocatable, intent(out) :: position(:, :)     !! (ndim, n) [m]
    real(wp), allocatable, intent(out) :: volume(:)          !! not allocated: none given [m3]
    integer, allocatable, intent(out) :: line_number(:)      !! (n) in the file
    character(len=:), allocatable, intent(out) :: message    !! '' if all is well
    real(wp), allocatable :: row(:, :)   ! the places, then the volume
    integer :: start(most_fields), finish(most_fields)
    integer :: column(ndim + 1), n, n_column, number, place, first, last, n_word
    logical :: has_names

    n = line_limit(text)
    allocate (row(ndim + 1, n), line_number(n))
    message = ''
    column = 0
    n = 0
    n_column = 0
    number = 0
    place = text_start(text)
    do while (place <= len(text) .and. len(message) == 0)
      call next_line(text, place, number, first, last)
      call find_fields(text(first:last), ',;', start, finish, n_word)
      if (n_word == 0) cycle
      if (n_word > most_fields) then
        message = 'line '//to_text(number)//': more than '//to_text(most_fields)//' columns'
      else if (n_column == 0) then
        n_column = n_word
        call find_columns(text(first:last), start, finish, n_word, column, has_names, message)
        if (has_names) cycle
      else if (n_word /= n_column) then
        message = 'line '//to_text(number)//': has '//to_text(n_word)// &
                  ' columns, the first line has '//to_text(n_column)// &
                  ' (numbers have points, not commas)'
      end if
      if (len(message) > 0) exit
      n = n + 1
      line_number(n) = number
      call read_row(text(first:last), start, finish, column, number, row(:, n), message)
    end do
    if (len(message) == 0 .and. n == 0) message = 'holds no particles'
    position = row(:ndim, :n)
    line_number = line_number(:n)
    if (column(ndim + 1) > 0) volume = row(ndim + 1, :n)
    if (len(message) == 0 .and. column(ndim + 1) > 0) then
      call check_volumes(volume, line_number, column(ndim + 1), message)
    end if
    if (len(message) == 0) call find_twins(position, line_number, message)
  end subroutine parse_points

  subroutine read_row(line, start, finish, column, number, row, message)
    !! The numbers of one line.
    character(len=*), intent(in) :: line
    integer, intent(in) :: start(:), finish(:)      !! of its fields
    integer, intent(in) :: column(ndim + 1)         !! of x, (y,) z, volume; 0 for no volume
    integer, intent(in) :: number                   !! of the line
    real(wp), intent(inout) :: row(ndim + 1)
    character(len=:), allocatable, intent(inout) :: message
    character(len=:), allocatable :: reason
    integer :: k

    do k = 1, ndim + 1
      if (column(k) == 0) cycle
      associate (word => line(start(column(k)):finish(column(k))))
        if (len_trim(word) == 0) then
          reason = 'is empty'
        else
          call text_as_real(word, row(k), reason)
        end if
        if (len(reason) == 0 .and. .not. abs(row(k)) <= largest) then
          reason = 'must be between -1e15 and 1e15'
        end if
        if (len(reason) == 0 .and. k > ndim .and. .not. row(k) > 0.0_wp) then
          reason = 'the volume must be positive'
        end if
        if (len(reason) == 0) cycle
        message = field_name(number, column(k), title(k), word)//': '//reason
        return
      end associate
    end do
  end subroutine read_row

  pure subroutine check_volumes(volume, line_number, column, message)
    !! Volumes that cannot be those of particles beside the others: typing errors, other units.
    real(wp), intent(in) :: volume(:)   !! [m3]
    integer, intent(in) :: line_number(:), column
    character(len=:), allocatable, intent(inout) :: message
    real(wp) :: mean
    integer :: p

    mean = sum(volume)/real(size(volume), wp)
    do p = 1, size(volume)
      if (volume(p) >= smallest_part*mean) cycle
      message = field_name(line_number(p), column, 'volume', to_text(volume(p)))// &
                ': must be at least '//to_text(smallest_part*mean, 3)//' m3, '// &
                to_text(smallest_part)//' of the mean volume'
      return
    end do
  end subroutine check_volumes

  pure subroutine find_columns(line, start, finish, n_word, column, has_names, message)
    !! Which column holds what, from the first line.
    character(len=*), intent(in) :: line
    integer, intent(in) :: start(:), finish(:)   !! of its fields
    integer, intent(in) :: n_word
    integer, intent(out) :: column(ndim + 1)     !! of x, (y,) z, volume; 0 for no volume
    logical, intent(out) :: has_names            !! the line holds names
    character(len=:), allocatable, intent(inout) :: message
    integer :: k, j

    has_names = is_name(line(start(1):finish(1)))
    column = 0
    if (has_names) then
      do k = 1, ndim + 1
        do j = 1, n_word
          if (lower_case(trim(line(start(j):finish(j)))) /= title(k)) cycle
          if (column(k) > 0) message = "has two columns '"//title(k)//"'"
          column(k) = j
        end do
        if (column(k) == 0 .and. k <= ndim) message = "has no column '"//title(k)//"'"
      end do
    else if (n_word == ndim .or. n_word == ndim + 1) then
      column = [(k, k=1, ndim + 1)]
      if (n_word == ndim) column(ndim + 1) = 0
    else
      message = 'has '//to_text(n_word)//' columns, not '//to_text(ndim)//' or '// &
                to_text(ndim + 1)//': a first line with names tells what they hold'
    end if
  end subroutine find_columns

  pure logical function is_name(word) result(is)
    !! Does a word name a column? What begins as a number does not, nor does what is no number.
    character(len=*), intent(in) :: word

    is = .false.
    if (len_trim(word) == 0) return
    is = verify(lower_case(word(1:1)), 'abcdefghijklmnopqrstuvwxyz_') == 0 .and. &
         .not. is_special(trim(word))
  end function is_name

  pure function title(k) result(name)
    !! Name of a column: x, (y,) z, volume.
    integer, intent(in) :: k
    character(len=:), allocatable :: name

    if (k > ndim) then
      name = 'volume'
    else
      name = name_of(merge(3, k, k == ndim))
    end if
  end function title

  subroutine find_twins(position, line_number, message)
    !! Two particles in one place.
    real(wp), intent(in) :: position(:, :)
    integer, intent(in) :: line_number(:)
    character(len=:), allocatable, intent(inout) :: message
    integer, allocatable :: order(:)
    integer(i8), allocatable :: pattern(:)
    integer :: k, d

    allocate (pattern(size(position, 2)), source=0_i8)
    do d = 1, ndim   ! equal places have equal sums of bit patterns
      pattern = ieor(ishftc(pattern, 21), transfer(position(d, :) + 0.0_wp, pattern))
    end do
    call sort_permutation(pattern, order)
    do k = 1, size(order) - 1
      if (all(abs(position(:, order(k)) - position(:, order(k + 1))) <= 0.0_wp)) then
        message = 'lines '//to_text(line_number(order(k)))//' and '// &
                  to_text(line_number(order(k + 1)))//' hold the same place'
        return
      end if
    end do
  end subroutine find_twins
end module dosui_point_file

!! Particles from a table of text (CSV): a place in each line and, if known, a volume.
module dosui_point_file
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_sort, only: sort_permutation
  use dosui_text, only: lower_case, to_text
  implicit none
  private

  public :: parse_points

  integer, parameter :: most_columns = 64
  integer, parameter :: word_length = 40
  character(len=word_length), parameter :: name_of(3) = [character(len=word_length) :: 'x', 'y', &
                                                                                                'z']

contains

  subroutine parse_points(text, position, volume, line_number, message)
    !! The particles of a file. Columns are parted by commas, semicolons, blanks or tabs; a first
    !! line with names picks x, (y,) z and volume among others; without one they come in this order.
    character(len=*), intent(in) :: text
    real(wp), allocatable, intent(out) :: position(:, :)     !! (ndim, n) [m]
    real(wp), allocatable, intent(out) :: volume(:)          !! not allocated: none given [m3]
    integer, allocatable, intent(out) :: line_number(:)      !! (n) in the file
    character(len=:), allocatable, intent(out) :: message    !! '' if all is well
    character(len=word_length) :: word(most_columns)
    character(len=:), allocatable :: line
    real(wp) :: value
    real(wp), allocatable :: row(:, :)   ! the places, then the volume
    integer :: column(ndim + 1), n, number, first, length, n_word, k, status
    logical :: has_names

    n = count([(text(k:k) == new_line('a'), k=1, len(text))]) + 1
    allocate (row(ndim + 1, n), line_number(n))
    message = ''
    column = 0
    n = 0
    number = 0
    first = 1
    do while (first <= len(text))
      length = index(text(first:), new_line('a')) - 1
      if (length < 0) length = len(text) - first + 1
      line = text(first:first + length - 1)
      first = first + length + 1
      number = number + 1
      call split(line, word, n_word)
      if (n_word == 0) cycle
      if (all(column == 0)) then
        call find_columns(word(:n_word), column, has_names, message)
        if (len(message) > 0) exit
        if (has_names) cycle
      end if
      n = n + 1
      line_number(n) = number
      do k = 1, ndim + 1
        if (column(k) == 0) cycle
        status = 1
        if (column(k) <= n_word) read (word(column(k)), *, iostat=status) value
        if (status == 0) then
          if (.not. ieee_is_finite(value)) status = 1
        end if
        if (status /= 0) then
          message = 'line '//to_text(number)//": no number for '"//title(k)//"'"
          exit
        end if
        row(k, n) = value
      end do
      if (len(message) > 0) exit
      if (column(ndim + 1) == 0) cycle
      if (.not. row(ndim + 1, n) > 0.0_wp) then
        message = 'line '//to_text(number)//': the volume must be positive'
        exit
      end if
    end do
    if (len(message) == 0 .and. n == 0) message = 'holds no particles'
    position = row(:ndim, :n)
    line_number = line_number(:n)
    if (column(ndim + 1) > 0) volume = row(ndim + 1, :n)
    if (len(message) == 0) call find_twins(position, line_number, message)
  end subroutine parse_points

  pure subroutine find_columns(word, column, has_names, message)
    !! Which column holds what, from the first line.
    character(len=*), intent(in) :: word(:)
    integer, intent(out) :: column(ndim + 1)     !! of x, (y,) z, volume; 0 for no volume
    logical, intent(out) :: has_names            !! the line holds names
    character(len=:), allocatable, intent(inout) :: message
    real(wp) :: value
    integer :: k, status

    read (word(1), *, iostat=status) value
    has_names = status /= 0
    column = 0
    if (has_names) then
      do k = 1, ndim + 1
        column(k) = findloc(word == title(k), .true., dim=1)
        if (column(k) == 0 .and. k <= ndim) message = "has no column '"//title(k)//"'"
      end do
    else if (size(word) == ndim .or. size(word) == ndim + 1) then
      column = [(k, k=1, ndim + 1)]
      if (size(word) == ndim) column(ndim + 1) = 0
    else
      message = 'has '//to_text(size(word))//' columns, not '//to_text(ndim)//' or '// &
                to_text(ndim + 1)//': a first line with names tells what they hold'
    end if
  end subroutine find_columns

  pure function title(k) result(name)
    !! Name of a column: x, (y,) z, volume.
    integer, intent(in) :: k
    character(len=:), allocatable :: name

    if (k > ndim) then
      name = 'volume'
    else
      name = trim(name_of(merge(3, k, k == ndim)))
    end if
  end function title

  pure subroutine split(line, word, n)
    !! Words of a line up to a '#', in lower case and without quotes.
    character(len=*), intent(in) :: line
    character(len=word_length), intent(out) :: word(:)
    integer, intent(out) :: n
    character(len=*), parameter :: blank = ' '//achar(9)//achar(13)
    integer :: k, length
    logical :: after_comma, inside   ! of a word

    word = ''
    n = 0
    length = 0
    inside = .false.
    after_comma = .true.
    do k = 1, len(line)
      if (line(k:k) == '#') exit
      if (scan(line(k:k), ',;') > 0) then
        if (after_comma .and. .not. inside) n = n + 1   ! an empty column
        after_comma = .true.
        inside = .false.
      else if (scan(line(k:k), blank) > 0) then
        inside = .false.
      else if (scan(line(k:k), '"''') == 0) then
        if (.not. inside) then
          n = n + 1
          length = 0
        end if
        inside = .true.
        after_comma = .false.
        length = length + 1
        if (n <= size(word) .and. length <= word_length) word(n) (length:length) = line(k:k)
      end if
      if (n >= size(word)) exit
    end do
    do k = 1, n
      word(k) = lower_case(word(k))
    end do
  end subroutine split

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

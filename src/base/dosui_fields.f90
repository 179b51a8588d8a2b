!! Lines of a text and the fields of a line, as tables have them.
module dosui_fields
  use dosui_text, only: to_text
  implicit none
  private

  public :: text_start, next_line, line_limit, find_fields, field_name, shown_word

  integer, parameter, public :: most_fields = 64   !! of a line

  character(len=1), parameter :: tab = achar(9), newline = achar(10), return = achar(13)
  character(len=3), parameter :: byte_order_mark = char(239)//char(187)//char(191)

contains

  pure integer function text_start(text) result(place)
    !! Place of the first character after a byte order mark (of UTF-8).
    character(len=*), intent(in) :: text

    place = 1
    if (index(text, byte_order_mark) == 1) place = len(byte_order_mark) + 1
  end function text_start

  pure integer function line_limit(text) result(n)
    !! At least as many lines as a text has.
    character(len=*), intent(in) :: text
    integer :: k

    n = 1
    do k = 1, len(text)
      if (text(k:k) == newline .or. text(k:k) == return) n = n + 1
    end do
  end function line_limit

  pure subroutine next_line(text, place, number, first, last)
    !! The next line of a text; a line feed, a carriage return or both end it.
    character(len=*), intent(in) :: text
    integer, intent(inout) :: place    !! of the line's first character, then of the next line's
    integer, intent(inout) :: number   !! of the line
    integer, intent(out) :: first, last

    first = place
    do place = first, len(text)
      if (text(place:place) == newline .or. text(place:place) == return) exit
    end do
    last = place - 1
    if (place < len(text)) then
      if (text(place:place + 1) == return//newline) place = place + 1
    end if
    place = place + 1
    number = number + 1
  end subroutine next_line

  pure subroutine find_fields(line, separators, first, last, n)
    !! The fields of a line up to a '#': between blanks, tabs and separators, or in quotes. Nothing
    !! between two separators is an empty field.
    character(len=*), intent(in) :: line
    character(len=*), intent(in) :: separators   !! besides blanks and tabs
    integer, intent(out) :: first(most_fields), last(most_fields)   !! of its characters
    integer, intent(out) :: n                    !! fields; at most most_fields + 1
    integer :: k, length
    logical :: after_separator

    n = 0
    after_separator = .true.
    k = 1
    do while (k <= len(line) .and. n <= most_fields)
      if (line(k:k) == '#') exit
      if (line(k:k) == ' ' .or. line(k:k) == tab) then
        k = k + 1
      else if (scan(line(k:k), separators) > 0) then
        if (after_separator) call append(k, k - 1, first, last, n)
        after_separator = .true.
        k = k + 1
      else if (scan(line(k:k), '"''') > 0) then
        length = index(line(k + 1:), line(k:k)) - 1
        if (length < 0) length = len(line) - k
        call append(k + 1, k + length, first, last, n)
        after_separator = .false.
        k = k + length + 2
      else
        length = scan(line(k:), ' #'//tab//separators) - 1
        if (length < 0) length = len(line) - k + 1
        call append(k, k + length - 1, first, last, n)
        after_separator = .false.
        k = k + length
      end if
    end do
  end subroutine find_fields

  pure subroutine append(begin, finish, first, last, n)
    !! One more field.
    integer, intent(in) :: begin, finish
    integer, intent(inout) :: first(most_fields), last(most_fields), n

    n = n + 1
    if (n > most_fields) return
    first(n) = begin
    last(n) = finish
  end subroutine append

  pure function field_name(line, column, name, word) result(text)
    !! A field for a message: `line 3, column 2 (volume) = '1e5000'`.
    integer, intent(in) :: line, column    !! counted from 1
    character(len=*), intent(in) :: name   !! of the column
    character(len=*), intent(in) :: word   !! what stands there
    character(len=:), allocatable :: text

    text = 'line '//to_text(line)//', column '//to_text(column)//' ('//name//')'
    if (len_trim(word) > 0) text = text//' = '//shown_word(word)
  end function field_name

  pure function shown_word(word) result(text)
    !! A word in quotes for a message: long ones are cut, characters that do not print are '?'.
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: text
    integer, parameter :: longest = 40
    integer :: k

    text = trim(word)
    if (len(text) > longest) text = text(:longest)//'...'
    do k = 1, len(text)
      if (iachar(text(k:k)) < 32 .or. iachar(text(k:k)) == 127) text(k:k) = '?'
    end do
    text = "'"//text//"'"
  end function shown_word
end module dosui_fields

!! A scanner of namelist text: `&group key = values /`, with the line of everything and clear words
!! for what is wrong. It knows no names: which groups and keys exist is the reader's business.
!!
!! Fortran's own namelist read is not used: it passes missing groups and duplicates silently and
!! takes a decimal comma for a strange name.
module dosui_namelist
  use, intrinsic :: iso_fortran_env, only: iostat_end
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_fields, only: text_start
  use dosui_file_system, only: input_problem
  use dosui_name_index, only: name_index_t
  use dosui_numbers, only: is_special, text_as_integer, text_as_real
  use dosui_problems, only: problems_t
  use dosui_text, only: lower_case, to_text
  implicit none
  private

  public :: read_bytes, read_text_file, decimal_comma

  integer, parameter :: name_room = 64  !! of a quoted text, to begin with
  integer, parameter :: few_keys = 32   !! of a group that is searched from end to end
  integer, parameter :: most_values = 10000000   !! of one key; more is surely a typing error
  integer, parameter :: largest_file = 256*1024*1024   !! of a scene, or beside it [byte]
  character(len=1), parameter :: tab = achar(9), newline = achar(10), return = achar(13)
  character(len=*), parameter :: delimiters = ' ,/!='//"'"//'"&'//achar(9)//achar(10)//achar(13)

  type, public :: namelist_value_t
    !! One value as written.
    character(len=:), allocatable :: text   !! contents of a quoted text, or the bare word
    logical :: is_quoted = .false.
    logical :: is_given = .false.           !! false: left out between indexed elements
    logical :: is_glued = .false.           !! follows a comma without blanks on either side
    integer :: line = 0
  contains
    procedure :: shown => value_shown
    procedure :: to_real => value_to_real
    procedure :: to_integer => value_to_integer
    procedure :: to_long => value_to_long
    procedure :: to_logical => value_to_logical
    procedure :: to_name => value_to_name
  end type namelist_value_t

  type, public :: namelist_key_t
    character(len=:), allocatable :: name   !! in lower case
    integer :: line = 0
    logical :: is_indexed = .false.         !! given by elements: name(2) = ...
    integer :: n_value = 0
    type(namelist_value_t), allocatable :: value(:)   !! the first n_value count
  contains
    procedure :: shown => key_shown
  end type namelist_key_t

  type, public :: namelist_group_t
    character(len=:), allocatable :: name   !! in lower case
    integer :: line = 0
    integer :: n_key = 0
    type(namelist_key_t), allocatable :: key(:)       !! the first n_key count
    type(name_index_t), private :: names              !! of the keys, if there are many
  contains
    procedure :: find => group_find
  end type namelist_group_t

  type, public :: namelist_t
    !! The groups of a text, in its order.
    character(len=:), allocatable :: file             !! for messages
    integer :: n_group = 0
    type(namelist_group_t), allocatable :: group(:)   !! the first n_group count
    type(name_index_t), private :: names              !! of the groups
  contains
    procedure :: scan => namelist_scan
    procedure :: count => namelist_count
    procedure :: find => namelist_find
  end type namelist_t

  type :: scanner_t
    !! Where in the text the scan is, and what it has met.
    character(len=:), allocatable :: text
    integer :: place = 1                 !! of the next character
    integer :: line = 1
    logical :: is_first = .true.         !! nothing but blanks before this place in its line
    integer :: slot = 0                  !! key that values belong to; 0: none, they are dropped
    logical :: expects_value = .false.   !! after '=' or ','
    logical :: had_dollar = .false.      !! '$' for '&' has been reported
    logical :: drops_values = .false.    !! of a duplicate or broken key: without complaint
    integer :: element = 1               !! where the next value goes
    integer :: repeats = 1               !! of the next value
    integer :: comma = 0                 !! place of the last comma, 0 if none since the last value
    integer :: last_end = 0              !! place of the last character of the last value
  contains
    procedure :: is_end => scanner_is_end
    procedure :: next => scanner_next
    procedure :: advance => scanner_advance
    procedure :: skip_blanks => scanner_skip_blanks
    procedure :: word => scanner_word
    procedure :: complain => scanner_complain
  end type scanner_t

contains

  ! ---------------------------------------------------------------- files

  subroutine read_text_file(path, text, err)
    !! The whole of a text file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(error_t), intent(inout) :: err

    call read_bytes(path, text, err)
    if (err%failed()) return
    if (index(text, char(255)//char(254)) == 1 .or. index(text, char(254)//char(255)) == 1) then
      call err%set('cannot read '//path//': UTF-16 text; save it as UTF-8')
    else if (index(text, achar(0)) > 0) then
      call err%set('cannot read '//path//': not a text file')
    end if
    call end_lines(text)
  end subroutine read_text_file

  pure subroutine end_lines(text)
    !! Carriage returns that end lines alone (of old Macs) become line feeds.
    character(len=:), allocatable, intent(inout) :: text
    integer :: k

    do k = 1, len(text)
      if (text(k:k) /= return) cycle
      if (k < len(text)) then
        if (text(k + 1:k + 1) == newline) cycle
      end if
      text(k:k) = newline
    end do
  end subroutine end_lines

  subroutine read_bytes(path, text, err)
    !! The whole of any file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(error_t), intent(inout) :: err
    character(len=256) :: message
    character(len=:), allocatable :: reason
    integer :: unit, status
    integer(i8) :: n

    reason = input_problem(path)   ! before it is opened: a pipe would wait for ever
    if (len(reason) > 0) then
      call err%set('cannot read '//path//': '//reason)
      return
    end if
    open (newunit=unit, file=path, access='stream', form='unformatted', action='read', &
          status='old', iostat=status, iomsg=message)
    if (status /= 0) then
      call err%set('cannot read '//path//': '//trim(message))
      return
    end if
    inquire (unit=unit, size=n)
    if (n < 0_i8 .or. n > largest_file) then
      call err%set('cannot read '//path//': it has '//to_text(n)//' bytes, more than '// &
                   to_text(largest_file))
    else
      allocate (character(len=n) :: text)
      if (n > 0) read (unit, iostat=status, iomsg=message) text
      if (status /= 0 .and. status /= iostat_end) then
        call err%set('cannot read '//path//': '//trim(message))
      end if
    end if
    close (unit)
  end subroutine read_bytes

  ! ---------------------------------------------------------------- look-up

  pure integer function namelist_count(self, name) result(n)
    !! How many groups have this name.
    class(namelist_t), intent(in) :: self
    character(len=*), intent(in) :: name

    n = self%names%count(name)
  end function namelist_count

  pure integer function namelist_find(self, name, instance) result(slot)
    !! Place of the group of this name, 0 if there is none.
    class(namelist_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: instance   !! 1: the first of its name, 2: the second, ...

    slot = self%names%find(name, instance)
  end function namelist_find

  pure integer function group_find(self, name) result(slot)
    !! Place of the key of this name, 0 if there is none.
    class(namelist_group_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer :: k

    slot = 0
    if (self%n_key > few_keys) then
      slot = self%names%find(name)
      return
    end if
    do k = 1, self%n_key
      if (self%key(k)%name == name) slot = k
    end do
  end function group_find

  ! ---------------------------------------------------------------- values

  pure function value_shown(self) result(text)
    !! The value as written, for messages.
    class(namelist_value_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = ''
    if (.not. self%is_given) return
    text = self%text
    if (self%is_quoted) text = "'"//text//"'"
  end function value_shown

  pure function key_shown(self) result(text)
    !! The values of a key as written, for messages; long lists are cut.
    class(namelist_key_t), intent(in) :: self
    character(len=:), allocatable :: text
    integer, parameter :: longest = 50
    integer :: k

    text = ''
    do k = 1, self%n_value
      if (k > 1) then
        text = text//','
        if (.not. self%value(k)%is_glued) text = text//' '
      end if
      text = text//self%value(k)%shown()
      if (len(text) > longest) then
        text = text(:longest)//' ...'
        exit
      end if
    end do
  end function key_shown

  pure subroutine value_to_real(self, x, reason)
    !! The value as a real; the reason is '' if it is one, and x is left alone if it is none.
    class(namelist_value_t), intent(in) :: self
    real(wp), intent(inout) :: x   !! [any unit]
    character(len=:), allocatable, intent(out) :: reason

    if (self%is_quoted) then
      reason = 'must be a number, without quotes'
    else
      call text_as_real(self%text, x, reason)
    end if
  end subroutine value_to_real

  pure subroutine value_to_integer(self, n, reason)
    !! The value as an integer; the reason is '' if it is one.
    class(namelist_value_t), intent(in) :: self
    integer, intent(inout) :: n
    character(len=:), allocatable, intent(out) :: reason

    reason = 'must be an integer'
    if (.not. self%is_quoted) call text_as_integer(self%text, n, reason)
  end subroutine value_to_integer

  pure subroutine value_to_logical(self, flag, reason)
    !! The value as a logical; the reason is '' if it is one.
    class(namelist_value_t), intent(in) :: self
    logical, intent(inout) :: flag
    character(len=:), allocatable, intent(out) :: reason

    reason = 'must be .true. or .false.'
    if (self%is_quoted .or. .not. is_logical(self%text)) return
    reason = ''
    flag = index(lower_case(self%text), 't') > 0
  end subroutine value_to_logical

  pure subroutine value_to_name(self, text, reason)
    !! The value as text; the reason is '' if it was quoted.
    class(namelist_value_t), intent(in) :: self
    character(len=:), allocatable, intent(out) :: text
    character(len=:), allocatable, intent(out) :: reason

    text = self%text
    reason = ''
    if (.not. self%is_quoted) reason = "must be text in quotes: '"//text//"'"
  end subroutine value_to_name

  pure subroutine value_to_long(self, n, reason)
    !! The value as an integer of 64 bits; the reason is '' if it is one.
    class(namelist_value_t), intent(in) :: self
    integer(i8), intent(inout) :: n
    character(len=:), allocatable, intent(out) :: reason
    integer(i8) :: long
    integer :: first, status

    reason = 'must be an integer'
    if (self%is_quoted) return
    first = 1
    if (scan(self%text, '+-') == 1) first = 2
    if (first > len(self%text) .or. verify(self%text(first:), '0123456789') /= 0) return
    reason = 'is too large'
    if (len(self%text) - first + 1 > 18) return
    read (self%text, *, iostat=status) long
    if (status /= 0) return
    reason = ''
    n = long
  end subroutine value_to_long

  pure logical function is_logical(word)
    !! Is a word one of T, F, true, false, .true., .false., .t., .f. in any case?
    character(len=*), intent(in) :: word

    select case (lower_case(word))
    case ('t', 'f', 'true', 'false', '.true.', '.false.', '.t.', '.f.')
      is_logical = .true.
    case default
      is_logical = .false.
    end select
  end function is_logical

  pure function decimal_comma(key, must_be_certain) result(number)
    !! The number that was probably meant by a decimal comma, '' if there is none: `0,5` gives
    !! '0.5'. Certain is only `0,05`, because nobody writes the integer 05.
    type(namelist_key_t), intent(in) :: key
    logical, intent(in) :: must_be_certain
    character(len=:), allocatable :: number
    integer :: k, n

    number = ''
    do k = 2, key%n_value
      if (.not. (key%value(k)%is_glued .and. key%value(k - 1)%is_given)) cycle
      if (key%value(k - 1)%is_glued) then   ! 1,2,3 is a list
        number = ''
        return
      end if
      associate (before => key%value(k - 1)%text, after => key%value(k)%text)
        n = verify(lower_case(after)//'!', '0123456789') - 1
        if (verify(before, '+-0123456789') /= 0 .or. n < 1) cycle
        if (n < len(after)) then
          if (scan(after(n + 1:n + 1), 'eEdD') == 0) cycle
        end if
        if (must_be_certain .and. .not. (after(1:1) == '0' .and. n > 1)) cycle
        number = before//'.'//after
      end associate
    end do
  end function decimal_comma

  ! ---------------------------------------------------------------- the scan

  subroutine namelist_scan(self, text, file, problems, until)
    !! Takes a text apart into groups, keys and values.
    class(namelist_t), intent(out) :: self
    character(len=*), intent(in) :: text
    character(len=*), intent(in) :: file        !! for messages
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in), optional :: until   !! a group after which no more is read
    type(scanner_t) :: scanner
    logical :: is_reported

    self%file = file
    allocate (self%group(16))
    scanner%text = text
    scanner%place = text_start(text)
    is_reported = .false.
    do
      call scanner%skip_blanks()
      if (scanner%is_end()) exit
      if (begins_group(scanner)) then
        if (scanner%next() == '$') call complain_of_dollar(file, scanner, problems)
        call scan_group(self, scanner, problems)
        is_reported = .false.
        if (present(until)) then
          if (self%count(until) > 0) exit
        end if
      else
        if (.not. is_reported) call problems%add(file, scanner%line, '', '', '', &
                                        "text outside of groups: '"//trim(rest_of_line(scanner))// &
                                                 "' (a '/' outside of quotes ends a group)")
        is_reported = .true.
        do while (.not. scanner%is_end())
          if (scanner%next() == newline .or. scanner%next() == '&') exit
          call scanner%advance()
        end do
      end if
    end do
  end subroutine namelist_scan

  subroutine scan_group(self, scanner, problems)
    !! One group, from '&' to '/'.
    type(namelist_t), intent(inout) :: self
    type(scanner_t), intent(inout) :: scanner
    type(problems_t), intent(inout) :: problems
    type(namelist_group_t) :: group
    character(len=1) :: c

    group%line = scanner%line
    allocate (group%key(4))
    call scanner%advance()
    group%name = lower_case(scanner%word())
    if (len(group%name) == 0) call scanner%complain(self%file, problems, group, 0, &
                                                    'a group has no name')
    scanner%slot = 0
    scanner%drops_values = .false.
    call start_values(scanner, 1)
    do
      call scanner%skip_blanks()
      if (scanner%is_end()) then
        call problems%add(self%file, group%line, group%name, '', '', "group is not closed by '/'")
        exit
      end if
      c = scanner%next()
      if (c == '/') then
        call scanner%advance()
        exit
      else if (c == '&' .or. begins_dollar(scanner)) then
        if (c == '$') call complain_of_dollar(self%file, scanner, problems)
        if (is_legacy_end(scanner)) exit
        call problems%add(self%file, group%line, group%name, '', '', &
                          "group is not closed by '/' before line "//to_text(scanner%line))
        exit
      end if
      call scan_item(self%file, scanner, group, problems)
    end do
    call finish_values(self%file, scanner, group, problems)
    if (len(group%name) > 0) call append_group(self, group)
  end subroutine scan_group

  logical function is_legacy_end(scanner) result(is_end)
    !! Is this the old way to close a group, &end or $end? It is then passed over.
    type(scanner_t), intent(inout) :: scanner
    character(len=:), allocatable :: word

    is_end = .false.
    word = lower_case(scanner%text(scanner%place:min(len(scanner%text), scanner%place + 3)))
    if (word /= '&end' .and. word /= '$end') return
    call scanner%advance()
    word = scanner%word()
    is_end = .true.
  end function is_legacy_end

  pure logical function begins_group(scanner) result(begins)
    !! Is this '&', or '$' as some compilers take it?
    type(scanner_t), intent(in) :: scanner

    begins = scanner%next() == '&' .or. begins_dollar(scanner)
  end function begins_group

  pure logical function begins_dollar(scanner) result(begins)
    !! Is this '$' with a name after it?
    type(scanner_t), intent(in) :: scanner
    integer :: next

    next = min(scanner%place + 1, len(scanner%text))
    begins = scanner%next() == '$' .and. &
             verify(lower_case(scanner%text(next:next)), 'abcdefghijklmnopqrstuvwxyz') == 0
  end function begins_dollar

  subroutine complain_of_dollar(file, scanner, problems)
    !! Once a file: the groups are then read all the same, so that other problems are found.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(problems_t), intent(inout) :: problems

    if (.not. scanner%had_dollar) then
      call problems%add(file, scanner%line, '', '', '', &
                        "groups begin with '&' and end with '/', not '"// &
                        trim(rest_of_line(scanner))//"'")
    end if
    scanner%had_dollar = .true.
  end subroutine complain_of_dollar

  subroutine scan_item(file, scanner, group, problems)
    !! One comma, text, word or key within a group.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(inout) :: group
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable :: word
    character(len=1) :: c
    logical :: is_first
    integer :: start, line

    c = scanner%next()
    is_first = scanner%is_first
    line = scanner%line
    start = scanner%place
    if (c == ',') then
      if (scanner%expects_value) then
        call scanner%complain(file, problems, group, line, 'no value before a comma')
        scanner%element = scanner%element + 1
      end if
      scanner%expects_value = .true.
      scanner%comma = scanner%place
      call scanner%advance()
    else if (c == "'" .or. c == '"') then
      call scan_quoted(file, scanner, group, problems, word)
      call put_value(file, scanner, group, problems, word, .true., start, line)
    else if (c == '=') then
      call scanner%complain(file, problems, group, line, "'=' without a key before it")
      call scanner%advance()
    else
      word = scanner%word()
      if (begins_key(scanner, word)) then
        call scan_key(file, scanner, group, problems, word, line)
      else if (is_first .and. is_identifier(word)) then
        call problems%add(file, line, group%name, word, '', "'=' is missing after "//word// &
                          ', or quotes around it')
        call finish_values(file, scanner, group, problems)
        scanner%slot = 0
        scanner%drops_values = .true.
      else
        call scan_word(file, scanner, group, problems, word, start, line)
      end if
    end if
  end subroutine scan_item

  subroutine scan_word(file, scanner, group, problems, word, start, line)
    !! A bare value, perhaps with a repeat count: 3*0.0.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(inout) :: group
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in) :: word
    integer, intent(in) :: start, line
    integer :: star, status

    star = index(word, '*')
    if (star > 1 .and. star < 10) then
      if (verify(word(:star - 1), '0123456789') == 0) then
        read (word(:star - 1), *, iostat=status) scanner%repeats
        if (status /= 0) scanner%repeats = 0
        if (scanner%repeats < 1) then
          call scanner%complain(file, problems, group, line, 'repeat count of '//word// &
                                ' must be at least 1')
          scanner%repeats = 1
        end if
        if (star < len(word)) then
          call put_value(file, scanner, group, problems, word(star + 1:), .false., start, line)
        else if (scan(scanner%next(), "'"//'"') == 0) then
          call scanner%complain(file, problems, group, line, 'no value after '//word)
          scanner%repeats = 1
        end if
        return
      end if
    end if
    call put_value(file, scanner, group, problems, word, .false., start, line)
  end subroutine scan_word

  subroutine scan_quoted(file, scanner, group, problems, contents)
    !! A text in quotes on one line; a doubled quote stands for one.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(in) :: group
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable, intent(out) :: contents
    character(len=:), allocatable :: buffer
    character(len=1) :: quote
    integer :: n

    quote = scanner%next()
    call scanner%advance()
    buffer = repeat(' ', name_room)
    n = 0
    do
      if (scanner%is_end() .or. scanner%next() == newline) then
        contents = buffer(:n)
        call scanner%complain(file, problems, group, scanner%line, &
                              'text is not closed by '//quote//' on its line: '//quote// &
                              trim(contents))
        return
      end if
      if (scanner%next() == quote) then
        call scanner%advance()
        if (scanner%next() /= quote) then
          contents = buffer(:n)
          return
        end if
      end if
      if (n == len(buffer)) buffer = buffer//repeat(' ', n)
      n = n + 1
      buffer(n:n) = scanner%next()
      call scanner%advance()
    end do
  end subroutine scan_quoted

  subroutine scan_key(file, scanner, group, problems, word, line)
    !! `name =` or `name(2) =`, after the name; opens the key for values.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(inout) :: group
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in) :: word
    integer, intent(in) :: line
    character(len=:), allocatable :: name, subscript
    integer :: bracket, element, slot

    call finish_values(file, scanner, group, problems)
    do while (scanner%next() /= '=')
      call scanner%advance()
    end do
    call scanner%advance()
    bracket = index(word, '(')
    name = lower_case(word)
    element = 0
    if (bracket > 0) then
      name = lower_case(trim(word(:bracket - 1)))
      subscript = trim(adjustl(word(bracket + 1:len(word) - 1)))
      if (len(subscript) > 0 .and. len(subscript) < 8 .and. &
          verify(subscript, '0123456789') == 0) read (subscript, *) element
    end if
    slot = group%find(name)
    scanner%drops_values = .true.
    scanner%slot = 0
    if (bracket > 0 .and. element < 1) then
      call problems%add(file, line, group%name, name, '', 'index ('//subscript// &
                        ') must be one positive integer: '//name//'(1) = ...')
    else if (slot > 0 .and. bracket == 0) then
      call problems%add(file, line, group%name, name, '', &
                        'given twice (first in line '//to_text(group%key(slot)%line)//')')
    else
      if (slot == 0) call append_key(group, name, line, slot)
      group%key(slot)%is_indexed = bracket > 0
      scanner%slot = slot
      scanner%drops_values = .false.
    end if
    call start_values(scanner, max(element, 1))
  end subroutine scan_key

  subroutine start_values(scanner, element)
    !! Values may follow now.
    type(scanner_t), intent(inout) :: scanner
    integer, intent(in) :: element

    scanner%element = element
    scanner%expects_value = scanner%slot > 0
    scanner%comma = 0
    scanner%last_end = 0
    scanner%repeats = 1
  end subroutine start_values

  subroutine finish_values(file, scanner, group, problems)
    !! No more values for the present key: were there any?
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(inout) :: group
    type(problems_t), intent(inout) :: problems

    if (scanner%slot == 0) return
    associate (key => group%key(scanner%slot))
      if (scanner%last_end == 0 .and. scanner%comma == 0) then
        call problems%add(file, key%line, group%name, key%name, '', 'no value given')
      end if
    end associate
    scanner%slot = 0
  end subroutine finish_values

  subroutine put_value(file, scanner, group, problems, word, is_quoted, start, line)
    !! Stores a value, as often as its repeat count says.
    character(len=*), intent(in) :: file
    type(scanner_t), intent(inout) :: scanner
    type(namelist_group_t), intent(inout) :: group
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in) :: word
    logical, intent(in) :: is_quoted
    integer, intent(in) :: start, line
    logical :: is_glued
    integer :: k, n

    is_glued = scanner%comma > 0 .and. scanner%comma == start - 1 .and. &
               scanner%last_end == scanner%comma - 1
    n = scanner%repeats
    if (scanner%slot == 0) then
      if (.not. scanner%drops_values) call problems%add(file, line, group%name, '', '', &
                                                        'value '//word//' without a key before it')
    else if (scanner%element + n - 1 > most_values) then
      call scanner%complain(file, problems, group, line, 'more than '//to_text(most_values)// &
                            ' values')
    else
      associate (key => group%key(scanner%slot))
        call reserve_values(key, scanner%element + n - 1)
        do k = scanner%element, scanner%element + n - 1
          if (key%value(k)%is_given) call problems%add(file, line, group%name, &
                             key%name//'('//to_text(k)//')', word, 'given twice (first in line '// &
                                                       to_text(key%value(k)%line)//')')
          key%value(k)%text = word
          key%value(k)%is_quoted = is_quoted
          key%value(k)%is_given = .true.
          key%value(k)%is_glued = is_glued .and. k == scanner%element
          key%value(k)%line = line
        end do
      end associate
      scanner%element = scanner%element + n
    end if
    scanner%repeats = 1
    scanner%expects_value = .false.
    scanner%comma = 0
    scanner%last_end = scanner%place - 1
  end subroutine put_value

  ! ---------------------------------------------------------------- growing lists

  subroutine reserve_values(key, n)
    !! Makes room for n values.
    type(namelist_key_t), intent(inout) :: key
    integer, intent(in) :: n
    type(namelist_value_t), allocatable :: more(:)
    integer :: k

    if (n > size(key%value)) then
      allocate (more(max(n, 2*size(key%value))))
      do k = 1, key%n_value
        more(k)%is_quoted = key%value(k)%is_quoted
        more(k)%is_given = key%value(k)%is_given
        more(k)%is_glued = key%value(k)%is_glued
        more(k)%line = key%value(k)%line
        call move_alloc(key%value(k)%text, more(k)%text)
      end do
      call move_alloc(more, key%value)
    end if
    key%n_value = max(key%n_value, n)
  end subroutine reserve_values

  subroutine append_key(group, name, line, slot)
    !! Adds a key without values.
    type(namelist_group_t), intent(inout) :: group
    character(len=*), intent(in) :: name
    integer, intent(in) :: line
    integer, intent(out) :: slot
    type(namelist_key_t), allocatable :: more(:)
    integer :: k

    if (group%n_key == size(group%key)) then
      allocate (more(2*group%n_key))
      do k = 1, group%n_key
        call move_key(group%key(k), more(k))
      end do
      call move_alloc(more, group%key)
    end if
    group%n_key = group%n_key + 1
    slot = group%n_key
    if (group%n_key == few_keys + 1) then
      do k = 1, few_keys
        call group%names%add(group%key(k)%name, k)
      end do
    end if
    if (group%n_key > few_keys) call group%names%add(name, slot)
    group%key(slot)%name = name
    group%key(slot)%line = line
    allocate (group%key(slot)%value(1))
  end subroutine append_key

  subroutine move_key(from, to)
    !! Moves a key without copying its values.
    type(namelist_key_t), intent(inout) :: from
    type(namelist_key_t), intent(out) :: to

    call move_alloc(from%name, to%name)
    call move_alloc(from%value, to%value)
    to%line = from%line
    to%is_indexed = from%is_indexed
    to%n_value = from%n_value
  end subroutine move_key

  subroutine append_group(self, group)
    !! Adds a complete group, which is used up.
    type(namelist_t), intent(inout) :: self
    type(namelist_group_t), intent(inout) :: group
    type(namelist_group_t), allocatable :: more(:)
    integer :: k

    if (self%n_group == size(self%group)) then
      allocate (more(2*self%n_group))
      do k = 1, self%n_group
        call move_group(self%group(k), more(k))
      end do
      call move_alloc(more, self%group)
    end if
    self%n_group = self%n_group + 1
    call self%names%add(group%name, self%n_group)
    call move_group(group, self%group(self%n_group))
  end subroutine append_group

  subroutine move_group(from, to)
    !! Moves a group without copying its keys.
    type(namelist_group_t), intent(inout) :: from
    type(namelist_group_t), intent(out) :: to

    call move_alloc(from%name, to%name)
    call move_alloc(from%key, to%key)
    to%line = from%line
    to%n_key = from%n_key
    if (from%n_key > few_keys) to%names = from%names
  end subroutine move_group

  ! ---------------------------------------------------------------- characters

  pure logical function scanner_is_end(self) result(is_end)
    !! Is the text used up?
    class(scanner_t), intent(in) :: self

    is_end = self%place > len(self%text)
  end function scanner_is_end

  pure character(len=1) function scanner_next(self) result(c)
    !! The next character, a new line after the end of the text.
    class(scanner_t), intent(in) :: self

    c = newline
    if (self%place <= len(self%text)) c = self%text(self%place:self%place)
  end function scanner_next

  subroutine scanner_advance(self)
    !! Passes one character.
    class(scanner_t), intent(inout) :: self
    character(len=1) :: c

    c = self%next()
    if (c == newline) then
      self%line = self%line + 1
      self%is_first = .true.
    else if (c /= ' ' .and. c /= tab .and. c /= return) then
      self%is_first = .false.
    end if
    self%place = self%place + 1
  end subroutine scanner_advance

  subroutine scanner_skip_blanks(self)
    !! Passes blanks, new lines and comments.
    class(scanner_t), intent(inout) :: self
    character(len=1) :: c

    do while (.not. self%is_end())
      c = self%next()
      if (c == '!') then
        do while (self%next() /= newline)
          call self%advance()
        end do
      else if (c == ' ' .or. c == tab .or. c == return .or. c == newline) then
        call self%advance()
      else
        exit
      end if
    end do
  end subroutine scanner_skip_blanks

  function scanner_word(self) result(word)
    !! The characters up to the next delimiter; a bracketed index belongs to the word, blanks
    !! within and before it too.
    class(scanner_t), intent(inout) :: self
    character(len=:), allocatable :: word
    integer :: start, last, bracket

    start = self%place
    last = place_of(self%text, start, delimiters//'(') - 1
    bracket = last + 1
    do while (bracket < len(self%text))
      if (verify(self%text(bracket:bracket), ' '//tab) /= 0) exit
      bracket = bracket + 1
    end do
    if (bracket <= len(self%text)) then
      if (self%text(bracket:bracket) == '(') then
        last = min(place_of(self%text, bracket, ')'//newline), len(self%text))
        if (self%text(last:last) == newline) last = last - 1
      end if
    end if
    word = self%text(start:last)
    do while (self%place <= last)
      call self%advance()
    end do
  end function scanner_word

  subroutine scanner_complain(self, file, problems, group, line, reason)
    !! Adds a problem of the present key.
    class(scanner_t), intent(in) :: self
    character(len=*), intent(in) :: file
    type(problems_t), intent(inout) :: problems
    type(namelist_group_t), intent(in) :: group
    integer, intent(in) :: line
    character(len=*), intent(in) :: reason
    character(len=:), allocatable :: key

    key = ''
    if (self%slot > 0) key = group%key(self%slot)%name
    call problems%add(file, merge(line, group%line, line > 0), group%name, key, '', reason)
  end subroutine scanner_complain

  pure logical function begins_key(scanner, word)
    !! Is the word just read followed by '='?
    type(scanner_t), intent(in) :: scanner
    character(len=*), intent(in) :: word
    integer :: k

    begins_key = .false.
    if (len(word) == 0) return
    k = scanner%place
    do while (k < len(scanner%text))
      if (verify(scanner%text(k:k), ' '//tab) /= 0) exit
      k = k + 1
    end do
    if (k <= len(scanner%text)) begins_key = scanner%text(k:k) == '='
  end function begins_key

  pure logical function is_identifier(word)
    !! Does a word look like a key, and not like a logical or a number?
    character(len=*), intent(in) :: word

    is_identifier = .false.
    if (len(word) == 0 .or. is_logical(word) .or. is_special(word)) return
    is_identifier = verify(lower_case(word(1:1)), 'abcdefghijklmnopqrstuvwxyz_') == 0
  end function is_identifier

  pure integer function place_of(text, start, set) result(place)
    !! Place of the first character of a set, counted from the beginning of the text; just after
    !! the text if there is none. Pieces of words and lines are searched: they are met before the
    !! rest of a long text.
    character(len=*), intent(in) :: text, set
    integer, intent(in) :: start
    integer, parameter :: piece = 64
    integer :: first, found

    do first = start, len(text), piece
      found = scan(text(first:min(first + piece - 1, len(text))), set)
      place = first + found - 1
      if (found > 0) return
    end do
    place = len(text) + 1
  end function place_of

  pure function rest_of_line(scanner) result(text)
    !! What follows on the present line, for messages.
    type(scanner_t), intent(in) :: scanner
    character(len=:), allocatable :: text
    integer, parameter :: longest = 40
    integer :: n

    n = place_of(scanner%text, scanner%place, newline//return) - scanner%place
    text = scanner%text(scanner%place:scanner%place + min(n, longest) - 1)
  end function rest_of_line
end module dosui_namelist

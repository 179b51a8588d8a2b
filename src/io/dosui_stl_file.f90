!! Triangles from STL files, text or binary.
module dosui_stl_file
  use, intrinsic :: iso_fortran_env, only: int32, real32
  use dosui_fields, only: field_name, find_fields, line_limit, most_fields, next_line, shown_word, &
                          text_start
  use dosui_kinds, only: wp, i8
  use dosui_numbers, only: text_as_real
  use dosui_scene, only: name_length
  use dosui_text, only: lower_case, to_text
  implicit none
  private

  public :: parse_stl

  integer, parameter :: header_length = 84     !! of binary files: a title and the count [byte]
  integer, parameter :: record_length = 50     !! of a triangle in binary files [byte]
  real(wp), parameter :: largest = 1.0e15_wp   !! coordinate [m]
  character(len=1), parameter :: axis_name(3) = ['x', 'y', 'z']
  character(len=*), parameter :: blank = ' '//achar(9)//achar(13)

contains

  subroutine parse_stl(text, corners, solid, line, names, message)
    !! All triangles of a file. Their normals are not read: they follow from the corners.
    character(len=*), intent(in) :: text                       !! bytes of the file
    real(wp), allocatable, intent(out) :: corners(:, :, :)     !! (3, 3, n) [file's unit]
    integer, allocatable, intent(out) :: solid(:)              !! (n) which solid of the file
    integer, allocatable, intent(out) :: line(:)               !! (n) where it begins; 0: binary
    character(len=name_length), allocatable, intent(out) :: names(:)   !! of the solids
    character(len=:), allocatable, intent(out) :: message      !! '' if all is well
    integer(i8) :: n

    message = ''
    n = -1_i8
    if (len(text) >= header_length) n = unsigned(text(header_length - 3:header_length))
    if (n >= 0_i8 .and. header_length + record_length*n == len(text)) then
      call parse_binary(text, int(n), corners, solid, line, names, message)
    else if (starts_as_text(text)) then
      call parse_text(text, corners, solid, line, names, message)
    else if (len(text) < header_length .or. index(text, achar(0)) == 0) then
      message = "is no STL file: it does not begin with 'solid', nor is it binary"
    else
      message = 'is a binary STL file of '//to_text(n)//' triangles, which takes '// &
                to_text(header_length + record_length*n)//' bytes; it has '//to_text(len(text))
      if (len(text) < header_length + record_length*n) then
        message = message//' and breaks off in triangle '// &
                  to_text((len(text) - header_length)/record_length + 1)
      end if
    end if
    if (.not. allocated(corners)) allocate (corners(3, 3, 0), solid(0), line(0))
    if (.not. allocated(names)) allocate (names(0))
  end subroutine parse_stl

  pure logical function starts_as_text(text)
    !! Does the file begin with 'solid', and is it text?
    character(len=*), intent(in) :: text
    integer :: first, k

    starts_as_text = .false.
    first = text_start(text)
    if (first > len(text)) return
    k = verify(text(first:), blank//new_line('a'))
    first = first + k - 1
    if (k == 0 .or. first + 4 > len(text)) return
    starts_as_text = lower_case(text(first:first + 4)) == 'solid' .and. index(text, achar(0)) == 0
  end function starts_as_text

  subroutine parse_binary(text, n, corners, solid, line, names, message)
    !! Records of a normal, three corners (single precision, lowest byte first) and two bytes.
    character(len=*), intent(in) :: text
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: corners(:, :, :)
    integer, allocatable, intent(out) :: solid(:), line(:)
    character(len=name_length), allocatable, intent(out) :: names(:)
    character(len=:), allocatable, intent(inout) :: message
    integer :: t, k, d, first
    logical :: is_good

    allocate (corners(3, 3, n), solid(n), line(n), names(1))
    solid = 1
    line = 0
    names = ''
    do t = 1, n
      do k = 1, 3
        do d = 1, 3
          first = header_length + record_length*(t - 1) + 12*k + 4*d - 3
          call single(text(first:first + 3), corners(d, k, t), is_good)
          if (is_good) cycle
          message = 'triangle '//to_text(t)//' (byte '//to_text(first)//'): a coordinate is no '// &
                    'number'
          return
        end do
      end do
    end do
  end subroutine parse_binary

  pure integer(i8) function unsigned(bytes)
    !! A number of four bytes, the lowest first.
    character(len=4), intent(in) :: bytes
    integer :: k

    unsigned = 0_i8
    do k = 4, 1, -1
      unsigned = 256_i8*unsigned + iachar(bytes(k:k))
    end do
  end function unsigned

  pure subroutine single(bytes, value, is_good)
    !! A single-precision number; those that are none are found before they can trap.
    character(len=4), intent(in) :: bytes
    real(wp), intent(out) :: value
    logical, intent(out) :: is_good
    integer(i8) :: number
    integer(int32) :: pattern
    integer(int32), parameter :: exponent_bits = int(z'7F800000', int32)

    number = unsigned(bytes)
    if (number >= 2_i8**31) number = number - 2_i8**32
    pattern = int(number, int32)
    is_good = iand(pattern, exponent_bits) /= exponent_bits
    value = 0.0_wp
    if (is_good) value = real(transfer(pattern, 1.0_real32), wp)
    is_good = is_good .and. abs(value) <= largest
  end subroutine single

  subroutine parse_text(text, corners, solid, line, names, message)
    !! Lines `solid name`, `facet normal ...`, `outer loop`, three of `vertex x y z`, `endloop`,
    !! `endfacet`, `endsolid`.
    character(len=*), intent(in) :: text
    real(wp), allocatable, intent(out) :: corners(:, :, :)
    integer, allocatable, intent(out) :: solid(:), line(:)
    character(len=name_length), allocatable, intent(out) :: names(:)
    character(len=:), allocatable, intent(inout) :: message
    character(len=name_length), allocatable :: more(:)
    character(len=:), allocatable :: word, rest
    integer :: number, next, first, last, n, most, n_corner
    logical :: in_solid

    most = occurrences(lower_case(text), 'endfacet') + 1
    allocate (corners(3, 3, most), solid(most), line(most), names(0))
    n = 0
    n_corner = -1   ! outside a facet
    in_solid = .false.
    number = 0
    next = text_start(text)
    do while (next <= len(text))
      call next_line(text, next, number, first, last)
      call first_word(text(first:last), word, rest)
      select case (word)
      case ('solid')
        if (in_solid) message = "'solid' within a solid"
        in_solid = .true.
        allocate (more(size(names) + 1))
        more(:size(names)) = names
        more(size(more)) = rest
        call move_alloc(more, names)
      case ('endsolid')
        if (n_corner >= 0) message = 'the solid ends within a triangle'
        if (.not. in_solid) message = "'endsolid' outside a solid"
        in_solid = .false.
      case ('facet')
        if (.not. in_solid) message = "'facet' outside a solid"
        if (n_corner >= 0) message = "'facet' within a facet"
        if (n == most) message = "'facet' without 'endfacet'"
        if (len(message) > 0) exit
        n = n + 1
        n_corner = 0
        solid(n) = size(names)
        line(n) = number
      case ('vertex')
        if (n_corner < 0) message = "'vertex' outside a facet"
        if (n_corner == 3) message = 'a fourth corner of a triangle'
        if (len(message) > 0) exit
        n_corner = n_corner + 1
        call read_corner(text(first:last), number, corners(:, n_corner, n), message)
        if (len(message) > 0) return
      case ('endfacet')
        if (n_corner /= 3) message = "'endfacet' after "//to_text(max(n_corner, 0))// &
                                     ' corners instead of 3'
        n_corner = -1
      case ('outer', 'endloop', '')
        continue
      case default
        message = 'unknown word '//shown_word(word)
      end select
      if (len(message) > 0) exit
    end do
    if (len(message) > 0) then
      message = 'line '//to_text(number)//': '//message
    else if (in_solid .or. n_corner >= 0) then
      message = 'line '//to_text(number)//": the file breaks off before 'endsolid'"
    else if (n == 0) then
      message = 'holds no triangles'
    end if
    corners = corners(:, :, :n)
    solid = solid(:n)
    line = line(:n)
  end subroutine parse_text

  pure subroutine read_corner(line, number, corner, message)
    !! The coordinates of a line `vertex x y z`.
    character(len=*), intent(in) :: line
    integer, intent(in) :: number           !! of the line
    real(wp), intent(inout) :: corner(3)    !! [file's unit]
    character(len=:), allocatable, intent(inout) :: message
    character(len=:), allocatable :: reason
    integer :: start(most_fields), finish(most_fields), n, d

    call find_fields(line, '', start, finish, n)
    if (n /= 4) message = 'line '//to_text(number)//': a corner has three coordinates, not '// &
                          to_text(n - 1)
    do d = 1, 3
      if (len(message) > 0) return
      associate (word => line(start(d + 1):finish(d + 1)))
        call text_as_real(word, corner(d), reason)
        if (len(reason) == 0 .and. .not. abs(corner(d)) <= largest) then
          reason = 'must be between -1e15 and 1e15'
        end if
        if (len(reason) > 0) message = field_name(number, d + 1, axis_name(d), word)//': '//reason
      end associate
    end do
  end subroutine read_corner

  pure integer function occurrences(text, word) result(n)
    !! How often a word occurs.
    character(len=*), intent(in) :: text, word
    integer :: first, next

    n = 0
    first = 1
    do
      next = index(text(first:), word)
      if (next == 0) exit
      n = n + 1
      first = first + next + len(word) - 1
    end do
  end function occurrences

  pure subroutine first_word(line, word, rest)
    !! The first word of a line, in lower case, and what follows it.
    character(len=*), intent(in) :: line
    character(len=:), allocatable, intent(out) :: word, rest
    integer :: first, last

    word = ''
    rest = ''
    first = verify(line, blank)
    if (first == 0) return
    last = scan(line(first:), blank)
    last = merge(len(line), first + last - 2, last == 0)
    word = lower_case(line(first:last))
    first = verify(line(last + 1:), blank)
    if (first == 0) return
    rest = line(last + first:verify(line, blank, back=.true.))
  end subroutine first_word
end module dosui_stl_file

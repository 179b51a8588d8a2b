!! A scene as namelist text: every key with the value in force. Reading it gives the same scene.
module dosui_scene_echo
  use dosui_kinds, only: wp, i8
  use dosui_key_visitor, only: key_t, key_visitor_t, name_length, real_text
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: scene_t
  use dosui_scene_keys, only: group_t, scene_groups, group_size, visit_group
  use dosui_text, only: to_text
  implicit none
  private

  public :: write_echo, group_entries, is_in_force

  character(len=1), parameter :: newline = new_line('a')
  integer, parameter :: line_width = 96   !! of lists that go over several lines

  type, public :: entry_t
    !! One key of a group instance as text.
    type(key_t) :: key
    character(len=:), allocatable :: value       !! '' for none
    character(len=:), allocatable :: note        !! what holds if there is no value
    character(len=:), allocatable :: statement   !! `key = value`, or a comment in place of it
  end type entry_t

  type :: buffer_t
    !! A text that grows without being copied each time.
    character(len=:), allocatable :: text   !! the first n characters count
    integer :: n = 0
  contains
    procedure :: add => buffer_add
  end type buffer_t

  type, extends(key_visitor_t) :: writer_t
    !! Collects the entries of a group instance, or only writes their statements.
    type(entry_t), allocatable :: item(:)
    integer :: n = 0
    logical :: is_echo = .false.   ! no items, but lines of text
    type(buffer_t) :: echo
  contains
    procedure :: real => write_real
    procedure :: property => write_property
    procedure :: integer => write_integer
    procedure :: long => write_long
    procedure :: logical => write_logical
    procedure :: name => write_name
    procedure :: text => write_text
    procedure :: vector => write_vector
    procedure :: list => write_list
    procedure :: points => write_points
  end type writer_t

contains

  subroutine write_echo(scene, text)
    !! The whole scene as namelist text. Keys that mean nothing in this scene are left out.
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable, intent(out) :: text
    type(group_t), allocatable :: groups(:)
    type(writer_t) :: writer
    type(scene_t) :: copy   ! visitors may change what they see; this one does not
    integer :: g, instance

    copy = scene
    writer%is_echo = .true.
    call writer%echo%add('! the scene with every value in force'//newline)
    groups = scene_groups()
    do g = 1, size(groups)
      if (.not. is_in_force(scene, groups(g)%name)) cycle
      do instance = 1, group_size(scene, groups(g)%name)
        call writer%echo%add(newline//'&'//groups(g)%name//newline)
        call visit_group(writer, copy, groups(g)%name, instance)
        call writer%echo%add('/'//newline)
      end do
    end do
    text = writer%echo%text(:writer%echo%n)
  end subroutine write_echo

  pure subroutine buffer_add(self, text)
    !! Appends a text.
    class(buffer_t), intent(inout) :: self
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: more

    if (.not. allocated(self%text)) allocate (character(len=4096) :: self%text)
    if (self%n + len(text) > len(self%text)) then
      allocate (character(len=2*(self%n + len(text))) :: more)
      more(:self%n) = self%text(:self%n)
      call move_alloc(more, self%text)
    end if
    self%text(self%n + 1:self%n + len(text)) = text
    self%n = self%n + len(text)
  end subroutine buffer_add

  pure logical function is_in_force(scene, group)
    !! Does a group mean anything in this scene?
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group

    is_in_force = .true.
    if (group == 'water') is_in_force = scene%water_mode /= 'none'
    if (group == 'verification') is_in_force = scene%verification%case /= ''
  end function is_in_force

  subroutine group_entries(scene, group, instance, entries)
    !! All keys of one instance of a group as text.
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    type(entry_t), allocatable, intent(out) :: entries(:)
    type(writer_t) :: writer
    type(scene_t) :: copy
    integer :: k

    copy = scene
    allocate (writer%item(64))
    call visit_group(writer, copy, group, instance)
    allocate (entries(writer%n))
    do k = 1, writer%n
      entries(k) = writer%item(k)
    end do
  end subroutine group_entries

  pure logical function is_left_out(self, key)
    !! Has a key no place in an echo? Asked before a number is written: that takes long.
    class(writer_t), intent(in) :: self
    type(key_t), intent(in) :: key

    is_left_out = self%is_echo .and. .not. key%applies
  end function is_left_out

  subroutine append(self, key, value, note)
    !! Adds an entry; without a value, a comment says what holds instead.
    class(writer_t), intent(inout) :: self
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: value
    character(len=*), intent(in) :: note

    if (is_left_out(self, key)) return
    if (len(value) > 0) then
      call add_entry(self, key, value, note, key%name//' = '//value)
    else if (len_trim(key%fallback) > 0) then
      call add_entry(self, key, value, note, '! '//key%name//': '//trim(key%fallback))
    else
      call add_entry(self, key, value, note, '! '//key%name//': '//note)
    end if
  end subroutine append

  subroutine add_entry(self, key, value, note, statement)
    !! Adds an entry with its statement.
    class(writer_t), intent(inout) :: self
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: value, note, statement

    if (self%is_echo) then
      call self%echo%add('  '//statement//newline)
      return
    end if
    self%n = self%n + 1
    associate (item => self%item(self%n))
      item%key = key
      item%value = value
      item%note = note
      if (len_trim(key%fallback) > 0) item%note = trim(key%fallback)
      item%statement = statement
    end associate
  end subroutine add_entry

  subroutine write_real(self, value, key)
    class(writer_t), intent(inout) :: self
    real(wp), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (is_left_out(self, key)) return
    call append(self, key, real_text(value), 'unlimited')
  end subroutine write_real

  subroutine write_property(self, value, key)
    class(writer_t), intent(inout) :: self
    type(scalar_function_t), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (is_left_out(self, key)) return
    if (value%varies()) then
      call append(self, key, quoted(value%formula), '')
    else
      call append(self, key, real_text(value%constant), 'unlimited')
    end if
  end subroutine write_property

  subroutine write_integer(self, value, key)
    class(writer_t), intent(inout) :: self
    integer, intent(inout) :: value
    type(key_t), intent(in) :: key

    if (value == huge(value)) then
      call append(self, key, '', 'unlimited')
    else
      call append(self, key, to_text(value), '')
    end if
  end subroutine write_integer

  subroutine write_long(self, value, key)
    class(writer_t), intent(inout) :: self
    integer(i8), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (value == huge(value)) then
      call append(self, key, '', 'unlimited')
    else
      call append(self, key, to_text(value), '')
    end if
  end subroutine write_long

  subroutine write_logical(self, value, key)
    class(writer_t), intent(inout) :: self
    logical, intent(inout) :: value
    type(key_t), intent(in) :: key

    call append(self, key, '.'//to_text(value)//'.', '')
  end subroutine write_logical

  subroutine write_name(self, value, key)
    class(writer_t), intent(inout) :: self
    character(len=name_length), intent(inout) :: value
    type(key_t), intent(in) :: key

    if (len_trim(value) == 0) then
      call append(self, key, '', 'none')
    else
      call append(self, key, quoted(trim(value)), '')
    end if
  end subroutine write_name

  subroutine write_text(self, value, key)
    class(writer_t), intent(inout) :: self
    character(len=:), allocatable, intent(inout) :: value
    type(key_t), intent(in) :: key

    if (allocated(value)) then
      call append(self, key, quoted(value), '')
    else
      call append(self, key, '', 'none')
    end if
  end subroutine write_text

  subroutine write_vector(self, value, key)
    class(writer_t), intent(inout) :: self
    real(wp), intent(inout) :: value(:)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: statement
    logical :: is_limited(size(value))
    integer :: k

    if (is_left_out(self, key)) return
    is_limited = abs(value) < huge(value)
    if (all(is_limited)) then
      call append(self, key, joined(value), '')
    else if (.not. any(is_limited)) then
      call append(self, key, '', 'unlimited')
    else
      statement = ''
      do k = 1, size(value)
        if (is_limited(k)) statement = statement//key%name//'('//to_text(k)//') = '// &
                                       real_text(value(k))//' '
      end do
      statement = trim(statement)
      call add_entry(self, key, statement, 'unlimited', statement)
    end if
  end subroutine write_vector

  subroutine write_list(self, value, key)
    class(writer_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:)
    type(key_t), intent(in) :: key

    if (.not. allocated(value)) then
      call append(self, key, '', 'none')
    else
      call append(self, key, joined(value), 'none')
    end if
  end subroutine write_list

  subroutine write_points(self, value, key)
    class(writer_t), intent(inout) :: self
    real(wp), allocatable, intent(inout) :: value(:, :)
    type(key_t), intent(in) :: key

    if (.not. allocated(value)) then
      call append(self, key, '', 'none')
    else
      call append(self, key, joined(reshape(value, [size(value)])), 'none')
    end if
  end subroutine write_points

  pure function joined(values) result(text)
    !! Numbers with commas between them, over several lines if there are many.
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: text
    character(len=:), allocatable :: number
    type(buffer_t) :: buffer
    integer :: k, first

    if (size(values) == 1) then
      text = to_text(values(1))
      return
    end if
    call buffer%add('')
    first = 0   ! what stands before the present line
    do k = 1, size(values)
      number = to_text(values(k))
      if (k < size(values)) number = number//','
      if (buffer%n - first + len(number) + 24 > line_width) then
        call buffer%add(newline//'   ')
        first = buffer%n
      end if
      if (k > 1) call buffer%add(' ')
      call buffer%add(number)
    end do
    text = buffer%text(:buffer%n)
  end function joined

  pure function quoted(text)
    !! A text in quotes, with quotes within it doubled.
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: quoted
    character(len=2*len(text) + 2) :: buffer
    integer :: k, n

    buffer(1:1) = "'"
    n = 1
    do k = 1, len(text)
      n = n + 1
      buffer(n:n) = text(k:k)
      if (text(k:k) /= "'") cycle
      n = n + 1
      buffer(n:n) = "'"
    end do
    quoted = buffer(:n)//"'"
  end function quoted
end module dosui_scene_echo

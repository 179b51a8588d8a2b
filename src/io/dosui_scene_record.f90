!! What a checkpoint knows of its scene: every key in force with its value, one a line, and the
!! comparison with the scene of a restart.
!!
!! Both follow from the table of keys, which also says what a restart may change of each. Files that
!! a scene refers to count with what they hold, not with their path.
module dosui_scene_record
  use dosui_kinds, only: wp, i8
  use dosui_checksum, only: checksum_t
  use dosui_dimension, only: ndim
  use dosui_key_visitor, only: key_t, restart_content, restart_free, restart_later, restart_same
  use dosui_scene, only: scene_t, region_t
  use dosui_table, only: table_t
  use dosui_scene_echo, only: entry_t, group_entries, is_in_force
  use dosui_scene_keys, only: collect_keys, group_size, group_t, scene_groups
  use dosui_text, only: to_text
  implicit none
  private

  public :: write_record, compare_records

  character(len=1), parameter :: newline = new_line('a')
  integer, parameter :: longest_value = 60     !! characters that a message shows
  integer, parameter :: most_lines = 200       !! that a message has
  real(wp), parameter :: same_factor = 1.0e-12_wp   !! round-off of interpolated factors [-]

  type :: text_t
    !! A text that grows.
    character(len=:), allocatable :: buffer
    integer :: n = 0          !! characters in use
    integer :: n_line = 0     !! of messages
  contains
    procedure :: append => text_append
    procedure :: say => text_say
    procedure :: all => text_all
  end type text_t

  type :: line_t
    character(len=:), allocatable :: key, value
  end type line_t

  type :: instance_t
    !! One group of a record.
    character(len=:), allocatable :: group
    character(len=:), allocatable :: label   !! value of the first key of groups given several times
    integer :: first = 1, last = 0           !! its lines
    logical :: is_matched = .false.
  end type instance_t

  type :: record_t
    type(instance_t), allocatable :: instance(:)
    type(line_t), allocatable :: line(:)
    integer :: n_instance = 0, n_line = 0
  end type record_t

  type :: comparison_t
    !! What is known while two records are compared.
    type(record_t) :: old, new
    type(key_t), allocatable :: keys(:)
    type(group_t), allocatable :: groups(:)
    real(wp) :: time = 0.0_wp      !! of the checkpoint [s]
    type(text_t) :: refused, changed
  end type comparison_t

contains

  ! ---------------------------------------------------------------- writing

  subroutine write_record(scene, text)
    !! A scene, its integrator resolved, as text: `&group label`, then `key = value` lines. Lists
    !! stand on one line.
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable, intent(out) :: text
    type(group_t), allocatable :: groups(:)
    type(entry_t), allocatable :: entries(:)
    type(text_t) :: record
    character(len=:), allocatable :: label
    integer :: g, instance, k

    groups = scene_groups()
    do g = 1, size(groups)
      if (.not. is_in_force(scene, groups(g)%name)) cycle
      do instance = 1, group_size(scene, groups(g)%name)
        call group_entries(scene, groups(g)%name, instance, entries)
        label = ''
        if (groups(g)%is_repeatable) label = ' '//on_one_line(entries(1)%value)
        call record%append('&'//groups(g)%name//label//newline)
        do k = 1, size(entries)
          if (entries(k)%key%applies) call append_entry(record, scene, instance, entries(k))
        end do
      end do
    end do
    text = record%all()
  end subroutine write_record

  subroutine append_entry(record, scene, instance, entry)
    !! Adds a key with its value, or with a checksum of what its file holds.
    type(text_t), intent(inout) :: record
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: instance
    type(entry_t), intent(in) :: entry
    character(len=:), allocatable :: value

    value = on_one_line(entry%value)
    if (len(value) == 0) value = '('//on_one_line(entry%note)//')'
    if (entry%key%restart == restart_content .and. len(entry%value) > 0) then
      select case (entry%key%name)
      case ('stl_file')
        value = body_content(scene%region(instance))
      case ('particle_file')
        value = particle_content(scene%region(instance))
      case default   ! of &base_motion: factor_times shows what it holds; of &output: nothing
        return
      end select
    end if
    call record%append(entry%key%name//' = '//value//newline)
  end subroutine append_entry

  function body_content(region) result(text)
    !! What tells one body of triangles from another: places of corners, solids.
    type(region_t), intent(in) :: region
    character(len=:), allocatable :: text
    type(checksum_t) :: checksum
    integer :: k

    if (allocated(region%body)) then
      do k = 1, region%body%n_vertex
        call checksum%add(3, region%body%vertex(:, k))
      end do
      do k = 1, region%body%n_triangle
        call checksum%add(4, int([region%body%corner(:, k), region%body%solid(k)], i8))
      end do
    end if
    text = content_text(checksum)
  end function body_content

  function particle_content(region) result(text)
    !! What tells one table of particles from another.
    type(region_t), intent(in) :: region
    character(len=:), allocatable :: text
    type(checksum_t) :: checksum
    integer :: k

    if (allocated(region%particle)) then
      do k = 1, size(region%particle, 2)
        call checksum%add(size(region%particle, 1), region%particle(:, k))
      end do
    end if
    if (allocated(region%particle_volume)) then
      call checksum%add(size(region%particle_volume), region%particle_volume)
    end if
    text = content_text(checksum)
  end function particle_content

  function content_text(checksum) result(text)
    type(checksum_t), intent(in) :: checksum
    character(len=:), allocatable :: text
    character(len=16) :: digits

    write (digits, '(z16.16)') checksum%value()
    text = 'content '//digits
  end function content_text

  pure function on_one_line(value) result(line)
    !! A value without line breaks and the blanks after them.
    character(len=*), intent(in) :: value
    character(len=:), allocatable :: line
    logical :: is_broken
    integer :: k, n

    allocate (character(len=len(value)) :: line)
    n = 0
    is_broken = .false.
    do k = 1, len(value)
      if (value(k:k) == newline) is_broken = .true.
      if (is_broken .and. (value(k:k) == newline .or. value(k:k) == ' ')) cycle
      if (is_broken) then
        n = n + 1
        line(n:n) = ' '
        is_broken = .false.
      end if
      n = n + 1
      line(n:n) = value(k:k)
    end do
    line = line(:n)
  end function on_one_line

  ! ---------------------------------------------------------------- comparing

  subroutine compare_records(old_text, new_text, time, refused, changed)
    !! What differs between a checkpoint's scene and that of a restart, a line each.
    character(len=*), intent(in) :: old_text, new_text
    real(wp), intent(in) :: time                           !! of the checkpoint [s]
    character(len=:), allocatable, intent(out) :: refused  !! what must not differ; '' if nothing
    character(len=:), allocatable, intent(out) :: changed  !! what may
    type(comparison_t) :: c
    integer :: n, o, last

    refused = ''
    changed = ''
    if (old_text == new_text) return
    call parse(old_text, c%old)
    call parse(new_text, c%new)
    call collect_keys(c%keys)
    c%groups = scene_groups()
    c%time = time
    last = 0
    do n = 1, c%new%n_instance
      o = partner_of(c, n, last)
      if (o == 0) then
        call say_alone(c, c%new%instance(n), 'only in the scene of the restart')
        cycle
      end if
      c%old%instance(o)%is_matched = .true.
      call compare_instances(c, o, n)
      if (o < last) call say_order(c, n)
      last = o
    end do
    do o = 1, c%old%n_instance
      if (.not. c%old%instance(o)%is_matched) call say_alone(c, c%old%instance(o), &
                                                             'only in the checkpoint''s scene')
    end do
    refused = c%refused%all()
    changed = c%changed%all()
  end subroutine compare_records

  integer function partner_of(c, n, last) result(o)
    !! The checkpoint's group that an instance of the new scene goes on from; 0: none.
    type(comparison_t), intent(in) :: c
    integer, intent(in) :: n, last
    integer :: k

    do k = 1, c%old%n_instance
      o = modulo(last + k - 1, c%old%n_instance) + 1   ! most likely the next one
      associate (old => c%old%instance(o), new => c%new%instance(n))
        if (old%is_matched .or. old%group /= new%group) cycle
        if (old%label == new%label) return
      end associate
    end do
    o = 0
  end function partner_of

  subroutine say_alone(c, instance, where_text)
    !! A group that only one of the scenes has.
    type(comparison_t), intent(inout) :: c
    type(instance_t), intent(in) :: instance
    character(len=*), intent(in) :: where_text

    if (is_free_group(c, instance%group)) then
      call c%changed%say(title(instance)//': '//where_text)
    else
      call c%refused%say(title(instance)//': '//where_text)
    end if
  end subroutine say_alone

  subroutine say_order(c, n)
    !! A group that stands before one that it stood after.
    type(comparison_t), intent(inout) :: c
    integer, intent(in) :: n

    if (is_free_group(c, c%new%instance(n)%group)) return
    call c%refused%say(title(c%new%instance(n))//': the order of the groups differs')
  end subroutine say_order

  subroutine compare_instances(c, o, n)
    !! The keys of a group that both scenes have.
    type(comparison_t), intent(inout) :: c
    integer, intent(in) :: o, n
    character(len=:), allocatable :: value
    integer :: i, j
    logical :: is_in_step

    associate (old => c%old%instance(o), new => c%new%instance(n))
      is_in_step = old%last - old%first == new%last - new%first
      if (is_in_step) then
        do i = 0, new%last - new%first
          is_in_step = c%old%line(old%first + i)%key == c%new%line(new%first + i)%key .and. &
                       c%old%line(old%first + i)%value == c%new%line(new%first + i)%value
          if (.not. is_in_step) exit
        end do
      end if
      if (is_in_step) return   ! all equal
      value = ''
      do i = new%first, new%last
        j = line_of(c%old, old, c%new%line(i)%key)
        value = default_of(c, new%group, c%new%line(i)%key)
        if (j > 0) value = c%old%line(j)%value
        call compare_values(c, o, n, c%new%line(i)%key, value, c%new%line(i)%value)
      end do
      do j = old%first, old%last
        if (line_of(c%new, new, c%old%line(j)%key) > 0) cycle
        call compare_values(c, o, n, c%old%line(j)%key, c%old%line(j)%value, &
                            default_of(c, old%group, c%old%line(j)%key))
      end do
    end associate
  end subroutine compare_instances

  subroutine compare_values(c, o, n, key, old, new)
    !! One key.
    type(comparison_t), intent(inout) :: c
    integer, intent(in) :: o, n                  !! instances
    character(len=*), intent(in) :: key, old, new
    character(len=:), allocatable :: message
    integer :: restart

    if (old == new) return
    restart = restart_of(c, c%new%instance(n)%group, key)
    message = title(c%new%instance(n))//' '//key//': '//shown(old)//' -> '//shown(new)
    if (restart == restart_later) then
      if (same_until(c, o, n)) then
        call c%changed%say(message//' (only later than the checkpoint)')
      else
        call c%refused%say(message//' (not only later than the checkpoint, t = '// &
                           to_text(c%time)//' s)')
      end if
    else if (restart == restart_free) then
      call c%changed%say(message)
    else
      call c%refused%say(message)
    end if
  end subroutine compare_values

  logical function same_until(c, o, n) result(same)
    !! Are the factors of both scenes the same until the time of the checkpoint?
    type(comparison_t), intent(in) :: c
    integer, intent(in) :: o, n
    type(table_t) :: old, new

    old = table_in(c%old, c%old%instance(o))
    new = table_in(c%new, c%new%instance(n))
    same = agree_at(0.0_wp) .and. agree_at(c%time)
    if (allocated(old%argument)) same = same .and. agree_at_all(old%argument)
    if (allocated(new%argument)) same = same .and. agree_at_all(new%argument)

  contains

    logical function agree_at_all(times) result(agree)
      real(wp), intent(in) :: times(:)   !! [s]
      integer :: k

      agree = .true.
      do k = 1, size(times)
        if (times(k) > 0.0_wp .and. times(k) < c%time) agree = agree .and. agree_at(times(k))
      end do
    end function agree_at_all

    logical function agree_at(t) result(agree)
      real(wp), intent(in) :: t   !! [s]
      real(wp) :: a, b

      a = old%at(t)
      b = new%at(t)
      agree = abs(a - b) <= same_factor*max(1.0_wp, abs(a), abs(b))
    end function agree_at
  end function same_until

  function table_in(record, instance) result(table)
    !! The factors of a group.
    type(record_t), intent(in) :: record
    type(instance_t), intent(in) :: instance
    type(table_t) :: table
    integer :: times, values

    times = line_of(record, instance, 'factor_times')
    values = line_of(record, instance, 'factor_values')
    if (times == 0 .or. values == 0) return
    table%argument = numbers(record%line(times)%value)
    table%value = numbers(record%line(values)%value)
    if (size(table%argument) == 0 .or. size(table%argument) /= size(table%value)) then
      deallocate (table%argument, table%value)
    end if
  end function table_in

  function numbers(text) result(list)
    !! The numbers of a list; none for a note in brackets.
    character(len=*), intent(in) :: text
    real(wp), allocatable :: list(:)
    integer :: k, n, status

    n = 0
    if (len(text) > 0) n = 1
    if (index(text, '(') == 1) n = 0
    do k = 1, len(text)
      if (n > 0 .and. text(k:k) == ',') n = n + 1
    end do
    allocate (list(n))
    if (n == 0) return
    read (text, *, iostat=status) list
    if (status /= 0) list = huge(1.0_wp)
  end function numbers

  ! ---------------------------------------------------------------- words of messages

  function title(instance) result(text)
    type(instance_t), intent(in) :: instance
    character(len=:), allocatable :: text

    text = '&'//instance%group//instance%label
  end function title

  function shown(value) result(text)
    !! A value, shortened if it is long.
    character(len=*), intent(in) :: value
    character(len=:), allocatable :: text

    text = value
    if (len(value) > longest_value) text = value(:longest_value - 3)//'...'
  end function shown

  integer function restart_of(c, group, key) result(restart)
    !! What a restart may change of a key.
    type(comparison_t), intent(in) :: c
    character(len=*), intent(in) :: group, key
    integer :: k

    restart = restart_same
    do k = 1, size(c%keys)
      if (c%keys(k)%group == group .and. c%keys(k)%name == key) restart = c%keys(k)%restart
    end do
  end function restart_of

  function default_of(c, group, key) result(value)
    !! The default of a key as a record shows it: what holds where a scene does not have the key.
    type(comparison_t), intent(in) :: c
    character(len=*), intent(in) :: group, key
    character(len=:), allocatable :: value
    integer :: k

    value = '(not known)'
    do k = 1, size(c%keys)
      if (c%keys(k)%group /= group .or. c%keys(k)%name /= key) cycle
      value = c%keys(k)%default
      if (c%keys(k)%kind == 'vector') value = value//repeat(', '//value, ndim - 1)
      if (len(c%keys(k)%default) == 0) value = '('//trim(c%keys(k)%fallback)//')'
    end do
  end function default_of

  logical function is_free_group(c, group) result(is_free)
    type(comparison_t), intent(in) :: c
    character(len=*), intent(in) :: group
    integer :: g

    is_free = .false.
    do g = 1, size(c%groups)
      if (c%groups(g)%name == group) is_free = c%groups(g)%is_free
    end do
  end function is_free_group

  integer function line_of(record, instance, key) result(k)
    !! Where a key of a group stands; 0: nowhere.
    type(record_t), intent(in) :: record
    type(instance_t), intent(in) :: instance
    character(len=*), intent(in) :: key

    do k = instance%first, instance%last
      if (record%line(k)%key == key) return
    end do
    k = 0
  end function line_of

  ! ---------------------------------------------------------------- reading

  subroutine parse(text, record)
    !! A record from its text.
    character(len=*), intent(in) :: text
    type(record_t), intent(inout) :: record
    integer :: first, length, blank, n
    character(len=:), allocatable :: line

    line = ''
    n = count([(text(first:first) == newline, first=1, len(text))]) + 1
    allocate (record%line(n), record%instance(n))
    first = 1
    do while (first <= len(text))
      length = index(text(first:), newline) - 1
      if (length < 0) length = len(text) - first + 1
      line = text(first:first + length - 1)
      first = first + length + 1
      if (index(line, '&') == 1) then
        blank = index(line//' ', ' ')
        record%n_instance = record%n_instance + 1
        associate (instance => record%instance(record%n_instance))
          instance%group = line(2:blank - 1)
          instance%label = line(blank:)
          instance%first = record%n_line + 1
          instance%last = record%n_line
        end associate
      else if (index(line, ' = ') > 0 .and. record%n_instance > 0) then
        record%n_line = record%n_line + 1
        record%line(record%n_line)%key = line(:index(line, ' = ') - 1)
        record%line(record%n_line)%value = line(index(line, ' = ') + 3:)
        record%instance(record%n_instance)%last = record%n_line
      end if
    end do
  end subroutine parse

  ! ---------------------------------------------------------------- texts that grow

  subroutine text_append(self, more)
    class(text_t), intent(inout) :: self
    character(len=*), intent(in) :: more
    character(len=:), allocatable :: longer

    if (.not. allocated(self%buffer)) allocate (character(len=1024) :: self%buffer)
    if (self%n + len(more) > len(self%buffer)) then
      allocate (character(len=2*(self%n + len(more))) :: longer)
      longer(:self%n) = self%buffer(:self%n)
      call move_alloc(longer, self%buffer)
    end if
    self%buffer(self%n + 1:self%n + len(more)) = more
    self%n = self%n + len(more)
  end subroutine text_append

  subroutine text_say(self, line)
    !! Adds a line of a message; beyond the most lines nothing but their end.
    class(text_t), intent(inout) :: self
    character(len=*), intent(in) :: line

    self%n_line = self%n_line + 1
    if (self%n_line > most_lines + 1) return
    if (self%n > 0) call self%append(newline)
    if (self%n_line > most_lines) then
      call self%append('  ...')
    else
      call self%append('  '//line)
    end if
  end subroutine text_say

  pure function text_all(self) result(text)
    class(text_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = ''
    if (self%n > 0) text = self%buffer(:self%n)
  end function text_all
end module dosui_scene_record

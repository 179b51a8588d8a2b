!! What the table of keys says to the user: a template of a scene, and the pages of the manual.
module dosui_scene_template
  use dosui_kinds, only: wp
  use dosui_combinations_page, only: combinations_page
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_key_visitor, only: key_t, restart_content, restart_free, restart_later
  use dosui_scene, only: scene_t
  use dosui_scene_echo, only: entry_t, group_entries
  use dosui_scene_keys, only: group_t, scene_groups, group_size, allocate_group, collect_keys
  implicit none
  private

  public :: write_template, write_group_docs, example_scene

  character(len=1), parameter :: newline = new_line('a')
  integer, parameter :: comment_column = 40   !! where the comments of the template begin
  integer, parameter :: page_width = 98       !! columns of the template

contains

  ! ---------------------------------------------------------------- template

  subroutine write_template(text)
    !! A complete, commented scene that runs: Terzaghi's column in the dimension of this executable.
    !! Keys that stay at their defaults are commented out.
    character(len=:), allocatable, intent(out) :: text
    type(group_t), allocatable :: groups(:)
    type(scene_t) :: scene, defaults
    integer :: g, instance

    groups = scene_groups()
    call example_scene(scene)
    text = '! Terzaghi consolidation of a column: a template with all groups and keys.'//newline// &
           '! Keys that are commented out show their defaults. Units are SI; z is up; stress is'// &
           newline//'! tension positive, pore pressure compression positive.'//newline
    do g = 1, size(groups)
      call allocate_group(defaults, groups(g)%name, 1)
      text = text//newline//folded('! &'//groups(g)%name//', '//group_note(groups(g))//': '// &
                                   groups(g)%description)
      if (group_size(scene, groups(g)%name) == 0) then
        call append_group(text, defaults, defaults, groups(g)%name, 1, '! ')
      end if
      do instance = 1, group_size(scene, groups(g)%name)
        call append_group(text, scene, defaults, groups(g)%name, instance, '')
      end do
    end do
  end subroutine write_template

  subroutine append_group(text, scene, defaults, group, instance, prefix)
    !! One instance of a group; keys at their defaults are shown in the first instance only.
    character(len=:), allocatable, intent(inout) :: text
    type(scene_t), intent(in) :: scene
    type(scene_t), intent(in) :: defaults   !! with one instance of the group
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    character(len=*), intent(in) :: prefix  !! of all lines: '! ' for a group that is not in use
    type(entry_t), allocatable :: entries(:), default_entries(:)
    character(len=:), allocatable :: line
    integer :: k
    logical :: is_used

    line = ''
    call group_entries(scene, group, instance, entries)
    call group_entries(defaults, group, 1, default_entries)
    text = text//prefix//'&'//group//newline
    do k = 1, size(entries)
      associate (entry => entries(k))
        is_used = entry%key%applies .and. len(entry%value) > 0 .and. len(prefix) == 0 .and. &
                  (entry%key%is_required .or. entry%value /= default_entries(k)%value)
        if (instance > 1 .and. .not. is_used) cycle
        line = '  ! '//entry%key%name//' = '//entry%value
        if (is_used .or. len(prefix) > 0) line = '  '//entry%key%name//' = '//entry%value
        line = prefix//line
        if (instance == 1) line = with_comment(line, prefix, key_note(entry))
        text = text//line//newline
      end associate
    end do
    text = text//prefix//'/'//newline
  end subroutine append_group

  pure function group_note(group) result(note)
    !! Must a group be given, and how often?
    type(group_t), intent(in) :: group
    character(len=:), allocatable :: note

    note = 'optional'
    if (group%is_required) note = 'required'
    if (group%is_repeatable) note = note//', may be given several times'
  end function group_note

  pure function key_note(entry) result(text)
    !! What there is to say about a key: 'drained Young''s modulus [Pa]; > 0; required'.
    type(entry_t), intent(in) :: entry
    character(len=:), allocatable :: text

    associate (key => entry%key)
      text = key%description
      if (len_trim(key%unit) > 0) text = text//' ['//trim(key%unit)//']'
      if (len_trim(key%range) > 0) text = text//'; '//trim(key%range)
      if (len_trim(key%choices) > 0) text = text//'; '//listed(trim(key%choices), "'", ', ')
      if (key%is_required) text = text//'; required'
      if (len_trim(key%only) > 0) text = text//'; only with '//trim(key%only)
      if (len(entry%value) == 0 .and. .not. key%is_required) text = text//'; default: '//entry%note
    end associate
  end function key_note

  pure function with_comment(line, prefix, comment) result(text)
    !! A line with a comment beside it, folded so that it stays within the page.
    character(len=*), intent(in) :: line, prefix, comment
    character(len=:), allocatable :: text
    character(len=:), allocatable :: rest
    integer :: cut, room

    text = line//repeat(' ', max(comment_column - len(line), 1))//'! '
    room = page_width - len(text)
    rest = comment
    do while (len(rest) > room)
      cut = index(rest(:room + 1), ' ', back=.true.)
      if (cut == 0) exit
      text = text//rest(:cut - 1)//newline//prefix// &
             repeat(' ', comment_column - len(prefix))//'! '
      room = page_width - comment_column - 2
      rest = rest(cut + 1:)
    end do
    text = text//rest
  end function with_comment

  pure function listed(choices, quote, separator) result(text)
    !! A list of words with quotes around each.
    character(len=*), intent(in) :: choices, quote, separator
    character(len=:), allocatable :: text
    integer :: k

    text = quote
    do k = 1, len(choices)
      if (choices(k:k) == ' ') then
        text = text//quote//separator//quote
      else
        text = text//choices(k:k)
      end if
    end do
    text = text//quote
  end function listed

  pure function folded(comment) result(text)
    !! A comment on lines that stay within the page.
    character(len=*), intent(in) :: comment
    character(len=:), allocatable :: text
    integer :: cut, first

    text = ''
    first = 1
    do while (len(comment) - first + 1 > page_width)
      cut = first - 1 + index(comment(first:first + page_width - 1), ' ', back=.true.)
      text = text//comment(first:cut - 1)//newline//'! '
      first = cut + 1
    end do
    text = text//comment(first:)//newline
  end function folded

  subroutine example_scene(scene)
    !! Terzaghi's column, 1 m high, loaded by 1000 Pa and drained at the top.
    type(scene_t), intent(out) :: scene
    real(wp), parameter :: width = 0.1_wp, height = 1.0_wp, load = 1000.0_wp   ! [m], [m], [Pa]
    type(group_t), allocatable :: groups(:)
    integer :: g

    groups = scene_groups()
    do g = 1, size(groups)
      call allocate_group(scene, groups(g)%name, 1)
    end do
    call allocate_group(scene, 'table', 0)
    call allocate_group(scene, 'initial_state', 0)
    call allocate_group(scene, 'hole', 0)
    call allocate_group(scene, 'barrier', 0)
    call allocate_group(scene, 'rigid_wall', 0)
    scene%title = 'Terzaghi consolidation of a column'
    scene%grid_spacing = 0.05_wp
    scene%time%end_time = 9.0_wp
    scene%time%output_interval = 0.45_wp
    scene%material(1)%name = 'soil'
    call scene%material(1)%set('young_modulus', 1.0e6_wp)
    call scene%material(1)%set('poisson_ratio', 0.2_wp)
    call scene%material(1)%hydraulic_conductivity%set(1.0e-3_wp)
    scene%water%bulk_modulus = 3.0e7_wp
    scene%region(1)%name = 'column'
    scene%region(1)%material = 'soil'
    scene%region(1)%box_max = width
    scene%region(1)%box_max(ndim) = height
    call example_boundary(scene)
    scene%hydraulic_condition(1)%surface = 'top'
    scene%hydraulic_condition(1)%kind = 'pressure'
    scene%mechanical_condition(size(scene%mechanical_condition))%value(1) = load
    scene%probe(1)%name = 'settlement'
    scene%probe(1)%kind = 'settlement'
    scene%probe(1)%surface = 'top'
    scene%verification%case = 'terzaghi'
    scene%verification%load = load
    scene%verification%length = height
    scene%verification%drained(ndim) = height
    scene%verification%direction(ndim) = -1.0_wp
  end subroutine example_scene

  subroutine example_boundary(scene)
    !! Rollers on base and sides, a pressure on the top.
    type(scene_t), intent(inout) :: scene
    character(len=6), parameter :: names(6) = ['left  ', 'right ', 'front ', 'back  ', 'base  ', &
                                               'top   ']
    character(len=2), parameter :: faces(6) = ['x-', 'x+', 'y-', 'y+', 'z-', 'z+']
    integer :: s, k

    call allocate_group(scene, 'surface', 2*ndim)
    call allocate_group(scene, 'mechanical_condition', 2*ndim)
    do s = 1, 2*ndim
      k = s
      if (s > 2*ndim - 2) k = s + 6 - 2*ndim
      scene%surface(s)%name = names(k)
      scene%surface(s)%region = 'column'
      scene%surface(s)%face = faces(k)
      scene%mechanical_condition(s)%surface = names(k)
      scene%mechanical_condition(s)%kind = 'roller'
    end do
    scene%mechanical_condition(2*ndim)%kind = 'pressure'
  end subroutine example_boundary

  ! ---------------------------------------------------------------- manual

  subroutine write_group_docs(directory, err)
    !! One page for each group, one of what works with what, and an index, into a folder that
    !! exists: the same from the executables of all dimensions.
    character(len=*), intent(in) :: directory
    type(error_t), intent(inout) :: err
    type(group_t), allocatable :: groups(:)
    type(key_t), allocatable :: keys(:)
    character(len=:), allocatable :: contents
    integer :: g

    groups = scene_groups()
    call collect_keys(keys)
    contents = docs_mark('dosui_*_keys')//'# The scene file'//newline//newline// &
               'A scene is a text file of groups, `&name key = value ... /`; `!` begins a '// &
               'comment. Texts stand in'//newline//'quotes, vectors hold the components of the '// &
               'scene''s dimension: (z), (x, z) or (x, y, z), with z up.'//newline// &
               'Single elements (`gravity(2) = -9.81`) and repeat counts (`3*0.0`) may be '// &
               'used. Names of groups and keys'//newline//'may be written in capitals. '// &
               'Numbers are in SI units, with a decimal point.'//newline//newline// &
               '`dosui --template 2` prints a scene that runs, with all keys; `dosui --check '// &
               'scene.nml` checks one'//newline//'without computing.'//newline//newline// &
               'The last column of the pages tells what may change at a restart: free, the '// &
               'value; later, factors after'//newline//'the time of the checkpoint; content, '// &
               'the path of a file but not what it holds; nothing, if it is empty'//newline// &
               '([restart](../restart.md)).'//newline//newline// &
               'Which integrator and which deformation do what: [what works with '// &
               'what](combinations.md).'//newline//newline// &
               '| group | given | holds |'//newline//'|---|---|---|'//newline
    do g = 1, size(groups)
      contents = contents//'| [`&'//groups(g)%name//'`]('//groups(g)%name//'.md) | '// &
                 group_note(groups(g))//' | '//groups(g)%description//' |'//newline
      call write_file(directory//'/'//groups(g)%name//'.md', group_page(groups(g), keys), err)
    end do
    call write_file(directory//'/README.md', contents, err)
    call write_file(directory//'/combinations.md', &
                    combinations_page(docs_mark('dosui_capabilities')), err)
  end subroutine write_group_docs

  pure function docs_mark(module) result(text)
    !! The first line of every page.
    character(len=*), intent(in) :: module   !! that it is written from
    character(len=:), allocatable :: text

    text = '<!-- Written by `dosui --docs docs/namelist` from src/io/'//module// &
           '.f90: change it there. -->'//newline//newline
  end function docs_mark

  function group_page(group, keys) result(text)
    !! The page of a group.
    type(group_t), intent(in) :: group
    type(key_t), intent(in) :: keys(:)
    character(len=:), allocatable :: text
    integer :: k

    text = docs_mark('dosui_*_keys')//'# `&'//group%name//'`'//newline//newline// &
           group%description//newline//newline//'This group is '//group_note(group)//'.'// &
           newline//newline// &
           '| key | type | unit | default | allowed | meaning | at a restart |'//newline// &
           '|---|---|---|---|---|---|---|'//newline
    do k = 1, size(keys)
      if (keys(k)%group == group%name) text = text//key_row(keys(k))//newline
    end do
  end function group_page

  pure function key_row(key) result(row)
    !! A key as a row of the table of its page.
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: row
    character(len=:), allocatable :: default, allowed, kind

    kind = key%kind
    if (kind == 'vector' .and. key%name == 'value') kind = 'vector or real'
    default = trim(key%fallback)
    if (len(key%default) > 0) default = '`'//key%default//'`'
    if (key%kind == 'vector' .and. len(key%default) > 0) default = default//' each'
    if (key%is_required) default = '**required**'
    allowed = trim(key%range)
    if (len_trim(key%choices) > 0) allowed = listed(trim(key%choices), '`', ', ')
    row = '| `'//key%name//'` | '//kind//' | '//trim(key%unit)//' | '//default//' | '// &
          allowed//' | '//key%description
    if (len_trim(key%only) > 0) row = row//'. Only with '//trim(key%only)
    row = row//' | '//restart_word(key)//' |'
  end function key_row

  pure function restart_word(key) result(word)
    !! What a restart may change of a key.
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: word

    select case (key%restart)
    case (restart_free)
      word = 'free'
    case (restart_later)
      word = 'later'
    case (restart_content)
      word = 'content'
    case default
      word = ''
    end select
  end function restart_word

  subroutine write_file(path, text, err)
    !! Replaces a text file.
    character(len=*), intent(in) :: path, text
    type(error_t), intent(inout) :: err
    character(len=256) :: message
    integer :: unit, status

    if (err%failed()) return
    open (newunit=unit, file=path, access='stream', form='unformatted', action='write', &
          status='replace', iostat=status, iomsg=message)
    if (status == 0) write (unit, iostat=status, iomsg=message) text
    if (status /= 0) then
      call err%set('cannot write '//path//': '//trim(message))
    else
      close (unit)
    end if
  end subroutine write_file
end module dosui_scene_template

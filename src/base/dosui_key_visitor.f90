!! What is known about a key of a scene, and what does something with every key that it is shown.
!! Whoever has keys of its own (the groups in dosui_scene_keys, the soils in material/) shows them
!! to a visitor together with the variables that they set.
module dosui_key_visitor
  use dosui_kinds, only: wp, i8
  use dosui_numbers, only: text_as_real
  use dosui_scalar_function, only: scalar_function_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: key, real_text, in_range, n_choice, choice_of, present_choice

  integer, parameter, public :: name_length = 64   !! characters of a name in a scene

  ! what a restart may change of a key (docs/restart.md)
  integer, parameter, public :: restart_same = 0      !! nothing
  integer, parameter, public :: restart_free = 1      !! its value
  integer, parameter, public :: restart_later = 2     !! factors later than the checkpoint
  integer, parameter, public :: restart_content = 3   !! the path, not what the file holds

  type, public :: key_t
    !! What is known about a key. Short texts have a fixed length: a scene of many groups shows
    !! millions of keys, and most of the time would go to finding room for their texts.
    character(len=:), allocatable :: name
    character(len=:), allocatable :: description   !! one line
    character(len=8) :: unit = ''                  !! '' for what has none
    character(len=64) :: range = ''                !! '' or '> 0', '>= 0 and <= 1', ...
    character(len=192) :: choices = ''             !! '' or the allowed texts, separated by blanks
    character(len=96) :: only = ''                 !! '' or where it has a meaning: kind = 'given'
    character(len=96) :: fallback = ''             !! '' or the default in words
    character(len=name_length) :: former = ''      !! '' or what the key was called before
    character(len=96) :: former_choices = ''
    !! '' or pairs of a former choice and its present name, separated by blanks
    logical :: is_required = .false.
    logical :: applies = .true.                    !! is the condition `only` met in this instance?
    logical :: is_undecided = .false.              !! unknown, because a choice above is missing
    integer :: longest = name_length               !! characters of a text
    integer :: restart = restart_same              !! what a restart may change
    ! filled by collect_keys
    character(len=:), allocatable :: group
    character(len=:), allocatable :: kind          !! 'real', 'integer', 'logical', 'text', ...
    character(len=:), allocatable :: default       !! as namelist text, '' for none
  end type key_t

  type, abstract, public :: key_visitor_t
    !! Does something with every key that it is shown.
  contains
    procedure(visit_real), deferred :: real
    procedure(visit_property), deferred :: property
    procedure(visit_integer), deferred :: integer
    procedure(visit_long), deferred :: long
    procedure(visit_logical), deferred :: logical
    procedure(visit_name), deferred :: name
    procedure(visit_text), deferred :: text
    procedure(visit_vector), deferred :: vector
    procedure(visit_list), deferred :: list
    procedure(visit_points), deferred :: points
  end type key_visitor_t

  abstract interface
    subroutine visit_real(self, value, key)
      import :: key_visitor_t, key_t, wp
      implicit none
      class(key_visitor_t), intent(inout) :: self
      real(wp), intent(inout) :: value   !! [unit of the key]
      type(key_t), intent(in) :: key
    end subroutine visit_real
    subroutine visit_property(self, value, key)
      !! A real, or a formula of place.
      import :: key_visitor_t, key_t, scalar_function_t
      implicit none
      class(key_visitor_t), intent(inout) :: self
      type(scalar_function_t), intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_property
    subroutine visit_integer(self, value, key)
      import :: key_visitor_t, key_t
      implicit none
      class(key_visitor_t), intent(inout) :: self
      integer, intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_integer
    subroutine visit_long(self, value, key)
      !! An integer of 64 bits, of steps say.
      import :: key_visitor_t, key_t, i8
      implicit none
      class(key_visitor_t), intent(inout) :: self
      integer(i8), intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_long
    subroutine visit_logical(self, value, key)
      import :: key_visitor_t, key_t
      implicit none
      class(key_visitor_t), intent(inout) :: self
      logical, intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_logical
    subroutine visit_name(self, value, key)
      import :: key_visitor_t, key_t, name_length
      implicit none
      class(key_visitor_t), intent(inout) :: self
      character(len=name_length), intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_name
    subroutine visit_text(self, value, key)
      import :: key_visitor_t, key_t
      implicit none
      class(key_visitor_t), intent(inout) :: self
      character(len=:), allocatable, intent(inout) :: value
      type(key_t), intent(in) :: key
    end subroutine visit_text
    subroutine visit_vector(self, value, key)
      !! A fixed number of reals.
      import :: key_visitor_t, key_t, wp
      implicit none
      class(key_visitor_t), intent(inout) :: self
      real(wp), intent(inout) :: value(:)   !! [unit of the key]
      type(key_t), intent(in) :: key
    end subroutine visit_vector
    subroutine visit_list(self, value, key)
      !! Any number of reals.
      import :: key_visitor_t, key_t, wp
      implicit none
      class(key_visitor_t), intent(inout) :: self
      real(wp), allocatable, intent(inout) :: value(:)   !! [unit of the key]
      type(key_t), intent(in) :: key
    end subroutine visit_list
    subroutine visit_points(self, value, key)
      !! Any number of points (ndim, n).
      import :: key_visitor_t, key_t, wp
      implicit none
      class(key_visitor_t), intent(inout) :: self
      real(wp), allocatable, intent(inout) :: value(:, :)   !! [unit of the key]
      type(key_t), intent(in) :: key
    end subroutine visit_points
  end interface

contains

  pure function key(name, description, unit, range, choices, only, applies, required, fallback, &
                    longest, undecided, restart, former, former_choices)
    !! A key with what was left out empty.
    character(len=*), intent(in) :: name, description
    character(len=*), intent(in), optional :: unit, range, choices, only, fallback, former
    character(len=*), intent(in), optional :: former_choices
    logical, intent(in), optional :: applies, required, undecided
    integer, intent(in), optional :: longest, restart
    type(key_t) :: key

    key%name = name
    key%description = description
    if (present(unit)) key%unit = unit
    if (present(range)) key%range = range
    if (present(choices)) key%choices = choices
    if (present(only)) key%only = only
    if (present(fallback)) key%fallback = fallback
    if (present(former)) key%former = former
    if (present(former_choices)) key%former_choices = former_choices
    if (present(applies)) key%applies = applies
    if (present(required)) key%is_required = required
    if (present(longest)) key%longest = longest
    if (present(undecided)) key%is_undecided = undecided
    if (present(restart)) key%restart = restart
  end function key

  pure logical function in_range(x, range) result(is_in)
    !! Does a number fulfil all conditions of a range like '>= 0 and < 0.5'?
    real(wp), intent(in) :: x   !! [any unit]
    character(len=*), intent(in) :: range
    character(len=*), parameter :: conjunction = ' and '
    character(len=:), allocatable :: reason
    real(wp) :: bound
    integer :: first, last, blank

    is_in = .true.
    first = 1
    do while (first <= len_trim(range))
      last = index(range(first:), conjunction)
      last = merge(first + last - 2, len_trim(range), last > 0)
      blank = first + index(range(first:last), ' ') - 1
      bound = 0.0_wp
      call text_as_real(range(blank + 1:last), bound, reason)
      is_in = is_in .and. len(reason) == 0   ! a range that is none holds for nothing
      select case (range(first:blank - 1))
      case ('>')
        is_in = is_in .and. x > bound
      case ('>=')
        is_in = is_in .and. x >= bound
      case ('<')
        is_in = is_in .and. x < bound
      case default
        is_in = is_in .and. x <= bound
      end select
      first = last + len(conjunction) + 1
    end do
  end function in_range

  pure integer function n_choice(choices) result(n)
    !! How many texts a list of choices holds.
    character(len=*), intent(in) :: choices
    integer :: k

    n = 0
    if (len_trim(choices) > 0) n = 1
    do k = 1, len_trim(choices)
      if (choices(k:k) == ' ') n = n + 1
    end do
  end function n_choice

  pure function choice_of(choices, k) result(choice)
    !! The k-th text of a list of choices.
    character(len=*), intent(in) :: choices
    integer, intent(in) :: k
    character(len=name_length) :: choice
    integer :: first, n

    first = 1
    do n = 2, k
      first = first + index(choices(first:), ' ')
    end do
    choice = choices(first:first - 2 + index(choices(first:)//' ', ' '))
  end function choice_of

  pure function present_choice(former_choices, choice) result(present_name)
    !! What a former choice is called now, '' if it never was one.
    character(len=*), intent(in) :: former_choices   !! pairs, as of keys
    character(len=*), intent(in) :: choice
    character(len=:), allocatable :: present_name
    integer :: k

    present_name = ''
    do k = 1, n_choice(former_choices), 2
      if (choice_of(former_choices, k) /= choice) cycle
      present_name = trim(choice_of(former_choices, k + 1))
    end do
  end function present_choice

  pure function real_text(x) result(text)
    !! A real as namelist text, '' if it stands for no limit.
    real(wp), intent(in) :: x   !! [any unit]
    character(len=:), allocatable :: text

    text = ''
    if (abs(x) < huge(x)) text = to_text(x)
  end function real_text
end module dosui_key_visitor

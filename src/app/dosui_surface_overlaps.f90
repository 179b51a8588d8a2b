!! Conditions that meet on the same surface points: those that exclude each other are problems of
!! the scene; those whose sum acts, or of which one does nothing, are worth a word.
module dosui_surface_overlaps
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_log, only: log_t
  use dosui_model, only: model_t
  use dosui_name_index, only: name_index_t
  use dosui_scene, only: hydraulic_condition_t, scene_t
  use dosui_surface_sets, only: index_of, set_holds, set_is_empty
  use dosui_text, only: to_text, vector_text
  use dosui_wall, only: wall_t
  implicit none
  private

  public :: check_overlaps, warn_of_overlaps

  integer, parameter :: none = 0, two_walls = 1, two_waters = 2, two_loads = 3, idle_load = 4
  integer, parameter :: most = 20                 !! meetings told
  integer(i8), parameter :: base = 2_i8**29       !! more than conditions

  type :: meetings_t
    !! Distinct pairs of conditions that meet, on this rank.
    integer :: n = 0
    integer(i8), allocatable :: key(:)    !! of the kind of meeting and both conditions
    integer(i8), allocatable :: id(:)     !! least identity of a point where they meet
    integer, allocatable :: count(:)      !! of points
    real(wp), allocatable :: place(:, :)  !! of the point with that identity [m]
  end type meetings_t

contains

  subroutine check_overlaps(model, problems)
    !! Problems, one a line: two walls, or two hydraulic conditions that differ, on one point.
    !! Collective.
    type(model_t), intent(in) :: model
    character(len=:), allocatable, intent(inout) :: problems
    type(log_t) :: nowhere

    call tell(model, [two_walls, two_waters], problems, nowhere)
  end subroutine check_overlaps

  subroutine warn_of_overlaps(model)
    !! Warnings: loads of one kind that add up where their surfaces overlap, and loads on points
    !! that are held against them. Collective.
    type(model_t), intent(inout) :: model
    character(len=:), allocatable :: problems

    problems = ''
    call tell(model, [two_loads, idle_load], problems, model%log)
  end subroutine warn_of_overlaps

  subroutine tell(model, kinds, problems, log)
    !! Finds the meetings of some kinds on all ranks and words them.
    type(model_t), intent(in) :: model
    integer, intent(in) :: kinds(:)
    character(len=:), allocatable, intent(inout) :: problems   !! of the first two kinds
    type(log_t), intent(inout) :: log                          !! hears of the others
    type(meetings_t) :: meetings
    integer(i8) :: next, id
    integer :: told, k, total
    real(wp) :: place(ndim)

    call find_meetings(model, kinds, meetings)
    next = -1_i8
    do told = 1, most
      next = model%comm%minimum(minval(meetings%key(:meetings%n), &
                                       mask=meetings%key(:meetings%n) > next))
      if (next == huge(next)) exit
      k = findloc(meetings%key(:meetings%n), next, dim=1)
      id = huge(id)
      total = 0
      if (k > 0) then
        id = meetings%id(k)
        total = meetings%count(k)
      end if
      total = model%comm%sum(total)
      place = 0.0_wp
      if (id == model%comm%minimum(id) .and. k > 0) place = meetings%place(:, k)
      call model%comm%sum_array(place)
      if (any(kinds == two_walls)) then
        problems = problems//worded(model, next, total, place)//new_line('a')
      else
        call log%warning(worded(model, next, total, place))
      end if
    end do
  end subroutine tell

  subroutine find_meetings(model, kinds, meetings)
    !! All pairs of conditions of this rank's points.
    type(model_t), intent(in) :: model
    integer, intent(in) :: kinds(:)
    type(meetings_t), intent(out) :: meetings
    integer, allocatable :: distinct(:), mechanical(:), hydraulic(:), here(:)
    integer :: p, b, k

    allocate (meetings%key(8), meetings%id(8), meetings%count(8), meetings%place(ndim, 8))
    meetings%key = huge(1_i8)
    associate (scene => model%scene, points => model%surface)
      distinct = distinct_conditions(scene)
      mechanical = [(index_of(scene, scene%mechanical_condition(distinct(k))%surface), &
                     k=1, size(distinct))]
      hydraulic = [(index_of(scene, scene%hydraulic_condition(k)%surface), &
                    k=1, size(scene%hydraulic_condition))]
      do p = 1, points%count
        associate (set => points%field(model%s%surface)%values(:, p))
          if (set_is_empty(set)) cycle
          here = pack(distinct, [(set_holds(set, mechanical(k)), k=1, size(mechanical))])
          call book_mechanical(model, meetings, kinds, here, p)
          if (.not. any(kinds == two_waters)) cycle
          here = pack([(k, k=1, size(hydraulic))], &
                      [(set_holds(set, hydraulic(k)), k=1, size(hydraulic))])
          do b = 2, size(here)
            if (differ(scene%hydraulic_condition(here(1)), scene%hydraulic_condition(here(b)))) then
              call book(model, meetings, two_waters, here(1), here(b), p)
            end if
          end do
        end associate
      end do
    end associate
  end subroutine find_meetings

  function distinct_conditions(scene) result(distinct)
    !! The mechanical conditions without loads that repeat an earlier one's kind and surface: these
    !! meet the same others, in the same words.
    type(scene_t), intent(in) :: scene
    integer, allocatable :: distinct(:)
    logical :: is_distinct(size(scene%mechanical_condition))
    type(name_index_t) :: loads
    integer :: k

    is_distinct = .true.
    do k = 1, size(is_distinct)
      associate (condition => scene%mechanical_condition(k))
        if (.not. condition%is_load()) cycle
        is_distinct(k) = loads%find(condition%kind//condition%surface) == 0
        if (is_distinct(k)) call loads%add(condition%kind//condition%surface, k)
      end associate
    end do
    distinct = pack([(k, k=1, size(is_distinct))], is_distinct)
  end function distinct_conditions

  subroutine book_mechanical(model, meetings, kinds, here, point)
    !! Counts one point for the meetings of its mechanical conditions. Meetings of the first kind
    !! beyond those that are told are left out: they come in the order in which they are told, so
    !! each that is told is among the first at every point.
    type(model_t), intent(in) :: model
    type(meetings_t), intent(inout) :: meetings
    integer, intent(in) :: kinds(:)   !! the first of them is told first
    integer, intent(in) :: here(:)    !! conditions of the point, increasing
    integer, intent(in) :: point
    integer :: a, b, kind, n

    n = 0
    do a = 1, size(here) - 1
      do b = a + 1, size(here)
        kind = mechanical_meeting(model, here(a), here(b))
        if (any(kinds == kind)) call book(model, meetings, kind, here(a), here(b), point)
        if (kind == kinds(1)) n = n + 1
        if (n == most) return
      end do
    end do
  end subroutine book_mechanical

  pure logical function differ(a, b)
    !! Do two hydraulic conditions prescribe different things?
    type(hydraulic_condition_t), intent(in) :: a, b

    differ = a%kind /= b%kind .or. abs(a%value - b%value) > 0.0_wp .or. &
             .not. a%pattern%equals(b%pattern)
  end function differ

  pure integer function mechanical_meeting(model, first, second) result(kind)
    !! What two mechanical conditions on one point do to each other.
    type(model_t), intent(in) :: model
    integer, intent(in) :: first, second

    associate (a => model%scene%mechanical_condition(first), &
               b => model%scene%mechanical_condition(second))
      kind = none
      if (.not. (a%is_load() .or. b%is_load())) then
        kind = two_walls
      else if (a%is_load() .and. b%is_load()) then
        if (a%kind == b%kind .and. a%surface /= b%surface) kind = two_loads
      else if (a%is_load()) then
        if (holds_against(b%wall(), a%kind)) kind = idle_load
      else
        if (holds_against(a%wall(), b%kind)) kind = idle_load
      end if
    end associate
  end function mechanical_meeting

  pure logical function holds_against(wall, load)
    !! Does a wall take all of a load, so that the body never feels it?
    type(wall_t), intent(in) :: wall
    character(len=*), intent(in) :: load   !! kind of condition

    holds_against = wall%holds_all .or. (.not. wall%is_plate() .and. &
                                         (load == 'pressure' .or. load == 'reservoir'))
  end function holds_against

  subroutine book(model, meetings, kind, first, second, point)
    !! Counts one point of a meeting.
    type(model_t), intent(in) :: model
    type(meetings_t), intent(inout) :: meetings
    integer, intent(in) :: kind, first, second   !! conditions
    integer, intent(in) :: point
    integer(i8) :: key
    integer :: k, n

    key = (int(kind, i8)*base + int(first, i8))*base + int(second, i8)
    n = meetings%n
    k = findloc(meetings%key(:n), key, dim=1)
    if (k == 0) then
      if (n == size(meetings%key)) then
        meetings%key = [meetings%key, spread(huge(1_i8), 1, n)]
        meetings%id = [meetings%id, spread(0_i8, 1, n)]
        meetings%count = [meetings%count, spread(0, 1, n)]
        meetings%place = reshape(meetings%place, [ndim, 2*n], pad=[0.0_wp])
      end if
      k = n + 1
      meetings%n = k
      meetings%key(k) = key
      meetings%id(k) = huge(1_i8)
      meetings%count(k) = 0
    end if
    meetings%count(k) = meetings%count(k) + 1
    if (model%surface%id(point) >= meetings%id(k)) return
    meetings%id(k) = model%surface%id(point)
    meetings%place(:, k) = model%surface%field(model%s%position)%values(:, point)
  end subroutine book

  function worded(model, key, total, place) result(text)
    !! A meeting in words.
    type(model_t), intent(in) :: model
    integer(i8), intent(in) :: key
    integer, intent(in) :: total            !! points
    real(wp), intent(in) :: place(ndim)     !! of one of them [m]
    character(len=:), allocatable :: text, group, a, b, here
    integer :: first, second, kind

    kind = int(key/base/base)
    first = int(mod(key/base, base))
    second = int(mod(key, base))
    here = to_text(total)//' surface points, e.g. at '// &
           vector_text(place + model%scene%local_origin)//' m'
    if (kind == two_waters) then
      group = '&hydraulic_condition: '
      associate (c => model%scene%hydraulic_condition)
        a = "surface '"//trim(c(first)%surface)//"' ("//trim(c(first)%kind)//')'
        b = "surface '"//trim(c(second)%surface)//"' ("//trim(c(second)%kind)//')'
      end associate
    else
      group = '&mechanical_condition: '
      associate (c => model%scene%mechanical_condition)
        a = "surface '"//trim(c(first)%surface)//"' ("//trim(c(first)%kind)//')'
        b = "surface '"//trim(c(second)%surface)//"' ("//trim(c(second)%kind)//')'
      end associate
    end if
    select case (kind)
    case (two_loads)
      text = group//a//' and '//b//' overlap: their sum acts on '//here
    case (idle_load)
      text = group//a//' and '//b//' name the same points: what is held there does not feel '// &
             'the load on '//here
    case default
      text = group//a//' and '//b//' exclude each other but both name '//here// &
             ': cut one of the surfaces by box_min and box_max'
    end select
  end function worded
end module dosui_surface_overlaps

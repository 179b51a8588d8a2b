!! Everything that is wrong with an input, collected so that the user hears it all at once.
module dosui_problems
  use, intrinsic :: iso_fortran_env, only: error_unit
  use dosui_text, only: to_text
  implicit none
  private

  type :: problem_t
    character(len=:), allocatable :: file      !! path of the input
    integer :: line = 0                        !! 0: concerns the whole file
    character(len=:), allocatable :: group     !! '' outside of groups
    character(len=:), allocatable :: key       !! '' if the group as a whole is meant
    character(len=:), allocatable :: value     !! as written, '' if it does not matter
    character(len=:), allocatable :: reason    !! what is wrong, with the allowed range
    character(len=:), allocatable :: nearest   !! the known name most likely meant, '' if none
  end type problem_t

  type, public :: problems_t
    !! A growing list of problems.
    private
    type(problem_t), allocatable :: item(:)
    integer :: n = 0
  contains
    procedure :: add => problems_add
    procedure :: count => problems_count
    procedure :: line => problems_line
    procedure :: text => problems_text
    procedure :: report => problems_report
  end type problems_t

contains

  subroutine problems_add(self, file, line, group, key, value, reason, nearest)
    !! Appends a problem; lines stay in the order of the file, whole-file problems come last.
    class(problems_t), intent(inout) :: self
    character(len=*), intent(in) :: file
    integer, intent(in) :: line
    character(len=*), intent(in) :: group, key, value, reason
    character(len=*), intent(in), optional :: nearest
    type(problem_t), allocatable :: more(:)
    integer :: k, place

    place = self%n + 1
    do k = self%n, 1, -1
      if (line == 0 .or. (self%item(k)%line <= line .and. self%item(k)%line > 0)) exit
      place = k
    end do
    allocate (more(self%n + 1))
    do k = 1, self%n
      more(merge(k + 1, k, k >= place)) = self%item(k)
    end do
    more(place)%file = file
    more(place)%line = line
    more(place)%group = group
    more(place)%key = key
    more(place)%value = value
    more(place)%reason = reason
    more(place)%nearest = ''
    if (present(nearest)) more(place)%nearest = nearest
    call move_alloc(more, self%item)
    self%n = self%n + 1
  end subroutine problems_add

  pure integer function problems_count(self) result(n)
    !! Problems found so far.
    class(problems_t), intent(in) :: self

    n = self%n
  end function problems_count

  pure integer function problems_line(self, k) result(line)
    !! Line of the k-th problem, 0 if it concerns the whole file.
    class(problems_t), intent(in) :: self
    integer, intent(in) :: k

    line = self%item(k)%line
  end function problems_line

  pure function problems_text(self, k) result(text)
    !! The k-th problem as one line: `scene.nml:12: &material young_modulus = -5: must be > 0 [Pa]`.
    class(problems_t), intent(in) :: self
    integer, intent(in) :: k
    character(len=:), allocatable :: text

    associate (item => self%item(k))
      text = item%file
      if (item%line > 0) text = text//':'//to_text(item%line)
      text = text//': '
      if (len(item%group) > 0) then
        text = text//'&'//item%group
        if (len(item%key) > 0) text = text//' '//item%key
        if (len(item%value) > 0) text = text//' = '//item%value
        text = text//': '
      end if
      text = text//item%reason
      if (len(item%nearest) > 0) text = text//'; did you mean '//item%nearest//'?'
    end associate
  end function problems_text

  subroutine problems_report(self, unit)
    !! Writes all problems, one a line.
    class(problems_t), intent(in) :: self
    integer, intent(in), optional :: unit   !! default: standard error
    integer :: k, target_unit, status

    target_unit = error_unit
    if (present(unit)) target_unit = unit
    do k = 1, self%n
      write (target_unit, '(a)', iostat=status) self%text(k)
      if (status /= 0) return   ! nobody reads
    end do
    flush (target_unit, iostat=status)
    if (status /= 0) return
  end subroutine problems_report
end module dosui_problems

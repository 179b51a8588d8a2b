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
    type(problem_t), allocatable :: item(:)    ! the first n, as they came
    integer, allocatable :: order(:)           ! of them by lines
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
    integer, allocatable :: longer(:)
    integer :: k, place

    if (.not. allocated(self%item)) allocate (self%item(8), self%order(8))
    if (self%n == size(self%item)) then
      allocate (more(2*self%n), longer(2*self%n))
      do k = 1, self%n
        call move_problem(self%item(k), more(k))
      end do
      longer(:self%n) = self%order
      call move_alloc(more, self%item)
      call move_alloc(longer, self%order)
    end if
    place = place_of(self, line)
    do k = self%n, place, -1
      self%order(k + 1) = self%order(k)
    end do
    self%n = self%n + 1
    self%order(place) = self%n
    associate (item => self%item(self%n))
      item%file = file
      item%line = line
      item%group = group
      item%key = key
      item%value = value
      item%reason = reason
      item%nearest = ''
      if (present(nearest)) item%nearest = nearest
    end associate
  end subroutine problems_add

  pure integer function place_of(self, line) result(place)
    !! Where a problem of a line stands: behind those of the same line; line 0 comes last.
    type(problems_t), intent(in) :: self
    integer, intent(in) :: line
    integer :: low, high, middle, other

    low = 1
    high = self%n + 1
    do while (low < high)
      middle = low + (high - low)/2
      other = self%item(self%order(middle))%line
      if (line == 0 .or. (other > 0 .and. other <= line)) then
        low = middle + 1
      else
        high = middle
      end if
    end do
    place = low
  end function place_of

  pure subroutine move_problem(from, to)
    !! Moves a problem without copying its texts.
    type(problem_t), intent(inout) :: from, to

    to%line = from%line
    call move_alloc(from%file, to%file)
    call move_alloc(from%group, to%group)
    call move_alloc(from%key, to%key)
    call move_alloc(from%value, to%value)
    call move_alloc(from%reason, to%reason)
    call move_alloc(from%nearest, to%nearest)
  end subroutine move_problem

  pure integer function problems_count(self) result(n)
    !! Problems found so far.
    class(problems_t), intent(in) :: self

    n = self%n
  end function problems_count

  pure integer function problems_line(self, k) result(line)
    !! Line of the k-th problem, 0 if it concerns the whole file.
    class(problems_t), intent(in) :: self
    integer, intent(in) :: k

    line = self%item(self%order(k))%line
  end function problems_line

  pure function problems_text(self, k) result(text)
    !! The k-th problem as one line: `scene.nml:12: &material young_modulus = -5: must be > 0 [Pa]`.
    class(problems_t), intent(in) :: self
    integer, intent(in) :: k
    character(len=:), allocatable :: text

    associate (item => self%item(self%order(k)))
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

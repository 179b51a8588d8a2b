!! What the user reads while dosui runs: one writer, line by line.
module dosui_log
  use, intrinsic :: iso_fortran_env, only: output_unit, error_unit
  use dosui_name_index, only: name_index_t
  use dosui_text, only: to_text
  implicit none
  private

  type :: warning_t
    character(len=:), allocatable :: text
    integer :: n = 0                      !! how often it was given
  end type warning_t

  type, public :: log_t
    !! Messages of the root rank; the other ranks say nothing (but may call everything).
    private
    logical :: is_root = .false.
    integer :: unit = output_unit         !! of information
    integer :: error_unit = error_unit    !! of warnings and errors
    integer :: n_different = 0                    !! warnings
    type(warning_t), allocatable :: warnings(:)   !! these, in order of appearance
    type(name_index_t) :: index                   !! of their texts
  contains
    procedure :: init => log_init
    procedure :: info => log_info
    procedure :: warning => log_warning
    procedure :: error => log_error
    procedure :: n_warnings => log_n_warnings
    procedure :: summary => log_summary
  end type log_t

contains

  subroutine log_init(self, is_root, unit)
    !! Starts a log without warnings.
    class(log_t), intent(out) :: self
    logical, intent(in) :: is_root          !! does this rank write?
    integer, intent(in), optional :: unit   !! an open file instead of standard output and error

    self%is_root = is_root
    if (present(unit)) then
      self%unit = unit
      self%error_unit = unit
    end if
  end subroutine log_init

  subroutine log_info(self, text)
    !! One line of information on standard output.
    class(log_t), intent(in) :: self
    character(len=*), intent(in) :: text

    if (self%is_root) call write_line(self%unit, text)
  end subroutine log_info

  subroutine log_warning(self, text, detail)
    !! A warning on standard error; counted, and repeated in the closing summary. A warning with
    !! the same text is written only the first time; one with details that change also the 10th,
    !! 100th, ... time.
    class(log_t), intent(inout) :: self
    character(len=*), intent(in) :: text
    character(len=*), intent(in), optional :: detail   !! of this time, follows the text
    character(len=:), allocatable :: line
    integer :: k

    if (.not. self%is_root) return
    line = 'warning: '//text
    if (present(detail)) line = line//detail
    k = self%index%find(text)
    if (k == 0) then
      call append(self, text)
      call write_line(self%error_unit, line)
      return
    end if
    self%warnings(k)%n = self%warnings(k)%n + 1
    if (present(detail) .and. is_power_of_ten(self%warnings(k)%n)) then
      call write_line(self%error_unit, line//' ('//to_text(self%warnings(k)%n)//' times so far)')
    end if
  end subroutine log_warning

  subroutine append(self, text)
    !! Keeps a warning of another text than all before.
    class(log_t), intent(inout) :: self
    character(len=*), intent(in) :: text
    type(warning_t), allocatable :: more(:)
    integer :: k

    if (.not. allocated(self%warnings)) allocate (self%warnings(1))
    if (self%n_different == size(self%warnings)) then
      allocate (more(2*self%n_different))
      do k = 1, self%n_different
        call move_alloc(self%warnings(k)%text, more(k)%text)
        more(k)%n = self%warnings(k)%n
      end do
      call move_alloc(more, self%warnings)
    end if
    self%n_different = self%n_different + 1
    self%warnings(self%n_different)%text = text
    self%warnings(self%n_different)%n = 1
    call self%index%add(text, self%n_different)
  end subroutine append

  pure logical function is_power_of_ten(n)
    !! 10, 100, 1000, ...?
    integer, intent(in) :: n
    integer :: rest

    rest = n
    do while (rest > 1 .and. mod(rest, 10) == 0)
      rest = rest/10
    end do
    is_power_of_ten = rest == 1
  end function is_power_of_ten

  subroutine log_error(self, text)
    !! An error message on standard error; it does not stop anything.
    class(log_t), intent(in) :: self
    character(len=*), intent(in) :: text

    if (self%is_root) call write_line(self%error_unit, 'error: '//text)
  end subroutine log_error

  pure integer function log_n_warnings(self) result(n)
    !! Warnings given so far, repeated ones included (0 on ranks that do not write).
    class(log_t), intent(in) :: self

    n = 0
    if (allocated(self%warnings)) n = sum(self%warnings(:self%n_different)%n)
  end function log_n_warnings

  subroutine log_summary(self)
    !! Repeats the different warnings of the run on standard output.
    class(log_t), intent(in) :: self
    character(len=:), allocatable :: times
    integer :: k

    if (.not. self%is_root .or. self%n_warnings() == 0) return
    call write_line(self%unit, to_text(self%n_warnings())//' warning(s):')
    do k = 1, self%n_different
      times = ''
      if (self%warnings(k)%n > 1) times = ' ('//to_text(self%warnings(k)%n)//' times)'
      call write_line(self%unit, '  '//self%warnings(k)%text//times)
    end do
  end subroutine log_summary

  subroutine write_line(unit, text)
    !! Writes and flushes, so that a pipe or a batch file shows every line at once. A line that
    !! cannot be written (full disk, reader gone) is lost: the run is worth more.
    integer, intent(in) :: unit
    character(len=*), intent(in) :: text
    integer :: status

    write (unit, '(a)', iostat=status) text
    if (status == 0) flush (unit, iostat=status)
    if (status /= 0) return
  end subroutine write_line
end module dosui_log

!! Wall-clock time of the phases of a run.
module dosui_timers
  use dosui_kinds, only: wp, i8
  implicit none
  private

  integer, parameter :: name_length = 48

  type, public :: timers_t
    !! Named stop watches, used by handle.
    integer :: n = 0                                          !! timers
    character(len=name_length), allocatable :: name(:)        !! (n)
    integer(i8), allocatable, private :: ticks(:)             !! (n) accumulated
    integer(i8), allocatable, private :: started(:)           !! (n) at the last start
    logical, allocatable, private :: running(:)               !! (n)
  contains
    procedure :: add => timers_add
    procedure :: start => timers_start
    procedure :: stop => timers_stop
    procedure :: seconds => timers_seconds
    procedure :: reset => timers_reset
  end type timers_t

contains

  integer function timers_add(self, name) result(handle)
    !! Handle of the timer of this name, made when it is new.
    class(timers_t), intent(inout) :: self
    character(len=*), intent(in) :: name

    do handle = 1, self%n
      if (self%name(handle) == name) return
    end do
    if (self%n == 0) allocate (self%name(0), self%ticks(0), self%started(0), self%running(0))
    self%name = [character(len=name_length) :: self%name, name]
    self%ticks = [self%ticks, 0_i8]
    self%started = [self%started, 0_i8]
    self%running = [self%running, .false.]
    self%n = self%n + 1
    handle = self%n
  end function timers_add

  subroutine timers_start(self, handle)
    !! Starts a timer; one that runs already is left alone.
    class(timers_t), intent(inout) :: self
    integer, intent(in) :: handle

    if (self%running(handle)) return
    self%running(handle) = .true.
    call system_clock(self%started(handle))
  end subroutine timers_start

  subroutine timers_stop(self, handle)
    !! Stops a timer and adds the time since its start.
    class(timers_t), intent(inout) :: self
    integer, intent(in) :: handle
    integer(i8) :: now

    if (.not. self%running(handle)) return
    call system_clock(now)
    self%ticks(handle) = self%ticks(handle) + (now - self%started(handle))
    self%running(handle) = .false.
  end subroutine timers_stop

  real(wp) function timers_seconds(self, handle) result(seconds)
    !! Accumulated wall-clock time of a timer, up to now if it runs [s].
    class(timers_t), intent(in) :: self
    integer, intent(in) :: handle
    integer(i8) :: now, rate, ticks

    call system_clock(now, rate)
    ticks = self%ticks(handle)
    if (self%running(handle)) ticks = ticks + (now - self%started(handle))
    seconds = real(ticks, wp)/real(rate, wp)
  end function timers_seconds

  subroutine timers_reset(self)
    !! Sets all timers to zero; running ones go on from now.
    class(timers_t), intent(inout) :: self
    integer(i8) :: now

    if (self%n == 0) return
    call system_clock(now)
    self%ticks = 0_i8
    self%started = now
  end subroutine timers_reset
end module dosui_timers

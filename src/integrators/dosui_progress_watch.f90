!! Watches whether a run with steps of its own choice gets anywhere.
!!
!! Attempts at steps are counted in windows of a thousandth of the run. A window that takes too many
!! of them, with too large a share that had to be repeated, or whose failed steps have shrunk to
!! almost nothing, will not end in anybody's lifetime. Twice the time since the start begins a new
!! window, too. Steps that the user has chosen do not count: they may be as small as they like.
!!
!! Checkpoints hold what the watch remembers, so that a restart ends where the run would have.
!!
!! Failed solutions are dear. Where step after step has some, steps do not grow: a run that would
!! need very many of these is stuck at once.
module dosui_progress_watch
  use dosui_kinds, only: wp
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: window = 1.0e-3_wp       !! of the run [-]
  integer, parameter :: most_attempts = 200       !! in a window, if many of them are repeated
  integer, parameter :: most_failures = 30        !! of solutions in a window: these are costly
  real(wp), parameter :: repeated_share = 0.25_wp    !! of the attempts: fewer are no trouble [-]
  real(wp), parameter :: least_step = 1.0e-9_wp   !! of the run, of solutions that fail [-]
  integer, parameter :: most_vain = 8             !! failures where steps do not grow ...
  integer, parameter :: most_troubled = 3         !! ... more of these steps than of others ...
  real(wp), parameter :: small_step = 2.0e-4_wp   !! ... that are shorter, of what is left ...
  real(wp), parameter :: shrunk = 0.1_wp          !! ... and of the longest attempt [-]
  real(wp), parameter :: least_progress = 1.0e-7_wp  !! of the run, in a full window [-]

  integer, parameter, public :: n_watch_memory = 12   !! numbers that a checkpoint keeps

  type, public :: progress_watch_t
    private
    real(wp) :: length = 0.0_wp      !! of the run [s]
    real(wp) :: origin = 0.0_wp      !! of the run [s]
    real(wp) :: start = 0.0_wp       !! of the window [s]
    real(wp) :: now = 0.0_wp         !! end of the last step [s]
    real(wp) :: smallest = huge(1.0_wp)   !! step whose solution failed in the window [s]
    real(wp) :: step = huge(1.0_wp)  !! the last one that the integrator chose [s]
    integer :: n_troubled = 0        !! steps with failures, less those without
    integer :: n_vain = 0            !! failures since there were none of these steps
    logical :: has_failed = .false.  !! in the present step
    real(wp) :: longest = 0.0_wp     !! attempt [s]
    integer :: n_attempt = 0         !! in the window
    integer :: n_failed = 0          !! of them: without solution
    integer :: n_rejected = 0        !! of them: too inaccurate, or with other surface points
  contains
    procedure :: init => watch_init
    procedure :: accept => watch_accept
    procedure :: reject => watch_reject
    procedure :: fail => watch_fail
    procedure :: is_stuck => watch_is_stuck
    procedure :: describe => watch_describe
    procedure :: memory => watch_memory
    procedure :: recall => watch_recall
  end type progress_watch_t

contains

  subroutine watch_init(self, length, time)
    !! Starts a watch.
    class(progress_watch_t), intent(out) :: self
    real(wp), intent(in) :: length   !! of the run [s]
    real(wp), intent(in) :: time     !! now [s]

    self%length = length
    self%origin = time
    self%start = time
    self%now = time
  end subroutine watch_init

  pure subroutine watch_accept(self, time, is_chosen)
    !! A step has ended.
    class(progress_watch_t), intent(inout) :: self
    real(wp), intent(in) :: time         !! its end [s]
    logical, intent(in) :: is_chosen     !! its length was the integrator's own choice

    if (is_chosen) then
      self%n_attempt = self%n_attempt + 1
      self%step = time - self%now
      self%longest = max(self%longest, self%step)
    end if
    self%n_troubled = max(0, self%n_troubled + merge(1, -1, self%has_failed))
    if (self%n_troubled == 0) self%n_vain = 0
    self%has_failed = .false.
    self%now = time
    ! after loads that come at once steps grow with the time since then: that is progress, too
    if (time - self%start < window*self%length .and. &
        time - self%origin < 2.0_wp*(self%start - self%origin)) return
    self%start = time
    self%smallest = huge(1.0_wp)
    self%n_attempt = 0
    self%n_failed = 0
    self%n_rejected = 0
  end subroutine watch_accept

  pure subroutine watch_reject(self)
    !! An attempt is repeated although it had a solution.
    class(progress_watch_t), intent(inout) :: self

    self%n_attempt = self%n_attempt + 1
    self%n_rejected = self%n_rejected + 1
  end subroutine watch_reject

  pure subroutine watch_fail(self, dt)
    !! An attempt has found no solution.
    class(progress_watch_t), intent(inout) :: self
    real(wp), intent(in) :: dt   !! its step [s]

    self%n_attempt = self%n_attempt + 1
    self%n_failed = self%n_failed + 1
    self%n_vain = self%n_vain + 1
    self%has_failed = .true.
    self%longest = max(self%longest, dt)
    self%smallest = min(self%smallest, dt)
  end subroutine watch_fail

  pure logical function watch_is_stuck(self) result(stuck)
    !! Is there no hope that the run ends?
    class(progress_watch_t), intent(in) :: self
    integer :: repeated

    repeated = self%n_failed + self%n_rejected
    stuck = self%n_failed >= most_failures .or. self%smallest < least_step*self%length
    stuck = stuck .or. (self%n_vain >= most_vain .and. self%n_troubled >= most_troubled .and. &
                        self%step < small_step*(self%length - self%now) .and. &
                        self%step < shrunk*self%longest)
    if (self%n_attempt < most_attempts) return
    stuck = stuck .or. real(repeated, wp) >= repeated_share*real(self%n_attempt, wp) .or. &
            self%now - self%start < least_progress*self%length
  end function watch_is_stuck

  pure function watch_memory(self) result(values)
    !! What a checkpoint keeps of the watch.
    class(progress_watch_t), intent(in) :: self
    real(wp) :: values(n_watch_memory)   !! [s, -]

    values = [self%origin, self%start, self%now, self%smallest, self%step, self%longest, &
              real([self%n_troubled, self%n_vain, merge(1, 0, self%has_failed), self%n_attempt, &
                    self%n_failed, self%n_rejected], wp)]
  end function watch_memory

  pure subroutine watch_recall(self, values)
    !! Takes up the watch of the run that wrote a checkpoint; the end of the run may be another.
    class(progress_watch_t), intent(inout) :: self
    real(wp), intent(in) :: values(n_watch_memory)   !! as from `memory` [s, -]

    self%origin = values(1)
    self%start = values(2)
    self%now = values(3)
    self%smallest = values(4)
    self%step = values(5)
    self%longest = values(6)
    self%n_troubled = nint(values(7))
    self%n_vain = nint(values(8))
    self%has_failed = values(9) > 0.5_wp
    self%n_attempt = nint(values(10))
    self%n_failed = nint(values(11))
    self%n_rejected = nint(values(12))
  end subroutine watch_recall

  function watch_describe(self) result(text)
    !! What the window has seen.
    class(progress_watch_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = 'since t = '//to_text(self%start, 6)//' s '//to_text(self%n_attempt)// &
           ' attempts at a step, '//to_text(self%n_failed)//' without solution, '// &
           to_text(self%n_rejected)//' rejected'
    if (self%n_failed > 0) text = text//', the smallest of '//to_text(self%smallest, 3)//' s'
    if (self%n_vain > self%n_failed) text = text//'; '//to_text(self%n_vain)// &
                                            ' failures in steps that do not grow'
  end function watch_describe
end module dosui_progress_watch

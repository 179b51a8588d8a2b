!! Time steps: named limits, the smallest of which decides, and soft landings on output times.
module dosui_time_control
  use dosui_kinds, only: wp, i8
  use dosui_scene, only: time_t
  use dosui_sort, only: sort_permutation
  implicit none
  private

  integer, parameter :: name_width = 48
  real(wp), parameter :: landing_tolerance = 1.0e-9_wp   !! of a step [-]
  real(wp), parameter :: on_division = 1.0e-7_wp         !! of a step [-]

  type, public :: step_limit_t
    !! One limit of the time step, with the name that the user sees.
    character(len=name_width) :: name = ''
    real(wp) :: dt = huge(1.0_wp)           !! [s]
  end type step_limit_t

  type, public :: time_control_t
    !! The clock of a run.
    real(wp) :: time = 0.0_wp               !! [s]
    real(wp) :: dt = 0.0_wp                 !! current step [s]
    integer(i8) :: step = 0_i8              !! steps done
    integer :: output = 0                   !! outputs written
    real(wp), allocatable :: output_time(:) !! increasing, last one is the end [s]
    type(step_limit_t) :: limit             !! what decided the current step
    logical :: is_even = .false.            !! the step divides the way between two outputs evenly
  contains
    procedure :: init => time_control_init
    procedure :: choose_step => time_control_choose_step
    procedure :: round_step => time_control_round_step
    procedure :: advance => time_control_advance
    procedure :: at_output => time_control_at_output
    procedure :: finished => time_control_finished
  end type time_control_t

contains

  subroutine time_control_init(self, options)
    !! Collects the output times: the given ones, the multiples of the interval, and the end.
    class(time_control_t), intent(inout) :: self
    type(time_t), intent(in) :: options
    real(wp), allocatable :: times(:)
    integer, allocatable :: order(:)
    integer(i8) :: k, n, n_given

    n = 0_i8
    if (options%output_interval > 0.0_wp) then
      n = int(options%end_time/options%output_interval*(1.0_wp + landing_tolerance), i8)
    end if
    n_given = 0_i8
    if (allocated(options%output_times)) n_given = size(options%output_times, kind=i8)
    allocate (times(n_given + n + 1_i8))
    if (n_given > 0_i8) times(:n_given) = options%output_times
    do k = 1_i8, n
      times(n_given + k) = options%output_interval*real(k, wp)
    end do
    times(n_given + n + 1_i8) = options%end_time
    ! positive reals have the order of their bits
    call sort_permutation(transfer(times, [0_i8]), order)
    times = times(order)
    self%output_time = distinct(times, landing_tolerance*options%end_time)
    self%time = 0.0_wp
    self%step = 0_i8
    self%output = 0
  end subroutine time_control_init

  pure function distinct(values, tolerance) result(kept)
    !! Increasing values without those closer than the tolerance to the one kept before.
    real(wp), intent(in) :: values(:)
    real(wp), intent(in) :: tolerance
    real(wp), allocatable :: kept(:)
    logical, allocatable :: is_new(:)
    real(wp) :: last
    integer(i8) :: k

    allocate (is_new(size(values, kind=i8)), source=.false.)
    last = -huge(1.0_wp)
    do k = 1_i8, size(values, kind=i8)
      if (.not. values(k) > last + tolerance) cycle
      is_new(k) = .true.
      last = values(k)
    end do
    kept = pack(values, is_new)
  end function distinct

  pure subroutine time_control_choose_step(self, options, limits)
    !! Takes the smallest limit, then divides the way to the next output into equal steps: the way
    !! from the output before if the clock is on that division, which gives the same step to the
    !! last bit, else the rest of it.
    class(time_control_t), intent(inout) :: self
    type(time_t), intent(in) :: options
    type(step_limit_t), intent(in) :: limits(:)   !! stability limits, already times Courant number
    real(wp) :: remaining, way, even, steps
    integer :: smallest

    smallest = minloc(limits%dt, dim=1)
    self%limit = limits(smallest)
    if (options%time_step > 0.0_wp) then
      self%limit%name = 'time_step of the scene'
      self%limit%dt = options%time_step
    end if
    if (options%largest_step < self%limit%dt) then
      self%limit%name = 'largest_step of the scene'
      self%limit%dt = options%largest_step
    end if
    remaining = self%output_time(self%output + 1) - self%time
    way = self%output_time(self%output + 1)
    if (self%output > 0) way = way - self%output_time(self%output)
    even = way/number_of_steps(way)
    steps = anint(remaining/even)
    self%is_even = steps > 0.5_wp .and. abs(remaining - steps*even) < on_division*even
    self%dt = even
    if (.not. self%is_even) self%dt = remaining/number_of_steps(remaining)

  contains

    pure real(wp) function number_of_steps(length)
      !! Equal steps within the limit that fill a length of time.
      real(wp), intent(in) :: length   !! [s]

      number_of_steps = max(1.0_wp, &
                            aint(length/self%limit%dt*(1.0_wp - landing_tolerance)) + 1.0_wp)
    end function number_of_steps
  end subroutine time_control_choose_step

  pure subroutine time_control_round_step(self)
    !! Rounds the step to 30 binary digits, so that steps that are equal but for round-off are
    !! equal: matrices that contain the step then stay valid, after a restart, too. Even steps are
    !! equal as they are.
    class(time_control_t), intent(inout) :: self

    if (self%is_even) return
    self%dt = set_exponent(anint(fraction(self%dt)*2.0_wp**30)*2.0_wp**(-30), exponent(self%dt))
  end subroutine time_control_round_step

  pure subroutine time_control_advance(self)
    !! Moves the clock by one step, exactly onto an output time when it is reached.
    class(time_control_t), intent(inout) :: self
    real(wp) :: target

    self%step = self%step + 1_i8
    target = self%output_time(self%output + 1)
    self%time = self%time + self%dt
    if (abs(target - self%time) < 1.0e-6_wp*self%dt) self%time = target
  end subroutine time_control_advance

  pure logical function time_control_at_output(self) result(reached)
    !! Has the next output time been reached?
    class(time_control_t), intent(in) :: self

    reached = .false.
    if (self%output < size(self%output_time)) then
      reached = self%time >= self%output_time(self%output + 1)
    end if
  end function time_control_at_output

  pure logical function time_control_finished(self) result(finished)
    !! Have all outputs been written?
    class(time_control_t), intent(in) :: self

    finished = self%output >= size(self%output_time)
  end function time_control_finished
end module dosui_time_control

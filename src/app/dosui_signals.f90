!! Signals. Those that ask for an end (Ctrl-C, a terminal that closes, batch systems before the time
!! limit) raise a flag: the run writes a checkpoint and ends at its next step. Those of failed
!! writes are ignored, so that the write returns an error that can be told.
module dosui_signals
  use, intrinsic :: iso_c_binding, only: c_int, c_intptr_t, c_funptr, c_funloc
  implicit none
  private

  public :: signals_watch, signals_of_writing, signal_received

  integer(c_int), parameter :: sighup = 1, sigint = 2, sigusr1 = 10, sigpipe = 13, sigterm = 15, &
                               sigxcpu = 24, sigxfsz = 25   ! Linux numbers
  integer(c_int), parameter :: asks_to_end(5) = [sighup, sigint, sigusr1, sigterm, sigxcpu]
  integer(c_intptr_t), parameter :: by_default = 0, ignored = 1   ! SIG_DFL, SIG_IGN
  ! A signal handler can reach nothing but a static variable.
  integer(c_int), volatile :: received = 0

  interface
    function c_signal(number, handler) bind(c, name='signal') result(old)
      import :: c_int, c_funptr
      implicit none
      integer(c_int), value :: number
      type(c_funptr), value :: handler
      type(c_funptr) :: old
    end function c_signal
  end interface

contains

  subroutine signals_watch()
    !! Starts to watch. What whoever started the program ignores (nohup: SIGHUP) stays ignored.
    type(c_funptr) :: old
    integer :: k

    do k = 1, size(asks_to_end)
      old = c_signal(asks_to_end(k), c_funloc(on_signal))
      if (transfer(old, ignored) == ignored) old = c_signal(asks_to_end(k), old)
    end do
  end subroutine signals_watch

  subroutine signals_of_writing()
    !! A file larger than allowed, a pipe without reader: errors of the write and no end.
    type(c_funptr) :: old

    old = c_signal(sigxfsz, transfer(ignored, old))
    old = c_signal(sigpipe, transfer(ignored, old))
  end subroutine signals_of_writing

  subroutine on_signal(number) bind(c)
    !! The handler: remembers the signal. A second Ctrl-C ends the program as if nobody watched.
    integer(c_int), value :: number
    type(c_funptr) :: old

    received = number
    if (number == sigint) old = c_signal(number, transfer(by_default, old))
  end subroutine on_signal

  logical function signal_received() result(yes)
    !! Has this rank been asked to end?
    yes = received /= 0
  end function signal_received
end module dosui_signals

!! SIGTERM and SIGUSR1, which batch systems send before the time limit: a flag is raised, and the
!! run writes a checkpoint and ends at its next step.
module dosui_signals
  use, intrinsic :: iso_c_binding, only: c_int, c_funptr, c_funloc
  implicit none
  private

  public :: signals_watch, signal_received

  integer(c_int), parameter :: sigusr1 = 10, sigterm = 15   ! Linux numbers
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
    !! Starts to watch.
    type(c_funptr) :: old

    old = c_signal(sigusr1, c_funloc(on_signal))
    old = c_signal(sigterm, c_funloc(on_signal))
  end subroutine signals_watch

  subroutine on_signal(number) bind(c)
    !! The handler: remembers the signal.
    integer(c_int), value :: number

    received = number
  end subroutine on_signal

  logical function signal_received() result(yes)
    !! Has this rank been asked to end?
    yes = received /= 0
  end function signal_received
end module dosui_signals

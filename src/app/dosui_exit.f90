!! Ending the process with a status: Fortran 2008's `stop` takes constants only.
module dosui_exit
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private

  public :: exit_with, exit_at_once

  interface
    subroutine c_exit(status) bind(c, name='exit')
      import :: c_int
      implicit none
      integer(c_int), value :: status
    end subroutine c_exit
    subroutine posix_exit(status) bind(c, name='_exit')
      import :: c_int
      implicit none
      integer(c_int), value :: status
    end subroutine posix_exit
  end interface

contains

  subroutine exit_with(status)
    !! Ends this process.
    integer, intent(in) :: status   !! exit status, 0 for success

    call c_exit(int(status, c_int))
  end subroutine exit_with

  subroutine exit_at_once(status)
    !! Ends this process without the last words of its libraries.
    integer, intent(in) :: status   !! exit status, 0 for success

    call posix_exit(int(status, c_int))
  end subroutine exit_at_once
end module dosui_exit

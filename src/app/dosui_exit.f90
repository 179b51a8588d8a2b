!! Ending the process with a status: Fortran 2008's `stop` takes constants only.
module dosui_exit
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private

  public :: exit_with

  interface
    subroutine c_exit(status) bind(c, name='exit')
      import :: c_int
      implicit none
      integer(c_int), value :: status
    end subroutine c_exit
  end interface

contains

  subroutine exit_with(status)
    !! Ends this process.
    integer, intent(in) :: status   !! exit status, 0 for success

    call c_exit(int(status, c_int))
  end subroutine exit_with
end module dosui_exit

!! Environment variables that make other libraries behave; what the user has set stays.
module dosui_environment
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char
  implicit none
  private

  public :: suggest_variable, choose_mpi_io

  ! C strings have no length in their interfaces.
  ! allow(C071)
  interface
    integer(c_int) function setenv(name, value, overwrite) bind(c, name='setenv')
      import :: c_int, c_char
      implicit none
      character(kind=c_char), intent(in) :: name(*), value(*)
      integer(c_int), value :: overwrite
    end function setenv
  end interface

contains

  subroutine suggest_variable(name, value)
    !! Sets an environment variable that the user has not set.
    character(len=*), intent(in) :: name, value
    integer(c_int) :: status

    status = setenv(name//c_null_char, value//c_null_char, 0_c_int)
    if (status /= 0) return   ! no memory for it: the programs do without
  end subroutine suggest_variable

  subroutine choose_mpi_io()
    !! Before MPI starts: of Open MPI's two ways to write files the one that takes any path (the
    !! other, ompio, stops at 250 characters with a buffer overflow) and leaves it to its caller to
    !! tell of a full disk. Other MPI libraries ignore this.
    call suggest_variable('OMPI_MCA_io_ompio_priority', '1')
  end subroutine choose_mpi_io
end module dosui_environment

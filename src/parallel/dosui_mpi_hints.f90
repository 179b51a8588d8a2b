!! What other libraries want to know of MPI beside a communicator.
module dosui_mpi_hints
  use mpi_f08, only: MPI_INFO_NULL
  implicit none
  private
  public :: no_mpi_hints

contains

  integer function no_mpi_hints() result(info)
    !! The info handle "no hints for this file", as the integer that HDF5 takes.
    info = MPI_INFO_NULL%MPI_VAL
  end function no_mpi_hints
end module dosui_mpi_hints

!! MPI tests of the test driver: what pFUnit's `pfunit` module offers to the subset we use.
!!
!! One mpiexec starts the largest number of processes that any test of the file asks for; a test
!! for fewer runs on the first ranks while the others wait.
module pfunit
  use mpi_f08, only: MPI_Comm, MPI_Init, MPI_Finalize, MPI_Comm_rank, MPI_Comm_size, &
                     MPI_Comm_split, MPI_Comm_free, MPI_Comm_set_errhandler, MPI_Allreduce, &
                     MPI_COMM_WORLD, MPI_UNDEFINED, MPI_INTEGER, MPI_SUM, MPI_ERRORS_ARE_FATAL
  use funit
  use funit_state, only: begin_tests, begin_test, end_test, report_failure, any_failure, &
                         is_selected, end_process, no_tests_ran, is_speaker, n_failed, n_run
  implicit none
  public
  private :: MPI_Comm, MPI_Init, MPI_Finalize, MPI_Comm_rank, MPI_Comm_size, MPI_Comm_split, &
             MPI_Comm_free, MPI_Comm_set_errhandler, MPI_Allreduce, MPI_COMM_WORLD, &
             MPI_UNDEFINED, MPI_INTEGER, MPI_SUM, MPI_ERRORS_ARE_FATAL
  private :: begin_tests, begin_test, end_test, report_failure, any_failure, is_selected
  private :: end_process, no_tests_ran, is_speaker, n_failed, n_run, failed_ranks

  type :: MpiTestMethod
    !! The argument of an MPI test: its communicator.
    private
    type(MPI_Comm) :: communicator
    integer :: rank = 0
    integer :: size = 1
  contains
    procedure :: getMpiCommunicator
    procedure :: getProcessRank
    procedure :: getNumProcesses
  end type MpiTestMethod

  abstract interface
    subroutine mpi_test(this)
      import :: MpiTestMethod
      class(MpiTestMethod), intent(inout) :: this
    end subroutine mpi_test

    subroutine serial_test()
    end subroutine serial_test
  end interface
  private :: mpi_test, serial_test

contains

  integer function getMpiCommunicator(this) result(handle)
    class(MpiTestMethod), intent(in) :: this

    handle = this%communicator%mpi_val
  end function getMpiCommunicator

  integer function getProcessRank(this) result(rank)
    class(MpiTestMethod), intent(in) :: this

    rank = this%rank
  end function getProcessRank

  integer function getNumProcesses(this) result(size)
    class(MpiTestMethod), intent(in) :: this

    size = this%size
  end function getNumProcesses

  subroutine pfunit_begin(path)
    !! Starts MPI; the tests of one .pf file follow.
    character(len=*), intent(in) :: path
    integer :: rank

    call MPI_Init()
    call MPI_Comm_rank(MPI_COMM_WORLD, rank)
    is_speaker = rank == 0
    call begin_tests(path)
  end subroutine pfunit_begin

  subroutine pfunit_run_serial(name, test)
    !! A test without npes: the first process runs it.
    character(len=*), intent(in) :: name
    procedure(serial_test) :: test
    integer :: rank

    if (.not. is_selected(name)) return
    call MPI_Comm_rank(MPI_COMM_WORLD, rank)
    call begin_test(name, 0, 1)
    if (rank == 0) call test()
    call end_test(failed_ranks())
  end subroutine pfunit_run_serial

  subroutine pfunit_run(name, n_process, test)
    !! A test on the first `n_process` ranks with a communicator of their own.
    character(len=*), intent(in) :: name
    integer, intent(in) :: n_process
    procedure(mpi_test) :: test
    type(MpiTestMethod) :: this
    integer :: rank, size

    if (.not. is_selected(name)) return
    call MPI_Comm_rank(MPI_COMM_WORLD, rank)
    call MPI_Comm_size(MPI_COMM_WORLD, size)
    call begin_test(name, rank, n_process)
    if (n_process > size) then
      if (rank == 0) call report_failure(text='more processes asked for than mpiexec started')
    else
      call MPI_Comm_split(MPI_COMM_WORLD, merge(0, MPI_UNDEFINED, rank < n_process), rank, &
                          this%communicator)
      if (rank < n_process) then
        call MPI_Comm_set_errhandler(this%communicator, MPI_ERRORS_ARE_FATAL)
        this%rank = rank
        this%size = n_process
        call test(this)
        call MPI_Comm_free(this%communicator)
      end if
    end if
    call end_test(failed_ranks())
  end subroutine pfunit_run

  subroutine pfunit_end()
    !! After the last test; does not return.
    logical :: failed

    failed = no_tests_ran()
    failed = n_failed > 0 .or. failed
    call MPI_Finalize()
    ! Only the process that prints fails: mpiexec would kill it before its last line if another one
    ! ended earlier with a status other than 0. Every process counts the same failed tests.
    call end_process(failed .and. is_speaker)
  end subroutine pfunit_end

  integer function failed_ranks() result(n)
    !! On how many ranks the running test has failed.
    integer :: mine

    mine = merge(1, 0, any_failure())
    call MPI_Allreduce(mine, n, 1, MPI_INTEGER, MPI_SUM, MPI_COMM_WORLD)
  end function failed_ranks
end module pfunit

!! What the test driver remembers while tests run, and how a failure is reported.
!!
!! Module variables are right here: a program runs one test at a time and the assertions, which have
!! pFUnit's interface, have no argument that could carry a state.
module funit_state
  use, intrinsic :: iso_fortran_env, only: output_unit
  use, intrinsic :: iso_c_binding, only: c_int, c_funptr, c_funloc
  implicit none
  private

  public :: begin_tests, begin_test, end_test, report_failure, any_failure, is_selected
  public :: end_process, no_tests_ran

  type, public :: SourceLocation
    !! Where an assertion stands in a .pf file.
    character(len=128) :: file = ''
    integer :: line = 0
  end type SourceLocation

  integer, parameter :: failures_shown = 20   !! of one test on one rank

  integer, public :: rank = 0                  !! of the running test's communicator
  integer, public :: n_rank = 1                !! size of that communicator
  integer, public :: n_run = 0                 !! tests begun
  integer, public :: n_failed = 0              !! tests with a failed assertion on this rank
  logical, public :: is_speaker = .true.       !! this process prints the progress
  integer :: n_failure = 0                     !! failed assertions of the running test
  logical :: is_finished = .false.             !! every test has been run to its end
  character(len=:), allocatable :: test_name
  character(len=:), allocatable :: source_path
  character(len=:), allocatable :: selection   !! only tests whose name contains this text

  interface
    integer(c_int) function c_atexit(handler) bind(c, name='atexit')
      import :: c_int, c_funptr
      type(c_funptr), value :: handler
    end function c_atexit

    subroutine c_quit(status) bind(c, name='_exit')
      import :: c_int
      integer(c_int), value :: status
    end subroutine c_quit
  end interface

contains

  subroutine begin_tests(path)
    !! Before the first test: the .pf file's path, for messages.
    character(len=*), intent(in) :: path
    integer :: length
    integer(c_int) :: status

    source_path = trim(path)
    test_name = '(before the first test)'
    call get_command_argument(1, length=length)
    allocate (character(len=length) :: selection)
    if (length > 0) call get_command_argument(1, selection)
    status = c_atexit(c_funloc(early_exit))
  end subroutine begin_tests

  logical function is_selected(name)
    !! Was this test asked for? Without a command argument every test is.
    character(len=*), intent(in) :: name

    is_selected = index(name, selection) > 0
  end function is_selected

  subroutine begin_test(name, my_rank, size)
    character(len=*), intent(in) :: name
    integer, intent(in) :: my_rank, size

    test_name = name
    rank = my_rank
    n_rank = size
    n_failure = 0
    n_run = n_run + 1
    if (is_speaker) then
      write (output_unit, '(a)') 'run   '//test_title()
      flush (output_unit)
    end if
  end subroutine begin_test

  subroutine end_test(failed_ranks)
    !! After a test: how many ranks had a failure.
    integer, intent(in) :: failed_ranks

    if (failed_ranks > 0) n_failed = n_failed + 1
    if (is_speaker .and. failed_ranks > 0) then
      write (output_unit, '(a)') 'FAIL  '//test_title()
      flush (output_unit)
    end if
    test_name = '(between tests)'
  end subroutine end_test

  logical function any_failure()
    !! Has an assertion of the running test failed on this rank?
    any_failure = n_failure > 0
  end function any_failure

  subroutine report_failure(location, text, message)
    !! Prints `path:line: what went wrong` at once, so that a later crash cannot swallow it.
    type(SourceLocation), intent(in), optional :: location
    character(len=*), intent(in) :: text
    character(len=*), intent(in), optional :: message
    character(len=:), allocatable :: line
    character(len=12) :: number

    n_failure = n_failure + 1
    if (n_failure > failures_shown) return
    line = source_path
    if (present(location)) then
      write (number, '(i0)') location%line
      line = line//':'//trim(number)
    end if
    line = line//': '//test_name
    if (n_rank > 1) then
      write (number, '(i0)') rank
      line = line//' (rank '//trim(number)
      write (number, '(i0)') n_rank
      line = line//' of '//trim(number)//')'
    end if
    line = line//': '//text
    if (present(message)) line = line//' -- '//trim(message)
    if (n_failure == failures_shown) line = line//' (further failures of this test are not shown)'
    write (output_unit, '(a)') line
    flush (output_unit)
  end subroutine report_failure

  logical function no_tests_ran()
    no_tests_ran = n_run == 0
    if (no_tests_ran .and. is_speaker) write (output_unit, '(a)') source_path//': no test was run'
  end function no_tests_ran

  subroutine end_process(failed)
    !! Ends the process after the last test: exit status 1 if anything failed, else 0.
    logical, intent(in) :: failed

    is_finished = .true.
    if (is_speaker) then
      if (failed) then
        write (output_unit, '(i0,a,i0,a)') n_failed, ' of ', n_run, ' tests failed'
      else
        write (output_unit, '(a,i0,a)') 'OK: ', n_run, ' tests'
      end if
    end if
    flush (output_unit)
    call c_quit(merge(1_c_int, 0_c_int, failed))
  end subroutine end_process

  subroutine early_exit() bind(c)
    !! A `stop` in the code under test would end the program with status 0: make that a failure.
    if (is_finished) return
    write (output_unit, '(a)') source_path//': '//test_name//': the program ended inside a test'
    flush (output_unit)
    call c_quit(1_c_int)
  end subroutine early_exit

  function test_title() result(title)
    character(len=:), allocatable :: title
    character(len=12) :: number

    write (number, '(i0)') n_rank
    title = test_name//' ['//trim(number)//trim(merge(' rank ', ' ranks', n_rank == 1))//']'
  end function test_title
end module funit_state

!! The table of histories, and its way through the result file.
module test_history
  use pfunit
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_communicator, only: communicator_t
  use dosui_history, only: history_t
  use dosui_result_file, only: result_file_t, result_layout_t
  use dosui_hdf5, only: hid_t, hdf5_file_t, hdf5_open_group, hdf5_close_group, &
                        hdf5_open_dataset, hdf5_close_dataset, hdf5_dataset_shape, &
                        hdf5_read_rows, hdf5_read_attribute
  implicit none

contains

  subroutine start(this, comm, history, layout)
    !! A communicator, two columns, and a file without fields.
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t), intent(inout) :: comm
    type(history_t), intent(inout) :: history
    type(result_layout_t), intent(inout) :: layout
    type(error_t) :: err
    integer :: column

    comm%handle%mpi_val = this%getMpiCommunicator()
    call comm%init(comm%handle)
    call history%add_column('time', 's', column, err)
    call history%add_column('settlement', 'm', column, err)
    layout%n_step_max = 2
    layout%n_point = 3_i8
    allocate (layout%field(0), layout%metadata_name(0), layout%metadata_value(0))
    layout%history = history%column
    layout%history_capacity = 7_i8
    layout%scene_text = ''
    layout%scene_echo = ''
  end subroutine start

  subroutine one_step(comm, result, time, err)
    !! Writes a step of three points of root.
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(inout) :: result
    real(wp), intent(in) :: time
    type(error_t), intent(inout) :: err
    real(wp) :: points(3, 3), values(0, 3)
    integer :: n

    points = 1.0_wp
    n = 0
    if (comm%is_root()) n = 3
    call result%write_step(comm, time, n, [1_i8, 2_i8, 3_i8], points, values, err)
  end subroutine one_step

  subroutine read_column(comm, path, name, n_entries, values, err)
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path, name
    integer(i8), intent(out) :: n_entries
    real(wp), allocatable, intent(out) :: values(:)
    type(error_t), intent(inout) :: err
    type(hdf5_file_t) :: file
    integer(hid_t) :: group, dataset
    integer(i8) :: n_row
    integer :: width

    call file%open(comm, path, .false., err)
    call hdf5_open_group(file%id, 'History', group, err)
    call hdf5_read_attribute(group, 'n_entries', n_entries, err)
    call hdf5_open_dataset(group, name, dataset, err)
    call hdf5_dataset_shape(dataset, width, n_row, err)
    allocate (values(int(n_row)), source=0.0_wp)
    call hdf5_read_rows(dataset, 1_i8, int(n_row), values, err)
    call hdf5_close_dataset(dataset, err)
    call hdf5_close_group(group, err)
    call file%close(err)
  end subroutine read_column

  !@test(npes=[1])
  subroutine columns_have_unique_names(this)
    class(MpiTestMethod), intent(inout) :: this
    type(history_t) :: history
    type(error_t) :: err
    integer :: column

    call history%add_column('time', 's', column, err)
#line 85 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(1, column, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 85) )
  if (anyExceptions()) return
#line 86 "/work/main/tests/unit/io/test_history.pf"
    call history%add_column('head p1', 'm', column, err)
#line 87 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(2, column, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 87) )
  if (anyExceptions()) return
#line 88 "/work/main/tests/unit/io/test_history.pf"
#line 88 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 88) )
  if (anyExceptions()) return
#line 89 "/work/main/tests/unit/io/test_history.pf"
    call history%add_column('time', 's', column, err)
#line 90 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 90) )
  if (anyExceptions()) return
#line 91 "/work/main/tests/unit/io/test_history.pf"
#line 91 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(index(err%message, 'time') > 0, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 91) )
  if (anyExceptions()) return
#line 92 "/work/main/tests/unit/io/test_history.pf"
    call err%clear()
    call history%add_column('a/b', 's', column, err)
#line 94 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 94) )
  if (anyExceptions()) return
#line 95 "/work/main/tests/unit/io/test_history.pf"
#line 95 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(2, history%n_column(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 95) )
  if (anyExceptions()) return
#line 96 "/work/main/tests/unit/io/test_history.pf"
  end subroutine columns_have_unique_names

  !@test(npes=[1])
  subroutine rows_survive_growth(this)
    class(MpiTestMethod), intent(inout) :: this
    type(history_t) :: history
    type(error_t) :: err
    integer :: column, k

    call history%add_column('time', 's', column, err)
    call history%add_column('square', '', column, err)
    do k = 1, 300
      call history%append([real(k, wp), real(k, wp)**2])
    end do
#line 110 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(300, history%n_row, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 110) )
  if (anyExceptions()) return
#line 111 "/work/main/tests/unit/io/test_history.pf"
    do k = 1, 300
#line 112 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(real(k, wp)**2, history%value(2, k), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 112) )
  if (anyExceptions()) return
#line 113 "/work/main/tests/unit/io/test_history.pf"
    end do
    call history%clear()
#line 115 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(0, history%n_row, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 115) )
  if (anyExceptions()) return
#line 116 "/work/main/tests/unit/io/test_history.pf"
    call history%append([7.0_wp, 8.0_wp])
#line 117 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(8.0_wp, history%value(2, 1), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 117) )
  if (anyExceptions()) return
#line 118 "/work/main/tests/unit/io/test_history.pf"
  end subroutine rows_survive_growth

  !@test(npes=[1, 2, 3, 4])
  subroutine written_rows_come_back_and_the_rest_is_nan(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(history_t) :: history
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err
    real(wp), allocatable :: values(:)
    integer(i8) :: n_entries
    integer :: k

    call start(this, comm, history, layout)
    call result%create(comm, 'test_history.vtkhdf', layout, err)
#line 134 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 134) )
  if (anyExceptions()) return
#line 135 "/work/main/tests/unit/io/test_history.pf"
    do k = 1, 3
      if (comm%is_root()) call history%append([0.1_wp*k, -1.0_wp*k])
    end do
    call result%write_history(comm, history, err)
#line 139 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(0, history%n_row, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 139) )
  if (anyExceptions()) return
#line 140 "/work/main/tests/unit/io/test_history.pf"
    call one_step(comm, result, 0.3_wp, err)
    do k = 4, 5
      if (comm%is_root()) call history%append([0.1_wp*k, -1.0_wp*k])
    end do
    call result%write_history(comm, history, err)
    call result%write_history(comm, history, err)
    call result%close(comm, err)
#line 147 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 147) )
  if (anyExceptions()) return
#line 148 "/work/main/tests/unit/io/test_history.pf"
    call read_column(comm, 'test_history.vtkhdf', 'settlement', n_entries, values, err)
#line 149 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 149) )
  if (anyExceptions()) return
#line 150 "/work/main/tests/unit/io/test_history.pf"
#line 150 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(5_i8, n_entries, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 150) )
  if (anyExceptions()) return
#line 151 "/work/main/tests/unit/io/test_history.pf"
#line 151 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(7, size(values), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 151) )
  if (anyExceptions()) return
#line 152 "/work/main/tests/unit/io/test_history.pf"
#line 152 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual([-1.0_wp, -2.0_wp, -3.0_wp, -4.0_wp, -5.0_wp], values(:5), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 152) )
  if (anyExceptions()) return
#line 153 "/work/main/tests/unit/io/test_history.pf"
#line 153 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(all(ieee_is_nan(values(6:))), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 153) )
  if (anyExceptions()) return
#line 154 "/work/main/tests/unit/io/test_history.pf"
  end subroutine written_rows_come_back_and_the_rest_is_nan

  !@test(npes=[1, 3])
  subroutine too_many_rows_are_an_error(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(history_t) :: history
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err, ignored
    integer :: k

    call start(this, comm, history, layout)
    call result%create(comm, 'test_history_full.vtkhdf', layout, err)
    do k = 1, 8
      if (comm%is_root()) call history%append([0.1_wp*k, -1.0_wp*k])
    end do
#line 171 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 171) )
  if (anyExceptions()) return
#line 172 "/work/main/tests/unit/io/test_history.pf"
    call result%write_history(comm, history, err)
#line 173 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 173) )
  if (anyExceptions()) return
#line 174 "/work/main/tests/unit/io/test_history.pf"
    call result%close(comm, ignored)
  end subroutine too_many_rows_are_an_error

  !@test(npes=[1, 2, 4])
  subroutine a_restart_drops_later_rows(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(history_t) :: history
    type(result_layout_t) :: layout
    type(result_file_t) :: result, continued
    type(error_t) :: err
    real(wp), allocatable :: values(:)
    integer(i8) :: n_entries
    integer :: k

    call start(this, comm, history, layout)
    call result%create(comm, 'test_history_restart.vtkhdf', layout, err)
    do k = 1, 6
      if (comm%is_root()) call history%append([0.1_wp*k, 1.0_wp*k])
    end do
    call result%write_history(comm, history, err)
    call one_step(comm, result, 0.2_wp, err)
    call result%close(comm, err)
    call continued%open_existing(comm, 'test_history_restart.vtkhdf', 0.1_wp*4, layout, err)
#line 198 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 198) )
  if (anyExceptions()) return
#line 199 "/work/main/tests/unit/io/test_history.pf"
#line 199 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(4_i8, continued%n_history, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 199) )
  if (anyExceptions()) return
#line 200 "/work/main/tests/unit/io/test_history.pf"
    if (comm%is_root()) call history%append([0.45_wp, 45.0_wp])
    call continued%write_history(comm, history, err)
    call continued%close(comm, err)
    call read_column(comm, 'test_history_restart.vtkhdf', 'settlement', n_entries, values, err)
#line 204 "/work/main/tests/unit/io/test_history.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 204) )
  if (anyExceptions()) return
#line 205 "/work/main/tests/unit/io/test_history.pf"
#line 205 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual(5_i8, n_entries, &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 205) )
  if (anyExceptions()) return
#line 206 "/work/main/tests/unit/io/test_history.pf"
#line 206 "/work/main/tests/unit/io/test_history.pf"
  call assertEqual([1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp, 45.0_wp], values(:5), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 206) )
  if (anyExceptions()) return
#line 207 "/work/main/tests/unit/io/test_history.pf"
#line 207 "/work/main/tests/unit/io/test_history.pf"
  call assertTrue(all(ieee_is_nan(values(6:))), &
 & location=SourceLocation( &
 & 'test_history.pf', &
 & 207) )
  if (anyExceptions()) return
#line 208 "/work/main/tests/unit/io/test_history.pf"
  end subroutine a_restart_drops_later_rows
end module test_history

module Wraptest_history
   use FUnit
   use test_history
   implicit none
   private

contains


end module Wraptest_history

function test_history_suite() result(suite)
   use FUnit
   use test_history
   use Wraptest_history
   implicit none
   type (TestSuite) :: suite

   class (Test), allocatable :: t

   suite = TestSuite('test_history_suite')

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('columns_have_unique_names', &
      columns_have_unique_names, 1))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('rows_survive_growth', &
      rows_survive_growth, 1))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('written_rows_come_back_and_the_rest_is_nan', &
      written_rows_come_back_and_the_rest_is_nan, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('written_rows_come_back_and_the_rest_is_nan', &
      written_rows_come_back_and_the_rest_is_nan, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('written_rows_come_back_and_the_rest_is_nan', &
      written_rows_come_back_and_the_rest_is_nan, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('written_rows_come_back_and_the_rest_is_nan', &
      written_rows_come_back_and_the_rest_is_nan, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('too_many_rows_are_an_error', &
      too_many_rows_are_an_error, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('too_many_rows_are_an_error', &
      too_many_rows_are_an_error, 3))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_drops_later_rows', &
      a_restart_drops_later_rows, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_drops_later_rows', &
      a_restart_drops_later_rows, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_drops_later_rows', &
      a_restart_drops_later_rows, 4))
   call suite%addTest(t)


end function test_history_suite


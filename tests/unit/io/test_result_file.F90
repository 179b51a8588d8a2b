!! The result file read back: order by id, any ranks, any time of death, restarts.
module test_result_file
  use pfunit
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_communicator, only: communicator_t
  use dosui_history, only: history_t, history_column_t
  use dosui_result_file, only: result_file_t, result_layout_t, result_field_t
  use dosui_hdf5, only: hid_t, hdf5_file_t, hdf5_open_group, hdf5_close_group, &
                        hdf5_open_dataset, hdf5_close_dataset, hdf5_dataset_shape, &
                        hdf5_read_rows, hdf5_read_attribute, hdf5_read_text
  implicit none

  integer, parameter :: n_largest = 12   ! points of the first step

contains

  ! ------------------------------------------------------------- a run with known values

  subroutine start(this, comm, layout)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t), intent(inout) :: comm
    type(result_layout_t), intent(inout) :: layout

    comm%handle%mpi_val = this%getMpiCommunicator()
    call comm%init(comm%handle)
    layout%n_step_max = 4
    layout%n_point = int(n_largest, i8)
    layout%field = [result_field_t('pore_pressure', 'Pa', 1), result_field_t('velocity', 'm/s', 3)]
    layout%history = [history_column_t('time', 's')]
    layout%history_capacity = 4_i8
    layout%scene_text = '&scene title = "test" /'
    layout%scene_echo = 'echo'
    allocate (layout%metadata_name(1), layout%metadata_value(1))
    layout%metadata_name = 'git_hash'
    layout%metadata_value = 'cafe'
  end subroutine start

  pure integer function points_in(step) result(n)
    !! Two points are lost every step.
    integer, intent(in) :: step

    n = n_largest - 2*(step - 1)
  end function points_in

  pure integer(i8) function id_of(k, step) result(id)
    !! The ids left in a step, increasing in k: multiples of 5; the smallest is lost first.
    integer, intent(in) :: k, step

    id = 5_i8*(k + step - 1)
  end function id_of

  pure real(wp) function value_of(id, component, step) result(value)
    integer(i8), intent(in) :: id
    integer, intent(in) :: component, step

    value = 1000.0_wp*step + id + 0.125_wp*component
  end function value_of

  pure integer function owner_of(k, step, n_rank) result(rank)
    !! Scattered; in the second step the last rank has all, the others none.
    integer, intent(in) :: k, step, n_rank

    rank = mod(7*k, n_rank)
    if (step == 2) rank = n_rank - 1
  end function owner_of

  subroutine write_known_step(comm, result, step, err)
    !! Each rank passes its points in decreasing order.
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(inout) :: result
    integer, intent(in) :: step
    type(error_t), intent(inout) :: err
    integer(i8) :: id(n_largest)
    real(wp) :: points(3, n_largest), values(4, n_largest)
    integer :: k, n, j

    n = 0
    values = 0.0_wp
    points = 0.0_wp
    do k = points_in(step), 1, -1
      if (owner_of(k, step, comm%size) /= comm%rank) cycle
      n = n + 1
      id(n) = id_of(k, step)
      do j = 1, 3
        points(j, n) = value_of(id(n), -j, step)
      end do
      do j = 1, 4
        values(j, n) = value_of(id(n), j, step)
      end do
    end do
    call result%write_step(comm, 0.5_wp*step, n, id(:n), points(:, :n), values(:, :n), err)
  end subroutine write_known_step

  ! ------------------------------------------------------------- reading back

  integer function steps_in(comm, path, err) result(n_step)
    !! Steps a file shows; -1 if its tables are not exactly as long.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    type(hdf5_file_t) :: file
    integer(hid_t) :: group, dataset
    integer(i8) :: n, n_values, n_counts
    integer :: width

    n_step = -1
    call file%open(comm, path, .false., err)
    if (err%failed()) return
    call hdf5_open_group(file%id, 'VTKHDF/Steps', group, err)
    call hdf5_read_attribute(group, 'NSteps', n, err)
    call hdf5_close_group(group, err)
    call hdf5_open_dataset(file%id, 'VTKHDF/Steps/Values', dataset, err)
    call hdf5_dataset_shape(dataset, width, n_values, err)
    call hdf5_close_dataset(dataset, err)
    call hdf5_open_dataset(file%id, 'VTKHDF/NumberOfPoints', dataset, err)
    call hdf5_dataset_shape(dataset, width, n_counts, err)
    call hdf5_close_dataset(dataset, err)
    call file%close(err)
    if (n == n_values .and. n == n_counts) n_step = int(n)
  end function steps_in

  integer function wrong_numbers(comm, path, step, err) result(n_wrong)
    !! Numbers of a step that differ from the known ones, through the offsets a reader uses.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    integer, intent(in) :: step
    type(error_t), intent(inout) :: err
    type(hdf5_file_t) :: file
    integer(i8) :: offset(4), cell_offset(1), count(4), cells(4), id(n_largest)
    real(wp) :: points(3, n_largest), pressure(n_largest), velocity(3, n_largest), times(4)
    integer :: k, j, n

    n_wrong = -1
    call file%open(comm, path, .false., err)
    if (err%failed()) return
    count = 0_i8
    call read_integers(file, 'NumberOfPoints', 1_i8, step, count, err)
    call read_integers(file, 'Vertices/NumberOfCells', 1_i8, step, cells, err)
    call read_integers(file, 'Steps/PointOffsets', 1_i8, step, offset, err)
    call read_integers(file, 'Steps/PointDataOffsets/velocity', int(step, i8), 1, cell_offset, err)
    call read_reals(file, 'Steps/Values', 1_i8, 1, step, times, err)
    n = int(count(step))
    n_wrong = abs(n - points_in(step)) + int(abs(cells(step) - n) + abs(cell_offset(1) - offset(step)))
    if (n_wrong > 0) return
    call read_integers(file, 'PointData/id', offset(step) + 1_i8, n, id, err)
    call read_reals(file, 'Points', offset(step) + 1_i8, 3, n, points, err)
    call read_reals(file, 'PointData/pore_pressure', offset(step) + 1_i8, 1, n, pressure, err)
    call read_reals(file, 'PointData/velocity', offset(step) + 1_i8, 3, n, velocity, err)
    call file%close(err)
    if (err%failed()) return
    n_wrong = n_wrong + differ(times(step), 0.5_wp*step)
    do k = 1, n
      if (id(k) /= id_of(k, step)) n_wrong = n_wrong + 1
      n_wrong = n_wrong + differ(pressure(k), value_of(id_of(k, step), 1, step))
      do j = 1, 3
        n_wrong = n_wrong + differ(points(j, k), value_of(id_of(k, step), -j, step))
        n_wrong = n_wrong + differ(velocity(j, k), value_of(id_of(k, step), j + 1, step))
      end do
    end do
  end function wrong_numbers

  pure integer function differ(found, expected)
    real(wp), intent(in) :: found, expected

    differ = 1
    if (abs(found - expected) <= 0.0_wp) differ = 0
  end function differ

  subroutine read_integers(file, name, first, n, values, err)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: first
    integer, intent(in) :: n
    integer(i8), intent(inout) :: values(:)
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset

    values = -1_i8
    call hdf5_open_dataset(file%id, 'VTKHDF/'//name, dataset, err)
    call hdf5_read_rows(dataset, first, n, values, err)
    call hdf5_close_dataset(dataset, err)
  end subroutine read_integers

  subroutine read_reals(file, name, first, width, n, values, err)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: first
    integer, intent(in) :: width, n
    real(wp), intent(inout) :: values(width, *)
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset

    values(:, :n) = -1.0_wp
    call hdf5_open_dataset(file%id, 'VTKHDF/'//name, dataset, err)
    call hdf5_read_rows(dataset, first, width, n, values, err)
    call hdf5_close_dataset(dataset, err)
  end subroutine read_reals

  subroutine copy_file(comm, source, destination)
    !! What another process would see of a file at this moment: the state a kill would leave.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: source, destination
    character(len=1), allocatable :: bytes(:)
    integer :: unit, n

    if (comm%is_root()) then
      open (newunit=unit, file=source, access='stream', form='unformatted', action='read')
      inquire (unit=unit, size=n)
      allocate (bytes(n))
      read (unit) bytes
      close (unit)
      open (newunit=unit, file=destination, access='stream', form='unformatted', &
            status='replace', action='write')
      write (unit) bytes
      close (unit)
    end if
    call comm%barrier()
  end subroutine copy_file

  subroutine write_line(comm, path, line)
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path, line
    integer :: unit

    if (comm%is_root()) then
      open (newunit=unit, file=path, status='replace', action='write')
      write (unit, '(a)') line
      close (unit)
    end if
    call comm%barrier()
  end subroutine write_line

  ! ------------------------------------------------------------- tests

  !@test(npes=[1, 2, 3, 4])
  subroutine points_are_stored_by_id_whatever_the_ranks(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err
    integer :: step

    call start(this, comm, layout)
    call result%create(comm, 'test_result.vtkhdf', layout, err)
    do step = 1, 4
      call write_known_step(comm, result, step, err)
    end do
    call result%close(comm, err)
#line 252 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 252) )
  if (anyExceptions()) return
#line 253 "/work/main/tests/unit/io/test_result_file.pf"
#line 253 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(4, steps_in(comm, 'test_result.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 253) )
  if (anyExceptions()) return
#line 254 "/work/main/tests/unit/io/test_result_file.pf"
    do step = 1, 4
#line 255 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(0, wrong_numbers(comm, 'test_result.vtkhdf', step, err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 255) )
  if (anyExceptions()) return
#line 256 "/work/main/tests/unit/io/test_result_file.pf"
    end do
#line 257 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 257) )
  if (anyExceptions()) return
#line 258 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine points_are_stored_by_id_whatever_the_ranks

  !@test(npes=[1, 2, 3, 4])
  subroutine every_completed_step_is_readable_without_a_close(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err
    integer :: step, k

    call start(this, comm, layout)
    call result%create(comm, 'test_result_alive.vtkhdf', layout, err)
    do step = 1, 4
      call write_known_step(comm, result, step, err)
      call copy_file(comm, 'test_result_alive.vtkhdf', 'test_result_dead.vtkhdf')
#line 274 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(step, steps_in(comm, 'test_result_dead.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 274) )
  if (anyExceptions()) return
#line 275 "/work/main/tests/unit/io/test_result_file.pf"
      do k = 1, step
#line 276 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(0, wrong_numbers(comm, 'test_result_dead.vtkhdf', k, err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 276) )
  if (anyExceptions()) return
#line 277 "/work/main/tests/unit/io/test_result_file.pf"
      end do
    end do
    call result%close(comm, err)
#line 280 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 280) )
  if (anyExceptions()) return
#line 281 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine every_completed_step_is_readable_without_a_close

  !@test(npes=[1, 2])
  subroutine the_old_file_stays_until_the_first_step(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err
    character(len=20) :: line
    integer :: unit

    call start(this, comm, layout)
    call write_line(comm, 'test_result_old.vtkhdf', 'last weeks result')
    call result%create(comm, 'test_result_old.vtkhdf', layout, err)
#line 296 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 296) )
  if (anyExceptions()) return
#line 297 "/work/main/tests/unit/io/test_result_file.pf"
    open (newunit=unit, file='test_result_old.vtkhdf', action='read')
    read (unit, '(a)') line
    close (unit)
#line 300 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual('last weeks result', trim(line), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 300) )
  if (anyExceptions()) return
#line 301 "/work/main/tests/unit/io/test_result_file.pf"
    call comm%barrier()
    call write_known_step(comm, result, 1, err)
    call result%close(comm, err)
#line 304 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(1, steps_in(comm, 'test_result_old.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 304) )
  if (anyExceptions()) return
#line 305 "/work/main/tests/unit/io/test_result_file.pf"
#line 305 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 305) )
  if (anyExceptions()) return
#line 306 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine the_old_file_stays_until_the_first_step

  !@test(npes=[1, 2, 3, 4])
  subroutine a_restart_goes_on_in_the_same_file(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result, continued
    type(error_t) :: err
    integer :: step

    call start(this, comm, layout)
    call result%create(comm, 'test_result_restart.vtkhdf', layout, err)
    do step = 1, 3
      call write_known_step(comm, result, step, err)
    end do
    call result%close(comm, err)
    call continued%open_existing(comm, 'test_result_restart.vtkhdf', 0.75_wp, layout, err)
#line 324 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 324) )
  if (anyExceptions()) return
#line 325 "/work/main/tests/unit/io/test_result_file.pf"
#line 325 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(1, continued%n_step, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 325) )
  if (anyExceptions()) return
#line 326 "/work/main/tests/unit/io/test_result_file.pf"
#line 326 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(0.5_wp, continued%last_time, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 326) )
  if (anyExceptions()) return
#line 327 "/work/main/tests/unit/io/test_result_file.pf"
    call copy_file(comm, 'test_result_restart.vtkhdf', 'test_result_dead.vtkhdf')
#line 328 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(1, steps_in(comm, 'test_result_dead.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 328) )
  if (anyExceptions()) return
#line 329 "/work/main/tests/unit/io/test_result_file.pf"
    do step = 2, 4
      call write_known_step(comm, continued, step, err)
#line 331 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 331) )
  if (anyExceptions()) return
#line 332 "/work/main/tests/unit/io/test_result_file.pf"
    end do
    call continued%close(comm, err)
#line 334 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(4, steps_in(comm, 'test_result_restart.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 334) )
  if (anyExceptions()) return
#line 335 "/work/main/tests/unit/io/test_result_file.pf"
    do step = 1, 4
#line 336 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(0, wrong_numbers(comm, 'test_result_restart.vtkhdf', step, err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 336) )
  if (anyExceptions()) return
#line 337 "/work/main/tests/unit/io/test_result_file.pf"
    end do
#line 338 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 338) )
  if (anyExceptions()) return
#line 339 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine a_restart_goes_on_in_the_same_file

  !@test(npes=[1, 2, 3, 4])
  subroutine a_restart_with_more_output_copies_the_kept_steps(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout, longer
    type(result_file_t) :: result, continued
    type(error_t) :: err
    integer :: step

    call start(this, comm, layout)
    longer = layout
    layout%n_step_max = 2
    call result%create(comm, 'test_result_longer.vtkhdf', layout, err)
    do step = 1, 2
      call write_known_step(comm, result, step, err)
    end do
    call result%close(comm, err)
    longer%history = [history_column_t('time', 's'), history_column_t('new', 'm')]
    call continued%open_existing(comm, 'test_result_longer.vtkhdf', 1.0_wp, longer, err)
#line 360 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 360) )
  if (anyExceptions()) return
#line 361 "/work/main/tests/unit/io/test_result_file.pf"
#line 361 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(2, continued%n_step, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 361) )
  if (anyExceptions()) return
#line 362 "/work/main/tests/unit/io/test_result_file.pf"
    do step = 3, 4
      call write_known_step(comm, continued, step, err)
    end do
    call continued%close(comm, err)
#line 366 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(4, steps_in(comm, 'test_result_longer.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 366) )
  if (anyExceptions()) return
#line 367 "/work/main/tests/unit/io/test_result_file.pf"
    do step = 1, 4
#line 368 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(0, wrong_numbers(comm, 'test_result_longer.vtkhdf', step, err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 368) )
  if (anyExceptions()) return
#line 369 "/work/main/tests/unit/io/test_result_file.pf"
    end do
#line 370 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 370) )
  if (anyExceptions()) return
#line 371 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine a_restart_with_more_output_copies_the_kept_steps

  !@test(npes=[1, 2])
  subroutine a_step_of_the_same_time_is_not_stored_twice(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err

    call start(this, comm, layout)
    call result%create(comm, 'test_result_twice.vtkhdf', layout, err)
    call write_known_step(comm, result, 2, err)
    call write_known_step(comm, result, 2, err)
#line 385 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 385) )
  if (anyExceptions()) return
#line 386 "/work/main/tests/unit/io/test_result_file.pf"
#line 386 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(1, result%n_step, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 386) )
  if (anyExceptions()) return
#line 387 "/work/main/tests/unit/io/test_result_file.pf"
    call write_known_step(comm, result, 1, err)
#line 388 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 388) )
  if (anyExceptions()) return
#line 389 "/work/main/tests/unit/io/test_result_file.pf"
    call err%clear()
    call result%close(comm, err)
  end subroutine a_step_of_the_same_time_is_not_stored_twice

  !@test(npes=[1, 3])
  subroutine what_does_not_fit_is_an_error_and_changes_nothing(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err

    call start(this, comm, layout)
    layout%n_step_max = 2
    layout%n_point = 10_i8
    call result%create(comm, 'test_result_full.vtkhdf', layout, err)
    call write_known_step(comm, result, 1, err)
#line 406 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 406) )
  if (anyExceptions()) return
#line 407 "/work/main/tests/unit/io/test_result_file.pf"
    call err%clear()
    call write_known_step(comm, result, 2, err)
    call write_known_step(comm, result, 3, err)
#line 410 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 410) )
  if (anyExceptions()) return
#line 411 "/work/main/tests/unit/io/test_result_file.pf"
    call write_known_step(comm, result, 4, err)
#line 412 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 412) )
  if (anyExceptions()) return
#line 413 "/work/main/tests/unit/io/test_result_file.pf"
    call err%clear()
    call result%close(comm, err)
#line 415 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(2, steps_in(comm, 'test_result_full.vtkhdf', err), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 415) )
  if (anyExceptions()) return
#line 416 "/work/main/tests/unit/io/test_result_file.pf"
#line 416 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 416) )
  if (anyExceptions()) return
#line 417 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine what_does_not_fit_is_an_error_and_changes_nothing

  !@test(npes=[1, 2])
  subroutine errors_name_the_path_and_the_reason(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(error_t) :: err

    call start(this, comm, layout)
    call result%create(comm, 'no_such_folder/result.vtkhdf', layout, err)
#line 429 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 429) )
  if (anyExceptions()) return
#line 430 "/work/main/tests/unit/io/test_result_file.pf"
#line 430 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(index(err%message, 'no_such_folder/result.vtkhdf') > 0, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 430) )
  if (anyExceptions()) return
#line 431 "/work/main/tests/unit/io/test_result_file.pf"
    call err%clear()
    call write_line(comm, 'test_result_text.vtkhdf', 'not a result')
    call result%open_existing(comm, 'test_result_text.vtkhdf', 0.0_wp, layout, err)
#line 434 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 434) )
  if (anyExceptions()) return
#line 435 "/work/main/tests/unit/io/test_result_file.pf"
#line 435 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(index(err%message, 'not an HDF5 file') > 0, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 435) )
  if (anyExceptions()) return
#line 436 "/work/main/tests/unit/io/test_result_file.pf"
    call err%clear()
    layout%field(2)%name = layout%field(1)%name
    call result%create(comm, 'test_result_double.vtkhdf', layout, err)
#line 439 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 439) )
  if (anyExceptions()) return
#line 440 "/work/main/tests/unit/io/test_result_file.pf"
#line 440 "/work/main/tests/unit/io/test_result_file.pf"
  call assertTrue(index(err%message, 'pore_pressure') > 0, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 440) )
  if (anyExceptions()) return
#line 441 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine errors_name_the_path_and_the_reason

  !@test(npes=[1, 4])
  subroutine scene_and_metadata_are_inside(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(result_layout_t) :: layout
    type(result_file_t) :: result
    type(hdf5_file_t) :: file
    type(error_t) :: err
    character(len=:), allocatable :: text, hash
    integer(hid_t) :: group
    integer(i8) :: ranks

    call start(this, comm, layout)
    call result%create(comm, 'test_result_scene.vtkhdf', layout, err)
    call write_known_step(comm, result, 1, err)
    call result%close(comm, err)
    call file%open(comm, 'test_result_scene.vtkhdf', .false., err)
    call hdf5_open_group(file%id, 'Scene', group, err)
    call hdf5_read_text(group, 'text', text, err)
    call hdf5_read_attribute(group, 'git_hash', hash, err)
    call hdf5_read_attribute(group, 'ranks', ranks, err)
    call hdf5_close_group(group, err)
    call file%close(err)
#line 466 "/work/main/tests/unit/io/test_result_file.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 466) )
  if (anyExceptions()) return
#line 467 "/work/main/tests/unit/io/test_result_file.pf"
#line 467 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual('&scene title = "test" /', text, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 467) )
  if (anyExceptions()) return
#line 468 "/work/main/tests/unit/io/test_result_file.pf"
#line 468 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual('cafe', hash, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 468) )
  if (anyExceptions()) return
#line 469 "/work/main/tests/unit/io/test_result_file.pf"
#line 469 "/work/main/tests/unit/io/test_result_file.pf"
  call assertEqual(int(this%getNumProcesses(), i8), ranks, &
 & location=SourceLocation( &
 & 'test_result_file.pf', &
 & 469) )
  if (anyExceptions()) return
#line 470 "/work/main/tests/unit/io/test_result_file.pf"
  end subroutine scene_and_metadata_are_inside
end module test_result_file

module Wraptest_result_file
   use FUnit
   use test_result_file
   implicit none
   private

contains


end module Wraptest_result_file

function test_result_file_suite() result(suite)
   use FUnit
   use test_result_file
   use Wraptest_result_file
   implicit none
   type (TestSuite) :: suite

   class (Test), allocatable :: t

   suite = TestSuite('test_result_file_suite')

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('points_are_stored_by_id_whatever_the_ranks', &
      points_are_stored_by_id_whatever_the_ranks, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('points_are_stored_by_id_whatever_the_ranks', &
      points_are_stored_by_id_whatever_the_ranks, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('points_are_stored_by_id_whatever_the_ranks', &
      points_are_stored_by_id_whatever_the_ranks, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('points_are_stored_by_id_whatever_the_ranks', &
      points_are_stored_by_id_whatever_the_ranks, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('every_completed_step_is_readable_without_a_close', &
      every_completed_step_is_readable_without_a_close, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('every_completed_step_is_readable_without_a_close', &
      every_completed_step_is_readable_without_a_close, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('every_completed_step_is_readable_without_a_close', &
      every_completed_step_is_readable_without_a_close, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('every_completed_step_is_readable_without_a_close', &
      every_completed_step_is_readable_without_a_close, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_old_file_stays_until_the_first_step', &
      the_old_file_stays_until_the_first_step, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_old_file_stays_until_the_first_step', &
      the_old_file_stays_until_the_first_step, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_goes_on_in_the_same_file', &
      a_restart_goes_on_in_the_same_file, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_goes_on_in_the_same_file', &
      a_restart_goes_on_in_the_same_file, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_goes_on_in_the_same_file', &
      a_restart_goes_on_in_the_same_file, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_goes_on_in_the_same_file', &
      a_restart_goes_on_in_the_same_file, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_with_more_output_copies_the_kept_steps', &
      a_restart_with_more_output_copies_the_kept_steps, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_with_more_output_copies_the_kept_steps', &
      a_restart_with_more_output_copies_the_kept_steps, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_with_more_output_copies_the_kept_steps', &
      a_restart_with_more_output_copies_the_kept_steps, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_restart_with_more_output_copies_the_kept_steps', &
      a_restart_with_more_output_copies_the_kept_steps, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_step_of_the_same_time_is_not_stored_twice', &
      a_step_of_the_same_time_is_not_stored_twice, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_step_of_the_same_time_is_not_stored_twice', &
      a_step_of_the_same_time_is_not_stored_twice, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('what_does_not_fit_is_an_error_and_changes_nothing', &
      what_does_not_fit_is_an_error_and_changes_nothing, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('what_does_not_fit_is_an_error_and_changes_nothing', &
      what_does_not_fit_is_an_error_and_changes_nothing, 3))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('errors_name_the_path_and_the_reason', &
      errors_name_the_path_and_the_reason, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('errors_name_the_path_and_the_reason', &
      errors_name_the_path_and_the_reason, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('scene_and_metadata_are_inside', &
      scene_and_metadata_are_inside, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('scene_and_metadata_are_inside', &
      scene_and_metadata_are_inside, 4))
   call suite%addTest(t)


end function test_result_file_suite


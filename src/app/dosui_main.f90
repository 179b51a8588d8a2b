!! The program of one dimension: dosui1d, dosui2d or dosui3d. The launcher `dosui` becomes the one
!! that a scene needs.
program dosui_main
  use dosui_allocator, only: return_large_arrays
  use dosui_build_info, only: build_type, compiler, flags, git_hash, version
  use dosui_checkpoint, only: find_checkpoint
  use dosui_combinations_page, only: combinations_list
  use dosui_command_line, only: command_line_t, read_command_line, usage
  use dosui_communicator, only: communicator_t, parallel_start, parallel_stop
  use dosui_directories, only: make_directory
  use dosui_element_tests, only: element_tests
  use dosui_environment, only: choose_mpi_io
  use dosui_error, only: error_t
  use dosui_exit, only: exit_at_once, exit_with
  use dosui_file_system, only: file_lock_t, lock_file, output_problem, remove_link, &
                               unlock_file, write_output
  use dosui_hdf5, only: hdf5_has_open_files
  use dosui_kinds, only: wp
  use dosui_log, only: log_t
  use dosui_numbers, only: text_as_real
  use dosui_petsc, only: petsc_stop
  use dosui_problems, only: problems_t
  use dosui_run_files, only: checkpoint_path
  use dosui_scene, only: scene_t
  use dosui_scene_reader, only: read_scene
  use dosui_scene_template, only: write_group_docs, write_template
  use dosui_simulation, only: run_scene, status_bad_input, status_failed, status_finished, &
                              to_check, to_find_safety, to_run
  use dosui_signals, only: signals_of_writing
  implicit none

  type(communicator_t) :: comm
  type(command_line_t) :: line
  type(error_t) :: err
  type(log_t) :: log
  character(len=:), allocatable :: text
  integer :: status

  call return_large_arrays()
  call signals_of_writing()
  call choose_mpi_io()
  call parallel_start(comm, err)
  call log%init(comm%is_root())
  call read_command_line(line, err)
  status = status_finished
  if (err%failed()) then
    call log%error(err%message)
    status = status_bad_input
  else if (line%is_help) then
    call log%info(usage())
  else if (line%is_version) then
    call log%info('dosui '//version//' ('//git_hash//', '//build_type//')'//new_line('a')// &
                  'compiler '//compiler//new_line('a')//'flags    '//flags)
  else if (line%is_template) then
    call write_template(text)
    call print_text(text)
  else if (line%is_combinations) then
    call print_text(combinations_list())
  else if (len(line%docs) > 0) then
    if (comm%is_root()) call write_group_docs(line%docs, err)
    call comm%agree(err)
    if (err%failed()) then
      call log%error(err%message)
      status = status_bad_input
    end if
  else
    call run(status)
  end if
  if (comm%any(hdf5_has_open_files())) call exit_at_once(status)   ! of a full disk
  call petsc_stop()
  call parallel_stop()
  call exit_with(status)

contains

  subroutine print_text(text)
    !! Writes a text to the standard output. Collective.
    character(len=*), intent(in) :: text

    if (comm%is_root()) call write_output(text, err)
    call comm%agree(err)
    if (.not. err%failed()) return
    call log%error(err%message)
    status = status_failed
  end subroutine print_text

  subroutine run(status)
    !! Reads and runs the scene of the command line.
    integer, intent(out) :: status
    type(scene_t) :: scene
    type(problems_t) :: problems
    type(file_lock_t) :: lock
    character(len=:), allocatable :: stem
    integer :: purpose

    if (len(line%output) > 0) then
      call read_scene(comm, line%scene, scene, problems, err, line%output, line%is_check)
    else
      call read_scene(comm, line%scene, scene, problems, err, only_check=line%is_check)
    end if
    if (err%failed()) then
      if (comm%is_root()) call problems%report()
      status = status_bad_input
      return
    end if
    if (line%is_elements) then
      call print_elements(scene, status)
      return
    end if
    stem = scene%output%name
    if (len(scene%output%directory) > 0) stem = scene%output%directory//'/'//stem
    if (comm%is_root() .and. len(scene%output%directory) > 0 .and. .not. line%is_check) then
      call make_directory(scene%output%directory, err)
    end if
    call comm%agree(err)
    if (err%failed()) then
      call log%error(err%message)
      status = status_bad_input
      return
    end if
    purpose = to_run
    if (line%is_check) purpose = to_check
    if (line%is_safety) purpose = to_find_safety
    if (comm%is_root() .and. purpose == to_run) call take_files(stem, lock, err)
    call comm%agree(err)
    if (line%is_continued .and. .not. err%failed()) call find_restart(stem, err)
    if (err%failed()) then
      call log%error(err%message)
      status = status_bad_input
      return
    end if
    call run_scene(comm, scene, stem, line%restart, purpose, status)
    if (comm%is_root() .and. purpose == to_run) call remove_link(stem//'.vtkhdf.part')   ! no step
    call unlock_file(lock)
  end subroutine run

  subroutine take_files(stem, lock, err)
    !! The run's files are its own from now on: their names can be had, no other run writes them.
    character(len=*), intent(in) :: stem   !! directory and name without suffix
    type(file_lock_t), intent(inout) :: lock
    type(error_t), intent(inout) :: err
    character(len=20), parameter :: suffix(5) = [character(len=20) :: &
                                                 '.vtkhdf', '.vtkhdf.part', '.restart.h5', &
                                                 '.restart.h5.tmp', '.restart.h5.previous']
    character(len=:), allocatable :: reason
    integer :: k

    reason = ''
    do k = 1, size(suffix)
      reason = output_problem(stem//trim(suffix(k)))
      if (len(reason) > 0) call err%set('cannot write '//stem//trim(suffix(k))//': '//reason)
    end do
    if (.not. err%failed()) call lock_file(lock, stem//'.lock', err)
  end subroutine take_files

  subroutine find_restart(stem, err)
    !! The checkpoint that --continue goes on from.
    character(len=*), intent(in) :: stem    !! of the run's files
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: note

    call find_checkpoint(comm, checkpoint_path(stem), line%restart, note, err)
    if (err%failed()) return
    if (len(line%restart) == 0) call log%info('no checkpoint of this scene: it starts')
    if (len(note) > 0) call log%warning(note//'; the one before it is taken')
  end subroutine find_restart

  subroutine print_elements(scene, status)
    !! Laboratory tests of the scene's soils.
    type(scene_t), intent(in) :: scene
    integer, intent(out) :: status
    character(len=:), allocatable :: table
    real(wp) :: pressure
    character(len=:), allocatable :: reason

    status = status_finished
    reason = ''
    pressure = 1.0e5_wp
    if (len(line%pressure) > 0) call text_as_real(line%pressure, pressure, reason)
    if (len(reason) == 0 .and. .not. pressure > 0.0_wp) reason = 'must be > 0'
    if (len(reason) > 0) then
      call err%set('--elements='//line%pressure//': the pressure '//reason//' [Pa]')
    else
      call element_tests(scene, pressure, table, err)
      if (comm%is_root()) call write_output(table, err)
    end if
    if (.not. err%failed()) return
    call log%error(err%message)
    status = status_bad_input
  end subroutine print_elements
end program dosui_main

!! The program of one dimension: dosui1d, dosui2d or dosui3d. The launcher `dosui` becomes the one
!! that a scene needs.
program dosui_main
  use, intrinsic :: iso_fortran_env, only: output_unit
  use dosui_allocator, only: return_large_arrays
  use dosui_build_info, only: build_type, compiler, flags, git_hash, version
  use dosui_checkpoint, only: find_checkpoint
  use dosui_command_line, only: command_line_t, read_command_line, usage
  use dosui_communicator, only: communicator_t, parallel_start, parallel_stop
  use dosui_directories, only: make_directory
  use dosui_element_tests, only: element_tests
  use dosui_error, only: error_t
  use dosui_exit, only: exit_with
  use dosui_kinds, only: wp
  use dosui_log, only: log_t
  use dosui_petsc, only: petsc_stop
  use dosui_problems, only: problems_t
  use dosui_run_files, only: checkpoint_path
  use dosui_scene, only: scene_t
  use dosui_scene_reader, only: read_scene
  use dosui_scene_template, only: write_group_docs, write_template
  use dosui_simulation, only: run_scene, status_bad_input, status_finished, to_check, &
                              to_find_safety, to_run
  implicit none

  type(communicator_t) :: comm
  type(command_line_t) :: line
  type(error_t) :: err
  type(log_t) :: log
  character(len=:), allocatable :: template
  integer :: status

  call return_large_arrays()
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
    call write_template(template)
    if (comm%is_root()) write (output_unit, '(a)', advance='no') template
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
  call petsc_stop()
  call parallel_stop()
  call exit_with(status)

contains

  subroutine run(status)
    !! Reads and runs the scene of the command line.
    integer, intent(out) :: status
    type(scene_t) :: scene
    type(problems_t) :: problems
    character(len=:), allocatable :: stem
    integer :: purpose

    if (len(line%output) > 0) then
      call read_scene(comm, line%scene, scene, problems, err, line%output)
    else
      call read_scene(comm, line%scene, scene, problems, err)
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
    if (line%is_continued) then
      call find_restart(stem, err)
      if (err%failed()) then
        call log%error(err%message)
        status = status_bad_input
        return
      end if
    end if
    call run_scene(comm, scene, stem, line%restart, purpose, status)
  end subroutine run

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
    integer :: failure

    status = status_finished
    failure = 0
    pressure = 1.0e5_wp
    if (len(line%pressure) > 0) read (line%pressure, *, iostat=failure) pressure
    if (failure /= 0 .or. .not. (pressure > 0.0_wp .and. pressure < huge(1.0_wp))) then
      call err%set('--elements='//line%pressure//': the pressure must be > 0 [Pa]')
    else
      call element_tests(scene, pressure, table, err)
      if (comm%is_root()) write (output_unit, '(a)', advance='no') table
    end if
    if (.not. err%failed()) return
    call log%error(err%message)
    status = status_bad_input
  end subroutine print_elements
end program dosui_main

!! Says how large a scene is before it runs, and warns of what takes much of the machine.
module dosui_size_report
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_directories, only: existing_folder
  use dosui_machine, only: bytes_text, free_disk, free_memory
  use dosui_model, only: model_t
  use dosui_scene_sizes, only: scene_sizes_t, sizes_of
  use dosui_text, only: to_text
  implicit none
  private

  public :: report_sizes

  real(wp), parameter :: much = 0.1_wp   !! of what is free [-]

contains

  subroutine report_sizes(model, in_full)
    !! Warnings, and the whole estimate if it is asked for. Collective.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: in_full
    type(scene_sizes_t) :: sizes
    real(wp) :: memory, free, disk

    sizes = sizes_of(model%scene, model%comm%size)
    memory = sizes%memory/real(model%comm%size, wp)
    free = model%comm%minimum(free_memory()/real(model%comm%ranks_on_node(), wp))
    disk = free_disk(existing_folder(model%scene%output%directory))
    call report_origin(model)
    if (in_full) then
      call model%log%info('estimate     '//to_text(sizes%particles, 3)//' particles, '// &
                          to_text(sizes%surface_points, 3)//' surface points, '// &
                          bytes_text(memory)//' of memory on each rank'//of_free(free))
      call model%log%info('estimate     '//to_text(sizes%outputs, 6)//' outputs: '// &
                          bytes_text(sizes%result_bytes)//', '//to_text(sizes%rows, 3)// &
                          ' history rows: '//bytes_text(sizes%history_bytes)// &
                          ', a checkpoint: '//bytes_text(sizes%checkpoint_bytes)//of_free(disk))
    end if
    if (free >= 0.0_wp .and. memory > much*free) then
      call model%log%warning('the run will need about '//bytes_text(memory)// &
                             ' of memory on each rank'//of_free(free))
    end if
    if (disk >= 0.0_wp .and. sizes%disk() > much*disk) then
      call model%log%warning('the files of the run will take about '//bytes_text(sizes%disk())// &
                             of_free(disk))
    end if
  end subroutine report_sizes

  subroutine report_origin(model)
    !! Where coordinates count from in a scene far away.
    type(model_t), intent(inout) :: model
    character(len=:), allocatable :: text
    integer :: d

    if (.not. any(abs(model%scene%local_origin) > 0.0_wp)) return
    text = ''
    do d = 1, ndim
      if (d > 1) text = text//', '
      text = text//to_text(model%scene%local_origin(d))
    end do
    call model%log%info('local origin ('//text//') m: the run counts from there, files do not')
  end subroutine report_origin

  function of_free(bytes) result(text)
    !! What is free, if that is known.
    real(wp), intent(in) :: bytes
    character(len=:), allocatable :: text

    text = ''
    if (bytes >= 0.0_wp) text = ' ('//bytes_text(bytes)//' free)'
  end function of_free
end module dosui_size_report

!! Refuses scenes that no run could finish: coordinates that doubles do not resolve, and sizes that
!! memory, disk or formats do not hold. All is found from the numbers in the file.
module dosui_scene_limits
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_directories, only: existing_folder
  use dosui_keys, only: largest_index
  use dosui_local_origin, only: resolved_to, scene_bounds
  use dosui_machine, only: bytes_text, free_disk, free_memory
  use dosui_namelist, only: namelist_t
  use dosui_problems, only: problems_t
  use dosui_scene, only: scene_t
  use dosui_scene_sizes, only: region_particles, scene_sizes_t, sizes_of
  use dosui_seeding, only: grid_reach, most_sites, region_spacing
  use dosui_shapes, only: region_bounds, shape_bounds
  use dosui_text, only: to_text
  implicit none
  private

  public :: check_coordinates, check_reach, check_sizes

  real(wp), parameter :: most_outputs = 1.0e7_wp    !! of a result file
  real(wp), parameter :: most_rows = 1.0e10_wp      !! of its histories
  real(wp), parameter :: large_region = 1.0e3_wp    !! side that may be meant in millimetres [m]

contains

  subroutine complain(namelist, problems, group, instance, key, reason)
    !! Adds a problem at the line of a key, or of its group if the key is not given.
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in) :: group, key, reason
    integer, intent(in) :: instance
    integer :: g, k

    g = namelist%find(group, instance)
    if (g == 0) then
      call problems%add(namelist%file, 0, group, key, '', reason)
      return
    end if
    k = namelist%group(g)%find(key)
    if (k == 0) then
      call problems%add(namelist%file, namelist%group(g)%line, group, key, '', reason)
    else
      associate (given => namelist%group(g)%key(k))
        call problems%add(namelist%file, given%line, group, key, given%shown(), reason)
      end associate
    end if
  end subroutine complain

  pure function place_key(scene, r) result(key)
    !! The key that says how far a region reaches.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r   !! region
    character(len=:), allocatable :: key

    key = 'box_max'
    if (scene%region(r)%shape == 'polygon') key = 'vertices'
    if (scene%region(r)%shape == 'circle' .or. scene%region(r)%shape == 'sphere') key = 'radius'
    if (scene%region(r)%shape == 'stl') key = 'stl_file'
  end function place_key

  ! ---------------------------------------------------------------- coordinates

  subroutine check_coordinates(scene, namelist, problems)
    !! Can doubles tell the cells apart, where grid and bodies are? Bodies of files count once they
    !! have been read.
    type(scene_t), intent(in) :: scene
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    character(len=:), allocatable :: reason
    real(wp) :: limit, low(ndim), high(ndim)
    integer :: r

    limit = resolved_to(scene%grid_spacing)
    reason = 'coordinates must stay below '//to_text(limit, 3)//' m, else doubles do not '// &
             'resolve cells of '//to_text(scene%grid_spacing)//' m'
    if (any(abs(scene%grid_origin) > limit)) then
      call complain(namelist, problems, 'grid', 1, 'origin', reason)
    end if
    if (any(scene%grid_period > real(largest_index, wp)*scene%grid_spacing)) then
      call complain(namelist, problems, 'grid', 1, 'period', 'must be at most '// &
                    to_text(largest_index)//' cells')
    end if
    do r = 1, size(scene%region)
      if (scene%region(r)%shape == 'stl') cycle
      call region_bounds(scene%region(r), low, high)
      if (any(abs(low) > limit .or. abs(high) > limit .or. abs(scene%region(r)%pivot) > limit)) then
        call complain(namelist, problems, 'region', r, place_key(scene, r), reason)
      end if
    end do
  end subroutine check_coordinates

  subroutine check_reach(scene, namelist, problems)
    !! Do all bodies lie within the reach of the grid about the scene's local origin?
    type(scene_t), intent(in) :: scene
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    real(wp) :: reach, low(ndim), high(ndim)
    integer :: r

    call scene_bounds(scene, low, high)
    reach = grid_reach(scene)
    if (all(max(abs(low), abs(high)) <= reach .and. &
            max(abs(low - scene%grid_origin), abs(high - scene%grid_origin)) <= reach)) return
    do r = 1, size(scene%region)
      if (scene%region(r)%shape == 'stl' .and. .not. allocated(scene%region(r)%body)) cycle
      call region_bounds(scene%region(r), low, high)
      if (all(max(abs(low), abs(high)) <= reach .and. &
              max(abs(low - scene%grid_origin), abs(high - scene%grid_origin)) <= reach)) cycle
      call complain(namelist, problems, 'region', r, place_key(scene, r), &
                    'the grid reaches '//to_text(reach, 3)//' m ('//to_text(largest_index)// &
                    ' cells) from the middle of all regions, and not to here: larger cells, '// &
                    'or scenes of their own for bodies so far apart')
    end do
  end subroutine check_reach

  ! ---------------------------------------------------------------- sizes

  subroutine check_sizes(comm, scene, namelist, problems)
    !! Refuses what the machine does not hold. Collective.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    type(scene_sizes_t) :: sizes
    character(len=:), allocatable :: needed
    real(wp) :: memory, disk
    integer :: n_problem

    sizes = sizes_of(scene, comm%size)
    memory = comm%minimum(free_memory()/real(comm%ranks_on_node(), wp))
    disk = free_disk(existing_folder(scene%output%directory))
    call comm%broadcast(disk)
    n_problem = problems%count()
    if (sizes%outputs > most_outputs) then
      call complain(namelist, problems, 'time', 1, output_key(scene), 'asks for about '// &
                    to_text(sizes%outputs, 2)//' outputs: a file holds '//to_text(most_outputs))
    end if
    if (sizes%rows - sizes%outputs > most_rows) then
      call complain(namelist, problems, 'output', 1, 'history_interval', 'asks for about '// &
                    to_text(sizes%rows, 2)//' rows of histories, '// &
                    bytes_text(sizes%history_bytes)//': a file holds '//to_text(most_rows))
    end if
    if (problems%count() > n_problem) return
    if (sizes%sites > most_sites*real(comm%size, wp)) then
      call complain_of_particles(scene, sizes, namelist, problems, 'more than '// &
                                 to_text(most_sites)//' lattice sites on a rank')
    else if (memory >= 0.0_wp .and. sizes%memory/real(comm%size, wp) > memory) then
      needed = bytes_text(sizes%memory/real(comm%size, wp))
      call complain_of_particles(scene, sizes, namelist, problems, needed//' of memory on each '// &
                                 'rank, and '//bytes_text(memory)//' are free')
    end if
    if (problems%count() > n_problem) return
    if (disk >= 0.0_wp .and. sizes%disk() > disk) then
      call complain_of_files(scene, sizes, namelist, problems, disk)
    end if
  end subroutine check_sizes

  pure function output_key(scene) result(key)
    !! The key that asks for most outputs.
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: key

    key = 'output_times'
    if (.not. scene%time%output_interval > 0.0_wp) return
    if (scene%time%end_time/scene%time%output_interval > &
        real(size(scene%time%output_times), wp)) key = 'output_interval'
  end function output_key

  subroutine complain_of_particles(scene, sizes, namelist, problems, what)
    !! At the largest region: its spacing, its size or the grid's spacing will be wrong.
    type(scene_t), intent(in) :: scene
    type(scene_sizes_t), intent(in) :: sizes
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    character(len=*), intent(in) :: what   !! that is not there
    character(len=:), allocatable :: text
    real(wp) :: particles, sites, most, low(ndim), high(ndim)
    integer :: r, largest, d

    largest = 1
    most = -1.0_wp
    do r = 1, size(scene%region)
      call region_particles(scene, scene%region(r), particles, sites)
      if (max(particles, sites) <= most) cycle
      most = max(particles, sites)
      largest = r
    end do
    associate (region => scene%region(largest))
      call shape_bounds(region, region%shape_angle, low, high)
      text = "region '"//trim(region%name)//"' of "
      do d = 1, ndim
        if (d > 1) text = text//' x '
        text = text//to_text(high(d) - low(d), 4)
      end do
      text = text//' m with particles '//to_text(region_spacing(scene, region), 3)// &
             ' m apart: about '//to_text(sizes%particles, 2)//' particles in all, '//what// &
             '; check sizes, units and spacings'
      if (region%particle_spacing > 0.0_wp) then
        call complain(namelist, problems, 'region', largest, 'particle_spacing', text)
      else if (maxval(high - low) >= large_region) then
        call complain(namelist, problems, 'region', largest, place_key(scene, largest), text)
      else
        call complain(namelist, problems, 'grid', 1, 'spacing', text)
      end if
    end associate
  end subroutine complain_of_particles

  subroutine complain_of_files(scene, sizes, namelist, problems, disk)
    !! Files that the disk does not hold.
    type(scene_t), intent(in) :: scene
    type(scene_sizes_t), intent(in) :: sizes
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    real(wp), intent(in) :: disk   !! [B]

    if (sizes%history_bytes > sizes%result_bytes) then
      call complain(namelist, problems, 'output', 1, 'history_interval', 'asks for about '// &
                    to_text(sizes%rows, 2)//' rows of histories, '// &
                    bytes_text(sizes%history_bytes)//': the disk has '//bytes_text(disk)//' free')
    else
      call complain(namelist, problems, 'time', 1, output_key(scene), 'about '// &
                    to_text(sizes%outputs, 2)//' outputs of '//to_text(sizes%particles, 2)// &
                    ' particles take '//bytes_text(sizes%result_bytes)//': the disk has '// &
                    bytes_text(disk)//' free')
    end if
  end subroutine complain_of_files
end module dosui_scene_limits

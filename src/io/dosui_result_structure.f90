!! What a result file holds, and how an empty one is built.
module dosui_result_structure
  use dosui_kinds, only: i8
  use dosui_error, only: error_t
  use dosui_dimension, only: ndim
  use dosui_checksum, only: checksum_t
  use dosui_communicator, only: communicator_t
  use dosui_history, only: history_column_t
  use dosui_hdf5, only: hid_t, hdf5_real, hdf5_integer, hdf5_create_group, hdf5_close_group, &
                        hdf5_create_dataset, hdf5_close_dataset, hdf5_write_rows, &
                        hdf5_write_attribute, hdf5_write_text, hdf5_create_hard_link
  use dosui_result_rows, only: write_sequence, write_nan
  implicit none
  private

  public :: check_layout, build_histories, build_scene, build_twins, build_checksums, &
            summed_names, text_sum

  character(len=*), parameter, public :: twin_name(2) = ['a', 'b']
  ! checksums of a step: of time and place, ids, points, then of each field
  integer, parameter, public :: sum_place = 1, sum_ids = 2, sum_points = 3, n_first_sum = 3

  type, public :: result_field_t
    !! A quantity stored for every point.
    character(len=64) :: name = ''
    character(len=16) :: unit = ''
    integer :: n_components = 1     !! 1, 3 (vectors) or 6 (xx, yy, zz, xy, yz, zx)
  end type result_field_t

  type, public :: result_layout_t
    !! What a result file holds; equal on all ranks.
    integer :: n_step_max = 0                       !! output steps there is room for
    integer(i8) :: n_point = 0_i8                   !! points a step on all ranks, at most
    type(result_field_t), allocatable :: field(:)
    type(history_column_t), allocatable :: history(:)
    integer(i8) :: history_capacity = 0_i8          !! rows of the histories there is room for
    character(len=:), allocatable :: scene_text     !! the namelist as read
    character(len=:), allocatable :: scene_echo     !! every key with the value in force
    character(len=64), allocatable :: metadata_name(:)     !! e.g. 'git_hash'; attributes of /Scene
    character(len=256), allocatable :: metadata_value(:)
  end type result_layout_t

contains

  subroutine check_layout(layout, err)
    type(result_layout_t), intent(in) :: layout
    type(error_t), intent(inout) :: err
    integer :: k, j

    if (layout%n_step_max < 1) call err%set('a result file needs room for one step at least')
    if (.not. (allocated(layout%field) .and. allocated(layout%history) .and. &
               allocated(layout%metadata_name) .and. allocated(layout%metadata_value))) then
      call err%set('the layout of the result file is incomplete')
      return
    end if
    if (layout%history_capacity < 0_i8) call err%set('negative number of history rows')
    do k = 1, size(layout%field)
      if (layout%field(k)%n_components < 1) call err%set('a result field has no components')
      if (layout%field(k)%name == 'id') call err%set("the result field 'id' is always written")
      do j = 1, k - 1
        if (layout%field(j)%name == layout%field(k)%name) then
          call err%set("two result fields are called '"//trim(layout%field(k)%name)//"'")
        end if
      end do
    end do
  end subroutine check_layout

  subroutine build_histories(layout, comm, group, err)
    !! One dataset a history, filled with NaN.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: group
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset
    integer :: k

    do k = 1, size(layout%history)
      call hdf5_create_dataset(group, trim(layout%history(k)%name), hdf5_real, 1, &
                               layout%history_capacity, dataset, err)
      call hdf5_write_attribute(dataset, 'unit', trim(layout%history(k)%unit), err)
      if (comm%is_root()) call write_nan(dataset, 1_i8, layout%history_capacity, err)
      call hdf5_close_dataset(dataset, err)
    end do
  end subroutine build_histories

  subroutine build_scene(layout, comm, file, err)
    !! The scene's text, what was made of it, and where the result comes from.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: file
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group
    integer :: k

    call hdf5_create_group(file, 'Scene', group, err)
    call hdf5_write_attribute(group, 'ndim', int(ndim, i8), err)
    call hdf5_write_attribute(group, 'ranks', int(comm%size, i8), err)
    do k = 1, size(layout%metadata_name)
      call hdf5_write_attribute(group, trim(layout%metadata_name(k)), &
                                trim(layout%metadata_value(k)), err)
    end do
    call hdf5_write_text(group, 'text', layout%scene_text, comm%is_root(), err)
    call hdf5_write_text(group, 'echo', layout%scene_echo, comm%is_root(), err)
    call hdf5_close_group(group, err)
  end subroutine build_scene

  subroutine build_twins(layout, comm, file, err)
    !! /Commits/a with everything, /Commits/b sharing all of it that need not exist twice.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: file
    type(error_t), intent(inout) :: err
    character(len=9), parameter :: shared(6) = ['Points   ', 'PointData', 'Vertices ', &
                                                'Lines    ', 'Polygons ', 'Strips   ']
    character(len=21), parameter :: shared_steps(6) = ['PartOffsets          ', &
                                                       'NumberOfParts        ', &
                                                       'PointOffsets         ', &
                                                       'CellOffsets          ', &
                                                       'ConnectivityIdOffsets', &
                                                       'PointDataOffsets     ']
    integer(hid_t) :: commits, first, second, first_steps, second_steps
    integer :: k

    call hdf5_create_group(file, 'Commits', commits, err)
    call build_twin(layout, commits, 1, first, first_steps, err)
    call build_twin(layout, commits, 2, second, second_steps, err)
    call build_points(layout, first, err)
    call build_cells(layout, comm, first, err)
    call build_step_tables(layout, comm, first_steps, err)
    do k = 1, size(shared)
      call hdf5_create_hard_link(first, trim(shared(k)), second, trim(shared(k)), err)
    end do
    do k = 1, size(shared_steps)
      call hdf5_create_hard_link(first_steps, trim(shared_steps(k)), second_steps, &
                                 trim(shared_steps(k)), err)
    end do
    call hdf5_close_group(first_steps, err)
    call hdf5_close_group(second_steps, err)
    call hdf5_close_group(first, err)
    call hdf5_close_group(second, err)
    call hdf5_close_group(commits, err)
  end subroutine build_twins

  subroutine build_twin(layout, parent, twin, group, steps, err)
    type(result_layout_t), intent(in) :: layout
    integer(hid_t), intent(in) :: parent
    integer, intent(in) :: twin
    integer(hid_t), intent(out) :: group, steps
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset
    integer(i8) :: n_step

    n_step = int(layout%n_step_max, i8)
    call hdf5_create_group(parent, twin_name(twin), group, err)
    call hdf5_write_attribute(group, 'Version', [2_i8, 0_i8], err)
    call hdf5_write_attribute(group, 'Type', 'PolyData', err)
    call hdf5_write_attribute(group, 'twin', int(twin, i8), err)
    call hdf5_create_group(group, 'Steps', steps, err)
    call hdf5_write_attribute(steps, 'NSteps', 0_i8, err)
    call hdf5_create_dataset(group, 'NumberOfPoints', hdf5_integer, 1, 1_i8, dataset, err, &
                             n_row_max=n_step)
    call hdf5_close_dataset(dataset, err)
    call hdf5_create_dataset(steps, 'Values', hdf5_real, 1, 1_i8, dataset, err, n_row_max=n_step)
    call hdf5_write_attribute(dataset, 'unit', 's', err)
    call hdf5_close_dataset(dataset, err)
  end subroutine build_twin

  subroutine build_points(layout, parent, err)
    !! Positions and fields of all steps, one after the other.
    type(result_layout_t), intent(in) :: layout
    integer(hid_t), intent(in) :: parent
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset, group
    integer(i8) :: n_row
    integer :: k

    n_row = layout%n_point*layout%n_step_max
    call hdf5_create_dataset(parent, 'Points', hdf5_real, 3, n_row, dataset, err)
    call hdf5_write_attribute(dataset, 'unit', 'm', err)
    call hdf5_close_dataset(dataset, err)
    call hdf5_create_group(parent, 'PointData', group, err)
    call hdf5_create_dataset(group, 'id', hdf5_integer, 1, n_row, dataset, err)
    call hdf5_close_dataset(dataset, err)
    do k = 1, size(layout%field)
      call hdf5_create_dataset(group, trim(layout%field(k)%name), hdf5_real, &
                               layout%field(k)%n_components, n_row, dataset, err)
      call hdf5_write_attribute(dataset, 'unit', trim(layout%field(k)%unit), err)
      call hdf5_close_dataset(dataset, err)
    end do
    call hdf5_close_group(group, err)
  end subroutine build_points

  subroutine build_cells(layout, comm, parent, err)
    !! One vertex a point. All steps share the connectivity, but have their own offsets: VTK 9.3
    !! skips the offsets of earlier steps in any case.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: parent
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group, counts, offsets, connectivity
    integer(i8), allocatable :: zero(:)

    allocate (zero(layout%n_step_max), source=0_i8)
    call hdf5_create_group(parent, 'Vertices', group, err)
    call hdf5_create_dataset(group, 'NumberOfCells', hdf5_integer, 1, size(zero, kind=i8), &
                             counts, err)
    call hdf5_create_hard_link(group, 'NumberOfCells', group, 'NumberOfConnectivityIds', err)
    call hdf5_create_dataset(group, 'Offsets', hdf5_integer, 1, &
                             (layout%n_point + 1_i8)*layout%n_step_max, offsets, err)
    call hdf5_create_dataset(group, 'Connectivity', hdf5_integer, 1, layout%n_point, &
                             connectivity, err)
    if (comm%is_root()) call hdf5_write_rows(counts, 1_i8, size(zero), zero, err)
    call write_sequence(comm, connectivity, 1_i8, layout%n_point, err)
    call hdf5_close_dataset(counts, err)
    call hdf5_close_dataset(offsets, err)
    call hdf5_close_dataset(connectivity, err)
    call hdf5_close_group(group, err)

    call hdf5_create_group(parent, 'Lines', group, err)
    call hdf5_create_dataset(group, 'NumberOfCells', hdf5_integer, 1, size(zero, kind=i8), &
                             counts, err)
    call hdf5_create_hard_link(group, 'NumberOfCells', group, 'NumberOfConnectivityIds', err)
    call hdf5_create_dataset(group, 'Offsets', hdf5_integer, 1, size(zero, kind=i8), offsets, err)
    call hdf5_create_dataset(group, 'Connectivity', hdf5_integer, 1, 0_i8, connectivity, err)
    if (comm%is_root()) call hdf5_write_rows(counts, 1_i8, size(zero), zero, err)
    if (comm%is_root()) call hdf5_write_rows(offsets, 1_i8, size(zero), zero, err)
    call hdf5_close_dataset(counts, err)
    call hdf5_close_dataset(offsets, err)
    call hdf5_close_dataset(connectivity, err)
    call hdf5_close_group(group, err)
    call hdf5_create_hard_link(parent, 'Lines', parent, 'Polygons', err)
    call hdf5_create_hard_link(parent, 'Lines', parent, 'Strips', err)
  end subroutine build_cells

  subroutine build_step_tables(layout, comm, steps, err)
    !! The tables of a step's whereabouts.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: steps
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: table(:)
    integer(hid_t) :: group
    integer :: i, k, n

    n = layout%n_step_max
    allocate (table(4*n), source=0_i8)
    call build_table(comm, steps, 'CellOffsets', 4, n, table, err)
    call build_table(comm, steps, 'ConnectivityIdOffsets', 4, n, table, err)
    call build_table(comm, steps, 'PointOffsets', 1, n, table, err)
    table = 1_i8
    call build_table(comm, steps, 'NumberOfParts', 1, n, table, err)
    do i = 1, n
      table(i) = i - 1
    end do
    call build_table(comm, steps, 'PartOffsets', 1, n, table, err)
    call hdf5_create_group(steps, 'PointDataOffsets', group, err)
    call hdf5_create_hard_link(steps, 'PointOffsets', group, 'id', err)
    do k = 1, size(layout%field)
      call hdf5_create_hard_link(steps, 'PointOffsets', group, trim(layout%field(k)%name), err)
    end do
    call hdf5_close_group(group, err)
  end subroutine build_step_tables

  subroutine build_table(comm, parent, name, width, n, values, err)
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer, intent(in) :: width, n
    integer(i8), intent(in) :: values(width*n)
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset

    call hdf5_create_dataset(parent, name, hdf5_integer, width, int(n, i8), dataset, err)
    if (comm%is_root()) then
      if (width == 1) call hdf5_write_rows(dataset, 1_i8, n, values, err)
      if (width > 1) call hdf5_write_rows(dataset, 1_i8, width, n, &
                                          reshape(values, [width, n]), err)
    end if
    call hdf5_close_dataset(dataset, err)
  end subroutine build_table

  subroutine build_checksums(layout, comm, file, err)
    !! Tables of checksums, and what their columns are of, one name a line.
    type(result_layout_t), intent(in) :: layout
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: file
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group, dataset
    character(len=:), allocatable :: names
    integer :: k

    call hdf5_create_group(file, 'Checksums', group, err)
    call hdf5_write_attribute(group, 'scene_text', text_sum(layout%scene_text), err)
    call hdf5_write_attribute(group, 'scene_echo', text_sum(layout%scene_echo), err)
    call hdf5_create_dataset(group, 'steps', hdf5_integer, n_first_sum + size(layout%field), &
                             int(layout%n_step_max, i8), dataset, err)
    call hdf5_close_dataset(dataset, err)
    call hdf5_create_dataset(group, 'history', hdf5_integer, 1, layout%history_capacity, &
                             dataset, err)
    call hdf5_close_dataset(dataset, err)
    names = ''
    associate (summed => summed_names(layout))
      do k = 1, size(summed)
        names = names//trim(summed(k))//new_line('a')
      end do
    end associate
    call hdf5_write_text(group, 'step_columns', names, comm%is_root(), err)
    names = ''
    do k = 1, size(layout%history)
      names = names//trim(layout%history(k)%name)//new_line('a')
    end do
    call hdf5_write_text(group, 'history_columns', names, comm%is_root(), err)
    call hdf5_close_group(group, err)
  end subroutine build_checksums

  pure function summed_names(layout) result(names)
    !! What the checksums of a step are of.
    type(result_layout_t), intent(in) :: layout
    character(len=64), allocatable :: names(:)

    names = [[character(len=64) :: 'place', 'id', 'Points'], layout%field%name]
  end function summed_names

  pure integer(i8) function text_sum(text) result(value)
    !! Checksum of a text as the file holds it: an empty one is a blank.
    character(len=*), intent(in) :: text
    type(checksum_t) :: checksum

    call checksum%add_text(text//repeat(' ', merge(1, 0, len(text) == 0)))
    value = checksum%value()
  end function text_sum
end module dosui_result_structure

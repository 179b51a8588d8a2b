!! The result file: VTKHDF poly data of the particles, step by step, with histories and the scene.
!!
!! A killed run must leave a file in which every completed step can be read, by VTK's reader too,
!! which wants Steps/Values and (for a single step) NumberOfPoints exactly as long as NSteps says.
!! HDF5 cannot change three objects at once. Therefore
!!
!! 1. everything large has its final size when the file is created, and its space is reserved, so
!!    that writing a step changes no structure of the file;
!! 2. the few things that must agree (NSteps, Steps/Values, NumberOfPoints) exist twice, below
!!    /Commits/a and /Commits/b, and /VTKHDF is a soft link to one of them. A step is written to
!!    free rows and to the other twin, flushed, and then the link is turned: one small write into
!!    the first page of the file, which is either done or not.
!! 3. the file is built under the name <path>.part and gets its name with its first complete step:
!!    what was at `path` before is replaced by a readable file or not at all.
!!
!! Points are stored in the order of their global id, so files do not depend on the ranks.
!!
!! /Checksums holds checksums (dosui_checksum) of what a step and what a row of the histories hold,
!! written before the step or row is shown; readers refuse what does not fit.
module dosui_result_file
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_dimension, only: ndim
  use dosui_checksum, only: checksum_t, combine_checksums
  use dosui_communicator, only: communicator_t
  use dosui_text, only: to_text
  use dosui_file_exchange, only: remove_file, rename_file
  use dosui_history, only: history_t, history_column_t
  use dosui_hdf5, only: hid_t, hdf5_file_t, hdf5_integer, hdf5_create_group, hdf5_open_group, &
                        hdf5_close_group, hdf5_create_dataset, hdf5_open_dataset, &
                        hdf5_close_dataset, hdf5_dataset_shape, hdf5_resize_dataset, &
                        hdf5_write_rows, hdf5_read_rows, hdf5_write_attribute, &
                        hdf5_read_attribute, hdf5_update_attribute, hdf5_read_text, hdf5_exists, &
                        hdf5_n_links, hdf5_create_soft_link, hdf5_create_hard_link, &
                        hdf5_remove_link
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use dosui_result_rows, only: plan_redistribution, write_columns, write_sequence, write_nan, &
                               share, copy_reals, copy_integers, copy_column, sum_reals, &
                               sum_integers, checksums_of_rows
  use dosui_result_structure, only: check_layout, build_histories, build_scene, build_twins, &
                                    build_checksums, summed_names, text_sum, twin_name, sum_ids, &
                                    sum_points, n_first_sum, result_field_t, result_layout_t
  implicit none
  private

  public :: result_field_t, result_layout_t

  character(len=*), parameter :: row_sums_name = 'Checksums/history'

  type :: step_plan_t
    !! Where the points of the step that is being written go.
    real(wp) :: time = 0.0_wp
    integer(i8) :: n_total = 0_i8, first_row = 0_i8
    integer, allocatable :: outgoing(:), send_count(:), order(:)
    type(checksum_t), allocatable :: checksum(:)   !! of this rank's part
  end type step_plan_t

  type :: twin_t
    !! One of the two sets of objects that must change together.
    integer(hid_t) :: steps = -1_hid_t, values = -1_hid_t, number_of_points = -1_hid_t
    integer :: n_valid = 0          !! leading steps whose entries are right
    logical :: is_known = .false.   !! the tables are not longer than that
  end type twin_t

  type, public :: result_file_t
    !! An open result file. All procedures are collective.
    integer :: n_step = 0                  !! completed steps
    real(wp) :: last_time = -huge(1.0_wp)  !! of the last completed step [s]
    integer(i8) :: n_history = 0_i8        !! completed rows of the histories
    type(result_layout_t), private :: layout
    type(hdf5_file_t), private :: file
    character(len=:), allocatable, private :: path
    logical, private :: has_name = .false.          !! false: still under its .part name
    real(wp), allocatable, private :: time(:)       !! (n_step_max) [s]
    integer(i8), allocatable, private :: count(:)   !! (n_step_max) points of a step
    integer(i8), private :: n_row = 0_i8            !! rows in use
    integer, private :: active = 0                  !! twin that /VTKHDF shows; 0: none yet
    type(twin_t), private :: twin(2)
    type(step_plan_t), private :: plan
    integer(hid_t), private :: points = -1_hid_t, ids = -1_hid_t
    integer(hid_t), private :: point_offsets = -1_hid_t, cell_offsets = -1_hid_t
    integer(hid_t), private :: number_of_cells = -1_hid_t, vertex_offsets = -1_hid_t
    integer(hid_t), private :: history_group = -1_hid_t
    integer(hid_t), allocatable, private :: field(:), history(:)
    integer(hid_t), private :: step_sums = -1_hid_t, row_sums = -1_hid_t   !! checksums
    integer(i8), private :: row_capacity = 0_i8     !! of row_sums
    character(len=64), allocatable, private :: summed(:)     !! what step_sums are of
    integer(i8), allocatable, private :: kept_sums(:, :)     !! (summed, step) once checked
  contains
    procedure :: create => result_create
    procedure :: open_existing => result_open_existing
    procedure :: write_step => result_write_step
    procedure :: begin_step => result_begin_step
    procedure :: write_field => result_write_field
    procedure :: end_step => result_end_step
    procedure :: write_history => result_write_history
    procedure :: close => result_close
  end type result_file_t

contains

  ! ---------------------------------------------------------------- public

  subroutine result_create(self, comm, path, layout, err)
    !! Prepares a new file; `path` itself changes when the first step is complete.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path            !! ends in .vtkhdf
    type(result_layout_t), intent(in) :: layout
    type(error_t), intent(inout) :: err

    call check_layout(layout, err)
    call comm%agree(err)
    if (err%failed()) return
    self%layout = layout
    self%path = path
    self%has_name = .false.
    call start_counting(self)
    call build_file(self, comm, path//'.part', err)
    if (.not. err%failed()) call attach(self, comm, path//'.part', err)
    call comm%agree(err)
    if (err%failed() .and. comm%is_root()) call remove_file(path//'.part')   ! it takes space
  end subroutine result_create

  subroutine result_open_existing(self, comm, path, time, layout, err)
    !! Continues the file of an interrupted run: steps and history rows later than `time` go.
    !!
    !! If scene, fields, histories or sizes differ from the file's, the kept steps are copied to a
    !! new file; then values of fields that the old file lacks are zero, of histories NaN.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    real(wp), intent(in) :: time                    !! of the checkpoint [s]
    type(result_layout_t), intent(in) :: layout     !! of the continued run
    type(error_t), intent(inout) :: err
    type(result_file_t) :: old
    type(error_t) :: damage
    integer :: n_kept

    call check_layout(layout, err)
    call comm%agree(err)
    if (err%failed()) return
    old%path = path
    old%has_name = .true.
    call read_layout(old, comm, path, damage)
    call comm%agree(damage)
    if (.not. damage%failed()) then
      n_kept = count(old%time(:old%n_step) <= time + 4.0_wp*spacing(abs(time)))
      call check_checksums(old, comm, n_kept, layout, damage)
    end if
    if (damage%failed()) then
      call err%set(named(path, damage%message))
      call old%close(comm, err)
      return
    end if
    if (n_kept > 0 .and. is_compatible(old, layout)) then
      call continue_in_place(self, comm, old, n_kept, time, layout, err)
    else
      call continue_in_copy(self, comm, old, n_kept, time, layout, err)
    end if
    call comm%agree(err)
  end subroutine result_open_existing

  pure function named(path, message) result(text)
    !! What is wrong with a file, with its path.
    character(len=*), intent(in) :: path, message
    character(len=:), allocatable :: text

    text = message
    if (index(message, path) == 0) text = path//' is damaged: '//message
  end function named

  subroutine result_write_step(self, comm, time, n, id, points, values, err)
    !! Adds a step. Ranks pass their own points in any order; they are stored by increasing id.
    !!
    !! A step at the time of the last one is already there (restart, end of run): nothing is done.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: time             !! [s]
    integer, intent(in) :: n                 !! points of this rank, may be 0
    integer(i8), intent(in) :: id(n)         !! global, unique
    real(wp), intent(in) :: points(3, n)     !! positions, unused coordinates 0 [m]
    real(wp), intent(in) :: values(:, :)
    !! (sum of the fields' components, n), fields in order [unit of the field]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: field(:, :)
    logical :: is_new
    integer :: k, row, width

    call self%begin_step(comm, time, n, id, points, is_new, err)
    if (err%failed() .or. .not. is_new) return
    row = 0
    do k = 1, size(self%layout%field)
      width = self%layout%field(k)%n_components
      field = values(row + 1:row + width, :)
      call self%write_field(comm, k, n, field, err)
      row = row + width
    end do
    call self%end_step(comm, err)
  end subroutine result_write_step

  subroutine result_begin_step(self, comm, time, n, id, points, is_new, err)
    !! Begins a step, whose fields follow one by one (`write_field`), so that no more than one of
    !! them need be held; `end_step` shows it to readers. Not new: already there, skip the rest.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: time             !! [s]
    integer, intent(in) :: n                 !! points of this rank, may be 0
    integer(i8), intent(in) :: id(n)         !! global, unique
    real(wp), intent(in) :: points(3, n)     !! positions, unused coordinates 0 [m]
    logical, intent(out) :: is_new
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: sorted_id(:)
    real(wp), allocatable :: coordinates(:, :)
    integer :: n_local

    is_new = .not. (self%n_step > 0 .and. .not. (time > self%last_time))
    if (.not. is_new) then
      if (.not. (abs(time - self%last_time) <= 0.0_wp)) call err%set('output steps go back in time')
      return
    end if
    associate (plan => self%plan)
      plan%time = time
      plan%n_total = comm%sum(int(n, i8))
      call check_room(self, plan%n_total, err)
      if (err%failed()) return
      call plan_redistribution(comm, n, id, plan%outgoing, plan%send_count, plan%order, sorted_id)
      n_local = size(sorted_id)
      allocate (plan%checksum(n_first_sum + size(self%layout%field)))
      call plan%checksum(sum_ids)%add(n_local, sorted_id)
      plan%first_row = self%n_row + comm%prefix_sum(int(n_local, i8)) + 1_i8
      call hdf5_write_rows(self%ids, plan%first_row, n_local, sorted_id, err)
      coordinates = points
      call write_columns(comm, self%points, plan%first_row, 3, n, coordinates, plan%outgoing, &
                         plan%send_count, plan%order, plan%checksum(sum_points), err)
    end associate
  end subroutine result_begin_step

  subroutine result_write_field(self, comm, number, n, values, err)
    !! Writes a field of the step that has begun.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: number            !! of the field in the layout
    integer, intent(in) :: n                 !! points of this rank
    real(wp), allocatable, intent(inout) :: values(:, :)
    !! (components, n), in the order of begin_step; used up [unit of the field]
    type(error_t), intent(inout) :: err

    call write_columns(comm, self%field(number), self%plan%first_row, &
                       self%layout%field(number)%n_components, n, values, self%plan%outgoing, &
                       self%plan%send_count, self%plan%order, &
                       self%plan%checksum(n_first_sum + number), err)
  end subroutine result_write_field

  subroutine result_end_step(self, comm, err)
    !! Makes the step visible.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(error_t), intent(inout) :: err

    call combine_checksums(comm, self%plan%checksum)
    call write_step_sums(self, comm, self%n_step + 1, &
                         [place_sum(self%plan%time, self%n_row, self%plan%n_total), &
                          self%plan%checksum(sum_ids:)%value()], err)
    call commit(self, comm, self%n_step + 1, self%plan%time, self%plan%n_total, err)
    deallocate (self%plan%outgoing, self%plan%send_count, self%plan%order, self%plan%checksum)
  end subroutine result_end_step

  subroutine result_write_history(self, comm, history, err)
    !! Writes the rows waiting on root and forgets them.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(history_t), intent(inout) :: history
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: column(:)
    integer(i8) :: n_new(1)
    integer :: k, n

    n_new = 0_i8
    if (comm%is_root()) n_new = history%n_row
    call comm%broadcast(n_new)
    if (n_new(1) == 0_i8) return
    if (self%n_history + n_new(1) > self%layout%history_capacity) then
      call grow_histories(self, comm, 2_i8*(self%n_history + n_new(1)), err)
      if (err%failed()) return
    end if
    n = int(n_new(1))
    if (self%n_history + n > self%row_capacity) then
      call grow_row_sums(self, comm, 2_i8*(self%n_history + n), err)
    end if
    if (comm%is_root()) then
      allocate (column(n))
      do k = 1, size(self%history)
        column(:) = history%value(k, :n)
        call hdf5_write_rows(self%history(k), self%n_history + 1_i8, n, column, err)
      end do
      call hdf5_write_rows(self%row_sums, self%n_history + 1_i8, n, &
                           checksums_of_rows(size(self%history), n, history%value), err)
    end if
    call comm%agree(err)
    if (err%failed()) return
    self%n_history = self%n_history + n_new(1)
    call hdf5_update_attribute(self%history_group, 'n_entries', self%n_history, err)
    call self%file%flush(err)
    call comm%agree(err)
    call history%clear()
  end subroutine result_write_history

  subroutine grow_histories(self, comm, capacity, err)
    !! Moves the histories to larger arrays in a new group, to which the link /History turns when
    !! it is complete.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: capacity   !! rows there will be room for
    type(error_t), intent(inout) :: err
    character(len=*), parameter :: place = '/Commits/History'
    integer(hid_t) :: group
    integer :: k

    self%layout%history_capacity = capacity
    call hdf5_create_group(self%file%id, place, group, err)
    call hdf5_write_attribute(group, 'n_entries', self%n_history, err)
    call build_histories(self%layout, comm, group, err)
    if (comm%is_root()) then
      do k = 1, size(self%history)
        call copy_column(self%history(k), group, trim(self%layout%history(k)%name), &
                         int(self%n_history), err)
      end do
    end if
    call comm%agree(err)
    if (err%failed()) return
    call self%file%flush(err)
    do k = 1, size(self%history)
      call hdf5_close_dataset(self%history(k), err)
    end do
    call hdf5_close_group(self%history_group, err)
    call hdf5_remove_link(self%file%id, 'History', err)
    call hdf5_create_hard_link(self%file%id, place, self%file%id, 'History', err)
    call self%file%flush(err)
    call hdf5_remove_link(self%file%id, place, err)
    self%history_group = group
    do k = 1, size(self%history)
      call hdf5_open_dataset(self%history_group, trim(self%layout%history(k)%name), &
                             self%history(k), err)
    end do
    call comm%agree(err)
  end subroutine grow_histories

  subroutine result_close(self, comm, err)
    !! Ends the file. Without any step it stays under its .part name.
    class(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(error_t), intent(inout) :: err

    if (.not. self%file%is_open()) return
    call self%file%close(err)
    call comm%agree(err)
  end subroutine result_close

  ! ---------------------------------------------------------------- checks

  subroutine check_room(self, n_total, err)
    type(result_file_t), intent(in) :: self
    integer(i8), intent(in) :: n_total
    type(error_t), intent(inout) :: err

    if (.not. self%file%is_open()) then
      call err%set('the result file is not open')
    else if (self%n_step >= self%layout%n_step_max) then
      call err%set('there is no room for more output steps in '//self%path)
    else if (n_total > self%layout%n_point) then
      call err%set('there is no room for so many points in '//self%path)
    end if
  end subroutine check_room

  logical function is_compatible(old, layout) result(is)
    !! Can the run described by `layout` go on in the file?
    type(result_file_t), intent(in) :: old
    type(result_layout_t), intent(in) :: layout
    integer(hid_t) :: group
    integer(i8) :: n_row
    integer :: k, width
    type(error_t) :: err

    is = old%layout%n_step_max >= layout%n_step_max .and. old%layout%n_point >= layout%n_point &
         .and. old%layout%scene_text == layout%scene_text .and. &
         hdf5_exists(old%file%id, 'Checksums') .and. &
         hdf5_n_links(old%history_group) == size(layout%history)
    call hdf5_open_group(old%file%id, 'VTKHDF/PointData', group, err)
    is = is .and. hdf5_n_links(group) == size(layout%field) + 1
    do k = 1, size(layout%field)
      call find_dataset(group, layout%field(k)%name, width, n_row)
      is = is .and. width == layout%field(k)%n_components
    end do
    call hdf5_close_group(group, err)
    do k = 1, size(layout%history)
      call find_dataset(old%history_group, layout%history(k)%name, width, n_row)
      is = is .and. width == 1 .and. n_row >= layout%history_capacity
    end do
  end function is_compatible

  subroutine find_dataset(group, name, width, n_row)
    !! Size of a dataset; 0 if there is none of this name.
    integer(hid_t), intent(in) :: group
    character(len=*), intent(in) :: name
    integer, intent(out) :: width
    integer(i8), intent(out) :: n_row
    integer(hid_t) :: dataset
    type(error_t) :: err

    width = 0
    n_row = 0_i8
    if (.not. hdf5_exists(group, trim(name))) return
    call hdf5_open_dataset(group, trim(name), dataset, err)
    if (err%failed()) return
    call hdf5_dataset_shape(dataset, width, n_row, err)
    call hdf5_close_dataset(dataset, err)
  end subroutine find_dataset

  subroutine start_counting(self)
    !! An empty file of the given layout.
    type(result_file_t), intent(inout) :: self

    self%n_step = 0
    self%last_time = -huge(1.0_wp)
    self%n_history = 0_i8
    self%n_row = 0_i8
    self%active = 0
    self%twin(:)%n_valid = 0
    self%twin(:)%is_known = .false.
    if (allocated(self%time)) deallocate (self%time)
    if (allocated(self%count)) deallocate (self%count)
    allocate (self%time(self%layout%n_step_max), source=0.0_wp)
    allocate (self%count(self%layout%n_step_max), source=0_i8)
  end subroutine start_counting

  ! ---------------------------------------------------------------- a new file

  subroutine build_file(self, comm, path, err)
    !! Creates every object the file will ever have, and closes it.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group
    logical :: ok

    call self%file%create(comm, path, err)
    call comm%agree(err)
    if (err%failed()) return
    ! First, so that the three objects changed during the run lie in the first page of the file.
    call hdf5_create_soft_link(self%file%id, 'VTKHDF', '/Commits/a', err)
    call hdf5_create_group(self%file%id, 'History', group, err)
    call hdf5_write_attribute(group, 'n_entries', 0_i8, err)
    call build_histories(self%layout, comm, group, err)
    call hdf5_close_group(group, err)
    call build_scene(self%layout, comm, self%file%id, err)
    call build_twins(self%layout, comm, self%file%id, err)
    call build_checksums(self%layout, comm, self%file%id, err)
    ok = .not. err%failed()
    call self%file%flush(err)
    call self%file%close(err)
    call comm%agree(err)
    if (ok .and. err%failed()) call err%set('cannot write '//path)
  end subroutine build_file

  ! ---------------------------------------------------------------- checksums

  subroutine grow_row_sums(self, comm, capacity, err)
    !! Moves the checksums of the histories' rows to a larger table, which gets its name when it is
    !! complete.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer(i8), intent(in) :: capacity   !! rows there will be room for
    type(error_t), intent(inout) :: err
    character(len=*), parameter :: place = '/Commits/history_sums'
    integer(hid_t) :: larger

    call hdf5_create_dataset(self%file%id, place, hdf5_integer, 1, capacity, larger, err)
    call copy_integers(comm, self%row_sums, larger, self%n_history, err)
    call comm%agree(err)
    if (err%failed()) return
    call self%file%flush(err)
    call hdf5_close_dataset(self%row_sums, err)
    call hdf5_remove_link(self%file%id, row_sums_name, err)
    call hdf5_create_hard_link(self%file%id, place, self%file%id, row_sums_name, err)
    call self%file%flush(err)
    call hdf5_remove_link(self%file%id, place, err)
    call comm%agree(err)
    self%row_sums = larger
    self%row_capacity = capacity
  end subroutine grow_row_sums

  pure integer(i8) function place_sum(time, offset, n_total) result(value)
    !! Checksum of a step's time and of where its points are.
    real(wp), intent(in) :: time                    !! [s]
    integer(i8), intent(in) :: offset, n_total      !! points of earlier steps, of this one
    type(checksum_t) :: checksum

    call checksum%add(1, [time])
    call checksum%add(2, [offset, n_total])
    value = checksum%value()
  end function place_sum

  subroutine write_step_sums(self, comm, step, sums, err)
    type(result_file_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: step
    integer(i8), intent(in) :: sums(:)
    type(error_t), intent(inout) :: err

    if (comm%is_root()) call hdf5_write_rows(self%step_sums, int(step, i8), size(sums), 1, &
                                             reshape(sums, [size(sums), 1]), err)
  end subroutine write_step_sums

  subroutine check_checksums(old, comm, n_kept, layout, err)
    !! Refuses a file whose kept steps or histories are not what was written. Keeps the checksums
    !! of its steps; those of a file that has none are found anew. Collective.
    type(result_file_t), intent(inout) :: old
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_kept
    type(result_layout_t), intent(in) :: layout   !! of the continued run
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: stored(:, :), sums(:)
    integer(i8) :: offset, text_sums(2)
    logical :: has_sums
    integer :: k, c

    has_sums = hdf5_exists(old%file%id, 'Checksums')
    call find_summed(old, has_sums, layout, text_sums, err)
    call comm%agree(err)
    if (err%failed()) return
    if (has_sums .and. text_sums(1) /= text_sum(old%layout%scene_text)) then
      call err%set(old%path//' is damaged: the checksum of the scene does not fit')
    end if
    allocate (old%kept_sums(size(old%summed), n_kept), stored(size(old%summed), n_kept))
    if (has_sums .and. comm%is_root()) then
      call hdf5_read_rows(old%step_sums, 1_i8, size(stored, 1), n_kept, stored, err)
    end if
    offset = 0_i8
    do k = 1, n_kept
      call sum_step(old, comm, k, offset, sums, err)
      old%kept_sums(:, k) = sums
      offset = offset + old%count(k)
      if (.not. (has_sums .and. comm%is_root())) cycle
      c = findloc(stored(:, k) == sums, .false., dim=1)
      if (c > 0) call err%set(old%path//' is damaged: the checksum of '//trim(old%summed(c))// &
                              ' in step '//to_text(k)//' does not fit')
    end do
    if (has_sums .and. comm%is_root()) call check_rows(old, err)
    call comm%agree(err)
  end subroutine check_checksums

  subroutine find_summed(old, has_sums, layout, text_sums, err)
    !! What the checksums of a file are of, and of its texts.
    type(result_file_t), intent(inout) :: old
    logical, intent(in) :: has_sums
    type(result_layout_t), intent(in) :: layout
    integer(i8), intent(out) :: text_sums(2)
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group
    character(len=:), allocatable :: names
    integer(i8) :: n_row, n_row_sum
    integer :: width

    text_sums = 0_i8
    if (.not. has_sums) then
      old%summed = summed_names(layout)
      return
    end if
    call hdf5_open_group(old%file%id, 'Checksums', group, err)
    call hdf5_read_attribute(group, 'scene_text', text_sums(1), err)
    call hdf5_read_attribute(group, 'scene_echo', text_sums(2), err)
    call hdf5_read_text(group, 'step_columns', names, err)
    old%summed = lines_of(names)
    call hdf5_read_text(group, 'history_columns', names, err)
    old%layout%history = [history_column_t ::]
    if (.not. err%failed()) call take_columns(old%layout, lines_of(names))
    call hdf5_open_dataset(group, 'steps', old%step_sums, err)
    if (.not. err%failed()) call hdf5_dataset_shape(old%step_sums, width, n_row, err)
    call hdf5_open_dataset(group, 'history', old%row_sums, err)
    if (.not. err%failed()) call hdf5_dataset_shape(old%row_sums, width, n_row_sum, err)
    if (err%failed()) return
    call hdf5_close_group(group, err)
    if (n_row /= old%layout%n_step_max .or. n_row_sum < old%n_history) then
      call err%set(old%path//' is damaged: its tables of checksums contradict it')
    end if
  end subroutine find_summed

  pure subroutine take_columns(layout, names)
    !! Columns of histories by name.
    type(result_layout_t), intent(inout) :: layout
    character(len=*), intent(in) :: names(:)

    if (allocated(layout%history)) deallocate (layout%history)
    allocate (layout%history(size(names)))
    layout%history%name = names
  end subroutine take_columns

  pure function lines_of(text) result(lines)
    !! The lines of a text, each ended by a line break.
    character(len=*), intent(in) :: text
    character(len=64), allocatable :: lines(:)
    integer :: k, n, first

    n = 0
    do k = 1, len(text)
      if (text(k:k) == new_line('a')) n = n + 1
    end do
    allocate (lines(n))
    first = 1
    do k = 1, n
      lines(k) = text(first:first + index(text(first:), new_line('a')) - 2)
      first = first + index(text(first:), new_line('a'))
    end do
  end function lines_of

  subroutine sum_step(old, comm, step, offset, sums, err)
    !! Checksums of what a file holds of a step, every rank reading its share. Collective.
    type(result_file_t), intent(inout) :: old
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: step
    integer(i8), intent(in) :: offset        !! points of earlier steps
    integer(i8), allocatable, intent(out) :: sums(:)
    type(error_t), intent(inout) :: err
    type(checksum_t) :: checksum(size(old%summed))
    integer(hid_t) :: group, dataset
    integer(i8) :: first, last, n_row
    integer :: k, width

    call share(old%count(step), comm%rank, comm%size, first, last)
    first = first + offset
    last = last + offset
    call sum_integers(old%ids, first, last, checksum(sum_ids), err)
    call sum_reals(old%points, 3, first, last, checksum(sum_points), err)
    call hdf5_open_group(old%file%id, 'VTKHDF/PointData', group, err)
    do k = n_first_sum + 1, size(old%summed)
      call find_dataset(group, old%summed(k), width, n_row)
      if (width == 0) cycle
      call hdf5_open_dataset(group, trim(old%summed(k)), dataset, err)
      call sum_reals(dataset, width, first, last, checksum(k), err)
      call hdf5_close_dataset(dataset, err)
    end do
    call hdf5_close_group(group, err)
    call combine_checksums(comm, checksum)
    sums = [place_sum(old%time(step), offset, old%count(step)), checksum(sum_ids:)%value()]
  end subroutine sum_step

  subroutine check_rows(old, err)
    !! Compares the histories with their checksums. Call on root only.
    type(result_file_t), intent(in) :: old
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: table(:, :)
    integer(i8), allocatable :: stored(:)
    integer :: n, row

    n = int(old%n_history)
    call read_history(old, n, old%layout%history, table, err)
    allocate (stored(n), source=0_i8)
    call hdf5_read_rows(old%row_sums, 1_i8, n, stored, err)
    if (err%failed()) return
    row = findloc(stored == checksums_of_rows(size(table, 1), n, table), .false., dim=1)
    if (row > 0) call err%set(old%path//' is damaged: the checksum of row '//to_text(row)// &
                              ' of the histories does not fit')
  end subroutine check_rows

  subroutine read_history(old, n, columns, table, err)
    !! The first rows of the histories; NaN where the file has no column. Call on root only.
    type(result_file_t), intent(in) :: old
    integer, intent(in) :: n
    type(history_column_t), intent(in) :: columns(:)
    real(wp), allocatable, intent(out) :: table(:, :)   !! (column, row)
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: column(:)
    integer(hid_t) :: dataset
    integer(i8) :: n_row
    integer :: k, width

    allocate (table(size(columns), n), column(n))
    table = ieee_value(1.0_wp, ieee_quiet_nan)
    do k = 1, size(columns)
      call find_dataset(old%history_group, columns(k)%name, width, n_row)
      if (width /= 1 .or. n_row < n) cycle
      call hdf5_open_dataset(old%history_group, trim(columns(k)%name), dataset, err)
      call hdf5_read_rows(dataset, 1_i8, n, column, err)
      call hdf5_close_dataset(dataset, err)
      table(k, :) = column
    end do
  end subroutine read_history

  ! ---------------------------------------------------------------- steps

  subroutine attach(self, comm, path, err)
    !! Opens the file for writing and all objects that change.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: root
    integer :: k

    call self%file%open(comm, path, .true., err)
    call comm%agree(err)
    if (err%failed()) return
    do k = 1, 2
      root = '/Commits/'//twin_name(k)
      call hdf5_open_group(self%file%id, root//'/Steps', self%twin(k)%steps, err)
      call hdf5_open_dataset(self%file%id, root//'/Steps/Values', self%twin(k)%values, err)
      call hdf5_open_dataset(self%file%id, root//'/NumberOfPoints', &
                             self%twin(k)%number_of_points, err)
    end do
    call hdf5_open_dataset(self%file%id, root//'/Points', self%points, err)
    call hdf5_open_dataset(self%file%id, root//'/PointData/id', self%ids, err)
    call hdf5_open_dataset(self%file%id, root//'/Steps/PointOffsets', self%point_offsets, err)
    call hdf5_open_dataset(self%file%id, root//'/Steps/CellOffsets', self%cell_offsets, err)
    call hdf5_open_dataset(self%file%id, root//'/Vertices/NumberOfCells', &
                           self%number_of_cells, err)
    call hdf5_open_dataset(self%file%id, root//'/Vertices/Offsets', self%vertex_offsets, err)
    if (allocated(self%field)) deallocate (self%field)
    if (allocated(self%history)) deallocate (self%history)
    allocate (self%field(size(self%layout%field)), source=-1_hid_t)
    allocate (self%history(size(self%layout%history)), source=-1_hid_t)
    do k = 1, size(self%field)
      call hdf5_open_dataset(self%file%id, root//'/PointData/'//trim(self%layout%field(k)%name), &
                             self%field(k), err)
    end do
    call hdf5_open_dataset(self%file%id, 'Checksums/steps', self%step_sums, err)
    call hdf5_open_dataset(self%file%id, row_sums_name, self%row_sums, err)
    if (.not. err%failed()) call hdf5_dataset_shape(self%row_sums, k, self%row_capacity, err)
    call hdf5_open_group(self%file%id, 'History', self%history_group, err)
    do k = 1, size(self%history)
      call hdf5_open_dataset(self%history_group, trim(self%layout%history(k)%name), &
                             self%history(k), err)
    end do
  end subroutine attach

  subroutine commit(self, comm, n_step, time, n_total, err)
    !! Makes a step whose rows have been written part of the file (see the top of this module).
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_step          !! steps of the file afterwards
    real(wp), intent(in) :: time           !! of the last of them [s]
    integer(i8), intent(in) :: n_total     !! points of the last of them
    type(error_t), intent(inout) :: err

    call write_whereabouts(self, comm, n_step, self%n_row, n_total, err)
    call comm%agree(err)
    if (err%failed()) return
    self%time(n_step) = time
    self%count(n_step) = n_total
    call show(self, comm, n_step, err)
    if (err%failed()) return
    self%n_row = self%n_row + n_total
  end subroutine commit

  subroutine write_whereabouts(self, comm, step, offset, n_total, err)
    !! Where the points and cells of a step are.
    type(result_file_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: step
    integer(i8), intent(in) :: offset      !! points of all earlier steps
    integer(i8), intent(in) :: n_total     !! points of this step
    type(error_t), intent(inout) :: err

    if (comm%is_root()) then
      call hdf5_write_rows(self%point_offsets, int(step, i8), 1, [offset], err)
      call hdf5_write_rows(self%cell_offsets, int(step, i8), 4, 1, &
                           reshape([offset, 0_i8, 0_i8, 0_i8], [4, 1]), err)
      call hdf5_write_rows(self%number_of_cells, int(step, i8), 1, [n_total], err)
    end if
    call write_sequence(comm, self%vertex_offsets, offset + step, n_total + 1_i8, err)
  end subroutine write_whereabouts

  subroutine show(self, comm, n_step, err)
    !! Turns /VTKHDF to the twin that has the first n_step steps.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: n_step
    type(error_t), intent(inout) :: err
    integer :: next

    next = 1
    if (self%active == 1) next = 2
    call fill_twin(self, comm, self%twin(next), n_step, err)
    call self%file%flush(err)
    call comm%agree(err)
    if (err%failed()) return
    call hdf5_remove_link(self%file%id, 'VTKHDF', err)
    call hdf5_create_soft_link(self%file%id, 'VTKHDF', '/Commits/'//twin_name(next), err)
    call self%file%flush(err)
    if (.not. self%has_name .and. comm%is_root() .and. .not. err%failed()) then
      call rename_file(self%path//'.part', self%path, err)
    end if
    call comm%agree(err)
    if (err%failed()) return
    self%has_name = .true.
    self%active = next
    self%n_step = n_step
    self%last_time = self%time(n_step)
  end subroutine show

  subroutine fill_twin(self, comm, twin, n_step, err)
    !! Sizes of the twin's tables, and the entries it does not have yet.
    type(result_file_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(twin_t), intent(inout) :: twin
    integer, intent(in) :: n_step
    type(error_t), intent(inout) :: err
    integer :: first, n

    call hdf5_resize_dataset(twin%values, int(n_step, i8), err)
    call hdf5_resize_dataset(twin%number_of_points, int(n_step, i8), err)
    if (n_step < twin%n_valid .or. .not. twin%is_known) then
      ! HDF5 rewrites a table whose size is lowered, on every rank: let that be over.
      call self%file%flush(err)
      call comm%barrier()
      twin%n_valid = 0
      twin%is_known = .true.
    end if
    first = min(twin%n_valid, n_step - 1) + 1
    n = n_step - first + 1
    if (comm%is_root()) then
      call hdf5_write_rows(twin%values, int(first, i8), n, self%time(first:n_step), err)
      call hdf5_write_rows(twin%number_of_points, int(first, i8), n, self%count(first:n_step), err)
    end if
    call hdf5_update_attribute(twin%steps, 'NSteps', int(n_step, i8), err)
    twin%n_valid = n_step
  end subroutine fill_twin

  ! ---------------------------------------------------------------- an existing file

  subroutine read_layout(self, comm, path, err)
    !! Opens a result file for reading; what it holds and how far it got.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group
    integer(i8) :: n_step, n_row, file_ndim, active
    integer :: width, n
    logical :: is_result

    call self%file%open(comm, path, .false., err)
    if (err%failed()) return
    is_result = hdf5_exists(self%file%id, 'Commits') .and. hdf5_exists(self%file%id, 'Scene') &
                .and. hdf5_exists(self%file%id, 'History')
    if (.not. is_result) then
      call err%set(path//' is not a result file that can be continued')
      return
    end if
    call hdf5_open_group(self%file%id, 'Scene', group, err)
    call hdf5_read_attribute(group, 'ndim', file_ndim, err)
    if (file_ndim /= ndim) call err%set(path//' has points of another dimension')
    call hdf5_read_text(group, 'text', self%layout%scene_text, err)
    call hdf5_close_group(group, err)
    call hdf5_open_group(self%file%id, 'VTKHDF', group, err)
    call hdf5_read_attribute(group, 'twin', active, err)
    call hdf5_close_group(group, err)
    call hdf5_open_group(self%file%id, 'VTKHDF/Steps', group, err)
    call hdf5_read_attribute(group, 'NSteps', n_step, err)
    call hdf5_close_group(group, err)
    call hdf5_open_dataset(self%file%id, 'VTKHDF/Steps/PointOffsets', self%point_offsets, err)
    call hdf5_dataset_shape(self%point_offsets, width, n_row, err)
    if (err%failed()) return
    if (n_step < 0_i8 .or. n_step > n_row .or. active < 1_i8 .or. active > 2_i8) then
      call err%set(path//' is damaged: its number of steps contradicts it')
      return
    end if
    self%layout%n_step_max = int(n_row)
    call start_counting(self)
    n = int(n_step)
    self%n_step = n
    self%active = int(active)
    call hdf5_open_dataset(self%file%id, 'VTKHDF/Steps/Values', self%twin(1)%values, err)
    call hdf5_read_rows(self%twin(1)%values, 1_i8, n, self%time, err)
    call hdf5_open_dataset(self%file%id, 'VTKHDF/NumberOfPoints', &
                           self%twin(1)%number_of_points, err)
    call hdf5_read_rows(self%twin(1)%number_of_points, 1_i8, n, self%count, err)
    call hdf5_open_dataset(self%file%id, 'VTKHDF/Points', self%points, err)
    call hdf5_dataset_shape(self%points, width, n_row, err)
    self%layout%n_point = n_row/self%layout%n_step_max
    call hdf5_open_dataset(self%file%id, 'VTKHDF/PointData/id', self%ids, err)
    call hdf5_open_group(self%file%id, 'History', self%history_group, err)
    call hdf5_read_attribute(self%history_group, 'n_entries', self%n_history, err)
    if (any(self%count(:n) < 0_i8) .or. any(self%count(:n) > self%layout%n_point) .or. &
        self%n_history < 0_i8) then
      call err%set(path//' is damaged: its numbers of points or rows contradict it')
    end if
  end subroutine read_layout

  subroutine continue_in_place(self, comm, old, n_kept, time, layout, err)
    !! Goes on in the same file after dropping what is later than the checkpoint.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(inout) :: old
    integer, intent(in) :: n_kept
    real(wp), intent(in) :: time             !! of the checkpoint [s]
    type(result_layout_t), intent(in) :: layout
    type(error_t), intent(inout) :: err
    integer(i8) :: n_history, capacity
    integer :: width, k

    n_history = n_history_until(old, comm, time, err)
    capacity = layout%history_capacity
    if (size(layout%history) > 0) call find_dataset(old%history_group, layout%history(1)%name, &
                                                    width, capacity)
    call old%file%close(err)
    self%layout = layout
    self%layout%n_step_max = old%layout%n_step_max
    self%layout%n_point = old%layout%n_point
    self%layout%history_capacity = capacity
    self%path = old%path
    self%has_name = .true.
    call start_counting(self)
    self%time = old%time
    self%count = old%count
    self%n_row = sum(self%count(:n_kept))
    self%active = old%active
    call attach(self, comm, self%path, err)
    call comm%agree(err)
    if (err%failed()) return
    self%n_step = n_kept
    self%last_time = self%time(n_kept)
    if (n_kept < old%n_step) call show(self, comm, n_kept, err)
    self%n_history = n_history
    call hdf5_update_attribute(self%history_group, 'n_entries', n_history, err)
    call self%file%flush(err)
    if (comm%is_root()) then
      do k = 1, size(self%history)
        call write_nan(self%history(k), n_history + 1_i8, old%n_history, err)
      end do
    end if
  end subroutine continue_in_place

  subroutine continue_in_copy(self, comm, old, n_kept, time, layout, err)
    !! Copies what is kept into a new file, which replaces the old one when it is complete.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(inout) :: old
    integer, intent(in) :: n_kept
    real(wp), intent(in) :: time             !! of the checkpoint [s]
    type(result_layout_t), intent(in) :: layout
    type(error_t), intent(inout) :: err
    type(result_layout_t) :: larger
    integer(i8) :: n_history

    n_history = n_history_until(old, comm, time, err)
    larger = layout
    larger%n_step_max = n_kept + layout%n_step_max   ! the kept may not be on the new schedule
    larger%n_point = max(layout%n_point, maxval([0_i8, old%count(:n_kept)]))
    larger%history_capacity = n_history + layout%history_capacity
    call self%create(comm, old%path, larger, err)
    if (err%failed()) return
    call copy_history(self, comm, old, n_history, err)
    if (n_kept > 0) call copy_steps(self, comm, old, n_kept, err)
    call old%file%close(err)
  end subroutine continue_in_copy

  subroutine copy_history(self, comm, old, n_history, err)
    !! Copies the first rows of the histories that both files have.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(in) :: old
    integer(i8), intent(in) :: n_history
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: table(:, :)
    integer :: k, n

    n = int(n_history)
    if (comm%is_root()) then
      call read_history(old, n, self%layout%history, table, err)
      do k = 1, size(self%history)
        call hdf5_write_rows(self%history(k), 1_i8, n, table(k, :), err)
      end do
      call hdf5_write_rows(self%row_sums, 1_i8, n, &
                           checksums_of_rows(size(self%history), n, table), err)
    end if
    self%n_history = n_history
    call hdf5_update_attribute(self%history_group, 'n_entries', n_history, err)
  end subroutine copy_history

  subroutine copy_steps(self, comm, old, n_kept, err)
    !! Copies the first steps and shows them.
    type(result_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(in) :: old
    integer, intent(in) :: n_kept
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset, group
    integer(i8) :: n_row
    integer :: k, width

    n_row = 0_i8
    do k = 1, n_kept
      call write_whereabouts(self, comm, k, n_row, old%count(k), err)
      n_row = n_row + old%count(k)
    end do
    call copy_integers(comm, old%ids, self%ids, n_row, err)
    call copy_reals(comm, old%points, self%points, 3, n_row, err)
    call hdf5_open_group(old%file%id, 'VTKHDF/PointData', group, err)
    do k = 1, size(self%field)
      call find_dataset(group, self%layout%field(k)%name, width, n_row)
      if (width /= self%layout%field(k)%n_components) cycle
      call hdf5_open_dataset(group, trim(self%layout%field(k)%name), dataset, err)
      call copy_reals(comm, dataset, self%field(k), width, sum(old%count(:n_kept)), err)
      call hdf5_close_dataset(dataset, err)
    end do
    call hdf5_close_group(group, err)
    call copy_sums(self, comm, old, n_kept, err)
    call comm%agree(err)
    if (err%failed()) return
    self%time(:n_kept) = old%time(:n_kept)
    self%count(:n_kept) = old%count(:n_kept)
    self%n_row = sum(old%count(:n_kept))
    call show(self, comm, n_kept, err)
  end subroutine copy_steps

  subroutine copy_sums(self, comm, old, n_kept, err)
    !! Checksums of copied steps: those of the old file, or of zeros for fields that it lacks.
    type(result_file_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(result_file_t), intent(in) :: old
    integer, intent(in) :: n_kept
    type(error_t), intent(inout) :: err
    character(len=64), allocatable :: names(:)
    integer(i8), allocatable :: sums(:)
    type(checksum_t) :: zeros
    integer :: step, k, from, width

    names = summed_names(self%layout)
    do step = 1, n_kept
      sums = old%kept_sums(:n_first_sum, step)
      do k = 1, size(self%layout%field)
        from = findloc(old%summed == names(n_first_sum + k), .true., dim=1)
        width = self%layout%field(k)%n_components
        zeros = checksum_t()
        call zeros%add_zeros(width*old%count(step))
        if (from > 0) then
          sums = [sums, old%kept_sums(from, step)]
        else
          sums = [sums, zeros%value()]
        end if
      end do
      call write_step_sums(self, comm, step, sums, err)
    end do
  end subroutine copy_sums

  integer(i8) function n_history_until(old, comm, time, err) result(n_row)
    !! Rows of the histories up to a time (all of them if there is no history 'time').
    type(result_file_t), intent(in) :: old
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: time   !! [s]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: times(:)
    integer(hid_t) :: dataset
    integer :: n

    n_row = old%n_history
    if (n_row == 0_i8 .or. .not. hdf5_exists(old%history_group, 'time')) return
    n = int(n_row)
    allocate (times(n), source=0.0_wp)
    call hdf5_open_dataset(old%history_group, 'time', dataset, err)
    if (comm%is_root()) call hdf5_read_rows(dataset, 1_i8, n, times, err)
    call comm%broadcast(times)
    call hdf5_close_dataset(dataset, err)
    n_row = count(times <= time + 4.0_wp*spacing(abs(time)), kind=i8)
  end function n_history_until
end module dosui_result_file

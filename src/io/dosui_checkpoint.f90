!! Checkpoints: everything a run needs to go on, written beside the last one and then renamed.
!!
!! Points are stored rank after rank with the number of points of every rank, so that the same
!! number of ranks reads back its own points in their order (a restart then repeats every bit);
!! any other number of ranks reads equal contiguous parts.
module dosui_checkpoint
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_point_set, only: point_set_t
  use dosui_file_exchange, only: remove_file, rename_file, replace_keeping_previous
  use dosui_file_seal, only: check_seal, seal_file
  use dosui_hdf5, only: hid_t, hdf5_file_t, hdf5_real, hdf5_integer, &
                        hdf5_create_group, hdf5_open_group, hdf5_close_group, &
                        hdf5_create_dataset, hdf5_open_dataset, hdf5_close_dataset, &
                        hdf5_dataset_shape, hdf5_write_rows, hdf5_read_rows, &
                        hdf5_write_attribute, hdf5_read_attribute, &
                        hdf5_write_text, hdf5_read_text, hdf5_exists
  implicit none
  private

  character(len=*), parameter :: format_name = 'dosui checkpoint'
  integer(i8), parameter :: format_version = 3_i8

  public :: find_checkpoint

  type, public :: checkpoint_writer_t
    !! Use: begin, any number of write_values and write_set, finish. All are collective; after an
    !! error the rest does nothing and `finish` leaves the earlier checkpoints as they are.
    character(len=:), allocatable, private :: path
    logical, private :: keeps_previous = .true.
    type(hdf5_file_t), private :: file
    integer(hid_t), private :: values = -1_hid_t
  contains
    procedure :: begin => writer_begin
    procedure :: write_values => writer_write_values
    procedure :: write_of_ranks => writer_write_of_ranks
    procedure :: write_set => writer_write_set
    procedure :: finish => writer_finish
  end type checkpoint_writer_t

  type, public :: checkpoint_reader_t
    !! Use: begin, read_values and read_set in any order, finish. All are collective.
    character(len=:), allocatable :: scene_text   !! of the run that wrote the checkpoint
    character(len=:), allocatable :: record       !! likewise, see dosui_scene_record
    character(len=:), allocatable :: git_hash     !! of its source
    integer :: n_ranks = 0                        !! of that run
    logical :: same_ranks = .false.               !! every rank gets back its own points
    type(hdf5_file_t), private :: file
    integer(hid_t), private :: values = -1_hid_t
  contains
    procedure :: begin => reader_begin
    procedure :: has_values => reader_has_values
    procedure :: read_values => reader_read_values
    procedure :: read_of_ranks => reader_read_of_ranks
    procedure :: read_set => reader_read_set
    procedure :: finish => reader_finish
  end type checkpoint_reader_t

contains

  ! ---------------------------------------------------------------- writing

  subroutine writer_begin(self, comm, path, scene_text, git_hash, err, record, keeps_previous)
    !! Starts a checkpoint under the name <path>.tmp.
    class(checkpoint_writer_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path          !! final name
    character(len=*), intent(in) :: scene_text, git_hash
    type(error_t), intent(inout) :: err
    character(len=*), intent(in), optional :: record          !! of the scene
    logical, intent(in), optional :: keeps_previous           !! default: it does
    character(len=:), allocatable :: scene_record

    scene_record = ''
    if (present(record)) scene_record = record
    self%keeps_previous = .true.
    if (present(keeps_previous)) self%keeps_previous = keeps_previous
    self%path = path
    call self%file%create(comm, path//'.tmp', err)
    call comm%agree(err)
    if (err%failed()) return
    call hdf5_write_attribute(self%file%id, 'format', format_name, err)
    call hdf5_write_attribute(self%file%id, 'format_version', format_version, err)
    call hdf5_write_attribute(self%file%id, 'ndim', int(ndim, i8), err)
    call hdf5_write_attribute(self%file%id, 'ranks', int(comm%size, i8), err)
    call hdf5_write_attribute(self%file%id, 'git_hash', git_hash, err)
    call hdf5_write_text(self%file%id, 'scene', scene_text, comm%is_root(), err)
    call hdf5_write_text(self%file%id, 'record', scene_record, comm%is_root(), err)
    call hdf5_create_group(self%file%id, 'values', self%values, err)
    call comm%agree(err)
  end subroutine writer_begin

  subroutine writer_write_values(self, comm, name, values, err)
    !! Stores numbers that are the same on all ranks (time, step, integrals, …), bit for bit.
    class(checkpoint_writer_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset

    if (err%failed()) return
    call hdf5_create_dataset(self%values, name, hdf5_real, 1, size(values, kind=i8), dataset, err)
    if (comm%is_root()) call hdf5_write_rows(dataset, 1_i8, size(values), values, err)
    call comm%agree(err)
    if (.not. err%failed()) call hdf5_close_dataset(dataset, err)
  end subroutine writer_write_values

  subroutine writer_write_of_ranks(self, comm, name, values, err)
    !! Stores numbers of which every rank has its own, as many on all of them, bit for bit.
    class(checkpoint_writer_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset

    if (err%failed()) return
    call hdf5_create_dataset(self%values, name, hdf5_real, 1, &
                             int(comm%size, i8)*size(values), dataset, err)
    call hdf5_write_rows(dataset, int(comm%rank, i8)*size(values) + 1_i8, size(values), values, err)
    call comm%agree(err)
    if (.not. err%failed()) call hdf5_close_dataset(dataset, err)
  end subroutine writer_write_of_ranks

  subroutine writer_write_set(self, comm, name, set, err)
    !! Stores the owned points: ids and every field marked `checkpoint`.
    class(checkpoint_writer_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name      !! e.g. 'particles'
    type(point_set_t), intent(in) :: set
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group, dataset
    integer(i8) :: n_total, first_row
    integer :: k

    if (err%failed()) return
    n_total = comm%sum(int(set%count, i8))
    first_row = comm%prefix_sum(int(set%count, i8)) + 1_i8
    call hdf5_create_group(self%file%id, name, group, err)
    call hdf5_create_dataset(group, 'counts', hdf5_integer, 1, int(comm%size, i8), dataset, err)
    call hdf5_write_rows(dataset, int(comm%rank, i8) + 1_i8, 1, [int(set%count, i8)], err)
    call hdf5_close_dataset(dataset, err)
    call hdf5_create_dataset(group, 'ids', hdf5_integer, 1, n_total, dataset, err)
    if (set%count > 0) call hdf5_write_rows(dataset, first_row, set%count, set%id, err)
    call hdf5_close_dataset(dataset, err)
    call comm%agree(err)
    if (allocated(set%field)) then
      do k = 1, size(set%field)
        if (err%failed()) exit
        if (.not. set%field(k)%checkpoint) cycle
        call hdf5_create_dataset(group, 'field_'//trim(set%field(k)%name), hdf5_real, &
                                 set%field(k)%width, n_total, dataset, err)
        call hdf5_write_attribute(dataset, 'unit', trim(set%field(k)%unit), err)
        if (set%count > 0) call hdf5_write_rows(dataset, first_row, set%field(k)%width, &
                                                set%count, set%field(k)%values, err)
        call hdf5_close_dataset(dataset, err)
        call comm%agree(err)
      end do
    end if
    call hdf5_close_group(group, err)
  end subroutine writer_write_set

  subroutine writer_finish(self, comm, err)
    !! Completes the checkpoint: <path>.tmp gets its seal and becomes path, the one before becomes
    !! <path>.previous. After an error <path>.tmp is removed.
    class(checkpoint_writer_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(error_t), intent(inout) :: err

    if (.not. self%file%is_open()) return
    if (.not. err%failed()) call self%file%flush(err)
    call self%file%close(err)
    self%values = -1_hid_t
    call comm%agree(err)
    if (.not. err%failed()) call seal_file(comm, self%path//'.tmp', err)
    if (err%failed()) then
      if (comm%is_root()) call remove_file(self%path//'.tmp')
      return
    end if
    if (comm%is_root() .and. .not. self%keeps_previous) then
      call rename_file(self%path//'.tmp', self%path, err)
    else if (comm%is_root()) then
      call replace_keeping_previous(self%path//'.tmp', self%path, self%path//'.previous', err)
    end if
    call comm%agree(err)
  end subroutine writer_finish

  ! ---------------------------------------------------------------- reading

  subroutine reader_begin(self, comm, path, err)
    !! Opens a checkpoint and checks that it is one, undamaged and of this dimension.
    class(checkpoint_reader_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: text
    integer(i8) :: version, file_ndim, ranks
    type(error_t) :: missing

    call check_seal(comm, path, err)
    if (err%failed()) return
    call self%file%open(comm, path, .false., err)
    call comm%agree(err)
    if (err%failed()) return
    call hdf5_read_attribute(self%file%id, 'format', text, missing)
    if (text /= format_name) call err%set(path//' is not a checkpoint of dosui')
    call hdf5_read_attribute(self%file%id, 'format_version', version, err)
    if (version /= format_version) then
      call err%set(path//' has another checkpoint format than this version of dosui reads')
    end if
    call hdf5_read_attribute(self%file%id, 'ndim', file_ndim, err)
    if (file_ndim /= ndim) then
      call err%set(path//' is a checkpoint of a '//digit(file_ndim)//'-D run, this program is '// &
                   digit(int(ndim, i8))//'-D')
    end if
    call hdf5_read_attribute(self%file%id, 'ranks', ranks, err)
    self%n_ranks = int(ranks)
    self%same_ranks = self%n_ranks == comm%size
    call hdf5_read_attribute(self%file%id, 'git_hash', self%git_hash, err)
    call hdf5_read_text(self%file%id, 'scene', self%scene_text, err)
    call hdf5_read_text(self%file%id, 'record', self%record, err)
    call hdf5_open_group(self%file%id, 'values', self%values, err)
    call comm%agree(err)
    if (err%failed()) call self%file%close(missing)
  end subroutine reader_begin

  pure character(len=1) function digit(n) result(text)
    integer(i8), intent(in) :: n

    text = '?'
    if (n >= 0_i8 .and. n <= 9_i8) text = achar(iachar('0') + int(n))
  end function digit

  logical function reader_has_values(self, name) result(has)
    !! Were values of this name stored?
    class(checkpoint_reader_t), intent(in) :: self
    character(len=*), intent(in) :: name

    has = .false.
    if (self%file%is_open()) has = hdf5_exists(self%values, name)
  end function reader_has_values

  subroutine reader_read_values(self, comm, name, values, err)
    !! The numbers stored under a name, on all ranks.
    class(checkpoint_reader_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(out) :: values(:)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer(hid_t) :: dataset
    integer(i8) :: n_row
    integer :: width

    allocate (values(0))
    if (err%failed()) return
    if (.not. self%has_values(name)) then
      call err%set("the checkpoint has no values '"//name//"'")
      return
    end if
    call hdf5_open_dataset(self%values, name, dataset, err)
    call hdf5_dataset_shape(dataset, width, n_row, err)
    deallocate (values)
    allocate (values(int(n_row)), source=0.0_wp)
    if (comm%is_root()) call hdf5_read_rows(dataset, 1_i8, int(n_row), values, err)
    call comm%agree(err)
    call comm%broadcast(values)
    call hdf5_close_dataset(dataset, err)
  end subroutine reader_read_values

  subroutine reader_read_of_ranks(self, comm, name, values, err)
    !! Numbers of which every rank has its own: those of this rank on as many ranks as wrote them,
    !! else the sums over all of those on root, and zeros on the other ranks.
    class(checkpoint_reader_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(out) :: values(:)   !! [any unit]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: all_values(:), table(:, :)
    integer :: n

    call self%read_values(comm, name, all_values, err)
    n = size(all_values)/max(1, self%n_ranks)
    table = reshape(all_values, [n, max(1, self%n_ranks)])
    allocate (values(n), source=0.0_wp)
    if (self%same_ranks) then
      values = table(:, comm%rank + 1)
    else if (comm%is_root()) then
      values = sum(table, dim=2)
    end if
  end subroutine reader_read_of_ranks

  subroutine reader_read_set(self, comm, name, set, err)
    !! Reads ids and every field of `set` marked `checkpoint`, whose fields must be registered.
    !!
    !! Other fields keep what `resize` gives them; fields that only the file has are passed over.
    class(checkpoint_reader_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: name
    type(point_set_t), intent(inout) :: set
    type(error_t), intent(inout) :: err
    integer(hid_t) :: group, dataset
    integer(i8) :: n_total, first_row
    integer :: k, n

    if (err%failed()) return
    if (.not. hdf5_exists(self%file%id, name)) then
      call err%set("the checkpoint has no points '"//name//"'")
      return
    end if
    call hdf5_open_group(self%file%id, name, group, err)
    call find_own_rows(self, comm, group, n, first_row, n_total, err)
    call comm%agree(err)
    if (err%failed()) return
    call set%resize(n)
    call hdf5_open_dataset(group, 'ids', dataset, err)
    if (n > 0) call hdf5_read_rows(dataset, first_row, n, set%id, err)
    call hdf5_close_dataset(dataset, err)
    if (allocated(set%field)) then
      do k = 1, size(set%field)
        if (.not. set%field(k)%checkpoint) cycle
        call open_field(group, name, set%field(k)%name, set%field(k)%width, n_total, dataset, err)
        if (err%failed()) exit
        if (n > 0) call hdf5_read_rows(dataset, first_row, set%field(k)%width, n, &
                                       set%field(k)%values, err)
        call hdf5_close_dataset(dataset, err)
      end do
    end if
    call hdf5_close_group(group, err)
    call comm%agree(err)
  end subroutine reader_read_set

  subroutine open_field(group, set_name, name, width, n_total, dataset, err)
    !! Opens a stored field after checking its shape.
    integer(hid_t), intent(in) :: group
    character(len=*), intent(in) :: set_name, name
    integer, intent(in) :: width
    integer(i8), intent(in) :: n_total
    integer(hid_t), intent(out) :: dataset
    type(error_t), intent(inout) :: err
    integer(i8) :: n_row
    integer :: stored_width

    dataset = -1_hid_t
    if (.not. hdf5_exists(group, 'field_'//trim(name))) then
      call err%set("the checkpoint has no field '"//trim(name)//"' of the "//set_name)
      return
    end if
    call hdf5_open_dataset(group, 'field_'//trim(name), dataset, err)
    call hdf5_dataset_shape(dataset, stored_width, n_row, err)
    if (stored_width /= width .or. n_row /= n_total) then
      call err%set("the checkpoint's field '"//trim(name)//"' of the "//set_name// &
                   ' has another shape')
    end if
  end subroutine open_field

  subroutine find_own_rows(self, comm, group, n, first_row, n_total, err)
    !! Which rows of the stored points this rank reads.
    type(checkpoint_reader_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    integer(hid_t), intent(in) :: group
    integer, intent(out) :: n
    integer(i8), intent(out) :: first_row, n_total
    type(error_t), intent(inout) :: err
    integer(i8), allocatable :: counts(:)
    integer(hid_t) :: dataset
    integer(i8) :: n_row, before, until
    integer :: width

    n = 0
    first_row = 1_i8
    n_total = 0_i8
    call hdf5_open_dataset(group, 'counts', dataset, err)
    call hdf5_dataset_shape(dataset, width, n_row, err)
    if (n_row /= self%n_ranks) call err%set('the checkpoint contradicts itself')
    if (err%failed()) return
    allocate (counts(self%n_ranks), source=0_i8)
    if (comm%is_root()) call hdf5_read_rows(dataset, 1_i8, self%n_ranks, counts, err)
    call comm%broadcast(counts)
    call hdf5_close_dataset(dataset, err)
    n_total = sum(counts)
    if (self%same_ranks) then
      before = sum(counts(:comm%rank))
      until = before + counts(comm%rank + 1)
    else
      before = share_end(n_total, comm%rank, comm%size)
      until = share_end(n_total, comm%rank + 1, comm%size)
    end if
    first_row = before + 1_i8
    n = int(until - before)
  end subroutine find_own_rows

  pure integer(i8) function share_end(n, n_parts_before, n_part) result(last)
    !! Rows in the first n_parts_before of n_part nearly equal parts.
    integer(i8), intent(in) :: n
    integer, intent(in) :: n_parts_before, n_part

    last = n_parts_before*(n/n_part) + min(int(n_parts_before, i8), mod(n, int(n_part, i8)))
  end function share_end

  subroutine reader_finish(self, comm, err)
    class(checkpoint_reader_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(error_t), intent(inout) :: err

    if (.not. self%file%is_open()) return
    call self%file%close(err)
    self%values = -1_hid_t
    call comm%agree(err)
  end subroutine reader_finish
  subroutine find_checkpoint(comm, path, found, note, err)
    !! The checkpoint to go on from: the one at `path` if it is undamaged, else the one before it.
    !! An error only if there are some, but none of them is undamaged. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: found   !! '' if there is none
    character(len=:), allocatable, intent(out) :: note    !! why it is not the one at `path`; or ''
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: candidate
    type(error_t) :: damage
    logical :: exists
    integer :: k

    found = ''
    note = ''
    candidate = ''
    do k = 1, 2
      candidate = path
      if (k == 2) candidate = path//'.previous'
      exists = .false.
      if (comm%is_root()) inquire (file=candidate, exist=exists)
      call comm%broadcast(exists)
      if (.not. exists) cycle
      damage = error_t()
      call check_seal(comm, candidate, damage)
      if (.not. damage%failed()) then
        found = candidate
        return
      end if
      if (len(note) == 0) note = damage%message
    end do
    if (len(note) > 0) call err%set(note)
  end subroutine find_checkpoint
end module dosui_checkpoint

!! Thin wrapper of parallel HDF5: one file shared by all ranks, errors as values.
!!
!! Fortran arrays (width, n) appear in the file as (n, width): a "row" is one point or one step.
!! Calls that change the file's structure (files, groups, datasets, attributes, links, flush) are
!! collective. Reading and writing of rows is independent: every rank does it for its own rows or
!! not at all. (Independent writes of contiguous slices are the faster ones on local disks, and a
!! full disk seen by one rank cannot hang the others.)
module dosui_hdf5
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_f_pointer, c_funloc, c_funptr
  use, intrinsic :: iso_c_binding, only: c_int, c_int64_t, c_loc, c_null_char, c_ptr, c_size_t
  use hdf5, only: hid_t, hsize_t, size_t, h5_integer_kind, h5kind_to_type, &
                  h5open_f, h5iis_valid_f, h5eset_auto_f, &
                  h5fcreate_f, h5fopen_f, h5fflush_f, h5fclose_f, h5fis_hdf5_f, h5fget_name_f, &
                  h5f_obj_all_f, h5f_obj_file_f, &
                  h5pcreate_f, h5pclose_f, h5pset_fapl_mpio_f, h5pset_libver_bounds_f, &
                  h5pset_fclose_degree_f, h5pset_chunk_f, h5pset_alloc_time_f, &
                  h5pset_fill_time_f, h5pset_obj_track_times_f, &
                  h5gcreate_f, h5gopen_f, h5gclose_f, h5gget_info_f, &
                  h5dcreate_f, h5dopen_f, h5dclose_f, h5dget_space_f, h5dwrite_f, h5dread_f, &
                  h5dget_type_f, h5dset_extent_f, &
                  h5screate_f, h5screate_simple_f, h5sclose_f, h5sselect_hyperslab_f, &
                  h5sget_simple_extent_ndims_f, h5sget_simple_extent_dims_f, &
                  h5acreate_f, h5aopen_f, h5aclose_f, h5awrite_f, h5aread_f, h5aexists_f, &
                  h5aget_type_f, &
                  h5tcopy_f, h5tclose_f, h5tset_size_f, h5tget_size_f, h5tset_strpad_f, &
                  h5tset_cset_f, h5lexists_f, h5ldelete_f, h5lcreate_soft_f, h5lcreate_hard_f, &
                  h5p_file_access_f, h5p_file_create_f, h5p_dataset_create_f, &
                  h5p_group_create_f, h5p_default_f, h5f_acc_trunc_f, h5f_acc_rdonly_f, &
                  h5f_acc_rdwr_f, h5f_libver_v18_f, h5f_close_strong_f, h5f_scope_global_f, &
                  h5d_alloc_time_early_f, h5d_fill_time_never_f, h5s_select_set_f, h5s_scalar_f, &
                  h5t_native_double, h5t_ieee_f64le, h5t_std_i64le, h5t_fortran_s1, &
                  h5t_str_nullpad_f, h5t_cset_utf8_f, h5t_cset_ascii_f
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_file_system, only: create_anew, input_problem, writing_problem
  use dosui_communicator, only: communicator_t
  use dosui_mpi_hints, only: no_mpi_hints
  implicit none
  private

  public :: hid_t, hdf5_has_open_files
  public :: hdf5_create_group, hdf5_open_group, hdf5_close_group
  public :: hdf5_create_dataset, hdf5_open_dataset, hdf5_close_dataset
  public :: hdf5_dataset_shape, hdf5_resize_dataset
  public :: hdf5_write_rows, hdf5_read_rows
  public :: hdf5_write_attribute, hdf5_read_attribute, hdf5_update_attribute
  public :: hdf5_write_text, hdf5_read_text
  public :: hdf5_exists, hdf5_n_links
  public :: hdf5_create_soft_link, hdf5_create_hard_link, hdf5_remove_link

  integer, parameter, public :: hdf5_real = 1       !! dataset of real(wp)
  integer, parameter, public :: hdf5_integer = 2    !! dataset of integer(i8)

  character(len=5), parameter :: suffix(2) = ['.part', '.tmp ']   !! of files being written
  integer, parameter :: largest_transfer = 2**26    !! numbers a call (MPI counts are 32 bit)

  type, public :: hdf5_file_t
    !! One open file; every rank of the communicator holds one.
    integer(hid_t) :: id = -1_hid_t
    character(len=:), allocatable :: path
    logical, private :: is_writable = .false.
  contains
    procedure :: create => file_create
    procedure :: open => file_open
    procedure :: flush => file_flush
    procedure :: close => file_close
    procedure :: is_open => file_is_open
  end type hdf5_file_t

  interface hdf5_write_rows
    !! Writes rows first_row, first_row + 1, … (counted from 1) of a dataset, independently.
    module procedure write_rows_real1, write_rows_real2, write_rows_integer1, write_rows_integer2
  end interface hdf5_write_rows

  interface hdf5_read_rows
    !! Reads rows first_row, first_row + 1, … (counted from 1) of a dataset, independently.
    module procedure read_rows_real1, read_rows_real2, read_rows_integer1, read_rows_integer2
  end interface hdf5_read_rows

  interface hdf5_write_attribute
    !! Creates an attribute (64-bit integers or text) of an object. Collective.
    module procedure write_attribute_integer, write_attribute_integers, write_attribute_text
  end interface hdf5_write_attribute

  interface hdf5_read_attribute
    module procedure read_attribute_integer, read_attribute_text
  end interface hdf5_read_attribute

  type, bind(c) :: hdf5_error_entry_t
    !! H5E_error2_t of H5Epublic.h
    integer(c_int64_t) :: class_id, major, minor
    integer(c_int) :: line
    type(c_ptr) :: function_name, file_name, description
  end type hdf5_error_entry_t

  type, bind(c) :: error_text_t
    integer(c_int) :: length = 0
    character(kind=c_char) :: text(1024) = ' '
  end type error_text_t

  interface
    integer(c_int) function h5ewalk2(stack, direction, visit, client) bind(c, name='H5Ewalk2')
      import :: c_int, c_int64_t, c_funptr, c_ptr
      implicit none
      integer(c_int64_t), value :: stack
      integer(c_int), value :: direction
      type(c_funptr), value :: visit
      type(c_ptr), value :: client
    end function h5ewalk2
    integer(c_size_t) function h5fget_obj_count(file, kinds) bind(c, name='H5Fget_obj_count')
      import :: c_int, c_int64_t, c_size_t
      implicit none
      integer(c_int64_t), value :: file
      integer(c_int), value :: kinds
    end function h5fget_obj_count
  end interface

contains

  ! ---------------------------------------------------------------- files

  subroutine file_create(self, comm, path, err)
    !! Creates a file, replacing an existing one. Collective.
    class(hdf5_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(hid_t) :: access, creation
    integer :: status

    call start_library(err)
    if (comm%is_root() .and. .not. err%failed()) call create_anew(path, err)
    call comm%agree(err)
    if (err%failed()) return
    access = file_access(comm)
    creation = without_times(h5p_file_create_f)
    self%path = path
    call h5fcreate_f(path, h5f_acc_trunc_f, self%id, status, creation, access)
    call check_writing(status, path, err)
    if (status < 0) self%id = -1_hid_t
    self%is_writable = .true.
    call close_property(access)
    call close_property(creation)
  end subroutine file_create

  subroutine file_open(self, comm, path, writable, err)
    !! Opens an existing file. Collective.
    class(hdf5_file_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    logical, intent(in) :: writable
    type(error_t), intent(inout) :: err
    integer(hid_t) :: access
    integer :: status
    character(len=:), allocatable :: reason
    logical :: is_hdf5

    call start_library(err)
    if (comm%is_root() .and. .not. err%failed()) then
      reason = input_problem(path)   ! a pipe would wait for ever
      if (reason == 'no such file') call err%set('there is no file '//path)
      if (len(reason) > 0) call err%set('cannot open '//path//': '//reason)
      if (len(reason) == 0) then
        call h5fis_hdf5_f(path, is_hdf5, status)
        if (status < 0 .or. .not. is_hdf5) call err%set(path//' is not an HDF5 file')
      end if
    end if
    call comm%agree(err)
    if (err%failed()) return
    access = file_access(comm)
    self%path = path
    self%is_writable = writable
    call h5fopen_f(path, merge(h5f_acc_rdwr_f, h5f_acc_rdonly_f, writable), self%id, status, access)
    call check(status, 'cannot open the file '//path, err)
    if (status < 0) self%id = -1_hid_t
    call close_property(access)
  end subroutine file_open

  subroutine file_flush(self, err)
    !! Hands everything written so far to the operating system. Collective.
    class(hdf5_file_t), intent(in) :: self
    type(error_t), intent(inout) :: err
    integer :: status

    call h5fflush_f(self%id, h5f_scope_global_f, status)
    call check_writing(status, self%path, err)
  end subroutine file_flush

  subroutine file_close(self, err)
    !! Closes the file and every object of it still open. Collective.
    !!
    !! After an error, or if the rest cannot be written, a writable file stays open: HDF5 1.10
    !! frees a file whose closing fails, but remembers it and crashes when the library ends.
    class(hdf5_file_t), intent(inout) :: self
    type(error_t), intent(inout) :: err
    integer :: status

    if (.not. self%is_open()) return
    if (self%is_writable) then
      call h5fflush_f(self%id, h5f_scope_global_f, status)
      call check_writing(status, self%path, err)
    end if
    if (.not. (self%is_writable .and. err%failed())) then
      call h5fclose_f(self%id, status)
      call check_writing(status, self%path, err)
    end if
    self%id = -1_hid_t
  end subroutine file_close

  pure logical function file_is_open(self) result(is_open)
    class(hdf5_file_t), intent(in) :: self

    is_open = self%id >= 0_hid_t
  end function file_is_open

  logical function hdf5_has_open_files() result(has)
    !! Are there files that could not be closed? MPI must not be ended then: it ends HDF5, which
    !! crashes on them.
    integer :: status

    has = .false.
    call h5iis_valid_f(h5t_native_double, has, status)   ! has the library been started?
    ! HDF5's own Fortran function subtracts the predefined types, which are no files
    if (has) has = h5fget_obj_count(int(h5f_obj_all_f, c_int64_t), int(h5f_obj_file_f, c_int)) > 0
  end function hdf5_has_open_files

  ! ---------------------------------------------------------------- groups, links

  subroutine hdf5_create_group(parent, name, group, err)
    !! Creates and opens a group of a file or group. Collective.
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer(hid_t), intent(out) :: group
    type(error_t), intent(inout) :: err
    integer(hid_t) :: creation
    integer :: status

    creation = without_times(h5p_group_create_f)
    call h5gcreate_f(parent, name, group, status, gcpl_id=creation)
    call check(status, 'cannot create the group '//name, err)
    call close_property(creation)
  end subroutine hdf5_create_group

  subroutine hdf5_open_group(parent, name, group, err)
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer(hid_t), intent(out) :: group
    type(error_t), intent(inout) :: err
    integer :: status

    call h5gopen_f(parent, name, group, status)
    call check(status, 'no group '//name, err)
  end subroutine hdf5_open_group

  subroutine hdf5_close_group(group, err)
    integer(hid_t), intent(inout) :: group
    type(error_t), intent(inout) :: err
    integer :: status

    if (group < 0_hid_t) return
    call h5gclose_f(group, status)
    call check(status, 'cannot close a group', err)
    group = -1_hid_t
  end subroutine hdf5_close_group

  logical function hdf5_exists(parent, name) result(exists)
    !! Does the object have a link of this name? (Intermediate groups of a path must exist.)
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer :: status

    call h5lexists_f(parent, name, exists, status)
    if (status < 0) exists = .false.
  end function hdf5_exists

  integer function hdf5_n_links(group) result(n)
    !! Number of objects in a group; 0 if it cannot be told.
    integer(hid_t), intent(in) :: group
    integer :: storage, largest_order, status

    call h5gget_info_f(group, storage, n, largest_order, status)
    if (status < 0) n = 0
  end function hdf5_n_links

  subroutine hdf5_create_soft_link(parent, name, target_path, err)
    !! Links a name to a path of the same file. Collective.
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name, target_path
    type(error_t), intent(inout) :: err
    integer :: status

    call h5lcreate_soft_f(target_path, parent, name, status)
    call check(status, 'cannot link '//name, err)
  end subroutine hdf5_create_soft_link

  subroutine hdf5_create_hard_link(old_parent, old_name, parent, name, err)
    !! Gives an object a second name. Collective.
    integer(hid_t), intent(in) :: old_parent, parent
    character(len=*), intent(in) :: old_name, name
    type(error_t), intent(inout) :: err
    integer :: status

    call h5lcreate_hard_f(old_parent, old_name, parent, name, status)
    call check(status, 'cannot link '//name, err)
  end subroutine hdf5_create_hard_link

  subroutine hdf5_remove_link(parent, name, err)
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    type(error_t), intent(inout) :: err
    integer :: status

    call h5ldelete_f(parent, name, status)
    call check(status, 'cannot unlink '//name, err)
  end subroutine hdf5_remove_link

  ! ---------------------------------------------------------------- datasets

  subroutine hdf5_create_dataset(parent, name, kind, width, n_row, dataset, err, n_row_max)
    !! Creates and opens a dataset (n_row) or, for width > 1, (n_row, width). Collective.
    !!
    !! Its space is reserved at once but not written, so that nothing of the file's structure
    !! changes afterwards: a sparse file takes disk space only as rows are written.
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer, intent(in) :: kind             !! hdf5_real or hdf5_integer
    integer, intent(in) :: width            !! numbers a row
    integer(i8), intent(in) :: n_row
    integer(hid_t), intent(out) :: dataset
    type(error_t), intent(inout) :: err
    integer(i8), intent(in), optional :: n_row_max   !! rows it may be resized to
    integer(hid_t) :: space, creation
    integer(hsize_t) :: extent(2), largest(2)
    integer :: rank, status

    rank = merge(1, 2, width == 1)
    extent = [int(width, hsize_t), int(n_row, hsize_t)]
    largest = extent
    if (present(n_row_max)) largest(2) = int(n_row_max, hsize_t)
    if (rank == 1) extent(1) = extent(2)
    if (rank == 1) largest(1) = largest(2)
    creation = without_times(h5p_dataset_create_f)
    call h5pset_alloc_time_f(creation, h5d_alloc_time_early_f, status)
    call h5pset_fill_time_f(creation, h5d_fill_time_never_f, status)
    ! One chunk of the largest size: its place in the file stays when the size changes.
    if (present(n_row_max)) call h5pset_chunk_f(creation, rank, largest(:rank), status)
    call h5screate_simple_f(rank, extent(:rank), space, status, largest(:rank))
    call h5dcreate_f(parent, name, merge(h5t_ieee_f64le, h5t_std_i64le, kind == hdf5_real), space, &
                     dataset, status, dcpl_id=creation)
    call check(status, 'cannot create the dataset '//name, err)
    call h5sclose_f(space, status)
    call close_property(creation)
  end subroutine hdf5_create_dataset

  subroutine hdf5_open_dataset(parent, name, dataset, err)
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer(hid_t), intent(out) :: dataset
    type(error_t), intent(inout) :: err
    integer :: status

    call h5dopen_f(parent, name, dataset, status)
    call check(status, 'no dataset '//name, err)
    if (status < 0) dataset = -1_hid_t
  end subroutine hdf5_open_dataset

  subroutine hdf5_close_dataset(dataset, err)
    integer(hid_t), intent(inout) :: dataset
    type(error_t), intent(inout) :: err
    integer :: status

    if (dataset < 0_hid_t) return
    call h5dclose_f(dataset, status)
    call check(status, 'cannot close a dataset', err)
    dataset = -1_hid_t
  end subroutine hdf5_close_dataset

  subroutine hdf5_dataset_shape(dataset, width, n_row, err)
    !! Numbers a row and rows of a dataset of one or two dimensions.
    integer(hid_t), intent(in) :: dataset
    integer, intent(out) :: width
    integer(i8), intent(out) :: n_row
    type(error_t), intent(inout) :: err
    integer(hid_t) :: space
    integer(hsize_t) :: extent(2), largest(2)
    integer :: rank, status

    width = 0
    n_row = 0_i8
    call h5dget_space_f(dataset, space, status)
    call check(status, 'cannot read the shape of a dataset', err)
    if (status < 0) return
    call h5sget_simple_extent_ndims_f(space, rank, status)
    if (rank == 1 .or. rank == 2) then
      call h5sget_simple_extent_dims_f(space, extent(:rank), largest(:rank), status)
      width = 1
      if (rank == 2) width = int(extent(1))
      n_row = int(extent(rank), i8)
    else
      call err%set('a dataset has neither one nor two dimensions')
    end if
    call h5sclose_f(space, status)
  end subroutine hdf5_dataset_shape

  subroutine hdf5_resize_dataset(dataset, n_row, err)
    !! Sets the number of rows of a one-dimensional dataset created with n_row_max. Collective.
    !!
    !! After lowering it, flush before writing rows: HDF5 keeps the old ones until then.
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: n_row   !! at most the number it was created with
    type(error_t), intent(inout) :: err
    integer :: status

    call h5dset_extent_f(dataset, [int(n_row, hsize_t)], status)
    call check(status, 'cannot resize a dataset', err)
  end subroutine hdf5_resize_dataset

  subroutine write_rows_real1(dataset, first_row, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: n
    real(wp), intent(in), target :: values(n)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer :: i, m

    do i = 1, n, largest_transfer
      m = min(largest_transfer, n - i + 1)
      call transfer_rows(.true., dataset, h5t_native_double, 1, m, first_row + i - 1, &
                         c_loc(values(i)), err)
    end do
  end subroutine write_rows_real1

  subroutine write_rows_real2(dataset, first_row, width, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: width, n
    real(wp), intent(in), target :: values(width, n)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer :: i, m, step

    step = max(1, largest_transfer/max(1, width))
    do i = 1, n, step
      m = min(step, n - i + 1)
      call transfer_rows(.true., dataset, h5t_native_double, width, m, first_row + i - 1, &
                         c_loc(values(1, i)), err)
    end do
  end subroutine write_rows_real2

  subroutine write_rows_integer1(dataset, first_row, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: n
    integer(i8), intent(in), target :: values(n)
    type(error_t), intent(inout) :: err
    integer :: i, m

    do i = 1, n, largest_transfer
      m = min(largest_transfer, n - i + 1)
      call transfer_rows(.true., dataset, h5kind_to_type(i8, h5_integer_kind), 1, m, &
                         first_row + i - 1, c_loc(values(i)), err)
    end do
  end subroutine write_rows_integer1

  subroutine write_rows_integer2(dataset, first_row, width, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: width, n
    integer(i8), intent(in), target :: values(width, n)
    type(error_t), intent(inout) :: err
    integer :: i, m, step

    step = max(1, largest_transfer/max(1, width))
    do i = 1, n, step
      m = min(step, n - i + 1)
      call transfer_rows(.true., dataset, h5kind_to_type(i8, h5_integer_kind), width, m, &
                         first_row + i - 1, c_loc(values(1, i)), err)
    end do
  end subroutine write_rows_integer2

  subroutine read_rows_real1(dataset, first_row, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: n
    real(wp), intent(inout), target :: values(n)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer :: i, m

    do i = 1, n, largest_transfer
      m = min(largest_transfer, n - i + 1)
      call transfer_rows(.false., dataset, h5t_native_double, 1, m, first_row + i - 1, &
                         c_loc(values(i)), err)
    end do
  end subroutine read_rows_real1

  subroutine read_rows_real2(dataset, first_row, width, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: width, n
    real(wp), intent(inout), target :: values(width, n)   !! [any unit]
    type(error_t), intent(inout) :: err
    integer :: i, m, step

    step = max(1, largest_transfer/max(1, width))
    do i = 1, n, step
      m = min(step, n - i + 1)
      call transfer_rows(.false., dataset, h5t_native_double, width, m, first_row + i - 1, &
                         c_loc(values(1, i)), err)
    end do
  end subroutine read_rows_real2

  subroutine read_rows_integer1(dataset, first_row, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: n
    integer(i8), intent(inout), target :: values(n)
    type(error_t), intent(inout) :: err
    integer :: i, m

    do i = 1, n, largest_transfer
      m = min(largest_transfer, n - i + 1)
      call transfer_rows(.false., dataset, h5kind_to_type(i8, h5_integer_kind), 1, m, &
                         first_row + i - 1, c_loc(values(i)), err)
    end do
  end subroutine read_rows_integer1

  subroutine read_rows_integer2(dataset, first_row, width, n, values, err)
    integer(hid_t), intent(in) :: dataset
    integer(i8), intent(in) :: first_row
    integer, intent(in) :: width, n
    integer(i8), intent(inout), target :: values(width, n)
    type(error_t), intent(inout) :: err
    integer :: i, m, step

    step = max(1, largest_transfer/max(1, width))
    do i = 1, n, step
      m = min(step, n - i + 1)
      call transfer_rows(.false., dataset, h5kind_to_type(i8, h5_integer_kind), width, m, &
                         first_row + i - 1, c_loc(values(1, i)), err)
    end do
  end subroutine read_rows_integer2

  subroutine transfer_rows(is_write, dataset, number_type, width, n, first_row, buffer, err)
    !! Moves n rows between memory and the file; nothing once an error has occurred.
    logical, intent(in) :: is_write
    integer(hid_t), intent(in) :: dataset, number_type
    integer, intent(in) :: width, n
    integer(i8), intent(in) :: first_row
    type(c_ptr), intent(in) :: buffer
    type(error_t), intent(inout) :: err
    integer(hid_t) :: file_space, memory_space
    integer(hsize_t) :: start(2), extent(2)
    type(c_ptr) :: address
    integer :: rank, status, ignored

    if (err%failed() .or. n == 0) return
    address = buffer
    start = [0_hsize_t, int(first_row - 1_i8, hsize_t)]
    extent = [int(width, hsize_t), int(n, hsize_t)]
    rank = 2
    if (width == 1) then
      rank = 1
      start(1) = start(2)
      extent(1) = extent(2)
    end if
    call h5dget_space_f(dataset, file_space, status)
    call check(status, 'no such dataset', err)
    if (status < 0) return
    call h5sselect_hyperslab_f(file_space, h5s_select_set_f, start(:rank), extent(:rank), status)
    call check(status, 'cannot select rows', err)
    call h5screate_simple_f(rank, extent(:rank), memory_space, ignored)
    if (status >= 0) then
      if (is_write) then
        call h5dwrite_f(dataset, number_type, address, status, memory_space, file_space)
        call check_writing(status, file_name_of(dataset), err)
      else
        call h5dread_f(dataset, number_type, address, status, memory_space, file_space)
        call check(status, 'cannot read', err, dataset)
      end if
    end if
    call h5sclose_f(memory_space, ignored)
    call h5sclose_f(file_space, ignored)
  end subroutine transfer_rows

  function file_name_of(dataset) result(name)
    !! The path of the file that a dataset is in.
    integer(hid_t), intent(in) :: dataset
    character(len=:), allocatable :: name
    character(len=4096) :: buffer
    integer(size_t) :: length
    integer :: status

    call h5fget_name_f(dataset, buffer, length, status)
    name = 'a file'
    if (status >= 0) name = buffer(:min(int(length), len(buffer)))
  end function file_name_of

  ! ---------------------------------------------------------------- attributes and texts

  subroutine write_attribute_integer(object, name, value, err)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: value
    type(error_t), intent(inout) :: err
    integer(i8), target :: buffer
    integer(hid_t) :: space, attribute
    type(c_ptr) :: address
    integer :: status

    buffer = value
    address = c_loc(buffer)
    call h5screate_f(h5s_scalar_f, space, status)
    call h5acreate_f(object, name, h5t_std_i64le, space, attribute, status)
    call check(status, 'cannot create the attribute '//name, err)
    call h5awrite_f(attribute, h5kind_to_type(i8, h5_integer_kind), address, status)
    call check_writing(status, file_name_of(object), err)
    call h5aclose_f(attribute, status)
    call h5sclose_f(space, status)
  end subroutine write_attribute_integer

  subroutine write_attribute_integers(object, name, values, err)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: values(:)
    type(error_t), intent(inout) :: err
    integer(i8), allocatable, target :: buffer(:)
    integer(hid_t) :: space, attribute
    type(c_ptr) :: address
    integer :: status

    allocate (buffer(size(values)), source=values)
    address = c_loc(buffer)
    call h5screate_simple_f(1, [int(size(values), hsize_t)], space, status)
    call h5acreate_f(object, name, h5t_std_i64le, space, attribute, status)
    call check(status, 'cannot create the attribute '//name, err)
    call h5awrite_f(attribute, h5kind_to_type(i8, h5_integer_kind), address, status)
    call check_writing(status, file_name_of(object), err)
    call h5aclose_f(attribute, status)
    call h5sclose_f(space, status)
  end subroutine write_attribute_integers

  subroutine write_attribute_text(object, name, value, err)
    !! Attributes are ASCII of fixed length (what VTK expects); an empty text becomes one blank.
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name, value
    type(error_t), intent(inout) :: err
    character(len=max(1, len(value))), target :: buffer
    integer(hid_t) :: space, attribute, text_type
    type(c_ptr) :: address
    integer :: status

    buffer = value
    address = c_loc(buffer)
    text_type = new_text_type(len(buffer), h5t_cset_ascii_f)
    call h5screate_f(h5s_scalar_f, space, status)
    call h5acreate_f(object, name, text_type, space, attribute, status)
    call check(status, 'cannot create the attribute '//name, err)
    call h5awrite_f(attribute, text_type, address, status)
    call check_writing(status, file_name_of(object), err)
    call h5aclose_f(attribute, status)
    call h5sclose_f(space, status)
    call h5tclose_f(text_type, status)
  end subroutine write_attribute_text

  subroutine hdf5_update_attribute(object, name, value, err)
    !! Overwrites an existing integer attribute in place. Collective.
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: value
    type(error_t), intent(inout) :: err
    integer(i8), target :: buffer
    integer(hid_t) :: attribute
    type(c_ptr) :: address
    integer :: status

    buffer = value
    address = c_loc(buffer)
    call h5aopen_f(object, name, attribute, status)
    call check(status, 'no attribute '//name, err)
    if (status < 0) return
    call h5awrite_f(attribute, h5kind_to_type(i8, h5_integer_kind), address, status)
    call check_writing(status, file_name_of(object), err)
    call h5aclose_f(attribute, status)
  end subroutine hdf5_update_attribute

  subroutine read_attribute_integer(object, name, value, err)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(out) :: value
    type(error_t), intent(inout) :: err
    integer(i8), target :: buffer
    integer(hid_t) :: attribute
    type(c_ptr) :: address
    integer :: status

    value = 0_i8
    call open_attribute(object, name, attribute, err)
    if (err%failed()) return
    buffer = 0_i8
    address = c_loc(buffer)
    call h5aread_f(attribute, h5kind_to_type(i8, h5_integer_kind), address, status)
    call check(status, 'cannot read the attribute '//name, err)
    call h5aclose_f(attribute, status)
    value = buffer
  end subroutine read_attribute_integer

  subroutine read_attribute_text(object, name, value, err)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    character(len=:), allocatable, intent(out) :: value
    type(error_t), intent(inout) :: err
    integer(hid_t) :: attribute, text_type
    integer(size_t) :: length
    integer :: status

    value = ''
    call open_attribute(object, name, attribute, err)
    if (err%failed()) return
    call h5aget_type_f(attribute, text_type, status)
    call h5tget_size_f(text_type, length, status)
    call check(status, 'cannot read the attribute '//name, err)
    if (status >= 0) call read_text_attribute(attribute, text_type, int(length), value, err)
    call h5tclose_f(text_type, status)
    call h5aclose_f(attribute, status)
  end subroutine read_attribute_text

  subroutine read_text_attribute(attribute, text_type, length, value, err)
    integer(hid_t), intent(in) :: attribute, text_type
    integer, intent(in) :: length
    character(len=:), allocatable, intent(out) :: value
    type(error_t), intent(inout) :: err
    character(len=length), target :: buffer
    type(c_ptr) :: address
    integer :: status

    buffer = ''
    address = c_loc(buffer)
    call h5aread_f(attribute, text_type, address, status)
    call check(status, 'cannot read an attribute', err)
    value = buffer
  end subroutine read_text_attribute

  subroutine open_attribute(object, name, attribute, err)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(hid_t), intent(out) :: attribute
    type(error_t), intent(inout) :: err
    logical :: exists
    integer :: status

    attribute = -1_hid_t
    call h5aexists_f(object, name, exists, status)
    if (status < 0 .or. .not. exists) then
      call err%set('no attribute '//name)
      return
    end if
    call h5aopen_f(object, name, attribute, status)
    call check(status, 'no attribute '//name, err)
  end subroutine open_attribute

  subroutine hdf5_write_text(parent, name, text, is_writer, err)
    !! Stores a text of any length (UTF-8) as a dataset of one string. Collective; one rank writes.
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name, text
    logical, intent(in) :: is_writer   !! true on one rank
    type(error_t), intent(inout) :: err
    character(len=:), allocatable, target :: buffer
    integer(hid_t) :: space, dataset, text_type, creation
    type(c_ptr) :: address
    integer :: status

    buffer = text
    if (len(buffer) == 0) buffer = ' '
    text_type = new_text_type(len(buffer), h5t_cset_utf8_f)
    creation = without_times(h5p_dataset_create_f)
    call h5pset_alloc_time_f(creation, h5d_alloc_time_early_f, status)
    call h5screate_f(h5s_scalar_f, space, status)
    call h5dcreate_f(parent, name, text_type, space, dataset, status, dcpl_id=creation)
    call check(status, 'cannot create the text '//name, err)
    if (status >= 0 .and. is_writer) then
      address = c_loc(buffer)
      call h5dwrite_f(dataset, text_type, address, status)
      call check_writing(status, file_name_of(parent), err)
    end if
    if (dataset >= 0_hid_t) call h5dclose_f(dataset, status)
    call h5sclose_f(space, status)
    call h5tclose_f(text_type, status)
    call close_property(creation)
  end subroutine hdf5_write_text

  subroutine hdf5_read_text(parent, name, text, err)
    integer(hid_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    character(len=:), allocatable, intent(out) :: text
    type(error_t), intent(inout) :: err
    character(len=:), allocatable, target :: buffer
    integer(hid_t) :: dataset, text_type
    integer(size_t) :: length
    type(c_ptr) :: address
    integer :: status

    text = ''
    call h5dopen_f(parent, name, dataset, status)
    call check(status, 'no text '//name, err)
    if (status < 0) return
    call h5dget_type_f(dataset, text_type, status)
    call h5tget_size_f(text_type, length, status)
    allocate (character(len=int(length)) :: buffer)
    address = c_loc(buffer)
    call h5dread_f(dataset, text_type, address, status)
    call check(status, 'cannot read the text '//name, err)
    if (status >= 0) text = buffer
    call h5tclose_f(text_type, status)
    call h5dclose_f(dataset, status)
  end subroutine hdf5_read_text

  ! ---------------------------------------------------------------- below the surface

  subroutine start_library(err)
    !! Initialises HDF5's Fortran constants once and silences its own printing of errors.
    type(error_t), intent(inout) :: err
    logical :: is_started
    integer :: status

    call h5iis_valid_f(h5t_native_double, is_started, status)
    if (is_started) return
    call h5open_f(status)
    if (status < 0) call err%set('the HDF5 library does not start')
    call h5eset_auto_f(0, status)
  end subroutine start_library

  integer(hid_t) function file_access(comm) result(access)
    !! MPI-IO; format of HDF5 1.8, which every reader knows and which has no "open for writing" mark
    !! that a killed run would leave behind.
    type(communicator_t), intent(in) :: comm
    integer :: status

    call h5pcreate_f(h5p_file_access_f, access, status)
    call h5pset_fapl_mpio_f(access, comm%handle%mpi_val, no_mpi_hints(), status)
    call h5pset_libver_bounds_f(access, h5f_libver_v18_f, h5f_libver_v18_f, status)
    call h5pset_fclose_degree_f(access, h5f_close_strong_f, status)
  end function file_access

  integer(hid_t) function without_times(property_class) result(property)
    !! Creation properties without time stamps: the same run gives the same bytes.
    integer(hid_t), intent(in) :: property_class
    integer :: status

    call h5pcreate_f(property_class, property, status)
    call h5pset_obj_track_times_f(property, .false., status)
  end function without_times

  subroutine close_property(property)
    integer(hid_t), intent(in) :: property
    integer :: status

    call h5pclose_f(property, status)
  end subroutine close_property

  integer(hid_t) function new_text_type(length, character_set) result(text_type)
    integer, intent(in) :: length, character_set
    integer :: status

    call h5tcopy_f(h5t_fortran_s1, text_type, status)
    call h5tset_size_f(text_type, int(length, size_t), status)
    call h5tset_strpad_f(text_type, h5t_str_nullpad_f, status)
    call h5tset_cset_f(text_type, character_set, status)
  end function new_text_type

  subroutine check(status, action, err, object)
    !! Turns a failed HDF5 call into an error: the action and HDF5's innermost reason.
    integer, intent(in) :: status
    character(len=*), intent(in) :: action
    type(error_t), intent(inout) :: err
    integer(hid_t), intent(in), optional :: object   !! names the file behind the action
    type(error_text_t), target :: reason
    character(len=:), allocatable :: text
    integer(c_int) :: walked
    integer :: i

    if (status >= 0) return
    walked = h5ewalk2(0_c_int64_t, 0_c_int, c_funloc(keep_description), c_loc(reason))
    text = ''
    do i = 1, reason%length
      text = text//reason%text(i)
    end do
    if (walked < 0 .or. len(text) == 0) text = 'HDF5 gives no reason'
    if (present(object)) then
      call err%set(action//' '//file_name_of(object)//' ('//text//')')
    else
      call err%set(action//' ('//text//')')
    end if
  end subroutine check

  subroutine check_writing(status, path, err)
    !! Turns a write that failed into an error: the file as the user knows it, and the reason in
    !! the words of the system, else of HDF5.
    integer, intent(in) :: status
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: known, reason
    integer :: k

    if (status >= 0 .or. err%failed()) return
    known = path
    do k = 1, size(suffix)   ! names that files have until they are complete
      if (index(path, trim(suffix(k)), back=.true.) == len(path) - len_trim(suffix(k)) + 1) then
        known = path(:len(path) - len_trim(suffix(k)))
      end if
    end do
    reason = writing_problem(path)
    if (len(reason) > 0) call err%set('cannot write '//known//': '//reason)
    call check(status, 'cannot write '//known, err)
  end subroutine check_writing

  integer(c_int) function keep_description(position, entry, client) result(status) bind(c)
    !! Visits HDF5's error stack from the innermost call outwards; keeps the first two texts.
    integer(c_int), value :: position
    type(hdf5_error_entry_t), intent(in) :: entry
    type(c_ptr), value :: client
    type(error_text_t), pointer :: kept
    character(kind=c_char), pointer :: text(:)
    integer :: i

    status = 0
    if (position > 1) return
    if (.not. c_associated(entry%description)) return
    call c_f_pointer(client, kept)
    call c_f_pointer(entry%description, text, [size(kept%text)])
    if (position > 0) call append_character(kept, ';')
    if (position > 0) call append_character(kept, ' ')
    do i = 1, size(text)
      if (text(i) == c_null_char) exit
      call append_character(kept, text(i))
    end do
  end function keep_description

  subroutine append_character(kept, letter)
    type(error_text_t), intent(inout) :: kept
    character(kind=c_char), intent(in) :: letter

    if (kept%length >= size(kept%text)) return
    kept%length = kept%length + 1_c_int
    kept%text(kept%length) = letter
  end subroutine append_character
end module dosui_hdf5

!! What Fortran does not know of files: their kind, links, locks, and why something went wrong.
!! POSIX and Linux calls; nothing here is collective.
module dosui_file_system
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_f_pointer, c_int, c_int16_t
  use, intrinsic :: iso_c_binding, only: c_int32_t, c_int64_t, c_loc, c_null_char, c_ptr, c_size_t
  use dosui_error, only: error_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: kind_of_file, input_problem, output_problem, remove_link, create_anew, writing_problem
  public :: write_output
  public :: lock_file, unlock_file

  integer, parameter, public :: is_missing = 0, is_regular = 1, is_directory = 2, is_pipe = 3, &
                                is_device = 4, is_socket = 5, is_link = 6, is_unknown = 7
  !! what kind_of_file finds

  type, public :: file_lock_t
    !! A file that only one process holds; the lock dies with its process, however that ends.
    integer(c_int), private :: descriptor = -1_c_int
    character(len=:), allocatable, private :: path
  end type file_lock_t

  type, bind(c) :: statx_t
    !! struct statx of linux/stat.h, the same on all processors
    integer(c_int32_t) :: mask = 0, block_size = 0
    integer(c_int64_t) :: attributes = 0
    integer(c_int32_t) :: n_link = 0, owner = 0, group = 0
    integer(c_int16_t) :: mode = 0, spare = 0
    integer(c_int64_t) :: inode = 0, bytes = 0, blocks = 0, attributes_mask = 0
    integer(c_int64_t) :: times(8) = 0
    integer(c_int32_t) :: device(4) = 0
    integer(c_int64_t) :: rest(14) = 0
  end type statx_t

  integer(c_int), parameter :: at_folder = -100, at_empty_path = int(z'1000', c_int)   ! of statx
  integer(c_int), parameter :: no_follow = int(z'100', c_int)
  integer(c_int), parameter :: basic_stats = int(z'7ff', c_int)
  integer(c_int), parameter :: write_only = 1, read_write = 2, create = int(z'40', c_int)
  integer(c_int), parameter :: exclusive = int(z'80', c_int), keep_off = int(z'80000', c_int)
  integer(c_int), parameter :: everybody = 438   ! mode 0666, cut by the umask
  integer(c_int), parameter :: lock_exclusive = 2, lock_at_once = 4   ! of flock
  integer(c_int), parameter :: no_such_file = 2, would_block = 11, is_a_directory = 21   ! errno
  integer(c_int), parameter :: standard_output = 1
  integer(c_int), parameter :: file_size = 1   ! of getrlimit
  integer, parameter :: type_mask = int(z'f000')
  integer, parameter :: most_attempts = 20     ! to lock a file that others remove meanwhile
  integer, parameter :: probe_size = 1048576   ! of a file that tries whether there is space [byte]

  ! C strings have no length in their interfaces.
  ! allow(C071, C072)
  interface
    integer(c_int) function posix_statx(folder, path, flags, mask, buffer) bind(c, name='statx')
      import :: c_char, c_int, statx_t
      implicit none
      integer(c_int), value :: folder, flags, mask
      character(kind=c_char), intent(in) :: path(*)
      type(statx_t), intent(inout) :: buffer
    end function posix_statx
    integer(c_int) function posix_open(path, flags, mode) bind(c, name='open')
      import :: c_char, c_int
      implicit none
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value :: flags, mode
    end function posix_open
    integer(c_int) function posix_close(descriptor) bind(c, name='close')
      import :: c_int
      implicit none
      integer(c_int), value :: descriptor
    end function posix_close
    integer(c_size_t) function posix_write(descriptor, buffer, n) bind(c, name='write')
      import :: c_char, c_int, c_size_t
      implicit none
      integer(c_int), value :: descriptor
      character(kind=c_char), intent(in) :: buffer(*)
      integer(c_size_t), value :: n
    end function posix_write
    integer(c_size_t) function posix_read(descriptor, buffer, n) bind(c, name='read')
      import :: c_char, c_int, c_size_t
      implicit none
      integer(c_int), value :: descriptor
      character(kind=c_char), intent(inout) :: buffer(*)
      integer(c_size_t), value :: n
    end function posix_read
    integer(c_int) function posix_ftruncate(descriptor, n) bind(c, name='ftruncate')
      import :: c_int, c_int64_t
      implicit none
      integer(c_int), value :: descriptor
      integer(c_int64_t), value :: n
    end function posix_ftruncate
    integer(c_int) function posix_flock(descriptor, operation) bind(c, name='flock')
      import :: c_int
      implicit none
      integer(c_int), value :: descriptor, operation
    end function posix_flock
    integer(c_int) function posix_unlink(path) bind(c, name='unlink')
      import :: c_char, c_int
      implicit none
      character(kind=c_char), intent(in) :: path(*)
    end function posix_unlink
    integer(c_int) function posix_getrlimit(resource, limits) bind(c, name='getrlimit')
      import :: c_int, c_int64_t
      implicit none
      integer(c_int), value :: resource
      integer(c_int64_t), intent(inout) :: limits(2)
    end function posix_getrlimit
    integer(c_int) function posix_getpid() bind(c, name='getpid')
      import :: c_int
      implicit none
    end function posix_getpid
    integer(c_int) function posix_gethostname(name, n) bind(c, name='gethostname')
      import :: c_char, c_int, c_size_t
      implicit none
      character(kind=c_char), intent(inout) :: name(*)
      integer(c_size_t), value :: n
    end function posix_gethostname
    type(c_ptr) function errno_location() bind(c, name='__errno_location')
      import :: c_ptr
      implicit none
    end function errno_location
    type(c_ptr) function c_strerror(number) bind(c, name='strerror')
      import :: c_int, c_ptr
      implicit none
      integer(c_int), value :: number
    end function c_strerror
  end interface

contains

  ! ---------------------------------------------------------------- kinds

  integer function kind_of_file(path, follow) result(kind)
    !! What is at a path?
    character(len=*), intent(in) :: path
    logical, intent(in) :: follow   !! a link is what it leads to
    type(statx_t) :: found

    if (posix_statx(at_folder, path//c_null_char, merge(0_c_int, no_follow, follow), basic_stats, &
                    found) /= 0_c_int) then
      kind = is_missing
      if (last_error() /= no_such_file) kind = is_unknown
      return
    end if
    select case (iand(int(found%mode), type_mask))
    case (int(z'8000'))
      kind = is_regular
    case (int(z'4000'))
      kind = is_directory
    case (int(z'1000'))
      kind = is_pipe
    case (int(z'2000'), int(z'6000'))
      kind = is_device
    case (int(z'c000'))
      kind = is_socket
    case (int(z'a000'))
      kind = is_link
    case default
      kind = is_unknown
    end select
  end function kind_of_file

  pure function name_of_kind(kind) result(name)
    !! For messages.
    integer, intent(in) :: kind
    character(len=:), allocatable :: name

    select case (kind)
    case (is_directory)
      name = 'a directory'
    case (is_pipe)
      name = 'a pipe'
    case (is_device)
      name = 'a device'
    case (is_socket)
      name = 'a socket'
    case default
      name = 'something else'
    end select
  end function name_of_kind

  function input_problem(path) result(reason)
    !! Why a file cannot be read, '' if it probably can. Pipes and devices are refused: they may
    !! never end, and can be read only once.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: reason
    integer :: kind

    reason = ''
    kind = kind_of_file(path, .true.)
    select case (kind)
    case (is_regular)
      continue
    case (is_missing)
      reason = 'no such file'
      if (kind_of_file(path, .false.) == is_link) reason = 'it is a link to nothing'
    case (is_unknown)
      reason = text_of_error(last_error())
    case default
      reason = 'it is '//name_of_kind(kind)//', not a file'
    end select
  end function input_problem

  function output_problem(path) result(reason)
    !! Why a file cannot take a place, '' if there is nothing, a file or a link.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: reason
    integer :: kind

    reason = ''
    kind = kind_of_file(path, .false.)
    if (kind == is_missing .or. kind == is_regular .or. kind == is_link) return
    if (kind == is_unknown) then
      reason = text_of_error(last_error())
    else
      reason = 'there is '//name_of_kind(kind)//' of this name'
    end if
  end function output_problem

  ! ---------------------------------------------------------------- creating

  subroutine create_anew(path, err)
    !! An empty file; what was there is removed, not followed (a link) or emptied (a second name).
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(c_int) :: descriptor, status

    status = posix_unlink(path//c_null_char)
    descriptor = -1_c_int
    if (status == 0_c_int .or. last_error() == no_such_file) then
      descriptor = posix_open(path//c_null_char, write_only + create + exclusive + keep_off, &
                              everybody)
    end if
    if (descriptor < 0_c_int) then
      call err%set('cannot create the file '//path//': '//text_of_error(last_error()))
    else
      status = posix_close(descriptor)
    end if
  end subroutine create_anew

  subroutine remove_link(path)
    !! Removes a file or link if it is there.
    character(len=*), intent(in) :: path
    integer(c_int) :: status

    status = posix_unlink(path//c_null_char)
    if (status /= 0_c_int) return   ! nothing there: as wanted
  end subroutine remove_link

  function writing_problem(path) result(reason)
    !! Why writing to a file has failed, in the words of the system ('No space left on device');
    !! '' if nothing is found. A file beside it is tried, and removed.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: reason
    character(kind=c_char), allocatable :: zeros(:)
    character(len=:), allocatable :: probe
    integer(c_int) :: descriptor, status
    integer(c_size_t) :: n, done

    reason = ''
    probe = path//'.try'//to_text(int(posix_getpid()))
    status = posix_unlink(probe//c_null_char)
    descriptor = posix_open(probe//c_null_char, write_only + create + exclusive + keep_off, &
                            everybody)
    if (descriptor < 0_c_int) then
      reason = text_of_error(last_error())
      return
    end if
    allocate (zeros(probe_size), source=c_null_char)
    done = 0
    do while (done < probe_size)
      n = posix_write(descriptor, zeros, int(probe_size, c_size_t) - done)
      if (n <= 0) exit
      done = done + n
    end do
    if (done < probe_size) reason = text_of_error(last_error())
    status = posix_close(descriptor)
    status = posix_unlink(probe//c_null_char)
    if (len(reason) == 0) reason = size_limit()
  end function writing_problem

  function size_limit() result(text)
    !! The largest file that this process may write, '' if it is not limited.
    character(len=:), allocatable :: text
    integer(c_int64_t) :: limits(2)

    text = ''
    limits = -1_c_int64_t
    if (posix_getrlimit(file_size, limits) /= 0_c_int .or. limits(1) < 0_c_int64_t) return
    text = 'File too large? ulimit -f allows '//to_text(limits(1))//' bytes'
  end function size_limit

  subroutine write_output(text, err)
    !! Writes a text to standard output; Fortran's own `flush` does not tell of a full disk.
    character(len=*), intent(in) :: text
    type(error_t), intent(inout) :: err
    integer(c_size_t) :: n, done

    done = 0
    do while (done < len(text))
      n = posix_write(standard_output, text(done + 1:), len(text, kind=c_size_t) - done)
      if (n <= 0) then
        call err%set('cannot write to standard output: '//text_of_error(last_error()))
        return
      end if
      done = done + n
    end do
  end subroutine write_output

  ! ---------------------------------------------------------------- locks

  subroutine lock_file(lock, path, err)
    !! Locks a file that is made for it and holds the host and process; an error says who holds it.
    !! Where the file system knows no locks nothing is locked.
    type(file_lock_t), intent(inout) :: lock
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(c_int) :: descriptor, status
    integer :: k

    do k = 1, most_attempts
      if (kind_of_file(path, .false.) > is_regular) then
        call err%set('cannot lock '//path//': it is no plain file')
        return
      end if
      descriptor = posix_open(path//c_null_char, read_write + create + keep_off, everybody)
      if (descriptor < 0_c_int) then
        call err%set('cannot create the file '//path//': '//text_of_error(last_error()))
        return
      end if
      status = posix_flock(descriptor, lock_exclusive + lock_at_once)
      if (status /= 0_c_int .and. last_error() == would_block) then
        call err%set('another run writes the same files: '//holder(descriptor)//' holds '//path)
        status = posix_close(descriptor)
        return
      end if
      if (is_at(descriptor, path)) exit
      status = posix_close(descriptor)   ! its last holder has removed it meanwhile
    end do
    if (k > most_attempts) then
      call err%set('cannot lock '//path//': it is a link, or others remove it')
      return
    end if
    lock%descriptor = descriptor
    lock%path = path
    call write_holder(descriptor)
  end subroutine lock_file

  subroutine unlock_file(lock)
    !! Removes the file, then lets it go.
    type(file_lock_t), intent(inout) :: lock
    integer(c_int) :: status

    if (lock%descriptor < 0_c_int) return
    status = posix_unlink(lock%path//c_null_char)
    status = posix_close(lock%descriptor)
    lock%descriptor = -1_c_int
  end subroutine unlock_file

  logical function is_at(descriptor, path) result(is)
    !! Is the open file the one of this path?
    integer(c_int), intent(in) :: descriptor
    character(len=*), intent(in) :: path
    type(statx_t) :: open, named

    is = .true.
    if (posix_statx(descriptor, c_null_char, at_empty_path, basic_stats, open) /= 0_c_int) return
    is = posix_statx(at_folder, path//c_null_char, no_follow, basic_stats, named) == 0_c_int
    if (is) is = open%inode == named%inode .and. all(open%device(3:4) == named%device(3:4))
  end function is_at

  function holder(descriptor) result(text)
    !! Who has written into a lock.
    integer(c_int), intent(in) :: descriptor
    character(len=:), allocatable :: text
    character(kind=c_char) :: buffer(256)
    integer :: k, n

    n = int(posix_read(descriptor, buffer, size(buffer, kind=c_size_t)))
    text = ''
    do k = 1, n
      if (buffer(k) == new_line('a')) exit
      text = text//buffer(k)
    end do
    if (len(text) == 0) text = 'its process'
  end function holder

  subroutine write_holder(descriptor)
    !! This process as the holder of a lock.
    integer(c_int), intent(in) :: descriptor
    character(kind=c_char) :: host(256)
    character(len=:), allocatable :: text
    integer(c_int) :: status
    integer(c_size_t) :: n
    integer :: k

    host = c_null_char
    status = posix_gethostname(host, size(host, kind=c_size_t) - 1_c_size_t)
    text = 'process '//to_text(int(posix_getpid()))//' on '
    do k = 1, size(host)
      if (host(k) == c_null_char) exit
      text = text//host(k)
    end do
    text = text//new_line('a')
    status = posix_ftruncate(descriptor, 0_c_int64_t)
    n = posix_write(descriptor, text, len(text, kind=c_size_t))
    if (n < 0 .or. status < 0) return   ! a full disk: the lock holds without a name
  end subroutine write_holder

  ! ---------------------------------------------------------------- errors

  integer(c_int) function last_error() result(number)
    !! errno
    integer(c_int), pointer :: value

    call c_f_pointer(errno_location(), value)
    number = value
  end function last_error

  function text_of_error(number) result(text)
    !! What the system calls an error.
    integer(c_int), intent(in) :: number
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    type(c_ptr) :: address
    integer :: k

    text = 'error '//to_text(int(number))
    address = c_strerror(number)
    if (.not. c_associated(address)) return
    call c_f_pointer(address, letters, [256])
    text = ''
    do k = 1, size(letters)
      if (letters(k) == c_null_char) exit
      text = text//letters(k)
    end do
  end function text_of_error
end module dosui_file_system

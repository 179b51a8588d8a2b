!! Folders: can files be written there, and what are they called?
module dosui_directories
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char, c_ptr, c_associated
  use dosui_error, only: error_t
  implicit none
  private

  public :: directory_problem, existing_folder, make_directory, absolute_path

  integer(c_int), parameter :: is_there = 0_c_int, may_write_and_enter = 3_c_int   !! of access(2)
  integer(c_int), parameter :: everybody = 511_c_int   !! mode 0777, cut by the umask
  integer, parameter :: longest_path = 4096

  interface
    integer(c_int) function posix_access(path, mode) bind(c, name='access')
      import :: c_char, c_int
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value :: mode
    end function posix_access
    integer(c_int) function posix_mkdir(path, mode) bind(c, name='mkdir')
      import :: c_char, c_int
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value :: mode
    end function posix_mkdir
    type(c_ptr) function posix_realpath(path, resolved) bind(c, name='realpath')
      import :: c_char, c_ptr
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: path(*)
      ! allow(C071, C072)
      character(kind=c_char), intent(out) :: resolved(*)
    end function posix_realpath
  end interface

contains

  function directory_problem(path) result(reason)
    !! Why files cannot be written in a folder, '' if they can. A folder that is not there yet is
    !! no problem if it can be made in its parent. Nothing is written.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: reason
    character(len=:), allocatable :: parent
    integer :: slash

    reason = ''
    if (len_trim(path) == 0) then
      reason = 'must not be empty'
    else if (len(path) + 2 >= longest_path) then
      reason = 'is longer than the system takes'
    else if (has_access(path, is_there)) then
      if (.not. has_access(path//'/.', is_there)) then
        reason = 'is no directory'
      else if (.not. has_access(path, may_write_and_enter)) then
        reason = 'is not writable'
      end if
    else
      slash = index(without_last_slash(path), '/', back=.true.)
      parent = '.'
      if (slash == 1) parent = '/'
      if (slash > 1) parent = path(:slash - 1)
      if (.not. has_access(parent//'/.', is_there)) then
        reason = 'cannot be made: there is no directory '//parent
      else if (.not. has_access(parent, may_write_and_enter)) then
        reason = 'cannot be made: '//parent//' is not writable'
      end if
    end if
  end function directory_problem

  function existing_folder(path) result(folder)
    !! A folder, or the parent that it can be made in.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    integer :: slash

    folder = path
    if (has_access(path//'/.', is_there)) return
    slash = index(without_last_slash(path), '/', back=.true.)
    folder = '.'
    if (slash == 1) folder = '/'
    if (slash > 1) folder = path(:slash - 1)
  end function existing_folder

  subroutine make_directory(path, err)
    !! Makes a folder; one that is there already is no error.
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(c_int) :: status

    if (has_access(path//'/.', is_there)) return
    status = posix_mkdir(path//c_null_char, everybody)
    if (.not. has_access(path//'/.', is_there)) call err%set('cannot make the directory '//path)
  end subroutine make_directory

  function absolute_path(path) result(absolute)
    !! The path from the root, without links and dots; as it is if there is no such file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: absolute
    character(kind=c_char) :: resolved(longest_path)
    integer :: k

    absolute = path
    resolved = c_null_char
    if (.not. c_associated(posix_realpath(path//c_null_char, resolved))) return
    absolute = ''
    do k = 1, longest_path
      if (resolved(k) == c_null_char) exit
      absolute = absolute//resolved(k)
    end do
  end function absolute_path

  logical function has_access(path, mode)
    !! May this process use a file in this way?
    character(len=*), intent(in) :: path
    integer(c_int), intent(in) :: mode

    has_access = posix_access(path//c_null_char, mode) == 0_c_int
  end function has_access

  pure function without_last_slash(path) result(short)
    !! The path without slashes at its end.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: short

    short = path
    do while (len(short) > 1)
      if (short(len(short):) /= '/') exit
      short = short(:len(short) - 1)
    end do
  end function without_last_slash
end module dosui_directories

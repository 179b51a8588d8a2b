!! Replacing files so that a complete one is there at every moment.
module dosui_file_exchange
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char
  use dosui_error, only: error_t
  implicit none
  private
  public :: rename_file, remove_file, replace_keeping_previous

  interface
    integer(c_int) function posix_rename(old, new) bind(c, name='rename')
      import :: c_char, c_int
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: old(*), new(*)
    end function posix_rename
    integer(c_int) function posix_link(old, new) bind(c, name='link')
      import :: c_char, c_int
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: old(*), new(*)
    end function posix_link
    integer(c_int) function posix_unlink(path) bind(c, name='unlink')
      import :: c_char, c_int
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: path(*)
    end function posix_unlink
  end interface

contains

  subroutine rename_file(old_path, new_path, err)
    !! Gives a file another name of the same folder; a file of that name is replaced in one step.
    character(len=*), intent(in) :: old_path, new_path
    type(error_t), intent(inout) :: err

    if (posix_rename(old_path//c_null_char, new_path//c_null_char) /= 0_c_int) then
      call err%set('cannot rename '//old_path//' to '//new_path)
    end if
  end subroutine rename_file

  subroutine remove_file(path)
    !! Removes a file if it is there.
    character(len=*), intent(in) :: path
    integer(c_int) :: status

    status = posix_unlink(path//c_null_char)
    if (status /= 0_c_int) return   ! nothing there: as wanted
  end subroutine remove_file

  subroutine replace_keeping_previous(new_path, path, previous_path, err)
    !! Renames new_path to path; what was at path becomes previous_path.
    !!
    !! Both names hold a complete file at every moment: the old file gets a second name (hard link)
    !! before the new one takes its place. Where the file system has no hard links, `path` is
    !! missing for the moment between two renames.
    character(len=*), intent(in) :: new_path, path, previous_path
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: second_name
    logical :: exists
    integer(c_int) :: status

    second_name = previous_path//'.new'//c_null_char
    inquire (file=path, exist=exists)
    if (exists) then
      status = posix_unlink(second_name)
      status = posix_link(path//c_null_char, second_name)
      if (status == 0_c_int) then
        call rename_file(previous_path//'.new', previous_path, err)
        status = posix_unlink(second_name)   ! left over if both names already were one file
      else
        call rename_file(path, previous_path, err)
      end if
    end if
    if (.not. err%failed()) call rename_file(new_path, path, err)
  end subroutine replace_keeping_previous
end module dosui_file_exchange

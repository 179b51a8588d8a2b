!! The C library's allocator: large arrays give their memory back when they are deallocated.
!!
!! SuperLU, which comes with PETSc, turns that off for the whole process when it is loaded
!! (mallopt: no memory maps, no trimming). Measured with 1e5 and 1e6 particles in 2-D, updated:
!! 790 and 793 B a particle, 714 and 712 B with maps above 2 MB. Maps for smaller arrays cost
!! time: 225 instead of 194 ns a step above 0.5 MB, for the pages of temporary arrays are made anew.
module dosui_allocator
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_f_procpointer, c_funptr, c_int
  use, intrinsic :: iso_c_binding, only: c_null_char, c_null_ptr, c_ptr
  implicit none
  private

  public :: return_large_arrays

  integer(c_int), parameter :: trim_threshold = -1, mmap_threshold = -3, mmap_max = -4   ! glibc's
  integer(c_int), parameter :: most_maps = 65536   ! glibc's default
  integer(c_int), parameter :: large = 2097152     ! mapped and trimmed; smaller ones are reused [B]

  abstract interface
    integer(c_int) function mallopt_f(parameter, value) bind(c)
      import :: c_int
      implicit none
      integer(c_int), value :: parameter, value
    end function mallopt_f
  end interface

  interface
    type(c_funptr) function dlsym(handle, symbol) bind(c, name='dlsym')
      import :: c_char, c_funptr, c_ptr
      implicit none
      type(c_ptr), value :: handle
      ! allow(C071)
      character(kind=c_char), intent(in) :: symbol(*)
    end function dlsym
  end interface

contains

  subroutine return_large_arrays()
    !! Undoes it with glibc; does nothing with another C library.
    type(c_funptr) :: address
    procedure(mallopt_f), pointer :: mallopt
    integer(c_int) :: done

    address = dlsym(c_null_ptr, 'mallopt'//c_null_char)   ! null: among all that is loaded
    if (.not. c_associated(address)) return
    call c_f_procpointer(address, mallopt)
    done = mallopt(mmap_max, most_maps)
    done = mallopt(trim_threshold, large)
    done = mallopt(mmap_threshold, large)
  end subroutine return_large_arrays
end module dosui_allocator

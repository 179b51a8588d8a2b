!! Errors as values: whatever the world or the user can cause comes back in an `error_t`.
module dosui_error
  implicit none
  private

  type, public :: error_t
    !! No error while `message` is unallocated.
    character(len=:), allocatable :: message   !! what went wrong, for the user
  contains
    procedure :: set => error_set
    procedure :: failed => error_failed
    procedure :: clear => error_clear
  end type error_t

contains

  subroutine error_set(self, message)
    !! Records an error; the first one is kept, because later ones are usually its consequences.
    class(error_t), intent(inout) :: self
    character(len=*), intent(in) :: message

    if (.not. allocated(self%message)) self%message = message
  end subroutine error_set

  pure logical function error_failed(self) result(failed)
    !! Has an error been recorded?
    class(error_t), intent(in) :: self

    failed = allocated(self%message)
  end function error_failed

  subroutine error_clear(self)
    !! Forgets a recorded error (after it has been handled).
    class(error_t), intent(inout) :: self

    if (allocated(self%message)) deallocate (self%message)
  end subroutine error_clear
end module dosui_error

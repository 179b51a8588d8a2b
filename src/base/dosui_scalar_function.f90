!! A number that may vary with place: a constant, or a formula of the coordinates.
module dosui_scalar_function
  use dosui_kinds, only: wp
  use dosui_expression, only: expression_t
  implicit none
  private

  type, public :: scalar_function_t
    real(wp) :: constant = 0.0_wp               !! the value; of a formula, the largest [any unit]
    real(wp) :: least = 0.0_wp                  !! smallest value of a formula [any unit]
    character(len=:), allocatable :: formula    !! of the coordinates [m]; unallocated: constant
    type(expression_t), allocatable, private :: expression   !! of the formula
  contains
    procedure :: varies => scalar_function_varies
    procedure :: set => scalar_function_set
    procedure :: parse => scalar_function_parse
    procedure :: at => scalar_function_at
    procedure :: smallest => scalar_function_smallest
  end type scalar_function_t

contains

  pure elemental logical function scalar_function_varies(self) result(varies)
    !! Is it a formula?
    class(scalar_function_t), intent(in) :: self

    varies = allocated(self%formula)
  end function scalar_function_varies

  pure elemental subroutine scalar_function_set(self, constant)
    !! Makes it a constant.
    class(scalar_function_t), intent(inout) :: self
    real(wp), intent(in) :: constant   !! [unit of the quantity]

    self%constant = constant
    if (allocated(self%formula)) deallocate (self%formula)
    if (allocated(self%expression)) deallocate (self%expression)
  end subroutine scalar_function_set

  subroutine scalar_function_parse(self, formula, variables, message)
    !! Makes it a formula, unless that cannot be read, or the constant that the formula is. The
    !! constant of a formula that varies is not known afterwards.
    class(scalar_function_t), intent(inout) :: self
    character(len=*), intent(in) :: formula
    character(len=*), intent(in) :: variables(:)   !! names of the coordinates
    character(len=:), allocatable, intent(out) :: message
    !! what is wrong and at which column; unallocated: nothing
    type(expression_t) :: expression
    integer :: k

    call expression%parse(formula, variables, message)
    if (allocated(message)) return
    if (expression%is_constant()) then
      call self%set(expression%value([(0.0_wp, k=1, size(variables))]))
      return
    end if
    self%formula = formula
    self%expression = expression
  end subroutine scalar_function_parse

  pure real(wp) function scalar_function_at(self, place) result(value)
    !! The value at a place [unit of the quantity].
    class(scalar_function_t), intent(in) :: self
    real(wp), intent(in) :: place(:)   !! coordinates, the local origin added [m]

    value = self%constant
    if (allocated(self%expression)) value = self%expression%value(place)
  end function scalar_function_at

  pure elemental real(wp) function scalar_function_smallest(self) result(value)
    !! The smallest value where the soil is [unit of the quantity].
    class(scalar_function_t), intent(in) :: self

    value = self%constant
    if (allocated(self%formula)) value = self%least
  end function scalar_function_smallest
end module dosui_scalar_function

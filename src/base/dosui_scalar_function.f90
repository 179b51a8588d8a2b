!! A number that may vary: a constant, or a formula of the coordinates and time, times a table of
!! time.
module dosui_scalar_function
  use dosui_kinds, only: wp
  use dosui_expression, only: expression_t
  use dosui_table, only: named_table_t, table_t
  implicit none
  private

  type, public :: scalar_function_t
    real(wp) :: constant = 0.0_wp               !! the value; of a formula, the largest [any unit]
    real(wp) :: least = 0.0_wp                  !! smallest value of a formula [any unit]
    character(len=:), allocatable :: formula
    !! of the coordinates [m] and, in conditions and sources, t [s]; unallocated: constant
    type(table_t) :: factor                     !! over time [-]
    real(wp) :: origin(3) = 0.0_wp              !! what positions of `at` count from [m]
    type(expression_t), allocatable, private :: expression   !! of the formula
  contains
    procedure :: varies => scalar_function_varies
    procedure :: set => scalar_function_set
    procedure :: parse => scalar_function_parse
    procedure :: prepare => scalar_function_prepare
    procedure :: at => scalar_function_at
    procedure :: smallest => scalar_function_smallest
    procedure :: corners => scalar_function_corners
    procedure :: uses => scalar_function_uses
    procedure :: equals => scalar_function_equals
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

  subroutine scalar_function_parse(self, formula, variables, message, tables)
    !! Makes it a formula, unless that cannot be read, or the constant that the formula is. The
    !! constant of a formula that varies is not known afterwards.
    class(scalar_function_t), intent(inout) :: self
    character(len=*), intent(in) :: formula
    character(len=*), intent(in) :: variables(:)   !! names of the coordinates
    character(len=:), allocatable, intent(out) :: message
    !! what is wrong and at which column; unallocated: nothing
    type(named_table_t), intent(in), optional :: tables(:)   !! functions by their names
    type(expression_t) :: expression
    integer :: k

    call expression%parse(formula, variables, message, tables)
    if (allocated(message)) return
    if (expression%is_constant()) then
      call self%set(expression%value([(0.0_wp, k=1, size(variables))]))
      return
    end if
    self%formula = formula
    self%expression = expression
  end subroutine scalar_function_parse

  subroutine scalar_function_prepare(self, variables, message, tables)
    !! Reads its formula, if it has one, and keeps it whatever it is.
    class(scalar_function_t), intent(inout) :: self
    character(len=*), intent(in) :: variables(:)   !! names of the coordinates and of time
    character(len=:), allocatable, intent(out) :: message   !! as of `parse`
    type(named_table_t), intent(in), optional :: tables(:)   !! functions by their names

    if (.not. allocated(self%formula)) return
    if (.not. allocated(self%expression)) allocate (self%expression)
    call self%expression%parse(self%formula, variables, message, tables)
  end subroutine scalar_function_prepare

  pure real(wp) function scalar_function_at(self, position, time) result(value)
    !! The value at a place, and a time where it depends on one [unit of the quantity].
    class(scalar_function_t), intent(in) :: self
    real(wp), intent(in) :: position(:)          !! coordinates from `origin` [m]
    real(wp), intent(in), optional :: time       !! [s]

    value = self%constant
    if (present(time)) then
      if (allocated(self%expression)) value = self%expression%value( &
                                              [position + self%origin(:size(position)), time])
      value = self%factor%at(time)*value
    else if (allocated(self%expression)) then
      value = self%expression%value(position + self%origin(:size(position)))
    end if
  end function scalar_function_at

  pure elemental real(wp) function scalar_function_smallest(self) result(value)
    !! The smallest value where the soil is [unit of the quantity].
    class(scalar_function_t), intent(in) :: self

    value = self%constant
    if (allocated(self%formula)) value = self%least
  end function scalar_function_smallest

  pure function scalar_function_corners(self, n_coordinate) result(time)
    !! Times where it may turn: entries of its factor and of tables of time alone in its formula, in
    !! no order [s].
    class(scalar_function_t), intent(in) :: self
    integer, intent(in) :: n_coordinate   !! time is the variable after them
    real(wp), allocatable :: time(:)

    allocate (time(0))
    if (allocated(self%factor%argument)) time = self%factor%argument
    if (allocated(self%expression)) time = [time, self%expression%corners(n_coordinate + 1)]
  end function scalar_function_corners

  pure logical function scalar_function_uses(self, name) result(uses)
    !! Does its formula hold the table of that name?
    class(scalar_function_t), intent(in) :: self
    character(len=*), intent(in) :: name

    uses = .false.
    if (allocated(self%expression)) uses = self%expression%uses(name)
  end function scalar_function_uses

  pure logical function scalar_function_equals(self, other) result(equals)
    !! Have both the same constant, text and entries?
    class(scalar_function_t), intent(in) :: self, other

    equals = .not. abs(self%constant - other%constant) > 0.0_wp .and. &
             (self%varies() .eqv. other%varies()) .and. &
             (allocated(self%factor%argument) .eqv. allocated(other%factor%argument))
    if (.not. equals) return
    if (self%varies()) equals = self%formula == other%formula
    if (.not. equals .or. .not. allocated(self%factor%argument)) return
    equals = size(self%factor%argument) == size(other%factor%argument)
    if (.not. equals) return
    equals = .not. (any(abs(self%factor%argument - other%factor%argument) > 0.0_wp) .or. &
                    any(abs(self%factor%value - other%factor%value) > 0.0_wp))
  end function scalar_function_equals
end module dosui_scalar_function

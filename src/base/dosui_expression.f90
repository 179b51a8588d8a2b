!! Formulas as text, such as '-9.81*(z - 2)*step(t - 10)', for fields that users write down.
!!
!! A formula holds numbers, pi, variables that the caller names, + - * / ^ (or **), brackets, and
!! sin cos tan atan exp log sqrt abs sinh cosh tanh step of one argument, min and max of two.
!! step is 0 below zero and 1 from zero on. Tables that the caller names are functions of one
!! argument, too. Powers go first and from the right: -x^2 is -(x^2), 2^3^2 is 2^9. Capitals and
!! blanks do not count. Angles are radians.
!!
!! Reading turns the text into a program for a stack machine; what is constant is computed there.
module dosui_expression
  use dosui_kinds, only: wp
  use dosui_numbers, only: text_as_real
  use dosui_table, only: named_table_t
  use dosui_text, only: lower_case, nearest_name, to_text
  implicit none
  private

  integer, parameter :: stack_size = 32     ! values that can wait for each other
  integer, parameter :: most_nested = 64    ! brackets, functions, signs and powers inside another

  ! Instructions: -k pushes variable k, op_constant the next constant; unary ones change the value
  ! on top of the stack, those from op_add on replace the two on top; op_table + k puts the value of
  ! table k in the place of its argument.
  integer, parameter :: op_constant = 1, op_negate = 2, op_sin = 3, op_cos = 4, op_tan = 5, &
                        op_atan = 6, op_exp = 7, op_log = 8, op_sqrt = 9, op_abs = 10, &
                        op_sinh = 11, op_cosh = 12, op_tanh = 13, op_step = 14, op_add = 15, &
                        op_subtract = 16, op_multiply = 17, op_divide = 18, op_power = 19, &
                        op_min = 20, op_max = 21, op_table = 21
  character(len=4), parameter :: function_name(*) = &
                                 ['sin ', 'cos ', 'tan ', 'atan', 'exp ', 'log ', 'sqrt', &
                                  'abs ', 'sinh', 'cosh', 'tanh', 'step', 'min ', 'max ']
  integer, parameter :: function_code(*) = [op_sin, op_cos, op_tan, op_atan, op_exp, op_log, &
                                            op_sqrt, op_abs, op_sinh, op_cosh, op_tanh, op_step, &
                                            op_min, op_max]
  character(len=*), parameter :: name_of_pi = 'pi'
  character(len=*), parameter :: digits = '0123456789'
  character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyz_'

  type, public :: expression_t
    !! A formula that has been read; before that, and after an error, the constant 0.
    private
    integer, allocatable :: code(:)         ! the program, operands before operators
    type(named_table_t), allocatable :: table(:)   ! that it uses
    real(wp), allocatable :: constant(:)    !! in the order of the program [any unit]
  contains
    procedure :: parse => expression_parse
    procedure :: value => expression_value
    procedure :: is_constant => expression_is_constant
    procedure :: depends_on => expression_depends_on
    procedure :: corners => expression_corners
    procedure :: uses => expression_uses
  end type expression_t

  type :: parser_t   ! a text being read, and its program so far
    character(len=:), allocatable :: text      ! lower case
    integer :: at = 1                          ! column that comes next, never a blank
    character :: next = ' '                    ! the character there; blank: the text is over
    integer, allocatable :: code(:)
    real(wp), allocatable :: constant(:)
    integer :: n_code = 0, n_constant = 0
    integer :: n_waiting = 0                   ! values on the stack
    integer :: nested = 0
    type(named_table_t), allocatable :: known(:)   ! tables that may be named ...
    type(named_table_t), allocatable :: table(:)   ! ... and those that are
    character(len=:), allocatable :: message   ! the first error
  contains
    procedure :: advance => parser_advance
    procedure :: fail => parser_fail
    procedure :: failed => parser_failed
    procedure :: push => parser_push
    procedure :: operate => parser_operate
  end type parser_t

contains

  subroutine expression_parse(self, text, variables, message, tables)
    !! Reads a formula.
    use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_status_type
    use, intrinsic :: ieee_exceptions, only: ieee_get_status, ieee_set_halting_mode, ieee_set_status
    class(expression_t), intent(out) :: self
    character(len=*), intent(in) :: text
    character(len=*), intent(in) :: variables(:)   !! names, in the order of their values
    character(len=:), allocatable, intent(out) :: message
    !! what is wrong and at which column; unallocated: nothing
    type(named_table_t), intent(in), optional :: tables(:)   !! functions by their names
    type(parser_t) :: parser
    type(ieee_status_type) :: status

    parser%text = lower_case(text)
    allocate (parser%known(0), parser%table(0))
    if (present(tables)) parser%known = tables
    ! an instruction takes at least one character
    allocate (parser%code(len(text)), parser%constant(len(text)))
    call parser%advance(0)
    if (parser%next == ' ') call parser%fail('the formula is empty')
    ! 1e999 or 1/0 must not trap here: constants that are not finite are left to the evaluation
    call ieee_get_status(status)
    call ieee_set_halting_mode(ieee_all, .false.)
    call parse_sum(parser, variables)
    call ieee_set_status(status)
    if (parser%next /= ' ') call complain_about_next(parser)
    if (parser%failed()) then
      message = parser%message
    else
      self%code = parser%code(:parser%n_code)
      self%constant = parser%constant(:parser%n_constant)
      if (size(parser%table) > 0) self%table = parser%table
    end if
  end subroutine expression_parse

  pure real(wp) function expression_value(self, variables) result(value)
    !! The formula at given values; division by zero and the like follow IEEE [any unit].
    class(expression_t), intent(in) :: self
    real(wp), intent(in) :: variables(:)   !! in the order of their names at `parse` [any unit]
    real(wp) :: stack(stack_size)
    integer :: k, n_constant, top

    value = 0.0_wp
    if (.not. allocated(self%code)) return
    n_constant = 0
    top = 0
    do k = 1, size(self%code)
      associate (code => self%code(k))
        if (code < 0) then
          top = top + 1
          stack(top) = variables(-code)
        else if (code == op_constant) then
          top = top + 1
          n_constant = n_constant + 1
          stack(top) = self%constant(n_constant)
        else if (code < op_add) then
          stack(top) = unary(code, stack(top))
        else if (code > op_table) then
          stack(top) = self%table(code - op_table)%at(stack(top))
        else
          top = top - 1
          stack(top) = binary(code, stack(top), stack(top + 1))
        end if
      end associate
    end do
    value = stack(1)
  end function expression_value

  pure logical function expression_is_constant(self) result(is_constant)
    !! Does the formula hold no variable?
    class(expression_t), intent(in) :: self

    is_constant = .true.
    if (allocated(self%code)) is_constant = .not. any(self%code < 0)
  end function expression_is_constant

  pure logical function expression_depends_on(self, k) result(depends)
    !! Does the formula hold the k-th variable?
    class(expression_t), intent(in) :: self
    integer, intent(in) :: k   !! place among the names at `parse`

    depends = .false.
    if (allocated(self%code) .and. k > 0) depends = any(self%code == -k)
  end function expression_depends_on

  pure function expression_corners(self, k) result(corners)
    !! Arguments of the entries of tables of the k-th variable alone, in no order: there the formula
    !! may turn [unit of the variable].
    class(expression_t), intent(in) :: self
    integer, intent(in) :: k   !! place among the names at `parse`
    real(wp), allocatable :: corners(:)
    integer :: i

    allocate (corners(0))
    if (.not. allocated(self%table)) return
    do i = 2, size(self%code)
      if (self%code(i) <= op_table .or. self%code(i - 1) /= -k) cycle
      corners = [corners, self%table(self%code(i) - op_table)%argument]
    end do
  end function expression_corners

  pure logical function expression_uses(self, name) result(uses)
    !! Does the formula hold the table of that name?
    class(expression_t), intent(in) :: self
    character(len=*), intent(in) :: name

    uses = .false.
    if (allocated(self%table)) uses = any(self%table%name == lower_case(trim(name)))
  end function expression_uses

  ! ---------------------------------------------------------------- operations

  pure real(wp) function unary(code, x) result(y)
    !! Kernel: an operation on one value.
    integer, intent(in) :: code
    real(wp), intent(in) :: x

    select case (code)
    case (op_negate)
      y = -x
    case (op_sin)
      y = sin(x)
    case (op_cos)
      y = cos(x)
    case (op_tan)
      y = tan(x)
    case (op_atan)
      y = atan(x)
    case (op_exp)
      y = exp(x)
    case (op_log)
      y = log(x)
    case (op_sqrt)
      y = sqrt(x)
    case (op_abs)
      y = abs(x)
    case (op_sinh)
      y = sinh(x)
    case (op_cosh)
      y = cosh(x)
    case (op_tanh)
      y = tanh(x)
    case default   ! op_step
      y = merge(1.0_wp, 0.0_wp, x >= 0.0_wp)
    end select
  end function unary

  pure real(wp) function binary(code, x, y) result(z)
    !! Kernel: an operation on two values.
    integer, intent(in) :: code
    real(wp), intent(in) :: x, y

    select case (code)
    case (op_add)
      z = x + y
    case (op_subtract)
      z = x - y
    case (op_multiply)
      z = x*y
    case (op_divide)
      z = x/y
    case (op_power)
      z = power(x, y)
    case (op_min)
      z = min(x, y)
    case default   ! op_max
      z = max(x, y)
    end select
  end function binary

  pure real(wp) function power(x, y) result(z)
    !! Kernel: x^y. Fortran has no real powers of negative numbers: whole exponents go by their
    !! parity, for others there is none.
    real(wp), intent(in) :: x, y

    if (x >= 0.0_wp) then
      z = x**y
    else if (abs(y - anint(y)) > 0.0_wp) then
      z = sqrt(x)   ! not a number
    else
      z = abs(x)**y
      if (abs(modulo(y, 2.0_wp)) > 0.0_wp) z = -z
    end if
  end function power

  ! ---------------------------------------------------------------- grammar

  recursive subroutine parse_sum(parser, variables)
    !! product {(+ | -) product}
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    character :: sign

    call parse_product(parser, variables)
    do while (scan(parser%next, '+-') > 0)
      sign = parser%next
      call parser%advance(1)
      call parse_product(parser, variables)
      call parser%operate(merge(op_add, op_subtract, sign == '+'), 2)
    end do
  end subroutine parse_sum

  recursive subroutine parse_product(parser, variables)
    !! factor {(* | /) factor}
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    character :: sign

    call parse_factor(parser, variables)
    do while (scan(parser%next, '*/') > 0)
      sign = parser%next
      call parser%advance(1)
      call parse_factor(parser, variables)
      call parser%operate(merge(op_multiply, op_divide, sign == '*'), 2)
    end do
  end subroutine parse_product

  recursive subroutine parse_factor(parser, variables)
    !! (+ | -) factor | operand [(^ | **) factor]; all nesting passes through here.
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    character :: sign

    parser%nested = parser%nested + 1
    if (parser%nested > most_nested) then
      call parser%fail('too deeply nested at column '//to_text(parser%at))
    else if (scan(parser%next, '+-') > 0) then
      sign = parser%next
      call parser%advance(1)
      call parse_factor(parser, variables)
      if (sign == '-') call parser%operate(op_negate, 1)
    else
      call parse_operand(parser, variables)
      if (at_power(parser)) then
        call parser%advance(merge(1, 2, parser%next == '^'))
        call parse_factor(parser, variables)
        call parser%operate(op_power, 2)
      end if
    end if
    parser%nested = parser%nested - 1
  end subroutine parse_factor

  pure logical function at_power(parser)
    !! Does ^ or ** come next?
    type(parser_t), intent(in) :: parser

    at_power = parser%next == '^'
    if (parser%next == '*' .and. parser%at < len(parser%text)) then
      at_power = parser%text(parser%at + 1:parser%at + 1) == '*'
    end if
  end function at_power

  recursive subroutine parse_operand(parser, variables)
    !! A number, a name or brackets.
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    integer :: column

    if (parser%failed()) return
    column = parser%at
    if (parser%next == ' ') then
      call parser%fail('the formula ends at column '//to_text(column)//' where a value must follow')
    else if (parser%next == '(') then
      call parser%advance(1)
      call parse_sum(parser, variables)
      call close_bracket(parser, column)
    else if (scan(parser%next, digits//'.') > 0) then
      call parse_number(parser)
    else if (scan(parser%next, letters) > 0) then
      call parse_name(parser, variables)
    else
      call parser%fail('a value must stand at column '//to_text(column)//', not '// &
                       quoted(parser%next))
    end if
  end subroutine parse_operand

  subroutine parse_number(parser)
    !! Digits with a point and an exponent (e or d), without sign.
    type(parser_t), intent(inout) :: parser
    character(len=:), allocatable :: reason
    real(wp) :: x
    integer :: first, last, mark

    first = parser%at
    last = end_of(parser%text, first, digits)
    if (last < len(parser%text)) then
      if (parser%text(last + 1:last + 1) == '.') last = end_of(parser%text, last + 2, digits)
    end if
    if (parser%text(first:last) == '.') then
      call parser%fail('a number without digits at column '//to_text(first))
      return
    end if
    if (scan(parser%text(min(last + 1, len(parser%text)):), 'ed') == 1) then
      mark = last + 2
      if (mark < len(parser%text)) then
        if (scan(parser%text(mark:mark), '+-') > 0) mark = mark + 1
      end if
      ! without digits it is no exponent but a name that lacks its operator
      if (end_of(parser%text, mark, digits) >= mark) last = end_of(parser%text, mark, digits)
    end if
    x = 0.0_wp
    call text_as_real(parser%text(first:last), x, reason)
    if (len(reason) > 0) then
      call parser%fail('the number at column '//to_text(first)//' '//reason)
      return
    end if
    call parser%push(first, op_constant, x)
    call parser%advance(last + 1 - first)
  end subroutine parse_number

  recursive subroutine parse_name(parser, variables)
    !! A variable, pi or a function with its arguments.
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    character(len=:), allocatable :: name
    integer :: column, k

    column = parser%at
    name = parser%text(column:end_of(parser%text, column, letters//digits))
    call parser%advance(len(name))
    do k = 1, size(variables)
      if (lower_case(variables(k)) == name) then
        call parser%push(column, -k)
        return
      end if
    end do
    if (name == name_of_pi) then
      call parser%push(column, op_constant, acos(-1.0_wp))
      return
    end if
    do k = 1, size(function_name)
      if (function_name(k) == name) then
        call parse_arguments(parser, variables, column, name, function_code(k))
        return
      end if
    end do
    do k = 1, size(parser%known)
      if (lower_case(trim(parser%known(k)%name)) == name) then
        call parse_arguments(parser, variables, column, name, op_table + place_of(parser, k))
        return
      end if
    end do
    call complain_about_name(parser, variables, name, column)
  end subroutine parse_name

  integer function place_of(parser, known) result(place)
    !! Where the formula keeps a known table; a name that is there is not put there again.
    type(parser_t), intent(inout) :: parser
    integer, intent(in) :: known
    type(named_table_t), allocatable :: more(:)
    character(len=:), allocatable :: name
    integer :: k

    name = lower_case(trim(parser%known(known)%name))
    place = findloc(parser%table%name == name, .true., dim=1)
    if (place > 0) return
    place = size(parser%table) + 1
    allocate (more(place))
    do k = 1, place - 1
      more(k) = parser%table(k)
    end do
    more(place) = parser%known(known)
    more(place)%name = name
    call move_alloc(more, parser%table)
  end function place_of

  recursive subroutine parse_arguments(parser, variables, column, name, code)
    !! (sum {, sum}) of a function.
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:)
    integer, intent(in) :: column   !! of the function's name
    character(len=*), intent(in) :: name
    integer, intent(in) :: code     !! of the function
    integer :: bracket, n, wanted

    wanted = merge(1, 2, code < op_add .or. code > op_table)
    bracket = parser%at
    if (parser%next /= '(') then
      call parser%fail(name//' at column '//to_text(column)//' needs brackets: '//name// &
                       trim(merge('(a)   ', '(a, b)', wanted == 1)))
      return
    end if
    call parser%advance(1)
    call parse_sum(parser, variables)
    n = 1
    do while (parser%next == ',')
      call parser%advance(1)
      call parse_sum(parser, variables)
      n = n + 1
    end do
    call close_bracket(parser, bracket)
    if (n /= wanted) then
      call parser%fail(name//' at column '//to_text(column)//' takes '// &
                       trim(merge('1 argument ', '2 arguments', wanted == 1))//', not '//to_text(n))
    end if
    call parser%operate(code, wanted)
  end subroutine parse_arguments

  subroutine close_bracket(parser, column)
    !! The bracket that must come next.
    type(parser_t), intent(inout) :: parser
    integer, intent(in) :: column   !! of the one that it closes

    if (parser%next == ')') then
      call parser%advance(1)
    else if (parser%next == ' ') then
      call parser%fail("')' is missing for the '(' at column "//to_text(column))
    else
      call complain_about_next(parser)
    end if
  end subroutine close_bracket

  pure integer function end_of(text, first, set) result(last)
    !! Last of the characters of a set from `first` on; first - 1 if there is none.
    character(len=*), intent(in) :: text
    integer, intent(in) :: first   !! may lie behind the text
    character(len=*), intent(in) :: set

    last = first - 1
    do while (last < len(text))
      if (scan(text(last + 1:last + 1), set) == 0) exit
      last = last + 1
    end do
  end function end_of

  ! ---------------------------------------------------------------- complaints

  subroutine complain_about_next(parser)
    !! What comes next cannot follow a value.
    type(parser_t), intent(inout) :: parser
    character(len=:), allocatable :: column

    column = to_text(parser%at)
    if (parser%next == ')') then
      call parser%fail("')' at column "//column//' closes nothing')
    else if (scan(parser%next, digits//letters//'.(') > 0) then
      call parser%fail('an operator is missing before column '//column)
    else
      call parser%fail('unexpected '//quoted(parser%next)//' at column '//column)
    end if
  end subroutine complain_about_next

  subroutine complain_about_name(parser, variables, name, column)
    !! An unknown name: the one most likely meant, else all that are known.
    type(parser_t), intent(inout) :: parser
    character(len=*), intent(in) :: variables(:), name
    integer, intent(in) :: column
    character(len=max(len(variables), len(function_name), len(parser%known%name))) :: &
      known(size(variables) + 1 + size(function_name) + size(parser%known))
    character(len=:), allocatable :: hint
    integer :: k

    known(:size(variables)) = variables
    known(size(variables) + 1) = name_of_pi
    k = size(variables) + 2
    known(k:k + size(function_name) - 1) = function_name
    known(k + size(function_name):) = parser%known%name
    hint = nearest_name(name, known)
    if (len(hint) > 0) then
      hint = 'did you mean '//hint//'?'
    else
      hint = 'known are'
      do k = 1, size(known)
        hint = hint//' '//trim(known(k))
      end do
    end if
    call parser%fail("unknown name '"//name//"' at column "//to_text(column)//'; '//hint)
  end subroutine complain_about_name

  pure function quoted(character_) result(text)
    !! A character for a message; what does not print is named.
    character, intent(in) :: character_
    character(len=:), allocatable :: text

    text = 'special character'
    if (iachar(character_) > 32 .and. iachar(character_) < 127) text = "'"//character_//"'"
  end function quoted

  ! ---------------------------------------------------------------- parser

  pure subroutine parser_advance(self, n)
    !! Goes on by n characters, and past blanks, tabs and ends of lines.
    class(parser_t), intent(inout) :: self
    integer, intent(in) :: n

    self%at = self%at + n
    self%next = ' '
    do while (self%at <= len(self%text))
      if (scan(self%text(self%at:self%at), ' '//achar(9)//achar(10)//achar(13)) == 0) then
        self%next = self%text(self%at:self%at)
        return
      end if
      self%at = self%at + 1
    end do
  end subroutine parser_advance

  pure subroutine parser_fail(self, message)
    !! Records the first error and ends the text, so that all loops end.
    class(parser_t), intent(inout) :: self
    character(len=*), intent(in) :: message

    if (self%failed()) return
    self%message = message
    self%at = len(self%text) + 1
    self%next = ' '
  end subroutine parser_fail

  pure logical function parser_failed(self) result(failed)
    !! Has an error been found?
    class(parser_t), intent(in) :: self

    failed = allocated(self%message)
  end function parser_failed

  pure subroutine parser_push(self, column, code, constant)
    !! Appends an instruction that puts a value on the stack.
    class(parser_t), intent(inout) :: self
    integer, intent(in) :: column   !! of the value
    integer, intent(in) :: code
    real(wp), intent(in), optional :: constant

    if (self%failed()) return
    if (self%n_waiting == stack_size) then
      call self%fail('too deeply nested at column '//to_text(column))
      return
    end if
    self%n_waiting = self%n_waiting + 1
    self%n_code = self%n_code + 1
    self%code(self%n_code) = code
    if (.not. present(constant)) return
    self%n_constant = self%n_constant + 1
    self%constant(self%n_constant) = constant
  end subroutine parser_push

  pure subroutine parser_operate(self, code, n)
    !! Appends an operation, or its result if its n operands are constants.
    class(parser_t), intent(inout) :: self
    integer, intent(in) :: code
    integer, intent(in) :: n   !! operands, 1 or 2
    real(wp) :: x

    if (self%failed()) return
    self%n_waiting = self%n_waiting - n + 1
    if (all(self%code(self%n_code - n + 1:self%n_code) == op_constant)) then
      associate (last => self%constant(self%n_constant), &
                 first => self%constant(self%n_constant - n + 1))
        if (code > op_table) then
          x = self%table(code - op_table)%at(last)
        else if (n == 1) then
          x = unary(code, last)
        end if
        if (n == 2) x = binary(code, first, last)
      end associate
      if (abs(x) <= huge(x)) then
        self%n_code = self%n_code - n + 1
        self%n_constant = self%n_constant - n + 1
        self%constant(self%n_constant) = x
        return
      end if
    end if
    self%n_code = self%n_code + 1
    self%code(self%n_code) = code
  end subroutine parser_operate
end module dosui_expression

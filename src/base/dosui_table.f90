!! Functions of one number, given by their values at some: of a time, or of an elevation.
module dosui_table
  use dosui_fields, only: field_name, find_fields, line_limit, most_fields, next_line, &
                          shown_word, text_start
  use dosui_kinds, only: wp
  use dosui_numbers, only: text_as_real
  use dosui_text, only: to_text
  implicit none
  private

  integer, parameter, public :: table_name_length = 64

  type, public :: table_t
    !! Linear between entries, constant before the first and after the last; without entries 1.
    real(wp), allocatable :: argument(:)   !! strictly increasing [s], or any unit
    real(wp), allocatable :: value(:)      !! same length [unit of the quantity]
  contains
    procedure :: at => table_at
    procedure :: integral => table_integral
    procedure :: parse => table_parse
  end type table_t

  type, extends(table_t), public :: named_table_t
    !! A table that formulas call by its name.
    character(len=table_name_length) :: name = ''
    character(len=:), allocatable :: file   !! of its entries; unallocated: given in the scene
  end type named_table_t

contains

  pure real(wp) function table_at(self, argument) result(value)
    !! Value of the table; 1 without entries [unit of the quantity].
    class(table_t), intent(in) :: self
    real(wp), intent(in) :: argument   !! [s], or its unit
    integer :: k, n

    value = 1.0_wp
    if (.not. allocated(self%argument)) return
    n = size(self%argument)
    if (argument <= self%argument(1)) then
      value = self%value(1)
    else if (argument >= self%argument(n)) then
      value = self%value(n)
    else
      k = last_before(self%argument, argument)
      value = self%value(k) + (self%value(k + 1) - self%value(k))* &
              (argument - self%argument(k))/(self%argument(k + 1) - self%argument(k))
    end if
  end function table_at

  pure integer function last_before(entries, argument) result(k)
    !! The last of increasing entries that is not above an argument between first and last; the
    !! first for an argument that is no number.
    real(wp), intent(in) :: entries(:), argument   !! [s], or their unit
    integer :: above, middle

    k = 1
    above = size(entries)
    do while (above - k > 1)
      middle = k + (above - k)/2
      if (entries(middle) <= argument) then
        k = middle
      else
        above = middle
      end if
    end do
  end function last_before

  pure real(wp) function table_integral(self, time) result(integral)
    !! Integral of the table from 0 to a time [unit s].
    class(table_t), intent(in) :: self
    real(wp), intent(in) :: time   !! [s]
    real(wp) :: left, right
    integer :: k

    if (.not. allocated(self%argument)) then
      integral = time
      return
    end if
    integral = 0.0_wp
    left = 0.0_wp
    do k = 1, size(self%argument)
      right = min(max(self%argument(k), 0.0_wp), time)
      if (right > left) then
        integral = integral + 0.5_wp*(right - left)*(self%at(left) + self%at(right))
        left = right
      end if
    end do
    if (time > left) integral = integral + (time - left)*self%at(time)
  end function table_integral

  subroutine table_parse(self, text, names, message)
    !! Reads a file: two numbers in each line, blanks or a comma between them; a '#' begins a
    !! comment.
    class(table_t), intent(inout) :: self
    character(len=*), intent(in) :: text
    character(len=*), intent(in) :: names(2)   !! of the columns, for messages
    character(len=:), allocatable, intent(inout) :: message   !! '' if all is well
    real(wp), allocatable :: rows(:, :)
    integer :: start(most_fields), finish(most_fields), place, number, first, last, n, n_field

    allocate (rows(2, line_limit(text)))
    n = 0
    number = 0
    place = text_start(text)
    do while (place <= len(text))
      call next_line(text, place, number, first, last)
      call find_fields(text(first:last), ',;', start, finish, n_field)
      if (n_field == 0) cycle
      if (n_field /= 2) then
        message = 'line '//to_text(number)//': needs two numbers, '//trim(names(1))//' and '// &
                  trim(names(2))//', not '//shown_word(text(first:last))
        return
      end if
      n = n + 1
      call read_pair(text(first:last), start, finish, names, number, rows(:, n), message)
      if (len(message) == 0 .and. n > 1) then
        if (.not. rows(1, n) > rows(1, n - 1)) then
          message = 'line '//to_text(number)//': its '//trim(names(1))// &
                    's must increase strictly'
        end if
      end if
      if (len(message) > 0) return
    end do
    if (n == 0) message = 'holds no table'
    self%argument = rows(1, :n)
    self%value = rows(2, :n)
  end subroutine table_parse

  pure subroutine read_pair(line, start, finish, names, number, pair, message)
    !! The two numbers of a line.
    character(len=*), intent(in) :: line
    integer, intent(in) :: start(:), finish(:)   !! of its fields
    character(len=*), intent(in) :: names(2)     !! of the columns
    integer, intent(in) :: number                !! of the line
    real(wp), intent(inout) :: pair(2)
    character(len=:), allocatable, intent(inout) :: message
    real(wp), parameter :: largest = 1.0e15_wp
    character(len=:), allocatable :: reason
    integer :: k

    do k = 1, 2
      call text_as_real(line(start(k):finish(k)), pair(k), reason)
      if (finish(k) < start(k)) reason = 'is empty'
      if (len(reason) == 0 .and. .not. abs(pair(k)) <= largest) then
        reason = 'must be between -1e15 and 1e15'
      end if
      if (len(reason) == 0) cycle
      message = field_name(number, k, trim(names(k)), line(start(k):finish(k)))//': '//reason
      return
    end do
  end subroutine read_pair
end module dosui_table

!! Growing lists of matrix entries: row, column, value. Equal places are summed by the matrix.
module dosui_entries
  use dosui_kinds, only: wp
  implicit none
  private

  type, public :: entries_t
    integer :: n = 0
    integer, allocatable :: row(:), column(:)   !! global numbers from 0; negative: left out
    real(wp), allocatable :: value(:)   !! [unit of the matrix]
  contains
    procedure :: add => entries_add
    procedure :: finish => entries_finish
  end type entries_t

contains

  subroutine entries_add(self, row, column, value)
    !! Adds one entry, unless its place is negative.
    class(entries_t), intent(inout) :: self
    integer, intent(in) :: row, column
    real(wp), intent(in) :: value   !! [unit of the matrix]

    if (row < 0 .or. column < 0) return
    if (.not. allocated(self%row)) then
      allocate (self%row(1024), self%column(1024), self%value(1024))
    else if (self%n == size(self%row)) then
      call resize(self, self%n + self%n/2 + 1)
    end if
    self%n = self%n + 1
    self%row(self%n) = row
    self%column(self%n) = column
    self%value(self%n) = value
  end subroutine entries_add

  subroutine entries_finish(self)
    !! No entry follows: room that is not needed is given back.
    class(entries_t), intent(inout) :: self

    if (.not. allocated(self%row)) allocate (self%row(0), self%column(0), self%value(0))
    if (self%n < size(self%row)) call resize(self, self%n)
  end subroutine entries_finish

  subroutine resize(self, room)
    !! Room for so many entries.
    type(entries_t), intent(inout) :: self
    integer, intent(in) :: room
    integer, allocatable :: numbers(:)
    real(wp), allocatable :: values(:)
    integer :: n

    n = self%n
    allocate (numbers(room))
    numbers(1:n) = self%row(1:n)
    call move_alloc(numbers, self%row)
    allocate (numbers(room))
    numbers(1:n) = self%column(1:n)
    call move_alloc(numbers, self%column)
    allocate (values(room))
    values(1:n) = self%value(1:n)
    call move_alloc(values, self%value)
  end subroutine resize
end module dosui_entries

!! Named time histories: a table of rows that the root rank collects until they are written.
module dosui_history
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  implicit none
  private

  type, public :: history_column_t
    character(len=96) :: name = ''   !! becomes the name of a dataset
    character(len=16) :: unit = ''   !! '' for a pure number
  end type history_column_t

  type, public :: history_t
    !! All ranks know the columns; only root appends rows. The first column should be 'time'.
    type(history_column_t), allocatable :: column(:)
    integer :: n_row = 0                    !! rows waiting to be written
    real(wp), allocatable :: value(:, :)    !! (column, row >= n_row) [units of the columns]
  contains
    procedure :: add_column => history_add_column
    procedure :: n_column => history_n_column
    procedure :: append => history_append
    procedure :: clear => history_clear
  end type history_t

contains

  subroutine history_add_column(self, name, unit, column, err)
    !! Adds a column before the first row; its position comes back.
    class(history_t), intent(inout) :: self
    character(len=*), intent(in) :: name   !! unique, without '/'
    character(len=*), intent(in) :: unit
    integer, intent(out) :: column
    type(error_t), intent(inout) :: err
    type(history_column_t), allocatable :: longer(:)
    integer :: k

    column = 0
    do k = 1, self%n_column()
      if (self%column(k)%name == name) call err%set("two histories are called '"//trim(name)//"'")
    end do
    if (len_trim(name) == 0) call err%set('a history has no name')
    if (len_trim(name) > len(longer%name)) call err%set("the name of the history '"// &
                                                        trim(name)//"' is too long")
    if (index(name, '/') > 0 .or. trim(name) == '.') then
      call err%set("the name of the history '"//trim(name)//"' contains '/'")
    end if
    if (self%n_row > 0) call err%set("history '"//trim(name)//"' begins after the first row")
    if (err%failed()) return
    column = self%n_column() + 1
    allocate (longer(column))
    if (column > 1) longer(:column - 1) = self%column
    longer(column)%name = name
    longer(column)%unit = unit
    call move_alloc(longer, self%column)
  end subroutine history_add_column

  pure integer function history_n_column(self) result(n)
    class(history_t), intent(in) :: self

    n = 0
    if (allocated(self%column)) n = size(self%column)
  end function history_n_column

  subroutine history_append(self, row)
    !! Adds a row. Call on root only.
    class(history_t), intent(inout) :: self
    real(wp), intent(in) :: row(:)   !! one value a column [unit of the column]
    real(wp), allocatable :: longer(:, :)
    integer :: capacity

    if (.not. allocated(self%value)) allocate (self%value(self%n_column(), 64))
    capacity = size(self%value, 2)
    if (self%n_row == capacity) then
      allocate (longer(self%n_column(), 2*capacity))
      longer(:, :capacity) = self%value
      call move_alloc(longer, self%value)
    end if
    self%n_row = self%n_row + 1
    self%value(:, self%n_row) = row
  end subroutine history_append

  subroutine history_clear(self)
    !! Forgets the waiting rows (after they have been written).
    class(history_t), intent(inout) :: self

    self%n_row = 0
  end subroutine history_clear
end module dosui_history

!! Sets of points as structures of arrays: named real fields and global identities.
!!
!! A field is registered once, with what sorting, migration, ghost exchange, output and checkpoint
!! need to know; they all loop over the table.
module dosui_point_set
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_keys, only: pack_key
  use dosui_migration, only: migrate_rows
  use dosui_sort, only: sort_permutation
  implicit none
  private

  public :: cell_order

  type, public :: field_t
    character(len=32) :: name = ''
    character(len=16) :: unit = ''
    integer :: width = 1              !! components
    logical :: migrates = .true.      !! travels with the point
    logical :: halo = .false.         !! has values on ghosts
    logical :: output = .false.       !! written to the result file
    logical :: checkpoint = .false.   !! needed to continue a run
    real(wp), allocatable :: values(:, :)   !! (width, capacity) [unit of the field]
  end type field_t

  type, public :: point_set_t
    integer :: count = 0              !! owned points
    integer :: ghost_count = 0        !! ghosts, behind the owned ones, in halo fields only
    integer(i8), allocatable :: id(:) !! (capacity) global identities, ghosts too
    type(field_t), allocatable :: field(:)
  contains
    procedure :: add => point_set_add
    procedure :: handle => point_set_handle
    procedure :: resize => point_set_resize
    procedure :: reorder => point_set_reorder
    procedure :: migrate => point_set_migrate
    procedure :: memory_bytes => point_set_memory_bytes
  end type point_set_t

contains

  integer function point_set_add(self, name, unit, width, migrates, halo, output, checkpoint) &
    result(handle)
    !! Registers a field before any point exists; returns its place in the table.
    class(point_set_t), intent(inout) :: self
    character(len=*), intent(in) :: name, unit
    integer, intent(in) :: width
    logical, intent(in) :: migrates, halo, output, checkpoint
    type(field_t) :: new

    if (.not. allocated(self%field)) allocate (self%field(0))
    if (.not. allocated(self%id)) allocate (self%id(0))
    new%name = name
    new%unit = unit
    new%width = width
    new%migrates = migrates
    new%halo = halo
    new%output = output
    new%checkpoint = checkpoint
    allocate (new%values(width, 0))
    self%field = [self%field, new]
    handle = size(self%field)
  end function point_set_add

  pure integer function point_set_handle(self, name) result(handle)
    !! Place of a field in the table; 0 when the scene has no such field.
    class(point_set_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer :: k

    handle = 0
    if (.not. allocated(self%field)) return
    do k = 1, size(self%field)
      if (self%field(k)%name == name) handle = k
    end do
  end function point_set_handle

  subroutine point_set_resize(self, count, ghost_count)
    !! Sets the numbers of points; contents of points that stay are kept, new values are zero.
    class(point_set_t), intent(inout) :: self
    integer, intent(in) :: count
    integer, intent(in), optional :: ghost_count   !! default 0
    integer(i8), allocatable :: id(:)
    integer :: k, n, kept

    kept = min(self%count, count)
    self%count = count
    self%ghost_count = 0
    if (present(ghost_count)) self%ghost_count = ghost_count
    do k = 1, size(self%field)
      call resize_field(self%field(k), kept, &
                        count + merge(self%ghost_count, 0, self%field(k)%halo))
    end do
    n = count + self%ghost_count
    if (size(self%id) < n) then
      allocate (id(room_for(n, kept)), source=0_i8)
      id(1:kept) = self%id(1:kept)
      call move_alloc(id, self%id)
    else
      self%id(kept + 1:n) = 0_i8
    end if
  end subroutine point_set_resize

  subroutine resize_field(field, kept, n)
    !! Makes room for n points when there is less; those after the kept ones are zero.
    type(field_t), intent(inout) :: field
    integer, intent(in) :: kept, n
    real(wp), allocatable :: values(:, :)

    if (size(field%values, 2) >= n) then
      field%values(:, kept + 1:n) = 0.0_wp
      return
    end if
    allocate (values(field%width, room_for(n, kept)), source=0.0_wp)
    values(:, 1:kept) = field%values(:, 1:kept)
    call move_alloc(values, field%values)
  end subroutine resize_field

  pure integer function room_for(n, kept) result(room)
    !! Points to make room for: what is asked in the beginning, an eighth more for a set that grows.
    integer, intent(in) :: n, kept

    room = n
    if (kept > 0) room = n + n/8
  end function room_for

  subroutine point_set_reorder(self, permutation)
    !! New point k is old point permutation(k).
    class(point_set_t), intent(inout) :: self
    integer, intent(in) :: permutation(:)
    real(wp), allocatable :: values(:, :)
    integer :: k

    self%id(1:self%count) = self%id(permutation)
    do k = 1, size(self%field)
      values = self%field(k)%values(:, permutation)
      self%field(k)%values(:, 1:self%count) = values
    end do
  end subroutine point_set_reorder

  subroutine point_set_migrate(self, comm, destination)
    !! Moves points to other ranks; ghosts are forgotten, and when any point moves so are the
    !! values that do not migrate. Collective.
    class(point_set_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: destination(:)       !! (count) rank of each point
    real(wp), allocatable :: rows(:, :)
    integer(i8), allocatable :: ids(:, :)
    integer :: k, width, first, n

    if (.not. comm%any(any(destination /= comm%rank))) then
      call self%resize(self%count)
      return
    end if
    width = sum(self%field%width, mask=self%field%migrates)
    allocate (rows(width, self%count), ids(1, self%count))
    first = 0
    do k = 1, size(self%field)
      if (.not. self%field(k)%migrates) cycle
      rows(first + 1:first + self%field(k)%width, :) = self%field(k)%values(:, 1:self%count)
      first = first + self%field(k)%width
    end do
    ids(1, :) = self%id(1:self%count)
    call migrate_rows(comm, destination, rows, ids)
    n = size(rows, 2)
    call self%resize(0)
    call self%resize(n)
    self%id(1:n) = ids(1, :)
    first = 0
    do k = 1, size(self%field)
      if (.not. self%field(k)%migrates) cycle
      self%field(k)%values(:, 1:n) = rows(first + 1:first + self%field(k)%width, :)
      first = first + self%field(k)%width
    end do
  end subroutine point_set_migrate

  subroutine cell_order(n, position, id, origin, spacing, permutation)
    !! Order by cell (x slowest, so that the vertical neighbours of a cell are near), then by id.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    integer(i8), intent(in) :: id(n)
    real(wp), intent(in) :: origin(ndim), spacing   !! of the grid [m]
    integer, allocatable, intent(out) :: permutation(:)
    integer, allocatable :: by_id(:), by_cell(:)
    integer(i8), allocatable :: key(:)
    integer :: p

    call sort_permutation(id, by_id)
    allocate (key(n))
    do p = 1, n
      key(p) = pack_key(floor((position(:, by_id(p)) - origin)/spacing))
    end do
    call sort_permutation(key, by_cell)
    permutation = by_id(by_cell)
  end subroutine cell_order

  pure real(wp) function point_set_memory_bytes(self) result(bytes)
    !! Memory of all fields [B].
    class(point_set_t), intent(in) :: self
    integer :: k

    bytes = 8.0_wp*real(size(self%id), wp)
    do k = 1, size(self%field)
      bytes = bytes + 8.0_wp*real(size(self%field(k)%values), wp)
    end do
  end function point_set_memory_bytes
end module dosui_point_set

!! Where names stand in a list: found in a time that does not grow with the list.
module dosui_name_index
  use dosui_kinds, only: i8
  implicit none
  private

  integer, parameter :: first_size = 64   ! of the table; a power of two
  integer(i8), parameter :: seed = 1469598103_i8, factor = 16777619_i8, modulus = 2_i8**31

  type :: entry_t
    !! A name and the places where it stands, in their order.
    character(len=:), allocatable :: name
    integer :: n = 0
    integer, allocatable :: place(:)   !! the first n count
  end type entry_t

  type, public :: name_index_t
    !! A hash table with open addressing.
    private
    integer :: n_entry = 0
    type(entry_t), allocatable :: entry(:)    ! the first n_entry count
    integer, allocatable :: slot(:)           ! entry in each slot of the table, 0: none
  contains
    procedure :: add => index_add
    procedure :: add_all => index_add_all
    procedure :: find => index_find
    procedure :: count => index_count
  end type name_index_t

contains

  subroutine index_add(self, name, place)
    !! One more place of a name. Blanks at its end do not count.
    class(name_index_t), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: place
    integer, allocatable :: more(:)
    integer :: s, e

    if (.not. allocated(self%slot)) then
      allocate (self%slot(0:first_size - 1), source=0)
      allocate (self%entry(first_size/2))
    end if
    if (2*self%n_entry >= size(self%slot)) call enlarge(self)
    s = slot_of(self, name)
    if (self%slot(s) == 0) then
      self%n_entry = self%n_entry + 1
      self%slot(s) = self%n_entry
      self%entry(self%n_entry)%name = trim(name)
      allocate (self%entry(self%n_entry)%place(1))
    end if
    e = self%slot(s)
    if (self%entry(e)%n == size(self%entry(e)%place)) then
      allocate (more(2*self%entry(e)%n))
      more(:self%entry(e)%n) = self%entry(e)%place
      call move_alloc(more, self%entry(e)%place)
    end if
    self%entry(e)%n = self%entry(e)%n + 1
    self%entry(e)%place(self%entry(e)%n) = place
  end subroutine index_add

  subroutine index_add_all(self, names)
    !! Names by their places in a list.
    class(name_index_t), intent(inout) :: self
    character(len=*), intent(in) :: names(:)
    integer :: k

    do k = 1, size(names)
      call self%add(names(k), k)
    end do
  end subroutine index_add_all

  pure integer function index_find(self, name, instance) result(place)
    !! A place of a name, the first one by default; 0 if there is none.
    class(name_index_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer, intent(in), optional :: instance   !! 2: the second place, ...
    integer :: e, wanted

    place = 0
    wanted = 1
    if (present(instance)) wanted = instance
    if (self%n_entry == 0) return
    e = self%slot(slot_of(self, name))
    if (e == 0) return
    if (wanted <= self%entry(e)%n) place = self%entry(e)%place(wanted)
  end function index_find

  pure integer function index_count(self, name) result(n)
    !! How many places a name has.
    class(name_index_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer :: e

    n = 0
    if (self%n_entry == 0) return
    e = self%slot(slot_of(self, name))
    if (e > 0) n = self%entry(e)%n
  end function index_count

  pure integer function slot_of(self, name) result(slot)
    !! The slot of a name, or the empty one where it belongs.
    type(name_index_t), intent(in) :: self
    character(len=*), intent(in) :: name
    integer :: e

    slot = int(mod(hash_of(name), int(size(self%slot), i8)))
    do
      e = self%slot(slot)
      if (e == 0) return
      if (self%entry(e)%name == name) return
      slot = mod(slot + 1, size(self%slot))
    end do
  end function slot_of

  pure integer(i8) function hash_of(name) result(hash)
    !! A number below 2**31 that names share by accident only (FNV-1a).
    character(len=*), intent(in) :: name
    integer :: k

    hash = seed
    do k = 1, len_trim(name)
      hash = mod(ieor(hash, int(iachar(name(k:k)), i8))*factor, modulus)
    end do
    hash = ieor(hash, ishft(hash, -15))
  end function hash_of

  subroutine enlarge(self)
    !! Twice the room; places move, they are not copied.
    type(name_index_t), intent(inout) :: self
    type(entry_t), allocatable :: more(:)
    integer :: e, n

    n = 2*size(self%slot)
    deallocate (self%slot)
    allocate (self%slot(0:n - 1), source=0)
    allocate (more(n/2))
    do e = 1, self%n_entry
      call move_alloc(self%entry(e)%name, more(e)%name)
      call move_alloc(self%entry(e)%place, more(e)%place)
      more(e)%n = self%entry(e)%n
    end do
    call move_alloc(more, self%entry)
    do e = 1, self%n_entry
      self%slot(slot_of(self, self%entry(e)%name)) = e
    end do
  end subroutine enlarge
end module dosui_name_index

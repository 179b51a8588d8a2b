!! Integer grid coordinates packed into one sortable 64-bit key: 21 bits per direction.
module dosui_keys
  use dosui_kinds, only: i8
  implicit none
  private

  public :: pack_key, unpack_key, key_in_range

  integer(i8), parameter :: offset = 2_i8**20     !! makes negative coordinates positive
  integer(i8), parameter :: base = 2_i8**21       !! coordinates per direction

  integer, parameter, public :: largest_index = 2**20 - 8
  !! of cells and bins that still have room for neighbours

contains

  pure integer(i8) function pack_key(ijk) result(key)
    !! Key of one to three integer coordinates, the first one varying fastest.
    integer, intent(in) :: ijk(:)   !! each within -2**20 ... 2**20 - 1
    integer :: d

    key = 0_i8
    do d = 3, size(ijk) + 1, -1
      key = key*base + offset
    end do
    do d = size(ijk), 1, -1
      key = key*base + (int(ijk(d), i8) + offset)
    end do
  end function pack_key

  pure function unpack_key(key) result(ijk)
    !! The three coordinates of a key; unused ones are 0.
    integer(i8), intent(in) :: key
    integer :: ijk(3)
    integer(i8) :: rest
    integer :: d

    rest = key
    do d = 1, 3
      ijk(d) = int(mod(rest, base) - offset)
      rest = rest/base
    end do
  end function unpack_key

  pure logical function key_in_range(ijk) result(in_range)
    !! Can these coordinates be packed?
    integer, intent(in) :: ijk(:)

    in_range = all(int(ijk, i8) >= -offset .and. int(ijk, i8) < offset)
  end function key_in_range
end module dosui_keys

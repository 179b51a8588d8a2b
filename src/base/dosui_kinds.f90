!! Number kinds used everywhere in dosui.
module dosui_kinds
  use, intrinsic :: iso_fortran_env, only: real64, int32, int64
  implicit none
  private

  integer, parameter, public :: wp = real64   !! working precision of every real
  integer, parameter, public :: i4 = int32    !! local indices
  integer, parameter, public :: i8 = int64    !! global identities and grid keys
end module dosui_kinds

!! The part of a model that divides the work among ranks.
module dosui_decomposition
  use dosui_kinds, only: wp, i8
  use dosui_partition, only: partition_statistics_t
  implicit none
  private

  type, public :: decomposition_t
    !! Who computes what, and how long it stays so.
    type(partition_statistics_t) :: partition
    integer(i8), allocatable :: brick_key(:)  !! sorted bricks of cells ...
    integer, allocatable :: brick_rank(:)     !! ... and their owners
    integer :: brick_edge = 1                 !! cells along a brick's edge
    integer :: rebuilds = 0
    real(wp) :: movement = 0.0_wp             !! bound of the way since the last build [m]
    integer(i8) :: removed = 0_i8             !! particles that left the domain
  end type decomposition_t
end module dosui_decomposition

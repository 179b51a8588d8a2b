!! Small systems of normal equations.
module dosui_least_squares
  use dosui_kinds, only: wp
  implicit none
  private

  public :: eliminate

  real(wp), parameter :: least_pivot = 1.0e-6_wp   !! over the first one [-]

contains

  pure subroutine eliminate(matrix, right, regular)
    !! Solves a small symmetric positive definite system by elimination.
    real(wp), intent(inout) :: matrix(:, :), right(:)
    !! (m, m) destroyed; (m) right side, then the solution [any unit]
    logical, intent(out) :: regular
    real(wp) :: factor, largest
    integer :: i, j, m

    m = size(right)
    largest = matrix(1, 1)
    regular = .true.
    do i = 1, m
      if (.not. matrix(i, i) > least_pivot*largest) then
        regular = .false.
        return
      end if
      do j = i + 1, m
        factor = matrix(j, i)/matrix(i, i)
        matrix(j, :) = matrix(j, :) - factor*matrix(i, :)
        right(j) = right(j) - factor*right(i)
      end do
    end do
    do i = m, 1, -1
      right(i) = (right(i) - dot_product(matrix(i, i + 1:), right(i + 1:)))/matrix(i, i)
    end do
  end subroutine eliminate
end module dosui_least_squares

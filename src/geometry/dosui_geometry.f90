!! Vector products, and polygons cut along planes.
module dosui_geometry
  use dosui_kinds, only: wp
  implicit none
  private

  public :: cross, clip_outline

contains

  pure function cross(a, b) result(product)
    !! Vector product [product of the units].
    real(wp), intent(in) :: a(3), b(3)   !! [any unit]
    real(wp) :: product(3)

    product = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function cross

  pure subroutine clip_outline(direction, plane, inward, n, outline)
    !! Keeps what of a polygon lies on one side of a plane or in it [Sutherland1974].
    integer, intent(in) :: direction       !! component that is constant in the plane
    real(wp), intent(in) :: plane          !! its value there [m, or any unit of the corners]
    real(wp), intent(in) :: inward         !! 1: above, -1: below is kept [-]
    integer, intent(inout) :: n            !! corners
    real(wp), intent(inout) :: outline(:, :)
    !! (components, at least n + 1 for a convex polygon, else 2 n) corners in their order
    !! [any unit]
    real(wp) :: kept(size(outline, 1), size(outline, 2)), here, next
    integer :: k, m, after

    m = 0
    do k = 1, n
      after = mod(k, n) + 1
      here = inward*(outline(direction, k) - plane)
      next = inward*(outline(direction, after) - plane)
      if (here >= 0.0_wp) then
        m = m + 1
        kept(:, m) = outline(:, k)
      end if
      if ((here > 0.0_wp .and. next < 0.0_wp) .or. (here < 0.0_wp .and. next > 0.0_wp)) then
        m = m + 1
        kept(:, m) = outline(:, k) + here/(here - next)*(outline(:, after) - outline(:, k))
        kept(direction, m) = plane
      end if
    end do
    n = m
    outline(:, :n) = kept(:, :n)
  end subroutine clip_outline
end module dosui_geometry

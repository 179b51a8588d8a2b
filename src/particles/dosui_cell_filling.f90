!! How much of a grid cell the scene's regions fill, exactly: volume and moments of cut cells.
module dosui_cell_filling
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_scene, only: region_t
  use dosui_shapes, only: shape_bounds, turned
  implicit none
  private

  public :: filling_t, cell_filling

  integer, parameter :: middle = min(ndim, 2)   ! y in 3-D

  type :: filling_t
    !! Integrals over the filled part of a cell, in local coordinates (0 to 1 in the cell).
    real(wp) :: volume = 0.0_wp           !! over that of the cell [-]
    real(wp) :: moment(ndim) = 0.0_wp     !! of the coordinates [-]
    real(wp) :: mixed = 0.0_wp            !! of the product of the first and the last one [-]
  contains
    procedure :: add => filling_add
  end type filling_t

contains

  pure subroutine filling_add(self, other, shift)
    !! Adds a part whose local coordinates start `shift` cells away.
    class(filling_t), intent(inout) :: self
    type(filling_t), intent(in) :: other
    integer, intent(in) :: shift(ndim)
    real(wp) :: s(ndim)

    s = real(shift, wp)
    self%mixed = self%mixed + other%mixed + s(1)*other%moment(ndim) + s(ndim)*other%moment(1) + &
                 s(1)*s(ndim)*other%volume
    self%moment = self%moment + other%moment + s*other%volume
    self%volume = self%volume + other%volume
  end subroutine filling_add

  pure function cell_filling(regions, corner, spacing) result(filling)
    !! What all regions together fill of a cell.
    type(region_t), intent(in) :: regions(:)
    real(wp), intent(in) :: corner(ndim)   !! lowest corner of the cell [m]
    real(wp), intent(in) :: spacing        !! of the grid [m]
    type(filling_t) :: filling, part
    real(wp) :: low(ndim), high(ndim), from, to
    integer :: r

    do r = 1, size(regions)
      call shape_bounds(regions(r), regions(r)%shape_angle, low, high)
      low = (low + regions(r)%pivot - corner)/spacing
      high = (high + regions(r)%pivot - corner)/spacing
      if (any(low >= 1.0_wp) .or. any(high <= 0.0_wp)) cycle
      if (ndim == 1) then
        from = max(low(1), 0.0_wp)
        to = min(high(1), 1.0_wp)
        part%volume = to - from
        part%moment = 0.5_wp*(to**2 - from**2)
        part%mixed = (to**3 - from**3)/3.0_wp
      else
        part = section_filling(regions(r), corner, spacing)
        if (ndim == 3) then   ! shapes are prisms along y
          from = max(low(middle), 0.0_wp)
          to = min(high(middle), 1.0_wp)
          part%moment(middle) = 0.5_wp*(to**2 - from**2)*part%volume
          part%moment(1) = (to - from)*part%moment(1)
          part%moment(ndim) = (to - from)*part%moment(ndim)
          part%volume = (to - from)*part%volume
          part%mixed = (to - from)*part%mixed
        end if
      end if
      call filling%add(part, spread(0, 1, ndim))
    end do
  end function cell_filling

  pure function section_filling(region, corner, spacing) result(part)
    !! The x-z section: the shape's outline clipped by the four sides (Sutherland & Hodgman 1974),
    !! and Green's formulas for the integrals.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: corner(ndim), spacing
    type(filling_t) :: part
    real(wp), allocatable :: outline(:, :)
    real(wp) :: cross, x0, z0, x1, z1
    integer :: k, n, side

    call shape_outline(region, corner, spacing, outline)
    do side = 1, 4
      call clip(side, outline)
    end do
    n = size(outline, 2)
    do k = 1, n
      x0 = outline(1, k)
      z0 = outline(2, k)
      x1 = outline(1, mod(k, n) + 1)
      z1 = outline(2, mod(k, n) + 1)
      cross = x0*z1 - x1*z0
      part%volume = part%volume + 0.5_wp*cross
      part%moment(1) = part%moment(1) + cross*(x0 + x1)/6.0_wp
      part%moment(ndim) = part%moment(ndim) + cross*(z0 + z1)/6.0_wp
      part%mixed = part%mixed + cross*(2.0_wp*x0*z0 + x0*z1 + x1*z0 + 2.0_wp*x1*z1)/24.0_wp
    end do
  end function section_filling

  pure subroutine shape_outline(region, corner, spacing, outline)
    !! Corners of the shape's x-z section, counter-clockwise, in the cell's local coordinates.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: corner(ndim), spacing
    real(wp), allocatable, intent(out) :: outline(:, :)
    real(wp) :: point(ndim), area
    integer :: k, n

    n = 4
    if (region%shape == 'polygon') n = size(region%vertices, 2)
    allocate (outline(2, n))
    area = 0.0_wp
    do k = 1, n
      if (region%shape == 'polygon') then
        point = region%vertices(:, k)
      else
        point = region%box_min
        if (k == 2 .or. k == 3) point(1) = region%box_max(1)
        if (k >= 3) point(ndim) = region%box_max(ndim)
      end if
      point = (region%pivot + turned(point - region%pivot, region%shape_angle) - corner)/spacing
      outline(:, k) = point([1, ndim])
    end do
    do k = 1, n
      area = area + outline(1, k)*outline(2, mod(k, n) + 1) - &
             outline(1, mod(k, n) + 1)*outline(2, k)
    end do
    if (area < 0.0_wp) outline = outline(:, n:1:-1)
  end subroutine shape_outline

  pure subroutine clip(side, outline)
    !! Keeps what lies on the inner side of one side of the unit square.
    integer, intent(in) :: side            !! 1: x > 0, 2: x < 1, 3: z > 0, 4: z < 1
    real(wp), allocatable, intent(inout) :: outline(:, :)
    real(wp) :: kept(2, 2*size(outline, 2)), here, next
    integer :: k, n, m, after

    n = size(outline, 2)
    m = 0
    do k = 1, n
      after = mod(k, n) + 1
      here = inner(side, outline(:, k))
      next = inner(side, outline(:, after))
      if (here >= 0.0_wp) then
        m = m + 1
        kept(:, m) = outline(:, k)
      end if
      if ((here > 0.0_wp .and. next < 0.0_wp) .or. (here < 0.0_wp .and. next > 0.0_wp)) then
        m = m + 1
        kept(:, m) = outline(:, k) + here/(here - next)*(outline(:, after) - outline(:, k))
      end if
    end do
    outline = kept(:, 1:m)
  end subroutine clip

  pure real(wp) function inner(side, point) result(distance)
    !! Distance to the inside of a side of the unit square.
    integer, intent(in) :: side
    real(wp), intent(in) :: point(2)

    select case (side)
    case (1)
      distance = point(1)
    case (2)
      distance = 1.0_wp - point(1)
    case (3)
      distance = point(2)
    case default
      distance = 1.0_wp - point(2)
    end select
  end function inner
end module dosui_cell_filling

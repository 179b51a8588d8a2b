!! How much of a grid cell the scene's regions fill, exactly: volume and moments of cut cells.
module dosui_cell_filling
  use dosui_geometry, only: clip_outline
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, axis
  use dosui_scene, only: region_t
  use dosui_shapes, only: shape_bounds, spatial, turned
  implicit none
  private

  public :: filling_t, cell_filling

  integer, parameter :: middle = min(ndim, 2)   ! y in 3-D

  type :: filling_t
    !! Integrals over the filled part of a cell, in local coordinates (0 to 1 in the cell).
    real(wp) :: volume = 0.0_wp           !! over that of the cell [-]
    real(wp) :: moment(ndim) = 0.0_wp     !! of the coordinates [-]
    real(wp) :: mixed(ndim) = 0.0_wp
    !! of the product of the other two coordinates in 3-D; in 2-D the last is that of both [-]
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
    integer :: d, a, b

    s = real(shift, wp)
    if (ndim == 3) then
      do d = 1, ndim
        a = modulo(d, ndim) + 1
        b = modulo(a, ndim) + 1
        self%mixed(d) = self%mixed(d) + other%mixed(d) + s(a)*other%moment(b) + &
                        s(b)*other%moment(a) + s(a)*s(b)*other%volume
      end do
    end if
    if (ndim == 2) then
      self%mixed(ndim) = self%mixed(ndim) + other%mixed(ndim) + s(1)*other%moment(ndim) + &
                         s(ndim)*other%moment(1) + s(1)*s(ndim)*other%volume
    end if
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
      part = filling_t()
      if (regions(r)%shape == 'stl') then
        part = filling_of_body(regions(r), corner, spacing)
      else if (ndim == 1) then
        from = max(low(1), 0.0_wp)
        to = min(high(1), 1.0_wp)
        part%volume = to - from
        part%moment = 0.5_wp*(to**2 - from**2)
      else if (ndim == 2) then
        part = section_filling(regions(r), 0.0_wp, corner, spacing)
      else
        part = filling_of_sections(regions(r), corner, spacing, max(low(middle), 0.0_wp), &
                                   min(high(middle), 1.0_wp))
      end if
      call filling%add(part, spread(0, 1, ndim))
    end do
  end function cell_filling

  pure function filling_of_body(region, corner, spacing) result(part)
    !! What a triangulated body fills of a cell.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: corner(ndim), spacing
    type(filling_t) :: part
    real(wp) :: moment(3), mixed(3)

    call region%body%moments(spatial(corner), spacing, part%volume, moment, mixed)
    part%moment = moment(axis)
    part%mixed = mixed(axis)
  end function filling_of_body

  pure function filling_of_sections(region, corner, spacing, from, to) result(part)
    !! 3-D: x-z sections integrated along y. Boxes are prisms, one section will do; the sections of
    !! spheres are integrated panel by panel (Gauss).
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: corner(ndim), spacing
    real(wp), intent(in) :: from, to               !! ends along y in local coordinates
    type(filling_t) :: part, section
    integer, parameter :: panels = 4, nodes = 3
    real(wp), parameter :: node(nodes) = [-0.774596669241483377036_wp, 0.0_wp, &
                                          0.774596669241483377036_wp]
    real(wp), parameter :: weight(nodes) = [5.0_wp, 8.0_wp, 5.0_wp]/9.0_wp
    real(wp) :: half, y, share
    integer :: k, g

    if (region%shape /= 'sphere') then
      section = section_filling(region, 0.0_wp, corner, spacing)
      call add_section(0.5_wp*(from + to), to - from)
      return
    end if
    half = 0.5_wp*(to - from)/real(panels, wp)
    do k = 1, panels
      do g = 1, nodes
        y = from + half*(real(2*k - 1, wp) + node(g))
        share = half*weight(g)
        section = section_filling(region, corner(middle) + y*spacing - region%centre(middle), &
                                  corner, spacing)
        call add_section(y, share)
      end do
    end do

  contains

    pure subroutine add_section(level, thickness)
      !! A slice with this section.
      real(wp), intent(in) :: level, thickness

      part%volume = part%volume + thickness*section%volume
      part%moment(1) = part%moment(1) + thickness*section%moment(1)
      part%moment(ndim) = part%moment(ndim) + thickness*section%moment(ndim)
      part%moment(middle) = part%moment(middle) + thickness*level*section%volume
      part%mixed(1) = part%mixed(1) + thickness*level*section%moment(ndim)
      part%mixed(ndim) = part%mixed(ndim) + thickness*level*section%moment(1)
      part%mixed(middle) = part%mixed(middle) + thickness*section%mixed(middle)
    end subroutine add_section
  end function filling_of_sections

  pure function section_filling(region, level, corner, spacing) result(part)
    !! The x-z section: the shape's outline clipped by the four sides [Sutherland1974],
    !! and Green's formulas for the integrals.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: level             !! distance of the section from a sphere's centre [m]
    real(wp), intent(in) :: corner(ndim), spacing
    type(filling_t) :: part
    real(wp), allocatable :: outline(:, :)
    integer :: k

    call shape_outline(region, level, corner, spacing, outline)
    call add_outline(1.0_wp, outline, part)
    if (.not. allocated(region%hole)) return
    do k = 1, size(region%hole)
      outline = region%hole(k)%vertices([1, ndim], :)
      call place_outline(region, corner, spacing, outline)
      call add_outline(-1.0_wp, outline, part)
    end do
  end function section_filling

  pure subroutine add_outline(factor, outline, part)
    !! Adds what an outline encloses of the unit square.
    real(wp), intent(in) :: factor           !! -1 takes it away
    real(wp), allocatable, intent(inout) :: outline(:, :)   !! counter-clockwise; is clipped
    type(filling_t), intent(inout) :: part
    real(wp) :: cross, x0, z0, x1, z1
    integer :: k, n, side

    do side = 1, 4
      call clip(side, outline)
    end do
    n = size(outline, 2)
    do k = 1, n
      x0 = outline(1, k)
      z0 = outline(2, k)
      x1 = outline(1, mod(k, n) + 1)
      z1 = outline(2, mod(k, n) + 1)
      cross = factor*(x0*z1 - x1*z0)
      part%volume = part%volume + 0.5_wp*cross
      part%moment(1) = part%moment(1) + cross*(x0 + x1)/6.0_wp
      part%moment(ndim) = part%moment(ndim) + cross*(z0 + z1)/6.0_wp
      part%mixed(middle) = part%mixed(middle) + &
                           cross*(2.0_wp*x0*z0 + x0*z1 + x1*z0 + 2.0_wp*x1*z1)/24.0_wp
    end do
  end subroutine add_outline

  pure subroutine shape_outline(region, level, corner, spacing, outline)
    !! Corners of the shape's x-z section, counter-clockwise, in the cell's local coordinates.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: level
    real(wp), intent(in) :: corner(ndim), spacing
    real(wp), allocatable, intent(out) :: outline(:, :)

    if (region%shape == 'circle' .or. region%shape == 'sphere') then
      call round_outline(region, level, corner, spacing, outline)
    else if (region%shape == 'polygon') then
      outline = region%vertices([1, ndim], :)
    else
      allocate (outline(2, 4))
      outline(1, :) = [region%box_min(1), region%box_max(1), region%box_max(1), region%box_min(1)]
      outline(2, :) = [region%box_min(ndim), region%box_min(ndim), region%box_max(ndim), &
                       region%box_max(ndim)]
    end if
    call place_outline(region, corner, spacing, outline)
  end subroutine shape_outline

  pure subroutine place_outline(region, corner, spacing, outline)
    !! Turns an outline with its region and puts it into the cell's local coordinates,
    !! counter-clockwise.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: corner(ndim), spacing
    real(wp), allocatable, intent(inout) :: outline(:, :)
    real(wp) :: point(ndim), area
    integer :: k, n

    n = size(outline, 2)
    do k = 1, n
      point = 0.0_wp
      point(1) = outline(1, k)
      point(ndim) = outline(2, k)
      point = (region%pivot + turned(point - region%pivot, region%shape_angle) - corner)/spacing
      outline(:, k) = point([1, ndim])
    end do
    area = 0.0_wp
    do k = 1, n
      area = area + outline(1, k)*outline(2, mod(k, n) + 1) - &
             outline(1, mod(k, n) + 1)*outline(2, k)
    end do
    if (area < 0.0_wp) outline = outline(:, n:1:-1)
  end subroutine place_outline

  pure subroutine round_outline(region, level, corner, spacing, outline)
    !! Section of a circle or sphere within its cuts, before turning: a polygon of equal area, fine
    !! where the cell is, coarse elsewhere [m].
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: level
    real(wp), intent(in) :: corner(ndim), spacing
    real(wp), allocatable, intent(out) :: outline(:, :)
    real(wp), parameter :: pi = acos(-1.0_wp), reach = 1.5_wp   ! cell's middle to corner, and more
    integer, parameter :: n_coarse = 16, per_cell = 24
    real(wp) :: radius, place(ndim), angle, half, step, blown
    integer :: k, n_fine

    radius = sqrt(max(region%radius**2 - level**2, 0.0_wp))
    place = corner + 0.5_wp*spacing
    place = region%pivot + turned(place - region%pivot, -region%shape_angle) - region%centre
    place(middle) = merge(place(middle), 0.0_wp, ndim == 2)
    angle = atan2(place(ndim), place(1))
    half = pi
    if (norm2(place) > 2.0_wp*reach*spacing) half = asin(reach*spacing/norm2(place))
    n_fine = max(4, ceiling(2.0_wp*half*radius/spacing*per_cell))
    allocate (outline(2, n_fine + merge(n_coarse, 0, half < pi)))
    step = 2.0_wp*half/real(n_fine, wp)
    do k = 1, size(outline, 2)
      if (k == n_fine + 1) then
        angle = angle + half
        step = 2.0_wp*(pi - half)/real(n_coarse, wp)
        half = 0.0_wp
      end if
      blown = radius*sqrt(step/sin(step))
      associate (a => angle - half + step*(real(merge(k, k - n_fine, k <= n_fine), wp) - 0.5_wp))
        outline(:, k) = region%centre([1, ndim]) + blown*[cos(a), sin(a)]
      end associate
    end do
    do k = 1, 2
      call cut(k, region%cut_min(merge(1, ndim, k == 1)), 1.0_wp, outline)
      call cut(k, region%cut_max(merge(1, ndim, k == 1)), -1.0_wp, outline)
    end do
  end subroutine round_outline

  pure subroutine clip(side, outline)
    !! Keeps what lies on the inner side of one side of the unit square.
    integer, intent(in) :: side            !! 1: x > 0, 2: x < 1, 3: z > 0, 4: z < 1
    real(wp), allocatable, intent(inout) :: outline(:, :)

    call cut((side + 1)/2, real(1 - mod(side, 2), wp), real(2*mod(side, 2) - 1, wp), outline)
  end subroutine clip

  pure subroutine cut(direction, plane, inward, outline)
    !! Keeps what lies on one side of a plane.
    integer, intent(in) :: direction       !! 1: x, 2: z
    real(wp), intent(in) :: plane
    real(wp), intent(in) :: inward         !! 1: above, -1: below is kept
    real(wp), allocatable, intent(inout) :: outline(:, :)
    real(wp) :: room(2, 2*size(outline, 2))
    integer :: n

    n = size(outline, 2)
    room(:, 1:n) = outline
    call clip_outline(direction, plane, inward, n, room)
    outline = room(:, 1:n)
  end subroutine cut
end module dosui_cell_filling

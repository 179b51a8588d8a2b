!! Geometry of regions: inside tests and the planar faces of boxes and polygons.
module dosui_shapes
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_scene, only: region_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: shape_bounds, shape_contains, shape_faces, shape_measure, turned, degrees

  real(wp), parameter :: degrees = acos(-1.0_wp)/180.0_wp   !! radians per degree

  type, public :: face_t
    !! A planar face: corner + sum of fractions of its edges, with the outward unit normal.
    character(len=16) :: name = ''                  !! 'x-' ... 'z+' or 'edge1' ...
    real(wp) :: corner(ndim) = 0.0_wp               !! [m]
    real(wp) :: edge(ndim, max(ndim - 1, 1)) = 0.0_wp   !! edges that span it, unused in 1-D [m]
    real(wp) :: normal(ndim) = 0.0_wp               !! outward [-]
  end type face_t

contains

  pure function turned(vector, angle) result(rotated)
    !! A vector turned by an angle in the x-z plane, from x towards z. 1-D: unchanged.
    real(wp), intent(in) :: vector(ndim)
    real(wp), intent(in) :: angle   !! [deg]
    real(wp) :: rotated(ndim)

    rotated = vector
    if (ndim == 1 .or. abs(angle) <= 0.0_wp) return
    rotated(1) = cos(angle*degrees)*vector(1) - sin(angle*degrees)*vector(ndim)
    rotated(ndim) = sin(angle*degrees)*vector(1) + cos(angle*degrees)*vector(ndim)
  end function turned

  pure subroutine shape_bounds(region, angle, low, high)
    !! Bounds, relative to the pivot, of the shape as given turned by an angle about the pivot [m].
    !! With the shape's own angle: its place; less the lattice's angle: as its lattice sees it.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: angle   !! [deg]
    real(wp), intent(out) :: low(ndim), high(ndim)
    real(wp) :: corner(ndim)
    integer :: k, d, n_corner

    n_corner = 2**ndim
    if (region%shape == 'polygon') n_corner = size(region%vertices, 2)
    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do k = 1, n_corner
      if (region%shape == 'polygon') then
        corner = region%vertices(:, k)
      else
        do d = 1, ndim
          corner(d) = merge(region%box_max(d), region%box_min(d), btest(k, d - 1))
        end do
      end if
      corner = turned(corner - region%pivot, angle)
      low = min(low, corner)
      high = max(high, corner)
    end do
  end subroutine shape_bounds

  pure logical function shape_contains(region, position, margin) result(inside)
    !! Is a position inside the shape, at least `margin` away from its faces?
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp), intent(in) :: margin           !! may be negative [m]
    real(wp) :: local(ndim)

    local = region%pivot + turned(position - region%pivot, -region%shape_angle)
    if (region%shape == 'polygon') then
      inside = inside_polygon(region%vertices, local)
      if (abs(margin) > 0.0_wp) then
        if (distance_to_edges(region%vertices, local) < abs(margin)) inside = margin < 0.0_wp
      end if
    else
      inside = all(local >= region%box_min + margin .and. local <= region%box_max - margin)
    end if
  end function shape_contains

  pure logical function inside_polygon(vertices, position) result(inside)
    !! Even-odd rule.
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n) [m]
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp) :: a(ndim), b(ndim)
    integer :: k, n

    inside = .false.
    n = size(vertices, 2)
    do k = 1, n
      a = vertices(:, k)
      b = vertices(:, modulo(k, n) + 1)
      if ((a(ndim) > position(ndim)) .eqv. (b(ndim) > position(ndim))) cycle
      if (position(1) < a(1) + (b(1) - a(1))*(position(ndim) - a(ndim))/(b(ndim) - a(ndim))) then
        inside = .not. inside
      end if
    end do
  end function inside_polygon

  pure real(wp) function distance_to_edges(vertices, position) result(distance)
    !! Distance to the nearest edge of a polygon [m].
    real(wp), intent(in) :: vertices(:, :)
    real(wp), intent(in) :: position(ndim)
    real(wp) :: a(ndim), ab(ndim), fraction
    integer :: k, n

    distance = huge(1.0_wp)
    n = size(vertices, 2)
    do k = 1, n
      a = vertices(:, k)
      ab = vertices(:, modulo(k, n) + 1) - a
      fraction = min(max(dot_product(position - a, ab)/dot_product(ab, ab), 0.0_wp), 1.0_wp)
      distance = min(distance, norm2(position - a - fraction*ab))
    end do
  end function distance_to_edges

  pure real(wp) function shape_measure(region) result(measure)
    !! Volume of the shape [m3; m2 in 2-D, m in 1-D].
    type(region_t), intent(in) :: region
    integer :: k, n, next

    if (region%shape == 'polygon') then
      measure = 0.0_wp
      n = size(region%vertices, 2)
      do k = 1, n
        next = modulo(k, n) + 1
        measure = measure + 0.5_wp*(region%vertices(1, k)*region%vertices(ndim, next) - &
                                    region%vertices(1, next)*region%vertices(ndim, k))
      end do
      measure = abs(measure)
    else
      measure = product(region%box_max - region%box_min)
    end if
  end function shape_measure

  pure function shape_faces(region) result(faces)
    !! All faces of a region, turned with it.
    type(region_t), intent(in) :: region
    type(face_t), allocatable :: faces(:)
    integer :: k

    if (region%shape == 'polygon') then
      faces = polygon_faces(region)
    else
      faces = box_faces(region)
    end if
    do k = 1, size(faces)
      faces(k)%corner = region%pivot + turned(faces(k)%corner - region%pivot, region%shape_angle)
      faces(k)%normal = turned(faces(k)%normal, region%shape_angle)
      faces(k)%edge(:, 1) = turned(faces(k)%edge(:, 1), region%shape_angle)
      if (ndim == 3) faces(k)%edge(:, size(faces(k)%edge, 2)) = &
        turned(faces(k)%edge(:, size(faces(k)%edge, 2)), region%shape_angle)
    end do
  end function shape_faces

  pure function box_faces(region) result(faces)
    !! The faces x-, x+, (y-, y+,) z-, z+ of an unturned box.
    type(region_t), intent(in) :: region
    type(face_t), allocatable :: faces(:)
    character(len=1), parameter :: names(3) = ['x', 'y', 'z']
    real(wp) :: extent(ndim)
    integer :: d, side, k, other, e

    allocate (faces(2*ndim))
    extent = region%box_max - region%box_min
    k = 0
    do d = 1, ndim
      do side = -1, 1, 2
        k = k + 1
        faces(k)%name = names(merge(3, d, d == ndim))//merge('-', '+', side < 0)
        faces(k)%normal(d) = real(side, wp)
        faces(k)%corner = region%box_min
        if (side > 0) faces(k)%corner(d) = region%box_max(d)
        e = 0
        do other = 1, ndim
          if (other == d) cycle
          e = e + 1
          faces(k)%edge(other, e) = extent(other)
        end do
      end do
    end do
  end function box_faces

  pure function polygon_faces(region) result(faces)
    !! One face an edge of an unturned counter-clockwise polygon (2-D).
    type(region_t), intent(in) :: region
    type(face_t), allocatable :: faces(:)
    integer :: k, n

    n = size(region%vertices, 2)
    allocate (faces(n))
    do k = 1, n
      faces(k)%name = 'edge'//to_text(k)
      faces(k)%corner = region%vertices(:, k)
      faces(k)%edge(:, 1) = region%vertices(:, modulo(k, n) + 1) - region%vertices(:, k)
      faces(k)%normal(1) = faces(k)%edge(ndim, 1)
      faces(k)%normal(ndim) = -faces(k)%edge(1, 1)
      faces(k)%normal = faces(k)%normal/norm2(faces(k)%normal)
    end do
  end function polygon_faces
end module dosui_shapes

!! Geometry of regions: inside tests, measures and faces of boxes, polygons, circles, spheres and
!! triangulated bodies.
module dosui_shapes
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, axis
  use dosui_scene, only: name_length, region_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: region_bounds, shape_bounds, shape_contains, shape_faces, shape_measure, spatial, &
            turned, degrees

  real(wp), parameter :: degrees = acos(-1.0_wp)/180.0_wp   !! radians per degree

  type :: ends_t
    real(wp), allocatable :: at(:)   !! (0:n) fractions of an edge, from 0 to 1 [-]
  end type ends_t

  type, public :: face_t
    !! A planar face: corner + sum of fractions of its edges, with the outward unit normal; or the
    !! round face of a circle or sphere between two planes in each direction; or a list of pieces.
    character(len=name_length) :: name = ''   !! 'x-' ... 'z+', 'edge1' ..., 'round', 'face1' ...
    character(len=name_length) :: solid = ''        !! of a file that the face belongs to
    real(wp) :: corner(ndim) = 0.0_wp               !! [m]
    real(wp) :: edge(ndim, max(ndim - 1, 1)) = 0.0_wp   !! edges that span it, unused in 1-D [m]
    real(wp) :: normal(ndim) = 0.0_wp               !! outward, of a planar face [-]
    real(wp) :: centre(ndim) = 0.0_wp               !! of the circle or sphere [m]
    real(wp) :: radius = huge(1.0_wp)               !! a planar face ends there, too [m]
    real(wp) :: low(ndim) = -huge(1.0_wp)           !! cuts of a round face, about centre [m]
    real(wp) :: high(ndim) = huge(1.0_wp)           !! likewise [m]
    real(wp) :: angle = 0.0_wp                      !! of these planes [deg]
    type(ends_t) :: ends(2)
    !! of the pieces along the edges of a planar face, where these are not equal
    real(wp), allocatable :: piece_position(:, :)   !! (ndim, n) of triangulated faces [m]
    real(wp), allocatable :: piece_normal(:, :)     !! (ndim, n) outward [-]
    real(wp), allocatable :: piece_area(:)          !! (n) [m2]
    real(wp), allocatable :: piece_held(:, :)       !! (ndim, n) normals that walls hold [-]
    real(wp), allocatable :: piece_edge(:, :)       !! (ndim, 2) that span all pieces, if known [m]
  end type face_t

contains

  pure function turned(vector, angle) result(rotated)
    !! A vector turned by an angle in the x-z plane, from x towards z. 1-D: unchanged
    !! [unit of the vector].
    real(wp), intent(in) :: vector(ndim)   !! [any unit]
    real(wp), intent(in) :: angle   !! [deg]
    real(wp) :: rotated(ndim)

    rotated = vector
    if (ndim == 1 .or. abs(angle) <= 0.0_wp) return
    rotated(1) = cos(angle*degrees)*vector(1) - sin(angle*degrees)*vector(ndim)
    rotated(ndim) = sin(angle*degrees)*vector(1) + cos(angle*degrees)*vector(ndim)
  end function turned

  pure function spatial(position) result(place)
    !! x, y and z of a place, 0 where the dimension lacks them [m].
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp) :: place(3)

    place = 0.0_wp
    place(axis) = position
  end function spatial

  pure subroutine region_bounds(region, low, high)
    !! Bounds of a region where it lies [m].
    type(region_t), intent(in) :: region
    real(wp), intent(out) :: low(ndim), high(ndim)   !! [m]

    call shape_bounds(region, region%shape_angle, low, high)
    low = low + region%pivot
    high = high + region%pivot
  end subroutine region_bounds

  pure subroutine shape_bounds(region, angle, low, high)
    !! Bounds, relative to the pivot, of the shape as given turned by an angle about the pivot [m].
    !! With the shape's own angle: its place; less the lattice's angle: as its lattice sees it.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: angle   !! [deg]
    real(wp), intent(out) :: low(ndim), high(ndim)   !! [m]
    real(wp) :: corner(ndim), box_low(ndim), box_high(ndim)
    integer :: k, d, n_corner

    if (region%shape == 'stl') then
      call body_bounds(region, angle, low, high)
      return
    end if
    call bounding_box(region, box_low, box_high)
    n_corner = 2**ndim
    if (region%shape == 'polygon') n_corner = size(region%vertices, 2)
    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do k = 1, n_corner
      if (region%shape == 'polygon') then
        corner = region%vertices(:, k)
      else
        do d = 1, ndim
          corner(d) = merge(box_high(d), box_low(d), btest(k, d - 1))
        end do
      end if
      corner = turned(corner - region%pivot, angle)
      low = min(low, corner)
      high = max(high, corner)
    end do
    if (is_round(region)) then
      corner = turned(region%centre - region%pivot, angle)
      low = max(low, corner - region%radius)
      high = min(high, corner + region%radius)
    end if
  end subroutine shape_bounds

  pure subroutine body_bounds(region, angle, low, high)
    !! Bounds of a triangulated body, which has its own turn already [m].
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: angle   !! [deg]
    real(wp), intent(out) :: low(ndim), high(ndim)
    real(wp) :: corner(ndim)
    integer :: k

    low = region%body%low(axis) - region%pivot
    high = region%body%high(axis) - region%pivot
    if (abs(angle - region%shape_angle) <= 0.0_wp) return
    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do k = 1, region%body%n_vertex
      corner = turned(region%body%vertex(axis, k) - region%pivot, angle - region%shape_angle)
      low = min(low, corner)
      high = max(high, corner)
    end do
  end subroutine body_bounds

  pure logical function is_round(region)
    !! Circle or sphere?
    type(region_t), intent(in) :: region

    is_round = region%shape == 'circle' .or. region%shape == 'sphere'
  end function is_round

  pure subroutine bounding_box(region, low, high)
    !! The box, or the one around a circle or sphere and within its cuts, before turning [m].
    type(region_t), intent(in) :: region
    real(wp), intent(out) :: low(ndim), high(ndim)

    low = region%box_min
    high = region%box_max
    if (.not. is_round(region)) return
    low = max(region%cut_min, region%centre - region%radius)
    high = min(region%cut_max, region%centre + region%radius)
  end subroutine bounding_box

  pure logical function shape_contains(region, position, margin) result(inside)
    !! Is a position inside the shape, at least `margin` away from its faces?
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp), intent(in) :: margin           !! may be negative [m]
    real(wp) :: local(ndim)
    integer :: k

    if (region%shape == 'stl') then
      inside = region%body%contains(spatial(position), margin)
      return
    end if
    local = region%pivot + turned(position - region%pivot, -region%shape_angle)
    if (region%shape == 'polygon') then
      inside = inside_polygon(region%vertices, local)
      if (abs(margin) > 0.0_wp) then
        if (distance_to_edges(region%vertices, local) < abs(margin)) inside = margin < 0.0_wp
      end if
    else if (is_round(region)) then
      inside = norm2(local - region%centre) <= region%radius - margin .and. &
               all(local >= region%cut_min + margin .and. local <= region%cut_max - margin)
    else
      inside = all(local >= region%box_min + margin .and. local <= region%box_max - margin)
    end if
    if (.not. inside .or. .not. allocated(region%hole)) return
    do k = 1, size(region%hole)
      associate (vertices => region%hole(k)%vertices)
        if (abs(margin) > 0.0_wp) then
          if (distance_to_edges(vertices, local) < abs(margin)) then
            inside = inside .and. margin < 0.0_wp
            cycle
          end if
        end if
        inside = inside .and. .not. inside_polygon(vertices, local)
      end associate
    end do
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
    !! Volume of the shape [m3, m2 in 2-D, m in 1-D].
    type(region_t), intent(in) :: region
    integer :: k

    if (region%shape == 'stl') then
      measure = region%body%volume
    else if (is_round(region)) then
      measure = round_measure(region)
    else if (region%shape == 'polygon') then
      measure = polygon_measure(region%vertices)
    else
      measure = product(region%box_max - region%box_min)
    end if
    if (.not. allocated(region%hole)) return
    do k = 1, size(region%hole)
      measure = measure - polygon_measure(region%hole(k)%vertices)
    end do
  end function shape_measure

  pure real(wp) function polygon_measure(vertices) result(measure)
    !! Area of a polygon [m2].
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n) [m]
    integer :: k, n, next

    measure = 0.0_wp
    n = size(vertices, 2)
    do k = 1, n
      next = modulo(k, n) + 1
      measure = measure + 0.5_wp*(vertices(1, k)*vertices(ndim, next) - &
                                  vertices(1, next)*vertices(ndim, k))
    end do
    measure = abs(measure)
  end function polygon_measure

  pure real(wp) function round_measure(region) result(measure)
    !! Of a circle or sphere within its cuts: exact in 2-D, and in 3-D when the cuts go through the
    !! centre, else by integration over its sections [m2, m3].
    type(region_t), intent(in) :: region
    integer, parameter :: panels = 256, nodes = 4, across = min(ndim, 2)   ! y in 3-D
    real(wp), parameter :: node(nodes) = [-0.8611363115940526_wp, -0.3399810435848563_wp, &
                                          0.3399810435848563_wp, 0.8611363115940526_wp]
    real(wp), parameter :: weight(nodes) = [0.3478548451374539_wp, 0.6521451548625461_wp, &
                                            0.6521451548625461_wp, 0.3478548451374539_wp]
    real(wp) :: low(ndim), high(ndim), half, y, radius
    integer :: k, g

    call bounding_box(region, low, high)
    low = low - region%centre
    high = high - region%centre
    measure = 0.0_wp
    if (any(low >= high)) return
    if (ndim < 3) then
      measure = disc_measure(region%radius, low([1, ndim]), high([1, ndim]))
      return
    end if
    half = 0.5_wp*(high(across) - low(across))/panels
    do k = 1, panels
      do g = 1, nodes
        y = low(across) + half*(real(2*k - 1, wp) + node(g))
        radius = sqrt(max(region%radius**2 - y**2, 0.0_wp))
        measure = measure + half*weight(g)*disc_measure(radius, low([1, ndim]), high([1, ndim]))
      end do
    end do
  end function round_measure

  pure real(wp) function disc_measure(radius, low, high) result(area)
    !! Exact area of a disc about the origin within a rectangle [m2].
    real(wp), intent(in) :: radius             !! [m]
    real(wp), intent(in) :: low(2), high(2)    !! [m]
    real(wp) :: bound(6), from, to, middle, top, bottom
    integer :: k

    area = 0.0_wp
    if (.not. radius > 0.0_wp) return
    ! between these abscissae the upper and the lower end are each an arc or a side
    bound = [low(1), -abscissa(high(2)), -abscissa(low(2)), abscissa(high(2)), abscissa(low(2)), &
             high(1)]
    bound = min(max(bound, max(low(1), -radius)), min(high(1), radius))
    if (bound(6) <= bound(1)) return
    bound(2:5) = ascending(bound(2:5))
    do k = 1, 5
      from = bound(k)
      to = bound(k + 1)
      if (.not. to > from) cycle
      middle = sqrt(max(radius**2 - (0.5_wp*(from + to))**2, 0.0_wp))
      if (min(high(2), middle) <= max(low(2), -middle)) cycle
      top = high(2)*(to - from)
      if (middle < high(2)) top = arc(to) - arc(from)
      bottom = low(2)*(to - from)
      if (-middle > low(2)) bottom = arc(from) - arc(to)
      area = area + top - bottom
    end do

  contains

    pure real(wp) function abscissa(height)
      !! Where the disc is `height` high.
      real(wp), intent(in) :: height

      abscissa = sqrt(max(radius**2 - min(abs(height), radius)**2, 0.0_wp))
    end function abscissa

    pure real(wp) function arc(x)
      !! Integral of sqrt(radius^2 - x^2) from 0.
      real(wp), intent(in) :: x
      real(wp) :: ratio

      ratio = min(max(x/radius, -1.0_wp), 1.0_wp)
      arc = 0.5_wp*radius**2*(ratio*sqrt(1.0_wp - ratio**2) + asin(ratio))
    end function arc
  end function disc_measure

  pure function ascending(values) result(sorted)
    !! A few values in order.
    real(wp), intent(in) :: values(:)
    real(wp) :: sorted(size(values))
    integer :: k, m

    sorted = values
    do k = 2, size(sorted)
      do m = k, 2, -1
        if (sorted(m) < sorted(m - 1)) sorted([m - 1, m]) = sorted([m, m - 1])
      end do
    end do
  end function ascending

  pure function shape_faces(region) result(faces)
    !! All faces of a region, turned with it; those of triangulated bodies need a spacing
    !! (`region_faces` in `dosui_face_pieces`).
    type(region_t), intent(in) :: region
    type(face_t), allocatable :: faces(:), edges(:)
    integer :: k

    if (region%shape == 'polygon') then
      faces = polygon_faces(region%vertices)
      do k = 1, size(faces)
        faces(k)%name = 'edge'//to_text(k)
      end do
    else if (is_round(region)) then
      faces = round_faces(region)
    else
      faces = box_faces(region%box_min, region%box_max)
    end if
    if (allocated(region%hole)) then
      do k = 1, size(region%hole)
        edges = polygon_faces(region%hole(k)%vertices)
        edges%name = 'hole'//to_text(k)
        faces = [faces, edges]
      end do
    end if
    do k = 1, size(faces)
      faces(k)%angle = region%shape_angle
      faces(k)%centre = region%pivot + turned(faces(k)%centre - region%pivot, region%shape_angle)
      faces(k)%corner = region%pivot + turned(faces(k)%corner - region%pivot, region%shape_angle)
      faces(k)%normal = turned(faces(k)%normal, region%shape_angle)
      faces(k)%edge(:, 1) = turned(faces(k)%edge(:, 1), region%shape_angle)
      if (ndim == 3) faces(k)%edge(:, size(faces(k)%edge, 2)) = &
        turned(faces(k)%edge(:, size(faces(k)%edge, 2)), region%shape_angle)
    end do
  end function shape_faces

  pure function round_faces(region) result(faces)
    !! The round face of an unturned circle or sphere, and its cuts, called like a box's faces.
    type(region_t), intent(in) :: region
    type(face_t), allocatable :: faces(:)
    logical :: is_cut(2*ndim)
    real(wp) :: low(ndim), high(ndim), half, distance
    integer :: d, k, side

    call bounding_box(region, low, high)
    faces = box_faces(low, high)
    do d = 1, ndim
      is_cut(2*d - 1) = region%cut_min(d) > region%centre(d) - region%radius
      is_cut(2*d) = region%cut_max(d) < region%centre(d) + region%radius
      do side = 0, 1
        if (ndim /= 2 .or. .not. is_cut(2*d - 1 + side)) cycle
        ! a chord ends on the circle
        k = 3 - d
        distance = merge(high(d), low(d), side == 1) - region%centre(d)
        half = sqrt(max(region%radius**2 - distance**2, 0.0_wp))
        associate (face => faces(2*d - 1 + side))
          face%corner(k) = max(low(k), region%centre(k) - half)
          face%edge(k, 1) = min(high(k), region%centre(k) + half) - face%corner(k)
        end associate
      end do
    end do
    faces = pack(faces, is_cut)
    do k = 1, size(faces)
      faces(k)%centre = region%centre
      faces(k)%radius = region%radius
    end do
    faces = [faces, face_t(name='round', centre=region%centre, radius=region%radius, &
                           low=region%cut_min - region%centre, &
                           high=region%cut_max - region%centre)]
  end function round_faces

  pure function box_faces(box_min, box_max) result(faces)
    !! The faces x-, x+, (y-, y+,) z-, z+ of an unturned box.
    real(wp), intent(in) :: box_min(ndim), box_max(ndim)   !! [m]
    type(face_t), allocatable :: faces(:)
    character(len=1), parameter :: names(3) = ['x', 'y', 'z']
    real(wp) :: extent(ndim)
    integer :: d, side, k, other, e

    allocate (faces(2*ndim))
    extent = box_max - box_min
    k = 0
    do d = 1, ndim
      do side = -1, 1, 2
        k = k + 1
        faces(k)%name = names(merge(3, d, d == ndim))//merge('-', '+', side < 0)
        faces(k)%normal(d) = real(side, wp)
        faces(k)%corner = box_min
        if (side > 0) faces(k)%corner(d) = box_max(d)
        e = 0
        do other = 1, ndim
          if (other == d) cycle
          e = e + 1
          faces(k)%edge(other, e) = extent(other)
        end do
      end do
    end do
  end function box_faces

  pure function polygon_faces(vertices) result(faces)
    !! One nameless face an edge of an unturned counter-clockwise polygon (2-D); the corners of
    !! holes are clockwise, so that their normals point into them.
    real(wp), intent(in) :: vertices(:, :)   !! (ndim, n) [m]
    type(face_t), allocatable :: faces(:)
    integer :: k, n

    n = size(vertices, 2)
    allocate (faces(n))
    do k = 1, n
      faces(k)%corner = vertices(:, k)
      faces(k)%edge(:, 1) = vertices(:, modulo(k, n) + 1) - vertices(:, k)
      faces(k)%normal(1) = faces(k)%edge(ndim, 1)
      faces(k)%normal(ndim) = -faces(k)%edge(1, 1)
      faces(k)%normal = faces(k)%normal/norm2(faces(k)%normal)
    end do
  end function polygon_faces
end module dosui_shapes

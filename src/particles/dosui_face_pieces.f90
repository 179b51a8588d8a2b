!! Pieces of about equal area that faces of regions are divided into.
!!
!! A planar face is divided along its edges, a circle in equal angles, a sphere in rings of equal
!! width about z and these in equal angles. Numbers of angles are multiples of 4, of rings of 2, so
!! that halves, quarters and eighths consist of whole pieces; others are cut to their inner part.
!! Where the box of a surface ends on a planar face, pieces end, too.
module dosui_face_pieces
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, axis
  use dosui_scene, only: region_t
  use dosui_shapes, only: face_t, shape_faces, turned
  use dosui_smooth_normals, only: mean_edge, smooth_normals
  use dosui_text, only: to_text
  use dosui_triangle_pieces, only: divide_face
  implicit none
  private

  public :: region_faces, end_pieces, piece_count, face_piece, is_faceted

  real(wp), parameter :: coarsest_facet = 4.0_wp
  !! in spacings: facets above this are resolved and held one by one [-]
  real(wp), parameter :: bend = 1.0e-6_wp        !! of mean normals of planes [-]
  integer, parameter :: samples = 16             !! of a piece that may be cut, per direction
  real(wp), parameter :: same_place = 1.0e-6_wp  !! of ends of pieces [pieces]
  real(wp), parameter :: pi = acos(-1.0_wp)

contains

  subroutine region_faces(region, spacing, faces)
    !! All faces of a region; those of a triangulated body with their pieces.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: spacing   !! wanted length of a piece [m]
    type(face_t), allocatable, intent(out) :: faces(:)
    real(wp), allocatable :: position(:, :), normal(:, :), area(:), held(:, :), edge(:, :)
    integer :: f

    if (region%shape /= 'stl') then
      faces = shape_faces(region)
      return
    end if
    allocate (faces(region%body%n_face))
    do f = 1, size(faces)
      faces(f)%name = 'face'//to_text(f)
      faces(f)%solid = region%solid(region%body%solid(findloc(region%body%face, f, dim=1)))
      call divide_face(region%body, f, spacing, position, normal, area, edge)
      if (allocated(edge)) faces(f)%piece_edge = edge(axis, :)
      faces(f)%piece_position = position(axis, :)
      faces(f)%piece_normal = normal(axis, :)
      faces(f)%piece_area = area
      held = normal
      if (mean_edge(region%body, f) <= coarsest_facet*spacing) then
        call smooth_normals(region%body, f, position, normal, held)
      end if
      faces(f)%piece_held = held(axis, :)
    end do
  end subroutine region_faces

  subroutine end_pieces(face, spacing, longest, low, high)
    !! Lets pieces of a planar face end where boxes do, if the planes of these cross one of its
    !! edges only: a load then acts on all of its surface and on nothing else. Pieces longer than a
    !! cell, which would leave out cells, are divided.
    type(face_t), intent(inout) :: face
    real(wp), intent(in) :: spacing                    !! wanted length of a piece [m]
    real(wp), intent(in) :: longest                    !! of a piece: a cell [m]
    real(wp), intent(in) :: low(:, :), high(:, :)      !! (ndim, boxes) [m]
    real(wp) :: fraction(2*ndim*size(low, 2)), piece, length
    integer :: n, e, b, d, n_even
    logical :: is_long

    if (ndim == 1 .or. face%name == 'round' .or. face%radius < huge(1.0_wp)) return
    if (allocated(face%piece_area)) return
    do e = 1, size(face%edge, 2)
      n = 0
      length = norm2(face%edge(:, e))
      n_even = max(1, nint(length/spacing))
      is_long = length > real(n_even, wp)*longest*(1.0_wp + same_place)
      if (is_long) n_even = ceiling(length/longest*(1.0_wp - same_place))
      piece = length/real(n_even, wp)
      do b = 1, size(low, 2)
        do d = 1, ndim
          if (abs(face%edge(d, e)) < same_place*piece .or. &
              any(abs(face%edge(d, :e - 1)) > same_place*piece) .or. &
              any(abs(face%edge(d, e + 1:)) > same_place*piece)) cycle
          call add_end(low(d, b))
          call add_end(high(d, b))
        end do
      end do
      if (n > 0 .or. is_long) call divide_between(fraction(:n), real(n_even, wp), face%ends(e)%at)
    end do

  contains

    subroutine add_end(plane)
      !! One plane, unless equal pieces end there or pieces do already.
      real(wp), intent(in) :: plane   !! [m]
      real(wp) :: here

      if (.not. abs(plane) < huge(1.0_wp)) return
      here = (plane - face%corner(d))/face%edge(d, e)
      if (here*n_even < same_place .or. (1.0_wp - here)*n_even < same_place) return
      if (abs(here*n_even - anint(here*n_even)) < same_place) return
      if (any(abs(fraction(:n) - here)*n_even < same_place)) return
      n = n + 1
      fraction(n) = here
    end subroutine add_end
  end subroutine end_pieces

  pure subroutine divide_between(fraction, wanted, at)
    !! Ends of pieces along an edge: about equal ones between the fractions.
    real(wp), intent(in) :: fraction(:)   !! in any order [-]
    real(wp), intent(in) :: wanted        !! pieces in all [-]
    real(wp), allocatable, intent(out) :: at(:)   !! (0:n)
    real(wp) :: from, to
    integer :: k, j, n
    integer :: parts(size(fraction) + 1)
    real(wp) :: ends(0:size(fraction) + 1)

    ends(0) = 0.0_wp
    do k = 1, size(fraction)
      ends(k) = minval(fraction, mask=fraction > ends(k - 1))
    end do
    ends(size(fraction) + 1) = 1.0_wp
    do k = 1, size(parts)
      parts(k) = max(1, nint((ends(k) - ends(k - 1))*wanted))
    end do
    allocate (at(0:sum(parts)))
    at(0) = 0.0_wp
    n = 0
    do k = 1, size(parts)
      from = ends(k - 1)
      to = ends(k)
      do j = 1, parts(k)
        n = n + 1
        at(n) = from + (to - from)*real(j, wp)/real(parts(k), wp)
      end do
      at(n) = to
    end do
  end subroutine divide_between

  pure logical function is_faceted(region, name, spacing)
    !! Does a bent face, by its name, of a triangulated body have facets so large that the pieces
    !! keep their own normals?
    type(region_t), intent(in) :: region
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: spacing   !! of the pieces [m]
    real(wp) :: mean(3)
    integer, allocatable :: members(:)
    integer :: f, t

    is_faceted = .false.
    if (region%shape /= 'stl') return
    do f = 1, region%body%n_face
      members = pack([(t, t=1, region%body%n_triangle)], region%body%face == f)
      if (name /= 'face'//to_text(f) .and. name /= 'all' .and. &
          name /= region%solid(region%body%solid(members(1)))) cycle
      mean = matmul(region%body%normal(:, members), region%body%area(members))
      if (norm2(mean) > (1.0_wp - bend)*sum(region%body%area(members))) cycle
      is_faceted = is_faceted .or. mean_edge(region%body, f) > coarsest_facet*spacing
    end do
  end function is_faceted

  pure integer(i8) function piece_count(face, spacing) result(count)
    !! Number of pieces of a face, those outside its cuts included.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing   !! wanted length of a piece [m]
    integer :: ring, n_ring

    if (allocated(face%piece_area)) then
      count = size(face%piece_area, kind=i8)
    else if (face%name /= 'round') then
      count = product(int(divisions(face, spacing), i8))
    else
      n_ring = rings(face, spacing)
      count = 0_i8
      do ring = 1, n_ring
        count = count + angles(face, spacing, ring, n_ring)
      end do
    end if
  end function piece_count

  pure subroutine face_piece(face, spacing, number, position, normal, area, edge)
    !! Middle, outward normal and area of one piece; area 0 if it lies outside the face's cuts.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing                  !! as in `piece_count` [m]
    integer(i8), intent(in) :: number                !! from 1
    real(wp), intent(out) :: position(ndim)          !! [m]
    real(wp), intent(out) :: normal(ndim)            !! [-]
    real(wp), intent(out) :: area                    !! [m2, m in 2-D, 1 in 1-D]
    real(wp), intent(out), optional :: edge(ndim, max(ndim - 1, 1))
    !! that span it about its middle; 0: they are not known [m]
    real(wp) :: first(2), last(2), share(2), x(ndim), inner(ndim)
    integer :: e, u, v, n_inside, n_sample(2)

    if (present(edge)) edge = 0.0_wp
    if (allocated(face%piece_area)) then
      position = face%piece_position(:, number)
      normal = face%piece_normal(:, number)
      area = face%piece_area(number)
      if (.not. (present(edge) .and. allocated(face%piece_edge))) return
      edge = face%piece_edge(:, :size(edge, 2))
      return
    end if
    call piece_parameters(face, spacing, number, first, last, area)
    normal = face%normal
    position = face_point(face, 0.5_wp*(first + last))
    if (.not. face%radius < huge(1.0_wp)) then
      if (.not. present(edge)) return
      do e = 1, size(edge, 2)
        edge(:, e) = (last(e) - first(e))*face%edge(:, e)
      end do
      return
    end if
    n_sample = merge(samples, 1, [1, 2] < ndim)
    n_inside = 0
    inner = 0.0_wp
    do v = 1, n_sample(2)
      do u = 1, n_sample(1)
        share = (real([u, v], wp) - 0.5_wp)/real(n_sample, wp)
        x = face_point(face, first + share*(last - first))
        if (.not. within_cuts(face, x)) cycle
        n_inside = n_inside + 1
        inner = inner + x
      end do
    end do
    area = area*real(n_inside, wp)/real(product(n_sample), wp)
    if (n_inside == 0) return
    if (face%name /= 'round') then
      if (n_inside < product(n_sample)) position = inner/real(n_inside, wp)
    else
      normal = inner/real(n_inside, wp) - face%centre
      normal = normal/norm2(normal)
      position = face%centre + face%radius*normal
    end if
  end subroutine face_piece

  pure function divisions(face, spacing) result(n)
    !! Pieces of a planar face along each of its edges.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing
    integer :: n(max(ndim - 1, 1)), e

    n = 1
    do e = 1, size(n)   ! in 1-D the only edge has no length
      n(e) = max(1, nint(norm2(face%edge(:, e))/spacing))
      if (allocated(face%ends(e)%at)) n(e) = ubound(face%ends(e)%at, 1)
    end do
  end function divisions

  pure integer function rings(face, spacing) result(n)
    !! Of a sphere; a circle is one ring.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing

    n = 1
    if (ndim == 3) n = 2*max(1, nint(0.5_wp*pi*face%radius/spacing))
  end function rings

  pure integer function angles(face, spacing, ring, n_ring) result(n)
    !! Pieces of one ring.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing
    integer, intent(in) :: ring, n_ring
    real(wp) :: length

    length = 2.0_wp*pi*face%radius
    if (ndim == 3) length = length*sin(pi*(real(ring, wp) - 0.5_wp)/real(n_ring, wp))
    n = 4*max(1, nint(0.25_wp*length/spacing))
  end function angles

  pure subroutine piece_parameters(face, spacing, number, first, last, area)
    !! A piece as a rectangle of the face's parameters, and its whole area.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing
    integer(i8), intent(in) :: number
    real(wp), intent(out) :: first(2), last(2)   !! see `face_point`
    real(wp), intent(out) :: area                !! [m2]
    integer(i8) :: rest
    integer :: n(max(ndim - 1, 1)), e, k, ring, n_ring, n_angle

    first = 0.0_wp
    last = 1.0_wp
    rest = number - 1_i8
    if (face%name /= 'round') then
      n = divisions(face, spacing)
      area = 1.0_wp
      do e = 1, size(n)
        if (allocated(face%ends(e)%at)) then
          k = int(mod(rest, int(n(e), i8)))
          first(e) = face%ends(e)%at(k)
          last(e) = face%ends(e)%at(k + 1)
          area = area*norm2(face%edge(:, e))*(last(e) - first(e))
        else
          first(e) = real(mod(rest, int(n(e), i8)), wp)/real(n(e), wp)
          last(e) = (real(mod(rest, int(n(e), i8)), wp) + 1.0_wp)/real(n(e), wp)
          if (ndim > 1) area = area*norm2(face%edge(:, e))/real(n(e), wp)
        end if
        rest = rest/n(e)
      end do
      return
    end if
    n_ring = rings(face, spacing)
    ring = 1
    n_angle = angles(face, spacing, ring, n_ring)
    do while (rest >= n_angle .and. ring < n_ring)
      rest = rest - n_angle
      ring = ring + 1
      n_angle = angles(face, spacing, ring, n_ring)
    end do
    first(1) = 2.0_wp*pi*real(rest, wp)/real(n_angle, wp)
    last(1) = 2.0_wp*pi*real(rest + 1, wp)/real(n_angle, wp)
    area = face%radius*(last(1) - first(1))
    if (ndim < 3) return
    first(2) = cos(pi*real(ring, wp)/real(n_ring, wp))
    last(2) = cos(pi*real(ring - 1, wp)/real(n_ring, wp))
    area = area*face%radius*(last(2) - first(2))
  end subroutine piece_parameters

  pure function face_point(face, parameter) result(position)
    !! A place on a face: fractions of its edges; angle about y or z, and cosine of the angle to z,
    !! both uniform in area [m].
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: parameter(2)
    real(wp) :: position(ndim), level
    integer, parameter :: across = min(ndim, 2)   ! y in 3-D
    integer :: e

    if (face%name /= 'round') then
      position = face%corner
      do e = 1, size(face%edge, 2)
        position = position + face%edge(:, e)*parameter(e)
      end do
    else
      position = face%centre
      level = sin(parameter(1))
      if (ndim == 3) then
        level = parameter(2)
        position(across) = position(across) + &
                           face%radius*sqrt(1.0_wp - level**2)*sin(parameter(1))
        position(1) = position(1) + face%radius*sqrt(1.0_wp - level**2)*cos(parameter(1))
      else
        position(1) = position(1) + face%radius*cos(parameter(1))
      end if
      position(ndim) = position(ndim) + face%radius*level
    end if
  end function face_point

  pure logical function within_cuts(face, position)
    !! Is a place of a planar face within its circle, one of a round face between its planes?
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: position(ndim)
    real(wp) :: local(ndim)

    if (face%name /= 'round') then
      within_cuts = norm2(position - face%centre) <= face%radius
    else
      local = turned(position - face%centre, -face%angle)
      within_cuts = all(local >= face%low .and. local <= face%high)
    end if
  end function within_cuts
end module dosui_face_pieces

!! Interior barriers that no water passes, such as sheet piles: particles do not see each other
!! through them. Each side has boundary points of its own, without flow.
!!
!! A barrier is a chain of straight segments in 2-D and a flat convex polygon in 3-D. What lies in
!! its plane counts as its positive side. It has no stiffness: the skeleton does not notice it.
module dosui_barriers
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_geometry, only: cross
  use dosui_scene, only: barrier_t
  implicit none
  private

  public :: barrier_faces, cut_neighbours, cut_points

  real(wp), parameter :: tolerance = 1.0e-9_wp   ! of places along a face [-]

  type, public :: barrier_face_t
    !! A flat piece of a barrier.
    real(wp), allocatable :: vertex(:, :)   !! (ndim, 2) ends or (ndim, n) corners in order [m]
    real(wp) :: normal(ndim) = 0.0_wp       !! of the positive side [-]
    real(wp) :: along(ndim, 2) = 0.0_wp     !! unit vectors in the face, 2-D: the first one [-]
    real(wp) :: low(2) = 0.0_wp             !! lowest corner along them, from the first vertex [m]
    real(wp) :: piece(2) = 1.0_wp           !! sides of the pieces of boundary points [m]
    integer :: n_piece(2) = 1               !! of them in each direction
  contains
    procedure :: side => face_side
    procedure :: is_crossed => face_is_crossed
    procedure :: contains => face_contains
    procedure :: centre => face_centre
    procedure :: faces_piece => face_faces_piece
  end type barrier_face_t

contains

  pure function barrier_faces(barriers, spacing) result(faces)
    !! The flat pieces of all barriers, divided into boundary points about a spacing apart.
    type(barrier_t), intent(in) :: barriers(:)
    real(wp), intent(in) :: spacing                     !! [m]
    type(barrier_face_t), allocatable :: faces(:)
    integer :: b, k, n

    n = 0
    do b = 1, size(barriers)
      n = n + merge(size(barriers(b)%vertices, 2) - 1, 1, ndim == 2)
    end do
    allocate (faces(n))
    n = 0
    do b = 1, size(barriers)
      if (ndim == 2) then
        do k = 1, size(barriers(b)%vertices, 2) - 1
          n = n + 1
          faces(n) = face_of(barriers(b)%vertices(:, k:k + 1), spacing)
        end do
      else
        n = n + 1
        faces(n) = face_of(barriers(b)%vertices, spacing)
      end if
    end do
  end function barrier_faces

  pure function face_of(vertices, spacing) result(face)
    !! A flat face with its directions and pieces.
    real(wp), intent(in) :: vertices(:, :)   !! [m]
    real(wp), intent(in) :: spacing          !! [m]
    type(barrier_face_t) :: face
    real(wp) :: normal(3), first(3), place, high(2)
    integer :: d, k

    face%vertex = vertices
    face%along(:, 1) = (vertices(:, 2) - vertices(:, 1))/norm2(vertices(:, 2) - vertices(:, 1))
    if (ndim == 2) then
      face%normal(ndim) = face%along(1, 1)
      face%normal(1) = -face%along(ndim, 1)
    else
      first = [face%along(:, 1), spread(0.0_wp, 1, 3 - ndim)]
      normal = cross(first, [vertices(:, 3) - vertices(:, 2), spread(0.0_wp, 1, 3 - ndim)])
      normal = normal/norm2(normal)
      face%normal = normal(:ndim)
      normal = cross(normal, first)
      face%along(:, 2) = normal(:ndim)
    end if
    face%low = 0.0_wp
    high = 0.0_wp
    do k = 2, size(vertices, 2)
      do d = 1, 2
        if (d >= ndim) exit
        place = dot_product(vertices(:, k) - vertices(:, 1), face%along(:, d))
        face%low(d) = min(face%low(d), place)
        high(d) = max(high(d), place)
      end do
    end do
    do d = 1, 2
      if (d >= ndim) exit
      face%n_piece(d) = max(1, nint((high(d) - face%low(d))/spacing))
      face%piece(d) = (high(d) - face%low(d))/real(face%n_piece(d), wp)
    end do
  end function face_of

  pure integer function face_side(self, position) result(side)
    !! 1 or -1: on which side of the face's plane a position lies.
    class(barrier_face_t), intent(in) :: self
    real(wp), intent(in) :: position(ndim)   !! [m]

    side = merge(1, -1, dot_product(position - self%vertex(:, 1), self%normal) >= 0.0_wp)
  end function face_side

  pure logical function face_is_crossed(self, from, to) result(crossed)
    !! Does a straight line between two positions pass the face?
    class(barrier_face_t), intent(in) :: self
    real(wp), intent(in) :: from(ndim), to(ndim)   !! [m]
    real(wp) :: before, after

    crossed = .false.
    if (self%side(from) == self%side(to)) return
    before = dot_product(from - self%vertex(:, 1), self%normal)
    after = dot_product(to - self%vertex(:, 1), self%normal)
    crossed = self%contains(from + (to - from)*before/(before - after))
  end function face_is_crossed

  pure logical function face_contains(self, position) result(inside)
    !! Does the projection of a position on the face's plane lie in the face?
    class(barrier_face_t), intent(in) :: self
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp) :: length, place, edge(3), way(3), turn(3)
    integer :: k, n

    n = size(self%vertex, 2)
    if (ndim == 2) then
      length = norm2(self%vertex(:, 2) - self%vertex(:, 1))
      place = dot_product(position - self%vertex(:, 1), self%along(:, 1))
      inside = place >= -tolerance*length .and. place <= (1.0_wp + tolerance)*length
      return
    end if
    inside = .true.
    do k = 1, n
      edge = [self%vertex(:, modulo(k, n) + 1) - self%vertex(:, k), spread(0.0_wp, 1, 3 - ndim)]
      way = [position - self%vertex(:, k), spread(0.0_wp, 1, 3 - ndim)]
      turn = cross(edge, way)
      inside = inside .and. dot_product(turn(:ndim), self%normal) >= -tolerance*sum(edge**2)
    end do
  end function face_contains

  pure function face_centre(self, piece) result(position)
    !! Centre of a piece of the face; pieces are numbered from 1 [m].
    class(barrier_face_t), intent(in) :: self
    integer, intent(in) :: piece
    real(wp) :: position(ndim)
    integer :: index(2), d

    index = [mod(piece - 1, self%n_piece(1)), (piece - 1)/self%n_piece(1)]
    position = self%vertex(:, 1)
    do d = 1, 2
      if (d >= ndim) exit
      position = position + (self%low(d) + (real(index(d), wp) + 0.5_wp)*self%piece(d))* &
                 self%along(:, d)
    end do
  end function face_centre

  pure logical function face_faces_piece(self, position, centre) result(faces)
    !! Is the foot of a position on the face's plane in the piece with this centre?
    class(barrier_face_t), intent(in) :: self
    real(wp), intent(in) :: position(ndim), centre(ndim)   !! [m]
    integer :: d

    faces = .true.
    do d = 1, 2
      if (d >= ndim) exit
      faces = faces .and. abs(dot_product(position - centre, self%along(:, d))) <= &
        (0.5_wp + tolerance)*self%piece(d)
    end do
  end function face_faces_piece

  subroutine cut_neighbours(faces, row_position, position, row_start, neighbour)
    !! Takes neighbours behind barriers out of lists.
    type(barrier_face_t), intent(in) :: faces(:)
    real(wp), intent(in) :: row_position(:, :)            !! [m]
    real(wp), intent(in) :: position(:, :)                !! [m]
    integer, intent(inout) :: row_start(:)
    integer, allocatable, intent(inout) :: neighbour(:)

    call cut_points(faces, spread(0, 1, size(position, 2)), row_position, position, position, &
                    row_start, neighbour)
  end subroutine cut_neighbours

  subroutine cut_points(faces, face_of_point, row_position, position, normal, row_start, neighbour)
    !! Takes boundary points behind barriers out of lists, and of barriers' own points those of
    !! the other side and those whose piece does not hold the particle's foot.
    type(barrier_face_t), intent(in) :: faces(:)
    integer, intent(in) :: face_of_point(:)               !! 0: an outer surface's
    real(wp), intent(in) :: row_position(:, :)            !! of particles [m]
    real(wp), intent(in) :: position(:, :)                !! of boundary points [m]
    real(wp), intent(in) :: normal(:, :)                  !! of barriers' own points [-]
    integer, intent(inout) :: row_start(:)
    integer, allocatable, intent(inout) :: neighbour(:)
    integer :: i, k, f, n, first, own
    logical :: is_seen

    n = 0
    do i = 1, size(row_start) - 1
      first = row_start(i)
      row_start(i) = n + 1
      do k = first, row_start(i + 1) - 1
        associate (x => row_position(:, i), b => neighbour(k))
          own = face_of_point(b)
          is_seen = .true.
          if (own > 0) then   ! outward from the particle's side
            is_seen = dot_product(normal(:, b), faces(own)%normal)* &
                      real(faces(own)%side(x), wp) < 0.0_wp .and. &
                      faces(own)%faces_piece(x, position(:, b))
          end if
          do f = 1, size(faces)
            if (.not. is_seen) exit
            if (f /= own) is_seen = .not. faces(f)%is_crossed(x, position(:, b))
          end do
        end associate
        if (.not. is_seen) cycle
        n = n + 1
        neighbour(n) = neighbour(k)
      end do
    end do
    row_start(size(row_start)) = n + 1
    neighbour = neighbour(:n)
  end subroutine cut_points
end module dosui_barriers

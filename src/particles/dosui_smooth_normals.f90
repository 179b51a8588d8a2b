!! Normals of the smooth surface that a face of triangles stands for.
!!
!! Facets of a curved face lean: on a cylinder by about their length over 8 radii, up here, down
!! there. A wall that holds facet by facet so holds all directions. Vertices lie on the true
!! surface: a weighted quadratic fit of those around a piece gives its normal, exact on planes and
!! of third order elsewhere.
module dosui_smooth_normals
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, axis
  use dosui_least_squares, only: eliminate
  use dosui_neighbours, only: build_neighbours
  use dosui_triangles, only: triangles_t
  implicit none
  private

  public :: smooth_normals, mean_edge

  real(wp), parameter :: reach = 2.5_wp        !! of a fit, in mean edges of triangles [-]
  real(wp), parameter :: flat = 1.0e-9_wp      !! heights of planes, in reaches [-]
  real(wp), parameter :: least_cosine = 0.8_wp !! between facets and fit: else there is no fit [-]
  integer, parameter :: n_fit = 6              !! unknowns

contains

  subroutine smooth_normals(body, face, position, normal, smooth)
    !! Outward normals at pieces of a face; where vertices are too few, the piece's own.
    type(triangles_t), intent(in) :: body
    integer, intent(in) :: face
    real(wp), intent(in) :: position(:, :), normal(:, :)    !! (3, n) of the pieces [m], [-]
    real(wp), allocatable, intent(out) :: smooth(:, :)      !! (3, n) [-]
    integer, allocatable :: vertices(:), start(:), near(:)
    logical :: is_used(body%n_vertex)
    real(wp) :: radius
    integer :: t, k

    is_used = .false.
    do t = 1, body%n_triangle
      if (body%face(t) == face) is_used(body%corner(:, t)) = .true.
    end do
    vertices = pack([(k, k=1, body%n_vertex)], is_used)
    radius = reach*mean_edge(body, face)
    call build_neighbours(size(normal, 2), position(axis, :), size(vertices), &
                          body%vertex(axis, vertices), radius, start, near, skip_self=.false.)
    smooth = normal
    do k = 1, size(normal, 2)
      associate (around => vertices(near(start(k):start(k + 1) - 1)))
        call fit_normal(position(:, k), radius, body%vertex(:, around), smooth(:, k))
      end associate
    end do
  end subroutine smooth_normals

  pure real(wp) function mean_edge(body, face) result(edge)
    !! Mean length of the edges of a face's triangles [m].
    type(triangles_t), intent(in) :: body
    integer, intent(in) :: face
    real(wp) :: x(3, 3)
    integer :: t, k, n

    edge = 0.0_wp
    n = 0
    do t = 1, body%n_triangle
      if (body%face(t) /= face) cycle
      x = body%points(t)
      do k = 1, 3
        edge = edge + norm2(x(:, modulo(k, 3) + 1) - x(:, k))
      end do
      n = n + 3
    end do
    edge = edge/real(max(1, n), wp)
  end function mean_edge

  pure subroutine fit_normal(place, radius, vertex, normal)
    !! Turns a normal to that of the quadratic surface through vertices around a place.
    real(wp), intent(in) :: place(3), radius   !! [m]
    real(wp), intent(in) :: vertex(:, :)       !! (3, n) [m]
    real(wp), intent(inout) :: normal(3)
    real(wp) :: along(3, 2), way(3), u, v, basis(n_fit), matrix(n_fit, n_fit), right(n_fit)
    real(wp) :: weight, height, highest, fitted(3)
    integer :: k, i
    logical :: regular

    along = tangents(normal)
    matrix = 0.0_wp
    right = 0.0_wp
    highest = 0.0_wp
    do k = 1, size(vertex, 2)
      way = (vertex(:, k) - place)/radius
      height = dot_product(way, normal)
      highest = max(highest, abs(height))
      u = dot_product(way, along(:, 1))
      v = dot_product(way, along(:, 2))
      basis = [1.0_wp, u, v, u*u, u*v, v*v]
      weight = max(0.0_wp, 1.0_wp - norm2(way))**2
      do i = 1, n_fit
        matrix(:, i) = matrix(:, i) + weight*basis*basis(i)
      end do
      right = right + weight*basis*height
    end do
    if (.not. highest > flat) return
    call eliminate(matrix, right, regular)
    if (.not. regular) return
    fitted = normal - right(2)*along(:, 1) - right(3)*along(:, 2)
    fitted = fitted/norm2(fitted)
    if (dot_product(fitted, normal) > least_cosine) normal = fitted
  end subroutine fit_normal

  pure function tangents(normal) result(along)
    !! Two unit vectors square to a normal and to each other.
    real(wp), intent(in) :: normal(3)
    real(wp) :: along(3, 2)
    integer :: k

    along = 0.0_wp
    k = minloc(abs(normal), dim=1)
    along(k, 1) = 1.0_wp
    along(:, 1) = along(:, 1) - normal(k)*normal
    along(:, 1) = along(:, 1)/norm2(along(:, 1))
    along(:, 2) = [normal(2)*along(3, 1) - normal(3)*along(2, 1), &
                   normal(3)*along(1, 1) - normal(1)*along(3, 1), &
                   normal(1)*along(2, 1) - normal(2)*along(1, 1)]
  end function tangents
end module dosui_smooth_normals

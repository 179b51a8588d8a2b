!! Where the surface of a cloud of particles is.
!!
!! A particle bounds the body where an empty ball touches it, that is where its ball of radius r is
!! not covered by the balls of its neighbours ([Dilts2000] in the plane, [HaqueDilts2007] in
!! space), or, in other words, where its Voronoi cell reaches farther than r. Directions are
!! sampled, and each counts by how much farther, so that normals are smooth functions of the places.
!! What is exposed within 90 degrees of a mean direction is one facet, what is left another one: a
!! sheet of single particles has two sides. A facet lies half a particle's edge out; its area is
!! the section of the Voronoi cell. A rigid wall covers what points to it, and is itself
!! a facet of the particles beside it. Bodies that meet on the grid keep a gap of about 1.3 cells;
!! across such a gap facets are no longer free.
module dosui_free_surface
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_scene, only: rigid_wall_t
  implicit none
  private

  public :: find_facets

  real(wp), parameter :: ball = 1.1_wp           !! r over the particle's edge [-]
  real(wp), parameter :: full = 1.3_wp           !! a Voronoi cell that reaches so far counts fully
  real(wp), parameter, public :: sight = 1.4_wp  !! beyond it is air: bodies touch at 2 x 1.3 edges
  real(wp), parameter :: open_share = 0.02_wp    !! of all directions, of a facet that is new [-]
  real(wp), parameter :: opposite = 0.85_wp      !! cosine of what lies across a gap [-]
  real(wp), parameter :: balanced = 0.1_wp       !! exposed directions that have no mean [-]
  real(wp), parameter :: at_wall = 0.8_wp        !! distance of particles that rest on a wall [-]
  integer, parameter :: n_direction = merge(2, merge(72, 200, ndim == 2), ndim == 1)
  integer, parameter :: n_around = merge(1, merge(2, 48, ndim == 2), ndim == 1)   !! in a plane
  integer, parameter :: max_near = 512           !! neighbours and walls of a particle

  type, public :: facets_t
    !! Pieces of the surface, at most two free ones a particle and one for each wall.
    integer :: n = 0
    integer, allocatable :: particle(:)    !! that they bound
    integer, allocatable :: wall(:)        !! rigid wall that they rest on, 0: none
    logical, allocatable :: is_free(:)     !! neither a wall nor a body that touches is beyond
    logical, allocatable :: is_open(:)     !! enough is exposed for a new piece of surface
    real(wp), allocatable :: place(:, :)   !! [m]
    real(wp), allocatable :: normal(:, :)  !! outward [-]
    real(wp), allocatable :: area(:)       !! [m2, m in 2-D, 1 in 1-D]
  contains
    procedure, private :: append => facets_append
  end type facets_t

contains

  subroutine find_facets(n, position, edge, row_start, neighbour, walls, facets)
    !! The facets of n particles.
    integer, intent(in) :: n
    real(wp), intent(in) :: position(:, :)       !! of particles and ghosts [m]
    real(wp), intent(in) :: edge(n)              !! of the particles: volume**(1/ndim) [m]
    integer, intent(in) :: row_start(n + 1)      !! particles nearer than 2 sight edge, or more
    integer, intent(in) :: neighbour(:)
    type(rigid_wall_t), intent(in) :: walls(:)
    type(facets_t), intent(out) :: facets
    real(wp) :: bound(ndim, max_near), direction(ndim, n_direction), offset(ndim)
    real(wp) :: distance(size(walls)), wall_normal(ndim, size(walls))
    integer :: i, k, n_bound

    allocate (facets%particle(0), facets%wall(0), facets%is_open(0), facets%is_free(0), &
              facets%place(ndim, 0), facets%normal(ndim, 0), facets%area(0))
    direction = sample_directions()
    do k = 1, size(walls)
      wall_normal(:, k) = walls(k)%normal/norm2(walls(k)%normal)
    end do
    do i = 1, n
      n_bound = 0
      do k = row_start(i), row_start(i + 1) - 1
        offset = (position(:, neighbour(k)) - position(:, i))/edge(i)
        if (.not. sum(offset**2) < (2.0_wp*sight)**2 .or. n_bound == max_near) cycle
        n_bound = n_bound + 1
        bound(:, n_bound) = 2.0_wp*offset/max(sum(offset**2), tiny(1.0_wp)*1.0e9_wp)
      end do
      do k = 1, size(walls)
        distance(k) = dot_product(position(:, i) - walls(k)%position, wall_normal(:, k))/edge(i)
        if (distance(k) < at_wall) call add_wall_facet(k)
      end do
      do k = 1, size(walls)
        if (distance(k) > sight .or. n_bound == max_near) cycle
        n_bound = n_bound + 1
        bound(:, n_bound) = -wall_normal(:, k)/max(distance(k), 1.0e-3_wp)
      end do
      call add_free_facets()
    end do

  contains

    subroutine add_wall_facet(wall)
      !! The piece of a wall that a particle rests on, unless another one lies between.
      integer, intent(in) :: wall
      real(wp) :: depth

      depth = max(distance(wall), 0.0_wp)
      if (reach_inverse(-wall_normal(:, wall))*depth > 1.0_wp) return
      call facets%append(i, wall, .false., .true., position(:, i) - distance(wall)*edge(i)* &
                         wall_normal(:, wall), -wall_normal(:, wall), &
                         section(n_bound, bound, wall_normal(:, wall))*edge(i)**(ndim - 1))
    end subroutine add_wall_facet

    subroutine add_free_facets()
      !! What no neighbour and no wall covers.
      real(wp) :: weight(n_direction), axis(ndim), total, vector(ndim)
      integer :: side
      logical :: is_free

      weight = exposure(n_bound, bound, direction)
      total = sum(weight)
      if (.not. total > 0.0_wp) return
      axis = matmul(direction, weight)
      if (.not. norm2(axis) > balanced*total) axis = direction(:, maxloc(weight, dim=1))
      do side = 1, -1, -2
        associate (part => weight*merge(1.0_wp, 0.0_wp, &
                                        real(side, wp)*matmul(axis, direction) > 0.0_wp))
          vector = matmul(direction, part)
          if (.not. norm2(vector) > 0.0_wp) cycle
          vector = vector/norm2(vector)
          if (side < 0) then   ! the ends of a sheet's rim are no side
            if (reach_inverse(vector)*ball > 1.0_wp) cycle
          end if
          is_free = .not. meets_body(vector)
          call facets%append(i, 0, is_free, sum(part) > open_share*n_direction, &
                             position(:, i) + 0.5_wp*edge(i)*vector, vector, &
                             section(n_bound, bound, vector)*edge(i)**(ndim - 1))
        end associate
      end do
    end subroutine add_free_facets

    pure logical function meets_body(along)
      !! Does another particle face this one across a narrow gap?
      real(wp), intent(in) :: along(ndim)
      real(wp) :: component
      integer :: j

      meets_body = .false.
      do j = 1, n_bound
        component = dot_product(along, bound(:, j))
        meets_body = component*sight > 1.0_wp .and. component > opposite*norm2(bound(:, j))
        if (meets_body) return
      end do
    end function meets_body

    pure real(wp) function reach_inverse(along)
      !! One over the distance of the Voronoi cell's end, 0 if there is none [-].
      real(wp), intent(in) :: along(ndim)

      reach_inverse = max(0.0_wp, maxval(matmul(along, bound(:, 1:n_bound))))
    end function reach_inverse
  end subroutine find_facets

  pure function exposure(n_bound, bound, direction) result(weight)
    !! Kernel: 0 in covered directions, up to 1 in exposed ones.
    integer, intent(in) :: n_bound
    real(wp), intent(in) :: bound(ndim, max_near)   !! of the Voronoi cell: bound . x <= 1
    real(wp), intent(in) :: direction(ndim, n_direction)
    real(wp) :: weight(n_direction)
    real(wp) :: inverse   ! of the Voronoi cell's reach
    integer :: d, j

    weight = 0.0_wp
    do d = 1, n_direction
      inverse = 0.0_wp
      do j = 1, n_bound
        inverse = max(inverse, dot_product(direction(:, d), bound(:, j)))
        if (inverse*ball >= 1.0_wp) exit
      end do
      weight(d) = min(1.0_wp, max(0.0_wp, (1.0_wp/ball - inverse)/(1.0_wp/ball - 1.0_wp/full)))
    end do
  end function exposure

  pure real(wp) function section(n_bound, bound, normal) result(area)
    !! Kernel: section of the Voronoi cell across a normal, through the particle (through the
    !! facet's place it would be up to a fifth too large on balls); a ball's at most [-].
    integer, intent(in) :: n_bound
    real(wp), intent(in) :: bound(ndim, max_near)
    real(wp), intent(in) :: normal(ndim)
    real(wp), parameter :: turn = 2.0_wp*acos(-1.0_wp)/n_around
    real(wp) :: inverse, along(ndim), frame(ndim, ndim)
    integer :: k, j

    area = 1.0_wp
    if (ndim == 1) return
    area = 0.0_wp
    frame = tangents(normal)
    do k = 1, n_around
      along = cos(turn*k)*frame(:, 1) + sin(turn*k)*frame(:, max(ndim - 1, 1))
      if (ndim == 2) along = real(2*k - 3, wp)*frame(:, 1)
      inverse = 1.0_wp/ball
      do j = 1, n_bound
        inverse = max(inverse, dot_product(along, bound(:, j)))
      end do
      area = area + merge(1.0_wp/inverse, 0.5_wp*turn/inverse**2, ndim == 2)
    end do
  end function section

  pure function tangents(normal) result(frame)
    !! Unit vectors across a normal, in the first ndim - 1 columns.
    real(wp), intent(in) :: normal(ndim)
    real(wp) :: frame(ndim, ndim), bias(ndim)
    integer :: k, d

    frame = 0.0_wp
    bias = [(0.05_wp*d, d=1, ndim)]   ! the choice of an axis shall not hang on round-off
    do k = 1, max(ndim - 1, 1)
      d = minloc(abs(normal) + bias + merge(2.0_wp, 0.0_wp, k > 1)*abs(frame(:, 1)), dim=1)
      frame(d, k) = 1.0_wp
      frame(:, k) = frame(:, k) - dot_product(frame(:, k), normal)*normal
      if (k > 1) frame(:, k) = frame(:, k) - dot_product(frame(:, k), frame(:, 1))*frame(:, 1)
      frame(:, k) = frame(:, k)/norm2(frame(:, k))
    end do
  end function tangents

  pure function sample_directions() result(direction)
    !! Directions in even distances, turned so that none is one of a lattice's.
    real(wp) :: direction(ndim, n_direction)
    real(wp), parameter :: golden = acos(-1.0_wp)*(3.0_wp - sqrt(5.0_wp))
    real(wp) :: height, angle
    integer :: k

    do k = 1, n_direction
      if (ndim == 1) then
        direction(1, k) = real(2*k - 3, wp)
      else
        height = 0.0_wp
        angle = 2.0_wp*acos(-1.0_wp)*(real(k, wp) + 0.137_wp)/n_direction
        if (ndim == 3) then   ! a spiral from pole to pole, its turns by the golden angle
          height = (2.0_wp*real(k, wp) - 1.0_wp)/n_direction - 1.0_wp
          angle = golden*real(k, wp) + 0.137_wp
        end if
        direction(1, k) = sqrt(1.0_wp - height**2)*cos(angle)
        direction(ndim, k) = height
        direction(min(2, ndim), k) = sqrt(1.0_wp - height**2)*sin(angle)
      end if
    end do
  end function sample_directions

  subroutine facets_append(self, particle, wall, is_free, is_open, place, normal, area)
    !! One more facet.
    class(facets_t), intent(inout) :: self
    integer, intent(in) :: particle, wall
    logical, intent(in) :: is_free, is_open
    real(wp), intent(in) :: place(ndim), normal(ndim)   !! [m], [-]
    real(wp), intent(in) :: area                        !! [m2]
    type(facets_t) :: longer
    integer :: n, room

    n = self%n
    if (n == size(self%particle)) then
      room = 2*n + 64
      allocate (longer%particle(room), longer%wall(room), longer%is_open(room), &
                longer%is_free(room), longer%place(ndim, room), longer%normal(ndim, room), &
                longer%area(room))
      longer%particle(1:n) = self%particle(1:n)
      longer%wall(1:n) = self%wall(1:n)
      longer%is_open(1:n) = self%is_open(1:n)
      longer%is_free(1:n) = self%is_free(1:n)
      longer%place(:, 1:n) = self%place(:, 1:n)
      longer%normal(:, 1:n) = self%normal(:, 1:n)
      longer%area(1:n) = self%area(1:n)
      call move_alloc(longer%particle, self%particle)
      call move_alloc(longer%wall, self%wall)
      call move_alloc(longer%is_open, self%is_open)
      call move_alloc(longer%is_free, self%is_free)
      call move_alloc(longer%place, self%place)
      call move_alloc(longer%normal, self%normal)
      call move_alloc(longer%area, self%area)
    end if
    n = n + 1
    self%n = n
    self%particle(n) = particle
    self%wall(n) = wall
    self%is_open(n) = is_open
    self%is_free(n) = is_free
    self%place(:, n) = place
    self%normal(:, n) = normal
    self%area(n) = area
  end subroutine facets_append
end module dosui_free_surface

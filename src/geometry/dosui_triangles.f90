!! Bodies bounded by closed triangulated surfaces: topology, faces, inside tests, distances, and the
!! integrals over boxes cut out of them.
module dosui_triangles
  use dosui_geometry, only: clip_outline, cross
  use dosui_kinds, only: wp, i8
  use dosui_sort, only: sort_permutation
  use dosui_text, only: to_text
  implicit none
  private

  public :: closest_point

  real(wp), parameter :: merge_distance = 1.0e-6_wp   !! of equal corners, over the diagonal [-]
  real(wp), parameter :: least_height = 1.0e-8_wp     !! of a triangle, over its longest edge [-]
  real(wp), parameter :: least_volume = 1.0e-9_wp     !! over that of the bounding box [-]
  real(wp), parameter :: degrees = acos(-1.0_wp)/180.0_wp   !! radians per degree
  integer, parameter :: most_corners = 16             !! of a clipped triangle

  type :: buckets_t
    !! Triangles by the buckets of a regular lattice that their bounding boxes touch.
    integer :: n(3) = 1
    real(wp) :: low(3) = 0.0_wp           !! [m]
    real(wp) :: edge(3) = 1.0_wp          !! [m]
    integer, allocatable :: start(:)      !! (n_bucket + 1) CSR
    integer, allocatable :: triangle(:)
  contains
    procedure :: place => buckets_place
    procedure :: number => buckets_number
  end type buckets_t

  type, public :: triangles_t
    !! A closed surface; triangles are counter-clockwise seen from outside.
    integer :: n_vertex = 0, n_triangle = 0
    real(wp), allocatable :: vertex(:, :)      !! (3, n_vertex) [m]
    integer, allocatable :: corner(:, :)       !! (3, n_triangle)
    integer, allocatable :: neighbour(:, :)    !! (3, n_triangle) beyond the edge from a corner on
    integer, allocatable :: solid(:)           !! (n_triangle) part of the file
    integer, allocatable :: face(:)            !! (n_triangle) from `split`
    integer :: n_face = 0
    real(wp), allocatable :: normal(:, :)      !! (3, n_triangle) outward [-]
    real(wp), allocatable :: area(:)           !! (n_triangle) [m2]
    real(wp) :: low(3) = 0.0_wp, high(3) = 0.0_wp   !! bounding box [m]
    real(wp) :: origin(3) = 0.0_wp             !! where its coordinates count from [m]
    real(wp) :: volume = 0.0_wp                !! [m3]
    logical :: was_inside_out = .false.        !! before it was turned round
    type(buckets_t) :: columns                 !! along x
    type(buckets_t) :: buckets
  contains
    procedure :: init => triangles_init
    procedure :: split => triangles_split
    procedure :: describe_face => triangles_describe_face
    procedure :: winding => triangles_winding
    procedure :: contains => triangles_contains
    procedure :: moments => triangles_moments
    procedure :: points => triangles_points
  end type triangles_t

contains

  ! ---------------------------------------------------------------- from corners to a closed body

  subroutine triangles_init(self, corners, solid, line, message, origin)
    !! Joins single triangles to a closed surface, or says why they are none.
    class(triangles_t), intent(out) :: self
    real(wp), intent(in) :: corners(:, :, :)   !! (3, 3, n) coordinates, corners, triangles [m]
    integer, intent(in) :: solid(:)            !! (n) part of the file
    integer, intent(in) :: line(:)             !! (n) of the file where they begin; 0: no text
    character(len=:), allocatable, intent(out) :: message   !! '' if all is well
    real(wp), intent(in), optional :: origin(3)   !! where corners count from, for messages [m]
    integer :: t

    message = ''
    if (present(origin)) self%origin = origin
    self%n_triangle = size(corners, 3)
    if (self%n_triangle == 0) then
      message = 'holds no triangles'
      return
    end if
    self%solid = solid
    self%low = minval(minval(corners, dim=3), dim=2)
    self%high = maxval(maxval(corners, dim=3), dim=2)
    if (.not. all(self%high > self%low)) then
      message = 'encloses no volume: it is flat'
      return
    end if
    call merge_corners(self, reshape(corners, [3, 3*self%n_triangle]))
    call measure_triangles(self, line, message)
    if (len(message) > 0) return
    call find_neighbours(self, line, message)
    if (len(message) > 0) return
    self%volume = signed_volume(self)
    if (.not. abs(self%volume) > least_volume*product(self%high - self%low)) then
      message = 'encloses no volume'
      return
    end if
    self%was_inside_out = self%volume < 0.0_wp
    if (self%was_inside_out) then
      self%volume = -self%volume
      self%normal = -self%normal
      do t = 1, self%n_triangle
        self%corner(:, t) = self%corner([1, 3, 2], t)
        self%neighbour(:, t) = self%neighbour([3, 2, 1], t)
      end do
    end if
    call fill_buckets(self)
    call check_sides(self, line, message)
    if (len(message) == 0) call check_crossings(self, line, message)
  end subroutine triangles_init

  subroutine merge_corners(self, place)
    !! Corners of one place become one vertex: those that share a cell of one of eight lattices
    !! that are half a cell apart.
    type(triangles_t), intent(inout) :: self
    real(wp), intent(in) :: place(:, :)   !! (3, n) of all triangles' corners [m]
    integer, allocatable :: same(:), order(:), vertex(:)
    integer(i8), allocatable :: key(:)
    real(wp) :: cell, shift(3)
    integer :: k, d, lattice, n

    n = size(place, 2)
    cell = 2.0_wp*merge_distance*norm2(self%high - self%low)
    allocate (same(n), key(n), vertex(n))
    do k = 1, n
      same(k) = k
    end do
    do lattice = 0, 7
      shift = [(merge(0.5_wp, 0.0_wp, btest(lattice, d)), d=0, 2)]
      do k = 1, n
        key(k) = 0_i8
        do d = 1, 3
          key(k) = ishft(key(k), 21) + int((place(d, k) - self%low(d))/cell + shift(d), i8)
        end do
      end do
      call sort_permutation(key, order)
      do k = 2, n
        if (key(order(k)) /= key(order(k - 1))) cycle
        call unite(same, order(k - 1), order(k))
      end do
    end do
    self%n_vertex = 0
    allocate (self%vertex(3, n))
    do k = 1, n
      if (root(same, k) == k) then
        self%n_vertex = self%n_vertex + 1
        self%vertex(:, self%n_vertex) = place(:, k)
        vertex(k) = self%n_vertex
      else
        vertex(k) = vertex(root(same, k))
      end if
    end do
    self%vertex = self%vertex(:, :self%n_vertex)
    self%corner = reshape(vertex, [3, self%n_triangle])
  end subroutine merge_corners

  pure integer function root(parent, k) result(r)
    !! First member of the set that holds k.
    integer, intent(in) :: parent(:)
    integer, intent(in) :: k

    r = k
    do while (parent(r) /= r)
      r = parent(r)
    end do
  end function root

  pure subroutine unite(parent, a, b)
    !! Joins the sets of a and b; the lowest member leads.
    integer, intent(inout) :: parent(:)
    integer, intent(in) :: a, b
    integer :: low, high

    low = min(root(parent, a), root(parent, b))
    high = max(root(parent, a), root(parent, b))
    parent(high) = low
    parent(a) = low
    parent(b) = low
  end subroutine unite

  subroutine measure_triangles(self, line, message)
    !! Normals and areas.
    type(triangles_t), intent(inout) :: self
    integer, intent(in) :: line(:)
    character(len=:), allocatable, intent(inout) :: message
    real(wp) :: edge(3, 3), twice(3)
    integer :: t, k

    allocate (self%normal(3, self%n_triangle), self%area(self%n_triangle))
    do t = 1, self%n_triangle
      do k = 1, 3
        edge(:, k) = self%vertex(:, self%corner(modulo(k, 3) + 1, t)) - &
                     self%vertex(:, self%corner(k, t))
      end do
      twice = cross(edge(:, 1), edge(:, 2))
      if (.not. norm2(twice) > least_height*maxval(sum(edge**2, dim=1))) then
        message = named(t, line)//': its corners coincide or lie on a line'
        return
      end if
      self%area(t) = 0.5_wp*norm2(twice)
      self%normal(:, t) = twice/norm2(twice)
    end do
  end subroutine measure_triangles

  subroutine find_neighbours(self, line, message)
    !! Triangles beyond each edge; every edge must join two that run along it in opposite senses.
    type(triangles_t), intent(inout) :: self
    integer, intent(in) :: line(:)
    character(len=:), allocatable, intent(inout) :: message
    integer(i8), allocatable :: key(:)
    integer, allocatable :: order(:)
    integer :: t, k, n, first, last, a, b, n_open, open_edge

    n = 3*self%n_triangle
    allocate (key(n), self%neighbour(3, self%n_triangle))
    do t = 1, self%n_triangle
      do k = 1, 3
        a = self%corner(k, t)
        b = self%corner(modulo(k, 3) + 1, t)
        key(3*(t - 1) + k) = int(min(a, b), i8)*(self%n_vertex + 1_i8) + max(a, b)
      end do
    end do
    call sort_permutation(key, order)
    n_open = 0
    open_edge = 0
    first = 1
    do while (first <= n)
      last = first
      do while (last < n)
        if (key(order(last + 1)) /= key(order(first))) exit
        last = last + 1
      end do
      if (last == first) then
        n_open = n_open + 1
        if (open_edge == 0 .or. order(first) < open_edge) open_edge = order(first)
      else if (last > first + 1) then
        message = named(triangle_of(order(first)), line)//': its edge '//described(order(first))// &
                  ' belongs to '//to_text(last - first + 1)//' triangles; a closed surface has 2'
        return
      else
        a = order(first)
        b = order(last)
        if (start_of(a) == start_of(b)) then
          message = named(triangle_of(b), line)//': runs along its edge '//described(b)// &
                    ' in the same sense as '//named(triangle_of(a), line)// &
                    ': one of them must be turned round'
          return
        end if
        self%neighbour(modulo(a - 1, 3) + 1, triangle_of(a)) = triangle_of(b)
        self%neighbour(modulo(b - 1, 3) + 1, triangle_of(b)) = triangle_of(a)
      end if
      first = last + 1
    end do
    if (n_open > 0) message = named(triangle_of(open_edge), line)//': its edge '// &
                              described(open_edge)//' belongs to no other triangle: the '// &
                              'surface is not closed ('//to_text(n_open)//' such edges)'

  contains

    pure integer function triangle_of(edge)
      !! The triangle that an edge belongs to.
      integer, intent(in) :: edge

      triangle_of = (edge - 1)/3 + 1
    end function triangle_of

    pure integer function start_of(edge)
      !! The vertex that an edge starts from.
      integer, intent(in) :: edge

      start_of = self%corner(modulo(edge - 1, 3) + 1, triangle_of(edge))
    end function start_of

    pure function described(edge) result(text)
      !! Both ends.
      integer, intent(in) :: edge
      character(len=:), allocatable :: text
      integer :: from, to

      from = start_of(edge)
      to = self%corner(modulo(edge, 3) + 1, triangle_of(edge))
      text = 'from '//place_text(self%vertex(:, from) + self%origin)//' to '// &
             place_text(self%vertex(:, to) + self%origin)
    end function described
  end subroutine find_neighbours

  pure function named(triangle, line) result(text)
    !! A triangle for a message.
    integer, intent(in) :: triangle
    integer, intent(in) :: line(:)
    character(len=:), allocatable :: text

    text = 'triangle '//to_text(triangle)
    if (line(triangle) > 0) text = text//' (line '//to_text(line(triangle))//')'
  end function named

  pure function place_text(place) result(text)
    !! Coordinates in brackets.
    real(wp), intent(in) :: place(3)
    character(len=:), allocatable :: text

    text = '('//coordinate(place(1))//', '//coordinate(place(2))//', '//coordinate(place(3))//')'

  contains

    pure function coordinate(x) result(text)
      !! To a millimetre where six digits are less.
      real(wp), intent(in) :: x   !! [m]
      character(len=:), allocatable :: text

      text = to_text(x, max(6, 4 + int(log10(max(abs(x), 1.0_wp)))))
    end function coordinate
  end function place_text

  pure real(wp) function signed_volume(self) result(volume)
    !! Sum of tetrahedra with their tips in the middle of the bounding box [m3].
    type(triangles_t), intent(in) :: self
    real(wp) :: middle(3)
    integer :: t

    middle = 0.5_wp*(self%low + self%high)
    volume = 0.0_wp
    do t = 1, self%n_triangle
      volume = volume + self%area(t)/3.0_wp* &
               dot_product(self%normal(:, t), self%vertex(:, self%corner(1, t)) - middle)
    end do
  end function signed_volume

  subroutine check_sides(self, line, message)
    !! Just inside every triangle the body must be once, just outside not at all.
    type(triangles_t), intent(in) :: self
    integer, intent(in) :: line(:)
    character(len=:), allocatable, intent(inout) :: message
    real(wp) :: x(3, 3), middle(3), step
    integer :: t, outside, inside

    do t = 1, self%n_triangle
      x = self%points(t)
      middle = sum(x, dim=2)/3.0_wp
      step = min(1.0e-6_wp*norm2(self%high - self%low), 1.0e-3_wp*sqrt(self%area(t)), &
                 1.0e-3_wp*self%area(t)/maxval(norm2(x - x(:, [2, 3, 1]), dim=1)))
      outside = self%winding(middle + step*self%normal(:, t))
      inside = self%winding(middle - step*self%normal(:, t))
      if (outside == 0 .and. inside == 1) cycle
      if (outside >= 1 .and. inside == outside + 1) then
        message = named(t, line)//': lies inside the body: two parts of it overlap'
      else if (inside <= 0) then
        message = named(t, line)//': belongs to a part that is inside out'
      else
        message = named(t, line)//': the surface passes through itself'
      end if
      return
    end do
  end subroutine check_sides

  subroutine check_crossings(self, line, message)
    !! No edge may pass through a triangle that it does not belong to.
    type(triangles_t), intent(in) :: self
    integer, intent(in) :: line(:)
    character(len=:), allocatable, intent(inout) :: message
    real(wp) :: x(3, 3), y(3, 3)
    integer :: b, i, j, k

    do b = 1, size(self%buckets%start) - 1
      do i = self%buckets%start(b), self%buckets%start(b + 1) - 1
        associate (t => self%buckets%triangle(i))
          x = self%points(t)
          do j = self%buckets%start(b), self%buckets%start(b + 1) - 1
            associate (other => self%buckets%triangle(j))
              y = self%points(other)
              if (any(maxval(y, dim=2) < minval(x, dim=2))) cycle
              if (any(maxval(x, dim=2) < minval(y, dim=2))) cycle
              if (any(self%corner(:, other) == self%corner(1, t)) .or. &
                  any(self%corner(:, other) == self%corner(2, t)) .or. &
                  any(self%corner(:, other) == self%corner(3, t))) cycle
              do k = 1, 3
                if (.not. pierces(y(:, k), y(:, modulo(k, 3) + 1), x)) cycle
                message = named(t, line)//': is crossed by '//named(other, line)// &
                          ': the surface passes through itself, or parts of it overlap'
                return
              end do
            end associate
          end do
        end associate
      end do
    end do
  end subroutine check_crossings

  pure logical function pierces(from, to, x)
    !! Does a segment pass through a triangle, through its edges too?
    real(wp), intent(in) :: from(3), to(3)   !! [m]
    real(wp), intent(in) :: x(3, 3)          !! corners [m]
    real(wp), parameter :: slack = 1.0e-9_wp
    real(wp) :: normal(3), height(2), side(3), scale
    integer :: k

    normal = cross(x(:, 2) - x(:, 1), x(:, 3) - x(:, 1))
    height = [dot_product(normal, from - x(:, 1)), dot_product(normal, to - x(:, 1))]
    scale = slack*norm2(normal)*(norm2(to - from) + sqrt(norm2(normal)))
    pierces = .false.
    if (minval(height) > -scale .or. maxval(height) < scale) return
    do k = 1, 3
      side(k) = dot_product(to - from, cross(x(:, k) - from, x(:, modulo(k, 3) + 1) - from))
    end do
    scale = slack*norm2(to - from)*norm2(normal)
    pierces = all(side > -scale) .or. all(side < scale)
  end function pierces

  ! ---------------------------------------------------------------- buckets

  subroutine fill_buckets(self)
    !! Sorts the triangles into columns along x and into cubes.
    type(triangles_t), intent(inout) :: self
    real(wp) :: extent(3), edge

    extent = self%high - self%low
    edge = sqrt(product(extent(2:))/real(self%n_triangle, wp))
    call fill(self, [1, pieces(extent(2), edge), pieces(extent(3), edge)], self%columns)
    edge = max(sqrt(sum(self%area)/real(self%n_triangle, wp)), &
               (product(extent)/(8.0_wp*real(self%n_triangle, wp) + 1000.0_wp))**(1.0_wp/3.0_wp))
    call fill(self, [pieces(extent(1), edge), pieces(extent(2), edge), pieces(extent(3), edge)], &
              self%buckets)

  contains

    pure integer function pieces(length, wanted)
      !! Number of buckets along a length.
      real(wp), intent(in) :: length, wanted

      pieces = max(1, int(min(length/wanted, 4096.0_wp)))
    end function pieces
  end subroutine fill_buckets

  subroutine fill(self, n, buckets)
    !! Sorts the triangles into one lattice.
    type(triangles_t), intent(in) :: self
    integer, intent(in) :: n(3)
    type(buckets_t), intent(out) :: buckets
    integer :: t, i, j, k, first(3), last(3), pass, b
    real(wp) :: x(3, 3)

    buckets%n = n
    buckets%low = self%low
    buckets%edge = (self%high - self%low)/real(n, wp)
    allocate (buckets%start(product(n) + 1), source=0)
    do pass = 1, 2
      do t = 1, self%n_triangle
        x = self%points(t)
        first = buckets%place(minval(x, dim=2))
        last = buckets%place(maxval(x, dim=2))
        do k = first(3), last(3)
          do j = first(2), last(2)
            do i = first(1), last(1)
              b = buckets%number([i, j, k])
              if (pass == 2) buckets%triangle(buckets%start(b)) = t
              buckets%start(b) = buckets%start(b) + 1
            end do
          end do
        end do
      end do
      if (pass == 1) then   ! numbers become places
        allocate (buckets%triangle(sum(buckets%start)))
        i = 1
        do b = 1, product(n)
          j = buckets%start(b)
          buckets%start(b) = i
          i = i + j
        end do
      end if
    end do
    buckets%start(2:) = buckets%start(:product(n))
    buckets%start(1) = 1
  end subroutine fill

  pure function buckets_place(self, x) result(place)
    !! Which bucket a place belongs to; places beside the lattice belong to the next one.
    class(buckets_t), intent(in) :: self
    real(wp), intent(in) :: x(3)   !! [m]
    integer :: place(3)

    place = int(min(max((x - self%low)/self%edge, 0.0_wp), real(self%n, wp) - 0.5_wp))
  end function buckets_place

  pure integer function buckets_number(self, place) result(number)
    !! Number of a bucket.
    class(buckets_t), intent(in) :: self
    integer, intent(in) :: place(3)

    number = 1 + place(1) + self%n(1)*(place(2) + self%n(2)*place(3))
  end function buckets_number

  ! ---------------------------------------------------------------- faces

  subroutine triangles_split(self, angle)
    !! Divides the surface into faces: neighbours of one solid whose normals differ by less than
    !! an angle. They are numbered in the order of the file.
    class(triangles_t), intent(inout) :: self
    real(wp), intent(in) :: angle   !! [deg]
    integer, allocatable :: same(:)
    real(wp), parameter :: slack = 1.0e-4_wp   ! [deg]
    integer :: t, k, other

    allocate (same(self%n_triangle))
    do t = 1, self%n_triangle
      same(t) = t
    end do
    do t = 1, self%n_triangle
      do k = 1, 3
        other = self%neighbour(k, t)
        if (self%solid(other) /= self%solid(t)) cycle
        if (angle_between(self%normal(:, t), self%normal(:, other)) > angle + slack) cycle
        call unite(same, t, other)
      end do
    end do
    if (allocated(self%face)) deallocate (self%face)
    allocate (self%face(self%n_triangle))
    self%n_face = 0
    do t = 1, self%n_triangle
      if (root(same, t) == t) then
        self%n_face = self%n_face + 1
        self%face(t) = self%n_face
      else
        self%face(t) = self%face(root(same, t))
      end if
    end do
  end subroutine triangles_split

  pure function triangles_describe_face(self, face) result(text)
    !! Area, mean normal (short if the face is curved) and middle of a face.
    class(triangles_t), intent(in) :: self
    integer, intent(in) :: face
    character(len=:), allocatable :: text
    real(wp) :: area, normal(3), middle(3)
    integer :: t

    area = 0.0_wp
    normal = 0.0_wp
    middle = 0.0_wp
    do t = 1, self%n_triangle
      if (self%face(t) /= face) cycle
      area = area + self%area(t)
      normal = normal + self%area(t)*self%normal(:, t)
      middle = middle + self%area(t)*sum(self%points(t), dim=2)/3.0_wp
    end do
    text = to_text(area, 6)//' m2, normal '//place_text(tidy(normal/area, 1.0e-4_wp))// &
           ', middle '//place_text(tidy(middle/area, 1.0e-6_wp*norm2(self%high - self%low)) + &
                                   self%origin)
  end function triangles_describe_face

  elemental real(wp) function tidy(value, least)
    !! 0 for what is nothing but round-off, for messages.
    real(wp), intent(in) :: value, least

    tidy = merge(value, 0.0_wp, abs(value) >= least)
  end function tidy

  pure real(wp) function angle_between(a, b) result(angle)
    !! Of two unit vectors [deg].
    real(wp), intent(in) :: a(3), b(3)

    angle = atan2(norm2(cross(a, b)), dot_product(a, b))/degrees
  end function angle_between

  ! ---------------------------------------------------------------- inside tests

  pure integer function triangles_winding(self, position) result(winding)
    !! How often the surface winds round a place: crossings of the ray in the direction of x, each
    !! with its sense. Each edge is looked at in the same way from both of its triangles, so that
    !! rays through edges and corners cross as often as their neighbours.
    class(triangles_t), intent(in) :: self
    real(wp), intent(in) :: position(3)   !! [m]
    real(wp) :: x(3, 3)
    integer :: b, k, turns

    winding = 0
    if (any(position < self%low) .or. any(position > self%high)) return
    b = self%columns%number(self%columns%place(position))
    do k = self%columns%start(b), self%columns%start(b + 1) - 1
      associate (t => self%columns%triangle(k))
        x = self%points(t)
        if (maxval(x(1, :)) < position(1)) cycle
        turns = turns_around(self%corner(:, t), x, position)
        if (turns == 0) cycle
        if (crossing(x, self%normal(:, t), position) > position(1)) winding = winding + turns
      end associate
    end do
  end function triangles_winding

  pure integer function turns_around(corner, x, position) result(turns)
    !! How often a triangle, seen along x, runs round a place: 1 counter-clockwise, -1 clockwise.
    integer, intent(in) :: corner(3)      !! vertices
    real(wp), intent(in) :: x(3, 3)       !! their places [m]
    real(wp), intent(in) :: position(3)   !! [m]
    real(wp) :: a(3), b(3), side
    integer :: k, next, sense

    turns = 0
    do k = 1, 3
      next = modulo(k, 3) + 1
      sense = 1
      a = x(:, k)
      b = x(:, next)
      if (corner(k) > corner(next)) then
        sense = -1
        a = x(:, next)
        b = x(:, k)
      end if
      if ((a(3) > position(3)) .eqv. (b(3) > position(3))) cycle
      side = (b(2) - a(2))*(position(3) - a(3)) - (position(2) - a(2))*(b(3) - a(3))
      if (b(3) > a(3)) then
        if (side > 0.0_wp) turns = turns + sense
      else
        if (side < 0.0_wp) turns = turns - sense
      end if
    end do
  end function turns_around

  pure real(wp) function crossing(x, normal, position)
    !! Where the line along x through a place meets a triangle [m].
    real(wp), intent(in) :: x(3, 3)       !! corners [m]
    real(wp), intent(in) :: normal(3)
    real(wp), intent(in) :: position(3)   !! [m]
    real(wp), parameter :: almost_along = 1.0e-12_wp

    crossing = x(1, 1)
    if (abs(normal(1)) > almost_along) then
      crossing = crossing + dot_product(normal(2:), x(2:, 1) - position(2:))/normal(1)
    end if
    crossing = min(max(crossing, minval(x(1, :))), maxval(x(1, :)))
  end function crossing

  pure logical function triangles_contains(self, position, margin) result(inside)
    !! Is a place inside, at least `margin` away from the surface?
    class(triangles_t), intent(in) :: self
    real(wp), intent(in) :: position(3)   !! [m]
    real(wp), intent(in) :: margin        !! may be negative [m]

    inside = .false.
    if (any(position < self%low - abs(margin)) .or. any(position > self%high + abs(margin))) return
    inside = self%winding(position) /= 0
    if (.not. abs(margin) > 0.0_wp .or. (inside .eqv. margin < 0.0_wp)) return
    if (is_near(self, position, abs(margin))) inside = margin < 0.0_wp
  end function triangles_contains

  pure logical function is_near(self, position, distance)
    !! Is a triangle nearer than a distance?
    type(triangles_t), intent(in) :: self
    real(wp), intent(in) :: position(3), distance   !! [m]
    integer :: first(3), last(3), i, j, k, m, b

    first = self%buckets%place(position - distance)
    last = self%buckets%place(position + distance)
    is_near = .true.
    do k = first(3), last(3)
      do j = first(2), last(2)
        do i = first(1), last(1)
          b = self%buckets%number([i, j, k])
          do m = self%buckets%start(b), self%buckets%start(b + 1) - 1
            if (norm2(position - closest_point(self%points(self%buckets%triangle(m)), &
                                               position)) < distance) return
          end do
        end do
      end do
    end do
    is_near = .false.
  end function is_near

  pure function closest_point(x, position) result(closest)
    !! The point of a triangle that is nearest to a place [m].
    real(wp), intent(in) :: x(3, 3)       !! corners [m]
    real(wp), intent(in) :: position(3)   !! [m]
    real(wp) :: closest(3), normal(3), edge(3), candidate(3), share
    integer :: k, next
    logical :: within

    normal = cross(x(:, 2) - x(:, 1), x(:, 3) - x(:, 1))
    closest = position - dot_product(position - x(:, 1), normal)/sum(normal**2)*normal
    within = .true.
    do k = 1, 3
      edge = x(:, modulo(k, 3) + 1) - x(:, k)
      if (dot_product(cross(edge, closest - x(:, k)), normal) < 0.0_wp) within = .false.
    end do
    if (within) return
    closest = x(:, 1)
    do k = 1, 3
      next = modulo(k, 3) + 1
      edge = x(:, next) - x(:, k)
      share = min(max(dot_product(position - x(:, k), edge)/sum(edge**2), 0.0_wp), 1.0_wp)
      candidate = x(:, k) + share*edge
      if (norm2(candidate - position) < norm2(closest - position)) closest = candidate
    end do
  end function closest_point

  pure function triangles_points(self, triangle) result(x)
    !! The three corners of a triangle [m].
    class(triangles_t), intent(in) :: self
    integer, intent(in) :: triangle
    real(wp) :: x(3, 3)

    x = self%vertex(:, self%corner(:, triangle))
  end function triangles_points

  ! ---------------------------------------------------------------- integrals over cells

  pure subroutine triangles_moments(self, corner, edge, volume, moment, mixed)
    !! Integrals over the part of a cubic cell that the body fills, in coordinates from 0 to 1.
    !!
    !! The field (F(min(max(x, 0), 1), y, z), 0, 0) with dF/dx = f has the divergence f in the cell
    !! and 0 before and behind it, and no flux through planes along x. So the integral of f is the
    !! flux through those parts of the surface that project into the cell along x.
    class(triangles_t), intent(in) :: self
    real(wp), intent(in) :: corner(3)      !! lowest of the cell [m]
    real(wp), intent(in) :: edge           !! [m]
    real(wp), intent(out) :: volume        !! of 1 [-]
    real(wp), intent(out) :: moment(3)     !! of x, y, z [-]
    real(wp), intent(out) :: mixed(3)      !! of yz, zx, xy [-]
    real(wp) :: x(3, 3), outline(3, most_corners), behind(3, most_corners)
    integer :: first(3), last(3), own(3), j, k, m, b, n, n_behind, d

    volume = 0.0_wp
    moment = 0.0_wp
    mixed = 0.0_wp
    first = self%columns%place(corner)
    last = self%columns%place(corner + edge)
    do k = first(3), last(3)
      do j = first(2), last(2)
        b = self%columns%number([0, j, k])
        do m = self%columns%start(b), self%columns%start(b + 1) - 1
          x = self%points(self%columns%triangle(m))
          own = max(self%columns%place(minval(x, dim=2)), first)
          if (own(2) /= j .or. own(3) /= k) cycle   ! it is met in another column, too
          do d = 1, 3
            x(d, :) = (x(d, :) - corner(d))/edge
          end do
          if (any(maxval(x, dim=2) <= 0.0_wp) .or. any(minval(x(2:, :), dim=2) >= 1.0_wp)) cycle
          n = 3
          outline(:, :3) = x
          do d = 2, 3
            call clip_outline(d, 0.0_wp, 1.0_wp, n, outline)
            call clip_outline(d, 1.0_wp, -1.0_wp, n, outline)
          end do
          call clip_outline(1, 0.0_wp, 1.0_wp, n, outline)
          if (any(outline(1, :n) > 1.0_wp)) then
            n_behind = n
            behind(:, :n) = outline(:, :n)
            call clip_outline(1, 1.0_wp, 1.0_wp, n_behind, behind)
            behind(1, :n_behind) = 1.0_wp
            call add_flux(n_behind, behind, volume, moment, mixed)
            call clip_outline(1, 1.0_wp, -1.0_wp, n, outline)
          end if
          call add_flux(n, outline, volume, moment, mixed)
        end do
      end do
    end do
  end subroutine triangles_moments

  pure subroutine add_flux(n, outline, volume, moment, mixed)
    !! Adds the fluxes through a polygon, by a rule that is exact for cubics.
    integer, intent(in) :: n
    real(wp), intent(in) :: outline(3, most_corners)
    real(wp), intent(inout) :: volume, moment(3), mixed(3)
    real(wp), parameter :: weight(4) = [-27.0_wp, 25.0_wp, 25.0_wp, 25.0_wp]/48.0_wp
    real(wp), parameter :: share(3, 4) = reshape([1.0_wp/3.0_wp, 1.0_wp/3.0_wp, 1.0_wp/3.0_wp, &
                                                  0.6_wp, 0.2_wp, 0.2_wp, 0.2_wp, 0.6_wp, &
                                                  0.2_wp, 0.2_wp, 0.2_wp, 0.6_wp], [3, 4])
    real(wp) :: a(3), b(3), c(3), area, x(3)
    integer :: k, g

    a = outline(:, 1)
    do k = 2, n - 1
      b = outline(:, k)
      c = outline(:, k + 1)
      area = 0.5_wp*((b(2) - a(2))*(c(3) - a(3)) - (b(3) - a(3))*(c(2) - a(2)))
      do g = 1, 4
        x = share(1, g)*a + share(2, g)*b + share(3, g)*c
        associate (flux => area*weight(g)*x(1))
          volume = volume + flux
          moment = moment + flux*[0.5_wp*x(1), x(2), x(3)]
          mixed = mixed + flux*[x(2)*x(3), 0.5_wp*x(1)*x(3), 0.5_wp*x(1)*x(2)]
        end associate
      end do
    end do
  end subroutine add_flux
end module dosui_triangles

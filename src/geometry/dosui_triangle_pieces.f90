!! Divides faces of a triangulated surface into pieces of about one spacing, whatever the sizes of
!! their triangles.
!!
!! A planar face that a rectangular lattice fills exactly is divided by it. Any other face is cut
!! into crumbs, which gather around centres: Lloyd's iterations [Lloyd1982] with distances that also
!! count how much normals differ. Areas of all pieces add up to that of the face.
module dosui_triangle_pieces
  use dosui_geometry, only: clip_outline
  use dosui_kinds, only: wp, i8
  use dosui_sort, only: sort_permutation
  use dosui_triangles, only: closest_point, triangles_t
  implicit none
  private

  public :: divide_face

  real(wp), parameter :: plane_tolerance = 1.0e-5_wp   !! of normals, and of lattice cells [-]
  real(wp), parameter :: crumb_edge = 0.3_wp           !! longest, in spacings [-]
  real(wp), parameter :: turn_weight = 1.0_wp          !! of normals against distances [-]
  integer, parameter :: iterations = 30

  type :: crumbs_t
    !! Small parts of triangles.
    integer :: n = 0
    real(wp), allocatable :: middle(:, :)    !! (3, n) [m]
    real(wp), allocatable :: area(:)         !! (n) [m2]
    integer, allocatable :: triangle(:)      !! (n)
  end type crumbs_t

contains

  subroutine divide_face(body, face, spacing, position, normal, area, edge)
    !! Places on the surface, mean normals and areas of a face's pieces.
    type(triangles_t), intent(in) :: body
    integer, intent(in) :: face
    real(wp), intent(in) :: spacing                          !! wanted length of a piece [m]
    real(wp), allocatable, intent(out) :: position(:, :)     !! (3, n) [m]
    real(wp), allocatable, intent(out) :: normal(:, :)       !! (3, n) outward [-]
    real(wp), allocatable, intent(out) :: area(:)            !! (n) [m2]
    real(wp), allocatable, intent(out), optional :: edge(:, :)
    !! (3, 2) that span every piece about its place, where a lattice fills the face [m]
    integer, allocatable :: members(:)
    real(wp), allocatable :: centre(:, :), direction(:, :)
    type(crumbs_t) :: crumbs
    real(wp) :: mean(3), cell_edge(3, 2)
    logical :: fits
    integer :: t

    members = pack([(t, t=1, body%n_triangle)], body%face == face)
    mean = matmul(body%normal(:, members), body%area(members))
    fits = norm2(mean) >= (1.0_wp - plane_tolerance**2)*sum(body%area(members))
    if (fits) then
      mean = mean/norm2(mean)
      call divide_by_lattice(body, members, mean, spacing, position, area, cell_edge, fits)
      if (fits) then
        normal = spread(mean, 2, size(area))
        if (present(edge)) edge = cell_edge
        return
      end if
    end if
    call crumble(body, members, crumb_edge*spacing, crumbs)
    if (allocated(position)) then   ! the lattice's cells that are at least half full
      centre = position
      direction = spread(mean, 2, size(centre, 2))
    else
      call choose_centres(body, crumbs, spacing, centre, direction)
    end if
    call gather_crumbs(body, crumbs, spacing, centre, direction, position, normal, area)
  end subroutine divide_face

  ! ---------------------------------------------------------------- planar faces

  subroutine divide_by_lattice(body, members, normal, spacing, position, area, edge, fits)
    !! Cuts a planar face by a lattice along its longest side. `fits` if no cell is cut; if not, the
    !! cells at least half full are given.
    type(triangles_t), intent(in) :: body
    integer, intent(in) :: members(:)
    real(wp), intent(in) :: normal(3), spacing
    real(wp), allocatable, intent(out) :: position(:, :)     !! [m]
    real(wp), allocatable, intent(out) :: area(:)            !! [m2]
    real(wp), intent(out) :: edge(3, 2)                      !! of a cell [m]
    logical, intent(out) :: fits
    real(wp) :: along(3), axes(3, 2), origin(3), low(2), high(2), step(2), x(3, 3), flat(2, 3)
    real(wp), allocatable :: sums(:, :)   ! area and its moments of each cell
    integer :: n(2), k, m, first(2), last(2), i, j, c
    logical, allocatable :: keep(:)

    origin = body%vertex(:, body%corner(1, members(1)))
    axes = 0.0_wp
    do m = 1, size(members)
      x = body%points(members(m))
      do k = 1, 3
        if (body%face(body%neighbour(k, members(m))) == body%face(members(m))) cycle
        along = x(:, modulo(k, 3) + 1) - x(:, k)
        if (norm2(along) > (1.0_wp + plane_tolerance)*norm2(axes(:, 1))) axes(:, 1) = along
      end do
    end do
    axes(:, 1) = axes(:, 1) - dot_product(axes(:, 1), normal)*normal
    axes(:, 1) = axes(:, 1)/norm2(axes(:, 1))
    axes(:, 2) = [normal(2)*axes(3, 1) - normal(3)*axes(2, 1), &
                  normal(3)*axes(1, 1) - normal(1)*axes(3, 1), &
                  normal(1)*axes(2, 1) - normal(2)*axes(1, 1)]
    low = huge(1.0_wp)
    high = -huge(1.0_wp)
    do m = 1, size(members)
      flat = matmul(transpose(axes), body%points(members(m)) - spread(origin, 2, 3))
      low = min(low, minval(flat, dim=2))
      high = max(high, maxval(flat, dim=2))
    end do
    n = max(1, nint((high - low)/spacing))
    step = (high - low)/real(n, wp)
    edge = axes*spread(step, 1, 3)
    allocate (sums(3, product(n)), source=0.0_wp)
    do m = 1, size(members)
      flat = matmul(transpose(axes), body%points(members(m)) - spread(origin, 2, 3))
      do k = 1, 3
        flat(:, k) = (flat(:, k) - low)/step
      end do
      first = min(max(int(minval(flat, dim=2)), 0), n - 1)
      last = min(max(int(maxval(flat, dim=2)), 0), n - 1)
      do j = first(2), last(2)
        do i = first(1), last(1)
          c = 1 + i + n(1)*j
          call add_cell(flat - spread(real([i, j], wp), 2, 3), sums(:, c))
        end do
      end do
    end do
    fits = all(sums(1, :) < plane_tolerance .or. abs(sums(1, :) - 1.0_wp) < plane_tolerance)
    keep = sums(1, :) >= 0.5_wp
    if (.not. any(keep)) keep(maxloc(sums(1, :), dim=1)) = .true.
    allocate (position(3, count(keep)), area(count(keep)))
    m = 0
    do c = 1, product(n)
      if (.not. keep(c)) cycle
      m = m + 1
      associate (cell => real([mod(c - 1, n(1)), (c - 1)/n(1)], wp))
        position(:, m) = origin + matmul(axes, low + step*(cell + sums(2:, c)/sums(1, c)))
      end associate
      area(m) = sums(1, c)*product(step)
    end do
  end subroutine divide_by_lattice

  pure subroutine add_cell(corner, sums)
    !! Area, and its moments, of a triangle's part in the unit square.
    real(wp), intent(in) :: corner(2, 3)
    real(wp), intent(inout) :: sums(3)
    real(wp) :: outline(2, 16), twice
    integer :: n, k, d

    n = 3
    outline(:, :3) = corner
    do d = 1, 2
      call clip_outline(d, 0.0_wp, 1.0_wp, n, outline)
      call clip_outline(d, 1.0_wp, -1.0_wp, n, outline)
    end do
    do k = 2, n - 1
      twice = (outline(1, k) - outline(1, 1))*(outline(2, k + 1) - outline(2, 1)) - &
              (outline(2, k) - outline(2, 1))*(outline(1, k + 1) - outline(1, 1))
      sums(1) = sums(1) + 0.5_wp*abs(twice)
      sums(2:) = sums(2:) + abs(twice)/6.0_wp*(outline(:, 1) + outline(:, k) + outline(:, k + 1))
    end do
  end subroutine add_cell

  ! ---------------------------------------------------------------- other faces

  subroutine crumble(body, members, longest, crumbs)
    !! Halves triangles across their longest edges until no edge is longer than wanted.
    type(triangles_t), intent(in) :: body
    integer, intent(in) :: members(:)
    real(wp), intent(in) :: longest   !! [m]
    type(crumbs_t), intent(inout) :: crumbs
    integer, parameter :: deepest = 64
    real(wp) :: stack(3, 3, deepest), area(deepest), x(3, 3), half, length(3)
    integer :: m, n, k, next

    do m = 1, size(members)
      n = 1
      stack(:, :, 1) = body%points(members(m))
      area(1) = body%area(members(m))
      do while (n > 0)
        x = stack(:, :, n)
        half = 0.5_wp*area(n)
        length = norm2(x(:, [2, 3, 1]) - x, dim=1)
        k = maxloc(length, dim=1)
        if (length(k) <= longest .or. n == deepest) then
          call add_crumb(sum(x, dim=2)/3.0_wp, area(n), members(m))
          n = n - 1
          cycle
        end if
        next = mod(k, 3) + 1
        stack(:, :, n) = x
        stack(:, k, n) = 0.5_wp*(x(:, k) + x(:, next))
        stack(:, :, n + 1) = x
        stack(:, next, n + 1) = stack(:, k, n)
        area(n:n + 1) = half
        n = n + 1
      end do
    end do
    crumbs%middle = crumbs%middle(:, :crumbs%n)
    crumbs%area = crumbs%area(:crumbs%n)
    crumbs%triangle = crumbs%triangle(:crumbs%n)

  contains

    subroutine add_crumb(middle, its_area, triangle)
      !! One more; room doubles.
      real(wp), intent(in) :: middle(3), its_area
      integer, intent(in) :: triangle
      type(crumbs_t) :: more

      if (.not. allocated(crumbs%area)) allocate (crumbs%middle(3, 1024), crumbs%area(1024), &
                                                  crumbs%triangle(1024))
      if (crumbs%n == size(crumbs%area)) then
        allocate (more%middle(3, 2*crumbs%n), more%area(2*crumbs%n), more%triangle(2*crumbs%n))
        more%middle(:, :crumbs%n) = crumbs%middle
        more%area(:crumbs%n) = crumbs%area
        more%triangle(:crumbs%n) = crumbs%triangle
        call move_alloc(more%middle, crumbs%middle)
        call move_alloc(more%area, crumbs%area)
        call move_alloc(more%triangle, crumbs%triangle)
      end if
      crumbs%n = crumbs%n + 1
      crumbs%middle(:, crumbs%n) = middle
      crumbs%area(crumbs%n) = its_area
      crumbs%triangle(crumbs%n) = triangle
    end subroutine add_crumb
  end subroutine crumble

  subroutine choose_centres(body, crumbs, spacing, centre, direction)
    !! First centres: crumbs at equal steps of area along a Z-shaped curve (Morton's order).
    type(triangles_t), intent(in) :: body
    type(crumbs_t), intent(in) :: crumbs
    real(wp), intent(in) :: spacing
    real(wp), allocatable, intent(out) :: centre(:, :), direction(:, :)   !! (3, n) [m], [-]
    integer, parameter :: bits = 20
    integer(i8) :: key(crumbs%n)
    integer, allocatable :: order(:)
    real(wp) :: low(3), edge, passed, total
    integer :: place(3), n, k, m, b, d

    low = minval(crumbs%middle, dim=2)
    edge = max(maxval(maxval(crumbs%middle, dim=2) - low), spacing)*1.001_wp/2.0_wp**bits
    do k = 1, crumbs%n
      place = int((crumbs%middle(:, k) - low)/edge)
      key(k) = 0_i8
      do b = bits - 1, 0, -1
        do d = 1, 3
          key(k) = 2_i8*key(k) + int(ibits(place(d), b, 1), i8)
        end do
      end do
    end do
    call sort_permutation(key, order)
    total = sum(crumbs%area)
    n = max(1, nint(total/spacing**2))
    allocate (centre(3, n), direction(3, n))
    passed = 0.0_wp
    m = 0
    do k = 1, crumbs%n
      passed = passed + crumbs%area(order(k))
      do while (m < n)
        if (passed < (real(m, wp) + 0.5_wp)*total/real(n, wp)) exit
        m = m + 1
        centre(:, m) = crumbs%middle(:, order(k))
        direction(:, m) = body%normal(:, crumbs%triangle(order(k)))
      end do
    end do
    centre = centre(:, :m)
    direction = direction(:, :m)
  end subroutine choose_centres

  subroutine gather_crumbs(body, crumbs, spacing, centre, direction, position, normal, area)
    !! Crumbs go to the nearest centre, centres to the middle of their crumbs, and so on.
    type(triangles_t), intent(in) :: body
    type(crumbs_t), intent(in) :: crumbs
    real(wp), intent(in) :: spacing
    real(wp), intent(inout) :: centre(:, :), direction(:, :)   !! (3, n) [m], [-]
    real(wp), allocatable, intent(out) :: position(:, :), normal(:, :)   !! (3, n) [m], [-]
    real(wp), allocatable, intent(out) :: area(:)            !! (n) [m2]
    real(wp), allocatable :: sums(:, :)   ! area, and area times middle and normal
    integer, allocatable :: owner(:), before(:)
    integer :: pass, k, n

    n = size(centre, 2)
    allocate (owner(crumbs%n), source=0)
    allocate (sums(7, n))
    do pass = 1, iterations
      before = owner
      call find_owners(body, crumbs, spacing, centre, direction, owner)
      sums = 0.0_wp
      do k = 1, crumbs%n
        associate (own => sums(:, owner(k)), a => crumbs%area(k))
          own(1) = own(1) + a
          own(2:4) = own(2:4) + a*crumbs%middle(:, k)
          own(5:7) = own(5:7) + a*body%normal(:, crumbs%triangle(k))
        end associate
      end do
      do k = 1, n
        if (.not. sums(1, k) > 0.0_wp) cycle
        centre(:, k) = sums(2:4, k)/sums(1, k)
        if (norm2(sums(5:7, k)) > 1.0e-3_wp*sums(1, k)) direction(:, k) = &
          sums(5:7, k)/norm2(sums(5:7, k))
      end do
      if (all(owner == before)) exit
    end do
    position = spread(spread(huge(1.0_wp), 1, 3), 2, n)
    do k = 1, crumbs%n
      call approach(body%points(crumbs%triangle(k)), centre(:, owner(k)), position(:, owner(k)))
    end do
    n = count(sums(1, :) > 0.0_wp)
    position = reshape(pack(position, spread(sums(1, :) > 0.0_wp, 1, 3)), [3, n])
    normal = reshape(pack(direction, spread(sums(1, :) > 0.0_wp, 1, 3)), [3, n])
    area = pack(sums(1, :), sums(1, :) > 0.0_wp)
  end subroutine gather_crumbs

  pure subroutine approach(triangle, centre, position)
    !! Takes the point of a triangle if it is nearer to the centre.
    real(wp), intent(in) :: triangle(3, 3), centre(3)
    real(wp), intent(inout) :: position(3)
    real(wp) :: candidate(3)

    candidate = closest_point(triangle, centre)
    if (position(1) < huge(1.0_wp)) then
      if (norm2(candidate - centre) >= norm2(position - centre)) return
    end if
    position = candidate
  end subroutine approach

  subroutine find_owners(body, crumbs, spacing, centre, direction, owner)
    !! The nearest centre of each crumb, looked for in ever wider rings of cells.
    type(triangles_t), intent(in) :: body
    type(crumbs_t), intent(in) :: crumbs
    real(wp), intent(in) :: spacing
    real(wp), intent(in) :: centre(:, :), direction(:, :)
    integer, intent(inout) :: owner(:)
    real(wp), parameter :: most_cells = 4.0e6_wp
    real(wp) :: low(3), high(3), edge, distance, best
    integer, allocatable :: start(:), entry(:), cell(:)
    integer :: n(3), place(3), k, i, j, l, m, ring, c, total

    low = min(minval(crumbs%middle, dim=2), minval(centre, dim=2))
    high = max(maxval(crumbs%middle, dim=2), maxval(centre, dim=2))
    edge = 0.5_wp*spacing
    do
      edge = 2.0_wp*edge
      if (product((high - low)/edge + 1.0_wp) <= most_cells) exit
    end do
    n = int((high - low)/edge) + 1
    total = size(centre, 2)
    allocate (cell(total), start(product(n) + 1), entry(total))
    start = 0
    do m = 1, total
      place = int((centre(:, m) - low)/edge)
      cell(m) = 1 + place(1) + n(1)*(place(2) + n(2)*place(3))
      start(cell(m)) = start(cell(m)) + 1
    end do
    l = 1
    do c = 1, size(start)
      k = start(c)
      start(c) = l
      l = l + k
    end do
    do m = 1, total
      entry(start(cell(m))) = m
      start(cell(m)) = start(cell(m)) + 1
    end do
    start(2:) = start(:size(start) - 1)
    start(1) = 1
    do k = 1, crumbs%n
      place = int((crumbs%middle(:, k) - low)/edge)
      best = huge(1.0_wp)
      do ring = 0, maxval(n)
        if (best <= (real(ring - 1, wp)*edge)**2 .and. ring > 0) exit
        do l = max(place(3) - ring, 0), min(place(3) + ring, n(3) - 1)
          do j = max(place(2) - ring, 0), min(place(2) + ring, n(2) - 1)
            do i = max(place(1) - ring, 0), min(place(1) + ring, n(1) - 1)
              if (maxval(abs([i, j, l] - place)) /= ring) cycle
              c = 1 + i + n(1)*(j + n(2)*l)
              do m = start(c), start(c + 1) - 1
                distance = sum((centre(:, entry(m)) - crumbs%middle(:, k))**2) + &
                           turn_weight*spacing**2* &
                           (1.0_wp - dot_product(direction(:, entry(m)), &
                                                 body%normal(:, crumbs%triangle(k))))
                if (distance >= best) cycle
                best = distance
                owner(k) = entry(m)
              end do
            end do
          end do
        end do
      end do
    end do
  end subroutine find_owners
end module dosui_triangle_pieces

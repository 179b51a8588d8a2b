!! Which regions touch or almost touch, and what holds and drives the bodies that they make.
!!
!! Samples of all faces look outwards: into another region at once is a contact, into one within a
!! grid spacing a gap that the grid bridges. Bodies are what contacts and gaps join.
module dosui_region_contacts
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_face_pieces, only: face_piece, piece_count, region_faces
  use dosui_name_index, only: name_index_t
  use dosui_scene, only: mechanical_condition_t, scene_t
  use dosui_table, only: table_t
  use dosui_wall, only: wall_t
  use dosui_seeding, only: region_spacing
  use dosui_shapes, only: face_t, region_bounds, shape_contains
  use dosui_sort, only: sort_permutation
  implicit none
  private

  integer(i8), parameter :: most_pieces = 50000_i8   !! samples of a face
  integer, parameter :: looks = 16                   !! outwards, within a grid spacing
  integer, parameter :: halvings = 30                !! of the last look
  real(wp), parameter :: touching = 1.0e-6_wp        !! of a grid spacing [-]
  real(wp), parameter :: least_gap = 0.25_wp         !! of a particle spacing: joined below [-]
  real(wp), parameter :: wedge = 2.0_wp              !! gaps so near to a contact open there [h]
  real(wp), parameter :: independent = 1.0e-3_wp     !! of a normal from those before [-]
  real(wp), parameter :: far_away = 1.0e15_wp        !! in grid spacings
  real(wp), parameter :: driven = 1.0e-3_wp          !! of gravity or of all loads [-]

  type, public :: region_gap_t
    !! The narrowest place between two regions that do not touch there.
    integer :: first = 0, second = 0        !! regions
    real(wp) :: width = 0.0_wp              !! [m]
    real(wp) :: place(ndim) = 0.0_wp        !! [m]
  end type region_gap_t

  type :: body_t
    !! What holds and drives a body.
    integer :: n_held = 0
    real(wp) :: held(ndim, ndim) = 0.0_wp   !! orthonormal directions, the first n_held columns [-]
    real(wp) :: force(ndim) = 0.0_wp        !! of all loads [N]
    real(wp) :: gross = 0.0_wp              !! sum of their sizes [N]
  contains
    procedure :: hold => body_hold
    procedure :: free_part => body_free_part
  end type body_t

  type :: sample_t
    !! A place on a face.
    real(wp) :: position(ndim) = 0.0_wp     !! [m]
    real(wp) :: normal(ndim) = 0.0_wp       !! outward [-]
    real(wp) :: area = 0.0_wp               !! [m2]
  end type sample_t

  type, public :: region_contacts_t
    integer, allocatable :: body(:)         !! of each region: the first region of its body
    real(wp), allocatable :: unheld(:, :)   !! (ndim, region): of a body's first region, the unit
    !! vector along which it is driven, but not held; else 0 [-]
    logical, allocatable :: pulls(:)        !! of each mechanical condition: a load outwards
    type(region_gap_t), allocatable :: gap(:)
    real(wp), allocatable :: cells_across(:)
    !! of each body's first region: grid spacings in its thinnest direction, of those whose ends do
    !! not lie on planes of nodes [-]
    real(wp), allocatable, private :: low(:, :), high(:, :)   !! bounds of the regions [m]
    integer, allocatable, private :: neighbour(:), first_neighbour(:)   !! regions within h
  contains
    procedure :: find => region_contacts_find
  end type region_contacts_t

contains

  subroutine region_contacts_find(self, scene)
    !! Looks at all regions and mechanical conditions of a scene without problems.
    class(region_contacts_t), intent(out) :: self
    type(scene_t), intent(in) :: scene
    type(face_t), allocatable :: faces(:)
    type(body_t), allocatable :: body(:)
    integer :: r, n

    n = size(scene%region)
    self%body = [(r, r=1, n)]
    allocate (self%gap(0), self%unheld(ndim, n))
    allocate (self%pulls(size(scene%mechanical_condition)), source=.false.)
    self%unheld = 0.0_wp
    call find_neighbours(self, scene)
    do r = 1, n
      if (self%first_neighbour(r) == self%first_neighbour(r + 1)) cycle
      call region_faces(scene%region(r), region_spacing(scene, scene%region(r)), faces)
      call look_outwards(self, scene, r, faces)
    end do
    do r = 1, n
      self%body(r) = root(self%body, r)
    end do
    call measure_bodies(self, scene)
    allocate (body(n))
    if (allocated(scene%rigid_wall)) body%n_held = ndim   ! bodies may come to rest on them
    call apply_conditions(self, scene, body)
    do r = 1, n
      if (self%body(r) == r) self%unheld(:, r) = unheld_direction(scene, body(r))
    end do
  end subroutine region_contacts_find

  subroutine measure_bodies(self, scene)
    !! How many cells lie across the bodies.
    type(region_contacts_t), intent(inout) :: self
    type(scene_t), intent(in) :: scene
    real(wp) :: low(ndim), high(ndim)
    logical :: is_turned(ndim)
    integer :: r, other, d

    allocate (self%cells_across(size(scene%region)), source=huge(1.0_wp))
    do r = 1, size(scene%region)
      if (self%body(r) /= r) cycle
      is_turned = .false.
      low = self%low(:, r)
      high = self%high(:, r)
      if (count(self%body == r) == 1 .and. scene%region(r)%shape == 'box') then   ! its own axes
        low = scene%region(r)%box_min
        high = scene%region(r)%box_max
        is_turned = ndim > 1 .and. abs(scene%region(r)%shape_angle) > 0.0_wp
        is_turned(min(2, ndim)) = is_turned(min(2, ndim)) .and. ndim == 2   ! not y
      end if
      do other = r + 1, size(scene%region)
        if (self%body(other) /= r) cycle
        low = min(low, self%low(:, other))
        high = max(high, self%high(:, other))
      end do
      do d = 1, ndim
        if (.not. is_turned(d) .and. is_plane(low(d), d) .and. is_plane(high(d), d)) cycle
        self%cells_across(r) = min(self%cells_across(r), (high(d) - low(d))/scene%grid_spacing)
      end do
    end do

  contains

    pure logical function is_plane(place, direction)
      !! Does a face lie on grid nodes?
      real(wp), intent(in) :: place
      integer, intent(in) :: direction
      real(wp) :: node

      node = (place - scene%grid_origin(direction))/scene%grid_spacing
      is_plane = abs(node - anint(node)) < touching
    end function is_plane
  end subroutine measure_bodies

  subroutine find_neighbours(self, scene)
    !! Regions whose bounds come within a grid spacing of each other, found along the first axis.
    type(region_contacts_t), intent(inout) :: self
    type(scene_t), intent(in) :: scene
    integer, allocatable :: order(:), filled(:)
    integer(i8), allocatable :: column(:)   ! of cells, where a region begins
    integer :: i, j, r, other, n, pass

    n = size(scene%region)
    allocate (self%low(ndim, n), self%high(ndim, n))
    do r = 1, n
      call region_bounds(scene%region(r), self%low(:, r), self%high(:, r))
    end do
    column = int(min((self%low(1, :) - minval(self%low(1, :)))/scene%grid_spacing, far_away), i8)
    call sort_permutation(column, order)
    allocate (self%first_neighbour(n + 1), source=1)
    allocate (filled(n), source=0)
    do pass = 1, 2   ! count, then fill
      do i = 1, n
        r = order(i)
        do j = i + 1, n
          other = order(j)
          if (real(column(other) - column(r), wp)*scene%grid_spacing > &
              self%high(1, r) - self%low(1, r) + 3.0_wp*scene%grid_spacing) exit
          if (any(self%low(:, other) > self%high(:, r) + scene%grid_spacing) .or. &
              any(self%low(:, r) > self%high(:, other) + scene%grid_spacing)) cycle
          if (pass == 2) then
            self%neighbour(self%first_neighbour(r) + filled(r)) = other
            self%neighbour(self%first_neighbour(other) + filled(other)) = r
          end if
          filled([r, other]) = filled([r, other]) + 1
        end do
      end do
      if (pass == 2) exit
      do r = 1, n
        self%first_neighbour(r + 1) = self%first_neighbour(r) + filled(r)
      end do
      allocate (self%neighbour(sum(filled)))
      filled = 0
    end do
  end subroutine find_neighbours

  subroutine look_outwards(self, scene, r, faces)
    !! Contacts and gaps of one region, seen from its faces.
    type(region_contacts_t), intent(inout) :: self
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    type(face_t), intent(in) :: faces(:)
    type(sample_t), allocatable :: sample(:)
    integer, allocatable :: seen(:)        ! region in front of each sample, 0 for none
    real(wp), allocatable :: width(:)      ! of the gap to it, 0: a contact [m]
    real(wp) :: spacing
    integer :: f, k

    spacing = region_spacing(scene, scene%region(r))
    do f = 1, size(faces)
      call take_samples(faces(f), spacing, sample)
      if (.not. allocated(seen)) allocate (seen(0), width(0))
      deallocate (seen, width)
      allocate (seen(size(sample)), width(size(sample)))
      do k = 1, size(sample)
        call look(self, scene, r, sample(k), seen(k), width(k))
        if (seen(k) > 0 .and. width(k) <= least_gap*spacing) width(k) = 0.0_wp
        if (seen(k) > 0) call join(self%body, r, seen(k))
      end do
      do k = 1, size(sample)
        if (seen(k) == 0 .or. .not. width(k) > 0.0_wp) cycle
        if (is_wedge(sample(k))) cycle
        call note_gap(self, r, seen(k), width(k), sample(k)%position)
      end do
    end do

  contains

    pure logical function is_wedge(place)
      !! Does this face touch the region that it sees nearby?
      type(sample_t), intent(in) :: place
      integer :: i

      is_wedge = .false.
      do i = 1, size(sample)
        if (seen(i) == 0 .or. width(i) > 0.0_wp) cycle
        if (norm2(sample(i)%position - place%position) < wedge*scene%grid_spacing) is_wedge = .true.
      end do
    end function is_wedge
  end subroutine look_outwards

  subroutine look(self, scene, r, sample, seen, width)
    !! The first region in front of a place on a face, within a grid spacing.
    type(region_contacts_t), intent(in) :: self
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    type(sample_t), intent(in) :: sample
    integer, intent(out) :: seen        !! 0: none
    real(wp), intent(out) :: width      !! way to it [m]
    real(wp) :: near, far, middle
    integer :: k

    near = touching*scene%grid_spacing
    width = 0.0_wp
    seen = region_at(self, scene, r, sample%position + near*sample%normal)
    if (seen > 0) return
    do k = 1, looks
      far = scene%grid_spacing*real(k, wp)/real(looks, wp)
      if (shape_contains(scene%region(r), sample%position + far*sample%normal, 0.0_wp)) return
      seen = region_at(self, scene, r, sample%position + far*sample%normal)
      if (seen > 0) exit
      near = far
    end do
    if (seen == 0) return
    do k = 1, halvings
      middle = 0.5_wp*(near + far)
      if (region_at(self, scene, r, sample%position + middle*sample%normal) > 0) then
        far = middle
      else
        near = middle
      end if
    end do
    width = far
  end subroutine look

  pure integer function region_at(self, scene, r, position) result(other)
    !! A neighbour of region r that holds a place, 0 for none.
    type(region_contacts_t), intent(in) :: self
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    real(wp), intent(in) :: position(ndim)   !! [m]
    integer :: k

    do k = self%first_neighbour(r), self%first_neighbour(r + 1) - 1
      other = self%neighbour(k)
      if (any(position < self%low(:, other)) .or. any(position > self%high(:, other))) cycle
      if (shape_contains(scene%region(other), position, 0.0_wp)) return
    end do
    other = 0
  end function region_at

  subroutine take_samples(face, spacing, sample)
    !! Middles of a face's pieces; fewer on huge faces.
    type(face_t), intent(in) :: face
    real(wp), intent(in) :: spacing   !! of particles [m]
    type(sample_t), allocatable, intent(out) :: sample(:)
    type(sample_t) :: piece
    real(wp) :: length
    integer(i8) :: k
    integer :: n

    length = spacing
    if (.not. allocated(face%piece_area)) then
      do while (piece_count(face, length) > most_pieces)
        length = 2.0_wp*length
      end do
    end if
    allocate (sample(piece_count(face, length)))
    n = 0
    do k = 1_i8, size(sample, kind=i8)
      call face_piece(face, length, k, piece%position, piece%normal, piece%area)
      if (.not. piece%area > 0.0_wp) cycle
      n = n + 1
      sample(n) = piece
    end do
    sample = sample(:n)
  end subroutine take_samples

  subroutine note_gap(self, first, second, width, place)
    !! Keeps the narrowest place between two regions.
    type(region_contacts_t), intent(inout) :: self
    integer, intent(in) :: first, second
    real(wp), intent(in) :: width         !! [m]
    real(wp), intent(in) :: place(ndim)   !! [m]
    integer :: k

    do k = 1, size(self%gap)
      associate (gap => self%gap(k))
        if (gap%first /= min(first, second) .or. gap%second /= max(first, second)) cycle
        if (width < gap%width) gap = region_gap_t(gap%first, gap%second, width, place)
        return
      end associate
    end do
    self%gap = [self%gap, region_gap_t(min(first, second), max(first, second), width, place)]
  end subroutine note_gap

  pure subroutine join(body, a, b)
    !! Two regions belong to one body.
    integer, intent(inout) :: body(:)
    integer, intent(in) :: a, b
    integer :: i, j

    i = root(body, a)
    j = root(body, b)
    body(max(i, j)) = min(i, j)
  end subroutine join

  pure integer function root(body, region)
    !! The first region of a body.
    integer, intent(in) :: body(:)
    integer, intent(in) :: region

    root = region
    do while (body(root) /= root)
      root = body(root)
    end do
  end function root

  ! ---------------------------------------------------------------- what holds and drives

  subroutine apply_conditions(self, scene, body)
    !! Directions held and forces of all bodies by the mechanical conditions.
    type(region_contacts_t), intent(inout) :: self
    type(scene_t), intent(in) :: scene
    type(body_t), intent(inout) :: body(:)
    type(face_t), allocatable :: faces(:)
    type(name_index_t) :: surfaces, regions
    integer :: c, f, r, s

    call surfaces%add_all(scene%surface%name)
    call regions%add_all(scene%region%name)
    do c = 1, size(scene%mechanical_condition)
      s = surfaces%find(scene%mechanical_condition(c)%surface)
      if (s == 0) cycle
      r = regions%find(scene%surface(s)%region)
      if (r == 0) cycle
      call region_faces(scene%region(r), region_spacing(scene, scene%region(r)), faces)
      do f = 1, size(faces)
        if (scene%surface(s)%face == faces(f)%name .or. &
            scene%surface(s)%face == faces(f)%solid .or. scene%surface(s)%face == 'all') then
          call apply_face(self, scene, c, s, r, faces(f), body(self%body(r)))
        end if
      end do
    end do
  end subroutine apply_conditions

  subroutine apply_face(self, scene, c, s, r, face, body)
    !! One face of a condition's surface.
    type(region_contacts_t), intent(inout) :: self
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: c, s, r         !! condition, surface, region
    type(face_t), intent(in) :: face
    type(body_t), intent(inout) :: body
    type(sample_t), allocatable :: sample(:)
    type(wall_t) :: wall
    real(wp) :: load(ndim), outward
    integer :: k, d

    associate (condition => scene%mechanical_condition(c), surface => scene%surface(s))
      call take_samples(face, region_spacing(scene, scene%region(r)), sample)
      outward = 0.0_wp
      wall = condition%wall()
      do k = 1, size(sample)
        if (any(sample(k)%position < surface%box_min) .or. &
            any(sample(k)%position > surface%box_max)) cycle
        if (wall%holds_all .or. condition%kind == 'absorbing') then
          do d = 1, ndim
            call body%hold(unit_vector(d))
          end do
        else if (wall%holds .and. .not. wall%is_plate()) then
          call body%hold(sample(k)%normal)
        else
          load = load_on(condition, sample(k)%normal)
          outward = outward + dot_product(load, sample(k)%normal)*sample(k)%area
          body%force = body%force + load*sample(k)%area
          body%gross = body%gross + norm2(load)*sample(k)%area
        end if
      end do
      if (.not. allocated(condition%pattern%formula)) then
        if (any(outward*factors(condition%pattern%factor) > 0.0_wp)) self%pulls(c) = .true.
      end if
    end associate
  end subroutine apply_face

  pure function load_on(condition, normal) result(load)
    !! A load per area, before tables and formulas; of a plate in proportion to it [Pa].
    type(mechanical_condition_t), intent(in) :: condition
    real(wp), intent(in) :: normal(ndim)   !! outward [-]
    real(wp) :: load(ndim)

    select case (condition%kind)
    case ('traction')
      load = condition%value
    case ('reservoir')   ! pushes
      load = -normal
    case default   ! a pressure or a plate
      load = -condition%value(1)*normal
    end select
  end function load_on

  pure function factors(table) result(values)
    !! What a table multiplies a value with.
    type(table_t), intent(in) :: table
    real(wp), allocatable :: values(:)

    values = [1.0_wp]
    if (allocated(table%value)) values = table%value
  end function factors

  pure function unit_vector(d) result(vector)
    !! Along an axis.
    integer, intent(in) :: d
    real(wp) :: vector(ndim)

    vector = 0.0_wp
    vector(d) = 1.0_wp
  end function unit_vector

  pure subroutine body_hold(self, direction)
    !! The body cannot move along one more direction.
    class(body_t), intent(inout) :: self
    real(wp), intent(in) :: direction(ndim)   !! unit vector
    real(wp) :: rest(ndim)

    rest = self%free_part(direction)
    if (self%n_held == ndim .or. .not. norm2(rest) > independent) return
    self%n_held = self%n_held + 1
    self%held(:, self%n_held) = rest/norm2(rest)
  end subroutine body_hold

  pure function body_free_part(self, vector) result(free)
    !! The part of a vector along which nothing holds the body.
    class(body_t), intent(in) :: self
    real(wp), intent(in) :: vector(ndim)
    real(wp) :: free(ndim)
    integer :: k

    free = 0.0_wp
    if (self%n_held == ndim) return
    free = vector
    do k = 1, self%n_held
      free = free - dot_product(free, self%held(:, k))*self%held(:, k)
    end do
  end function body_free_part

  pure function unheld_direction(scene, body) result(direction)
    !! Where gravity or loads drive a body that is not held there; 0 if they do not.
    type(scene_t), intent(in) :: scene
    type(body_t), intent(in) :: body
    real(wp) :: direction(ndim)

    direction = body%free_part(scene%gravity)
    if (.not. norm2(direction) > driven*norm2(scene%gravity)) then
      direction = body%free_part(body%force)
      if (.not. norm2(direction) > driven*body%gross) direction = 0.0_wp
    end if
    if (norm2(direction) > 0.0_wp) direction = direction/norm2(direction)
  end function unheld_direction
end module dosui_region_contacts

!! Forces on surfaces of any orientation: tractions, and walls imposed by a penalty.
!!
!! Every surface point spreads its force with linear hats over the corner nodes of its cell. A
!! node that carries too little mass for the area it would serve is left out and the other weights
!! are scaled up, so that loads keep their total and no light node is shot away: an interior wall
!! node has m / a = rho h / 2, and nodes below `light_node` rho h are dropped.
!!
!! A penalty wall is a spring kappa = penalty * modulus / h with a dashpot on the displacement of
!! the surface point against the wall ([Belytschko1991] for the explicit penalty method).
!! Its displacement error is stress / kappa, first order in h. Where facets stand for a smooth
!! surface, walls hold its normals: facets lean, and held one by one they hold all motion.
module dosui_surface_forces
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_keys, only: pack_key
  use dosui_piece_cuts, only: cut_piece, most_cells, square_edges
  use dosui_shape_functions, only: corner_hats
  use dosui_scene, only: mechanical_condition_t
  use dosui_sort, only: binary_search
  use dosui_wall, only: wall_t
  implicit none
  private

  public :: load_traction

  real(wp), parameter :: light_node = 0.1_wp       !! least m / (a rho h) of a loaded node [-]
  real(wp), parameter :: dashpot_ratio = 0.2_wp    !! of critical damping of a wall node [-]

  type, public :: surface_forces_t
    !! Which surface points carry which condition, and how they spread forces over nodes.
    integer :: n_point = 0
    integer :: n_part = 1                      !! cells that a point's piece lies in, at most
    integer, allocatable :: cell(:, :)         !! (n_part, n_point) cell of each part, 0: none
    integer, allocatable :: node(:, :, :)      !! (2**ndim, n_part, n_point) corners of that cell
    real(wp), allocatable :: weight(:, :, :)   !! likewise: share of each node, in all 1 a point [-]
    integer, allocatable :: entry_point(:)     !! surface point of each entry
    integer, allocatable :: entry_condition(:) !! mechanical condition of each entry
    type(wall_t), allocatable :: wall(:)       !! of all conditions
    real(wp), allocatable :: held(:, :)        !! (ndim, n_point) normals that walls hold [-]
    real(wp) :: stiffness = 0.0_wp             !! kappa of penalty walls [Pa/m]
    real(wp) :: damping = 0.0_wp               !! dashpot of penalty walls [Pa s/m]
    integer :: n_dropped = 0                   !! points that found no node with mass
  contains
    procedure :: init => surface_forces_init
    procedure :: apply => surface_forces_apply
    procedure :: press => surface_forces_press
    procedure :: values_of => surface_forces_values_of
    procedure :: point_velocity => surface_forces_point_velocity
    procedure :: has_lifts => surface_forces_has_lifts
    procedure :: lift => surface_forces_lift
    procedure :: react => surface_forces_react
    procedure :: lift_operators => surface_forces_lift_operators
    procedure :: spring => surface_forces_spring
    procedure :: forget => surface_forces_forget
  end type surface_forces_t

contains

  subroutine surface_forces_init(self, comm, conditions, grid, n_point, cell, position, normal, &
                                 area, mass, density, modulus, penalty, handled, is_filled, &
                                 held, edge)
    !! Computes the weights of all surface points from the nodal masses at hand. Collective.
    !!
    !! With `is_filled` a point stands for parts of its piece of surface, one in each cell that the
    !! piece lies in, with the hats of that cell (`dosui_piece_cuts`): the integral over the surface
    !! then fits the integrals over cut cells.
    class(surface_forces_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(mechanical_condition_t), intent(in) :: conditions(:)
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n_point
    integer, intent(in) :: cell(n_point)              !! cell of each surface point, 0: none
    real(wp), intent(in) :: position(ndim, n_point)   !! [m]
    real(wp), intent(in) :: normal(ndim, n_point)     !! outward [-]
    real(wp), intent(in) :: area(n_point)             !! [m2, m per m in 2-D, 1 in 1-D]
    real(wp), intent(in) :: mass(grid%n_node)         !! complete nodal masses [kg]
    real(wp), intent(in) :: density                   !! reference density of the body [kg/m3]
    real(wp), intent(in) :: modulus                   !! that walls resist [Pa]
    real(wp), intent(in) :: penalty                   !! wall stiffness factor [-]
    logical, intent(in) :: handled(:, :)              !! (conditions, points) entries to be made
    logical, intent(in), optional :: is_filled(grid%n_cell)
    !! cells with a part of the body: these cut the pieces
    real(wp), intent(in), optional :: held(ndim, n_point)
    !! normals of the smooth surfaces that facets stand for; absent: they are the facets' [-]
    real(wp), intent(in), optional :: edge(ndim, max(ndim - 1, 1), n_point)
    !! that span the pieces; 0 or absent: they are squares [m]
    real(wp), allocatable :: served(:, :)
    logical, allocatable :: usable(:)
    integer :: p, c, k

    self%wall = conditions%wall()
    self%n_point = n_point
    self%n_part = 1
    self%held = normal
    if (present(held)) self%held = held
    self%stiffness = penalty*modulus/grid%spacing
    self%damping = dashpot_ratio*sqrt(self%stiffness*density*grid%spacing)
    self%entry_point = pack([((p, c=1, size(handled, 1)), p=1, n_point)], &
                            reshape(handled, [size(handled)]))
    self%entry_condition = pack([((c, c=1, size(handled, 1)), p=1, n_point)], &
                                reshape(handled, [size(handled)]))
    self%n_dropped = 0
    if (allocated(self%weight)) deallocate (self%weight, self%node, self%cell)
    if (present(is_filled)) then
      call cut_pieces(self, grid, cell, is_filled, position, normal, area, edge)
      return
    end if
    allocate (self%weight(2**ndim, self%n_part, n_point), source=0.0_wp)
    allocate (self%node(2**ndim, self%n_part, n_point), self%cell(self%n_part, n_point), source=0)
    allocate (served(1, grid%n_node), source=0.0_wp)
    do p = 1, n_point
      self%cell(1, p) = cell(p)
      if (cell(p) == 0) cycle
      self%node(:, 1, p) = grid%cell_node(:, cell(p))
      self%weight(:, 1, p) = hat_weights(position(:, p), grid, cell(p))
      served(1, self%node(:, 1, p)) = served(1, self%node(:, 1, p)) + self%weight(:, 1, p)*area(p)
    end do
    call grid%node_map%sum_copies(comm, 1, served)

    usable = mass >= light_node*density*grid%spacing*served(1, :) .and. mass > 0.0_wp
    do p = 1, n_point
      do k = 1, self%n_part
        if (self%cell(k, p) == 0) cycle
        call keep_usable(self%node(:, k, p), usable, mass, self%weight(:, k, p))
      end do
      if (.not. any(abs(self%weight(:, :, p)) > 0.0_wp) .and. any(handled(:, p)) .and. &
          cell(p) > 0) self%n_dropped = self%n_dropped + 1
    end do
  end subroutine surface_forces_init

  subroutine cut_pieces(self, grid, cell, is_filled, position, normal, area, edge)
    !! Parts of all pieces. What lies beyond the body's cells, as flat pieces of bent faces may,
    !! stays with the point's cell: nothing else holds the nodes there.
    class(surface_forces_t), intent(inout) :: self
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell(:)
    logical, intent(in) :: is_filled(:)
    real(wp), intent(in) :: position(:, :), normal(:, :), area(:)
    real(wp), intent(in), optional :: edge(:, :, :)
    integer, allocatable :: base(:, :)
    real(wp), allocatable :: weight(:, :)
    real(wp) :: span(ndim, max(ndim - 1, 1)), place(ndim)
    integer :: p, k, n, pass, most

    most = 1
    do pass = 1, 2   ! counts, then fills
      do p = 1, self%n_point
        if (cell(p) == 0) cycle
        span = 0.0_wp
        if (present(edge)) span = edge(:, :, p)
        if (.not. any(abs(span) > 0.0_wp)) call square_edges(normal(:, p), area(p), span)
        span = span/grid%spacing
        place = (position(:, p) - grid%origin)/grid%spacing
        if (pass == 1) then
          most = max(most, most_cells(place, normal(:, p), span))
          cycle
        end if
        call cut_piece(place, normal(:, p), span, n, base, weight)
        do k = 1, n
          self%cell(k, p) = binary_search(grid%cell_key, pack_key(base(:, k)))
          if (self%cell(k, p) > 0) then
            if (.not. is_filled(self%cell(k, p))) self%cell(k, p) = 0
          end if
          if (self%cell(k, p) == 0) then
            self%cell(k, p) = cell(p)
            weight(:, k) = sum(weight(:, k))*hat_weights(position(:, p), grid, cell(p))
          end if
          self%node(:, k, p) = grid%cell_node(:, self%cell(k, p))
          self%weight(:, k, p) = weight(:, k)
        end do
      end do
      if (pass == 2) exit
      self%n_part = most
      allocate (base(ndim, most), weight(2**ndim, most))
      allocate (self%weight(2**ndim, most, self%n_point), source=0.0_wp)
      allocate (self%node(2**ndim, most, self%n_point), self%cell(most, self%n_point), source=0)
    end do
  end subroutine cut_pieces

  pure function hat_weights(position, grid, cell) result(weight)
    !! Linear hats of a cell's corner nodes (x fastest) at a position; they go on into parts of
    !! neighbouring cells that belong to this one [-].
    real(wp), intent(in) :: position(ndim)   !! [m]
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    real(wp) :: weight(2**ndim)

    weight = corner_hats((position - grid%origin)/grid%spacing - &
                         real(grid%cell_base(:, cell), wp))
  end function hat_weights

  pure subroutine keep_usable(node, usable, mass, weight)
    !! Drops the weights of unusable nodes and scales the others to a sum of 1. If none is left,
    !! the heaviest node takes all: no load is lost while the point's cell holds any mass.
    integer, intent(in) :: node(2**ndim)
    logical, intent(in) :: usable(:)
    real(wp), intent(in) :: mass(:)            !! nodal masses [kg]
    real(wp), intent(inout) :: weight(2**ndim)
    integer :: heaviest

    where (.not. usable(node)) weight = 0.0_wp
    if (sum(weight) > 1.0e-6_wp) then
      weight = weight*(1.0_wp/sum(weight))
    else
      weight = 0.0_wp
      heaviest = maxloc(mass(node), dim=1)
      if (mass(node(heaviest)) > 0.0_wp) weight(heaviest) = 1.0_wp
    end if
  end subroutine keep_usable

  subroutine surface_forces_apply(self, comm, conditions, time, area, position, normal, &
                                  displacement, velocity, force, only)
    !! Adds the forces of tractions and walls to the nodal forces. Collective when a plate is
    !! imposed by penalty: the plate's displacement follows from its equilibrium.
    class(surface_forces_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(mechanical_condition_t), intent(in) :: conditions(:)
    real(wp), intent(in) :: time                                 !! [s]
    real(wp), intent(in) :: area(self%n_point)                   !! [m2]
    real(wp), intent(in) :: position(ndim, self%n_point)         !! of the surface points [m]
    real(wp), intent(in) :: normal(ndim, self%n_point)           !! outward [-]
    real(wp), intent(in) :: displacement(ndim, self%n_point)     !! of the surface points [m]
    real(wp), intent(in) :: velocity(ndim, self%n_point)         !! of the surface points [m/s]
    real(wp), intent(inout) :: force(:, :)                       !! (ndim, n_node) nodal forces [N]
    integer, intent(in), optional :: only                        !! one of the conditions
    real(wp), allocatable :: plate_displacement(:)
    real(wp) :: traction(ndim)
    integer :: e, p, c, k

    allocate (plate_displacement(size(conditions)))
    call solve_plates(self, comm, time, area, displacement, plate_displacement)
    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      c = self%entry_condition(e)
      if (present(only)) then
        if (c /= only) cycle
      end if
      if (self%wall(c)%holds) then
        traction = wall_traction(self, self%wall(c), time, self%held(:, p), displacement(:, p), &
                                 velocity(:, p), plate_displacement(c))
      else
        traction = load_traction(conditions(c), time, position(:, p), normal(:, p), velocity(:, p))
      end if
      do k = 1, self%n_part
        call spread_load(self, k, p, area(p)*traction, force)
      end do
    end do
  end subroutine surface_forces_apply

  pure subroutine spread_load(self, part, point, load, force)
    !! Adds a point's load on one of its parts to the nodes.
    class(surface_forces_t), intent(in) :: self
    integer, intent(in) :: part, point
    real(wp), intent(in) :: load(ndim)           !! as if on the whole point [N]
    real(wp), intent(inout) :: force(:, :)       !! (ndim, n_node) [N]
    integer :: i, node

    do i = 1, 2**ndim
      node = self%node(i, part, point)
      if (node > 0) force(:, node) = force(:, node) + self%weight(i, part, point)*load
    end do
  end subroutine spread_load

  pure subroutine surface_forces_press(self, area, normal, pressure, force)
    !! Adds the forces of pressures at the surface points to the nodal forces.
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: area(self%n_point)           !! [m2]
    real(wp), intent(in) :: normal(ndim, self%n_point)   !! outward [-]
    real(wp), intent(in) :: pressure(self%n_point)       !! into the body [Pa]
    real(wp), intent(inout) :: force(:, :)               !! (ndim, n_node) [N]
    integer :: p, k

    do p = 1, self%n_point
      if (.not. abs(pressure(p)) > 0.0_wp) cycle
      do k = 1, self%n_part
        call spread_load(self, k, p, -pressure(p)*area(p)*normal(:, p), force)
      end do
    end do
  end subroutine surface_forces_press

  pure subroutine surface_forces_values_of(self, nodal, values)
    !! A nodal field at the surface points, by the weights that forces are spread with. Points
    !! without a cell get 0.
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: nodal(:)                  !! (n_node) [any unit]
    real(wp), intent(out) :: values(self%n_point)   !! [unit of the nodal field]
    integer :: i, k, p

    values = 0.0_wp
    do p = 1, self%n_point
      do k = 1, self%n_part
        do i = 1, 2**ndim
          if (self%node(i, k, p) == 0) cycle
          values(p) = values(p) + self%weight(i, k, p)*nodal(self%node(i, k, p))
        end do
      end do
    end do
  end subroutine surface_forces_values_of

  pure function part_velocity(self, part, point, nodal_velocity) result(velocity)
    !! Share of one part in the velocity of a point [m/s].
    class(surface_forces_t), intent(in) :: self
    integer, intent(in) :: part, point
    real(wp), intent(in) :: nodal_velocity(:, :)   !! (ndim, n_node) [m/s]
    real(wp) :: velocity(ndim)
    integer :: i, node

    velocity = 0.0_wp
    do i = 1, 2**ndim
      node = self%node(i, part, point)
      if (node > 0) velocity = velocity + self%weight(i, part, point)*nodal_velocity(:, node)
    end do
  end function part_velocity

  pure function wall_traction(self, wall, time, normal, displacement, velocity, &
                              plate_displacement) result(traction)
    !! Traction of a wall's spring and dashpot on the body at a surface point [Pa].
    class(surface_forces_t), intent(in) :: self
    type(wall_t), intent(in) :: wall
    real(wp), intent(in) :: time                                 !! [s]
    real(wp), intent(in) :: normal(ndim)                         !! that the wall holds [-]
    real(wp), intent(in) :: displacement(ndim), velocity(ndim)   !! of the point [m], [m/s]
    real(wp), intent(in) :: plate_displacement                   !! along the normal [m]
    real(wp) :: traction(ndim)

    if (wall%is_plate()) then
      traction = self%stiffness*(plate_displacement - dot_product(displacement, normal))*normal
    else
      traction = self%stiffness*wall%held(wall%way(0.0_wp, time, normal) - displacement, normal) + &
                 self%damping*wall%held(wall%velocity(time, normal) - velocity, normal)
    end if
  end function wall_traction

  pure function load_traction(condition, time, position, normal, velocity) result(traction)
    !! Traction that a given load puts on the body at a surface point, and what absorbs waves [Pa].
    type(mechanical_condition_t), intent(in) :: condition   !! no wall
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(in) :: position(ndim)   !! of the point [m]
    real(wp), intent(in) :: normal(ndim)     !! outward [-]
    real(wp), intent(in), optional :: velocity(ndim)   !! of the point; absent: at rest [m/s]
    real(wp) :: traction(ndim)

    select case (condition%kind)
    case ('traction')
      traction = condition%value*condition%pattern%at(position, time)
    case ('absorbing')
      traction = 0.0_wp
      if (present(velocity)) traction = &
        -condition%impedance(2)*velocity - &
        (condition%impedance(1) - condition%impedance(2))*dot_product(velocity, normal)*normal
    case default   ! pressure, reservoir
      traction = -condition%pressure_at(time, position)*normal
    end select
  end function load_traction

  subroutine solve_plates(self, comm, time, area, displacement, plate_displacement)
    !! Normal displacement U of each penalty plate from sum kappa a (U - u_n) = -F [m].
    class(surface_forces_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: time                               !! [s]
    real(wp), intent(in) :: area(self%n_point)                 !! [m2]
    real(wp), intent(in) :: displacement(ndim, self%n_point)   !! [m]
    real(wp), intent(out) :: plate_displacement(size(self%wall))
    real(wp) :: sums(2*size(self%wall))
    integer :: e, p, c

    plate_displacement = 0.0_wp
    if (.not. any(self%wall%is_plate())) return
    sums = 0.0_wp
    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      c = self%entry_condition(e)
      if (.not. self%wall(c)%is_plate()) cycle
      sums(2*c - 1) = sums(2*c - 1) + self%stiffness*area(p)
      sums(2*c) = sums(2*c) + self%stiffness*area(p)* &
                  dot_product(displacement(:, p), self%held(:, p))
    end do
    call comm%sum_array(sums)
    do c = 1, size(self%wall)
      if (.not. sums(2*c - 1) > 0.0_wp) cycle
      plate_displacement(c) = (sums(2*c) - self%wall(c)%force(time))/sums(2*c - 1)
    end do
  end subroutine solve_plates

  pure logical function is_lifted(self, condition)
    !! Walls whose motion is known: all but plates.
    class(surface_forces_t), intent(in) :: self
    integer, intent(in) :: condition

    is_lifted = self%wall(condition)%holds .and. .not. self%wall(condition)%is_plate()
  end function is_lifted

  pure logical function surface_forces_has_lifts(self) result(has)
    !! Are there penalty walls that `lift` sees on this rank?
    class(surface_forces_t), intent(in) :: self
    integer :: e

    has = .false.
    do e = 1, size(self%entry_point)
      if (is_lifted(self, self%entry_condition(e))) has = .true.
    end do
  end function surface_forces_has_lifts

  pure subroutine surface_forces_lift(self, time, at_rest, area, normal, nodal_velocity, lift)
    !! Takes the motion relative to penalty walls out of the cells' strains: adds
    !! - sum a sym((v - v_wall) x n), to be divided by the cell's measure [m3/s]. The penalty then
    !! only has to keep the wall in place; the wall's reaction is that of the stress (`react`, the
    !! adjoint), which makes the condition consistent (Nitsche's method in the lifted form of
    !! [Brezzi2000]).
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: time                               !! [s]
    logical, intent(in) :: at_rest                             !! walls do not move
    real(wp), intent(in) :: area(self%n_point)                 !! [m2]
    real(wp), intent(in) :: normal(ndim, self%n_point)         !! outward [-]
    real(wp), intent(in) :: nodal_velocity(:, :)               !! (ndim, n_node) [m/s]
    real(wp), intent(inout) :: lift(:, :)                      !! (nsig, n_cell), 2 x shear [m3/s]
    real(wp) :: slip(ndim)
    integer :: e, p, c, a, b, k, cell

    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      c = self%entry_condition(e)
      if (.not. is_lifted(self, c)) cycle
      do k = 1, self%n_part
        cell = self%cell(k, p)
        if (cell == 0) cycle
        slip = part_velocity(self, k, p, nodal_velocity)
        if (.not. at_rest) slip = slip - self%wall(c)%velocity(time, self%held(:, p))* &
                                  sum(self%weight(:, k, p))
        slip = self%wall(c)%held(slip, self%held(:, p))
        do b = 1, ndim
          do a = 1, ndim
            lift(voigt_slot(a, b), cell) = lift(voigt_slot(a, b), cell) - &
                                           area(p)*slip(a)*normal(b, p)
          end do
        end do
      end do
    end do
  end subroutine surface_forces_lift

  pure subroutine surface_forces_lift_operators(self, area, normal, lift)
    !! The matrices of `lift`: adds what they make of the displacements of a cell's corners, corner
    !! by corner, to be divided by the cell's measure [m2].
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: area(self%n_point)             !! [m2]
    real(wp), intent(in) :: normal(ndim, self%n_point)     !! outward [-]
    real(wp), intent(inout) :: lift(:, :)                  !! (nsig*ndim*2**ndim, n_cell) [m2]
    real(wp) :: slip(ndim)
    integer :: e, p, c, a, b, d, i, k, cell, place

    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      c = self%entry_condition(e)
      if (.not. is_lifted(self, c)) cycle
      do k = 1, self%n_part
        cell = self%cell(k, p)
        if (cell == 0) cycle
        do i = 1, 2**ndim
          do d = 1, ndim
            slip = 0.0_wp
            slip(d) = self%weight(i, k, p)
            slip = self%wall(c)%held(slip, self%held(:, p))
            do b = 1, ndim
              do a = 1, ndim
                place = nsig*(ndim*(i - 1) + d - 1) + voigt_slot(a, b)
                lift(place, cell) = lift(place, cell) - area(p)*slip(a)*normal(b, p)
              end do
            end do
          end do
        end do
      end do
    end do
  end subroutine surface_forces_lift_operators

  subroutine surface_forces_spring(self, entry, area, node, weight, spring)
    !! The spring of one entry: force on node i per displacement of node j is
    !! - weight(i)*weight(j)*spring. No nodes for entries that are loads.
    class(surface_forces_t), intent(in) :: self
    integer, intent(in) :: entry
    real(wp), intent(in) :: area(self%n_point)              !! [m2]
    integer, allocatable, intent(out) :: node(:)
    real(wp), allocatable, intent(out) :: weight(:)         !! [-]
    real(wp), intent(out) :: spring(ndim, ndim)             !! [N/m]
    real(wp) :: along(ndim)
    integer :: p, a, i, k, place

    allocate (node(0), weight(0))
    spring = 0.0_wp
    p = self%entry_point(entry)
    if (.not. self%wall(self%entry_condition(entry))%holds) return
    do k = 1, self%n_part
      do i = 1, 2**ndim
        if (self%node(i, k, p) == 0) cycle
        place = findloc(node, self%node(i, k, p), dim=1)
        if (place == 0) then
          node = [node, self%node(i, k, p)]
          weight = [weight, 0.0_wp]
          place = size(node)
        end if
        weight(place) = weight(place) + self%weight(i, k, p)
      end do
    end do
    do a = 1, ndim
      along = 0.0_wp
      along(a) = self%stiffness*area(p)
      spring(:, a) = self%wall(self%entry_condition(entry))%held(along, self%held(:, p))
    end do
  end subroutine surface_forces_spring

  pure subroutine surface_forces_forget(self, displacement)
    !! Sets displacements to zero, but for what springs of walls need: it is their force.
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(inout) :: displacement(ndim, self%n_point)   !! of the surface points [m]
    real(wp) :: kept(ndim, self%n_point)
    integer :: e, p

    kept = 0.0_wp
    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      associate (wall => self%wall(self%entry_condition(e)))
        if (wall%holds) kept(:, p) = wall%held(displacement(:, p), self%held(:, p))
      end associate
    end do
    displacement = kept
  end subroutine surface_forces_forget

  pure subroutine surface_forces_react(self, area, normal, stress, force, only)
    !! Adds the walls' reactions to the mean stresses of their cells: the adjoint of `lift`.
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: area(self%n_point)            !! [m2]
    real(wp), intent(in) :: normal(ndim, self%n_point)    !! outward [-]
    real(wp), intent(in) :: stress(:, :)                  !! (nsig, n_cell) total [Pa]
    real(wp), intent(inout) :: force(:, :)                !! (ndim, n_node) nodal forces [N]
    integer, intent(in), optional :: only                 !! one of the conditions
    real(wp) :: traction(ndim)
    integer :: e, p, c, a, b, k

    do e = 1, size(self%entry_point)
      p = self%entry_point(e)
      c = self%entry_condition(e)
      if (present(only)) then
        if (c /= only) cycle
      end if
      if (.not. is_lifted(self, c)) cycle
      do k = 1, self%n_part
        if (self%cell(k, p) == 0) cycle
        traction = 0.0_wp
        do b = 1, ndim
          do a = 1, ndim
            traction(a) = traction(a) + stress(voigt_slot(a, b), self%cell(k, p))*normal(b, p)
          end do
        end do
        traction = self%wall(c)%held(traction, self%held(:, p))
        call spread_load(self, k, p, area(p)*traction, force)
      end do
    end do
  end subroutine surface_forces_react

  pure subroutine surface_forces_point_velocity(self, nodal_velocity, velocity)
    !! Velocity of the surface points, interpolated with the same weights [m/s].
    class(surface_forces_t), intent(in) :: self
    real(wp), intent(in) :: nodal_velocity(:, :)             !! (ndim, n_node) [m/s]
    real(wp), intent(out) :: velocity(ndim, self%n_point)    !! [m/s]
    integer :: p, k

    velocity = 0.0_wp
    do p = 1, self%n_point
      do k = 1, self%n_part
        velocity(:, p) = velocity(:, p) + part_velocity(self, k, p, nodal_velocity)
      end do
    end do
  end subroutine surface_forces_point_velocity
end module dosui_surface_forces

!! Mechanical conditions imposed on grid nodes, for surfaces that lie on planes of grid nodes.
!!
!! A surface point qualifies when its normal is a coordinate direction and its plane holds grid
!! nodes; the corner nodes of its cell on that plane, at most half a cell away, are then
!! constrained, and those further away that no other surface's points on the plane are beside: a
!! face may end within a cell. All other points are left to the penalty walls of
!! `dosui_surface_forces`.
module dosui_nodal_conditions
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_scene, only: mechanical_condition_t
  use dosui_wall, only: wall_t
  implicit none
  private

  public :: point_on_grid_plane

  real(wp), parameter :: plane_tolerance = 1.0e-6_wp   !! of the grid spacing [-]

  type, public :: nodal_conditions_t
    !! Constrained node components, and rigid plates: sets of nodes with one normal velocity.
    integer :: n_constraint = 0
    integer, allocatable :: node(:)            !! constrained node of each constraint
    integer, allocatable :: direction(:)       !! its constrained component
    integer, allocatable :: condition(:)       !! the mechanical condition it comes from
    real(wp), allocatable :: outward(:)        !! sign of the surface's outward normal [-]
    logical, allocatable :: plate(:)           !! constraint belongs to a rigid plate
    logical, allocatable :: faces(:)           !! its surface faces the constrained direction
    integer, allocatable :: plate_condition(:) !! conditions that are plates on nodes
    type(wall_t), allocatable :: wall(:)       !! of all conditions
  contains
    procedure :: init => nodal_conditions_init
    procedure :: apply => nodal_conditions_apply
    procedure :: prescribe => nodal_conditions_prescribe
    procedure :: way => nodal_conditions_way
    procedure :: holders => nodal_conditions_holders
    procedure :: bars => nodal_conditions_bars
  end type nodal_conditions_t

contains

  pure logical function point_on_grid_plane(position, normal, origin, spacing) result(on_plane)
    !! Does a surface point lie on a plane of grid nodes that is normal to its own normal?
    real(wp), intent(in) :: position(ndim)   !! of the point [m]
    real(wp), intent(in) :: normal(ndim)     !! outward unit normal [-]
    real(wp), intent(in) :: origin(ndim)     !! of the grid [m]
    real(wp), intent(in) :: spacing          !! of the grid [m]
    real(wp) :: plane
    integer :: direction

    direction = maxloc(abs(normal), dim=1)
    plane = (position(direction) - origin(direction))/spacing
    on_plane = abs(normal(direction)) > 1.0_wp - plane_tolerance .and. &
               abs(plane - anint(plane)) < plane_tolerance
  end function point_on_grid_plane

  subroutine nodal_conditions_init(self, comm, conditions, grid, n_point, cell, position, normal, &
                                   handled)
    !! Finds the constrained nodes. Collective, because nodes are shared between ranks.
    class(nodal_conditions_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(mechanical_condition_t), intent(in) :: conditions(:)
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n_point
    integer, intent(in) :: cell(n_point)              !! cell that holds each surface point, 0: none
    real(wp), intent(in) :: position(ndim, n_point)   !! of the surface points [m]
    real(wp), intent(in) :: normal(ndim, n_point)     !! outward unit normals [-]
    logical, intent(in) :: handled(size(conditions), n_point)
    !! point belongs to the condition and the condition is imposed on nodes there
    real(wp), allocatable :: mark(:, :), beside(:, :), own(:, :)
    integer :: c, p, direction, k

    if (allocated(self%node)) deallocate (self%node, self%direction, self%condition, &
                                          self%outward, self%plate, self%faces, &
                                          self%plate_condition)
    allocate (self%node(0), self%direction(0), self%condition(0), self%outward(0), self%plate(0), &
              self%faces(0))
    self%n_constraint = 0
    self%wall = conditions%wall()
    self%plate_condition = pack([(c, c=1, size(conditions))], self%wall%is_plate())
    allocate (mark(ndim, grid%n_node), beside(ndim, grid%n_node), own(ndim, grid%n_node))
    beside = 0.0_wp
    do p = 1, n_point
      if (cell(p) == 0) cycle
      if (.not. point_on_grid_plane(position(:, p), normal(:, p), grid%origin, grid%spacing)) cycle
      call mark_nodes(grid, cell(p), position(:, p), normal(:, p), 1.0_wp, beside)
    end do
    call grid%node_map%sum_copies(comm, ndim, beside)
    do c = 1, size(conditions)
      if (.not. self%wall(c)%holds) cycle
      mark = 0.0_wp
      own = 0.0_wp
      do p = 1, n_point
        if (.not. handled(c, p) .or. cell(p) == 0) cycle
        call mark_nodes(grid, cell(p), position(:, p), normal(:, p), 0.5_wp, mark)
        call mark_nodes(grid, cell(p), position(:, p), normal(:, p), 1.0_wp, own)
      end do
      call grid%node_map%sum_copies(comm, ndim, mark)
      call grid%node_map%sum_copies(comm, ndim, own)
      where (abs(own - beside) < 0.5_wp) mark = own
      do direction = 1, ndim
        call add_constraints(self, c, direction, &
                             pack([(k, k=1, grid%n_node)], abs(mark(direction, :)) > 0.5_wp), mark)
      end do
    end do
  end subroutine nodal_conditions_init

  subroutine mark_nodes(grid, cell, position, normal, reach, mark)
    !! Marks the nodes of a cell that lie on a surface point's plane, within a reach of it.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    real(wp), intent(in) :: position(ndim)
    real(wp), intent(in) :: normal(ndim)
    real(wp), intent(in) :: reach           !! in cells [-]
    real(wp), intent(inout) :: mark(:, :)   !! sign of the normal, summed over points
    real(wp) :: distance(ndim)
    integer :: corner, node, direction

    direction = maxloc(abs(normal), dim=1)
    do corner = 1, 2**ndim
      node = grid%cell_node(corner, cell)
      distance = abs((position - grid%origin)/grid%spacing &
                     - real(grid%corner_index(corner, cell), wp))
      if (distance(direction) > plane_tolerance) cycle
      if (any(distance > reach + plane_tolerance)) cycle
      mark(direction, node) = mark(direction, node) + sign(1.0_wp, normal(direction))
    end do
  end subroutine mark_nodes

  subroutine add_constraints(self, condition, direction, nodes, mark)
    !! Appends the constraints of one condition and surface direction.
    class(nodal_conditions_t), intent(inout) :: self
    integer, intent(in) :: condition, direction
    integer, intent(in) :: nodes(:)
    real(wp), intent(in) :: mark(:, :)
    integer :: component, k

    do component = 1, ndim
      if (component /= direction .and. .not. self%wall(condition)%holds_all) cycle
      self%node = [self%node, nodes]
      self%direction = [self%direction, spread(component, 1, size(nodes))]
      self%condition = [self%condition, spread(condition, 1, size(nodes))]
      self%outward = [self%outward, &
                      [(sign(1.0_wp, mark(direction, nodes(k))), k=1, size(nodes))]]
      self%plate = [self%plate, spread(self%wall(condition)%is_plate(), 1, size(nodes))]
      self%faces = [self%faces, spread(component == direction, 1, size(nodes))]
    end do
    self%n_constraint = size(self%node)
  end subroutine add_constraints

  subroutine nodal_conditions_apply(self, comm, grid, time, dt, mass, velocity_old, velocity, &
                                    at_rest)
    !! Overwrites the constrained components of the nodal velocities before and after the step.
    !!
    !! A plate's nodes share V with (sum m) dV/dt = sum f - F, all along the outward normal: the
    !! nodal velocities already hold sum f, so V = (sum m v - dt F) / sum m.
    class(nodal_conditions_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: time                          !! at the end of the step [s]
    real(wp), intent(in) :: dt                            !! [s]
    real(wp), intent(in) :: mass(grid%n_node)             !! nodal mass [kg]
    real(wp), intent(inout) :: velocity_old(ndim, grid%n_node)   !! before the step [m/s]
    real(wp), intent(inout) :: velocity(ndim, grid%n_node)       !! after the step [m/s]
    logical, intent(in), optional :: at_rest      !! prescribed velocities are zero
    real(wp), allocatable :: sums(:)
    real(wp) :: prescribed
    integer :: k, c, slot

    allocate (sums(3*size(self%plate_condition)), source=0.0_wp)
    do k = 1, self%n_constraint
      if (.not. self%plate(k) .or. .not. grid%node_map%is_owned(self%node(k))) cycle
      slot = 3*(findloc(self%plate_condition, self%condition(k), dim=1) - 1)
      sums(slot + 1) = sums(slot + 1) + mass(self%node(k))
      sums(slot + 2) = sums(slot + 2) + mass(self%node(k))*self%outward(k)* &
                       velocity_old(self%direction(k), self%node(k))
      sums(slot + 3) = sums(slot + 3) + mass(self%node(k))*self%outward(k)* &
                       velocity(self%direction(k), self%node(k))
    end do
    if (size(sums) > 0) call comm%sum_array(sums)
    do k = 1, self%n_constraint
      c = self%condition(k)
      if (self%plate(k)) then
        slot = 3*(findloc(self%plate_condition, c, dim=1) - 1)
        velocity_old(self%direction(k), self%node(k)) = self%outward(k)*sums(slot + 2)/ &
                                                        sums(slot + 1)
        prescribed = self%outward(k)*(sums(slot + 3) - dt*self%wall(c)%force(time))/sums(slot + 1)
        velocity(self%direction(k), self%node(k)) = prescribed
        cycle
      end if
      prescribed = component(self%wall(c)%velocity(time, facing(self, k)), self%direction(k))
      if (present(at_rest)) prescribed = merge(0.0_wp, prescribed, at_rest)
      velocity_old(self%direction(k), self%node(k)) = prescribed
      velocity(self%direction(k), self%node(k)) = prescribed
    end do
  end subroutine nodal_conditions_apply

  pure function facing(self, constraint) result(normal)
    !! Outward normal of a wall that faces the constrained direction [-].
    class(nodal_conditions_t), intent(in) :: self
    integer, intent(in) :: constraint
    real(wp) :: normal(ndim)

    normal = 0.0_wp
    normal(self%direction(constraint)) = self%outward(constraint)
  end function facing

  pure real(wp) function nodal_conditions_way(self, constraint, from, to) result(way)
    !! Displacement of a constrained component between two times; 0 on plates [m].
    class(nodal_conditions_t), intent(in) :: self
    integer, intent(in) :: constraint
    real(wp), intent(in) :: from, to   !! [s]

    associate (wall => self%wall(self%condition(constraint)))
      way = component(wall%way(from, to, facing(self, constraint)), self%direction(constraint))
    end associate
  end function nodal_conditions_way

  pure real(wp) function component(vector, direction)
    !! One of a vector's components [unit of the vector].
    real(wp), intent(in) :: vector(ndim)   !! [any unit]
    integer, intent(in) :: direction

    component = vector(direction)
  end function component

  pure subroutine nodal_conditions_prescribe(self, time, at_rest, is_held, velocity, plate)
    !! The same conditions as values, for nodes that do not move by themselves. Those on plates have
    !! the sign of the plate's outward normal in place of its velocity.
    class(nodal_conditions_t), intent(in) :: self
    real(wp), intent(in) :: time              !! at the end of the step [s]
    logical, intent(in) :: at_rest            !! prescribed velocities are zero
    logical, intent(out) :: is_held(:, :)     !! (ndim, n_node)
    real(wp), intent(out) :: velocity(:, :)   !! (ndim, n_node) 0 where nothing holds [m/s]
    integer, intent(out) :: plate(:, :)       !! (ndim, n_node) which of the plates, 0: none
    integer :: c, k

    is_held = .false.
    velocity = 0.0_wp
    plate = 0
    do k = 1, self%n_constraint
      c = self%condition(k)
      associate (a => self%direction(k), i => self%node(k))
        is_held(a, i) = .true.
        plate(a, i) = 0
        velocity(a, i) = 0.0_wp
        if (self%plate(k)) then
          plate(a, i) = findloc(self%plate_condition, c, dim=1)
          velocity(a, i) = self%outward(k)
        else if (.not. at_rest) then
          velocity(a, i) = component(self%wall(c)%velocity(time, facing(self, k)), a)
        end if
      end associate
    end do
  end subroutine nodal_conditions_prescribe

  pure subroutine nodal_conditions_holders(self, holder)
    !! Which constraint takes the force on each component of the nodes. Of two at rest it is that
    !! of the surface that faces the component, else the later one, which is in force.
    class(nodal_conditions_t), intent(in) :: self
    integer, intent(out) :: holder(:, :)   !! (ndim, n_node) constraint, 0: none
    integer :: k

    holder = 0
    do k = 1, self%n_constraint
      associate (before => holder(self%direction(k), self%node(k)))
        if (before > 0) then
          if (self%faces(before) .and. .not. self%faces(k) .and. rests(before) .and. rests(k)) cycle
        end if
        before = k
      end associate
    end do

  contains

    pure logical function rests(constraint)
      !! Does a constraint keep its component still?
      integer, intent(in) :: constraint

      rests = self%wall(self%condition(constraint))%rests(self%direction(constraint))
    end function rests
  end subroutine nodal_conditions_holders

  pure function nodal_conditions_bars(self, n_node) result(is_barred)
    !! Components of the nodes that walls at rest hold across themselves.
    class(nodal_conditions_t), intent(in) :: self
    integer, intent(in) :: n_node
    logical :: is_barred(ndim, n_node)
    integer :: k

    is_barred = .false.
    do k = 1, self%n_constraint
      if (.not. (self%faces(k) .and. self%wall(self%condition(k))%rests(self%direction(k)))) cycle
      is_barred(self%direction(k), self%node(k)) = .true.
    end do
  end function nodal_conditions_bars
end module dosui_nodal_conditions

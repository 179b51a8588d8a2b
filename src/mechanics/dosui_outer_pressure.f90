!! Pressures on surfaces that move through the grid, as a stress of the cells inside; the part of
!! tractions along the surface's normal is a pressure, too.
!!
!! With any field P that equals the pressure p on loaded surfaces and 0 on free ones (Gauss)
!!
!!     - int_loaded p N_i n dA = - int (P grad N_i + N_i grad P) dV + int_walls P N_i n dA.
!!
!! The integral over the body is taken as that of the stresses is. So sigma = - p I balances the
!! pressure p exactly, whatever becomes of cut cells, light nodes and the particles' domains there,
!! where forces on a cell's corners balance it roughly. P is p times a share that is 1 on the
!! condition's surface, 0 on other open surfaces and harmonic in between.
!!
!! What P does not meet, at the rim of a load, are forces at the surface's points. Nodes that a wall
!! holds or may stop feel the load itself along the wall's normal: - int (P grad N_i + N_i grad P)
!! is there what the integral over the walls gives back, so that friction, separation and
!! reactions see stresses and loads only.
module dosui_outer_pressure
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_scene, only: mechanical_condition_t, rigid_wall_t
  use dosui_shape_functions, only: corner_hats, group_count, n_group, n_group_wide
  use dosui_cell_quadrature, only: hat_gradients
  implicit none
  private

  real(wp), parameter :: empty_share = 1.0e-3_wp   !! conductance of cells without particles [-]
  real(wp), parameter :: converged = 1.0e-13_wp    !! residual over the first one [-]
  integer, parameter :: most_iterations = 10000
  real(wp), parameter :: same = 1.0e-12_wp         !! of values that are one but for round-off [-]
  real(wp), parameter :: near_wall = 0.5_wp        !! of surface points on rigid walls [h]
  real(wp), parameter :: on_plane = 1.0e-9_wp      !! [h]

  public :: is_pressure, pressure_forces

  type, public :: outer_pressure_t
    logical :: acts = .false.               !! on any rank
    integer, allocatable :: condition(:)    !! the mechanical conditions that are loads
    real(wp), allocatable :: share(:, :)
    !! (conditions, n_node) of their pressures in P [-]; of tractions - value . n [Pa]
    logical, allocatable :: is_open(:)      !! surface points that no wall is at
    integer, allocatable :: wall_node(:)    !! nodes that walls hold or may stop ...
    real(wp), allocatable :: wall_normal(:, :)   !! ... and along which direction [-]
  contains
    procedure :: init => outer_pressure_init
    procedure :: at_nodes => outer_pressure_at_nodes
    procedure :: at_points => outer_pressure_at_points
    procedure :: at_particles => outer_pressure_at_particles
    procedure :: take_at_walls => outer_pressure_take_at_walls
  end type outer_pressure_t

contains

  pure elemental logical function is_pressure(condition)
    !! Does a condition press along the surface's normal?
    type(mechanical_condition_t), intent(in) :: condition

    is_pressure = condition%kind == 'pressure' .or. condition%kind == 'reservoir'
  end function is_pressure

  pure elemental logical function is_wall(condition)
    !! Does a condition answer the body?
    type(mechanical_condition_t), intent(in) :: condition

    is_wall = .not. condition%is_load() .or. condition%kind == 'absorbing'
  end function is_wall

  pure real(wp) function normal_part(condition, normal) result(part)
    !! What the condition's pattern is to be multiplied by for the pressure into the body.
    type(mechanical_condition_t), intent(in) :: condition
    real(wp), intent(in) :: normal(ndim)   !! outward [-]

    part = 1.0_wp
    if (condition%kind == 'traction') part = -dot_product(condition%value, normal)
  end function normal_part

  pure real(wp) function pressure_of(condition, time, position) result(value)
    !! The pressure of a condition whose normal part is 1 [Pa], or the pattern of a traction [-].
    type(mechanical_condition_t), intent(in) :: condition
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(in) :: position(ndim)   !! [m]

    if (condition%kind == 'traction') then
      value = condition%pattern%at(position, time)
    else
      value = condition%pressure_at(time, position)
    end if
  end function pressure_of

  subroutine outer_pressure_init(self, comm, grid, conditions, walls, n, particle_cell, n_point, &
                                 cell, position, normal, area, by_force, on_nodes, is_shut, &
                                 held_node, held_direction)
    !! Shares of the pressures, and the nodes of walls. Collective.
    class(outer_pressure_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    type(mechanical_condition_t), intent(in) :: conditions(:)
    type(rigid_wall_t), intent(in) :: walls(:)
    integer, intent(in) :: n
    integer, intent(in) :: particle_cell(n)           !! 0: none
    integer, intent(in) :: n_point                    !! of the surface
    integer, intent(in) :: cell(n_point)              !! 0: none
    real(wp), intent(in) :: position(ndim, n_point)   !! [m]
    real(wp), intent(in) :: normal(ndim, n_point)     !! outward [-]
    real(wp), intent(in) :: area(n_point)             !! [m2]
    logical, intent(in) :: by_force(:, :)             !! (conditions, points) loads, penalty walls
    logical, intent(in) :: on_nodes(:, :)             !! likewise: walls on nodes
    logical, intent(in) :: is_shut(n_point)           !! barriers, and where bodies touch
    integer, intent(in) :: held_node(:), held_direction(:)   !! conditions on nodes
    real(wp), allocatable :: open_area(:, :), weight(:)
    integer :: c, k, p

    self%condition = pack([(c, c=1, size(conditions))], is_pressure(conditions) .or. &
                          conditions%kind == 'traction')
    if (allocated(self%is_open)) deallocate (self%is_open, self%share)
    allocate (self%is_open(n_point))
    do p = 1, n_point
      self%is_open(p) = any(by_force(self%condition, p)) .or. &
                        .not. (is_shut(p) .or. any(on_nodes(:, p)) .or. &
                               any(by_force(:, p) .and. is_wall(conditions)) .or. &
                               lies_on(walls, position(:, p), normal(:, p), near_wall*grid%spacing))
    end do
    allocate (open_area(1 + size(self%condition), grid%n_node), source=0.0_wp)
    do p = 1, n_point
      if (.not. self%is_open(p) .or. cell(p) == 0) cycle
      do k = 1, 2**ndim
        associate (sums => open_area(:, grid%cell_node(k, cell(p))))
          sums(1) = sums(1) + area(p)
          do c = 1, size(self%condition)
            if (by_force(self%condition(c), p)) sums(1 + c) = sums(1 + c) + area(p)* &
                                            normal_part(conditions(self%condition(c)), normal(:, p))
          end do
        end associate
      end do
    end do
    call grid%node_map%sum_copies(comm, size(open_area, 1), open_area)
    allocate (self%share(size(self%condition), grid%n_node), source=0.0_wp)
    do k = 1, grid%n_node
      if (open_area(1, k) > 0.0_wp) self%share(:, k) = open_area(2:, k)/open_area(1, k)
    end do
    call find_conductances(comm, grid, n, particle_cell, weight)
    do c = 1, size(self%condition)
      call extend(comm, grid, weight, open_area(1, :) > 0.0_wp, self%share(c, :))
    end do
    self%acts = comm%any(any(abs(self%share) > 0.0_wp))
    call find_wall_nodes(self, grid, walls, held_node, held_direction)
    do c = 1, size(conditions)
      if (is_wall(conditions(c))) call add_wall_points(self, comm, grid, cell, normal, area, &
                                                       by_force(c, :))
    end do
  end subroutine outer_pressure_init

  pure logical function lies_on(walls, position, normal, reach)
    !! Does a surface face a rigid wall and lie on it?
    type(rigid_wall_t), intent(in) :: walls(:)
    real(wp), intent(in) :: position(ndim), normal(ndim)
    real(wp), intent(in) :: reach   !! [m]
    real(wp) :: inward(ndim)
    integer :: k

    lies_on = .false.
    do k = 1, size(walls)
      inward = walls(k)%normal/norm2(walls(k)%normal)
      if (dot_product(position - walls(k)%position, inward) <= reach .and. &
          dot_product(normal, inward) < -0.5_wp) lies_on = .true.
    end do
  end function lies_on

  subroutine find_conductances(comm, grid, n, particle_cell, weight)
    !! Conductances of the cells along their edges: 1 where there is a body. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: particle_cell(n)
    real(wp), allocatable, intent(out) :: weight(:)   !! (n_cell) [-]
    integer :: p

    allocate (weight(grid%n_cell), source=0.0_wp)
    do p = 1, n
      if (particle_cell(p) > 0) weight(particle_cell(p)) = 1.0_wp
    end do
    call grid%cell_map%sum_copies(comm, 1, weight)
    weight = merge(1.0_wp, empty_share, weight > 0.5_wp)
    where (.not. grid%cell_map%is_owned) weight = 0.0_wp
  end subroutine find_conductances

  subroutine extend(comm, grid, weight, is_given, share)
    !! Fills in a nodal field between given nodes: harmonic along the edges of the cells, by
    !! conjugate gradients. A field without given nodes stays 0. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: weight(:)         !! conductances of the cells, 0: not this rank's [-]
    logical, intent(in) :: is_given(:)        !! (n_node)
    real(wp), intent(inout) :: share(:)       !! likewise [-]
    real(wp), dimension(size(share)) :: residual, direction, product, diagonal
    logical :: counts(size(share))
    real(wp) :: gamma, gamma_new, first, least, most
    integer :: k

    least = comm%minimum(minval([huge(1.0_wp), pack(share, is_given)]))
    most = comm%maximum(maxval([-huge(1.0_wp), pack(share, is_given)]))
    if (.not. most - least > same*max(abs(least), abs(most))) then   ! one value, or none is given
      where (.not. is_given) share = merge(most, 0.0_wp, most >= least)
      return
    end if
    counts = grid%node_map%is_owned(:size(share)) .and. .not. is_given
    where (.not. is_given) share = 0.0_wp
    call apply_edges(comm, grid, weight, share, product, diagonal)
    residual = -product
    where (is_given .or. .not. diagonal > 0.0_wp) residual = 0.0_wp
    diagonal = merge(diagonal, 1.0_wp, diagonal > 0.0_wp)
    direction = residual/diagonal
    gamma = comm%sum(sum(residual*direction, mask=counts))
    first = gamma
    do k = 1, most_iterations
      if (.not. gamma > converged**2*first) exit
      call apply_edges(comm, grid, weight, direction, product)
      where (is_given) product = 0.0_wp
      gamma_new = gamma/comm%sum(sum(direction*product, mask=counts))
      share = share + gamma_new*direction
      residual = residual - gamma_new*product
      gamma_new = comm%sum(sum(residual*residual/diagonal, mask=counts))
      direction = residual/diagonal + (gamma_new/gamma)*direction
      gamma = gamma_new
    end do
  end subroutine extend

  subroutine apply_edges(comm, grid, weight, values, product, diagonal)
    !! The edges' Laplacian of a nodal field, complete on every rank. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: weight(:)
    real(wp), intent(in) :: values(:)
    real(wp), intent(out) :: product(:)
    real(wp), intent(out), optional :: diagonal(:)
    real(wp) :: sums(2, size(values)), flow
    integer :: a, b, c, d

    sums = 0.0_wp
    do c = 1, grid%n_cell
      if (.not. weight(c) > 0.0_wp) cycle
      do a = 1, 2**ndim
        do d = 1, ndim
          if (btest(a - 1, d - 1)) cycle
          b = a + 2**(d - 1)
          associate (i => grid%cell_node(a, c), j => grid%cell_node(b, c))
            flow = weight(c)*(values(i) - values(j))
            sums(1, i) = sums(1, i) + flow
            sums(1, j) = sums(1, j) - flow
            sums(2, i) = sums(2, i) + weight(c)
            sums(2, j) = sums(2, j) + weight(c)
          end associate
        end do
      end do
    end do
    call grid%node_map%sum_copies(comm, 2, sums)
    product = sums(1, :)
    if (present(diagonal)) diagonal = sums(2, :)
  end subroutine apply_edges

  subroutine find_wall_nodes(self, grid, walls, held_node, held_direction)
    !! Nodes whose force along a normal belongs to a wall: held ones, and those of cells that a
    !! rigid wall bounds or crosses.
    class(outer_pressure_t), intent(inout) :: self
    type(grid_t), intent(in) :: grid
    type(rigid_wall_t), intent(in) :: walls(:)
    integer, intent(in) :: held_node(:), held_direction(:)
    real(wp) :: normal(ndim), reach
    logical :: is_near(grid%n_node)
    integer :: i, k, n

    self%wall_node = held_node
    if (allocated(self%wall_normal)) deallocate (self%wall_normal)
    allocate (self%wall_normal(ndim, size(held_node)), source=0.0_wp)
    do k = 1, size(held_node)
      self%wall_normal(held_direction(k), k) = 1.0_wp
    end do
    do k = 1, size(walls)
      normal = walls(k)%normal/norm2(walls(k)%normal)
      reach = (sum(abs(normal)) - on_plane)*grid%spacing
      do i = 1, grid%n_node
        is_near(i) = dot_product(grid%origin + grid%spacing*grid%node_index(:, i) - &
                                 walls(k)%position, normal) < reach
      end do
      n = count(is_near)
      self%wall_node = [self%wall_node, pack([(i, i=1, grid%n_node)], is_near)]
      self%wall_normal = reshape([self%wall_normal, spread(normal, 2, n)], &
                                 [ndim, size(self%wall_node)])
    end do
  end subroutine find_wall_nodes

  subroutine add_wall_points(self, comm, grid, cell, normal, area, is_here)
    !! Nodes of the cells that a wall off the planes of nodes runs through. Collective.
    class(outer_pressure_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: cell(:)           !! of the surface points, 0: none
    real(wp), intent(in) :: normal(:, :)     !! (ndim, points) [-]
    real(wp), intent(in) :: area(:)          !! [m2]
    logical, intent(in) :: is_here(:)        !! points of the wall
    real(wp) :: mean(ndim, grid%n_node)
    integer, allocatable :: nodes(:)
    integer :: i, k, p

    mean = 0.0_wp
    do p = 1, size(cell)
      if (.not. is_here(p) .or. cell(p) == 0) cycle
      do k = 1, 2**ndim
        associate (node => grid%cell_node(k, cell(p)))
          mean(:, node) = mean(:, node) + area(p)*normal(:, p)
        end associate
      end do
    end do
    call grid%node_map%sum_copies(comm, ndim, mean)
    nodes = pack([(i, i=1, grid%n_node)], sum(mean**2, dim=1) > 0.0_wp)
    self%wall_node = [self%wall_node, nodes]
    self%wall_normal = reshape([self%wall_normal, &
                                (mean(:, nodes(i))/norm2(mean(:, nodes(i))), i=1, size(nodes))], &
                               [ndim, size(self%wall_node)])
  end subroutine add_wall_points

  pure subroutine outer_pressure_at_nodes(self, conditions, grid, time, pressure)
    !! P at the nodes [Pa].
    class(outer_pressure_t), intent(in) :: self
    type(mechanical_condition_t), intent(in) :: conditions(:)
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: time                       !! [s]
    real(wp), intent(out) :: pressure(grid%n_node)     !! into the body [Pa]
    real(wp) :: value
    logical :: varies
    integer :: i, k

    pressure = 0.0_wp
    do k = 1, size(self%condition)
      associate (condition => conditions(self%condition(k)))
        varies = condition%kind == 'reservoir' .or. allocated(condition%pattern%formula)
        value = 0.0_wp
        if (.not. varies) value = pressure_of(condition, time, grid%origin)
        do i = 1, grid%n_node
          if (.not. abs(self%share(k, i)) > 0.0_wp) cycle
          if (varies) value = pressure_of(condition, time, grid%origin + &
                                          grid%spacing*grid%node_index(:, i))
          pressure(i) = pressure(i) + self%share(k, i)*value
        end do
      end associate
    end do
  end subroutine outer_pressure_at_nodes

  pure subroutine outer_pressure_at_points(self, conditions, time, position, normal, by_force, &
                                           pressure, of_tractions)
    !! The conditions' pressures at the surface points.
    class(outer_pressure_t), intent(in) :: self
    type(mechanical_condition_t), intent(in) :: conditions(:)
    real(wp), intent(in) :: time              !! [s]
    real(wp), intent(in) :: position(:, :)    !! (ndim, points) [m]
    real(wp), intent(in) :: normal(:, :)      !! likewise: outward [-]
    logical, intent(in) :: by_force(:, :)     !! (conditions, points)
    real(wp), intent(out) :: pressure(:)      !! into the body [Pa]
    real(wp), intent(out) :: of_tractions(:)  !! what tractions have in it [Pa]
    real(wp) :: value
    integer :: k, p

    pressure = 0.0_wp
    of_tractions = 0.0_wp
    do p = 1, size(pressure)
      do k = 1, size(self%condition)
        if (.not. by_force(self%condition(k), p)) cycle
        associate (condition => conditions(self%condition(k)))
          value = normal_part(condition, normal(:, p))*pressure_of(condition, time, position(:, p))
          if (condition%kind == 'traction') of_tractions(p) = of_tractions(p) + value
        end associate
        pressure(p) = pressure(p) + value
      end do
    end do
  end subroutine outer_pressure_at_points

  pure subroutine outer_pressure_at_particles(self, grid, n, cell, position, nodal, pressure, slope)
    !! P and its gradient at particles, by the hats of their cells.
    class(outer_pressure_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: position(:, :)       !! (ndim, n) [m]
    real(wp), intent(in) :: nodal(grid%n_node)   !! P at the nodes [Pa]
    real(wp), intent(out) :: pressure(n)         !! [Pa]
    real(wp), intent(out) :: slope(ndim, n)      !! [Pa/m]
    real(wp) :: local(ndim), corner(2**ndim), gradient(ndim, 2**ndim)
    integer :: p

    pressure = 0.0_wp
    slope = 0.0_wp
    if (.not. self%acts) return
    do p = 1, n
      corner = nodal(grid%cell_node(:, cell(p)))
      pressure(p) = corner(1)
      if (.not. any(abs(corner - corner(1)) > 1.0e-12_wp*abs(corner(1)))) cycle
      local = (position(:, p) - grid%origin)/grid%spacing - grid%cell_base(:, cell(p))
      call hat_gradients(local, spread(0.0_wp, 1, ndim), grid%spacing, gradient)
      pressure(p) = dot_product(corner_hats(local), corner)
      slope(:, p) = matmul(gradient, corner)
    end do
  end subroutine outer_pressure_at_particles

  pure subroutine outer_pressure_take_at_walls(self, load, force)
    !! Along walls' normals, the forces of their nodes become the loads.
    class(outer_pressure_t), intent(in) :: self
    real(wp), intent(in) :: load(:, :)       !! (ndim, n_node) of the surface's points [N]
    real(wp), intent(inout) :: force(:, :)   !! likewise: of P [N]
    integer :: k

    do k = 1, size(self%wall_node)
      associate (i => self%wall_node(k), normal => self%wall_normal(:, k))
        force(:, i) = force(:, i) + dot_product(load(:, i) - force(:, i), normal)*normal
      end associate
    end do
  end subroutine outer_pressure_take_at_walls

  pure subroutine pressure_forces(grid, n, patch, position, weight, volume, pressure, slope, force)
    !! Adds - sum (w P grad N_i + V N_i grad P) over particles to the nodal forces: P as stresses
    !! are integrated, its gradient as the weight is.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(:, :)     !! (ndim, n) [m]
    real(wp), intent(in) :: weight(n)          !! in integrals of stresses [m3]
    real(wp), intent(in) :: volume(n)          !! [m3]
    real(wp), intent(in) :: pressure(n)        !! P, compression positive [Pa]
    real(wp), intent(in) :: slope(:, :)        !! (ndim, n) grad P [Pa/m]
    real(wp), intent(inout) :: force(:, :)     !! (ndim, n_node) [N]
    real(wp) :: share(n_group*n_group_wide), gradient(n_group*n_group_wide*ndim)
    integer :: p, i, node, groups, padded

    groups = group_count(grid%shape_kind)
    padded = n_group*groups
    do p = 1, n
      if (.not. (abs(pressure(p)) > 0.0_wp .or. any(abs(slope(:, p)) > 0.0_wp))) cycle
      call grid%weigh(p, 1, patch(p:p), position(:, p:p), groups, share, gradient)
      do i = 1, size(grid%patch_node, 1)
        node = grid%patch_node(i, patch(p))
        force(:, node) = force(:, node) - volume(p)*share(i)*slope(:, p) - &
                         weight(p)*pressure(p)*gradient(i:i + (ndim - 1)*padded:padded)
      end do
    end do
  end subroutine pressure_forces
end module dosui_outer_pressure

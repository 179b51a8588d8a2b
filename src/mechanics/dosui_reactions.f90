!! Forces of walls on the bodies, and what they balance: loads, weight, inertia and the like.
!!
!! A reaction is what a condition adds to the forces on the nodes (or at the surface points) that it
!! holds: the force of the wall on the body. Everything is summed over this rank's part first, and
!! only for steps that get a row of the histories.
module dosui_reactions
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: axis, ndim
  use dosui_scene, only: mechanical_condition_t, name_length, rigid_wall_t, surface_t
  implicit none
  private

  integer, parameter, public :: of_loads = 1     !! tractions and pressures on surfaces
  integer, parameter, public :: of_weight = 2
  integer, parameter, public :: of_shaking = 3   !! the base's motion
  integer, parameter, public :: of_sources = 4   !! body forces by formulas
  integer, parameter, public :: of_damping = 5
  integer, parameter, public :: of_light_nodes = 6   !! what nodes almost without mass do not feel
  integer, parameter, public :: of_inertia = 7   !! mass times acceleration: what all others make
  integer, parameter, public :: n_total = 7

  type, public :: reactions_t
    integer :: n = 0                           !! walls: surfaces that hold, then rigid walls
    integer :: n_surface = 0                   !! of them, surfaces
    character(len=name_length), allocatable :: name(:)
    integer, allocatable :: wall_of(:)         !! wall of each mechanical condition, 0: a load
    real(wp), allocatable :: centre(:, :)      !! (ndim, n) points that moments refer to [m]
    real(wp), allocatable :: force(:, :)       !! (ndim, n) of walls on the bodies [N]
    real(wp), allocatable :: moment(:, :)      !! (3, n) likewise, x y z [N m]
    real(wp) :: total(ndim, n_total) = 0.0_wp  !! other forces [N]
    real(wp) :: gross = 0.0_wp                 !! sum of the magnitudes of all forces [N]
    real(wp) :: noise = 0.0_wp   !! momenta over the step: their round-off passes for forces [N]
    real(wp) :: gravity(ndim) = 0.0_wp         !! that the weight is made of [m/s2]
    real(wp) :: shaking(ndim) = 0.0_wp         !! likewise of the base's motion [m/s2]
    real(wp) :: momentum(ndim) = 0.0_wp        !! of the particles before the step [kg m/s]
    logical :: is_wanted = .false.             !! the forces at hand are to be summed
    logical :: is_known = .false.              !! they have been, and wait for their row
    real(wp) :: next_time = 0.0_wp             !! of the next row [s]
    integer(i8) :: next_step = 0_i8            !! no row before this step
    real(wp), allocatable :: undamped(:, :)    !! (ndim, n_node) forces before damping [N]
    real(wp), allocatable :: by_walls(:, :)    !! (ndim, n_node) forces of rigid walls [N]
    integer, allocatable :: holder(:, :)       !! (ndim, n_node) rigid wall that holds it, 0: none
    real(wp) :: row_time = -1.0_wp             !! of the last row [s]; < 0: there is none
    real(wp) :: row_total(ndim, n_total + 1) = 0.0_wp   !! its forces, those of all walls last [N]
    real(wp) :: row_error = 0.0_wp             !! what is missing in it, over the gross [-]
    real(wp) :: largest_error = 0.0_wp         !! of all rows of this run [-]
  contains
    procedure :: init => reactions_init
    procedure :: want => reactions_want
    procedure :: clear => reactions_clear
    procedure :: add => reactions_add
    procedure :: add_nodes => reactions_add_nodes
    procedure :: n_column => reactions_n_column
  end type reactions_t

  public :: n_moment, moment_axis, reacts

  integer, parameter :: n_moment = ndim*(ndim - 1)/2   !! components of a moment: 0, 1, 3
  integer, parameter :: moment_axis(3) = merge([2, 2, 2], [1, 2, 3], ndim == 2)   !! their axes

contains

  pure logical function reacts(condition)
    !! Does a condition answer the body, so that its force is not given?
    type(mechanical_condition_t), intent(in) :: condition

    reacts = .not. condition%is_load() .or. condition%kind == 'absorbing'
  end function reacts

  pure subroutine reactions_init(self, surfaces, conditions, walls)
    !! Numbers the walls of a scene.
    class(reactions_t), intent(inout) :: self
    type(surface_t), intent(in) :: surfaces(:)
    type(mechanical_condition_t), intent(in) :: conditions(:)
    type(rigid_wall_t), intent(in) :: walls(:)
    integer :: c, k, s

    allocate (self%name(size(surfaces) + size(walls)))
    allocate (self%wall_of(size(conditions)), source=0)
    self%n = 0
    do s = 1, size(surfaces)
      do c = 1, size(conditions)
        if (conditions(c)%surface /= surfaces(s)%name .or. .not. reacts(conditions(c))) cycle
        if (self%wall_of(c) > 0) cycle
        if (.not. any(self%name(:self%n) == surfaces(s)%name)) self%n = self%n + 1
        self%name(self%n) = surfaces(s)%name
        self%wall_of(c) = self%n
      end do
    end do
    self%n_surface = self%n
    do k = 1, size(walls)
      self%n = self%n + 1
      self%name(self%n) = walls(k)%name
    end do
    allocate (self%centre(ndim, self%n), self%force(ndim, self%n), self%moment(3, self%n), &
              source=0.0_wp)
    do k = 1, size(walls)
      self%centre(:, self%n_surface + k) = walls(k)%position
    end do
  end subroutine reactions_init

  pure subroutine reactions_want(self, time, dt, step)
    !! Decides whether the forces of a step are summed.
    class(reactions_t), intent(inout) :: self
    real(wp), intent(in) :: time       !! at its end [s]
    real(wp), intent(in) :: dt         !! [s]
    integer(i8), intent(in) :: step    !! its number

    ! clocks land on output times from as far as 1e-6 dt
    self%is_wanted = self%n > 0 .and. step >= self%next_step .and. &
                     time + 1.0e-5_wp*dt >= self%next_time*(1.0_wp - 1.0e-12_wp)
  end subroutine reactions_want

  pure subroutine reactions_clear(self, n_node)
    !! Begins a sum.
    class(reactions_t), intent(inout) :: self
    integer, intent(in) :: n_node

    self%force = 0.0_wp
    self%moment = 0.0_wp
    self%total = 0.0_wp
    self%gross = 0.0_wp
    self%noise = 0.0_wp
    if (allocated(self%undamped)) deallocate (self%undamped)
    if (allocated(self%by_walls)) deallocate (self%by_walls, self%holder)
    if (self%n == self%n_surface) return
    allocate (self%by_walls(ndim, n_node), source=0.0_wp)
    allocate (self%holder(ndim, n_node), source=0)
  end subroutine reactions_clear

  pure subroutine reactions_add(self, wall, place, force)
    !! Adds a force of a wall on the body.
    class(reactions_t), intent(inout) :: self
    integer, intent(in) :: wall
    real(wp), intent(in) :: place(ndim)   !! [m]
    real(wp), intent(in) :: force(ndim)   !! [N]
    real(wp) :: arm(3), push(3)

    self%force(:, wall) = self%force(:, wall) + force
    self%gross = self%gross + norm2(force)
    arm = 0.0_wp
    push = 0.0_wp
    arm(axis) = place - self%centre(:, wall)
    push(axis) = force
    self%moment(:, wall) = self%moment(:, wall) + &
                           [arm(2)*push(3) - arm(3)*push(2), arm(3)*push(1) - arm(1)*push(3), &
                            arm(1)*push(2) - arm(2)*push(1)]
  end subroutine reactions_add

  pure subroutine reactions_add_nodes(self, wall, total, place, force)
    !! Adds this rank's share of forces on nodes, to a wall or, wall = 0, to a total.
    class(reactions_t), intent(inout) :: self
    integer, intent(in) :: wall, total
    real(wp), intent(in) :: place(:, :)   !! (ndim, n_node) [m]
    real(wp), intent(in) :: force(:, :)   !! likewise [N]
    integer :: i

    do i = 1, size(force, 2)
      if (.not. any(abs(force(:, i)) > 0.0_wp)) cycle
      if (wall > 0) then
        call self%add(wall, place(:, i), force(:, i))
      else
        self%total(:, total) = self%total(:, total) + force(:, i)
        self%gross = self%gross + norm2(force(:, i))
      end if
    end do
  end subroutine reactions_add_nodes

  pure integer function reactions_n_column(self) result(n)
    !! Columns of the histories: forces and moments, and what is missing in the balance.
    class(reactions_t), intent(in) :: self

    n = 0
    if (self%n > 0) n = self%n*(ndim + n_moment) + 1
  end function reactions_n_column
end module dosui_reactions

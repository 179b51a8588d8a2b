!! Walls: what they hold of a body's motion, and what moves them. A kind of wall is its line in
!! `wall_of`; everything else asks for these facts.
module dosui_wall
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_table, only: table_t
  implicit none
  private

  public :: wall_of

  integer, parameter :: by_nothing = 0, by_vector = 1, along_normal = 2, by_force = 3

  type, public :: wall_t
    !! A wall, or nothing that holds.
    logical :: holds = .false.                    !! it is a wall
    logical :: holds_all = .false.                !! also along its surface
    integer, private :: moved = by_nothing
    real(wp), private :: value(ndim) = 0.0_wp     ! velocity [m/s], or force of a plate [N]
    type(table_t), private :: factor              ! on it, over time [-]
  contains
    procedure :: held => wall_held
    procedure :: velocity => wall_velocity
    procedure :: way => wall_way
    procedure :: force => wall_force
    procedure :: is_plate => wall_is_plate
    procedure :: is_guided => wall_is_guided
    procedure :: rests => wall_rests
  end type wall_t

contains

  pure function wall_of(kind, value, factor) result(wall)
    !! The wall of a kind; one that holds nothing for the kinds of loads. The kind alone tells what
    !! it holds and what moves it.
    character(len=*), intent(in) :: kind
    real(wp), intent(in), optional :: value(ndim)   !! velocity [m/s], or force of a plate [N]
    type(table_t), intent(in), optional :: factor   !! on it, over time [-]
    type(wall_t) :: wall

    select case (kind)
    case ('fixed')
      wall = wall_t(.true., .true.)
    case ('roller')
      wall = wall_t(.true., .false.)
    case ('velocity')
      wall = wall_t(.true., .true., by_vector)
    case ('normal_velocity')
      wall = wall_t(.true., .false., along_normal)
    case ('plate')
      wall = wall_t(.true., .false., by_force)
    case default   ! a load
    end select
    if (wall%moved == by_nothing) return
    if (present(value)) wall%value = value
    if (present(factor)) wall%factor = factor
  end function wall_of

  pure function wall_held(self, motion, normal) result(held)
    !! The part of a motion, or of a force, that the wall takes [unit of the motion].
    class(wall_t), intent(in) :: self
    real(wp), intent(in) :: motion(ndim)   !! [m, m/s or N]
    real(wp), intent(in) :: normal(ndim)   !! of the wall [-]
    real(wp) :: held(ndim)

    held = motion
    if (.not. self%holds_all) held = dot_product(motion, normal)*normal
  end function wall_held

  pure function moved_by(self, amount, normal) result(motion)
    !! Its value times a factor [m/s], or times the integral of that [m].
    class(wall_t), intent(in) :: self
    real(wp), intent(in) :: amount         !! factor [-], or integral [s]
    real(wp), intent(in) :: normal(ndim)   !! outward [-]
    real(wp) :: motion(ndim)

    motion = 0.0_wp
    if (self%moved == by_vector) motion = self%value*amount
    if (self%moved == along_normal) motion = self%value(1)*amount*normal
  end function moved_by

  pure function wall_velocity(self, time, normal) result(velocity)
    !! Prescribed velocity; 0 for walls at rest and for plates, whose velocity is not known [m/s].
    class(wall_t), intent(in) :: self
    real(wp), intent(in) :: time           !! [s]
    real(wp), intent(in) :: normal(ndim)   !! outward [-]
    real(wp) :: velocity(ndim)

    velocity = moved_by(self, self%factor%at(time), normal)
  end function wall_velocity

  pure function wall_way(self, from, to, normal) result(way)
    !! Prescribed displacement between two times [m].
    class(wall_t), intent(in) :: self
    real(wp), intent(in) :: from, to       !! [s]
    real(wp), intent(in) :: normal(ndim)   !! outward [-]
    real(wp) :: way(ndim)

    way = moved_by(self, self%factor%integral(to) - self%factor%integral(from), normal)
  end function wall_way

  pure real(wp) function wall_force(self, time) result(force)
    !! Total force of a plate, into the body [N, per m thickness in 2-D, per m2 in 1-D].
    class(wall_t), intent(in) :: self
    real(wp), intent(in) :: time   !! [s]

    force = 0.0_wp
    if (self%moved == by_force) force = self%value(1)*self%factor%at(time)
  end function wall_force

  pure elemental logical function wall_is_plate(self) result(is_plate)
    !! Does a given force move it, so that its motion is not known?
    class(wall_t), intent(in) :: self

    is_plate = self%moved == by_force
  end function wall_is_plate

  pure elemental logical function wall_is_guided(self) result(is_guided)
    !! Has it a velocity that is given?
    class(wall_t), intent(in) :: self

    is_guided = self%moved == by_vector .or. self%moved == along_normal
  end function wall_is_guided

  pure logical function wall_rests(self, direction) result(rests)
    !! Does it keep a component of motion still?
    class(wall_t), intent(in) :: self
    integer, intent(in) :: direction   !! axis of the scene

    rests = self%holds .and. self%moved == by_nothing
    if (self%moved == by_vector) rests = .not. abs(self%value(direction)) > 0.0_wp
  end function wall_rests
end module dosui_wall

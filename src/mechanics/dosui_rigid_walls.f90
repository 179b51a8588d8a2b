!! Rigid walls outside all bodies: what meets them slides with friction, and leaves freely.
!!
!! A wall acts on the velocities of the nodes at or behind its plane, as the contact of
!! [Bardenhagen2000] with a body that does not move: only what approaches is stopped, and
!! friction takes no more than the coefficient times the momentum that the wall took along its
!! normal.
module dosui_rigid_walls
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_grid, only: grid_t
  use dosui_scene, only: rigid_wall_t
  implicit none
  private

  public :: meet_walls, correct_friction, rest_on_walls

  real(wp), parameter :: on_plane = 1.0e-9_wp   !! of a grid spacing [-]

contains

  pure subroutine meet_walls(walls, grid, velocity, is_held, taken)
    !! Stops and brakes the nodes that move into walls.
    type(rigid_wall_t), intent(in) :: walls(:)
    type(grid_t), intent(in) :: grid
    real(wp), intent(inout) :: velocity(ndim, grid%n_node)   !! [m/s]
    logical, intent(inout), optional :: is_held(ndim, grid%n_node)
    !! set for components that walls stop: along the axis of a wall's normal, all where it sticks
    real(wp), intent(inout), optional :: taken(ndim, grid%n_node)
    !! the velocities into walls that were taken are added, along their inward normals [m/s]
    real(wp) :: normal(ndim), approach, sliding
    integer :: i, k

    do k = 1, size(walls)
      normal = walls(k)%normal/norm2(walls(k)%normal)
      do i = 1, grid%n_node
        if (.not. is_behind(walls(k), normal, grid, i)) cycle
        approach = -dot_product(velocity(:, i), normal)
        if (.not. approach > 0.0_wp) cycle
        velocity(:, i) = velocity(:, i) + approach*normal
        if (walls(k)%is_rough()) then
          velocity(:, i) = 0.0_wp
        else if (walls(k)%friction > 0.0_wp) then
          sliding = norm2(velocity(:, i))
          if (sliding > walls(k)%friction*approach) then
            velocity(:, i) = velocity(:, i)*(1.0_wp - walls(k)%friction*approach/sliding)
          else
            velocity(:, i) = 0.0_wp
          end if
        end if
        if (present(taken)) taken(:, i) = taken(:, i) - approach*normal
        if (present(is_held)) then
          is_held(maxloc(abs(normal), dim=1), i) = .true.
          if (.not. norm2(velocity(:, i)) > 0.0_wp .and. &
              (walls(k)%is_rough() .or. walls(k)%friction > 0.0_wp)) is_held(:, i) = .true.
        end if
      end do
    end do
  end subroutine meet_walls

  pure subroutine correct_friction(walls, grid, taken, push, is_held, velocity)
    !! Friction of what later pushes nodes against walls that have stopped them already, or eases
    !! them: altogether no more than the coefficient times what walls take, and no less than none.
    type(rigid_wall_t), intent(in) :: walls(:)
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: taken(ndim, grid%n_node)      !! as from `meet_walls` [m/s]
    real(wp), intent(in) :: push(ndim, grid%n_node)       !! velocity it would give free nodes [m/s]
    logical, intent(in) :: is_held(ndim, grid%n_node)     !! as from `meet_walls`
    real(wp), intent(inout) :: velocity(ndim, grid%n_node)   !! [m/s]
    real(wp) :: normal(ndim), more, sliding
    integer :: i, k

    do k = 1, size(walls)
      if (walls(k)%is_rough() .or. .not. walls(k)%friction > 0.0_wp) cycle
      normal = walls(k)%normal/norm2(walls(k)%normal)
      do i = 1, grid%n_node
        if (all(is_held(:, i)) .or. .not. is_held(maxloc(abs(normal), dim=1), i)) cycle
        if (.not. is_behind(walls(k), normal, grid, i)) cycle
        sliding = norm2(velocity(:, i))
        if (.not. sliding > 0.0_wp) cycle
        more = max(-dot_product(push(:, i), normal), dot_product(taken(:, i), normal))
        velocity(:, i) = velocity(:, i)*max(0.0_wp, 1.0_wp - walls(k)%friction*more/sliding)
      end do
    end do
  end subroutine correct_friction

  pure subroutine rest_on_walls(walls, grid, motion)
    !! What an equilibrium before t = 0 takes a wall for: it holds the nodes at and behind it, also
    !! along its plane if there is friction.
    type(rigid_wall_t), intent(in) :: walls(:)
    type(grid_t), intent(in) :: grid
    real(wp), intent(inout) :: motion(ndim, grid%n_node)   !! [m or any unit of a motion]
    real(wp) :: normal(ndim)
    integer :: i, k

    do k = 1, size(walls)
      normal = walls(k)%normal/norm2(walls(k)%normal)
      do i = 1, grid%n_node
        if (.not. is_behind(walls(k), normal, grid, i)) cycle
        motion(:, i) = motion(:, i) - dot_product(motion(:, i), normal)*normal
        if (walls(k)%is_rough() .or. walls(k)%friction > 0.0_wp) motion(:, i) = 0.0_wp
      end do
    end do
  end subroutine rest_on_walls

  pure logical function is_behind(wall, normal, grid, node)
    !! Does a node lie on the plane or behind it?
    type(rigid_wall_t), intent(in) :: wall
    real(wp), intent(in) :: normal(ndim)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node
    real(wp) :: place(ndim)

    place = grid%origin + grid%spacing*grid%node_index(:, node)
    is_behind = dot_product(place - wall%position, normal) <= on_plane*grid%spacing
  end function is_behind
end module dosui_rigid_walls

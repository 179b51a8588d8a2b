!! Body forces and water sources that the scene gives as formulas of place and time.
module dosui_sources
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, axis
  use dosui_grid, only: grid_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: source_t
  use dosui_shape_functions, only: group_count, n_group, n_group_wide
  implicit none
  private

  type, public :: sources_t
    logical :: has_force = .false., has_water = .false.
    type(scalar_function_t) :: force(ndim)   !! body force beside gravity [N/m3]
    type(scalar_function_t) :: water         !! water supplied per volume of soil [1/s]
  contains
    procedure :: init => sources_init
    procedure :: add_forces => sources_add_forces
    procedure :: add_water => sources_add_water
  end type sources_t

contains

  subroutine sources_init(self, source)
    !! Takes over formulas that have been read.
    class(sources_t), intent(inout) :: self
    type(source_t), intent(in) :: source

    self%force = source%force(axis)
    self%water = source%water
    self%has_force = any(self%force%varies())
    self%has_water = self%water%varies()
  end subroutine sources_init

  subroutine sources_add_forces(self, grid, n, patch, position, weight, time, force)
    !! Adds sum w N_i b to the nodal forces.
    class(sources_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(:, :)     !! (ndim, n) [m]
    real(wp), intent(in) :: weight(n)          !! [m3]
    real(wp), intent(in) :: time               !! [s]
    real(wp), intent(inout) :: force(:, :)     !! (ndim, n_node) [N]
    real(wp) :: share(n_group*n_group_wide), gradient(n_group*n_group_wide*ndim), density(ndim)
    integer :: p, i, d, node

    do p = 1, n
      call grid%weigh(p, 1, patch(p:p), position(:, p:p), group_count(grid%shape_kind), share, &
                      gradient)
      do d = 1, ndim
        density(d) = self%force(d)%at(position(:, p), time)
      end do
      do i = 1, size(grid%patch_node, 1)
        node = grid%patch_node(i, patch(p))
        force(:, node) = force(:, node) + weight(p)*share(i)*density
      end do
    end do
  end subroutine sources_add_forces

  subroutine sources_add_water(self, n, position, time, rate)
    !! Adds the supply to the rates of water content.
    class(sources_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: position(:, :)   !! (ndim, n) [m]
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(inout) :: rate(n)       !! [1/s]
    integer :: p

    do p = 1, n
      rate(p) = rate(p) + self%water%at(position(:, p), time)
    end do
  end subroutine sources_add_water
end module dosui_sources

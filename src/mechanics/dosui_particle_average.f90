!! Averages of particles' values over a width that belongs to the soil, not to the grid.
!!
!! One sweep takes values to the corners of the cells and back, weighted with mass, by linear shape
!! functions: a convex mean, so that uniform values stay what they are, at surfaces, too. A sweep
!! spreads a value with a variance of h^2/3; a number of them, damped, makes any larger variance.
module dosui_particle_average
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: corner_hats
  implicit none
  private

  public :: average_particles

  real(wp), parameter :: of_sweep = 1.0_wp/3.0_wp   !! variance of a sweep over h^2 [-]

contains

  subroutine average_particles(comm, grid, n, cell, position, mass, variance, values)
    !! Means of the particles' values around them. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)              !! all in the grid
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    real(wp), intent(in) :: mass(n)             !! 0: takes a mean, but has no part in it [kg]
    real(wp), intent(in) :: variance            !! of the weights in each direction [m2]
    real(wp), intent(inout) :: values(n)        !! [any unit]
    real(wp), allocatable :: weight(:, :), inverse(:), nodal(:)
    real(wp) :: share   ! of a sweep [-]
    integer :: k, n_sweep, p

    n_sweep = ceiling(variance/(of_sweep*grid%spacing**2))
    if (n_sweep < 1) return
    share = variance/(of_sweep*grid%spacing**2*n_sweep)
    allocate (weight(2**ndim, n), inverse(grid%n_node), nodal(grid%n_node))
    do p = 1, n
      weight(:, p) = corner_hats((position(:, p) - grid%origin)/grid%spacing - &
                                 grid%cell_base(:, cell(p)))
    end do
    call sum_at_nodes(comm, grid, n, cell, weight, mass, inverse)
    where (inverse > 0.0_wp) inverse = 1.0_wp/inverse
    do k = 1, n_sweep
      call sum_at_nodes(comm, grid, n, cell, weight, mass*values, nodal)
      nodal = nodal*inverse
      do p = 1, n
        values(p) = values(p) + &
                    share*(sum(weight(:, p)*nodal(grid%cell_node(:, cell(p)))) - values(p))
      end do
    end do
  end subroutine average_particles

  subroutine sum_at_nodes(comm, grid, n, cell, weight, values, nodal)
    !! Sums of weight times value at the corners of cells over all ranks. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: weight(2**ndim, n), values(n)   !! [-], [any unit]
    real(wp), intent(out) :: nodal(grid%n_node)             !! [unit of the values]
    integer :: p

    nodal = 0.0_wp
    do p = 1, n
      associate (node => grid%cell_node(:, cell(p)))
        nodal(node) = nodal(node) + weight(:, p)*values(p)
      end associate
    end do
    call grid%node_map%sum_copies(comm, 1, nodal)
  end subroutine sum_at_nodes
end module dosui_particle_average

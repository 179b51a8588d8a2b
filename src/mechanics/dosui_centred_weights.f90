!! Weights by which particles stand for the water of their cells: centred on the cells' filling.
!!
!! A cell's volume change is that of its filling's centroid X (`dosui_cell_quadrature`), and the
!! cell's pressure acts there, too. With even weights the mean of the particles' pressures is that
!! of their own middle. On a lattice that does not follow the grid all middles lie off by the same
!! way, and water and skeleton are displaced against each other by up to a quarter of a cell.
module dosui_centred_weights
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_least_squares, only: eliminate
  implicit none
  private

  public :: centre_weights

  real(wp), parameter :: least_factor = 0.1_wp    !! of weights [-]
  real(wp), parameter :: least_spread = 1.0e-3_wp !! variance of places that can be centred [cells2]
  real(wp), parameter :: centred_enough = 1.0e-13_wp   !! [cells]
  integer, parameter :: newton_limit = 40         !! steps

contains

  subroutine centre_weights(comm, grid, n, cell, position, centre, weight)
    !! Changes weights so that their centre in every cell is the given one, with the same sums.
    !!
    !! Factors exp(a.(x - X)) are those that change the weights least in the sense of entropy, and
    !! never negative [Arroyo2006]; Newton's method finds the slope a of every cell. It goes
    !! as far as every factor stays above `least_factor`, and nowhere where particles hardly span
    !! all directions. Weights that are centred stay as they are. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: position(ndim, n)   !! [m]
    real(wp), intent(in) :: centre(:, :)        !! (ndim, n_cell) X from a cell's corner [cells]
    real(wp), intent(inout) :: weight(n)        !! [m3]
    real(wp), allocatable :: place(:, :), slope(:, :), factor(:), way(:, :)
    logical, allocatable :: is_done(:)
    integer :: p, iteration

    allocate (place(ndim, n), factor(n), slope(1 + ndim, grid%n_cell), way(1, grid%n_cell))
    allocate (is_done(grid%n_cell), source=.false.)
    factor = 1.0_wp
    do p = 1, n   ! from the centre [cells]
      place(:, p) = (position(:, p) - grid%origin)/grid%spacing - grid%cell_base(:, cell(p)) - &
                    centre(:, cell(p))
    end do
    do iteration = 1, newton_limit
      call find_slopes(comm, grid, n, cell, place, weight*factor, is_done, slope)
      if (.not. comm%any(.not. all(is_done))) exit
      way = 1.0_wp   ! as far as no factor falls too low
      do p = 1, n
        associate (change => log_change(p))
          if (factor(p)*exp(change) < least_factor) then
            way(1, cell(p)) = min(way(1, cell(p)), log(least_factor/factor(p))/change)
          end if
        end associate
      end do
      call grid%cell_map%scatter_min(comm, 1, way)
      call grid%cell_map%gather(comm, 1, way)
      do p = 1, n
        factor(p) = factor(p)*exp(way(1, cell(p))*log_change(p))
      end do
      is_done = is_done .or. way(1, :) < 1.0_wp
    end do
    call keep_sums(comm, grid, n, cell, factor, weight)

  contains

    pure real(wp) function log_change(i) result(change)
      !! What a Newton step adds to the logarithm of a particle's factor.
      integer, intent(in) :: i

      change = max(slope(1, cell(i)) + dot_product(slope(2:, cell(i)), place(:, i)), -1.0_wp)
    end function log_change
  end subroutine centre_weights

  subroutine find_slopes(comm, grid, n, cell, place, weight, is_done, slope)
    !! Newton's steps a of factors exp(a.(x - X)), as -a.X and a; 0 in cells that are done, where
    !! the middle X of the weights is the origin or particles do not span. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n, cell(n)
    real(wp), intent(in) :: place(ndim, n)        !! [cells]
    real(wp), intent(in) :: weight(n)             !! [m3]
    logical, intent(inout) :: is_done(grid%n_cell)
    real(wp), intent(out) :: slope(1 + ndim, grid%n_cell)   !! [1/cells]
    integer, parameter :: width = 1 + ndim + ndim**2
    real(wp) :: sums(width, grid%n_cell), matrix(ndim, ndim), middle(ndim)
    logical :: regular
    integer :: a, c, p

    sums = 0.0_wp
    do p = 1, n
      sums(:, cell(p)) = sums(:, cell(p)) + &
                         weight(p)*[1.0_wp, place(:, p), [(place(a, p)*place(:, p), a=1, ndim)]]
    end do
    call grid%cell_map%sum_copies(comm, width, sums)
    slope = 0.0_wp
    do c = 1, grid%n_cell
      is_done(c) = is_done(c) .or. .not. sums(1, c) > 0.0_wp
      if (is_done(c)) cycle
      middle = sums(2:1 + ndim, c)/sums(1, c)
      is_done(c) = all(abs(middle) <= centred_enough)
      if (is_done(c)) cycle
      matrix = reshape(sums(2 + ndim:, c)/sums(1, c), [ndim, ndim])
      do a = 1, ndim
        matrix(:, a) = matrix(:, a) - middle*middle(a)
      end do
      regular = all([(matrix(a, a), a=1, ndim)] > least_spread)
      slope(2:, c) = -middle
      if (regular) call eliminate_spread(matrix, slope(2:, c), regular)
      slope(1, c) = -dot_product(slope(2:, c), middle)
      is_done(c) = .not. regular
      if (is_done(c)) slope(:, c) = 0.0_wp
    end do
  end subroutine find_slopes

  pure subroutine eliminate_spread(matrix, right, regular)
    !! Solves with a covariance of places, unless they lie on a line or a plane, almost.
    real(wp), intent(in) :: matrix(ndim, ndim)    !! [cells2]
    real(wp), intent(inout) :: right(ndim)        !! [cells] on entry, [1/cells] on return
    logical, intent(out) :: regular
    real(wp) :: work(ndim, ndim), unit(ndim)
    integer :: a

    do a = 1, ndim   ! the inverse's diagonal: one over the spread that others do not explain
      work = matrix
      unit = 0.0_wp
      unit(a) = 1.0_wp
      call eliminate(work, unit, regular)
      if (regular) regular = unit(a)*least_spread < 1.0_wp .and. unit(a) > 0.0_wp
      if (.not. regular) return
    end do
    work = matrix
    call eliminate(work, right, regular)
  end subroutine eliminate_spread

  subroutine keep_sums(comm, grid, n, cell, factor, weight)
    !! Weights times factors with the same sum in every cell. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n, cell(n)
    real(wp), intent(in) :: factor(n)             !! [-]
    real(wp), intent(inout) :: weight(n)          !! [m3]
    real(wp) :: sums(2, grid%n_cell)
    integer :: p

    sums = 0.0_wp
    do p = 1, n
      sums(:, cell(p)) = sums(:, cell(p)) + weight(p)*[1.0_wp, factor(p)]
    end do
    call grid%cell_map%sum_copies(comm, 2, sums)
    do p = 1, n
      weight(p) = weight(p)*factor(p)*(sums(1, cell(p))/sums(2, cell(p)))
    end do
  end subroutine keep_sums
end module dosui_centred_weights

!! Weight of bodies that cut the cells of the grid, integrated over the same parts of cells as their
!! stresses.
!!
!! Particles weigh V_p rho at x_p. Off the grid's own lattice their sums over a part of a cell are
!! neither its mass nor its first moments, and the stress that balances them is off by as much: by
!! rho g times the way between the particles' centre and the part's. Shapes know the integrals
!!
!!     int rho N_i dV = rho sum_c W_c mean(N_i over the part)
!!
!! and what these differ from the particles' sums is kept as a nodal mass, whose weight is added to
!! that of the particles. Inertia stays with the particles, and so do changes of their mass. In
!! total every material weighs what its particles do.
module dosui_body_weight
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_cell_filling, only: filling_t
  use dosui_cell_quadrature, only: cell_quadrature_t
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_particle_to_grid, only: n_nodal_row, particles_to_grid
  use dosui_scene, only: scene_t
  implicit none
  private

  public :: find_weight_shift

contains

  subroutine find_weight_shift(comm, grid, scene, quadrature, n, patch, material, position, &
                               volume, shift)
    !! Masses that nodes have by the regions' shapes, less those of the undeformed particles, on
    !! all copies of the nodes [kg]. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    type(scene_t), intent(in) :: scene
    type(cell_quadrature_t), intent(in) :: quadrature   !! exact and not fitted
    integer, intent(in) :: n
    integer, intent(in) :: patch(n), material(n)    !! of the particles
    real(wp), intent(in) :: position(ndim, n)       !! undeformed [m]
    real(wp), intent(in) :: volume(n)               !! likewise [m3]
    real(wp), allocatable, intent(out) :: shift(:)  !! (n_node) [kg]
    real(wp), allocatable :: by_shape(:, :), by_particles(:, :), mass(:), none(:), at_rest(:, :)
    real(wp), allocatable :: both(:)                ! of all ranks
    real(wp) :: sums(2, size(scene%material))       ! masses by particles, by shapes
    integer :: m, p

    allocate (by_shape(size(scene%material), grid%n_node))
    allocate (by_particles(n_nodal_row, grid%n_node), mass(n), none(n), at_rest(max(ndim, nsig), n))
    none = 0.0_wp
    at_rest = 0.0_wp
    sums = 0.0_wp
    do p = 1, n
      mass(p) = volume(p)*scene%mixture_density(material(p), position(:, p))
      sums(1, material(p)) = sums(1, material(p)) + mass(p)
    end do
    call particles_to_grid(grid, n, patch, position, at_rest(:ndim, :), mass, none, &
                           at_rest(:nsig, :), spread(0.0_wp, 1, ndim), by_particles)
    call add_shapes(grid, scene, quadrature, by_shape, sums(2, :))
    both = [sums(1, :), sums(2, :)]
    call comm%sum_array(both)
    allocate (shift(grid%n_node))
    shift = -by_particles(1, :)
    do m = 1, size(scene%material)
      associate (particles => both(m), shapes => both(size(scene%material) + m))
        if (shapes > 0.0_wp) shift = shift + by_shape(m, :)*(particles/shapes)
      end associate
    end do
    call grid%node_map%sum_copies(comm, 1, shift)
  end subroutine find_weight_shift

  subroutine add_shapes(grid, scene, quadrature, by_shape, total)
    !! Nodal masses and total mass of every material in the parts of this rank's own cells that
    !! bear stresses [kg].
    type(grid_t), intent(in) :: grid
    type(scene_t), intent(in) :: scene
    type(cell_quadrature_t), intent(in) :: quadrature
    real(wp), intent(out) :: by_shape(:, :)   !! (materials, n_node)
    real(wp), intent(out) :: total(:)         !! (materials)
    real(wp) :: mass, centre(ndim)
    integer :: c, k, m

    by_shape = 0.0_wp
    total = 0.0_wp
    do c = 1, grid%n_cell
      if (.not. grid%cell_map%is_owned(c)) cycle
      if (.not. quadrature%measure(quadrature%host(c)) > 0.0_wp) cycle
      do k = quadrature%piece_start(c), quadrature%piece_start(c + 1) - 1
        associate (part => quadrature%piece(k)%filling, &
                   region => scene%region(quadrature%piece(k)%region))
          m = findloc(scene%material%name == region%material, .true., dim=1)
          centre = grid%origin + grid%spacing*(grid%cell_base(:, c) + part%moment/part%volume)
          mass = part%volume*grid%spacing**ndim*scene%mixture_density(m, centre)
          total(m) = total(m) + mass
          by_shape(m, grid%cell_node(:, c)) = by_shape(m, grid%cell_node(:, c)) + &
                                              mass*mean_hats(part)
        end associate
      end do
    end do
  end subroutine add_shapes

  pure function mean_hats(part) result(hat)
    !! Means of a cell's corner hats over a part of it, x fastest: exact in 1-D and 2-D, and in 3-D
    !! where the third central moment of the coordinates is 0, as in boxes along the grid [-].
    type(filling_t), intent(in) :: part
    real(wp) :: hat(2**ndim)
    real(wp) :: centroid(ndim), covariance(ndim), linear(ndim), others
    integer :: corner, d, e, f
    real(wp) :: side(ndim)

    centroid = part%moment/part%volume
    covariance = 0.0_wp
    if (ndim == 2) covariance(ndim) = part%mixed(ndim)/part%volume - product(centroid)
    if (ndim == 3) covariance = part%mixed/part%volume - cshift(centroid, 1)*cshift(centroid, 2)
    do corner = 1, 2**ndim
      do d = 1, ndim
        side(d) = merge(1.0_wp, -1.0_wp, btest(corner - 1, d - 1))
        linear(d) = merge(centroid(d), 1.0_wp - centroid(d), btest(corner - 1, d - 1))
      end do
      hat(corner) = product(linear)
      if (ndim == 2) hat(corner) = hat(corner) + product(side)*covariance(ndim)
      if (ndim < 3) cycle
      do d = 1, ndim
        e = modulo(d, ndim) + 1
        f = modulo(e, ndim) + 1
        others = side(e)*side(f)*covariance(d)
        hat(corner) = hat(corner) + linear(d)*others
      end do
    end do
  end function mean_hats
end module dosui_body_weight

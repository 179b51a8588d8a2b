!! Particles to grid: nodal mass, momentum and force.
!!
!! Particles are taken in chunks: first the weights and loads of a chunk, then its nodal sums.
!! Runs of particles in one patch are summed in a small local array that goes to the nodes when
!! the patch changes, so particles sorted by cell are fast and unsorted ones are right.
module dosui_particle_to_grid
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: n_group, n_group_wide, group_count, patch_offsets
  implicit none
  private

  public :: particles_to_grid

  integer, parameter, public :: n_nodal_row = 1 + 2*ndim   !! mass, momentum, force
  integer, parameter :: chunk = 32   ! particles, so that their weights stay in the L1 cache

contains

  subroutine particles_to_grid(grid, n, patch, position, velocity, mass, volume, stress, gravity, &
                               nodal, affine, pore_pressure, cell, cell_mean_stress, cell_stress)
    !! Nodal mass, momentum and force of this rank's particles (complete after scatter_add):
    !! m_i = sum m N_i,  p_i = sum m N_i (v + C (x_i - x)),  f_i = sum m N_i g - V sigma grad N_i.
    !!
    !! sigma is the effective stress, changed by one of these:
    !! * pore_pressure u: sigma = sigma' - u I;
    !! * cell and cell_mean_stress s: the mean normal stress over the scene's directions becomes
    !!   that of the particle's cell. With s = P(mean sigma' - u) this is the adjoint of the
    !!   averaged volume change (B-bar);
    !! * cell and cell_stress s: sigma = dev(sigma' - s), where `cell_quadrature_t` does the rest;
    !!   with pore_pressure u also - u I, where it does not.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)                       !! all in the grid
    real(wp), intent(in) :: position(ndim, n)             !! [m]
    real(wp), intent(in) :: velocity(ndim, n)             !! [m/s]
    real(wp), intent(in) :: mass(n)                       !! [kg]
    real(wp), intent(in) :: volume(n)                     !! [m3]
    real(wp), intent(in) :: stress(nsig, n)               !! effective, tension positive [Pa]
    real(wp), intent(in) :: gravity(ndim)                 !! [m/s2]
    real(wp), intent(out) :: nodal(n_nodal_row, grid%n_node)
    !! mass [kg], momentum [kg m/s], force [N]
    real(wp), intent(in), optional :: affine(ndim*ndim, n)
    !! C of APIC, component (a, b) = dv_a/dx_b at a + (b - 1) ndim [1/s]
    real(wp), intent(in), optional :: pore_pressure(n)    !! compression positive [Pa]
    integer, intent(in), optional :: cell(n)              !! all in the grid
    real(wp), intent(in), optional :: cell_mean_stress(grid%n_cell)   !! tension positive [Pa]
    real(wp), intent(in), optional :: cell_stress(nsig, grid%n_cell)  !! tension positive [Pa]
    real(wp) :: load(ndim, ndim, chunk), start(ndim, chunk), slope(ndim, ndim, chunk)
    integer :: first, last, m

    nodal = 0.0_wp
    slope = 0.0_wp
    do first = 1, n, chunk
      last = min(first + chunk - 1, n)
      m = last - first + 1
      call internal_loads(m, volume(first:last), stress(:, first:last), load)
      if (present(cell_stress)) then
        call keep_deviation(m, volume(first:last), cell(first:last), grid%n_cell, cell_stress, load)
        if (present(pore_pressure)) then
          call add_pressure(m, volume(first:last), pore_pressure(first:last), load)
        end if
      else if (present(cell_mean_stress)) then
        call replace_mean(m, volume(first:last), cell(first:last), grid%n_cell, cell_mean_stress, &
                          load)
      else if (present(pore_pressure)) then
        call add_pressure(m, volume(first:last), pore_pressure(first:last), load)
      end if
      start(:, 1:m) = velocity(:, first:last)
      if (present(affine)) then
        call expand_affine(m, grid%origin, grid%spacing, patch(first:last), grid%n_patch, &
                           grid%patch_base, position(:, first:last), affine(:, first:last), &
                           start, slope)
      end if
      call spread_chunk(grid, group_count(grid%shape_kind), first, m, patch(first:last), &
                        position(:, first:last), mass(first:last), gravity, start, slope, load, &
                        nodal)
    end do
  end subroutine particles_to_grid

  pure subroutine internal_loads(m, volume, stress, load)
    !! Kernel: -V sigma as a full tensor.
    integer, intent(in) :: m
    real(wp), intent(in) :: volume(m), stress(nsig, m)
    real(wp), intent(inout) :: load(ndim, ndim, chunk)
    integer :: a, b, p

    do p = 1, m
      do b = 1, ndim
        do a = 1, ndim
          load(a, b, p) = -volume(p)*stress(voigt_slot(a, b), p)
        end do
      end do
    end do
  end subroutine internal_loads

  pure subroutine add_pressure(m, volume, pressure, load)
    !! Kernel: adds V u I.
    integer, intent(in) :: m
    real(wp), intent(in) :: volume(m), pressure(m)
    real(wp), intent(inout) :: load(ndim, ndim, chunk)
    integer :: a, p

    do p = 1, m
      do a = 1, ndim
        load(a, a, p) = load(a, a, p) + volume(p)*pressure(p)
      end do
    end do
  end subroutine add_pressure

  pure subroutine keep_deviation(m, volume, cell, n_cell, cell_stress, load)
    !! Kernel: leaves -V dev(sigma - s) of -V sigma.
    integer, intent(in) :: m, n_cell
    integer, intent(in) :: cell(m)
    real(wp), intent(in) :: volume(m), cell_stress(nsig, n_cell)
    real(wp), intent(inout) :: load(ndim, ndim, chunk)
    real(wp) :: mean
    integer :: a, b, p

    do p = 1, m
      mean = 0.0_wp
      do b = 1, ndim
        do a = 1, ndim
          load(a, b, p) = load(a, b, p) + volume(p)*cell_stress(voigt_slot(a, b), cell(p))
        end do
        mean = mean + load(b, b, p)
      end do
      do a = 1, ndim
        load(a, a, p) = load(a, a, p) - mean*(1.0_wp/ndim)
      end do
    end do
  end subroutine keep_deviation

  pure subroutine replace_mean(m, volume, cell, n_cell, mean_stress, load)
    !! Kernel: gives -V sigma the cell's mean normal stress.
    integer, intent(in) :: m, n_cell
    integer, intent(in) :: cell(m)
    real(wp), intent(in) :: volume(m), mean_stress(n_cell)
    real(wp), intent(inout) :: load(ndim, ndim, chunk)
    real(wp) :: mean, change
    integer :: a, p

    do p = 1, m
      mean = 0.0_wp
      do a = 1, ndim
        mean = mean + load(a, a, p)
      end do
      change = -volume(p)*mean_stress(cell(p)) - mean*(1.0_wp/ndim)
      do a = 1, ndim
        load(a, a, p) = load(a, a, p) + change
      end do
    end do
  end subroutine replace_mean

  pure subroutine expand_affine(m, origin, spacing, patch, n_patch, patch_base, position, affine, &
                                start, slope)
    !! Kernel: the affine velocity v + C (x_i - x) as a value at the base node and a slope per
    !! node spacing.
    integer, intent(in) :: m, n_patch
    real(wp), intent(in) :: origin(ndim), spacing
    integer, intent(in) :: patch(m), patch_base(ndim, n_patch)
    real(wp), intent(in) :: position(ndim, m), affine(ndim, ndim, m)
    real(wp), intent(inout) :: start(ndim, chunk)     !! v on entry, value at the base on return
    real(wp), intent(inout) :: slope(ndim, ndim, chunk)
    real(wp) :: to_base
    integer :: b, p

    do p = 1, m
      do b = 1, ndim
        to_base = origin(b) + spacing*patch_base(b, patch(p)) - position(b, p)
        start(:, p) = start(:, p) + affine(:, b, p)*to_base
        slope(:, b, p) = spacing*affine(:, b, p)
      end do
    end do
  end subroutine expand_affine

  subroutine spread_chunk(grid, n_groups, number, m, patch, position, mass, gravity, start, slope, &
                          load, nodal)
    !! Weights of a chunk and its nodal sums, run by run of particles in one patch.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n_groups, number, m   !! number of the first particle
    integer, intent(in) :: patch(m)
    real(wp), intent(in) :: position(ndim, m), mass(m), gravity(ndim)
    real(wp), intent(in) :: start(ndim, chunk), slope(ndim, ndim, chunk), load(ndim, ndim, chunk)
    real(wp), intent(inout) :: nodal(n_nodal_row, grid%n_node)
    real(wp) :: weight(n_group*n_group_wide*chunk), gradient(n_group*n_group_wide*ndim*chunk)
    real(wp) :: offset(n_group*n_group_wide*ndim)
    integer :: first, last, g, n_node

    n_node = size(grid%patch_node, 1)
    call patch_offsets(grid%shape_kind, n_groups, offset)
    call grid%weigh(number, m, patch, position, n_groups, weight, gradient)
    first = 1
    do while (first <= m)
      last = first
      do while (last < m)
        if (patch(last + 1) /= patch(first)) exit
        last = last + 1
      end do
      do g = 1, n_groups
        call spread_run(g, n_groups, offset, first, last, weight, gradient, mass, gravity, start, &
                        slope, load, n_node, grid%patch_node(1, patch(first)), grid%n_node, nodal)
      end do
      first = last + 1
    end do
  end subroutine spread_chunk

  pure subroutine spread_run(g, n_groups, offset, first, last, weight, gradient, mass, gravity, &
                             start, slope, load, n_patch_node, patch_node, n_node, nodal)
    !! Kernel: sums of particles that share a patch, vectorised over one group of its nodes.
    integer, intent(in) :: g, n_groups, first, last
    real(wp), intent(in) :: offset(n_group, n_groups, ndim)
    real(wp), intent(in) :: weight(n_group, n_groups, last), mass(last), gravity(ndim)
    real(wp), intent(in) :: gradient(n_group, n_groups, ndim, last)
    real(wp), intent(in) :: start(ndim, last), slope(ndim, ndim, last), load(ndim, ndim, last)
    integer, intent(in) :: n_patch_node, patch_node(n_patch_node), n_node
    real(wp), intent(inout) :: nodal(n_nodal_row, n_node)
    real(wp) :: sums(n_group, n_nodal_row), share(n_group), momentum(n_group), force(n_group)
    integer :: a, b, i, node, p

    sums = 0.0_wp
    do p = first, last
      share = mass(p)*weight(:, g, p)
      sums(:, 1) = sums(:, 1) + share
      do a = 1, ndim
        momentum = start(a, p)
        force = 0.0_wp
        do b = 1, ndim
          momentum = momentum + slope(a, b, p)*offset(:, g, b)
          force = force + load(a, b, p)*gradient(:, g, b, p)
        end do
        sums(:, 1 + a) = sums(:, 1 + a) + share*momentum
        sums(:, 1 + ndim + a) = sums(:, 1 + ndim + a) + force
      end do
    end do
    do a = 1, ndim
      sums(:, 1 + ndim + a) = sums(:, 1 + ndim + a) + gravity(a)*sums(:, 1)
    end do
    do i = 1, min(n_group, n_patch_node - n_group*(g - 1))
      node = patch_node(n_group*(g - 1) + i)
      nodal(:, node) = nodal(:, node) + sums(i, :)
    end do
  end subroutine spread_run
end module dosui_particle_to_grid

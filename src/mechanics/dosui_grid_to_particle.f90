!! Grid to particles: velocities, displacements, strain increments and the affine matrix.
!!
!! Particles are taken in chunks: weights, interpolation, and what follows from it. Nodal values
!! of a patch are loaded once for a run of particles that share it.
module dosui_grid_to_particle
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, nshear, axis, voigt_slot
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: shape_bspline, shape_linear, n_group, n_group_wide, &
                                   group_count, patch_offsets
  implicit none
  private

  public :: grid_to_particles

  integer, parameter :: chunk = 32   ! particles, so that their weights stay in the L1 cache
  real(wp), parameter :: equal_shares = 1.0e-13_wp   !! round-off of means of equal times [-]

contains

  subroutine grid_to_particles(grid, n, patch, dt, flip_fraction, velocity_old, velocity_new, &
                               moves, position, velocity, displacement, strain_increment, affine, &
                               spin, share)
    !! Particles after a step: with alpha = flip_fraction (FLIP 1, PIC and APIC 0)
    !! v = alpha v + sum N_i (v_i_new - alpha v_i_old), u and x grow by dt sum N_i v_i_new,
    !! strain increment dt sym(L) and spin dt skew(L) of L = sum v_i_new (x) grad N_i.
    !!
    !! The affine matrix of APIC is B D^-1 with D over all nodes of the patch [Jiang2015]:
    !! D = h^2/4 I for B-splines and depends on the place for GIMP; for linear hats B D^-1 is L
    !! itself. L does not serve GIMP: a body that turns freely then gains energy.
    !!
    !! With alpha of AFLIP that differs from node to node, every node keeps its share of what the
    !! particle's own affine field has beside the node's velocity:
    !! v = sum N_i v_i_new + sum N_i alpha_i (v + C (x_i - x) - v_i_old).
    !! Momentum is then exact, since `particles_to_grid` made sum m N_i (v + C (x_i - x)) of it.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)                            !! all in the grid
    real(wp), intent(in) :: dt                                 !! [s]
    real(wp), intent(in) :: flip_fraction                      !! [-]
    real(wp), intent(in) :: velocity_old(ndim, grid%n_node)    !! before the step [m/s]
    real(wp), intent(in) :: velocity_new(ndim, grid%n_node)    !! after the step [m/s]
    logical, intent(in) :: moves                               !! positions follow (updated mode)
    real(wp), intent(inout) :: position(ndim, n)               !! [m]
    real(wp), intent(inout) :: velocity(ndim, n)               !! [m/s]
    real(wp), intent(inout) :: displacement(ndim, n)           !! [m]
    real(wp), intent(inout) :: strain_increment(nsig, n)       !! tension positive, 2 x shear [-]
    real(wp), intent(inout), optional :: affine(ndim*ndim, n)
    !! C of APIC, component (a, b) = dv_a/dx_b at a + (b - 1) ndim [1/s]
    real(wp), intent(inout), optional :: spin(nshear, n)
    !! (dv_a/dx_b - dv_b/dx_a) dt/2 for (a, b) = (x, y), (y, z), (z, x); 2-D: (z, x) [-]
    real(wp), intent(in), optional :: share(grid%n_node)
    !! alpha of nodes: with `affine` and flip_fraction = 0 [-]
    real(wp) :: mean(ndim, chunk), change(ndim, chunk), slope(ndim, ndim, chunk)
    real(wp) :: moment(ndim, ndim, chunk), kept(chunk), lever(ndim, chunk)
    integer :: first, last, m
    logical :: has_moments

    has_moments = present(affine) .and. grid%shape_kind /= shape_linear
    do first = 1, n, chunk
      last = min(first + chunk - 1, n)
      m = last - first + 1
      call gather_chunk(grid, group_count(grid%shape_kind), first, m, patch(first:last), &
                        position(:, first:last), flip_fraction, velocity_old, velocity_new, &
                        has_moments, mean, change, slope, moment, kept, lever, share)
      if (present(share)) then
        call keep_own_fields(m, grid%origin, grid%spacing, patch(first:last), grid%n_patch, &
                             grid%patch_base, position(:, first:last), kept, lever, &
                             velocity(:, first:last), affine(:, first:last), change)
      end if
      if (has_moments) then
        call invert_moments(grid, first, m, patch(first:last), position(:, first:last), mean, &
                            moment, slope, affine(:, first:last))
      else if (present(affine)) then
        affine(:, first:last) = reshape(slope(:, :, 1:m), [ndim*ndim, m])
      end if
      if (present(spin)) call set_spin(m, dt, slope, spin(:, first:last))
      call set_strain(m, dt, slope, strain_increment(:, first:last))
      velocity(:, first:last) = flip_fraction*velocity(:, first:last) + change(:, 1:m)
      displacement(:, first:last) = displacement(:, first:last) + dt*mean(:, 1:m)
      if (moves) position(:, first:last) = position(:, first:last) + dt*mean(:, 1:m)
    end do
  end subroutine grid_to_particles

  subroutine gather_chunk(grid, n_groups, number, m, patch, position, flip_fraction, &
                          velocity_old, velocity_new, has_moments, mean, change, slope, moment, &
                          kept, lever, share)
    !! Weights of a chunk and its interpolated values, run by run of particles in one patch.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n_groups, number, m   !! number of the first particle
    integer, intent(in) :: patch(m)
    real(wp), intent(in) :: position(ndim, m), flip_fraction
    real(wp), intent(in) :: velocity_old(ndim, grid%n_node), velocity_new(ndim, grid%n_node)
    logical, intent(in) :: has_moments
    real(wp), intent(inout) :: mean(ndim, chunk), change(ndim, chunk)
    real(wp), intent(inout) :: slope(ndim, ndim, chunk), moment(ndim, ndim, chunk)
    real(wp), intent(inout) :: kept(chunk), lever(ndim, chunk)   !! with shares only
    real(wp), intent(in), optional :: share(grid%n_node)
    real(wp) :: weight(n_group*n_group_wide*chunk), gradient(n_group*n_group_wide*ndim*chunk)
    real(wp) :: offset(n_group*n_group_wide*ndim)
    real(wp) :: alpha   ! of all nodes of a patch [-]
    logical :: differs
    integer :: first, last, g, n_node, p

    n_node = size(grid%patch_node, 1)
    call patch_offsets(grid%shape_kind, n_groups, offset)
    call grid%weigh(number, m, patch, position, n_groups, weight, gradient)
    alpha = flip_fraction
    differs = .false.
    mean(:, 1:m) = 0.0_wp
    change(:, 1:m) = 0.0_wp
    slope(:, :, 1:m) = 0.0_wp
    if (has_moments) moment(:, :, 1:m) = 0.0_wp
    if (present(share)) then
      kept(1:m) = 0.0_wp
      lever(:, 1:m) = 0.0_wp
    end if
    first = 1
    do while (first <= m)
      last = first
      do while (last < m)
        if (patch(last + 1) /= patch(first)) exit
        last = last + 1
      end do
      if (present(share)) then
        call find_share(n_node, grid%patch_node(1, patch(first)), grid%n_node, share, alpha, &
                        differs)
        if (.not. differs) then   ! sum N_i = 1 and sum N_i x_i = x
          do p = first, last
            kept(p) = alpha
            lever(:, p) = ((position(:, p) - grid%origin)/grid%spacing - &
                           grid%patch_base(:, patch(p)))*alpha
          end do
        end if
      end if
      do g = 1, n_groups
        call gather_run(g, n_groups, first, last, weight, gradient, n_node, &
                        grid%patch_node(1, patch(first)), alpha, grid%n_node, &
                        velocity_old, velocity_new, mean, change, slope)
        if (has_moments) then
          call gather_moments(g, n_groups, offset, first, last, weight, n_node, &
                              grid%patch_node(1, patch(first)), grid%n_node, velocity_new, moment)
        end if
        if (differs) then
          call gather_shares(g, n_groups, offset, first, last, weight, n_node, &
                             grid%patch_node(1, patch(first)), grid%n_node, share, velocity_old, &
                             kept, lever, change)
        end if
      end do
      first = last + 1
    end do
  end subroutine gather_chunk

  pure subroutine find_share(n_patch_node, patch_node, n_node, share, alpha, differs)
    !! Kernel: alpha that all nodes of a patch have but for round-off, or 0 where they differ: the
    !! common case needs no sums of its own.
    integer, intent(in) :: n_patch_node, patch_node(n_patch_node), n_node
    real(wp), intent(in) :: share(n_node)
    real(wp), intent(out) :: alpha
    logical, intent(out) :: differs
    real(wp) :: least, most
    integer :: i

    least = share(patch_node(1))
    most = least
    do i = 2, n_patch_node
      least = min(least, share(patch_node(i)))
      most = max(most, share(patch_node(i)))
    end do
    differs = most - least > equal_shares*most
    alpha = merge(0.0_wp, most, differs)
  end subroutine find_share

  pure subroutine gather_run(g, n_groups, first, last, weight, gradient, n_patch_node, patch_node, &
                             flip_fraction, n_node, velocity_old, velocity_new, mean, change, slope)
    !! Kernel: adds what one group of nodes gives to particles that share a patch.
    integer, intent(in) :: g, n_groups, first, last
    real(wp), intent(in) :: weight(n_group, n_groups, last)
    real(wp), intent(in) :: gradient(n_group, n_groups, ndim, last)
    integer, intent(in) :: n_patch_node, patch_node(n_patch_node), n_node
    real(wp), intent(in) :: flip_fraction
    real(wp), intent(in) :: velocity_old(ndim, n_node), velocity_new(ndim, n_node)
    real(wp), intent(inout) :: mean(ndim, last), change(ndim, last), slope(ndim, ndim, last)
    real(wp) :: new(n_group, ndim), gain(n_group, ndim)
    integer :: a, b, i, node, p

    new = 0.0_wp
    gain = 0.0_wp
    do i = 1, min(n_group, n_patch_node - n_group*(g - 1))
      node = patch_node(n_group*(g - 1) + i)
      new(i, :) = velocity_new(:, node)
      gain(i, :) = velocity_new(:, node) - flip_fraction*velocity_old(:, node)
    end do
    do p = first, last
      do a = 1, ndim
        mean(a, p) = mean(a, p) + dot_product(weight(:, g, p), new(:, a))
        change(a, p) = change(a, p) + dot_product(weight(:, g, p), gain(:, a))
      end do
      do b = 1, ndim
        do a = 1, ndim
          slope(a, b, p) = slope(a, b, p) + dot_product(gradient(:, g, b, p), new(:, a))
        end do
      end do
    end do
  end subroutine gather_run

  pure subroutine gather_moments(g, n_groups, offset, first, last, weight, n_patch_node, &
                                 patch_node, n_node, velocity, moment)
    !! Kernel: adds one group's sum N_i v_i (x_i - x_base)/h to particles that share a patch.
    integer, intent(in) :: g, n_groups, first, last
    real(wp), intent(in) :: offset(n_group, n_groups, ndim), weight(n_group, n_groups, last)
    integer, intent(in) :: n_patch_node, patch_node(n_patch_node), n_node
    real(wp), intent(in) :: velocity(ndim, n_node)
    real(wp), intent(inout) :: moment(ndim, ndim, last)
    integer :: b, i, node, p

    do p = first, last
      do i = 1, min(n_group, n_patch_node - n_group*(g - 1))
        node = patch_node(n_group*(g - 1) + i)
        do b = 1, ndim
          moment(:, b, p) = moment(:, b, p) + weight(i, g, p)*offset(i, g, b)*velocity(:, node)
        end do
      end do
    end do
  end subroutine gather_moments

  pure subroutine gather_shares(g, n_groups, offset, first, last, weight, n_patch_node, &
                                patch_node, n_node, share, velocity_old, kept, lever, change)
    !! Kernel: adds one group's sums N_i alpha_i, N_i alpha_i (x_i - x_base)/h and
    !! - N_i alpha_i v_i_old to particles that share a patch.
    integer, intent(in) :: g, n_groups, first, last
    real(wp), intent(in) :: offset(n_group, n_groups, ndim), weight(n_group, n_groups, last)
    integer, intent(in) :: n_patch_node, patch_node(n_patch_node), n_node
    real(wp), intent(in) :: share(n_node), velocity_old(ndim, n_node)
    real(wp), intent(inout) :: kept(last), lever(ndim, last), change(ndim, last)
    real(wp) :: part(n_group), old(n_group, ndim), keeps(n_group)
    integer :: a, i, node, p

    part = 0.0_wp
    old = 0.0_wp
    do i = 1, min(n_group, n_patch_node - n_group*(g - 1))
      node = patch_node(n_group*(g - 1) + i)
      part(i) = share(node)
      old(i, :) = velocity_old(:, node)
    end do
    do p = first, last
      keeps = weight(:, g, p)*part
      kept(p) = kept(p) + sum(keeps)
      do a = 1, ndim
        lever(a, p) = lever(a, p) + dot_product(keeps, offset(:, g, a))
        change(a, p) = change(a, p) - dot_product(keeps, old(:, a))
      end do
    end do
  end subroutine gather_shares

  pure subroutine keep_own_fields(m, origin, spacing, patch, n_patch, patch_base, position, kept, &
                                  lever, velocity, affine, change)
    !! Kernel: adds sum N_i alpha_i (v + C (x_i - x)) of the particles' old fields to the change of
    !! their velocities.
    integer, intent(in) :: m, n_patch
    real(wp), intent(in) :: origin(ndim), spacing
    integer, intent(in) :: patch(m), patch_base(ndim, n_patch)
    real(wp), intent(in) :: position(ndim, m), kept(chunk), lever(ndim, chunk)
    real(wp), intent(in) :: velocity(ndim, m), affine(ndim, ndim, m)
    real(wp), intent(inout) :: change(ndim, chunk)
    real(wp) :: local
    integer :: b, p

    do p = 1, m
      change(:, p) = change(:, p) + kept(p)*velocity(:, p)
      do b = 1, ndim
        local = (position(b, p) - origin(b))/spacing - patch_base(b, patch(p))
        change(:, p) = change(:, p) + affine(:, b, p)*(spacing*(lever(b, p) - local*kept(p)))
      end do
    end do
  end subroutine keep_own_fields

  pure subroutine invert_moments(grid, number, m, patch, position, mean, moment, slope, affine)
    !! Kernel: C = sum N_i v_i (x_i - x) D^-1 with the second moments D = sum N_i (x_i - x)^2 of
    !! each direction; along folded directions, where D vanishes, the gradient itself.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: number, m   !! number of the first particle
    integer, intent(in) :: patch(m)
    real(wp), intent(in) :: position(ndim, m), mean(ndim, chunk), moment(ndim, ndim, chunk)
    real(wp), intent(in) :: slope(ndim, ndim, chunk)
    real(wp), intent(inout) :: affine(ndim, ndim, m)
    real(wp) :: local, half_domain
    integer :: b, p

    half_domain = grid%half_domain
    do p = 1, m
      do b = 1, ndim
        if (allocated(grid%domain)) half_domain = grid%domain(b, number + p - 1)
        local = (position(b, p) - grid%origin(b))/grid%spacing - grid%patch_base(b, patch(p))
        affine(:, b, p) = (moment(:, b, p) - local*mean(:, p))/ &
                          (grid%spacing*second_moment(grid%shape_kind, half_domain, local))
        if (grid%patch_fold(b, patch(p)) /= 0) affine(:, b, p) = slope(:, b, p)
      end do
    end do
  end subroutine invert_moments

  pure real(wp) function second_moment(shape_kind, half_domain, local) result(moment)
    !! Sum of N_i (x_i - x)^2 in one direction, over h^2. GIMP: the mean of the hats' s (1 - s) over
    !! the domain, and of the squared distance to its points.
    integer, intent(in) :: shape_kind        !! GIMP or B-splines
    real(wp), intent(in) :: half_domain      !! of GIMP, over h
    real(wp), intent(in) :: local            !! place in the patch, over h
    real(wp) :: distance                     ! to the next node, over h

    moment = 0.25_wp
    if (shape_kind == shape_bspline) return
    distance = abs(local - anint(local))
    if (distance < half_domain) then   ! the node lies within the domain
      moment = 0.5_wp*(distance**2 + half_domain**2)/half_domain - distance**2
    else
      moment = distance*(1.0_wp - distance)
    end if
  end function second_moment

  pure subroutine set_strain(m, dt, slope, strain_increment)
    !! Kernel: dt sym(L), shear components doubled.
    integer, intent(in) :: m
    real(wp), intent(in) :: dt, slope(ndim, ndim, chunk)
    real(wp), intent(inout) :: strain_increment(nsig, m)
    integer :: a, b, p

    do p = 1, m
      strain_increment(:, p) = 0.0_wp
      do b = 1, ndim
        do a = 1, ndim
          strain_increment(voigt_slot(a, b), p) = strain_increment(voigt_slot(a, b), p) + &
                                                  dt*slope(a, b, p)
        end do
      end do
    end do
  end subroutine set_strain

  pure subroutine set_spin(m, dt, slope, spin)
    !! Kernel: dt skew(L) for (x, y), (y, z), (z, x) or, in 2-D, (z, x).
    integer, intent(in) :: m
    real(wp), intent(in) :: dt, slope(ndim, ndim, chunk)
    real(wp), intent(inout) :: spin(nshear, m)
    integer :: a, b, p

    do p = 1, m
      do b = 1, ndim
        do a = 1, ndim
          if (axis(b) /= mod(axis(a), 3) + 1) cycle   ! one entry for each pair of directions
          spin(voigt_slot(a, b) - 3, p) = 0.5_wp*dt*(slope(a, b, p) - slope(b, a, p))
        end do
      end do
    end do
  end subroutine set_spin
end module dosui_grid_to_particle

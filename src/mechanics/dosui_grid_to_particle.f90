!! Grid to particles: velocities, displacements, strain increments and the affine matrix.
!!
!! Nodal values of a patch are loaded once for a run of particles that share it.
module dosui_grid_to_particle
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, nshear, voigt_slot
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: patch_weights, shape_bspline
  implicit none
  private

  public :: grid_to_particles, cell_divergence_centre

  integer, parameter :: chunk = 32   ! particles, so that their weights stay in the L1 cache

contains

  subroutine grid_to_particles(grid, n, patch, dt, flip_fraction, velocity_old, velocity_new, &
                               moves, position, velocity, displacement, strain_increment, affine, &
                               spin)
    !! Particles after a step: with alpha = flip_fraction (FLIP 1, PIC and APIC 0)
    !! v = alpha v + sum N_i (v_i_new - alpha v_i_old), u and x grow by dt sum N_i v_i_new,
    !! strain increment dt sym(L) and spin dt skew(L) of L = sum v_i_new (x) grad N_i.
    !!
    !! The affine matrix of APIC is B D^-1 with D over all nodes of the patch (Jiang et al. 2015):
    !! D = h^2/4 I for B-splines; for linear hats B D^-1 is L itself, which also serves GIMP.
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
    real(wp), intent(out) :: strain_increment(nsig, n)         !! tension positive, 2 x shear [-]
    real(wp), intent(inout), optional :: affine(ndim*ndim, n)
    !! C of APIC, component (a, b) = dv_a/dx_b at a + (b - 1) ndim [1/s]
    real(wp), intent(inout), optional :: spin(nshear, n)
    !! (dv_a/dx_b - dv_b/dx_a) dt/2 for (a, b) = (x, y), (y, z), (z, x); 2-D: (z, x) [-]
    real(wp) :: slope(ndim, ndim, chunk)
    integer :: first, last, m

    do first = 1, n, chunk
      last = min(first + chunk - 1, n)
      m = last - first + 1
      if (grid%width == 2) then
        call gather_chunk(grid, 2, 2**ndim, m, patch(first:last), dt, flip_fraction, velocity_old, &
                          velocity_new, moves, present(affine), position(:, first:last), &
                          velocity(:, first:last), displacement(:, first:last), slope)
      else
        call gather_chunk(grid, 3, 3**ndim, m, patch(first:last), dt, flip_fraction, velocity_old, &
                          velocity_new, moves, present(affine), position(:, first:last), &
                          velocity(:, first:last), displacement(:, first:last), slope)
      end if
    end do
  end subroutine grid_to_particles
end module dosui_grid_to_particle

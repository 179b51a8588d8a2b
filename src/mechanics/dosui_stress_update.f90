!! Stresses, volumes and porosities after a step.
module dosui_stress_update
  use dosui_kinds, only: wp
  use dosui_dimension, only: axis, n_volume, ndim, nshear, nsig, voigt_slot, volume_slot
  use dosui_error, only: error_t
  use dosui_materials, only: material_set_t
  implicit none
  private

  public :: update_stress, update_volume

  integer, parameter :: chunk = 128   ! points of a batch, so that their strains stay in the cache

contains

  subroutine update_stress(materials, n, material, strain_increment, stress, state, err, cell, &
                           cell_volume_strain, cell_shift, spin, tangent)
    !! Adds the stress increments of a step, batch by batch and material by material.
    !!
    !! With cell and cell_volume_strain the volume change of each strain is replaced by that of the
    !! particle's cell (B-bar), in equal parts over the scene's directions, so that plane and
    !! uniaxial strain stay what they are. cell_shift is added before that. With spin (updated
    !! mode) stresses, and tensors among the state variables, first turn with the material: the
    !! Jaumann rate, integrated so that rotations keep invariants exactly [HughesWinget1980].
    type(material_set_t), intent(in) :: materials
    integer, intent(in) :: n
    integer, intent(in) :: material(n)                      !! index in the set
    real(wp), intent(in) :: strain_increment(nsig, n)       !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)              !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)
    !! (n_state, n) of the materials [units of `state_units`]
    type(error_t), intent(inout) :: err
    integer, intent(in), optional :: cell(n)
    real(wp), intent(in), optional :: cell_volume_strain(:) !! (n_cell) mean of the increments [-]
    real(wp), intent(in), optional :: cell_shift(:, :)      !! (nsig, n_cell) [-]
    real(wp), intent(in), optional :: spin(nshear, n)       !! as from grid_to_particles [-]
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! as from the materials [Pa]
    real(wp) :: strain(nsig, chunk)
    integer :: first, last, m, p, here, run_end, n_state, k

    do first = 1, n, chunk
      last = min(first + chunk - 1, n)
      m = last - first + 1
      strain(:, 1:m) = strain_increment(:, first:last)
      if (present(cell_shift)) then
        do p = 1, m
          strain(:, p) = strain(:, p) + cell_shift(:, cell(first + p - 1))
        end do
      end if
      if (present(cell_volume_strain)) then
        call replace_volume_strain(m, cell(first:last), size(cell_volume_strain), &
                                   cell_volume_strain, strain)
      end if
      if (present(spin)) call rotate_tensors(m, spin(:, first:last), stress(:, first:last))
      here = first
      do while (here <= last)
        run_end = here
        do while (run_end < last)
          if (material(run_end + 1) /= material(here)) exit
          run_end = run_end + 1
        end do
        n_state = materials%item(material(here))%model%n_state()
        associate (model => materials%item(material(here))%model)
          if (present(spin) .and. allocated(model%state_tensors)) then
            do k = 1, size(model%state_tensors)
              associate (rows => state(model%state_tensors(k):model%state_tensors(k) + nsig - 1, &
                                       here:run_end))
                call rotate_tensors(run_end - here + 1, spin(:, here:run_end), rows)
              end associate
            end do
          end if
          if (present(tangent)) then
            call model%update_stress(run_end - here + 1, &
                                     strain(:, here - first + 1:run_end - first + 1), &
                                     stress(:, here:run_end), state(1:n_state, here:run_end), err, &
                                     tangent(:, :, here:run_end))
          else
            call model%update_stress(run_end - here + 1, &
                                     strain(:, here - first + 1:run_end - first + 1), &
                                     stress(:, here:run_end), state(1:n_state, here:run_end), err)
          end if
        end associate
        here = run_end + 1
      end do
    end do
  end subroutine update_stress

  pure subroutine replace_volume_strain(m, cell, n_cell, cell_volume_strain, strain)
    !! Kernel: gives strains the volume change of their cells.
    integer, intent(in) :: m, n_cell
    integer, intent(in) :: cell(m)
    real(wp), intent(in) :: cell_volume_strain(n_cell)
    real(wp), intent(inout) :: strain(nsig, chunk)
    real(wp) :: change
    integer :: a, p

    do p = 1, m
      change = cell_volume_strain(cell(p))
      do a = 1, n_volume
        change = change - strain(volume_slot(a), p)
      end do
      do a = 1, n_volume
        strain(volume_slot(a), p) = strain(volume_slot(a), p) + change*(1.0_wp/n_volume)
      end do
    end do
  end subroutine replace_volume_strain

  pure subroutine rotate_tensors(m, spin, tensor)
    !! Kernel: S = R S R^T with R = (I - W/2)^-1 (I + W/2), a rotation for any spin W.
    integer, intent(in) :: m
    real(wp), intent(in) :: spin(nshear, m)
    real(wp), intent(inout) :: tensor(nsig, m)
    real(wp) :: w(ndim, ndim), r(ndim, ndim), s(ndim, ndim), square
    integer :: a, b, p

    do p = 1, m
      w = 0.0_wp
      square = 0.0_wp
      do b = 1, ndim
        do a = 1, ndim
          if (axis(b) /= mod(axis(a), 3) + 1) cycle   ! one entry for each pair of directions
          w(a, b) = spin(voigt_slot(a, b) - 3, p)
          w(b, a) = -w(a, b)
          square = square + w(a, b)**2
        end do
      end do
      ! W^3 = -square W turns the inverse into a polynomial.
      r = (w + 0.5_wp*matmul(w, w))/(1.0_wp + 0.25_wp*square)
      do a = 1, ndim
        r(a, a) = r(a, a) + 1.0_wp
        do b = 1, ndim
          s(a, b) = tensor(voigt_slot(a, b), p)
        end do
      end do
      s = matmul(r, matmul(s, transpose(r)))
      do b = 1, ndim
        do a = 1, ndim
          tensor(voigt_slot(a, b), p) = s(a, b)
        end do
      end do
    end do
  end subroutine rotate_tensors

  pure subroutine update_volume(n, strain_increment, volume, porosity, n_inverted, cell, &
                                cell_volume_strain, first, needs_pores, closes)
    !! Kernel: V grows by the volume change of the step, grains keep theirs: (1 - n) V is constant.
    !! Particles whose volume (or pores, if they are needed) would vanish keep it and are counted.
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)       !! tension positive [-]
    real(wp), intent(inout) :: volume(n)                    !! [m3]
    real(wp), intent(inout) :: porosity(n)                  !! [-]
    integer, intent(out) :: n_inverted
    integer, intent(in), optional :: cell(n)
    real(wp), intent(in), optional :: cell_volume_strain(:) !! replaces the particles' own [-]
    integer, intent(out), optional :: first                 !! inverted particle, 0: none
    logical, intent(in), optional :: needs_pores            !! for water
    logical, intent(out), optional :: closes                !! it has volume left, but no pores
    real(wp) :: ratio, grains   ! least volume over the present one [-]
    logical :: is_wet
    integer :: a, p

    n_inverted = 0
    if (present(first)) first = 0
    if (present(closes)) closes = .false.
    is_wet = .false.
    if (present(needs_pores)) is_wet = needs_pores
    do p = 1, n
      ratio = 1.0_wp
      if (present(cell_volume_strain)) then
        ratio = ratio + cell_volume_strain(cell(p))
      else
        do a = 1, n_volume
          ratio = ratio + strain_increment(volume_slot(a), p)
        end do
      end if
      grains = merge(1.0_wp - porosity(p), 0.0_wp, is_wet)
      if (.not. (ratio > grains)) then
        n_inverted = n_inverted + 1
        if (n_inverted == 1) then
          if (present(first)) first = p
          if (present(closes)) closes = ratio > 0.0_wp
        end if
        cycle
      end if
      volume(p) = volume(p)*ratio
      porosity(p) = 1.0_wp - (1.0_wp - porosity(p))/ratio
    end do
  end subroutine update_volume
end module dosui_stress_update

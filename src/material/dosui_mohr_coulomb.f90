!! Mohr-Coulomb plasticity with a tension cut-off and softening: linear elasticity inside the
!! planes of strength, return to planes, edges and corners in principal stresses.
!!
!!     (s1 - s3)/2 + (s1 + s3)/2 sin(phi) <= c cos(phi),   s1 <= tensile strength
!!
!! With s1 >= s2 >= s3, tension positive. Plastic flow of the shear planes follows the dilation
!! angle, that of the cut-off is associated. Which planes are active is found by trying them: as
!! elasticity and planes are linear, one solution has no negative multiplier and breaks no plane
!! (Clausen et al. 2006 do the same with geometry). Cohesion and angles follow the plastic shear
!! strain at the start of the step. phi = 0 is Tresca's material.
module dosui_mohr_coulomb
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_isotropic_model, only: isotropic_model_t
  use dosui_principal, only: elastic_matrix, principal_stresses, stress_from_principal, &
                             tangent_from_principal
  implicit none
  private

  integer, parameter :: n_plane = 6   ! shear between 1-3, 1-2, 2-3, tension along 1, 2, 3
  real(wp), parameter :: slack = 1.0e-10_wp     ! of planes, over the stress [-]
  real(wp), parameter :: unlimited = 0.5_wp*huge(1.0_wp)   ! strengths beyond are none [Pa]
  integer, parameter :: plastic_strain = 1      ! state variable: plastic shear strain [-]

  type, extends(isotropic_model_t), public :: mohr_coulomb_t
    real(wp) :: cohesion = 0.0_wp          !! c at first [Pa]
    real(wp) :: friction = 0.0_wp          !! phi at first [rad]
    real(wp) :: dilation = 0.0_wp          !! psi at first [rad]
    real(wp) :: tensile_strength = huge(1.0_wp)   !! cut-off [Pa]
    real(wp) :: residual_cohesion = 0.0_wp !! after softening [Pa]
    real(wp) :: residual_friction = 0.0_wp !! likewise [rad]
    real(wp) :: softening_strain = 0.0_wp  !! plastic shear strain that softens fully; 0: none [-]
  contains
    procedure :: init => mohr_coulomb_init
    procedure :: update_stress => mohr_coulomb_update_stress
  end type mohr_coulomb_t

contains

  pure subroutine mohr_coulomb_init(self, young_modulus, poisson_ratio)
    !! Sets the elastic constants; those of strength are components.
    class(mohr_coulomb_t), intent(inout) :: self
    real(wp), intent(in) :: young_modulus   !! E, drained [Pa]
    real(wp), intent(in) :: poisson_ratio   !! nu, drained [-]

    call self%set_elasticity(young_modulus, poisson_ratio)
    self%is_nonlinear = .true.
    self%state_names = [character(len=32) :: 'plastic_shear_strain']
    self%state_units = [character(len=8) :: '-']
  end subroutine mohr_coulomb_init

  subroutine mohr_coulomb_update_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments, and their consistent tangents.
    class(mohr_coulomb_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)
    real(wp), intent(inout) :: stress(nsig, n)
    real(wp), intent(inout) :: state(:, :)
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)
    real(wp) :: elastic(nsig, nsig), trial(3), vector(3, 3), value(3), derivative(3, 3), shear
    real(wp) :: normal(3, n_plane), flow(3, n_plane), strength(n_plane)
    integer :: p
    logical :: is_elastic, is_solved

    elastic = elastic_matrix(self%lambda, self%shear)
    do p = 1, n
      stress(:, p) = stress(:, p) + matmul(elastic, strain_increment(:, p))
      if (present(tangent)) tangent(:, :, p) = elastic
      call principal_stresses(stress(:, p), trial, vector)
      call planes_of(self, state(plastic_strain, p), normal, flow, strength)
      call return_to_planes(self, trial, normal, flow, strength, value, derivative, shear, &
                            is_elastic, is_solved)
      if (is_elastic) cycle
      if (.not. is_solved) call err%set('Mohr-Coulomb: no admissible stress')
      stress(:, p) = stress_from_principal(value, vector)
      state(plastic_strain, p) = state(plastic_strain, p) + shear
      if (present(tangent)) then
        tangent(:, :, p) = tangent_from_principal(trial, vector, value, derivative, elastic)
      end if
    end do
  end subroutine mohr_coulomb_update_stress

  pure subroutine planes_of(self, strain, normal, flow, strength)
    !! Planes normal . s <= strength and their directions of plastic strain.
    type(mohr_coulomb_t), intent(in) :: self
    real(wp), intent(in) :: strain                 !! plastic, in shear [-]
    real(wp), intent(out) :: normal(3, n_plane), flow(3, n_plane), strength(n_plane)
    integer, parameter :: major(3) = [1, 1, 2], minor(3) = [3, 2, 3]
    real(wp) :: cohesion, friction, dilation, left
    integer :: k

    left = 1.0_wp   ! share of the first strength
    if (self%softening_strain > 0.0_wp) left = max(0.0_wp, 1.0_wp - strain/self%softening_strain)
    cohesion = self%residual_cohesion + left*(self%cohesion - self%residual_cohesion)
    friction = self%residual_friction + left*(self%friction - self%residual_friction)
    if (.not. self%softening_strain > 0.0_wp) then
      cohesion = self%cohesion
      friction = self%friction
    end if
    dilation = min(self%dilation*left, friction)
    normal = 0.0_wp
    flow = 0.0_wp
    do k = 1, 3
      normal(major(k), k) = 0.5_wp*(1.0_wp + sin(friction))
      normal(minor(k), k) = -0.5_wp*(1.0_wp - sin(friction))
      flow(major(k), k) = 0.5_wp*(1.0_wp + sin(dilation))
      flow(minor(k), k) = -0.5_wp*(1.0_wp - sin(dilation))
      strength(k) = cohesion*cos(friction)
      normal(k, 3 + k) = 1.0_wp
      flow(k, 3 + k) = 1.0_wp
      strength(3 + k) = self%tensile_strength
      ! the cut-off never lies behind the apex
      if (sin(friction) > 0.0_wp) strength(3 + k) = min(self%tensile_strength, &
                                                        cohesion*cos(friction)/sin(friction))
    end do
  end subroutine planes_of

  subroutine return_to_planes(self, trial, normal, flow, strength, value, derivative, shear, &
                              is_elastic, is_solved)
    !! Principal stresses on the active planes. The trial stress lies outside at least one.
    type(mohr_coulomb_t), intent(in) :: self
    real(wp), intent(in) :: trial(3)                       !! ordered [Pa]
    real(wp), intent(in) :: normal(3, n_plane), flow(3, n_plane), strength(n_plane)
    real(wp), intent(out) :: value(3)                      !! [Pa]
    real(wp), intent(out) :: derivative(3, 3)              !! of value by trial [-]
    real(wp), intent(out) :: shear                         !! plastic shear strain increment [-]
    logical, intent(out) :: is_elastic, is_solved
    real(wp) :: excess(n_plane), back(3, n_plane), allowed, limit
    integer :: active(3), i, j, k

    is_elastic = .true.
    is_solved = .false.
    value = trial
    derivative = 0.0_wp
    shear = 0.0_wp
    do k = 1, n_plane
      allowed = slack*maxval(abs(trial))
      excess(k) = -1.0_wp
      if (strength(k) < unlimited) excess(k) = dot_product(normal(:, k), trial) - strength(k)
      if (excess(k) > allowed) is_elastic = .false.
      back(:, k) = 2.0_wp*self%shear*flow(:, k) + self%lambda*sum(flow(:, k))   ! D flow
    end do
    if (is_elastic) return
    limit = slack*(maxval(abs(trial)) + maxval(abs(strength), mask=strength < unlimited))
    do i = 1, n_plane
      active = [i, 0, 0]
      call try(active(1:1))
      if (is_solved) return
    end do
    do i = 1, n_plane
      do j = i + 1, n_plane
        active = [i, j, 0]
        call try(active(1:2))
        if (is_solved) return
      end do
    end do
    do i = 1, n_plane
      do j = i + 1, n_plane
        do k = j + 1, n_plane
          active = [i, j, k]
          call try(active)
          if (is_solved) return
        end do
      end do
    end do

  contains

    subroutine try(planes)
      !! Solves with these planes active; accepts what breaks no plane and pulls none.
      integer, intent(in) :: planes(:)
      real(wp) :: matrix(size(planes), size(planes)), inverse(size(planes), size(planes))
      real(wp) :: multiplier(size(planes)), candidate(3), identity(3, 3), strain(3)
      integer :: a, b, m
      logical :: is_regular

      m = size(planes)
      if (any(strength(planes) > unlimited)) return
      do b = 1, m
        do a = 1, m
          matrix(a, b) = dot_product(normal(:, planes(a)), back(:, planes(b)))
        end do
      end do
      call invert_small(m, matrix, inverse, is_regular)
      if (.not. is_regular) return
      multiplier = matmul(inverse, excess(planes))
      if (any(multiplier < -slack*maxval(abs(multiplier)))) return
      candidate = trial - matmul(back(:, planes), multiplier)
      do a = 1, n_plane
        if (strength(a) > unlimited) cycle
        if (dot_product(normal(:, a), candidate) - strength(a) > limit) return
      end do
      if (candidate(1) < candidate(2) - limit .or. candidate(2) < candidate(3) - limit) return
      is_solved = .true.
      value = candidate
      identity = 0.0_wp
      do a = 1, 3
        identity(a, a) = 1.0_wp
      end do
      derivative = identity - matmul(matmul(back(:, planes), inverse), &
                                     transpose(normal(:, planes)))
      strain = matmul(flow(:, planes), multiplier)
      shear = maxval(strain) - minval(strain)
    end subroutine try
  end subroutine return_to_planes

  pure subroutine invert_small(n, matrix, inverse, is_regular)
    !! Inverse of a matrix of up to three rows by Gauss-Jordan with pivots.
    integer, intent(in) :: n
    real(wp), intent(in) :: matrix(n, n)
    real(wp), intent(out) :: inverse(n, n)
    logical, intent(out) :: is_regular
    real(wp) :: a(n, n), row(n), factor, scale
    integer :: i, j, pivot

    a = matrix
    inverse = 0.0_wp
    do i = 1, n
      inverse(i, i) = 1.0_wp
    end do
    scale = maxval(abs(a))
    is_regular = scale > 0.0_wp
    if (.not. is_regular) return
    do i = 1, n
      pivot = i - 1 + maxloc(abs(a(i:, i)), dim=1)
      if (.not. abs(a(pivot, i)) > 1.0e-12_wp*scale) then
        is_regular = .false.
        return
      end if
      row = a(i, :)
      a(i, :) = a(pivot, :)
      a(pivot, :) = row
      row = inverse(i, :)
      inverse(i, :) = inverse(pivot, :)
      inverse(pivot, :) = row
      factor = 1.0_wp/a(i, i)
      a(i, :) = a(i, :)*factor
      inverse(i, :) = inverse(i, :)*factor
      do j = 1, n
        if (j == i) cycle
        factor = a(j, i)
        a(j, :) = a(j, :) - factor*a(i, :)
        inverse(j, :) = inverse(j, :) - factor*inverse(i, :)
      end do
    end do
  end subroutine invert_small
end module dosui_mohr_coulomb

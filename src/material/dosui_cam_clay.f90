!! Modified Cam-clay (Roscoe & Burland 1968): q^2/M^2 + p (p - p_c) <= 0, associated.
!!
!! p and p_c are compression positive here. Elastic stiffness K = v (p + p_a)/kappa, with a small
!! p_a so that soil without stress keeps some; G follows from K at the start of a step and
!! Poisson's ratio. Volumes are integrated exactly: p + p_a grows by exp(v/kappa de), p_c by
!! exp(v/(lambda - kappa) de_p), v the specific volume at the step's start. Return mapping by
!! Newton's iterations for the plastic volume strain and the multiplier (Borja & Lee 1990).
module dosui_cam_clay
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_material_model, only: material_model_t
  use dosui_principal, only: deviator_of, elastic_matrix, tangent_from_invariants
  implicit none
  private

  integer, parameter :: yield_pressure = 1, specific_volume = 2   ! state variables
  integer, parameter :: most_iterations = 60
  real(wp), parameter :: tolerance = 1.0e-12_wp    ! of the yield function over p_c^2 [-]
  real(wp), parameter :: largest_change = 1.0_wp   ! of an exponent in one iteration [-]
  real(wp), parameter :: root_3 = sqrt(3.0_wp)

  type, extends(material_model_t), public :: cam_clay_t
    real(wp) :: ratio = 1.0_wp               !! M: q/p in the critical state [-]
    real(wp) :: compression = 0.1_wp         !! lambda: slope of virgin compression in v, ln p [-]
    real(wp) :: swelling = 0.01_wp           !! kappa: slope of swelling lines [-]
    real(wp) :: poisson_ratio = 0.3_wp       !! [-]
    real(wp) :: over_consolidation = 1.0_wp  !! p_c over that of the initial stress [-]
    real(wp) :: least_pressure = 1.0e3_wp    !! p_a [Pa]
    real(wp) :: reference_pressure = 1.0e5_wp   !! that moduli are estimated for [Pa]
  contains
    procedure :: init => cam_clay_init
    procedure :: update_stress => cam_clay_update_stress
    procedure :: tangent => cam_clay_tangent
    procedure :: start_state => cam_clay_start_state
    procedure :: constrained_modulus => cam_clay_constrained_modulus
    procedure :: shear_modulus => cam_clay_shear_modulus
    procedure :: bulk_modulus => cam_clay_bulk_modulus
  end type cam_clay_t

  type :: point_t
    !! What a return mapping needs to know of a point.
    real(wp) :: p, q, p_c          !! trial values, compression positive [Pa]
    real(wp) :: elastic, plastic   !! v/kappa and v/(lambda - kappa) [-]
    real(wp) :: shear              !! G [Pa]
  end type point_t

contains

  pure subroutine cam_clay_init(self)
    !! Names the state variables; all constants are components.
    class(cam_clay_t), intent(inout) :: self

    self%is_nonlinear = .true.
    self%is_in_cauchy = .true.   ! v and ln p of oedometer tests
    self%state_names = [character(len=32) :: 'preconsolidation_pressure', 'specific_volume']
    self%state_units = [character(len=8) :: 'Pa', '-']
  end subroutine cam_clay_init

  subroutine cam_clay_start_state(self, porosity, stress, state)
    !! The yield surface through the initial stress, times the over-consolidation ratio.
    class(cam_clay_t), intent(in) :: self
    real(wp), intent(in) :: porosity          !! [-]
    real(wp), intent(in) :: stress(nsig)      !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:)
    real(wp) :: mean, deviator(nsig), length, p

    call deviator_of(stress, mean, deviator, length)
    p = max(-mean, self%least_pressure)
    state(yield_pressure) = self%over_consolidation*(p + 3.0_wp*length**2/(self%ratio**2*p))
    state(specific_volume) = 1.0_wp/(1.0_wp - porosity)
  end subroutine cam_clay_start_state

  pure real(wp) function poisson_factor(self) result(factor)
    !! G/K of Poisson's ratio [-].
    type(cam_clay_t), intent(in) :: self

    factor = 1.5_wp*(1.0_wp - 2.0_wp*self%poisson_ratio)/(1.0_wp + self%poisson_ratio)
  end function poisson_factor

  subroutine cam_clay_update_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments, and their consistent tangents.
    class(cam_clay_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)
    real(wp), intent(inout) :: stress(nsig, n)
    real(wp), intent(inout) :: state(:, :)
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)
    type(point_t) :: point
    real(wp) :: deviator(nsig), mean, length, shrink, volume, p, q, p_c, slope(2, 2)
    integer :: i
    logical :: converged

    do i = 1, n
      volume = state(specific_volume, i)
      shrink = -sum(strain_increment(1:3, i))
      call deviator_of(stress(:, i), mean, deviator, length)
      point%elastic = volume/self%swelling
      point%plastic = volume/(self%compression - self%swelling)
      point%shear = poisson_factor(self)*point%elastic*(self%least_pressure - mean)
      point%p = (self%least_pressure - mean)*exp(point%elastic*shrink) - self%least_pressure
      point%p_c = state(yield_pressure, i)
      deviator = deviator + point%shear*strain_increment(:, i)
      deviator(1:3) = deviator(1:3) + point%shear*(strain_increment(1:3, i) + 2.0_wp*shrink/3.0_wp)
      length = sqrt(0.5_wp*sum(deviator(1:3)**2) + sum(deviator(4:)**2))
      point%q = root_3*length
      call return_to_ellipse(self, point, p, q, p_c, slope, converged)
      if (.not. converged) call err%set('modified Cam-clay: the return mapping does not converge')
      if (length > 0.0_wp) stress(:, i) = deviator*(q/point%q)
      if (.not. length > 0.0_wp) stress(:, i) = 0.0_wp
      stress(1:3, i) = stress(1:3, i) - p
      state(yield_pressure, i) = p_c
      state(specific_volume, i) = volume*exp(-shrink)
      if (present(tangent)) then
        tangent(:, :, i) = tangent_from_invariants( &
                           point%elastic*(point%p + self%least_pressure), point%shear, deviator, &
                           length, q/root_3, [slope(1, 1), -root_3*slope(1, 2)], &
                           [-slope(2, 1)/root_3, slope(2, 2)])
      end if
    end do
  end subroutine cam_clay_update_stress

  pure subroutine return_to_ellipse(self, point, p, q, p_c, slope, converged)
    !! Kernel: p, q and p_c after a trial, and the derivatives of p and q by their trials. Unknowns
    !! are the plastic volume strain x and the multiplier g: x = g (2 p - p_c), f = 0.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    real(wp), intent(out) :: p, q, p_c         !! [Pa]
    real(wp), intent(out) :: slope(2, 2)       !! of (p, q) by their trials [-]
    logical, intent(out) :: converged
    real(wp) :: x, g, p_x, p_c_x, q_g, jacobian(2, 2), residual(2), step(2), unit, right(2, 2)
    integer :: k

    p = point%p
    q = point%q
    p_c = point%p_c
    slope = reshape([1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [2, 2])
    unit = point%p_c   ! makes g a number, too
    converged = q**2/self%ratio**2 + p*(p - p_c) <= tolerance*unit**2
    if (converged) return
    x = 0.0_wp
    g = 0.0_wp
    do k = 1, most_iterations
      p = (point%p + self%least_pressure)*exp(-point%elastic*x) - self%least_pressure
      p_c = point%p_c*exp(point%plastic*x)
      associate (softening => 1.0_wp + 6.0_wp*point%shear*g/(unit*self%ratio**2))
        q = point%q/softening
        q_g = -q*6.0_wp*point%shear/(unit*self%ratio**2)/softening
      end associate
      p_x = -point%elastic*(p + self%least_pressure)
      p_c_x = point%plastic*p_c
      residual = [x - g*(2.0_wp*p - p_c)/unit, (q**2/self%ratio**2 + p*(p - p_c))/unit**2]
      jacobian(1, :) = [1.0_wp - g*(2.0_wp*p_x - p_c_x)/unit, -(2.0_wp*p - p_c)/unit]
      jacobian(2, :) = [(p_x*(2.0_wp*p - p_c) - p*p_c_x), 2.0_wp*q*q_g/self%ratio**2]/unit**2
      converged = all(abs(residual) <= tolerance)
      if (converged) exit
      step = solved(residual)
      step = step*min(1.0_wp, largest_change/ &
                      max(tiny(1.0_wp), abs(step(1))*max(point%elastic, point%plastic)))
      x = x - step(1)
      g = max(0.0_wp, g - step(2))
    end do
    associate (growth => (p + self%least_pressure)/(point%p + self%least_pressure))
      right(:, 1) = [-2.0_wp*g*growth/unit, (2.0_wp*p - p_c)*growth/unit**2]
      right(:, 2) = [0.0_wp, 2.0_wp*q**2/(self%ratio**2*max(point%q, tiny(1.0_wp)))/unit**2]
      step = -solved(right(:, 1))
      slope(:, 1) = [growth + p_x*step(1), q_g*step(2)]
      step = -solved(right(:, 2))
      slope(:, 2) = [p_x*step(1), q/max(point%q, tiny(1.0_wp)) + q_g*step(2)]
    end associate

  contains

    pure function solved(right_side) result(solution)
      !! Solution with the Jacobian at hand.
      real(wp), intent(in) :: right_side(2)
      real(wp) :: solution(2), determinant

      determinant = jacobian(1, 1)*jacobian(2, 2) - jacobian(1, 2)*jacobian(2, 1)
      solution = [right_side(1)*jacobian(2, 2) - right_side(2)*jacobian(1, 2), &
                  jacobian(1, 1)*right_side(2) - jacobian(2, 1)*right_side(1)]/determinant
    end function solved
  end subroutine return_to_ellipse

  subroutine cam_clay_tangent(self, stress, state, tangent)
    !! The elastic matrix at a stress.
    class(cam_clay_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)
    real(wp), intent(in) :: state(:)
    real(wp), intent(out) :: tangent(nsig, nsig)
    real(wp) :: bulk, shear

    bulk = state(specific_volume)/self%swelling*(self%least_pressure + &
                                                 max(0.0_wp, -sum(stress(1:3))/3.0_wp))
    shear = poisson_factor(self)*bulk
    tangent = elastic_matrix(bulk - 2.0_wp*shear/3.0_wp, shear)
  end subroutine cam_clay_tangent

  pure real(wp) function cam_clay_bulk_modulus(self) result(modulus)
    !! K at the reference pressure and a specific volume of 2 [Pa].
    class(cam_clay_t), intent(in) :: self

    modulus = 2.0_wp*(self%reference_pressure + self%least_pressure)/self%swelling
  end function cam_clay_bulk_modulus

  pure real(wp) function cam_clay_shear_modulus(self) result(modulus)
    !! G, likewise [Pa].
    class(cam_clay_t), intent(in) :: self

    modulus = self%bulk_modulus()*1.5_wp*(1.0_wp - 2.0_wp*self%poisson_ratio)/ &
              (1.0_wp + self%poisson_ratio)
  end function cam_clay_shear_modulus

  pure real(wp) function cam_clay_constrained_modulus(self) result(modulus)
    !! M = K + 4 G/3, likewise [Pa].
    class(cam_clay_t), intent(in) :: self

    modulus = self%bulk_modulus() + 4.0_wp*self%shear_modulus()/3.0_wp
  end function cam_clay_constrained_modulus
end module dosui_cam_clay

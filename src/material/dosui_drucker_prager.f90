!! Drucker-Prager plasticity [Drucker1952] with a tension cut-off:
!!
!!     sqrt(J2) + eta m <= xi c,   m <= m_t          (m: mean stress, tension positive)
!!
!! eta and xi fit the cone to Mohr-Coulomb's planes: at triaxial compression, at triaxial extension,
!! or for plane strain [deSouzaNeto2008, ch. 6].
!!
!! Soil whose m_t is zero remembers by how much its volume opens at the cut-off, and carries no
!! pressure before that has closed: the opened volume is a strain that the next elastic trial still
!! has [Tampubolon2017].
module dosui_drucker_prager
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_isotropic_model, only: isotropic_model_t, opened, plastic_strain, poisson_ratio, &
                                   young_modulus
  use dosui_key_visitor, only: key, key_t, key_visitor_t, name_length
  use dosui_principal, only: deviator_of, elastic_matrix, tangent_from_invariants
  use dosui_strength, only: check_dilation, cohesion, degree, dilation_angle, flatter, &
                            friction_angle, n_strength, strength_key, tensile_strength
  implicit none
  private

  type, extends(isotropic_model_t), public :: drucker_prager_t
    character(len=name_length) :: cone = 'compression'
    !! where it meets Mohr-Coulomb's planes: 'compression', 'extension' or 'plane_strain'
    real(wp) :: eta = 0.0_wp             !! slope of the cone [-]
    real(wp) :: flow = 0.0_wp            !! slope of the plastic potential [-]
    real(wp) :: strength = 0.0_wp        !! xi c [Pa]
    real(wp) :: largest_mean = huge(1.0_wp)   !! m_t, not beyond the apex [Pa]
    logical, private :: can_open = .false.    !! m_t is zero
  contains
    procedure :: declare => drucker_prager_declare
    procedure :: key_of => drucker_prager_key_of
    procedure :: visit_options => drucker_prager_visit_options
    procedure :: check => drucker_prager_check
    procedure :: has_strength => drucker_prager_has_strength
    procedure :: prepare => drucker_prager_prepare
    procedure :: init => drucker_prager_init
    procedure :: return_stress => drucker_prager_return_stress
  end type drucker_prager_t

contains

  subroutine drucker_prager_declare(self)
    !! Elasticity and strength: without friction, cohesion and limit to tension.
    class(drucker_prager_t), intent(inout) :: self

    if (.not. allocated(self%constant)) allocate (self%constant(n_strength))
    self%constant(tensile_strength)%constant = huge(1.0_wp)
  end subroutine drucker_prager_declare

  pure function drucker_prager_key_of(self, k) result(described)
    !! Keys of elasticity and strength.
    class(drucker_prager_t), intent(in) :: self
    integer, intent(in) :: k
    type(key_t) :: described

    associate (not_used => self%strength)
    end associate
    described = strength_key(k)
  end function drucker_prager_key_of

  subroutine drucker_prager_visit_options(self, visitor, applies)
    !! The fit of the cone.
    class(drucker_prager_t), intent(inout) :: self
    class(key_visitor_t), intent(inout) :: visitor
    logical, intent(in) :: applies

    call visitor%name(self%cone, &
                      key('cone', 'where the cone meets Mohr-Coulomb''s planes', &
                          choices='compression extension plane_strain', &
                          only="model = 'drucker_prager'", applies=applies))
  end subroutine drucker_prager_visit_options

  pure subroutine drucker_prager_check(self, key, message)
    !! Dilation that would give work.
    class(drucker_prager_t), intent(in) :: self
    character(len=:), allocatable, intent(out) :: key, message

    call check_dilation(self%constant, key, message)
  end subroutine drucker_prager_check

  pure logical function drucker_prager_has_strength(self) result(has_strength)
    !! Its strength can be reduced.
    class(drucker_prager_t), intent(in) :: self

    associate (not_used => self%strength)
    end associate
    has_strength = .true.
  end function drucker_prager_has_strength

  pure subroutine drucker_prager_prepare(self)
    !! The cone of c/F, tan(phi)/F and tan(psi)/F, the tensile strength with them.
    class(drucker_prager_t), intent(inout) :: self
    real(wp) :: tension

    associate (value => self%constant%constant, factor => self%strength_reduction)
      tension = value(tensile_strength)
      if (tension < huge(1.0_wp)) tension = tension/factor
      call self%init(value(young_modulus), value(poisson_ratio), value(cohesion)/factor, &
                     flatter(value(friction_angle)*degree, factor), &
                     flatter(value(dilation_angle)*degree, factor), tension, trim(self%cone))
    end associate
  end subroutine drucker_prager_prepare

  pure subroutine drucker_prager_init(self, young, poisson, c, friction, dilation, tension, cone)
    !! Fits the cone.
    class(drucker_prager_t), intent(inout) :: self
    real(wp), intent(in) :: young, poisson       !! drained [Pa], [-]
    real(wp), intent(in) :: c                    !! cohesion [Pa]
    real(wp), intent(in) :: friction, dilation   !! phi, psi [rad]
    real(wp), intent(in) :: tension              !! largest mean stress [Pa]
    character(len=*), intent(in) :: cone
    !! 'compression', 'extension' or 'plane_strain'

    call self%set_elasticity(young, poisson)
    self%eta = slope_of(friction)
    self%flow = slope_of(dilation)
    self%strength = c*factor_of(friction)
    self%largest_mean = tension
    if (self%eta > 0.0_wp) self%largest_mean = min(tension, self%strength/self%eta)
    self%can_open = .not. self%largest_mean > 0.0_wp
    call self%name_plastic_state(self%can_open)

  contains

    pure real(wp) function slope_of(angle) result(slope)
      !! eta of an angle.
      real(wp), intent(in) :: angle

      slope = factor_of(angle)*tan(angle)
    end function slope_of

    pure real(wp) function factor_of(angle) result(factor)
      !! xi of an angle.
      real(wp), intent(in) :: angle

      select case (cone)
      case ('extension')
        factor = 6.0_wp*cos(angle)/(sqrt(3.0_wp)*(3.0_wp + sin(angle)))
      case ('plane_strain')
        factor = 3.0_wp/sqrt(9.0_wp + 12.0_wp*tan(angle)**2)
      case default   ! compression
        factor = 6.0_wp*cos(angle)/(sqrt(3.0_wp)*(3.0_wp - sin(angle)))
      end select
    end function factor_of
  end subroutine drucker_prager_init

  subroutine drucker_prager_return_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments, and their consistent tangents. Numbers cannot fail.
    class(drucker_prager_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)   !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)   !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)   !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! for 2 x shear [Pa]
    real(wp) :: elastic(nsig, nsig), deviator(nsig), trial_mean, trial_length, mean, length
    real(wp) :: of_mean(2), of_length(2), bulk, multiplier, new(nsig)
    integer :: p
    logical :: is_elastic

    if (err%failed()) return
    bulk = self%bulk_modulus()
    elastic = elastic_matrix(self%lambda, self%shear)
    do p = 1, n
      new = stress(:, p) + matmul(elastic, strain_increment(:, p))
      if (self%can_open) new(1:3) = new(1:3) + bulk*state(opened, p)   ! that must close first
      call deviator_of(new, trial_mean, deviator, trial_length)
      if (present(tangent)) tangent(:, :, p) = elastic
      if (.not. abs(trial_mean) + trial_length <= huge(1.0_wp)) then
        call self%explain('Drucker-Prager: no numbers', strain_increment(:, p), stress(:, p), &
                          state(:, p), err)
        cycle
      end if
      if (self%can_open) state(opened, p) = 0.0_wp
      stress(:, p) = new
      call return_to_cone(self, bulk, trial_mean, trial_length, mean, length, of_mean, of_length, &
                          is_elastic)
      if (is_elastic) cycle
      if (trial_length > 0.0_wp) stress(:, p) = deviator*(length/trial_length)
      stress(1:3, p) = stress(1:3, p) + mean
      if (.not. trial_length > 0.0_wp) stress(1:3, p) = mean
      multiplier = max(0.0_wp, trial_length - length)/self%shear
      state(plastic_strain, p) = state(plastic_strain, p) + multiplier
      if (self%can_open .and. .not. mean < self%largest_mean) then
        ! at the cut-off; soil that carries nothing does not dilate either
        if (length > 0.0_wp) trial_mean = trial_mean - bulk*self%flow*multiplier
        state(opened, p) = max(0.0_wp, (trial_mean - mean)/bulk)
      end if
      if (present(tangent)) then
        tangent(:, :, p) = tangent_from_invariants(bulk, self%shear, deviator, trial_length, &
                                                   length, of_mean, of_length)
      end if
    end do
  end subroutine drucker_prager_return_stress

  pure subroutine return_to_cone(self, bulk, trial_mean, trial_length, mean, length, of_mean, &
                                 of_length, is_elastic)
    !! Kernel: mean stress and sqrt(J2) on the cone, the cut-off, or the edge between them.
    type(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: bulk                         !! K [Pa]
    real(wp), intent(in) :: trial_mean, trial_length     !! [Pa]
    real(wp), intent(out) :: mean, length                !! [Pa]
    real(wp), intent(out) :: of_mean(2), of_length(2)    !! their derivatives by the trials [-]
    logical, intent(out) :: is_elastic
    real(wp) :: excess, multiplier, stiffness

    mean = trial_mean
    length = trial_length
    of_mean = [1.0_wp, 0.0_wp]
    of_length = [0.0_wp, 1.0_wp]
    excess = trial_length + self%eta*trial_mean - self%strength
    is_elastic = excess <= 0.0_wp .and. trial_mean <= self%largest_mean
    if (is_elastic) return
    if (excess > 0.0_wp) then
      stiffness = self%shear + bulk*self%eta*self%flow
      multiplier = excess/stiffness
      mean = trial_mean - bulk*self%flow*multiplier
      length = trial_length - self%shear*multiplier
      of_mean = [1.0_wp, 0.0_wp] - bulk*self%flow/stiffness*[self%eta, 1.0_wp]
      of_length = [0.0_wp, 1.0_wp] - self%shear/stiffness*[self%eta, 1.0_wp]
    end if
    if (mean <= self%largest_mean) then
      length = max(0.0_wp, length)   ! below zero by round-off only: the cut-off ends at the apex
      return
    end if
    mean = self%largest_mean   ! the cut-off, and its edge with the cone
    of_mean = 0.0_wp
    length = trial_length
    of_length = [0.0_wp, 1.0_wp]
    if (length + self%eta*mean >= self%strength) then
      length = max(0.0_wp, self%strength - self%eta*mean)
      of_length = 0.0_wp
    end if
  end subroutine return_to_cone
end module dosui_drucker_prager

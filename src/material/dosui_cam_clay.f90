!! Modified Cam-clay [Roscoe1968]: q^2/M^2 + p (p - p_c) <= 0, associated.
!!
!! p and p_c are compression positive here. Elastic stiffness K = v (p + p_a)/kappa, with a small
!! p_a so that soil without stress keeps some; G follows from K at the start of a step and
!! Poisson's ratio. Volumes are integrated exactly: p + p_a grows by exp(v/kappa de), p_c by
!! exp(v/(lambda - kappa) de_p), v the specific volume at the step's start. Return mapping by
!! Newton's iterations for the plastic volume strain and the multiplier [Borja1990]; where
!! these fail (soil with almost no p_c, increments that would multiply p), by bisection.
module dosui_cam_clay
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_key_visitor, only: key, key_t
  use dosui_material_model, only: material_model_t
  use dosui_principal, only: deviator_of, elastic_matrix, tangent_from_invariants
  use dosui_shared_keys, only: shared_key
  implicit none
  private

  ! constants
  integer, parameter :: poisson_ratio = 1, critical_state_ratio = 2, lambda = 3, &
                        kappa = 4, over_consolidation_ratio = 5, least_pressure = 6, &
                        reference_pressure = 7, n_constant = 7
  integer, parameter :: yield_pressure = 1, specific_volume = 2   ! state variables
  integer, parameter :: most_iterations = 60
  integer, parameter :: most_doublings = 400, most_bisections = 200
  real(wp), parameter :: tolerance = 1.0e-12_wp    ! of the yield function over p_c^2 [-]
  real(wp), parameter :: largest_change = 1.0_wp   ! of an exponent in one iteration [-]
  real(wp), parameter :: largest_growth = 100.0_wp ! of exponents, so that nothing overflows [-]
  real(wp), parameter :: least_multiplier = 1.0e-16_wp      ! where the bisection begins [-]
  real(wp), parameter :: regular = 1.0e-14_wp      ! determinants beyond, over their terms [-]
  real(wp), parameter :: largest_pressure = 1.0e15_wp       ! [Pa]
  real(wp), parameter :: least_yield = 1.0e-6_wp   ! of p_c over p_a: torn soil keeps that [-]
  real(wp), parameter :: least_stiffness = 1.0e-3_wp   ! p + p_a of pulled initial states, over p_a
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
    procedure :: declare => cam_clay_declare
    procedure :: key_of => cam_clay_key_of
    procedure :: check => cam_clay_check
    procedure :: prepare => cam_clay_prepare
    procedure :: init => cam_clay_init
    procedure :: return_stress => cam_clay_return_stress
    procedure :: elastic_tangent => cam_clay_elastic_tangent
    procedure :: start_state => cam_clay_start_state
    procedure :: shear_modulus => cam_clay_shear_modulus
    procedure :: bulk_modulus => cam_clay_bulk_modulus
  end type cam_clay_t

  type :: point_t
    !! What a return mapping needs to know of a point.
    real(wp) :: base               !! p + p_a before, compression positive [Pa]
    real(wp) :: growth             !! of its logarithm if the increment were elastic [-]
    real(wp) :: q                  !! trial value [Pa]
    real(wp) :: p_c, least         !! before, and the least it can become [Pa]
    real(wp) :: elastic, plastic   !! v/kappa and v/(lambda - kappa) [-]
    real(wp) :: shear              !! G [Pa]
  end type point_t

  type :: system_t
    !! Stresses for some plastic volume strain x and multiplier g, and how far from a solution.
    real(wp) :: p, q, p_c             !! [Pa]
    real(wp) :: p_x, q_g, softening   !! derivatives [Pa], and trial q over q [-]
    real(wp) :: residual(2)           !! of flow and yield function over p_c**2 [-]
    real(wp) :: jacobian(2, 2)        !! of the residual by x and g
  end type system_t

  type :: return_t
    !! Where a return mapping ends.
    real(wp) :: p = 0.0_wp, q = 0.0_wp, p_c = 0.0_wp   !! [Pa]
    real(wp) :: slope(2, 2) = 0.0_wp
    !! derivatives of (p, q) by their trials; those by p over (p + p_a)/(trial p + p_a) [-]
    logical :: converged = .false.
  end type return_t

contains

  subroutine cam_clay_declare(self)
    !! Constants with their defaults.
    class(cam_clay_t), intent(inout) :: self

    if (.not. allocated(self%constant)) allocate (self%constant(n_constant))
    associate (value => self%constant)
      value(critical_state_ratio)%constant = 1.25_wp
      value(lambda)%constant = 0.1_wp
      value(kappa)%constant = 0.01_wp
      value(over_consolidation_ratio)%constant = 1.0_wp
      value(least_pressure)%constant = 1.0e3_wp
      value(reference_pressure)%constant = 1.0e5_wp
    end associate
  end subroutine cam_clay_declare

  pure function cam_clay_key_of(self, k) result(described)
    !! Keys of the constants.
    class(cam_clay_t), intent(in) :: self
    integer, intent(in) :: k
    type(key_t) :: described

    associate (not_used => self%ratio)
    end associate
    select case (k)
    case (poisson_ratio)
      described = shared_key('poisson_ratio')
    case (critical_state_ratio)
      described = shared_key('critical_state_ratio')
      described%is_required = .true.
    case (lambda)
      described = key('lambda', 'virgin compression in specific volume over ln p; C_c = 2.303 '// &
                      'lambda', unit='-', range='> 0', required=.true., &
                      former='compression_index')
    case (kappa)
      described = key('kappa', 'swelling, likewise; below lambda', unit='-', range='> 0', &
                      required=.true., former='swelling_index')
    case (over_consolidation_ratio)
      described = key('over_consolidation_ratio', 'size of the yield surface over that through '// &
                      'the initial stress', unit='-', range='>= 1')
    case (least_pressure)
      described = key('least_pressure', 'added to p in the elastic stiffness', unit='Pa', &
                      range='> 0')
    case default
      described = shared_key('reference_pressure')
    end select
  end function cam_clay_key_of

  pure subroutine cam_clay_check(self, key, message)
    !! Swelling beyond compression.
    class(cam_clay_t), intent(in) :: self
    character(len=:), allocatable, intent(out) :: key, message

    key = 'kappa'
    message = ''
    associate (swelling => self%constant(kappa), &
               compression => self%constant(lambda))
      if (swelling%varies() .or. compression%varies()) return
      if (.not. swelling%constant < compression%constant) then
        message = 'must be below lambda'
      end if
    end associate
  end subroutine cam_clay_check

  pure subroutine cam_clay_prepare(self)
    !! The model's constants from those of the scene.
    class(cam_clay_t), intent(inout) :: self

    associate (value => self%constant%constant)
      self%poisson_ratio = value(poisson_ratio)
      self%ratio = value(critical_state_ratio)
      self%compression = value(lambda)
      self%swelling = value(kappa)
      self%over_consolidation = value(over_consolidation_ratio)
      self%least_pressure = value(least_pressure)
      self%reference_pressure = value(reference_pressure)
    end associate
    call self%init()
  end subroutine cam_clay_prepare

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
    real(wp), intent(inout) :: state(:)   !! [units of `state_units`]
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

  subroutine cam_clay_return_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments, and their consistent tangents. Fails, and leaves the
    !! point as it is, where pores close or stresses grow without end.
    class(cam_clay_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)   !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)   !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)   !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! for 2 x shear [Pa]
    type(point_t) :: point
    type(return_t) :: to
    real(wp) :: deviator(nsig), length, ratio, volume
    integer :: i

    if (present(tangent)) tangent = 0.0_wp   ! of points that fail
    do i = 1, n
      volume = state(specific_volume, i)* &
               exp(min(largest_growth, sum(strain_increment(1:3, i))))
      call find_trial(self, strain_increment(:, i), stress(:, i), state(:, i), point, deviator, &
                      length)
      call return_to_ellipse(self, point, present(tangent), to)
      call judge(self, strain_increment(:, i), stress(:, i), state(:, i), volume, to, err)
      if (err%failed()) return
      ratio = 0.0_wp
      if (length > 0.0_wp) ratio = to%q/point%q
      stress(:, i) = deviator*ratio
      stress(1:3, i) = stress(1:3, i) - to%p
      state(yield_pressure, i) = to%p_c
      state(specific_volume, i) = volume
      if (present(tangent)) then
        tangent(:, :, i) = tangent_from_invariants( &
                           point%elastic*(to%p + self%least_pressure), point%shear, deviator, &
                           length, to%q/root_3, [to%slope(1, 1), -root_3*to%slope(1, 2)], &
                           [-to%slope(2, 1)/root_3, to%slope(2, 2)])
      end if
    end do
  end subroutine cam_clay_return_stress

  pure subroutine find_trial(self, strain, stress, state, point, deviator, length)
    !! The elastic trial of an increment.
    type(cam_clay_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig), stress(nsig), state(:)
    type(point_t), intent(out) :: point
    real(wp), intent(out) :: deviator(nsig), length   !! of the trial stress, and sqrt(J2) [Pa]
    real(wp) :: mean, shrink

    shrink = -sum(strain(1:3))
    call deviator_of(stress, mean, deviator, length)
    ! admissible stresses have p >= 0; others (given at the start) keep some stiffness
    point%base = max(self%least_pressure - mean, least_stiffness*self%least_pressure)
    point%elastic = state(specific_volume)/self%swelling
    point%plastic = state(specific_volume)/(self%compression - self%swelling)
    point%shear = poisson_factor(self)*point%elastic*point%base
    point%growth = point%elastic*shrink
    point%p_c = state(yield_pressure)
    point%least = least_yield*self%least_pressure
    deviator = deviator + point%shear*strain
    deviator(1:3) = deviator(1:3) + point%shear*(strain(1:3) + 2.0_wp*shrink/3.0_wp)
    length = sqrt(0.5_wp*sum(deviator(1:3)**2) + sum(deviator(4:)**2))
    point%q = root_3*length
  end subroutine find_trial

  subroutine judge(self, strain, stress, state, volume, to, err)
    !! Words for what cannot be, before it is.
    type(cam_clay_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig), stress(nsig), state(:)   !! before
    real(wp), intent(in) :: volume   !! specific, after
    type(return_t), intent(in) :: to
    type(error_t), intent(inout) :: err
    character(len=*), parameter :: name = 'modified Cam-clay: '

    if (.not. volume > 1.0_wp) then
      call self%explain(name//'the pores close', strain, stress, state, err)
    else if (.not. (to%p < largest_pressure .and. to%q < largest_pressure)) then
      call self%explain(name//'stresses grow beyond any soil''s', strain, stress, state, err)
    else if (.not. to%converged) then
      call self%explain(name//'no admissible stress', strain, stress, state, err)
    end if
  end subroutine judge

  pure subroutine return_to_ellipse(self, point, with_slope, to)
    !! Kernel: p, q and p_c after a trial. Unknowns are the plastic volume strain x and the
    !! multiplier g (times the first p_c): x = g (2 p - p_c), f = 0. Newton's iterations from the
    !! trial, or bisection where they fail.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    logical, intent(in) :: with_slope
    type(return_t), intent(out) :: to
    type(system_t) :: system
    real(wp) :: g, largest

    to%p = -self%least_pressure
    if (point%growth < largest_growth) then
      to%p = point%base*exp(point%growth) - self%least_pressure
      to%q = point%q
      to%p_c = point%p_c
      ! slopes are those by the trial's p, over (p + p_a)/(p_trial + p_a)
      to%slope = reshape([1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [2, 2])
      largest = largest_pressure*max(1.0_wp, self%ratio)
      to%converged = .false.
      if (abs(to%p) < largest .and. to%q < largest) then
        to%converged = to%q**2/self%ratio**2 + to%p*(to%p - to%p_c) <= tolerance*to%p_c**2
      end if
      if (to%converged) return
      call iterate(self, point, system, g, to%converged)
    end if
    if (.not. to%converged) call bisect(self, point, system, g, to%converged)
    if (.not. to%converged .and. .not. point%growth < largest_growth) to%p = huge(1.0_wp)
    if (.not. to%converged) return
    to%p = system%p
    to%q = system%q
    to%p_c = system%p_c
    if (with_slope) call find_slope(self, point, system, g, to%slope)
  end subroutine return_to_ellipse

  pure function system_at(self, point, x, g) result(system)
    !! Kernel: stresses, residuals and their derivatives.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    real(wp), intent(in) :: x, g
    type(system_t) :: system
    real(wp) :: softening, p_x, p_c_x, q_g

    associate (s => system, m_2 => self%ratio**2, unit => point%p_c)
      s%p = point%base*exp(min(largest_growth, point%growth - point%elastic*x)) - &
            self%least_pressure
      s%p_c = point%p_c*exp(min(largest_growth, point%plastic*x))
      p_c_x = point%plastic*s%p_c
      if (s%p_c < point%least) then
        s%p_c = point%least
        p_c_x = 0.0_wp
      end if
      softening = 1.0_wp + 6.0_wp*point%shear*g/(unit*m_2)
      s%q = point%q/softening
      q_g = -s%q*6.0_wp*point%shear/(unit*m_2)/softening
      p_x = -point%elastic*(s%p + self%least_pressure)
      s%softening = softening
      s%p_x = p_x
      s%q_g = q_g
      s%residual = [x - g*(2.0_wp*s%p - s%p_c)/unit, &
                    (s%q**2/m_2 + s%p*(s%p - s%p_c))/unit**2]
      s%jacobian(1, :) = [1.0_wp - g*(2.0_wp*p_x - p_c_x)/unit, -(2.0_wp*s%p - s%p_c)/unit]
      s%jacobian(2, :) = [p_x*(2.0_wp*s%p - s%p_c) - s%p*p_c_x, 2.0_wp*s%q*q_g/m_2]/unit**2
    end associate
  end function system_at

  pure subroutine iterate(self, point, system, g, converged)
    !! Kernel: Newton's iterations from the trial, with limited changes.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    type(system_t), intent(out) :: system   !! at the solution
    real(wp), intent(out) :: g
    logical, intent(out) :: converged
    real(wp) :: x, step(2), size
    integer :: k
    logical :: can_solve

    x = 0.0_wp
    g = 0.0_wp
    converged = .false.
    do k = 1, most_iterations
      system = system_at(self, point, x, g)
      size = (system%p_c/point%p_c)**2
      converged = abs(system%residual(1)) <= tolerance .and. &
                  abs(system%residual(2)) <= tolerance*size
      if (converged) return
      call solve(system%jacobian, system%residual, step, can_solve)
      if (.not. can_solve) return
      step = step*min(1.0_wp, largest_change/ &
                      max(tiny(1.0_wp), abs(step(1))*max(point%elastic, point%plastic)))
      x = x - step(1)
      g = max(0.0_wp, g - step(2))
    end do
  end subroutine iterate

  pure subroutine bisect(self, point, system, g, converged)
    !! Kernel: the least multiplier with f = 0. As it grows without end, the stress goes to
    !! q = 0 at the critical p, where f < 0: there is one. Slow, and never fails.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    type(system_t), intent(out) :: system   !! at the solution
    real(wp), intent(out) :: g
    logical, intent(out) :: converged
    real(wp) :: x, low, high, middle
    integer :: k

    low = 0.0_wp
    high = least_multiplier
    do k = 1, most_doublings
      x = volume_of(self, point, high)
      system = system_at(self, point, x, high)
      if (.not. system%residual(2) > 0.0_wp) exit
      low = high
      high = 2.0_wp*high
    end do
    converged = .not. system%residual(2) > 0.0_wp
    g = high
    if (.not. converged) return
    do k = 1, most_bisections
      middle = 0.5_wp*(low + high)
      if (.not. (middle > low .and. middle < high)) exit
      x = volume_of(self, point, middle)
      system = system_at(self, point, x, middle)
      if (system%residual(2) > 0.0_wp) then
        low = middle
      else
        high = middle
      end if
    end do
    g = high
    x = volume_of(self, point, g)
    system = system_at(self, point, x, g)
  end subroutine bisect

  pure real(wp) function volume_of(self, point, g) result(x)
    !! Kernel: the plastic volume strain of a multiplier: x - g (2 p - p_c) grows with x.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    real(wp), intent(in) :: g
    type(system_t) :: system
    real(wp) :: low, high, next
    integer :: k

    ! 2 p - p_c falls with x: it is negative at the one end and positive at the other
    high = max(0.0_wp, (point%growth + log(2.0_wp*point%base/point%p_c))/ &
               (point%elastic + point%plastic))
    low = min(0.0_wp, (point%growth - log((0.5_wp*point%p_c + self%least_pressure)/point%base))/ &
              point%elastic)
    x = 0.0_wp
    if (point%growth > 0.0_wp) x = high
    do k = 1, most_bisections
      system = system_at(self, point, x, g)
      if (system%residual(1) > 0.0_wp) then
        high = x
      else
        low = x
      end if
      next = x - system%residual(1)/system%jacobian(1, 1)
      if (.not. (next > low .and. next < high) .or. mod(k, 3) == 0) next = 0.5_wp*(low + high)
      if (abs(next - x) <= epsilon(1.0_wp)*abs(x)) exit
      x = next
    end do
  end function volume_of

  pure subroutine find_slope(self, point, system, g, slope)
    !! Kernel: derivatives of p and q by their trials at the solution.
    type(cam_clay_t), intent(in) :: self
    type(point_t), intent(in) :: point
    type(system_t), intent(in) :: system
    real(wp), intent(in) :: g
    real(wp), intent(out) :: slope(2, 2)   !! [-]; by p over the growth of p + p_a
    real(wp) :: right(2, 2), step(2)
    logical :: can_solve

    slope = 0.0_wp
    associate (unit => point%p_c, from_q => 1.0_wp/system%softening)
      right(:, 1) = [-2.0_wp*g/unit, (2.0_wp*system%p - system%p_c)/unit**2]
      right(:, 2) = [0.0_wp, 2.0_wp*system%q*from_q/self%ratio**2/unit**2]
      call solve(system%jacobian, right(:, 1), step, can_solve)
      if (.not. can_solve) return   ! a limit point of softening
      slope(:, 1) = [1.0_wp - system%p_x*step(1), -system%q_g*step(2)]
      call solve(system%jacobian, right(:, 2), step, can_solve)
      slope(:, 2) = [-system%p_x*step(1), from_q - system%q_g*step(2)]
    end associate
  end subroutine find_slope

  pure subroutine solve(matrix, right_side, solution, is_regular)
    !! Kernel: solution of a system of two equations.
    real(wp), intent(in) :: matrix(2, 2), right_side(2)
    real(wp), intent(out) :: solution(2)
    logical, intent(out) :: is_regular
    real(wp) :: a, b

    a = matrix(1, 1)*matrix(2, 2)
    b = matrix(1, 2)*matrix(2, 1)
    is_regular = abs(a - b) > regular*(abs(a) + abs(b))
    solution = 0.0_wp
    if (.not. is_regular) return
    solution = [right_side(1)*matrix(2, 2) - right_side(2)*matrix(1, 2), &
                matrix(1, 1)*right_side(2) - matrix(2, 1)*right_side(1)]/(a - b)
  end subroutine solve

  subroutine cam_clay_elastic_tangent(self, stress, state, tangent)
    !! The elastic matrix at a stress.
    class(cam_clay_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)   !! effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)   !! [units of `state_units`]
    real(wp), intent(out) :: tangent(nsig, nsig)   !! for 2 x shear [Pa]
    real(wp) :: bulk, shear

    bulk = state(specific_volume)/self%swelling*(self%least_pressure + &
                                                 max(0.0_wp, -sum(stress(1:3))/3.0_wp))
    shear = poisson_factor(self)*bulk
    tangent = elastic_matrix(bulk - 2.0_wp*shear/3.0_wp, shear)
  end subroutine cam_clay_elastic_tangent

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
end module dosui_cam_clay

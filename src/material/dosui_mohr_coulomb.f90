!! Mohr-Coulomb plasticity with a tension cut-off and softening: linear elasticity inside the
!! planes of strength, return to planes, edges and corners in principal stresses.
!!
!!     (s1 - s3)/2 + (s1 + s3)/2 sin(phi) <= c cos(phi),   s1 <= tensile strength
!!
!! With s1 >= s2 >= s3, tension positive. Plastic flow of the shear planes follows the dilation
!! angle, that of the cut-off is associated. Which planes are active is found by trying them: as
!! elasticity and planes are linear, one solution has no negative multiplier and breaks no plane
!! ([Clausen2006] do the same with geometry). The likely ones come first. Cohesion and angles
!! follow the plastic shear strain at the start of the step. phi = 0 is Tresca's material.
!!
!! Soil without any tensile strength (cut-off at zero) that comes apart remembers by how much its
!! volume has opened: it carries nothing before that has closed [Tampubolon2017]. The opened
!! volume is a strain that the next elastic trial still has.
module dosui_mohr_coulomb
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_error, only: error_t
  use dosui_isotropic_model, only: isotropic_model_t, opened, plastic_strain, poisson_ratio, &
                                   young_modulus
  use dosui_key_visitor, only: key, key_t, key_visitor_t
  use dosui_principal, only: elastic_matrix, principal_stresses, stress_from_principal, &
                             tangent_from_principal
  use dosui_strength, only: check_dilation, cohesion, degree, dilation_angle, flatter, &
                            friction_angle, n_strength, strength_key, tensile_strength
  implicit none
  private

  ! constants after those of elasticity and strength
  integer, parameter :: softening_displacement = n_strength + 1, &
                        softening_strain = n_strength + 2, residual_cohesion = n_strength + 3, &
                        residual_friction_angle = n_strength + 4, n_constant = n_strength + 4
  character(len=*), parameter :: when_softening = 'softening_displacement or softening_strain > 0'
  integer, parameter :: n_plane = 6   ! shear between 1-3, 1-2, 2-3, tension along 1, 2, 3
  integer, parameter :: n_set = 41    ! of up to three planes
  integer, parameter :: sets(n_set) = [ &   ! their numbers as digits: likely ones, then all others
                        1, 12, 13, 456, 4, 14, 45, 124, 134, 145, 123, 2, 3, 5, &
                        6, 15, 16, 23, 24, 25, 26, 34, 35, 36, 46, 56, 125, 126, &
                        135, 136, 146, 156, 234, 235, 236, 245, 246, 256, 345, 346, 356]
  real(wp), parameter :: slack = 1.0e-10_wp   ! of planes, over the stress [-]
  integer, parameter :: refinements = 2
  integer, parameter :: most_attempts = 5     ! with refined solutions and ten times the slack each
  real(wp), parameter :: round_off = 1.0e-13_wp   ! of stresses, over the bulk modulus [-]
  real(wp), parameter :: regular = 1.0e-12_wp   ! pivots and determinants beyond, over the entries
  real(wp), parameter :: of_band = 1.0_wp/6.0_wp
  !! variance across a band over its width squared, that of a linear shape function [-]
  real(wp), parameter :: unlimited = 0.5_wp*huge(1.0_wp)   ! strengths beyond are none [Pa]

  type :: planes_t
    !! Planes normal . s <= strength and their plastic flow.
    real(wp) :: normal(3, n_plane)
    real(wp) :: flow(3, n_plane)             !! direction of the plastic strain
    real(wp) :: back(3, n_plane)             !! elastic stress of that strain [Pa]
    real(wp) :: product(n_plane, n_plane)    !! normal^T back [Pa]
    real(wp) :: strength(n_plane)            !! [Pa]
    logical :: is_limited(n_plane)           !! the others have no strength that counts
  end type planes_t
  type, extends(isotropic_model_t), public :: mohr_coulomb_t
    real(wp) :: cohesion = 0.0_wp          !! c at first [Pa]
    real(wp) :: friction = 0.0_wp          !! phi at first [rad]
    real(wp) :: dilation = 0.0_wp          !! psi at first [rad]
    real(wp) :: tensile_strength = huge(1.0_wp)   !! cut-off [Pa]
    real(wp) :: residual_cohesion = 0.0_wp !! after softening [Pa]
    real(wp) :: residual_friction = 0.0_wp !! likewise [rad]
    real(wp) :: softening_strain = 0.0_wp  !! plastic shear strain that softens fully; 0: none [-]
    real(wp) :: softening_width = 0.0_wp   !! over which strains are averaged; 0: none [m]
    logical, private :: can_open = .false. !! the cut-off is, or can come to lie, at zero
  contains
    procedure :: declare => mohr_coulomb_declare
    procedure :: key_of => mohr_coulomb_key_of
    procedure :: visit_options => mohr_coulomb_visit_options
    procedure :: check => mohr_coulomb_check
    procedure :: has_strength => mohr_coulomb_has_strength
    procedure :: prepare => mohr_coulomb_prepare
    procedure :: init => mohr_coulomb_init
    procedure :: return_stress => mohr_coulomb_return_stress
    procedure, private :: softens => mohr_coulomb_softens
  end type mohr_coulomb_t

contains

  subroutine mohr_coulomb_declare(self)
    !! Elasticity and strength: without friction, cohesion and limit to tension.
    class(mohr_coulomb_t), intent(inout) :: self

    if (.not. allocated(self%constant)) allocate (self%constant(n_constant))
    self%constant(tensile_strength)%constant = huge(1.0_wp)
  end subroutine mohr_coulomb_declare

  pure function mohr_coulomb_key_of(self, k) result(described)
    !! Keys of elasticity and strength.
    class(mohr_coulomb_t), intent(in) :: self
    integer, intent(in) :: k
    type(key_t) :: described

    select case (k)
    case (softening_displacement)
      described = key('softening_displacement', 'displacement across a shear band over which '// &
                      'cohesion and friction fall to their residual values: a plastic shear '// &
                      'strain of this over softening_width; 0: they do not', unit='m', &
                      range='>= 0')
    case (softening_strain)
      described = key('softening_strain', 'plastic shear strain in place of '// &
                      'softening_displacement; bands narrow with the grid''s spacing, and so '// &
                      'does what softening takes', unit='-', range='>= 0')
    case (residual_cohesion)
      described = key('residual_cohesion', 'c after softening', unit='Pa', range='>= 0', &
                      only=when_softening, applies=self%softens())
    case (residual_friction_angle)
      described = key('residual_friction_angle', 'phi after softening', unit='deg', &
                      range='>= 0 and < 90', only=when_softening, applies=self%softens())
    case default
      described = strength_key(k)
    end select
  end function mohr_coulomb_key_of

  subroutine mohr_coulomb_visit_options(self, visitor, applies)
    !! The width of bands.
    class(mohr_coulomb_t), intent(inout) :: self
    class(key_visitor_t), intent(inout) :: visitor
    logical, intent(in) :: applies
    logical :: is_used

    is_used = applies .and. allocated(self%constant)
    if (is_used) is_used = self%softens()
    call visitor%real(self%softening_width, &
                      key('softening_width', 'width of shear bands, whatever the grid: '// &
                          'softening follows the mean of the plastic shear strain over it; '// &
                          'up to the grid''s spacing, or 0: the spacing, without means', &
                          unit='m', range='>= 0', only=when_softening, applies=is_used))
  end subroutine mohr_coulomb_visit_options

  pure subroutine mohr_coulomb_check(self, key, message)
    !! Dilation that would give work, two measures of softening.
    class(mohr_coulomb_t), intent(in) :: self
    character(len=:), allocatable, intent(out) :: key, message

    call check_dilation(self%constant, key, message)
    if (len(message) > 0) return
    key = 'softening_strain'
    if (self%constant(softening_strain)%constant > 0.0_wp .and. &
        self%constant(softening_displacement)%constant > 0.0_wp) then
      message = 'does not go with softening_displacement'
    end if
  end subroutine mohr_coulomb_check

  pure logical function mohr_coulomb_has_strength(self) result(has_strength)
    !! Its strength can be reduced.
    class(mohr_coulomb_t), intent(in) :: self

    associate (not_used => self%cohesion)
    end associate
    has_strength = .true.
  end function mohr_coulomb_has_strength

  pure logical function mohr_coulomb_softens(self) result(softens)
    !! Do cohesion and friction fall with plastic strains?
    class(mohr_coulomb_t), intent(in) :: self

    associate (strain => self%constant(softening_strain), &
               displacement => self%constant(softening_displacement))
      softens = strain%constant > 0.0_wp .or. displacement%constant > 0.0_wp .or. &
                strain%varies() .or. displacement%varies()
    end associate
  end function mohr_coulomb_softens

  pure subroutine mohr_coulomb_prepare(self)
    !! The planes' constants: c/F and tan(phi)/F, before and after softening, and the dilation and
    !! the tensile strength with them. Bands of shear are about one spacing of the grid wide,
    !! whatever that is, so a displacement across them is a property of the soil where a strain is
    !! one of the grid. Where the soil has a width of its own, means over it add what the grid's
    !! bands lack.
    class(mohr_coulomb_t), intent(inout) :: self
    real(wp) :: width   ! of bands [m]

    width = max(self%softening_width, self%band_width)
    associate (value => self%constant%constant, factor => self%strength_reduction)
      self%cohesion = value(cohesion)/factor
      self%friction = flatter(value(friction_angle)*degree, factor)
      self%dilation = flatter(value(dilation_angle)*degree, factor)
      self%tensile_strength = value(tensile_strength)
      if (value(tensile_strength) < huge(1.0_wp)) then
        self%tensile_strength = value(tensile_strength)/factor
      end if
      self%residual_cohesion = value(residual_cohesion)/factor
      self%residual_friction = flatter(value(residual_friction_angle)*degree, factor)
      self%softening_strain = value(softening_strain)
      if (value(softening_displacement) > 0.0_wp) then
        self%softening_strain = value(softening_displacement)/width
      end if
      self%mean_state = 0
      self%mean_variance = of_band*(width**2 - self%band_width**2)
      call self%init(value(young_modulus), value(poisson_ratio))
    end associate
  end subroutine mohr_coulomb_prepare

  pure subroutine mohr_coulomb_init(self, young, poisson)
    !! Sets the elastic constants; those of strength are components.
    class(mohr_coulomb_t), intent(inout) :: self
    real(wp), intent(in) :: young     !! E, drained [Pa]
    real(wp), intent(in) :: poisson   !! nu, drained [-]

    call self%set_elasticity(young, poisson)
    self%can_open = .not. self%tensile_strength > 0.0_wp
    if (self%friction > 0.0_wp .and. .not. self%cohesion > 0.0_wp) self%can_open = .true.
    if (self%softening_strain > 0.0_wp .and. self%residual_friction > 0.0_wp .and. &
        .not. self%residual_cohesion > 0.0_wp) self%can_open = .true.
    call self%name_plastic_state(self%can_open)
    if (.not. self%mean_variance > 0.0_wp) return
    if (.not. self%softens()) return
    self%mean_of = plastic_strain
    self%mean_state = size(self%state_names) + 1
    self%state_names = [self%state_names, [character(len=32) :: 'mean_plastic_shear_strain']]
    self%state_units = [self%state_units, [character(len=8) :: '-']]
  end subroutine mohr_coulomb_init

  subroutine mohr_coulomb_return_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments, and their consistent tangents.
    class(mohr_coulomb_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)   !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)   !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)   !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! for 2 x shear [Pa]
    real(wp) :: elastic(nsig, nsig), trial(3), vector(3, 3), value(3), strain(3), inverse(3, 3)
    real(wp) :: bulk, new(nsig)
    type(planes_t) :: planes
    integer :: active(3), p, softened_by
    logical :: is_elastic, is_solved

    elastic = elastic_matrix(self%lambda, self%shear)
    bulk = self%bulk_modulus()
    call find_planes(self, 0.0_wp, planes)
    softened_by = merge(self%mean_state, plastic_strain, self%mean_state > 0)
    do p = 1, n
      new = stress(:, p) + matmul(elastic, strain_increment(:, p))
      if (self%can_open) new(1:3) = new(1:3) + bulk*state(opened, p)   ! that must close first
      if (present(tangent)) tangent(:, :, p) = elastic
      call principal_stresses(new, trial, vector)
      if (self%softening_strain > 0.0_wp) call find_planes(self, state(softened_by, p), planes)
      call return_to_planes(trial, planes, value, strain, active, inverse, is_elastic, is_solved)
      if (.not. (is_solved .and. abs(sum(new)) <= huge(1.0_wp))) then   ! the latter: numbers
        call self%explain('Mohr-Coulomb: no admissible stress', strain_increment(:, p), &
                          stress(:, p), state(:, p), err)
        cycle
      end if
      if (self%can_open) state(opened, p) = 0.0_wp
      stress(:, p) = new
      if (is_elastic) cycle
      stress(:, p) = stress_from_principal(value, vector)
      state(plastic_strain, p) = state(plastic_strain, p) + (maxval(strain) - minval(strain))
      if (self%can_open) then
        if (is_apart(trial, value, planes, bulk)) state(opened, p) = max(0.0_wp, sum(strain))
      end if
      if (present(tangent)) then
        tangent(:, :, p) = tangent_from_principal(trial, vector, value, &
                                                  derivative_of(planes, active, inverse), elastic)
      end if
    end do
  end subroutine mohr_coulomb_return_stress

  pure subroutine find_planes(self, plastic, planes)
    !! The planes after some plastic strain.
    type(mohr_coulomb_t), intent(in) :: self
    real(wp), intent(in) :: plastic                 !! in shear [-]
    type(planes_t), intent(out) :: planes
    integer, parameter :: major(3) = [1, 1, 2], minor(3) = [3, 2, 3]
    real(wp) :: cohesion, friction, dilation, left
    integer :: k

    left = 1.0_wp   ! share of the first strength
    cohesion = self%cohesion
    friction = self%friction
    if (self%softening_strain > 0.0_wp) then
      left = max(0.0_wp, 1.0_wp - plastic/self%softening_strain)
      cohesion = self%residual_cohesion + left*(self%cohesion - self%residual_cohesion)
      friction = self%residual_friction + left*(self%friction - self%residual_friction)
    end if
    dilation = min(self%dilation*left, friction)
    planes%normal = 0.0_wp
    planes%flow = 0.0_wp
    do k = 1, 3
      planes%normal(major(k), k) = 0.5_wp*(1.0_wp + sin(friction))
      planes%normal(minor(k), k) = -0.5_wp*(1.0_wp - sin(friction))
      planes%flow(major(k), k) = 0.5_wp*(1.0_wp + sin(dilation))
      planes%flow(minor(k), k) = -0.5_wp*(1.0_wp - sin(dilation))
      planes%strength(k) = cohesion*cos(friction)
      planes%normal(k, 3 + k) = 1.0_wp
      planes%flow(k, 3 + k) = 1.0_wp
      planes%strength(3 + k) = self%tensile_strength
      ! the cut-off never lies behind the apex
      if (sin(friction) > 0.0_wp) then
        planes%strength(3 + k) = min(self%tensile_strength, cohesion*cos(friction)/sin(friction))
      end if
    end do
    planes%is_limited = planes%strength < unlimited
    do k = 1, n_plane
      planes%back(:, k) = 2.0_wp*self%shear*planes%flow(:, k) + self%lambda*sum(planes%flow(:, k))
    end do
    planes%product = matmul(transpose(planes%normal), planes%back)
  end subroutine find_planes

  pure subroutine return_to_planes(trial, planes, value, strain, active, inverse, is_elastic, &
                                   is_solved)
    !! Principal stresses on the active planes.
    real(wp), intent(in) :: trial(3)             !! ordered, largest first [Pa]
    type(planes_t), intent(in) :: planes
    real(wp), intent(out) :: value(3)            !! [Pa]
    real(wp), intent(out) :: strain(3)           !! plastic, principal [-]
    integer, intent(out) :: active(3)            !! planes, 0: fewer
    real(wp), intent(out) :: inverse(3, 3)       !! of their part of planes%product [1/Pa]
    logical, intent(out) :: is_elastic, is_solved
    real(wp) :: excess(n_plane), scale, limit(n_plane)
    real(wp) :: allowed
    integer :: attempt, k, set
    logical :: is_upper

    value = trial
    strain = 0.0_wp
    active = 0
    inverse = 0.0_wp
    is_solved = .false.
    scale = max(abs(trial(1)), abs(trial(3)))
    excess = excess_of(planes, trial)
    is_elastic = max(excess(1), excess(4)) <= slack*scale   ! the others have less
    is_solved = is_elastic
    if (is_elastic) return
    call return_to_corner(planes, excess, value, strain, active, inverse, is_solved)
    if (is_solved) return
    limit = slack*(scale + abs(planes%strength))   ! of unlimited ones: not used
    is_upper = trial(1) - trial(2) < trial(2) - trial(3)
    do attempt = 0, most_attempts
      allowed = 10.0_wp**max(0, attempt - 1)
      do k = 1, n_set
        set = sets(k)
        if (k == 2 .and. is_upper) set = sets(3)   ! the nearer edge first
        if (k == 3 .and. is_upper) set = sets(2)
        active = [mod(set, 10), mod(set/10, 10), set/100]
        call try_planes(trial, planes, excess, allowed*limit, allowed*slack, attempt > 0, active, &
                        value, strain, inverse, is_solved)
        if (is_solved) return
      end do
    end do
  end subroutine return_to_planes

  pure subroutine return_to_corner(planes, excess, value, strain, active, inverse, is_solved)
    !! Where the elastic strain beyond the cut-off's corner has no negative component, its three
    !! planes are active and no others. Their equations lose as many digits as moduli are apart, and
    !! then leave stresses, and jumps of these; the corner itself is known.
    type(planes_t), intent(in) :: planes
    real(wp), intent(in) :: excess(n_plane)             !! of the trial, ordered [Pa]
    real(wp), intent(inout) :: value(3), strain(3)      !! set if it is so
    integer, intent(inout) :: active(3)                 !! likewise
    real(wp), intent(inout) :: inverse(3, 3)            !! likewise [1/Pa]
    logical, intent(out) :: is_solved
    real(wp) :: lambda, shear, share, mean, volume
    integer :: a

    is_solved = .false.
    if (.not. (planes%is_limited(4) .and. excess(6) > 0.0_wp)) return
    lambda = planes%product(4, 5)
    shear = 0.5_wp*(planes%product(4, 4) - lambda)
    share = lambda/(3.0_wp*lambda + 2.0_wp*shear)
    if (.not. excess(6) >= share*sum(excess(4:6))) return
    is_solved = .true.
    value = planes%strength(4:6)
    mean = sum(excess(4:6))/3.0_wp
    volume = 3.0_wp*mean/(3.0_wp*lambda + 2.0_wp*shear)
    strain = (excess(4:6) - mean)/(2.0_wp*shear) + volume/3.0_wp
    active = [4, 5, 6]
    inverse = -share/(2.0_wp*shear)
    do a = 1, 3
      inverse(a, a) = (1.0_wp - share)/(2.0_wp*shear)
    end do
  end subroutine return_to_corner

  pure function excess_of(planes, stress) result(excess)
    !! How far principal stresses lie beyond the planes [Pa].
    type(planes_t), intent(in) :: planes
    real(wp), intent(in) :: stress(3)
    real(wp) :: excess(n_plane)
    integer :: k

    do k = 1, n_plane
      excess(k) = -1.0_wp
      if (planes%is_limited(k)) then
        excess(k) = planes%normal(1, k)*stress(1) + planes%normal(2, k)*stress(2) + &
                    planes%normal(3, k)*stress(3) - planes%strength(k)
      end if
    end do
  end function excess_of

  pure subroutine try_planes(trial, planes, excess, limit, pull, is_refined, active, value, &
                             strain, inverse, is_solved)
    !! Solves with these planes active; accepts what breaks no plane and pulls none.
    real(wp), intent(in) :: trial(3)
    type(planes_t), intent(in) :: planes
    real(wp), intent(in) :: excess(n_plane), limit(n_plane)   !! [Pa]
    real(wp), intent(in) :: pull             !! least multiplier over the largest one [-]
    logical, intent(in) :: is_refined        !! solved to round-off where moduli are far apart
    integer, intent(in) :: active(3)
    real(wp), intent(inout) :: value(3), strain(3)      !! set if accepted
    real(wp), intent(out) :: inverse(3, 3)
    logical, intent(out) :: is_solved
    real(wp) :: multiplier(3), candidate(3), correction(n_plane)
    integer :: a, b, n
    logical :: is_regular

    is_solved = .false.
    n = count(active > 0)
    do a = 1, n
      if (.not. planes%is_limited(active(a))) return
    end do
    if (n == 1) then
      inverse(1, 1) = 1.0_wp/planes%product(active(1), active(1))
      multiplier(1) = inverse(1, 1)*excess(active(1))
      if (multiplier(1) < 0.0_wp) return
    else
      do b = 1, n
        do a = 1, n
          inverse(a, b) = planes%product(active(a), active(b))
        end do
      end do
      call invert_small(n, inverse, is_regular)
      if (.not. is_regular) return
      multiplier(1:n) = matmul(inverse(1:n, 1:n), excess(active(1:n)))
      if (minval(multiplier(1:n)) < -pull*maxval(abs(multiplier(1:n)))) return
    end if
    candidate = trial
    do a = 1, n
      candidate = candidate - planes%back(:, active(a))*multiplier(a)
    end do
    if (is_refined) then
      do b = 1, refinements
        correction = excess_of(planes, candidate)
        correction(1:n) = matmul(inverse(1:n, 1:n), correction(active(1:n)))
        multiplier(1:n) = multiplier(1:n) + correction(1:n)
        do a = 1, n
          candidate = candidate - planes%back(:, active(a))*correction(a)
        end do
      end do
      if (minval(multiplier(1:n)) < -pull*maxval(abs(multiplier(1:n)))) return
    end if
    if (candidate(1) < candidate(2) - limit(1) .or. candidate(2) < candidate(3) - limit(1)) return
    if (any(excess_of(planes, candidate) > limit)) return
    is_solved = .true.
    value = candidate
    strain = 0.0_wp
    do a = 1, n
      strain = strain + planes%flow(:, active(a))*multiplier(a)
    end do
  end subroutine try_planes

  pure logical function is_apart(trial, value, planes, bulk)
    !! Does the soil carry nothing at all, since its cut-off lies at zero?
    real(wp), intent(in) :: trial(3), value(3)   !! [Pa]
    type(planes_t), intent(in) :: planes
    real(wp), intent(in) :: bulk                 !! modulus [Pa]

    is_apart = planes%strength(4) <= 0.0_wp .and. &
               maxval(abs(value)) <= slack*maxval(abs(trial)) + round_off*bulk
  end function is_apart

  pure function derivative_of(planes, active, inverse) result(derivative)
    !! Derivative of the principal stresses by the trial ones [-].
    type(planes_t), intent(in) :: planes
    integer, intent(in) :: active(3)
    real(wp), intent(in) :: inverse(3, 3)   !! of the active part of planes%product [1/Pa]
    real(wp) :: derivative(3, 3)
    integer :: a, n

    n = count(active > 0)
    derivative = -matmul(matmul(planes%back(:, active(1:n)), inverse(1:n, 1:n)), &
                         transpose(planes%normal(:, active(1:n))))
    do a = 1, 3
      derivative(a, a) = derivative(a, a) + 1.0_wp
    end do
  end function derivative_of

  pure subroutine invert_small(n, matrix, is_regular)
    !! Replaces the first n rows and columns of a matrix by their inverse; three by Gauss-Jordan
    !! with pivots.
    integer, intent(in) :: n                        !! 2 or 3
    real(wp), intent(inout) :: matrix(3, 3)
    logical, intent(out) :: is_regular
    real(wp) :: a(3, 6), row(6), scale, determinant
    integer :: i, j, pivot

    is_regular = .false.
    if (n == 2) then
      determinant = matrix(1, 1)*matrix(2, 2) - matrix(1, 2)*matrix(2, 1)
      scale = abs(matrix(1, 1)*matrix(2, 2)) + abs(matrix(1, 2)*matrix(2, 1))
      if (.not. abs(determinant) > regular*scale) return
      is_regular = .true.
      scale = 1.0_wp/determinant
      matrix(1:2, 1:2) = reshape([matrix(2, 2), -matrix(2, 1), -matrix(1, 2), matrix(1, 1)], &
                                 [2, 2])*scale
      return
    end if
    a = 0.0_wp
    a(:, 1:3) = matrix
    do j = 1, 3
      a(j, 3 + j) = 1.0_wp
    end do
    scale = maxval(abs(matrix))
    do i = 1, 3
      pivot = i
      do j = i + 1, 3
        if (abs(a(j, i)) > abs(a(pivot, i))) pivot = j
      end do
      if (.not. abs(a(pivot, i)) > regular*scale) return
      row = a(pivot, :)/a(pivot, i)
      a(pivot, :) = a(i, :)
      a(i, :) = row
      do j = 1, 3
        if (j /= i) a(j, :) = a(j, :) - a(j, i)*row
      end do
    end do
    is_regular = .true.
    matrix = a(:, 4:)
  end subroutine invert_small
end module dosui_mohr_coulomb

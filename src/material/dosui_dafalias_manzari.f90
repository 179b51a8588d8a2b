!! The sand model of Dafalias & Manzari [Dafalias2004]: stress-ratio plasticity with a critical
!! state, bounding and dilatancy surfaces, and a fabric tensor that dilation builds and reversals
!! feel.
!!
!! In this module stresses and strains are compression positive and shear strains are tensor
!! components. Within an increment, sub-steps of 2^-k of it keep the error of modified Euler's rule
!! below a tolerance [Sloan2001]; since sizes are powers of two, stresses are smooth
!! functions of the increment but for rare jumps of the size of the error. An elastic part of a
!! sub-step ends where it meets the yield surface. Afterwards the thin yield surface is put back
!! around the stress (drift). The mean stress never falls below `smallest_pressure`; there the
!! stress ratio follows the yield surface instead.
module dosui_dafalias_manzari
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig, voigt6
  use dosui_error, only: error_t
  use dosui_key_visitor, only: key, key_t, restart_free
  use dosui_material_model, only: material_model_t
  use dosui_principal, only: elastic_matrix
  use dosui_shared_keys, only: shared_key
  implicit none
  private

  ! constants
  integer, parameter :: poisson_ratio = 1, critical_state_ratio = 2, shear_modulus_number = 3, &
                        extension_ratio = 4, critical_void_ratio = 5, critical_slope = 6, &
                        critical_exponent = 7, yield_ratio = 8, hardening_number = 9, &
                        hardening_void_factor = 10, bounding_exponent = 11, &
                        dilatancy_number = 12, dilatancy_exponent = 13, fabric_limit = 14, &
                        fabric_rate = 15, atmospheric_pressure = 16, smallest_pressure = 17, &
                        substep_tolerance = 18, reference_pressure = 19, n_constant = 19
  integer, parameter :: void_ratio = 1              ! state variable; tensors begin at
  integer, parameter :: back = 2                    ! alpha
  integer, parameter :: start = 2 + nsig            ! alpha where the loading began
  integer, parameter :: fabric = 2 + 2*nsig         ! z
  integer, parameter :: finest = 13                 ! sub-steps are no shorter than 2^-finest
  integer, parameter :: most_iterations = 60        ! of the search for the yield surface
  real(wp), parameter :: root_23 = sqrt(2.0_wp/3.0_wp)
  real(wp), parameter :: on_surface = 1.0e-9_wp     ! |f| over the surface's radius [-]
  real(wp), parameter :: at_floor = 1.0_wp + 1.0e-6_wp
  ! up to here a mean stress counts as the least one, so that round-off does not decide [-]
  real(wp), parameter :: stable = 1.0_wp
  ! elastic change of the stress ratio in a sub-step over the yield surface's radius: beyond 2 the
  ! direction of flow, which turns towards that of the strain, would swing about it [-]
  real(wp), parameter :: growth = 0.15_wp           ! error over tolerance that doubles a step [-]
  real(wp), parameter :: leaving = 2.0_wp           ! error over tolerance, others' sub-steps [-]
  real(wp), parameter :: least_way = 1.0e-8_wp      ! of alpha since the loading began [-]
  real(wp), parameter :: least_hardening = 0.01_wp  ! 1 - c_h e [-]
  real(wp), parameter :: least_stiffness = 0.5_wp   ! of plastic shear, over G [-]
  real(wp), parameter :: largest_state = 1.0_wp     ! |psi| that surfaces answer to [-]
  real(wp), parameter :: void_range(2) = [0.01_wp, 2.0_wp]   ! that moduli answer to [-]
  real(wp), parameter :: largest_start = 0.95_wp    ! alpha at first over the bounding surface [-]
  real(wp), parameter :: perturbation = 1.0e-5_wp   ! of strains over the largest, for tangents
  real(wp), parameter :: shortened = 0.1_wp           ! of perturbations beside kinks [-]
  real(wp), parameter :: widened = 100.0_wp           ! where they have no tangent [-]
  real(wp), parameter :: kink = 1.0e-3_wp             ! of sides' tangents, over the stiffness [-]
  real(wp), parameter :: least_perturbation = 1.0e-11_wp
  real(wp), parameter :: largest_increment = 1.0_wp   ! of strains [-]

  type, extends(material_model_t), public :: dafalias_manzari_t
    !! Constants; the values here are those of Toyoura sand.
    real(wp) :: stiffness = 125.0_wp            !! G_0 [-]
    real(wp) :: poisson_ratio = 0.05_wp         !! [-]
    real(wp) :: ratio = 1.25_wp                 !! M: q/p in the critical state, compression [-]
    real(wp) :: extension = 0.712_wp            !! c: that of extension over M [-]
    real(wp) :: critical_void_ratio = 0.934_wp  !! e_0 of the critical state at p = 0 [-]
    real(wp) :: critical_slope = 0.019_wp       !! lambda_c [-]
    real(wp) :: critical_exponent = 0.7_wp      !! xi [-]
    real(wp) :: yield_ratio = 0.01_wp           !! m [-]
    real(wp) :: hardening = 7.05_wp             !! h_0 [-]
    real(wp) :: hardening_void = 0.968_wp       !! c_h [-]
    real(wp) :: bounding_exponent = 1.1_wp      !! n^b [-]
    real(wp) :: dilatancy = 0.704_wp            !! A_0 [-]
    real(wp) :: dilatancy_exponent = 3.5_wp     !! n^d [-]
    real(wp) :: fabric_limit = 4.0_wp           !! z_max [-]
    real(wp) :: fabric_rate = 600.0_wp          !! c_z [-]
    real(wp) :: atmosphere = 1.01e5_wp          !! p_at [Pa]
    real(wp) :: smallest_pressure = 100.0_wp    !! p never falls below [Pa]
    real(wp) :: tolerance = 1.0e-5_wp           !! error of a sub-step [-]
    real(wp) :: reference_pressure = 1.0e5_wp   !! that moduli are estimated for [Pa]
    real(wp) :: reference_void_ratio = 0.7_wp   !! likewise [-]
  contains
    procedure :: declare => dafalias_manzari_declare
    procedure :: key_of => dafalias_manzari_key_of
    procedure :: follows_finite_strains => dafalias_manzari_follows_finite_strains
    procedure :: prepare => dafalias_manzari_prepare
    procedure :: init => dafalias_manzari_init
    procedure :: return_stress => dafalias_manzari_return_stress
    procedure :: elastic_tangent => dafalias_manzari_elastic_tangent
    procedure :: start_state => dafalias_manzari_start_state
    procedure :: shear_modulus => dafalias_manzari_shear_modulus
    procedure :: bulk_modulus => dafalias_manzari_bulk_modulus
  end type dafalias_manzari_t

  type :: point_t
    !! What changes within an increment.
    real(wp) :: stress(nsig) = 0.0_wp   !! [Pa]
    real(wp) :: back(nsig) = 0.0_wp     !! alpha, centre of the yield surface [-]
    real(wp) :: start(nsig) = 0.0_wp    !! alpha where the present loading began [-]
    real(wp) :: fabric(nsig) = 0.0_wp   !! z [-]
  end type point_t

  type :: plan_t
    !! Sub-steps of an increment, kept so that tangents belong to the same ones.
    logical :: is_fixed = .false.
    logical :: is_left = .false.        !! followed where it is too coarse: near instability
    integer, allocatable :: level(:)    !! k of their sizes 2^-k; not allocated: not kept
  end type plan_t

contains

  subroutine dafalias_manzari_declare(self)
    !! Constants with their defaults, those of Toyoura sand but for Poisson's ratio.
    class(dafalias_manzari_t), intent(inout) :: self

    if (.not. allocated(self%constant)) allocate (self%constant(n_constant))
    associate (value => self%constant)
      value(critical_state_ratio)%constant = 1.25_wp
      value(shear_modulus_number)%constant = 125.0_wp
      value(extension_ratio)%constant = 0.712_wp
      value(critical_void_ratio)%constant = 0.934_wp
      value(critical_slope)%constant = 0.019_wp
      value(critical_exponent)%constant = 0.7_wp
      value(yield_ratio)%constant = 0.01_wp
      value(hardening_number)%constant = 7.05_wp
      value(hardening_void_factor)%constant = 0.968_wp
      value(bounding_exponent)%constant = 1.1_wp
      value(dilatancy_number)%constant = 0.704_wp
      value(dilatancy_exponent)%constant = 3.5_wp
      value(fabric_limit)%constant = 4.0_wp
      value(fabric_rate)%constant = 600.0_wp
      value(atmospheric_pressure)%constant = 1.01e5_wp
      value(smallest_pressure)%constant = 100.0_wp
      value(substep_tolerance)%constant = 1.0e-5_wp
      value(reference_pressure)%constant = 1.0e5_wp
    end associate
  end subroutine dafalias_manzari_declare

  pure function dafalias_manzari_key_of(self, k) result(described)
    !! Keys of the constants.
    class(dafalias_manzari_t), intent(in) :: self
    integer, intent(in) :: k
    type(key_t) :: described

    associate (not_used => self%ratio)
    end associate
    select case (k)
    case (poisson_ratio)
      described = shared_key('poisson_ratio')
    case (critical_state_ratio)
      described = shared_key('critical_state_ratio')
    case (shear_modulus_number)
      described = key('shear_modulus_number', 'G_0 in G = G_0 p_at (2.97 - e)^2/(1 + e) '// &
                      'sqrt(p/p_at); this default and those of sand below are Toyoura '// &
                      'sand''s, with poisson_ratio = 0.05', unit='-', range='> 0')
    case (extension_ratio)
      described = key('extension_ratio', 'c: critical q/p of triaxial extension over that '// &
                      'of compression', unit='-', range='>= 0.6 and <= 1')
    case (critical_void_ratio)
      described = key('critical_void_ratio', 'e_0 of the critical state, e_c = e_0 - '// &
                      'lambda_c (p/p_at)^xi', unit='-', range='> 0 and < 2')
    case (critical_slope)
      described = key('critical_slope', 'lambda_c, likewise', unit='-', range='>= 0')
    case (critical_exponent)
      described = key('critical_exponent', 'xi, likewise', unit='-', range='> 0')
    case (yield_ratio)
      described = key('yield_ratio', 'm: radius of the yield surface in q/p', unit='-', &
                      range='>= 1e-3 and <= 0.2')
    case (hardening_number)
      described = key('hardening_number', 'h_0 of the plastic stiffness', unit='-', range='> 0')
    case (hardening_void_factor)
      described = key('hardening_void_factor', 'c_h: the plastic stiffness goes with 1 - c_h e', &
                      unit='-', range='>= 0')
    case (bounding_exponent)
      described = key('bounding_exponent', &
                      'n^b: q/p is bounded by M exp(-n^b psi), psi = e - e_c', unit='-', &
                      range='>= 0')
    case (dilatancy_number)
      described = key('dilatancy_number', 'A_0 of the dilatancy', unit='-', range='> 0')
    case (dilatancy_exponent)
      described = key('dilatancy_exponent', 'n^d: sand dilates above q/p = M exp(n^d psi)', &
                      unit='-', range='>= 0')
    case (fabric_limit)
      described = key('fabric_limit', 'z_max of the fabric that dilation builds', unit='-', &
                      range='>= 0')
    case (fabric_rate)
      described = key('fabric_rate', 'c_z: how fast it builds it', unit='-', range='>= 0')
    case (atmospheric_pressure)
      described = key('atmospheric_pressure', 'p_at of the formulas above', unit='Pa', &
                      range='> 0')
    case (smallest_pressure)
      described = key('smallest_pressure', 'the mean effective stress does not fall below', &
                      unit='Pa', range='> 0')
    case (substep_tolerance)
      described = key('substep_tolerance', 'error of a sub-step over the mean stress', unit='-', &
                      range='>= 1e-10 and <= 1e-2', restart=restart_free)
    case default
      described = shared_key('reference_pressure')
    end select
  end function dafalias_manzari_key_of

  pure logical function dafalias_manzari_follows_finite_strains(self) result(follows)
    !! Its tensors do not turn with the deformation gradient.
    class(dafalias_manzari_t), intent(in) :: self

    associate (not_used => self%ratio)
    end associate
    follows = .false.
  end function dafalias_manzari_follows_finite_strains

  pure subroutine dafalias_manzari_prepare(self)
    !! The model's constants from those of the scene.
    class(dafalias_manzari_t), intent(inout) :: self

    associate (value => self%constant%constant)
      self%poisson_ratio = value(poisson_ratio)
      self%ratio = value(critical_state_ratio)
      self%stiffness = value(shear_modulus_number)
      self%extension = value(extension_ratio)
      self%critical_void_ratio = value(critical_void_ratio)
      self%critical_slope = value(critical_slope)
      self%critical_exponent = value(critical_exponent)
      self%yield_ratio = value(yield_ratio)
      self%hardening = value(hardening_number)
      self%hardening_void = value(hardening_void_factor)
      self%bounding_exponent = value(bounding_exponent)
      self%dilatancy = value(dilatancy_number)
      self%dilatancy_exponent = value(dilatancy_exponent)
      self%fabric_limit = value(fabric_limit)
      self%fabric_rate = value(fabric_rate)
      self%atmosphere = value(atmospheric_pressure)
      self%smallest_pressure = value(smallest_pressure)
      self%tolerance = value(substep_tolerance)
      self%reference_pressure = value(reference_pressure)
    end associate
    self%reference_void_ratio = self%porosity/(1.0_wp - self%porosity)
    call self%init()
  end subroutine dafalias_manzari_prepare

  pure subroutine dafalias_manzari_init(self)
    !! Names the state variables; all constants are components.
    class(dafalias_manzari_t), intent(inout) :: self
    character(len=2), parameter :: component(6) = ['xx', 'yy', 'zz', 'xy', 'yz', 'zx']
    integer :: k

    self%is_nonlinear = .true.
    self%state_tensors = [back, start, fabric]
    if (allocated(self%state_names)) deallocate (self%state_names, self%state_units)
    allocate (self%state_names(1 + 3*nsig), self%state_units(1 + 3*nsig))
    self%state_units = '-'
    self%state_names(void_ratio) = 'void_ratio'
    do k = 1, nsig
      self%state_names(back + k - 1) = 'back_stress_ratio_'//component(voigt6(k))
      self%state_names(start + k - 1) = 'initial_back_stress_ratio_'//component(voigt6(k))
      self%state_names(fabric + k - 1) = 'fabric_'//component(voigt6(k))
    end do
  end subroutine dafalias_manzari_init

  subroutine dafalias_manzari_start_state(self, porosity, stress, state)
    !! The yield surface around the initial stress, within the bounding surface; no fabric.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: porosity          !! [-]
    real(wp), intent(in) :: stress(nsig)      !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:)   !! [units of `state_units`]
    real(wp) :: r(nsig), p, length, bound

    state(void_ratio) = porosity/(1.0_wp - porosity)
    call split(self, -stress, p, r)
    length = size_of(r)
    bound = root_23*largest_start*(self%ratio*self%extension* &
                                   exp(-self%bounding_exponent* &
                                       state_parameter(self, p, state(void_ratio))) - &
                                   self%yield_ratio)
    if (length > bound) r = r*(max(bound, 0.0_wp)/max(length, tiny(1.0_wp)))
    state(back:back + nsig - 1) = r
    state(start:start + nsig - 1) = r
    state(fabric:fabric + nsig - 1) = 0.0_wp
  end subroutine dafalias_manzari_start_state

  subroutine dafalias_manzari_return_stress(self, n, strain_increment, stress, state, err, tangent)
    !! Stresses after strain increments. Tangents are central differences over the same sub-steps,
    !! elastic moduli where nothing is strained. Fails, and leaves the point as it is, where pores
    !! close and for increments far beyond small strains.
    class(dafalias_manzari_t), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: strain_increment(nsig, n)   !! tension positive, 2 x shear [-]
    real(wp), intent(inout) :: stress(nsig, n)   !! effective, tension positive [Pa]
    real(wp), intent(inout) :: state(:, :)   !! (n_state, n) [units of `state_units`]
    type(error_t), intent(inout) :: err
    real(wp), intent(out), optional :: tangent(nsig, nsig, n)   !! for 2 x shear [Pa]
    type(point_t) :: before, point
    type(plan_t) :: plan
    real(wp) :: strain(nsig), volume
    integer :: i

    if (err%failed()) return
    if (present(tangent)) allocate (plan%level(2**finest))
    if (present(tangent)) tangent = 0.0_wp   ! of points that fail
    do i = 1, n
      call judge(self, strain_increment(:, i), stress(:, i), state(:, i), err)
      if (err%failed()) return
      strain = -strain_increment(:, i)
      strain(4:) = 0.5_wp*strain(4:)
      before%stress = -stress(:, i)
      before%back = state(back:back + nsig - 1, i)
      before%start = state(start:start + nsig - 1, i)
      before%fabric = state(fabric:fabric + nsig - 1, i)
      volume = 1.0_wp + state(void_ratio, i)
      point = before
      plan%is_fixed = .false.
      call integrate(self, strain, volume, point, plan)
      if (present(tangent)) then
        plan%is_fixed = .true.
        call differentiate(self, strain, volume, before, point%stress, plan, tangent(:, :, i))
      end if
      stress(:, i) = -point%stress
      state(void_ratio, i) = void_after(volume, sum(strain(1:3)))
      state(back:back + nsig - 1, i) = point%back
      state(start:start + nsig - 1, i) = point%start
      state(fabric:fabric + nsig - 1, i) = point%fabric
    end do
  end subroutine dafalias_manzari_return_stress

  subroutine judge(self, strain, stress, state, err)
    !! Words for what cannot be, before it is.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig), stress(nsig), state(:)
    type(error_t), intent(inout) :: err
    character(len=*), parameter :: name = 'Dafalias-Manzari sand: '

    if (.not. all(ieee_is_finite([strain, stress, state]))) then
      call self%explain(name//'no numbers', strain, stress, state, err)
    else if (maxval(abs(strain)) > largest_increment) then
      call self%explain(name//'the increment is too large', strain, stress, state, err)
    else if (.not. (1.0_wp + state(void_ratio))*exp(sum(strain(1:3))) > 1.0_wp) then
      call self%explain(name//'the pores close', strain, stress, state, err)
    end if
  end subroutine judge

  subroutine differentiate(self, strain, volume, before, after, plan, tangent)
    !! Kernel: the tangent of an increment by central differences over its own sub-steps; by
    !! shorter ones where the sides differ, since a kink beside the increment does not belong to it;
    !! by wider ones with sub-steps of their own where the response has no tangent, at kinks and
    !! where sand with hardly any stress answers to the least change, if their sides differ less.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)    !! the increment
    real(wp), intent(in) :: volume          !! 1 + e before
    type(point_t), intent(in) :: before
    real(wp), intent(in) :: after(nsig)     !! stress after it, compression positive [Pa]
    type(plan_t), intent(inout) :: plan
    real(wp), intent(out) :: tangent(nsig, nsig)
    real(wp) :: step, p, r(nsig), bulk, shear, sides(nsig, 2), wide(nsig, 2)
    real(wp) :: apart, apart_wide, least
    logical :: is_left
    integer :: k

    call split(self, before%stress, p, r)
    call moduli(self, max(p, sum(after(1:3))/3.0_wp), volume - 1.0_wp, bulk, shear)
    if (.not. maxval(abs(strain)) > 0.0_wp) then
      tangent = elastic_matrix(bulk - 2.0_wp*shear/3.0_wp, shear)
      return
    end if
    step = max(least_perturbation, perturbation*maxval(abs(strain)))
    least = kink*(bulk + 4.0_wp*shear/3.0_wp)
    do k = 1, nsig
      call find_sides(step, .true., sides, apart, is_left)
      if (apart > least .or. is_left) then
        call find_sides(shortened*step, .true., sides, apart, is_left)
      end if
      if (apart > least) then
        call find_sides(widened*step, .false., wide, apart_wide, is_left)
        if (apart_wide < apart) sides = wide
      end if
      tangent(:, k) = 0.5_wp*(sides(:, 1) + sides(:, 2))
    end do

  contains

    subroutine find_sides(length, is_kept, sides, apart, is_left)
      !! Differences to both sides along the strain of column k.
      real(wp), intent(in) :: length     ! of strain, engineering's if of shear [-]
      logical, intent(in) :: is_kept     ! the increment's sub-steps are
      real(wp), intent(out) :: sides(nsig, 2)   ! [Pa]
      real(wp), intent(out) :: apart     ! how far the sides are [Pa]
      logical, intent(out) :: is_left    ! the sub-steps do not suit one of them
      type(point_t) :: other
      type(plan_t) :: own
      real(wp) :: change(nsig)
      integer :: s

      is_left = .false.
      do s = 1, 2
        change = 0.0_wp
        change(k) = merge(-length, length, s == 1)
        if (k > 3) change(k) = 0.5_wp*change(k)
        other = before
        if (is_kept) then
          call integrate(self, strain + change, volume, other, plan)
          is_left = is_left .or. plan%is_left
        else
          call integrate(self, strain + change, volume, other, own)
        end if
        sides(:, s) = (other%stress - after)/merge(-length, length, s == 1)
      end do
      apart = maxval(abs(sides(:, 2) - sides(:, 1)))
    end subroutine find_sides
  end subroutine differentiate

  subroutine integrate(self, strain, volume, point, plan)
    !! Kernel: brings a point to the end of an increment.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)    !! the increment
    real(wp), intent(in) :: volume          !! 1 + e before
    type(point_t), intent(inout) :: point
    type(plan_t), intent(inout) :: plan     !! followed if fixed, else filled
    type(point_t) :: trial
    real(wp) :: voids(2), size, error, compression
    integer :: level, place, taken, k

    call lift(self, point)
    if (.not. maxval(abs(strain)) > 0.0_wp) return
    compression = sum(strain(1:3))
    level = 0
    place = 0   ! in units of 2^-finest
    k = 0
    plan%is_left = .false.
    do while (place < 2**finest)
      k = k + 1
      if (plan%is_fixed) level = plan%level(k)
      taken = 2**(finest - level)
      size = 2.0_wp**(-level)
      voids(1) = void_after(volume, compression*real(place, wp)/2.0_wp**finest)
      voids(2) = void_after(volume, compression*real(place + taken, wp)/2.0_wp**finest)
      trial = point
      call substep(self, strain*size, voids, trial, error)
      if (.not. plan%is_fixed) then
        if (error > self%tolerance .and. level < finest) then
          k = k - 1
          level = level + 1
          cycle
        end if
        if (allocated(plan%level)) plan%level(k) = level
      end if
      if (plan%is_fixed .and. level < finest) then
        plan%is_left = plan%is_left .or. error > leaving*self%tolerance
      end if
      if (error > self%tolerance .and. level == finest) then
        call hold_within(self, voids(2), point, trial)
      end if
      point = trial
      place = place + taken
      if (error < growth*self%tolerance .and. level > 0) then
        if (mod(place, 2*taken) == 0) level = level - 1
      end if
    end do
  end subroutine integrate

  pure subroutine hold_within(self, voids, before, point)
    !! Kernel: where the finest sub-step is still too long (hardly any mean stress), its rates may
    !! lead anywhere: alpha stays within the bounding surface, or where it was, and the stress on
    !! the yield surface.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: voids           !! e after [-]
    type(point_t), intent(in) :: before
    type(point_t), intent(inout) :: point
    real(wp) :: r(nsig), out(nsig), p, length, bound

    call split(self, point%stress, p, r)
    bound = root_23*(self%ratio*exp(-self%bounding_exponent*state_parameter(self, p, voids)) - &
                     self%yield_ratio)
    bound = max(bound, size_of(before%back))
    length = size_of(point%back)
    if (.not. length > bound) return
    out = deviator_between(r, point%back)
    point%back = point%back*(bound/length)
    point%back(1:3) = point%back(1:3) - sum(point%back(1:3))/3.0_wp
    length = size_of(out)
    if (length > 0.0_wp) out = out*(root_23*self%yield_ratio/length)
    point%stress = p*(point%back + out)
    point%stress(1:3) = point%stress(1:3) + p
  end subroutine hold_within

  pure subroutine substep(self, strain, voids, point, error)
    !! Kernel: an elastic part up to the yield surface, and modified Euler's rule beyond.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)
    real(wp), intent(in) :: voids(2)        !! e before and after
    type(point_t), intent(inout) :: point
    real(wp), intent(out) :: error          !! over the present values [-]
    type(point_t) :: first, second, trial
    real(wp) :: direction(nsig), elastic_share, p, r(nsig), bulk, shear, unused, loading

    call rate(self, strain, voids(1), point, first, direction, loading)
    error = 0.0_wp
    elastic_share = 0.0_wp
    if (overstress(self, point) < -on_surface .or. .not. loading > 0.0_wp) then
      trial = point
      call move_elastically(self, strain, voids, trial, error)
      if (.not. overstress(self, trial) > on_surface) then
        point = trial
        return
      end if
      call find_surface(self, strain, voids, point, elastic_share)
      trial = point
      call move_elastically(self, elastic_share*strain, voids, trial, error)
      point = trial
      call rate(self, strain, voids(1), point, first, direction, unused)
    end if
    if (contract(point%back - point%start, direction) < 0.0_wp) then   ! a new loading begins
      point%start = point%back
      call rate(self, strain, voids(1), point, first, direction, unused)
    end if
    trial = moved(point, first, 1.0_wp - elastic_share)
    call rate(self, strain, voids(2), trial, second, direction, unused)
    call split(self, point%stress, p, r)
    call moduli(self, p, voids(1), bulk, shear)
    error = max(error, self%tolerance*(2.0_wp*shear*(1.0_wp - elastic_share)*size_of(strain)/ &
                                       (stable*p*root_23*self%yield_ratio))**2, &
                0.5_wp*(1.0_wp - elastic_share)* &
                max(size_of(second%stress - first%stress)/p, &
                    size_of(second%back - first%back), &
                    size_of(second%fabric - first%fabric)/(1.0_wp + self%fabric_limit)))
    point = moved(moved(point, first, 0.5_wp*(1.0_wp - elastic_share)), second, &
                  0.5_wp*(1.0_wp - elastic_share))
    call put_on_surface(self, point)
  end subroutine substep

  pure function moved(point, rates, share) result(after)
    !! A point after a share of its rates.
    type(point_t), intent(in) :: point, rates
    real(wp), intent(in) :: share
    type(point_t) :: after

    after%stress = point%stress + share*rates%stress
    after%back = point%back + share*rates%back
    after%start = point%start
    after%fabric = point%fabric + share*rates%fabric
  end function moved

  pure subroutine rate(self, strain, voids, point, rates, direction, loading)
    !! Kernel: changes of a point for a strain, elastic and plastic. With h = b_0/(way of alpha)
    !! the multiplier is l and l h is used as such, since h is infinite where a loading begins.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)
    real(wp), intent(in) :: voids                !! e [-]
    type(point_t), intent(in) :: point
    type(point_t), intent(out) :: rates
    real(wp), intent(out) :: direction(nsig)     !! n: unit deviator out of the yield surface
    real(wp), intent(out) :: loading             !! > 0: plastic flow [Pa]
    real(wp) :: r(nsig), square(nsig), p, bulk, shear, compression, length, cube, lode, g, psi
    real(wp) :: bound, dense, flow, relief, b, c, stiff, softness, way, total, along, lh, l

    call split(self, point%stress, p, r)
    call moduli(self, p, voids, bulk, shear)
    compression = sum(strain(1:3))
    rates%stress = 2.0_wp*shear*strain
    rates%stress(1:3) = rates%stress(1:3) + (bulk - 2.0_wp*shear/3.0_wp)*compression
    direction = deviator_between(r, point%back)
    length = size_of(direction)
    loading = 0.0_wp
    if (.not. length > on_surface*self%yield_ratio) then
      direction = 0.0_wp
      return
    end if
    direction = direction/length
    along = contract(direction, r)
    loading = 2.0_wp*shear*contract(direction, strain) - along*bulk*compression
    if (.not. loading > 0.0_wp) return
    ! surfaces in this direction
    square = squared(direction)
    cube = contract(direction, square)
    lode = max(-1.0_wp, min(1.0_wp, sqrt(6.0_wp)*cube))
    g = 2.0_wp*self%extension/(1.0_wp + self%extension - (1.0_wp - self%extension)*lode)
    psi = state_parameter(self, p, voids)
    bound = root_23*(g*self%ratio*exp(-self%bounding_exponent*psi) - self%yield_ratio)
    dense = root_23*(g*self%ratio*exp(self%dilatancy_exponent*psi) - self%yield_ratio)
    ! flow
    flow = self%dilatancy*(1.0_wp + max(0.0_wp, contract(point%fabric, direction)))* &
           (dense - contract(point%back, direction))
    ! contraction that relieves more stress than shearing builds up has no continuous answer
    relief = bulk*flow*along
    if (relief > (2.0_wp - least_stiffness)*shear) then
      flow = flow*(2.0_wp - least_stiffness)*shear/relief
    end if
    b = 1.0_wp + 1.5_wp*(1.0_wp - self%extension)/self%extension*g*lode
    c = 3.0_wp*sqrt(1.5_wp)*(1.0_wp - self%extension)/self%extension*g
    stiff = 2.0_wp*shear*(b - c*cube) - bulk*flow*along
    ! hardening
    way = bound - contract(point%back, direction)
    softness = max(least_way, contract(point%back - point%start, direction))/ &
               (self%stiffness*self%hardening* &
                max(least_hardening, 1.0_wp - self%hardening_void*voids)* &
                sqrt(self%atmosphere/p))
    ! beyond the bounding surface: no snap back where a loading has just begun
    if (way < 0.0_wp) softness = max(softness, -4.0_wp/3.0_wp*p*way/stiff)
    total = 2.0_wp/3.0_wp*p*way + softness*stiff
    lh = loading/total
    l = lh*softness
    rates%stress = rates%stress - 2.0_wp*shear*l*(b*direction - c*square)
    rates%stress(1:3) = rates%stress(1:3) - l*(2.0_wp*shear*c/3.0_wp + bulk*flow)
    rates%back = lh*2.0_wp/3.0_wp*(bound*direction - point%back)
    rates%fabric = -self%fabric_rate*max(0.0_wp, -l*flow)* &
                   (self%fabric_limit*direction + point%fabric)
  end subroutine rate

  pure subroutine move_elastically(self, strain, voids, point, error)
    !! Kernel: an elastic strain by modified Euler's rule.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)
    real(wp), intent(in) :: voids(2)
    type(point_t), intent(inout) :: point
    real(wp), intent(out) :: error
    real(wp) :: r(nsig), p, bulk(2), shear(2), compression

    compression = sum(strain(1:3))
    call split(self, point%stress, p, r)
    call moduli(self, p, voids(1), bulk(1), shear(1))
    call moduli(self, max(self%smallest_pressure, p + bulk(1)*compression), voids(2), bulk(2), &
                shear(2))
    associate (k => 0.5_wp*sum(bulk), g => 0.5_wp*sum(shear))
      point%stress = point%stress + 2.0_wp*g*strain
      point%stress(1:3) = point%stress(1:3) + (k - 2.0_wp*g/3.0_wp)*compression
    end associate
    call lift(self, point)
    error = 0.5_wp*max(abs(bulk(2) - bulk(1))*abs(compression), &
                       2.0_wp*abs(shear(2) - shear(1))*size_of(strain))/p
  end subroutine move_elastically

  pure subroutine find_surface(self, strain, voids, point, share)
    !! Kernel: the share of a strain after which an elastic path leaves the yield surface, by
    !! halving until it is inside, then regula falsi (Illinois); 0 if it is never inside.
    type(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: strain(nsig)
    real(wp), intent(in) :: voids(2)
    type(point_t), intent(in) :: point
    real(wp), intent(out) :: share
    real(wp) :: low, high, f_low, f_high, f
    integer :: k, side

    high = 1.0_wp
    f_high = value_at(high)
    low = 0.0_wp
    f_low = overstress(self, point)
    if (f_low > -on_surface) then
      low = 0.5_wp
      do k = 1, most_iterations
        f_low = value_at(low)
        if (f_low < -on_surface) exit
        high = low
        f_high = f_low
        low = 0.5_wp*low
      end do
    end if
    share = 0.0_wp
    if (.not. (f_low < 0.0_wp .and. f_high > 0.0_wp)) return
    side = 0
    do k = 1, most_iterations
      share = (low*f_high - high*f_low)/(f_high - f_low)
      f = value_at(share)
      if (abs(f) <= 1.0e-3_wp*on_surface) exit
      if (f > 0.0_wp) then
        high = share
        f_high = f
        if (side == 1) f_low = 0.5_wp*f_low
        side = 1
      else
        low = share
        f_low = f
        if (side == -1) f_high = 0.5_wp*f_high
        side = -1
      end if
    end do

  contains

    pure real(wp) function value_at(part) result(value)
      real(wp), intent(in) :: part   ! of the strain
      type(point_t) :: there
      real(wp) :: unused

      there = point
      call move_elastically(self, part*strain, voids, there, unused)
      value = overstress(self, there)
    end function value_at
  end subroutine find_surface

  pure real(wp) function overstress(self, point) result(value)
    !! The yield function over the surface's radius: |r - alpha|/(sqrt(2/3) m) - 1 [-].
    type(dafalias_manzari_t), intent(in) :: self
    type(point_t), intent(in) :: point
    real(wp) :: r(nsig), p

    call split(self, point%stress, p, r)
    r = r - point%back
    value = size_of(r)/(root_23*self%yield_ratio) - 1.0_wp
  end function overstress

  pure subroutine put_on_surface(self, point)
    !! Kernel: takes the drift away. The yield surface moves to the stress; where the mean stress
    !! has fallen too low, the stress to the yield surface.
    type(dafalias_manzari_t), intent(in) :: self
    type(point_t), intent(inout) :: point
    real(wp) :: r(nsig), out(nsig), p, length

    call split(self, point%stress, p, r)
    point%back(1:3) = point%back(1:3) - sum(point%back(1:3))/3.0_wp   ! round-off
    out = deviator_between(r, point%back)
    length = size_of(out)
    if (.not. length > 0.0_wp) return
    out = out*(root_23*self%yield_ratio/length)
    if (sum(point%stress(1:3))/3.0_wp < at_floor*self%smallest_pressure) then
      point%stress = p*(point%back + out)
      point%stress(1:3) = point%stress(1:3) + p
    else
      point%back = r - out
    end if
  end subroutine put_on_surface

  pure function deviator_between(r, centre) result(direction)
    !! From the centre of the yield surface to a stress ratio; without the trace that round-off
    !! has, which many small sub-steps would let grow.
    real(wp), intent(in) :: r(nsig), centre(nsig)   !! deviators [-]
    real(wp) :: direction(nsig)

    direction = r - centre
    direction(1:3) = direction(1:3) - sum(direction(1:3))/3.0_wp
  end function deviator_between

  pure subroutine lift(self, point)
    !! Kernel: raises the mean stress to its least value.
    type(dafalias_manzari_t), intent(in) :: self
    type(point_t), intent(inout) :: point

    point%stress(1:3) = point%stress(1:3) + &
                        max(0.0_wp, self%smallest_pressure - sum(point%stress(1:3))/3.0_wp)
  end subroutine lift

  pure subroutine split(self, stress, p, r)
    !! Mean stress, not below its least value, and the deviator over it.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)   !! [Pa]
    real(wp), intent(out) :: p             !! [Pa]
    real(wp), intent(out) :: r(nsig)       !! [-]

    p = sum(stress(1:3))/3.0_wp
    r = stress
    r(1:3) = r(1:3) - p
    p = max(p, self%smallest_pressure)
    r = r/p
  end subroutine split

  pure subroutine moduli(self, p, voids, bulk, shear)
    !! G = G_0 p_at (2.97 - e)^2/(1 + e) sqrt(p/p_at), and K of Poisson's ratio.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: p             !! [Pa]
    real(wp), intent(in) :: voids         !! e [-]
    real(wp), intent(out) :: bulk, shear  !! [Pa]

    associate (e => max(void_range(1), min(voids, void_range(2))))
      shear = self%stiffness*sqrt(self%atmosphere*p)*(2.97_wp - e)**2/(1.0_wp + e)
    end associate
    bulk = shear*2.0_wp*(1.0_wp + self%poisson_ratio)/(3.0_wp*(1.0_wp - 2.0_wp*self%poisson_ratio))
  end subroutine moduli

  pure real(wp) function state_parameter(self, p, voids) result(psi)
    !! psi = e - e_c: distance from the critical state, e_c = e_0 - lambda_c (p/p_at)^xi.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: p       !! [Pa]
    real(wp), intent(in) :: voids   !! e [-]

    psi = voids - self%critical_void_ratio + &
          self%critical_slope*(p/self%atmosphere)**self%critical_exponent
    psi = max(-largest_state, min(psi, largest_state))
  end function state_parameter

  pure real(wp) function void_after(volume, compression) result(voids)
    !! e after a (logarithmic) volume strain, compression positive, from 1 + e.
    real(wp), intent(in) :: volume, compression

    voids = max(0.0_wp, volume*exp(max(-1.0_wp, min(-compression, 1.0_wp))) - 1.0_wp)
  end function void_after

  pure real(wp) function contract(a, b) result(product)
    !! a : b of symmetric tensors.
    real(wp), intent(in) :: a(nsig), b(nsig)

    product = sum(a(1:3)*b(1:3)) + 2.0_wp*sum(a(4:)*b(4:))
  end function contract

  pure real(wp) function size_of(a)
    !! sqrt(a : a).
    real(wp), intent(in) :: a(nsig)

    size_of = sqrt(contract(a, a))
  end function size_of

  pure function squared(a) result(square)
    !! a . a of a symmetric tensor.
    real(wp), intent(in) :: a(nsig)
    real(wp) :: square(nsig)
    real(wp) :: f(6), s(6)

    f = 0.0_wp
    f(voigt6) = a
    s = [f(1)**2 + f(4)**2 + f(6)**2, f(2)**2 + f(4)**2 + f(5)**2, f(3)**2 + f(5)**2 + f(6)**2, &
         (f(1) + f(2))*f(4) + f(5)*f(6), (f(2) + f(3))*f(5) + f(4)*f(6), &
         (f(1) + f(3))*f(6) + f(4)*f(5)]
    square = s(voigt6)
  end function squared

  subroutine dafalias_manzari_elastic_tangent(self, stress, state, tangent)
    !! The elastic matrix at a stress.
    class(dafalias_manzari_t), intent(in) :: self
    real(wp), intent(in) :: stress(nsig)   !! effective, tension positive [Pa]
    real(wp), intent(in) :: state(:)   !! [units of `state_units`]
    real(wp), intent(out) :: tangent(nsig, nsig)   !! for 2 x shear [Pa]
    real(wp) :: p, r(nsig), bulk, shear

    call split(self, -stress, p, r)
    call moduli(self, p, state(void_ratio), bulk, shear)
    tangent = elastic_matrix(bulk - 2.0_wp*shear/3.0_wp, shear)
  end subroutine dafalias_manzari_elastic_tangent

  pure real(wp) function dafalias_manzari_bulk_modulus(self) result(modulus)
    !! K at the reference pressure and void ratio [Pa].
    class(dafalias_manzari_t), intent(in) :: self
    real(wp) :: shear

    call moduli(self, self%reference_pressure, self%reference_void_ratio, modulus, shear)
  end function dafalias_manzari_bulk_modulus

  pure real(wp) function dafalias_manzari_shear_modulus(self) result(modulus)
    !! G, likewise [Pa].
    class(dafalias_manzari_t), intent(in) :: self
    real(wp) :: bulk

    call moduli(self, self%reference_pressure, self%reference_void_ratio, bulk, modulus)
  end function dafalias_manzari_shear_modulus
end module dosui_dafalias_manzari

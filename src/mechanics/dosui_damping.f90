!! Damping of the grid's motion, for quasi-static answers from a dynamic integrator.
module dosui_damping
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  implicit none
  private

  public :: damping_kind_of, automatic_damping, fastest_damping, damping_at, damp_forces

  integer, parameter, public :: damping_none = 0
  integer, parameter, public :: damping_viscous = 1   !! -c m v
  integer, parameter, public :: damping_local = 2     !! -c |f| sign(v) [Cundall1987]
  integer, parameter, public :: damping_fading = 3    !! -c(t) m v with c -> b/t

  ! Measured on Mandel's and Terzaghi's problems (docs/theory/explicit-steps.md): enough to still
  ! the body between load and first drainage, too little to delay the settlement.
  real(wp), parameter :: viscous_ratio = 0.1_wp        ! c over the lowest frequency [-]
  real(wp), parameter :: local_coefficient = 0.3_wp
  real(wp), parameter :: fading_exponent = 3.0_wp
  real(wp), parameter :: pi = acos(-1.0_wp)

contains

  pure integer function damping_kind_of(name) result(kind)
    !! Kind of the damping with this name in a scene, -1 for an unknown name.
    character(len=*), intent(in) :: name   !! 'none', 'viscous', 'local' or 'fading'

    select case (name)
    case ('none')
      kind = damping_none
    case ('viscous')
      kind = damping_viscous
    case ('local')
      kind = damping_local
    case ('fading')
      kind = damping_fading
    case default
      kind = -1
    end select
  end function damping_kind_of

  pure real(wp) function automatic_damping(kind, wave_speed, length) result(coefficient)
    !! Coefficient from the lowest frequency of a column held at one end, pi c/(2 L):
    !! viscous [1/s], local [-], fading [-].
    integer, intent(in) :: kind
    real(wp), intent(in) :: wave_speed   !! of the drained skeleton [m/s]
    real(wp), intent(in) :: length       !! largest extent of the body [m]

    select case (kind)
    case (damping_viscous)
      coefficient = viscous_ratio*pi*wave_speed/(2.0_wp*length)
    case (damping_local)
      coefficient = local_coefficient
    case (damping_fading)
      coefficient = fading_exponent
    case default
      coefficient = 0.0_wp
    end select
  end function automatic_damping

  pure real(wp) function fastest_damping(wave_speed, length) result(rate)
    !! Where fading damping starts: critical for the lowest frequency, twice pi c/(2 L) [1/s].
    real(wp), intent(in) :: wave_speed   !! of the drained skeleton [m/s]
    real(wp), intent(in) :: length       !! largest extent of the body [m]

    rate = pi*wave_speed/length
  end function fastest_damping

  pure real(wp) function damping_at(kind, coefficient, start, time) result(c)
    !! Coefficient at a time: viscous and fading [1/s], local [-].
    !!
    !! Fading: c = b/(t + b/c_0). Waves decay like t**(-b/2) whatever their frequency, and a motion
    !! that slows down like a power of time (consolidation) is disturbed by rho c v, of the order
    !! of its own inertia rho v/t; a constant c that stills waves as well disturbs it far longer.
    integer, intent(in) :: kind
    real(wp), intent(in) :: coefficient   !! of the scene; fading: b [-]
    real(wp), intent(in) :: start         !! c_0 of fading damping [1/s]
    real(wp), intent(in) :: time          !! since the start [s]

    c = coefficient
    if (kind == damping_fading) c = coefficient*start/(coefficient + start*time)
  end function damping_at

  pure subroutine damp_forces(kind, coefficient, n_node, nodal)
    !! Kernel: adds damping to complete nodal forces (after scatter_add and external loads).
    integer, intent(in) :: kind
    real(wp), intent(in) :: coefficient                     !! at this time [1/s], local [-]
    integer, intent(in) :: n_node
    real(wp), intent(inout) :: nodal(1 + 2*ndim, n_node)    !! mass, momentum, force [N]
    real(wp) :: momentum, force
    integer :: a, i

    do i = 1, n_node
      do a = 1, ndim
        momentum = nodal(1 + a, i)
        force = nodal(1 + ndim + a, i)
        if (kind == damping_viscous .or. kind == damping_fading) then
          nodal(1 + ndim + a, i) = force - coefficient*momentum
        else if (kind == damping_local .and. abs(momentum) > 0.0_wp) then
          nodal(1 + ndim + a, i) = force - coefficient*sign(abs(force), momentum)
        end if
      end do
    end do
  end subroutine damp_forces
end module dosui_damping

!! Surface points that choose between a head and a flux: reservoirs, seepage faces, rainfall.
!!
!! Water leaves a seepage face at zero pressure and does not enter it: points with inflow close,
!! closed points whose pressure would be positive open. Rain enters as far as the soil takes it:
!! where the pressure would become positive it ponds (zero pressure, the rest runs off) until the
!! soil takes all of it again. Points below a reservoir's level have its head.
!!
!! A review follows every step, or every attempt at a step that can be repeated. A point that has
!! changed twice in one step stays as it is, so that no step goes on for ever.
module dosui_seepage
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_ghosts, only: gather_field
  use dosui_model, only: model_t
  use dosui_topology, only: build_water
  use dosui_water_balance, only: surface_values
  use dosui_water_step, only: prepare_flow, set_surface_data, surface_elevation
  implicit none
  private

  real(wp), parameter :: slack = 1.0e-6_wp   !! of k and of a spacing's head, against round-off [-]
  integer, parameter :: most_changes = 2     !! of a point in one step

  type, public :: seepage_t
    integer, allocatable, private :: n_changed(:)   !! of each owned surface point in this step
  contains
    procedure :: start_step => seepage_start_step
    procedure :: review => seepage_review
  end type seepage_t

contains

  subroutine seepage_start_step(self, model)
    !! Allows changes again.
    class(seepage_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    if (allocated(self%n_changed)) deallocate (self%n_changed)
    allocate (self%n_changed(model%surface%count), source=0)
  end subroutine seepage_start_step

  subroutine seepage_review(self, model, time, pressure, changed)
    !! Opens and closes points by the pressures at a time; rebuilds the head operator if any
    !! changed. Collective.
    class(seepage_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time           !! [s]
    real(wp), intent(in) :: pressure(:)    !! of owned particles [Pa]
    logical, intent(out) :: changed        !! any, on any rank
    real(wp), allocatable :: measured(:), elevation(:)
    logical :: has_head
    integer :: p, n

    changed = .false.
    if (.not. model%water%switching) return
    call set_surface_data(model, time)
    call prepare_flow(model, pressure)
    call measure(model, measured)
    call surface_elevation(model, elevation)
    n = 0
    do p = 1, model%surface%count
      if (.not. model%water%hydraulic_conditions%may_switch(p)) cycle
      if (self%n_changed(p) >= most_changes) cycle
      associate (now => model%surface%field(model%s%has_head)%values(1, p))
        has_head = wants_head(model, p, time, now > 0.5_wp, measured(p), elevation(p))
        if (has_head .eqv. now > 0.5_wp) cycle
        now = merge(1.0_wp, 0.0_wp, has_head)
      end associate
      self%n_changed(p) = self%n_changed(p) + 1
      n = n + 1
    end do
    n = model%comm%sum(n)
    changed = n > 0
    if (.not. changed) return
    model%water%switches = model%water%switches + int(n, i8)
    call gather_field(model%comm, model%surface, model%water%surface_map, model%s%has_head)
    call rebuild(model, time)
  end subroutine seepage_review

  subroutine measure(model, measured)
    !! Outward flux of owned surface points with a head [m/s], head of the others [m]. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: measured(:)
    real(wp) :: values(model%water%surface_flux%n)
    integer :: e, p

    allocate (measured(model%surface%count + model%surface%ghost_count), source=0.0_wp)
    call surface_values(model, values)
    do e = 1, model%water%surface_flux%n
      p = model%water%surface_flux%point(e)
      measured(p) = measured(p) + model%water%surface_flux%share(e)*values(e)
    end do
    call model%water%surface_map%scatter_add(model%comm, 1, measured)
  end subroutine measure

  logical function wants_head(model, p, time, has_head, measured, elevation)
    !! Does a point prescribe a head from now on?
    type(model_t), intent(in) :: model
    integer, intent(in) :: p               !! surface point
    real(wp), intent(in) :: time           !! [s]
    logical, intent(in) :: has_head        !! at present
    real(wp), intent(in) :: measured       !! its outward flux [m/s], or its head [m]
    real(wp), intent(in) :: elevation      !! [m]
    real(wp) :: value, allowed

    associate (condition => model%scene%hydraulic_condition( &
               model%water%hydraulic_conditions%condition(p)), &
               field => model%surface%field, k => maxval(model%scene%material% &
                                                         hydraulic_conductivity%constant))
      value = 0.0_wp
      if (condition%kind /= 'seepage_face') then
        value = condition%value_at(time, field(model%s%position)%values(:, p))
      end if
      if (condition%kind == 'reservoir' .and. value > elevation) then
        wants_head = .true.
      else if (has_head) then
        allowed = slack*k
        if (condition%kind == 'rainfall') then
          allowed = allowed + value*max(0.0_wp, field(model%s%normal)%values(ndim, p))
        end if
        wants_head = -measured <= allowed
      else
        wants_head = measured - elevation > slack*model%scales%spacing
      end if
    end associate
  end function wants_head

  subroutine rebuild(model, time)
    !! The head operator with the points' present kinds.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time   !! of the surfaces' data [s]
    integer :: place

    call model%timers%start(model%phase%rebuild)
    place = model%p%water_position
    call build_water(model, place)
    call set_surface_data(model, time)
    model%decomposition%rebuilds = model%decomposition%rebuilds + 1
    call model%timers%stop(model%phase%rebuild)
  end subroutine rebuild
end module dosui_seepage

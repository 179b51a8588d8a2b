!! What surface points prescribe to the water: a head, or an outward flux (no-flow is flux 0).
!!
!! Points of reservoirs, seepage faces and rainfall may switch between the two: `has_head` says
!! which it is at present, and `dosui_seepage` decides.
module dosui_hydraulic_conditions
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_head_operator, only: kind_flux, kind_head
  use dosui_scene, only: hydraulic_condition_t
  use dosui_surface_sets, only: set_holds, set_is_empty
  implicit none
  private

  type, public :: hydraulic_conditions_t
    integer, allocatable :: condition(:)   !! of each surface point, 0: no-flow by default
    integer, allocatable :: kind(:)        !! kind_head or kind_flux of each surface point
    real(wp), allocatable :: datum(:)      !! total head [m] or outward Darcy flux [m/s]
    logical, allocatable :: may_switch(:)  !! of each surface point
  contains
    procedure :: init => hydraulic_conditions_init
    procedure :: set_time => hydraulic_conditions_set_time
  end type hydraulic_conditions_t

contains

  subroutine hydraulic_conditions_init(self, conditions, condition_surface, n_point, surface, &
                                       has_head)
    !! Finds the condition of every surface point (the last of equal ones).
    class(hydraulic_conditions_t), intent(inout) :: self
    type(hydraulic_condition_t), intent(in) :: conditions(:)
    integer, intent(in) :: condition_surface(size(conditions))   !! surface of each condition
    integer, intent(in) :: n_point
    real(wp), intent(in) :: surface(:, :)   !! sets of surfaces of the points, as bits [-]
    logical, intent(in) :: has_head(n_point)                     !! of points that may switch
    integer :: p, c

    if (allocated(self%condition)) then
      deallocate (self%condition, self%kind, self%datum, self%may_switch)
    end if
    allocate (self%condition(n_point), source=0)
    allocate (self%kind(n_point), source=kind_flux)
    allocate (self%datum(n_point), source=0.0_wp)
    allocate (self%may_switch(n_point), source=.false.)
    do p = 1, n_point
      if (set_is_empty(surface(:, p))) cycle
      do c = 1, size(conditions)
        if (set_holds(surface(:, p), condition_surface(c))) self%condition(p) = c
      end do
      c = self%condition(p)
      if (c == 0) cycle
      self%may_switch(p) = conditions(c)%may_switch()
      if (conditions(c)%kind == 'head' .or. conditions(c)%kind == 'pressure' .or. &
          (self%may_switch(p) .and. has_head(p))) self%kind(p) = kind_head
    end do
  end subroutine hydraulic_conditions_init

  subroutine hydraulic_conditions_set_time(self, conditions, time, unit_weight, elevation, &
                                           position, normal)
    !! Sets the data of all surface points.
    class(hydraulic_conditions_t), intent(inout) :: self
    type(hydraulic_condition_t), intent(in) :: conditions(:)
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(in) :: unit_weight      !! gamma_w [N/m3]
    real(wp), intent(in) :: elevation(:)     !! of the surface points [m]
    real(wp), intent(in) :: position(:, :)   !! of the surface points [m]
    real(wp), intent(in) :: normal(:, :)     !! outward [-]
    real(wp) :: value, steady(size(conditions))
    logical :: is_uniform(size(conditions))
    integer :: p, c

    do c = 1, size(conditions)
      is_uniform(c) = .not. allocated(conditions(c)%pattern%formula)
      if (is_uniform(c)) steady(c) = conditions(c)%uniform_value_at(time)
    end do
    do p = 1, size(self%condition)
      c = self%condition(p)
      if (c == 0) cycle
      if (is_uniform(c)) then
        value = steady(c)
      else
        value = conditions(c)%value_at(time, position(:, p))
      end if
      select case (conditions(c)%kind)
      case ('pressure')
        self%datum(p) = value/unit_weight + elevation(p)
      case ('head', 'flux')
        self%datum(p) = value
      case ('reservoir')
        self%datum(p) = merge(max(value, elevation(p)), 0.0_wp, self%kind(p) == kind_head)
      case ('seepage_face')
        self%datum(p) = merge(elevation(p), 0.0_wp, self%kind(p) == kind_head)
      case ('rainfall')
        self%datum(p) = merge(elevation(p), -value*max(normal(ndim, p), 0.0_wp), &
                              self%kind(p) == kind_head)
      case default   ! no_flow
        self%datum(p) = 0.0_wp
      end select
    end do
  end subroutine hydraulic_conditions_set_time
end module dosui_hydraulic_conditions

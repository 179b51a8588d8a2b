!! What surface points prescribe to the water: a head, or an outward flux (no-flow is flux 0).
module dosui_hydraulic_conditions
  use dosui_kinds, only: wp
  use dosui_head_operator, only: kind_flux, kind_head
  use dosui_scene, only: hydraulic_condition_t
  implicit none
  private

  type, public :: hydraulic_conditions_t
    integer, allocatable :: condition(:)   !! of each surface point, 0: no-flow by default
    integer, allocatable :: kind(:)        !! kind_head or kind_flux of each surface point
    real(wp), allocatable :: datum(:)      !! total head [m] or outward Darcy flux [m/s]
  contains
    procedure :: init => hydraulic_conditions_init
    procedure :: set_time => hydraulic_conditions_set_time
  end type hydraulic_conditions_t

contains

  subroutine hydraulic_conditions_init(self, conditions, condition_surface, n_point, surface)
    !! Finds the condition of every surface point: the last one that names its surface.
    class(hydraulic_conditions_t), intent(inout) :: self
    type(hydraulic_condition_t), intent(in) :: conditions(:)
    integer, intent(in) :: condition_surface(size(conditions))   !! surface of each condition
    integer, intent(in) :: n_point
    integer, intent(in) :: surface(n_point)                      !! 0: unnamed
    integer :: p, c

    if (allocated(self%condition)) deallocate (self%condition, self%kind, self%datum)
    allocate (self%condition(n_point), source=0)
    allocate (self%kind(n_point), source=kind_flux)
    allocate (self%datum(n_point), source=0.0_wp)
    do p = 1, n_point
      if (surface(p) == 0) cycle
      do c = 1, size(conditions)
        if (condition_surface(c) == surface(p)) self%condition(p) = c
      end do
      c = self%condition(p)
      if (c == 0) cycle
      if (conditions(c)%kind == 'head' .or. conditions(c)%kind == 'pressure') then
        self%kind(p) = kind_head
      end if
    end do
  end subroutine hydraulic_conditions_init

  subroutine hydraulic_conditions_set_time(self, conditions, time, unit_weight, elevation)
    !! Sets the data of all surface points.
    class(hydraulic_conditions_t), intent(inout) :: self
    type(hydraulic_condition_t), intent(in) :: conditions(:)
    real(wp), intent(in) :: time           !! [s]
    real(wp), intent(in) :: unit_weight    !! gamma_w [N/m3]
    real(wp), intent(in) :: elevation(:)   !! of the surface points [m]
    real(wp) :: value(size(conditions))
    integer :: p, c

    do c = 1, size(conditions)
      value(c) = conditions(c)%value*conditions(c)%factor%at(time)
    end do
    do p = 1, size(self%condition)
      c = self%condition(p)
      if (c == 0) cycle
      if (conditions(c)%kind == 'pressure') then
        self%datum(p) = value(c)/unit_weight + elevation(p)
      else if (conditions(c)%kind == 'no_flow') then
        self%datum(p) = 0.0_wp
      else
        self%datum(p) = value(c)
      end if
    end do
  end subroutine hydraulic_conditions_set_time
end module dosui_hydraulic_conditions

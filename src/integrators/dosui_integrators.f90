!! The one place that knows every integrator by its name. A new one adds its case here, its facts in
!! `dosui_integrator_traits` and its column in `dosui_capabilities`.
module dosui_integrators
  use dosui_kinds, only: i8
  use dosui_error, only: error_t
  use dosui_explicit, only: explicit_t
  use dosui_integrator, only: integrator_t
  use dosui_integrator_traits, only: explicit, quasi_static, semi_implicit
  use dosui_quasi_static, only: quasi_static_t
  use dosui_semi_implicit, only: semi_implicit_t
  implicit none
  private

  public :: create_integrator

  integer(i8), parameter :: many_steps = 64_i8   !! between looks: explicit steps are cheap

contains

  subroutine create_integrator(name, integrator, err)
    !! The integrator with a name; an error for others, 'auto' among them.
    character(len=*), intent(in) :: name
    class(integrator_t), allocatable, intent(out) :: integrator
    type(error_t), intent(inout) :: err

    select case (name)
    case (explicit)
      allocate (explicit_t :: integrator)
      integrator%look_interval = many_steps
    case (semi_implicit)
      allocate (semi_implicit_t :: integrator)
    case (quasi_static)
      allocate (quasi_static_t :: integrator)
    case default
      call err%set('there is no integrator '''//trim(name)//'''')
    end select
  end subroutine create_integrator
end module dosui_integrators

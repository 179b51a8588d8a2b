!! What the parts of a model ask about the integrator that will advance it: facts, not its name.
module dosui_integrator_traits
  use dosui_scene, only: name_length
  implicit none
  private

  type, public :: integrator_traits_t
    !! The facts of an explicit integrator, if nothing else is said.
    character(len=name_length) :: name = 'explicit'   !! as keys and messages have it
    logical :: solves_skeleton = .false.   !! equations hold the stiffness of the skeleton
    logical :: solves_water = .false.      !! equations hold the pressures of the water
  contains
    procedure :: is_explicit => traits_is_explicit
    procedure :: projects => traits_projects
  end type integrator_traits_t

  public :: traits_of

  character(len=*), parameter, public :: explicit = 'explicit'
  character(len=*), parameter, public :: semi_implicit = 'semi_implicit'
  character(len=*), parameter, public :: quasi_static = 'quasi_static'

contains

  pure function traits_of(name) result(traits)
    !! The facts of the integrator with a name.
    character(len=*), intent(in) :: name
    type(integrator_traits_t) :: traits

    traits%name = name
    traits%solves_skeleton = name == quasi_static
    traits%solves_water = name == quasi_static .or. name == semi_implicit
  end function traits_of

  pure logical function traits_is_explicit(self) result(is_explicit)
    !! No equations at all?
    class(integrator_traits_t), intent(in) :: self

    is_explicit = .not. (self%solves_skeleton .or. self%solves_water)
  end function traits_is_explicit

  pure logical function traits_projects(self) result(projects)
    !! Explicit skeleton, implicit water?
    class(integrator_traits_t), intent(in) :: self

    projects = self%solves_water .and. .not. self%solves_skeleton
  end function traits_projects
end module dosui_integrator_traits

!! What the parts of a model ask about the integrator that advances it: facts, not its name.
module dosui_integrator_traits
  use dosui_kinds, only: wp
  use dosui_text, only: to_text
  implicit none
  private

  integer, parameter :: longest = 16   !! name of an integrator
  character(len=*), parameter, public :: explicit = 'explicit'
  character(len=*), parameter, public :: semi_implicit = 'semi_implicit'
  character(len=*), parameter, public :: quasi_static = 'quasi_static'
  character(len=*), parameter, public :: automatic = 'auto'   !! none of them yet
  character(len=*), parameter, public :: integrators(3) = [character(len=longest) :: explicit, &
                                                                        semi_implicit, quasi_static]

  type, public :: integrator_traits_t
    !! The facts of an explicit integrator, if nothing else is said.
    character(len=longest) :: name = 'explicit'   !! as keys and messages have it
    logical :: solves_skeleton = .false.   !! equations hold the stiffness of the skeleton
    logical :: solves_water = .false.      !! equations hold the pressures of the water
  contains
    procedure :: is_explicit => traits_is_explicit
    procedure :: projects => traits_projects
    procedure :: has_inertia => traits_has_inertia
    procedure :: stands => traits_stands
  end type integrator_traits_t

  type, public :: integrator_choice_t
    !! Why a scene has its integrator, and how many steps each would take.
    character(len=:), allocatable :: reason
    logical :: is_automatic = .false.   !! the scene left it open
    real(wp) :: steps(size(integrators)) = 0.0_wp
    !! estimates for the whole run, in the order of `integrators`; 0: not possible [-]
  contains
    procedure :: steps_of => choice_steps_of
    procedure :: describe => choice_describe
  end type integrator_choice_t

  public :: traits_of

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

  pure logical function traits_has_inertia(self) result(has_inertia)
    !! Do masses oppose accelerations?
    class(integrator_traits_t), intent(in) :: self

    has_inertia = .not. self%solves_skeleton
  end function traits_has_inertia

  pure logical function traits_stands(self) result(stands)
    !! Is it an integrator, and not left open?
    class(integrator_traits_t), intent(in) :: self

    stands = any(integrators == self%name)
  end function traits_stands

  pure real(wp) function choice_steps_of(self, name) result(steps)
    !! What the integrator with a name would take for the whole run; 0: it cannot [-].
    class(integrator_choice_t), intent(in) :: self
    character(len=*), intent(in) :: name

    steps = sum(pack(self%steps, integrators == name))
  end function choice_steps_of

  function choice_describe(self) result(text)
    !! The steps of all integrators that can run the scene: 'about 12 explicit, 3 quasi_static'.
    class(integrator_choice_t), intent(in) :: self
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = 1, size(integrators)
      if (.not. self%steps(k) > 0.0_wp) cycle
      if (len(text) > 0) text = text//', '
      text = text//to_text(self%steps(k), 2)//' '//trim(integrators(k))
    end do
    text = 'about '//text//' steps'
  end function choice_describe
end module dosui_integrator_traits

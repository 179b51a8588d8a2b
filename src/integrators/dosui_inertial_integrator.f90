!! What integrators with inertia have in common: a start from rest or from the undrained
!! equilibrium, steps that waves limit, and particles that may move through the grid.
module dosui_inertial_integrator
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_following, only: keep_up
  use dosui_integrator, only: integrator_t
  use dosui_model, only: model_t
  use dosui_skeleton_step, only: start_forces
  use dosui_starts, only: undrained_start
  use dosui_state_check, only: check_state
  use dosui_step_watch, only: step_watch_t
  use dosui_transfer_filter, only: set_filter_times
  implicit none
  private

  type, abstract, extends(integrator_t), public :: inertial_integrator_t
    type(step_watch_t), private :: watch   !! over steps that get too small
  contains
    procedure :: init => inertial_init
    procedure :: start => inertial_start
    procedure :: step => inertial_step
    procedure :: memory => inertial_memory
    procedure :: recall => inertial_recall
    procedure(inertial_advance), deferred :: advance
  end type inertial_integrator_t

  abstract interface
    subroutine inertial_advance(self, model, err)
      !! Advances the state, but not the clock, by the clock's step. Collective.
      import :: inertial_integrator_t, model_t, error_t
      implicit none
      class(inertial_integrator_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
      type(error_t), intent(inout) :: err
    end subroutine inertial_advance
  end interface

contains

  subroutine inertial_init(self, model, err)
    !! A watch that has seen nothing yet is all that is kept beside the model.
    class(inertial_integrator_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    associate (not_used => model, nor => err)
    end associate
    self%watch = step_watch_t()
  end subroutine inertial_init

  subroutine inertial_start(self, model, err)
    !! The undrained equilibrium, if the scene asks for it, and the forces at the start. Collective.
    class(inertial_integrator_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    associate (not_used => self)
    end associate
    if (model%scene%time%undrained_start .and. .not. model%rigid) call undrained_start(model, err)
    if (.not. err%failed()) call check_state(model, err)
    if (err%failed()) return
    call set_filter_times(model)   ! of the stresses that starts have found
    if (.not. model%rigid) call start_forces(model)
  end subroutine inertial_start

  subroutine inertial_step(self, model, err)
    !! One step with inertia: choose dt, advance, follow the particles. Collective.
    class(inertial_integrator_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call self%choose_step(model)
    call self%watch%look(model, err)
    if (.not. err%failed()) call self%advance(model, err)
    if (err%failed()) return
    call model%clock%advance()
    if (model%updated) call keep_up(model, err)
  end subroutine inertial_step

  pure function inertial_memory(self) result(values)
    !! The watch over small steps.
    class(inertial_integrator_t), intent(in) :: self
    real(wp), allocatable :: values(:)   !! [several units]

    values = self%watch%memory()
  end function inertial_memory

  subroutine inertial_recall(self, model, values, err)
    !! Goes on watching.
    class(inertial_integrator_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: values(:)   !! as from `memory` [several units]
    type(error_t), intent(inout) :: err

    associate (not_used => model, nor => err)
    end associate
    call self%watch%recall(values)
  end subroutine inertial_recall
end module dosui_inertial_integrator

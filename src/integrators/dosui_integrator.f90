!! What every integrator can do. A run asks for nothing else: `dosui_simulation` knows this type
!! only, and `dosui_integrators` alone knows which integrators there are.
module dosui_integrator
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: most_steps = 9.0e18_wp   !! that 64 bits count

  type, abstract, public :: integrator_t
    integer(i8) :: look_interval = 1_i8   !! steps between looks at signals, the clock and NaN
  contains
    procedure(integrator_init), deferred :: init
    procedure(integrator_init), deferred :: start
    procedure(integrator_choose_step), deferred :: choose_step
    procedure(integrator_init), deferred :: step
    procedure(integrator_describe), deferred :: describe
    procedure(integrator_memory), deferred :: memory
    procedure(integrator_recall), deferred :: recall
    procedure :: announce => integrator_announce
  end type integrator_t

  abstract interface
    subroutine integrator_init(self, model, err)
      !! `init`: what steps need beside the model, after a restart, too.
      !! `start`: the equilibrium that a new run begins with, after `init`.
      !! `step`: one step, however many attempts it takes; advances the clock, and grid and owners
      !! follow the particles. All are collective.
      import :: integrator_t, model_t, error_t
      implicit none
      class(integrator_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
      type(error_t), intent(inout) :: err
    end subroutine integrator_init
    subroutine integrator_choose_step(self, model)
      !! Sets the clock's step for the next attempt, and what limits it. Collective.
      import :: integrator_t, model_t
      implicit none
      class(integrator_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
    end subroutine integrator_choose_step
    function integrator_describe(self) result(text)
      !! What it took, for the closing summary; empty: nothing to say.
      import :: integrator_t
      implicit none
      class(integrator_t), intent(in) :: self
      character(len=:), allocatable :: text
    end function integrator_describe
    pure function integrator_memory(self) result(values)
      !! What steps follow from beside the model, for checkpoints. The same on all ranks.
      import :: integrator_t, wp
      implicit none
      class(integrator_t), intent(in) :: self
      real(wp), allocatable :: values(:)   !! [several units]
    end function integrator_memory
    subroutine integrator_recall(self, model, values, err)
      !! Takes up the steps of the run that wrote a checkpoint, after `init`. Collective.
      import :: integrator_t, model_t, error_t, wp
      implicit none
      class(integrator_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
      real(wp), intent(in) :: values(:)   !! as from `memory` [several units]
      type(error_t), intent(inout) :: err
    end subroutine integrator_recall
  end interface

contains

  subroutine integrator_announce(self, model)
    !! The first time step, what limits it and how many there will be. Collective.
    class(integrator_t), intent(inout) :: self
    type(model_t), intent(inout) :: model

    call self%choose_step(model)
    call model%log%info('time step    '//to_text(model%clock%dt)//' s, limited by '// &
                        trim(model%clock%limit%name)//'; about '// &
                        to_text(nint(min(model%scene%time%end_time/model%clock%limit%dt, &
                                         most_steps), i8))//' steps')
  end subroutine integrator_announce
end module dosui_integrator

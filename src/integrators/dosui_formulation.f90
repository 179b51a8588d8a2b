!! How the skeleton of implicit steps deforms: which state a motion of the nodes leads to, and which
!! forces and which change of the water's content that state has.
!!
!! The loop over stages and Newton's iterations know these verbs only. A step starts from a state
!! that `take_start` keeps; `move_to` puts the model where a motion since then brings it, as often
!! as it takes; `accept` ends the step.
module dosui_formulation
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_implicit_system, only: implicit_system_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: content_change
  use dosui_water_step, only: find_flow
  implicit none
  private

  public :: missing_in_place

  type, public :: stage_data_t
    !! What a stage of a step is given.
    real(wp) :: time = 0.0_wp              !! at its end [s]
    real(wp) :: flow_weight = 0.0_wp       !! a: weight of the flow at its end [s]
    real(wp), allocatable :: supply(:)     !! water of the particles beside a times the flow [m3]
    real(wp), allocatable :: start(:)      !! their pressures at the step's start [Pa]
  end type stage_data_t

  type, abstract, public :: formulation_t
    logical :: is_linear = .true.          !! with linear soils, and without suction
    logical :: follows_places = .false.    !! water is stored and flows where the body has moved to
    real(wp) :: least_motion = 1.0e-8_wp
    !! of a cell: Newton's tolerance is relative to this where nothing moves more [-]
  contains
    procedure(formulation_linearise), deferred :: linearise
    procedure(formulation_take_start), deferred :: take_start
    procedure(formulation_move_to), deferred :: move_to
    procedure(formulation_find_forces), deferred :: find_forces
    procedure(formulation_find_missing_water), deferred :: find_missing_water
    procedure :: accept => formulation_accept
    procedure :: start_stress => formulation_start_stress
  end type formulation_t

  abstract interface
    subroutine formulation_linearise(self, model, err)
      !! Before the first step: what kind this is, tangents and operators of the state at hand.
      !! Collective.
      import :: formulation_t, model_t, error_t
      implicit none
      class(formulation_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
      type(error_t), intent(inout) :: err
    end subroutine formulation_linearise
    subroutine formulation_take_start(self, model)
      !! Keeps the present state: motions count from here.
      import :: formulation_t, model_t
      implicit none
      class(formulation_t), intent(inout) :: self
      type(model_t), intent(in) :: model
    end subroutine formulation_take_start
    subroutine formulation_move_to(self, model, motion, err)
      !! Puts the model where a motion of the nodes since the start brings it. An error says that
      !! the motion is too large; the model then waits for a smaller one. Collective.
      import :: formulation_t, model_t, error_t, wp
      implicit none
      class(formulation_t), intent(inout) :: self
      type(model_t), intent(inout) :: model
      real(wp), intent(in) :: motion(:, :)   !! (ndim, n_node) [m]
      type(error_t), intent(inout) :: err
    end subroutine formulation_move_to
    subroutine formulation_find_forces(self, system, model, force, motion)
      !! Complete forces on the nodes in the state and with the pressures at hand, at the clock's
      !! time. Collective.
      import :: formulation_t, implicit_system_t, model_t, wp
      implicit none
      class(formulation_t), intent(in) :: self
      type(implicit_system_t), intent(inout) :: system
      type(model_t), intent(inout) :: model
      real(wp), intent(inout) :: force(:, :)           !! (ndim, n_node) [N]
      real(wp), intent(in), optional :: motion(:, :)
      !! (ndim, n_node) since the start, which weak modes resist; absent: none [m]
    end subroutine formulation_find_forces
    subroutine formulation_find_missing_water(self, system, model, stage, pressure, water, err)
      !! Water that the state at hand lacks: supply + a F - stored - squeezed [m3]. Collective.
      import :: formulation_t, implicit_system_t, model_t, stage_data_t, error_t, wp
      implicit none
      class(formulation_t), intent(in) :: self
      type(implicit_system_t), intent(inout) :: system
      type(model_t), intent(inout) :: model
      class(stage_data_t), intent(in) :: stage
      real(wp), intent(in) :: pressure(:)      !! of the particles since the start [Pa]
      real(wp), intent(inout) :: water(:)      !! of the particles [m3]
      type(error_t), intent(inout) :: err
    end subroutine formulation_find_missing_water
  end interface

contains

  subroutine formulation_accept(self, model)
    !! Ends a step of the clock's length whose state the model has. Motions that went through the
    !! kernels of a step have left velocities and volume changes already.
    class(formulation_t), intent(inout) :: self
    type(model_t), intent(inout) :: model

    associate (not_used => self, nor => model)
    end associate
  end subroutine formulation_accept

  subroutine formulation_start_stress(self, stress)
    !! Effective stresses at the start, if motions add increments to these. Others, which turn with
    !! the body or do not count, leave the argument as it is.
    class(formulation_t), intent(in) :: self
    real(wp), allocatable, intent(inout) :: stress(:, :)   !! (nsig, n) [Pa]

    associate (not_used => self, nor => stress)
    end associate
  end subroutine formulation_start_stress

  subroutine missing_in_place(system, model, stage, pressure, water)
    !! Water that pores lack which keep their places and volumes: supply + a F - stored [m3].
    !! Collective.
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    class(stage_data_t), intent(in) :: stage
    real(wp), intent(in) :: pressure(:)      !! of the particles since the start [Pa]
    real(wp), intent(inout) :: water(:)      !! of the particles [m3]
    real(wp) :: stored(size(water))

    call find_flow(model, stage%time, stage%start + pressure, water)
    call system%stored_by_projection(pressure, stored)
    water = stage%supply + stage%flow_weight*water - stored - model%mesh%water_weight* &
            (content_change(model, stage%start, stage%start + pressure) - &
             model%water%storage%compressibility*pressure)
  end subroutine missing_in_place
end module dosui_formulation

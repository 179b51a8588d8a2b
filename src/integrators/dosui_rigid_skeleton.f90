!! A skeleton that does not move: only the water has equations.
module dosui_rigid_skeleton
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_formulation, only: formulation_t, missing_in_place, stage_data_t
  use dosui_implicit_system, only: implicit_system_t
  use dosui_model, only: model_t
  implicit none
  private

  type, extends(formulation_t), public :: rigid_skeleton_t
  contains
    procedure :: linearise => rigid_linearise
    procedure :: take_start => rigid_take_start
    procedure :: move_to => rigid_move_to
    procedure :: find_forces => rigid_find_forces
    procedure :: find_missing_water => rigid_find_missing_water
  end type rigid_skeleton_t

contains

  subroutine rigid_linearise(self, model, err)
    !! Suction alone makes the equations nonlinear.
    class(rigid_skeleton_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    associate (not_used => err)
    end associate
    self%is_linear = .not. model%nonlinear
  end subroutine rigid_linearise

  subroutine rigid_take_start(self, model)
    !! There is nothing to keep.
    class(rigid_skeleton_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    associate (not_used => self, nor => model)
    end associate
  end subroutine rigid_take_start

  subroutine rigid_move_to(self, model, motion, err)
    !! Nothing moves.
    class(rigid_skeleton_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! [m]
    type(error_t), intent(inout) :: err

    associate (not_used => self, nor => model, neither => motion, this => err)
    end associate
  end subroutine rigid_move_to

  subroutine rigid_find_forces(self, system, model, force, motion)
    !! None that anything feels.
    class(rigid_skeleton_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: force(:, :)           !! [N]
    real(wp), intent(in), optional :: motion(:, :)   !! of the nodes since the start [m]

    associate (not_used => self, nor => system, neither => model, this => motion)
    end associate
    force = 0.0_wp
  end subroutine rigid_find_forces

  subroutine rigid_find_missing_water(self, system, model, stage, pressure, water, err)
    !! Nothing is squeezed out. Collective.
    class(rigid_skeleton_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    class(stage_data_t), intent(in) :: stage
    real(wp), intent(in) :: pressure(:)      !! since the start [Pa]
    real(wp), intent(inout) :: water(:)      !! [m3]
    type(error_t), intent(inout) :: err

    associate (not_used => self, nor => err)
    end associate
    call missing_in_place(system, model, stage, pressure, water)
  end subroutine rigid_find_missing_water
end module dosui_rigid_skeleton

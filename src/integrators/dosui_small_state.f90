!! The state that trial motions of nonlinear small-strain steps start from. A trial runs through the
!! kernels of an explicit step, so that forces, stresses and volume changes are theirs.
module dosui_small_state
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_skeleton_step, only: update_particles, zero_velocities
  implicit none
  private

  type, public :: small_start_t
    real(wp), allocatable :: displacement(:, :)           !! of the particles [m]
    real(wp), allocatable :: stress(:, :)                 !! effective [Pa]
    real(wp), allocatable :: state(:, :)                  !! of the materials
    real(wp), allocatable :: surface_displacement(:, :)   !! of the surface points [m]
  contains
    procedure :: take => start_take
    procedure :: move => start_move
  end type small_start_t

contains

  subroutine start_take(self, model)
    !! Keeps the present state.
    class(small_start_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      self%displacement = field(h%displacement)%values(:, 1:n)
      self%stress = field(h%effective_stress)%values(:, 1:n)
    end associate
    if (model%p%state > 0) then
      associate (n => model%particles%count)
        self%state = model%particles%field(model%p%state)%values(:, 1:n)
      end associate
    end if
    associate (m => model%surface%count)
      self%surface_displacement = model%surface%field(model%s%displacement)%values(:, 1:m)
    end associate
  end subroutine start_take

  subroutine start_move(self, model, motion, err)
    !! Puts the model where a motion of the nodes since the start brings it. Collective.
    class(small_start_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    type(error_t), intent(inout) :: err

    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      field(h%displacement)%values(:, 1:n) = self%displacement
      field(h%effective_stress)%values(:, 1:n) = self%stress
    end associate
    if (model%p%state > 0) then
      associate (n => model%particles%count)
        model%particles%field(model%p%state)%values(:, 1:n) = self%state
      end associate
    end if
    associate (m => model%surface%count)
      model%surface%field(model%s%displacement)%values(:, 1:m) = self%surface_displacement
    end associate
    call zero_velocities(model)
    model%velocity_old = 0.0_wp
    model%velocity = motion/model%clock%dt
    call update_particles(model, err)
    call model%comm%agree(err)
  end subroutine start_move
end module dosui_small_state

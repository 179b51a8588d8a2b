!! One explicit time step of the coupled (or dry, or rigid) problem.
!!
!! Momentum at t_n with the pressures of t_n, then stress and pressures with the new velocities:
!! a staggered (symplectic Euler) scheme. Water may take several sub-steps in one step of the
!! skeleton, with the volume change of the step held constant.
module dosui_explicit
  use dosui_model, only: model_t
  use dosui_skeleton_step, only: gather_forces, update_nodes, update_particles
  use dosui_water_step, only: update_pressure
  implicit none
  private

  public :: explicit_step

contains

  subroutine explicit_step(model, drained)
    !! Advances the model by the clock's step; `drained = .false.` keeps the water in place.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: drained

    if (.not. model%rigid) then
      call gather_forces(model)
      call update_nodes(model)
      call update_particles(model)
    end if
    if (model%coupled) call update_pressure(model, drained)
  end subroutine explicit_step
end module dosui_explicit

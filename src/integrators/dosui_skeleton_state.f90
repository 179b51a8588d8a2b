!! The part of a model that its skeleton's motion is solved with.
module dosui_skeleton_state
  use dosui_kinds, only: wp
  use dosui_nodal_conditions, only: nodal_conditions_t
  use dosui_outer_pressure, only: outer_pressure_t
  use dosui_surface_forces, only: surface_forces_t
  implicit none
  private

  type, public :: skeleton_state_t
    !! What the solution of the momentum balance holds beside the particles: nodal values,
    !! conditions on the body, strains of the step.
    real(wp), allocatable :: nodal(:, :)
    !! (1 + 2 ndim, n_node) mass [kg], momentum [kg m/s], force [N]
    real(wp), allocatable :: velocity_old(:, :)   !! (ndim, n_node) before the step [m/s]
    real(wp), allocatable :: velocity(:, :)       !! (ndim, n_node) after the step [m/s]
    real(wp) :: filter_time = 0.0_wp   !! of AFLIP, if it is the same everywhere [s]
    real(wp), allocatable :: node_filter_time(:)  !! of nodes, if it is not [s]
    real(wp), allocatable :: node_share(:)        !! of AFLIP in the step, likewise [-]
    type(nodal_conditions_t) :: nodal_conditions
    type(surface_forces_t) :: surface_forces
    type(outer_pressure_t) :: outer_pressure  !! pressures on surfaces that move
    real(wp), allocatable :: pressed_volume(:)
    !! of the particles for these, as old as the weights: trial motions change the volumes [m3]
    real(wp), allocatable :: strain_increment(:, :)   !! (nsig, particles) of the step [-]
    real(wp), allocatable :: spin(:, :)               !! (nshear, particles) in updated scenes [-]
    real(wp), allocatable :: no_state(:, :)           !! (0, n) for materials without state [-]
    real(wp), allocatable :: tangent(:, :, :)         !! of stresses, nonlinear implicit steps [Pa]
    real(wp), allocatable :: inertia(:)               !! least inertia of nodes [kg]
    real(wp), allocatable :: shift(:, :)
    !! (ndim, n_node) constant forces where surfaces cut cells (`dosui_cut_weight`) [N]
    real(wp), allocatable :: inverse_deformation(:, :, :)   !! F^-1 of finite strains [-]
    real(wp), allocatable :: own_volume(:)   !! weight without averages, of finite strains [m3]
    real(wp), allocatable :: filling(:)      !! weight over volume, of finite strains [-]
    real(wp) :: damping = 0.0_wp              !! the scene's coefficient [1/s] or [-]
    real(wp) :: damping_start = 0.0_wp        !! of fading damping [1/s]
    integer :: damping_kind = 0
    logical :: lifted = .false.               !! walls take part in the cells' strains, on any rank
    logical :: averaged = .false.    !! volume change is averaged over cells
    logical :: centred = .false.     !! means of cells come from one gradient per cell
    logical, allocatable :: on_nodes(:, :)    !! (mechanical conditions, surface points)
    logical, allocatable :: by_force(:, :)    !! likewise: tractions and penalty walls
  end type skeleton_state_t
end module dosui_skeleton_state

!! The state that time integrators advance, and nothing else: particles, surface points, the grid
!! they touch, conditions, and (in coupled scenes only) the water's operators.
module dosui_model
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_grid, only: grid_t
  use dosui_integrator_traits, only: integrator_traits_t
  use dosui_log, only: log_t
  use dosui_materials, only: material_set_t
  use dosui_particle_fields, only: particle_handles_t, surface_handles_t
  use dosui_point_set, only: point_set_t
  use dosui_reactions, only: reactions_t
  use dosui_scene, only: scene_t
  use dosui_sources, only: sources_t
  use dosui_time_control, only: time_control_t
  use dosui_timers, only: timers_t
  use dosui_skeleton_state, only: skeleton_state_t
  use dosui_water_state, only: water_state_t
  use dosui_mesh, only: mesh_t
  use dosui_decomposition, only: decomposition_t
  use dosui_scales, only: scales_t
  implicit none
  private

  type, public :: phase_timers_t
    !! Handles of the timers of a run's phases.
    integer :: rebuild = 0, to_grid = 0, nodes = 0, to_particles = 0, stress = 0, water = 0
    integer :: halo = 0, output = 0, assembly = 0, solver = 0
  end type phase_timers_t

  type, public :: balance_t
    !! Running sums of this rank, for the history and the closing summary.
    real(wp), allocatable :: inflow(:)
    !! through each hydraulic condition, and of sources; then gross, in and out [m3]
    real(wp) :: squeezed = 0.0_wp    !! water displaced by the skeleton's volume change [m3]
    real(wp) :: stored = 0.0_wp      !! water stored by compression since the start [m3]
    real(wp) :: moved = 0.0_wp       !! both of them, whatever their sign [m3]
    real(wp) :: noise = 0.0_wp       !! square of what round-off makes of them [m6]
    real(wp) :: wall_impulse(ndim) = 0.0_wp   !! of rigid walls on the bodies [N s]
    real(wp) :: lost_impulse(ndim) = 0.0_wp   !! of forces on almost massless nodes, reversed [N s]
  end type balance_t

  type, public :: model_t
    type(communicator_t) :: comm
    type(scene_t) :: scene
    type(log_t) :: log
    type(timers_t) :: timers
    type(phase_timers_t) :: phase
    type(time_control_t) :: clock
    logical :: coupled = .false.     !! water is computed
    type(integrator_traits_t) :: traits      !! of the integrator
    logical :: rigid = .false.       !! skeleton does not move: mechanics is skipped
    logical :: updated = .false.     !! particles move, geometry follows
    logical :: finite = .false.      !! finite strains on a total Lagrangian grid
    logical :: unsaturated = .false. !! suction empties pores
    logical :: nonlinear = .false.   !! soils or suction need Newton's iterations, with kinks
    logical :: finds_surface = .false.   !! free surfaces are found as bodies move
    integer :: inverted = 0          !! a particle that lost its volume or pores; 0: none
    logical :: pores_close = .false. !! ... its pores
    type(error_t) :: fault           !! the first impossible state of this rank ...
    real(wp) :: fault_time = 0.0_wp  !! ... and when: all ranks look now and then [s]
    logical :: relaxing = .false.    !! an equilibrium is sought: particles keep their places
    procedure(asked_to_end), pointer, nopass :: asked_to_end => null()   !! starts look at it
    logical :: is_interrupted = .false.   !! a start has ended because it was asked to
    type(point_set_t) :: particles
    type(particle_handles_t) :: p
    type(point_set_t) :: surface     !! points on the body's surface
    type(surface_handles_t) :: s
    type(material_set_t) :: materials
    type(sources_t) :: sources                !! body forces and water by formulas
    integer, allocatable :: material(:)       !! material of each particle
    type(grid_t) :: grid
    type(balance_t) :: balance
    type(reactions_t) :: reactions            !! forces of walls, for the histories
    real(wp) :: next_dt = 0.0_wp              !! what an adaptive integrator would take next [s]
    type(skeleton_state_t) :: skeleton
    type(water_state_t) :: water
    type(mesh_t) :: mesh
    type(decomposition_t) :: decomposition
    type(scales_t) :: scales
  end type model_t

  abstract interface
    logical function asked_to_end()
      !! Has this rank been asked to end, by a signal?
      implicit none
    end function asked_to_end
  end interface
end module dosui_model

!! The state that time integrators advance, and nothing else: particles, surface points, the grid
!! they touch, conditions, and (in coupled scenes only) the water's operators.
module dosui_model
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_barriers, only: barrier_face_t
  use dosui_cell_average, only: cell_average_t
  use dosui_cell_quadrature, only: cell_quadrature_t
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_grid, only: grid_t
  use dosui_head_operator, only: head_operator_t
  use dosui_hydraulic_conditions, only: hydraulic_conditions_t
  use dosui_index_map, only: index_map_t
  use dosui_integrator_traits, only: integrator_traits_t
  use dosui_log, only: log_t
  use dosui_materials, only: material_set_t
  use dosui_nodal_conditions, only: nodal_conditions_t
  use dosui_nodal_extension, only: nodal_extension_t
  use dosui_outer_pressure, only: outer_pressure_t
  use dosui_particle_fields, only: particle_handles_t, surface_handles_t
  use dosui_partition, only: partition_statistics_t
  use dosui_point_set, only: point_set_t
  use dosui_reactions, only: reactions_t
  use dosui_retention, only: retention_t
  use dosui_scene, only: scene_t
  use dosui_sources, only: sources_t
  use dosui_storage, only: storage_t
  use dosui_surface_forces, only: surface_forces_t
  use dosui_time_control, only: time_control_t
  use dosui_timers, only: timers_t
  use dosui_surface_flux, only: surface_flux_t
  use dosui_two_pass_operator, only: two_pass_operator_t
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
    logical :: switching = .false.   !! surface points may change between head and flux
    logical :: finds_surface = .false.   !! free surfaces are found as bodies move
    integer :: inverted = 0          !! a particle that lost its volume or pores; 0: none
    logical :: pores_close = .false. !! ... its pores
    type(error_t) :: fault           !! the first impossible state of this rank ...
    real(wp) :: fault_time = 0.0_wp  !! ... and when: all ranks look now and then [s]
    logical :: relaxing = .false.    !! an equilibrium is sought: particles keep their places
    logical :: averaged = .false.    !! volume change is averaged over cells
    logical :: centred = .false.     !! means of cells come from one gradient per cell

    type(point_set_t) :: particles
    type(particle_handles_t) :: p
    type(point_set_t) :: surface     !! points on the body's surface
    type(surface_handles_t) :: s
    type(material_set_t) :: materials
    type(sources_t) :: sources                !! body forces and water by formulas
    integer, allocatable :: material(:)       !! material of each particle
    integer, allocatable :: condition_surface(:)   !! surface of each hydraulic condition
    logical :: lifted = .false.               !! walls take part in the cells' strains, on any rank
    logical, allocatable :: on_nodes(:, :)    !! (mechanical conditions, surface points)
    logical, allocatable :: by_force(:, :)    !! likewise: tractions and penalty walls

    type(grid_t) :: grid
    integer, allocatable :: patch(:)          !! nodes' patch of each particle
    integer, allocatable :: cell(:)           !! cell of each particle
    integer, allocatable :: surface_cell(:)   !! cell of each owned surface point
    logical, allocatable :: surface_node(:)   !! nodes of surface points' cells, of any rank
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
    type(cell_average_t) :: average
    type(cell_quadrature_t) :: quadrature
    type(nodal_extension_t) :: extension   !! nodes that the body hardly touches
    real(wp), allocatable :: strain_increment(:, :)   !! (nsig, particles) of the step [-]
    real(wp), allocatable :: spin(:, :)               !! (nshear, particles) in updated scenes [-]
    real(wp), allocatable :: no_state(:, :)           !! (0, n) for materials without state [-]
    real(wp), allocatable :: tangent(:, :, :)         !! of stresses, nonlinear implicit steps [Pa]
    real(wp), allocatable :: inertia(:)               !! least inertia of nodes [kg]
    real(wp), allocatable :: shift(:, :)
    !! (ndim, n_node) constant forces where surfaces cut cells (`dosui_cut_weight`) [N]
    real(wp), allocatable :: weight(:)                !! of particles in integrals [m3]
    real(wp), allocatable :: water_weight(:)   !! likewise, of the water: centred in cells [m3]
    real(wp), allocatable :: volume_strain(:)         !! of the step, as the water sees it [-]
    logical :: inertia_drives = .false.               !! the water's inertia counts in Darcy's law
    real(wp), allocatable :: mobility(:, :)
    !! (2, n_node) then: k rho_w/gamma_w [s] and k/(gamma_w S h^2) [1/s]
    real(wp), allocatable :: inertia_strain(:)
    !! (particles) water that inertia brings in the step, over the volume [-]
    real(wp), allocatable :: inertia_flux(:)
    !! (surface points, ghosts too) against inertia's part of the outward flow [m/s]
    real(wp), allocatable :: inverse_deformation(:, :, :)   !! F^-1 of finite strains [-]
    real(wp), allocatable :: own_volume(:)   !! weight without averages, of finite strains [m3]
    real(wp), allocatable :: filling(:)      !! weight over volume, of finite strains [-]
    real(wp) :: density = 0.0_wp              !! mean inertial density of the body [kg/m3]
    real(wp) :: stiffest = 0.0_wp             !! largest undrained modulus M + K_w/n [Pa]
    real(wp) :: stiffest_now = 0.0_wp         !! likewise with the present porosities [Pa]
    real(wp) :: skeleton_modulus = 0.0_wp     !! largest drained modulus M [Pa]

    type(index_map_t) :: particle_map         !! ghost particles of the water's neighbourhoods
    type(index_map_t) :: surface_map          !! ghost surface points
    type(head_operator_t) :: head_operator
    type(two_pass_operator_t) :: two_pass
    type(hydraulic_conditions_t) :: hydraulic_conditions
    type(surface_flux_t) :: surface_flux      !! measures the inflow
    type(barrier_face_t), allocatable :: barrier(:)   !! faces that no water passes
    type(storage_t) :: storage
    real(wp), allocatable :: head(:)          !! of owned and ghost particles [m]
    real(wp), allocatable :: elevation(:)     !! likewise [m]
    type(retention_t), allocatable :: retention(:)    !! of each material
    real(wp), allocatable :: relative(:)      !! k_r of owned and ghost particles, with suction [-]
    real(wp), allocatable :: point_relative(:)   !! k_r of surface points, likewise [-]
    real(wp) :: spacing = 0.0_wp              !! smallest particle spacing [m]
    real(wp) :: largest_row_sum = 0.0_wp      !! of all ranks' head operators [1/(m s)]
    real(wp) :: diffusion_limit = huge(1.0_wp)   !! explicit limit of the water's diffusion [s]
    integer :: substeps = 1                   !! of the water in a step of the skeleton
    integer :: stages = 0                     !! of super-time-stepping; 0: Euler sub-steps

    real(wp) :: damping = 0.0_wp              !! the scene's coefficient [1/s] or [-]
    real(wp) :: damping_start = 0.0_wp        !! of fading damping [1/s]
    integer :: damping_kind = 0
    type(balance_t) :: balance
    type(reactions_t) :: reactions            !! forces of walls, for the histories
    real(wp) :: next_dt = 0.0_wp              !! what an adaptive integrator would take next [s]
    real(wp) :: pressure_scale = 0.0_wp       !! largest mean excess pressure so far [Pa]
    type(partition_statistics_t) :: partition
    integer(i8), allocatable :: brick_key(:)  !! sorted bricks of cells ...
    integer, allocatable :: brick_rank(:)     !! ... and their owners
    integer :: brick_edge = 1                 !! cells along a brick's edge
    integer :: rebuilds = 0
    integer(i8) :: switches = 0_i8            !! of surface points between head and flux
    integer(i8) :: removed = 0_i8             !! particles that left the domain
    real(wp) :: movement = 0.0_wp             !! bound of the way since the last build [m]
  end type model_t
end module dosui_model

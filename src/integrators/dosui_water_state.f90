!! The part of a model that its water's flow is solved with; empty in dry scenes.
module dosui_water_state
  use dosui_kinds, only: wp, i8
  use dosui_barriers, only: barrier_face_t
  use dosui_head_operator, only: head_operator_t
  use dosui_hydraulic_conditions, only: hydraulic_conditions_t
  use dosui_index_map, only: index_map_t
  use dosui_retention, only: retention_t
  use dosui_storage, only: storage_t
  use dosui_surface_flux, only: surface_flux_t
  use dosui_two_pass_operator, only: two_pass_operator_t
  implicit none
  private

  type, public :: water_state_t
    !! What the solution of the water's continuity holds beside the particles: neighbourhoods,
    !! operators, conditions, heads.
    type(index_map_t) :: particle_map         !! ghost particles of the water's neighbourhoods
    type(index_map_t) :: surface_map          !! ghost surface points
    type(head_operator_t) :: head_operator
    type(two_pass_operator_t) :: two_pass
    type(hydraulic_conditions_t) :: hydraulic_conditions
    integer, allocatable :: condition_surface(:)   !! surface of each hydraulic condition
    type(surface_flux_t) :: surface_flux      !! measures the inflow
    type(barrier_face_t), allocatable :: barrier(:)   !! faces that no water passes
    type(storage_t) :: storage
    real(wp), allocatable :: head(:)          !! of owned and ghost particles [m]
    real(wp), allocatable :: elevation(:)     !! likewise [m]
    type(retention_t), allocatable :: retention(:)    !! of each material
    real(wp), allocatable :: relative(:)      !! k_r of owned and ghost particles, with suction [-]
    real(wp), allocatable :: point_relative(:)   !! k_r of surface points, likewise [-]
    real(wp) :: largest_row_sum = 0.0_wp      !! of all ranks' head operators [1/(m s)]
    real(wp) :: diffusion_limit = huge(1.0_wp)   !! explicit limit of the water's diffusion [s]
    integer :: substeps = 1                   !! of the water in a step of the skeleton
    integer :: stages = 0                     !! of super-time-stepping; 0: Euler sub-steps
    logical :: switching = .false.   !! surface points may change between head and flux
    logical :: inertia_drives = .false.               !! the water's inertia counts in Darcy's law
    real(wp), allocatable :: mobility(:, :)
    !! (2, n_node) then: k rho_w/gamma_w [s] and k/(gamma_w S h^2) [1/s]
    real(wp), allocatable :: inertia_strain(:)
    !! (particles) water that inertia brings in the step, over the volume [-]
    real(wp), allocatable :: inertia_flux(:)
    !! (surface points, ghosts too) against inertia's part of the outward flow [m/s]
    real(wp), allocatable :: volume_strain(:)         !! of the step, as the water sees it [-]
    integer(i8) :: switches = 0_i8            !! of surface points between head and flux
  end type water_state_t
end module dosui_water_state

!! The fields of particles and of surface points, registered by what the scene needs.
module dosui_particle_fields
  use dosui_dimension, only: ndim, nsig
  use dosui_point_set, only: point_set_t
  use dosui_surface_sets, only: set_width
  implicit none
  private

  public :: register_particle_fields, register_surface_fields

  type, public :: particle_handles_t
    !! Places of the particles' fields in their table; 0: not in this scene.
    integer :: position = 0           !! on the grid: of reference with finite strains, else now [m]
    integer :: current_position = 0   !! now [m]
    integer :: build_position = 0     !! that the grid was last built with [m]
    integer :: water_position = 0     !! that the water's neighbourhoods were last built with [m]
    integer :: velocity = 0           !! [m/s]
    integer :: displacement = 0       !! [m]
    integer :: effective_stress = 0   !! tension positive [Pa]
    integer :: volume = 0             !! [m3, per m in 2-D, per m2 in 1-D]
    integer :: mass = 0               !! [kg, likewise]
    integer :: porosity = 0           !! [-]
    integer :: material = 0           !! index into the scene's materials
    integer :: affine = 0             !! APIC velocity gradient [1/s]
    integer :: filter_time = 0        !! in which velocities off the grid's fade, AFLIP [s]
    integer :: pore_pressure = 0      !! compression positive [Pa]
    integer :: conductivity = 0       !! k [m/s]
    integer :: deformation = 0        !! F_ab = dx_a/dX_b at a + (b - 1) ndim, where needed [-]
    integer :: half_domain = 0        !! over h, when built, of GIMP domains that follow F [-]
    integer :: reference_volume = 0   !! before any deformation, finite strains [m3]
    integer :: inertia_rate = 0       !! water that its inertia brought in the last step [1/s]
    integer :: state = 0              !! state variables of the materials
    integer :: unmet_volume = 0       !! volume change that no pressure has answered yet [m3]
    integer :: start_pressure = 0     !! pore pressure before any load, adaptive steps only [Pa]
    integer :: region = 0             !! index into the scene's regions, if surfaces are found
    integer :: surface = 0            !! 1 on the free surface, if it is found, else 0 [-]
  end type particle_handles_t

  type, public :: surface_handles_t
    !! Places of the surface points' fields in their table.
    integer :: position = 0           !! as of particles, on the true surface [m]
    integer :: current_position = 0   !! likewise [m]
    integer :: build_position = 0     !! likewise [m]
    integer :: water_position = 0     !! likewise [m]
    integer :: normal = 0             !! outward unit normal [-]
    integer :: area = 0               !! of the piece [m2, m in 2-D, 1 in 1-D]
    integer :: surface = 0            !! set of the scene's surfaces (dosui_surface_sets), 0: none
    integer :: patch = 0              !! distinct for each region face and what acts on it
    integer :: outward_area = 0       !! area times normal as they are now, updated mode [m2]
    integer :: displacement = 0       !! [m]
    integer :: velocity = 0           !! [m/s]
    integer :: deformation = 0        !! F as for particles, finite strains [-]
    integer :: reference_area = 0     !! outward area before any deformation, finite strains [m2]
    integer :: has_head = 0           !! 1 where a point that may switch has a head now [-]
    integer :: material = 0           !! of the region, with suction or soils of unlike k [-]
    integer :: inertia_rate = 0       !! outward flow by the water's inertia in the last step [m/s]
    integer :: held = 0               !! normal that walls hold, of triangulated bodies [-]
    integer :: edge = 0               !! that span the piece, bodies at rest in 3-D; 0: unknown [m]
    integer :: free = 0               !! the free surface it is or may become part of, 0: none
  end type surface_handles_t

  type, public :: field_needs_t
    !! What a scene asks of its particles and surface points.
    logical :: coupled = .false.       !! water is computed
    logical :: affine = .false.        !! APIC transfer
    logical :: filtered = .false.      !! AFLIP transfer
    logical :: updated = .false.       !! particles move
    logical :: finite = .false.        !! finite strains
    logical :: adaptive = .false.      !! steps are chosen by their error
    logical :: projected = .false.     !! pressures by projection, then rigid walls
    logical :: switching = .false.     !! surface points may change between head and flux
    logical :: unsaturated = .false.   !! suction empties pores
    logical :: layered = .false.       !! soils of several conductivities
    logical :: finds_surface = .false. !! free surfaces are found as bodies move
    integer :: n_state = 0             !! state variables of the materials
    integer :: n_surface = 0           !! surfaces that the scene names
    logical :: inertia = .false.       !! of the water, in Darcy's law
    logical :: following = .false.     !! particles' domains follow their deformation
    logical :: triangulated = .false.  !! facets stand for smooth surfaces
  end type field_needs_t

contains

  subroutine register_particle_fields(set, handles, needs)
    !! Registers what a scene needs; dry scenes hold no water.
    type(point_set_t), intent(inout) :: set
    type(particle_handles_t), intent(out) :: handles
    type(field_needs_t), intent(in) :: needs
    logical, parameter :: yes = .true., no = .false.

    ! name, unit, width, migrates, halo, output, checkpoint
    handles%position = set%add('position', 'm', ndim, yes, yes, no, yes)
    handles%velocity = set%add('velocity', 'm/s', ndim, yes, no, yes, yes)
    handles%displacement = set%add('displacement', 'm', ndim, yes, no, yes, yes)
    handles%effective_stress = set%add('effective_stress', 'Pa', nsig, yes, no, yes, yes)
    handles%volume = set%add('volume', 'm3', 1, yes, no, yes, yes)
    handles%mass = set%add('mass', 'kg', 1, yes, no, no, yes)
    handles%porosity = set%add('porosity', '-', 1, yes, no, yes, yes)
    handles%material = set%add('material', '-', 1, yes, no, yes, yes)
    if (needs%n_state > 0) then
      handles%state = set%add('state', '', needs%n_state, yes, no, no, yes)
    end if
    if (needs%affine) handles%affine = set%add('affine', '1/s', ndim*ndim, yes, no, no, yes)
    if (needs%filtered) handles%filter_time = set%add('filter_time', 's', 1, yes, no, no, yes)
    call add_positions(set, needs, handles%position, handles%current_position, &
                       handles%build_position, handles%water_position)
    if (needs%following) handles%half_domain = &
      set%add('half_domain', '-', ndim, yes, no, no, yes)
    if (needs%finite .or. needs%following) handles%deformation = &
      set%add('deformation', '-', ndim*ndim, yes, no, no, yes)
    if (needs%finite) then
      handles%reference_volume = set%add('reference_volume', 'm3', 1, yes, no, no, yes)
    end if
    if (needs%finds_surface) then
      handles%region = set%add('region', '-', 1, yes, no, no, yes)
      handles%surface = set%add('surface', '-', 1, yes, no, yes, yes)
    end if
    if (.not. needs%coupled) return
    handles%pore_pressure = set%add('pore_pressure', 'Pa', 1, yes, no, yes, yes)
    handles%conductivity = set%add('conductivity', 'm/s', 1, yes, yes, no, yes)
    if (needs%projected) handles%unmet_volume = set%add('unmet_volume', 'm3', 1, yes, no, no, yes)
    if (needs%inertia) handles%inertia_rate = set%add('inertia_rate', '1/s', 1, yes, no, no, yes)
    if (needs%adaptive) handles%start_pressure = &
      set%add('start_pressure', 'Pa', 1, yes, no, no, yes)
  end subroutine register_particle_fields

  subroutine register_surface_fields(set, handles, needs)
    !! Registers the fields of surface points.
    type(point_set_t), intent(inout) :: set
    type(surface_handles_t), intent(out) :: handles
    type(field_needs_t), intent(in) :: needs
    logical, parameter :: yes = .true., no = .false.

    handles%position = set%add('position', 'm', ndim, yes, yes, no, yes)
    handles%normal = set%add('normal', '-', ndim, yes, yes, no, yes)
    handles%area = set%add('area', 'm2', 1, yes, yes, no, yes)
    handles%surface = set%add('surfaces', '-', set_width(needs%n_surface), yes, yes, no, yes)
    handles%patch = set%add('patch', '-', 1, yes, yes, no, yes)
    handles%displacement = set%add('displacement', 'm', ndim, yes, no, no, yes)
    handles%velocity = set%add('velocity', 'm/s', ndim, yes, no, no, yes)
    call add_positions(set, needs, handles%position, handles%current_position, &
                       handles%build_position, handles%water_position)
    if (needs%updated) handles%outward_area = set%add('outward_area', 'm2', ndim, yes, no, no, yes)
    if (needs%switching) handles%has_head = set%add('has_head', '-', 1, yes, yes, no, yes)
    if (needs%unsaturated .or. needs%layered) handles%material = &
      set%add('material', '-', 1, yes, yes, no, yes)
    if (needs%inertia) handles%inertia_rate = set%add('inertia_rate', 'm/s', 1, yes, no, no, yes)
    if (needs%triangulated) handles%held = set%add('held', '-', ndim, yes, no, no, yes)
    if (ndim == 3 .and. .not. needs%updated) then
      handles%edge = set%add('edge', 'm', ndim*(ndim - 1), yes, no, no, yes)
    end if
    if (needs%finds_surface) handles%free = set%add('free', '-', 1, yes, no, no, yes)
    if (.not. needs%finite) return
    handles%deformation = set%add('deformation', '-', ndim*ndim, yes, no, no, yes)
    handles%reference_area = set%add('reference_area', 'm2', ndim, yes, no, no, yes)
  end subroutine register_surface_fields

  subroutine add_positions(set, needs, position, current, build, water)
    !! Handles of a point's other positions: fields of their own where bodies deform.
    type(point_set_t), intent(inout) :: set
    type(field_needs_t), intent(in) :: needs
    integer, intent(in) :: position
    integer, intent(out) :: current, build, water
    logical, parameter :: yes = .true., no = .false.

    current = position
    build = position
    if (needs%finite) current = set%add('current_position', 'm', ndim, yes, yes, no, yes)
    if (needs%updated) build = set%add('build_position', 'm', ndim, yes, yes, no, yes)
    water = merge(build, current, needs%updated)
  end subroutine add_positions
end module dosui_particle_fields

!! What a scene asks for: plain types with defaults, filled by `dosui_scene_reader` or by hand.
!!
!! Vectors hold the components of the scene's dimension: (z) in 1-D, (x, z) in 2-D, (x, y, z) in
!! 3-D.
module dosui_scene
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim, nsig, axis
  use dosui_integrator_traits, only: automatic, integrator_choice_t
  use dosui_key_visitor, only: name_length
  use dosui_material_model, only: material_model_t
  use dosui_materials, only: create_model, material_set_t, soil_catalogue_t
  use dosui_problems, only: problems_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_table, only: named_table_t
  use dosui_triangles, only: triangles_t
  use dosui_wall, only: wall_of, wall_t
  implicit none
  private

  public :: name_length

  character(len=1), parameter, public :: axis_name(3) = ['x', 'y', 'z']   !! in formulas

  ! of properties that may vary with place
  character(len=*), parameter, public :: density_range = '> 0'               !! [kg/m3]
  character(len=*), parameter, public :: porosity_range = '> 0 and < 1'      !! [-]
  character(len=*), parameter, public :: conductivity_range = '>= 0'         !! [m/s]

  type, public :: hole_t
    !! A polygon that is cut out of a region (2-D).
    character(len=name_length) :: region = ''
    real(wp), allocatable :: vertices(:, :)   !! (ndim, n) corners, clockwise once checked [m]
  end type hole_t

  type, public :: region_t
    !! A shape filled with particles of one material on a regular lattice.
    character(len=name_length) :: name = ''
    character(len=name_length) :: material = ''
    character(len=name_length) :: shape = 'box'
    !! or 'polygon', 'circle' (2-D), 'sphere', 'stl' (3-D)
    real(wp) :: box_min(ndim) = 0.0_wp               !! lower corner before turning [m]
    real(wp) :: box_max(ndim) = 0.0_wp               !! upper corner before turning [m]
    real(wp), allocatable :: vertices(:, :)   !! (ndim, n) polygon corners, counter-clockwise [m]
    real(wp) :: centre(ndim) = 0.0_wp                !! of a circle or sphere before turning [m]
    real(wp) :: radius = 0.0_wp                      !! of it [m]
    real(wp) :: cut_min(ndim) = -huge(1.0_wp)        !! a circle or sphere keeps what is above [m]
    real(wp) :: cut_max(ndim) = huge(1.0_wp)         !! and below [m]
    character(len=:), allocatable :: stl_file        !! of a triangulated surface
    real(wp) :: stl_scale = 1.0_wp                   !! unit of that file [m]
    real(wp) :: stl_face_angle = 30.0_wp             !! between faces, at least [deg]
    type(triangles_t), allocatable :: body           !! of the file, turned by shape_angle
    character(len=name_length), allocatable :: solid(:)   !! names of the file's solids
    real(wp) :: particle_spacing = 0.0_wp
    !! lattice spacing [m]; 0: grid spacing / particles_per_cell
    integer :: particles_per_cell = 2                !! per direction
    real(wp) :: jitter = 0.0_wp                      !! random shift, fraction of the spacing [-]
    integer :: jitter_seed = 1
    real(wp) :: shape_angle = 0.0_wp   !! turn of the shape about pivot, x towards z [deg]
    real(wp) :: lattice_angle = 0.0_wp   !! turn of the particle lattice, x towards z [deg]
    real(wp) :: pivot(ndim) = 0.0_wp                 !! centre of both turns [m]
    real(wp) :: velocity(ndim) = 0.0_wp              !! initial velocity [m/s]
    type(hole_t), allocatable :: hole(:)             !! that are cut out of it
    character(len=:), allocatable :: particle_file   !! not allocated: a lattice
    real(wp), allocatable :: particle(:, :)          !! (ndim, n) of the file [m]
    real(wp), allocatable :: particle_volume(:)      !! (n) if the file holds them [m3]
    real(wp) :: spin = 0.0_wp   !! initial angular velocity about pivot, x towards z [rad/s]
  end type region_t

  type, public :: material_t
    !! A soil: what every one has, and a constitutive model with its own constants. Values that are
    !! formulas of place hold the largest (and the least) of their regions.
    character(len=name_length) :: name = ''
    character(len=name_length) :: model = 'linear_elastic'
    class(material_model_t), allocatable :: soil     !! with its constants; see `choose_soil`
    type(scalar_function_t) :: solid_density = scalar_function_t(2650.0_wp)   !! grains [kg/m3]
    type(scalar_function_t) :: porosity = scalar_function_t(0.3_wp)   !! initial [-]
    type(scalar_function_t) :: hydraulic_conductivity                 !! k [m/s]
    character(len=name_length) :: conductivity_law = 'constant'   !! or 'kozeny_carman'
    logical :: rigid = .false.                       !! skeleton does not move: pure seepage
    character(len=name_length) :: retention = 'none'   !! 'none' (saturated) or 'van_genuchten'
    real(wp) :: retention_alpha = 0.0_wp             !! inverse of a suction head [1/m]
    real(wp) :: retention_exponent = 2.0_wp          !! n of van Genuchten [-]
    real(wp) :: residual_saturation = 0.0_wp         !! of the driest soil [-]
    real(wp) :: least_conductivity = 1.0e-6_wp       !! over that of the saturated soil [-]
  contains
    procedure :: choose_soil => material_choose_soil
    procedure :: set => material_set
    procedure :: varies => material_varies
    procedure :: calls => material_calls
    procedure :: follows_finite_strains => material_follows_finite_strains
    procedure :: value => material_value
  end type material_t

  type, public :: water_t
    real(wp) :: density = 1000.0_wp                  !! [kg/m3]
    real(wp) :: bulk_modulus = 2.2e9_wp              !! K_w [Pa]
    real(wp) :: unit_weight = 9810.0_wp              !! gamma_w that k and heads refer to [N/m3]
    character(len=name_length) :: operator = 'compact'   !! 'compact' or 'two_pass'
    logical :: fluid_inertia = .false.               !! rho_w times acceleration in Darcy's law
    real(wp) :: support_radius = 2.4_wp              !! neighbourhood, in particle spacings [-]
    real(wp) :: rebuild_displacement = 0.1_wp
    !! rebuild when a particle moved this, in spacings [-]
    real(wp) :: cell_storage = 1.0_wp                !! tau_i: projection storage inside a cell [-]
    real(wp) :: block_storage = 0.25_wp   !! tau_m: projection storage inside 2x2(x2) cells [-]
    character(len=name_length) :: stepping = 'auto'  !! 'single', 'subcycle', 'rkl2' or 'auto'
  end type water_t

  type, public :: mechanics_t
    character(len=name_length) :: transfer = 'auto'
    !! 'flip', 'apic', 'pic', 'blend', 'aflip' or 'auto': see `transfer_in_force`
    real(wp) :: flip_fraction = 0.99_wp              !! for 'blend': rest is PIC [-]
    real(wp) :: filter_time = 0.0_wp   !! for 'aflip'; 0: from materials and grid [s]
    logical :: average_volume_change = .true.
    !! cell average of volume change (B-bar) for skeleton and water
    character(len=name_length) :: coupling_gradient = 'auto'
    !! 'particle', 'cell_centre' or 'auto'
    character(len=name_length) :: damping = 'none'   !! 'none', 'viscous', 'local' or 'fading'
    real(wp) :: damping_coefficient = -1.0_wp
    !! viscous [1/s], local [-]; negative: chosen from the scene
    real(wp) :: density_scaling = 1.0_wp             !! factor on inertia only [-]
    real(wp) :: penalty = 1.0_wp   !! wall stiffness in units of modulus / spacing [-]
  end type mechanics_t

  type, public :: initial_state_t
    character(len=name_length) :: region = ''        !! empty: every region
    character(len=name_length) :: pore_pressure = 'zero'
    !! 'zero', 'hydrostatic', 'given' or 'checkerboard'
    real(wp) :: water_level = 0.0_wp   !! elevation of zero pressure for 'hydrostatic' [m]
    real(wp) :: pore_pressure_value = 0.0_wp   !! for 'given', amplitude for 'checkerboard' [Pa]
    character(len=name_length) :: effective_stress = 'zero'   !! 'zero', 'geostatic' or 'given'
    real(wp) :: surface_level = 0.0_wp   !! elevation of zero effective stress for 'geostatic' [m]
    real(wp) :: lateral_ratio = 0.5_wp               !! K_0 for 'geostatic' [-]
    real(wp) :: effective_stress_value(6) = 0.0_wp
    !! xx yy zz xy yz zx for 'given', tension positive [Pa]
    real(wp) :: mode_amplitude = 0.0_wp
    !! initial velocity v = a sin(pi (2 m - 1) z / (2 H)) [m/s]
    integer :: mode_number = 0                       !! m of the line above; 0: none
  end type initial_state_t

  type, public :: surface_t
    !! Part of the boundary of a region, selected by face and optionally cut by a box.
    character(len=name_length) :: name = ''
    character(len=name_length) :: region = ''
    character(len=name_length) :: face = ''
    !! 'x-', 'x+', 'y-', 'y+', 'z-', 'z+', 'all', 'edge1'... or 'free'
    real(wp) :: box_min(ndim) = -huge(1.0_wp)        !! keep only points above [m]
    real(wp) :: box_max(ndim) = huge(1.0_wp)         !! keep only points below [m]
  end type surface_t

  type, public :: barrier_t
    !! An interior surface that water does not pass.
    character(len=name_length) :: name = ''
    real(wp), allocatable :: vertices(:, :)
    !! (ndim, n) chain of points in 2-D, corners of a flat convex polygon in 3-D [m]
  end type barrier_t

  type, public :: rigid_wall_t
    !! A half-space that bodies do not enter.
    character(len=name_length) :: name = ''
    real(wp) :: position(ndim) = 0.0_wp              !! a point of its plane [m]
    real(wp) :: normal(ndim) = 0.0_wp                !! from the wall to the bodies, any length [-]
    character(len=name_length) :: kind = 'frictional'   !! or 'rough'
    real(wp) :: friction = 0.0_wp                    !! coefficient [-]
  contains
    procedure :: is_rough => rigid_wall_is_rough
  end type rigid_wall_t

  type, public :: mechanical_condition_t
    character(len=name_length) :: surface = ''
    character(len=name_length) :: kind = ''
    !! 'roller', 'fixed', 'velocity', 'normal_velocity', 'traction', 'pressure', 'reservoir',
    !! 'absorbing' or 'plate'
    character(len=name_length) :: imposition = 'auto'   !! 'nodes', 'penalty' or 'auto'
    real(wp) :: value(ndim) = 0.0_wp
    !! velocity [m/s]; traction [Pa]; pressure: first component, positive into the body [Pa];
    !! reservoir: first component, level of its water [m];
    !! plate: first component, total force into the body [N, per m thickness in 2-D, per m2 in 1-D]
    type(scalar_function_t) :: pattern = scalar_function_t(1.0_wp)   !! multiplies value
    real(wp) :: water_weight = 0.0_wp                !! of a reservoir's water [N/m3]
    real(wp) :: datum = 0.0_wp                       !! where levels of reservoirs count from [m]
    real(wp) :: impedance(2) = 0.0_wp
    !! of an absorbing surface to compression and shear waves [Pa s/m]
  contains
    procedure :: wall => mechanical_condition_wall
    procedure :: is_load => mechanical_condition_is_load
    procedure :: moves_wall => mechanical_condition_moves_wall
    procedure :: pressure_at => mechanical_condition_pressure_at
  end type mechanical_condition_t

  type, public :: base_motion_t
    !! Acceleration of the frame that the scene is computed in: its walls and its base.
    logical :: is_given = .false.
    real(wp) :: acceleration(ndim) = 0.0_wp          !! [m/s2]
    type(scalar_function_t) :: pattern = scalar_function_t(1.0_wp)   !! multiplies it
    character(len=:), allocatable :: file            !! times and factors; unallocated: none
  end type base_motion_t

  type, public :: hydraulic_condition_t
    character(len=name_length) :: surface = ''
    character(len=name_length) :: kind = ''
    !! 'head', 'pressure', 'flux', 'no_flow', 'reservoir', 'seepage_face' or 'rainfall'
    real(wp) :: value = 0.0_wp
    !! head [m]; pressure [Pa]; outward Darcy flux [m/s]; level of a reservoir [m]; rain on a
    !! level plane [m/s]
    type(scalar_function_t) :: pattern = scalar_function_t(1.0_wp)   !! multiplies value
    real(wp) :: datum = 0.0_wp                       !! where heads and levels count from [m]
  contains
    procedure :: may_switch => hydraulic_condition_may_switch
    procedure :: value_at => hydraulic_condition_value_at
    procedure :: uniform_value_at => hydraulic_condition_uniform_value_at
  end type hydraulic_condition_t

  type, public :: source_t
    type(scalar_function_t) :: force(3)   !! body force along x, y, z beside gravity [N/m3]
    type(scalar_function_t) :: water      !! water supplied per volume of soil [1/s]
  end type source_t

  type, public :: probe_t
    character(len=name_length) :: name = ''
    character(len=name_length) :: kind = ''
    !! 'point', 'surface_mean', 'settlement', 'domain_sum' or 'run_out'
    character(len=name_length) :: field = ''   !! a field of the result file, e.g. 'pore_pressure'
    integer :: component = 1   !! of a vector or stress field, as in the result file
    character(len=name_length) :: surface = ''       !! for 'surface_mean' and 'settlement'
    real(wp) :: position(ndim) = 0.0_wp              !! for 'point' and 'run_out' [m]
    real(wp) :: direction(ndim) = 0.0_wp   !! of a run-out; 0: any horizontal one [-]
    real(wp) :: fraction = 0.95_wp         !! of the mass within a run-out [-]
  end type probe_t

  type, public :: time_t
    real(wp) :: end_time = 0.0_wp                    !! [s]
    real(wp) :: output_interval = 0.0_wp             !! [s]; 0: only output_times and the end
    real(wp), allocatable :: output_times(:)         !! [s]
    real(wp) :: courant = 0.5_wp                     !! fraction of the stability limit [-]
    real(wp) :: time_step = 0.0_wp                   !! fixed dt [s]; 0: chosen from the limits
    real(wp) :: largest_step = huge(1.0_wp)          !! [s]
    integer(i8) :: maximum_steps = huge(1_i8)
    real(wp) :: relative_tolerance = 1.0e-4_wp       !! of a quasi-static step's pressures [-]
    logical :: geostatic_start = .false.   !! settle at the given pressures before t = 0
    logical :: undrained_start = .false.   !! settle undrained under the first loads before t = 0
  end type time_t

  type, public :: solver_t
    !! Linear solutions of implicit integrators.
    character(len=name_length) :: linear = 'auto'    !! 'direct', 'iterative' or 'auto'
    real(wp) :: tolerance = 1.0e-6_wp                !! residual over right-hand side [-]
  end type solver_t

  type, public :: output_t
    character(len=:), allocatable :: name
    !! stem of the files; default: name of the scene's folder or file
    character(len=:), allocatable :: directory       !! default: working directory
    real(wp) :: history_interval = 0.0_wp            !! [s]; 0: every step, explicit 1000 in all
    integer(i8) :: checkpoint_steps = 0_i8           !! 0: off
    real(wp) :: checkpoint_minutes = 0.0_wp          !! 0: off [min]
    logical :: checkpoint_at_outputs = .false.       !! one each, all of them kept
    real(wp) :: progress_seconds = 5.0_wp            !! wall time between progress lines [s]
  end type output_t

  type, public :: verification_t
    !! Exact solution that the postprocessing compares with, and what it needs beside the scene.
    character(len=name_length) :: case = ''
    !! '', 'terzaghi', 'mandel', 'cryer', 'de_leeuw', 'hydrostatic', 'bar' or 'drainage'
    real(wp) :: load = 0.0_wp                        !! q [Pa] or F [N/m]
    real(wp) :: length = 0.0_wp                      !! drainage length H or half width a [m]
    real(wp) :: drained(ndim) = 0.0_wp               !! a point of the drained surface [m]
    real(wp) :: direction(ndim) = 0.0_wp
    !! from the drained surface into the body, unit vector [-]
  end type verification_t

  type, public :: scene_t
    character(len=:), allocatable :: file            !! path of the namelist
    character(len=:), allocatable :: text            !! its text as read
    character(len=:), allocatable :: echo            !! every key with the value in force
    character(len=:), allocatable :: title
    character(len=name_length) :: water_mode = 'coupled'       !! 'none' or 'coupled'
    character(len=name_length) :: integrator = automatic
    !! 'explicit', 'semi_implicit' or 'quasi_static'; 'auto' until `resolve_integrator`
    type(integrator_choice_t) :: choice              !! why that integrator
    character(len=name_length) :: deformation = 'small_strain'
    !! 'small_strain', 'finite' or 'updated'
    character(len=name_length) :: leaving_particles = 'stop'     !! 'stop' or 'remove'
    real(wp) :: gravity(ndim) = 0.0_wp               !! [m/s2]
    real(wp) :: grid_spacing = 0.0_wp                !! [m]
    real(wp) :: grid_origin(ndim) = 0.0_wp           !! a node of the grid [m]
    real(wp) :: grid_period(ndim) = 0.0_wp           !! the grid repeats after it; 0: never [m]
    character(len=name_length) :: shape_function = 'auto'
    !! 'linear', 'gimp', 'cpgimp', 'bspline' or 'auto': see `shape_function_in_force`
    real(wp) :: domain_min(ndim) = -huge(1.0_wp)     !! particles outside have left [m]
    real(wp) :: domain_max(ndim) = huge(1.0_wp)      !! likewise [m]
    real(wp) :: local_origin(ndim) = 0.0_wp
    !! what coordinates of scene and model count from: 0 unless the bodies are far away; places in
    !! files, formulas and messages add it [m]
    type(time_t) :: time
    type(mechanics_t) :: mechanics
    type(water_t) :: water
    type(solver_t) :: solver
    type(source_t) :: source
    type(base_motion_t) :: base_motion
    type(output_t) :: output
    type(verification_t) :: verification
    type(region_t), allocatable :: region(:)
    type(named_table_t), allocatable :: table(:)     !! functions for formulas
    type(material_t), allocatable :: material(:)
    type(soil_catalogue_t) :: catalogue              !! of the models that materials may have
    type(initial_state_t), allocatable :: initial_state(:)
    type(surface_t), allocatable :: surface(:)
    type(mechanical_condition_t), allocatable :: mechanical_condition(:)
    type(hydraulic_condition_t), allocatable :: hydraulic_condition(:)
    type(hole_t), allocatable :: hole(:)             !! regions have copies of their own
    type(barrier_t), allocatable :: barrier(:)
    type(rigid_wall_t), allocatable :: rigid_wall(:)
    type(probe_t), allocatable :: probe(:)
    type(problems_t) :: warnings                     !! what is allowed, but hardly meant
  contains
    procedure :: head_at_origin => scene_head_at_origin
    procedure :: shape_function_in_force => scene_shape_function_in_force
    procedure :: transfer_in_force => scene_transfer_in_force
    procedure :: mixture_density => scene_mixture_density
    procedure :: water_modulus => scene_water_modulus
    procedure :: prepare_materials => scene_prepare_materials
    procedure :: prepare_functions => scene_prepare_functions
  end type scene_t

contains

  pure function scene_shape_function_in_force(self) result(name)
    !! The shape function, 'auto' resolved: particles that cross cells need a smooth one.
    class(scene_t), intent(in) :: self
    character(len=name_length) :: name   !! 'linear', 'gimp', 'cpgimp' or 'bspline'

    name = self%shape_function
    if (name == 'auto') name = merge('gimp  ', 'linear', self%deformation == 'updated')
  end function scene_shape_function_in_force

  pure function scene_transfer_in_force(self) result(name)
    !! The transfer, 'auto' resolved: bodies that move through the grid need one whose losses do not
    !! grow with the number of steps.
    class(scene_t), intent(in) :: self
    character(len=name_length) :: name   !! 'flip', 'apic', 'pic', 'blend' or 'aflip'

    name = self%mechanics%transfer
    if (name == 'auto') name = merge('aflip', 'apic ', self%deformation == 'updated')
  end function scene_transfer_in_force

  pure real(wp) function scene_head_at_origin(self) result(head)
    !! Head of water without pressure at the local origin: what heads of the model lack [m].
    class(scene_t), intent(in) :: self

    head = -self%water%density*dot_product(self%gravity, self%local_origin)/self%water%unit_weight
  end function scene_head_at_origin

  pure real(wp) function scene_mixture_density(self, material, position) result(density)
    !! Grains and the water in all voids, per volume [kg/m3].
    class(scene_t), intent(in) :: self
    integer, intent(in) :: material   !! index
    real(wp), intent(in), optional :: position(ndim)
    !! for materials that vary; without it the largest constants count [m]
    real(wp) :: grains, porosity

    associate (soil => self%material(material))
      grains = soil%solid_density%constant
      porosity = soil%porosity%constant
      if (present(position)) then
        grains = soil%solid_density%at(position + self%local_origin)
        porosity = soil%porosity%at(position + self%local_origin)
      end if
      density = (1.0_wp - porosity)*grains
      if (self%water_mode /= 'none') density = density + porosity*self%water%density
    end associate
  end function scene_mixture_density

  pure real(wp) function scene_water_modulus(self, material) result(modulus)
    !! K_w/n of the least porosity: what undrained water adds to a soil's moduli; 0 in dry scenes
    !! [Pa].
    class(scene_t), intent(in) :: self
    integer, intent(in) :: material   !! index

    modulus = 0.0_wp
    if (self%water_mode == 'none') return
    modulus = self%water%bulk_modulus/self%material(material)%porosity%smallest()
  end function scene_water_modulus

  subroutine scene_prepare_functions(self)
    !! Reads the formulas of conditions, base motion and sources, which have been checked.
    class(scene_t), intent(inout) :: self
    character(len=:), allocatable :: message   ! none
    integer :: k

    do k = 1, size(self%mechanical_condition)
      call prepare(self%mechanical_condition(k)%pattern)
    end do
    do k = 1, size(self%hydraulic_condition)
      call prepare(self%hydraulic_condition(k)%pattern)
    end do
    call prepare(self%base_motion%pattern)
    do k = 1, size(self%source%force)
      call prepare(self%source%force(k))
    end do
    call prepare(self%source%water)

  contains

    subroutine prepare(function)
      type(scalar_function_t), intent(inout) :: function

      call function%prepare([axis_name(axis), 't'], message, self%table)
    end subroutine prepare
  end subroutine scene_prepare_functions

  subroutine scene_prepare_materials(self, materials, uniform)
    !! The soils' models, ready to return stresses.
    class(scene_t), intent(in) :: self
    type(material_set_t), intent(out) :: materials
    logical, intent(in), optional :: uniform   !! constants do not vary: the largest count
    type(material_t) :: material
    logical :: is_uniform
    integer :: k

    is_uniform = .false.
    if (present(uniform)) is_uniform = uniform

    allocate (materials%item(size(self%material)))
    do k = 1, size(self%material)
      material = self%material(k)
      call material%choose_soil()
      material%soil%porosity = material%porosity%constant
      material%soil%band_width = self%grid_spacing
      call material%soil%prepare()
      if (.not. is_uniform) call material%soil%vary()
      call move_alloc(material%soil, materials%item(k)%model)
    end do
  end subroutine scene_prepare_materials

  subroutine material_choose_soil(self)
    !! Makes the soil that `model` names, with default constants, unless it is there already.
    class(material_t), intent(inout) :: self

    if (.not. allocated(self%soil)) call create_model(self%model, self%soil)
  end subroutine material_choose_soil

  subroutine material_set(self, key, value)
    !! Sets a constant of the soil by its key; nothing if the model has none of that name.
    class(material_t), intent(inout) :: self
    character(len=*), intent(in) :: key
    real(wp), intent(in) :: value   !! [unit of the key]
    integer :: k

    call self%choose_soil()
    k = self%soil%index_of(key)
    if (k > 0) call self%soil%constant(k)%set(value)
  end subroutine material_set

  pure logical function material_calls(self, table) result(calls)
    !! Does any formula of its properties call a table?
    class(material_t), intent(in) :: self
    character(len=*), intent(in) :: table   !! name
    integer :: k

    calls = self%solid_density%uses(table) .or. self%porosity%uses(table) .or. &
            self%hydraulic_conductivity%uses(table)
    if (.not. allocated(self%soil)) return
    do k = 1, size(self%soil%constant)
      calls = calls .or. self%soil%constant(k)%uses(table)
    end do
  end function material_calls

  pure elemental logical function material_varies(self) result(varies)
    !! Is any property a formula of place?
    class(material_t), intent(in) :: self

    varies = self%solid_density%varies() .or. self%porosity%varies() .or. &
             self%hydraulic_conductivity%varies()
    if (allocated(self%soil)) varies = varies .or. any(self%soil%constant%varies())
  end function material_varies

  pure elemental logical function material_follows_finite_strains(self) result(follows)
    !! Do the soil's state variables follow the deformation gradient of finite strains?
    class(material_t), intent(in) :: self

    follows = .true.
    if (allocated(self%soil)) follows = self%soil%follows_finite_strains()
  end function material_follows_finite_strains

  pure real(wp) function material_value(self, key) result(value)
    !! A constant of the soil by its key, 0 if the model has none of that name [unit of the key].
    class(material_t), intent(in) :: self
    character(len=*), intent(in) :: key
    integer :: k

    value = 0.0_wp
    if (.not. allocated(self%soil)) return
    k = self%soil%index_of(key)
    if (k > 0) value = self%soil%constant(k)%constant
  end function material_value

  pure elemental logical function rigid_wall_is_rough(self) result(is_rough)
    !! Does what touches the wall stick to it?
    class(rigid_wall_t), intent(in) :: self

    is_rough = self%kind == 'rough'
  end function rigid_wall_is_rough

  pure elemental type(wall_t) function mechanical_condition_wall(self) result(wall)
    !! The wall that it is; of a load one that holds nothing.
    class(mechanical_condition_t), intent(in) :: self

    wall = wall_of(self%kind, self%value, self%pattern%factor)
  end function mechanical_condition_wall

  pure elemental logical function mechanical_condition_is_load(self) result(is_load)
    !! Is it a given load, and not a wall or plate?
    class(mechanical_condition_t), intent(in) :: self

    type(wall_t) :: wall

    wall = wall_of(self%kind)
    is_load = .not. wall%holds
  end function mechanical_condition_is_load

  pure elemental logical function mechanical_condition_moves_wall(self) result(moves)
    !! Is it a plate or a wall that moves, and no load and no wall at rest?
    class(mechanical_condition_t), intent(in) :: self

    type(wall_t) :: wall

    wall = wall_of(self%kind)
    moves = wall%is_plate() .or. wall%is_guided()
  end function mechanical_condition_moves_wall

  pure real(wp) function mechanical_condition_pressure_at(self, time, position) result(pressure)
    !! Pressure into the body of 'pressure' and 'reservoir' conditions [Pa].
    class(mechanical_condition_t), intent(in) :: self
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(in) :: position(ndim)   !! [m]

    pressure = self%value(1)*self%pattern%at(position, time)
    if (self%kind == 'reservoir') then
      pressure = self%water_weight*max(0.0_wp, (pressure - self%datum) - position(ndim))
    end if
  end function mechanical_condition_pressure_at

  pure elemental logical function hydraulic_condition_may_switch(self) result(switches)
    !! May its points change between a prescribed head and a prescribed flux?
    class(hydraulic_condition_t), intent(in) :: self

    switches = self%kind == 'reservoir' .or. self%kind == 'seepage_face' .or. &
               self%kind == 'rainfall'
  end function hydraulic_condition_may_switch

  pure real(wp) function hydraulic_condition_value_at(self, time, position) result(value)
    !! What it prescribes at a time and a place; heads and levels as the model counts them
    !! [m, Pa or m/s, by its kind].
    class(hydraulic_condition_t), intent(in) :: self
    real(wp), intent(in) :: time             !! [s]
    real(wp), intent(in) :: position(ndim)   !! [m]

    value = self%value*self%pattern%at(position, time) - self%datum
  end function hydraulic_condition_value_at

  pure real(wp) function hydraulic_condition_uniform_value_at(self, time) result(value)
    !! Likewise where no formula varies it in space [m, Pa or m/s, by its kind].
    class(hydraulic_condition_t), intent(in) :: self
    real(wp), intent(in) :: time   !! [s]

    value = self%value*self%pattern%factor%at(time) - self%datum
  end function hydraulic_condition_uniform_value_at
end module dosui_scene

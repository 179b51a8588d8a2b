!! Small strains: motions run through the kernels of an explicit step, so that forces, stresses and
!! volume changes are theirs.
module dosui_small_strain
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_formulation, only: formulation_t, missing_in_place, stage_data_t
  use dosui_hourglass, only: add_hourglass_forces
  use dosui_implicit_system, only: implicit_system_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: mean_saturation
  use dosui_skeleton_step, only: gather_forces, update_particles, zero_velocities
  implicit none
  private

  type, extends(formulation_t), public :: small_strain_t
    !! What a motion of the nodes starts from.
    real(wp), allocatable :: displacement(:, :)           !! of the particles [m]
    real(wp), allocatable :: stress(:, :)                 !! effective [Pa]
    real(wp), allocatable :: state(:, :)                  !! of the materials [units of the states]
    real(wp), allocatable :: surface_displacement(:, :)   !! of the surface points [m]
    real(wp), allocatable :: volume(:, :)     !! of the particles, where these follow strains [m3]
    real(wp), allocatable :: porosity(:, :)   !! likewise [-]
  contains
    procedure :: linearise => small_linearise
    procedure :: take_start => small_take_start
    procedure :: move_to => small_move_to
    procedure :: find_forces => small_find_forces
    procedure :: find_missing_water => small_find_missing_water
    procedure :: start_stress => small_start_stress
  end type small_strain_t

contains

  subroutine small_linearise(self, model, err)
    !! Soils that yield give their tangents with a motion that is none. Collective.
    class(small_strain_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :)

    self%is_linear = .not. model%nonlinear
    if (.not. allocated(model%skeleton%tangent)) return
    allocate (motion(ndim, model%grid%n_node), source=0.0_wp)
    call self%take_start(model)
    model%clock%dt = 1.0_wp
    call self%move_to(model, motion, err)
  end subroutine small_linearise

  subroutine small_take_start(self, model)
    !! Keeps the present state.
    class(small_strain_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      self%displacement = field(h%displacement)%values(:, 1:n)
      self%stress = field(h%effective_stress)%values(:, 1:n)
      if (h%state > 0) self%state = field(h%state)%values(:, 1:n)
      if (model%updated) then
        self%volume = field(h%volume)%values(:, 1:n)
        self%porosity = field(h%porosity)%values(:, 1:n)
      end if
    end associate
    associate (m => model%surface%count)
      self%surface_displacement = model%surface%field(model%s%displacement)%values(:, 1:m)
    end associate
  end subroutine small_take_start

  subroutine small_move_to(self, model, motion, err)
    !! Puts the model where a motion of the nodes since the start brings it. Collective.
    class(small_strain_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    type(error_t), intent(inout) :: err

    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      field(h%displacement)%values(:, 1:n) = self%displacement
      field(h%effective_stress)%values(:, 1:n) = self%stress
      if (h%state > 0) field(h%state)%values(:, 1:n) = self%state
      if (model%updated) then   ! starts of scenes whose particles move: trials do not add up
        field(h%volume)%values(:, 1:n) = self%volume
        field(h%porosity)%values(:, 1:n) = self%porosity
      end if
    end associate
    associate (m => model%surface%count)
      model%surface%field(model%s%displacement)%values(:, 1:m) = self%surface_displacement
    end associate
    call zero_velocities(model)
    model%skeleton%velocity_old = 0.0_wp
    model%skeleton%velocity = motion/model%clock%dt
    call update_particles(model, err)
    call model%comm%agree(err)
  end subroutine small_move_to

  subroutine small_find_forces(self, system, model, force, motion)
    !! Forces of an explicit step, and of the resistance that implicit steps add. The dashpots of
    !! penalty walls belong to dynamics. Collective.
    class(small_strain_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: force(:, :)           !! [N]
    real(wp), intent(in), optional :: motion(:, :)   !! of the nodes since the start [m]
    real(wp), allocatable :: velocity(:, :)

    associate (not_used => self)
    end associate
    associate (field => model%surface%field(model%s%velocity))
      velocity = field%values
      field%values = 0.0_wp
      call gather_forces(model)
      field%values = velocity
    end associate
    force = model%skeleton%nodal(2 + ndim:, :)
    if (present(motion)) call add_hourglass_forces(model, motion, force)
    call system%unknowns%fold(model, force)
  end subroutine small_find_forces

  subroutine small_find_missing_water(self, system, model, stage, pressure, water, err)
    !! What the skeleton squeezes out is as saturated as the mean of before and after. Collective.
    class(small_strain_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    class(stage_data_t), intent(in) :: stage
    real(wp), intent(in) :: pressure(:)      !! since the start [Pa]
    real(wp), intent(inout) :: water(:)      !! [m3]
    type(error_t), intent(inout) :: err

    associate (not_used => self, nor => err)
    end associate
    call missing_in_place(system, model, stage, pressure, water)
    water = water - model%mesh%water_weight*model%water%volume_strain* &
            mean_saturation(model, stage%start, stage%start + pressure)
  end subroutine small_find_missing_water

  subroutine small_start_stress(self, stress)
    !! Those that strains add to.
    class(small_strain_t), intent(in) :: self
    real(wp), allocatable, intent(inout) :: stress(:, :)   !! [Pa]

    if (allocated(self%stress)) stress = self%stress
  end subroutine small_start_stress
end module dosui_small_strain

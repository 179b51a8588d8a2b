!! Finite strains on a total Lagrangian grid: nodes and shape functions belong to the
!! reference configuration, everything else follows from the nodes' motion since some start.
!!
!! Volumes are averaged over cells: a particle's deformation gradient is scaled so that its
!! determinant is J = sum V0 det F/sum V0 of its cell (F-bar), which is what the water sees, too.
!! Surface points carry a deformation gradient, too, so that pressures follow the surface:
!! n da = J F^-T N dA (Nanson).
module dosui_total_lagrangian
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_error, only: error_t
  use dosui_finite_strain, only: carried_area, deform, elastic_strain, elastic_trial, invert, &
                                 rate_of_logarithm
  use dosui_formulation, only: formulation_t, stage_data_t
  use dosui_hourglass, only: add_hourglass_forces, elastic_tangent
  use dosui_implicit_system, only: implicit_system_t, surface_gradients
  use dosui_model, only: model_t
  use dosui_pore_water, only: content_change, mean_saturation, saturation_at
  use dosui_skeleton_step, only: gather_loads
  use dosui_state_check, only: describe_particle
  use dosui_stress_update, only: update_stress
  use dosui_topology, only: build_water, refresh_weights
  use dosui_water_step, only: find_flow
  implicit none
  private

  real(wp), parameter :: least_motion = 1.0e-4_wp
  !! of a cell: smaller motions are not told apart, as logarithms round off against 1 [-]

  type, extends(formulation_t), public :: total_lagrangian_t
    !! What a motion of the nodes starts from.
    real(wp), allocatable :: deformation(:, :, :)         !! (ndim, ndim, n) [-]
    real(wp), allocatable :: displacement(:, :)           !! of the particles [m]
    real(wp), allocatable :: surface_displacement(:, :)   !! of the surface points [m]
    real(wp), allocatable :: surface_deformation(:, :)    !! likewise (ndim*ndim, points) [-]
    real(wp), allocatable :: volume(:), porosity(:), mass(:)   !! [m3], [-], [kg]
    real(wp), allocatable :: stress(:, :)                 !! effective [Pa]
    real(wp), allocatable :: state(:, :)                  !! of the materials [units of the states]
  contains
    procedure :: linearise => lagrangian_linearise
    procedure :: take_start => lagrangian_take_start
    procedure :: move_to => lagrangian_move_to
    procedure :: find_forces => lagrangian_find_forces
    procedure :: find_missing_water => lagrangian_find_missing_water
    procedure :: accept => lagrangian_accept
  end type total_lagrangian_t

contains

  subroutine lagrangian_take_start(self, model)
    !! Keeps the present state.
    class(total_lagrangian_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    integer :: n, m

    n = model%particles%count
    m = model%surface%count
    associate (field => model%particles%field, h => model%p)
      self%deformation = reshape(field(h%deformation)%values(:, 1:n), [ndim, ndim, n])
      self%displacement = field(h%displacement)%values(:, 1:n)
      self%volume = field(h%volume)%values(1, 1:n)
      self%porosity = field(h%porosity)%values(1, 1:n)
      self%mass = field(h%mass)%values(1, 1:n)
      self%stress = field(h%effective_stress)%values(:, 1:n)
      if (h%state > 0) self%state = field(h%state)%values(:, 1:n)
    end associate
    associate (field => model%surface%field, h => model%s)
      self%surface_displacement = field(h%displacement)%values(:, 1:m)
      self%surface_deformation = field(h%deformation)%values(:, 1:m)
    end associate
  end subroutine lagrangian_take_start

  subroutine lagrangian_move_to(self, model, motion, err)
    !! Puts the model where a motion of the nodes since the start brings it. A cell that has lost
    !! its volume is an error, and the model then waits for a smaller motion. Collective.
    class(total_lagrangian_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: deformation(:, :, :), step(:, :)
    integer :: n, m

    call model%timers%start(model%phase%stress)
    n = model%particles%count
    m = model%surface%count
    deformation = self%deformation
    associate (field => model%particles%field, h => model%p)
      field(h%displacement)%values(:, 1:n) = self%displacement
      call deform(model%grid, n, model%mesh%patch, field(h%position)%values(:, 1:n), motion, &
                  deformation, field(h%displacement)%values(:, 1:n))
      if (model%skeleton%centred) call take_cell_gradients(self, model, motion, deformation)
      field(h%deformation)%values(:, 1:n) = reshape(deformation, [ndim*ndim, n])
      field(h%current_position)%values(:, 1:n) = field(h%position)%values(:, 1:n) + &
                                                 field(h%displacement)%values(:, 1:n)
    end associate
    allocate (step(ndim, m))
    call model%skeleton%surface_forces%point_velocity(motion, step)
    associate (field => model%surface%field, h => model%s)
      field(h%displacement)%values(:, 1:m) = self%surface_displacement + step
      field(h%current_position)%values(:, 1:m) = field(h%position)%values(:, 1:m) + &
                                                 field(h%displacement)%values(:, 1:m)
    end associate
    call deform_surface(self, model, motion)
    call find_stresses(self, model, deformation, err)
    call model%timers%stop(model%phase%stress)
    call model%comm%agree(err)
    if (err%failed()) return
    call model%timers%start(model%phase%rebuild)
    call refresh_weights(model)
    if (model%coupled) call build_water(model, model%p%current_position)
    call model%timers%stop(model%phase%rebuild)
  end subroutine lagrangian_move_to

  subroutine lagrangian_find_forces(self, system, model, force, motion)
    !! Loads on the deformed surface and stresses of the deformed body. Collective.
    class(total_lagrangian_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: force(:, :)           !! [N]
    real(wp), intent(in), optional :: motion(:, :)   !! of the nodes since the start [m]
    real(wp) :: pressure(model%particles%count)

    associate (not_used => self)
    end associate
    pressure = 0.0_wp
    if (model%coupled) pressure = model%particles%field(model%p%pore_pressure)% &
                                  values(1, 1:size(pressure))
    call gather_loads(model)
    force = model%skeleton%nodal(2 + ndim:, :)
    call system%internal_forces(model, pressure*saturation_at(model, pressure), force)
    if (present(motion)) call add_hourglass_forces(model, motion, force)
    call system%unknowns%fold(model, force)
  end subroutine lagrangian_find_forces

  subroutine lagrangian_find_missing_water(self, system, model, stage, pressure, water, err)
    !! With suction: mean pores times the change of what they hold, and mean saturation times the
    !! change of pores: the difference of their product. Collective.
    class(total_lagrangian_t), intent(in) :: self
    type(implicit_system_t), intent(inout) :: system
    type(model_t), intent(inout) :: model
    class(stage_data_t), intent(in) :: stage
    real(wp), intent(in) :: pressure(:)      !! since the start [Pa]
    real(wp), intent(inout) :: water(:)      !! [m3]
    type(error_t), intent(inout) :: err
    real(wp), dimension(size(water)) :: stored, pores, growth

    associate (field => model%particles%field, h => model%p, n => size(water), &
               a => stage%flow_weight)
      growth = field(h%volume)%values(1, 1:n) - self%volume
      if (.not. model%unsaturated) then
        call find_flow(model, stage%time, stage%start, water)
        call system%stored(model, a, pressure, stored, err)
        water = stage%supply + a*water - stored - model%skeleton%filling*growth
        return
      end if
      call find_flow(model, stage%time, stage%start + pressure, water)
      call system%stored_by_projection(pressure, stored)
      pores = 0.5_wp + 0.5_wp*self%porosity*self%volume/ &
              (field(h%porosity)%values(1, 1:n)*field(h%volume)%values(1, 1:n))
      water = stage%supply + a*water - stored - model%mesh%water_weight* &
              (pores*content_change(model, stage%start, stage%start + pressure) - &
               model%water%storage%compressibility*pressure)
      water = water - model%skeleton%filling*mean_saturation(model, stage%start, &
                                                             stage%start + pressure)* &
              growth
    end associate
  end subroutine lagrangian_find_missing_water

  subroutine lagrangian_accept(self, model)
    !! Velocities and volume changes of a step that is accepted; the state is there already.
    class(total_lagrangian_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    integer :: n, m

    n = model%particles%count
    m = model%surface%count
    associate (field => model%particles%field, h => model%p)
      field(h%velocity)%values(:, 1:n) = (field(h%displacement)%values(:, 1:n) - &
                                          self%displacement)/model%clock%dt
      if (model%coupled) model%water%volume_strain = &
        (1.0_wp - self%volume/field(h%volume)%values(1, 1:n))
    end associate
    associate (field => model%surface%field, h => model%s)
      field(h%velocity)%values(:, 1:m) = (field(h%displacement)%values(:, 1:m) - &
                                          self%surface_displacement)/model%clock%dt
    end associate
  end subroutine lagrangian_accept

  subroutine take_cell_gradients(self, model, motion, deformation)
    !! Gives the increments of the particles' deformation gradients the mean that the gradient C of
    !! their cell has: off a lattice particles do not integrate well, and cells may be cut.
    class(total_lagrangian_t), intent(in) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: motion(:, :)                  !! of the nodes [m]
    real(wp), intent(inout) :: deformation(:, :, :)       !! [-]
    real(wp) :: shift(ndim, ndim, model%grid%n_cell), volume(model%grid%n_cell)
    real(wp), allocatable :: slope(:, :, :)
    logical :: is_used(model%grid%n_cell)
    integer :: p, c

    shift = 0.0_wp
    volume = 0.0_wp
    is_used = .false.
    associate (v0 => model%particles%field(model%p%reference_volume)%values)
      do p = 1, model%particles%count
        c = model%mesh%cell(p)
        is_used(c) = .true.
        shift(:, :, c) = shift(:, :, c) - v0(1, p)*(deformation(:, :, p) - &
                                                    self%deformation(:, :, p))
        volume(c) = volume(c) + v0(1, p)
      end do
    end associate
    allocate (slope(ndim, ndim, model%grid%n_cell))
    call model%mesh%quadrature%slopes(model%grid, motion, slope)
    do c = 1, model%grid%n_cell
      if (is_used(c)) shift(:, :, c) = shift(:, :, c)/volume(c) + slope(:, :, c)
    end do
    do p = 1, model%particles%count
      deformation(:, :, p) = deformation(:, :, p) + shift(:, :, model%mesh%cell(p))
    end do
  end subroutine take_cell_gradients

  subroutine deform_surface(self, model, motion)
    !! Deformation gradients, normals and areas of the surface points.
    class(total_lagrangian_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes [m]
    real(wp) :: f(ndim, ndim), area(ndim), gradient(ndim, 2**ndim)
    integer :: p, i, b

    associate (field => model%surface%field, h => model%s)
      do p = 1, model%surface%count
        f = reshape(self%surface_deformation(:, p), [ndim, ndim])
        if (model%mesh%surface_cell(p) > 0) then
          call surface_gradients(model, p, gradient)
          do i = 1, 2**ndim
            do b = 1, ndim
              f(:, b) = f(:, b) + gradient(b, i)* &
                        motion(:, model%grid%cell_node(i, model%mesh%surface_cell(p)))
            end do
          end do
        end if
        field(h%deformation)%values(:, p) = reshape(f, [ndim*ndim])
        area = carried_area(f, field(h%reference_area)%values(:, p))
        field(h%area)%values(1, p) = norm2(area)
        field(h%normal)%values(:, p) = area/max(norm2(area), tiny(1.0_wp))
      end do
    end associate
  end subroutine deform_surface

  subroutine lagrangian_linearise(self, model, err)
    !! What follows from the deformation gradients at hand, with the elastic stiffness. Collective.
    class(total_lagrangian_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp) :: tangent(nsig, nsig)
    real(wp), allocatable :: ratio(:)
    integer :: p, n

    self%is_linear = .false.
    self%follows_places = .true.
    self%least_motion = least_motion
    n = model%particles%count
    call find_volume_ratios(model, reshape(model%particles%field(model%p%deformation)% &
                                           values(:, 1:n), [ndim, ndim, n]), ratio, err)
    call model%comm%agree(err)
    if (err%failed()) return
    do p = 1, n
      call elastic_tangent(model, p, tangent)
      model%skeleton%tangent(:, :, p) = tangent
    end do
    call refresh_weights(model)
    if (model%coupled) call build_water(model, model%p%current_position)
  end subroutine lagrangian_linearise

  subroutine find_volume_ratios(model, deformation, ratio, err)
    !! Inverses and own volumes of particles, and J of their cells.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: deformation(:, :, :)
    real(wp), allocatable, intent(out) :: ratio(:)   !! J that particles take [-]
    type(error_t), intent(inout) :: err
    real(wp) :: total(model%grid%n_cell), reference(model%grid%n_cell), jacobian
    integer :: p, n

    n = model%particles%count
    if (allocated(model%skeleton%inverse_deformation)) deallocate ( &
      model%skeleton%inverse_deformation)
    if (allocated(model%skeleton%own_volume)) deallocate (model%skeleton%own_volume)
    allocate (model%skeleton%inverse_deformation(ndim, ndim, n), model%skeleton%own_volume(n), &
              ratio(n))
    total = 0.0_wp
    reference = 0.0_wp
    associate (v0 => model%particles%field(model%p%reference_volume)%values)
      do p = 1, n
        call invert(deformation(:, :, p), model%skeleton%inverse_deformation(:, :, p), jacobian)
        if (.not. jacobian > 0.0_wp .and. .not. err%failed()) then
          call err%set(describe_particle(model, 'has lost all its volume (J <= 0)', p, .true.))
        end if
        model%skeleton%own_volume(p) = model%skeleton%filling(p)*v0(1, p)*jacobian
        total(model%mesh%cell(p)) = total(model%mesh%cell(p)) + model%skeleton%own_volume(p)
        reference(model%mesh%cell(p)) = reference(model%mesh%cell(p)) + &
                                        model%skeleton%filling(p)*v0(1, p)
      end do
      if (err%failed()) return
      do p = 1, n
        ratio(p) = total(model%mesh%cell(p))/reference(model%mesh%cell(p))
        if (.not. model%skeleton%averaged) ratio(p) = model%skeleton%own_volume(p)/ &
                                                      (model%skeleton%filling(p)*v0(1, p))
      end do
    end associate
  end subroutine find_volume_ratios

  subroutine check_pores(self, model, ratio, err)
    !! Particles that a motion compresses beyond the volume of their grains are an error.
    class(total_lagrangian_t), intent(in) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: ratio(:)   !! J that particles take [-]
    type(error_t), intent(inout) :: err
    real(wp) :: grains
    integer :: p

    associate (v0 => model%particles%field(model%p%reference_volume)%values)
      do p = 1, size(ratio)
        grains = (1.0_wp - self%porosity(p))*self%volume(p)
        if (ratio(p)*v0(1, p) > grains) cycle
        call err%set(describe_particle(model, 'closes its pores: it is compressed beyond the '// &
                                       'volume of its grains', p, .true.))
        return
      end do
    end associate
  end subroutine check_pores

  subroutine find_stresses(self, model, deformation, err)
    !! Volumes, stresses, porosities and masses from deformation gradients: the elastic trial
    !! strains of the step, which models see as strain increments of its start.
    class(total_lagrangian_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: deformation(:, :, :)
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: ratio(:), increment(:, :), trial(:, :), value(:, :), axes(:, :, :)
    real(wp), allocatable :: wet(:)   ! saturation at the start [-]
    integer :: p, n

    call find_volume_ratios(model, deformation, ratio, err)
    if (model%coupled .and. .not. err%failed()) call check_pores(self, model, ratio, err)
    if (err%failed()) return
    n = model%particles%count
    allocate (increment(nsig, n), trial(nsig, n), value(3, n), axes(3, 3, n))
    if (model%coupled) then
      wet = saturation_at(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n))
    end if
    associate (field => model%particles%field, h => model%p)
      field(h%effective_stress)%values(:, 1:n) = self%stress
      if (h%state > 0) field(h%state)%values(:, 1:n) = self%state
      do p = 1, n
        call take_trial(p)
      end do
      if (h%state > 0) then
        call update_with(field(h%state)%values)
      else
        call update_with(model%skeleton%no_state)
      end if
      do p = 1, n
        call finish_particle(p)
      end do
    end associate

  contains

    subroutine take_trial(p)
      !! Trial strain of a particle, and the stress and strain increment that its model sees.
      integer, intent(in) :: p
      real(wp) :: step(ndim, ndim), inverse(ndim, ndim), tangent(nsig, nsig), elastic(nsig)
      real(wp) :: old, old_ratio, own

      associate (sigma => model%particles%field(model%p%effective_stress)%values, &
                 v0 => model%particles%field(model%p%reference_volume)%values(1, p))
        call invert(self%deformation(:, :, p), inverse, old)
        old_ratio = self%volume(p)/v0
        own = model%skeleton%own_volume(p)/(model%skeleton%filling(p)*v0*old)
        step = matmul(deformation(:, :, p), inverse)* &
               (ratio(p)/(old_ratio*own))**(1.0_wp/ndim)
        call elastic_tangent(model, p, tangent)
        if (is_in_cauchy(p)) old_ratio = 1.0_wp
        elastic = elastic_strain(old_ratio*sigma(:, p), tangent)
        call elastic_trial(step, elastic, trial(:, p), value(:, p), axes(:, :, p))
        increment(:, p) = trial(:, p) - elastic
        increment(4:, p) = 2.0_wp*increment(4:, p)
        if (is_in_cauchy(p)) return
        increment(:, p) = increment(:, p)/ratio(p)   ! the model sees tau/J
        sigma(:, p) = sigma(:, p)*(old_ratio/ratio(p))
      end associate
      associate (soil => model%materials%item(model%material(p))%model)
        if (allocated(soil%state_strains)) then
          model%particles%field(model%p%state)%values(soil%state_strains, p) = &
            self%state(soil%state_strains, p)/ratio(p)
        end if
      end associate
    end subroutine take_trial

    subroutine update_with(state)
      !! Stresses with these state variables.
      real(wp), intent(inout) :: state(:, :)

      call update_stress(model%materials, n, model%material, increment, &
                         model%particles%field(model%p%effective_stress)%values, state, err, &
                         tangent=model%skeleton%tangent)
    end subroutine update_with

    subroutine finish_particle(p)
      !! State variables that the scaling has changed, the derivative of the Kirchhoff stress in
      !! axes that turn with the body, and what follows from the volume. With the tangent T of a
      !! model in tau/J: dtau = T de + (tau - T e) dJ/J.
      integer, intent(in) :: p
      real(wp) :: of_volume(nsig), elastic(nsig)

      associate (field => model%particles%field, h => model%p, &
                 tangent => model%skeleton%tangent(:, :, p))
        of_volume = ratio(p)*field(h%effective_stress)%values(:, p)
        if (is_in_cauchy(p)) then
          tangent = ratio(p)*tangent
        else
          elastic = trial(:, p)   ! with gaps that have to close
          if (h%state > 0) then
            associate (state => field(h%state)%values(:, p), first => self%state(:, p), &
                       soil => model%materials%item(model%material(p))%model)
              state = first + ratio(p)*(state - first)
              if (allocated(soil%state_strains)) then   ! ratio times what the model left
                state(soil%state_strains) = state(soil%state_strains) + &
                                            (ratio(p) - 1.0_wp)*first(soil%state_strains)
                elastic(1:3) = elastic(1:3) + sum(first(soil%state_strains))/3.0_wp
              end if
            end associate
          end if
          of_volume = of_volume - matmul(tangent(:, 1:3), elastic(1:3)) - &
                      2.0_wp*matmul(tangent(:, 4:), elastic(4:))
        end if
        tangent(:, 1:3) = tangent(:, 1:3) + spread(of_volume, 2, 3)
        tangent = matmul(tangent, rate_of_logarithm(value(:, p), axes(:, :, p)))
        field(h%volume)%values(1, p) = field(h%reference_volume)%values(1, p)*ratio(p)
        field(h%porosity)%values(1, p) = 1.0_wp - (1.0_wp - self%porosity(p))*self%volume(p)/ &
                                         field(h%volume)%values(1, p)
        if (model%coupled) then   ! the water that left is no longer carried
          field(h%mass)%values(1, p) = self%mass(p) + model%scene%water%density*wet(p)* &
                                       (field(h%volume)%values(1, p) - self%volume(p))
        end if
      end associate
    end subroutine finish_particle

    pure logical function is_in_cauchy(p)
      !! Are the laws of a particle's model in Cauchy stresses?
      integer, intent(in) :: p

      is_in_cauchy = model%materials%item(model%material(p))%model%is_in_cauchy
    end function is_in_cauchy
  end subroutine find_stresses
end module dosui_total_lagrangian

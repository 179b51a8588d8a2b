!! Equilibrium under the loads of the present time, without inertia: undrained, or at the pore
!! pressures at hand.
!!
!! Conjugate gradients [Hestenes1952] on the nodal displacements, with the nodal masses as
!! preconditioner and the step's own kernels as operator: a trial motion changes stresses and
!! pressures, and the change of the nodal accelerations is what the operator does to it. Conditions
!! on nodes and rigid plates are projections in the mass norm and so commute with the
!! preconditioner.
!!
!! Residuals are measured against what loads and stresses would do if nothing balanced them, never
!! against their own first value: a body that is in equilibrium already has nothing to do.
module dosui_equilibrium
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_error, only: error_t
  use dosui_hourglass, only: add_hourglass_forces
  use dosui_implicit_system, only: find_empty, implicit_system_t, is_small
  use dosui_interruption, only: look_for_interruption
  use dosui_isotropic_model, only: isotropic_model_t
  use dosui_linear_elastic, only: linear_elastic_t
  use dosui_materials, only: material_set_t
  use dosui_model, only: model_t
  use dosui_point_set, only: point_set_t
  use dosui_skeleton_step, only: gather_forces, gather_loads, light_node_mass, &
                                 nodal_accelerations, update_particles, zero_velocities
  use dosui_text, only: to_text
  use dosui_total_lagrangian, only: total_lagrangian_t
  use dosui_water_step, only: update_pressure
  implicit none
  private

  integer, parameter :: iteration_limit = 200000
  integer, parameter :: look_interval = 16            !! iterations between looks at signals
  integer, parameter :: cycle_limit = 8               !! restarts from the true residual
  real(wp), parameter :: cycle_reduction = 1.0e-9_wp  !! of the residual before a restart [-]
  real(wp), parameter :: round_off = 3.0e-14_wp       !! residual over the loads [-]
  real(wp), parameter :: noise = 1.0e-14_wp           !! residual over unbalanced stresses [-]
  real(wp), parameter :: near_round_off = 1.0e-11_wp  !! over both, where progress may end [-]
  integer, parameter :: patience = 200                !! iterations without progress there
  integer, parameter :: least_hope = 5000             !! iterations without progress elsewhere ...
  real(wp), parameter :: hope = 3.0_wp                !! ... or so many for each unknown [-]
  real(wp), parameter :: acceptable = 1.0e-8_wp       !! at the end, or it is an error [-]

  integer, parameter :: correction_limit = 3000        !! initial-stress iterations
  integer, parameter :: round = 500                    !! of them: a standing body gains in each
  real(wp), parameter :: least_gain = 0.5_wp           !! residual over that a round ago [-]
  real(wp), parameter :: correction = 1.0e-2_wp        !! what each leaves of the residual [-]
  real(wp), parameter :: nearly = 1.0e-2_wp            !! residual of a body that may yet stand [-]
  real(wp), parameter :: direct_tolerance = 1.0e-13_wp  !! of a factorised one of them [-]
  real(wp), parameter :: balanced = 1.0e-11_wp         !! residual over the weight [-]
  real(wp), parameter :: diverged = 100.0_wp           !! residual over the loads [-]

  real(wp), parameter :: soft = 1.0e-11_wp        !! energy that is looked at twice ...
  real(wp), parameter :: no_energy = 1.0e-13_wp   !! ... that is none, over the stiffest motion's
  real(wp), parameter :: rigid = 1.0e-5_wp        !! strain times spacing over motion [-]

  type, public :: load_scale_t
    !! Norms of accelerations in the masses, against which residuals are measured.
    real(wp) :: loads = -1.0_wp    !! of weight, loads, first residual; < 0: none [kg**(1/2) m/s2]
    real(wp) :: stress = 0.0_wp    !! of stresses and pressures within a cell [kg**(1/2) m/s2]
  end type load_scale_t

  type :: trial_t
    !! How trial motions act.
    logical :: undrained = .false.            !! pressures follow the volume
    logical :: is_direct = .false.            !! elastic solutions are factorised
    logical :: is_weak = .false.              !! a motion was found that strains and does no work
    real(wp), allocatable :: moved(:, :)      !! motion that hourglass modes resist [m]
    logical, allocatable :: is_empty(:, :)    !! with `moved`: components that nothing strains
  end type trial_t

  public :: find_equilibrium, find_geostatic_equilibrium, mean_stress_size

contains

  subroutine find_geostatic_equilibrium(model, n_iteration, stands, err, remains)
    !! Effective stresses in equilibrium with weight, loads and the pore pressures at hand, which
    !! stay. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(inout) :: n_iteration      !! in all
    logical, intent(out) :: stands             !! false: soils cannot carry the loads
    type(error_t), intent(inout) :: err
    character(len=:), allocatable, intent(inout) :: remains   !! then: how much, and where
    type(load_scale_t) :: scale
    type(trial_t) :: state

    stands = .true.
    if (model%materials%is_nonlinear()) then
      call relax_soils(model, state, n_iteration, scale, stands, err, remains)
    else
      call relax(model, state, 0.0_wp, n_iteration, scale, err)
    end if
  end subroutine find_geostatic_equilibrium

  subroutine relax_soils(model, state, n_iteration, scale, stands, err, remains)
    !! Soils that yield: initial-stress iterations, each an elastic solution whose strains the soils
    !! then take. What the soils remember depends on the way, so that drained solutions of small
    !! systems are direct: the way is then the same on any number of ranks. Where these solutions
    !! lead away, since the equations are not those of the kernels (stiffness that particles out of
    !! order leave), conjugate gradients begin anew. Collective.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    integer, intent(inout) :: n_iteration      !! in all
    type(load_scale_t), intent(inout) :: scale
    logical, intent(out) :: stands             !! false: soils cannot carry the loads
    type(error_t), intent(inout) :: err
    character(len=:), allocatable, intent(inout) :: remains   !! then: how much, and where
    type(material_set_t) :: soils, elastic
    type(implicit_system_t) :: system         ! of the elastic solutions, if they are direct
    type(point_set_t) :: particles, surface   ! before all motion
    real(wp), allocatable :: residual(:, :), stress(:, :)
    real(wp) :: norm, round_start   ! residual now, and where this round began
    integer :: k

    stands = .true.
    round_start = huge(1.0_wp)
    particles = model%particles
    surface = model%surface
    soils = model%materials
    elastic = elastic_parts(soils)
    allocate (residual(ndim, model%grid%n_node))
    stress = model%particles%field(model%p%effective_stress)%values
    call take_strains(model, elastic, stress, err)   ! none yet: back to the yield surface
    state%is_direct = is_small(model) .and. .not. (state%undrained .or. model%finite)
    if (allocated(model%scene%rigid_wall)) state%is_direct = .false.
    if (state%is_direct) state%is_direct = .not. hangs_on_walls(model)
    do k = 1, correction_limit + 1
      call model%comm%agree(err)
      call look_for_interruption(model, err)
      if (err%failed()) return
      model%relaxing = .true.
      call find_residual(model, state, residual, norm)
      call update_scale(model, norm, scale)
      model%relaxing = .false.
      if (.not. norm <= diverged*scale%loads) then
        stands = state%is_direct
        if (.not. stands) exit
        state%is_direct = .false.
        round_start = huge(1.0_wp)
        model%particles = particles
        model%surface = surface
        model%inverted = 0
        cycle
      end if
      stands = k <= correction_limit .and. &
               .not. (mod(k, round) == 1 .and. norm > least_gain*round_start)
      if (.not. stands .and. norm <= acceptable*scale%loads) then   ! as near as round-off lets it
        stands = .true.
        return
      end if
      if (.not. stands .and. k <= correction_limit .and. state%is_direct .and. &
          norm < nearly*scale%loads) then
        ! resistance that the equations have and the kernels have not may be in the way
        state%is_direct = .false.
        stands = .true.
      end if
      if (.not. stands) exit
      if (mod(k, round) == 1) round_start = norm
      if (norm <= max(balanced*scale%loads, noise*scale%stress)) return
      stress = model%particles%field(model%p%effective_stress)%values
      model%materials = elastic
      if (.not. state%is_direct) then
        call relax(model, state, correction*norm/scale%loads, n_iteration, scale, err)
      else
        call relax_directly(model, state, system, n_iteration, err)
      end if
      model%materials = soils
      if (err%failed()) return
      call take_strains(model, elastic, stress, err)
    end do
    remains = to_text(100.0_wp*norm/scale%loads, 2)//' % of the loads are not carried, '// &
              'around '//vector_text(centre_of(model, residual) + model%scene%local_origin)//' m'
  end subroutine relax_soils

  function elastic_parts(soils) result(elastic)
    !! Linear elasticity with the moduli of soils.
    type(material_set_t), intent(in) :: soils
    type(material_set_t) :: elastic
    type(linear_elastic_t) :: part
    real(wp) :: bulk, shear
    integer :: m

    allocate (elastic%item(size(soils%item)))
    do m = 1, size(soils%item)
      bulk = soils%item(m)%model%bulk_modulus()
      shear = soils%item(m)%model%shear_modulus()
      call part%init(9.0_wp*bulk*shear/(3.0_wp*bulk + shear), &
                     (3.0_wp*bulk - 2.0_wp*shear)/(2.0_wp*(3.0_wp*bulk + shear)))
      allocate (elastic%item(m)%model, source=part)
      select type (soil => soils%item(m)%model)
      class is (isotropic_model_t)   ! it has the same first constants
        if (soil%varies()) call elastic%item(m)%model%vary_like(soil)
      end select
    end do
  end function elastic_parts

  subroutine take_strains(model, elastic, before, err)
    !! Soils take the strains by which elastic stresses have changed since `before`.
    type(model_t), intent(inout) :: model
    type(material_set_t), intent(in) :: elastic
    real(wp), intent(in) :: before(:, :)   !! (nsig, n) [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: change(nsig), strain(nsig, 1), mean, state(0, 1), bulk, shear
    integer :: m, p, n_state

    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        m = nint(field(h%material)%values(1, p))
        change = field(h%effective_stress)%values(:, p) - before(:, p)
        associate (part => elastic%item(m)%model, soil => model%materials%item(m)%model)
          mean = sum(change(1:3))/3.0_wp
          bulk = part%bulk_modulus()
          shear = part%shear_modulus()
          if (part%varies()) call part%moduli(field(h%state)%values(:, p), bulk, shear)
          strain(:, 1) = change/shear
          strain(1:3, 1) = 0.5_wp*(change(1:3) - mean)/shear + mean/(3.0_wp*bulk)
          field(h%effective_stress)%values(:, p) = before(:, p)
          n_state = soil%n_state()
          if (n_state > 0) then
            call soil%update_stress(1, strain, field(h%effective_stress)%values(:, p:p), &
                                    field(h%state)%values(1:n_state, p:p), err)
          else
            call soil%update_stress(1, strain, field(h%effective_stress)%values(:, p:p), state, err)
          end if
        end associate
      end do
    end associate
  end subroutine take_strains

  subroutine find_equilibrium(model, reduction, n_iteration, scale, err)
    !! Undrained equilibrium: brings the residual accelerations down to `reduction` times the
    !! loads', or to round-off. Particles keep their places and do not move afterwards. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: reduction          !! wanted [-]; 0: round-off
    integer, intent(inout) :: n_iteration      !! in all
    type(load_scale_t), intent(inout) :: scale
    type(error_t), intent(inout) :: err
    type(trial_t) :: state
    character(len=:), allocatable :: remains
    logical :: stands

    state%undrained = model%coupled
    if (.not. model%materials%is_nonlinear()) then
      call relax(model, state, reduction, n_iteration, scale, err)
      return
    end if
    call relax_soils(model, state, n_iteration, scale, stands, err, remains)
    if (stands .or. err%failed()) return
    call err%set('the start found no equilibrium: the soils cannot carry the loads; '//remains)
  end subroutine find_equilibrium

  subroutine relax(model, state, reduction, n_iteration, scale, err)
    !! As `find_equilibrium`, drained or undrained.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    real(wp), intent(in) :: reduction          !! wanted [-]; 0: round-off
    integer, intent(inout) :: n_iteration      !! in all
    type(load_scale_t), intent(inout) :: scale
    type(error_t), intent(inout) :: err
    type(point_set_t) :: particles, surface   ! before all motion
    real(wp), allocatable :: residual(:, :)
    real(wp) :: norm, last_norm, wanted, small
    integer :: k

    model%relaxing = .true.
    model%clock%dt = 1.0_wp   ! nodal velocities are displacements here
    allocate (residual(ndim, model%grid%n_node))
    last_norm = huge(1.0_wp)
    do k = 1, cycle_limit
      call find_residual(model, state, residual, norm)
      call update_scale(model, norm, scale)
      wanted = max(max(reduction, round_off)*scale%loads, noise*scale%stress)
      small = near_round_off*max(scale%loads, scale%stress)
      if (norm <= wanted .or. norm > 0.5_wp*last_norm) exit
      last_norm = norm
      if (k == 1) particles = model%particles
      if (k == 1) surface = model%surface
      call conjugate_gradients(model, state, max(cycle_reduction*norm, 0.5_wp*wanted), small, &
                               scale, residual, n_iteration, err)
      if (err%failed()) exit
      if (state%is_weak .and. .not. allocated(state%moved)) then   ! once more, with resistance
        model%particles = particles
        model%surface = surface
        model%inverted = 0
        call add_resistance(model, state, err)
        if (err%failed()) exit
        last_norm = huge(1.0_wp)
      end if
    end do
    model%relaxing = .false.
    if (err%failed()) return
    if (.not. norm <= max(max(acceptable, reduction)*scale%loads, small)) then
      call err%set('the start found no equilibrium: a residual of '// &
                   to_text(norm/scale%loads)//' of the loads is left')
    end if
  end subroutine relax

  logical function hangs_on_walls(model) result(hangs)
    !! Are there nodes with mass that nothing strains? Only the springs of walls can hold these, and
    !! implicit equations take them for held. Collective.
    type(model_t), intent(inout) :: model
    logical, allocatable :: is_empty(:, :)
    integer :: i

    call zero_velocities(model)
    call gather_forces(model)
    allocate (is_empty(ndim, model%grid%n_node))
    call find_empty(model, is_empty)
    hangs = .false.
    do i = 1, model%grid%n_node
      hangs = hangs .or. any(is_empty(:, i)) .and. &
              model%skeleton%nodal(1, i) > light_node_mass(model)
    end do
    hangs = model%comm%any(hangs)
  end function hangs_on_walls

  subroutine relax_directly(model, state, system, n_iteration, err)
    !! The motion that balances the elastic body, its pressures held, by factorisation. Where that
    !! fails, conjugate gradients have their turn next time. Collective.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    type(implicit_system_t), intent(inout) :: system   !! built when it is first needed
    integer, intent(inout) :: n_iteration
    type(error_t), intent(inout) :: err
    type(error_t) :: failure
    real(wp), allocatable :: force(:, :), motion(:, :), held(:, :), tangent(:, :, :)
    real(wp) :: none(0)
    logical :: coupled

    model%relaxing = .true.
    model%clock%dt = 1.0_wp
    call zero_velocities(model)
    call gather_forces(model)
    force = model%skeleton%nodal(2 + ndim:, :)
    allocate (motion, held, mold=force)
    motion = 0.0_wp
    held = 0.0_wp
    coupled = model%coupled
    model%coupled = .false.   ! the skeleton alone gives way
    if (allocated(model%skeleton%tangent)) call move_alloc(model%skeleton%tangent, tangent)
    if (system%unknowns%n_u == 0) call system%build(model, .false., failure)
    if (.not. failure%failed()) then
      call system%solve(model, 0.0_wp, force, model%clock%time, held, .false., none, &
                        direct_tolerance, .false., motion, none, failure)
    end if
    if (allocated(tangent)) call move_alloc(tangent, model%skeleton%tangent)
    model%coupled = coupled
    n_iteration = n_iteration + 1
    state%is_direct = .not. failure%failed()
    if (state%is_direct) call move_by(model, state, motion, err)
    model%relaxing = .false.
  end subroutine relax_directly

  subroutine add_resistance(model, state, err)
    !! From here on weak modes are resisted as in implicit steps. Collective.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    type(error_t), intent(inout) :: err
    type(total_lagrangian_t) :: body

    if (model%finite) call body%linearise(model, err)   ! the operators need it
    if (err%failed()) return
    allocate (state%moved(ndim, model%grid%n_node), source=0.0_wp)
    allocate (state%is_empty(ndim, model%grid%n_node))
    call find_empty(model, state%is_empty)
  end subroutine add_resistance

  subroutine update_scale(model, norm, scale)
    !! Scales of the residuals: loads once, the stresses as they are. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: norm                 !! of the residual at hand
    type(load_scale_t), intent(inout) :: scale
    real(wp), allocatable :: forces(:, :)
    real(wp) :: sums(2)

    sums = [sum(model%particles%field(model%p%mass)%values(1, 1:model%particles%count)), &
            sum(model%mesh%weight(1:model%particles%count))]
    call model%comm%sum_array(sums)
    scale%stress = mean_stress_size(model)*sums(2)/(sqrt(sums(1))*model%grid%spacing)
    if (scale%loads >= 0.0_wp) return
    forces = model%skeleton%nodal   ! those at hand are still wanted
    call gather_loads(model)
    scale%loads = max(norm, sqrt(force_product(model)))
    model%skeleton%nodal = forces
  end subroutine update_scale

  real(wp) function mean_stress_size(model) result(stress)
    !! Root mean square of effective stresses and pore pressures together [Pa]. Collective.
    type(model_t), intent(in) :: model
    real(wp) :: sums(2), square
    integer :: p

    sums = 0.0_wp
    do p = 1, model%particles%count
      square = sum(model%particles%field(model%p%effective_stress)%values(:, p)**2)
      if (model%coupled) then
        square = square + ndim*model%particles%field(model%p%pore_pressure)%values(1, p)**2
      end if
      sums = sums + model%mesh%weight(p)*[square, 1.0_wp]
    end do
    call model%comm%sum_array(sums)
    stress = sqrt(sums(1)/sums(2))
  end function mean_stress_size

  real(wp) function force_product(model) result(product)
    !! Sum of f.f/m over the nodes that particles touch. Collective.
    type(model_t), intent(in) :: model
    integer :: i

    product = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      if (.not. model%skeleton%nodal(1, i) > light_node_mass(model)) cycle
      product = product + sum(model%skeleton%nodal(2 + ndim:, i)**2)/node_inertia(model, i)
    end do
    product = model%comm%sum(product)
  end function force_product

  subroutine conjugate_gradients(model, state, target_norm, small_norm, scale, residual, &
                                 n_iteration, err)
    !! One run of the iteration. The motion of an iteration is completed together with the trial
    !! motion of the next one, so that an iteration costs as much as an explicit step.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state       !! weak on return: it ended, and needs resistance
    real(wp), intent(in) :: target_norm
    real(wp), intent(in) :: small_norm          !! below this it may end without progress, too
    type(load_scale_t), intent(in) :: scale
    real(wp), intent(inout) :: residual(:, :)   !! accelerations of the nodes
    integer, intent(inout) :: n_iteration
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: direction(:, :), trial(:, :), motion(:, :)
    real(wp), allocatable :: least(:, :)   ! residual when it was last halved
    real(wp) :: square, new_square, best_square, curvature, length, trial_length, norm, way_square
    real(wp) :: most_idle   ! iterations without progress
    integer :: n_idle

    allocate (direction, source=residual)
    allocate (motion, mold=residual)
    allocate (trial, mold=residual)
    motion = 0.0_wp
    square = mass_product(model, residual, residual)
    way_square = square
    best_square = square
    n_idle = 0
    least = residual
    most_idle = max(real(least_hope, wp), hope*unknowns(model))
    trial_length = first_length(model)
    do
      motion = motion + trial_length*direction
      call move_by(model, state, motion, err)
      if (err%failed()) return
      call find_residual(model, state, trial, norm)
      trial = (residual - trial)/trial_length      ! what the operator makes of the direction
      curvature = mass_product(model, direction, trial)
      n_iteration = n_iteration + 1
      if (mod(n_iteration, look_interval) == 0) call look_for_interruption(model, err)
      if (err%failed()) return
      if (.not. (curvature > soft*way_square/first_length(model) .and. &
                 curvature <= huge(1.0_wp))) then
        motion = -trial_length*direction
        if (square <= small_norm**2) exit
        call move_by(model, state, motion, err)
        if (.not. err%failed()) call look_twice(model, state, direction, scale, trial_length, &
                                                trial, curvature, err)
        if (err%failed() .or. (state%is_weak .and. .not. allocated(state%moved))) return
      end if
      length = square/curvature
      motion = (length - trial_length)*direction
      residual = residual - length*trial
      new_square = mass_product(model, residual, residual)
      if (new_square <= target_norm**2) exit
      n_idle = n_idle + 1
      if (new_square < 0.25_wp*best_square) then
        best_square = new_square
        n_idle = 0
        least = residual
      else if (n_idle > patience .and. new_square <= small_norm**2) then
        exit
      end if
      if (n_idle > most_idle) then
        call err%set('the start found no equilibrium: '//to_text(n_idle)//' iterations have '// &
                     'not halved a residual of '//to_text(sqrt(best_square)/scale%loads, 2)// &
                     ' of the loads around '//vector_text(centre_of(model, least) + &
                                                          model%scene%local_origin)// &
                     ' m; is the body held there by its mechanical conditions?')
        return
      end if
      if (n_iteration >= iteration_limit) then
        call err%set('the start found no equilibrium in '//to_text(n_iteration)// &
                     ' iterations: the residual is '//to_text(sqrt(best_square)/scale%loads, 2)// &
                     ' of the loads at best, now around '// &
                     vector_text(centre_of(model, residual) + model%scene%local_origin)//' m')
        return
      end if
      direction = residual + (new_square/square)*direction
      way_square = new_square + (new_square/square)**2*way_square
      square = new_square
      trial_length = length
    end do
    call move_by(model, state, motion, err)
  end subroutine conjugate_gradients

  real(wp) function unknowns(model) result(n)
    !! Components of motion of all nodes with mass. Collective.
    type(model_t), intent(in) :: model
    integer :: i

    n = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      if (model%skeleton%nodal(1, i) > light_node_mass(model)) n = n + real(ndim, wp)
    end do
    n = model%comm%sum(n)
  end function unknowns

  subroutine look_twice(model, state, direction, scale, trial_length, trial, curvature, err)
    !! The energy of a direction that seems to have none, from a motion so large that round-off of
    !! the stresses does not matter. If there is none and forces drive the motion, nothing holds
    !! the body: an error says where. The state is then beside itself by `trial_length`. Collective.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    real(wp), intent(in) :: direction(:, :)
    type(load_scale_t), intent(in) :: scale
    real(wp), intent(out) :: trial_length        !! of the motion
    real(wp), intent(inout) :: trial(:, :)       !! what the operator makes of the direction
    real(wp), intent(out) :: curvature
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: residual(:, :)
    real(wp) :: norm, way_square, strain
    logical :: is_rigid

    way_square = mass_product(model, direction, direction)
    trial_length = max(scale%loads, scale%stress)*first_length(model)/sqrt(way_square)
    allocate (residual, mold=direction)
    call find_residual(model, state, residual, norm)
    call move_by(model, state, trial_length*direction, err)
    if (err%failed()) return
    strain = strain_size(model)/trial_length
    call find_residual(model, state, trial, norm)
    trial = (residual - trial)/trial_length
    curvature = mass_product(model, direction, trial)
    if (curvature > no_energy*way_square/first_length(model) .and. &
        curvature <= huge(1.0_wp)) return
    is_rigid = strain*model%grid%spacing <= rigid*motion_size()
    if (allocated(state%moved)) then
      call err%set(describe_mechanism(model, direction, is_rigid))
    else
      call move_by(model, state, -trial_length*direction, err)
      state%is_weak = .true.
    end if

  contains

    real(wp) function motion_size() result(way)
      !! Root mean square of the direction over the masses.
      real(wp) :: mass

      associate (masses => model%particles%field(model%p%mass)%values)
        mass = model%comm%sum(sum(masses(1, 1:model%particles%count)))
      end associate
      way = sqrt(way_square/mass)
    end function motion_size
  end subroutine look_twice

  real(wp) function strain_size(model) result(strain)
    !! Root mean square of the particles' last strain increments [-]. Collective.
    type(model_t), intent(in) :: model
    real(wp) :: sums(2)
    integer :: p

    sums = 0.0_wp
    do p = 1, model%particles%count
      sums = sums + model%mesh%weight(p)*[sum(model%skeleton%strain_increment(:, p)**2), 1.0_wp]
    end do
    call model%comm%sum_array(sums)
    strain = sqrt(sums(1)/sums(2))
  end function strain_size

  function describe_mechanism(model, motion, is_rigid) result(text)
    !! Where a motion without resistance is, and where it goes. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: motion(:, :)   !! of the nodes, any size
    logical, intent(in) :: is_rigid        !! no particle is strained
    character(len=:), allocatable :: text
    real(wp) :: way(ndim), centre(ndim)
    integer :: i

    centre = centre_of(model, motion) + model%scene%local_origin
    way = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      way = way + model%skeleton%nodal(1, i)*norm2(motion(:, i))*motion(:, i)
    end do
    call model%comm%sum_array(way)
    if (norm2(way) > 0.0_wp) way = way/norm2(way)
    if (is_rigid) then
      text = 'the start found no equilibrium: the body around '//vector_text(centre)// &
             ' m can move along '//vector_text(way)//' without resistance and is driven; '// &
             'is it held by its mechanical conditions?'
    else
      text = 'the start found no equilibrium: the soil around '//vector_text(centre)// &
             ' m gives way along '//vector_text(way)//' without resistance'
    end if
  end function describe_mechanism

  function centre_of(model, motion) result(centre)
    !! Centre of a nodal field, weighted with mass times its square [m]. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: motion(:, :)   !! (ndim, n_node)
    real(wp) :: centre(ndim), sums(1 + ndim), square
    integer :: i

    sums = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      square = node_inertia(model, i)*sum(motion(:, i)**2)
      centre = model%grid%origin + model%grid%spacing*real(model%grid%node_index(:, i), wp)
      sums = sums + square*[1.0_wp, centre]
    end do
    call model%comm%sum_array(sums)
    centre = 0.0_wp
    if (sums(1) > 0.0_wp) centre = sums(2:)/sums(1)
  end function centre_of

  function vector_text(vector) result(text)
    !! (x, y, z), three digits each.
    real(wp), intent(in) :: vector(:)
    character(len=:), allocatable :: text
    integer :: d

    text = '('
    do d = 1, size(vector)
      if (d > 1) text = text//', '
      text = text//to_text(vector(d), 3)
    end do
    text = text//')'
  end function vector_text

  real(wp) function first_length(model) result(length)
    !! A trial length of the right size: accelerations act over the time of the fastest wave [s2].
    type(model_t), intent(in) :: model

    length = model%scales%density*model%grid%spacing**2/model%scales%stiffest
  end function first_length

  subroutine find_residual(model, state, residual, norm)
    !! Accelerations of the nodes at rest, and their norm in the masses.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(in) :: state
    real(wp), intent(out) :: residual(:, :)
    real(wp), intent(out) :: norm

    call zero_velocities(model)
    call gather_forces(model)
    if (allocated(state%moved)) then
      call add_hourglass_forces(model, state%moved, model%skeleton%nodal(2 + ndim:, :))
      where (state%is_empty) model%skeleton%nodal(2 + ndim:, :) = 0.0_wp
    end if
    call nodal_accelerations(model, residual)
    norm = sqrt(mass_product(model, residual, residual))
  end subroutine find_residual

  subroutine move_by(model, state, motion, err)
    !! Stresses and, if undrained, pressures after a motion of the nodes.
    type(model_t), intent(inout) :: model
    type(trial_t), intent(inout) :: state
    real(wp), intent(in) :: motion(:, :)   !! [m]
    type(error_t), intent(inout) :: err

    model%skeleton%velocity_old = 0.0_wp
    model%skeleton%velocity = motion
    call update_particles(model, err)
    if (state%undrained) call update_pressure(model, .false.)
    if (allocated(state%moved)) state%moved = state%moved + motion
    call model%comm%agree(err)
  end subroutine move_by

  real(wp) function mass_product(model, a, b) result(product)
    !! Sum of m a.b over all nodes. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: a(:, :), b(:, :)
    integer :: i

    product = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      product = product + node_inertia(model, i)*dot_product(a(:, i), b(:, i))
    end do
    product = model%comm%sum(product)
  end function mass_product

  pure real(wp) function node_inertia(model, i) result(inertia)
    !! What `nodal_accelerations` accelerates a node with [kg]: only in this product are they the
    !! gradient of the energy. Nodes that follow others, and those that lead, have their mass alone.
    type(model_t), intent(in) :: model
    integer, intent(in) :: i   !! node

    inertia = model%skeleton%nodal(1, i)
    if (.not. model%mesh%extension%is_on) inertia = max(inertia, model%skeleton%inertia(i))
  end function node_inertia
end module dosui_equilibrium

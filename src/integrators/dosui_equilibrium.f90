!! Equilibrium under the loads of the present time, without inertia: undrained, or at the pore
!! pressures at hand.
!!
!! Conjugate gradients on the nodal displacements, with the nodal masses as preconditioner and the
!! step's own kernels as operator: a trial motion changes stresses and pressures, and the change
!! of the nodal accelerations is what the operator does to it. Conditions on nodes and rigid
!! plates are projections in the mass norm and so commute with the preconditioner.
module dosui_equilibrium
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_error, only: error_t
  use dosui_linear_elastic, only: linear_elastic_t
  use dosui_materials, only: material_set_t
  use dosui_model, only: model_t
  use dosui_skeleton_step, only: gather_forces, nodal_accelerations, update_particles, &
                                 zero_velocities
  use dosui_text, only: to_text
  use dosui_water_step, only: update_pressure
  implicit none
  private

  integer, parameter :: iteration_limit = 200000
  integer, parameter :: cycle_limit = 8               !! restarts from the true residual
  real(wp), parameter :: cycle_reduction = 1.0e-9_wp  !! of the residual before a restart [-]
  real(wp), parameter :: round_off = 3.0e-14_wp       !! residual over its first value [-]
  real(wp), parameter :: near_round_off = 1.0e-11_wp  !! likewise, where progress may end [-]
  integer, parameter :: patience = 200                !! iterations without progress there
  real(wp), parameter :: acceptable = 1.0e-8_wp       !! at the end, or it is an error [-]

  integer, parameter :: correction_limit = 3000        !! initial-stress iterations
  integer, parameter :: round = 500                    !! of them: a standing body gains in each
  real(wp), parameter :: least_gain = 0.5_wp           !! residual over that a round ago [-]
  real(wp), parameter :: correction = 1.0e-2_wp        !! what each leaves of the residual [-]
  real(wp), parameter :: balanced = 1.0e-11_wp         !! residual over the weight [-]

  public :: find_equilibrium, find_geostatic_equilibrium

contains

  subroutine find_geostatic_equilibrium(model, n_iteration, stands, err)
    !! Effective stresses in equilibrium with weight, loads and the pore pressures at hand, which
    !! stay. Soils that yield: initial-stress iterations, each an elastic solution whose strains
    !! the soils then take. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(inout) :: n_iteration      !! in all
    logical, intent(out) :: stands             !! false: soils cannot carry the loads
    type(error_t), intent(inout) :: err
    type(material_set_t) :: soils, elastic
    real(wp), allocatable :: residual(:, :), stress(:, :)
    real(wp) :: first, start, norm   ! residuals: the first of all and of an elastic solution, now
    real(wp) :: scale, round_start   ! of the weight; residual where this round began
    integer :: k, n

    stands = .true.
    first = -1.0_wp
    round_start = huge(1.0_wp)
    if (.not. model%materials%is_nonlinear()) then
      call find_equilibrium(model, 0.0_wp, n_iteration, first, err, water_held=.true.)
      return
    end if
    soils = model%materials
    elastic = elastic_parts(soils)
    allocate (residual(ndim, model%grid%n_node))
    stress = model%particles%field(model%p%effective_stress)%values
    call take_strains(model, elastic, stress, err)   ! none yet: back to the yield surface
    scale = norm2(model%scene%gravity)*sqrt(model%comm%sum(sum( &
                            model%particles%field(model%p%mass)%values(1, :model%particles%count))))
    do k = 1, correction_limit
      call model%comm%agree(err)
      if (err%failed()) return
      model%relaxing = .true.
      call find_residual(model, residual, norm)
      model%relaxing = .false.
      if (first < 0.0_wp) first = norm
      stands = .not. (mod(k, round) == 1 .and. norm > least_gain*round_start)
      if (.not. stands) return
      if (mod(k, round) == 1) round_start = norm
      if (norm <= balanced*max(scale, first)) return
      stress = model%particles%field(model%p%effective_stress)%values
      model%materials = elastic
      start = -1.0_wp
      n = 0
      call find_equilibrium(model, correction, n, start, err, water_held=.true.)
      n_iteration = n_iteration + n
      model%materials = soils
      if (err%failed()) return
      call take_strains(model, elastic, stress, err)
    end do
    stands = .false.
  end subroutine find_geostatic_equilibrium

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
    end do
  end function elastic_parts

  subroutine take_strains(model, elastic, before, err)
    !! Soils take the strains by which elastic stresses have changed since `before`.
    type(model_t), intent(inout) :: model
    type(material_set_t), intent(in) :: elastic
    real(wp), intent(in) :: before(:, :)   !! (nsig, n) [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: change(nsig), strain(nsig, 1), mean, state(0, 1)
    integer :: m, p, n_state

    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        m = nint(field(h%material)%values(1, p))
        change = field(h%effective_stress)%values(:, p) - before(:, p)
        associate (part => elastic%item(m)%model, soil => model%materials%item(m)%model)
          mean = sum(change(1:3))/3.0_wp
          strain(:, 1) = change/part%shear_modulus()
          strain(1:3, 1) = 0.5_wp*(change(1:3) - mean)/part%shear_modulus() + &
                           mean/(3.0_wp*part%bulk_modulus())
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

  subroutine find_equilibrium(model, reduction, n_iteration, first, err, water_held)
    !! Brings the residual accelerations down to `reduction` times `first`, or to round-off.
    !! Particles keep their places and do not move afterwards. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: reduction          !! wanted [-]; 0: round-off
    integer, intent(inout) :: n_iteration      !! in all
    real(wp), intent(inout) :: first           !! norm of the first residual; < 0: not known yet
    type(error_t), intent(inout) :: err
    logical, intent(in), optional :: water_held   !! pressures stay: the skeleton alone gives way
    real(wp), allocatable :: residual(:, :)
    real(wp) :: norm, last_norm
    logical :: undrained
    integer :: k

    undrained = model%coupled
    if (present(water_held)) undrained = undrained .and. .not. water_held
    model%relaxing = .true.
    model%clock%dt = 1.0_wp   ! nodal velocities are displacements here
    allocate (residual(ndim, model%grid%n_node))
    last_norm = huge(1.0_wp)
    do k = 1, cycle_limit
      call find_residual(model, residual, norm)
      if (first < 0.0_wp) first = norm
      if (norm <= max(reduction, round_off)*first .or. norm > 0.5_wp*last_norm) exit
      last_norm = norm
      call conjugate_gradients(model, max(cycle_reduction*norm, &
                                          0.5_wp*max(reduction, round_off)*first), &
                               near_round_off*first, undrained, residual, n_iteration, err)
      if (err%failed()) exit
    end do
    model%relaxing = .false.
    if (err%failed()) return
    if (.not. norm <= max(acceptable, reduction)*first) then
      call err%set('the start found no equilibrium: a residual of '// &
                   to_text(norm/first)//' of the loads is left')
    end if
  end subroutine find_equilibrium

  subroutine conjugate_gradients(model, target_norm, small_norm, undrained, residual, &
                                 n_iteration, err)
    !! One run of the iteration. The motion of an iteration is completed together with the trial
    !! motion of the next one, so that an iteration costs as much as an explicit step.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: target_norm
    real(wp), intent(in) :: small_norm          !! below this it may end without progress, too
    logical, intent(in) :: undrained            !! pressures follow the volume
    real(wp), intent(inout) :: residual(:, :)   !! accelerations of the nodes
    integer, intent(inout) :: n_iteration
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: direction(:, :), trial(:, :), motion(:, :)
    real(wp) :: square, new_square, best_square, curvature, length, trial_length, norm
    integer :: n_idle

    allocate (direction, source=residual)
    allocate (motion, mold=residual)
    allocate (trial, mold=residual)
    motion = 0.0_wp
    square = mass_product(model, residual, residual)
    best_square = square
    n_idle = 0
    trial_length = first_length(model)
    do
      motion = motion + trial_length*direction
      call move_by(model, motion, undrained, err)
      if (err%failed()) return
      call find_residual(model, trial, norm)
      trial = (residual - trial)/trial_length      ! what the operator makes of the direction
      curvature = mass_product(model, direction, trial)
      n_iteration = n_iteration + 1
      if (.not. (curvature > 0.0_wp .and. curvature <= huge(1.0_wp))) then
        if (square <= small_norm**2) exit
        call err%set('the start found no equilibrium: the body can move without '// &
                     'resistance; is it held by its mechanical conditions?')
        return
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
      else if (n_idle > patience .and. new_square <= small_norm**2) then
        exit
      end if
      if (n_iteration >= iteration_limit) then
        call err%set('the start found no equilibrium in '//to_text(n_iteration)// &
                     ' iterations')
        return
      end if
      direction = residual + (new_square/square)*direction
      square = new_square
      trial_length = length
    end do
    call move_by(model, motion, undrained, err)
  end subroutine conjugate_gradients

  real(wp) function first_length(model) result(length)
    !! A trial length of the right size: accelerations act over the time of the fastest wave [s2].
    type(model_t), intent(in) :: model

    length = model%density*model%grid%spacing**2/model%stiffest
  end function first_length

  subroutine find_residual(model, residual, norm)
    !! Accelerations of the nodes at rest, and their norm in the masses.
    type(model_t), intent(inout) :: model
    real(wp), intent(out) :: residual(:, :)
    real(wp), intent(out) :: norm

    call zero_velocities(model)
    call gather_forces(model)
    call nodal_accelerations(model, residual)
    norm = sqrt(mass_product(model, residual, residual))
  end subroutine find_residual

  subroutine move_by(model, motion, undrained, err)
    !! Stresses and, if undrained, pressures after a motion of the nodes.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! [m]
    logical, intent(in) :: undrained
    type(error_t), intent(inout) :: err

    model%velocity_old = 0.0_wp
    model%velocity = motion
    call update_particles(model, err)
    if (undrained) call update_pressure(model, .false.)
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
      product = product + max(model%nodal(1, i), model%inertia(i))*dot_product(a(:, i), b(:, i))
    end do
    product = model%comm%sum(product)
  end function mass_product
end module dosui_equilibrium

!! Undrained equilibrium under the loads of the present time, without inertia.
!!
!! Conjugate gradients on the nodal displacements, with the nodal masses as preconditioner and the
!! step's own kernels as operator: a trial motion changes stresses and pressures, and the change
!! of the nodal accelerations is what the operator does to it. Conditions on nodes and rigid
!! plates are projections in the mass norm and so commute with the preconditioner.
module dosui_equilibrium
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
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

  public :: find_equilibrium

contains

  subroutine find_equilibrium(model, reduction, n_iteration, first, err)
    !! Brings the residual accelerations down to `reduction` times `first`, or to round-off.
    !! Particles keep their places and do not move afterwards. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: reduction          !! wanted [-]; 0: round-off
    integer, intent(inout) :: n_iteration      !! in all
    real(wp), intent(inout) :: first           !! norm of the first residual; < 0: not known yet
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: residual(:, :)
    real(wp) :: norm, last_norm
    integer :: k

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
                               near_round_off*first, residual, n_iteration, err)
      if (err%failed()) exit
    end do
    model%relaxing = .false.
    if (err%failed()) return
    if (.not. norm <= max(acceptable, reduction)*first) then
      call err%set('the undrained start found no equilibrium: a residual of '// &
                   to_text(norm/first)//' of the loads is left')
    end if
  end subroutine find_equilibrium

  subroutine conjugate_gradients(model, target_norm, small_norm, residual, n_iteration, err)
    !! One run of the iteration. The motion of an iteration is completed together with the trial
    !! motion of the next one, so that an iteration costs as much as an explicit step.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: target_norm
    real(wp), intent(in) :: small_norm          !! below this it may end without progress, too
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
      call move_by(model, motion, err)
      if (err%failed()) return
      call find_residual(model, trial, norm)
      trial = (residual - trial)/trial_length      ! what the operator makes of the direction
      curvature = mass_product(model, direction, trial)
      n_iteration = n_iteration + 1
      if (.not. (curvature > 0.0_wp .and. curvature <= huge(1.0_wp))) then
        if (square <= small_norm**2) exit
        call err%set('the undrained start found no equilibrium: the body can move without '// &
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
        call err%set('the undrained start found no equilibrium in '//to_text(n_iteration)// &
                     ' iterations')
        return
      end if
      direction = residual + (new_square/square)*direction
      square = new_square
      trial_length = length
    end do
    call move_by(model, motion, err)
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

  subroutine move_by(model, motion, err)
    !! Stresses and undrained pressures after a motion of the nodes.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)   !! [m]
    type(error_t), intent(inout) :: err

    model%velocity_old = 0.0_wp
    model%velocity = motion
    call update_particles(model, err)
    if (model%coupled) call update_pressure(model, .false.)
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

!! One explicit time step of the coupled (or dry, or rigid) problem.
!!
!! Momentum at t_n with the pressures of t_n, then stresses and pressures with the new velocities:
!! a staggered (symplectic Euler) scheme. The water may take several sub-steps in one step of the
!! skeleton, with the volume change of the step held constant.
module dosui_explicit
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_damping, only: damping_fading, damping_viscous
  use dosui_error, only: error_t
  use dosui_fluid_inertia, only: find_inertia_flow
  use dosui_force_balance, only: want_forces
  use dosui_inertial_integrator, only: inertial_integrator_t
  use dosui_model, only: model_t
  use dosui_scene, only: name_length
  use dosui_seepage, only: seepage_t
  use dosui_skeleton_step, only: finish_forces, gather_forces, update_nodes, update_particles
  use dosui_state_check, only: note_failure, note_fault
  use dosui_super_time_stepping, only: stages_needed
  use dosui_text, only: to_text
  use dosui_time_control, only: step_limit_t
  use dosui_topology, only: refresh_storage
  use dosui_water_step, only: update_pressure
  implicit none
  private

  type, extends(inertial_integrator_t), public :: explicit_t
    !! Nothing but how often the water needed sub-steps or stages of its own.
    integer :: most_parts = 1              !! of the water in a step
    integer(i8) :: n_part = 0_i8           !! of the water in all steps
    integer(i8) :: n_step = 0_i8
  contains
    procedure :: choose_step => explicit_choose_step
    procedure :: advance => explicit_advance
    procedure :: describe => explicit_describe
  end type explicit_t

  public :: explicit_step, choose_explicit_step, cut_share, damping_limit, fastest_particle

  ! Measured with random boxes (tests/verification/explicit_boxes.py) as steps over h/c: FLIP fails
  ! from 0.4 on with one particle a cell, from 0.45 on with more; others from 0.5 and 0.6 on.
  real(wp), parameter :: sparse = 0.75_wp   !! spacing of one particle a cell over the grid's [-]
  real(wp), parameter :: flip = 0.8_wp             !! [-]
  real(wp), parameter :: sparse_flip = merge(0.55_wp, 0.64_wp, ndim == 3)      !! [-]
  real(wp), parameter :: sparse_others = merge(0.75_wp, 0.85_wp, ndim == 3)    !! [-]
  integer, parameter :: most_substeps = 100000000   !! of the water in a step; 2e4 stages of RKL2

contains

  subroutine explicit_choose_step(self, model)
    !! See `choose_explicit_step`. Collective.
    class(explicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model

    call choose_explicit_step(model)
    self%most_parts = max(self%most_parts, model%water%substeps, model%water%stages)
  end subroutine explicit_choose_step

  subroutine explicit_advance(self, model, err)
    !! See `explicit_step`. Collective.
    class(explicit_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call explicit_step(model, .true., err)
    self%n_step = self%n_step + 1_i8
    self%n_part = self%n_part + int(max(1, model%water%substeps, model%water%stages), i8)
  end subroutine explicit_advance

  function explicit_describe(self) result(text)
    !! Sub-steps of the water for the closing summary, if there were any.
    class(explicit_t), intent(in) :: self
    character(len=:), allocatable :: text

    text = ''
    if (self%most_parts > 1) text = 'sub-steps or stages of the water '//to_text(self%n_part)// &
                                    ' in '//to_text(self%n_step)//' steps, at most '// &
                                    to_text(self%most_parts)//' in one'
  end function explicit_describe

  subroutine explicit_step(model, drained, err)
    !! Advances the state by the clock's step; `drained = .false.` keeps the water in place.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: drained
    type(error_t), intent(inout) :: err
    type(error_t) :: failure

    if (model%water%substeps > most_substeps) then
      call err%set('a step of '//to_text(model%clock%dt, 3)//' s needs more than '// &
                   to_text(most_substeps)//' sub-steps of the water, whose explicit limit is '// &
                   to_text(model%water%diffusion_limit, 3)//' s: a smaller time_step, or an '// &
                   'implicit integrator')
      return
    end if
    if (.not. model%rigid) then
      call want_forces(model)
      call gather_forces(model)
      call update_nodes(model)
      call note_fault(model)
      if (drained) call find_inertia_flow(model)
      call update_particles(model, failure)
      call note_failure(model, failure)   ! of this rank alone: the others learn of it later
      if (model%reactions%is_wanted) call finish_forces(model)
    end if
    if (.not. model%coupled) return
    if (model%rigid) call note_fault(model)
    if (model%unsaturated) call refresh_storage(model)   ! it follows the pressures
    call update_pressure(model, drained)
    if (model%water%switching .and. drained) call review_surfaces(model)
  end subroutine explicit_step

  subroutine review_surfaces(model)
    !! Opens and closes seepage faces and the like after a step.
    type(model_t), intent(inout) :: model
    type(seepage_t) :: seepage
    logical :: changed

    call seepage%start_step(model)
    associate (n => model%particles%count)
      call seepage%review(model, model%clock%time + model%clock%dt, &
                          model%particles%field(model%p%pore_pressure)%values(1, 1:n), changed)
    end associate
  end subroutine review_surfaces

  subroutine choose_explicit_step(model)
    !! Step from the named limits (numerics: 1/(1/t_d + 1/t_w) when the water takes one sub-step),
    !! then the water's sub-steps or stages for it.
    type(model_t), intent(inout) :: model
    type(step_limit_t) :: limits(5)
    character(len=name_length) :: stepping
    real(wp) :: courant, ratio, speed

    courant = model%scene%time%courant
    stepping = model%scene%water%stepping
    if (.not. model%rigid) then
      limits(1)%name = merge('water sound speed   ', 'skeleton wave speed ', model%coupled)
      limits(1)%dt = courant*wave_limit(model)*cut_share(model)
      if (cut_share(model) < 1.0_wp) limits(1)%name = 'nodes beside cut cells'
    end if
    limits(2)%name = 'viscous damping'
    limits(2)%dt = courant*damping_limit(model)
    if (model%coupled) then
      if (stepping == 'auto') then
        stepping = 'single'
        if (.not. model%rigid) then
          if (model%water%diffusion_limit < 2.0_wp*wave_limit(model)) stepping = 'subcycle'
          if (model%water%diffusion_limit < 0.4_wp*wave_limit(model)) stepping = 'rkl2'
        end if
      end if
      if (stepping == 'single' .or. model%rigid) then
        limits(3)%name = 'water diffusion'
        limits(3)%dt = courant*model%water%diffusion_limit
        if (.not. model%rigid) then
          limits(4)%name = 'water sound speed and diffusion'
          limits(4)%dt = courant/(1.0_wp/model%water%diffusion_limit + 1.0_wp/wave_limit(model))
        end if
      end if
    end if
    if (model%updated) then
      speed = fastest_particle(model)
      if (speed > 0.0_wp) then
        limits(5)%name = 'particle speed'
        limits(5)%dt = courant*model%scene%grid_spacing/speed
      end if
    end if
    call model%clock%choose_step(model%scene%time, limits)
    model%water%substeps = 1
    model%water%stages = 0
    ratio = model%clock%dt/(courant*model%water%diffusion_limit)
    if (.not. model%coupled .or. stepping == 'single' .or. model%rigid .or. ratio <= 1.0_wp) return
    if (ratio > real(most_substeps, wp)) then
      model%water%substeps = most_substeps + 1   ! the step refuses it
    else if (stepping == 'subcycle') then
      model%water%substeps = ceiling(ratio)
    else if (stepping == 'rkl2') then
      model%water%stages = stages_needed(ratio)
    end if
  end subroutine choose_explicit_step

  pure real(wp) function damping_limit(model) result(limit)
    !! Largest stable step of the viscous damping [s].
    type(model_t), intent(in) :: model
    real(wp) :: rate

    rate = 0.0_wp
    if (model%skeleton%damping_kind == damping_viscous) rate = model%skeleton%damping
    if (model%skeleton%damping_kind == damping_fading) rate = model%skeleton%damping_start
    limit = huge(1.0_wp)
    if (rate > 0.0_wp) limit = 2.0_wp/rate
  end function damping_limit

  real(wp) function fastest_particle(model) result(speed)
    !! Largest speed of a particle [m/s]. Collective.
    type(model_t), intent(in) :: model
    real(wp) :: square
    integer :: p

    square = 0.0_wp
    associate (velocity => model%particles%field(model%p%velocity)%values)
      do p = 1, model%particles%count
        square = max(square, sum(velocity(:, p)**2))
      end do
    end associate
    speed = sqrt(model%comm%maximum(square))
  end function fastest_particle

  pure real(wp) function cut_share(model) result(share)
    !! What surfaces within cells leave of the wave's limit [-]. Nodes beside have less mass than
    !! their cells have stiffness, the less the fewer particles there are; FLIP's limit is 1/sqrt(2)
    !! of others', since nodes forget the velocity of motions that particles do not see, but not
    !! where these have led.
    type(model_t), intent(in) :: model
    logical :: forgets, is_sparse

    share = 1.0_wp
    if (.not. model%mesh%extension%is_on) return
    is_sparse = model%scales%spacing > sparse*model%scene%grid_spacing
    forgets = any(model%scene%mechanics%transfer == ['flip ', 'blend'])
    if (forgets) share = flip
    if (is_sparse) share = merge(sparse_flip, sparse_others, forgets)
  end function cut_share

  pure real(wp) function wave_limit(model) result(limit)
    !! Time that the fastest wave needs for a grid cell [s].
    type(model_t), intent(in) :: model

    limit = model%scene%grid_spacing/sqrt(max(model%scales%stiffest, &
                                              model%scales%stiffest_now)/model%scales%density)
  end function wave_limit
end module dosui_explicit

!! The error of a step of TR-BDF2, from the flows at its three times.
module dosui_step_error
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_implicit_system, only: implicit_system_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: compressibility_at
  implicit none
  private

  real(wp), parameter, public :: gamma = 2.0_wp - sqrt(2.0_wp)   !! the middle stage [-]
  real(wp), parameter :: error_constant = (-3.0_wp*gamma**2 + 4.0_wp*gamma - 2.0_wp)/ &
                         (12.0_wp*(2.0_wp - gamma))
  real(wp), parameter, public :: first_fraction = 1.0e-5_wp   !! of the run: the first step [-]
  real(wp), parameter :: scale_share = 0.01_wp        !! of the largest pressure, in the norm [-]
  real(wp), parameter :: noise_share = 1.0e-7_wp      !! of the pressures: no error is smaller [-]

  public :: content_error, estimate_error, root_mean_square

contains

  pure function content_error(dt, flow) result(content)
    !! 2 k dt (F_n/g - F_g/(g (1 - g)) + F_1/(1 - g)) [m3].
    real(wp), intent(in) :: dt            !! [s]
    real(wp), intent(in) :: flow(:, :)    !! F of the particles at the three times [m3/s]
    real(wp) :: content(size(flow, 1))

    content = 2.0_wp*error_constant*dt*(flow(:, 1)/gamma - flow(:, 2)/(gamma*(1.0_wp - gamma)) + &
                                        flow(:, 3)/(1.0_wp - gamma))
  end function content_error

  subroutine estimate_error(system, model, a, content, start, pressure, error_norm, err)
    !! Error of the pressures: that of the content put through the system, in a norm relative to the
    !! excess pressures. A body at rest has none of these; its error is the noise that solutions
    !! leave on the pressures themselves.
    !!
    !! Where pores empty or fill and surfaces switch, flows jump, and the pressures of saturated
    !! pores, which store next to nothing, with them: such an estimate is as large at any step. What
    !! lasts are errors of the water content. An estimate that is too large is therefore put through
    !! the system once more, as what it stores [HairerWanner1996, IV.8], and at last for the
    !! time of a first step: errors that die away within it do not count.
    type(implicit_system_t), intent(inout) :: system   !! as it was last built
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: a                        !! weight of the flow in the system [s]
    real(wp), intent(in) :: content(:)               !! error of the water content [m3]
    real(wp), intent(in) :: start(:), pressure(:)    !! at t_n, and its increment [Pa]
    real(wp), intent(out) :: error_norm   !! over the allowed error [-]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: motion(:, :), error_pressure(:), supply(:), excess(:)
    real(wp) :: allowed, first

    error_norm = 0.0_wp
    allocate (motion, mold=model%skeleton%velocity)
    motion = 0.0_wp
    allocate (error_pressure(size(pressure)), supply(size(pressure)), source=0.0_wp)
    call solve_error(system, model, a, content, motion, error_pressure, err)
    if (err%failed()) return
    excess = start + pressure - &
             model%particles%field(model%p%start_pressure)%values(1, 1:size(pressure))
    allowed = root_mean_square(model, excess)
    model%scales%pressure_scale = max(model%scales%pressure_scale, allowed)
    allowed = model%scene%time%relative_tolerance*(allowed + &
                                                   scale_share*model%scales%pressure_scale) + &
              noise_share*root_mean_square(model, start + pressure)
    if (.not. allowed > 0.0_wp) return
    error_norm = root_mean_square(model, error_pressure)/allowed
    if (.not. (model%unsaturated .or. model%water%switching)) return
    first = first_fraction*model%scene%time%end_time
    if (error_norm > 1.0_wp) call keep_what_lasts(a)
    if (error_norm > 1.0_wp .and. first > a) call keep_what_lasts(first)

  contains

    subroutine keep_what_lasts(weight)
      !! Of the error: what is left of it after some time.
      real(wp), intent(in) :: weight   !! [s]

      if (err%failed()) return
      call stored_water(system, model, start + pressure, motion, error_pressure, supply)
      call solve_error(system, model, weight, supply, motion, error_pressure, err)
      if (err%failed()) return
      error_norm = min(error_norm, root_mean_square(model, error_pressure)/allowed)
    end subroutine keep_what_lasts
  end subroutine estimate_error

  subroutine solve_error(system, model, a, supply, motion, pressure, err)
    !! Motions and pressures that water supplied without any load brings.
    type(implicit_system_t), intent(inout) :: system   !! as it was last built
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: a                    !! weight of the flow [s]
    real(wp), intent(in) :: supply(:)            !! [m3]
    real(wp), intent(inout) :: motion(:, :)      !! [m]
    real(wp), intent(inout) :: pressure(:)       !! [Pa]
    type(error_t), intent(inout) :: err
    real(wp) :: zero(size(motion, 1), size(motion, 2))

    zero = 0.0_wp
    call model%timers%start(model%phase%solver)
    call system%solve(model, a, zero, model%clock%time, zero, .false., supply, &
                      system%tolerance, .false., motion, &
                      pressure, err, without_loads=.true.)
    call model%timers%stop(model%phase%solver)
  end subroutine solve_error

  subroutine stored_water(system, model, state, motion, pressure, stored)
    !! Water that small changes of motions and pressures store.
    type(implicit_system_t), intent(inout) :: system   !! as it was last built
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: state(:)         !! pressures that are changed [Pa]
    real(wp), intent(in) :: motion(:, :)     !! change [m]
    real(wp), intent(in) :: pressure(:)      !! likewise [Pa]
    real(wp), intent(inout) :: stored(:)     !! [m3]
    real(wp) :: squeezed(size(stored))

    call system%stored_by_projection(pressure, stored)
    if (model%unsaturated) stored = stored + model%mesh%water_weight*pressure* &
                                    (compressibility_at(model, state) - &
                                     model%water%storage%compressibility)
    if (model%rigid) return
    call system%volume_change(motion, squeezed)
    stored = stored + squeezed
  end subroutine stored_water

  real(wp) function root_mean_square(model, values) result(norm)
    !! Weighted by volume, over all ranks [unit of the values].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: values(:)   !! of the particles [any unit]
    real(wp) :: sums(2)

    sums = [sum(model%mesh%weight*values**2), sum(model%mesh%weight)]
    call model%comm%sum_array(sums)
    norm = sqrt(sums(1)/sums(2))
  end function root_mean_square
end module dosui_step_error

!! Formulas are tried where and when a run will need them, before it starts: a logarithm of a
!! negative number would otherwise show hours later.
module dosui_formula_trials
  use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_get_status, ieee_set_halting_mode, &
                                                                   ieee_set_status, ieee_status_type
  use dosui_kinds, only: wp
  use dosui_dimension, only: axis, ndim
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_namelist, only: namelist_t
  use dosui_problems, only: problems_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: axis_name
  use dosui_surface_sets, only: index_of, set_holds
  use dosui_text, only: to_text
  implicit none
  private

  integer, parameter :: most_values = 300000   !! of one formula on one rank
  integer, parameter :: even_times = 61        !! over the run
  integer, parameter :: most_outputs = 100     !! of the output times
  integer, parameter :: decades = 12           !! before the end of the run

  public :: try_formulas

  type :: trial_t
    !! What is being tried, for messages.
    type(namelist_t) :: namelist   !! scanned once something is wrong
    type(problems_t) :: problems
    real(wp), allocatable :: time(:)   !! increasing [s]
  end type trial_t

contains

  subroutine try_formulas(model, problems)
    !! Evaluates the formulas and tables of conditions, sources and base motion on the scene's own
    !! points and times. Collective; all ranks find the same problems.
    type(model_t), intent(in) :: model
    type(problems_t), intent(inout) :: problems
    type(trial_t) :: trial
    type(ieee_status_type) :: status
    real(wp) :: origin(ndim, 1)
    integer :: k

    call ieee_get_status(status)
    call ieee_set_halting_mode(ieee_all, .false.)   ! these may be no numbers
    do k = 1, size(model%scene%mechanical_condition)
      associate (condition => model%scene%mechanical_condition(k))
        if (.not. allocated(condition%pattern%formula)) cycle
        call try_pattern(trial, model, 'mechanical_condition', k, condition%pattern, &
                         maxval(abs(condition%value)), points_of(model, condition%surface))
      end associate
    end do
    do k = 1, size(model%scene%hydraulic_condition)
      associate (condition => model%scene%hydraulic_condition(k))
        if (.not. allocated(condition%pattern%formula)) cycle
        call try_pattern(trial, model, 'hydraulic_condition', k, condition%pattern, &
                         condition%value, points_of(model, condition%surface))
      end associate
    end do
    if (model%scene%base_motion%is_given) then
      origin = 0.0_wp
      call try_pattern(trial, model, 'base_motion', 1, model%scene%base_motion%pattern, &
                       maxval(abs(model%scene%base_motion%acceleration)), origin)
    end if
    call try_sources(trial, model)
    call ieee_set_status(status)
    problems = trial%problems
  end subroutine try_formulas

  function points_of(model, surface) result(position)
    !! This rank's points of a surface [m].
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: surface
    real(wp), allocatable :: position(:, :)
    integer :: s, p

    s = index_of(model%scene, surface)
    associate (field => model%surface%field, h => model%s, n => model%surface%count)
      position = field(h%position)%values(:, pack([(p, p=1, n)], &
                                           [(set_holds(field(h%surface)%values(:, p), s), p=1, n)]))
    end associate
  end function points_of

  subroutine try_pattern(trial, model, group, instance, pattern, value, position)
    !! A value times its table and formula. Collective.
    type(trial_t), intent(inout) :: trial
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: group
    integer, intent(in) :: instance
    type(scalar_function_t), intent(in) :: pattern
    real(wp), intent(in) :: value            !! that it multiplies
    real(wp), intent(in) :: position(:, :)   !! (ndim, n) [m]
    type(error_t) :: fault
    integer :: j, p, stride

    if (.not. allocated(pattern%formula)) return
    trial%time = trial_times(model, pattern)
    stride = stride_of(size(position, 2), size(trial%time))
    times: do j = 1, size(trial%time)
      do p = 1 + mod(j - 1, stride), size(position, 2), stride
        if (abs(value*pattern%at(position(:, p), trial%time(j))) <= huge(1.0_wp)) cycle
        call fault%set(what_is_wrong(position(:, p) + model%scene%local_origin, trial%time(j)))
        exit times
      end do
    end do times
    call complain(trial, model, group, instance, 'formula', fault)
  end subroutine try_pattern

  subroutine try_sources(trial, model)
    !! Body forces and water on the particles. Collective.
    type(trial_t), intent(inout) :: trial
    type(model_t), intent(in) :: model
    integer :: d

    do d = 1, ndim
      if (.not. model%sources%force(d)%varies()) cycle
      call try_source(trial, model, 'force_'//axis_name(axis(d)), model%sources%force(d))
    end do
    if (model%sources%has_water) call try_source(trial, model, 'water', model%sources%water)
  end subroutine try_sources

  subroutine try_source(trial, model, key, formula)
    !! A formula of the group source. Collective.
    type(trial_t), intent(inout) :: trial
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: key
    type(scalar_function_t), intent(in) :: formula
    type(error_t) :: fault
    integer :: j, p, stride

    trial%time = trial_times(model, formula)
    associate (position => model%particles%field(model%p%position)%values, &
               n => model%particles%count)
      stride = stride_of(n, size(trial%time))
      times: do j = 1, size(trial%time)
        do p = 1 + mod(j - 1, stride), n, stride
          if (abs(formula%at(position(:, p), trial%time(j))) <= huge(1.0_wp)) cycle
          call fault%set(what_is_wrong(position(:, p) + model%scene%local_origin, trial%time(j)))
          exit times
        end do
      end do times
    end associate
    call complain(trial, model, 'source', 1, key, fault)
  end subroutine try_source

  pure integer function stride_of(n_point, n_time) result(stride)
    !! Every how manieth point is tried at a time; others are at the next one.
    integer, intent(in) :: n_point, n_time

    stride = max(1, ceiling(real(n_point, wp)*real(n_time, wp)/real(most_values, wp)))
  end function stride_of

  function trial_times(model, pattern) result(time)
    !! Start, end, output times, entries of the table, and times between: evenly over the run and
    !! one a decade before its end [s].
    type(model_t), intent(in) :: model
    type(scalar_function_t), intent(in) :: pattern
    real(wp), allocatable :: time(:), corner(:)
    real(wp) :: now, next
    integer :: k, n

    associate (options => model%scene%time, start => model%clock%time)
      time = [start, options%end_time, &
              (start + (options%end_time - start)*real(k, wp)/even_times, k=1, even_times - 1), &
              (options%end_time*10.0_wp**(-k), k=1, decades)]
      if (allocated(options%output_times)) then
        n = min(size(options%output_times), most_outputs)
        time = [time, options%output_times(:n)]
      end if
      if (options%output_interval > 0.0_wp) then
        n = int(min(real(most_outputs, wp), options%end_time/options%output_interval))
        time = [time, (options%output_interval*real(k, wp), k=1, n)]
      end if
      corner = pattern%corners(ndim)
      n = min(size(corner), 10*most_outputs)
      time = [time, corner(:n), 0.5_wp*(corner(2:n) + corner(:n - 1))]
      time = pack(time, time >= start .and. time <= options%end_time)
    end associate
    do k = 1, size(time)   ! in order, so that the first time is named
      n = k - 1 + minloc(time(k:), dim=1)
      now = time(k)
      next = time(n)
      time(k) = next
      time(n) = now
    end do
  end function trial_times

  function what_is_wrong(position, time) result(text)
    !! Place and time of a value that is no number.
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp), intent(in) :: time             !! [s]
    character(len=:), allocatable :: text
    integer :: d

    text = 'is not a finite number at '
    do d = 1, ndim
      text = text//axis_name(axis(d))//' = '//to_text(position(d), 6)//', '
    end do
    text = text//'t = '//to_text(time, 6)//' s'
  end function what_is_wrong

  subroutine complain(trial, model, group, instance, key, fault)
    !! Adds what any rank has found to the problems of all. Collective.
    type(trial_t), intent(inout) :: trial
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: instance
    type(error_t), intent(inout) :: fault
    type(problems_t) :: known   ! to whoever read the scene
    integer :: g, k

    call model%comm%agree(fault)
    if (.not. fault%failed()) return
    if (trial%namelist%n_group == 0) then
      call trial%namelist%scan(model%scene%text, model%scene%file, known)
    end if
    g = trial%namelist%find(group, instance)
    k = trial%namelist%group(g)%find(key)
    associate (given => trial%namelist%group(g)%key(k))
      call trial%problems%add(model%scene%file, given%line, group, key, given%shown(), &
                              fault%message)
    end associate
  end subroutine complain
end module dosui_formula_trials

!! A run from the first particle to the closing summary.
module dosui_simulation
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_balance_search, only: balance_search_t
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_formula_trials, only: try_formulas
  use dosui_integrator, only: integrator_t
  use dosui_integrators, only: create_integrator
  use dosui_model, only: model_t
  use dosui_probes, only: check_probes
  use dosui_problems, only: problems_t
  use dosui_reactions, only: n_total, of_damping, of_inertia, of_light_nodes, of_loads, &
                             of_shaking, of_sources, of_weight
  use dosui_result_fields, only: result_fields
  use dosui_run_files, only: run_files_t
  use dosui_safety, only: find_safety_factor
  use dosui_scene, only: scene_t
  use dosui_size_report, only: report_sizes
  use dosui_setup, only: describe_model, finish_setup, seed_model, setup_model
  use dosui_softening_bands, only: average_bands
  use dosui_signals, only: signal_received, signals_watch
  use dosui_starts, only: geostatic_start
  use dosui_state_check, only: check_state, is_sound
  use dosui_text, only: to_text
  use dosui_topology, only: distribute
  use dosui_water_balance, only: balance_error, balance_noise, balance_sums
  implicit none
  private

  public :: run_scene

  integer, parameter, public :: status_finished = 0, status_failed = 1, status_bad_input = 2, &
                                status_stopped = 3   !! exit statuses
  integer, parameter, public :: to_run = 1, to_check = 2, to_find_safety = 3   !! purposes
  real(wp), parameter :: noteworthy = 0.01_wp, untrusted = 0.1_wp   !! balance errors [-]

contains

  subroutine run_scene(comm, scene, stem, restart, purpose, status)
    !! Runs a scene that has been read without problems. Collective.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: stem       !! of the files: directory and name
    character(len=*), intent(in) :: restart    !! path of a checkpoint, '' for none
    integer, intent(in) :: purpose
    integer, intent(out) :: status
    type(model_t) :: model
    class(integrator_t), allocatable :: integrator
    type(run_files_t) :: files
    type(balance_search_t) :: search
    type(error_t) :: err
    type(problems_t) :: refused
    character(len=:), allocatable :: problems

    problems = ''
    call setup_model(model, comm, scene)
    status = status_bad_input
    call create_integrator(trim(model%traits%name), integrator, err)
    call check_probes(scene%probe, result_fields(model), problems)
    if (len(restart) > 0) then
      call restore(model, files, restart, err)
    else
      call seed_model(model, problems, err)
    end if
    if (report(model, problems, err)) return
    call try_formulas(model, refused)
    if (say_refused(model, refused)) return
    call finish_setup(model, err)
    if (report(model, problems, err)) return
    call describe_model(model)
    call report_sizes(model, purpose == to_check)
    status = status_finished
    if (purpose == to_check) then
      call integrator%announce(model)
      call model%log%info('the scene is valid; nothing was computed')
      return
    end if
    if (purpose == to_find_safety) then
      call find_safety_factor(model, err)
      if (report(model, problems, err)) status = status_failed
      return
    end if
    call files%open(model, stem, len(restart) > 0, err)
    status = status_failed
    if (report(model, problems, err)) return
    call signals_watch()
    model%asked_to_end => signal_received
    call advance(model, integrator, files, search, len(restart) == 0, status, err)
    if (model%is_interrupted) then
      call model%log%info(err%message)
      status = status_stopped
      return
    end if
    if (report(model, problems, err)) return
    call summarise(model, search, status)
  end subroutine run_scene

  logical function say_refused(model, refused) result(is_refused)
    !! Shows what a scene that can be read asks for in vain.
    type(model_t), intent(in) :: model
    type(problems_t), intent(in) :: refused

    is_refused = refused%count() > 0
    if (is_refused .and. model%comm%is_root()) call refused%report()
  end function say_refused

  logical function report(model, problems, err) result(failed)
    !! Tells the user about problems of the scene or an error.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: problems
    type(error_t), intent(in) :: err

    failed = len(problems) > 0 .or. err%failed()
    if (len(problems) > 0) call model%log%error(model%scene%file//': '// &
                                                problems(:len(problems) - 1))
    if (err%failed()) call model%log%error(err%message)
  end function report

  subroutine restore(model, files, path, err)
    !! Takes up a run from its checkpoint. On the same number of ranks every rank gets back its own
    !! particles in their order; otherwise they are distributed anew.
    type(model_t), intent(inout) :: model
    type(run_files_t), intent(inout) :: files
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    logical :: same_ranks

    call model%particles%resize(0)
    call model%surface%resize(0)
    call files%read_checkpoint(model, path, same_ranks, err)
    if (err%failed()) return
    if (.not. same_ranks) call distribute(model, err, as_built=.true.)
    call model%comm%agree(err)
    call model%log%info('restart      from '//path//' at t = '//to_text(model%clock%time)//' s')
  end subroutine restore

  subroutine advance(model, integrator, files, search, from_start, status, err)
    !! The time loop.
    type(model_t), intent(inout) :: model
    class(integrator_t), intent(inout) :: integrator
    type(run_files_t), intent(inout) :: files
    type(balance_search_t), intent(inout) :: search
    logical, intent(in) :: from_start
    integer, intent(out) :: status
    type(error_t), intent(inout) :: err
    real(wp) :: started, last_line, last_checkpoint
    integer(i8) :: first_step
    type(error_t) :: write_error

    status = status_failed
    if (from_start .and. model%scene%time%geostatic_start .and. .not. model%rigid) then
      call geostatic_start(model, err)
      if (err%failed()) return
    end if
    call integrator%init(model, err)
    if (.not. (from_start .or. err%failed())) call integrator%recall(model, files%memory, err)
    if (err%failed()) return
    if (from_start) then
      call integrator%start(model, err)
      if (err%failed()) return
      call files%sample(model)
      call write_output(model, integrator, files, err)
      if (err%failed()) return
    end if
    if (from_start) call average_bands(model, err)   ! of what the start has left
    started = wall_seconds()
    last_line = started
    last_checkpoint = started
    first_step = model%clock%step
    do while (.not. (model%clock%finished() .or. &
                     model%clock%step >= model%scene%time%maximum_steps))
      call integrator%step(model, err)
      call average_bands(model, err)
      if (is_due(model, integrator%look_interval)) call check_state(model, err)
      if (err%failed()) then
        call model%comm%agree(err)
        call write_last_state(model, files, write_error)
        call files%close(model, write_error)
        return
      end if
      call files%sample(model)
      if (model%clock%at_output()) then
        call model%timers%start(model%phase%output)
        model%clock%output = model%clock%output + 1
        call write_output(model, integrator, files, err)
        call search%look(model)
        call model%timers%stop(model%phase%output)
        if (err%failed()) return
      end if
      if (model%clock%step >= model%scene%time%maximum_steps) exit
      if (mod(model%clock%step, integrator%look_interval) == 0_i8) then
        call progress(model, started, first_step, last_line)
        if (model%comm%any(signal_received())) then
          call files%write_checkpoint(model, integrator%memory(), err)
          call files%close(model, err)
          if (err%failed()) return
          call describe_solutions()
          call model%log%info('stopped by a signal at t = '//to_text(model%clock%time)// &
                              ' s; continue with --restart '//files%checkpoint_path())
          status = status_stopped
          return
        end if
      end if
      call checkpoint_if_due(model, integrator, files, last_checkpoint, err)
      if (err%failed()) return
    end do
    call describe_solutions()
    call files%write_step(model, err)   ! where maximum_steps ends a run; else it is there already
    if (.not. (err%failed() .or. model%clock%finished())) then
      call files%write_checkpoint(model, integrator%memory(), err)
      if (.not. err%failed()) call model%log%info('maximum_steps ended the run; continue with '// &
                                                  '--restart '//files%checkpoint_path())
    end if
    if (.not. err%failed()) call files%close(model, err)
    if (.not. err%failed()) status = status_finished

  contains

    subroutine describe_solutions()
      !! What the integrator has to say of its steps.
      character(len=:), allocatable :: text

      text = integrator%describe()
      if (len(text) > 0) call model%log%info(text)
    end subroutine describe_solutions
  end subroutine advance

  pure logical function is_due(model, look_interval) result(due)
    !! Is the state to be looked at after this step? Now and then, and before it is written.
    type(model_t), intent(in) :: model
    integer(i8), intent(in) :: look_interval   !! steps

    associate (step => model%clock%step, every => model%scene%output%checkpoint_steps)
      due = mod(step, look_interval) == 0_i8 .or. model%clock%at_output() .or. &
            step >= model%scene%time%maximum_steps
      if (every > 0_i8) due = due .or. mod(step, every) == 0_i8
    end associate
  end function is_due

  subroutine write_last_state(model, files, err)
    !! Before a run stops with an error: its state, if it is possible. Collective.
    type(model_t), intent(inout) :: model
    type(run_files_t), intent(inout) :: files
    type(error_t), intent(inout) :: err

    if (is_sound(model)) call files%write_step(model, err)
  end subroutine write_last_state

  subroutine write_output(model, integrator, files, err)
    !! An output step and, if the scene asks for it, a checkpoint that is kept. Collective.
    type(model_t), intent(inout) :: model
    class(integrator_t), intent(in) :: integrator
    type(run_files_t), intent(inout) :: files
    type(error_t), intent(inout) :: err

    call files%write_step(model, err)
    if (err%failed() .or. .not. model%scene%output%checkpoint_at_outputs) return
    call files%write_checkpoint(model, integrator%memory(), err, is_kept=.true.)
  end subroutine write_output

  subroutine checkpoint_if_due(model, integrator, files, last, err)
    !! Writes a checkpoint every so many steps or minutes. Collective.
    type(model_t), intent(inout) :: model
    class(integrator_t), intent(in) :: integrator
    type(run_files_t), intent(inout) :: files
    real(wp), intent(inout) :: last         !! wall clock of the last one [s]
    type(error_t), intent(inout) :: err
    logical :: due

    due = .false.
    if (model%scene%output%checkpoint_steps > 0_i8) then
      due = mod(model%clock%step, model%scene%output%checkpoint_steps) == 0_i8
    end if
    if (model%scene%output%checkpoint_minutes > 0.0_wp .and. &
        mod(model%clock%step, integrator%look_interval) == 0_i8) then
      due = due .or. model%comm%any(wall_seconds() - last > &
                                    60.0_wp*model%scene%output%checkpoint_minutes)
    end if
    if (.not. due) return
    last = wall_seconds()
    call files%write_checkpoint(model, integrator%memory(), err)
  end subroutine checkpoint_if_due

  subroutine progress(model, started, first_step, last_line)
    !! A line now and then: step, time, dt and what limits it, rate, time to go.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: started
    integer(i8), intent(in) :: first_step
    real(wp), intent(inout) :: last_line
    real(wp) :: now, rate, to_go

    now = wall_seconds()
    if (now - last_line < model%scene%output%progress_seconds) return
    last_line = now
    rate = real(model%clock%step - first_step, wp)/(now - started)
    to_go = (model%scene%time%end_time - model%clock%time)/model%clock%dt/rate
    call model%log%info('step '//to_text(model%clock%step)//'  t = '//to_text(model%clock%time)// &
                        ' s ('//to_text(100.0_wp*model%clock%time/model%scene%time%end_time, 3)// &
                        ' %)  dt = '//to_text(model%clock%dt, 4)//' s ('// &
                        trim(model%clock%limit%name)//')  '//to_text(rate, 4)// &
                        ' steps/s  to go '//to_text(to_go, 3)//' s')
  end subroutine progress

  real(wp) function wall_seconds() result(seconds)
    !! Wall clock, from an arbitrary origin [s].
    integer(i8) :: now, rate

    call system_clock(now, rate)
    seconds = real(now, wp)/real(rate, wp)
  end function wall_seconds

  subroutine summarise(model, search, status)
    !! Closing summary: time per phase over the ranks, particle-steps per second, warnings.
    type(model_t), intent(inout) :: model
    type(balance_search_t), intent(in) :: search
    integer, intent(in) :: status
    real(wp) :: seconds, least, mean, most, total
    integer :: k
    integer(i8) :: n

    n = model%comm%sum(int(model%particles%count, i8))
    call model%log%info(trim(merge('finished     ', 'stopped early', status == status_finished))// &
                        ' at t = '//to_text(model%clock%time)//' s after '// &
                        to_text(model%clock%step)//' steps')
    call model%log%info('phase                    min [s]   mean [s]    max [s]')
    total = 0.0_wp
    do k = 1, model%timers%n
      seconds = model%timers%seconds(k)
      least = model%comm%minimum(seconds)
      most = model%comm%maximum(seconds)
      mean = model%comm%sum(seconds)/real(model%comm%size, wp)
      total = total + mean
      if (most < 5.0e-4_wp) cycle
      call model%log%info('  '//model%timers%name(k) (1:20)//column(least)// &
                          column(mean)//column(most))
    end do
    if (model%clock%step > 0_i8 .and. total > 0.0_wp) then
      call model%log%info('particle-steps per second '// &
                          to_text(real(n, wp)*real(model%clock%step, wp)/total, 3)// &
                          ', rebuilds '//to_text(model%decomposition%rebuilds))
    end if
    call say_forces(model)
    if (model%coupled) call say_balance(model, search)
    if (.not. model%coupled) call say_closed(model)
    if (model%decomposition%removed > 0_i8) call model%log%info('particles removed '// &
                                                               to_text(model%decomposition%removed))
    call model%log%summary()
  end subroutine summarise

  subroutine say_forces(model)
    !! The balance of forces in the last row of the histories, parts that are zero left out.
    type(model_t), intent(in) :: model
    character(len=12) :: part(n_total + 1)
    integer, parameter :: order(n_total + 1) = [of_loads, of_weight, of_shaking, of_sources, &
                                                n_total + 1, of_damping, of_light_nodes, of_inertia]
    character(len=5), parameter :: unit(3) = [character(len=5) :: ' N/m2', ' N/m', ' N']
    real(wp), parameter :: round_off = 1.0e-12_wp   ! of the largest force [-]
    character(len=:), allocatable :: text, separator
    real(wp) :: least   ! shown [N]
    integer :: d, k

    part = [character(len=12) :: 'loads', 'weight', 'shaking', 'sources', 'damping', &
            'light nodes', 'inertia', 'walls']
    associate (reactions => model%reactions)
      if (reactions%row_time < 0.0_wp) return
      text = 'forces on the bodies at t = '//to_text(reactions%row_time, 6)//' s'
      separator = ': '
      least = round_off*maxval(abs(reactions%row_total))
      do k = 1, size(order)
        associate (force => reactions%row_total(:, order(k)))
          if (.not. any(abs(force) > least)) cycle
          text = text//separator//trim(part(order(k)))//' ('
          do d = 1, ndim
            text = text//to_text(merge(force(d), 0.0_wp, abs(force(d)) > least), 5)// &
                   merge(') ', ', ', d == ndim)
          end do
        end associate
        text = text(:len(text) - 1)
        separator = ', '
      end do
      call model%log%info(text//trim(unit(ndim))//'; missing '// &
                          to_text(reactions%row_error, 2)//' of all, at most '// &
                          to_text(reactions%largest_error, 2)//' in a row')
    end associate
  end subroutine say_forces

  subroutine say_closed(model)
    !! Dry bodies that are denser than their grains: no pores are needed, but no soil is so.
    !! Collective.
    type(model_t), intent(inout) :: model
    integer(i8) :: n

    associate (n_particle => model%particles%count)
      n = model%comm%sum(int(count(model%particles%field(model%p%porosity)%values &
                                   (1, 1:n_particle) <= 0.0_wp), i8))
    end associate
    if (n > 0_i8) call model%log%warning(to_text(n)//' particles are compressed beyond the '// &
                                         'volume of their grains: their porosity is written as 0')
  end subroutine say_closed

  subroutine say_balance(model, search)
    !! The water's balance over the whole run, and what an error of it means. Collective.
    type(model_t), intent(inout) :: model
    type(balance_search_t), intent(in) :: search
    real(wp), allocatable :: sums(:)
    character(len=:), allocatable :: missing, place

    call balance_sums(model, sums)
    missing = to_text(100.0_wp*balance_error(sums), 2)//' %'
    where (abs(sums(:3)) <= balance_noise(sums)) sums(:3) = 0.0_wp   ! round-off
    call model%log%info('water stored '//to_text(sums(1), 4)//' m3 = inflow '// &
                        to_text(sums(2), 4)//' + squeezed out of pores '//to_text(sums(3), 4)// &
                        ', missing '//missing)
    place = search%place(model)
    if (balance_error(sums) <= noteworthy) return
    call model%log%warning('the water balance misses '//missing//place)
    if (balance_error(sums) <= untrusted) return
    call model%log%info(repeat('*', 78))
    call model%log%info('*** THE DISCHARGES OF THIS RUN ARE NOT TO BE TRUSTED: '//missing// &
                        ' of the water is missing')
    call model%log%info(repeat('*', 78))
  end subroutine say_balance

  function column(seconds) result(text)
    !! A number in a column of the summary.
    real(wp), intent(in) :: seconds
    character(len=11) :: text

    write (text, '(f11.3)') seconds
  end function column
end module dosui_simulation

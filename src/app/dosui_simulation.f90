!! A run from the first particle to the closing summary.
module dosui_simulation
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_equilibrium, only: find_equilibrium, find_geostatic_equilibrium
  use dosui_error, only: error_t
  use dosui_explicit, only: choose_explicit_step, explicit_step
  use dosui_model, only: model_t
  use dosui_point_set, only: point_set_t
  use dosui_probes, only: check_probes
  use dosui_result_fields, only: result_fields
  use dosui_quasi_static, only: quasi_static_t
  use dosui_run_files, only: run_files_t
  use dosui_safety, only: find_safety_factor
  use dosui_scene, only: scene_t
  use dosui_semi_implicit, only: choose_semi_implicit_step, semi_implicit_t
  use dosui_setup, only: describe_model, finish_setup, seed_model, setup_model
  use dosui_signals, only: signal_received, signals_watch
  use dosui_text, only: to_text
  use dosui_topology, only: build_geometry, distribute, needs_rebuild, refresh_storage, &
                            refresh_weights
  use dosui_water_balance, only: balance_error, balance_sums
  implicit none
  private

  public :: run_scene

  integer, parameter, public :: status_finished = 0, status_failed = 1, status_bad_input = 2, &
                                status_stopped = 3   !! exit statuses
  integer, parameter, public :: to_run = 1, to_check = 2, to_find_safety = 3   !! purposes
  integer, parameter :: explicit_check_interval = 64  !! steps between looks at signals and NaN
  integer, parameter :: equilibrium_passes = 20       !! of updated scenes
  real(wp), parameter :: settled = 1.0e-12_wp         !! of the first displacements [-]
  real(wp), parameter :: pass_reduction = 1.0e-9_wp   !! of their residual [-]

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
    type(run_files_t) :: files
    type(error_t) :: err
    character(len=:), allocatable :: problems

    problems = ''
    call setup_model(model, comm, scene)
    call check_probes(scene%probe, result_fields(model), problems)
    if (len(restart) > 0) then
      call restore(model, files, restart, err)
    else
      call seed_model(model, problems, err)
    end if
    status = status_bad_input
    if (report(model, problems, err)) return
    call finish_setup(model, err)
    if (report(model, problems, err)) return
    call describe_model(model)
    status = status_finished
    if (purpose == to_check) then
      call say_step(model)
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
    call advance(model, files, len(restart) == 0, status, err)
    if (report(model, problems, err)) return
    call summarise(model, status)
  end subroutine run_scene

  subroutine say_step(model)
    !! The first time step, and what limits it.
    type(model_t), intent(inout) :: model

    if (model%integrator == 'quasi_static') return   ! it is chosen by its error
    if (model%integrator == 'semi_implicit') then
      call choose_semi_implicit_step(model)
    else
      call choose_explicit_step(model)
    end if
    call model%log%info('time step    '//to_text(model%clock%dt)//' s, limited by '// &
                        trim(model%clock%limit%name)//'; about '// &
                        to_text(nint(model%scene%time%end_time/model%clock%limit%dt, i8))//' steps')
  end subroutine say_step

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

  subroutine advance(model, files, from_start, status, err)
    !! The time loop.
    type(model_t), intent(inout) :: model
    type(run_files_t), intent(inout) :: files
    logical, intent(in) :: from_start
    integer, intent(out) :: status
    type(error_t), intent(inout) :: err
    real(wp) :: started, last_line, last_checkpoint
    integer :: first_step, check_interval
    type(quasi_static_t) :: quasi_static
    type(semi_implicit_t) :: semi_implicit
    type(error_t) :: write_error

    status = status_failed
    check_interval = merge(explicit_check_interval, 1, model%integrator == 'explicit')
    if (from_start .and. model%scene%time%geostatic_start .and. .not. model%rigid) then
      call geostatic_start(model, err)
      if (err%failed()) return
    end if
    if (model%integrator == 'quasi_static') call quasi_static%init(model, err)
    if (err%failed()) return
    if (from_start) then
      if (model%integrator == 'quasi_static') then
        call quasi_static%settle(model, err)
      else if (model%scene%time%undrained_start .and. .not. model%rigid) then
        call undrained_start(model, err)
      end if
      if (err%failed()) return
      call files%sample(model)
      call files%write_step(model, err)
      if (err%failed()) return
    end if
    started = wall_seconds()
    last_line = started
    last_checkpoint = started
    first_step = model%clock%step
    do while (.not. model%clock%finished())
      if (model%integrator == 'quasi_static') then
        call quasi_static%step(model, err)
      else
        call step(model, semi_implicit, err)
      end if
      if (mod(model%clock%step, check_interval) == 0 .or. model%clock%at_output()) then
        call check_state(model, err)
      end if
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
        call files%write_step(model, err)
        call model%timers%stop(model%phase%output)
        if (err%failed()) return
      end if
      if (model%clock%step >= model%scene%time%maximum_steps) exit
      if (mod(model%clock%step, check_interval) == 0) then
        call progress(model, started, first_step, last_line)
        if (model%comm%any(signal_received())) then
          call files%write_checkpoint(model, err)
          call files%close(model, err)
          call describe_solutions()
          call model%log%info('stopped by a signal at t = '//to_text(model%clock%time)// &
                              ' s; continue with --restart '//files%stem//'.restart.h5')
          status = status_stopped
          return
        end if
      end if
      call checkpoint_if_due(model, files, check_interval, last_checkpoint, err)
      if (err%failed()) return
    end do
    call describe_solutions()
    call files%write_step(model, err)   ! where maximum_steps ends a run; else it is there already
    if (.not. err%failed()) call files%close(model, err)
    if (.not. err%failed()) status = status_finished

  contains

    subroutine describe_solutions()
      !! Linear solutions of an implicit integrator.
      if (model%integrator == 'quasi_static') call model%log%info(quasi_static%describe())
      if (model%integrator == 'semi_implicit') call model%log%info(semi_implicit%describe())
    end subroutine describe_solutions
  end subroutine advance

  subroutine step(model, semi_implicit, err)
    !! One step with inertia: choose dt, advance, follow the particles.
    type(model_t), intent(inout) :: model
    type(semi_implicit_t), intent(inout) :: semi_implicit
    type(error_t), intent(inout) :: err

    if (model%integrator == 'semi_implicit') then
      call choose_semi_implicit_step(model)
      call semi_implicit%step(model, err)
      if (err%failed()) return
    else
      call choose_explicit_step(model)
      call explicit_step(model, .true., err)
    end if
    call model%clock%advance()
    if (model%updated) call keep_up(model, err)
  end subroutine step

  subroutine keep_up(model, err)
    !! After a step of an updated scene: grid, owners and neighbourhoods follow the particles.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    if (model%inverted > 0) then
      call err%set(describe_particle(model, 'has lost all its volume (J <= 0)', model%inverted))
    end if
    call model%comm%agree(err)   ! only in updated scenes can a single rank fail within a step
    if (err%failed()) return
    if (needs_rebuild(model)) then
      call rebuild(model, err)
    else
      call follow(model, err)
    end if
  end subroutine keep_up

  subroutine rebuild(model, err)
    !! Particles go to their owners, everything that depends on places is built anew. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call check_state(model, err)   ! a position that is no number would only seem to leave
    if (.not. err%failed()) call remove_leavers(model, err)
    if (.not. err%failed()) call distribute(model, err)
    if (.not. err%failed()) call build_geometry(model, err)
    call model%comm%agree(err)
  end subroutine rebuild

  subroutine follow(model, err)
    !! Cells, patches, cell volumes and storage of particles that moved within the grid.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer :: n_lost, n

    n = model%particles%count
    call model%grid%locate(n, model%particles%field(model%p%position)%values, model%patch, &
                           model%cell, n_lost)
    if (n_lost > 0) call err%set('particles moved out of the grid in one step at t = '// &
                                 to_text(model%clock%time)//' s: the run is unstable')
    call model%comm%agree(err)
    if (err%failed()) return
    call refresh_weights(model)
    if (model%coupled) call refresh_storage(model)
  end subroutine follow

  subroutine remove_leavers(model, err)
    !! Particles outside the scene's domain: an error, or removed and counted.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer, allocatable :: keep(:)
    logical, allocatable :: inside(:)
    integer :: p, n

    n = model%particles%count
    allocate (inside(n))
    do p = 1, n
      associate (x => model%particles%field(model%p%position)%values(:, p))
        inside(p) = all(x >= model%scene%domain_min .and. x <= model%scene%domain_max)
      end associate
    end do
    if (.not. model%comm%any(.not. all(inside))) return
    if (model%scene%leaving_particles == 'stop') then
      if (.not. all(inside)) then
        call err%set(describe_particle(model, 'left the domain', findloc(inside, .false., dim=1)))
      end if
      call model%comm%agree(err)
      return
    end if
    model%removed = model%removed + model%comm%sum(int(count(.not. inside), i8))
    keep = pack([(p, p=1, n)], inside)
    model%particles%count = size(keep)
    call model%particles%reorder(keep)
    call model%log%warning('particles left the domain and were removed: '// &
                           to_text(model%removed)//' so far')
  end subroutine remove_leavers

  subroutine write_last_state(model, files, err)
    !! Before a run stops with an error: its state, if all of it is numbers. Collective.
    type(model_t), intent(inout) :: model
    type(run_files_t), intent(inout) :: files
    type(error_t), intent(inout) :: err

    if (model%comm%all(first_unsound(model) == 0)) call files%write_step(model, err)
  end subroutine write_last_state

  subroutine check_state(model, err)
    !! Stops all ranks when a particle's state is not a number. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer :: p

    p = first_unsound(model)
    if (p > 0) call err%set(describe_particle(model, 'has a state that is not a finite number', p))
    call model%comm%agree(err)
  end subroutine check_state

  integer function first_unsound(model) result(p)
    !! The first of this rank's particles whose state is not finite; 0: none.
    type(model_t), intent(in) :: model

    do p = 1, model%particles%count
      if (.not. is_sound(model, p)) return
    end do
    p = 0
  end function first_unsound

  logical function is_sound(model, p) result(sound)
    !! Are velocity, stress and pressure of a particle finite?
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp) :: largest

    associate (field => model%particles%field, h => model%p)
      largest = huge(1.0_wp)
      sound = all(abs(field(h%velocity)%values(:, p)) <= largest) .and. &
              all(abs(field(h%effective_stress)%values(:, p)) <= largest)
      if (h%pore_pressure > 0) sound = sound .and. &
                                       abs(field(h%pore_pressure)%values(1, p)) <= largest
    end associate
  end function is_sound

  function describe_particle(model, what, p) result(text)
    !! Step, time, identity and position of a particle in trouble.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: what
    integer, intent(in) :: p
    character(len=:), allocatable :: text
    integer :: d

    text = 'particle '//to_text(model%particles%id(p))//' '//what//' in step '// &
           to_text(model%clock%step)//', t = '//to_text(model%clock%time)//' s, at ('
    do d = 1, ndim
      text = text//to_text(model%particles%field(model%p%position)%values(d, p))// &
             merge(') m', ',  ', d == ndim)
    end do
  end function describe_particle

  subroutine geostatic_start(model, err)
    !! Effective stresses in equilibrium with weight, loads and pore pressures before the clock
    !! starts. The body is where it shall be, so what has moved on the way is forgotten, but for
    !! the springs of penalty walls.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer :: n_iteration
    logical :: stands

    n_iteration = 0
    call find_geostatic_equilibrium(model, n_iteration, stands, err)
    if (.not. (stands .or. err%failed())) then
      call err%set('the geostatic start found no equilibrium: the soils cannot carry the loads '// &
                   '(dosui --safety finds by how much)')
    end if
    if (err%failed()) return
    model%particles%field(model%p%displacement)%values = 0.0_wp
    associate (displacement => model%surface%field(model%s%displacement)%values, &
               m => model%surface%count)
      if (model%finite) then
        displacement = 0.0_wp
      else
        call model%surface_forces%forget(model%scene%mechanical_condition, displacement(:, 1:m))
      end if
    end associate
    call model%log%info('geostatic equilibrium after '//to_text(n_iteration)//' iterations')
  end subroutine geostatic_start

  subroutine undrained_start(model, err)
    !! Undrained equilibrium under the loads at t = 0, before the clock starts. In updated scenes
    !! the particles then move, and the equilibrium is sought again where they are.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: before(:, :), before_surface(:, :)
    real(wp) :: first
    integer :: pass, n_iteration, last_iteration

    first = -1.0_wp
    n_iteration = 0
    do pass = 1, equilibrium_passes
      last_iteration = n_iteration
      before = model%particles%field(model%p%displacement)%values(:, 1:model%particles%count)
      before_surface = model%surface%field(model%s%displacement)%values(:, 1:model%surface%count)
      if (model%integrator == 'explicit') then
        call find_equilibrium(model, merge(pass_reduction, 0.0_wp, model%updated), n_iteration, &
                              first, err)
      else
        call solve_equilibrium(model, before, n_iteration, first, err)
      end if
      if (err%failed()) return
      if (.not. model%updated .or. n_iteration == last_iteration) exit
      call move_by(model%particles, model%p%position, model%p%displacement, before)
      call move_by(model%surface, model%s%position, model%s%displacement, before_surface)
      call rebuild(model, err)
      if (err%failed()) return
    end do
    call model%log%info('undrained equilibrium after '//to_text(n_iteration)//' iterations')
    if (pass > equilibrium_passes) then
      call model%log%warning('undrained equilibrium: moving the particles still disturbs it '// &
                             'after '//to_text(equilibrium_passes)//' passes')
    end if
  end subroutine undrained_start

  subroutine solve_equilibrium(model, before, n_solution, first, err)
    !! Undrained equilibrium by one implicit solution. It counts while displacements still change.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: before(:, :)      !! displacements [m]
    integer, intent(inout) :: n_solution      !! that changed anything
    real(wp), intent(inout) :: first          !! the first of these changes [m]; < 0: none yet
    type(error_t), intent(inout) :: err
    type(quasi_static_t) :: solver
    real(wp) :: change

    call solver%init(model, err)
    if (.not. err%failed()) call solver%settle(model, err)
    if (err%failed()) return
    change = 0.0_wp
    associate (displacement => model%particles%field(model%p%displacement)%values, &
               n => model%particles%count)
      if (n > 0) change = maxval(abs(displacement(:, 1:n) - before))
    end associate
    change = model%comm%maximum(change)
    if (first < 0.0_wp) first = change
    if (change > settled*first) n_solution = n_solution + 1
  end subroutine solve_equilibrium

  pure subroutine move_by(set, position, displacement, before)
    !! Moves points by what their displacements have grown.
    type(point_set_t), intent(inout) :: set
    integer, intent(in) :: position, displacement   !! fields
    real(wp), intent(in) :: before(:, :)            !! displacements at the last position [m]
    integer :: p

    do p = 1, set%count
      set%field(position)%values(:, p) = set%field(position)%values(:, p) + &
                                         set%field(displacement)%values(:, p) - before(:, p)
    end do
  end subroutine move_by

  subroutine checkpoint_if_due(model, files, check_interval, last, err)
    !! Writes a checkpoint every so many steps or minutes. Collective.
    type(model_t), intent(inout) :: model
    type(run_files_t), intent(inout) :: files
    integer, intent(in) :: check_interval   !! steps between looks at the wall clock
    real(wp), intent(inout) :: last         !! wall clock of the last one [s]
    type(error_t), intent(inout) :: err
    logical :: due

    due = .false.
    if (model%scene%output%checkpoint_steps > 0) then
      due = mod(model%clock%step, model%scene%output%checkpoint_steps) == 0
    end if
    if (model%scene%output%checkpoint_minutes > 0.0_wp .and. &
        mod(model%clock%step, check_interval) == 0) then
      due = due .or. model%comm%any(wall_seconds() - last > &
                                    60.0_wp*model%scene%output%checkpoint_minutes)
    end if
    if (.not. due) return
    last = wall_seconds()
    call files%write_checkpoint(model, err)
  end subroutine checkpoint_if_due

  subroutine progress(model, started, first_step, last_line)
    !! A line now and then: step, time, dt and what limits it, rate, time to go.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: started
    integer, intent(in) :: first_step
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

  subroutine summarise(model, status)
    !! Closing summary: time per phase over the ranks, particle-steps per second, warnings.
    type(model_t), intent(inout) :: model
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
    if (model%clock%step > 0 .and. total > 0.0_wp) then
      call model%log%info('particle-steps per second '// &
                          to_text(real(n, wp)*real(model%clock%step, wp)/total, 3)// &
                          ', rebuilds '//to_text(model%rebuilds))
    end if
    if (model%coupled) call say_balance(model)
    if (model%removed > 0_i8) call model%log%info('particles removed '//to_text(model%removed))
    call model%log%summary()
  end subroutine summarise

  subroutine say_balance(model)
    !! The water's balance over the whole run. Collective.
    type(model_t), intent(in) :: model
    real(wp), allocatable :: sums(:)

    call balance_sums(model, sums)
    call model%log%info('water stored '//to_text(sums(1), 4)//' m3 = inflow '// &
                        to_text(sums(2), 4)//' + squeezed out of pores '//to_text(sums(3), 4)// &
                        ', missing '//to_text(100.0_wp*balance_error(sums), 2)//' %')
  end subroutine say_balance

  function column(seconds) result(text)
    !! A number in a column of the summary.
    real(wp), intent(in) :: seconds
    character(len=11) :: text

    write (text, '(f11.3)') seconds
  end function column
end module dosui_simulation

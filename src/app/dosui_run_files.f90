!! The files of a run: result file, histories and checkpoints.
module dosui_run_files
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_build_info, only: compiler, flags, git_hash, version
  use dosui_checkpoint, only: checkpoint_reader_t, checkpoint_writer_t
  use dosui_error, only: error_t
  use dosui_history, only: history_t
  use dosui_history_quantities, only: quantities_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_model, only: model_t
  use dosui_result_fields, only: field_values, points_in_space, result_fields
  use dosui_result_file, only: result_field_t, result_file_t, result_layout_t
  use dosui_scene_record, only: compare_records, write_record
  use dosui_text, only: to_text
  implicit none
  private

  public :: checkpoint_path

  integer, parameter :: step_digits = 10      !! in the names of checkpoints that are kept
  integer, parameter :: default_rows = 1000   !! of explicit runs whose scene gives no interval
  real(wp), parameter :: early_growth = 1.1_wp   !! of the time between their first rows [-]
  integer(i8), parameter :: many_steps = 100000_i8   !! implicit runs have no row for each after it
  integer(i8), parameter :: first_room = 16384_i8   !! rows there is room for at the start, at most

  type, public :: run_files_t
    !! Open files and waiting history rows of a run.
    type(result_file_t) :: result
    type(history_t) :: history
    character(len=:), allocatable :: stem      !! directory and name without suffix
    real(wp), allocatable :: memory(:)         !! the integrator's, as read [several units]
    character(len=:), allocatable, private :: record   !! of the scene, for checkpoints
    real(wp) :: history_interval = 0.0_wp      !! [s]
    real(wp) :: next_history = 0.0_wp          !! [s]
    logical, private :: is_given = .true.      !! the interval is the scene's
    logical, private :: every_step = .false.   !! as many rows as steps
    integer(i8), private :: stride = 1_i8      !! steps a row of these
  contains
    procedure :: open => run_files_open
    procedure :: write_step => run_files_write_step
    procedure :: sample => run_files_sample
    procedure :: checkpoint_path => run_files_checkpoint_path
    procedure :: write_checkpoint => run_files_write_checkpoint
    procedure :: read_checkpoint => run_files_read_checkpoint
    procedure :: close => run_files_close
  end type run_files_t

contains

  subroutine run_files_open(self, model, stem, restarted, err)
    !! Creates the result file, or continues the one of an interrupted run. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: stem
    logical, intent(in) :: restarted
    type(error_t), intent(inout) :: err
    type(result_layout_t) :: layout
    logical :: exists

    self%stem = stem
    self%history_interval = model%scene%output%history_interval
    if (.not. self%history_interval > 0.0_wp) then
      self%history_interval = model%scene%time%end_time/real(default_rows, wp)
      self%is_given = .false.
      self%every_step = model%traits%solves_water
    end if
    self%stride = stride_at(model%clock%step)
    if (restarted) self%next_history = min(self%next_history, next_row(self, model%clock%time))
    call tell_next_row(self, model)
    call define_history(self%history, model, err)
    layout%n_step_max = size(model%clock%output_time) + 2
    layout%n_point = model%comm%sum(int(model%particles%count, i8)) + model%decomposition%removed
    layout%field = result_fields(model)
    layout%history = self%history%column
    layout%history_capacity = int(min(real(first_room, wp), &
                                      model%scene%time%end_time/self%history_interval), i8) + 256_i8
    layout%scene_text = model%scene%text
    layout%scene_echo = model%scene%echo
    call add_metadata(layout)
    inquire (file=stem//'.vtkhdf', exist=exists)
    exists = model%comm%all(exists)
    if (restarted .and. exists) then
      call self%result%open_existing(model%comm, stem//'.vtkhdf', model%clock%time, layout, err)
    else
      call self%result%create(model%comm, stem//'.vtkhdf', layout, err)
    end if
    call model%comm%agree(err)
  end subroutine run_files_open

  subroutine add_metadata(layout)
    !! Where a result comes from.
    type(result_layout_t), intent(inout) :: layout

    allocate (layout%metadata_name(4), layout%metadata_value(4))
    layout%metadata_name = [character(len=64) :: 'version', 'git_hash', 'compiler', 'flags']
    layout%metadata_value(1) = version
    layout%metadata_value(2) = git_hash
    layout%metadata_value(3) = compiler
    layout%metadata_value(4) = flags
  end subroutine add_metadata

  subroutine define_history(history, model, err)
    !! Columns of the histories.
    type(history_t), intent(inout) :: history
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(quantities_t) :: quantities
    integer :: column, k

    call quantities%find(model, .false.)
    do k = 1, quantities%n
      call history%add_column(trim(quantities%column(k)%name), trim(quantities%column(k)%unit), &
                              column, err)
    end do
  end subroutine define_history

  pure real(wp) function next_row(self, time) result(next)
    !! When the histories get a row after a time [s]. Rows of explicit runs are dense at the start.
    class(run_files_t), intent(in) :: self
    real(wp), intent(in) :: time   !! [s]
    real(wp) :: intervals

    next = 0.0_wp
    if (self%every_step) return
    intervals = aint(time/self%history_interval*(1.0_wp + 1.0e-12_wp))
    next = (intervals + 1.0_wp)*self%history_interval
    if (.not. self%is_given) next = min(next, early_growth*time)
  end function next_row

  pure integer(i8) function stride_at(step) result(stride)
    !! Steps between rows of implicit runs: 1 up to many steps, and twice as many whenever the
    !! number of steps has doubled.
    integer(i8), intent(in) :: step

    stride = 1_i8
    do while (step >= stride*many_steps)
      stride = 2_i8*stride
    end do
  end function stride_at

  subroutine tell_next_row(self, model)
    !! Lets the integrators know which step has the next row.
    class(run_files_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    integer(i8) :: step

    model%reactions%next_time = self%next_history
    model%reactions%next_step = 0_i8
    if (.not. self%every_step) return
    step = model%clock%step
    model%reactions%next_step = (step/self%stride + 1_i8)*self%stride
    if (step == 0_i8) model%reactions%next_step = 0_i8   ! nothing is known yet about the start
  end subroutine tell_next_row

  logical function has_row(self, model)
    !! Has the time of the next row come?
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    integer(i8) :: step

    step = model%clock%step
    if (self%every_step) then
      has_row = mod(step, self%stride) == 0_i8
      if (.not. has_row) return
      if (stride_at(step) > self%stride) then
        self%stride = stride_at(step)
        call model%log%info('histories    from step '//to_text(step)//' on only every '// &
                            to_text(self%stride)//'th step has a row; history_interval chooses')
      end if
    else
      has_row = .not. model%clock%time < self%next_history*(1.0_wp - 1.0e-12_wp)
    end if
  end function has_row

  subroutine run_files_sample(self, model)
    !! Adds a row to the histories when its time has come. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(quantities_t) :: quantities

    if (.not. has_row(self, model)) return
    self%next_history = next_row(self, model%clock%time)
    call tell_next_row(self, model)
    call quantities%find(model, .true.)
    if (model%comm%is_root()) call self%history%append(quantities%value(:quantities%n))
  end subroutine run_files_sample

  subroutine run_files_write_step(self, model, err)
    !! Writes all fields and the waiting histories. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(result_field_t), allocatable :: fields(:)
    real(wp), allocatable :: values(:, :)
    logical :: is_new
    integer :: k, n

    n = model%particles%count
    call self%result%write_history(model%comm, self%history, err)
    call model%comm%agree(err)
    if (err%failed()) return
    call self%result%begin_step(model%comm, model%clock%time, n, model%particles%id(1:n), &
                                points_in_space(model), is_new, err)
    call model%comm%agree(err)
    if (err%failed() .or. .not. is_new) return
    fields = result_fields(model)
    do k = 1, size(fields)
      call field_values(model, trim(fields(k)%name), values)
      call self%result%write_field(model%comm, k, n, values, err)
    end do
    call self%result%end_step(model%comm, err)
    call model%comm%agree(err)
  end subroutine run_files_write_step

  pure function run_files_checkpoint_path(self) result(path)
    !! Where the last checkpoint is.
    class(run_files_t), intent(in) :: self
    character(len=:), allocatable :: path

    path = checkpoint_path(self%stem)
  end function run_files_checkpoint_path

  pure function checkpoint_path(stem) result(path)
    !! The last checkpoint of a run whose files begin with `stem`.
    character(len=*), intent(in) :: stem
    character(len=:), allocatable :: path

    path = stem//'.restart.h5'
  end function checkpoint_path

  subroutine run_files_write_checkpoint(self, model, memory, err, is_kept)
    !! Writes what a restart needs. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: memory(:)          !! of the integrator [several units]
    type(error_t), intent(inout) :: err
    logical, intent(in), optional :: is_kept   !! under a name of its own, with the step
    type(checkpoint_writer_t) :: writer
    character(len=:), allocatable :: path
    logical :: keeps_previous

    call self%result%write_history(model%comm, self%history, err)   ! a restart keeps no rows
    call model%comm%agree(err)
    if (err%failed()) return
    path = self%checkpoint_path()
    keeps_previous = .true.
    if (present(is_kept)) keeps_previous = .not. is_kept
    if (.not. keeps_previous) path = kept_path(self%stem, model)
    call take_record(self, model)
    call writer%begin(model%comm, path, model%scene%text, git_hash, err, self%record, &
                      keeps_previous)
    call writer%write_values(model%comm, 'clock', &
                             [model%clock%time, real(model%clock%step, wp), &
                              real(model%clock%output, wp), self%next_history, &
                              model%decomposition%movement, &
                              real(model%decomposition%removed, wp), &
                              real(model%decomposition%brick_edge, wp), &
                              model%scales%density, model%next_dt, &
                              model%scales%pressure_scale], err)
    call writer%write_values(model%comm, 'integrator', memory, err)
    call writer%write_of_ranks(model%comm, 'balance', balance_of_rank(model), err)
    call writer%write_values(model%comm, 'bricks', brick_table(model), err)
    call writer%write_set(model%comm, 'particles', model%particles, err)
    call writer%write_set(model%comm, 'surface', model%surface, err)
    call writer%finish(model%comm, err)
    call model%comm%agree(err)
  end subroutine run_files_write_checkpoint

  pure function kept_path(stem, model) result(path)
    !! Where a checkpoint that is kept goes; the names sort by the step.
    character(len=*), intent(in) :: stem
    type(model_t), intent(in) :: model
    character(len=:), allocatable :: path
    character(len=:), allocatable :: step

    step = to_text(model%clock%step)
    path = stem//'.restart.'//repeat('0', max(0, step_digits - len(step)))//step//'.h5'
  end function kept_path

  subroutine take_record(self, model)
    !! Makes the record of the scene, once.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(in) :: model

    if (.not. allocated(self%record)) call write_record(model%scene, self%record)
  end subroutine take_record

  pure function balance_of_rank(model) result(values)
    !! This rank's running sums, so that they go on bit by bit.
    type(model_t), intent(in) :: model
    real(wp), allocatable :: values(:)

    associate (balance => model%balance)
      values = [balance%stored, balance%squeezed, balance%wall_impulse, balance%lost_impulse, &
                balance%moved, balance%noise, balance%inflow]
    end associate
  end function balance_of_rank

  pure subroutine take_balance(model, values)
    !! Running sums from a checkpoint.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: values(:)   !! as from `balance_of_rank`

    associate (balance => model%balance)
      balance%stored = values(1)
      balance%squeezed = values(2)
      balance%wall_impulse = values(3:2 + ndim)
      balance%lost_impulse = values(3 + ndim:2 + 2*ndim)
      balance%moved = values(3 + 2*ndim)
      balance%noise = values(4 + 2*ndim)
      balance%inflow = values(5 + 2*ndim:)
    end associate
  end subroutine take_balance

  subroutine run_files_read_checkpoint(self, model, path, same_ranks, err)
    !! Reads a checkpoint of the same scene into a model whose fields are registered. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: path
    logical, intent(out) :: same_ranks
    type(error_t), intent(inout) :: err
    type(checkpoint_reader_t) :: reader
    real(wp), allocatable :: clock(:), bricks(:), balance(:)

    same_ranks = .false.
    call reader%begin(model%comm, path, err)
    if (.not. err%failed()) call reader%read_values(model%comm, 'clock', clock, err)
    if (.not. err%failed()) call compare_scenes(self, model, reader, path, clock(1), err)
    if (.not. err%failed()) call reader%read_values(model%comm, 'integrator', self%memory, err)
    if (.not. err%failed()) call reader%read_of_ranks(model%comm, 'balance', balance, err)
    if (.not. err%failed()) call reader%read_values(model%comm, 'bricks', bricks, err)
    if (.not. err%failed()) call reader%read_set(model%comm, 'particles', model%particles, err)
    if (.not. err%failed()) call reader%read_set(model%comm, 'surface', model%surface, err)
    call model%comm%agree(err)
    if (err%failed()) return
    same_ranks = reader%same_ranks
    call reader%finish(model%comm, err)
    model%clock%time = clock(1)
    model%clock%step = nint(clock(2), i8)
    model%clock%output = count(model%clock%output_time <= clock(1)*(1.0_wp + 1.0e-12_wp))
    self%next_history = clock(4)
    model%decomposition%movement = clock(5)
    model%decomposition%removed = int(clock(6), i8)
    model%decomposition%brick_edge = nint(clock(7))
    model%scales%density = clock(8)
    model%next_dt = clock(9)
    model%scales%pressure_scale = clock(10)
    call take_balance(model, balance)
    if (same_ranks) call take_bricks(model, bricks)
  end subroutine run_files_read_checkpoint

  subroutine compare_scenes(self, model, reader, path, time, err)
    !! Refuses a checkpoint of another scene; says what has changed that may.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    type(checkpoint_reader_t), intent(in) :: reader
    character(len=*), intent(in) :: path
    real(wp), intent(in) :: time   !! of the checkpoint [s]
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: refused, changed

    call take_record(self, model)
    call compare_records(reader%record, self%record, time, refused, changed)
    if (len(refused) > 0) then
      if (index(refused, '&scene integrator:') > 0 .and. model%scene%choice%is_automatic) then
        refused = refused//new_line('a')//'  (integrator = ''auto'' chooses anew: '// &
                  model%scene%choice%reason//'; name that of the checkpoint to go on with it)'
      end if
      call err%set('the checkpoint '//path//' is of another scene (docs/restart.md lists what '// &
                   'may change); in the checkpoint -> in the scene:'//new_line('a')//refused)
    else if (len(changed) > 0) then
      call model%log%info('changed at the restart; in the checkpoint -> in the scene:'// &
                          new_line('a')//changed)
    end if
    if (reader%git_hash /= git_hash) then
      call model%log%info('the checkpoint is of another build of dosui: '//reader%git_hash// &
                          ', this is '//git_hash)
    end if
  end subroutine compare_scenes

  function brick_table(model) result(table)
    !! The owners of bricks as numbers that a double holds exactly: coordinates and rank.
    type(model_t), intent(in) :: model
    real(wp), allocatable :: table(:)
    integer :: k

    table = [model%decomposition%partition%imbalance, &
             (real(unpack_key(model%decomposition%brick_key(k)), wp), &
              real(model%decomposition%brick_rank(k), wp), &
              k=1, size(model%decomposition%brick_key))]
  end function brick_table

  subroutine take_bricks(model, table)
    !! Owners of bricks from a checkpoint.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: table(:)
    integer :: k, n

    n = (size(table) - 1)/4
    model%decomposition%partition%imbalance = table(1)
    model%decomposition%partition%n_brick = n
    model%decomposition%brick_key = [(pack_key(nint(table(4*k - 2:4*k))), k=1, n)]
    model%decomposition%brick_rank = [(nint(table(4*k + 1)), k=1, n)]
  end subroutine take_bricks

  subroutine run_files_close(self, model, err)
    !! Ends the result file. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call self%result%write_history(model%comm, self%history, err)
    call self%result%close(model%comm, err)
    call model%comm%agree(err)
  end subroutine run_files_close
end module dosui_run_files

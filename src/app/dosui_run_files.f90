!! The files of a run: result file, histories and checkpoints.
module dosui_run_files
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: axis, ndim
  use dosui_build_info, only: compiler, flags, git_hash, version
  use dosui_checkpoint, only: checkpoint_reader_t, checkpoint_writer_t
  use dosui_error, only: error_t
  use dosui_history, only: history_t
  use dosui_keys, only: pack_key, unpack_key
  use dosui_model, only: model_t
  use dosui_probes, only: add_probe_columns, probe_value
  use dosui_result_fields, only: field_values, points_in_space, result_fields
  use dosui_result_file, only: result_field_t, result_file_t, result_layout_t
  use dosui_surface_renewal, only: free_area
  use dosui_water_balance, only: balance_error, balance_sums, n_scale
  implicit none
  private

  integer, parameter :: default_rows = 1000   !! history entries when the scene gives no interval

  character(len=1), parameter :: axis_name(3) = ['x', 'y', 'z']

  type, public :: run_files_t
    !! Open files and waiting history rows of a run.
    type(result_file_t) :: result
    type(history_t) :: history
    character(len=:), allocatable :: stem      !! directory and name without suffix
    real(wp) :: history_interval = 0.0_wp      !! [s]
    real(wp) :: next_history = 0.0_wp          !! [s]
  contains
    procedure :: open => run_files_open
    procedure :: write_step => run_files_write_step
    procedure :: sample => run_files_sample
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
    end if
    call define_history(self%history, model, err)
    layout%n_step_max = size(model%clock%output_time) + 2
    layout%n_point = model%comm%sum(int(model%particles%count, i8)) + model%removed
    layout%field = result_fields(model)
    layout%history = self%history%column
    layout%history_capacity = int(model%scene%time%end_time/self%history_interval, i8) + &
                              2_i8*size(model%clock%output_time) + 16_i8
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
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err
    integer :: column, c

    call history%add_column('time', 's', column, err)
    call history%add_column('dt', 's', column, err)
    call history%add_column('step', '', column, err)
    call history%add_column('particles', '', column, err)
    call history%add_column('mass', 'kg', column, err)
    call history%add_column('kinetic_energy', 'J', column, err)
    if (model%coupled) then
      call history%add_column('water_stored', 'm3', column, err)
      call history%add_column('water_inflow', 'm3', column, err)
      call history%add_column('water_squeezed', 'm3', column, err)
      call history%add_column('water_balance_error', '', column, err)
      do c = 1, size(model%scene%hydraulic_condition)
        call history%add_column('inflow_'//trim(model%scene%hydraulic_condition(c)%surface), &
                                'm3', column, err)
      end do
      if (model%sources%has_water) call history%add_column('inflow_sources', 'm3', column, err)
    end if
    if (allocated(model%scene%rigid_wall)) then
      do c = 1, ndim
        call history%add_column('momentum_'//axis_name(axis(c)), 'kg m/s', column, err)
      end do
      do c = 1, ndim
        call history%add_column('impulse_walls_'//axis_name(axis(c)), 'N s', column, err)
      end do
      do c = 1, ndim
        call history%add_column('impulse_lost_'//axis_name(axis(c)), 'N s', column, err)
      end do
    end if
    do c = 1, size(model%scene%surface)
      if (.not. has_area(model, c)) cycle
      call history%add_column('area_'//trim(model%scene%surface(c)%name), 'm2', column, err)
    end do
    call add_probe_columns(model%scene%probe, &
                           result_fields(model), history, err)
  end subroutine define_history

  pure logical function has_area(model, surface)
    !! Is the area of a surface among the histories?
    type(model_t), intent(in) :: model
    integer, intent(in) :: surface

    has_area = model%finds_surface .and. model%scene%surface(surface)%face == 'free'
  end function has_area

  function momenta(model) result(sums)
    !! Momentum of the bodies [kg m/s], then impulses that rigid walls have given them and
    !! that were lost at almost massless nodes [N s]. Collective.
    type(model_t), intent(in) :: model
    real(wp) :: sums(3*ndim)
    integer :: p

    sums(:ndim) = 0.0_wp
    sums(ndim + 1:) = [model%balance%wall_impulse, model%balance%lost_impulse]
    associate (field => model%particles%field, h => model%p)
      do p = 1, model%particles%count
        sums(:ndim) = sums(:ndim) + field(h%mass)%values(1, p)*field(h%velocity)%values(:, p)
      end do
    end associate
    call model%comm%sum_array(sums)
  end function momenta

  subroutine run_files_sample(self, model)
    !! Adds a row to the histories when its time has come. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: row(:), sums(:), water(:)
    real(wp) :: intervals
    integer :: k, p

    if (model%clock%time < self%next_history*(1.0_wp - 1.0e-12_wp)) return
    intervals = aint(model%clock%time/self%history_interval*(1.0_wp + 1.0e-12_wp))
    self%next_history = (intervals + 1.0_wp)*self%history_interval
    sums = [0.0_wp, 0.0_wp, 0.0_wp]
    associate (field => model%particles%field, h => model%p)
      sums(1) = real(model%particles%count, wp)
      do p = 1, model%particles%count
        sums(2) = sums(2) + field(h%mass)%values(1, p)/model%scene%mechanics%density_scaling
        sums(3) = sums(3) + 0.5_wp*field(h%mass)%values(1, p)* &
                  sum(field(h%velocity)%values(:, p)**2)
      end do
    end associate
    call model%comm%sum_array(sums)
    row = [model%clock%time, model%clock%dt, real(model%clock%step, wp), sums(1:3)]
    if (model%coupled) then
      call balance_sums(model, water)
      k = size(water) - n_scale - merge(0, 1, model%sources%has_water)
      row = [row, water(1:3), balance_error(water), water(4:k)]
    end if
    if (allocated(model%scene%rigid_wall)) row = [row, momenta(model)]
    do k = 1, size(model%scene%surface)
      if (has_area(model, k)) row = [row, free_area(model, k)]
    end do
    row = [row, (probe_value(model, model%scene%probe(k)), k=1, size(model%scene%probe))]
    if (model%comm%is_root()) call self%history%append(row)
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

  subroutine run_files_write_checkpoint(self, model, err)
    !! Writes what a restart needs. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(checkpoint_writer_t) :: writer
    real(wp), allocatable :: balance(:), impulse(:)

    call self%result%write_history(model%comm, self%history, err)   ! a restart keeps no rows
    call writer%begin(model%comm, self%stem//'.restart.h5', model%scene%text, git_hash, err)
    call writer%write_values(model%comm, 'clock', &
                             [model%clock%time, real(model%clock%step, wp), &
                              real(model%clock%output, wp), self%next_history, model%movement, &
                              real(model%removed, wp), real(model%brick_edge, wp), &
                              model%density, model%next_dt, model%pressure_scale], err)
    call balance_sums(model, balance)
    call writer%write_values(model%comm, 'balance', balance, err)
    if (allocated(model%scene%rigid_wall)) then
      impulse = momenta(model)
      call writer%write_values(model%comm, 'wall_impulse', impulse(ndim + 1:), err)
    end if
    call writer%write_values(model%comm, 'bricks', brick_table(model), err)
    call writer%write_set(model%comm, 'particles', model%particles, err)
    call writer%write_set(model%comm, 'surface', model%surface, err)
    call writer%finish(model%comm, err)
    call model%comm%agree(err)
  end subroutine run_files_write_checkpoint

  subroutine run_files_read_checkpoint(self, model, path, same_ranks, err)
    !! Reads a checkpoint into a model whose fields are registered. Collective.
    class(run_files_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: path
    logical, intent(out) :: same_ranks
    type(error_t), intent(inout) :: err
    type(checkpoint_reader_t) :: reader
    real(wp), allocatable :: clock(:), bricks(:), balance(:), impulse(:)

    same_ranks = .false.
    call reader%begin(model%comm, path, err)
    if (.not. err%failed()) call reader%read_values(model%comm, 'clock', clock, err)
    if (.not. err%failed()) call reader%read_values(model%comm, 'balance', balance, err)
    if (allocated(model%scene%rigid_wall) .and. .not. err%failed()) then
      call reader%read_values(model%comm, 'wall_impulse', impulse, err)
    end if
    if (.not. err%failed()) call reader%read_values(model%comm, 'bricks', bricks, err)
    if (.not. err%failed()) call reader%read_set(model%comm, 'particles', model%particles, err)
    if (.not. err%failed()) call reader%read_set(model%comm, 'surface', model%surface, err)
    call model%comm%agree(err)
    if (err%failed()) return
    same_ranks = reader%same_ranks
    call reader%finish(model%comm, err)
    model%clock%time = clock(1)
    model%clock%step = nint(clock(2))
    model%clock%output = count(model%clock%output_time <= clock(1)*(1.0_wp + 1.0e-12_wp))
    self%next_history = clock(4)
    model%movement = clock(5)
    model%removed = int(clock(6), i8)
    model%brick_edge = nint(clock(7))
    model%density = clock(8)
    model%next_dt = clock(9)
    model%pressure_scale = clock(10)
    if (same_ranks) call take_bricks(model, bricks)
    if (.not. model%comm%is_root()) return
    model%balance%stored = balance(1)
    model%balance%squeezed = balance(3)
    model%balance%inflow = balance(4:size(balance) - n_scale + 1)
    model%balance%moved = balance(size(balance) - 1)
    model%balance%noise = balance(size(balance))
    if (allocated(impulse)) then
      model%balance%wall_impulse = impulse(:ndim)
      model%balance%lost_impulse = impulse(ndim + 1:)
    end if
  end subroutine run_files_read_checkpoint

  function brick_table(model) result(table)
    !! The owners of bricks as numbers that a double holds exactly: coordinates and rank.
    type(model_t), intent(in) :: model
    real(wp), allocatable :: table(:)
    integer :: k

    table = [model%partition%imbalance, &
             (real(unpack_key(model%brick_key(k)), wp), real(model%brick_rank(k), wp), &
              k=1, size(model%brick_key))]
  end function brick_table

  subroutine take_bricks(model, table)
    !! Owners of bricks from a checkpoint.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: table(:)
    integer :: k, n

    n = (size(table) - 1)/4
    model%partition%imbalance = table(1)
    model%partition%n_brick = n
    model%brick_key = [(pack_key(nint(table(4*k - 2:4*k))), k=1, n)]
    model%brick_rank = [(nint(table(4*k + 1)), k=1, n)]
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

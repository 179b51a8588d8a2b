!! What the histories of a run hold: one list of names, units and values.
module dosui_history_quantities
  use dosui_kinds, only: wp
  use dosui_dimension, only: axis, ndim
  use dosui_force_balance, only: force_row
  use dosui_history, only: history_column_t
  use dosui_model, only: model_t
  use dosui_probes, only: probe_unit, probe_value
  use dosui_reactions, only: moment_axis, n_moment
  use dosui_result_fields, only: result_fields
  use dosui_result_file, only: result_field_t
  use dosui_scene, only: axis_name
  use dosui_surface_renewal, only: free_area
  use dosui_text, only: to_text
  use dosui_water_balance, only: balance_error, balance_sums, n_scale
  implicit none
  private

  type, public :: quantities_t
    !! The quantities of a scene in the order of their columns, at one time.
    integer :: n = 0
    type(history_column_t), allocatable :: column(:)   !! names and units, n or more
    real(wp), allocatable :: value(:)                  !! likewise [units of the columns]
    logical, private :: has_values = .false.
  contains
    procedure :: find => quantities_find
    procedure, private :: add
  end type quantities_t

contains

  subroutine quantities_find(self, model, has_values)
    !! Lists all quantities. Collective with values.
    class(quantities_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    logical, intent(in) :: has_values   !! .false.: names and units only
    integer :: k

    self%n = 0
    self%has_values = has_values
    call add_run(self, model)
    if (model%coupled) call add_water(self, model)
    if (allocated(model%scene%rigid_wall)) call add_momenta(self, model)
    if (model%reactions%n > 0) call add_forces(self, model)
    do k = 1, size(model%scene%surface)
      if (model%finds_surface .and. model%scene%surface(k)%face == 'free') then
        call add_free_area(self, model, k)
      end if
    end do
    call add_probes(self, model)
  end subroutine quantities_find

  subroutine add(self, name, unit, value)
    !! One more.
    class(quantities_t), intent(inout) :: self
    character(len=*), intent(in) :: name, unit
    real(wp), intent(in) :: value
    type(history_column_t), allocatable :: more(:)
    real(wp), allocatable :: more_values(:)
    integer :: room

    room = 0
    if (allocated(self%value)) room = size(self%value)
    if (self%n == room) then
      allocate (more(2*room + 16), more_values(2*room + 16))
      if (room > 0) more(:room) = self%column
      if (room > 0) more_values(:room) = self%value
      call move_alloc(more, self%column)
      call move_alloc(more_values, self%value)
    end if
    self%n = self%n + 1
    self%column(self%n) = history_column_t(name, unit)
    self%value(self%n) = value
  end subroutine add

  subroutine add_run(list, model)
    !! Time, step and the particles' sums.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(in) :: model
    real(wp) :: sums(3)
    integer :: p

    sums = 0.0_wp
    if (list%has_values) then
      associate (field => model%particles%field, h => model%p)
        sums(1) = real(model%particles%count, wp)
        do p = 1, model%particles%count
          sums(2) = sums(2) + field(h%mass)%values(1, p)/model%scene%mechanics%density_scaling
          sums(3) = sums(3) + 0.5_wp*field(h%mass)%values(1, p)* &
                    sum(field(h%velocity)%values(:, p)**2)
        end do
      end associate
      call model%comm%sum_array(sums)
    end if
    call list%add('time', 's', model%clock%time)
    call list%add('dt', 's', model%clock%dt)
    call list%add('step', '', real(model%clock%step, wp))
    call list%add('particles', '', sums(1))
    call list%add('mass', 'kg', sums(2))
    call list%add('kinetic_energy', 'J', sums(3))
  end subroutine add_run

  subroutine add_water(list, model)
    !! What was stored, what came in, and from where.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(in) :: model
    real(wp), allocatable :: sums(:)
    integer :: c, n

    n = size(model%scene%hydraulic_condition)
    if (list%has_values) then
      call balance_sums(model, sums)
    else
      allocate (sums(3 + n + 1 + n_scale), source=0.0_wp)
    end if
    call list%add('water_stored', 'm3', sums(1))
    call list%add('water_inflow', 'm3', sums(2))
    call list%add('water_squeezed', 'm3', sums(3))
    call list%add('water_balance_error', '', balance_error(sums))
    do c = 1, n
      call list%add('inflow_'//trim(model%scene%hydraulic_condition(c)%surface), 'm3', sums(3 + c))
    end do
    if (model%sources%has_water) call list%add('inflow_sources', 'm3', sums(3 + n + 1))
  end subroutine add_water

  subroutine add_momenta(list, model)
    !! Momentum of the bodies, impulses that rigid walls have given them, and those that were lost
    !! at almost massless nodes.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(in) :: model
    real(wp) :: sums(3*ndim)
    integer :: d, k, p
    character(len=14), parameter :: name(3) = [character(len=14) :: &
                                               'momentum', 'impulse_walls', 'impulse_lost']
    character(len=6), parameter :: unit(3) = [character(len=6) :: 'kg m/s', 'N s', 'N s']

    sums = 0.0_wp
    if (list%has_values) then
      sums(ndim + 1:) = [model%balance%wall_impulse, model%balance%lost_impulse]
      associate (field => model%particles%field, h => model%p)
        do p = 1, model%particles%count
          sums(:ndim) = sums(:ndim) + field(h%mass)%values(1, p)*field(h%velocity)%values(:, p)
        end do
      end associate
      call model%comm%sum_array(sums)
    end if
    do k = 1, 3
      do d = 1, ndim
        call list%add(trim(name(k))//'_'//axis_name(axis(d)), trim(unit(k)), sums(ndim*(k - 1) + d))
      end do
    end do
  end subroutine add_momenta

  subroutine add_forces(list, model)
    !! Forces and moments of walls, and what their balance misses.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(inout) :: model
    character(len=4), parameter :: force_unit(3) = [character(len=4) :: 'N/m2', 'N/m', 'N']
    character(len=5), parameter :: moment_unit(3) = [character(len=5) :: '', 'N m/m', 'N m']
    character(len=:), allocatable :: name
    real(wp), allocatable :: values(:)
    integer :: d, k, at

    if (list%has_values) then
      values = force_row(model)
    else
      allocate (values(model%reactions%n_column()), source=0.0_wp)
    end if
    at = 0
    do k = 1, model%reactions%n
      name = trim(model%reactions%name(k))
      if (k > model%reactions%n_surface) then   ! rigid walls may have a surface's name
        if (any(model%reactions%name(:k - 1) == name)) name = name//'_'//to_text(k)
      end if
      do d = 1, ndim
        call list%add('reaction_'//name//'_'//axis_name(axis(d)), trim(force_unit(ndim)), &
                      values(at + d))
      end do
      do d = 1, size(moment_axis)
        if (d > n_moment) exit
        call list%add('moment_'//name//'_'//axis_name(moment_axis(d)), trim(moment_unit(ndim)), &
                      values(at + ndim + d))
      end do
      at = at + ndim + n_moment
    end do
    call list%add('force_balance_error', '', values(at + 1))
  end subroutine add_forces

  subroutine add_free_area(list, model, surface)
    !! Area of a surface that is found as bodies move.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(in) :: model
    integer, intent(in) :: surface
    real(wp) :: area

    area = 0.0_wp
    if (list%has_values) area = free_area(model, surface)
    call list%add('area_'//trim(model%scene%surface(surface)%name), 'm2', area)
  end subroutine add_free_area

  subroutine add_probes(list, model)
    !! What the scene asks for.
    type(quantities_t), intent(inout) :: list
    type(model_t), intent(inout) :: model
    type(result_field_t), allocatable :: fields(:)
    real(wp) :: value
    integer :: k

    if (size(model%scene%probe) == 0) return
    allocate (fields, source=result_fields(model))
    value = 0.0_wp
    do k = 1, size(model%scene%probe)
      associate (probe => model%scene%probe(k))
        if (list%has_values) value = probe_value(model, probe)
        call list%add(trim(probe%name), trim(probe_unit(probe, fields)), value)
      end associate
    end do
  end subroutine add_probes
end module dosui_history_quantities

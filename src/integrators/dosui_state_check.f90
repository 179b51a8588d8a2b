!! Is the state of a run physically possible? Every field of every particle and surface point is
!! looked at: numbers, volumes and masses above zero, open pores, bodies that are not inside out.
!! What is wrong is said with particle, place, step and time.
module dosui_state_check
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_finite_strain, only: invert
  use dosui_model, only: model_t
  use dosui_point_set, only: field_t, point_set_t
  use dosui_surface_sets, only: first_member
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: largest = huge(1.0_wp)

  public :: check_state, describe_particle, is_sound, note_failure, note_fault, &
            place_of

contains

  subroutine check_state(model, err)
    !! Stops all ranks where the state of a particle or surface point is impossible, with the first
    !! fault that was noted since the last check, if there is one. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp) :: first

    first = huge(1.0_wp)
    if (model%fault%failed()) first = model%fault_time
    first = model%comm%minimum(first)
    if (.not. first < huge(1.0_wp)) then
      call find_fault(model, err)
    else if (model%fault%failed() .and. model%fault_time <= first) then
      call err%set(model%fault%message)
    end if
    call model%comm%agree(err)
  end subroutine check_state

  logical function is_sound(model) result(sound)
    !! Is the state possible on all ranks? Collective.
    type(model_t), intent(in) :: model
    type(error_t) :: fault

    call find_fault(model, fault)
    sound = model%comm%all(.not. (fault%failed() .or. model%fault%failed()))
  end function is_sound

  subroutine note_failure(model, failure)
    !! Keeps an error of this rank until all ranks look at the state, if it is the first.
    type(model_t), intent(inout) :: model
    type(error_t), intent(in) :: failure

    if (model%fault%failed() .or. .not. failure%failed()) return
    model%fault = failure
    model%fault_time = model%clock%time
  end subroutine note_failure

  subroutine note_fault(model)
    !! Notes the first step in which this rank's motion (or pressure, if nothing moves) is not a
    !! number, before particles hear of it. One sum a step: looks at all particles of all ranks
    !! come seldom, and by then NaN is everywhere.
    type(model_t), intent(inout) :: model
    integer :: n, i

    if (model%fault%failed()) return
    n = model%particles%count
    if (.not. model%rigid) then
      if (abs(sum(model%skeleton%velocity)) <= largest) return
    else if (model%coupled) then
      if (abs(sum(model%particles%field(model%p%pore_pressure)%values(1, 1:n))) <= largest) return
    end if
    model%fault_time = model%clock%time
    call find_fault(model, model%fault, .true.)   ! the cause, if it is a stress, pressure or volume
    if (model%fault%failed() .or. model%rigid) return
    do i = 1, model%grid%n_node
      if (all(abs(model%skeleton%velocity(:, i)) <= largest)) cycle
      call model%fault%set('the force on the body at '// &
                           place_of(model, model%grid%origin + model%grid%spacing* &
                                    real(model%grid%node_index(:, i), wp))// &
                           ' is not a finite number '//moment(model, .true.)// &
                           ': see loads, sources and prescribed motions')
      return
    end do
  end subroutine note_fault

  subroutine find_fault(model, fault, within)
    !! The first impossible state of this rank: what, of which particle, where and when. What moves
    !! comes last: it is the consequence of all others.
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: fault
    logical, intent(in), optional :: within   !! as in `moment`
    character(len=:), allocatable :: what
    integer :: k, p, pass

    do pass = 1, 2
      do k = 1, size(model%particles%field)
        if (is_motion(model%particles%field(k)) .neqv. pass == 2) cycle
        p = first_bad(model%particles, k)
        if (p == 0) cycle
        call fault%set(describe_particle(model, 'has a '// &
                                         said(model%particles%field(k)%name)// &
                                         ' that is not a finite number', p, within))
        return
      end do
    end do
    do k = 1, size(model%surface%field)
      p = first_bad(model%surface, k)
      if (p == 0) cycle
      call fault%set('a point of '//surface_name(model, p)//' has a '// &
                     said(model%surface%field(k)%name)//' that is not a finite number '// &
                     moment(model, within)//', at '// &
                     place_of(model, model%surface%field(model%s%position)%values(:, p)))
      return
    end do
    do p = 1, model%particles%count
      what = impossible(model, p)
      if (len(what) == 0) cycle
      call fault%set(describe_particle(model, what, p, within))
      return
    end do
  end subroutine find_fault

  pure logical function is_motion(field)
    !! Does a field follow from the motion of the nodes at once?
    type(field_t), intent(in) :: field

    is_motion = any(field%name == [character(len=32) :: 'position', 'current_position', &
                                   'build_position', 'velocity', 'displacement', 'affine'])
  end function is_motion

  pure integer function first_bad(set, k) result(p)
    !! The first owned point whose field k is not finite; 0: none.
    type(point_set_t), intent(in) :: set
    integer, intent(in) :: k

    associate (values => set%field(k)%values)
      do p = 1, set%count
        if (.not. all(abs(values(:, p)) <= largest)) return
      end do
    end associate
    p = 0
  end function first_bad

  function impossible(model, p) result(what)
    !! What finite numbers of a particle cannot be; '' if all is well.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    character(len=:), allocatable :: what
    real(wp) :: inverse(ndim, ndim), jacobian

    what = ''
    associate (field => model%particles%field, h => model%p)
      if (.not. field(h%volume)%values(1, p) > 0.0_wp) then
        what = 'has lost all its volume (J <= 0)'
      else if (model%coupled .and. .not. field(h%porosity)%values(1, p) > 0.0_wp) then
        what = 'has closed pores (porosity '//to_text(field(h%porosity)%values(1, p), 3)//')'
      else if (.not. field(h%porosity)%values(1, p) < 1.0_wp) then
        what = 'has no grains left (porosity '//to_text(field(h%porosity)%values(1, p), 3)//')'
      else if (.not. field(h%mass)%values(1, p) > 0.0_wp) then
        what = 'has lost its mass'
      else if (h%deformation > 0) then
        call invert(reshape(field(h%deformation)%values(:, p), [ndim, ndim]), inverse, jacobian)
        if (.not. jacobian > 0.0_wp) what = 'has lost all its volume (J <= 0)'
      end if
    end associate
  end function impossible

  function describe_particle(model, what, p, within) result(text)
    !! Step, time, identity, material and position of a particle in trouble.
    type(model_t), intent(in) :: model
    character(len=*), intent(in) :: what
    integer, intent(in) :: p
    logical, intent(in), optional :: within   !! as in `moment`
    character(len=:), allocatable :: text

    text = 'particle '//to_text(model%particles%id(p))//' '//what//' '//moment(model, within)// &
           ', at '// &
           place_of(model, model%particles%field(model%p%current_position)%values(:, p))// &
           " of '"// &
           trim(model%scene%material(nint(model%particles%field(model%p%material)% &
                                          values(1, p)))%name)//"'"
  end function describe_particle

  function moment(model, within) result(text)
    !! Step and time of the clock.
    type(model_t), intent(in) :: model
    logical, intent(in), optional :: within   !! the step that comes next is being computed
    character(len=:), allocatable :: text
    integer :: more

    more = 0
    if (present(within)) more = merge(1, 0, within)
    text = 'in step '//to_text(model%clock%step + more)//', t = '//to_text(model%clock%time)//' s'
  end function moment

  function place_of(model, position) result(text)
    !! The scene's coordinates of a place, in brackets.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: position(ndim)   !! [m]
    character(len=:), allocatable :: text
    integer :: d

    text = '('
    do d = 1, ndim
      text = text//to_text(position(d) + model%scene%local_origin(d), 6)
      if (d < ndim) text = text//', '
    end do
    text = text//') m'
  end function place_of

  function surface_name(model, p) result(text)
    !! The surface that a point belongs to, for messages.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    character(len=:), allocatable :: text
    integer :: s

    s = first_member(model%surface%field(model%s%surface)%values(:, p))
    text = 'an unnamed surface'
    if (s > 0) text = "surface '"//trim(model%scene%surface(s)%name)//"'"
  end function surface_name

  pure function said(name) result(text)
    !! The name of a field as words.
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    integer :: k

    text = trim(name)
    do k = 1, len(text)
      if (text(k:k) == '_') text(k:k) = ' '
    end do
  end function said
end module dosui_state_check

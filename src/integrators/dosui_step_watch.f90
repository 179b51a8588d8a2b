!! Watches whether the steps of a run with inertia (or of an explicit flow) still lead to its end.
!!
!! Their length follows from the state: bodies that fly off, pores that fill and then store nothing
!! but the compression of their water, pores that close. The first step promises how many there
!! will be. A run that would need very many more than that, step after step, ends with an error
!! that names the particle. Sub-steps and stages of the water count as steps. Checkpoints hold what
!! the watch remembers: a restart in the midst of such steps must not take them for the usual ones.
module dosui_step_watch
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_pore_water, only: compressibility_at
  use dosui_state_check, only: describe_particle
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: many = 1.0e8_wp       !! steps that are left: more are warned of beforehand
  real(wp), parameter :: beyond = 100.0_wp     !! what the first step promised [-]
  real(wp), parameter :: patience = 200.0_wp   !! steps in a row without hope

  type, public :: step_watch_t
    private
    real(wp) :: first = 0.0_wp      !! the first step of the run [s]; 0: there was none
    real(wp) :: parts = 1.0_wp      !! steps of the water in it [-]
    real(wp) :: hopeless = 0.0_wp   !! steps in a row [-]
  contains
    procedure :: look => watch_look
    procedure :: memory => watch_memory
    procedure :: recall => watch_recall
  end type step_watch_t

contains

  subroutine watch_look(self, model, err)
    !! Looks at a step that has been chosen and not yet made. Collective.
    class(step_watch_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err
    real(wp) :: parts, left, promised

    associate (clock => model%clock, end_time => model%scene%time%end_time)
      parts = real(max(1, model%water%substeps, model%water%stages), wp)
      left = parts*(end_time - clock%time)/clock%dt
      if (.not. self%first > 0.0_wp) then
        self%first = clock%dt
        self%parts = parts
      end if
      promised = self%parts*end_time/self%first   ! a restart may have another end
      if (.not. left > max(many, beyond*promised)) then
        self%hopeless = 0.0_wp
        return
      end if
      self%hopeless = self%hopeless + parts
      if (self%hopeless < patience) return
      call err%set('the steps end at t = '//to_text(clock%time, 6)//' s: no progress; dt is '// &
                   to_text(clock%dt, 3)//' s ('//trim(clock%limit%name)//'; '// &
                   to_text(self%first, 3)//' s in the first step)'//water_steps(parts)// &
                   ', so that '//to_text(left, 2)//' steps are left where the first promised '// &
                   to_text(promised, 2)//' in all; '//trouble(model))
    end associate
  end subroutine watch_look

  pure function watch_memory(self) result(values)
    !! What a checkpoint keeps of the watch.
    class(step_watch_t), intent(in) :: self
    real(wp) :: values(3)   !! [s, -, -]

    values = [self%first, self%parts, self%hopeless]
  end function watch_memory

  pure subroutine watch_recall(self, values)
    !! Takes up the watch of the run that wrote a checkpoint.
    class(step_watch_t), intent(inout) :: self
    real(wp), intent(in) :: values(:)   !! as from `memory` [s, -, -]

    self%first = values(1)
    self%parts = values(2)
    self%hopeless = values(3)
  end subroutine watch_recall

  function water_steps(parts) result(text)
    !! Sub-steps or stages of the water in a step.
    real(wp), intent(in) :: parts
    character(len=:), allocatable :: text

    text = ''
    if (parts > 1.0_wp) text = ' with '//to_text(parts, 3)//' steps of the water in each'
  end function water_steps

  function trouble(model) result(text)
    !! The particle that forces the small steps, and what that usually means. Collective.
    type(model_t), intent(in) :: model
    character(len=:), allocatable :: text
    type(error_t) :: carrier   ! takes the text to all ranks
    real(wp) :: least, most
    integer :: p, owner

    most = -1.0_wp
    p = 0
    if (model%clock%limit%name == 'particle speed') then
      call find_fastest(model, p, most)
    else if (model%coupled) then
      call find_stiffest_pores(model, p, most)
    end if
    least = most
    call model%comm%maximum_location(most, owner)
    if (owner == model%comm%rank .and. p > 0) then
      if (model%clock%limit%name == 'particle speed') then
        call carrier%set(describe_particle(model, 'is the fastest ('//to_text(least, 3)// &
                                           ' m/s)', p, .true.))
      else
        call carrier%set(describe_particle(model, 'stores the least water ('// &
                                           to_text(1.0_wp/least, 3)//' of its volume per Pa)', &
                                           p, .true.))
      end if
    end if
    call model%comm%agree(carrier)
    text = 'dt follows the damping and the stiffness of the skeleton'
    if (.not. carrier%failed()) return
    text = carrier%message//'. Such steps usually mean '
    if (model%clock%limit%name == 'particle speed') then
      text = text//'that particles fly off: a body that has burst, lost its contact or meets '// &
             'very stiff springs (a smaller courant, damping, another shape_function)'
    else if (model%unsaturated) then
      text = text//'that pores have filled: full pores store only what their water is '// &
             'compressed. Quasi-static steps (integrator) do not depend on it'
    else
      text = text//'that pores close. Quasi-static or semi-implicit steps (integrator) do not '// &
             'depend on it'
    end if
  end function trouble

  subroutine find_fastest(model, p, speed)
    !! This rank's fastest particle.
    type(model_t), intent(in) :: model
    integer, intent(out) :: p         !! 0: it has none
    real(wp), intent(out) :: speed    !! [m/s]

    p = 0
    speed = -1.0_wp
    associate (velocity => model%particles%field(model%p%velocity)%values, &
               n => model%particles%count)
      if (n == 0) return
      p = maxloc(sum(velocity(:, 1:n)**2, dim=1), dim=1)
      speed = norm2(velocity(:, p))
    end associate
  end subroutine find_fastest

  subroutine find_stiffest_pores(model, p, stiffness)
    !! This rank's particle whose pores store the least water.
    type(model_t), intent(in) :: model
    integer, intent(out) :: p             !! 0: it has none
    real(wp), intent(out) :: stiffness    !! pressure over stored water [Pa]
    real(wp), allocatable :: compressibility(:)

    p = 0
    stiffness = -1.0_wp
    associate (n => model%particles%count)
      if (n == 0) return
      allocate (compressibility(n))
      compressibility = compressibility_at(model, model%particles%field(model%p%pore_pressure)% &
                                           values(1, 1:n))
      p = minloc(compressibility, dim=1)
      stiffness = 1.0_wp/compressibility(p)
    end associate
  end subroutine find_stiffest_pores
end module dosui_step_watch

!! The equilibria that runs begin with.
module dosui_starts
  use dosui_kinds, only: wp
  use dosui_equilibrium, only: find_equilibrium, find_geostatic_equilibrium, load_scale_t, &
                               mean_stress_size
  use dosui_error, only: error_t
  use dosui_following, only: rebuild
  use dosui_model, only: model_t
  use dosui_point_set, only: point_set_t
  use dosui_quasi_static, only: quasi_static_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: geostatic_start, undrained_start

  integer, parameter :: equilibrium_passes = 20       !! of updated scenes
  real(wp), parameter :: settled = 1.0e-12_wp         !! of the first displacements [-]
  real(wp), parameter :: pass_reduction = 1.0e-12_wp  !! residual over the loads [-]

contains

  subroutine geostatic_start(model, err)
    !! Effective stresses in equilibrium with weight, loads and pore pressures before the clock
    !! starts. The body is where it shall be, so what has moved on the way is forgotten, but for
    !! the springs of penalty walls.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: volume(:, :), porosity(:, :)
    character(len=:), allocatable :: remains
    integer :: n_iteration
    logical :: stands

    n_iteration = 0
    volume = model%particles%field(model%p%volume)%values
    porosity = model%particles%field(model%p%porosity)%values
    call find_geostatic_equilibrium(model, n_iteration, stands, err, remains)
    if (.not. (stands .or. err%failed())) then
      call err%set('the geostatic start found no equilibrium: the soils cannot carry the loads '// &
                   '(dosui --safety finds by how much); '//remains)
    end if
    if (err%failed()) return
    model%particles%field(model%p%displacement)%values = 0.0_wp
    model%particles%field(model%p%volume)%values = volume
    model%particles%field(model%p%porosity)%values = porosity
    model%inverted = 0
    associate (displacement => model%surface%field(model%s%displacement)%values, &
               m => model%surface%count)
      if (model%finite) then
        displacement = 0.0_wp
      else
        call model%skeleton%surface_forces%forget(displacement(:, 1:m))
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
    type(load_scale_t) :: scale
    real(wp) :: first
    integer :: pass, n_iteration, last_iteration

    first = -1.0_wp
    n_iteration = 0
    do pass = 1, equilibrium_passes
      last_iteration = n_iteration
      before = model%particles%field(model%p%displacement)%values(:, 1:model%particles%count)
      before_surface = model%surface%field(model%s%displacement)%values(:, 1:model%surface%count)
      if (model%traits%is_explicit()) then
        call find_equilibrium(model, merge(pass_reduction, 0.0_wp, model%updated), n_iteration, &
                              scale, err)
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
    if (first < 0.0_wp) first = max(change, model%grid%spacing*mean_stress_size(model)/ &
                                    model%scales%skeleton_modulus)   ! of stresses within a cell
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
end module dosui_starts

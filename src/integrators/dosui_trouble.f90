!! Where a step that finds no solution has its trouble, and what that usually means.
module dosui_trouble
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_error, only: error_t
  use dosui_hourglass, only: elastic_tangent
  use dosui_model, only: model_t
  use dosui_scene, only: name_length
  use dosui_state_check, only: place_of
  use dosui_surface_sets, only: first_member
  use dosui_text, only: to_text
  implicit none
  private

  real(wp), parameter :: near = 2.0_wp        !! a surface is near, in cells [-]
  real(wp), parameter :: soft = 0.5_wp        !! stiffness over the elastic one: it yields [-]

  public :: describe_trouble

contains

  subroutine describe_trouble(model, force, is_free, change, by_water, before, text)
    !! The place of the largest unbalanced force, or of the largest last change of pressure: its
    !! coordinates, material, nearest surface and, of soil, how far beyond its strength it is.
    !! Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: force(:, :)      !! unbalanced, of nodes [N]
    logical, intent(in) :: is_free(:, :)     !! components that no condition holds
    real(wp), intent(in) :: change(:)        !! last ones of the particles' pressures [Pa]
    logical, intent(in) :: by_water          !! pressures are in trouble, not the skeleton
    real(wp), allocatable, intent(in) :: before(:, :)   !! stresses at the step's start [Pa]
    character(len=:), allocatable, intent(out) :: text
    type(error_t) :: carrier   ! takes the text to all ranks
    real(wp) :: worst, most, share, reaction, x(ndim)
    integer :: k, owner

    share = yielding_share(model)
    reaction = 0.0_wp
    if (size(force) > 0) reaction = maxval(abs(force), mask=.not. is_free)
    reaction = model%comm%maximum(max(0.0_wp, reaction))
    k = 0
    worst = -1.0_wp
    x = 0.0_wp
    if (by_water) then
      if (size(change) > 0) k = maxloc(abs(change), dim=1)
      if (k > 0) worst = abs(change(k))
      if (k > 0) x = model%particles%field(model%p%current_position)%values(:, k)
    else if (size(force) > 0) then
      k = maxloc(maxval(abs(force), mask=is_free, dim=1), dim=1)
      worst = maxval(abs(force(:, k)), mask=is_free(:, k))
      x = model%grid%origin + model%grid%spacing*real(model%grid%node_index(:, k), wp)
    end if
    most = worst
    call model%comm%maximum_location(most, owner)
    if (owner == model%comm%rank) then
      call carrier%set('worst at '//place_of(model, x)// &
                       surroundings(model, x, by_water, worst, share, reaction, before))
    end if
    call model%comm%agree(carrier)
    text = carrier%message
  end subroutine describe_trouble

  function surroundings(model, x, by_water, worst, share, reaction, before) result(text)
    !! Material, surface and state of the particle nearest to a place.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: x(ndim)        !! [m]
    logical, intent(in) :: by_water
    real(wp), intent(in) :: worst          !! unbalanced force [N] or change of pressure [Pa]
    real(wp), intent(in) :: share          !! of the particles that yield [-]
    real(wp), intent(in) :: reaction       !! largest of a held node [N]
    real(wp), allocatable, intent(in) :: before(:, :)   !! [Pa]
    character(len=:), allocatable :: text
    integer :: p, m

    text = ''
    if (model%particles%count == 0) return
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      p = nearest_point(field(model%p%current_position)%values(:, 1:n), x)
      m = nint(field(h%material)%values(1, p))
      text = " in '"//trim(model%scene%material(m)%name)//"'"//surface_near(model, x)
      if (by_water) then
        text = text//': the pressure ('//to_text(field(h%pore_pressure)%values(1, p), 3)// &
               ' Pa at the start of the step) still changes by '//to_text(worst, 3)//' Pa'
        if (model%water%retention(m)%is_active) then
          text = text//'. Such steps usually mean a wetting front in dry soil or a surface '// &
                 'that gets wet at once: finer particles, a smaller retention_exponent or '// &
                 'retention_alpha, heads that rise with time (factor_times)'
        end if
        return
      end if
      text = text//': unbalanced force '//to_text(worst, 3)//' N'
      if (reaction > 0.0_wp) then
        text = text//' ('//to_text(100.0_wp*worst/reaction, 2)//' % of the largest reaction)'
      end if
      if (.not. model%materials%is_nonlinear()) return
      if (allocated(before)) text = text//beyond_strength(model, p, before(:, p))
      text = text//', '//to_text(100.0_wp*share, 2)//' % of the particles yield'
      if (sum(field(h%effective_stress)%values(1:3, p)) > 0.0_wp) then
        text = text//'. Such steps usually mean that the soil is torn: it is pulled beyond its '// &
               'tensile strength'
      else
        text = text//'. Such steps usually mean that the soil is at failure: loads or motions '// &
               'exceed its strength (dosui --safety finds by how much)'
      end if
    end associate
  end function surroundings

  function beyond_strength(model, p, before) result(text)
    !! How much larger the stress of a particle would be if its soil were elastic in this step.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp), intent(in) :: before(nsig)   !! stress at the start [Pa]
    character(len=:), allocatable :: text
    real(wp) :: tangent(nsig, nsig), there, elastic

    text = ''
    if (model%finite .or. .not. allocated(model%skeleton%strain_increment)) return
    call elastic_tangent(model, p, tangent)
    there = norm2(model%particles%field(model%p%effective_stress)%values(:, p))
    elastic = norm2(before + matmul(tangent, model%skeleton%strain_increment(:, p)))
    if (.not. (there > 0.0_wp .and. elastic > 1.01_wp*there)) return
    text = ', elastic stresses would be '//to_text(elastic/there, 3)//' times what the soil bears'
  end function beyond_strength

  real(wp) function yielding_share(model) result(share)
    !! Part of the particles whose tangent is much softer than their elasticity [-]. Collective.
    type(model_t), intent(in) :: model
    real(wp) :: tangent(nsig, nsig), counts(2)
    integer :: p

    share = 0.0_wp
    if (model%rigid .or. .not. model%materials%is_nonlinear()) return
    if (.not. allocated(model%skeleton%tangent)) return   ! none has been needed yet
    counts = 0.0_wp
    do p = 1, model%particles%count
      call elastic_tangent(model, p, tangent)
      if (softest(model%skeleton%tangent(:, :, p), tangent) < soft) counts(1) = counts(1) + 1.0_wp
    end do
    counts(2) = real(model%particles%count, wp)
    call model%comm%sum_array(counts)
    share = counts(1)/counts(2)
  end function yielding_share

  pure real(wp) function softest(tangent, elastic) result(ratio)
    !! Least quotient of diagonal entries [-].
    real(wp), intent(in) :: tangent(nsig, nsig), elastic(nsig, nsig)
    integer :: k

    ratio = 1.0_wp
    do k = 1, nsig
      ratio = min(ratio, tangent(k, k)/elastic(k, k))
    end do
  end function softest

  function surface_near(model, x) result(text)
    !! The named surface that is nearest to a place, if one is near.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: x(ndim)   !! [m]
    character(len=:), allocatable :: text
    character(len=name_length) :: name
    real(wp) :: least, distance
    integer :: p, s, h

    h = model%s%current_position
    least = near*model%grid%spacing
    name = ''
    do p = 1, model%surface%count
      s = first_member(model%surface%field(model%s%surface)%values(:, p))
      if (s <= 0) cycle
      distance = norm2(model%surface%field(h)%values(:, p) - x)
      if (distance >= least) cycle
      least = distance
      name = model%scene%surface(s)%name
    end do
    text = ''
    if (name /= '') text = ", beside surface '"//trim(name)//"'"
  end function surface_near

  pure integer function nearest_point(position, x) result(p)
    !! The point nearest to a place.
    real(wp), intent(in) :: position(:, :)   !! (ndim, n) [m]
    real(wp), intent(in) :: x(ndim)          !! [m]
    real(wp) :: least, square
    integer :: k

    p = 1
    least = huge(1.0_wp)
    do k = 1, size(position, 2)
      square = sum((position(:, k) - x)**2)
      if (square >= least) cycle
      least = square
      p = k
    end do
  end function nearest_point
end module dosui_trouble

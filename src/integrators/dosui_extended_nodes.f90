!! Velocities and accelerations of nodes where some of them follow others (`dosui_nodal_extension`).
!!
!! Components v = E v' + g: those that nothing holds and that do not follow are unknowns v', held
!! ones have g. Momenta p and forces f of the particles give
!!     E^T m (E v' + g) = E^T p,   E^T m E a' = E^T f
!! with the mass m of every node: constant and linear fields are in the range of E, so that linear
!! and angular momentum of the particles' transfer survive, and forces change them by their exact
!! resultants. A rigid plate is one more unknown V: what is left over on its nodes with V = 0, over
!! what V = 1 leaves there.
module dosui_extended_nodes
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_least_squares, only: eliminate
  use dosui_model, only: model_t
  implicit none
  private

  public :: fold_nodal, solve_nodal, held_components, inertia_forces

contains

  subroutine held_components(model, time, at_rest, is_held, known, plate)
    !! What conditions on nodes prescribe at a time.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: time       !! [s]
    logical, intent(in) :: at_rest     !! prescribed velocities are zero
    logical, allocatable, intent(out) :: is_held(:, :)
    real(wp), allocatable, intent(out) :: known(:, :)   !! [m/s]
    integer, allocatable, intent(out) :: plate(:, :)

    allocate (is_held(ndim, model%grid%n_node), known(ndim, model%grid%n_node), &
              plate(ndim, model%grid%n_node))
    call model%skeleton%nodal_conditions%prescribe(time, at_rest, &
                                                   is_held, known, plate)
  end subroutine held_components

  subroutine fold_nodal(model, is_held)
    !! Momenta and forces of components that follow go to those that lead. Collective.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_held(:, :)
    real(wp), allocatable :: sums(:, :)

    sums = model%skeleton%nodal(2:, :)
    call model%mesh%extension%fold(model%comm, model%grid, 2*ndim, sums, is_held)
    model%skeleton%nodal(2:, :) = sums
  end subroutine fold_nodal

  subroutine solve_nodal(model, dt, time, at_rest, is_held, known, plate, least_mass)
    !! Velocities before and after the step from folded momenta and forces. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: dt, time         !! step, and its end [s]
    logical, intent(in) :: at_rest           !! plates, too, stand before the step
    logical, intent(in) :: is_held(:, :)     !! from `held_components`, as the next two
    real(wp), intent(in) :: known(:, :)      !! [m/s]
    integer, intent(in) :: plate(:, :)
    real(wp), intent(in) :: least_mass       !! forces do not move nodes with no more [kg]
    real(wp), allocatable :: motion(:, :)    ! velocities, accelerations
    integer :: a, i

    motion = model%skeleton%nodal(2:, :)
    do i = 1, model%grid%n_node
      if (.not. (model%skeleton%nodal(1, i) > least_mass .or. &
                 model%mesh%extension%in_strip(i))) then
        motion(ndim + 1:, i) = 0.0_wp
      end if
      do a = 1, ndim
        if (.not. is_held(a, i)) cycle
        motion(a, i) = merge(0.0_wp, known(a, i), plate(a, i) > 0)
        motion(ndim + a, i) = 0.0_wp
      end do
    end do
    call model%mesh%extension%solve(model%comm, model%grid, 2*ndim, model%skeleton%nodal(1, :), &
                                    motion, is_held)
    if (size(model%skeleton%nodal_conditions%plate_condition) > 0) then
      call move_plates(model, time, at_rest, is_held, known, plate, motion)
    end if
    do i = 1, model%grid%n_node
      model%skeleton%velocity_old(:, i) = motion(:ndim, i)
      model%skeleton%velocity(:, i) = motion(:ndim, i) + dt*motion(ndim + 1:, i)
    end do
  end subroutine solve_nodal

  subroutine move_plates(model, time, at_rest, is_held, known, plate, motion)
    !! Adds the plates' motion, and what follows them, to that of all others. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: time                 !! [s]
    logical, intent(in) :: at_rest, is_held(:, :)
    real(wp), intent(in) :: known(:, :)
    integer, intent(in) :: plate(:, :)
    real(wp), intent(inout) :: motion(:, :)      !! (2 ndim, n_node) velocities, accelerations
    real(wp), allocatable :: unit(:, :, :), rest(:, :), matrix(:, :), right(:), sums(:)
    real(wp), allocatable :: left(:, :)          ! of momenta and forces, for each plate
    logical :: regular
    integer :: c, i, k, m

    m = size(model%skeleton%nodal_conditions%plate_condition)
    allocate (unit(ndim, model%grid%n_node, m), matrix(m, m), left(m, 2))
    rest = motion
    call inertia_forces(model, is_held, rest)
    rest = model%skeleton%nodal(2:, :) - rest
    call sum_over_plates(model, known, plate, m, rest(:ndim, :), left(:, 1))
    call sum_over_plates(model, known, plate, m, rest(ndim + 1:, :), left(:, 2))
    do k = 1, m
      unit(:, :, k) = merge(known, 0.0_wp, plate == k)
      call model%mesh%extension%solve(model%comm, model%grid, ndim, model%skeleton%nodal(1, :), &
                                      unit(:, :, k), &
                                      is_held)
      rest = unit(:, :, k)
      call inertia_forces(model, is_held, rest)
      allocate (sums(m))
      call sum_over_plates(model, known, plate, m, rest, sums)
      matrix(:, k) = sums
      deallocate (sums)
      c = model%skeleton%nodal_conditions%plate_condition(k)
      left(k, 2) = left(k, 2) - model%skeleton%nodal_conditions%wall(c)%force(time)
    end do
    if (at_rest) left(:, 1) = 0.0_wp
    do c = 1, 2
      right = left(:, c)
      call solve_small(matrix, right, regular)
      if (.not. regular) cycle
      do k = 1, m
        do i = 1, model%grid%n_node
          motion((c - 1)*ndim + 1:c*ndim, i) = motion((c - 1)*ndim + 1:c*ndim, i) + &
                                               right(k)*unit(:, i, k)
        end do
      end do
    end do
  end subroutine move_plates

  pure subroutine solve_small(matrix, right, regular)
    !! Solves for the plates' velocities; the matrix stays.
    real(wp), intent(in) :: matrix(:, :)
    real(wp), intent(inout) :: right(:)
    logical, intent(out) :: regular
    real(wp) :: work(size(right), size(right))

    work = matrix
    call eliminate(work, right, regular)
  end subroutine solve_small

  subroutine sum_over_plates(model, known, plate, m, values, sums)
    !! Sums along the outward normals of the plates. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: known(:, :)     !! outward signs
    integer, intent(in) :: plate(:, :), m
    real(wp), intent(in) :: values(:, :)
    real(wp), intent(out) :: sums(:)
    integer :: a, i

    sums(:m) = 0.0_wp
    do i = 1, model%grid%n_node
      if (.not. model%grid%node_map%is_owned(i)) cycle
      do a = 1, ndim
        if (plate(a, i) > 0) sums(plate(a, i)) = sums(plate(a, i)) + known(a, i)*values(a, i)
      end do
    end do
    call model%comm%sum_array(sums)
  end subroutine sum_over_plates

  subroutine inertia_forces(model, is_held, motion)
    !! E^T m times a field: on unknowns and held components, 0 on those that follow. Collective.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_held(:, :)
    real(wp), intent(inout) :: motion(:, :)
    !! (vectors of ndim components, n_node) accelerations [m/s2], then forces [N]
    integer :: i

    do i = 1, model%grid%n_node
      motion(:, i) = model%skeleton%nodal(1, i)*motion(:, i)
    end do
    call model%mesh%extension%fold(model%comm, model%grid, size(motion, 1), motion, is_held)
  end subroutine inertia_forces
end module dosui_extended_nodes

!! Pressures on the surfaces of bodies that move through the grid, see `dosui_outer_pressure`.
module dosui_moving_loads
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, volume_slot
  use dosui_cell_average, only: cell_sums
  use dosui_force_balance, only: book_loads
  use dosui_model, only: model_t
  use dosui_outer_pressure, only: pressure_forces
  use dosui_scene, only: rigid_wall_t
  implicit none
  private

  public :: add_moving_loads, build_moving_loads

contains

  subroutine build_moving_loads(model, handle, cell)
    !! Where pressures act, for the geometry at hand. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: handle      !! positions of the surface points
    integer, intent(in) :: cell(:)     !! of the particles where the geometry is built
    type(rigid_wall_t), allocatable :: walls(:)
    logical :: is_shut(model%surface%count)
    integer :: m, p

    m = model%surface%count
    allocate (walls(0))
    if (allocated(model%scene%rigid_wall)) walls = model%scene%rigid_wall
    associate (field => model%surface%field, h => model%s)
      do p = 1, m
        is_shut(p) = field(h%surface)%values(1, p) < 0.0_wp   ! a barrier
        if (h%free > 0) then   ! where bodies touch, points have lost their free surface
          if (field(h%free)%values(1, p) > 0.5_wp .and. &
              .not. any(abs(field(h%surface)%values(:, p)) > 0.0_wp)) is_shut(p) = .true.
        end if
      end do
      call model%skeleton%outer_pressure%init(model%comm, model%grid, &
                                              model%scene%mechanical_condition, &
                                              walls, size(cell), cell, m, model%mesh%surface_cell, &
                                     field(handle)%values(:, 1:m), field(h%normal)%values(:, 1:m), &
                                            field(h%area)%values(1, 1:m), model%skeleton%by_force, &
                                              model%skeleton%on_nodes, is_shut, &
                                              model%skeleton%nodal_conditions%node, &
                                              model%skeleton%nodal_conditions%direction)
    end associate
  end subroutine build_moving_loads

  subroutine add_moving_loads(model)
    !! Adds the forces of pressures to this rank's nodal forces. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: nodal(:), force(:, :), load(:, :), given(:), met(:), of_tractions(:)
    integer :: m

    if (.not. model%skeleton%outer_pressure%acts) return
    m = model%surface%count
    allocate (nodal(model%grid%n_node), given(m), met(m), of_tractions(m))
    allocate (force(ndim, model%grid%n_node), load(ndim, model%grid%n_node), source=0.0_wp)
    associate (field => model%surface%field, h => model%s, outer => model%skeleton%outer_pressure)
      call outer%at_nodes(model%scene%mechanical_condition, model%grid, model%clock%time, nodal)
      call outer%at_points(model%scene%mechanical_condition, model%clock%time, &
                           field(h%position)%values(:, 1:m), field(h%normal)%values(:, 1:m), &
                           model%skeleton%by_force, given, of_tractions)
      call add_body_part(model, nodal, force)
      call model%skeleton%surface_forces%values_of(nodal, met)
      met = merge(given - met, 0.0_wp, outer%is_open)
      associate (area => field(h%area)%values(1, 1:m), normal => field(h%normal)%values(:, 1:m))
        call model%skeleton%surface_forces%press(area, normal, met, force)
        call model%skeleton%surface_forces%press(area, normal, given, load)
        call outer%take_at_walls(load, force)
        call model%skeleton%surface_forces%press(area, normal, -of_tractions, &
                                                 force)   ! there already
      end associate
    end associate
    if (model%reactions%is_wanted) call book_loads(model, force)
    model%skeleton%nodal(2 + ndim:, :) = model%skeleton%nodal(2 + ndim:, :) + force
  end subroutine add_moving_loads

  subroutine add_body_part(model, nodal, force)
    !! - int (P grad N_i + N_i grad P) dV as the stresses are integrated. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: nodal(:)           !! P at the nodes [Pa]
    real(wp), intent(inout) :: force(:, :)     !! (ndim, n_node) [N]
    real(wp), allocatable :: own(:), slope(:, :), mean(:), stress(:, :)
    integer :: a, n, p

    n = model%particles%count
    allocate (own(n), slope(ndim, n))
    associate (position => model%particles%field(model%p%position)%values)
      call model%skeleton%outer_pressure%at_particles(model%grid, n, model%mesh%cell, position, &
                                                      nodal, own, slope)
      if (model%skeleton%averaged) then
        allocate (mean(model%grid%n_cell))
        call cell_sums(n, model%mesh%cell, model%mesh%weight, own, model%grid%n_cell, mean)
        call model%mesh%average%cell_means(model%comm, model%grid, 1, mean)
        do p = 1, n
          own(p) = mean(model%mesh%cell(p))
          if (.not. model%skeleton%centred) cycle
          if (.not. model%mesh%quadrature%is_ragged(model%mesh%cell(p))) own(p) = 0.0_wp
        end do
      end if
      if (model%skeleton%centred) then
        where (model%mesh%quadrature%is_ragged) mean = 0.0_wp
        allocate (stress(nsig, model%grid%n_cell), source=0.0_wp)
        do a = 1, n_volume
          stress(volume_slot(a), :) = mean
        end do
        call model%mesh%quadrature%forces(model%grid, model%mesh%average%cell_weight, stress, force)
      end if
      call pressure_forces(model%grid, n, model%mesh%patch, position, model%mesh%weight, &
                           model%skeleton%pressed_volume, own, slope, force)
    end associate
  end subroutine add_body_part
end module dosui_moving_loads

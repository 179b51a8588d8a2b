!! Constant forces that keep bodies in balance whose surfaces cut the cells of the grid.
!!
!! A body at rest under its own weight has stresses that are linear in depth, and these balance the
!! weight where both are integrated exactly. Particles do neither in cells that they do not fill
!! evenly: their masses lie about another point than the part's centroid X_c, and so do their mean
!! stresses. What is missing does not change with time:
!!
!! * the weight by shapes less that of the particles (`dosui_body_weight`);
!! * - W_c C_c^T (sigma_0(X_c) - mean of sigma_0 over the cell's particles) for the initial stress
!!   sigma_0 that the scene gives, and for the pore pressure, which in water at rest differs by
!!   rho_w g.x between two points;
!! * the same for what walls take of a cell's stress, at the middle of their pieces;
!! * the particles' deviations from their cell's mean, reversed, for sigma_0: walls know means.
!!
!! Stresses of particles stay what they are at their own places. All but the first need undeformed
!! cells (small strains) and, for the water, pores that are full.
module dosui_cut_weight
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, voigt_slot, volume_slot
  use dosui_body_weight, only: find_weight_shift
  use dosui_cell_average, only: cell_sums, cell_tensor_sums
  use dosui_initial_state, only: initial_stress_change
  use dosui_model, only: model_t
  use dosui_particle_to_grid, only: n_nodal_row, particles_to_grid
  implicit none
  private

  public :: build_shift, add_wall, find_group_centres

contains

  subroutine build_shift(model)
    !! Finds the forces; none where all cells are full, or move. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: mass(:), forces(:, :)
    logical, allocatable :: is_filled(:)
    integer :: a

    if (allocated(model%skeleton%shift)) deallocate (model%skeleton%shift)
    if (.not. (model%skeleton%centred .and. &
               model%mesh%quadrature%exact) .or. model%mesh%quadrature%fitted) return
    if (.not. norm2(model%scene%gravity) > 0.0_wp) return
    is_filled = model%mesh%quadrature%measure(model%mesh%quadrature%host) > 0.0_wp
    associate (field => model%particles%field, n => model%particles%count, &
               volume => merge(model%p%reference_volume, model%p%volume, model%finite))
      call find_weight_shift(model%comm, model%grid, model%scene, model%mesh%quadrature, n, &
                             model%mesh%patch, model%material, &
                             field(model%p%position)%values(:, 1:n), &
                             field(volume)%values(1, 1:n), mass)
    end associate
    allocate (model%skeleton%shift(ndim, model%grid%n_node))
    do a = 1, ndim
      model%skeleton%shift(a, :) = model%scene%gravity(a)*mass
    end do
    if (model%finite) return
    allocate (forces(ndim, model%grid%n_node), source=0.0_wp)
    call add_cells(model, is_filled, forces)
    call add_walls(model, forces)
    call take_deviations(model, forces)
    call model%grid%node_map%sum_copies(model%comm, ndim, forces)
    model%skeleton%shift = model%skeleton%shift + forces
  end subroutine build_shift

  subroutine add_cells(model, is_filled, forces)
    !! What the cells' mean stresses lack. Collective.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_filled(:)
    real(wp), intent(inout) :: forces(:, :)   !! (ndim, n_node) of this rank [N]
    real(wp) :: at(ndim, model%grid%n_cell), change(nsig, model%grid%n_cell)
    real(wp) :: middle(ndim, model%grid%n_cell)   ! of groups
    real(wp) :: load(ndim)
    integer :: a, b, c, k

    do c = 1, model%grid%n_cell
      at(:, c) = model%grid%origin + model%grid%spacing* &
                 (real(model%grid%cell_base(:, c), wp) + model%mesh%quadrature%centroid(:, c))
    end do
    call find_group_centres(model, middle)
    call find_changes(model, at, .false., change)
    call add_water(model, at, middle, is_filled, change)
    do c = 1, model%grid%n_cell
      if (.not. (is_filled(c) .and. model%grid%cell_map%is_owned(c))) cycle
      do k = 1, 2**ndim
        load = 0.0_wp
        do b = 1, ndim
          do a = 1, ndim
            load(a) = load(a) - model%mesh%quadrature%part(c)*change(voigt_slot(a, b), c)* &
                      model%mesh%quadrature%gradient(b, k, c)
          end do
        end do
        associate (node => model%grid%cell_node(k, c))
          forces(:, node) = forces(:, node) + load
        end associate
      end do
    end do
  end subroutine add_cells

  subroutine take_deviations(model, forces)
    !! Takes off what the particles' own deviations from their cell's mean initial stress exert:
    !! walls and weight balance means. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: forces(:, :)   !! (ndim, n_node) of this rank [N]
    real(wp) :: centre(ndim, model%grid%n_cell), mean(nsig, model%grid%n_cell)
    real(wp), allocatable :: nodal(:, :), change(:, :), none(:)
    integer :: p

    call sum_places(model, model%mesh%weight, centre)
    call model%mesh%average%cell_means(model%comm, model%grid, ndim, centre)
    associate (field => model%particles%field, h => model%p, n => model%particles%count)
      allocate (nodal(n_nodal_row, model%grid%n_node), change(nsig, n), none(n))
      none = 0.0_wp
      do p = 1, n   ! of the mean over its own
        associate (x => field(h%position)%values(:, p))
          change(:, p) = initial_stress_change(model%scene, model%material(p), model%coupled, x, &
                                               centre(:, model%mesh%cell(p)) - x)
        end associate
      end do
      call cell_tensor_sums(n, model%mesh%cell, model%mesh%weight, change, model%grid%n_cell, mean)
      call model%mesh%average%cell_means(model%comm, model%grid, nsig, mean)
      call particles_to_grid(model%grid, n, model%mesh%patch, field(h%position)%values, &
                             field(h%velocity)%values, none, model%mesh%weight, change, &
                             model%scene%gravity, nodal, cell=model%mesh%cell, cell_stress=mean)
    end associate
    forces = forces + nodal(2 + ndim:, :)
  end subroutine take_deviations

  subroutine add_walls(model, forces)
    !! What the walls' shares of the cells' mean stresses lack. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: forces(:, :)   !! (ndim, n_node) of this rank [N]
    real(wp) :: centre(ndim, model%grid%n_cell)
    integer :: c

    if (.not. model%skeleton%lifted) return
    call find_group_centres(model, centre)
    do c = 1, size(model%scene%mechanical_condition)
      call add_wall(model, c, centre, forces)
    end do
  end subroutine add_walls

  subroutine add_wall(model, condition, centre, forces)
    !! What the walls of one condition take beside their share of the cells' mean stresses, in
    !! small strains where cells are cut. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: condition
    real(wp), intent(in) :: centre(:, :)      !! (ndim, n_cell) of the groups' particles [m]
    real(wp), intent(inout) :: forces(:, :)   !! (ndim, n_node) of this rank [N]
    real(wp) :: at(ndim, model%grid%n_cell), change(nsig, model%grid%n_cell)
    logical :: is_held(model%grid%n_cell)
    integer :: m

    m = model%surface%count
    call find_middles(model, condition, at, is_held)
    call find_changes(model, at, .true., change)
    call add_water(model, at, centre, is_held, change)
    associate (field => model%surface%field, h => model%s)
      call model%skeleton%surface_forces%react(field(h%area)%values(1, 1:m), &
                                               field(h%normal)%values(:, 1:m), change, forces, &
                                               only=condition)
    end associate
  end subroutine add_wall

  subroutine find_group_centres(model, centre)
    !! Middles of the water's weights in every cell's group. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(out) :: centre(:, :)     !! (ndim, n_cell) [m]

    centre = 0.0_wp
    if (.not. model%coupled) return
    call sum_places(model, model%mesh%water_weight, centre)
    call model%mesh%average%group_means(model%comm, model%grid, ndim, centre)
  end subroutine find_group_centres

  subroutine find_middles(model, condition, at, is_held)
    !! Middles of the pieces of surface in every cell that bear a condition, from the cell's hats.
    !! Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: condition
    real(wp), intent(out) :: at(:, :)        !! (ndim, n_cell) [m]
    logical, intent(out) :: is_held(:)       !! (n_cell) has such pieces
    real(wp) :: sums(1 + ndim, model%grid%n_cell), hat
    integer :: c, e, i, k, p

    sums = 0.0_wp
    associate (forces => model%skeleton%surface_forces, &
               area => model%surface%field(model%s%area)%values)
      do e = 1, size(forces%entry_point)
        if (forces%entry_condition(e) /= condition) cycle
        p = forces%entry_point(e)
        do k = 1, forces%n_part
          c = forces%cell(k, p)
          if (c == 0) cycle
          do i = 1, 2**ndim
            hat = area(1, p)*forces%weight(i, k, p)
            sums(:, c) = sums(:, c) + hat*[1.0_wp, real(model%grid%corner_index(i, c), wp)]
          end do
        end do
      end do
    end associate
    call model%grid%cell_map%sum_copies(model%comm, 1 + ndim, sums)
    is_held = sums(1, :) > 0.0_wp
    at = 0.0_wp
    do c = 1, model%grid%n_cell
      if (is_held(c)) at(:, c) = model%grid%origin + model%grid%spacing*sums(2:, c)/sums(1, c)
    end do
  end subroutine find_middles

  subroutine sum_places(model, weight, sums)
    !! Weights times positions of this rank's particles in every cell.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: weight(:)     !! of the particles [m3]
    real(wp), intent(out) :: sums(:, :)   !! (ndim, n_cell) [m4]
    real(wp) :: one(size(sums, 2))
    integer :: a

    associate (n => model%particles%count)
      do a = 1, ndim
        call cell_sums(n, model%mesh%cell, weight, &
                       model%particles%field(model%p%position)%values(a, 1:n), size(one), one)
        sums(a, :) = one
      end do
    end associate
  end subroutine sum_places

  subroutine find_changes(model, at, by_group, change)
    !! Initial effective stresses at a point of every cell less their mean over the particles of
    !! the cell's host, or group. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: at(:, :)        !! (ndim, n_cell) [m]
    logical, intent(in) :: by_group
    real(wp), intent(out) :: change(:, :)   !! (nsig, n_cell), tension positive [Pa]
    real(wp) :: whole(model%grid%n_cell), of_particle(nsig)
    integer :: c, g, k, p

    change = 0.0_wp
    whole = 1.0_wp/max(model%mesh%average%cell_inverse, tiny(1.0_wp))
    if (by_group .and. model%mesh%quadrature%has_groups) then
      whole = 1.0_wp/max(model%mesh%average%group_inverse, tiny(1.0_wp))
    end if
    do p = 1, model%particles%count
      g = model%mesh%quadrature%group(model%mesh%cell(p))
      do k = model%mesh%quadrature%member_start(g), model%mesh%quadrature%member_start(g + 1) - 1
        c = model%mesh%quadrature%member(k)
        if (.not. by_group .and. model%mesh%quadrature%host(c) /= model%mesh%cell(p)) cycle
        associate (x => model%particles%field(model%p%position)%values(:, p))
          of_particle = initial_stress_change(model%scene, model%material(p), model%coupled, x, &
                                              at(:, c) - x)
        end associate
        change(:, c) = change(:, c) + model%mesh%weight(p)/ &
                       whole(merge(g, model%mesh%cell(p), by_group))*of_particle
      end do
    end do
    call model%grid%cell_map%sum_copies(model%comm, nsig, change)
  end subroutine find_changes

  pure subroutine add_water(model, at, centre, is_wanted, change)
    !! Takes off the change of water's pressure between the middle of a group's particles and a
    !! point: rho_w g.x, as at rest.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: at(:, :)           !! (ndim, n_cell) [m]
    real(wp), intent(in) :: centre(:, :)       !! (ndim, n_cell) these middles [m]
    logical, intent(in) :: is_wanted(:)
    real(wp), intent(inout) :: change(:, :)    !! (nsig, n_cell) of total stress [Pa]
    real(wp) :: pressure
    integer :: a, c

    if (.not. model%coupled .or. model%unsaturated) return
    do c = 1, model%grid%n_cell
      if (.not. is_wanted(c)) cycle
      pressure = model%scene%water%density* &
                 dot_product(model%scene%gravity, at(:, c) - centre(:, c))
      do a = 1, n_volume
        change(volume_slot(a), c) = change(volume_slot(a), c) - pressure
      end do
    end do
  end subroutine add_water
end module dosui_cut_weight

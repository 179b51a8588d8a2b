!! The inertia of the pore water in Darcy's law, with the skeleton's acceleration (u-p form):
!!
!!     w = - k (grad h + rho_w a/gamma_w)
!!
!! ([Zienkiewicz1980]; the water's acceleration relative to the skeleton is left
!! out). Its part of the flow is that of k rho_w a/gamma_w, carried by the nodes: what it brings to
!! a cell is the divergence there, and impervious surfaces that accelerate get the head's gradient
!! that stops it.
!!
!! Where pressures settle within a step they follow the accelerations, which they make in turn,
!! one step late: that is negative damping. So accelerations are extrapolated by a step, by the
!! share x/(1 + x) with x = dt k/(gamma_w S h^2). Of the modes of a staggered step none then grows
!! as long as the head operator's eigenvalue is at least 0.7 of the cells'. It is less for the
!! shortest waves: so what inertia brings is smoothed once over neighbouring cells, which keeps its
!! sum and removes waves of two cells.
module dosui_fluid_inertia
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, volume_slot
  use dosui_cell_average, only: cell_sums
  use dosui_model, only: model_t
  use dosui_shape_functions, only: group_count, n_group, n_group_wide
  implicit none
  private

  public :: find_mobility, find_inertia_flow, forget_inertia_flow

contains

  subroutine find_mobility(model)
    !! k rho_w/gamma_w and k/(gamma_w S h^2) at the nodes, means of the particles around by their
    !! weights. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: sums(:, :)
    real(wp) :: share(n_group*n_group_wide), gradient(n_group*n_group_wide*ndim)
    real(wp) :: mobility(2)
    integer :: i, node, p

    if (.not. model%water%inertia_drives) return
    allocate (sums(3, model%grid%n_node), source=0.0_wp)
    associate (field => model%particles%field, grid => model%grid)
      do p = 1, model%particles%count
        mobility = mobilities(model, p)
        call grid%weigh(p, 1, model%mesh%patch(p:p), field(model%p%position)%values(:, p:p), &
                        group_count(grid%shape_kind), share, gradient)
        do i = 1, size(grid%patch_node, 1)
          node = grid%patch_node(i, model%mesh%patch(p))
          sums(:, node) = sums(:, node) + &
                          max(share(i), 0.0_wp)*model%mesh%weight(p)*[1.0_wp, mobility]
        end do
      end do
    end associate
    call model%grid%node_map%sum_copies(model%comm, 3, sums)
    do i = 1, model%grid%n_node
      if (sums(1, i) > 0.0_wp) sums(2:, i) = sums(2:, i)/sums(1, i)
    end do
    model%water%mobility = sums(2:, :)
  end subroutine find_mobility

  pure function mobilities(model, p) result(mobility)
    !! k rho_w/gamma_w [s] and k/(gamma_w S h^2) [1/s] of a particle.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp) :: mobility(2)

    associate (field => model%particles%field, water => model%scene%water)
      mobility = field(model%p%conductivity)%values(1, p)/water%unit_weight* &
                 [water%density*model%scene%mechanics%density_scaling, &
                  1.0_wp/(model%water%storage%compressibility(p)*model%grid%spacing**2)]
      if (.not. model%unsaturated) return
      mobility = mobility*model%water%retention(model%material(p))% &
                 relative_conductivity(field(model%p%pore_pressure)%values(1, p))
    end associate
  end function mobilities

  pure elemental real(wp) function ahead(now, before, rate, dt)
    !! A value extrapolated by as much of a step as pressures settle in it.
    real(wp), intent(in) :: now, before
    real(wp), intent(in) :: rate   !! k/(gamma_w S h^2) [1/s]
    real(wp), intent(in) :: dt     !! [s]

    ahead = now + rate*dt/(1.0_wp + rate*dt)*(now - before)
  end function ahead

  subroutine forget_inertia_flow(model)
    !! No flow by inertia, as before the first step.
    type(model_t), intent(inout) :: model

    if (.not. model%water%inertia_drives) return
    model%water%inertia_strain = spread(0.0_wp, 1, model%particles%count)
    model%water%inertia_flux = spread(0.0_wp, 1, model%surface%count + model%surface%ghost_count)
  end subroutine forget_inertia_flow

  subroutine find_inertia_flow(model)
    !! The flow by the nodes' accelerations in the step at hand. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: push(:, :), strain(:, :), flux(:, :), mean(:)
    real(wp) :: shaking(ndim)
    real(wp), allocatable :: rate(:)   ! of the pressures at surface points [1/s]
    real(wp) :: now, mobility(2)
    integer :: a, i, m, p

    if (.not. model%water%inertia_drives) return
    call forget_inertia_flow(model)
    if (model%unsaturated) call find_mobility(model)   ! it follows the pressures
    shaking = 0.0_wp
    if (model%scene%base_motion%is_given) then
      shaking = model%scene%base_motion%acceleration* &
                model%scene%base_motion%pattern%at(spread(0.0_wp, 1, ndim), model%clock%time)
    end if
    allocate (push(ndim, model%grid%n_node))
    do i = 1, model%grid%n_node
      associate (change => model%skeleton%velocity(:, i) - model%skeleton%velocity_old(:, i))
        push(:, i) = model%water%mobility(1, i)*(change/model%clock%dt + shaking)
      end associate
    end do
    if (model%skeleton%centred) then
      allocate (strain(nsig, model%grid%n_cell), mean(model%grid%n_cell))
      call model%mesh%quadrature%strains(model%grid, model%clock%dt, push, strain)
      mean = 0.0_wp
      do a = 1, n_volume
        mean = mean + strain(volume_slot(a), :)
      end do
      call smooth(model, mean)
      model%water%inertia_strain = mean(model%mesh%cell)
    else
      call find_at_particles(model, push)
    end if
    associate (before => model%particles%field(model%p%inertia_rate)%values)
      do p = 1, model%particles%count
        now = model%water%inertia_strain(p)/model%clock%dt
        mobility = mobilities(model, p)
        model%water%inertia_strain(p) = model%clock%dt*ahead(now, before(1, p), mobility(2), &
                                                             model%clock%dt)
        before(1, p) = now
      end do
    end associate
    m = model%surface%count
    allocate (flux(ndim, m), rate(m))
    call model%skeleton%surface_forces%point_velocity(push, flux)
    call model%skeleton%surface_forces%values_of(model%water%mobility(2, :), rate)
    associate (before => model%surface%field(model%s%inertia_rate)%values)
      do p = 1, m
        now = dot_product(flux(:, p), model%surface%field(model%s%normal)%values(:, p))
        model%water%inertia_flux(p) = ahead(now, before(1, p), rate(p), model%clock%dt)
        before(1, p) = now
      end do
    end associate
    call model%water%surface_map%gather(model%comm, 1, model%water%inertia_flux)
  end subroutine find_inertia_flow

  subroutine find_at_particles(model, push)
    !! Divergences where the volume change is that of the particles, or their means over cells.
    !! Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: push(:, :)   !! (ndim, n_node) [m/s]
    real(wp) :: share(n_group*n_group_wide), gradient(n_group*n_group_wide*ndim)
    real(wp), allocatable :: mean(:)
    integer :: a, i, p, padded

    padded = n_group*group_count(model%grid%shape_kind)
    associate (grid => model%grid, position => model%particles%field(model%p%position)%values)
      do p = 1, model%particles%count
        call grid%weigh(p, 1, model%mesh%patch(p:p), position(:, p:p), &
                        group_count(grid%shape_kind), &
                        share, gradient)
        do i = 1, size(grid%patch_node, 1)
          do a = 1, ndim
            model%water%inertia_strain(p) = model%water%inertia_strain(p) + model%clock%dt* &
                                            gradient(i + (a - 1)*padded)* &
                                            push(a, grid%patch_node(i, model%mesh%patch(p)))
          end do
        end do
      end do
    end associate
    if (.not. model%skeleton%averaged) return
    allocate (mean(model%grid%n_cell))
    call cell_sums(model%particles%count, model%mesh%cell, model%mesh%weight, &
                   model%water%inertia_strain, &
                   model%grid%n_cell, mean)
    call model%mesh%average%cell_means(model%comm, model%grid, 1, mean)
    call smooth(model, mean)
    model%water%inertia_strain = mean(model%mesh%cell)
  end subroutine find_at_particles

  subroutine smooth(model, mean)
    !! Means of cells go to their corners and back, by the cells' weights. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(inout) :: mean(:)   !! of the cells
    real(wp) :: sums(2, model%grid%n_node)
    integer :: c, i

    sums = 0.0_wp
    associate (grid => model%grid, weight => model%mesh%average%cell_weight)
      do c = 1, grid%n_cell   ! weights are this rank's part
        do i = 1, 2**ndim
          sums(:, grid%cell_node(i, c)) = sums(:, grid%cell_node(i, c)) + &
                                          weight(c)*[1.0_wp, mean(c)]
        end do
      end do
      call grid%node_map%sum_copies(model%comm, 2, sums)
      do i = 1, grid%n_node
        if (sums(1, i) > 0.0_wp) sums(2, i) = sums(2, i)/sums(1, i)
      end do
      do c = 1, grid%n_cell
        mean(c) = sum(sums(2, grid%cell_node(:, c)))/2**ndim
      end do
    end associate
  end subroutine smooth
end module dosui_fluid_inertia

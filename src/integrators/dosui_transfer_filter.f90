!! The times in which AFLIP forgets what particles have beside the grid's velocities.
!!
!! A particle keeps the share exp(-dt/tau) of the velocity that the nodes do not see. tau belongs to
!! the soil and the grid, not to the step: filtering once a step, as PIC and APIC do, makes losses
!! that grow with the number of steps. tau = 2 h/c_s is where run-outs no longer change and the
!! noise that is left is a few per cent (docs/theory/skeleton.md). Soils without stiffness have what
!! falls by a cell: sqrt(h/g)/3.
module dosui_transfer_filter
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig
  use dosui_hourglass, only: elastic_tangent
  use dosui_model, only: model_t
  implicit none
  private

  public :: set_filter_times, spread_filter_times

  real(wp), parameter :: per_shear_wave = 2.0_wp        !! tau over h/c_s [-]
  real(wp), parameter :: per_fall = 1.0_wp/3.0_wp       !! tau over sqrt(h/g), at most [-]
  real(wp), parameter :: never = 1.0e30_wp              !! tau without stiffness and weight [s]

contains

  subroutine set_filter_times(model)
    !! Times of the particles, from their elastic shear moduli and densities as they are now.
    !! Collective.
    type(model_t), intent(inout) :: model
    real(wp) :: tangent(nsig, nsig), modulus, density, longest
    integer :: p

    if (model%p%filter_time == 0) return
    longest = never
    if (norm2(model%scene%gravity) > 0.0_wp) then
      longest = per_fall*sqrt(model%grid%spacing/norm2(model%scene%gravity))
    end if
    associate (field => model%particles%field, h => model%p)
      associate (time => field(h%filter_time)%values)
        do p = 1, model%particles%count
          time(1, p) = model%scene%mechanics%filter_time
          if (time(1, p) > 0.0_wp) cycle
          time(1, p) = longest
          if (model%scene%material(model%material(p))%rigid) cycle
          call elastic_tangent(model, p, tangent)
          modulus = 0.5_wp*(tangent(1, 1) - tangent(1, 2))   ! G of an isotropic tangent
          density = field(h%mass)%values(1, p)/field(h%volume)%values(1, p)
          if (modulus > 0.0_wp) time(1, p) = min(longest, per_shear_wave*model%grid%spacing* &
                                                 sqrt(density/modulus))
        end do
      end associate
    end associate
    call spread_filter_times(model)
  end subroutine set_filter_times

  subroutine spread_filter_times(model)
    !! One time if all particles have the same, else those of nodes: means over the particles whose
    !! patches hold the node, weighted with mass, so that a stiff base does not filter a soft slope.
    !! Any times of nodes keep the momentum; they stay until the next build of the grid. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: sums(:, :)
    integer, allocatable :: patch(:), cell(:)   ! where particles were when the grid was built
    real(wp) :: shortest, longest, mass
    integer :: i, n_lost, p, place

    if (model%p%filter_time == 0) return
    if (allocated(model%skeleton%node_filter_time)) deallocate (model%skeleton%node_filter_time)
    if (allocated(model%skeleton%node_share)) deallocate (model%skeleton%node_share)
    place = model%p%build_position
    associate (time => model%particles%field(model%p%filter_time)%values(1, :), &
               n => model%particles%count)
      shortest = huge(1.0_wp)
      longest = 0.0_wp
      if (n > 0) then
        shortest = minval(time(1:n))
        longest = maxval(time(1:n))
      end if
      shortest = model%comm%minimum(shortest)
      longest = model%comm%maximum(longest)
      model%skeleton%filter_time = longest
      if (.not. longest > 0.0_wp) model%skeleton%filter_time = never   ! not set yet
      if (.not. longest > shortest) return
      allocate (patch(n), cell(n), source=0)
      call model%grid%locate(n, model%particles%field(place)%values(:, 1:n), patch, cell, n_lost)
      allocate (sums(2, model%grid%n_node), source=0.0_wp)
      do p = 1, n
        mass = model%particles%field(model%p%mass)%values(1, p)
        do i = 1, size(model%grid%patch_node, 1)
          associate (node => model%grid%patch_node(i, patch(p)))
            sums(:, node) = sums(:, node) + mass*[1.0_wp, time(p)]
          end associate
        end do
      end do
    end associate
    call model%grid%node_map%sum_copies(model%comm, 2, sums)
    allocate (model%skeleton%node_filter_time(model%grid%n_node), source=longest)
    do i = 1, model%grid%n_node
      if (sums(1, i) > 0.0_wp) model%skeleton%node_filter_time(i) = sums(2, i)/sums(1, i)
    end do
  end subroutine spread_filter_times
end module dosui_transfer_filter

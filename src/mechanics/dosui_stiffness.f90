!! Matrices of the grid's cells: stiffness of the skeleton and the volume change that the water
!! sees, from the same strain operators as the explicit step, so that forces are exact derivatives.
!!
!! A particle's strain is E_p u with
!!     E_p = dev(B_p - mean of B) + C                    means of cells from one gradient C
!!     E_p = B_p + (tr mean of B - tr B_p) I/ndim        averaged volume change (B-bar)
!!     E_p = B_p                                         every particle by itself
!! With finite strains the first shift is made in the gradients of the undeformed particles, the
!! second in those of the deformed ones.
!! and the stiffness of a cell is sum w E^T D E (the first is the adjoint pair of
!! `dosui_cell_quadrature`: the cross terms of mean and deviation vanish for a uniform D).
module dosui_stiffness
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, voigt_slot, volume_slot
  use dosui_cell_quadrature, only: hat_gradients
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: group_count, n_group, n_group_wide, patch_weights
  implicit none
  private

  public :: cell_lists, cell_strain_operators, hourglass_operators

  type, public :: cell_operators_t
    !! Strain operators of one cell's particles on the cell's own list of nodes.
    integer :: n_node = 0
    integer, allocatable :: node(:)            !! (n_node)
    real(wp), allocatable :: strain(:, :, :)   !! (nsig, ndim*n_node, particles) E_p [1/m]
    real(wp), allocatable :: gradient(:, :, :) !! (ndim, n_node, particles), if deformed [1/m]
    real(wp), allocatable :: volume(:, :)      !! (ndim*n_node, particles) volume strain [1/m]
  end type cell_operators_t

contains

  pure subroutine cell_lists(n, cell, n_cell, start, particle)
    !! Particles of each cell, in increasing order.
    integer, intent(in) :: n, n_cell
    integer, intent(in) :: cell(n)
    integer, allocatable, intent(out) :: start(:)      !! (n_cell + 1)
    integer, allocatable, intent(out) :: particle(:)   !! (n)
    integer, allocatable :: next(:)
    integer :: p, c

    allocate (start(n_cell + 1), source=0)
    allocate (particle(n))
    do p = 1, n
      start(cell(p) + 1) = start(cell(p) + 1) + 1
    end do
    start(1) = 1
    do c = 1, n_cell
      start(c + 1) = start(c) + start(c + 1)
    end do
    next = start
    do p = 1, n
      particle(next(cell(p))) = p
      next(cell(p)) = next(cell(p)) + 1
    end do
  end subroutine cell_lists

  subroutine cell_strain_operators(grid, cell, patch, position, weight, averaged, operators, &
                                   centre, inverse, reference, mean_node, mean_volume, &
                                   particle)
    !! Strain operators of the particles of one cell.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    integer, intent(in) :: patch(:)            !! of the cell's particles
    real(wp), intent(in) :: position(:, :)     !! (ndim, particles) [m]
    real(wp), intent(in) :: weight(:)          !! (particles) [m3]
    logical, intent(in) :: averaged            !! volume change is averaged over the cell
    type(cell_operators_t), intent(inout) :: operators
    real(wp), intent(in), optional :: centre(:, :)
    !! (nsig, ndim*nodes) C on the cell's corners or the nodes of `mean_node`, lifts included: means
    !! come from it [1/m]
    real(wp), intent(in), optional :: inverse(:, :, :)
    !! (ndim, ndim, particles) F^-1: gradients belong to the deformed places [-]
    real(wp), intent(in), optional :: reference(:)
    !! (particles) with `inverse` and `centre`: undeformed volumes, with which the mean of the
    !! gradients becomes that of C before anything is deformed [m3]
    integer, intent(in), optional :: mean_node(:)   !! nodes of the cell's group
    real(wp), intent(in), optional :: mean_volume(:)
    !! (ndim*nodes) likewise: volume change that the water sees [1/m]
    integer, intent(in), optional :: particle(:)   !! numbers, where domains follow the deformation
    real(wp), allocatable :: domain(:, :)   ! half domains that follow the deformation [h]
    real(wp), allocatable :: w(:), gradient(:), own(:, :, :), mean(:, :), trace(:), mean_trace(:)
    integer, allocatable :: local(:), mean_nodes(:)
    integer :: m, n_groups, n_patch_node, p, i, k, a, b, column
    logical :: is_centred

    m = size(patch)
    n_groups = group_count(grid%shape_kind)
    n_patch_node = size(grid%patch_node, 1)
    allocate (w(n_group*n_group_wide*m), gradient(n_group*n_group_wide*ndim*m))
    if (allocated(grid%domain) .and. present(particle)) domain = grid%domain(:, particle)
    call patch_weights(grid%shape_kind, grid%half_domain, grid%origin, grid%spacing, m, patch, &
                       position, grid%n_patch, grid%patch_base, grid%patch_fold, n_groups, w, &
                       gradient, domain)
    mean_nodes = grid%cell_node(:, cell)
    if (present(mean_node)) mean_nodes = mean_node
    call collect_nodes(grid, cell, patch, present(centre) .or. present(inverse), mean_nodes, &
                       operators)
    if (allocated(operators%strain)) deallocate (operators%strain, operators%volume)
    allocate (own(nsig, ndim*operators%n_node, m), source=0.0_wp)
    allocate (operators%volume(ndim*operators%n_node, m), source=0.0_wp)
    if (present(inverse)) call find_gradients()
    do p = 1, m
      if (present(inverse)) then
        do i = 1, operators%n_node
          call add_slope(i, operators%gradient(:, i, p))
        end do
        cycle
      end if
      local = places(operators, grid%patch_node(:, patch(p)))
      do i = 1, n_patch_node
        call add_slope(local(i), [(slope(i, b, p), b=1, ndim)])
      end do
    end do
    is_centred = present(centre) .and. .not. present(inverse)   ! deformed gradients are already
    if (averaged .or. is_centred) then
      allocate (mean(nsig, ndim*operators%n_node), source=0.0_wp)
      do p = 1, m
        mean = mean + weight(p)/sum(weight)*own(:, :, p)
      end do
    end if
    if (is_centred) then
      do p = 1, m
        own(:, :, p) = own(:, :, p) - mean
        call add_trace(-trace_of(own(:, :, p)), own(:, :, p))
      end do
      local = places(operators, mean_nodes)
      do i = 1, size(local)
        do a = 1, ndim
          column = ndim*(local(i) - 1) + a
          do p = 1, m
            own(:, column, p) = own(:, column, p) + centre(:, ndim*(i - 1) + a)
          end do
        end do
      end do
    else if (averaged) then
      mean_trace = trace_of(mean)
      do p = 1, m
        trace = trace_of(own(:, :, p))
        call add_trace(mean_trace - trace, own(:, :, p))
      end do
    end if
    if (present(mean_volume)) then
      local = places(operators, mean_nodes)
      do i = 1, size(local)
        do a = 1, ndim
          operators%volume(ndim*(local(i) - 1) + a, :) = mean_volume(ndim*(i - 1) + a)
        end do
      end do
    else
      do p = 1, m
        operators%volume(:, p) = trace_of(own(:, :, p))
      end do
    end if
    call move_alloc(own, operators%strain)

  contains

    subroutine add_slope(place, gradient_of_node)
      !! Strain of particle p by the motion of a node in the cell's list.
      integer, intent(in) :: place
      real(wp), intent(in) :: gradient_of_node(ndim)   !! [1/m]

      do a = 1, ndim
        column = ndim*(place - 1) + a
        do b = 1, ndim
          k = voigt_slot(a, b)
          own(k, column, p) = own(k, column, p) + gradient_of_node(b)
        end do
      end do
    end subroutine add_slope

    subroutine find_gradients()
      !! The particles' gradients on the cell's nodes, with respect to the deformed places:
      !! F^-T grad_X N.
      real(wp) :: average(ndim, operators%n_node)
      integer :: number, node, d

      if (allocated(operators%gradient)) deallocate (operators%gradient)
      allocate (operators%gradient(ndim, operators%n_node, m), source=0.0_wp)
      do number = 1, m
        local = places(operators, grid%patch_node(:, patch(number)))
        do node = 1, n_patch_node
          do d = 1, ndim
            operators%gradient(d, local(node), number) = &
              operators%gradient(d, local(node), number) + slope(node, d, number)
          end do
        end do
      end do
      if (present(centre)) then
        average = 0.0_wp
        do number = 1, m
          average = average + reference(number)/sum(reference)*operators%gradient(:, :, number)
        end do
        local = places(operators, mean_nodes)
        do number = 1, m
          operators%gradient(:, :, number) = operators%gradient(:, :, number) - average
          do node = 1, size(local)
            do d = 1, ndim
              operators%gradient(d, local(node), number) = &
                operators%gradient(d, local(node), number) + &
                centre(voigt_slot(d, d), ndim*(node - 1) + d)
            end do
          end do
        end do
      end if
      do number = 1, m
        operators%gradient(:, :, number) = matmul(transpose(inverse(:, :, number)), &
                                                  operators%gradient(:, :, number))
      end do
    end subroutine find_gradients

    pure real(wp) function slope(node, direction, number)
      !! Gradient of a node of a particle's patch [1/m].
      integer, intent(in) :: node, direction, number
      integer :: per_particle

      per_particle = n_group*n_groups
      slope = gradient(per_particle*(ndim*(number - 1) + direction - 1) + node)
    end function slope
  end subroutine cell_strain_operators

  subroutine hourglass_operators(spacing, strain)
    !! Deviations of the hats' strains at the 2**ndim Gauss points of a full cell from their mean:
    !! the modes that a single particle does not see [Flanagan1981].
    real(wp), intent(in) :: spacing                                     !! [m]
    real(wp), intent(out) :: strain(nsig, ndim*2**ndim, 2**ndim)        !! [1/m]
    real(wp) :: gradient(ndim, 2**ndim), place(ndim), mean(nsig, ndim*2**ndim)
    integer :: g, i, a, b, d, k

    strain = 0.0_wp
    do g = 1, 2**ndim
      do d = 1, ndim
        place(d) = 0.5_wp + merge(0.5_wp, -0.5_wp, btest(g - 1, d - 1))/sqrt(3.0_wp)
      end do
      call hat_gradients(place, spread(0.0_wp, 1, ndim), spacing, gradient)
      do i = 1, 2**ndim
        do a = 1, ndim
          do b = 1, ndim
            k = voigt_slot(a, b)
            strain(k, ndim*(i - 1) + a, g) = strain(k, ndim*(i - 1) + a, g) + gradient(b, i)
          end do
        end do
      end do
    end do
    mean = sum(strain, dim=3)/real(2**ndim, wp)
    do g = 1, 2**ndim
      strain(:, :, g) = strain(:, :, g) - mean
      call add_trace(-trace_of(strain(:, :, g)), strain(:, :, g))
    end do
  end subroutine hourglass_operators

  pure function trace_of(strain) result(trace)
    !! Volume strain of each column, over the scene's directions.
    real(wp), intent(in) :: strain(:, :)   !! (nsig, columns)
    real(wp) :: trace(size(strain, 2))
    integer :: a

    trace = 0.0_wp
    do a = 1, n_volume
      trace = trace + strain(volume_slot(a), :)
    end do
  end function trace_of

  pure subroutine add_trace(change, strain)
    !! Adds a volume strain in equal parts over the scene's directions.
    real(wp), intent(in) :: change(:)
    real(wp), intent(inout) :: strain(:, :)   !! (nsig, columns)
    integer :: a

    do a = 1, n_volume
      strain(volume_slot(a), :) = strain(volume_slot(a), :) + change*(1.0_wp/n_volume)
    end do
  end subroutine add_trace

  subroutine collect_nodes(grid, cell, patch, with_corners, others, operators)
    !! All nodes of the particles' patches, and of the cell and its group.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell, patch(:)
    logical, intent(in) :: with_corners
    integer, intent(in) :: others(:)   !! of the group
    type(cell_operators_t), intent(inout) :: operators
    integer :: list(size(grid%patch_node, 1)*size(patch) + 2**ndim + size(others))
    integer :: p, last

    operators%n_node = 0
    last = 0
    if (with_corners) then
      call add(grid%cell_node(:, cell))
      call add(others)
    end if
    do p = 1, size(patch)
      if (patch(p) == last) cycle
      last = patch(p)
      call add(grid%patch_node(:, patch(p)))
    end do
    operators%node = list(1:operators%n_node)

  contains

    subroutine add(nodes)
      !! Adds nodes that are not there yet.
      integer, intent(in) :: nodes(:)
      integer :: i

      do i = 1, size(nodes)
        if (any(list(1:operators%n_node) == nodes(i))) cycle
        operators%n_node = operators%n_node + 1
        list(operators%n_node) = nodes(i)
      end do
    end subroutine add
  end subroutine collect_nodes

  pure function places(operators, nodes) result(local)
    !! Places of nodes in the cell's list.
    type(cell_operators_t), intent(in) :: operators
    integer, intent(in) :: nodes(:)
    integer :: local(size(nodes))
    integer :: i

    do i = 1, size(nodes)
      local(i) = findloc(operators%node, nodes(i), dim=1)
    end do
  end function places
end module dosui_stiffness

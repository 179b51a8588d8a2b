!! What resists deviations of cells that one particle, or none, does not see (hourglass modes).
module dosui_hourglass
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig
  use dosui_model, only: model_t
  use dosui_stiffness, only: cell_lists, hourglass_operators
  implicit none
  private

  public :: elastic_tangent, part_stiffness, find_part_deviations, add_hourglass_forces

  real(wp), parameter, public :: hourglass_stiffness = 0.1_wp
  real(wp), parameter :: least_part = 0.1003_wp   !! of a cell whose nodes may lead others [-]

contains

  subroutine elastic_tangent(model, p, tangent)
    !! Elastic stiffness of a particle [Pa].
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp), intent(out) :: tangent(nsig, nsig)   !! for 2 x shear strains [Pa]

    associate (field => model%particles%field, h => model%p, &
               material => model%materials%item(model%material(p))%model)
      if (h%state > 0) then
        call material%tangent(field(h%effective_stress)%values(:, p), &
                              field(h%state)%values(:, p), tangent)
      else
        call material%tangent(field(h%effective_stress)%values(:, p), &
                              model%skeleton%no_state(:, p), &
                              tangent)
      end if
    end associate
  end subroutine elastic_tangent

  pure real(wp) function part_stiffness(model) result(factor)
    !! Of deviations within cells that share one strain, over the elastic one: all of it where
    !! nothing yields [-].
    type(model_t), intent(in) :: model

    factor = merge(hourglass_stiffness, 1.0_wp, model%materials%is_nonlinear())
  end function part_stiffness

  subroutine find_part_deviations(model, cell, node, deviation, volume)
    !! Strain operators of the parts that share the mean strain of a cell's particles, less this
    !! mean, if one of them is more than a sliver without particle: its nodes do not follow others,
    !! and rows of such cells could move through the body without any mean strain.
    type(model_t), intent(in) :: model
    integer, intent(in) :: cell                               !! with particles
    integer, allocatable, intent(out) :: node(:)
    real(wp), allocatable, intent(out) :: deviation(:, :, :)  !! (nsig, ndim*nodes, parts) [1/m]
    real(wp), allocatable, intent(out) :: volume(:)           !! (parts), none: no such cell [m3]
    integer, allocatable :: member(:)
    real(wp), allocatable :: mean(:, :)
    real(wp) :: part(nsig, ndim*2**ndim)
    integer :: a, c, i, k, column

    allocate (volume(0))
    if (.not. (model%mesh%quadrature%exact .and. &
               model%skeleton%centred) .or. model%mesh%quadrature%fitted) return
    associate (quadrature => model%mesh%quadrature, corner => model%grid%cell_node)
      k = quadrature%group(cell)
      member = quadrature%member(quadrature%member_start(k):quadrature%member_start(k + 1) - 1)
      member = pack(member, quadrature%host(member) == cell)
      if (.not. any(quadrature%is_unseen(model%grid, member, least_part))) return
      allocate (node(0))
      do k = 1, size(member)
        do i = 1, 2**ndim
          if (.not. any(node == corner(i, member(k)))) node = [node, corner(i, member(k))]
        end do
      end do
      volume = quadrature%part(member)
      allocate (deviation(nsig, ndim*size(node), size(member)), source=0.0_wp)
      do k = 1, size(member)
        c = member(k)
        call quadrature%strain_operator(model%grid, c, part)
        do i = 1, 2**ndim
          do a = 1, ndim
            column = ndim*(findloc(node, corner(i, c), dim=1) - 1) + a
            deviation(:, column, k) = part(:, ndim*(i - 1) + a)
          end do
        end do
      end do
    end associate
    allocate (mean(nsig, ndim*size(node)), source=0.0_wp)
    do k = 1, size(member)
      mean = mean + volume(k)/sum(volume)*deviation(:, :, k)
    end do
    do k = 1, size(member)
      deviation(:, :, k) = deviation(:, :, k) - mean
    end do
  end subroutine find_part_deviations

  subroutine add_hourglass_forces(model, motion, force)
    !! Adds the forces by which cells with one particle resist hourglass modes of a motion, and
    !! cells without particle deviations from the mean strain that they share. Collective.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)       !! (ndim, n_node) [m]
    real(wp), intent(inout) :: force(:, :)     !! (ndim, n_node), complete [N]
    real(wp) :: hourglass(nsig, ndim*2**ndim, 2**ndim), tangent(nsig, nsig), share(2**ndim)
    real(wp), allocatable :: internal(:, :), deviation(:, :, :), volume(:)
    integer, allocatable :: start(:), particle(:), node(:)
    integer :: c, k

    if (.not. (model%skeleton%centred .or. model%finite)) return
    call cell_lists(model%particles%count, model%mesh%cell, model%grid%n_cell, start, particle)
    call hourglass_operators(model%grid%spacing, hourglass)
    allocate (internal(ndim, model%grid%n_node), source=0.0_wp)
    do c = 1, model%grid%n_cell
      if (start(c + 1) == start(c)) cycle
      k = particle(start(c))
      call elastic_tangent(model, k, tangent)
      if (start(c + 1) - start(c) == 1) then
        share = hourglass_stiffness/2**ndim*model%mesh%weight(k)
        call resist(model%grid%cell_node(:, c), hourglass, share)
      end if
      call find_part_deviations(model, c, node, deviation, volume)
      if (size(volume) > 0) call resist(node, deviation, part_stiffness(model)*volume)
    end do
    call model%grid%node_map%sum_copies(model%comm, ndim, internal)
    force = force + internal

  contains

    subroutine resist(nodes, operators, volumes)
      !! Forces against the elastic stresses of strains.
      integer, intent(in) :: nodes(:)
      real(wp), intent(in) :: operators(:, :, :)   !! (nsig, ndim*nodes, points) [1/m]
      real(wp), intent(in) :: volumes(:)           !! (points) [m3]
      real(wp) :: way(ndim*size(nodes)), resistance(ndim*size(nodes))
      integer :: p

      way = reshape(motion(:, nodes), [size(way)])
      resistance = 0.0_wp
      do p = 1, size(volumes)
        resistance = resistance + volumes(p)*matmul(matmul(tangent, &
                                                           matmul(operators(:, :, p), way)), &
                                                    operators(:, :, p))
      end do
      internal(:, nodes) = internal(:, nodes) - reshape(resistance, [ndim, size(nodes)])
    end subroutine resist
  end subroutine add_hourglass_forces
end module dosui_hourglass

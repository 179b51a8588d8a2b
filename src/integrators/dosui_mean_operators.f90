!! Strain operators of a cell's particles, with the means of its parts and the lifts of its walls.
module dosui_mean_operators
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, volume_slot
  use dosui_model, only: model_t
  use dosui_stiffness, only: cell_operators_t, cell_strain_operators
  implicit none
  private

  public :: mean_operators, operators_of_cell

  type, public :: means_t
    !! Strain operators of the parts' means; not allocated where means come from particles.
    real(wp), allocatable :: part(:, :, :)   !! (nsig, ndim*2**ndim, n_cell) [1/m]
    real(wp), allocatable :: lift(:, :, :)   !! likewise, of penalty walls, times volumes [m2]
  end type means_t

contains

  subroutine mean_operators(model, means)
    !! Strain operators of the parts' means, and what penalty walls lift. Collective.
    type(model_t), intent(inout) :: model
    type(means_t), intent(out) :: means
    integer :: c, width

    if (.not. model%skeleton%centred) return
    width = nsig*ndim*2**ndim
    allocate (means%part(nsig, ndim*2**ndim, model%grid%n_cell))
    do c = 1, model%grid%n_cell
      call model%mesh%quadrature%strain_operator(model%grid, c, means%part(:, :, c))
    end do
    if (.not. model%skeleton%lifted) return
    call find_lifts(model, width, means%lift)
  end subroutine mean_operators

  subroutine find_lifts(model, width, lifts)
    !! What penalty walls take out of the strains of parts, times their volumes. Collective.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: width   !! numbers of a part
    real(wp), allocatable, intent(out) :: lifts(:, :, :)   !! (nsig, ndim*2**ndim, n_cell) [m2]
    real(wp), allocatable :: lift(:, :)

    allocate (lift(width, model%grid%n_cell), source=0.0_wp)
    associate (field => model%surface%field, h => model%s, m => model%surface%count)
      call model%skeleton%surface_forces%lift_operators(field(h%area)%values(1, 1:m), &
                                                        field(h%normal)%values(:, 1:m), lift)
    end associate
    call model%grid%cell_map%sum_copies(model%comm, width, lift)
    lifts = reshape(lift, [nsig, ndim*2**ndim, model%grid%n_cell])
  end subroutine find_lifts

  subroutine mean_of_cell(model, means, cell, node, strain, volume)
    !! Mean strain of a cell with particles, on the nodes of all parts of its group, lifts included,
    !! and the volume change that the water sees.
    type(model_t), intent(in) :: model
    type(means_t), intent(in) :: means
    integer, intent(in) :: cell
    integer, allocatable, intent(out) :: node(:)
    real(wp), allocatable, intent(out) :: strain(:, :)   !! (nsig, ndim*nodes) [1/m]
    real(wp), allocatable, intent(out) :: volume(:)      !! (ndim*nodes) [1/m]
    integer :: k, i, a, c, first, last, column, list(2**ndim)
    real(wp) :: whole, part(nsig, ndim*2**ndim)

    associate (quadrature => model%mesh%quadrature, corner => model%grid%cell_node)
      first = quadrature%member_start(quadrature%group(cell))
      last = quadrature%member_start(quadrature%group(cell) + 1) - 1
      node = corner(:, cell)
      do k = first, last
        c = quadrature%member(k)
        list = corner(:, c)
        do i = 1, 2**ndim
          if (.not. any(node == list(i))) node = [node, list(i)]
        end do
      end do
      whole = sum(quadrature%part(quadrature%member(first:last)))
      allocate (strain(nsig, ndim*size(node)), volume(ndim*size(node)), source=0.0_wp)
      do k = first, last
        c = quadrature%member(k)
        list = [(findloc(node, corner(i, c), dim=1), i=1, 2**ndim)]
        part = 0.0_wp
        if (allocated(means%lift)) part = means%lift(:, :, c)/whole
        do i = 1, 2**ndim
          do a = 1, ndim
            column = ndim*(list(i) - 1) + a
            associate (own => means%part(:, ndim*(i - 1) + a, c), &
                       lifted => part(:, ndim*(i - 1) + a))
              strain(:, column) = strain(:, column) + lifted
              if (quadrature%host(c) == cell) strain(:, column) = strain(:, column) + &
                                                                  quadrature%share(c)*own
              volume(column) = volume(column) + trace_of(lifted) + &
                               quadrature%part(c)/whole*trace_of(own)
            end associate
          end do
        end do
      end do
    end associate
  end subroutine mean_of_cell

  pure real(wp) function trace_of(strain) result(trace)
    !! Volume strain over the scene's directions.
    real(wp), intent(in) :: strain(nsig)

    trace = sum(strain(volume_slot))
  end function trace_of

  subroutine operators_of_cell(model, cell, particle, means, operators)
    !! Strain operators of a cell's particles.
    type(model_t), intent(in) :: model
    integer, intent(in) :: cell, particle(:)
    type(means_t), intent(in) :: means
    type(cell_operators_t), intent(inout) :: operators
    real(wp), allocatable :: strain(:, :), volume(:)   ! of the cell's mean, if it has one
    integer, allocatable :: node(:)

    if (allocated(means%part)) then
      if (model%mesh%quadrature%exact .and. .not. model%mesh%quadrature%fitted) then
        call mean_of_cell(model, means, cell, node, strain, volume)
        if (model%finite) deallocate (volume)   ! it is that of the deformed cell
      else
        strain = means%part(:, :, cell)
        if (allocated(means%lift) .and. model%mesh%quadrature%measure(cell) > 0.0_wp) then
          strain = strain + means%lift(:, :, cell)/model%mesh%quadrature%measure(cell)
        end if
      end if
    end if
    if (model%finite .and. allocated(strain)) then
      associate (field => model%particles%field)
        call cell_strain_operators(model%grid, cell, model%mesh%patch(particle), &
                                   field(model%p%position)%values(:, particle), &
                                   model%skeleton%own_volume(particle), &
                                   model%skeleton%averaged, operators, &
                                   centre=strain, &
                                   inverse=model%skeleton%inverse_deformation(:, :, particle), &
                                   reference=field(model%p%reference_volume)%values(1, particle), &
                                   mean_node=node)
      end associate
    else if (model%finite) then
      call cell_strain_operators(model%grid, cell, model%mesh%patch(particle), &
                                 model%particles%field(model%p%position)%values(:, particle), &
                                 model%skeleton%own_volume(particle), model%skeleton%averaged, &
                                 operators, &
                                 inverse=model%skeleton%inverse_deformation(:, :, particle))
    else
      call cell_strain_operators(model%grid, cell, model%mesh%patch(particle), &
                                 model%particles%field(model%p%position)%values(:, particle), &
                                 model%mesh%weight(particle), model%skeleton%averaged, operators, &
                                 centre=strain, mean_node=node, mean_volume=volume, &
                                 particle=particle)
    end if
  end subroutine operators_of_cell
end module dosui_mean_operators

!! Does the grid resolve what the scene describes? A material that fills no cell alone has no strain
!! of its own: its cells have the mean of what shares them, whatever the number of particles.
module dosui_resolution
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_keys, only: unpack_key
  use dosui_model, only: model_t
  use dosui_scene, only: scene_t
  use dosui_seeding, only: region_spacing
  use dosui_shapes, only: region_bounds, shape_contains
  use dosui_text, only: to_text, vector_text
  implicit none
  private

  public :: warn_of_loose_nodes, warn_of_thin_regions, warn_of_unseen_cells, fills_a_cell

  real(wp), parameter :: skin = 1.0e-6_wp      !! of a cell, against round-off [-]
  real(wp), parameter :: least_filled = 0.4997_wp   !! of a cell that should hold particles [-]
  real(wp), parameter :: coarse = 1.0_wp + skin   !! largest distance of particles [cells]

contains

  subroutine warn_of_thin_regions(model)
    !! Warnings: regions thinner than a cell, particles farther apart than cells. Collective.
    type(model_t), intent(inout) :: model
    real(wp) :: spacing
    integer :: r

    if (model%rigid) return   ! flow alone needs no grid
    do r = 1, size(model%scene%region)
      associate (scene => model%scene, region => model%scene%region(r))
        if (.not. model%comm%any(fills_a_cell(scene, r, model%comm%rank, model%comm%size))) then
          call model%log%warning(named(scene, r)//': the grid (spacing '// &
                                 to_text(scene%grid_spacing)//' m) does not resolve it, no '// &
                                 "cell holds material '"//trim(region%material)//"' alone")
        end if
        spacing = region_spacing(scene, region)
        if (spacing > coarse*scene%grid_spacing) then
          call model%log%warning(named(scene, r)//': its particles are '//to_text(spacing)// &
                                 ' m apart, more than a cell: some cells hold none')
        end if
      end associate
    end do
  end subroutine warn_of_thin_regions

  subroutine warn_of_loose_nodes(model)
    !! Warnings: nodes beside cut cells that no well-filled node leads, or none in some direction.
    type(model_t), intent(inout) :: model

    if (.not. model%mesh%extension%is_on) return
    associate (extension => model%mesh%extension)
      if (extension%n_short > 0) then
        call model%log%warning(to_text(extension%n_short)//' nodes beside cut cells have '// &
                               'well-filled nodes in some directions only, the first at '// &
                               place_of(model, extension%first_short)//': a body is thinner '// &
                               'than two cells there, and its strains across are not its own')
      end if
      if (extension%n_orphan > 0) then
        call model%log%warning(to_text(extension%n_orphan)//' nodes beside cut cells have no '// &
                               'well-filled node near, the first at '// &
                               place_of(model, extension%first_orphan)//': they are free, '// &
                               'and little holds them')
      end if
    end associate
  end subroutine warn_of_loose_nodes

  subroutine warn_of_unseen_cells(model)
    !! Warning: cells that the bodies fill, but without particle. Collective.
    type(model_t), intent(inout) :: model
    integer(i8) :: first
    integer :: c, n

    if (.not. model%mesh%quadrature%exact .or. model%mesh%quadrature%fitted) return
    n = 0
    first = huge(first)
    do c = 1, model%grid%n_cell
      if (.not. model%grid%cell_map%is_owned(c)) cycle
      if (.not. model%mesh%quadrature%is_unseen(model%grid, c, least_filled)) cycle
      n = n + 1
      first = min(first, model%grid%cell_key(c))
    end do
    n = model%comm%sum(n)
    first = model%comm%minimum(first)
    if (n == 0) return
    associate (corner => unpack_key(first))
      call model%log%warning(to_text(n)//' cells within the bodies hold no particle, the first '// &
                             'at '//place_of(model, corner(1:ndim))//': they share the stress '// &
                             'of particles beside them, and explicit steps let them swing; '// &
                             'more particles_per_cell, or less jitter')
    end associate
  end subroutine warn_of_unseen_cells

  function place_of(model, coordinates) result(text)
    !! A node's place in the scene's coordinates.
    type(model_t), intent(in) :: model
    integer, intent(in) :: coordinates(ndim)
    character(len=:), allocatable :: text

    text = vector_text(model%scene%grid_origin + model%scene%local_origin + &
                       model%scene%grid_spacing*coordinates)//' m'
  end function place_of

  pure logical function fills_a_cell(scene, r, rank, n_rank) result(fills)
    !! Does the material of a region fill a whole cell near it, among this rank's share of cells?
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r             !! region
    integer, intent(in) :: rank, n_rank
    real(wp) :: low(ndim), high(ndim), corner(ndim)
    integer(i8) :: first(ndim), n(ndim), k, rest
    integer :: d

    call region_bounds(scene%region(r), low, high)
    low = (low - scene%grid_origin)/scene%grid_spacing
    high = (high - scene%grid_origin)/scene%grid_spacing
    first = floor(low + skin, i8)
    n = ceiling(high - skin, i8) - first
    fills = .false.
    do k = int(rank, i8), product(n) - 1_i8, int(n_rank, i8)
      rest = k
      do d = 1, ndim
        corner(d) = real(first(d) + mod(rest, n(d)), wp)
        rest = rest/n(d)
      end do
      fills = is_full(scene, r, scene%grid_origin + corner*scene%grid_spacing)
      if (fills) return
    end do
  end function fills_a_cell

  pure logical function is_full(scene, r, corner) result(full)
    !! Do a cell's corners and its middle lie in the material of a region?
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    real(wp), intent(in) :: corner(ndim)   !! lowest one of the cell [m]
    real(wp) :: place(ndim)
    integer :: k, d

    full = lies_in_material(scene, r, corner + 0.5_wp*scene%grid_spacing)
    do k = 0, 2**ndim - 1
      if (.not. full) return
      do d = 1, ndim
        place(d) = merge(1.0_wp - skin, skin, btest(k, d - 1))
      end do
      full = lies_in_material(scene, r, corner + place*scene%grid_spacing)
    end do
  end function is_full

  pure logical function lies_in_material(scene, r, position) result(lies)
    !! Is a position in a region, or in another one of the same material?
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    real(wp), intent(in) :: position(ndim)   !! [m]
    integer :: other

    lies = shape_contains(scene%region(r), position, 0.0_wp)
    do other = 1, size(scene%region)
      if (lies) return
      if (other == r .or. scene%region(other)%material /= scene%region(r)%material) cycle
      lies = shape_contains(scene%region(other), position, 0.0_wp)
    end do
  end function lies_in_material

  function named(scene, r) result(text)
    !! A region, and where it lies.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    character(len=:), allocatable :: text
    real(wp) :: low(ndim), high(ndim)

    call region_bounds(scene%region(r), low, high)
    text = "&region '"//trim(scene%region(r)%name)//"' from "// &
           vector_text(low + scene%local_origin)//' to '// &
           vector_text(high + scene%local_origin)//' m'
  end function named
end module dosui_resolution

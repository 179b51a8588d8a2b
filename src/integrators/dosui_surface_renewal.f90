!! Surface points of free surfaces come and go as bodies tear, spread and meet.
!!
!! At a rebuild of an updated scene `dosui_free_surface` finds the facets of the particles. A facet
!! that no surface point is near gets one of its own; a point of a free surface that no facet is
!! near has nothing to bound any more and is removed. Points in between move with the grid as ever.
!! Points named otherwise stay, and close their facets. Facets on rigid walls, and on bodies that
!! touch, get points without a condition: no water passes there.
module dosui_surface_renewal
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_boundary_points, only: add_point, free_surface_of
  use dosui_free_surface, only: facets_t, find_facets, sight
  use dosui_ghosts, only: find_ghosts
  use dosui_index_map, only: index_map_t
  use dosui_model, only: model_t
  use dosui_neighbours, only: build_neighbours
  use dosui_scene, only: rigid_wall_t
  use dosui_seeding, only: region_spacing
  use dosui_surface_sets, only: set_add, set_holds, set_remove
  implicit none
  private

  public :: renew_surface, free_area

  real(wp), parameter :: near = 0.75_wp + 0.25_wp*ndim   !! a point serves a facet [edges]
  real(wp), parameter :: kept = near + 0.25_wp           !! a facet keeps a point [edges]
  real(wp), parameter :: same_side = 0.3_wp              !! cosine between normals [-]
  integer(i8), parameter :: ids_of_step = 2_i8**36       !! more than particles times facets
  integer(i8), parameter :: steps_of_ids = 2_i8**27 - 2_i8   !! until they repeat: within 63 bits
  real(wp), parameter :: askew(3) = [0.137_wp, 0.071_wp, 0.029_wp]   ! no lattice's direction

contains

  subroutine renew_surface(model, changes)
    !! Marks the particles on free surfaces and, if asked, brings their surface points up to date.
    !! Particles and points lie with their owners. Collective.
    type(model_t), intent(inout) :: model
    logical, intent(in) :: changes
    type(facets_t) :: facets
    logical, allocatable :: is_served(:)
    integer :: f

    call find_model_facets(model, facets)
    associate (mark => model%particles%field(model%p%surface)%values)
      mark = 0.0_wp
      do f = 1, facets%n
        if (facets%is_free(f) .and. facets%is_open(f)) mark(1, facets%particle(f)) = 1.0_wp
      end do
    end associate
    if (.not. changes) return
    call remove_points(model, facets, is_served)
    do f = 1, facets%n
      if (facets%is_open(f) .and. .not. is_served(f)) call give_point(model, facets, f)
    end do
  end subroutine renew_surface

  subroutine find_model_facets(model, facets)
    !! Facets of this rank's particles. Collective.
    type(model_t), intent(inout) :: model
    type(facets_t), intent(out) :: facets
    type(index_map_t) :: map
    type(rigid_wall_t), allocatable :: walls(:)
    real(wp), allocatable :: edge(:)
    integer, allocatable :: row_start(:), neighbour(:)
    real(wp) :: radius
    integer :: n, n_local

    n = model%particles%count
    allocate (edge, source=edges(model))
    radius = search_radius(model, edge)
    allocate (walls(0))
    if (allocated(model%scene%rigid_wall)) walls = model%scene%rigid_wall
    associate (place => model%p%build_position)
      call find_ghosts(model%comm, model%particles, place, n, &
                       model%particles%field(place)%values(:, 1:n), radius, map)
      n_local = n + model%particles%ghost_count
      associate (x => model%particles%field(place)%values)
        call build_neighbours(n, x(:, 1:n), n_local, x(:, 1:n_local), radius, row_start, &
                              neighbour, skip_self=.true.)
        call find_facets(n, x(:, 1:n_local), edge, row_start, neighbour, walls, facets)
      end associate
    end associate
    call model%particles%resize(n)
  end subroutine find_model_facets

  pure function edges(model) result(edge)
    !! Edges of the particles [m]. What has been pulled out by a crack sees no farther for that.
    type(model_t), intent(in) :: model
    real(wp) :: edge(model%particles%count)
    real(wp) :: spacing(size(model%scene%region))
    integer :: k

    spacing = [(region_spacing(model%scene, model%scene%region(k)), k=1, size(spacing))]
    associate (field => model%particles%field, n => model%particles%count)
      edge = min(field(model%p%volume)%values(1, 1:n)**(1.0_wp/real(ndim, wp)), &
                 spacing(nint(field(model%p%region)%values(1, 1:n))))
    end associate
  end function edges

  real(wp) function search_radius(model, edge) result(radius)
    !! Farther than any particle looks for others and for surface points [m]. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: edge(:)
    real(wp) :: largest

    largest = model%scales%spacing
    if (size(edge) > 0) largest = max(largest, maxval(edge))
    radius = 2.0_wp*sight*model%comm%maximum(largest)
  end function search_radius

  subroutine remove_points(model, facets, is_served)
    !! Removes points that bound nothing, and tells facets that have a point. Collective.
    type(model_t), intent(inout) :: model
    type(facets_t), intent(in) :: facets
    logical, allocatable, intent(out) :: is_served(:)   !! facets that a point is near
    type(index_map_t) :: map
    integer, allocatable :: start(:), near_point(:), keep(:)
    real(wp), allocatable :: edge(:), free_claim(:), shut_claim(:)
    real(wp) :: radius, cosine
    integer :: n, m, f, k, p

    n = model%particles%count
    m = model%surface%count
    allocate (edge, source=edges(model))
    radius = search_radius(model, edge)
    associate (place => model%s%build_position)
      call find_ghosts(model%comm, model%surface, place, n, &
                       model%particles%field(model%p%build_position)%values(:, 1:n), radius, map)
      k = m + model%surface%ghost_count
      allocate (is_served(facets%n), source=.false.)
      allocate (free_claim(k), shut_claim(k), source=0.0_wp)
      associate (x => model%surface%field(place)%values, &
                 normal => model%surface%field(model%s%normal)%values)
        call build_neighbours(facets%n, facets%place(:, 1:facets%n), k, x(:, 1:k), &
                              kept/(2.0_wp*sight)*radius, start, near_point, skip_self=.false.)
        do f = 1, facets%n
          do k = start(f), start(f + 1) - 1
            p = near_point(k)
            cosine = dot_product(normal(:, p), facets%normal(:, f))
            if (.not. cosine > same_side) cycle
            associate (distance => norm2(x(:, p) - facets%place(:, f))/edge(facets%particle(f)))
              if (distance > kept) cycle
              if (distance <= near) is_served(f) = .true.
            end associate
            if (facets%is_free(f)) then
              free_claim(p) = min(free_claim(p), -cosine)
            else
              shut_claim(p) = min(shut_claim(p), -cosine)
            end if
          end do
        end do
      end associate
    end associate
    call map%scatter_min(model%comm, 1, free_claim)
    call map%scatter_min(model%comm, 1, shut_claim)
    call model%surface%resize(m)
    associate (field => model%surface%field, h => model%s)
      do p = 1, m
        if (nint(field(h%free)%values(1, p)) == 0) cycle
        associate (free => nint(field(h%free)%values(1, p)), set => field(h%surface)%values(:, p))
          if (shut_claim(p) < free_claim(p)) then
            call set_remove(set, free)
          else
            call set_add(set, free)
          end if
        end associate
      end do
      keep = pack([(p, p=1, m)], nint(field(h%free)%values(1, 1:m)) == 0 .or. &
                  free_claim(1:m) < 0.0_wp .or. shut_claim(1:m) < 0.0_wp)
    end associate
    if (size(keep) == m) return
    model%surface%count = size(keep)
    call model%surface%reorder(keep)
  end subroutine remove_points

  subroutine give_point(model, facets, f)
    !! A new surface point for a facet, if its particle's region has a free surface.
    type(model_t), intent(inout) :: model
    type(facets_t), intent(in) :: facets
    integer, intent(in) :: f
    integer :: region, surface, i, p, sector

    i = facets%particle(f)
    region = nint(model%particles%field(model%p%region)%values(1, i))
    surface = free_surface_of(model%scene, region)
    if (surface == 0) return
    ! one foot of a particle on each patch: sides of a sheet and of an edge are different ones
    sector = maxloc(abs(facets%normal(:, f) + askew(1:ndim)), dim=1)
    if (facets%normal(sector, f) < -askew(sector)) sector = sector + ndim
    sector = sector + 2*ndim*(facets%wall(f) + (size_of_walls(model) + 1)*region)
    call add_point(model%scene, region, &
                   ids_of_step*(1_i8 + mod(model%clock%step, steps_of_ids)) + &
                   16_i8*model%particles%id(i) + int(f - first_of(facets, f), i8), &
                   facets%place(:, f), facets%normal(:, f), facets%area(f), &
                   pack([surface], [facets%is_free(f)]), -sector, &
                   model%surface, model%s)
    p = model%surface%count
    associate (field => model%surface%field, h => model%s, particle => model%particles%field)
      field(h%free)%values(1, p) = real(surface, wp)
      field(h%build_position)%values(:, p) = facets%place(:, f)
      field(h%outward_area)%values(:, p) = facets%area(f)*facets%normal(:, f)
      field(h%displacement)%values(:, p) = particle(model%p%displacement)%values(:, i)
      field(h%velocity)%values(:, p) = particle(model%p%velocity)%values(:, i)
    end associate
  end subroutine give_point

  pure integer function size_of_walls(model) result(n)
    !! Rigid walls of the scene.
    type(model_t), intent(in) :: model

    n = 0
    if (allocated(model%scene%rigid_wall)) n = size(model%scene%rigid_wall)
  end function size_of_walls

  pure integer function first_of(facets, f) result(first)
    !! The first facet of the same particle.
    type(facets_t), intent(in) :: facets
    integer, intent(in) :: f

    first = f
    do while (first > 1)
      if (facets%particle(first - 1) /= facets%particle(f)) exit
      first = first - 1
    end do
  end function first_of

  real(wp) function free_area(model, surface) result(area)
    !! Area of a surface now [m2]. Collective.
    type(model_t), intent(in) :: model
    integer, intent(in) :: surface
    integer :: p

    associate (field => model%surface%field)
      area = 0.0_wp
      do p = 1, model%surface%count
        if (.not. set_holds(field(model%s%surface)%values(:, p), surface)) cycle
        area = area + field(model%s%area)%values(1, p)
      end do
    end associate
    area = model%comm%sum(area)
  end function free_area
end module dosui_surface_renewal

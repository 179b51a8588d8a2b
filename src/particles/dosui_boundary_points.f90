!! Points on the true surface of the body: the outer faces of all regions in pieces.
module dosui_boundary_points
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_barriers, only: barrier_face_t, barrier_faces
  use dosui_communicator, only: communicator_t
  use dosui_face_pieces, only: end_pieces, face_piece, piece_count, region_faces
  use dosui_particle_fields, only: surface_handles_t
  use dosui_point_set, only: point_set_t
  use dosui_scene, only: scene_t
  use dosui_seeding, only: region_spacing
  use dosui_region_bins, only: region_bins_t
  use dosui_shapes, only: face_t, shape_contains
  use dosui_surface_sets, only: rank_mechanical, rank_probe, set_add, surface_ranks
  implicit none
  private

  public :: seed_boundary_points, add_point, free_surface_of

  real(wp), parameter :: probe_depth = 0.25_wp   !! of the look outside [spacings]
  real(wp), parameter :: on_wall = 1.0e-6_wp     !! distance of points on rigid walls [spacings]

contains

  subroutine seed_boundary_points(comm, scene, points, handles, problems)
    !! Seeds the points of all outer faces; a piece covered by another region is interior and left
    !! out. Identities do not depend on the ranks. Surfaces without a point are problems, one a
    !! line. Collective.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    type(point_set_t), intent(inout) :: points
    type(surface_handles_t), intent(in) :: handles
    character(len=:), allocatable, intent(inout) :: problems
    type(face_t), allocatable :: faces(:)
    type(region_bins_t) :: bins
    logical, allocatable :: touched(:)
    real(wp), allocatable :: number(:)   ! of ranks that have points of each surface
    integer :: rank(size(scene%surface))
    integer(i8) :: id
    integer :: r, f, s, patch

    allocate (touched(size(scene%surface)), source=.false.)
    rank = surface_ranks(scene)
    call bins%init(scene%region, scene%grid_spacing)
    id = 0_i8
    patch = 0
    do r = 1, size(scene%region)
      call region_faces(scene%region(r), region_spacing(scene, scene%region(r)), faces)
      do f = 1, size(faces)
        call end_at_boxes(scene, r, rank, faces(f))
        call seed_face(comm, scene, bins, r, faces(f), rank, patch, id, points, handles, touched)
        patch = patch + 1 + size(scene%surface)
      end do
    end do
    if (allocated(scene%barrier)) then
      call seed_barriers(comm, scene, bins, patch, id, points, handles)
    end if
    number = merge(1.0_wp, 0.0_wp, touched)
    call comm%sum_array(number)
    if (handles%free > 0) then   ! free ones may come to be
      where (scene%surface%face == 'free') number = 1.0_wp
    end if
    call tell_untouched(scene, pack([(s, s=1, size(number))], number <= 0.0_wp), problems)
  end subroutine seed_boundary_points

  subroutine tell_untouched(scene, missing, problems)
    !! One problem for each of many surfaces without a point: the text is made in one piece.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: missing(:)   !! surfaces
    character(len=:), allocatable, intent(inout) :: problems
    character(len=*), parameter :: before = "&surface '"
    character(len=*), parameter :: &
      after = "' touches no particle: check region, face and box"//new_line('a')
    character(len=:), allocatable :: text
    integer :: k, n

    n = 0
    allocate (character(len=sum(len_trim(scene%surface(missing)%name)) + &
                        size(missing)*(len(before) + len(after))) :: text)
    do k = 1, size(missing)
      associate (line => before//trim(scene%surface(missing(k))%name)//after)
        text(n + 1:n + len(line)) = line
        n = n + len(line)
      end associate
    end do
    problems = problems//text
  end subroutine tell_untouched

  subroutine end_at_boxes(scene, r, rank, face)
    !! Lets pieces end where surfaces that conditions use do.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r                      !! region of the face
    integer, intent(in) :: rank(:)                !! uses of the surfaces
    type(face_t), intent(inout) :: face
    real(wp), allocatable :: low(:, :), high(:, :)
    integer, allocatable :: named(:)
    integer :: k

    allocate (named, source=surfaces_of(scene, r, face))
    named = pack(named, rank(named) >= rank_mechanical)
    allocate (low(ndim, size(named)), high(ndim, size(named)))
    do k = 1, size(named)
      low(:, k) = scene%surface(named(k))%box_min
      high(:, k) = scene%surface(named(k))%box_max
    end do
    call end_pieces(face, region_spacing(scene, scene%region(r)), scene%grid_spacing, low, high)
  end subroutine end_at_boxes

  subroutine seed_face(comm, scene, bins, r, face, rank, first_patch, id, points, handles, touched)
    !! This rank's share of a face's pieces. A piece belongs to every surface that names it. What
    !! is free, and which pieces are one patch, follows from the surfaces that conditions use (or
    !! nothing): a probe's surface changes nothing.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    type(region_bins_t), intent(in) :: bins       !! of all regions
    integer, intent(in) :: r                      !! region of the face
    type(face_t), intent(in) :: face
    integer, intent(in) :: rank(:)                !! uses of the surfaces, as `surface_ranks` says
    integer, intent(in) :: first_patch
    integer(i8), intent(inout) :: id              !! last identity given out
    type(point_set_t), intent(inout) :: points
    type(surface_handles_t), intent(in) :: handles
    logical, intent(inout) :: touched(:)
    integer(i8) :: total, k, first, last
    integer, allocatable :: named(:), here(:)
    integer :: s, free
    logical :: is_free
    real(wp) :: spacing, x(ndim), normal(ndim), area, edge(ndim, max(ndim - 1, 1))

    free = free_surface_of(scene, r)
    allocate (named, source=surfaces_of(scene, r, face))
    spacing = region_spacing(scene, scene%region(r))
    total = piece_count(face, spacing)
    first = total*comm%rank/comm%size + 1_i8
    last = total*(comm%rank + 1_i8)/comm%size
    do k = first, last
      call face_piece(face, spacing, k, x, normal, area, edge)
      if (.not. area > 0.0_wp) cycle
      if (is_interior(scene, bins, r, x + probe_depth*spacing*normal)) cycle
      here = pack(named, [(lies_in_box(scene, named(s), x), s=1, size(named))])
      is_free = free > 0 .and. all(rank(here) == rank_probe)
      if (is_free .and. .not. lies_on_wall(scene, x, normal, on_wall*spacing)) here = [here, free]
      touched(here) = .true.
      call add_point(scene, r, id + k, x, normal, area, here, first_patch + owner_of(rank, here), &
                     points, handles)
      if (handles%edge > 0) then
        points%field(handles%edge)%values(:, points%count) = reshape(edge, [size(edge)])
      end if
      if (allocated(face%piece_held) .and. handles%held > 0) then
        points%field(handles%held)%values(:, points%count) = face%piece_held(:, k)
      end if
      if (is_free .and. handles%free > 0) then
        points%field(handles%free)%values(1, points%count) = real(free, wp)
      end if
    end do
    id = id + total
  end subroutine seed_face

  pure integer function owner_of(rank, surfaces) result(owner)
    !! The surface that tells a point's patch: the last one with water, else the last one with a
    !! mechanical condition, else one that nothing uses; 0 for none.
    integer, intent(in) :: rank(:)       !! uses of all surfaces
    integer, intent(in) :: surfaces(:)   !! of the point
    integer :: k

    owner = 0
    do k = 1, size(surfaces)
      if (rank(surfaces(k)) == rank_probe) cycle
      if (owner > 0) then
        if (rank(surfaces(k)) < rank(owner)) cycle
      end if
      owner = surfaces(k)
    end do
  end function owner_of

  subroutine add_point(scene, region, id, position, normal, area, surfaces, patch, points, handles)
    !! One more boundary point.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: region              !! whose material it bounds
    integer(i8), intent(in) :: id
    real(wp), intent(in) :: position(ndim)     !! [m]
    real(wp), intent(in) :: normal(ndim)       !! outward [-]
    real(wp), intent(in) :: area               !! [m2]
    integer, intent(in) :: surfaces(:)         !! all that it belongs to; one < 0: of a barrier
    integer, intent(in) :: patch
    type(point_set_t), intent(inout) :: points
    type(surface_handles_t), intent(in) :: handles
    integer :: i, k

    i = points%count + 1
    call points%resize(i)
    points%id(i) = id
    associate (field => points%field)
      field(handles%position)%values(:, i) = position
      field(handles%normal)%values(:, i) = normal
      field(handles%area)%values(1, i) = area
      if (handles%held > 0) field(handles%held)%values(:, i) = normal
      if (handles%edge > 0) field(handles%edge)%values(:, i) = 0.0_wp
      field(handles%surface)%values(:, i) = 0.0_wp
      do k = 1, size(surfaces)
        if (surfaces(k) < 0) field(handles%surface)%values(1, i) = real(surfaces(k), wp)
        call set_add(field(handles%surface)%values(:, i), surfaces(k))
      end do
      field(handles%patch)%values(1, i) = real(patch, wp)
      if (handles%inertia_rate > 0) field(handles%inertia_rate)%values(1, i) = 0.0_wp
      if (handles%has_head > 0) field(handles%has_head)%values(1, i) = 0.0_wp
      if (handles%material > 0) field(handles%material)%values(1, i) = &
        real(findloc(scene%material%name == scene%region(region)%material, .true., dim=1), wp)
    end associate
  end subroutine add_point

  subroutine seed_barriers(comm, scene, bins, last_patch, last_id, points, handles)
    !! This rank's share of the two sides of barriers, as far as they lie in regions.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    type(region_bins_t), intent(in) :: bins   !! of all regions
    integer, intent(in) :: last_patch         !! given out so far
    integer(i8), intent(in) :: last_id        !! likewise
    type(point_set_t), intent(inout) :: points
    type(surface_handles_t), intent(in) :: handles
    type(barrier_face_t), allocatable :: faces(:)
    real(wp) :: x(ndim), spacing
    integer(i8) :: id
    integer :: f, k, r, side

    spacing = minval([(region_spacing(scene, scene%region(r)), r=1, size(scene%region))])
    faces = barrier_faces(scene%barrier, spacing)
    id = last_id
    do f = 1, size(faces)
      do k = 1, product(faces(f)%n_piece(:max(1, ndim - 1)))
        x = faces(f)%centre(k)
        do side = -1, 1, 2
          id = id + 1_i8
          if (mod(k, comm%size) /= comm%rank) cycle
          if (.not. faces(f)%contains(x)) cycle
          r = region_at(scene, bins, x)
          if (r == 0) cycle
          call add_point(scene, r, id, x, real(side, wp)*faces(f)%normal, &
                         product(faces(f)%piece(:max(1, ndim - 1))), [-f], &
                         last_patch + 2*f + max(side, 0), points, handles)
        end do
      end do
    end do
  end subroutine seed_barriers

  pure integer function region_at(scene, bins, position) result(region)
    !! The region that holds a position, 0 for none.
    type(scene_t), intent(in) :: scene
    type(region_bins_t), intent(in) :: bins  !! of all regions
    real(wp), intent(in) :: position(ndim)   !! [m]
    integer :: k

    region = 0
    associate (near => bins%near(position))
      do k = 1, size(near)
        if (shape_contains(scene%region(near(k)), position, 0.0_wp)) region = near(k)
      end do
    end associate
  end function region_at

  pure logical function is_interior(scene, bins, r, outside) result(interior)
    !! Does a position just outside a region lie inside another one?
    type(scene_t), intent(in) :: scene
    type(region_bins_t), intent(in) :: bins   !! of all regions
    integer, intent(in) :: r
    real(wp), intent(in) :: outside(ndim)
    integer :: k

    interior = .false.
    associate (near => bins%near(outside))
      do k = 1, size(near)
        if (near(k) == r) cycle
        if (shape_contains(scene%region(near(k)), outside, 0.0_wp)) interior = .true.
      end do
    end associate
  end function is_interior

  pure function surfaces_of(scene, r, face) result(surfaces)
    !! The surfaces of the scene that name a face or a part of it.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    type(face_t), intent(in) :: face
    integer, allocatable :: surfaces(:)
    integer :: s

    surfaces = pack([(s, s=1, size(scene%surface))], &
                    scene%surface%region == scene%region(r)%name .and. &
                    (scene%surface%face == face%name .or. scene%surface%face == face%solid .or. &
                     scene%surface%face == 'all'))
  end function surfaces_of

  pure logical function lies_in_box(scene, surface, position)
    !! Does the part of a face that a surface keeps hold a position?
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: surface
    real(wp), intent(in) :: position(ndim)   !! [m]

    lies_in_box = all(position >= scene%surface(surface)%box_min) .and. &
                  all(position <= scene%surface(surface)%box_max)
  end function lies_in_box

  pure integer function free_surface_of(scene, region) result(surface)
    !! The surface that takes what no other one of a region names, 0 for none.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: region
    integer :: s

    surface = 0
    do s = 1, size(scene%surface)
      if (scene%surface(s)%face == 'free' .and. &
          scene%surface(s)%region == scene%region(region)%name) surface = s
    end do
  end function free_surface_of

  pure logical function lies_on_wall(scene, position, normal, tolerance)
    !! Does a piece of surface lie on a rigid wall?
    type(scene_t), intent(in) :: scene
    real(wp), intent(in) :: position(ndim)   !! [m]
    real(wp), intent(in) :: normal(ndim)     !! outward [-]
    real(wp), intent(in) :: tolerance        !! [m]
    real(wp) :: wall_normal(ndim)
    integer :: k

    lies_on_wall = .false.
    if (.not. allocated(scene%rigid_wall)) return
    do k = 1, size(scene%rigid_wall)
      wall_normal = scene%rigid_wall(k)%normal/norm2(scene%rigid_wall(k)%normal)
      if (dot_product(position - scene%rigid_wall(k)%position, wall_normal) <= tolerance .and. &
          dot_product(normal, wall_normal) < -0.5_wp) lies_on_wall = .true.
    end do
  end function lies_on_wall
end module dosui_boundary_points

!! Fills regions with particles on regular lattices, or as files tell.
!!
!! Every rank seeds a contiguous share of each region's lattice; identities and jitter depend on
!! the lattice only, so the particles are the same on any number of ranks.
module dosui_seeding
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_keys, only: largest_index
  use dosui_particle_fields, only: particle_handles_t
  use dosui_point_set, only: point_set_t
  use dosui_random, only: hash_uniform
  use dosui_scene, only: region_t, scene_t
  use dosui_region_bins, only: region_bins_t
  use dosui_shapes, only: shape_bounds, shape_contains, shape_measure, turned
  implicit none
  private

  public :: seed_regions, region_spacing, points_along, lattice_parity, grid_reach

  real(wp), parameter :: closest_to_face = 0.1_wp   !! for jittered particles, in spacings [-]
  real(wp), parameter :: round_off = 1.0e-9_wp      !! of a spacing [-]
  real(wp), parameter, public :: most_sites = 5.0e8_wp   !! of a lattice, on each rank

  real(wp), parameter :: most_points = 1.0e18_wp    !! along a side, that 64 bits count

  type :: lattice_t
    !! A regular lattice of n(1) x n(2) x n(3) points around a pivot.
    integer(i8) :: n(ndim) = 0_i8
    real(wp) :: step(ndim) = 0.0_wp     !! [m]
    real(wp) :: first(ndim) = 0.0_wp    !! position of the first point before turning [m]
    real(wp) :: pivot(ndim) = 0.0_wp
    real(wp) :: angle = 0.0_wp          !! [deg]
    logical :: fills_shape = .true.     !! follows the shape: no inside test is needed
  end type lattice_t

contains

  pure real(wp) function region_spacing(scene, region) result(spacing)
    !! Particle spacing of a region [m].
    type(scene_t), intent(in) :: scene
    type(region_t), intent(in) :: region

    spacing = region%particle_spacing
    if (spacing > 0.0_wp) return
    spacing = scene%grid_spacing/real(region%particles_per_cell, wp)
    if (allocated(region%particle)) spacing = (shape_measure(region)/ &
                                        real(size(region%particle, 2), wp))**(1.0_wp/real(ndim, wp))
  end function region_spacing

  pure real(wp) function grid_reach(scene) result(reach)
    !! How far from the local origin the numbers of cells and of neighbourhoods reach [m].
    type(scene_t), intent(in) :: scene
    integer :: r

    reach = scene%grid_spacing
    if (scene%water_mode /= 'none') then
      do r = 1, size(scene%region)
        reach = min(reach, scene%water%support_radius*region_spacing(scene, scene%region(r)))
      end do
    end if
    reach = reach*real(largest_index, wp)
  end function grid_reach

  pure elemental real(wp) function points_along(extent, spacing, grid_spacing) result(n)
    !! Particles along the side of a box: the whole number whose distance is next to the spacing.
    !! A spacing within a cell is not stretched beyond one: rows of cells would hold no particle,
    !! and nothing the nodes beside them [-].
    real(wp), intent(in) :: extent         !! [m]
    real(wp), intent(in) :: spacing        !! [m]
    real(wp), intent(in) :: grid_spacing   !! [m]
    real(wp), parameter :: round_off = 1.0e-9_wp

    n = anint(extent/spacing)
    if (.not. n > 0.0_wp .or. spacing > grid_spacing*(1.0_wp + round_off)) return
    n = max(n, aint(extent/grid_spacing*(1.0_wp - round_off)) + 1.0_wp)
  end function points_along

  pure function region_lattice(region, spacing, grid_spacing) result(lattice)
    !! The lattice of a region. When it follows a box the spacing is stretched to fit whole numbers.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: spacing        !! [m]
    real(wp), intent(in) :: grid_spacing   !! [m]
    type(lattice_t) :: lattice
    real(wp) :: extent(ndim), low(ndim), high(ndim)
    logical :: follows   ! with a whole number of points along its sides

    lattice%pivot = region%pivot
    lattice%angle = region%lattice_angle
    lattice%fills_shape = region%shape == 'box' .and. &
                          abs(region%lattice_angle - region%shape_angle) < 1.0e-12_wp
    follows = lattice%fills_shape
    if (allocated(region%hole)) lattice%fills_shape = follows .and. size(region%hole) == 0
    if (follows) then
      extent = region%box_max - region%box_min
      lattice%n = nint(min(points_along(extent, spacing, grid_spacing), most_points), i8)
      lattice%step = extent/real(max(1_i8, lattice%n), wp)
      lattice%first = region%box_min + 0.5_wp*lattice%step
    else
      call shape_bounds(region, region%shape_angle - region%lattice_angle, low, high)
      low = anint(low/spacing) - 0.5_wp   ! points lie half a spacing beside the pivot
      lattice%n = ceiling(min(high/spacing - low, most_points), i8) + 1_i8
      lattice%step = spacing
      lattice%first = region%pivot + low*spacing
    end if
  end function region_lattice

  pure integer function lattice_parity(scene, region, position) result(parity)
    !! 0 and 1 in turn from neighbour to neighbour on the region's lattice, for particles that
    !! jitter has moved by less than half a spacing, too.
    type(scene_t), intent(in) :: scene
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: position(ndim)   !! [m]
    type(lattice_t) :: lattice
    real(wp) :: x(ndim)

    lattice = region_lattice(region, region_spacing(scene, region), scene%grid_spacing)
    x = lattice%pivot + turned(position - lattice%pivot, -lattice%angle)
    parity = int(modulo(sum(nint((x - lattice%first)/lattice%step, i8)), 2_i8))
  end function lattice_parity

  subroutine seed_regions(comm, scene, particles, handles, problems)
    !! Seeds all regions; positions, ids, volumes, masses, porosity, conductivity, velocity.
    !! Problems (regions without particles, overlaps) come back one a line. Collective.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    type(point_set_t), intent(inout) :: particles
    type(particle_handles_t), intent(in) :: handles
    character(len=:), allocatable, intent(inout) :: problems
    real(wp), allocatable :: position(:, :)
    integer(i8), allocatable :: id(:)
    integer(i8) :: first_id, total
    real(wp), allocatable :: volume(:)
    real(wp) :: spacing
    type(lattice_t) :: lattice
    integer :: last(0:size(scene%region)), r, k   ! last particle of each region

    first_id = 0_i8
    last = 0
    do r = 1, size(scene%region)
      last(r) = last(r - 1)
      spacing = region_spacing(scene, scene%region(r))
      lattice = region_lattice(scene%region(r), spacing, scene%grid_spacing)
      if (allocated(scene%region(r)%particle)) then
        call share_particles(comm, scene%region(r), position, id)
      else if (.not. product(real(lattice%n, wp)) < &
               most_sites*real(comm%size, wp)) then   ! or more than integers hold
        problems = problems//"&region '"//trim(scene%region(r)%name)//"' is too large for its "// &
                   'particle spacing: check its size, unit and the spacing'//new_line('a')
        cycle
      else
        call seed_lattice(comm, scene%region(r), lattice, spacing, position, id)
      end if
      total = comm%sum(int(size(id), i8))
      if (total == 0_i8) then
        problems = problems//"&region '"//trim(scene%region(r)%name)// &
                   "' holds no particle: it is smaller than the particle spacing"//new_line('a')
        cycle
      end if
      volume = spread(shape_measure(scene%region(r))/real(total, wp), 1, size(id))
      if (allocated(scene%region(r)%particle_volume)) volume = scene%region(r)%particle_volume(id)
      ! Shares are in lattice order, so ranks before this one hold the lower identities.
      id = first_id + comm%prefix_sum(int(size(id), i8)) + [(int(k, i8), k=1, size(id))]
      call append(particles, handles, scene, r, position, id, volume)
      first_id = first_id + total
      last(r) = particles%count
    end do
    call tell_overlaps(comm, scene, last, &
                       particles%field(handles%position)%values(:, 1:particles%count), problems)
  end subroutine seed_regions

  subroutine tell_overlaps(comm, scene, last, position, problems)
    !! Regions of which a particle lies inside an earlier region, or that hold one of an earlier
    !! region, are problems, one a line. Collective.
    type(communicator_t), intent(in) :: comm
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: last(0:)          !! particle of each region, in the order of the regions
    real(wp), intent(in) :: position(:, :)   !! of all particles (ndim, n) [m]
    character(len=:), allocatable, intent(inout) :: problems
    type(region_bins_t) :: bins
    integer, allocatable :: near(:)
    real(wp) :: overlapping(size(scene%region)), margin   ! more than 0: it does
    integer :: r, p, k, later

    overlapping = 0.0_wp
    call bins%init(scene%region, scene%grid_spacing)
    do r = 1, size(scene%region)
      do p = last(r - 1) + 1, last(r)
        near = bins%near(position(:, p))
        do k = 1, size(near)
          if (near(k) == r) cycle
          later = max(r, near(k))
          margin = 1.0e-6_wp*region_spacing(scene, scene%region(later))
          if (shape_contains(scene%region(near(k)), position(:, p), margin)) then
            overlapping(later) = 1.0_wp
          end if
        end do
      end do
    end do
    call comm%sum_array(overlapping)
    do r = 1, size(scene%region)
      if (.not. overlapping(r) > 0.0_wp) cycle
      problems = problems//"&region '"//trim(scene%region(r)%name)// &
                 "' overlaps an earlier region"//new_line('a')
    end do
  end subroutine tell_overlaps

  subroutine seed_lattice(comm, region, lattice, spacing, position, id)
    !! This rank's share of a lattice: positions and lattice numbers from 1.
    type(communicator_t), intent(in) :: comm
    type(region_t), intent(in) :: region
    type(lattice_t), intent(in) :: lattice
    real(wp), intent(in) :: spacing   !! [m]
    real(wp), allocatable, intent(out) :: position(:, :)
    integer(i8), allocatable, intent(out) :: id(:)
    integer(i8) :: total, first, last, k
    integer :: n
    real(wp) :: x(ndim)

    total = product(lattice%n)
    first = total*comm%rank/comm%size + 1_i8
    last = total*(comm%rank + 1_i8)/comm%size
    allocate (position(ndim, max(0_i8, last - first + 1_i8)), id(max(0_i8, last - first + 1_i8)))
    n = 0
    do k = first, last
      x = lattice_point(lattice, k)
      if (.not. lattice%fills_shape) then
        if (.not. shape_contains(region, x, round_off*spacing)) cycle
      end if
      if (region%jitter > 0.0_wp) x = jittered(region, spacing, x, k)
      n = n + 1
      position(:, n) = x
      id(n) = k
    end do
    position = position(:, 1:n)
    id = id(1:n)
  end subroutine seed_lattice

  subroutine share_particles(comm, region, position, id)
    !! This rank's share of the particles of a file: positions and numbers from 1.
    type(communicator_t), intent(in) :: comm
    type(region_t), intent(in) :: region
    real(wp), allocatable, intent(out) :: position(:, :)
    integer(i8), allocatable, intent(out) :: id(:)
    integer(i8) :: total, k

    total = size(region%particle, 2, i8)
    id = [(k, k=total*comm%rank/comm%size + 1_i8, total*(comm%rank + 1_i8)/comm%size)]
    position = region%particle(:, id)
  end subroutine share_particles

  pure function lattice_point(lattice, number) result(position)
    !! Position of a lattice point; the last coordinate varies fastest.
    type(lattice_t), intent(in) :: lattice
    integer(i8), intent(in) :: number   !! from 1
    real(wp) :: position(ndim)
    integer(i8) :: rest
    integer :: d

    rest = number - 1_i8
    do d = ndim, 1, -1
      position(d) = lattice%first(d) + lattice%step(d)*real(mod(rest, lattice%n(d)), wp)
      rest = rest/lattice%n(d)
    end do
    position = lattice%pivot + turned(position - lattice%pivot, lattice%angle)
  end function lattice_point

  pure function jittered(region, spacing, position, number) result(moved)
    !! A random shift of at most jitter x spacing per direction that keeps clear of the faces;
    !! it is shortened until it does.
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: spacing          !! [m]
    real(wp), intent(in) :: position(ndim)   !! [m]
    integer(i8), intent(in) :: number        !! of the lattice point
    real(wp) :: moved(ndim), shift(ndim)
    integer :: d, attempt

    do d = 1, ndim
      shift(d) = region%jitter*spacing*(2.0_wp*hash_uniform(region%jitter_seed, number, d) - 1.0_wp)
    end do
    do attempt = 1, 8
      moved = position + shift
      if (shape_contains(region, moved, closest_to_face*spacing)) return
      shift = 0.5_wp*shift
    end do
    moved = position
  end function jittered

  subroutine append(particles, handles, scene, r, position, id, volume)
    !! Adds the particles of a region to the set.
    type(point_set_t), intent(inout) :: particles
    type(particle_handles_t), intent(in) :: handles
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: r
    real(wp), intent(in) :: position(:, :)
    integer(i8), intent(in) :: id(:)
    real(wp), intent(in) :: volume(:)        !! [m3]
    integer :: m, first, last, p
    real(wp) :: place(ndim)   ! for formulas [m]

    m = findloc(scene%material%name == scene%region(r)%material, .true., dim=1)
    first = particles%count + 1
    last = particles%count + size(id)
    call particles%resize(last)
    particles%id(first:last) = id
    associate (field => particles%field)
      field(handles%position)%values(:, first:last) = position
      field(handles%velocity)%values(:, first:last) = initial_velocity(scene%region(r), position)
      if (handles%affine > 0) field(handles%affine)%values(:, first:last) = &
        spread(spin_gradient(scene%region(r)%spin), 2, size(id))
      field(handles%volume)%values(1, first:last) = volume
      do p = 1, size(id)
        place = position(:, p) + scene%local_origin
        field(handles%mass)%values(1, first - 1 + p) = volume(p)* &
                                                       scene%mixture_density(m, position(:, p))
        field(handles%porosity)%values(1, first - 1 + p) = scene%material(m)%porosity%at(place)
        if (handles%conductivity > 0) field(handles%conductivity)%values(1, first - 1 + p) = &
          scene%material(m)%hydraulic_conductivity%at(place)
      end do
      field(handles%material)%values(1, first:last) = real(m, wp)
      if (handles%region > 0) field(handles%region)%values(1, first:last) = real(r, wp)
    end associate
  end subroutine append

  pure function spin_gradient(spin) result(gradient)
    !! Velocity gradient of a spin, component (a, b) = dv_a/dx_b at a + (b - 1) ndim [1/s].
    real(wp), intent(in) :: spin   !! x towards z [rad/s]
    real(wp) :: gradient(ndim*ndim)

    gradient = 0.0_wp
    gradient(ndim) = spin                    ! dv_z/dx
    gradient(1 + (ndim - 1)*ndim) = -spin    ! dv_x/dz
    if (ndim == 1) gradient = 0.0_wp         ! the checks refuse it
  end function spin_gradient

  pure function initial_velocity(region, position) result(velocity)
    !! Velocity of a region plus its spin about the pivot [m/s].
    type(region_t), intent(in) :: region
    real(wp), intent(in) :: position(:, :)   !! (ndim, n) [m]
    real(wp) :: velocity(ndim, size(position, 2))

    velocity = spread(region%velocity, 2, size(position, 2))
    velocity(1, :) = velocity(1, :) - region%spin*(position(ndim, :) - region%pivot(ndim))
    velocity(ndim, :) = velocity(ndim, :) + region%spin*(position(1, :) - region%pivot(1))
  end function initial_velocity
end module dosui_seeding

!! How large a scene is, from the numbers in its file: particles, memory, outputs, files. Nothing
!! of that size is made to find out.
module dosui_scene_sizes
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_error, only: error_t
  use dosui_integrator_traits, only: integrator_traits_t, traits_of
  use dosui_materials, only: material_set_t
  use dosui_ratios, only: ratio => bounded_ratio
  use dosui_scene, only: region_t, scene_t
  use dosui_scene_keys, only: group_size
  use dosui_seeding, only: points_along, region_spacing
  use dosui_shapes, only: face_t, shape_bounds, shape_faces, shape_measure
  implicit none
  private

  public :: sizes_of, region_particles

  integer, parameter :: default_rows = 1000      !! of histories when the scene gives no interval
  real(wp), parameter :: real_bytes = 8.0_wp

  ! Measured by tests/performance/memory.py in 1-D, 2-D and 3-D [B]: particles with their fields,
  ! then what comes on top of that.
  real(wp), parameter :: dry_particle(3) = [250.0_wp, 270.0_wp, 390.0_wp]
  real(wp), parameter :: wet_particle(3) = [250.0_wp, 310.0_wp, 810.0_wp]
  real(wp), parameter :: moving_particle(3) = [40.0_wp, 40.0_wp, 80.0_wp]
  real(wp), parameter :: matrix_particle(3) = [1600.0_wp, 4400.0_wp, 11500.0_wp]   !! with water
  real(wp), parameter :: cell(3) = [100.0_wp, 300.0_wp, 400.0_wp]   !! with its nodes
  real(wp), parameter :: matrix_cell(3) = [600.0_wp, 2500.0_wp, 14500.0_wp]
  real(wp), parameter :: factor_particle(3) = [0.0_wp, 270.0_wp, 1900.0_wp]
  !! of direct solutions, times 1 in 1-D, log2 n in 2-D, n^(1/3) in 3-D
  real(wp), parameter :: point = 300.0_wp           !! on a surface
  real(wp), parameter :: process_bytes = 5.0e7_wp   !! a process without any particle

  type, public :: scene_sizes_t
    !! Counts, and sizes in bytes.
    real(wp) :: particles = 0.0_wp, surface_points = 0.0_wp   !! [-]
    real(wp) :: sites = 0.0_wp          !! of lattices that are asked whether they lie in a body [-]
    real(wp) :: cells = 0.0_wp          !! [-]
    real(wp) :: memory = 0.0_wp         !! of all ranks together [B]
    real(wp) :: outputs = 0.0_wp        !! the start included [-]
    real(wp) :: rows = 0.0_wp           !! of histories [-]
    real(wp) :: result_bytes = 0.0_wp, history_bytes = 0.0_wp, checkpoint_bytes = 0.0_wp   !! [B]
  contains
    procedure :: disk => scene_sizes_disk
  end type scene_sizes_t

contains

  pure real(wp) function scene_sizes_disk(self) result(bytes)
    !! All files together, two checkpoints included [B].
    class(scene_sizes_t), intent(in) :: self

    bytes = self%result_bytes + self%history_bytes + 2.0_wp*self%checkpoint_bytes
  end function scene_sizes_disk

  function sizes_of(scene, n_rank) result(sizes)
    !! Estimates for a scene without problems, whose integrator is resolved; bodies and particles
    !! of files are taken if they have been read.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: n_rank
    type(scene_sizes_t) :: sizes
    real(wp) :: particles, sites
    integer :: r

    do r = 1, size(scene%region)
      call region_particles(scene, scene%region(r), particles, sites)
      sizes%particles = sizes%particles + particles
      sizes%sites = sizes%sites + sites
      sizes%surface_points = sizes%surface_points + region_points(scene, scene%region(r))
      sizes%cells = sizes%cells + particles*ratio(region_spacing(scene, scene%region(r)), &
                                                  scene%grid_spacing)**ndim
    end do
    associate (time => scene%time)
      sizes%outputs = 2.0_wp
      if (time%output_interval > 0.0_wp) sizes%outputs = sizes%outputs + &
                                                         ratio(time%end_time, time%output_interval)
      if (allocated(time%output_times)) sizes%outputs = sizes%outputs + &
                                                        real(size(time%output_times), wp)
      sizes%rows = real(default_rows, wp)
      if (scene%output%history_interval > 0.0_wp) then
        sizes%rows = ratio(time%end_time, scene%output%history_interval)
      end if
      sizes%rows = sizes%rows + sizes%outputs
    end associate
    call add_files(scene, sizes)
    sizes%memory = memory_of(scene, sizes) + real(n_rank, wp)* &
                   (process_bytes + 2.0_wp*real_bytes*sizes%outputs)
  end function sizes_of

  pure subroutine region_particles(scene, region, particles, sites)
    !! Particles of a region, and the sites of its lattice that are looked at to find them.
    type(scene_t), intent(in) :: scene
    type(region_t), intent(in) :: region
    real(wp), intent(out) :: particles, sites   !! numbers, which integers may not hold [-]
    real(wp) :: low(ndim), high(ndim), spacing

    sites = 0.0_wp
    if (allocated(region%particle)) then
      particles = real(size(region%particle, 2), wp)
      return
    end if
    spacing = region_spacing(scene, region)
    if (region%shape == 'box' .and. abs(region%lattice_angle - region%shape_angle) <= 0.0_wp) then
      sites = product(points_along(ratio(region%box_max - region%box_min, spacing), 1.0_wp, &
                                   ratio(scene%grid_spacing, spacing)))
      particles = sites*shape_measure(region)/product(region%box_max - region%box_min)
    else
      call shape_bounds(region, region%shape_angle - region%lattice_angle, low, high)
      sites = product(ratio(high - low, spacing) + 2.0_wp)
      particles = product(ratio(high - low, spacing))* &
                  ratio(shape_measure(region), product(high - low))
    end if
  end subroutine region_particles

  real(wp) function region_points(scene, region) result(points)
    !! Surface points of a region: pieces of its faces as long as the particle spacing.
    type(scene_t), intent(in) :: scene
    type(region_t), intent(in) :: region
    real(wp), parameter :: pi = acos(-1.0_wp)
    type(face_t), allocatable :: faces(:)
    real(wp) :: spacing, area
    integer :: f, e

    spacing = region_spacing(scene, region)
    points = 0.0_wp
    if (region%shape == 'stl') then
      if (allocated(region%body)) points = ratio(sum(region%body%area), spacing**2)
      return
    end if
    faces = shape_faces(region)
    do f = 1, size(faces)
      area = 1.0_wp
      do e = 1, size(faces(f)%edge, 2)   ! in 1-D the only edge has no length
        area = area*max(1.0_wp, ratio(norm2(faces(f)%edge(:, e)), spacing))
      end do
      if (faces(f)%name == 'round') then   ! cut as the body is, about
        area = real(2*ndim - 2, wp)*pi*ratio(faces(f)%radius, spacing)**(ndim - 1)
        area = area*min(1.0_wp, ratio(shape_measure(region), real(2*ndim - 2, wp)*pi* &
                                      faces(f)%radius**ndim/real(ndim, wp)))
      end if
      points = points + area
    end do
  end function region_points

  subroutine add_files(scene, sizes)
    !! Bytes of the result file, its histories and a checkpoint.
    type(scene_t), intent(in) :: scene
    type(scene_sizes_t), intent(inout) :: sizes
    type(material_set_t) :: materials
    type(integrator_traits_t) :: integrator
    real(wp) :: numbers, columns, fields
    logical :: is_wet

    is_wet = scene%water_mode /= 'none'
    integrator = traits_of(scene%integrator)
    call scene%prepare_materials(materials)
    numbers = 21.0_wp + real(materials%n_state(), wp)   ! place, identity and the fields
    if (is_wet) numbers = numbers + 6.0_wp
    sizes%result_bytes = sizes%outputs*(real_bytes*numbers*sizes%particles + 13.0_wp*real_bytes)
    columns = 6.0_wp + real(size(scene%probe), wp)
    if (is_wet) columns = columns + 4.0_wp + real(size(scene%hydraulic_condition), wp)
    columns = columns + real(3*ndim*min(1, group_size(scene, 'rigid_wall')), wp)
    columns = columns + real(2*ndim*size(scene%mechanical_condition), wp)
    sizes%history_bytes = real_bytes*columns*sizes%rows
    fields = real(3*ndim + 4 + ndim*ndim + (ndim*(ndim + 5))/2 + materials%n_state(), wp)
    if (is_wet) fields = fields + 3.0_wp
    if (scene%deformation == 'finite') fields = fields + real(ndim + ndim*ndim + 1, wp)
    if (.not. integrator%has_inertia()) fields = fields + 1.0_wp
    sizes%checkpoint_bytes = real_bytes*(fields*sizes%particles + &
                                         real(4*ndim + 6, wp)*sizes%surface_points)
  end subroutine add_files

  pure real(wp) function memory_of(scene, sizes) result(bytes)
    !! Memory of particles, grid and matrices of all ranks [B].
    type(scene_t), intent(in) :: scene
    type(scene_sizes_t), intent(in) :: sizes
    type(integrator_traits_t) :: integrator
    real(wp) :: particle, per_cell, seeding, fill(3)
    logical :: is_wet, is_implicit

    is_wet = scene%water_mode /= 'none'
    integrator = traits_of(scene%integrator)
    is_implicit = .not. integrator%is_explicit()
    particle = dry_particle(ndim)
    per_cell = cell(ndim)
    if (is_wet) particle = particle + wet_particle(ndim)
    if (scene%deformation /= 'small_strain') particle = particle + moving_particle(ndim)
    if (is_implicit) then
      per_cell = per_cell + matrix_cell(ndim)
      if (is_wet) particle = particle + matrix_particle(ndim)
      fill = [1.0_wp, log(sizes%particles + 1.0_wp)/log(2.0_wp), sizes%particles**(1.0_wp/3.0_wp)]
      if (scene%solver%linear == 'direct') particle = particle + factor_particle(ndim)*fill(ndim)
    end if
    seeding = real(8*ndim + 8, wp)*sizes%sites   ! before there are fields
    bytes = max(seeding, sizes%particles*particle + sizes%cells*per_cell) + &
            point*sizes%surface_points
  end function memory_of
end module dosui_scene_sizes

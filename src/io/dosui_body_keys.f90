!! Keys of bodies: their shapes, surfaces and first states, and what lies in and beside them.
module dosui_body_keys
  use dosui_kinds, only: wp
  use dosui_key_visitor, only: key, key_visitor_t, restart_content
  use dosui_scene, only: region_t, initial_state_t, surface_t, barrier_t, hole_t, rigid_wall_t
  implicit none
  private

  public :: visit_region, visit_hole, visit_initial_state, visit_surface, visit_barrier, &
            visit_rigid_wall

contains

  subroutine visit_region(v, region)
    !! Keys of &region.
    class(key_visitor_t), intent(inout) :: v
    type(region_t), intent(inout) :: region

    call v%name(region%name, key('name', 'what surfaces and initial states call it', &
                                 required=.true.))
    call v%name(region%material, key('material', 'name of a &material', required=.true.))
    call v%name(region%shape, &
                key('shape', 'box, polygon or circle (2-D), sphere or triangles of a file (3-D)', &
                    choices='box polygon circle sphere stl'))
    call v%vector(region%box_min, &
                  key('box_min', 'lower corner before turning', unit='m', required=.true., &
                      only='shape = ''box''', applies=region%shape == 'box', &
                      undecided=region%shape == ''))
    call v%vector(region%box_max, &
                  key('box_max', 'upper corner before turning', unit='m', required=.true., &
                      only='shape = ''box''', applies=region%shape == 'box', &
                      undecided=region%shape == ''))
    call v%points(region%vertices, &
                  key('vertices', 'corners x1, z1, x2, z2, ... of a simple polygon; edge1 runs '// &
                      'from the first to the second, counter-clockwise', unit='m', &
                      required=.true., only='shape = ''polygon''', &
                      applies=region%shape == 'polygon', undecided=region%shape == ''))
    call v%vector(region%centre, &
                  key('centre', 'of the circle or sphere before turning', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%real(region%radius, &
                key('radius', 'of the circle or sphere', unit='m', range='> 0', required=.true., &
                    only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                    undecided=region%shape == ''))
    call v%vector(region%cut_min, &
                  key('cut_min', 'only the part of the circle or sphere above this corner: a '// &
                      'half, quarter or eighth', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%vector(region%cut_max, &
                  key('cut_max', 'only the part below this corner', unit='m', &
                      only='shape = ''circle'' or ''sphere''', applies=is_round(region), &
                      undecided=region%shape == ''))
    call v%text(region%stl_file, &
                key('stl_file', 'a closed surface of triangles (STL, text or binary); a path '// &
                    'from the scene''s folder. Its faces are called by the names of '// &
                    'its solids, and face1, face2, ...: the start and --check list them', &
                    longest=1000, required=.true., only='shape = ''stl''', &
                    applies=region%shape == 'stl', undecided=region%shape == '', &
                    restart=restart_content))
    call v%real(region%stl_scale, &
                key('stl_scale', 'unit of the file, e.g. 1e-3 for mm', unit='m', range='> 0', &
                    only='shape = ''stl''', applies=region%shape == 'stl', &
                    undecided=region%shape == ''))
    call v%real(region%stl_face_angle, &
                key('stl_face_angle', 'neighbouring triangles whose normals differ by more '// &
                    'belong to different faces', unit='deg', range='>= 0 and <= 180', &
                    only='shape = ''stl''', applies=region%shape == 'stl', &
                    undecided=region%shape == ''))
    call v%text(region%particle_file, &
                key('particle_file', 'a table (CSV) of particles, a path from the scene''s '// &
                    'folder, takes the place of the lattice: x, (y,) z [m] and, if given, '// &
                    'volume [m3; m2 in 2-D, m in 1-D] in each line; a first line with names '// &
                    'picks these columns; # begins a comment. The shape still tells the faces', &
                    longest=1000, restart=restart_content))
    call v%real(region%particle_spacing, &
                key('particle_spacing', 'of the lattice; 0: grid spacing / particles_per_cell, '// &
                    'or the mean one of particle_file', unit='m', range='>= 0'))
    call v%integer(region%particles_per_cell, &
                   key('particles_per_cell', 'particles per cell and direction', &
                       range='>= 1 and <= 100', only='particle_spacing = 0', &
                       applies=.not. region%particle_spacing > 0.0_wp .and. &
                       .not. allocated(region%particle_file)))
    call v%real(region%jitter, &
                key('jitter', 'largest random shift of a particle in each direction, in '// &
                    'particle spacings', unit='-', range='>= 0 and < 0.5'))
    call v%integer(region%jitter_seed, key('jitter_seed', 'another number, other shifts'))
    call v%real(region%shape_angle, &
                key('shape_angle', 'turn of the shape about pivot, from x towards z', unit='deg', &
                    range='>= -360 and <= 360'))
    call v%real(region%lattice_angle, &
                key('lattice_angle', 'turn of the particle lattice about pivot, from x towards z', &
                    unit='deg', range='>= -360 and <= 360'))
    call v%vector(region%pivot, key('pivot', 'centre of both turns', unit='m'))
    call v%vector(region%velocity, key('velocity', 'initial velocity', unit='m/s'))
    call v%real(region%spin, &
                key('spin', 'initial angular velocity about pivot, from x towards z, added to '// &
                    'velocity', unit='rad/s'))
  end subroutine visit_region

  pure logical function is_round(region)
    !! Is the region's shape a circle or a sphere?
    type(region_t), intent(in) :: region

    is_round = region%shape == 'circle' .or. region%shape == 'sphere'
  end function is_round

  subroutine visit_hole(v, hole)
    !! Keys of &hole.
    class(key_visitor_t), intent(inout) :: v
    type(hole_t), intent(inout) :: hole

    call v%name(hole%region, key('region', 'name of the &region that it is cut out of; it '// &
                                 'turns with it', required=.true.))
    call v%points(hole%vertices, &
                  key('vertices', 'corners x1, z1, x2, z2, ... of a simple polygon within the '// &
                      'region; its edges are the face hole1 of the region, those of the '// &
                      'region''s next hole hole2, ...', unit='m', required=.true.))
  end subroutine visit_hole

  subroutine visit_initial_state(v, state, is_dry)
    !! Keys of &initial_state.
    class(key_visitor_t), intent(inout) :: v
    type(initial_state_t), intent(inout) :: state
    logical, intent(in) :: is_dry

    call v%name(state%region, &
                key('region', 'name of a &region', fallback='every region'))
    call v%name(state%pore_pressure, &
                key('pore_pressure', 'zero, hydrostatic about water_level (suction above '// &
                    'it), a given value, or a checkerboard of both signs', &
                    choices='zero hydrostatic given checkerboard', &
                    only='water = ''coupled'' in &scene', applies=.not. is_dry))
    call v%real(state%water_level, &
                key('water_level', 'elevation of zero pressure', unit='m', &
                    only='pore_pressure = ''hydrostatic''', &
                    applies=state%pore_pressure == 'hydrostatic', &
                    undecided=state%pore_pressure == ''))
    call v%real(state%pore_pressure_value, &
                key('pore_pressure_value', 'pressure, or amplitude of the checkerboard; '// &
                    'compression positive', unit='Pa', &
                    only='pore_pressure = ''given'' or ''checkerboard''', &
                    applies=state%pore_pressure == 'given' .or. &
                    state%pore_pressure == 'checkerboard', &
                    undecided=state%pore_pressure == ''))
    call v%name(state%effective_stress, &
                key('effective_stress', 'zero, given, or geostatic: the weight of the '// &
                    'particle''s own soil, under water in scenes with water, below '// &
                    'surface_level; for layers of different weight, deeper water or '// &
                    'sloping ground add geostatic_start in &time', &
                    choices='zero geostatic given'))
    call v%real(state%surface_level, &
                key('surface_level', 'elevation of zero effective stress', unit='m', &
                    only='effective_stress = ''geostatic''', &
                    applies=state%effective_stress == 'geostatic', &
                    undecided=state%effective_stress == ''))
    call v%real(state%lateral_ratio, &
                key('lateral_ratio', 'K_0: horizontal over vertical effective stress', unit='-', &
                    range='>= 0', only='effective_stress = ''geostatic''', &
                    applies=state%effective_stress == 'geostatic', &
                    undecided=state%effective_stress == ''))
    call v%vector(state%effective_stress_value, &
                  key('effective_stress_value', 'xx, yy, zz, xy, yz, zx; tension positive', &
                      unit='Pa', only='effective_stress = ''given''', &
                      applies=state%effective_stress == 'given', &
                      undecided=state%effective_stress == ''))
    call v%integer(state%mode_number, &
                   key('mode_number', 'm of the initial velocity v_z = a sin(pi (2 m - 1) z / '// &
                       '(2 H)) of a bar, H high over all regions; 0: none', &
                       range='>= 0 and <= 1000'))
    call v%real(state%mode_amplitude, &
                key('mode_amplitude', 'a of that velocity', unit='m/s', only='mode_number > 0', &
                    applies=state%mode_number > 0))
  end subroutine visit_initial_state

  subroutine visit_surface(v, surface)
    !! Keys of &surface.
    class(key_visitor_t), intent(inout) :: v
    type(surface_t), intent(inout) :: surface

    call v%name(surface%name, key('name', 'what conditions and probes call it', required=.true.))
    call v%name(surface%region, key('region', 'name of a &region', required=.true.))
    call v%name(surface%face, &
                key('face', 'face of the unturned box (x-, x+, y-, y+, z-, z+), edge of a '// &
                    'polygon (edge1, edge2, ...), round of a circle or sphere, whose cuts are '// &
                    'called like a box''s faces, or all; free: what no other surface names '// &
                    '(but for those that only probes use), '// &
                    'with deformation = ''updated'' also what comes to be as bodies tear, '// &
                    'spread and meet', required=.true.))
    call v%vector(surface%box_min, &
                  key('box_min', 'only the part of the face above this corner', unit='m'))
    call v%vector(surface%box_max, &
                  key('box_max', 'only the part of the face below this corner', unit='m'))
  end subroutine visit_surface

  subroutine visit_barrier(v, barrier)
    !! Keys of &barrier.
    class(key_visitor_t), intent(inout) :: v
    type(barrier_t), intent(inout) :: barrier

    call v%name(barrier%name, key('name', 'what messages call it', required=.true.))
    call v%points(barrier%vertices, &
                  key('vertices', '2-D: a chain of points x1, z1, x2, z2, ...; 3-D: corners of '// &
                      'a flat convex polygon, in order', unit='m', required=.true.))
  end subroutine visit_barrier

  subroutine visit_rigid_wall(v, wall)
    !! Keys of &rigid_wall.
    class(key_visitor_t), intent(inout) :: v
    type(rigid_wall_t), intent(inout) :: wall

    call v%name(wall%name, key('name', 'what messages call it', required=.true.))
    call v%vector(wall%position, key('position', 'a point of its plane', unit='m', required=.true.))
    call v%vector(wall%normal, key('normal', 'from the wall towards the bodies, of any length', &
                                   unit='-', required=.true.))
    call v%name(wall%kind, key('kind', 'frictional: slides, with Coulomb''s friction; rough: '// &
                               'what touches it sticks', choices='frictional rough'))
    call v%real(wall%friction, &
                key('friction', 'tangent of the angle of friction between soil and wall', &
                    unit='-', range='>= 0', only='kind = ''frictional''', &
                    applies=.not. wall%is_rough()))
  end subroutine visit_rigid_wall
end module dosui_body_keys

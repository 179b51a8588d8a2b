!! Keys of how a scene is computed and what it leaves behind.
module dosui_run_keys
  use dosui_dimension, only: ndim, axis
  use dosui_key_visitor, only: key, key_visitor_t, restart_content, restart_free
  use dosui_scene, only: scene_t, water_t, mechanics_t, probe_t, solver_t, time_t, output_t, &
                         verification_t
  implicit none
  private

  public :: visit_scene, visit_grid, visit_time, visit_water, visit_mechanics, visit_solver, &
            visit_output, visit_probe, visit_verification

contains

  subroutine visit_scene(v, scene)
    !! Keys of &scene.
    class(key_visitor_t), intent(inout) :: v
    type(scene_t), intent(inout) :: scene
    integer :: dimension

    dimension = ndim
    call v%text(scene%title, &
                key('title', 'one line about the scene', longest=1000, restart=restart_free))
    call v%integer(dimension, &
                   key('dimension', 'space dimensions: (z), (x, z) or (x, y, z); z is up', &
                       range='>= 1 and <= 3', required=.true.))
    call v%name(scene%water_mode, &
                key('water', 'pore water: none (dry soil), or coupled with the skeleton', &
                    choices='none coupled', former_choices='saturated coupled'))
    call v%name(scene%integrator, &
                key('integrator', 'explicit: all waves resolved; semi_implicit: waves of the '// &
                    'skeleton only; quasi_static: no inertia, steps by accuracy; auto: what '// &
                    'suits the scene', choices='explicit semi_implicit quasi_static auto'))
    call v%name(scene%deformation, &
               key('deformation', 'small_strain: the geometry stays as it is; finite: the grid '// &
                    'deforms with the body (quasi_static); updated: particles move through '// &
                    'the grid', choices='small_strain finite updated'))
    call v%name(scene%leaving_particles, &
                key('leaving_particles', 'what happens when a particle leaves the domain: stop '// &
                    'with an error, or remove and count it', choices='stop remove', &
                    restart=restart_free))
    call v%vector(scene%gravity, &
                  key('gravity', 'acceleration; z is up, so its last component is negative', &
                      unit='m/s2'))
  end subroutine visit_scene

  subroutine visit_grid(v, scene)
    !! Keys of &grid.
    class(key_visitor_t), intent(inout) :: v
    type(scene_t), intent(inout) :: scene

    call v%real(scene%grid_spacing, &
                key('spacing', 'edge length of the cells', unit='m', range='> 0', required=.true.))
    call v%vector(scene%grid_origin, key('origin', 'position of one node of the grid', unit='m'))
    call v%vector(scene%grid_period, &
                  key('period', 'the skeleton repeats after this length along each axis (0: it '// &
                      'does not): its sides move as one, for columns, layers and slopes of '// &
                      'endless extent; water needs its own conditions on these sides, or '// &
                      'does not flow through them', unit='m', range='>= 0'))
    call v%name(scene%shape_function, &
                key('shape_function', 'linear hats, GIMP (uniform; cpgimp: domains stretch '// &
                    'with the particles, with deformation = ''updated'' only) or quadratic '// &
                    'B-splines; auto: gimp with deformation = ''updated'', where particles '// &
                    'cross cells, else linear', choices='auto linear gimp cpgimp bspline'))
    call v%vector(scene%domain_min, &
                  key('domain_min', 'particles more than a hundredth of a cell below have left '// &
                      'the domain', unit='m', &
                      restart=restart_free))
    call v%vector(scene%domain_max, &
                  key('domain_max', 'particles more than a hundredth of a cell above have left '// &
                      'the domain', unit='m', &
                      restart=restart_free))
  end subroutine visit_grid

  subroutine visit_time(v, time)
    !! Keys of &time.
    class(key_visitor_t), intent(inout) :: v
    type(time_t), intent(inout) :: time

    call v%real(time%end_time, &
                key('end_time', 'end of the run', unit='s', range='> 0', required=.true., &
                    restart=restart_free))
    call v%real(time%output_interval, &
                key('output_interval', 'time between outputs; 0: only output_times and the end', &
                    unit='s', range='>= 0', restart=restart_free))
    call v%list(time%output_times, &
                key('output_times', 'times of output, besides the start and the end', unit='s', &
                    range='> 0', restart=restart_free))
    call v%real(time%courant, &
                key('courant', 'fraction of the stability limit that a step takes', unit='-', &
                    range='> 0 and <= 1', restart=restart_free))
    call v%real(time%time_step, &
                key('time_step', 'fixed step; 0: chosen from the stability limits', unit='s', &
                    range='>= 0', restart=restart_free))
    call v%real(time%largest_step, &
                key('largest_step', 'no step is longer', unit='s', range='> 0', &
                    restart=restart_free))
    call v%logical(time%geostatic_start, &
                   key('geostatic_start', 'bring the initial effective stresses into '// &
                       'equilibrium with weight, loads and the initial pore pressures before '// &
                       'the clock starts; displacements count from there'))
    call v%logical(time%undrained_start, &
                   key('undrained_start', 'settle into the undrained equilibrium under the '// &
                       'loads at t = 0 before the clock starts'))
    call v%long(time%maximum_steps, &
                key('maximum_steps', 'the run ends after so many steps', range='>= 1', &
                    fallback='unlimited', restart=restart_free))
    call v%real(time%relative_tolerance, &
                key('relative_tolerance', 'quasi_static: error of the pressures that a step '// &
                    'may make, relative to their size', unit='-', range='> 0 and <= 0.1', &
                    restart=restart_free))
  end subroutine visit_time

  subroutine visit_water(v, water)
    !! Keys of &water.
    class(key_visitor_t), intent(inout) :: v
    type(water_t), intent(inout) :: water

    call v%real(water%density, key('density', 'density', unit='kg/m3', range='> 0'))
    call v%real(water%bulk_modulus, &
                key('bulk_modulus', 'K_w; lower values stand for a little trapped air', unit='Pa', &
                    range='> 0'))
    call v%real(water%unit_weight, &
                key('unit_weight', 'gamma_w that k and heads refer to', unit='N/m3', range='> 0'))
    call v%name(water%operator, &
                key('operator', 'compact: quadratic MLS with boundary points; two_pass: the '// &
                    'published MLS-SPH recipe, first order at best', choices='compact two_pass'))
    call v%real(water%support_radius, &
                key('support_radius', 'radius of the neighbourhoods, in particle spacings', &
                    unit='-', range='>= 1.5 and <= 4'))
    call v%real(water%rebuild_displacement, &
                key('rebuild_displacement', 'neighbourhoods are built anew when a particle has '// &
                    'moved so far, in particle spacings', unit='-', range='> 0 and <= 1', &
                    restart=restart_free))
    call v%logical(water%fluid_inertia, &
                   key('fluid_inertia', 'Darcy''s law with the water''s inertia at the '// &
                       'skeleton''s acceleration, as the literature''s u-p form has it; with '// &
                       'integrator = ''explicit'' only', &
                       only='operator = ''compact''', applies=water%operator == 'compact', &
                       undecided=water%operator == ''))
    call v%real(water%cell_storage, &
                key('cell_storage', 'pressure-projection storage inside a cell, tau_i', unit='-', &
                    range='>= 0', only='operator = ''compact''', &
                    applies=water%operator == 'compact', undecided=water%operator == ''))
    call v%real(water%block_storage, &
                key('block_storage', 'pressure-projection storage inside 2 x 2 (x 2) cells, '// &
                    'tau_m', unit='-', range='>= 0', only='operator = ''compact''', &
                    applies=water%operator == 'compact', undecided=water%operator == ''))
    call v%name(water%stepping, &
                key('stepping', 'pressure steps within a mechanical step: one, several, RKL2 '// &
                    'super-time-stepping, or chosen from the limits', &
                    choices='auto single subcycle rkl2', restart=restart_free))
  end subroutine visit_water

  subroutine visit_mechanics(v, mechanics)
    !! Keys of &mechanics.
    class(key_visitor_t), intent(inout) :: v
    type(mechanics_t), intent(inout) :: mechanics

    call v%name(mechanics%transfer, &
                key('transfer', 'how velocities pass between particles and grid; auto: aflip '// &
                    'with deformation = ''updated'', where losses a step would shorten '// &
                    'run-outs, else apic', choices='auto aflip apic flip pic blend'))
    call v%real(mechanics%filter_time, &
                key('filter_time', 'in which velocities that the grid does not see fade; 0: '// &
                    'of each particle, 2 spacings over its speed of shear waves, at most '// &
                    'sqrt(spacing/gravity)/3', unit='s', range='>= 0', &
                    only='transfer = ''aflip''', &
                    applies=mechanics%transfer == 'aflip' .or. mechanics%transfer == 'auto', &
                    undecided=mechanics%transfer == ''))
    call v%real(mechanics%flip_fraction, &
                key('flip_fraction', 'share of FLIP, the rest is PIC', unit='-', &
                    range='>= 0 and <= 1', only='transfer = ''blend''', &
                    applies=mechanics%transfer == 'blend', undecided=mechanics%transfer == '', &
                    restart=restart_free))
    call v%logical(mechanics%average_volume_change, &
                   key('average_volume_change', 'volume change of skeleton and water averaged '// &
                       'over the cell (B-bar)'))
    call v%name(mechanics%coupling_gradient, &
                key('coupling_gradient', 'where the volume change for the water is evaluated', &
                    choices='auto particle cell_centre'))
    call v%name(mechanics%damping, &
                key('damping', 'viscous: force -c m v; local: -c |force| against the velocity; '// &
                    'fading: viscous with c = b/t, for loads at the start', &
                    choices='none viscous local fading', restart=restart_free))
    call v%real(mechanics%damping_coefficient, &
                key('damping_coefficient', 'c: viscous [1/s], local [-]; b: fading [-]; '// &
                    'negative: from the scene''s lowest frequency, 0.3 and 3', &
                    only='damping = ''viscous'', ''local'' or ''fading''', &
                    applies=mechanics%damping /= 'none', undecided=mechanics%damping == '', &
                    restart=restart_free))
    call v%real(mechanics%density_scaling, &
                key('density_scaling', 'factor on inertia only, for quasi-static runs', unit='-', &
                    range='>= 1'))
    call v%real(mechanics%penalty, &
                key('penalty', 'stiffness of walls that no grid line follows, in modulus '// &
                    'per spacing: the undrained one, at most 1000 times the drained', &
                    unit='-', range='> 0'))
  end subroutine visit_mechanics

  subroutine visit_solver(v, solver)
    !! Keys of &solver.
    class(key_visitor_t), intent(inout) :: v
    type(solver_t), intent(inout) :: solver

    call v%name(solver%linear, &
                key('linear', 'direct: factorised on every rank; iterative: Krylov method with '// &
                    'multigrid; auto: direct for small systems', choices='auto direct iterative'))
    call v%real(solver%tolerance, &
                key('tolerance', 'relative error of an iterative solution''s displacements and '// &
                    'pressures; the residual is brought down as far as that takes', &
                    unit='-', range='> 0 and <= 1e-2'))
  end subroutine visit_solver

  subroutine visit_output(v, output)
    !! Keys of &output.
    class(key_visitor_t), intent(inout) :: v
    type(output_t), intent(inout) :: output

    call v%text(output%name, &
                key('name', 'stem of the files', longest=200, restart=restart_content, &
                    fallback='name of the scene''s folder or file'))
    call v%text(output%directory, &
                key('directory', 'where the files go', longest=4000, restart=restart_content, &
                    fallback='the working directory'))
    call v%real(output%history_interval, &
                key('history_interval', 'time between entries of the histories; 0: every step '// &
                    'of implicit runs, about 1000 entries of explicit ones', unit='s', &
                    range='>= 0'))
    call v%long(output%checkpoint_steps, &
                key('checkpoint_steps', 'steps between checkpoints; 0: none', range='>= 0'))
    call v%real(output%checkpoint_minutes, &
                key('checkpoint_minutes', 'wall time between checkpoints; 0: none', unit='min', &
                    range='>= 0'))
    call v%logical(output%checkpoint_at_outputs, &
                   key('checkpoint_at_outputs', 'a checkpoint at every output, the start and '// &
                       'the end included; all are kept, as <name>.restart.<step>.h5'))
    call v%real(output%progress_seconds, &
                key('progress_seconds', 'wall time between lines of progress', unit='s', &
                    range='>= 0'))
  end subroutine visit_output

  subroutine visit_probe(v, probe)
    !! Keys of &probe.
    class(key_visitor_t), intent(inout) :: v
    type(probe_t), intent(inout) :: probe
    logical :: is_field, is_surface

    call v%name(probe%name, key('name', 'name of the history', required=.true.))
    call v%name(probe%kind, &
                key('kind', 'value at a point, mean over a surface (integral over area, at the '// &
                    'surface itself), mean downward displacement '// &
                    'of a surface, volume integral, or the distance within which a fraction '// &
                    'of the mass lies', required=.true., &
                    choices='point surface_mean settlement domain_sum run_out'))
    is_field = probe%kind /= 'settlement' .and. probe%kind /= 'run_out'
    is_surface = probe%kind == 'surface_mean' .or. probe%kind == 'settlement'
    call v%name(probe%field, &
                key('field', 'a field of the result file, e.g. pore_pressure', &
                    only='a kind other than ''settlement'' and ''run_out''', &
                    applies=is_field, required=.true., &
                    undecided=probe%kind == ''))
    call v%integer(probe%component, &
                   key('component', 'of a vector or stress field, as in the result file', &
                       range='>= 1 and <= 6', &
                       only='a kind other than ''settlement'' and ''run_out''', &
                       applies=is_field))
    call v%name(probe%surface, &
                key('surface', 'name of a &surface', &
                    only='kind = ''surface_mean'' or ''settlement''', &
                    applies=is_surface, required=.true., undecided=probe%kind == ''))
    call v%vector(probe%position, &
                  key('position', 'where, or where distances of a run-out count from', &
                      unit='m', only='kind = ''point'' or ''run_out''', &
                      applies=probe%kind == 'point' .or. probe%kind == 'run_out', &
                      required=.true., undecided=probe%kind == ''))
    call v%vector(probe%direction, &
                  key('direction', 'of a run-out, of any length; 0: the horizontal distance '// &
                      'from the vertical through the position', unit='-', &
                      only='kind = ''run_out''', applies=probe%kind == 'run_out', &
                      undecided=probe%kind == ''))
    call v%real(probe%fraction, &
                key('fraction', 'of the mass that lies within the run-out; single foremost '// &
                    'particles depend on chance: 0.95 and 0.99 do not', unit='-', &
                    range='> 0 and <= 1', only='kind = ''run_out''', &
                    applies=probe%kind == 'run_out', undecided=probe%kind == ''))
  end subroutine visit_probe

  subroutine visit_verification(v, verification)
    !! Keys of &verification.
    class(key_visitor_t), intent(inout) :: v
    type(verification_t), intent(inout) :: verification

    call v%name(verification%case, &
                key('case', 'name of the exact solution', required=.true., &
                    choices='terzaghi mandel cryer de_leeuw hydrostatic bar drainage'))
    call v%real(verification%load, &
                key('load', 'pressure q [Pa]; Mandel: force F [N/m]'))
    call v%real(verification%length, &
                key('length', 'drainage length H, half width or radius a', unit='m', range='> 0', &
                    required=.true.))
    call v%vector(verification%drained, &
                  key('drained', 'a point of the drained surface', unit='m', required=.true.))
    call v%vector(verification%direction, &
                  key('direction', 'unit vector from the drained surface into the body', unit='-', &
                      required=.true.))
  end subroutine visit_verification
end module dosui_run_keys

!! What is allowed in a scene, but hardly meant: values in the wrong unit or sign, things that
!! nothing uses, bodies that nothing holds, gaps that a cell bridges.
module dosui_scene_warnings
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_initial_state, only: geostatic_density
  use dosui_integrator_traits, only: integrator_traits_t, traits_of
  use dosui_local_origin, only: scene_bounds
  use dosui_name_index, only: name_index_t
  use dosui_namelist, only: namelist_t
  use dosui_region_contacts, only: region_contacts_t
  use dosui_scene, only: material_t, scene_t
  use dosui_table, only: table_name_length, table_t
  use dosui_scene_checks, only: checker_t
  use dosui_shapes, only: region_bounds
  use dosui_text, only: to_text, vector_text
  implicit none
  private

  public :: find_warnings

  ! Limits of what soils, water and this planet have
  real(wp), parameter :: least_density = 500.0_wp, most_density = 5000.0_wp      !! [kg/m3]
  real(wp), parameter :: least_modulus = 1.0e3_wp, most_modulus = 1.0e12_wp      !! [Pa]
  real(wp), parameter :: most_fast_water = 0.03_wp   !! k omega/g [-]
  real(wp), parameter :: most_conductivity = 1.0_wp                              !! [m/s]
  real(wp), parameter :: least_gravity = 9.7_wp, most_gravity = 9.9_wp           !! [m/s2]
  real(wp), parameter :: right_angle = acos(0.0_wp), degrees = 90.0_wp/right_angle
  real(wp), parameter :: round_off = 1.0e-6_wp   !! of a force or direction [-]
  real(wp), parameter :: least_cells = 2.0_wp    !! across a body that cuts cells [-]

contains

  subroutine find_warnings(scene, namelist)
    !! Fills the warnings of a scene without problems, each with its line.
    type(scene_t), intent(inout) :: scene
    type(namelist_t), intent(in), target :: namelist   !! of its text
    type(checker_t) :: checker

    checker%namelist => namelist
    call warn_of_methods(checker, scene)
    call warn_of_fast_water(checker, scene)
    call warn_of_gravity(checker, scene)
    call warn_of_materials(checker, scene)
    call warn_of_overridden_states(checker, scene)
    if (.not. (scene%time%geostatic_start .or. all(scene%material%rigid))) then
      call warn_of_water_tables(checker, scene)
      call warn_of_layers(checker, scene)
    end if
    call warn_of_unused(checker, scene)
    call warn_of_bodies(checker, scene)
    scene%warnings = checker%problems
  end subroutine find_warnings

  subroutine warn_of_methods(checker, scene)
    !! Shape functions that do not suit the motion.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene

    if (scene%deformation == 'updated' .and. scene%shape_function == 'linear') then
      call checker%complain('grid', 1, 'shape_function', 'forces jump when particles cross '// &
                            'cells: ''gimp'' or ''bspline'' suit deformation = ''updated''')
    end if
  end subroutine warn_of_methods

  subroutine warn_of_fast_water(checker, scene)
    !! Water that moves against the skeleton faster than the equations, which leave the acceleration
    !! of this motion out, are good for: k omega/g with the pulsation of harmonic loads.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(integrator_traits_t) :: integrator
    real(wp) :: pulsation, ratio
    integer :: k

    integrator = traits_of(scene%integrator)
    if (scene%water_mode /= 'coupled' .or. .not. integrator%has_inertia()) return
    if (all(scene%material%rigid)) return
    pulsation = 0.0_wp
    do k = 1, size(scene%mechanical_condition)
      pulsation = max(pulsation, pulsation_of(scene%mechanical_condition(k)%pattern%factor))
    end do
    if (scene%base_motion%is_given) then
      pulsation = max(pulsation, pulsation_of(scene%base_motion%pattern%factor))
    end if
    do k = 1, size(scene%material)
      if (scene%material(k)%rigid) cycle
      ratio = scene%material(k)%hydraulic_conductivity%constant*pulsation*scene%water%density/ &
              scene%water%unit_weight
      if (.not. ratio > most_fast_water) cycle
      call checker%complain('material', k, 'hydraulic_conductivity', 'the water''s own '// &
                           'acceleration against the skeleton, which dosui leaves out, counts: '// &
                            'k omega/g is '//to_text(ratio, 2)//' with the loads'' '// &
                            to_text(pulsation, 3)//' 1/s; above '// &
                            to_text(most_fast_water, 2)// &
                            ' displacements are more than 3 % off')
    end do
  end subroutine warn_of_fast_water

  pure real(wp) function pulsation_of(table) result(pulsation)
    !! Pulsation of an oscillating table: pi over the mean time between its turns; 0 for a table
    !! that turns fewer than three times [1/s].
    type(table_t), intent(in) :: table
    real(wp) :: first, last, change, before
    integer :: k, turns

    pulsation = 0.0_wp
    if (.not. allocated(table%argument)) return
    turns = 0
    before = 0.0_wp
    first = 0.0_wp
    last = 0.0_wp
    do k = 2, size(table%argument)
      change = table%value(k) - table%value(k - 1)
      if (change*before < 0.0_wp) then
        turns = turns + 1
        if (turns == 1) first = table%argument(k - 1)
        last = table%argument(k - 1)
      end if
      if (abs(change) > 0.0_wp) before = change
    end do
    if (turns >= 3) pulsation = 2.0_wp*right_angle*real(turns - 1, wp)/(last - first)
  end function pulsation_of

  subroutine warn_of_gravity(checker, scene)
    !! Gravity upwards, or of another planet.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    real(wp) :: size_of_gravity

    size_of_gravity = norm2(scene%gravity)
    if (scene%gravity(ndim) > 0.0_wp) then
      call checker%complain('scene', 1, 'gravity', 'points up: z is up, so its last component '// &
                            'is negative')
    else if (size_of_gravity > 0.0_wp .and. &
             (size_of_gravity < least_gravity .or. size_of_gravity > most_gravity)) then
      call checker%complain('scene', 1, 'gravity', 'has the size '//to_text(size_of_gravity, 4)// &
                            ', not that of the Earth, 9.81 [m/s2]')
    end if
  end subroutine warn_of_gravity

  subroutine warn_of_materials(checker, scene)
    !! Constants outside of what soils have.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    integer :: k
    logical :: is_wet

    is_wet = scene%water_mode /= 'none'
    do k = 1, size(scene%material)
      associate (material => scene%material(k))
        call warn_outside('material', k, 'solid_density', material%solid_density%constant, &
                          least_density, most_density, 'kg/m3')
        if (checker%has('material', k, 'young_modulus') .and. .not. material%rigid) then
          call warn_outside('material', k, 'young_modulus', material%value('young_modulus'), &
                            least_modulus, most_modulus, 'Pa')
        end if
        if (is_wet) call warn_outside('material', k, 'hydraulic_conductivity', &
                                      material%hydraulic_conductivity%constant, 0.0_wp, &
                                      most_conductivity, 'm/s')
        if (checker%has('material', k, 'softening_strain') .and. &
            material%value('softening_strain') > 0.0_wp) then
          call checker%complain('material', k, 'softening_strain', 'makes results depend on '// &
                                'the grid, as bands of shear are one or two spacings wide: '// &
                                'softening_displacement = '// &
                                to_text(material%value('softening_strain')* &
                                        scene%grid_spacing, 4)// &
                                ' [m] is the same on this grid and does not')
        end if
        call warn_of_radians(checker, material, k, 'friction_angle')
        call warn_of_radians(checker, material, k, 'dilation_angle')
        call warn_of_radians(checker, material, k, 'residual_friction_angle')
      end associate
    end do
    if (is_wet) call warn_outside('water', 1, 'density', scene%water%density, least_density, &
                                  most_density, 'kg/m3')

  contains

    subroutine warn_outside(group, instance, key, value, least, most, unit)
      !! A constant outside of its usual range.
      character(len=*), intent(in) :: group
      integer, intent(in) :: instance
      character(len=*), intent(in) :: key
      real(wp), intent(in) :: value, least, most
      character(len=*), intent(in) :: unit

      if (value >= least .and. value <= most) return
      call checker%complain(group, instance, key, 'is unusual: '//to_text(least)//' ... '// &
                            to_text(most)//' ['//unit//'] is expected; is its unit right?')
    end subroutine warn_outside
  end subroutine warn_of_materials

  subroutine warn_of_radians(checker, material, instance, key)
    !! An angle that is small in degrees and sensible in radians.
    type(checker_t), intent(inout) :: checker
    type(material_t), intent(in) :: material
    integer, intent(in) :: instance
    character(len=*), intent(in) :: key
    real(wp) :: angle

    if (.not. checker%has('material', instance, key)) return
    angle = material%value(key)
    if (.not. (angle > 0.0_wp .and. angle < right_angle)) return
    call checker%complain('material', instance, key, 'is in degrees; in radians it would be '// &
                          to_text(angle*degrees, 3)//' [deg]')
  end subroutine warn_of_radians

  subroutine warn_of_overridden_states(checker, scene)
    !! Initial states that set to zero, without a word, what an earlier one gave their region.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=16), parameter :: key(2) = ['pore_pressure   ', 'effective_stress']
    logical :: given(2, 0:size(scene%region))   ! to every region so far, 0: to all of them
    logical, dimension(2) :: anywhere, before, now, has
    type(name_index_t) :: regions
    integer :: i, k, r

    call regions%add_all(scene%region%name)
    given = .false.
    anywhere = .false.
    do k = 1, size(scene%initial_state)
      associate (state => scene%initial_state(k))
        r = 0
        if (state%region /= '') r = regions%find(state%region)
        before = given(:, 0) .or. given(:, r)
        if (r == 0) before = anywhere
        has = [(checker%has('initial_state', k, trim(key(i))), i=1, 2)]
        now = [state%pore_pressure /= 'zero', state%effective_stress /= 'zero']
        given(:, r) = given(:, r) .or. now
        anywhere = anywhere .or. now
        if (.not. any(before .and. .not. has)) cycle
        call checker%complain('initial_state', k, 'region', 'sets all of the state, and so to '// &
                              'zero what it does not name and an earlier &initial_state gave: '// &
                              'name pore_pressure and effective_stress')
      end associate
    end do
  end subroutine warn_of_overridden_states

  subroutine warn_of_water_tables(checker, scene)
    !! Geostatic stresses by the weight under water where the water does not reach the surface: the
    !! missing part is the weight of the water above its level.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    real(wp) :: low(ndim), high(ndim)
    integer :: k

    if (scene%water_mode /= 'coupled') return
    call scene_bounds(scene, low, high)
    do k = 1, size(scene%initial_state)
      associate (state => scene%initial_state(k), near => round_off*scene%grid_spacing)
        if (state%effective_stress /= 'geostatic' .or. state%pore_pressure /= 'hydrostatic') cycle
        ! a level above all soil has been raised to stand for what lies between
        if (state%surface_level > high(ndim) + near) cycle
        if (state%surface_level - state%water_level <= near) cycle
        call checker%complain('initial_state', k, 'effective_stress', 'is the weight under '// &
                              'water, from surface_level on, but the water stands '// &
                              to_text(state%surface_level - state%water_level, 4)// &
                              ' m lower: &time geostatic_start = .true. finds the equilibrium')
      end associate
    end do
  end subroutine warn_of_water_tables

  subroutine warn_of_layers(checker, scene)
    !! Geostatic stresses below a layer of another weight: each soil counts only with its own.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    real(wp) :: low(ndim, size(scene%region)), high(ndim, size(scene%region))
    real(wp) :: density(size(scene%region)), near
    integer :: state(size(scene%region))   ! the one that makes a region's stresses, 0: none
    type(name_index_t) :: materials
    integer :: a, b

    call materials%add_all(scene%material%name)
    call find_geostatic(scene, state)
    do a = 1, size(state)
      call region_bounds(scene%region(a), low(:, a), high(:, a))
      density(a) = geostatic_density(scene, materials%find(scene%region(a)%material), &
                                     scene%water_mode == 'coupled')
    end do
    if (.not. any(state > 0)) return
    near = round_off*scene%grid_spacing
    if (maxval(density, mask=state > 0) - minval(density, mask=state > 0) <= &
        round_off*maxval(density, mask=state > 0)) return   ! one weight for all
    do a = 1, size(state)
      if (state(a) == 0) cycle
      do b = 1, size(state)
        if (state(b) == 0 .or. abs(density(a) - density(b)) <= round_off*density(a)) cycle
        if (.not. (low(ndim, b) >= high(ndim, a) - near .and. &
                   all(min(high(:ndim - 1, a), high(:ndim - 1, b)) > &
                       max(low(:ndim - 1, a), low(:ndim - 1, b))))) cycle
        ! who gives the layers levels of their own has counted what lies above
        if (abs(scene%initial_state(state(a))%surface_level - &
                scene%initial_state(state(b))%surface_level) > near) cycle
        call checker%complain('initial_state', state(a), 'effective_stress', "takes '"// &
                              trim(scene%region(a)%name)//"' to have its own weight up to "// &
                              "surface_level, but '"//trim(scene%region(b)%name)//"' lies "// &
                              'above, whose weight is another: &time geostatic_start = .true. '// &
                              'finds the equilibrium')
        exit
      end do
    end do
  end subroutine warn_of_layers

  subroutine find_geostatic(scene, state)
    !! The initial state in force in every region, the last that names it or all regions, if its
    !! stresses are geostatic.
    type(scene_t), intent(in) :: scene
    integer, intent(out) :: state(:)   !! index, 0: there is none
    type(name_index_t) :: regions
    integer :: everywhere, k   ! the last one that names no region

    call regions%add_all(scene%region%name)
    state = 0
    everywhere = 0
    do k = 1, size(scene%initial_state)
      if (scene%initial_state(k)%region == '') then
        everywhere = k
      else
        state(regions%find(scene%initial_state(k)%region)) = k
      end if
    end do
    state = max(state, everywhere)
    do k = 1, size(state)
      if (state(k) == 0) cycle
      if (scene%initial_state(state(k))%effective_stress /= 'geostatic') state(k) = 0
    end do
  end subroutine find_geostatic

  subroutine warn_of_unused(checker, scene)
    !! Materials, surfaces and tables that nothing uses.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(name_index_t) :: materials, surfaces
    integer :: k

    call materials%add_all(scene%region%material)
    do k = 1, size(scene%material)
      if (materials%find(scene%material(k)%name) > 0) cycle
      call checker%complain('material', k, 'name', 'no &region uses it')
    end do
    call surfaces%add_all(scene%mechanical_condition%surface)
    call surfaces%add_all(scene%hydraulic_condition%surface)
    call surfaces%add_all(scene%probe%surface)
    do k = 1, size(scene%surface)
      if (scene%surface(k)%face == 'free') cycle   ! its area is a history
      if (surfaces%find(scene%surface(k)%name) > 0) cycle
      call checker%complain('surface', k, 'name', 'no condition or probe uses it')
    end do
    if (size(scene%table) > 0) call warn_of_unused_tables(checker, scene)
  end subroutine warn_of_unused

  subroutine warn_of_unused_tables(checker, scene)
    !! Tables that no formula calls.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=table_name_length) :: name
    logical :: is_used
    integer :: k, c

    do k = 1, size(scene%table)
      name = scene%table(k)%name
      is_used = scene%source%water%uses(name) .or. scene%base_motion%pattern%uses(name)
      do c = 1, size(scene%source%force)
        is_used = is_used .or. scene%source%force(c)%uses(name)
      end do
      do c = 1, size(scene%mechanical_condition)
        is_used = is_used .or. scene%mechanical_condition(c)%pattern%uses(name)
      end do
      do c = 1, size(scene%hydraulic_condition)
        is_used = is_used .or. scene%hydraulic_condition(c)%pattern%uses(name)
      end do
      do c = 1, size(scene%material)
        is_used = is_used .or. scene%material(c)%calls(name)
      end do
      if (.not. is_used) call checker%complain('table', k, 'name', 'no formula calls it')
    end do
  end subroutine warn_of_unused_tables

  subroutine warn_of_bodies(checker, scene)
    !! Gaps, loads that pull, bodies thinner than two cells, and those that nothing holds.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(region_contacts_t) :: contacts
    integer :: a, c, g

    call contacts%find(scene)
    do g = 1, size(contacts%gap)
      associate (gap => contacts%gap(g))
        call checker%complain('region', gap%second, 'name', 'lies '//to_text(gap%width, 4)// &
                              " m away from '"//trim(scene%region(gap%first)%name)//"' at "// &
                              vector_text(gap%place + scene%local_origin)//' [m]: within '// &
                              'a grid spacing the skeletons are joined, but no water passes')
      end associate
    end do
    do c = 1, size(contacts%pulls)
      if (.not. contacts%pulls(c)) cycle
      call checker%complain('mechanical_condition', c, 'value', 'pulls at the body: pressures '// &
                            'and plate forces are positive, tractions point into the body')
    end do
    if (any(scene%material%rigid)) return
    call warn_of_particle_gradients(checker, scene, contacts)
    do a = 1, size(scene%region)
      if (.not. contacts%cells_across(a) < least_cells*(1.0_wp - round_off)) cycle
      call checker%complain('region', a, 'name', 'makes a body of '// &
                            to_text(contacts%cells_across(a), 2)//' grid cells across, between '// &
                            'grid lines: two or more follow bending and shear; a smaller '// &
                            'spacing, or lines along its faces')
    end do
    do a = 1, size(scene%region)
      if (contacts%body(a) /= a .or. .not. norm2(contacts%unheld(:, a)) > round_off) cycle
      call checker%complain('region', a, 'name', 'gravity or loads drive the body along '// &
                            vector_text(contacts%unheld(:, a))//', where none of its '// &
                            'mechanical conditions holds it')
    end do
  end subroutine warn_of_bodies

  subroutine warn_of_particle_gradients(checker, scene, contacts)
    !! Particles as quadrature points under own weight, where surfaces cut cells: what the weight
    !! and the stresses that balance it miss of the cells is known for means of cells only.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    type(region_contacts_t), intent(in) :: contacts
    character(len=:), allocatable :: key

    if (.not. norm2(scene%gravity) > 0.0_wp) return
    if (scene%deformation == 'updated') return   ! what its cells lack is not known anyway
    if (all(scene%region%shape == 'box') .and. &
        .not. any(contacts%cells_across < huge(1.0_wp))) return
    if (.not. scene%mechanics%average_volume_change) then
      key = 'average_volume_change'
    else if (scene%mechanics%coupling_gradient == 'particle') then
      key = 'coupling_gradient'
    else
      return
    end if
    call checker%complain('mechanics', 1, key, 'stresses are then integrated by particles, '// &
                          'which do not fill the cells that surfaces cut: under own weight '// &
                          'displacements can be 10 to 24 % wrong; leave the key out, or put '// &
                          'grid lines along the faces')
  end subroutine warn_of_particle_gradients
end module dosui_scene_warnings

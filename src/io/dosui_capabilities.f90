!! Which integrator runs which scene: one table of what does not work, and why.
!!
!! A feature is something that a scene may ask for; a rule refuses it in some integrators and
!! deformations. What no rule refuses works. The checks of scenes, the choice of 'auto', the page
!! docs/namelist/combinations.md and `dosui --combinations` are made of this table, and
!! tests/verification/test_combinations.py runs every combination in it.
module dosui_capabilities
  use dosui_kinds, only: wp
  use dosui_integrator_traits, only: explicit, integrators, quasi_static, semi_implicit
  use dosui_scene, only: scene_t
  implicit none
  private

  character(len=*), parameter, public :: deformations(3) = [character(len=16) :: 'small_strain', &
                                                                                'finite', 'updated']
  character(len=*), parameter, public :: any_scene = 'any scene'   !! the feature of every scene
  character(len=*), parameter, public :: wall = 'wall by penalty', &
                                         moving_wall = 'moving wall by penalty'
  !! features of walls that do not follow the grid's lines, too

  type, public :: feature_t
    !! Something that a scene may ask for, and where it does.
    character(len=32) :: name = ''      !! of the page, messages and the test
    character(len=48) :: meaning = ''   !! in keys, for the page
    character(len=24) :: group = ''     !! that messages point at
    character(len=24) :: key = ''       !! likewise; empty: the group itself
  end type feature_t

  type :: rule_t
    !! What does not work.
    character(len=32) :: feature = ''
    character(len=48) :: integrators = ''      !! names, separated by blanks; empty: all
    character(len=32) :: deformations = ''     !! likewise
    character(len=256) :: reason = ''
  end type rule_t

  real(wp), parameter :: most_courant = 0.65_wp   !! of explicit steps of moving particles [-]

  public :: all_features, obstacle, reason_against, users_of

contains

  pure function all_features() result(features)
    !! Every feature that some combination refuses. The first one is in every scene.
    type(feature_t), allocatable :: features(:)

    features = [ &
               feature_t(any_scene, '', 'scene', 'deformation'), &
               feature_t('dry soil', "`water = 'none'`", 'scene', 'integrator'), &
               feature_t('rigid skeleton', '`rigid = .true.`', 'material', 'rigid'), &
               feature_t('suction', "`retention = 'van_genuchten'`", 'material', 'retention'), &
               feature_t('conductivity of porosity', "`conductivity_law = 'kozeny_carman'`", &
                         'material', 'conductivity_law'), &
               feature_t('cyclic sand', "`model = 'dafalias_manzari'`", 'material', 'model'), &
               feature_t('two-pass operator', "`operator = 'two_pass'`", 'water', 'operator'), &
               feature_t('fluid inertia', '`fluid_inertia = .true.`', 'water', 'fluid_inertia'), &
               feature_t('barrier', '`&barrier`', 'barrier', ''), &
               feature_t('period', '`period` in `&grid`', 'grid', 'period'), &
               feature_t('deforming domains', "`shape_function = 'cpgimp'`", 'grid', &
                         'shape_function'), &
               feature_t('shaken base', '`&base_motion`', 'base_motion', ''), &
               feature_t('absorbing surface', "`kind = 'absorbing'`", 'mechanical_condition', &
                         'kind'), &
               feature_t('initial velocity', '`velocity` in `&region`', 'region', 'velocity'), &
               feature_t('initial spin', '`spin` in `&region`', 'region', 'spin'), &
               feature_t('initial mode', '`mode_number`', 'initial_state', 'mode_number'), &
               feature_t('rigid wall', '`&rigid_wall` along an axis', 'rigid_wall', ''), &
               feature_t('oblique rigid wall', '`&rigid_wall`, any `normal`', 'rigid_wall', &
                         'normal'), &
               feature_t(wall, "`imposition = 'penalty'`, at rest", 'mechanical_condition', &
                         'imposition'), &
               feature_t(moving_wall, "`imposition = 'penalty'`, moving", &
                         'mechanical_condition', 'imposition'), &
               feature_t('long explicit steps', '`courant > 0.65`', 'time', 'courant')]
  end function all_features

  pure function rules() result(table)
    !! The table: each line refuses a feature in some integrators and deformations.
    type(rule_t), allocatable :: table(:)
    character(len=*), parameter :: with_inertia = explicit//' '//semi_implicit
    character(len=*), parameter :: implicit = semi_implicit//' '//quasi_static
    character(len=*), parameter :: and_inertia = ': take integrator = ''explicit'' or '// &
                                   '''semi_implicit'''
    character(len=*), parameter :: no_contact = 'equations of steps without inertia have no '// &
                                   'contact that opens and closes yet: take a condition of '// &
                                   'kind ''roller'' or ''fixed'', or integrator = '// &
                                   '''explicit'' or ''semi_implicit'''

    table = [ &
            rule_t(any_scene, quasi_static, 'updated', 'steps without inertia cannot follow '// &
                   'particles through the grid yet: take deformation = ''finite'', or '// &
                   'integrator = ''explicit'' or ''semi_implicit'''), &
            rule_t(any_scene, with_inertia, 'finite', 'the grid deforms with the body only in '// &
                   'steps without inertia: take integrator = ''quasi_static'', or '// &
                   'deformation = ''updated'''), &
            rule_t('dry soil', semi_implicit, '', 'a dry scene has no pore pressure that could '// &
                   'be implicit: take integrator = ''explicit'' or ''quasi_static'''), &
            rule_t('rigid skeleton', semi_implicit, '', 'a skeleton that does not move has no '// &
                   'waves to resolve: take integrator = ''quasi_static'' or ''explicit'''), &
            rule_t('rigid skeleton', '', 'finite', 'a skeleton that does not move has no '// &
                   'finite strains: take deformation = ''small_strain'''), &
            rule_t('suction', semi_implicit, '', 'semi-implicit steps do not follow '// &
                   'saturations yet: take integrator = ''explicit'' or ''quasi_static'''), &
            rule_t('conductivity of porosity', '', 'small_strain', 'small strains leave the '// &
                   'porosity as it is: take deformation = ''finite'' or ''updated'', or '// &
                   'conductivity_law = ''constant'''), &
            rule_t('cyclic sand', '', 'finite', 'the tensors that the sand remembers do not '// &
                   'turn with the body in finite strains: take deformation = ''small_strain'' '// &
                   'or ''updated'''), &
            rule_t('two-pass operator', implicit, '', 'the two-pass operator couples '// &
                'neighbours of neighbours, which equations of implicit steps do not hold: take '// &
                   'operator = ''compact'', or integrator = ''explicit'''), &
            rule_t('fluid inertia', implicit, '', 'in implicit steps accelerations of the step '// &
                   'before make pressures grow: take integrator = ''explicit'''), &
            rule_t('barrier', '', 'finite updated', 'barriers do not move with the soil: take '// &
                   'deformation = ''small_strain'''), &
            rule_t('period', '', 'finite updated', 'particles cannot cross the border of a '// &
                   'period yet: take deformation = ''small_strain'''), &
            rule_t('deforming domains', '', 'small_strain finite', 'domains of particles '// &
                   'stretch only where these move through the grid: take deformation = '// &
                   '''updated'', or shape_function = ''gimp'''), &
            rule_t('shaken base', quasi_static, '', 'shaking acts by inertia'//and_inertia), &
            rule_t('absorbing surface', quasi_static, '', 'there are no waves to let out '// &
                   'without inertia'//and_inertia), &
            rule_t('initial velocity', quasi_static, '', 'bodies without inertia keep no '// &
                   'velocity'//and_inertia), &
            rule_t('initial spin', quasi_static, '', 'bodies without inertia keep no spin'// &
                   and_inertia), &
            rule_t('initial mode', quasi_static, '', 'bodies without inertia do not vibrate'// &
                   and_inertia), &
            rule_t('rigid wall', quasi_static, '', no_contact), &
            rule_t('oblique rigid wall', quasi_static, '', no_contact), &
            rule_t('oblique rigid wall', semi_implicit, '', 'semi-implicit steps hold walls '// &
                   'only along the axes yet: take a normal along an axis (and turn body and '// &
                   'gravity), or integrator = ''explicit'''), &
            rule_t(wall, '', 'finite', 'springs of walls off the grid lines do not follow a '// &
                   'grid that deforms: take faces along grid lines and imposition = ''auto'', '// &
                   'or deformation = ''small_strain'''), &
            rule_t(moving_wall, implicit, '', 'equations of implicit steps move walls on grid '// &
                   'nodes only: take faces along grid lines and imposition = ''auto'', or '// &
                   'integrator = ''explicit'''), &
            rule_t('long explicit steps', explicit, 'updated', 'in longer steps particles at '// &
                   'free surfaces would lose their volume: take courant = 0.65 or less')]
  end function rules

  pure function reason_against(feature, integrator, deformation) result(reason)
    !! Why a feature does not work with an integrator and a deformation; empty: it works, if the
    !! integrator and the deformation go together ('any scene').
    character(len=*), intent(in) :: feature       !! its name
    character(len=*), intent(in) :: integrator    !! never 'auto'
    character(len=*), intent(in) :: deformation
    character(len=:), allocatable :: reason
    type(rule_t), allocatable :: table(:)
    integer :: k

    reason = ''
    table = rules()
    do k = 1, size(table)
      if (table(k)%feature /= feature) cycle
      if (.not. (holds(table(k)%integrators, integrator) .and. &
                 holds(table(k)%deformations, deformation))) cycle
      reason = trim(table(k)%reason)
      return
    end do
  end function reason_against

  pure logical function holds(list, word)
    !! Is a word in a list that is separated by blanks? An empty list holds everything.
    character(len=*), intent(in) :: list, word

    holds = list == '' .or. index(' '//trim(list)//' ', ' '//trim(word)//' ') > 0
  end function holds

  pure function obstacle(scene, integrator) result(name)
    !! The first feature of a scene that an integrator refuses; empty: it can run the scene.
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: integrator   !! never 'auto'
    character(len=:), allocatable :: name
    type(feature_t), allocatable :: features(:)
    integer :: f

    features = all_features()
    do f = 1, size(features)
      name = trim(features(f)%name)
      if (len(reason_against(name, integrator, scene%deformation)) == 0) cycle
      if (size(users_of(scene, name)) > 0) return
    end do
    name = ''
  end function obstacle

  pure function users_of(scene, feature) result(users)
    !! The instances of a feature's group that ask for it.
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: feature   !! its name
    integer, allocatable :: users(:)
    logical, allocatable :: asks(:)
    integer :: k

    allocate (asks(0))
    select case (feature)
    case (any_scene)
      asks = [.true.]
    case ('dry soil')
      asks = [scene%water_mode == 'none']
    case ('rigid skeleton')
      asks = scene%material%rigid
    case ('suction')
      asks = scene%material%retention /= 'none' .and. scene%water_mode /= 'none'
    case ('conductivity of porosity')
      asks = scene%material%conductivity_law /= 'constant'
    case ('cyclic sand')
      asks = .not. scene%material%follows_finite_strains()
    case ('two-pass operator')
      asks = [scene%water%operator == 'two_pass' .and. scene%water_mode /= 'none']
    case ('fluid inertia')
      asks = [scene%water%fluid_inertia .and. scene%water_mode /= 'none']
    case ('barrier')
      if (allocated(scene%barrier)) asks = spread(.true., 1, size(scene%barrier))
    case ('period')
      asks = [any(scene%grid_period > 0.0_wp)]
    case ('deforming domains')
      asks = [scene%shape_function == 'cpgimp']
    case ('shaken base')
      asks = [any(abs(scene%base_motion%acceleration) > 0.0_wp)]
    case ('absorbing surface')
      asks = scene%mechanical_condition%kind == 'absorbing'
    case ('initial velocity')
      asks = [(any(abs(scene%region(k)%velocity) > 0.0_wp), k=1, size(scene%region))]
    case ('initial spin')
      asks = abs(scene%region%spin) > 0.0_wp
    case ('initial mode')
      asks = scene%initial_state%mode_number > 0
    case ('rigid wall')
      asks = .not. walls_are_oblique(scene)
    case ('oblique rigid wall')
      asks = walls_are_oblique(scene)
    case (wall)
      asks = scene%mechanical_condition%imposition == 'penalty' .and. &
             .not. scene%mechanical_condition%moves_wall()
    case (moving_wall)
      asks = scene%mechanical_condition%imposition == 'penalty' .and. &
             scene%mechanical_condition%moves_wall()
    case ('long explicit steps')
      asks = [scene%time%courant > most_courant]
    case default   ! no feature of the table
    end select
    users = pack([(k, k=1, size(asks))], asks)
  end function users_of

  pure function walls_are_oblique(scene) result(oblique)
    !! Does the normal of a rigid wall lie across the axes?
    type(scene_t), intent(in) :: scene
    logical, allocatable :: oblique(:)   !! (number of rigid walls)
    integer :: k

    allocate (oblique(0))
    if (.not. allocated(scene%rigid_wall)) return
    oblique = [(count(abs(scene%rigid_wall(k)%normal) > 0.0_wp) > 1, k=1, size(scene%rigid_wall))]
  end function walls_are_oblique
end module dosui_capabilities

!! Does the scene's integrator do what the scene asks for? The table of `dosui_capabilities`
!! against a scene; where the scene leaves the integrator open, against all of them.
module dosui_combination_checks
  use dosui_capabilities, only: all_features, any_scene, feature_t, obstacle, reason_against, &
                                users_of
  use dosui_integrator_traits, only: integrators, integrator_traits_t, traits_of
  use dosui_namelist, only: namelist_t
  use dosui_problems, only: problems_t
  use dosui_scene, only: scene_t
  use dosui_scene_checks, only: checker_t
  implicit none
  private

  public :: check_combinations

contains

  subroutine check_combinations(scene, namelist, problems)
    !! Every feature of a scene that its integrator refuses, with the reason, at its line. A scene
    !! that passes has an integrator, or one that 'auto' may take.
    type(scene_t), intent(in) :: scene
    type(namelist_t), intent(in), target :: namelist
    type(problems_t), intent(inout) :: problems
    type(checker_t) :: checker
    type(feature_t), allocatable :: features(:)
    type(integrator_traits_t) :: given
    character(len=:), allocatable :: reason
    integer, allocatable :: users(:)
    integer :: f, k, n_problem

    checker%namelist => namelist
    checker%problems = problems
    n_problem = problems%count()
    given = traits_of(scene%integrator)
    features = all_features()
    do f = 1, size(features)
      if (given%stands()) then
        reason = reason_against(trim(features(f)%name), trim(given%name), scene%deformation)
      else
        reason = reason_against_all(trim(features(f)%name), scene%deformation)
      end if
      if (len(reason) == 0) cycle
      users = users_of(scene, trim(features(f)%name))
      do k = 1, size(users)
        call checker%complain(trim(features(f)%group), users(k), trim(features(f)%key), reason)
      end do
    end do
    if (.not. given%stands() .and. checker%problems%count() == n_problem) then
      call check_together(checker, scene)
    end if
    problems = checker%problems
  end subroutine check_combinations

  pure function reason_against_all(feature, deformation) result(reason)
    !! Why a feature works with no integrator that a deformation has; empty: with one of them.
    character(len=*), intent(in) :: feature, deformation
    character(len=:), allocatable :: reason, others
    integer :: k

    reason = ''
    others = ''
    do k = 1, size(integrators)
      if (len(reason_against(any_scene, trim(integrators(k)), deformation)) > 0) then
        others = 'others'
        cycle
      end if
      reason = reason_against(feature, trim(integrators(k)), deformation)
      if (len(reason) == 0) return
      if (len(others) > 0) reason = reason//' (deformation = '''//trim(deformation)// &
                                    ''' works with integrator = '''//trim(integrators(k))//''')'
    end do
  end function reason_against_all

  subroutine check_together(checker, scene)
    !! Features that go with some integrator each, but with none together.
    type(checker_t), intent(inout) :: checker
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: feature, list
    integer :: k

    feature = ''
    list = ''
    do k = 1, size(integrators)
      feature = obstacle(scene, trim(integrators(k)))
      if (len(feature) == 0) return
      if (feature == any_scene) cycle   ! not of this deformation
      if (len(list) > 0) list = list//'; '
      list = list//trim(integrators(k))//' does not go with: '//feature
    end do
    call checker%complain('scene', 1, 'integrator', 'no integrator can do all that the scene '// &
                          'asks for with deformation = '''//trim(scene%deformation)//''': '//list)
  end subroutine check_together
end module dosui_combination_checks

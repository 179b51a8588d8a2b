!! What works with what, from the table of `dosui_capabilities`: for readers the page
!! docs/namelist/combinations.md, for programs a list with tabs.
module dosui_combinations_page
  use dosui_capabilities, only: all_features, any_scene, deformations, feature_t, reason_against
  use dosui_integrator_traits, only: integrators
  use dosui_text, only: to_text
  implicit none
  private

  public :: combinations_list, combinations_page

  character(len=*), parameter :: newline = new_line('a'), tab = achar(9)

  type :: note_t
    !! A reason that tables refer to by its number.
    character(len=:), allocatable :: text
  end type note_t

contains

  function combinations_list() result(text)
    !! Every feature with every integrator and deformation that go together, and the feature 'any
    !! scene' with all: feature, integrator, deformation, group and key that messages point at, and
    !! the reason of a refusal, with tabs between them, a line each.
    character(len=:), allocatable :: text
    type(feature_t), allocatable :: features(:)
    character(len=:), allocatable :: reason
    integer :: f, i, d

    text = 'feature'//tab//'integrator'//tab//'deformation'//tab//'group'//tab//'key'//tab// &
           'reason'//newline
    reason = ''
    features = all_features()
    do f = 1, size(features)
      do d = 1, size(deformations)
        do i = 1, size(integrators)
          if (features(f)%name /= any_scene .and. .not. goes_together(i, d)) cycle
          reason = reason_against(features(f)%name, integrators(i), deformations(d))
          text = text//trim(features(f)%name)//tab//trim(integrators(i))//tab// &
                 trim(deformations(d))//tab//trim(features(f)%group)//tab// &
                 trim(features(f)%key)//tab//reason//newline
        end do
      end do
    end do
  end function combinations_list

  function combinations_page(mark) result(text)
    !! The whole page.
    character(len=*), intent(in) :: mark   !! that says who writes it, for the first line
    character(len=:), allocatable :: text
    type(note_t), allocatable :: notes(:)
    integer :: k

    allocate (notes(0))
    text = mark//'# What works with what'//newline//newline// &
           'A scene has one `integrator`, one kind of `deformation` (both in '// &
           '[`&scene`](scene.md)), and any number of'//newline// &
           'the features below. What is not listed works with '// &
           'all of them. A number leads to the reason, which dosui'//newline//'gives when it '// &
           'refuses such a scene. `integrator = ''auto''`, the default, takes one that '// &
           'says yes to all'//newline//'that the scene asks for; the log tells which and why.'// &
           newline//newline//'## Integrator and deformation'//newline//newline// &
           cell_table(notes)//newline//'## Features'//newline//newline//feature_table(notes)// &
           newline//'## Reasons'//newline//newline
    do k = 1, size(notes)
      text = text//to_text(k)//'. '//sentence(notes(k)%text)//newline
    end do
  end function combinations_page

  pure function sentence(reason) result(text)
    !! A reason with a capital and a full stop.
    character(len=*), intent(in) :: reason
    character(len=:), allocatable :: text

    text = reason//'.'
    if (reason(1:1) >= 'a' .and. reason(1:1) <= 'z') text(1:1) = achar(iachar(reason(1:1)) - 32)
  end function sentence

  function cell_table(notes) result(text)
    !! Integrators against deformations.
    type(note_t), allocatable, intent(inout) :: notes(:)
    character(len=:), allocatable :: text
    integer :: d, i

    text = '| |'
    do d = 1, size(deformations)
      text = text//' `'//trim(deformations(d))//'` |'
    end do
    text = text//newline//'|---|'//repeat('---|', size(deformations))//newline
    do i = 1, size(integrators)
      text = text//'| `'//trim(integrators(i))//'` |'
      do d = 1, size(deformations)
        text = text//' '//answer(any_scene, i, d, notes)//' |'
      end do
      text = text//newline
    end do
  end function cell_table

  function feature_table(notes) result(text)
    !! Features against pairs of integrator and deformation that go together.
    type(note_t), allocatable, intent(inout) :: notes(:)
    character(len=:), allocatable :: text, below
    type(feature_t), allocatable :: features(:)
    integer :: f, d, i

    text = '| feature | asked for by |'
    below = '|---|---|'
    do d = 1, size(deformations)
      do i = 1, size(integrators)
        if (.not. goes_together(i, d)) cycle
        text = text//' `'//trim(integrators(i))//'` `'//trim(deformations(d))//'` |'
        below = below//'---|'
      end do
    end do
    text = text//newline//below//newline
    features = all_features()
    do f = 1, size(features)
      if (features(f)%name == any_scene) cycle
      text = text//'| '//trim(features(f)%name)//' | '//trim(features(f)%meaning)//' |'
      do d = 1, size(deformations)
        do i = 1, size(integrators)
          if (goes_together(i, d)) text = text//' '//answer(features(f)%name, i, d, notes)//' |'
        end do
      end do
      text = text//newline
    end do
  end function feature_table

  pure logical function goes_together(i, d) result(together)
    !! Does any scene run with an integrator and a deformation?
    integer, intent(in) :: i, d   !! indices

    together = len(reason_against(any_scene, integrators(i), deformations(d))) == 0
  end function goes_together

  function answer(feature, i, d, notes) result(text)
    !! 'yes', or 'no' with the number of the reason.
    character(len=*), intent(in) :: feature
    integer, intent(in) :: i, d   !! of the integrator and the deformation
    type(note_t), allocatable, intent(inout) :: notes(:)
    character(len=:), allocatable :: text, reason
    integer :: k

    reason = reason_against(feature, integrators(i), deformations(d))
    text = 'yes'
    if (len(reason) == 0) return
    do k = 1, size(notes)
      if (notes(k)%text == reason) exit
    end do
    if (k > size(notes)) notes = [notes, note_t(reason)]
    text = 'no ('//to_text(k)//')'
  end function answer
end module dosui_combinations_page

!! Ends of runs that are asked for while an equilibrium is sought, which may take much longer than
!! a step.
module dosui_interruption
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: look_for_interruption

contains

  subroutine look_for_interruption(model, err)
    !! Ends a start as an error does if any rank has been asked to end. `model%is_interrupted` tells
    !! this error from those that another attempt may mend. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    logical :: asked

    asked = .false.
    if (associated(model%asked_to_end)) asked = model%asked_to_end()
    if (.not. model%comm%any(asked)) return
    model%is_interrupted = .true.
    call err%set('stopped by a signal while the start sought the equilibrium at t = '// &
                 to_text(model%clock%time)//' s; nothing is kept of it')
  end subroutine look_for_interruption
end module dosui_interruption

!! Grid, owners and neighbourhoods follow the particles of scenes whose geometry is updated.
module dosui_following
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_state_check, only: check_state, describe_particle
  use dosui_text, only: to_text
  use dosui_topology, only: build_geometry, distribute, needs_rebuild, refresh_storage, &
                            refresh_weights
  implicit none
  private

  public :: keep_up, rebuild

  real(wp), parameter :: beyond = 0.01_wp   !! the domain: a wall there may give way [h]

contains

  subroutine keep_up(model, err)
    !! After a step of an updated scene: grid, owners and neighbourhoods follow the particles.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call say_inverted(model, err)
    call model%comm%agree(err)   ! only in updated scenes can a single rank fail within a step
    if (err%failed()) return
    if (needs_rebuild(model)) then
      call rebuild(model, err)
    else
      call follow(model, err)
    end if
  end subroutine keep_up

  subroutine say_inverted(model, err)
    !! Names a particle that would have lost its volume or pores in this step, if there is one; NaN
    !! is no volume either, but has its own cause.
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err

    if (model%inverted == 0) return
    if (model%fault%failed()) then
      call err%set(model%fault%message)
    else if (model%pores_close) then
      call err%set(describe_particle(model, 'closes its pores: it is compressed beyond the '// &
                                     'volume of its grains', model%inverted))
    else
      call err%set(describe_particle(model, 'has lost all its volume (J <= 0)', model%inverted))
    end if
  end subroutine say_inverted

  subroutine rebuild(model, err)
    !! Particles go to their owners, everything that depends on places is built anew. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err

    call check_state(model, err)   ! a position that is no number would only seem to leave
    if (.not. err%failed()) call remove_leavers(model, err)
    if (.not. err%failed()) call distribute(model, err)
    if (.not. err%failed()) call build_geometry(model, err)
    call model%comm%agree(err)
  end subroutine rebuild

  subroutine follow(model, err)
    !! Cells, patches, cell volumes and storage of particles that moved within the grid.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer :: n_lost, n

    n = model%particles%count
    call model%grid%locate(n, model%particles%field(model%p%position)%values, model%mesh%patch, &
                           model%mesh%cell, n_lost)
    if (n_lost > 0) call err%set('particles moved out of the grid in one step at t = '// &
                                 to_text(model%clock%time)//' s: the run is unstable')
    call model%comm%agree(err)
    if (err%failed()) return
    call refresh_weights(model)
    if (model%coupled) call refresh_storage(model)
  end subroutine follow

  subroutine remove_leavers(model, err)
    !! Particles outside the scene's domain: an error, or removed and counted.
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    integer, allocatable :: keep(:)
    logical, allocatable :: inside(:)
    real(wp) :: margin   ! [m]
    integer :: p, n

    n = model%particles%count
    margin = beyond*model%scene%grid_spacing
    allocate (inside(n))
    do p = 1, n
      associate (x => model%particles%field(model%p%position)%values(:, p))
        inside(p) = all(x >= model%scene%domain_min - margin .and. &
                        x <= model%scene%domain_max + margin)
      end associate
    end do
    if (.not. model%comm%any(.not. all(inside))) return
    if (model%scene%leaving_particles == 'stop') then
      if (.not. all(inside)) then
        call err%set(describe_particle(model, 'left the domain', findloc(inside, .false., dim=1)))
      end if
      call model%comm%agree(err)
      return
    end if
    model%decomposition%removed = model%decomposition%removed + &
                                  model%comm%sum(int(count(.not. inside), i8))
    keep = pack([(p, p=1, n)], inside)
    model%particles%count = size(keep)
    call model%particles%reorder(keep)
    call model%log%warning('particles left the domain and were removed: '// &
                           to_text(model%decomposition%removed)//' so far')
  end subroutine remove_leavers
end module dosui_following

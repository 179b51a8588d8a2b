!! What a scene loads, drains and measures, surface by surface, before anything is computed.
module dosui_surface_report
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_face_pieces, only: is_faceted
  use dosui_model, only: model_t
  use dosui_probes, only: points_in_reach
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: hydraulic_condition_t, mechanical_condition_t
  use dosui_seeding, only: region_spacing
  use dosui_surface_forces, only: load_traction
  use dosui_surface_sets, only: index_of, set_holds
  use dosui_text, only: to_text, vector_text
  use dosui_wall, only: wall_t
  implicit none
  private

  public :: describe_surfaces

  integer, parameter :: samples = 64   !! times at which a formula is looked at
  character(len=*), parameter :: unit_of_force = merge('N  ', merge('N/m', 'Pa ', ndim == 2), &
                                                       ndim == 3)
  character(len=*), parameter :: unit_of_area = merge('m2', 'm ', ndim == 3)

contains

  subroutine describe_surfaces(model)
    !! One line for every surface, mechanical condition, hydraulic condition and probe. Collective.
    type(model_t), intent(inout) :: model
    integer :: k

    call list_surfaces(model)
    do k = 1, size(model%scene%mechanical_condition)
      if (model%scene%mechanical_condition(k)%is_load()) then
        call list_load(model, k)
      else
        call list_wall(model, k)
      end if
    end do
    if (model%coupled) then
      do k = 1, size(model%scene%hydraulic_condition)
        call list_water(model, model%scene%hydraulic_condition(k))
      end do
    end if
    call list_probes(model)
  end subroutine describe_surfaces

  subroutine list_surfaces(model)
    !! Points and area of every surface.
    type(model_t), intent(inout) :: model
    real(wp) :: sums(2*size(model%scene%surface))
    character(len=:), allocatable :: area
    integer :: s, p

    sums = 0.0_wp
    associate (set => model%surface%field(model%s%surface)%values, &
               areas => model%surface%field(model%s%area)%values)
      do p = 1, model%surface%count
        do s = 1, size(model%scene%surface)
          if (.not. set_holds(set(:, p), s)) cycle
          sums(2*s - 1) = sums(2*s - 1) + 1.0_wp
          sums(2*s) = sums(2*s) + areas(1, p)
        end do
      end do
    end associate
    call model%comm%sum_array(sums)
    do s = 1, size(model%scene%surface)
      area = ''
      if (ndim > 1) area = ', '//to_text(sums(2*s), 6)//' '//trim(unit_of_area)
      call model%log%info('surface      '//trim(model%scene%surface(s)%name)//': '// &
                          trim(model%scene%surface(s)%face)//' of '// &
                          trim(model%scene%surface(s)%region)//', '// &
                          to_text(nint(sums(2*s - 1)))//' points'//area)
    end do
  end subroutine list_surfaces

  subroutine list_wall(model, c)
    !! How a wall or plate is imposed, and the force of a plate.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: c   !! mechanical condition
    type(wall_t) :: wall
    integer :: fitted, forced
    character(len=:), allocatable :: force

    fitted = model%comm%sum(count(model%skeleton%on_nodes(c, :)))
    forced = model%comm%sum(count(model%skeleton%by_force(c, :)))
    associate (condition => model%scene%mechanical_condition(c))
      force = ''
      wall = condition%wall()
      if (wall%is_plate()) force = ', total force '//to_text(condition%value(1), 6)// &
                                   ' '//trim(unit_of_force)//variation(condition%pattern)
      call model%log%info('wall         '//trim(condition%surface)//': '//trim(condition%kind)// &
                          ' on '//trim(merge('grid nodes   ', 'penalty walls', forced == 0))// &
                          ' ('//to_text(fitted + forced)//' points)'//force)
      if (forced > 0 .and. .not. wall%holds_all) then
        call warn_of_facets(model, condition%surface)
      end if
    end associate
  end subroutine list_wall

  subroutine warn_of_facets(model, surface)
    !! Facets that lean against the surface they stand for hold its tangential motion, too.
    type(model_t), intent(inout) :: model
    character(len=*), intent(in) :: surface
    real(wp) :: spacing
    integer :: r, s

    s = index_of(model%scene, surface)
    r = findloc(model%scene%region%name == model%scene%surface(s)%region, .true., dim=1)
    spacing = region_spacing(model%scene, model%scene%region(r))
    if (.not. is_faceted(model%scene%region(r), trim(model%scene%surface(s)%face), spacing)) return
    call model%log%warning("&mechanical_condition: surface '"//trim(surface)//"' is curved, "// &
                           'but its facets are larger than cells: the wall holds facet by '// &
                           'facet, also along the surface; take a finer &region stl_file')
  end subroutine warn_of_facets

  subroutine list_load(model, c)
    !! The total force of a load, when it is largest.
    type(model_t), intent(inout) :: model
    integer, intent(in) :: c   !! mechanical condition
    real(wp), allocatable :: times(:), force(:, :)
    integer :: k, largest, p, s

    associate (condition => model%scene%mechanical_condition(c), field => model%surface%field, &
               h => model%s)
      if (condition%kind == 'absorbing') then
        call model%log%info('load         '//trim(condition%surface)//': absorbing')
        return
      end if
      s = index_of(model%scene, condition%surface)
      allocate (times, source=telling_times(condition%pattern, model%scene%time%end_time))
      allocate (force(ndim, size(times)), source=0.0_wp)
      do p = 1, model%surface%count
        if (.not. set_holds(field(h%surface)%values(:, p), s)) cycle
        do k = 1, size(times)
          force(:, k) = force(:, k) + field(h%area)%values(1, p)* &
                        load_traction(condition, times(k), field(h%position)%values(:, p), &
                                      field(h%normal)%values(:, p))
        end do
      end do
      do k = 1, size(times)
        call model%comm%sum_array(force(:, k))
      end do
      largest = maxloc(norm2(force, dim=1), dim=1)
      if (size(times) > 1) then
        call model%log%info('load         '//trim(condition%surface)//': '// &
                            trim(condition%kind)//', largest total force '// &
                            vector_text(force(:, largest))//' '//trim(unit_of_force)// &
                            ' at t = '//to_text(times(largest), 6)//' s')
      else
        call model%log%info('load         '//trim(condition%surface)//': '// &
                            trim(condition%kind)//', total force '// &
                            vector_text(force(:, 1))//' '//trim(unit_of_force))
      end if
    end associate
  end subroutine list_load

  subroutine list_water(model, condition)
    !! What a hydraulic condition prescribes.
    type(model_t), intent(inout) :: model
    type(hydraulic_condition_t), intent(in) :: condition
    character(len=:), allocatable :: text

    text = 'water        '//trim(condition%surface)//': '//trim(condition%kind)
    select case (condition%kind)
    case ('head', 'reservoir')
      text = text//' '//to_text(condition%value, 6)//' m'//variation(condition%pattern)
    case ('pressure')
      text = text//' '//to_text(condition%value, 6)//' Pa'//variation(condition%pattern)
    case ('flux', 'rainfall')
      text = text//' '//to_text(condition%value, 6)//' m/s'//variation(condition%pattern)
    case default   ! no_flow, seepage_face
    end select
    call model%log%info(text)
  end subroutine list_water

  subroutine list_probes(model)
    !! What is measured where; a warning for points that no particle is near.
    type(model_t), intent(inout) :: model
    integer :: k

    do k = 1, size(model%scene%probe)
      associate (probe => model%scene%probe(k), &
                 name => 'probe        '//trim(model%scene%probe(k)%name)//': ')
        select case (probe%kind)
        case ('settlement')
          call model%log%info(name//"settlement of surface '"//trim(probe%surface)//"'")
        case ('surface_mean')
          call model%log%info(name//'mean '//trim(probe%field)//" over surface '"// &
                              trim(probe%surface)//"'")
        case ('domain_sum')
          call model%log%info(name//'integral of '//trim(probe%field))
        case ('run_out')
          call model%log%info(name//'run-out of '//to_text(100.0_wp*probe%fraction)// &
                              ' % of the mass from '//vector_text(probe%position + &
                                                                  model%scene%local_origin))
        case default
          call model%log%info(name//trim(probe%field)//' at '//vector_text(probe%position + &
                                                                          model%scene%local_origin))
          if (points_in_reach(model, probe%position) > 0) cycle
          call model%log%warning("&probe '"//trim(probe%name)//"': no particle is near its "// &
                                 'position; its history is 0 as long as none comes')
        end select
      end associate
    end do
  end subroutine list_probes

  pure function variation(pattern) result(text)
    !! Says that a value varies.
    type(scalar_function_t), intent(in) :: pattern
    character(len=:), allocatable :: text

    text = ''
    if (allocated(pattern%factor%argument)) then
      text = ' times '//to_text(size(pattern%factor%argument))//' factors of time'
    end if
    if (allocated(pattern%formula)) text = text//' times '//pattern%formula
  end function variation

  pure function telling_times(pattern, end_time) result(times)
    !! When a load may be largest: one time if it is constant [s].
    type(scalar_function_t), intent(in) :: pattern
    real(wp), intent(in) :: end_time   !! [s]
    real(wp), allocatable :: times(:)
    integer :: k

    times = [0.0_wp]
    associate (corner => pattern%corners(ndim))
      if (size(corner) > 0) then
        times = [times, pack(corner, corner > 0.0_wp .and. corner < end_time), end_time]
      end if
    end associate
    if (allocated(pattern%formula)) then
      times = [times, (end_time*real(k, wp)/real(samples, wp), k=1, samples)]
    end if
  end function telling_times
end module dosui_surface_report

!! Keys of what acts on bodies, and of the tables that formulas call.
module dosui_condition_keys
  use dosui_dimension, only: ndim, axis
  use dosui_key_visitor, only: key, key_visitor_t, restart_content, restart_later
  use dosui_scene, only: mechanical_condition_t, hydraulic_condition_t, base_motion_t, source_t, &
                         axis_name
  use dosui_table, only: named_table_t, table_t
  implicit none
  private

  public :: visit_named_table, visit_mechanical_condition, visit_hydraulic_condition, &
            visit_source, visit_base_motion

contains

  subroutine visit_named_table(v, table)
    !! Keys of &table.
    class(key_visitor_t), intent(inout) :: v
    type(named_table_t), intent(inout) :: table

    call v%name(table%name, &
                key('name', 'what formulas call it: a letter, then letters, digits and _', &
                    required=.true.))
    call v%list(table%argument, &
                key('arguments', 'where its values are known, strictly increasing: times [s], '// &
                    'elevations [m], or what formulas call it with', only='no file', &
                    applies=.not. allocated(table%file)))
    call v%list(table%value, &
                key('values', 'of the function there: linear between, constant before the '// &
                    'first and after the last', only='no file', &
                    applies=.not. allocated(table%file)))
    call v%text(table%file, &
                key('file', 'a file with an argument and a value in each line, a path from the '// &
                    'scene''s folder, in the place of arguments and values; # begins a '// &
                    'comment', longest=1000, restart=restart_content))
  end subroutine visit_named_table

  subroutine visit_mechanical_condition(v, condition)
    !! Keys of &mechanical_condition.
    class(key_visitor_t), intent(inout) :: v
    type(mechanical_condition_t), intent(inout) :: condition
    character(len=*), parameter :: no_wall = 'a kind other than ''roller'', ''fixed'' and '// &
                                   '''absorbing'''
    integer :: n
    logical :: has_value

    call v%name(condition%surface, key('surface', 'name of a &surface', required=.true.))
    call v%name(condition%kind, &
                key('kind', 'roller: no normal motion; fixed: none at all; velocity, '// &
                    'normal_velocity: prescribed; traction, pressure: loads; reservoir: '// &
                    'pressure of water with a free level; absorbing: lets waves out (dashpots '// &
                    'of Lysmer and Kuhlemeyer); plate: rigid, '// &
                    'frictionless, one normal velocity and a total force', required=.true., &
                    choices='roller fixed velocity normal_velocity traction pressure reservoir '// &
                    'absorbing plate'))
    call v%name(condition%imposition, &
                key('imposition', 'of walls: on grid nodes, by springs on the true surface, or '// &
                    'nodes where the grid follows the surface', choices='auto nodes penalty', &
                    only='a wall or plate', applies=.not. condition%is_load()))
    has_value = condition%kind /= 'roller' .and. condition%kind /= 'fixed' .and. &
                condition%kind /= 'absorbing'
    n = ndim
    if (condition%kind == 'pressure' .or. condition%kind == 'plate' .or. &
        condition%kind == 'reservoir' .or. condition%kind == 'normal_velocity') n = 1
    call v%vector(condition%value(1:n), &
                  key('value', 'velocity [m/s] and traction [Pa]: a vector; normal_velocity '// &
                      '[m/s]: outward; pressure: into the body [Pa]; reservoir: elevation of '// &
                      'its level [m]; plate: total force into '// &
                      'the body [N; N/m in 2-D, Pa in 1-D]', only=no_wall, &
                      applies=has_value, &
                      required=.true., undecided=condition%kind == ''))
    call visit_table(v, condition%pattern%factor, no_wall, has_value)
    call visit_formula(v, condition%pattern%formula, 'a given load', &
                       condition%is_load() .and. has_value)
  end subroutine visit_mechanical_condition

  subroutine visit_hydraulic_condition(v, condition)
    !! Keys of &hydraulic_condition.
    class(key_visitor_t), intent(inout) :: v
    type(hydraulic_condition_t), intent(inout) :: condition
    character(len=*), parameter :: has_no_value = 'a kind other than ''no_flow'' and '// &
                                   '''seepage_face'''
    logical :: has_value

    call v%name(condition%surface, key('surface', 'name of a &surface', required=.true.))
    call v%name(condition%kind, &
                key('kind', 'total head, pore pressure, outward Darcy flux, or none; '// &
                    'reservoir: the head of its level below it, a seepage face above; '// &
                    'seepage_face: water '// &
                    'may leave at zero pressure, none enters; rainfall: enters as far as it '// &
                    'can without ponding', required=.true., &
                    choices='head pressure flux no_flow reservoir seepage_face rainfall'))
    has_value = condition%kind /= 'no_flow' .and. condition%kind /= 'seepage_face'
    call v%real(condition%value, &
                key('value', 'head [m], pressure [Pa], flux [m/s], outward positive, elevation '// &
                    'of the reservoir''s level [m], or rain on a level plane [m/s]', &
                    only=has_no_value, applies=has_value, required=.true., &
                    undecided=condition%kind == ''))
    call visit_table(v, condition%pattern%factor, has_no_value, has_value)
    call visit_formula(v, condition%pattern%formula, has_no_value, has_value)
  end subroutine visit_hydraulic_condition

  subroutine visit_source(v, source)
    !! Keys of &source.
    class(key_visitor_t), intent(inout) :: v
    type(source_t), intent(inout) :: source
    character(len=18), parameter :: scenes(3) = [character(len=18) :: 'dimension = 2 or 3', &
                                                                                'dimension = 3', '']
    integer :: d

    do d = 1, 3
      call v%text(source%force(d)%formula, &
                  key('force_'//axis_name(d), 'formula of the body force along '// &
                      axis_name(d)//', beside gravity', unit='N/m3', longest=1000, &
                      only=trim(scenes(d)), applies=any(axis == d)))
    end do
    call v%text(source%water%formula, &
                key('water', 'formula of the water supplied per volume of soil', unit='1/s', &
                    longest=1000))
  end subroutine visit_source

  subroutine visit_base_motion(v, motion)
    !! Keys of &base_motion.
    class(key_visitor_t), intent(inout) :: v
    type(base_motion_t), intent(inout) :: motion

    call v%vector(motion%acceleration, &
                  key('acceleration', 'of the base, times the factors below', unit='m/s2', &
                      fallback='none'))
    call visit_table(v, motion%pattern%factor, '', .true.)
    call v%text(motion%file, &
                key('file', 'a file with a time [s] and a factor in each line, a path from '// &
                    'the scene''s folder, takes the place of factor_times and '// &
                    'factor_values; # begins a comment', longest=1000, restart=restart_content))
    call visit_formula(v, motion%pattern%formula, '', .true.)
  end subroutine visit_base_motion

  subroutine visit_formula(v, formula, only, applies)
    !! The key of a formula of place and time.
    class(key_visitor_t), intent(inout) :: v
    character(len=:), allocatable, intent(inout) :: formula
    character(len=*), intent(in) :: only
    logical, intent(in) :: applies

    call v%text(formula, &
                key('formula', 'a further factor on value, a formula of x, y, z [m] and t [s] '// &
                    'as in &source', unit='-', longest=1000, only=only, applies=applies, &
                    fallback='1 everywhere'))
  end subroutine visit_formula

  subroutine visit_table(v, table, only, applies)
    !! The two keys of a factor over time.
    class(key_visitor_t), intent(inout) :: v
    type(table_t), intent(inout) :: table
    character(len=*), intent(in) :: only
    logical, intent(in) :: applies

    call v%list(table%argument, &
                key('factor_times', 'times of factor_values, strictly increasing', unit='s', &
                    only=only, applies=applies, restart=restart_later))
    call v%list(table%value, &
                key('factor_values', 'factors on value: linear between the times, constant '// &
                    'before and after', unit='-', only=only, applies=applies, &
                    fallback='1 at all times', restart=restart_later))
  end subroutine visit_table
end module dosui_condition_keys

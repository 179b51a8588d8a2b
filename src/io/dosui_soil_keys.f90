!! Keys of soils: what every one has, and those that a constitutive model brings.
module dosui_soil_keys
  use dosui_key_visitor, only: key, key_t, key_visitor_t
  use dosui_materials, only: model_index, model_names, soil_catalogue_t
  use dosui_scene, only: material_t, conductivity_range, density_range, porosity_range
  implicit none
  private

  public :: visit_material

contains

  subroutine visit_material(v, material, catalogue, is_dry)
    !! Keys of &material.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    type(soil_catalogue_t), intent(inout) :: catalogue
    logical, intent(in) :: is_dry

    call v%name(material%name, key('name', 'what regions call it', required=.true.))
    call v%name(material%model, &
                key('model', 'constitutive model', choices=all_models()))
    call v%logical(material%rigid, &
                   key('rigid', 'the skeleton does not move: pure seepage'))
    call visit_soil(v, material, catalogue)
    call v%property(material%solid_density, &
                    key('solid_density', 'density of the grains', unit='kg/m3', &
                        range=density_range))
    call v%property(material%porosity, &
                    key('porosity', 'initial volume of voids per volume', unit='-', &
                        range=porosity_range))
    call v%property(material%hydraulic_conductivity, &
                    key('hydraulic_conductivity', 'Darcy''s k; 0: undrained', unit='m/s', &
                        range=conductivity_range, only='water = ''coupled'' in &scene', &
                        applies=.not. is_dry))
    call v%name(material%conductivity_law, &
                key('conductivity_law', 'constant, or following the porosity n of bodies that '// &
                    'deform much: n^3/(1 - n)^2 over its first value', &
                    choices='constant kozeny_carman', only='water = ''coupled'' in &scene', &
                    applies=.not. is_dry))
    call visit_retention(v, material, is_dry)
  end subroutine visit_material

  pure function all_models() result(choices)
    !! Names of the constitutive models with blanks between them.
    character(len=:), allocatable :: choices
    integer :: m

    choices = trim(model_names(1))
    do m = 2, size(model_names)
      choices = choices//' '//trim(model_names(m))
    end do
  end function all_models

  subroutine visit_soil(v, material, catalogue)
    !! Keys of &material that the constitutive models bring: those of its own model, and the
    !! others', which mean nothing here.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    type(soil_catalogue_t), intent(inout) :: catalogue
    type(key_t) :: described
    integer :: m, j, chosen

    call material%choose_soil()
    chosen = model_index(material%model)
    do m = 1, size(catalogue%model)
      do j = 1, size(catalogue%key)
        if (catalogue%bringer(j) /= m) cycle
        associate (place => catalogue%key(j)%place, of_others => catalogue%key(j)%described)
          if (is_owned(place)) then
            described = material%soil%key_of(place(chosen))
            described%is_required = described%is_required .and. .not. material%rigid
            described%only = of_others%only
            call v%property(material%soil%constant(place(chosen)), described)
          else
            of_others%is_undecided = chosen == 0
            call v%property(catalogue%model(m)%model%constant(place(m)), of_others)
          end if
        end associate
      end do
      if (m == chosen) then
        call material%soil%visit_options(v, .true.)
      else
        call catalogue%model(m)%model%visit_options(v, .false.)
      end if
    end do

  contains

    pure logical function is_owned(place)
      !! Has the chosen model a key?
      integer, intent(in) :: place(:)   !! of the models

      is_owned = .false.
      if (chosen > 0) is_owned = place(chosen) > 0
    end function is_owned
  end subroutine visit_soil

  subroutine visit_retention(v, material, is_dry)
    !! Keys of &material on partial saturation.
    class(key_visitor_t), intent(inout) :: v
    type(material_t), intent(inout) :: material
    logical, intent(in) :: is_dry
    character(len=*), parameter :: only = 'retention = ''van_genuchten'''
    logical :: applies

    call v%name(material%retention, &
                key('retention', 'none: saturated at any pressure; van_genuchten: suction '// &
                    'empties the pores, Mualem''s relative conductivity', &
                    choices='none van_genuchten', only='water = ''coupled'' in &scene', &
                    applies=.not. is_dry))
    applies = material%retention == 'van_genuchten' .and. .not. is_dry
    call v%real(material%retention_alpha, &
                key('retention_alpha', 'alpha of van Genuchten: 1 over the suction head that '// &
                    'empties the pores', unit='1/m', range='> 0', required=.true., only=only, &
                    applies=applies))
    call v%real(material%retention_exponent, &
                key('retention_exponent', 'n of van Genuchten; m is 1 - 1/n', unit='-', &
                    range='> 1 and <= 20', only=only, applies=applies))
    call v%real(material%residual_saturation, &
                key('residual_saturation', 'S_r: what no suction takes out', unit='-', &
                    range='>= 0 and < 1', only=only, applies=applies))
    call v%real(material%least_conductivity, &
                key('least_conductivity', 'floor of the conductivity over that of the '// &
                    'saturated soil', unit='-', range='>= 0 and <= 1', only=only, applies=applies))
  end subroutine visit_retention
end module dosui_soil_keys

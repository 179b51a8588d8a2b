!! Moduli of single particles: those of their place where constants of soils vary.
module dosui_particle_moduli
  use dosui_kinds, only: wp
  use dosui_model, only: model_t
  implicit none
  private

  public :: find_moduli_of

contains

  pure subroutine find_moduli_of(model, p, bulk, shear)
    !! The largest moduli that the skeleton of a particle can have.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp), intent(out) :: bulk, shear   !! K and G [Pa]

    associate (soil => model%materials%item(model%material(p))%model)
      if (soil%varies()) then
        call soil%moduli(model%particles%field(model%p%state)%values(:, p), bulk, shear)
      else
        bulk = soil%bulk_modulus()
        shear = soil%shear_modulus()
      end if
    end associate
  end subroutine find_moduli_of
end module dosui_particle_moduli

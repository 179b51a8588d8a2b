!! Keys of constants that several soils have.
module dosui_shared_keys
  use dosui_key_visitor, only: key, key_t
  implicit none
  private

  public :: shared_key

contains

  pure function shared_key(name) result(described)
    !! What is known about such a key.
    character(len=*), intent(in) :: name
    type(key_t) :: described

    select case (name)
    case ('poisson_ratio')
      described = key(name, 'drained Poisson''s ratio', unit='-', range='> -1 and < 0.5')
    case ('cohesion')
      described = key(name, 'c; with friction_angle = 0 the undrained strength', unit='Pa', &
                      range='>= 0')
    case ('friction_angle')
      described = key(name, 'angle of friction', unit='deg', range='>= 0 and < 90')
    case ('dilation_angle')
      described = key(name, 'psi, not above friction_angle', unit='deg', range='>= 0 and < 90')
    case ('tensile_strength')
      described = key(name, 'largest principal (mohr_coulomb) or mean (drucker_prager) tension', &
                      unit='Pa', range='>= 0', fallback='unlimited')
    case ('critical_state_ratio')
      described = key(name, 'M: q/p in the critical state, of sand in triaxial compression; '// &
                      'cam_clay needs it', unit='-', range='>= 0.1 and <= 3')
    case default
      described = key('reference_pressure', 'largest mean effective stress that steps and '// &
                      'penalties are estimated for', unit='Pa', range='> 0')
    end select
  end function shared_key
end module dosui_shared_keys

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
    case ('critical_state_ratio')
      described = key(name, 'M: q/p in the critical state, of sand in triaxial compression; '// &
                      'cam_clay needs it', unit='-', range='>= 0.1 and <= 3')
    case default
      described = key('reference_pressure', 'largest mean effective stress that steps and '// &
                      'penalties are estimated for', unit='Pa', range='> 0')
    end select
  end function shared_key
end module dosui_shared_keys

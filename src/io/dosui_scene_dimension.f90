!! The dimension of a scene, for the reader and for the launcher, which has to know it first.
module dosui_scene_dimension
  use dosui_namelist, only: namelist_t
  implicit none
  private

  public :: scene_dimension

contains

  pure integer function scene_dimension(namelist, default) result(n)
    !! What the key `dimension` of the first &scene says: 1, 2, 3, or the default where it says
    !! nothing or nonsense (which the reader then reports).
    type(namelist_t), intent(in) :: namelist
    integer, intent(in) :: default
    character(len=:), allocatable :: reason
    integer :: g, k, given

    n = default
    g = namelist%find('scene', 1)
    if (g == 0) return
    k = namelist%group(g)%find('dimension')
    if (k == 0) return
    associate (key => namelist%group(g)%key(k))
      if (key%n_value /= 1) return
      given = 0
      call key%value(1)%to_integer(given, reason)
      if (given >= 1 .and. given <= 3) n = given
    end associate
  end function scene_dimension
end module dosui_scene_dimension

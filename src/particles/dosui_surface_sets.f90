!! Sets of surfaces that a surface point belongs to, as bits of reals: they migrate, come back from
!! checkpoints and reach ghosts like any field, and hold up to 52 surfaces in the first number.
!!
!! Surfaces may overlap. A condition acts on all points of its surface, whatever else names them;
!! a probe looks at all points of its surface and takes none away.
module dosui_surface_sets
  use dosui_kinds, only: wp, i8
  use dosui_scene, only: scene_t
  implicit none
  private

  public :: set_width, set_add, set_remove, set_holds, set_is_empty, set_members, &
            first_member, sets_meet, &
            wall_set, index_of, surface_ranks

  integer, parameter :: bits = 52   !! that a double holds exactly, the sign apart

  integer, parameter, public :: rank_probe = 0, rank_unused = 1, rank_mechanical = 2, &
                                rank_hydraulic = 3   !! what a surface is used for, at most

contains

  pure integer function set_width(n_surface) result(width)
    !! Numbers that hold a set.
    integer, intent(in) :: n_surface   !! of the scene

    width = max(1, (n_surface + bits - 1)/bits)
  end function set_width

  pure subroutine set_add(set, surface)
    !! Puts a surface into a set.
    real(wp), intent(inout) :: set(:)   !! bits as numbers [-]
    integer, intent(in) :: surface   !! index, from 1

    if (surface < 1) return
    if (.not. set_holds(set, surface)) set(word(surface)) = set(word(surface)) + value_of(surface)
  end subroutine set_add

  pure subroutine set_remove(set, surface)
    !! Takes a surface out of a set.
    real(wp), intent(inout) :: set(:)   !! bits as numbers [-]
    integer, intent(in) :: surface

    if (set_holds(set, surface)) set(word(surface)) = set(word(surface)) - value_of(surface)
  end subroutine set_remove

  pure logical function set_holds(set, surface) result(holds)
    !! Is a surface in a set? Points of barriers (a negative number) are on none.
    real(wp), intent(in) :: set(:)   !! bits as numbers [-]
    integer, intent(in) :: surface

    holds = .false.
    if (surface < 1 .or. set(1) < 0.0_wp) return
    holds = btest(int(set(word(surface)), i8), mod(surface - 1, bits))
  end function set_holds

  pure logical function set_is_empty(set) result(empty)
    !! No surface: a point that nothing names, or one of a barrier.
    real(wp), intent(in) :: set(:)   !! bits as numbers [-]

    empty = .not. any(set > 0.0_wp)
  end function set_is_empty

  pure function set_members(set) result(surfaces)
    !! The surfaces of a set, in their order.
    real(wp), intent(in) :: set(:)   !! bits as numbers [-]
    integer, allocatable :: surfaces(:)
    integer :: s

    surfaces = pack([(s, s=1, bits*size(set))], [(set_holds(set, s), s=1, bits*size(set))])
  end function set_members

  pure integer function first_member(set) result(surface)
    !! The first surface of a set; 0 for none, or a point of a barrier.
    real(wp), intent(in) :: set(:)   !! bits as numbers [-]
    integer :: w

    surface = 0
    if (set(1) < 0.0_wp) return
    do w = 1, size(set)
      if (.not. set(w) > 0.0_wp) cycle
      surface = (w - 1)*bits + trailz(int(set(w), i8)) + 1
      return
    end do
  end function first_member

  pure integer function word(surface)
    !! Place of a surface's bit.
    integer, intent(in) :: surface

    word = (surface - 1)/bits + 1
  end function word

  pure real(wp) function value_of(surface) result(value)
    !! The surface's bit as a number.
    integer, intent(in) :: surface

    value = real(ishft(1_i8, mod(surface - 1, bits)), wp)
  end function value_of

  pure logical function sets_meet(first, second) result(meet)
    !! Is any surface in both sets? Points of barriers meet nothing.
    real(wp), intent(in) :: first(:), second(:)   !! bits as numbers [-]

    meet = .false.
    if (first(1) < 0.0_wp .or. second(1) < 0.0_wp) return
    meet = any(iand(int(first, i8), int(second, i8)) /= 0_i8)
  end function sets_meet

  pure function wall_set(scene) result(walls)
    !! The surfaces that something of their own holds or moves, bits as numbers [-].
    type(scene_t), intent(in) :: scene
    real(wp) :: walls(set_width(size(scene%surface)))
    integer :: c

    walls = 0.0_wp
    if (.not. allocated(scene%mechanical_condition)) return
    do c = 1, size(scene%mechanical_condition)
      if (scene%mechanical_condition(c)%is_load()) cycle
      call set_add(walls, index_of(scene, scene%mechanical_condition(c)%surface))
    end do
  end function wall_set

  pure integer function index_of(scene, name) result(surface)
    !! Place of a surface in the scene, 0 for none.
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: name

    surface = findloc(scene%surface%name == name, .true., dim=1)
  end function index_of

  pure function surface_ranks(scene) result(rank)
    !! What each surface is used for: water, mechanics, nothing, or probes alone.
    type(scene_t), intent(in) :: scene
    integer :: rank(size(scene%surface))
    integer :: k, s

    rank = rank_unused
    if (allocated(scene%probe)) then
      do k = 1, size(scene%probe)
        s = index_of(scene, scene%probe(k)%surface)
        if (s > 0) rank(s) = rank_probe
      end do
    end if
    if (allocated(scene%mechanical_condition)) then
      do k = 1, size(scene%mechanical_condition)
        s = index_of(scene, scene%mechanical_condition(k)%surface)
        if (s > 0) rank(s) = rank_mechanical
      end do
    end if
    if (.not. allocated(scene%hydraulic_condition)) return
    do k = 1, size(scene%hydraulic_condition)
      s = index_of(scene, scene%hydraulic_condition(k)%surface)
      if (s > 0) rank(s) = rank_hydraulic
    end do
  end function surface_ranks
end module dosui_surface_sets

!! Largest and least values of properties that are formulas of place, for everything that is
!! estimated from a scene before there are particles.
module dosui_property_estimates
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_get_status, ieee_set_halting_mode
  use, intrinsic :: ieee_exceptions, only: ieee_set_status, ieee_status_type
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_key_visitor, only: in_range, key_t
  use dosui_namelist, only: namelist_t
  use dosui_problems, only: problems_t
  use dosui_scalar_function, only: scalar_function_t
  use dosui_scene, only: conductivity_range, density_range, porosity_range, scene_t
  use dosui_shapes, only: region_bounds, shape_contains
  use dosui_text, only: to_text, vector_text
  implicit none
  private

  public :: estimate_properties

  real(wp), parameter :: inset = 1.0e-6_wp
  !! of the lattice from the faces, over the region's size: a modulus may vanish at a surface [-]
  integer, parameter :: samples(3) = [65, 17, 9]   ! along each axis of a region, by dimension

contains

  subroutine estimate_properties(scene, namelist, problems)
    !! Tries the formulas on a lattice in the regions of each material and keeps the largest and
    !! the least value. Values that are none, or out of range, are problems.
    type(scene_t), intent(inout) :: scene
    type(namelist_t), intent(in) :: namelist
    type(problems_t), intent(inout) :: problems
    type(ieee_status_type) :: status
    type(key_t) :: described
    real(wp), allocatable :: place(:, :)
    integer :: m, k

    call ieee_get_status(status)
    call ieee_set_halting_mode(ieee_all, .false.)   ! formulas may give no numbers
    do m = 1, size(scene%material)
      associate (material => scene%material(m))
        if (.not. material%varies()) cycle
        call find_places(scene, m, place)
        call estimate(material%solid_density, 'solid_density', density_range)
        call estimate(material%porosity, 'porosity', porosity_range)
        call estimate(material%hydraulic_conductivity, 'hydraulic_conductivity', &
                      conductivity_range)
        do k = 1, size(material%soil%constant)
          described = material%soil%key_of(k)
          call estimate(material%soil%constant(k), described%name, described%range)
        end do
      end associate
    end do
    call ieee_set_status(status)

  contains

    subroutine estimate(property, key, range)
      !! The limits of one property.
      type(scalar_function_t), intent(inout) :: property
      character(len=*), intent(in) :: key, range
      real(wp) :: value
      integer :: p, g, slot

      if (.not. property%varies()) return
      property%constant = -huge(1.0_wp)
      property%least = huge(1.0_wp)
      do p = 1, size(place, 2)
        value = property%at(place(:, p))
        if (ieee_is_finite(value) .and. in_range(value, range)) then
          property%constant = max(property%constant, value)
          property%least = min(property%least, value)
          cycle
        end if
        g = namelist%find('material', m)
        slot = namelist%group(g)%find(key)
        associate (given => namelist%group(g)%key(slot))
          call problems%add(namelist%file, given%line, 'material', key, given%shown(), &
                            'is '//to_text(value, 6)//' at '//vector_text(place(:, p))// &
                            ' m, must be '//trim(range))
        end associate
        return
      end do
    end subroutine estimate
  end subroutine estimate_properties

  subroutine find_places(scene, m, place)
    !! Points of a lattice in the regions of a material, at least one.
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: m
    real(wp), allocatable, intent(out) :: place(:, :)   !! the local origin added [m]
    real(wp) :: low(ndim), high(ndim), position(ndim)
    integer :: r, i, d, n, rest

    n = count(scene%region%material == scene%material(m)%name)
    allocate (place(ndim, samples(ndim)**ndim*n + 1))
    n = 0
    do r = 1, size(scene%region)
      if (scene%region(r)%material /= scene%material(m)%name) cycle
      call region_bounds(scene%region(r), low, high)
      do i = 0, samples(ndim)**ndim - 1
        rest = i
        do d = 1, ndim
          position(d) = low(d) + (high(d) - low(d))* &
                        (inset + (1.0_wp - 2.0_wp*inset)*real(mod(rest, samples(ndim)), wp)/ &
                         real(samples(ndim) - 1, wp))
          rest = rest/samples(ndim)
        end do
        if (.not. shape_contains(scene%region(r), position, 0.0_wp)) cycle
        n = n + 1
        place(:, n) = position + scene%local_origin
      end do
    end do
    if (n == 0) then   ! a thin or unused one
      n = 1
      place(:, 1) = scene%local_origin
    end if
    place = place(:, :n)
  end subroutine find_places
end module dosui_property_estimates

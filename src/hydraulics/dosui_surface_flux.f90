!! Darcy flux through surface points with a head, from the fit of the particle that lies nearest.
!!
!! The scheme itself needs no flux there: this is what the water balance measures it with. The
!! fit of the particle's row of the head operator is differentiated at the point, one-sided from
!! inside. Where several particles are equally near, each has its share, so that the result does
!! not depend on the ranks.
module dosui_surface_flux
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_head_operator, only: head_operator_t, stencil_t
  use dosui_index_map, only: index_map_t
  use dosui_mls, only: n_basis, quadratic_basis_slope, solve_factored
  implicit none
  private

  real(wp), parameter :: equally_near = 1.0_wp + 1.0e-9_wp   !! distances over the least [-]

  type, public :: surface_flux_t
    integer :: n = 0                           !! pairs of surface point and particle
    integer, allocatable :: point(:)           !! surface point of each pair, ghosts too
    integer, allocatable :: particle(:)        !! owned particle of each pair
    real(wp), allocatable :: share(:)          !! of the pair in its point's flux [-]
    integer, allocatable :: start(:)           !! (n + 1) entries of each pair
    real(wp), allocatable :: coefficient(:)    !! of differences of head [1/s], of fluxes [-]
  contains
    procedure :: build => surface_flux_build
    procedure :: apply => surface_flux_apply
  end type surface_flux_t

contains

  subroutine surface_flux_build(self, comm, operator, position, conductivity, spacing, radius, &
                                point_map, point_position, point_normal)
    !! Finds the particles and their coefficients. Collective.
    class(surface_flux_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(head_operator_t), intent(in) :: operator
    real(wp), intent(in) :: position(:, :), conductivity(:)   !! of particles [m], [m/s]
    real(wp), intent(in) :: spacing, radius                   !! dx [m], R/dx [-]
    type(index_map_t), intent(inout) :: point_map             !! of the surface points
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)   !! with ghosts
    real(wp), allocatable :: least(:), pairs(:)
    integer :: i, k, e

    allocate (least(size(point_position, 2)), source=huge(1.0_wp))
    allocate (pairs(size(point_position, 2)), source=0.0_wp)
    do i = 1, operator%n_row
      do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
        if (.not. operator%boundary_is_head(k)) cycle
        associate (b => operator%boundary_point(k))
          least(b) = min(least(b), norm2(point_position(:, b) - position(:, i)))
        end associate
      end do
    end do
    call point_map%scatter_min(comm, 1, least)
    call point_map%gather(comm, 1, least)
    call find_pairs(self, operator, position, point_position, least)
    do e = 1, self%n
      pairs(self%point(e)) = pairs(self%point(e)) + 1.0_wp
    end do
    call point_map%scatter_add(comm, 1, pairs)
    call point_map%gather(comm, 1, pairs)
    self%share = [(1.0_wp/pairs(self%point(e)), e=1, self%n)]
    do e = 1, self%n
      call differentiate(operator, self%particle(e), self%point(e), position, &
                         conductivity(self%particle(e)), spacing, radius, point_position, &
                         point_normal, self%coefficient(self%start(e):self%start(e + 1) - 1))
    end do
  end subroutine surface_flux_build

  pure subroutine find_pairs(self, operator, position, point_position, least)
    !! Lists this rank's particles that are nearest to a point with a head.
    class(surface_flux_t), intent(inout) :: self
    type(head_operator_t), intent(in) :: operator
    real(wp), intent(in) :: position(:, :), point_position(:, :)   !! [m]
    real(wp), intent(in) :: least(:)                               !! distance of points [m]
    integer :: i, k, n_entry, pass

    do pass = 1, 2   ! count, then list
      if (pass == 2) then
        if (allocated(self%point)) then
          deallocate (self%point, self%particle, self%start, self%coefficient)
        end if
        allocate (self%point(self%n), self%particle(self%n), self%start(self%n + 1))
        allocate (self%coefficient(n_entry))
      end if
      self%n = 0
      n_entry = 0
      do i = 1, operator%n_row
        do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
          if (.not. operator%boundary_is_head(k)) cycle
          associate (b => operator%boundary_point(k))
            if (norm2(point_position(:, b) - position(:, i)) > equally_near*least(b)) cycle
            self%n = self%n + 1
            if (pass == 2) then
              self%point(self%n) = b
              self%particle(self%n) = i
              self%start(self%n) = n_entry + 1
            end if
            n_entry = n_entry + entries_of_row(operator, i)
          end associate
        end do
      end do
    end do
    self%start(self%n + 1) = n_entry + 1
  end subroutine find_pairs

  pure integer function entries_of_row(operator, i) result(n)
    !! Particles and surface points of a row.
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i

    n = operator%row_start(i + 1) - operator%row_start(i) + operator%boundary_start(i + 1) - &
        operator%boundary_start(i)
  end function entries_of_row

  pure subroutine differentiate(operator, i, b, position, conductivity, spacing, radius, &
                                point_position, point_normal, coefficient)
    !! Kernel: outward flux -k dh/dn at a point in terms of the row's heads and fluxes.
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, b                          !! particle, surface point
    real(wp), intent(in) :: position(:, :), conductivity, spacing, radius
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)
    real(wp), intent(out) :: coefficient(:)
    type(stencil_t) :: stencil
    real(wp) :: matrix(n_basis, n_basis), slope(n_basis), derivative
    integer :: k, n_near, n_listed
    logical :: regular

    coefficient = 0.0_wp
    call operator%fit(i, position, spacing, radius, point_position, point_normal, stencil, n_near, &
                      matrix, regular)
    if (.not. regular) return
    n_listed = operator%row_start(i + 1) - operator%row_start(i)
    slope = quadratic_basis_slope((point_position(:, b) - position(:, i))/spacing, &
                                  point_normal(:, b))
    call solve_factored(n_basis, matrix, slope)
    do k = 1, stencil%n
      derivative = stencil%weight(k)*dot_product(stencil%basis(:, k), slope)
      if (k <= n_near) then
        coefficient(k) = -conductivity/spacing*derivative
      else if (operator%boundary_is_head(operator%boundary_start(i) + k - n_near - 1)) then
        coefficient(n_listed + k - n_near) = -conductivity/spacing*derivative
      else
        coefficient(n_listed + k - n_near) = derivative   ! of the flux itself
      end if
    end do
  end subroutine differentiate

  pure subroutine surface_flux_apply(self, operator, head, datum, flux)
    !! Kernel: outward Darcy flux of each pair [m/s].
    class(surface_flux_t), intent(in) :: self
    type(head_operator_t), intent(in) :: operator    !! that it was built with
    real(wp), intent(in) :: head(:)                  !! of owned and ghost particles [m]
    real(wp), intent(in) :: datum(:)                 !! of surface points: head [m] or flux [m/s]
    real(wp), intent(out) :: flux(:)                 !! (n)
    integer :: e, i, k, entry
    real(wp) :: here

    do e = 1, self%n
      i = self%particle(e)
      here = head(i)
      flux(e) = 0.0_wp
      entry = self%start(e)
      do k = operator%row_start(i), operator%row_start(i + 1) - 1
        flux(e) = flux(e) + self%coefficient(entry)*(head(operator%column(k)) - here)
        entry = entry + 1
      end do
      do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
        associate (value => datum(operator%boundary_point(k)))
          if (operator%boundary_is_head(k)) then
            flux(e) = flux(e) + self%coefficient(entry)*(value - here)
          else
            flux(e) = flux(e) + self%coefficient(entry)*value
          end if
        end associate
        entry = entry + 1
      end do
    end do
  end subroutine surface_flux_apply
end module dosui_surface_flux

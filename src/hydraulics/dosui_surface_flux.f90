!! Darcy flux through surface points with a head, and the head at points that may change from a
!! flux to a head, from the fit of the particle that lies nearest.
!!
!! The scheme itself needs neither: this is what the water balance and seepage faces measure with.
!! The fit of the particle's row of the head operator is evaluated at the point, one-sided from
!! inside, and from the particle's own soil. Where several particles are equally near, each has its
!! share, so that the result does not depend on the ranks.
module dosui_surface_flux
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_head_operator, only: head_operator_t, kind_head, stencil_t
  use dosui_index_map, only: index_map_t
  use dosui_mls, only: n_basis, quadratic_basis, quadratic_basis_slope, solve_factored
  implicit none
  private

  real(wp), parameter :: equally_near = 1.0_wp + 1.0e-9_wp   !! distances over the least [-]

  type, public :: surface_flux_t
    integer :: n = 0                           !! pairs of surface point and particle
    integer, allocatable :: point(:)           !! surface point of each pair, ghosts too
    integer, allocatable :: particle(:)        !! owned particle of each pair
    logical, allocatable :: is_head(:)         !! the point has a head: the pair finds its flux
    real(wp), allocatable :: share(:)          !! of the pair in its point's value [-]
    integer, allocatable :: start(:)           !! (n + 1) entries of each pair
    real(wp), allocatable :: coefficient(:)
    !! for a flux: of differences of head [1/s], of fluxes [-]; for a head: [-], [s]
  contains
    procedure :: build => surface_flux_build
    procedure :: apply => surface_flux_apply
  end type surface_flux_t

contains

  subroutine surface_flux_build(self, comm, operator, position, conductivity, soil, spacing, &
                                radius, point_map, point_position, point_normal, point_soil, &
                                point_kind, wanted, point_start, point_neighbour)
    !! Finds the particles and their coefficients. Collective.
    class(surface_flux_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(head_operator_t), intent(in) :: operator
    real(wp), intent(in) :: position(:, :), conductivity(:)   !! of particles [m], [m/s]
    real(wp), intent(in) :: soil(:), point_soil(:)            !! as for the operator's `fit` [m/s]
    real(wp), intent(in) :: spacing, radius                   !! dx [m], R/dx [-]
    type(index_map_t), intent(inout) :: point_map             !! of the surface points
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)   !! with ghosts [m], [-]
    integer, intent(in) :: point_kind(:)                      !! kind_head or kind_flux
    logical, intent(in) :: wanted(:)                          !! points that are asked for
    integer, intent(in) :: point_start(:), point_neighbour(:) !! surface points near each row
    real(wp), allocatable :: least(:), pairs(:)
    integer :: i, k, e

    allocate (least(size(point_position, 2)), source=huge(1.0_wp))
    allocate (pairs(size(point_position, 2)), source=0.0_wp)
    do i = 1, operator%n_row
      do k = point_start(i), point_start(i + 1) - 1
        associate (b => point_neighbour(k))
          if (wanted(b)) least(b) = min(least(b), norm2(point_position(:, b) - position(:, i)))
        end associate
      end do
    end do
    call point_map%scatter_min(comm, 1, least)
    call point_map%gather(comm, 1, least)
    call find_pairs(self, operator, position, point_position, least, wanted, point_start, &
                    point_neighbour)
    self%is_head = point_kind(self%point) == kind_head
    do e = 1, self%n
      pairs(self%point(e)) = pairs(self%point(e)) + 1.0_wp
    end do
    call point_map%sum_copies(comm, 1, pairs)
    self%share = [(1.0_wp/pairs(self%point(e)), e=1, self%n)]
    do e = 1, self%n
      call evaluate(operator, self%particle(e), self%point(e), self%is_head(e), position, &
                    conductivity(self%particle(e)), soil, spacing, radius, point_position, &
                    point_normal, point_soil, self%coefficient(self%start(e):self%start(e + 1) - 1))
    end do
  end subroutine surface_flux_build

  pure subroutine find_pairs(self, operator, position, point_position, least, wanted, &
                             point_start, point_neighbour)
    !! Lists this rank's particles that are nearest to a wanted point.
    class(surface_flux_t), intent(inout) :: self
    type(head_operator_t), intent(in) :: operator
    real(wp), intent(in) :: position(:, :), point_position(:, :)   !! [m]
    real(wp), intent(in) :: least(:)                               !! distance of points [m]
    logical, intent(in) :: wanted(:)
    integer, intent(in) :: point_start(:), point_neighbour(:)      !! surface points near each row
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
        do k = point_start(i), point_start(i + 1) - 1
          associate (b => point_neighbour(k))
            if (.not. wanted(b)) cycle
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

  pure subroutine evaluate(operator, i, b, is_head, position, conductivity, soil, spacing, radius, &
                           point_position, point_normal, point_soil, coefficient)
    !! Kernel: outward flux -k dh/dn at a point, or its head above the particle's, in terms of the
    !! row's heads and fluxes.
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, b                          !! particle, surface point
    logical, intent(in) :: is_head                       !! of the point: its flux is wanted
    real(wp), intent(in) :: position(:, :), conductivity, spacing, radius
    real(wp), intent(in) :: soil(:), point_soil(:)
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)
    real(wp), intent(out) :: coefficient(:)
    type(stencil_t) :: stencil
    real(wp) :: matrix(n_basis, n_basis), form(n_basis), value, scale
    integer :: k, n_near, n_listed
    logical :: regular

    coefficient = 0.0_wp
    call operator%fit(i, position, soil, spacing, radius, point_position, point_normal, &
                      point_soil, stencil, n_near, matrix, regular)
    if (.not. regular) return
    n_listed = operator%row_start(i + 1) - operator%row_start(i)
    form = quadratic_basis((point_position(:, b) - position(:, i))/spacing)
    scale = 1.0_wp
    if (is_head) then
      form = quadratic_basis_slope((point_position(:, b) - position(:, i))/spacing, &
                                   point_normal(:, b))
      scale = -conductivity/spacing
    end if
    call solve_factored(n_basis, matrix, form)
    do k = 1, stencil%n
      value = scale*stencil%weight(k)*dot_product(stencil%basis(:, k), form)
      if (k <= n_near) then
        coefficient(k) = value
      else if (operator%boundary_is_head(operator%boundary_start(i) + k - n_near - 1)) then
        coefficient(n_listed + k - n_near) = value
      else if (conductivity > 0.0_wp) then   ! the datum of the fit is -dx q/k
        coefficient(n_listed + k - n_near) = -value*spacing/conductivity
      end if
    end do
  end subroutine evaluate

  pure subroutine surface_flux_apply(self, operator, head, datum, flux, relative, point_relative)
    !! Kernel: outward Darcy flux of each pair [m/s], or the head at its point [m].
    class(surface_flux_t), intent(in) :: self
    type(head_operator_t), intent(in) :: operator    !! that it was built with
    real(wp), intent(in) :: head(:)                  !! of owned and ghost particles [m]
    real(wp), intent(in) :: datum(:)                 !! of surface points: head [m] or flux [m/s]
    real(wp), intent(out) :: flux(:)                 !! (n) [m/s or m]
    real(wp), intent(in), optional :: relative(:)        !! k_r of particles, with suction [-]
    real(wp), intent(in), optional :: point_relative(:)  !! k_r of surface points, likewise [-]
    integer :: e, i, k, entry
    real(wp) :: here, of_heads, of_fluxes

    do e = 1, self%n
      i = self%particle(e)
      here = head(i)
      of_heads = 0.0_wp
      of_fluxes = 0.0_wp
      entry = self%start(e)
      do k = operator%row_start(i), operator%row_start(i + 1) - 1
        of_heads = of_heads + self%coefficient(entry)*(head(operator%column(k)) - here)
        entry = entry + 1
      end do
      do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
        associate (value => datum(operator%boundary_point(k)))
          if (operator%boundary_is_head(k)) then
            of_heads = of_heads + self%coefficient(entry)*(value - here)
          else
            of_fluxes = of_fluxes + self%coefficient(entry)*value
          end if
        end associate
        entry = entry + 1
      end do
      if (present(relative) .and. present(point_relative)) then
        if (self%is_head(e)) then
          of_heads = of_heads*point_relative(self%point(e))
        else if (relative(i) > 0.0_wp) then
          of_fluxes = of_fluxes/relative(i)
        end if
      end if
      flux(e) = of_heads + of_fluxes
      if (.not. self%is_head(e)) flux(e) = flux(e) + here
    end do
  end subroutine surface_flux_apply
end module dosui_surface_flux

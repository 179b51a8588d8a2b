!! The literal MLS-SPH operator of the published one-set method: the Darcy flux from MLS-corrected
!! SPH gradients of the head [Randles1996], then the SPH divergence of that flux with the same
!! gradients.
!!
!! Kept for comparison (docs/theory/water.md shows its measured limits): the antisymmetric stencil
!! applied twice cannot see a checkerboard, and heads are set on the centres of surface particles.
!! The wall-normal flux of particles next to a no-flow surface is removed.
module dosui_two_pass_operator
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_mls, only: factorise, solve_factored, wendland_weight
  implicit none
  private

  type, public :: two_pass_operator_t
    integer :: n_row = 0
    integer, allocatable :: row_start(:), column(:)
    real(wp), allocatable :: gradient(:, :)       !! (ndim, entries) corrected kernel gradient [1/m]
    real(wp), allocatable :: conductivity(:)      !! k of owned particles [m/s]
    integer, allocatable :: wall_start(:)         !! CSR: normals of walls next to a particle
    real(wp), allocatable :: wall_normal(:, :)    !! [-]
    integer, allocatable :: wall_point(:)         !! surface point, for its flux
    integer, allocatable :: held_by(:)            !! head point that holds a particle's head, or 0
    integer :: n_isolated = 0                     !! rows without a gradient
  contains
    procedure :: build => two_pass_build
    procedure :: flux => two_pass_flux
    procedure :: divergence => two_pass_divergence
  end type two_pass_operator_t

contains

  subroutine two_pass_build(self, n_row, position, conductivity, row_start, neighbour, spacing, &
                            radius, point_position, point_normal, point_patch, point_is_head, &
                            point_start, point_neighbour)
    !! Gradients of all rows, walls and held particles (those within 0.75 spacing of a point).
    class(two_pass_operator_t), intent(inout) :: self
    integer, intent(in) :: n_row
    real(wp), intent(in) :: position(:, :)                     !! of owned and ghost particles [m]
    real(wp), intent(in) :: conductivity(:)                    !! [m/s]
    integer, intent(in) :: row_start(:), neighbour(:)
    real(wp), intent(in) :: spacing, radius                    !! dx [m], R/dx [-]
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)
    !! of surface points [m], outward [-]
    integer, intent(in) :: point_patch(:)
    logical, intent(in) :: point_is_head(:)
    integer, intent(in) :: point_start(:), point_neighbour(:)  !! surface points near each row
    integer :: i, k, b, n_wall
    real(wp) :: distance, nearest

    self%n_row = n_row
    self%row_start = row_start
    self%column = neighbour
    self%conductivity = conductivity(1:n_row)
    if (allocated(self%gradient)) deallocate (self%gradient, self%wall_start, self%wall_normal, &
                                              self%wall_point, self%held_by)
    allocate (self%gradient(ndim, size(neighbour)), self%wall_start(n_row + 1))
    allocate (self%wall_normal(ndim, size(point_neighbour)), self%wall_point(size(point_neighbour)))
    allocate (self%held_by(n_row), source=0)
    self%n_isolated = 0
    n_wall = 0
    do i = 1, n_row
      call gradient_row(i, row_start(i + 1) - row_start(i), &
                        neighbour(row_start(i):row_start(i + 1) - 1), position, spacing, radius, &
                        self%gradient(:, row_start(i):row_start(i + 1) - 1), self%n_isolated)
      self%wall_start(i) = n_wall + 1
      nearest = huge(1.0_wp)
      do k = point_start(i), point_start(i + 1) - 1
        b = point_neighbour(k)
        distance = norm2(point_position(:, b) - position(:, i))
        if (distance > 0.75_wp*spacing) cycle
        if (point_is_head(b)) then
          if (distance < nearest) self%held_by(i) = b
          nearest = min(nearest, distance)
        else if (.not. any(point_patch(self%wall_point(self%wall_start(i):n_wall)) == &
                           point_patch(b))) then
          n_wall = n_wall + 1
          self%wall_normal(:, n_wall) = point_normal(:, b)
          self%wall_point(n_wall) = b
        end if
      end do
    end do
    self%wall_start(n_row + 1) = n_wall + 1
  end subroutine two_pass_build

  pure subroutine gradient_row(i, n, neighbour, position, spacing, radius, gradient, n_isolated)
    !! Kernel: corrected gradients B w (x_j - x_i) with B = (sum w r r^T)^-1; zero where the
    !! neighbours do not span all directions.
    integer, intent(in) :: i, n
    integer, intent(in) :: neighbour(n)
    real(wp), intent(in) :: position(:, :)
    real(wp), intent(in) :: spacing, radius
    real(wp), intent(out) :: gradient(ndim, n)
    integer, intent(inout) :: n_isolated
    real(wp) :: matrix(ndim, ndim), r(ndim), weight
    integer :: k, a
    logical :: regular

    matrix = 0.0_wp
    do k = 1, n
      r = (position(:, neighbour(k)) - position(:, i))/spacing
      weight = wendland_weight(norm2(r)/radius)
      gradient(:, k) = weight*r/spacing
      do a = 1, ndim
        matrix(:, a) = matrix(:, a) + weight*r*r(a)
      end do
    end do
    call factorise(ndim, matrix, regular)
    if (.not. regular) then
      gradient = 0.0_wp
      n_isolated = n_isolated + 1
      return
    end if
    do k = 1, n
      call solve_factored(ndim, matrix, gradient(:, k))
    end do
  end subroutine gradient_row

  pure subroutine two_pass_flux(self, head, datum, flux)
    !! Kernel: Darcy flux w = -k grad h of owned particles; at walls the normal part is replaced by
    !! the prescribed outward flux [m/s].
    class(two_pass_operator_t), intent(in) :: self
    real(wp), intent(in) :: head(:)            !! [m]
    real(wp), intent(in) :: datum(:)           !! of surface points [m/s]
    real(wp), intent(inout) :: flux(:, :)      !! (ndim, >= n_row) [m/s]
    integer :: i, k

    do i = 1, self%n_row
      flux(:, i) = 0.0_wp
      do k = self%row_start(i), self%row_start(i + 1) - 1
        flux(:, i) = flux(:, i) - (head(self%column(k)) - head(i))*self%gradient(:, k)
      end do
      flux(:, i) = self%conductivity(i)*flux(:, i)
      do k = self%wall_start(i), self%wall_start(i + 1) - 1
        flux(:, i) = flux(:, i) + (datum(self%wall_point(k)) - &
                                   dot_product(flux(:, i), self%wall_normal(:, k)))* &
                     self%wall_normal(:, k)
      end do
    end do
  end subroutine two_pass_flux

  pure subroutine two_pass_divergence(self, flux, rate)
    !! Kernel: -div w of owned particles [1/s]; 0 where the head is held.
    class(two_pass_operator_t), intent(in) :: self
    real(wp), intent(in) :: flux(:, :)         !! of owned and ghost particles [m/s]
    real(wp), intent(inout) :: rate(:)   !! (>= n_row) [1/s]
    integer :: i, k

    do i = 1, self%n_row
      rate(i) = 0.0_wp
      if (self%held_by(i) > 0) cycle
      do k = self%row_start(i), self%row_start(i + 1) - 1
        rate(i) = rate(i) - dot_product(flux(:, self%column(k)) - flux(:, i), self%gradient(:, k))
      end do
    end do
  end subroutine two_pass_divergence
end module dosui_two_pass_operator

!! The operator div(k grad h) on particles: compact quadratic MLS with points on the true surface.
!!
!! Row i collects its neighbours' heads, the heads of surface points with a head condition, and the
!! normal derivatives at flux points. Of these the nearest one of each patch stands at the foot of
!! the particle (its orthogonal projection on the patch), the others where they are: without them
!! nothing holds the mixed derivative of a particle in a corner. A patch that turns by more than 30
!! degrees within the neighbourhood (thin walls, small fillets) has one foot for each of its
!! directions. The conductivity k_ij between particles is the harmonic mean and multiplies the
!! entries of the Laplacian. All entries act on differences h_j - h_i, so that a constant head gives
!! exactly zero.
!!
!! A particle that almost lies on a surface with a head has its neighbours on one side only and
!! surface points beside it instead of beyond: through its own head the fit falls off convexly, and
!! the rate gets the wrong sign. The row of a fit f without its own head, lap f + (C/dx^2)(f - h_i),
!! is consistent, too, as f - h_i is of the third order, and its diagonal is -C. The weaker the
!! diagonal of the usual row, the larger is the share of this one: none from C/2 on, all at 0.
!!
!! Where bodies shear or tear, a fit may put large negative entries on neighbours, and heads grow.
!! Such a row leaves out those neighbours, the worst one first, as long as the others determine a
!! fit: rows without negative entries cannot grow, and keep heads between their neighbours' (cf.
!! [Seibold2008]). If none is left the neighbours exchange water in pairs.
module dosui_head_operator
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_mls, only: n_basis, wendland_weight, quadratic_basis, quadratic_basis_slope, &
                       factorise, solve_factored
  implicit none
  private

  integer, parameter, public :: kind_flux = 0    !! surface point with a flux; no-flow is flux 0
  integer, parameter, public :: kind_head = 1    !! surface point with a head
  real(wp), parameter :: foot_reach = 1.1_wp     !! a foot beyond the patch's points by this is none
  real(wp), parameter :: same_side = 0.86602540378443865_wp   !! least cosine of normals: 30 deg [-]
  integer, parameter :: max_rows = 512           !! neighbours and surface rows of one particle
  real(wp), parameter :: almost_on = 0.4_wp      !! distance of a face with heads, in spacings [-]
  real(wp), parameter :: attraction = 4.0_wp*ndim   !! C, the diagonal of such rows [-]
  real(wp), parameter :: most_negative = 0.4_wp  !! sum of negative over that of positive entries
  real(wp), parameter :: hardly_negative = 0.05_wp   !! where a row has to be made anew, likewise
  real(wp), parameter :: equal_entries = 0.999_wp    !! of the most negative one [-]

  type, public :: head_operator_t
    integer :: n_row = 0
    integer, allocatable :: row_start(:)             !! (n_row + 1) CSR over particles
    integer, allocatable :: column(:)
    real(wp), allocatable :: coefficient(:)          !! k_ij L_ij [1/(m s)]
    integer, allocatable :: boundary_start(:)        !! (n_row + 1) CSR over surface points
    integer, allocatable :: boundary_point(:)
    logical, allocatable :: boundary_is_head(:)      !! acts on h_b - h_i, otherwise on the flux
    logical, allocatable :: boundary_is_foot(:)      !! a flux point that stands at the row's foot
    real(wp), allocatable :: boundary_weight(:)      !! [1/(m s)] for heads, [1/m] for fluxes
    integer :: n_linear = 0                          !! rows that fell back to a pairwise form
    integer :: n_isolated = 0                        !! rows without any exchange
  contains
    procedure :: clear => head_operator_clear
    procedure :: build => head_operator_build
    procedure :: apply => head_operator_apply
    procedure :: apply_relative => head_operator_apply_relative
    procedure :: linearise => head_operator_linearise
    procedure :: fit => head_operator_fit
    procedure :: flux => head_operator_flux
    procedure :: largest_row_sum => head_operator_largest_row_sum
  end type head_operator_t

  type, public :: stencil_t
    !! The rows that determine one particle's fit.
    integer :: n = 0
    real(wp) :: r(ndim, max_rows)          !! offsets in spacings [-]
    real(wp) :: weight(max_rows)           !! [-]
    real(wp) :: basis(n_basis, max_rows)   !! monomials or their slopes [-]
    real(wp) :: constant(max_rows)         !! 1, or 0 for slopes [-]
    real(wp) :: to_head                    !! distance to the nearest face with heads [-]
  end type stencil_t

contains

  subroutine head_operator_clear(self)
    !! Gives its memory back, before neighbours are listed for the next build.
    class(head_operator_t), intent(inout) :: self

    if (.not. allocated(self%column)) return
    deallocate (self%row_start, self%column, self%coefficient, self%boundary_start, &
                self%boundary_point, self%boundary_is_head, self%boundary_is_foot, &
                self%boundary_weight)
  end subroutine head_operator_clear

  subroutine head_operator_build(self, n_row, n_local, position, conductivity, row_start, &
                                 neighbour, spacing, radius, n_point, point_position, &
                                point_normal, point_patch, point_kind, point_start, point_neighbour)
    !! Computes all rows. Neighbour lists come with the radius R = radius x spacing; those of
    !! particles become the operator's own.
    class(head_operator_t), intent(inout) :: self
    integer, intent(in) :: n_row, n_local                        !! owned; owned and ghosts
    real(wp), intent(in) :: position(ndim, n_local)              !! [m]
    real(wp), intent(in) :: conductivity(n_local)                !! k [m/s]
    integer, allocatable, intent(inout) :: row_start(:)          !! particles near each row, taken
    integer, allocatable, intent(inout) :: neighbour(:)
    real(wp), intent(in) :: spacing                              !! dx [m]
    real(wp), intent(in) :: radius                               !! R/dx [-]
    integer, intent(in) :: n_point                               !! surface points, ghosts too
    real(wp), intent(in) :: point_position(ndim, n_point)        !! [m]
    real(wp), intent(in) :: point_normal(ndim, n_point)          !! outward [-]
    integer, intent(in) :: point_patch(n_point)                  !! planar face of each point
    integer, intent(in) :: point_kind(n_point)                   !! kind_head or kind_flux
    integer, intent(in) :: point_start(:), point_neighbour(:)    !! surface points near each row
    type(stencil_t) :: stencil
    integer :: point(max_rows), i, n_entry, first, n_near, row_kind
    logical :: is_foot(max_rows)
    real(wp) :: laplacian(max_rows), factor
    integer :: k, j

    call self%clear()
    self%n_row = n_row
    call move_alloc(row_start, self%row_start)
    call move_alloc(neighbour, self%column)
    allocate (self%coefficient(size(self%column)), self%boundary_start(n_row + 1))
    allocate (self%boundary_point(size(point_neighbour)), &   ! at most one entry per listed point
              self%boundary_is_head(size(point_neighbour)), &
              self%boundary_is_foot(size(point_neighbour)), &
              self%boundary_weight(size(point_neighbour)))
    self%n_linear = 0
    self%n_isolated = 0
    n_entry = 0
    do i = 1, n_row
      self%boundary_start(i) = n_entry + 1
      first = self%row_start(i)
      n_near = min(self%row_start(i + 1) - first, max_rows/2)
      call particle_rows(position(:, i), n_near, self%column(first:first + n_near - 1), position, &
                         spacing, radius, stencil)
      call surface_rows(position(:, i), point_neighbour(point_start(i):point_start(i + 1) - 1), &
                        point_position, point_normal, point_patch, point_kind, spacing, radius, &
                        stencil, point, is_foot)
      call laplacian_row(stencil, row_kind, laplacian)
      if (row_kind == 1) self%n_linear = self%n_linear + 1
      if (row_kind == 2) self%n_isolated = self%n_isolated + 1
      do k = 1, n_near
        j = self%column(first + k - 1)
        self%coefficient(first + k - 1) = harmonic_mean(conductivity(i), conductivity(j))* &
                                          laplacian(k)/spacing**2
      end do
      self%coefficient(first + n_near:self%row_start(i + 1) - 1) = 0.0_wp
      do k = n_near + 1, stencil%n
        n_entry = n_entry + 1
        j = point(k - n_near)
        self%boundary_point(n_entry) = j
        self%boundary_is_head(n_entry) = point_kind(j) == kind_head
        self%boundary_is_foot(n_entry) = is_foot(k - n_near)
        ! a flux q sets dx dh/dn = -dx q/k, a head acts like a neighbour
        factor = merge(conductivity(i)/spacing**2, -1.0_wp/spacing, point_kind(j) == kind_head)
        self%boundary_weight(n_entry) = factor*laplacian(k)
      end do
    end do
    self%boundary_start(n_row + 1) = n_entry + 1
  end subroutine head_operator_build

  pure real(wp) function harmonic_mean(a, b) result(mean)
    !! Harmonic mean of two conductivities [m/s]; 0 when either is 0.
    real(wp), intent(in) :: a, b

    mean = 0.0_wp
    if (a > 0.0_wp .and. b > 0.0_wp) mean = 2.0_wp*a*b/(a + b)
  end function harmonic_mean

  pure subroutine particle_rows(x, n, neighbour, position, spacing, radius, stencil)
    !! Kernel: the rows of the neighbouring particles.
    real(wp), intent(in) :: x(ndim)
    integer, intent(in) :: n
    integer, intent(in) :: neighbour(n)
    real(wp), intent(in) :: position(:, :)
    real(wp), intent(in) :: spacing, radius
    type(stencil_t), intent(inout) :: stencil
    integer :: k

    do k = 1, n
      call set_row(stencil, k, (position(:, neighbour(k)) - x)/spacing, radius)
    end do
    stencil%to_head = huge(1.0_wp)
    stencil%n = n
  end subroutine particle_rows

  pure subroutine surface_rows(x, near, position, normal, patch, kind, spacing, radius, stencil, &
                               point, is_foot)
    !! Kernel: the rows of head points and flux points.
    real(wp), intent(in) :: x(ndim)
    integer, intent(in) :: near(:)                          !! surface points within the radius
    real(wp), intent(in) :: position(:, :), normal(:, :)
    integer, intent(in) :: patch(:), kind(:)
    real(wp), intent(in) :: spacing, radius
    type(stencil_t), intent(inout) :: stencil
    integer, intent(inout) :: point(:)                      !! surface point of each added row
    logical, intent(inout) :: is_foot(:)                    !! does it stand at the particle's foot?
    real(wp) :: r(ndim), foot(ndim)
    integer :: k, n_before, added
    logical :: has_foot

    n_before = stencil%n
    do k = 1, size(near)
      if (stencil%n == max_rows) exit
      r = (position(:, near(k)) - x)/spacing
      foot = dot_product(r, normal(:, near(k)))*normal(:, near(k))
      has_foot = norm2(r - foot) <= foot_reach
      stencil%n = stencil%n + 1
      added = stencil%n - n_before
      point(added) = near(k)
      is_foot(added) = .false.
      if (kind(near(k)) == kind_head) then
        if (has_foot) stencil%to_head = min(stencil%to_head, norm2(foot))
        call set_row(stencil, stencil%n, r, radius)
      else
        if (has_foot) is_foot(added) = nearest_of_patch(k)
        if (is_foot(added)) r = foot
        call set_row(stencil, stencil%n, r, radius, normal(:, near(k)))
      end if
    end do

  contains

    pure logical function nearest_of_patch(candidate) result(nearest)
      !! Is this the nearest point of its patch that faces its way (the first one of equals)?
      integer, intent(in) :: candidate
      real(wp) :: distance, rival
      integer :: other

      nearest = .true.
      distance = sum((position(:, near(candidate)) - x)**2)
      do other = 1, size(near)
        if (patch(near(other)) /= patch(near(candidate)) .or. other == candidate) cycle
        if (dot_product(normal(:, near(other)), normal(:, near(candidate))) < same_side) cycle
        rival = sum((position(:, near(other)) - x)**2)
        if (rival < distance*(1.0_wp - 1.0e-9_wp)) nearest = .false.
        if (abs(rival - distance) <= 1.0e-9_wp*distance .and. other < candidate) nearest = .false.
      end do
    end function nearest_of_patch
  end subroutine surface_rows

  pure subroutine set_row(stencil, k, r, radius, normal)
    !! Kernel: a row for a head at r, or, with a normal, for the derivative along it.
    type(stencil_t), intent(inout) :: stencil
    integer, intent(in) :: k
    real(wp), intent(in) :: r(ndim)                !! [-]
    real(wp), intent(in) :: radius                 !! R/dx [-]
    real(wp), intent(in), optional :: normal(ndim)

    stencil%r(:, k) = r
    stencil%weight(k) = wendland_weight(norm2(r)/radius)
    if (present(normal)) then
      stencil%basis(:, k) = quadratic_basis_slope(r, normal)
      stencil%constant(k) = 0.0_wp
    else
      stencil%basis(:, k) = quadratic_basis(r)
      stencil%constant(k) = 1.0_wp
    end if
  end subroutine set_row

  pure subroutine laplacian_row(stencil, row_kind, laplacian)
    !! Kernel: entries of the Laplacian in units of 1/dx^2 for all rows of the stencil.
    type(stencil_t), intent(in) :: stencil
    integer, intent(out) :: row_kind               !! 0 quadratic, 1 pairwise, 2 isolated
    real(wp), intent(inout) :: laplacian(:)
    real(wp) :: diagonal, share   ! its share of an attracted row
    logical :: regular

    row_kind = 0
    call quadratic_row(stencil, stencil%weight(:stencil%n), laplacian, regular)
    if (regular) then
      if (stencil%to_head < almost_on) then
        diagonal = sum(stencil%constant(:stencil%n)*laplacian(:stencil%n))
        share = min(1.0_wp - 2.0_wp*diagonal/attraction, 1.0_wp)
        if (share > 0.0_wp) call mix_attracted_row(stencil, share, laplacian)
      end if
      if (negative_share(stencil, laplacian) > most_negative) then
        call drop_negative_entries(stencil, laplacian, regular)
      end if
    end if
    if (.not. regular) call pairwise_row(stencil, row_kind, laplacian)
  end subroutine laplacian_row

  pure subroutine quadratic_row(stencil, weight, laplacian, regular)
    !! Kernel: the fit's Laplacian with given weights of the rows.
    type(stencil_t), intent(in) :: stencil
    real(wp), intent(in) :: weight(:)              !! (stencil%n) [-]
    real(wp), intent(inout) :: laplacian(:)        !! left as it is if there is no fit
    logical, intent(out) :: regular
    real(wp) :: matrix(n_basis, n_basis), right(n_basis)
    integer :: k

    call normal_matrix(stencil, weight, matrix)
    call factorise(n_basis, matrix, regular)
    if (.not. regular) return
    right = 0.0_wp
    right(ndim + 1:2*ndim) = 1.0_wp
    call solve_factored(n_basis, matrix, right)
    do k = 1, stencil%n
      laplacian(k) = weight(k)*dot_product(stencil%basis(:, k), right)
    end do
  end subroutine quadratic_row

  pure real(wp) function negative_share(stencil, laplacian) result(share)
    !! Sum of the negative entries that act on heads over that of the positive ones [-].
    type(stencil_t), intent(in) :: stencil
    real(wp), intent(in) :: laplacian(:)
    real(wp) :: negative, positive, entry
    integer :: k

    negative = 0.0_wp
    positive = 0.0_wp
    do k = 1, stencil%n
      entry = stencil%constant(k)*laplacian(k)   ! 0 for slopes
      negative = negative + max(-entry, 0.0_wp)
      positive = positive + max(entry, 0.0_wp)
    end do
    share = huge(1.0_wp)
    if (positive > 0.0_wp) share = negative/positive
  end function negative_share

  pure subroutine drop_negative_entries(stencil, laplacian, regular)
    !! Kernel: leaves out one row after the other until hardly a negative entry is left. Equal ones
    !! go together, so that round-off does not choose.
    type(stencil_t), intent(in) :: stencil
    real(wp), intent(inout) :: laplacian(:)
    logical, intent(out) :: regular                !! such a row exists
    real(wp) :: weight(stencil%n), entry(stencil%n)
    integer :: number

    weight = stencil%weight(:stencil%n)
    do number = 1, stencil%n
      entry = stencil%constant(:stencil%n)*laplacian(:stencil%n)
      where (entry <= equal_entries*minval(entry)) weight = 0.0_wp
      call quadratic_row(stencil, weight, laplacian, regular)
      if (.not. regular) return
      if (.not. negative_share(stencil, laplacian) > hardly_negative) return
    end do
    regular = .false.
  end subroutine drop_negative_entries

  pure subroutine mix_attracted_row(stencil, share, laplacian)
    !! Kernel: mixes in the row of a particle that almost lies on a face with heads (see module).
    type(stencil_t), intent(in) :: stencil
    real(wp), intent(in) :: share                  !! of it [-]
    real(wp), intent(inout) :: laplacian(:)        !! left as it is if there is no such fit
    real(wp) :: matrix(n_basis + 1, n_basis + 1), right(n_basis + 1), row(n_basis + 1)
    integer :: k, a
    logical :: regular

    matrix = 0.0_wp
    do k = 1, stencil%n
      row = [stencil%basis(:, k), stencil%constant(k)]
      do a = 1, n_basis + 1
        matrix(a:, a) = matrix(a:, a) + stencil%weight(k)*row(a)*row(a:)
      end do
    end do
    call factorise(n_basis + 1, matrix, regular)
    if (.not. regular) return
    right = 0.0_wp
    right(ndim + 1:2*ndim) = 1.0_wp
    right(n_basis + 1) = attraction
    call solve_factored(n_basis + 1, matrix, right)
    do k = 1, stencil%n
      laplacian(k) = (1.0_wp - share)*laplacian(k) + share*stencil%weight(k)* &
                     dot_product([stencil%basis(:, k), stencil%constant(k)], right)
    end do
  end subroutine mix_attracted_row

  pure subroutine normal_matrix(stencil, weight, matrix)
    !! Kernel: lower triangle of sum w P P^T over all rows.
    type(stencil_t), intent(in) :: stencil
    real(wp), intent(in) :: weight(:)              !! (stencil%n) [-]
    real(wp), intent(out) :: matrix(n_basis, n_basis)
    integer :: k, a

    matrix = 0.0_wp
    do k = 1, stencil%n
      do a = 1, n_basis
        matrix(a:, a) = matrix(a:, a) + weight(k)*stencil%basis(a, k)*stencil%basis(a:, k)
      end do
    end do
  end subroutine normal_matrix

  pure subroutine pairwise_row(stencil, row_kind, laplacian)
    !! Kernel: too few or collinear rows. Exchange with positive weights that would be exact for
    !! a symmetric neighbourhood, 2 d w_j / sum w r^2; nothing at all without neighbours. Flux
    !! rows are left out, which is no-flow.
    type(stencil_t), intent(in) :: stencil
    integer, intent(out) :: row_kind
    real(wp), intent(inout) :: laplacian(:)
    real(wp) :: second_moment
    integer :: k

    second_moment = 0.0_wp
    do k = 1, stencil%n
      second_moment = second_moment + &
                      stencil%constant(k)*stencil%weight(k)*sum(stencil%r(:, k)**2)
    end do
    laplacian(1:stencil%n) = 0.0_wp
    row_kind = 2
    if (.not. second_moment > 1.0e-6_wp) return
    row_kind = 1
    do k = 1, stencil%n
      laplacian(k) = 2.0_wp*ndim*stencil%constant(k)*stencil%weight(k)/second_moment
    end do
  end subroutine pairwise_row

  pure subroutine head_operator_apply(self, head, datum, rate)
    !! Kernel: div(k grad h) at every owned particle [1/s].
    class(head_operator_t), intent(in) :: self
    real(wp), intent(in), contiguous :: head(:)     !! of owned and ghost particles [m]
    real(wp), intent(in), contiguous :: datum(:)    !! of surface points: head [m] or flux [m/s]
    real(wp), intent(inout), contiguous :: rate(:)  !! (n_row) [1/s]
    real(wp) :: total, here
    integer :: i, k

    do i = 1, self%n_row
      here = head(i)
      total = 0.0_wp
      do k = self%row_start(i), self%row_start(i + 1) - 1
        total = total + self%coefficient(k)*(head(self%column(k)) - here)
      end do
      do k = self%boundary_start(i), self%boundary_start(i + 1) - 1
        if (self%boundary_is_head(k)) then
          total = total + self%boundary_weight(k)*(datum(self%boundary_point(k)) - here)
        else
          total = total + self%boundary_weight(k)*datum(self%boundary_point(k))
        end if
      end do
      rate(i) = total
    end do
  end subroutine head_operator_apply

  pure subroutine head_operator_apply_relative(self, head, datum, relative, point_relative, rate)
    !! Kernel: as `apply`, where suction lowers conductivities: neighbours exchange water by the
    !! arithmetic mean of their relative conductivities, which keeps the second order.
    class(head_operator_t), intent(in) :: self
    real(wp), intent(in), contiguous :: head(:)             !! of owned and ghost particles [m]
    real(wp), intent(in), contiguous :: datum(:)            !! of surface points [m] or [m/s]
    real(wp), intent(in), contiguous :: relative(:)         !! k_r of particles [-]
    real(wp), intent(in), contiguous :: point_relative(:)   !! k_r of surface points [-]
    real(wp), intent(inout), contiguous :: rate(:)          !! (n_row) [1/s]
    real(wp) :: total, here
    integer :: i, j, k

    do i = 1, self%n_row
      here = head(i)
      total = 0.0_wp
      do k = self%row_start(i), self%row_start(i + 1) - 1
        j = self%column(k)
        total = total + self%coefficient(k)*0.5_wp*(relative(i) + relative(j))*(head(j) - here)
      end do
      do k = self%boundary_start(i), self%boundary_start(i + 1) - 1
        j = self%boundary_point(k)
        if (self%boundary_is_head(k)) then
          total = total + self%boundary_weight(k)*0.5_wp*(relative(i) + point_relative(j))* &
                  (datum(j) - here)
        else
          total = total + self%boundary_weight(k)*datum(j)
        end if
      end do
      rate(i) = total
    end do
  end subroutine head_operator_apply_relative

  pure subroutine head_operator_linearise(self, head, datum, relative, slope, point_relative, &
                                          unit_weight, entry, diagonal)
    !! Kernel: derivative of `apply_relative` with respect to the particles' pressures.
    class(head_operator_t), intent(in) :: self
    real(wp), intent(in), contiguous :: head(:), datum(:)
    !! as for `apply_relative` [m], [m or m/s]
    real(wp), intent(in), contiguous :: relative(:), point_relative(:)   !! likewise [-]
    real(wp), intent(in), contiguous :: slope(:)     !! dk_r/du of particles [1/Pa]
    real(wp), intent(in) :: unit_weight              !! gamma_w [N/m3]
    real(wp), intent(out), contiguous :: entry(:)    !! like `coefficient` [1/(Pa s)]
    real(wp), intent(out), contiguous :: diagonal(:) !! (n_row) [1/(Pa s)]
    real(wp) :: mean
    integer :: i, j, k

    do i = 1, self%n_row
      diagonal(i) = 0.0_wp
      do k = self%row_start(i), self%row_start(i + 1) - 1
        j = self%column(k)
        mean = 0.5_wp*(relative(i) + relative(j))/unit_weight
        entry(k) = self%coefficient(k)*(mean + 0.5_wp*slope(j)*(head(j) - head(i)))
        diagonal(i) = diagonal(i) + self%coefficient(k)* &
                      (0.5_wp*slope(i)*(head(j) - head(i)) - mean)
      end do
      do k = self%boundary_start(i), self%boundary_start(i + 1) - 1
        if (.not. self%boundary_is_head(k)) cycle
        j = self%boundary_point(k)
        mean = 0.5_wp*(relative(i) + point_relative(j))/unit_weight
        diagonal(i) = diagonal(i) + self%boundary_weight(k)* &
                      (0.5_wp*slope(i)*(datum(j) - head(i)) - mean)
      end do
    end do
  end subroutine head_operator_linearise

  pure subroutine head_operator_fit(self, i, position, soil, spacing, radius, point_position, &
                                    point_normal, point_soil, stencil, n_near, matrix, regular)
    !! Kernel: the fit that made a row, again: its rows and its factorised normal matrix. Heads have
    !! a kink where soils of other conductivity begin, and slopes are wanted on this side of it:
    !! what lies in such soils is left out if the others determine a fit.
    class(head_operator_t), intent(in) :: self
    integer, intent(in) :: i                                  !! particle
    real(wp), intent(in) :: position(:, :)                    !! of particles [m]
    real(wp), intent(in) :: soil(:), point_soil(:)
    !! conductivities of the soils that particles and surface points are of [m/s]
    real(wp), intent(in) :: spacing, radius                   !! dx [m], R/dx [-]
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)   !! of surface points [m], [-]
    type(stencil_t), intent(inout) :: stencil
    integer, intent(out) :: n_near        !! the first rows are particles, the others surface points
    real(wp), intent(out) :: matrix(n_basis, n_basis)
    !! its Cholesky factor, of weighted monomials [-]
    logical, intent(out) :: regular
    real(wp) :: r(ndim), weight(max_rows)   ! of what lies in the particle's own soil
    integer :: k, first, b

    first = self%row_start(i)
    n_near = min(self%row_start(i + 1) - first, max_rows/2)
    call particle_rows(position(:, i), n_near, self%column(first:first + n_near - 1), position, &
                       spacing, radius, stencil)
    do k = self%boundary_start(i), self%boundary_start(i + 1) - 1
      b = self%boundary_point(k)
      stencil%n = stencil%n + 1
      r = (point_position(:, b) - position(:, i))/spacing
      if (self%boundary_is_foot(k)) r = dot_product(r, point_normal(:, b))*point_normal(:, b)
      if (self%boundary_is_head(k)) then
        call set_row(stencil, stencil%n, r, radius)
      else
        call set_row(stencil, stencil%n, r, radius, point_normal(:, b))
      end if
    end do
    weight(:stencil%n) = stencil%weight(:stencil%n)
    do k = 1, stencil%n
      if (k <= n_near) then
        if (is_other(soil(self%column(first + k - 1)), soil(i))) weight(k) = 0.0_wp
      else
        b = self%boundary_point(self%boundary_start(i) + k - n_near - 1)
        if (is_other(point_soil(b), soil(i))) weight(k) = 0.0_wp
      end if
    end do
    call normal_matrix(stencil, weight(:stencil%n), matrix)
    call factorise(n_basis, matrix, regular)
    if (regular) then
      stencil%weight(:stencil%n) = weight(:stencil%n)
    else
      call normal_matrix(stencil, stencil%weight(:stencil%n), matrix)
      call factorise(n_basis, matrix, regular)
    end if
  end subroutine head_operator_fit

  pure elemental logical function is_other(a, b)
    !! Are these conductivities of different soils?
    real(wp), intent(in) :: a, b   !! [m/s]

    is_other = abs(a - b) > 0.0_wp
  end function is_other

  pure subroutine head_operator_flux(self, position, conductivity, soil, spacing, radius, &
                                     point_position, point_normal, point_soil, head, datum, flux)
    !! Kernel: Darcy flux w = -k grad h of owned particles, from the first derivatives of the same
    !! fits; 0 where a row has no fit. For output, so the fits are made again instead of stored.
    class(head_operator_t), intent(in) :: self
    real(wp), intent(in) :: position(:, :), conductivity(:)   !! of particles [m], [m/s]
    real(wp), intent(in) :: soil(:), point_soil(:)            !! as for `fit` [m/s]
    real(wp), intent(in) :: spacing, radius                   !! dx [m], R/dx [-]
    real(wp), intent(in) :: point_position(:, :), point_normal(:, :)   !! of surface points [m], [-]
    real(wp), intent(in) :: head(:), datum(:)                 !! as for `apply` [m], [m or m/s]
    real(wp), intent(inout) :: flux(:, :)                     !! (ndim, n_row) [m/s]
    type(stencil_t) :: stencil
    real(wp) :: matrix(n_basis, n_basis), right(n_basis), value
    integer :: i, k, first, n_near, b
    logical :: regular

    do i = 1, self%n_row
      flux(:, i) = 0.0_wp
      call self%fit(i, position, soil, spacing, radius, point_position, point_normal, point_soil, &
                    stencil, n_near, matrix, regular)
      if (.not. regular) cycle
      first = self%row_start(i)
      right = 0.0_wp
      do k = 1, stencil%n
        if (k <= n_near) then
          value = head(self%column(first + k - 1)) - head(i)
        else
          b = self%boundary_start(i) + k - n_near - 1
          if (self%boundary_is_head(b)) then
            value = datum(self%boundary_point(b)) - head(i)
          else
            value = 0.0_wp
            if (conductivity(i) > 0.0_wp) then
              value = -spacing*datum(self%boundary_point(b))/conductivity(i)
            end if
          end if
        end if
        right = right + stencil%weight(k)*stencil%basis(:, k)*value
      end do
      call solve_factored(n_basis, matrix, right)
      flux(:, i) = -conductivity(i)*right(1:ndim)/spacing
    end do
  end subroutine head_operator_flux

  pure real(wp) function head_operator_largest_row_sum(self) result(largest)
    !! Largest sum of |entries| of a row with its diagonal: a Gershgorin bound of the spectral
    !! radius [1/(m s)].
    class(head_operator_t), intent(in) :: self
    real(wp) :: diagonal, off_diagonal
    integer :: i, k

    largest = 0.0_wp
    do i = 1, self%n_row
      diagonal = 0.0_wp
      off_diagonal = 0.0_wp
      do k = self%row_start(i), self%row_start(i + 1) - 1
        diagonal = diagonal + self%coefficient(k)
        off_diagonal = off_diagonal + abs(self%coefficient(k))
      end do
      do k = self%boundary_start(i), self%boundary_start(i + 1) - 1
        if (self%boundary_is_head(k)) diagonal = diagonal + self%boundary_weight(k)
      end do
      largest = max(largest, abs(diagonal) + off_diagonal)
    end do
  end function head_operator_largest_row_sum
end module dosui_head_operator

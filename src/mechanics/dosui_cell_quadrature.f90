!! Cell-wise integration of stresses: means through one gradient per cell, deviations at particles.
!!
!! Particles off a lattice are poor quadrature points: sums of V grad N over them do not balance a
!! uniform stress, the body seems 0.4 to 1.2 % too soft, and almost incompressible water amplifies
!! what is left. So the mean strain of a cell comes from the gradient at its centre, which is exact
!! for a full cell, and particles add their deviation from their own mean:
!!
!!     strain_p = C_c v + dev(L_p v - mean of L v)
!!     f = - W C^T mean(sigma) - V L^T dev(sigma - mean)
!!
!! the second line being the adjoint of the first (cf. the mean-strain hexahedron of
!! [Flanagan1981], whose hourglass modes the particles' deviations control here). W is the volume
!! of the filled part of the cell, C the hats' gradient at its centroid. In small-strain scenes
!! both come from the shapes of the regions. A part without particle joins the nearest cell that
!! has one, and the mean strain of such a union is that of its parts, weighted with their volumes,
!! each with the hats of its own corners: fields stay continuous, and a uniform stress balances
!! tractions that are integrated in the same way (`dosui_piece_cuts`).
!!
!! Parts of less than half a cell share the water's volume change, its pressure and the lifts of
!! walls with the nearest one of more than that: as parts by themselves they see too little of the
!! nodes to have a pressure, and a wall's lift in them is stiffer than steps can bear. These are
!! groups, named by their first cell. In updated scenes full cells are full, cut ones take what
!! their particles hold, and there are no groups.
module dosui_cell_quadrature
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_communicator, only: communicator_t
  use dosui_cell_average, only: cell_sums
  use dosui_cell_filling, only: cell_filling, filling_t
  use dosui_grid, only: grid_t
  use dosui_keys, only: pack_key
  use dosui_region_bins, only: region_bins_t
  use dosui_scene, only: region_t
  use dosui_shape_functions, only: corner_hats
  use dosui_sort, only: binary_search
  implicit none
  private

  public :: hat_gradients

  real(wp), parameter :: group_part = 0.4997_wp   !! of a cell whose pressure is its own [-]
  real(wp), parameter :: empty_part = 1.0e-14_wp  !! round-off of fillings [-]
  integer, parameter :: reach = 2                 !! of cells that join others
  real(wp), parameter :: steps_of_filling = 999983.0_wp   !! by which fillings differ [-]
  ! odd numbers, so that round-off does not decide about halves
  real(wp), parameter :: fitted_tolerance = 1.0e-9_wp   !! [-]
  real(wp), parameter :: least_filling = 0.5_wp   !! of a cell that no surface cuts, to be full [-]
  ! A corner with less than this share s of what even filling would give it makes its cell ragged:
  ! a cell's mean strain is stable up to dt = h/c sqrt(s/ndim), and steps take half of h/c. Odd
  ! numbers, so that round-off does not decide about lattices.
  real(wp), parameter :: least_share = merge(0.3943_wp, merge(0.5547_wp, 0.7771_wp, ndim == 2), &
                                             ndim == 1)   !! [-]

  type, public :: shape_piece_t
    !! What one region fills of a cell.
    integer :: region = 0
    type(filling_t) :: filling
  end type shape_piece_t

  type, public :: cell_quadrature_t
    logical :: fitted = .true.                       !! every cell is full or empty
    logical :: exact = .false.                       !! measures come from shapes
    logical :: has_groups = .false.                  !! on any rank
    integer, allocatable :: host(:)       !! (n_cell) cell with particles that a part belongs to
    integer, allocatable :: group(:)      !! (n_cell) first cell of the group that it belongs to
    integer, allocatable :: member_start(:)   !! (n_cell + 1) exact and not fitted: ...
    integer, allocatable :: member(:)         !! ... parts of the group of a first cell
    real(wp), allocatable :: part(:)                 !! (n_cell) volume of the filled part [m3]
    real(wp), allocatable :: share(:)     !! (n_cell) of a part in its host's strain [-]
    real(wp), allocatable :: measure(:)   !! (n_cell) W of hosts, with the parts that joined [m3]
    real(wp), allocatable :: centroid(:, :)
    !! (ndim, n_cell) of parts, exact and not fitted, 0 to 1 in the cell [-]
    integer, allocatable :: piece_start(:)       !! (n_cell + 1) exact and not fitted: ...
    type(shape_piece_t), allocatable :: piece(:)   !! ... regions in a cell, in their order
    logical, allocatable :: is_cut(:)                !! (n_cell)
    logical :: has_ragged = .false.                  !! on this rank
    logical, allocatable :: is_ragged(:)   !! (n_cell) particles stand for it, not its centre
    real(wp), allocatable :: gradient(:, :, :)   !! (ndim, 2**ndim, n_cell) C, unless fitted [1/m]
  contains
    procedure :: init_from_shapes => cell_quadrature_init_from_shapes
    procedure :: init_from_particles => cell_quadrature_init_from_particles
    procedure :: weigh => cell_quadrature_weigh
    procedure :: find_centres => cell_quadrature_find_centres
    procedure :: is_unseen => cell_quadrature_is_unseen
    procedure :: strain_operator => cell_quadrature_strain_operator
    procedure :: slopes => cell_quadrature_slopes
    procedure :: strains => cell_quadrature_strains
    procedure :: forces => cell_quadrature_forces
  end type cell_quadrature_t

contains

  subroutine cell_quadrature_init_from_shapes(self, comm, grid, regions, n, cell)
    !! Measures and gradients of all cells from the shapes of undeformed regions. Collective.
    class(cell_quadrature_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    type(region_t), intent(in) :: regions(:)
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)   !! of the particles
    type(filling_t), allocatable :: own(:)
    real(wp), allocatable :: number(:), share(:)
    real(wp) :: centroid(ndim), covariance(ndim), cell_volume
    integer, allocatable :: offset(:, :)
    integer :: p, c
    logical :: fitted

    cell_volume = grid%spacing**ndim
    allocate (number(grid%n_cell), source=0.0_wp)
    do p = 1, n
      if (cell(p) > 0) number(cell(p)) = number(cell(p)) + 1.0_wp
    end do
    share = number   ! of this rank
    call grid%cell_map%sum_copies(comm, 1, number)
    self%has_ragged = .false.
    if (allocated(self%is_ragged)) deallocate (self%is_ragged)
    allocate (self%is_ragged(grid%n_cell), source=.false.)
    call find_pieces(self, grid, regions, own)
    do c = 1, grid%n_cell
      if (.not. own(c)%volume > empty_part) own(c) = filling_t()
      if (number(c) > 0.5_wp .and. .not. own(c)%volume > 0.0_wp) own(c) = grain()
    end do
    self%exact = .true.
    self%part = own%volume*cell_volume
    offset = near_cells()
    self%host = [(c, c=1, grid%n_cell)]
    do c = 1, grid%n_cell
      if (own(c)%volume > 0.0_wp .and. .not. number(c) > 0.5_wp) then
        self%host(c) = nearest_of(grid, c, offset, number > 0.5_wp, own%volume)
      end if
    end do
    self%measure = 0.0_wp*self%part
    do c = 1, grid%n_cell
      self%measure(self%host(c)) = self%measure(self%host(c)) + self%part(c)
    end do
    ! ranks that hold a host's particles know all of its parts
    where (number > 0.5_wp) self%measure = self%measure*(share/number)
    where (.not. number > 0.5_wp) self%measure = 0.0_wp
    call grid%cell_map%sum_copies(comm, 1, self%measure)
    self%is_cut = self%measure > 0.0_wp .and. &
                  abs(self%measure/cell_volume - 1.0_wp) > fitted_tolerance
    fitted = .not. any(self%is_cut)
    self%fitted = comm%all(fitted)
    self%share = merge(1.0_wp, 0.0_wp, self%measure > 0.0_wp)
    self%group = self%host
    self%has_groups = .false.
    if (allocated(self%gradient)) deallocate (self%gradient)
    if (allocated(self%centroid)) deallocate (self%centroid)
    if (allocated(self%member)) deallocate (self%member, self%member_start)
    if (self%fitted) then
      deallocate (self%piece, self%piece_start)
      return
    end if
    do c = 1, grid%n_cell
      if (.not. self%measure(self%host(c)) > 0.0_wp) cycle
      if (self%host(c) == c .and. self%part(c) >= self%measure(c)) cycle   ! by itself: 1
      self%share(c) = self%part(c)/self%measure(self%host(c))
    end do
    call find_groups(self, comm, grid, offset)
    allocate (self%gradient(ndim, 2**ndim, grid%n_cell), self%centroid(ndim, grid%n_cell), &
              source=0.0_wp)
    do c = 1, grid%n_cell
      if (.not. own(c)%volume > 0.0_wp) cycle
      centroid = min(1.0_wp, max(0.0_wp, own(c)%moment/own(c)%volume))
      covariance = 0.0_wp
      if (ndim == 3) covariance = own(c)%mixed/own(c)%volume - &
                                  cshift(centroid, 1)*cshift(centroid, 2)
      self%centroid(:, c) = centroid
      call hat_gradients(centroid, covariance, grid%spacing, self%gradient(:, :, c))
    end do

  contains

    pure type(filling_t) function grain()
      !! What particles stand for that lie in a cell without body, by round-off.
      grain%volume = empty_part
      grain%moment = 0.5_wp*empty_part
      grain%mixed = 0.25_wp*empty_part
    end function grain
  end subroutine cell_quadrature_init_from_shapes

  subroutine find_pieces(self, grid, regions, whole)
    !! Integrates the regions' shapes over the cells, once for all.
    class(cell_quadrature_t), intent(inout) :: self
    type(grid_t), intent(in) :: grid
    type(region_t), intent(in) :: regions(:)
    type(filling_t), allocatable, intent(out) :: whole(:)   !! (n_cell) of all regions
    type(shape_piece_t), allocatable :: piece(:)
    type(filling_t) :: part
    type(region_bins_t) :: bins
    integer, allocatable :: near(:)
    real(wp) :: corner(ndim)
    integer :: c, n, k

    call bins%init(regions, grid%spacing)   ! what a cell meets lies within reach of its corner
    allocate (whole(grid%n_cell), piece(grid%n_cell + 1))
    if (allocated(self%piece_start)) deallocate (self%piece_start)
    allocate (self%piece_start(grid%n_cell + 1), source=1)
    n = 0
    do c = 1, grid%n_cell
      corner = grid%origin + grid%spacing*grid%cell_base(:, c)
      near = bins%near(corner)
      do while (n + size(near) > size(piece))
        piece = [piece, piece]
      end do
      do k = 1, size(near)
        part = cell_filling(regions(near(k):near(k)), corner, grid%spacing)
        call whole(c)%add(part, spread(0, 1, ndim))
        if (.not. part%volume > 0.0_wp) cycle
        n = n + 1
        piece(n) = shape_piece_t(near(k), part)
      end do
      self%piece_start(c + 1) = n + 1
    end do
    self%piece = piece(1:n)
  end subroutine find_pieces

  subroutine find_groups(self, comm, grid, offset)
    !! Cells that share one volume change of the water, and the parts of their groups. Collective.
    class(cell_quadrature_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: offset(:, :)
    logical, allocatable :: leads(:)
    integer, allocatable :: first(:)
    integer :: c

    leads = self%measure >= group_part*grid%spacing**ndim
    first = [(c, c=1, grid%n_cell)]
    do c = 1, grid%n_cell
      if (self%measure(c) > 0.0_wp .and. .not. leads(c)) then
        first(c) = nearest_of(grid, c, offset, leads, self%measure/grid%spacing**ndim)
      end if
    end do
    self%group = first(self%host)
    self%has_groups = comm%any(any(self%group /= [(c, c=1, grid%n_cell)]))
    allocate (self%member_start(grid%n_cell + 1), source=0)
    do c = 1, grid%n_cell
      if (.not. self%part(c) > 0.0_wp) cycle
      self%member_start(self%group(c) + 1) = self%member_start(self%group(c) + 1) + 1
    end do
    self%member_start(1) = 1
    do c = 1, grid%n_cell
      self%member_start(c + 1) = self%member_start(c + 1) + self%member_start(c)
    end do
    allocate (self%member(self%member_start(grid%n_cell + 1) - 1))
    first = self%member_start(1:grid%n_cell)
    do c = 1, grid%n_cell
      if (.not. self%part(c) > 0.0_wp) cycle
      self%member(first(self%group(c))) = c
      first(self%group(c)) = first(self%group(c)) + 1
    end do
  end subroutine find_groups

  pure function near_cells() result(offset)
    !! Steps to the cells around one, by distance.
    integer :: offset(ndim, (2*reach + 1)**ndim - 1)
    integer :: m, d, n, square, step(ndim)

    n = 0
    do square = 1, ndim*reach**2
      do m = 0, (2*reach + 1)**ndim - 1
        do d = 1, ndim
          step(d) = mod(m/(2*reach + 1)**(d - 1), 2*reach + 1) - reach
        end do
        if (sum(step**2) /= square) cycle
        n = n + 1
        offset(:, n) = step
      end do
    end do
  end function near_cells

  pure integer function nearest_of(grid, cell, offset, is_candidate, filling) result(best)
    !! The nearest candidate around a cell; of several the fullest, then the one with the smallest
    !! key: the same on every rank. The cell itself if there is none.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    integer, intent(in) :: offset(:, :)          !! as from `near_cells`
    logical, intent(in) :: is_candidate(:)       !! (n_cell)
    real(wp), intent(in) :: filling(:)           !! (n_cell) over that of a full cell [-]
    integer :: k, other, fullest, square

    best = cell
    fullest = -1
    square = huge(1)
    do k = 1, size(offset, 2)
      if (sum(offset(:, k)**2) > square) exit
      other = binary_search(grid%cell_key, pack_key(grid%cell_base(:, cell) + offset(:, k)))
      if (other == 0) cycle
      if (.not. is_candidate(other)) cycle
      if (nint(filling(other)*steps_of_filling) > fullest) then
        fullest = nint(filling(other)*steps_of_filling)
        best = other
      else if (nint(filling(other)*steps_of_filling) == fullest) then
        best = min(best, other)   ! cells are sorted by key
      end if
      square = sum(offset(:, k)**2)
    end do
  end function nearest_of

  subroutine cell_quadrature_init_from_particles(self, comm, grid, n, cell, position, n_point, &
                                                 point_cell, cuts, finds_ragged)
    !! Finds the cut and ragged cells and the gradients of all cells. Collective.
    class(cell_quadrature_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)                   !! of the particles
    real(wp), intent(in) :: position(ndim, n)        !! [m]
    integer, intent(in) :: n_point                   !! surface points
    integer, intent(in) :: point_cell(n_point)       !! 0: none
    logical, intent(in) :: cuts(n_point)             !! the surface runs through the cell
    logical, intent(in) :: finds_ragged              !! explicit steps cannot bear light corners
    real(wp), allocatable :: sums(:, :)              ! number of particles, cut, positions
    integer :: p, c

    allocate (sums(2 + ndim, grid%n_cell), source=0.0_wp)
    do p = 1, n
      if (cell(p) == 0) cycle
      sums(1, cell(p)) = sums(1, cell(p)) + 1.0_wp
      sums(3:, cell(p)) = sums(3:, cell(p)) + position(:, p)
    end do
    do p = 1, n_point
      if (cuts(p) .and. point_cell(p) > 0) sums(2, point_cell(p)) = 1.0_wp
    end do
    call grid%cell_map%sum_copies(comm, 2 + ndim, sums)
    self%is_cut = sums(2, :) > 0.5_wp .and. sums(1, :) > 0.5_wp
    if (allocated(self%is_ragged)) deallocate (self%is_ragged)
    allocate (self%is_ragged(grid%n_cell), source=.false.)
    if (finds_ragged) call find_ragged(comm, grid, n, cell, position, sums(1, :), self%is_ragged)
    self%has_ragged = any(self%is_ragged)
    self%exact = .false.
    self%host = [(c, c=1, grid%n_cell)]
    self%group = self%host
    self%has_groups = .false.
    self%share = 1.0_wp + 0.0_wp*sums(1, :)
    self%measure = 0.0_wp*sums(1, :)
    self%fitted = .not. comm%any(any(self%is_cut))
    if (allocated(self%gradient)) deallocate (self%gradient)
    if (self%fitted) return
    allocate (self%gradient(ndim, 2**ndim, grid%n_cell))
    do c = 1, grid%n_cell
      if (self%is_cut(c)) then
        call hat_gradients((sums(3:, c)/sums(1, c) - grid%origin)/grid%spacing - &
                           grid%cell_base(:, c), spread(0.0_wp, 1, ndim), grid%spacing, &
                           self%gradient(:, :, c))
      else
        call hat_gradients(spread(0.5_wp, 1, ndim), spread(0.0_wp, 1, ndim), grid%spacing, &
                           self%gradient(:, :, c))
      end if
    end do
  end subroutine cell_quadrature_init_from_particles

  subroutine find_ragged(comm, grid, n, cell, position, number, is_ragged)
    !! Cells with a corner that particles hardly touch: the force of a whole cell would hurl it
    !! away. Collective.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)                     !! of the particles
    real(wp), intent(in) :: position(ndim, n)          !! [m]
    real(wp), intent(in) :: number(grid%n_cell)        !! of particles
    logical, intent(out) :: is_ragged(grid%n_cell)
    real(wp), allocatable :: filling(:, :)   ! (2, n_node) share of particles, and if they were even
    real(wp) :: local(ndim)
    integer :: p, c, k, node

    allocate (filling(2, grid%n_node), source=0.0_wp)
    do p = 1, n
      if (cell(p) == 0) cycle
      local = (position(:, p) - grid%origin)/grid%spacing - grid%cell_base(:, cell(p))
      associate (node => grid%cell_node(:, cell(p)))
        filling(1, node) = filling(1, node) + corner_hats(local)
      end associate
    end do
    do c = 1, grid%n_cell
      if (.not. grid%cell_map%is_owned(c)) cycle
      do k = 1, 2**ndim
        node = grid%cell_node(k, c)
        filling(2, node) = filling(2, node) + number(c)/2**ndim
      end do
    end do
    call grid%node_map%sum_copies(comm, 2, filling)
    do c = 1, grid%n_cell
      is_ragged(c) = number(c) < 0.5_wp .or. &   ! particles may enter before the next build
                     any(filling(1, grid%cell_node(:, c)) < &
                         least_share*filling(2, grid%cell_node(:, c)))
    end do
  end subroutine find_ragged

  pure subroutine hat_gradients(centroid, covariance, spacing, gradient)
    !! Mean gradients of the corner hats over a part of a cell, x fastest [1/m].
    real(wp), intent(in) :: centroid(ndim)   !! local coordinates, 0 to 1 in the cell [-]
    real(wp), intent(in) :: covariance(ndim)   !! of the other two coordinates, 3-D only [-]
    real(wp), intent(in) :: spacing          !! [m]
    real(wp), intent(out) :: gradient(ndim, 2**ndim)   !! [1/m]
    real(wp) :: factor
    integer :: corner, d, e, f

    do corner = 1, 2**ndim
      do d = 1, ndim
        factor = 1.0_wp
        do e = 1, ndim
          if (e /= d) factor = factor*merge(centroid(e), 1.0_wp - centroid(e), &
                                            btest(corner - 1, e - 1))
        end do
        if (ndim == 3) then   ! the gradient contains the product of the other two
          e = modulo(d, ndim) + 1
          f = modulo(e, ndim) + 1
          factor = factor + covariance(d)*sign_of(corner, e)*sign_of(corner, f)
        end if
        gradient(d, corner) = sign_of(corner, d)*factor/spacing
      end do
    end do
  end subroutine hat_gradients

  pure real(wp) function sign_of(corner, direction)
    !! -1 for the lower, 1 for the upper end of a cell.
    integer, intent(in) :: corner, direction

    sign_of = merge(1.0_wp, -1.0_wp, btest(corner - 1, direction - 1))
  end function sign_of

  subroutine cell_quadrature_weigh(self, comm, grid, n, cell, volume, weight)
    !! Measures of the cells, and weights of the particles: their volumes, scaled so that they fill
    !! their cells. Collective.
    class(cell_quadrature_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: volume(n)       !! [m3]
    real(wp), intent(inout) :: weight(n)    !! [m3]
    real(wp), allocatable :: sums(:), one(:)
    real(wp) :: full
    integer :: p, c

    allocate (sums(grid%n_cell))
    allocate (one(n), source=1.0_wp)
    call cell_sums(n, cell, volume, one, grid%n_cell, sums)
    call grid%cell_map%sum_copies(comm, 1, sums)
    full = grid%spacing**ndim
    do c = 1, grid%n_cell
      if (self%exact) exit
      self%measure(c) = sums(c)
      if (self%is_cut(c) .or. self%is_ragged(c)) cycle
      if (sums(c) > least_filling*full) self%measure(c) = full
    end do
    do p = 1, n
      weight(p) = volume(p)*(self%measure(cell(p))/sums(cell(p)))
    end do
  end subroutine cell_quadrature_weigh

  pure subroutine cell_quadrature_find_centres(self, grid, centre)
    !! Centroids of hosts with the parts that joined them, in the cells where this rank has
    !! particles. From shapes only.
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    real(wp), intent(out) :: centre(ndim, grid%n_cell)   !! from the cell's low corner [cells]
    integer :: c, host

    if (self%fitted) then
      centre = 0.5_wp
      return
    end if
    centre = 0.0_wp
    do c = 1, grid%n_cell
      host = self%host(c)
      centre(:, host) = centre(:, host) + self%share(c)* &
                        (self%centroid(:, c) + &
                         real(grid%cell_base(:, c) - grid%cell_base(:, host), wp))
    end do
  end subroutine cell_quadrature_find_centres

  elemental logical function cell_quadrature_is_unseen(self, grid, cell, least) result(is_unseen)
    !! Is a cell of exact measures filled by so much, but without particle?
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    real(wp), intent(in) :: least   !! [-]

    is_unseen = self%host(cell) /= cell .and. self%part(cell) >= least*grid%spacing**ndim
  end function cell_quadrature_is_unseen

  pure subroutine cell_quadrature_strain_operator(self, grid, cell, operator)
    !! C of one part: its mean strain is the product with its corners' displacements.
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    real(wp), intent(out) :: operator(nsig, ndim*2**ndim)   !! corner by corner, 2 x shear [1/m]
    real(wp) :: centre(ndim, 2**ndim)
    integer :: a, b, k, column

    if (self%fitted) then
      call hat_gradients(spread(0.5_wp, 1, ndim), spread(0.0_wp, 1, ndim), grid%spacing, centre)
    else
      centre = self%gradient(:, :, cell)
    end if
    operator = 0.0_wp
    do k = 1, 2**ndim
      do a = 1, ndim
        column = ndim*(k - 1) + a
        do b = 1, ndim
          operator(voigt_slot(a, b), column) = operator(voigt_slot(a, b), column) + centre(b, k)
        end do
      end do
    end do
  end subroutine cell_quadrature_strain_operator

  pure subroutine cell_quadrature_slopes(self, grid, velocity, slope)
    !! Kernel: mean gradients dv_a/dx_b of every cell that has particles, of its whole union.
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: velocity(ndim, grid%n_node)   !! [m/s]
    real(wp), intent(out) :: slope(ndim, ndim, grid%n_cell)   !! [1/s]
    real(wp) :: centre(ndim, 2**ndim)
    integer :: c, host

    call hat_gradients(spread(0.5_wp, 1, ndim), spread(0.0_wp, 1, ndim), grid%spacing, centre)
    slope = 0.0_wp
    do c = 1, grid%n_cell
      host = c
      if (.not. self%fitted) then
        host = self%host(c)
        if (.not. self%share(c) > 0.0_wp) cycle
        centre = self%share(c)*self%gradient(:, :, c)
      end if
      slope(:, :, host) = slope(:, :, host) + slope_of(grid, c, centre, velocity)
    end do
  end subroutine cell_quadrature_slopes

  pure subroutine cell_quadrature_strains(self, grid, dt, velocity, strain)
    !! Kernel: dt sym(C v), from the same gradients.
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: dt                        !! [s]
    real(wp), intent(in) :: velocity(ndim, grid%n_node)   !! [m/s]
    real(wp), intent(out) :: strain(nsig, grid%n_cell)    !! tension positive, 2 x shear [-]
    real(wp) :: centre(ndim, 2**ndim), slope(ndim, ndim)
    integer :: a, b, c, host

    call hat_gradients(spread(0.5_wp, 1, ndim), spread(0.0_wp, 1, ndim), grid%spacing, centre)
    strain = 0.0_wp
    do c = 1, grid%n_cell
      host = c
      if (.not. self%fitted) then
        host = self%host(c)
        if (.not. self%share(c) > 0.0_wp) cycle
        centre = self%share(c)*self%gradient(:, :, c)
      end if
      slope = slope_of(grid, c, centre, velocity)
      do b = 1, ndim
        do a = 1, ndim
          strain(voigt_slot(a, b), host) = strain(voigt_slot(a, b), host) + dt*slope(a, b)
        end do
      end do
    end do
  end subroutine cell_quadrature_strains

  pure function slope_of(grid, cell, centre, velocity) result(slope)
    !! Kernel: a cell's gradient C of a nodal field [1/s].
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: cell
    real(wp), intent(in) :: centre(ndim, 2**ndim)         !! C [1/m]
    real(wp), intent(in) :: velocity(ndim, grid%n_node)   !! [m/s]
    real(wp) :: slope(ndim, ndim)
    integer :: a, b, k

    slope = 0.0_wp
    do k = 1, 2**ndim
      do b = 1, ndim
        do a = 1, ndim
          slope(a, b) = slope(a, b) + velocity(a, grid%cell_node(k, cell))*centre(b, k)
        end do
      end do
    end do
  end function slope_of

  pure subroutine cell_quadrature_forces(self, grid, share, stress, force)
    !! Kernel: adds - W C^T sigma of every cell, the adjoint of `strains`.
    class(cell_quadrature_t), intent(in) :: self
    type(grid_t), intent(in) :: grid
    real(wp), intent(in) :: share(grid%n_cell)          !! this rank's part of W [m3]
    real(wp), intent(in) :: stress(nsig, grid%n_cell)   !! tension positive [Pa]
    real(wp), intent(inout) :: force(:, :)              !! (ndim, n_node) [N]
    real(wp) :: centre(ndim, 2**ndim), load(ndim, ndim)
    integer :: a, b, c, k, host

    call hat_gradients(spread(0.5_wp, 1, ndim), spread(0.0_wp, 1, ndim), grid%spacing, centre)
    do c = 1, grid%n_cell
      host = c
      if (.not. self%fitted) host = self%host(c)
      if (.not. share(host) > 0.0_wp) cycle
      if (.not. self%fitted) centre = self%share(c)*self%gradient(:, :, c)
      do b = 1, ndim
        do a = 1, ndim
          load(a, b) = -share(host)*stress(voigt_slot(a, b), host)
        end do
      end do
      do k = 1, 2**ndim
        do b = 1, ndim
          do a = 1, ndim
            force(a, grid%cell_node(k, c)) = force(a, grid%cell_node(k, c)) + &
                                             load(a, b)*centre(b, k)
          end do
        end do
      end do
    end do
  end subroutine cell_quadrature_forces
end module dosui_cell_quadrature

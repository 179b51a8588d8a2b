!! Nodes that a body hardly touches follow those that it fills: the conforming extension.
!!
!! A node is well-posed if its share sum N_i(x_p) V_p of the particles' volumes is at least about
!! half of A_i = sum W_c/2^d, what the filled parts W_c of the cells around would give it if they
!! were evenly filled, and if one of these cells is not just a sliver. All others follow a linear
!! fit through well-posed nodes k around them, u_j = sum E_jk u_k. Sums over k of E_jk are 1, of
!! E_jk x_k x_j: linear fields, hence rigid motions and uniform strains, are reproduced. Sources
!! come by whole shells of equal distance until they span all directions, so there are no ties to
!! break; they are connected with j through filled cells. Aggregated unfitted elements [Badia2018]
!! with the averaged extension of [Burman2022].
!!
!! Cells, particles and kernels know nothing of it. What others do:
!!
!!     call extension%init(…)                     at every build of the geometry; collective
!!     if (extension%is_on) then                  the same on all ranks; else nothing to do
!!       call extension%fold(…, forces, held)     E^T: complete forces, masses x velocities, …
!!       call extension%solve(…, forces, held)    M_r^-1 of folded ones, M_r = E^T diag(m) E
!!       call extension%expand(…, motion, held)   E: before motions are used
!!     end if
!!
!! Conditions on nodes win over the extension, component by component: what they hold does not
!! follow, but may lead.
!!
!! The mass is restricted exactly, not lumped: with negative weights row sums would make transfers
!! amplify. M_r is diagonal but for the sources of other nodes (the strip), where conjugate
!! gradients start with D^-1 b, D = E^T m: the sum of the residual is then 0 in every iterate, and
!! linear momentum exact however early they stop.
!!
!! Implicit systems take the rows themselves: `row_of(i)` is the row r of a node that follows, 0 if
!! it is its own unknown; its sources are `strip_key(source(k))` (a node's key; `strip_node` is its
!! number in this rank's grid, 0 if it has none there) with weights `weight(k)`,
!! k = row_start(r) … row_start(r + 1) - 1. Rows of nodes that the caller wants are there, others'
!! nodes included; `complete_strip` brings the sources' values (numbers of unknowns, too) from
!! their owners, those outside this rank's grid included, `add_strip` sums values back.
module dosui_nodal_extension
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  use dosui_index_map, only: index_map_t
  use dosui_keys, only: unpack_key
  use dosui_sort, only: binary_search, sort_permutation
  use dosui_nodal_fits, only: look_around, find_well_posed, find_fits, share_boxes, send_keys, &
                              node_table_t, fit_t
  implicit none
  private

  real(wp), parameter :: lumped_share = 0.05_wp   !! least E^T m over the diagonal of M_r [-]
  real(wp), parameter :: solver_tolerance = 1.0e-13_wp   !! of masses times velocities [-]
  integer, parameter :: iteration_limit = 100
  integer, parameter :: n_column = 2*ndim         !! velocities and accelerations at a time

  type, public :: nodal_extension_t
    logical :: is_on = .false.               !! a node follows others, on any rank
    logical, allocatable :: follows(:)       !! (n_node) is no unknown of its own
    integer, allocatable :: row_of(:)        !! (n_node) its row, 0: none here
    integer :: n_row = 0                     !! rows of owned and of wanted nodes
    integer, allocatable :: row_node(:)      !! (n_row)
    logical, allocatable :: row_is_owned(:)  !! (n_row)
    integer, allocatable :: row_start(:)     !! (n_row + 1) into source and weight
    integer, allocatable :: source(:)        !! places in the strip, by key
    real(wp), allocatable :: weight(:)       !! E_jk [-]
    integer :: n_strip = 0                   !! sources that this rank knows
    integer(i8), allocatable :: strip_key(:) !! (n_strip) sorted
    integer, allocatable :: strip_node(:)    !! (n_strip) nodes, 0: not in this rank's grid
    logical, allocatable :: strip_is_owned(:)   !! (n_strip) this rank owns the node
    logical, allocatable :: in_strip(:)      !! (n_node) leads others
    type(index_map_t) :: strip_map           !! copies of the strip; owners are not the nodes'
    integer :: n_follow = 0    !! nodes that follow, on all ranks
    integer :: n_short = 0     !! of them: without neighbours in some direction
    integer :: n_orphan = 0    !! ill-posed nodes that nothing leads: they stay free
    integer :: first_short(ndim) = 0, first_orphan(ndim) = 0   !! coordinates of one, if there are
    integer :: n_solve = 0, n_iteration = 0, most_iterations = 0
  contains
    procedure :: init => nodal_extension_init
    procedure :: fold => nodal_extension_fold
    procedure :: expand => nodal_extension_expand
    procedure :: solve => nodal_extension_solve
    procedure :: mass_product => nodal_extension_mass_product
    procedure :: complete_strip
    procedure :: add_strip
  end type nodal_extension_t

contains

  ! ---------------------------------------------------------------- construction

  subroutine nodal_extension_init(self, comm, grid, filling, is_occupied, amount, wanted)
    !! Finds the well-posed nodes and what the others follow. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    real(wp), intent(in) :: filling(grid%n_cell)       !! W_c over a cell's volume [-]
    logical, intent(in) :: is_occupied(grid%n_cell)    !! holds a particle of any rank
    real(wp), intent(in) :: amount(grid%n_node)
    !! sum N_i V_p, complete, over a cell's volume [-]
    logical, intent(in) :: wanted(grid%n_node)
    !! nodes whose rows this rank needs; owned ones with particles or filled cells have theirs
    type(node_table_t) :: table
    type(fit_t), allocatable :: fit(:)
    real(wp), allocatable :: around(:, :)
    logical, allocatable :: needs_row(:)
    integer, allocatable :: row_node(:)
    integer :: i

    self%n_solve = 0
    self%n_iteration = 0
    self%most_iterations = 0
    call look_around(comm, grid, filling, is_occupied, around)
    call find_well_posed(comm, grid, amount, around, table)
    allocate (needs_row(grid%n_node))
    do i = 1, grid%n_node
      needs_row(i) = around(1, i) > 0.0_wp .or. amount(i) > 0.0_wp
      needs_row(i) = needs_row(i) .and. (wanted(i) .or. grid%node_map%is_owned(i)) .and. &
                     .not. table%is_well(i)
    end do
    self%is_on = comm%any(any(needs_row))
    if (.not. self%is_on) then
      call clear(self, grid%n_node)
      return
    end if
    row_node = pack([(i, i=1, grid%n_node)], needs_row)
    call find_fits(comm, grid, row_node, table, fit)
    call keep_fits(self, comm, grid, row_node, table, fit)
  end subroutine nodal_extension_init

  subroutine clear(self, n_node)
    !! Every node is its own unknown.
    class(nodal_extension_t), intent(inout) :: self
    integer, intent(in) :: n_node

    self%follows = spread(.false., 1, n_node)
    self%row_of = spread(0, 1, n_node)
    self%n_row = 0
    self%n_strip = 0
    self%n_follow = 0
    self%n_short = 0
    self%n_orphan = 0
  end subroutine clear

  ! ---------------------------------------------------------------- rows and strip

  subroutine keep_fits(self, comm, grid, row_node, table, fit)
    !! Fits become rows, their sources the strip. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: row_node(:)
    type(node_table_t), intent(in) :: table
    type(fit_t), intent(in) :: fit(:)
    real(wp) :: mark(1, grid%n_node)
    integer, allocatable :: strip_of(:)
    integer :: r, k, n, place
    integer(i8) :: counts(3), key, first(2)

    self%follows = spread(.false., 1, grid%n_node)
    mark = 0.0_wp
    counts = 0_i8
    first = huge(first)
    do r = 1, size(row_node)
      if (fit(r)%n > 0) mark(1, row_node(r)) = 1.0_wp
      if (.not. grid%node_map%is_owned(row_node(r))) cycle
      key = grid%node_key(row_node(r))
      if (fit(r)%n == 0) then
        counts(3) = counts(3) + 1_i8
        first(2) = min(first(2), key)
        cycle
      end if
      counts(1) = counts(1) + 1_i8
      if (.not. fit(r)%is_short) cycle
      counts(2) = counts(2) + 1_i8
      first(1) = min(first(1), key)
    end do
    call grid%node_map%gather(comm, 1, mark)
    self%follows = mark(1, :) > 0.5_wp
    self%n_follow = int(comm%sum(counts(1)))
    self%n_short = int(comm%sum(counts(2)))
    self%n_orphan = int(comm%sum(counts(3)))
    self%first_short = coordinates_of(comm%minimum(first(1)), self%n_short)
    self%first_orphan = coordinates_of(comm%minimum(first(2)), self%n_orphan)
    call build_strip(self, comm, grid, table, fit, strip_of)
    self%n_row = count(fit%n > 0)
    if (allocated(self%row_node)) deallocate (self%row_node, self%row_start, self%source, &
                                              self%weight, self%row_is_owned)
    n = sum(fit%n)
    allocate (self%row_node(self%n_row), self%row_start(self%n_row + 1), self%source(n), &
              self%weight(n), self%row_is_owned(self%n_row))
    self%row_of = spread(0, 1, grid%n_node)
    self%row_start(1) = 1
    n = 0
    do r = 1, size(row_node)
      if (fit(r)%n == 0) cycle
      n = n + 1
      self%row_node(n) = row_node(r)
      self%row_is_owned(n) = grid%node_map%is_owned(row_node(r))
      self%row_of(row_node(r)) = n
      do k = 1, fit(r)%n
        place = self%row_start(n) + k - 1
        self%source(place) = strip_of(fit(r)%place(k))
        self%weight(place) = fit(r)%weight(k)
      end do
      self%row_start(n + 1) = self%row_start(n) + fit(r)%n
    end do
  end subroutine keep_fits

  pure function coordinates_of(key, n) result(place)
    !! Coordinates of the first of n nodes; 0 if there is none.
    integer(i8), intent(in) :: key
    integer, intent(in) :: n
    integer :: place(ndim), all(3)

    place = 0
    if (n == 0) return
    all = unpack_key(key)
    place = all(1:ndim)
  end function coordinates_of

  subroutine build_strip(self, comm, grid, table, fit, strip_of)
    !! The sources: all of this rank's nodes that any rank's rows use, and others' in its own rows.
    !! Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    type(node_table_t), intent(in) :: table
    type(fit_t), intent(in) :: fit(:)
    integer, allocatable, intent(out) :: strip_of(:)   !! place in the strip of the table's nodes
    real(wp) :: mark(1, grid%n_node)
    logical, allocatable :: is_used(:)
    integer(i8), allocatable :: keys(:), received(:)
    integer, allocatable :: order(:), n_received(:), box(:, :), place(:)
    integer :: r, k, i, n

    allocate (is_used(size(table%is_well)), source=.false.)
    do r = 1, size(fit)
      do k = 1, fit(r)%n
        is_used(fit(r)%place(k)) = .true.
      end do
    end do
    mark(1, :) = merge(1.0_wp, 0.0_wp, is_used(:grid%n_node))
    if (comm%size > 1) then
      call share_boxes(comm, grid, box)
      call send_keys(comm, box, pack(table%extra_key, is_used(grid%n_node + 1:)), received, &
                     n_received)
      do k = 1, size(received)
        i = binary_search(grid%node_key, received(k))
        if (i == 0) cycle
        if (grid%node_map%is_owned(i)) mark(1, i) = 1.0_wp
      end do
      call grid%node_map%sum_copies(comm, 1, mark)
    end if
    is_used(:grid%n_node) = mark(1, :) > 0.5_wp
    self%in_strip = is_used(:grid%n_node)
    n = count(is_used)
    place = pack([(k, k=1, size(is_used))], is_used)
    keys = [pack(grid%node_key, is_used(:grid%n_node)), &
            pack(table%extra_key, is_used(grid%n_node + 1:))]
    call sort_permutation(keys, order)
    self%n_strip = n
    self%strip_key = keys(order)
    allocate (strip_of(size(is_used)), source=0)
    if (allocated(self%strip_node)) deallocate (self%strip_node, self%strip_is_owned)
    allocate (self%strip_node(n), source=0)
    allocate (self%strip_is_owned(n), source=.false.)
    do k = 1, n
      strip_of(place(order(k))) = k
      if (place(order(k)) > grid%n_node) cycle
      self%strip_node(k) = place(order(k))
      self%strip_is_owned(k) = grid%node_map%is_owned(self%strip_node(k))
    end do
    call self%strip_map%init_shared(comm, self%strip_key, spread(.true., 1, n))
  end subroutine build_strip

  ! ---------------------------------------------------------------- use

  subroutine complete_strip(self, comm, width, values)
    !! Brings values of the strip from the nodes' owners to all copies. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width
    real(wp), intent(inout) :: values(width, self%n_strip)   !! [any unit]
    integer :: s

    if (comm%size == 1) return
    do s = 1, self%n_strip
      if (.not. self%strip_is_owned(s)) values(:, s) = 0.0_wp
    end do
    call self%add_strip(comm, width, values)
  end subroutine complete_strip

  subroutine add_strip(self, comm, width, values)
    !! Sums the ranks' parts of the strip, on all copies. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    integer, intent(in) :: width
    real(wp), intent(inout) :: values(width, self%n_strip)   !! [any unit]

    call self%strip_map%sum_copies(comm, width, values)
  end subroutine add_strip

  subroutine nodal_extension_fold(self, comm, grid, width, values, is_held)
    !! E^T: what components that follow have goes to their sources, and leaves them 0. Held ones
    !! keep theirs. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: width    !! a multiple of ndim if components are held
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete: forces [N], momenta [kg m/s], masses [kg]
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp) :: strip(width, self%n_strip), given(width)
    integer :: i, k, r, s

    if (.not. self%is_on) return
    strip = 0.0_wp
    do r = 1, self%n_row
      if (.not. self%row_is_owned(r)) cycle
      given = values(:, self%row_node(r))
      if (present(is_held)) where (columns(width, is_held(:, self%row_node(r)))) given = 0.0_wp
      do k = self%row_start(r), self%row_start(r + 1) - 1
        s = self%source(k)
        strip(:, s) = strip(:, s) + self%weight(k)*given
      end do
    end do
    call self%add_strip(comm, width, strip)
    do s = 1, self%n_strip
      if (self%strip_node(s) == 0) cycle
      values(:, self%strip_node(s)) = values(:, self%strip_node(s)) + strip(:, s)
    end do
    do i = 1, grid%n_node
      if (.not. self%follows(i)) cycle
      if (present(is_held)) then
        where (.not. columns(width, is_held(:, i))) values(:, i) = 0.0_wp
      else
        values(:, i) = 0.0_wp
      end if
    end do
  end subroutine nodal_extension_fold

  subroutine nodal_extension_expand(self, comm, grid, width, values, is_held)
    !! E: components that follow get their values; held ones keep theirs. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width    !! a multiple of ndim if components are held
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete on nodes that do not follow [m or any unit of a motion]
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp) :: strip(width, self%n_strip), total(width)
    integer :: k, r, s

    if (.not. self%is_on) return
    do s = 1, self%n_strip
      if (self%strip_node(s) > 0) strip(:, s) = values(:, self%strip_node(s))
    end do
    call self%complete_strip(comm, width, strip)
    do r = 1, self%n_row
      total = 0.0_wp
      do k = self%row_start(r), self%row_start(r + 1) - 1
        total = total + self%weight(k)*strip(:, self%source(k))
      end do
      if (present(is_held)) then
        where (columns(width, is_held(:, self%row_node(r)))) total = values(:, self%row_node(r))
      end if
      values(:, self%row_node(r)) = total
    end do
    call grid%node_map%gather(comm, width, values)
  end subroutine nodal_extension_expand

  pure function columns(width, components)
    !! Flags of a node's components, for several vectors one after the other.
    integer, intent(in) :: width
    logical, intent(in) :: components(ndim)
    logical :: columns(width)
    integer :: k

    columns = [(components(mod(k - 1, ndim) + 1), k=1, width)]
  end function columns

  subroutine nodal_extension_mass_product(self, comm, grid, width, mass, values)
    !! M_r = E^T diag(m) E times values of the nodes that do not follow; the others' are 0 on
    !! return. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width
    real(wp), intent(in) :: mass(grid%n_node)   !! complete [kg]
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! motions on entry [m/s or m/s2], [kg m/s or N] on return
    integer :: i

    call self%expand(comm, grid, width, values)
    do i = 1, grid%n_node
      values(:, i) = mass(i)*values(:, i)
    end do
    call self%fold(comm, grid, width, values)
  end subroutine nodal_extension_mass_product

  subroutine nodal_extension_solve(self, comm, grid, width, mass, values, is_held)
    !! M_r^-1: folded momenta become velocities, folded forces accelerations, of all nodes, those
    !! that follow included. Nodes without mass get 0. Held components are what they are given as,
    !! and the mass beside moves with them. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width    !! one or two vectors of ndim components, one after the other
    real(wp), intent(in) :: mass(grid%n_node)               !! of particles, complete [kg]
    real(wp), intent(inout) :: values(width, grid%n_node)
    !! complete [kg m/s or N] on entry, [m/s or m/s2] on return
    logical, intent(in), optional :: is_held(ndim, grid%n_node)   !! components that conditions hold
    real(wp), dimension(n_column, self%n_strip) :: x, is_free
    real(wp) :: own(self%n_strip), row_mass(n_column, self%n_row), inverse
    integer :: i, k, n, s

    do i = 1, grid%n_node
      if (self%follows(i)) cycle
      if (self%is_on) then
        if (self%in_strip(i)) cycle
      end if
      inverse = 0.0_wp
      if (mass(i) > tiny(1.0_wp)*1.0e20_wp) inverse = 1.0_wp/mass(i)
      do k = 1, width
        if (present(is_held)) then
          if (is_held(mod(k - 1, ndim) + 1, i)) cycle
        end if
        values(k, i) = values(k, i)*inverse
      end do
    end do
    if (.not. self%is_on) return
    x = 0.0_wp
    is_free = 0.0_wp
    own = 0.0_wp
    do s = 1, self%n_strip
      if (self%strip_node(s) == 0) cycle
      x(:width, s) = values(:, self%strip_node(s))
      own(s) = mass(self%strip_node(s))
      is_free(:width, s) = 1.0_wp
      if (.not. present(is_held)) cycle
      where (columns(width, is_held(:, self%strip_node(s)))) is_free(:width, s) = 0.0_wp
    end do
    do n = 1, self%n_row
      row_mass(:, n) = mass(self%row_node(n))
      if (.not. present(is_held)) cycle
      where (columns(n_column, is_held(:, self%row_node(n)))) row_mass(:, n) = 0.0_wp
    end do
    call solve_strip(self, comm, own, row_mass, is_free, x, present(is_held))
    do s = 1, self%n_strip
      if (self%strip_node(s) > 0) values(:, self%strip_node(s)) = x(:width, s)
    end do
    call self%expand(comm, grid, width, values, is_held)
  end subroutine nodal_extension_solve

  subroutine solve_strip(self, comm, own, row_mass, is_free, x, has_held)
    !! The equations of the strip, by conjugate gradients. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(inout) :: own(self%n_strip)   !! masses of the nodes [kg]
    real(wp), intent(in) :: row_mass(n_column, self%n_row)
    !! masses of the components that follow [kg]
    real(wp), intent(inout) :: is_free(n_column, self%n_strip)   !! 1: unknown, 0: held
    real(wp), intent(inout) :: x(n_column, self%n_strip)
    !! right side on unknowns and values where held; solution on return
    logical, intent(in) :: has_held
    real(wp), dimension(n_column, self%n_strip) :: r, z, p, q, inverse
    real(wp) :: sums(2*n_column), before(n_column), first(n_column), factor(n_column)
    integer :: iteration

    call self%complete_strip(comm, n_column, x)
    call self%complete_strip(comm, 1, own)
    call self%complete_strip(comm, n_column, is_free)
    r = is_free*x
    x = x - r          ! what is held
    call invert_lumped(self, comm, own, row_mass, is_free, inverse)
    z = inverse*r
    sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, r, z)
    if (has_held) then
      call multiply(x, q)
      r = is_free*(r - q)
    end if
    p = inverse*r      ! after this the residual's sum is 0
    x = x + p
    call multiply(p, q)
    r = is_free*(r - q)
    p = inverse*r
    sums(n_column + 1:) = product_of(self%n_strip, self%strip_is_owned, r, p)
    call comm%sum_array(sums)
    first = sums(:n_column)
    before = sums(n_column + 1:)
    self%n_solve = self%n_solve + 1
    do iteration = 1, iteration_limit
      if (all(before <= solver_tolerance**2*first)) exit
      call multiply(p, q)
      sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, p, q)
      call comm%sum_array(sums(:n_column))
      factor = 0.0_wp
      where (sums(:n_column) > 0.0_wp) factor = before/sums(:n_column)
      call advance(self%n_strip, factor, is_free, inverse, p, q, x, r, z)
      sums(:n_column) = product_of(self%n_strip, self%strip_is_owned, r, z)
      call comm%sum_array(sums(:n_column))
      factor = 0.0_wp
      where (before > 0.0_wp) factor = sums(:n_column)/before
      before = sums(:n_column)
      call turn(self%n_strip, factor, z, p)
      self%n_iteration = self%n_iteration + 1
      self%most_iterations = max(self%most_iterations, iteration)
    end do

  contains

    subroutine multiply(a, b)
      !! b = M_r a on the strip, complete on all copies.
      real(wp), intent(in) :: a(n_column, self%n_strip)
      real(wp), intent(out) :: b(n_column, self%n_strip)

      call start_product(self%n_strip, self%strip_is_owned, own, a, b)
      call add_followers(self%n_row, self%row_is_owned, self%row_start, size(self%source), &
                         self%source, self%weight, row_mass, self%n_strip, a, b)
      call self%add_strip(comm, n_column, b)
    end subroutine multiply
  end subroutine solve_strip

  pure function product_of(n, is_owned, a, b) result(products)
    !! Kernel: this rank's part of the scalar products.
    integer, intent(in) :: n
    logical, intent(in) :: is_owned(n)
    real(wp), intent(in) :: a(n_column, n), b(n_column, n)
    real(wp) :: products(n_column)
    integer :: k

    products = 0.0_wp
    do k = 1, n
      if (is_owned(k)) products = products + a(:, k)*b(:, k)
    end do
  end function product_of

  pure subroutine advance(n, factor, is_free, inverse, p, q, x, r, z)
    !! Kernel: one step along a direction.
    integer, intent(in) :: n
    real(wp), intent(in) :: factor(n_column)
    real(wp), dimension(n_column, n), intent(in) :: is_free, inverse, p, q
    real(wp), dimension(n_column, n), intent(inout) :: x, r, z
    integer :: k

    do k = 1, n
      x(:, k) = x(:, k) + factor*p(:, k)
      r(:, k) = r(:, k) - factor*is_free(:, k)*q(:, k)
      z(:, k) = inverse(:, k)*r(:, k)
    end do
  end subroutine advance

  pure subroutine turn(n, factor, z, p)
    !! Kernel: the next direction.
    integer, intent(in) :: n
    real(wp), intent(in) :: factor(n_column), z(n_column, n)
    real(wp), intent(inout) :: p(n_column, n)
    integer :: k

    do k = 1, n
      p(:, k) = z(:, k) + factor*p(:, k)
    end do
  end subroutine turn

  pure subroutine start_product(n, is_owned, own, a, b)
    !! Kernel: the nodes' own masses times a.
    integer, intent(in) :: n
    logical, intent(in) :: is_owned(n)
    real(wp), intent(in) :: own(n), a(n_column, n)
    real(wp), intent(out) :: b(n_column, n)
    integer :: k

    do k = 1, n
      if (is_owned(k)) then
        b(:, k) = own(k)*a(:, k)
      else
        b(:, k) = 0.0_wp
      end if
    end do
  end subroutine start_product

 pure subroutine add_followers(n_row, row_is_owned, row_start, n_source, source, weight, row_mass, &
                                n_strip, a, b)
    !! Kernel: adds E^T m E a of the nodes that follow.
    integer, intent(in) :: n_row, n_source, n_strip
    logical, intent(in) :: row_is_owned(n_row)
    integer, intent(in) :: row_start(n_row + 1), source(n_source)
    real(wp), intent(in) :: weight(n_source)
    real(wp), intent(in) :: row_mass(n_column, n_row)   !! [kg]
    real(wp), intent(in) :: a(n_column, n_strip)
    real(wp), intent(inout) :: b(n_column, n_strip)
    real(wp) :: total(n_column)
    integer :: k, row

    do row = 1, n_row
      if (.not. row_is_owned(row)) cycle
      total = 0.0_wp
      do k = row_start(row), row_start(row + 1) - 1
        total = total + weight(k)*a(:, source(k))
      end do
      total = row_mass(:, row)*total
      do k = row_start(row), row_start(row + 1) - 1
        b(:, source(k)) = b(:, source(k)) + weight(k)*total
      end do
    end do
  end subroutine add_followers

  subroutine invert_lumped(self, comm, own, row_mass, is_free, inverse)
    !! 1/(E^T m), or of the diagonal of M_r where that is much larger; 0 where held. Collective.
    class(nodal_extension_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    real(wp), intent(in) :: own(self%n_strip)                 !! masses of the strip's nodes [kg]
    real(wp), intent(in) :: row_mass(n_column, self%n_row)    !! of components that follow [kg]
    real(wp), intent(in) :: is_free(n_column, self%n_strip)
    real(wp), intent(out) :: inverse(n_column, self%n_strip)  !! [1/kg]
    real(wp) :: lumped(2*ndim, self%n_strip)   ! E^T m and the diagonal of M_r
    integer :: a, k, r, s

    lumped = 0.0_wp
    do r = 1, self%n_row
      if (.not. self%row_is_owned(r)) cycle
      do k = self%row_start(r), self%row_start(r + 1) - 1
        s = self%source(k)
        lumped(:ndim, s) = lumped(:ndim, s) + self%weight(k)*row_mass(:ndim, r)
        lumped(ndim + 1:, s) = lumped(ndim + 1:, s) + self%weight(k)**2*row_mass(:ndim, r)
      end do
    end do
    call self%add_strip(comm, 2*ndim, lumped)
    do s = 1, self%n_strip
      do a = 1, ndim
        lumped(a, s) = lumped(a, s) + own(s)
        lumped(ndim + a, s) = lumped(ndim + a, s) + own(s)
        if (.not. lumped(a, s) > lumped_share*lumped(ndim + a, s)) then
          lumped(a, s) = lumped(ndim + a, s)
        end if
        lumped(ndim + a, s) = 0.0_wp
        if (lumped(a, s) > tiny(1.0_wp)*1.0e20_wp) lumped(ndim + a, s) = 1.0_wp/lumped(a, s)
      end do
      do k = 1, n_column
        inverse(k, s) = is_free(k, s)*lumped(ndim + mod(k - 1, ndim) + 1, s)
      end do
    end do
  end subroutine invert_lumped
end module dosui_nodal_extension

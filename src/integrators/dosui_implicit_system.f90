!! The equations of an implicit step: stiffness, coupling, storage and flow as one block system.
!!
!!     [ K      -Q       ] [du]   [f]        f: forces at the new time on the old state
!!     [ V P D  S - a VL ] [dp] = [r]        a: weight of the flow at the new time
!!
!! K, Q and VPD come from the explicit step's own strain operators, S is its storage, and L its head
!! operator over gamma_w. Unknowns are scaled by the grid spacing and the skeleton's modulus, so
!! that all blocks are of order one.
!!
!! For semi-implicit steps the inertia M/dt^2 takes the place of K: du is then the motion that the
!! new pressures add to that of the explicit forces.
module dosui_implicit_system
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, volume_slot
  use dosui_block_system, only: block_p, block_system_t, block_u
  use dosui_cell_quadrature, only: hat_gradients
  use dosui_entries, only: entries_t
  use dosui_error, only: error_t
  use dosui_finite_strain, only: geometric_stiffness, invert
  use dosui_model, only: model_t
  use dosui_particle_moduli, only: find_moduli_of
  use dosui_pore_water, only: compressibility_at
  use dosui_skeleton_step, only: light_node_mass
  use dosui_stiffness, only: cell_lists, cell_operators_t, hourglass_operators
  use dosui_unknowns, only: unknowns_t
  use dosui_mean_operators, only: mean_operators, operators_of_cell, means_t
  use dosui_hourglass, only: elastic_tangent, hourglass_stiffness, part_stiffness, &
                             find_part_deviations
  implicit none
  private

  public :: find_empty, is_small, surface_gradients

  integer, parameter :: direct_limit(3) = [500000, 12000, 4000]   !! unknowns in 1-D, 2-D, 3-D
  integer, parameter, public :: n_system_memory = 3   !! numbers that a checkpoint keeps
  integer, parameter :: last_resort = 20   !! times as many are factorised where iterations fail
  !! of cells with one particle, over their deviatoric stiffness; it acts on increments only [-]
  real(wp), parameter :: empty_node = 1.0e-12_wp   !! stiffness of a node over the modulus [-]

  type, public :: implicit_system_t
    type(unknowns_t) :: unknowns
    type(block_system_t) :: system
    real(wp) :: length = 1.0_wp      !! unit of displacements [m]
    real(wp) :: pressure = 1.0_wp    !! unit of pressures [Pa]
    real(wp) :: force = 1.0_wp       !! unit of nodal forces [N]
    real(wp) :: volume = 1.0_wp      !! unit of water volumes [m3]
    real(wp) :: tolerance = 1.0e-6_wp   !! of linear solutions [-]
    logical, private :: insists_on_direct = .false.   !! iterations have failed
    real(wp), allocatable, private :: storage(:)   !! entries of S
    integer, allocatable, private :: storage_place(:, :)   !! (2, :) particles of those of S itself
    real(wp), allocatable, private :: flow(:)      !! entries of -VL, after those of S
    real(wp), allocatable, private :: coupling(:)  !! Schur complement beyond C, like storage
    real(wp), private :: flow_weight = -1.0_wp     !! a of the present entries [s]
    logical, private :: is_dynamic = .false.       !! inertia instead of stiffness
    real(wp), allocatable, private :: inertia(:)   !! entries of M [kg], scaled
    real(wp), private :: inertia_step = -1.0_wp    !! dt of the present entries [s]
    type(entries_t), private :: held               !! K, free rows and held columns, local places
    type(entries_t), private :: held_water         !! VPD, likewise; all columns in dynamic steps
  contains
    procedure :: build => implicit_build
    procedure :: solve => implicit_solve
    procedure :: internal_forces => implicit_internal_forces
    procedure :: stored => implicit_stored
    procedure :: stored_by_projection => implicit_stored_by_projection
    procedure :: turn_safe => implicit_turn_safe
    procedure :: memory => implicit_memory
    procedure :: recall => implicit_recall
    procedure :: set_step => implicit_set_step
    procedure :: volume_change => implicit_volume_change
    procedure :: pressure_forces => implicit_pressure_forces
    procedure, private :: build_skeleton
    procedure, private :: build_water
    procedure, private :: set_flow
    procedure, private :: subtract_held
  end type implicit_system_t

contains

  subroutine implicit_build(self, model, is_dynamic, err, by_walls)
    !! Assembles everything for the geometry at hand; with inertia, nodal masses must be there, and
    !! `set_step` follows. Collective.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    logical, intent(in) :: is_dynamic   !! inertia instead of stiffness
    type(error_t), intent(inout) :: err
    logical, intent(in), optional :: by_walls(:, :)   !! (ndim, n_node) held by rigid walls
    type(entries_t) :: skeleton, pressure_force, volume_change
    logical, allocatable :: is_empty(:, :)
    real(wp) :: h
    integer :: n_unknown, n_u
    logical :: is_direct

    h = model%scene%grid_spacing
    self%length = h
    self%pressure = model%scales%skeleton_modulus
    if (model%rigid) self%pressure = model%scene%water%unit_weight*h
    self%force = self%pressure*h**(ndim - 1)
    self%volume = h**ndim
    self%tolerance = model%scene%solver%tolerance
    self%flow_weight = -1.0_wp
    self%inertia_step = -1.0_wp
    self%is_dynamic = is_dynamic
    self%held = entries_t()
    self%held_water = entries_t()
    if (.not. model%rigid) then
      allocate (is_empty(ndim, model%grid%n_node))
      if (is_dynamic) then
        call find_light(model, is_empty)
      else
        call find_empty(model, is_empty)
      end if
      if (present(by_walls)) is_empty = is_empty .or. by_walls
    end if
    call self%unknowns%build(model, is_empty)
    n_u = self%unknowns%n_u
    ! rows of empty nodes around the body do not count: their number depends on the ranks
    n_unknown = model%comm%sum(self%unknowns%n_moving) + model%comm%sum(self%unknowns%n_p)
    is_direct = n_unknown <= direct_limit(ndim)
    if (model%scene%solver%linear /= 'auto') is_direct = model%scene%solver%linear == 'direct'
    is_direct = is_direct .or. self%insists_on_direct
    call self%system%init(model%comm, n_u, self%unknowns%n_p, is_direct, is_dynamic, err)
    if (err%failed()) return
    if (.not. model%rigid) then
      call self%build_skeleton(model, skeleton, pressure_force, volume_change)
      call self%system%set_pattern(block_u, block_u, skeleton%row, skeleton%column, err)
      if (.not. err%failed()) call self%system%set_values(block_u, block_u, skeleton%value, err)
      if (is_dynamic) self%inertia = skeleton%value
      if (.not. err%failed() .and. .not. is_dynamic) call set_coordinates(self, model, err)
      if (model%coupled .and. .not. err%failed()) then
        call self%system%set_pattern(block_u, block_p, pressure_force%row, pressure_force%column, &
                                     err)
        call self%system%set_values(block_u, block_p, pressure_force%value, err)
        call self%system%set_pattern(block_p, block_u, volume_change%row, volume_change%column, err)
        call self%system%set_values(block_p, block_u, volume_change%value, err)
      end if
    end if
    if (model%coupled .and. .not. err%failed()) call self%build_water(model, err)
    call model%comm%agree(err)
  end subroutine implicit_build

  logical function is_small(model)
    !! May equations of the skeleton alone be factorised? Collective.
    type(model_t), intent(in) :: model
    integer :: k, n

    n = 0
    do k = 1, model%grid%n_node
      if (model%grid%node_map%is_owned(k)) n = n + ndim
    end do
    is_small = model%comm%sum(n) <= direct_limit(ndim) .and. &
               model%scene%solver%linear /= 'iterative'
  end function is_small

  subroutine find_empty(model, is_empty)
    !! Nodes that no particle strains and no penalty wall holds: all weights there are zero.
    type(model_t), intent(inout) :: model
    logical, intent(out) :: is_empty(:, :)
    real(wp), allocatable :: touch(:, :)
    type(cell_operators_t) :: operators
    integer, allocatable :: start(:), particle(:)
    type(means_t) :: means
    integer :: c, p, i, k

    allocate (touch(ndim, model%grid%n_node), source=0.0_wp)
    call cell_lists(model%particles%count, model%mesh%cell, model%grid%n_cell, start, particle)
    call mean_operators(model, means)
    do c = 1, model%grid%n_cell
      if (start(c + 1) == start(c)) cycle
      call operators_of_cell(model, c, particle(start(c):start(c + 1) - 1), means, operators)
      do p = 1, size(operators%strain, 3)
        do i = 1, operators%n_node
          do k = 1, ndim
            touch(k, operators%node(i)) = &
              touch(k, operators%node(i)) + model%mesh%weight(particle(start(c) + p - 1))* &
              sum(operators%strain(:, ndim*(i - 1) + k, p)**2)
          end do
        end do
      end do
    end do
    call add_springs(model, touch)
    call model%grid%node_map%sum_copies(model%comm, ndim, touch)
    is_empty = .not. touch > empty_node*model%grid%spacing**(ndim - 2)
    if (model%mesh%extension%is_on) is_empty = is_empty .and. &
                                               .not. spread(model%mesh%extension%follows, 1, ndim)
  end subroutine find_empty

  subroutine add_springs(model, touch)
    !! Springs of penalty walls over the modulus: a wall in a cut cell can take a node out of all
    !! strains.
    type(model_t), intent(in) :: model
    real(wp), intent(inout) :: touch(:, :)   !! (ndim, n_node) [m**(ndim - 2)]
    integer, allocatable :: node(:)
    real(wp), allocatable :: weight(:)
    real(wp) :: spring(ndim, ndim)
    integer :: a, e, i

    associate (field => model%surface%field, h => model%s, m => model%surface%count)
      do e = 1, size(model%skeleton%surface_forces%entry_point)
        call model%skeleton%surface_forces%spring(e, field(h%area)%values(1, 1:m), &
                                                  node, weight, spring)
        do i = 1, size(node)
          do a = 1, ndim
            touch(a, node(i)) = touch(a, node(i)) + &
                                weight(i)**2*spring(a, a)/model%scales%skeleton_modulus
          end do
        end do
      end do
    end associate
  end subroutine add_springs

  subroutine find_light(model, is_light)
    !! Nodes that particles hardly touch: they keep their velocity, as in explicit steps.
    type(model_t), intent(in) :: model
    logical, intent(out) :: is_light(:, :)
    integer :: k

    do k = 1, model%grid%n_node
      is_light(:, k) = .not. model%skeleton%nodal(1, k) > light_node_mass(model)
    end do
  end subroutine find_light

  subroutine build_skeleton(self, model, skeleton, pressure_force, volume_change)
    !! Entries of K (or of the inertia), -Q and VPD, cell by cell, and of penalty walls.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(entries_t), intent(inout) :: skeleton, pressure_force, volume_change
    type(cell_operators_t) :: operators
    integer, allocatable :: start(:), particle(:)
    type(means_t) :: means
    real(wp) :: hourglass(nsig, ndim*2**ndim, 2**ndim)
    integer :: c
    logical :: walls_move

    walls_move = any(model%skeleton%nodal_conditions%wall%is_guided())
    call cell_lists(model%particles%count, model%mesh%cell, model%grid%n_cell, start, particle)
    call mean_operators(model, means)
    call hourglass_operators(model%grid%spacing, hourglass)
    do c = 1, model%grid%n_cell
      if (start(c + 1) == start(c)) cycle
      associate (inside => particle(start(c):start(c + 1) - 1))
        call operators_of_cell(model, c, inside, means, operators)
        if (.not. self%is_dynamic) then
          call add_stiffness(self, model, operators, inside, hourglass, walls_move, skeleton)
        end if
        if (model%coupled) then
          call add_coupling(self, model, operators, inside, walls_move .or. self%is_dynamic, &
                            pressure_force, volume_change)
        end if
      end associate
    end do
    call add_ones(self, skeleton)
    if (self%is_dynamic) then
      call add_masses(self, model, skeleton)
    else
      call add_walls(self, model, skeleton)
      if (model%finite) call add_pressure_loads(self, model, skeleton)
    end if
    call skeleton%finish()
    call pressure_force%finish()
    call volume_change%finish()
    call self%held%finish()
    call self%held_water%finish()
  end subroutine build_skeleton

  subroutine add_stiffness(self, model, operators, particle, hourglass, keeps_held, skeleton)
    !! Stiffness of one cell.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    type(cell_operators_t), intent(in) :: operators
    integer, intent(in) :: particle(:)          !! of the cell
    real(wp), intent(in) :: hourglass(:, :, :)  !! as from `hourglass_operators`
    logical, intent(in) :: keeps_held           !! columns of held components, too
    type(entries_t), intent(inout) :: skeleton
    real(wp) :: matrix(ndim*operators%n_node, ndim*operators%n_node), tangent(nsig, nsig)
    real(wp), allocatable :: deviation(:, :, :), volume(:)
    integer, allocatable :: node(:), place(:)
    integer :: a, i, p, k, m

    matrix = 0.0_wp
    do p = 1, size(particle)
      k = particle(p)
      if (allocated(model%skeleton%tangent)) then
        tangent = model%skeleton%tangent(:, :, k)
      else
        call elastic_tangent(model, k, tangent)
      end if
      if (model%finite) then   ! D belongs to the Kirchhoff stress
        tangent = tangent*model%particles%field(model%p%reference_volume)%values(1, k)/ &
                  model%particles%field(model%p%volume)%values(1, k)
      end if
      matrix = matrix + model%mesh%weight(k)*product_of(operators%strain(:, :, p), tangent)
    end do
    if (model%finite) call add_geometric(model, operators, particle, matrix)
    if (size(particle) == 1 .and. (model%skeleton%centred .or. model%finite)) then
      m = ndim*2**ndim   ! the cell's corners come first in its list of nodes
      if (allocated(model%skeleton%tangent)) call elastic_tangent(model, particle(1), tangent)
      do p = 1, 2**ndim
        matrix(1:m, 1:m) = matrix(1:m, 1:m) + hourglass_stiffness/2**ndim* &
                           model%mesh%weight(particle(1))*product_of(hourglass(:, :, p), tangent)
      end do
    end if
    call find_part_deviations(model, model%mesh%cell(particle(1)), node, deviation, volume)
    if (size(volume) > 0) then
      call elastic_tangent(model, particle(1), tangent)
      place = [((ndim*(findloc(operators%node, node(i), dim=1) - 1) + a, a=1, ndim), &
                i=1, size(node))]
      do p = 1, size(volume)
        matrix(place, place) = matrix(place, place) + &
                               part_stiffness(model)*volume(p)* &
                               product_of(deviation(:, :, p), tangent)
      end do
    end if
    matrix = matrix*(self%length/self%force)
    call add_matrix(self%unknowns, operators%node, matrix, skeleton)
    if (keeps_held) call keep_held(self, operators, matrix*(self%force/self%length))

  contains

    pure function product_of(strain, modulus) result(stiffness)
      !! E^T D E.
      real(wp), intent(in) :: strain(:, :), modulus(:, :)
      real(wp) :: stiffness(size(strain, 2), size(strain, 2))

      stiffness = matmul(transpose(strain), matmul(modulus, strain))
    end function product_of
  end subroutine add_stiffness

  subroutine add_matrix(unknowns, node, matrix, skeleton)
    !! A matrix on the components of a list of nodes becomes one on unknowns.
    type(unknowns_t), intent(in) :: unknowns
    integer, intent(in) :: node(:)
    real(wp), intent(in) :: matrix(:, :)    !! (ndim*nodes, ndim*nodes)
    type(entries_t), intent(inout) :: skeleton
    integer, allocatable :: row(:)
    real(wp), allocatable :: share(:, :), reduced(:, :), sign(:)
    integer :: i, j

    call unknowns%reduce(node, row, share)
    if (allocated(share)) then
      reduced = matmul(share, matmul(matrix, transpose(share)))
      do j = 1, size(row)
        do i = 1, size(row)
          call skeleton%add(row(i), row(j), reduced(i, j))
        end do
      end do
      return
    end if
    sign = reshape(unknowns%sign(:, node), [size(row)])
    do j = 1, size(row)
      do i = 1, size(row)
        call skeleton%add(row(i), row(j), sign(i)*sign(j)*matrix(i, j))
      end do
    end do
  end subroutine add_matrix

  subroutine add_geometric(model, operators, particle, matrix)
    !! What stresses and pressures of finite strains add to a cell's stiffness. With averaged
    !! volumes the mean parts s of the stress and p of the pressure act on the cell's volume:
    !! (s - p) sum v (div div - grad:grad^T) - s (sum v) D D^T with its mean divergence D.
    type(model_t), intent(in) :: model
    type(cell_operators_t), intent(in) :: operators
    integer, intent(in) :: particle(:)             !! of the cell
    real(wp), intent(inout) :: matrix(:, :)        !! [Pa m]
    real(wp) :: geometric(size(matrix, 1), size(matrix, 2)), stress(nsig), mean, water, volume
    real(wp) :: bearing(size(particle))   ! pressures that the skeleton feels [Pa]
    integer :: p, k, a, i

    bearing = 0.0_wp
    if (model%coupled) then
      bearing = model%particles%field(model%p%pore_pressure)%values(1, particle)
      do p = 1, size(particle)
        if (.not. model%unsaturated) exit
        bearing(p) = bearing(p)* &
                     model%water%retention(model%material(particle(p)))%saturation(bearing(p))
      end do
    end if

    associate (sigma => model%particles%field(model%p%effective_stress)%values, &
               v0 => model%particles%field(model%p%reference_volume)%values)
      mean = 0.0_wp
      water = 0.0_wp
      if (model%skeleton%averaged) then
        do p = 1, size(particle)
          k = particle(p)
          do a = 1, n_volume
            mean = mean + v0(1, k)*sigma(volume_slot(a), k)/n_volume
          end do
          water = water + v0(1, k)*bearing(p)
        end do
        volume = sum(v0(1, particle))
        mean = mean/volume
        water = water/volume
      end if
      do p = 1, size(particle)
        k = particle(p)
        stress = sigma(:, k)
        volume = model%mesh%weight(k)
        if (model%skeleton%averaged) then
          do a = 1, n_volume
            stress(volume_slot(a)) = stress(volume_slot(a)) - sum(sigma(volume_slot, k))/n_volume
          end do
          volume = model%skeleton%own_volume(k)
        else
          water = bearing(p)
        end if
        call geometric_stiffness(operators%gradient(:, :, p), stress*model%mesh%weight(k), &
                                 (water - mean)*volume, geometric)
        matrix = matrix + geometric
      end do
      if (.not. model%skeleton%averaged) return
      volume = sum(model%skeleton%own_volume(particle))
      do i = 1, size(matrix, 2)
        matrix(:, i) = matrix(:, i) - mean*volume*operators%volume(:, 1)*operators%volume(i, 1)
      end do
    end associate
  end subroutine add_geometric

  subroutine add_coupling(self, model, operators, particle, keeps_all, pressure_force, &
                          volume_change)
    !! Volume changes of one cell's particles, and the forces of their pressures.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    type(cell_operators_t), intent(in) :: operators
    integer, intent(in) :: particle(:)   !! of the cell
    logical, intent(in) :: keeps_all     !! all columns are wanted later
    type(entries_t), intent(inout) :: pressure_force, volume_change
    real(wp), allocatable :: shares(:, :), change(:), of_row(:), sign(:)
    integer, allocatable :: row(:)
    real(wp) :: bearing, saturation
    integer :: p, i, k

    call self%unknowns%reduce(operators%node, row, shares)
    if (.not. allocated(shares)) then
      sign = reshape(self%unknowns%sign(:, operators%node), [size(row)])
    end if
    bearing = 1.0_wp
    saturation = 1.0_wp
    do p = 1, size(particle)
      k = particle(p)
      if (model%unsaturated) then
        associate (retention => model%water%retention(model%material(k)), &
                   pressure => model%particles%field(model%p%pore_pressure)%values(1, k))
          saturation = retention%saturation(pressure)
          bearing = saturation + pressure*retention%capacity(pressure)
        end associate
      end if
      change = model%mesh%water_weight(k)*operators%volume(:, p)
      if (keeps_all) then
        do i = 1, size(change)
          if (.not. abs(change(i)) > 0.0_wp) cycle
          call self%held_water%add(k, place_of(operators, i), saturation*change(i)/self%volume)
        end do
      end if
      if (allocated(shares)) then
        of_row = matmul(shares, change)
      else
        of_row = sign*change
      end if
      of_row = of_row*(self%length/self%volume)
      do i = 1, size(row)
        if (.not. abs(of_row(i)) > 0.0_wp) cycle
        call volume_change%add(self%unknowns%particle_row(k), row(i), saturation*of_row(i))
        call pressure_force%add(row(i), self%unknowns%particle_row(k), -bearing*of_row(i))
      end do
    end do
  end subroutine add_coupling

  subroutine add_ones(self, skeleton)
    !! Components that follow no unknown of their own keep a one on the diagonal.
    class(implicit_system_t), intent(in) :: self
    type(entries_t), intent(inout) :: skeleton
    integer :: i, a, row

    do i = 1, size(self%unknowns%own_node)
      do a = 1, ndim
        row = self%unknowns%own_row(a, self%unknowns%own_node(i))
        if (self%unknowns%row(a, self%unknowns%own_node(i)) /= row) then
          call skeleton%add(row, row, 1.0_wp)
        end if
      end do
    end do
  end subroutine add_ones

  pure integer function place_of(operators, column) result(place)
    !! Place of a cell's column among the components of all nodes, from 1.
    type(cell_operators_t), intent(in) :: operators
    integer, intent(in) :: column

    place = ndim*(operators%node((column - 1)/ndim + 1) - 1) + mod(column - 1, ndim) + 1
  end function place_of

  subroutine keep_held(self, operators, matrix)
    !! Keeps the columns of held components, and of those that may follow them, for prescribed
    !! motion.
    class(implicit_system_t), intent(inout) :: self
    type(cell_operators_t), intent(in) :: operators
    real(wp), intent(in) :: matrix(:, :)
    integer :: i, j, place

    do j = 1, size(matrix, 2)
      place = place_of(operators, j)
      if (.not. is_prescribed(mod(place - 1, ndim) + 1, (place - 1)/ndim + 1)) cycle
      do i = 1, size(matrix, 1)
        call self%held%add(place_of(operators, i), place, matrix(i, j))
      end do
    end do

  contains

    pure logical function is_prescribed(a, node)
      !! May a component move with what is held?
      integer, intent(in) :: a, node

      is_prescribed = self%unknowns%is_held(a, node)
      if (self%unknowns%extends) is_prescribed = is_prescribed .or. self%unknowns%follows(a, node)
    end function is_prescribed
  end subroutine keep_held

  subroutine add_masses(self, model, skeleton)
    !! Nodal masses: on the diagonal, but for the unknowns that other nodes follow.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: skeleton
    integer :: k, i, j, a, node

    do k = 1, size(self%unknowns%own_node)
      node = self%unknowns%own_node(k)
      do a = 1, ndim
        if (self%unknowns%extends) then
          if (self%unknowns%follows(a, node)) then
            associate (start => self%unknowns%start, row => self%unknowns%source, &
                       share => self%unknowns%share, place => ndim*(node - 1) + a)
              do j = start(place), start(place + 1) - 1
                do i = start(place), start(place + 1) - 1
                  call skeleton%add(row(i), row(j), &
                             share(i)*share(j)*model%skeleton%nodal(1, node)*self%length/self%force)
                end do
              end do
            end associate
            cycle
          end if
        end if
        call skeleton%add(self%unknowns%row(a, node), self%unknowns%row(a, node), &
                          max(model%skeleton%nodal(1, node), &
                              model%skeleton%inertia(node))*self%length/self%force)
      end do
    end do
  end subroutine add_masses

  subroutine implicit_set_step(self, dt, err)
    !! Puts the step into the inertia; nothing to do when it is that of the last one.
    class(implicit_system_t), intent(inout) :: self
    real(wp), intent(in) :: dt   !! [s]
    type(error_t), intent(inout) :: err

    if (.not. abs(dt - self%inertia_step) > 0.0_wp) return
    call self%system%set_values(block_u, block_u, self%inertia/dt**2, err)
    self%inertia_step = dt
  end subroutine implicit_set_step

  subroutine implicit_volume_change(self, motion, change)
    !! Volume change of every particle's part of the body in a motion of the nodes.
    class(implicit_system_t), intent(in) :: self
    real(wp), intent(in) :: motion(:, :)     !! (ndim, n_node) [m]
    real(wp), intent(out) :: change(:)       !! of the particles [m3]
    integer :: k, column

    change = 0.0_wp
    do k = 1, self%held_water%n
      column = self%held_water%column(k) - 1
      change(self%held_water%row(k)) = change(self%held_water%row(k)) + &
                                       self%held_water%value(k)*self%volume* &
                                       motion(mod(column, ndim) + 1, column/ndim + 1)
    end do
  end subroutine implicit_volume_change

  subroutine implicit_pressure_forces(self, model, pressure, force)
    !! Nodal forces of particles' pressures, held components too. Collective.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)      !! [Pa]
    real(wp), intent(out) :: force(:, :)     !! (ndim, n_node) [N]
    integer :: k, column

    force = 0.0_wp
    do k = 1, self%held_water%n
      column = self%held_water%column(k) - 1
      associate (entry => force(mod(column, ndim) + 1, column/ndim + 1))
        entry = entry + self%held_water%value(k)*self%volume*pressure(self%held_water%row(k))
      end associate
    end do
    call model%grid%node_map%sum_copies(model%comm, ndim, force)
  end subroutine implicit_pressure_forces

  subroutine add_walls(self, model, skeleton)
    !! Springs of penalty walls.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: skeleton
    integer, allocatable :: node(:)
    real(wp), allocatable :: weight(:)
    real(wp), allocatable :: matrix(:, :)
    real(wp) :: spring(ndim, ndim)
    integer :: e, i, j

    associate (field => model%surface%field, h => model%s, m => model%surface%count)
      do e = 1, size(model%skeleton%surface_forces%entry_point)
        call model%skeleton%surface_forces%spring(e, field(h%area)%values(1, 1:m), node, &
                                                  weight, spring)
        if (size(node) == 0) cycle
        allocate (matrix(ndim*size(node), ndim*size(node)))
        do j = 1, size(node)
          do i = 1, size(node)
            matrix(ndim*(i - 1) + 1:ndim*i, ndim*(j - 1) + 1:ndim*j) = &
              weight(i)*weight(j)*(self%length/self%force)*spring
          end do
        end do
        call add_matrix(self%unknowns, node, matrix, skeleton)
        deallocate (matrix)
      end do
    end associate
  end subroutine add_walls

  subroutine surface_gradients(model, p, gradient)
    !! Gradients of a surface point's cell with respect to the reference configuration.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p                                 !! surface point with a cell
    real(wp), intent(out) :: gradient(ndim, 2**ndim)         !! [1/m]
    real(wp) :: place(ndim)

    associate (grid => model%grid)
      place = (model%surface%field(model%s%position)%values(:, p) - grid%origin)/grid%spacing - &
              real(grid%cell_base(:, model%mesh%surface_cell(p)), wp)
      call hat_gradients(place, spread(0.0_wp, 1, ndim), grid%spacing, gradient)
    end associate
  end subroutine surface_gradients

  subroutine add_pressure_loads(self, model, skeleton)
    !! Pressures on surfaces of finite strains turn and grow with them: the derivative of
    !! f_i = -q N_i n a is -q N_i a (n div(u) - grad(u)^T n), which is not symmetric.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: skeleton
    real(wp) :: gradient(ndim, 2**ndim), f(ndim, ndim), inverse(ndim, ndim), jacobian, load
    real(wp) :: matrix(2*ndim*2**ndim, 2*ndim*2**ndim)   ! of loaded nodes and of the point's cell
    integer, parameter :: half = ndim*2**ndim
    integer :: e, p, i, j, k, a, b

    associate (field => model%surface%field, h => model%s, forces => model%skeleton%surface_forces)
      do e = 1, size(forces%entry_point)
        p = forces%entry_point(e)
        associate (condition => model%scene%mechanical_condition(forces%entry_condition(e)))
          if (condition%kind /= 'pressure' .and. condition%kind /= 'reservoir') cycle
          if (model%mesh%surface_cell(p) == 0) cycle
          load = condition%pressure_at(model%clock%time, &
                                       field(h%current_position)%values(:, p))* &
                 field(h%area)%values(1, p)
        end associate
        call surface_gradients(model, p, gradient)
        f = reshape(field(h%deformation)%values(:, p), [ndim, ndim])
        call invert(f, inverse, jacobian)
        gradient = matmul(transpose(inverse), gradient)
        do k = 1, forces%n_part
          if (forces%cell(k, p) == 0) cycle
          associate (n => field(h%normal)%values(:, p), node => forces%node(:, k, p), &
                     around => model%grid%cell_node(:, model%mesh%surface_cell(p)))
            matrix = 0.0_wp
            do j = 1, 2**ndim
              do i = 1, 2**ndim
                do b = 1, ndim
                  do a = 1, ndim
                    matrix(ndim*(i - 1) + a, half + ndim*(j - 1) + b) = &
                      load*forces%weight(i, k, p)*(n(a)*gradient(b, j) - gradient(a, j)*n(b))* &
                      self%length/self%force
                  end do
                end do
              end do
            end do
            call add_matrix(self%unknowns, [node, around], matrix, skeleton)
          end associate
        end do
      end do
    end associate
  end subroutine add_pressure_loads

  subroutine set_coordinates(self, model, err)
    !! Positions of the owned nodes for the rigid-body modes.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    type(error_t), intent(inout) :: err
    real(wp) :: coordinates(self%unknowns%n_u)
    integer :: k

    do k = 1, size(self%unknowns%own_node)
      coordinates(ndim*(k - 1) + 1:ndim*k) = &
        real(model%grid%node_index(:, self%unknowns%own_node(k)), wp)
    end do
    call self%system%set_coordinates(ndim, coordinates, err)
  end subroutine set_coordinates

  subroutine build_water(self, model, err)
    !! Entries of S and of -VL, and what the skeleton adds to the Schur complement.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    type(error_t), intent(inout) :: err
    type(entries_t) :: storage, coupling
    integer :: n_storage

    call add_storage(self, model, storage, coupling)
    if (model%nonlinear .or. model%water%switching) self%storage_place = &
      storage_places(self, storage)
    if (model%unsaturated) call add_capacity(self, model, storage, coupling)
    n_storage = storage%n
    call coupling%finish()
    self%coupling = coupling%value*(self%pressure/self%volume)
    if (model%unsaturated) then
      call add_relative_flow(self, model, storage)
    else
      call add_flow(self, model, storage)
    end if
    call storage%finish()
    self%storage = storage%value(1:n_storage)*(self%pressure/self%volume)
    self%flow = storage%value(n_storage + 1:)*(self%pressure/self%volume)
    call self%system%set_pattern(block_p, block_p, storage%row, storage%column, err)
  end subroutine build_water

  subroutine add_flow(self, model, storage)
    !! Entries of -VL after those of S.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: storage
    real(wp) :: weight, diagonal
    integer :: i, k

    associate (operator => model%water%head_operator, row => self%unknowns%particle_row)
      do i = 1, operator%n_row
        weight = model%mesh%water_weight(i)/model%scene%water%unit_weight
        diagonal = 0.0_wp
        do k = operator%row_start(i), operator%row_start(i + 1) - 1
          diagonal = diagonal + operator%coefficient(k)
          call storage%add(row(i), row(operator%column(k)), -weight*operator%coefficient(k))
        end do
        do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
          if (operator%boundary_is_head(k)) diagonal = diagonal + operator%boundary_weight(k)
        end do
        call storage%add(row(i), row(i), weight*diagonal)
      end do
    end associate
  end subroutine add_flow

  subroutine add_relative_flow(self, model, storage)
    !! As `add_flow`, with the derivatives of relative conductivities, at the pressures at hand.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    type(entries_t), intent(inout) :: storage
    real(wp), allocatable :: slope(:), entry(:), diagonal(:)
    integer :: i, k, n

    n = model%particles%count
    associate (operator => model%water%head_operator, row => self%unknowns%particle_row)
      allocate (slope(size(model%water%head)), source=0.0_wp)
      allocate (entry(size(operator%coefficient)), diagonal(operator%n_row))
      do i = 1, n
        slope(i) = model%water%retention(model%material(i))%conductivity_slope( &
                   model%particles%field(model%p%pore_pressure)%values(1, i))
      end do
      call model%water%particle_map%gather(model%comm, 1, slope)
      call operator%linearise(model%water%head, model%water%hydraulic_conditions%datum, &
                              model%water%relative, slope, &
                              model%water%point_relative, model%scene%water%unit_weight, entry, &
                              diagonal)
      do i = 1, operator%n_row
        do k = operator%row_start(i), operator%row_start(i + 1) - 1
          call storage%add(row(i), row(operator%column(k)), -model%mesh%water_weight(i)*entry(k))
        end do
        call storage%add(row(i), row(i), -model%mesh%water_weight(i)*diagonal(i))
      end do
    end associate
  end subroutine add_relative_flow

  function storage_places(self, storage) result(place)
    !! Owned particles of the entries of S, by which it can be applied without the linear solver.
    class(implicit_system_t), intent(in) :: self
    type(entries_t), intent(in) :: storage
    integer, allocatable :: place(:, :)
    integer :: k, first

    allocate (place(2, storage%n))
    if (storage%n == 0) return
    first = minval(self%unknowns%particle_row(1:self%unknowns%n_p))
    do k = 1, storage%n
      place(:, k) = [storage%row(k), storage%column(k)] - first + 1
    end do
  end function storage_places

  subroutine add_capacity(self, model, storage, coupling)
    !! What the present pressures add to the compressibility that S was made with.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: storage, coupling
    real(wp), allocatable :: added(:)
    integer :: p, n

    n = model%particles%count
    added = compressibility_at(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n)) &
            - model%water%storage%compressibility
    do p = 1, n
      call storage%add(self%unknowns%particle_row(p), self%unknowns%particle_row(p), &
                       model%mesh%water_weight(p)*added(p))
      call coupling%add(self%unknowns%particle_row(p), self%unknowns%particle_row(p), 0.0_wp)
    end do
  end subroutine add_capacity

  subroutine add_storage(self, model, storage, coupling)
    !! Entries of S, block by block: the inverse of `storage_t%pressure_rate`. `coupling` has the
    !! same places: 1/(2-D: lambda + G, the stiffness against a change of volume) times P.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(in) :: model
    type(entries_t), intent(inout) :: storage, coupling
    integer, allocatable :: start(:), particle(:), block_of(:)
    real(wp), allocatable :: cell_weight(:), block_weight(:)
    real(wp) :: value, stiff, softness
    integer :: n, b, c, i, j, p, q

    n = model%particles%count
    associate (row => self%unknowns%particle_row, w => model%mesh%water_weight)
      if (.not. model%water%storage%projected) then
        do p = 1, n
          call storage%add(row(p), row(p), w(p)*model%water%storage%compressibility(p))
          softness = 0.0_wp
          if (.not. model%rigid) softness = w(p)/volume_modulus(model, p)
          call coupling%add(row(p), row(p), softness)
        end do
        return
      end if
      allocate (block_of(n), cell_weight(model%grid%n_cell), block_weight(model%grid%n_block))
      cell_weight = 0.0_wp
      block_weight = 0.0_wp
      do p = 1, n
        c = group_of(p)
        block_of(p) = model%grid%cell_block(c)
        cell_weight(c) = cell_weight(c) + w(p)
        block_weight(block_of(p)) = block_weight(block_of(p)) + w(p)
      end do
      call cell_lists(n, block_of, model%grid%n_block, start, particle)
      do b = 1, model%grid%n_block
        do j = start(b), start(b + 1) - 1
          q = particle(j)
          do i = start(b), start(b + 1) - 1
            p = particle(i)
            c = group_of(p)
            value = w(q)/block_weight(b)*(1.0_wp/model%water%storage%of_block(b) - &
                                          1.0_wp/model%water%storage%in_block(b))
            softness = 0.0_wp
            if (group_of(q) == c) then
              stiff = 1.0_wp/model%water%storage%in_cell(c)
              value = value + w(q)/cell_weight(c)*(1.0_wp/model%water%storage%in_block(b) - stiff)
              if (p == q) value = value + stiff
              softness = w(q)/cell_weight(c)/volume_modulus(model, p)
            end if
            call storage%add(row(p), row(q), w(p)*value)
            call coupling%add(row(p), row(q), w(p)*softness)
          end do
        end do
      end do
    end associate

  contains

    pure integer function group_of(k)
      !! Cell that stands for those that share a particle's mean pressure.
      integer, intent(in) :: k

      group_of = model%mesh%cell(k)
      if (model%skeleton%centred) group_of = model%mesh%quadrature%group(group_of)
    end function group_of
  end subroutine add_storage

  pure real(wp) function volume_modulus(model, p) result(modulus)
    !! Stiffness of the skeleton against a change of volume in the scene's directions [Pa]: M in
    !! 1-D, lambda + G in 2-D, K in 3-D.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    real(wp) :: bulk, shear

    call find_moduli_of(model, p, bulk, shear)
    modulus = bulk + shear*(2.0_wp/real(ndim, wp) - 2.0_wp/3.0_wp)
  end function volume_modulus

  subroutine set_flow(self, weight, err)
    !! Puts the weight of the flow at the new time into the equations.
    class(implicit_system_t), intent(inout) :: self
    real(wp), intent(in) :: weight   !! a [s]
    type(error_t), intent(inout) :: err

    if (.not. abs(weight - self%flow_weight) > 0.0_wp) return
    call self%system%set_values(block_p, block_p, [self%storage, weight*self%flow], err)
    if (err%failed()) return
    call self%system%set_schur([self%storage + self%coupling, weight*self%flow], err)
    self%flow_weight = weight
  end subroutine set_flow

  subroutine implicit_internal_forces(self, model, pressure, force)
    !! Adds the nodal forces of effective stresses and pressures of finite strains to complete
    !! forces; the derivative of these is the system's. Collective.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)        !! that the skeleton feels at particles [Pa]
    real(wp), intent(inout) :: force(:, :)     !! (ndim, n_node) [N]
    type(cell_operators_t) :: operators
    integer, allocatable :: start(:), particle(:)
    type(means_t) :: means
    real(wp), allocatable :: internal(:, :), cell_force(:)
    integer :: c, p, k, i

    allocate (internal(ndim, model%grid%n_node), source=0.0_wp)
    call cell_lists(model%particles%count, model%mesh%cell, model%grid%n_cell, start, particle)
    call mean_operators(model, means)
    do c = 1, model%grid%n_cell
      if (start(c + 1) == start(c)) cycle
      call operators_of_cell(model, c, particle(start(c):start(c + 1) - 1), means, operators)
      do p = 1, size(operators%strain, 3)
        k = particle(start(c) + p - 1)
        cell_force = -model%mesh%weight(k)* &
                     matmul(model%particles%field(model%p%effective_stress)%values(:, k), &
                            operators%strain(:, :, p))
        if (self%unknowns%n_p > 0) then
          cell_force = cell_force + model%mesh%weight(k)*pressure(k)*operators%volume(:, p)
        end if
        do i = 1, operators%n_node
          internal(:, operators%node(i)) = internal(:, operators%node(i)) + &
                                           cell_force(ndim*(i - 1) + 1:ndim*i)
        end do
      end do
    end do
    call model%grid%node_map%sum_copies(model%comm, ndim, internal)
    force = force + internal
  end subroutine implicit_internal_forces

  subroutine implicit_turn_safe(self, model, turned, what)
    !! After a solution that failed: the next `build` factorises, if the iterations were to blame,
    !! the scene leaves the choice and the system is not too large.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    logical, intent(out) :: turned
    character(len=:), allocatable, intent(out) :: what   !! is done from now on

    turned = .false.
    what = 'direct solutions'
    if (self%system%is_direct .or. .not. self%system%has_failed) return
    turned = model%scene%solver%linear == 'auto' .and. &
             sum(self%system%n_all) <= last_resort*direct_limit(ndim)
    self%insists_on_direct = turned
  end subroutine implicit_turn_safe

  pure function implicit_memory(self) result(values)
    !! What solutions follow from beside the model: iterations know their error from the first
    !! solution after the last set-up, which need not be that of a restart.
    class(implicit_system_t), intent(in) :: self
    real(wp) :: values(n_system_memory)   !! [several units]

    values = [merge(1.0_wp, 0.0_wp, self%insists_on_direct), self%flow_weight, &
              self%system%amplification]
  end function implicit_memory

  subroutine implicit_recall(self, model, values, err)
    !! Brings a system that has just been built to where a checkpoint left its own. Collective.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: values(n_system_memory)   !! as from `memory` [several units]
    type(error_t), intent(inout) :: err

    self%insists_on_direct = values(1) > 0.5_wp .and. model%scene%solver%linear == 'auto'
    if (self%insists_on_direct) call self%build(model, self%is_dynamic, err)
    if (self%system%is_direct .or. err%failed()) return
    if (values(2) < 0.0_wp) return
    if (model%coupled) call self%set_flow(values(2), err)
    if (.not. err%failed()) call self%system%prepare(err)
    self%system%amplification = values(3)
  end subroutine implicit_recall

  subroutine implicit_stored(self, model, flow_weight, pressure, stored, err)
    !! S V p - a V L p: what increments of pressure store and let out. Collective.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: flow_weight      !! a [s]
    real(wp), intent(in) :: pressure(:)      !! of the particles [Pa]
    real(wp), intent(inout) :: stored(:)     !! [m3]
    type(error_t), intent(inout) :: err
    real(wp), allocatable :: x(:), y(:)
    integer :: n_u, n_p

    n_u = self%unknowns%n_u
    n_p = self%unknowns%n_p
    allocate (x(n_u + n_p), y(n_u + n_p), source=0.0_wp)
    if (.not. model%coupled) return
    x(n_u + 1:) = pressure(1:n_p)/self%pressure
    call self%set_flow(flow_weight, err)
    call self%system%prepare(err)
    if (.not. err%failed()) call self%system%multiply(x, y, err)
    stored(1:n_p) = y(n_u + 1:)*self%volume
  end subroutine implicit_stored

  subroutine implicit_stored_by_projection(self, pressure, stored)
    !! S V p of increments of pressure, S as `build` found it, without what suction adds.
    class(implicit_system_t), intent(in) :: self
    real(wp), intent(in) :: pressure(:)     !! of owned particles [Pa]
    real(wp), intent(out) :: stored(:)      !! [m3]
    integer :: k

    stored = 0.0_wp
    do k = 1, size(self%storage_place, 2)
      associate (i => self%storage_place(1, k), j => self%storage_place(2, k))
        stored(i) = stored(i) + self%storage(k)*(self%volume/self%pressure)*pressure(j)
      end associate
    end do
  end subroutine implicit_stored_by_projection

  subroutine implicit_solve(self, model, flow_weight, force, time, prescribed, has_prescribed, &
                            supply, tolerance, is_guess, motion, pressure, err, without_loads)
    !! Solves for nodal displacements and pressures of particles. Collective.
    class(implicit_system_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: flow_weight          !! a [s]
    real(wp), intent(in) :: force(:, :)          !! (ndim, n_node) complete nodal forces [N]
    real(wp), intent(in) :: time                 !! of the plates' loads [s]
    real(wp), intent(in) :: prescribed(:, :)     !! (ndim, n_node) motion of held nodes [m]
    logical, intent(in) :: has_prescribed
    real(wp), intent(in) :: supply(:)            !! r of each particle [m3]
    real(wp), intent(in) :: tolerance            !! of the linear solution, relative [-]
    logical, intent(in) :: is_guess              !! motion and pressure come with a first guess
    real(wp), intent(inout) :: motion(:, :)      !! (ndim, n_node) [m]
    real(wp), intent(inout) :: pressure(:)       !! of particles [Pa]
    type(error_t), intent(inout) :: err
    logical, intent(in), optional :: without_loads   !! plates carry none
    real(wp), allocatable :: right(:), left(:), load(:, :), water(:)
    integer :: n_u, n_p

    n_u = self%unknowns%n_u
    n_p = self%unknowns%n_p
    if (model%coupled) call self%set_flow(flow_weight, err)
    if (err%failed()) return
    allocate (right(n_u + n_p), left(n_u + n_p), source=0.0_wp)
    water = supply(1:n_p)
    if (.not. model%rigid) then
      load = force
      if (has_prescribed) call self%subtract_held(model, prescribed, load, water)
      call self%unknowns%to_rows(model, load, time, right(1:n_u), without_loads)
      right(1:n_u) = right(1:n_u)/self%force
    end if
    right(n_u + 1:) = water/self%volume
    if (is_guess) then
      if (.not. model%rigid) then
        call self%unknowns%to_unknowns(motion, left(1:n_u))
        left(1:n_u) = left(1:n_u)/self%length
      end if
      left(n_u + 1:) = pressure(1:n_p)/self%pressure
    end if
    call self%system%solve(right, left, tolerance, is_guess, err)
    if (err%failed()) return
    motion = prescribed
    if (.not. model%rigid) call self%unknowns%to_nodes(model, left(1:n_u)*self%length, motion)
    if (model%coupled) pressure(1:n_p) = left(n_u + 1:)*self%pressure
  end subroutine implicit_solve

  subroutine subtract_held(self, model, prescribed, load, water)
    !! Forces and volume changes of prescribed motion go to the right-hand side. Collective.
    class(implicit_system_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: prescribed(:, :)      !! (ndim, n_node) [m]
    real(wp), intent(inout) :: load(:, :), water(:)
    real(wp), allocatable :: reaction(:, :), change(:)
    integer :: k, row, column

    allocate (reaction(ndim, model%grid%n_node), source=0.0_wp)
    do k = 1, self%held%n
      row = self%held%row(k) - 1
      column = self%held%column(k) - 1
      reaction(mod(row, ndim) + 1, row/ndim + 1) = &
        reaction(mod(row, ndim) + 1, row/ndim + 1) + &
        self%held%value(k)*prescribed(mod(column, ndim) + 1, column/ndim + 1)
    end do
    call model%grid%node_map%sum_copies(model%comm, ndim, reaction)
    load = load - reaction
    allocate (change(size(water)))
    call self%volume_change(prescribed, change)
    water = water - change
  end subroutine subtract_held
end module dosui_implicit_system

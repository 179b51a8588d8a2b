!! Volume-weighted averages of particle values over grid cells and over blocks of 2**ndim cells.
!!
!! The average P is self-adjoint in the weights: sum w a (P b) = sum w (P a) b. Kernels sum over
!! this rank's particles, `cell_average_t` completes the sums of cells that ranks share.
!! Without shared cells no message is sent.
!!
!! Cells may form groups, named by their first cell, whose members take one mean together.
module dosui_cell_average
  use dosui_kinds, only: wp
  use dosui_dimension, only: n_volume, ndim, nsig, volume_slot
  use dosui_communicator, only: communicator_t
  use dosui_grid, only: grid_t
  implicit none
  private

  public :: cell_sums, cell_tensor_sums, cell_trace_sums, block_sums

  type, public :: cell_average_t
    !! Weights of cells and blocks, complete over all ranks.
    real(wp), allocatable :: cell_weight(:)      !! (n_cell) this rank's share of the weight [m3]
    real(wp), allocatable :: cell_inverse(:)     !! (n_cell) 1/complete weight, 0 if empty [1/m3]
    real(wp), allocatable :: block_inverse(:)    !! (n_block) 1/complete weight, 0 if empty [1/m3]
    integer, allocatable :: group(:)             !! (n_cell) first cell of the group, if there are
    real(wp), allocatable :: group_inverse(:)    !! (n_cell) 1/complete weight of that group [1/m3]
  contains
    procedure :: set_weights => cell_average_set_weights
    procedure :: cell_means => cell_average_cell_means
    procedure :: group_means => cell_average_group_means
    procedure :: group_sums => cell_average_group_sums
    procedure :: block_means => cell_average_block_means
  end type cell_average_t

contains

  pure subroutine cell_sums(n, cell, weight, value, n_cell, sums)
    !! Kernel: sums of weight*value over the particles of each cell.
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: weight(n), value(n)   !! volumes, say [m3], and values [any unit]
    integer, intent(in) :: n_cell
    real(wp), intent(out) :: sums(n_cell)   !! [unit of weight times value]
    integer :: p, here
    real(wp) :: total

    sums = 0.0_wp
    if (n == 0) return
    here = cell(1)
    total = 0.0_wp
    do p = 1, n   ! a run of particles in one cell is summed in a register
      if (cell(p) /= here) then
        sums(here) = sums(here) + total
        here = cell(p)
        total = 0.0_wp
      end if
      total = total + weight(p)*value(p)
    end do
    sums(here) = sums(here) + total
  end subroutine cell_sums

  pure subroutine cell_trace_sums(n, cell, weight, tensor, n_cell, sums)
    !! Kernel: sums of weight*trace over the particles of each cell; the trace is taken over the
    !! directions of the scene (volume change of strains; ndim times the mean in-plane stress).
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: weight(n)   !! volumes, say [m3]
    real(wp), intent(in) :: tensor(nsig, n)   !! strains [-] or stresses [Pa]
    integer, intent(in) :: n_cell
    real(wp), intent(out) :: sums(n_cell)   !! [unit of weight times tensor]
    integer :: p, here, d
    real(wp) :: total, trace

    sums = 0.0_wp
    if (n == 0) return
    here = cell(1)
    total = 0.0_wp
    do p = 1, n
      if (cell(p) /= here) then
        sums(here) = sums(here) + total
        here = cell(p)
        total = 0.0_wp
      end if
      trace = 0.0_wp
      do d = 1, n_volume
        trace = trace + tensor(volume_slot(d), p)
      end do
      total = total + weight(p)*trace
    end do
    sums(here) = sums(here) + total
  end subroutine cell_trace_sums

  pure subroutine cell_tensor_sums(n, cell, weight, tensor, n_cell, sums)
    !! Kernel: sums of weight*tensor over the particles of each cell.
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: weight(n)   !! volumes, say [m3]
    real(wp), intent(in) :: tensor(nsig, n)   !! strains [-] or stresses [Pa]
    integer, intent(in) :: n_cell
    real(wp), intent(out) :: sums(nsig, n_cell)   !! [unit of weight times tensor]
    integer :: p, here
    real(wp) :: total(nsig)

    sums = 0.0_wp
    if (n == 0) return
    here = cell(1)
    total = 0.0_wp
    do p = 1, n   ! a run of particles in one cell is summed in registers
      if (cell(p) /= here) then
        sums(:, here) = sums(:, here) + total
        here = cell(p)
        total = 0.0_wp
      end if
      total = total + weight(p)*tensor(:, p)
    end do
    sums(:, here) = sums(:, here) + total
  end subroutine cell_tensor_sums

  pure subroutine block_sums(width, n_cell, cell_block, cell_value, n_block, sums)
    !! Kernel: sums of cell values over the blocks.
    integer, intent(in) :: width, n_cell
    integer, intent(in) :: cell_block(n_cell)
    real(wp), intent(in) :: cell_value(width, n_cell)   !! [any unit]
    integer, intent(in) :: n_block
    real(wp), intent(out) :: sums(width, n_block)   !! [unit of the cell values]
    integer :: c

    sums = 0.0_wp
    do c = 1, n_cell
      sums(:, cell_block(c)) = sums(:, cell_block(c)) + cell_value(:, c)
    end do
  end subroutine block_sums

  subroutine complete_cells(comm, grid, width, sums)
    !! Adds up the ranks' sums of shared cells.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width
    real(wp), intent(inout) :: sums(width, grid%n_cell)

    call grid%cell_map%sum_copies(comm, width, sums)
  end subroutine complete_cells

  subroutine complete_blocks(comm, grid, width, cell_value, sums)
    !! Sums of the ranks' cell values over blocks, shared ones added up.
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width
    real(wp), intent(in) :: cell_value(width, grid%n_cell)    !! this rank's share
    real(wp), intent(out) :: sums(width, grid%n_block)

    call block_sums(width, grid%n_cell, grid%cell_block, cell_value, grid%n_block, sums)
    call grid%block_map%sum_copies(comm, width, sums)
  end subroutine complete_blocks

  subroutine cell_average_set_weights(self, comm, grid, n, cell, weight, group)
    !! Takes over the particles' weights (volumes). All ranks call it together.
    class(cell_average_t), intent(inout) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    real(wp), intent(in) :: weight(n)   !! [m3]
    integer, intent(in), optional :: group(:)   !! (n_cell) first cells of the groups
    real(wp), allocatable :: one(:)

    if (allocated(self%cell_weight)) then
      deallocate (self%cell_weight, self%cell_inverse, self%block_inverse)
    end if
    allocate (self%cell_weight(grid%n_cell), self%cell_inverse(grid%n_cell), &
              self%block_inverse(grid%n_block))
    allocate (one(n), source=1.0_wp)
    call cell_sums(n, cell, weight, one, grid%n_cell, self%cell_weight)
    call complete_blocks(comm, grid, 1, self%cell_weight, self%block_inverse)
    self%cell_inverse = self%cell_weight
    call complete_cells(comm, grid, 1, self%cell_inverse)
    call invert_positive(grid%n_cell, self%cell_inverse)
    call invert_positive(grid%n_block, self%block_inverse)
    if (allocated(self%group)) deallocate (self%group, self%group_inverse)
    if (.not. present(group)) return
    self%group = group
    self%group_inverse = self%cell_weight
    call self%group_sums(comm, grid, 1, self%group_inverse)
    call invert_positive(grid%n_cell, self%group_inverse)
  end subroutine cell_average_set_weights

  pure subroutine invert_positive(n, values)
    integer, intent(in) :: n
    real(wp), intent(inout) :: values(n)
    integer :: k

    do k = 1, n
      if (values(k) > 0.0_wp) then
        values(k) = 1.0_wp/values(k)
      else
        values(k) = 0.0_wp
      end if
    end do
  end subroutine invert_positive

  subroutine cell_average_cell_means(self, comm, grid, width, sums)
    !! Turns this rank's sums of weight*value into the cells' means over all ranks.
    class(cell_average_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width                              !! values per cell
    real(wp), intent(inout) :: sums(width, grid%n_cell)
    !! sums [unit of weight times value] on entry, means [unit of value] on return
    integer :: c

    call complete_cells(comm, grid, width, sums)
    do c = 1, grid%n_cell
      sums(:, c) = sums(:, c)*self%cell_inverse(c)
    end do
  end subroutine cell_average_cell_means

  subroutine cell_average_group_sums(self, comm, grid, width, sums)
    !! Turns this rank's sums over cells into those of their groups over all ranks. Without groups
    !! cells are by themselves.
    class(cell_average_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width                              !! values per cell
    real(wp), intent(inout) :: sums(width, grid%n_cell)   !! [unit of weight times value]
    integer :: c

    if (allocated(self%group)) then
      do c = 1, grid%n_cell
        if (self%group(c) == c) cycle
        sums(:, self%group(c)) = sums(:, self%group(c)) + sums(:, c)
      end do
    end if
    call complete_cells(comm, grid, width, sums)
    if (allocated(self%group)) sums = sums(:, self%group)
  end subroutine cell_average_group_sums

  subroutine cell_average_group_means(self, comm, grid, width, sums)
    !! Turns this rank's sums of weight*value over cells into the means of their groups over all
    !! ranks, or of cells without groups.
    class(cell_average_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width                              !! values per cell
    real(wp), intent(inout) :: sums(width, grid%n_cell)
    !! sums [unit of weight times value] on entry, means [unit of value] on return
    integer :: c

    if (.not. allocated(self%group)) then
      call self%cell_means(comm, grid, width, sums)
      return
    end if
    call self%group_sums(comm, grid, width, sums)
    do c = 1, grid%n_cell
      sums(:, c) = sums(:, c)*self%group_inverse(c)
    end do
  end subroutine cell_average_group_means

  subroutine cell_average_block_means(self, comm, grid, width, sums, means)
    !! The blocks' means over all ranks from this rank's sums of weight*value over cells (before
    !! `cell_means` has changed them).
    class(cell_average_t), intent(in) :: self
    type(communicator_t), intent(in) :: comm
    type(grid_t), intent(inout) :: grid
    integer, intent(in) :: width
    real(wp), intent(in) :: sums(width, grid%n_cell)   !! [unit of weight times value]
    real(wp), intent(out) :: means(width, grid%n_block)   !! [unit of value]
    integer :: b

    call complete_blocks(comm, grid, width, sums, means)
    do b = 1, grid%n_block
      means(:, b) = means(:, b)*self%block_inverse(b)
    end do
  end subroutine cell_average_block_means
end module dosui_cell_average

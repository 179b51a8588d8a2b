!! Storage of pore water with pressure projection, acting on increments:
!! S = n/K_w + (tau_i/M) (I - P) + (tau_m/M) (P - P_2), P the average over a cell and P_2 over a
!! block of 2**ndim cells (after [Dohrmann2004]). It leaves steady states untouched and
!! takes out the pressures that the grid's volume change cannot balance.
!!
!! P and P_2 are nested orthogonal projections, so S is inverted part by part.
module dosui_storage
  use dosui_kinds, only: wp
  implicit none
  private

  type, public :: storage_t
    logical :: projected = .false.             !! cells and blocks are in use
    real(wp), allocatable :: compressibility(:)   !! n/K_w of each particle [1/Pa]
    real(wp), allocatable :: in_cell(:)        !! (n_cell) 1/(n/K_w + tau_i/M) [Pa]
    real(wp), allocatable :: in_block(:)       !! (n_block) 1/(n/K_w + tau_m/M) [Pa]
    real(wp), allocatable :: of_block(:)       !! (n_block) 1/(n/K_w) [Pa]
  contains
    procedure :: init => storage_init
    procedure :: pressure_rate => storage_pressure_rate
  end type storage_t

contains

  subroutine storage_init(self, cell_storage, block_storage, compressibility, &
                          cell_compressibility, cell_softness, block_compressibility, &
                          block_softness)
    !! Takes the means of n/K_w and of 1/M over cells and blocks (0 in empty ones).
    class(storage_t), intent(inout) :: self
    real(wp), intent(in) :: cell_storage, block_storage           !! tau_i, tau_m [-]
    real(wp), intent(in) :: compressibility(:)                    !! of particles [1/Pa]
    real(wp), intent(in) :: cell_compressibility(:), cell_softness(:)     !! [1/Pa]
    real(wp), intent(in) :: block_compressibility(:), block_softness(:)   !! [1/Pa]

    self%projected = cell_storage > 0.0_wp .or. block_storage > 0.0_wp
    self%compressibility = compressibility
    self%in_cell = inverse(cell_compressibility + cell_storage*cell_softness)
    self%in_block = inverse(block_compressibility + block_storage*block_softness)
    self%of_block = inverse(block_compressibility)
  end subroutine storage_init

  elemental real(wp) function inverse(value)
    !! 1/value, 0 for empty cells.
    real(wp), intent(in) :: value

    inverse = 0.0_wp
    if (value > 0.0_wp) inverse = 1.0_wp/value
  end function inverse

  pure subroutine storage_pressure_rate(self, n, cell, cell_block, cell_mean, block_mean, rate)
    !! Kernel: turns rates of water content [1/s] into rates of pressure [Pa/s], in place.
    class(storage_t), intent(in) :: self
    integer, intent(in) :: n
    integer, intent(in) :: cell(n)
    integer, intent(in) :: cell_block(:)
    real(wp), intent(in) :: cell_mean(:)    !! P rate [1/s]
    real(wp), intent(in) :: block_mean(:)   !! P_2 rate [1/s]
    real(wp), intent(inout) :: rate(n)
    !! of water content [1/s] on entry, of pressure [Pa/s] on return
    integer :: p, c, b, here
    real(wp) :: smooth, fine

    here = 0
    fine = 0.0_wp
    smooth = 0.0_wp
    do p = 1, n
      c = cell(p)
      if (c /= here) then
        b = cell_block(c)
        here = c
        fine = self%in_cell(c)
        smooth = (cell_mean(c) - block_mean(b))*self%in_block(b) + &
                 block_mean(b)*self%of_block(b) - cell_mean(c)*fine
      end if
      rate(p) = rate(p)*fine + smooth
    end do
  end subroutine storage_pressure_rate
end module dosui_storage

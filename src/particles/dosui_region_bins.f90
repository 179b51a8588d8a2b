!! Which regions may hold a place: bins over the bounds of all regions, so that a search does not
!! grow with their number.
module dosui_region_bins
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_scene, only: region_t
  use dosui_shapes, only: region_bounds
  implicit none
  private

  integer, parameter :: entries_per_region = 8   ! at most, on average: large regions fill many bins

  type, public :: region_bins_t
    private
    integer :: n(ndim) = 1                      ! of bins in each direction
    real(wp) :: low(ndim) = 0.0_wp              ! corner of the first bin [m]
    real(wp) :: width(ndim) = 1.0_wp            ! of a bin [m]
    integer, allocatable :: first(:), item(:)   ! regions of each bin, in their order
  contains
    procedure :: init => region_bins_init
    procedure :: near => region_bins_near
  end type region_bins_t

contains

  subroutine region_bins_init(self, regions, reach)
    !! Sorts regions into bins. They are found from places that lie outside their bounds, too, but
    !! not farther away than the reach.
    class(region_bins_t), intent(inout) :: self
    type(region_t), intent(in) :: regions(:)
    real(wp), intent(in) :: reach   !! not negative [m]
    real(wp) :: low(ndim, size(regions)), high(ndim, size(regions)), extent(ndim)
    integer :: r

    do r = 1, size(regions)
      call region_bounds(regions(r), low(:, r), high(:, r))
    end do
    low = low - reach
    high = high + reach
    extent = 0.0_wp
    if (size(regions) > 0) then
      self%low = minval(low, dim=2)
      extent = maxval(high, dim=2) - self%low
    end if
    self%n = max(1, nint(real(size(regions), wp)**(1.0_wp/ndim)))
    do
      self%width = max(extent/real(self%n, wp), tiny(1.0_wp))
      if (all(self%n == 1)) exit
      if (n_entry() <= entries_per_region*size(regions)) exit
      self%n = max(1, self%n/2)
    end do
    call fill(self, low, high)

  contains

    pure integer function n_entry() result(n)
      !! How many bins all regions lie in together; more than enough is not counted.
      integer :: s

      n = 0
      do s = 1, size(regions)
        n = n + product(step_of(self, high(:, s)) - step_of(self, low(:, s)) + 1)
        if (n > entries_per_region*size(regions)) return
      end do
    end function n_entry
  end subroutine region_bins_init

  pure subroutine fill(self, low, high)
    !! Lists the regions of each bin.
    class(region_bins_t), intent(inout) :: self
    real(wp), intent(in) :: low(:, :), high(:, :)   ! bounds of the regions (ndim, n) [m]
    integer :: next(product(self%n)), from(ndim), steps(ndim), b, k, r, round

    next = 0
    if (allocated(self%first)) deallocate (self%first, self%item)
    allocate (self%first(product(self%n) + 1))
    do round = 1, 2   ! counts, then writes
      do r = 1, size(low, 2)
        from = step_of(self, low(:, r))
        steps = step_of(self, high(:, r)) - from + 1
        do k = 0, product(steps) - 1
          b = bin_at(self, from + offset_of(k, steps))
          if (round == 2) self%item(next(b)) = r
          next(b) = next(b) + 1
        end do
      end do
      if (round == 2) exit
      self%first(1) = 1
      do b = 1, size(next)
        self%first(b + 1) = self%first(b) + next(b)
      end do
      next = self%first(:size(next))
      allocate (self%item(self%first(size(next) + 1) - 1))
    end do
  end subroutine fill

  pure function region_bins_near(self, place) result(regions)
    !! Indices, increasing, of all regions that may hold a place or lie within reach of it; some of
    !! them do not.
    class(region_bins_t), intent(in) :: self
    real(wp), intent(in) :: place(ndim)   !! [m]
    integer, allocatable :: regions(:)
    integer :: b

    b = bin_at(self, step_of(self, place))
    regions = self%item(self%first(b):self%first(b + 1) - 1)
  end function region_bins_near

  pure function step_of(self, place) result(step)
    !! Bins from the first one in each direction; places beyond all bins count to the outermost.
    class(region_bins_t), intent(in) :: self
    real(wp), intent(in) :: place(ndim)   ! [m]
    integer :: step(ndim)

    step = int(max(0.0_wp, min(real(self%n - 1, wp), (place - self%low)/self%width)))
  end function step_of

  pure integer function bin_at(self, step) result(bin)
    !! Number of a bin from its steps.
    class(region_bins_t), intent(in) :: self
    integer, intent(in) :: step(ndim)
    integer :: d

    bin = 0
    do d = ndim, 1, -1
      bin = bin*self%n(d) + step(d)
    end do
    bin = bin + 1
  end function bin_at

  pure function offset_of(k, steps) result(offset)
    !! The k-th of the bins of a box of bins, from its first.
    integer, intent(in) :: k            ! from 0
    integer, intent(in) :: steps(ndim)  ! bins along its sides
    integer :: offset(ndim), rest, d

    rest = k
    do d = 1, ndim
      offset(d) = mod(rest, steps(d))
      rest = rest/steps(d)
    end do
  end function offset_of
end module dosui_region_bins

!! Shape functions of the background grid: linear hats, GIMP and quadratic B-splines.
!!
!! A particle touches a patch of `width` nodes per direction, counted from its base node. The
!! local coordinate xi = x/h - base is measured from that node: xi in [0, 1) for linear hats,
!! [1/2, 3/2) for the others. Derivatives are taken with respect to xi (divide by h for 1/m).
!!
!! Where a body ends, wide functions reach nodes beyond its surface that little mass and no
!! condition holds. Patches with empty cells on one side are therefore folded there: the outer
!! node follows the two others, v_0 = 2 v_1 - v_2, so that linear fields are kept and the field
!! on a surface through node 1 is that node's value (cf. [Steffen2008] on end functions).
module dosui_shape_functions
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  implicit none
  private

  public :: corner_hats, shape_kind_of, shape_width, shape_shift, shape_weights
  public :: group_count, patch_offsets, patch_weights

  integer, parameter, public :: shape_linear = 1    !! hats
  integer, parameter, public :: shape_gimp = 2      !! hats averaged over the particle's domain
  integer, parameter, public :: shape_bspline = 3   !! quadratic B-splines

  ! Kernels take the nodes of a patch in groups of n_group, a length known to the compiler that
  ! fits vector registers. Hats fill one group; wide patches (3**ndim nodes) are padded with zeros.
  integer, parameter, public :: n_group = 2**ndim
  integer, parameter, public :: n_group_wide = ceiling(1.5_wp**ndim)
  integer, parameter :: n_wide = 3**ndim, n_padded = n_group*n_group_wide

  integer :: i, j, k   ! of the tables below
  integer, parameter :: corner(n_group, ndim) = &
                        reshape([((ibits(i, j, 1), i=0, n_group - 1), j=0, ndim - 1)], &
                                [n_group, ndim])
  integer, parameter :: base_three(27, 3) = reshape([((i, i=0, 2), j=1, 9), &
                                                     (((i, k=1, 3), i=0, 2), j=1, 3), &
                                                     ((i, k=1, 9), i=0, 2)], [27, 3])
  integer, parameter :: wide(n_wide, ndim) = base_three(1:n_wide, 1:ndim)

contains

  pure function corner_hats(local) result(weight)
    !! Hats of a cell's corners, x fastest [-].
    real(wp), intent(in) :: local(ndim)   !! coordinates in the cell, 0 to 1 [-]
    real(wp) :: weight(2**ndim)
    integer :: corner, d

    do corner = 1, 2**ndim
      weight(corner) = 1.0_wp
      do d = 1, ndim
        weight(corner) = weight(corner)*merge(local(d), 1.0_wp - local(d), btest(corner - 1, d - 1))
      end do
    end do
  end function corner_hats

  pure integer function shape_kind_of(name) result(kind)
    !! Kind of the shape functions with this name in a scene, 0 for an unknown name.
    character(len=*), intent(in) :: name   !! 'linear', 'gimp', 'cpgimp' or 'bspline'

    select case (name)
    case ('linear')
      kind = shape_linear
    case ('gimp', 'cpgimp')   ! the latter with domains that follow the deformation
      kind = shape_gimp
    case ('bspline')
      kind = shape_bspline
    case default
      kind = 0
    end select
  end function shape_kind_of

  pure integer function shape_width(kind) result(width)
    !! Nodes that a particle touches in each direction.
    integer, intent(in) :: kind

    width = merge(2, 3, kind == shape_linear)
  end function shape_width

  pure real(wp) function shape_shift(kind) result(shift)
    !! The base node of a particle at x is floor(x/h - shift) [-].
    integer, intent(in) :: kind

    shift = merge(0.0_wp, 0.5_wp, kind == shape_linear)
  end function shape_shift

  pure subroutine shape_weights(kind, half_domain, xi, weight, slope)
    !! Weights and derivatives in one direction; linear hats leave the third entry 0.
    integer, intent(in) :: kind
    real(wp), intent(in) :: half_domain      !! GIMP: half the particle's side over h, (0, 1/2] [-]
    real(wp), intent(in) :: xi               !! local coordinate from the base node [-]
    real(wp), intent(out) :: weight(0:2)     !! sum 1 [-]
    real(wp), intent(out) :: slope(0:2)      !! d weight / d xi, sum 0 [-]

    select case (kind)
    case (shape_linear)
      weight = [1.0_wp - xi, xi, 0.0_wp]
      slope = [-1.0_wp, 1.0_wp, 0.0_wp]
    case (shape_gimp)
      call gimp_weights(half_domain, xi, weight, slope)
    case default
      call bspline_weights(xi, weight, slope)
    end select
  end subroutine shape_weights

  pure subroutine gimp_weights(half_domain, xi, weight, slope)
    !! Hats averaged over [xi - l, xi + l] [Bardenhagen2004]. With N the hat and H its
    !! integral: weight = (H(d + l) - H(d - l))/(2 l), slope = (N(d + l) - N(d - l))/(2 l).
    real(wp), intent(in) :: half_domain   !! l [-]
    real(wp), intent(in) :: xi
    real(wp), intent(out) :: weight(0:2), slope(0:2)
    real(wp) :: low, high, scale
    integer :: i

    scale = 0.5_wp/half_domain
    do i = 0, 2
      high = min(max(xi - real(i, wp) + half_domain, -1.0_wp), 1.0_wp)
      low = min(max(xi - real(i, wp) - half_domain, -1.0_wp), 1.0_wp)
      weight(i) = scale*((high - 0.5_wp*high*abs(high)) - (low - 0.5_wp*low*abs(low)))
      slope(i) = scale*(abs(low) - abs(high))
    end do
  end subroutine gimp_weights

  pure subroutine bspline_weights(xi, weight, slope)
    !! Quadratic B-spline of unit knot spacing, xi in [1/2, 3/2).
    real(wp), intent(in) :: xi
    real(wp), intent(out) :: weight(0:2), slope(0:2)

    weight(0) = 0.5_wp*(1.5_wp - xi)**2
    weight(1) = 0.75_wp - (xi - 1.0_wp)**2
    weight(2) = 0.5_wp*(xi - 0.5_wp)**2
    slope(0) = xi - 1.5_wp
    slope(1) = 2.0_wp - 2.0_wp*xi
    slope(2) = xi - 0.5_wp
  end subroutine bspline_weights

  pure integer function group_count(kind) result(n)
    !! Groups of `n_group` nodes that a patch fills.
    integer, intent(in) :: kind

    n = merge(1, n_group_wide, kind == shape_linear)
  end function group_count

  pure subroutine patch_offsets(kind, n_groups, offset)
    !! Coordinates of a patch's nodes from its base node, x fastest; 0 in the padding.
    integer, intent(in) :: kind
    integer, intent(in) :: n_groups                               !! of group_count
    real(wp), intent(out) :: offset(n_group*n_groups, ndim)       !! [-]

    offset = 0.0_wp
    if (kind == shape_linear) then
      offset(1:n_group, :) = corner
    else
      offset(1:n_wide, :) = wide
    end if
  end subroutine patch_offsets

  pure subroutine patch_weights(kind, half_domain, origin, spacing, n, patch, position, n_patch, &
                                patch_base, patch_fold, n_groups, weight, gradient, domain)
    !! Kernel: weights and gradients at the nodes of each particle's patch, x fastest, in groups.
    integer, intent(in) :: kind
    real(wp), intent(in) :: half_domain                   !! GIMP only [-]
    real(wp), intent(in) :: origin(ndim), spacing         !! of the grid [m]
    integer, intent(in) :: n                              !! particles
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)             !! [m]
    integer, intent(in) :: n_patch
    integer, intent(in) :: patch_base(ndim, n_patch)      !! base node of the patches
    integer, intent(in) :: patch_fold(ndim, n_patch)      !! -1, 0 or 1: folded end (not hats)
    integer, intent(in) :: n_groups                       !! of group_count
    real(wp), intent(out) :: weight(n_group, n_groups, n)            !! [-]
    real(wp), intent(out) :: gradient(n_group, n_groups, ndim, n)    !! [1/m]
    real(wp), intent(in), optional :: domain(ndim, n)
    !! GIMP: half domains of each particle over h, instead of the one [-]

    if (kind == shape_linear) then
      call linear_patch_weights(origin, spacing, n, patch, position, n_patch, patch_base, weight, &
                                gradient)
    else
      call wide_patch_weights(kind, half_domain, origin, spacing, n, patch, position, n_patch, &
                              patch_base, patch_fold, weight, gradient, domain)
    end if
  end subroutine patch_weights

  pure subroutine linear_patch_weights(origin, spacing, n, patch, position, n_patch, patch_base, &
                                       weight, gradient)
    !! Products of hats at the 2**ndim nodes of a cell, vectorised over the nodes.
    real(wp), intent(in) :: origin(ndim), spacing
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)
    integer, intent(in) :: n_patch
    integer, intent(in) :: patch_base(ndim, n_patch)
    real(wp), intent(out) :: weight(n_group, n), gradient(n_group, ndim, n)
    integer :: d, e, p
    ! A node has the factor at_base + side*xi in direction d.
    real(wp), parameter :: side(n_group, ndim) = 2*corner - 1
    real(wp), parameter :: at_base(n_group, ndim) = 1 - corner
    real(wp) :: inverse, xi, factor(n_group, ndim)

    inverse = 1.0_wp/spacing
    do p = 1, n
      do d = 1, ndim
        xi = (position(d, p) - origin(d))*inverse - real(patch_base(d, patch(p)), wp)
        factor(:, d) = at_base(:, d) + side(:, d)*xi
      end do
      weight(:, p) = 1.0_wp
      do d = 1, ndim
        weight(:, p) = weight(:, p)*factor(:, d)
      end do
      do d = 1, ndim
        gradient(:, d, p) = side(:, d)*inverse
        do e = 1, ndim
          if (e /= d) gradient(:, d, p) = gradient(:, d, p)*factor(:, e)
        end do
      end do
    end do
  end subroutine linear_patch_weights

  pure subroutine wide_patch_weights(kind, half_domain, origin, spacing, n, patch, position, &
                                     n_patch, patch_base, patch_fold, weight, gradient, domain)
    !! Products of GIMP or B-spline weights at the 3**ndim nodes of a patch.
    integer, intent(in) :: kind
    real(wp), intent(in) :: half_domain
    real(wp), intent(in) :: origin(ndim), spacing
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)
    integer, intent(in) :: n_patch
    integer, intent(in) :: patch_base(ndim, n_patch), patch_fold(ndim, n_patch)
    real(wp), intent(out) :: weight(n_padded, n), gradient(n_padded, ndim, n)
    real(wp), intent(in), optional :: domain(ndim, n)
    integer :: d, p
    real(wp) :: inverse, xi, w(0:2, ndim), s(0:2, ndim), factor(0:2, ndim)

    inverse = 1.0_wp/spacing
    weight(n_wide + 1:, :) = 0.0_wp
    gradient(n_wide + 1:, :, :) = 0.0_wp
    do p = 1, n
      do d = 1, ndim
        xi = (position(d, p) - origin(d))*inverse - real(patch_base(d, patch(p)), wp)
        if (present(domain)) then
          call gimp_weights(domain(d, p), xi, w(:, d), s(:, d))
        else if (kind == shape_gimp) then
          call gimp_weights(half_domain, xi, w(:, d), s(:, d))
        else
          call bspline_weights(xi, w(:, d), s(:, d))
        end if
        if (patch_fold(d, patch(p)) /= 0) then
          call fold(patch_fold(d, patch(p)), w(:, d))
          call fold(patch_fold(d, patch(p)), s(:, d))
        end if
      end do
      call multiply_out(w, weight(1:n_wide, p))
      do d = 1, ndim
        factor = w
        factor(:, d) = inverse*s(:, d)
        call multiply_out(factor, gradient(1:n_wide, d, p))
      end do
    end do
  end subroutine wide_patch_weights

  pure subroutine fold(end, factor)
    !! Gives the share of the outer node to the two others.
    integer, intent(in) :: end                   !! -1: below, 1: above
    real(wp), intent(inout) :: factor(-1:1)
    real(wp) :: share

    share = factor(end)
    factor(end) = 0.0_wp
    factor(0) = factor(0) + 2.0_wp*share
    factor(-end) = factor(-end) - share
  end subroutine fold

  pure subroutine multiply_out(factor, products)
    !! Products of one factor per direction, x fastest. Trip counts are constants, to be unrolled.
    real(wp), intent(in) :: factor(0:2, ndim)
    real(wp), intent(inout) :: products(n_wide)
    integer, parameter :: middle = min(ndim, 2)
    integer :: i, j, k

    if (ndim == 1) then
      do i = 0, 2
        products(i + 1) = factor(i, 1)
      end do
    else if (ndim == 2) then
      do j = 0, 2
        do i = 0, 2
          products(3*j + i + 1) = factor(i, 1)*factor(j, ndim)
        end do
      end do
    else
      do k = 0, 2
        do j = 0, 2
          do i = 0, 2
            products(9*k + 3*j + i + 1) = factor(i, 1)*(factor(j, middle)*factor(k, ndim))
          end do
        end do
      end do
    end if
  end subroutine multiply_out
end module dosui_shape_functions

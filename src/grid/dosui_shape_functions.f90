!! Shape functions of the background grid: linear hats, GIMP and quadratic B-splines.
!!
!! A particle touches a patch of `width` nodes per direction, counted from its base node. The
!! local coordinate xi = x/h - base is measured from that node: xi in [0, 1) for linear hats,
!! [1/2, 3/2) for the others. Derivatives are taken with respect to xi (divide by h for 1/m).
module dosui_shape_functions
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  implicit none
  private

  public :: shape_kind_of, shape_width, shape_shift, shape_weights, patch_weights

  integer, parameter, public :: shape_linear = 1    !! hats
  integer, parameter, public :: shape_gimp = 2      !! hats averaged over the particle's domain
  integer, parameter, public :: shape_bspline = 3   !! quadratic B-splines

  integer, parameter :: n2 = 2**ndim, n3 = 3**ndim   ! nodes of a patch

contains

  pure integer function shape_kind_of(name) result(kind)
    !! Kind of the shape functions with this name in a scene, 0 for an unknown name.
    character(len=*), intent(in) :: name   !! 'linear', 'gimp' or 'bspline'

    select case (name)
    case ('linear')
      kind = shape_linear
    case ('gimp')
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
    !! Hats averaged over [xi - l, xi + l] (Bardenhagen & Kober 2004). With N the hat and H its
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

  pure subroutine patch_weights(kind, half_domain, origin, spacing, n, patch, position, n_patch, &
                                patch_base, n_node, weight, gradient)
    !! Kernel: weights and gradients at the nodes of each particle's patch, x fastest.
    integer, intent(in) :: kind
    real(wp), intent(in) :: half_domain                    !! GIMP only [-]
    real(wp), intent(in) :: origin(ndim), spacing          !! of the grid [m]
    integer, intent(in) :: n                               !! particles
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)              !! [m]
    integer, intent(in) :: n_patch
    integer, intent(in) :: patch_base(ndim, n_patch)       !! base node of the patches
    integer, intent(in) :: n_node                          !! of a patch
    real(wp), intent(out) :: weight(n_node, n)             !! [-]
    real(wp), intent(out) :: gradient(n_node, ndim, n)     !! [1/m]

    if (kind == shape_linear) then
      call linear_patch_weights(origin, spacing, n, patch, position, n_patch, patch_base, weight, &
                                gradient)
    else
      call wide_patch_weights(kind, half_domain, origin, spacing, n, patch, position, n_patch, &
                              patch_base, weight, gradient)
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
    real(wp), intent(out) :: weight(n2, n), gradient(n2, ndim, n)
    integer :: d, e, i, p
    ! Node i has the factor at_base + side*xi in direction d.
    real(wp), parameter :: side(n2, ndim) = &
                           reshape([((real(2*mod((i - 1)/2**(d - 1), 2) - 1, wp), i=1, n2), &
                                     d=1, ndim)], [n2, ndim])
    real(wp), parameter :: at_base(n2, ndim) = 0.5_wp*(1.0_wp - side)
    real(wp) :: inverse, xi, factor(n2, ndim)

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
                                     n_patch, patch_base, weight, gradient)
    !! Products of GIMP or B-spline weights at the 3**ndim nodes of a patch.
    integer, intent(in) :: kind
    real(wp), intent(in) :: half_domain
    real(wp), intent(in) :: origin(ndim), spacing
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)
    integer, intent(in) :: n_patch
    integer, intent(in) :: patch_base(ndim, n_patch)
    real(wp), intent(out) :: weight(n3, n), gradient(n3, ndim, n)
    integer :: d, e, i, p
    integer, parameter :: node(n3, ndim) = &
                          reshape([((mod((i - 1)/3**(d - 1), 3), i=1, n3), d=1, ndim)], &
                                  [n3, ndim])
    real(wp) :: inverse, xi, w(0:2, ndim), s(0:2, ndim)

    inverse = 1.0_wp/spacing
    do p = 1, n
      do d = 1, ndim
        xi = (position(d, p) - origin(d))*inverse - real(patch_base(d, patch(p)), wp)
        if (kind == shape_gimp) then
          call gimp_weights(half_domain, xi, w(:, d), s(:, d))
        else
          call bspline_weights(xi, w(:, d), s(:, d))
        end if
      end do
      weight(:, p) = 1.0_wp
      gradient(:, :, p) = inverse
      do d = 1, ndim
        weight(:, p) = weight(:, p)*w(node(:, d), d)
        do e = 1, ndim
          if (e == d) then
            gradient(:, e, p) = gradient(:, e, p)*s(node(:, d), d)
          else
            gradient(:, e, p) = gradient(:, e, p)*w(node(:, d), d)
          end if
        end do
      end do
    end do
  end subroutine wide_patch_weights
end module dosui_shape_functions

!! Kinematics of finite strains: deformation gradients, and the elastic logarithmic strains by which
!! small-strain models serve for finite ones [Simo1992; deSouzaNeto2008, ch. 14].
module dosui_finite_strain
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_grid, only: grid_t
  use dosui_principal, only: dyad_of, principal_stresses, stress_from_principal
  use dosui_shape_functions, only: group_count, n_group, n_group_wide, patch_weights
  implicit none
  private

  public :: carried_area, deform, elastic_strain, elastic_trial, geometric_stiffness, invert, &
            rate_of_logarithm

  integer, parameter :: chunk = 32    ! particles whose weights are computed together

contains

  subroutine deform(grid, n, patch, position, motion, deformation, displacement)
    !! Kernel: adds a motion of the nodes to the particles' deformation gradients and places. Shape
    !! functions belong to the reference configuration.
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: n
    integer, intent(in) :: patch(n)
    real(wp), intent(in) :: position(ndim, n)               !! of the reference [m]
    real(wp), intent(in) :: motion(ndim, grid%n_node)       !! [m]
    real(wp), intent(inout) :: deformation(ndim, ndim, n)   !! F_ab = dx_a/dX_b [-]
    real(wp), intent(inout) :: displacement(ndim, n)        !! [m]
    real(wp) :: weight(n_group*n_group_wide*chunk), gradient(n_group*n_group_wide*ndim*chunk)
    integer :: n_groups, width, first, last, p, i, b, m

    n_groups = group_count(grid%shape_kind)
    width = n_group*n_groups
    do first = 1, n, chunk
      last = min(first + chunk - 1, n)
      m = last - first + 1
      call patch_weights(grid%shape_kind, grid%half_domain, grid%origin, grid%spacing, m, &
                         patch(first:last), position(:, first:last), grid%n_patch, &
                         grid%patch_base, grid%patch_fold, n_groups, weight, gradient)
      do p = first, last
        do i = 1, size(grid%patch_node, 1)
          associate (step => motion(:, grid%patch_node(i, patch(p))))
            displacement(:, p) = displacement(:, p) + weight(width*(p - first) + i)*step
            do b = 1, ndim
              deformation(:, b, p) = deformation(:, b, p) + &
                                     gradient(width*(ndim*(p - first) + b - 1) + i)*step
            end do
          end associate
        end do
      end do
    end do
  end subroutine deform

  pure function carried_area(f, reference) result(area)
    !! Nanson's formula: an area along its normal after a deformation, J F^-T A; zero if F is
    !! singular [m2].
    real(wp), intent(in) :: f(ndim, ndim)     !! deformation gradient [-]
    real(wp), intent(in) :: reference(ndim)   !! area along the normal before [m2]
    real(wp) :: area(ndim)
    real(wp) :: inverse(ndim, ndim), jacobian

    call invert(f, inverse, jacobian)
    area = jacobian*matmul(reference, inverse)
  end function carried_area

  pure subroutine invert(a, inverse, determinant)
    !! Inverse and determinant by elimination with pivots; the inverse of a singular matrix is 0.
    real(wp), intent(in) :: a(ndim, ndim)   !! [any unit]
    real(wp), intent(out) :: inverse(ndim, ndim), determinant   !! [any unit, inverted; its power]
    real(wp) :: left(ndim, ndim), row(ndim)
    integer :: k, j, pivot

    left = a
    inverse = 0.0_wp
    do k = 1, ndim
      inverse(k, k) = 1.0_wp
    end do
    determinant = 1.0_wp
    do k = 1, ndim
      pivot = k - 1 + maxloc(abs(left(k:, k)), dim=1)
      if (pivot /= k) then
        row = left(k, :)
        left(k, :) = left(pivot, :)
        left(pivot, :) = row
        row = inverse(k, :)
        inverse(k, :) = inverse(pivot, :)
        inverse(pivot, :) = row
        determinant = -determinant
      end if
      determinant = determinant*left(k, k)
      if (.not. abs(left(k, k)) > 0.0_wp) then
        inverse = 0.0_wp
        return
      end if
      inverse(k, :) = inverse(k, :)/left(k, k)
      left(k, :) = left(k, :)/left(k, k)
      do j = 1, ndim
        if (j == k) cycle
        inverse(j, :) = inverse(j, :) - left(j, k)*inverse(k, :)
        left(j, :) = left(j, :) - left(j, k)*left(k, :)
      end do
    end do
  end subroutine invert

  pure subroutine elastic_trial(step, elastic, trial, value, axes)
    !! Elastic logarithmic strain after a step without plastic flow, 1/2 ln(f exp(2 e) f^T): with
    !! b = exp(2 e) the elastic left Cauchy-Green tensor [Simo1992]. Shear components are single.
    real(wp), intent(in) :: step(ndim, ndim)     !! f = F_new F_old^-1 [-]
    real(wp), intent(in) :: elastic(nsig)        !! e at the step's start [-]
    real(wp), intent(out) :: trial(nsig)         !! [-]
    real(wp), intent(out) :: value(3)            !! its principal values [-]
    real(wp), intent(out) :: axes(3, 3)          !! and their directions (component, direction) [-]
    real(wp) :: b(nsig), block(ndim, ndim)
    integer :: i, j

    call principal_stresses(elastic, value, axes)
    b = stress_from_principal(exp(2.0_wp*value), axes)
    do j = 1, ndim
      do i = 1, ndim
        block(i, j) = b(voigt_slot(i, j))
      end do
    end do
    block = matmul(step, matmul(block, transpose(step)))
    do j = 1, ndim
      do i = 1, j
        b(voigt_slot(i, j)) = 0.5_wp*(block(i, j) + block(j, i))
      end do
    end do
    call principal_stresses(b, value, axes)
    value = 0.5_wp*log(value)
    trial = stress_from_principal(value, axes)
  end subroutine elastic_trial

  pure function rate_of_logarithm(value, axes) result(rate)
    !! Derivative of the trial strain with respect to the symmetric gradient of a further motion,
    !! in axes that turn with the body: x coth(x), x = e_i - e_j, between the principal directions
    !! i and j. From d ln(b) of b = l b + b l^T. Shear components are doubled [-].
    real(wp), intent(in) :: value(3), axes(3, 3)   !! as from `elastic_trial` [-]
    real(wp) :: rate(nsig, nsig)
    real(wp) :: mixed(nsig), twice(nsig)
    integer :: i, j, s

    rate = 0.0_wp
    twice = 1.0_wp
    twice(4:) = 2.0_wp
    do s = 1, nsig
      rate(s, s) = 1.0_wp
    end do
    do i = 1, 2
      do j = i + 1, 3
        mixed = dyad_of(axes(:, i), axes(:, j))
        rate = rate + 2.0_wp*excess(value(i) - value(j))* &
               spread(twice*mixed, 2, nsig)*spread(mixed, 1, nsig)
      end do
    end do

  contains

    pure real(wp) function excess(x)
      !! x coth(x) - 1.
      real(wp), intent(in) :: x

      if (abs(x) < 1.0e-2_wp) then
        excess = x**2*(1.0_wp/3.0_wp - x**2/45.0_wp)
      else
        excess = x/tanh(x) - 1.0_wp
      end if
    end function excess
  end function rate_of_logarithm

  pure function elastic_strain(stress, tangent) result(strain)
    !! The strain that an isotropic elastic matrix has a stress for; single shear components [-].
    real(wp), intent(in) :: stress(nsig)           !! [Pa]
    real(wp), intent(in) :: tangent(nsig, nsig)    !! [Pa]
    real(wp) :: strain(nsig)
    real(wp) :: mean, shear

    mean = sum(stress(1:3))/3.0_wp
    shear = 0.5_wp*(tangent(1, 1) - tangent(1, 2))
    strain = 0.5_wp*stress/shear
    strain(1:3) = strain(1:3) - 0.5_wp*mean/shear + mean/(tangent(1, 1) + 2.0_wp*tangent(1, 2))
  end function elastic_strain

  pure subroutine geometric_stiffness(gradient, stress, pressure, stiffness)
    !! What the stress adds to the derivative of a particle's nodal forces:
    !! grad(du) : (w s - s w - s L^T) of the effective stress with w = skew L, L = grad(u), and
    !! -p (div(du) div(u) - grad(du) : grad(u)^T) of the water [Pa m].
    real(wp), intent(in) :: gradient(:, :)    !! (ndim, nodes), of the present places [1/m]
    real(wp), intent(in) :: stress(nsig)      !! effective times volume, tension positive [Pa m3]
    real(wp), intent(in) :: pressure          !! of the water times volume [Pa m3]
    real(wp), intent(inout) :: stiffness(:, :)   !! (ndim*nodes, ndim*nodes) [Pa m]
    real(wp) :: full(ndim, ndim), pushed(ndim, size(gradient, 2)), g(ndim), f(ndim), cross
    integer :: i, j, a, b

    do a = 1, ndim
      do b = 1, ndim
        full(a, b) = stress(voigt_slot(a, b))
      end do
    end do
    pushed = matmul(full, gradient)
    do j = 1, size(gradient, 2)
      g = gradient(:, j)
      do i = 1, size(gradient, 2)
        f = gradient(:, i)
        cross = dot_product(f, g)
        do b = 1, ndim
          do a = 1, ndim
            stiffness(ndim*(i - 1) + a, ndim*(j - 1) + b) = -0.5_wp*( &
                                       g(a)*pushed(b, i) + full(a, b)*cross + pushed(a, j)*f(b)) - &
                                                            pressure*(f(a)*g(b) - g(a)*f(b))
          end do
          stiffness(ndim*(i - 1) + b, ndim*(j - 1) + b) = &
            stiffness(ndim*(i - 1) + b, ndim*(j - 1) + b) + 0.5_wp*dot_product(g, pushed(:, i))
        end do
      end do
    end do
  end subroutine geometric_stiffness
end module dosui_finite_strain

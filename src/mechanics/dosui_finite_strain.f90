!! Kinematics of finite strains and Hencky's elasticity: the Kirchhoff stress is linear in the
!! logarithmic strain, tau = D ln V with F = V R (Hencky 1928; de Souza Neto et al. 2008, ch. 14).
module dosui_finite_strain
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_grid, only: grid_t
  use dosui_shape_functions, only: group_count, n_group, n_group_wide, patch_weights
  implicit none
  private

  public :: carried_area, deform, geometric_stiffness, invert, logarithmic_strain

  integer, parameter :: sweeps = 30   ! of Jacobi's rotations; a few are enough
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
    !! singular.
    real(wp), intent(in) :: f(ndim, ndim)     !! deformation gradient [-]
    real(wp), intent(in) :: reference(ndim)   !! area along the normal before [m2]
    real(wp) :: area(ndim)
    real(wp) :: inverse(ndim, ndim), jacobian

    call invert(f, inverse, jacobian)
    area = jacobian*matmul(reference, inverse)
  end function carried_area

  pure subroutine invert(a, inverse, determinant)
    !! Inverse and determinant by elimination with pivots; the inverse of a singular matrix is 0.
    real(wp), intent(in) :: a(ndim, ndim)
    real(wp), intent(out) :: inverse(ndim, ndim), determinant
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

  pure subroutine logarithmic_strain(deformation, strain)
    !! ln V = 1/2 ln(F F^T), tension positive, shear components doubled [-].
    real(wp), intent(in) :: deformation(ndim, ndim)
    real(wp), intent(out) :: strain(nsig)
    real(wp) :: stretch(ndim, ndim), axes(ndim, ndim)
    integer :: k, a, b

    stretch = matmul(deformation, transpose(deformation))
    call diagonalise(stretch, axes)
    strain = 0.0_wp
    do k = 1, ndim
      do a = 1, ndim
        do b = 1, ndim   ! both orders of a shear component add up to its double
          strain(voigt_slot(a, b)) = strain(voigt_slot(a, b)) + &
                                     0.5_wp*log(stretch(k, k))*axes(a, k)*axes(b, k)
        end do
      end do
    end do
  end subroutine logarithmic_strain

  pure subroutine diagonalise(a, axes)
    !! Eigenvalues (left on the diagonal) and eigenvectors of a symmetric matrix, by Jacobi's
    !! rotations.
    real(wp), intent(inout) :: a(ndim, ndim)
    real(wp), intent(out) :: axes(ndim, ndim)
    real(wp) :: theta, t, c, s, column(ndim), row(ndim)
    integer :: k, p, q

    axes = 0.0_wp
    do k = 1, ndim
      axes(k, k) = 1.0_wp
    end do
    do k = 1, sweeps
      do p = 1, ndim
        do q = 1, ndim
          if (q <= p) cycle
          if (.not. abs(a(p, q)) > epsilon(1.0_wp)*1.0e-2_wp*(abs(a(p, p)) + abs(a(q, q)))) cycle
          theta = 0.5_wp*(a(q, q) - a(p, p))/a(p, q)
          t = sign(1.0_wp, theta)/(abs(theta) + sqrt(theta**2 + 1.0_wp))
          c = 1.0_wp/sqrt(t**2 + 1.0_wp)
          s = t*c
          column = a(:, p)
          a(:, p) = c*column - s*a(:, q)
          a(:, q) = s*column + c*a(:, q)
          row = a(p, :)
          a(p, :) = c*row - s*a(q, :)
          a(q, :) = s*row + c*a(q, :)
          column = axes(:, p)
          axes(:, p) = c*column - s*axes(:, q)
          axes(:, q) = s*column + c*axes(:, q)
        end do
      end do
    end do
  end subroutine diagonalise

  pure subroutine geometric_stiffness(gradient, stress, pressure, stiffness)
    !! What the stress adds to the derivative of a particle's nodal forces:
    !! grad(du) : (w s - s w - s L^T) of the effective stress with w = skew L, L = grad(u), and
    !! -p (div(du) div(u) - grad(du) : grad(u)^T) of the water [Pa m].
    real(wp), intent(in) :: gradient(:, :)    !! (ndim, nodes), of the present places [1/m]
    real(wp), intent(in) :: stress(nsig)      !! effective times volume, tension positive [Pa m3]
    real(wp), intent(in) :: pressure          !! of the water times volume [Pa m3]
    real(wp), intent(inout) :: stiffness(:, :)   !! (ndim*nodes, ndim*nodes)
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

!! Moving least squares for the head: rows of the Laplacian and of the gradient at a particle.
!!
!! The compact (generalised finite difference) form fits h_j - h_i by a full quadratic in
!! r = (x_j - x_i)/dx with Wendland C2 weights [Wendland1995] and reads second derivatives off
!! the fit ([Liszka1980]; flux rows as in [Milewski2012]): no gradient is taken twice.
module dosui_mls
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  implicit none
  private

  public :: wendland_weight, quadratic_basis, quadratic_basis_slope, factorise, solve_factored

  integer, parameter, public :: n_basis = ndim + ndim*(ndim + 1)/2   !! 2, 5 or 9 monomials
  real(wp), parameter :: smallest_pivot = 1.0e-8_wp   !! of the diagonal, after scaling [-]

contains

  pure real(wp) function wendland_weight(ratio) result(weight)
    !! Wendland C2 weight (1 - q)^4 (1 + 4 q) of q = r/R < 1 [-].
    real(wp), intent(in) :: ratio   !! q, from 0 to 1 [-]

    weight = (1.0_wp - ratio)**4*(1.0_wp + 4.0_wp*ratio)
  end function wendland_weight

  pure function quadratic_basis(r) result(basis)
    !! (r_a, r_a^2/2, r_a r_b): the Taylor monomials without the constant [-].
    real(wp), intent(in) :: r(ndim)   !! place relative to the particle over dx [-]
    real(wp) :: basis(n_basis)
    integer :: a, b, k

    basis(1:ndim) = r
    basis(ndim + 1:2*ndim) = 0.5_wp*r*r
    k = 2*ndim
    do a = 1, ndim
      do b = a + 1, ndim
        k = k + 1
        basis(k) = r(a)*r(b)
      end do
    end do
  end function quadratic_basis

  pure function quadratic_basis_slope(r, normal) result(slope)
    !! Derivative of the monomials along a normal [-].
    real(wp), intent(in) :: r(ndim), normal(ndim)
    !! place relative to the particle over dx, unit vector [-]
    real(wp) :: slope(n_basis)
    integer :: a, b, k

    slope(1:ndim) = normal
    slope(ndim + 1:2*ndim) = r*normal
    k = 2*ndim
    do a = 1, ndim
      do b = a + 1, ndim
        k = k + 1
        slope(k) = normal(a)*r(b) + r(a)*normal(b)
      end do
    end do
  end function quadratic_basis_slope

  pure subroutine factorise(m, matrix, regular)
    !! Kernel: Cholesky factor (lower triangle) of a symmetric matrix, in place. `regular` is false
    !! when a pivot is tiny against its diagonal entry: the rows do not determine the fit.
    integer, intent(in) :: m
    real(wp), intent(inout) :: matrix(m, m)   !! symmetric on entry, its factor on return [any unit]
    logical, intent(out) :: regular
    real(wp) :: pivot
    integer :: i, j, k

    regular = .true.
    do j = 1, m
      pivot = matrix(j, j)
      do k = 1, j - 1
        pivot = pivot - matrix(j, k)**2
      end do
      if (.not. pivot > smallest_pivot*matrix(j, j)) then
        regular = .false.
        return
      end if
      pivot = sqrt(pivot)
      matrix(j, j) = pivot
      do i = j + 1, m
        do k = 1, j - 1
          matrix(i, j) = matrix(i, j) - matrix(i, k)*matrix(j, k)
        end do
        matrix(i, j) = matrix(i, j)/pivot
      end do
    end do
  end subroutine factorise

  pure subroutine solve_factored(m, factor, right)
    !! Kernel: solves with the Cholesky factor, in place.
    integer, intent(in) :: m
    real(wp), intent(in) :: factor(m, m)   !! as from `factorise` [any unit]
    real(wp), intent(inout) :: right(m)   !! right side on entry, solution on return [any unit]
    integer :: i, k

    do i = 1, m
      do k = 1, i - 1
        right(i) = right(i) - factor(i, k)*right(k)
      end do
      right(i) = right(i)/factor(i, i)
    end do
    do i = m, 1, -1
      do k = i + 1, m
        right(i) = right(i) - factor(k, i)*right(k)
      end do
      right(i) = right(i)/factor(i, i)
    end do
  end subroutine solve_factored
end module dosui_mls

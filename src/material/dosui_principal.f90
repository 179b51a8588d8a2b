!! Principal stresses, and tangents of materials whose stress is an isotropic function of the
!! elastic trial stress: they only need to know what happens to the three principal values.
module dosui_principal
  use dosui_kinds, only: wp
  use dosui_dimension, only: nsig, voigt6
  implicit none
  private

  public :: elastic_matrix, principal_stresses, stress_from_principal, tangent_from_principal, &
            deviator_of, dyad_of, tangent_from_invariants

  integer, parameter :: first_axis(6) = [1, 2, 3, 1, 2, 3]    ! of xx, yy, zz, xy, yz, zx
  integer, parameter :: second_axis(6) = [1, 2, 3, 2, 3, 1]
  integer, parameter :: sweeps = 30                   ! of Jacobi's rotations, at most
  real(wp), parameter :: equal_values = 1.0e-9_wp     ! principal values that differ less are one

contains

  pure function elastic_matrix(lambda, shear) result(matrix)
    !! Isotropic elasticity for strains with twice the shear components [Pa].
    real(wp), intent(in) :: lambda, shear   !! Lame's constants [Pa]
    real(wp) :: matrix(nsig, nsig)
    integer :: s

    matrix = 0.0_wp
    matrix(1:3, 1:3) = lambda
    do s = 1, nsig
      matrix(s, s) = shear
      if (s <= 3) matrix(s, s) = lambda + 2.0_wp*shear
    end do
  end function elastic_matrix

  pure subroutine principal_stresses(stress, value, vector)
    !! Principal values, largest (most tensile) first, and their directions, by Jacobi's rotations.
    real(wp), intent(in) :: stress(nsig)
    !! or any symmetric tensor of single shears [Pa or any unit]
    real(wp), intent(out) :: value(3)   !! [unit of the stress]
    real(wp), intent(out) :: vector(3, 3)   !! (component, direction) [-]
    real(wp) :: a(3, 3), column(3), t, c, s, h
    integer :: i, j, k, m, sweep

    a = 0.0_wp
    do m = 1, nsig
      a(first_axis(voigt6(m)), second_axis(voigt6(m))) = stress(m)
      a(second_axis(voigt6(m)), first_axis(voigt6(m))) = stress(m)
    end do
    vector = 0.0_wp
    do k = 1, 3
      vector(k, k) = 1.0_wp
    end do
    if (nsig == 4) then   ! a plane: one rotation
      call turn_plane(a, vector)
      call put_in_order(a, vector, value)
      return
    end if
    do sweep = 1, sweeps
      if (abs(a(1, 2)) + abs(a(2, 3)) + abs(a(1, 3)) <= &
          epsilon(1.0_wp)*1.0e-2_wp*maxval(abs(a))) exit
      do i = 1, 2
        do j = i + 1, 3
          if (.not. abs(a(i, j)) > 0.0_wp) cycle
          h = 0.5_wp*(a(j, j) - a(i, i))
          t = a(i, j)/(abs(h) + sqrt(h**2 + a(i, j)**2))
          if (h < 0.0_wp) t = -t
          c = 1.0_wp/sqrt(1.0_wp + t**2)
          s = t*c
          column = a(:, i)
          a(:, i) = c*column - s*a(:, j)
          a(:, j) = s*column + c*a(:, j)
          column = a(i, :)
          a(i, :) = c*column - s*a(j, :)
          a(j, :) = s*column + c*a(j, :)
          column = vector(:, i)
          vector(:, i) = c*column - s*vector(:, j)
          vector(:, j) = s*column + c*vector(:, j)
        end do
      end do
    end do
    call put_in_order(a, vector, value)
  end subroutine principal_stresses

  pure subroutine turn_plane(a, vector)
    !! Principal values and directions where only one shear stress is not zero.
    real(wp), intent(inout) :: a(3, 3)
    real(wp), intent(inout) :: vector(3, 3)   !! the unit matrix at first
    real(wp) :: t, c, s, h
    integer :: i, j

    i = first_axis(voigt6(nsig))
    j = second_axis(voigt6(nsig))
    if (.not. abs(a(i, j)) > 0.0_wp) return
    h = 0.5_wp*(a(j, j) - a(i, i))
    t = a(i, j)/(abs(h) + sqrt(h**2 + a(i, j)**2))
    if (h < 0.0_wp) t = -t
    c = 1.0_wp/sqrt(1.0_wp + t**2)
    s = t*c
    a(i, i) = a(i, i) - t*a(i, j)
    a(j, j) = a(j, j) + t*a(i, j)
    vector(i, i) = c
    vector(j, i) = -s
    vector(i, j) = s
    vector(j, j) = c
  end subroutine turn_plane

  pure subroutine put_in_order(a, vector, value)
    !! The diagonal and its directions, largest value first.
    real(wp), intent(in) :: a(3, 3)
    real(wp), intent(inout) :: vector(3, 3)
    real(wp), intent(out) :: value(3)
    real(wp) :: kept, column(3)
    integer :: i, j

    value = [a(1, 1), a(2, 2), a(3, 3)]
    do i = 1, 2
      do j = 1, 3 - i
        if (.not. value(j) < value(j + 1)) cycle
        kept = value(j)
        value(j) = value(j + 1)
        value(j + 1) = kept
        column = vector(:, j)
        vector(:, j) = vector(:, j + 1)
        vector(:, j + 1) = column
      end do
    end do
  end subroutine put_in_order

  pure function stress_from_principal(value, vector) result(stress)
    !! The stress with given principal values and directions [unit of the values].
    real(wp), intent(in) :: value(3), vector(3, 3)   !! [Pa or any unit], (component, direction) [-]
    real(wp) :: stress(nsig)
    integer :: m, k

    stress = 0.0_wp
    do k = 1, 3
      do m = 1, nsig
        stress(m) = stress(m) + value(k)*vector(first_axis(voigt6(m)), k)* &
                    vector(second_axis(voigt6(m)), k)
      end do
    end do
  end function stress_from_principal

  pure function tangent_from_principal(trial, vector, value, derivative, elastic) result(tangent)
    !! Derivative of the stress with respect to the strain (twice the shear): the derivative of the
    !! principal values, and the turning of their directions [deSouzaNeto2008, app. A]
    !! [Pa].
    real(wp), intent(in) :: trial(3)                 !! principal trial stresses [Pa]
    real(wp), intent(in) :: vector(3, 3)             !! their directions [-]
    real(wp), intent(in) :: value(3)                 !! principal stresses [Pa]
    real(wp), intent(in) :: derivative(3, 3)         !! of value(i) by trial(j) [-]
    real(wp), intent(in) :: elastic(nsig, nsig)      !! of the trial stress [Pa]
    real(wp) :: tangent(nsig, nsig)
    real(wp) :: dyad(nsig, 3), mixed(nsig), twice(nsig), turn, gap
    integer :: i, j

    twice = 1.0_wp
    twice(4:) = 2.0_wp
    do i = 1, 3
      dyad(:, i) = dyad_of(vector(:, i), vector(:, i))
    end do
    tangent = 0.0_wp
    do i = 1, 3
      do j = 1, 3
        tangent = tangent + derivative(i, j)*outer(dyad(:, i), twice*dyad(:, j))
      end do
    end do
    do i = 1, 2
      do j = i + 1, 3
        gap = trial(i) - trial(j)
        if (gap > equal_values*maxval(abs(trial))) then
          turn = (value(i) - value(j))/gap
        else   ! the limit
          turn = 0.5_wp*(derivative(i, i) - derivative(i, j) + derivative(j, j) - derivative(j, i))
        end if
        mixed = dyad_of(vector(:, i), vector(:, j))
        tangent = tangent + 2.0_wp*turn*outer(mixed, twice*mixed)
      end do
    end do
    tangent = matmul(tangent, elastic)
  end function tangent_from_principal

  pure subroutine deviator_of(stress, mean, deviator, length)
    !! Mean stress, deviator, and sqrt(J2) = sqrt(s:s/2) [Pa].
    real(wp), intent(in) :: stress(nsig)   !! [Pa]
    real(wp), intent(out) :: mean, deviator(nsig), length   !! [Pa]

    mean = sum(stress(1:3))/3.0_wp
    deviator = stress
    deviator(1:3) = deviator(1:3) - mean
    length = sqrt(0.5_wp*sum(deviator(1:3)**2) + sum(deviator(4:)**2))
  end subroutine deviator_of

  pure function tangent_from_invariants(bulk, shear, trial, trial_length, length, of_mean, &
                                        of_length) result(tangent)
    !! Derivative of the stress with respect to the strain (twice the shear) where the deviator
    !! keeps its direction: the mean m and the length l = sqrt(J2) are functions of their trials
    !! [Pa].
    real(wp), intent(in) :: bulk             !! of the mean trial stress by the volume strain [Pa]
    real(wp), intent(in) :: shear            !! G of the trial deviator [Pa]
    real(wp), intent(in) :: trial(nsig)      !! its deviator [Pa]
    real(wp), intent(in) :: trial_length     !! its length [Pa]
    real(wp), intent(in) :: length           !! l [Pa]
    real(wp), intent(in) :: of_mean(2)       !! derivatives of m by the trial mean and length [-]
    real(wp), intent(in) :: of_length(2)     !! derivatives of l, likewise [-]
    real(wp) :: tangent(nsig, nsig)
    real(wp) :: one(nsig), row(nsig), along(nsig), ratio
    integer :: s

    one = 0.0_wp
    one(1:3) = 1.0_wp
    along = 0.0_wp
    ratio = of_length(2)   ! the limit without a deviator
    if (trial_length > 0.0_wp) then
      along = trial/trial_length
      ratio = length/trial_length
    end if
    row = of_mean(1)*bulk*one + of_mean(2)*shear*along
    tangent = outer(one, row)
    row = of_length(1)*bulk*one + (of_length(2) - ratio)*shear*along
    tangent = tangent + outer(along, row)
    tangent(1:3, 1:3) = tangent(1:3, 1:3) - 2.0_wp*shear*ratio/3.0_wp
    do s = 1, nsig
      tangent(s, s) = tangent(s, s) + merge(2.0_wp, 1.0_wp, s <= 3)*shear*ratio
    end do
  end function tangent_from_invariants

  pure function dyad_of(a, b) result(dyad)
    !! Symmetric part of the dyad of two vectors, as a stress vector [product of the units].
    real(wp), intent(in) :: a(3), b(3)   !! [any unit]
    real(wp) :: dyad(nsig)
    integer :: m

    do m = 1, nsig
      associate (i => first_axis(voigt6(m)), j => second_axis(voigt6(m)))
        dyad(m) = 0.5_wp*(a(i)*b(j) + a(j)*b(i))
      end associate
    end do
  end function dyad_of

  pure function outer(a, b) result(product)
    !! a b^T.
    real(wp), intent(in) :: a(nsig), b(nsig)
    real(wp) :: product(nsig, nsig)

    product = spread(a, 2, nsig)*spread(b, 1, nsig)
  end function outer
end module dosui_principal

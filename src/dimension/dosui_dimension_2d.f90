!! The number of space dimensions, known at compile time: 2-D (vertical plane x-z, plane strain).
!!
!! z is up in every dimension, so the last coordinate is always the elevation. Stress vectors start
!! with the three normal components (xx, yy, zz) in every dimension; shear components follow.
module dosui_dimension
  implicit none
  private

  integer, parameter, public :: ndim = 2   !! coordinates and velocity components carried
  integer, parameter, public :: nsig = 4   !! stress components carried: xx, yy, zz, zx
  integer, parameter, public :: axis(ndim) = [1, 3]   !! 3-D axis (1=x, 2=y, 3=z) of each coordinate
  integer, parameter, public :: nshear = nsig - 3   !! shear components carried
  integer, parameter, public :: voigt6(nsig) = [1, 2, 3, 6]   !! slot in (xx, yy, zz, xy, yz, zx)
  integer, parameter, public :: voigt_slot(ndim, ndim) = &
                                reshape([1, 4, 4, 3], [ndim, ndim])
    !! slot of tensor component (i, j) in the stress vector
  integer, parameter, public :: n_volume = ndim   !! normal components that make volume
  integer, parameter, public :: volume_slot(n_volume) = [1, 3]   !! their slots
end module dosui_dimension

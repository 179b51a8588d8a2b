!! The part of a model that ties particles to the grid.
module dosui_mesh
  use dosui_kinds, only: wp
  use dosui_cell_average, only: cell_average_t
  use dosui_cell_quadrature, only: cell_quadrature_t
  use dosui_nodal_extension, only: nodal_extension_t
  implicit none
  private

  type, public :: mesh_t
    !! How particles and surface points lie on the grid, and how its cells are integrated.
    integer, allocatable :: patch(:)          !! nodes' patch of each particle
    integer, allocatable :: cell(:)           !! cell of each particle
    integer, allocatable :: surface_cell(:)   !! cell of each owned surface point
    logical, allocatable :: surface_node(:)   !! nodes of surface points' cells, of any rank
    type(cell_average_t) :: average
    type(cell_quadrature_t) :: quadrature
    type(nodal_extension_t) :: extension   !! nodes that the body hardly touches
    real(wp), allocatable :: weight(:)                !! of particles in integrals [m3]
    real(wp), allocatable :: water_weight(:)   !! likewise, of the water: centred in cells [m3]
  end type mesh_t
end module dosui_mesh

!! Binding of the METIS graph partitioner (Karypis & Kumar 1998), 32-bit indices.
module dosui_metis
  use, intrinsic :: iso_c_binding, only: c_int32_t, c_ptr, c_null_ptr, c_float
  implicit none
  private

  public :: metis_partition

  integer, parameter :: n_options = 40          ! METIS_NOPTIONS
  integer, parameter :: option_seed = 9         ! METIS_OPTION_SEED, counted from 1
  integer, parameter :: status_ok = 1           ! METIS_OK

  interface
    integer(c_int32_t) function metis_set_default_options(options) &
      bind(c, name='METIS_SetDefaultOptions')
      import :: c_int32_t
      integer(c_int32_t), intent(inout) :: options(*)
    end function metis_set_default_options

    integer(c_int32_t) function metis_part_graph_kway(nvtxs, ncon, xadj, adjncy, vwgt, vsize, &
                                                      adjwgt, nparts, tpwgts, ubvec, options, &
                                                      objval, part) &
      bind(c, name='METIS_PartGraphKway')
      import :: c_int32_t, c_ptr
      integer(c_int32_t), intent(in) :: nvtxs, ncon, xadj(*), adjncy(*), vwgt(*)
      type(c_ptr), value :: vsize, adjwgt
      integer(c_int32_t), intent(in) :: nparts
      type(c_ptr), value :: tpwgts, ubvec
      integer(c_int32_t), intent(in) :: options(*)
      integer(c_int32_t), intent(out) :: objval, part(*)
    end function metis_part_graph_kway
  end interface

contains

  subroutine metis_partition(adjacency_start, adjacency, weight, n_part, part, edge_cut, ok)
    !! Splits a graph into parts of equal weight with few cut edges. A fixed seed makes it repeat.
    integer, intent(in) :: adjacency_start(:)   !! (n + 1) CSR, from 0
    integer, intent(in) :: adjacency(:)         !! neighbours, from 0
    integer, intent(in) :: weight(:)            !! (n) positive
    integer, intent(in) :: n_part               !! at least 2
    integer, intent(out) :: part(:)             !! (n) from 0
    integer, intent(out) :: edge_cut
    logical, intent(out) :: ok
    integer(c_int32_t) :: options(n_options), cut, status
    integer(c_int32_t), allocatable :: parts(:)

    allocate (parts(size(weight)))
    status = metis_set_default_options(options)
    options(option_seed) = 7_c_int32_t
    status = metis_part_graph_kway(size(weight, kind=c_int32_t), 1_c_int32_t, &
                                   int(adjacency_start, c_int32_t), int(adjacency, c_int32_t), &
                                   int(weight, c_int32_t), c_null_ptr, c_null_ptr, &
                                   int(n_part, c_int32_t), c_null_ptr, c_null_ptr, options, cut, &
                                   parts)
    ok = status == status_ok
    part = int(parts)
    edge_cut = int(cut)
  end subroutine metis_partition
end module dosui_metis

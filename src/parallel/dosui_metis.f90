!! Binding of the graph partitioner METIS 5 (32-bit indices).
module dosui_metis
  use, intrinsic :: iso_c_binding, only: c_int32_t, c_ptr, c_null_ptr
  use, intrinsic :: ieee_exceptions, only: ieee_usual, ieee_get_halting_mode
  use, intrinsic :: ieee_exceptions, only: ieee_set_halting_mode, ieee_set_flag
  implicit none
  private

  public :: metis_partition

  integer, parameter :: n_options = 40          !! METIS_NOPTIONS
  integer, parameter :: option_seed = 9         !! METIS_OPTION_SEED, counted from 1
  integer, parameter :: option_contig = 12      !! METIS_OPTION_CONTIG
  integer, parameter :: option_numbering = 18   !! METIS_OPTION_NUMBERING
  integer, parameter :: status_ok = 1           !! METIS_OK
  integer, parameter :: seed = 20240229

  interface
    integer(c_int32_t) function metis_set_default_options(options) &
      bind(c, name='METIS_SetDefaultOptions')
      import :: c_int32_t, n_options
      implicit none
      integer(c_int32_t), intent(out) :: options(n_options)
    end function metis_set_default_options

    integer(c_int32_t) function metis_part_graph_kway(nvtxs, ncon, xadj, adjncy, vwgt, vsize, &
                                                      adjwgt, nparts, tpwgts, ubvec, options, &
                                                      objval, part) &
      bind(c, name='METIS_PartGraphKway')
      import :: c_int32_t, c_ptr, n_options
      implicit none
      integer(c_int32_t), intent(in) :: nvtxs, ncon, xadj(nvtxs + 1), adjncy(xadj(nvtxs + 1))
      integer(c_int32_t), intent(in) :: vwgt(nvtxs)
      type(c_ptr), value :: vsize, adjwgt
      integer(c_int32_t), intent(in) :: nparts
      type(c_ptr), value :: tpwgts, ubvec
      integer(c_int32_t), intent(in) :: options(n_options)
      integer(c_int32_t), intent(out) :: objval
      integer(c_int32_t), intent(inout) :: part(nvtxs)
    end function metis_part_graph_kway
  end interface

contains

  subroutine metis_partition(start, adjacency, weight, n_part, part, is_done)
    !! Splits a graph into parts of nearly equal weight with few cut edges. A fixed seed makes it
    !! repeat itself. Parts need not be contiguous, and some may come out empty.
    integer, intent(in) :: start(:)       !! (n+1) where each vertex's neighbours begin, from 0
    integer, intent(in) :: adjacency(:)   !! neighbours, vertices counted from 0; not empty
    integer, intent(in) :: weight(:)      !! (n) positive; their sum fits an integer
    integer, intent(in) :: n_part         !! 2 ... n
    integer, intent(out) :: part(:)       !! (n) counted from 0
    logical, intent(out) :: is_done
    integer(c_int32_t) :: options(n_options), status, cut
    logical :: halting(size(ieee_usual))

    part = 0
    ! METIS divides by zero now and then on its way; this is no error of ours
    call ieee_get_halting_mode(ieee_usual, halting)
    call ieee_set_halting_mode(ieee_usual, .false.)
    status = metis_set_default_options(options)
    options(option_seed) = seed
    options(option_contig) = 0
    options(option_numbering) = 0
    if (status == status_ok) then
      status = metis_part_graph_kway(size(weight), 1, start, adjacency, weight, c_null_ptr, &
                                     c_null_ptr, n_part, c_null_ptr, c_null_ptr, options, cut, part)
    end if
    call ieee_set_flag(ieee_usual, .false.)
    call ieee_set_halting_mode(ieee_usual, halting)
    is_done = status == status_ok
    if (is_done) is_done = all(part >= 0 .and. part < n_part)
  end subroutine metis_partition
end module dosui_metis

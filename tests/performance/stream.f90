!! STREAM triad a = b + s c on every rank at once: the memory bandwidth that dosui's runs can have.
!! Prints the best of ten passes, summed over the ranks [GB/s], counting 24 bytes an element.
program stream
  use, intrinsic :: iso_fortran_env, only: int64, output_unit, real64
  use mpi_f08, only: MPI_Barrier, MPI_Comm_rank, MPI_Comm_size, MPI_COMM_WORLD, MPI_Finalize, &
                     MPI_Init
  implicit none
  integer, parameter :: n = 8*1024*1024    ! 64 MiB an array: far more than the caches hold
  integer, parameter :: passes = 10
  real(real64), allocatable :: a(:), b(:), c(:)
  real(real64) :: seconds, best
  integer(int64) :: begin, now, rate
  integer :: pass, i, rank, ranks

  call MPI_Init()
  call MPI_Comm_rank(MPI_COMM_WORLD, rank)
  call MPI_Comm_size(MPI_COMM_WORLD, ranks)
  allocate (a(n), b(n), c(n))
  do i = 1, n
    a(i) = 0.0_real64
    b(i) = 1.0_real64
    c(i) = real(i, real64)
  end do
  best = huge(best)
  do pass = 1, passes
    call MPI_Barrier(MPI_COMM_WORLD)
    call system_clock(begin, rate)
    do i = 1, n
      a(i) = b(i) + 3.0_real64*c(i)
    end do
    call MPI_Barrier(MPI_COMM_WORLD)
    call system_clock(now)
    seconds = real(now - begin, real64)/real(rate, real64)
    if (pass > 1) best = min(best, seconds)
    b(1) = a(n)    ! keeps the passes from being merged
  end do
  if (rank == 0) write (output_unit, '(f0.3)') 24.0e-9_real64*real(n, real64)*ranks/best
  call MPI_Finalize()
end program stream

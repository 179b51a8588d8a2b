!! The program `dosui`: reads the dimension of a scene and becomes dosui1d, dosui2d or dosui3d,
!! before MPI starts. One source, three executables: a run never pays for another dimension.
program dosui_launcher
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_loc, c_null_char, c_null_ptr, c_ptr, &
                                                                            c_size_t
  use, intrinsic :: iso_fortran_env, only: error_unit
  use dosui_command_line, only: command_line_t, read_command_line
  use dosui_environment, only: suggest_variable
  use dosui_error, only: error_t
  use dosui_namelist, only: namelist_t, read_text_file
  use dosui_problems, only: problems_t
  use dosui_scene_dimension, only: scene_dimension
  use dosui_text, only: to_text
  implicit none

  integer, parameter :: longest = 4096   ! path of Linux

  ! C strings have no length in their interfaces.
  ! allow(C071, C072)
  interface
    integer(c_int) function execv(path, argv) bind(c, name='execv')
      import :: c_int, c_char, c_ptr
      implicit none
      character(kind=c_char), intent(in) :: path(*)
      type(c_ptr), intent(in) :: argv(*)
    end function execv
    integer(c_size_t) function readlink(path, buffer, size) bind(c, name='readlink')
      import :: c_char, c_size_t
      implicit none
      character(kind=c_char), intent(in) :: path(*)
      character(kind=c_char), intent(out) :: buffer(*)
      integer(c_size_t), value :: size
    end function readlink
    subroutine c_exit(status) bind(c, name='exit')
      import :: c_int
      implicit none
      integer(c_int), value :: status
    end subroutine c_exit
  end interface

  character(len=:), allocatable :: program
  integer :: dimension

  dimension = wanted_dimension()
  program = own_folder()//'/dosui'//to_text(dimension)//'d'
  call ask_for_huge_pages()
  call ask_for_quick_start()
  call become(program)
  write (error_unit, '(a)') 'error: cannot start '//program
  call c_exit(2_c_int)

contains

  integer function wanted_dimension() result(n)
    !! Dimension of the scene or the template asked for, read as the programs read them; 2 where
    !! nothing says it, so that the program reports what is wrong.
    type(command_line_t) :: line
    type(namelist_t) :: namelist
    type(problems_t) :: problems   ! the program's to report
    type(error_t) :: err, read_error
    character(len=:), allocatable :: text

    n = 2
    call read_command_line(line, err)
    if (line%dimension > 0) n = line%dimension
    if (len(line%scene) == 0) return
    call read_text_file(line%scene, text, read_error)
    if (read_error%failed()) return
    call namelist%scan(text, line%scene, problems, until='scene')
    n = scene_dimension(namelist, n)
  end function wanted_dimension

  function own_folder() result(folder)
    !! Folder of this program.
    character(len=:), allocatable :: folder
    character(kind=c_char, len=1) :: buffer(longest)
    integer :: k, n

    n = int(readlink('/proc/self/exe'//c_null_char, buffer, int(longest, c_size_t)))
    folder = '.'
    if (n <= 0) return
    folder = ''
    do k = 1, n
      folder = folder//buffer(k)
    end do
    folder = folder(:index(folder, '/', back=.true.) - 1)
  end function own_folder

  subroutine ask_for_huge_pages()
    !! Large arrays on pages of 2 MB, with glibc 2.35 and later: 98 ns a particle-step become 79
    !! with 1e6 particles (2-D, coupled, small strain), and the memory stays the same. The library
    !! reads this when a program starts.
    call suggest_variable('GLIBC_TUNABLES', 'glibc.malloc.hugetlb=1')
  end subroutine ask_for_huge_pages

  subroutine ask_for_quick_start()
    !! Open MPI without the drivers of fast networks where the machine has no such card: one of them
    !! measures the processor's clock for 0.2 s. Other MPI libraries ignore this. (The daemon of a
    !! single process costs another 0.1 s, but gives it a session folder of its own: without it,
    !! concurrent runs remove each other's.)
    character(len=*), parameter :: cards(2) = [character(len=21) :: '/sys/class/infiniband', &
                                                                                   '/sys/class/cxi']
    logical :: has_card
    integer :: k

    do k = 1, size(cards)
      inquire (file=trim(cards(k))//'/.', exist=has_card)
      if (has_card) return
    end do
    call suggest_variable('OMPI_MCA_mtl', '^psm,psm2,ofi')
  end subroutine ask_for_quick_start

  subroutine become(path)
    !! Replaces this process; returns only when that fails.
    character(len=*), intent(in) :: path
    character(kind=c_char, len=:), allocatable, target :: arguments
    type(c_ptr), allocatable :: argv(:)
    integer, allocatable :: first(:)
    integer :: k, n, length
    integer(c_int) :: status

    n = command_argument_count()
    allocate (first(0:n + 1), argv(0:n + 1))
    first(0) = 1
    first(1) = len(path) + 2
    do k = 1, n
      call get_command_argument(k, length=length)
      first(k + 1) = first(k) + length + 1
    end do
    allocate (character(kind=c_char, len=first(n + 1) - 1) :: arguments)
    arguments(:first(1) - 1) = path//c_null_char
    do k = 1, n
      call get_command_argument(k, arguments(first(k):first(k + 1) - 2))
      arguments(first(k + 1) - 1:first(k + 1) - 1) = c_null_char
    end do
    do k = 0, n
      argv(k) = c_loc(arguments(first(k):first(k)))
    end do
    argv(n + 1) = c_null_ptr
    status = execv(path//c_null_char, argv)
  end subroutine become
end program dosui_launcher

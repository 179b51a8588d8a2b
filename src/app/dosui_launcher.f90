!! The program `dosui`: reads the dimension of a scene and becomes dosui1d, dosui2d or dosui3d,
!! before MPI starts. One source, three executables: a run never pays for another dimension.
program dosui_launcher
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_loc, c_null_char, c_null_ptr, c_ptr, &
                                                                            c_size_t
  use, intrinsic :: iso_fortran_env, only: error_unit
  use dosui_text, only: lower_case, to_text
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
    integer(c_int) function setenv(name, value, overwrite) bind(c, name='setenv')
      import :: c_int, c_char
      implicit none
      character(kind=c_char), intent(in) :: name(*), value(*)
      integer(c_int), value :: overwrite
    end function setenv
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

  function argument(k) result(text)
    !! The k-th argument.
    integer, intent(in) :: k
    character(len=:), allocatable :: text
    character(len=longest) :: buffer

    call get_command_argument(k, buffer)
    text = trim(buffer)
  end function argument

  integer function wanted_dimension() result(n)
    !! Dimension of the scene or the template asked for; 2 where nothing says it, so that the
    !! executable reports what is wrong.
    character(len=:), allocatable :: text
    integer :: k

    n = 2
    do k = 1, command_argument_count()
      text = argument(k)
      if (k > 1) then
        if (argument(k - 1) == '--template' .and. verify(text, '123') == 0 .and. &
            len(text) == 1) n = index('123', text)
        if (argument(k - 1) == '--output' .or. argument(k - 1) == '--restart' .or. &
            argument(k - 1) == '--docs') cycle
      end if
      if (len(text) == 0) cycle
      if (text(1:1) == '-') then
        if (index(text, '--template=') == 1) n = max(1, index('123', text(len(text):)))
        cycle
      end if
      n = scene_dimension(text, n)
    end do
  end function wanted_dimension

  integer function scene_dimension(path, default) result(n)
    !! What the key `dimension` of a namelist says; comments are skipped.
    character(len=*), intent(in) :: path
    integer, intent(in) :: default
    character(len=1024) :: line
    integer :: unit, status, place, comment, value

    n = default
    open (newunit=unit, file=path, status='old', action='read', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      line = lower_case(line)
      comment = index(line, '!')
      if (comment > 0) line(comment:) = ''
      place = index(line, 'dimension')
      if (place == 0) cycle
      line = adjustl(line(place + len('dimension'):))
      if (line(1:1) /= '=') cycle
      line = adjustl(line(2:))
      value = index('123', line(1:1))
      if (value > 0 .and. verify(line(2:2), ' ,/') == 0) n = value
      exit
    end do
    close (unit)
  end function scene_dimension

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
    call suggest('GLIBC_TUNABLES', 'glibc.malloc.hugetlb=1')
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
    call suggest('OMPI_MCA_mtl', '^psm,psm2,ofi')
  end subroutine ask_for_quick_start

  subroutine suggest(name, value)
    !! Sets an environment variable that the user has not set.
    character(len=*), intent(in) :: name, value
    integer(c_int) :: status

    status = setenv(name//c_null_char, value//c_null_char, 0_c_int)
    if (status /= 0) return   ! no memory for it: the programs do without
  end subroutine suggest

  subroutine become(path)
    !! Replaces this process; returns only when that fails.
    character(len=*), intent(in) :: path
    character(kind=c_char, len=longest + 1), allocatable, target :: arguments(:)
    type(c_ptr), allocatable :: argv(:)
    integer :: k, n
    integer(c_int) :: status

    n = command_argument_count()
    allocate (arguments(0:n), argv(0:n + 1))
    arguments(0) = path//c_null_char
    do k = 1, n
      arguments(k) = argument(k)//c_null_char
    end do
    do k = 0, n
      argv(k) = c_loc(arguments(k))
    end do
    argv(n + 1) = c_null_ptr
    status = execv(path//c_null_char, argv)
  end subroutine become
end program dosui_launcher

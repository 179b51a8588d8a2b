!! What the machine has left: memory and room on a disk. Negative where it does not tell.
module dosui_machine
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_long, c_null_char
  use dosui_kinds, only: wp, i8
  use dosui_text, only: to_text
  implicit none
  private

  public :: free_memory, free_disk, bytes_text

  real(wp), parameter, public :: unknown_bytes = -1.0_wp

  integer, parameter :: words = 64   !! of statvfs, with room to spare
  integer, parameter :: fragment_size = 2, blocks_available = 5   !! its words on 64-bit Linux

  interface
    integer(c_int) function posix_statvfs(path, buffer) bind(c, name='statvfs')
      import :: c_char, c_int, c_long
      implicit none
      ! allow(C071)
      character(kind=c_char), intent(in) :: path(*)
      ! allow(C071)
      integer(c_long), intent(inout) :: buffer(*)
    end function posix_statvfs
  end interface

contains

  real(wp) function free_memory() result(bytes)
    !! Memory that programs can still have on this node, within the limits of a container or a
    !! batch job if there are any [B].
    real(wp) :: limit, used
    character(len=:), allocatable :: group

    bytes = 1024.0_wp*value_of('/proc/meminfo', 'MemAvailable:')
    if (bytes < 0.0_wp) return
    group = '/sys/fs/cgroup'//control_group()
    do while (len(group) >= len('/sys/fs/cgroup'))
      limit = value_of(group//'/memory.max', '')
      used = value_of(group//'/memory.current', '')
      if (limit >= 0.0_wp .and. used >= 0.0_wp) bytes = min(bytes, max(0.0_wp, limit - used))
      group = group(:index(group, '/', back=.true.) - 1)
    end do
  end function free_memory

  function control_group() result(path)
    !! Where the limits of this process stand, '' if nowhere.
    character(len=:), allocatable :: path
    character(len=1024) :: line
    integer :: unit, status

    path = ''
    open (newunit=unit, file='/proc/self/cgroup', action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, '0::/') == 1 .and. len_trim(line) > 4) path = trim(line(4:))
    end do
    close (unit)
  end function control_group

  real(wp) function value_of(file, label) result(value)
    !! The number behind a label in a file of lines, the first one without a label.
    character(len=*), intent(in) :: file, label
    character(len=256) :: line
    integer(i8) :: number
    integer :: unit, status

    value = unknown_bytes
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, label) /= 1) cycle
      read (line(len(label) + 1:), *, iostat=status) number
      if (status == 0) value = real(number, wp)
      exit
    end do
    close (unit)
  end function value_of

  real(wp) function free_disk(path) result(bytes)
    !! Room for files in a folder [B].
    character(len=*), intent(in) :: path
    integer(c_long) :: buffer(words)
    logical :: is_linux

    bytes = unknown_bytes
    inquire (file='/proc/meminfo', exist=is_linux)   ! elsewhere the words mean something else
    if (.not. is_linux .or. storage_size(buffer) < 64) return
    buffer = 0_c_long
    if (posix_statvfs(path//c_null_char, buffer) /= 0_c_int) return
    bytes = real(buffer(fragment_size), wp)*real(buffer(blocks_available), wp)
  end function free_disk

  pure function bytes_text(bytes) result(text)
    !! A size for people: '12 MB', '3.4e5 GB'.
    real(wp), intent(in) :: bytes   !! [B]
    character(len=:), allocatable :: text
    real(wp) :: size
    character(len=2) :: unit

    size = bytes/1.0e6_wp
    unit = 'MB'
    if (size >= 1000.0_wp) then
      size = size/1000.0_wp
      unit = 'GB'
    end if
    text = to_text(size, merge(3, 2, size >= 100.0_wp .and. size < 1000.0_wp))//' '//unit
  end function bytes_text
end module dosui_machine

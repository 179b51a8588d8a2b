!! Files that are written once, like checkpoints, end with a seal: their size and a checksum of
!! every byte. It is checked before anything else looks at the file, so that damage of its
!! structure, too, is found here and not by HDF5.
module dosui_file_seal
  use dosui_kinds, only: i8
  use dosui_checksum, only: checksum_t, combine_checksums
  use dosui_communicator, only: communicator_t
  use dosui_error, only: error_t
  use dosui_file_system, only: input_problem
  implicit none
  private

  public :: seal_file, check_seal

  character(len=8), parameter :: mark = 'dosuiEND'
  integer, parameter :: n_seal = 4        !! words: mark, size of the file before it, two checksums
  integer, parameter :: block = 131072    !! words that a rank reads at once

contains

  subroutine seal_file(comm, path, err)
    !! Puts a seal at the end of a file that is complete and closed. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(i8) :: n_byte, seal(n_seal)
    integer :: unit, status, closed

    closed = 0
    n_byte = size_of(comm, path)
    seal(1) = transfer(mark, 0_i8)
    seal(2) = n_byte
    call sum_file(comm, path, n_byte, seal(3), err)
    seal(4) = sum_of(seal(:3))
    if (comm%is_root() .and. .not. err%failed()) then
      open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
            action='write', position='append', iostat=status)
      if (status == 0) then
        write (unit, iostat=status) seal
        close (unit, iostat=closed)
      end if
      if (status /= 0 .or. closed /= 0) call err%set('cannot write '//path)
    end if
    call comm%agree(err)
  end subroutine seal_file

  subroutine check_seal(comm, path, err)
    !! Is every byte of the file as it was written? Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    integer(i8) :: n_byte, seal(n_seal), found
    character(len=:), allocatable :: reason

    reason = ''
    if (comm%is_root()) reason = input_problem(path)   ! a pipe would wait for ever
    if (reason == 'no such file') call err%set('there is no file '//path)
    if (len(reason) > 0) call err%set('cannot read '//path//': '//reason)
    call comm%agree(err)
    if (err%failed()) return
    n_byte = size_of(comm, path) - 8_i8*n_seal
    seal = 0_i8
    if (comm%is_root() .and. n_byte > 0_i8) call read_seal(path, n_byte, seal)
    call comm%broadcast(seal)
    if (seal(1) /= transfer(mark, 0_i8) .or. seal(2) /= n_byte .or. &
        seal(4) /= sum_of(seal(:3))) then
      call err%set(path//' is damaged or cut short, or was not written by this version of '// &
                   'dosui: it does not end with a checksum')
      return
    end if
    call sum_file(comm, path, n_byte, found, err)
    if (.not. err%failed() .and. found /= seal(3)) then
      call err%set(path//' is damaged: its checksum does not fit')
    end if
  end subroutine check_seal

  subroutine read_seal(path, n_byte, seal)
    !! The last words of a file; zeros if they cannot be read.
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: n_byte       !! before the seal
    integer(i8), intent(out) :: seal(n_seal)
    integer :: unit, status

    seal = 0_i8
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
          action='read', iostat=status)
    if (status /= 0) return
    read (unit, pos=n_byte + 1_i8, iostat=status) seal
    if (status /= 0) seal = 0_i8
    close (unit)
  end subroutine read_seal

  pure integer(i8) function sum_of(words) result(value)
    integer(i8), intent(in) :: words(:)
    type(checksum_t) :: sum

    call sum%add(size(words), words)
    value = sum%value()
  end function sum_of

  integer(i8) function size_of(comm, path) result(n_byte)
    !! Size of a file as root sees it [bytes]; 0 for what is no ordinary file. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path

    n_byte = 0_i8
    if (comm%is_root()) inquire (file=path, size=n_byte)
    call comm%broadcast(n_byte)
  end function size_of

  subroutine sum_file(comm, path, n_byte, value, err)
    !! Checksum of the first bytes of a file; every rank reads its share. Collective.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: n_byte
    integer(i8), intent(out) :: value
    type(error_t), intent(inout) :: err
    type(checksum_t) :: sum(1)
    integer(i8) :: n_word, first, last
    integer :: unit, status

    n_word = n_byte/8_i8
    first = n_word/comm%size*comm%rank + min(int(comm%rank, i8), mod(n_word, int(comm%size, i8)))
    last = first + n_word/comm%size
    if (comm%rank < mod(n_word, int(comm%size, i8))) last = last + 1_i8
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
          action='read', iostat=status)
    if (status == 0) then
      call sum_words(unit, first, last, sum(1), status)
      if (comm%rank == comm%size - 1 .and. status == 0) then
        call sum_rest(unit, 8_i8*n_word, int(n_byte - 8_i8*n_word), sum(1), status)
      end if
      close (unit)
    end if
    if (status /= 0) call err%set('cannot read '//path)
    call comm%agree(err)
    call combine_checksums(comm, sum)
    value = sum(1)%value()
  end subroutine sum_file

  subroutine sum_words(unit, first, last, sum, status)
    !! Adds the words first, …, last - 1 of a file, counted from 0.
    integer, intent(in) :: unit
    integer(i8), intent(in) :: first, last
    type(checksum_t), intent(inout) :: sum
    integer, intent(out) :: status
    integer(i8), allocatable :: words(:)
    integer(i8) :: word
    integer :: n

    status = 0
    allocate (words(int(min(int(block, i8), last - first))))
    do word = first, last - 1_i8, int(block, i8)
      n = int(min(int(block, i8), last - word))
      read (unit, pos=8_i8*word + 1_i8, iostat=status) words(:n)
      if (status /= 0) return
      call sum%add(n, words)
    end do
  end subroutine sum_words

  subroutine sum_rest(unit, n_before, n, sum, status)
    !! Adds the last bytes of a file, fewer than a word.
    integer, intent(in) :: unit, n
    integer(i8), intent(in) :: n_before   !! bytes
    type(checksum_t), intent(inout) :: sum
    integer, intent(out) :: status
    character(len=n) :: rest

    status = 0
    if (n == 0) return
    read (unit, pos=n_before + 1_i8, iostat=status) rest
    if (status == 0) call sum%add_text(rest)
  end subroutine sum_rest
end module dosui_file_seal

!! Checkpoints read back: bit for bit on the same ranks, whole on any others, never half a file.
module test_checkpoint
  use pfunit
  use mpi_f08, only: MPI_COMM_SELF
  use dosui_kinds, only: wp, i8
  use dosui_error, only: error_t
  use dosui_communicator, only: communicator_t
  use dosui_point_set, only: point_set_t
  use dosui_checkpoint, only: checkpoint_writer_t, checkpoint_reader_t
  implicit none

contains

  subroutine start(this, comm)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t), intent(inout) :: comm

    comm%handle%mpi_val = this%getMpiCommunicator()
    call comm%init(comm%handle)
  end subroutine start

  subroutine register(set)
    !! Two fields that are kept and one that is not.
    type(point_set_t), intent(inout) :: set
    integer :: handle

    handle = set%add_field('position', 'm', 2, .true., .true., .false., .true.)
    handle = set%add_field('scratch', '', 1, .true., .false., .false., .false.)
    handle = set%add_field('pore_pressure', 'Pa', 1, .true., .true., .true., .true.)
  end subroutine register

  subroutine fill(set, rank, n)
    !! n points with ids in no order and values that use every bit.
    type(point_set_t), intent(inout) :: set
    integer, intent(in) :: rank, n
    integer :: i

    call register(set)
    call set%resize(n)
    do i = 1, n
      set%id(i) = 1000_i8*rank + mod(7*i, 11)
      set%field(1)%values(:, i) = [value_of(rank, i)/3.0_wp, -0.0_wp]
      set%field(2)%values(1, i) = 1.0_wp
      set%field(3)%values(1, i) = value_of(rank, i)
    end do
  end subroutine fill

  pure real(wp) function value_of(rank, i) result(value)
    integer, intent(in) :: rank, i

    value = sqrt(real(100*rank + i, wp))*10.0_wp**(i - 4)
  end function value_of

  pure logical function same_bits(a, b) result(same)
    real(wp), intent(in) :: a, b

    same = transfer(a, 0_i8) == transfer(b, 0_i8)
  end function same_bits

  subroutine write_time(comm, path, time, err)
    !! A checkpoint of one number.
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    real(wp), intent(in) :: time
    type(error_t), intent(inout) :: err
    type(checkpoint_writer_t) :: writer

    call writer%begin(comm, path, 'scene', 'hash', err)
    call writer%write_values(comm, 'time', [time], err)
    call writer%finish(comm, err)
  end subroutine write_time

  real(wp) function time_in(comm, path, err) result(time)
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    type(error_t), intent(inout) :: err
    type(checkpoint_reader_t) :: reader
    real(wp), allocatable :: values(:)

    time = -1.0_wp
    call reader%begin(comm, path, err)
    if (err%failed()) return
    call reader%read_values(comm, 'time', values, err)
    if (size(values) == 1) time = values(1)
    call reader%finish(comm, err)
  end function time_in

  subroutine remove(comm, path)
    type(communicator_t), intent(in) :: comm
    character(len=*), intent(in) :: path
    integer :: unit
    logical :: exists

    if (comm%is_root()) then
      inquire (file=path, exist=exists)
      if (exists) then
        open (newunit=unit, file=path, status='old')
        close (unit, status='delete')
      end if
    end if
    call comm%barrier()
  end subroutine remove

  !@test(npes=[1, 2, 3, 4])
  subroutine the_same_ranks_get_their_points_bit_for_bit(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(checkpoint_writer_t) :: writer
    type(checkpoint_reader_t) :: reader
    type(point_set_t) :: written, read_back
    type(error_t) :: err
    real(wp), allocatable :: values(:)
    integer :: i, n

    call start(this, comm)
    n = mod(5*comm%rank, 7)
    if (comm%size == 1) n = 6
    call fill(written, comm%rank, n)
    call writer%begin(comm, 'test_checkpoint.h5', '&scene /', 'cafe', err)
    call writer%write_values(comm, 'time', [1.0_wp/3.0_wp], err)
    call writer%write_values(comm, 'many', [1.0_wp, tiny(1.0_wp), -0.0_wp], err)
    call writer%write_values(comm, 'none', [real(wp) ::], err)
    call writer%write_set(comm, 'particles', written, err)
    call writer%finish(comm, err)
#line 125 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 125) )
  if (anyExceptions()) return
#line 126 "/work/main/tests/unit/io/test_checkpoint.pf"

    call register(read_back)
    call reader%begin(comm, 'test_checkpoint.h5', err)
#line 129 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(reader%same_ranks, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 129) )
  if (anyExceptions()) return
#line 130 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 130 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual('&scene /', reader%scene_text, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 130) )
  if (anyExceptions()) return
#line 131 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 131 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual('cafe', reader%git_hash, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 131) )
  if (anyExceptions()) return
#line 132 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%read_set(comm, 'particles', read_back, err)
    call reader%read_values(comm, 'time', values, err)
#line 134 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(1.0_wp/3.0_wp, values(1)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 134) )
  if (anyExceptions()) return
#line 135 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%read_values(comm, 'many', values, err)
#line 136 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(3, size(values), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 136) )
  if (anyExceptions()) return
#line 137 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 137 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(tiny(1.0_wp), values(2)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 137) )
  if (anyExceptions()) return
#line 138 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 138 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(-0.0_wp, values(3)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 138) )
  if (anyExceptions()) return
#line 139 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%read_values(comm, 'none', values, err)
#line 140 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(0, size(values), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 140) )
  if (anyExceptions()) return
#line 141 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 141 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(reader%has_values('time'), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 141) )
  if (anyExceptions()) return
#line 142 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 142 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(reader%has_values('step'), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 142) )
  if (anyExceptions()) return
#line 143 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%finish(comm, err)
#line 144 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 144) )
  if (anyExceptions()) return
#line 145 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 145 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(n, read_back%count, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 145) )
  if (anyExceptions()) return
#line 146 "/work/main/tests/unit/io/test_checkpoint.pf"
    do i = 1, n
#line 147 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(written%id(i), read_back%id(i), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 147) )
  if (anyExceptions()) return
#line 148 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 148 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(written%field(1)%values(1, i), read_back%field(1)%values(1, i)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 148) )
  if (anyExceptions()) return
#line 149 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 149 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(-0.0_wp, read_back%field(1)%values(2, i)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 149) )
  if (anyExceptions()) return
#line 150 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 150 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(same_bits(written%field(3)%values(1, i), read_back%field(3)%values(1, i)), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 150) )
  if (anyExceptions()) return
#line 151 "/work/main/tests/unit/io/test_checkpoint.pf"
    end do
  end subroutine the_same_ranks_get_their_points_bit_for_bit

  !@test(npes=[2, 3, 4])
  subroutine other_ranks_share_the_points(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm, alone
    type(checkpoint_writer_t) :: writer
    type(checkpoint_reader_t) :: reader
    type(point_set_t) :: written, read_back
    type(error_t) :: err
    integer, parameter :: n = 10
    integer :: i, first

    call start(this, comm)
    call fill(written, 3, n)
    if (comm%is_root()) then
      call alone%init(MPI_COMM_SELF)
      call writer%begin(alone, 'test_checkpoint_one.h5', '', '', err)
      call writer%write_set(alone, 'particles', written, err)
      call writer%finish(alone, err)
    end if
#line 173 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 173) )
  if (anyExceptions()) return
#line 174 "/work/main/tests/unit/io/test_checkpoint.pf"
    call comm%barrier()
    call register(read_back)
    call reader%begin(comm, 'test_checkpoint_one.h5', err)
#line 177 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(reader%same_ranks, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 177) )
  if (anyExceptions()) return
#line 178 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 178 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(1, reader%n_ranks, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 178) )
  if (anyExceptions()) return
#line 179 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%read_set(comm, 'particles', read_back, err)
    call reader%finish(comm, err)
#line 181 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 181) )
  if (anyExceptions()) return
#line 182 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 182 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(n, comm%sum(read_back%count), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 182) )
  if (anyExceptions()) return
#line 183 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 183 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertLessThanOrEqual(abs(read_back%count - n/comm%size), 1, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 183) )
  if (anyExceptions()) return
#line 184 "/work/main/tests/unit/io/test_checkpoint.pf"
    first = int(comm%prefix_sum(int(read_back%count, i8)))
    do i = 1, read_back%count
#line 186 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(written%id(first + i), read_back%id(i), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 186) )
  if (anyExceptions()) return
#line 187 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 187 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(written%field(3)%values(1, first + i), read_back%field(3)%values(1, i), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 187) )
  if (anyExceptions()) return
#line 188 "/work/main/tests/unit/io/test_checkpoint.pf"
    end do
  end subroutine other_ranks_share_the_points

  !@test(npes=[1, 2])
  subroutine the_last_two_are_kept(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(error_t) :: err
    logical :: exists

    call start(this, comm)
    call remove(comm, 'test_checkpoint_two.h5')
    call remove(comm, 'test_checkpoint_two.h5.previous')
    call write_time(comm, 'test_checkpoint_two.h5', 1.0_wp, err)
#line 202 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(1.0_wp, time_in(comm, 'test_checkpoint_two.h5', err), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 202) )
  if (anyExceptions()) return
#line 203 "/work/main/tests/unit/io/test_checkpoint.pf"
    inquire (file='test_checkpoint_two.h5.previous', exist=exists)
#line 204 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(exists, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 204) )
  if (anyExceptions()) return
#line 205 "/work/main/tests/unit/io/test_checkpoint.pf"
    call comm%barrier()
    call write_time(comm, 'test_checkpoint_two.h5', 2.0_wp, err)
    call write_time(comm, 'test_checkpoint_two.h5', 3.0_wp, err)
#line 208 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(3.0_wp, time_in(comm, 'test_checkpoint_two.h5', err), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 208) )
  if (anyExceptions()) return
#line 209 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 209 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(2.0_wp, time_in(comm, 'test_checkpoint_two.h5.previous', err), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 209) )
  if (anyExceptions()) return
#line 210 "/work/main/tests/unit/io/test_checkpoint.pf"
    inquire (file='test_checkpoint_two.h5.tmp', exist=exists)
#line 211 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(exists, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 211) )
  if (anyExceptions()) return
#line 212 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 212 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 212) )
  if (anyExceptions()) return
#line 213 "/work/main/tests/unit/io/test_checkpoint.pf"
  end subroutine the_last_two_are_kept

  !@test(npes=[1, 2])
  subroutine a_failed_checkpoint_leaves_the_earlier_ones(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(checkpoint_writer_t) :: writer
    type(error_t) :: err, failure

    call start(this, comm)
    call write_time(comm, 'test_checkpoint_safe.h5', 1.0_wp, err)
    call writer%begin(comm, 'test_checkpoint_safe.h5', '', '', failure)
    call failure%set('the disk is full')
    call writer%write_values(comm, 'time', [2.0_wp], failure)
    call writer%finish(comm, failure)
#line 228 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(failure%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 228) )
  if (anyExceptions()) return
#line 229 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 229 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertEqual(1.0_wp, time_in(comm, 'test_checkpoint_safe.h5', err), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 229) )
  if (anyExceptions()) return
#line 230 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 230 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 230) )
  if (anyExceptions()) return
#line 231 "/work/main/tests/unit/io/test_checkpoint.pf"
  end subroutine a_failed_checkpoint_leaves_the_earlier_ones

  !@test(npes=[1, 2])
  subroutine what_cannot_be_read_is_named(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(checkpoint_writer_t) :: writer
    type(checkpoint_reader_t) :: reader
    type(point_set_t) :: written, more, wider
    type(error_t) :: err
    real(wp), allocatable :: values(:)
    integer :: handle

    call start(this, comm)
    call fill(written, comm%rank, 4)
    call writer%begin(comm, 'test_checkpoint_lack.h5', '', '', err)
    call writer%write_set(comm, 'particles', written, err)
    call writer%finish(comm, err)
    call reader%begin(comm, 'test_checkpoint_lack.h5', err)
#line 250 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 250) )
  if (anyExceptions()) return
#line 251 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%read_values(comm, 'time', values, err)
#line 252 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 252) )
  if (anyExceptions()) return
#line 253 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 253 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, "'time'") > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 253) )
  if (anyExceptions()) return
#line 254 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()
    call register(more)
    handle = more%add_field('affine', '1/s', 4, .true., .false., .false., .true.)
    call reader%read_set(comm, 'particles', more, err)
#line 258 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 258) )
  if (anyExceptions()) return
#line 259 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 259 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, "'affine'") > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 259) )
  if (anyExceptions()) return
#line 260 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()
    handle = wider%add_field('position', 'm', 3, .true., .true., .false., .true.)
    call reader%read_set(comm, 'particles', wider, err)
#line 263 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 263) )
  if (anyExceptions()) return
#line 264 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 264 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, "'position'") > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 264) )
  if (anyExceptions()) return
#line 265 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()
    call reader%read_set(comm, 'surface', more, err)
#line 267 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 267) )
  if (anyExceptions()) return
#line 268 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 268 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, "'surface'") > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 268) )
  if (anyExceptions()) return
#line 269 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()
    call reader%finish(comm, err)
#line 271 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 271) )
  if (anyExceptions()) return
#line 272 "/work/main/tests/unit/io/test_checkpoint.pf"
  end subroutine what_cannot_be_read_is_named

  !@test(npes=[1, 2])
  subroutine a_broken_file_is_refused(this)
    class(MpiTestMethod), intent(inout) :: this
    type(communicator_t) :: comm
    type(checkpoint_reader_t) :: reader
    type(error_t) :: err
    character(len=1), allocatable :: bytes(:)
    integer :: unit, n

    call start(this, comm)
    call remove(comm, 'test_checkpoint_none.h5')
    call reader%begin(comm, 'test_checkpoint_none.h5', err)
#line 286 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 286) )
  if (anyExceptions()) return
#line 287 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 287 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, 'test_checkpoint_none.h5') > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 287) )
  if (anyExceptions()) return
#line 288 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()

    call write_time(comm, 'test_checkpoint_cut.h5', 1.0_wp, err)
    if (comm%is_root()) then
      open (newunit=unit, file='test_checkpoint_cut.h5', access='stream', form='unformatted')
      inquire (unit=unit, size=n)
      allocate (bytes(n))
      read (unit) bytes
      close (unit)
      open (newunit=unit, file='test_checkpoint_cut.h5', access='stream', form='unformatted', status='replace')
      write (unit) bytes(:n/2)
      close (unit)
    end if
    call comm%barrier()
#line 302 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertFalse(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 302) )
  if (anyExceptions()) return
#line 303 "/work/main/tests/unit/io/test_checkpoint.pf"
    call reader%begin(comm, 'test_checkpoint_cut.h5', err)
#line 304 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 304) )
  if (anyExceptions()) return
#line 305 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 305 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, 'test_checkpoint_cut.h5') > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 305) )
  if (anyExceptions()) return
#line 306 "/work/main/tests/unit/io/test_checkpoint.pf"
    call err%clear()

    if (comm%is_root()) then
      open (newunit=unit, file='test_checkpoint_text.h5', status='replace')
      write (unit, '(a)') 'this is no checkpoint'
      close (unit)
    end if
    call comm%barrier()
    call reader%begin(comm, 'test_checkpoint_text.h5', err)
#line 315 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(err%failed(), &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 315) )
  if (anyExceptions()) return
#line 316 "/work/main/tests/unit/io/test_checkpoint.pf"
#line 316 "/work/main/tests/unit/io/test_checkpoint.pf"
  call assertTrue(index(err%message, 'test_checkpoint_text.h5') > 0, &
 & location=SourceLocation( &
 & 'test_checkpoint.pf', &
 & 316) )
  if (anyExceptions()) return
#line 317 "/work/main/tests/unit/io/test_checkpoint.pf"
  end subroutine a_broken_file_is_refused
end module test_checkpoint

module Wraptest_checkpoint
   use FUnit
   use test_checkpoint
   implicit none
   private

contains


end module Wraptest_checkpoint

function test_checkpoint_suite() result(suite)
   use FUnit
   use test_checkpoint
   use Wraptest_checkpoint
   implicit none
   type (TestSuite) :: suite

   class (Test), allocatable :: t

   suite = TestSuite('test_checkpoint_suite')

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_same_ranks_get_their_points_bit_for_bit', &
      the_same_ranks_get_their_points_bit_for_bit, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_same_ranks_get_their_points_bit_for_bit', &
      the_same_ranks_get_their_points_bit_for_bit, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_same_ranks_get_their_points_bit_for_bit', &
      the_same_ranks_get_their_points_bit_for_bit, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_same_ranks_get_their_points_bit_for_bit', &
      the_same_ranks_get_their_points_bit_for_bit, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('other_ranks_share_the_points', &
      other_ranks_share_the_points, 2))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('other_ranks_share_the_points', &
      other_ranks_share_the_points, 3))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('other_ranks_share_the_points', &
      other_ranks_share_the_points, 4))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_last_two_are_kept', &
      the_last_two_are_kept, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('the_last_two_are_kept', &
      the_last_two_are_kept, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_failed_checkpoint_leaves_the_earlier_ones', &
      a_failed_checkpoint_leaves_the_earlier_ones, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_failed_checkpoint_leaves_the_earlier_ones', &
      a_failed_checkpoint_leaves_the_earlier_ones, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('what_cannot_be_read_is_named', &
      what_cannot_be_read_is_named, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('what_cannot_be_read_is_named', &
      what_cannot_be_read_is_named, 2))
   call suite%addTest(t)

   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_broken_file_is_refused', &
      a_broken_file_is_refused, 1))
   call suite%addTest(t)
   if(allocated(t)) deallocate(t)
   allocate(t, source=MpiTestMethod('a_broken_file_is_refused', &
      a_broken_file_is_refused, 2))
   call suite%addTest(t)


end function test_checkpoint_suite


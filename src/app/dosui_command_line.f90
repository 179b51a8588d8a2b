!! What the user typed after the program's name.
module dosui_command_line
  use dosui_error, only: error_t
  use dosui_text, only: nearest_name, starts_with
  implicit none
  private

  public :: get_arguments, parse_command_line, read_command_line, usage

  integer, parameter, public :: argument_length = 4096   !! the longest path of Linux
  integer, parameter :: option_length = 14
  character(len=option_length), parameter :: options(12) = [character(len=option_length) :: &
                                                 '--check', '--template', '--output', '--restart', &
                                                            '--continue', '--combinations', &
                                                            '--docs', '--elements', &
                                                            '--safety', '--version', &
                                                            '--help', '-h']

  type, public :: command_line_t
    character(len=:), allocatable :: scene      !! path of the namelist, '' if not given
    character(len=:), allocatable :: output     !! folder for all files, '' if not given
    character(len=:), allocatable :: restart    !! path of a checkpoint, '' if not given
    character(len=:), allocatable :: docs       !! folder for the pages of the manual, '' if none
    integer :: dimension = 0                    !! of the template, 0 if not given
    logical :: is_continued = .false.           !! go on from the run's own checkpoint, if any
    logical :: is_check = .false.
    logical :: is_combinations = .false.
    logical :: is_elements = .false.
    logical :: is_safety = .false.
    character(len=:), allocatable :: pressure   !! confining, of element tests, '' if not given
    logical :: is_template = .false.
    logical :: is_version = .false.
    logical :: is_help = .false.
  contains
    procedure :: is_run => command_line_is_run
  end type command_line_t

contains

  pure function usage() result(text)
    !! What --help prints.
    character(len=:), allocatable :: text
    character(len=1), parameter :: newline = new_line('a')

    text = 'usage: dosui [options] scene.nml                  on one processor core'//newline// &
           '       mpirun -n 4 dosui [options] scene.nml      on four'//newline// &
           newline// &
           '  --check            read and check the scene, print everything that is wrong'// &
           newline// &
           '  --output DIR       write the files there instead of where the scene says'//newline// &
           '  --restart FILE     go on from a checkpoint; with --check or --safety: look at '// &
           'its state'//newline// &
           '  --continue         go on from the last checkpoint of this scene in the output '// &
           'folder,'//newline// &
           '                     or start if there is none'//newline// &
           '  --template [1|2|3] print a commented scene that runs, in so many dimensions (2)'// &
           newline// &
           '  --elements[=PA]    print laboratory tests of the scene''s soils as a table, at '// &
           'this confining'//newline// &
           '                     pressure (1e5 Pa)'//newline// &
           '  --safety           print by how much the soils'' strength may fall before the '// &
           'body fails'//newline// &
           '  --combinations     print which integrator and deformation do what, a table with '// &
           'tabs'//newline// &
           '  --version          print the version and how it was built'//newline// &
           '  --help             print this'//newline// &
           newline// &
           'Exit status: 0 finished, 1 failed while running, 2 bad input, 3 stopped early by a '// &
           'signal.'
  end function usage

  subroutine get_arguments(arguments, err)
    !! The arguments of this process, blank-padded.
    character(len=argument_length), allocatable, intent(out) :: arguments(:)
    type(error_t), intent(inout) :: err
    integer :: k, status

    allocate (arguments(command_argument_count()))
    do k = 1, size(arguments)
      call get_command_argument(k, arguments(k), status=status)
      if (status /= 0) call err%set('an argument is too long')
    end do
  end subroutine get_arguments

  subroutine read_command_line(line, err)
    !! What the user typed, sorted.
    type(command_line_t), intent(out) :: line
    type(error_t), intent(inout) :: err
    character(len=argument_length), allocatable :: arguments(:)

    call get_arguments(arguments, err)
    call parse_command_line(arguments, line, err)
  end subroutine read_command_line

  subroutine parse_command_line(arguments, line, err)
    !! Sorts the arguments. `--output DIR` and `--output=DIR` mean the same.
    character(len=*), intent(in) :: arguments(:)
    type(command_line_t), intent(out) :: line
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: option, value
    integer :: k, equals

    line%scene = ''
    line%output = ''
    line%restart = ''
    line%docs = ''
    line%pressure = ''
    k = 0
    do while (k < size(arguments))
      k = k + 1
      option = trim(arguments(k))
      if (.not. starts_with(option, '-')) then
        if (len(option) == 0) call err%set('an argument is empty')
        if (len(line%scene) > 0) call err%set('two scenes are given: '//line%scene//' and '//option)
        line%scene = option
        cycle
      end if
      value = ''
      equals = index(option, '=')
      if (equals > 0) then
        value = option(equals + 1:)
        option = option(:equals - 1)
      end if
      if (takes_value(option) .and. equals == 0) then
        if (k < size(arguments)) value = trim(arguments(k + 1))
        if (starts_with(value, '-')) value = ''
        k = k + 1
      else if (option == '--template' .and. equals == 0 .and. k < size(arguments)) then
        if (.not. starts_with(trim(arguments(k + 1)), '-')) then
          k = k + 1
          value = trim(arguments(k))
        end if
      end if
      call set_option(line, option, value, equals > 0, err)
    end do
    if (line%is_continued .and. len(line%restart) > 0) then
      call err%set('--continue looks for a checkpoint, --restart names one: give one of them')
    end if
    if (.not. err%failed() .and. len(line%scene) == 0 .and. line%is_run()) then
      call err%set('no scene is given (dosui --help explains)')
    end if
  end subroutine parse_command_line

  pure logical function takes_value(option)
    !! Must the option be followed by a value?
    character(len=*), intent(in) :: option

    takes_value = option == '--output' .or. option == '--restart' .or. option == '--docs'
  end function takes_value

  subroutine set_option(line, option, value, has_equals, err)
    !! Takes over one option.
    type(command_line_t), intent(inout) :: line
    character(len=*), intent(in) :: option, value
    logical, intent(in) :: has_equals
    type(error_t), intent(inout) :: err
    character(len=:), allocatable :: nearest

    if (takes_value(option) .and. len(value) == 0) then
      call err%set('the option '//option//' needs a value')
    else if (has_equals .and. .not. takes_value(option) .and. option /= '--template' .and. &
             option /= '--elements' .and. &
             any(options == option)) then
      call err%set('the option '//option//' takes no value')
    end if
    select case (option)
    case ('--check')
      line%is_check = .true.
    case ('--template')
      line%is_template = .true.
      line%dimension = index('123', value)
      if (len(value) == 0) line%dimension = 0
      if (len(value) > 1 .or. (len(value) == 1 .and. line%dimension == 0)) then
        call err%set('--template '//value//': the dimension must be 1, 2 or 3')
      end if
    case ('--combinations')
      line%is_combinations = .true.
    case ('--safety')
      line%is_safety = .true.
    case ('--elements')
      line%is_elements = .true.
      line%pressure = value
    case ('--output')
      line%output = value
    case ('--continue')
      line%is_continued = .true.
    case ('--restart')
      line%restart = value
    case ('--docs')
      line%docs = value
    case ('--version')
      line%is_version = .true.
    case ('--help', '-h')
      line%is_help = .true.
    case default
      nearest = nearest_name(option, options)
      if (len(nearest) > 0) nearest = '; did you mean '//nearest//'?'
      call err%set('unknown option '//option//nearest)
    end select
  end subroutine set_option

  pure logical function command_line_is_run(self) result(is_run)
    !! Is a scene to be run or checked (and not only something to be printed)?
    class(command_line_t), intent(in) :: self

    is_run = .not. (self%is_template .or. self%is_combinations .or. self%is_version .or. &
                    self%is_help) .and. len(self%docs) == 0
  end function command_line_is_run
end module dosui_command_line

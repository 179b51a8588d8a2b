!! Laboratory tests of a scene's soils at one material point, as a table for `dosui-post material`.
module dosui_element_tests
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim, nsig, voigt_slot
  use dosui_error, only: error_t
  use dosui_material_model, only: material_model_t
  use dosui_materials, only: material_set_t
  use dosui_scene, only: scene_t
  use dosui_text, only: to_text
  implicit none
  private

  public :: element_tests

  integer, parameter :: most_iterations = 200
  integer, parameter :: most_rows = 20000          ! of a cyclic test
  real(wp), parameter :: tolerance = 1.0e-9_wp     ! of held stresses over the first one [-]
  real(wp), parameter :: largest_part = 0.05_wp    ! of the amplitude in a step of a cycle [-]
  real(wp), parameter :: largest_step = 1.0e-3_wp, least_step = 1.0e-9_wp   ! strains there [-]
  real(wp), parameter :: reached = 0.995_wp        ! of the amplitude: there a cycle turns [-]
  character(len=1), parameter :: newline = new_line('a')

  type :: test_t
    !! What is done to a sample, step by step.
    character(len=32) :: name = ''
    integer :: n_step = 200
    logical :: holds_stress(nsig) = .false.   !! this component's stress stays as it is
    real(wp) :: strain(nsig) = 0.0_wp         !! largest, of the other components [-]
    integer :: kept_total = 0                 !! undrained: this total stress stays; 0: drained
    integer :: cycles = 0                     !! of a stress; 0: strains grow in n_step steps
    integer :: cycled(2) = 0                  !! that stress less this one (0: none)
    real(wp) :: amplitude = 0.0_wp            !! of it over the confining pressure [-]
  end type test_t

  type :: text_t
    !! A text that grows at its end.
    character(len=:), allocatable :: text
    integer :: length = 0
  contains
    procedure :: append => text_append
  end type text_t

contains

  subroutine element_tests(scene, pressure, table, err)
    !! Tests of all soils from an isotropic stress, as comma-separated lines with a heading.
    type(scene_t), intent(in) :: scene
    real(wp), intent(in) :: pressure                          !! confining, into the sample [Pa]
    character(len=:), allocatable, intent(out) :: table
    type(error_t), intent(inout) :: err
    type(material_set_t) :: materials
    type(test_t), allocatable :: tests(:)
    type(text_t) :: rows
    integer :: m, k

    call rows%append('material,test,step,strain_xx,strain_yy,strain_zz,strain_zx,stress_xx,'// &
                     'stress_yy,stress_zz,stress_zx,pore_pressure'//newline)
    call scene%prepare_materials(materials, uniform=.true.)
    tests = laboratory()
    do m = 1, size(scene%material)
      if (scene%material(m)%rigid) cycle
      do k = 1, size(tests)
        call run_test(materials%item(m)%model, trim(scene%material(m)%name), &
                      scene%material(m)%porosity%constant, pressure, tests(k), rows, err)
      end do
    end do
    table = rows%text(:rows%length)
  end subroutine element_tests

  pure subroutine text_append(self, more)
    !! Adds to the end.
    class(text_t), intent(inout) :: self
    character(len=*), intent(in) :: more
    character(len=:), allocatable :: longer

    if (.not. allocated(self%text)) allocate (character(len=4096) :: self%text)
    if (self%length + len(more) > len(self%text)) then
      allocate (character(len=2*(self%length + len(more))) :: longer)
      longer(:self%length) = self%text(:self%length)
      call move_alloc(longer, self%text)
    end if
    self%text(self%length + 1:self%length + len(more)) = more
    self%length = self%length + len(more)
  end subroutine text_append

  pure function laboratory() result(tests)
    !! The tests; those with shear need a scene with a shear stress.
    type(test_t), allocatable :: tests(:)
    integer :: zx

    allocate (tests(merge(4, 7, ndim == 1)))
    tests(1)%name = 'oedometer'
    tests(1)%strain(3) = -0.1_wp
    tests(2)%name = 'triaxial_drained'
    tests(2)%strain(3) = -0.2_wp
    tests(2)%holds_stress(1:2) = .true.
    tests(3)%name = 'triaxial_undrained'
    tests(3)%strain(1:3) = [0.1_wp, 0.1_wp, -0.2_wp]
    tests(3)%kept_total = 1
    tests(4)%name = 'cyclic_triaxial_undrained'
    tests(4)%strain(1:3) = [0.025_wp, 0.025_wp, -0.05_wp]
    tests(4)%kept_total = 1
    tests(4)%cycles = 10
    tests(4)%cycled = [1, 3]
    tests(4)%amplitude = 0.4_wp
    if (ndim == 1) return
    zx = voigt_slot(1, ndim)
    tests(5)%name = 'simple_shear_drained'
    tests(5)%strain(zx) = 0.3_wp
    tests(5)%holds_stress(3) = .true.
    tests(6)%name = 'simple_shear_undrained'
    tests(6)%strain(zx) = 0.3_wp
    tests(6)%kept_total = 3
    tests(7)%name = 'cyclic_shear_undrained'
    tests(7)%strain(zx) = 0.05_wp
    tests(7)%kept_total = 3
    tests(7)%cycles = 10
    tests(7)%cycled = [zx, 0]
    tests(7)%amplitude = 0.2_wp
  end function laboratory

  subroutine run_test(model, name, porosity, pressure, test, rows, err)
    !! One test of one soil.
    class(material_model_t), intent(in) :: model
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: porosity             !! [-]
    real(wp), intent(in) :: pressure             !! [Pa]
    type(test_t), intent(in) :: test
    type(text_t), intent(inout) :: rows
    type(error_t), intent(inout) :: err
    real(wp) :: stress(nsig), state(model%n_state()), strain(nsig), increment(nsig)
    integer :: k

    stress = 0.0_wp
    stress(1:3) = -pressure
    call model%start_state(porosity, stress, state)
    strain = 0.0_wp
    k = 0
    call add_row()
    if (test%cycles > 0) then
      call cycle_stress()
      return
    end if
    do k = 1, test%n_step
      increment = test%strain/real(test%n_step, wp)
      call load(model, test, pressure, increment, stress, state, err)
      if (err%failed()) return
      strain = strain + increment
      call add_row()
    end do

  contains

    subroutine add_row()
      !! The present state as a row.
      real(wp) :: pore

      pore = 0.0_wp
      if (test%kept_total > 0) pore = stress(test%kept_total) + pressure
      call rows%append(name//','//trim(test%name)//','//to_text(k)//row_of(strain)// &
                       row_of(stress)//','//to_text(pore)//newline)
    end subroutine add_row

    subroutine cycle_stress()
      !! Strains that turn where a stress reaches its amplitude, until they themselves have grown
      !! to their largest values.
      real(wp) :: trial(nsig), trial_state(size(state)), now, after, way, size_of_step, largest
      real(wp) :: amplitude
      integer :: turns

      largest = maxval(abs(test%strain))
      amplitude = test%amplitude*pressure
      way = 1.0_wp
      size_of_step = least_step
      turns = 0
      do while (turns < 2*test%cycles .and. k < most_rows .and. maxval(abs(strain)) < largest)
        size_of_step = min(2.0_wp*size_of_step, largest_step)
        now = way*cycled_stress(stress)
        do   ! a step that neither leaps nor goes too far
          increment = way*size_of_step/largest*test%strain
          trial = stress
          trial_state = state
          call load(model, test, pressure, increment, trial, trial_state, err)
          if (err%failed()) return
          after = way*cycled_stress(trial)
          if (size_of_step <= least_step) exit
          if (after - now <= largest_part*amplitude .and. after <= amplitude) exit
          size_of_step = 0.5_wp*size_of_step
        end do
        stress = trial
        state = trial_state
        strain = strain + increment
        k = k + 1
        call add_row()
        if (after >= reached*amplitude) then
          way = -way
          turns = turns + 1
          size_of_step = max(least_step, size_of_step/64.0_wp)
        end if
      end do
    end subroutine cycle_stress

    pure real(wp) function cycled_stress(of) result(value)
      !! The stress that is cycled [Pa].
      real(wp), intent(in) :: of(nsig)

      value = of(test%cycled(1))
      if (test%cycled(2) > 0) value = value - of(test%cycled(2))
    end function cycled_stress
  end subroutine run_test

  pure function row_of(values) result(text)
    !! xx, yy, zz and zx as text, each after a comma.
    real(wp), intent(in) :: values(nsig)
    character(len=:), allocatable :: text
    real(wp) :: shear

    shear = 0.0_wp
    if (ndim > 1) shear = values(voigt_slot(1, ndim))
    text = ','//to_text(values(1))//','//to_text(values(2))//','//to_text(values(3))//','// &
           to_text(shear)
  end function row_of

  subroutine load(model, test, pressure, increment, stress, state, err)
    !! One increment; strains of components with held stress are found by Newton's iterations.
    class(material_model_t), intent(in) :: model
    type(test_t), intent(in) :: test
    real(wp), intent(in) :: pressure                 !! of the held components [Pa]
    real(wp), intent(inout) :: increment(nsig)
    real(wp), intent(inout) :: stress(nsig), state(:)
    type(error_t), intent(inout) :: err
    real(wp) :: trial(nsig, 1), trial_state(size(state), 1), tangent(nsig, nsig, 1), excess
    real(wp) :: matrix(2, 2), correction(2), residual(2), determinant
    integer :: held(2), n, k, i

    n = 0
    held = 0
    do k = 1, 3
      if (.not. test%holds_stress(k)) cycle
      n = n + 1
      held(n) = k
    end do
    do i = 1, most_iterations
      trial(:, 1) = stress
      trial_state(:, 1) = state
      call model%update_stress(1, reshape(increment, [nsig, 1]), trial, trial_state, err, tangent)
      if (n == 0 .or. err%failed()) exit
      residual = 0.0_wp
      matrix = reshape([1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [2, 2])*model%shear_modulus()
      residual(1:n) = trial(held(1:n), 1) + pressure
      excess = maxval(abs(residual))
      if (excess <= tolerance*pressure) exit
      matrix(1:n, 1:n) = tangent(held(1:n), held(1:n), 1)
      determinant = matrix(1, 1)*matrix(2, 2) - matrix(1, 2)*matrix(2, 1)
      if (.not. abs(determinant) > 1.0e-10_wp*maxval(abs(matrix))**2) then
        call model%tangent(stress, state, tangent(:, :, 1))   ! perfectly plastic: elastic steps
        matrix(1:n, 1:n) = tangent(held(1:n), held(1:n), 1)
        determinant = matrix(1, 1)*matrix(2, 2) - matrix(1, 2)*matrix(2, 1)
      end if
      correction = [residual(1)*matrix(2, 2) - residual(2)*matrix(1, 2), &
                    matrix(1, 1)*residual(2) - matrix(2, 1)*residual(1)]/determinant
      increment(held(1:n)) = increment(held(1:n)) - correction(1:n)
    end do
    stress = trial(:, 1)
    state = trial_state(:, 1)
    call model%take_own_mean(state)
  end subroutine load
end module dosui_element_tests

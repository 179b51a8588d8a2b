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
  real(wp), parameter :: tolerance = 1.0e-9_wp     ! of held stresses over the first one [-]
  character(len=1), parameter :: newline = new_line('a')

  type :: test_t
    !! What is done to a sample, step by step.
    character(len=32) :: name = ''
    integer :: n_step = 200
    logical :: holds_stress(nsig) = .false.   !! this component's stress stays as it is
    real(wp) :: strain(nsig) = 0.0_wp         !! largest, of the other components [-]
    integer :: cycles = 0                     !! 0: monotonic; else back and forth so often
    logical :: is_undrained = .false.         !! the lateral total stress stays: pore pressure
  end type test_t

contains

  subroutine element_tests(scene, pressure, table, err)
    !! Tests of all soils from an isotropic stress, as comma-separated lines with a heading.
    type(scene_t), intent(in) :: scene
    real(wp), intent(in) :: pressure                          !! confining, into the sample [Pa]
    character(len=:), allocatable, intent(out) :: table
    type(error_t), intent(inout) :: err
    type(material_set_t) :: materials
    type(test_t), allocatable :: tests(:)
    integer :: m, k

    table = 'material,test,step,strain_xx,strain_yy,strain_zz,strain_zx,stress_xx,stress_yy,'// &
            'stress_zz,stress_zx,pore_pressure'//newline
    call materials%init(scene%material, err)
    if (err%failed()) return
    tests = laboratory()
    do m = 1, size(scene%material)
      if (scene%material(m)%rigid) cycle
      do k = 1, size(tests)
        call run_test(materials%item(m)%model, trim(scene%material(m)%name), &
                      scene%material(m)%porosity, pressure, tests(k), table, err)
      end do
    end do
  end subroutine element_tests

  pure function laboratory() result(tests)
    !! The tests; those with shear need a scene with a shear stress.
    type(test_t), allocatable :: tests(:)
    integer :: zx

    allocate (tests(merge(3, 6, ndim == 1)))
    tests(1)%name = 'oedometer'
    tests(1)%strain(3) = -0.1_wp
    tests(2)%name = 'triaxial_drained'
    tests(2)%strain(3) = -0.2_wp
    tests(2)%holds_stress(1:2) = .true.
    tests(3)%name = 'triaxial_undrained'
    tests(3)%strain(1:3) = [0.1_wp, 0.1_wp, -0.2_wp]
    tests(3)%is_undrained = .true.
    if (ndim == 1) return
    zx = voigt_slot(1, ndim)
    tests(4)%name = 'simple_shear_drained'
    tests(4)%strain(zx) = 0.3_wp
    tests(4)%holds_stress(3) = .true.
    tests(5)%name = 'simple_shear_undrained'
    tests(5)%strain(zx) = 0.3_wp
    tests(5)%is_undrained = .true.
    tests(6)%name = 'cyclic_shear_undrained'
    tests(6)%strain(zx) = 0.01_wp
    tests(6)%cycles = 10
    tests(6)%n_step = 1000
    tests(6)%is_undrained = .true.
  end function laboratory

  subroutine run_test(model, name, porosity, pressure, test, table, err)
    !! One test of one soil.
    class(material_model_t), intent(in) :: model
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: porosity             !! [-]
    real(wp), intent(in) :: pressure             !! [Pa]
    type(test_t), intent(in) :: test
    character(len=:), allocatable, intent(inout) :: table
    type(error_t), intent(inout) :: err
    real(wp) :: stress(nsig), state(model%n_state()), strain(nsig), increment(nsig), pore
    integer :: k

    stress = 0.0_wp
    stress(1:3) = -pressure
    call model%start_state(porosity, stress, state)
    strain = 0.0_wp
    pore = 0.0_wp
    do k = 0, test%n_step
      if (k > 0) then
        increment = test%strain*(course(test, k) - course(test, k - 1))
        call load(model, test, pressure, increment, stress, state, err)
        if (err%failed()) return
        strain = strain + increment
        if (test%is_undrained) pore = stress(1) + pressure
      end if
      table = table//name//','//trim(test%name)//','//to_text(k)//row_of(strain)//row_of(stress)// &
              ','//to_text(pore)//newline
    end do
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

  pure real(wp) function course(test, step) result(share)
    !! Share of the largest strain at a step: a line, or triangles.
    type(test_t), intent(in) :: test
    integer, intent(in) :: step
    real(wp) :: phase

    share = real(step, wp)/real(test%n_step, wp)
    if (test%cycles == 0) return
    phase = modulo(share*real(test%cycles, wp) + 0.25_wp, 1.0_wp)
    share = 1.0_wp - 4.0_wp*abs(phase - 0.5_wp)
  end function course

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
  end subroutine load
end module dosui_element_tests

!! What pores hold at a pressure: water content, its derivative, and the pressure that the skeleton
!! feels. Saturated scenes hold n (1 + u/K_w); with suction it is n S(u) (1 + u/K_w), and stresses
!! are effective after [Bishop1959] with chi = S.
module dosui_pore_water
  use dosui_kinds, only: wp
  use dosui_model, only: model_t
  implicit none
  private

  public :: add_pressure, bearing_pressure, compressibility_at, content_change, mean_saturation, &
            saturation_at, wet_masses

contains

  function saturation_at(model, pressure) result(saturation)
    !! S of owned particles [-].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: pressure(:)   !! [Pa]
    real(wp) :: saturation(size(pressure))
    integer :: p

    saturation = 1.0_wp
    if (.not. model%unsaturated) return
    do p = 1, size(pressure)
      saturation(p) = model%water%retention(model%material(p))%saturation(pressure(p))
    end do
  end function saturation_at

  function mean_saturation(model, before, after) result(saturation)
    !! S of owned particles in a step, by which their volume changes displace water [-].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: before(:), after(:)   !! [Pa]
    real(wp) :: saturation(size(before))

    saturation = 0.5_wp*(saturation_at(model, before) + saturation_at(model, after))
  end function mean_saturation

  function compressibility_at(model, pressure) result(compressibility)
    !! Derivative of the water content with respect to the pressure [1/Pa].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: pressure(:)   !! [Pa]
    real(wp) :: compressibility(size(pressure))
    integer :: p

    associate (porosity => model%particles%field(model%p%porosity)%values, &
               modulus => model%scene%water%bulk_modulus)
      if (.not. model%unsaturated) then
        compressibility = porosity(1, 1:size(pressure))/modulus
        return
      end if
      do p = 1, size(pressure)
        associate (retention => model%water%retention(model%material(p)))
          compressibility(p) = porosity(1, p)* &
                               (retention%saturation(pressure(p))/modulus + &
                                retention%capacity(pressure(p))*(1.0_wp + pressure(p)/modulus))
        end associate
      end do
    end associate
  end function compressibility_at

  function content_change(model, before, after) result(change)
    !! Change of the water content between two pressures of owned particles [-].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: before(:), after(:)   !! [Pa]
    real(wp) :: change(size(before))

    associate (n => size(before), modulus => model%scene%water%bulk_modulus)
      change = after - before
      if (model%unsaturated) then
        change = modulus*(saturation_at(model, after) - saturation_at(model, before)) + &
                 saturation_at(model, after)*after - saturation_at(model, before)*before
      end if
      change = model%particles%field(model%p%porosity)%values(1, 1:n)*change/modulus
    end associate
  end function content_change

  function bearing_pressure(model) result(pressure)
    !! The share S u of the pore pressures that the skeleton feels, (1, n) [Pa].
    type(model_t), intent(in) :: model
    real(wp), allocatable :: pressure(:, :)

    associate (n => model%particles%count)
      pressure = model%particles%field(model%p%pore_pressure)%values(:, 1:n)
      if (model%unsaturated) pressure(1, :) = pressure(1, :)*saturation_at(model, pressure(1, :))
    end associate
  end function bearing_pressure

  subroutine add_pressure(model, pressure)
    !! Adds increments to the particles' pressures.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: pressure(:)   !! [Pa]

    if (.not. model%coupled) return
    associate (values => model%particles%field(model%p%pore_pressure)%values, &
               n => model%particles%count)
      values(1, 1:n) = values(1, 1:n) + pressure(1:n)
    end associate
  end subroutine add_pressure

  subroutine wet_masses(model, before, after)
    !! Particles weigh what their pores hold.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: before(:), after(:)   !! pressures of owned particles [Pa]
    integer :: n

    if (.not. model%unsaturated) return
    n = size(before)
    associate (field => model%particles%field, h => model%p)
      field(h%mass)%values(1, 1:n) = field(h%mass)%values(1, 1:n) + &
                                     model%scene%water%density*field(h%porosity)%values(1, 1:n)* &
                                     field(h%volume)%values(1, 1:n)* &
                                     (saturation_at(model, after) - saturation_at(model, before))* &
                                     model%scene%mechanics%density_scaling
    end associate
  end subroutine wet_masses
end module dosui_pore_water

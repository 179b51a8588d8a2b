!! The water balance: stored = inflow + supplied + squeezed, each of them measured by itself.
!!
!! Storage comes from the particles' pressures, the skeleton's share from their volume changes, the
!! inflow from the fluxes at surface points. What is missing is what the meshfree operator creates
!! or loses: it is exact for quadratic heads and not conservative by construction. It is measured
!! against the gross flow, all that flowed in, flowed out, was stored, let go or displaced, and is
!! nothing where it is no more than the round-off of heads and pressures.
module dosui_water_balance
  use dosui_kinds, only: wp
  use dosui_head_operator, only: kind_flux
  use dosui_model, only: model_t
  use dosui_pore_water, only: content_change, mean_saturation
  implicit none
  private

  real(wp), parameter :: round_off = 1.0e-13_wp   !! of the heads and pressures of a step [-]
  integer, parameter :: n_scale = 3               !! of `balance_sums`, at its end

  public :: inflow_rate, surface_values, add_to_balance, balance_sums, balance_error, &
            balance_noise, n_scale

contains

  subroutine inflow_rate(model, supply, rate)
    !! Inflow of this rank through each hydraulic condition's surface, and from sources, for the
    !! heads and surface data at hand; then what flows in or out, whatever its sign [m3/s].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: supply    !! from sources, all of this rank's particles [m3/s]
    real(wp), intent(out) :: rate(:)  !! (conditions + 2) [m3/s]
    real(wp) :: flux(model%water%surface_flux%n)
    integer :: p, e, c, gross

    gross = size(rate)
    rate = 0.0_wp
    rate(gross - 1) = supply
    rate(gross) = abs(supply)
    call surface_values(model, flux)
    associate (area => model%surface%field(model%s%area)%values, &
               conditions => model%water%hydraulic_conditions)
      do e = 1, model%water%surface_flux%n
        if (.not. model%water%surface_flux%is_head(e)) cycle
        p = model%water%surface_flux%point(e)
        c = conditions%condition(p)
        rate(c) = rate(c) - model%water%surface_flux%share(e)*area(1, p)*flux(e)
        rate(gross) = rate(gross) + model%water%surface_flux%share(e)*area(1, p)*abs(flux(e))
      end do
      do p = 1, model%surface%count
        c = conditions%condition(p)
        if (c == 0) cycle
        if (conditions%kind(p) /= kind_flux) cycle
        rate(c) = rate(c) - area(1, p)*conditions%datum(p)
        rate(gross) = rate(gross) + area(1, p)*abs(conditions%datum(p))
      end do
      if (.not. allocated(model%water%inertia_flux)) return
      do p = 1, model%surface%count   ! the other part of Darcy's law
        c = conditions%condition(p)
        if (c > 0) rate(c) = rate(c) + area(1, p)*model%water%inertia_flux(p)
      end do
    end associate
  end subroutine inflow_rate

  subroutine surface_values(model, values)
    !! Outward fluxes [m/s] and heads [m] of the pairs of surface points and particles.
    type(model_t), intent(in) :: model
    real(wp), intent(out) :: values(:)   !! (pairs) [m/s or m]

    if (model%unsaturated) then
      call model%water%surface_flux%apply(model%water%head_operator, model%water%head, &
                                          model%water%hydraulic_conditions%datum, values, &
                                          model%water%relative, model%water%point_relative)
    else
      call model%water%surface_flux%apply(model%water%head_operator, model%water%head, &
                                          model%water%hydraulic_conditions%datum, values)
    end if
  end subroutine surface_values

  subroutine add_to_balance(model, inflow, before, after)
    !! Books a step: its inflow, the volume changes at hand, and the changes of pressure.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: inflow(:)              !! of the step, as from `inflow_rate` [m3]
    real(wp), intent(in) :: before(:), after(:)    !! pressures of owned particles [Pa]

    real(wp) :: content(size(before)), volume(size(before))   ! changes of the step [m3]

    associate (balance => model%balance, n => size(before))
      content = model%mesh%water_weight(1:n)*content_change(model, before, after)
      balance%inflow = balance%inflow + inflow
      balance%stored = balance%stored + sum(content)
      balance%moved = balance%moved + sum(abs(content))
      if (.not. model%rigid) then
        volume = model%mesh%water_weight(1:n)*model%water%volume_strain(1:n)* &
                 mean_saturation(model, before, after)
        balance%squeezed = balance%squeezed - sum(volume)
        balance%moved = balance%moved + sum(abs(volume))
      end if
      balance%noise = balance%noise + (round_off*water_at_hand(model, after))**2
    end associate
  end subroutine add_to_balance

  pure real(wp) function water_at_hand(model, pressure) result(volume)
    !! What round-off is a part of: the water that pressures keep stored and displaced, and what
    !! heads would drive through a spacing in the step [m3].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: pressure(:)   !! of owned particles [Pa]
    real(wp) :: softness
    integer :: p

    softness = 0.0_wp
    if (.not. model%rigid) softness = 1.0_wp/model%scales%skeleton_modulus
    volume = sum(model%mesh%water_weight(1:size(pressure))*abs(pressure)* &
                 (model%water%storage%compressibility(1:size(pressure)) + softness))
    do p = 1, model%surface%count
      if (model%water%hydraulic_conditions%condition(p) == 0) cycle
      if (model%water%hydraulic_conditions%kind(p) == kind_flux) cycle
      volume = volume + model%surface%field(model%s%area)%values(1, p)*model%clock%dt* &
               maxval(model%scene%material%hydraulic_conductivity%constant)* &
               abs(model%water%hydraulic_conditions%datum(p))/model%scales%spacing
    end do
  end function water_at_hand

  subroutine balance_sums(model, sums)
    !! Stored, inflow, squeezed, then the inflow of each condition and of the sources, then the
    !! `n_scale` of the error: gross flow through surfaces and within the body, square of the noise
    !! [m3, m3, m6], over all ranks. Collective.
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: sums(:)   !! volumes [m3], at last the square of one [m6]

    associate (balance => model%balance, n => size(model%balance%inflow) - 1)
      sums = [balance%stored, sum(balance%inflow(:n)), balance%squeezed, balance%inflow(:n), &
              balance%inflow(n + 1), balance%moved, balance%noise]
    end associate
    call model%comm%sum_array(sums)
  end subroutine balance_sums

  pure real(wp) function balance_error(sums) result(error)
    !! What is missing in stored = inflow + squeezed, relative to the gross flow [-].
    real(wp), intent(in) :: sums(:)   !! as from `balance_sums` [m3], [m6]
    real(wp) :: missing

    missing = abs(sums(1) - sums(2) - sums(3))
    error = 0.0_wp
    if (missing > balance_noise(sums)) error = missing/sum(sums(size(sums) - 2:size(sums) - 1))
  end function balance_error

  pure real(wp) function balance_noise(sums) result(noise)
    !! Volumes that are round-off only [m3].
    real(wp), intent(in) :: sums(:)   !! as from `balance_sums` [m3], [m6]

    noise = sqrt(sums(size(sums)))
  end function balance_noise
end module dosui_water_balance

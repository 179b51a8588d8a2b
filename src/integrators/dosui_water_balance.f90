!! The water balance: stored = inflow + supplied + squeezed, each of them measured by itself.
!!
!! Storage comes from the particles' pressures, the skeleton's share from their volume changes, the
!! inflow from the fluxes at surface points. What is missing is what the meshfree operator creates
!! or loses: it is exact for quadratic heads and not conservative by construction.
module dosui_water_balance
  use dosui_kinds, only: wp
  use dosui_head_operator, only: kind_flux
  use dosui_model, only: model_t
  use dosui_pore_water, only: content_change, mean_saturation
  implicit none
  private

  real(wp), parameter :: through_flow_share = 1.0e-9_wp   ! of the inflow of one surface [-]

  public :: inflow_rate, surface_values, add_to_balance, balance_sums, balance_error

contains

  subroutine inflow_rate(model, supply, rate)
    !! Inflow of this rank through each hydraulic condition's surface, and from sources, for the
    !! heads and surface data at hand [m3/s].
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: supply    !! from sources, all of this rank's particles [m3/s]
    real(wp), intent(out) :: rate(:)  !! (conditions + 1)
    real(wp) :: flux(model%surface_flux%n)
    integer :: p, e, c

    rate = 0.0_wp
    rate(size(rate)) = supply
    call surface_values(model, flux)
    associate (area => model%surface%field(model%s%area)%values, &
               conditions => model%hydraulic_conditions)
      do e = 1, model%surface_flux%n
        if (.not. model%surface_flux%is_head(e)) cycle
        p = model%surface_flux%point(e)
        c = conditions%condition(p)
        rate(c) = rate(c) - model%surface_flux%share(e)*area(1, p)*flux(e)
      end do
      do p = 1, model%surface%count
        c = conditions%condition(p)
        if (c == 0) cycle
        if (conditions%kind(p) == kind_flux) rate(c) = rate(c) - area(1, p)*conditions%datum(p)
      end do
    end associate
  end subroutine inflow_rate

  subroutine surface_values(model, values)
    !! Outward fluxes [m/s] and heads [m] of the pairs of surface points and particles.
    type(model_t), intent(in) :: model
    real(wp), intent(out) :: values(:)

    if (model%unsaturated) then
      call model%surface_flux%apply(model%head_operator, model%head, &
                                    model%hydraulic_conditions%datum, values, &
                                    model%relative, model%point_relative)
    else
      call model%surface_flux%apply(model%head_operator, model%head, &
                                    model%hydraulic_conditions%datum, values)
    end if
  end subroutine surface_values

  subroutine add_to_balance(model, inflow, before, after)
    !! Books a step: its inflow, the volume changes at hand, and the changes of pressure.
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: inflow(:)              !! of the step, as from `inflow_rate` [m3]
    real(wp), intent(in) :: before(:), after(:)    !! pressures of owned particles [Pa]

    associate (balance => model%balance, n => size(before))
      balance%inflow = balance%inflow + inflow
      balance%stored = balance%stored + dot_product(model%weight(1:n), &
                                                    content_change(model, before, after))
      if (.not. model%rigid) then
        balance%squeezed = balance%squeezed - sum(model%weight(1:n)*model%volume_strain(1:n)* &
                                                  mean_saturation(model, before, after))
      end if
    end associate
  end subroutine add_to_balance

  subroutine balance_sums(model, sums)
    !! Stored, inflow, squeezed, then the inflow of each condition and of the sources [m3], over
    !! all ranks. Collective.
    type(model_t), intent(in) :: model
    real(wp), allocatable, intent(out) :: sums(:)

    associate (balance => model%balance)
      sums = [balance%stored, sum(balance%inflow), balance%squeezed, balance%inflow]
    end associate
    call model%comm%sum_array(sums)
  end subroutine balance_sums

  pure real(wp) function balance_error(sums) result(error)
    !! What is missing in stored = inflow + squeezed, relative to the largest of them [-], or to
    !! the round-off of what only flows through.
    real(wp), intent(in) :: sums(:)   !! as from `balance_sums`
    real(wp) :: largest

    largest = max(maxval(abs(sums(1:3))), through_flow_share*maxval(abs(sums)))
    error = 0.0_wp
    if (largest > 0.0_wp) error = abs(sums(1) - sums(2) - sums(3))/largest
  end function balance_error
end module dosui_water_balance

!! Softening follows means of plastic strains over the width of the soil's shear bands.
!!
!! A strain that is the particle's own makes softening depend on the grid: bands are as narrow as
!! cells. A displacement over the grid's spacing (softening_displacement alone) mends bands, but not
!! what deforms evenly, as all of a flowing mass does: there strains do not depend on the grid. Over
!! a width of the soil both hold (nonlocal plasticity, docs/theory/soils.md).
module dosui_softening_bands
  use dosui_kinds, only: wp
  use dosui_error, only: error_t
  use dosui_model, only: model_t
  use dosui_particle_average, only: average_particles
  implicit none
  private

  public :: average_bands

contains

  subroutine average_bands(model, err)
    !! Means of the strains as they are now, for the next step, soil by soil. After an error on any
    !! rank nothing happens. Collective.
    type(model_t), intent(inout) :: model
    type(error_t), intent(in) :: err
    real(wp), allocatable :: mass(:), mean(:)
    integer :: k, n

    n = model%particles%count
    do k = 1, size(model%materials%item)
      associate (soil => model%materials%item(k)%model, h => model%p)
        if (soil%mean_state == 0) cycle
        if (model%comm%any(err%failed())) return
        associate (state => model%particles%field(h%state)%values)
          mass = merge(model%particles%field(h%mass)%values(1, 1:n), 0.0_wp, &
                       model%material(1:n) == k)
          mean = state(soil%mean_of, 1:n)
          call average_particles(model%comm, model%grid, n, model%mesh%cell, &
                                 model%particles%field(h%position)%values(:, 1:n), mass, &
                                 soil%mean_variance, mean)
          where (model%material(1:n) == k) state(soil%mean_state, 1:n) = mean
        end associate
      end associate
    end do
  end subroutine average_bands
end module dosui_softening_bands

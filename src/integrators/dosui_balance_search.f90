!! Where water is created or lost: the meshfree head operator does not conserve by construction.
!!
!! What particle j gives to i should be what i takes from j. Half of the difference is booked on
!! either of them, and particles belong to the contact of two materials, to the nearest surface
!! whose points are in their rows, or to the inside. What surface points give to rows, less the
!! inflow that is measured there, is booked on their surface, beside a contact on the contact.
!! Besides the sums by place the particle that created or lost most at the last look is known.
module dosui_balance_search
  use dosui_kinds, only: wp, i8
  use dosui_dimension, only: ndim
  use dosui_head_operator, only: head_operator_t
  use dosui_model, only: model_t
  use dosui_surface_sets, only: first_member
  use dosui_text, only: to_text, vector_text
  use dosui_water_balance, only: inflow_rate, surface_values
  use dosui_water_step, only: prepare_flow
  implicit none
  private

  real(wp), parameter :: stands_out = 0.5_wp   !! share of a place that is named alone [-]

  type, public :: balance_search_t
    real(wp), allocatable, private :: created(:)   !! of this rank, by place [m3]
    real(wp), private :: last = 0.0_wp             !! looked at [s]
    real(wp), private :: worst(ndim) = 0.0_wp      !! where a particle created or lost most [m]
  contains
    procedure :: look => search_look
    procedure :: place => search_place
  end type balance_search_t

contains

  subroutine search_look(self, model)
    !! Books what is created at the present rates since the last look. Collective.
    class(balance_search_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: rate(:)
    integer :: n

    if (.not. model%coupled .or. model%scene%water%operator == 'two_pass') return
    n = model%particles%count
    call prepare_flow(model, model%particles%field(model%p%pore_pressure)%values(1, 1:n))
    call created_rates(model, rate, self%worst)
    if (.not. allocated(self%created)) allocate (self%created(size(rate)), source=0.0_wp)
    ! at the start, rates tell the places, too
    self%created = self%created + rate*max(model%clock%time - self%last, &
                                           1.0e-6_wp*model%scene%time%end_time)
    self%last = model%clock%time
  end subroutine search_look

  subroutine created_rates(model, rate, worst)
    !! Water created per time, by place: surfaces, then faces without a name, pairs of materials,
    !! and the inside [m3/s]. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: rate(:)
    real(wp), intent(out) :: worst(ndim)   !! where a particle creates or loses most [m]
    real(wp), allocatable :: pairs(:), inflow(:)
    integer, allocatable :: place(:)       ! of particles
    real(wp) :: given
    integer :: i, k, c, s

    allocate (rate(size(model%scene%surface) + size(model%scene%material)**2 + 2), source=0.0_wp)
    allocate (pairs(model%particles%count + model%particles%ghost_count), source=0.0_wp)
    allocate (inflow(size(model%balance%inflow)))
    call find_places(model, place)
    associate (operator => model%water%head_operator)
      do i = 1, operator%n_row
        do k = operator%row_start(i), operator%row_start(i + 1) - 1
          given = 0.5_wp*model%mesh%water_weight(i)*exchange(model, operator, i, k)
          pairs(i) = pairs(i) + given
          pairs(operator%column(k)) = pairs(operator%column(k)) + given
        end do
        do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
          s = surface_of(model, operator%boundary_point(k))
          if (is_contact(model, place(i))) s = place(i)
          rate(s) = rate(s) + model%mesh%water_weight(i)*boundary_exchange(model, operator, i, k)
        end do
      end do
      call model%water%particle_map%scatter_add(model%comm, 1, pairs)
      do i = 1, operator%n_row
        rate(place(i)) = rate(place(i)) + pairs(i)
      end do
      call find_worst(model, pairs(:operator%n_row), worst)
    end associate
    call inflow_rate(model, 0.0_wp, inflow)
    do c = 1, size(model%water%condition_surface)
      rate(model%water%condition_surface(c)) = rate(model%water%condition_surface(c)) - inflow(c)
    end do
    call move_to_contacts(model, place, rate)
  end subroutine created_rates

  subroutine move_to_contacts(model, place, rate)
    !! Books inflow that fits beside contacts have measured there and not on the surface.
    type(model_t), intent(in) :: model
    integer, intent(in) :: place(:)        !! of particles
    real(wp), intent(inout) :: rate(:)     !! created, by place [m3/s]
    real(wp) :: flux(model%water%surface_flux%n), inflow
    integer :: e, p, s, i

    call surface_values(model, flux)
    do e = 1, model%water%surface_flux%n
      p = model%water%surface_flux%point(e)
      i = model%water%surface_flux%particle(e)
      if (.not. (model%water%surface_flux%is_head(e) .and. is_contact(model, place(i)))) cycle
      s = surface_of(model, p)
      inflow = -model%water%surface_flux%share(e)*model%surface%field(model%s%area)%values(1, p)* &
               flux(e)
      rate(s) = rate(s) + inflow
      rate(place(i)) = rate(place(i)) - inflow
    end do
  end subroutine move_to_contacts

  subroutine find_worst(model, created, worst)
    !! The place of the particle that creates or loses most. Collective.
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: created(:)     !! by particles of this rank [m3/s]
    real(wp), intent(out) :: worst(ndim)   !! [m]
    real(wp), parameter :: alike = 1.0_wp - 1.0e-6_wp   ! the first one of equals is told
    real(wp) :: most
    integer(i8) :: id
    integer :: i

    most = -1.0_wp
    if (size(created) > 0) most = maxval(abs(created))
    most = model%comm%maximum(most)
    id = huge(id)
    do i = 1, size(created)
      if (abs(created(i)) >= alike*most) id = min(id, model%particles%id(i))
    end do
    id = model%comm%minimum(id)
    worst = 0.0_wp
    do i = 1, size(created)
      if (model%particles%id(i) /= id) cycle
      worst = model%particles%field(model%p%current_position)%values(:, i)
    end do
    call model%comm%sum_array(worst)
  end subroutine find_worst

  subroutine find_places(model, place)
    !! Places of this rank's particles. Collective.
    type(model_t), intent(inout) :: model
    integer, allocatable, intent(out) :: place(:)
    real(wp), allocatable :: material(:)   ! ghosts too
    integer :: i

    associate (n => model%particles%count)
      allocate (material(n + model%particles%ghost_count))
      material(1:n) = model%particles%field(model%p%material)%values(1, 1:n)
      call model%water%particle_map%gather(model%comm, 1, material)
      allocate (place(n))
      do i = 1, n
        place(i) = group_of(model, model%water%head_operator, nint(material), i)
      end do
    end associate
  end subroutine find_places

  pure logical function is_contact(model, place)
    !! Is a place the contact of two materials?
    type(model_t), intent(in) :: model
    integer, intent(in) :: place
    integer :: first

    first = size(model%scene%surface) + 1
    is_contact = place > first .and. place <= first + size(model%scene%material)**2
  end function is_contact

  pure real(wp) function exchange(model, operator, i, k) result(rate)
    !! What entry k gives to row i [1/s].
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, k

    associate (j => operator%column(k))
      rate = operator%coefficient(k)*(model%water%head(j) - model%water%head(i))
      if (model%unsaturated) rate = rate*0.5_wp*(model%water%relative(i) + model%water%relative(j))
    end associate
  end function exchange

  pure real(wp) function boundary_exchange(model, operator, i, k) result(rate)
    !! Likewise of a surface point.
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, k

    associate (p => operator%boundary_point(k), datum => model%water%hydraulic_conditions%datum)
      if (.not. operator%boundary_is_head(k)) then
        rate = operator%boundary_weight(k)*datum(p)
        return
      end if
      rate = operator%boundary_weight(k)*(datum(p) - model%water%head(i))
      if (model%unsaturated) rate = rate*0.5_wp*(model%water%relative(i) + &
                                                 model%water%point_relative(p))
    end associate
  end function boundary_exchange

  pure integer function surface_of(model, p) result(s)
    !! Place of a surface point: its condition's surface, its own, or that of faces without a name.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    integer :: c

    c = model%water%hydraulic_conditions%condition(p)
    if (c > 0) then
      s = model%water%condition_surface(c)
    else
      s = first_member(model%surface%field(model%s%surface)%values(:, p))
      if (s <= 0) s = size(model%scene%surface) + 1
    end if
  end function surface_of

  pure integer function group_of(model, operator, material, i) result(g)
    !! Place of a particle: a contact of its material with another one, a surface, or the inside.
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: material(:)   !! of particles and ghosts
    integer, intent(in) :: i
    integer :: k, n, m

    n = size(model%scene%material)
    do k = operator%row_start(i), operator%row_start(i + 1) - 1
      m = material(operator%column(k))
      if (m == material(i)) cycle
      g = size(model%scene%surface) + 1 + n*(min(m, material(i)) - 1) + max(m, material(i))
      return
    end do
    g = size(model%scene%surface) + 2 + n**2   ! the inside
    do k = operator%boundary_start(i + 1) - 1, operator%boundary_start(i), -1
      g = surface_of(model, operator%boundary_point(k))
      if (operator%boundary_is_head(k)) return   ! rather than a face without flow beside it
    end do
  end function group_of

  function search_place(self, model) result(text)
    !! The place that has created or lost most, its share, and where single particles did; '' if
    !! nothing was looked at. Collective.
    class(balance_search_t), intent(in) :: self
    type(model_t), intent(in) :: model
    character(len=:), allocatable :: text
    real(wp), allocatable :: created(:)
    real(wp) :: share

    text = ''
    if (.not. allocated(self%created)) return
    created = self%created
    call model%comm%sum_array(created)
    created = abs(created)
    if (.not. maxval(created) > 0.0_wp) return
    share = maxval(created)/sum(created)
    text = ', most probably at '
    if (share < stands_out) text = '; no place stands out, the largest part is at '
    text = text//place_text(model, maxloc(created, dim=1))//' ('// &
           to_text(100.0_wp*share, 2)//' % of what places create or lose)'// &
           ', among particles most at '//vector_text(self%worst + model%scene%local_origin)//' m'
  end function search_place

  function place_text(model, place) result(text)
    !! A place in words.
    type(model_t), intent(in) :: model
    integer, intent(in) :: place
    character(len=:), allocatable :: text
    integer :: k, n, m

    k = place
    n = size(model%scene%surface)
    m = size(model%scene%material)
    if (k <= n) then
      text = "surface '"//trim(model%scene%surface(k)%name)//"'"
    else if (k == n + 1) then
      text = 'faces that no surface names'
    else if (k <= n + 1 + m**2) then
      k = k - n - 2
      text = "the contact of '"//trim(model%scene%material(k/m + 1)%name)//"' with '"// &
             trim(model%scene%material(mod(k, m) + 1)%name)//"'"
    else
      text = 'the inside of the bodies (particles that are not in order?)'
    end if
  end function place_text
end module dosui_balance_search

!! Where water is created or lost: the meshfree head operator does not conserve by construction.
!!
!! What particle j gives to i should be what i takes from j. Half of the difference is booked on
!! either of them, and particles belong to the nearest surface whose points are in their rows, to
!! the contact of two materials, or to the inside. What surface points give to rows, less the
!! inflow that is measured there, is booked on their surface.
module dosui_balance_search
  use dosui_kinds, only: wp
  use dosui_head_operator, only: head_operator_t
  use dosui_model, only: model_t
  use dosui_surface_sets, only: first_member
  use dosui_water_balance, only: inflow_rate
  use dosui_water_step, only: prepare_flow
  implicit none
  private

  type, public :: balance_search_t
    real(wp), allocatable, private :: created(:)   !! of this rank, by place [m3]
    real(wp), private :: last = 0.0_wp             !! looked at [s]
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
    call created_rates(model, rate)
    if (.not. allocated(self%created)) allocate (self%created(size(rate)), source=0.0_wp)
    ! at the start, rates tell the places, too
    self%created = self%created + rate*max(model%clock%time - self%last, &
                                           1.0e-6_wp*model%scene%time%end_time)
    self%last = model%clock%time
  end subroutine search_look

  subroutine created_rates(model, rate)
    !! Water created per time, by place: surfaces, then faces without a name, pairs of materials,
    !! and the inside [m3/s]. Collective.
    type(model_t), intent(inout) :: model
    real(wp), allocatable, intent(out) :: rate(:)
    real(wp), allocatable :: pairs(:), inflow(:)
    real(wp) :: given
    integer :: i, k, c, s

    allocate (rate(size(model%scene%surface) + size(model%scene%material)**2 + 2), source=0.0_wp)
    allocate (pairs(model%particles%count + model%particles%ghost_count), source=0.0_wp)
    allocate (inflow(size(model%balance%inflow)))
    associate (operator => model%head_operator)
      do i = 1, operator%n_row
        do k = operator%row_start(i), operator%row_start(i + 1) - 1
          given = 0.5_wp*model%weight(i)*exchange(model, operator, i, k)
          pairs(i) = pairs(i) + given
          pairs(operator%column(k)) = pairs(operator%column(k)) + given
        end do
        do k = operator%boundary_start(i), operator%boundary_start(i + 1) - 1
          s = surface_of(model, operator%boundary_point(k))
          rate(s) = rate(s) + model%weight(i)*boundary_exchange(model, operator, i, k)
        end do
      end do
      call model%particle_map%scatter_add(model%comm, 1, pairs)
      do i = 1, operator%n_row
        s = group_of(model, operator, i)
        rate(s) = rate(s) + pairs(i)
      end do
    end associate
    call inflow_rate(model, 0.0_wp, inflow)
    do c = 1, size(model%condition_surface)
      rate(model%condition_surface(c)) = rate(model%condition_surface(c)) - inflow(c)
    end do
  end subroutine created_rates

  pure real(wp) function exchange(model, operator, i, k) result(rate)
    !! What entry k gives to row i [1/s].
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, k

    associate (j => operator%column(k))
      rate = operator%coefficient(k)*(model%head(j) - model%head(i))
      if (model%unsaturated) rate = rate*0.5_wp*(model%relative(i) + model%relative(j))
    end associate
  end function exchange

  pure real(wp) function boundary_exchange(model, operator, i, k) result(rate)
    !! Likewise of a surface point.
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i, k

    associate (p => operator%boundary_point(k), datum => model%hydraulic_conditions%datum)
      if (.not. operator%boundary_is_head(k)) then
        rate = operator%boundary_weight(k)*datum(p)
        return
      end if
      rate = operator%boundary_weight(k)*(datum(p) - model%head(i))
      if (model%unsaturated) rate = rate*0.5_wp*(model%relative(i) + model%point_relative(p))
    end associate
  end function boundary_exchange

  pure integer function surface_of(model, p) result(s)
    !! Place of a surface point: its condition's surface, its own, or that of faces without a name.
    type(model_t), intent(in) :: model
    integer, intent(in) :: p
    integer :: c

    c = model%hydraulic_conditions%condition(p)
    if (c > 0) then
      s = model%condition_surface(c)
    else
      s = first_member(model%surface%field(model%s%surface)%values(:, p))
      if (s <= 0) s = size(model%scene%surface) + 1
    end if
  end function surface_of

  pure integer function group_of(model, operator, i) result(g)
    !! Place of a particle: a contact of its material with another one, a surface, or the inside.
    type(model_t), intent(in) :: model
    type(head_operator_t), intent(in) :: operator
    integer, intent(in) :: i
    integer :: k, j, n, m

    n = size(model%scene%material)
    do k = operator%row_start(i), operator%row_start(i + 1) - 1
      j = operator%column(k)
      if (j > model%particles%count) cycle   ! ghosts bring no material along
      m = model%material(j)
      if (m == model%material(i)) cycle
      g = size(model%scene%surface) + 1 + n*(min(m, model%material(i)) - 1) + &
          max(m, model%material(i))
      return
    end do
    g = size(model%scene%surface) + 2 + n**2   ! the inside
    do k = operator%boundary_start(i + 1) - 1, operator%boundary_start(i), -1
      g = surface_of(model, operator%boundary_point(k))
      if (operator%boundary_is_head(k)) return   ! rather than a face without flow beside it
    end do
  end function group_of

  function search_place(self, model) result(text)
    !! The place that has created or lost most; '' if none stands out. Collective.
    class(balance_search_t), intent(in) :: self
    type(model_t), intent(in) :: model
    character(len=:), allocatable :: text
    real(wp), allocatable :: created(:)
    integer :: k, n, m

    text = ''
    if (.not. allocated(self%created)) return
    created = self%created
    call model%comm%sum_array(created)
    if (.not. maxval(abs(created)) > 0.0_wp) return
    k = maxloc(abs(created), dim=1)
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
  end function search_place
end module dosui_balance_search

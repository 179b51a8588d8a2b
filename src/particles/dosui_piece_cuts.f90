!! Pieces of surface cut by the cells of the grid: the integrals of each cell's corner hats over the
!! part of a piece that lies in it.
!!
!! Stresses end where the body does, cell by cell, with the hats of every cell's own corners.
!! Tractions balance them only if they are integrated in the same way: a piece is cut at the planes
!! of the grid, and every part has as many Gauss points as the hats' degree on a plane asks: two on
!! a line, a rule of degree 4 on the triangles of a polygon. The sums are exact.
module dosui_piece_cuts
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_geometry, only: clip_outline
  use dosui_shape_functions, only: corner_hats
  implicit none
  private

  public :: cut_piece, most_cells, square_edges

  integer, parameter :: along = max(ndim - 1, 1)   ! edges of a piece
  integer, parameter :: second = min(2, along)     ! the second of them in 3-D
  real(wp), parameter :: inward = 1.0e-9_wp   !! the cell of a piece lies inside it [cells]
  real(wp), parameter :: no_part = 1.0e-14_wp  !! of a piece [-]

contains

  pure integer function most_cells(place, normal, edge) result(n)
    !! Cells that a piece can lie in, at most.
    real(wp), intent(in) :: place(ndim)           !! its middle, in cells from the origin [-]
    real(wp), intent(in) :: normal(ndim)          !! outward [-]
    real(wp), intent(in) :: edge(ndim, along)     !! that span it [cells]
    integer :: low(ndim), high(ndim)

    call cell_range(place - inward*normal, edge, low, high)
    n = product(high - low + 1)
  end function most_cells

  pure subroutine cell_range(place, edge, low, high)
    !! Lowest and highest cells of a piece's box.
    real(wp), intent(in) :: place(ndim)
    real(wp), intent(in) :: edge(ndim, along)
    integer, intent(out) :: low(ndim), high(ndim)
    real(wp) :: reach(ndim)

    reach = 0.0_wp
    if (ndim > 1) reach = 0.5_wp*sum(abs(edge), dim=2)
    low = floor(place - reach)
    high = floor(place + reach)
  end subroutine cell_range

  pure subroutine cut_piece(place, normal, edge, n, base, weight)
    !! Cells of a piece, and the integrals of their corner hats over it, over its area.
    real(wp), intent(in) :: place(ndim)           !! its middle, in cells from the origin [-]
    real(wp), intent(in) :: normal(ndim)          !! outward [-]
    real(wp), intent(in) :: edge(ndim, along)     !! that span it; unused in 1-D [cells]
    integer, intent(out) :: n                     !! cells
    integer, intent(out) :: base(:, :)            !! (ndim, most_cells) integer coordinates
    real(wp), intent(out) :: weight(:, :)         !! (2**ndim, most_cells) x fastest [-]
    real(wp) :: inside(ndim), part(2**ndim)
    integer :: low(ndim), high(ndim), cell(ndim), k, d, rest

    inside = place - inward*normal
    call cell_range(inside, edge, low, high)
    n = 0
    do k = 0, product(high - low + 1) - 1
      rest = k
      do d = 1, ndim
        cell(d) = low(d) + mod(rest, high(d) - low(d) + 1)
        rest = rest/(high(d) - low(d) + 1)
      end do
      if (ndim == 1) then
        part = corner_hats(place - cell)
      else if (ndim == 2) then
        call integrate_line(place - cell, inside - cell, edge(:, 1), part)
      else
        call integrate_polygon(place - cell, inside - cell, edge, part)
      end if
      if (.not. sum(part) > no_part) cycle
      n = n + 1
      base(:, n) = cell
      weight(:, n) = part
    end do
  end subroutine cut_piece

  pure subroutine integrate_line(place, inside, edge, part)
    !! 2-D: the share of a line in the unit cell, by two Gauss points.
    real(wp), intent(in) :: place(ndim), inside(ndim)   !! its middle, and that moved inwards
    real(wp), intent(in) :: edge(ndim)
    real(wp), intent(out) :: part(2**ndim)
    real(wp) :: from, to, one, other, t
    integer :: d, g

    from = -0.5_wp
    to = 0.5_wp
    do d = 1, ndim
      if (abs(edge(d)) > tiny(1.0_wp)) then
        one = -inside(d)/edge(d)
        other = (1.0_wp - inside(d))/edge(d)
        from = max(from, min(one, other))
        to = min(to, max(one, other))
      else if (inside(d) < 0.0_wp .or. inside(d) >= 1.0_wp) then
        to = from
      end if
    end do
    part = 0.0_wp
    if (.not. to > from) return
    do g = -1, 1, 2
      t = 0.5_wp*(from + to + real(g, wp)*(to - from)/sqrt(3.0_wp))
      part = part + 0.5_wp*(to - from)*corner_hats(place + t*edge)
    end do
  end subroutine integrate_line

  pure subroutine integrate_polygon(place, inside, edge, part)
    !! 3-D: the share of a parallelogram in the unit cell, by triangles with 6 points each, exact
    !! for degree 4 [Dunavant1985].
    real(wp), intent(in) :: place(ndim), inside(ndim)   !! its middle, and that moved inwards
    real(wp), intent(in) :: edge(ndim, along)
    real(wp), intent(out) :: part(2**ndim)
    real(wp), parameter :: share(2) = [0.223381589678011465951_wp, 0.109951743655321867382_wp], &
                           corner(2) = [0.445948490915964886319_wp, 0.091576213509770743460_wp]
    real(wp) :: outline(ndim, 16), side(ndim, 2), whole, size_of
    integer :: n, d, k, g, c

    n = 4
    outline(:, 1) = inside - 0.5_wp*(edge(:, 1) + edge(:, second))
    outline(:, 2) = inside + 0.5_wp*(edge(:, 1) - edge(:, second))
    outline(:, 3) = inside + 0.5_wp*(edge(:, 1) + edge(:, second))
    outline(:, 4) = inside - 0.5_wp*(edge(:, 1) - edge(:, second))
    do d = 1, ndim
      call clip_outline(d, 0.0_wp, 1.0_wp, n, outline)
      call clip_outline(d, 1.0_wp, -1.0_wp, n, outline)
    end do
    part = 0.0_wp
    if (n < 3) return
    do k = 1, n
      outline(:, k) = outline(:, k) + (place - inside)
    end do
    whole = area_of(edge(:, 1), edge(:, second))
    do k = 2, n - 1
      side(:, 1) = outline(:, k) - outline(:, 1)
      side(:, 2) = outline(:, k + 1) - outline(:, 1)
      size_of = 0.5_wp*area_of(side(:, 1), side(:, 2))/whole
      do g = 1, 2
        do c = 1, 3
          associate (one => merge(1.0_wp - 2.0_wp*corner(g), corner(g), c == 1), &
                     two => merge(1.0_wp - 2.0_wp*corner(g), corner(g), c == 2))
            part = part + size_of*share(g)*corner_hats(outline(:, 1) + one*side(:, 1) + &
                                                       two*side(:, 2))
          end associate
        end do
      end do
    end do
  end subroutine integrate_polygon

  pure real(wp) function area_of(a, b) result(area)
    !! Of the parallelogram that two vectors span.
    real(wp), intent(in) :: a(ndim), b(ndim)

    area = sqrt(max(0.0_wp, dot_product(a, a)*dot_product(b, b) - dot_product(a, b)**2))
  end function area_of

  pure subroutine square_edges(normal, area, edge)
    !! Edges of a square about a piece whose own are not known, or of a line in 2-D.
    real(wp), intent(in) :: normal(ndim)   !! [-]
    real(wp), intent(in) :: area           !! [m2, m in 2-D]
    real(wp), intent(out) :: edge(ndim, along)   !! [m]
    integer :: steep

    edge = 0.0_wp
    if (ndim == 1) return
    if (ndim == 2) then
      edge(1, 1) = -area*normal(ndim)
      edge(ndim, 1) = area*normal(1)
      return
    end if
    steep = minloc(abs(normal), dim=1)   ! a direction well off the normal
    edge(:, 1) = -normal(steep)*normal
    edge(steep, 1) = edge(steep, 1) + 1.0_wp
    edge(:, 1) = edge(:, 1)*(sqrt(area)/norm2(edge(:, 1)))
    edge(1, second) = normal(second)*edge(ndim, 1) - normal(ndim)*edge(second, 1)
    edge(second, second) = normal(ndim)*edge(1, 1) - normal(1)*edge(ndim, 1)
    edge(ndim, second) = normal(1)*edge(second, 1) - normal(second)*edge(1, 1)
  end subroutine square_edges
end module dosui_piece_cuts

!! Ties that hold nodes which no cell with soil has at its corners: hats beyond the body, touched by
!! a few particles only. Means of cells do not feel them and deviations need not, so that some of
!! their motions do no work. Each is tied to where the corner hats of a touching particle's cell
!! would take it: linear motions cost nothing.
module dosui_weak_ties
  use dosui_kinds, only: wp
  use dosui_dimension, only: ndim
  use dosui_model, only: model_t
  use dosui_shape_functions, only: corner_hats, group_count, n_group, n_group_wide
  implicit none
  private

  real(wp), parameter :: tie_stiffness = 0.1_wp   !! over the shear modulus of their soil [-]

  type, public :: weak_ties_t
    integer :: n = 0
    integer, allocatable :: node(:, :)     !! (1 + 2**ndim, n) tied node, then the cell's corners
    real(wp), allocatable :: weight(:, :)  !! likewise: of the nodes in the gap [-]
    real(wp), allocatable :: spring(:)     !! (n) [N/m]
  contains
    procedure :: find => ties_find
    procedure :: add_forces => ties_add_forces
  end type weak_ties_t

contains

  subroutine ties_find(self, model)
    !! Ties of this rank's particles to nodes beyond the cells. Collective.
    class(weak_ties_t), intent(inout) :: self
    type(model_t), intent(inout) :: model
    real(wp), allocatable :: is_corner(:, :), weight(:), gradient(:)
    real(wp) :: offset(ndim)
    integer :: c, p, i, d, n_groups, width, pass
    logical :: is_tie

    allocate (is_corner(1, model%grid%n_node), source=0.0_wp)
    do p = 1, model%particles%count
      is_corner(1, model%grid%cell_node(:, model%cell(p))) = 1.0_wp
    end do
    call model%grid%node_map%scatter_add(model%comm, 1, is_corner)
    call model%grid%node_map%gather(model%comm, 1, is_corner)
    n_groups = group_count(model%grid%shape_kind)
    width = model%grid%width
    allocate (weight(n_group*n_group_wide), gradient(n_group*n_group_wide*ndim))
    do pass = 1, 2   ! counts, then fills
      self%n = 0
      do p = 1, model%particles%count
        associate (grid => model%grid, patch => model%patch(p))
          if (all(is_corner(1, grid%patch_node(:, patch)) > 0.5_wp)) cycle
          call grid%weigh(p, 1, model%patch(p:p), &
                          model%particles%field(model%p%position)%values(:, p:p), n_groups, &
                          weight, gradient)
          c = model%cell(p)
          do i = 1, size(grid%patch_node, 1)
            is_tie = weight(i) > 0.0_wp .and. is_corner(1, grid%patch_node(i, patch)) < 0.5_wp
            if (.not. is_tie) cycle
            self%n = self%n + 1
            if (pass == 1) cycle
            do d = 1, ndim
              offset(d) = real(grid%patch_base(d, patch) + mod((i - 1)/width**(d - 1), width) - &
                               grid%cell_base(d, c), wp)
            end do
            self%node(:, self%n) = [grid%patch_node(i, patch), grid%cell_node(:, c)]
            self%weight(:, self%n) = [1.0_wp, -corner_hats(offset)]
            self%spring(self%n) = &
              tie_stiffness*model%materials%item(model%material(p))%model%shear_modulus()* &
              model%weight(p)*weight(i)/grid%spacing**2
          end do
        end associate
      end do
      if (pass == 2) exit
      if (allocated(self%node)) deallocate (self%node, self%weight, self%spring)
      allocate (self%node(1 + 2**ndim, self%n), self%weight(1 + 2**ndim, self%n))
      allocate (self%spring(self%n))
    end do
  end subroutine ties_find

  subroutine ties_add_forces(self, model, motion, force)
    !! Adds the forces that resist a motion of the nodes. Collective.
    class(weak_ties_t), intent(in) :: self
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: motion(:, :)      !! (ndim, n_node) [m]
    real(wp), intent(inout) :: force(:, :)    !! (ndim, n_node), complete [N]
    real(wp), allocatable :: own(:, :)
    real(wp) :: gap(ndim)
    integer :: t, k

    allocate (own(ndim, model%grid%n_node), source=0.0_wp)
    do t = 1, self%n
      gap = matmul(motion(:, self%node(:, t)), self%weight(:, t))
      do k = 1, size(self%node, 1)
        own(:, self%node(k, t)) = own(:, self%node(k, t)) - &
                                  self%spring(t)*self%weight(k, t)*gap
      end do
    end do
    call model%grid%node_map%scatter_add(model%comm, ndim, own)
    call model%grid%node_map%gather(model%comm, ndim, own)
    force = force + own
  end subroutine ties_add_forces
end module dosui_weak_ties

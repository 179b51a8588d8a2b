!! Retention of water above the water table: saturation and relative conductivity of a soil by the
!! suction of its water [vanGenuchten1980, Mualem1976].
!!
!!     S_e = (1 + (alpha psi)^n)^-m, m = 1 - 1/n, psi = -u/gamma_w; S = S_r + (1 - S_r) S_e
!!     k_r = sqrt(S_e) (1 - (1 - S_e^(1/m))^m)^2
module dosui_retention
  use dosui_kinds, only: wp
  implicit none
  private

  type, public :: retention_t
    logical :: is_active = .false.      !! false: saturated at any pressure
    real(wp) :: alpha = 0.0_wp          !! per suction head [1/m]
    real(wp) :: n = 2.0_wp              !! exponent, > 1 [-]
    real(wp) :: residual = 0.0_wp       !! S_r: saturation of dry soil [-]
    real(wp) :: least = 0.0_wp          !! smallest relative conductivity [-]
    real(wp) :: unit_weight = 9810.0_wp   !! gamma_w [N/m3]
  contains
    procedure :: saturation => retention_saturation
    procedure :: capacity => retention_capacity
    procedure :: relative_conductivity => retention_relative_conductivity
    procedure :: conductivity_slope => retention_conductivity_slope
  end type retention_t

contains

  pure elemental real(wp) function retention_saturation(self, pressure) result(saturation)
    !! S: volume of water over volume of voids [-].
    class(retention_t), intent(in) :: self
    real(wp), intent(in) :: pressure   !! of the water, compression positive [Pa]

    saturation = 1.0_wp
    if (self%is_active .and. pressure < 0.0_wp) then
      saturation = self%residual + (1.0_wp - self%residual)*effective(self, pressure)
    end if
  end function retention_saturation

  pure elemental real(wp) function retention_capacity(self, pressure) result(capacity)
    !! dS/du [1/Pa].
    class(retention_t), intent(in) :: self
    real(wp), intent(in) :: pressure   !! [Pa]
    real(wp) :: reduced, m

    capacity = 0.0_wp
    if (.not. self%is_active .or. pressure >= 0.0_wp) return
    m = 1.0_wp - 1.0_wp/self%n
    reduced = -self%alpha*pressure/self%unit_weight
    ! dS_e/d(alpha psi) = -m n (alpha psi)^(n - 1) (1 + (alpha psi)^n)^(-m - 1)
    capacity = (1.0_wp - self%residual)*m*self%n*reduced**(self%n - 1.0_wp)* &
               (1.0_wp + reduced**self%n)**(-m - 1.0_wp)*self%alpha/self%unit_weight
  end function retention_capacity

  pure elemental real(wp) function retention_relative_conductivity(self, pressure) result(relative)
    !! k_r: conductivity over that of the saturated soil [-].
    class(retention_t), intent(in) :: self
    real(wp), intent(in) :: pressure   !! [Pa]
    real(wp) :: share, m

    relative = 1.0_wp
    if (.not. self%is_active .or. pressure >= 0.0_wp) return
    m = 1.0_wp - 1.0_wp/self%n
    share = effective(self, pressure)
    relative = self%least + (1.0_wp - self%least)*sqrt(share)* &
               (1.0_wp - (1.0_wp - share**(1.0_wp/m))**m)**2
  end function retention_relative_conductivity

  pure elemental real(wp) function retention_conductivity_slope(self, pressure) result(slope)
    !! dk_r/du [1/Pa].
    class(retention_t), intent(in) :: self
    real(wp), intent(in) :: pressure   !! [Pa]
    real(wp) :: share, root, inner, m, share_slope

    slope = 0.0_wp
    if (.not. self%is_active .or. pressure >= 0.0_wp) return
    m = 1.0_wp - 1.0_wp/self%n
    share = effective(self, pressure)
    root = share**(1.0_wp/m)
    if (.not. root > 0.0_wp .or. .not. root < 1.0_wp) return
    inner = 1.0_wp - (1.0_wp - root)**m
    share_slope = self%capacity(pressure)/(1.0_wp - self%residual)
    ! d inner/d S_e = (1 - root)^(m - 1) S_e^(1/m - 1)
    slope = (1.0_wp - self%least)*share_slope* &
            (0.5_wp*inner**2/sqrt(share) + &
             2.0_wp*sqrt(share)*inner*(1.0_wp - root)**(m - 1.0_wp)*root/share)
  end function retention_conductivity_slope

  pure elemental real(wp) function effective(self, pressure) result(share)
    !! S_e at a suction [-].
    class(retention_t), intent(in) :: self
    real(wp), intent(in) :: pressure   !! < 0 [Pa]

    share = (1.0_wp + (-self%alpha*pressure/self%unit_weight)**self%n)** &
            (-(1.0_wp - 1.0_wp/self%n))
  end function effective
end module dosui_retention

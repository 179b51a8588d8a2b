r"""Exact solutions that results are compared with.

Pore pressure and loads are compression positive, units are SI. The water is compressible
(bulk modulus K_w), the grains are not: Biot coefficient 1, storage S = n/K_w.

Sources
-------
* K. Terzaghi (1923), Die Berechnung der Durchlässigkeitsziffer des Tones aus dem Verlauf der
  hydrodynamischen Spannungserscheinungen. Sitzungsber. Akad. Wiss. Wien IIa 132.
* J. Mandel (1953), Consolidation des sols (étude mathématique). Géotechnique 3(7).
* Y. Abousleiman, A. H.-D. Cheng, L. Cui, E. Detournay, J.-C. Roegiers (1996), Mandel's problem
  revisited. Géotechnique 46(2), eqs. 11-17.
* C. W. Cryer (1963), A comparison of the three-dimensional consolidation theories of Biot and
  Terzaghi. Quart. J. Mech. Appl. Math. 16(4).
* E. H. de Leeuw (1965), The theory of three-dimensional consolidation applied to cylindrical
  bodies. Proc. 6th ICSMFE I.
* A. Verruijt (2016), Theory and Problems of Poroelasticity, ch. 2 and 3 (finite K_w).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from dosui_post.errors import DosuiPostError

FloatArray = npt.NDArray[np.float64]

_NEGLIGIBLE_EXPONENT = 40.0  # exp(-40) = 4e-18
_EARLIEST_TIME_FACTOR = 1.0e-12  # before: the limit T -> 0+, off by less than 2e-6
_CHUNK = 4_000_000  # values of a series held at once


@dataclass(frozen=True)
class Soil:
    """Constants of a saturated, linearly elastic, isotropic soil."""

    young_modulus: float
    """E, drained [Pa]"""
    poisson_ratio: float
    """ν, drained [-]"""
    porosity: float
    """n [-]"""
    conductivity: float
    """k, hydraulic conductivity [m/s]"""
    water_bulk_modulus: float
    """K_w [Pa]; may be infinite"""
    unit_weight: float
    """γ_w [N/m³]"""
    is_rigid: bool = False
    """the skeleton does not move: 1/M = 0"""

    def __post_init__(self) -> None:
        checks = {
            "Young's modulus": self.is_rigid or 0 < self.young_modulus < math.inf,
            "Poisson's ratio": self.is_rigid or -1 < self.poisson_ratio < 0.5,
            "porosity": 0 < self.porosity < 1,
            "hydraulic conductivity": 0 < self.conductivity < math.inf,
            "bulk modulus of water": self.water_bulk_modulus > 0,
            "unit weight of water": 0 < self.unit_weight < math.inf,
        }
        wrong = [name for name, is_right in checks.items() if not is_right]
        if wrong:
            raise DosuiPostError("no exact solution: out of range: " + ", ".join(wrong))

    @property
    def shear_modulus(self) -> float:
        """G = E/(2(1+ν)) [Pa]."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def bulk_modulus(self) -> float:
        """K = E/(3(1-2ν)), drained [Pa]."""
        return self.young_modulus / (3 * (1 - 2 * self.poisson_ratio))

    @property
    def constrained_modulus(self) -> float:
        """M = K + 4G/3 [Pa]; infinite for a rigid skeleton."""
        if self.is_rigid:
            return math.inf
        return self.bulk_modulus + 4 * self.shear_modulus / 3

    @property
    def storage(self) -> float:
        """S = n/K_w [1/Pa]."""
        return self.porosity / self.water_bulk_modulus

    @property
    def consolidation_coefficient(self) -> float:
        """c_v = (k/γ_w)/(S + 1/M) [m²/s]; k K_w/(γ_w n) for a rigid skeleton."""
        mobility = self.conductivity / self.unit_weight
        return mobility / (self.storage + 1 / self.constrained_modulus)

    @property
    def skempton(self) -> float:
        """Skempton's B = (1/S)/(K + 1/S) [-]."""
        return 1 / (1 + self.storage * self.bulk_modulus)

    @property
    def poisson_increase(self) -> float:
        """ν_u - ν without cancellation [-] (Verruijt 2016; Biot coefficient 1)."""
        b, nu = self.skempton, self.poisson_ratio
        return b * (1 - 2 * nu) * (1 + nu) / (3 - b * (1 - 2 * nu))

    @property
    def undrained_poisson_ratio(self) -> float:
        """ν_u = (3K_u - 2G)/(2(3K_u + G)) with K_u = K + 1/S [-]."""
        return self.poisson_ratio + self.poisson_increase


@dataclass(frozen=True)
class Terzaghi:
    """One-dimensional consolidation: drained top z = 0, closed and fixed base z = H.

    A load q acts on the top from t = 0. z is the distance from the drained top [m].
    """

    soil: Soil
    load: float
    """q [Pa]"""
    length: float
    """drainage path H [m]"""

    @property
    def initial_pressure(self) -> float:
        """Undrained pore pressure u_0 = q (1/M)/(S + 1/M) [Pa]."""
        compliance = 1 / self.soil.constrained_modulus
        return self.load * compliance / (self.soil.storage + compliance)

    def time_factor(self, time: float) -> float:
        """T = c_v t/H² [-]."""
        return self.soil.consolidation_coefficient * time / self.length**2

    def time(self, time_factor: float) -> float:
        """T = T H²/c_v [s]."""
        return time_factor * self.length**2 / self.soil.consolidation_coefficient

    def pressure(self, z: npt.ArrayLike, time: float) -> FloatArray:
        """Excess pore pressure u = u_0 Σ (2/μ) sin(μ z/H) exp(-μ² T), μ = π(2m+1)/2 [Pa]."""
        depth = np.asarray(z, dtype=np.float64) / self.length
        factor = self.time_factor(time)
        if factor < _EARLIEST_TIME_FACTOR:
            return self.initial_pressure * (depth > 0).astype(np.float64)
        mu = _quarter_turns(_n_terms(factor))
        return self.initial_pressure * _series(
            depth, mu, 2 / mu * np.exp(-(mu**2) * factor), np.sin
        )

    def displacement(self, z: npt.ArrayLike, time: float) -> FloatArray:
        """Displacement towards the base, w = ∫_z^H (q - u)/M dz [m]."""
        depth = np.asarray(z, dtype=np.float64) / self.length
        factor = self.time_factor(time)
        stiffness = self.soil.constrained_modulus / self.length
        if factor < _EARLIEST_TIME_FACTOR:
            return (self.load - self.initial_pressure) * (1 - depth) / stiffness
        mu = _quarter_turns(_n_terms(factor))
        resisting = self.initial_pressure * _series(
            depth, mu, 2 / mu**2 * np.exp(-(mu**2) * factor), np.cos
        )
        return (self.load * (1 - depth) - resisting) / stiffness

    def settlement(self, time: float) -> float:
        """Displacement of the top [m]."""
        return float(self.displacement(0.0, time))


@dataclass(frozen=True)
class Drainage(Terzaghi):
    """Water leaving a rigid skeleton: diffusion with D = k K_w/(γ_w n), u(z, 0) = load.

    z is the distance from the drained surface, z = H is closed. The `load` is the initial
    excess pore pressure [Pa].
    """

    def __post_init__(self) -> None:
        if not self.soil.is_rigid:
            raise DosuiPostError("the case 'drainage' needs a rigid material")

    @property
    def initial_pressure(self) -> float:
        """The pore pressure everywhere at t = 0 [Pa]."""
        return self.load

    def displacement(self, z: npt.ArrayLike, time: float) -> FloatArray:
        """No displacement [m]."""
        return np.zeros_like(np.asarray(z, dtype=np.float64))


@dataclass(frozen=True)
class Mandel:
    """Mandel's problem, quarter section 0 <= x <= a, plane strain, drained at x = a.

    x = 0 and z = 0 are planes of symmetry. A rigid frictionless plate on the top carries the
    force F on this quarter from t = 0 (2F on the whole plate of width 2a).
    """

    soil: Soil
    force: float
    """F [N per m thickness]"""
    half_width: float
    """a [m]"""

    @property
    def initial_pressure(self) -> float:
        """Undrained pore pressure u_0 = F B (1 + ν_u)/(3a) [Pa]."""
        soil = self.soil
        return (
            self.force * soil.skempton * (1 + soil.undrained_poisson_ratio) / (3 * self.half_width)
        )

    def time_factor(self, time: float) -> float:
        """T = c_v t/a² [-]."""
        return self.soil.consolidation_coefficient * time / self.half_width**2

    def time(self, time_factor: float) -> float:
        """T = T a²/c_v [s]."""
        return time_factor * self.half_width**2 / self.soil.consolidation_coefficient

    def pressure(self, x: npt.ArrayLike, time: float) -> FloatArray:
        """Excess pore pressure [Pa], x from the plane of symmetry [m].

        u = 2 u_0 Σ sin α_i/(α_i - sin α_i cos α_i) (cos(α_i x/a) - cos α_i) exp(-α_i² T)
        with tan α_i/α_i = (1-ν)/(ν_u-ν).
        """
        position = np.asarray(x, dtype=np.float64) / self.half_width
        factor = self.time_factor(time)
        if factor < _EARLIEST_TIME_FACTOR:
            return self.initial_pressure * (position < 1).astype(np.float64)
        alpha, sine, cosine, decay = self._modes(factor)
        weight = sine * decay
        boundary = float(np.sum(weight * cosine))
        return 2 * self.initial_pressure * (_series(position, alpha, weight, np.cos) - boundary)

    def horizontal_displacement(self, x: npt.ArrayLike, time: float) -> FloatArray:
        """Displacement along x, positive outwards [m]."""
        x = np.asarray(x, dtype=np.float64)
        soil, a = self.soil, self.half_width
        nu, nu_u, factor = soil.poisson_ratio, soil.undrained_poisson_ratio, self.time_factor(time)
        scale = self.force / soil.shear_modulus
        if factor < _EARLIEST_TIME_FACTOR:
            return np.asarray(scale * nu_u / (2 * a) * x)
        alpha, sine, cosine, decay = self._modes(factor)
        common = float(np.sum(sine * cosine * decay))
        uniform = (nu / 2 - nu_u * common) * x / a
        return np.asarray(scale * (uniform + _series(x / a, alpha, cosine * decay, np.sin)))

    def vertical_strain(self, time: float) -> float:
        """∂u_z/∂z, uniform, negative: shortening [-]."""
        soil = self.soil
        nu, nu_u, factor = soil.poisson_ratio, soil.undrained_poisson_ratio, self.time_factor(time)
        scale = self.force / (soil.shear_modulus * self.half_width)
        if factor < _EARLIEST_TIME_FACTOR:
            return -scale * (1 - nu_u) / 2
        _, sine, cosine, decay = self._modes(factor)
        return scale * (-(1 - nu) / 2 + (1 - nu_u) * float(np.sum(sine * cosine * decay)))

    def settlement(self, height: float, time: float) -> float:
        """Downward displacement of the plate at `height` above the symmetry plane [m]."""
        return -height * self.vertical_strain(time)

    def roots(self, count: int) -> FloatArray:
        """The first positive roots of tan α = η α, η = (1-ν)/(ν_u-ν), one in each (iπ, iπ+π/2)."""
        return _quarter_turns(count) - self._root_gaps(count)

    def _root_gaps(self, count: int) -> FloatArray:
        """δ_i = iπ + π/2 - α_i, bisected in (0, π/2): safe for every η > 1, no cancellation."""
        eta = (1 - self.soil.poisson_ratio) / self.soil.poisson_increase
        quarter_turns = _quarter_turns(count)
        low = np.zeros(count)
        high = np.full(count, math.pi / 2)
        high[0] -= 1.0e-6  # beyond lies the trivial root α = 0
        for _ in range(80):
            middle = 0.5 * (low + high)
            is_above = (quarter_turns - middle) * np.sin(middle) > np.cos(middle) / eta
            high = np.where(is_above, middle, high)
            low = np.where(is_above, low, middle)
        return np.asarray(0.5 * (low + high))

    def _modes(self, factor: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """α_i, sin α_i, cos α_i and exp(-α_i² T)/(α_i - sin α_i cos α_i)."""
        count = _n_terms(factor)
        gap = self._root_gaps(count)
        alpha = _quarter_turns(count) - gap
        sign = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
        sine, cosine = sign * np.cos(gap), sign * np.sin(gap)
        return alpha, sine, cosine, np.exp(-(alpha**2) * factor) / (alpha - sine * cosine)


@dataclass(frozen=True)
class RadialConsolidation:
    """Cryer's sphere and de Leeuw's cylinder: drained surface r = a under a pressure q from t = 0.

    Equilibrium gives M ε = u + f(t) for the volume strain ε, and the radial stress at r = a ties f
    to the means: f = (g ū - q)/(1 - g) with g = 2G(d-1)/(dM) in d dimensions. The water's balance
    is then a diffusion equation with a source,

        ∂u/∂t + β ∂ū/∂t = c_v ∇²u,   β = g/((1 - g)(1 + S M)),

    whose modes are φ = J(λ r/a) - J(λ), (1 + β) J(λ) = β J̄(λ), with J = J_0 for the cylinder,
    sin x/x for the sphere and J̄ the mean of J(λ r/a) over the body.
    """

    soil: Soil
    load: float
    """q [Pa]"""
    radius: float
    """a [m]"""
    dimension: int
    """2: cylinder in plane strain, 3: sphere"""

    @property
    def initial_pressure(self) -> float:
        """Undrained pore pressure u_0 = q/(1 + S K_d) with K_d = M (1 - g) [Pa]."""
        stiffness = self.soil.constrained_modulus * (1 - self._share)
        return self.load / (1 + self.soil.storage * stiffness)

    def time_factor(self, time: float) -> float:
        """T = c_v t/a² [-]."""
        return self.soil.consolidation_coefficient * time / self.radius**2

    def time(self, time_factor: float) -> float:
        """T = T a²/c_v [s]."""
        return time_factor * self.radius**2 / self.soil.consolidation_coefficient

    def pressure(self, r: npt.ArrayLike, time: float) -> FloatArray:
        """Excess pore pressure u_0 Σ A_i φ_i exp(-λ_i² T), r from the centre [Pa]."""
        position = np.asarray(r, dtype=np.float64) / self.radius
        factor = self.time_factor(time)
        if factor < _EARLIEST_TIME_FACTOR:
            return self.initial_pressure * (position < 1).astype(np.float64)
        roots, weight = self._modes(factor)
        boundary = float(np.sum(weight * self._wave(roots)))
        return self.initial_pressure * (_series(position, roots, weight, self._wave) - boundary)

    def mean_pressure(self, time: float) -> float:
        """Mean excess pore pressure of the body [Pa]."""
        factor = self.time_factor(time)
        if factor < _EARLIEST_TIME_FACTOR:
            return self.initial_pressure
        roots, weight = self._modes(factor)
        return self.initial_pressure * float(
            np.sum(weight * (self._mean_wave(roots) - self._wave(roots)))
        )

    def displacement(self, r: npt.ArrayLike, time: float) -> FloatArray:
        """Radial displacement, positive outwards: r^(1-d) ∫ ε r^(d-1) dr [m]."""
        r = np.asarray(r, dtype=np.float64)
        position = r / self.radius
        modulus, share, d = self.soil.constrained_modulus, self._share, self.dimension
        source = (share * self.mean_pressure(time) - self.load) / (1 - share)
        inside = self.initial_pressure * np.ones_like(position)
        factor = self.time_factor(time)
        if factor >= _EARLIEST_TIME_FACTOR:
            roots, weight = self._modes(factor)
            boundary = float(np.sum(weight * self._wave(roots)))
            inside = self.initial_pressure * (
                _series(position, roots, weight, self._mean_wave) - boundary
            )
        return np.asarray((inside + source) * r / (d * modulus))

    def roots(self, count: int) -> FloatArray:
        """The first positive roots of (1 + β) J(λ) = β J̄(λ)."""
        # Sampled finely enough to part them: they lie about π apart.
        step = 0.05
        grid = np.arange(0.5 * step, (count + 2) * math.pi, step)
        value = self._characteristic(grid)
        change = np.nonzero(value[:-1] * value[1:] < 0)[0][:count]
        low, high = grid[change], grid[change + 1]
        low_value = value[change]
        for _ in range(60):
            middle = 0.5 * (low + high)
            middle_value = self._characteristic(middle)
            is_low = middle_value * low_value > 0
            low = np.where(is_low, middle, low)
            high = np.where(is_low, high, middle)
        return np.asarray(0.5 * (low + high))

    @property
    def _share(self) -> float:
        """G = 2G(d-1)/(dM) [-]."""
        d = self.dimension
        return 2 * self.soil.shear_modulus * (d - 1) / (d * self.soil.constrained_modulus)

    @property
    def _source_ratio(self) -> float:
        """β [-]."""
        stored = 1 + self.soil.storage * self.soil.constrained_modulus
        return self._share / ((1 - self._share) * stored)

    def _characteristic(self, x: FloatArray) -> FloatArray:
        beta = self._source_ratio
        return (1 + beta) * self._wave(x) - beta * self._mean_wave(x)

    def _wave(self, x: FloatArray) -> FloatArray:
        """J."""
        if self.dimension == 3:
            return np.asarray(np.sinc(x / math.pi))
        return np.asarray(special.j0(x))

    def _mean_wave(self, x: FloatArray) -> FloatArray:
        """Mean of J over a cylinder or sphere of radius x; x = 0 gives 1."""
        near = np.abs(x) < 1.0e-2
        safe = np.where(near, 1.0, x)
        if self.dimension == 3:
            far = 3 * (np.sin(safe) - safe * np.cos(safe)) / safe**3
            return np.asarray(np.where(near, 1 - x**2 / 10, far))
        return np.asarray(np.where(near, 1 - x**2 / 8, 2 * special.j1(safe) / safe))

    def _modes(self, factor: float) -> tuple[FloatArray, FloatArray]:
        """λ_i, and A_i exp(-λ_i² T): the projection of a uniform initial pressure."""
        x = self.roots(_n_terms(factor) + 1)
        wave, mean = self._wave(x), self._mean_wave(x)
        if self.dimension == 3:
            square = 1.5 * (1 - np.sin(2 * x) / (2 * x)) / x**2
        else:
            square = wave**2 + special.j1(x) ** 2
        return x, mean / (square - wave * mean) * np.exp(-(x**2) * factor)


@dataclass(frozen=True)
class Hydrostatic:
    """Water at rest below a level: u = γ_w (level - z), 0 above it."""

    unit_weight: float
    """γ_w [N/m³]"""
    level: float
    """elevation of zero pressure [m]"""

    def pressure(self, z: npt.ArrayLike) -> FloatArray:
        """Pore pressure at the elevation z [Pa]."""
        return self.unit_weight * np.maximum(self.level - np.asarray(z, dtype=np.float64), 0.0)


@dataclass(frozen=True)
class BarVibration:
    """Free axial vibration of an elastic bar, fixed at s = 0, free at s = H, in one mode.

    v(s, 0) = v_0 sin(π(2m-1)s/(2H)), no displacement at t = 0.
    """

    wave_speed: float
    """c = sqrt(M/ρ) [m/s]"""
    length: float
    """H [m]"""
    amplitude: float
    """v_0 [m/s]"""
    mode: int = 1
    """m = 1, 2, …"""

    @property
    def circular_frequency(self) -> float:
        """ω = c π(2m-1)/(2H) [1/s]."""
        return self.wave_speed * math.pi * (2 * self.mode - 1) / (2 * self.length)

    @property
    def period(self) -> float:
        """2π/ω [s]."""
        return 2 * math.pi / self.circular_frequency

    def shape(self, s: npt.ArrayLike) -> FloatArray:
        """sin(π(2m-1)s/(2H)) [-]."""
        phase = math.pi * (2 * self.mode - 1) / (2 * self.length)
        return np.asarray(np.sin(phase * np.asarray(s, dtype=np.float64)))

    def velocity(self, s: npt.ArrayLike, time: float) -> FloatArray:
        """v_0 sin(…) cos(ωt) [m/s]."""
        return self.amplitude * math.cos(self.circular_frequency * time) * self.shape(s)

    def displacement(self, s: npt.ArrayLike, time: float) -> FloatArray:
        """(v_0/ω) sin(…) sin(ωt) [m]."""
        omega = self.circular_frequency
        return self.amplitude / omega * math.sin(omega * time) * self.shape(s)


def _quarter_turns(count: int) -> FloatArray:
    """π(i + 1/2), i = 0, 1, …."""
    return np.asarray(math.pi * (np.arange(count, dtype=np.float64) + 0.5))


def _n_terms(time_factor: float) -> int:
    """Terms until exp(-(iπ)² T) is negligible."""
    return math.ceil(math.sqrt(_NEGLIGIBLE_EXPONENT / time_factor) / math.pi) + 2


def _series(
    position: FloatArray,
    wave_number: FloatArray,
    weight: FloatArray,
    wave: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Σ weight_i wave(wave_number_i position), with bounded memory."""
    distinct, inverse = np.unique(position, return_inverse=True)
    total = np.zeros_like(distinct)
    chunk = max(1, _CHUNK // max(1, distinct.size))
    for first in range(0, wave_number.size, chunk):
        part = slice(first, first + chunk)
        total += wave(np.outer(distinct, wave_number[part])) @ weight[part]
    return total[inverse].reshape(position.shape)

"""Exact solutions against published values, their equations and independent computations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import soil

from dosui_post.errors import DosuiPostError
from dosui_post.exact import (
    BarVibration,
    Drainage,
    Hydrostatic,
    Mandel,
    RadialConsolidation,
    Soil,
    Terzaghi,
)

NO_WATER_COMPRESSION = math.inf
POISSON = [-0.3, 0.0, 0.2, 0.4, 0.49, 0.499]


def test_constants_of_the_soil() -> None:
    s = soil(0.2, 2.2e9)
    storage = 0.3 / 2.2e9
    k_undrained = s.bulk_modulus + 1 / storage
    g = s.shear_modulus
    assert s.constrained_modulus == pytest.approx(1e6 * 0.8 / (1.2 * 0.6))
    assert s.skempton == pytest.approx(1 / storage / k_undrained, rel=1e-12)
    assert s.undrained_poisson_ratio == pytest.approx(
        (3 * k_undrained - 2 * g) / (2 * (3 * k_undrained + g)), rel=1e-12
    )


def test_incompressible_water_is_the_limit() -> None:
    s = soil(0.2, NO_WATER_COMPRESSION)
    assert (s.storage, s.skempton) == (0.0, 1.0)
    assert s.undrained_poisson_ratio == pytest.approx(0.5, rel=1e-14)


def test_scene_2d_consolidation_coefficient() -> None:
    """The value stated in input/terzaghi/scene_2d.nml."""
    assert soil(0.2, 3.0e7).consolidation_coefficient == pytest.approx(0.112018, rel=1e-5)


@pytest.mark.parametrize("wrong", [{"poisson_ratio": 0.5}, {"porosity": math.nan}])
def test_impossible_soil_is_refused(wrong: dict[str, float]) -> None:
    right = {
        "young_modulus": 1e6,
        "poisson_ratio": 0.2,
        "porosity": 0.3,
        "conductivity": 1e-3,
        "water_bulk_modulus": 2.2e9,
        "unit_weight": 9810.0,
    }
    with pytest.raises(DosuiPostError, match="out of range"):
        Soil(**{**right, **wrong})


# ---------------------------------------------------------------------- Terzaghi


def terzaghi(kw: float = 3.0e7) -> Terzaghi:
    return Terzaghi(soil(0.2, kw), 1000.0, 2.0)


def test_terzaghi_published_value() -> None:
    t = terzaghi()
    base = float(t.pressure(2.0, t.time(0.2)))
    assert base / t.initial_pressure == pytest.approx(0.7723, abs=5e-5)


@pytest.mark.parametrize("factor", [1e-9, 1e-6, 1e-3, 0.01, 0.1, 0.5])
def test_terzaghi_equals_the_images_of_the_half_space(factor: float) -> None:
    """Another series, error functions of mirror images: best where ours converges worst."""
    t = terzaghi()
    root = 2 * math.sqrt(factor)
    for depth in (0.0, 0.3 * root, 0.02, 0.3, 0.77, 1.0):
        images = sum(
            (-1) ** k * (math.erfc((2 * k + depth) / root) + math.erfc((2 * k + 2 - depth) / root))
            for k in range(20)
        )
        u = float(t.pressure(depth * t.length, t.time(factor))) / t.initial_pressure
        assert u == pytest.approx(1 - images, abs=1e-12)


def test_terzaghi_against_finite_differences() -> None:
    t = terzaghi()
    n, target = 200, 0.2
    dz, dt = 1.0 / n, target / 4000
    u = np.ones(n + 1)
    u[0] = 0.0
    # Crank-Nicolson after ten implicit steps, which damp the jump at the drained top.
    second = np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    second[-1, -2] = 2.0
    second /= dz**2
    identity = np.eye(n)
    implicit = np.linalg.inv(identity - dt * second)
    half = np.linalg.solve(identity - 0.5 * dt * second, identity + 0.5 * dt * second)
    inner = np.linalg.matrix_power(half, 3990) @ np.linalg.matrix_power(implicit, 10) @ u[1:]
    exact = t.pressure(np.linspace(0, 1, n + 1)[1:] * t.length, t.time(target))
    assert np.max(np.abs(inner - exact / t.initial_pressure)) < 2e-5


def test_terzaghi_displacement_is_the_integral_of_strain() -> None:
    t = terzaghi()
    time = t.time(0.07)
    z = np.linspace(0, t.length, 20001)
    strain = (t.load - t.pressure(z, time)) / t.soil.constrained_modulus
    whole = np.sum(0.5 * (strain[1:] + strain[:-1]) * np.diff(z))
    assert t.settlement(time) == pytest.approx(whole, rel=1e-7)
    assert float(t.displacement(t.length, time)) == pytest.approx(0.0, abs=1e-18)


def test_terzaghi_settlement_limits() -> None:
    t = terzaghi()
    m, h = t.soil.constrained_modulus, t.length
    share = t.initial_pressure / t.load
    assert t.settlement(0.0) == pytest.approx(t.load * (1 - share) * h / m)
    assert t.settlement(t.time(1e-10)) == pytest.approx(t.settlement(0.0), rel=2e-3)
    assert t.settlement(t.time(20.0)) == pytest.approx(t.load * h / m, rel=1e-12)
    # Early degree of consolidation 2 sqrt(T/pi).
    degree = (t.settlement(t.time(1e-4)) - t.settlement(0.0)) / (
        t.settlement(t.time(20)) - t.settlement(0.0)
    )
    assert degree == pytest.approx(2 * math.sqrt(1e-4 / math.pi), rel=1e-9)


def test_undrained_pressure_is_shared_by_stiffness() -> None:
    t = terzaghi(kw=2.2e9)
    water = t.soil.water_bulk_modulus / t.soil.porosity
    assert t.initial_pressure == pytest.approx(
        t.load * water / (water + t.soil.constrained_modulus), rel=1e-12
    )
    assert np.all(
        t.pressure(np.array([0.0, 0.1, 2.0]), 0.0) == t.initial_pressure * np.array([0, 1, 1])
    )


def test_drainage_is_terzaghi_with_the_waters_own_diffusivity() -> None:
    s = soil(rigid=True)
    d = Drainage(s, 500.0, 1.0)
    diffusivity = 1e-3 * 2.2e9 / (9810.0 * 0.3)
    assert d.soil.consolidation_coefficient == pytest.approx(diffusivity, rel=1e-12)
    assert float(d.pressure(1.0, d.time(0.2))) / 500.0 == pytest.approx(0.7723, abs=5e-5)
    assert np.all(d.displacement(np.ones(3), 1.0) == 0)
    with pytest.raises(DosuiPostError, match="rigid"):
        Drainage(soil(), 500.0, 1.0)


# ---------------------------------------------------------------------- Mandel


def test_mandel_published_values() -> None:
    m = Mandel(soil(0.2, 2.2e9), 1.0, 1.0)
    table = {0: 0.5000, 0.01: 0.5218, 0.05: 0.5494, 0.1: 0.5476, 0.2: 0.4840, 1: 0.1294}
    for factor, value in table.items():
        assert float(m.pressure(0.0, m.time(factor))) == pytest.approx(value, abs=6e-5)


@pytest.mark.parametrize("nu", POISSON)
@pytest.mark.parametrize("kw", [1e2, 1e5, 3e7, 2.2e9, 1e12, NO_WATER_COMPRESSION])
def test_mandel_roots(nu: float, kw: float) -> None:
    m = Mandel(soil(nu, kw), 1.0, 1.0)
    alpha = m.roots(500)
    turn = math.pi * np.arange(500)
    assert np.all((alpha > turn) & (alpha < turn + math.pi / 2))
    eta = (1 - nu) / m.soil.poisson_increase
    # tan(alpha) = eta alpha, without the pole
    residual = np.sin(alpha) - eta * alpha * np.cos(alpha)
    assert np.max(np.abs(residual) / (eta * alpha)) < 1e-12


@pytest.mark.parametrize("nu", POISSON)
@pytest.mark.parametrize("kw", [3e6, 2.2e9, NO_WATER_COMPRESSION])
@pytest.mark.parametrize("factor", [1e-4, 0.05, 0.7])
def test_mandel_satisfies_equilibrium_and_continuity(nu: float, kw: float, factor: float) -> None:
    """Balance of forces, of horizontal stress and of water, from u, u_x and the strain alone."""
    m = Mandel(soil(nu, kw), 1000.0, 2.0)
    s, time, a = m.soil, m.time(factor), m.half_width
    lame, g = s.bulk_modulus - 2 * s.shear_modulus / 3, s.shear_modulus
    x = np.linspace(0, a, 4001)
    dx = x[1] - x[0]

    def strain_x(t: float) -> np.ndarray:
        return np.gradient(m.horizontal_displacement(x, t), dx, edge_order=2)

    u, e_x, e_z = m.pressure(x, time), strain_x(time), m.vertical_strain(time)
    size = m.force / a
    stress_x = (lame + 2 * g) * e_x + lame * e_z - u
    smooth = slice(2, -2)
    assert np.max(np.abs(stress_x[smooth])) < 5e-4 * size * (1 + lame / g * 1e-3)
    stress_z = (lame + 2 * g) * e_z + lame * e_x - u
    force = -np.sum(0.5 * (stress_z[1:] + stress_z[:-1]) * np.diff(x))
    assert force == pytest.approx(m.force, rel=2e-4 * (1 + lame / g * 1e-3))
    dt = 1e-4 * time
    rate = (m.pressure(x, time + dt) - m.pressure(x, time - dt)) / (2 * dt)
    volume_rate = (strain_x(time + dt) - strain_x(time - dt)) / (2 * dt) + (
        m.vertical_strain(time + dt) - m.vertical_strain(time - dt)
    ) / (2 * dt)
    flow = s.conductivity / s.unit_weight * np.gradient(np.gradient(u, dx), dx)
    inner = slice(3, -3)
    residual = s.storage * rate + volume_rate - flow
    # The scale of what is balanced, from the moving front at the drained side.
    assert np.max(np.abs(residual[inner])) < 3e-3 * np.max(np.abs(flow[inner]))


@pytest.mark.parametrize("nu", POISSON)
def test_mandel_limits(nu: float) -> None:
    m = Mandel(soil(nu, 2.2e9), 1000.0, 2.0)
    x = np.linspace(0, 1.9, 20)
    assert np.all(m.pressure(x, 0.0) == m.initial_pressure)
    assert np.all(m.pressure([0.0, 1.0, 2.0], 0.0) == [m.initial_pressure, m.initial_pressure, 0])
    early = m.pressure(x, m.time(1e-9))
    assert np.max(np.abs(early / m.initial_pressure - 1)) < 1e-4
    assert float(m.pressure(2.0, m.time(0.1))) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(m.pressure(x, m.time(30.0)))) < 1e-9
    # Undrained and drained plane strain.
    g, s = m.soil.shear_modulus, m.soil
    for time, ratio in ((0.0, s.undrained_poisson_ratio), (m.time(40.0), nu)):
        assert m.vertical_strain(time) == pytest.approx(-1000 * (1 - ratio) / (2 * g * 2.0))
        assert float(m.horizontal_displacement(2.0, time)) == pytest.approx(
            1000 * ratio / (2 * g), abs=1e-15
        )
    assert m.vertical_strain(m.time(1e-10)) == pytest.approx(m.vertical_strain(0.0), rel=1e-4)
    assert m.settlement(3.0, 0.0) == pytest.approx(-3 * m.vertical_strain(0.0))


def test_mandel_cryer_rise_falls_with_poissons_ratio() -> None:
    peaks = []
    for nu in (0.0, 0.2, 0.4):
        m = Mandel(soil(nu), 1.0, 1.0)
        history = [float(m.pressure(0.0, m.time(t))) for t in np.geomspace(1e-3, 1, 200)]
        peaks.append(max(history) / m.initial_pressure)
    assert peaks[0] > peaks[1] > peaks[2] > 1


# ---------------------------------------------------------------------- the others


def test_hydrostatic_pressure() -> None:
    assert np.all(Hydrostatic(10.0, 2.0).pressure([0.0, 1.5, 3.0]) == [20.0, 5.0, 0.0])


def test_bar_satisfies_the_wave_equation() -> None:
    bar = BarVibration(wave_speed=30.0, length=2.0, amplitude=0.1, mode=3)
    s, t, h, dt = np.linspace(0, 2, 401), 0.0123, 2 / 400, 1e-5
    d = bar.displacement(s, t)
    acceleration = (bar.displacement(s, t + dt) - 2 * d + bar.displacement(s, t - dt)) / dt**2
    curvature = (d[2:] - 2 * d[1:-1] + d[:-2]) / h**2
    assert np.allclose(
        acceleration[1:-1], 900 * curvature, atol=2e-4 * np.max(np.abs(acceleration))
    )
    rate = (bar.displacement(s, t + dt) - bar.displacement(s, t - dt)) / (2 * dt)
    assert np.allclose(rate, bar.velocity(s, t), atol=1e-6)
    assert d[0] == 0
    assert abs(d[-1] - d[-2]) < 1e-3 * np.max(np.abs(d))
    assert bar.velocity(2.0 / 5, 0.0) == pytest.approx(0.1)
    assert bar.displacement(s, bar.period) == pytest.approx(bar.displacement(s, 0.0), abs=1e-12)


# ---------------------------------------------------------------------- Cryer, de Leeuw


def radial(dimension: int, nu: float, kw: float) -> RadialConsolidation:
    return RadialConsolidation(soil(nu, kw), 1000.0, 0.8, dimension)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("nu", [-0.3, 0.0, 0.2, 0.4, 0.499])
@pytest.mark.parametrize("kw", [3.0e6, 2.2e9])
def test_radial_consolidation_satisfies_its_equations(dimension: int, nu: float, kw: float) -> None:
    """Storage, equilibrium and the load at the surface, by differences."""
    case = radial(dimension, nu, kw)
    s, a, d = case.soil, case.radius, dimension
    time = case.time(0.07)
    modulus, shear = s.constrained_modulus, s.shear_modulus
    step = 2.0e-3 * a
    r = np.linspace(0.2, 0.8, 7) * a

    def strain(position: np.ndarray, at: float) -> np.ndarray:
        outer = (position + step) ** (d - 1) * case.displacement(position + step, at)
        inner = (position - step) ** (d - 1) * case.displacement(position - step, at)
        return (outer - inner) / (2 * step * position ** (d - 1))

    dt = 1.0e-4 * time
    stored = (
        strain(r, time + dt)
        - strain(r, time - dt)
        + s.storage * (case.pressure(r, time + dt) - case.pressure(r, time - dt))
    ) / (2 * dt)
    up, here, down = (case.pressure(r + k * step, time) for k in (1, 0, -1))
    flow = (up - 2 * here + down) / step**2 + (d - 1) / r * (up - down) / (2 * step)
    flow *= s.conductivity / s.unit_weight
    assert stored == pytest.approx(flow, rel=2e-4, abs=2e-5 * np.max(np.abs(flow)))
    # M grad(strain) = grad(u), and the total radial stress is -q at r = a
    slope = (strain(r + step, time) - strain(r - step, time)) / (2 * step)
    assert modulus * slope == pytest.approx(
        (up - down) / (2 * step), rel=1e-3, abs=5e-4 * case.load / a
    )
    at = np.array([a])
    one_sided = (
        3 * case.displacement(at, time)
        - 4 * case.displacement(at - step, time)
        + case.displacement(at - 2 * step, time)
    ) / (2 * step)
    hoop = case.displacement(at, time) / a
    stress = modulus * one_sided + (modulus - 2 * shear) * (d - 1) * hoop
    assert stress == pytest.approx(-case.load, rel=2e-4)
    assert case.pressure(at, time) == pytest.approx(0.0, abs=1e-9 * case.load)


@pytest.mark.parametrize("dimension", [2, 3])
def test_radial_consolidation_starts_undrained_and_rises(dimension: int) -> None:
    case = radial(dimension, 0.0, math.inf)
    assert case.initial_pressure == pytest.approx(case.load, rel=1e-12)
    early = case.pressure(np.linspace(0, 0.9, 10) * case.radius, case.time(1e-5))
    assert early == pytest.approx(case.load, rel=0.02)
    assert case.displacement(case.radius, 0.0) == pytest.approx(0.0, abs=1e-15)
    peak = max(float(case.pressure(0.0, case.time(t))) for t in np.linspace(0.02, 0.12, 51))
    # Cryer (1963), fig. 3: about 1.6 for nu = 0
    assert peak == pytest.approx({2: 1.27, 3: 1.57}[dimension] * case.load, rel=0.01)
    final = -case.load / (2 * case.soil.shear_modulus)
    # nu = 0: no lateral coupling, every direction is compressed by q/E
    assert case.displacement(case.radius, case.time(20.0)) / case.radius == pytest.approx(final)

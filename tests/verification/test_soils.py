"""Soils that yield, in whole bodies."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Run, Runner, scene_text


def bearing_factors(run: Run) -> np.ndarray:
    """Load of the footing over width and strength: the base carries what the footing brings."""
    return -run.history("footing", "base_stress") * 5.0 / 1.0 / 1.0e4


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_footing_reaches_prandtls_load(dosui: Runner, ranks: int) -> None:
    """N_c = 2 + pi, approached from above with the spacing, and no locking beyond."""
    run = dosui(scene_text("footing/scene.nml", spacing="0.1"), ranks=ranks)
    assert run.status == 0, run.stderr
    factors = bearing_factors(run)
    exact = 2 + np.pi
    assert factors[-1] == pytest.approx(exact, rel=0.03)
    half = np.searchsorted(run.history("footing", "time"), 0.6)
    assert factors[-1] == pytest.approx(factors[half], rel=2e-3)  # a plateau
    assert -run.history("footing", "footing_stress")[-1] / 1e4 == pytest.approx(exact, rel=0.03)


COLUMN = """
&scene dimension = 1 integrator = '{integrator}' water = 'none' gravity = 0.0 /
&grid spacing = 0.1 /
&time end_time = {time} largest_step = {step} output_interval = {interval} /
&material name = 'soil' {soil} /
&region name = 'column' material = 'soil' box_min = 0.0 box_max = 1.0 /
&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e5, 3*0.0 /
&surface name = 'bottom' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'bottom' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'normal_velocity' value = {velocity} /
{more}
&output name = 'column' /
"""
CLAY = """model = 'cam_clay' critical_state_ratio = 1.0 lambda = 0.2
  kappa = 0.04 poisson_ratio = 0.3 porosity = 0.5"""


def oedometer(strain: float, steps: int = 20000) -> np.ndarray:
    """Modified Cam-clay at one point, forward integration of its rates: axial stress [Pa]."""
    lam, kap, ratio, nu = 0.2, 0.04, 1.0, 0.3
    p_a = 1.0e3
    s = np.array([1.0e5, 1.0e5, 1.0e5])  # compression positive: x, y, z
    p_c, v = 1.0e5, 2.0
    de = np.array([0.0, 0.0, strain / steps])
    for _ in range(steps):
        p = s.mean()
        bulk = v * (p + p_a) / kap
        shear = 1.5 * (1 - 2 * nu) / (1 + nu) * bulk
        d = bulk * np.ones((3, 3)) + 2 * shear * (np.eye(3) - 1 / 3)
        n = (2 * p - p_c) / 3 + 3 * (s - p) / ratio**2
        hardening = p * v / (lam - kap) * p_c * (2 * p - p_c)
        multiplier = max(0.0, n @ d @ de / (n @ d @ n + hardening))
        s = s + d @ (de - multiplier * n)
        p_c *= np.exp(v / (lam - kap) * multiplier * (2 * p - p_c))
        v *= np.exp(-de.sum())
    return s


def test_clay_in_the_oedometer(dosui: Runner) -> None:
    """A column of Cam-clay compressed by 5 %: the rates of the model, integrated on their own."""
    run = dosui(
        COLUMN.format(
            integrator="quasi_static",
            time=1.0,
            step=0.02,
            interval=1.0,
            velocity=-0.05,
            soil=CLAY,
            more="",
        )
    )
    assert run.status == 0, run.stderr
    data = run.fields("column")
    exact = oedometer(0.05)
    assert -data["effective_stress"][:, 2] == pytest.approx(exact[2], rel=5e-3)
    assert -data["effective_stress"][:, 0] == pytest.approx(exact[0], rel=5e-3)
    assert data["preconsolidation_pressure"] == pytest.approx(
        data["preconsolidation_pressure"][0], rel=1e-9
    )
    assert data["specific_volume"] == pytest.approx(2.0 * np.exp(-0.05), rel=1e-4)


def test_explicit_steps_yield_alike(dosui: Runner) -> None:
    """The same column, compressed slowly with inertia and damping."""
    text = COLUMN.format(
        integrator="explicit",
        time=2.0,
        step=1.0,
        interval=2.0,
        velocity=-0.025,
        soil=CLAY,
        more="&mechanics damping = 'viscous' /",
    )
    run = dosui(text)
    assert run.status == 0, run.stderr
    stress = -run.fields("column")["effective_stress"][:, 2]
    assert stress == pytest.approx(oedometer(0.05)[2], rel=0.02)


def test_a_restart_keeps_the_soils_state(dosui: Runner) -> None:
    """Straight and interrupted runs end bit-equal."""
    text = COLUMN.format(
        integrator="explicit",
        time=0.2,
        step=1.0,
        interval=0.1,
        velocity=-0.025,
        soil=CLAY,
        more="&mechanics damping = 'viscous' /",
    )
    straight = dosui(text, folder="straight")
    assert straight.history("column", "step")[-1] > 120
    stops = text.replace("largest_step = 1.0", "largest_step = 1.0 maximum_steps = 100")
    stops = stops.replace("&output", "&output checkpoint_steps = 60")
    first = dosui(stops, folder="parts")
    assert first.status == 0, first.stderr
    second = dosui(text, "--restart", "column.restart.h5", folder="parts")
    assert second.status == 0, second.stderr
    for name in ("effective_stress", "preconsolidation_pressure", "specific_volume"):
        a, b = straight.fields("column")[name], second.fields("column")[name]
        assert np.array_equal(a, b), name

"""A saturated column under a step and a harmonic load, against its modes.

The column is fixed and closed at z = 0, loaded and drained at z = H. In the modes sin(w z) of the
displacement and cos(w z) of the pressure, w = pi (n + 1/2)/H, the equations part (the last term,
the water's inertia in Darcy's law, with `fluid_inertia` only, as in docs/theory/dynamics.md):

    rho a'' = - M w^2 a + w b - (2/H) (-1)^n q(t)
    S b'    = - (k/gamma_w) w^2 b - w a' + (k rho_w/gamma_w) w a''

For q linear in time between the points of its table each mode is advanced exactly.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import Run, Runner
from scipy.linalg import expm

UNIT_WEIGHT, POROSITY, WATER, SOLID, FLUID = 9810.0, 0.33, 2.2e9, 2650.0, 1000.0
MODULUS, HEIGHT, LOAD = 40.0e6, 10.0, 1000.0  # Pa (nu = 0), m, Pa
DENSITY = (1 - POROSITY) * SOLID + POROSITY * FLUID
STORAGE = POROSITY / WATER


@dataclass(frozen=True)
class Motion:
    """A load table and what follows from it."""

    conductivity: float  # m/s
    times: tuple[float, ...]  # of the table [s]
    factors: tuple[float, ...]
    ends: tuple[float, ...]  # output times [s]
    inertia: bool = False  # of the water, in Darcy's law

    @functools.cache  # noqa: B019 (a handful of frozen loads)
    def modes(self, count: int = 200) -> np.ndarray:
        """a, a' and b of each mode at each output time: (output, 3, mode)."""
        w = np.pi * (np.arange(count) + 0.5) / HEIGHT
        mobility = self.conductivity / UNIT_WEIGHT
        knots = sorted({0.0, *self.times, *self.ends})
        state = np.zeros((count, 3))
        found = []
        for start, end in pairwise(knots):
            q0 = LOAD * np.interp(start, self.times, self.factors)
            slope = (LOAD * np.interp(end, self.times, self.factors) - q0) / (end - start)
            push = -(2 / HEIGHT) * (-1.0) ** np.arange(count) / DENSITY
            matrix = np.zeros((count, 5, 5))
            matrix[:, 0, 1] = 1.0
            matrix[:, 1, 0] = -MODULUS * w**2 / DENSITY
            matrix[:, 1, 2] = w / DENSITY
            matrix[:, 1, 3] = push
            matrix[:, 2, 1] = -w / STORAGE
            matrix[:, 2, 2] = -mobility * w**2 / STORAGE
            if self.inertia:
                matrix[:, 2] += (mobility * FLUID * w / STORAGE)[:, None] * matrix[:, 1]
            matrix[:, 3, 4] = 1.0
            # pressures next to displacements would spoil the exponential's accuracy
            scale = np.array([1.0, 1.0, 1.0e9, 1.0e3, 1.0e3])
            full = np.empty((count, 5))
            full[:, :3] = state
            full[:, 3:] = q0, slope
            for n in range(count):
                step = expm((end - start) * matrix[n] * scale / scale[:, None])
                state[n] = (scale * (step @ (full[n] / scale)))[:3]
            if end in self.ends:
                found.append(state.T.copy())
        return np.array(found)

    def exact(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement along z [m] and pore pressure [Pa] at each output time."""
        modes = self.modes()
        w = np.pi * (np.arange(modes.shape[2]) + 0.5) / HEIGHT
        return modes[:, 0] @ np.sin(np.outer(w, z)), modes[:, 2] @ np.cos(np.outer(w, z))

    def scene(self, cells: int, integrator: str, mechanics: str = "") -> str:
        """The namelist."""
        listed = ", ".join(repr(t) for t in self.ends[:-1])
        return f"""
&scene dimension = 1 integrator = '{integrator}' gravity = 0.0 /
&grid spacing = {HEIGHT / cells} /
&time end_time = {self.ends[-1]!r} output_times = {listed} /
&material name = 'sand' young_modulus = {MODULUS} poisson_ratio = 0.0 porosity = {POROSITY}
  solid_density = {SOLID} hydraulic_conductivity = {self.conductivity} /
&water bulk_modulus = {WATER} density = {FLUID} unit_weight = {UNIT_WEIGHT}
  fluid_inertia = .{str(self.inertia).lower()}. /
&mechanics {mechanics} /
&region name = 'column' material = 'sand' box_min = 0.0 box_max = {HEIGHT} particles_per_cell = 2 /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {LOAD}
  factor_times = {", ".join(repr(t) for t in self.times)}
  factor_values = {", ".join(repr(f) for f in self.factors)} /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'column' /
"""

    def errors(self, run: Run) -> tuple[float, float]:
        """L2 errors of displacement and pressure over all outputs, over their largest norm."""
        assert run.status == 0, run.stderr
        z = run.fields("column", 0)["points"][:, 2]
        u, p = self.exact(z)
        wrong_u, wrong_p = [], []
        for step in range(len(self.ends)):
            fields = run.fields("column", step + 1)
            wrong_u.append(np.linalg.norm(fields["displacement"][:, 2] - u[step]))
            wrong_p.append(np.linalg.norm(fields["pore_pressure"] - p[step]))
        scale_u = np.sqrt(np.mean(np.sum(u**2, axis=1)))
        scale_p = np.sqrt(np.mean(np.sum(p**2, axis=1)))
        return (
            float(np.sqrt(np.mean(np.square(wrong_u))) / scale_u),
            float(np.sqrt(np.mean(np.square(wrong_p))) / scale_p),
        )


def stepped(conductivity: float) -> Motion:
    """A load that comes within a fifth of the undrained travel time, then stays."""
    travel = HEIGHT / math.sqrt((MODULUS + WATER / POROSITY) / DENSITY)
    slow = HEIGHT / math.sqrt(MODULUS / DENSITY)
    rise = 0.5 * slow
    assert travel < slow
    return Motion(
        conductivity,
        (0.0, rise, 100.0),
        (0.0, 1.0, 1.0),
        tuple(float(x) for x in np.linspace(0.5, 8.0, 12) * slow),
    )


def harmonic(conductivity: float) -> Motion:
    """Two periods of twice the drained column's fundamental, in 40 pieces each."""
    period = 2 * HEIGHT / np.sqrt(MODULUS / DENSITY)
    times = np.linspace(0.0, 2 * period, 81)
    factors = np.sin(2 * np.pi * times / period)
    return Motion(
        conductivity,
        tuple(float(t) for t in times),
        tuple(float(f) for f in factors),
        tuple(float(t) for t in times[10::10]),
    )


def errors_on_two_grids(
    dosui: Runner, motion: Motion, integrator: str, mechanics: str = ""
) -> np.ndarray:
    """Of displacement and pressure with 20 and 40 cells: (grid, 2)."""
    return np.array(
        [
            motion.errors(
                dosui(motion.scene(cells, integrator, mechanics), folder=f"{integrator}_{cells}")
            )
            for cells in (20, 40)
        ]
    )


@pytest.mark.parametrize("load", [stepped, harmonic])
@pytest.mark.parametrize("conductivity", [1.0e-1, 1.0e-2])
def test_explicit_column(
    dosui: Runner, load: Callable[[float], Motion], conductivity: float
) -> None:
    """Both compression waves: 1e-2 with 40 cells, second order."""
    coarse, fine = errors_on_two_grids(dosui, load(conductivity), "explicit")
    assert fine.max() <= 1.0e-2
    assert np.all(coarse / fine >= 2.0**1.5)


@pytest.mark.parametrize("transfer", ["apic", "flip"])
@pytest.mark.parametrize("load", [stepped, harmonic])
def test_semi_implicit_column(
    dosui: Runner, load: Callable[[float], Motion], transfer: str
) -> None:
    """Steps of the skeleton's wave, first order in time: 4e-2 with 40 cells."""
    coarse, fine = errors_on_two_grids(
        dosui, load(1.0e-2), "semi_implicit", f"transfer = '{transfer}'"
    )
    assert fine.max() <= 4.5e-2
    assert np.all(coarse / fine >= 1.8)


def test_slow_water_moves_with_the_skeleton(dosui: Runner) -> None:
    """k = 1e-3 m/s: layers of pressure that 40 cells hardly resolve."""
    motion = stepped(1.0e-3)
    for integrator, most in (("explicit", 1.5e-2), ("semi_implicit", 4.0e-2)):
        assert errors_on_two_grids(dosui, motion, integrator)[1].max() <= most


@pytest.mark.parametrize("load", [stepped, harmonic])
@pytest.mark.parametrize(("conductivity", "most"), [(1.0e-1, 2.0e-2), (1.0e-2, 1.2e-2)])
def test_fluid_inertia(
    dosui: Runner, load: Callable[[float], Motion], conductivity: float, most: float
) -> None:
    """Stable where pressures follow within a step, and right; without the term up to 30 % off."""
    motion = replace(load(conductivity), inertia=True)
    with_it, without = errors_on_two_grids(dosui, motion, "explicit"), []
    assert with_it[1].max() <= most
    assert np.all(with_it[0] / with_it[1] >= 1.8)
    if conductivity > 5.0e-2 and load is harmonic:
        plain = replace(motion, inertia=False)
        without = motion.errors(dosui(plain.scene(40, "explicit"), folder="without"))
        assert min(without) >= 0.15


def test_where_u_p_ends(dosui: Runner) -> None:
    """--check warns of loads too fast for equations without the water's relative acceleration."""
    fast, slow = (dosui(harmonic(k).scene(20, "explicit"), "--check") for k in (1.0e-1, 1.0e-3))
    assert "k omega/g is 0.44" in fast.stdout + fast.stderr
    assert "k omega/g" not in slow.stdout + slow.stderr
    inert = replace(harmonic(1.0e-3), inertia=True)
    refused = dosui(inert.scene(20, "semi_implicit"), "--check")
    assert refused.status == 2
    assert "fluid_inertia = .true.: in implicit steps" in refused.stderr


SHAKEN = """
&scene dimension = {dim} water = 'none' gravity = {dim}*0.0 integrator = 'explicit' /
&grid spacing = {h} /
&time end_time = 0.5 output_interval = 0.05 courant = 0.4 /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.25 porosity = 0.4
  solid_density = 2500.0 /
&mechanics transfer = 'flip' /
&region name = 'column' material = 'soil' box_min = {dim}*0.0 box_max = {top} /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
{more}
&output name = 'shaken' /
"""
SPEED = float(np.sqrt(1.2e7 / 1500.0))  # of compression waves [m/s]
SHEAR_SPEED = float(np.sqrt(4.0e6 / 1500.0))


def shaken_exact(z: np.ndarray, t: float, speed: float, omega: float) -> np.ndarray:
    """Displacement against a base that is accelerated by sin(omega t), from rest: 400 modes."""
    height, total = 10.0, np.zeros_like(z)
    for m in range(400):
        k = (2 * m + 1) * np.pi / (2 * height)
        w = k * speed
        share = 4 / ((2 * m + 1) * np.pi)
        q = np.sin(omega * t) - omega / w * np.sin(w * t)
        total -= share * q / (w**2 - omega**2) * np.sin(k * z)
    return total


@pytest.mark.parametrize("source", ["formula", "file"])
def test_shaken_base(dosui: Runner, tmp_path: Path, source: str) -> None:
    """A column on a shaken base, by a formula or from a file, against its modes."""
    omega, times = 40.0, np.linspace(0.0, 0.5, 2001)
    table = tmp_path / "motion.txt"
    rows = "\n".join(f"{t:.6f}, {np.sin(omega * t):.9f}" for t in times)
    table.write_text(f"# time, factor\n{rows}\n")
    key = f"formula = 'sin({omega}*t)'" if source == "formula" else f"file = '{table}'"
    more = f"""&base_motion acceleration = 1.0 {key} /
&mechanical_condition surface = 'base' kind = 'roller' /"""
    run = dosui(SHAKEN.format(dim=1, h=0.1, top="10.0", more=more))
    assert run.status == 0, run.stderr
    for step in (4, 7, 10):
        data = run.fields("shaken", step)
        height = data["points"][:, 2]
        exact = shaken_exact(height, run.times("shaken")[step], SPEED, omega)
        error = np.linalg.norm(data["displacement"][:, 2] - exact) / np.linalg.norm(exact)
        assert error < 0.01, step


def test_base_shaken_sideways(dosui: Runner) -> None:
    """A shear column in the plane: every motion of its sides is one, so walls slide upright."""
    omega = 20.0
    more = f"""&surface name = 'left' region = 'column' face = 'x-' /
&base_motion acceleration = 1.0, 0.0 formula = 'sin({omega}*t)' /
&mechanical_condition surface = 'base' kind = 'fixed' /"""
    # 60 m wide: what the free sides disturb has not reached the middle
    text = SHAKEN.format(dim=2, h=0.5, top="80.0, 10.0", more=more)
    run = dosui(text)
    assert run.status == 0, run.stderr
    data = run.fields("shaken", 6)
    rows = np.abs(data["points"][:, 0] - 40.0) < 0.5
    exact = shaken_exact(data["points"][rows, 2], run.times("shaken")[6], SHEAR_SPEED, omega)
    error = np.linalg.norm(data["displacement"][rows, 0] - exact) / np.linalg.norm(exact)
    assert error < 0.02


@pytest.mark.parametrize("base", ["absorbing", "fixed"])
def test_absorbing_base_lets_waves_out(dosui: Runner, base: str) -> None:
    """A pulse from the top leaves through dashpots; a fixed base sends it back."""
    more = f"""&mechanical_condition surface = 'base' kind = '{base}' /
&mechanical_condition surface = 'top' kind = 'pressure' value = 1000.0
  factor_times = 0.0, 0.01, 0.02 factor_values = 0.0, 1.0, 0.0 /"""
    run = dosui(SHAKEN.format(dim=1, h=0.05, top="10.0", more=more))
    assert run.status == 0, run.stderr
    energy = run.history("shaken", "kinetic_energy")
    time = run.history("shaken", "time")
    late = energy[(time > 0.16) & (time < 0.2)].max() / energy.max()
    if base == "absorbing":
        assert late < 1e-3
    else:
        assert late > 0.5

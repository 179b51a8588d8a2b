"""Layers of unlike conductivity: eigenfunctions, steady flow across, balances at contacts."""

from __future__ import annotations

import functools
import random
import re

import numpy as np
import pytest
from conftest import Runner

UNIT_WEIGHT, MODULUS, POROSITY, WATER = 9810.0, 1.0e6, 0.3, 2.2e9
LOAD, SLOW, FAST, HALF = 1000.0, 1.0e-9, 1.0e-3, 0.5  # Pa, m/s, m/s, m
FACTORS = (0.05, 0.1, 0.2, 0.5, 1.0)  # of the slow layer
STORAGE = POROSITY / WATER + 1 / MODULUS
START = LOAD / MODULUS / STORAGE


def time_of(factor: float) -> float:
    """Seconds."""
    return factor * HALF**2 * STORAGE * UNIT_WEIGHT / SLOW


@functools.cache
def modes(base: float, top: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Eigenvalues w, amplitudes of the top layer's sine and of the series, both travel times.

    Base: cos(w a z/h), no flow at z = 0; top: A sin(w b (H - z)/h), drained;
    sqrt(k_base) tan(w a) = sqrt(k_top) cot(w b).
    """
    a, b = (HALF * np.sqrt(STORAGE * UNIT_WEIGHT / k) for k in (base, top))

    def gap(w: np.ndarray) -> np.ndarray:
        return np.sqrt(base) * np.sin(w * a) * np.sin(w * b) - np.sqrt(top) * np.cos(
            w * a
        ) * np.cos(w * b)

    last = np.sqrt(60.0 / time_of(FACTORS[0]))
    grid = np.linspace(0.0, last, 200001)
    values = gap(grid)
    places = np.nonzero(values[1:] * values[:-1] < 0)[0]
    low, high = grid[places], grid[places + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_left = gap(low) * gap(middle) <= 0
        low, high = np.where(is_left, low, middle), np.where(is_left, middle, high)
    w = 0.5 * (low + high)
    # continuity of the head, or of the flux where the sine vanishes
    sine, cosine = np.sin(w * b), np.cos(w * b)
    from_head = np.cos(w * a) / np.where(np.abs(sine) > 1e-3, sine, 1.0)
    from_flux = np.sqrt(base / top) * np.sin(w * a) / np.where(np.abs(cosine) > 1e-3, cosine, 1.0)
    ratio = np.where(np.abs(sine) > 1e-3, from_head, from_flux)
    mean = HALF * (np.sin(w * a) / (w * a) + ratio * (1 - np.cos(w * b)) / (w * b))
    square = HALF * (
        0.5 + np.sin(2 * w * a) / (4 * w * a) + ratio**2 * (0.5 - np.sin(2 * w * b) / (4 * w * b))
    )
    return w, ratio, mean / square, float(a), float(b)


def exact(height: np.ndarray, base: float, top: float, time: float) -> np.ndarray:
    """Pressure of the undrained start's decay [Pa]."""
    w, ratio, amplitude, a, b = modes(base, top)
    z = height[:, None]
    below = np.cos(w * a * np.minimum(z, HALF) / HALF)
    above = ratio * np.sin(w * b * (2 * HALF - np.maximum(z, HALF)) / HALF)
    shape = np.where(z < HALF, below, above)
    return START * np.asarray((amplitude * shape * np.exp(-(w**2) * time)).sum(axis=1))


def scene(base: float, top: float, cells: int, dimension: int = 1) -> str:
    """A column of 1 m, half of each soil."""
    h = 1.0 / cells
    side = f"{2 * h}, " * (dimension - 1)
    zero = "0.0, " * (dimension - 1)
    times = ", ".join(repr(time_of(factor)) for factor in FACTORS)
    soils = "\n".join(
        f"&material name = '{name}' young_modulus = {MODULUS} poisson_ratio = 0.0 "
        f"porosity = {POROSITY} hydraulic_conductivity = {k} /"
        for name, k in (("base", base), ("top", top))
    )
    faces = ("x-", "x+", "y-", "y+")[: 2 * dimension - 2]
    walls = "\n".join(
        f"&surface name = '{r}{f}' region = '{r}' face = '{f}' /\n"
        f"&mechanical_condition surface = '{r}{f}' kind = 'roller' /"
        for f in faces
        for r in ("base", "top")
    )
    return f"""
&scene dimension = {dimension} integrator = 'quasi_static' gravity = {dimension}*0.0 /
&grid spacing = {h} /
&time end_time = {time_of(FACTORS[-1])!r} output_times = {times} relative_tolerance = 1e-5 /
{soils}
&water bulk_modulus = {WATER} /
&region name = 'base' material = 'base' box_min = {zero} 0.0 box_max = {side} {HALF} /
&region name = 'top' material = 'top' box_min = {zero} {HALF} box_max = {side} 1.0 /
&surface name = 'foot' region = 'base' face = 'z-' /
&surface name = 'head' region = 'top' face = 'z+' /
&mechanical_condition surface = 'foot' kind = 'roller' /
{walls}
&mechanical_condition surface = 'head' kind = 'pressure' value = {LOAD} /
&hydraulic_condition surface = 'head' kind = 'head' value = 0.0 /
&output name = 'layers' /
"""


def errors(dosui: Runner, base: float, top: float, cells: int, dimension: int = 1) -> np.ndarray:
    """Relative L2 errors of the pressure at all times."""
    run = dosui(scene(base, top, cells, dimension))
    assert run.status == 0, run.stderr
    found = []
    for step, factor in enumerate(FACTORS):
        fields = run.fields("layers", step + 1)
        right = exact(fields["points"][:, 2], base, top, time_of(factor))
        wrong = fields["pore_pressure"] - right
        found.append(np.linalg.norm(wrong) / np.linalg.norm(right))
    return np.array(found)


@pytest.mark.parametrize(("base", "top"), [(SLOW, FAST), (FAST, SLOW)])
@pytest.mark.parametrize("dimension", [1, 2])
def test_layers(dosui: Runner, base: float, top: float, dimension: int) -> None:
    """A slow base below a drain, and a lake of pressure under a slow lid."""
    coarse = errors(dosui, base, top, 20, dimension)
    fine = errors(dosui, base, top, 80, dimension)
    assert coarse.max() <= 7e-3
    assert fine.max() <= 2.5e-3
    assert fine[:3].max() <= 1e-3
    assert np.all(coarse[:3] / fine[:3] >= 3.0)  # harmonic means: first order at the interface


def across(low: float, high: float, contact: float) -> str:
    """Steady flow down through two layers; heads 1 m above, 0 below."""
    return f"""&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = 0.1 /
&time end_time = 1e13 /
&material name = 'a' rigid = .true. hydraulic_conductivity = {low!r} /
&material name = 'b' rigid = .true. hydraulic_conductivity = {high!r} /
&region name = 'a' material = 'a' box_min = 0, 0 box_max = 0.6, {contact!r} /
&region name = 'b' material = 'b' box_min = 0, {contact!r} box_max = 0.6, 1.0 /
&surface name = 'base' region = 'a' face = 'z-' /
&surface name = 'top' region = 'b' face = 'z+' /
&hydraulic_condition surface = 'top' kind = 'head' value = 1.0 /
&hydraulic_condition surface = 'base' kind = 'head' value = 0.0 /
&output name = 'r' /
"""


@pytest.mark.parametrize("seed", range(6))
def test_flow_beside_a_contact(dosui: Runner, seed: int) -> None:
    """Darcy velocities are those of the particle's own soil, beside the contact, too."""
    draw = random.Random(seed)
    low, contrast, contact = 1.0e-7, 10.0 ** draw.uniform(0.3, 5.0), draw.uniform(0.3, 0.7)
    soils = (low, low * contrast) if draw.random() < 0.5 else (low * contrast, low)
    run = dosui(across(*soils, contact))
    assert run.status == 0, run.stderr
    flow = run.fields("r")["darcy_velocity"]
    right = -1.0 / (contact / soils[0] + (1.0 - contact) / soils[1])
    assert np.abs(flow[:, 2] / right - 1.0).max() <= 0.1
    assert np.abs(flow[:, 0] / right).max() <= 0.02


TILTED = """&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = 0.1 origin = 0.013, 0.013 /
&time end_time = 1e10 relative_tolerance = 1e-3 /
&material name = 'a' rigid = .true. hydraulic_conductivity = 1e-7 /
&material name = 'b' rigid = .true. hydraulic_conductivity = 1e-4 /
&region name = 'a' material = 'a' shape = 'polygon' vertices = -1,-1, 1,-1, 1,0.6, -1,-0.6 /
&region name = 'b' material = 'b' shape = 'polygon' vertices = -1,-0.6, 1,0.6, 1,1, -1,1 /
&output name = 'r' /
""" + "".join(
    f"&surface name = '{region}{k}' region = '{region}' face = 'edge{k}' /\n"
    f"&hydraulic_condition surface = '{region}{k}' kind = 'head' value = 1.0\n"
    "  formula = 'min(z - 0.6*x, 0) + 0.001*max(z - 0.6*x, 0)' /\n"  # steady flow across
    for region, k in (("a", 1), ("a", 2), ("a", 4), ("b", 2), ("b", 3), ("b", 4))
)


def test_contacts_are_named(dosui: Runner) -> None:
    """A bad balance of soils that meet on a slope is the contact's, on any number of ranks."""
    words = []
    for ranks in (1, 3):
        run = dosui(TILTED, ranks=ranks, folder=str(ranks))
        assert run.status == 0, run.stderr
        words += re.findall(
            r"misses .* most probably at (.*) \(\d+ % .* most at (.*) m", run.stderr
        )
    assert words[0][0] == "the contact of 'a' with 'b'"
    assert words[0] == words[1]

"""Water that enters a dry column, against Richards' equation solved here by finite volumes."""

from __future__ import annotations

import numpy as np
from conftest import ROOT, Run, Runner
from scipy.linalg import solve_banded

UNIT_WEIGHT, CONDUCTIVITY, POROSITY = 9810.0, 1.0e-5, 0.45
ALPHA, EXPONENT, RESIDUAL, LEAST = 2.0, 2.5, 0.15, 1.0e-6  # of the shipped scene
FIRST = -1.0e5 / UNIT_WEIGHT  # m
TIMES = (3600.0, 7200.0, 10800.0, 14400.0)  # s
M = 1 - 1 / EXPONENT


def saturation(head: np.ndarray) -> np.ndarray:
    """Van Genuchten (1980) at pressure heads."""
    reduced = np.abs(np.minimum(ALPHA * head, 0.0))
    return RESIDUAL + (1 - RESIDUAL) * (1 + reduced**EXPONENT) ** -M


def capacity(head: np.ndarray) -> np.ndarray:
    """Its slope [1/m]."""
    reduced = np.abs(np.minimum(ALPHA * head, 0.0))
    slope = M * EXPONENT * ALPHA * reduced ** (EXPONENT - 1) * (1 + reduced**EXPONENT) ** (-M - 1)
    return (1 - RESIDUAL) * slope


def relative(head: np.ndarray) -> np.ndarray:
    """Mualem's relative conductivity."""
    share = (saturation(head) - RESIDUAL) / (1 - RESIDUAL)
    return LEAST + (1 - LEAST) * np.sqrt(share) * (1 - (1 - share ** (1 / M)) ** M) ** 2


def richards(cells: int, longest: float) -> list[np.ndarray]:
    """Pressure heads at TIMES from the base up: mixed form, modified Picard (Celia et al. 1990),
    backward Euler; the fronts change by less than 1e-3 between 200 and 400 cells."""
    dz = 1.0 / cells
    head, time, dt = np.full(cells, FIRST), 0.0, 1.0e-2
    found = []
    for end in TIMES:
        while time < end - 1.0e-9:
            dt = min(dt, end - time, longest)
            new, iterations = head.copy(), 0
            for iterations in range(30):  # noqa: B007
                k = CONDUCTIVITY * relative(new)
                inner, top = 0.5 * (k[1:] + k[:-1]), 0.5 * (CONDUCTIVITY + k[-1])
                flux = np.zeros(cells + 1)  # upwards
                flux[1:-1] = -inner * (np.diff(new) / dz + 1)
                flux[-1] = -top * (-new[-1] / (dz / 2) + 1)
                change = POROSITY * (saturation(new) - saturation(head))
                residual = change / dt + np.diff(flux) / dz
                band = np.zeros((3, cells))
                band[1] = POROSITY * (capacity(new) + 1.0e-6) / dt
                band[1, 1:] += inner / dz**2
                band[1, :-1] += inner / dz**2
                band[1, -1] += 2 * top / dz**2
                band[0, 1:] = band[2, :-1] = -inner / dz**2
                step = solve_banded((1, 1), band, -residual)
                new += step
                if np.abs(step).max() < 1.0e-6:
                    break
            else:
                dt *= 0.25
                continue
            head, time = new, time + dt
            dt *= 1.3 if iterations < 6 else 0.8
        found.append(head)
    return found


def front(z: np.ndarray, head: np.ndarray) -> float:
    """Depth where the saturation is half-way between dry and wet [m]."""
    wet = saturation(head)
    half = 0.5 * (wet.min() + 1.0)
    last = np.nonzero(wet < half)[0].max()
    return float(1.0 - np.interp(half, wet[last : last + 2], z[last : last + 2]))


def fronts(run: Run) -> np.ndarray:
    """Of all outputs."""
    found = []
    for step in range(1, len(TIMES) + 1):
        fields = run.fields("infiltration", step)
        order = np.argsort(fields["points"][:, 2])
        head = fields["pore_pressure"][order] / UNIT_WEIGHT
        found.append(front(fields["points"][order, 2], head))
    return np.array(found)


def test_front(dosui: Runner) -> None:
    """The front of the shipped scene is within 2 % of Richards', with half the cells, too."""
    z = (np.arange(200) + 0.5) / 200
    right = np.array([front(z, head) for head in richards(200, 10.0)])
    text = (ROOT / "input/infiltration/scene.nml").read_text()
    for spacing, limit in (("0.04", 2.0e-2), ("0.02", 1.0e-2)):
        run = dosui(text.replace("spacing = 0.02", f"spacing = {spacing}"), folder=spacing)
        assert run.status == 0, run.stderr
        assert np.abs(fronts(run) / right - 1).max() <= limit


def test_front_in_the_plane(dosui: Runner) -> None:
    """The same column in 2-D, its particles jittered, on two ranks."""
    z = (np.arange(200) + 0.5) / 200
    right = front(z, richards(200, 10.0)[0])
    text = (ROOT / "input/infiltration/scene.nml").read_text()
    for old, new in (
        ("dimension = 1", "dimension = 2"),
        ("gravity = -9.81", "gravity = 0.0, -9.81"),
        ("spacing = 0.02", "spacing = 0.04"),
        ("box_min = 0.0", "box_min = 0.0, 0.0 jitter = 0.2"),
        ("box_max = 1.0", "box_max = 0.16, 1.0"),
        ("end_time = 14400.0", "end_time = 3600.0"),
    ):
        text = text.replace(old, new)
    run = dosui(text, ranks=2)
    assert run.status == 0, run.stderr
    fields = run.fields("infiltration")
    levels = np.arange(0.3, 0.98, 0.04)
    near = [np.abs(fields["points"][:, 2] - level) < 0.03 for level in levels]
    head = np.array([fields["pore_pressure"][rows].mean() for rows in near]) / UNIT_WEIGHT
    assert abs(front(levels, head) / right - 1) <= 5.0e-2

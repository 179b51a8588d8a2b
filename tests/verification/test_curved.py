"""Bodies with curved surfaces that neither grid nor lattice follows."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import ROOT, Run, Runner
from dosui_post.exact import RadialConsolidation, Soil
from scipy import special

FACTORS = (0.01, 0.05, 0.1, 0.2, 0.5)


def solution(dimension: int, nu: float) -> RadialConsolidation:
    """That of the scenes."""
    soil = Soil(1.0e6, nu, 0.3, 1.0e-7, 2.2e9, 9810.0)
    return RadialConsolidation(soil, 1000.0, 1.0, dimension)


def scene(dimension: int, spacing: float, nu: float = 0.2, region: str = "") -> str:
    """A shipped scene with other values."""
    folder = {2: "de_leeuw", 3: "cryer"}[dimension]
    text = (ROOT / "input" / folder / "scene.nml").read_text()
    text = re.sub(r"&grid\s+spacing = [0-9.]+", f"&grid\n  spacing = {spacing}", text)
    text = text.replace("poisson_ratio = 0.2", f"poisson_ratio = {nu}")
    times = [solution(dimension, nu).time(factor) for factor in FACTORS]
    text = re.sub(r"end_time = .*", f"end_time = {times[-1]!r}", text)
    listed = ", ".join(repr(t) for t in times[:-1])
    text = re.sub(r"output_times = .*", f"output_times = {listed}", text)
    return text.replace("particles_per_cell = 2", f"particles_per_cell = 2\n  {region}")


def errors(run: Run, name: str, exact: RadialConsolidation) -> tuple[np.ndarray, np.ndarray]:
    """L2 errors at all times: pressure, relative; displacement, over the final one."""
    assert run.status == 0, run.stderr
    pressure, displacement = [], []
    for step, factor in enumerate(FACTORS):
        fields = run.fields(name, step + 1)
        time, x = exact.time(factor), fields["points"]
        r = np.linalg.norm(x, axis=1)
        right = exact.pressure(r, time)
        pressure.append(np.linalg.norm(fields["pore_pressure"] - right) / np.linalg.norm(right))
        moved = x * (exact.displacement(r, time) / r)[:, None]
        final = x * (exact.displacement(r, exact.time(5.0)) / r)[:, None]
        displacement.append(np.linalg.norm(fields["displacement"] - moved) / np.linalg.norm(final))
    return np.array(pressure), np.array(displacement)


def history_error(run: Run, name: str, exact: RadialConsolidation) -> tuple[float, float]:
    """Largest error of the centre's pressure from T = 0.01 on, and of its peak, over u0."""
    times, centre = run.history(name, "time"), run.history(name, "centre_pressure")
    after = times >= exact.time(0.01)
    right = np.array([float(exact.pressure(0.0, t)) for t in times[after]])
    u0 = exact.initial_pressure
    dense = [float(exact.pressure(0.0, exact.time(t))) for t in np.linspace(0.01, 0.3, 400)]
    peak = abs(float(centre.max()) - max(dense)) / max(dense)
    return float(np.max(np.abs(centre[after] - right)) / u0), peak


@pytest.mark.parametrize("nu", [0.0, 0.4])
@pytest.mark.parametrize("region", ["", "jitter = 0.25", "lattice_angle = 30.0"])
def test_de_leeuw(dosui: Runner, nu: float, region: str) -> None:
    """The quarter of a cylinder; also with particles off a lattice along the symmetry planes."""
    found = []
    for cells in (10, 20):
        run = dosui(scene(2, 1.0 / cells, nu, region), folder=str(cells))
        found.append(errors(run, "de_leeuw", solution(2, nu)))
        largest, peak = history_error(run, "de_leeuw", solution(2, nu))
        assert largest <= {10: 1.0e-2, 20: 3.0e-3}[cells]
        assert peak <= {10: 5.0e-3, 20: 1.5e-3}[cells]
    coarse, fine = found
    assert coarse[0].max() <= 1.0e-2
    assert fine[0].max() <= 3.0e-3
    assert fine[1].max() <= 5.0e-3
    assert coarse[0][0] / fine[0][0] >= 2.0**1.5


def test_de_leeuw_off_the_grid(dosui: Runner) -> None:
    """Grid lines anywhere: the lattice's middles then lie off those of all cells alike."""
    aligned = scene(2, 0.05, 0.0)
    moved = aligned.replace("&grid", "&grid origin = 0.0185, 0.0285")
    on, off = (
        errors(dosui(text, folder=name), "de_leeuw", solution(2, 0.0))
        for name, text in (("on", aligned), ("off", moved))
    )
    for aligned_errors, moved_errors in zip(on, off, strict=True):
        assert moved_errors.max() <= 1.5 * aligned_errors.max()


@pytest.mark.parametrize(
    "region",
    [
        "jitter = 0.25",
        pytest.param("", marks=pytest.mark.long),
        pytest.param("lattice_angle = 30.0", marks=pytest.mark.long),
    ],
)
def test_cryer(dosui: Runner, region: str) -> None:
    """The eighth of a sphere; also with particles off a lattice along the symmetry planes."""
    found = []
    for cells in (5, 10):
        run = dosui(scene(3, 1.0 / cells, 0.0, region), folder=str(cells), timeout=300)
        found.append(errors(run, "cryer", solution(3, 0.0)))
        largest, peak = history_error(run, "cryer", solution(3, 0.0))
        assert largest <= {5: 3.5e-2, 10: 1.0e-2}[cells]
        assert peak <= {5: 2.0e-2, 10: 5.0e-3}[cells]
    coarse, fine = found
    assert fine[0].max() <= 1.0e-2
    assert coarse[0][0] / fine[0][0] >= 2.0**1.3


def rigid(text: str, factors: tuple[float, ...]) -> str:
    """A shipped scene without deformation, at 1000 Pa before water leaves through its surface."""
    text = text.replace("young_modulus = 1.0e6\n  poisson_ratio = 0.2", "rigid = .true.")
    text = re.sub(r"&mechanical_condition.*\n", "", text)
    text += "&initial_state pore_pressure = 'given' pore_pressure_value = 1000.0 /\n"
    text = re.sub(r"&verification.*?\n/\n", "", text, flags=re.S)
    diffusivity = 1.0e-7 * 2.2e9 / (9810.0 * 0.3)
    times = [factor / diffusivity for factor in factors]
    text = re.sub(r"end_time = .*", f"end_time = {times[-1]!r}", text)
    listed = ", ".join(repr(t) for t in times[:-1])
    text = re.sub(r"output_times = .*", f"output_times = {listed}", text)
    return text.replace("&time", "&time\n  relative_tolerance = 1.0e-5")


def drained_pressure(dimension: int, r: np.ndarray, factor: float) -> np.ndarray:
    """Of a rigid disc or ball, at D t/a2 (Crank 1975, eqs 5.22 and 6.18)."""
    n = np.arange(1, 61)
    if dimension == 2:
        roots = special.jn_zeros(0, n.size)
        modes = special.j0(roots * r[:, None]) / (roots * special.j1(roots))
    else:
        roots = n * np.pi
        modes = -((-1.0) ** n) * np.sinc(n * r[:, None])
    return 2000.0 * (modes * np.exp(-(roots**2) * factor)).sum(axis=1)


def drainage_errors(run: Run, name: str, dimension: int, factors: tuple[float, ...]) -> np.ndarray:
    """L2 errors at all times, relative."""
    assert run.status == 0, run.stderr
    found = []
    for step, factor in enumerate(factors):
        fields = run.fields(name, step + 1)
        right = drained_pressure(dimension, np.linalg.norm(fields["points"], axis=1), factor)
        found.append(np.linalg.norm(fields["pore_pressure"] - right) / np.linalg.norm(right))
    return np.array(found)


@pytest.mark.parametrize(
    "region",
    [
        pytest.param("shape_angle = 20.0\n  lattice_angle = 20.0", marks=pytest.mark.long),
        pytest.param("jitter = 0.25", marks=pytest.mark.long),
        "lattice_angle = 7.0 jitter = 0.4",
    ],
)
def test_drainage_of_a_disc(dosui: Runner, region: str) -> None:
    """Whole and rigid; the same on any number of ranks."""
    text = rigid(scene(2, 0.1, 0.2, region), FACTORS)
    text = re.sub(r"cut_min = .*", "", text)
    text = re.sub(r"&surface .*'(left|bottom)'.*\n", "", text)
    runs = {}
    for spacing, ranks in ((0.1, 1), (0.1, 3), (0.05, 2)):
        changed = text.replace("spacing = 0.1", f"spacing = {spacing}")
        runs[spacing, ranks] = dosui(changed, ranks=ranks, folder=f"{spacing}_{ranks}")
    coarse = drainage_errors(runs[0.1, 1], "de_leeuw", 2, FACTORS)
    fine = drainage_errors(runs[0.05, 2], "de_leeuw", 2, FACTORS)
    assert fine.max() <= 2.0e-3
    assert coarse[1] / fine[1] >= 2.0**1.7

    def in_order(run: Run) -> np.ndarray:
        fields = run.fields("de_leeuw", len(FACTORS))
        return fields["pore_pressure"][np.argsort(fields["id"])]

    assert np.max(np.abs(in_order(runs[0.1, 3]) - in_order(runs[0.1, 1]))) <= 1.0e-11 * 1000.0


@pytest.mark.long
def test_drainage_of_a_ball(dosui: Runner) -> None:
    """The eighth of a rigid one, jittered."""
    factors = FACTORS[:4]
    found = []
    for cells in (8, 16):
        text = rigid(scene(3, 1.0 / cells, 0.2, "jitter = 0.25"), factors)
        run = dosui(text, ranks=2, folder=str(cells), timeout=300)
        found.append(drainage_errors(run, "cryer", 3, factors))
    coarse, fine = found
    assert fine.max() <= 2.0e-3
    assert np.all(coarse / fine >= 2.0**1.7)


def test_impossible_shapes(dosui: Runner) -> None:
    """Bad radii and cuts are named with their lines."""
    text = scene(2, 0.1).replace("radius = 1.0", "radius = 0.0")
    run = dosui(text, "--check")
    assert run.status == 2
    assert "radius" in run.stderr
    for wrong, message in (
        ("cut_min = 0.8, 0.8", "leave nothing"),
        ("cut_min = 0.0, 0.0 cut_max = -1.0, 1.0", "must be above cut_min"),
        ("cut_min = -2.0, 0.0", "round, all"),
    ):
        run = dosui(scene(2, 0.1).replace("cut_min = 0.0, 0.0", wrong), "--check")
        assert run.status == 2, wrong
        assert message in run.stderr, run.stderr
    run = dosui(scene(2, 0.1).replace("'circle'", "'sphere'"), "--check")
    assert run.status == 2
    assert "a sphere needs a scene in 3-D" in run.stderr

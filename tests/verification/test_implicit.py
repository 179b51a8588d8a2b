"""Quasi-static and semi-implicit integrators against exact solutions, and their hard cases."""

from __future__ import annotations

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from columns import Column
from conftest import Run, Runner
from manufactured import Manufactured
from test_columns import errors

REAL_WATER = 2.2e9
STATIC = Column(integrator="quasi_static", bulk_modulus=REAL_WATER, conductivity=1.0e-7)


def norm(found: np.ndarray, exact: np.ndarray) -> float:
    """Relative L2 difference."""
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def steps_of(run: Run) -> int:
    """Time steps of a finished run."""
    found = re.search(r"after (\d+) steps", run.stdout)
    assert found
    return int(found.group(1))


@pytest.mark.parametrize("conductivity", [1e-5, 1e-7, 1e-9])
def test_terzaghi_with_real_water(dosui: Runner, conductivity: float) -> None:
    """1e-3 up to T = 0.5, 2e-3 at T = 1, in at most 80 steps."""
    column = replace(STATIC, conductivity=conductivity)
    found = errors(dosui, column)
    assert found[0] <= 1e-12
    assert found[1:5].max() <= 1e-3
    assert found[5] <= 2e-3
    assert steps_of(dosui(column.text())) <= 80


@pytest.mark.parametrize(
    "change",
    [
        {"per_cell": 2, "jitter": 0.25},
        {"per_cell": 2, "jitter": 0.25, "grid": "shape_function = 'bspline'"},
        {"per_cell": 2, "grid": "shape_function = 'gimp'"},
        {"per_cell": 2, "mechanics": "coupling_gradient = 'particle'"},
        {"per_cell": 2, "mechanics": "average_volume_change = .false."},
        {"rigid": True, "angle": 30.0, "jitter": 0.2},
        {"solver": "linear = 'iterative'"},
        {"poisson_ratio": 0.0, "bulk_modulus": 1.0e12},
        {"poisson_ratio": 0.45, "young_modulus": 2.0e7},
    ],
)
def test_columns_of_all_kinds(dosui: Runner, change: dict[str, object]) -> None:
    """Particles off the lattice, other shapes, solvers and soils: 2e-3 at all times."""
    assert errors(dosui, replace(STATIC, **change))[1:].max() <= 2e-3


def test_turned_column(dosui: Runner) -> None:
    """Walls, load and drainage off the grid lines: exact at first, then falling with dx**1.7."""
    worst = []
    for spacing in (0.05, 0.025, 0.0125):
        column = replace(STATIC, spacing=spacing, per_cell=2, angle=30.0, last=0.5)
        found = errors(dosui, column)
        assert found[0] <= 1e-12
        assert found[4] <= 5e-4  # what steps in time leave
        worst.append(found[1:4].max())
    assert worst[1] <= 5e-4
    assert worst[0] / worst[1] >= 2.5
    assert worst[1] / worst[2] >= 2.5


@pytest.mark.parametrize("change", [{"angle": 30.0}, {"jitter": 0.25}])
def test_any_number_of_ranks(dosui: Runner, change: dict[str, float]) -> None:
    """Direct solutions agree to 1e-11."""
    column = replace(STATIC, per_cell=2, last=0.1, **change)
    fields = [dosui(column.text(), ranks=n).fields("column") for n in (1, 2, 5)]
    for name in ("pore_pressure", "displacement", "effective_stress", "velocity"):
        for other in fields[1:]:
            scale = np.abs(fields[0][name]).max()
            assert np.abs(other[name] - fields[0][name]).max() <= 1e-11 * scale, name


@pytest.mark.parametrize(
    ("integrator", "linear"),
    [("quasi_static", "direct"), ("quasi_static", "iterative"), ("semi_implicit", "direct")],
)
def test_restart_is_bit_equal(dosui: Runner, integrator: str, linear: str) -> None:
    """A run that was cut in two is the run that was not."""
    column = replace(
        STATIC,
        integrator=integrator,
        conductivity=1e-3,
        last=0.05,
        solver=f"linear = '{linear}'",
    )
    limits = {"quasi_static": (20, 12), "semi_implicit": (200, 120)}[integrator]
    text = column.text().replace("&output", f"&output checkpoint_steps = {limits[1]}")
    whole = dosui(text.replace("&time", f"&time maximum_steps = {limits[0]}"), folder="whole")
    first = dosui(text.replace("&time", f"&time maximum_steps = {limits[1] + 1}"), folder="parts")
    assert whole.status == 0 and first.status == 0, whole.stderr + first.stderr
    second = dosui(
        text.replace("&time", f"&time maximum_steps = {limits[0]}"),
        "--restart",
        str(first.folder / "column.restart.h5"),
        folder="parts",
    )
    assert second.status == 0, second.stderr
    for name, values in whole.fields("column").items():
        assert np.array_equal(values, second.fields("column")[name]), name


@pytest.mark.parametrize("bulk_modulus", [REAL_WATER, 1.0e12])
@pytest.mark.parametrize(
    ("jitter", "per_cell", "allowed"), [(0.0, 1, 5e-3), (0.0, 2, 5e-3), (0.25, 2, 1e-2)]
)
def test_first_drained_step_does_not_overshoot(
    dosui: Runner, bulk_modulus: float, jitter: float, per_cell: int, allowed: float
) -> None:
    """k = 1e-12: the undrained pressure is exact, and nothing rises beside the drained edge."""
    column = replace(
        STATIC, conductivity=1e-12, bulk_modulus=bulk_modulus, jitter=jitter, per_cell=per_cell
    )
    text = re.sub(r"&time [^/]*/", "&time end_time = 1.0e5 time_step = 1.0e5 /", column.text())
    run = dosui(text)
    assert run.status == 0, run.stderr
    u0 = column.initial_pressure
    assert norm(run.fields("column", 0)["pore_pressure"], np.full(1, u0)) <= 1e-9 * 400
    last = run.fields("column")["pore_pressure"] / u0
    assert last.max() <= 1.0 + allowed
    assert last.min() >= 0.0


def strip_load(jitter: float, per_cell: int, poisson_ratio: float, bulk_modulus: float) -> str:
    """A strip load of width 1 m on 5 m x 5 m, k = 1e-12."""
    return f"""
&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = 0.1 /
&time end_time = 1.0e5 /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = {poisson_ratio} porosity = 0.3
  hydraulic_conductivity = 1.0e-12 /
&water bulk_modulus = {bulk_modulus} /
&region name = 'soil' material = 'soil' box_min = 0, 0 box_max = 5, 5
  particles_per_cell = {per_cell} jitter = {jitter} /
&surface name = 'base' region = 'soil' face = 'z-' /
&surface name = 'top' region = 'soil' face = 'z+' /
&surface name = 'strip' region = 'soil' face = 'z+' box_min = -1, 0 box_max = 1, 6 /
&surface name = 'left' region = 'soil' face = 'x-' /
&surface name = 'right' region = 'soil' face = 'x+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'strip' kind = 'pressure' value = 1000 /
&hydraulic_condition surface = 'top' kind = 'head' value = 0 /
&hydraulic_condition surface = 'strip' kind = 'head' value = 0 /
&probe name = 'settlement' kind = 'settlement' surface = 'strip' /
&output name = 'strip' /
"""


@pytest.mark.parametrize(("jitter", "per_cell"), [(0.0, 1), (0.0, 2), (0.25, 2)])
def test_strip_load_keeps_pressures_bounded(dosui: Runner, jitter: float, per_cell: int) -> None:
    """0 <= u/q <= 1 in the undrained state and after the first steps, up to K_w = 1e12."""
    for bulk_modulus in (REAL_WATER, 1.0e12):
        run = dosui(strip_load(jitter, per_cell, 0.2, bulk_modulus))
        assert run.status == 0, run.stderr
        for step in (0, -1):
            pressure = run.fields("strip", step)["pore_pressure"] / 1000.0
            assert pressure.min() >= 0.0
            assert pressure.max() <= 1.0


@pytest.mark.parametrize(
    ("spacing", "per_cell", "jitter"),
    [
        (0.2, 1, 0.0),
        (0.2, 2, 0.0),
        (0.1, 1, 0.0),
        pytest.param(0.1, 2, 0.25, marks=pytest.mark.long),
    ],
)
def test_strip_load_does_not_lock(
    dosui: Runner, spacing: float, per_cell: int, jitter: float
) -> None:
    """nu = 0.499, undrained: the settlement of the finest grids (0.05 m, both kinds of cells)."""
    text = strip_load(jitter, per_cell, 0.499, REAL_WATER)
    run = dosui(text.replace("spacing = 0.1", f"spacing = {spacing}").replace("1.0e5", "1.0"))
    assert run.status == 0, run.stderr
    assert run.history("strip", "settlement")[0] == pytest.approx(1.1456e-3, rel=5e-3)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_tolerance_bounds_the_error(dosui: Runner, tolerance: float) -> None:
    """Iterative solutions differ from direct ones by the tolerance, on almost rigid water, too."""
    column = replace(STATIC, bulk_modulus=2.2e9, last=0.05)
    runs = [
        dosui(
            replace(column, solver=f"linear = '{linear}' tolerance = {tolerance}").text(),
            folder=linear,
        )
        for linear in ("direct", "iterative")
    ]
    for step in (0, -1):
        exact, found = (run.fields("column", step) for run in runs)
        for name in ("pore_pressure", "displacement"):
            error = np.linalg.norm(found[name] - exact[name]) / np.linalg.norm(exact[name])
            assert error <= tolerance, (step, name)


def test_iterative_solutions_on_any_number_of_ranks(dosui: Runner) -> None:
    """A tolerance far below that of the steps: ranks choose the same steps."""
    column = replace(STATIC, per_cell=2, jitter=0.25, last=0.05)
    exact = dosui(column.text(), folder="direct")
    tolerance = 1e-8
    column = replace(column, solver=f"linear = 'iterative' tolerance = {tolerance}")
    run = dosui(column.text(), ranks=3)
    assert run.status == 0, run.stderr
    assert "iterative solutions" in run.stdout
    steps = exact.history("column", "dt")
    assert run.history("column", "dt") == pytest.approx(steps, rel=tolerance)
    for step in (0, -1):
        for name in ("pore_pressure", "displacement"):
            found, right = (r.fields("column", step)[name] for r in (run, exact))
            assert norm(found, right) <= tolerance, (step, name)


@pytest.mark.long
def test_direct_solutions_where_iterations_fail(
    dosui: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A system above the direct limit whose iterations stop: factorised, and said so."""
    text = strip_load(0.0, 1, 0.3, REAL_WATER).replace("spacing = 0.1", "spacing = 0.0625")
    text = text.replace("1.0e5", "1.0")
    right = dosui(text, folder="right")
    assert "iterative solutions" in right.stdout
    poor = "-dosui_split_fieldsplit_u_pc_type none -dosui_split_fieldsplit_p_pc_type none"
    monkeypatch.setenv("PETSC_OPTIONS", poor)
    run = dosui(text, folder="left")
    assert run.status == 0, run.stderr
    assert "direct solutions from now on" in run.stderr + run.stdout
    found = [r.history("strip", "settlement")[-1] for r in (run, right)]
    assert found[0] == pytest.approx(found[1], rel=1e-6)


@pytest.mark.parametrize(
    ("dimension", "cells", "per_cell"),
    [
        (1, (20, 40, 80), 1),
        (2, (8, 16, 32), 1),
        pytest.param(2, (8, 16, 32), 2, marks=pytest.mark.long),
        pytest.param(3, (4, 8), 2, marks=pytest.mark.long),
    ],
)
def test_manufactured_solution_order_in_space(
    dosui: Runner, dimension: int, cells: tuple[int, ...], per_cell: int
) -> None:
    """Order 1.8 and more between the two finest grids, pressures and displacements."""
    found = []
    for n in cells:
        scene = Manufactured(
            dimension, n, per_cell, time=f"relative_tolerance = {1e-5 if dimension == 3 else 1e-6}"
        )
        run = dosui(scene.text(), timeout=300)
        assert run.status == 0, run.stderr
        data = run.fields("manufactured")
        pressure, displacement = scene.exact(data["points"])
        found.append(
            [norm(data["pore_pressure"], pressure), norm(data["displacement"], displacement)]
        )
    order = np.log2(np.array(found[-2]) / np.array(found[-1]))
    assert order.min() >= 1.8, f"errors {found}, orders {order}"


@pytest.mark.parametrize(
    ("integrator", "mechanics", "conductivity", "steps", "reference", "order"),
    [
        ("quasi_static", "", 1.0e-6, (16, 32, 64), 256, 1.9),
        ("semi_implicit", "transfer = 'flip'", 1.0e-2, (256, 512, 1024), 8192, 0.95),
    ],
)
def test_manufactured_solution_order_in_time(
    dosui: Runner,
    integrator: str,
    mechanics: str,
    conductivity: float,
    steps: tuple[int, ...],
    reference: int,
    order: float,
) -> None:
    """Fixed steps on one grid, compared with much smaller ones."""

    def pressures(n: int) -> np.ndarray:
        scene = Manufactured(integrator=integrator, mechanics=mechanics, conductivity=conductivity)
        text = replace(scene, time=f"time_step = {scene.end / n!r}").text()
        run = dosui(text)
        assert run.status == 0, run.stderr
        return run.fields("manufactured")["pore_pressure"]

    exact = pressures(reference)
    found = [norm(pressures(n), exact) for n in steps]
    orders = np.log2(np.array(found[:-1]) / np.array(found[1:]))
    assert orders.min() >= order, f"errors {found}, orders {orders}"


@pytest.mark.parametrize("conductivity", [1e-2, 1e-4, 1e-7, 1e-9])
@pytest.mark.parametrize(("transfer", "courant"), [("flip", 0.8), ("apic", 1.0)])
def test_semi_implicit_limit(
    dosui: Runner, transfer: str, courant: float, conductivity: float
) -> None:
    """Stable with real water at the limit of the skeleton's wave, whatever the conductivity."""
    for change in ({}, {"per_cell": 2, "jitter": 0.25}):
        column = replace(
            STATIC,
            integrator="semi_implicit",
            conductivity=conductivity,
            mechanics=f"transfer = '{transfer}'",
            time=f"courant = {courant} maximum_steps = 1000",
            **change,
        )
        run = dosui(column.text())
        assert run.status == 0, run.stderr
        data = run.fields("column")
        if conductivity <= 1e-4:
            pressure = data["pore_pressure"] / column.load
            assert pressure.min() >= -0.01
            assert pressure.max() <= 1.01
        assert np.abs(data["velocity"]).max() <= 0.05


def test_semi_implicit_terzaghi(dosui: Runner) -> None:
    """As accurate as explicit steps, with real water and k = 1e-3."""
    column = replace(STATIC, integrator="semi_implicit", conductivity=1e-3, last=0.2)
    found = errors(dosui, column)
    assert found[0] <= 1e-12
    assert found[1:].max() <= 2e-3


def test_semi_implicit_updated_mode(dosui: Runner) -> None:
    """Moving particles on 1 and 3 ranks."""
    column = replace(
        STATIC,
        integrator="semi_implicit",
        conductivity=1e-3,
        per_cell=2,
        last=0.1,
        grid="shape_function = 'gimp'",
        time="courant = 0.8 maximum_steps = 200",
    )
    text = column.text().replace("dimension = 2", "dimension = 2 deformation = 'updated'")
    alone, three = (dosui(text, ranks=n) for n in (1, 3))
    assert alone.status == 0, alone.stderr
    for name in ("pore_pressure", "displacement"):
        first, second = alone.fields("column")[name], three.fields("column")[name]
        assert np.abs(first - second).max() <= 1e-11 * np.abs(first).max()


def test_dry_and_rigid_scenes(dosui: Runner) -> None:
    """A dry column settles at once; wrong combinations are refused by name."""
    text = STATIC.text().replace("dimension = 2", "dimension = 2 water = 'none'")
    text = re.sub(r"&water[^/]*/|&hydraulic_condition[^/]*/", "", text)
    text = text.replace(f"hydraulic_conductivity = {STATIC.conductivity}", "")
    run = dosui(text)
    assert run.status == 0, run.stderr
    top = run.fields("column")["displacement"][:, 2].min()
    assert top == pytest.approx(-STATIC.load * STATIC.softness * 0.9875, rel=1e-9)
    refused = dosui(STATIC.text().replace("&water", "&water operator = 'two_pass'"))
    assert refused.status == 2
    assert "two_pass" in refused.stderr


def test_auto_chooses_and_says_why(dosui: Runner) -> None:
    """Consolidation is quasi-static, a body in motion is not; --check prints estimates."""
    text = replace(STATIC, integrator="auto").text()
    run = dosui(text, "--check")
    assert "integrator   quasi_static (nothing in the scene has inertia)" in run.stdout
    assert re.search(r"about .* explicit, .* semi_implicit, .* quasi_static steps", run.stdout)
    moving = text.replace("jitter_seed = 1", "jitter_seed = 1 velocity = 0.0, 1.0")
    assert "integrator   semi_implicit" in dosui(moving, "--check").stdout


def test_solver_failure_ends_cleanly(dosui: Runner) -> None:
    """A body that nothing holds has no equilibrium: an error, and no result that looks finished."""
    text = re.sub(r"&mechanical_condition surface = '(base|left|right)'[^/]*/", "", STATIC.text())
    run = dosui(text, ranks=2)
    assert run.status != 0
    assert "error" in run.stderr
    path = run.folder / "column.vtkhdf"
    if path.exists():
        with h5py.File(path) as file:
            assert int(file["VTKHDF/Steps"].attrs["NSteps"]) == 0


def test_semi_implicit_factorises_once(dosui: Runner) -> None:
    """The case of the well-known MPI code: 2e-3 to T = 0.5 in 1270 steps, a matrix or two."""
    soil = {"young_modulus": 1.0e7, "conductivity": 1.0e-3, "bulk_modulus": REAL_WATER}
    column = replace(
        STATIC,
        **soil,
        spacing=0.0125,
        per_cell=2,
        last=0.5,
        integrator="semi_implicit",
        mechanics="damping = 'viscous'",
        time="courant = 1.0",
    )
    text = column.text().replace("= 0.25, 1.0", "= 0.025, 1.0")
    run = dosui(text)
    assert run.status == 0, run.stderr
    counts = re.search(r"direct solutions (\d+), set-ups (\d+)", run.stdout)
    assert counts
    assert int(counts[1]) <= 1300
    assert int(counts[2]) <= 8
    for step, time in enumerate(run.times("column")):
        data = run.fields("column", step)
        right = column.exact(data["points"], time) if step > 0 else column.initial_pressure
        size = np.linalg.norm(right * np.ones(len(data["points"])))
        assert np.linalg.norm(data["pore_pressure"] - right) <= 2.0e-3 * size

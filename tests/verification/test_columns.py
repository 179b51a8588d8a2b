"""Turned and disordered columns, and what the classic cases hide."""

from __future__ import annotations

import re

import numpy as np
import pytest
from columns import Column
from conftest import Runner


def errors(dosui: Runner, column: Column, ranks: int = 1) -> np.ndarray:
    """Relative L2 errors of the pressure at all output times."""
    run = dosui(column.text(), ranks=ranks, timeout=600)
    assert run.status == 0, run.stderr
    worst = []
    for step, time in enumerate(run.times("column")):
        data = run.fields("column", step)
        exact = column.initial_pressure if step == 0 else column.exact(data["points"], time)
        worst.append(np.linalg.norm(data["pore_pressure"] - exact))
        worst[-1] /= np.linalg.norm(exact * np.ones(len(data["points"])))
    return np.array(worst)


@pytest.mark.parametrize("jitter", [0.0, 0.25])
@pytest.mark.parametrize("angles", [(0.0, 0.0), (30.0, 0.0), (30.0, 30.0)])
def test_drainage_of_turned_and_jittered_columns(
    dosui: Runner, angles: tuple[float, float], jitter: float
) -> None:
    """A rigid skeleton: at most 1e-3, order 1.7 and more (root mean square over the times)."""
    angle, lattice_angle = angles
    norms = []
    for spacing in (0.05, 0.025, 0.0125):
        column = Column(
            spacing=spacing, angle=angle, lattice_angle=lattice_angle, jitter=jitter, rigid=True
        )
        found = errors(dosui, column)[1:]
        norms.append(np.sqrt(np.mean(found**2)))
        if spacing == 0.025:
            assert found.max() <= 1e-3
    orders = np.log2(np.array(norms[:-1]) / np.array(norms[1:]))
    assert orders.min() >= 1.7, f"errors {norms}, orders {orders}"


@pytest.mark.parametrize("shape", ["linear", "gimp", "bspline"])
@pytest.mark.parametrize("seed", [1, pytest.param(7, marks=pytest.mark.long)])
def test_jittered_coupled_column(dosui: Runner, shape: str, seed: int) -> None:
    """Disorder costs nothing: undrained pressure at round-off, errors as on the lattice."""
    column = Column(
        spacing=0.03125, per_cell=2, jitter=0.25, seed=seed, last=0.5,
        grid=f"shape_function = '{shape}'",
    )  # fmt: skip
    found = errors(dosui, column)
    assert found[0] <= 1e-10
    assert found[1:].max() <= 5e-3


@pytest.mark.long
def test_turned_coupled_column(dosui: Runner) -> None:
    """Rollers, load and drainage on surfaces that no grid line follows: 2e-3, order 0.9."""
    norms = []
    for spacing in (0.05, 0.025):
        column = Column(spacing=spacing, per_cell=2, angle=30.0, lattice_angle=30.0, last=0.5)
        found = errors(dosui, column)[1:]
        norms.append(np.sqrt(np.mean(found**2)))
    assert found.max() <= 2e-3
    assert np.log2(norms[0] / norms[1]) >= 0.9, norms


@pytest.mark.parametrize("per_cell", [1, 2])
@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_undrained_pressure(dosui: Runner, per_cell: int, jitter: float) -> None:
    """At t = 0+ the water carries its share of the load; in one cell, too."""
    column = Column(per_cell=per_cell, last=0.05, time="maximum_steps = 1", jitter=jitter)
    run = dosui(column.text())
    assert run.status == 0, run.stderr
    pressure = run.fields("column", 0)["pore_pressure"]
    assert np.abs(pressure / column.initial_pressure - 1.0).max() <= 1e-6
    cell = re.sub(r"box_max = [\d., ]+", "box_max = 0.025, 0.025\n  ", column.text())
    run = dosui(re.sub(r"spacing = 0\.05\b", "spacing = 0.025", cell), folder="cell")
    assert run.status == 0, run.stderr
    pressure = run.fields("column", 0)["pore_pressure"]
    assert np.abs(pressure / column.initial_pressure - 1.0).max() <= 1e-6


@pytest.mark.parametrize("per_cell", [1, 2])
def test_checkerboard_decays(dosui: Runner, per_cell: int) -> None:
    """A seeded +1, -1 head is gone after 10 dx2/c_v; the literal operator keeps it."""
    amplitudes = {}
    for water in ("", "operator = 'two_pass'"):
        column = Column(per_cell=per_cell, pattern="checkerboard", water=water)
        text = re.sub(r"output_times = [^\n]*", "", column.text())
        end = 10.0 * column.spacing**2 / column.c_v
        text = re.sub(r"end_time = \S+", f"end_time = {end!r}", text)
        transfer = "transfer = 'flip'" if water else ""
        text = text.replace("&mechanics ", f"&mechanics {transfer} ")
        run = dosui(text, folder=f"checkerboard{len(amplitudes)}")
        assert run.status == 0, run.stderr
        data = run.fields("column")
        index = np.rint(data["points"][:, [0, 2]] / column.spacing - 0.5).astype(int)
        inner = (index.min(axis=1) >= 4) | (index[:, 1] >= 4)
        inner &= (index[:, 0] >= 3) & (index[:, 0] <= 6) & (index[:, 1] <= 35)
        sign = np.where(index.sum(axis=1) % 2 == 0, 1.0, -1.0)
        amplitudes[water] = abs(np.mean(sign[inner] * data["pore_pressure"][inner])) / column.load
    assert amplitudes[""] <= 1e-3
    assert amplitudes["operator = 'two_pass'"] >= 0.05, amplitudes


def test_mirrored_column(dosui: Runner) -> None:
    """A polygon and its mirror image have mirrored answers."""
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.25, 1.0], [0.05, 1.0]])
    fields = []
    for sign in (1.0, -1.0):
        outline = corners * [sign, 1.0]
        if sign < 0:
            outline = np.roll(outline[::-1], 1, axis=0)[[2, 3, 0, 1]]
        vertices = ", ".join(repr(float(value)) for value in outline.ravel())
        text = Column(last=0.05).text()
        text = re.sub(
            r"box_min = [^\n]*", f"shape = 'polygon' vertices = {vertices}", text, count=1
        )
        lower = int(np.argmin(np.abs(outline - np.roll(outline, -1, 0))[:, 1] + outline[:, 1]))
        names = ["base", "right", "top", "left"] if sign > 0 else ["base", "left", "top", "right"]
        for k, name in enumerate(names):
            face = {"base": "z-", "top": "z+", "left": "x-", "right": "x+"}[name]
            edge = (lower + k) % 4 + 1
            text = text.replace(
                f"name = '{name}' region = 'column' face = '{face}'",
                f"name = '{name}' region = 'column' face = 'edge{edge}'",
            )
        run = dosui(text, folder=f"mirror{sign}")
        assert run.status == 0, run.stderr
        data = run.fields("column")
        order = np.lexsort(
            (np.round(sign * data["points"][:, 0], 6), np.round(data["points"][:, 2], 6))
        )
        fields.append(data["pore_pressure"][order])
    assert np.abs(fields[0] - fields[1]).max() <= 1e-9 * np.abs(fields[0]).max()


def test_load_adds_up_on_any_ranks(dosui: Runner) -> None:
    """Gravity-free undrained equilibrium: the mean total stress is the load, turned or not."""
    column = Column(
        spacing=0.05, per_cell=2, angle=30.0, last=0.05, time="maximum_steps = 1", jitter=0.2
    )
    for ranks in (1, 3):
        run = dosui(column.text(), ranks=ranks, folder=f"ranks{ranks}")
        assert run.status == 0, run.stderr
        data = run.fields("column", 0)
        angle = np.radians(30.0)
        along = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        xx, _, zz, _, _, zx = (data["effective_stress"] * data["volume"][:, None]).sum(axis=0)
        total = xx * along[0] ** 2 + zz * along[2] ** 2 + 2.0 * zx * along[0] * along[2]
        total -= (data["pore_pressure"] * data["volume"]).sum()
        assert total / data["volume"].sum() == pytest.approx(-1000.0, rel=0.02)

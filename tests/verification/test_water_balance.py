"""Stored = inflow + squeezed, with every term measured by itself."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from columns import WIDTH, Column
from conftest import Run, Runner

BASE = Column(per_cell=2, last=0.2)


def outflow(column: Column, time: float) -> float:
    """Water that Terzaghi's column gives off through its top [m3 per m of thickness]."""
    mu = 0.5 * np.pi * (2 * np.arange(400) + 1)
    left = np.sum(2.0 / mu**2 * np.exp(-(mu**2) * column.c_v * time))
    return float(WIDTH * column.initial_pressure * (column.storage + column.softness) * (1 - left))


def balance(run: Run) -> dict[str, np.ndarray]:
    """The water's columns of the history."""
    assert run.status == 0, run.stderr
    names = ("time", "water_stored", "water_inflow", "water_squeezed", "water_balance_error")
    return {name: run.history("column", name) for name in (*names, "inflow_top")}


@pytest.mark.parametrize(
    ("change", "missing", "error"),
    [
        ({}, 1e-3, 1e-2),
        ({"jitter": 0.25}, 2e-2, 2e-2),
        ({"rigid": True}, 1e-3, 1e-2),
        ({"rigid": True, "angle": 30.0, "jitter": 0.2}, 2e-2, 2e-2),
        ({"water": "stepping = 'rkl2'"}, 1e-3, 1e-2),
        ({"integrator": "quasi_static"}, 1e-3, 1e-2),
        ({"integrator": "quasi_static", "bulk_modulus": 2.2e9}, 1e-3, 1e-2),
        ({"integrator": "semi_implicit"}, 1e-3, 1e-2),
    ],
)
def test_outflow_of_a_column(
    dosui: Runner, change: dict[str, object], missing: float, error: float
) -> None:
    """What leaves through the top is Terzaghi's, and what the balance misses is little."""
    column = replace(BASE, **change)
    run = dosui(column.text())
    water = balance(run)
    assert water["water_balance_error"][-1] <= missing
    assert np.array_equal(water["water_inflow"], water["inflow_top"])
    expected = outflow(column, water["time"][-1])
    assert abs(-water["inflow_top"][-1] - expected) <= error * expected
    said = re.search(r"missing ([-\d.e+]+) %", run.stdout)
    assert said and abs(float(said.group(1)) / 100 - water["water_balance_error"][-1]) <= 1e-3


@pytest.mark.parametrize("integrator", ["explicit", "quasi_static"])
def test_ranks_and_restart(dosui: Runner, integrator: str) -> None:
    """The balance does not depend on the ranks, and goes on after a restart."""
    column = replace(BASE, jitter=0.2, integrator=integrator, last=0.1)
    one = balance(dosui(column.text(), folder="one"))
    three = balance(dosui(column.text(), ranks=3, folder="three"))
    text = column.text().replace("&output", "&output checkpoint_steps = 10 ")
    part = dosui(text.replace("&time", "&time maximum_steps = 30 "), folder="part")
    again = balance(dosui(text, "--restart", str(part.folder / "column.restart.h5"), folder="part"))
    for name, values in one.items():
        scale = np.abs(values).max()
        assert abs(three[name][-1] - values[-1]) <= 1e-9 * scale
        assert abs(again[name][-1] - values[-1]) <= 1e-9 * scale


def test_prescribed_flux_and_sources(dosui: Runner) -> None:
    """A flux and a source are booked exactly: 2 mm/s out of the base for 0.5 s."""
    column = replace(BASE, rigid=True, integrator="quasi_static")
    text = column.text() + (
        "&hydraulic_condition surface = 'base' kind = 'flux' value = 2e-3 "
        "factor_times = 0.0, 0.5 factor_values = 0.0, 1.0 /\n"
        "&source water = '1e-3*t' /\n"
    )
    text = re.sub(r"end_time = .*", "end_time = 0.5", text, count=1)
    run = dosui(text)
    assert run.status == 0, run.stderr
    assert run.history("column", "inflow_base")[-1] == pytest.approx(-2e-3 * 0.25 * WIDTH, rel=1e-9)
    assert run.history("column", "inflow_sources")[-1] == pytest.approx(
        1e-3 * 0.125 * WIDTH, rel=1e-9
    )
    assert run.history("column", "water_balance_error")[-1] <= 1e-2

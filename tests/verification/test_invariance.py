"""The same answer on any number of ranks, after a restart, in other units, mirrored."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import Run, Runner, scene_text

NO_OUTPUT_TIMES = "output_times = 4.905, 9.81, 19.62, 49.05"


def short_terzaghi(**changes: str) -> str:
    """A coarse, short form of the 2-D scene with four particles a cell."""
    text = scene_text("terzaghi/scene_2d.nml", spacing="0.125", end_time="0.15", **changes)
    return text.replace(NO_OUTPUT_TIMES, "output_interval = 0.025").replace(
        "particles_per_cell = 1", "particles_per_cell = 2\n  jitter = 0.2"
    )


def largest_difference(a: Run, b: Run, name: str) -> float:
    """Largest difference of any field, relative to the field's largest value."""
    one, two = a.fields(name), b.fields(name)
    assert one.keys() == two.keys()
    worst = 0.0
    for key in one.keys() - {"rank"}:
        scale = max(np.abs(one[key]).max(), 1e-300)
        difference = np.abs(one[key].astype(float) - two[key].astype(float)).max() / scale
        assert difference == difference, key
        worst = max(worst, difference)
    return worst


def in_mode(mode: str) -> str:
    """The short scene in small-strain or updated mode."""
    text = short_terzaghi().replace("dimension = 2", f"dimension = 2\n  deformation = '{mode}'")
    if mode == "updated":
        text = text.replace("spacing = 0.125", "spacing = 0.125\n  shape_function = 'gimp'")
    return text


@pytest.mark.parametrize("ranks", [2, 3, 4, 7])
@pytest.mark.parametrize("mode", ["small_strain", "updated"])
def test_ranks(dosui: Runner, ranks: int, mode: str) -> None:
    """All fields agree to 1e-11 on any number of ranks."""
    serial = dosui(in_mode(mode), folder="serial")
    parallel = dosui(in_mode(mode), ranks=ranks, folder="parallel")
    assert serial.status == 0, serial.stderr
    assert parallel.status == 0, parallel.stderr
    assert largest_difference(serial, parallel, "terzaghi_2d") <= 1e-11


@pytest.mark.parametrize("mode", ["small_strain", "updated"])
def test_repeat_is_bit_identical(dosui: Runner, mode: str) -> None:
    """The same scene on the same ranks."""
    text = in_mode(mode)
    runs = [dosui(text, ranks=2, folder=f"run{k}") for k in range(2)]
    assert largest_difference(runs[0], runs[1], "terzaghi_2d") == 0.0


@pytest.mark.parametrize("mode", ["small_strain", "updated"])
@pytest.mark.parametrize("ranks", [1, 2])
def test_restart(dosui: Runner, mode: str, ranks: int) -> None:
    """A restart continues bit by bit on the same ranks, to 1e-11 on others."""
    text = in_mode(mode)
    straight = dosui(text, ranks=ranks, folder="straight")
    part = re.sub(r"end_time = [\d.]+", "end_time = 0.15\n  maximum_steps = 100", text)
    part = part.replace("&output", "&output\n  checkpoint_steps = 60")
    first = dosui(part, ranks=ranks, folder="part")
    assert straight.status == 0 and first.status == 0, first.stderr
    checkpoint = str(first.folder / "terzaghi_2d.restart.h5")
    same = dosui(text, "--restart", checkpoint, ranks=ranks, folder="part")
    assert same.status == 0, same.stderr
    assert largest_difference(straight, same, "terzaghi_2d") == 0.0
    other = dosui(text, "--restart", checkpoint, ranks=3, folder="other")
    assert other.status == 0, other.stderr
    assert largest_difference(straight, other, "terzaghi_2d") <= 1e-11


def test_units(dosui: Runner) -> None:
    """Millimetres and grams give the answer of metres and kilograms."""
    metres = dosui(short_terzaghi(), folder="metres")
    text = short_terzaghi()
    for old, new in {
        "spacing = 0.125": "spacing = 125.0",
        "box_max = 0.25, 1.0": "box_max = 250.0, 1000.0",
        "hydraulic_conductivity = 1.0e-4": "hydraulic_conductivity = 0.1\n"
        "  solid_density = 2.65e-3",
        "bulk_modulus = 3.0e6": "bulk_modulus = 3.0e6\n  density = 1.0e-3\n  unit_weight = 9.81",
        "position = 0.125, 0.0": "position = 125.0, 0.0",
    }.items():
        assert old in text
        text = text.replace(old, new)
    millimetres = dosui(text, folder="millimetres")  # g / (mm s2) = Pa
    assert millimetres.status == 0, millimetres.stderr
    a, b = metres.fields("terzaghi_2d"), millimetres.fields("terzaghi_2d")
    for key, factor in {
        "pore_pressure": 1.0,
        "displacement": 1e-3,
        "effective_stress": 1.0,
    }.items():
        assert np.abs(a[key] - factor * b[key]).max() <= 1e-9 * np.abs(a[key]).max(), key

"""Forces of walls in the histories, against statics, and their balance in every integrator."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from conftest import Run, Runner, scene_text

GRAVITY = 9.81
DENSITY = 0.7 * 2650.0 + 0.3 * 1000.0  # of the saturated soil


def column(integrator: str = "quasi_static", end: float = 1.0e5, load: str = "") -> str:
    """A saturated column on a fixed base between rollers, 0.5 m wide and 1 m high."""
    load = load or "kind = 'pressure' value = 1.0e4"
    return f"""
&scene dimension = 2 integrator = '{integrator}' gravity = 0.0, {-GRAVITY} /
&grid spacing = 0.125 /
&time end_time = {end} /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.3 hydraulic_conductivity = 1e-6 /
&region name = 'soil' material = 'soil' box_min = 0.0, 0.0 box_max = 0.5, 1.0 /
&surface name = 'left' region = 'soil' face = 'x-' /
&surface name = 'right' region = 'soil' face = 'x+' /
&surface name = 'base' region = 'soil' face = 'z-' /
&surface name = 'top' region = 'soil' face = 'z+' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' {load} /
&hydraulic_condition surface = 'top' kind = 'head' value = 1.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 1.0
  effective_stress = 'geostatic' surface_level = 1.0 lateral_ratio = 0.5 /
&output name = 'column' /
"""


WEIGHT = 0.5 * DENSITY * GRAVITY
LOAD = 0.5 * 1.0e4


def columns(run: Run, name: str, *wanted: str) -> list[np.ndarray]:
    """Histories of a run that has ended well."""
    assert run.status == 0, run.stderr + run.stdout
    return [run.history(name, column) for column in wanted]


def test_reactions_of_a_column(dosui: Runner) -> None:
    """Base: load and weight, at all times. Sides: the undrained, then the drained stress."""
    run = dosui(column())
    time, base, left, right, turn = columns(
        run,
        "column",
        "time",
        "reaction_base_z",
        "reaction_left_x",
        "reaction_right_x",
        "moment_left_y",
    )
    assert np.abs(base - WEIGHT - LOAD).max() <= 1e-10 * WEIGHT
    assert np.abs(left + right).max() <= 1e-5 * left[0]
    # at rest: K_0 times the effective stress, and the water; then q and, drained, K q
    ratio, k0 = 0.3 / 0.7, 0.5
    modulus = 1.0e7 * 0.7 / (1.3 * 0.4)
    buoyant = DENSITY * GRAVITY - 9810.0
    rest = 0.5 * (k0 * buoyant + 9810.0)
    share = (2.2e9 / 0.3) / (modulus + 2.2e9 / 0.3)  # of the load that the water takes at once
    first = rest + 1.0e4 * (share + ratio * (1.0 - share))
    assert time[0] == 0.0
    assert left[0] == pytest.approx(first, rel=1e-9)
    # drained; the corner's half cell below belongs to the roller, too
    assert left[-1] == pytest.approx(rest + 1.0e4 * ratio, rel=1e-6)
    # about the side's centre: the stress of the soil at rest grows by 2 rest per metre
    assert turn[-1] == pytest.approx(-rest / 6.0, rel=2e-2)  # the lowest cell's step is h^2
    step = run.history("column", "step")
    assert np.array_equal(step, np.arange(len(step)))  # every step has its row
    assert re.search(r"forces on the bodies at t = 100000 s: .*missing 0 of all", run.stdout)


@pytest.mark.parametrize("integrator", ["explicit", "semi_implicit", "quasi_static", "finite"])
@pytest.mark.parametrize("where", ["nodes", "penalty", "plate", "driven"])
def test_balance(dosui: Runner, integrator: str, where: str) -> None:
    """Loads, weight and walls make the change of momentum, to round-off, in every row."""
    end = {"explicit": 1.0e-3, "semi_implicit": 1.0e-2, "finite": 0.1}.get(integrator, 100.0)
    load = {"plate": "kind = 'plate' value = 5.0e3", "driven": "kind = 'velocity' value = 0, -1e-5"}
    text = column(integrator.replace("finite", "quasi_static"), end, load.get(where, ""))
    if integrator == "finite":
        text = text.replace("&scene", "&scene deformation = 'finite'")
    if where == "penalty":
        if integrator == "finite":
            pytest.skip("finite strains have no penalty walls")
        text = text.replace("0.0, 0.0 box_max = 0.5, 1.0", "0.03, 0.05 box_max = 0.53, 1.05")
    run = dosui(text + "&source force_x = '50.0' /\n")
    error, base, mass = columns(run, "column", "force_balance_error", "reaction_base_z", "mass")
    assert np.all(error <= 1e-11)
    assert mass[0] == pytest.approx(0.5 * DENSITY)
    sides = sum(columns(run, "column", *(f"reaction_{s}_x" for s in ("left", "right", "base"))))
    above = np.full(len(base), -LOAD)
    if where in load:
        above = run.history("column", "reaction_top_z")
        sides = sides + run.history("column", "reaction_top_x")
    if where == "plate":
        assert np.abs(above + 5.0e3).max() <= 1e-8 * 5.0e3
    if integrator in ("quasi_static", "finite"):  # finite: water leaves with its weight
        tolerance = 1e-3 if integrator == "finite" else 1e-8
        assert np.abs(base + above - WEIGHT).max() <= tolerance * WEIGHT
        assert np.abs(sides + 25.0).max() <= tolerance * 25.0


@pytest.mark.parametrize("transfer", ["flip", "pic", "blend"])
def test_balance_of_transfers(dosui: Runner, transfer: str) -> None:
    """What a wall takes depends on how particles get their velocities; damping counts."""
    text = column("explicit", 1.0e-3)
    text += f"&mechanics transfer = '{transfer}' damping = 'local' /\n"
    text += "&base_motion acceleration = 1.0, 0.5 /\n"
    run = dosui(text)
    (error,) = columns(run, "column", "force_balance_error")
    assert np.all(error <= 1e-11)
    assert "shaking (-" in run.stdout and "damping (" in run.stdout


def test_absorbing_surface(dosui: Runner) -> None:
    """A surface that lets waves out: its force is a reaction."""
    text = column("explicit", 2.0e-3).replace("'base' kind = 'fixed'", "'base' kind = 'absorbing'")
    error, base, speed = columns(
        dosui(text), "column", "force_balance_error", "reaction_base_z", "kinetic_energy"
    )
    assert np.all(error <= 1e-11)
    assert speed[-1] > 0.0 and abs(base[-1]) > 0.1 * WEIGHT


def test_moments(dosui: Runner) -> None:
    """An eccentric, inclined load on a block in space that stands on its base."""
    text = f"""
&scene dimension = 3 integrator = 'quasi_static' water = 'none' gravity = 0.0, 0.0, {-GRAVITY} /
&grid spacing = 0.25 /
&time end_time = 1.0 /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.3 /
&region name = 'block' material = 'soil' box_min = 1.0, 2.0, 3.0 box_max = 2.0, 2.5, 4.0 /
&surface name = 'base' region = 'block' face = 'z-' /
&surface name = 'top' region = 'block' face = 'z+' box_max = 1.5, 9.0, 9.0 /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' kind = 'traction' value = 0.0, 100.0, -1000.0 /
&output name = 'block' /
"""
    run = dosui(text)
    force = np.array([c[-1] for c in columns(run, "block", *(f"reaction_base_{a}" for a in "xyz"))])
    moment = np.array([c[-1] for c in columns(run, "block", *(f"moment_base_{a}" for a in "xyz"))])
    weight = np.array([0.0, 0.0, -0.5 * 0.7 * 2650.0 * GRAVITY])
    load = 0.25 * np.array([0.0, 100.0, -1000.0])
    arm = np.array([-0.25, 0.0, 1.0])  # from the centre of the base
    assert np.abs(force + load + weight).max() <= 1e-9 * abs(weight[2])
    assert np.abs(moment + np.cross(arm, load)).max() <= 1e-9 * abs(weight[2])


def test_mandel(dosui: Runner) -> None:
    """The plate's reaction is its load at all times, the base carries it, both about the middle."""
    text = scene_text("mandel/nu_0.2.nml", spacing="0.02")
    text = text.replace("'explicit'", "'quasi_static'")
    run = dosui(text)
    plate, base, turn, middle = columns(
        run,
        "mandel_nu_0.2",
        "reaction_top_z",
        "reaction_bottom_z",
        "moment_top_y",
        "reaction_middle_x",
    )
    assert len(plate) > 20
    assert np.abs(plate + 200.0).max() <= 1e-9 * 200.0
    assert np.abs(base - 200.0).max() <= 1e-9 * 200.0
    assert np.abs(middle).max() <= 1e-9 * 200.0  # the side is free
    # undrained the stress is even; it then leaves the drained side: r_z F_x - r_x F_z > 0 for x < 0
    assert abs(turn[0]) <= 1e-2 * 200.0 * 0.2
    assert turn.min() < -0.01 * 200.0 * 0.2
    assert "missing 0 of all" in run.stdout


def test_friction_on_a_wall(dosui: Runner) -> None:
    """A block slides down: normal force W cos b in the mean, friction mu times it at any time."""
    angle, friction = math.radians(30.0), 0.2
    text = f"""
&scene dimension = 2 water = 'none' deformation = 'updated'
  gravity = {GRAVITY * math.sin(angle)!r}, {-GRAVITY * math.cos(angle)!r} /
&grid spacing = 0.15 shape_function = 'gimp' /
&time end_time = 0.3 /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.3 /
&region name = 'block' material = 'soil' box_min = 0.0, 0.0 box_max = 0.6, 0.3 /
&rigid_wall name = 'floor' position = 0.0, 0.0 normal = 0.0, 2.0 friction = {friction} /
&rigid_wall name = 'far' position = 0.0, -1.0 normal = 0.0, 1.0 /
&output name = 'block' history_interval = 1.0e-4 /
"""
    time, normal, tangent, far, error, mass = columns(
        dosui(text),
        "block",
        "time",
        "reaction_floor_z",
        "reaction_floor_x",
        "reaction_far_z",
        "force_balance_error",
        "mass",
    )
    assert np.all(error <= 1e-11)
    assert np.all(np.abs(tangent) <= friction * normal * (1.0 + 1e-9) + 1e-9 * normal.max())
    slides = time > 0.1  # at first edges bulge against the slope
    assert np.abs(tangent + friction * normal)[slides].max() <= 1e-9 * normal.max()
    step = np.diff(time)
    mean = (normal[1:] * step).sum() / step.sum()
    assert mean == pytest.approx(mass[0] * GRAVITY * math.cos(angle), rel=2e-2)
    assert not far.any()


@pytest.mark.parametrize("integrator", ["explicit", "semi_implicit", "quasi_static"])
def test_ranks_and_restart(dosui: Runner, integrator: str) -> None:
    """The same on two ranks; bit for bit after a restart."""
    end = {"explicit": 4.0e-4, "semi_implicit": 0.01}.get(integrator, 0.1)
    text = column(integrator, end)
    names = [f"reaction_{s}_{a}" for s in ("base", "left") for a in "xz"] + ["moment_base_y"]
    one = columns(dosui(text, folder="one"), "column", "time", *names)
    two = columns(dosui(text, folder="two", ranks=2), "column", "time", *names)
    for a, b in zip(one, two, strict=True):
        assert a.shape == b.shape
        assert np.abs(a - b).max() <= 1e-11 * max(np.abs(one[2]).max(), end)
    half = text.replace("&output", "&output checkpoint_steps = 7")
    half_way = half.replace("end_time", "maximum_steps = 10 end_time")
    checkpoint = next(dosui(half_way, folder="parts").folder.glob("*.restart.h5"))
    run = dosui(half, "--restart", str(checkpoint), folder="parts")
    parts = columns(run, "column", "time", *names)
    for a, b in zip(one, parts, strict=True):
        assert np.array_equal(a, b)


def test_rows_of_implicit_runs(dosui: Runner) -> None:
    """Every step of a long run has its row, and the file grows with them; an interval thins them;
    explicit runs show their first steps."""
    text = column("quasi_static", 1300.0).replace("&time", "&time time_step = 1.0")
    text = text.replace("spacing = 0.125", "spacing = 0.25")
    time, base = columns(dosui(text), "column", "time", "reaction_base_z")
    assert np.allclose(time, np.arange(1301.0), rtol=0.0, atol=1e-6)
    assert np.abs(base - WEIGHT - LOAD).max() <= 1e-9 * WEIGHT
    text = text.replace("&output", "&output history_interval = 100.0")
    time, base = columns(dosui(text, folder="thin"), "column", "time", "reaction_base_z")
    assert np.allclose(time, np.arange(0.0, 1301.0, 100.0), rtol=0.0, atol=1e-6)
    assert np.abs(base - WEIGHT - LOAD).max() <= 1e-9 * WEIGHT
    text = column("explicit", 0.2).replace("spacing = 0.125", "spacing = 0.25")
    step = dosui(text, folder="explicit").history("column", "step")
    assert np.array_equal(step[:9], np.arange(9.0))
    assert 1000 <= len(step) <= 1200

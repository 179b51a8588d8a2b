"""Bodies that meet rigid walls: friction, leaving, and a column that collapses."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from conftest import ROOT, Runner

GRAVITY, ANGLE, END = 9.81, math.radians(30.0), 0.5


def block(wall: str, shape: str = "gimp", motion: str = "", turn: bool = True) -> str:
    """An elastic block on a floor, gravity inclined."""
    gx = GRAVITY * math.sin(ANGLE) if turn else 0.0
    gz = -GRAVITY * math.cos(ANGLE) if turn else 0.0
    return f"""
&scene dimension = 2 water = 'none' deformation = 'updated' gravity = {gx!r}, {gz!r} /
&grid spacing = 0.1 shape_function = '{shape}' /
&time end_time = {END} /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.3 /
&region name = 'block' material = 'soil' box_min = 0.0, 0.0 box_max = 0.6, 0.3 {motion} /
&rigid_wall name = 'floor' position = 0.0, 0.0 normal = 0.0, 2.0 {wall} /
&output name = 'block' /
"""


@pytest.mark.parametrize("shape", ["gimp", "bspline"])
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4])
def test_sliding(dosui: Runner, friction: float, shape: str) -> None:
    """Down an incline with g (sin b - mu cos b): to round-off, once it slides everywhere, if the
    normal force is taken with what shakes the block (it falls onto the floor at t = 0)."""
    text = block(f"friction = {friction}", shape)
    run = dosui(text.replace("/\n&material", f"output_interval = {END / 2} /\n&material"))
    assert run.status == 0, run.stderr
    gain = run.fields("block")["velocity"].mean(axis=0)
    gain -= run.fields("block", step=1)["velocity"].mean(axis=0)
    exact = GRAVITY * (math.sin(ANGLE) - friction * math.cos(ANGLE))
    assert (gain[0] + friction * gain[2]) / (END / 2) == pytest.approx(exact, rel=1e-12)


def test_rough_wall_holds(dosui: Runner) -> None:
    """What sticks does not slide: it only shakes."""
    run = dosui(block("kind = 'rough'"))
    assert run.status == 0, run.stderr
    assert np.abs(run.fields("block")["displacement"]).max() <= 2e-3


def test_leaving_is_free(dosui: Runner) -> None:
    """A block that is thrown off the wall keeps its momentum to round-off."""
    run = dosui(block("friction = 0.5", motion="velocity = 0.2, 1.0", turn=False))
    assert run.status == 0, run.stderr
    velocity = run.fields("block")["velocity"]
    assert np.abs(velocity[:, 0] - 0.2).max() <= 1e-12
    assert np.abs(velocity[:, 2] - 1.0).max() <= 1e-12


def test_ranks(dosui: Runner) -> None:
    """The same on three ranks."""
    one = dosui(block("friction = 0.2"), folder="one").fields("block")
    three = dosui(block("friction = 0.2"), ranks=3, folder="three").fields("block")
    for name in ("displacement", "velocity", "effective_stress"):
        assert np.abs(one[name] - three[name]).max() <= 1e-11 * np.abs(one[name]).max()


def edge(points: np.ndarray, volume: float) -> float:
    """Where a deposit becomes thinner than one and a half layers of particles (0.05 of the first
    width at the shipped spacing), over that width, beyond it; each particle has this volume [m3]"""
    width = 0.0125
    thickness = np.bincount((points[:, 0] / width).astype(int)) * volume / width
    thin = np.append(thickness, 0.0) < 0.05 * 0.2
    last = int(np.argmax(thin)) - 1
    share = (thickness[last] - 0.01) / (thickness[last] - np.append(thickness, 0.0)[last + 1])
    return float((last + 0.5 + share) * width / 0.2 - 1.0)


# aspect ratio, run-out of Lube et al. (2005), spacing, end, band
COLLAPSES = [
    (0.5, 0.6, 0.00625, 0.6, 0.25),
    (1.0, 1.2, 0.0125, 0.7, 0.15),
    (2.0, 2.4, 0.0125, 0.9, 0.15),
    (4.0, 1.9 * 4.0 ** (2 / 3), 0.2 / 12, 1.2, 0.15),
]


@pytest.mark.parametrize(("aspect", "runout", "spacing", "end", "band"), COLLAPSES)
def test_column_collapse(
    dosui: Runner, aspect: float, runout: float, spacing: float, end: float, band: float
) -> None:
    """Run-out against Lube et al. (2005); in the end at rest on the floor, with the first volume:
    what opened has closed."""
    text = (ROOT / "input/column_collapse/scene.nml").read_text()
    for old, new in (
        ("box_max = 0.2, 0.2", f"box_max = 0.2, {0.2 * aspect}"),
        ("surface_level = 0.2", f"surface_level = {0.2 * aspect}"),
        ("spacing = 0.0125", f"spacing = {spacing!r}"),
        ("end_time = 1.2", f"end_time = {end}"),
    ):
        assert old in text
        text = text.replace(old, new)
    run = dosui(text)
    assert run.status == 0, run.stderr
    fields = run.fields("column_collapse")
    assert abs(edge(fields["points"], (0.5 * spacing) ** 2) / runout - 1) <= band
    assert fields["points"][:, 2].min() > 0.0 and fields["points"][:, 0].min() > 0.0
    assert np.abs(fields["velocity"]).max() <= 0.05
    assert abs(fields["volume"].mean() / (0.5 * spacing) ** 2 - 1.0) <= 0.015
    assert fields["opened_volume"].max() > 0.0
    mass = run.history("column_collapse", "mass")
    assert np.ptp(mass) <= 1e-12 * mass[0]


def wet(integrator: str, wall: str, motion: str = "", turn: bool = True, end: float = 1.0) -> str:
    """The block, saturated and closed."""
    text = block(wall, motion=motion, turn=turn)
    text = text.replace("name = 'block' /\n", "name = 'block' history_interval = 0.005 /\n")
    text = text.replace("&scene", f"&scene integrator = '{integrator}'")
    text = text.replace("water = 'none'", "").replace(f"end_time = {END}", f"end_time = {end}")
    text = text.replace("ratio = 0.3", "ratio = 0.3 porosity = 0.4 hydraulic_conductivity = 1.0e-3")
    return text + "&water bulk_modulus = 3.0e7 /\n"


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4])
def test_saturated_block_slides(dosui: Runner, friction: float) -> None:
    """Semi-implicit steps: down an incline with g (sin b - mu cos b), as explicit ones. It rings on
    the floor, so the mean acceleration counts; friction is mu times the normal force altogether,
    but for the first travels of its shear waves, when its base still sticks."""
    run = dosui(wet("semi_implicit", f"friction = {friction}"))
    assert run.status == 0, run.stderr
    time, mass = run.history("block", "time"), run.history("block", "mass")[0]
    speed = run.history("block", "momentum_x") / mass
    exact = GRAVITY * (math.sin(ANGLE) - friction * math.cos(ANGLE))
    assert np.polyfit(time, speed, 1)[0] == pytest.approx(exact, rel=5e-3)
    walls = [run.history("block", f"impulse_walls_{axis}")[-1] for axis in "xz"]
    assert walls[0] == pytest.approx(-friction * walls[1], rel=5e-3, abs=1e-9 * walls[1])


def test_saturated_block_rests(dosui: Runner) -> None:
    """Both integrators: the same settlement and pressures on a smooth floor (friction would keep
    what the first waves left); a rough floor holds a slope."""
    runs = {}
    for integrator in ("explicit", "semi_implicit"):
        text = wet(integrator, "friction = 0.0", turn=False)
        text += "&mechanics damping = 'viscous' damping_coefficient = 60.0 /\n"
        text = re.sub(r"gravity = \S+, \S+ /", f"gravity = 0.0, {-GRAVITY} /", text)
        runs[integrator] = dosui(text, folder=integrator).fields("block")
    for name, limit in (("displacement", 5e-3), ("pore_pressure", 5e-3)):
        one, two = (runs[k][name] for k in ("explicit", "semi_implicit"))
        assert np.abs(one - two).max() <= limit * np.abs(one).max()
    assert np.abs(runs["semi_implicit"]["velocity"]).max() <= 1e-3
    run = dosui(wet("semi_implicit", "kind = 'rough'", end=0.5), folder="rough")
    assert run.status == 0, run.stderr
    assert np.abs(run.fields("block")["displacement"]).max() <= 2e-3


def test_saturated_block_leaves(dosui: Runner) -> None:
    """Semi-implicit steps: thrown off the wall it keeps its momentum; two ranks agree with one."""
    text = wet("semi_implicit", "friction = 0.5", motion="velocity = 0.2, 1.0", turn=False)
    velocity = dosui(text).fields("block")["velocity"]
    assert np.abs(velocity[:, 0] - 0.2).max() <= 1e-12
    assert np.abs(velocity[:, 2] - 1.0).max() <= 1e-12
    text = wet("semi_implicit", "friction = 0.2", end=0.2)
    one = dosui(text, folder="one").fields("block")
    two = dosui(text, folder="two", ranks=2).fields("block")
    for name in ("displacement", "velocity", "effective_stress", "pore_pressure"):
        assert np.abs(one[name] - two[name]).max() <= 1e-11 * np.abs(one[name]).max()


@pytest.mark.parametrize("integrator", ["explicit", "semi_implicit"])
@pytest.mark.parametrize("wall", ["friction = 0.2", "kind = 'rough'"])
def test_impulses_of_walls(dosui: Runner, integrator: str, wall: str) -> None:
    """Gravity and walls give all the momentum that a saturated block has."""
    run = dosui(wet(integrator, wall, end=0.1))
    assert run.status == 0, run.stderr
    time, mass = run.history("block", "time"), run.history("block", "mass")[0]
    for axis, slope in (("x", math.sin(ANGLE)), ("z", -math.cos(ANGLE))):
        momentum, walls, lost = (
            run.history("block", f"{kind}_{axis}")
            for kind in ("momentum", "impulse_walls", "impulse_lost")
        )
        weight = mass * GRAVITY * time
        assert np.abs(momentum - weight * slope - walls - lost).max() <= 1e-12 * weight[-1]
        assert abs(walls[-1]) > 0.1 * weight[-1]
    bare = re.sub(r"&rigid_wall[^/]*/", "", wet(integrator, wall, end=0.01))
    with pytest.raises(KeyError):  # nobody pays for walls without any
        dosui(bare, folder="bare").history("block", "momentum_x")


def test_refusals(dosui: Runner) -> None:
    """Implicit steps and walls without a direction are refused with the line of the group."""
    text = block("friction = 0.2")
    assert dosui(text, "--check").status == 0
    wrong = text.replace("'updated'", "'small_strain' integrator = 'quasi_static'")
    run = dosui(wrong, "--check")
    assert run.status == 2 and "rigid_wall" in run.stderr
    run = dosui(
        wet("semi_implicit", "").replace("normal = 0.0, 2.0", "normal = 1.0, 2.0"), "--check"
    )
    assert run.status == 2 and "axis" in run.stderr
    run = dosui(text.replace("normal = 0.0, 2.0", "normal = 0.0, 0.0"), "--check")
    assert run.status == 2 and "normal" in run.stderr
    run = dosui(text.replace("friction = 0.2", "friction = -0.2"), "--check")
    assert run.status == 2 and "friction" in run.stderr

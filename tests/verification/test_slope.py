"""Endless layers: periodic sides, parallel seepage, the safety factor."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from conftest import ROOT, Run, Runner, scene_text

GRAVITY, DENSITY, WATER = 9.81, 0.7 * 2650.0 + 0.3 * 1000.0, 1000.0


def slope(
    angle: float, cohesion: float, friction: float, spacing: float = 0.25, height: float = 5.0
) -> str:
    """The shipped scene with other constants."""
    inclination = math.radians(angle)
    down, into = GRAVITY * math.sin(inclination), GRAVITY * math.cos(inclination)
    text = (ROOT / "input/infinite_slope/scene.nml").read_text()
    text = re.sub(r"gravity = .*", f"gravity = {down!r}, {-into!r}", text)
    text = text.replace("spacing = 0.25", f"spacing = {spacing}")
    text = re.sub(r"cohesion = .*", f"cohesion = {cohesion!r}", text)
    text = re.sub(r"(friction|dilation)_angle = .*", rf"\1_angle = {friction!r}", text)
    text = text.replace("box_max = 1.0, 5.0", f"box_max = 1.0, {height}")
    text = text.replace("water_level = 5.0", f"water_level = {height}")
    text = text.replace("value = 9218.3847501", f"value = {WATER * into!r}")
    return text.replace("'5 - z'", f"'{height} - z'")


def safety(angle: float, cohesion: float, friction: float, height: float = 5.0) -> float:
    """Strength over shear stress on the rock."""
    inclination = math.radians(angle)
    normal = (DENSITY - WATER) * GRAVITY * height * math.cos(inclination)
    shear = DENSITY * GRAVITY * height * math.sin(inclination)
    return (cohesion + normal * math.tan(math.radians(friction))) / shear


def bracket(run: Run) -> tuple[float, float]:
    """What --safety prints at its end."""
    assert run.status == 0, run.stderr
    found = re.search(r"safety factor between (\S+) and (\S+)", run.stdout)
    assert found, run.stdout
    return float(found[1]), float(found[2])


@pytest.mark.parametrize(
    ("angle", "cohesion", "friction", "ranks"), [(20.0, 5.0e3, 32.0, 2), (35.0, 1.5e4, 25.0, 1)]
)
def test_safety_factor(
    dosui: Runner, angle: float, cohesion: float, friction: float, ranks: int
) -> None:
    """Failure between 0.97 and 1.03 of the exact strength."""
    run = dosui(slope(angle, cohesion, friction), "--safety", ranks=ranks)
    exact = safety(angle, cohesion, friction)
    for factor in bracket(run):
        assert 0.97 * exact <= factor <= 1.03 * exact


def test_slope_fails_and_stands_as_it_should(dosui: Runner) -> None:
    """The run itself: 3 % too little strength is refused, 3 % more stands; exact pressures."""
    exact = safety(20.0, 5.0e3, 32.0)
    tangent = math.tan(math.radians(32.0))
    status = {}
    for share in (0.97, 1.03):
        friction = math.degrees(math.atan(tangent * share / exact))
        run = dosui(slope(20.0, 5.0e3 * share / exact, friction), folder=str(share))
        status[share] = run.status
    assert status == {0.97: 1, 1.03: 0}
    fields = run.fields("infinite_slope")
    right = WATER * GRAVITY * math.cos(math.radians(20.0)) * (5.0 - fields["points"][:, 2])
    assert np.abs(fields["pore_pressure"] - right).max() <= 5e-3 * right.max()
    base = np.argmin(fields["points"][:, 2])
    assert run.history("infinite_slope", "water_balance_error")[-1] <= 1e-5
    depth = 5.0 - 0.125  # stresses are means of cells
    effective = (DENSITY - WATER) * GRAVITY * depth * math.cos(math.radians(20.0))
    shear = DENSITY * GRAVITY * depth * math.sin(math.radians(20.0))
    assert fields["effective_stress"][base, 2] == pytest.approx(-effective, rel=5e-3)
    assert np.abs(fields["effective_stress"][base, 3:]).max() == pytest.approx(shear, rel=5e-3)


def test_seepage_becomes_parallel(dosui: Runner) -> None:
    """From no pressure at all to the exact ones of the steady state."""
    text = slope(20.0, 5.0e3, 32.0)
    text = re.sub(r"&initial_state.*", "", text)
    text = re.sub(r"  model = .*\n", "  rigid = .true.\n", text)
    text = re.sub(r"  (young|poisson|cohesion|friction|dilation).*\n", "", text)
    text = re.sub(r"&mechanical_condition.*|  geostatic_start.*", "", text)
    run = dosui(text, ranks=2)
    assert run.status == 0, run.stderr
    fields = run.fields("infinite_slope")
    right = WATER * GRAVITY * math.cos(math.radians(20.0)) * (5.0 - fields["points"][:, 2])
    assert np.abs(fields["pore_pressure"] - right).max() <= 5e-3 * right.max()


LAYER = """
&scene dimension = 2 integrator = '{integrator}' water = 'none' gravity = 3.0, -9.0 /
&grid spacing = 0.125 period = 0.5, 0.0 shape_function = '{shape}' /
&time end_time = {end} /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.25 solid_density = 2000.0
  porosity = 1.0e-9 /
&region name = 'layer' material = 'soil' box_min = -0.75, 0.0 box_max = -0.25, 5.0
  particles_per_cell = 2 /
&surface name = 'base' region = 'layer' face = 'z-' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&output name = 'layer' /
"""


@pytest.mark.parametrize("shape", ["linear", "gimp", "bspline"])
@pytest.mark.parametrize("integrator", ["explicit", "quasi_static"])
def test_layer_under_sudden_gravity(dosui: Runner, integrator: str, shape: str) -> None:
    """Shear waves along, pressure waves across an endless layer; at rest without inertia."""
    end, modulus, height = 0.2, {0: 1.0e7 / 2.5, 2: 1.2e7}, 5.0
    moved = []
    for ranks in (1, 3):
        text = LAYER.format(integrator=integrator, shape=shape, end=end)
        run = dosui(text, ranks=ranks, folder=str(ranks))
        assert run.status == 0, run.stderr
        fields = run.fields("layer")
        order = np.argsort(fields["id"])
        displacement = fields["displacement"][order]
        z = (fields["points"][order] - displacement)[:, 2]
        moved.append(displacement)
    assert np.abs(moved[1] - moved[0]).max() <= 1e-11 * np.abs(moved[0]).max()
    for axis, acceleration in ((0, 3.0), (2, -9.0)):
        static = 2000.0 * acceleration / modulus[axis] * (height * z - 0.5 * z * z)
        right = static.copy()
        if integrator != "quasi_static":
            for n in range(1, 200):
                number = (n - 0.5) * np.pi / height
                frequency = number * math.sqrt(modulus[axis] / 2000.0)
                size = 2000.0 * acceleration / modulus[axis] * 2 / (height * number**3)
                right -= size * np.sin(number * z) * math.cos(frequency * end)
        error = np.linalg.norm(displacement[:, axis] - right) / np.linalg.norm(static)
        assert error <= 1.5e-2, (axis, error)


def test_periods_that_cannot_be(dosui: Runner) -> None:
    """Named with their lines."""
    for change, message in (
        (("period = 1.0", "period = 1.1"), "whole grid spacings"),
        (("period = 1.0", "period = 0.25"), "whole grid spacings"),
        (("period = 1.0", "period = -1.0"), "period"),
    ):
        run = dosui(scene_text("infinite_slope/scene.nml").replace(*change), "--check")
        assert run.status == 2, run.stdout
        assert message in run.stderr
    text = slope(20.0, 5.0e3, 32.0).replace("&scene", "&scene deformation = 'updated'")
    run = dosui(text.replace("'quasi_static'", "'explicit'"), "--check")
    assert run.status == 2
    assert "small_strain" in run.stderr
    text = text.replace("deformation = 'updated'", "").replace("'mohr_coulomb'", "'linear_elastic'")
    text = re.sub(r"  (cohesion|friction|dilation).*\n", "", text)
    run = dosui(text, "--safety")
    assert run.status == 1
    assert "mohr_coulomb" in run.stderr


def test_soils_remember_the_same_on_any_ranks(dosui: Runner) -> None:
    """What a start in plastic soil leaves depends on its way, which must not depend on ranks."""
    text = slope(20.0, 5.0e3, 32.0)
    one, three = (dosui(text, ranks=n, folder=f"ranks{n}") for n in (1, 3))
    for name in ("effective_stress", "plastic_shear_strain", "pore_pressure"):
        a, b = (run.fields("infinite_slope")[name] for run in (one, three))
        assert np.abs(a - b).max() <= 1e-11 * np.abs(a).max()

"""Loads on surfaces that move through the grid, and domains that follow the deformation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import Run, Runner

MODULUS, SOLID, GRAVITY = 1.0e6, 2650.0, 9.81
LOAD = math.log(2.0) * MODULUS  # halves a column whose stress is M ln J


def column(
    courant: float = 0.5,
    spacing: float = 0.1,
    left: float = 0.0,
    load: str = "pressure",
    integrator: str = "explicit",
    shape: str = "gimp",
) -> str:
    """A column of two cells' width between rollers, pressed slowly from its top; nu = 0."""
    wet = integrator == "semi_implicit"
    end = 4.0 if wet else 10.0
    value = f"0.0, {-LOAD}" if load == "traction" else f"{LOAD}"
    return f"""
&scene dimension = 2 integrator = '{integrator}' deformation = 'updated'
  water = '{"coupled" if wet else "none"}' /
&grid spacing = {spacing} shape_function = '{shape}' /
&time end_time = {end} courant = {courant} /
&material name = 'soil' young_modulus = {MODULUS} poisson_ratio = 0.0 porosity = 0.6
  {"hydraulic_conductivity = 1.0e-2" if wet else ""} /
{"&water bulk_modulus = 3.0e6 /" if wet else ""}
&mechanics transfer = 'apic' damping = 'viscous' /
&region name = 'body' material = 'soil' box_min = {left}, 0.0 box_max = {left + 2 * spacing}, 1.0 /
&surface name = 'base' region = 'body' face = 'z-' /
&surface name = 'left' region = 'body' face = 'x-' /
&surface name = 'right' region = 'body' face = 'x+' /
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'top' kind = '{load}' value = {value}
  factor_times = 0.0, {end / 2} factor_values = 0.0, 1.0 /
{"&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /" if wet else ""}
&output name = 'column' /
"""


def lost_height(run: Run) -> tuple[float, float, float]:
    """Error of the height, largest ones of the particles' elevations, which halve, and stresses."""
    assert run.status == 0, run.stderr + run.stdout
    start, end = run.fields("column", 0), run.fields("column")
    z = start["points"][:, 2] + end["displacement"][:, 2] - start["displacement"][:, 2]
    stress = end["effective_stress"][:, 2]
    return (
        abs(4.0 * float(z.mean()) - 1.0),
        float(np.abs(z / 0.5 - start["points"][:, 2]).max()),
        float(np.abs(stress / LOAD + 1.0).max()),
    )


@pytest.mark.parametrize(
    ("shape", "load", "courant"),
    [
        ("gimp", "pressure", 0.5),
        ("gimp", "pressure", 0.2),
        ("gimp", "traction", 0.5),
        ("cpgimp", "pressure", 0.5),
        ("cpgimp", "traction", 0.5),
        ("bspline", "traction", 0.5),
    ],
)
def test_pressed_column(dosui: Runner, shape: str, load: str, courant: float) -> None:
    """To half its height: 0.1 % (it was up to 23 % with forces at the surface points)."""
    run = dosui(column(courant=courant, load=load, shape=shape))
    height, worst, stress = lost_height(run)
    assert max(height, worst) <= 1e-3
    assert stress <= 1e-3
    area = run.history("column", "reaction_base_z")[-1] / LOAD
    assert area == pytest.approx(0.2, rel=1e-4)
    assert run.history("column", "force_balance_error").max() <= 1e-11


def test_pressed_column_between_walls_off_the_grid(dosui: Runner) -> None:
    """Walls get their part of the load back (the column lost its volume without)."""
    height, worst, _ = lost_height(dosui(column(courant=0.3, left=0.033)))
    assert height <= 1e-3
    assert worst <= 1e-2


def test_pressed_wet_column(dosui: Runner) -> None:
    """Semi-implicit steps, drained: 0.2 %."""
    height, worst, _ = lost_height(dosui(column(integrator="semi_implicit", spacing=0.2)))
    assert height <= 2e-3
    assert worst <= 5e-3


def block(end: float, load: float = 2.0e4) -> str:
    """A block on a floor with friction, pressed on its top, then pulled along."""
    return f"""
&scene dimension = 2 integrator = 'explicit' deformation = 'updated' water = 'none'
  gravity = 0.0, {-GRAVITY} /
&grid spacing = 0.1 /
&time end_time = {end} /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.3 porosity = 0.5 /
&mechanics transfer = 'apic' /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 1.0, 0.5 /
&surface name = 'top' region = 'body' face = 'z+' /
&rigid_wall name = 'floor' position = 0.0, 0.0 normal = 0.0, 1.0 kind = 'frictional'
  friction = 0.3 /
&mechanical_condition surface = 'top' kind = 'pressure' value = {load}
  factor_times = 0.0, 0.05 factor_values = 0.0, 1.0 /
&source force_x = '4.0e4*min(1, max(0, (t - 0.1)*1e4))' /
&output name = 'block' /
"""


def test_surcharge_slides_with_friction(dosui: Runner) -> None:
    """Friction is mu (W + p A): the floor's share of the load comes back before friction."""
    run = dosui(block(0.4))
    assert run.status == 0, run.stderr + run.stdout
    mass = 0.5 * SOLID * 0.5
    normal = mass * GRAVITY + 2.0e4
    velocity = run.fields("block")["velocity"].mean(axis=0)
    # the floor's impulse also makes the momentum that the block bounces with
    exact = (0.5 * 4.0e4 - 0.3 * normal) / mass * 0.3 - 0.3 * velocity[2]
    assert velocity[0] == pytest.approx(exact, rel=1e-2)
    time = run.history("block", "time")
    late = time > 0.15
    force = run.history("block", "reaction_floor_z")[late]
    span = np.ptp(time[late])
    bounce = mass * velocity[2] / span
    mean = float(np.trapezoid(force, time[late]) / span)
    assert mean == pytest.approx(normal + bounce, rel=2e-2)
    assert np.allclose(run.history("block", "reaction_floor_x")[late], -0.3 * force)
    assert run.history("block", "force_balance_error").max() <= 1e-11


def test_unequal_pressures_do_not_depend_on_ranks(dosui: Runner) -> None:
    """The field between the loaded top and the free sides is the same on any ranks."""
    found = []
    for ranks in (1, 3):
        run = dosui(block(0.12), ranks=ranks, folder=str(ranks))
        assert run.status == 0, run.stderr + run.stdout
        fields = run.fields("block")
        order = np.lexsort(np.round(fields["points"], 7).T)
        found.append({key: fields[key][order] for key in ("velocity", "effective_stress")})
    for key, one in found[0].items():
        assert np.abs(found[1][key] - one).max() <= 1e-11 * np.abs(one).max()


def test_reservoir_is_buoyancy(dosui: Runner) -> None:
    """A saturated disc sinks with g (1 - rho_w/rho), off the grid, and stays one."""
    run = dosui(f"""
&scene dimension = 2 integrator = 'explicit' deformation = 'updated' gravity = 0.0, {-GRAVITY} /
&grid spacing = 0.1 /
&time end_time = 0.5 /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.3 porosity = 0.5
  hydraulic_conductivity = 1.0e-9 /
&water bulk_modulus = 1.0e7 /
&region name = 'body' material = 'soil' shape = 'circle' centre = 0.033, 1.0 radius = 0.5 /
&surface name = 'skin' region = 'body' face = 'all' /
&mechanical_condition surface = 'skin' kind = 'reservoir' value = 5.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 5.0 /
&output name = 'disc' /
""")
    assert run.status == 0, run.stderr + run.stdout
    fields = run.fields("disc")
    density = 0.5 * SOLID + 500.0
    exact = -GRAVITY * (1.0 - 1000.0 / density) * 0.5
    assert fields["velocity"][:, 2].mean() == pytest.approx(exact, rel=5e-3)
    assert np.std(fields["velocity"][:, 2]) <= 1e-3 * abs(exact)
    # pressures grow by 12 kPa on the way; the skeleton feels next to nothing of it
    assert np.abs(fields["effective_stress"]).max() <= 600.0


def test_domains_follow_the_deformation(dosui: Runner) -> None:
    """A column that its own weight presses to half its thickness below."""
    rate = math.log(2.0)
    pull = f"&base_motion acceleration = 0.0, {LOAD / (0.4 * SOLID)}"
    text = column(courant=0.2)
    first = text.index("&mechanical_condition surface = 'top'")
    last = text.index("factor_times", first)
    heights = {}
    for shape in ("gimp", "cpgimp"):
        scene = (text[:first] + pull + " " + text[last:]).replace("'gimp'", f"'{shape}'")
        run = dosui(scene, folder=shape)
        assert run.status == 0, run.stderr + run.stdout
        start, end = run.fields("column", 0), run.fields("column")
        depth = 1.0 - start["points"][:, 2]
        z = start["points"][:, 2] + end["displacement"][:, 2]
        exact = (np.exp(-rate * depth) - 0.5) / rate
        heights[shape] = z
        assert np.abs(z - exact).max() <= 1e-2 * 0.5 / rate
    assert np.abs(heights["gimp"] - heights["cpgimp"]).max() > 1e-5


@pytest.mark.parametrize("shape", ["gimp", "bspline"])
def test_pressed_box_stays_as_it_is(dosui: Runner, shape: str) -> None:
    """The patch test of moving bodies: jittered, off the grid, under pressure from all sides."""
    faces = {"left": "x-", "right": "x+", "base": "z-", "top": "z+"}
    sides = "\n".join(
        f"&surface name = '{name}' region = 'box' face = '{face}' /\n"
        f"&mechanical_condition surface = '{name}' kind = 'pressure' value = 1.0e4 /"
        for name, face in faces.items()
    )
    run = dosui(f"""
&scene dimension = 2 water = 'none' deformation = 'updated' gravity = 0.0, 0.0 /
&grid spacing = 0.125 shape_function = '{shape}' /
&time end_time = 100.0 maximum_steps = 200 /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.3 /
&region name = 'box' material = 'soil' box_min = 0.03, 0.051 box_max = 0.83, 1.051 jitter = 0.25 /
{sides}
&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e4, 3*0.0 /
&output name = 'box' /
""")
    assert run.status == 0, run.stderr + run.stdout
    fields = run.fields("box")
    assert np.abs(fields["effective_stress"][:, :3] + 1.0e4).max() <= 1e-12 * 1.0e4
    assert np.abs(fields["displacement"]).max() <= 1e-13

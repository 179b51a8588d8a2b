"""Places far away, sizes that no machine holds, and texts with a hundred thousand lines."""

from __future__ import annotations

import resource
from decimal import Decimal

import numpy as np
import pytest
from conftest import Run, Runner

FAR = {1: (5000000,), 2: (500000, 5000000), 3: (500000, -300000, 5000000)}


def at(shift: tuple[int, ...], *place: object) -> str:
    """Coordinates of a place as decimals, moved."""
    return ", ".join(
        str(Decimal(str(x)) + s) for x, s in zip(place[-len(shift) :], shift, strict=True)
    )


def column(shift: tuple[int, ...], h: str, extra: str = "") -> str:
    """A column 2 x 2 x 8 cells wide under weight, water and a load that varies in space."""
    dim = len(shift)
    width, height = 2 * Decimal(h), 8 * Decimal(h)
    level = shift[-1] + height
    sides = ["x-", "x+", "y-", "y+"][: 2 * (dim - 1)]
    gravity = ", ".join(["0"] * (dim - 1) + ["-9.81"])
    text = f"""
&scene dimension = {dim} gravity = {gravity} integrator = 'quasi_static' {extra} /
&grid spacing = {h} /
&time end_time = 500 output_times = 100 /
&material name = 'soil' young_modulus = 1e6 poisson_ratio = 0.25 porosity = 0.3
  hydraulic_conductivity = 1e-6 /
&region name = 'body' material = 'soil' box_min = {at(shift, 0, 0, 0)}
  box_max = {at(shift, width, width, height)} /
&initial_state pore_pressure = 'hydrostatic' water_level = {level}
  effective_stress = 'geostatic' surface_level = {level} lateral_ratio = 0.4 /
&surface name = 'base' region = 'body' face = 'z-' /
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = 1e4
  formula = '1 + 3*(z - {shift[-1]})^2' /
&hydraulic_condition surface = 'top' kind = 'head' value = {level} /
&probe name = 'middle' kind = 'point' field = 'head'
  position = {at(shift, width / 2, width / 2, height / 2)} /
&probe name = 'settlement' kind = 'settlement' surface = 'top' /
&output name = 'r' /
"""
    for face in sides:
        text += f"&surface name = '{face}' region = 'body' face = '{face}' /\n"
        text += f"&mechanical_condition surface = '{face}' kind = 'roller' /\n"
    return text


def differences(near: Run, far: Run, shift: tuple[int, ...]) -> dict[str, float]:
    """Largest differences of the last step's fields over the fields' size at the origin."""
    here, there = near.fields("r"), far.fields("r")
    place = np.zeros(3)
    place[{1: [2], 2: [0, 2], 3: [0, 1, 2]}[len(shift)]] = shift
    there["points"] = there["points"] - place
    if "head" in there:
        # differences of head are what drives water: the column's are its excess over rest
        there["head"] = there["head"] - shift[-1]
    assert set(here) == set(there)
    return {
        key: float(np.abs(here[key] - there[key]).max() / max(np.abs(here[key]).max(), 1e-300))
        for key in here
    }


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize(("h", "tolerance"), [("0.0625", 1e-9), ("0.05", 1e-6)])
def test_site_coordinates(dosui: Runner, dim: int, h: str, tolerance: float) -> None:
    """A column at x = 500 km, z = 5000 km is the column at the origin."""
    origin = (0,) * dim
    near = dosui(column(origin, h), folder="near")
    far = dosui(column(FAR[dim], h), folder="far")
    assert near.status == 0, near.stderr
    assert far.status == 0, far.stderr
    for key, difference in differences(near, far, FAR[dim]).items():
        # points are written with the digits that 5000 km leave
        limit = 1e-8 if key in ("points", "head") else tolerance
        assert difference <= limit, key
    assert far.history("r", "middle") - FAR[dim][-1] == pytest.approx(
        near.history("r", "middle"), abs=2e-8
    )
    assert far.history("r", "settlement") == pytest.approx(
        near.history("r", "settlement"), rel=tolerance
    )


def seepage(shift: tuple[int, int]) -> str:
    """Free reservoirs, a seepage face, a polygon with a hole and a sheet pile."""
    x, z = shift
    corners = [(0, 0), (2, 0), (2, 0.5), (1.5, 1), (0, 1)]
    hole = [(0.4, 0.3), (0.6, 0.3), (0.6, 0.5), (0.4, 0.5)]
    return f"""
&scene dimension = 2 gravity = 0, -9.81 integrator = 'quasi_static' /
&grid spacing = 0.1 /
&time end_time = 1e4 /
&material name = 'soil' rigid = .true. porosity = 0.3 hydraulic_conductivity = 1e-4 /
&region name = 'body' material = 'soil' shape = 'polygon'
  vertices = {", ".join(at(shift, *corner) for corner in corners)} /
&hole region = 'body' vertices = {", ".join(at(shift, *corner) for corner in hole)} /
&barrier name = 'pile' vertices = {at(shift, 1, 0.4)}, {at(shift, 1, 1)} /
&surface name = 'river' region = 'body' face = 'edge5' /
&surface name = 'pit' region = 'body' face = 'edge2' box_max = {at(shift, 9, 0.25)} /
&hydraulic_condition surface = 'river' kind = 'reservoir' value = 1
  formula = '{z} + 0.9 + 0*(x - {x})' /
&hydraulic_condition surface = 'pit' kind = 'seepage_face' /
&source water = '1e-6*(x - {x})*(z - {z})' /
&output name = 'r' /
"""


def test_levels_of_water(dosui: Runner) -> None:
    """Reservoirs, seepage faces, formulas, holes and barriers move with the coordinates."""
    shift = FAR[2]
    near = dosui(seepage((0, 0)), folder="near")
    far = dosui(seepage(shift), folder="far")
    assert near.status == 0, near.stderr
    assert far.status == 0, far.stderr
    assert np.ptp(near.fields("r")["head"]) > 0.2
    for key, difference in differences(near, far, shift).items():
        assert difference <= (1e-8 if key in ("points", "head") else 1e-6), key
    for name in ("inflow_river", "inflow_pit"):
        assert far.history("r", name)[-1] == pytest.approx(near.history("r", name)[-1], rel=1e-6)


def falling(shift: tuple[int, int], extra: str = "", **keys: str) -> str:
    """A turned block and a disc that fall on a wall."""
    return f"""
&scene dimension = 2 water = 'none' gravity = 0, -9.81 deformation = 'updated' {extra} /
&grid spacing = 0.125 shape_function = 'gimp' {keys.get("grid", "")} /
&time end_time = 0.05 time_step = 5e-4 {keys.get("time", "")} /
&material name = 'soil' young_modulus = 1e5 poisson_ratio = 0.25 porosity = 0.3 /
&region name = 'block' material = 'soil' box_min = {at(shift, 0, 0.0625)}
  box_max = {at(shift, 0.5, 0.5625)} shape_angle = 10 lattice_angle = 20
  pivot = {at(shift, 0.25, 0.25)} velocity = 0.5, -2 spin = 1 {keys.get("region", "")} /
&region name = 'disc' material = 'soil' shape = 'circle' centre = {at(shift, 2, 0.5)}
  radius = 0.25 cut_min = {at(shift, 1, 0.5)} jitter = 0.1 /
&rigid_wall name = 'floor' position = {at(shift, 0, 0)} normal = 0, 1 friction = 0.3 /
&output name = 'r' /
"""


def test_moving_bodies(dosui: Runner) -> None:
    """Bodies that move keep their digits, too: 100 steps, contact, turned and jittered lattices."""
    shift = (524288, 4194304)
    near = dosui(falling((0, 0)), folder="near")
    far = dosui(falling(shift), folder="far")
    assert near.status == 0, near.stderr
    assert far.status == 0, far.stderr
    assert near.history("r", "impulse_walls_z")[-1] > 1.0
    for key, difference in differences(near, far, shift).items():
        assert difference <= (1e-8 if key == "points" else 1e-9), key


def test_bodies_that_fly_away(dosui: Runner) -> None:
    """Before the numbers of cells end, a run stops and says who went where; or goes on without."""
    text = falling((0, 0), time="", region="").replace("velocity = 0.5, -2", "velocity = 4e8, 1")
    run = dosui(text.replace("end_time = 0.05", "end_time = 0.05 courant = 0.65"), timeout=100)
    assert run.status == 1, run.stdout + run.stderr
    assert "beyond the grid's reach" in run.stderr
    assert "domain_max" in run.stderr


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("spacing = 0.25", "spacing = 1e-7", ":3: &grid spacing = 1e-7: "),
        ("spacing = 0.25", "spacing = 0.25 origin = 1e20, 0", ":3: &grid origin = 1e20, 0: "),
        ("spacing = 0.25", "spacing = 0.25 period = 1e7, 0", ":3: &grid period = 1e7, 0: "),
        ("box_max = 1, 1", "box_max = 2500000, 1000000", ":6: &region box_max = 2500000, 1000000"),
        ("box_max = 1, 1", "box_max = 1, 1 particle_spacing = 1e-9", "particle_spacing = 1e-9: "),
        ("box_min = 0, 0", "box_min = -1e200, 0", ":6: &region "),
        ("end_time = 100", "end_time = 100 output_interval = 1e-12", "output_interval = 1e-12: "),
        ("end_time = 100", "end_time = 100 output_interval = 1e-6", "output_interval = 1e-6: "),
        ("name = 'r'", "name = 'r' history_interval = 1e-9", "history_interval = 1e-9: "),
        ("name = 'r'", "name = 'r' history_interval = 1e-300", "history_interval = 1e-300: "),
    ],
)
@pytest.mark.parametrize("option", ["--check", ""])
def test_sizes_are_refused(dosui: Runner, old: str, new: str, expected: str, option: str) -> None:
    """What no machine holds is refused at its key before anything of that size is made."""
    text = """
&scene dimension = 2 integrator = 'explicit' /
&grid spacing = 0.25 /
&time end_time = 100 maximum_steps = 3 /
&material name = 's' young_modulus = 1e6 porosity = 0.3 hydraulic_conductivity = 1e-5 /
&region name = 'b' material = 's' box_min = 0, 0 box_max = 1, 1 /
&output name = 'r' /
"""
    assert old in text
    run = dosui(text.replace(old, new), *option.split(), timeout=30)
    assert run.status == 2, run.stdout + run.stderr
    assert expected in run.stderr, run.stderr
    assert [path.name for path in run.folder.iterdir()] == ["scene.nml"]


def test_far_apart_bodies_are_refused(dosui: Runner) -> None:
    """Two bodies with more cells between them than their numbers hold."""
    text = falling((0, 0)).replace("centre = 2, 0.5", "centre = 3e6, 0.5")
    text = text.replace("cut_min = 1, 0.5", "")
    run = dosui(text, "--check", timeout=60)
    assert run.status == 2
    assert "the grid reaches" in run.stderr
    assert "&region radius" in run.stderr


def test_too_many_substeps(dosui: Runner) -> None:
    """A step whose sub-steps 32 bits do not count is refused, not taken without any."""
    text = column((0,), "0.0625").replace("'quasi_static'", "'explicit'")
    text = text.replace("conductivity = 1e-6", "conductivity = 1")
    for stepping in ("subcycle", "rkl2"):
        run = dosui(
            text.replace("end_time = 500 output_times = 100", "end_time = 10 time_step = 10")
            + f"&water stepping = '{stepping}' /\n",
            folder=stepping,
            timeout=60,
        )
        assert run.status == 1, run.stdout
        assert "sub-steps of the water" in run.stderr


def test_ranks_and_restarts(dosui: Runner) -> None:
    """Far away, too, ranks agree to round-off and a restart repeats every bit."""
    text = falling((524288, 4194304)).replace("time_step = 5e-4", "time_step = 5e-4 {}")
    whole = dosui(text.format("output_times = 0.025"), folder="whole")
    assert whole.status == 0, whole.stderr
    two = dosui(text.format("output_times = 0.025"), ranks=2, folder="two")
    assert two.status == 0, two.stderr
    for key, difference in differences(whole, two, (0, 0)).items():
        assert difference <= 1e-10 or key == "rank", key
    saving = text.format("output_times = 0.025 maximum_steps = 60")
    half = dosui(saving.replace("name = 'r'", "name = 'r' checkpoint_steps = 50"), folder="half")
    assert half.status == 0, half.stderr
    again = dosui(text.format("output_times = 0.025"), "--restart", "r.restart.h5", folder="half")
    assert again.status == 0, again.stderr
    here, there = whole.fields("r"), again.fields("r")
    for key in here:
        assert np.array_equal(here[key], there[key]), key


def test_check_estimates(dosui: Runner) -> None:
    """--check prints counts and sizes; they are those of the run."""
    text = column((0, 0), "0.0625")
    run = dosui(text, "--check", folder="check")
    assert run.status == 0, run.stderr
    assert "estimate     64 particles, 40 surface points, " in run.stdout
    assert "estimate     3 outputs: " in run.stdout
    assert "history rows: " in run.stdout
    assert "particles    64 (2-D), surface points 40" in run.stdout


def test_many_groups(dosui: Runner) -> None:
    """A hundred thousand values, fifty thousand groups, ten thousand problems."""

    def many(n: int) -> str:
        times = ", ".join(str(k) for k in range(1, n))
        surfaces = "\n".join(
            f"&surface name = 's{k}' region = 'b' face = 'z+' box_min = {k}, 0 /"
            for k in range(n // 2)
        )
        words = " ".join(f"word_{k} = {k}" for k in range(n // 10))
        return f"""
&scene dimension = 2 integrator = 'explicit' /
&grid spacing = 0.25 /
&time end_time = {n} output_times = {times} /
&material name = 's' young_modulus = 1e6 porosity = 0.3 hydraulic_conductivity = 1e-5 /
&region name = 'b' material = 's' box_min = 0, 0 box_max = 1, 1 /
{surfaces}
&mechanics {words} /
&output name = 'r' /
"""

    run = dosui(many(100000), "--check", folder="many", timeout=60)
    assert run.status == 2
    assert run.stderr.count("unknown key") == 10000


@pytest.mark.parametrize(("regions", "loads"), [(4000, 1), (1, 50000)])
def test_setup_is_linear_in_groups(dosui: Runner, regions: int, loads: int) -> None:
    """Thousands of regions, or loads on one surface: seconds, where every pair took 25 s."""
    bodies = "\n".join(
        f"&region name = 'b{k}' material = 's' box_min = {4 * (k % 100)}, {4 * (k // 100)} "
        f"box_max = {4 * (k % 100) + 2}, {4 * (k // 100) + 2} /"
        for k in range(regions)
    )
    load = "&mechanical_condition surface = 'top' kind = 'pressure' value = 1 /\n"
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    run = dosui(
        f"""
&scene dimension = 2 integrator = 'explicit' water = 'none' /
&grid spacing = 1.0 /
&time end_time = 1 /
&material name = 's' young_modulus = 1e6 porosity = 0.3 /
{bodies}
&surface name = 'top' region = 'b0' face = 'z+' /
&surface name = 'base' region = 'b0' face = 'z-' /
&mechanical_condition surface = 'base' kind = 'roller' /
{load * loads}
&output name = 'r' /
""",
        "--check",
    )
    assert run.status == 0, run.stderr
    assert f"particles    {16 * regions} (2-D), surface points {16 * regions}" in run.stdout
    assert run.stdout.count("load         top: pressure, total force (0, -2) N/m") == loads
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 8.0

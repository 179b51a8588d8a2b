"""Surfaces that overlap, what probes measure on them, and what is said before a run."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import bodies
import numpy as np
import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from conftest import Run, Runner

YOUNG, POISSON = 1.0e6, 0.3
MODULUS = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))

COLUMN = """
&scene dimension = 2 integrator = 'quasi_static' {scene} /
&grid spacing = 0.1 /
&time end_time = {end_time} /
&material name = 's' young_modulus = 1e6 poisson_ratio = 0.3 {flow} /
&region name = 'c' material = 's' box_min = 0, 0 box_max = 0.5, 1 {region} /
&surface name = 'base' region = 'c' face = 'z-' /
&surface name = 'left' region = 'c' face = 'x-' /
&surface name = 'right' region = 'c' face = 'x+' /
&surface name = 'top' region = 'c' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
{more}
&output name = 'r' /
"""
DRY = "water = 'none' gravity = 0, 0"
FLOW = "hydraulic_conductivity = 1e-5"
LOAD = "&mechanical_condition surface = '{}' kind = 'pressure' value = {} /\n"
MIDDLE = "&surface name = 'mid' region = 'c' face = 'z+' box_min = 0.1, 0.9 box_max = 0.3, 1.1 /\n"
SETTLEMENT = "&probe name = '{0}' kind = 'settlement' surface = '{0}' /\n"


def column(more: str, scene: str = DRY, region: str = "", end_time: float = 1.0) -> str:
    """The scene of a column on rollers."""
    flow = "" if scene == DRY else FLOW
    return COLUMN.format(more=more, scene=scene, region=region, end_time=end_time, flow=flow)


def last(run: Run, *names: str) -> list[float]:
    """Last rows of histories."""
    assert run.status == 0, run.stderr
    return [float(run.history("r", name)[-1]) for name in names]


def test_a_probe_takes_nothing_away(dosui: Runner) -> None:
    """A probe on a part of a loaded and drained face: every other number stays, bit for bit."""
    loads = LOAD.format("top", 1000) + "&hydraulic_condition surface='top' kind='head' value=0 /\n"
    plain = loads + SETTLEMENT.format("top")
    before = dosui(column(plain, scene="", end_time=1e4), folder="plain")
    probed = plain + MIDDLE + SETTLEMENT.format("mid")
    after = dosui(column(probed, scene="", end_time=1e4), folder="probed")
    top, mid = last(after, "top", "mid")
    assert last(before, "top") == [top]
    assert abs(top / (1000 / MODULUS) - 1) < 1e-4
    assert abs(mid / top - 1) < 1e-6
    for field, values in before.fields("r").items():
        assert np.array_equal(values, after.fields("r")[field]), field


def test_conditions_that_overlap_act(dosui: Runner) -> None:
    """Loads add up and drainage acts on surfaces that lie over each other, partly or wholly."""
    surfaces = (
        "&surface name = 'more' region = 'c' face = 'z+' /\n"
        "&surface name = 'drain' region = 'c' face = 'z+' box_min = 0.2, 0.9 /\n"
        "&hydraulic_condition surface = 'drain' kind = 'pressure' value = 0 /\n"
    )
    loads = LOAD.format("top", 300) + LOAD.format("more", 700)
    scene = column(surfaces + loads + SETTLEMENT.format("top"), scene="", end_time=1e4)
    run = dosui(scene)
    (settlement,) = last(run, "top")
    assert abs(settlement / (1000 / MODULUS) - 1) < 1e-4
    assert np.abs(run.fields("r")["pore_pressure"]).max() < 0.1
    assert "surface 'top' (pressure) and surface 'more' (pressure) overlap: their sum" in run.stderr


def test_conditions_that_exclude_each_other(dosui: Runner) -> None:
    """Two walls or two hydraulic conditions on one point: both are named, with a place."""
    second = (
        "&surface name = 'all' region = 'c' face = 'all' box_max = 0.6, 0.5 /\n"
        "&mechanical_condition surface = 'all' kind = 'fixed' /\n"
        "&hydraulic_condition surface = 'top' kind = 'head' value = 0 /\n"
        "&hydraulic_condition surface = 'mid' kind = 'flux' value = 1e-6 /\n"
    )
    for ranks in (1, 3):
        run = dosui(column(MIDDLE + second, scene=""), ranks=ranks)
        assert run.status != 0
        for words in (
            "surface 'base' (roller) and surface 'all' (fixed) exclude each other but both name "
            "10 surface points, e.g. at (0.025, 0) m",
            "surface 'left' (roller) and surface 'all' (fixed) exclude each other",
            "surface 'top' (head) and surface 'mid' (flux) exclude each other but both name 4 "
            "surface points, e.g. at (0.125, 1) m",
        ):
            assert words in run.stderr
    same = second.replace("kind = 'fixed'", "kind = 'pressure' value = 0").replace(
        "kind = 'flux' value = 1e-6", "kind = 'head' value = 0"
    )
    assert dosui(column(MIDDLE + same, scene=""), "--check").status == 0  # equal heads agree


def test_loads_on_what_is_held(dosui: Runner) -> None:
    """A pressure against a roller does nothing: a warning says so."""
    run = dosui(column(LOAD.format("base", 1000)), "--check")
    assert run.status == 0
    assert "what is held there does not feel the load on 10 surface points" in run.stderr


PROBES = "".join(
    f"&probe name = '{name}' kind = 'surface_mean' surface = '{surface}' field = '{field}' "
    f"component = {component} /\n"
    for name, surface, field, component in (
        ("top_u", "top", "displacement", 3),
        ("right_u", "right", "displacement", 3),
        ("mid_u", "mid", "displacement", 3),
        ("right_x", "right", "displacement", 1),
        ("right_s", "right", "effective_stress", 3),
        ("top_s", "top", "effective_stress", 1),
    )
)


@pytest.mark.parametrize("region", ["", "jitter = 0.45", "lattice_angle = 20"])
def test_means_of_linear_fields_are_exact(dosui: Runner, region: str) -> None:
    """Displacements and stresses over whole surfaces and parts, on lattices of all kinds."""
    more = LOAD.format("top", 1000) + MIDDLE + PROBES + SETTLEMENT.format("top")
    names = ["top", "top_u", "mid_u", "right_u", "right_x", "right_s", "top_s"]
    run = dosui(column(more, region=region))
    values = last(run, *names)
    u = 1000 / MODULUS
    exact = [u, -u, -u, -u / 2, 0, -1000, -1000 * POISSON / (1 - POISSON)]
    scale = [u] * 5 + [1000] * 2
    assert np.abs((np.array(values) - exact) / scale).max() < 1e-9
    others = dosui(column(more, region=region), ranks=3, folder="ranks")
    assert np.abs((np.array(last(others, *names)) - values) / scale).max() < 1e-11


ROUND = """
&scene dimension = 2 integrator = 'quasi_static' gravity = 0, -9.81 /
&grid spacing = 0.1 /
&time end_time = 1 /
&material name = 's' hydraulic_conductivity = 1e-5 rigid = .true. /
&region name = 'c' material = 's' shape = 'circle' centre = 0.51, 0.53 radius = 0.5 {region} /
&initial_state pore_pressure = 'hydrostatic' water_level = 2.0 /
&surface name = 'rim' region = 'c' face = 'round' /
&surface name = 'low' region = 'c' face = 'round' box_max = 2, 0.53 /
{water}
&probe name = 'rim' kind = 'surface_mean' surface = 'rim' field = 'pore_pressure' /
&probe name = 'low' kind = 'surface_mean' surface = 'low' field = 'pore_pressure' /
&output name = 'r' /
"""


@pytest.mark.parametrize("water", ["", "&hydraulic_condition surface='rim' kind='head' value=2 /"])
@pytest.mark.parametrize("region", ["", "jitter = 0.4 lattice_angle = 30"])
def test_means_over_round_surfaces(dosui: Runner, region: str, water: str) -> None:
    """Water at rest: a circle's mean is that of its centre, its lower half's 2 R/pi below.

    Fits of the particles beside a closed rim and the given heads of an open one agree. The pieces
    of the rim stand for arcs: their middles lie 1 - sin(a)/a too far out, a = pi/60 (4 pieces a
    cell).
    """
    values = last(dosui(ROUND.format(region=region, water=water)), "rim", "low")
    assert abs(values[0] / (9810 * 1.47) - 1) < 1e-6
    assert abs(values[1] / (9810 * (1.47 + 1 / np.pi)) - 1) < 2e-4


def test_a_geostatic_start_is_no_settlement(dosui: Runner) -> None:
    """What moves before the clock starts is forgotten on every surface, walls included."""
    more = "".join(SETTLEMENT.format(name) for name in ("left", "top", "base"))
    more += "&initial_state effective_stress = 'geostatic' surface_level = 0.8 /\n"
    scene = column(more, scene="water = 'none' gravity = 0, -9.81").replace(
        "end_time = 1.0", "end_time = 1.0 geostatic_start = .true."
    )
    run = dosui(scene.replace(FLOW, ""))
    assert np.abs(last(run, "left", "top", "base")).max() < 1e-12


def test_what_a_scene_does_is_listed(dosui: Runner) -> None:
    """Points and area of surfaces, total forces, heads and probes, one line each."""
    more = (
        MIDDLE
        + "&mechanical_condition surface = 'top' kind = 'pressure' value = 1000 "
        + "factor_times = 0, 0.5, 1 factor_values = 0, 2, 0 /\n"
        + "&mechanical_condition surface = 'mid' kind = 'traction' value = 10, -20 "
        + "formula = 'x' /\n"
        + "&hydraulic_condition surface = 'top' kind = 'head' value = 4 /\n"
        + SETTLEMENT.format("mid")
        + "&probe name = 'p' kind = 'point' position = 0.2, 0.4 field = 'pore_pressure' /\n"
        + "&probe name = 'far' kind = 'point' position = 5, 5 field = 'pore_pressure' /\n"
    )
    run = dosui(column(more, scene="gravity = 0, -9.81"), "--check")
    assert run.status == 0
    for line in (
        "surface      top: z+ of c, 10 points, 0.5 m",
        "surface      mid: z+ of c, 4 points, 0.2 m",
        "wall         base: roller on grid nodes (10 points)",
        "load         top: pressure, largest total force (0, -1000) N/m at t = 0.5 s",
        "load         mid: traction, largest total force (0.4, -0.8) N/m at t = 0 s",
        "water        top: head 4 m",
        "probe        mid: settlement of surface 'mid'",
        "probe        p: pore_pressure at (0.2, 0.4)",
    ):
        assert line in run.stdout.splitlines()
    assert "&probe 'far': no particle is near its position" in run.stderr
    assert "'p'" not in run.stderr


LAYERS = """
&scene dimension = 2 water = 'none' integrator = 'explicit' /
&grid spacing = 0.1 /
&time end_time = 1 /
&material name = 's' young_modulus = 1e6 /
&material name = 't' young_modulus = 1e5 /
&region name = 'below' material = 's' box_min = 0, 0 box_max = 0.5, 1 /
&region name = 'thin' material = '{}' box_min = 0, 1 box_max = 0.5, {} /
"""


def test_layers_that_the_grid_does_not_resolve(dosui: Runner) -> None:
    """A layer in half a cell has no strain of its own: said with its key and place."""
    words = "&region 'thin' from (0, 1) to (0.5, 1.05) m: the grid (spacing 0.1 m) does not resolve"
    above = "&region name = 'above' material = 's' box_min = 0, 1.05 box_max = 0.5, 1.1 /\n"
    assert words in dosui(LAYERS.format("t", 1.05), "--check").stderr
    assert words in dosui(LAYERS.format("t", 1.05) + above, "--check", ranks=2).stderr
    assert words in dosui(LAYERS.format("s", 1.05), "--check").stderr  # half its cells are empty
    assert dosui(LAYERS.format("t", 1.1), "--check").stderr == ""
    one_soil = LAYERS.format("s", 1.05).replace("&material name = 't' young_modulus = 1e5 /\n", "")
    assert dosui(one_soil + above, "--check").stderr == ""  # the same soil around
    coarse = LAYERS.format("t", 1.1).replace("1.1 /", "1.1 particle_spacing = 0.2 /")
    assert "particles are 0.2 m apart, more than a cell" in dosui(coarse, "--check").stderr


def leaning_wedge(n_edge: int, n_row: int = 4) -> bodies.Faces:
    """A quarter of a hollow cylinder about z, 0.1 ... 0.5 m wide and 0.4 m high, whose curved faces
    have triangles that lean: every other row of corners is half an edge further round."""
    heights = np.linspace(0.0, 0.4, n_row + 1)
    faces: bodies.Faces = {}
    rims = {}
    for name, radius in (("well", 0.1), ("round", 0.5)):
        rows = []
        for k, z in enumerate(heights):
            steps = np.linspace(0.0, 0.5 * np.pi, n_edge + 1)
            if k % 2:
                steps = np.concatenate([[0.0], 0.5 * (steps[1:] + steps[:-1]), [0.5 * np.pi]])
            rows.append(
                np.stack([radius * np.cos(steps), radius * np.sin(steps), 0 * steps + z], 1)
            )
        triangles = []
        for low, high in pairwise(rows):
            triangles += strip(low, high)
        faces[name] = np.array(triangles)
        if name == "well":
            faces[name] = faces[name][:, ::-1]
        rims[name] = rows
    for name, row, order in (("bottom", 0, -1), ("top", n_row, 1)):
        faces[name] = np.array(strip(rims["round"][row], rims["well"][row]))[:, ::order]
    for name, column_, order in (("y-", 0, -1), ("x-", -1, 1)):
        inner = np.array([row[column_] for row in rims["well"]])
        outer = np.array([row[column_] for row in rims["round"]])
        faces[name] = np.array(strip(inner, outer))[:, ::order]
    return faces


def strip(low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """Triangles between two chains of points that begin and end beside each other."""
    triangles = []
    i = j = 0
    while i < len(low) - 1 or j < len(high) - 1:
        next_low = (i + 1) / (len(low) - 1) if i < len(low) - 1 else 2.0
        next_high = (j + 1) / (len(high) - 1) if j < len(high) - 1 else 2.0
        if next_low <= next_high:
            triangles.append(np.array([low[i], low[i + 1], high[j]]))
            i += 1
        else:
            triangles.append(np.array([low[i], high[j + 1], high[j]]))
            j += 1
    return triangles


WEDGE = """
&scene dimension = 3 integrator = 'quasi_static' /
&grid spacing = 0.1 /
&time end_time = 2e7 relative_tolerance = 1e-2 /
&material name = 's' young_modulus = 2e6 porosity = 0.5 hydraulic_conductivity = 1e-9 /
&region name = 'c' material = 's' shape = 'stl' stl_file = 'wedge.stl' /
{surfaces}
&mechanical_condition surface = 'top' kind = 'pressure' value = 1e5 /
&hydraulic_condition surface = 'well' kind = 'pressure' value = 0 /
&probe name = 'top' kind = 'settlement' surface = 'top' /
&output name = 'r' /
"""


def wedge_scene() -> str:
    """A drain's cell whose curved walls slide along it."""
    surfaces = ""
    for name in ("well", "round", "bottom", "top", "y-", "x-"):
        surfaces += f"&surface name = '{name}' region = 'c' face = '{name}' /\n"
        if name != "top":
            surfaces += f"&mechanical_condition surface = '{name}' kind = 'roller' /\n"
    return WEDGE.format(surfaces=surfaces)


def test_leaning_facets_do_not_lock(dosui: Runner, tmp_path: Path) -> None:
    """Rollers on the triangles of cylinders hold the cylinder's normals: q H/M, 20 mm."""
    bodies.write_text(tmp_path / "wedge.stl", leaning_wedge(8))
    (settlement,) = last(dosui(wedge_scene()), "top")
    assert abs(settlement / 0.02 - 1) < 5e-3


def test_facets_as_large_as_cells(dosui: Runner, tmp_path: Path) -> None:
    """Facets that the grid resolves are held one by one: a warning says so."""
    bodies.write_text(tmp_path / "wedge.stl", leaning_wedge(3, n_row=2))
    run = dosui(wedge_scene(), "--check")
    assert run.status == 0
    assert "surface 'round' is curved, but its facets are larger than cells" in run.stderr
    assert "'well'" not in run.stderr

"""Bodies from STL files: as shapes, drained, coupled, with curved walls, at rest, broken."""

from __future__ import annotations

import re
from pathlib import Path

import bodies
import numpy as np
import pytest
from conftest import ROOT, Run, Runner, scene_text
from test_curved import FACTORS, drainage_errors, errors, history_error, rigid, scene, solution

SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")
ROUND = "shape = 'sphere'\n  radius = 1.0\n  cut_min = 0.0, 0.0, 0.0"


def in_order(run: Run, name: str, field: str, step: int = -1) -> np.ndarray:
    """A field in the order of the particles' identities."""
    assert run.status == 0, run.stderr
    fields = run.fields(name, step)
    return fields[field][np.argsort(fields["id"])]


def difference(run: Run, other: Run, name: str, field: str) -> float:
    """Largest difference, relative to the largest value."""
    right = in_order(other, name, field)
    return float(np.abs(in_order(run, name, field) - right).max() / np.abs(right).max())


def short_column() -> str:
    """Terzaghi's column in 3-D, 0.5 m high, in quasi-static steps."""
    text = scene_text("terzaghi/scene_3d.nml", end_time="10.0", output_times="5.0")
    text = text.replace("'explicit'", "'quasi_static'")
    text = text.replace("damping = 'fading'", "").replace("undrained_start = .true.", "")
    text = text.replace("spacing = 0.025", "spacing = 0.05")
    text = re.sub(r"&verification.*?\n/\n", "", text, flags=re.S)
    return text.replace("0.1, 0.1, 1.0", "0.1, 0.1, 0.5").replace("per_cell = 1", "per_cell = 2")


def test_box_as_a_file(dosui: Runner, tmp_path: Path) -> None:
    """Millimetres, binary, beside the scene: what the box gives, on 3 ranks, too."""
    text = short_column()
    box = dosui(text, folder="box")
    shape = "shape = 'stl' stl_file = '../box.stl' stl_scale = 1.0e-3"
    text = text.replace("box_min = 0.0, 0.0, 0.0\n  box_max = 0.1, 0.1, 0.5", shape)
    faces = bodies.box((0.0, 0.0, 0.0), (0.1, 0.1, 0.5))
    bodies.write_text(tmp_path / "box.stl", faces, 1000.0)
    for ranks in (1, 3):
        run = dosui(text, ranks=ranks, folder=f"file{ranks}")
        for field in ("pore_pressure", "displacement", "effective_stress", "volume"):
            assert difference(run, box, "terzaghi_3d", field) <= 1.0e-11, field
    bodies.write_binary(tmp_path / "box.stl", faces, 1000.0)
    for number, side in enumerate(SIDES):
        text = text.replace(f"face = '{side}'", f"face = 'face{number + 1}'")
    (tmp_path / "file1" / "again.nml").write_text(text)
    run = dosui(tmp_path / "file1" / "again.nml")
    assert difference(run, box, "terzaghi_3d", "pore_pressure") <= 1.0e-11


def test_touching_bodies(dosui: Runner, tmp_path: Path) -> None:
    """A file's body below, a box above, as two boxes: their common face is none."""
    bodies.write_text(tmp_path / "low.stl", bodies.box((0.0, 0.0, 0.0), (0.1, 0.1, 0.3)))
    material = "material = 'soil'\n  particles_per_cell = 2\n  "
    head, tail = short_column().split("&region", 1)
    tail = tail.split("/\n", 1)[1].replace(
        "region = 'column' face = 'z-'", "region = 'low' face = 'z-'"
    )
    for side, name in zip(SIDES[:4], ("left", "right", "front", "back"), strict=True):
        tail += f"&surface name = 'low_{name}' region = 'low' face = '{side}' /\n"
        tail += f"&mechanical_condition surface = 'low_{name}' kind = 'roller' /\n"
    runs = []
    for low in (
        "box_min = 0.0, 0.0, 0.0 box_max = 0.1, 0.1, 0.3",
        "shape = 'stl' stl_file = '../low.stl'",
    ):
        text = f"{head}&region name = 'low' {material} {low} /\n&region name = 'column' {material}"
        text += f" box_min = 0.0, 0.0, 0.3 box_max = 0.1, 0.1, 0.5 /\n{tail}"
        runs.append(dosui(text, ranks=1 + len(runs), folder=f"{len(runs)}"))
    for field in ("pore_pressure", "displacement"):
        assert difference(runs[1], runs[0], "terzaghi_3d", field) <= 1.0e-11, field


def test_turned_with_its_region(dosui: Runner, tmp_path: Path) -> None:
    """shape_angle, pivot and lattice_angle do what they do to a box; so does jitter."""
    bodies.write_text(tmp_path / "box.stl", bodies.box((0.0, 0.0, 0.0), (0.5, 0.3, 0.4)))
    runs = []
    for shape in (
        "box_min = 0.0, 0.0, 0.0 box_max = 0.5, 0.3, 0.4",
        "shape = 'stl' stl_file = '../box.stl'",
    ):
        text = "&scene dimension = 3 integrator = 'quasi_static' water = 'none' /\n"
        text += "&grid spacing = 0.1 /\n&time end_time = 1.0 /\n"
        text += "&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.2 porosity = 0.3 /"
        text += f"\n&region name = 'b' material = 'soil' {shape} shape_angle = 20.0 jitter = 0.2\n"
        text += "  lattice_angle = 15.0 pivot = 0.1, 0.2, 0.1 /\n&output name = 'turned' /\n"
        for side in SIDES:
            kind = "kind = 'roller'" if "-" in side else "kind = 'pressure' value = 1.0e3"
            text += f"&surface name = '{side}' region = 'b' face = '{side}' /\n"
            text += f"&mechanical_condition surface = '{side}' {kind} /\n"
        runs.append(dosui(text, folder=f"{len(runs)}"))
    for field in ("points", "displacement", "effective_stress"):
        assert difference(runs[1], runs[0], "turned", field) <= 1.0e-8, field


def drained_box(path: str, spacing: float) -> str:
    """A rigid body at 1000 Pa before water leaves through its surface; D = 1."""
    return f"""
&scene dimension = 3 integrator = 'quasi_static' /
&grid spacing = {spacing} /
&time end_time = 0.05 output_times = 0.01, 0.02 relative_tolerance = 1.0e-5 /
&material name = 'soil' rigid = .true. porosity = 0.3 hydraulic_conductivity = 9.81e-4 /
&water bulk_modulus = 3.0e6 /
&region name = 'b' material = 'soil' shape = 'stl' stl_file = '{path}' /
&surface name = 'all' region = 'b' face = 'all' /
&hydraulic_condition surface = 'all' kind = 'head' value = 0.0 /
&initial_state pore_pressure = 'given' pore_pressure_value = 1000.0 /
&output name = 'drained' /
"""


def test_box_turned_anyhow(dosui: Runner, tmp_path: Path) -> None:
    """About an axis askew: its drainage is the product of three series."""
    size, axis, angle = np.array([1.0, 0.7, 0.8]), (1.0, 2.0, 3.0), 40.0
    faces = bodies.turned(bodies.box((0.0, 0.0, 0.0), tuple(size)), axis, angle)
    bodies.write_text(tmp_path / "box.stl", faces)
    back = bodies.turned({"": np.eye(3)[None]}, axis, angle)[""][0]
    odd = 2.0 * np.arange(40)[:, None, None] + 1.0
    found = []
    for spacing in (0.2, 0.1):
        run = dosui(drained_box("../box.stl", spacing), ranks=2, folder=f"{spacing}")
        assert run.status == 0, run.stderr
        worst = []
        for step, time in enumerate((0.01, 0.02, 0.05), start=1):
            fields = run.fields("drained", step)
            x = fields["points"] @ back.T
            series = 4.0 / (odd * np.pi) * np.sin(odd * np.pi * x / size)
            series = series * np.exp(-((odd * np.pi / size) ** 2) * time)
            right = 1000.0 * series.sum(axis=0).prod(axis=1)
            worst.append(np.linalg.norm(fields["pore_pressure"] - right) / np.linalg.norm(right))
        assert abs(fields["volume"].sum() - size.prod()) <= 1.0e-12
        found.append(max(worst))
    assert found[1] <= 1.8e-2  # 14 particles across; the box along the lattice has 1.75e-2
    assert found[0] / found[1] >= 2.0**1.7


def test_drained_ball(dosui: Runner, tmp_path: Path) -> None:
    """An eighth of 4096 + 192 triangles: the ball's series, up to 5e-4 of tessellation."""
    factors = FACTORS[:4]
    bodies.write_text(tmp_path / "ball.stl", bodies.octant(6))
    found = []
    for cells in (5, 10):
        text = rigid(scene(3, 1.0 / cells, 0.2, "jitter = 0.25"), factors)
        text = text.replace(ROUND, "shape = 'stl' stl_file = '../ball.stl'")
        run = dosui(text, ranks=2, folder=str(cells))
        found.append(drainage_errors(run, "cryer", 3, factors))
    coarse, fine = found
    assert fine.max() <= 5.0e-3
    assert coarse[0] / fine[0] >= 2.0**1.7


@pytest.mark.long
def test_cryer_on_triangles(dosui: Runner, tmp_path: Path) -> None:
    """Coupled, 1024 triangles on the round face, pore pressures as on the sphere itself."""
    bodies.write_text(tmp_path / "ball.stl", bodies.octant(5))
    text = scene(3, 1.0 / 8, 0.0).replace(ROUND, "shape = 'stl' stl_file = '../ball.stl'")
    run = dosui(text, ranks=2, folder="ball", timeout=300)
    pressure, displacement = errors(run, "cryer", solution(3, 0.0))
    largest, peak = history_error(run, "cryer", solution(3, 0.0))
    assert pressure.max() <= 1.0e-2
    assert displacement.max() <= 1.0e-2
    assert largest <= 1.5e-2
    assert peak <= 5.0e-3


def bent_flow(path: str, region: str = "") -> str:
    """Round a bend between two ends with heads of 0 and 1 m."""
    return f"""
&scene dimension = 3 integrator = 'quasi_static' /
&grid spacing = 0.25 /
&time end_time = 1.0e5 relative_tolerance = 1.0e-5 output_times = 1.0e4 /
&material name = 'soil' rigid = .true. porosity = 0.3 hydraulic_conductivity = 1.0e-4 /
&water bulk_modulus = 2.2e6 /
&region name = 'b' material = 'soil' shape = 'stl' stl_file = '{path}' {region} /
&surface name = 'in' region = 'b' face = 'inlet' /
&surface name = 'out' region = 'b' face = 'outlet' /
&hydraulic_condition surface = 'in' kind = 'head' value = 0.0 /
&hydraulic_condition surface = 'out' kind = 'head' value = 1.0 /
&output name = 'bend' checkpoint_steps = 5 /
"""


def test_flow_round_a_bend(dosui: Runner, tmp_path: Path) -> None:
    """Curved walls of triangles without flow: heads follow the angle. Ranks, restart."""
    bodies.write_text(tmp_path / "bend.stl", bodies.bend(1.0, 2.0, 0.5, 24, 2))
    text = bent_flow("../bend.stl", "jitter = 0.25")
    runs = {ranks: dosui(text, ranks=ranks, folder=f"{ranks}") for ranks in (1, 2, 3, 5)}
    x = in_order(runs[1], "bend", "points")
    head = in_order(runs[1], "bend", "pore_pressure") / 9810.0
    error = head - np.arctan2(x[:, 2], x[:, 0]) / (0.5 * np.pi)
    assert np.abs(error).max() <= 5.0e-3
    for ranks in (2, 3, 5):
        assert difference(runs[ranks], runs[1], "bend", "pore_pressure") <= 1.0e-11
    part = text.replace("end_time = 1.0e5", "end_time = 1.0e5 maximum_steps = 12")
    first = dosui(part, folder="part")
    assert first.status == 0, first.stderr
    again = dosui(text, "--restart", str(first.folder / "bend.restart.h5"), folder="part")
    assert difference(again, runs[1], "bend", "pore_pressure") == 0.0


def test_sharp_edges_within_a_face(dosui: Runner, tmp_path: Path) -> None:
    """All walls of the bend as one face: particles near its edges see each of its sides."""
    faces = bodies.bend(1.0, 2.0, 0.5, 24, 2)
    walls = np.concatenate([faces.pop(name) for name in ("outer", "inner", "front", "back")])
    bodies.write_text(tmp_path / "bend.stl", {**faces, "wall": walls})
    run = dosui(bent_flow("bend.stl", "stl_face_angle = 180.0"))
    assert "faces 3" in run.stdout
    x = in_order(run, "bend", "points")
    head = in_order(run, "bend", "pore_pressure") / 9810.0
    error = head - np.arctan2(x[:, 2], x[:, 0]) / (0.5 * np.pi)
    assert np.sqrt((error**2).mean()) <= 1.0e-3  # with one foot a face 1.5e-3


@pytest.mark.parametrize("name", ["angle", "tunnel", "torus"])
def test_rest(dosui: Runner, tmp_path: Path, name: str) -> None:
    """Concave and pierced bodies under water: exact volumes, nothing moves, nothing flows."""
    faces, spacing = {
        "angle": (bodies.angle_piece(1.0, 0.5), 0.125),
        "tunnel": (bodies.tunnel_block(1.2, 0.6), 0.15),
        "torus": (bodies.torus(1.0, 0.4, 36, 18), 0.3),
    }[name]
    bodies.write_text(tmp_path / "body.stl", faces)
    levels = np.concatenate([x[..., 2].ravel() for x in faces.values()])
    foot = levels.min() + 0.3 * np.ptp(levels)
    text = f"""
&scene dimension = 3 gravity = 0.0, 0.0, -9.81 integrator = 'quasi_static' /
&grid spacing = {spacing} /
&time end_time = 1.0e4 geostatic_start = .true. /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.2 porosity = 0.3
  hydraulic_conductivity = 1.0e-6 /
&water bulk_modulus = 2.2e9 /
&region name = 'b' material = 'soil' shape = 'stl' stl_file = '../body.stl' jitter = 0.2 /
&surface name = 'all' region = 'b' face = 'all' /
&surface name = 'foot' region = 'b' face = 'all' box_max = 1.0e3, 1.0e3, {foot} /
&initial_state pore_pressure = 'hydrostatic' water_level = 5.0 /
&mechanical_condition surface = 'foot' kind = 'fixed' /
&mechanical_condition surface = 'all' kind = 'reservoir' value = 5.0 /
&hydraulic_condition surface = 'all' kind = 'head' value = 5.0 /
&output name = 'rest' /
"""
    if name == "torus":  # 3759 iterations to the equilibrium of so coarse a body
        text = text.replace("young_modulus", "rigid = .true. young_modulus")
        text = re.sub("&mechanical_condition.*\n", "", text).replace("geostatic_start = .true.", "")
        text = text.replace("young_modulus = 1.0e7 poisson_ratio = 0.2", "")
    run = dosui(text, folder="rest")
    assert run.status == 0, run.stderr
    fields = run.fields("rest")
    volume = bodies.volume(faces)
    assert abs(fields["volume"].sum() / volume - 1.0) <= 1.0e-13
    middle = (fields["points"] * fields["volume"][:, None]).sum(axis=0) / volume
    assert np.abs(middle - bodies.centroid(faces)).max() <= 0.02 * spacing
    assert np.abs(fields["displacement"]).max() <= 1.0e-14
    assert np.abs(fields["darcy_velocity"]).max() <= 1.0e-13 * 1.0e-6
    right = 9810.0 * (5.0 - fields["points"][:, 2])
    assert np.abs(fields["pore_pressure"] - right).max() <= 1.0e-13 * right.max()


def test_faces_are_listed(dosui: Runner, tmp_path: Path) -> None:
    """Names of solids, numbers by angles; an unknown face is named with its line."""
    bodies.write_text(tmp_path / "bend.stl", bodies.bend(1.0, 2.0, 0.5, 24, 2))
    text = bent_flow("bend.stl")
    run = dosui(text, "--check")
    assert run.status == 0, run.stderr
    assert "296 triangles, 1.17726 m3, faces 6" in run.stdout
    assert (
        "face         5 of 'inlet': 0.5 m2, normal (0, 0, -1), middle (1.5, 0.25, 0)" in run.stdout
    )
    run = dosui(bent_flow("bend.stl", "stl_face_angle = 1.0"), "--check")
    assert "faces 52" in run.stdout  # 24 strips outside and inside, and 4 planes
    run = dosui(text.replace("'outlet'", "'exit'"), "--check", ranks=2)
    assert run.status == 2
    assert (
        "scene.nml:9: &surface face = 'exit': the region has the faces outer, inner" in run.stderr
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (None, None, "no such file"),
        ("vertex 0.0 1.0 1.0", "vertex 0.0 1.0 nan", "line 6, column 4 (z) = 'nan': must be"),
        ("vertex 0.0 1.0 1.0", "vertex 0.0 1.0", "line 6: a corner has three coordinates"),
        ("vertex 0.0 1.0 1.0", "vertex 0.0 1.0 1.5", "triangle 1 (line 2): its edge"),
        ("vertex 0.0 1.0 1.0", "vertex 0.0 0.0 0.0", "triangle 1 (line 2): its corners coincide"),
        ("endloop", "vertex 0.0 1.0 1.0\n  endloop", "line 7: a fourth corner"),
        ("  endloop\nendfacet\nfacet", "facet", "line 7: 'facet' within a facet"),
        ("facet normal", "triangle", "line 2: unknown word 'triangle'"),
        ("endsolid z+\n", "", "breaks off before 'endsolid'"),
        ("solid x-", "body x-", "is no STL file"),
    ],
)
def test_broken_texts(
    dosui: Runner, tmp_path: Path, old: str | None, new: str, message: str
) -> None:
    """Named with file, key and line, on all ranks."""
    if old is not None:
        path = tmp_path / "box.stl"
        bodies.write_text(path, bodies.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        content = path.read_text()
        assert old in content
        path.write_text(content.replace(old, new, 1))
    run = dosui(drained_box("../box.stl", 0.25), "--check", ranks=2, folder="broken")
    assert run.status == 2, run.stdout
    assert "scene.nml:7: &region stl_file = '../box.stl': " in run.stderr
    assert message in run.stderr


def test_broken_surfaces(dosui: Runner, tmp_path: Path) -> None:
    """Open, flat, inside out, turned triangles, shells in shells, binary files cut short."""
    path = tmp_path / "box.stl"
    good = np.concatenate(list(bodies.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)).values()))
    text = drained_box("../box.stl", 0.25).replace("'b' face = 'all'", "'b' face = 'face1'")

    def said(triangles: np.ndarray, cut: int | None = None) -> str:
        bodies.write_binary(path, {"": triangles})
        path.write_bytes(path.read_bytes()[:cut])
        run = dosui(text, "--check", folder="broken")
        assert run.status == 2, run.stdout
        return run.stderr

    assert "triangle 1: its edge" in said(good[1:])
    assert "the surface is not closed (3 such edges)" in said(good[1:])
    assert "belongs to 3 triangles" in said(np.concatenate([good, good[:1]]))
    one_turned = good.copy()
    one_turned[4] = one_turned[4, ::-1]
    assert "must be turned round" in said(one_turned)
    assert "flat" in said(good * [1.0, 0.0, 1.0])
    assert "encloses no volume" in said(np.stack([good[0], good[0, ::-1]]) @ rotation())
    assert "two parts of it overlap" in said(np.concatenate([good, 0.3 * good + 0.1]))
    assert "passes through itself" in said(np.concatenate([good, good + 0.7]))
    no_number = good.copy()
    no_number[3, 1, 2] = np.nan
    assert "triangle 4 (byte 267): a coordinate is no number" in said(no_number)
    assert "of 12 triangles, which takes 684 bytes; it has 400" in said(good, 400)
    assert "breaks off in triangle 7" in said(good, 400)
    bodies.write_binary(path, {"": good[:, ::-1]})
    run = dosui(text, "--check", folder="broken")
    assert run.status == 0, run.stderr
    assert "inside out: all triangles are turned round" in run.stdout + run.stderr


def rotation() -> np.ndarray:
    """About an axis askew, so that nothing is flat along an axis."""
    return bodies.turned({"": np.eye(3)[None]}, (1.0, 2.0, 3.0), 40.0)[""][0]


def test_keys(dosui: Runner, tmp_path: Path) -> None:
    """A file is needed, and three dimensions."""
    text = drained_box("../box.stl", 0.25)
    run = dosui(text.replace("stl_file = '../box.stl'", ""), "--check")
    assert run.status == 2
    assert "stl_file" in run.stderr
    run = dosui(text.replace("stl_file", "stl_scale = 0.0 stl_file"), "--check")
    assert run.status == 2
    assert "stl_scale = 0.0" in run.stderr
    text = text.replace("dimension = 3", "dimension = 2")
    run = dosui(text, "--check")
    assert run.status == 2


def test_tunnel(dosui: Runner) -> None:
    """The shipped scene: the half-space's exact heads and inflow (bipolar coordinates)."""
    run = dosui(ROOT / "input" / "tunnel" / "scene.nml", ranks=2)
    assert run.status == 0, run.stderr
    fields = run.fields("tunnel")
    x, _, z = fields["points"].T
    far = np.sqrt(5.0**2 - 2.0**2)
    ratio = 2.5 + np.sqrt(2.5**2 - 1.0)
    head = -1.5 / np.log(ratio) * np.log((x**2 + (far - z) ** 2) / (x**2 + (far + z) ** 2))
    assert np.abs(fields["pore_pressure"] / 9810.0 - head).max() <= 5.0e-3 * 3.0
    time, inflow = run.history("tunnel", "time"), run.history("tunnel", "inflow_tunnel")
    rate = -(inflow[-1] - inflow[-2]) / (time[-1] - time[-2])
    assert rate == pytest.approx(2.0 * 2.0 * np.pi * 1.0e-5 * 3.0 / np.log(ratio), rel=0.02)

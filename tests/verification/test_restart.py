"""Checkpoints: of which scene, when they are written, what damage they stand; histories go on."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import BIN, ROOT, Run, Runner, scene_text
from damage_outputs import Sweep
from test_batch import wait_for
from test_slope import DENSITY, GRAVITY, bracket, safety, slope
from test_transfers import slope as running_slope

POST = [sys.executable, "-m", "dosui_post"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT / "postprocess" / "src")}


def column(
    maximum_steps: int = 0, factors: str = "", integrator: str = "explicit", **changes: str
) -> str:
    """A short column in 1-D with histories of every few steps."""
    text = scene_text("terzaghi/scene_1d.nml", **{"spacing": "0.05", "end_time": "0.08"} | changes)
    text = text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "output_interval = 0.02")
    text = text.replace("name = 'terzaghi_1d'", "name = 'box'\n  history_interval = 0.0004")
    text = text.replace("integrator = 'explicit'", f"integrator = '{integrator}'")
    text = text.replace("value = 1000.0 /", f"value = 1000.0 {factors} /")
    if maximum_steps:
        text = text.replace("  end_time", f"  maximum_steps = {maximum_steps}\n  end_time", 1)
    return text


def histories(run: Run, name: str) -> dict[str, bytes]:
    """All rows of all histories, bit by bit."""
    with h5py.File(run.folder / f"{name}.vtkhdf") as file:
        group = file["History"]
        n = int(group.attrs["n_entries"])
        return {key: group[key][:n].tobytes() for key in group}


def same_end(one: Run, two: Run, name: str) -> bool:
    """Are the fields of the last step equal bit by bit?"""
    a, b = one.fields(name), two.fields(name)
    return a.keys() == b.keys() and all(a[key].tobytes() == b[key].tobytes() for key in a)


COLLAPSE = """
&scene dimension = 2 water = 'none' deformation = 'updated' gravity = 0.0, -9.81 /
&grid spacing = 0.1 shape_function = 'gimp' /
&time end_time = 0.3 /
&material name = 'sand' model = 'mohr_coulomb' young_modulus = 1.0e6 poisson_ratio = 0.3
  friction_angle = 30 porosity = 0.4 /
&material name = 'mud' model = 'mohr_coulomb' young_modulus = 1.0e5 poisson_ratio = 0.3
  friction_angle = 20 porosity = 0.4 /
&region name = 'heap' material = 'sand' box_min = 0.0, 0.02 box_max = 0.4, 0.52 /
&region name = 'lid' material = 'mud' box_min = 0.0, 0.52 box_max = 0.4, 0.62 /
&rigid_wall name = 'floor' position = 0.0, 0.0 normal = 0.0, 1.0 friction = 0.4 /
&output name = 'box' history_interval = 0.0005 /
"""


# pressures of a step answer what walls did to the one before
WET = running_slope(integrator="semi_implicit").replace("end_time = 6.0", "end_time = 1.2")
WET = WET.replace("&output name = 'slope' history_interval = 0.1", "&output name = 'box'")


@pytest.mark.parametrize(
    ("text", "stop", "ranks"),
    [
        (column(), 100, 2),
        (column(integrator="semi_implicit"), 5, 1),
        (column(integrator="quasi_static", end_time="2.0").replace("0.02", "1.0"), 7, 2),
        (COLLAPSE, 90, 3),
        (WET, 10, 2),
    ],
    ids=["explicit", "semi_implicit", "quasi_static", "walls", "wet_walls"],
)
def test_histories_go_on_bit_by_bit(dosui: Runner, text: str, stop: int, ranks: int) -> None:
    """Rows, dt, running sums and fields of a stopped run are those of the straight one."""
    straight = dosui(text, ranks=ranks, folder="straight")
    first = text.replace("end_time", f"maximum_steps = {stop} end_time", 1)
    stopped = dosui(first, ranks=ranks, folder="stopped")
    assert stopped.status == 0, stopped.stderr
    assert "maximum_steps ended the run; continue with --restart" in stopped.stdout
    again = dosui(text, "--continue", ranks=ranks, folder="stopped")
    assert straight.status == 0 and again.status == 0, again.stderr
    assert "maximum_steps: " in again.stdout
    one, two = histories(straight, "box"), histories(again, "box")
    assert len(one["time"]) > 8 * stop
    assert one.keys() == two.keys()
    assert [key for key in one if one[key] != two[key]] == []
    assert same_end(straight, again, "box")
    check = subprocess.run([*POST, "check", "box.vtkhdf"], cwd=again.folder, env=ENVIRONMENT)
    assert check.returncode == 0


CHANGES = {
    "&grid spacing: 0.05 -> 0.025": ("spacing = 0.05", "spacing = 0.025"),
    "&scene integrator: 'explicit' -> 'quasi_static'": ("'explicit'", "'quasi_static'"),
    "&scene deformation: 'small_strain' -> 'updated'": (
        "dimension = 1",
        "dimension = 1 deformation = 'updated'",
    ),
    "&water bulk_modulus: 3e6 -> 2e9": ("bulk_modulus = 3.0e6", "bulk_modulus = 2.0e9"),
    "&material 'soil' young_modulus: 1e6 -> 2e6": ("1.0e6", "2.0e6"),
    "&material 'soil' hydraulic_conductivity: 1e-4 -> 1e-5": ("1.0e-4", "1.0e-5"),
    "&region 'column' box_max: 1 -> 1.1": ("box_max = 1.0", "box_max = 1.1"),
    "&region 'column' particles_per_cell: 1 -> 2": (
        "particles_per_cell = 1",
        "particles_per_cell = 2",
    ),
    "&region 'cap': only in the scene of the restart": (
        "&surface name = 'base'",
        "&region name = 'cap' material = 'soil' box_min = 1.0 box_max = 1.2 /\n"
        "&surface name = 'base'",
    ),
    "&mechanical_condition 'top' value: 1000 -> 2000": ("value = 1000.0", "value = 2000.0"),
    "&hydraulic_condition 'top': only in the checkpoint's scene": (
        "&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /",
        "",
    ),
    "&scene gravity: 0 -> -9.81": ("dimension = 1", "dimension = 1 gravity = -9.81"),
}


def test_another_scene_is_refused(dosui: Runner) -> None:
    """Every difference is named, all of them at once; nothing is written."""
    first = dosui(column(100))
    assert first.status == 0, first.stderr
    before = (first.folder / "box.vtkhdf").read_bytes()
    for message, change in CHANGES.items():
        text = column().replace(*change)
        assert text != column()
        run = dosui(text, "--check", "--restart", "box.restart.h5")
        assert run.status == 2, message
        assert message in run.stderr and "of another scene" in run.stderr, run.stderr
    several = list(CHANGES)[4:8]
    text = column()
    for message in several:
        text = text.replace(*CHANGES[message])
    run = dosui(text, "--restart", "box.restart.h5")
    assert run.status == 2
    assert all(message in run.stderr for message in several)
    assert (first.folder / "box.vtkhdf").read_bytes() == before


def test_what_may_change_is_said(dosui: Runner) -> None:
    """End, outputs, probes and factors after the checkpoint; comments, paths are no change."""
    stopped = dosui(column(100))
    text = "! a comment\n" + column(end_time="0.1\n  courant = 0.4").replace("1.0e6", "1e6")
    text = text.replace("&probe name = 'base_pressure'", "&probe name = 'foot'")
    path = stopped.folder / "other" / "name.nml"
    path.parent.mkdir()
    path.write_text(text)
    run = dosui(path, "--restart", "box.restart.h5", "--output", "elsewhere")
    assert run.status == 0, run.stderr
    said = run.stdout[: run.stdout.index("restart  ")]
    for line in (
        "&time end_time: 0.08 -> 0.1",
        "&time courant: 0.5 -> 0.4",
        "&time maximum_steps: 100 -> (unlimited)",
        "&probe 'foot': only in the scene of the restart",
        "&probe 'base_pressure': only in the checkpoint's scene",
    ):
        assert line in said
    assert said.count(" -> ") == 4  # three values and the title line
    same = dosui(column(100), "--restart", "box.restart.h5")
    assert "changed" not in same.stdout


def test_loads_may_change_later_than_the_checkpoint(dosui: Runner) -> None:
    """The state is then that of a run that had the new factors from its start, bit by bit."""
    old = "factor_times = 0, 0.06 factor_values = 0, 1"
    later = "factor_times = 0, 0.03, 0.05 factor_values = 0, 0.5, 2"
    earlier = "factor_times = 0, 0.01, 0.05 factor_values = 0, 0.5, 2"
    assert dosui(column(60, old), folder="run").status == 0
    said = dosui(column(0, old), "--check", "--restart", "box.restart.h5", folder="run").stdout
    assert 0.01 < float(re.search(r"at t = (\S+) s", said)[1]) < 0.03
    run = dosui(column(0, earlier), "--restart", "box.restart.h5", folder="run")
    assert run.status == 2
    assert "&mechanical_condition 'top' factor_values: 0, 1 -> 0, 0.5, 2 (not only later" in (
        run.stderr
    )
    run = dosui(column(0, later), "--restart", "box.restart.h5", folder="run")
    assert run.status == 0, run.stderr
    assert "factor_values: 0, 1 -> 0, 0.5, 2 (only later than the checkpoint)" in run.stdout
    straight = dosui(column(0, later), folder="straight")
    assert same_end(straight, run, "box")


def test_files_of_a_scene_count_with_what_they_hold(dosui: Runner, tmp_path: Path) -> None:
    """A table of particles may move, but not change."""
    places = [0.025 + 0.05 * k for k in range(20)]
    text = column(100).replace("particles_per_cell = 1", "particle_file = 'points.csv'")
    (tmp_path / "points.csv").write_text("\n".join(f"{z:.3f}" for z in places) + "\n")
    run = dosui(text)
    assert run.status == 0, run.stderr
    (tmp_path / "moved.csv").write_text("# moved\n" + "\n".join(f"{z:.4f}" for z in places) + "\n")
    run = dosui(text.replace("points.csv", "moved.csv"), "--check", "--restart", "box.restart.h5")
    assert run.status == 0, run.stderr
    places[3] += 0.001
    (tmp_path / "points.csv").write_text("\n".join(f"{z:.3f}" for z in places) + "\n")
    run = dosui(text, "--check", "--restart", "box.restart.h5")
    assert run.status == 2
    assert "&region 'column' particle_file: content " in run.stderr


def test_checkpoints_at_outputs(dosui: Runner) -> None:
    """One at each output, all kept, in the order of time; any of them leads to the same end."""
    text = column().replace("name = 'box'", "name = 'box'\n  checkpoint_at_outputs = .true.")
    run = dosui(text)
    assert run.status == 0, run.stderr
    names = sorted(path.name for path in run.folder.glob("*.h5"))
    assert len(names) == 5 and all(re.fullmatch(r"box\.restart\.\d{10}\.h5", n) for n in names)
    times = []
    for name in names:
        with h5py.File(run.folder / name) as file:
            times.append(float(file["values/clock"][0]))
    assert times == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
    assert int(names[0].split(".")[2]) == 0
    again = dosui(text, "--restart", f"../{names[2]}", folder="again")
    assert again.status == 0, again.stderr
    assert same_end(run, again, "box")


def test_continue(dosui: Runner) -> None:
    """Starts, goes on, falls back on the checkpoint before; other scenes' do not matter."""
    text = column(100)
    first = dosui(text, "--continue")
    assert first.status == 0 and "no checkpoint of this scene" in first.stdout, first.stderr
    last, previous = (first.folder / f"box.restart.h5{end}" for end in ("", ".previous"))
    shutil.copy(last, first.folder / "newer.restart.h5")
    second = dosui(column(150), "--continue")
    assert second.status == 0 and "from ./box.restart.h5 at" in second.stdout, second.stderr
    last.write_bytes(last.read_bytes()[:-5000])
    third = dosui(column(), "--continue")
    assert third.status == 0 and "from ./box.restart.h5.previous at" in third.stdout
    assert "box.restart.h5 is damaged" in third.stderr
    previous.write_bytes(b"")
    run = dosui(column(), "--continue")
    assert run.status == 2 and "box.restart.h5 is damaged" in run.stderr


def test_nothing_is_left_to_do(dosui: Runner) -> None:
    """A run that maximum_steps has ended does no further step."""
    text = column(100)
    assert dosui(text).status == 0
    run = dosui(text, "--continue")
    assert run.status == 0 and "after 100 steps" in run.stdout, run.stderr
    assert run.history("box", "step")[-1] <= 100


def test_damage_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few members of the sweep of damage_outputs.py."""
    monkeypatch.setenv("PYTHONPATH", ENVIRONMENT["PYTHONPATH"])
    sweep = Sweep(tmp_path, seed=7)
    assert {sweep.check_checkpoint(member) for member in range(7)} == {"refused"}
    verdicts = {check(m) for check in (sweep.check_result, sweep.check_post) for m in range(5)}
    assert verdicts <= {"refused", "unharmed"}


def test_a_damaged_field_is_refused(dosui: Runner) -> None:
    """One bit of one value of a kept step, of a history, of the scene."""
    stopped = dosui(column(100))
    path = stopped.folder / "box.vtkhdf"
    whole = path.read_bytes()
    for name, what in (
        ("VTKHDF/PointData/pore_pressure", "pore_pressure in step 1"),
        ("VTKHDF/Points", "Points in step 1"),
        ("History/dt", "row 1 of the histories"),
        ("Scene/text", "scene"),
    ):
        path.write_bytes(whole)
        with h5py.File(path) as file:
            place = file[name].id.get_offset()
        data = bytearray(whole)
        data[place + 1] ^= 4
        path.write_bytes(data)
        run = dosui(column(), "--continue")
        assert run.status == 1, name
        assert f"box.vtkhdf is damaged: the checksum of {what} does not fit" in run.stderr or (
            "the checksum of the scene does not fit" in run.stderr and what == "scene"
        )
        check = subprocess.run(
            [*POST, "check", str(path)], env=ENVIRONMENT, capture_output=True, text=True
        )
        assert check.returncode == 1 and "does not fit" in check.stderr


def test_a_killed_run_fits_its_checksums(tmp_path: Path) -> None:
    """Killed at any moment: what the file shows is whole."""
    text = column(end_time="100.0").replace("history_interval = 0.0004", "").replace("0.02", "0.2")
    (tmp_path / "scene.nml").write_text(text)
    process = subprocess.Popen([str(BIN / "dosui"), "scene.nml"], cwd=tmp_path)
    wait_for(tmp_path / "box.vtkhdf")
    time.sleep(1.0)
    process.kill()
    process.wait()
    check = subprocess.run([*POST, "check", "box.vtkhdf"], cwd=tmp_path, env=ENVIRONMENT)
    assert check.returncode == 0


def test_safety_of_a_checkpoint(dosui: Runner) -> None:
    """The factor of the state in the checkpoint: drained at first, then with seepage."""
    text = slope(20.0, 5.0e3, 32.0, spacing=0.5)
    text = re.sub(r"&initial_state.*", "&initial_state pore_pressure = 'zero' /", text)
    text = text.replace("&output", "&output\n  checkpoint_at_outputs = .true.")
    run = dosui(text)
    assert run.status == 0, run.stderr
    names = sorted(path.name for path in run.folder.glob("*.h5"))
    inclination, tangent = math.radians(20.0), math.tan(math.radians(32.0))
    weight = DENSITY * GRAVITY * 5.0
    drained = (5.0e3 + weight * math.cos(inclination) * tangent) / (weight * math.sin(inclination))
    for name, exact in ((names[0], drained), (names[-1], safety(20.0, 5.0e3, 32.0))):
        for factor in bracket(dosui(text, "--safety", "--restart", name)):
            assert 0.97 * exact <= factor <= 1.03 * exact
    assert np.isfinite(run.fields("infinite_slope")["pore_pressure"]).all()

"""Bad input, killed runs and signals."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
from conftest import BIN, ROOT, Runner, scene_text

sys.path.insert(0, str(ROOT / "tests" / "robustness"))
import robustness


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("young_modulus = 1.0e6", "young_modulus = -1.0e6", "young_modulus"),
        ("poisson_ratio = 0.2", "poisson_ratio = 0.5", "poisson_ratio"),
        ("porosity = 0.3", "porosity = 1.2", "porosity"),
        ("porosity = 0.3", "porosity = nan", "porosity"),
        ("porosity = 0.3", "porosity = 0,3", "decimal comma"),
        ("porosity = 0.3", "porosty = 0.3", "porosity"),
        ("&material", "&materials", "material"),
        ("face = 'z+'", "face = 'q+'", "face"),
        ("box_max = 0.25, 1.0", "box_max = 0.0001, 0.0001", "region"),
        ("surface = 'top'   kind", "surface = 'tob' kind", "top"),
        ("kind = 'pressure'", "kind = 'presure'", "pressure"),
        ("field = 'pore_pressure'", "field = 'por_pressure'", "por_pressure"),
        ("dimension = 2", "dimension = 4", "dimension"),
    ],
)
@pytest.mark.parametrize("ranks", [1, 2])
def test_bad_input(dosui: Runner, old: str, new: str, expected: str, ranks: int) -> None:
    """A message that names the culprit, exit status 2, no file touched."""
    text = (ROOT / "input/terzaghi/scene_2d.nml").read_text()
    if old not in text:
        old, new = old.replace("   ", " "), new.replace("   ", " ")
    assert old in text
    run = dosui(text.replace(old, new, 1), ranks=ranks, timeout=60)
    assert run.status == 2, run.stdout + run.stderr
    assert expected in run.stderr
    assert [path.name for path in run.folder.iterdir()] == ["scene.nml"]


def test_all_errors_at_once(dosui: Runner) -> None:
    """Several problems are reported together, each with its line."""
    text = scene_text(
        "terzaghi/scene_2d.nml", young_modulus="-1", poisson_ratio="0.7", porosity="2"
    )
    run = dosui(text, timeout=60)
    assert run.status == 2
    for key in ("young_modulus", "poisson_ratio", "porosity"):
        line = 1 + next(k for k, row in enumerate(text.splitlines()) if row.strip().startswith(key))
        assert any(f":{line}:" in row and key in row for row in run.stderr.splitlines()), key


def test_check_computes_nothing(dosui: Runner) -> None:
    """--check validates and writes nothing."""
    run = dosui(ROOT / "input/terzaghi/scene_2d.nml", "--check", timeout=60)
    assert run.status == 0, run.stderr
    assert not list(run.folder.iterdir())


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_template_is_a_valid_scene(dosui: Runner, dimension: int) -> None:
    """The template of each dimension passes its own check."""
    template = subprocess.run(
        [str(BIN / "dosui"), "--template", str(dimension)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert template.returncode == 0
    run = dosui(template.stdout, "--check", timeout=60)
    assert run.status == 0, run.stderr


def long_scene() -> str:
    """A scene that outputs often."""
    text = scene_text("terzaghi/scene_1d.nml", end_time="200.0")
    return text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "output_interval = 0.02")


@pytest.mark.parametrize("ranks", [1, 2])
def test_killed_run_leaves_a_readable_file(dosui: Runner, ranks: int) -> None:
    """Every completed step of a killed run can be read."""
    with pytest.raises(subprocess.TimeoutExpired):
        dosui(long_scene(), ranks=ranks, timeout=3.0)
    run = dosui(ROOT / "input/terzaghi/scene_1d.nml", "--check")
    times = run.times("terzaghi_1d")
    assert len(times) >= 2
    for step in range(len(times)):
        assert len(run.fields("terzaghi_1d", step)["pore_pressure"]) == 40


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_signal_writes_a_checkpoint(dosui: Runner, tmp_path, number: signal.Signals) -> None:
    """A batch system's signal: checkpoint, status 3, and the run can go on."""
    (tmp_path / "scene.nml").write_text(long_scene())
    process = subprocess.Popen([str(BIN / "dosui"), "scene.nml"], cwd=tmp_path)
    deadline = time.monotonic() + 60
    while not (tmp_path / "terzaghi_1d.vtkhdf").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(0.5)
    process.send_signal(number)
    assert process.wait(timeout=60) == 3
    assert (tmp_path / "terzaghi_1d.restart.h5").exists()
    with h5py.File(tmp_path / "terzaghi_1d.vtkhdf") as file:
        end = float(file["VTKHDF/Steps/Values"][int(file["VTKHDF/Steps"].attrs["NSteps"]) - 1]) + 1
    text = scene_text("terzaghi/scene_1d.nml", end_time=f"{end:.3f}", output_times="0.01")
    run = dosui(text, "--restart", "terzaghi_1d.restart.h5", timeout=300)
    assert run.status == 0, run.stderr
    assert run.times("terzaghi_1d")[-1] == pytest.approx(end, abs=1e-3)


@pytest.mark.parametrize("ranks", [1, 3])
def test_crushed_particle_is_named(dosui: Runner, ranks: int) -> None:
    """J <= 0 stops all ranks with step, time, id and place; the state at the end is in the file."""
    text = """
&scene dimension = 2 water = 'none' deformation = 'updated' /
&grid spacing = 0.1 /
&time end_time = 1.0 output_interval = 0.01 /
&mechanics transfer = 'apic' /
&material name = 'soil' young_modulus = 1.0e4 poisson_ratio = 0.2 porosity = 0.3 /
&region name = 'block' material = 'soil' box_min = 0.0, 0.0 box_max = 1.0, 1.0
  velocity = 0.0, -60.0 /
&surface name = 'base' region = 'block' face = 'z-' /
&mechanical_condition surface = 'base' kind = 'roller' /
&output name = 'crush' /
"""
    run = dosui(text, ranks=ranks)
    run.ended_with(1)
    pattern = r"particle \d+ has lost all its volume \(J <= 0\) in step \d+, t = \S+ s, at \("
    assert re.search(pattern, run.stderr), run.stderr
    times = run.times("crush")
    assert len(times) >= 2 and times[-1] > 0.01
    assert np.isfinite(run.fields("crush")["effective_stress"]).all()


@pytest.mark.parametrize(
    ("kind", "count"),
    [("check", 30), ("slips", 60), ("bytes", 20), ("tables", 30), ("restart", 3), ("kill", 2)],
)
def test_random_trials_end_clean(kind: str, count: int) -> None:
    """A short member of each sweep of tests/robustness, which tries thousands."""
    (trial,) = (k for k in robustness.KINDS if k.name == kind)
    outcomes = list(robustness.run_cases(trial, range(count)))
    assert len(outcomes) == count
    assert not [o for o in outcomes if o.state == robustness.BROKEN]
    if kind in ("check", "slips"):  # it tells right from wrong
        assert {robustness.ACCEPTED, robustness.REFUSED} <= {o.state for o in outcomes}

"""Shipped scenes against exact solutions."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT, Runner, pressure_error, scene_text


def verify(folder, name: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Runs dosui-post verify on a result."""
    return subprocess.run(
        [sys.executable, "-m", "dosui_post", "verify", str(folder / f"{name}.vtkhdf"), *options],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT / "postprocess/src")},
    )


def depth(points: np.ndarray) -> np.ndarray:
    """Depth below the drained top."""
    return 1.0 - points[:, 2]


@pytest.mark.parametrize("dimension", [1, pytest.param(2, marks=pytest.mark.long)])
def test_terzaghi_error(dosui: Runner, dimension: int) -> None:
    """The published particle set reaches 1e-3 at T >= 0.1 and 5e-3 at T = 0.05."""
    run = dosui(ROOT / f"input/terzaghi/scene_{dimension}d.nml", "--output", ".", timeout=900)
    assert run.status == 0, run.stderr
    name = f"terzaghi_{dimension}d"
    late = verify(run.folder, name, "--tolerance", "1e-3", "--from-time-factor", "0.1")
    assert late.returncode == 0, late.stdout + late.stderr
    assert verify(run.folder, name, "--tolerance", "5e-3").returncode == 0
    strict = verify(run.folder, name, "--tolerance", "1e-6")
    assert strict.returncode == 1, "a tolerance that cannot be met must fail"


def test_terzaghi_order(dosui: Runner) -> None:
    """Halving the spacing divides the error by 2^1.8 or more (1-D column, T = 0.1)."""
    errors = []
    for spacing in (0.05, 0.025, 0.0125):
        text = scene_text("terzaghi/scene_1d.nml", spacing=str(spacing), end_time="9.81")
        text = text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "")
        run = dosui(text, folder=f"dx{spacing}")
        assert run.status == 0, run.stderr
        errors.append(pressure_error(run, "terzaghi_1d", -1, depth))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[1] <= 1e-3
    assert np.all(orders >= 1.8), f"errors {errors}, orders {orders}"


def test_mandel_error(dosui: Runner) -> None:
    """Mandel's pressures and the Mandel-Cryer rise."""
    run = dosui(ROOT / "input/mandel/nu_0.2.nml", "--output", ".", timeout=900)
    assert run.status == 0, run.stderr
    result = verify(run.folder, "mandel_nu_0.2", "--tolerance", "2e-3")
    assert result.returncode == 0, result.stdout + result.stderr
    centre = run.history("mandel_nu_0.2", "centre_pressure")
    assert centre.max() > 1.05 * centre[0], "the pressure must rise above its undrained value"


def test_literal_operator_reproduces_its_own_error(dosui: Runner) -> None:
    """The published two-pass operator is two orders worse, as measured for it."""
    text = scene_text("terzaghi/scene_2d_two_pass.nml", end_time="9.81")
    text = text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "")
    run = dosui(text)
    assert run.status == 0, run.stderr
    error = pressure_error(run, "terzaghi_2d_two_pass", -1, depth)
    assert 5e-3 <= error <= 1.2e-1, f"error {error}"


def test_hydrostatic_column_rests(dosui: Runner) -> None:
    """Velocity at round-off of sqrt(gH), flux at round-off of k."""
    run = dosui(ROOT / "input/hydrostatic/scene.nml", "--output", ".")
    assert run.status == 0, run.stderr
    data = run.fields("hydrostatic")
    assert np.abs(data["velocity"]).max() <= 1e-9 * np.sqrt(9.81)
    assert np.abs(data["darcy_velocity"]).max() <= 1e-9 * 1.0e-4
    assert np.allclose(data["pore_pressure"], 9810.0 * (1.0 - data["points"][:, 2]), rtol=1e-9)


def test_elastic_bar_vibrates(dosui: Runner) -> None:
    """One period of a dry bar: first mode, no water fields."""
    run = dosui(ROOT / "input/elastic_bar/scene.nml", "--output", ".")
    assert run.status == 0, run.stderr
    result = verify(run.folder, "elastic_bar")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "pore_pressure" not in run.fields("elastic_bar")


def test_vtk_reads_every_step(dosui: Runner) -> None:
    """ParaView's reader opens all steps."""
    vtk = pytest.importorskip("vtkmodules.vtkIOHDF")
    text = scene_text("terzaghi/scene_1d.nml", end_time="0.1")
    text = text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "output_interval = 0.02")
    run = dosui(text)
    assert run.status == 0, run.stderr
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(run.folder / "terzaghi_1d.vtkhdf"))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 6
    for step in range(6):
        reader.SetStep(step)
        reader.Update()
        output = reader.GetOutput()
        assert output.GetNumberOfPoints() == 40
        assert output.GetPointData().GetArray("pore_pressure") is not None

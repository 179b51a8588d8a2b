"""The command `verify`: what passes, what fails and how."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from synthetic import FloatArray, Spoil

from dosui_post.cli import main
from dosui_post.result import Result
from dosui_post.verify import verify


def scaled(factor: float) -> Spoil:
    return lambda values, _step: values * (1 + factor)


def broken_at(step: int, value: float) -> Spoil:
    def spoil(values: FloatArray, index: int) -> FloatArray:
        if index == step:
            values = values.copy()
            values[3] = value
        return values

    return spoil


def status(path: Path, *options: str) -> int:
    return main(["verify", str(path), *options])


@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("moving", [False, True])
def test_exact_terzaghi_passes(tmp_path: Path, ndim: int, moving: bool) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", ndim=ndim, moving=moving)
    assert status(path, "--tolerance", "1e-12") == 0


def test_the_error_is_the_relative_l2_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", spoil=scaled(3e-3))
    with Result(path) as result:
        verification = verify(result)
    assert [step.error for step in verification.steps] == pytest.approx([3e-3] * 5)
    assert [step.time_factor for step in verification.steps] == pytest.approx(synthetic.T_OUTPUT)
    assert verification.steps[0].others["displ. L2"] == 0
    assert verification.steps[0].others["settlement"] < 1e-4
    assert status(path) == 0
    assert "passed: largest error 3.000e-03 <= tolerance 0.005" in capsys.readouterr().out
    assert status(path, "--tolerance", "2.9e-3") == 1
    assert "FAILED" in capsys.readouterr().out


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("step", [1, 5])
def test_a_single_value_that_is_not_finite_fails(tmp_path: Path, value: float, step: int) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", spoil=broken_at(step, value))
    assert status(path, "--tolerance", "1e9") == 1


@pytest.mark.parametrize("name", ["displacement", "volume"])
def test_nan_elsewhere_fails_too(tmp_path: Path, name: str) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        file["VTKHDF/PointData"][name][-1] = np.nan
    assert status(path, "--tolerance", "1e9") == 1


def test_nan_in_the_settlement_history_fails(tmp_path: Path) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        file["History/top_settlement"][200:] = np.nan
    assert status(path, "--tolerance", "1e9") == 1


def test_no_step_after_the_start_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", time_factors=())
    assert status(path) == 1
    assert "no output step can be compared" in capsys.readouterr().out


def test_steps_before_a_time_factor_can_be_left_out(tmp_path: Path) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", spoil=broken_at(1, 1e9))
    assert status(path) == 1
    assert status(path, "--from-time-factor", "0.1") == 0
    assert status(path, "--from-time-factor", "5") == 1


def test_literal_operator_has_its_own_tolerance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", spoil=scaled(0.1), operator="two_pass")
    assert status(path) == 0
    assert "the error is the method's own" in capsys.readouterr().out
    path = synthetic.terzaghi_file(tmp_path / "b.vtkhdf", spoil=scaled(0.1))
    assert status(path) == 1


def test_a_run_that_ended_early_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf", room=2)
    with h5py.File(path, "r+") as file:
        file["VTKHDF/Steps"].attrs["NSteps"] = np.int64(4)
    assert status(path) == 0
    assert "has not reached its end" in capsys.readouterr().out


@pytest.mark.parametrize("nu", [0.0, 0.2, 0.4, 0.499])
def test_exact_mandel_passes(tmp_path: Path, nu: float) -> None:
    path = synthetic.mandel_file(tmp_path / "a.vtkhdf", nu)
    assert status(path, "--tolerance", "1e-12") == 0
    with Result(path) as result:
        assert all(step.others["displ. L2"] < 1e-12 for step in verify(result).steps)


def test_mandel_of_another_soil_fails(tmp_path: Path) -> None:
    """The comparison uses the stored constants, not those the values came from."""
    path = synthetic.mandel_file(tmp_path / "a.vtkhdf", 0.2)
    with h5py.File(path, "r+") as file:
        echo = file["Scene/echo"][()].decode().replace("poisson_ratio = 0.2", "poisson_ratio = 0.1")
        del file["Scene/echo"]
        file["Scene/echo"] = echo
    assert status(path) == 1


def test_turned_drainage(tmp_path: Path) -> None:
    assert status(synthetic.drainage_file(tmp_path / "a.vtkhdf"), "--tolerance", "1e-12") == 0


def test_hydrostatic(tmp_path: Path) -> None:
    assert status(synthetic.hydrostatic_file(tmp_path / "a.vtkhdf")) == 0
    assert status(synthetic.hydrostatic_file(tmp_path / "b.vtkhdf", speed=1e-6)) == 1
    assert status(synthetic.hydrostatic_file(tmp_path / "c.vtkhdf", pressure_error=1e-6)) == 1
    assert status(synthetic.hydrostatic_file(tmp_path / "d.vtkhdf", speed=np.nan)) == 1


def test_bar(tmp_path: Path) -> None:
    assert status(synthetic.bar_file(tmp_path / "a.vtkhdf"), "--tolerance", "1e-12") == 0
    assert status(synthetic.bar_file(tmp_path / "b.vtkhdf", damping=1.0)) == 1


def test_several_results_and_the_worst_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = str(synthetic.terzaghi_file(tmp_path / "good.vtkhdf"))
    bad = str(synthetic.terzaghi_file(tmp_path / "bad.vtkhdf", spoil=scaled(1.0)))
    assert main(["verify", good, good]) == 0
    assert main(["verify", bad, good]) == 1
    assert main(["verify", "missing.vtkhdf", bad, good]) == 2
    output = capsys.readouterr()
    assert "missing.vtkhdf does not exist" in output.err
    assert output.out.count("passed") == 4


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("case = 'terzaghi'", "case = ''", "names no exact solution"),
        ("case = 'terzaghi'", "case = 'gibson'", "known: terzaghi"),
        ("porosity = 0.3", "", "no value of porosity"),
        ("porosity = 0.3", "porosity = 1.5", "out of range: porosity"),
        ("length = 1.0", "length = 0.0", "length"),
        ("load = 1000.0", "load = 0.0", "load"),
        ("direction = 0.0, -1.0", "direction = 0.0, -2.0", "unit vector"),
        ("deformation", "gravity = 0.0, -9.81 deformation", "without gravity"),
        ("material = 'soil' box", "material = 'rock' box", "no material"),
    ],
)
def test_scenes_without_a_solution(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    path = synthetic.terzaghi_file(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        echo = file["Scene/echo"][()].decode()
        assert old in echo
        del file["Scene/echo"]
        file["Scene/echo"] = echo.replace(old, new)
    assert status(path) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "a.vtkhdf" in error

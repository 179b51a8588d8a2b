"""Runs dosui on scenes in a temporary folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "postprocess" / "src"))
# containers run as root, and have fewer cores than some tests have ranks
for variable, value in {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}.items():
    os.environ.setdefault(variable, value)
BIN = Path(os.environ.get("DOSUI_BIN", ROOT / "build" / "release" / "bin"))


def pytest_configure(config: pytest.Config) -> None:
    """The mark of tests that only tests/long.sh runs."""
    config.addinivalue_line("markers", "long: more than half a minute of a core; tests/long.sh")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests have a shorter sibling in every test run."""
    if os.environ.get("DOSUI_LONG"):
        return
    for item in items:
        if "long" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="a long test: tests/long.sh"))


@dataclass
class Run:
    """What a run left behind."""

    status: int
    stdout: str
    stderr: str
    folder: Path
    accepted: int = 0  # status of runs whose results may be read

    def ended_with(self, status: int) -> None:
        """Makes sure that the run failed as it should: then its results may be read, too."""
        assert self.status == status, self.stdout + self.stderr
        self.accepted = status

    def _open(self, name: str) -> h5py.File:
        """The result file of a run that ended as it should: a test of a run that failed by chance
        would compare what was there before."""
        assert self.status == self.accepted, self.stdout + self.stderr
        return h5py.File(self.folder / f"{name}.vtkhdf")

    def fields(self, name: str, step: int = -1) -> dict[str, np.ndarray]:
        """Point data of one step of a result file, with the points themselves."""
        with self._open(name) as file:
            vtk = file["VTKHDF"]
            n_steps = int(vtk["Steps"].attrs["NSteps"])
            k = step % n_steps
            first = int(vtk["Steps/PointOffsets"][k])
            last = first + int(vtk["NumberOfPoints"][k])
            data = {key: vtk["PointData"][key][first:last] for key in vtk["PointData"]}
            data["points"] = vtk["Points"][first:last]
            return data

    def history(self, name: str, column: str) -> np.ndarray:
        """The valid rows of a history column."""
        with self._open(name) as file:
            group = file["History"]
            return np.asarray(group[column][: int(group.attrs["n_entries"])])

    def times(self, name: str) -> np.ndarray:
        """Times of the output steps."""
        with self._open(name) as file:
            steps = file["VTKHDF/Steps"]
            return np.asarray(steps["Values"][: int(steps.attrs["NSteps"])])


Runner = Callable[..., Run]


@pytest.fixture
def dosui(tmp_path: Path) -> Runner:
    """Runs a scene (text or path), on several ranks, in a folder of its own."""

    def run(
        scene: str | Path, *options: str, ranks: int = 1, folder: str = ".", timeout: float = 300
    ) -> Run:
        work = tmp_path / folder
        work.mkdir(parents=True, exist_ok=True)
        if isinstance(scene, str):
            path = work / "scene.nml"
            path.write_text(scene)
        else:
            path = scene
        command = [str(BIN / "dosui"), str(path), *options]
        if ranks > 1:
            command = ["mpirun", "-n", str(ranks), *command]
        done = subprocess.run(command, cwd=work, capture_output=True, text=True, timeout=timeout)
        return Run(done.returncode, done.stdout, done.stderr, work)

    return run


def scene_text(path: str, **changes: str) -> str:
    """A shipped scene with some values replaced: the first `key = value` of each key."""
    text = (ROOT / "input" / path).read_text()
    for key, value in changes.items():
        text, n = re.subn(rf"(?m)^(\s*{key}\s*=\s*)[^\n]*$", rf"\g<1>{value}", text, count=1)
        assert n == 1, f"{path} has no {key}"
    return text


def exact_terzaghi(depth: np.ndarray, time: float, height: float = 1.0) -> np.ndarray:
    """Excess pressure of the shipped Terzaghi scenes: an independent series [Pa]."""
    modulus = 1.0e6 * 0.8 / (1.2 * 0.6)
    storage = 0.3 / 3.0e6
    c_v = 1.0e-4 / 9810.0 / (storage + 1.0 / modulus)
    u_0 = 1000.0 / modulus / (storage + 1.0 / modulus)
    mu = 0.5 * np.pi * (2 * np.arange(300)[:, None] + 1)
    series = 2.0 / mu * np.sin(mu * depth / height) * np.exp(-(mu**2) * c_v * time / height**2)
    return u_0 * series.sum(axis=0)


def pressure_error(
    run: Run, name: str, step: int, depth_of: Callable[[np.ndarray], np.ndarray]
) -> float:
    """Relative L2 error of the particles' pressure against Terzaghi's solution."""
    data = run.fields(name, step)
    exact = exact_terzaghi(depth_of(data["points"]), run.times(name)[step])
    return float(np.linalg.norm(data["pore_pressure"] - exact) / np.linalg.norm(exact))

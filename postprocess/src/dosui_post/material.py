"""Laboratory tests of a scene's soils, run by `dosui --elements` and drawn."""

from __future__ import annotations

import csv
import io
import shutil
import subprocess
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dosui_post.errors import DosuiPostError
from dosui_post.result import FloatArray
from dosui_post.style import COLOURS, caption, house_style, save
from dosui_post.units import number

_TIMEOUT = 300.0  # of the tests [s]


@dataclass(frozen=True)
class ElementTest:
    """One test of one soil; stresses are effective and tension positive, as in result files."""

    material: str
    name: str
    strain: FloatArray  # (steps, 4): xx, yy, zz, zx (twice the shear)
    stress: FloatArray  # (steps, 4) [Pa]
    pore_pressure: FloatArray  # (steps,) [Pa]

    @property
    def mean(self) -> FloatArray:
        """p, compression positive [Pa]."""
        return np.asarray(-self.stress[:, :3].mean(axis=1))

    @property
    def deviatoric(self) -> FloatArray:
        """Deviatoric stress q = sqrt(3 J2), positive [Pa]."""
        s = self.stress[:, :3] + self.mean[:, None]
        return np.asarray(np.sqrt(1.5 * (s**2).sum(axis=1) + 3 * self.stress[:, 3] ** 2))

    @property
    def volume_strain(self) -> FloatArray:
        """Expansion positive [-]."""
        return np.asarray(self.strain[:, :3].sum(axis=1))

    @property
    def distortion(self) -> FloatArray:
        """Shear strain of tests with shear, else the axial strain, compression positive [-]."""
        return np.asarray(self.strain[:, 3] if "shear" in self.name else -self.strain[:, 2])

    @property
    def cycled(self) -> FloatArray:
        """What a cyclic test cycles: the shear stress, or axial less lateral stress [Pa]."""
        if "shear" in self.name:
            return self.stress[:, 3]
        return np.asarray(self.stress[:, 0] - self.stress[:, 2])

    @property
    def cycles(self) -> FloatArray:
        """Cycles so far, half of one for each turn of the strain, linear in the stress between."""
        way = np.sign(np.diff(self.distortion))
        turns = np.concatenate([[0], np.cumsum(np.abs(np.diff(way)) > 0), [0]])
        turns[-1] = turns[-2]
        half = turns[: len(self.distortion)].astype(float)
        done = np.zeros_like(half)
        for k in range(int(half[-1]) + 1):
            at = np.flatnonzero(half == k)
            if len(at) > 1:
                path = np.abs(np.diff(self.cycled[at], prepend=self.cycled[at[0]])).cumsum()
                done[at] = path / max(path[-1], 1e-300) * (len(at) - 1) / len(at)
        return np.asarray(0.5 * (half + done))


def element_tests(scene: Path, pressure: float, program: Path | None) -> list[ElementTest]:
    """Lets dosui test the soils of a scene."""
    command = str(program) if program is not None else shutil.which("dosui")
    if command is None:
        raise DosuiPostError("dosui is not on PATH: say where it is with --program")
    try:
        done = subprocess.run(
            [command, f"--elements={pressure!r}", str(scene)],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DosuiPostError(f"cannot run {command}: {error}") from error
    if done.returncode != 0:
        raise DosuiPostError(done.stderr.strip() or f"{command} stopped with {done.returncode}")
    return parse_tests(done.stdout)


def parse_tests(text: str) -> list[ElementTest]:
    """The tests in a table of `dosui --elements`."""
    rows: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
    reader = csv.reader(io.StringIO(text))
    heading = next(reader, [])
    if heading[:3] != ["material", "test", "step"] or len(heading) != 12:
        raise DosuiPostError("this is not a table of dosui --elements")
    for row in reader:
        rows[row[0], row[1]].append([float(value) for value in row[3:]])
    if not rows:
        raise DosuiPostError("the scene has no soil that deforms")
    tests = []
    for (material, name), values in rows.items():
        table = np.array(values)
        tests.append(ElementTest(material, name, table[:, :4], table[:, 4:8], table[:, 8]))
    return tests


def draw_tests(tests: list[ElementTest], material: str, output: Path) -> Path:
    """One soil: stresses and volumes over strain, stress paths; loops of cycles, pore pressures."""
    chosen = [test for test in tests if test.material == material]
    if not chosen:
        known = ", ".join(dict.fromkeys(test.material for test in tests))
        raise DosuiPostError(f"no material '{material}' (known: {known})")
    with house_style():
        figure = Figure(figsize=(11.0, 6.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 3)
        for colour, test in zip(COLOURS, chosen, strict=False):
            if test.name.startswith("cyclic"):
                _line(axes[1, 0], 100 * test.distortion, test.cycled / 1e3, test, colour)
                _line(axes[1, 1], test.mean / 1e3, test.cycled / 1e3, test, colour)
                ratio = test.pore_pressure / test.mean[0]
                _line(axes[1, 2], test.cycles, ratio, test, colour)
                continue
            distortion = 100 * test.distortion
            _line(axes[0, 0], distortion, test.deviatoric / 1e3, test, colour)
            _line(axes[0, 1], test.mean / 1e3, test.deviatoric / 1e3, test, colour)
            if "undrained" not in test.name:
                _line(axes[0, 2], distortion, 100 * test.volume_strain, test, colour)
        labels = (
            ("axial or shear strain [%]", "q [kPa]"),
            ("p [kPa]", "q [kPa]"),
            ("axial or shear strain [%]", "volume strain [%]"),
            ("axial or shear strain [%]", "cycled q or shear stress [kPa]"),
            ("p [kPa]", "cycled q or shear stress [kPa]"),
            ("cycles", "pore pressure / first p"),
        )
        for axis, (x, y) in zip(axes.flat, labels, strict=True):
            axis.set_xlabel(x)
            axis.set_ylabel(y)
        others = [test for test in chosen if test.name != "oedometer"]
        if others:  # an oedometer goes to much larger stresses
            top = 1.3 * max(float(test.deviatoric.max()) for test in others) / 1e3
            right = 1.3 * max(float(test.mean.max()) for test in others) / 1e3
            axes[0, 0].set_ylim(-0.03 * top, top)
            axes[0, 1].set_ylim(-0.03 * top, top)
            axes[0, 1].set_xlim(-0.03 * right, right)
        handles = {handle.get_label(): handle for axis in axes.flat for handle in axis.get_lines()}
        figure.legend(
            list(handles.values()), [str(k) for k in handles], loc="outside lower center", ncols=4
        )
        start = float(chosen[0].mean[0])
        caption(figure, f"Element tests of '{material}'", f"from p = {number(start / 1e3)} kPa")
        return save(figure, output)


def _line(axis: Axes, x: FloatArray, y: FloatArray, test: ElementTest, colour: str) -> None:
    axis.plot(x, y, "-", color=colour, linewidth=1.3, label=test.name.replace("_", " "))

"""Kratos GeoMechanics on the report's columns and slabs: input, run, error.

Quadratic displacements and linear pressures on squares of the width dx, the generalised Newmark
scheme with θ = 0.5 (pressures by the trapezoidal rule), steps that grow until T = 0.05, a direct
solver, one thread. Mandel's plate moves as in the exact solution. Kratos runs in an interpreter of
its own, by `kratos_driver.py`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

import numpy as np

from dosui_post.errors import DosuiPostError
from dosui_post.report.elements import (
    SIDES,
    Mesh,
    drained,
    error_of,
    plate_motion,
    rollers,
    step_ends,
)
from dosui_post.report.measure import errors_at, is_finished
from dosui_post.report.process import run
from dosui_post.report.scenes import PROBLEMS, TIME_FACTORS, Problem
from dosui_post.report.store import DONE, FAILED, TIMEOUT, Run, Store

METHOD = "Kratos, Taylor–Hood"
DRIVER = Path(__file__).with_name("kratos_driver.py")

_THETA = 0.5
_STEPS = (16, 48)
_WIDTHS = {"terzaghi": (0.05, 0.025), "mandel": (0.02, 0.01)}


@dataclass(frozen=True)
class KratosJob:
    """One run."""

    problem: Problem
    spacing: float
    """width of the elements [m]"""
    n: int
    """steps until T = 0.05"""

    @property
    def control(self) -> str:
        """As the tables call it."""
        return f"{len(step_ends(self.problem, self.n))} steps"

    @property
    def label(self) -> str:
        """One line, as those of dosui."""
        spacing = f"dx = {self.spacing:g} m"
        return f"{self.problem.name}: {METHOD}, {spacing}, {self.control}, 1 rank"

    def case(self) -> str:
        """What the driver reads."""
        problem, mesh = self.problem, Mesh.of(self.problem, self.spacing)
        ends = step_ends(problem, self.n)
        # output times as the steps end, to the last bit
        outputs = [min(ends, key=lambda end: abs(end - time)) for time in problem.times]
        plate = [plate_motion(problem, end) for end in ends]
        top = sorted(mesh.side("top"), key=lambda k: -mesh.points[k, 0])
        edges = [[top[k], top[k + 2], top[k + 1]] for k in range(0, len(top) - 2, 2)]
        return json.dumps(
            {
                "points": mesh.points[:, :2].tolist(),
                "cells": mesh.cells,
                "edges": edges if plate[0] is None else [],
                "sides": {name: mesh.side(name) for name in SIDES},
                "rollers": rollers(problem),
                "drained": drained(problem),
                "plate": None if plate[0] is None else plate,
                "load": problem.load,
                "soil": asdict(problem.soil),
                "theta": _THETA,
                "ends": ends,
                "outputs": outputs,
            }
        )


def measure_all(
    python: str | None,
    is_quick: bool,
    only: str,
    store: Store,
    tell: Callable[[str], None],
    repeat: int = 1,
    limit: float = 3600.0,
) -> list[Run]:
    """The runs of Kratos by an interpreter that has it; none without one."""
    if python is None:
        tell("Kratos: no interpreter given (--kratos), skipped")
        return []
    version = _version(python)
    tell(version)
    runs = []
    wanted = re.compile(only, re.IGNORECASE)
    for job in (job for job in jobs(is_quick) if wanted.search(job.label)):
        found = store.get(_key(job, version))
        if found is None or not is_finished(found, repeat, limit):
            found = _measure(job, python, version, repeat, limit)
            store.add(found)
        runs.append(found)
        said = found.message or f"{found.wall:.2f} s, error {found.error:.1e}"
        tell(f"{job.label}: {said}")
    return runs


def jobs(is_quick: bool) -> list[KratosJob]:
    """Columns and Mandel's slab; with more steps if there is time."""
    counts = _STEPS if is_quick else (*_STEPS, 3 * _STEPS[-1])
    return [
        KratosJob(problem, dx, n)
        for kind, widths in _WIDTHS.items()
        for problem in (PROBLEMS[kind], PROBLEMS[f"{kind}-stiff"])
        for dx in widths
        for n in counts
    ]


# ---------------------------------------------------------------------- inside


def _measure(job: KratosJob, python: str, version: str, repeat: int, limit: float) -> Run:
    mesh = Mesh.of(job.problem, job.spacing)
    result = Run(
        key=_key(job, version),
        scene=job.problem.name,
        method=METHOD,
        spacing=job.spacing,
        control=job.control,
        ranks=1,
        state=FAILED,
        particles=len(mesh.points),
        steps=float(len(step_ends(job.problem, job.n))),
        when=date.today().isoformat(),
        program=version,
    )
    for _ in range(repeat):
        with tempfile.TemporaryDirectory(prefix="dosui_report_") as name:
            folder = Path(name)
            (folder / "case.json").write_text(job.case(), encoding="utf-8")
            command = [python, str(DRIVER), "case.json", "result.json"]
            outcome = run(command, folder, limit)
            if outcome.status != 0:
                result.state = TIMEOUT if outcome.status is None else FAILED
                result.wall, result.message = outcome.wall, outcome.last_words()
                return result
            if result.state != DONE or outcome.wall < result.wall:
                result.wall, result.cpu = outcome.wall, outcome.cpu
                try:
                    answer = json.loads((folder / "result.json").read_text(encoding="utf-8"))
                    result.startup = outcome.wall - float(answer["loop"])
                    result.errors = _errors(job, mesh, answer["pressures"])
                except (OSError, ValueError, KeyError) as error:
                    result.message = f"unreadable result: {error}"
                    return result
    complete = len(result.errors) == len(TIME_FACTORS) and math.isfinite(result.error)
    result.state = DONE if complete else FAILED
    result.message = "" if complete else "no finite error at every T"
    result.repeats = repeat
    return result


def _errors(job: KratosJob, mesh: Mesh, pressures: dict[str, list[float]]) -> dict[str, float]:
    """Relative L2 errors of the pressure over T."""
    errors = {}
    for text, nodal in pressures.items():
        time = float(text)
        factor = job.problem.solution.time_factor(time)
        errors[factor] = error_of(job.problem, mesh, np.array(nodal), time)
    return errors_at(errors)


def _version(python: str) -> str:
    outcome = run([python, str(DRIVER), "--version"], Path.cwd(), 60.0)
    found = re.search(r"version: (\d+)\.(\d+)\D*(\d*)", outcome.output)
    if outcome.status != 0 or found is None:
        raise DosuiPostError(f"{python} has no Kratos (--kratos)")
    return "Kratos GeoMechanics " + ".".join(part for part in found.groups() if part)


def _key(job: KratosJob, version: str) -> str:
    driver = DRIVER.read_text(encoding="utf-8")
    whole = "\n".join([version, driver, job.case()])
    return hashlib.sha256(whole.encode()).hexdigest()[:16]

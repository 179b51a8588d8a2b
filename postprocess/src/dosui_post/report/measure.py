"""Measures one job, or finds it among the finished ones."""

from __future__ import annotations

import hashlib
import math
import re
import tempfile
from datetime import date
from pathlib import Path

from dosui_post.errors import DosuiPostError
from dosui_post.report.machine import Program
from dosui_post.report.matrix import Job
from dosui_post.report.process import Outcome, run
from dosui_post.report.scenes import TIME_FACTORS
from dosui_post.report.store import DONE, ESTIMATED, FAILED, REFUSED, TIMEOUT, Run
from dosui_post.result import Result
from dosui_post.verify import verify

_BAD_INPUT = 2  # exit status of dosui


def key_of(job: Job, program: Program) -> str:
    """Hash of the scene's text, the program and the ranks."""
    whole = "\n".join([job.text(), program.identity, str(job.ranks)])
    return hashlib.sha256(whole.encode()).hexdigest()[:16]


def is_finished(found: Run | None, repeat: int, limit: float) -> bool:
    """Tells whether a stored run need not be made again."""
    if found is None or found.state == FAILED:
        return False
    if found.state == TIMEOUT:
        return found.wall >= limit
    return found.state != DONE or found.repeats >= repeat


def measure(job: Job, program: Program, repeat: int, limit: float) -> Run:
    """Checks the scene, runs it `repeat` times, keeps the fastest."""
    result = _empty(job, program)
    with tempfile.TemporaryDirectory(prefix="dosui_report_") as name:
        folder = Path(name)
        (folder / "scene.nml").write_text(job.text(), encoding="utf-8")
        check = run(program.command(1, "--check", "scene.nml"), folder, limit)
        if check.status != 0:
            return _unsuccessful(result, check)
        result.startup = check.wall
        result.particles = _particles(check.output, job)
        if job.is_estimate:
            return _estimate(result, check.output)
        for _ in range(repeat):
            outcome = run(program.command(job.ranks, "scene.nml", "--output", "."), folder, limit)
            if outcome.status != 0:
                return _unsuccessful(result, outcome)
            if result.state != DONE or outcome.wall < result.wall:
                _take(result, outcome, folder / "result.vtkhdf")
            if result.state == FAILED:
                break
        result.repeats = repeat
    return result


# ---------------------------------------------------------------------- inside


def _empty(job: Job, program: Program) -> Run:
    return Run(
        key=key_of(job, program),
        scene=job.problem.name,
        method=job.method.name,
        spacing=job.spacing,
        control=job.control,
        ranks=job.ranks,
        state=FAILED,
        when=date.today().isoformat(),
        program=program.version.splitlines()[0],
    )


def _take(result: Run, outcome: Outcome, path: Path) -> None:
    steps = re.search(r"after (\d+) steps", outcome.output)
    if steps is None:
        result.message = "the program does not say how many steps it took"
        return
    try:
        with Result(path) as file:
            errors = verify(file).steps
            result.particles = len(file.points(-1))
    except DosuiPostError as error:
        result.message = str(error).replace(f"{path.parent}/", "")
        return
    result.errors = errors_at({step.time_factor: step.error for step in errors})
    if len(result.errors) < len(TIME_FACTORS) or not math.isfinite(result.error):
        result.message = "no finite error at every T"
        return
    result.state, result.message = DONE, ""
    result.steps, result.wall, result.cpu = float(steps[1]), outcome.wall, outcome.cpu


def errors_at(errors: dict[float, float]) -> dict[str, float]:
    """Of all outputs those at the report's time factors."""
    return {
        f"{wanted:g}": error
        for wanted in TIME_FACTORS
        for factor, error in errors.items()
        if math.isclose(factor, wanted, rel_tol=1.0e-3)
    }


def _estimate(result: Run, output: str) -> Run:
    steps = re.search(r"about ([\d.eE+]+) steps", output)
    if steps is None:
        result.message = "the program estimates no steps"
        return result
    result.state, result.steps = ESTIMATED, float(steps[1])
    return result


def _particles(output: str, job: Job) -> int:
    found = re.search(r"^particles +(\d+)", output, re.MULTILINE)
    return int(found[1]) if found else job.problem.particles(job.spacing)


def _unsuccessful(result: Run, outcome: Outcome) -> Run:
    result.wall, result.cpu = outcome.wall, outcome.cpu
    if outcome.status is None:
        result.state, result.message = TIMEOUT, f"longer than {outcome.wall:.0f} s"
        return result
    result.state = REFUSED if outcome.status == _BAD_INPUT else FAILED
    result.message = re.sub(r"^\S*scene\.nml(:\d+)?: ", "", outcome.last_words())
    return result

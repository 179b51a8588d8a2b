"""Runs a case with a method and judges what came of it."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from dosui_post.errors import DosuiPostError
from dosui_post.report.machine import Program
from dosui_post.report.process import Outcome, run
from dosui_post.result import Result
from dosui_post.stability.case import (
    FAILED,
    HELD,
    NOT_MEANT,
    REFUSED,
    SLOW,
    STOPPED,
    Case,
    Evidence,
    Method,
    Verdict,
)

_BAD_INPUT = 2  # exit status of dosui
_RESULT = "result.vtkhdf"
_MOST_STEPS = 1.0e7


def judge(case: Case, method: Method, program: Program) -> Verdict:
    """The verdict on a case; programs that take too long are ended."""
    text = case.scene(method)
    if text is None:
        return Verdict(case.name, method.name, NOT_MEANT)
    with tempfile.TemporaryDirectory(prefix="dosui_stability_") as name:
        folder = Path(name)
        steps = 0.0
        if method.has_inertia:
            steps = _expected_steps(text, folder, program, case.limit)
        if steps > _MOST_STEPS:
            return Verdict(case.name, method.name, SLOW, (), f"about {steps:.0e} steps, not run")
        outcome = _compute(text, case.ranks, folder / "run", program, case.limit)
        if outcome.status != 0:
            return _without_result(case, method, outcome)
        serial = None
        if case.ranks > 1:
            alone = _compute(text, 1, folder / "serial", program, case.limit)
            if alone.status != 0:
                return _without_result(case, method, alone)
            serial = folder / "serial" / _RESULT
        return _judged(case, method, folder / "run" / _RESULT, serial, outcome.wall)


# ---------------------------------------------------------------------- inside


def _expected_steps(text: str, folder: Path, program: Program, limit: float) -> float:
    """What --check says of steps whose length stability limits; 0 if it does not."""
    (folder / "check.nml").write_text(text, encoding="utf-8")
    checked = run(program.command(1, "--check", "check.nml"), folder, limit)
    found = re.search(r"^time step .*; about (\d+) steps", checked.output, re.MULTILINE)
    return float(found[1]) if found else 0.0


def _compute(text: str, ranks: int, folder: Path, program: Program, limit: float) -> Outcome:
    folder.mkdir()
    (folder / "scene.nml").write_text(text, encoding="utf-8")
    return run(program.command(ranks, "scene.nml", "--output", "."), folder, limit)


def _judged(case: Case, method: Method, path: Path, serial: Path | None, wall: float) -> Verdict:
    try:
        with Result(path) as result:
            if serial is None:
                found = tuple(case.check(Evidence(result)))
            else:
                with Result(serial) as other:
                    found = tuple(case.check(Evidence(result, other)))
    except DosuiPostError as error:
        return Verdict(case.name, method.name, FAILED, (), str(error), wall)
    state = HELD if all(quantity.holds for quantity in found) else FAILED
    return Verdict(case.name, method.name, state, found, "", wall)


def _without_result(case: Case, method: Method, outcome: Outcome) -> Verdict:
    if outcome.status is None:
        message = f"longer than {case.limit:.0f} s"
        return Verdict(case.name, method.name, SLOW, (), message, outcome.wall)
    state = REFUSED if outcome.status == _BAD_INPUT else STOPPED
    lines = outcome.complaint.splitlines()
    message = next((line for line in lines if line.startswith("error: ")), outcome.last_words())
    message = re.sub(r"^(error: )?(\S*scene\.nml(:\d+)?: )?", "", message)
    return Verdict(case.name, method.name, state, (), message, outcome.wall)

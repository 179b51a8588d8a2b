"""The default methods hold every hard case; the record in docs/stability.md is of this program.

The limits are those of dosui_post.stability; `dosui-post report stability` writes the whole
record, with the published two-pass recipe and the cases that take longer than a test may.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from dosui_post.report.machine import Program, program_at
from dosui_post.stability.case import HELD, METHODS, NOT_MEANT, REFUSED, SLOW, Case, Method
from dosui_post.stability.cases import CASES
from dosui_post.stability.judge import judge

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(os.environ.get("DOSUI_BIN", ROOT / "build" / "release" / "bin"))
LONG = {  # seconds of each; in the record only
    ("rotation", "semi-implicit"),
    ("compression", "semi-implicit"),
    ("nu-0.49", "semi-implicit"),
    ("nu-0.499", "semi-implicit"),
    ("water-2.2e9", "explicit"),
    ("water-1e12", "explicit"),
    ("drawdown", "explicit"),
}

NOT_HELD = {  # all others hold
    ("contrast", "explicit"): SLOW,
    ("contrast", "semi-implicit"): SLOW,
    ("drained-step", "explicit"): SLOW,
    ("drained-step", "semi-implicit"): SLOW,
    ("drawdown", "semi-implicit"): REFUSED,
}

PAIRS = [
    pytest.param(
        case,
        method,
        id=f"{case.name}-{method.name}",
    )
    for case in CASES
    for method in METHODS[:3]
    if (case.name, method.name) not in LONG and case.scene(method) is not None
]


@pytest.fixture(scope="module")
def program() -> Program:
    """dosui, asked for its version once."""
    return program_at(BIN / "dosui")


@pytest.mark.parametrize(("case", "method"), PAIRS)
def test_default_method(program: Program, case: Case, method: Method) -> None:
    """What must hold does; of the few others dosui says beforehand why not."""
    verdict = judge(case, method, program)
    wrong = [(q.name, q.value, q.limit) for q in verdict.quantities if not q.holds]
    expected = NOT_HELD.get((case.name, method.name), HELD)
    assert verdict.state == expected, (verdict.message, wrong)
    if verdict.state == SLOW:
        assert "steps, not run" in verdict.message


@pytest.mark.parametrize("name", ["plain", "jittered", "strip", "checkerboard"])
def test_two_pass_recipe_is_no_default(program: Program, name: str) -> None:
    """What the record says against the published recipe: a check that cannot fail would hold."""
    case = next(case for case in CASES if case.name == name)
    verdict = judge(case, METHODS[3], program)
    assert verdict.state not in (HELD, NOT_MEANT)


def test_record_is_complete() -> None:
    """The page tells of every case."""
    page = (ROOT / "docs" / "stability.md").read_text(encoding="utf-8")
    assert all(f"| {case.title} |" in page for case in CASES)
    assert all(f" {method.name} |" in page for method in METHODS)

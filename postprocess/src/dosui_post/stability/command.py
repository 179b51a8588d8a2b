"""The command `dosui-post report stability`."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

from dosui_post.errors import DosuiPostError
from dosui_post.report.machine import find_program, program_at, this_machine
from dosui_post.stability.case import FAILED, METHODS, NOT_MEANT, STOPPED, Verdict
from dosui_post.stability.cases import CASES
from dosui_post.stability.figure import draw
from dosui_post.stability.judge import judge
from dosui_post.stability.page import figure_of, write_page

PAGE_NAME = "stability.md"


@dataclass
class Request:
    """What the command line asks for."""

    output: Path
    program: Path | None = None
    only: str = ""
    mpirun: tuple[str, ...] = ("mpirun",)
    page: Path | None = None
    command: str = "dosui-post report stability"
    """for the page"""


def record(request: Request) -> int:
    """Runs every case with every method and writes the page, the picture and verdicts.json."""
    cases = [case for case in CASES if re.search(request.only, case.name)]
    if not cases:
        raise DosuiPostError(f"no case is called '{request.only}' (--only)")
    program = program_at(find_program(request.program), request.mpirun)
    print(program.version.splitlines()[0], flush=True)
    verdicts: list[Verdict] = []
    for case in cases:
        for method in METHODS:
            verdict = judge(case, method, program)
            verdicts.append(verdict)
            if verdict.state != NOT_MEANT:
                print(_line(verdict), flush=True)
    page = request.page or request.output / PAGE_NAME
    picture = page.parent / "images" / "stability.png"
    version = program.version.splitlines()[0]
    draw(cases, verdicts, picture, f"Worst quantity of each run over its limit. {version}")
    machine, day = this_machine(), date.today().isoformat()
    write_page(page, cases, verdicts, machine, program.version, picture, day, request.command)
    request.output.mkdir(parents=True, exist_ok=True)
    table = request.output / "verdicts.json"
    text = json.dumps([asdict(verdict) for verdict in verdicts], indent=1, allow_nan=True)
    table.write_text(text + "\n", encoding="utf-8")
    for path in (table, picture, page):
        print(path)
    return 0


def _line(verdict: Verdict) -> str:
    worst = verdict.worst
    said = verdict.message
    if worst is not None:
        said = f"{worst.name} {figure_of(worst)} (limit {worst.limit:g})"
    mark = "  <--" if verdict.state in (FAILED, STOPPED) else ""
    return (
        f"{verdict.case}, {verdict.method}: {verdict.state} in {verdict.wall:.1f} s; {said}{mark}"
    )

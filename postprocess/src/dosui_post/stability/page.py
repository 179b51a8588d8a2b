"""The record in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dosui_post.report.machine import Machine
from dosui_post.report.tables import item
from dosui_post.stability.case import (
    FAILED,
    HELD,
    METHODS,
    NOT_MEANT,
    REFUSED,
    SLOW,
    STOPPED,
    Case,
    Quantity,
    Verdict,
)

_PAGE = """<!-- Written by `dosui-post report stability`: do not edit. -->

# Stability on hard cases

Measured on {date} ({cpu}) with

    {version}

Each case is run with its scene written for four methods: the default method (compact operator,
means over cells, APIC) with each of the three integrators, and for contrast the published
*two-pass* recipe (two first derivatives, FLIP, no means over cells, explicit). Every run must end
by itself and keep what the second column promises; the number is the quantity nearest to its
limit. **Bold** is a failure. *refused*: dosui says why it does not take the scene; *stopped*: it
ended with an error; *too slow*: longer than the case's limit of wall time; –: the method has no
meaning there (no inertia, no motion).

{summary}

![Stability]({picture})

{table}

## What did not hold, and why it was refused

{failures}

## All quantities

{details}

## The cases

Soil, if nothing else is said: E = 1 MPa, ν = 0.2, n = 0.3, k = 1e-4 m/s, K_w = 3 MPa, four
particles a cell, columns of 0.25 m x 1 m with spacings of 0.05 m, load 1 kPa; errors are relative
L2 errors of the pore pressure against the exact solution, the largest at T = 0.05, 0.1 and 0.2.
Motions (translation, rotation, collision, thrown particle, compression, slide) are `updated`
scenes with GIMP functions; quasi-static compression has `finite` strains. The namelists are in
[`scenes.py`](../postprocess/src/dosui_post/stability/scenes.py), the limits in
[`checks.py`](../postprocess/src/dosui_post/stability/checks.py).

## Again

    {command}
"""


def write_page(
    path: Path,
    cases: Sequence[Case],
    verdicts: Sequence[Verdict],
    machine: Machine,
    version: str,
    picture: Path,
    date: str,
    command: str,
) -> Path:
    """Writes the page; the picture lies below its folder."""
    found = {(verdict.case, verdict.method): verdict for verdict in verdicts}
    text = _PAGE.format(
        date=date,
        cpu=machine.cpu,
        version="\n    ".join(version.splitlines()),
        summary=_summary(verdicts),
        picture=picture.relative_to(path.parent).as_posix(),
        table=_table(cases, found),
        failures=_failures(cases, found),
        details=_details(cases, found),
        command=command,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def figure_of(quantity: Quantity) -> str:
    """A value for people."""
    return f"{quantity.value:.2g}".replace("e-0", "e-").replace("e+0", "e+")


# ---------------------------------------------------------------------- inside


def _summary(verdicts: Sequence[Verdict]) -> str:
    rows = ["| method | held | failed or stopped | too slow | refused |", "|---|---|---|---|---|"]
    for method in METHODS:
        own = [v.state for v in verdicts if v.method == method.name and v.state != NOT_MEANT]
        broken = own.count(FAILED) + own.count(STOPPED)
        rows.append(
            f"| {method.name} | {own.count(HELD)} of {len(own)} | {broken} | {own.count(SLOW)}"
            f" | {own.count(REFUSED)} |"
        )
    return "\n".join(rows)


def _table(cases: Sequence[Case], found: dict[tuple[str, str], Verdict]) -> str:
    names = [method.name for method in METHODS]
    rows = [
        "| case | must hold | " + " | ".join(names) + " |",
        "|---|---|" + "---|" * len(names),
    ]
    for case in cases:
        cells = [_cell(found.get((case.name, name))) for name in names]
        rows.append(f"| {case.title} | {case.must} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _cell(verdict: Verdict | None) -> str:
    if verdict is None or verdict.state == NOT_MEANT:
        return "–"
    worst = verdict.worst
    if worst is None:
        return f"**{verdict.state}**" if verdict.state == STOPPED else f"*{verdict.state}*"
    text = figure_of(worst)
    return text if verdict.state == HELD else f"**{text}**"


def _failures(cases: Sequence[Case], found: dict[tuple[str, str], Verdict]) -> str:
    rows = []
    for case in cases:
        for method in METHODS:
            verdict = found.get((case.name, method.name))
            if verdict is None or verdict.state in (HELD, NOT_MEANT):
                continue
            wrong = [
                f"{q.name} {figure_of(q)} (limit {q.limit:g})"
                for q in verdict.quantities
                if not q.holds
            ]
            reason = verdict.message or "; ".join(wrong)
            rows.append(item(f"{case.title}, {method.name}: {verdict.state}; {reason}"))
    return "\n".join(rows) if rows else "Nothing."


def _details(cases: Sequence[Case], found: dict[tuple[str, str], Verdict]) -> str:
    rows = ["| case | quantity | limit | " + " | ".join(m.name for m in METHODS) + " |"]
    rows.append("|---|---|---|" + "---|" * len(METHODS))
    for case in cases:
        own = [found.get((case.name, method.name)) for method in METHODS]
        names = {q.name: q.limit for v in own if v is not None for q in v.quantities}
        for name, limit in names.items():
            cells = []
            for verdict in own:
                values = [q for q in verdict.quantities if q.name == name] if verdict else []
                cells.append(figure_of(values[0]) if values else "–")
            rows.append(f"| {case.title} | {name} | {limit:g} | " + " | ".join(cells) + " |")
    return "\n".join(rows)

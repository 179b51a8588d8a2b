"""The page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dosui_post.report.kratos import METHOD as KRATOS
from dosui_post.report.machine import Machine
from dosui_post.report.ogs import METHOD as OGS
from dosui_post.report.store import DONE, Run
from dosui_post.report.tables import (
    FULL_HEAD,
    efficiency_rows,
    full_rows,
    item,
    markdown,
    refusals,
)

_PAGE = """<!-- Written by `dosui-post report`: do not edit. -->

# Speed and error

Measured on {date}: {cpu}, {cores} cores, {memory:.0f} GB, {system};
{stream}. Load of the machine before the runs: {load:.1f}. {repeats}

    {version}

Every run is a process of its own; its wall time contains the start (column *start*: the same
process with `--check`) and the files. The error is the relative L2 error of the pore pressure over
the particles, the largest at T = 0.05, 0.1, 0.2 and 0.5. *Soft water* has K_w = 3 MPa, so that the
explicit integrator can be afforded; *pure water* has K_w = 2.2 GPa and k = 1e-7 m/s, and explicit
runs are only estimated: steps by `dosui --check`, time from the run with soft water whose steps
cost the same, without its start. The exact solutions contain the water's compressibility. Methods:
*explicit* has the compact operator, *two-pass* is the published MLS-SPH recipe with FLIP, *scaled
inertia* a density scaling with which a wave of the skeleton crosses the body in 1 % of the run,
*1-D* the column as what it is; the other programs' columns are one element wide.

## Efficiency

Wall time of the fastest measured run that reaches the error. Errors in space and time may cancel
in a coarse run: the table of all runs shows where a smaller step makes the error larger.

{efficiency}

{pictures}

Lines join the runs that no other one of their method beats; faint marks are the others. Errors
above 100 % are not drawn.
{refused}
## All runs

{full}

{others}
## Again

    {command}

A run that is finished is not made again: an interrupted report goes on where it was.
"""

_OGS = f"""*{OGS}* ({{versions}}): quadratic displacements, linear pressures on squares of
the width dx, backward Euler with fixed steps that grow until T = 0.05, direct solver, its pressures
compared in the middle of the elements; *particles* counts nodes. Its column is one element wide,
that of dosui 0.25 m. Its own step control and other elements may do better. Mandel's rigid plate
moves as in the exact solution: it has no condition that ties displacements together.
"""

_KRATOS = f"""*{KRATOS}* ({{versions}}): the same elements and steps, Newmark's scheme
with θ = 0.5, direct solver, one thread; *start* is what its process needs outside the loop over
the steps.
"""


def write_page(
    path: Path,
    runs: Sequence[Run],
    machine: Machine,
    version: str,
    pictures: Sequence[Path],
    command: str,
) -> Path:
    """Writes the page; pictures lie below its folder."""
    reasons = "\n".join(item(f"{who}: {why}") for who, why in refusals(runs))
    most = max((run.repeats for run in runs if run.state == DONE), default=1)
    text = _PAGE.format(
        date=_dates(runs),
        cpu=machine.cpu,
        cores=machine.cores,
        memory=machine.memory,
        system=machine.system,
        stream=machine.bandwidth(),
        load=machine.load,
        repeats=f"Each run is the fastest of {most}." if most > 1 else "Each run was made once.",
        version="\n    ".join(version.splitlines()),
        efficiency=markdown(["scene", "method", "to 1 %", "to 0.1 %"], efficiency_rows(runs)),
        pictures="\n\n".join(
            f"![{picture.stem.replace('-', ' ')}]({picture.relative_to(path.parent).as_posix()})"
            for picture in pictures
        ),
        refused=f"\nNot measured:\n\n{reasons}\n" if reasons else "",
        full=markdown(FULL_HEAD, full_rows(runs)),
        others=_others(runs),
        command=command,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def _others(runs: Sequence[Run]) -> str:
    texts = []
    for method, text in ((OGS, _OGS), (KRATOS, _KRATOS)):
        versions = sorted({run.program for run in runs if run.method == method})
        if versions:
            texts.append(text.format(versions=", ".join(versions)))
    return "\n".join(texts)


def _dates(runs: Sequence[Run]) -> str:
    days = sorted({run.when for run in runs if run.when})
    if not days:
        return "no day"
    return days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"

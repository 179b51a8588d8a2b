"""The command `dosui-post report`."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from dosui_post.errors import DosuiPostError
from dosui_post.report.figure import draw
from dosui_post.report.kratos import measure_all as measure_kratos
from dosui_post.report.machine import (
    Machine,
    Program,
    find_program,
    program_at,
    stream_bandwidth,
    this_machine,
)
from dosui_post.report.matrix import Job, full_matrix, quick_matrix, selected
from dosui_post.report.measure import is_finished, key_of, measure
from dosui_post.report.ogs import measure_all as measure_ogs
from dosui_post.report.page import write_page
from dosui_post.report.store import DONE, ESTIMATED, Run, Store
from dosui_post.report.tables import write_csv

INTERRUPTED = 3
"""Exit status, as that of dosui."""

PAGE_NAME = "speed-and-error.md"


@dataclass
class Request:
    """What the command line asks for."""

    output: Path
    program: Path | None = None
    is_quick: bool = False
    only: str = ""
    repeat: int = 1
    limit: float = 3600.0
    """of one run [s]"""
    mpirun: tuple[str, ...] = ("mpirun",)
    page: Path | None = None
    ogs: str | None = None
    """OpenGeoSys, if it is to be compared"""
    kratos: str | None = None
    """an interpreter with Kratos, if that is to be compared"""
    command: str = "dosui-post report"
    """for the page"""


def report(request: Request) -> int:
    """Runs what is missing, writes tables, pictures and the page; returns the exit status."""
    jobs = selected(quick_matrix() if request.is_quick else full_matrix(), request.only)
    program = program_at(find_program(request.program), request.mpirun)
    store = Store(request.output / "runs.jsonl")
    print(program.version.splitlines()[0], flush=True)
    runs: list[Run] = []
    try:
        with _terminable():
            machine = _measured_machine(request, program, jobs)
            _run_all(jobs, program, store, request, runs)
            runs += _others(request, store)
    except KeyboardInterrupt:
        print(
            f"\ninterrupted: {len(runs)} of {len(jobs)} runs are in {store.path};"
            " the same command goes on",
            flush=True,
        )
        return INTERRUPTED
    if not runs:
        raise DosuiPostError(f"no run has '{request.only}' in its label (--only)")
    for path in _write(request, runs, machine, program.version):
        print(path)
    return 0


# ---------------------------------------------------------------------- inside


def _measured_machine(request: Request, program: Program, jobs: Sequence[Job]) -> Machine:
    machine = this_machine()
    machine.stream = stream_bandwidth(program, [job.ranks for job in jobs])
    print(f"{machine.cpu}, {machine.cores} cores; {machine.bandwidth()}", flush=True)
    request.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(machine.to_dict(), indent=2)
    (request.output / "machine.json").write_text(text + "\n", encoding="utf-8")
    return machine


def _run_all(
    jobs: Sequence[Job], program: Program, store: Store, request: Request, runs: list[Run]
) -> None:
    begin = time.monotonic()
    for index, job in enumerate(jobs, start=1):
        found = store.get(key_of(job, program))
        is_old = is_finished(found, request.repeat, request.limit)
        if found is None or not is_old:
            found = measure(job, program, request.repeat, request.limit)
            store.add(found)
        runs.append(found)
        elapsed = time.monotonic() - begin
        told = _outcome(found) + (" (kept)" if is_old else "")
        _tell(f"[{index}/{len(jobs)}, {elapsed:.0f} s] {job.label}: {told}")


def _others(request: Request, store: Store) -> list[Run]:
    common = (request.is_quick, request.only, store, _tell, request.repeat, request.limit)
    return [*measure_ogs(request.ogs, *common), *measure_kratos(request.kratos, *common)]


def _outcome(run: Run) -> str:
    if run.state == DONE:
        return f"{run.wall:.2f} s, {run.steps:.0f} steps, error {run.error:.1e}"
    if run.state == ESTIMATED:
        return f"not run, about {run.steps:.3g} steps"
    return f"{run.state}: {run.message}"


def _tell(text: str) -> None:
    print(text, flush=True)


def _write(request: Request, runs: Sequence[Run], machine: Machine, version: str) -> list[Path]:
    page = request.page or request.output / PAGE_NAME
    table = request.output / "runs.csv"
    write_csv(table, runs)
    details = f"{machine.cpu}, {machine.cores} cores; {machine.bandwidth()}"
    quantities: list[tuple[str, str, Callable[[Run], float]]] = [
        ("speed-and-error-time", "wall time  [s]", lambda run: run.wall),
        ("speed-and-error-work", "particle-steps  [–]", lambda run: run.particle_steps),
    ]
    pictures = [
        draw(runs, page.parent / "images" / f"{name}.png", quantity, label, details)
        for name, label, quantity in quantities
    ]
    write_page(page, runs, machine, version, pictures, request.command)
    return [table, *pictures, page]


@contextmanager
def _terminable() -> Iterator[None]:
    """SIGTERM counts as Ctrl-C, so that a job's end leaves no process behind."""

    def stop(_sign: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    try:
        old = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, old)
        sys.stdout.flush()

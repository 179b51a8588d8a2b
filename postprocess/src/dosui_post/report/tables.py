"""Tables of the runs: efficiency, everything, CSV."""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Sequence
from pathlib import Path

from dosui_post.report.matrix import METHODS
from dosui_post.report.scenes import PROBLEMS, TIME_FACTORS
from dosui_post.report.store import DONE, ESTIMATED, FAILED, REFUSED, TIMEOUT, Run
from dosui_post.units import number

LEVELS = (1.0e-2, 1.0e-3)
"""Errors to be reached."""


def scenes_of(runs: Sequence[Run]) -> list[str]:
    """Names of the scenes, in the order of the matrix."""
    return [name for name in PROBLEMS if any(run.scene == name for run in runs)]


def methods_of(runs: Sequence[Run]) -> list[str]:
    """Names of the methods, dosui's first."""
    own = [method.name for method in METHODS]
    found = list(dict.fromkeys(run.method for run in runs))
    return [name for name in own if name in found] + [name for name in found if name not in own]


def of(runs: Sequence[Run], scene: str, method: str) -> list[Run]:
    """Runs of a scene and a method."""
    return [run for run in runs if run.scene == scene and run.method == method]


def first_to_reach(runs: Sequence[Run], level: float) -> Run | None:
    """The fastest measured run whose error is at most `level`."""
    good = [run for run in runs if run.is_measured and run.error <= level]
    return min(good, key=lambda run: run.wall, default=None)


def efficiency_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Scene, method and the time to each level."""
    rows = []
    for scene in scenes_of(runs):
        for method in methods_of(runs):
            own = of(runs, scene, method)
            if own:
                title = PROBLEMS[scene].title
                rows.append([title, method, *(_time_to(own, level, runs) for level in LEVELS)])
    return rows


def _time_to(own: Sequence[Run], level: float, runs: Sequence[Run]) -> str:
    best = first_to_reach(own, level)
    if best is not None:
        return f"**{seconds(best.wall)}** ({settings(best)})"
    measured = [run for run in own if run.is_measured]
    if measured:
        smallest = min(run.error for run in measured)
        return f"not reached (best {percent(smallest)})"
    estimated = [run for run in own if run.state == ESTIMATED]
    if estimated:
        return _estimate_to(estimated, level, runs)
    for state, text in ((REFUSED, "refused"), (TIMEOUT, "too long"), (FAILED, "failed")):
        if any(run.state == state for run in own):
            return text
    return "not run"


def _estimate_to(estimated: Sequence[Run], level: float, runs: Sequence[Run]) -> str:
    """From the run with soft water that reaches the level, and the steps of --check."""
    best: tuple[float, Run] | None = None
    for run in estimated:
        twin = soft_twin(run, runs)
        if twin is not None and twin.error <= level:
            wall = (twin.wall - twin.startup) * run.steps / twin.steps
            if best is None or wall < best[0]:
                best = wall, run
    if best is None:
        steps = min(run.steps for run in estimated)
        return f"not run (at least {number(float(f'{steps:.1e}'))} steps)"
    wall, run = best
    steps_text = number(float(f"{run.steps:.1e}"))
    return f"not run: estimated {seconds(wall)} (dx = {run.spacing:g} m, {steps_text} steps)"


def soft_twin(run: Run, runs: Sequence[Run]) -> Run | None:
    """The same measured run with soft water, whose steps cost the same."""
    scene = run.scene.removesuffix("-stiff")
    twins = [
        other
        for other in of(runs, scene, run.method)
        if other.is_measured
        and (other.spacing, other.control, other.ranks) == (run.spacing, run.control, run.ranks)
    ]
    return twins[0] if twins else None


FULL_HEAD = (
    "scene",
    "method",
    "dx [m]",
    "control",
    "ranks",
    "particles",
    "steps",
    "wall [s]",
    "cpu [s]",
    "start [s]",
    "largest error",
    *(f"T = {factor:g}" for factor in TIME_FACTORS),
)


def full_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Every run, by scene, method and spacing."""
    return [_full_row(run) for run in ordered(runs)]


def ordered(runs: Sequence[Run]) -> list[Run]:
    """By scene, method, spacing from coarse to fine, ranks, control."""
    scenes, methods = scenes_of(runs), methods_of(runs)
    return sorted(
        runs,
        key=lambda run: (
            scenes.index(run.scene),
            methods.index(run.method),
            -run.spacing,
            run.ranks,
            run.control,
        ),
    )


def _full_row(run: Run) -> list[str]:
    row = [run.scene, run.method, f"{run.spacing:g}", short(run.control), str(run.ranks)]
    row.append(str(run.particles) if run.particles else "-")
    if run.state == DONE:
        times = [f"{run.wall:.3g}", f"{run.cpu:.3g}"]
        times.append(f"{run.startup:.2g}" if run.startup > 0 else "-")
        errors = [f"{run.errors.get(f'{t:g}', float('nan')):.1e}" for t in TIME_FACTORS]
        return [*row, f"{run.steps:.0f}", *times, f"{run.error:.1e}", *errors]
    steps = number(float(f"{run.steps:.1e}"))
    said = f"about {steps}" if run.state == ESTIMATED else run.state
    return [*row, said, *["-"] * (len(FULL_HEAD) - len(row) - 1)]


def refusals(runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Methods with their scenes, and why they were not measured."""
    scenes: dict[tuple[str, str, str], list[str]] = {}
    for run in ordered(runs):
        if run.state in (REFUSED, FAILED, TIMEOUT):
            titles = scenes.setdefault((run.method, run.state, run.message), [])
            if PROBLEMS[run.scene].title not in titles:
                titles.append(PROBLEMS[run.scene].title)
    return [
        (f"{method} ({'; '.join(titles)})", f"{state}: {message}")
        for (method, state, message), titles in scenes.items()
    ]


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in lines
    )


def item(text: str) -> str:
    """An item of a list, in lines of a page's width."""
    return textwrap.fill(
        f"- {text}", 120, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


_CSV_HEAD = (
    "scene",
    "method",
    "spacing_m",
    "control",
    "ranks",
    "state",
    "message",
    "particles",
    "steps",
    "particle_steps",
    "wall_s",
    "cpu_s",
    "startup_s",
    "largest_error",
)


def write_csv(path: Path, runs: Sequence[Run]) -> None:
    """Every run with all that is known of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(
            list(_CSV_HEAD)
            + [f"error_T_{factor:g}" for factor in TIME_FACTORS]
            + ["repeats", "date", "program"]
        )
        for run in ordered(runs):
            errors = [run.errors.get(f"{factor:g}", "") for factor in TIME_FACTORS]
            out.writerow(
                [
                    run.scene,
                    run.method,
                    run.spacing,
                    run.control,
                    run.ranks,
                    run.state,
                    run.message,
                    run.particles,
                    f"{run.steps:.0f}",
                    f"{run.particle_steps:.0f}",
                    f"{run.wall:.4f}",
                    f"{run.cpu:.4f}",
                    f"{run.startup:.4f}",
                    f"{run.error:.6e}" if run.errors else "",
                    *errors,
                    run.repeats,
                    run.when,
                    run.program,
                ]
            )


# ---------------------------------------------------------------------- texts


def seconds(value: float) -> str:
    """A time for people."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if value >= 2 * size:
            return f"{value / size:.2g} {unit}"
    return f"{value:.2g} s" if value < 10 else f"{value:.0f} s"


def percent(value: float) -> str:
    """An error for people."""
    return f"{100 * value:.3g} %" if value < 1 else f"{100 * value:.0f} %"


def short(control: str) -> str:
    """Control of the step, as short as it can be understood."""
    return control.replace("relative_tolerance", "rtol").replace(" = ", " ")


def settings(run: Run) -> str:
    """Spacing, control, ranks and steps of a run."""
    steps = f"{run.steps:.0f} steps"
    parts = [f"dx = {run.spacing:g} m"]
    if run.control != steps:
        parts.append(short(run.control))
    if run.ranks > 1:
        parts.append(f"{run.ranks} ranks")
    return ", ".join([*parts, steps])

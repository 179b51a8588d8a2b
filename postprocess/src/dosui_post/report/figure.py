"""Work-precision pictures: one panel for each scene, one line for each method."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from dosui_post.report.scenes import PROBLEMS
from dosui_post.report.store import ESTIMATED, Run
from dosui_post.report.tables import LEVELS, methods_of, of, percent, scenes_of
from dosui_post.style import COLOURS, MUTED, caption, house_style, save
from dosui_post.units import number

_MARKERS = "osD^vphX*"
_LINES = (*COLOURS, "#7F7F7F", "#8C510A")  # nine methods
_DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), "-")
_PANEL = (3.7, 3.0)  # inch
_MOST_COLUMNS = 2
_LARGEST_ERROR = 1.0  # drawn
_LEGEND_LINE = 0.24  # inch
_HEAD = 1.0  # inch, for title, caption and legend


def draw(
    runs: Sequence[Run], output: Path, quantity: Callable[[Run], float], label: str, details: str
) -> Path:
    """`quantity` over the largest error, log-log."""
    runs = [run for run in runs if not run.is_measured or run.error <= _LARGEST_ERROR]
    scenes = [s for s in scenes_of(runs) if any(r.scene == s and r.is_measured for r in runs)]
    columns = min(_MOST_COLUMNS, max(1, len(scenes)))
    rows = max(1, -(-len(scenes) // columns))
    with house_style():
        mpl.rcParams["savefig.dpi"] = 120
        size = (max(5.0, _PANEL[0] * columns), _PANEL[1] * rows + _HEAD)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True).flat
        methods = methods_of([run for run in runs if run.is_measured])
        styles = {name: _style(index) for index, name in enumerate(methods)}
        for axes, scene in zip(panels, scenes, strict=False):
            _panel(axes, runs, scene, quantity, styles)
        for axes in list(panels)[len(scenes) :]:
            axes.set_visible(False)
        _label(figure, columns, len(scenes), label)
        handles = [Line2D([], [], label=name, **styles[name]) for name in methods]
        figure.legend(handles=handles, loc="lower center", ncols=3)
        caption(figure, f"{label.split('  ')[0].capitalize()} over error", details)
        engine = figure.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):
            left, bottom, width, height = engine.get()["rect"]
            legend = _LEGEND_LINE * -(-len(handles) // 3) / size[1]
            engine.set(rect=(left, bottom + legend, width, height - legend))
        return save(figure, output)


def _label(figure: Figure, columns: int, count: int, label: str) -> None:
    """Labels below the lowest panels and left of the first ones."""
    for index, axes in enumerate(figure.axes[:count]):
        if index + columns >= count:
            axes.set_xlabel("largest relative L2 error of the pressure  [–]")
        if index % columns == 0:
            axes.set_ylabel(label)


def efficient(runs: Sequence[Run], quantity: Callable[[Run], float]) -> list[Run]:
    """The measured runs that no other one beats in error and quantity, from large errors on."""
    front: list[Run] = []
    for run in sorted(runs, key=lambda run: (quantity(run), run.error)):
        if run.is_measured and (not front or run.error < front[-1].error):
            front.append(run)
    return front


def _style(index: int) -> dict[str, Any]:
    return {
        "color": _LINES[index % len(_LINES)],
        "marker": _MARKERS[index % len(_MARKERS)],
        "linestyle": _DASHES[index % len(_DASHES)],
        "markersize": 5.5,
        "linewidth": 1.4,
        "markeredgecolor": "white",
        "markeredgewidth": 0.5,
    }


def _panel(
    axes: Axes,
    runs: Sequence[Run],
    scene: str,
    quantity: Callable[[Run], float],
    styles: dict[str, dict[str, Any]],
) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    for method, style in styles.items():
        own = [run for run in of(runs, scene, method) if run.is_measured]
        dots = {**style, "linestyle": "none", "markersize": 3.5, "alpha": 0.45}
        axes.plot([r.error for r in own], [quantity(r) for r in own], zorder=2, **dots)
        best = efficient(own, quantity)
        axes.plot([r.error for r in best], [quantity(r) for r in best], zorder=3, **style)
    for level in LEVELS:
        axes.axvline(level, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        axes.annotate(
            percent(level),
            (level, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, -2),
            textcoords="offset points",
            fontsize=7.5,
            color=MUTED,
            va="top",
        )
    axes.set_title(PROBLEMS[scene].title, fontsize=9.5, loc="left")
    axes.tick_params(which="both", labelbottom=True)
    axes.margins(0.08, 0.12)
    _decades(axes)
    _note_estimates(axes, of_state(runs, scene))


def _decades(axes: Axes) -> None:
    """Ends the vertical axis at powers of ten, so that its labels are those."""
    low, high = axes.get_ylim()
    axes.set_ylim(10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=9))
        axis.set_minor_formatter(NullFormatter())


def of_state(runs: Sequence[Run], scene: str) -> list[Run]:
    """Estimated runs of a scene."""
    return [run for run in runs if run.scene == scene and run.state == ESTIMATED]


def _note_estimates(axes: Axes, runs: Sequence[Run]) -> None:
    if not runs:
        return
    low, high = min(run.steps for run in runs), max(run.steps for run in runs)
    ends = [number(float(f"{value:.1e}")) for value in (low, high)]
    text = f"{runs[0].method}: not run,\n{ends[0]} to {ends[1]} steps"
    axes.annotate(
        text,
        (0.98, 0.9),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=7.5,
        color=MUTED,
    )

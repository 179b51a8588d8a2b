"""The common look of all figures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dosui_post.errors import DosuiPostError

# Okabe & Ito (2008): told apart with any colour vision. Yellow is too pale for lines.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
EXACT_LINE: dict[str, Any] = {"linewidth": 1.4, "solid_capstyle": "round"}
DOTS: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 4.0,
    "markeredgewidth": 0.5,
}
DOTS_EDGE = "white"
INK = "#222222"
MUTED = "#666666"

_SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "mathtext.fontset": "dejavusans",
    "font.size": 9.5,
    "axes.labelsize": 10,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "text.color": INK,
    "savefig.dpi": 200,
    "figure.dpi": 100,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Settings of every figure, without touching the caller's."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def new_figure(width: float, height: float, layout: Any = "constrained") -> tuple[Figure, Axes]:
    """A figure [inch] without a window."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def caption(figure: Figure, title: str, details: str = "") -> None:
    """A heading at the left and, smaller, the constants below it."""
    characters = int(figure.get_figwidth() * 14.5)
    lines = textwrap.wrap(details, characters, break_on_hyphens=False)
    size = 7.8 / 72 / figure.get_figheight()
    top = 1 - 0.6 * size
    figure.text(0.02, top, title, fontsize=11, fontweight="bold", va="top")
    below = top - 2.3 * size
    figure.text(0.02, below, "\n".join(lines), fontsize=7.8, color=MUTED, va="top")
    used = 1 - below + 1.35 * size * len(lines) + 1.2 * size
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0, 0, 1, 1 - used))  # type: ignore[call-arg]


def save(figure: Figure, path: Path) -> Path:
    """Writes the figure; the format follows the ending of the path."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise DosuiPostError(f"cannot write {path}: {error}") from error
    return path

"""The record as a picture: how far every case stays below its limit, or is beyond it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from dosui_post.stability.case import (
    HELD,
    METHODS,
    NOT_MEANT,
    REFUSED,
    SLOW,
    Case,
    Verdict,
)
from dosui_post.style import COLOURS, MUTED, caption, house_style, new_figure, save

_MARKERS = "osDX"
_LEAST, _LARGEST = 1.0e-6, 1.0e4  # value over limit that is drawn
_ROW = 0.22  # inch


def draw(cases: Sequence[Case], verdicts: Sequence[Verdict], output: Path, details: str) -> Path:
    """One row a case, one mark a method; the line is the limit."""
    with house_style():
        mpl.rcParams["savefig.dpi"] = 120
        figure, axes = new_figure(8.2, 1.9 + _ROW * len(cases))
        axes.set_xscale("log")
        axes.axvspan(1.0, 30 * _LARGEST, color="#D55E00", alpha=0.08, linewidth=0)
        axes.axvline(1.0, color=MUTED, linewidth=1.0)
        for index, method in enumerate(METHODS):
            places, heights = [], []
            for row, case in enumerate(cases):
                verdict = _of(verdicts, case.name, method.name)
                if verdict is None or verdict.state in (NOT_MEANT, REFUSED, SLOW):
                    continue
                places.append(_ratio(verdict))
                heights.append(row + 0.16 * (index - 1.5))
            axes.plot(
                places,
                heights,
                linestyle="none",
                marker=_MARKERS[index],
                color=COLOURS[index],
                markersize=5,
                markeredgecolor="white",
                markeredgewidth=0.4,
                label=method.name,
            )
        axes.set_yticks(range(len(cases)), [case.title for case in cases], fontsize=8)
        axes.set_ylim(len(cases) - 0.4, -0.6)
        axes.set_xlim(0.3 * _LEAST, 30 * _LARGEST)
        axes.set_xlabel("quantity over its limit  [–]   (right of the line: not held)")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=4)
        caption(figure, "Hard cases", details)
        return save(figure, output)


def _of(verdicts: Sequence[Verdict], case: str, method: str) -> Verdict | None:
    return next((v for v in verdicts if v.case == case and v.method == method), None)


def _ratio(verdict: Verdict) -> float:
    worst = verdict.worst
    if worst is None:
        return _LEAST if verdict.state == HELD else 10 * _LARGEST  # stopped with an error
    if worst.limit == 0.0:
        return _LEAST if worst.holds else 10 * _LARGEST
    ratio = abs(worst.value) / worst.limit
    if math.isnan(ratio):
        return 10 * _LARGEST
    return min(max(ratio, _LEAST), 10 * _LARGEST)

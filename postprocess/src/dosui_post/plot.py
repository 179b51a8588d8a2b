"""Figures: exact solutions as lines, dosui as dots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from dosui_post.case import (
    ColumnCase,
    ConsolidationCase,
    DrainageCase,
    MandelCase,
    RadialCase,
    consolidation_of,
    probe_column,
    settlement_history,
)
from dosui_post.errors import DosuiPostError
from dosui_post.result import FloatArray, Result, to_xyz
from dosui_post.style import (
    COLOURS,
    DOTS,
    DOTS_EDGE,
    EXACT_LINE,
    INK,
    MUTED,
    caption,
    house_style,
    new_figure,
    save,
)
from dosui_post.units import number, scale

_USUAL_TIME_FACTORS = (0.01, 0.05, 0.1, 0.2, 0.5, 1.0)
_RIGHT_END = 1.08  # of the axis of u/u0
_MOST_DOTS = 1500  # a step; more only blacken the figure
_DOTS_OF_HISTORY = 26
_NARROW = 0.9  # inch: narrower maps have ticks at their ends
_LETTER = 0.09  # inch, width of a letter of these
Box = tuple[FloatArray, FloatArray]
_VECTOR = ("x", "y", "z", "magnitude")
_STRESS = ("xx", "yy", "zz", "xy", "yz", "zx", "mean")

# ---------------------------------------------------------------------- isochrones


def isochrones(
    result: Result, output: Path, time_factors: Sequence[float] | None = None, most: int = 7
) -> Path:
    """Normalised excess pore pressure over depth at several T."""
    case = column_of(result)
    steps = _steps_of(result, case, time_factors, most)
    with house_style():
        figure, axes = new_figure(5.2, 5.6)
        draw_isochrones(axes, result, case, steps)
        caption(figure, case.title, constants_text(case, result))
        return save(figure, output)


def draw_isochrones(
    axes: Axes, result: Result, case: ColumnCase, steps: Sequence[int], with_labels: bool = True
) -> None:
    """Lines and dots of the steps; axes with labels and legend."""
    colours = _isochrone_colours(len(steps))
    depth = np.linspace(0, 1, 401)
    curves = []
    for step, colour in zip(steps, colours, strict=True):
        time = float(result.times[step])
        exact = case.solution.pressure(depth * case.length, time) / case.initial_pressure
        curves.append(exact)
        axes.plot(exact, depth, color=colour, zorder=2, **EXACT_LINE)
        u, z = _dots(result, case, step)
        axes.plot(u, z, color=colour, zorder=3, markeredgecolor=DOTS_EDGE, **DOTS)
    if with_labels:
        _label_isochrones(axes, curves, depth, colours, [_factor(result, case, s) for s in steps])
    drawn = np.concatenate([line.get_xdata(orig=False) for line in axes.get_lines()])
    drawn = drawn[np.isfinite(drawn)]
    axes.set_xlim(
        min(0.0, 1.04 * float(np.min(drawn))), max(_RIGHT_END, 1.04 * float(np.max(drawn)))
    )
    axes.set_ylim(1.0, 0.0)
    axes.margins(0)
    axes.set_xlabel("excess pore pressure  $u/u_0$  [–]")
    axes.set_ylabel("depth below the drained surface  $z/H$  [–]")
    _legend(axes, "lower left" if with_labels and _is_early(curves) else "upper right")


def column_of(result: Result) -> ColumnCase:
    """The case of a result, if it has isochrones."""
    case = consolidation_of(result)
    if not isinstance(case, ColumnCase):
        raise DosuiPostError(
            f"{result.path}: isochrones belong to 'terzaghi' and 'drainage', not to '{case.title}'"
        )
    return case


def _steps_of(
    result: Result, case: ConsolidationCase, time_factors: Sequence[float] | None, most: int
) -> list[int]:
    """Steps nearest to the wanted T, or all after t = 0; the usual T of too many."""
    after = [s for s in range(result.n_steps) if result.times[s] > 0]
    if not after:
        raise DosuiPostError(f"{result.path} has no output step after t = 0")
    if time_factors is not None:
        wanted = [result.step_near(case.solution.time(t)) for t in time_factors]
        return sorted({s for s in wanted if s in after})
    if len(after) <= most:
        return after
    nearest = {result.step_near(case.solution.time(t)) for t in _USUAL_TIME_FACTORS}
    return sorted(nearest & set(after))


def _dots(result: Result, case: ColumnCase, step: int) -> tuple[FloatArray, FloatArray]:
    """u/u_0 and depth/H of particles, thinned if there are very many."""
    depth = case.geometry.depth(result.reference_points(step)) / case.length
    pressure = result.field("pore_pressure", step) / case.initial_pressure
    # Particles of a regular row lie on top of each other: one dot for equal ones is enough.
    rounded = np.round(np.column_stack([depth, pressure]), 4)
    _, first = np.unique(rounded, axis=0, return_index=True)
    keep = first[:: max(1, -(-len(first) // _MOST_DOTS))]
    return pressure[keep], depth[keep]


def _isochrone_colours(count: int) -> list[tuple[float, ...]]:
    """From dark blue (early) to green and ochre (late), distinct in lightness too."""
    if count == 1:
        return [mpl.colors.to_rgb(COLOURS[0])]
    return [tuple(mpl.colormaps["viridis"](x)[:3]) for x in np.linspace(0.05, 0.82, count)]


def _label_isochrones(
    axes: Axes,
    curves: Sequence[FloatArray],
    depth: FloatArray,
    colours: Sequence[tuple[float, ...]],
    factors: Sequence[float],
) -> None:
    """T at the upper right of each curve, where the way to the next one is longest."""
    text_height = 18  # in intervals of the depths
    place = np.arange(int(0.14 * len(depth)), int(0.96 * len(depth)))
    for i, curve in enumerate(curves):
        room = np.minimum(0.2, _RIGHT_END - curve[place])
        for other in curves:
            gap = other[place - text_height] - curve[place]
            is_right = other[place] > curve[place] + 1.0e-9
            room = np.where(is_right, np.minimum(room, gap), room)
        # Of places with equal room the one in the middle of the steep part reads best.
        best = place[int(np.argmax(room - 1.0e-3 * np.abs(depth[place] - 0.62)))]
        axes.annotate(
            f"T = {factors[i]:.3g}" if i == 0 else f"{factors[i]:.3g}",
            (float(curve[best]), float(depth[best])),
            xytext=(4, 2),
            textcoords="offset points",
            fontsize=8.5,
            fontweight="bold",
            color=colours[i],
            zorder=4,
        )


def _is_early(curves: Sequence[FloatArray]) -> bool:
    """Tells whether the lower left corner is still empty."""
    return min(float(curve[-1]) for curve in curves) > 0.45


# ---------------------------------------------------------------------- Mandel


def mandel(results: Sequence[Result], output: Path) -> Path:
    """History of the pore pressure in the centre: Mandel's, Cryer's or de Leeuw's problem."""
    cases = [_mandel_of(result) for result in results]
    if len({case.title for case in cases}) > 1:
        raise DosuiPostError("one figure takes results of one problem")
    order = sorted(range(len(cases)), key=lambda i: cases[i].solution.soil.poisson_ratio)
    with house_style():
        figure, axes = new_figure(6.6, 4.7)
        last = max(float(_last_factor(r, c)) for r, c in zip(results, cases, strict=True))
        factors = np.geomspace(1.0e-3, 1.1 * max(last, 1.0), 220)
        top = 1.0
        lines: list[Line2D] = []
        for rank, i in enumerate(order):
            result, case = results[i], cases[i]
            colour = COLOURS[rank % len(COLOURS)]
            solution, u0 = case.solution, case.initial_pressure
            centre = np.array([float(solution.pressure(0.0, solution.time(t))) for t in factors])
            top = max(top, float(np.max(centre)) / u0)
            lines += axes.plot(
                factors,
                centre / u0,
                color=colour,
                label=f"ν = {solution.soil.poisson_ratio:g}",
                zorder=2,
                **EXACT_LINE,
            )
            times, pressure = _centre_pressure(result, case)
            t, u = _thin(times / solution.time(1.0), pressure / u0, factors[0])
            axes.plot(t, u, color=colour, zorder=3, markeredgecolor=DOTS_EDGE, **DOTS)
        axes.axhline(1, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        axes.set_xscale("log")
        axes.set_xlim(factors[0], factors[-1])
        axes.set_ylim(0, 1.06 * top + 0.04)
        _plain_log_ticks(axes)
        axes.set_xlabel("time factor  $T = c_v t/a^2$  [–]")
        axes.set_ylabel("pore pressure in the centre  $u/u_0$  [–]")
        _legend(axes, "lower left", first=lines if len(results) > 1 else [])
        heading = f"{cases[0].title}: pressure in the centre"
        caption(figure, heading, _common_constants(cases, results))
        return save(figure, output)


def _mandel_of(result: Result) -> MandelCase | RadialCase:
    case = consolidation_of(result)
    if not isinstance(case, MandelCase | RadialCase):
        raise DosuiPostError(
            f"{result.path} is no result of Mandel's, Cryer's or de Leeuw's problem: '{case.title}'"
        )
    return case


def _last_factor(result: Result, case: ConsolidationCase) -> float:
    return case.time_factor(float(result.times[-1]))


def _centre_pressure(
    result: Result, case: MandelCase | RadialCase
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and pressure [Pa]: of the point probe in the centre, else of particles near it."""
    best, nearest = None, 0.05 * case.geometry.length
    for probe in result.scene.all("probe"):
        is_pressure = probe.text("field", "") == "pore_pressure" and "position" in probe
        if probe.text("kind", "") != "point" or not is_pressure:
            continue
        position = to_xyz(probe.numbers("position"))[np.newaxis, :]
        distance = abs(float(case.abscissa(position)[0]))
        column = probe_column(result, probe)
        if column is not None and distance <= nearest:
            best, nearest = column, distance
    if best is not None and "time" in result.history_names() and len(result.history(best)) > 1:
        return result.history("time"), result.history(best)
    values = []
    for step in range(result.n_steps):
        distances = np.abs(case.abscissa(result.reference_points(step)))
        near = distances <= 1.2 * np.min(distances)
        values.append(float(np.mean(result.field("pore_pressure", step)[near])))
    return result.times, np.array(values)


# ---------------------------------------------------------------------- settlement


def settlement(results: Sequence[Result], output: Path) -> Path:
    """Settlement over the time factor."""
    cases = [consolidation_of(result) for result in results]
    if any(isinstance(case, DrainageCase) for case in cases):
        raise DosuiPostError("a rigid column does not settle")
    if any(isinstance(case, RadialCase) for case in cases):
        raise DosuiPostError("a cylinder or sphere does not settle evenly")
    if len({type(case) for case in cases}) > 1:
        raise DosuiPostError("one figure takes settlements of one kind: Terzaghi's or Mandel's")
    with house_style():
        figure, axes = new_figure(6.2, 4.4)
        curves = [_settlement(r, c) for r, c in zip(results, cases, strict=True)]
        final = max(abs(_exact_settlement(c, p, np.inf)) for c, (_, _, p) in _pairs(cases, curves))
        factor, unit = scale(final, "m")
        last = max(_last_factor(r, c) for r, c in zip(results, cases, strict=True))
        factors = np.geomspace(1.0e-3, 1.1 * max(last, 1.0), 220)
        lines: list[Line2D] = []
        for i, (case, (times, values, place)) in enumerate(_pairs(cases, curves)):
            colour = COLOURS[i % len(COLOURS)]
            times_exact = [case.solution.time(t) for t in factors]
            exact = np.array([_exact_settlement(case, place, t) for t in times_exact])
            label = _name_of(case, results[i], cases)
            lines += axes.plot(
                factors, exact * factor, color=colour, label=label, zorder=2, **EXACT_LINE
            )
            t, s = _thin(times / case.solution.time(1.0), values * factor, factors[0])
            axes.plot(t, s, color=colour, zorder=3, markeredgecolor=DOTS_EDGE, **DOTS)
        axes.set_xscale("log")
        axes.set_xlim(factors[0], factors[-1])
        axes.set_ylim(1.08 * final * factor, 0)
        _plain_log_ticks(axes)
        power = "H" if isinstance(cases[0], ColumnCase) else "a"
        axes.set_xlabel(f"time factor  $T = c_v t/{power}^2$  [–]")
        axes.set_ylabel(f"settlement  [{unit}]")
        _legend(axes, "best", first=lines if len(results) > 1 else [])
        caption(figure, f"{cases[0].title}: settlement", _common_constants(cases, results))
        return save(figure, output)


_Curve = tuple[FloatArray, FloatArray, float | None]
"""times [s], settlement [m], depth or height of the particles it is taken from [m]"""


def _pairs(
    cases: Sequence[ConsolidationCase], curves: Sequence[_Curve]
) -> list[tuple[ConsolidationCase, _Curve]]:
    return list(zip(cases, curves, strict=True))


def _settlement(result: Result, case: ConsolidationCase) -> _Curve:
    """From the probe; without one, of the particles nearest to the loaded surface."""
    history = settlement_history(result)
    if history is not None and case.settlement(1.0) is not None and len(history[0]) > 1:
        return history[0], history[1], None
    downwards = case.geometry.direction if isinstance(case, ColumnCase) else np.array([0, 0, -1.0])
    values, place = [], 0.0
    for step in range(result.n_steps):
        distance = result.reference_points(step) @ downwards
        row = distance <= np.min(distance) + 1e-6 * case.geometry.length
        values.append(float(np.mean(result.field("displacement", step)[row] @ downwards)))
        if isinstance(case, ColumnCase):
            place = float(np.min(case.geometry.depth(result.reference_points(step))))
        else:
            place = -float(np.min(distance))
    return result.times, np.array(values), place


def _exact_settlement(case: ConsolidationCase, place: float | None, time: float) -> float:
    # 50 decay times stand for infinity.
    time = min(time, case.solution.time(50.0))
    if place is None:
        exact = case.settlement(time)
        assert exact is not None
        return exact
    if isinstance(case, ColumnCase):
        return float(case.solution.displacement(place, time))
    assert isinstance(case, MandelCase)
    return case.solution.settlement(place, time)


# ---------------------------------------------------------------------- probes


def probes(result: Result, output: Path, names: Sequence[str] = ()) -> Path:
    """Histories over time, one panel for each unit."""
    known = [name for name in result.history_names() if name != "time"]
    chosen = list(names) if names else _scene_probes(result) or known
    if not chosen or "time" not in result.history_names():
        raise DosuiPostError(f"{result.path} has no histories over time")
    time = result.history("time")
    if len(time) == 0:
        raise DosuiPostError(f"the histories of {result.path} are empty")
    panels: dict[str, list[str]] = {}
    for name in chosen:
        panels.setdefault(result.history_unit(name), []).append(name)
    with house_style():
        figure = Figure(figsize=(6.4, 0.9 + 2.5 * len(panels)), layout="constrained")
        all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (unit, columns) in zip(all_axes, panels.items(), strict=True):
            values = [result.history(name) for name in columns]
            largest = max(float(np.max(np.abs(v[np.isfinite(v)]), initial=0)) for v in values)
            factor, shown = scale(largest, unit)
            for i, (name, value) in enumerate(zip(columns, values, strict=True)):
                colour = COLOURS[i % len(COLOURS)]
                axes.plot(time, value * factor, color=colour, label=_words(name), linewidth=1.3)
            is_single = len(columns) == 1
            quantity = _words(columns[0]) if is_single else "value"
            axes.set_ylabel(f"{quantity}  [{shown or '–'}]")
            axes.set_xlim(float(time[0]), float(time[-1]) or 1.0)
            if not is_single:
                axes.legend(loc="best")
        all_axes[-1].set_xlabel("time  $t$  [s]")
        caption(figure, "Histories", _title(result))
        return save(figure, output)


def _scene_probes(result: Result) -> list[str]:
    columns = [probe_column(result, probe) for probe in result.scene.all("probe")]
    return [column for column in columns if column is not None]


# ---------------------------------------------------------------------- maps


def field_map(
    result: Result,
    output: Path,
    name: str = "pore_pressure",
    component: str | None = None,
    step: int = -1,
    slice_y: float | None = None,
) -> Path:
    """A field on the particles: 2-D, a slice of 3-D, or a profile over z in 1-D."""
    values = field_values(result, name, component, step)
    with house_style():
        figure = draw_map(
            result, name, component, step, limits_of([values]), box_of(result, [step]), slice_y
        )
        return save(figure, output)


def draw_map(
    result: Result,
    name: str,
    component: str | None,
    step: int,
    limits: tuple[float, float],
    box: Box,
    slice_y: float | None = None,
) -> Figure:
    """The figure of `field_map` for given limits of the colours and of the axes."""
    points = result.points(step)
    values = field_values(result, name, component, step)
    factor, unit = scale(max(abs(limits[0]), abs(limits[1])), result.field_unit(name))
    label = f"{_field_label(result, name, component)}  [{unit or '–'}]"
    low, high = limits[0] * factor, limits[1] * factor
    heading = f"{_field_label(result, name, component)} at t = {number(result.times[step])} s"
    heading = heading[0].upper() + heading[1:]
    details = _title(result)
    if np.ptp(points[:, 0]) == 0 and np.ptp(points[:, 1]) == 0:
        figure, axes = new_figure(4.6, 5.2)
        order = np.argsort(points[:, 2])
        x, z = values[order] * factor, points[order, 2]
        axes.plot(x, z, color=COLOURS[0], linewidth=0.8, alpha=0.5)
        axes.plot(x, z, color=COLOURS[0], markeredgecolor=DOTS_EDGE, **DOTS)
        margin = 0.04 * (high - low)
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(box[0][2], box[1][2])
        axes.set_xlabel(label)
        axes.set_ylabel("$z$  [m]")
        caption(figure, heading, details)
        return figure
    sides = _particle_sides(result, step, points)
    if np.ptp(points[:, 1]) > 0:
        keep, y = _slice(points, sides, slice_y)
        points, values, sides = points[keep], values[keep], sides[keep]
        details += f", slice at y = {y:.4g} m"
    figure = _square_map(points, values * factor, sides, _turn(result), label, (low, high), box)
    caption(figure, heading, details)
    return figure


def field_values(result: Result, name: str, component: str | None, step: int) -> FloatArray:
    """One number for every particle: a component, the magnitude or the mean stress."""
    values = result.field(name, step)
    if values.ndim == 1 or values.shape[1] == 1:
        if component is not None:
            raise DosuiPostError(f"the field '{name}' has no components")
        return values.reshape(len(values))
    names = {3: _VECTOR, 6: _STRESS}.get(values.shape[1])
    if names is None:
        names = tuple(str(k + 1) for k in range(values.shape[1]))
    chosen = _component(values.shape[1], component)
    if chosen not in names:
        raise DosuiPostError(f"'{name}' has no component '{chosen}' (it has: {', '.join(names)})")
    if chosen == "magnitude":
        return np.asarray(np.linalg.norm(values, axis=1))
    if chosen == "mean":
        return np.asarray(np.mean(values[:, :3], axis=1))
    return values[:, names.index(chosen)]


def limits_of(arrays: Sequence[FloatArray]) -> tuple[float, float]:
    """Common limits of colours: from 0 where that costs little, symmetric for both signs."""
    finite = [a[np.isfinite(a)] for a in arrays]
    low = min((float(np.min(a)) for a in finite if a.size), default=0.0)
    high = max((float(np.max(a)) for a in finite if a.size), default=1.0)
    size = max(abs(low), abs(high))
    if size == 0:
        return 0.0, 1.0
    if high - low < 1.0e-9 * size:
        # A constant field shows as one colour, not as its rounding errors.
        return low - 0.5 * size, high + 0.5 * size
    if min(-low, high) > 0.1 * size:
        return -size, size
    if -0.01 * size < low < 0.5 * high:
        low = 0.0
    if 0.5 * low < high < 0.01 * size:
        high = 0.0
    return low, high


def box_of(result: Result, steps: Sequence[int]) -> Box:
    """Corners of the box around all particles of the steps."""
    lows, highs = [], []
    for step in steps:
        points = result.points(step)
        half = 0.5 * _particle_sides(result, step, points)[:, np.newaxis]
        reach = half * (abs(np.cos(_turn(result))) + abs(np.sin(_turn(result))))
        lows.append(np.nanmin(points - reach, axis=0))
        highs.append(np.nanmax(points + reach, axis=0))
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _component(width: int, component: str | None) -> str:
    return component or {3: "magnitude", 6: "zz"}.get(width, "1")


def _field_label(result: Result, name: str, component: str | None) -> str:
    values = result.field(name, 0)
    if values.ndim == 1 or values.shape[1] == 1:
        return _words(name)
    return f"{_words(name)}, {_component(values.shape[1], component)}"


def _particle_sides(result: Result, step: int, points: FloatArray) -> FloatArray:
    """Side of the line, square or cube that a particle fills [m]."""
    extent = np.ptp(points, axis=0)
    filled = extent[extent > 0]
    if result.has_field("volume"):
        content = np.maximum(result.field("volume", step), 0)
    else:
        content = np.full(len(points), np.prod(filled) / len(points))
    return np.asarray(content ** (1 / max(1, len(filled))))


def _slice(
    points: FloatArray, sides: FloatArray, wanted: float | None
) -> tuple[npt.NDArray[np.bool_], float]:
    """The layer of particles nearest to the plane y = wanted (default: the middle)."""
    y = points[:, 1]
    plane = 0.5 * float(np.min(y) + np.max(y)) if wanted is None else wanted
    nearest = float(y[np.argmin(np.abs(y - plane))])
    return np.abs(y - nearest) <= 0.5 * sides, nearest


def _turn(result: Result) -> float:
    """Turn of the particle lattice, x towards z [rad]."""
    angles = [r.number("lattice_angle") for r in result.scene.all("region") if "lattice_angle" in r]
    return float(np.deg2rad(angles[0])) if angles else 0.0


def _square_map(
    points: FloatArray,
    values: FloatArray,
    sides: FloatArray,
    turn: float,
    label: str,
    limits: tuple[float, float],
    box: Box,
) -> Figure:
    x, z, half = points[:, 0], points[:, 2], 0.5 * sides
    cosine, sine = np.cos(turn), np.sin(turn)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    offset = corners @ np.array([[cosine, sine], [-sine, cosine]])
    squares = np.stack([x, z], axis=1)[:, np.newaxis, :] + half[:, np.newaxis, np.newaxis] * offset
    low, high = box[0][[0, 2]], box[1][[0, 2]]
    width, height = high - low
    # The drawing keeps its proportions within 5.6 x 4.6 inch; the rest is for labels.
    inch = min(5.6 / width, 4.6 / height)
    size = max(3.6, width * inch + 1.9), max(2.6, height * inch + 1.4)
    figure, axes = new_figure(*size, layout="compressed")
    patches = PolyCollection(
        list(squares), cmap=_colours(limits), linewidth=0.1, edgecolor="face", rasterized=True
    )
    patches.set_array(np.ma.masked_invalid(values))
    patches.set_clim(*limits)
    axes.add_collection(patches)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.grid(False)
    _spread_ticks(axes, (low[0], high[0]), width * inch)
    axes.set_xlabel("$x$  [m]")
    axes.set_ylabel("$z$  [m]")
    bar = figure.colorbar(patches, ax=axes, pad=0.04, aspect=height * inch / 0.17)
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    bar.outline.set_edgecolor(MUTED)
    return figure


def _spread_ticks(axes: Axes, ends: tuple[float, float], inches: float) -> None:
    """Ticks of x whose labels do not touch; of narrow bodies the ends, or one of them."""
    if inches >= _NARROW:
        axes.locator_params(axis="x", nbins=max(2, min(6, int(inches / 0.7))))
        return
    labels = [f"{end:.7g}" for end in ends]
    n = 2 if 0.5 * sum(map(len, labels)) * _LETTER < inches else 1
    axes.set_xticks(list(ends[:n]), labels[:n])


def _colours(limits: tuple[float, float]) -> Colormap:
    """Diverging for both signs, else sequential; both safe for colour blindness."""
    is_symmetric = limits[0] < 0 and np.isclose(-limits[0], limits[1])
    colours = mpl.colormaps["RdBu_r" if is_symmetric else "viridis"]
    return colours.with_extremes(bad="#bbbbbb")


# ---------------------------------------------------------------------- shared


def _legend(axes: Axes, place: Any, first: Sequence[Line2D] = ()) -> None:
    """What lines and dots mean, after the colours."""
    exact = Line2D([], [], color=INK, label="exact", **EXACT_LINE)
    dots = Line2D([], [], color=INK, markeredgecolor=DOTS_EDGE, label="dosui", **DOTS)
    axes.legend(handles=[*first, exact, dots], loc=place, handlelength=1.6)


def _thin(x: FloatArray, y: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
    """Some dots of a history, evenly spaced on a logarithmic axis."""
    inside = np.flatnonzero((x >= start) & np.isfinite(y))
    if len(inside) <= _DOTS_OF_HISTORY:
        return x[inside], y[inside]
    targets = np.geomspace(x[inside[0]], x[inside[-1]], _DOTS_OF_HISTORY)
    nearest = [int(np.argmin(np.abs(np.log(x[inside] / target)))) for target in targets]
    keep = inside[sorted(set(nearest))]
    return x[keep], y[keep]


def _plain_log_ticks(axes: Axes) -> None:
    axes.xaxis.set_major_locator(LogLocator(base=10))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _factor(result: Result, case: ConsolidationCase, step: int) -> float:
    return case.time_factor(float(result.times[step]))


def _title(result: Result) -> str:
    """The scene's title and the file's name."""
    title = result.scene.one("scene").text("title", "")
    return f"{title} ({result.path.name})" if title else result.path.name


def _words(name: str) -> str:
    return name.replace("_", " ")


def _operator(result: Result) -> list[str]:
    if result.scene.one("water").text("operator", "compact") == "two_pass":
        return ["literal two-pass operator"]
    return []


def constants_text(case: ConsolidationCase, result: Result) -> str:
    """Constants of the case and the operator, for a caption."""
    return _typeset([*case.constants(), *_operator(result)])


def _common_constants(cases: Sequence[ConsolidationCase], results: Sequence[Result]) -> str:
    """Constants that all cases share."""
    lists = [
        [*case.constants(), *_operator(result)] for case, result in zip(cases, results, strict=True)
    ]
    return _typeset([text for text in lists[0] if all(text in other for other in lists)])


def _typeset(constants: Sequence[str]) -> str:
    """Symbols in italics, numbers and units upright; words as they are."""
    shown = []
    for text in constants:
        symbol, equals, value = text.partition(" = ")
        symbol = {"ν": r"\nu", "u₀": "u_0", "K_w": "K_w"}.get(symbol, symbol)
        shown.append(f"${symbol}$ = {value}".replace(" ", "\N{NO-BREAK SPACE}") if equals else text)
    return ",  ".join(shown)


def _name_of(case: ConsolidationCase, result: Result, cases: Sequence[ConsolidationCase]) -> str:
    """What tells a curve from the others."""
    ratios = {other.solution.soil.poisson_ratio for other in cases}
    if len(ratios) == len(cases):
        return f"ν = {case.solution.soil.poisson_ratio:g}"
    return result.name

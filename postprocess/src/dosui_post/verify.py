"""Compares results with their exact solutions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dosui_post.case import (
    BarCase,
    Case,
    ColumnCase,
    HydrostaticCase,
    MandelCase,
    RadialCase,
    case_of,
    settlement_history,
)
from dosui_post.errors import DosuiPostError
from dosui_post.result import FloatArray, Result

TWO_PASS_TOLERANCE = 0.15
"""Default for the literal two-pass operator, whose own error is 2e-2 to 1.2e-1."""


@dataclass
class StepError:
    """How far one output step is from the exact solution."""

    time: float
    """[s]"""
    time_factor: float
    """T [-]"""
    error: float
    """relative L2 error that is judged [-]"""
    others: dict[str, float] = field(default_factory=dict)
    """further relative errors by name [-]"""
    is_finite: bool = True
    """no NaN or infinity among the particles' values"""


@dataclass
class Verification:
    """All comparable steps of a result."""

    title: str
    constants: list[str]
    measure: str
    """what `error` is"""
    steps: list[StepError]
    tolerance: float
    notes: list[str]

    @property
    def largest_error(self) -> float:
        """Largest error of the steps; NaN if there is none or one is NaN."""
        return float(np.max([step.error for step in self.steps])) if self.steps else math.nan

    @property
    def has_passed(self) -> bool:
        """At least one step, all of them finite and within the tolerance."""
        is_finite = all(step.is_finite for step in self.steps)
        return bool(self.steps) and is_finite and self.largest_error <= self.tolerance

    def table(self) -> str:
        """The comparison as text."""
        lines = [f"{self.title} ({', '.join(self.constants)})"] if self.constants else [self.title]
        lines += [f"  note: {note}" for note in self.notes]
        if not self.steps:
            return "\n".join([*lines, "  FAILED: no output step can be compared"])
        names = list(dict.fromkeys(name for step in self.steps for name in step.others))
        heads = ["T", "time [s]", self.measure, *names]
        widths = [max(11, len(head)) for head in heads]
        lines.append("  " + "  ".join(f"{h:>{w}}" for h, w in zip(heads, widths, strict=True)))
        for step in self.steps:
            cells = [f"{step.time_factor:.5g}", f"{step.time:.6g}", f"{step.error:.3e}"]
            cells += [f"{step.others[n]:.3e}" if n in step.others else "-" for n in names]
            lines.append("  " + "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True)))
        return "\n".join([*lines, "  " + self._verdict()])

    def _verdict(self) -> str:
        error = f"largest error {self.largest_error:.3e}"
        if self.has_passed:
            return f"passed: {error} <= tolerance {self.tolerance:g}"
        if not all(step.is_finite for step in self.steps):
            return f"FAILED: values that are not finite, {error}"
        return f"FAILED: {error} > tolerance {self.tolerance:g}"


def verify(
    result: Result, tolerance: float | None = None, smallest_time_factor: float = 0.0
) -> Verification:
    """Errors of every output step after t = 0 (and from a time factor on)."""
    case = case_of(result)
    compare, measure = _comparison(case)
    steps = []
    for index in range(result.n_steps):
        time = float(result.times[index])
        # 1 - 1e-6: output times are rounded in the scene.
        if time <= 0 or case.time_factor(time) < smallest_time_factor * (1 - 1.0e-6):
            continue
        steps.append(compare(case, result, index))
    return Verification(
        title=f"{result.path}: {case.title}",
        constants=case.constants(),
        measure=measure,
        steps=steps,
        tolerance=default_tolerance(case, result) if tolerance is None else tolerance,
        notes=_notes(result),
    )


def default_tolerance(case: Case, result: Result) -> float:
    """The case's own, or the wider one of the literal two-pass operator."""
    return TWO_PASS_TOLERANCE if _is_two_pass(result) else case.tolerance


def relative_l2(value: FloatArray, exact: FloatArray, weight: FloatArray) -> float:
    """sqrt(Σ V |value - exact|² / Σ V |exact|²) over particles; NaN stays NaN."""
    axes = tuple(range(1, value.ndim))
    difference = np.sum((value - exact) ** 2, axis=axes)
    size = np.sum(exact**2, axis=axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.sqrt(np.sum(weight * difference) / np.sum(weight * size)))


# ---------------------------------------------------------------------- inside

_Comparison = Callable[[Case, Result, int], StepError]


def _comparison(case: Case) -> tuple[_Comparison, str]:
    if isinstance(case, HydrostaticCase):
        return _compare_hydrostatic, "larger error"
    if isinstance(case, BarCase):
        return _compare_bar, "energy norm"
    return _compare_consolidation, "pressure L2"


def _compare_consolidation(case: Case, result: Result, index: int) -> StepError:
    assert isinstance(case, ColumnCase | MandelCase | RadialCase)
    time = float(result.times[index])
    points = result.reference_points(index)
    weight = _weight(result, index)
    pressure = _scalar(result, "pore_pressure", index)
    exact = case.pressure(points, time)
    others = {"max/u0": _largest(pressure - exact) / abs(case.initial_pressure)}
    is_finite = bool(np.all(np.isfinite(pressure)))
    is_rigid = case.solution.soil.is_rigid
    if result.has_field("displacement") and not is_rigid:
        displacement = result.field("displacement", index)
        is_finite = is_finite and bool(np.all(np.isfinite(displacement)))
        others["displ. L2"] = relative_l2(displacement, case.displacement(points, time), weight)
    settlement = None if is_rigid else _settlement_error(case, result, time)
    if settlement is not None:
        others["settlement"] = settlement
        is_finite = is_finite and math.isfinite(settlement)
    return StepError(
        time=time,
        time_factor=case.time_factor(time),
        error=relative_l2(pressure, exact, weight),
        others=others,
        is_finite=is_finite,
    )


def _settlement_error(
    case: ColumnCase | MandelCase | RadialCase, result: Result, time: float
) -> float | None:
    exact = case.settlement(time)
    history = settlement_history(result)
    if exact is None or history is None:
        return None
    times, values = history
    # Histories are sampled on their own: the last row may end just before the output.
    slack = 1.0e-6 * time + (times[-1] - times[-2] if len(times) > 1 else 0.0)
    if len(times) == 0 or not times[0] <= time <= times[-1] + slack:
        return None
    return abs(float(np.interp(time, times, values)) - exact) / abs(exact)


def _compare_hydrostatic(case: Case, result: Result, index: int) -> StepError:
    assert isinstance(case, HydrostaticCase)
    time = float(result.times[index])
    pressure = _scalar(result, "pore_pressure", index)
    exact = case.solution.pressure(result.reference_points(index)[:, 2])
    pressure_error = relative_l2(pressure, exact, _weight(result, index))
    speed = np.linalg.norm(result.field("velocity", index), axis=1)
    velocity_error = _largest(speed) / case.velocity_scale
    return StepError(
        time=time,
        time_factor=case.time_factor(time),
        error=float(np.maximum(pressure_error, velocity_error)),
        others={"pressure L2": pressure_error, "max |v|/sqrt(gH)": velocity_error},
        is_finite=bool(np.all(np.isfinite(pressure)) and np.all(np.isfinite(speed))),
    )


def _compare_bar(case: Case, result: Result, index: int) -> StepError:
    """Kinetic and elastic parts together: neither vanishes when the other is largest."""
    assert isinstance(case, BarCase)
    time = float(result.times[index])
    s = case.abscissa(result.reference_points(index))
    weight = _weight(result, index)
    solution, direction = case.solution, -case.geometry.direction
    velocity = result.field("velocity", index)
    displacement = result.field("displacement", index)
    scale = np.outer(solution.amplitude * solution.shape(s), direction)
    # relative_l2 needs a size that does not vanish with time: the amplitude's.
    exact_velocity = np.outer(solution.velocity(s, time), direction)
    exact_displacement = np.outer(solution.displacement(s, time), direction)
    omega = solution.circular_frequency
    velocity_error = relative_l2(velocity - exact_velocity + scale, scale, weight)
    displacement_error = relative_l2(
        omega * (displacement - exact_displacement) + scale, scale, weight
    )
    return StepError(
        time=time,
        time_factor=case.time_factor(time),
        error=math.hypot(velocity_error, displacement_error),
        others={"velocity L2": velocity_error, "displ. L2": displacement_error},
        is_finite=bool(np.all(np.isfinite(velocity)) and np.all(np.isfinite(displacement))),
    )


def _scalar(result: Result, name: str, index: int) -> FloatArray:
    values = result.field(name, index)
    if values.ndim > 1:
        values = values[:, 0]
    if values.size == 0:
        raise DosuiPostError(f"{result.path}: step {index} has no particles")
    return values


def _weight(result: Result, index: int) -> FloatArray:
    if result.has_field("volume"):
        return result.field("volume", index)
    return np.ones(len(result.points(index)))


def _largest(values: FloatArray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def _is_two_pass(result: Result) -> bool:
    return result.scene.one("water").text("operator", "compact") == "two_pass"


def _notes(result: Result) -> list[str]:
    notes = []
    if _is_two_pass(result):
        notes.append("literal two-pass MLS-SPH operator: the error is the method's own")
    time = result.scene.one("time")
    if "end_time" in time:
        end, last = time.number("end_time"), float(result.times[-1])
        if last < end * (1 - 1.0e-6):
            notes.append(f"the run has not reached its end: t = {last:g} s of {end:g} s")
    return notes

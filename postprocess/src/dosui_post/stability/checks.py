"""What the results of the hard cases must fulfil."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dosui_post.result import Result
from dosui_post.stability import scenes
from dosui_post.stability.case import Evidence, Quantity
from dosui_post.verify import verify

Check = Callable[[Evidence], list[Quantity]]


def terzaghi(limit: float) -> Check:
    """The largest relative L2 error of the pressure over the outputs."""

    def check(evidence: Evidence) -> list[Quantity]:
        steps = [step for step in verify(evidence.result).steps if step.time_factor > 0.0]
        return [Quantity("pressure error", max(step.error for step in steps), limit)]

    return check


def layers(evidence: Evidence) -> list[Quantity]:
    """Against finite volumes."""
    result = evidence.result
    exact = scenes.layered_pressure(result.points(-1)[:, 2])
    return [Quantity("pressure error", _distance(_pressure(result), exact), 1.0e-2)]


def undrained_range(evidence: Evidence) -> list[Quantity]:
    """0 to q, and 5 % of q beyond at the strip's edge."""
    pressure = _pressure(evidence.result) / scenes.LOAD
    return [Quantity("pressure outside 0…q", _beyond(pressure), 0.05)]


def no_overshoot(evidence: Evidence) -> list[Quantity]:
    """Where nothing can have drained the undrained pressure stays."""
    solution = scenes.Column(bulk_modulus=2.2e9).solution
    pressure = _pressure(evidence.result) / solution.initial_pressure
    inside = evidence.result.points(-1)[:, 2] < scenes.HEIGHT - 0.1
    return [
        Quantity("overshoot", _finite(pressure, max(float(pressure.max()) - 1.0, 0.0)), 0.01),
        Quantity("change inside", float(np.abs(pressure[inside] - 1.0).max()), 0.02),
    ]


def faded(evidence: Evidence) -> list[Quantity]:
    """A checkerboard is gone."""
    left = np.sqrt(np.mean(_pressure(evidence.result) ** 2)) / scenes.LOAD
    return [Quantity("rms left", float(left), 0.02)]


def between(evidence: Evidence) -> list[Quantity]:
    """Heads between those of the start and the shore's."""
    head = evidence.result.field("head", -1)
    return [Quantity("head outside 0…1 m", _beyond(head), 0.01)]


def lid(evidence: Evidence) -> list[Quantity]:
    """Above a seam water has drained, below it has not yet; nothing outside 0 to u_0."""
    pressure = _pressure(evidence.result) / scenes.Column().solution.initial_pressure
    z = evidence.result.points(-1)[:, 2]
    return [
        Quantity("pressure outside 0…u0", _beyond(pressure), 0.01),
        Quantity("unevenness below", float(np.ptp(pressure[z < 0.3])), 0.05),
    ]


def at_rest(evidence: Evidence) -> list[Quantity]:
    """Nothing has moved and nothing flows."""
    result = evidence.result
    moved = np.abs(result.field("displacement", -1)).max()
    flow = np.abs(result.field("darcy_velocity", -1)).max() / 1.0e-4
    return [
        Quantity("displacement over depth", float(moved) / scenes.REST_DEPTH, 1.0e-9),
        Quantity("flow over k", float(flow), 1.0e-9),
    ]


def carried(evidence: Evidence) -> list[Quantity]:
    """Stress and pressure of a body that moves in equilibrium stay."""
    result = evidence.result
    stress = result.field("effective_stress", -1) / scenes.BODY_PRESSURE
    stress[:, :3] -= 1.0
    pressure = _pressure(result) / scenes.BODY_PRESSURE - 1.0
    return [
        Quantity("change of stress", float(np.abs(stress).max()), 1.0e-6),
        Quantity("change of pressure", float(np.abs(pressure).max()), 1.0e-6),
    ]


def momentum(evidence: Evidence) -> list[Quantity]:
    """Mass and momentum of a closed system; kinetic energy does not grow."""
    result = evidence.result
    change = _momentum(result, -1) - _momentum(result, 0)
    scale = float(np.sum(result.history("mass")[0]))
    energy = result.history("kinetic_energy")
    mass = result.history("mass")
    return [
        Quantity("momentum", float(np.abs(change).max()) / scale, 1.0e-10),
        Quantity("mass", float(np.ptp(mass) / mass[0]), 1.0e-14),
        Quantity("energy gained", max(float(energy.max() / energy[0]) - 1.0, 0.0), 1.0e-6),
    ]


def drained_tear(evidence: Evidence) -> list[Quantity]:
    """Both halves have a surface where they were torn, pressures lie between 0 and the first."""
    result = evidence.result
    pressure = _pressure(result) / scenes.TORN_PRESSURE
    area = [result.history(f"area_air_{half}") for half in "ab"]
    change = _momentum(result, -1) - _momentum(result, 0)
    scale = 4.0 * float(np.sum(result.history("mass")[0]))
    return [
        Quantity("pressure outside 0…u0", _beyond(pressure), 0.05),
        Quantity("surface missing", max(4.0 - min(float(a[-1]) for a in area), 0.0), 0.1),
        Quantity("momentum", float(np.abs(change).max()) / scale, 1.0e-10),
    ]


def alone(evidence: Evidence) -> list[Quantity]:
    """A particle that left keeps its number, mass, velocity and pressure."""
    result = evidence.result
    last = int(np.argmax(result.points(0)[:, 2]))
    velocity = result.field("velocity", -1)[last, 2]
    ids = result.field("id", 0) != result.field("id", -1)
    mass = result.history("mass")
    return [
        Quantity("numbers changed", float(ids.sum()), 0.0),
        Quantity("mass", float(np.ptp(mass) / mass[0]), 1.0e-14),
        Quantity("velocity lost", abs(float(velocity) / 2.0 - 1.0), 1.0e-10),
        Quantity("its pressure [Pa]", abs(float(_pressure(result)[last])), 1.0e-2),
    ]


def energy(evidence: Evidence) -> list[Quantity]:
    """No period has more kinetic energy than the first."""
    values = evidence.result.history("kinetic_energy")
    time = evidence.result.history("time")
    later = values[time > scenes.vibration_period()]
    gained = float(later.max() / values[0]) - 1.0
    return [Quantity("energy gained", max(gained, 0.0) if math.isfinite(gained) else gained, 1e-3)]


def periodic(evidence: Evidence) -> list[Quantity]:
    """Pressures under a cyclic load stay within its range."""
    result = evidence.result
    largest = [
        np.abs(result.field("pore_pressure", step)).max() / scenes.LOAD
        for step in range(1, result.n_steps)
    ]
    return [Quantity("largest pressure over q", float(np.max(largest)), 1.0)]


def halved(evidence: Evidence) -> list[Quantity]:
    """The column has half its height and no pressure is left."""
    result = evidence.result
    end = result.reference_points(-1)[:, 2] + result.field("displacement", -1)[:, 2]
    half = 0.5 * result.reference_points(-1)[:, 2]
    load = math.log(2.0) * 1.0e6
    return [
        Quantity("height", float(np.abs(end - half).max()), 2.0e-2),
        Quantity("pressure over load", float(np.abs(_pressure(result)).max()) / load, 2.0e-2),
    ]


def slid(evidence: Evidence) -> list[Quantity]:
    """The slope ran, pressures stayed bounded, mass was kept, and no energy came from nothing."""
    result = evidence.result
    pressure = _pressure(result) / (2000.0 * 9.81 * 3.0)
    mass = result.history("mass")
    fallen = result.field("displacement", -1)[:, 2]
    weight = mass[0] / len(fallen) * 9.81
    released = -float(fallen.sum()) * weight
    kinetic = float(result.history("kinetic_energy").max())
    toe = float(result.points(-1)[:, 0].max())
    return [
        Quantity("pressure over weight", float(np.abs(pressure).max()), 5.0),
        Quantity("mass", float(np.ptp(mass) / mass[0]), 1.0e-12),
        Quantity("kinetic over released energy", kinetic / max(released, 1.0e-9), 1.0),
        Quantity("run-out missing", max(6.2 - toe, 0.0), 0.0),
    ]


def drained_face(evidence: Evidence) -> list[Quantity]:
    """Pressures lie between suction and what they began with; the balance closes."""
    result = evidence.result
    pressure = _pressure(result) / (scenes.GAMMA * 2.0)
    return [
        Quantity("pressure over the first", float(pressure.max()), 1.01),
        Quantity("suction over height", -min(float(pressure.min()), 0.0), 1.01),
        Quantity("water missing", float(result.history("water_balance_error")[-1]), 1.0e-2),
    ]


def same_on_ranks(evidence: Evidence) -> list[Quantity]:
    """All fields as on one rank."""
    if evidence.serial is None:
        return [Quantity("difference", math.nan, 1.0e-11)]
    differences = []
    for name in ("pore_pressure", "displacement", "effective_stress"):
        one = evidence.serial.field(name, -1)
        two = evidence.result.field(name, -1)
        differences.append(np.abs(one - two).max() / np.abs(one).max())
    return [Quantity("difference", float(np.max(differences)), 1.0e-11)]  # NaN stays


# ---------------------------------------------------------------------- inside


def _pressure(result: Result) -> np.ndarray:
    return result.field("pore_pressure", -1)


def _distance(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _beyond(values: np.ndarray) -> float:
    """How far values lie outside 0 to 1."""
    return _finite(values, max(float(values.max()) - 1.0, -float(values.min()), 0.0))


def _finite(values: np.ndarray, number: float) -> float:
    return number if bool(np.isfinite(values).all()) else math.nan


def _momentum(result: Result, step: int) -> np.ndarray:
    """Of particles of equal mass, per speed of 1 m/s."""
    mass = float(result.history("mass")[0])
    return mass * np.asarray(result.field("velocity", step).mean(axis=0))

"""All hard cases."""

from __future__ import annotations

import math

from dosui_post.stability import checks, scenes
from dosui_post.stability.case import Case, Method
from dosui_post.stability.scenes import Column


def _columns() -> list[Case]:
    columns = [
        ("plain", "Column, as it comes", Column(), 0.01),
        ("turned", "Column turned by 30°", Column(angle=30.0), 0.01),
        ("jittered", "Column, particles jittered by 25 %", Column(jitter=0.25), 0.01),
        ("turned-jittered", "Both", Column(angle=30.0, jitter=0.25), 0.01),
        ("nu-0", "ν = 0", Column(poisson_ratio=0.0), 0.01),
        ("nu-0.49", "ν = 0.49", Column(poisson_ratio=0.49, conductivity=1.0e-5), 0.01),
        ("nu-0.499", "ν = 0.499", Column(poisson_ratio=0.499, conductivity=1.0e-5), 0.01),
        ("water-2.2e9", "K_w = 2.2 GPa", Column(bulk_modulus=2.2e9), 0.01),
        ("water-1e12", "K_w = 1e12 Pa", Column(bulk_modulus=1.0e12), 0.01),
    ]
    return [
        Case(name, title, f"error ≤ {limit:.0%}", column.text, checks.terzaghi(limit))
        for name, title, column, limit in columns
    ]


def _drained_step(method: Method) -> str:
    step = 0.0 if method.has_inertia else 1.0e5
    column = Column(bulk_modulus=2.2e9, conductivity=1.0e-12, time_step=step)
    return column.text(method, [1.0e5])


CASES: tuple[Case, ...] = (
    *_columns(),
    Case(
        "contrast",
        "k of two layers 1 : 1 000 000",
        "error ≤ 1 %",
        scenes.layers,
        checks.layers,
    ),
    Case(
        "seam",
        "A layer of one particle, k 1 : 100",
        "0 ≤ u ≤ u0, even below it",
        scenes.seam,
        checks.lid,
    ),
    Case(
        "strip",
        "Undrained strip load, k = 0, jittered",
        "0 ≤ u ≤ q within 5 %",
        scenes.strip,
        checks.undrained_range,
    ),
    Case(
        "drained-step",
        "A step of 1e5 s at k = 1e-12 m/s",
        "no overshoot, nothing inside",
        _drained_step,
        checks.no_overshoot,
    ),
    Case(
        "checkerboard",
        "Pressures +u, -u of neighbours",
        "2 % left after 2 dx²/c",
        scenes.checkerboard,
        checks.faded,
    ),
    Case(
        "island",
        "Heads all round a box, lattice turned by 15°",
        "heads within theirs (1 %)",
        scenes.island,
        checks.between,
    ),
    Case(
        "cyclic",
        "30 cycles of load",
        "pressure within the load",
        scenes.cyclic,
        checks.periodic,
    ),
    Case(
        "rest",
        "Bed under water, jittered by 25 %",
        "no motion, no flow to 1e-9",
        scenes.rest,
        checks.at_rest,
    ),
    Case(
        "translation",
        "Stressed body over 100 cells",
        "stress and pressure to 1e-6",
        lambda method: scenes.drifting(method, "velocity = 10.0, 3.0", 1.0),
        checks.carried,
    ),
    Case(
        "rotation",
        "Stressed body, one turn",
        "stress and pressure to 1e-6",
        lambda method: scenes.drifting(method, "spin = 0.03", 2 * math.pi / 0.03),
        checks.carried,
        limit=240.0,
    ),
    Case(
        "collision",
        "Two bodies meet",
        "mass, momentum, no energy gained",
        scenes.collision,
        checks.momentum,
    ),
    Case(
        "tear",
        "A body torn in two, free surface drained",
        "surface on both sides, 0 ≤ u ≤ u0",
        scenes.torn,
        checks.drained_tear,
    ),
    Case(
        "thrown",
        "A particle leaves its body",
        "keeps number, mass, speed, pressure",
        scenes.thrown,
        checks.alone,
    ),
    Case(
        "vibration",
        "Undrained bar, 20 periods undamped",
        "no energy gained (0.1 %)",
        scenes.vibration,
        checks.energy,
    ),
    Case(
        "compression",
        "Column pressed to half its height",
        "height within 2 %, J > 0",
        scenes.compression,
        checks.halved,
        limit=120.0,
    ),
    Case(
        "slide",
        "Undrained slope runs out",
        "bounded pressures, mass, energy",
        scenes.slide,
        checks.slid,
        limit=120.0,
    ),
    Case(
        "drawdown",
        "Reservoir falls at once, seepage face",
        "bounded pressures, balance 1 %",
        scenes.drawdown,
        checks.drained_face,
    ),
    Case(
        "empty-rank",
        "5 ranks for 4 particles",
        "as on one rank to 1e-11",
        scenes.few_particles,
        checks.same_on_ranks,
        ranks=5,
    ),
    Case(
        "particle-a-rank",
        "One particle a rank",
        "as on one rank to 1e-11",
        scenes.few_particles,
        checks.same_on_ranks,
        ranks=4,
    ),
)

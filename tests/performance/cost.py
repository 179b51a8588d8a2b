"""What options cost: core time and memory of a particle with an option off and on.

    cmake --build --preset release --target dosui1d dosui2d dosui3d
    python tests/performance/cost.py             # about ten minutes; writes docs/cost.md

Every option is compared with the scene that has all else alike, run by run in turns; medians
count. Off means that the option's keys are written with their neutral value: it must cost
nothing.
"""

from __future__ import annotations

import argparse
import json
import statistics
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

from benchmark import BIN, ROOT, Case, measure
from report import output

PARTICLES = 100_000
SPREAD = 3  # runs of each scene

PAGE = """<!-- Written by tests/performance/cost.py: do not edit. -->

# What options cost

Only what a scene needs: an option that is off must cost nothing, and one that is on shows its
price.

Measured on {date} with {version}; one rank, about {particles} particles.
Every option is measured against the scene that is alike but for it, in turns; the table holds
differences of medians of
{runs} runs, per particle and step. **Noise** is the largest difference between two runs of the
same scene: {noise:.0f} ns. *Off* writes the option's keys with their neutral value.

| option | against | ns there | B there | off: ns | off: B | on: ns | on: B |
|---|---|---|---|---|---|---|---|
{rows}

The blocks are those of [performance.md](performance.md): in free flight, loaded on the top. Soils
that yield start beyond their strength, so that every particle returns to the yield surface.
Dimensions compare whole scenes; what is left to do for a particle grows with the nodes and
neighbours that it has.
The sand hardly strains here; where it flows, its sub-steps follow the strain (29 µs a particle-step
in a block of 500 particles that bursts).

Again: `python tests/performance/cost.py`.
"""


@dataclass
class Option:
    """One line: what it is compared with, the scene with neutral keys, and with the option."""

    name: str
    against: str
    base: Case
    off: Case | None
    on: Case


DRY = Case(2, False, False)
WET = Case(2, True, False)
MOVING = Case(2, False, True)
STRESSED = (
    "&initial_state effective_stress = 'given'\n"
    "  effective_stress_value = -1.0e3, -1.0e3, -9.0e3, 0.0, 0.0, 0.0 /\n"
)
PRESSED = (
    "&initial_state effective_stress = 'given'\n  effective_stress_value = 3*-1.0e3, 3*0.0 /\n"
)
SHAKEN = "&base_motion acceleration = {}, 0.0 formula = 'sin(10*t)' /\n"
OPTIONS = [
    Option("1-D", "2-D", DRY, None, Case(1, False, False)),
    Option("3-D", "2-D", DRY, None, Case(3, False, False)),
    Option("water", "dry", DRY, None, WET),
    Option("suction (van Genuchten)", "water", WET, replace(WET, soil="retention = 'none'"),
           replace(WET, soil="retention = 'van_genuchten' retention_alpha = 1.0")),
    Option("seepage face", "water", WET, None,
           replace(WET, drain="kind = 'seepage_face'")),
    Option("barrier", "water", WET, None,
           replace(WET, groups="&barrier name = 'pile' vertices = 0.5, 0.3, 0.5, 0.9 /\n")),
    Option("water, large deformation", "dry, large deformation", MOVING, None,
           Case(2, True, True)),
    Option("large deformation (updated, GIMP)", "small strain", DRY, None, MOVING),
    Option("k follows porosity (Kozeny-Carman)", "water, large deformation", Case(2, True, True),
           replace(Case(2, True, True), soil="conductivity_law = 'constant'"),
           replace(Case(2, True, True), soil="conductivity_law = 'kozeny_carman'")),
    Option("Mohr-Coulomb", "elastic", replace(DRY, groups=STRESSED),
           replace(DRY, soil="model = 'linear_elastic'", groups=STRESSED),
           replace(DRY, soil="model = 'mohr_coulomb' friction_angle = 30.0", groups=STRESSED)),
    Option("Drucker-Prager", "elastic", replace(DRY, groups=STRESSED), None,
           replace(DRY, soil="model = 'drucker_prager' friction_angle = 30.0", groups=STRESSED)),
    Option("sand (Dafalias & Manzari)", "elastic", replace(DRY, groups=PRESSED), None,
           replace(DRY, soil="model = 'dafalias_manzari'", modulus="", groups=PRESSED, steps=10)),
    Option("rigid wall with friction", "large deformation", MOVING, None,
           replace(MOVING, groups="&rigid_wall name = 'floor' position = 2*0.0\n"
                   "  normal = 0.0, 1.0 friction = 0.5 /\n")),
    Option("free surface found anew", "water, large deformation", Case(2, True, True), None,
           replace(Case(2, True, True),
                   groups="&surface name = 'air' region = 'block' face = 'free' /\n"
                   "&hydraulic_condition surface = 'air' kind = 'pressure' value = 0.0 /\n")),
    Option("shaking", "at rest", DRY,
           replace(DRY, groups="&base_motion /\n"), replace(DRY, groups=SHAKEN.format(1.0))),
    Option("absorbing surface", "free surface", DRY, None,
           replace(DRY, groups="&surface name = 'base' region = 'block' face = 'z-' /\n"
                   "&mechanical_condition surface = 'base' kind = 'absorbing' /\n")),
]  # fmt: skip


def median(case: Case, found: dict[str, list[tuple[float, float]]]) -> tuple[float, float]:
    """ns and bytes of a scene."""
    runs = found[case.scene(PARTICLES, 0)]
    return statistics.median(r[0] for r in runs), statistics.median(r[1] for r in runs)


def main() -> None:
    """Runs all scenes in turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="options whose name contains this")
    arguments = parser.parse_args()
    options = [o for o in OPTIONS if arguments.only in o.name]
    found: dict[str, list[tuple[float, float]]] = {}
    cases = {
        case.scene(PARTICLES, 0): case
        for option in options
        for case in (option.base, option.off, option.on)
        if case is not None
    }
    for turn in range(SPREAD):
        for text, case in cases.items():
            line = measure(case, PARTICLES, 1, 1, 1.0)
            found.setdefault(text, []).append((line.ns, line.bytes))
        print(f"turn {turn + 1} of {SPREAD}", flush=True)
    rows = []
    for option in options:
        ns, size = median(option.base, found)
        on = median(option.on, found)
        cells = ["", ""]
        if option.off is not None:
            off = median(option.off, found)
            cells = [f"{off[0] - ns:+.0f}", f"{off[1] - size:+.0f}"]
        cells += [f"{on[0] - ns:+.0f}", f"{on[1] - size:+.0f}"]
        rows.append(
            f"| {option.name} | {option.against} | {ns:.0f} | {size:.0f} | "
            + " | ".join(cells)
            + " |"
        )
        print(rows[-1], flush=True)
    noise = max(max(r[0] for r in runs) - min(r[0] for r in runs) for runs in found.values())
    (ROOT / "build" / "cost.json").write_text(json.dumps(list(found.values())))
    if arguments.only:
        return
    page: Path = ROOT / "docs" / "cost.md"
    page.write_text(
        PAGE.format(
            date=date.today(),
            version=output(str(BIN / "dosui2d"), "--version").splitlines()[0],
            particles=PARTICLES,
            runs=SPREAD,
            noise=noise,
            rows="\n".join(rows),
        )
    )


if __name__ == "__main__":
    main()

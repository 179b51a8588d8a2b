"""Explicit steps of boxes that lie anywhere in the grid: vibrations stay bounded, damped ones come
to rest in the exact uniform stress.

`python tests/verification/explicit_boxes.py 200` tries as many boxes at the default step and prints
those that blow up, and the worst errors of damped ones; `... 200 3` begins with number 3;
`... 200 3 flip` with this transfer only; DOSUI_RANKS=3 runs on so many ranks, DOSUI_COURANT=0.7
with other steps, DOSUI_DIMENSION=3 in three dimensions.

The boxes are those of `cut_bodies.py` with softer water (K_w/n = 10 M), loaded all at once: held by
walls on cut faces or free under pressure from all sides; hats, GIMP or B-splines.
"""

from __future__ import annotations

import os
import random
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cut_bodies
import numpy as np
from cut_bodies import POROSITY, Patch, errors, patch, read, run

MODULUS = cut_bodies.LAME + 2 * cut_bodies.SHEAR  # M [Pa]
SOFT_WATER = 10.0 * MODULUS  # K_w/n [Pa]
TRANSFERS = ("apic", "flip", "pic", "blend")
SOLID, WATER = 2650.0, 1000.0  # kg/m3
BOUND = 4.0  # speeds of a late time over those of the first quarter [-]
RESTS = 1.0e-8  # what damped boxes may miss: damping leaves so much of the start [-]


@dataclass
class Trial:
    """A box, how it moves and how long."""

    case: Patch
    transfer: str
    shape: str
    free: bool
    damped: bool

    @property
    def name(self) -> str:
        """What is special about it."""
        held = "free" if self.free else "held"
        return f"{self.case.name} {self.transfer} {self.shape} {held}{' damped' * self.damped}"


def trial(seed: int, transfer: str = "") -> Trial:
    """The trial of this number: one in four is damped, with the box's own functions."""
    cut_bodies.STIFF_WATER = SOFT_WATER
    draw = random.Random(1000 + seed)
    case = patch(seed, int(os.environ.get("DOSUI_DIMENSION", "2")))
    transfer = transfer or draw.choice(TRANSFERS)
    damped = seed % 4 == 0 and not case.finite and case.per_cell > 1  # single grains rest slowly
    damped = damped and case.load != "pressed"  # its wall never rests
    shape = "linear" if damped else draw.choice(["linear", "linear", "gimp", "bspline"])
    free = not damped and draw.random() < 0.5
    text = case.text.replace("shape_function='linear'", f"shape_function='{shape}'")
    shape = text.split("shape_function='")[1].split("'")[0]  # some boxes have one of their own
    text = text.replace("integrator='quasi_static'", "integrator='explicit'")
    text = text.replace("deformation='finite'", "")
    text = re.sub("&mechanics [^/]*/", "", text)
    text = text.replace("hydraulic_conductivity=1e-12", "hydraulic_conductivity=1e-16")
    if free:
        lines = [line for line in text.splitlines() if not line.startswith("&mechanical")]
        lines = [line for line in lines if not line.startswith("&surface")]
        lines += [
            f"&surface name='{f}' region='c' face='{f}' /\n"
            f"&mechanical_condition surface='{f}' kind='pressure' value=1000 /"
            for f in cut_bodies.faces_of(case.dimension)
        ]
        text = "\n".join(lines) + "\n"
    density = (1 - POROSITY) * SOLID + POROSITY * WATER * case.wet
    speed = np.sqrt((MODULUS + SOFT_WATER * case.wet) / density)
    slow = np.sqrt(cut_bodies.SHEAR / density)
    spacing = float(text.split("spacing=")[1].split()[0])
    courant = os.environ.get("DOSUI_COURANT", "")
    step = float(courant or 0.5) * spacing / speed
    end = 2000 * step
    keys = f"end_time={end:.17g} output_interval={end / 20:.17g}"
    if courant:
        keys += f" courant={courant}"
    rate = 0.0
    if damped:
        rate = 2 * np.pi * slow / 4.0  # about critical for the slowest vibration
        end = (90 if shape == "linear" else 140) / rate  # wide functions' soft modes rest later
        keys = f"end_time={end:.17g} output_interval={end:.17g}"
    text = text.replace("end_time=1 ", keys + " ")
    more = f"&mechanics transfer='{transfer}'"
    if damped:
        more += f" damping='viscous' damping_coefficient={rate:.17g}"
    case.text = text + more + " /\n"
    return Trial(case, transfer, shape, free, damped)


def growth(path: Path) -> float:
    """Largest speed of the later outputs over that of the first quarter."""
    speeds = []
    for step in range(1, 21):
        speeds.append(float(np.abs(read(path, step)["velocity"]).max()))
    return max(speeds[5:]) / max(speeds[:5])


def attempt(one: Trial, program: Path, ranks: int = 1) -> tuple[bool, dict[str, float]]:
    """Is it as it should be, and what was measured."""
    with tempfile.TemporaryDirectory() as name:
        status, output = run(one.case, Path(name), program, ranks)
        if status != 0:
            print(f"{one.name}: status {status}: {output.strip().splitlines()[-1]}", flush=True)
            return False, {}
        if one.damped:
            found = errors(one.case, Path(name) / "r.vtkhdf")
            return max(found.values()) <= RESTS, found
        found = {"growth": growth(Path(name) / "r.vtkhdf")}
        return found["growth"] <= BOUND, found


def main() -> int:
    """Runs a number of boxes."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    start = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    transfer = sys.argv[3] if len(sys.argv) > 3 else ""
    ranks = int(os.environ.get("DOSUI_RANKS", "1"))
    program = Path(os.environ.get("DOSUI", "build/release/bin/dosui")).resolve()
    worst: dict[str, tuple[float, str]] = {}
    n_bad = 0
    for seed in range(start, start + count):
        one = trial(seed, transfer)
        is_good, found = attempt(one, program, ranks)
        for key, value in found.items():
            if not value <= worst.get(key, (-1.0, ""))[0]:
                worst[key] = (value, one.name)
        if not is_good:
            n_bad += 1
            print(f"{one.name}: " + ", ".join(f"{k} {v:.2e}" for k, v in found.items()), flush=True)
    for key, (value, what) in sorted(worst.items()):
        print(f"worst {key}: {value:.2e} ({what})")
    print(f"{n_bad} of {count} wrong")
    return n_bad > 0


if __name__ == "__main__":
    sys.exit(main())

"""Jittered boxes that fly, spin and vibrate freely through the grid, as explicit `updated` scenes.

`python tests/verification/flying_boxes.py 3` tries as many boxes with every transfer and shape
function and prints what becomes of momentum (over mass times the initial speed), of angular
momentum and of energy; DOSUI_RANKS=3 runs on so many ranks.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
from cut_bodies import read, run

YOUNG, POISSON, SOLID, POROSITY = 1.0e6, 0.3, 1250.0, 0.2
DENSITY = SOLID * (1 - POROSITY)
LAME = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
SHEAR = YOUNG / 2 / (1 + POISSON)
SPEED = float(np.sqrt((LAME + 2 * SHEAR) / DENSITY))  # of waves [m/s]
STEPS = 1500


def box(seed: int, transfer: str, shape: str, steps: int = STEPS) -> SimpleNamespace:
    """5 x 6 cells; one tenth of the wave's speed, turning by as much at its ends, under a load that
    ends after a while."""
    draw = random.Random(seed)
    h = 1.0 / 6
    end = steps * 0.5 * h / SPEED
    v = [0.1 * SPEED * draw.uniform(0.5, 1.0) * draw.choice([-1, 1]) for _ in range(2)]
    per_cell = draw.choice([2, 2, 3])
    text = f"""
&scene title='box {seed}' dimension=2 integrator='explicit' water='none' gravity=0, 0
 deformation='updated' /
&grid spacing={h:.17g} origin={h * draw.random():.17g}, {h * draw.random():.17g}
 shape_function='{shape}' /
&time end_time={end:.17g} output_interval={end / 10:.17g} /
&mechanics transfer='{transfer}' /
&material name='s' young_modulus={YOUNG} poisson_ratio={POISSON} porosity={POROSITY}
 solid_density={SOLID} /
&region name='c' material='s' box_min=0, 0 box_max={5 * h:.17g}, {6 * h:.17g} jitter=0.25
 jitter_seed={seed} particles_per_cell={per_cell} lattice_angle={draw.uniform(-45, 45):.17g}
 shape_angle={draw.uniform(-45, 45):.17g} velocity={v[0]:.17g}, {v[1]:.17g}
 spin={0.1 * SPEED:.17g} pivot={2.5 * h:.17g}, {3 * h:.17g} /
&output name='r' /
"""
    name = f"{seed}: {transfer} {shape} {per_cell} per direction"
    return SimpleNamespace(name=name, text=text)


def sums(path: Path, step: int) -> tuple[np.ndarray, float, float]:
    """Mean velocity, angular momentum about the centre and energy, for unit masses and volumes."""
    data = read(path, step)
    v = data["velocity"]
    with h5py.File(path) as file:
        x = file["VTKHDF/Points"][step * len(v) : (step + 1) * len(v)]
    mean, arm = v.mean(axis=0), x - x.mean(axis=0)
    spin = float((arm[:, 0] * v[:, 2] - arm[:, 2] * v[:, 0]).mean())
    s = data["effective_stress"]
    trace = s[:, :3].sum(axis=1)
    square = (s[:, :3] ** 2).sum(axis=1) + 2 * (s[:, 3:] ** 2).sum(axis=1)
    elastic = (square - POISSON / (1 + POISSON) * trace**2) / (4 * SHEAR) / DENSITY
    return mean, spin, float((0.5 * (v**2).sum(axis=1) + elastic).mean())


def fly(case: SimpleNamespace, program: Path, ranks: int = 1) -> dict[str, float]:
    """Relative changes from the start to the end, and of energy the largest one above."""
    with tempfile.TemporaryDirectory() as name:
        status, output = run(case, Path(name), program, ranks)
        if status != 0:
            print(output.strip().splitlines()[-1])
            return {"status": float(status)}
        every = [sums(Path(name) / "r.vtkhdf", k) for k in range(11)]
    mean, spin, energy = every[0]
    return {
        "momentum": max(float(np.linalg.norm(m - mean)) for m, _, _ in every)
        / float(np.linalg.norm(mean)),
        "angular": abs(every[-1][1] / spin - 1),
        "energy": every[-1][2] / energy - 1,
        "gain": max(e for _, _, e in every) / energy - 1,
    }


def main() -> int:
    """Runs a number of boxes."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    ranks = int(os.environ.get("DOSUI_RANKS", "1"))
    program = Path(os.environ.get("DOSUI", "build/release/bin/dosui")).resolve()
    n_bad = 0
    for shape in ("gimp", "bspline"):
        for transfer in ("apic", "flip", "blend", "pic"):
            for seed in range(1, count + 1):
                case = box(seed, transfer, shape)
                found = fly(case, program, ranks)
                print(
                    f"{case.name}: " + ", ".join(f"{k} {v:.2e}" for k, v in found.items()),
                    flush=True,
                )
                n_bad += not found.get("momentum", 1.0) <= 1e-12
    print(f"{n_bad} wrong")
    return n_bad > 0


if __name__ == "__main__":
    sys.exit(main())

"""The run-out of the slope of test_transfers.py over steps, integrators, stiffness of the water and
grids: rows of the table in docs/verification.md. Minutes, an hour for the grids;
`python run_outs.py [meshes]`."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
from conftest import BIN
from test_transfers import slope

STEPS: list[dict[str, object]] = [
    {"integrator": integrator, "courant": courant}
    for integrator in ("explicit", "semi_implicit")
    for courant in (0.5, 0.25, 0.1)
] + [
    {"integrator": integrator, "water": water}
    for integrator in ("explicit", "semi_implicit")
    for water in (5.0e6, 5.0e8)
]
SOFTENING: tuple[dict[str, object], ...] = (
    {"softening": "softening_displacement = 0.5"},
    {"softening": "softening_displacement = 0.5 softening_width = 1.0"},
    {"softening": "softening_strain = 0.5"},
    {"softening": "", "residual": "", "cohesion": 3.0e3},  # perfectly plastic
)
MESHES: list[dict[str, object]] = [
    soil | {"spacing": spacing, "end": end}
    for soil in SOFTENING
    for spacing in (1.0, 0.5, 0.25)
    for end in (6.0, 12.0)
]


def run_out(changes: dict[str, object]) -> str:
    """A row: the scene's changes, steps, front, 95 % and 99 % quantile [m], what is missing of the
    water that was stored [%]."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "slope.nml"
        scene.write_text(slope(**changes))
        run = subprocess.run(
            [BIN / "dosui2d", scene], cwd=folder, capture_output=True, text=True, check=False
        )
        found = re.search(r"after (\d+) steps", run.stdout)
        row = ", ".join(f"{key} {value}" for key, value in changes.items())
        if run.returncode != 0 or not found:
            return f"| {row} | {run.stderr.splitlines()[-1]} |"
        with h5py.File(Path(folder) / "slope.vtkhdf") as file:
            group = file["History"]
            last = int(group.attrs["n_entries"]) - 1
            keys = ("front", "q95", "q99", "water_stored", "water_inflow", "water_squeezed")
            end = {key: float(group[key][last]) for key in keys}
    missing = end["water_stored"] - end["water_inflow"] - end["water_squeezed"]
    return (
        f"| {row} | {found[1]} | {end['front']:.2f} | {end['q95']:.2f} | {end['q99']:.2f} "
        f"| {100 * abs(missing / end['water_stored']):.2f} |"
    )


if "meshes" in sys.argv:
    for changes in MESHES:
        print(run_out(changes), flush=True)
else:
    for changes in STEPS:
        for transfer in ({}, {"mechanics": "transfer = 'apic'"}):
            print(run_out(changes | transfer), flush=True)

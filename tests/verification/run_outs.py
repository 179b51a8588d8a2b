"""The run-out of the slope of test_transfers.py over steps, integrators, stiffness of the water and
grids: rows of the table in docs/verification.md. Minutes; `python run_outs.py [meshes]`."""

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
MESHES: list[dict[str, object]] = [
    {"spacing": spacing, "softening": softening}
    for softening in ("softening_displacement = 0.5", "softening_strain = 0.5")
    for spacing in (1.0, 0.5, 0.25)
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


for changes in MESHES if "meshes" in sys.argv else STEPS:
    for transfer in ("", "transfer = 'apic'"):
        print(run_out(changes | ({"mechanics": transfer} if transfer else {})), flush=True)

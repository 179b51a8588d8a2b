#!/usr/bin/env python3
"""Memory of a particle by dimension and method: the constants of `src/io/dosui_scene_sizes.f90`.

memory.py [BIN]      BIN: folder of dosui1d, dosui2d, dosui3d; default build/release/bin

Two runs of two steps on boxes of different sizes give the slope in bytes for each particle.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

BIN = Path(sys.argv[1] if len(sys.argv) > 1 else "build/release/bin").resolve()
# method: water, integrator, deformation, linear solver, cells along a side in 1-D, 2-D, 3-D
METHODS = {
    "dry": ("none", "explicit", "small_strain", "auto", (100000, 150, 16)),
    "dry updated": ("none", "explicit", "updated", "auto", (100000, 150, 16)),
    "dry quasi-static": ("none", "quasi_static", "small_strain", "iterative", (40000, 100, 9)),
    "coupled": ("coupled", "explicit", "small_strain", "auto", (2000, 100, 12)),
    "quasi-static, iterative": (
        "coupled",
        "quasi_static",
        "small_strain",
        "iterative",
        (9000, 50, 6),
    ),
    "quasi-static, direct": ("coupled", "quasi_static", "small_strain", "direct", (9000, 40, 4)),
    "semi-implicit": ("coupled", "semi_implicit", "small_strain", "iterative", (9000, 50, 6)),
    "finite": ("coupled", "quasi_static", "finite", "direct", (9000, 30, 3)),
}


def scene(dim: int, n: int, method: str) -> str:
    """A box of n cells along each side with 2 particles a direction."""
    water, integrator, deformation, linear, _ = METHODS[method]
    # a sixth of the way of the water's waves through a cell: two steps must not crush particles
    step = "" if integrator == "quasi_static" else f"time_step = {1e-4 / n!r}"
    text = f"""
&scene dimension = {dim} water = '{water}' integrator = '{integrator}' deformation = '{deformation}'
  gravity = {", ".join(["0"] * (dim - 1) + ["-9.81"])} /
&grid spacing = {1.0 / n!r} shape_function = '{"gimp" if deformation[0] == "u" else "linear"}' /
&time end_time = 1 maximum_steps = 2 {step} /
&material name = 's' young_modulus = 1e7 porosity = 0.3
  {"hydraulic_conductivity = 1e-5" if water == "coupled" else ""} /
&region name = 'b' material = 's' box_min = {", ".join("0" * dim)}
  box_max = {", ".join("1" * dim)} /
&surface name = 'base' region = 'b' face = 'z-' /
&surface name = 'top' region = 'b' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' kind = 'pressure' value = 1e3 /
"""
    if integrator != "explicit":
        text += f"&solver linear = '{linear}' /\n"
    if water == "coupled":
        text += "&hydraulic_condition surface = 'top' kind = 'pressure' value = 0 /\n"
    return text


def memory_of(dim: int, n: int, method: str) -> tuple[int, float]:
    """Particles, and the most memory that the process had [B]."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "s.nml").write_text(scene(dim, n, method))
        process = subprocess.Popen(
            [BIN / f"dosui{dim}d", "s.nml"], cwd=folder, stdout=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            sys.exit(f"{dim}-D {method}: exit status {process.returncode}")
    return (2 * n) ** dim, 1024.0 * usage.ru_maxrss


def main() -> None:
    """A table of slopes."""
    for dim in (1, 2, 3):
        for method, (*_, sides) in METHODS.items():
            few, low = memory_of(dim, sides[dim - 1], method)
            many, high = memory_of(dim, 2 * sides[dim - 1], method)
            slope = (high - low) / (many - few)
            print(f"{dim}-D {method:26s} {many:8d} particles {slope:8.0f} B each", flush=True)


if __name__ == "__main__":
    main()

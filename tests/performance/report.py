"""Writes the benchmark's measurements."""

from __future__ import annotations

import csv
import os
import platform
import subprocess
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmark import Measurement

PAGE = """<!-- Written by tests/performance/benchmark.py: do not edit. -->

# Performance

Measured on {date}: {machine}, {cores} cores.
Program: {version}.
STREAM triad in the same run: {stream}.
**other** is how many cores worked for something else during a run: such lines are upper bounds.

A block of soil in free flight at 0.3 % of its sound speed, loaded on its top, with {per_cell}
particles per cell. `small_strain` scenes use linear hats, `updated` scenes GIMP: their particles
change cells and their neighbourhoods are rebuilt as often as the table says. Coupled scenes take
one water step in every step. Each line is the fastest of {runs} run(s).

- **ns**: core time of a particle-step, wall time x ranks / (particles x steps), with sorting,
  neighbour lists and stencils; without setup, the first of the rebuilds, and files.
- **B**: peak resident memory of a particle: the difference to a run with 500 particles.
- **STREAM**: that memory passed through once a step, as a share of the measured bandwidth. Low
  means that arithmetic or latency limits, not the bandwidth.

| case | ranks | particles | rebuilds / steps | ns | B | STREAM | other |
|---|---|---|---|---|---|---|---|
{rows}

## Where the time goes

ns per particle-step, mean over the ranks, largest size on one rank.

| case | {names} |
|---|{dashes}
{phases}

Again: `cmake --build --preset release --target dosui_stream dosui2d dosui3d`, then
`python tests/performance/benchmark.py`.
"""


def write_csv(path: Path, lines: list[Measurement]) -> None:
    """One row for each measurement."""
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(
            [
                "case",
                "ranks",
                "particles",
                "steps",
                "rebuilds",
                "ns_per_particle_step",
                "bytes_per_particle",
                "stream_GB_s",
                "share_of_stream",
                "other_busy_cores",
            ]
        )
        out.writerows(
            [
                k.case,
                k.ranks,
                k.particles,
                k.steps,
                k.rebuilds,
                f"{k.ns:.2f}",
                f"{k.bytes:.1f}",
                f"{k.stream:.2f}",
                f"{k.share:.4f}",
                f"{k.other:.2f}",
            ]
            for k in lines
        )


def output(*command: str) -> str:
    """What a command prints, or a question mark."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "?"


def write_page(path: Path, lines: list[Measurement], program: Path) -> None:
    """docs/performance.md."""
    if not lines:
        raise SystemExit("nothing was measured")
    cpu = [
        k.split(":", 1)[1].strip()
        for k in Path("/proc/cpuinfo").read_text().splitlines()
        if k.startswith("model name")
    ]
    streams = {k.ranks: k.stream for k in lines}
    largest = {k.case: k for k in lines if k.ranks == 1}
    names = list(dict.fromkeys(name for k in largest.values() for name in k.phases))
    path.write_text(
        PAGE.format(
            date=date.today(),
            machine=cpu[0] if cpu else platform.machine(),
            cores=os.cpu_count(),
            version="; ".join(output(str(program), "--version").splitlines()),
            runs=lines[0].runs,
            stream=", ".join(f"{v:.1f} GB/s on {k} rank(s)" for k, v in streams.items()),
            per_cell="4 (2-D) or 8 (3-D)",
            rows="\n".join(
                f"| {k.case} | {k.ranks} | {k.particles} | {k.rebuilds} / {k.steps} | {k.ns:.0f} |"
                f" {k.bytes:.0f} | {100 * k.share:.0f} % | {k.other:.1f} |"
                for k in lines
            ),
            names=" | ".join(names),
            dashes="---|" * len(names),
            phases="\n".join(
                f"| {k.case} | "
                + " | ".join(f"{k.phases.get(name, 0.0):.1f}" for name in names)
                + " |"
                for k in largest.values()
            ),
        )
    )

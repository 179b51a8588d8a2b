"""Measures dosui: core time and memory of a particle, and its share of the STREAM bandwidth.

    cmake --build --preset release --target dosui_stream dosui2d dosui3d
    python tests/performance/benchmark.py --quick        # 1e4 and 1e5 particles
    python tests/performance/benchmark.py                # 1e4, 1e5 and 1e6: about ten minutes

Prints a table, writes build/performance.csv, and docs/performance.md unless --quick.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from report import write_csv, write_page

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(os.environ.get("DOSUI_BIN", ROOT / "build" / "release" / "bin"))
SPACING = 0.01  # of the grid [m]
PER_CELL = {1: 2, 2: 4, 3: 8}
STEPPED = (
    "geometry",
    "particles to grid",
    "grid halo exchange",
    "nodal update",
    "grid to particles",
    "stress",
    "water",
)  # the phases of a step: no setup, no files


@dataclass
class Case:
    """A block of soil in free flight under a load on its top."""

    dimension: int
    water: bool
    updated: bool
    soil: str = ""
    """more keys of &material"""
    modulus: str = "young_modulus = 1.0e7"
    """of the soil"""
    groups: str = ""
    """more groups"""
    drain: str = "kind = 'head' value = 0.0"
    """keys of the &hydraulic_condition of the top"""
    steps: int = 0
    """of a run; 0: as many as can be measured well"""

    @property
    def label(self) -> str:
        """As it is called in the tables."""
        mode = "updated" if self.updated else "small strain"
        return f"{self.dimension}-D {'coupled' if self.water else 'dry'}, {mode}"

    def scene(self, particles: int, steps: int) -> str:
        """The namelist; the number of particles is rounded to whole cells."""
        d = self.dimension
        width = round((particles / PER_CELL[d]) ** (1 / d)) * SPACING
        vector = ", ".join
        # About 0.3 % of the sound speed: some 30 steps between the rebuilds of an updated scene.
        speed = 5.0 if self.water else 0.3
        flow = "hydraulic_conductivity = 1.0e-6" if self.water else ""
        mode = "updated" if self.updated else "small_strain"
        shape = "gimp" if self.updated else "linear"
        lines = [
            f"&scene dimension = {d} water = '{'coupled' if self.water else 'none'}'",
            "  integrator = 'explicit'",
            f"  deformation = '{mode}' gravity = {vector(['0.0'] * (d - 1) + ['-9.81'])} /",
            f"&grid spacing = {SPACING} shape_function = '{shape}' /",
            f"&time end_time = 1.0e3 maximum_steps = {steps} /",
            f"&material name = 'soil' {self.modulus} poisson_ratio = 0.3 porosity = 0.4",
            f"  {flow} {self.soil} /",
            "&region name = 'block' material = 'soil' particles_per_cell = 2",
            f"  box_min = {vector(['0.0'] * d)} box_max = {vector([f'{width:.6f}'] * d)}",
            f"  velocity = {vector([str(speed)] + ['0.0'] * (d - 1))} /",
            "&surface name = 'top' region = 'block' face = 'z+' /",
            "&mechanical_condition surface = 'top' kind = 'pressure' value = 1000.0 /",
            "&output name = 'benchmark' /",
            self.groups,
        ]
        if self.water:
            lines.append("&water bulk_modulus = 2.2e9 stepping = 'single' /")
            lines.append(f"&hydraulic_condition surface = 'top' {self.drain} /")
        return "\n".join(lines) + "\n"


@dataclass
class Measurement:
    """One line of the table."""

    case: str
    ranks: int
    particles: int
    steps: int
    rebuilds: int
    ns: float  # core time of a particle-step: wall time x ranks / (particles x steps)
    bytes: float  # peak resident memory of a particle
    stream: float  # GB/s of all ranks together
    share: float  # of that: the memory of all particles passed through once in every step
    other: float  # cores that worked for something else meanwhile
    runs: int  # of which this is the fastest
    phases: dict[str, float]  # ns, mean over the ranks


def busy_seconds() -> float:
    """Processor time that the machine has spent on other things than our children [s]."""
    fields = [int(k) for k in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    total = (sum(fields) - fields[3] - fields[4]) / os.sysconf("SC_CLK_TCK")  # idle, iowait
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    return total - own.ru_utime - own.ru_stime


def run(case: Case, particles: int, steps: int, ranks: int) -> tuple[str, float, float]:
    """Output of one run, peak memory of its ranks together [B], other busy cores."""
    program = str(BIN / "dosui")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "scene.nml").write_text(case.scene(particles, steps))
        # The wrapper reports the peak memory of the one rank that it starts.
        command = [sys.executable, __file__, "--rank", folder, program, "scene.nml"]
        if ranks > 1:
            command = ["mpirun", "-n", str(ranks), *command]
        begin, busy = time.monotonic(), busy_seconds()
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        other = (busy_seconds() - busy) / (time.monotonic() - begin)
        if done.returncode != 0:
            raise SystemExit(f"{case.label}: {done.stdout}{done.stderr}")
        peak = sum(float(file.read_text()) for file in path.glob("*.peak"))
    return done.stdout, peak, max(0.0, other)


def measure(case: Case, particles: int, ranks: int, repeat: int, stream: float) -> Measurement:
    """The fastest of some runs."""
    steps = case.steps or max(
        120 if case.updated else 40, min(400, round((1e7 if case.water else 2e7) / particles))
    )
    _, base, _ = run(case, 500, 10, ranks)
    best: Measurement | None = None
    for _ in range(repeat):
        text, peak, other = run(case, particles, steps, ranks)
        n = int(re.search(r"particles +(\d+)", text)[1])
        done = int(re.search(r"after (\d+) steps", text)[1])
        mean = {
            name: float(value)
            for name, value in re.findall(r"(?m)^ {2}(\S[a-z ]*?) +[\d.]+ +([\d.]+) +[\d.]+$", text)
        }
        phases = {k: 1e9 * mean[k] * ranks / (n * done) for k in STEPPED if k in mean}
        phases.setdefault("geometry", 0.0)  # too short to be printed
        rebuilds = int(re.search(r"rebuilds (\d+)", text)[1])
        phases["geometry"] *= (rebuilds - 1) / rebuilds  # the first build is setup
        ns = sum(phases.values())
        size = (peak - base) / (n - 500)
        share = size / ns * ranks / stream
        line = Measurement(
            case=case.label,
            ranks=ranks,
            particles=n,
            steps=done,
            rebuilds=rebuilds,
            ns=ns,
            bytes=size,
            stream=stream,
            share=share,
            other=other,
            runs=repeat,
            phases=phases,
        )
        if best is None or line.ns < best.ns:
            best = line
    assert best is not None
    return best


def main() -> None:
    """Runs all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="1e4 and 1e5 particles only")
    parser.add_argument("--only", default="", help="cases whose label contains this")
    parser.add_argument("--repeat", type=int, default=2, help="runs of a case; the fastest counts")
    parser.add_argument("--page", action="store_true", help="write docs/performance.md")
    arguments = parser.parse_args()
    sizes = [10**4, 10**5] if arguments.quick else [10**4, 10**5, 10**6]
    lines: list[Measurement] = []
    for ranks in (1, 2):
        launch = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        stream = float(subprocess.check_output([*launch, str(BIN / "dosui_stream")], text=True))
        print(f"STREAM triad on {ranks} rank(s): {stream:.1f} GB/s", flush=True)
        for d in (2, 3):
            for water in (False, True):
                for updated in (False, True):
                    case = Case(d, water, updated)
                    if arguments.only not in case.label:
                        continue
                    for size in sizes:
                        line = measure(case, size, ranks, arguments.repeat, stream)
                        lines.append(line)
                        print(
                            f"{line.case:28s} {ranks:2d} ranks {line.particles:8d} particles"
                            f" {line.ns:7.1f} ns {line.bytes:6.0f} B {100 * line.share:5.1f} %"
                            f"  other work {line.other:.2f} cores",
                            flush=True,
                        )
    (ROOT / "build").mkdir(exist_ok=True)
    write_csv(ROOT / "build" / "performance.csv", lines)
    (ROOT / "build" / "performance.json").write_text(json.dumps([asdict(k) for k in lines]))
    if arguments.page or not (arguments.quick or arguments.only):
        write_page(ROOT / "docs" / "performance.md", lines, BIN / "dosui2d")


def one_rank(folder: str, command: list[str]) -> None:
    """Runs one rank and leaves its peak memory [B] in the folder."""
    pid = os.posix_spawnp(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    (Path(folder) / f"{pid}.peak").write_text(str(1024 * usage.ru_maxrss))
    sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--rank"]:
        one_rank(sys.argv[2], sys.argv[3:])
    else:
        main()

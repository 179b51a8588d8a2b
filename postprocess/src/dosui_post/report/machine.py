"""The machine and the program that are measured."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from dosui_post.errors import DosuiPostError
from dosui_post.report.process import run

_STREAM_RUNS = 3  # the best counts
_LIMIT = 120.0  # of the helpers [s]


@dataclass(frozen=True)
class Program:
    """dosui as it is installed."""

    path: Path
    version: str
    """what --version prints"""
    digest: str
    """hash of its files: --version does not tell one uncommitted change from another"""
    mpirun: tuple[str, ...] = ("mpirun",)

    def command(self, ranks: int, *arguments: str) -> list[str]:
        """The command line."""
        return [*self.launch(ranks), str(self.path), *arguments]

    def launch(self, ranks: int) -> list[str]:
        """What starts several ranks."""
        return [*self.mpirun, "-n", str(ranks)] if ranks > 1 else []

    @property
    def identity(self) -> str:
        """Part of the key of a run."""
        return f"{self.version}\n{self.digest}"


def find_program(path: Path | None) -> Path:
    """The given program, or dosui on PATH."""
    found = path or shutil.which("dosui")
    if found is None:
        raise DosuiPostError("dosui is not on PATH: give --program PATH")
    return Path(found)


def program_at(path: Path, mpirun: Sequence[str] = ("mpirun",)) -> Program:
    """Asks the program for its version."""
    path = path.resolve()
    if not path.is_file():
        raise DosuiPostError(f"no program {path} (--program)")
    outcome = run([str(path), "--version"], path.parent, _LIMIT)
    if outcome.status != 0:
        raise DosuiPostError(f"{path} --version: {outcome.last_words()}")
    digest = hashlib.sha256()
    for file in (path, path.with_name(f"{path.name}2d")):
        if file.is_file():
            digest.update(file.read_bytes())
    return Program(path, outcome.output.strip(), digest.hexdigest(), tuple(mpirun))


@dataclass
class Machine:
    """What the wall times depend on."""

    cpu: str
    cores: int
    memory: float
    """[GB]"""
    system: str
    load: float
    """processes that were running when the report began, mean of a minute"""
    stream: dict[str, float] = field(default_factory=dict)
    """STREAM triad over ranks [GB/s]"""

    def bandwidth(self) -> str:
        """For titles and the page."""
        if not self.stream:
            return "STREAM triad not measured"
        parts = [
            f"{value:.1f} GB/s on {ranks} rank{'s' if ranks != '1' else ''}"
            for ranks, value in self.stream.items()
        ]
        return "STREAM triad " + ", ".join(parts)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def this_machine() -> Machine:
    """Processor, cores, memory, system; no bandwidth yet."""
    return Machine(
        cpu=_cpu_name(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else _cores(),
        memory=_memory(),
        system=f"{platform.system()} {platform.release()}",
        load=os.getloadavg()[0],
    )


def stream_bandwidth(program: Program, ranks: Iterable[int]) -> dict[str, float]:
    """STREAM triad [GB/s] of `dosui_stream` beside the program; empty without it."""
    stream = program.path.with_name("dosui_stream")
    found: dict[str, float] = {}
    if not stream.is_file():
        return found
    with tempfile.TemporaryDirectory() as folder:
        for count in sorted(set(ranks)):
            for _ in range(_STREAM_RUNS):
                outcome = run([*program.launch(count), str(stream)], Path(folder), _LIMIT)
                number = re.search(r"\d+(\.\d+)?", outcome.output)
                if outcome.status == 0 and number is not None:
                    found[str(count)] = max(float(number[0]), found.get(str(count), 0.0))
    return found


def _cpu_name() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        text = ""
    name = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return name[1].strip() if name else platform.processor() or platform.machine()


def _cores() -> int:
    return os.cpu_count() or 1


def _memory() -> float:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1.0e9
    except (ValueError, OSError):
        return 0.0

"""Finished runs, a line of JSON each: what an interrupted report goes on from."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path

DONE, REFUSED, ESTIMATED, TIMEOUT, FAILED = "done", "refused", "estimated", "timeout", "failed"


@dataclass
class Run:
    """One measured, refused or estimated run."""

    key: str
    """hash of scene, program and ranks"""
    scene: str
    method: str
    spacing: float
    """[m]"""
    control: str
    ranks: int
    state: str
    message: str = ""
    particles: int = 0
    """particles, or nodes of finite elements"""
    steps: float = 0.0
    wall: float = 0.0
    """wall time of the whole process [s]"""
    cpu: float = 0.0
    """processor time of all ranks [s]"""
    startup: float = 0.0
    """wall time of the same process with --check [s]"""
    errors: dict[str, float] = field(default_factory=dict)
    """relative L2 error of the pressure over T"""
    repeats: int = 1
    """runs, of which this is the fastest"""
    when: str = ""
    """date"""
    program: str = ""
    """name and version"""

    @property
    def error(self) -> float:
        """The largest error over the time factors; NaN without any or with one."""
        values = list(self.errors.values())
        if not values or any(math.isnan(value) for value in values):
            return math.nan
        return max(values)

    @property
    def particle_steps(self) -> float:
        """Particles times time steps."""
        return self.particles * self.steps

    @property
    def is_measured(self) -> bool:
        """A finished run with an error."""
        return self.state == DONE and math.isfinite(self.error)


class Store:
    """The file of finished runs; the last line of a key counts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._runs: dict[str, Run] = {}
        if path.exists():
            self._read(path.read_text(encoding="utf-8"))

    def _read(self, text: str) -> None:
        for line in text.splitlines():
            try:
                run = Run(**json.loads(line))
            except (ValueError, TypeError):
                continue  # torn by a kill, or of another version: is run again
            self._runs[run.key] = run

    def get(self, key: str) -> Run | None:
        """The run of a key."""
        return self._runs.get(key)

    def add(self, run: Run) -> None:
        """Appends a run and writes it at once."""
        self._runs[run.key] = run
        self.path.parent.mkdir(parents=True, exist_ok=True)
        is_torn = self.path.exists() and not self.path.read_bytes().endswith(b"\n")
        with self.path.open("a", encoding="utf-8") as file:
            file.write(("\n" if is_torn else "") + json.dumps(asdict(run)) + "\n")

"""Starts programs: timed, limited, and gone when the report is interrupted."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dosui_post.errors import DosuiPostError


@dataclass
class Outcome:
    """What a process did."""

    status: int | None
    """exit status; None after too long a time"""
    output: str
    complaint: str
    """what it wrote to standard error"""
    wall: float
    """[s]"""
    cpu: float
    """[s]"""

    def last_words(self) -> str:
        """One line for a table."""
        lines = [line.strip() for line in (self.complaint or self.output).splitlines()]
        lines = [line for line in lines if line]
        if any(line.startswith("Traceback") for line in lines):
            return next((line for line in lines if "Error" in line), lines[-1])
        return lines[0] if lines else f"exit status {self.status}"


def run(command: Sequence[str], folder: Path, limit: float) -> Outcome:
    """Runs a command in a folder; it and its children are ended after `limit` seconds."""
    before = _children()
    begin = time.perf_counter()
    try:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except OSError as error:
        raise DosuiPostError(f"cannot start {command[0]}: {error.strerror}") from error
    try:
        output, complaint = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        _end(process)
        return Outcome(None, "", "", time.perf_counter() - begin, _children() - before)
    except BaseException:
        _end(process)
        raise
    wall = time.perf_counter() - begin
    return Outcome(process.returncode, output, complaint, wall, _children() - before)


def _end(process: subprocess.Popen[str]) -> None:
    """Ends a process with its children: asked first, so that mpirun can end its ranks."""
    for sign, patience in ((signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0)):
        try:
            os.killpg(process.pid, sign)
        except ProcessLookupError:
            break
        try:
            process.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            continue
        break


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime

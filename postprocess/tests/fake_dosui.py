"""Stands in for dosui: exact pressures with an error of dx², or whatever FAKE_* asks for."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

VERSION = "dosui 9.9.9 (0123456789ab, Release)\ncompiler GNU 12.2.0"


def log(word: str) -> None:
    """A line for the test."""
    with Path(os.environ["FAKE_LOG"]).open("a") as file:
        file.write(word + "\n")


def compute(text: str, name: Path) -> int:
    """Writes the result; returns the steps."""
    import numpy as np  # slow to import: not for --version and --check
    import synthetic

    from dosui_post.case import ColumnCase, MandelCase, _build
    from dosui_post.result import Scene

    text = text.replace("&water ", "&water unit_weight = 9810.0 ")  # a default, as in the echo
    scene = Scene(text, text)
    case = _build(scene)
    assert isinstance(case, ColumnCase | MandelCase)
    spacing = scene.one("grid").number("spacing")
    width, height = scene.one("region").numbers("box_max")
    points = synthetic.lattice(width, height, spacing)
    group = scene.one("time")
    times = [0.0, *group.numbers("output_times"), group.number("end_time")]
    error = float(os.environ.get("FAKE_ERROR", "1.0")) * spacing**2
    steps = [
        synthetic.Step(t, points, {"pore_pressure": (1 + error) * case.pressure(points, t)})
        for t in times
    ]
    if "FAKE_NAN" in os.environ:
        steps[-1].fields["pore_pressure"] = np.full(len(points), np.nan)
    synthetic.write_result(name, text, steps)
    return round(10 / spacing)


def main() -> int:
    """As the real one: status 2 for bad input, 3 never."""
    arguments = sys.argv[1:]
    if "--version" in arguments:
        print(VERSION)
        return 0
    text = Path("scene.nml").read_text()
    if "integrator = 'semi_implicit'" in text:
        sys.stderr.write("scene.nml:1: &scene integrator = 'semi_implicit': must be 'explicit'\n")
        return 2
    if "--check" in arguments:
        print("particles    400 (2-D)\ntime step 1 s, limited by sound; about 1.3e9 steps")
        return 0
    log("run")
    if "FAKE_CRASH" in os.environ:
        sys.stderr.write("\n  no such luck\n")
        return 1
    if os.environ.get("FAKE_HANG"):
        log(f"pid {os.getpid()}")
        time.sleep(60)
    count = Path(os.environ["FAKE_LOG"]).read_text().count("run")
    if str(count) == os.environ.get("FAKE_INTERRUPT_AT"):
        os.kill(int(os.environ["FAKE_PARENT"]), signal.SIGTERM)
        time.sleep(60)
    steps = compute(text, Path("result.vtkhdf"))
    print(f"finished at t = 1 s after {steps} steps")
    return 0


if __name__ == "__main__":
    sys.exit(main())

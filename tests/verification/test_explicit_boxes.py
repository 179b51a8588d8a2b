"""Explicit steps of boxes off the grid: a few of `explicit_boxes.py` and `flying_boxes.py`."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from cut_bodies import read, run
from explicit_boxes import BOUND, RESTS, attempt, trial
from flying_boxes import box, fly

PROGRAM = Path(os.environ.get("DOSUI_BIN", ROOT / "build" / "release" / "bin")) / "dosui"


@pytest.mark.parametrize("seed", [4, 242, 267, 308])
def test_random_boxes(seed: int) -> None:
    """Vibrations stay bounded, damped boxes come to rest in the exact stress; some of these blew up
    with longer steps or without the extension."""
    one = trial(seed, "flip" if seed in (242, 267, 308) else "")
    is_good, found = attempt(one, PROGRAM)
    assert is_good, f"{one.name}: {found}, not {RESTS if one.damped else BOUND}"


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_flying_box(transfer: str) -> None:
    """Momentum but for what light nodes lose; angular momentum of APIC within a per cent; energy
    falls."""
    found = fly(box(1, transfer, "gimp", steps=300), PROGRAM)
    assert found["momentum"] <= 1e-6
    assert found["angular"] <= (0.01 if transfer == "apic" else 0.3)
    assert -0.1 <= found["energy"] <= 0.0
    assert found["gain"] <= 5e-3


def test_ranks(tmp_path: Path) -> None:
    """The same on three ranks: a box in small strains, a flying one in `updated` steps."""
    held = trial(17, "apic").case
    held.text = re.sub(r"end_time=\S+ output_interval=(\S+)", r"end_time=\1", held.text)
    for name, case in (("held", held), ("flying", box(2, "apic", "gimp", 60))):
        fields = []
        for ranks in (1, 3):
            folder = tmp_path / f"{name}{ranks}"
            folder.mkdir()
            status, output = run(case, folder, PROGRAM, ranks)
            assert status == 0, output
            fields.append(read(folder / "r.vtkhdf", -1))
        for key in ("displacement", "velocity", "effective_stress"):
            scale = np.abs(fields[0][key]).max()
            assert np.abs(fields[0][key] - fields[1][key]).max() <= 1e-11 * scale

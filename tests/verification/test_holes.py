"""Regions with holes: volumes, faces, flow between a hole and the outside."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from conftest import Runner

SQUARE = "0.5, 0.5, 1.5, 0.5, 1.5, 1.5, 0.5, 1.5"


SIDES = ["left", "right", "base", "top"]


def frame(region: str = "", hole: str = SQUARE, spacing: float = 0.1) -> str:
    """A square frame, water enters through its hole."""
    return f"""
&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = {spacing} /
&time end_time = 1.0e6 /
&material name = 'soil' rigid = .true. porosity = 0.3 hydraulic_conductivity = 1.0e-5 /
&water bulk_modulus = 2.2e9 /
&region name = 'frame' material = 'soil' box_min = 0.0, 0.0 box_max = 2.0, 2.0 {region} /
&hole region = 'frame' vertices = {hole} /
&surface name = 'left' region = 'frame' face = 'x-' /
&surface name = 'right' region = 'frame' face = 'x+' /
&surface name = 'base' region = 'frame' face = 'z-' /
&surface name = 'top' region = 'frame' face = 'z+' /
&surface name = 'inner' region = 'frame' face = 'hole1' /
&hydraulic_condition surface = 'inner' kind = 'head' value = 1.0 /
&hydraulic_condition surface = 'left' kind = 'head' value = 0.0 /
&hydraulic_condition surface = 'right' kind = 'head' value = 0.0 /
&hydraulic_condition surface = 'base' kind = 'head' value = 0.0 /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'frame' /
"""


@pytest.mark.parametrize("ranks", [1, 3])
def test_flow_through_a_frame(dosui: Runner, ranks: int) -> None:
    """Steady heads are harmonic: against finite differences, and the exact discharge."""
    n = 40  # half spacing of the particles' lattice
    head = np.zeros((2 * n + 1, 2 * n + 1))
    hole = np.zeros_like(head, dtype=bool)
    hole[n // 2 : 3 * n // 2 + 1, n // 2 : 3 * n // 2 + 1] = True
    head[hole] = 1.0
    omega = 1.93  # over-relaxation by colours
    i, j = np.indices(head.shape)
    free = ~hole & (i > 0) & (j > 0) & (i < 2 * n) & (j < 2 * n)
    colours = [free & ((i + j) % 2 == c) for c in (0, 1)]
    for _ in range(600):
        for rows in colours:
            around = sum(np.roll(head, s, axis=a) for s in (1, -1) for a in (0, 1))
            head[rows] += omega * (0.25 * around[rows] - head[rows])
    run = dosui(frame(), ranks=ranks)
    assert run.status == 0, run.stderr
    fields = run.fields("frame")
    assert len(fields["id"]) == 1200
    assert fields["volume"].sum() == pytest.approx(3.0, rel=1e-12)
    nodes = np.rint(fields["points"][:, [0, 2]] * n).astype(int)
    right = head[nodes[:, 0], nodes[:, 1]]
    assert np.abs(fields["head"] - right).max() <= 4.0e-2  # r^(2/3) at the corners
    assert np.linalg.norm(fields["head"] - right) <= 1.2e-2 * np.linalg.norm(right)
    with h5py.File(run.folder / "frame.vtkhdf") as file:
        assert {f"inflow_{name}" for name in ("inner", *SIDES)} <= set(file["History"])
    time = run.history("frame", "time")
    rates = []
    for names in (["inner"], SIDES):
        entered = sum(run.history("frame", f"inflow_{name}") for name in names)
        rates.append((entered[-1] - entered[-2]) / (time[-1] - time[-2]))
    # 10.2341: capacitance of a square coaxial line of ratio 1/2 (Bowman 1935)
    assert rates[0] == pytest.approx(10.2341e-5, rel=2.0e-2)
    assert rates[1] == pytest.approx(-10.2341e-5, rel=1.0e-2)


def test_turned_frame_keeps_its_volume(dosui: Runner) -> None:
    """The hole turns with its region; clockwise corners are as good."""
    text = frame(
        "shape_angle = 30.0 lattice_angle = 30.0", "0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5, 0.5"
    )
    run = dosui(text)
    assert run.status == 0, run.stderr
    fields = run.fields("frame")
    angle = np.radians(30.0)
    x, z = fields["points"][:, 0], fields["points"][:, 2]
    own = np.array([np.cos(angle) * x + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * x])
    assert fields["volume"].sum() == pytest.approx(3.0, rel=1e-12)
    assert np.abs(own - 1.0).max(axis=0).min() >= 0.5


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SQUARE, "0.5, 0.5, 2.5, 0.5, 1.5, 1.5", "outside the region"),
        (SQUARE, "0.5, 0.5, 1.5, 0.5", "at least 3 corners"),
        (SQUARE, "0.5, 0.5, 1.5, 1.5, 1.5, 0.5, 0.5, 1.5", "crosses or touches itself"),
        ("&hole region = 'frame'", "&hole region = 'fram'", "no &region is called so"),
        ("face = 'hole1'", "face = 'hole2'", "hole1"),
    ],
)
def test_bad_holes(dosui: Runner, old: str, new: str, message: str) -> None:
    """Named with their lines."""
    run = dosui(frame().replace(old, new), "--check")
    assert run.status == 2
    assert message in run.stderr

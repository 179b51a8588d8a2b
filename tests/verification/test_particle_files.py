"""Particles that come from a table instead of a lattice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Runner, scene_text
from dosui_post.exact import Soil, Terzaghi

COLUMN = "terzaghi/scene_2d_pure_water.nml"


def column(path: Path | str, **keys: str) -> str:
    """The shipped column with particles of a file."""
    text = scene_text(COLUMN, **keys)
    return text.replace("  particles_per_cell = 1\n", f"  particle_file = '{path}'\n")


def test_lattice_from_a_file(dosui: Runner, tmp_path: Path) -> None:
    """The particles of a lattice, read back, give the same run; 3 ranks too."""
    text = scene_text(COLUMN, end_time="4415.17", output_times="4415.17")
    lattice = dosui(text, folder="lattice").fields("terzaghi_pure_water")
    order = np.argsort(lattice["id"])
    x, _, z = lattice["points"][order].T  # small strains: where they started
    volume = lattice["volume"][order]
    path = tmp_path / "particles.csv"
    rows = [f'{a!r}, 7, "{c!r}", {b!r}' for a, b, c in np.stack([x, z, volume], 1).tolist()]
    path.write_text("\n".join(["# drawn by hand", '"X", note, "Volume", z', *rows]))
    for ranks in (1, 3):
        run = dosui(
            column(path, end_time="4415.17", output_times="4415.17"),
            ranks=ranks,
            folder=f"file{ranks}",
        )
        assert run.status == 0, run.stderr
        fields = run.fields("terzaghi_pure_water")
        again = fields["pore_pressure"][np.argsort(fields["id"])]
        right = lattice["pore_pressure"][order]
        assert np.abs(again - right).max() <= 1e-10 * np.abs(right).max()


def test_scattered_particles_drain(dosui: Runner, tmp_path: Path) -> None:
    """Places without volumes, no lattice at all: Terzaghi's pressures."""
    random = np.random.default_rng(3)
    i, j = np.indices((12, 47))
    x = (i + 0.5 + 0.25 * (2 * random.random(i.shape) - 1)) * 0.25 / 12
    z = (j + 0.5 + 0.25 * (2 * random.random(i.shape) - 1)) / 47
    path = tmp_path / "scattered.txt"
    np.savetxt(path, np.column_stack([x.ravel(), z.ravel()])[random.permutation(x.size)])
    run = dosui(column(path, spacing="0.05"), ranks=2)
    assert run.status == 0, run.stderr
    exact = Terzaghi(Soil(1.0e6, 0.2, 0.3, 1.0e-7, 2.2e9, 9810.0), load=1000.0, length=1.0)
    for number, time in enumerate((4415.17, 8830.34, 17660.7, 44151.7), start=1):
        fields = run.fields("terzaghi_pure_water", number)
        right = exact.pressure(1.0 - fields["points"][:, 2], time)
        assert np.abs(fields["pore_pressure"] - right).max() <= 1e-2 * exact.load


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("0.1 0.5\n0.3 0.5\n", "line 2: lies outside the region 'column'"),
        ("0.1, 0.5\n0.1 0.6\n\n0.1;0.5\n", "lines 1 and 4 hold the same place"),
        ("0.1 0.5\n0.1 zwei\n", "line 2, column 2 (z) = 'zwei': must be a number"),
        ("0.1 0.5\n0.1\n", "line 2: has 1 columns, the first line has 2"),
        ("0.1 nan\n", "line 1, column 2 (z) = 'nan': must be a finite number"),
        ("/ 0.5\n", "line 1, column 1 (x) = '/': must be a number"),
        ("x y\n0.1 0.5\n", "has no column 'z'"),
        ("0.1 0.5 0.2 0.3\n", "has 4 columns, not 2 or 3"),
        ("0.1 0.5 0.2\n", "make up 0.8"),
        ("0.1 0.5 -0.2\n", "line 1, column 3 (volume) = '-0.2': the volume must be positive"),
        ("# nothing\n", "holds no particles"),
        (None, "no such file"),
    ],
)
def test_tables_that_cannot_be(
    dosui: Runner, tmp_path: Path, table: str | None, message: str
) -> None:
    """Named with the line of the table, on all ranks."""
    path = tmp_path / "table.csv"
    if table is not None:
        path.write_text(table)
    run = dosui(column(path), "--check", ranks=2)
    assert run.status == 2, run.stdout
    assert message in run.stderr
    assert "particle_file" in run.stderr


def test_keys_of_a_lattice(dosui: Runner, tmp_path: Path) -> None:
    """Jitter, turns and counts per cell belong to lattices."""
    path = tmp_path / "table.csv"
    path.write_text("0.1 0.5\n")
    for key in ("jitter = 0.2", "lattice_angle = 5.0", "particles_per_cell = 2"):
        text = column(path).replace("  particle_file", f"  {key}\n  particle_file")
        run = dosui(text, "--check")
        assert run.status == 2, run.stdout
        assert key.split()[0] in run.stderr

"""Element tests: reading the table, invariants, pictures."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from dosui_post.cli import main
from dosui_post.errors import DosuiPostError
from dosui_post.material import draw_tests, parse_tests

HEADING = (
    "material,test,step,strain_xx,strain_yy,strain_zz,strain_zx,stress_xx,stress_yy,stress_zz,"
    "stress_zx,pore_pressure\n"
)


def table() -> str:
    """Triaxial compression of an elastic soil, E = 10 MPa, nu = 0.25, and a sheared sample."""
    lines = [HEADING]
    for k in range(11):
        e = -0.01 * k
        lines.append(
            f"sand,triaxial_drained,{k},{-0.25 * e},{-0.25 * e},{e},0,-1e5,-1e5,{-1e5 + 1e7 * e},"
            "0,0\n"
        )
    for k in range(11):
        g = 0.01 * np.sin(np.pi * k / 4)
        lines.append(f"sand,cyclic_shear_undrained,{k},0,0,0,{g},-1e5,-1e5,-1e5,{4e6 * g},0\n")
    return "".join(lines)


def test_invariants() -> None:
    test = parse_tests(table())[0]
    assert (test.material, test.name) == ("sand", "triaxial_drained")
    assert test.mean[-1] == pytest.approx(1e5 + 1e6 / 3)
    assert test.deviatoric[-1] == pytest.approx(1e6)
    assert test.volume_strain[-1] == pytest.approx(-0.05)
    shear = parse_tests(table())[1]
    assert shear.deviatoric[1] == pytest.approx(np.sqrt(3) * 4e4 * np.sqrt(0.5))
    assert shear.cycled[2] == pytest.approx(4e4)
    assert shear.cycles[[0, 2, 6]] == pytest.approx([0.0, 0.5, 1.0])  # at its turns
    assert np.all(np.diff(shear.cycles) >= 0)
    assert test.cycled[-1] == pytest.approx(1e6)


def test_pictures(tmp_path: Path) -> None:
    path = draw_tests(parse_tests(table()), "sand", tmp_path / "sand.png")
    assert path.stat().st_size > 10_000
    with pytest.raises(DosuiPostError, match="known: sand"):
        draw_tests(parse_tests(table()), "clay", tmp_path / "clay.png")


def test_tables_that_are_none() -> None:
    with pytest.raises(DosuiPostError, match="not a table"):
        parse_tests("hello\n")
    with pytest.raises(DosuiPostError, match="no soil"):
        parse_tests(HEADING)


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "dosui"
    (tmp_path / "table.csv").write_text(table())
    program.write_text(f"#!/bin/sh\ncat {tmp_path}/table.csv\n")
    os.chmod(program, 0o755)
    scene = tmp_path / "slope.nml"
    scene.write_text("")
    monkeypatch.chdir(tmp_path)
    assert main(["material", str(scene), "--program", str(program)]) == 0
    assert (tmp_path / "slope_sand.png").exists()
    program.write_text("#!/bin/sh\necho 'error: bad scene' >&2\nexit 2\n")
    assert main(["material", str(scene), "--program", str(program)]) == 2

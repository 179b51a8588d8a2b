"""Uniform stresses and smooth fields in bodies that lie anywhere in the grid (short forms)."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN
from cut_bodies import DRY, WET, errors, patch, read, run
from cut_fields import Field, solve

PROGRAM = BIN / "dosui"


@pytest.mark.parametrize("seed", [*range(1, 11), 104, 207, 222])
def test_uniform_stress_in_boxes_anywhere(tmp_path: Path, seed: int) -> None:
    """Dry, undrained, turned, jittered, with walls on lines of the grid and off them, finite."""
    case = patch(seed, 3 if seed in (5, 104) else 2)
    status, output = run(case, tmp_path, PROGRAM)
    assert status == 0, output
    found = errors(case, tmp_path / "r.vtkhdf")
    assert max(found.values()) <= (WET if case.wet else DRY), f"{case.name}: {found}"


@pytest.mark.parametrize("seed", [5, 9, 17])
def test_ranks_agree(tmp_path: Path, seed: int) -> None:
    """Parts, groups and nodes that follow others are the same on any number of ranks."""
    case = patch(seed, 2)
    data = []
    for ranks in (1, 3):
        folder = tmp_path / str(ranks)
        folder.mkdir()
        status, output = run(case, folder, PROGRAM, ranks)
        assert status == 0, output
        fields = read(folder / "r.vtkhdf", -1)
        data.append((fields, np.argsort(fields["id"])))
    for key in ("displacement", "effective_stress") + (("pore_pressure",) if case.wet else ()):
        one, three = (fields[key][order] for fields, order in data)
        assert np.abs(one - three).max() <= 1e-11 * np.abs(one).max(), key


@pytest.mark.parametrize("wet", [False, True])
def test_order_of_smooth_fields(wet: bool) -> None:
    """A turned box of jittered particles: second order in displacements, first in pressures."""
    coarse, fine = (solve(Field(1, n, wet, 0.3, 33.0, 0.25, 33.0), PROGRAM) for n in (6, 12))
    assert fine["u"] <= coarse["u"] / 2**1.6, (coarse, fine)
    assert fine["u"] <= (2.5e-2 if wet else 7e-3)
    if wet:
        assert fine["p"] <= coarse["p"] / 2, (coarse, fine)
        assert fine["p"] <= 8e-2
        assert fine["worst p"] <= 0.17


def test_thin_bodies_are_warned_of(tmp_path: Path) -> None:
    """Less than two cells between grid lines; none if the lines follow the faces."""
    case = patch(17, 2)
    for size, warns in (("0.8, 1", False), ("0.8, 0.1", True)):
        case.text = case.text.replace(
            "box_max=" + case.text.split("box_max=")[1].split(" part")[0], f"box_max={size}"
        )
        _, output = run(case, tmp_path, PROGRAM)
        assert ("grid cells across" in output) == warns, output


def test_loose_nodes_are_warned_of(tmp_path: Path) -> None:
    """Nodes that lead in some directions only; the warning names one beside the body."""
    for top, warns in (("1.3", False), ("1.07", True)):
        text = f"""&scene dimension=2 integrator='quasi_static' gravity=0, 0 /
&grid spacing=0.1 origin=0.04, 0.03 shape_function='linear' /
&time end_time=1 /
&material name='s' young_modulus=1e6 poisson_ratio=0.3 porosity=0.3 /
&region name='c' material='s' box_min=5, 1 box_max=6, {top} particles_per_cell=2 /
&surface name='x-' region='c' face='x-' /
&mechanical_condition surface='x-' kind='fixed' /
&output name='r' /
"""
        (tmp_path / "scene.nml").write_text(text)
        done = subprocess.run(
            [str(PROGRAM), "scene.nml"], cwd=tmp_path, capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stdout + done.stderr
        output = done.stdout + done.stderr
        found = re.search(r"in some directions only, the first at \(([\d.]+), ([\d.]+)\) m", output)
        assert (found is not None) == warns, output
        if found:
            x, z = (float(found[k]) for k in (1, 2))
            assert 4.9 <= x <= 6.1 and 0.9 <= z <= 1.23, output
            for place, start in ((x, 0.04), (z, 0.03)):
                assert abs((place - start) / 0.1 - round((place - start) / 0.1)) <= 1e-6, output


@pytest.mark.parametrize("shape", ["linear", "bspline"])
@pytest.mark.parametrize(
    ("region", "unseen"),
    [("", False), ("jitter=0.25 jitter_seed=8", True), ("lattice_angle=8", True)],
)
def test_weight_with_one_particle_a_cell(
    tmp_path: Path, shape: str, region: str, unseen: bool
) -> None:
    """Rows of cells without particle moved by metres, single ones by the whole displacement."""
    young, poisson, density, gravity, depth = 1.0e6, 0.3, 1400.0, 9.81, 0.52
    (tmp_path / "scene.nml").write_text(
        f"""&scene dimension=2 integrator='quasi_static' gravity=0, {-gravity} water='none' /
&grid spacing=0.1 origin=0.043, 0.058 shape_function='{shape}' /
&time end_time=1 /
&material name='s' young_modulus={young} poisson_ratio={poisson} porosity=0.3
  solid_density={density / 0.7} /
&region name='c' material='s' box_min=0, 0 box_max=1.07, {depth} particles_per_cell=1 {region} /
&surface name='x-' region='c' face='x-' /
&surface name='x+' region='c' face='x+' /
&surface name='z-' region='c' face='z-' /
&mechanical_condition surface='x-' kind='roller' /
&mechanical_condition surface='x+' kind='roller' /
&mechanical_condition surface='z-' kind='roller' /
&output name='r' /
"""
    )
    done = subprocess.run(
        [str(PROGRAM), "scene.nml"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("hold no particle" in done.stdout + done.stderr) == unseen
    data = read(tmp_path / "r.vtkhdf", -1)
    moved = data["displacement"][:, 2]
    z = data["points"][:, 2] - moved
    modulus = young * (1 - poisson) / (1 + poisson) / (1 - 2 * poisson)
    exact = -density * gravity / modulus * (depth * z - z**2 / 2)
    assert np.abs(moved - exact).max() <= 0.1 * np.abs(exact).max()

"""Smooth fields in bodies that lie anywhere in the grid: orders of displacements and pressures.

`python tests/verification/cut_fields.py 4` runs as many cuts on three grids and prints the
worst errors.

A box is held by rollers on two faces of its own and loaded on the others by the tractions of a
plane strain solution without body forces (Kolosov's potentials A sinh(k w), B sinh(k w)), dry, or
undrained with a fluid 10000 times as stiff as the skeleton; a beam is bent by end moments.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cut_bodies import POROSITY, read, turn

YOUNG = 1.0e6  # Pa
WAVE = 1.7  # k [1/m]
FIRST, SECOND = 300.0, -200.0  # A, B [N/m]


@dataclass
class Field:
    """One scene and its solution."""

    seed: int
    cells: float  # a metre
    wet: bool
    poisson: float
    angle: float
    jitter: float
    lattice: float
    beam: float = 0.0  # depth in cells of a beam of four times that length; 0: the box

    @property
    def shear(self) -> float:
        """G [Pa]."""
        return YOUNG / 2 / (1 + self.poisson)

    @property
    def stiff_water(self) -> float:
        """K_w/n [Pa]."""
        return 1.0e4 * YOUNG

    @property
    def total_poisson(self) -> float:
        """Poisson's ratio of the mixture."""
        if not self.wet:
            return self.poisson
        lame = 2 * self.shear * self.poisson / (1 - 2 * self.poisson) + self.stiff_water
        return lame / 2 / (lame + self.shear)

    def solution(self, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacements and volume strain in the body's axes."""
        nu = self.total_poisson
        if self.beam > 0:
            depth = self.depth
            curvature = 1.0e-2 / depth
            u = curvature * x * (z - 0.5 * depth)
            ratio = nu / (1 - nu)
            v = -0.5 * curvature * (x**2 + ratio * (z - 0.5 * depth) ** 2)
            volume = curvature * (z - 0.5 * depth) * (1 - ratio)
            return u, v, volume
        w = x + 1j * z
        slope = FIRST * WAVE * np.cosh(WAVE * w)
        value = (3 - 4 * nu) * FIRST * np.sinh(WAVE * w) - w * np.conj(slope)
        value -= np.conj(SECOND * np.sinh(WAVE * w))
        value /= 2 * self.shear
        # in-plane mean total stress 2 Re phi' = (lambda + G) times the volume strain
        stiffness = self.shear / (1 - 2 * nu)
        return value.real, value.imag, 2 * slope.real / stiffness

    @property
    def depth(self) -> float:
        """Of the beam [m]."""
        return 0.25

    def stresses(self) -> tuple[str, str, str]:
        """Formulas of total xx, zz and xz in the body's axes, of X and Z."""
        if self.beam > 0:
            modulus = 2 * self.shear / (1 - self.total_poisson)
            slope = modulus * 1.0e-2 / self.depth
            return f"{slope!r}*(Z-{0.5 * self.depth!r})", "0", "0"
        k = WAVE
        re = f"{FIRST * k!r}*cosh({k}*X)*cos({k}*Z)"  # phi'
        # phi'' = A k^2 sinh, psi' = B k cosh
        sr, si = f"sinh({k}*X)*cos({k}*Z)", f"cosh({k}*X)*sin({k}*Z)"
        cr, ci = f"cosh({k}*X)*cos({k}*Z)", f"sinh({k}*X)*sin({k}*Z)"
        dr = f"({FIRST * k * k!r}*(X*{sr}+Z*{si})+{SECOND * k!r}*{cr})"
        di = f"({FIRST * k * k!r}*(X*{si}-Z*{sr})+{SECOND * k!r}*{ci})"
        return f"(2*{re}-{dr})", f"(2*{re}+{dr})", di

    def text(self) -> str:
        """The namelist."""
        draw = random.Random(self.seed)
        h = 1.0 / self.cells if self.beam == 0 else self.depth / self.beam
        size = [0.8, 1.0] if self.beam == 0 else [4 * self.depth, self.depth]
        origin = [h * draw.random(), h * draw.random()]
        at = turn(self.angle)
        inverse = {
            "X": f"({float(at[0, 0])!r}*x+{float(at[2, 0])!r}*z)",
            "Z": f"({float(at[0, 2])!r}*x+{float(at[2, 2])!r}*z)",
        }
        xx, zz, xz = self.stresses()
        loads = []
        for face, pair in (("x+", (xx, xz)), ("z+", (xz, zz))):
            for component, normal in zip(pair, (at[:, 0], at[:, 2]), strict=True):
                if component == "0":
                    continue
                formula = component.replace("X", inverse["X"]).replace("Z", inverse["Z"])
                loads.append(
                    f"&mechanical_condition surface='{face}' kind='traction' "
                    f"value={float(normal[0])!r}, {float(normal[2])!r} formula='{formula}' /"
                )
        walls = ["&mechanical_condition surface='x-' kind='roller' /"]
        if self.beam > 0:  # a tenth of its root in the middle cannot slide
            low, high = 0.45 * self.depth, 0.55 * self.depth
            walls = [
                f"&mechanical_condition surface='{s}' kind='roller' /" for s in ("low", "high")
            ]
            walls.append("&mechanical_condition surface='pin' kind='fixed' /")
        surfaces = [
            f"&surface name='{f}' region='c' face='{f}' /" for f in ("x-", "x+", "z-", "z+")
        ]
        if self.beam == 0:
            walls.append("&mechanical_condition surface='z-' kind='roller' /")
        else:
            surfaces = [
                "&surface name='x+' region='c' face='x+' /",
                f"&surface name='low' region='c' face='x-' box_max=1, {low!r} /",
                f"&surface name='pin' region='c' face='x-' box_min=-1, {low!r}"
                f" box_max=1, {high!r} /",
                f"&surface name='high' region='c' face='x-' box_min=-1, {high!r} /",
            ]
        lines = [
            f"&scene dimension=2 integrator='quasi_static' gravity=0, 0 "
            f"water='{'coupled' if self.wet else 'none'}' /",
            f"&grid spacing={h!r} origin={origin[0]!r}, {origin[1]!r} shape_function='linear' /",
            "&time end_time=1 /",
            f"&material name='s' young_modulus={YOUNG} poisson_ratio={self.poisson} "
            f"porosity={POROSITY} {'hydraulic_conductivity=1e-14' if self.wet else ''} /",
            f"&water bulk_modulus={self.stiff_water * POROSITY} /" if self.wet else "",
            f"&region name='c' material='s' box_min=0, 0 box_max={size[0]}, {size[1]}",
            f" particles_per_cell=2 jitter={self.jitter} jitter_seed={self.seed}",
            f" lattice_angle={self.lattice!r} shape_angle={self.angle!r} /",
            *surfaces,
            *walls,
            *loads,
            "&output name='r' /",
        ]
        return "\n".join(line for line in lines if line) + "\n"


def errors(case: Field, path: Path) -> dict[str, float]:
    """L2 errors of displacement and pressure, and the worst pressure, relative."""
    data = read(path, -1)
    at = turn(case.angle)
    local = data["points"] @ at
    u, v, volume = case.solution(local[:, 0], local[:, 2])
    moved = data["displacement"] @ at
    difference = np.column_stack([moved[:, 0] - u, moved[:, 2] - v])
    found = {"u": float(np.sqrt((difference**2).sum() / (u**2 + v**2).sum()))}
    if case.wet:
        p = -case.stiff_water * volume
        gap = data["pore_pressure"] - p
        found["p"] = float(np.sqrt((gap**2).sum() / (p**2).sum()))
        found["worst p"] = float(np.abs(gap).max() / np.abs(p).max())
    return found


def solve(case: Field, program: Path) -> dict[str, float]:
    """Runs a scene."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.nml").write_text(case.text())
        done = subprocess.run(
            [str(program), "scene.nml"], cwd=folder, capture_output=True, text=True, timeout=600
        )
        if done.returncode != 0:
            raise RuntimeError(done.stdout + done.stderr)
        return errors(case, folder / "r.vtkhdf")


CUTS = ((0.0, 0.0, 0.0), (20.0, 0.0, 20.0), (33.0, 0.25, 33.0), (0.0, 0.0, 25.0))


def main() -> int:
    """Worst errors of some cuts."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    program = Path(os.environ.get("DOSUI", "build/release/bin/dosui")).resolve()
    for poisson in (0.3, 0.45):
        for cells in (3.3, 4.6, 8.2):
            found = [
                solve(Field(seed, 0, False, poisson, 0.0, jitter, 0.0, cells), program)["u"]
                for seed in range(1, count + 1)
                for jitter in (0.0, 0.25)
            ]
            print(f"bent beam, nu {poisson}, {cells} cells deep: u {max(found):.2e}", flush=True)
    for wet in (False, True):
        for angle, jitter, lattice in CUTS:
            rows = []
            for cells in (6, 12, 24):
                worst: dict[str, float] = {}
                for seed in range(1, count + 1):
                    found = solve(Field(seed, cells, wet, 0.3, angle, jitter, lattice), program)
                    worst = {k: max(v, worst.get(k, 0.0)) for k, v in found.items()}
                rows.append(worst)
            for key in rows[0]:
                e = [row[key] for row in rows]
                order = [float(np.log2(e[k] / e[k + 1])) for k in range(2)]
                print(
                    f"{'undrained' if wet else 'dry'} turned {angle}, lattice {lattice}, "
                    f"jitter {jitter}: "
                    f"{key} "
                    + " ".join(f"{x:.2e}" for x in e)
                    + "  orders "
                    + " ".join(f"{x:.2f}" for x in order),
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())

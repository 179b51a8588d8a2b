"""Patch tests on cut cells: uniform stresses in boxes that lie anywhere in the grid.

`python tests/verification/cut_bodies.py 500` runs as many and prints what went wrong, and the worst
errors; `... 500 3` begins with number 3; DOSUI_RANKS=3 runs on so many ranks, DOSUI_DIMENSION=3 in
three dimensions only. Some have their walls on lines of the grid; some of these bear finite
strains.

Each box is confined by walls on its own (cut) faces and loaded on the others, so that a linear
field of displacements and a uniform stress are the solution: in one direction, in two, or in shear;
dry, or undrained with a fluid 10000 times as stiff as the skeleton.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

YOUNG, POISSON, POROSITY = 1.0e6, 0.3, 0.3  # Pa, -, -
LAME = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
SHEAR = YOUNG / 2 / (1 + POISSON)
STIFF_WATER = 1.0e4 * YOUNG  # K_w/n of undrained boxes [Pa]
KINDS = ("aligned", "jittered", "lattice", "body", "body_jittered", "both")
DRY, WET = 1.0e-11, 1.0e-8  # targets, relative to the field's largest value


@dataclass
class Patch:
    """One scene and its solution in the box's own axes."""

    seed: int
    dimension: int
    kind: str
    shape: str
    per_cell: int
    wet: bool
    load: str
    anchored: bool  # walls lie on grid lines
    finite: bool
    angle: float
    size: list[float]
    strain: np.ndarray  # (3, 3) gradient of the displacement, body axes
    stress: np.ndarray  # (3, 3) effective, body axes [Pa]
    pressure: float  # of the water [Pa]
    text: str

    @property
    def name(self) -> str:
        """What is special about it."""
        water = "undrained" if self.wet else "dry"
        return (
            f"{self.seed}: {self.dimension}-D {self.kind} {self.shape} "
            f"{self.per_cell} per direction {water} "
            f"{self.load}{' anchored' if self.anchored else ''}{' finite' if self.finite else ''}"
        )


def turn(angle: float) -> np.ndarray:
    """Turn in the x-z plane, from x towards z."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def numbers(values: list[float]) -> str:
    """A list for a namelist."""
    return ", ".join(f"{v:.17g}" for v in values)


def undrained(
    confined: list[int], total: dict[int, float], wet: bool, known: dict[int, float]
) -> tuple[np.ndarray, float]:
    """Strains along the axes, some known, under total stresses on the others, and the pressure."""
    bulk = STIFF_WATER if wet else 0.0
    free = [a for a in range(3) if a not in confined and a not in known]
    strain = np.zeros(3)
    for a, value in known.items():
        strain[a] = value
    matrix = np.full((len(free), len(free)), LAME + bulk) + 2 * SHEAR * np.eye(len(free))
    held = (LAME + bulk) * strain.sum()
    strain[free] = np.linalg.solve(matrix, [total[a] - held for a in free])
    return strain, -bulk * strain.sum()


def faces_of(dimension: int) -> list[str]:
    """Names of the faces of a box."""
    return ["x-", "x+", "z-", "z+"] + (["y-", "y+"] if dimension == 3 else [])


def finite_state(confined: list[int], push: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Displacement gradient and Cauchy stress of logarithmic elasticity under pressures."""
    free = [a for a in range(3) if a not in confined]
    e = np.zeros(3)
    for _ in range(60):  # Kirchhoff stress = J x Cauchy stress
        volume = np.exp(e.sum())
        matrix = np.full((len(free), len(free)), LAME) + 2 * SHEAR * np.eye(len(free))
        e[free] = np.linalg.solve(matrix, [-push[a] * volume for a in free])
    kirchhoff = LAME * e.sum() + 2 * SHEAR * e
    return np.diag(np.exp(e) - 1.0), np.diag(kirchhoff / np.exp(e.sum()))


def patch(seed: int, dimension: int = 0) -> Patch:
    """The patch of this number."""
    draw = random.Random(seed)
    dimension = dimension or draw.choice([2] * 5 + [3])
    kind = draw.choice(KINDS)
    per_cell = draw.choice([1, 2, 2, 2, 3]) if dimension == 2 else draw.choice([1, 2])
    wet = draw.random() < 0.4
    load = draw.choice(["uniaxial", "biaxial", "biaxial", "shear"])
    if wet and load == "uniaxial":
        load = "biaxial"
    cells = draw.uniform(6, 12) if dimension == 2 else draw.uniform(3, 4)
    anchored = draw.random() < 0.3
    if anchored:
        kind = draw.choice(["aligned", "jittered", "lattice"])
    finite = anchored and not wet and draw.random() < 0.5
    if anchored and not finite and load == "biaxial":  # both ends on grid lines
        load = random.Random(seed).choice(["biaxial", "pressed", "plate"])
        cells = round(cells) if load != "biaxial" else cells
    h = 1.0 / cells
    size = [0.8, 0.7, 1.0]
    axes = [0, 2] if dimension == 2 else [0, 1, 2]
    origin = [0.0 if anchored else h * draw.random() for _ in axes]
    angle = draw.uniform(-45, 45) if "bod" in kind or kind == "both" else 0.0
    lattice = {"lattice": draw.uniform(-45, 45), "both": draw.uniform(-45, 45)}.get(kind, angle)
    jitter = 0.25 if "jittered" in kind else 0.0
    shape = random.Random(-seed).choice(["linear"] * 4 + ["gimp", "bspline"])
    across = [] if dimension == 3 else [1]
    strain = np.zeros((3, 3))
    push = {a: draw.uniform(500, 1500) for a in range(3)}
    walls: list[str] = []
    faces = faces_of(dimension)
    if load == "shear":
        gamma = 1.0e-3
        strain[0, 2] = gamma
        pull = turn(angle) @ np.array([SHEAR * gamma, 0.0, 0.0])
        traction = turn(angle) @ np.array([0.0, 0.0, SHEAR * gamma])
        walls += ["surface='z-' kind='fixed'"]
        walls += [f"surface='z+' kind='traction' value={numbers([pull[a] for a in axes])}"]
        walls += [f"surface='x+' kind='traction' value={numbers([traction[a] for a in axes])}"]
        walls += [f"surface='x-' kind='traction' value={numbers([-traction[a] for a in axes])}"]
        pressure = 0.0
        faces = faces[:4]
    else:
        confined = across + ([a for a in axes if a != 2] if load == "uniaxial" else [])
        known = {2: -1.0e-3} if load == "pressed" else {}
        axial, pressure = undrained(confined, {a: -push[a] for a in range(3)}, wet, known)
        strain = np.diag(axial)
        for a, name in enumerate("xyz"):
            if a not in axes:
                continue
            walls += [f"surface='{name}-' kind='roller'"]
            if a in confined:
                walls += [f"surface='{name}+' kind='roller'"]
            elif a == 2 and load == "pressed":
                walls += [f"surface='z+' kind='normal_velocity' value={-1.0e-3 * size[2]:.17g}"]
            elif a == 2 and load == "plate":
                force = push[a] * size[0] * (size[1] if dimension == 3 else 1.0)
                walls += [f"surface='z+' kind='plate' value={force:.17g}"]
            else:
                walls += [f"surface='{name}+' kind='pressure' value={push[a]:.17g}"]
    if finite:
        load = "biaxial"
        push = {a: 100.0 * p for a, p in push.items()}
        strain, stress = finite_state(across, push)
        walls, faces = [], faces_of(dimension)
        for a in axes:
            walls += [f"surface='{'xyz'[a]}-' kind='roller'"]
            walls += [f"surface='{'xyz'[a]}+' kind='pressure' value={push[a]:.17g}"]
    symmetric = 0.5 * (strain + strain.T)
    if not finite:
        stress = LAME * np.trace(symmetric) * np.eye(3) + 2 * SHEAR * symmetric
    lines = [
        f"&scene title='patch {seed}' dimension={dimension} integrator='quasi_static'",
        f" water='{'coupled' if wet else 'none'}' gravity={numbers([0.0] * dimension)}",
        " deformation='finite' /" if finite else " /",
        f"&grid spacing={h:.17g} origin={numbers(origin)} shape_function='{shape}' /",
        "&mechanics coupling_gradient='cell_centre' /",
        "&time end_time=1 /",
        f"&material name='s' young_modulus={YOUNG} poisson_ratio={POISSON} porosity={POROSITY}",
        f" hydraulic_conductivity={1.0e-12 if wet else 0.0} /" if wet else " /",
        f"&water bulk_modulus={STIFF_WATER * POROSITY} /" if wet else "",
        f"&region name='c' material='s' box_min={numbers([0.0] * dimension)}",
        f" box_max={numbers([size[a] for a in axes])} particles_per_cell={per_cell}",
        f" jitter={jitter} jitter_seed={seed} lattice_angle={lattice:.17g}",
        f" shape_angle={angle:.17g} /",
    ]
    lines += [f"&surface name='{f}' region='c' face='{f}' /" for f in faces]
    lines += [f"&mechanical_condition {w} /" for w in walls]
    lines += ["&output name='r' /"]
    return Patch(
        seed,
        dimension,
        kind,
        shape,
        per_cell,
        wet,
        load,
        anchored,
        finite,
        angle,
        size,
        strain,
        stress,
        pressure,
        "\n".join(line for line in lines if line) + "\n",
    )


def read(path: Path, step: int) -> dict[str, np.ndarray]:
    """Points and fields of one output."""
    with h5py.File(path) as file:
        vtk = file["VTKHDF"]
        k = step % int(vtk["Steps"].attrs["NSteps"])
        first = int(vtk["Steps/PointOffsets"][k])
        last = first + int(vtk["NumberOfPoints"][k])
        data = {key: vtk["PointData"][key][first:last] for key in vtk["PointData"]}
        data["points"] = vtk["Points"][0 : last - first]
        return data


def errors(case: Patch, path: Path) -> dict[str, float]:
    """Largest errors of displacement, stress and pressure over the largest right values."""
    data = read(path, -1)
    at = turn(case.angle)
    local = data["points"] @ at  # boxes turn about their lower corner
    if case.dimension == 2:
        local[:, 1] = 0.0
    if case.finite:  # results show deformed places
        local = (data["points"] - data["displacement"]) @ at
        local[:, 1] *= case.dimension == 3
    exact = local @ case.strain.T @ at.T
    found = {"u": float(np.abs(data["displacement"] - exact).max() / np.abs(exact).max())}
    stress = at @ case.stress @ at.T
    voigt = np.array(
        [stress[0, 0], stress[1, 1], stress[2, 2], stress[1, 2], stress[0, 2], stress[0, 1]]
    )
    order = data["effective_stress"][:, [0, 1, 2, 4, 5, 3]]
    scale = max(np.abs(voigt).max(), case.pressure)
    found["stress"] = float(np.abs(order - voigt).max() / scale)
    if case.wet:
        scale = max(abs(case.pressure), np.abs(voigt).max())
        found["p"] = float(np.abs(data["pore_pressure"] - case.pressure).max() / scale)
    return found


def run(case: Patch, folder: Path, program: Path, ranks: int = 1) -> tuple[int, str]:
    """Exit status and output."""
    (folder / "scene.nml").write_text(case.text)
    command = [str(program), "scene.nml"]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    return done.returncode, done.stdout + done.stderr


def main() -> int:
    """Runs a number of patches."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    start = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    ranks = int(os.environ.get("DOSUI_RANKS", "1"))
    dimension = int(os.environ.get("DOSUI_DIMENSION", "0"))
    program = Path(os.environ.get("DOSUI", "build/release/bin/dosui")).resolve()
    worst: dict[str, tuple[float, str]] = {}
    n_bad = 0
    for seed in range(start, start + count):
        case = patch(seed, dimension)
        with tempfile.TemporaryDirectory() as name:
            status, output = run(case, Path(name), program, ranks)
            if status != 0:
                n_bad += 1
                print(
                    f"{case.name}: status {status}: {output.strip().splitlines()[-1]}", flush=True
                )
                continue
            found = errors(case, Path(name) / "r.vtkhdf")
        limit = WET if case.wet else DRY
        for key, value in found.items():
            full = f"{'wet' if case.wet else 'dry'} {key}"
            if not value <= worst.get(full, (-1.0, ""))[0]:
                worst[full] = (value, case.name)
        if not max(found.values()) <= limit:
            n_bad += 1
            print(
                f"{case.name}: " + ", ".join(f"{k} {v:.2e}" for k, v in found.items()), flush=True
            )
    for key, (value, what) in sorted(worst.items()):
        print(f"worst {key}: {value:.2e} ({what})")
    print(f"{n_bad} of {count} wrong")
    return n_bad > 0


if __name__ == "__main__":
    sys.exit(main())

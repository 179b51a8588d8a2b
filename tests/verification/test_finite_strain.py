"""Finite strains: a column that loses half its height, exact states of dry bodies, soils that
yield, initial stresses."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import ROOT, Run, Runner
from test_soils import CLAY

UNIT_WEIGHT, MODULUS, CONDUCTIVITY = 9810.0, 1.0e6, 1.0e-7
HALF = float(np.log(2.0)) / 0.5 * MODULUS  # the pressure that leaves half the height [Pa]
TIMES = (0.05, 0.1, 0.2, 0.5)  # c_v t/H2 with the height and stiffness of the start


def rollers(dimension: int, region: str) -> str:
    """Smooth walls at all faces but the top."""
    faces = ("z-", "x-", "x+", "y-", "y+")[: 2 * dimension - 1]
    return "\n".join(
        f"&surface name = '{f}' region = '{region}' face = '{f}' /\n"
        f"&mechanical_condition surface = '{f}' kind = 'roller' /"
        for f in faces
    )


@dataclass(frozen=True)
class SoftColumn:
    """A confined column of 1 m on a smooth base, pressed from its top."""

    dimension: int = 1
    cells: int = 40
    per_cell: int = 1
    pressure: float = HALF
    poisson_ratio: float = 0.0
    jitter: float = 0.0
    shape: str = "linear"
    water: bool = True

    def text(self) -> str:
        """The namelist."""
        dim, h = self.dimension, 1.0 / self.cells
        c_v = CONDUCTIVITY * MODULUS / UNIT_WEIGHT
        times = ", ".join(repr(factor / c_v) for factor in TIMES)
        nu = self.poisson_ratio
        young = MODULUS * (1 + nu) * (1 - 2 * nu) / (1 - nu)
        top = [repr(2 * h)] * (dim - 1) + ["1.0"]
        soil = f"hydraulic_conductivity = {CONDUCTIVITY}" if self.water else ""
        wet = (
            "&water bulk_modulus = 2.2e9 /\n"
            "&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /"
        )
        return f"""
&scene dimension = {dim} deformation = 'finite' integrator = 'auto' gravity = {dim}*0.0
  {"" if self.water else "water = 'none'"} /
&grid spacing = {h} shape_function = '{self.shape}' /
&time end_time = {TIMES[-1] / c_v!r} output_times = {times} relative_tolerance = 1e-4 /
&material name = 'soft' young_modulus = {young!r} poisson_ratio = {nu} porosity = 0.6 {soil} /
&region name = 'column' material = 'soft' box_min = {dim}*0.0 box_max = {", ".join(top)}
  particles_per_cell = {self.per_cell} jitter = {self.jitter} /
&surface name = 'top' region = 'column' face = 'z+' /
{rollers(dim, "column")}
&mechanical_condition surface = 'top' kind = 'pressure' value = {self.pressure!r} /
{wet if self.water else ""}
&output name = 'soft' /
"""


WEIGHT_TIMES = (0.1, 0.3, 1.0)  # c_v t/H2
HEIGHT, SOLID, WATER, VOIDS = 10.0, 2650.0, 1000.0, 0.7  # m, kg/m3, kg/m3, porosity at first
SOFT = 8.0e4  # stiffness of the sediment [Pa]


def own_weight(law: str, cells: int = 40) -> str:
    """A sediment that settles under its own weight, drained at its moving top."""
    c_v = 1.0e-6 * SOFT / UNIT_WEIGHT
    times = [factor * HEIGHT**2 / c_v for factor in WEIGHT_TIMES]
    return f"""
&scene dimension = 1 deformation = 'finite' integrator = 'quasi_static' gravity = -9.81 /
&grid spacing = {HEIGHT / cells} /
&time end_time = {times[-1]!r} output_times = {times[0]!r}, {times[1]!r}
  relative_tolerance = 1e-4 /
&material name = 'mud' young_modulus = {SOFT} poisson_ratio = 0.0 porosity = {VOIDS}
  solid_density = {SOLID} hydraulic_conductivity = 1.0e-6 conductivity_law = '{law}' /
&water bulk_modulus = 2.2e9 /
&region name = 'mud' material = 'mud' box_min = 0.0 box_max = {HEIGHT} particles_per_cell = 1 /
&surface name = 'top' region = 'mud' face = 'z+' /
&surface name = 'rock' region = 'mud' face = 'z-' /
&mechanical_condition surface = 'rock' kind = 'roller' /
&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /
&output name = 'mud' /
"""


def own_weight_reference(law: str, cells: int = 200, steps: int = 300) -> list[np.ndarray]:
    """Settlement of the heights at cell edges at WEIGHT_TIMES: finite volumes of the reference
    height (Gibson et al. 1967 in J = dz/dZ), backward Euler with Richardson's extrapolation."""
    dz, g = HEIGHT / cells, 9.81
    kappa = 1.0e-6 / UNIT_WEIGHT
    c_v = kappa * SOFT

    def rate(j: np.ndarray) -> np.ndarray:
        load = ((1 - VOIDS) * SOLID + (j - (1 - VOIDS)) * WATER) * g * dz
        above = np.cumsum(load[::-1])[::-1] - 0.5 * load
        p = above + SOFT * np.log(j) / j
        n = 1 - (1 - VOIDS) / j
        k = kappa * np.ones(cells)
        if law == "kozeny_carman":
            k = kappa * (n / VOIDS) ** 3 * ((1 - VOIDS) / (1 - n)) ** 2
        mean = 2 * k[1:] * k[:-1] / (k[1:] + k[:-1])
        between = 0.5 * (j[1:] + j[:-1])
        flux = np.zeros(cells + 1)
        flux[1:-1] = -mean * (np.diff(p) / dz / between + WATER * g)
        flux[-1] = -k[-1] * (-p[-1] / (0.5 * dz) / j[-1] + WATER * g)
        return -np.diff(flux) / dz

    def march(count: int) -> list[np.ndarray]:
        found, j, t = [], np.ones(cells), 0.0
        ends = [factor * HEIGHT**2 / c_v for factor in WEIGHT_TIMES]
        for time in sorted({*(ends[-1] * (np.arange(1, count + 1) / count) ** 2), *ends}):
            new = j.copy()
            for _ in range(12):
                base, matrix = rate(new), np.zeros((cells, cells))
                for k in range(cells):  # the weight above couples all
                    moved = new.copy()
                    moved[k] += 1e-7
                    matrix[:, k] = (rate(moved) - base) / 1e-7
                step = np.linalg.solve(
                    np.eye(cells) - (time - t) * matrix, new - j - (time - t) * base
                )
                new -= step
                if np.abs(step).max() < 1e-10:
                    break
            j, t = new, time
            if time in ends:
                found.append(np.concatenate([[0.0], np.cumsum(j - 1) * dz]))
        return found

    return [2 * b - a for a, b in zip(march(steps // 2), march(steps), strict=True)]


@pytest.mark.parametrize("law", ["constant", "kozeny_carman"])
def test_sediment_under_its_own_weight(dosui: Runner, law: str) -> None:
    """Settlement within 1 % of the Lagrangian reference at all times and heights."""
    run = dosui(own_weight(law))
    assert run.status == 0, run.stderr
    cells = 60
    edges = HEIGHT * np.arange(cells + 1) / cells
    for step, exact in enumerate(own_weight_reference(law, cells, 120)):
        fields = run.fields("mud", step + 1)
        moved = fields["displacement"][:, 2]
        expected = np.interp(fields["points"][:, 2] - moved, edges, exact)
        assert np.abs(moved - expected).max() <= 0.01 * np.abs(exact).max(), (step, exact[-1])
    assert -exact[-1] > 0.15 * HEIGHT  # a large strain


@functools.cache
def reference(cells: int = 200, steps: int = 400) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """Pressure and displacement at cell centres for each of TIMES: finite volumes of the reference
    height, dJ/dt = d/dZ (k/(g_w J) dp/dZ), p = q + M ln J/J, by SDIRK2 with growing steps."""
    kappa = CONDUCTIVITY / UNIT_WEIGHT
    dz = 1.0 / cells
    c_v = kappa * MODULUS

    def pressure(j: np.ndarray) -> np.ndarray:
        return HALF + MODULUS * np.log(j) / j

    def rate(j: np.ndarray) -> np.ndarray:
        p, flux = pressure(j), np.zeros(cells + 1)
        flux[1:-1] = -kappa * np.diff(p) / dz / (0.5 * (j[1:] + j[:-1]))
        flux[-1] = kappa * p[-1] / (0.5 * dz) / (0.5 * (j[-1] + 0.5))
        return -np.diff(flux) / dz

    def derivative(j: np.ndarray) -> np.ndarray:
        matrix, base, step = np.zeros((cells, cells)), rate(j), 1e-7
        for colour in range(3):  # tridiagonal
            moved = j.copy()
            moved[colour::3] += step
            change = (rate(moved) - base) / step
            for k in range(colour, cells, 3):
                rows = slice(max(0, k - 1), min(cells, k + 2))
                matrix[rows, k] = change[rows]
        return matrix

    def stage(start: np.ndarray, guess: np.ndarray, weight: float) -> np.ndarray:
        j = guess.copy()
        for _ in range(8):
            residual = j - start - weight * rate(j)
            step = np.linalg.solve(np.eye(cells) - weight * derivative(j), residual)
            j -= step
            if np.abs(step).max() < 1e-11:
                break
        return j

    gamma = 1.0 - np.sqrt(0.5)
    found, j, t = {}, np.ones(cells), 0.0
    ends = [factor / c_v for factor in TIMES]
    grid = sorted({*(ends[-1] * (np.arange(1, steps + 1) / steps) ** 3), *ends})
    for end in grid:
        dt = end - t
        first = stage(j, j, gamma * dt)
        slope = (first - j) / (gamma * dt)
        j = stage(j + (1 - gamma) * dt * slope, first, gamma * dt)
        t = end
        for factor, time in zip(TIMES, ends, strict=True):
            if time == end:
                below = np.cumsum(j - 1) * dz - 0.5 * dz * (j - 1)
                found[factor] = (pressure(j), below)
    return found


def errors(run: Run, name: str = "soft") -> np.ndarray:
    """Largest errors of pressure (over the load) and displacement (over 0.5 m) at TIMES."""
    assert run.status == 0, run.stderr
    exact, found = reference(), []
    for step, factor in enumerate(TIMES):
        fields = run.fields(name, step + 1)
        moved = fields["displacement"][:, 2]
        height = fields["points"][:, 2] - moved
        centres = (np.arange(200) + 0.5) / 200
        pressure, displacement = (np.interp(height, centres, values) for values in exact[factor])
        found.append(
            (
                np.abs(fields["pore_pressure"] - pressure).max() / HALF,
                np.abs(moved - displacement).max() / 0.5,
            )
        )
    return np.array(found)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"poisson_ratio": 0.3},
        {"dimension": 2, "per_cell": 2},
        {"dimension": 2, "per_cell": 2, "shape": "bspline", "jitter": 0.2},
        {"dimension": 3, "cells": 20, "per_cell": 1},
    ],
)
def test_half_the_height_is_lost(dosui: Runner, change: dict[str, object]) -> None:
    """Pressure and settlement within 1 % of the converged reference."""
    run = dosui(replace(SoftColumn(), **change).text())
    assert errors(run).max() <= 1e-2
    assert run.history("soft", "water_balance_error")[-1] <= 1e-2
    assert "quasi_static (nothing in the scene has inertia)" in run.stdout


def test_shipped_scene(dosui: Runner) -> None:
    """Half the height with 20 cells of four particles."""
    run = dosui(ROOT / "input/large_strain/scene.nml")
    assert errors(run, "large_strain").max() <= 1e-2
    assert abs(run.history("large_strain", "top_settlement")[-1] - 0.5) <= 1e-4


def test_error_falls_with_the_grid(dosui: Runner) -> None:
    """Three grids of the half-height column."""
    worst = [errors(dosui(SoftColumn(cells=n).text())).max() for n in (10, 20, 40)]
    assert worst[0] / worst[1] >= 1.7
    assert worst[1] / worst[2] >= 1.7


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("shape", ["linear", "bspline"])
def test_dry_column_is_exact(dosui: Runner, dimension: int, shape: str) -> None:
    """sigma = M ln J/J everywhere, in one step, on scattered particles."""
    column = SoftColumn(
        dimension=dimension,
        cells=6,
        per_cell=2,
        poisson_ratio=0.25,
        water=False,
        shape=shape,
        jitter=0.2,
    )
    run = dosui(column.text())
    assert run.status == 0, run.stderr
    fields = run.fields("soft")
    height = fields["points"][:, 2] - fields["displacement"][:, 2]
    stress = fields["effective_stress"]
    assert np.allclose(fields["points"][:, 2], 0.5 * height, rtol=1e-12)
    assert np.allclose(stress[:, 2], -HALF, rtol=1e-12)
    assert np.allclose(stress[:, 0], -HALF / 3, rtol=1e-12)
    assert np.allclose(fields["porosity"], 1 - 0.4 / 0.5, rtol=1e-11)


@pytest.mark.parametrize(("pressure", "jitter"), [(5.0e5, 0.2), (2.0e6, 0.0)])
def test_pressed_wedge_keeps_its_shape(dosui: Runner, pressure: float, jitter: float) -> None:
    """Pressures on a sloping face through cells and on the top, smooth walls: (l + G) 2 e = -p J,
    J = exp(2 e). Particles' own gradients know nothing of the cut cells."""
    text = f"""
&scene dimension = 2 deformation = 'finite' integrator = 'quasi_static' water = 'none'
  gravity = 2*0.0 /
&grid spacing = 0.25 /
&time end_time = 1.0 /
&material name = 'soft' young_modulus = 1.0e6 poisson_ratio = 0.25 /
&region name = 'wedge' material = 'soft' shape = 'polygon' jitter = {jitter}
  vertices = 0.0, 0.0, 2.0, 0.0, 1.0, 2.0, 0.0, 2.0 /
&surface name = 'base' region = 'wedge' face = 'edge1' /
&surface name = 'slope' region = 'wedge' face = 'edge2' /
&surface name = 'top' region = 'wedge' face = 'edge3' /
&surface name = 'axis' region = 'wedge' face = 'edge4' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'axis' kind = 'roller' /
&mechanical_condition surface = 'slope' kind = 'pressure' value = {pressure} /
&mechanical_condition surface = 'top' kind = 'pressure' value = {pressure} /
&output name = 'wedge' /
"""
    strain = -0.1
    for _ in range(50):
        load = pressure * np.exp(2 * strain)
        strain -= (load + 1.6e6 * strain) / (2 * load + 1.6e6)
    found = []
    for mechanics in ("", "&mechanics coupling_gradient = 'particle' /\n"):
        if mechanics and pressure > 1e6:
            continue  # too far off to find any equilibrium
        run = dosui(text.replace("&output", mechanics + "&output"), folder=mechanics[-12:-3])
        assert run.status == 0, run.stderr
        fields = run.fields("wedge")
        start = fields["points"] - fields["displacement"]
        moved = np.abs(fields["points"] - np.exp(strain) * start)[:, [0, 2]].max()
        found.append((moved, np.abs(fields["effective_stress"][:, [0, 2]] / -pressure - 1).max()))
    assert found[0][0] <= 5e-4
    assert found[0][1] <= 7e-3  # as in small strains: loads of parts of the face
    assert found[-1][1] > 20 * found[0][1] or pressure > 1e6


def test_block_between_plates_widens(dosui: Runner) -> None:
    """Plane strain, free sides, 40 % shorter: ln of the widening is nu/(1 - nu) ln(1/0.6)."""
    text = SoftColumn(dimension=2, cells=4, per_cell=2, poisson_ratio=0.3, water=False).text()
    text = text.replace("&mechanical_condition surface = 'x+' kind = 'roller' /", "")
    c_v = CONDUCTIVITY * MODULUS / UNIT_WEIGHT
    text = re.sub(
        r"surface = 'top' kind = 'pressure' value = .*",
        f"surface = 'top' kind = 'normal_velocity' value = {-0.4 * c_v / TIMES[-1]!r} /",
        text,
    )
    run = dosui(text)
    assert run.status == 0, run.stderr
    fields = run.fields("soft")
    start = fields["points"] - fields["displacement"]
    wide = (1 / 0.6) ** (0.3 / 0.7)
    assert np.allclose(fields["points"][:, 2], 0.6 * start[:, 2], rtol=1e-7)
    assert np.allclose(fields["points"][:, 0], wide * start[:, 0], rtol=1e-7)
    assert np.abs(fields["effective_stress"][:, 0]).max() <= 1e-6 * MODULUS


@pytest.mark.parametrize("ranks", [pytest.param(2, marks=pytest.mark.long), 3])
def test_ranks_and_restart(dosui: Runner, ranks: int) -> None:
    """Ranks agree to 1e-11; a restart goes on bit by bit."""
    text = SoftColumn(dimension=2, cells=10, per_cell=2, jitter=0.1).text()
    text = text.replace("&time", "&time maximum_steps = 40")
    one = dosui(text, folder="one").fields("soft")
    many = dosui(text, ranks=ranks, folder="many").fields("soft")
    part = text.replace("steps = 40", "steps = 25").replace(
        "&output", "&output checkpoint_steps = 20"
    )
    first = dosui(part, ranks=ranks, folder="part")
    checkpoint = str(first.folder / "soft.restart.h5")
    again = dosui(text, "--restart", checkpoint, ranks=ranks, folder="part")
    assert again.status == 0, again.stderr
    rest = again.fields("soft")
    for name in ("pore_pressure", "displacement", "effective_stress", "volume"):
        scale = HALF if name == "pore_pressure" else np.abs(one[name]).max()
        order_one, order_many = (np.lexsort(f["points"].round(6).T) for f in (one, many))
        assert np.abs(one[name][order_one] - many[name][order_many]).max() <= 1e-11 * scale
        assert np.array_equal(many[name], rest[name])


# ---------------------------------------------------------------- soils that yield

YOUNG, POISSON, COHESION, FRICTION, DILATION = 1.0e7, 0.1, 2.0e5, 30.0, 5.0
STRONG = f"""young_modulus = {YOUNG} poisson_ratio = {POISSON} cohesion = {COHESION}
  friction_angle = {FRICTION} dilation_angle = {DILATION} porosity = 0.5"""


def block(
    dimension: int,
    soil: str,
    height: float,
    steps: int,
    more: str = "",
    scene: str = "water = 'none'",
) -> str:
    """A confined cube of 1 m brought to another height."""
    return f"""
&scene dimension = {dimension} deformation = 'finite' integrator = 'quasi_static'
  gravity = {dimension}*0.0 {scene} /
&grid spacing = 0.5 /
&time end_time = 1.0 time_step = {1.0 / steps!r} /
&material name = 'soil' {soil} /
&region name = 'block' material = 'soil' box_min = {dimension}*0.0 box_max = {dimension}*1.0 /
{more}
&surface name = 'top' region = 'block' face = 'z+' /
{rollers(dimension, "block")}
&mechanical_condition surface = 'top' kind = 'normal_velocity' value = {height - 1.0!r} /
&output name = 'block' /
"""


def squeezed(model: str, height: float) -> tuple[float, float, float]:
    """Axial and radial Cauchy stress and plastic shear strain of a confined cube. Axes do not turn
    and the flow keeps its direction, so one multiplier m of the whole way is enough:
    tau = D (ln F - m N), f(tau/J) = 0."""
    bulk, shear = YOUNG / 3 / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
    phi, psi = np.radians(FRICTION), np.radians(DILATION)

    def cone(angle: float) -> float:
        return 6 * np.cos(angle) / (np.sqrt(3) * (3 - np.sin(angle)))

    def stresses(m: float) -> tuple[float, float]:
        z, r = np.log(height) - m * flow[0], -m * flow[1]
        volume = z + 2 * r
        return tuple((bulk * volume + 2 * shear * (e - volume / 3)) / height for e in (z, r))

    def excess(m: float) -> float:
        z, r = stresses(m)
        if model == "mohr_coulomb":
            return (r - z) / 2 + (r + z) / 2 * np.sin(phi) - COHESION * np.cos(phi)
        return (r - z) / np.sqrt(3) + cone(phi) * (np.tan(phi) * (z + 2 * r) / 3 - COHESION)

    if model == "mohr_coulomb":  # both planes 1-3 and 2-3
        flow = (-(1 - np.sin(psi)) / 2, (1 + np.sin(psi)) / 4)
    else:
        slope = cone(psi) * np.tan(psi) / 3
        flow = (-1 / np.sqrt(3) + slope, 0.5 / np.sqrt(3) + slope)
    m = excess(0.0) / (excess(0.0) - excess(1.0))
    assert m > 0
    return (*stresses(m), m * (flow[1] - flow[0] if model == "mohr_coulomb" else 1.0))


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("model", ["mohr_coulomb", "drucker_prager"])
def test_squeezed_soil_is_exact(dosui: Runner, dimension: int, model: str) -> None:
    """35 % shorter: the strength limits Cauchy stresses, whatever the steps."""
    exact = squeezed(model, 0.65)
    for steps in (1, 7):
        run = dosui(block(dimension, f"model = '{model}' {STRONG}", 0.65, steps))
        assert run.status == 0, run.stderr
        fields = run.fields("block")
        assert np.allclose(fields["effective_stress"][:, 2], exact[0], rtol=1e-11)
        assert np.allclose(fields["effective_stress"][:, 0], exact[1], rtol=1e-11)
        assert np.allclose(fields["plastic_shear_strain"], exact[2], rtol=1e-11)
        assert newton_iterations(run) <= 4 * steps


def newton_iterations(run: Run) -> int:
    """Of a whole run, from its summary."""
    return int(re.findall(r"Newton's iterations (\d+);", run.stdout)[-1])


def test_the_cut_off_limits_cauchy_stresses(dosui: Runner) -> None:
    """30 % longer: the axial stress is the tensile strength; radial strains are elastic."""
    strength = 5.0e4
    text = block(2, f"model = 'mohr_coulomb' {STRONG} tensile_strength = {strength}", 1.3, 3)
    run = dosui(text.replace("spacing = 0.5", "spacing = 1.0"))  # nothing else would be unique
    assert run.status == 0, run.stderr
    stress = run.fields("block")["effective_stress"]
    assert np.allclose(stress[:, 2], strength, rtol=1e-11)
    assert np.allclose(stress[:, 0], strength * POISSON / (1 - POISSON), rtol=1e-11)


@pytest.mark.parametrize("model", ["mohr_coulomb", "drucker_prager"])
def test_a_gap_closes_before_it_carries(dosui: Runner, model: str) -> None:
    """Pulled apart by 5 %, then pressed: the gap is a logarithmic strain, closes where it opened,
    and elasticity goes on from there (but for the shear of the step that closes it)."""
    soil = f"model = '{model}' young_modulus = 1.0e7 poisson_ratio = 0.3 friction_angle = 30.0"
    text = block(1, soil + " tensile_strength = 0.0", 1.2, 100)  # displacement 0.2 (t - t^2)
    text = text.replace("value = ", "factor_times = 0.0, 2.0 factor_values = 1.0, -3.0 value = ")
    text = text.replace("spacing = 0.5", "spacing = 1.0")  # nothing else would be unique
    end = 0.5 + 0.5**0.5
    text = text.replace("end_time = 1.0", f"end_time = {end!r} output_times = 0.5")
    run = dosui(text)
    assert run.status == 0, run.stderr
    apart, pressed = run.fields("block", 1), run.fields("block", 2)
    assert np.allclose(apart["opened_volume"], np.log(1.05), rtol=1e-9)
    assert np.abs(apart["effective_stress"]).max() <= 1e-3
    assert np.abs(pressed["opened_volume"]).max() <= 1e-12
    stress = 1.0e7 * 0.7 / (1.3 * 0.4) * np.log(0.95) / 0.95
    assert np.allclose(pressed["effective_stress"][:, 2], stress, rtol=5e-3)


def test_softening_follows_the_plastic_strain(dosui: Runner) -> None:
    """The cohesion of the present plastic strain, which steps take from their start."""
    keys = "softening_strain = 0.4 residual_cohesion = 1.0e5 residual_friction_angle = 30.0"
    soil = f"model = 'mohr_coulomb' {STRONG} {keys}".replace("dilation_angle = 5.0", "")
    errors = []
    for steps in (25, 50):
        run = dosui(block(1, soil, 0.7, steps))
        assert run.status == 0, run.stderr
        fields = run.fields("block")
        strain, stress = fields["plastic_shear_strain"][0], fields["effective_stress"][0]
        assert strain > 0.1
        sin, cos = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
        cohesion = ((stress[0] - stress[2]) / 2 + (stress[0] + stress[2]) / 2 * sin) / cos
        errors.append(cohesion - (COHESION - 1.0e5 * strain / 0.4))
    assert 0 < errors[1] < 0.01 * COHESION
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def clay_path(strain: tuple[float, ...], pressure: float, steps: int = 20000) -> np.ndarray:
    """Principal stresses of virgin Cam-clay along a straight path of logarithmic strains from an
    isotropic pressure, compression positive: forward integration of the rates."""
    lam, kap, nu, p_a = 0.2, 0.04, 0.3, 1.0e3
    s, p_c, v, de = np.full(3, pressure), pressure, 2.0, np.array(strain) / steps
    found = [s]
    for _ in range(steps):
        p = s.mean()
        bulk = v * (p + p_a) / kap
        shear = 1.5 * (1 - 2 * nu) / (1 + nu) * bulk
        d = bulk * np.ones((3, 3)) + 2 * shear * (np.eye(3) - 1 / 3)
        n = (2 * p - p_c) / 3 + 3 * (s - p)
        hardening = p * v / (lam - kap) * p_c * (2 * p - p_c)
        m = max(0.0, n @ d @ de / (n @ d @ n + hardening))
        s = s + d @ (de - m * n)
        p_c *= np.exp(v / (lam - kap) * m * (2 * p - p_c))
        v *= np.exp(-de.sum())
        found.append(s)
    return np.array(found)


@pytest.mark.parametrize("dimension", [1, 2])
def test_squeezed_clay(dosui: Runner, dimension: int) -> None:
    """35 % shorter: rates of Cam-clay in logarithmic strains and Cauchy stresses."""
    exact = clay_path((0.0, 0.0, -np.log(0.65)), 1.0e5)[-1]
    start = "&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e5, 3*0.0 /"
    errors = []
    for steps in (40, 80):
        run = dosui(block(dimension, CLAY, 0.65, steps, start))
        assert run.status == 0, run.stderr
        fields = run.fields("block")
        errors.append(
            max(np.abs(fields["effective_stress"][:, k] / -exact[k] - 1).max() for k in (0, 2))
        )
        assert np.allclose(fields["specific_volume"], 2.0 * 0.65, rtol=1e-12)
    assert errors[1] <= 0.01
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_undrained_clay_between_plates(dosui: Runner) -> None:
    """Plane strain, 40 % shorter without drainage under a constant pressure on its sides, up to the
    critical state: rates of Cam-clay at constant volume."""
    height, side, steps = 0.6, 1.0e5, 50
    more = "&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e5, 3*0.0 /"
    text = block(2, f"{CLAY} hydraulic_conductivity = 1e-15", height, steps, more, scene="")
    text = text.replace(
        "&mechanical_condition surface = 'x+' kind = 'roller' /",
        f"&mechanical_condition surface = 'x+' kind = 'pressure' value = {side} /",
    )
    run = dosui(text)
    assert run.status == 0, run.stderr
    fields = run.fields("block")
    strain = -np.log(height)
    exact = clay_path((-strain, 0.0, strain), side)[-1]
    for k in range(3):
        assert -fields["effective_stress"][:, k] == pytest.approx(exact[k], rel=3e-3), k
    assert fields["pore_pressure"] == pytest.approx(side - exact[0], rel=3e-3)
    assert fields["volume"].sum() == pytest.approx(1.0, rel=2e-5)  # u n/K_w
    assert fields["points"][:, 0].max() > 1.4
    assert newton_iterations(run) <= 9 * steps  # two stages a step


CLAY_TIMES = (1.0e6, 5.0e6, 2.0e7)
CLAY_START, CLAY_LOAD, CLAY_CONDUCTIVITY = 5.0e4, 6.0e5, 1.0e-9


def clay_column(dimension: int, cells: int) -> str:
    """A column of Cam-clay that consolidates under a sudden load."""
    text = replace(SoftColumn(), dimension=dimension, cells=cells, per_cell=dimension).text()
    soil = f"name = 'soft' {CLAY} hydraulic_conductivity = {CLAY_CONDUCTIVITY} /"
    text = re.sub(r"name = 'soft' young_modulus.*?/", soil, text)
    times = ", ".join(map(repr, CLAY_TIMES))
    text = re.sub(
        r"&time .* r", f"&time end_time = {CLAY_TIMES[-1]} output_times = {times} r", text
    )
    text = text.replace(f"value = {HALF!r}", f"value = {CLAY_START + CLAY_LOAD!r}")
    return text + (
        "&initial_state effective_stress = 'given'"
        f" effective_stress_value = 3*-{CLAY_START}, 3*0.0 /\n"
    )


@functools.cache
def clay_reference(cells: int = 50, steps: int = 120) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """As `reference`, with the stress of virgin confined compression at a height ratio J."""
    strain, points = 0.4, 4000
    path = (
        np.exp(-strain * np.arange(points + 1) / points),
        clay_path((0.0, 0.0, strain), CLAY_START, points)[:, 2],
    )
    total, kappa, dz = CLAY_START + CLAY_LOAD, CLAY_CONDUCTIVITY / UNIT_WEIGHT, 1.0 / cells
    last = np.interp(total, path[1], path[0])

    def rate(j: np.ndarray) -> np.ndarray:
        p, flux = total - np.interp(j, path[0][::-1], path[1][::-1]), np.zeros(cells + 1)
        flux[1:-1] = -kappa * np.diff(p) / dz / (0.5 * (j[1:] + j[:-1]))
        flux[-1] = kappa * p[-1] / (0.5 * dz) / (0.5 * (j[-1] + last))
        return -np.diff(flux) / dz

    def stage(start: np.ndarray, weight: float) -> np.ndarray:
        j = start.copy()
        for _ in range(20):
            base, matrix = rate(j), np.eye(cells)
            for colour in range(3):  # tridiagonal
                moved = j.copy()
                moved[colour::3] -= 1e-7
                change = (base - rate(moved)) / 1e-7
                for k in range(colour, cells, 3):
                    rows = slice(max(0, k - 1), min(cells, k + 2))
                    matrix[rows, k] -= weight * change[rows]
            step = np.linalg.solve(matrix, j - start - weight * base)
            j -= step
            if np.abs(step).max() < 1e-10:
                break
        return j

    gamma = 1.0 - np.sqrt(0.5)
    found, j, t = {}, np.ones(cells), 0.0
    for end in sorted({*(CLAY_TIMES[-1] * (np.arange(1, steps + 1) / steps) ** 3), *CLAY_TIMES}):
        first = stage(j, gamma * (end - t))
        j = stage(j + (1 - gamma) / gamma * (first - j), gamma * (end - t))
        t = end
        if end in CLAY_TIMES:
            below = np.cumsum(j - 1) * dz - 0.5 * dz * (j - 1)
            found[end] = (total - np.interp(j, path[0][::-1], path[1][::-1]), below)
    return found


@pytest.mark.parametrize("dimension", [1, 2])
def test_clay_consolidates(dosui: Runner, dimension: int) -> None:
    """A quarter of the height lost: pressures and settlements of Lagrangian finite volumes."""
    run = dosui(clay_column(dimension, 20))
    assert run.status == 0, run.stderr
    cells = 50
    centres = (np.arange(cells) + 0.5) / cells
    for step, time in enumerate(CLAY_TIMES):
        pressure, settled = clay_reference(cells)[time]
        fields = run.fields("soft", step + 1)
        moved = fields["displacement"][:, 2]
        height = fields["points"][:, 2] - moved
        error = np.abs(np.interp(height, centres, settled) - moved).max()
        assert error <= 2e-3, time
        error = np.abs(np.interp(height, centres, pressure) - fields["pore_pressure"]).max()
        assert error <= 5e-3 * CLAY_LOAD, time
    assert settled[-1] < -0.23


def footing(soil: str, averages: str = "", depth: float = 0.5) -> str:
    """One half of a rough strip footing, 2 m wide, that sinks into weightless soil."""
    return f"""
&scene dimension = 2 deformation = 'finite' integrator = 'quasi_static' water = 'none'
  gravity = 2*0.0 /
&grid spacing = 0.25 /
&time end_time = 1.0 largest_step = 0.02 /
&material name = 'soil' {soil} /
&mechanics {averages} /
&region name = 'soil' material = 'soil' box_min = 2*0.0 box_max = 3.5, 2.0 /
&surface name = 'footing' region = 'soil' face = 'z+' box_max = 1.0, 3.0 /
&surface name = 'base' region = 'soil' face = 'z-' /
&surface name = 'axis' region = 'soil' face = 'x-' /
&surface name = 'far' region = 'soil' face = 'x+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'axis' kind = 'roller' /
&mechanical_condition surface = 'far' kind = 'roller' /
&mechanical_condition surface = 'footing' kind = 'velocity' value = 0.0, {-depth} /
&probe name = 'base' kind = 'surface_mean' surface = 'base' field = 'effective_stress'
  component = 3 /
&output name = 'footing' history_interval = 0.05 /
"""


def footing_load(run: Run) -> np.ndarray:
    """Over width and cohesion, at every twentieth of the way."""
    assert run.status == 0, run.stderr
    return -run.history("footing", "base") * 3.5 / 1.0 / 1.0e4


def test_footing_sinks_deep(dosui: Runner) -> None:
    """To a half of its half width: past Prandtl's load the resistance
    rises evenly as soil rises beside. Without averages of volume the grid locks."""
    soil = """model = 'drucker_prager' young_modulus = 1.0e6 poisson_ratio = 0.3 cohesion = 1.0e4
  friction_angle = 20.0 cone = 'plane_strain'"""
    run = dosui(footing(soil))
    load = footing_load(run)
    assert "step repeated" not in run.stdout + run.stderr
    tan = np.tan(np.radians(20.0))
    prandtl = (np.exp(np.pi * tan) * np.tan(np.radians(55.0)) ** 2 - 1) / tan
    way = run.history("footing", "time")
    late = way >= 0.6
    rise = np.diff(load[late]) / np.diff(way[late])
    assert np.all(rise > 0)
    assert prandtl < load[-1] < 1.15 * prandtl
    stiff = footing_load(dosui(footing(soil, "average_volume_change = .false."), folder="own"))
    assert stiff[-1] > 1.2 * load[-1]


@pytest.mark.parametrize("gravity", [0.0, -10.0])
def test_soil_shrinks_by_suction(dosui: Runner, gravity: float) -> None:
    """A soft column that a suction at its top drains: 12 % shorter. Without weight M ln J = J S u;
    with it the total stress is the weight above, of the water that is left, too."""
    end, suction = 3.0e7, -8.0e3 if gravity == 0.0 else -1.2e4
    run = dosui(f"""
&scene dimension = 1 deformation = 'finite' integrator = 'quasi_static' gravity = {gravity} /
&grid spacing = 0.05 /
&time end_time = {end} relative_tolerance = 1e-3 /
&material name = 'soft' young_modulus = 5.0e4 porosity = 0.6 hydraulic_conductivity = 1e-7
  retention = 'van_genuchten' retention_alpha = 0.5 residual_saturation = 0.1 /
&water bulk_modulus = 2.2e9 /
&region name = 'column' material = 'soft' box_min = 0.0 box_max = 1.0 /
&surface name = 'top' region = 'column' face = 'z+' /
{rollers(1, "column")}
&hydraulic_condition surface = 'top' kind = 'pressure' value = {suction}
  factor_times = 0.0, 1.0e4 factor_values = 0.0, 1.0 /
&output name = 'soft' /
""")
    assert run.status == 0, run.stderr
    assert run.history("soft", "water_balance_error")[-1] <= 0.04  # a third with 40 cells
    data = run.fields("soft")
    order = np.argsort(data["points"][:, 2])
    u, n, volume = (data[name][order] for name in ("pore_pressure", "porosity", "volume"))
    saturation = 0.1 + 0.9 / np.sqrt(1 + (0.5 * np.maximum(-u, 0.0) / UNIT_WEIGHT) ** 2)
    total = data["effective_stress"][order, 2] - saturation * u
    weight = -gravity * volume * ((1 - n) * 2650.0 + n * saturation * 1000.0)
    above = np.cumsum(weight[::-1])[::-1] - 0.5 * weight
    error = (total + above).reshape(-1, 2).mean(axis=1)  # of cells
    assert np.abs(error).max() <= 1e-3 * np.abs(total).max()
    assert volume.sum() < 0.9
    if gravity == 0.0:
        ratio = (1 - 0.6) / (1 - n)
        assert np.abs(5.0e4 * np.log(ratio) / (ratio * saturation * u) - 1).max() <= 1e-6
        assert u == pytest.approx(suction, rel=1e-4)


# ---------------------------------------------------------------- initial stresses


def heavy_column(dimension: int, water: bool, cells: int = 20) -> str:
    """10 m of soft soil under its own weight, and a surcharge."""
    width, height = 2 * 10.0 / cells, 10.0
    top = ", ".join([repr(width)] * (dimension - 1) + [repr(height)])
    gravity = ", ".join(["0.0"] * (dimension - 1) + ["-10.0"])
    wet = (
        "&water bulk_modulus = 2.2e9 /\n"
        "&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /"
    )
    return f"""
&scene dimension = {dimension} deformation = 'finite' integrator = 'quasi_static'
  gravity = {gravity} {"" if water else "water = 'none'"} /
&grid spacing = {10.0 / cells} /
&time end_time = 1.0e9 output_times = 1.0e-3 geostatic_start = .true. relative_tolerance = 1e-3 /
&material name = 'soft' young_modulus = 1.0e6 poisson_ratio = 0.2 porosity = 0.5
  {"hydraulic_conductivity = 1.0e-6" if water else ""} /
&region name = 'column' material = 'soft' box_min = {dimension}*0.0 box_max = {top} /
&initial_state effective_stress = 'geostatic' surface_level = 10.0 lateral_ratio = 0.25
  {"pore_pressure = 'hydrostatic' water_level = 10.0" if water else ""} /
&surface name = 'top' region = 'column' face = 'z+' /
{rollers(dimension, "column")}
&mechanical_condition surface = 'top' kind = 'pressure' value = 1.0e5
  factor_times = 0.0, 1.0e5 factor_values = 0.0, 1.0 /
{wet if water else ""}
&output name = 'heavy' /
"""


@pytest.mark.parametrize(("dimension", "water"), [(1, True), (2, False)])
def test_heavy_column_settles_from_its_weight(dosui: Runner, dimension: int, water: bool) -> None:
    """No motion before the surcharge; then J sigma = sigma_0 + M ln J at every height, with the
    stress sigma_0 that the (buoyant) weight had left."""
    run = dosui(heavy_column(dimension, water))
    assert run.status == 0, run.stderr
    assert np.abs(run.fields("heavy", 1)["displacement"]).max() <= 1e-7
    modulus, weight = 1.0e6 * 0.8 / (1.2 * 0.6), 0.5 * (1650.0 if water else 2650.0) * 10.0
    cells = 2000
    height = 10.0 * (np.arange(cells) + 0.5) / cells
    first = -weight * (10.0 - height)
    j = np.ones(cells)
    for _ in range(30):
        excess = j * (first - 1.0e5) - first - modulus * np.log(j)
        j -= excess / (first - 1.0e5 - modulus / j)
    settled = (np.cumsum(j - 1) - 0.5 * (j - 1)) * 10.0 / cells
    fields = run.fields("heavy")
    moved = fields["displacement"][:, 2]
    at = fields["points"][:, 2] - moved
    assert np.abs(np.interp(at, height, settled) - moved).max() <= 5e-5
    assert settled[-1] < -0.7
    stress = fields["effective_stress"][:, 2]
    assert np.abs(np.interp(at, height, first - 1.0e5) - stress).max() <= 200.0


@pytest.mark.parametrize(
    "soil", ["", "model = 'mohr_coulomb' friction_angle = 30.0 cohesion = 2e4"]
)
def test_geostatic_start_needs_no_motion(dosui: Runner, soil: str) -> None:
    """A bank with a free side that knew nothing of its weight stands still."""
    run = dosui(f"""
&scene dimension = 2 deformation = 'finite' integrator = 'quasi_static' water = 'none'
  gravity = 0.0, -10.0 /
&grid spacing = 0.5 /
&time end_time = 1.0 geostatic_start = .true. /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.2 porosity = 0.5 {soil} /
&region name = 'bank' material = 'soil' box_min = 2*0.0 box_max = 4.0, 3.0 jitter = 0.2 /
&surface name = 'base' region = 'bank' face = 'z-' /
&surface name = 'axis' region = 'bank' face = 'x-' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'axis' kind = 'roller' /
&output name = 'bank' /
""")
    assert run.status == 0, run.stderr
    fields = run.fields("bank")
    assert np.abs(fields["displacement"]).max() <= 1e-11
    assert fields["effective_stress"][:, 2].min() < -3.0e4


def test_ranks_and_restart_of_clay(dosui: Runner) -> None:
    """As `test_ranks_and_restart`, with a soil that yields and a slope through cells."""
    text = clay_column(2, 8).replace("&time", "&time maximum_steps = 12")
    corners = "shape = 'polygon' vertices = 0.0, 0.0, 0.6, 0.0, 0.25, 1.0, 0.0, 1.0"
    text = re.sub(r"box_min = .* box_max = .*", corners, text)
    text = text.replace("'x+' kind = 'roller'", "'x+' kind = 'pressure' value = 8.0e4")
    text = text.replace(f"value = {CLAY_START + CLAY_LOAD!r}", "value = 1.2e5")
    for face, edge in (("z-", 1), ("x+", 2), ("z+", 3), ("x-", 4)):
        text = text.replace(f" face = '{face}'", f" face = 'edge{edge}'")
    one = dosui(text, folder="one").fields("soft")
    many = dosui(text, ranks=3, folder="many").fields("soft")
    part = text.replace("steps = 12", "steps = 9").replace(
        "&output", "&output checkpoint_steps = 6"
    )
    assert dosui(part, ranks=3, folder="part").status == 0
    again = dosui(text, "--restart", "soft.restart.h5", ranks=3, folder="part")
    assert again.status == 0, again.stderr
    rest = again.fields("soft")
    for name in ("displacement", "effective_stress", "preconsolidation_pressure", "volume"):
        scale = np.abs(one[name]).max()
        order_one, order_many = (np.lexsort(f["points"].round(6).T) for f in (one, many))
        assert np.abs(one[name][order_one] - many[name][order_many]).max() <= 1e-11 * scale, name
        assert np.array_equal(many[name], rest[name]), name
    assert one["preconsolidation_pressure"].max() > 1.1 * CLAY_START  # it yields


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("'auto'", "'explicit'", "the grid deforms with the body only in steps without inertia"),
        (
            "kind = 'roller'",
            "kind = 'roller' imposition = 'penalty'",
            "springs of walls off the grid lines do not follow a grid that deforms",
        ),
        (
            "young_modulus",
            "model = 'dafalias_manzari' young_modulus",
            "take deformation = 'small_strain' or 'updated'",
        ),
    ],
)
def test_what_finite_strains_cannot_do(dosui: Runner, old: str, new: str, expected: str) -> None:
    """Reported before anything is computed."""
    run = dosui(SoftColumn().text().replace(old, new))
    assert run.status == 2
    assert expected in run.stderr

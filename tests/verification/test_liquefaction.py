"""A level layer of sand that liquefies and settles again, and the sand model in whole bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Run, Runner, scene_text

HEIGHT, CONDUCTIVITY, UNIT_WEIGHT = 5.0, 1.0e-3, 9810.0
SHAKEN = 3.0  # the base rests since 2.5 s [s]
TENSORS = ("back_stress_ratio", "initial_back_stress_ratio", "fabric")


def layer(integrator: str = "semi_implicit", end_time: float = 30.0, interval: float = 0.5) -> str:
    """The shipped scene with cells of 0.5 m."""
    return scene_text(
        "liquefaction/scene.nml",
        integrator=f"'{integrator}'",
        spacing="0.5",
        period="1.0, 0.0",
        box_max="1.0, 5.0",
        end_time=f"{end_time}",
        output_interval=f"{interval}",
    )


def contract(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a : b of tensors (n, 4): xx, yy, zz, zx."""
    return np.asarray(a * b @ np.array([1.0, 1.0, 1.0, 2.0]))


class Sand:
    """Dafalias & Manzari's rates for Toyoura sand, integrated by Euler's rule in small steps.

    Compression positive; points (n, 4): xx, yy, zz, zx.
    """

    shear_number, poisson, atmosphere, least = 125.0, 0.05, 1.01e5, 100.0
    critical, extension = 1.25, 0.712
    e_0, slope, exponent = 0.934, 0.019, 0.7
    radius, h_0, c_h, n_b, a_0, n_d, z_max, c_z = 0.01, 7.05, 0.968, 1.1, 0.704, 3.5, 4.0, 600.0

    def __init__(self, stress: np.ndarray, voids: np.ndarray, tensors: list[np.ndarray]) -> None:
        self.stress, self.voids = stress.copy(), voids.copy()
        self.back, self.start, self.fabric = (tensor.copy() for tensor in tensors)

    def compress(self, strain: np.ndarray) -> None:
        """Adds a vertical strain of each point."""
        self.deform(strain[:, None] * np.array([0.0, 0.0, 1.0, 0.0]))

    def deform(self, tensor: np.ndarray) -> None:
        """Adds a strain of each point."""
        one = np.array([1.0, 1.0, 1.0, 0.0])
        strain = tensor[:, :3].sum(axis=1)
        mean = self.stress[:, :3].mean(axis=1)
        p = np.maximum(mean, self.least)
        r = (self.stress - mean[:, None] * one) / p[:, None]
        shear = self.shear_number * np.sqrt(self.atmosphere * p)
        shear *= (2.97 - self.voids) ** 2 / (1 + self.voids)
        bulk = shear * 2 * (1 + self.poisson) / (3 * (1 - 2 * self.poisson))
        gap = r - self.back
        length = np.sqrt(contract(gap, gap))
        n = gap / np.maximum(length, 1e-30)[:, None]
        along = contract(n, r)
        load = 2 * shear * contract(n, tensor) - along * bulk * strain
        flows = (length > np.sqrt(2 / 3) * self.radius * (1 - 1e-4)) & (load > 0)
        new = flows & (contract(self.back - self.start, n) < 0)
        self.start[new] = self.back[new]
        xx, yy, zz, zx = n.T
        square = np.stack([xx**2 + zx**2, yy**2, zz**2 + zx**2, zx * (xx + zz)], axis=1)
        cube = contract(n, square)
        lode = np.clip(np.sqrt(6) * cube, -1, 1)
        c = self.extension
        g = 2 * c / (1 + c - (1 - c) * lode)
        psi = self.voids - self.e_0 + self.slope * (p / self.atmosphere) ** self.exponent
        bound = np.sqrt(2 / 3) * (g * self.critical * np.exp(-self.n_b * psi) - self.radius)
        dense = np.sqrt(2 / 3) * (g * self.critical * np.exp(self.n_d * psi) - self.radius)
        flow = self.a_0 * (1 + np.maximum(contract(self.fabric, n), 0))
        flow *= dense - contract(self.back, n)
        big_b = 1 + 1.5 * (1 - c) / c * g * lode
        big_c = 3 * np.sqrt(1.5) * (1 - c) / c * g
        b_0 = self.shear_number * self.h_0 * (1 - self.c_h * self.voids)
        b_0 /= np.sqrt(p / self.atmosphere)
        softness = np.maximum(contract(self.back - self.start, n), 1e-8) / b_0
        stiff = 2 * shear * (big_b - big_c * cube) - bulk * flow * along
        total = 2 / 3 * p * (bound - contract(self.back, n)) + softness * stiff
        lh = np.where(flows, load / total, 0.0)
        multiplier = lh * softness
        self.stress += 2 * shear[:, None] * (tensor - strain[:, None] * one / 3)
        self.stress += (bulk * strain)[:, None] * one
        turned = big_b[:, None] * n - big_c[:, None] * (square - one / 3)
        self.stress -= (multiplier * 2 * shear)[:, None] * turned
        self.stress -= (multiplier * bulk * flow)[:, None] * one
        self.back += (2 / 3 * lh)[:, None] * (bound[:, None] * n - self.back)
        built = self.c_z * np.maximum(-multiplier * flow, 0)
        self.fabric -= built[:, None] * (self.z_max * n + self.fabric)
        self.voids = (1 + self.voids) * np.exp(-strain) - 1
        rise = np.maximum(self.least - self.stress[:, :3].mean(axis=1), 0)
        self.stress += rise[:, None] * one


class Layer:
    """Means over rows of particles of the same height."""

    def __init__(self, run: Run, name: str = "liquefaction") -> None:
        self.run, self.name = run, name
        self.times = run.times(name)
        z = run.fields(name, 0)["points"][:, 2].round(6)
        self.z = np.unique(z)
        self.rows = [np.flatnonzero(z == height) for height in self.z]

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Of one value or tensor per particle."""
        return np.array([values[row].mean(axis=0) for row in self.rows])

    def fields(self, step: int) -> dict[str, np.ndarray]:
        """Means at one output step."""
        return {key: self.mean(value) for key, value in self.run.fields(self.name, step).items()}


def reconsolidate(layer: Layer, first: int, dt: float = 2.0e-3) -> tuple[np.ndarray, np.ndarray]:
    """Terzaghi's consolidation of the layer from an output step on, with the sand's own stiffness.

    Incompressible water; strains are what flows out, stresses follow them, and what they do not
    carry of the total stress is excess pressure. Finite volumes, one for each row of particles.
    Returns settlements of the uppermost row [m] and excess pressures [Pa] at the output steps.
    """
    start = layer.fields(first)
    dz = layer.z[1] - layer.z[0]
    components = ("xx", "yy", "zz", "zx")
    tensors = [np.stack([start[f"{t}_{c}"] for c in components], axis=1) for t in TENSORS]
    sand = Sand(-start["effective_stress"][:, [0, 1, 2, 5]], start["void_ratio"], tensors)
    excess = start["pore_pressure"] - UNIT_WEIGHT * (HEIGHT - layer.z)
    total = excess + sand.stress[:, 2]
    strain = np.zeros_like(excess)
    flow = np.zeros(len(excess) + 1)  # upwards through the faces between rows
    settlements, pressures = [0.0], [excess.copy()]
    for before, after in zip(layer.times[first:-1], layer.times[first + 1 :], strict=True):
        for _ in range(round((after - before) / dt)):
            flow[1:-1] = -CONDUCTIVITY / UNIT_WEIGHT * np.diff(excess) / dz
            flow[-1] = CONDUCTIVITY / UNIT_WEIGHT * excess[-1] / (0.5 * dz)
            step = dt * np.diff(flow) / dz
            sand.compress(step)
            strain += step
            excess = total - sand.stress[:, 2]
        settlements.append(dz * (strain.sum() - 0.5 * strain[-1]))
        pressures.append(excess.copy())
    return np.array(settlements), np.array(pressures)


def test_layer_liquefies_and_settles(dosui: Runner) -> None:
    """r_u to 0.95 ... 1 everywhere, from the top down; settlement and pressures of theory."""
    run = dosui(layer())
    assert run.status == 0, run.stderr
    found = Layer(run)
    weight = -found.fields(0)["effective_stress"][:, 2]
    hydrostatic = UNIT_WEIGHT * (HEIGHT - found.z)
    excess = np.array(
        [found.fields(k)["pore_pressure"] - hydrostatic for k in range(len(found.times))]
    )
    ratio = excess / weight
    assert np.all(ratio.max(axis=0) >= 0.95)
    assert ratio.max() <= 1.01
    early = ratio[int(np.argmin(abs(found.times - 0.5)))]  # while it comes: more above
    assert early[-1] > 1.2 * early[0]
    first = int(np.argmin(abs(found.times - SHAKEN)))
    settlement, pressure = reconsolidate(found, first)
    sunk = -np.array([found.fields(k)["displacement"][-1, 2] for k in range(len(found.times))])
    sunk = sunk[first:] - sunk[first]
    assert sunk[-1] > 0.9e-2
    assert sunk[2:] == pytest.approx(settlement[2:], rel=1e-2)
    scale = np.linalg.norm(pressure[0])
    wrong = np.linalg.norm(excess[first:] - pressure, axis=1) / scale
    assert np.all(wrong <= 1e-2)
    assert np.linalg.norm(pressure[-1]) < 0.1 * scale  # most of the way
    # the time: where half of the final settlement is reached
    half = [np.interp(0.5 * s[-1], s, found.times[first:]) - SHAKEN for s in (sunk, settlement)]
    assert half[0] == pytest.approx(half[1], rel=1e-2)


@pytest.mark.parametrize("integrator", ["semi_implicit", "explicit"])
def test_ranks_liquefy_alike(dosui: Runner, integrator: str) -> None:
    """Round-off does not grow in liquefied sand; restarts repeat every bit."""
    text = layer(integrator, end_time=0.75)
    one = dosui(text, folder="one")
    three = dosui(text, ranks=3, folder="three")
    assert one.status == 0, one.stderr
    assert three.status == 0, three.stderr
    a, b = one.fields("liquefaction"), three.fields("liquefaction")
    pressure_ratio = (
        1 - a["effective_stress"][:, 2] / one.fields("liquefaction", 0)["effective_stress"][:, 2]
    )
    assert pressure_ratio.max() > 0.9
    for name in ("pore_pressure", "effective_stress", "displacement", "fabric_zx", "void_ratio"):
        assert np.abs(a[name] - b[name]).max() <= 1e-11 * np.abs(a[name]).max(), name
    steps = int(one.history("liquefaction", "step")[-1])
    stops = text.replace("geostatic_start", f"maximum_steps = {2 * steps // 3}\n  geostatic_start")
    stops = stops.replace("&output", f"&output checkpoint_steps = {steps // 2}")
    first = dosui(stops, folder="parts")
    assert first.status == 0, first.stderr
    second = dosui(text, "--restart", "liquefaction.restart.h5", folder="parts")
    assert second.status == 0, second.stderr
    c = second.fields("liquefaction")
    for name in a:
        assert np.array_equal(a[name], c[name]), name


COLUMN = """
&scene dimension = {dim} integrator = '{integrator}' water = 'none' gravity = {dim}*0.0
  deformation = '{deformation}' /
&grid spacing = 0.1 {shape} /
&time end_time = {time} largest_step = {step} output_interval = {time} /
&material name = 'sand' model = 'dafalias_manzari' poisson_ratio = 0.05 porosity = 0.4737 /
&region name = 'column' material = 'sand' box_min = {dim}*0.0 box_max = {top} /
&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e4, 3*0.0 /
&surface name = 'bottom' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
{more}
&mechanical_condition surface = 'bottom' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'normal_velocity' value = {velocity}
  factor_times = 0.0, 1.0 factor_values = 0.0, 1.0 /
&output name = 'column' /
"""


@pytest.mark.parametrize(
    ("dim", "integrator", "deformation"),
    [
        (1, "quasi_static", "small_strain"),
        (3, "quasi_static", "small_strain"),
        (1, "explicit", "updated"),
    ],
)
def test_sand_in_the_oedometer(dosui: Runner, dim: int, integrator: str, deformation: str) -> None:
    """One per cent of compression: the rates of the model, integrated on their own."""
    quasi_static = integrator == "quasi_static"
    sides = "".join(
        f"&surface name = '{face}' region = 'column' face = '{face}' /\n"
        f"&mechanical_condition surface = '{face}' kind = 'roller' /\n"
        for face in ("x-", "x+", "y-", "y+")
        if dim == 3
    )
    run = dosui(
        COLUMN.format(
            dim=dim,
            integrator=integrator,
            deformation=deformation,
            shape="shape_function = 'gimp'" if deformation == "updated" else "",
            time=1.0,
            velocity=-0.02 if dim == 1 else -0.01,
            step=0.1 if quasi_static else 1.0,
            top="1.0" if dim == 1 else "0.1, 0.1, 0.5",
            more=sides
            + (
                ""
                if quasi_static
                else "&mechanics damping = 'viscous' damping_coefficient = 600.0 /"
            ),
        )
    )
    assert run.status == 0, run.stderr
    data = run.fields("column")
    e_0 = 0.4737 / (1 - 0.4737)
    strain = np.log((1 + e_0) / (1 + data["void_ratio"]))  # of every particle
    assert strain.mean() == pytest.approx(0.01, rel=1e-2)
    if quasi_static:
        assert np.ptp(strain) < 1e-6
    zero = np.zeros((len(strain), 4))
    soil = Sand(zero + np.array([1.0e4, 1.0e4, 1.0e4, 0.0]), zero[:, 0] + e_0, [zero] * 3)
    for _ in range(4000):
        soil.compress(strain / 4000)
    assert soil.stress[:, 2].min() > 2.0e5
    # where the grid is updated, the two cells that the surface moves through see their strains
    # come and go a little
    inner = data["points"][:, 2] < (0.8 if deformation == "updated" else 1.0)
    for k in (0, 2):
        stress = -data["effective_stress"][inner, k]
        assert stress == pytest.approx(soil.stress[inner, k], rel=5e-3)
    if deformation == "updated":  # the void ratio is that of the porosity
        n = data["porosity"]
        assert data["void_ratio"] == pytest.approx(n / (1 - n), rel=1e-6)


CONSOLIDATION = """
&scene dimension = 2 integrator = 'quasi_static' gravity = 2*0.0 /
&grid spacing = 0.1 /
&time end_time = 1.0 largest_step = 0.1 /
&material name = 'sand' model = 'dafalias_manzari' poisson_ratio = 0.05 porosity = 0.4737
  hydraulic_conductivity = {conductivity} /
&region name = 'column' material = 'sand' box_min = 2*0.0 box_max = 0.2, 0.5
  particles_per_cell = 2 /
&initial_state effective_stress = 'given' effective_stress_value = 3*-1.0e4, 3*0.0 /
&surface name = 'bottom' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&surface name = 'left' region = 'column' face = 'x-' /
&surface name = 'right' region = 'column' face = 'x+' /
&mechanical_condition surface = 'bottom' kind = 'roller' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = 1.0e5
  factor_times = 0.0, 1.0 factor_values = 0.1, 1.0 /
&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /
&output name = 'column' /
"""


def test_saturated_sand_consolidates(dosui: Runner) -> None:
    """A slow load: the strain that the sand's rates give; a fast one: the water bears it."""
    run = dosui(CONSOLIDATION.format(conductivity="1.0"), folder="slow")
    assert run.status == 0, run.stderr
    data = run.fields("column")
    assert data["effective_stress"][:, 2] == pytest.approx(-1.0e5, rel=1e-3)
    zero, e_0 = np.zeros((1, 4)), 0.4737 / (1 - 0.4737)
    soil = Sand(zero + np.array([1e4, 1e4, 1e4, 0.0]), zero[:, 0] + e_0, [zero] * 3)
    while soil.stress[0, 2] < 1.0e5:
        soil.compress(np.array([1.0e-6]))
    strain = np.log((1 + e_0) / (1 + soil.voids[0]))
    assert np.log((1 + e_0) / (1 + data["void_ratio"])) == pytest.approx(strain, rel=5e-3)
    run = dosui(CONSOLIDATION.format(conductivity="0.0"), folder="fast")
    assert run.status == 0, run.stderr
    data = run.fields("column")
    assert data["pore_pressure"] == pytest.approx(9.0e4, rel=2e-2)
    assert data["effective_stress"][:, 2] == pytest.approx(-1.0e4, rel=2e-1)


SOILS = """
&scene dimension = 2 water = 'none' integrator = 'explicit' gravity = 2*0.0 /
&grid spacing = 0.1 /
&time end_time = 1.0 /
&material name = 'elastic' young_modulus = 2.0e7 poisson_ratio = 0.3 /
&material name = 'planes' model = 'mohr_coulomb' young_modulus = 2.0e7 poisson_ratio = 0.3
  friction_angle = 30.0 cohesion = 1.0e3 /
&material name = 'cone' model = 'drucker_prager' young_modulus = 2.0e7 poisson_ratio = 0.3
  friction_angle = 30.0 cohesion = 1.0e3 /
&material name = 'clay' model = 'cam_clay' critical_state_ratio = 1.0 lambda = 0.2
  kappa = 0.04 poisson_ratio = 0.3 porosity = 0.5 /
&material name = 'sand' model = 'dafalias_manzari' poisson_ratio = 0.05 porosity = 0.4737 /
&region name = 'body' material = 'sand' box_min = 2*0.0 box_max = 2*1.0 /
"""


def test_every_soil_is_tested(dosui: Runner) -> None:
    """`dosui --elements`: drained, undrained and cyclic; only the sand liquefies."""
    run = dosui(SOILS, "--elements=5e4")
    assert run.status == 0, run.stderr
    rows: dict[tuple[str, str], list[list[float]]] = {}
    for line in run.stdout.splitlines()[1:]:
        material, test, _, *values = line.split(",")
        rows.setdefault((material, test), []).append([float(v) for v in values])
    tests = {key: np.array(value) for key, value in rows.items()}
    names = {name for _, name in tests}
    for shear in ("triaxial", "simple_shear"):
        assert {f"{shear}_drained", f"{shear}_undrained"} <= names
    assert "oedometer" in names
    for soil in ("elastic", "planes", "cone", "clay", "sand"):
        assert {name for s, name in tests if s == soil} == names
        for name in names:
            table = tests[soil, name]
            strain, stress, pressure = table[:, :4], table[:, 4:8], table[:, 8]
            if "undrained" in name:  # no volume change, one total stress stays
                assert np.abs(strain[:, :3].sum(axis=1)).max() < 1e-12
                kept = 2 if "shear" in name else 0
                assert stress[:, kept] - pressure == pytest.approx(-5e4, abs=1e-6 * 5e4)
            elif name == "triaxial_drained":
                assert stress[:, 0] == pytest.approx(-5e4, rel=1e-6)
            if name.startswith("cyclic"):
                cycled = stress[:, 3] if "shear" in name else stress[:, 0] - stress[:, 2]
                amplitude = (0.2 if "shear" in name else 0.4) * 5e4
                assert np.abs(cycled).max() == pytest.approx(amplitude, rel=6e-3)
                mean = -stress[:, :3].mean(axis=1)
                if soil == "sand":
                    assert mean.min() < 0.05 * mean[0]
                else:
                    assert mean.min() > 0.3 * mean[0]
    # two per cent of undrained triaxial compression and of simple shear, side by side
    zero = np.zeros((2, 4))
    e = 0.4737 / (1 - 0.4737)
    sand = Sand(zero + np.array([5e4, 5e4, 5e4, 0.0]), zero[:, 0] + e, [zero] * 3)
    step = np.array([[-1.0, -1.0, 2.0, 0.0], [0.0, 0.0, 0.0, -1.0]]) * 1e-2 / 8000
    for _ in range(8000):
        sand.deform(step)
    for k, name in enumerate(("triaxial_undrained", "simple_shear_undrained")):
        table = tests["sand", name]
        found = np.array(
            [np.interp(0.02, np.abs(table[:, 2 + k]), table[:, 4 + c]) for c in range(4)]
        )
        assert -found == pytest.approx(sand.stress[k], abs=5e-3 * 5e4), name


BAD = (
    ("critical_state_ratio = -1.0", "critical_state_ratio"),
    ("yield_ratio = 0.5", "yield_ratio"),
    ("young_modulus = 1.0e6", "young_modulus"),
    ("substep_tolerance = 0.1", "substep_tolerance"),
)


@pytest.mark.parametrize(("keys", "key"), BAD)
def test_bad_constants_are_refused(dosui: Runner, keys: str, key: str, tmp_path: Path) -> None:
    """With file, line, group and key."""
    text = layer().replace("poisson_ratio = 0.05", f"poisson_ratio = 0.05\n  {keys}")
    run = dosui(text)
    assert run.status == 2
    assert f"&material {key}" in run.stderr
    assert not list(tmp_path.glob("*.vtkhdf"))

"""Namelists of the hard cases."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dosui_post.exact import Soil, Terzaghi
from dosui_post.stability.case import Method

GAMMA = 9810.0  # N/m3
LOAD = 1000.0  # Pa
POROSITY = 0.3
WIDTH, HEIGHT = 0.25, 1.0  # m, of the columns
FACTORS = (0.05, 0.1, 0.2)  # c_v t/H2 of the outputs


def keys_of(method: Method) -> str:
    """Keys of &water that belong to the method."""
    return "operator = 'two_pass'" if method.is_two_pass else ""


def transfer_of(method: Method) -> str:
    """Keys of &mechanics that belong to the method."""
    return "transfer = 'flip' average_volume_change = .false." if method.is_two_pass else ""


def fading(method: Method) -> str:
    """Damping of what the first load stirs up, where there is inertia."""
    return "damping = 'fading'" if method.has_inertia else ""


def undrained(method: Method) -> str:
    """The start that quasi-static steps make by themselves."""
    return "undrained_start = .true." if method.has_inertia else ""


@dataclass(frozen=True)
class Column:
    """A column under a load, drained at its top."""

    young_modulus: float = 1.0e6  # Pa
    poisson_ratio: float = 0.2
    bulk_modulus: float = 3.0e6  # Pa, of the water
    conductivity: float = 1.0e-4  # m/s
    spacing: float = 0.05  # of the particles [m]
    per_cell: int = 2
    angle: float = 0.0  # deg
    jitter: float = 0.0  # spacings
    factors: tuple[float, ...] = FACTORS
    time_step: float = 0.0  # s
    load_keys: str = ""

    @property
    def soil(self) -> Soil:
        """For the exact solution."""
        return Soil(
            young_modulus=self.young_modulus,
            poisson_ratio=self.poisson_ratio,
            porosity=POROSITY,
            conductivity=self.conductivity,
            water_bulk_modulus=self.bulk_modulus,
            unit_weight=GAMMA,
        )

    @property
    def solution(self) -> Terzaghi:
        """The exact solution."""
        return Terzaghi(self.soil, LOAD, HEIGHT)

    @property
    def times(self) -> list[float]:
        """Of the outputs [s]."""
        return [self.solution.time(factor) for factor in self.factors]

    def text(self, method: Method, times: list[float] | None = None, starts: bool = True) -> str:
        """The namelist; `starts`: with an undrained start where there is inertia."""
        times = times or self.times
        control = f"time_step = {self.time_step!r}" if self.time_step else ""
        damping = ""
        if starts:
            control += f" {undrained(method)}"
            damping = fading(method)
        sine, cosine = math.sin(math.radians(self.angle)), math.cos(math.radians(self.angle))
        middle = 0.5 * WIDTH
        drained = (middle * cosine - HEIGHT * sine, middle * sine + HEIGHT * cosine)
        drain = "pressure" if self.angle else "head"
        return f"""&scene title = 'Column' dimension = 2 integrator = '{method.integrator}' /
&grid spacing = {self.spacing * self.per_cell!r} /
&time end_time = {times[-1]!r} output_times = {", ".join(map(repr, times))} {control} /
&material name = 'soil' young_modulus = {self.young_modulus!r}
  poisson_ratio = {self.poisson_ratio!r} porosity = {POROSITY}
  hydraulic_conductivity = {self.conductivity!r} /
&water bulk_modulus = {self.bulk_modulus!r} {keys_of(method)} /
&mechanics {transfer_of(method)} {damping} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = {WIDTH}, {HEIGHT}
  particle_spacing = {self.spacing!r} shape_angle = {self.angle!r}
  lattice_angle = {self.angle!r} jitter = {self.jitter!r} /
{walls("base", "left", "right")}
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {LOAD} {self.load_keys} /
&hydraulic_condition surface = 'top' kind = '{drain}' value = 0.0 /
&output name = 'result' /
&verification case = 'terzaghi' load = {LOAD} length = {HEIGHT}
  drained = {drained[0]!r}, {drained[1]!r} direction = {sine!r}, {-cosine!r} /
"""


FACES = {"base": "z-", "left": "x-", "right": "x+", "top": "z+"}


def walls(*names: str) -> str:
    """Smooth walls on faces of the body."""
    return "\n".join(
        f"&surface name = '{name}' region = 'body' face = '{FACES[name]}' /\n"
        f"&mechanical_condition surface = '{name}' kind = 'roller' /"
        for name in names
    )


def side_walls(*regions: str) -> str:
    """Smooth walls beside several regions."""
    return "\n".join(
        f"&surface name = '{region}{face}' region = '{region}' face = '{face}' /\n"
        f"&mechanical_condition surface = '{region}{face}' kind = 'roller' /"
        for region in regions
        for face in ("x-", "x+")
    )


# ---------------------------------------------------------------------- undrained and drained

SLOW, FAST = 1.0e-9, 1.0e-3  # m/s
LAYER_FACTOR = 0.1  # of the slow layer


def layer_time() -> float:
    """Of the layers' output [s]."""
    storage = POROSITY / 2.2e9 + 1.0e-6
    return LAYER_FACTOR * 0.25 * storage * GAMMA / SLOW


def layers(method: Method) -> str:
    """A slow base under a fast lid, a millionfold."""
    soil = "&material name = '{}' young_modulus = 1.0e6 poisson_ratio = 0.0 porosity = 0.3\n"
    soil += "  hydraulic_conductivity = {!r} /"
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = 0.05 /
&time end_time = {layer_time()!r} /
{soil.format("slow", SLOW)}
{soil.format("fast", FAST)}
&water bulk_modulus = 2.2e9 {keys_of(method)} /
&mechanics {transfer_of(method)} {fading(method)} /
&region name = 'slow' material = 'slow' box_min = 0.0, 0.0 box_max = 0.1, 0.5 /
&region name = 'fast' material = 'fast' box_min = 0.0, 0.5 box_max = 0.1, 1.0 /
&surface name = 'foot' region = 'slow' face = 'z-' /
&surface name = 'top' region = 'fast' face = 'z+' /
{side_walls("slow", "fast")}
&mechanical_condition surface = 'foot' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {LOAD} /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'result' /
"""


def layered_pressure(height: np.ndarray, cells: int = 800) -> np.ndarray:
    """Pressure of `layers` by finite volumes and exact exponentials in time [Pa]."""
    z = (np.arange(cells) + 0.5) / cells
    k = np.where(z < 0.5, SLOW, FAST) / GAMMA
    between = 2 * k[1:] * k[:-1] / (k[1:] + k[:-1])
    matrix = np.zeros((cells, cells))
    for i, value in enumerate(between):
        matrix[i : i + 2, i : i + 2] += value * np.array([[-1.0, 1.0], [1.0, -1.0]])
    matrix[-1, -1] -= 2 * k[-1]
    storage = POROSITY / 2.2e9 + 1.0e-6
    rates, modes = np.linalg.eigh(matrix * cells**2 / storage)
    start = np.full(cells, LOAD * 1.0e-6 / storage)
    pressure = modes @ (np.exp(rates * layer_time()) * (modes.T @ start))
    return np.asarray(np.interp(height, z, pressure))


def strip(method: Method) -> str:
    """A strip load on an undrained body, four disordered particles a cell."""
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = 0.25 /
&time end_time = 0.01 {undrained(method)} /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.3 porosity = {POROSITY}
  hydraulic_conductivity = 0.0 /
&water bulk_modulus = 1.0e8 {keys_of(method)} /
&mechanics {transfer_of(method)} {fading(method)} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 5.0, 5.0 jitter = 0.2 /
{walls("base", "left", "right")}
&surface name = 'strip' region = 'body' face = 'z+' box_max = 1.0, 9.0 /
&mechanical_condition surface = 'strip' kind = 'pressure' value = {LOAD} /
&output name = 'result' /
"""


def rigid_box(
    method: Method, spacing: float, seconds: float, conductivity: str, bulk_modulus: str, rest: str
) -> str | None:
    """Seepage through a body that does not move."""
    if method.integrator == "semi_implicit":
        return None
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = {spacing} /
&time end_time = {seconds!r} /
&material name = 'soil' rigid = .true. porosity = {POROSITY}
  hydraulic_conductivity = {conductivity} /
&water bulk_modulus = {bulk_modulus} {keys_of(method)} /
{rest}
&output name = 'result' /
"""


def checkerboard(method: Method) -> str | None:
    """A rigid body of alternating pressures, drained at its top."""
    rest = f"""&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 0.5, 0.5
  particles_per_cell = 1 /
&surface name = 'top' region = 'body' face = 'z+' /
&initial_state pore_pressure = 'checkerboard' pore_pressure_value = {LOAD} /
&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /"""
    return rigid_box(method, 0.05, checkerboard_time(), "1.0e-4", "3.0e6", rest)


def island(method: Method) -> str | None:
    """A rigid box on a lattice that is turned against it, water at its faces rises at once."""
    rest = """&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 2.0, 2.0
  shape_angle = 20.0 lattice_angle = 5.0 jitter = 0.1 /
&surface name = 'shore' region = 'body' face = 'all' /
&hydraulic_condition surface = 'shore' kind = 'head' value = 1.0 /"""
    return rigid_box(method, 0.1, 0.02, "1.0e-5", "2.2e9", rest)


def checkerboard_time() -> float:
    """Two spacings squared over the diffusivity [s]."""
    return 2 * 0.05**2 / (1.0e-4 / GAMMA * 3.0e6 / POROSITY)


def seam(method: Method) -> str:
    """A layer of one particle, a hundred times less permeable, between two sands."""
    times = Column().times
    region = "&region name = '{0}' material = '{1}' box_min = 0.0, {2} box_max = 0.2, {3}"
    region += " particles_per_cell = 1 /"
    soil = "&material name = '{}' young_modulus = 1.0e6 porosity = 0.3 poisson_ratio = 0.2\n"
    soil += "  hydraulic_conductivity = {!r} /"
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = 0.05 /
&time end_time = {times[-1]!r} {undrained(method)} /
{soil.format("sand", 1.0e-4)}
{soil.format("clay", 1.0e-6)}
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&mechanics {transfer_of(method)} {fading(method)} /
{region.format("lower", "sand", 0.0, 0.5)}
{region.format("seam", "clay", 0.5, 0.55)}
{region.format("upper", "sand", 0.55, 1.0)}
{side_walls("lower", "seam", "upper")}
&surface name = 'foot' region = 'lower' face = 'z-' /
&surface name = 'top' region = 'upper' face = 'z+' /
&mechanical_condition surface = 'foot' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {LOAD} /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'result' /
"""


# ---------------------------------------------------------------------- rest and motion

REST_DEPTH = 2.0  # m


def rest(method: Method) -> str:
    """A jittered bed under water in hydrostatic and geostatic equilibrium."""
    return f"""&scene dimension = 2 integrator = '{method.integrator}' gravity = 0.0, -9.81 /
&grid spacing = 0.2 /
&time end_time = 2.0 geostatic_start = .true. /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.3 porosity = {POROSITY}
  hydraulic_conductivity = 1.0e-4 /
&water bulk_modulus = 3.0e7 {keys_of(method)} /
&mechanics {transfer_of(method)} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 2.0, {REST_DEPTH}
  jitter = 0.25 /
{walls("base", "left", "right")}
&surface name = 'top' region = 'body' face = 'z+' /
&initial_state pore_pressure = 'hydrostatic' water_level = 3.0 effective_stress = 'geostatic'
  surface_level = {REST_DEPTH} lateral_ratio = 0.43 /
&mechanical_condition surface = 'top' kind = 'reservoir' value = 3.0 /
&hydraulic_condition surface = 'top' kind = 'head' value = 3.0 /
&output name = 'result' /
"""


TORN_PRESSURE = 1000.0  # [Pa]
BODY_PRESSURE = 1.0e6  # Pa


ELASTIC = "young_modulus = 1.0e6 poisson_ratio = 0.3"


def flying(method: Method, seconds: float, bodies: str, soil: str = ELASTIC) -> str | None:
    """Bodies that nothing holds."""
    if not method.has_inertia:
        return None
    return f"""&scene dimension = 2 integrator = '{method.integrator}' deformation = 'updated' /
&grid spacing = 0.1 shape_function = 'gimp' /
&time end_time = {seconds!r} /
&material name = 'soil' {soil} porosity = {POROSITY}
  hydraulic_conductivity = 1.0e-4 /
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&mechanics {transfer_of(method)} /
{bodies}
&output name = 'result' /
"""


def drifting(method: Method, motion: str, seconds: float) -> str | None:
    """A square in equilibrium with its own stress and pressure, that moves freely."""
    p = BODY_PRESSURE
    body = f"""&region name = 'body' material = 'soil' box_min = -0.3, -0.3
  box_max = 0.3, 0.3 {motion} /
&initial_state pore_pressure = 'given' pore_pressure_value = {p!r}
  effective_stress = 'given' effective_stress_value = {p!r}, {p!r}, {p!r}, 0.0, 0.0, 0.0 /"""
    return flying(method, seconds, body)


def collision(method: Method) -> str | None:
    """Two dry-sided saturated blocks meet on their way."""
    region = "&region name = '{}' material = 'soil' box_min = {}, 0.0 box_max = {}, 0.5"
    region += " velocity = {}, 0.3 /"
    bodies = [region.format("a", 0.0, 0.5, 1.0), region.format("b", 0.7, 1.2, -1.0)]
    return flying(method, 0.15, "\n".join(bodies))


def torn(method: Method) -> str | None:
    """A block of sand under pressure, whose halves fly apart; its free surface is drained."""
    if not method.has_inertia:
        return None
    regions = "\n".join(
        f"""&region name = '{name}' material = 'sand' velocity = {speed!r}, 0.0
  box_min = {low!r}, 0.0 box_max = {low + 1.0!r}, 1.0 /
&surface name = 'air_{name}' region = '{name}' face = 'free' /
&hydraulic_condition surface = 'air_{name}' kind = 'pressure' value = 0.0 /"""
        for name, low, speed in (("a", 0.0, -4.0), ("b", 1.0, 4.0))
    )
    return f"""&scene dimension = 2 integrator = '{method.integrator}' deformation = 'updated' /
&grid spacing = 0.1 shape_function = 'gimp' /
&time end_time = 0.1 /
&material name = 'sand' model = 'mohr_coulomb' young_modulus = 1.0e6 poisson_ratio = 0.0
  porosity = {POROSITY} friction_angle = 30.0 tensile_strength = 0.0
  hydraulic_conductivity = 5.0 /
&water bulk_modulus = 400.0 unit_weight = 1.0e4 {keys_of(method)} /
&mechanics {transfer_of(method)} /
{regions}
&initial_state pore_pressure = 'given' pore_pressure_value = {TORN_PRESSURE!r} /
&output name = 'result' /
"""


def thrown(method: Method) -> str | None:
    """A body, and one particle that flies away from it."""
    soil = f"model = 'mohr_coulomb' {ELASTIC} friction_angle = 30.0 tensile_strength = 0.0"
    bodies = """&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 1.0, 1.0 /
&region name = 'grain' material = 'soil' box_min = 0.5, 1.1 box_max = 0.55, 1.15
  velocity = 0.0, 2.0 /"""
    return flying(method, 0.5, bodies, soil)


def vibration(method: Method) -> str | None:
    """A saturated undrained bar in its first mode, without damping."""
    if not method.has_inertia:
        return None
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = 0.1 /
&time end_time = {20 * vibration_period()!r} /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.0 porosity = {POROSITY}
  hydraulic_conductivity = 0.0 /
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&mechanics {transfer_of(method)} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 0.2, 2.0 /
{walls("base", "left", "right")}
&initial_state mode_number = 1 mode_amplitude = 0.01 /
&output name = 'result' /
"""


def vibration_period() -> float:
    """Of the undrained bar [s]."""
    density = (1 - POROSITY) * 2650.0 + POROSITY * 1000.0
    return 4 * 2.0 / math.sqrt((1.0e6 + 3.0e6 / POROSITY) / density)


def cyclic(method: Method) -> str:
    """Thirty periods of a load from 0 to 1000 Pa, much shorter than the drainage."""
    period = cyclic_period()
    times = [0.5 * k * period for k in range(61)]
    values = [float(k % 2) for k in range(61)]
    keys = f"factor_times = {', '.join(map(repr, times))}\n"
    keys += f"  factor_values = {', '.join(map(repr, values))}"
    text = Column(load_keys=keys).text(method, [29.5 * period, 30 * period], starts=False)
    if method.has_inertia:
        return text
    return text.replace("&time ", f"&time largest_step = {period / 40!r} ")


def cyclic_period() -> float:
    """A fiftieth of the drainage time [s]."""
    return Column().solution.time(0.02)


# ---------------------------------------------------------------------- large deformation


def compression(method: Method) -> str:
    """A column pressed to half its height while it drains."""
    modulus = 1.0e6
    finite = not method.has_inertia
    load = 2 * math.log(2.0) * modulus if finite else math.log(2.0) * modulus
    seconds = 4.0 * GAMMA * (1.0 / modulus) / 1.0e-3
    deformation = "finite" if finite else "updated"
    control = "" if finite else f"factor_times = 0.0, {0.5 * seconds!r} factor_values = 0.0, 1.0"
    shape = "linear" if finite else "gimp"
    damping = "" if finite else "damping = 'viscous'"
    return f"""&scene dimension = 2 integrator = '{method.integrator}'
  deformation = '{deformation}' /
&grid spacing = 0.1 shape_function = '{shape}' /
&time end_time = {seconds!r} /
&material name = 'soil' young_modulus = {modulus!r} poisson_ratio = 0.0 porosity = 0.6
  hydraulic_conductivity = 1.0e-3 /
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&mechanics {transfer_of(method)} {damping} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 0.2, 1.0 /
{walls("base", "left", "right")}
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {load!r} {control} /
&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /
&output name = 'result' /
"""


def slide(method: Method) -> str | None:
    """A steep undrained slope of soft clay that runs out."""
    if not method.has_inertia:
        return None
    return f"""&scene dimension = 2 integrator = '{method.integrator}' deformation = 'updated'
  gravity = 0.0, -9.81 /
&grid spacing = 0.25 shape_function = 'gimp' /
&time end_time = 2.0 /
&material name = 'clay' model = 'mohr_coulomb' young_modulus = 2.0e6 poisson_ratio = 0.3
  porosity = 0.4 cohesion = 4000.0 hydraulic_conductivity = 1.0e-8 /
&water bulk_modulus = 3.0e7 {keys_of(method)} /
&mechanics {transfer_of(method)} /
&region name = 'body' material = 'clay' shape = 'polygon'
  vertices = 0.0, 0.0, 6.0, 0.0, 4.0, 3.0, 0.0, 3.0 /
&surface name = 'base' region = 'body' face = 'edge1' /
&surface name = 'left' region = 'body' face = 'edge4' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'left' kind = 'roller' /
&initial_state effective_stress = 'geostatic' surface_level = 3.0 lateral_ratio = 0.5 /
&output name = 'result' /
"""


# ---------------------------------------------------------------------- surfaces and ranks


def drawdown(method: Method) -> str:
    """A dam whose reservoir falls at once: a seepage face that water leaves through."""
    return f"""&scene dimension = 2 integrator = '{method.integrator}' gravity = 0.0, -9.81 /
&grid spacing = 0.1 /
&time end_time = 200.0 /
&material name = 'soil' rigid = .true. porosity = {POROSITY} hydraulic_conductivity = 1.0e-3
  retention = 'van_genuchten' retention_alpha = 4.0 retention_exponent = 2.0 /
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 2.0, 2.0 /
&surface name = 'left' region = 'body' face = 'x-' /
&surface name = 'right' region = 'body' face = 'x+' /
&initial_state pore_pressure = 'hydrostatic' water_level = 2.0 /
&hydraulic_condition surface = 'left' kind = 'reservoir' value = 0.5 /
&hydraulic_condition surface = 'right' kind = 'seepage_face' /
&output name = 'result' /
"""


def few_particles(method: Method) -> str:
    """Four particles in two cells: more ranks than work."""
    return f"""&scene dimension = 2 integrator = '{method.integrator}' /
&grid spacing = 0.5 /
&time end_time = 20.0 {undrained(method)} /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.2 porosity = {POROSITY}
  hydraulic_conductivity = 1.0e-4 /
&water bulk_modulus = 3.0e6 {keys_of(method)} /
&mechanics {transfer_of(method)} {fading(method)} /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 0.5, 2.0
  particles_per_cell = 1 /
{walls("base", "left", "right")}
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {LOAD} /
&hydraulic_condition surface = 'top' kind = 'pressure' value = 0.0 /
&output name = 'result' /
"""

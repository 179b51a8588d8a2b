"""The scenes of the report, written for any spacing, integrator and operator."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dosui_post.exact import Drainage, Mandel, Soil, Terzaghi

TIME_FACTORS = (0.05, 0.1, 0.2, 0.5)
"""T of the outputs; the largest error of them counts."""

Solution = Terzaghi | Mandel


@dataclass(frozen=True)
class Water:
    """Water and the conductivity that goes with it."""

    bulk_modulus: float
    """K_w [Pa]"""
    conductivity: float
    """k [m/s]"""


@dataclass(frozen=True)
class Problem:
    """A problem with an exact solution."""

    name: str
    title: str
    kind: str
    """case of &verification: terzaghi, mandel or drainage"""
    water: Water
    size: tuple[float, float]
    """width and height [m]"""
    load: float
    """Terzaghi: pressure [Pa]; Mandel: force on the quarter [N/m]; drainage: u_0 [Pa]"""
    angle: float = 0.0
    """of the column and its lattice [deg]"""
    jitter: float = 0.0
    """of the particles, in spacings"""

    @property
    def soil(self) -> Soil:
        """The soil of all scenes: E = 1 MPa, ν = 0.2, n = 0.3."""
        return Soil(
            young_modulus=1.0e6,
            poisson_ratio=0.2,
            porosity=0.3,
            conductivity=self.water.conductivity,
            water_bulk_modulus=self.water.bulk_modulus,
            unit_weight=9810.0,
            is_rigid=self.kind == "drainage",
        )

    @property
    def length(self) -> float:
        """Drainage path or half width [m]."""
        return self.size[0] if self.kind == "mandel" else self.size[1]

    @property
    def solution(self) -> Solution:
        """The exact solution."""
        if self.kind == "mandel":
            return Mandel(self.soil, self.load, self.length)
        if self.kind == "drainage":
            return Drainage(self.soil, self.load, self.length)
        return Terzaghi(self.soil, self.load, self.length)

    @property
    def times(self) -> list[float]:
        """Output times [s]."""
        return [self.solution.time(factor) for factor in TIME_FACTORS]

    @property
    def is_stiff(self) -> bool:
        """Water as it is, without trapped air: no explicit run can be afforded."""
        return self.water.bulk_modulus > 1.0e9

    @property
    def density_scaling(self) -> float:
        """Inertia with which a wave of the skeleton crosses the body in 1 % of the time [-]."""
        if self.soil.is_rigid:
            return 1.0
        density = (1 - self.soil.porosity) * 2650.0 + self.soil.porosity * 1000.0
        speed = math.sqrt(self.soil.constrained_modulus / density)
        factor = (0.01 * self.times[-1] * speed / self.length) ** 2
        return max(1.0, float(f"{factor:.1e}"))

    def particles(self, spacing: float) -> int:
        """Particles of an upright body, one per cell."""
        return round(self.size[0] / spacing) * round(self.size[1] / spacing)


_SOFT_COLUMN, _SOFT_SLAB = Water(3.0e6, 1.0e-4), Water(3.0e6, 5.0e-5)
_REAL = Water(2.2e9, 1.0e-7)

PROBLEMS = {
    problem.name: problem
    for problem in (
        Problem("terzaghi", "Terzaghi, soft water", "terzaghi", _SOFT_COLUMN, (0.25, 1.0), 1000.0),
        Problem("terzaghi-stiff", "Terzaghi, pure water", "terzaghi", _REAL, (0.25, 1.0), 1000.0),
        Problem("mandel", "Mandel, soft water", "mandel", _SOFT_SLAB, (0.2, 0.2), 200.0),
        Problem("mandel-stiff", "Mandel, pure water", "mandel", _REAL, (0.2, 0.2), 200.0),
        Problem(
            name="drainage",
            title="Turned, jittered drainage",
            kind="drainage",
            water=_SOFT_COLUMN,
            size=(0.25, 1.0),
            load=1000.0,
            angle=30.0,
            jitter=0.25,
        ),
    )
}


@dataclass(frozen=True)
class Method:
    """How the equations are solved."""

    name: str
    integrator: str
    operator: str = "compact"
    is_scaled: bool = False
    """with the inertia of `Problem.density_scaling`"""
    is_line: bool = False
    """a column as what it is: in one dimension"""

    @property
    def is_explicit(self) -> bool:
        """Tells whether inertia is resolved, so that the start must be undrained and damped."""
        return self.integrator != "quasi_static"

    def mechanics(self, problem: Problem) -> str:
        """Keys of &mechanics."""
        keys = []
        if self.operator == "two_pass":
            keys.append("transfer = 'flip'")  # the published one
        if self.is_explicit:
            keys.append("damping = 'fading'")
        if self.is_scaled:
            keys.append(f"density_scaling = {problem.density_scaling!r}")
        return " ".join(keys)


def scene_text(problem: Problem, method: Method, spacing: float, control: str) -> str:
    """The namelist; `control`: keys of &time, such as `courant = 0.5`."""
    *early, end = problem.times
    start = "undrained_start = .true." if method.is_explicit and problem.kind != "drainage" else ""
    dimension = 1 if method.is_line else 2
    return f"""&scene title = '{problem.title}' dimension = {dimension}
  integrator = '{method.integrator}' /
&grid spacing = {spacing!r} /
&time end_time = {end!r} {start} {control}
  output_times = {", ".join(repr(time) for time in early)} /
&material name = 'soil' {_skeleton(problem)} porosity = {problem.soil.porosity!r}
  hydraulic_conductivity = {problem.water.conductivity!r} /
&water bulk_modulus = {problem.water.bulk_modulus!r} operator = '{method.operator}' /
&mechanics {method.mechanics(problem)} /
{_line(problem, spacing) if method.is_line else _plane(problem, spacing)}
&output name = 'result' /
{_verification(problem, method.is_line)}
"""


# ---------------------------------------------------------------------- inside


def _line(problem: Problem, spacing: float) -> str:
    return f"""&region name = 'body' material = 'soil' box_min = 0.0 box_max = {problem.size[1]!r}
  particle_spacing = {spacing!r} /
&surface name = 'base' region = 'body' face = 'z-' /
&surface name = 'top' region = 'body' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {problem.load!r} /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /"""


def _plane(problem: Problem, spacing: float) -> str:
    return f"""&region name = 'body' material = 'soil' box_min = 0.0, 0.0
  box_max = {problem.size[0]!r}, {problem.size[1]!r} particle_spacing = {spacing!r}
  shape_angle = {problem.angle!r} lattice_angle = {problem.angle!r} jitter = {problem.jitter!r} /
&surface name = 'base' region = 'body' face = 'z-' /
&surface name = 'left' region = 'body' face = 'x-' /
&surface name = 'right' region = 'body' face = 'x+' /
&surface name = 'top' region = 'body' face = 'z+' /
{_conditions(problem)}"""


def _skeleton(problem: Problem) -> str:
    soil = problem.soil
    if soil.is_rigid:
        return "rigid = .true."
    return f"young_modulus = {soil.young_modulus!r} poisson_ratio = {soil.poisson_ratio!r}"


def _conditions(problem: Problem) -> str:
    wall = "&mechanical_condition surface = '{}' kind = 'roller' /".format
    drain = "&hydraulic_condition surface = '{}' kind = 'head' value = 0.0 /".format
    load = "&mechanical_condition surface = 'top' kind = '{}' value = {!r} /".format
    if problem.kind == "drainage":
        state = "&initial_state pore_pressure = 'given' pore_pressure_value = "
        return "\n".join([f"{state}{problem.load!r} /", drain("top")])
    if problem.kind == "mandel":
        return "\n".join([wall("base"), wall("left"), load("plate", problem.load), drain("right")])
    walls = [wall(name) for name in ("base", "left", "right")]
    return "\n".join([*walls, load("pressure", problem.load), drain("top")])


def _verification(problem: Problem, is_line: bool) -> str:
    width, height = problem.size
    if is_line:
        return (
            f"&verification case = '{problem.kind}' load = {problem.load!r}"
            f" length = {problem.length!r}\n  drained = {height!r} direction = -1.0 /"
        )
    if problem.kind == "mandel":
        drained, direction = (width, 0.0), (-1.0, 0.0)
    else:
        sine, cosine = math.sin(math.radians(problem.angle)), math.cos(math.radians(problem.angle))
        middle = 0.5 * width
        drained = (middle * cosine - height * sine, middle * sine + height * cosine)
        direction = (sine, -cosine)
    return (
        f"&verification case = '{problem.kind}' load = {problem.load!r}"
        f" length = {problem.length!r}\n"
        f"  drained = {drained[0]!r}, {drained[1]!r}"
        f" direction = {direction[0]!r}, {direction[1]!r} /"
    )

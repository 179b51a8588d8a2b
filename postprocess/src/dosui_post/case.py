"""The exact solution that belongs to a result, built from the scene stored in it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dosui_post.errors import DosuiPostError
from dosui_post.exact import (
    BarVibration,
    Drainage,
    Hydrostatic,
    Mandel,
    RadialConsolidation,
    Soil,
    Terzaghi,
)
from dosui_post.namelist import Group
from dosui_post.result import FloatArray, Result, Scene, to_xyz
from dosui_post.units import si

CASES = ("terzaghi", "mandel", "cryer", "de_leeuw", "hydrostatic", "bar", "drainage")


@dataclass(frozen=True)
class Geometry:
    """Where the exact solution lies in the scene."""

    drained: FloatArray
    """a point of the drained surface (3) [m]"""
    direction: FloatArray
    """unit vector from it into the body (3) [-]"""
    length: float
    """drainage path, half width or bar length [m]"""

    def depth(self, points: FloatArray) -> FloatArray:
        """Distance of points (n, 3) from the drained surface [m]."""
        return (points - self.drained) @ self.direction


class Case(ABC):
    """An exact solution placed in a scene."""

    title: ClassVar[str]
    tolerance: ClassVar[float]
    """largest relative error that `verify` accepts by default [-]"""

    geometry: Geometry

    @abstractmethod
    def time_factor(self, time: float) -> float:
        """Dimensionless time T [-]."""

    @abstractmethod
    def constants(self) -> list[str]:
        """The constants of the case, ready to be printed."""


@dataclass
class ColumnCase(Case):
    """Terzaghi's consolidation, and the drainage of a rigid column."""

    geometry: Geometry
    solution: Terzaghi
    title = "Terzaghi's consolidation"
    tolerance = 5.0e-3

    def time_factor(self, time: float) -> float:
        """T = c_v t/H²."""
        return self.solution.time_factor(time)

    def pressure(self, points: FloatArray, time: float) -> FloatArray:
        """Exact excess pore pressure [Pa]."""
        return self.solution.pressure(self.geometry.depth(points), time)

    def displacement(self, points: FloatArray, time: float) -> FloatArray:
        """Exact displacement (n, 3) [m]."""
        along = self.solution.displacement(self.geometry.depth(points), time)
        return np.outer(along, self.geometry.direction)

    def settlement(self, time: float) -> float | None:
        """Exact downward displacement of the loaded surface [m]; None if it moves level."""
        share = -float(self.geometry.direction[2])
        return share * self.solution.settlement(time) if abs(share) > 1.0e-6 else None

    @property
    def initial_pressure(self) -> float:
        """Exact undrained pore pressure [Pa]."""
        return self.solution.initial_pressure

    def constants(self) -> list[str]:
        """Soil, load and length."""
        load = si(self.solution.load, "Pa")
        return [*_soil_text(self.solution.soil), f"q = {load}", f"H = {si(self.length, 'm')}"]

    @property
    def length(self) -> float:
        """Drainage path [m]."""
        return self.geometry.length


@dataclass
class DrainageCase(ColumnCase):
    """Drainage of a rigid column."""

    title = "Drainage of a rigid column"
    tolerance = 1.0e-3

    def constants(self) -> list[str]:
        """Soil, initial pressure and length."""
        pressure = si(self.solution.load, "Pa")
        return [
            *_soil_text(self.solution.soil),
            f"u₀ = {pressure}",
            f"H = {si(self.length, 'm')}",
        ]


@dataclass
class MandelCase(Case):
    """Mandel's problem on a quarter section."""

    geometry: Geometry
    solution: Mandel
    height: float | None
    """of the plate above the plane of symmetry z = 0 [m], if known"""
    title = "Mandel's problem"
    tolerance = 2.0e-3

    def time_factor(self, time: float) -> float:
        """T = c_v t/a²."""
        return self.solution.time_factor(time)

    def abscissa(self, points: FloatArray) -> FloatArray:
        """Distance of points (n, 3) from the plane of symmetry [m]."""
        return self.geometry.length - self.geometry.depth(points)

    def pressure(self, points: FloatArray, time: float) -> FloatArray:
        """Exact excess pore pressure [Pa]."""
        return self.solution.pressure(self.abscissa(points), time)

    def displacement(self, points: FloatArray, time: float) -> FloatArray:
        """Exact displacement (n, 3) [m]."""
        outwards = self.solution.horizontal_displacement(self.abscissa(points), time)
        exact = np.outer(outwards, -self.geometry.direction)
        exact[:, 2] += self.solution.vertical_strain(time) * points[:, 2]
        return exact

    def settlement(self, time: float) -> float | None:
        """Exact settlement of the plate [m], if its height is known."""
        return None if self.height is None else self.solution.settlement(self.height, time)

    @property
    def initial_pressure(self) -> float:
        """Exact undrained pore pressure [Pa]."""
        return self.solution.initial_pressure

    def constants(self) -> list[str]:
        """Soil, force and half width."""
        return [
            *_soil_text(self.solution.soil),
            f"F = {si(self.solution.force, 'N/m')}",
            f"a = {si(self.geometry.length, 'm')}",
        ]


@dataclass
class RadialCase(Case):
    """Cryer's sphere or de Leeuw's cylinder about an axis along y."""

    geometry: Geometry
    solution: RadialConsolidation
    tolerance = 2.0e-2

    @property
    def title(self) -> str:  # type: ignore[override]
        """Name of the problem."""
        return "Cryer's sphere" if self.solution.dimension == 3 else "de Leeuw's cylinder"

    def time_factor(self, time: float) -> float:
        """T = c_v t/a²."""
        return self.solution.time_factor(time)

    @property
    def centre(self) -> FloatArray:
        """The drained surface's centre (3) [m]."""
        return self.geometry.drained + self.geometry.length * self.geometry.direction

    def abscissa(self, points: FloatArray) -> FloatArray:
        """Distance of points (n, 3) from the centre [m]."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1))

    def pressure(self, points: FloatArray, time: float) -> FloatArray:
        """Exact excess pore pressure [Pa]."""
        return self.solution.pressure(self.abscissa(points), time)

    def displacement(self, points: FloatArray, time: float) -> FloatArray:
        """Exact displacement (n, 3) [m]."""
        arm = points - self.centre
        radius = self.abscissa(points)
        outwards = self.solution.displacement(radius, time) / np.maximum(radius, 1.0e-300)
        return arm * outwards[:, np.newaxis]

    def settlement(self, time: float) -> float | None:
        """None: the surface does not settle evenly."""
        return None

    @property
    def initial_pressure(self) -> float:
        """Exact undrained pore pressure [Pa]."""
        return self.solution.initial_pressure

    def constants(self) -> list[str]:
        """Soil, load and radius."""
        return [
            *_soil_text(self.solution.soil),
            f"q = {si(self.solution.load, 'Pa')}",
            f"a = {si(self.geometry.length, 'm')}",
        ]


ConsolidationCase = ColumnCase | MandelCase | RadialCase


@dataclass
class HydrostaticCase(Case):
    """Water and soil at rest."""

    geometry: Geometry
    solution: Hydrostatic
    gravity: float
    """g [m/s²]"""
    title = "Hydrostatic column at rest"
    tolerance = 1.0e-9

    def time_factor(self, time: float) -> float:
        """Time over the time of free fall sqrt(H/g)."""
        return time / math.sqrt(self.geometry.length / self.gravity)

    @property
    def velocity_scale(self) -> float:
        """sqrt(g H) [m/s]."""
        return math.sqrt(self.gravity * self.geometry.length)

    def constants(self) -> list[str]:
        """Unit weight, level and length."""
        return [
            f"γ_w = {si(self.solution.unit_weight, 'N/m³')}",
            f"level = {self.solution.level:g} m",
            f"H = {si(self.geometry.length, 'm')}",
        ]


@dataclass
class BarCase(Case):
    """Free vibration of a dry elastic bar in one mode."""

    geometry: Geometry
    solution: BarVibration
    title = "Vibration of an elastic bar"
    tolerance = 2.0e-2

    def time_factor(self, time: float) -> float:
        """Time over the period."""
        return time / self.solution.period

    def abscissa(self, points: FloatArray) -> FloatArray:
        """Distance of points (n, 3) from the fixed end [m]."""
        return self.geometry.length - self.geometry.depth(points)

    def constants(self) -> list[str]:
        """Wave speed, length and mode."""
        return [
            f"c = {self.solution.wave_speed:.4g} m/s",
            f"H = {si(self.geometry.length, 'm')}",
            f"mode {self.solution.mode}",
        ]


def case_of(result: Result) -> Case:
    """The case named in &verification of the scene in a result."""
    try:
        return _build(result.scene)
    except DosuiPostError as error:
        raise DosuiPostError(f"{result.path}: {error}") from error


def consolidation_of(result: Result) -> ConsolidationCase:
    """The same, if it is one with excess pore pressure."""
    case = case_of(result)
    if not isinstance(case, ColumnCase | MandelCase | RadialCase):
        raise DosuiPostError(f"{result.path}: '{case.title}' has no excess pore pressure to draw")
    return case


def settlement_history(result: Result) -> tuple[FloatArray, FloatArray] | None:
    """Times [s] and settlement [m] of the scene's first settlement probe, if there is one."""
    for probe in result.scene.all("probe"):
        if probe.text("kind", "") != "settlement" or "time" not in result.history_names():
            continue
        column = probe_column(result, probe)
        if column is not None:
            return result.history("time"), result.history(column)
    return None


def probe_column(result: Result, probe: Group) -> str | None:
    """Name of the history that a probe of the scene wrote."""
    name = probe.text("name", "")
    return name if name in result.history_names() else None


# ---------------------------------------------------------------------- inside


def _build(scene: Scene) -> Case:
    verification = scene.one("verification")
    name = verification.text("case", "").lower()
    if name == "":
        raise DosuiPostError(
            "the scene names no exact solution (case in &verification); "
            "'plot probe' and 'plot map' draw results without one"
        )
    if name not in CASES:
        raise DosuiPostError(
            f"no exact solution '{name}' in &verification (known: {', '.join(CASES)})"
        )
    geometry = _geometry(verification)
    if name == "hydrostatic":
        return _hydrostatic(scene, geometry)
    if name == "bar":
        return _bar(scene, geometry)
    if _gravity(scene) > 0:
        raise DosuiPostError(f"the exact solution '{name}' holds without gravity")
    soil = _soil(scene)
    if name == "mandel":
        load = _load(verification)
        return MandelCase(geometry, Mandel(soil, load, geometry.length), _plate_height(scene))
    if name in ("cryer", "de_leeuw"):
        dimension = 3 if name == "cryer" else 2
        load = _load(verification)
        return RadialCase(geometry, RadialConsolidation(soil, load, geometry.length, dimension))
    if name == "drainage":
        pressure = _initial_pressure(scene, verification)
        return DrainageCase(geometry, Drainage(soil, pressure, geometry.length))
    return ColumnCase(geometry, Terzaghi(soil, _load(verification), geometry.length))


def _geometry(verification: Group) -> Geometry:
    direction = to_xyz(verification.numbers("direction"))
    norm = float(np.linalg.norm(direction))
    if not abs(norm - 1) <= 1.0e-3:
        raise DosuiPostError("direction in &verification is not a unit vector")
    length = verification.number("length")
    if not 0 < length < math.inf:
        raise DosuiPostError("length in &verification is not positive")
    return Geometry(to_xyz(verification.numbers("drained")), direction / norm, length)


def _load(verification: Group) -> float:
    load = verification.number("load")
    if not (load != 0 and math.isfinite(load)):
        raise DosuiPostError("load in &verification is 0")
    return load


def _gravity(scene: Scene) -> float:
    group = scene.with_key("gravity")
    return float(np.linalg.norm(group.numbers("gravity"))) if "gravity" in group else 0.0


def _material(scene: Scene) -> Group:
    """The one material of the scene; exact solutions are for homogeneous bodies."""
    used = {region.text("material", "") for region in scene.all("region")}
    materials = [g for g in scene.all("material") if g.text("name", "") in used or not used]
    if not materials:
        raise DosuiPostError("the scene in the result has no material of a region")
    if len(materials) > 1:
        raise DosuiPostError("the exact solution is for one material; the scene has several")
    return materials[0]


def _soil(scene: Scene) -> Soil:
    material, water = _material(scene), scene.one("water")
    is_rigid = material.flag("rigid", False)
    return Soil(
        young_modulus=0.0 if is_rigid else material.number("young_modulus"),
        poisson_ratio=0.0 if is_rigid else material.number("poisson_ratio"),
        porosity=material.number("porosity"),
        conductivity=material.number("hydraulic_conductivity"),
        water_bulk_modulus=water.number("bulk_modulus"),
        unit_weight=water.number("unit_weight"),
        is_rigid=is_rigid,
    )


def _plate_height(scene: Scene) -> float | None:
    """Top of the regions above z = 0; None if a shape hides it."""
    tops = []
    for region in scene.all("region"):
        if "box_max" not in region or ("shape_angle" in region and region.number("shape_angle")):
            return None
        tops.append(to_xyz(region.numbers("box_max"))[2])
    return float(max(tops)) if tops else None


def _initial_pressure(scene: Scene, verification: Group) -> float:
    for state in scene.all("initial_state"):
        if state.text("pore_pressure", "zero") == "given":
            return state.number("pore_pressure_value")
    return _load(verification)


def _hydrostatic(scene: Scene, geometry: Geometry) -> HydrostaticCase:
    gravity = _gravity(scene)
    if not gravity > 0:
        raise DosuiPostError("the case 'hydrostatic' needs gravity")
    solution = Hydrostatic(scene.one("water").number("unit_weight"), float(geometry.drained[2]))
    return HydrostaticCase(geometry, solution, gravity)


def _bar(scene: Scene, geometry: Geometry) -> BarCase:
    material = _material(scene)
    young, poisson = material.number("young_modulus"), material.number("poisson_ratio")
    # Waves along a bar that cannot widen: rollers on its sides, or a 1-D scene.
    modulus = young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    density = (1 - material.number("porosity")) * material.number("solid_density")
    mechanics = scene.one("mechanics")
    if "density_scaling" in mechanics:
        density *= mechanics.number("density_scaling")
    for state in scene.all("initial_state"):
        if "mode_number" in state and state.number("mode_number") > 0:
            solution = BarVibration(
                wave_speed=math.sqrt(modulus / density),
                length=geometry.length,
                amplitude=state.number("mode_amplitude"),
                mode=int(state.number("mode_number")),
            )
            if solution.amplitude == 0:
                break
            return BarCase(geometry, solution)
    raise DosuiPostError("the case 'bar' needs a mode in &initial_state")


def _soil_text(soil: Soil) -> list[str]:
    skeleton = (
        ["rigid skeleton"]
        if soil.is_rigid
        else [f"E = {si(soil.young_modulus, 'Pa')}", f"ν = {soil.poisson_ratio:g}"]
    )
    return [
        *skeleton,
        f"n = {soil.porosity:g}",
        f"k = {si(soil.conductivity, 'm/s')}",
        f"K_w = {si(soil.water_bulk_modulus, 'Pa')}",
    ]

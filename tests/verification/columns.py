"""Columns of any spacing, turn and disorder, with the exact pressures of their drainage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

UNIT_WEIGHT = 9810.0  # N/m3
POROSITY = 0.3
HEIGHT, WIDTH = 1.0, 0.25  # m
TIME_FACTORS = (0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True)
class Column:
    """A column drained at its top: a scene and what is exact about it."""

    spacing: float = 0.025  # of the particles [m]
    per_cell: int = 1  # particles per cell and direction
    angle: float = 0.0  # of the column [deg]
    lattice_angle: float = 0.0  # of the particles' lattice [deg]
    jitter: float = 0.0  # in spacings
    seed: int = 1
    rigid: bool = False
    conductivity: float = 1.0e-4  # m/s
    bulk_modulus: float = 3.0e6  # Pa
    young_modulus: float = 1.0e6  # Pa
    poisson_ratio: float = 0.2
    load: float = 1000.0  # Pa
    last: float = 1.0  # time factor at the end
    integrator: str = "explicit"
    mechanics: str | None = None  # explicit: fading damping
    water: str = ""
    time: str = ""
    grid: str = ""
    pattern: str = ""  # of the initial pressure, instead of a uniform one
    solver: str = ""

    @property
    def softness(self) -> float:
        """One-dimensional compressibility of the skeleton [1/Pa]; 0 if it is rigid."""
        e, nu = self.young_modulus, self.poisson_ratio
        return 0.0 if self.rigid else (1 + nu) * (1 - 2 * nu) / (e * (1 - nu))

    @property
    def storage(self) -> float:
        """n/K_w [1/Pa]."""
        return POROSITY / self.bulk_modulus

    @property
    def c_v(self) -> float:
        """Coefficient of consolidation [m2/s]."""
        return self.conductivity / UNIT_WEIGHT / (self.storage + self.softness)

    @property
    def initial_pressure(self) -> float:
        """Undrained pressure under the load, or what a rigid skeleton starts from [Pa]."""
        return (
            self.load if self.rigid else self.load * self.softness / (self.softness + self.storage)
        )

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (n, 3) from the drained top [m]."""
        angle = np.radians(self.angle)
        return HEIGHT - (-np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 2])

    def exact(self, points: np.ndarray, time: float) -> np.ndarray:
        """Terzaghi's pressure [Pa]."""
        mu = 0.5 * np.pi * (2 * np.arange(400)[:, None] + 1)
        decay = np.exp(-(mu**2) * self.c_v * time / HEIGHT**2)
        series = 2.0 / mu * np.sin(mu * self.depth(points) / HEIGHT) * decay
        return self.initial_pressure * series.sum(axis=0)

    def text(self) -> str:
        """The namelist."""
        factors = [factor for factor in TIME_FACTORS if factor <= self.last]
        times = [factor * HEIGHT**2 / self.c_v for factor in factors]
        skeleton = (
            "rigid = .true."
            if self.rigid
            else f"young_modulus = {self.young_modulus} poisson_ratio = {self.poisson_ratio}"
        )
        start = "" if self.rigid or self.pattern else "undrained_start = .true."
        mechanics = self.mechanics
        if mechanics is None:
            mechanics = "" if self.integrator == "quasi_static" else "damping = 'fading'"
        state = ""
        if self.rigid or self.pattern:
            pattern = self.pattern or "given"
            state = (
                f"&initial_state pore_pressure = '{pattern}' pore_pressure_value = {self.load} /"
            )
        walls = "\n".join(
            f"&mechanical_condition surface = '{name}' kind = 'roller' /"
            for name in ("base", "left", "right")
        )
        load = f"&mechanical_condition surface = 'top' kind = 'pressure' value = {self.load} /"
        if self.rigid:
            walls = load = ""
        elif self.pattern:
            load = ""
        return f"""
&scene title = 'column' dimension = 2 integrator = '{self.integrator}' /
&grid spacing = {self.spacing * self.per_cell} {self.grid} /
&time end_time = {times[-1]!r} output_times = {", ".join(repr(t) for t in times)} {start}
  {self.time} /
&material name = 'soil' {skeleton} porosity = {POROSITY}
  hydraulic_conductivity = {self.conductivity} /
&water bulk_modulus = {self.bulk_modulus} {self.water} /
{f"&solver {self.solver} /" if self.solver else ""}
{f"&mechanics {mechanics} /" if not self.rigid else ""}
&region name = 'column' material = 'soil' box_min = 0.0, 0.0 box_max = {WIDTH}, {HEIGHT}
  particle_spacing = {self.spacing} shape_angle = {self.angle}
  lattice_angle = {self.lattice_angle} jitter = {self.jitter} jitter_seed = {self.seed} /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&surface name = 'left' region = 'column' face = 'x-' /
&surface name = 'right' region = 'column' face = 'x+' /
{state}
{walls}
{load}
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'column' /
"""

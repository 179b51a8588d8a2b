"""A smooth solution of Biot's equations that body forces and a water source keep up.

With psi = product of cos(pi x_a) over the directions of the unit cube and g = sin(w t)^2:
p = P psi g, u = -(A/pi) grad psi g. Smooth walls (rollers), no flow through them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

UNIT_WEIGHT, YOUNG, POISSON, POROSITY = 9810.0, 1.0e6, 0.25, 0.3
MODULUS = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
AMPLITUDE, PRESSURE = 1.0e-3, 1.0e3  # A [m], P [Pa]


@dataclass(frozen=True)
class Manufactured:
    """The scene and its exact fields."""

    dimension: int = 2
    cells: int = 8
    per_cell: int = 2
    integrator: str = "quasi_static"
    conductivity: float = 1.0e-6  # m/s
    bulk_modulus: float = 2.2e9  # Pa
    time: str = ""
    mechanics: str = ""

    @property
    def storage(self) -> float:
        """n/K_w [1/Pa]."""
        return POROSITY / self.bulk_modulus

    @property
    def c_v(self) -> float:
        """Coefficient of consolidation [m2/s]."""
        return self.conductivity / UNIT_WEIGHT / (self.storage + 1 / MODULUS)

    @property
    def end(self) -> float:
        """End of the run: 0.6 of the period of g [s]."""
        return 0.6 * 0.3 / self.c_v

    @property
    def frequency(self) -> float:
        """w [1/s]."""
        return np.pi * self.c_v / 0.3

    @property
    def axes(self) -> list[str]:
        """Names of the directions."""
        return {1: ["z"], 2: ["x", "z"], 3: ["x", "y", "z"]}[self.dimension]

    def exact(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures and displacements (n, 3) at the end."""
        g = np.sin(self.frequency * self.end) ** 2
        columns = ["xyz".index(a) for a in self.axes]
        cosine = {c: np.cos(np.pi * points[:, c]) for c in columns}
        pressure = PRESSURE * g * np.prod([cosine[c] for c in columns], axis=0)
        displacement = np.zeros_like(points)
        for c in columns:
            others = np.prod(
                [np.ones(len(points))] + [cosine[d] for d in columns if d != c], axis=0
            )
            displacement[:, c] = AMPLITUDE * g * np.sin(np.pi * points[:, c]) * others
        return pressure, displacement

    def text(self) -> str:
        """The namelist."""
        d, w = self.dimension, self.frequency
        g, rate = f"sin({w!r}*t)^2", f"{w!r}*sin(2*{w!r}*t)"
        kappa = self.conductivity / UNIT_WEIGHT
        psi = "*".join(f"cos(pi*{a})" for a in self.axes)
        force = d * MODULUS * np.pi**2 * AMPLITUDE - PRESSURE * np.pi
        forces = ""
        for a in self.axes:
            shape = "*".join(f"{'sin' if a == b else 'cos'}(pi*{b})" for b in self.axes)
            forces += f"  force_{a} = '{force!r}*{shape}*{g}'\n"
        stored = self.storage * PRESSURE + d * np.pi * AMPLITUDE
        flow = d * kappa * np.pi**2 * PRESSURE
        walls = "".join(
            f"&surface name = '{a}{s}' region = 'cube' face = '{a}{s}' /\n"
            f"&mechanical_condition surface = '{a}{s}' kind = 'roller' /\n"
            for a in self.axes
            for s in "-+"
        )
        return f"""
&scene dimension = {d} integrator = '{self.integrator}' /
&grid spacing = {1 / self.cells!r} /
&time end_time = {self.end!r} {self.time} /
&material name = 'soil' young_modulus = {YOUNG} poisson_ratio = {POISSON}
  porosity = {POROSITY} hydraulic_conductivity = {self.conductivity} /
&water bulk_modulus = {self.bulk_modulus} /
&mechanics {self.mechanics} /
&region name = 'cube' material = 'soil' particles_per_cell = {self.per_cell}
  box_min = {", ".join(["0"] * d)} box_max = {", ".join(["1"] * d)} /
{walls}&source
{forces}  water = '({stored!r}*{rate} + {flow!r}*{g})*{psi}' /
&output name = 'manufactured' /
"""

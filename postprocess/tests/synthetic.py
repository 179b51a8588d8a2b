"""Writes result files as dosui does, with exact or spoiled values, without dosui."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from dosui_post.exact import BarVibration, Mandel, Soil, Terzaghi

FloatArray = npt.NDArray[np.float64]
UNITS = {"pore_pressure": "Pa", "displacement": "m", "velocity": "m/s", "volume": "m3"}
T_OUTPUT = (0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass
class Step:
    time: float
    points: FloatArray
    fields: dict[str, FloatArray] = field(default_factory=dict)


def write_result(
    path: Path,
    echo: str,
    steps: Sequence[Step],
    history: dict[str, FloatArray] | None = None,
    room: int = 0,
    text: str = "",
    as_attributes: bool = False,
) -> Path:
    """A result file; `room`: steps and history rows reserved but never written (a killed run)."""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
        root.attrs.create("Type", b"PolyData", dtype="S8")
        counts = np.array([len(step.points) for step in steps], dtype=np.int64)
        spare = room * int(counts.max(initial=0))
        offsets = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)

        def stack(arrays: Sequence[FloatArray]) -> FloatArray:
            rows = np.concatenate(arrays)
            return np.concatenate([rows, np.full((spare, *rows.shape[1:]), np.nan)])

        def table(values: npt.ArrayLike) -> npt.NDArray[np.int64]:
            array = np.asarray(values, dtype=np.int64)
            return np.concatenate([array, np.full((room, *array.shape[1:]), -7)])

        root["Points"] = stack([step.points for step in steps])
        root["NumberOfPoints"] = counts
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            cells = counts if name == "Vertices" else np.zeros(len(steps), dtype=np.int64)
            group = root.create_group(name)
            group["NumberOfCells"] = cells
            group["NumberOfConnectivityIds"] = cells
            most = int(cells.max(initial=0))
            group["Offsets"] = np.arange(most + 1)
            group["Connectivity"] = np.arange(most)
        data = root.create_group("PointData")
        table_group = root.create_group("Steps")
        table_group.attrs["NSteps"] = np.int64(len(steps))
        table_group["Values"] = np.array([step.time for step in steps])
        table_group["PartOffsets"] = table(range(len(steps)))
        table_group["NumberOfParts"] = table(np.ones(len(steps)))
        table_group["PointOffsets"] = table(offsets)
        table_group["CellOffsets"] = table(np.zeros((len(steps), 4)))
        table_group["ConnectivityIdOffsets"] = table(np.zeros((len(steps), 4)))
        data_offsets = table_group.create_group("PointDataOffsets")
        for name in steps[0].fields:
            data[name] = stack([step.fields[name] for step in steps])
            data[name].attrs["unit"] = UNITS.get(name, "")
            data_offsets[name] = table_group["PointOffsets"]
        columns = history or {}
        group = file.create_group("History")
        group.attrs["n_entries"] = np.int64(max([len(v) for v in columns.values()], default=0))
        for name, values in columns.items():
            group[name] = np.concatenate([values, np.full(room, np.nan)])
            group[name].attrs["unit"] = {"time": "s", "top_settlement": "m"}.get(name, "Pa")
        scene = file.create_group("Scene")
        scene.attrs["ndim"] = np.int64(2)
        scene.attrs["git_hash"] = "0123abc"
        if as_attributes:
            scene.attrs["text"], scene.attrs["echo"] = text, echo
        else:
            scene["text"] = np.bytes_(text or " ")
            scene.create_dataset("echo", data=echo, dtype=h5py.string_dtype())
    return path


# ---------------------------------------------------------------------- scenes

_COMMON = """
&scene title = 'Synthetic' deformation = '{deformation}' {gravity} /
&water bulk_modulus = {kw} unit_weight = 9810.0 operator = '{operator}' /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = {nu} porosity = 0.3
  hydraulic_conductivity = 1.0e-3 solid_density = 2650.0 rigid = {rigid} /
"""


def common(
    nu: float = 0.2,
    kw: float = 2.2e9,
    rigid: bool = False,
    operator: str = "compact",
    deformation: str = "small_strain",
    gravity: str = "",
) -> str:
    return _COMMON.format(
        nu=nu,
        kw=kw,
        rigid=".true." if rigid else ".false.",
        operator=operator,
        deformation=deformation,
        gravity=gravity,
    )


def soil(nu: float = 0.2, kw: float = 2.2e9, rigid: bool = False) -> Soil:
    return Soil(1.0e6, nu, 0.3, 1.0e-3, kw, 9810.0, rigid)


def lattice(width: float, height: float, spacing: float) -> FloatArray:
    x = np.arange(spacing / 2, width, spacing)
    z = np.arange(spacing / 2, height, spacing)
    xx, zz = np.meshgrid(x, z, indexing="ij")
    return np.column_stack([xx.ravel(), np.zeros(xx.size), zz.ravel()])


Spoil = Callable[[FloatArray, int], FloatArray]


def untouched(values: FloatArray, _step: int) -> FloatArray:
    return values


def terzaghi_file(
    path: Path,
    time_factors: Sequence[float] = T_OUTPUT,
    spoil: Spoil = untouched,
    operator: str = "compact",
    ndim: int = 2,
    moving: bool = False,
    with_history: bool = True,
    **options: int,
) -> Path:
    """Terzaghi's column of the published case, exact values at the particles."""
    solution = Terzaghi(soil(kw=3.0e7), 1000.0, 1.0)
    points = lattice(0.25, 1.0, 0.025)
    if ndim == 1:
        points = points[points[:, 0] < 0.02] * [0, 1, 1]
    steps = []
    for k, factor in enumerate([0.0, *time_factors]):
        time = solution.time(factor)
        depth = 1.0 - points[:, 2]
        pressure = solution.pressure(depth, time) if k > 0 else np.zeros(len(points))
        displacement = np.zeros_like(points)
        displacement[:, 2] = -solution.displacement(depth, time) if k > 0 else 0.0
        steps.append(
            Step(
                time,
                points + displacement if moving else points,
                {
                    "pore_pressure": spoil(pressure, k),
                    "displacement": displacement,
                    "volume": np.full(len(points), 0.025**ndim),
                    "effective_stress": np.zeros((len(points), 6)),
                },
            )
        )
    times = np.linspace(0, steps[-1].time, 400)
    history = {
        "time": times,
        "top_settlement": np.array([0.0, *[solution.settlement(t) for t in times[1:]]]),
        "base_pressure": np.array([float(solution.pressure(1.0, t)) for t in times]),
    }
    drained, direction = ("1.0", "-1.0") if ndim == 1 else ("0.125, 1.0", "0.0, -1.0")
    echo = common(kw=3.0e7, operator=operator, deformation="updated" if moving else "small_strain")
    echo += f"""
&time end_time = {solution.time(max(time_factors, default=1.0))} /
&region name = 'column' material = 'soil' box_max = {"1.0" if ndim == 1 else "0.25, 1.0"} /
&probe name = 'top_settlement' kind = 'settlement' surface = 'top' /
&probe name = 'base_pressure' kind = 'point' field = 'pore_pressure' position = 0.0 /
&verification case = 'terzaghi' load = 1000.0 length = 1.0
  drained = {drained} direction = {direction} /
"""
    return write_result(path, echo, steps, history if with_history else None, **options)


def mandel_file(
    path: Path,
    nu: float = 0.2,
    time_factors: Sequence[float] = (0.01, *T_OUTPUT),
    with_probe: bool = True,
    spacing: float = 0.05,
) -> Path:
    """Mandel's quarter section, a = b = 1 m, F = 1 kN/m."""
    solution = Mandel(soil(nu), 1000.0, 1.0)
    points = lattice(1.0, 1.0, spacing)
    steps = []
    for factor in time_factors:
        time = solution.time(factor)
        displacement = np.zeros_like(points)
        displacement[:, 0] = solution.horizontal_displacement(points[:, 0], time)
        displacement[:, 2] = solution.vertical_strain(time) * points[:, 2]
        fields = {
            "pore_pressure": solution.pressure(points[:, 0], time),
            "displacement": displacement,
            "volume": np.full(len(points), spacing**2),
        }
        steps.append(Step(time, points, fields))
    times = np.linspace(0, steps[-1].time, 2000)
    history = {
        "time": times,
        "centre": np.array([0.0, *[float(solution.pressure(0.0, t)) for t in times[1:]]]),
    }
    echo = (
        common(nu)
        + """
&region name = 'block' material = 'soil' box_max = 1.0, 1.0 /
&probe name = 'centre' kind = 'point' field = 'pore_pressure' position = 0.0, 0.0 /
&verification case = 'mandel' load = 1000.0 length = 1.0
  drained = 1.0, 0.0 direction = -1.0, 0.0 /
"""
    )
    return write_result(path, echo, steps, history if with_probe else None)


def drainage_file(path: Path, angle: float = 30.0) -> Path:
    """A rigid column turned about the origin."""
    upright = lattice(0.25, 1.0, 0.025)
    cosine, sine = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    points = upright @ turn.T
    steps = []
    for factor in T_OUTPUT:
        time = factor / soil(rigid=True).consolidation_coefficient
        mu = np.pi * (np.arange(60) + 0.5)
        modes = np.sin(np.outer(1 - upright[:, 2], mu)) * 2 / mu * np.exp(-(mu**2) * factor)
        steps.append(Step(time, points, {"pore_pressure": 1000.0 * modes.sum(axis=1)}))
    top, inwards = turn @ [0, 0, 1], turn @ [0, 0, -1]
    echo = (
        common(rigid=True)
        + f"""
&initial_state pore_pressure = 'given' pore_pressure_value = 1000.0 /
&region name = 'column' material = 'soil' lattice_angle = {angle} shape_angle = {angle} /
&verification case = 'drainage' length = 1.0
  drained = {top[0]}, {top[2]} direction = {inwards[0]}, {inwards[2]} /
"""
    )
    return write_result(path, echo, steps)


def hydrostatic_file(path: Path, speed: float = 0.0, pressure_error: float = 0.0) -> Path:
    points = lattice(0.5, 2.0, 0.1)
    fields = {
        "pore_pressure": 9810.0 * (2.0 - points[:, 2]) * (1 + pressure_error),
        "velocity": np.full_like(points, speed),
    }
    steps = [Step(time, points, fields) for time in (0.0, 1.0)]
    echo = (
        common(gravity="gravity = 0.0, -9.81")
        + """
&region name = 'column' material = 'soil' /
&verification case = 'hydrostatic' length = 2.0 drained = 0.0, 2.0 direction = 0.0, -1.0 /
"""
    )
    return write_result(path, echo, steps)


def bar_file(path: Path, damping: float = 0.0) -> Path:
    modulus, density = 1.0e6 * 0.8 / (1.2 * 0.6), 0.7 * 2650.0
    solution = BarVibration(np.sqrt(modulus / density), 2.0, 0.1, 2)
    points = lattice(0.1, 2.0, 0.1)
    steps = []
    for k in range(9):
        time = k / 8 * solution.period
        fade = np.exp(-damping * time)
        velocity, displacement = np.zeros_like(points), np.zeros_like(points)
        velocity[:, 2] = fade * solution.velocity(points[:, 2], time)
        displacement[:, 2] = fade * solution.displacement(points[:, 2], time)
        steps.append(Step(time, points, {"velocity": velocity, "displacement": displacement}))
    echo = (
        common()
        + """
&initial_state mode_amplitude = 0.1 mode_number = 2 /
&region name = 'bar' material = 'soil' /
&verification case = 'bar' length = 2.0 drained = 0.0, 2.0 direction = 0.0, -1.0 /
"""
    )
    return write_result(path, echo, steps)


def cube_file(path: Path) -> Path:
    """3-D, without an exact solution."""
    axis = np.arange(0.05, 1.0, 0.1)
    grid = np.meshgrid(axis, axis, axis, indexing="ij")
    points = np.column_stack([g.ravel() for g in grid])
    fields = {
        "pore_pressure": 1000 * points[:, 0],
        "velocity": points - 0.5,
        "volume": np.full(len(points), 1e-3),
    }
    return write_result(path, common(), [Step(0.0, points, fields), Step(1.0, points, fields)])

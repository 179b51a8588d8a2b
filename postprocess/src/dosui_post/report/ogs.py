"""OpenGeoSys 6 on the report's columns: input, run, error.

Quadratic displacements and linear pressures on squares of the width dx (process HYDRO_MECHANICS),
backward Euler with steps that grow until T = 0.05, a direct solver. The pressure is compared in
the middle of the elements, where dosui has its particles. Mandel's rigid plate is left out:
OpenGeoSys has no condition that ties the displacements of a side to each other.
"""

from __future__ import annotations

import hashlib
import math
import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dosui_post.errors import DosuiPostError
from dosui_post.report.elements import (
    Mesh,
    drained,
    error_of,
    extent,
    plate_motion,
    rollers,
    step_ends,
)
from dosui_post.report.measure import errors_at, is_finished
from dosui_post.report.process import run
from dosui_post.report.scenes import PROBLEMS, TIME_FACTORS, Problem
from dosui_post.report.store import DONE, FAILED, TIMEOUT, Run, Store
from dosui_post.result import FloatArray

METHOD = "OpenGeoSys, Taylor–Hood"

_NAME = "column"
_STEPS = (16, 48, 160)
_WIDTHS = {"terzaghi": (0.05, 0.025), "mandel": (0.02, 0.01)}


@dataclass(frozen=True)
class OgsJob:
    """One run."""

    problem: Problem
    spacing: float
    """width of the elements [m]"""
    n: int
    """steps until T = 0.05"""

    @property
    def control(self) -> str:
        """As the tables call it."""
        return f"{len(step_ends(self.problem, self.n))} steps"

    @property
    def label(self) -> str:
        """One line, as those of dosui."""
        spacing = f"dx = {self.spacing:g} m"
        return f"{self.problem.name}: {METHOD}, {spacing}, {self.control}, 1 rank"

    def files(self) -> dict[str, str]:
        """The input by name."""
        mesh = Mesh.of(self.problem, self.spacing)
        return {
            f"{_NAME}.prj": project_text(self.problem, step_ends(self.problem, self.n)),
            f"{_NAME}.vtu": vtu_text(mesh),
            f"{_NAME}.gml": geometry_text(self.problem, self.spacing),
        }


def measure_all(
    program: str | None,
    is_quick: bool,
    only: str,
    store: Store,
    tell: Callable[[str], None],
    repeat: int = 1,
    limit: float = 3600.0,
) -> list[Run]:
    """The runs of OpenGeoSys; none where it is not installed."""
    path = shutil.which(program or "ogs")
    if path is None:
        if program is not None:
            raise DosuiPostError(f"no program {program} (--ogs)")
        tell("OpenGeoSys: not installed, skipped")
        return []
    version = _version(Path(path))
    tell(f"OpenGeoSys {version}")
    runs = []
    wanted = re.compile(only, re.IGNORECASE)
    for job in (job for job in jobs(is_quick) if wanted.search(job.label)):
        found = store.get(_key(job, version))
        if found is None or not is_finished(found, repeat, limit):
            found = _measure(job, path, version, repeat, limit)
            store.add(found)
        runs.append(found)
        said = found.message or f"{found.wall:.2f} s, error {found.error:.1e}"
        tell(f"{job.label}: {said}")
    return runs


def jobs(is_quick: bool) -> list[OgsJob]:
    """Columns and Mandel's slab; finer and with more steps if there is time."""
    found = []
    for kind, coarse in _WIDTHS.items():
        widths = coarse if is_quick else (*coarse, 0.5 * coarse[-1])
        counts: tuple[int, ...] = _STEPS if is_quick else (*_STEPS, 4 * _STEPS[-1])
        if kind == "mandel" and is_quick:
            counts = _STEPS[:-1]  # minutes each
        problems = (PROBLEMS[kind], PROBLEMS[f"{kind}-stiff"])
        found += [OgsJob(p, dx, n) for p in problems for dx in widths for n in counts]
    return found


# ---------------------------------------------------------------------- input


def vtu_text(mesh: Mesh) -> str:
    """The mesh as a VTU file."""
    points = "\n".join(f"{x!r} {y!r} 0.0" for x, y, _ in mesh.points.tolist())
    cells = "\n".join(" ".join(map(str, cell)) for cell in mesh.cells)
    offsets = " ".join(str(8 * (k + 1)) for k in range(len(mesh.cells)))
    types = " ".join(["23"] * len(mesh.cells))
    materials = " ".join(["0"] * len(mesh.cells))
    return f"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<UnstructuredGrid>
<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{len(mesh.cells)}">
<Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">
{points}
</DataArray>
</Points>
<Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">
{cells}
</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">
{offsets}
</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">
{types}
</DataArray>
</Cells>
<CellData>
<DataArray type="Int32" Name="MaterialIDs" format="ascii">
{materials}
</DataArray>
</CellData>
</Piece>
</UnstructuredGrid>
</VTKFile>
"""


def geometry_text(problem: Problem, spacing: float) -> str:
    """The four sides."""
    width, height = extent(problem, spacing)
    corners = ((0.0, 0.0), (width, 0.0), (width, height), (0.0, height))
    points = "\n".join(
        f'<point id="{k}" x="{x!r}" y="{y!r}" z="0"/>' for k, (x, y) in enumerate(corners)
    )
    sides = "\n".join(
        f'<polyline id="{k}" name="{name}"><pnt>{k}</pnt><pnt>{(k + 1) % 4}</pnt></polyline>'
        for k, name in enumerate(("base", "right", "top", "left"))
    )
    return f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<OpenGeoSysGLI>
<name>{_NAME}</name>
<points>
{points}
</points>
<polylines>
{sides}
</polylines>
</OpenGeoSysGLI>
"""


def project_text(problem: Problem, ends: Sequence[float]) -> str:
    """The project file."""
    soil = problem.soil
    viscosity = 1.0e-3
    permeability = soil.conductivity / soil.unit_weight * viscosity
    steps = np.diff([0.0, *ends]).tolist()
    pairs = "\n".join(
        f"<pair><repeat>1</repeat><delta_t>{step!r}</delta_t></pair>" for step in steps
    )
    outputs = " ".join(repr(time) for time in problem.times)
    parameters = "\n".join(
        f"<parameter><name>{name}</name><type>Constant</type><values>{value}</values></parameter>"
        for name, value in {
            "E": repr(soil.young_modulus),
            "nu": repr(soil.poisson_ratio),
            "zero": "0",
            "rest": "0 0",
            "load": repr(-problem.load),
        }.items()
    )
    fixed = "\n".join(
        _condition(side, "Dirichlet", component, "zero") for side, component in rollers(problem)
    )
    motion = [plate_motion(problem, time) for time in ends]
    plate = ""
    if motion[0] is None:
        top = _condition("top", "Neumann", 1, "load")
    else:
        top = _condition("top", "Dirichlet", 1, "motion")
        parameters += (
            "<parameter><name>motion</name><type>CurveScaled</type><curve>plate</curve>"
            "<parameter>one</parameter></parameter>"
            "<parameter><name>one</name><type>Constant</type><value>1</value></parameter>"
        )
        # the plate is where it jumps to from the first step's start on
        times = " ".join(map(repr, [0.0, *ends]))
        values = " ".join(map(repr, [motion[0], *motion]))
        plate = (
            f"<curves><curve><name>plate</name><coords>{times}</coords>"
            f"<values>{values}</values></curve></curves>"
        )
    return f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<OpenGeoSysProject>
<mesh>{_NAME}.vtu</mesh>
<geometry>{_NAME}.gml</geometry>
<processes><process>
<name>HM</name>
<type>HYDRO_MECHANICS</type>
<integration_order>3</integration_order>
<constitutive_relation>
<type>LinearElasticIsotropic</type>
<youngs_modulus>E</youngs_modulus>
<poissons_ratio>nu</poissons_ratio>
</constitutive_relation>
<process_variables>
<displacement>displacement</displacement>
<pressure>pressure</pressure>
</process_variables>
<secondary_variables/>
<specific_body_force>0 0</specific_body_force>
</process></processes>
<media><medium>
<phases>
<phase><type>AqueousLiquid</type><properties>
{_constant("viscosity", viscosity)}
<property><name>density</name><type>Linear</type><reference_value>1000</reference_value>
<independent_variable><variable_name>liquid_phase_pressure</variable_name>
<reference_condition>0</reference_condition><slope>{1.0 / soil.water_bulk_modulus!r}</slope>
</independent_variable></property>
</properties></phase>
<phase><type>Solid</type><properties>
{_constant("density", 2650.0)}
</properties></phase>
</phases>
<properties>
{_constant("porosity", soil.porosity)}
{_constant("biot_coefficient", 1.0)}
{_constant("reference_temperature", 293.15)}
{_constant("permeability", permeability)}
</properties>
</medium></media>
<time_loop>
<processes><process ref="HM">
<nonlinear_solver>newton</nonlinear_solver>
<convergence_criterion>
<type>DeltaX</type><norm_type>NORM2</norm_type><reltol>1e-8</reltol>
</convergence_criterion>
<time_discretization><type>BackwardEuler</type></time_discretization>
<time_stepping>
<type>FixedTimeStepping</type>
<t_initial>0</t_initial>
<t_end>{problem.times[-1]!r}</t_end>
<timesteps>
{pairs}
</timesteps>
</time_stepping>
</process></processes>
<output>
<type>VTK</type>
<prefix>out</prefix>
<suffix>_{{:timestep}}</suffix>
<compress_output>false</compress_output>
<data_mode>Ascii</data_mode>
<timesteps><pair><repeat>1</repeat><each_steps>100000000</each_steps></pair></timesteps>
<fixed_output_times>{outputs}</fixed_output_times>
<variables><variable>pressure</variable></variables>
</output>
</time_loop>
<parameters>
{parameters}
</parameters>
{plate}
<process_variables>
<process_variable>
<name>displacement</name>
<components>2</components>
<order>2</order>
<initial_condition>rest</initial_condition>
<boundary_conditions>
{fixed}
{top}
</boundary_conditions>
</process_variable>
<process_variable>
<name>pressure</name>
<components>1</components>
<order>1</order>
<initial_condition>zero</initial_condition>
<boundary_conditions>
{_condition(drained(problem), "Dirichlet", 0, "zero")}
</boundary_conditions>
</process_variable>
</process_variables>
<nonlinear_solvers><nonlinear_solver>
<name>newton</name>
<type>Newton</type>
<max_iter>10</max_iter>
<linear_solver>direct</linear_solver>
</nonlinear_solver></nonlinear_solvers>
<linear_solvers><linear_solver>
<name>direct</name>
<eigen><solver_type>SparseLU</solver_type></eigen>
</linear_solver></linear_solvers>
</OpenGeoSysProject>
"""


def _constant(name: str, value: float) -> str:
    return f"<property><name>{name}</name><type>Constant</type><value>{value!r}</value></property>"


def _condition(side: str, kind: str, component: int, parameter: str) -> str:
    return (
        f"<boundary_condition><geometrical_set>{_NAME}</geometrical_set>"
        f"<geometry>{side}</geometry><type>{kind}</type><component>{component}</component>"
        f"<parameter>{parameter}</parameter></boundary_condition>"
    )


# ---------------------------------------------------------------------- run


def _measure(job: OgsJob, program: str, version: str, repeat: int, limit: float) -> Run:
    mesh = Mesh.of(job.problem, job.spacing)
    result = Run(
        key=_key(job, version),
        scene=job.problem.name,
        method=METHOD,
        spacing=job.spacing,
        control=job.control,
        ranks=1,
        state=FAILED,
        particles=len(mesh.points),
        steps=float(len(step_ends(job.problem, job.n))),
        when=date.today().isoformat(),
        program=f"OpenGeoSys {version}",
    )
    for _ in range(repeat):
        with tempfile.TemporaryDirectory(prefix="dosui_report_") as name:
            folder = Path(name)
            for file, text in job.files().items():
                (folder / file).write_text(text, encoding="utf-8")
            outcome = run([program, "-l", "error", f"{_NAME}.prj"], folder, limit)
            if outcome.status != 0:
                result.state = TIMEOUT if outcome.status is None else FAILED
                result.wall, result.message = outcome.wall, outcome.last_words()
                return result
            if result.state != DONE or outcome.wall < result.wall:
                result.wall, result.cpu = outcome.wall, outcome.cpu
                try:
                    result.errors = errors_of(folder, job.problem, mesh)
                except (OSError, ValueError, ElementTree.ParseError) as error:
                    result.message = f"unreadable result: {error}"
                    return result
    complete = len(result.errors) == len(TIME_FACTORS) and math.isfinite(result.error)
    result.state = DONE if complete else FAILED
    result.message = "" if complete else "no finite error at every T"
    result.repeats = repeat
    return result


def errors_of(folder: Path, problem: Problem, mesh: Mesh) -> dict[str, float]:
    """Relative L2 errors of the pressure in the centres of the elements, over T."""
    errors = {}
    for entry in ElementTree.parse(folder / "out.pvd").iter("DataSet"):
        time = float(entry.get("timestep", "0"))
        if time <= 0:
            continue
        nodal = _pressure(folder / entry.get("file", ""))
        errors[problem.solution.time_factor(time)] = error_of(problem, mesh, nodal, time)
    return errors_at(errors)


def _pressure(path: Path) -> FloatArray:
    for array in ElementTree.parse(path).iter("DataArray"):
        if array.get("Name") in ("pressure_interpolated", "pressure"):
            return np.array((array.text or "").split(), dtype=np.float64)
    raise ValueError(f"{path.name} has no pressure")


def _version(path: Path) -> str:
    outcome = run([str(path), "--version"], Path.cwd(), 60.0)
    found = re.search(r"version:\s*(\S+)", outcome.output)
    return found[1] if found else "of unknown version"


def _key(job: OgsJob, version: str) -> str:
    whole = "\n".join([version, *job.files().values()])
    return hashlib.sha256(whole.encode()).hexdigest()[:16]

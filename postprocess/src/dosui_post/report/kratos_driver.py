"""Runs Kratos GeoMechanics on a case that `kratos` wrote; for Kratos' own interpreter.

    python kratos_driver.py case.json result.json

Knows nothing of dosui_post. Newmark's scheme with steps of any length; writes the pressures at the
output times and the wall time of the loop.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"


def mesh_text(case: dict[str, Any]) -> str:
    """The mesh as an mdpa file: displacements quadratic, pressures linear."""
    nodes = [f"{k + 1} {x!r} {z!r} 0.0" for k, (x, z) in enumerate(case["points"])]
    cells = [
        f"{k + 1} 1 " + " ".join(str(n + 1) for n in cell) for k, cell in enumerate(case["cells"])
    ]
    edges = [
        f"{k + 1} 1 " + " ".join(str(n + 1) for n in edge) for k, edge in enumerate(case["edges"])
    ]
    lines = ["Begin Properties 1", "End Properties", "Begin Nodes", *nodes, "End Nodes"]
    lines += ["Begin Elements SmallStrainUPwDiffOrderElement2D8N", *cells, "End Elements"]
    lines += ["Begin Conditions LineLoadDiffOrderCondition2D3N", *edges, "End Conditions"]
    parts = {"soil": range(len(nodes)), **case["sides"]}
    for name, members in parts.items():
        lines += [f"Begin SubModelPart {name}", "Begin SubModelPartNodes"]
        lines += [str(n + 1) for n in members]
        lines += ["End SubModelPartNodes", "Begin SubModelPartElements"]
        lines += [str(k + 1) for k in range(len(cells))] if name == "soil" else []
        lines += ["End SubModelPartElements", "Begin SubModelPartConditions"]
        lines += [str(k + 1) for k in range(len(edges))] if name == "top" else []
        lines += ["End SubModelPartConditions", "End SubModelPart"]
    return "\n".join(lines) + "\n"


def materials(case: dict[str, Any]) -> dict[str, Any]:
    """MaterialParameters."""
    soil, viscosity = case["soil"], 1.0e-3
    permeability = soil["conductivity"] / soil["unit_weight"] * viscosity
    variables = {
        "GEO_DRAINAGE_TYPE": "FULLY_COUPLED",
        "YOUNG_MODULUS": soil["young_modulus"],
        "POISSON_RATIO": soil["poisson_ratio"],
        "DENSITY_SOLID": 2650.0,
        "DENSITY_WATER": 1000.0,
        "POROSITY": soil["porosity"],
        "BIOT_COEFFICIENT": 1.0,
        "BULK_MODULUS_SOLID": 1.0e20,
        "BULK_MODULUS_FLUID": soil["water_bulk_modulus"],
        "PERMEABILITY_XX": permeability,
        "PERMEABILITY_YY": permeability,
        "PERMEABILITY_XY": 0.0,
        "DYNAMIC_VISCOSITY": viscosity,
        "RETENTION_LAW": "SaturatedLaw",
        "SATURATED_SATURATION": 1.0,
        "RESIDUAL_SATURATION": 0.0,
        "THICKNESS": 1.0,
    }
    law = {"name": "GeoLinearElasticPlaneStrain2DLaw"}
    material = {"constitutive_law": law, "Variables": variables}
    return {
        "properties": [{"model_part_name": "domain.soil", "properties_id": 1, "Material": material}]
    }


def _vector(part: str, variable: str, active: list[bool], value: list[float]) -> dict[str, Any]:
    return {
        "python_module": "apply_vector_constraint_table_process",
        "kratos_module": "KratosMultiphysics.GeoMechanicsApplication",
        "process_name": "ApplyVectorConstraintTableProcess",
        "Parameters": {
            "model_part_name": f"domain.{part}",
            "variable_name": variable,
            "active": active,
            "is_fixed": active,
            "value": value,
            "table": [0, 0, 0],
        },
    }


def parameters(case: dict[str, Any]) -> dict[str, Any]:
    """ProjectParameters."""
    zero = [0.0, 0.0, 0.0]
    constraints = [
        _vector(side, "DISPLACEMENT", [component == 0, component == 1, False], zero)
        for side, component in case["rollers"]
    ]
    constraints.append(
        {
            "python_module": "apply_scalar_constraint_table_process",
            "kratos_module": "KratosMultiphysics.GeoMechanicsApplication",
            "process_name": "ApplyScalarConstraintTableProcess",
            "Parameters": {
                "model_part_name": f"domain.{case['drained']}",
                "variable_name": "WATER_PRESSURE",
                "is_fixed": True,
                "value": 0.0,
                "table": 0,
            },
        }
    )
    loads = []
    if case["plate"] is None:
        load = _vector("top", "LINE_LOAD", [False, True, False], [0.0, -case["load"], 0.0])
        load["Parameters"]["is_fixed"] = [False, False, False]
        loads.append(load)
    else:
        constraints.append(
            _vector("top", "DISPLACEMENT", [False, True, False], [0.0, case["plate"][0], 0.0])
        )
    return {
        "problem_data": {
            "problem_name": "case",
            "start_time": 0.0,
            "end_time": case["ends"][-1],
            "echo_level": 0,
            "parallel_type": "OpenMP",
            "number_of_threads": 1,
        },
        "solver_settings": {
            "solver_type": "U_Pw",
            "model_part_name": "domain",
            "domain_size": 2,
            "model_import_settings": {"input_type": "mdpa", "input_filename": "case"},
            "material_import_settings": {"materials_filename": "materials.json"},
            "time_stepping": {"time_step": case["ends"][0]},
            "buffer_size": 2,
            "echo_level": 0,
            "reset_displacements": False,
            "clear_storage": False,
            "compute_reactions": False,
            "move_mesh_flag": False,
            "reform_dofs_at_each_step": False,
            "block_builder": True,
            "solution_type": "Quasi-Static",
            "scheme_type": "Newmark",
            "newmark_beta": 0.25,
            "newmark_gamma": 0.5,
            "newmark_theta": case["theta"],
            "strategy_type": "newton_raphson",
            "convergence_criterion": "displacement_criterion",
            "displacement_relative_tolerance": 1.0e-6,
            "displacement_absolute_tolerance": 1.0e-14,
            "min_iterations": 1,
            "max_iterations": 10,
            "number_cycles": 1,
            "calculate_reactions": False,
            "rotation_dofs": False,
            "linear_solver_settings": {"solver_type": "LinearSolversApplication.sparse_lu"},
            "problem_domain_sub_model_part_list": ["soil"],
            "processes_sub_model_part_list": list(case["sides"]),
            "body_domain_sub_model_part_list": ["soil"],
        },
        "output_processes": {},
        "processes": {"constraints_process_list": constraints, "loads_process_list": loads},
    }


def solve(case: dict[str, Any]) -> dict[str, Any]:
    """Runs the case; pressures of all nodes (compression positive) at each output time."""
    import KratosMultiphysics as kratos
    import KratosMultiphysics.LinearSolversApplication
    from KratosMultiphysics.GeoMechanicsApplication.geomechanics_analysis import (
        GeoMechanicsAnalysis,
    )

    Path("case.mdpa").write_text(mesh_text(case), encoding="utf-8")
    Path("materials.json").write_text(json.dumps(materials(case)), encoding="utf-8")
    kratos.Logger.GetDefaultOutput().SetSeverity(kratos.Logger.Severity.WARNING)
    model = kratos.Model()
    analysis = GeoMechanicsAnalysis(model, kratos.Parameters(json.dumps(parameters(case))))
    analysis.Initialize()
    part, solver = model["domain"], analysis._GetSolver()
    plate = [model["domain"].Nodes[n + 1] for n in case["sides"]["top"]]
    pressures: dict[str, list[float]] = {}
    begin, before = time.perf_counter(), 0.0
    for k, end in enumerate(case["ends"]):
        part.CloneTimeStep(end)
        part.ProcessInfo[kratos.STEP] += 1
        part.ProcessInfo[kratos.DELTA_TIME] = end - before
        analysis.time = before = end
        analysis.InitializeSolutionStep()
        if case["plate"] is not None:
            for node in plate:
                node.SetSolutionStepValue(kratos.DISPLACEMENT_Y, case["plate"][k])
        solver.Predict()
        if not solver.SolveSolutionStep():
            raise SystemExit(f"no convergence at t = {end} s")
        analysis.FinalizeSolutionStep()
        if end in case["outputs"]:
            pressures[repr(end)] = [
                -node.GetSolutionStepValue(kratos.WATER_PRESSURE) for node in part.Nodes
            ]
    return {"loop": time.perf_counter() - begin, "pressures": pressures}


def version() -> str:
    """Of Kratos."""
    import KratosMultiphysics as kratos

    return str(kratos.KratosGlobals.Kernel.Version())


if __name__ == "__main__":
    if sys.argv[1] == "--version":
        print("version:", version())
    else:
        answer = solve(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
        Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")

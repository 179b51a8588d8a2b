"""What a scene may say, but hardly means: one warning each, with its place, none without cause."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import ROOT, Runner

SCENE = """&scene dimension = 2 integrator = '{integrator}' gravity = {gravity} {scene} /
&grid spacing = 0.5 {grid} /
&time end_time = {end} {time} /
&material name = 'clay' young_modulus = {young} porosity = 0.4 solid_density = {density}
  hydraulic_conductivity = {k} {material} /
&region name = 'clay' material = 'clay' box_min = 0, 0 box_max = 4, 4 /
{more}
&surface name = 'left' region = 'clay' face = 'x-' /
&surface name = 'base' region = 'clay' face = 'z-' /
&surface name = 'top' region = 'clay' face = 'z+' /
&mechanical_condition surface = 'left' kind = '{left}' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {load} /
&hydraulic_condition surface = 'top' kind = 'head' value = 4 /
"""
DEFAULTS = {
    "integrator": "quasi_static",
    "gravity": "0, -9.81",
    "scene": "",
    "grid": "",
    "end": "1e5",
    "time": "",
    "young": "1e7",
    "density": "2650",
    "k": "1e-8",
    "material": "",
    "more": "",
    "left": "roller",
    "load": "1e4",
}
MOHR = "model = 'mohr_coulomb' cohesion = 1e3 "


def warnings_of(text: str) -> list[str]:
    """Lines of warnings."""
    return [line for line in text.splitlines() if line.startswith("warning:")]


def test_a_sound_scene_warns_of_nothing(dosui: Runner) -> None:
    """The scene that the cases below spoil."""
    run = dosui(SCENE.format(**DEFAULTS), "--check")
    assert run.status == 0, run.stderr
    assert not warnings_of(run.stderr)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"density": "2.65"}, r":4: &material solid_density = 2.65: .*500 .*5000"),
        ({"density": "6000"}, r"solid_density"),
        ({"young": "10"}, r":4: &material young_modulus = 10: .*1000 "),
        ({"young": "2e12"}, r"young_modulus"),
        ({"k": "5"}, r":5: &material hydraulic_conductivity = 5:"),
        ({"gravity": "0, 9.81", "load": "1e5"}, r":1: &scene gravity = .*points up"),
        ({"gravity": "0, -98.1"}, r"&scene gravity = .*98.1"),
        ({"gravity": "0, -1.62"}, r"&scene gravity"),
        ({"material": MOHR + "friction_angle = 0.5236"}, r"friction_angle = 0.5236: .* 30 "),
        (
            {"material": MOHR + "friction_angle = 30 dilation_angle = 0.1"},
            r"dilation_angle = 0.1: .* 5.73 ",
        ),
        ({"load": "-1e4"}, r":13: &mechanical_condition value = -1e4: pulls"),
        ({"more": "&material name = 'sand' young_modulus = 1e7 /"}, r":7: &material name = 'sand'"),
        (
            {"more": "&surface name = 'right' region = 'clay' face = 'x+' /"},
            r":7: &surface name = 'right': no condition or probe",
        ),
        (
            {"more": "&region name = 'fill' material = 'clay' box_min = 0, 4.2 box_max = 4, 5.2 /"},
            r":7: &region name = 'fill': lies 0.2 m away from 'clay' at \(.*, 4\)",
        ),
        (
            {"more": "&region name = 'block' material = 'clay' box_min = 6, 0 box_max = 7, 1 /"},
            r":7: &region name = 'block': .*along \(0, -1\)",
        ),
        ({"gravity": "1, -9.76", "left": "fixed"}, None),
        ({"integrator": "explicit", "end": "1e9"}, r"explicit steps; semi_implicit would take"),
        (
            {
                "scene": "deformation = 'updated'",
                "grid": "shape_function = 'linear'",
                "integrator": "explicit",
                "end": "1.0",
            },
            r":2: &grid shape_function = 'linear': .*gimp",
        ),
        ({"scene": "deformation = 'updated'", "integrator": "explicit", "end": "1.0"}, None),
    ],
)
def test_one_warning(dosui: Runner, changes: dict[str, str], expected: str | None) -> None:
    """Each fault is named with line, group, key and value; nothing else is."""
    run = dosui(SCENE.format(**(DEFAULTS | changes)), "--check")
    assert run.status == 0, run.stderr
    found = warnings_of(run.stderr)
    if expected is None:
        assert not found
    else:
        assert len(found) == 1, found
        assert re.search(expected, found[0]), found


def test_body_that_nothing_holds(dosui: Runner) -> None:
    """Rollers at the base alone hold no body that is pushed sideways."""
    text = SCENE.format(**(DEFAULTS | {"left": "pressure' value = '1e3"})).replace("'1e3'", "1e3")
    run = dosui(text, "--check")
    assert any(
        re.search(r"&region name = 'clay': .*along \(1, -?0\)", line)
        for line in warnings_of(run.stderr)
    ), run.stderr


def test_updated_scenes_take_gimp(dosui: Runner) -> None:
    """The default shape function follows the deformation, and the file says which it was."""
    text = SCENE.format(**(DEFAULTS | {"integrator": "explicit", "time": "maximum_steps = 1"}))
    small = dosui(text, folder="small")
    assert small.status == 0, small.stderr
    moving = dosui(text.replace("gravity", "deformation = 'updated' gravity"), folder="moving")
    assert moving.status == 0, moving.stderr
    for run, name in ((small, "linear"), (moving, "gimp")):
        (result,) = run.folder.glob("*.vtkhdf")
        assert f"shape_function = '{name}'".encode() in result.read_bytes()


@pytest.mark.parametrize(
    "scene", sorted((ROOT / "input").glob("*/*.nml")), ids=lambda path: f"{path.parent.name}"
)
def test_shipped_scenes_warn_of_nothing(dosui: Runner, scene: Path) -> None:
    """What the project shows is meant as it is."""
    run = dosui(scene, "--check")
    assert run.status == 0, run.stderr
    assert not warnings_of(run.stderr)

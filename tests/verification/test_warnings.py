"""What a scene may say, but hardly means: one warning each, with its place, none without cause."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
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
LAYERS = (
    "&material name = 'peat' young_modulus = 1e6 porosity = {n} hydraulic_conductivity = 1e-8 /\n"
    "&region name = 'peat' material = 'peat' box_min = 0, 4 box_max = 4, 5 /\n"
)
STATE = "&initial_state {region} pore_pressure = 'hydrostatic' water_level = {water} "
STATE += "effective_stress = 'geostatic' surface_level = {surface} /\n"
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
        (
            {"integrator": "explicit", "end": "1e9"},
            r"explicit steps take very long: about .* explicit, .* semi_implicit, .* quasi_static",
        ),
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
        (
            {
                "grid": "origin = 0.05, 0.05",
                "more": "&mechanics average_volume_change = .false. /",
            },
            r":7: &mechanics average_volume_change = .false.: .*integrated by particles",
        ),
        (
            {"grid": "origin = 0.05, 0.05", "more": "&mechanics coupling_gradient = 'particle' /"},
            r":7: &mechanics coupling_gradient = 'particle': .*integrated by particles",
        ),
        ({"grid": "origin = 0.05, 0.05"}, None),
        ({"more": "&mechanics coupling_gradient = 'particle' /"}, None),
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


def state(surface: str = "5", water: str = "5", region: str = "") -> str:
    """An &initial_state with geostatic stresses."""
    return STATE.format(surface=surface, water=water, region=region and f"region = '{region}'")


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (LAYERS.format(n=0.7) + state(), r":9: &initial_state .*'clay'.*'peat' lies above"),
        (LAYERS.format(n=0.4) + state(), None),
        (LAYERS.format(n=0.7) + state("4.5", region="clay") + state(region="peat"), None),
        (LAYERS.format(n=0.7) + state(region="peat"), None),
        (state("4", "3"), r":7: &initial_state .*stands 1 m lower"),
        (state("4", "4"), None),
        (state("4", "4.5"), None),
        (state("6", "4"), None),
        (
            state("4", "4") + "&initial_state effective_stress = 'zero' /",
            r":8: &initial_state region.*sets all",
        ),
        (
            state("4", "4") + "&initial_state pore_pressure = 'zero' effective_stress = 'zero' /",
            None,
        ),
        (state("4", "4") + state("4", "4", "clay"), None),
    ],
)
def test_states_out_of_equilibrium(dosui: Runner, more: str, expected: str | None) -> None:
    """Layers, low water and overridden states have a warning, and none with a geostatic start."""
    scene = DEFAULTS | {"more": more}
    if "'peat'" in more:
        upper = SCENE.replace("'top' region = 'clay'", "'top' region = 'peat'")
    else:
        upper = SCENE
    run = dosui(upper.format(**scene), "--check")
    assert run.status == 0, run.stderr
    found = warnings_of(run.stderr)
    assert len(found) == (expected is not None), found
    assert expected is None or re.search(expected, found[0]), found
    scene["time"] = "geostatic_start = .true."
    run = dosui(upper.format(**scene), "--check")
    assert run.status == 0, run.stderr
    assert all("sets all" in line for line in warnings_of(run.stderr))


@pytest.mark.parametrize("starts_in_equilibrium", [False, True])
def test_layers_without_geostatic_start_change_pressures(
    dosui: Runner, starts_in_equilibrium: bool
) -> None:
    """What is warned of is real: undrained, the missing weight of the layer becomes pressure."""
    text = SCENE.format(
        **(
            DEFAULTS
            | {
                "more": LAYERS.format(n=0.7)
                + state()
                + "&probe name = 'u' kind = 'point' field = 'pore_pressure' position = 2, 1 /\n"
                + "&surface name = 'right' region = 'clay' face = 'x+' /\n"
                + "&mechanical_condition surface = 'right' kind = 'roller' /\n"
                + "&surface name = 'sides' region = 'peat' face = 'x-' /\n"
                + "&mechanical_condition surface = 'sides' kind = 'roller' /\n"
                + "&surface name = 'other' region = 'peat' face = 'x+' /\n"
                + "&mechanical_condition surface = 'other' kind = 'roller' /",
                "end": "1.0",
                "time": f"geostatic_start = .{str(starts_in_equilibrium).lower()}.",
            }
        )
    )
    # the top of the peat is the surface: no load, its own water level
    text = text.replace(
        "&surface name = 'top' region = 'clay'", "&surface name = 'top' region = 'peat'"
    )
    text = text.replace("kind = 'pressure' value = 1e4", "kind = 'pressure' value = 0")
    text = text.replace("kind = 'head' value = 4", "kind = 'head' value = 5")
    run = dosui(text)
    assert run.status == 0, run.stderr
    (file,) = run.folder.glob("*.vtkhdf")
    with h5py.File(file) as result:
        pressure = result["History/u"][0]
    missing = (0.3 - 0.6) * 1650.0 * 9.81 * 1.0
    expected = 1000.0 * 9.81 * 4.0 + (0.0 if starts_in_equilibrium else missing)
    assert abs(pressure - expected) < 0.02 * abs(missing), pressure
    assert ("lies above" in run.stderr) == (not starts_in_equilibrium)


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

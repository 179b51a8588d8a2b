"""Starts of bodies at rest: equilibrium is found, at once if it is there; the loose is named."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN, Runner
from start_boxes import box, run

# a few of the boxes that `python tests/verification/start_boxes.py 200` runs; DOSUI_SWEEP: so many
QUICK = [1, 2, 3, 5, 6, 12, 13, 15]
# started with absurd stresses, and with soils that yield under conjugate gradients
QUICK += [5147, 5149, 5170]
# did not end: nodes that follow others (in 1-D, in 2-D), GIMP beside rollers (in 3-D), volumes of
# trial motions that added up (in 1-D), more of Newton's iterations than a time step takes
QUICK += [77183, 5125, 77112, 77184, 77038]
SEEDS = list(range(1, 1 + int(os.environ["DOSUI_SWEEP"]))) if "DOSUI_SWEEP" in os.environ else QUICK


@pytest.mark.parametrize("seed", SEEDS)
def test_random_box(seed: int, tmp_path: Path) -> None:
    """Random boxes of ground start; their states are exact where the grid fits."""
    scene = box(seed)
    assert run(scene, BIN / "dosui", tmp_path) == [], scene.text


GROUND = """
&scene dimension = 2 integrator = '{integrator}' gravity = 0.0, -9.81 /
&grid spacing = 0.5 /
&time end_time = {end} geostatic_start = .true. maximum_steps = 60 /
&material name = 'soil' young_modulus = 1.0e7 poisson_ratio = 0.3
  hydraulic_conductivity = 1.0e-8 {model} /
&region name = 'soil' material = 'soil' box_min = 0.0, 0.0 box_max = 4.0, 4.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 4.0 {stress} /
&surface name = 'left' region = 'soil' face = 'x-' /
&surface name = 'right' region = 'soil' face = 'x+' /
&surface name = 'base' region = 'soil' face = 'z-' /
&surface name = 'top' region = 'soil' face = 'z+' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
{base}
&hydraulic_condition surface = 'top' kind = 'head' value = 4.0 /
&output name = 'ground' /
"""
BASE = "&mechanical_condition surface = 'base' kind = 'fixed' /"
GIVEN = "effective_stress = 'geostatic' surface_level = 4.0 lateral_ratio = 0.5"
STRONG = "model = 'mohr_coulomb' friction_angle = 35.0"


@pytest.mark.parametrize("model", ["", STRONG])
@pytest.mark.parametrize("stress", ["", GIVEN])
@pytest.mark.parametrize("integrator", ["explicit", "semi_implicit", "quasi_static"])
def test_water_up_to_the_ground(dosui: Runner, integrator: str, stress: str, model: str) -> None:
    """A beginner's first scene rests: nothing moves, no water flows, none is missing."""
    end = "1.0e6" if integrator == "quasi_static" else "0.05"
    done = dosui(
        GROUND.format(integrator=integrator, stress=stress, model=model, end=end, base=BASE)
    )
    assert done.status == 0, done.stderr
    iterations = int(re.findall(r"equilibrium after (\d+) it", done.stdout)[0])
    assert iterations == 0 or not stress
    state = done.fields("ground")
    assert np.abs(state["displacement"]).max() <= 4e-9
    pressure = 9810.0 * (4.0 - state["points"][:, 2])
    assert np.abs(state["pore_pressure"] - pressure).max() <= 1e-9 * 39240.0
    water = re.findall(r"water stored (\S+) m3 = inflow (\S+) .* pores (\S+), missing (\S+) %",
                       done.stdout)[0]  # fmt: skip
    assert [float(value) for value in water] == [0.0] * 4
    if integrator == "quasi_static":  # its steps grow to the run's end
        assert int(re.findall(r"after (\d+) steps", done.stdout)[0]) <= 20


def test_load_on_ground_at_rest(dosui: Runner) -> None:
    """A load on K0 ground raises its pressures by the water's share, and nothing else."""
    text = GROUND.format(integrator="quasi_static", stress=GIVEN, model="", end="1.0", base=BASE)
    text = text.replace("1.0e-8", "1.0e-12").replace(
        "&hydraulic",
        "&mechanical_condition surface = 'top' kind = 'pressure' value = 20000.0\n"
        "  factor_times = 0.0, 1.0 factor_values = 0.0, 1.0 /\n&hydraulic",
    )
    done = dosui(text)
    assert done.status == 0, done.stderr
    state = done.fields("ground")
    deep = state["points"][:, 2] < 3.0
    water, soil = 2.2e9 / 0.3, 1.0e7 * 0.7 / (1.3 * 0.4)
    excess = state["pore_pressure"] - 9810.0 * (4.0 - state["points"][:, 2])
    assert np.abs(excess[deep] / (20000.0 * water / (water + soil)) - 1.0).max() <= 1e-5


def test_free_body_is_named_with_its_place(dosui: Runner) -> None:
    """What nothing holds and weight drives is called so: its place and its way."""
    done = dosui(GROUND.format(integrator="explicit", stress="", model="", end="0.05", base=""))
    assert done.status == 1
    found = re.search(
        r"body around \(([^,]+), ([^)]+)\) m can move along \(([^,]+), ([^)]+)\) without resist",
        done.stderr + done.stdout,
    )
    assert found, done.stderr
    x, z, along_x, along_z = (float(text) for text in found.groups())
    assert abs(x - 2.0) <= 0.1 and abs(z - 2.0) <= 0.1
    assert abs(along_x) <= 1e-6 and abs(along_z + 1.0) <= 1e-6


def test_the_loose_one_of_two_bodies_is_named(dosui: Runner) -> None:
    """The body that nothing holds, not the one beside it that stands."""
    text = GROUND.format(integrator="explicit", stress="", model="", end="0.05", base=BASE)
    text += "&region name = 'loose' material = 'soil' box_min = 8.0, 0.0 box_max = 9.0, 1.0 /\n"
    done = dosui(text)
    assert done.status == 1
    assert re.search(r"body around \(8\.5, 0\.5\) m can move along \(\S+, -1\)", done.stderr)


def test_free_body_without_drive_rests(dosui: Runner) -> None:
    """A body that nothing holds and nothing drives is in equilibrium."""
    text = GROUND.format(integrator="explicit", stress="", model="", end="0.01", base="")
    text = text.replace("gravity = 0.0, -9.81", "").replace(
        "'hydrostatic' water_level = 4.0", "'zero'"
    )
    text = re.sub("&(mechanical|hydraulic)_condition.*\n", "", text)
    done = dosui(text)
    assert done.status == 0, done.stderr
    assert np.abs(done.fields("ground")["displacement"]).max() == 0.0


def test_steady_flow_misses_little(dosui: Runner) -> None:
    """In = out: what is missing counts against what flows, not against what is stored."""
    text = GROUND.format(integrator="quasi_static", stress=GIVEN, model="", end="1.0e9", base=BASE)
    text = text.replace(
        "&output", "&hydraulic_condition surface = 'base' kind = 'head' value = 5.0 /\n&output"
    ).replace("maximum_steps = 60", "")
    done = dosui(text)
    assert done.status == 0, done.stderr
    missing = float(re.findall(r"missing (\S+) %", done.stdout)[0])
    assert missing <= 0.1
    inflow = done.history("ground", "inflow_base")[-1]
    assert inflow == pytest.approx(1.0e-8 / 4.0 * 4.0 * 1.0e9, rel=1e-2)


# ---------------------------------------------------------------- starts that do not end

SLIDING = """
&scene dimension = 2 integrator = 'explicit' water = 'coupled' gravity = 0.0, 0.0 /
&grid spacing = 0.25 shape_function = 'gimp' /
&time end_time = 0.04 maximum_steps = 8 undrained_start = .true. /
&water bulk_modulus = 6.5e8 /
&material name = 'soil' young_modulus = 2.1e5 poisson_ratio = 0.45 porosity = 0.5
  hydraulic_conductivity = 1.0e-4 /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 1.0, 1.0
  shape_angle = -23.0 /
&surface name = 'left' region = 'body' face = 'x-' /
&surface name = 'base' region = 'body' face = 'z-' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'base' kind = 'pressure' value = 204.7 /
&output name = 'run' /
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_hopeless_start_ends(dosui: Runner, ranks: int) -> None:
    """A slanted body that slides along its wall, in almost incompressible water. It ends in
    seconds, not after 200000 iterations, and says where it gives way, and that along the wall."""
    done = dosui(SLIDING, ranks=ranks, timeout=60)
    assert done.status == 1, done.stdout
    assert "the start found no equilibrium" in done.stderr
    way = re.search(r"gives way along \((.*?), (.*?)\) without resistance", done.stderr)
    assert way is not None, done.stderr
    along = np.sin(np.radians(23.0)), np.cos(np.radians(23.0))
    assert float(way[1]) * along[0] + float(way[2]) * along[1] == pytest.approx(1.0, abs=1e-3)
    where = re.search(r"around \((.*?), (.*?)\) m", done.stderr)
    assert where is not None
    assert np.hypot(float(where[1]) - 0.5, float(where[2]) - 0.5) < 0.8


LONG_START = """
&scene dimension = 2 integrator = '{integrator}' water = 'coupled' gravity = 0.0, -9.81 /
&grid spacing = {spacing} /
&time end_time = 1.0 {start} /
&material name = 'soil' model = 'mohr_coulomb' young_modulus = 1.0e7 poisson_ratio = 0.3
  cohesion = 3.0e3 friction_angle = 20.0 porosity = 0.4 hydraulic_conductivity = 1.0e-6 /
&region name = 'body' material = 'soil' box_min = 0.0, 0.0 box_max = 8.0, 4.0
  shape_angle = 3.0 /
&surface name = 'base' region = 'body' face = 'z-' /
&surface name = 'left' region = 'body' face = 'x-' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'left' kind = 'roller' /
&output name = 'run' /
"""


@pytest.mark.parametrize(
    "integrator, start, number",
    [
        ("explicit", "undrained_start = .true.", signal.SIGTERM),
        ("explicit", "undrained_start = .true.", signal.SIGINT),
        ("explicit", "geostatic_start = .true.", signal.SIGXCPU),
        ("quasi_static", "", signal.SIGTERM),
    ],
)
def test_signal_ends_a_start(
    tmp_path: Path, integrator: str, start: str, number: signal.Signals
) -> None:
    """A signal while an equilibrium is sought: status 3 at once, and a sentence."""
    spacing = 0.05 if integrator == "quasi_static" else 0.1
    (tmp_path / "scene.nml").write_text(
        LONG_START.format(integrator=integrator, start=start, spacing=spacing)
    )
    process = subprocess.Popen(
        [str(BIN / "dosui"), "scene.nml"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("wall         left"):
            break
    time.sleep(0.6)
    assert process.poll() is None
    process.send_signal(number)
    rest, _ = process.communicate(timeout=60)
    assert process.returncode == 3, rest
    assert "stopped by a signal while the start sought the equilibrium at t = 0 s" in rest
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.nml"]

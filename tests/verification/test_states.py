"""Impossible states are named before their consequences; runs without progress say where."""

from __future__ import annotations

import re

import h5py
import numpy as np
import pytest

BOX = """&scene dimension=2 {scene} /
&grid spacing=0.25 /
&time end_time={end} {time} /
&material name='s' young_modulus=1e6 poisson_ratio=0.25 porosity=0.3 {k} {soil} /

&region name='b' material='s' box_min=0,0 box_max=1,1 /
&surface name='top' region='b' face='z+' /
&surface name='base' region='b' face='z-' /
&surface name='left' region='b' face='x-' /
&surface name='right' region='b' face='x+' /
&mechanical_condition surface='base' kind='fixed' /
{more}
&output name='r' {output} /
"""


def box(more="", scene="", soil="", end="5.0", time="", output=""):
    k = "" if "'none'" in scene else "hydraulic_conductivity=1e-5"
    return BOX.format(more=more, scene=scene, soil=soil, end=end, time=time, output=output, k=k)


def is_finite(file, group):
    """Are all numbers below a group of a file finite?"""
    found = []
    file[group].visititems(lambda _, item: found.append(item))
    data = [item[()] for item in found if isinstance(item, h5py.Dataset)]
    return all(np.all(np.isfinite(values)) for values in data if values.dtype.kind == "f")


@pytest.mark.parametrize(
    ("more", "scene", "line", "words"),
    [
        (
            "&source force_z='log(-1)' /",
            "water='none'",
            12,
            ["force_z", "x = 0.0625, z = 0.0625, t = 0 s"],
        ),
        ("&source water='sqrt(2 - t)' /", "", 12, ["&source water", "t = 2.04918 s"]),
        (
            "&mechanical_condition surface='top' kind='pressure'\n value=1 formula='1/(x-.9375)' /",
            "water='none'",
            13,
            ["&mechanical_condition formula", "x = 0.9375, z = 1, t = 0 s"],
        ),
        (
            "&hydraulic_condition surface='top' kind='head' value=1 formula='log(0.9 - x)' /",
            "",
            12,
            ["&hydraulic_condition formula", "x = 0.9375, z = 1"],
        ),
        (
            "&base_motion acceleration=1,0 formula='exp(1e3*t)' /",
            "water='none'",
            12,
            ["&base_motion formula", "t = 0.737705 s"],
        ),
    ],
)
@pytest.mark.parametrize("ranks", [1, 2])
def test_formulas_are_tried(dosui, more, scene, line, words, ranks):
    run = dosui(box(more, scene), "--check", ranks=ranks)
    assert run.status == 2
    assert f"scene.nml:{line}: " in run.stderr
    for word in ["is not a finite number", *words]:
        assert word in run.stderr
    assert run.stderr.count("is not a finite number") == 1


@pytest.mark.parametrize("integrator", ["explicit", "semi_implicit", "quasi_static"])
def test_a_force_that_is_no_number(dosui, integrator):
    # within 0.04 s of a run of 5 s, where no trial looks: 1/512 s fixes where the steps fall
    water = "" if integrator == "semi_implicit" else "water='none'"
    scene = box(
        "&source force_z='-100*sqrt(abs(t - 2.337) - 0.02)' /\n&mechanics damping='viscous' /",
        f"{water} integrator='{integrator}'",
        time="time_step=0.001953125 output_interval=0.5",
        output="checkpoint_steps=32",
    )
    run = dosui(scene)
    run.ended_with(1)
    assert re.search(r"force on the body at \(0, 0(.25)?\) m is not a finite number", run.stderr)
    with h5py.File(run.folder / "r.vtkhdf") as file:
        assert is_finite(file, "VTKHDF/PointData")
    times = run.times("r")
    assert 2.0 <= times[-1] <= 2.32  # the last whole state, or the last output before it
    with h5py.File(run.folder / "r.restart.h5") as file:
        assert is_finite(file, "/")
        assert file["values/clock"][0] == 2.3125  # the last multiple of 32 steps before 2.317 s


COLUMN = """&scene dimension=1 {scene} /
&grid spacing=0.05 {grid} /
&time end_time=200.0 output_interval=20.0 {time} /
&material name='s' young_modulus=1.0e5 porosity=0.3 hydraulic_conductivity=1.0e-3 /
&region name='r' material='s' box_min=0.0 box_max=1.0 /
&surface name='base' region='r' face='z-' /
&surface name='top' region='r' face='z+' /
&mechanical_condition surface='base' kind='roller' /
&mechanical_condition surface='top' kind='pressure' value=60000.0
  factor_times=0.0, {ramp} factor_values=0.0, 1.0 /
{more}
&output name='r' /
"""


def test_pores_close_with_finite_strains(dosui):
    # the top has its own load: 1e5 Pa x ln(J)/J = -60 kPa t/100 s at J = 0.7, 84.9 s
    more = "&hydraulic_condition surface='top' kind='pressure' value=0.0 /"
    scene = "integrator='quasi_static' deformation='finite'"
    run = dosui(COLUMN.format(scene=scene, more=more, ramp="100.0", grid="", time=""))
    run.ended_with(1)
    assert "particle 39 closes its pores" in run.stderr
    time = float(run.stderr.split("steps end at t = ")[1].split(" s")[0])
    exact = -100.0 * 1.0e5 * np.log(0.7) / 0.7 / 60000.0
    assert time == pytest.approx(exact, rel=0.02)  # the topmost particle lies below the top
    assert all(run.fields("r", k)["porosity"].min() > 0.0 for k in range(len(run.times("r"))))
    assert run.stderr.count("\n") <= 5


@pytest.mark.parametrize("water", ["coupled", "none"])
def test_pores_close_in_updated_scenes(dosui, water):
    # dry bodies need no pores, and what they write says that there are none
    more = "&mechanics damping='viscous' /\n"
    if water == "coupled":
        more += "&hydraulic_condition surface='top' kind='pressure' value=0.0 /"
    text = COLUMN.format(
        scene=f"water='{water}' deformation='updated' integrator='auto'",
        more=more,
        ramp="5.0",
        time="",
        grid="shape_function='gimp'",
    )
    text = text.replace("output_interval=20.0", "output_interval=0.1").replace("200.0", "6.0")
    if water == "none":
        text = text.replace("hydraulic_conductivity=1.0e-3", "")
    run = dosui(text)
    run.ended_with(0 if water == "none" else 1)
    porosity = [run.fields("r", k)["porosity"].min() for k in range(len(run.times("r")))]
    if water == "none":
        assert "their porosity is written as 0" in run.stderr
        assert min(porosity) == 0.0
    else:
        assert "closes its pores" in run.stderr
        assert min(porosity) > 0.0


@pytest.mark.parametrize(
    ("more", "scene", "words"),
    [
        (
            "&base_motion acceleration=3.0,0 factor_times=0,1,2 factor_values=0,1,0 /",
            "water='none' deformation='finite'",
            "&base_motion: shaking acts by inertia",
        ),
        (
            "&mechanical_condition surface='left' kind='absorbing' /",
            "water='none' deformation='finite'",
            "&mechanical_condition kind",
        ),
        (
            "&initial_state mode_amplitude=1.0 mode_number=1 /",
            "water='none' deformation='finite'",
            "&initial_state mode_number = 1: bodies without inertia",
        ),
        (
            "&water operator='two_pass' /",
            "deformation='finite'",
            "couples neighbours of neighbours",
        ),
    ],
)
def test_what_auto_becomes_is_checked(dosui, more, scene, words):
    run = dosui(box(more, f"integrator='auto' {scene}"), "--check")
    assert run.status == 2
    assert "scene.nml:12: " in run.stderr
    assert words in run.stderr
    assert "(deformation = 'finite' works with integrator = 'quasi_static')" in run.stderr


def test_constants_that_do_not_fit(dosui):
    # a soil that gave work when it is sheared ended with a segmentation fault
    soil = "model='mohr_coulomb' friction_angle=20 dilation_angle=30"
    run = dosui(box(soil=soil), "--check")
    assert run.status == 2
    assert ":4: &material dilation_angle = 30: must not exceed friction_angle" in run.stderr


def test_rigid_scenes_are_not_shaken(dosui):
    run = dosui(box("&base_motion acceleration=1,0 /", soil="rigid=.true."), "--check")
    assert run.status == 2
    assert "moves nothing" in run.stderr


@pytest.mark.parametrize(
    ("pulls", "stress"), [(0.0, [500, 500 / 3, 500 / 3]), (0.001, [500, 250, 500])]
)
def test_torn_bar(dosui, pulls, stress):
    # tension cut-off at 500 Pa: beyond it a uniform strain has no resistance but its own fixities
    run = dosui(
        f"""&scene dimension=2 water='none' integrator='quasi_static' /
&grid spacing=0.5 /
&time end_time=1.0 largest_step=0.05 /
&material name='s' model='mohr_coulomb' young_modulus=1.0e7 poisson_ratio=0.25 cohesion=1.0e3
  friction_angle=30 dilation_angle=0 tensile_strength=500 /
&region name='r' material='s' box_min=0,0 box_max=1,1 /
&surface name='base' region='r' face='z-' /
&surface name='top' region='r' face='z+' /
&surface name='left' region='r' face='x-' /
&surface name='right' region='r' face='x+' /
&mechanical_condition surface='base' kind='roller' /
&mechanical_condition surface='left' kind='roller' /
&mechanical_condition surface='right' kind='normal_velocity' value=0.001 /
&mechanical_condition surface='top' kind='normal_velocity' value={pulls} /
&output name='r' /
"""
    )
    assert run.status == 0
    assert run.stderr == ""
    found = run.fields("r")["effective_stress"][:, :3]
    assert np.abs(found - stress).max() < 1e-6 * 500


STRIP = """&scene dimension=2 water='none' integrator='quasi_static' /
&grid spacing=0.5 /
&time end_time=1.0 largest_step=0.05 /
&material name='clay' model='mohr_coulomb' young_modulus=1e7 poisson_ratio=0.3 cohesion=1e4 /
&region name='clay' material='clay' box_min=0,-3 box_max=5,0 particles_per_cell=2 /
&surface name='axis' region='clay' face='x-' /
&surface name='far' region='clay' face='x+' /
&surface name='base' region='clay' face='z-' /
&surface name='footing' region='clay' face='z+' box_max=1.0,1.0 /
&mechanical_condition surface='axis' kind='roller' /
&mechanical_condition surface='far' kind='roller' /
&mechanical_condition surface='base' kind='fixed' /
&mechanical_condition surface='footing' kind='pressure' value=2e5
  factor_times=0,1 factor_values=0,1 /
&output name='r' /
"""


def test_a_footing_beyond_its_strength(dosui):
    # Prandtl: 5.14 c = 51.4 kPa is reached at t = 0.257 s; a coarse grid bears some more
    run = dosui(STRIP)
    run.ended_with(1)
    message = run.stderr.strip().splitlines()[-1]
    assert "the soil is at failure" in message
    assert "in 'clay'" in message
    assert "beside surface 'footing'" in message
    assert "of the largest reaction" in message
    time = float(message.split("steps end at t = ")[1].split(" s")[0])
    assert 0.24 < time < 0.36
    assert run.stderr.count("\n") <= 4  # no storm of warnings
    assert np.isfinite(run.fields("r")["displacement"]).all()


DAM = """&scene dimension=2 integrator='quasi_static' gravity=0,-9.81 /
&grid spacing=0.1 /
&time end_time=1e6 /
&material name='s' rigid=.true. porosity=0.3 hydraulic_conductivity=1e-4
  retention='van_genuchten' retention_alpha=20 retention_exponent=4 /
&region name='r' material='s' box_min=0,0 box_max=1,1 /
&initial_state pore_pressure='hydrostatic' water_level=0.75 /
&surface name='left' region='r' face='x-' /
&surface name='right' region='r' face='x+' /
&hydraulic_condition surface='left' kind='reservoir' value=0.9 /
&hydraulic_condition surface='right' kind='reservoir' value=0.2 /
&output name='r' /
"""


def test_a_dam_whose_levels_change_at_once(dosui):
    # saturated pores lose 5 kPa at once, and again and again while the body drains. Dupuit's flow
    # is exact without suction; the capillary fringe adds at most k/alpha times the mean gradient
    run = dosui(DAM)
    assert run.status == 0
    assert run.stderr == ""
    assert run.history("r", "step")[-1] < 120
    time = run.history("r", "time")
    exact = 1e-4 * (0.9**2 - 0.2**2) / 2
    fringe = 1e-4 / 20 * 0.7
    for side, sign in (("left", 1), ("right", -1)):
        volume = sign * run.history("r", f"inflow_{side}")
        flow = (volume[-1] - volume[-5]) / (time[-1] - time[-5])
        assert exact < flow < exact + fringe
    assert abs(run.history("r", "water_balance_error")[-1]) < 0.01


def test_an_embankment_on_soil_without_strength(dosui):
    # clay whose stresses begin at zero fails below the foot of the first lift
    scene = """&scene dimension=2 integrator='quasi_static' gravity=0,-9.81 /
&grid spacing=2.0 /
&time end_time=6.3e7 geostatic_start=.true. /
&material name='clay' model='cam_clay' poisson_ratio=0.3 critical_state_ratio=1.0
  lambda=0.25 kappa=0.05 over_consolidation_ratio=1.5 least_pressure=3000
  porosity=0.6 hydraulic_conductivity=1e-9 /
&region name='clay' material='clay' box_min=0,0 box_max=40,10 /
&initial_state pore_pressure='hydrostatic' water_level=10.0 effective_stress='geostatic'
  surface_level=10.0 lateral_ratio=0.6 /
&surface name='axis' region='clay' face='x-' /
&surface name='far' region='clay' face='x+' /
&surface name='base' region='clay' face='z-' /
&surface name='top' region='clay' face='z+' /
&mechanical_condition surface='axis' kind='roller' /
&mechanical_condition surface='far' kind='roller' /
&mechanical_condition surface='base' kind='fixed' /
&mechanical_condition surface='top' kind='pressure' value=60e3
  formula='min(1, max(0, (16 - x)/6))' factor_times=0,3.9e6 factor_values=0,1 /
&hydraulic_condition surface='top' kind='head' value=10.0 /
&output name='r' checkpoint_steps=16 /
"""
    run = dosui(scene)
    run.ended_with(1)
    message = run.stderr.strip().splitlines()[-1]
    for words in ("no progress", "in 'clay'", "surface 'top'", "the soil is at failure"):
        assert words in message
    assert "times what the soil bears" in message
    steps = run.history("r", "step")[-1]
    assert steps < 100
    assert np.isfinite(run.fields("r")["displacement"]).all()
    # a restart remembers attempts without solution, and ends at the same step
    again = dosui(scene, "--restart", str(run.folder / "r.restart.h5"), folder="again")
    again.ended_with(1)
    assert again.stderr.strip().splitlines()[-1] == message
    assert again.history("r", "step")[-1] == steps


WET = """&scene dimension=2 integrator='explicit' gravity=0,-9.81 /
&grid spacing=0.1 /
&time end_time=1e6 /
&material name='s' rigid=.true. porosity=0.3 hydraulic_conductivity=1e-4
  retention='van_genuchten' retention_alpha=2.0 retention_exponent=1.5 /
&region name='r' material='s' box_min=0,0 box_max=0.2,1 /
&initial_state pore_pressure='hydrostatic' water_level=-1.0 /
&surface name='top' region='r' face='z+' /
&hydraulic_condition surface='top' kind='head' value=1.05 /
&output name='r' /
"""


def test_explicit_steps_collapse_where_pores_fill(dosui):
    # k n/(K_w gamma_w) instead of the capacity of suction: the step falls by 2e4
    run = dosui(WET)
    run.ended_with(1)
    message = run.stderr.strip().splitlines()[-1]
    assert "no progress" in message
    assert "water diffusion" in message
    assert "pores have filled" in message
    place = re.search(r"particle \d+ stores the least water .* at \((.*), (.*)\) m of 's'", message)
    assert float(place.group(2)) > 0.8  # below the wet surface
    assert np.isfinite(run.fields("r")["pore_pressure"]).all()


def test_a_restart_keeps_the_promise_of_the_first_step(dosui):
    # from the midst of the small steps: their own length promises nothing
    scene = WET.replace("&output name='r'", "&output name='r' checkpoint_steps=64")
    whole = dosui(scene, folder="whole")
    last = whole.folder / "r.restart.h5"
    with h5py.File(last) as file:
        watch = file["values/integrator"][:]
    assert 0 < watch[0] < 1e6
    assert watch[2] > 0  # steps without hope have begun
    again = dosui(scene, "--restart", str(last), folder="again", timeout=60)
    assert whole.status == 1
    assert again.status == 1
    errors = [run.stderr.strip().splitlines()[-1] for run in (whole, again)]
    assert "no progress" in errors[0]
    assert errors[1] == errors[0]


def test_explicit_steps_collapse_where_bodies_fly_off(dosui):
    # nothing holds a very soft body that falls for months
    run = dosui(
        """&scene dimension=2 integrator='explicit' deformation='updated' water='none'
  gravity=0,-9.81 /
&grid spacing=0.5 /
&time end_time=1e7 /
&material name='s' young_modulus=10 poisson_ratio=0.2 porosity=0.3 /
&region name='r' material='s' box_min=0,0 box_max=1,1 /
&output name='r' /
"""
    )
    assert run.status == 1
    message = run.stderr.strip().splitlines()[-1]
    assert "no progress" in message
    speed, time = re.search(r"is the fastest \((\S+) m/s\) .*t = (\S+) s", message).groups()
    assert abs(float(speed) / (9.81 * float(time)) - 1) < 0.01


def test_collapse_on_two_ranks(dosui):
    # no rank is left behind, and the particle is found wherever it is
    runs = dosui(WET), dosui(WET, ranks=2)
    alone, both = (re.findall("error: the steps end .* s: no progress", run.stderr) for run in runs)
    assert runs[1].status == 1
    assert len(alone) == 1
    assert both == alone


def test_a_bad_water_balance_is_said(dosui):
    # a contact of 1 : 1000 ends on the faces of a tilted body whose heads are exact: no net inflow
    head = "min(0.84*z - 0.54*x, 0) + 0.001*max(0.84*z - 0.54*x, 0)"
    faces = [("a", 1), ("a", 2), ("a", 4), ("b", 2), ("b", 3), ("b", 4)]
    surfaces = "".join(
        f"&surface name='{r}{k}' region='{r}' face='edge{k}' /\n"
        f"&hydraulic_condition surface='{r}{k}' kind='head' value=1 formula='{head}' /\n"
        for r, k in faces
    )
    z = 0.54 / 0.84
    run = dosui(
        f"""&scene dimension=2 integrator='quasi_static' /
&grid spacing=0.2 origin=0.013,0.013 /
&time end_time=1e10 relative_tolerance=1e-3 /
&material name='a' rigid=.true. hydraulic_conductivity=1e-7 /
&material name='b' rigid=.true. hydraulic_conductivity=1e-4 /
&region name='a' material='a' shape='polygon' vertices=-1,-1, 1,-1, 1,{z}, -1,{-z} /
&region name='b' material='b' shape='polygon' vertices=-1,{-z}, 1,{z}, 1,1, -1,1 /
{surfaces}&output name='r' /
"""
    )
    assert run.status == 0
    warning = [line for line in run.stderr.splitlines() if "the water balance misses" in line]
    assert len(warning) == 1
    assert "most probably at surface '" in warning[0] or "the contact of 'a' with 'b'" in warning[0]
    assert "DISCHARGES OF THIS RUN ARE NOT TO BE TRUSTED" in run.stdout

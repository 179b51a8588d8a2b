"""What transfers between particles and grid take: nothing that depends on the number of steps."""

from __future__ import annotations

import math
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import Run, Runner

SLOPE = """&scene dimension = 2 deformation = 'updated' integrator = '{integrator}'
  gravity = 0, -9.81 /
&grid spacing = {spacing} domain_min = -1.0, -1.0 domain_max = 60.0, 20.0 /
&time courant = {courant} end_time = {end} {time} /
&material name = 'clay' model = 'mohr_coulomb' young_modulus = 2.0e6 poisson_ratio = 0.3
  cohesion = {cohesion} friction_angle = 0 {softening} {residual}
  porosity = 0.5 hydraulic_conductivity = 1.0e-9 /
&mechanics {mechanics} /
&water bulk_modulus = {water} /
&region name = 'slope' material = 'clay' shape = 'polygon'
  vertices = 0.0, 0.0, 12.0, 0.0, 7.0, 5.0, 0.0, 5.0 /
&surface name = 'air' region = 'slope' face = 'free' /
&hydraulic_condition surface = 'air' kind = 'pressure' value = 0.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 5.0 effective_stress = 'geostatic'
  surface_level = 5.0 lateral_ratio = 0.8 /
&rigid_wall name = 'floor' position = 0.0, 0.0 normal = 0.0, 1.0 kind = 'rough' /
&rigid_wall name = 'back' position = 0.0, 0.0 normal = 1.0, 0.0 /
&probe name = 'q95' kind = 'run_out' position = 0.0, 0.0 direction = 1.0, 0.0 fraction = 0.95 /
&probe name = 'q99' kind = 'run_out' position = 0.0, 0.0 direction = 1.0, 0.0 fraction = 0.99 /
&probe name = 'front' kind = 'run_out' position = 0.0, 0.0 direction = 1.0, 0.0 fraction = 1.0 /
&output name = 'slope' history_interval = 0.1 /
"""
SLOPE_DEFAULTS = {
    "integrator": "explicit",
    "spacing": 1.0,
    "courant": 0.5,
    "time": "",
    "end": 6.0,
    "cohesion": 1.5e4,
    "residual": "residual_cohesion = 1.5e3",
    "softening": "softening_displacement = 0.5",
    "mechanics": "",
    "water": 5.0e7,
}


def slope(**changes: object) -> str:
    """The slope of sensitive clay, 5 m high, that fails and runs out."""
    return SLOPE.format(**(SLOPE_DEFAULTS | changes))


def missing_water(run: Run, name: str) -> float:
    """What is missing in the water balance at the end, over what has been stored [-]."""
    stored, inflow, squeezed = (
        run.history(name, f"water_{kind}")[-1] for kind in ("stored", "inflow", "squeezed")
    )
    return float(abs(stored - inflow - squeezed) / abs(stored))


def test_run_out_does_not_depend_on_the_step(dosui: Runner) -> None:
    """Front and 95 % quantile within 2 % of their middle, for steps and integrators that take 460
    to 5700 steps, where APIC has 24 to 34 m. The long table is
    `tests/verification/run_outs.py`."""
    found = []
    for k, changes in enumerate(
        ({}, {"courant": 0.25}, {"integrator": "semi_implicit"}, {"water": 5.0e6})
    ):
        run = dosui(slope(**changes), folder=str(k))
        assert run.status == 0, run.stderr
        found.append([run.history("slope", key)[-1] for key in ("front", "q95", "q99")])
        assert missing_water(run, "slope") <= 0.01
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    assert ((high - low) / (high + low) <= 0.02).all(), found
    assert (low > [34.0, 25.0, 31.0]).all() and (high < [37.0, 29.0, 35.0]).all()


def test_softening_displacement(dosui: Runner) -> None:
    """The same as the strain of displacement over spacing, bit by bit; it says what that is."""
    runs = [
        dosui(slope(softening=keys, spacing=0.5, time="maximum_steps = 200"), folder=folder)
        for folder, keys in (
            ("one", "softening_displacement = 0.1"),
            ("two", "softening_strain = 0.2"),
        )
    ]
    one, two = (run.fields("slope") for run in runs)
    assert one["plastic_shear_strain"].max() > 0.0
    assert all(np.array_equal(one[key], two[key]) for key in one)
    assert "softening_displacement = 0.1 [m]" in runs[1].stderr
    assert "softening" not in runs[0].stderr
    other = dosui(
        slope(softening="softening_displacement = 0.05", spacing=0.5, time="maximum_steps = 200"),
        folder="other",
    ).fields("slope")
    assert not np.array_equal(one["velocity"], other["velocity"])


SHEARED = """&scene dimension = 2 integrator = 'explicit' water = 'none' gravity = 0.0, 0.0 /
&grid spacing = {spacing} period = 2.0, 0.0 /
&time end_time = 6.0 output_interval = 6.0 /
&material name = 'clay' model = 'mohr_coulomb' young_modulus = 1.0e7 poisson_ratio = 0.25
  cohesion = '10000 - 500*exp(-(z - 4)^2)' friction_angle = 0.0 softening_displacement = 0.4
  residual_cohesion = 2.0e3 softening_width = {width} /
&region name = 'layer' material = 'clay' box_min = 0.0, 0.0 box_max = 2.0, 8.0 /
&surface name = 'base' region = 'layer' face = 'z-' /
&surface name = 'top' region = 'layer' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' kind = 'velocity' value = 0.05, 0.0 /
&mechanics damping = '{damping}' /
&output name = 'layer' history_interval = 0.02 /
"""


def test_softening_width(dosui: Runner) -> None:
    """A layer that slips along its weakest plane resists the same on grids of one and of half the
    width of bands; the same on any ranks. Without means the finer grid is 2 % of the peak off."""

    def sheared(spacing: float, width: float, damping: str = "local", ranks: int = 1) -> Run:
        text = SHEARED.format(spacing=spacing, width=width, damping=damping)
        run = dosui(text, folder=f"{spacing}_{width}_{damping}_{ranks}", ranks=ranks)
        assert run.status == 0, run.stderr
        return run

    def stress(run: Run) -> np.ndarray:
        time = run.history("layer", "time")
        force = -run.history("layer", "reaction_base_x") / 2.0
        return np.array([force[np.argmin(np.abs(time - t))] for t in (2.0, 4.0, 6.0)])

    coarse, fine, local = (sheared(*case) for case in ((1.0, 1.0), (0.5, 1.0), (0.5, 0.0)))
    assert np.abs(stress(fine) - stress(coarse)).max() <= 0.012 * 1.0e4
    assert np.abs(stress(local) - stress(coarse)).max() >= 0.02 * 1.0e4
    # the slip, v t less what is elastic, of the displacement that softens
    left = 1.0 - (0.2 - 8.0 * stress(coarse)[1] / 4.0e6) / 0.4
    assert stress(coarse)[1] == pytest.approx(2.0e3 + 7.5e3 * left, rel=0.1)
    assert "mean_plastic_shear_strain" not in local.fields("layer")
    # local damping takes signs of forces that vanish, which no two ranks agree on
    one, three = (sheared(0.5, 1.0, "viscous", ranks).fields("layer") for ranks in (1, 3))
    for name in ("effective_stress", "mean_plastic_shear_strain", "plastic_shear_strain"):
        assert np.abs(one[name] - three[name]).max() <= 1e-11 * np.abs(one[name]).max()
    assert one["mean_plastic_shear_strain"].max() < 0.9 * one["plastic_shear_strain"].max()


DISCS = """&scene dimension = 2 water = 'none' deformation = 'updated' /
&grid spacing = 0.2 /
&time end_time = 2.0 /
&material name = 'a' young_modulus = 1.0e5 poisson_ratio = 0.3 /
&material name = 'b' young_modulus = 1.0e7 poisson_ratio = 0.3 /
&region name = 'a' material = 'a' shape = 'circle' centre = -1.13, 0.5 radius = 1.0
  velocity = 1.0, 0.0 jitter = 0.2 /
&region name = 'b' material = 'b' shape = 'circle' centre = 1.12, -0.5 radius = 1.0
  velocity = -1.0, 0.0 jitter = 0.2 /
&rigid_wall name = 'far' position = 0.0, -50.0 normal = 0.0, 1.0 /
&mechanics {mechanics} /
&output name = 'discs' history_interval = 0.01 /
"""


def turning(fields: dict[str, np.ndarray]) -> float:
    """Angular momentum about the origin, per mass of a particle [m2/s]."""
    x, v = fields["points"], fields["velocity"]
    return float((x[:, 2] * v[:, 0] - x[:, 0] * v[:, 2]).sum())


def test_soils_of_different_stiffness(dosui: Runner) -> None:
    """A soft and a stiff disc meet off their centres: momentum to round-off, although every
    particle has its own time of the filter, angular momentum within 1 %, energy that only falls,
    the same on three ranks."""
    one = dosui(DISCS.format(mechanics=""), folder="one")
    three = dosui(DISCS.format(mechanics=""), ranks=3, folder="three")
    assert one.status == 0 and three.status == 0, three.stderr
    a, b = one.fields("discs"), three.fields("discs")
    for name in ("displacement", "velocity", "effective_stress"):
        assert np.abs(a[name] - b[name]).max() <= 1e-11 * np.abs(a[name]).max()
    mass, energy = one.history("discs", "mass")[0], one.history("discs", "kinetic_energy")
    for axis in "xz":
        momentum, lost = (one.history("discs", f"{k}_{axis}") for k in ("momentum", "impulse_lost"))
        assert np.abs(momentum - momentum[0] - lost).max() <= 1e-12 * mass
        assert np.abs(lost).max() <= 1e-5 * mass  # at nodes that hardly have mass
    start = one.fields("discs", 0)
    assert abs(turning(a) / turning(start) - 1.0) <= 1e-2
    assert energy.max() <= energy[0] * (1 + 1e-9) and energy.min() < 0.4 * energy[0]


BALLS = """&scene dimension = 3 water = 'none' deformation = 'updated' /
&grid spacing = 0.25 /
&time end_time = 2.0 /
&material name = 's' young_modulus = 1.0e5 poisson_ratio = 0.3 /
&region name = 'a' material = 's' shape = 'sphere' centre = -1.13, 0.0, 0.5 radius = 1.0
  velocity = 1.0, 0.0, 0.0 jitter = 0.2 /
&region name = 'b' material = 's' shape = 'sphere' centre = 1.12, 0.0, -0.5 radius = 1.0
  velocity = -1.0, 0.0, 0.0 jitter = 0.2 /
&rigid_wall name = 'far' position = 0.0, 0.0, -50.0 normal = 0.0, 0.0, 1.0 /
&output name = 'balls' checkpoint_at_outputs = .true. /
"""


def angular_momenta(path: Path, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Of a checkpoint: of the particles' velocities about the origin, and of their affine fields
    about themselves, C D with GIMP's second moments D (docs/theory/skeleton.md) [kg m2/s]."""
    with h5py.File(path) as file:
        x, v, c, mass = (
            file[f"particles/field_{key}"][()] for key in ("position", "velocity", "affine", "mass")
        )
    s, half = np.abs(x / spacing - np.round(x / spacing)), 0.25
    moment = np.where(s >= half, s * (1 - s), (s**2 + half**2) / (2 * half) - s**2) * spacing**2
    b = np.einsum("p,pba,pb->ab", mass, c.reshape(-1, 3, 3), moment)  # sum m v_a r_b
    orbital = (mass[:, None] * np.cross(x, v)).sum(axis=0)
    return orbital, np.array([b[2, 1] - b[1, 2], b[0, 2] - b[2, 0], b[1, 0] - b[0, 1]])


def test_balls_that_meet(dosui: Runner) -> None:
    """Two balls meet off their centres: their angular momentum within 2e-3, of which 2-3 % of the
    orbital one become the particles' own. Without that the balance would be so much off."""
    run = dosui(BALLS)
    assert run.status == 0, run.stderr
    paths = sorted(run.folder.glob("balls.restart.*.h5"))
    (orbital, own), (orbital_end, own_end) = (
        angular_momenta(path, 0.25) for path in (paths[0], paths[-1])
    )
    size = np.linalg.norm(orbital)
    assert np.abs(orbital_end + own_end - orbital - own).max() <= 2e-3 * size
    assert 1e-2 * size <= np.abs(orbital_end - orbital).max() <= 4e-2 * size


def test_time_of_the_filter(dosui: Runner) -> None:
    """None at all is APIC, whether one time holds for all or nodes have theirs; the times that
    soils have by themselves lie between that and FLIP's noise."""
    text = DISCS.replace("end_time = 2.0", "end_time = 0.6")
    keys = {
        "apic": "transfer = 'apic'",
        "none": "filter_time = 1.0e-9",
        "own": "",
        "long": "filter_time = 10.0",
    }
    ends = {key: dosui(text.format(mechanics=value), folder=key) for key, value in keys.items()}
    velocity = {key: run.fields("discs")["velocity"] for key, run in ends.items()}
    assert np.abs(velocity["none"] - velocity["apic"]).max() <= 1e-12
    apart = {key: np.abs(velocity[key] - velocity["apic"]).max() for key in ("own", "long")}
    assert 1e-3 < apart["own"] < apart["long"]


def test_turning_disc(dosui: Runner) -> None:
    """A disc of jittered particles, half a turn: angular momentum within 1e-3, energy 2 %."""
    run = dosui(
        f"""&scene dimension = 2 water = 'none' deformation = 'updated' /
&grid spacing = 0.2 /
&time end_time = {math.pi} /
&material name = 's' young_modulus = 1.0e6 poisson_ratio = 0.3 /
&region name = 'disc' material = 's' shape = 'circle' centre = 0.03, 0.02 radius = 1.0
  spin = 1.0 jitter = 0.2 /
&output name = 'disc' history_interval = 0.1 /
"""
    )
    assert run.status == 0, run.stderr
    assert abs(turning(run.fields("disc")) / turning(run.fields("disc", 0)) - 1.0) <= 1e-3
    energy = run.history("disc", "kinetic_energy")
    assert energy.max() <= 1.001 * energy[0] and energy[-1] >= 0.98 * energy[0]


BAR = """&scene dimension = 1 water = 'none' deformation = 'updated' /
&grid spacing = 0.05 /
&time end_time = {end!r} courant = {courant} /
&material name = 's' young_modulus = 1.0e6 poisson_ratio = 0.0 /
&region name = 'bar' material = 's' box_min = 0.0 box_max = 1.0 jitter = 0.2
  particles_per_cell = 2 /
&initial_state mode_number = {mode} mode_amplitude = {amplitude!r} /
&surface name = 'base' region = 'bar' face = 'z-' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanics transfer = '{transfer}' /
&output name = 'bar' history_interval = {interval!r} /
"""


def test_vibrating_bar(dosui: Runner) -> None:
    """Twenty periods of the first mode of 20 jittered cells: frequency within 1e-3, 1e-3 of the
    energy lost whatever the step; APIC loses more the smaller it is."""
    period = 4.0 / math.sqrt(1.0e6 / (2650.0 * 0.7))
    lost = {}
    for transfer in ("aflip", "apic"):
        for courant in (0.5, 0.1):
            run = dosui(
                BAR.format(
                    end=20 * period,
                    courant=courant,
                    mode=1,
                    amplitude=0.004 * 2 * math.pi / period,
                    transfer=transfer,
                    interval=period / 200,
                ),
                folder=f"{transfer}{courant}",
            )
            assert run.status == 0, run.stderr
            time, energy = run.history("bar", "time"), run.history("bar", "kinetic_energy")
            peaks = [
                energy[(time >= k * period / 2) & (time < (k + 1) * period / 2)].max()
                for k in range(40)
            ]
            lost[transfer, courant] = 1.0 - np.mean(peaks[-2:]) / peaks[1]
            top = [
                k
                for k in range(1, len(energy) - 1)
                if energy[k] > max(energy[k - 1], 0.5 * energy[0]) and energy[k] >= energy[k + 1]
            ]
            measured = 2 * (time[top[-1]] - time[top[0]]) / (len(top) - 1)
            assert measured == pytest.approx(period, rel=1e-3)
    assert abs(lost["aflip", 0.5]) <= 1e-3 and abs(lost["aflip", 0.1]) <= 1e-3
    assert lost["apic", 0.1] > 5 * lost["apic", 0.5] > 0.0


def test_higher_modes_of_a_bar(dosui: Runner) -> None:
    """Twenty periods of the second and third mode of 20 jittered cells: frequency within 3e-3, what
    AFLIP takes does not grow as steps get smaller, and is the mode's own: 1e-3, 6e-3."""
    wave = math.sqrt(1.0e6 / (2650.0 * 0.7))
    for mode, most in ((2, 1.2e-3), (3, 8.5e-3)):
        pulsation = math.pi * (mode - 0.5) * wave
        period = 2 * math.pi / pulsation
        lost = []
        for courant in (0.5, 0.25, 0.1):
            run = dosui(
                BAR.format(
                    end=20 * period,
                    courant=courant,
                    mode=mode,
                    amplitude=0.002 * pulsation,
                    transfer="aflip",
                    interval=period / 100,
                ),
                folder=f"{mode}_{courant}",
            )
            assert run.status == 0, run.stderr
            time, energy = run.history("bar", "time"), run.history("bar", "kinetic_energy")
            swing = []  # of the kinetic energy in each period: A cos(2 w t) + B sin(2 w t)
            for k in range(20):
                of = (time >= k * period) & (time < (k + 1) * period)
                angle = 2 * pulsation * time[of]
                terms = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
                swing.append(np.linalg.lstsq(terms, energy[of], rcond=None)[0] @ [0, 1, -1j])
            turned = np.polyfit(np.arange(20) * period, np.unwrap(np.angle(swing)), 1)[0]
            assert abs(turned) <= 3e-3 * 2 * pulsation
            lost.append(1.0 - abs(swing[-1]) / abs(swing[0]))
        assert most >= lost[0] > lost[1] > lost[2] > 0.0
        assert lost[1] - lost[2] <= 0.5 * (lost[0] - lost[2])  # at least in proportion to dt


def test_run_out_of_a_block(dosui: Runner) -> None:
    """A block of length L has f L: along x, against it, and of the horizontal distance; the same on
    three ranks. Heavy ends count by their mass."""
    text = """&scene dimension = 2 water = 'none' deformation = 'updated' /
&grid spacing = 0.5 /
&time end_time = 1.0 maximum_steps = 3 /
&material name = 'a' young_modulus = 1.0e6 poisson_ratio = 0.3 porosity = 0.5
  solid_density = 1000 /
&material name = 'b' young_modulus = 1.0e6 poisson_ratio = 0.3 porosity = 0.5
  solid_density = 3000 /
&region name = 'a' material = 'a' box_min = 0.0, 0.0 box_max = 3.0, 1.0 /
&region name = 'b' material = 'b' box_min = 3.0, 0.0 box_max = 4.0, 1.0 /
&probe name = 'right' kind = 'run_out' position = 0.0, 0.0 direction = 2.0, 0.0 fraction = 0.9 /
&probe name = 'left' kind = 'run_out' position = 4.0, 0.0 direction = -1.0, 0.0 fraction = 0.9 /
&probe name = 'all' kind = 'run_out' position = 1.0, 7.0 direction = 1.0, 0.0 fraction = 1.0 /
&probe name = 'around' kind = 'run_out' position = 0.0, 5.0 fraction = 0.5 /
&output name = 'block' /
"""
    for ranks in (1, 3):
        run = dosui(text, ranks=ranks, folder=str(ranks))
        assert run.status == 0, run.stderr
        found = [run.history("block", key)[-1] for key in ("right", "left", "all", "around")]
        assert found == pytest.approx([3.8, 3.4, 3.0, 3.0], rel=1e-10)
    assert run.status == 0 and "run-out of 90 % of the mass" in run.stdout


def test_refusals_and_warnings(dosui: Runner) -> None:
    """Steps that tear tips apart, keys that exclude each other, transfers that eat run-outs."""
    for changes, complaint in (
        ({"courant": 0.7}, r":4: &time courant = 0.7: .* take courant = 0.65 or less"),
        (
            {"softening": "softening_displacement = 0.1 softening_strain = 0.2"},
            r":6: &material softening_strain = 0.2: does not go with softening_displacement",
        ),
        (
            {"mechanics": "transfer = 'apic' filter_time = 0.1"},
            r":8: &mechanics filter_time = 0.1: has a meaning only with transfer = 'aflip'",
        ),
    ):
        run = dosui(slope(**changes), "--check")
        assert run.status == 2 and re.search(complaint, run.stderr), run.stderr
    run = dosui(slope(courant=0.7, integrator="semi_implicit"), "--check")
    assert run.status == 0 and "warning" not in run.stderr
    run = dosui(slope(mechanics="transfer = 'apic'"), "--check")
    assert "&mechanics transfer = 'apic' damps with every step" in run.stderr
    run = dosui(slope(mechanics="filter_time = 0.1").replace("updated", "small_strain"), "--check")
    assert run.status == 2 and "which deformation = 'updated' takes" in run.stderr

"""Properties of soils that are formulas of place, against integrals over the depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run, Runner

HEIGHT, LOAD, POROSITY, UNIT_WEIGHT = 10.0, 1.0e4, 0.3, 9810.0
YOUNG = "1e6 + 2e5*(10 - z)"
POISSON = 0.25
CONFINED = (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))  # M/E


def young(z: np.ndarray) -> np.ndarray:
    """The formula above [Pa]."""
    return 1.0e6 + 2.0e5 * (10.0 - z)


def column(
    material: str,
    scene: str = "",
    time: str = "",
    more: str = "",
    spacing: float = 0.25,
    load: float = LOAD,
    origin: float = 0.0,
) -> str:
    """A 1-D column under a load."""
    return f"""
&scene dimension = 1 integrator = 'quasi_static' water = 'none' {scene} /
&grid spacing = {spacing} /
&time end_time = 1.0 {time} /
&material name = 'soil' {material} /
&region name = 'column' material = 'soil' box_min = {origin} box_max = {origin + HEIGHT}
  particles_per_cell = 2 /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {load} /
&probe name = 'settlement' kind = 'settlement' surface = 'top' /
{more}
&output name = 'column' /
"""


def settled(run: Run) -> float:
    """The last settlement of the top [m]."""
    assert run.status == 0, run.stdout + run.stderr
    return float(run.history("column", "settlement")[-1])


def exact_settlement(load: float = LOAD) -> float:
    """Integral of q dz/M: M is linear in the depth [m]."""
    return load / (2.0e5 * CONFINED) * np.log(young(np.array(0.0)) / young(np.array(HEIGHT)))


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize("model", ["linear_elastic", "mohr_coulomb", "drucker_prager"])
def test_settlement_of_a_column_that_stiffens(dosui: Runner, model: str, ranks: int) -> None:
    """1e-4 of the integral, whatever the model that does not yield."""
    strength = "" if model == "linear_elastic" else "cohesion = '1e6 + 1e4*z'"
    material = f"model = '{model}' {strength} young_modulus = '{YOUNG}' poisson_ratio = {POISSON}"
    run = dosui(column(material), ranks=ranks)
    assert settled(run) == pytest.approx(exact_settlement(), rel=1e-4)
    fields = run.fields("column")
    np.testing.assert_allclose(fields["young_modulus"], young(fields["points"][:, 2]), rtol=1e-12)


@pytest.mark.parametrize("scene", ["deformation = 'finite'", "integrator = 'explicit'"])
def test_other_formulations(dosui: Runner, scene: str) -> None:
    """Finite strains at 1e-5 of strain, and steps with inertia that are damped."""
    material = f"young_modulus = '{YOUNG}' poisson_ratio = {POISSON}"
    text = column(material, load=10.0, spacing=0.5)
    text = text.replace("integrator = 'quasi_static'", "integrator = 'quasi_static' " + scene, 1)
    if "explicit" in scene:
        text = text.replace("integrator = 'quasi_static' ", "", 1)
        text = text.replace("end_time = 1.0", "end_time = 30.0")
        text += "&mechanics damping = 'fading' /\n"
    assert settled(dosui(text)) == pytest.approx(exact_settlement(10.0), rel=1e-3)


@pytest.mark.parametrize("in_file", [False, True])
def test_settlement_with_a_table_of_the_stiffness(
    dosui: Runner, tmp_path: Path, in_file: bool
) -> None:
    """A straight line between two entries of a table is the formula."""
    entries = "arguments = 0, 10 values = 3e6, 1e6"
    if in_file:
        (tmp_path / "stiffness.csv").write_text("# z [m], E [Pa]\n0, 3e6\n10, 1e6\n")
        entries = "file = 'stiffness.csv'"
    text = column(
        f"young_modulus = 'stiffness(z)' poisson_ratio = {POISSON}",
        more=f"&table name = 'stiffness' {entries} /",
    )
    run = dosui(text, ranks=1 + in_file)
    assert settled(run) == pytest.approx(exact_settlement(), rel=1e-4)
    assert "no formula calls" not in run.stdout


def random_stiffness(rng: np.random.Generator, low: float, high: float) -> tuple[str, str, Any]:
    """A formula of z, the tables that it calls, and the same as a function of z [Pa]."""
    mean = 10 ** rng.uniform(5, 8)
    ratio = rng.uniform(0.1, 0.9)
    wave = rng.uniform(0.5, 2.0)
    middle, height = 0.5 * (low + high), high - low
    z = np.sort(rng.uniform(low, high, rng.integers(2, 7)))
    e = mean * rng.uniform(0.3, 3.0, z.size)
    table = "&table name = 'e_of_z' arguments = {} values = {} /".format(
        ", ".join(f"{x:.17g}" for x in z), ", ".join(f"{x:.17g}" for x in e)
    )
    place = f"(z - ({middle!r}))/{height!r}"
    choices: list[tuple[str, str, Any]] = [
        (
            f"{mean!r}*(1 + {ratio!r}*2*{place})",
            "",
            lambda x: mean * (1 + ratio * 2 * (x - middle) / height),
        ),
        (
            f"{mean!r}*exp({2 * ratio!r}*{place})",
            "",
            lambda x: mean * np.exp(2 * ratio * (x - middle) / height),
        ),
        (
            f"{mean!r}/(1 + {ratio!r}*sin(2*pi*{wave!r}*{place}))",
            "",
            lambda x: mean / (1 + ratio * np.sin(2 * np.pi * wave * (x - middle) / height)),
        ),
        ("E_of_z(z)", table, lambda x: np.interp(x, z, e)),
        (
            f"max(e_of_z(z), {mean!r}) + abs({mean * ratio!r}*{place})",
            table,
            lambda x: (
                np.maximum(np.interp(x, z, e), mean) + np.abs(mean * ratio * (x - middle) / height)
            ),
        ),
    ]
    return choices[rng.integers(len(choices))]


@pytest.mark.parametrize("seed", range(12))
def test_random_columns(dosui: Runner, seed: int) -> None:
    """Formulas and tables of any of these kinds, sizes, places, particles a cell and ranks."""
    rng = np.random.default_rng(seed)
    height = rng.uniform(0.5, 50.0)
    low = float(rng.choice([0.0, rng.uniform(-100, 100), rng.uniform(1e3, 1e5)]))
    formula, table, stiffness = random_stiffness(rng, low, low + height)
    poisson = rng.uniform(0.0, 0.45)
    confined = (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    load = 1e-3 * float(stiffness(np.array(low + 0.5 * height)))
    text = f"""&scene dimension = 1 integrator = 'quasi_static' water = 'none' /
&grid spacing = {height / 80!r} origin = {low!r} /
&time end_time = 1.0 /
{table}
&material name = 'soil' young_modulus = "{formula}" poisson_ratio = {poisson!r} /
&region name = 'column' material = 'soil' box_min = {low!r} box_max = {low + height!r}
  particles_per_cell = {rng.integers(1, 4)} /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'top' kind = 'pressure' value = {load!r} /
&probe name = 'settlement' kind = 'settlement' surface = 'top' /
&output name = 'column' /
"""
    z = low + height * (np.arange(200000) + 0.5) / 200000
    exact = load * height * np.mean(1.0 / (confined * stiffness(z)))
    assert settled(dosui(text, ranks=int(rng.integers(1, 4)))) == pytest.approx(exact, rel=1e-3)


def test_one_hydrograph_for_several_conditions(dosui: Runner) -> None:
    """A named table of time is the table of factors of each condition that calls it."""
    times, factors = "0, 0.2, 0.7", "0, 1, 0.3"
    conditions = """&hydraulic_condition surface = 'base' kind = 'no_flow' /
&hydraulic_condition surface = 'top' kind = 'head' value = 12 {0} /
&water bulk_modulus = 2e7 /
"""
    material = "young_modulus = 1e6 hydraulic_conductivity = 1e-2"
    own = f"factor_times = {times} factor_values = {factors}"
    histories = []
    for factor, more in [
        (own, ""),
        ("formula = 'flood(t)'", f"&table name = 'flood' arguments = {times} values = {factors} /"),
    ]:
        text = column(material, more=conditions.format(factor) + more, spacing=0.5)
        text = text.replace("water = 'none'", "water = 'coupled'")
        text = text.replace(f"value = {LOAD}", f"value = {LOAD} {factor}")
        run = dosui(text)
        histories.append((run.history("column", "time"), run.history("column", "settlement")))
    np.testing.assert_array_equal(histories[0][0], histories[1][0])  # both step onto its corners
    np.testing.assert_allclose(histories[0][1], histories[1][1], rtol=1e-12)
    for corner in (0.2, 0.7):
        assert np.abs(histories[1][0] / corner - 1).min() < 1e-9


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("name = 'f'", "needs arguments and values, or a file"),
        ("name = 'f' arguments = 0, 1", "belong together"),
        ("name = 'f' arguments = 0, 0 values = 1, 2", "must increase strictly"),
        ("name = 'f' arguments = 0, 1 values = 1", "needs as many values"),
        ("name = 'sin' arguments = 0, 1 values = 1, 2", "no function or variable"),
        ("name = 'z' arguments = 0, 1 values = 1, 2", "no function or variable"),
        ("name = '2f' arguments = 0, 1 values = 1, 2", "must be a letter"),
        ("name = 'f g' arguments = 0, 1 values = 1, 2", "must be a letter"),
        ("name = 'f' arguments = 0, nan values = 1, 2", "number"),
        ("name = 'f' file = 'missing.csv'", "missing.csv"),
        ("name = 'f' file = 'scene.nml' arguments = 0 values = 1", "no meaning beside file"),
        ("name = 'F' arguments = 0 values = 1 / &table name = 'f' file = 'f'", "taken already"),
    ],
)
def test_tables_that_are_none(dosui: Runner, table: str, reason: str) -> None:
    """Refused with the line of the group or key."""
    text = column("young_modulus = 'f(z)'", more=f"&table {table} /")
    run = dosui(text, "--check")
    assert run.status == 2
    assert reason in run.stderr, run.stderr
    assert "&table" in run.stderr


def test_a_table_that_nothing_calls(dosui: Runner) -> None:
    """A warning names it."""
    text = column("young_modulus = 1e6", more="&table name = 'f' arguments = 0, 1 values = 1, 2 /")
    run = dosui(text, "--check")
    assert run.status == 0, run.stderr
    assert "no formula calls it" in run.stdout + run.stderr


def test_far_from_the_origin(dosui: Runner) -> None:
    """Formulas see the user's coordinates, also where a scene has a local origin."""
    far = 4.0e6
    material = f"young_modulus = '1e6 + 2e5*({far + HEIGHT} - z)' poisson_ratio = {POISSON}"
    run = dosui(
        column(material, origin=far, more=f"! {far}").replace("&grid ", f"&grid origin = {far} ")
    )
    assert settled(run) == pytest.approx(exact_settlement(), rel=1e-4)


def test_undrained_pressures(dosui: Runner) -> None:
    """u = q (K_w/n)/(M + K_w/n) at each depth, with a porosity that varies, too."""
    porosity = "0.3 + 0.01*z"
    material = (
        f"young_modulus = '{YOUNG}' poisson_ratio = {POISSON} porosity = '{porosity}' "
        "hydraulic_conductivity = 1e-20"
    )
    text = column(material, time="undrained_start = .true.", more="&water bulk_modulus = 5e6 /")
    run = dosui(text.replace("water = 'none'", "water = 'coupled'"))
    assert run.status == 0, run.stdout + run.stderr
    fields = run.fields("column", 0)
    z = fields["points"][:, 2]
    water = 5e6 / (0.3 + 0.01 * z)
    exact = LOAD * water / (CONFINED * young(z) + water)
    assert np.abs(fields["pore_pressure"] / exact - 1).max() <= 2e-3
    np.testing.assert_allclose(fields["porosity"], 0.3 + 0.01 * z, rtol=1e-3)


def test_steady_flow_through_conductivity_that_grows(dosui: Runner) -> None:
    """q is the same everywhere: the head falls by q dz/k."""
    text = column(
        "rigid = .true. hydraulic_conductivity = '1e-6*(1 + z)'",
        spacing=0.125,
        more="""&hydraulic_condition surface = 'base' kind = 'head' value = 12 /
&hydraulic_condition surface = 'top' kind = 'head' value = 10 /""",
    ).replace("water = 'none'", "water = 'coupled' gravity = -9.81")
    lines = [
        line
        for line in text.splitlines()
        if not line.startswith(("&mechanical_condition", "&probe"))
    ]
    run = dosui("\n".join(lines).replace("end_time = 1.0", "end_time = 1e9"))
    assert run.status == 0, run.stdout + run.stderr
    fields = run.fields("column")
    z = fields["points"][:, 2]
    exact = 12.0 - 2.0 * np.log(1 + z) / np.log(1 + HEIGHT)
    assert np.abs(fields["head"] - exact).max() <= 1e-3 * 2.0
    flow = 1e-6 * 2.0 / np.log(1 + HEIGHT)
    # surfaces have the conductivity of the particle beside them: first order there
    error = np.abs(fields["darcy_velocity"][:, 2] / flow - 1)
    assert error.max() <= 3e-2
    assert error[(z > 1.0) & (z < 9.0)].max() <= 3e-3


def test_geostatic_start_with_density_that_grows(dosui: Runner) -> None:
    """Stresses carry the weight of what lies above."""
    text = column(
        f"young_modulus = '{YOUNG}' poisson_ratio = {POISSON} solid_density = '3000 - 50*z'",
        scene="gravity = -9.81",
        time="geostatic_start = .true.",
        load=0.0,
        spacing=0.125,
    )
    run = dosui(text)
    assert run.status == 0, run.stdout + run.stderr
    fields = run.fields("column")
    z = fields["points"][:, 2]
    weight = 0.7 * 9.81 * (3000 * (HEIGHT - z) - 25 * (HEIGHT**2 - z**2))
    assert np.abs(fields["effective_stress"][:, 2] + weight).max() <= 5e-3 * weight.max()


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ("young_modulus = '1e6*(z - 5)'", "young_modulus = '1e6*(z - 5)': is -"),
        ("young_modulus = '1e6*(z'", "column 5"),
        ("young_modulus = '1e6*q'", "unknown"),
        ("young_modulus = '-1e6'", "must be a number, without quotes"),
        ("young_modulus = '2*(-1e6)'", "must be > 0"),
        ("young_modulus = 1e6 porosity = '0.2*z'", "must be > 0 and < 1"),
        ("young_modulus = 1e6 solid_density = 'log(z - 5)'", "is nan at"),
    ],
)
def test_formulas_that_cannot_be(dosui: Runner, material: str, message: str) -> None:
    """Refused with the line, the place and the range."""
    run = dosui(column(material))
    assert run.status != 0
    assert message in run.stdout + run.stderr


def gibson(spacing: float, half_width: float = 1.0, size: float = 40.0) -> str:
    """Half of a strip load on soil whose shear modulus is m times the depth."""
    return f"""
&scene dimension = 2 integrator = 'quasi_static' water = 'none' /
&grid spacing = {spacing} /
&time end_time = 1.0 /
&material name = 'soil' young_modulus = '2*(1 + 0.495)*1e5*({size} - z)' poisson_ratio = 0.495 /
&region name = 'box' material = 'soil' box_min = 0, 0 box_max = {size}, {size}
  particles_per_cell = 2 /
&surface name = 'base' region = 'box' face = 'z-' /
&surface name = 'left' region = 'box' face = 'x-' /
&surface name = 'right' region = 'box' face = 'x+' /
&surface name = 'strip' region = 'box' face = 'z+' box_max(1) = {half_width} /
&surface name = 'beside' region = 'box' face = 'z+' box_min(1) = {4 * half_width}
  box_max(1) = {8 * half_width} /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'strip' kind = 'pressure' value = {LOAD} /
&probe name = 'settlement' kind = 'settlement' surface = 'strip' /
&probe name = 'beside' kind = 'settlement' surface = 'beside' /
&output name = 'column' /
"""


def test_gibson(dosui: Runner) -> None:
    """Gibson (1967): without volume change the loaded strip settles by q/(2 m), the rest does not.

    On a box 20 widths wide and deep: within 5 % under the load, at most 5 % of it beside.
    """
    run = dosui(gibson(1 / 3))  # 7.1, 3.8, 1.9 % with 2, 3, 4 cells under half of the strip
    exact = LOAD / (2 * 1e5)
    assert settled(run) == pytest.approx(exact, rel=0.05)
    assert abs(run.history("column", "beside")[-1]) <= 0.05 * exact

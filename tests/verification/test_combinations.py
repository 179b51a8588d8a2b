"""Every line of the table of what works with what (`dosui --combinations`): what it refuses is
refused at the key it names, for its reason; what it allows runs to a right value."""

from __future__ import annotations

import functools
import math
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from conftest import BIN, Run, Runner

MODULUS, POROSITY, SOLID, FLUID = 1.0e6, 0.4, 2500.0, 1000.0  # Pa, -, kg/m3, kg/m3
WATER, UNIT_WEIGHT, CONDUCTIVITY = 4.0e5, 1.0e4, 0.05  # Pa, N/m3, m/s
LOAD, HEIGHT, SPACING, GRAVITY = 1.0e3, 1.0, 0.1, 10.0  # Pa, m, m, m/s2
DOWNHILL = (0.5 * GRAVITY, -GRAVITY * math.cos(math.pi / 6))  # towards a wall of 30 degrees


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    feature: str
    integrator: str
    deformation: str
    group: str
    key: str
    reason: str  # of a refusal; empty: it works

    @property
    def name(self) -> str:
        return f"{self.feature.replace(' ', '_')}-{self.integrator}-{self.deformation}"


@functools.cache
def table() -> list[Row]:
    """What the program says of itself."""
    command = [str(BIN / "dosui1d"), "--combinations"]
    text = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    head, *lines = text.splitlines()
    assert head.split("\t") == ["feature", "integrator", "deformation", "group", "key", "reason"]
    return [Row(*line.split("\t")) for line in lines]


@dataclass(frozen=True)
class Case:
    """A column of soil on a roller, drained and loaded at its top, that asks for a feature."""

    check: Callable[[Case, Run], None]
    integrator: str = ""
    deformation: str = ""
    is_wet: bool = True
    dimension: int = 1
    end: float = 1.25  # s
    is_damped: bool = True
    box: str = ""
    conductivity: float = CONDUCTIVITY
    soil: str = f"young_modulus = {MODULUS}"
    poisson_ratio: float = 0.0
    load: float = LOAD
    more: dict[str, str] = field(default_factory=dict)  # keys of groups
    base: str = "&mechanical_condition surface = 'base' kind = 'roller' {imposition} /"
    top: str = "&mechanical_condition surface = 'top' kind = 'pressure' value = {load} /"
    water: str = "&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /"
    groups: str = ""

    @property
    def density(self) -> float:
        """Of grains and water [kg/m3]."""
        return (1 - POROSITY) * SOLID + self.is_wet * POROSITY * FLUID

    @property
    def undrained_modulus(self) -> float:
        """Of one-dimensional strains [Pa]."""
        return MODULUS + self.is_wet * WATER / POROSITY

    def text(self) -> str:
        """The namelist."""
        groups = "scene grid time soil mechanics water region mechanical_condition"
        more = dict.fromkeys(groups.split(" "), "")
        if self.is_damped and self.integrator != "quasi_static":
            more["mechanics"] = "damping = 'viscous' damping_coefficient = 30.0"
        more |= self.more
        flow = f"hydraulic_conductivity = {self.conductivity}" if self.is_wet else ""
        box = self.box or f"box_max = {HEIGHT}"
        imposition = more["mechanical_condition"]
        wet = f"""
&water bulk_modulus = {WATER} unit_weight = {UNIT_WEIGHT} density = {FLUID} {more["water"]} /
{self.water}"""
        return f"""
&scene dimension = {self.dimension} water = '{"coupled" if self.is_wet else "none"}'
  integrator = '{self.integrator}' deformation = '{self.deformation}' {more["scene"]} /
&grid spacing = {SPACING} {more["grid"]} /
&time end_time = {self.end} {more["time"]} /
&material name = 's' {self.soil} poisson_ratio = {self.poisson_ratio}
  porosity = {POROSITY} solid_density = {SOLID} {flow} {more["soil"]} /
&mechanics {more["mechanics"]} /
&region name = 'r' material = 's' box_min = {self.dimension}*0.0 {box} {more["region"]} /
&surface name = 'base' region = 'r' face = 'z-' /
&surface name = 'top' region = 'r' face = 'z+' /
{self.base.format(imposition=imposition)}
{self.top.format(load=self.load, imposition=imposition)}
{wet if self.is_wet else ""}
{self.groups}
&output name = 'r' /
"""


def slope(data: dict[str, np.ndarray], values: np.ndarray) -> float:
    """Of values that grow with the height."""
    return float(np.polyfit(data["points"][:, 2], values, 1)[0])


def carries_its_load(case: Case, run: Run) -> None:
    """Drained, the skeleton alone: the stress by statics, the strain by Hooke's law."""
    data = run.fields("r")
    assert data["effective_stress"][:, 2] == pytest.approx(-case.load, rel=2e-3)
    nu = case.poisson_ratio
    modulus = MODULUS * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    assert slope(data, data["displacement"][:, 2]) == pytest.approx(-LOAD / modulus, rel=5e-3)


def carries_its_load_as_sand(case: Case, run: Run) -> None:
    """The stress by statics, after a step of load from the initial state."""
    assert run.fields("r")["effective_stress"][:, 2] == pytest.approx(-case.load, rel=1e-3)


def seeps(case: Case, run: Run) -> None:
    """Darcy's law, 1 m of head on 1 m."""
    assert run.fields("r")["darcy_velocity"][:, 2] == pytest.approx(CONDUCTIVITY, rel=1e-3)


def rests_under_suction(case: Case, run: Run) -> None:
    """Hydrostatic pressure about a level in the middle, and van Genuchten's saturation."""
    data = run.fields("r")
    head = 0.5 - data["points"][:, 2]
    assert data["pore_pressure"] == pytest.approx(UNIT_WEIGHT * head, abs=1e-3 * UNIT_WEIGHT)
    exact = (1 + (2.0 * np.maximum(-head, 0.0)) ** 2) ** -0.5
    assert data["saturation"] == pytest.approx(exact, abs=1e-3)


def seeps_through_less(case: Case, run: Run) -> None:
    """Darcy's law with Kozeny's and Carman's conductivity of the porosity after compression."""
    head = 0.05  # m, at the base; half of its pressure is carried by the water in the middle
    strain = (case.load - 0.5 * head * UNIT_WEIGHT) / MODULUS
    volume = np.exp(-strain)
    if case.deformation == "finite":  # stress per present area: ln(J)/J
        for _ in range(50):
            volume = np.exp(-strain * volume)
    porosity = 1 - (1 - POROSITY) / volume
    ratio = (porosity / POROSITY) ** 3 * ((1 - POROSITY) / (1 - porosity)) ** 2
    speed = CONDUCTIVITY * ratio * head / (HEIGHT * volume)
    assert ratio < 0.8
    middle = run.fields("r")["darcy_velocity"][5:-5, 2].mean()
    assert middle == pytest.approx(speed, rel=2e-2)  # 1.2 %, 0.5 % on half the spacing


def keeps_two_heads(case: Case, run: Run) -> None:
    """Nothing passes the barrier: each side has the head of its own end."""
    data = run.fields("r")
    exact = np.where(data["points"][:, 0] < 0.5, 0.02, 0.01)
    assert data["head"] == pytest.approx(exact, rel=1e-3)


def lies_in_the_shaking(case: Case, run: Run) -> None:
    """A base that goes up faster and faster presses as gravity does."""
    data = run.fields("r")
    x = data["points"][:, 2] - data["displacement"][:, 2]
    exact = -case.density / case.undrained_modulus * (HEIGHT * x - 0.5 * x**2)
    assert data["displacement"][:, 2] == pytest.approx(exact, abs=5e-3 * abs(exact).max())


def moves_on_its_dashpot(case: Case, run: Run) -> None:
    """A load on a column that ends in a dashpot: the velocity behind the front of its wave."""
    exact = -case.load / np.sqrt(case.density * case.undrained_modulus)
    assert run.fields("r")["velocity"][:, 2].mean() == pytest.approx(exact, rel=1e-2)


def flies(case: Case, run: Run) -> None:
    """Nothing acts on it: velocity times time."""
    assert run.fields("r")["displacement"][:, 2] == pytest.approx(0.1 * case.end, rel=1e-9)


def turns(case: Case, run: Run) -> None:
    """Nothing acts on it: displacements of a small turn, from x towards z."""
    data = run.fields("r")
    x, z = (data["points"][:, k] - data["points"][:, k].mean() for k in (0, 2))
    u, w = data["displacement"][:, 0], data["displacement"][:, 2]
    angle = np.sum(x * w - z * u) / np.sum(x**2 + z**2)
    assert angle == pytest.approx(0.1 * case.end, rel=1e-2)


def swings(case: Case, run: Run) -> None:
    """The first mode of a bar a quarter of a period after its start."""
    data = run.fields("r")
    z = data["points"][:, 2] - data["displacement"][:, 2]
    frequency = 0.5 * np.pi / HEIGHT * np.sqrt(case.undrained_modulus / case.density)
    exact = 0.01 / frequency * np.sin(0.5 * np.pi * z / HEIGHT)
    assert data["displacement"][:, 2] == pytest.approx(exact, abs=2e-2 * exact.max())


def stands_on_its_wall(case: Case, run: Run) -> None:
    """At rest the wall gives as much momentum as gravity takes."""
    time = run.history("r", "time")
    late = np.flatnonzero(time > 0.75 * case.end)[[0, -1]]
    volume = HEIGHT if case.dimension == 1 else 0.4 * HEIGHT
    gravity = {"z": -GRAVITY} if case.dimension == 1 else dict(zip("xz", DOWNHILL, strict=True))
    for axis, pull in gravity.items():
        force = np.diff(run.history("r", f"impulse_walls_{axis}")[late]) / np.diff(time[late])
        assert force == pytest.approx(-case.density * volume * pull, rel=1e-3)


COLUMN = Case(carries_its_load)
LOOSE = replace(COLUMN, base="", top="", water="", conductivity=0.0, is_damped=False)
SQUARE = "box_max = 0.6, 0.6"
WEIGHTY = {"scene": f"gravity = -{GRAVITY}"}
UPSIDE = f"gravity = {DOWNHILL[0]!r}, {DOWNHILL[1]!r}"
WALL = "&rigid_wall name = 'floor' position = {position} normal = {normal} /"
SIDES = "\n".join(
    f"&surface name = '{name}' region = 'r' face = '{face}' /\n"
    f"&mechanical_condition surface = '{name}' kind = 'roller' /"
    for name, face in (("left", "x-"), ("right", "x+"))
)

# A scene for every feature of the table
CASES = {
    "any scene": COLUMN,
    "dry soil": replace(COLUMN, is_wet=False),
    "rigid skeleton": Case(
        seeps,
        more={"soil": "rigid = .true."},
        base="&hydraulic_condition surface = 'base' kind = 'head' value = 1.0 /",
        top="",
    ),
    "suction": Case(
        rests_under_suction,
        end=0.2,
        more={
            "scene": f"gravity = -{GRAVITY}",
            "time": "geostatic_start = .true.",
            "soil": "retention = 'van_genuchten' retention_alpha = 2.0 retention_exponent = 2.0",
        },
        top="&initial_state pore_pressure = 'hydrostatic' water_level = 0.5 /",
        water="&hydraulic_condition surface = 'base' kind = 'head' value = 0.5 /",
    ),
    "conductivity of porosity": Case(
        seeps_through_less,
        load=5.0e4,
        more={"soil": "conductivity_law = 'kozeny_carman'"},
        groups="&hydraulic_condition surface = 'base' kind = 'head' value = 0.05 /",
    ),
    "cyclic sand": Case(
        carries_its_load_as_sand,
        end=0.3,
        load=1.02e5,
        soil="model = 'dafalias_manzari' reference_pressure = 1.0e5",
        poisson_ratio=0.05,
        groups="&initial_state effective_stress = 'given'\n"
        "  effective_stress_value = 3*-1.0e5, 3*0.0 /",
    ),
    "two-pass operator": replace(COLUMN, more={"water": "operator = 'two_pass'"}),
    "fluid inertia": replace(COLUMN, more={"water": "fluid_inertia = .true."}),
    "barrier": Case(
        keeps_two_heads,
        dimension=2,
        box="box_max = 1.0, 0.3",
        top="",
        water="&hydraulic_condition surface = 'left' kind = 'head' value = 0.02 /\n"
        "&hydraulic_condition surface = 'right' kind = 'head' value = 0.01 /",
        groups=SIDES + "&barrier name = 'b' vertices = 0.5, -0.1, 0.5, 0.4 /",
    ),
    "period": replace(
        COLUMN,
        dimension=2,
        box="box_max = 0.3, 1.0",
        poisson_ratio=0.3,
        more={"grid": "period = 0.3, 0.0"},
    ),
    "deforming domains": replace(COLUMN, more={"grid": "shape_function = 'cpgimp'"}),
    "shaken base": Case(
        lies_in_the_shaking,
        conductivity=0.0,
        top="",
        water="",
        groups="&base_motion acceleration = 1.0 /",
    ),
    "absorbing surface": Case(
        moves_on_its_dashpot,
        end=0.5,
        conductivity=0.0,
        is_damped=False,
        base="&mechanical_condition surface = 'base' kind = 'absorbing' /",
        water="",
    ),
    "initial velocity": replace(LOOSE, check=flies, end=0.5, more={"region": "velocity = 0.1"}),
    "initial spin": replace(
        LOOSE,
        check=turns,
        dimension=2,
        end=0.1,
        box=SQUARE,
        more={"region": "spin = 0.1 pivot = 0.3, 0.3"},
    ),
    "initial mode": replace(
        LOOSE,
        check=swings,
        base=COLUMN.base,
        more={"mechanics": "transfer = 'flip'", "time": "courant = 0.1"},
        groups="&initial_state mode_amplitude = 0.01 mode_number = 1 /",
    ),
    "rigid wall": replace(
        LOOSE,
        check=stands_on_its_wall,
        is_damped=True,
        end=2.0,
        more=WEIGHTY,
        groups=WALL.format(position="0.0", normal="1.0"),
    ),
    "oblique rigid wall": replace(
        LOOSE,
        check=stands_on_its_wall,
        is_damped=True,
        dimension=2,
        box="box_max = 0.4, 1.0",
        more={"scene": UPSIDE, "region": "shape_angle = 30.0 lattice_angle = 30.0"},
        groups=WALL.format(position="0.0, 0.0", normal="-0.5, 0.8660254037844386"),
    ),
    "wall by penalty": replace(COLUMN, more={"mechanical_condition": "imposition = 'penalty'"}),
    "moving wall by penalty": replace(
        COLUMN,
        more={"mechanical_condition": "imposition = 'penalty'"},
        base="&mechanical_condition surface = 'base' kind = 'roller' /",
        top="&mechanical_condition surface = 'top' kind = 'plate' value = {load} {imposition} /",
    ),
    "long explicit steps": replace(COLUMN, more={"time": "courant = 0.9"}),
}


def case_of(row: Row) -> Case:
    """The scene that asks for the feature; dry where water has no part in it, and explicit."""
    case = replace(CASES[row.feature], integrator=row.integrator, deformation=row.deformation)
    if row.feature == "initial mode":
        travel = HEIGHT / np.sqrt(case.undrained_modulus / case.density)
        case = replace(case, end=float(travel))
    return case


def test_every_feature_has_a_scene() -> None:
    """A new feature of the table comes with a scene that asks for it, and is refused somewhere."""
    assert {row.feature for row in table()} == set(CASES)
    assert {row.feature for row in table() if row.reason} == set(CASES)


@pytest.mark.parametrize("row", [r for r in table() if r.reason], ids=lambda row: row.name)
def test_no(dosui: Runner, row: Row) -> None:
    """Refused at the group and key of the feature, for the reason of the table, on one line."""
    run = dosui(case_of(row).text(), "--check")
    assert run.status == 2, run.stdout
    lines = [line for line in run.stderr.splitlines() if row.reason in line]
    assert len(lines) == 1, run.stderr
    assert f"&{row.group} {row.key}".rstrip() in lines[0]
    assert len(row.reason.split(": take ")) == 2, "a reason says what to do instead"


@pytest.mark.parametrize("row", [r for r in table() if not r.reason], ids=lambda row: row.name)
def test_yes(dosui: Runner, row: Row) -> None:
    """Runs to a right value."""
    case = case_of(row)
    run = dosui(case.text())
    assert run.status == 0, run.stderr
    case.check(case, run)


@pytest.mark.parametrize(
    ("feature", "deformation", "water", "words"),
    [
        ("any scene", "small_strain", "4e5", "quasi_static (nothing in the scene has inertia);"),
        ("any scene", "finite", "4e5", "quasi_static (nothing in the scene has inertia);"),
        ("any scene", "updated", "4e5", "explicit (large deformation);"),
        ("any scene", "updated", "2.2e9", "semi_implicit (large deformation, and the water"),
        ("rigid wall", "updated", "2.2e9", "semi_implicit (large deformation, and the water"),
        ("two-pass operator", "small_strain", "4e5", "quasi_static does not go with: two-pass"),
        ("shaken base", "small_strain", "4e5", "explicit (the base is shaken);"),
    ],
)
def test_what_auto_takes(
    dosui: Runner, feature: str, deformation: str, water: str, words: str
) -> None:
    """A scene that names no integrator gets one that can run it, and the log says why. Real water
    makes no scene explicit that can do without."""
    text = replace(CASES[feature], integrator="auto", deformation=deformation, end=100.0).text()
    text = text.replace("integrator = 'auto'", "").replace(f"= {WATER}", f"= {water}")
    run = dosui(text, "--check")
    assert run.status == 0, run.stderr
    (line,) = (line for line in run.stdout.splitlines() if line.startswith("integrator "))
    assert words in line and "; about " in line


def test_no_integrator_for_all_together(dosui: Runner) -> None:
    """Two things that go with some integrator each, and with none together."""
    case = replace(CASES["two-pass operator"], integrator="auto", deformation="updated")
    assert dosui(case.text(), "--check").status == 0
    long_steps = case.more | CASES["long explicit steps"].more
    run = dosui(replace(case, more=long_steps).text(), "--check")
    assert run.status == 2
    assert "no integrator can do all that the scene asks for" in run.stderr
    assert "explicit does not go with: long explicit steps" in run.stderr
    assert "semi_implicit does not go with: two-pass operator" in run.stderr


def test_auto_chooses_anew_at_a_restart(dosui: Runner) -> None:
    """Another end may make another integrator of 'auto': refused, with what to write."""
    case = replace(COLUMN, integrator="auto", deformation="small_strain", end=100.0)
    text = case.text().replace("&output", "&output checkpoint_steps = 1")
    run = dosui(text.replace("&time", "&time maximum_steps = 3"))
    assert "integrator   quasi_static" in run.stdout
    short = dosui(text.replace("= 100.0", "= 0.5"), "--restart", "r.restart.h5", "--check")
    assert short.status == 2
    assert "&scene integrator: 'quasi_static' -> 'explicit'" in short.stderr
    assert "'auto' chooses anew: the run is as short as waves travel" in short.stderr

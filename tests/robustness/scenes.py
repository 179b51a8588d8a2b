"""Random scenes that a user could mean: bodies, soils, water, loads and methods in any mixture."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

AXES = {1: "z", 2: "xz", 3: "xyz"}
MODELS = ("linear_elastic", "mohr_coulomb", "drucker_prager", "cam_clay", "dafalias_manzari")


@dataclass
class Sketch:
    """A scene while it is made."""

    random: Random
    ndim: int
    wet: bool
    integrator: str = ""
    deformation: str = ""
    heavy: bool = False
    groups: list[str] = field(default_factory=list)
    surfaces: list[str] = field(default_factory=list)

    def add(self, group: str, **values: object) -> None:
        """One more group; values are numbers, texts, truths and lists of numbers."""
        keys = "  ".join(f"{key} = {_text(value)}" for key, value in values.items())
        self.groups.append(f"&{group} {keys} /")

    def any(self, *choices: object) -> object:
        """One of several values."""
        return self.random.choice(choices)

    def log(self, low: float, high: float) -> float:
        """A number, uniform in its logarithm."""
        return _rounded(math.exp(self.random.uniform(math.log(low), math.log(high))))

    def vector(self, *values: float) -> list[float]:
        """Components of the dimension: the last ones of (x, y, z), z always."""
        return [_rounded(v) for v in ((values[0], values[-1]) if self.ndim == 2 else values)][
            -self.ndim :
        ]


def random_scene(seed: int) -> str:
    """A scene from a seed; small enough to run."""
    random = Random(seed)
    sketch = Sketch(random, random.choice((1, 2, 2, 2, 3)), random.random() < 0.65)
    _methods(sketch)
    _soils(sketch)
    _bodies(sketch)
    _conditions(sketch)
    _rest(sketch)
    return "\n".join(sketch.groups) + "\n"


# ---------------------------------------------------------------------- parts


def _methods(s: Sketch) -> None:
    mixtures = [("explicit", "small_strain"), ("quasi_static", "small_strain")] * 2
    mixtures += [("auto", "small_strain"), ("quasi_static", "finite"), ("explicit", "updated")]
    if s.wet:
        mixtures += [("semi_implicit", "small_strain"), ("semi_implicit", "updated")]
    s.integrator, s.deformation = s.random.choice(mixtures)
    if s.random.random() < 0.05:  # a mixture that may not exist
        s.deformation = str(s.any("small_strain", "finite", "updated"))
    s.heavy = s.random.random() < 0.7
    lateral = 1.0 if s.heavy and not s.wet and s.random.random() < 0.2 else 0.0
    s.add(
        "scene",
        dimension=s.ndim,
        integrator=s.integrator,
        deformation=s.deformation,
        water="coupled" if s.wet else "none",
        gravity=s.vector(lateral, 0.0, -9.81 if s.heavy else 0.0),
    )
    grid: dict[str, object] = {"spacing": s.any(0.125, 0.25, 0.1)}
    if s.random.random() < 0.5:
        grid["shape_function"] = s.any("linear", "gimp", "bspline", "auto")
    if s.random.random() < 0.2:
        grid["origin"] = s.vector(*(s.random.uniform(-0.1, 0.1) for _ in range(3)))
    s.add("grid", **grid)
    time: dict[str, object] = {"end_time": s.log(1e-3, 1e5), "maximum_steps": 8}
    if s.random.random() < 0.3:
        time[str(s.any("geostatic_start", "undrained_start"))] = True
    if s.random.random() < 0.3:
        time["output_interval"] = _rounded(float(str(time["end_time"])) / s.random.randint(1, 9))
    s.add("time", **time)
    mechanics: dict[str, object] = {}
    if s.random.random() < 0.3:
        mechanics["transfer"] = s.any("aflip", "flip", "apic", "pic", "blend", "auto")
    if s.random.random() < 0.3:
        mechanics["damping"] = s.any("none", "viscous", "local", "fading")
    if s.random.random() < 0.2:
        mechanics["average_volume_change"] = bool(s.any(True, False))
    if mechanics:
        s.add("mechanics", **mechanics)
    if s.wet and s.random.random() < 0.5:
        s.add(
            "water",
            bulk_modulus=s.log(1e6, 2.2e9),
            operator=s.any("compact", "compact", "two_pass")
            if s.integrator == "explicit" and not s.heavy
            else "compact",
        )


def _soils(s: Sketch) -> None:
    for name in ("soil", "other"):
        model = s.any(*(MODELS[:4] if s.deformation == "finite" else MODELS))
        values: dict[str, object] = {"name": name, "model": model}
        if model not in ("cam_clay", "dafalias_manzari"):
            values |= {
                "young_modulus": s.log(1e5, 1e9),
                "poisson_ratio": s.any(0.0, 0.2, 0.3, 0.45),
            }
        if model in ("mohr_coulomb", "drucker_prager"):
            phi = s.random.choice((0.0, 20.0, 30.0, 42.0))
            values |= {"cohesion": s.log(1.0, 1e5), "friction_angle": phi}
            values["dilation_angle"] = s.any(0.0, phi)
            if s.random.random() < 0.3:
                values["tensile_strength"] = s.log(1.0, 1e4)
        if model == "cam_clay":
            values |= {
                "critical_state_ratio": s.any(0.8, 1.0, 1.3),
                "lambda": s.any(0.1, 0.25),
                "kappa": s.any(0.01, 0.05),
                "over_consolidation_ratio": s.any(1.0, 1.5, 4.0),
            }
        values["porosity"] = s.any(0.3, 0.4, 0.5)
        if s.wet:
            values["hydraulic_conductivity"] = s.log(1e-9, 1e-2)
            if s.random.random() < 0.2 and s.heavy and s.integrator != "semi_implicit":
                values |= {
                    "retention": "van_genuchten",
                    "retention_alpha": s.log(0.2, 5.0),
                    "retention_exponent": s.any(1.5, 2.0, 3.0),
                }
        s.add("material", **values)


def _bodies(s: Sketch) -> None:
    r = s.random
    turned = s.ndim > 1 and r.random() < 0.2
    values: dict[str, object] = {"name": "body", "material": "soil"}
    size = [_rounded(r.choice((0.5, 1.0, r.uniform(0.4, 1.2)))) for _ in range(3)]
    shape = "box"
    if s.ndim > 1 and r.random() < 0.3:
        shape = "circle" if s.ndim == 3 else str(s.any("polygon", "circle"))
        shape = "sphere" if s.ndim == 3 else shape
    if shape == "box":
        values |= {"box_min": s.vector(0, 0, 0), "box_max": s.vector(*size)}
    elif shape == "polygon":
        top = r.uniform(0.3, 0.9)
        values |= {"shape": shape, "vertices": [0, 0, 1.2, 0, _rounded(top), size[0], 0, size[0]]}
    else:
        values |= {"shape": shape, "centre": s.vector(0, 0, 0), "radius": size[0]}
        if r.random() < 0.5:
            values["cut_min"] = s.vector(0, 0, 0)
    if r.random() < 0.3:
        values["jitter"] = s.any(0.1, 0.25)
    if turned:
        values[str(s.any("shape_angle", "lattice_angle"))] = r.choice((10.0, 45.0, -23.0))
    values["particles_per_cell"] = s.any(1, 2, 2, 3 if s.ndim < 3 else 2)
    s.add("region", **values)
    faces = {
        "box": [f"{axis}{side}" for axis in AXES[s.ndim] for side in "-+"],
        "polygon": ["edge1", "edge2", "edge3", "edge4"],
    }.get(shape, ["round"])
    if "cut_min" in values:
        faces = [*faces, *(f"{axis}-" for axis in AXES[s.ndim])]
    for face in faces:
        name = face.replace("-", "_low").replace("+", "_high")
        s.surfaces.append(name)
        s.add("surface", name=name, region="body", face=face)
    if shape == "box" and not turned and r.random() < 0.25:
        gap = r.choice((0.0, 0.0, 0.1))
        low, high = [0.0, 0.0, size[2] + gap], [*size[:2], 2 * size[2] + gap]
        s.add(
            "region",
            name="upper",
            material="other",
            box_min=s.vector(*low),
            box_max=s.vector(*high),
        )


def _conditions(s: Sketch) -> None:
    r = s.random
    for k, name in enumerate(s.surfaces):
        base = name.startswith("z_low") or name in ("edge1", "round")
        kind = "fixed" if base and r.random() < 0.6 else None
        if kind is None and r.random() < 0.7:
            kind = str(s.any("roller", "roller", "roller", "pressure", "traction", "plate"))
            if s.integrator in ("explicit", "semi_implicit") and r.random() < 0.1:
                kind = "absorbing"
        if kind in ("roller", "fixed", "absorbing"):
            s.add("mechanical_condition", surface=name, kind=kind)
        elif kind == "traction":
            s.add(
                "mechanical_condition",
                surface=name,
                kind=kind,
                value=s.vector(s.log(1, 1e3), 0.0, -s.log(1, 1e3)),
            )
        elif kind is not None:
            values: dict[str, object] = {"surface": name, "kind": kind, "value": s.log(1, 1e4)}
            if r.random() < 0.3:
                values |= {"factor_times": [0, 1, 10], "factor_values": [0, 1, 0.5]}
            elif r.random() < 0.2 and kind == "pressure":
                values["formula"] = "1 + 0.5*sin(t)*z"
            s.add("mechanical_condition", **values)
        if s.wet and (r.random() < 0.4 or k == len(s.surfaces) - 1):
            kinds = ["head", "pressure", "flux"]
            if s.heavy:
                kinds += ["reservoir", "seepage_face", "rainfall"]
            water = r.choice(kinds)
            group: dict[str, object] = {"surface": name, "kind": water}
            if water != "seepage_face":
                group["value"] = s.any(0.0, 0.5, 1.0) if water != "flux" else s.log(1e-9, 1e-5)
            s.add("hydraulic_condition", **group)


def _rest(s: Sketch) -> None:
    r = s.random
    state: dict[str, object] = {}
    if s.wet and s.heavy and r.random() < 0.5:
        state |= {"pore_pressure": "hydrostatic", "water_level": s.any(0.0, 0.5, 1.0, 2.0)}
    if s.heavy and r.random() < 0.4:
        state |= {"effective_stress": "geostatic", "surface_level": s.any(0.5, 1.0)}
    if state:
        s.add("initial_state", **state)
    if r.random() < 0.5:
        s.add("probe", name="top", kind="settlement", surface=s.surfaces[-1])
    if s.wet and r.random() < 0.3:
        s.add(
            "probe",
            name="inside",
            kind="point",
            field="pore_pressure",
            position=s.vector(0.2, 0.2, 0.2),
        )
    if r.random() < 0.1 and s.integrator == "explicit" and s.deformation == "updated":
        s.add(
            "rigid_wall",
            name="floor",
            position=s.vector(0, 0, 0),
            normal=s.vector(0, 0, 1),
            friction=0.3,
        )
    s.add("output", name="run")


def _text(value: object) -> str:
    if isinstance(value, bool):
        return ".true." if value else ".false."
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    return repr(value)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")

"""`dosui-post report` with a program that stands in for dosui."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import stat
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from dosui_post.cli import main
from dosui_post.exact import Mandel
from dosui_post.report import kratos, kratos_driver, matrix, ogs
from dosui_post.report.elements import Mesh, step_ends
from dosui_post.report.figure import efficient
from dosui_post.report.matrix import full_matrix, quick_matrix, selected
from dosui_post.report.scenes import PROBLEMS, TIME_FACTORS, scene_text
from dosui_post.report.store import DONE, ESTIMATED, REFUSED, Run, Store
from dosui_post.report.tables import efficiency_rows, first_to_reach, full_rows, refusals, seconds
from dosui_post.result import Scene

HERE = Path(__file__).resolve().parent


class Fake:
    """The stand-in and the command around it."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.program = folder / "dosui"
        self.log = folder / "log"
        self.output = folder / "out"
        paths = os.pathsep.join([str(HERE), str(HERE.parent / "src")])
        self.program.write_text(
            f'#!/bin/sh\nPYTHONPATH={paths} exec {sys.executable} {HERE / "fake_dosui.py"} "$@"\n'
        )
        self.program.chmod(self.program.stat().st_mode | stat.S_IEXEC)
        self.log.write_text("")
        monkeypatch.setenv("FAKE_LOG", str(self.log))
        monkeypatch.setenv("FAKE_PARENT", str(os.getpid()))
        monkeypatch.setenv("PATH", "/usr/bin:/bin")  # without OpenGeoSys

    def report(self, *options: str) -> int:
        """The command; `--quick` unless options say otherwise."""
        common = ["--program", str(self.program), "--output", str(self.output), "--quick"]
        return main(["report", *common, *options])

    @property
    def runs(self) -> int:
        """How often the program has computed something."""
        return self.log.read_text().count("run")

    def page(self) -> str:
        """The page."""
        return (self.output / "speed-and-error.md").read_text()

    def table(self) -> list[dict[str, str]]:
        """The CSV."""
        with (self.output / "runs.csv").open() as file:
            return list(csv.DictReader(file))


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    return Fake(tmp_path, monkeypatch)


FEW = "^terzaghi: (explicit|semi-implicit|quasi-static), dx = 0.(125|05) m.*(0.5|1e-4), 1"


# ---------------------------------------------------------------------- the command


def test_page_pictures_and_table(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    assert fake.report("--only", FEW) == 0
    out = capsys.readouterr().out
    assert "[1/6" in out
    assert "refused: &scene integrator = 'semi_implicit': must be 'explicit'" in out
    assert "OpenGeoSys: not installed, skipped" in out
    rows = fake.table()
    assert [row["state"] for row in rows].count("refused") == 2
    done = [row for row in rows if row["state"] == "done"]
    assert len(done) == 4 == fake.runs
    assert {row["program"] for row in rows} == {"dosui 9.9.9 (0123456789ab, Release)"}
    for row in done:
        dx = float(row["spacing_m"])
        assert float(row["largest_error"]) == pytest.approx(dx**2, rel=1e-6)
        assert float(row["error_T_0.05"]) == pytest.approx(dx**2, rel=1e-6)
        assert int(row["steps"]) == round(10 / dx)
        assert int(row["particle_steps"]) == int(row["steps"]) * int(row["particles"])
        assert int(row["particles"]) == round(0.25 / dx) * round(1 / dx)
        assert float(row["startup_s"]) > 0
        assert 0 < float(row["wall_s"]) < 60
    page = fake.page()
    assert "dosui 9.9.9 (0123456789ab, Release)\n    compiler GNU" in page
    assert re.search(r"Measured on \d{4}-\d\d-\d\d: .*, \d+ cores, \d+ GB", page)
    assert "STREAM triad not measured" in page
    assert "dosui-post report --program" in page
    assert re.search(r"\| explicit \| \*\*.* s\*\* \(dx = 0.05 m, courant 0.5, 200 steps\)", page)
    assert "| semi-implicit | refused | refused |" in page
    assert "not reached (best 0.25 %)" in page
    for picture in re.findall(r"\]\((images/[^)]*)\)", page):
        with Image.open(fake.output / picture) as image:
            assert len(np.unique(np.asarray(image.convert("L")))) > 10
    assert page.count("](images/") == 2


def test_finished_runs_are_kept(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    assert fake.report("--only", FEW) == 0
    assert fake.report("--only", FEW) == 0
    assert fake.runs == 4
    assert capsys.readouterr().out.count("(kept)") == 6
    assert fake.report("--only", FEW, "--repeat", "2") == 0
    assert fake.runs == 12
    assert "Each run is the fastest of 2." in fake.page()
    fake.program.write_text(fake.program.read_text() + "# another program\n")
    assert fake.report("--only", FEW) == 0
    assert fake.runs == 16


def test_torn_line_is_run_again(fake: Fake) -> None:
    assert fake.report("--only", FEW) == 0
    file = fake.output / "runs.jsonl"
    file.write_text(file.read_text()[:-40])
    assert fake.report("--only", FEW) == 0
    assert fake.runs == 5
    lines = file.read_text().splitlines()
    assert json.loads(lines[-1])["state"] == DONE
    assert len(lines) == 7


def test_interruption(
    fake: Fake, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_INTERRUPT_AT", "3")
    assert fake.report("--only", FEW) == 3
    assert "interrupted: 4 of 6 runs" in capsys.readouterr().out
    assert not (fake.output / "speed-and-error.md").exists()
    monkeypatch.delenv("FAKE_INTERRUPT_AT")
    assert fake.report("--only", FEW) == 0
    assert fake.runs == 5
    assert len(fake.table()) == 6


def test_too_long(fake: Fake, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process is ended; a longer limit tries again, the same one does not."""
    monkeypatch.setenv("FAKE_HANG", "1")
    one = ("--only", "^terzaghi: explicit, dx = 0.125")
    assert fake.report(*one, "--timeout", "3") == 0
    assert [row["state"] for row in fake.table()] == ["timeout"]
    pid = int(re.search(r"pid (\d+)", fake.log.read_text())[1])  # type: ignore[index]
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    monkeypatch.delenv("FAKE_HANG")
    assert fake.report(*one, "--timeout", "2") == 0
    assert fake.runs == 1
    assert fake.report(*one, "--timeout", "50") == 0
    assert [row["state"] for row in fake.table()] == ["done"]


@pytest.mark.parametrize(
    ("variable", "message"), [("FAKE_CRASH", "no such luck"), ("FAKE_NAN", "no finite error")]
)
def test_failures_are_told_and_repeated(
    fake: Fake, monkeypatch: pytest.MonkeyPatch, variable: str, message: str
) -> None:
    monkeypatch.setenv(variable, "1")
    one = ("--only", "^terzaghi: explicit, dx = 0.125")
    assert fake.report(*one) == 0
    assert [row["state"] for row in fake.table()] == ["failed"]
    assert f"explicit (Terzaghi, soft water): failed: {message}" in fake.page()
    monkeypatch.delenv(variable)
    assert fake.report(*one) == 0
    assert [row["state"] for row in fake.table()] == ["done"]


def test_pure_water_is_estimated(fake: Fake) -> None:
    assert fake.report("--only", "^terzaghi(-stiff)?: explicit, dx = 0.05 m") == 0
    states = {row["scene"]: row["state"] for row in fake.table()}
    assert states == {"terzaghi": "done", "terzaghi-stiff": "estimated"}
    assert fake.runs == 1
    assert re.search(r"not run: estimated .* \(dx = 0.05 m, 1.3×10⁹ steps\)", fake.page())


def test_page_elsewhere(fake: Fake, tmp_path: Path) -> None:
    page = tmp_path / "docs" / "speed.md"
    assert fake.report("--only", "mandel: explicit, dx = 0.04", "--page", str(page)) == 0
    for picture in re.findall(r"\]\((images/[^)]*)\)", page.read_text()):
        assert (page.parent / picture).is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "nothing at all"], "no run has 'nothing at all'"),
        (["--only", "("], "--only:"),
        (["--program", "/nowhere/dosui"], "no program /nowhere/dosui"),
        (["--only", "mandel: explicit, dx = 0.04", "--ogs", "/nowhere/ogs"], "(--ogs)"),
    ],
)
def test_wrong_requests(
    fake: Fake, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert fake.report(*options) == 2
    assert message in capsys.readouterr().err


# ---------------------------------------------------------------------- matrix and scenes


def test_matrices() -> None:
    for jobs in (quick_matrix(), full_matrix()):
        assert len({(job.text(), job.ranks) for job in jobs}) == len(jobs)
        methods = {job.method for job in jobs}
        assert methods == set(matrix.METHODS)
        assert {job.ranks for job in jobs} == {1, 2}
        assert any(job.is_estimate for job in jobs)
    assert {job.problem.name for job in full_matrix()} == set(PROBLEMS)
    only = selected(quick_matrix(), "MANDEL: quasi.*2 ranks")
    assert [job.label for job in only] == [
        "mandel: quasi-static, dx = 0.005 m, relative_tolerance = 1e-4, 2 ranks"
    ]


@pytest.mark.parametrize("name", PROBLEMS)
def test_scenes_hold_their_exact_solution(name: str) -> None:
    problem = PROBLEMS[name]
    text = scene_text(problem, matrix.EXPLICIT, 0.05, "courant = 0.5")
    scene = Scene(text, text)
    time = scene.one("time")
    factors = [problem.solution.time_factor(t) for t in time.numbers("output_times")]
    factors.append(problem.solution.time_factor(time.number("end_time")))
    assert factors == pytest.approx(list(TIME_FACTORS))
    drained, direction = (scene.one("verification").numbers(k) for k in ("drained", "direction"))
    assert math.hypot(*direction) == pytest.approx(1)
    # From the drained side through the body: length to the other side.
    angle = math.radians(problem.angle)
    back = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    start, way = back @ drained, back @ direction
    end = start + problem.length * way
    if problem.kind == "mandel":
        assert (start[0], end[0]) == pytest.approx((problem.size[0], 0))
    else:
        assert (start[1], end[1]) == pytest.approx((problem.size[1], 0), abs=1e-12)


def test_methods_differ_in_the_scene() -> None:
    problem = PROBLEMS["terzaghi"]
    texts = {method: scene_text(problem, method, 0.05, "") for method in matrix.METHODS}
    assert len(set(texts.values())) == len(texts)
    assert "undrained_start = .true." in texts[matrix.EXPLICIT]
    assert "damping = 'fading'" in texts[matrix.EXPLICIT]
    assert "undrained_start" not in texts[matrix.QUASI_STATIC]
    assert "operator = 'two_pass'" in texts[matrix.TWO_PASS]
    assert "transfer = 'flip'" in texts[matrix.TWO_PASS]
    assert 50 < problem.density_scaling < 200
    assert PROBLEMS["terzaghi-stiff"].density_scaling > 1e7
    assert "density_scaling" in texts[matrix.SCALED]


# ---------------------------------------------------------------------- tables


def run(method: str, wall: float, error: float, **options: object) -> Run:
    values = {"scene": "terzaghi", "spacing": 0.05, "control": "courant = 0.5", "ranks": 1}
    values |= {"state": DONE, "particles": 100, "steps": 1000.0, "wall": wall} | options
    errors = {f"{factor:g}": error for factor in TIME_FACTORS}
    return Run(key=f"{method}{wall}{values}", method=method, errors=errors, **values)  # type: ignore[arg-type]


def test_efficiency() -> None:
    runs = [
        run("explicit", 9.0, 9e-4, spacing=0.025, steps=8000.0),
        run("explicit", 2.0, 9e-3),
        run("explicit", 1.0, 2e-2, spacing=0.1),
        run("explicit", 8.0, math.nan),
        run("quasi-static", 0.5, 4e-3),
        run("semi-implicit", 0.1, 0.0, state=REFUSED, message="not yet"),
        run("explicit", 0.0, math.nan, scene="terzaghi-stiff", state=ESTIMATED, steps=1e9),
        run("other", 0.3, 9e-3),
        run("worse", 0.3, 2.9),
    ]
    table = {(row[0], row[1]): row[2:] for row in efficiency_rows(runs)}
    soft, stiff = (PROBLEMS[name].title for name in ("terzaghi", "terzaghi-stiff"))
    assert table[soft, "explicit"] == [
        "**2 s** (dx = 0.05 m, courant 0.5, 1000 steps)",
        "**9 s** (dx = 0.025 m, courant 0.5, 8000 steps)",
    ]
    assert table[soft, "quasi-static"][1] == "not reached (best 0.4 %)"
    assert table[soft, "semi-implicit"] == ["refused", "refused"]
    assert table[stiff, "explicit"] == [
        "not run: estimated 23 days (dx = 0.05 m, 10⁹ steps)",
        "not run (at least 10⁹ steps)",
    ]
    assert list(table)[-1] == (stiff, "explicit")
    assert [method for scene, method in table if scene == soft][-2:] == [
        "other",
        "worse",
    ]  # after dosui's own
    assert table[soft, "worse"][0] == "not reached (best 290 %)"
    assert first_to_reach(runs, 1e-9) is None
    assert refusals(runs) == [("semi-implicit (Terzaghi, soft water)", "refused: not yet")]
    assert all(len(row) == len(full_rows(runs)[0]) for row in full_rows(runs))


def test_front() -> None:
    runs = [run("a", w, e) for w, e in ((1, 1e-2), (2, 2e-2), (2, 1e-3), (3, 1e-3), (0.5, 0.5))]
    front = efficient([*runs, run("a", 0.1, math.nan)], lambda item: item.wall)
    assert [item.wall for item in front] == [0.5, 1, 2]


def test_seconds() -> None:
    assert [seconds(k) for k in (0.456, 45.6, 456, 7300, 8.64e5)] == [
        "0.46 s",
        "46 s",
        "7.6 min",
        "2 h",
        "10 days",
    ]


def test_store_keeps_the_last(tmp_path: Path) -> None:
    store = Store(tmp_path / "new" / "runs.jsonl")
    first = run("a", 1.0, 1e-2)
    store.add(first)
    store.add(replace(first, wall=2.0))
    with store.path.open("a") as file:
        file.write('{"key": "x", "unknown": 1}\nnonsense\n')
    again = Store(store.path).get(first.key)
    assert again is not None
    assert again == replace(first, wall=2.0)
    assert Store(store.path).get("x") is None


# ---------------------------------------------------------------------- OpenGeoSys

FAKE_OGS = """#!{python}
import sys
import xml.etree.ElementTree as tree
from pathlib import Path
sys.path[:0] = ["{source}"]
if "--version" in sys.argv:
    print("ogs  version: 6.9.9")
    sys.exit(0)
from dosui_post.report.scenes import PROBLEMS
import numpy as np
problem = PROBLEMS["terzaghi"]
project = tree.parse("column.prj")
points = tree.parse("column.vtu").find(".//Points/DataArray").text.split()
z = np.array(points, dtype=float).reshape(-1, 3)[:, 1]
sets = []
for k, time in enumerate([0.0, *map(float, project.find(".//fixed_output_times").text.split())]):
    p = problem.solution.pressure(1.0 - z, time) * 1.01
    text = " ".join(map(repr, p.tolist()))
    Path(f"out_{{k}}.vtu").write_text(
        f'<VTKFile><DataArray Name="pressure_interpolated">{{text}}</DataArray></VTKFile>'
    )
    sets.append(f'<DataSet timestep="{{time!r}}" file="out_{{k}}.vtu"/>')
Path("out.pvd").write_text("<VTKFile>" + "".join(sets) + "</VTKFile>")
"""


def test_ogs(fake: Fake, tmp_path: Path) -> None:
    program = tmp_path / "ogs"
    source = str(HERE.parent / "src")
    program.write_text(FAKE_OGS.format(python=sys.executable, source=source))
    program.chmod(0o755)
    only = ("--only", "^terzaghi: (explicit|OpenGeoSys.*), dx = 0.05 m", "--ogs", str(program))
    assert fake.report(*only) == 0
    rows = [row for row in fake.table() if row["method"] == ogs.METHOD]
    assert [row["state"] for row in rows] == ["done"] * 3
    # 1 % and the bilinear interpolation to the centres.
    assert all(5e-3 < float(row["largest_error"]) < 2e-2 for row in rows)
    assert f"*{ogs.METHOD}* (OpenGeoSys 6.9.9): quadratic" in fake.page()
    assert "OpenGeoSys" in (fake.output / "runs.jsonl").read_text()


def test_ogs_input() -> None:
    job = ogs.OgsJob(PROBLEMS["terzaghi"], 0.05, 16)
    files = job.files()
    assert all(ElementTree.fromstring(text) is not None for text in files.values())
    ends = step_ends(job.problem, job.n)
    steps = np.diff([0.0, *ends])
    assert steps.min() > 0
    assert ends[-1] == pytest.approx(job.problem.times[-1])
    for time in job.problem.times:
        assert np.abs(np.array(ends) - time).min() <= 1e-9 * time
    mesh = Mesh.of(job.problem, 0.05)
    assert len(mesh.cells) == 20
    assert len(mesh.points) == 2 * 21 + 21 + 2 * 20
    middles = np.array([mesh.points[cell[4:]].mean(axis=0) for cell in mesh.cells])
    assert mesh.middles() == pytest.approx(middles)


def test_ogs_plate_moves_as_in_the_exact_solution() -> None:
    job = ogs.OgsJob(PROBLEMS["mandel-stiff"], 0.05, 16)
    project = ElementTree.fromstring(job.files()["column.prj"])
    curve = project.find("curves/curve")
    assert curve is not None
    times = [float(x) for x in (curve.findtext("coords") or "").split()]
    values = [float(x) for x in (curve.findtext("values") or "").split()]
    solution = job.problem.solution
    assert isinstance(solution, Mandel)
    assert values[-1] == pytest.approx(-solution.settlement(0.2, times[-1]), rel=1e-12)
    assert len(times) == len(values) == len(step_ends(job.problem, job.n)) + 1


# ---------------------------------------------------------------------- Kratos

FAKE_KRATOS = """
import json, sys
sys.path[:0] = ["{source}"]
if "--version" in sys.argv:
    print('version: 10.9."8"--0-Release')
    sys.exit(0)
from dosui_post.report.scenes import PROBLEMS
case = json.load(open("case.json"))
problem = PROBLEMS["mandel" if case["plate"] else "terzaghi"]
assert case["plate"] is None or len(case["plate"]) == len(case["ends"])
pressures = dict()
for time in case["outputs"]:
    where = [x if case["plate"] else 1.0 - z for x, z in case["points"]]
    pressures[repr(time)] = (1.01 * problem.solution.pressure(where, time)).tolist()
json.dump(dict(loop=0.0, pressures=pressures), open("result.json", "w"))
"""


def test_kratos(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = tmp_path / "driver.py"
    driver.write_text(FAKE_KRATOS.format(source=str(HERE.parent / "src")))
    monkeypatch.setattr(kratos, "DRIVER", driver)
    only = "^(terzaghi|mandel): (explicit|Kratos.*), dx = 0.0(5|2) m"
    assert fake.report("--only", only, "--kratos", sys.executable) == 0
    rows = [row for row in fake.table() if row["method"] == kratos.METHOD]
    assert [row["state"] for row in rows] == ["done"] * 4
    assert all(5e-3 < float(row["largest_error"]) < 2e-2 for row in rows)
    assert f"*{kratos.METHOD}* (Kratos GeoMechanics 10.9.8): the same elements" in fake.page()


def test_kratos_is_not_there(fake: Fake, capsys: pytest.CaptureFixture[str]) -> None:
    only = ("--only", "mandel: explicit, dx = 0.04")
    assert fake.report(*only, "--kratos", sys.executable) != 0
    assert "has no Kratos" in capsys.readouterr().err


def test_kratos_input() -> None:
    """What the driver makes of a case, as far as it needs no Kratos."""
    case = json.loads(kratos.KratosJob(PROBLEMS["terzaghi"], 0.05, 16).case())
    mesh = kratos_driver.mesh_text(case)
    assert mesh.count("Begin SubModelPart ") == 5
    assert "LineLoadDiffOrderCondition2D3N" in mesh
    values = kratos_driver.parameters(case)
    (load,) = values["processes"]["loads_process_list"]
    assert load["Parameters"]["value"] == [0.0, -1000.0, 0.0]
    assert not any(load["Parameters"]["is_fixed"])
    assert values["solver_settings"]["newmark_theta"] == 0.5
    case = json.loads(kratos.KratosJob(PROBLEMS["mandel"], 0.02, 16).case())
    assert kratos_driver.parameters(case)["processes"]["loads_process_list"] == []
    (material,) = kratos_driver.materials(case)["properties"]
    assert material["Material"]["Variables"]["BULK_MODULUS_FLUID"] == 3.0e6

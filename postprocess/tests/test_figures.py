"""Figures, animations and the command line around them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import synthetic
from PIL import Image

from dosui_post import __version__
from dosui_post.cli import main
from dosui_post.plot import limits_of
from dosui_post.units import number, scale, si


def picture(path: Path) -> np.ndarray:
    """Pixels of a figure that is not empty."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert min(pixels.shape[:2]) > 300
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
    return pixels


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("results")
    synthetic.terzaghi_file(path / "terzaghi.vtkhdf")
    synthetic.terzaghi_file(path / "bare.vtkhdf", with_history=False)
    synthetic.terzaghi_file(path / "column.vtkhdf", ndim=1)
    synthetic.terzaghi_file(path / "many.vtkhdf", time_factors=np.geomspace(1e-3, 2, 12).tolist())
    for nu in (0.0, 0.2, 0.4):
        synthetic.mandel_file(path / f"mandel_{nu}.vtkhdf", nu, with_probe=nu != 0.2)
    synthetic.drainage_file(path / "drainage.vtkhdf")
    synthetic.cube_file(path / "cube.vtkhdf")
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        "plot isochrones terzaghi.vtkhdf",
        "plot isochrones column.vtkhdf --times 0.1 0.5",
        "plot isochrones many.vtkhdf",
        "plot isochrones drainage.vtkhdf",
        "plot mandel mandel_0.0.vtkhdf mandel_0.2.vtkhdf mandel_0.4.vtkhdf",
        "plot mandel mandel_0.2.vtkhdf",
        "plot settlement terzaghi.vtkhdf bare.vtkhdf",
        "plot settlement mandel_0.0.vtkhdf mandel_0.4.vtkhdf",
        "plot map terzaghi.vtkhdf",
        "plot map terzaghi.vtkhdf --field displacement --time 1.0",
        "plot map terzaghi.vtkhdf --field effective_stress --component mean --step 1",
        "plot map terzaghi.vtkhdf --step 0",
        "plot map column.vtkhdf --step 2",
        "plot map drainage.vtkhdf",
        "plot map cube.vtkhdf --field velocity --component z --slice 0.2",
        "plot probe terzaghi.vtkhdf",
        "plot probe terzaghi.vtkhdf base_pressure",
    ],
)
def test_every_figure(folder: Path, tmp_path: Path, arguments: str) -> None:
    words = [str(folder / word) if word.endswith("vtkhdf") else word for word in arguments.split()]
    output = tmp_path / "new" / "figure.png"
    assert main([*words, "-o", str(output)]) == 0
    picture(output)


def test_default_name(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["plot", "isochrones", str(folder / "terzaghi.vtkhdf")]) == 0
    assert capsys.readouterr().out.strip() == "terzaghi_isochrones.png"
    picture(tmp_path / "terzaghi_isochrones.png")


def test_map_shows_the_field(folder: Path, tmp_path: Path) -> None:
    """Other values, other picture: a map that ignores its field would pass for non-empty."""
    pictures = []
    for step in ("1", "4"):
        output = tmp_path / f"{step}.png"
        arguments = ["--step", step, "-o", str(output)]
        assert main(["plot", "map", str(folder / "terzaghi.vtkhdf"), *arguments]) == 0
        pictures.append(picture(output))
    assert not np.array_equal(*pictures)


@pytest.mark.parametrize("options", [["--isochrones"], ["--field", "pore_pressure"]])
def test_animation(folder: Path, tmp_path: Path, options: list[str]) -> None:
    output = tmp_path / "a.gif"
    source = str(folder / "many.vtkhdf")
    assert main(["animate", source, *options, "--every", "4", "-o", str(output)]) == 0
    with Image.open(output) as image:
        # 13 outputs: 0, 4, 8, 12; the isochrone has no t = 0.
        assert image.n_frames == (3 if "--isochrones" in options else 4)
        frames = []
        for index in range(image.n_frames):
            image.seek(index)
            frames.append(np.asarray(image.convert("RGB")))
    assert not np.array_equal(frames[0], frames[-1])
    assert frames[-1][-2, 2].tolist() == [255, 255, 255]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("plot isochrones mandel_0.2.vtkhdf", "isochrones belong to"),
        ("plot mandel terzaghi.vtkhdf", "no result of Mandel's, Cryer's or de Leeuw's problem"),
        ("plot settlement drainage.vtkhdf", "does not settle"),
        ("plot settlement terzaghi.vtkhdf mandel_0.2.vtkhdf", "of one kind"),
        ("plot map terzaghi.vtkhdf --field temperature", "no field 'temperature'"),
        ("plot map terzaghi.vtkhdf --field displacement --component xx", "no component 'xx'"),
        ("plot map terzaghi.vtkhdf --component x", "has no components"),
        ("plot map terzaghi.vtkhdf --step 17", "no step 17"),
        ("plot probe terzaghi.vtkhdf nothing", "no history 'nothing'"),
        ("plot probe cube.vtkhdf", "no histories"),
        ("plot isochrones terzaghi.vtkhdf -o a.unknown", "cannot write"),
        ("plot isochrones terzaghi.vtkhdf -o /proc/nowhere/a.png", "cannot write"),
        ("animate terzaghi.vtkhdf -o a.mp4", "must end in .gif"),
        ("animate terzaghi.vtkhdf --every 0", "every must be"),
        ("plot isochrones nothing.vtkhdf", "does not exist"),
    ],
)
def test_wrong_requests_get_a_sentence(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [str(folder / word) if word.endswith("vtkhdf") else word for word in arguments.split()]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("dosui-post: error: ")
    assert message in error
    assert list(tmp_path.iterdir()) == []


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    source = Path(__file__).resolve().parents[1] / "src"
    environment = {**os.environ, "PYTHONPATH": str(source)}
    command = [sys.executable, "-m", "dosui_post", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def test_as_a_command(tmp_path: Path) -> None:
    version = run("--version")
    assert (version.returncode, version.stdout) == (0, f"dosui-post {__version__}\n")
    broken = tmp_path / "broken.vtkhdf"
    broken.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    result = run("verify", str(broken))
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert "broken.vtkhdf" in result.stderr
    assert run("verify", str(broken), "--tolerance", "-1").returncode == 2
    assert run().returncode == 2


def test_limits_of_colours() -> None:
    assert limits_of([np.array([5.0, 10.0]), np.array([1.0])]) == (0.0, 10.0)
    assert limits_of([np.array([9.0, 10.0])]) == (9.0, 10.0)
    assert limits_of([np.array([-4.0, 2.0])]) == (-4.0, 4.0)
    assert limits_of([np.array([-4.0, -1.0])]) == (-4.0, 0.0)
    assert limits_of([np.array([0.0, np.nan])]) == (0.0, 1.0)
    assert limits_of([np.array([3.0, 3.0])]) == (1.5, 4.5)


def test_units() -> None:
    assert si(1.0e6, "Pa") == "1 MPa"
    assert si(2.2e9, "Pa") == "2.2 GPa"
    assert si(1.0e-5, "m/s") == "10⁻⁵ m/s"
    assert si(2.5e-7, "m/s") == "2.5×10⁻⁷ m/s"
    assert si(float("inf"), "Pa") == "∞ Pa"
    assert number(0.05) == "0.05"
    assert scale(2.0e-3, "m") == (1.0e3, "mm")
    assert scale(1.0e3, "-") == (1.0, "-")

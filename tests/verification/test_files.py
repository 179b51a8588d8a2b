"""Files that dosui reads (one reader, damage) and writes (full disks, links, paths, locks)."""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import damaged_inputs as damage
import h5py
import numpy as np
import pytest
from conftest import BIN, Runner

COLUMN = """&scene title = 'A column' dimension = 1 integrator = 'quasi_static' /
&grid spacing = 0.05 /
&time end_time = 9.0 output_interval = 0.5 /
&material name = 'soil' young_modulus = 1.0e6 poisson_ratio = 0.2 porosity = 0.3
  hydraulic_conductivity = 1.0e-3 /
&water bulk_modulus = 3.0e6 /
&region name = 'column' material = 'soil' box_min = 0.0 box_max = 1.0 particles_per_cell = 1 /
&surface name = 'base' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'base' kind = 'roller' /
&mechanical_condition surface = 'top' kind = 'pressure' value = 1000.0 /
&hydraulic_condition surface = 'top' kind = 'head' value = 0.0 /
&output name = 'col' checkpoint_steps = 3 /
"""
LONG = (
    COLUMN.replace("quasi_static", "explicit")
    .replace("0.05 /", "0.002 /")
    .replace("3.0e6", "3.0e9")
)


# ---------------------------------------------------------------- reading


def scene_head(dice: random.Random) -> str:
    """A &scene of one dimension as somebody might write it."""
    blank = [
        " ",
        "",
        "\t",
        "  ",
        "\n",
        " ! not dimension = 3\n",
        "\n! &scene dimension = 2 /\n  ",
        "\t\t",
    ]
    titles = [
        "flow in dimension = 2",
        "Stop! a / b",
        "it's 1-D, $x",
        "&scene dimension = 3 /",
        "",
        "Böschung",
    ]
    quote = dice.choice("'\"")
    title = dice.choice(titles).replace(quote, 2 * quote)
    keys = [
        dice.choice(["dimension", "DIMENSION", "Dimension(1)", "dimension ( 1 )"]),
        "title",
        dice.choice(["integrator", "INTEGRATOR"]),
    ]
    values = [dice.choice(["1", "+1", "01", "1*1"]), f"{quote}{title}{quote}", "'quasi_static'"]
    keys = [
        f"{key}{dice.choice(['', ' ', chr(9)])}={dice.choice(blank)}{v}"
        for key, v in zip(keys, values, strict=True)
    ]
    dice.shuffle(keys)
    between = [dice.choice([", ", " ", "\n", ",\t"]) for _ in keys]
    body = "".join(key + part for key, part in zip(keys, between, strict=True)).rstrip().rstrip(",")
    first, last = (
        dice.choice(["&scene ", "&SCENE\t", "&Scene\n"]),
        dice.choice([" /", "\n&end", "/"]),
    )
    return f"{first}{body}{last}\n"


@pytest.mark.parametrize("seed", range(6))
def test_launcher_reads_as_the_programs(dosui: Runner, tmp_path: Path, seed: int) -> None:
    """What dosui1d takes, dosui starts: any place, case, tabs, comments, titles, line ends."""
    dice = random.Random(seed)
    head, rest = scene_head(dice), COLUMN.split("\n", 1)[1]
    text = rest + head if dice.random() < 0.5 else head + rest
    text = text.replace("\n", dice.choice(["\n", "\r\n", "\r"]))
    data = dice.choice([b"", b"\xef\xbb\xbf"]) + text.encode()
    (tmp_path / "scene.nml").write_bytes(data)
    outputs = []
    for program in ("dosui1d", "dosui"):
        run = subprocess.run(
            [str(BIN / program), "--check", "scene.nml"],
            cwd=tmp_path,
            capture_output=True,
            timeout=60,
        )
        assert run.returncode == 0, text + run.stderr.decode()
        # what the machine has changes from second to second
        outputs.append(re.sub(rb"[\d.]+ [kMG]B free", b"", run.stdout))
    assert b"outputs" in outputs[0]
    assert outputs[0] == outputs[1]


def test_dollar_groups_are_named(dosui: Runner) -> None:
    """One sentence at the first line, and no complaints about missing groups."""
    text = COLUMN.replace("&", "$").replace(" /\n", " $end\n")
    run = dosui("\n" + text, "--check")
    assert run.status == 2
    assert "scene.nml:2: groups begin with '&' and end with '/'" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("0 0\n1 nan\n", "line 2, column 2 (factor) = 'nan': must be a finite number"),
        ("0 0\ninf 1\n", "line 2, column 1 (time) = 'inf': must be a finite number"),
        ("0 0\n/ 1\n", "line 2, column 1 (time) = '/': must be a number"),
        ("0 0\n1 2*3\n", "line 2, column 2 (factor) = '2*3': must be a number"),
        ("0 0\n1 1.5d+\n", "line 2, column 2 (factor) = '1.5d+': must be a number"),
        ("0 0\n1 --3\n", "line 2, column 2 (factor) = '--3': must be a number"),
        ("0 0\n1 1e400\n", "line 2, column 2 (factor) = '1e400': is too large"),
        ("0 0\n1 1e300\n", "must be between -1e15 and 1e15"),
        (f"0 0\n1 {'1' * 200}\n", "more than 100 characters"),
        ("0,0\n1,,2\n", "line 2: needs two numbers, time and factor"),
        ("0 0\n1 2 3\n", "line 2: needs two numbers, time and factor"),
        ("0 0\n1\n", "line 2: needs two numbers, time and factor"),
        ("0 0\r0 1\r", "line 2: its times must increase strictly"),
        ("# nothing\n", "holds no table"),
        ("\xff\xfe0\x000\x00", "UTF-16"),
        ("0 0\x00\n", "not a text file"),
    ],
)
def test_motions_that_cannot_be(dosui: Runner, tmp_path: Path, table: str, message: str) -> None:
    """Named with the file, line and column."""
    (tmp_path / "damaged").write_bytes(table.encode("latin-1"))
    run = dosui(damage.MOTION_SCENE, "--check")
    assert run.status == 2, run.stdout
    assert "'damaged'" in run.stderr or "damaged:" in run.stderr
    assert message in run.stderr


def test_byte_order_marks_are_skipped(dosui: Runner, tmp_path: Path) -> None:
    """In motions, tables, triangles and scenes."""
    for kind in ("motion", "particles", "stl_text"):
        scene, make, _, _ = damage.KINDS[kind]
        (tmp_path / "damaged").write_bytes(b"\xef\xbb\xbf" + make().replace(b"\n", b"\r\n"))
        run = dosui("\ufeff" + scene, "--check")
        assert run.status == 0, run.stderr


@pytest.mark.parametrize("kind", ["motion", "particles", "stl_text", "scene"])
def test_pipes_and_devices_are_refused(dosui: Runner, tmp_path: Path, kind: str) -> None:
    """Nothing waits for ever."""
    scene = damage.KINDS[kind][0]
    name = "scene2.nml" if kind == "scene" else "damaged"
    for make, message in (
        (os.mkfifo, "it is a pipe, not a file"),
        (os.mkdir, "it is a directory, not a file"),
        (lambda path: os.symlink("/dev/zero", path), "it is a device, not a file"),
        (lambda path: os.symlink("nowhere", path), "it is a link to nothing"),
    ):
        make(tmp_path / name)
        run = dosui(tmp_path / name if kind == "scene" else scene, "--check", timeout=30)
        assert run.status == 2, run.stdout
        assert message in run.stderr
        os.rmdir(tmp_path / name) if (tmp_path / name).is_dir() else os.remove(tmp_path / name)


@pytest.mark.parametrize("kind", list(damage.KINDS))
def test_damaged_inputs(tmp_path: Path, kind: str) -> None:
    """As tests/verification/damaged_inputs.py, which tries hundreds: right, and no crash."""
    for seed in range(100, 105):
        assert damage.try_one(kind, seed, tmp_path) in ("accepted", "refused"), seed


def test_pressure_of_element_tests(dosui: Runner) -> None:
    """The option's number goes through the same reader."""
    for word in ("2*3", "-1", ""):
        run = dosui(COLUMN, f"--elements={word}")
        assert run.status == (0 if word == "" else 2), word
        assert word == "" or "pressure must be" in run.stderr


# ---------------------------------------------------------------- writing


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator:
    """Makes a disk of some kilobytes; skipped where this is not allowed."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(kilobytes: int) -> Path:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", folder],
            capture_output=True,
        )
        if done.returncode != 0:
            pytest.skip("no disk can be mounted here")
        return folder

    yield mount
    subprocess.run(["umount", folder], capture_output=True)


def fill_when_used(disk: Path, rest: int) -> None:
    """Leaves `rest` bytes on a disk as soon as something else lies on it."""
    for _ in range(20000):
        if any(disk.iterdir()):
            break
        time.sleep(0.001)
    state = os.statvfs(disk)
    with contextlib.suppress(OSError):  # the run takes its share at the same time
        (disk / "filler").write_bytes(bytes(max(0, state.f_bavail * state.f_frsize - rest)))


@pytest.mark.parametrize(
    ("kilobytes", "ranks"), [(8, 1), (100, 1), (180, 1), (260, 1), (260, 2), (340, 1)]
)
def test_full_disk(dosui: Runner, small_disk, kilobytes: int, ranks: int) -> None:
    """One message, status 1, no signal; steps and checkpoints written before can be read."""
    disk = small_disk(20480)  # what the run needs, or it is refused before it starts
    text = COLUMN.replace("spacing = 0.05", "spacing = 0.005").replace(
        "interval = 0.5", "interval = 0.05"
    )
    filler = threading.Thread(target=fill_when_used, args=(disk, 1024 * kilobytes))
    filler.start()
    run = dosui(text, "--output", str(disk), ranks=ranks, timeout=100)
    filler.join()
    (disk / "filler").unlink()
    assert run.status == 1, run.stderr
    errors = [line for line in run.stderr.splitlines() if "rror" in line]
    assert len(errors) == 1, run.stderr
    assert errors[0].startswith(f"error: cannot write {disk}/col.")
    assert errors[0].endswith(": No space left on device")
    assert ".part" not in errors[0] and ".tmp" not in errors[0]
    left = {path.name for path in disk.iterdir()}
    assert left <= {f"col.{suffix}" for suffix in ("vtkhdf", "restart.h5", "restart.h5.previous")}
    if (disk / "col.vtkhdf").exists():
        with h5py.File(disk / "col.vtkhdf") as file:
            n_steps = int(file["VTKHDF/Steps"].attrs["NSteps"])
            n_rows = int(file["VTKHDF/NumberOfPoints"][:n_steps].sum())
            assert n_steps >= 1
            assert np.isfinite(file["VTKHDF/PointData/pore_pressure"][:n_rows]).all()
    for path in disk.glob("*.restart.h5*"):
        with h5py.File(path) as file:
            assert np.isfinite(file["particles/field_pore_pressure"][:]).all()


def test_file_larger_than_allowed(dosui: Runner, tmp_path: Path) -> None:
    """ulimit -f: an error and no signal."""
    text = COLUMN.replace("spacing = 0.05", "spacing = 0.001").replace(
        "interval = 0.5", "interval = 0.1"
    )
    (tmp_path / "scene.nml").write_text(text)
    limit = 6_000_000  # Open MPI itself needs 4 MB
    run = subprocess.run(
        [str(BIN / "dosui"), "scene.nml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=100,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert run.returncode == 1, run.stderr
    assert (
        run.stderr.strip()
        == f"error: cannot write ./col.vtkhdf: File too large? ulimit -f allows {limit} bytes"
    )


def test_lost_output_lines_stop_nothing(dosui: Runner, tmp_path: Path) -> None:
    """A full disk behind the log, a reader that goes away; but a lost template is an error."""
    (tmp_path / "scene.nml").write_text(COLUMN)
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [str(BIN / "dosui"), "scene.nml"], cwd=tmp_path, stdout=full, timeout=60
        )
        assert run.returncode == 0
        run = subprocess.run(
            [str(BIN / "dosui"), "--template", "1"], stdout=full, stderr=subprocess.PIPE, timeout=60
        )
        assert run.returncode == 1
        assert b"cannot write to standard output" in run.stderr
    reader, writer = os.pipe()
    os.close(reader)
    run = subprocess.run([str(BIN / "dosui"), "scene.nml"], cwd=tmp_path, stdout=writer, timeout=60)
    os.close(writer)
    assert run.returncode == 0
    assert (tmp_path / "col.vtkhdf").exists()


def test_links_are_not_followed(dosui: Runner, tmp_path: Path) -> None:
    """Files that are being written replace a link or a second name and leave its file alone."""
    for name in ("col.vtkhdf.part", "col.restart.h5.tmp"):
        (tmp_path / f"precious_{name}").write_text("precious")
        os.symlink(f"precious_{name}", tmp_path / name)
    (tmp_path / "precious").write_text("precious")
    os.link(tmp_path / "precious", tmp_path / "col.restart.h5.previous.new")
    run = dosui(COLUMN)
    assert run.status == 0, run.stderr
    for path in tmp_path.glob("precious*"):
        assert path.read_text() == "precious", path
    for name in ("col.vtkhdf", "col.restart.h5"):
        assert not (tmp_path / name).is_symlink()
    os.symlink("precious", tmp_path / "col.lock")
    run = dosui(COLUMN)
    assert run.status == 2
    assert "cannot lock ./col.lock" in run.stderr
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.parametrize("length", [300, 4070])
def test_long_paths(dosui: Runner, tmp_path: Path, length: int) -> None:
    """Open MPI's own way to write files stops at 250 characters."""
    folder = deep_folder(tmp_path, length)
    run = dosui(COLUMN, "--output", str(folder), ranks=2 if length == 300 else 1)
    assert run.status == 0, run.stderr
    run = dosui(COLUMN, "--output", str(folder), "--restart", f"{folder}/col.restart.h5")
    assert run.status == 0, run.stderr
    with h5py.File(folder / "col.vtkhdf") as file:
        assert int(file["VTKHDF/Steps"].attrs["NSteps"]) == 19


def test_paths_longer_than_the_system_takes(dosui: Runner, tmp_path: Path) -> None:
    """Said before anything is computed."""
    for length, message in (
        (4080, "File name too long"),
        (4094, "is longer than the system"),
    ):
        run = dosui(COLUMN, "--output", str(deep_folder(tmp_path, length)))
        assert run.status == 2
        assert message in run.stderr
        assert "particles" not in run.stdout


def deep_folder(start: Path, length: int) -> Path:
    """A folder whose path has so many characters."""
    path = str(start)
    while len(path) < length:
        path += "/" + "d" * min(100, max(1, length - len(path) - 1))
    path = path[:length].rstrip("/")
    os.makedirs(path)
    return Path(path)


def test_names_with_blanks_and_letters(dosui: Runner, tmp_path: Path) -> None:
    """Blanks, UTF-8, links to folders, by option and by key."""
    (tmp_path / "Grüße 1").mkdir()
    os.symlink("Grüße 1", tmp_path / "a link")
    text = COLUMN.replace("'col'", "'Säule 1'").replace(
        "checkpoint", "directory = 'a link' checkpoint"
    )
    run = dosui(text)
    assert run.status == 0, run.stderr
    assert sorted(os.listdir(tmp_path / "Grüße 1")) == [
        f"Säule 1.{s}" for s in ("restart.h5", "restart.h5.previous", "vtkhdf")
    ]
    run = dosui(text, "--output", "neu & alt", "--restart", "a link/Säule 1.restart.h5")
    assert run.status == 0, run.stderr
    assert (tmp_path / "neu & alt" / "Säule 1.vtkhdf").exists()


@pytest.mark.parametrize(
    "name", ["col.vtkhdf", "col.vtkhdf.part", "col.restart.h5", "col.restart.h5.tmp"]
)
def test_names_that_are_taken(dosui: Runner, tmp_path: Path, name: str) -> None:
    """By a directory or a pipe: said before anything is computed."""
    for make, message in (
        (os.mkdir, "there is a directory of this name"),
        (os.mkfifo, "there is a pipe of this name"),
    ):
        make(tmp_path / name)
        run = dosui(COLUMN, timeout=30)
        assert run.status == 2, run.stdout
        assert f"cannot write ./{name}: {message}" in run.stderr
        assert "particles" not in run.stdout
        shutil.rmtree(tmp_path / name) if (tmp_path / name).is_dir() else os.remove(tmp_path / name)


def test_restart_from_what_is_no_checkpoint(dosui: Runner, tmp_path: Path) -> None:
    """A pipe, a folder, nothing."""
    os.mkfifo(tmp_path / "pipe")
    for name, message in (
        ("pipe", "it is a pipe"),
        (".", "it is a directory"),
        ("none", "there is no file none"),
    ):
        run = dosui(COLUMN, "--restart", name, timeout=30)
        assert run.status == 2, run.stdout
        assert message in run.stderr


# ---------------------------------------------------------------- two runs, signals


def hear_signals() -> None:
    """Also where the tests themselves run under nohup, or in a script's background."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(folder: Path, *launcher: str) -> subprocess.Popen:
    """A long run whose first step is in its file."""
    (folder / "scene.nml").write_text(LONG)
    process = subprocess.Popen(
        [*launcher, str(BIN / "dosui"), "scene.nml"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=hear_signals,
    )
    deadline = time.monotonic() + 60
    while not (folder / "col.vtkhdf").exists():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    time.sleep(0.2)
    return process


@pytest.mark.parametrize("ranks", [1, 2])
def test_second_run_is_refused(dosui: Runner, tmp_path: Path, ranks: int) -> None:
    """While the first lives; a killed one does not count, and another folder is no matter."""
    first = start(tmp_path, *([] if ranks == 1 else ["mpirun", "-n", "2"]))
    try:
        run = dosui(COLUMN, ranks=ranks)
        assert run.status == 2, run.stdout
        assert "error: another run writes the same files: process " in run.stderr
        assert dosui(COLUMN, "--check").status == 0
        assert dosui(COLUMN, "--output", str(tmp_path / "other")).status == 0
    finally:
        first.kill()
        first.wait()
    time.sleep(0.0 if ranks == 1 else 2.0)  # mpirun's ranks notice a little later
    run = dosui(COLUMN, ranks=ranks)
    assert run.status == 0, run.stderr
    assert not (tmp_path / "col.lock").exists()


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGXCPU])
def test_signals_write_a_checkpoint(dosui: Runner, tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C, a terminal that closes, the batch system's limit: status 3, and the run can go on."""
    process = start(tmp_path)
    (tmp_path / "col.restart.h5").unlink(missing_ok=True)
    process.send_signal(number)
    assert process.wait(timeout=60) == 3
    with h5py.File(tmp_path / "col.restart.h5") as file:
        step = int(file["values/clock"][1])
    run = dosui(
        LONG.replace("end_time", f"maximum_steps = {step + 10} end_time"),
        "--restart",
        "col.restart.h5",
    )
    assert run.status == 0, run.stderr
    assert not (tmp_path / "col.lock").exists()


def test_ignored_signals_stay_ignored(tmp_path: Path) -> None:
    """nohup."""
    (tmp_path / "scene.nml").write_text(LONG)
    process = start(tmp_path, "nohup")
    process.send_signal(signal.SIGHUP)
    time.sleep(1.0)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=60) == 3

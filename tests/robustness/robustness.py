"""Tries to break dosui with random scenes, slips of the hand, damaged files and kills.

    build/venv/bin/python tests/robustness/robustness.py --page docs/robustness.md

Every case must end by itself, with an exit status that fits what happened and words that a user
can act on. Cases come from seeds, so each can be repeated: `--only KIND --first SEED --count 1
--keep FOLDER`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from random import Random

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(ROOT / "tests" / "verification"))
from bodies import box, write_binary, write_text  # noqa: E402
from scenes import random_scene  # noqa: E402
from slips import spoiled_bytes, spoiled_text  # noqa: E402

BIN = Path(os.environ.get("DOSUI_BIN", ROOT / "build" / "release" / "bin"))
MEMORY = 4 * 2**30  # bytes of address space: a case that wants more is not clean
SECONDS = 60  # of processor time of each rank: other work on the machine does not count
PATIENCE = 20 * SECONDS  # of wall time: a process that waits for ever
CRASH = re.compile(
    r"Backtrace|SIGSEGV|SIGABRT|SIGFPE|signal \d+|HDF5-DIAG|runtime error|PETSC ERROR|double free"
    r"|corrupt|Traceback|MPI_ABORT|terminate called"
)
ACCEPTED, REFUSED, FINISHED, STOPPED, BROKEN = (
    "accepted",
    "refused with a reason",
    "finished, finite",
    "stopped with a reason",
    "not clean",
)


@dataclass(frozen=True)
class Outcome:
    """What became of a case."""

    kind: str
    seed: int
    state: str
    words: str = ""


def main() -> int:
    """Runs the cases; exit status 1 if one was not clean."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, help="write this page")
    parser.add_argument("--count", type=int, help="cases of each kind")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", choices=[kind.name for kind in KINDS], help="one kind only")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="keep the folders of broken cases here")
    parser.add_argument("--log", type=Path, help="outcomes of earlier pieces, and of this one")
    options = parser.parse_args()
    started = time.monotonic()
    outcomes: list[Outcome] = []
    earlier = read_log(options.log)
    for kind in KINDS:
        if options.only in (None, kind.name):
            count = options.count or kind.count
            seeds = range(options.first, options.first + count)
            outcomes += list(run_cases(kind, seeds, options.workers, options.keep))
            own = Counter(o.state for o in outcomes if o.kind == kind.name)
            print(f"{kind.name}: {dict(own)}", flush=True)
    broken = [o for o in outcomes if o.state == BROKEN]
    for outcome in broken:
        print(f"--- {outcome.kind} {outcome.seed}: {outcome.words}")
    if options.log:
        with options.log.open("a") as log:
            log.writelines(json.dumps(asdict(o)) + "\n" for o in outcomes)
    if options.page:
        write_page(options.page, earlier + outcomes, (time.monotonic() - started) / 60)
    return 1 if broken else 0


def read_log(path: Path | None) -> list[Outcome]:
    """Outcomes of earlier pieces."""
    if path is None or not path.exists():
        return []
    return [Outcome(**json.loads(line)) for line in path.read_text().splitlines()]


def run_cases(
    kind: Kind, seeds: range, workers: int = 2, keep: Path | None = None
) -> Iterator[Outcome]:
    """The outcomes of some cases of one kind."""

    def one(seed: int) -> Outcome:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            try:
                state, words = kind.run(seed, folder)
            except Exception as error:  # a judge that fails found something, too
                state, words = BROKEN, f"{type(error).__name__}: {error}"
            if state == BROKEN and keep:
                shutil.copytree(folder, keep / f"{kind.name}-{seed}", dirs_exist_ok=True)
            return Outcome(kind.name, seed, state, words)

    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(one, seeds)


# ---------------------------------------------------------------------- one process


def dosui(folder: Path, *words: str, ranks: int = 1) -> tuple[int, str]:
    """Exit status (124: too slow) and all output of one process."""
    command = [str(BIN / "dosui"), *words]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))  # SIGKILL, not SIGXCPU
        if ranks == 1:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    with subprocess.Popen(
        command,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        preexec_fn=limit,
        start_new_session=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    ) as process:
        try:
            output, _ = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return 124, f"took more than {PATIENCE} s"
    if process.returncode in (-signal.SIGKILL, 128 + signal.SIGKILL):
        return 124, f"took more than {SECONDS} s of processor time"
    return process.returncode, output.decode("utf-8", "replace")


def complaint(status: int, output: str, allowed: tuple[int, ...]) -> str:
    """What is not clean about the end of a process; empty if it is."""
    crash = CRASH.search(output)
    if crash:
        return f"status {status}: {output[max(0, crash.start() - 200) : crash.end() + 300]}"
    if status not in allowed:
        return f"status {status}: {output[-500:]}"
    if status != 0 and not re.search(r"(?m)^(error: |\S.*?:( |\d+:))", output):
        return f"status {status} without a reason: {output[-500:]}"
    return ""


def judge_check(folder: Path, scene: str, *words: str) -> tuple[str, str]:
    """A scene that is only checked."""
    status, output = dosui(folder, "--check", scene, *words)
    problem = complaint(status, output, (0, 2))
    if problem:
        return BROKEN, problem
    return (ACCEPTED, "") if status == 0 else (REFUSED, output)


def judge_run(folder: Path, *words: str, ranks: int = 1) -> tuple[str, str]:
    """A run: what it says it finished must be finite."""
    status, output = dosui(folder, *words, ranks=ranks)
    problem = complaint(status, output, (0, 1, 2))
    if problem:
        return BROKEN, problem
    for result in folder.glob("*.vtkhdf"):
        problem = unsound(result)
        if problem:
            return BROKEN, f"status {status}: {problem}"
    return {0: (FINISHED, ""), 1: (STOPPED, output), 2: (REFUSED, output)}[status]


def unsound(path: Path) -> str:
    """What is not finite in a result file; empty if all is."""
    with h5py.File(path) as file:
        vtk = file["VTKHDF"]
        n = int(vtk["Steps"].attrs["NSteps"])
        last = int(sum(vtk["NumberOfPoints"][:n]))
        for name, data in vtk["PointData"].items():
            if not np.all(np.isfinite(data[:last])):
                return f"{name} is not finite"
            if name == "porosity" and not np.all(data[:last] > 0.0):
                return "porosity is not positive"
    return ""


# ---------------------------------------------------------------------- kinds of cases


def check_random(seed: int, folder: Path) -> tuple[str, str]:
    """A random scene is checked."""
    (folder / "scene.nml").write_text(random_scene(seed))
    return judge_check(folder, "scene.nml")


def run_random(seed: int, folder: Path) -> tuple[str, str]:
    """A random scene runs a few steps, every third on two ranks."""
    (folder / "scene.nml").write_text(random_scene(seed))
    return judge_run(folder, "scene.nml", ranks=2 if seed % 3 == 0 else 1)


def check_slips(seed: int, folder: Path) -> tuple[str, str]:
    """A scene, shipped or random, with slips of the hand."""
    random = Random(seed)
    shipped = sorted((ROOT / "input").glob("*/*.nml"))
    is_shipped = random.random() < 0.5
    text = random.choice(shipped).read_text() if is_shipped else random_scene(seed)
    text, _ = spoiled_text(text, random)
    (folder / "scene.nml").write_text(text)
    return judge_check(folder, "scene.nml")


def check_bytes(seed: int, folder: Path) -> tuple[str, str]:
    """A scene file whose bytes are damaged."""
    random = Random(seed)
    data, _ = spoiled_bytes(random_scene(seed % 50).encode(), random)
    (folder / "scene.nml").write_bytes(data)
    return judge_check(folder, "scene.nml")


TABLES = """&scene dimension = {dimension} water = 'none' integrator = 'explicit' /
&grid spacing = 0.25 /
&time end_time = 1.0 /
&material name = 'soil' young_modulus = 1e7 /
&region name = 'body' material = 'soil' {shape} /
{more}
"""


def check_tables(seed: int, folder: Path) -> tuple[str, str]:
    """A body's triangles, a table of particles or a base motion with damage or slips."""
    random = Random(seed)
    kind = random.choice(("stl", "csv", "motion"))
    shape, more, dimension = "box_min = 0, 0 box_max = 1, 1", "", 2
    if kind == "stl":
        dimension, shape = 3, "shape = 'stl' stl_file = 'data'"
        write_text(folder / "data", box((0, 0, 0), (1, 1, 1)))
        text = (folder / "data").read_text()
    elif kind == "csv":
        shape += " particle_file = 'data'"
        rows = [f"{0.125 + 0.25 * i},{0.125 + 0.25 * j},0.0625" for i in range(4) for j in range(4)]
        text = "x,z,volume\n" + "\n".join(rows) + "\n"
    else:
        more = "&base_motion acceleration = 1, 0 file = 'data' /"
        text = "".join(f"{0.1 * k:.1f} {0.3 * (-1) ** k:.2f}\n" for k in range(11))
    data = text.encode()
    if kind == "stl" and random.random() < 0.5:
        write_binary(folder / "data", box((0, 0, 0), (1, 1, 1)))
        data, _ = spoiled_bytes((folder / "data").read_bytes(), random)
    elif random.random() < 0.5:
        data, _ = spoiled_bytes(data, random)
    else:
        data = spoiled_text(text, random)[0].encode()
    (folder / "data").write_bytes(data)
    scene = TABLES.format(dimension=dimension, shape=shape, more=more)
    (folder / "scene.nml").write_text(scene)
    return judge_check(folder, "scene.nml")


def restart_damaged(seed: int, folder: Path) -> tuple[str, str]:
    """A checkpoint with damage must be refused: nothing of it may go unnoticed."""
    random = Random(seed)
    small = (ROOT / "input/terzaghi/scene_2d.nml").read_text()
    small = small.replace("&output", "&output checkpoint_steps = 20 ", 1)
    small = small.replace("&time", "&time maximum_steps = 40 ", 1)
    (folder / "scene.nml").write_text(small)
    status, output = dosui(folder, "scene.nml")
    checkpoints = sorted(folder.glob("*.restart.h5"))
    if status != 0 or not checkpoints:
        return BROKEN, f"no checkpoint: {output[-300:]}"
    data = checkpoints[0].read_bytes()
    damaged, kind = spoiled_bytes(data, random)
    if damaged == data:
        return REFUSED, "no damage"
    checkpoints[0].write_bytes(damaged)
    state, words = judge_run(folder, "--restart", checkpoints[0].name, "scene.nml")
    if state != REFUSED and state != STOPPED:
        return BROKEN, f"{kind}: {state} {words}"
    return REFUSED, words


def kill_run(seed: int, folder: Path) -> tuple[str, str]:
    """A run that is killed leaves files that open, and a checkpoint that goes on."""
    random = Random(seed)
    text = (ROOT / "input/terzaghi/scene_1d.nml").read_text()
    often = text.replace("&output", "&output checkpoint_steps = 20 ", 1)
    (folder / "scene.nml").write_text(often)
    command = [str(BIN / "dosui"), "scene.nml"]
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        time.sleep(random.uniform(0.1, 1.5))
        process.kill()
    for result in folder.glob("*.vtkhdf"):
        if "VTKHDF" not in h5py.File(result):
            return BROKEN, "a result file without results"
        problem = unsound(result)
        if problem:
            return BROKEN, problem
    checkpoints = sorted(folder.glob("*.restart.h5"))
    if not checkpoints:
        return FINISHED, "killed before the first checkpoint"
    (folder / "scene.nml").write_text(text)
    return judge_run(folder, "--restart", checkpoints[0].name, "scene.nml")


@dataclass(frozen=True)
class Kind:
    """One kind of trial."""

    name: str
    what: str
    run: Callable[[int, Path], tuple[str, str]]
    count: int


KINDS = (
    Kind("check", "random scenes, checked", check_random, 1000),
    Kind("run", "random scenes, a few steps, one or two ranks", run_random, 200),
    Kind("slips", "scenes with slips of the hand, checked", check_slips, 1500),
    Kind("bytes", "scenes with damaged bytes, checked", check_bytes, 500),
    Kind("tables", "triangles, particle tables and base motions with damage", check_tables, 600),
    Kind("restart", "checkpoints with damage", restart_damaged, 150),
    Kind("kill", "runs that are killed, then continued", kill_run, 40),
)


# ---------------------------------------------------------------------- the page

PAGE = """<!-- Written by `tests/robustness/robustness.py`: do not edit. -->

# Robustness

Random scenes, slips of the hand, damaged files and kills: {n} cases of seeds {seeds},
on {day} in {minutes:.0f} minutes. A case is clean if the program ends by itself within a minute of
processor time, without a crash and within 4 GiB, with an exit status that fits (0 finished or
valid, 1 stopped while running, 2 refused), says why if it is not 0, and leaves result files in
which everything is finite and porosities are positive. A damaged checkpoint must be refused.

{table}

{broken}

Again, by other seeds: `build/venv/bin/python tests/robustness/robustness.py --first SEED
--count N --page docs/robustness.md` (without `--count` 3990 cases, `--log FILE` adds up). One case:
`… robustness.py --only slips --first 17 --count 1 --keep /tmp/broken`. A short member of each
kind runs in every test run (`tests/verification/test_robustness.py`).
"""


def write_page(path: Path, outcomes: list[Outcome], minutes: float) -> None:
    """The counts in Markdown."""
    seeds = [o.seed for o in outcomes]
    states = (ACCEPTED, FINISHED, STOPPED, REFUSED, BROKEN)
    rows = ["| trial | tried | " + " | ".join(states) + " |", "|---|---|" + "---|" * len(states)]
    for kind in KINDS:
        own = Counter(o.state for o in outcomes if o.kind == kind.name)
        cells = [str(own[state]) if own[state] else "0" for state in states]
        rows.append(f"| {kind.what} | {sum(own.values())} | " + " | ".join(cells) + " |")
    broken = [
        f"* {o.kind} {o.seed}: {o.words.splitlines()[0]}" for o in outcomes if o.state == BROKEN
    ]
    path.write_text(
        PAGE.format(
            n=len(outcomes),
            day=date.today().isoformat(),
            minutes=minutes,
            seeds=f"{min(seeds)} to {max(seeds)}",
            table="\n".join(rows),
            broken="\n".join(broken) or "None was unclean.",
        )
    )


if __name__ == "__main__":
    sys.exit(main())

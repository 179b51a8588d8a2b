"""Damages checkpoints and result files at random places, and looks what dosui and dosui-post say.

    python tests/verification/damage_outputs.py --members 300 --seed 1

Right is: a message that names the file and exit status 1 or 2, or (result files have room that
holds nothing) exactly what the undamaged file gives. Crashes, hangs and other numbers are wrong.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
from conftest import BIN, ROOT, scene_text

CHECKPOINT, RESULT = "box.restart.h5", "box.vtkhdf"
KINDS = ("bit", "byte", "eight bytes", "zeros", "noise", "cut", "swap")


def scene(maximum_steps: int = 0) -> str:
    """A small column that takes a moment; with checkpoint and four outputs."""
    text = scene_text("terzaghi/scene_1d.nml", spacing="0.05", end_time="0.08")
    text = text.replace("output_times = 4.905, 9.81, 19.62, 49.05", "output_interval = 0.02")
    text = text.replace("name = 'terzaghi_1d'", "name = 'box'\n  history_interval = 0.001")
    if maximum_steps:
        text = text.replace("  end_time", f"  maximum_steps = {maximum_steps}\n  end_time", 1)
    return text


def damage(data: bytes, kind: str, random: np.random.Generator) -> bytes:
    """The bytes of a file with one fault; never equal to what they were."""
    size = len(data)
    wrong = np.frombuffer(data, dtype=np.uint8).copy()
    first = int(random.integers(size))
    if kind == "bit":
        wrong[first] ^= 1 << int(random.integers(8))
    elif kind == "byte":
        wrong[first] ^= int(random.integers(1, 256))
    elif kind == "eight bytes":
        wrong[first : first + 8] ^= random.integers(1, 256, len(wrong[first : first + 8])).astype(
            np.uint8
        )
    elif kind == "zeros":
        wrong[first : first + int(2 ** random.uniform(3, 13))] = 0
    elif kind == "noise":
        part = wrong[first : first + int(2 ** random.uniform(3, 13))]
        part[:] = random.integers(0, 256, len(part))
    elif kind == "cut":
        wrong = wrong[:first]
    else:
        length = min(int(2 ** random.uniform(3, 12)), size - first)
        other = int(random.integers(size - length + 1))
        part = wrong[first : first + length].copy()
        wrong[first : first + length] = wrong[other : other + length]
        wrong[other : other + length] = part
    if wrong.tobytes() == data:
        return damage(data, kind, random)
    return wrong.tobytes()


def run(command: list[str], folder: Path) -> tuple[int, str]:
    """Exit status (negative: a signal; 124: a hang) and what was printed."""
    # glibc's and HDF5's own words do not matter, only how it ends
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, timeout=60)
    except subprocess.TimeoutExpired:
        return 124, "hang"
    return done.returncode, (done.stdout + done.stderr).decode(errors="replace")


def content(path: Path) -> list[bytes]:
    """Everything that a result file shows."""
    shown = []
    with h5py.File(path) as file:
        vtk = file["VTKHDF"]
        n = int(vtk["Steps"].attrs["NSteps"])
        shown += [np.asarray(vtk["Steps/Values"][:n]).tobytes()]
        count, offset = vtk["NumberOfPoints"][:n], vtk["Steps/PointOffsets"][:n]
        for step in range(n):
            rows = slice(int(offset[step]), int(offset[step] + count[step]))
            shown += [np.asarray(vtk["Points"][rows]).tobytes()]
            shown += [vtk["PointData"][name][rows].tobytes() for name in sorted(vtk["PointData"])]
        history = file["History"]
        rows = slice(0, int(history.attrs["n_entries"]))
        shown += [history[name][rows].tobytes() for name in sorted(history)]
    return shown


class Sweep:
    """An undamaged pair of files, and what becomes of damaged ones."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        (folder / "stop.nml").write_text(scene(maximum_steps=120))
        (folder / "scene.nml").write_text(scene())
        assert run([str(BIN / "dosui"), "stop.nml"], folder)[0] == 0
        self.checkpoint = (folder / CHECKPOINT).read_bytes()
        self.result = (folder / RESULT).read_bytes()
        self.shown = content(folder / RESULT)
        assert self.go_on("whole", self.checkpoint, self.result)[0] == 0
        self.continued = content(folder / "whole" / RESULT)

    def go_on(self, name: str, checkpoint: bytes, result: bytes) -> tuple[int, str]:
        """Restarts from a pair of files in a folder of its own."""
        work = self.folder / name
        work.mkdir()
        (work / CHECKPOINT).write_bytes(checkpoint)
        (work / RESULT).write_bytes(result)
        command = [str(BIN / "dosui"), "scene.nml", "--output", name]
        return run([*command, "--restart", f"{name}/{CHECKPOINT}"], self.folder)

    def check_checkpoint(self, member: int) -> str:
        """One damaged checkpoint: 'refused', or what is wrong."""
        random = np.random.default_rng([self.seed, 1, member])
        kind = KINDS[member % len(KINDS)]
        wrong = damage(self.checkpoint, kind, random)
        name = f"checkpoint{member}"
        status, text = self.go_on(name, wrong, self.result)
        untouched = (self.folder / name / RESULT).read_bytes() == self.result
        shutil.rmtree(self.folder / name)
        if status == 2 and CHECKPOINT in text and "damaged" in text and untouched:
            return "refused"
        return f"WRONG checkpoint {member} ({kind}): status {status}, {text[-300:]}"

    def check_result(self, member: int) -> str:
        """One damaged result file: 'refused', 'unharmed', or what is wrong."""
        random = np.random.default_rng([self.seed, 2, member])
        kind = KINDS[member % len(KINDS)]
        wrong = damage(self.result, kind, random)
        name = f"result{member}"
        status, text = self.go_on(name, self.checkpoint, wrong)
        verdict = f"WRONG result {member} ({kind}) restarted: status {status}, {text[-300:]}"
        if status in (1, 2) and RESULT in text and "error" in text:
            verdict = "refused"
        elif status == 0 and content(self.folder / name / RESULT) == self.continued:
            verdict = "unharmed"
        elif status == 0:
            verdict = f"WRONG result {member} ({kind}): restarted with other numbers"
        shutil.rmtree(self.folder / name)
        return verdict

    def check_post(self, member: int) -> str:
        """The same file read by dosui-post."""
        random = np.random.default_rng([self.seed, 2, member])
        kind = KINDS[member % len(KINDS)]
        path = self.folder / f"post{member}.vtkhdf"
        path.write_bytes(damage(self.result, kind, random))
        command = [sys.executable, "-m", "dosui_post", "check", str(path)]
        status, text = run(command, self.folder)
        verdict = f"WRONG result {member} ({kind}) in dosui-post: status {status}, {text[-300:]}"
        if status == 1 and path.name in text and "Traceback" not in text:
            verdict = "refused"
        elif status == 0 and content(path) == self.shown:
            verdict = "unharmed"
        path.unlink()
        return verdict


def main() -> int:
    """The sweep as a command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--members", type=int, default=300, help="damaged files of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    os.environ["PYTHONPATH"] = str(ROOT / "postprocess" / "src")
    n_wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        sweep = Sweep(Path(folder), options.seed)
        checks = {
            "checkpoints, dosui": sweep.check_checkpoint,
            "results, dosui": sweep.check_result,
            "results, dosui-post": sweep.check_post,
        }
        for title, check in checks.items():
            verdicts = [check(member) for member in range(options.members)]
            wrong = [verdict for verdict in verdicts if verdict.startswith("WRONG")]
            counts = Counter("wrong" if v.startswith("WRONG") else v for v in verdicts)
            print(f"{title}: {options.members} damaged, {dict(counts)}")
            print("\n".join(wrong))
            n_wrong += len(wrong)
    return 1 if n_wrong else 0


if __name__ == "__main__":
    sys.exit(main())

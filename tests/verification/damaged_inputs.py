"""Damages input files of every kind and compares dosui's verdict with an independent one.

python tests/verification/damaged_inputs.py --count 300 --seed 1     # prints how many were refused
"""

from __future__ import annotations

import argparse
import os
import random
import re
import struct
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

BIN = Path(os.environ.get("DOSUI_BIN", Path(__file__).parents[2] / "build/release/bin"))
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d{1,8})?")
WORDS = [
    "nan",
    "inf",
    "-Infinity",
    "/",
    "2*3",
    ",,",
    "1.5e",
    "1.5d+",
    "--3",
    "1e999",
    "1e-300",
    "abc",
    "0x10",
]
WORDS += [
    "1_8",
    ";",
    "#",
    "\t",
    "\r",
    "\r\n",
    "\n",
    "\0",
    "\x1b[31m",
    "9" * 120,
    "5",
    "-",
    ".",
    "e5",
    "\xff",
    "!",
]

SOIL = "&material name='s' young_modulus=1e6 porosity=0.3 hydraulic_conductivity=1e-5 /\n"
DRY = SOIL.replace("hydraulic_conductivity=1e-5", "")
TABLE_SCENE = f"""&scene dimension=2 integrator='explicit' /
&grid spacing=0.1 /
&time end_time=1.0 maximum_steps=3 /
{SOIL}&region name='b' material='s' box_min=0,0 box_max=1,1 particle_file='damaged' /
&surface name='t' region='b' face='z+' /
&hydraulic_condition surface='t' kind='head' value=1.0 /
"""
MOTION_SCENE = f"""&scene dimension=1 water='none' integrator='explicit' /
&grid spacing=0.1 /
&time end_time=1.0 /
{DRY}&region name='b' material='s' box_min=0 box_max=1 /
&surface name='t' region='b' face='z-' /
&mechanical_condition surface='t' kind='fixed' /
&base_motion acceleration=1.0 file='damaged' /
"""
BODY_SCENE = f"""&scene dimension=3 water='none' integrator='explicit' /
&grid spacing=0.5 /
&time end_time=1.0 /
{DRY}&region name='b' material='s' shape='stl' stl_file='damaged' /
&surface name='t' region='b' face='all' /
&mechanical_condition surface='t' kind='fixed' /
"""


def number(word: str) -> float | None:
    """A number as Fortran and people write it, None for everything else."""
    if len(word) > 100 or not NUMBER.fullmatch(word):
        return None
    value = float(re.sub("[dD]", "e", word))
    return value if abs(value) < 1.8e308 else None


def rows(data: bytes) -> list[list[str]] | None:
    """Fields of the lines of a table; None: no text."""
    text = data.decode("latin-1")
    if "\0" in text or text[:2] in ("\xff\xfe", "\xfe\xff"):
        return None
    text = text.removeprefix("\xef\xbb\xbf")
    found = []
    for line in re.split("\r\n|\r|\n", text):
        parts = [part.strip(" \t") for part in re.split("[,;]", line.split("#")[0])]
        if not parts[-1]:
            parts.pop()  # what follows the last comma is no field
        fields = [word for part in parts for word in (re.split("[ \t]+", part) if part else [""])]
        if fields:
            found.append(fields)
    return found


def table_is_good(data: bytes) -> bool:
    """Are these particles that fill the unit square?"""
    table = rows(data)
    if not table or len(table[0]) != 3:
        return False
    if any(len(row) != 3 for row in table):
        return False
    values = [[number(word) for word in row] for row in table]
    if any(value is None for row in values for value in row):
        return False
    if any(not (0 <= x <= 1 and 0 <= z <= 1 and 0 < volume <= 1e15) for x, z, volume in values):
        return False
    total = sum(row[2] for row in values)
    if min(row[2] for row in values) < 1e-6 * total / len(values) or abs(total - 1) > 0.01:
        return False
    return len({(row[0], row[1]) for row in values}) == len(values)


def motion_is_good(data: bytes) -> bool:
    """Are these times that increase, each with a factor?"""
    table = rows(data)
    if not table or any(len(row) != 2 for row in table):
        return False
    values = [[number(word) for word in row] for row in table]
    if any(value is None or abs(value) > 1e15 for row in values for value in row):
        return False
    return all(b[0] > a[0] for a, b in pairwise(values))


def table_of_particles() -> bytes:
    """10 x 10 particles in the unit square."""
    return "".join(
        f"{(i + 0.5) / 10!r}, {(j + 0.5) / 10!r}, 0.01\n" for i in range(10) for j in range(10)
    ).encode()


def motion() -> bytes:
    """A record."""
    return "".join(f"{0.01 * k:.2f} {(-1) ** k * 0.1 * k:.4e}\n" for k in range(30)).encode()


def box(is_binary: bool) -> bytes:
    """A box of twelve triangles."""
    corner = [(x, y, z) for z in (0.0, 2.0) for y in (0.0, 1.0) for x in (0.0, 1.0)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [(a, b, c) for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    if is_binary:
        records = [
            struct.pack("<12fH", 0, 0, 0, *(v for k in t for v in corner[k]), 0) for t in triangles
        ]
        return b"box".ljust(80) + struct.pack("<I", len(records)) + b"".join(records)
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*corner[k]) for k in t)
        + "endloop\nendfacet\n"
        for t in triangles
    ]
    return ("solid box\n" + "".join(facets) + "endsolid box\n").encode()


def damaged(data: bytes, dice: random.Random) -> bytes:
    """Up to three flipped bits, lost or doubled pieces, foreign words, early ends, line ends."""
    for _ in range(dice.randint(1, 3)):
        at = dice.randrange(len(data) + 1)
        size = dice.choice([1, 1, 2, 5, 30])
        kind = dice.randrange(8)
        if kind == 0 and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << dice.randrange(8))]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[at + size :]
        elif kind == 2:
            data = data[: at + size] + data[at:]
        elif kind == 3:
            data = data[: dice.choice([at, len(data) - 1])]
        elif kind == 4:
            data = data.replace(b"\n", dice.choice([b"\r", b"\r\n", b"\n\n"]))
        elif kind == 5:
            data = b"\xef\xbb\xbf" + data
        else:  # a word for a word, or within one
            word = dice.choice(WORDS).encode("latin-1")
            places = [m.span() for m in re.finditer(rb"[^\s,]+", data)]
            first, last = dice.choice(places) if places and kind == 6 else (at, at)
            data = data[:first] + word + data[last:]
    return data


KINDS: dict[str, tuple[str, Callable[[], bytes], str, Callable[[bytes], bool] | None]] = {
    "particles": (TABLE_SCENE, table_of_particles, "particle_file", table_is_good),
    "motion": (MOTION_SCENE, motion, "&base_motion file", motion_is_good),
    "stl_text": (BODY_SCENE, lambda: box(False), "stl_file", None),
    "stl_binary": (BODY_SCENE, lambda: box(True), "stl_file", None),
    "scene": (MOTION_SCENE, MOTION_SCENE.encode, "scene.nml", None),
}


def try_one(kind: str, seed: int, folder: Path) -> str:
    """'accepted' or 'refused' if dosui is right, else what is wrong."""
    scene, make, culprit, is_good = KINDS[kind]
    data = damaged(make(), random.Random(f"{kind} {seed}"))
    if is_good:
        data = data.replace(b'"', b"").replace(b"'", b"")  # the other reader knows no quotes
    (folder / "damaged").write_bytes(motion() if kind == "scene" else data)
    (folder / "scene.nml").write_bytes(data if kind == "scene" else scene.encode())
    try:
        run = subprocess.run(
            [str(BIN / "dosui"), "--check", "scene.nml"],
            cwd=folder,
            capture_output=True,
            timeout=60,
        )
    except subprocess.TimeoutExpired:
        return "hangs"
    error = run.stderr.decode("latin-1")
    if run.returncode not in (0, 2):
        return f"status {run.returncode}: {error[-300:]}"
    blamed = run.returncode == 2 and culprit in error
    if is_good and blamed == is_good(data):
        return f"{'refused' if blamed else 'accepted'} wrongly: {error[-300:]}"
    if run.returncode == 2 and not error.strip():
        return "refused without a word"
    return "refused" if run.returncode == 2 else "accepted"


def main() -> None:
    """Counts, and every wrong verdict with its seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="files of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for kind in KINDS:
        counts: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as folder:
            for seed in range(options.seed, options.seed + options.count):
                verdict = try_one(kind, seed, Path(folder))
                if verdict not in ("accepted", "refused"):
                    print(f"{kind} seed {seed}: {verdict}")
                    verdict = "wrong"
                counts[verdict] += 1
        print(kind, dict(counts))


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Rules of the house that a machine can check.

lint.py [CHECK ...]      without arguments: all

rooms       which room of src/ may use which (docs/developer/design.md), and foreign modules
sources     lines, names, `only`, `private`, no stop and no preprocessor
names       integrators, soils and walls are asked for facts, not compared by name outside their own
            modules
units       every real that a room shows to others has its unit (docstrings.py)
choices     values in comments of dosui_scene are the choices of its keys (docstrings.py)
references  keys of docs/refs.bib are cited, cited keys are defined (documents.py)
links       relative links of pages lead to files and headings
contents    tables of contents are equal to the headings
widths      lines and cells of pages
site        the pages of docs/ as a site (mkdocs.yml, docs/site), without warnings
fprettify   layout; fortitude: Fortran linter; ruff: Python linter and layout
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import documents
from docstrings import check_choices, check_units, split_comment

ROOT = Path(__file__).resolve().parents[2]
LINE_LENGTH = 100

# Room: the rooms it may use beside itself. Upwards never.
MAY_USE = {
    "base": "",
    "dimension": "base",
    "geometry": "base",
    "parallel": "base",
    "material": "base dimension geometry",
    "grid": "base dimension parallel",
    "particles": "base dimension geometry parallel material grid",
    "mechanics": "base dimension parallel material grid particles",
    "hydraulics": "base dimension parallel material grid particles",
    "solvers": "base parallel",
    "integrators": "base dimension parallel material grid particles mechanics hydraulics solvers",
    "io": "base dimension geometry parallel material grid particles solvers",
    "app": "base dimension parallel material grid particles mechanics hydraulics solvers"
    " integrators io",
}
# Modules that count as another room than their folder: the scene is types with defaults, soils
# among them, which most rooms are built from; the build information is constants.
COUNTS_AS = {"dosui_scene": "material", "dosui_wall": "material", "dosui_build_info": "base"}
# Foreign modules and the only room that may use them.
FOREIGN = {"mpi_f08": "parallel", "mpi": "nobody", "hdf5": "io", "h5lt": "io"}
INTRINSIC = {
    "iso_fortran_env",
    "iso_c_binding",
    "ieee_arithmetic",
    "ieee_exceptions",
    "ieee_features",
}

USE = re.compile(r"\s*use\b\s*(,\s*intrinsic\s*)?(::)?\s*(\w+)\s*(,\s*only\s*:)?", re.I)
MODULE = re.compile(r"\s*module\s+(?!procedure\b)(\w+)\s*$", re.I)
STOP = re.compile(r"(^|[;)\s])(error\s+)?stop\b(?!\s*[=%(])", re.I)


def code_of(line: str) -> str:
    """The line without comment and without the text of its strings."""
    result, quote = "", ""
    for character in line:
        if quote:
            if character == quote:
                quote = ""
                result += character
        elif character in "'\"":
            quote = character
            result += character
        elif character == "!":
            break
        else:
            result += character
    return result.rstrip()


def fortran_files() -> list[Path]:
    return sorted((ROOT / "src").glob("*/*.f90"))


def room_of(path: Path) -> str:
    return COUNTS_AS.get(path.stem, path.parent.name)


def check_rooms() -> list[str]:
    rooms = {path.stem: room_of(path) for path in fortran_files()}
    rooms |= {"dosui_dimension": "dimension", **COUNTS_AS}
    problems = []
    for path in fortran_files():
        room = room_of(path)
        if room not in MAY_USE:
            problems.append(f"{path}:1: the room '{room}' is not in the table of {__file__}")
            continue
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            match = USE.match(code_of(line))
            if not match or match.group(1):
                continue
            used = match.group(3).lower()
            if used in FOREIGN and room != FOREIGN[used]:
                problems.append(f"{path}:{number}: only {FOREIGN[used]} may use {used}")
            elif used in rooms and rooms[used] not in [room, *MAY_USE[room].split()]:
                problems.append(f"{path}:{number}: {room} may not use {rooms[used]} ({used})")
            elif used not in rooms and used not in FOREIGN and used not in INTRINSIC:
                problems.append(f"{path}:{number}: unknown module {used}")
    return problems


def check_sources() -> list[str]:
    problems = []
    for path in fortran_files():
        text = path.read_text()
        lines = text.splitlines()
        modules = []
        for number, line in enumerate(lines, start=1):
            here, code = f"{path}:{number}", code_of(line)
            if len(line) > LINE_LENGTH:
                problems.append(f"{here}: {len(line)} columns, more than {LINE_LENGTH}")
            if line != line.rstrip() or "\t" in line:
                problems.append(f"{here}: tab or blanks at the end of the line")
            if STOP.search(code):
                problems.append(f"{here}: stop: return an error_t instead")
            if line.startswith("#"):
                problems.append(f"{here}: preprocessor line")
            if (match := USE.match(code)) and not match.group(4):
                problems.append(f"{here}: use without only")
            if match := MODULE.match(code):
                modules.append(match.group(1))
        stem = re.sub(r"^(dosui_dimension)_[123]d$", r"\1", path.stem)
        if modules:
            if modules != [stem]:
                problems.append(f"{path}:1: must hold one module of its name, holds {modules}")
            if not re.search(r"^  private$", text, re.M):
                problems.append(f"{path}:1: `private` is missing")
        elif not re.search(r"^program dosui", text, re.M):
            problems.append(f"{path}:1: neither module nor program")
        if not re.search(r"^  implicit none$", text, re.M):
            problems.append(f"{path}:1: `implicit none` is missing")
    return problems


# What is known by a name: the names, constants for them, the modules that may compare them, and
# those left that still do; no other may begin.
KNOWN_BY_NAME = {
    "integrator": (
        "explicit semi_implicit quasi_static",
        "explicit semi_implicit quasi_static automatic",
        "dosui_integrators dosui_integrator_traits",
        "",
    ),
    "soil": (
        "linear_elastic mohr_coulomb drucker_prager cam_clay dafalias_manzari",
        "",
        "dosui_materials",
        "",
    ),
    "wall": (
        "roller fixed normal_velocity plate",
        "",
        "dosui_wall",
        "dosui_condition_keys",
    ),
}
# `x == 'name'`, `'name' /= x`, `case ('name', ...)`; strings stay, comments go.
COMPARISON = r"(==|/=)\s*{0}|{0}\s*(==|/=)|\bcase\s*\([^)]*{0}"


def check_names() -> list[str]:
    problems = []
    for what, (names, constants, owners, left) in KNOWN_BY_NAME.items():
        of_names = comparisons(rf"['\"]{name}\s*['\"]" for name in names.split())
        of_constants = comparisons(rf"\b{name}\b(?!\s*[(%])" for name in constants.split())
        found = set()
        for path in fortran_files():
            for number, line in enumerate(path.read_text().splitlines(), start=1):
                if not (
                    of_names.search(split_comment(line)[0]) or of_constants.search(code_of(line))
                ):
                    continue
                found.add(path.stem)
                if path.stem not in owners.split() + left.split():
                    problems.append(f"{path}:{number}: compares names of {what}s: ask for a fact")
        for module in set(left.split()) - found:
            problems.append(f"{__file__}:1: {module} compares no {what}s any more: cross it out")
    return problems


def comparisons(words: Iterable[str]) -> re.Pattern[str]:
    """Comparisons with any of these words; with none, what no line holds."""
    choice = "|".join(words)
    return re.compile(COMPARISON.format(f"(?:{choice})") if choice else r"(?!)", re.I)


def tool(*command: str) -> tuple[int, str]:
    """A program of this Python's environment: (exit status, output)."""
    program = Path(sys.executable).parent / command[0]
    if not program.exists():
        return 1, f"{command[0]} is not installed beside {sys.executable}"
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [program, *command[1:]], capture_output=True, text=True, cwd=ROOT, env=environment
    )
    return done.returncode, (done.stdout + done.stderr).strip()


def check_fprettify() -> list[str]:
    files = [str(path.relative_to(ROOT)) for path in fortran_files()]
    files += [str(p.relative_to(ROOT)) for p in sorted((ROOT / "tests/support").glob("*.f90"))]
    status, output = tool("fprettify", "--silent", "--diff", *files)
    return [output + "\nfprettify FILE puts this right"] if status or output else []


def check_fortitude() -> list[str]:
    status, output = tool("fortitude", "check", "--output-format", "concise", "src")
    return [output] if status else []


def check_ruff() -> list[str]:
    folders = [name for name in ("docs", "postprocess", "tests") if (ROOT / name).is_dir()]
    checks = tool("ruff", "check", "--no-cache", "--output-format", "concise", *folders)
    layout = tool("ruff", "format", "--no-cache", "--diff", *folders)
    return [output for status, output in (checks, layout) if status]


def check_site() -> list[str]:
    # Without --quiet: with it MkDocs counts no warnings, and --strict means nothing.
    status, output = tool("mkdocs", "build", "--strict", "--site-dir", "build/site-check")
    return [output] if status or "WARNING" in output else []


CHECKS = {
    "rooms": check_rooms,
    "sources": check_sources,
    "names": check_names,
    "units": lambda: check_units(ROOT),
    "choices": lambda: check_choices(ROOT),
    "references": lambda: documents.check_references(ROOT),
    "links": lambda: documents.check_links(ROOT),
    "contents": lambda: documents.check_contents(ROOT),
    "widths": lambda: documents.check_widths(ROOT),
    "site": check_site,
    "fprettify": check_fprettify,
    "fortitude": check_fortitude,
    "ruff": check_ruff,
}


def main(names: list[str]) -> int:
    unknown = [name for name in names if name not in CHECKS]
    if unknown:
        print(__doc__, file=sys.stderr)
        return 2
    failed = False
    for name in names or CHECKS:
        problems = CHECKS[name]()
        for problem in problems:
            print(problem.replace(f"{ROOT}/", ""))
        print(f"{name}: {'ok' if not problems else 'NOT ok'}")
        failed |= bool(problems)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

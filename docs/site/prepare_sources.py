"""Copies src for FORD: prepare_sources.py OUTPUT

Three things stand differently in the copy. The text before a module, which says what it is for,
comes after its first line, where FORD looks for it. Text of docstrings is escaped, so that
`2**ndim` and `<name>` stay what they are, and `Kernel:` is no key of FORD's; lines that are set in
stay formulas. Of the three files of `dimension/` the one for 3-D is taken.
"""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNIT = re.compile(r"\s*(module\s+(?!procedure\b)\w+|program\s+\w+)\s*$", re.I)
DOCSTRING = re.compile(r"((?:[^'\"!]|'[^']*'|\"[^\"]*\")*)!!(.*)")


def escaped(text: str) -> str:
    """Markdown that shows a line of a docstring as it is, spans of `code` as code."""
    if text.startswith("     "):  # a formula
        return text
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a single `
        parts = [text.replace("`", "'")]
    for k in range(0, len(parts), 2):
        plain = html.escape(parts[k], quote=False)
        parts[k] = re.sub(r"([\\*_|$#])", r"\\\1", plain).replace("[[", "[ [")
    return re.sub(r"^(\s*[\w-]+):", r"\1&#58;", "`".join(parts))


def prepared(text: str) -> str:
    lines = text.splitlines()
    first = next((k for k, line in enumerate(lines) if UNIT.match(line)), 0)
    if all(not line or line.startswith("!!") for line in lines[:first]):
        head = ["  " + line for line in lines[:first] if line]
        lines = [lines[first], *head, *lines[first + 1 :]]
    result = []
    for line in lines:
        match = DOCSTRING.fullmatch(line)
        result.append(f"{match.group(1)}!!{escaped(match.group(2))}" if match else line)
    return "\n".join(result) + "\n"


def main(output: Path) -> None:
    for path in sorted((ROOT / "src").glob("*/*.f90")):
        if re.search(r"_[12]d$", path.stem):
            continue
        copy = output / path.relative_to(ROOT / "src")
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(prepared(path.read_text()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Pages and references: links, tables of contents, widths, and keys of docs/refs.bib.

A page is any *.md of the repository. Pages that a program writes say so in their first line
(`<!-- Written by ...`); their lines may be long. A section `Contents` is a table of contents: it
lists the title and all headings of second order of every page that it links, in their order.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

LINE_LENGTH = 120
HEADING = re.compile(r"(#{1,6})\s+(.*?)\s*#*$")
LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]*(?:\([^()]*\))?[^()\s]*)\)")
SOURCE = re.compile(r'src="([^"]+)"')
KEY = re.compile(r"(?<![\w.])[A-Za-z]+(?:1[6-9]|20)\d\d[a-z]?\b")
BRACKETS = re.compile(r"\[([^\[\]]*)\](?!\()")
# "Darcy (1856)", "Biot et al. 1941": an author and a year without a key
AUTHOR = re.compile(r"\b[A-Z][a-z]+(?: et al\.?)?,? (?:\((?:1[6-9]|20)\d\d\)|(?:1[89]|20)\d\d\b)")
MENTIONED = re.compile(r"(?<![\w/.-])((?:docs|input|postprocess)/[\w./-]+\.md)\b")


def listed_files(root: Path, *patterns: str) -> list[Path]:
    """Files of these patterns that git knows or would add (all of a tree without git)."""
    command = ["git", "-C", str(root), "ls-files", "-co", "--exclude-standard", *patterns]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode == 0:
        files = [root / name for name in done.stdout.splitlines()]
        return sorted(path for path in set(files) if path.exists())
    return sorted(path for pattern in patterns for path in root.rglob(pattern))


def page_files(root: Path) -> list[Path]:
    return listed_files(root, "*.md")


def is_written_by_a_program(text: str) -> bool:
    return text.startswith("<!-- Written by")


def text_lines(text: str) -> Iterator[tuple[int, str]]:
    """(number, line) of a page without its blocks of code; spans of code are emptied."""
    fenced, before = False, ""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced and not (line.startswith("    ") and not is_listed(line, before)):
            yield number, re.sub(r"(`+)(?:(?!\1).)*\1", "``", line)
        if line.strip() and not line.startswith("    "):
            before = line


def is_listed(line: str, before: str) -> bool:
    """Does an indented line belong to a list rather than being code?"""
    item = r"\s*(?:[-*+]|\d+\.)\s"
    return re.match(item, line) is not None or re.match(item, before) is not None


def headings(text: str) -> list[tuple[int, str]]:
    """(order, text) of all headings of a page."""
    fenced, found = False, []
    for line in text.splitlines():
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced and (match := HEADING.match(line)):
            found.append((len(match.group(1)), match.group(2)))
    return found


def anchor(heading: str) -> str:
    """The anchor that GitHub and the site make of a heading."""
    bare = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").lower()
    return re.sub(r"[^\w\- ]", "", bare).replace(" ", "-")


def anchors(text: str) -> set[str]:
    found: dict[str, int] = {}
    for _, heading in headings(text):
        name = anchor(heading)
        found[name] = found.get(name, -1) + 1
        if found[name]:
            found[f"{name}-{found[name]}"] = 0
    return set(found)


def check_links(root: Path) -> list[str]:
    """Relative links of pages, and pages named in comments of programs, lead to something."""
    problems = []
    for page in page_files(root):
        for number, line in text_lines(page.read_text()):
            for target in [match.group(2) for match in LINK.finditer(line)] + SOURCE.findall(line):
                if not re.match(r"\w+:", target) and (what := dead_link(page, target)):
                    problems.append(f"{page}:{number}: {what}")
    for path in listed_files(root, "*.f90", "*.py", "*.sh", "*.nml", "*.cmake", "CMakeLists.txt"):
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            for name in MENTIONED.findall(line):
                if not (root / name).exists():
                    problems.append(f"{path}:{number}: {name} does not exist")
    return problems


def dead_link(page: Path, target: str) -> str:
    name, _, place = target.partition("#")
    path = page.parent / name if name else page
    if not path.exists():
        return f"the link to {target} leads nowhere"
    if place and path.suffix == ".md" and place not in anchors(path.read_text()):
        return f"{path.name} has no heading #{place}"
    return ""


def check_contents(root: Path) -> list[str]:
    """Tables of contents are equal to the headings of the pages that they list."""
    problems = []
    for page in page_files(root):
        text = page.read_text()
        entries, inside, first = [], False, 0
        for number, line in text_lines(text):
            if match := HEADING.match(line):
                inside = match.group(2) == "Contents"
                first = number if inside else first
            elif inside:
                entries += [(number, *match.groups()) for match in LINK.finditer(line)]
        if not first:
            continue
        listed: dict[str, list[tuple[int, str, str]]] = {}
        for number, words, target in entries:
            name, _, place = target.partition("#")
            listed.setdefault(name, []).append((number, words, place))
        for name, found in listed.items():
            path = page.parent / name if name else page
            if not path.exists():
                continue  # check_links says so
            wanted = [
                (heading, anchor(heading) if order == 2 else "")
                for order, heading in headings(path.read_text())
                if (order == 1 and name) or (order == 2 and heading != "Contents")
            ]
            here = [(words, place) for _, words, place in found]
            for words in [w for w in wanted if w not in here]:
                problems.append(f"{page}:{first}: '{words[0]}' of {name or page.name} is missing")
            for number, *rest in found:
                if tuple(rest) not in wanted:
                    problems.append(f"{page}:{number}: no heading '{rest[0]}' in {path.name}")
            if sorted(here) == sorted(wanted) and here != wanted:
                problems.append(f"{page}:{found[0][0]}: the headings of {path.name} out of order")
        for path in sorted(page.parent.glob("*.md")):
            if path != page and any(listed) and path.name not in listed:
                problems.append(f"{page}:{first}: the page {path.name} is missing")
    return problems


def check_widths(root: Path) -> list[str]:
    """Lines of text, and cells of tables, that are too long to read (pages written by hand)."""
    problems = []
    for page in page_files(root):
        text = page.read_text()
        if is_written_by_a_program(text):
            continue
        for number, line in enumerate(text.splitlines(), start=1):
            if line.lstrip().startswith("|"):
                cells = re.split(r"(?<!\\)\|", line.strip().strip("|"))
                width, what = max(len(cell.strip()) for cell in cells), "a cell of"
            else:
                width, what = len(line), "a line of"
                if line.startswith("<img ") or " " not in line.strip():
                    continue
            if width > LINE_LENGTH:
                problems.append(f"{page}:{number}: {what} {width} columns, more than {LINE_LENGTH}")
    return problems


def citations(text: str, is_page: bool) -> Iterator[tuple[int, str]]:
    """(line, key) of the keys in [brackets] of a page or of the comments of Fortran."""
    lines = text_lines(text) if is_page else comments(text)
    for number, line in lines:
        for inside in BRACKETS.findall(line):
            for key in KEY.findall(inside):
                yield number, key


def comments(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if match := re.match(r"(?:[^'\"!]|'[^']*'|\"[^\"]*\")*!(.*)", line):
            yield number, match.group(1)


def check_references(root: Path) -> list[str]:
    """Every key of docs/refs.bib is cited, every cited key is defined, nothing else is cited."""
    problems, defined, cited = [], {}, set()
    bibliography = root / "docs/refs.bib"
    for number, line in enumerate(bibliography.read_text().splitlines(), start=1):
        if match := re.match(r"@\w+\{([^,\s]+),", line):
            if match.group(1) in defined:
                problems.append(f"{bibliography}:{number}: {match.group(1)} is defined twice")
            defined[match.group(1)] = number
    sources = [path for path in listed_files(root, "*.f90") if root / "src" in path.parents]
    for path in [*page_files(root), *sources]:
        text = path.read_text()
        for number, key in citations(text, path.suffix == ".md"):
            cited.add(key)
            if key not in defined:
                problems.append(f"{path}:{number}: [{key}] is not in docs/refs.bib")
    for path in sources:
        for number, line in comments(path.read_text()):
            if match := AUTHOR.search(line.replace("Fortran 20", "Fortran ")):
                problems.append(f"{path}:{number}: '{match.group(0)}' without a [key] of refs.bib")
    for key in sorted(set(defined) - cited):
        problems.append(f"{bibliography}:{defined[key]}: {key} is cited nowhere")
    return problems

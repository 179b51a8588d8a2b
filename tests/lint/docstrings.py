"""Units in the docstrings of src: every real that a room shows to others says its unit.

Dummy arguments of public procedures, results of public functions and components of public types
have a unit in [brackets] in their docstring (`!!` beside or below the declaration; for results also
in the docstring of the function). A number without dimension says [-].
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

SYMBOL = r"(?:m|kg|s|min|N|Pa|J|B|rad|deg|cells)(?:\d+|\*\*\([^)]*\))?"
PRODUCT = rf"{SYMBOL}(?: {SYMBOL})*"
OVER = rf"/(?:{SYMBOL}|\({PRODUCT}\))"
EXPRESSION = rf"(?:1{OVER}|{PRODUCT}(?:{OVER})?)"
# [-], [Pa s], [1/(Pa s)], [m2, m in 2-D], [m, Pa or m/s, by its kind], [unit of the field]
UNIT = re.compile(rf"\[(?:-|{EXPRESSION}(?:(?:, | or ).*?)?|[^\]]*\bunits?\b[^\]]*)\]")

KIND = r"(?:real|integer|logical|type|class|character)\s*(?:\([^)]*\))?"
PREFIX = rf"(?:pure|elemental|impure|recursive|{KIND})"
PROCEDURE = re.compile(rf"(?:{PREFIX}\s+)*(subroutine|function)\s+(\w+)\s*(?:\(([^)]*)\))?", re.I)
TYPE = re.compile(r"type\b(?!\s*\()\s*(,[^:]*)?(?:::)?\s*(\w+)\s*$", re.I)
BINDING = re.compile(r"procedure\s*(?:\((\w+)\))?\s*(,[^:]*)?::\s*(.*)", re.I)
REAL = re.compile(r"real\s*\(", re.I)


@dataclass
class Statement:
    """A statement with its continuation lines, and the docstring beside and below it."""

    line: int
    code: str
    doc: list[str] = field(default_factory=list)

    def has_unit(self) -> bool:
        return UNIT.search(" ".join(self.doc)) is not None


def split_comment(line: str) -> tuple[str, str]:
    quote = ""
    for place, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        elif character == "!":
            return line[:place].rstrip(), line[place:]
    return line.rstrip(), ""


def statements(text: str) -> list[Statement]:
    result: list[Statement] = []
    continues = False
    for number, line in enumerate(text.splitlines(), start=1):
        code, comment = split_comment(line)
        doc = comment[2:].strip() if comment.startswith("!!") else None
        if code.strip():
            part = code.strip().removeprefix("&").removesuffix("&").strip()
            if continues:
                result[-1].code += " " + part
            else:
                result.append(Statement(number, part))
            continues = code.endswith("&")
        elif doc is None and not continues:
            result.append(Statement(number, ""))  # a blank line ends a docstring
        if doc is not None and result:
            result[-1].doc.append(doc)
    return [s for s in result if s.code or s.doc]


def names_in(declaration: str) -> list[str]:
    """Names that a declaration declares: what follows '::', without shapes and values."""
    names, depth, name = [], 0, ""
    for character in declaration.split("::", 1)[1] + ",":
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0:
            if match := re.match(r"\s*(\w+)", name):
                names.append(match.group(1).lower())
            name = ""
        else:
            name += character
    return names


def public_names(code: list[Statement]) -> set[str]:
    """Lower-case names that a module shows: listed, bound to public types, in public interfaces."""
    public: set[str] = set()
    for statement in code:
        if match := re.match(r"public\s*::\s*(.*)", statement.code, re.I):
            public |= {name.strip().lower() for name in match.group(1).split(",")}
        elif (match := TYPE.match(statement.code)) and "public" in (match.group(1) or "").lower():
            public.add(match.group(2).lower())
    inside, after_contains, hidden, generic = "", False, False, ""
    for statement in code:
        lower = statement.code.lower()
        if match := TYPE.match(statement.code):
            inside, after_contains, hidden = match.group(2).lower(), False, False
        elif lower.startswith(("end type", "endtype")):
            inside = ""
        elif inside and lower == "contains":
            after_contains = True
        elif inside and after_contains and lower == "private":
            hidden = True
        elif inside in public and after_contains and (match := BINDING.match(statement.code)):
            attributes = (match.group(2) or "").lower()
            if "private" not in attributes and (not hidden or "public" in attributes):
                targets = [name.split("=>")[-1] for name in match.group(3).split(",")]
                public |= {name.strip().lower() for name in [match.group(1) or "", *targets]}
        elif match := re.match(r"(?:abstract\s+)?interface\b\s*(\w*)", lower):
            generic = match.group(1)
        elif lower.startswith("end interface"):
            generic = ""
        elif generic in public and (
            match := re.match(r"(?:module\s+)?procedure\s*(?:::)?\s*(.*)", lower)
        ):
            public |= {name.strip() for name in match.group(1).split(",")}
    return public - {""}


def missing_units(text: str) -> list[tuple[int, str]]:
    """(line, message) of every public real without a unit."""
    code = statements(text)
    public = public_names(code)
    problems = []
    procedure: Statement | None = None
    name, arguments, result, inside = "", set(), "", ""
    hidden = False
    for statement in code:
        lower = statement.code.lower()
        if match := TYPE.match(statement.code):
            inside, hidden = match.group(2).lower(), False
        elif lower.startswith(("end type", "endtype")):
            inside = ""
        elif inside and lower == "private":
            hidden = True
        elif match := PROCEDURE.match(statement.code):
            procedure, name = statement, match.group(2).lower()
            arguments = {word.strip().lower() for word in (match.group(3) or "").split(",")}
            result = ""
            if match.group(1).lower() == "function":
                given = re.search(r"result\s*\(\s*(\w+)\s*\)", lower)
                result = given.group(1) if given else name
                of_real = REAL.search(lower[: lower.index("function")])
                if of_real and name in public and not statement.has_unit():
                    problems.append((statement.line, f"the result of {name} has no [unit]"))
        elif re.match(r"end\s*(subroutine|function)", lower):
            procedure = None
        elif REAL.match(lower) and "::" in lower and not statement.has_unit():
            declared = names_in(statement.code)
            if inside in public and not hidden and "private" not in lower.split("::")[0]:
                problems.append((statement.line, f"{inside}%{declared[0]} has no [unit]"))
            elif procedure and name in public:
                if dummies := [word for word in declared if word in arguments]:
                    words = ", ".join(dummies)
                    problems.append((statement.line, f"{words} of {name} without a [unit]"))
                if result in declared and not procedure.has_unit():
                    problems.append((statement.line, f"the result of {name} has no [unit]"))
    return problems


def check_units(root: Path) -> list[str]:
    problems = []
    for path in sorted((root / "src").glob("*/*.f90")):
        problems += [f"{path}:{line}: {what}" for line, what in missing_units(path.read_text())]
    return problems


def choices_of_keys(text: str) -> dict[str, list[set[str]]]:
    """Name of a component: what the keys of the scene that are called so may be."""
    found: dict[str, list[set[str]]] = {}
    for statement in statements(text):
        name = re.match(r"call \w+%name\([\w%]*?(\w+), ", statement.code)
        choices = re.search(r"choices=((?:'[^']*'(?:\s*//\s*)?)+)", statement.code)
        if name and choices:
            words = "".join(re.findall(r"'([^']*)'", choices.group(1))).split()
            found.setdefault(name.group(1).lower(), []).append(set(words))
    return found


def wrong_choices(scene: str, keys: str) -> list[tuple[int, str]]:
    """(line, message) where the values in the comment of a component are not those of its key."""
    choices = choices_of_keys(keys)
    problems = []
    inside = ""
    for statement in statements(scene):
        if match := TYPE.match(statement.code):
            inside = match.group(2).lower()
        elif statement.code.lower().startswith("end type"):
            inside = ""
        elif inside and statement.code.lower().startswith("character") and "::" in statement.code:
            name = names_in(statement.code)[0]
            listed = set(re.findall(r"'(\w+)'", " ".join(statement.doc)))
            values = listed | set(re.findall(r"= '(\w+)'", statement.code))
            if listed and name in choices and values not in choices[name]:
                problems.append((statement.line, f"{inside}%{name} may be something else"))
    return problems


def check_choices(root: Path) -> list[str]:
    scene = root / "src/io/dosui_scene.f90"
    keys = "".join(path.read_text() for path in sorted((root / "src/io").glob("dosui_*_keys.f90")))
    found = wrong_choices(scene.read_text(), keys)
    return [f"{scene}:{line}: {what} (`choices` of its key)" for line, what in found]

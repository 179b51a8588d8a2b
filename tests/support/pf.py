#!/usr/bin/env python3
"""Runs pFUnit's .pf files without pFUnit: turns the subset that dosui uses into Fortran.

pf.py suite test_x.pf test_x.F90   the test module and the program that runs its tests
pf.py assertions funit.f90         the module `funit` with every specific assertion
pf.py npes test_x.pf               the largest number of processes a test asks for (0: no MPI)

The subset: one module per file, named as the file; `use funit` or `use pfunit`; `@test` before a
subroutine without argument; `@test(npes=[1,2])` before one with the argument `this`; assertions
`@assertEqual` and so on, one a line. Anything else that starts with @ is an error with file:line.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ASSERTIONS = {
    "assertequal": "assertEqual",
    "assertnotequal": "assertNotEqual",
    "assertlessthan": "assertLessThan",
    "assertlessthanorequal": "assertLessThanOrEqual",
    "assertgreaterthan": "assertGreaterThan",
    "assertgreaterthanorequal": "assertGreaterThanOrEqual",
    "asserttrue": "assertTrue",
    "assertfalse": "assertFalse",
}
SUBROUTINE = re.compile(r"\s*subroutine\s+(\w+)\s*(?:\(([\w\s,]*)\))?\s*(?:!.*)?$", re.I)
MODULE = re.compile(r"\s*module\s+(\w+)\s*(?:!.*)?$", re.I)
USE = re.compile(r"\s*use\s+(p?funit)\b(.*)$", re.I)
TEST = re.compile(r"@test\s*(?:\((.*)\))?\s*$", re.I)
NPES = re.compile(r"\s*npes\s*=\s*\[([0-9,\s]+)\]\s*$", re.I)
ASSERT = re.compile(r"@(\w+)\s*\((.*)\)\s*$")


class SubsetError(Exception):
    """A line that is not in the subset."""


class Suite:
    """One .pf file: its translated text and its tests [(name, [npes] or None)]."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.module = ""
        self.library = ""
        self.tests: list[tuple[str, list[int] | None]] = []
        self.lines: list[str] = []
        self.number = 0
        self._translate(path.read_text().splitlines())

    def fail(self, message: str) -> SubsetError:
        return SubsetError(f"{self.path}:{self.number}: {message}")

    def _translate(self, lines: list[str]) -> None:
        waiting: tuple[int, list[int] | None] | None = None  # an @test seeks its subroutine
        for self.number, line in enumerate(lines, start=1):
            code = line.strip()
            if waiting and code and not code.startswith("!"):
                self._test(waiting[1], line)
                waiting = None
                self.lines.append(line)
            elif not code.startswith("@"):
                self._plain(line)
                self.lines.append(line)
            elif match := TEST.match(code):
                waiting = (self.number, self._npes(match.group(1)))
                self.lines.append("! " + code)
            else:
                self.lines += self._assertion(code)
        if waiting:
            self.number = waiting[0]
            raise self.fail("no subroutine follows this @test")
        self.number = 1
        if self.module.lower() != self.path.stem.lower():
            raise self.fail(f"module '{self.module}' must have the file's name, {self.path.stem}")
        if not self.library:
            raise self.fail("neither `use funit` nor `use pfunit`")
        if not self.tests:
            raise self.fail("the file holds no @test")

    def _plain(self, line: str) -> None:
        if not self.module and (match := MODULE.match(line)):
            self.module = match.group(1)
        if match := USE.match(line):
            if match.group(2).split("!")[0].strip():
                raise self.fail(
                    f"write `use {match.group(1)}` alone: the assertions need all of it"
                )
            self.library = max(self.library, match.group(1).lower())  # 'pfunit' > 'funit'

    def _npes(self, options: str | None) -> list[int] | None:
        if options is None or not options.strip():
            return None
        match = NPES.match(options)
        numbers = [int(n) for n in match.group(1).split(",") if n.strip()] if match else []
        if not numbers or min(numbers) < 1:
            raise self.fail(f"only @test and @test(npes=[1,2,...]) are understood, not '{options}'")
        return numbers

    def _test(self, npes: list[int] | None, line: str) -> None:
        match = SUBROUTINE.match(line)
        if not match:
            raise self.fail("a subroutine must follow @test, on one line")
        arguments = (match.group(2) or "").split()
        if npes and self.library != "pfunit":
            raise self.fail("a test with npes needs `use pfunit`")
        if npes and len(arguments) != 1:
            raise self.fail("a test with npes takes one argument, class(MpiTestMethod) this")
        if not npes and arguments:
            raise self.fail("a test without npes takes no argument")
        if any(name.lower() == match.group(1).lower() for name, _ in self.tests):
            raise self.fail(f"second test named '{match.group(1)}'")
        self.tests.append((match.group(1), npes))

    def _assertion(self, code: str) -> list[str]:
        match = ASSERT.match(code)
        name = ASSERTIONS.get(match.group(1).lower()) if match else None
        if not match or not name:
            hint = " (an assertion must stand on one line)" if code.endswith("&") else ""
            raise self.fail(f"not in the subset of pFUnit that dosui uses: '{code}'{hint}")
        arguments = match.group(2).strip()
        wanted = 1 if name in ("assertTrue", "assertFalse") else 2
        if count_arguments(arguments) < wanted:
            raise self.fail(f"@{name} needs {wanted} argument{'s' * (wanted - 1)}")
        here = f'# {self.number} "{self.path}"'
        return [
            here,
            f"    call {name}({arguments}, &",
            here,
            f"      location=SourceLocation('{self.path.name}', {self.number}))",
            here,
            "    if (anyExceptions()) return",
            f'# {self.number + 1} "{self.path}"',
        ]

    def max_npes(self) -> int:
        return max((max(npes) for _, npes in self.tests if npes), default=0)

    def module_text(self) -> str:
        return f'# 1 "{self.path}"\n' + "\n".join(self.lines) + "\n"

    def main_text(self) -> str:
        """The program that runs the tests of the module."""
        parallel = self.max_npes() > 0
        library = "pfunit" if parallel else "funit"
        run = "pfunit_run_serial" if parallel else "funit_run"
        path = str(self.path).replace("'", "''")
        pieces = [path[k : k + 80] for k in range(0, len(path), 80)]
        calls = []
        for name, npes in self.tests:
            if npes:
                calls += [f"  call pfunit_run('{name}', {n}, &\n    {name})" for n in npes]
            else:
                calls.append(f"  call {run}('{name}', &\n    {name})")
        helpers = sorted(
            {f"{library}_begin", f"{library}_end", *re.findall(r"call (\w+)", "\n".join(calls))}
        )
        names = ", &\n    ".join(name for name, _ in self.tests)
        return (
            f"program run_{self.module}\n"
            f"  use {library}, only: {', '.join(helpers)}\n"
            f"  use {self.module}, only: &\n    {names}\n"
            "  implicit none\n\n"
            f"  call {library}_begin('"
            + "'// &\n    '".join(pieces)
            + "')\n"
            + "\n".join(calls)
            + f"\n  call {library}_end()\nend program run_{self.module}\n"
        )


def count_arguments(text: str) -> int:
    """Arguments at the top level of brackets and quotes."""
    depth, quote, count = 0, "", 1 if text else 0
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        elif character in "([":
            depth += 1
        elif character in ")]":
            depth -= 1
        elif character == "," and depth == 0:
            count += 1
    return count


RELATIONS = {
    "assertEqual": "==",
    "assertNotEqual": "/=",
    "assertLessThan": "<",
    "assertLessThanOrEqual": "<=",
    "assertGreaterThan": ">",
    "assertGreaterThanOrEqual": ">=",
}
KINDS = {"i4": "integer(int32)", "i8": "integer(int64)", "r4": "real(real32)", "r8": "real(real64)"}
INTEGER_PAIRS = [("i4", "i4"), ("i4", "i8"), ("i8", "i8"), ("i8", "i4")]
REAL_PAIRS = [("i4", "r8"), ("r8", "r8"), ("r4", "r8"), ("i4", "r4"), ("r4", "r4")]
RANKS = [(0, 0)] + [pair for rank in (1, 2, 3) for pair in ((0, rank), (rank, rank))]
TAIL = (
    "    character(len=*), intent(in), optional :: message\n"
    "    type(SourceLocation), intent(in), optional :: location\n\n"
)


def dimensions(rank: int) -> str:
    return "(" + ", ".join(":" * rank) + ")" if rank else ""


def flat(name: str, rank: int, conversion: str) -> str:
    """The argument as a rank-1 array of the widest kind."""
    value = conversion.format(name)
    return (
        f"[{value}]" if rank == 0 else value if rank == 1 else f"reshape({value}, [size({name})])"
    )


def numeric(
    assertion: str, pair: tuple[str, str], ranks: tuple[int, int], tolerance: bool
) -> tuple[str, str]:
    """One specific assertion: (name, text)."""
    (e, a), (re_, ra) = pair, ranks
    real = a[0] == "r"
    conversion = "real({}, real64)" if real else "int({}, int64)"
    name = f"{assertion}_{e}{re_}_{a}{ra}" + ("_t" if tolerance else "")
    text = (
        f"  subroutine {name}(expected, actual{', tolerance' * tolerance}, message, location)\n"
        f"    {KINDS[e]}, intent(in) :: expected{dimensions(re_)}\n"
        f"    {KINDS[a]}, intent(in) :: actual{dimensions(ra)}\n"
        + (f"    {KINDS[a]}, intent(in) :: tolerance\n" if tolerance else "")
        + TAIL
        + f"    call compare_{'reals' if real else 'integers'}('{RELATIONS[assertion]}', &\n"
        f"      {flat('expected', re_, conversion)}, shape(expected), &\n"
        f"      {flat('actual', ra, conversion)}, shape(actual), &\n"
        + (
            ""
            if not real
            else "      real(tolerance, real64), &\n"
            if tolerance
            else "      0.0_real64, &\n"
        )
        + f"      message, location)\n  end subroutine {name}\n"
    )
    return name, text


def logical(assertion: str, ranks: tuple[int, int]) -> tuple[str, str]:
    re_, ra = ranks
    name = f"{assertion}_l{re_}_l{ra}"
    return name, (
        f"  subroutine {name}(expected, actual, message, location)\n"
        f"    logical, intent(in) :: expected{dimensions(re_)}\n"
        f"    logical, intent(in) :: actual{dimensions(ra)}\n{TAIL}"
        f"    call compare_logicals({flat('expected', re_, '{}')}, shape(expected), &\n"
        f"      {flat('actual', ra, '{}')}, shape(actual), message, location)\n"
        f"  end subroutine {name}\n"
    )


def condition(assertion: str, rank: int) -> tuple[str, str]:
    name = f"{assertion}_{rank}"
    value = ".true." if assertion == "assertTrue" else ".false."
    return name, (
        f"  subroutine {name}(condition, message, location)\n"
        f"    logical, intent(in) :: condition{dimensions(rank)}\n{TAIL}"
        f"    call compare_logicals([{value}], [integer ::], {flat('condition', rank, '{}')}, &\n"
        f"      shape(condition), message, location)\n  end subroutine {name}\n"
    )


def assertions_text() -> str:
    """The module `funit`: every specific, generic by the name pFUnit gives it."""
    specifics: dict[str, list[tuple[str, str]]] = {}
    for assertion in RELATIONS:
        found = [
            numeric(assertion, pair, ranks, False)
            for pair in INTEGER_PAIRS + REAL_PAIRS
            for ranks in RANKS
        ]
        if assertion == "assertEqual":
            found += [
                numeric(assertion, pair, ranks, True) for pair in REAL_PAIRS for ranks in RANKS
            ]
            found += [logical(assertion, ranks) for ranks in RANKS]
        specifics[assertion] = found
    specifics["assertTrue"] = [condition("assertTrue", rank) for rank in (0, 1)]
    specifics["assertFalse"] = [condition("assertFalse", rank) for rank in (0, 1)]
    interfaces = []
    for generic, found in specifics.items():
        names = [name for name, _ in found]
        if generic == "assertEqual":
            names.append("assert_equal_text")
        body = "".join(f"    module procedure {name}\n" for name in names)
        interfaces.append(f"  interface {generic}\n{body}  end interface {generic}\n")
    template = (Path(__file__).parent / "funit.f90.in").read_text()
    bodies = "\n".join(text for found in specifics.values() for _, text in found)
    return (
        template.replace("@GENERICS@", ", &\n            ".join(specifics))
        .replace("@INTERFACES@", "\n".join(interfaces))
        .replace("@SPECIFICS@", bodies)
    )


def main(arguments: list[str]) -> int:
    try:
        match arguments:
            case ["suite", source, target]:
                suite = Suite(Path(source))
                Path(target).write_text(suite.module_text() + "\n" + suite.main_text())
            case ["npes", source]:
                print(Suite(Path(source)).max_npes())
            case ["assertions", target]:
                Path(target).write_text(assertions_text())
            case _:
                print(__doc__, file=sys.stderr)
                return 2
    except SubsetError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

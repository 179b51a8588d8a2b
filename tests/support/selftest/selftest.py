#!/usr/bin/env python3
"""Proves that the test driver can fail: runs the programs of the .pf files beside this script.

selftest.py BINARY_DIRECTORY MPIEXEC [FLAGS...]

Every assertion after a comment `! FAILS text` must be reported as file:line with that text,
every other one must pass, and the exit status must tell. The preprocessor must refuse what it
does not know.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
PREPROCESSOR = HERE.parent / "pf.py"
problems: list[str] = []


def check(condition: bool, text: str) -> None:
    print(("ok    " if condition else "FAIL  ") + text)
    if not condition:
        problems.append(text)


def run(command: list[str]) -> tuple[int, str]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stdout + done.stderr


def check_marked_failures(source: Path, command: list[str]) -> None:
    """Exactly the marked assertions fail."""
    status, output = run(command)
    lines = source.read_text().splitlines()
    marks = {
        k + 2: line.split("FAILS", 1)[1].strip()
        for k, line in enumerate(lines)
        if "! FAILS" in line
    }
    check(status != 0, f"{source.name}: exit status {status} is not 0")
    for number, text in marks.items():
        found = [line for line in output.splitlines() if f"{source.name}:{number}: " in line]
        check(len(found) == 1 and text in found[0], f"{source.name}:{number}: {text}")
    reported = [line for line in output.splitlines() if f"{source}:" in line]
    check(len(reported) == len(marks), f"{source.name}: {len(marks)} failures, not {len(reported)}")
    check(f"{len(marks)} of " in output, f"{source.name}: the last line counts the failed tests")


def check_refused(text: str, number: int, reason: str) -> None:
    """The preprocessor answers file:line and the reason."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "test_x.pf"
        source.write_text(text)
        status, output = run([sys.executable, str(PREPROCESSOR), "npes", str(source)])
    check(
        status != 0 and f"test_x.pf:{number}: " in output and reason in output, f"refused: {reason}"
    )


def main(binaries: Path, mpiexec: list[str]) -> int:
    status, output = run([str(binaries / "selftest_good")])
    check(status == 0 and "OK: 3 tests" in output, "test_good.pf passes")
    status, output = run([str(binaries / "selftest_good"), "reals"])
    check(status == 0 and "OK: 1 tests" in output, "one test can be selected by its name")
    status, output = run([str(binaries / "selftest_good"), "no_such_test"])
    check(status != 0 and "no test was run" in output, "a program that runs no test fails")
    status, output = run([str(binaries / "selftest_stop")])
    check(status != 0 and "ended inside a test" in output, "a stop inside a test fails")
    check_marked_failures(HERE / "test_bad.pf", [str(binaries / "selftest_bad")])
    check_marked_failures(
        HERE / "test_bad_mpi.pf", [*mpiexec, "3", str(binaries / "selftest_bad_mpi")]
    )
    status, output = run([*mpiexec, "2", str(binaries / "selftest_bad_mpi"), "test_passes"])
    check(status != 0 and "more processes asked for" in output, "too few processes fail")
    status, output = run([*mpiexec, "3", str(binaries / "selftest_crash_mpi")])
    check(
        status != 0 and "run   test_crash" in output and "OK:" not in output,
        "a crash on one rank of three fails",
    )

    start = "module test_x\n  use funit\ncontains\n"
    test = "  @test\n  subroutine a()\n"
    end = "  end subroutine a\nend module test_x\n"
    check_refused(
        start + "  @before\n  subroutine b()\n  end subroutine b\n" + test + end,
        4,
        "not in the subset",
    )
    check_refused(start + test + "    @assertEqual(1, &\n" + end, 6, "one line")
    check_refused(start + test + "    @assertEqual(1)\n" + end, 6, "needs 2 argument")
    check_refused(start + test + "    @assertAll([.true.])\n" + end, 6, "not in the subset")
    check_refused(
        start + "  @test(npes=[2])\n  subroutine a(this)\n" + end, 5, "needs `use pfunit`"
    )
    check_refused(start + "  @test(cases=[2])\n  subroutine a(this)\n" + end, 4, "are understood")
    check_refused(start + "  @test\n  integer function a()\n" + end, 5, "subroutine must follow")
    check_refused(start + "end module test_x\n", 1, "no @test")
    check_refused("module test_y\n  use funit\ncontains\n" + test + end, 1, "the file's name")
    check_refused("module test_x\ncontains\n" + test + end, 1, "neither")
    print(f"{len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))

"""The command `dosui-post`.

Exit status: 0 all right, 1 a verification failed, 2 a wrong request or an unreadable file,
3 a report was interrupted.
"""

from __future__ import annotations

import argparse
import math
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TypeAlias

from dosui_post import __version__
from dosui_post.errors import DosuiPostError
from dosui_post.result import Result

_PASSED, _FAILED, _WRONG = 0, 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    options = _parser().parse_args(arguments)
    options.arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        status: int = options.run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of a pipe has gone (`| head`): nothing more to say, even at shutdown.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except (DosuiPostError, OSError) as error:
        _complain(error)
        return _WRONG
    return status


def _complain(error: Exception) -> None:
    print(f"dosui-post: error: {error}", file=sys.stderr)


# ---------------------------------------------------------------------- commands


def _check(options: argparse.Namespace) -> int:
    from dosui_post.checksum import seal_problem

    status = _PASSED
    for path in options.files:
        try:
            if path.name.endswith((".h5", ".h5.previous")):
                problem = seal_problem(path)
                if problem:
                    raise DosuiPostError(f"{path} is damaged: {problem}")
                print(f"{path}: undamaged")
            else:
                with Result(path) as result:
                    n = result.check()
                print(f"{path}: undamaged, {n} checksums" if n else f"{path}: has no checksums")
        except (DosuiPostError, OSError) as error:
            _complain(error)
            status = _FAILED
    return status


def _rename(options: argparse.Namespace) -> int:
    from dosui_post.rename import rename

    for path in options.files:
        changes = rename(path)
        print("\n".join(changes) if changes else f"{path}: nothing to change")
    return _PASSED


def _verify(options: argparse.Namespace) -> int:
    from dosui_post.verify import verify

    status = _PASSED
    for path in options.results:
        try:
            with Result(path) as result:
                verification = verify(result, options.tolerance, options.from_time_factor)
                print(verification.table(), flush=True)
            if not verification.has_passed:
                status = max(status, _FAILED)
        except (DosuiPostError, OSError) as error:
            _complain(error)
            status = _WRONG
    return status


def _plot_isochrones(options: argparse.Namespace) -> int:
    from dosui_post.plot import isochrones

    with Result(options.result) as result:
        return _wrote(isochrones(result, _output(options, "isochrones.png"), options.times))


def _plot_mandel(options: argparse.Namespace) -> int:
    from dosui_post.plot import mandel

    with ExitStack() as stack:
        results = [stack.enter_context(Result(path)) for path in options.results]
        return _wrote(mandel(results, _output(options, "centre_pressure.png")))


def _plot_settlement(options: argparse.Namespace) -> int:
    from dosui_post.plot import settlement

    with ExitStack() as stack:
        results = [stack.enter_context(Result(path)) for path in options.results]
        return _wrote(settlement(results, _output(options, "settlement.png")))


def _plot_map(options: argparse.Namespace) -> int:
    from dosui_post.plot import field_map

    with Result(options.result) as result:
        step = options.step if options.time is None else result.step_near(options.time)
        output = _output(options, f"{options.field}.png")
        return _wrote(
            field_map(result, output, options.field, options.component, step, options.slice)
        )


def _plot_probe(options: argparse.Namespace) -> int:
    from dosui_post.plot import probes

    with Result(options.result) as result:
        return _wrote(probes(result, _output(options, "probes.png"), options.names))


def _animate(options: argparse.Namespace) -> int:
    from dosui_post.animate import animate_isochrones, animate_map

    with Result(options.result) as result:
        if options.isochrones:
            output = _output(options, "isochrones.gif")
            return _wrote(animate_isochrones(result, output, options.every, options.fps))
        output = _output(options, f"{options.field}.gif")
        return _wrote(
            animate_map(
                result, output, options.field, options.component, options.every, options.fps
            )
        )


def _material(options: argparse.Namespace) -> int:
    from dosui_post.material import draw_tests, element_tests

    tests = element_tests(options.scene, options.pressure, options.program)
    names = list(dict.fromkeys(test.material for test in tests))
    for name in names if options.material is None else [options.material]:
        output = Path(f"{options.scene.stem}_{name}.png")
        if options.output is not None:
            output = Path(options.output)
            if len(names) > 1 and options.material is None:
                output = output.with_name(f"{output.stem}_{name}{output.suffix}")
        _wrote(draw_tests(tests, name, output))
    return _PASSED


def _report(options: argparse.Namespace) -> int:
    if options.subject == "stability":
        return _stability(options)
    from dosui_post.report.command import Request, report

    return report(
        Request(
            output=options.output,
            program=options.program,
            is_quick=options.quick,
            only=options.only,
            repeat=options.repeat,
            limit=options.timeout,
            mpirun=tuple(shlex.split(options.mpirun)),
            page=options.page,
            ogs=options.ogs,
            kratos=options.kratos,
            command=shlex.join(["dosui-post", *options.arguments]),
        )
    )


def _stability(options: argparse.Namespace) -> int:
    from dosui_post.stability.command import Request, record

    return record(
        Request(
            output=options.output,
            program=options.program,
            only=options.only,
            mpirun=tuple(shlex.split(options.mpirun)),
            page=options.page,
            command=shlex.join(["dosui-post", *options.arguments]),
        )
    )


def _output(options: argparse.Namespace, ending: str) -> Path:
    """What was asked for, else <result>_<ending> in the working directory."""
    if options.output is not None:
        return Path(options.output)
    first = options.result if hasattr(options, "result") else options.results[0]
    return Path(f"{first.stem}_{ending}")


def _wrote(path: Path) -> int:
    print(path)
    return _PASSED


# ---------------------------------------------------------------------- arguments


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dosui-post", description="Reads, verifies and draws the results of dosui."
    )
    parser.add_argument("--version", action="version", version=f"dosui-post {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_verify(commands)
    _add_check(commands)
    plot = commands.add_parser("plot", help="draw a figure")
    _add_plots(plot.add_subparsers(metavar="FIGURE", required=True))
    _add_animate(commands)
    _add_material(commands)
    _add_report(commands)
    _add_rename(commands)
    return parser


_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def _add_verify(commands: _Commands) -> None:
    verify = commands.add_parser(
        "verify",
        help="compare results with their exact solutions",
        description="Prints the relative L2 error over the particles at every output time after"
        " t = 0 against the exact solution that the scene names in &verification, and fails"
        " (exit status 1) if one is above the tolerance, is not a number, or if there is no"
        " output to compare.",
    )
    verify.add_argument("results", metavar="RESULT", nargs="+", type=Path)
    verify.add_argument(
        "--tolerance",
        type=_positive,
        metavar="X",
        help="largest relative error accepted (default: terzaghi 5e-3, mandel 2e-3, drainage 1e-3,"
        " bar 2e-2, hydrostatic 1e-9; 0.15 with the literal two-pass operator)",
    )
    verify.add_argument(
        "--from-time-factor",
        type=float,
        default=0.0,
        metavar="T",
        help="leave out output before this time factor (default: 0)",
    )
    verify.set_defaults(run=_verify)


def _add_rename(commands: _Commands) -> None:
    rename = commands.add_parser(
        "rename",
        help="rewrite scenes of earlier versions",
        description="Replaces former names of keys and choices in scenes by their present ones, in"
        " place, and prints each change. Comments and layout stay.",
    )
    rename.add_argument("files", metavar="FILE", nargs="+", type=Path)
    rename.set_defaults(run=_rename)


def _add_check(commands: _Commands) -> None:
    check = commands.add_parser(
        "check",
        help="look for damage of results and checkpoints",
        description="Compares everything that result files and checkpoints hold with their"
        " checksums, and fails (exit status 1) if something does not fit.",
    )
    check.add_argument("files", metavar="FILE", nargs="+", type=Path)
    check.set_defaults(run=_check)


def _add_plots(figures: _Commands) -> None:
    isochrones = _figure(
        figures, "isochrones", "excess pore pressure over depth at several T", _plot_isochrones
    )
    isochrones.add_argument(
        "--times",
        nargs="+",
        type=_positive,
        metavar="T",
        help="time factors; the nearest outputs are drawn (default: up to 7 of all)",
    )
    _figure(
        figures, "mandel", "pressure in the centre over time, several results", _plot_mandel, True
    )
    _figure(
        figures, "settlement", "settlement over time, on the exact curve", _plot_settlement, True
    )
    field_map = _figure(figures, "map", "a field on the particles", _plot_map)
    _add_field(field_map)
    when = field_map.add_mutually_exclusive_group()
    when.add_argument(
        "--step", type=int, default=-1, help="output step from 0, or from the end (default: last)"
    )
    when.add_argument("--time", type=float, metavar="S", help="output nearest to this time [s]")
    field_map.add_argument(
        "--slice", type=float, metavar="Y", help="3-D: y of the slice [m] (default: middle)"
    )
    probe = _figure(figures, "probe", "histories over time", _plot_probe)
    probe.add_argument(
        "names", metavar="NAME", nargs="*", help="histories (default: the scene's probes)"
    )


def _add_animate(commands: _Commands) -> None:
    animate = commands.add_parser("animate", help="write an animated GIF")
    animate.add_argument("result", metavar="RESULT", type=Path)
    _add_field(animate)
    animate.add_argument(
        "--isochrones", action="store_true", help="the moving isochrone instead of a field"
    )
    animate.add_argument("--every", type=int, default=1, metavar="N", help="every N-th output")
    animate.add_argument(
        "--fps", type=float, default=8.0, help="frames a second (default: 8)", metavar="N"
    )
    _add_output(animate)
    animate.set_defaults(run=_animate)


def _add_material(commands: _Commands) -> None:
    material = commands.add_parser(
        "material",
        help="draw laboratory tests of a scene's soils",
        description="Runs `dosui --elements SCENE`: oedometer, triaxial and simple shear tests,"
        " drained and undrained, and draws one picture a soil.",
    )
    material.add_argument("scene", metavar="SCENE", type=Path)
    material.add_argument(
        "--pressure",
        type=_positive,
        default=1.0e5,
        metavar="PA",
        help="confining pressure (default: 1e5)",
    )
    material.add_argument("--material", metavar="NAME", help="only this one")
    material.add_argument("--program", type=Path, metavar="PATH", help="dosui (default: on PATH)")
    material.add_argument("-o", "--output", metavar="PATH", help="default: <scene>_<material>.png")
    material.set_defaults(run=_material)


def _add_report(commands: _Commands) -> None:
    report = commands.add_parser(
        "report",
        help="measure speed against error, or stability",
        description="Runs Terzaghi's and Mandel's problems with every integrator, operator and"
        " several spacings and tolerances; writes DIR/runs.csv, pictures and a page. Finished runs"
        " are kept in DIR/runs.jsonl: the same command goes on after an interruption (exit"
        " status 3).",
    )
    report.add_argument(
        "subject",
        nargs="?",
        choices=("speed", "stability"),
        default="speed",
        help="speed: speed against error (default); stability: the record of hard cases, in which"
        " --only selects cases and the options of comparisons mean nothing",
    )
    report.add_argument("--program", type=Path, metavar="PATH", help="dosui (default: on PATH)")
    report.add_argument(
        "--output", "-o", type=Path, default=Path("report"), metavar="DIR", help="default: report"
    )
    report.add_argument("--quick", action="store_true", help="a few minutes instead of hours")
    report.add_argument(
        "--only",
        default="",
        metavar="PATTERN",
        help="regular expression: runs such as 'mandel: quasi-static, dx = 0.01 m, ..., 2 ranks'",
    )
    report.add_argument(
        "--repeat", type=_count, default=1, metavar="N", help="the fastest of N counts (default: 1)"
    )
    report.add_argument(
        "--timeout", type=_positive, default=3600.0, metavar="S", help="of one run (default: 3600)"
    )
    report.add_argument("--mpirun", default="mpirun", metavar="COMMAND", help="default: mpirun")
    report.add_argument(
        "--page",
        type=Path,
        metavar="FILE",
        help="where the page goes, pictures to images/ beside it (default: DIR/speed-and-error.md)",
    )
    report.add_argument("--ogs", metavar="PATH", help="compare with this OpenGeoSys")
    report.add_argument(
        "--kratos", metavar="PYTHON", help="compare with Kratos GeoMechanics of this interpreter"
    )
    report.set_defaults(run=_report)


def _figure(
    figures: _Commands,
    name: str,
    text: str,
    run: Callable[[argparse.Namespace], int],
    takes_several: bool = False,
) -> argparse.ArgumentParser:
    figure: argparse.ArgumentParser = figures.add_parser(name, help=text, description=text)
    if takes_several:
        figure.add_argument("results", metavar="RESULT", nargs="+", type=Path)
    else:
        figure.add_argument("result", metavar="RESULT", type=Path)
    _add_output(figure)
    figure.set_defaults(run=run)
    return figure


def _add_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", metavar="PATH", help="default: <result>_<what>.<ending>")


def _add_field(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--field", default="pore_pressure", help="field of the result (default: pore_pressure)"
    )
    parser.add_argument(
        "--component",
        help="x, y, z or magnitude of vectors; xx, yy, zz, xy, yz, zx or mean of stress",
    )


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value

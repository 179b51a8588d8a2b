#!/usr/bin/env python3
"""Runs one scene and checks its result; `dosui_add_scene_test` of CMake calls this.

run_scene.py --program build/release/bin/dosui --ranks 2 --folder /tmp/x SCENE
             [--set group.key=value]... [--status N] [--verify [OPTIONS OF dosui-post verify]]

--set changes the first group of that name, or adds the key to it. Everything after --verify goes to
`dosui-post verify`. The folder is emptied first; the exit status is 0 if all was as expected.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path


def changed(text: str, change: str) -> str:
    """The scene with `group.key=value` in force."""
    target, value = change.split("=", 1)
    group, key = (part.strip().lower() for part in target.split("."))
    start = re.search(rf"^[ \t]*&{group}\b", text, re.I | re.M)
    if not start:
        raise SystemExit(f"run_scene.py: the scene has no group &{group}")
    # The group ends at the first slash that stands alone: paths stand in quotes.
    end = re.compile(r"(?:'[^']*'|\"[^\"]*\"|![^\n]*|[^/'\"!])*").match(text, start.end()).end()
    body = re.sub(rf"^[ \t]*{key}[ \t]*=[^\n]*\n", "", text[start.end() : end], flags=re.I | re.M)
    if re.search(rf"\b{key}\s*=", body, re.I):
        raise SystemExit(f"run_scene.py: {key} does not stand on a line of its own in &{group}")
    return f"{text[: start.end()]}\n  {key} = {value}{body}{text[end:]}"


def run(command: list[str]) -> int:
    print("+ " + " ".join(command), flush=True)
    return subprocess.run(command).returncode


def parse(arguments: list[str]) -> tuple[argparse.Namespace, list[str] | None]:
    """Our own options and those for `dosui-post verify` (None: nothing to verify)."""
    verify = None
    if "--verify" in arguments:
        at = arguments.index("--verify")
        arguments, verify = arguments[:at], arguments[at + 1 :]
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--program", type=Path, required=True)
    parser.add_argument("--mpiexec", default="mpiexec")
    parser.add_argument("--ranks", default="1")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--status", type=int, default=0)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("scene", type=Path)
    return parser.parse_args(arguments), verify


def main(arguments: list[str]) -> int:
    options, verify = parse(arguments)
    shutil.rmtree(options.folder, ignore_errors=True)
    options.folder.mkdir(parents=True)
    text = options.scene.read_text()
    for change in options.set:
        text = changed(text, change)
    scene = options.folder / options.scene.name
    scene.write_text(text)
    results = options.folder / "results"
    command = [options.mpiexec, "-n", options.ranks, str(options.program)]
    status = run([*command, str(scene), "--output", str(results)])
    if status != options.status:
        print(f"dosui ended with status {status}, not {options.status}")
        return 1
    if verify is None:
        return 0
    files = [str(path) for path in sorted(results.glob("*.vtkhdf"))]
    if len(files) != 1:
        print(f"expected one result file in {results}, found {files}")
        return 1
    return run([sys.executable, "-m", "dosui_post", "verify", *files, *verify])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

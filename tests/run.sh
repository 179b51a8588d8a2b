#!/usr/bin/env bash
# Sets everything up, builds Debug and Release, and passes every test:  tests/run.sh [ctest options]
# Debug runs the unit tests with every check on; Release runs all others on the program as shipped
# (tests/long.sh runs the unit tests there, too).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/support/setup.sh"

dosui_install_packages
mkdir -p "$DOSUI_ROOT/build"
dosui_install_python pytest vtk ruff mypy fprettify fortitude-lint "${DOSUI_SITE_TOOLS[@]}"
dosui_say "building Debug"
dosui_build debug all "-DDOSUI_PYTHON=$DOSUI_VENV/bin/python" -DDOSUI_DEBUG_LINES_ONLY=ON >"$DOSUI_ROOT/build/debug.log" 2>&1 ||
  { tail -n 60 "$DOSUI_ROOT/build/debug.log"; exit 1; }
dosui_say "building Release"
dosui_build release "dosui dosui1d dosui2d dosui3d" "-DDOSUI_PYTHON=$DOSUI_VENV/bin/python" >"$DOSUI_ROOT/build/release.log" 2>&1 ||
  { tail -n 60 "$DOSUI_ROOT/build/release.log"; exit 1; }
# A selection may match nothing in one of the two; without a selection that is an error.
[ $# -gt 0 ] || set -- --no-tests=error
dosui_say "unit tests, Debug"
ctest --test-dir "$DOSUI_ROOT/build/debug" --output-on-failure -L unit -j 2 "$@"
dosui_say "all other tests, Release"
ctest --test-dir "$DOSUI_ROOT/build/release" --output-on-failure -LE unit -j 2 "$@"

#!/usr/bin/env bash
# The tests that take long, after tests/run.sh:  tests/long.sh [pytest options]
# Unit tests in Release, and members of kinds of which every test run has a shorter one.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/support/setup.sh"

dosui_say "unit tests, Release"
dosui_build release all >"$DOSUI_ROOT/build/release.log" 2>&1 ||
  { tail -n 60 "$DOSUI_ROOT/build/release.log"; exit 1; }
ctest --test-dir "$DOSUI_ROOT/build/release" --output-on-failure -L unit -j 2
bash "$DOSUI_ROOT/docs/build.sh"   # tests/run.sh builds the pages only
export DOSUI_LONG=1 DOSUI_BIN="$DOSUI_ROOT/build/release/bin" MPLBACKEND=Agg
exec "$DOSUI_VENV/bin/python" -m pytest -q -p no:cacheprovider -m long "$@" "$DOSUI_ROOT/tests/verification"

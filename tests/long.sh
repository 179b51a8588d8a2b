#!/usr/bin/env bash
# The tests that take long, after a build by tests/run.sh:  tests/long.sh [pytest options]
# Every test run has a shorter member of each kind.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/support/setup.sh"

bash "$DOSUI_ROOT/docs/build.sh"   # tests/run.sh builds the pages only
export DOSUI_LONG=1 DOSUI_BIN="$DOSUI_ROOT/build/release/bin" MPLBACKEND=Agg
exec "$DOSUI_VENV/bin/python" -m pytest -q -p no:cacheprovider -m long "$@" "$DOSUI_ROOT/tests/verification"

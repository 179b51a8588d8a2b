#!/usr/bin/env bash
# Which lines of src/ and postprocess/ the tests reach:  tests/coverage.sh [pytest options]
# Unit tests and verification with instrumented programs; tables go to build/coverage/*.txt, the
# totals to the terminal. `tests/coverage.sh -k starts` runs only some of the verification.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/support/setup.sh"

dosui_install_packages
mkdir -p "$DOSUI_ROOT/build"
dosui_install_python pytest vtk ruff mypy fprettify fortitude-lint "${DOSUI_SITE_TOOLS[@]}"
"$DOSUI_VENV/bin/pip" install --quiet gcovr pytest-cov
dosui_say "building with counters"
dosui_build coverage all "-DDOSUI_PYTHON=$DOSUI_VENV/bin/python" >"$DOSUI_ROOT/build/coverage.log" 2>&1 ||
  { tail -n 60 "$DOSUI_ROOT/build/coverage.log"; exit 1; }
cd "$DOSUI_ROOT"
find build/coverage -name '*.gcda' -delete
failed=0
dosui_say "unit tests"
ctest --test-dir build/coverage --output-on-failure -L unit -j 2 || failed=1
dosui_say "verification and postprocessing"
DOSUI_BIN="$DOSUI_ROOT/build/coverage/bin" "$DOSUI_VENV/bin/python" -m pytest -q -p no:cacheprovider \
  --cov=dosui_post --cov-report="term:skip-covered" tests/verification postprocess/tests "$@" |
  tee build/coverage/python.txt || failed=1
dosui_say "lines of src/"
"$DOSUI_VENV/bin/gcovr" --root src --object-directory build/coverage --gcov-ignore-parse-errors \
  --merge-mode-functions=separate --txt build/coverage/fortran.txt --print-summary build/coverage
exit "$failed"

#!/usr/bin/env bash
# Builds the site: build/site/index.html, with the pages of the source in build/site/api.
# docs/build.sh [pages]     'pages' leaves out those of the source, which take a minute
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/../tests/support/setup.sh"

cd "$DOSUI_ROOT"
[ -x "$DOSUI_VENV/bin/python" ] || dosui_install_python
if ! "$DOSUI_VENV/bin/python" -c 'import ford, latex2mathml, material' 2>/dev/null; then
  "$DOSUI_VENV/bin/pip" install --quiet 'ford>=7.0.10,<8' "${DOSUI_SITE_TOOLS[@]}"
fi
export NO_MKDOCS_2_WARNING=1
if [ "${1:-}" != pages ]; then export DOSUI_SITE_API=1; fi

dosui_say "pages of docs/"
"$DOSUI_VENV/bin/mkdocs" build --strict   # with --quiet it would not see warnings
if [ "${1:-}" != pages ]; then
  dosui_say "pages of src/"
  rm -rf build/api-sources
  "$DOSUI_VENV/bin/python" docs/site/prepare_sources.py build/api-sources
  "$DOSUI_VENV/bin/ford" docs/site/api.md >build/ford.log 2>&1 || { tail -n 40 build/ford.log; exit 1; }
  if grep -A 1 -i warning build/ford.log; then
    echo "FORD warns: build/ford.log" >&2
    exit 1
  fi
  "$DOSUI_VENV/bin/python" docs/site/finish_api.py build/site/api
fi
dosui_say "build/site/index.html"

#!/usr/bin/env bash
# From an empty machine to the published verification: installs what is missing, builds Release,
# runs Terzaghi and Mandel on 2 ranks, prints the errors against the exact solutions and draws the
# pictures into output/.   input/quickstart.sh
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/../tests/support/setup.sh"

dosui_install_packages
dosui_install_python
dosui_say "building Release"
mkdir -p "$DOSUI_ROOT/build"
dosui_build release "dosui dosui1d dosui2d dosui3d" >"$DOSUI_ROOT/build/quickstart.log" 2>&1 ||
  { tail -n 60 "$DOSUI_ROOT/build/quickstart.log"; exit 1; }
cd "$DOSUI_ROOT"
mkdir -p output
post=$DOSUI_VENV/bin/dosui-post
for scene in terzaghi/scene_2d mandel/nu_0.0 mandel/nu_0.2 mandel/nu_0.4; do
  dosui_say "mpirun -n 2 dosui input/$scene.nml"
  mpirun -n 2 build/release/bin/dosui "input/$scene.nml" --output output
done
dosui_say "errors against the exact solutions"
"$post" verify output/terzaghi_2d.vtkhdf output/mandel_nu_*.vtkhdf
dosui_say "pictures"
"$post" plot isochrones output/terzaghi_2d.vtkhdf -o output/terzaghi_isochrones.png
"$post" plot settlement output/terzaghi_2d.vtkhdf -o output/terzaghi_settlement.png
"$post" plot mandel output/mandel_nu_*.vtkhdf -o output/mandel_pressure.png
"$post" plot map output/mandel_nu_0.2.vtkhdf --field pore_pressure --step 1 -o output/mandel_map.png

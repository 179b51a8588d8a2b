# Sourced by tests/run.sh and input/quickstart.sh: installs what is missing and prepares Python.
# Sets DOSUI_ROOT and DOSUI_VENV. Works as root, with sudo, and offline once everything is there.
DOSUI_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
DOSUI_VENV=$DOSUI_ROOT/build/venv
DOSUI_SITE_TOOLS=('mkdocs-material>=9.6,<10' 'latex2mathml>=3.77,<4')   # pages of docs/ as a site

# Open MPI in containers: root, more ranks than cores, no CMA between processes.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
export OMPI_MCA_mpi_yield_when_idle=1 OMPI_MCA_btl_vader_single_copy_mechanism=none
export OMPI_MCA_hwloc_base_binding_policy=none OMP_NUM_THREADS=1 MPLBACKEND=Agg

dosui_say() { printf '\n== %s  %s\n' "$(date +%H:%M:%S)" "$*"; }

dosui_install_packages() {   # Debian packages that are not installed yet
  local missing=() package
  for package in gfortran g++ libopenmpi-dev openmpi-bin libhdf5-openmpi-dev libmetis-dev libpetsc-real-dev cmake \
                 ninja-build python3-venv git ca-certificates; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' ||
      missing+=("$package")
  done
  [ ${#missing[@]} -eq 0 ] && return 0
  dosui_say "installing ${missing[*]}"
  local as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || { echo "needs root or sudo to install: ${missing[*]}" >&2; return 1; }
    as_root=(sudo)
  fi
  "${as_root[@]}" apt-get update -qq &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq \
      --no-install-recommends "${missing[@]}" >/dev/null
}

dosui_install_python() {   # a venv with dosui_post; arguments: further packages
  local stamp=$DOSUI_VENV/.installed wanted
  wanted="$(cat "$DOSUI_ROOT/postprocess/pyproject.toml" | cksum) $*"
  if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    dosui_say "preparing Python in build/venv"
    local python=python3
    [ -x /usr/bin/python3 ] && python=/usr/bin/python3
    [ -x "$DOSUI_VENV/bin/python" ] || "$python" -m venv "$DOSUI_VENV" || return 1
    "$DOSUI_VENV/bin/pip" install --quiet --upgrade pip setuptools wheel &&
      "$DOSUI_VENV/bin/pip" install --quiet --no-build-isolation -e "$DOSUI_ROOT/postprocess" "$@" ||
      return 1
    printf '%s' "$wanted" >"$stamp"
  fi
}

dosui_build() {   # arguments: preset, targets ('all' or names with blanks), then cmake options
  local preset=$1 targets=$2
  shift 2
  # Tests are always configured: an option left in the cache would make a later ctest find none.
  # shellcheck disable=SC2086
  (cd "$DOSUI_ROOT" && cmake --preset "$preset" -DDOSUI_TESTS=ON "$@" &&
    cmake --build --preset "$preset" --parallel 2 --target $targets)
}

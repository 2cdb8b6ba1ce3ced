#!/usr/bin/env bash
# The tests of what hangs on the inside of JAX and llvmlite, with the oldest of both that pyproject.toml allows, in a fresh virtual
# environment: `tests/oldest_versions.sh`, or with tests of your own choice behind it. CI runs the newest alone; run this where a bound
# changes, and where `jaxik/spmd` uses something of JAX's that it did not use before.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/oldest"
source "$work/oldest/bin/activate"
export XDG_CACHE_HOME="$work/cache" JAX_COMPILATION_CACHE_DIR="$work/cache/jaxik" MPLBACKEND=Agg
mapfile -t oldest < <(python - <<'PYTHON'
import re
import tomllib
from pathlib import Path

for each in tomllib.loads(Path("pyproject.toml").read_text())["project"]["dependencies"]:
    name, version = re.match(r"([a-z]+)>=([\d.]+)", each).groups()
    if name in ("jax", "llvmlite"):
        print(f"{name}=={version}.0")
PYTHON
)
pip install -q -e ".[test]" "${oldest[@]}"
pip list | grep -Ei "^(jax|jaxlib|llvmlite|numpy|scipy) "
[ $# -gt 0 ] || set -- tests/spmd tests/kinematics tests/ik tests/optimise
python -m pytest -q "$@"

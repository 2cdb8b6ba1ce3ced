#!/usr/bin/env bash
# All tests as if llvmlite were not installed, area by area: `tests/without_llvmlite.sh [AREA...]`, such as `kinematics dynamics`.
# Everything runs by XLA then, many times as slow, so this is for a night: an area that takes more than LIMIT seconds (7,200) is
# given up and counts as failed. Tests of kernels themselves are left out, and how many is told (`tests/conftest.py`).
set -uo pipefail
cd "$(dirname "$0")/.."
hidden=$(mktemp -d)
trap 'rm -rf "$hidden"' EXIT
mkdir "$hidden/llvmlite"
echo 'raise ImportError("llvmlite is hidden, by tests/without_llvmlite.sh")' > "$hidden/llvmlite/__init__.py"
export PYTHONPATH="$hidden${PYTHONPATH:+:$PYTHONPATH}"
export JAX_ENABLE_COMPILATION_CACHE=0  # jaxlib 0.10 died twice while it wrote a large program to the cache, after hundreds of tests
areas=("$@")
if [ ${#areas[@]} = 0 ]; then
  for folder in tests/*/; do compgen -G "$folder/test_*.py" > /dev/null && areas+=("$(basename "$folder")"); done
  areas+=($(basename -a tests/test_*.py))
fi
failed=()
for area in "${areas[@]}"; do
  echo "== $area"
  timeout "${LIMIT:-7200}" python -m pytest -q "tests/$area"
  code=$?
  test $code = 0 -o $code = 5 || failed+=("$area")  # 5: an area of kernels alone
done
echo "failed: ${failed[*]:-none}"
test ${#failed[@]} = 0

#!/usr/bin/env bash
# What pytest cannot: exported functions on processors that are not here, and under tools that watch memory. Needs qemu-user,
# gcc-aarch64-linux-gnu, valgrind and nodejs (Debian's packages), and the extra `export`. `tests/cross_targets.py` writes the folders.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
here=$(dirname "$0")
python "$here/cross_targets.py" "$work"

# AArch64: 10,000 configurations, at most 4 units in the last place from this machine's, under an emulator
aarch64-linux-gnu-gcc -O2 -static "$work/aarch64/test.c" "$work"/aarch64/lib*.a -o "$work/aarch64/run"
qemu-aarch64 "$work/aarch64/run"

# the oldest x86-64 and this one: no byte is read or written that is not the function's own; valgrind knows no AVX-512
for target in x86-64 native; do
  gcc -g -O1 -fsanitize=address,undefined "$work/$target/test.c" "$work/$target"/lib*.a -o "$work/$target/watched"
  "$work/$target/watched"
done
gcc -g -O1 "$work/x86-64/test.c" "$work"/x86-64/lib*.a -o "$work/x86-64/plain"
valgrind -q --error-exitcode=9 "$work/x86-64/plain"

# WebAssembly, in Node
node "$here/cross_targets.mjs" "$work/wasm32"

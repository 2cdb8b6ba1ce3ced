"""Functions as a module of WebAssembly, and a module of JavaScript that calls it on arrays."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from jaxik.codegen.functions import Function

_ARRAYS = {"float": "Float32Array", "double": "Float64Array", "i1": "Uint8Array"}
_ARRAYS |= {f"{sign}{bits}": f"{'Uint' if sign == 'u' else 'Int'}{bits}Array" for sign in "iu" for bits in (8, 16, 32)}
_ARRAYS |= {"i64": "BigInt64Array", "u64": "BigUint64Array"}
STACK, ROOM = 1 << 17, 1 << 16  # bytes of the module's stack, and of what a call's arrays have at first


def module(functions: Sequence[Function]) -> bytes:
    """The linked module, with its memory. Raises `ValueError` where there is no linker for it."""
    linker = _linker()
    if linker is None:
        told = "is linked by wasm-ld, which is not installed; pip install ziglang (or jaxik[export])"
        raise ValueError(f"export: {functions[0].name}: WebAssembly {told}")
    with tempfile.TemporaryDirectory() as folder:
        objects, made = [Path(folder) / f"{each.name}.o" for each in functions], Path(folder) / "made.wasm"
        for path, each in zip(objects, functions, strict=True):
            path.write_bytes(each.image)
        exports = [f"--export={symbol}" for each in functions for symbol in each.symbols]
        options = ["--no-entry", "--export=__heap_base", "--allow-undefined", "--strip-all", "-z", f"stack-size={STACK}"]
        ran = subprocess.run([*linker, *options, *exports, "-o", str(made), *map(str, objects)], capture_output=True, text=True)
        if ran.returncode:
            raise ValueError(f"export: {functions[0].name}: {linker[-1]} does not link it: {ran.stderr.strip()[:300]}")
        return made.read_bytes()


def _linker() -> list[str] | None:
    """The command of LLVM's linker for WebAssembly: its own, or that in Zig's compiler."""
    own = shutil.which("wasm-ld")
    if own is not None:
        return [own]
    return [sys.executable, "-m", "ziglang", "wasm-ld"] if importlib.util.find_spec("ziglang") else None


def javascript(name: str, functions: Sequence[Function]) -> str:
    """The text of `NAME.mjs`."""
    field = lambda f: [f.name, _ARRAYS[f.kind], f.size]
    described = {
        each.name: {
            "arguments": [[*field(f), f.shared] for f in each.arguments],
            "results": list(map(field, each.results)),
            "workspace": each.workspace,
        }
        for each in functions
    }
    return _LOADER.replace("@NAME@", name).replace("@FUNCTIONS@", json.dumps(described, indent=2))


_LOADER = """// The functions of @NAME@ on arrays; made by jaxik, and yours.
//
//     import { load } from "./@NAME@.mjs";
//     const robot = await load();            // or load(bytes)
//     const { pose } = robot.@NAME@_pose({ q: [0, 0, 0, 0, 0, 0, 0] });
//
// Arguments are arrays of one configuration, or of several end to end; results are typed arrays, row by row.

const DESCRIBED = @FUNCTIONS@;
const LIBRARY = { sin: Math.sin, cos: Math.cos, tan: Math.tan, pow: Math.pow, fmod: (a, b) => a % b };
const KINDS = { Float32Array, Float64Array, Uint8Array, Int8Array, Uint16Array, Int16Array, Uint32Array, Int32Array,
  BigUint64Array, BigInt64Array };

export async function load(source = new URL("./@NAME@.wasm", import.meta.url)) {
  const bytes = source instanceof URL || typeof source === "string" ? await (await fetch(source)).arrayBuffer() : source;
  const env = {};
  for (const [name, of] of Object.entries(LIBRARY)) {
    env[name] = of;
    env[name + "f"] = (...x) => Math.fround(of(...x));
  }
  const { instance } = await WebAssembly.instantiate(bytes, { env });
  const made = {};
  for (const [name, { arguments: taken, results, workspace }] of Object.entries(DESCRIBED)) {
    made[name] = (given) => call(instance.exports, name, taken, results, workspace, given);
  }
  return made;
}

function call(exports, name, taken, results, workspace, given) {
  let count = null;
  for (const [word, , size, shared] of taken) {
    const length = given?.[word]?.length ?? (typeof given?.[word] === "number" ? 1 : -1);
    const rows = length / size;
    if (!Number.isInteger(rows) || rows < 1 || (shared && rows !== 1) || (count !== null && !shared && rows !== count)) {
      throw new RangeError(`${name}: ${word} has ${length} numbers; give ${size}, or as many rows of them as the others`);
    }
    if (!shared) count = rows;
  }
  count ??= 1;
  let at = exports.__heap_base.value;
  const place = (bytes) => {
    at = (at + 63) & ~63;
    const here = at;
    at += bytes;
    return here;
  };
  const all = [...taken.map(([, kind, size, shared]) => [kind, shared ? size : count * size])];
  all.push(...results.map(([, kind, size]) => [kind, count * size]));
  const places = all.map(([kind, size]) => place(size * KINDS[kind].BYTES_PER_ELEMENT));
  const room = workspace ? [place(workspace)] : [];
  const missing = at - exports.memory.buffer.byteLength;
  if (missing > 0) exports.memory.grow(Math.ceil(missing / 65536));
  const view = (k) => new KINDS[all[k][0]](exports.memory.buffer, places[k], all[k][1]);
  taken.forEach(([word], k) => view(k).set(typeof given[word] === "number" ? [given[word]] : given[word]));
  if (count === 1) exports[name](...places, ...room);
  else exports[`${name}_batch`](count, ...places, ...room);
  return Object.fromEntries(results.map(([word], k) => [word, view(taken.length + k).slice()]));
}
"""

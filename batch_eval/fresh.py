"""What only a fresh process can tell: cold starts, compile times, memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMPILE = """
import time
import jax, jax.numpy as jnp, jaxik
chain, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
q, start = jnp.zeros((1000, 7)), time.perf_counter()
for f in (jaxik.forward_kinematics, jaxik.jacobian, lambda chain, q: jaxik.clearance(chain, scene, q)):
    jax.jit(jax.vmap(lambda q: f(chain, q))).lower(q).compile()
print(time.perf_counter() - start)
"""

MEMORY = """
import json
import jaxik

def peak():  # not getrusage: it begins with what the parent process had
    return 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))

chain, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
jaxik.scan(chain, scene, scene.fruits[0], 8, 4)
before = peak()
found = jaxik.scan(chain, scene, scene.fruits[0], 720, 174)
print(json.dumps({"candidates": found.status.size, "before_bytes": before, "peak_bytes": peak()}))
"""


def _run(*arguments: str, cache: str | None = None) -> tuple[str, float]:
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    environment |= {"XDG_CACHE_HOME": cache} if cache else {"JAXIK_CACHE": "off"}
    start = time.perf_counter()
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=True)
    return done.stdout, time.perf_counter() - start


def compile_seconds() -> float:
    """Tracing and compiling FK, Jacobian and clearance of P6R, apart from importing."""
    return float(_run("-c", COMPILE)[0])


def scan_memory() -> dict[str, float]:
    """Peak memory of a process that scans a million candidates [bytes]."""
    return json.loads(_run("-c", MEMORY)[0])


def cold_starts() -> tuple[float, float]:
    """`jaxik harvest` with picture, from the shell and back [s]: with an empty compilation cache, and again with it warm."""
    with tempfile.TemporaryDirectory() as folder:
        command = ("-c", "from jaxik.cli import main; main()", "harvest", "--out", str(Path(folder) / "out"))
        first, again = (_run(*command, cache=folder)[1] for _ in range(2))
    return first, again

"""Kernels are written against JAX's own rules, which change: an older JAX would fail deep inside, so it is told at import."""

import jax

OLDEST = 0, 10  # of what is tested

if tuple(map(int, jax.__version__.split(".")[:2])) < OLDEST:
    wanted = ".".join(map(str, OLDEST))
    raise ImportError(f"jaxik needs jax {wanted} or newer, and here is {jax.__version__}; pip install -U 'jax>={wanted}'")

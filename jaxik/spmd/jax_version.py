"""Kernels are written against JAX's own rules, which change: an older JAX would fail deep inside, so it is told at import."""

from typing import Any

import jax

OLDEST = 0, 8  # of what is tested

if tuple(map(int, jax.__version__.split(".")[:2])) < OLDEST:
    wanted = ".".join(map(str, OLDEST))
    raise ImportError(f"jaxik needs jax {wanted} or newer, and here is {jax.__version__}; pip install -U 'jax>={wanted}'")

# the manual axes of a mesh along which an array varies: before 0.10 they stood in the type by themselves
MANUAL = "manual_axis_type" if hasattr(jax.core.ShapedArray((), int), "mat") else "vma"


def varied(x: Any, axes: tuple[str, ...]) -> Any:
    """An array as one that varies along more manual axes of a mesh."""
    cast = getattr(jax.lax, "pcast", None)
    return cast(x, axes, to="varying") if cast else jax.lax.pvary(x, axes)  # type: ignore[attr-defined]


def manual(aval: Any) -> dict[str, Any]:
    """The argument by which another type varies along the same axes of a mesh."""
    return {MANUAL: aval.mat if MANUAL == "manual_axis_type" else aval.vma}


def varying(aval: Any) -> frozenset[str]:
    """The manual axes of a mesh along which an array differs."""
    return aval.mat.varying if MANUAL == "manual_axis_type" else aval.vma


def scanned(params: Any) -> tuple[int, int]:
    """How many constants a scan has, and how many values it carries. From 0.11 on all its arguments are one tree."""
    if "ft_in" in params:
        constants, carried, _ = map(len, params["ft_in"].unpack())
        return constants, carried
    return params["num_consts"], params["num_carry"]

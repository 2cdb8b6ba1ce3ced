"""Arrays of numbers from what a caller gives; or the one line that says what was given, and what is allowed."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import shown

Array = jax.Array | np.ndarray
RIGID = 1e-4  # how far R'R may be from 1 in a frame that is still one: rotations in files are rounded


def numbers(what: str, given: Any) -> np.ndarray:
    """`given` in float64. Raises `ValueError` for what is no array of integers or floats: text, truth values, ragged
    lists, masked entries."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):  # what lies under a mask would come back
        raise ValueError(f"{what}: masked entries; write finite ints or floats, and leave out what is not known")
    try:
        array = np.asarray(given)
        if array.dtype.kind in "iuf":
            return array.astype(np.float64)
    except jax.errors.TracerArrayConversionError:
        raise ValueError(f"{what}: traced; give numbers, and replace the arrays of what is made of them") from None
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"{what}: {type(given).__name__} that is no array of numbers; write finite ints or floats")


def shaped(what: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """`numbers` of one shape. Raises `ValueError` for another."""
    array = numbers(what, given)
    if array.shape != shape:
        raise ValueError(f"{what} of shape {array.shape}; allowed: {shape if shape else 'one number'}")
    return array


def as_numbers(what: str, given: Any) -> jax.Array:
    """`given`, traced or not, as an array of integers or floats. Raises `ValueError` for what is none."""
    try:
        array = jnp.asarray(given)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} is {shown(given)}; write an array of numbers") from None
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        raise ValueError(f"{what} is an array of {array.dtype}; write real numbers")
    return array


def as_shaped(what: str, given: Any, shape: tuple[int, ...]) -> jax.Array:
    """`as_numbers` of one shape. Raises `ValueError` for another."""
    array = as_numbers(what, given)
    if array.shape != shape:
        raise ValueError(f"{what} has the shape {array.shape}; allowed: {shape if shape else 'one number'}")
    return array


def as_given(what: str, given: Any, shape: tuple[int, ...]) -> Array:
    """Numbers of one shape, in float64 where they are known and as they are where they are traced. Raises `ValueError`
    likewise."""
    return shaped(what, given, shape) if is_known(given) else as_shaped(what, given, shape)


def stop_gradients(tree: Any) -> Any:
    """A tree without derivatives; what is known stays known, so that it folds."""
    return jax.tree_util.tree_map(lambda x: jax.lax.stop_gradient(x) if isinstance(x, jax.Array) else x, tree)


def is_known(given: Any) -> bool:
    """Whether nothing of it is traced."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(given))


def check_known(who: str, **given: Any) -> None:
    """Raises `ValueError` for traced values, which a function on the host cannot read."""
    for name, value in given.items():
        if not is_known(value):
            mend = "this runs on the host, outside of jit, vmap and grad, and takes numbers"
            raise ValueError(f"{who}: {name} is traced; {mend}")


def direction(what: str, given: Any) -> np.ndarray:
    """A unit vector (3,); one that is given stays as it is, so that a file that holds it gives it back.

    Raises `ValueError` for another shape, and for what has no length or is not finite.
    """
    axis = shaped(what, given, (3,))
    if not np.all(np.isfinite(axis)):
        raise ValueError(f"{what} holds {axis[~np.isfinite(axis)][0]:g}; write finite numbers, not NaN or infinity")
    norm = float(np.linalg.norm(axis))
    if not 1e-9 < norm < np.inf:
        raise ValueError(f"{what} is no direction; write a unit vector such as (0, 0, 1)")
    return axis if abs(norm - 1.0) <= 1e-15 else axis / norm


def positive(what: str, given: Any, lone: bool = False) -> float | tuple[float, ...] | None:
    """`given` (n,), one finite number a joint, as a tuple; where a `lone` one for all is allowed, which is a bound, infinity is
    allowed, too. None as it is. Raises `ValueError` for another shape, and for what is not above zero.
    """
    if given is None:
        return None
    values = numbers(what, given)
    fits = values.size > 0 and values.ndim <= 1 and (lone or (values.ndim and np.isfinite(values).all()))
    if not (fits and (values > 0.0).all()):
        also = "one number, or one" if lone else "one finite number"
        raise ValueError(f"{what} is {shown(given)}; allowed: {also} a joint, all above zero")
    return tuple(values.tolist()) if values.ndim else float(values)


def is_rigid(frames: np.ndarray) -> np.ndarray:
    """Whether each of `frames` (..., 4, 4) is finite, a right-handed rotation and a translation."""
    rotation = frames[..., :3, :3]
    with np.errstate(all="ignore"):
        off = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(axis=(-1, -2), initial=0.0)
        last = np.abs(frames[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(axis=-1, initial=0.0)
        finite = np.isfinite(frames).all(axis=(-1, -2))
        return np.asarray(finite & (off <= RIGID) & (last <= RIGID) & (np.linalg.det(rotation) > 0.0))


def rigid_frame(what: str, given: Any) -> Any:
    """`given` as a rigid frame (4, 4) [m]: in float64, or as it is where it is JAX's. A traced one is checked by its shape.

    Raises `ValueError` for another shape, and for what shears, scales or mirrors.
    """
    if isinstance(given, jax.core.Tracer):
        if given.shape != (4, 4):
            raise ValueError(f"{what} of shape {given.shape}; allowed: (4, 4)")
        return given
    frame = shaped(what, given, (4, 4))
    if not is_rigid(frame):
        raise ValueError(f"{what} is no rigid frame; allowed: finite, a right-handed rotation, and 0 0 0 1 below")
    return given if isinstance(given, jax.Array) and jnp.issubdtype(given.dtype, jnp.floating) else frame

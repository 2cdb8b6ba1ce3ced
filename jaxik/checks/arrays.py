"""Arrays of numbers from what a caller gives; or the one line that says what was given, and what is allowed."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import as_count, shown

Array = jax.Array | np.ndarray
RIGID = 1e-4  # how far R'R may be from 1 in a frame that is still one: rotations in files are rounded
ROUNDED = 1e-3  # of the largest moment of inertia that may be missing, for the same reason


Shape = tuple[Any, ...]  # of lengths; a letter is any length, and `...` in front any leading axes


def numbers(what: str, given: Any, *shapes: Shape, finite: bool = False) -> np.ndarray:
    """`given` in float64. Raises `ValueError` for what is no array of integers or floats: text, truth values, ragged lists,
    masked entries; for a shape that is none of `shapes`, if there are any; and where all are to be `finite` for others."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):  # what lies under a mask would come back
        raise ValueError(f"{what}: masked entries; write finite ints or floats, and leave out what is not known")
    try:
        array = np.asarray(given)
    except jax.errors.TracerArrayConversionError:
        raise ValueError(f"{what}: traced; give numbers, and replace the arrays of what is made of them") from None
    except (TypeError, ValueError, OverflowError):
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what}: {type(given).__name__} that is no array of numbers; write finite ints or floats")
    check_shape(what, array, *shapes)
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{what} holds {array[~np.isfinite(array)][0]:g}; write finite numbers, not NaN or infinity")
    return array.astype(np.float64)


def as_numbers(what: str, given: Any, *shapes: Shape) -> jax.Array:
    """`given`, traced or not, as an array of integers or floats. Raises `ValueError` for what is none, and for a shape that is
    none of `shapes`, if there are any."""
    try:
        array = jnp.asarray(given)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} is {shown(given)}; write an array of numbers") from None
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        raise ValueError(f"{what} is an array of {array.dtype}; write real numbers")
    check_shape(what, array, *shapes)
    return array


def as_given(what: str, given: Any, *shapes: Shape) -> Array:
    """`numbers` where they are known, and `as_numbers` where they are traced."""
    return numbers(what, given, *shapes) if is_known(given) else as_numbers(what, given, *shapes)


def check_shape(what: str, array: Any, *shapes: Shape) -> None:
    """Raises `ValueError` for an array in none of the `shapes`; any will do where there are none."""
    if shapes and not any(fits(array.shape, shape) for shape in shapes):
        raise ValueError(f"{what} has the shape {array.shape}; allowed: {' or '.join(map(written, shapes))}")


def fits(lengths: tuple[int, ...], shape: Shape) -> bool:
    """Whether an array of these `lengths` has the `shape`."""
    if shape[:1] == (...,):
        return len(lengths) >= len(shape) - 1 and fits(lengths[len(lengths) - len(shape) + 1 :], shape[1:])
    return len(lengths) == len(shape) and all(isinstance(n, str) or n == m for n, m in zip(shape, lengths, strict=True))


def written(shape: Shape) -> str:
    """The shape in words, such as (k, 3)."""
    lengths = ", ".join("..." if n is ... else str(n) for n in shape)
    return f"({lengths}{',' * (len(shape) == 1)})" if shape else "one number"


def as_count_or_values(name: str, value: Any, shape: Shape) -> int | np.ndarray:
    """A count, or finite values in float64 of the `shape`, at least one row of them; rows of one value may be bare.

    Raises a `ValueError` of one line for anything else: a truth value, text, a lone float.
    """
    also = f", or finite values of shape {written(shape)}"
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):  # ragged
        raise ValueError(f"{name}: {type(value).__name__} that is no array; allowed: a count{also}") from None
    if not given.ndim:
        return as_count(name, value, also)
    rows = given[:, None] if shape[1:] == (1,) and given.ndim == 1 else given
    if given.dtype.kind not in "iuf" or not fits(rows.shape, shape) or not len(rows) or not np.isfinite(given).all():
        raise ValueError(f"{name} has shape {given.shape}, {given.dtype}; allowed: a count{also}")
    return rows.astype(np.float64)


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
    axis = numbers(what, given, (3,), finite=True)
    norm = float(np.linalg.norm(axis))
    if not 1e-9 < norm < np.inf:
        raise ValueError(f"{what} is no direction; write a unit vector such as (0, 0, 1)")
    return axis if abs(norm - 1.0) <= 1e-15 else axis / norm


def positive(what: str, given: Any, lone: bool = False, each: str = "joint") -> float | tuple[float, ...] | None:
    """`given` (n,), one finite number a joint, or another `each`, as a tuple; where a `lone` one for all is allowed,
    which is a bound, infinity is allowed, too. None as it is. Raises `ValueError` for another shape, and for what is not above
    zero.
    """
    if given is None:
        return None
    values = numbers(what, given)
    fits = values.size > 0 and values.ndim <= 1 and (lone or (values.ndim and np.isfinite(values).all()))
    if not (fits and (values > 0.0).all()):
        also = "one number, or one" if lone else "one finite number"
        raise ValueError(f"{what} is {shown(given)}; allowed: {also} a {each}, all above zero")
    return tuple(values.tolist()) if values.ndim else float(values)


def is_rigid(frames: Any) -> Any:
    """Whether each of `frames` (..., 4, 4) is finite, a right-handed rotation and a translation. Traced, or in NumPy."""
    if isinstance(frames, np.ndarray) and frames.shape == (4, 4):
        return np.bool_(_one_is_rigid(*frames.tolist()))
    xp: Any = np if isinstance(frames, np.ndarray) else jnp
    rotation, last = frames[..., :3, :3], np.array([0.0, 0.0, 0.0, 1.0])
    with np.errstate(all="ignore"):
        x, y, z = (rotation[..., i, :] for i in range(3))
        right_handed = xp.sum(xp.cross(x, y) * z, axis=-1) > 0.0
        off = xp.abs(xp.swapaxes(rotation, -1, -2) @ rotation - np.eye(3))
        away = xp.abs(frames[..., 3, :] - last)
        near = xp.all(off <= RIGID, axis=(-1, -2)) & xp.all(away <= RIGID, axis=-1)
        return near & right_handed & xp.all(xp.isfinite(frames), axis=(-1, -2))


def _one_is_rigid(x: list[float], y: list[float], z: list[float], last: list[float]) -> bool:
    """`is_rigid` of one frame by its rows, in a twentieth of the time that NumPy takes to begin and end its loops."""
    (a, b, c, p), (d, e, f, q), (g, h, i, r) = x, y, z
    unit = abs(a * a + d * d + g * g - 1.0), abs(b * b + e * e + h * h - 1.0), abs(c * c + f * f + i * i - 1.0)
    square = abs(a * b + d * e + g * h), abs(a * c + d * f + g * i), abs(b * c + e * f + h * i)
    away = abs(last[0]), abs(last[1]), abs(last[2]), abs(last[3] - 1.0)
    near = max(*unit, *square, *away) <= RIGID  # or something is NaN, which makes the volume or the sum below so
    right_handed = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) > 0.0
    return near and right_handed and math.isfinite(p + q + r + sum(last))


def rigid_frame(what: str, given: Any) -> Any:
    """`given` as a rigid frame (4, 4) [m]: in float64, or as it is where it is JAX's. A traced one is checked by its shape.

    Raises `ValueError` for another shape, and for what shears, scales or mirrors.
    """
    if isinstance(given, jax.core.Tracer):
        check_shape(what, given, (4, 4))
        return given
    frame = numbers(what, given, (4, 4))
    if not is_rigid(frame):
        raise ValueError(f"{what} is no rigid frame; allowed: finite, a right-handed rotation, and 0 0 0 1 below")
    return given if isinstance(given, jax.Array) and jnp.issubdtype(given.dtype, jnp.floating) else frame


def check_mass(what: str, mass: Any, com: Any, inertia: Any) -> None:
    """Raises `ValueError` for a mass [kg], a centre of gravity [m] and an inertia about it [kg m2] that no body can have.

    No mass at all and a point mass are bodies, and so is an inertia alone, as files have it of a rotor.
    """
    mass, com, inertia = (np.asarray(x, np.float64) for x in (mass, com, inertia))
    if not all(np.all(np.isfinite(x)) for x in (mass, com, inertia)):
        raise ValueError(f"{what} holds NaN or infinity; write finite mass, com and inertia")
    if mass < 0.0:
        raise ValueError(f"{what} has a mass of {mass:g} kg; write a mass >= 0")
    dust = 1e-9 * mass
    if np.abs(inertia - inertia.T).max() > ROUNDED * np.abs(inertia).max() + dust:
        raise ValueError(f"{what} has an inertia that is not symmetric; write Ixy = Iyx, Ixz = Izx, Iyz = Izy")
    moments = np.linalg.eigvalsh(inertia)
    slack = ROUNDED * np.abs(moments).max() + dust
    written = ", ".join(f"{m:.4g}" for m in moments)
    if moments[0] < -slack:
        raise ValueError(f"{what} has principal moments of {written} kg m2; allowed: none below 0")
    if moments[0] + moments[1] < moments[2] - slack:
        mend = "the largest is at most the sum of the others; is the inertia about the centre of gravity?"
        raise ValueError(f"{what} has principal moments of {written} kg m2; {mend}")

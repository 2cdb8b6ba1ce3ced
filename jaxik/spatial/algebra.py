"""The algebra of rigid motions on scalars.

A vector here is three scalars and a frame twelve, not arrays. A scalar that is a Python float is a constant: sums and products
with 0 and +-1 fold away while JAX traces, so that a robot's right angles cost nothing, not even where XLA runs the function.

A scalar is a Python `float`, a JAX array of shape `()`, a NumPy array of any one shape (then the same expression is
evaluated by NumPy over a batch, without a compiler), or a `ball.Ball` (then its range is bounded).

XLA's own `sin` and `cos` are slow on a CPU; `sincos` below is polynomials there and the native functions on other platforms.
Derivatives never pass through the polynomials (`custom_jvp`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spatial.ball import Ball, direction, waves
from jaxik.spmd import elementary

Scalar = Any  # float | jax.Array of shape () | np.ndarray | Ball


# --------------------------------------------------------------------------------------------------------------------
# Sums and products whose constants fold


def _is(a: Scalar, value: float) -> bool:
    return isinstance(a, float) and bool(a == value)


def _plain(operation: Callable[[Any, Any], Any], general: Callable[[Any, Any], Any], a: Scalar, b: Scalar) -> Scalar:
    """JAX's `operation`, of arrays of one type, or one and a float, else the `general` one: with NumPy's promotion it costs
    twice the time to trace."""
    if isinstance(a, jax.Array):
        if isinstance(b, jax.Array):
            return operation(a, b) if a.aval == b.aval else general(a, b)
        return operation(a, a.dtype.type(b)) if _takes(a, b) else general(a, b)
    return operation(b.dtype.type(a), b) if isinstance(b, jax.Array) and _takes(b, a) else general(a, b)


def _takes(a: jax.Array, number: Scalar) -> bool:
    """Whether a float becomes one of the array's type, as it does by JAX's promotion."""
    return type(number) is float and not a.weak_type and a.dtype.kind == "f"


def add(a: Scalar, b: Scalar) -> Scalar:
    """`a + b`; 0 folds."""
    return b if _is(a, 0.0) else a if _is(b, 0.0) else _plain(lax.add, operator.add, a, b)


def sub(a: Scalar, b: Scalar) -> Scalar:
    """`a - b`; 0 folds."""
    return -b if _is(a, 0.0) else a if _is(b, 0.0) else _plain(lax.sub, operator.sub, a, b)


def mul(a: Scalar, b: Scalar) -> Scalar:
    """`a * b`; 0, 1 and -1 fold."""
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    if _is(a, 1.0) or _is(b, 1.0):
        return b if _is(a, 1.0) else a
    if _is(a, -1.0) or _is(b, -1.0):
        return -b if _is(a, -1.0) else -a
    return _plain(lax.mul, operator.mul, a, b)


def safe_divide(a: Any, b: Any) -> Any:
    """`a / b`, and 0 where b = 0."""
    return jnp.where(b == 0.0, 0.0, a / jnp.where(b == 0.0, 1.0, b))


def constants(values: Any, snap: float = 0.0) -> list[Any]:
    """The entries of an array as scalars: floats that fold if it is concrete, traced scalars if it is not.

    A concrete entry within `snap` of 0, 1 or -1 becomes that number. Files write a right angle as 1.5708, and the cosine of
    that, 4e-6 or 4e-12 or 6e-17, would otherwise keep a whole row of products alive for a digit that the working precision
    does not hold.
    """
    if isinstance(values, jax.core.Tracer):
        return traced(values)
    flat = [float(x) for x in np.asarray(values, dtype=np.float64).ravel()]
    return [next((w for w in (0.0, 1.0, -1.0) if abs(x - w) <= snap), x) for x in flat]


def traced(values: Any) -> list[Any]:
    """The entries of an array as scalars of its dtype, none of which folds."""
    return [values[i] for i in np.ndindex(values.shape)]


# --------------------------------------------------------------------------------------------------------------------
# Vectors, rotations, frames


class Vec3(NamedTuple):
    """A point or direction."""

    x: Scalar
    y: Scalar
    z: Scalar

    def __add__(self, o: Vec3) -> Vec3:  # type: ignore[override]
        return Vec3(add(self.x, o.x), add(self.y, o.y), add(self.z, o.z))

    def __sub__(self, o: Vec3) -> Vec3:
        return Vec3(sub(self.x, o.x), sub(self.y, o.y), sub(self.z, o.z))

    def __neg__(self) -> Vec3:
        return Vec3(sub(0.0, self.x), sub(0.0, self.y), sub(0.0, self.z))

    def __mul__(self, s: Scalar) -> Vec3:  # type: ignore[override]
        return Vec3(mul(self.x, s), mul(self.y, s), mul(self.z, s))

    def dot(self, o: Vec3) -> Scalar:
        return add(add(mul(self.x, o.x), mul(self.y, o.y)), mul(self.z, o.z))

    def cross(self, o: Vec3) -> Vec3:
        return Vec3(
            sub(mul(self.y, o.z), mul(self.z, o.y)),
            sub(mul(self.z, o.x), mul(self.x, o.z)),
            sub(mul(self.x, o.y), mul(self.y, o.x)),
        )


ZERO = Vec3(0.0, 0.0, 0.0)


class Rot3(NamedTuple):
    """A rotation, as the rows of its matrix: `R @ v`, `R @ S`, `R.T`."""

    row_x: Vec3
    row_y: Vec3
    row_z: Vec3

    def __matmul__(self, o: Any) -> Any:
        if isinstance(o, Vec3):
            return Vec3(*(row.dot(o) for row in self))
        columns = o.T
        return Rot3(*(Vec3(*(row.dot(c) for c in columns)) for row in self))

    @property
    def T(self) -> Rot3:  # the name that arrays use
        return Rot3(*(Vec3(*c) for c in zip(*self, strict=True)))

    @property
    def entries(self) -> tuple[Scalar, ...]:
        return (*self.row_x, *self.row_y, *self.row_z)

    @property
    def skew(self) -> Vec3:
        """The axis times the sine of the angle; of a change of a rotation, `R' R.T`, the angular velocity."""
        x, y, z = self
        return Vec3(sub(z.y, y.z), sub(x.z, z.x), sub(y.x, x.y)) * 0.5

    @staticmethod
    def about(axis: Vec3, sin: Scalar, cos: Scalar) -> Rot3:
        """The rotation by an angle with this sine and cosine about a unit `axis` (Rodrigues): `c 1 + s [a]x + (1-c) a a'`."""
        versine = sub(1.0, cos)
        a, s = axis, axis * sin
        ax, ay, az = (axis * mul(versine, component) for component in a)
        # c + (1 - c) folds where the axis is one of the frame's own
        xx, yy, zz = (1.0 if _is(c, 1.0) or _is(c, -1.0) else add(cos, v) for c, v in zip(a, (ax.x, ay.y, az.z), strict=True))
        return Rot3(
            Vec3(xx, sub(ax.y, s.z), add(ax.z, s.y)),
            Vec3(add(ay.x, s.z), yy, sub(ay.z, s.x)),
            Vec3(sub(az.x, s.y), add(az.y, s.x), zz),
        )

    @staticmethod
    def of(entries: Sequence[Scalar]) -> Rot3:
        """Makes a rotation of nine scalars, row by row."""
        return Rot3(Vec3(*entries[0:3]), Vec3(*entries[3:6]), Vec3(*entries[6:9]))


IDENTITY = Rot3(Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0))


class Frame(NamedTuple):
    """A rigid motion `a_T_b`: `a_T_b @ b_p` is the point in a, `a_T_b @ b_T_c` the frame of c in a."""

    rotation: Rot3
    translation: Vec3

    def __matmul__(self, o: Any) -> Any:
        if isinstance(o, Vec3):
            return self.rotation @ o + self.translation
        return Frame(self.rotation @ o.rotation, self.rotation @ o.translation + self.translation)

    def inverse(self) -> Frame:
        transposed = self.rotation.T
        return Frame(transposed, -(transposed @ self.translation))

    @property
    def entries(self) -> tuple[Scalar, ...]:
        """The sixteen entries of the matrix, row by row."""
        rows = zip(self.rotation, self.translation, strict=True)
        return (*(x for row, t in rows for x in (*row, t)), 0.0, 0.0, 0.0, 1.0)

    @property
    def matrices(self) -> np.ndarray:
        """The frames (..., 4, 4) in float64 of entries that are numbers, or columns (...,) of them."""
        columns = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in self.entries))
        return np.stack(columns, axis=-1).reshape(*columns[0].shape, 4, 4)

    @staticmethod
    def of_columns(matrices: Any) -> Frame:
        """Makes a frame of frames (..., 4, 4), NumPy's or traced: each entry is a column (...,)."""
        return Frame.of_entries([matrices[..., i, j] for i in range(4) for j in range(4)])

    @staticmethod
    def of(matrix: Any, snap: float = 0.0) -> Frame:
        """Makes a frame of a constant (4, 4) array: its entries as `constants` gives them."""
        return Frame.of_entries(constants(matrix, snap))

    @staticmethod
    def of_entries(m: Sequence[Scalar]) -> Frame:
        """Makes a frame of the sixteen entries of a matrix, row by row (the last four are not read)."""
        return Frame(Rot3(Vec3(*m[0:3]), Vec3(*m[4:7]), Vec3(*m[8:11])), Vec3(m[3], m[7], m[11]))


BASE = Frame(IDENTITY, ZERO)


def stack(entries: Sequence[Scalar], shape: tuple[int, ...], dtype: Any) -> jax.Array:
    """Scalars to one array of `shape`."""
    return jnp.stack([jnp.asarray(e, dtype) for e in entries]).reshape(shape) if entries else jnp.zeros(shape, dtype)


# --------------------------------------------------------------------------------------------------------------------
# Elementary functions


@jax.custom_jvp
def _sincos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    native = lambda x: (jnp.sin(x), jnp.cos(x))
    return lax.platform_dependent(x, cpu=elementary.sincos, default=native) if x.dtype.itemsize >= 4 else native(x)


@_sincos.defjvp
def _sincos_jvp(primals: Any, tangents: Any) -> Any:
    s, c = _sincos(*primals)
    return (s, c), (c * tangents[0], -s * tangents[0])


_traced_sincos = jax.jit(_sincos)  # once for all angles of a type: a robot's kernel has dozens


def sincos(x: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of an angle [rad].

    Error at most 2 units in the last place of 1 (2.4e-7 in float32, 4.4e-16 in float64) for |x| <= 1e4 rad, as a test holds;
    beyond 1e4 it grows with |x|. NaN and infinity give NaN.
    """
    if isinstance(x, float):
        return math.sin(x), math.cos(x)
    if isinstance(x, np.ndarray):
        return np.sin(x), np.cos(x)
    if isinstance(x, Ball):
        return waves(x, *sincos(x.mid))
    return _traced_sincos(x) if isinstance(x, jax.core.Tracer) else _sincos(x)


@jax.custom_jvp
def _atan2(y: jax.Array, x: jax.Array) -> jax.Array:
    return jnp.arctan2(y, x)


@_atan2.defjvp
def _atan2_jvp(primals: Any, tangents: Any) -> Any:
    (y, x), (dy, dx) = primals, tangents
    # at the origin there is no direction, and none is invented
    return _atan2(y, x), safe_divide(x * dy - y * dx, x * x + y * y)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """The angle of the point (x, y) in [-pi, pi] [rad]; 0 with derivative 0 at the origin. Finite arguments.

    Error at most 2 units in the last place of pi (4.8e-7 in float32, 8.9e-16 in float64), as a test holds.
    """
    if isinstance(y, float) and isinstance(x, float):
        return math.atan2(y, x)
    if isinstance(y, np.ndarray) or isinstance(x, np.ndarray):
        return np.arctan2(y, x)
    if isinstance(y, Ball) or isinstance(x, Ball):
        return direction(y, x, atan2)
    dtype = jnp.result_type(y, x)
    return _atan2(jnp.asarray(y, dtype), jnp.asarray(x, dtype))


def safe_sqrt(x: Scalar) -> Scalar:
    """`sqrt(max(x, 0))`, with derivative 0 where x <= 0 instead of infinity; NaN stays NaN."""
    if isinstance(x, float):
        return math.sqrt(max(x, 0.0))
    if isinstance(x, np.ndarray):
        return np.sqrt(np.maximum(x, 0.0))
    if isinstance(x, Ball):
        return x.square_root()
    zero = x <= 0.0  # the double where: https://jax.readthedocs.io/en/latest/faq.html (gradients contain NaN)
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))

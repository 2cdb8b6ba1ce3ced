"""Rotations as matrices, unit quaternions (w first), URDF's angles and rotation vectors, and the frames made with them."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import as_numbers, numbers
from jaxik.spatial.algebra import Rot3, Vec3, add, atan2, mul, safe_sqrt, sincos, sub, traced

# --------------------------------------------------------------------------------------------------------------------
# Of arrays of numbers


def pose(xyz: Any, *, wxyz: Any = None, rpy: Any = None) -> np.ndarray:
    """The frame (..., 4, 4) at `xyz` (..., 3) [m], turned by a quaternion `wxyz` (..., 4) or by `rpy` (..., 3) [rad]. Host.

    `Rz(yaw) Ry(pitch) Rx(roll)`: roll, pitch and yaw are about fixed axes, as in URDF. A quaternion is normalised; where
    neither is given nothing is turned. Leading axes broadcast. Raises `ValueError` for both, for other shapes, for what is not
    finite, and for a quaternion of 0.
    """
    if wxyz is not None and rpy is not None:
        raise ValueError("pose: wxyz and rpy say the same; give one of them")
    position, turn = numbers("pose: xyz", xyz, (..., 3), finite=True), np.eye(3)
    if wxyz is not None:
        quaternion = numbers("pose: wxyz", wxyz, (..., 4), finite=True)
        if not np.all(np.any(quaternion, axis=-1)):
            raise ValueError("pose: wxyz is 0 0 0 0, which is no rotation; write 1 0 0 0 for none")
        turn = from_wxyz(quaternion)
    if rpy is not None:
        turn = from_rpy(numbers("pose: rpy", rpy, (..., 3), finite=True))
    try:
        return frame(position, turn)
    except ValueError:
        rows = f"xyz of shape {position.shape}, {'rpy' if wxyz is None else 'wxyz'} of {turn.shape[:-2]} rows"
        raise ValueError(f"pose: {rows}; write as many of both, or one") from None


def frame(translation: Any = (0.0, 0.0, 0.0), rotation: Any = None) -> np.ndarray:
    """Frames (..., 4, 4) of places (..., 3) and rotations (..., 3, 3)."""
    places, turns = np.asarray(translation), np.eye(3) if rotation is None else np.asarray(rotation)
    found = np.zeros((*np.broadcast_shapes(places.shape[:-1], turns.shape[:-2]), 4, 4))
    found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = turns, places, 1.0
    return found


def from_wxyz(wxyz: Any) -> np.ndarray:
    """Rotations (..., 3, 3) of quaternions (..., 4) of any length; NaN of 0."""
    given = np.asarray(wxyz, np.float64)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        w, x, y, z = np.moveaxis(given / np.linalg.norm(given, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_wxyz(rotation: Any) -> np.ndarray:
    """Unit quaternions (..., 4) of rotations (..., 3, 3), w >= 0; NaN where they are none."""
    from scipy.spatial.transform import Rotation

    given = np.asarray(rotation)
    found = np.full((*given.shape[:-2], 4), np.nan)
    whole = np.isfinite(given).all(axis=(-2, -1)) & (np.linalg.det(np.nan_to_num(given)) > 0.0)
    if whole.any():
        found[whole] = Rotation.from_matrix(given[whole]).as_quat(canonical=True)[..., [3, 0, 1, 2]]
    return found


def from_rpy(rpy: Any) -> np.ndarray:
    """`Rz(yaw) Ry(pitch) Rx(roll)` (..., 3, 3) of URDF's fixed-axis angles (..., 3) [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_rpy(rotation: np.ndarray) -> tuple[float, float, float]:
    """The angles [rad] of a rotation (3, 3), of which `from_rpy` makes it again; a yaw of 0 where it is about roll's axis."""
    level = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = float(np.arctan2(-rotation[2, 0], level))
    if level < 1e-9:
        return float(np.arctan2(-rotation[1, 2], rotation[1, 1])), pitch, 0.0
    return float(np.arctan2(rotation[2, 1], rotation[2, 2])), pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation (3, 3) by an angle [rad] about a unit axis (3,)."""
    return from_wxyz([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * np.asarray(axis))])


# --------------------------------------------------------------------------------------------------------------------
# Of scalars and traced arrays


def rotation_log(rotation: Any) -> Any:
    """The rotation vector (3,) of a rotation (3, 3) [rad]. Traced. Raises `ValueError` for another shape."""
    rotation = as_numbers("rotation_log: rotation", rotation, (3, 3))
    return jnp.stack([jnp.asarray(x) for x in rotation_vector(Rot3.of(traced(rotation)))])


def rotation_exp(vector: Any) -> Any:
    """The rotation (3, 3) of a rotation vector (3,) [rad] (Rodrigues), with all derivatives at 0. Traced. Raises `ValueError`
    for another shape."""
    x, y, z = as_numbers("rotation_exp: vector", vector, (3,))
    cross = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * z
    cross += jnp.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]) * y
    cross += jnp.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]) * x
    square = x * x + y * y + z * z
    small = square < 1e-6
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    sine = jnp.where(small, 1.0 - square / 6.0 + square**2 / 120.0, jnp.sin(angle) / angle)
    versine = jnp.where(small, 0.5 - square / 24.0 + square**2 / 720.0, (1.0 - jnp.cos(angle)) / angle**2)
    return jnp.eye(3) + sine * cross + versine * cross @ cross


def rotation_vector(e: Rot3) -> Vec3:
    """`log E`: the axis times the angle in [0, pi] [rad]. At pi, where the axis has two directions, one of them."""
    v = e.skew
    cosine = 0.5 * (e[0].x + e[1].y + e[2].z - 1.0)
    sine = safe_sqrt(v.dot(v))
    angle = atan2(sine, cosine)
    eps = float(jnp.finfo(jnp.result_type(cosine)).eps)
    near_pi = (cosine < 0.0) & (sine < 30.0 * eps**0.5)
    scale = jnp.where(sine > 0.0, angle / jnp.where(sine > 0.0, sine, 1.0), 1.0)
    flipped = _axis_of_half_turn(e, v)
    return Vec3(*[jnp.where(near_pi, f * angle, x * scale) for x, f in zip(v, flipped, strict=True)])


def _axis_of_half_turn(e: Rot3, v: Vec3) -> Vec3:
    """The axis of a turn by nearly pi: the longest column of `E + E' + (1 - tr E) 1`, which is `2 (1 - cos) a a'`."""
    rest = 1.0 - (e[0].x + e[1].y + e[2].z)
    columns = [Vec3(*(add(add(e[i][j], e[j][i]), rest if i == j else 0.0) for i in range(3))) for j in range(3)]
    best = columns[0]
    largest = columns[0].x
    for j in (1, 2):
        longer = columns[j][j] > largest
        best = Vec3(*(jnp.where(longer, a, b) for a, b in zip(columns[j], best, strict=True)))
        largest = jnp.where(longer, columns[j][j], largest)
    length = safe_sqrt(best.dot(best))
    sign = jnp.where(best.dot(v) < 0.0, -1.0, 1.0) / jnp.where(length > 0.0, length, 1.0)
    return best * sign


def log_slope(vector: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """The rows of the derivative of a rotation vector (of up to pi) by the angular velocity, in the axes of what it is turned
    from: `1 - [v]x / 2 + (1 - h cot h) / (4 h^2) [v]x^2`, h half the angle [Chirikjian 2012, sec. 10.6]."""
    square = vector.dot(vector)
    small = square < 1e-4
    safe = jnp.where(small, 1.0, square)
    half = 0.5 * safe_sqrt(safe)
    sine, cosine = sincos(half)
    factor = jnp.where(small, 1.0 / 12.0 + square / 720.0, (1.0 - half * cosine / sine) / safe)
    x, y, z = vector
    once = Vec3(0.0, -z, y), Vec3(z, 0.0, -x), Vec3(-y, x, 0.0)
    twice = (vector * v + Vec3(*(-square if i == j else 0.0 for j in range(3))) for i, v in enumerate(vector))
    ones = (Vec3(*(1.0 if i == j else 0.0 for j in range(3))) for i in range(3))
    first, second, third = (one + a * -0.5 + b * factor for one, a, b in zip(ones, once, twice, strict=True))
    return first, second, third


def swing_slope(direction: Vec3, k: int) -> tuple[Vec3, Vec3, Vec3]:
    """The derivatives of `direction_swing` by the angular velocity about each of the three axes."""
    i, j = (k + 1) % 3, (k + 2) % 3
    cosine = direction[k]
    square = add(mul(direction[i], direction[i]), mul(direction[j], direction[j]))
    near = (square < 1e-4) & (cosine > 0.0)
    safe = jnp.where(square < 1e-12, 1e-12, square)
    sine, off = safe_sqrt(safe), 1.0 - cosine
    scale = jnp.where(near, 1.0 + off / 3.0 + 2.0 * off * off / 15.0, atan2(sine, cosine) / sine)
    slope = jnp.where(near, -1.0 / 3.0 - 4.0 * off / 15.0, -(1.0 - scale * cosine) / safe)  # of the scale, by the cosine
    found = []
    for axis in range(3):
        moved = Vec3(*(1.0 if n == axis else 0.0 for n in range(3))).cross(direction)
        rate = lambda n, moved=moved: add(mul(moved[n], scale), mul(mul(direction[n], slope), moved[k]))
        parts: list[Any] = [0.0, 0.0, 0.0]
        parts[i], parts[j] = sub(0.0, rate(j)), rate(i)
        found.append(Vec3(*parts))
    return found[0], found[1], found[2]


def rotation_swing(e: Rot3, k: int) -> Vec3:
    """The shortest turn that brings direction k to where E has it, as a rotation vector (component k is 0)."""
    return direction_swing(e.T[k], k)


def direction_swing(direction: Vec3, k: int) -> Vec3:
    """The shortest turn that brings axis k to a unit direction, as a rotation vector (component k is 0)."""
    i, j = (k + 1) % 3, (k + 2) % 3
    # k x direction: along i it is -direction_j, along j it is direction_i
    sine = safe_sqrt(add(mul(direction[i], direction[i]), mul(direction[j], direction[j])))
    angle = atan2(sine, direction[k])
    opposite = (sine == 0.0) & (direction[k] < 0.0)  # any axis across will do
    scale = jnp.where(sine > 0.0, angle / jnp.where(sine > 0.0, sine, 1.0), 1.0)
    parts: list[Any] = [0.0, 0.0, 0.0]
    parts[i] = jnp.where(opposite, angle, -direction[j] * scale)
    parts[j] = direction[i] * scale
    return Vec3(*parts)

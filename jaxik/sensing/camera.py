"""A depth camera: a pinhole, whose pixels hold depths along its axis."""

from __future__ import annotations

import json
import tomllib
import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import as_given, is_known, numbers, rigid_frame
from jaxik.checks.options import as_count, shown
from jaxik.pytree import Constant, static

NEAR, FAR = 0.1, 10.0  # [m] that depth cameras measure, unless told otherwise
BEYOND = 20.0  # of `far`: metres that are no metres


class Camera(Constant):
    """A camera without distortion: a point (x, y, z) in its frame, z along its axis, x to the right of the image and y down,
    is seen at the pixel `u = fx x / z + cx`, `v = fy y / z + cy`, where whole numbers are the middles of pixels. Depths from
    `near` to `far` [m] are measurements, all others are none.

    Raises `ValueError`, one line, for focal lengths that are not above zero, numbers that are not finite, an image without
    pixels, and a range that is none.
    """

    width: int = static()
    height: int = static()
    fx: Any
    fy: Any
    cx: Any
    cy: Any
    near: Any = NEAR
    far: Any = FAR

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            vars(self)[name] = as_count(f"Camera: {name}", getattr(self, name))
        for name in ("fx", "fy", "cx", "cy", "near", "far"):
            value: Any = as_given(f"Camera: {name}", getattr(self, name), ())
            if is_known(value):
                value = np.float64(value)
                if not np.isfinite(value) or (name in ("fx", "fy") and value <= 0.0):
                    raise ValueError(
                        f"Camera: {name} is {value:g}; write a finite number of pixels or metres, fx and fy above zero"
                    )
            vars(self)[name] = value
        if is_known((self.near, self.far)) and not 0.0 < self.near < self.far:
            raise ValueError(f"Camera: near is {self.near:g} m and far {self.far:g} m; write 0 < near < far")
        super().__post_init__()

    @classmethod
    def of_matrix(cls, matrix: Any, width: int, height: int, *, near: Any = NEAR, far: Any = FAR) -> Camera:
        """A camera by its intrinsic matrix (3, 3), as OpenCV and ROS have it. Host.

        Raises `ValueError` for one with skew or another last row, and as `Camera`.
        """
        m = numbers("Camera: matrix", matrix, (3, 3))
        if m[0, 1] != 0.0 or m[1, 0] != 0.0 or m[2].tolist() != [0.0, 0.0, 1.0]:
            raise ValueError(f"Camera: matrix {shown(m.tolist())}; allowed: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return cls(width, height, m[0, 0], m[1, 1], m[0, 2], m[1, 2], near, far)

    @property
    def numbers(self) -> Any:
        """The numbers fx, fy, cx, cy, near and far (6,)."""
        each = self.fx, self.fy, self.cx, self.cy, self.near, self.far
        return np.array(each) if is_known(each) else jnp.stack([jnp.asarray(x) for x in each])

    def depth(self, given: Any) -> np.ndarray:
        """A depth image (height, width) as metres, float32, NaN where it has no measurement between near and far. Host.

        Warns of an image of which more than half is beyond 20 times `far`: it is in millimetres. Raises `ValueError` for
        another shape.
        """
        image = numbers("depth", given, (self.height, self.width)).astype(np.float32)
        with np.errstate(invalid="ignore"):
            told = image[(image > 0.0) & (image < np.inf)]  # infinity is what some cameras have for none
            if 2 * np.count_nonzero(told > BEYOND * self.far) > len(told):
                warnings.warn(
                    f"depth: most of the image is beyond {BEYOND * self.far:g} m, {BEYOND:g} times the camera's far; is it"
                    " in millimetres? give depth / 1000",
                    stacklevel=2,
                )
            return np.where((image >= self.near) & (image <= self.far), image, np.float32(np.nan))

    def points(self, depth: Any, world_T_camera: Any) -> Any:
        """The points (height, width, 3) that a depth image shows [m, world], NaN where it has no measurement between near and
        far. Traced, or in NumPy where nothing is JAX's.

        `world_T_camera` (4, 4) is the pose of the camera's frame. Raises `ValueError` for an image of another shape, and for a
        pose that is no rigid frame; warns as `depth` does.
        """
        pose = rigid_frame("points: world_T_camera", world_T_camera)
        if is_known((self.numbers, depth)) and not any(hasattr(x, "at") for x in (depth, pose)):
            xp: Any = np
            image: Any = self.depth(depth)
        else:
            xp, image = jnp, jnp.asarray(as_given("points: depth", depth, (self.height, self.width)))
            image = jnp.where((image >= self.near) & (image <= self.far), image, jnp.nan)
        across = (np.arange(self.width) - self.cx) / self.fx
        down = (np.arange(self.height) - self.cy) / self.fy
        local = xp.stack([image * across[None, :], image * down[:, None], image * 1.0], axis=-1)
        return local @ pose[:3, :3].T + pose[:3, 3]


def load_camera(path: str | Path) -> Camera:
    """A camera from a `.toml` or `.json` file with `width`, `height`, and `fx`, `fy`, `cx`, `cy` or a `matrix` of three rows
    (or `K`, as ROS names it, of nine numbers); `near` and `far` [m] if it has them. Host.

    Raises `ValueError`, one line, for a file that is none, and as `Camera`.
    """
    file = Path(path)
    readers = {".toml": tomllib.loads, ".json": json.loads}
    if file.suffix not in readers:
        raise ValueError(f"load_camera: {file}: ending '{file.suffix}'; allowed: .toml, .json")
    try:
        held = readers[file.suffix](file.read_text())
        size = held["width"], held["height"]
        about = {name: held[name] for name in ("near", "far") if name in held}
        matrix = held.get("matrix", held.get("K", held.get("k")))
        if matrix is not None:
            return Camera.of_matrix(np.reshape(matrix, (3, 3)), *size, **about)
        return Camera(*size, **{name: held[name] for name in ("fx", "fy", "cx", "cy")}, **about)
    except KeyError as error:
        raise ValueError(f"load_camera: {file} has no {error}; it needs width, height, and fx, fy, cx, cy or matrix") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"load_camera: {file}: {shown(error)}") from None

"""Depth images from files: PNG by Pillow, EXR by OpenEXR, NPY by NumPy."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.files.documents import content_of
from jaxik.reasons import LoadError

MOST = 2**28  # bytes
MILLIMETRE = 0.001  # [m] that whole numbers count, as depth cameras write them
DEPTH = ("Z", "Y", "R", "V", "depth.Z", "depth.V")  # channels of an EXR, of several the first of these


def load_depth(path: str | Path, *, scale: Any = None) -> Float[np.ndarray, "h w"]:
    """The depth image (h, w) of a file [m], float32, for `Camera.points`, `Occupancy.with_depth` and `TSDF.with_depth`. Host.

    A `.png` holds whole numbers, of 16 bits mostly, an `.exr` floats in its one channel or in Z, and an `.npy` either. Whole
    numbers are millimetres and floats metres, unless `scale` says how many metres one is. Zeros, NaN and infinity stay: a
    camera's range leaves them out. EXR needs OpenEXR, `pip install "jaxik[exr]"`.

    Raises `LoadError` (a `ValueError`) with one line: the file, what is wrong, what is allowed, the mend; and `ValueError` for
    a scale that is not above zero.
    """
    path = Path(path)
    kind, content = content_of("load_depth", path, READERS, {".exr": ("OpenEXR", "exr")}, MOST)
    try:
        image = np.asarray(READERS[kind](content))
    except LookupError as error:  # which channel is meant
        raise LoadError(path, "document", str(error.args[0]), f"write one channel, or {', '.join(DEPTH)}") from None
    except Exception as error:  # whatever a parser for every variant raises is the file's fault
        mend = "write one number a pixel"
        raise LoadError(path, "document", f"cannot be read as {kind[1:].upper()} ({type(error).__name__})", mend) from None
    if image.ndim != 2 or image.dtype.kind not in "uif":
        told, mend = f"{image.dtype} of shape {image.shape}", "write one number a pixel (h, w), no colours"
        raise LoadError(path, "document", told, mend)
    usual = 1.0 if image.dtype.kind == "f" else MILLIMETRE
    metres = usual if scale is None else float(numbers("load_depth: scale", scale, (), finite=True))
    if not metres > 0.0:
        raise ValueError(f"load_depth: scale {shown(scale)}; write the metres that 1 in the file is, e.g. 0.001")
    return image.astype(np.float32) * np.float32(metres)


def _png(content: bytes) -> np.ndarray:
    from PIL import Image

    with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
        return np.asarray(image.convert("RGB") if image.mode == "P" else image)  # a palette's numbers are colours, not depths


def _exr(content: bytes) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(io.BytesIO(content), separate_channels=True) as file:
        channels = file.channels()
        name = next(iter(channels)) if len(channels) == 1 else next((n for n in DEPTH if n in channels), None)
        if name is None:
            raise LookupError(f"channels {', '.join(sorted(channels))}")
        return np.array(channels[name].pixels)


READERS: dict[str, Callable[[bytes], np.ndarray]] = {
    ".png": _png,
    ".exr": _exr,
    ".npy": lambda content: np.load(io.BytesIO(content), allow_pickle=False),
}

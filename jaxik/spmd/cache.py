"""What is made once and kept on disk: compiled kernels, fitted collision models. A folder of named objects, bounded in size."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

import jax

OURS = "jaxik_"  # how the names of objects begin, and of their files
LIMIT = 2**28  # bytes of the objects on disk, some 10,000 kernels; beyond, those longest not used go
_unseen = LIMIT  # bytes that this process has written since it last looked how large the folder is


def cache_folder() -> Path | None:
    """Where compiled kernels lie: beside JAX's compilation cache, or in the user's cache folder; None where JAXIK_CACHE is
    "off"."""
    if os.environ.get("JAXIK_CACHE", "") == "off":
        return None
    beside = jax.config.values["jax_compilation_cache_dir"]
    if beside:
        return Path(beside) / "kernels"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxik" / "kernels"


def read(name: str) -> bytes | None:
    """The object of that name; None if there is none, or one that is damaged or somebody else's."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        path = folder / name
        if hasattr(os, "getuid") and path.stat().st_uid != os.getuid():
            return None
        content = path.read_bytes()
    except OSError:
        return None
    with contextlib.suppress(OSError):  # a folder to read only
        os.utime(path)
    check, image = content[:32], content[32:]
    return image if image and hashlib.sha256(image).digest() == check else None


def write(name: str, image: bytes) -> None:
    """Beside, then renamed: another process sees all of it or nothing. A folder that cannot be written costs time only."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, aside = tempfile.mkstemp(dir=folder, prefix=OURS)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(image).digest() + image)
            os.replace(aside, folder / name)
        except OSError:
            os.unlink(aside)
        _bound(folder, len(image))


def _bound(folder: Path, more: int) -> None:
    """Looks at the folder now and then, and removes what was longest not used if it holds more than `LIMIT`. Others may do so
    too: who misses an object makes it again, who has opened one reads it to its end."""
    global _unseen
    _unseen += more
    if _unseen < LIMIT // 16:
        return
    _unseen = 0
    files = []
    for path in folder.glob(f"{OURS}*"):
        with contextlib.suppress(OSError):
            state = path.stat()
            files.append((state.st_mtime_ns, state.st_size, path))
    excess = sum(size for _, size, _ in files) - LIMIT
    if excess <= 0:
        return
    excess += LIMIT // 8  # room for a while
    for _, size, path in sorted(files):
        if excess <= 0:
            break
        with contextlib.suppress(OSError):
            path.unlink()
        excess -= size

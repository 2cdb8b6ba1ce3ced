"""A folder of named objects that are made once and kept on disk, bounded in size: compiled kernels, fitted collision models."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

import jax

from jaxik import platforms

OURS = "jaxik_"  # how the names of objects begin, and of their files
LIMIT = 2**28  # bytes of the objects on disk, some 10,000 kernels; beyond, those longest not used go
_unseen = LIMIT  # bytes that this process has written since it last looked how large the folder is


def cache_folder() -> Path | None:
    """Where compiled kernels lie: beside JAX's compilation cache, if that is a folder, or in the user's; None where there is
    neither, and where JAXIK_CACHE is "off"."""
    if os.environ.get("JAXIK_CACHE", "") == "off":
        return None
    beside = jax.config.values["jax_compilation_cache_dir"]
    if beside and "://" not in str(beside):
        return Path(beside) / "kernels"
    own = platforms.cache_home()
    return own and own / "jaxik" / "kernels"


def read(name: str) -> bytes | None:
    """The object of that name; None if there is none, or one that is damaged, or that somebody else could have written: it is
    machine code, and will run."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = platforms.read_own(folder, name)
    except OSError:
        return None
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
            platforms.replace(aside, folder / name)
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

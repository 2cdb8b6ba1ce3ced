"""A folder of named objects that are made once and kept on disk, bounded in size: compiled kernels, fitted collision models."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax

OURS = "jaxik_"  # how the names of objects begin, and of their files
LIMIT = 2**28  # bytes of the objects on disk, some 10,000 kernels; beyond, those longest not used go
_unseen = LIMIT  # bytes that this process has written since it last looked how large the folder is


def user_folder() -> Path | None:
    """The user's folder for what can be made again [XDG]; None for a user without a home."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # any other is to be ignored
        return Path(given)
    try:
        return Path.home() / ".cache"
    except RuntimeError:
        return None


def cache_folder() -> Path | None:
    """Where compiled kernels lie: beside JAX's compilation cache, if that is a folder, or in the user's; None where there is
    neither, and where JAXIK_CACHE is "off"."""
    if os.environ.get("JAXIK_CACHE", "") == "off":
        return None
    beside = jax.config.values["jax_compilation_cache_dir"]
    if beside and "://" not in str(beside):
        return Path(beside) / "kernels"
    own = user_folder()
    return own and own / "jaxik" / "kernels"


def read(name: str) -> bytes | None:
    """The object of that name; None if there is none, or one that is damaged, or that somebody else could have written: it is
    machine code, and will run."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = _read(folder, name)
    except OSError:
        return None
    check, image = content[:32], content[32:]
    return image if image and hashlib.sha256(image).digest() == check else None


def _read(folder: Path, name: str) -> bytes:
    """Reads a file and judges the very file that it read: each is opened once, by no link. Raises `OSError`."""
    inside = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    try:
        file = os.open(name, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), dir_fd=inside)
        with os.fdopen(file, "rb") as opened:
            if not (_ours_alone(inside, stat.S_ISDIR) and _ours_alone(file, stat.S_ISREG)):
                raise PermissionError(f"{folder / name}: others may write to it")
            with contextlib.suppress(OSError):  # a folder to read only
                os.utime(file)
            return opened.read()
    finally:
        os.close(inside)


def _ours_alone(opened: int, kind: Callable[[int], bool]) -> bool:
    """Whether it is of that kind, this user's, or of the machine's own, and nobody else may write to it."""
    state = os.fstat(opened)
    return kind(state.st_mode) and state.st_uid in (os.getuid(), 0) and not state.st_mode & 0o022


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

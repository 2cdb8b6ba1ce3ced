"""Calls that one system has and another has not, each with a way for Linux, macOS and Windows; no other module has any.

Paths are few, and by each system's custom, so that they need no library; that none is used where a user has no home, or the
variable is no whole path, is what `platformdirs` would not say.
"""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

WAITS = (0.01, 0.05, 0.2, 0.5)  # [s] after which Windows is asked again for a file that somebody reads just now


def is_windows() -> bool:
    """Whether this is Windows."""
    return sys.platform == "win32"


def cores() -> int:
    """The cores that this process may use; on systems that do not say, all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def after_fork(call: Callable[[], Any]) -> None:
    """Has `call` done in each process that is forked from this one; Windows forks none."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=call)


# --------------------------------------------------------------------------------------------------------------------
# Files


def cache_home() -> Path | None:
    """The user's folder for what can be made again: where XDG_CACHE_HOME says so, else by the system's custom; None for a user
    without a home."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # any other is to be ignored [XDG]
        return Path(given)
    local = os.environ.get("LOCALAPPDATA", "")
    if is_windows() and os.path.isabs(local):
        return Path(local)
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if is_windows():
        return home / "AppData" / "Local"
    return home / "Library" / "Caches" if sys.platform == "darwin" else home / ".cache"


def read_own(folder: Path, name: str) -> bytes:
    """Returns the content of a file that nobody but this user, or the machine's own, could have written, and notes that it was
    used. Raises `OSError` for any other."""
    if hasattr(os, "getuid") and os.open in os.supports_dir_fd:
        return _read_judged(folder, name)
    return _read_in_profile(folder, name)


def _read_judged(folder: Path, name: str) -> bytes:
    """Judges the very file that it reads, and its folder: each is opened once, by no link."""
    inside = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=inside)
        with os.fdopen(file, "rb") as opened:
            if not (ours_alone(inside, stat.S_ISDIR) and ours_alone(file, stat.S_ISREG)):
                raise PermissionError(f"{folder / name}: others may write to it")
            with contextlib.suppress(OSError):  # a folder to read only
                os.utime(file)
            return opened.read()
    finally:
        os.close(inside)


def ours_alone(opened: int, kind: Callable[[int], bool]) -> bool:
    """Whether it is of that kind, this user's, or of the machine's own, and nobody else may write to it."""
    state = os.fstat(opened)
    return kind(state.st_mode) and state.st_uid in (os.getuid(), 0) and not state.st_mode & 0o022


def _read_in_profile(folder: Path, name: str) -> bytes:
    """Windows has lists of who may write, of which Python says nothing: what lies in the user's own profile is this user's, and
    nothing else is read."""
    path = folder / name
    if not stat.S_ISREG(os.lstat(path).st_mode) or not _in_profile(path):
        raise PermissionError(f"{path}: not in the user's own folders; others may write to it")
    content = path.read_bytes()
    with contextlib.suppress(OSError):
        os.utime(path)
    return content


def _in_profile(path: Path) -> bool:
    try:
        return path.resolve().is_relative_to(Path.home().resolve())
    except RuntimeError:
        return False


def replace(source: Path | str, target: Path | str) -> None:
    """Puts a file in the place of another at once, as `os.replace`; Windows refuses while somebody reads that one, and is asked
    again for a second. Raises `OSError` as it does."""
    for wait in WAITS if is_windows() else ():
        try:
            return os.replace(source, target)
        except PermissionError:
            time.sleep(wait)
    os.replace(source, target)


def last_changed(state: os.stat_result) -> int:
    """Returns when a file was last written, or put in its place [ns]; Windows knows only what the file says."""
    return state.st_mtime_ns if is_windows() else state.st_ctime_ns


# --------------------------------------------------------------------------------------------------------------------
# Devices


class Keys:
    """The keys of a terminal, each at once, until `close`; or what another stream, one with a file of its own, holds by now."""

    def __init__(self, stream: Any):
        self.stream, self._before = stream, None
        if stream.isatty() and not is_windows():
            import termios
            import tty

            self._before = termios.tcgetattr(stream)
            tty.setcbreak(stream)

    def read(self) -> str:
        """Returns the keys since the last call."""
        if is_windows():
            return _console()
        told = b""
        while select.select([self.stream], [], [], 0.0)[0] and (more := os.read(self.stream.fileno(), 1)):
            told += more
        return told.decode(errors="ignore")

    def close(self) -> None:
        """Gives the terminal back as it was."""
        if self._before is not None:
            import termios

            termios.tcsetattr(self.stream, termios.TCSADRAIN, self._before)
            self._before = None


def _console() -> str:
    """Keys of Windows' console."""
    import msvcrt

    told = ""
    while msvcrt.kbhit():  # type: ignore[attr-defined]
        told += msvcrt.getwch()  # type: ignore[attr-defined]
    return told


def device(path: Path | str) -> int:
    """Opens a device of Linux to read without waiting. Raises `OSError` where there is none, as on other systems."""
    return os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))


def ready(file: int) -> bool:
    """Whether such a device has something to read."""
    return bool(select.select([file], [], [], 0.0)[0])

"""Other systems, as far as one can be played on this one: where things lie, what is trusted, and what is done again."""

import ast
import os
import sys
from pathlib import Path

import pytest

import jaxik
from jaxik import platforms
from jaxik.spmd import cache

ROOT = Path(jaxik.__file__).parent
# what one of Linux, macOS and Windows lacks
LOCAL = {
    "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "SIGALRM", "fork", "getuid", "geteuid", "mkfifo", "register_at_fork",
    "sched_getaffinity", "sched_setaffinity", "setitimer", "supports_dir_fd",
}  # fmt: skip
MODULES = {"fcntl", "grp", "msvcrt", "pwd", "resource", "termios", "tty", "winreg"}


@pytest.fixture
def system(monkeypatch, tmp_path):
    """Plays a system, whose user has a home in the test's folder."""

    def play(name):
        monkeypatch.setattr(platforms.sys, "platform", name)
        monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
        for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA", "JAXIK_CACHE"):
            monkeypatch.delenv(variable, raising=False)
        if name == "win32":
            monkeypatch.delattr(os, "getuid")
            monkeypatch.delattr(os, "register_at_fork")
            monkeypatch.delattr(os, "sched_getaffinity")
        return tmp_path / "home"

    return play


def test_no_other_module_asks_for_what_a_system_lacks():
    found = set()
    for path in ROOT.rglob("*.py"):
        if path.name == "platforms.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = {node.attr} & LOCAL if isinstance(node, ast.Attribute) else set()
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {each.name for each in node.names} & (LOCAL | MODULES)
            found |= {f"{path.relative_to(ROOT)}: {name}" for name in names}
    assert not found


FOLDERS = {"linux": ".cache", "darwin": "Library/Caches", "win32": "AppData/Local"}


@pytest.mark.parametrize("name", FOLDERS)
def test_each_system_has_its_folder_for_caches(name, system, monkeypatch, tmp_path):
    home = system(name)
    assert platforms.cache_home() == home / FOLDERS[name]
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert platforms.cache_home() == (tmp_path / "local" if name == "win32" else home / FOLDERS[name])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "asked"))
    assert platforms.cache_home() == tmp_path / "asked"


def test_windows_trusts_what_is_in_the_users_profile(system, monkeypatch, tmp_path):
    """Machine code from any other folder, and what a link leads to, is not run: others may have put it there."""
    home = system("win32")
    mine, others = home / "cache", tmp_path / "shared"
    for folder in (mine, others):
        folder.mkdir(parents=True)
        (folder / "jaxik_one").write_bytes(b"code")
    assert platforms.read_own(mine, "jaxik_one") == b"code"
    (mine / "jaxik_two").symlink_to(mine / "jaxik_one")
    (mine / "beyond").symlink_to(others)
    for folder, name in ((others, "jaxik_one"), (mine, "jaxik_two"), (mine / "beyond", "jaxik_one"), (mine, "jaxik_three")):
        with pytest.raises(OSError, match=r"others may write to it|No such file"):
            platforms.read_own(folder, name)


def test_a_kernel_is_kept_and_found_on_windows(system, monkeypatch):
    system("win32")
    before = jaxik.spmd.cache.jax.config.values["jax_compilation_cache_dir"]
    cache.jax.config.update("jax_compilation_cache_dir", None)
    try:
        cache.write("jaxik_one", b"code")
        assert cache.read("jaxik_one") == b"code" and cache.read("jaxik_two") is None
        assert platforms.cores() == (os.cpu_count() or 1)
        platforms.after_fork(lambda: None)  # which nobody will ask for
    finally:
        cache.jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.parametrize("times", [0, 2, 9])
def test_windows_is_asked_again_for_a_file_that_is_open(times, system, monkeypatch, tmp_path):
    system("win32")
    asked, waits, replace = [], [], os.replace

    def refusing(source, target):
        asked.append(target)
        if len(asked) <= times:
            raise PermissionError(13, "another process uses it")
        replace(source, target)

    monkeypatch.setattr(os, "replace", refusing)
    monkeypatch.setattr(platforms.time, "sleep", waits.append)
    (tmp_path / "new").write_text("new")
    if times > len(platforms.WAITS):
        with pytest.raises(PermissionError):
            platforms.replace(tmp_path / "new", tmp_path / "old")
    else:
        platforms.replace(tmp_path / "new", tmp_path / "old")
        assert (tmp_path / "old").read_text() == "new"
    assert waits == list(platforms.WAITS[:times])


def test_other_systems_refuse_at_once(monkeypatch, tmp_path):
    monkeypatch.setattr(platforms.time, "sleep", None)
    with pytest.raises(FileNotFoundError):
        platforms.replace(tmp_path / "none", tmp_path / "old")


def test_keys_of_windows_console(system, monkeypatch):
    """They come from its console, not from a file."""

    class Console:
        keys = list("ad ")

        def kbhit(self):
            return bool(self.keys)

        def getwch(self):
            return self.keys.pop(0)

    class Terminal:
        isatty = staticmethod(lambda: True)

    system("win32")
    monkeypatch.setitem(sys.modules, "msvcrt", Console())
    keys = platforms.Keys(Terminal())
    assert keys.read() == "ad " and keys.read() == ""
    keys.close()

"""The cache on disk is machine code and will run: whose it must be, where it may lie, and what becomes of what is no use."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxik import platforms, spmd
from jaxik.spmd import batch, cache

pytestmark = pytest.mark.kernels(reason="machine code on disk")


@pytest.fixture
def nowhere(monkeypatch):
    """No address that somebody gave."""
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("JAXIK_CACHE", raising=False)
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def homeless(nowhere, monkeypatch):
    """A user without a home, as in a container whose user is in no list."""

    def home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(Path, "home", home)


def test_a_user_without_a_home_has_no_cache(homeless):
    assert cache.cache_folder() is None
    batch.compilation_cache()
    assert jax.config.values["jax_compilation_cache_dir"] is None
    assert spmd.kernel(lambda q: jnp.sin(q).sum() * 3.0625)(np.zeros(3)) == 0.0


def test_an_address_that_is_no_folder_makes_none(nowhere, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    jax.config.update("jax_compilation_cache_dir", "gs://bucket/cache")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says that such a one is to be ignored
    assert cache.cache_folder() == tmp_path / "home" / ".cache" / "jaxik" / "kernels"
    cache.write("jaxik_one", b"code")
    assert cache.read("jaxik_one") == b"code" and [p.name for p in tmp_path.iterdir()] == ["home"]


def _world_writable(path):
    path.chmod(0o666)


def _in_anybodys_folder(path):
    path.parent.chmod(0o777)


def _link(path):
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def _pipe(path):
    path.unlink()
    os.mkfifo(path)


def _folder(path):
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("changed", [_world_writable, _in_anybodys_folder, _link, _pipe, _folder])
def test_what_others_could_have_written_is_not_run(changed, nowhere, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache.write("jaxik_one", b"code")
    assert cache.read("jaxik_one") == b"code"
    changed(cache.cache_folder() / "jaxik_one")
    assert cache.read("jaxik_one") is None


def test_what_is_judged_is_what_is_read(nowhere, monkeypatch, tmp_path):
    """Somebody else's file that takes the name's place between two look-ups is not the one that was judged."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache.write("jaxik_one", b"code")
    path, judge = cache.cache_folder() / "jaxik_one", platforms.ours_alone

    def slowly(opened, kind):
        other = path.with_name("other")
        other.write_bytes(hashlib.sha256(b"worse").digest() + b"worse")
        os.replace(other, path)
        return judge(opened, kind)

    monkeypatch.setattr(platforms, "ours_alone", slowly)
    assert cache.read("jaxik_one") == b"code"
    monkeypatch.setattr(os, "getuid", lambda: 54321)
    assert os.stat(path).st_uid == 0 or cache.read("jaxik_one") is None  # root may do anything anyhow


def test_what_does_not_link_is_made_anew(nowhere, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    read = cache.read
    monkeypatch.setattr(cache, "read", lambda name: bytes(16) + b"no object file")
    assert spmd.kernel(lambda q: jnp.cos(q).sum() * 5.0625)(np.zeros(3)) == 3 * 5.0625
    (path,) = cache.cache_folder().iterdir()
    assert len(read(path.name)) > 1000  # the new one


def test_an_older_jax_says_so_at_import():
    code = "import jax; jax.__version__ = '0.7.2'\nimport jaxik"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr.splitlines()[-1]
    assert told.startswith("ImportError: jaxik needs jax 0.8 or newer, and here is 0.7.2; pip install")

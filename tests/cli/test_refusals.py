"""Tasks that cannot be done, or written, are told in one line that names them, before the work where that can be known."""

import errno
import os
import subprocess
import sys

import pytest

import jaxik
from jaxik import cli
from jaxik.cli.results import check_writable, naming, writing
from jaxik.cli.terminal import progress_bar

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
SHUT = "/proc"  # where nobody can make a file, root neither
STUDY = 'robot = "ur5e"\n[targets]\nkind = "grid"\nx = [0, 1, 2]\ny = [0.5, 0.8, 2]\nz = [0.3, 0.5, 2]\n'


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """All that stderr holds of a call that ends with 2."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    (tmp_path / "t.csv").write_text("x,y,z\n0.4,0.2,0.3\n")
    (tmp_path / "s.toml").write_text(STUDY)
    (tmp_path / "file").write_text("")
    (tmp_path / "d.csv").mkdir()

    def call(words):
        monkeypatch.setattr(sys, "argv", ["jaxik", *words.split()])
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert left.value.code == 2
        return capsys.readouterr().err

    return call


@pytest.mark.parametrize(
    "words, told",
    [
        ("ik ur5e t.csv --position-tolerance nan", "position_tolerance nan, rotation_tolerance 1e-06; both are > 0 [m, rad]"),
        ("ik ur5e t.csv --rotation-tolerance 0", "both are > 0"),
        ("ik absent.urdf absent.csv", "jaxik: absent.csv: file: cannot be read"),  # before the robot
        ("base absent.urdf absent.csv --x 0 1 2 --y 0 1 2", "jaxik: absent.csv: file: cannot be read"),
        ("path absent.urdf absent.csv", "jaxik: absent.csv: file: cannot be read"),
        ("plan absent.urdf --start 0 --goal 1 --scene absent.toml", "jaxik: absent.toml: file: cannot be read"),
        ("ik ur5e t.csv --cloud-radius 0.02", "--cloud-radius is 0.02, and there are no points; give them by --cloud"),
        ("ik ur5e t.csv --margin inf", "margin is inf; it is a finite number"),
        ("ik ur5e t.csv --seed -1", "seed is -1; it is a whole number of at least 0"),
        ("ik ur5e t.csv --max-seeds 100000000000", "max_seeds is 100000000000; at most 1000000"),
        (f"ik ur5e t.csv --out {SHUT}/a.csv", f"--out {SHUT}/a.csv: cannot be written"),
        ("ik ur5e t.csv --out file/a.csv", "--out file/a.csv: cannot be written (Not a directory)"),
        (f"plan ur5e --start 0 0 0 0 0 0 --goal 1 0 0 0 0 0 --out {SHUT}/m.csv", f"--out {SHUT}/m.csv: cannot be written"),
        ("plan ur5e --start 0 0 0 0 0 0 --goal 1 0 0 0 0 0 --out d.csv", "--out d.csv: is a folder; name a file"),
        (
            "plan ur5e --start 0 0 --goal 1 0 0 0 0 0",
            "--start: 2 numbers; ur5e has 6: shoulder_pan_joint, ",
        ),
        ("plan ur5e --start 0 0 0 0 0 0 --goal 1 0 0 0 0 nan", "--goal 1.0 0.0 0.0 0.0 0.0 nan: finite numbers"),
        (
            "plan ur5e --start 0 0 0 0 0 0 --goal 1 0 0 0 0 0 --without leaf_1",
            "--without leaf_1: there is no scene to leave it out of; give --scene",
        ),
        (f"dynamics crops_v2 absent.csv --plot {SHUT}/a.png", f"--plot {SHUT}/a.png: cannot be written"),
        ("dynamics crops_v2 absent.csv", "jaxik: absent.csv: No such file or directory"),
        (f"harvest --out {SHUT}/a", f"--out {SHUT}/a: cannot be written"),
        ("harvest --margin nan", "harvest: margin is nan"),
        (f"fit absent.urdf --to {SHUT}/a.toml", f"--to {SHUT}/a.toml: cannot be written"),
        ("fit ur5e", "has no meshes"),
        (f"sweep s.toml --out {SHUT}/foo", f"{SHUT}/foo: nothing can be written in {SHUT} ("),
    ],
)
def test_one_line_and_no_bar(refused, words, told):
    printed = refused(words)
    assert printed.startswith("jaxik: ") and printed.count("\n") == 1 and told in printed, printed


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("old")
    told = r"m.csv: cannot be written \(No space left on device\)$"
    with pytest.raises(OSError, match=f"^--out .*{told}"), writing(path) as (aside, _):
        aside.write_text("half")
        raise FULL
    assert [p.name for p in tmp_path.iterdir()] == ["m.csv"] and path.read_text() == "old"
    with writing(path) as (aside, wrote):
        aside.write_text("new")
    assert path.read_text() == "new" and wrote.endswith("m.csv, over the old one")
    with (
        pytest.raises(OSError, match=r"^--plot u.png: cannot be written \(No space left on device\)$"),
        naming("u.png", "--plot"),
    ):
        raise FULL
    check_writable(tmp_path / "new" / "deep" / "a.CSV", endings=(".npz", ".csv"))
    with pytest.raises(ValueError, match=r"^--out .*a.txt: ending .\.txt.; allowed: \.npz, \.csv$"):
        check_writable(tmp_path / "a.txt", endings=(".npz", ".csv"))
    assert [p.name for p in tmp_path.iterdir()] == ["m.csv"]


def test_a_full_disk_is_named_by_the_harvest(refused, monkeypatch):
    def full(*_):
        raise FULL

    monkeypatch.setattr("jaxik.cli.harvest.write_harvest", full)
    printed = refused("harvest --angles 6 --slides 3 --out deep/out")
    assert printed.splitlines()[-1] == "jaxik: --out deep/out: cannot be written (No space left on device)"


def test_a_bar_of_work_that_was_done_stays(capsys):
    for done in (0, 1):
        with pytest.raises(ValueError, match="no"), progress_bar() as bar:
            bar.update(bar.add_task("work", total=2), completed=done)
            raise ValueError("no")
        assert ("work" in capsys.readouterr().err) == bool(done)


def test_the_package_is_the_command():
    done = subprocess.run([sys.executable, "-m", "jaxik", "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.strip() == f"jaxik {jaxik.__version__}"

"""Where a package that only an extra installs is not there, one line names the extra."""

import sys
from pathlib import Path

import numpy as np
import pytest

import jaxik
from jaxik.cli import main
from jaxik.estimation.plant import mujoco_model
from jaxik.harvesting.tour import shortest_tour
from jaxik.sweeps import Study, SweepResult
from jaxik.view import Page

STUDY = {"robot": "p6r", "slides": 2, "targets": {"kind": "grid", "x": [0.5, 0.5, 1], "y": [0.5, 0.5, 1], "z": [0.5, 0.5, 1]}}


def mjcf(folder):
    (folder / "arm.xml").write_text("<mujoco/>")
    jaxik.load(folder / "arm.xml")


def plant(folder):
    mujoco_model(jaxik.load("crops_v2"))


def parquet(folder):
    sys.argv = ["jaxik", "ik", "p6r", "nowhere.csv", "--out", str(folder / "a.parquet")]
    main()


def order(folder):
    groups = [np.array([1 + i]) for i in range(11)]
    shortest_tour(np.zeros((12, 12)), groups)


WITHOUT = [  # what is hidden, the extra that brings it, who asks for it
    ("mujoco", "mjcf", mjcf),
    ("mujoco", "mjcf", plant),
    ("zarr", "sweep", lambda folder: jaxik.sweep(STUDY, folder / "s.zarr")),
    ("xarray", "sweep", lambda folder: SweepResult(folder, Study.of(STUDY), 1, 1, {}).dataset()),
    ("distributed", "cluster", lambda folder: jaxik.sweep(STUDY, folder / "s.zarr", cluster="tcp://127.0.0.1:9")),
    ("viser", "view", lambda folder: Page(jaxik.load("planar2"))),
    ("pyarrow", "parquet", parquet),
    ("pyvrp", "harvest", order),
]


@pytest.mark.parametrize(("name", "extra", "ask"), WITHOUT)
def test_one_line_names_the_extra(name, extra, ask, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(sys, "argv", [])
    with pytest.raises((ValueError, SystemExit)) as raised:
        ask(tmp_path)
    line = capsys.readouterr().err.strip() or str(raised.value)
    assert line.endswith(f"needs {name}, which is not installed; pip install 'jaxik[{extra}]'") and "\n" not in line


def test_what_is_broken_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "zarr.py").write_text("import nothing_of_that_name")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "zarr", raising=False)
    with pytest.raises(ModuleNotFoundError, match="nothing_of_that_name"):
        jaxik.sweep(STUDY, tmp_path / "s.zarr")

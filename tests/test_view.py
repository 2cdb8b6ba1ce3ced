"""The page without a browser: what it may be opened with. `view_page.py` looks at it."""

import dataclasses

import numpy as np
import pytest

import jaxik
from jaxik.view.page import Page

STUDY = {
    "robot": "p6r",
    "slides": 11,
    "chunk": 100,
    "audited": 0,
    "base": {"z": [0.0, 0.1]},
    "targets": {"kind": "grid", "x": [0.0, 1.0, 3], "y": [0.4, 0.7, 3], "z": [0.2, 0.6, 3], "directions": [[0, 1, 0]]},
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    done = jaxik.sweep(STUDY, tmp_path_factory.mktemp("view") / "row.zarr")
    assert done.counts["solved"]
    return done.path


def test_a_store_of_another_robot_is_refused(store):
    p6r = jaxik.load("p6r")
    for chain, words in (
        (jaxik.load("planar2"), "row.zarr: holds p6r, not planar2"),
        (dataclasses.replace(p6r, joint_names=tuple("abcdefg")), "row.zarr: holds another p6r"),
        (p6r.with_tool(np.diag([1.0, -1.0, -1.0, 1.0])), "row.zarr: holds another p6r"),
    ):
        with pytest.raises(ValueError, match=words) as error:
            Page(chain, None, store)
        assert "\n" not in str(error.value)


def test_the_same_robot_is_shown_with_and_without_its_shapes(store):
    """Where the study did not read the meshes that the page shows, the chains differ and the robot does not."""
    for chain in (jaxik.load("p6r"), dataclasses.replace(jaxik.load("p6r"), boxes=())):
        page = Page(chain, None, store, port=0)
        assert page.url.startswith("http://127.0.0.1:")
        page.close()


def test_a_cell_without_a_fruit_is_shown(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(
        'name = "cell"\n[[object]]\nname = "a"\nboxes = [[0.5, 0, 0, 1, 1, 1]]\ncapsules = [[0, 0, 0, 1, 0, 0, 0.1]]\n'
    )
    page = Page(jaxik.load("planar2"), jaxik.load_scene(path), port=0)
    page.close()

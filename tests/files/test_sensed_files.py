"""Depth images and octrees from files, written by Pillow, OpenEXR, NumPy and OctoMap; and what is refused."""

import numpy as np
import OpenEXR
import pyoctomap
import pytest
from PIL import Image

from jaxik.files import load_depth, load_octomap
from jaxik.sensing import Camera

RNG = np.random.default_rng(1)
DEPTH = RNG.integers(0, 4000, (12, 16)).astype(np.uint16)  # [mm]; 0 where nothing was seen
METRES = DEPTH.astype(np.float32) * np.float32(0.001)


def exr(path, **channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


def test_a_png_is_in_millimetres_and_an_exr_in_metres(tmp_path):
    Image.fromarray(DEPTH).save(tmp_path / "a.png")
    np.testing.assert_array_equal(load_depth(tmp_path / "a.png"), METRES)
    np.testing.assert_allclose(load_depth(tmp_path / "a.png", scale=1 / 5000), DEPTH / 5000, rtol=1e-6)
    floats = np.where(DEPTH == 0, np.float32(np.inf), METRES)
    for name in ("Z", "Y", "far"):  # the only channel, whatever its name is
        np.testing.assert_array_equal(load_depth(exr(tmp_path / f"{name}.exr", **{name: floats})), floats)
    several = exr(tmp_path / "b.exr", R=METRES * 0, G=METRES * 0, B=METRES * 0, Z=METRES)
    np.testing.assert_array_equal(load_depth(several), METRES)
    half = exr(tmp_path / "half.exr", Z=METRES.astype(np.float16))
    np.testing.assert_array_equal(load_depth(half), METRES.astype(np.float16))


def test_an_npy_is_in_either(tmp_path):
    for array, true in ((DEPTH, METRES), (METRES, METRES), (DEPTH.astype(float), DEPTH.astype(np.float32))):
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(load_depth(tmp_path / "a.npy"), true)


def test_millimetres_that_pass_for_metres_are_warned_of_by_their_range(tmp_path):
    np.save(tmp_path / "a.npy", np.maximum(DEPTH, 300).astype(np.float32))
    with pytest.warns(UserWarning, match="millimetres"):
        Camera(16, 12, 10.0, 10.0, 8.0, 6.0).depth(load_depth(tmp_path / "a.npy"))


def colours(path, mode="RGB"):
    Image.fromarray(np.zeros((4, 5, 3), np.uint8)).convert(mode).save(path / "x.png")
    return path / "x.png"


def written(path, content):
    path.write_bytes(content)
    return path


BAD = {
    "another ending": (lambda p: p / "depth.tiff", "allowed: .png, .exr, .npy"),
    "no file": (lambda p: p / "none.png", "cannot be read"),
    "colours": (colours, "no colours"),
    "colours by a palette": (lambda p: colours(p, "P"), "no colours"),
    "no image": (lambda p: written(p / "x.png", b"hello"), "cannot be read as PNG"),
    "no EXR": (lambda p: written(p / "x.exr", b"hello"), "cannot be read as EXR"),
    "which channel": (lambda p: exr(p / "x.exr", u=METRES, w=METRES), "channels u, w"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_depth_image_is_refused_in_one_line(name, tmp_path):
    make, words = BAD[name]
    with pytest.raises(ValueError, match=words) as told:
        load_depth(make(tmp_path))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("scale", [0.0, -0.001, np.nan])
def test_a_scale_is_above_zero(scale, tmp_path):
    np.save(tmp_path / "a.npy", DEPTH)
    with pytest.raises(ValueError, match="scale"):
        load_depth(tmp_path / "a.npy", scale=scale)


def test_an_octree_is_a_grid_that_says_the_same_of_every_voxel(tmp_path):
    tree = pyoctomap.OcTree(0.1)
    for point in RNG.uniform(-1.0, 1.0, (300, 3)):
        tree.updateNode(point.tolist(), bool(point[0] > 0.0))
    for index in np.ndindex(4, 4, 4):  # one large leaf, once it is pruned
        tree.updateNode((np.array(index) * 0.1 + 0.85).tolist(), True)
    tree.updateInnerOccupancy()
    tree.writeBinary(str(tmp_path / "a.bt"))
    grid = load_octomap(tmp_path / "a.bt")
    assert grid.counts["occupied"] >= 64 and grid.counts["free"] > 100 and grid.spacing == pytest.approx(0.1)
    asked = grid.middles.reshape(-1, 3)
    nodes = [tree.search(point.tolist()) for point in asked]
    true = [0 if node is None else 1 + tree.isNodeOccupied(node) for node in nodes]
    np.testing.assert_array_equal(grid.state.ravel(), true)
    assert grid.in_scene().object_names == ("seen", "unseen")


def test_what_is_no_octree_is_refused_in_one_line(tmp_path):
    for path, words in (
        (written(tmp_path / "a.bt", b"hello"), "no binary OcTree"),
        (written(tmp_path / "b.bt", b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n"), "too early"),
        (tmp_path / "c.ot", "allowed: .bt"),
        (tmp_path / "d.bt", "cannot be read"),
    ):
        with pytest.raises(ValueError, match=words) as told:
            load_octomap(path)
        assert "\n" not in str(told.value)

"""Distances between voxels: against SciPy's transform, in grids of any shape, and next to what is rare."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxik.fields.voxel_distances import signed_distances

RNG = np.random.default_rng(3)
SHAPE = (19, 24, 33)


def ball():
    index = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
    return np.linalg.norm(index - [9, 12, 15], axis=-1) < 7.5


def one():
    solid = np.zeros(SHAPE, bool)
    solid[18, 0, 32] = True
    return solid


CASES = {
    "one voxel, in a corner": one(),
    "all but one": ~one(),
    "few": RNG.random(SHAPE) < 0.001,
    "half of them": RNG.random(SHAPE) < 0.5,
    "ball": ball(),
    "a half space": np.indices(SHAPE)[1] < 11,
    "a line": RNG.random((1, 1, 40)) < 0.1,
    "a plane": RNG.random((50, 2, 3)) < 0.1,
}


@pytest.mark.parametrize("name", CASES)
def test_distances_are_scipys(name):
    solid = CASES[name]
    true = distance_transform_edt(~solid) - distance_transform_edt(solid)
    np.testing.assert_allclose(signed_distances(solid), true, rtol=2e-7)

"""Slices of distance fields as pictures."""

import matplotlib.image
import numpy as np
import pytest

from jaxik.fields import DistanceField
from jaxik.view import plot_field

NODES = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, n) for n in (21, 21, 21)], indexing="ij"), axis=-1)
BALL = DistanceField(np.linalg.norm(NODES, axis=-1) - 0.3, np.eye(4), 0.05)


def test_what_is_inside_is_red_and_what_is_outside_is_blue(tmp_path):
    plot_field(BALL, tmp_path / "ball.png", axis="x", at=[0.5])
    picture = matplotlib.image.imread(tmp_path / "ball.png")[..., :3]
    red, blue = (picture[..., k] - picture[..., 2 - k] > 0.15 for k in (0, 2))
    assert red.any() and blue.any()
    rows, columns = np.nonzero(red[:, : red.shape[1] * 3 // 4])
    middle = rows.mean(), columns.mean()
    away = np.hypot(*(np.argwhere(blue[:, : red.shape[1] * 3 // 4]) - middle).T)
    assert away.min() > np.hypot(rows - middle[0], columns - middle[1]).mean()  # blue is around


@pytest.mark.parametrize(("given", "words"), [({"axis": "w"}, "allowed: x, y, z"), ({"at": [2.0]}, "z from 0 to 1 m")])
def test_bad_input_is_one_line(tmp_path, given, words):
    with pytest.raises(ValueError, match=words):
        plot_field(BALL, tmp_path / "ball.png", **given)

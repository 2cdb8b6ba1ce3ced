"""The image-to-field mapping of the 9-DOF paper."""

import numpy as np
import pytest
from papers.image_mapping import fit_mapping

PIXELS, FIELD = [202.0, 214.0, 253.0, 280.0], [280.0, 330.0, 570.0, 870.0]  # IJE 2022, table 2 [pixel], [mm]


def test_equation_3():
    mapping = fit_mapping(np.array(PIXELS), np.array(FIELD))
    assert [round(float(c), digits) for c, digits in zip(mapping.coefficients, (4, 3, 1), strict=True)] == [
        0.0667,
        -24.664,
        2546.5,
    ]
    assert round(mapping.r_squared, 4) == 0.9995
    np.testing.assert_allclose(mapping(np.array(PIXELS)), FIELD, atol=8.0)


@pytest.mark.parametrize(
    "image, field, words",
    [
        ([1.0, 2.0], [1.0, 2.0], "at least 3"),
        ([1.0, 1.0, 2.0], [1.0, 2.0, 3.0], "2 different pixels"),
        ([1.0, 2.0, np.nan], [1.0, 2.0, 3.0], "NaN"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "(3,)"),
        ([1.0, 2.0, 1e300, 4.0], [1.0, 2.0, 3.0, 4.0], "overflow"),
    ],
)
def test_bad_pairs(image, field, words):
    with pytest.raises(ValueError, match=words.replace("(", r"\(").replace(")", r"\)")):
        fit_mapping(np.array(image), np.array(field))

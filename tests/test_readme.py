"""The README's figures are those of the committed benchmark."""

import json
from pathlib import Path

from report import RESULT, markdown


def test_figures_come_from_the_benchmark():
    assert markdown(json.loads(RESULT.read_text())) in Path(__file__).parents[1].joinpath("README.md").read_text()

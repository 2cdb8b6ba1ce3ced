"""The README's figures are those of the committed benchmarks."""

import json
from pathlib import Path

from report import IK_RESULT, RESULT, ik_markdown, markdown


def test_figures_come_from_the_benchmarks():
    readme = Path(__file__).parents[1].joinpath("README.md").read_text()
    assert markdown(json.loads(RESULT.read_text())) in readme
    assert ik_markdown(json.loads(IK_RESULT.read_text())) in readme

"""The README's figures are those of the committed benchmarks."""

import pytest
from report import HERE, TABLES, tables


@pytest.mark.parametrize("table", tables(), ids=list(TABLES))
def test_figures_come_from_the_benchmark(table):
    assert table in (HERE.parent / "README.md").read_text()


def test_every_benchmark_has_its_result():
    assert {p.name for p in HERE.glob("*.json")} == set(TABLES)

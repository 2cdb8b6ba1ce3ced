"""The documentation's figures are those of the committed benchmarks, and what is public is in the reference."""

import re

import benchmarks
import papers_page
import public
import pytest
from report import HERE, TABLES

DOCS = HERE.parent / "docs"


@pytest.mark.parametrize("page", benchmarks.PAGES, ids=lambda page: page.name)
def test_figures_come_from_the_benchmarks(page):
    text = page.read_text()
    assert benchmarks.named(text) and benchmarks.filled(text) == text, "run python docs/benchmarks.py"


def test_figures_of_the_papers_come_from_the_studies():
    assert papers_page.PAGE.read_text() == papers_page.page(), "run python docs/papers_page.py"


def test_every_benchmark_has_its_result_and_its_place():
    assert {p.name for p in HERE.glob("*.json")} == set(TABLES) | {f"{name}.json" for name in papers_page.studies()}
    assert set(benchmarks.named((DOCS / "benchmarks.md").read_text())) == {*TABLES, "overview"}


def test_the_readme_is_a_page():
    text = (HERE.parent / "README.md").read_text()
    assert len(text.splitlines()) < 150
    linked = re.findall(r"\]\((?!http)([^)#]+)", text)  # those of the other pages are mkdocs' business
    assert linked and all((HERE.parent / each).exists() for each in linked)


def test_the_readme_has_two_commands_that_do_everything():
    """The script `.ci/run` reads each of them, as it stands there."""
    first, second = re.search(r"```\n(pip install .*)\n(pip install .*)\n```", (HERE.parent / "README.md").read_text()).groups()
    assert first.endswith("jaxik harvest") and second.endswith("pytest")


def test_what_is_public_is_in_the_reference():
    assert public.faults() == []


def test_files_that_the_pages_name_are_there():
    pages = [HERE.parent / "README.md", HERE.parent / "CONTRIBUTING.md", *DOCS.rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"`((?:[\w/]+/)?\w+\.py)`", page.read_text())}
    there = {
        path.relative_to(HERE.parent).as_posix()
        for folder in ("jaxik", "batch_eval", "tests", "docs")
        for path in (HERE.parent / folder).rglob("*.py")
    }
    assert len(named) > 20
    assert {name for name in named if not any(path.endswith(f"/{name}") or path == name for path in there)} == set()

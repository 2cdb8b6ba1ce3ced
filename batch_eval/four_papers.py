"""All that the four papers print, done again: `python batch_eval/four_papers.py [--quick] [STUDY ...]`.

Each study writes its JSON, and its pictures beside it; then `python docs/papers_page.py` writes the page that compares them
with what is printed. `--quick` does a small part of each, in a minute, and writes nothing: that all of them still run.
"""

from __future__ import annotations

import argparse
import importlib
import time

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

STUDIES = (
    "p6r_study",
    "astar",
    "nine_dof",
    "looking_ahead",
    "predictive_statistics",
    "peppers",
    "torque_estimation",
    "touch",
)


def main(names: list[str], quick: bool) -> None:
    """Runs these studies, with a bar for each."""
    columns = TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns) as progress:
        for name in names:
            task = progress.add_task(name, total=None)

            def tell(done: int, total: int, task: int = task) -> None:
                progress.update(task, completed=done, total=total)

            module, start = importlib.import_module(name), time.perf_counter()
            if quick:
                module.study(quick=True, tell=tell)
            else:
                module.main(tell)
            progress.console.print(f"{name}: {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a small part of each, and no files")
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=", ".join(STUDIES))
    given = parser.parse_args()
    if unknown := set(given.studies) - set(STUDIES):
        parser.error(f"no study {', '.join(sorted(unknown))}; there are {', '.join(STUDIES)}")
    main(given.studies or list(STUDIES), given.quick)

"""All that the four papers print, done again: `python batch_eval/four_papers.py [--quick] [STUDY ...]`.

Each study is a process on a core of its own, as many at a time as there are cores, and writes its JSON and its pictures; then
`python docs/papers_page.py` writes the page that compares them with what is printed. `--quick` does a small part of each, one
after the other, in a minute, and writes nothing: that all of them still run.
"""

from __future__ import annotations

import argparse
import importlib
import os
import queue
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from race import cores
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

STUDIES = (  # those that take longest first
    "peppers",
    "predictive_statistics",
    "touch",
    "torque_estimation",
    "astar",
    "p6r_study",
    "looking_ahead",
    "nine_dof",
)
DONE = re.compile(r"(\d+) of (\d+)")  # as `race.counted` prints it


def in_full(names: list[str], progress: Progress) -> None:
    """Runs the studies, each on the next core that is free. Raises `CalledProcessError` for one that fails."""
    free: queue.Queue[int] = queue.Queue()
    for core in cores():
        free.put(core)

    def run(name: str) -> None:
        core = free.get()
        task, start = progress.add_task(name, total=None), time.perf_counter()
        command = [sys.executable, str(Path(__file__).with_name(f"{name}.py"))]
        pin: Any = {"preexec_fn": lambda: os.sched_setaffinity(0, {core})} if hasattr(os, "sched_setaffinity") else {}
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **pin) as process:
            for line in process.stdout or ():
                if found := DONE.fullmatch(line.strip()):
                    progress.update(task, completed=int(found[1]), total=int(found[2]))
        free.put(core)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
        progress.console.print(f"{name}: {time.perf_counter() - start:.0f} s")

    with ThreadPoolExecutor(free.qsize()) as pool:
        list(pool.map(run, names))


def in_brief(names: list[str], progress: Progress) -> None:
    """Runs the quick form of the studies."""
    for name in names:
        task, start = progress.add_task(name, total=None), time.perf_counter()
        tell: Any = lambda done, total, task=task: progress.update(task, completed=done, total=total)
        importlib.import_module(name).study(quick=True, tell=tell)
        progress.console.print(f"{name}: {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a small part of each, and no files")
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=", ".join(STUDIES))
    given = parser.parse_args()
    if unknown := set(given.studies) - set(STUDIES):
        parser.error(f"no study {', '.join(sorted(unknown))}; there are {', '.join(STUDIES)}")
    with Progress(TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()) as bars:
        (in_brief if given.quick else in_full)(given.studies or list(STUDIES), bars)

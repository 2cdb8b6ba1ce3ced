"""The same chunks as tasks of a Dask scheduler (extra `[cluster]`). The one process that asked for them writes them.

A worker that dies loses nothing: Dask gives its tasks to another.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any

from jaxik.checks.options import optional
from jaxik.spmd.batch import compilation_cache
from jaxik.sweeps.evaluation import Columns, answer
from jaxik.sweeps.robot_variants import Variant
from jaxik.sweeps.study import Study

AHEAD = 2  # tasks a worker: one to run, one to have at hand; more would only stand in memory


def computed(study: Study, todo: list[int], address: str, stop: Callable[[], bool]) -> Iterator[tuple[int, Columns]]:
    """The chunks, in the order in which they come. Raises `ValueError` where no scheduler answers, or no worker comes."""
    dask = optional("--cluster", "distributed", "cluster")
    try:
        client = dask.Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        problem = f"no scheduler answers ({type(error).__name__})"
        raise ValueError(f"--cluster {address}: {problem}; start `dask scheduler`") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=60)
        except TimeoutError:
            raise ValueError(f"--cluster {address}: no worker in a minute; start `dask worker {address}`") from None
        waiting = iter(todo)
        tasks = dask.as_completed(with_results=True, loop=client.loop)

        def send(count: int) -> None:
            for number in itertools.islice(waiting, count):
                tasks.add(client.submit(_on_worker, number, *_piece(study, number), pure=False, retries=2))

        send(AHEAD * len(client.scheduler_info()["workers"]))
        for _, (number, columns) in tasks:
            yield number, columns
            if stop():
                return
            workers = len(client.scheduler_info()["workers"])
            send(max(1, AHEAD * workers - tasks.count()))


def _piece(study: Study, number: int) -> tuple[Study, Variant, slice]:
    """One piece of work alone, with no targets but its own."""
    variant, _, rows = study.work(number)
    targets, own = study.targets.only(rows)
    return dataclasses.replace(study, targets=targets), variant, own


def _on_worker(number: int, study: Study, variant: Variant, rows: slice) -> tuple[int, dict[str, Any]]:
    compilation_cache()
    return number, answer(study, variant, rows)

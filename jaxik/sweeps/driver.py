"""Where can this arm reach, from which base, and why not elsewhere: millions of targets into a store that is never lost.

`sweep` works through a `Study` chunk by chunk. A chunk is what is computed, written, resumed, sharded and sent to a cluster.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import operator
import os
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import optional, shown
from jaxik.collision.contact_report import warn_of_scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.problem import Poses
from jaxik.ik.solve import IKResult, solved
from jaxik.reasons import Reason
from jaxik.sweeps.auditing import audit
from jaxik.sweeps.evaluation import Columns, answer
from jaxik.sweeps.store import Store, StoreError
from jaxik.sweeps.study import Study

AHEAD = 2  # chunks at a time in this process: what one does on the host alone, the other spends in compiled blocks


@dataclasses.dataclass(frozen=True, repr=False)
class SweepResult:
    """The end of a call of `sweep`: the store at `path`, its study, and how many chunks of it are `done`, of how many. It is
    true once all are."""

    path: Path
    study: Study
    done: int
    total: int
    _counts: dict[str, int]

    @property
    def complete(self) -> bool:
        """Whether all chunks are done."""
        return self.done == self.total

    def __bool__(self) -> bool:
        return self.complete

    def __repr__(self) -> str:
        told = ", ".join(f"{count:,} {words}" for words, count in self._counts.items()) or "nothing yet"
        return f"Sweep {self.path}: {told}; {self.done} of {self.total} chunks"

    def counts(self) -> dict[str, int]:
        """How many targets of the finished chunks ended for each reason, by its words."""
        return dict(self._counts)

    @property
    def success(self) -> np.ndarray:
        """Whether each target is solved (..., N). Host."""
        return np.asarray(self.reason == Reason.SOLVED)

    @property
    def reason(self) -> np.ndarray:
        """The reasons (..., N), over the axes of the study and its targets; -1 where a chunk is not done. Host."""
        return np.asarray(Store.of(self.path, self.study).group["reason"][...])

    def dataset(self) -> Any:
        """The results as an `xarray.Dataset`, read as they are needed."""
        return optional("a sweep's dataset", "xarray", "sweep").open_zarr(self.path)

    def colliding(self, most: int) -> IKResult:
        """The answers of `solve_ik` to `most` targets that collide, of the first chunk that has any. Their `offenders` name
        what is in the way, which a store does not keep. Host driver."""
        store, study = Store.of(self.path, self.study), self.study
        for number in np.flatnonzero(store.finished()):
            variant, _, rows = study.work(int(number))
            colliding = rows.start + np.flatnonzero(store.column(int(number), "reason") == Reason.COLLISION)[:most]
            if len(colliding):
                break
        among, scene = study.targets.among, study.scene or make_scene()
        if among is not None:
            scene = study.targets.scenes[among[colliding[0]]]
            colliding = colliding[among[colliding] == among[colliding[0]]]
        base_T_frame = np.linalg.inv(variant.robot.world_T_base) if study.targets.frame == "world" else None
        targets = Poses.of(study.targets.poses_at(colliding, base_T_frame), study.ik.task)
        return solved(variant.robot, targets, scene, study.seed, study.ik)


def sweep(
    study: Study | str | Path | Mapping[str, Any],
    path: str | Path,
    *,
    shard: Any = (1, 1),
    cluster: str | None = None,
    repair: bool = False,
    progress: Callable[[int, int], Any] | None = None,
    stop: Callable[[], bool] | None = None,
) -> SweepResult:
    """Answers all targets of a study that the store at `path` does not hold yet; killed at any moment, a rerun goes on. Host
    driver.

    `study` is a TOML file, the same as nested dictionaries, or a `Study`. `shard` (i, n) or "i/n" does every n-th chunk, so
    that n processes, one for each i, fill one store. `cluster` is the address of a Dask scheduler whose workers compute. With
    `repair` damaged chunks are computed again. `progress` is called with the number of targets done and of all; `stop` is asked
    after every chunk.

    Raises `ValueError` for a study that cannot be read, a store of another study or a damaged chunk, and without the extra
    `sweep`; `OSError` where the store cannot be written. Nothing that is finished is lost by either.
    """
    read, path, stop = Study.of(study), Path(path), stop or (lambda: False)
    first, every = _shard(shard)
    store = Store.of(path, read)
    mine = range(first - 1, len(read.variants) * read.chunks, every)
    finished = store.finished()
    todo = [n for n in mine if not finished[n] or _kept(store, n, repair) is None]
    if todo and read.scene is not None:
        robot, *others = (variant.robot for variant in read.variants)
        warn_of_scene("sweep", robot, read.scene, read.margin, *others)
    report = progress or (lambda done, total: None)
    sizes = {n: (rows := read.work(n)[2]).stop - rows.start for n in mine}
    total = sum(sizes.values())
    done = total - sum(sizes[n] for n in todo)
    report(done, total)
    for number in _written(store, _computed(read, todo, cluster, stop)):
        done += sizes[number]
        report(done, total)
    return _ended(store, repair)


def _shard(shard: Any) -> tuple[int, int]:
    given = re.fullmatch(r"(\d+)/(\d+)", shard) if isinstance(shard, str) else None
    with contextlib.suppress(TypeError, ValueError):
        first, every = map(int, given.groups()) if given else map(operator.index, shard)
        if 1 <= first <= every:
            return first, every
    raise ValueError(f"shard {shown(shard)}: write i/n with 1 <= i <= n")


def _kept(store: Store, number: int, repair: bool, *names: str) -> Columns | None:
    """A finished chunk, or these columns of it. Raises `StoreError` for a damaged one, or, if that is to be made again, gives
    None."""
    try:
        return {name: store.column(number, name) for name in names} if names else store.read(number)
    except StoreError:
        if not repair:
            raise
        store.forget(number)
        return None


def _computed(study: Study, todo: list[int], cluster: str | None, stop: Callable[[], bool]) -> Iterator[tuple[int, Columns]]:
    """The chunks to do, as they come, until all are there or `stop` says so."""
    if cluster is not None and todo:
        from jaxik.sweeps.cluster import computed

        yield from computed(study, todo, cluster, stop)
        return
    with ThreadPoolExecutor(AHEAD, thread_name_prefix="jaxik-chunk") as pool:
        work = lambda number: (number, answer(study, *study.work(number)[::2]))
        waiting, running = iter(todo), deque[Future[tuple[int, Columns]]]()
        running.extend(pool.submit(work, number) for number in itertools.islice(waiting, AHEAD))
        while running:
            yield running.popleft().result()
            if not stop():
                running.extend(pool.submit(work, number) for number in itertools.islice(waiting, 1))


def _written(store: Store, chunks: Iterator[tuple[int, Columns]]) -> Iterator[int]:
    """Writes each chunk while the next is computed; the numbers of those that are on disk."""
    with ThreadPoolExecutor(1, thread_name_prefix="jaxik-store") as writer:
        last: Future[int] | None = None
        for number, columns in chunks:
            if last:
                yield last.result()
            last = writer.submit(_write, store, number, columns)
        if last:
            yield last.result()


def _write(store: Store, number: int, columns: Columns) -> int:
    try:
        store.write(number, columns)
    except OSError as error:
        what = os.strerror(error.errno) if error.errno else str(error)
        mend = "mend that and run again: it goes on"
        raise OSError(f"{store.path}: chunk {number} could not be written ({what}); {mend}") from None
    return number


def _ended(store: Store, repair: bool) -> SweepResult:
    """Counts, and, once all is done, what only the whole tells. With `repair` a chunk that cannot be counted, which is another
    shard's, is left for that to do."""
    finished = store.finished()
    tally, undecided = Counter[str](), 0
    for number in np.flatnonzero(finished):
        kept = _kept(store, int(number), repair, "reason", "proven")
        finished[number] = kept is not None
        if kept is not None:
            undecided += int(np.sum(~kept["proven"]))
            for reason, count in zip(*np.unique(kept["reason"], return_counts=True), strict=True):
                tally[Reason(int(reason)).text] += int(count)
    counts = dict(tally.most_common())
    if finished.all():
        counted = {"counts": counts, "undecided": undecided}
        asked_again = audit(store) if store.study.audited and not store.knows(counted) else {}
        store.finish({"complete": True} | counted | asked_again)
    return SweepResult(store.path, store.study, int(finished.sum()), len(finished), counts)

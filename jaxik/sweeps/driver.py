"""Where can this arm reach, from which base, and why not elsewhere: millions of targets into a store that is never lost.

`sweep` works through a `Study` chunk by chunk. A chunk is what is computed, written, resumed, sharded and sent to a cluster;
the one process that asked a cluster for them writes them.
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

from jaxik.analytic.families import redundancy
from jaxik.checks.options import optional, shown
from jaxik.collision.contact_report import warn_of_scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.problem import Poses
from jaxik.ik.result import IKResult
from jaxik.ik.solve import solved
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason
from jaxik.spmd.batch import compilation_cache
from jaxik.sweeps.columns import WHERE, Columns
from jaxik.sweeps.evaluation import answer
from jaxik.sweeps.postures import Postures
from jaxik.sweeps.robot_variants import Variant
from jaxik.sweeps.store import Store, StoreError
from jaxik.sweeps.study import Study

AHEAD = 2  # chunks at a time in this process, one on the host alone and one in compiled blocks; and tasks a worker of a cluster


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
        what is in the way, which a store does not keep; of motions only those whose goal is a pose that collides. Host driver.

        Raises `ValueError` where the targets are postures."""
        if isinstance(self.study.targets, Postures):
            raise ValueError("colliding: the targets are postures; jaxik.explain tells what one is too near to")
        store, study, colliding = Store.of(self.path, self.study), self.study, np.zeros(0, int)
        variant = study.variants[0]
        for number in np.flatnonzero(store.finished()):
            variant, _, rows = study.work(int(number))
            colliding = rows.start + np.flatnonzero(_hit(store, int(number)))[:most]
            if len(colliding):
                break
        among, scene = study.targets.among, study.scene_of(variant) or make_scene()
        if among is not None and len(colliding):
            scene = study.targets.scenes[among[colliding[0]]]
            colliding = colliding[among[colliding] == among[colliding[0]]]
        base_T_frame = np.linalg.inv(variant.robot.world_T_base) if study.targets.frame == "world" else None
        targets = Poses.of(study.targets.poses_at(colliding, base_T_frame), study.ik.task)
        return solved(variant.robot, targets, scene, study.seed, study.ik)


def _hit(store: Store, number: int) -> np.ndarray:
    """Whether each target of a finished chunk collides, and not the start of the motion to it."""
    hit = np.asarray(store.column(number, "reason") == Reason.COLLISION)
    return hit & (store.column(number, "where") == WHERE.index("goal")) if store.study.motions is not None else hit


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
    robots = list(dict.fromkeys(variant.robot for variant in read.variants))
    for scene in [read.scene, *(scene for _, scene in read.around)] if todo else []:
        if scene is not None:
            warn_of_scene("sweep", robots[0], scene, read.margin, *robots[1:])
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
        yield from _on_cluster(study, todo, cluster, stop)
        return
    with ThreadPoolExecutor(AHEAD, thread_name_prefix="jaxik-chunk") as pool:
        work = lambda number: (number, answer(study, *study.work(number)[::2]))
        waiting, running = iter(todo), deque[Future[tuple[int, Columns]]]()
        running.extend(pool.submit(work, number) for number in itertools.islice(waiting, AHEAD))
        while running:
            yield running.popleft().result()
            if not stop():
                running.extend(pool.submit(work, number) for number in itertools.islice(waiting, 1))


def _on_cluster(study: Study, todo: list[int], address: str, stop: Callable[[], bool]) -> Iterator[tuple[int, Columns]]:
    """The chunks as tasks of a Dask scheduler (extra `[cluster]`), in the order in which they come; of a worker that dies Dask
    gives its tasks to another. Raises `ValueError` where no scheduler answers, or no worker comes."""
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


# --------------------------------------------------------------------------------------------------------------------
# The audit


# times the study's own; the last is dense
EFFORTS = {"closed form": (0.25, 0.5, 1.0, 4.0), "search": (1 / 32, 1 / 8, 1.0, 8.0), "motion": (1 / 64, 1 / 8, 1.0, 4.0)}
WHAT = {"closed form": "slides", "search": "max_seeds", "motion": "rounds"}
AUDITED = 0x617564


def audit(store: Store) -> dict[str, Any]:
    """Estimates how many reachable targets a sweep missed: some of them, drawn at random, are asked again with more effort.
    Returns the attributes `audit`, by method, and `false_negative_rate`, over all, of a complete store.

    Effort is positions of what the closed form is given (a slide, an arm angle) where that answers, seeds where the search
    does, and rounds of the search for motions. A target that more effort reaches and the study did not is a false negative; the
    rate that is seen has an upper bound [Clopper and Pearson 1934]. A closed form that is given nothing knows no effort, and
    misses nothing.
    """
    study = store.study
    total = len(study.variants) * len(study.targets)
    drawn = np.random.default_rng((AUDITED, study.seed)).choice(total, min(study.audited, total), replace=False)
    variant, target = np.divmod(np.sort(drawn), len(study.targets))
    found: dict[str, list[np.ndarray]] = {}
    for v in np.unique(variant):
        each = study.variants[v]
        rows = target[variant == v]
        own = range(v * study.chunks, (v + 1) * study.chunks)
        seen = np.concatenate([store.column(int(n), "reachable") for n in own])[rows]
        method = study.method(each.robot)
        again = _again(study, each, rows, method) if _given_names(study, each.robot) else [seen] * len(EFFORTS[method])
        found.setdefault(method, []).append(np.stack([*again, seen]))
    joined = {method: np.concatenate(parts, axis=1) for method, parts in found.items()}
    missed = sum(int(np.sum(t[:-1].any(axis=0) & ~t[-1])) for t in joined.values())
    truth = sum(int(np.sum(t.any(axis=0))) for t in joined.values())
    known = {method: _summary(study, method, table) for method, table in joined.items()}
    return {"audit": known, "false_negative_rate": missed / max(truth, 1), "false_negative_bound_95": rate_bound(missed, truth)}


def rate_bound(missed: int, truth: int) -> float:
    """The rate that so few misses of so many exclude with 95 % confidence."""
    from scipy.stats import beta

    return 1.0 if missed >= truth else float(beta.ppf(0.95, missed + 1, truth - missed))


def _given_names(study: Study, robot: Robot) -> tuple[str, ...]:
    """The names of what there may be more of: a search's seeds, the values that a closed form is given."""
    once = {"search": ("seed",), "motion": ("round",)}
    return once.get(study.method(robot)) or redundancy(robot).names


def _again(study: Study, variant: Variant, rows: np.ndarray, method: str) -> list[np.ndarray]:
    """Whether some targets are reached, with each of the efforts."""
    changed, reached = dataclasses.replace(study, targets=study.targets.at(rows), refine=0), []
    for effort in _efforts(study, method):
        if method == "closed form":
            changed = dataclasses.replace(changed, slides=effort)
        elif study.motions is not None:
            plan = dataclasses.replace(study.motions.plan, rounds=effort)
            changed = dataclasses.replace(changed, motions=dataclasses.replace(study.motions, plan=plan))
        else:
            changed = dataclasses.replace(changed, ik=dataclasses.replace(study.ik, max_seeds=effort))
        reached.append(answer(changed, variant, slice(0, len(rows)))["reachable"])
    return reached


def _efforts(study: Study, method: str) -> list[int]:
    rounds = 0 if study.motions is None else study.motions.plan.rounds
    own = {"closed form": study.slides, "search": study.ik.max_seeds, "motion": rounds}[method]
    return [max(1, round(effort * own)) for effort in EFFORTS[method]]


def _summary(study: Study, method: str, table: np.ndarray) -> dict[str, Any]:
    """The `rates` of false negatives of each effort alone, and of the study as it was run."""
    truth = table.any(axis=0)
    count = max(int(truth.sum()), 1)
    rates = [float(np.sum(truth & ~row)) / count for row in table]
    known: dict[str, Any] = {"effort": WHAT[method], "efforts": [], "rates": [], "false_negative_rate": rates[-1]}
    robots = [each.robot for each in study.variants if study.method(each.robot) == method]
    if of := sorted({name for robot in robots for name in _given_names(study, robot)}):
        known |= {"efforts": _efforts(study, method), "rates": rates[:-1], "of": of}
    return known | {"sample": table.shape[1], "reachable_in_sample": int(truth.sum())}

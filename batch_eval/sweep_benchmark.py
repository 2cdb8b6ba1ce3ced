"""Measures what a sweep costs, and that nothing is lost: `python batch_eval/sweep_benchmark.py [PART ...]`, on Linux.

Parts: eaik, between, crop, search, scaling, scene, processes, kills, same, motions. Each part's rows are kept in
`sweep_benchmark.json`; the others stay as they were. `scene` and `scaling` draw `sweep_scaling.png`. Needs
`pip install -e ".[test,peers]"`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers import panda
from peers.arm import eaik_robot
from race import machine
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.reach import prove_reach
from jaxik.reach.leading_joints import freest, leading_grid
from jaxik.reach.proof import beyond

HERE = Path(__file__).parent
OUT = Path(__file__).with_suffix(".json")
BOX = {"kind": "grid", "x": [-0.3, 1.3, 40], "y": [0.1, 0.9, 25], "z": [-0.2, 1.0, 40]}
FREE = {"robot": "p6r", "chunk": 50_000, "audited": 0, "targets": BOX | {"directions": 25}}
DIRECTIONS = [[0, 1, 0], [0.5, 1, 0], [-0.5, 1, 0], [0, 1, 0.5], [0, 1, -0.5]]


def timed(study: dict[str, Any], warm: bool = True) -> tuple[float, Any]:
    """Seconds of a sweep into a new store, compiled before, and its attributes."""
    with tempfile.TemporaryDirectory() as folder:
        read = jaxik.sweeps.Study.of(study)
        if warm:
            few = study | {"targets": study["targets"] | {"x": [*study["targets"]["x"][:2], 3]}}
            jaxik.sweep(few, Path(folder) / "warm.zarr")
        ticks: list[float] = []
        done = jaxik.sweep(read, Path(folder) / "s.zarr", progress=lambda *_: ticks.append(time.perf_counter()))
        return ticks[-1] - ticks[0], dict(done.dataset().attrs) | {"targets": len(read.targets)}


def eaik() -> dict[str, Any]:
    """p6r, a million targets with limits, beside EAIK over the same slides: its solutions alone, and with the limits looked at,
    which is what a map needs."""
    study = jaxik.sweeps.Study.of(FREE)
    robot, count = study.variants[0].robot, len(study.targets)
    peer, tip = eaik_robot(robot)
    some = np.random.default_rng(0).choice(count, 2000, replace=False)
    poses = np.linalg.inv(robot.world_T_base) @ study.targets.poses_at(some)
    lower, upper = robot.lower[1:], robot.upper[1:]
    rows: dict[str, Any] = {"targets": count, "slides": study.slides}
    alone, full, reached = [], [], np.zeros(len(some), bool)
    for refine in (0, 5):
        seconds, known = timed(FREE | {"refine": refine})
        rows[f"jaxik_refine_{refine}"] = {"seconds": seconds, "per_second": count / seconds, **_known(known)}
        spent = [0.0, 0.0]
        for slide in np.linspace(0.0, 1.0, study.slides):
            moved = poses.copy()
            moved[:, 2, 3] -= slide
            moved[:, :3, :3] = moved[:, :3, :3] @ tip.T
            batch = list(moved)
            start = time.perf_counter()
            found = peer.IK_batched(batch, 2)
            spent[0] += time.perf_counter() - start
            joints, exact = [each.Q for each in found], [each.is_LS for each in found]  # what its interface gives, one by one
            owner = np.repeat(np.arange(len(found)), [len(x) for x in joints])
            q = np.concatenate([np.asarray(x).reshape(-1, 6) for x in joints])
            good = ~np.concatenate([np.asarray(x, bool).ravel() for x in exact])
            turned = q - np.round((q - (lower + upper) / 2.0) / (2.0 * np.pi)) * 2.0 * np.pi
            reached[owner[good & np.all((turned >= lower) & (turned <= upper), axis=1)]] = True
            spent[1] += time.perf_counter() - start
        alone.append(spent[0] / len(some))
        full.append(spent[1] / len(some))
    rows["eaik_us"], rows["eaik_with_limits_us"] = 1e6 * float(np.median(alone)), 1e6 * float(np.median(full))
    rows["eaik_reachable"] = float(reached.mean())
    for refine in (0, 5):
        each = rows[f"jaxik_refine_{refine}"]
        us = 1e6 / each["per_second"]
        each |= {"us": us, "times_eaik": rows["eaik_us"] / us, "times_eaik_with_limits": rows["eaik_with_limits_us"] / us}
    return rows


def between() -> dict[str, Any]:
    """Answers of arms over a rail, a first or last joint, an arm angle, or two of them between the positions of a grid: random
    poses all around, in any direction, and a grid 100 times denser, which must find nothing that was called out of reach."""
    tiago = panda.ROBOTS / "tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"
    robots = {name: jaxik.load(name) for name in ("p6r", "panda", "iiwa14", "gen3", "ur10e_rail", "panda_lift")}
    robots["tiago"] = jaxik.load(panda.bare_urdf(*tiago), tip=tiago[1])
    return {"cpu": machine()["cpu"], "arms": {name: _between(robot) for name, robot in robots.items()}}


def _between(robot: jaxik.Robot, count: int = 4000, refine: int = 5) -> dict[str, Any]:
    rng, given = np.random.default_rng(0), jaxik.analytic.redundancy(robot)
    poses, slides = _around(robot, rng, count), 11 if len(given.names) == 1 else 6
    away = beyond(robot, poses)
    on_grid = lambda positions: freest(robot, poses, leading_grid(robot, positions)).freedom >= 0.0
    found = on_grid(slides) & ~away
    asked = np.flatnonzero(~found & ~away)
    prove_reach(robot, poses[asked], slides=slides, refine=refine)  # compiled
    begun = time.perf_counter()
    more = prove_reach(robot, poses[asked], slides=slides, refine=refine)
    seconds = time.perf_counter() - begun
    hits, open_ = more.branch >= 0, np.zeros(count, bool)
    open_[asked] = more.reason == jaxik.Reason.NOT_CONVERGED
    reached = found.copy()
    reached[asked[hits]] = True
    finer = 100 if len(given.names) == 1 else 10  # of two, 10 times as many of each
    dense = on_grid(finer * (slides - 1) + 1)
    once_more = prove_reach(robot, poses[open_], slides=slides, refine=refine + 3).counts()
    return {
        "given": list(given.names),
        "targets": count,
        "positions": slides ** len(given.names),
        "refine": refine,
        "on_the_grid": int(found.sum()),
        "between": int(hits.sum()),
        "out_of_reach": int((~reached & ~open_).sum()),
        "undecided": int(open_.sum()),
        "undecided_once_more": once_more.get("not converged", 0),
        "seconds": seconds,
        "dense": int((dense & ~found).sum()),
        "dense_called_out_of_reach": int((dense & ~reached & ~open_).sum()),
        "dense_undecided": int((dense & open_).sum()),
    }


def _around(robot: jaxik.Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses `base_T_tip` (count, 4, 4) in the box of where the tip can be, turned anyhow."""
    q = rng.uniform(*robot.finite_limits, (400, robot.num_joints))
    tips = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))(q))[:, :3, 3]
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = rng.uniform(tips.min(axis=0), tips.max(axis=0), (count, 3))
    poses[:, :3, :3] = Rotation.random(count, rng).as_matrix()
    return poses


def crop() -> dict[str, Any]:
    """p6r in the shipped crop, with its spheres."""
    study = {"robot": "p6r", "chunk": 10_000, "collision": {"scene": "cucumber_row", "margin": 0.005}, "audited": 2000}
    seconds, known = timed(study | {"targets": BOX | {"directions": DIRECTIONS}})
    rate = known["targets"] / seconds
    return {"seconds": seconds, "per_second": rate, "per_minute": 60.0 * rate, **_known(known)}


def _known(attributes: dict[str, Any]) -> dict[str, Any]:
    names = ("targets", "counts", "undecided", "audit", "false_negative_rate", "false_negative_bound_95")
    return {k: attributes[k] for k in names if k in attributes}


def search() -> dict[str, Any]:
    """Robots without a closed form: crops_v2 (nine joints), and the Panda of example-robot-data."""
    file, tip = panda.ROBOTS / "panda_description/urdf/panda.urdf", "panda_link8"
    cases = {
        "crops_v2": {"robot": "crops_v2", "targets": {"kind": "grid", "x": [-1, 1, 16], "y": [-1, 1, 16], "z": [0, 1.6, 10]}},
        "panda.urdf": {
            "robot": jaxik.load(panda.bare_urdf(file, tip), tip=tip),
            "targets": {"kind": "grid", "x": [-0.9, 0.9, 16], "y": [-0.9, 0.9, 16], "z": [-0.3, 1.2, 10]},
        },
    }
    rows = {}
    for name, study in cases.items():
        study["targets"] |= {"directions": 6}
        seconds, known = timed(study | {"chunk": 5000, "audited": 2000})
        rows[name] = {"seconds": seconds, "per_second": known["targets"] / seconds, **_known(known)}
    return rows


def scaling() -> dict[str, Any]:
    """Cost against the number of targets, 1e4 to 1e7, in one fresh process, with the most memory that it held; and how far each
    lies from the straight line `first + each * targets` that has the least relative deviations. In wall and CPU seconds."""
    command = [sys.executable, __file__, "--scaling-child"]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1])
    count = np.array(found["targets"], float)
    for what in ("wall", "cpu"):
        seconds = np.array(found[what]["seconds"])
        terms = np.column_stack([np.ones(len(count)), count])
        (first, each), *_ = np.linalg.lstsq(terms / seconds[:, None], np.ones(len(count)), rcond=None)
        found[what] |= {"first_seconds": float(first), "us_per_target": 1e6 * float(each)}
        found[what]["deviation"] = list(seconds / (terms @ [first, each]) - 1.0)
    return found


def scaling_child() -> None:
    """Wall and CPU seconds, the medians of several rounds over all numbers of targets, for others use the machine too; each
    number is one of whole chunks."""
    across = (16, 48, 160, 480, 1600, 4800, 16_000)  # positions, times 25 * 25: 1e4 to 1e7
    runs: dict[int, list[list[float]]] = {n: [] for n in across}
    for turn in range(5):
        for n in across[: None if turn < 3 else -2]:
            begun = time.perf_counter()
            while time.perf_counter() < begun + 3.0:
                runs[n].append(_timed_run(n))
    runs[across[0]].pop(0)  # it compiled
    # not getrusage's, which a child takes over from the parent that it was forked from
    most = int(re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]) / 2**20
    wall, cpu = zip(*(np.median(each, axis=0).tolist() for each in runs.values()), strict=True)
    found = {"wall": {"seconds": wall}, "cpu": {"seconds": cpu}, "runs": [len(each) for each in runs.values()]}
    print(json.dumps({"targets": [625 * n for n in across], **found, "resident_gib": most}))


def _timed_run(across: int) -> list[float]:
    """Wall and CPU seconds of one sweep."""
    grid = {"x": [-0.3, 1.3, across], "y": [0.1, 0.9, 5], "z": [-0.2, 1.0, 5], "directions": 25}
    study = jaxik.sweeps.Study.of(FREE | {"refine": 0, "chunk": 10_000, "targets": BOX | grid})
    ticks: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        jaxik.sweep(study, f"{folder}/s.zarr", progress=lambda *_: ticks.append((time.perf_counter(), time.process_time())))
    return [ticks[-1][i] - ticks[0][i] for i in (0, 1)]


def scene() -> dict[str, Any]:
    """Cost against obstacles and against spheres."""
    small = {"kind": "grid", "x": [0.0, 1.0, 10], "y": [0.3, 0.8, 6], "z": [0.1, 0.8, 8], "directions": DIRECTIONS}
    study = {"chunk": 2400, "audited": 0, "refine": 0, "targets": small}
    rng = np.random.default_rng(0)
    rows: dict[str, Any] = {"obstacles": [], "spheres": []}
    for count in (10, 30, 100, 300, 1000):
        points = rng.uniform([0.0, 0.55, 0.0], [1.0, 0.95, 1.2], (count, 3))
        among = {"scene": jaxik.make_scene(points=points, point_radius=0.01), "margin": 0.005}
        seconds, known = timed(study | {"robot": "p6r", "collision": among})
        rows["obstacles"].append([count, known["targets"] / seconds])
    for each in (1, 8, 64, 512):
        robot = jaxik.load("p6r").with_spheres(each)
        if each > 8:  # pairs of spheres grow with the square
            study["targets"] = small | {"x": [0.0, 1.0, 3], "y": [0.3, 0.8, 3], "z": [0.1, 0.8, 3]}
        seconds, known = timed(study | {"robot": robot, "collision": {"scene": "cucumber_row", "margin": 0.005}})
        rows["spheres"].append([each * len(robot.boxes), known["targets"] / seconds])
    return rows


def processes() -> dict[str, Any]:
    """One process on one core, and two on a core each, as shards of one store; the same study, in turn."""
    study = json.dumps(FREE | {"chunk": 25_000, "targets": BOX | {"directions": 10}})
    code = (
        "import sys, json, os, time, jaxik; from jaxik.spmd.batch import compilation_cache; compilation_cache()\n"
        "os.sched_setaffinity(0, {int(sys.argv[4])})\n"
        "ticks = []\n"
        "jaxik.sweep(json.loads(sys.argv[1]), sys.argv[2], shard=sys.argv[3], progress=lambda *_: ticks.append(time.time()))\n"
        "print(ticks[0], ticks[1], ticks[-1], len(ticks) - 2)\n"
    )
    rows: dict[str, Any] = {}
    for name, shards in (("one", ("1/1",)), ("two", ("1/2", "2/2"))):
        with tempfile.TemporaryDirectory() as folder:
            started = [
                subprocess.Popen(
                    [sys.executable, "-c", code, study, f"{folder}/s.zarr", shard, str(core)], stdout=subprocess.PIPE, text=True
                )
                for core, shard in enumerate(shards)
            ]
            ends = [[float(x) for x in p.communicate()[0].split()] for p in started]
            # from its first chunk on, each at its own rate: what was compiled before does not count
            rows[name] = sum(25_000 * n / (last - second) for _, second, last, n in ends)
    return {"targets_per_second": rows, "ratio": rows["two"] / rows["one"]}


def kills() -> dict[str, Any]:
    """A sweep killed (-9) 20 times at random moments, each time begun again, beside one that was left alone."""
    study = {"robot": "p6r", "slides": 11, "chunk": 50, "collision": {"scene": "cucumber_row", "margin": 0.005}, "audited": 500}
    study["targets"] = BOX | {"x": [-0.3, 1.3, 20], "y": [0.1, 0.9, 10], "z": [-0.2, 1.0, 20], "directions": DIRECTIONS}
    code = (
        "import sys, json, jaxik; from jaxik.spmd.batch import compilation_cache; compilation_cache()\n"
        "jaxik.sweep(json.loads(sys.argv[1]), sys.argv[2])\n"
    )
    command = lambda path: [sys.executable, "-c", code, json.dumps(study), path]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(command(f"{folder}/whole.zarr"), check=True)
        killed, draw, path = 0, random.Random(0), f"{folder}/killed.zarr"
        while killed < 20:
            process = subprocess.Popen(command(path))
            begun = time.monotonic()
            before = len(list(Path(path).glob("crc/c/*")))
            while len(list(Path(path).glob("crc/c/*"))) == before and process.poll() is None and time.monotonic() - begun < 120:
                time.sleep(0.01)
            time.sleep(draw.uniform(0.0, 0.1))
            if process.poll() is not None:
                break
            process.send_signal(signal.SIGKILL)
            process.wait()
            killed += 1
        finished = len(list(Path(path).glob("crc/c/*")))
        subprocess.run(command(path), check=True)
        same_bits = _bits(Path(path)) == _bits(Path(f"{folder}/whole.zarr"))
    return {"killed": killed, "chunks_finished_by_then": finished, "bit_identical": same_bits}


def _bits(folder: Path) -> dict[str, str]:
    files = (p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def same() -> dict[str, Any]:
    """Chunks of 1,000 and of 50,000, and one process and two: the same numbers."""
    study = FREE | {
        "collision": {"scene": "cucumber_row", "margin": 0.005},
        "targets": BOX | {"x": [-0.3, 1.3, 11], "directions": DIRECTIONS},
    }
    with tempfile.TemporaryDirectory() as folder:
        made = {}
        for name, chunk, shards in (("small", 1000, ("1/1",)), ("large", 50_000, ("1/1",)), ("two", 1000, ("1/2", "2/2"))):
            code = "import sys, json, jaxik; jaxik.sweep(json.loads(sys.argv[1]), sys.argv[2], shard=sys.argv[3])"
            path = f"{folder}/{name}.zarr"
            words = [json.dumps(study | {"chunk": chunk}), path]
            running = [subprocess.Popen([sys.executable, "-c", code, *words, shard]) for shard in shards]
            assert all(p.wait() == 0 for p in running)
            made[name] = path
        import xarray

        small, large, two = (xarray.open_zarr(made[name]).load().drop_vars("crc") for name in ("small", "large", "two"))
        count = len(small.target)
        return {
            "targets": count,
            "chunk_sizes": bool(small.equals(large)),
            "one_and_two_processes": _bits(Path(made["small"])) == _bits(Path(made["two"])) and bool(small.equals(two)),
        }


def cell(seed: int = 0, count: int = 12) -> jaxik.Scene:
    """A table, a shelf of two boards behind it, and boxes and posts that stand on the table anyhow."""
    rng, z = np.random.default_rng(seed), 0.2
    boxes = [[0.55, 0.0, z - 0.05, 0.5, 1.2, 0.1], *([0.85, 0.0, h, 0.2, 1.2, 0.02] for h in (0.5, 0.75))]
    for x, y, height in rng.uniform([0.4, -0.5, 0.1], [0.7, 0.5, 0.3], (count, 3)):
        boxes.append([x, y, z + height / 2.0, 0.06, 0.06, height])
    return jaxik.make_scene(boxes=boxes, name="cell")


def motions(count: int = 10_000, rounds: int = 3) -> dict[str, Any]:
    """Motions of a Panda in a generated cell: between random free postures, and to poses on a grid; with their waypoints, and
    with samples too. Beside it `plan_motion` alone, of the same starts and goals in one call. Wall and CPU time."""
    home = [0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8]
    grid = {"x": [0.3, 0.7, 10], "y": [-0.6, 0.6, 25], "z": [0.3, 0.9, 8]}
    grid["directions"] = [[0, 0, -1], [1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 0, -1]]
    top = {"robot": "panda", "collision": {"scene": cell()}}
    studies = {
        "between postures": {"motions": {}, "targets": {"kind": "random", "count": count}},
        "the same, 64 samples": {"motions": {"samples": 64}, "targets": {"kind": "random", "count": count}},
        "to poses": {"motions": {"start": home}, "targets": {"kind": "grid"} | grid},
    }
    known = {key: machine()[key] for key in ("cpu", "cores", "python", "jaxik", "jax")}
    return {"machine": known, "studies": {name: _motions(top | study, rounds) for name, study in studies.items()}}


def _clocked(clocks: list[tuple[float, float]], call: Any) -> Any:
    """The value of a call, whose wall and CPU time [s] is noted."""
    wall, cpu = time.perf_counter(), time.process_time()
    value = call()
    clocks.append((time.perf_counter() - wall, time.process_time() - cpu))
    return value


def _motions(study: dict[str, Any], rounds: int) -> dict[str, Any]:
    read = jaxik.sweeps.Study.of(study)
    robot, options, own = read.variants[0].robot, read.motions.plan, read.targets.kind == "random"
    clocks: dict[str, list[tuple[float, float]]] = {"swept": [], "alone": []}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(rounds):
            done = _clocked(clocks["swept"], lambda: jaxik.sweep(read, Path(folder) / f"{turn}.zarr"))  # noqa: B023
            data = done.dataset().load()
            starts = data.start_q.values if own else np.array(read.variants[0].start)
            goals = data.goal_q.values if own else read.targets.poses_at(np.arange(len(read.targets)))
            plan = lambda: jaxik.plan_motion(robot, starts, goals, scene=read.scene, options=options)  # noqa: B023
            alone = _clocked(clocks["alone"], plan)
        stored = sum(f.stat().st_size for f in Path(folder, "0.zarr").rglob("*") if f.is_file())
    wall, cpu = ({name: min(x[i] for x in each) for name, each in clocks.items()} for i in range(2))
    solved = alone.success
    return {
        "motions": len(read.targets),
        "counts": done.counts(),
        "searched": int(np.sum(alone.rounds > 0)),
        "as_alone": bool(np.array_equal(data.reason, alone.reason))
        and all(np.array_equal(data.q.values[i], alone.waypoints[i][-1]) for i in np.flatnonzero(solved)),
        "an_hour": 3600.0 * len(read.targets) / wall["swept"],
        "ms_each": 1e3 * wall["swept"] / len(read.targets),
        "alone_ms_each": 1e3 * wall["alone"] / len(read.targets),
        "cpu_ms_each": 1e3 * cpu["swept"] / len(read.targets),
        "alone_cpu_ms_each": 1e3 * cpu["alone"] / len(read.targets),
        "bytes_each": stored / len(read.targets),
        "most_waypoints": int(data.waypoint_count.max()),
        "mean_duration": float(np.nanmean(data.duration)),
    }


PARTS = {f.__name__: f for f in (eaik, between, crop, search, scaling, scene, processes, kills, same, motions)}


def draw(result: dict[str, Any]) -> None:
    """The three costs as curves."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    if "scaling" in result:
        found = result["scaling"]
        for what, mark in (("wall", "o"), ("cpu", "s")):
            row = found[what]
            axes[0].loglog(found["targets"], row["seconds"], mark, label=f"measured, {what}")
            line = row["first_seconds"] + 1e-6 * row["us_per_target"] * np.array(found["targets"])
            axes[0].loglog(found["targets"], line, "k:", label="straight lines" if what == "wall" else None)
        axes[0].set(xlabel="targets", ylabel="seconds", title=f"p6r, limits: {found['resident_gib']:.2f} GiB at most")
        axes[0].legend()
    for axis, what in zip(axes[1:], ("obstacles", "spheres"), strict=True):
        if "scene" in result:
            axis.loglog(*np.array(result["scene"][what]).T, "o-")
        axis.set(xlabel=what, ylabel="targets/s", title=f"p6r, collision: {what}")
    figure.savefig(HERE / "sweep_scaling.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="all unless given")
    parser.add_argument("--scaling-child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.scaling_child:
        return scaling_child()
    result = json.loads(OUT.read_text()) if OUT.exists() else {}
    result["machine"] = machine()
    for name in arguments.parts or PARTS:
        start = time.perf_counter()
        result[name] = PARTS[name]()
        print(name, f"{time.perf_counter() - start:.0f} s", json.dumps(result[name]), flush=True)
        OUT.write_text(json.dumps(result, indent=1) + "\n")
    draw(result)
    return None


if __name__ == "__main__":
    main()

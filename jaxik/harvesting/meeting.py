"""Two arms at the same time: where on their ways they would meet, and who waits for whom, so that they do not.

Each arm has a clock of its own, which stands still while it waits; it waits where it is at rest anyway, between its stages. All
pairs of moments of the two clocks are a rectangle, the coordination diagram [O'Donnell, Lozano-Perez 1989]: its cells are free
or not, and a schedule is a way through free ones from corner to corner, along the diagonal while both move. The soonest is
found by dynamic programming.

Cells are proven, not sampled. On a part of its way no point of an arm is further than `sum_j w_j |q_j - c_j|` from where it is
at a configuration c in the middle, w_j the most that a joint's unit moves it; and between samples, `STEP` apart, no joint is
further from its chord than `a STEP^2 / 8` with the limit a of its acceleration. A rectangle of moments is free if the arms, at
both middles, are apart by the margin and all that both may be off these; one that is not is cut into four, down to a few steps
by a few. Two carriages on one rail are such bodies: one passes the other through no free cell.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.harvesting.arms import Arm
from jaxik.harvesting.picks import as_operands
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.kinematics.shapes import Box, Surface, Volume
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.trajectory import Trajectory

STEP = 0.005  # [s] of an arm's own clock between samples
COARSE, FINE = 64, 4  # samples that the largest part of a way has, and the smallest
ROUNDING = 1e-4  # [m] that the arms keep beyond the margin, for what float32 makes of distances
SAME = 1e-6  # [m] that two bodies may differ by, which are taken for one
ROOM = 1.01  # times its limit that an acceleration may be, as float32 has it
NEVER = 1 << 40  # steps that no way takes
Held = tuple[Volume | Box | Surface, ...]  # a body in a hand, in the frame of the joint that moves it


class Timeline(NamedTuple):
    """An arm's way by its own clock: its joints `q` (m + 1, k) at samples; where it is at `rest`, before and after each stage
    (s + 1,), by the samples' numbers; on each stage the number of the body in its hand, 0 of none (s,), and the motion."""

    q: np.ndarray
    rest: np.ndarray
    held: np.ndarray
    motions: tuple[Trajectory, ...]

    def key(self, stage: int) -> tuple[int, int]:
        """Returns by what a stage is known: its motion, and the body; or that the arm stands at home."""
        return (id(self.motions[stage]), int(self.held[stage])) if self.motions else (0, 0)

    def cells(self, stage: int) -> slice:
        """The steps of a stage; an arm that never moves has one."""
        return slice(int(self.rest[stage]), int(self.rest[stage + 1])) if self.motions else slice(0, 1)

    @staticmethod
    def of(motions: Sequence[Trajectory], held: Sequence[int], at: np.ndarray) -> Timeline:
        """The timeline of motions, one after another, which begin at a configuration."""
        steps = [int(np.ceil(float(moved.duration) / STEP - 1e-9)) for moved in motions]
        parts = [moved.at_times(STEP * np.arange(1, count + 1)).q for moved, count in zip(motions, steps, strict=True)]
        return Timeline(np.concatenate([at[None], *parts]), np.cumsum([0, *steps]), np.array(held, int), tuple(motions))


class Parts(NamedTuple):
    """The parts of a timeline, and their halves, and so on: each from sample `first` to sample `last`, with the middle `q`, and
    how far it `moves` any point from there [m]; what it holds; and its halves, -1 of a single step."""

    first: np.ndarray
    last: np.ndarray
    q: np.ndarray
    moves: np.ndarray
    held: np.ndarray
    stage: np.ndarray
    halves: np.ndarray
    whole: np.ndarray

    @staticmethod
    def of(timeline: Timeline, weights: np.ndarray, bent: float) -> Parts:
        """The parts of a timeline of an arm; `whole` are the largest. An arm that never moves has one of no length."""
        rows: list[tuple[int, int, int]] = []  # first, last, stage
        halves: list[tuple[int, int]] = []

        def add(first: int, last: int, stage: int) -> int:
            number = len(rows)
            rows.append((first, last, stage))
            halves.append((-1, -1))
            if last - first > FINE:
                middle = (first + last) // 2
                halves[number] = add(first, middle, stage), add(middle, last, stage)
            return number

        large = []
        for stage, (begin, end) in enumerate(zip(timeline.rest, timeline.rest[1:], strict=False)):
            large += [add(first, min(first + COARSE, int(end)), stage) for first in range(int(begin), int(end), COARSE)]
        if not large:
            large = [add(0, 0, 0)]
        middles, moves = [], []
        for first, last, _ in rows:
            near = timeline.q[first : last + 1]
            middle = 0.5 * (near.min(axis=0) + near.max(axis=0))
            middles.append(middle)
            moves.append(float(np.max(np.abs(near - middle) @ weights)) + bent)
        first, last, stages = np.array(rows).T
        held = np.array([*timeline.held, 0])[stages]
        return Parts(first, last, np.array(middles), np.array(moves), held, stages, np.array(halves), np.array(large))


class Meeting:
    """Two arms of one robot, with the limits of their joints' acceleration, that keep a margin [m] apart; and the bodies that
    they hold, by numbers."""

    def __init__(self, robot: Robot, arms: Sequence[Arm], acceleration: Sequence[np.ndarray], margin: float):
        self.robot, self.arms, self.acceleration, self.margin = robot, arms, acceleration, margin
        self.bodies: list[list[Held]] = [[()] for _ in arms]
        self.checkers: dict[tuple[int, int], CollisionChecker] = {}
        # the cells of two stages are the same in every diagram; motions are known by their place in memory, which they keep
        self.blocks: dict[tuple[tuple[int, int], tuple[int, int]], np.ndarray] = {}
        self.kept: dict[int, Trajectory] = {}

    def number(self, i: int, held: Robot | None) -> int:
        """The number of the body that an arm holds, by the arm with the body; equal bodies have the same."""
        if held is None:
            return 0
        alone, known = self.arms[i].robot, self.bodies[i]
        kinds = ((held.volumes, alone.volumes), (held.boxes, alone.boxes), (held.surfaces, alone.surfaces))
        body: Held = tuple(part for every, own in kinds for part in every[len(own) :])
        for number, other in enumerate(known):
            if _alike(body, other):
                return number
        known.append(body)
        if len(known) == 2:
            self.checkers.clear()  # now an empty hand is one that holds nothing
            self.blocks.clear()
        return len(known) - 1

    def checker(self, held: tuple[int, int]) -> CollisionChecker:
        """The checker that tells whether the arms hit each other while they hold bodies of these numbers."""
        if held not in self.checkers:
            robot = self.robot
            for arm, bodies, number in zip(self.arms, self.bodies, held, strict=True):
                robot = _holding(robot, arm, bodies[number] or _nothing(robot, arm, bodies[-1 if len(bodies) == 1 else 1]))
            owners = [owner(robot, self.arms, link) for link in range(len(robot.link_names))]
            solid = [link for link in solid_links(robot) if link >= len(self.robot.link_names)]
            known = {*self.robot.self_pairs, *((i, k) for k in solid for i in solid_links(robot) if i < k)}
            across = tuple(sorted((a, b) for a, b in known if {owners[a], owners[b]} == {0, 1}))
            tables = tuple(table for table in robot.pair_tables if table.links in across)
            robot = dataclasses.replace(robot, self_pairs=across, pair_tables=tables)
            self.checkers[held] = CollisionChecker(robot, None, self.margin)
        return self.checkers[held]

    def moves(self, i: int) -> tuple[np.ndarray, float]:
        """How far a unit of each joint moves a point of an arm at most, whatever it holds (k,) [m/rad, 1]; and how far it is
        off the chord of two samples at most [m]."""
        numbers = range(len(self.bodies[i]))
        each = [self.checker((number, 0) if i == 0 else (0, number)).weights for number in numbers]
        weights = np.max(each, axis=0)[list(self.arms[i].joints)]
        return weights, float(weights @ self.acceleration[i]) * ROOM * STEP**2 / 8.0

    def free(self, timelines: Sequence[Timeline]) -> np.ndarray:
        """The free cells of the diagram (m, k) of two timelines, a step of the one by a step of the other."""
        a, b = (Parts.of(line, *self.moves(i)) for i, line in enumerate(timelines))
        first, second = timelines
        shape = [max(1, int(line.rest[-1])) for line in timelines]
        found, new = np.zeros(shape, bool), np.zeros((max(1, len(first.held)), max(1, len(second.held))), bool)
        for i, k in np.ndindex(*new.shape):
            block = self.blocks.get((first.key(i), second.key(k)))
            new[i, k] = block is None
            if block is not None:
                found[first.cells(i), second.cells(k)] = block
        x, y = (grid.ravel() for grid in np.meshgrid(a.whole, b.whole, indexing="ij"))
        asked = new[a.stage[x], b.stage[y]]
        self._fill(found, a, b, x[asked], y[asked])
        for i, k in np.argwhere(new):
            self.blocks[first.key(i), second.key(k)] = found[first.cells(i), second.cells(k)].copy()
        self.kept |= {id(motion): motion for line in timelines for motion in line.motions}
        return found

    def _fill(self, found: np.ndarray, a: Parts, b: Parts, x: np.ndarray, y: np.ndarray) -> None:
        """Marks the free cells of such parts of both timelines."""
        while len(x):
            hit = self._hits(a, b, x, y)
            for i, k in zip(x[~hit], y[~hit], strict=True):
                found[a.first[i] : max(a.last[i], 1), b.first[k] : max(b.last[k], 1)] = True
            cut = hit & ~((a.halves[x, 0] < 0) & (b.halves[y, 0] < 0))
            x, y = x[cut], y[cut]
            pieces = [np.stack([i, k]) for i in _halved(a, x) for k in _halved(b, y)]
            x, y = np.unique(np.concatenate(pieces, axis=1), axis=1) if len(x) else (x, y)
            left = (x >= 0) & (y >= 0)
            x, y = x[left], y[left]

    def _hits(self, a: Parts, b: Parts, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether the arms may hit each other in the parts of such numbers of both timelines."""
        hit = np.ones(len(x), bool)
        for held in sorted({*zip(a.held[x].tolist(), b.held[y].tolist(), strict=True)}):
            rows = np.flatnonzero((a.held[x] == held[0]) & (b.held[y] == held[1]))
            q = np.zeros((len(rows), self.robot.num_joints))
            q[:, self.arms[0].joints], q[:, self.arms[1].joints] = a.q[x[rows]], b.q[y[rows]]
            far = a.moves[x[rows]] + b.moves[y[rows]] + ROUNDING
            hit[rows] = self.checker(held).hits(q, far)
        return hit


def owner(robot: Robot, arms: Sequence[Arm], link: int) -> int:
    """The number of the arm whose joints move a link; -1 of what neither moves."""
    joints = {robot.tree.joints[row] for row in robot.tree.way(robot.link_joint[link])}
    return next((i for i, arm in enumerate(arms) if joints & set(arm.joints)), -1)


def _alike(body: Held, other: Held) -> bool:
    """Whether two bodies are the same, but for rounding."""
    leaves = lambda parts: [np.asarray(x) for part in parts for x in jax.tree_util.tree_leaves(part)]
    a, b = leaves(body), leaves(other)
    return [x.shape for x in a] == [x.shape for x in b] and all(
        np.allclose(x, y, rtol=0.0, atol=SAME) for x, y in zip(a, b, strict=True)
    )


def _holding(robot: Robot, arm: Arm, body: Held) -> Robot:
    """The robot with a body in the hand of an arm, a link of its own; its numbers are JAX arrays, so that one kernel serves
    all."""
    row, link = robot.with_tips(arm.name).tips[0], len(robot.link_names)
    own: Any = lambda kind: tuple(dataclasses.replace(part, link=link) for part in body if isinstance(part, kind))
    count = len(robot.volumes)
    held = dataclasses.replace(
        robot,
        link_names=(*robot.link_names, f"held by {arm.name}"),
        link_joint=(*robot.link_joint, row),
        link_offset=np.concatenate([robot.link_offset, np.eye(4)[None]]),
        volumes=(*robot.volumes, *own(Volume)),
        boxes=(*robot.boxes, *own(Box)),
        surfaces=(*robot.surfaces, *own(Surface)),
    )
    return as_operands(held, count)


def _nothing(robot: Robot, arm: Arm, body: Held) -> Held:
    """The body in an empty hand: a point of the hand itself, of as many volumes as a body of these has; so one kernel serves
    both. It is nothing at all where that cannot be."""
    row = robot.with_tips(arm.name).tips[0]
    points = [np.asarray(b.joint_T_box)[:3, 3] for b in robot.boxes if robot.link_joint[b.link] == row]
    points += [np.asarray(v.corners)[0] for v in robot.volumes if robot.link_joint[v.link] == row]
    volumes = [part for part in body if isinstance(part, Volume)]
    if not points or len(volumes) < len(body):
        return ()
    none = lambda v: Volume(np.zeros(np.shape(v.corners)) + points[0], np.zeros(np.shape(v.radius)), v.link)
    return tuple(map(none, volumes))


def _halved(parts: Parts, which: np.ndarray) -> Iterator[np.ndarray]:
    """Both halves of parts, in turn; a single step is its own first half, and has no other."""
    halves = parts.halves[which]
    yield np.where(halves[:, 0] < 0, which, halves[:, 0])
    yield halves[:, 1]


def soonest(free: np.ndarray, rest: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    """The soonest way through the free cells (m, k) of a diagram, from both beginnings to both ends, as the steps (t + 1,) that
    each arm's own clock shows after 0, 1, .. steps of time; None where there is none. A clock stands only where its arm is at
    `rest`.
    """
    (m, k), (stops, others) = free.shape, rest
    # alone a clock goes on past a moment of the other, which belongs to the cells on both sides
    wide = np.pad(free, 1)
    along_a = wide[1:-1, :-1] | wide[1:-1, 1:]  # (m, k + 1): the first clock's step i, the other at j
    along_b = wide[:-1, 1:-1] | wide[1:, 1:-1]  # (m + 1, k)
    waits = np.zeros(k + 1, bool)
    waits[others] = True
    stands = np.zeros(m + 1, bool)
    stands[stops] = True
    cost = np.full((m + 1, k + 1), NEVER, np.int64)
    cost[0, 0] = 0
    for i in range(m + 1):
        if i:
            cost[i, 1:] = np.where(free[i - 1], cost[i - 1, :-1] + 1, NEVER)
            cost[i] = np.minimum(cost[i], np.where(waits & along_a[i - 1], cost[i - 1] + 1, NEVER))
        if stands[i]:
            cost[i] = _swept(cost[i], along_b[i])
    cost = np.minimum(cost, NEVER)
    if cost[m, k] >= NEVER:
        return None
    way = [(m, k)]
    while way[-1] != (0, 0):
        i, j = way[-1]
        if i and j and free[i - 1, j - 1] and cost[i - 1, j - 1] + 1 == cost[i, j]:
            way.append((i - 1, j - 1))
        elif i and waits[j] and along_a[i - 1, j] and cost[i - 1, j] + 1 == cost[i, j]:
            way.append((i - 1, j))
        else:
            way.append((i, j - 1))
    first, second = np.array(way[::-1]).T
    return first, second


def _swept(cost: np.ndarray, open_: np.ndarray) -> np.ndarray:
    """The costs (k + 1,) at the moments of one clock that may go on alone through what is open (k,)."""
    number = np.arange(len(cost))
    stretch = np.concatenate([[0], np.cumsum(~open_)])  # a way ends where the next cell is not free
    level = NEVER * 4 * stretch
    return np.minimum.accumulate(cost - number - level) + number + level


def starts(clock: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """When each stage begins (s,) [s], of an arm that is at rest at such steps, by the steps its own clock shows over time."""
    return STEP * (np.searchsorted(clock, rest[:-1], side="right") - 1)

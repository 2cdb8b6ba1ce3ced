"""A robot's links in random configurations: their surfaces, which are the truth, the convex parts that hold these, and which
pairs of links are checked against each other.

A pair is not checked that does not move, or whose surfaces touch in at least half of the configurations: they are meant to; nor
one whose parts do not overlap, neither there nor in a search from the nearest configurations. Where parts overlap and surfaces
do not, parts are cut: so there are many where other links pass, and few elsewhere. A pair whose parts even then overlap in at
least half of the configurations, and its surfaces in none, is not checked either: one link moves in a hollow of the other.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Collection, Sequence
from typing import Literal, NamedTuple

import numpy as np

from jaxik.collision.self_collision_pairs import default_pose
from jaxik.collision.surface_trees import surface_of
from jaxik.fitting.bodies import Body, apart_at_least, depths, gaps, hull_of, separated, touching
from jaxik.fitting.capsules import FitOptions
from jaxik.fitting.link_distance_tables import Places, between, frames
from jaxik.fitting.parts import best_cut, divided, divisions
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Surface, Unchecked, UncheckedReason, fan
from jaxik.spmd.batch import threads

SAMPLES = 2000  # random configurations
NEAR = 0.01  # [m] of gaps between links that matter to their fit
MOSTLY = 0.5  # of them in which the surfaces of a pair touch that is not checked: they are meant to
DEEP = 0.0005  # [m] that the parts of a pair may overlap where it never touches
OFTEN = 0.05  # of them from which a pair is checked in any case
NEAREST, CHILDREN, ROUNDS = 12, 6, 8  # of the search for a collision
FAR = 1e3  # [m] by which what is close goes before what is not
PARTS, FEW = 6, 2  # that a mesh is cut into by volume alone, and of these, that capsules are fitted to
BESIDE = 8  # configurations of neighbours, of which one tells enough of their joint
WORST = 4  # parts of two links that are tried for a cut
WORTH_CUTTING = 0.1  # of the false overlaps of a part, that a cut does away with
SHOWN = 100  # configurations that say how deep a pair is that is not checked
RARE = 0.003  # of the configurations, in which the parts of a pair may overlap falsely

Pair = tuple[int, int]
Bodies = list[tuple[int, Body]]  # each with its link
Hits = dict[Pair, np.ndarray]  # in which of the configurations a pair of links touches


class Shape(NamedTuple):
    """A shape of a link whose parts are fitted: the link, what the file calls it, its corners (p, 3) in the joint's frame [m],
    and its triangles (f, 3), where they are not those of the hull; `fine` (t, 3, 3) are triangles that are nearer to what is
    round than those."""

    link: int
    name: str
    corners: np.ndarray
    faces: np.ndarray | None = None
    fine: np.ndarray | None = None

    def moved(self, a_T_b: np.ndarray) -> Shape:
        """The same in frame a, of one in frame b."""
        placed = lambda x: x @ a_T_b[:3, :3].T + a_T_b[:3, 3]
        return self._replace(corners=placed(self.corners), fine=None if self.fine is None else placed(self.fine))

    @property
    def triangles(self) -> np.ndarray:
        """The triangles (f, 3) of its surface; none of what is flat and has no faces."""
        if self.faces is not None and len(self.faces):
            return self.faces
        hull = hull_of(self.corners)
        if hull is None:
            return np.zeros((0, 3), int)
        a, b, c = self.corners[hull.simplices].transpose(1, 0, 2)
        inward = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0.0
        return np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)


@dataclasses.dataclass(frozen=True)
class Asked:
    """A user's pairs of links: those that are not checked, and those that are in any case, or all."""

    apart: frozenset[frozenset[str]] = frozenset()
    checked: frozenset[frozenset[str]] = frozenset()
    all: bool = False


NOTHING_ASKED = Asked()


class Pass(NamedTuple):
    """Two bodies that come close: their numbers, the configurations, and the gaps [m]."""

    first: int
    second: int
    rows: np.ndarray
    gap: np.ndarray


class Links:
    """The links' surfaces and their convex parts in random configurations, the default pose before them."""

    def __init__(self, robot: Robot, shapes: Sequence[Shape], fit: FitOptions, asked: Asked, aside: Collection[str]):
        self.robot, self.shapes, self.fit, self.asked, self.aside = robot, shapes, fit, asked, aside
        self.names = robot.link_names
        # hulls let go of Python's lock
        found = [*threads().map(lambda s: divisions(s.corners, s.triangles, min(fit.parts, PARTS)), shapes)]
        self.few = [[pieces for pieces in each if len(pieces) <= max(FEW, len(each[0]))][-1] for each in found]  # of each shape
        self.pieces = [(i, piece) for i, each in enumerate(found) for piece in each[-1]]
        self.limits = robot.finite_limits
        rng = np.random.default_rng(0)
        self.q = np.vstack([default_pose(robot), rng.uniform(*self.limits, (SAMPLES, robot.num_joints))])
        self.frames = frames(robot, self.q)

    @functools.cached_property
    def bodies(self) -> Bodies:
        """The links' convex parts, and what is exact, each with its link."""
        return [(self.shapes[owner].link, Body(piece.hull)) for owner, piece in self.pieces] + self.exact

    @property
    def exact(self) -> Bodies:
        """The shapes that need no fit."""
        return [(v.link, Body(np.asarray(v.corners, np.float64), float(v.radius))) for v in self.robot.volumes]

    def of(self, link: int) -> list[int]:
        """The numbers of a link's bodies."""
        return [i for i, (owner, _) in enumerate(self.bodies) if owner == link]

    def couples(self, pair: Pair, bodies: Bodies | None = None) -> list[tuple[Body, Body]]:
        """The bodies of a pair of links, each with each; or the `bodies` that stand for all links' parts."""
        own = lambda each: [body for link, body in bodies or self.bodies if link == each]
        return [*itertools.product(own(pair[0]), own(pair[1]))]

    def passes(self, pair: Pair) -> list[Pass]:
        """Where bodies of a pair of links come nearer than `NEAR` [m]."""
        turn, place = between(self.robot, pair, self.frames)
        found = []
        for i, j in itertools.product(*map(self.of, pair)):
            a, b = self.bodies[i][1], self.bodies[j][1]
            rows = np.flatnonzero(apart_at_least(a, b, turn, place) < NEAR)
            gap = separated(a, b, turn[rows], place[rows], NEAR)[0]
            close = gap < NEAR
            found.append(Pass(i, j, rows[close], gap[close]))
        return found

    def least(self, passes: Sequence[Pass]) -> np.ndarray:
        """The gap of a pair of links in each configuration [m], infinite where it is not close."""
        least = np.full(len(self.q), np.inf)
        for each in passes:
            least[each.rows] = np.minimum(least[each.rows], each.gap)
        return least

    def depth(self, pair: Pair, q: np.ndarray) -> np.ndarray:
        """How far a pair of links overlaps at configurations `q` (n,) [m]."""
        return depths(self.couples(pair), *between(self.robot, pair, frames(self.robot, q)))

    # ----------------------------------------------------------------------------------------------------------------
    # Which pairs

    def chosen(self) -> tuple[list[Pair], tuple[Unchecked, ...], Hits, dict[Pair, list[Pass]]]:
        """The pairs of links to check, and those that are not; in which configurations surfaces touch, and where parts come
        close."""
        kept: list[Pair] = []
        left: list[Unchecked] = []
        touch: Hits = {}
        passes: dict[Pair, list[Pass]] = {}
        for pair in itertools.combinations(sorted({link for link, _ in self.bodies}), 2):
            reason, share, depth = self.named(pair), 0.0, 0.0
            if not reason:
                passes[pair] = self.passes(pair)
                gap, every = self.least(passes[pair]), BESIDE if self.neighbours(pair) else 1
                touch[pair] = self.surfaces_touch(pair, gap, every)
                share = float(touch[pair][every::every].mean())
                reason = self.reason(pair, share, gap)
                if not reason and every > 1:
                    touch[pair] = self.surfaces_touch(pair, gap)
            if not reason:
                kept.append(pair)
                continue
            if share:
                depth = float(self.depth(pair, self.q[np.flatnonzero(touch[pair])[:SHOWN]]).max())
            left.append(Unchecked((self.names[pair[0]], self.names[pair[1]]), reason, share, depth))
        return kept, tuple(left), touch, passes

    def apart(self, pair: Pair) -> int:
        """How many joints are between two links."""
        return self.robot.tree.distance(*(self.robot.link_joint[link] for link in pair))

    def neighbours(self, pair: Pair) -> bool:
        """Whether one joint is between two links, and neither is behind a joint beside the chain."""
        return self.apart(pair) == 1 and not {self.names[link] for link in pair} & set(self.aside)

    def named(self, pair: Pair) -> UncheckedReason | Literal[""]:
        """Why a pair is not checked, of which no configuration tells anything."""
        if self.apart(pair) == 0:
            return "fixed"
        return "named" if frozenset(self.names[link] for link in pair) in self.asked.apart else ""

    def reason(self, pair: Pair, share: float, gap: np.ndarray) -> UncheckedReason | Literal[""]:
        """Why a pair is not checked that touches in a share of configurations, its parts `gap` apart; "" where it is."""
        names = frozenset(self.names[link] for link in pair)
        if self.asked.all or names in self.asked.checked:
            return ""
        if share >= MOSTLY:
            return "touches"
        if self.neighbours(pair):
            return "neighbours" if share else "never"
        return "" if share or self.collides(pair, gap) else "never"

    def nested(self, pairs: Sequence[Pair], touch: Hits) -> dict[Pair, Unchecked]:
        """The pairs whose surfaces never touch while their parts mostly overlap, however these are cut: checked, they would let
        no configuration be free."""
        found = {}
        for pair in pairs:
            names = self.names[pair[0]], self.names[pair[1]]
            if touch[pair].any() or self.asked.all or frozenset(names) in self.asked.checked:
                continue
            if (falsely := self.falsely(pair, touch[pair])).mean() >= MOSTLY:
                depth = float(self.depth(pair, self.q[np.flatnonzero(falsely)[:SHOWN]]).max())
                found[pair] = Unchecked(names, "nested", 0.0, depth)
        return found

    def signed(self, pair: Pair, q: np.ndarray, enough: float) -> np.ndarray:
        """The gap of a pair of links at configurations `q` (n,) [m], at least `enough` where it is no less; where they overlap,
        by how much, less than 0."""
        turn, place = between(self.robot, pair, frames(self.robot, q))
        least = gaps(self.couples(pair), turn, place, max(enough, 1e-9))
        touching = least <= 0.0
        least[touching] = -depths(self.couples(pair), turn[touching], place[touching])
        return least

    def collides(self, pair: Pair, gap: np.ndarray) -> bool:
        """Whether a pair of links ever overlaps by more than `DEEP`: as it is in the samples, or after a search from the
        nearest of them that only turns the joints between the two."""
        touching = np.flatnonzero(gap <= 0.0)
        if len(touching) > OFTEN * len(gap) or (len(touching) and self.depth(pair, self.q[touching]).max() > DEEP):
            return True
        ways = self.robot.tree.apart(*(self.robot.link_joint[link] for link in pair))
        joints = np.array(sorted({self.robot.tree.joints[row] for way in ways for row in way}), int)
        turn, place = between(self.robot, pair, self.frames)
        bound = np.min([apart_at_least(a, b, turn, place) for a, b in self.couples(pair)], axis=0)
        best = self.q[np.argsort(np.where(np.isfinite(gap), gap - FAR, bound), kind="stable")[:NEAREST]]
        value, (low, high), rng = self.signed(pair, best, np.inf), self.limits, np.random.default_rng(1)
        for turned in range(ROUNDS):
            born = np.repeat(best, CHILDREN, axis=0)
            born[:, joints] += 0.25 * 0.6**turned * (high - low)[joints] * rng.normal(size=(len(born), len(joints)))
            born = np.clip(born, low, high)
            every = np.concatenate([value, self.signed(pair, born, float(value.max()))])
            order = np.argsort(every, kind="stable")[:NEAREST]
            best, value = np.vstack([best, born])[order], every[order]
            if value[0] < -DEEP:
                return True
        return False

    def surfaces_touch(self, pair: Pair, gap: np.ndarray, every: int = 1) -> np.ndarray:
        """Whether the surfaces of two links touch, in all configurations or one in `every`: where their parts do, at most."""
        found = np.zeros(len(self.q), bool)
        rows = np.flatnonzero((gap <= 0.0) & (np.arange(len(gap)) % every == 0))
        turn, place = between(self.robot, pair, self.frames[:, rows])
        room = max(len(each.corners) for each in self.surfaces.values())
        found[rows] = touching(self.surfaces[pair[0]], self.surfaces[pair[1]], turn, place, room)
        return found

    @functools.cached_property
    def surfaces(self) -> dict[int, Surface]:
        """The surface of each link."""
        return {each.link: each for each in link_surfaces(self.robot, self.shapes)}

    # ----------------------------------------------------------------------------------------------------------------
    # Where parts are cut

    def cut_where_links_pass(self, touch: Hits) -> bool:
        """Cut the parts that overlap others where surfaces do not touch, the worst first, each where that leaves fewest of
        these configurations. Whether anything was cut."""
        said = {pair: self.falsely(pair, rows) for pair, rows in touch.items()}
        done, finished = False, set[Pair]()
        while True:
            worst = {pair: float(rows.mean()) for pair, rows in said.items() if pair not in finished}
            if not worst or max(worst.values()) <= RARE:
                return done
            pair = max(worst, key=lambda each: worst[each])
            number = self.cut(pair, said[pair])
            if number is None:
                finished.add(pair)
                continue
            done, link = True, self.bodies[number][0]
            said |= {p: rows & self.falsely(p, ~rows) for p, rows in said.items() if link in p}

    def falsely(self, pair: Pair, touch: np.ndarray, bodies: Bodies | None = None) -> np.ndarray:
        """The configurations in which the parts of a pair of links overlap, or the `bodies` that stand for all links' parts, of
        those in which they do not `touch`."""
        rows, found = np.flatnonzero(~touch), np.zeros(len(self.q), bool)
        turn, place = between(self.robot, pair, self.frames[:, rows])
        found[rows] = gaps(self.couples(pair, bodies), turn, place, 1e-9) <= 0.0
        return found

    def cut(self, pair: Pair, falsely: np.ndarray) -> int | None:
        """Cut that part of two links which most often overlaps the other link `falsely`; its number, or None where no cut
        helps or the mesh has as many parts as it may."""
        rows = np.flatnonzero(falsely)
        turn, place = between(self.robot, pair, self.frames[:, rows[:: max(len(rows) // SHOWN, 1)]])
        back = turn.transpose(0, 2, 1), -np.einsum("nji,nj->ni", turn, place)
        tried = []
        for link, other, at in ((*pair, (turn, place)), (*pair[::-1], back)):
            others = [self.bodies[i][1] for i in self.of(other)]
            for number in filter(self.room, self.of(link)):
                tried.append((int(_overlaps(self.bodies[number][1], others, at).sum()), number, others, at))
        for count, number, others, at in sorted(tried, key=lambda each: -each[0])[:WORST]:
            owner, piece = self.pieces[number]
            left = lambda cut, o=others, at=at: np.any([_overlaps(Body(side), o, at) for side in cut.sides], axis=0).sum()
            gain, cut = best_cut(piece, lambda _, n=count, left=left: lambda each: float(n - left(each)))
            if cut is not None and gain >= WORTH_CUTTING * count:
                self.pieces[number : number + 1] = [(owner, side) for side in divided(piece, cut)]
                del self.bodies
                return number
        return None

    def room(self, number: int) -> bool:
        """Whether a body is part of a mesh that may have one more."""
        owners = [owner for owner, _ in self.pieces]
        return number < len(owners) and owners.count(owners[number]) < self.fit.parts


def _overlaps(body: Body, others: Sequence[Body], at: Places) -> np.ndarray:
    """Whether a body overlaps one of some others, which stand in some places (n,)."""
    return gaps([(body, other) for other in others], *at, 1e-9) <= 0.0


def link_surfaces(robot: Robot, shapes: Sequence[Shape]) -> tuple[Surface, ...]:
    """The surface of each link that has shapes, or volumes of a robot that has no others yet."""
    found: dict[int, list[tuple[np.ndarray, float]]] = {}
    for s in shapes:
        own = s.corners[s.triangles] if len(s.triangles) else fan(s.corners)
        found.setdefault(s.link, []).append((own if s.fine is None else s.fine, 0.0))
    for v in robot.volumes:
        found.setdefault(v.link, []).append((fan(np.asarray(v.corners)), float(v.radius)))
    return tuple(surface_of(link, found[link]) for link in sorted(found))

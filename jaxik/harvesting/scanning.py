"""Every posture that picks a fruit, on a grid of approach angles, leading joints (the slide) and branches; and why if none.

Van Henten et al. (2010, sec. 4) scan in two steps: the angle of the last three links first, then the slide at that angle.
Here the superset is scanned at once (every angle with every slide position and all eight branches), because in a batch it
costs less than deciding what to leave out; the two steps are `approach_angles` and `scan(..., angles=[best])`. Where the
grid has no posture, `recover` looks between its points: first a finer grid around the nearest misses, then gradient ascent.
That recovery is what the paper left open.

The drivers of this module run on the host: they chunk, pad to one shape, and drop candidates as soon as they are out.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import shaped
from jaxik.checks.options import as_count_or_values, check_finite, check_kind, shown
from jaxik.collision.clearances import by_object, check_geometry, clearance, object_clearances, self_clearance
from jaxik.collision.hierarchy import grouped
from jaxik.collision.scene import Fruit, Scene, remembered
from jaxik.costs import joint_freedom
from jaxik.reach.leading import grid, leading_grid
from jaxik.reasons import Reason
from jaxik.robot.chain import Chain
from jaxik.robot.kinematics import jacobian
from jaxik.robot.spherical_wrist import BRANCHES, closed_branches, closed_form_obstacle, closed_forms, valid_branches
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

LIMIT_LENGTH = 0.1  # [m/rad] at which a joint past its limit weighs against clearance while a miss is mended


@dataclasses.dataclass(frozen=True)
class Weights:
    """What makes a posture good: `clearance * min(D, reach)/reach + freedom * F`, both shares in [0, 1].

    D is the clearance [m], F the freedom of the least free joint (`costs.joint_freedom`); `reach` is the distance beyond which
    more clearance is worth nothing, 75 mm as in (6) of Van Henten et al. 2010.
    """

    clearance: float = 1.0
    freedom: float = 0.5
    reach: float = 0.075

    def __post_init__(self) -> None:
        check_finite("weights", **dataclasses.asdict(self))
        if not (self.clearance >= 0.0 and self.freedom >= 0.0 and self.reach > 0.0):
            raise ValueError(f"weights {self}: clearance and freedom are >= 0 and reach > 0, all finite numbers")

    def score(self, clearance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
        return self.clearance * np.clip(clearance, 0.0, self.reach) / self.reach + self.freedom * np.clip(freedom, 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Grasp:
    """How the tip meets a fruit: its direction `up` (tip frame) lies along the fruit's axis, `approach` points at the fruit.

    The default is the gripper of (5) in Van Henten et al. 2010: the tool's x-axis points down the fruit. Raises `ValueError`
    for what are no unit vectors at a right angle.
    """

    up: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    approach: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        up, approach = (shaped(f"grasp: {name}", getattr(self, name), (3,)) for name in ("up", "approach"))
        unit = np.allclose([np.linalg.norm(up), np.linalg.norm(approach)], 1.0, atol=1e-6)
        if not (unit and abs(up @ approach) <= 1e-6):
            raise ValueError(
                f"grasp: up {shown(self.up)} and approach {shown(self.approach)} are no unit vectors at a right angle; "
                "write e.g. up = (-1, 0, 0), approach = (0, 0, 1)"
            )


class Table(NamedTuple):
    """All candidates inside the limits, a row each; clearance [m], angle [rad], leading joints [m, rad]."""

    angle: np.ndarray
    leading: np.ndarray
    branch: np.ndarray
    q: np.ndarray
    clearance: np.ndarray
    freedom: np.ndarray
    score: np.ndarray

    def best(self, margin: float) -> int | None:
        """The row with the best score among those with at least `margin` of clearance [m]."""
        free = np.flatnonzero(self.clearance >= margin)
        return int(free[np.argmax(self.score[free])]) if len(free) else None


class Scan(NamedTuple):
    """A scanned fruit: the grid, the fate of every candidate as a `Reason`, (angles, leading, branches), and the table.

    `near_limits` are the valid candidates that miss the limits by least, as (angle, leading, branch) indices.
    """

    fruit: Fruit
    angles: np.ndarray
    leading: np.ndarray
    status: np.ndarray
    table: Table
    near_limits: np.ndarray

    @property
    def reason(self) -> Reason:
        """SOLVED, or how far the best candidate came."""
        for reason in (Reason.SOLVED, Reason.COLLISION, Reason.LIMITS):
            if np.any(self.status == reason):
                return reason
        return Reason.OUT_OF_REACH


# --------------------------------------------------------------------------------------------------------------------
# Compiled once a chain


@functools.lru_cache(maxsize=64)
def measures(chain: Chain) -> HostKernel:
    """A batch of clearances [m] and freedoms: (q, scene)."""
    return HostKernel(lambda q, scene: (clearance(chain, scene, q), joint_freedom(chain, q)), 1)


@functools.lru_cache(maxsize=16)
def _contacts(chain: Chain, objects: int) -> HostKernel:
    return HostKernel(lambda q, around: (by_object(chain, objects, around, q), self_clearance(chain, q)), 1)


@functools.lru_cache(maxsize=16)
def _ascent(chain: Chain) -> HostKernel:
    """What recovery raises (`_worth`), its gradient in q, and the Jacobian."""

    worth = jax.value_and_grad(lambda q, scene: _worth(chain, clearance(chain, scene, q), q))
    return HostKernel(lambda q, scene: (*worth(q, scene), jacobian(chain, q)), 1)


def _worth(chain: Chain, distance: Any, q: Any) -> Any:
    """The clearance, or the room to the limits if that is less: positive exactly where a posture is admissible."""
    room = jnp.minimum(q - jnp.asarray(chain.lower, q.dtype), jnp.asarray(chain.upper, q.dtype) - q)
    return jnp.minimum(distance, LIMIT_LENGTH * jnp.min(room))


# --------------------------------------------------------------------------------------------------------------------
# The scan


def grasp_poses(chain: Chain, fruit: Fruit, angles: np.ndarray, grasp: Grasp | None = None) -> np.ndarray:
    """`fruit_frames` in the chain's base."""
    return np.linalg.inv(chain.world_T_base) @ fruit_frames(fruit, angles, grasp)


def fruit_frames(fruit: Fruit, angles: np.ndarray, grasp: Grasp | None = None) -> np.ndarray:
    """The tip frames in the world (a, 4, 4) that hold `fruit` at the given angles [rad] about its axis.

    At angle 0 the approach is along the world's y (its x where the axis is y), turned right-handed about the axis from there.
    """
    grasp = grasp or Grasp()
    up, reference = fruit.axis, np.array([0.0, 1.0, 0.0])
    if abs(up @ reference) > 0.99:
        reference = np.array([1.0, 0.0, 0.0])
    forward = reference - up * (up @ reference)
    forward /= np.linalg.norm(forward)
    side = np.cross(up, forward)
    approach = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * side
    world = np.stack([np.broadcast_to(up, approach.shape), approach, np.cross(up, approach)], axis=-1)
    tool = np.stack([grasp.up, grasp.approach, np.cross(grasp.up, grasp.approach)], axis=-1)
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = world @ tool.T, fruit.position
    return poses


def approach_grid(angles: Any) -> np.ndarray:
    """Angles (m,) [rad] as given, or so many from -pi up to, and without, pi. Raises `ValueError` for what is neither."""
    angles = as_count_or_values("angles", angles, (-1,))
    if isinstance(angles, np.ndarray):
        return angles
    return -np.pi + 2.0 * np.pi * np.arange(angles) / angles


def scan(
    chain: Chain,
    scene: Scene,
    fruit: Fruit,
    angles: Any = 72,
    slides: Any = 41,
    weights: Weights | None = None,
    margin: float = 0.005,
    grasp: Grasp | None = None,
) -> Scan:
    """All candidates for a fruit: approach angles x leading joints x branches, with limits, clearance and freedom.

    `angles` and `slides` are counts or the values themselves, (m,) [rad] and (m, k) [m, rad]; of one slide (m,) too. The fruit
    itself is no obstacle. A candidate is SOLVED in `status` with at least `margin` [m] of clearance.

    Raises `ValueError` where the chain has no closed form, or nothing to collide with, for what is neither a count nor values,
    and for a fruit, weights, grasp or margin that is none.
    """
    check_kind("scan", "fruit", fruit, Fruit)
    check_kind("scan", "weights", weights, Weights, optional=True)
    check_kind("scan", "grasp", grasp, Grasp, optional=True)
    check_finite("scan", margin=margin)
    reason = closed_form_obstacle(chain)
    if reason:
        raise ValueError(f"{chain.name}: a scan needs the closed form, and {reason}")
    check_geometry(chain)
    at = approach_grid(angles)
    lead = leading_grid(chain, slides)
    poses = grasp_poses(chain, fruit, at, grasp)
    shape = (len(at), len(lead), BRANCHES)
    q, status, rows, near = _candidates(chain, poses, lead)
    distance, freedom = _measured(chain, scene, fruit, q)
    status[rows] = np.where(distance >= margin, Reason.SOLVED, Reason.COLLISION)
    angle, position, branch = np.unravel_index(rows, shape)
    score = (weights or Weights()).score(distance, freedom)
    table = Table(at[angle], lead[position], branch, q, distance, freedom, score)
    return Scan(fruit, at, lead, status.reshape(shape), table, np.stack(np.unravel_index(near, shape), axis=-1))


def _candidates(chain: Chain, poses: np.ndarray, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of all poses at all leading positions: postures inside the limits, the status of all candidates, the rows of those
    inside, and the nearest past the limits. All are asked which branches have the pose; only these are solved."""
    poses, leading, count = poses.astype(np.float32), lead.astype(np.float32), len(lead)
    cell = lambda pair: (poses.take(pair // count, axis=0), leading.take(pair % count, axis=0))
    pairs = np.arange(len(poses) * count, dtype=np.int32)
    (bits,) = in_blocks(valid_branches(chain), pairs, double=False, rows=cell)
    valid = np.flatnonzero(np.unpackbits(bits, bitorder="little").view(bool))
    posture = lambda row: (*cell(row // BRANCHES), (row % BRANCHES).astype(np.int32))
    q, within = in_blocks(closed_branches(chain), valid, double=False, rows=posture)
    status = np.full(len(pairs) * BRANCHES, Reason.OUT_OF_REACH, np.int8)
    status[valid] = Reason.LIMITS
    past = ~within
    violation = np.maximum(chain.lower - q[past], q[past] - chain.upper).max(axis=1)
    near = valid[past][np.argsort(violation, kind="stable")[:MISSES]]
    return q[within], status, valid[within], near


MISSES = 16  # candidates that recovery starts from


def _others(scene: Scene, fruit: Fruit) -> Scene:
    """The scene without the fruit that is being picked."""
    own = [name for name in scene.object_names if name == fruit.name]
    return remembered(scene, ("without", fruit.name), lambda: scene.without(own))


def _measured(chain: Chain, scene: Scene, fruit: Fruit, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(q):
        return np.zeros(0), np.zeros(0)
    distance, freedom = in_blocks(measures(chain), q, fixed=(grouped(_others(scene, fruit), chain),))
    return distance, freedom


# --------------------------------------------------------------------------------------------------------------------
# The first of the paper's two steps


def approach_angles(
    chain: Chain, scene: Scene, fruit: Fruit, angles: Any = 72, grasp: Grasp | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The approach angles [rad] from best to worst, and the clearance [m] of the last three links, straight, at each.

    Source: Van Henten et al. 2010, sec. 4.1, step 1.
    """
    at = approach_grid(angles)
    hand = chain.part(chain.num_joints - 3, chain.num_joints)
    rest = np.zeros(hand.num_joints)
    straight = hand.joint_T_tip
    for frame in hand.parent_T_joint[::-1]:
        straight = frame @ straight
    placed = chain.world_T_base @ grasp_poses(chain, fruit, at, grasp) @ np.linalg.inv(straight)
    others = _others(scene, fruit)
    each = jax.jit(jax.vmap(lambda frame: jnp.min(object_clearances(hand.mounted(frame), others, rest))))
    distance = np.asarray(each(placed))
    order = np.argsort(-distance, kind="stable")
    return at[order], distance[order]


def scan_two_step(
    chain: Chain, scene: Scene, fruit: Fruit, angles: Any = 72, slides: Any = 41, **options: Any
) -> tuple[Scan, int]:
    """The paper's two steps, with the recovery that it lacks: where the best angle has no posture the next one is taken.

    Returns the scan of the first angle that has one (else of the best angle) and how many angles were tried.
    """
    order, _ = approach_angles(chain, scene, fruit, angles, options.get("grasp"))
    first = None
    for tried, angle in enumerate(order, 1):
        found = scan(chain, scene, fruit, np.array([angle]), slides, **options)
        first = first or found
        if found.reason == Reason.SOLVED:
            return found, tried
    assert first is not None
    return first, len(order)


# --------------------------------------------------------------------------------------------------------------------
# Recovery


class Recovered(NamedTuple):
    """A posture found between the grid's points, and how: "finer grid" or "gradient"."""

    row: Table
    how: str


def recover(
    chain: Chain,
    scene: Scene,
    found: Scan,
    weights: Weights | None = None,
    margin: float = 0.005,
    grasp: Grasp | None = None,
    steps: int = 25,
) -> Recovered | None:
    """A posture near the misses of a scan that has none: a grid ten times finer around them, then gradient ascent.

    The gradient is exact. Along the self-motion (the tip stays) the joints follow angle and leading joints by
    `J_arm dq_arm = twist - J_lead dq_lead`, and every step ends in the closed form, so the pose never drifts.
    """
    starts = _misses(found)
    if not len(starts):
        return None
    for spread in _finer(chain, found, starts):
        finer = scan(chain, scene, found.fruit, *spread, weights=weights, margin=margin, grasp=grasp)
        best = finer.table.best(margin)
        if best is not None:
            return Recovered(Table(*(column[best : best + 1] for column in finer.table)), "finer grid")
    return _climb(chain, scene, found, starts, weights or Weights(), margin, grasp, steps)


def _misses(found: Scan) -> np.ndarray:
    """The nearest misses as rows (angle, leading..., branch): by clearance, then by how little a limit is passed."""
    table = found.table
    order = np.argsort(-table.clearance)[:MISSES]
    close = np.column_stack([table.angle[order], table.leading[order], table.branch[order]])
    a, s, b = found.near_limits.T
    return np.concatenate([close, np.column_stack([found.angles[a], found.leading[s], b])])


def _finer(chain: Chain, found: Scan, starts: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Around the few best distinct cells: a tenth of the grid's step, one step to either side."""
    step = 2.0 * np.pi / max(len(found.angles), 2)
    lead = found.leading
    width = np.array([np.min(np.diff(np.unique(c)), initial=np.inf) if len(np.unique(c)) > 1 else 0.0 for c in lead.T])
    fine = np.linspace(-1.0, 1.0, 21)
    cells = np.unique(starts[:, :-1], axis=0, return_index=True)[1]
    k = chain.num_joints - 6
    for row in starts[np.sort(cells)][:4]:
        axes = [np.clip(row[1 + i] + fine * width[i], chain.lower[i], chain.upper[i]) for i in range(k)]
        yield row[0] + fine * step, grid(axes)


def _climb(
    chain: Chain,
    scene: Scene,
    found: Scan,
    starts: np.ndarray,
    weights: Weights,
    margin: float,
    grasp: Grasp | None,
    steps: int,
) -> Recovered | None:
    others = grouped(_others(scene, found.fruit), chain)
    k = chain.num_joints - 6
    axis = np.asarray(chain.world_T_base[:3, :3].T @ found.fruit.axis)
    branch = starts[:, -1].astype(int)
    rows = np.arange(len(starts))

    def solve(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = grasp_poses(chain, found.fruit, u[:, 0], grasp)
        q, valid, _ = in_blocks(closed_forms(chain), poses.astype(np.float32), u[:, 1:].astype(np.float32))
        return q[rows, branch], valid[rows, branch]

    measure = lambda q: in_blocks(_ascent(chain), q, fixed=(others,))
    u, stride = starts[:, :-1].copy(), np.full(len(starts), 0.1)
    q, _ = solve(u)
    worth, slope, jacobians = measure(q)
    for _ in range(steps):
        direction = _self_motion(jacobians.astype(np.float64), slope.astype(np.float64), axis, k)
        trial = u + stride[:, None] * direction
        trial[:, 1:] = np.clip(trial[:, 1:], chain.lower[:k], chain.upper[:k])
        trial_q, valid = solve(trial)
        trial_worth, trial_slope, trial_jacobians = measure(trial_q)
        better = valid & (trial_worth > worth)
        u, q = np.where(better[:, None], trial, u), np.where(better[:, None], trial_q, q)
        worth, slope = np.where(better, trial_worth, worth), np.where(better[:, None], trial_slope, slope)
        jacobians = np.where(better[:, None, None], trial_jacobians, jacobians)
        stride = np.where(better, np.minimum(1.5 * stride, 0.3), 0.4 * stride)
        if np.max(worth) > margin or np.max(stride) < 1e-4:
            break
    distance, freedom = _measured(chain, scene, found.fruit, q)
    inside = np.all((q >= chain.lower) & (q <= chain.upper), axis=1)
    table = Table(u[:, 0], u[:, 1:], branch, q, np.where(inside, distance, -np.inf), freedom, weights.score(distance, freedom))
    best = table.best(margin)
    return None if best is None else Recovered(Table(*(c[best : best + 1] for c in table)), "gradient")


def _self_motion(jacobians: np.ndarray, slope: np.ndarray, axis: np.ndarray, k: int) -> np.ndarray:
    """The unit direction in (angle, leading joints) that raises a function of q with gradient `slope` most."""
    arm = jacobians[:, :, k:]
    turn = np.broadcast_to(np.concatenate([np.zeros(3), axis])[:, None], (len(arm), 6, 1))
    moved = np.linalg.pinv(arm) @ np.concatenate([turn, -jacobians[:, :, :k]], axis=2)  # pinv: the wrist may be singular
    gradient = np.einsum("bi,bij->bj", slope[:, k:], moved)
    gradient[:, 1:] += slope[:, :k]
    return gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


# --------------------------------------------------------------------------------------------------------------------
# What stands in the way


class Blockers(NamedTuple):
    """Objects in the way of a fruit: the share of candidate postures that each blocks, and a smallest set to remove.

    `removal` is None where no removable set opens a posture (the robot hits itself or what may not be removed).
    """

    names: tuple[str, ...]
    share: tuple[float, ...]
    removal: tuple[str, ...] | None
    row: int | None  # of the table: the posture that the removal opens


def blockers(chain: Chain, scene: Scene, found: Scan, margin: float = 0.005) -> Blockers:
    """Which objects stand in the way of a scanned fruit, and the fewest whose removal opens a posture of its table.

    A posture opens exactly when all that it touches is removed; so the smallest set is the smallest of the sets that the
    candidates touch, no search needed. Of equal sets the one with the most clearance to what stays is taken.
    """
    check_kind("blockers", "found", found, Scan)
    check_finite("blockers", margin=margin)
    if not len(found.table.q):
        return Blockers((), (), None, None)
    around = grouped(_others(scene, found.fruit), chain, by_object=True)
    distance, own = in_blocks(_contacts(chain, len(scene.object_names)), found.table.q, fixed=(around,))
    hit = distance < margin
    share = hit.mean(axis=0)
    order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] > 0.0]
    possible = np.flatnonzero((own >= margin) & ~np.any(hit & ~np.array(scene.removable, bool), axis=1))
    names = tuple(scene.object_names[i] for i in order)
    shares = tuple(float(share[i]) for i in order)
    if not len(possible):
        return Blockers(names, shares, None, None)
    stays = np.where(hit, np.inf, distance).min(axis=1, initial=np.inf)
    row = min(possible, key=lambda i: (int(hit[i].sum()), -float(min(stays[i], own[i]))))
    return Blockers(names, shares, tuple(scene.object_names[i] for i in np.flatnonzero(hit[row])), int(row))

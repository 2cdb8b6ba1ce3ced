"""Pictures of a sweep (matplotlib, no window needed): slices of the map, reasons, what was missed, how free postures are."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.options import optional
from jaxik.collision.scene import Scene
from jaxik.reasons import Reason
from jaxik.sweeps.robot_variants import variant_name
from jaxik.view.palette import COLOURS, GOOD, INK, PARTLY, SCALE, WORDS
from jaxik.view.pictures import draw_solids, marker
from jaxik.view.solids import scene_points, scene_solids

SHOWN = 20_000  # points of a scatter plot
SLICES = 3
VARIANTS = 20  # bars


class Map(NamedTuple):
    """One variant of a store: positions (p, 3) [m], the share (p,) of each one's tool directions that are reachable, and of all
    targets the reason and the limit margin, or the `duration` of motions [s]."""

    positions: np.ndarray
    share: np.ndarray
    reason: np.ndarray
    margin: np.ndarray
    axes: tuple[np.ndarray, ...]
    duration: np.ndarray | None = None


def open_store(path: str | Path) -> Any:
    """The Zarr group of a sweep. Raises `ValueError` where there is none, or one whose targets are no places."""
    zarr, found = optional("a sweep's store", "zarr", "sweep"), None
    with contextlib.suppress(OSError, ValueError):
        group = zarr.open_group(str(path), mode="r")
        if "reason" in group:
            found = group
    if found is not None and "position" in found:
        return found
    if found is not None:
        raise ValueError(f"{path}: its targets are postures, which are no places to show; take a store of poses")
    raise ValueError(f"{path}: is no store of a sweep; make one with `jaxik sweep STUDY.toml`")


def variant_axes(group: Any) -> list[str]:
    """The axes along which variants differ, besides the targets."""
    return [n for n in (group["reason"].metadata.dimension_names or ()) if n != "target"]


def variant_label(group: Any, index: tuple[int, ...]) -> str:
    """The words that tell a variant from others; none where there is only one."""
    return ", ".join(f"{name} {_labels(group, name)[i]}" for name, i in zip(variant_axes(group), index, strict=True))


def _labels(group: Any, name: str) -> list[str]:
    """The values along an axis, without the words that all of them share, such as "y=0.1" of "x=0 y=0.1 z=0 yaw_deg=0"."""
    labels = [f"{v:g}" if isinstance(v, float | np.floating) else str(v) for v in group[name][...]]
    words = [label.split() for label in labels]
    common = set.intersection(*map(set, words)) if len(words) > 1 else set()
    return [" ".join(w for w in each if w not in common) or label for each, label in zip(words, labels, strict=True)]


def base_frame(group: Any, index: tuple[int, ...]) -> np.ndarray:
    """Where the base of a variant is in the world (4, 4)."""
    return np.array(group.attrs["mounts"][variant_name(index)])


def is_in_base(group: Any) -> bool:
    """Whether targets are in the base's frame, not the world's."""
    return bool(group.attrs["frame"].startswith("targets are base"))


def shares(group: Any) -> np.ndarray:
    """The share of reachable targets of each variant, in the shape of the study's axes."""
    shape = group["reason"].shape[:-1]
    return np.reshape([np.mean(group["reachable"][(*index, slice(None))]) for index in np.ndindex(*shape)], shape)


def variant_map(group: Any, index: tuple[int, ...]) -> Map:
    """The store's map of one variant."""
    turns, read = int(group.attrs["targets_per_position"]), lambda name: np.asarray(group[name][(*index, slice(None))])
    positions, axes = np.asarray(group["position"][::turns]), tuple(np.array(a) for a in group.attrs["grid"])
    share = read("reachable").reshape(-1, turns).mean(axis=1)
    timed = "duration" in group
    margin = np.full(share.size * turns, np.nan) if timed else read("limit_margin")
    return Map(positions, share, read("reason"), margin, axes, read("duration") if timed else None)


def plot_sweep(store: str | Path, path: str | Path, *, scene: Scene | None = None) -> None:
    """Draws one picture (PNG) of a sweep's `store`: slices of the variant that reaches most, with the study's `scene`; what
    became of its targets, what was missed, and the variants beside each other. Host."""
    from matplotlib.figure import Figure

    group = open_store(store)
    every = shares(group)
    best = tuple(int(i) for i in np.unravel_index(np.argmax(every), every.shape))
    shown = variant_map(group, best)
    audit = {method: found for method, found in group.attrs.get("audit", {}).items() if found["efforts"]}
    figure = Figure(figsize=(15, 9.5), layout="constrained")
    head, above, legend, below = figure.subfigures(4, 1, height_ratios=(0.07, 1.0, 0.08, 0.9))
    handles = _draw_slices(above, group, shown, best, scene)
    legend.legend(handles=handles, loc="center", ncols=len(handles), frameon=False)
    timed = shown.duration is not None
    axes = below.subplots(1, 2 + bool(audit) + (timed and every.size > 1))
    _draw_reasons(axes[0], shown)
    if audit:
        _draw_missed(axes[1], audit)
    if every.size > 1:
        _draw_variants(axes[-1], group, every)
    if every.size == 1 or timed:
        _draw_values(axes[-1 if every.size == 1 else -2], shown)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    reached = f"the arm reaches {np.mean(shown.reason == Reason.SOLVED):.1%} of {len(shown.reason):,} targets"
    title = ", with ".join(filter(None, (f"{group.attrs['title']}: {reached}", variant_label(group, best))))
    head.text(0.5, 0.4, title, ha="center", va="center", weight="bold", size=15, color=INK)
    figure.savefig(path, dpi=110, format="png")


def categories(shown: Map) -> tuple[np.ndarray, list[tuple[str, str]]]:
    """The fate of each position, (p,) numbers into a list of words and colours: reachable from every direction, from some,
    or else the reason that is nearest to an answer; -1 where nothing is known yet."""
    reasons, words = [r for r in COLOURS if r != Reason.SOLVED], _words(shown)
    found = np.full(len(shown.positions), -1)
    turns = shown.reason.reshape(len(found), -1)
    whole = WORDS[Reason.SOLVED] if turns.shape[1] == 1 else "reachable from every direction"
    kinds = [(whole, GOOD), ("reachable from some directions", PARTLY)]
    for k, reason in reversed([*enumerate(reasons, len(kinds))]):
        found[(turns == reason).any(axis=1)] = k
    found[shown.share > 0.0] = 1
    found[shown.share == 1.0] = 0
    return found, [*kinds, *((words[r], COLOURS[r]) for r in reasons)]


def _words(shown: Map) -> dict[Reason, str]:
    """The words for the reasons of postures, or of motions."""
    return WORDS if shown.duration is None else WORDS | {Reason.NOT_CONVERGED: "no motion found"}


def _draw_slices(figure: Any, group: Any, shown: Map, index: tuple[int, ...], scene: Scene | None) -> list[Any]:
    """Level slices of a grid, or the positions from three sides, with the base and obstacles; returns the legend's entries."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    kind, kinds = categories(shown)
    edges = np.arange(len(kinds) + 1) - 0.5
    colours = {"cmap": ListedColormap([c for _, c in kinds]), "norm": BoundaryNorm(edges, len(kinds))}
    mount = base_frame(group, index)
    if is_in_base(group):
        scene, mount = None if scene is None else scene.moved(np.linalg.inv(mount)), np.eye(4)
    axes = figure.subplots(1, SLICES)
    if len(shown.axes) == 3:
        x, y, z = shown.axes
        cells = np.ma.masked_less(kind, 0).reshape(len(x), len(y), len(z))
        reached = np.flatnonzero((shown.share > 0.0).reshape(cells.shape).any(axis=(0, 1)))
        levels = reached if len(reached) else np.arange(len(z))
        picked = levels[np.unique(np.linspace(0, len(levels) - 1, 2 * SLICES + 1).round().astype(int)[1::2])]
        half = (z[-1] - z[0]) / max(2 * len(z) - 2, 1)
        for axis, k in zip(axes, picked, strict=False):
            axis.pcolormesh(x, y, cells[:, :, k].T, shading="nearest", **colours)
            _draw_surroundings(axis, scene, mount, 0, 1, (z[k] - half, z[k] + half))
            axis.set_title(f"from above, at a height of z = {z[k]:.2f} m")
        for axis in axes[len(picked) :]:
            axis.set_axis_off()
    else:
        some = np.random.default_rng(0).permutation(np.flatnonzero(kind >= 0))[:SHOWN]
        some = some[np.argsort(-kind[some], kind="stable")]  # what is reachable lies on top
        sides = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))
        for axis, (i, j, side) in zip(axes, sides, strict=True):
            axis.scatter(*shown.positions[some][:, [i, j]].T, c=kind[some], s=6, lw=0, **colours)
            _draw_surroundings(axis, scene, mount, i, j, (-np.inf, np.inf))
            axis.set_title(f"{side}, all targets")
    handles: list[Any] = [Patch(fc=c, ec="0.6", label=words) for k, (words, c) in enumerate(kinds) if (kind == k).any()]
    handles.append(marker(INK, "^", "the robot's base", mec="w", ms=11))
    if scene is not None:
        handles.append(Patch(fc="w", ec=INK, label="obstacles at this height" if len(shown.axes) == 3 else "obstacles"))
    return handles


def _draw_surroundings(axis: Any, scene: Scene | None, mount: np.ndarray, i: int, j: int, between: tuple[float, float]) -> None:
    """The base, and the outlines of the obstacles that are between two coordinates along the third axis."""
    across, (low, high) = 3 - i - j, between
    axis.autoscale_view()
    sides = np.array([axis.get_xlim(), axis.get_ylim()])
    if scene is not None:
        solids = [s for s in scene_solids(scene) if s.span[0, across] <= high and s.span[1, across] >= low]
        fill = (1.0, 1.0, 1.0, 0.7 if np.isfinite(low) else 0.0)
        draw_solids(axis, solids, i, j, facecolor=fill, edgecolor=INK, lw=1.0)
        points = scene_points(scene)[0]
        points = points[(points[:, across] >= low) & (points[:, across] <= high)]
        axis.scatter(points[:, i], points[:, j], s=10, color=[fill], ec=INK, lw=0.6)
    place = mount[[i, j], 3]
    axis.plot(*place, "^", color=INK, mec="w", ms=11, zorder=5, clip_on=False)
    sides = np.array([np.minimum(sides[:, 0], place - 0.05), np.maximum(sides[:, 1], place + 0.05)])
    axis.set(xlim=sides[:, 0], ylim=sides[:, 1], xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", aspect="equal")


def _draw_reasons(axis: Any, shown: Map) -> None:
    found = {r: float(np.mean(shown.reason == r)) for r in reversed(COLOURS) if (shown.reason == r).any()}
    percent = [100.0 * share for share in found.values()]
    words = _words(shown)
    bars = axis.barh([words[r] for r in found], percent, color=[COLOURS[r] for r in found], ec="0.6")
    axis.bar_label(bars, [f" {share:.1%} ({round(share * len(shown.reason)):,})" for share in found.values()])
    axis.set(title="What became of the targets", xlabel="targets [%]", xlim=(0.0, 1.35 * max(percent, default=1.0)))
    axis.set_xticks([tick for tick in axis.get_xticks() if tick <= 100.0])


def _draw_values(axis: Any, shown: Map) -> None:
    """How free the postures are, or how long the motions take."""
    values = shown.margin if shown.duration is None else shown.duration
    axis.hist(values[np.isfinite(values)], bins=40, color=GOOD)
    if shown.duration is None:
        title, along = "How far the joints stay from their limits", "0: at a limit; 1: in the middle"
    else:
        title, along = "How long the motions take", "duration [s]"
    axis.set(title=title, xlabel=along, ylabel="targets")


def _draw_missed(axis: Any, audit: dict[str, Any]) -> None:
    """How many reachable targets are missed, by how much is looked at alone; and how many this sweep misses."""
    for (method, found), style in zip(audit.items(), ("o-", "s--"), strict=False):
        rates = 100.0 * np.array(found["rates"])
        axis.plot(found["efforts"], rates, style, color=INK, label=f"{method}: these alone")
        rate = 100.0 * found["false_negative_rate"]
        axis.axhline(rate, color=GOOD, ls=style[1:], label=f"{method}: this sweep, {rate:.2g} %")
    efforts = sorted({e for found in audit.values() for e in found["efforts"]})
    axis.set_xscale("log")
    axis.minorticks_off()
    axis.set_xticks(efforts, [str(e) for e in efforts])
    axis.legend(fontsize=9, frameon=False)
    named = " or ".join(_effort(found) for found in audit.values())
    axis.set(title="Reachable targets that are missed", xlabel=f"{named} that are tried", ylabel="missed [%]", ylim=(0.0, None))


def _effort(found: dict[str, Any]) -> str:
    """The further effort of an audit."""
    counted = {"max_seeds": "seeds", "rounds": "rounds of the search"}
    return counted.get(found["effort"]) or f"positions of {' and '.join(found.get('of', ['the slide']))}"


def _draw_variants(axis: Any, group: Any, every: np.ndarray) -> None:
    names = variant_axes(group)
    title = "Reachable, by " + " and ".join(names)
    if every.ndim == 2:
        mesh = axis.imshow(100.0 * every, aspect="auto", cmap=SCALE)
        axis.figure.colorbar(mesh, ax=axis, label="reachable targets [%]")
        for set_ticks, name in ((axis.set_yticks, names[0]), (axis.set_xticks, names[1])):
            labels = _labels(group, name)
            every_few = -(-len(labels) // 12)  # more would lie over each other
            set_ticks(range(0, len(labels), every_few), labels[::every_few], fontsize=8)
        axis.set(ylabel=names[0], xlabel=names[1])
        axis.tick_params(axis="x", rotation=30)
    else:
        indices = [*np.ndindex(*every.shape)]
        labels = [variant_label(group, index) for index in indices]
        order = np.argsort(-every.ravel(), kind="stable")[:VARIANTS]
        best = [GOOD, *[PARTLY] * (len(order) - 1)]
        bars = axis.barh(range(len(order)), 100.0 * every.ravel()[order], color=best)
        axis.bar_label(bars, [f" {x:.1%}" for x in every.ravel()[order]], fontsize=9)
        axis.set_yticks(range(len(order)), [labels[i] for i in order], fontsize=9)
        axis.invert_yaxis()
        axis.margins(x=0.15)
        axis.set(xlabel="reachable targets [%]")
        title += f": the best {VARIANTS} of {len(indices)}" if len(indices) > VARIANTS else ""
    axis.set_title(title)

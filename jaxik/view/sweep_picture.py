"""Pictures of a sweep (matplotlib, no window needed): slices of the map, reasons, what was missed, how free postures are."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.extras import optional
from jaxik.reasons import Reason
from jaxik.view.harvest_picture import COLOURS

SHOWN = 20_000  # points of a scatter plot
SLICES = 3


class Map(NamedTuple):
    """One variant of a store: positions (p, 3) [m], the share (p,) of each one's tool directions that are reachable, and of all
    targets the reason and the limit margin."""

    label: str
    positions: np.ndarray
    share: np.ndarray
    reason: np.ndarray
    margin: np.ndarray
    axes: tuple[np.ndarray, ...]


def open_store(path: str | Path) -> Any:
    """The Zarr group of a sweep. Raises `ValueError` where there is none."""
    zarr = optional("a sweep's store", "zarr", "sweep")
    with contextlib.suppress(OSError, ValueError):
        group = zarr.open_group(str(path), mode="r")
        if "reason" in group:
            return group
    raise ValueError(f"{path}: is no store of a sweep; make one with `jaxik sweep STUDY.toml`")


def variant_axes(group: Any) -> list[str]:
    """What varies besides the targets."""
    return [n for n in (group["reason"].metadata.dimension_names or ()) if n != "target"]


def variant_label(group: Any, index: tuple[int, ...]) -> str:
    """A variant in words; none where there is only one."""
    return ", ".join(f"{n} {group[n][i]}" for n, i in zip(variant_axes(group), index, strict=True))


def shares(group: Any) -> np.ndarray:
    """The share of reachable targets of each variant, in the shape of the study's axes."""
    shape = group["reason"].shape[:-1]
    found = [np.mean(group["reachable"][(*index, slice(None))]) for index in np.ndindex(*shape)]
    return np.array(found).reshape(shape)


def variant_map(group: Any, index: tuple[int, ...]) -> Map:
    """What the store says of one variant."""
    turns, shape = int(group.attrs["targets_per_position"]), group["reason"].shape
    positions = np.asarray(group["position"][::turns])
    reachable = np.asarray(group["reachable"][(*index, slice(None))])
    axes = tuple(np.array(a) for a in group.attrs["grid"])
    return Map(
        variant_label(group, index),
        positions,
        reachable.reshape(-1, turns).mean(axis=1) if shape[-1] else np.zeros(0),
        np.asarray(group["reason"][(*index, slice(None))]),
        np.asarray(group["limit_margin"][(*index, slice(None))]),
        axes,
    )


def plot_sweep(path: str | Path, out: str | Path) -> None:
    """One picture (PNG) of the store at `path`: the variant that reaches most in slices, and of all variants the shares."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    group = open_store(path)
    every = shares(group)
    best = np.unravel_index(int(np.argmax(every)), every.shape) if every.ndim else ()
    shown = variant_map(group, tuple(int(i) for i in best))
    figure = Figure(figsize=(15, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, SLICES)
    _draw_slices(figure, axes[0], shown)
    _draw_reasons(axes[1, 0], shown)
    _draw_missed(axes[1, 1], dict(group.attrs.get("audit", {})))
    if every.size > 1:
        _draw_variants(axes[1, 2], group, every)
    else:
        _draw_margins(axes[1, 2], shown)
    title = f"{group.attrs['title']}: {np.mean(shown.reason == Reason.SOLVED):.1%} of {len(shown.reason):,} targets"
    figure.suptitle(f"{title}{f'; shown: {shown.label}' if shown.label else ''}")
    figure.savefig(out, dpi=110, format="png")


def _draw_slices(figure: Any, axes: Any, shown: Map) -> None:
    """Level slices of a grid, or the positions from three sides."""
    if len(shown.axes) == 3:
        x, y, z = shown.axes
        share = shown.share.reshape(len(x), len(y), len(z))
        picked = np.unique(np.linspace(0, len(z) - 1, SLICES + 2).round().astype(int)[1:-1])
        for axis, k in zip(axes, picked, strict=False):
            mesh = axis.pcolormesh(x, y, share[:, :, k].T, vmin=0.0, vmax=1.0, cmap="viridis", shading="nearest")
            axis.set(title=f"z = {z[k]:.2f} m", xlabel="x [m]", ylabel="y [m]", aspect="equal")
        for axis in axes[len(picked) :]:
            axis.set_axis_off()
    else:
        some = np.random.default_rng(0).permutation(len(shown.positions))[:SHOWN]
        for axis, (i, j) in zip(axes, ((0, 1), (0, 2), (1, 2)), strict=True):
            p = shown.positions[some]
            mesh = axis.scatter(p[:, i], p[:, j], c=shown.share[some], s=6, vmin=0.0, vmax=1.0, cmap="viridis")
            axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", aspect="equal")
    figure.colorbar(mesh, ax=axes, label="share of tool directions that are reachable", shrink=0.8)


def _draw_reasons(axis: Any, shown: Map) -> None:
    values, counts = np.unique(shown.reason[shown.reason >= 0], return_counts=True)
    reasons = [Reason(int(v)) for v in values]
    bars = axis.bar([r.text for r in reasons], counts, color=[COLOURS[r] for r in reasons])
    axis.bar_label(bars, [f"{c:,}" for c in counts])
    axis.set(title="what became of the targets", ylabel="targets")


def _draw_missed(axis: Any, audit: dict[str, Any]) -> None:
    for method, found in audit.items():
        line = axis.plot(found["efforts"], 100.0 * np.array(found["rates"]), "o-", label=f"{method}: {found['effort']} alone")
        rate = 100.0 * found["false_negative_rate"]
        axis.axhline(rate, color=line[0].get_color(), ls=":", label=f"{method}: this sweep, {rate:.2g} %")
    if audit:
        efforts = sorted({e for found in audit.values() for e in found["efforts"]})
        axis.set_xscale("log")
        axis.minorticks_off()
        axis.set_xticks(efforts, [str(e) for e in efforts])
        axis.legend(fontsize=8)
    axis.set(title="false negatives" if audit else "false negatives: not measured", xlabel="effort", ylabel="missed [%]")


def _draw_margins(axis: Any, shown: Map) -> None:
    axis.hist(shown.margin[np.isfinite(shown.margin)], bins=40, color="tab:green")
    axis.set(title="freedom of the best postures", xlabel="limit margin (1: joints in the middle)", ylabel="targets")


def _draw_variants(axis: Any, group: Any, every: np.ndarray) -> None:
    names = variant_axes(group)
    if every.ndim == 2:
        mesh = axis.imshow(100.0 * every, aspect="auto", cmap="viridis")
        axis.figure.colorbar(mesh, ax=axis, label="reachable [%]")
        for set_ticks, name in ((axis.set_yticks, names[0]), (axis.set_xticks, names[1])):
            labels = [_short(v) for v in group[name][...]]
            set_ticks(range(len(labels)), labels, fontsize=7)
        axis.set(ylabel=names[0], xlabel=names[1])
        axis.tick_params(axis="x", rotation=60)
    else:
        indices = list(np.ndindex(*every.shape))
        labels = [", ".join(_short(group[n][i]) for n, i in zip(names, index, strict=True)) for index in indices]
        axis.barh(range(len(labels)), 100.0 * every.ravel(), color="tab:green")
        axis.set_yticks(range(len(labels)), labels, fontsize=7)
        axis.set(xlabel="reachable [%]")
    axis.set_title("reachable, by " + ", ".join(names))


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float | np.floating) else str(value)

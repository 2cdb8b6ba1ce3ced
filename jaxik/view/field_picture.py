"""A picture of slices through a distance field (matplotlib, no window needed)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxik.checks.options import check_kind, shown
from jaxik.fields.distance_field import DistanceField
from jaxik.view.palette import DISTANCES, INK

AXES = "xyz"


def plot_field(field: DistanceField, path: str | Path, *, axis: str = "z", at: Sequence[float] = ()) -> None:
    """Draws slices of a distance field (PNG) across an `axis` of its grid, at such places on it [m, from the first node], the
    middle unless they are told: distances in colours, what is inside in the warm ones, and the surface as a line. Host.

    Raises `ValueError` for another axis, and for a place that is not in the grid.
    """
    from matplotlib.figure import Figure

    check_kind("plot_field", "field", field, DistanceField)
    if axis not in tuple(AXES):
        raise ValueError(f"plot_field: axis is {shown(repr(axis))}; allowed: x, y, z")
    k = AXES.index(axis)
    across, edge = [i for i in range(3) if i != k], float(field.spacing)
    last = float(field.corners[1][k])
    places = list(at) or [last / 2.0]
    values = np.moveaxis(np.asarray(field.values), k, 0)
    most = float(np.abs(values).max()) or 1.0
    figure = Figure(figsize=(5.0 * len(places) + 1.0, 4.5), layout="constrained")
    for panel, place in zip(figure.subplots(1, len(places), squeeze=False)[0], places, strict=True):
        if not 0.0 <= place <= last:
            raise ValueError(f"plot_field: at {place:g} m; the grid has {axis} from 0 to {last:g} m")
        number = round(place / edge)
        slice_ = values[number].T
        ends = [(-edge / 2.0, field.corners[1][i] + edge / 2.0) for i in across]
        looks = {"origin": "lower", "extent": (*ends[0], *ends[1]), "cmap": DISTANCES, "vmin": -most, "vmax": most}
        image = panel.imshow(slice_, **looks)
        if slice_.min() < 0.0 < slice_.max():
            nodes = [edge * np.arange(n) for n in slice_.shape[::-1]]
            panel.contour(*nodes, slice_, levels=[0.0], colors=INK, linewidths=1.0)
        panel.set(title=f"{axis} = {number * edge:.3f} m", xlabel=f"{AXES[across[0]]} [m]", ylabel=f"{AXES[across[1]]} [m]")
    figure.colorbar(image, ax=figure.axes, label="distance [m]")
    figure.savefig(path, dpi=110, format="png")

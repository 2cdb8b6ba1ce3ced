"""A sweep's targets on the page: a cloud of points, coloured, cut, and asked for the posture under a click."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.files.targets import as_frames
from jaxik.kinematics.forward import pose_errors
from jaxik.kinematics.robot import Robot
from jaxik.sweeps.robot_variants import variant_name
from jaxik.view.drawing import draw_points
from jaxik.view.palette import SCALE, bar, rgb, swatches
from jaxik.view.solids import SHOWN
from jaxik.view.stage import Stage
from jaxik.view.sweep_picture import Map, base_frame, categories, is_in_base, open_store, variant_label, variant_map

KINDS = "what became of it"
SHARE = "share of directions"
COLUMNS = {SHARE: 1.0, "limit margin": 1.0, "clearance [mm]": 1000.0, "solutions": 1.0}  # by which they grow
FAINT = 0.6  # how large the points are that are not reachable


class Cloud:
    """The controls of a map and its points, those that are reachable before the others.

    The robot stands where the variant has it. A map of another robot, or of other lengths of its links, is shown alone.
    """

    def __init__(self, page: Stage, group: Any):
        self.page, self.server, self.group = page, page.server, group
        self.turns = int(group.attrs["targets_per_position"])
        self.fits = functools.cache(lambda index: _is_of(group, index, page.home))
        self.map = functools.lru_cache(1)(self._map)  # one at a time: it may be large
        self.indices = {
            variant_label(group, index) or "the only one": index for index in np.ndindex(*group["reason"].shape[:-1])
        }
        told = [what for what in COLUMNS if what == SHARE or _name(what) in group]
        gui = self.server.gui
        self.legend = gui.add_html("")
        self.visible = gui.add_checkbox("show the map", True)
        self.variant = gui.add_dropdown("variant", list(self.indices), visible=len(self.indices) > 1)
        self.colour = gui.add_dropdown("colour by", (KINDS, *told))
        self.rest = gui.add_dropdown("not reachable", ("hidden", "faint"))
        spans = zip("xyz", *self._span(), strict=True)
        self.cuts = [gui.add_multi_slider(f"{axis} [m]", low, high, 0.001, (low, high)) for axis, low, high in spans]
        self.size = gui.add_slider("point size [mm]", 2.0, 50.0, 1.0, 8.0)
        for control in (self.visible, self.colour, self.rest, *self.cuts, self.size):
            control.on_update(lambda _: self.draw())
        self.variant.on_update(lambda _: self.stand())
        self.server.scene.on_click()(self._clicked)
        self.stand()

    def stand(self) -> None:
        """Puts the robot where the variant has it, and draws its map."""
        index = self.indices[self.variant.value]
        if self.fits(index):
            self.page.move(self.page.q, base_frame(self.group, index))
        self.draw()

    def draw(self) -> None:
        """Draws the points that the controls leave."""
        index = self.indices[self.variant.value]
        shown = self.map(index)
        low, high = np.transpose([cut.value for cut in self.cuts])
        inside = np.all((shown.positions >= low - 1e-3) & (shown.positions <= high + 1e-3), axis=1)
        colours, legend = self._colours(shown, inside, index)
        reached, radius = shown.share > 0.0, self.size.value / 1000.0
        for name, mask, size in (("reachable", reached, radius), ("rest", ~reached, FAINT * radius)):
            rows = np.flatnonzero(inside & mask)
            rows = rows[:: max(1, -(-len(rows) // SHOWN))]
            seen = self.visible.value and (name == "reachable" or self.rest.value == "faint")
            drawn = rows if seen else rows[:0]
            draw_points(self.server.scene, f"/map/{name}", shown.positions[drawn], colours[drawn], size)
            if name == "reachable":
                self.shown = shown.positions[rows], rows, index
        if not (inside & reached).any():
            legend += "<p>Nothing is reachable here. Widen x, y, z, or set <b>not reachable</b> to faint.</p>"
        self.legend.content = f"<div style='padding:0.4em 0.8em;font-size:0.85em'>{legend}</div>"

    def _span(self) -> tuple[list[float], list[float]]:
        """The least and largest coordinates of all variants' positions, rounded outwards to millimetres [m]."""
        given = np.asarray(self.group["position"][:: self.turns])
        shown = [*self.indices.values()][: None if is_in_base(self.group) else 1]  # of targets in the world one map tells all
        placed = np.concatenate([self._placed(given, index) for index in shown])
        low, high = np.floor(1e3 * placed.min(axis=0)), np.ceil(1e3 * placed.max(axis=0))
        return (low / 1e3).tolist(), (np.maximum(high, low + 1.0) / 1e3).tolist()

    def _placed(self, positions: np.ndarray, index: tuple[int, ...]) -> np.ndarray:
        """Positions in the store's frame in the world (p, 3) [m]."""
        mount = base_frame(self.group, index) if is_in_base(self.group) else np.eye(4)
        return positions @ mount[:3, :3].T + mount[:3, 3]

    def _map(self, index: tuple[int, ...]) -> Map:
        shown = variant_map(self.group, index)
        return shown._replace(positions=self._placed(shown.positions, index))

    def _colours(self, shown: Map, inside: np.ndarray, index: tuple[int, ...]) -> tuple[np.ndarray, str]:
        """A colour for each position, and the legend that explains them."""
        import matplotlib

        what = self.colour.value
        if what == KINDS:
            found, kinds = categories(shown)
            counts = np.bincount(found[inside & (found >= 0)], minlength=len(kinds))
            table = np.minimum([*(rgb(colour) for _, colour in kinds), (0, 0, 0)], 190).astype(np.uint8)  # on a white floor
            away = ["", "", *[", hidden" if self.rest.value == "hidden" else ""] * (len(kinds) - 2)]
            rows = zip(kinds, counts, away, strict=True)
            return table[found], swatches({f"{words} ({n:,}{hidden})": c for (words, c), n, hidden in rows if n})
        values = shown.share if what == SHARE else self._best(what, index)
        some = values[inside & np.isfinite(values)]
        low, high = (float(some.min()), float(some.max())) if len(some) else (0.0, 1.0)
        scale = matplotlib.colormaps[SCALE]
        colours = (255 * scale((values - low) / max(high - low, 1e-9))[:, :3]).astype(np.uint8)
        colours[~np.isfinite(values)] = 190
        return colours, bar(what, low, high)

    def _best(self, what: str, index: tuple[int, ...]) -> np.ndarray:
        """The largest value at each position, minus infinity where there is none."""
        every = COLUMNS[what] * np.asarray(self.group[_name(what)][(*index, slice(None))], float).reshape(-1, self.turns)
        return np.where(np.isfinite(every), every, -np.inf).max(axis=1)

    def _clicked(self, event: Any) -> None:
        """The posture at the point under a click: the nearest to the eye of those that its ray passes within a point's size."""
        points, rows, index = self.shown
        eye, along = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        depth = (points - eye) @ along
        aside = np.linalg.norm(points - eye - depth[:, None] * along, axis=1)
        hit = np.flatnonzero((aside <= self.size.value / 1000.0) & (depth > 0.0))
        if len(hit):
            self.posture(int(rows[hit[np.argmin(depth[hit])]]), index)

    def posture(self, position: int, index: tuple[int, ...]) -> None:
        """Shows the posture of the first reachable target at a position, by its number."""
        part = slice(position * self.turns, (position + 1) * self.turns)
        found = np.flatnonzero(self.group["reachable"][(*index, part)])
        if len(found) and self.fits(index):
            q = np.asarray(self.group["q"][(*index, position * self.turns + int(found[0]))])
            self.page.move(q[np.isfinite(q)], base_frame(self.group, index))


def store_of(robot: Robot, store: str | Path) -> Any:
    """The store, if one of its variants is of this robot."""
    group = open_store(store)
    if any(_is_of(group, index, robot) for index in np.ndindex(*group["reason"].shape[:-1])):
        return group
    names = sorted({model.rpartition(" ")[0] for model in group.attrs["models"].values()})
    known = f"another {robot.name}, whose postures do not fit"
    held = known if robot.name in names else f"{', '.join(names)}, not {robot.name}"
    raise ValueError(f"{store}: holds {held}; view the robot (file and tip) that was swept")


def _name(what: str) -> str:
    """The store's column of what points are coloured by."""
    return what.removesuffix(" [mm]").replace(" ", "_")


def _is_of(group: Any, index: tuple[int, ...], robot: Robot) -> bool:
    """Whether a variant's robot is this one: its postures bring this one's tip to their targets. Shapes may differ, such as
    meshes that one of both has not read."""
    attributes, mount = group.attrs, base_frame(group, index)
    name, _, digest = attributes["models"][variant_name(index)].rpartition(" ")
    if name != robot.name or attributes["joint_names"][name] != list(robot.joint_names):
        return False
    found = np.flatnonzero(group["reachable"][(*index, slice(None))])[:1]
    if robot.mounted(mount).digest.startswith(digest) or not len(found):
        return True
    row = int(found[0])
    pose = as_frames(np.concatenate([group["position"][row], group["quaternion"][row]])[None])[0]
    if not is_in_base(group):
        pose = np.linalg.inv(mount) @ pose
    q = np.asarray(group["q"][(*index, row)])
    away, turned = pose_errors(robot, q[np.isfinite(q)].tolist(), pose.ravel().tolist())
    return bool(away < 1e-3 and not turned > 1e-2)  # NaN where the rotation is free

"""Octrees of what is occupied and free, as OctoMap writes them [Hornung et al. 2013], as a grid of voxels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxik.checks.options import optional
from jaxik.files.documents import opened
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame

if TYPE_CHECKING:  # files are read by all, and most of them hold no voxels
    from jaxik.sensing.occupancy import Occupancy

BEGINS = b"# Octomap OcTree binary file"
BYTES = 2**28


def load_octomap(path: str | Path) -> Occupancy:
    """The voxels of OctoMap's binary file, `.bt`, as a grid around all that it knows; what it does not know is unseen. Host.

    The finest leaves are the voxels; a larger leaf is as many of them. Whether a voxel is free is said as surely as it was when
    the tree was made: OctoMap takes a voxel for free once enough rays went through any part of it, where `Occupancy.with_depth`
    asks that all of it was seen. Needs pyoctomap, `pip install "jaxik[octomap]"`.

    Raises `LoadError` (a `ValueError`) with one line: the file, what is wrong, what is allowed, the mend.
    """
    path = Path(path)
    if path.suffix.lower() != ".bt":
        raise LoadError(path, "file", f"ending '{path.suffix}'", "allowed: .bt, as octomap's writeBinary has it")
    with opened(path, BYTES) as file:
        if not file.read(len(BEGINS)) == BEGINS:
            raise LoadError(path, "document", "is no binary OcTree", f"its first line is '{BEGINS.decode()}'")
    tree: Any = optional("load_octomap", "pyoctomap", "octomap").OcTree(1.0)
    if not tree.readBinary(str(path)) or not tree.size():
        raise LoadError(path, "document", "holds no voxel, or ends too early", "write it anew with octomap's writeBinary")
    edge, middle = float(tree.getResolution()), []
    for leaf in tree.begin_leafs():
        middle.append((*leaf.getCoordinate(), leaf.getSize(), tree.isNodeOccupied(leaf)))
    return _grid(path, edge, np.array(middle))


def _grid(path: Path, edge: float, leaves: np.ndarray) -> Occupancy:
    """The grid of leaves (k, 5): their middles and edges [m], and whether they are occupied."""
    from jaxik.fields.distance_field import MOST
    from jaxik.sensing.occupancy import FREE, OCCUPIED, Occupancy

    across = np.round(leaves[:, 3] / edge).astype(int)
    first = np.round((leaves[:, :3] - leaves[:, 3:4] / 2.0) / edge).astype(int)
    low, high = first.min(axis=0), (first + across[:, None]).max(axis=0)
    if np.prod(counts := high - low, dtype=float) > MOST:
        told = f"{' x '.join(map(str, counts))} voxels of {edge:g} m around all leaves"
        raise LoadError(path, "document", told, f"at most {MOST:,}: write it with a coarser resolution, or cut it")
    state, first = np.zeros(counts, np.uint8), first - low
    kinds = np.where(leaves[:, 4] > 0.0, np.uint8(OCCUPIED), np.uint8(FREE))
    fine = across == 1  # most of them
    state[tuple(first[fine].T)] = kinds[fine]
    for at, width, kind in zip(first[~fine], across[~fine], kinds[~fine], strict=True):
        state[tuple(slice(a, a + width) for a in at)] = kind
    return Occupancy(state, frame(edge * (low + 0.5)), edge)

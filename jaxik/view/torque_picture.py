"""The picture of what a motion takes of the joints (matplotlib, no window needed)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxik.robot.chain import Chain


def torque_picture(chain: Chain, time: np.ndarray, torque: np.ndarray, holding: np.ndarray, file: Path) -> None:
    """A row a joint: its torque (i, n) [Nm, N] over `time` (i,) [s], and what would hold the arm at rest there."""
    from matplotlib.figure import Figure

    n = chain.num_joints
    figure = Figure(figsize=(8.0, 0.6 + 1.1 * n), layout="constrained")
    axes = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    for i, (name, slides, axis) in enumerate(zip(chain.joint_names, chain.is_prismatic, axes, strict=True)):
        axis.axhline(0.0, color="0.8", linewidth=0.8)
        axis.plot(time, holding[:, i], color="0.55", linewidth=1.0, linestyle="--", label="holding the arm at rest")
        axis.plot(time, torque[:, i], color="tab:blue", linewidth=1.4, label="in motion")
        axis.set_ylabel(f"{name}\n[{'N' if slides else 'Nm'}]", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[-1].set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    figure.savefig(file, dpi=120)

"""Figures 3.11, 3.12, 3.17 to 3.19, B.2 to B.5 and table 3.10 of Schütz 2017, from what `torque_estimation.py` found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from setups.torque_logs import CREEP, ELBOW, JUDGED, MEASUREMENTS, WIDTH, friction_band, log, model

from jaxik.dynamics import inverse_dynamics, motor_current
from jaxik.estimation import Played, TorqueEstimator, estimate

JOINTS = np.arange(2, 9)


def draw(file: Path, result: dict[str, Any], name: str, estimator: TorqueEstimator) -> None:
    """All of them; the errors of T_ext are those of the estimator of that `name`."""
    figure, axes = plt.subplots(2, 4, figsize=(19, 8), layout="constrained")
    nominal, rmse = np.array(result["nominal_torque"]), result["rmse"]
    currents(axes[0, 0], 6, "fig. 3.11 in kind: joint 6, nothing touches")
    _bars(axes[0, 1], rmse["inverse dynamics"], nominal, "fig. 3.12 in kind: error of inverse dynamics", gauged=False)
    _covariances(axes[0, 2], result["sweep"])
    _levers(axes[0, 3], result["detection"]["rows"])
    for ax, (joint, measurement) in zip(axes[1, :3], ((2, 6), (3, 7), (6, 6)), strict=True):
        external(ax, estimator, joint, measurement)
    _bars(axes[1, 3], rmse[name], nominal, "fig. 3.19 in kind: error of T_ext", gauged=True)
    of_model = 100 * np.nanmean(rmse["inverse dynamics"], axis=0) / nominal
    axes[1, 3].plot(JOINTS, of_model, "k_", markersize=16, label="inverse dynamics alone")
    for ax in (axes[0, 1], axes[1, 3]):
        ax.legend(fontsize=8, loc="upper left", ncol=2)
    figure.savefig(file, dpi=90)


def draw_joints(file: Path, estimator: TorqueEstimator) -> None:
    """Figures B.2 to B.4, the model of all joints that turn, and B.5, the external torque of joints 4 and 5."""
    figure, axes = plt.subplots(2, 5, figsize=(24, 8.5), layout="constrained")
    for ax, joint in zip(axes[:, :4].flat, range(2, 10), strict=True):
        number = 2 + np.searchsorted([4, 7], joint, side="right")
        currents(ax, joint, f"fig. B.{number} in kind: joint {joint}")
    for ax, joint, measurement in zip(axes[:, 4], (4, 5), (7, 7), strict=True):
        external(ax, estimator, joint, measurement, "fig. B.5 in kind")
    figure.savefig(file, dpi=70)


def currents(ax: Any, joint: int, title: str) -> None:
    """A joint's motor current beside what the model foretells, as torques, where nothing touches."""
    seen = log(JUDGED[0], False, 0 if joint != 3 else 1)
    asked, joint = seen.asked, joint - 1
    drive = model().drives[joint]
    inside = jax.jit(jax.vmap(lambda *x: motor_current(model(), inverse_dynamics(model(), *x), x[1], width=WIDTH)))
    gain = float(drive.torque_per_current)
    told = gain * np.asarray(inside(*asked.state))[:, joint]
    measured = gain * asked.current[:, joint]
    ax.plot(asked.time, measured, "0.3", linewidth=0.6, label="motor current")
    ax.plot(asked.time, told, label="model")
    _shade(ax, seen, joint, 0.0)
    low, high = np.percentile(np.r_[told, measured, 0.0], [0.2, 99.8])  # without the spikes where a joint breaks away
    room = 0.15 * (high - low)
    ax.set(title=title, ylabel="torque [Nm]", xlabel="time [s]", ylim=(low - room, high + 2.0 * room))
    _rate(ax, seen, joint)
    ax.legend(fontsize=8, ncol=2, loc="upper left")


def _rate(ax: Any, seen: Played, joint: int) -> None:
    """The rate asked of a joint, from 0, on an axis of its own."""
    rate = ax.twinx()
    rate.plot(seen.asked.time, seen.asked.velocity[:, joint], color="tab:green", linewidth=0.8)
    rate.set_ylabel("rate asked for [rad/s]", color="tab:green")


def _bars(ax: Any, rows: Any, nominal: np.ndarray, title: str, gauged: bool) -> None:
    """Root mean squares (4, 7) [Nm] of the measurements, a group of bars a joint."""
    for i, (row, (speed, spring)) in enumerate(zip(np.array(rows), MEASUREMENTS, strict=True)):
        label, colour = f"{speed:g} rad/s" + (f", {spring:g} N/m" if gauged else ""), plt.get_cmap("Blues")(0.35 + 0.18 * i)
        ax.bar(JOINTS + 0.2 * (i - 1.5), 100 * row / nominal, 0.2, color=colour, label=label)
    ax.set(title=title, xlabel="joint", ylabel="root mean square / nominal torque [%]", xticks=JOINTS)
    ax.axhline(5.0, color="0.4", linestyle=":", linewidth=1)
    ax.margins(y=0.35)


def _covariances(ax: Any, swept: dict[str, Any]) -> None:
    torsion, current, joint = swept["torsion_noise"], swept["current_noise"], 5
    mesh = ax.pcolormesh(torsion, current, swept["rmse_joint_6"], shading="nearest", cmap="viridis_r")
    best = swept["best_torsion_noise"][joint], swept["best_current_noise"][joint]
    ax.plot(*best, "*", color="tab:orange", markersize=14)
    ax.set(xscale="log", yscale="log", xlabel="$R_\\phi$ [rad$^2$]", ylabel="$R_I$ [A$^2$]", title="fig. 3.17 in kind: joint 6")
    ax.figure.colorbar(mesh, ax=ax, label="root mean square error [Nm]")


def _levers(ax: Any, rows: list[dict[str, Any]]) -> None:
    kinds = {
        "tactile sensor, 2 N": [row["tactile_nm"] for row in rows],
        "thesis, from motor currents": [row["thesis_nm"] for row in rows],
        "mean error of the estimate here": [row["error_nm"] for row in rows],
        "threshold here (mean of arms)": [np.mean(row["threshold_nm"]) for row in rows],
        "least push always found here": [row["least_torque_found_nm"] for row in rows],
    }
    joints = np.array([row["joint"] for row in rows])
    for i, (label, values) in enumerate(kinds.items()):
        ax.bar(joints + 0.17 * (i - 2), values, 0.17, label=label)
    ax.set(title="table 3.10 in kind", xlabel="joint", ylabel="torque [Nm]", xticks=joints)
    ax.margins(y=0.75)
    ax.legend(fontsize=8, loc="upper left")


def external(ax: Any, estimator: TorqueEstimator, joint: int, measurement: int, figure: str = "fig. 3.18 in kind") -> None:
    """The torque that the gauge exerts, the estimate of it, and how fast the joint was to move."""
    seen, way = log(JUDGED[0], True, measurement), "vertical" if measurement % 2 else "horizontal"
    ax.plot(seen.asked.time, seen.asked.external[:, joint - 1], "k", label="gauge")
    ax.plot(seen.asked.time, estimate(estimator, seen.asked)[:, joint - 1], color="tab:blue", label="estimate")
    _shade(ax, seen, joint - 1, seen.asked.external[:, joint - 1])
    ax.set(title=f"{figure}: joint {joint}, {way}", ylabel="external torque [Nm]", xlabel="time [s]")
    _rate(ax, seen, joint - 1)
    ax.margins(y=0.15)
    ax.legend(fontsize=8, loc="upper center" if joint != 3 else "lower right")


def _shade(ax: Any, seen: Played, joint: int, around: Any) -> None:
    """Grey where the joint, from 0, is near zero velocity; darker, `around` a torque [Nm], the friction's band there."""
    slow, band = np.abs(seen.asked.velocity[:, joint]) < CREEP, friction_band(np.array(ELBOW))[joint]
    ax.fill_between(seen.asked.time, 0, 1, where=slow, color="0.92", transform=ax.get_xaxis_transform(), linewidth=0)
    ax.fill_between(seen.asked.time, around - band, around + band, where=slow, color="0.75", linewidth=0)

"""Figures 3.11, 3.12, 3.17 to 3.19 and table 3.10 of Schütz 2017 in kind: `python batch_eval/torque_estimation.py`.

Writes `torque_estimation.json` and `.png` beside itself. The plant is MuJoCo's. The estimator knows the arm as `crops_v2` tells
it; the arms that move are others: masses, centres of gravity, friction, torque constants and stiffness differ by a draw for
each number (`OFF`), and the sensors are no better than `SENSORS`. Neither is printed, nor are the thesis' trajectories and
covariances, so all of these are stand-ins, as are the nominal torques of the model file: what is compared is the kind of
result, not digits.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import time
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from race import machine

import jaxik
from jaxik.control import (
    EstimationLoop,
    Instruments,
    MomentumObserver,
    Push,
    Sample,
    SimulatedLog,
    TorqueEstimator,
    TorqueFilter,
    detect,
    estimate,
    fit_detector,
    judge_alarms,
    over_log,
    play,
)
from jaxik.planning import Trajectory, quintic

DT, ARMS = 1e-3, 7
OFF = {"mass": 0.03, "com_m": 0.003, "friction": 0.1, "torque_constant": 0.02, "stiffness": 0.08}  # standard deviations
SENSORS = Instruments(
    current_noise=0.05,  # [A]
    current_step=0.01,
    torsion_noise=2e-5,  # [rad]
    torsion_step=2.4e-5,  # an encoder of 18 bits
    torsion_play=1.45e-4,  # half of an angular minute, a catalogue's hysteresis loss
    position_step=1e-5,
    window=10,
)
CREEP = 0.02  # [rad/s, m/s]: slower is near zero, where the thesis draws its grey areas
SHOWN = range(1, 8)  # joints 2 to 8, as in the thesis: hardly any load comes to joint 9, and the slide stands still
WIDTH = 0.005  # [rad/s, m/s] of the sign of friction, well below that
ELBOW = [0.5, 0.0, 0.5, 0.9, 0.3, 0.1, 0.4, 0.2, 0.1]
STRETCHED = np.array([0.5, 0.0, 0.0, 0.0, 0.3, 0.1, 0.4, 0.2, 0.1])
MEASUREMENTS = ((0.15, 60.0), (0.3, 60.0), (0.15, 150.0), (0.3, 150.0))  # fastest joint [rad/s], the gauge's spring [N/m]
LEVERS = {2: 0.51, 3: 0.51, 4: 0.16}  # table 3.10 [m]
PRINTED = {2: 3.0, 3: 7.0, 4: 8.0}  # [Nm]
FORCES = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0)  # [N]
BEST = "filter, current and torsion"
PROCESS = 0.05  # Q [Nm2 a sample]; the covariances are swept against it


@functools.cache
def model() -> jaxik.Chain:
    """What the estimator knows."""
    return jaxik.load("crops_v2")


@functools.cache
def arms() -> list[jaxik.Chain]:
    return [another(np.random.default_rng(seed)) for seed in range(ARMS)]


def another(rng: np.random.Generator) -> jaxik.Chain:
    """An arm of the same make: each number is off by its own draw."""
    near = lambda x, by: x * (1.0 + by * rng.standard_normal(np.shape(x)))
    bodies, drives = [], []
    for body in model().bodies:
        share = near(1.0, OFF["mass"])
        com = body.com + OFF["com_m"] * rng.standard_normal(3)
        bodies.append(dataclasses.replace(body, mass=share * body.mass, com=com, inertia=share * body.inertia))
    for drive in model().drives:
        names = ("coulomb", "breakaway", "load", "viscous", "viscous_load", "correction")
        friction = dataclasses.replace(drive.friction, **{k: near(getattr(drive.friction, k), OFF["friction"]) for k in names})
        own = {k: near(getattr(drive, k), OFF[k]) for k in ("torque_constant", "stiffness")}
        drives.append(dataclasses.replace(drive, friction=friction, **own))
    return dataclasses.replace(model(), bodies=tuple(bodies)).with_drives(drives)


def there_and_back(direction: tuple[float, float, float], speed: float) -> list[Trajectory]:
    """The TCP along 30 cm of a straight line, to its end and back, the fastest joint at `speed` [rad/s]."""
    held = dataclasses.replace(model(), lower=np.r_[ELBOW[0], model().lower[1:]], upper=np.r_[ELBOW[0], model().upper[1:]])
    start = np.asarray(jaxik.forward_kinematics(held, np.array(ELBOW)))
    end = start.copy()
    end[:3, 3] += 0.3 * np.array(direction)
    moved = jaxik.follow(held, jaxik.motions.Line(start, end), 2.0, ELBOW, dt=0.02)
    q = np.asarray(moved.q)[np.linspace(0, len(moved.q) - 1, 7).astype(int)]
    limits = {"velocity": speed, "acceleration": 4.0 * speed}
    return [quintic(q, **limits), quintic(q[::-1], **limits)]


def gauge(direction: tuple[float, float, float], stiffness: float) -> Push:
    """A spring from where the TCP begins to a force gauge, along the line."""
    line = np.array(direction)
    begin = np.asarray(jaxik.forward_kinematics(model(), np.array(ELBOW)))[:3, 3]
    return Push("body9", [0.0, 0.0, 0.013], lambda t, point: -stiffness * ((point - begin) @ line) * line)


def known(process: float = PROCESS, current: float = 0.05**2, torsion: float = np.inf) -> TorqueFilter:
    """The filter; covariances of the sensors in A^2 and rad^2."""
    return TorqueFilter.of_drives(model(), process, current, torsion)


def rmse(errors: np.ndarray, log: SimulatedLog) -> list[float]:
    """Root mean squares [Nm] of joints 2 to 8, each where it moves; NaN where one does not."""
    moves = np.abs(log.qdot_des) > CREEP
    return [float(np.sqrt(np.mean(errors[moves[:, i], i] ** 2))) if moves[:, i].any() else np.nan for i in SHOWN]


@functools.cache
def logs(arm: int, pushed: bool) -> list[SimulatedLog]:
    """Of the four measurements, along a horizontal line and along a vertical one; with the gauge, or free."""
    found = []
    for seed, (speed, stiffness) in enumerate(MEASUREMENTS):
        for direction in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
            contacts = [gauge(direction, stiffness)] if pushed else []
            motions = there_and_back(direction, speed)
            how = {"model": model(), "instruments": SENSORS, "rest": (0.4, 0.4), "seed": 10 * arm + seed}
            found.append(play(arms()[arm], motions, contacts, **how))
    return found


def in_pairs(errors: list[list[float]]) -> list[list[float]]:
    """The root mean squares (4, 7) of both directions together."""
    return np.sqrt(np.nanmean(np.square(errors).reshape(len(MEASUREMENTS), 2, -1), axis=1)).tolist()


def sweep() -> dict[str, Any]:
    """Fig. 3.17 of all joints at once, on the first arm's logs: a filter for each pair of covariances, one vmap over them."""
    current, torsion = np.geomspace(1e-4, 1e2, 19), np.geomspace(1e-12, 1e-4, 17)
    pairs = np.stack(np.meshgrid(current, torsion, indexing="ij"), axis=-1).reshape(-1, 2)
    basis, n = known(torsion=1.0), model().num_joints

    @jax.jit
    def squares(sensed: Any, external: Any, moves: Any) -> Any:
        def one(pair: Any) -> Any:
            filter = dataclasses.replace(basis, current_noise=pair[0] * np.ones(n), torsion_noise=pair[1] * np.ones(n))
            off = over_log(TorqueEstimator(model(), filter), sensed) - external
            return (moves * off**2).sum(axis=0)

        return jax.vmap(one)(pairs)

    total, count, seconds = np.zeros((len(pairs), n)), np.zeros(n), 0.0
    sense = jax.jit(jax.vmap(TorqueEstimator(model(), basis, width=WIDTH).sense))
    for log in logs(0, True):
        moves = np.abs(log.qdot_des) > CREEP
        sensed = sense(log.samples())
        begin = time.perf_counter()
        total, count = total + np.asarray(squares(sensed, log.external, moves)), count + moves.sum(axis=0)
        seconds += time.perf_counter() - begin
    found = np.sqrt(total / np.maximum(count, 1)).reshape(len(current), len(torsion), n)
    best = [np.unravel_index(np.argmin(found[..., i]), found.shape[:2]) for i in range(n)]
    return {
        "current_noise": current.tolist(),
        "torsion_noise": torsion.tolist(),
        "rmse_joint_6": found[..., 5].tolist(),
        "best_current_noise": [float(current[i]) for i, _ in best],
        "best_torsion_noise": [float(torsion[j]) for _, j in best],
        "by_current_alone": found.min(axis=0)[-1].tolist(),
        "by_torsion_alone": found.min(axis=1)[-1].tolist(),
        "best": found.min(axis=(0, 1)).tolist(),
        "filters": len(pairs),
        "seconds_with_compiling": seconds,
    }


def estimators(swept: dict[str, Any]) -> dict[str, Any]:
    """Those that are compared."""
    fused = known(PROCESS, np.array(swept["best_current_noise"]), np.array(swept["best_torsion_noise"]))
    bare = lambda friction: dataclasses.replace(friction, correction=np.zeros(2))  # without table 3.6
    drives = [dataclasses.replace(d, friction=bare(d.friction)) for d in model().drives]
    return {
        BEST: TorqueEstimator(model(), fused, width=WIDTH),
        "filter, current alone": TorqueEstimator(model(), known(PROCESS, np.array(swept["best_current_noise"])), width=WIDTH),
        "the same, friction without its corrections": TorqueEstimator(model().with_drives(drives), known(), width=WIDTH),
        "momentum observer": MomentumObserver(model(), 20.0, DT, width=WIDTH),
    }


def shown(estimator: Any, log: SimulatedLog) -> Sample:
    """The momentum is that of the measured motion."""
    return log.samples(desired=not isinstance(estimator, MomentumObserver))


def errors(named: dict[str, Any]) -> dict[str, Any]:
    """Figs. 3.12 and 3.19: of the model, of T_ext by each estimator; mean over the arms but the first, (4, 7) each."""
    whole = known(1e12)  # a gain of 1: the model's error itself
    rows = {"inverse dynamics": (TorqueEstimator(model(), whole, width=WIDTH), False)}
    rows |= {name: (estimator, True) for name, estimator in named.items()}
    found = {}
    for name, (estimator, pushed) in rows.items():
        of_arms = []
        for arm in range(1, ARMS):
            each = [rmse(estimate(estimator, shown(estimator, log)) - log.external, log) for log in logs(arm, pushed)]
            of_arms.append(in_pairs(each))
        found[name] = np.nanmean(of_arms, axis=0).tolist()
        print(f"{name:45s}", np.round(np.nanmean(of_arms, axis=(0, 1)), 2))
    found["gauge, the torque itself"] = in_pairs([rmse(log.external, log) for log in logs(1, True)])
    return found


def friction_band(q: np.ndarray) -> np.ndarray:
    """What static friction hides (n,) [Nm, N] where the arm is held at q; it grows with what the gears carry."""
    return np.asarray(jaxik.robot.static_friction(model(), jaxik.robot.gravity_torque(model(), q)))


def swing(speed: float) -> list[Trajectory]:
    """About the stretched posture, in which table 3.10's levers are the longest."""
    away = np.array([0.0, 0.5, 0.35, 0.35, 0.2, 0.1, 0.1, 0.1, 0.1])
    return [quintic([STRETCHED - away, STRETCHED, STRETCHED + away], velocity=speed, acceleration=4.0 * speed)]


def detection(estimator: TorqueEstimator) -> dict[str, Any]:
    """Table 3.10: thresholds from free logs, false alarms on others, and the least force on link 4 that is always found."""
    at = [0.16, 0.0, -0.03]
    how = {"model": model(), "instruments": SENSORS, "rest": (0.2, 0.2)}
    free = lambda arm, speed, seed: play(arms()[arm], swing(speed), **how, seed=seed)
    memory = int(3.0 / estimator.filter.gain.min())
    thresholds, false, free_time = [], [], 0.0
    pushes: dict[int, dict[float, list[float]]] = {joint: {f: [] for f in FORCES} for joint in LEVERS}
    for arm in range(1, ARMS):
        fitting = [free(arm, speed, seed) for seed, speed in enumerate((0.15, 0.3, 0.6))]
        band = 1.2 * friction_band(STRETCHED)
        known_free = [
            np.concatenate(x) for x in zip(*((estimate(estimator, g.samples()), g.qdot_des) for g in fitting), strict=True)
        ]
        moving = np.where(np.arange(9) == 0, 0.0, CREEP)  # the slide stands still throughout
        detector = fit_detector(*known_free, band, moving, memory)
        thresholds.append(detector.threshold)
        for seed, speed in enumerate((0.2, 0.45)):
            log = free(arm, speed, 100 + seed)
            alarms = detect(detector, estimate(estimator, log.samples()), log.qdot_des)
            false.append([judge_alarms(alarms[:, j - 1], np.zeros(len(alarms), bool), DT).false_alarms for j in LEVERS])
            free_time += judge_alarms(alarms[:, 0], np.zeros(len(alarms), bool), DT).free_time
        for joint in LEVERS:
            for force in FORCES:
                vector = np.array([force, 0.0, 0.0] if joint == 2 else [0.0, 0.0, -force])
                onset = 0.2 + 0.5 * float(swing(0.3)[0].duration)
                log = play(arms()[arm], swing(0.3), [Push("body4", at, vector, onset, onset + 0.5)], **how, seed=7)
                contact = (log.t >= onset) & (log.t < onset + 0.5)
                alarms = detect(detector, estimate(estimator, log.samples()), log.qdot_des)[:, joint - 1]
                pushes[joint][force] += judge_alarms(alarms, contact, DT).delay.tolist()
    rows = []
    for k, (joint, lever) in enumerate(LEVERS.items()):
        found = [force for force in FORCES if not np.isnan(pushes[joint][force]).any()]
        least = min(found, default=np.nan)
        rows.append(
            {
                "joint": joint,
                "lever_m": lever,
                "tactile_nm": 2.0 * lever,
                "thesis_nm": PRINTED[joint],
                "threshold_nm": [float(t[joint - 1]) for t in thresholds],
                "least_force_found_n": least,
                "least_torque_found_nm": least * lever,
                "delay_s": float(np.median(pushes[joint][least])) if found else None,
                "found": {f"{force:g}": float(np.mean(~np.isnan(d))) for force, d in pushes[joint].items()},
                "false_alarms": int(np.sum([f[k] for f in false])),
            }
        )
        print(rows[-1])
    return {"rows": rows, "free_s": free_time, "memory_samples": memory}


def step_times(named: dict[str, Any]) -> dict[str, Any]:
    """How long a step of the control loop takes [us], samples in, external torques out."""
    log, found = logs(1, True)[0], {}
    for name in (BEST, "momentum observer"):
        samples = [Sample(*(x[k] for x in log.samples())) for k in range(4000)]
        loop = EstimationLoop(named[name])
        state, times = loop.start(samples[0]), []
        for sample in samples:
            begin = time.perf_counter()
            state = loop.step(state, sample)
            times.append(1e6 * (time.perf_counter() - begin))
        found[name] = {"p50_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99))}
    return found


def shade(ax: Any, log: SimulatedLog, joint: int, band: float | None = None, around: Any = 0.0) -> None:
    """Grey where the joint is near zero velocity, darker the friction's band there."""
    slow = np.abs(log.qdot_des[:, joint]) < CREEP
    ax.fill_between(log.t, 0, 1, where=slow, color="0.92", transform=ax.get_xaxis_transform(), linewidth=0)
    if band is not None:
        ax.fill_between(log.t, around - band, around + band, where=slow, color="0.75", linewidth=0)


def draw(file: Path, result: dict[str, Any], named: dict[str, Any]) -> None:
    """The figures, redrawn."""
    figure, axes = plt.subplots(2, 4, figsize=(19, 8), layout="constrained")
    nominal, joints = np.array(result["nominal_torque"]), np.arange(2, 9)
    band = friction_band(np.array(ELBOW))
    both = named[BEST]

    ax, log = axes[0, 0], logs(1, False)[0]
    gain = np.array([float(d.ratio * d.torque_constant) for d in model().drives])
    inside = jax.jit(
        jax.vmap(lambda *x: jaxik.robot.motor_current(model(), jaxik.robot.inverse_dynamics(model(), *x), x[1], WIDTH))
    )
    ax.plot(log.t, gain[5] * log.current[:, 5], "0.3", linewidth=0.6, label="motor current")
    ax.plot(log.t, gain[5] * np.asarray(inside(log.q_des, log.qdot_des, log.qddot_des))[:, 5], label="model")
    shade(ax, log, 5, band[5])
    ax.set(title="fig. 3.11 in kind: joint 6, nothing touches", ylabel="torque [Nm]", xlabel="time [s]", ylim=(-8, 9))
    ax.legend(fontsize=8, ncol=2)

    def bars(ax: Any, rows: Any, title: str) -> None:
        for i, row in enumerate(np.array(rows)):
            speed, spring = MEASUREMENTS[i]
            label = f"{speed:g} rad/s" + (f", {spring:g} N/m" if "T_ext" in title else "")
            ax.bar(
                joints + 0.2 * (i - 1.5),
                100 * row / nominal,
                0.2,
                color=plt.get_cmap("Blues")(0.35 + 0.18 * i),
                label=label,
            )
        ax.set(title=title, xlabel="joint", ylabel="root mean square / nominal torque [%]", xticks=joints)
        ax.axhline(5.0, color="0.4", linestyle=":", linewidth=1)
        ax.margins(y=0.35)

    bars(axes[0, 1], result["rmse"]["inverse dynamics"], "fig. 3.12 in kind: error of inverse dynamics")
    bars(axes[1, 3], result["rmse"][BEST], "fig. 3.19 in kind: error of T_ext")
    model_only = np.nanmean(result["rmse"]["inverse dynamics"], axis=0)
    axes[1, 3].plot(joints, 100 * model_only / nominal, "k_", markersize=16, label="inverse dynamics alone")
    for ax in (axes[0, 1], axes[1, 3]):
        ax.legend(fontsize=8, loc="upper left", ncol=2)

    ax, swept = axes[0, 2], result["sweep"]
    mesh = ax.pcolormesh(
        swept["torsion_noise"], swept["current_noise"], swept["rmse_joint_6"], shading="nearest", cmap="viridis_r"
    )
    ax.plot(swept["best_torsion_noise"][5], swept["best_current_noise"][5], "*", color="tab:orange", markersize=14)
    ax.set(xscale="log", yscale="log", xlabel="$R_\\phi$ [rad$^2$]", ylabel="$R_I$ [A$^2$]", title="fig. 3.17 in kind: joint 6")
    figure.colorbar(mesh, ax=ax, label="root mean square error [Nm]")

    ax, rows = axes[0, 3], result["detection"]["rows"]
    kinds = {
        "tactile sensor, 2 N": [row["tactile_nm"] for row in rows],
        "thesis, from motor currents": [row["thesis_nm"] for row in rows],
        "threshold here (mean of arms)": [np.mean(row["threshold_nm"]) for row in rows],
        "least push always found here": [row["least_torque_found_nm"] for row in rows],
    }
    for i, (label, values) in enumerate(kinds.items()):
        ax.bar(np.array(list(LEVERS)) + 0.2 * (i - 1.5), values, 0.2, label=label)
    ax.set(title="table 3.10 in kind", xlabel="joint", ylabel="torque [Nm]", xticks=list(LEVERS))
    ax.margins(y=0.35)
    ax.legend(fontsize=8, loc="upper left")

    for ax, (joint, which) in zip(axes[1, :3], ((2, 6), (3, 7), (6, 6)), strict=True):
        log = logs(1, True)[which]
        ax.plot(log.t, log.external[:, joint - 1], "k", label="gauge")
        ax.plot(log.t, estimate(both, log.samples())[:, joint - 1], color="tab:blue", label="estimate")
        shade(ax, log, joint - 1, band[joint - 1], log.external[:, joint - 1])
        way = "horizontal" if which % 2 == 0 else "vertical"
        ax.set(title=f"fig. 3.18 in kind: joint {joint}, {way}", ylabel="external torque [Nm]", xlabel="time [s]")
        rate = ax.twinx()
        rate.plot(log.t, log.qdot_des[:, joint - 1], color="tab:green", linewidth=0.8)
        rate.set_ylabel("rate asked for [rad/s]", color="tab:green")
        ax.margins(y=0.15)
        ax.legend(fontsize=8, loc="upper center" if joint != 3 else "lower right")
    figure.savefig(file, dpi=90)


def main() -> None:
    """All of them; prints, and writes JSON and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    swept = sweep()
    named = estimators(swept)
    result = {
        "machine": machine(),
        "arms": ARMS - 1,
        "off": OFF,
        "sensors": dataclasses.asdict(SENSORS),
        "measurements": MEASUREMENTS,
        "nominal_torque": [float(model().drives[i].nominal_torque) for i in SHOWN],
        "sweep": swept,
        "rmse": errors(named),
        "detection": detection(named[BEST]),
        "step": step_times(named),
    }
    draw(out.with_suffix(".png"), result, named)
    out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Figures 3.11, 3.12, 3.17 to 3.19, B.2 to B.5 and table 3.10 of Schütz 2017 in kind: `python batch_eval/torque_estimation.py`.

Writes `torque_estimation.json`, `.png` and `_joints.png` beside itself. The plant is MuJoCo's. The estimator knows the arm as
`crops_v2` tells it; the arms that move are others: masses, centres of gravity, friction, torque constants and stiffness differ
by a draw for each number (`OFF`), and the sensors are no better than `SENSORS`. Neither is printed, nor are the thesis'
trajectories and covariances, so all of these are stand-ins, as are the nominal torques of the model file: what is compared is
the kind of result, not digits.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from papers.alarms import Judged, judge_alarms
from race import counted, machine, steps
from setups.torque_logs import CREEP, DT, JUDGED, MEASUREMENTS, OFF, SENSORS, TUNED, WIDTH, arms, friction_band, logs, model
from torque_pictures import draw, draw_joints

from jaxik.estimation import (
    Detector,
    MomentumObserver,
    Played,
    Push,
    TorqueEstimator,
    TorqueFilter,
    estimate,
    fit_detector,
    play,
)
from jaxik.kinematics import Motion
from jaxik.planning import Trajectory, time_path
from jaxik.spmd import ControlLoop

SHOWN = range(1, 8)  # joints 2 to 8, as in the thesis: hardly any load comes to joint 9, and the slide stands still
STRETCHED = np.array([0.5, 0.0, 0.0, 0.0, 0.3, 0.1, 0.4, 0.2, 0.1])
LEVERS = {2: 0.51, 3: 0.51, 4: 0.16}  # table 3.10 [m]
PRINTED = {2: 3.0, 3: 7.0, 4: 8.0}  # table 3.10: measurable by the estimation of torques [Nm]
TEXT = {  # of sections 3.2.4 and 3.3.3: mean errors below, as shares of nominal torque
    "fig_3_12_joints_2_to_6_share": 0.05,
    "fig_3_12_joints_7_to_9_share": 0.1,
    "fig_3_19_joints_2_to_6_and_8_share": 0.05,
    "fig_3_19_joint_7_share": 0.08,
    "table_3_10_nm": list(PRINTED.values()),
    "table_3_10_tactile_nm": [1.02, 1.02, 0.32],
}
FORCES = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0)  # [N]
BEST = "filter, current and torsion"
PROCESS = 0.05  # Q [Nm2 a sample]; the covariances are swept against it


def known(process: float = PROCESS, current: float = 0.05**2, torsion: float = np.inf) -> TorqueFilter:
    """The filter; covariances of the sensors in A^2 and rad^2."""
    return TorqueFilter.of_drives(model(), process, current, torsion_noise=torsion)


def rmse(errors: np.ndarray, log: Played) -> list[float]:
    """Root mean squares [Nm] of joints 2 to 8, each where it moves; NaN where one does not."""
    moves = np.abs(log.asked.velocity) > CREEP
    return [float(np.sqrt(np.mean(errors[moves[:, i], i] ** 2))) if moves[:, i].any() else np.nan for i in SHOWN]


def in_pairs(errors: list[list[float]]) -> list[list[float]]:
    """The root mean squares (4, 7) of both directions together."""
    return np.sqrt(np.nanmean(np.square(errors).reshape(len(MEASUREMENTS), 2, -1), axis=1)).tolist()


def sweep() -> dict[str, Any]:
    """Fig. 3.17 of all joints at once, on the logs of `TUNED`: a filter for each pair of covariances, one vmap over
    them."""
    current, torsion = np.geomspace(1e-4, 1e2, 19), np.geomspace(1e-12, 1e-4, 17)
    pairs = np.stack(np.meshgrid(current, torsion, indexing="ij"), axis=-1).reshape(-1, 2)
    basis, n = known(torsion=1.0), model().num_joints

    @jax.jit
    def squares(sensed: Any, external: Any, moves: Any) -> Any:
        def one(pair: Any) -> Any:
            filter = dataclasses.replace(basis, current_noise=pair[0] * np.ones(n), torsion_noise=pair[1] * np.ones(n))
            off = TorqueEstimator(model(), filter).over(sensed) - external
            return (moves * off**2).sum(axis=0)

        return jax.vmap(one)(pairs)

    total, count, seconds = np.zeros((len(pairs), n)), np.zeros(n), 0.0
    sense = jax.jit(jax.vmap(TorqueEstimator(model(), basis, width=WIDTH).sense))
    for log in (log for arm in TUNED for log in logs(arm, True)):
        moves = np.abs(log.asked.velocity) > CREEP
        sensed = sense(log.asked)
        begin = time.perf_counter()
        total, count = total + np.asarray(squares(sensed, log.asked.external, moves)), count + moves.sum(axis=0)
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
    """The estimators that are compared."""
    fused = known(PROCESS, np.array(swept["best_current_noise"]), np.array(swept["best_torsion_noise"]))
    bare = lambda friction: dataclasses.replace(friction, correction=np.zeros(2))  # without table 3.6
    drives = [dataclasses.replace(d, friction=bare(d.friction)) for d in model().drives]
    return {
        BEST: TorqueEstimator(model(), fused, width=WIDTH),
        "filter, current alone": TorqueEstimator(model(), known(PROCESS, np.array(swept["best_current_noise"])), width=WIDTH),
        "the same, friction without its corrections": TorqueEstimator(model().with_drives(drives), known(), width=WIDTH),
        "momentum observer": MomentumObserver(model(), 20.0, DT, width=WIDTH),
    }


def shown(estimator: Any, log: Played) -> Motion:
    """The momentum is that of the measured motion."""
    return log.measured if isinstance(estimator, MomentumObserver) else log.asked


def errors(named: dict[str, Any]) -> dict[str, Any]:
    """Figs. 3.12 and 3.19: of the model, of T_ext by each estimator; mean over the arms that are judged, (4, 7) each."""
    whole = known(1e12)  # a gain of 1: the model's error itself
    rows = {"inverse dynamics": (TorqueEstimator(model(), whole, width=WIDTH), False)}
    rows |= {name: (estimator, True) for name, estimator in named.items()}
    found = {}
    for name, (estimator, pushed) in rows.items():
        of_arms = []
        for arm in JUDGED:
            each = [rmse(estimate(estimator, shown(estimator, log)) - log.asked.external, log) for log in logs(arm, pushed)]
            of_arms.append(in_pairs(each))
        found[name] = np.nanmean(of_arms, axis=0).tolist()
        print(f"{name:45s}", np.round(np.nanmean(of_arms, axis=(0, 1)), 2))
    found["gauge, the torque itself"] = in_pairs([rmse(log.asked.external, log) for log in logs(JUDGED[0], True)])
    return found


def shares(rms: list[list[float]]) -> list[float]:
    """The mean (7,) of errors (4, 7) [Nm], as shares of nominal torque."""
    return (np.nanmean(rms, axis=0) / [float(model().drives[i].nominal_torque) for i in SHOWN]).tolist()


def swing(speed: float) -> list[Trajectory]:
    """About the stretched posture, in which table 3.10's levers are the longest."""
    away = np.array([0.0, 0.5, 0.35, 0.35, 0.2, 0.1, 0.1, 0.1, 0.1])
    return [time_path([STRETCHED - away, STRETCHED, STRETCHED + away], profile="quintic", velocity=speed)]


def swung(arm: int, speed: float, seed: int, pushes: Sequence[Push] = ()) -> Played:
    """The log of an arm that swings."""
    how = {"model": model(), "options": SENSORS, "rest": (0.2, 0.2), "seed": seed}
    return play(arms()[arm], swing(speed), pushes=pushes, **how)


def memory(estimator: TorqueEstimator) -> int:
    """The memory of the slowest joint's filter, in samples."""
    return int(3.0 / estimator.filter.gain.min())


def fitted(estimator: TorqueEstimator, arm: int) -> Detector:
    """Thresholds of an arm, from three swings without contact."""
    free = [swung(arm, speed, seed) for seed, speed in enumerate((0.15, 0.3, 0.6))]
    off = np.concatenate([estimate(estimator, log.asked) for log in free])
    rates, rest = np.concatenate([log.asked.velocity for log in free]), np.full(9, CREEP)
    rest[0] = 0.0  # the slide stands still throughout
    return fit_detector(off, rates, band=1.2 * friction_band(STRETCHED), rest=rest, memory=memory(estimator))


def alarms(detector: Detector, estimator: TorqueEstimator, log: Played) -> np.ndarray:
    """The alarms of each sample and joint (t, n)."""
    return detector.detect(estimate(estimator, log.asked), log.asked.velocity)


def false_alarms(detector: Detector, estimator: TorqueEstimator, arm: int) -> list[list[Judged]]:
    """The alarms in two other swings without contact, of each joint that is judged."""
    raised = [alarms(detector, estimator, swung(arm, speed, 100 + seed)) for seed, speed in enumerate((0.2, 0.45))]
    return [[judge_alarms(each[:, j - 1], np.zeros(len(each), bool), DT) for j in LEVERS] for each in raised]


def delays(detector: Detector, estimator: TorqueEstimator, arm: int, joint: int, force: float) -> list[float]:
    """How late [s] a push of half a second on link 4 is found at the joint; NaN where it is not."""
    vector, onset = np.array([force, 0.0, 0.0] if joint == 2 else [0.0, 0.0, -force]), 0.2 + 0.5 * float(swing(0.3)[0].duration)
    log = swung(arm, 0.3, 7, [Push("body4", [0.16, 0.0, -0.03], vector, onset, onset + 0.5)])
    contact = (log.asked.time >= onset) & (log.asked.time < onset + 0.5)
    return judge_alarms(alarms(detector, estimator, log)[:, joint - 1], contact, DT).delay.tolist()


def detection(estimator: TorqueEstimator, off: list[list[float]], tell: Callable[[], Any]) -> dict[str, Any]:
    """Table 3.10: thresholds from free logs, false alarms on others, the least force on link 4 that is found on every arm, and
    on how many of them one of the printed torque is; beside it the estimate's error, `off` (4, 7) [Nm], for the thesis may
    have read its column off "the performance evaluation", fig. 3.19, rather than off pushes."""
    detectors = {arm: fitted(estimator, arm) for arm in JUDGED}
    tell()
    quiet = [each for arm, detector in detectors.items() for each in false_alarms(detector, estimator, arm)]
    rows = []
    for k, (joint, lever) in enumerate(LEVERS.items()):
        tried = lambda f, joint=joint: [d for arm, own in detectors.items() for d in delays(own, estimator, arm, joint, f)]
        late = {force: tried(force) for force in FORCES}
        found = [force for force in FORCES if not np.isnan(late[force]).any()]
        least = min(found, default=np.nan)
        rows.append(
            {
                "joint": joint,
                "lever_m": lever,
                "tactile_nm": 2.0 * lever,
                "thesis_nm": PRINTED[joint],
                "threshold_nm": [float(own.threshold[joint - 1]) for own in detectors.values()],
                "least_force_found_n": least,
                "least_torque_found_nm": least * lever,
                "found_at_thesis_nm": float(np.mean(~np.isnan(tried(PRINTED[joint] / lever)))),
                "error_nm": float(np.nanmean(np.array(off)[:, joint - SHOWN.start - 1])),
                "delay_s": float(np.median(late[least])) if found else None,
                "found": {f"{force:g}": float(np.mean(~np.isnan(d))) for force, d in late.items()},
                "false_alarms": sum(each[k].false_alarms for each in quiet),
            }
        )
        print(rows[-1])
        tell()
    return {"rows": rows, "free_s": sum(each[0].free_time for each in quiet), "memory_samples": memory(estimator)}


def step_times(named: dict[str, Any]) -> dict[str, Any]:
    """How long a step of the control loop takes [us], samples in, external torques out."""
    log, found = logs(JUDGED[0], True)[0], {}
    for name in (BEST, "momentum observer"):
        samples = list(log.asked[:4000])
        loop = ControlLoop(named[name])
        state, times = loop.start(samples[0]), []
        for sample in samples:
            begin = time.perf_counter()
            state, _ = loop.step(state, sample)
            times.append(1e6 * (time.perf_counter() - begin))
        found[name] = {"p50_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99))}
    return found


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """All figures; `quick`, the gain of the filter and the printed numbers alone: each log takes seconds in MuJoCo."""
    told = steps(tell, 1 if quick else 4 + len(LEVERS))
    result: dict[str, Any] = {"printed": TEXT, "filter_gain": known().gain.tolist()}
    if quick:
        told()
        return result
    swept = sweep()
    told()
    named = estimators(swept)
    rms = errors(named)
    told()
    result |= {
        "arms": len(JUDGED),
        "off": OFF,
        "sensors": dataclasses.asdict(SENSORS),
        "measurements": MEASUREMENTS,
        "nominal_torque": [float(model().drives[i].nominal_torque) for i in SHOWN],
        "sweep": swept,
        "rmse": rms,
        "share_of_nominal": {name: shares(each) for name, each in rms.items()},
        "detection": detection(named[BEST], rms[BEST], told),
        "step": step_times(named),
    }
    told()
    return result


def main() -> None:
    """All of them; prints, and writes JSON and pictures."""
    out = Path(__file__).with_suffix(".json")
    jax.config.update("jax_enable_x64", True)
    result = {"machine": machine()} | study(tell=counted)
    best = estimators(result["sweep"])[BEST]
    draw(out.with_suffix(".png"), result, BEST, best)
    draw_joints(out.with_name(out.stem + "_joints.png"), best)
    out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

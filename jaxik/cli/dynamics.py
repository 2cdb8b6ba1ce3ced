"""`jaxik dynamics`: the torques that a motion takes, as a table and a picture."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import jax
import numpy as np
import tyro

import jaxik
from jaxik.cli.robot_arguments import RobotArguments
from jaxik.planning.trajectory import JointState
from jaxik.planning.trajectory_files import load_trajectory
from jaxik.robot.chain import Chain
from jaxik.robot.dynamics import gravity_torque, inverse_dynamics

PICTURES = ".png", ".pdf", ".svg"


@dataclasses.dataclass(kw_only=True)
class DynamicsArguments(RobotArguments):
    """The torques that a motion takes of each joint, those that hold the arm among them, and the power."""

    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file with masses and inertias (.urdf, .xml, .toml)."""
    motion: tyro.conf.Positional[Path]
    """A motion as `jaxik plan` writes it: .csv, .npz or .json; velocities and accelerations may be missing."""
    load: float = 0.0
    """A mass in the gripper [kg], at the tip."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """In the world [m/s2]."""
    out: Path = Path("torques.csv")
    """A line a sample: time, and each joint's torque, gravity's share of it, and power [Nm, N, W]."""
    plot: Path | None = None
    """A picture of the torques (.png, .pdf, .svg)."""

    def run(self) -> None:
        """Read, compute, write, and print a line a joint."""
        if self.out.suffix != ".csv":
            raise ValueError(f"--out {self.out}: ending '{self.out.suffix}'; allowed: .csv")
        if self.plot is not None and self.plot.suffix not in PICTURES:
            raise ValueError(f"--plot {self.plot}: ending '{self.plot.suffix}'; allowed: {', '.join(PICTURES)}")
        chain = jaxik.load(self.robot, **self.loading())
        chain = chain.with_load(self.load, np.zeros(3), np.zeros((3, 3))) if self.load else chain
        time, state = load_trajectory(self.motion, chain.joint_names)
        torque, holding = torques_of(chain, state, self.gravity)
        power = torque * state.velocity
        self.out.parent.mkdir(parents=True, exist_ok=True)
        _write(self.out, chain, time, torque, holding, power)
        _print_joints(chain, torque, holding, power)
        work = np.trapezoid(np.maximum(power, 0.0).sum(axis=1), time)
        print(f"{len(time)} samples, {time[-1] - time[0]:.2f} s, {work:.1f} J into the joints; wrote {self.out}")
        if self.plot is not None:
            from jaxik.view.torque_picture import torque_picture

            self.plot.parent.mkdir(parents=True, exist_ok=True)
            torque_picture(chain, time, torque, holding, self.plot)


def _print_joints(chain: Chain, torque: np.ndarray, holding: np.ndarray, power: np.ndarray) -> None:
    for i, (name, slides) in enumerate(zip(chain.joint_names, chain.is_prismatic, strict=True)):
        unit, most, usual = "N " if slides else "Nm", np.abs(torque[:, i]).max(), np.sqrt(np.mean(torque[:, i] ** 2))
        held, strongest = np.abs(holding[:, i]).max(), np.abs(power[:, i]).max()
        print(f"  {name:<20} at most {most:8.2f} {unit}, rms {usual:8.2f}, of gravity {held:8.2f}, power {strongest:8.2f} W")


def torques_of(chain: Chain, state: JointState, gravity: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The drives' torques (i, n) [Nm, N] along a motion, and what they would be at rest, `gravity` in world axes [m/s2]."""
    with jax.enable_x64(True):
        moving = jax.jit(jax.vmap(lambda *x: inverse_dynamics(chain, *x, gravity=gravity)))(*state)
        return np.asarray(moving), np.asarray(jax.jit(jax.vmap(lambda q: gravity_torque(chain, q, gravity)))(state.q))


def _write(file: Path, chain: Chain, time: np.ndarray, *kinds: np.ndarray) -> None:
    header = ["time", *(f"{kind}_{name}" for kind in ("torque", "gravity", "power") for name in chain.joint_names)]
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows([header, *np.column_stack([time, *kinds]).tolist()])

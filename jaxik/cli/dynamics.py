"""`jaxik dynamics`: the torques that a motion takes, as a table and a picture."""

from __future__ import annotations

import csv
import dataclasses
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar, NamedTuple

import jax
import numpy as np
import tyro

import jaxik
from jaxik.cli.arguments import RobotArguments
from jaxik.cli.results import check_writable, writing
from jaxik.dynamics.actuation import friction_torque, motor_current
from jaxik.dynamics.recursions import gravity_torque, inverse_dynamics
from jaxik.kinematics.motion import Motion, smooth
from jaxik.kinematics.robot import Robot, beyond_limits
from jaxik.planning.trajectory_files import check_ending, read_motion

ROUNDED = 1e-3  # [rad, m] beyond its limits that a joint may be, as files are rounded
SLOWEST = 1.0  # [s] between samples that are told in seconds
DRIVEN = ", friction {:8.2f}", ", current {:6.2f} A"  # of drives that are known, and of their motors


class Demand(NamedTuple):
    """The demand of a motion on each joint, (i, n): the drives' torque, gravity's share of it [Nm, N], and power [W]; and
    where drives are known, friction at the joints [Nm, N], and where their motors are, the currents [A]."""

    torque: np.ndarray
    gravity: np.ndarray
    power: np.ndarray
    friction: np.ndarray | None = None
    current: np.ndarray | None = None


@dataclasses.dataclass(kw_only=True)
class DynamicsArguments(RobotArguments):
    """The torques that a motion takes of each joint, those that hold the arm among them, and the power; of a robot whose drives
    are known also friction, and of known motors the currents."""

    SEVERAL: ClassVar[bool] = True
    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file with masses and inertias (.urdf, .xml, .toml)."""
    motion: tyro.conf.Positional[Path]
    """A motion as `jaxik plan` writes it, .csv, .npz or .json, or a log with the columns time [s] and a joint's name each [rad,
    m]; velocities and accelerations may be missing."""
    smooth: float | None = None
    """Leave out of the file's numbers what is above this frequency [Hz], as noise of measured positions."""
    load: float = 0.0
    """A mass in the gripper [kg], at the tip."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """In the world [m/s2]."""
    out: Path = Path("torques.csv")
    """A line a sample: time, and each joint's torque, gravity's share of it [Nm, N], power [W], and of drives friction [Nm, N]
    and current [A]."""
    plot: Path | None = None
    """A picture of the torques (.png, .pdf, .svg)."""

    def run(self) -> None:
        """Read, compute, write, and print a line a joint."""
        check_writable(self.out, endings=(".csv",))
        if self.plot is not None:
            check_writable(self.plot, "--plot", (".png", ".pdf", ".svg"))
        if not np.isfinite(self.gravity).all():
            raise ValueError(f"--gravity {' '.join(map(str, self.gravity))}: finite numbers [m/s2]")
        if self.load and len(self.tip) > 1:
            raise ValueError(f"--load {self.load:g}: hangs at one tip; name --tip once")
        robot = jaxik.load(self.robot, **self.loading())
        robot = robot.with_load(self.load, com=np.zeros(3), inertia=np.zeros((3, 3))) if self.load else robot
        found = read_motion(check_ending("dynamics", self.motion), robot.joint_names)
        time = found.time
        self._doubt(robot, time, np.asarray(found.q))
        whole = found.velocity is not None and found.acceleration is not None and self.smooth is None
        demand = demanded(robot, found if whole else smooth(found, cutoff=self.smooth), self.gravity)
        with writing(self.out) as (aside, wrote):
            _write(aside, robot, time, demand)
        if found.acceleration is None:
            print(f"  {self._derived(found.velocity is not None)}")
        for line in _lines(robot, demand):
            print(f"  {line}")
        work = np.trapezoid(np.maximum(demand.power, 0.0).sum(axis=1), time)
        print(f"{len(time)} samples, {time[-1] - time[0]:.2f} s, {work:.1f} J into the joints; {wrote}")
        if self.plot is not None:
            from jaxik.view import plot_torques

            title = f"{robot.name}, {self.load:g} kg at its tip" if self.load else robot.name
            with writing(self.plot, "--plot") as (aside, drew):
                plot_torques(robot, time, demand.torque, demand.gravity, aside, title=title)
            print(drew)

    def _doubt(self, robot: Robot, time: np.ndarray, q: np.ndarray) -> None:
        """Warns of numbers that are hardly radians, metres and seconds."""
        if told := beyond_limits(robot, q, ROUNDED):
            warnings.warn(f"{self.motion}: {told}", stacklevel=2)
        if len(time) > 1 and (period := float(np.median(np.diff(time)))) > SLOWEST:
            warnings.warn(f"{self.motion}: samples are {period:.4g} s apart; are these milliseconds?", stacklevel=2)

    def _derived(self, of_rates: bool) -> str:
        what = f"accelerations are {'derivatives of velocities' if of_rates else 'second derivatives of positions'}"
        noise = "of measured ones mostly noise: --smooth HZ" if self.smooth is None else f"smoothed below {self.smooth:g} Hz"
        return f"{what}, {noise}"


def demanded(robot: Robot, motion: Motion, gravity: tuple[float, float, float]) -> Demand:
    """The demand of a motion (i, n)."""
    every = lambda of, *x: np.asarray(jax.jit(jax.vmap(of))(*x))
    with jax.enable_x64(True):
        torque = every(lambda *x: inverse_dynamics(robot, *x, gravity=gravity), *motion.state)
        still = every(lambda q: gravity_torque(robot, q, gravity=gravity), motion.q)
        found = Demand(torque, still, torque * motion.velocity)
        if not robot.drives:
            return found
        friction = every(lambda v, t: friction_torque(robot, v, t), motion.velocity, torque)
        found = found._replace(friction=friction)
        if all(drive.torque_per_current == 1.0 for drive in robot.drives):  # a file that tells of friction knows no motors
            return found
        return found._replace(current=every(lambda t, v: motor_current(robot, t, v), torque, motion.velocity))


def _lines(robot: Robot, demand: Demand) -> Iterable[str]:
    """The largest demand on each joint."""
    most = {kind: np.abs(values).max(axis=0) for kind, values in demand._asdict().items() if values is not None}
    usual = np.sqrt(np.mean(demand.torque**2, axis=0))
    for i, (name, slides) in enumerate(zip(robot.joint_names, robot.is_prismatic, strict=True)):
        torque, gravity, power, *driven = (values[i] for values in most.values())
        limit = f" ({torque / robot.effort[i]:4.0%} of its limit)" if np.isfinite(robot.effort[i]) else ""
        line = f"{name:<20} at most {torque:8.2f} {'N ' if slides else 'Nm'}{limit}, rms {usual[i]:8.2f}"
        line += f", of gravity {gravity:8.2f}, power {power:8.2f} W"
        yield line + "".join(told.format(x) for told, x in zip(DRIVEN, driven, strict=False))


def _write(file: Path, robot: Robot, time: np.ndarray, demand: Demand) -> None:
    kinds = {kind: values for kind, values in demand._asdict().items() if values is not None}
    header = ["time", *(f"{kind}_{name}" for kind in kinds for name in robot.joint_names)]
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows([header, *np.column_stack([time, *kinds.values()]).tolist()])

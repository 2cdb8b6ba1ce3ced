"""The shipped models against what the papers say of them."""

import re
import tomllib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.files.documents import models_folder
from jaxik.files.robot_toml import ORIGINS

TABLE_4 = [  # 9-DOF paper: position [cm], q1 [cm], q2..q9 [deg]
    ((38, 34, 60), (8.16, 44.57, 5.33, 50.95, 56.99, -35.41, 6.34, 221.30, 50.87)),
    ((43.25, 29.25, 55), (8.12, 35.38, -4.73, 55.25, 66.34, -31.29, 1.50, -131.07, 43.13)),
    ((48.5, 24.5, 50), (8.14, 27.85, -16.29, 58.61, 74.69, -24.68, 1.50, 30.30, 21.22)),
    ((53.75, 19.75, 55), (8.15, 21.76, -9.88, 55.08, 67.54, -16.94, 1.50, -29.89, -33.31)),
    ((59, 15, 60), (7.91, 15.60, -2.06, 50.47, 58.72, -11.41, 13.43, 13.45, 34.23)),
    ((59, -15, 60), (7.84, -15.58, -1.90, 50.38, 58.62, 11.46, 11.76, 33.71, 23.54)),
]


@pytest.mark.parametrize("position, joints", TABLE_4)
def test_chembuly9_reproduces_table_4(position, joints):
    q = np.array([joints[0] / 100, *np.radians(joints[1:])])
    tip = jaxik.forward_kinematics(jaxik.load("chembuly9"), q)[:3, 3]
    assert np.max(np.abs(100 * tip - np.array(position))) <= 0.0101  # the table's rounding of the joints


def test_pendulum_starts_where_the_thesis_says():
    robot = jaxik.load("pendulum4")
    tip = jaxik.forward_kinematics(robot, jnp.radians(jnp.array([30.0, -30.0, -30.0, -60.0])))[:3, 3]
    assert np.allclose(tip, (1.0, 2.0 + np.sqrt(3.0), 0.0), atol=1e-15)
    q = np.random.default_rng(0).normal(size=4)
    c = np.cumsum(q)
    assert np.allclose(jaxik.forward_kinematics(robot, q)[:2, 3], (-np.sin(c).sum(), 1 + np.cos(c).sum()), atol=1e-14)


def test_crops_tensors_are_physical():
    for body in jaxik.load("crops_v2").bodies:
        moments = np.linalg.eigvalsh(body.inertia)
        assert moments[0] > 0.0 and moments[0] + moments[1] >= moments[2]
        assert body.mass > 0.0


def test_p6r_satisfies_the_appendix():
    robot = jaxik.load("p6r")
    slide, t2, t3, t4 = 0.37, 0.4, -0.6, -0.5
    wrist = jaxik.load("p6r", tip="wrist_roll", posture={})
    p = np.asarray(jaxik.forward_kinematics(wrist, jnp.array([slide, t2, t3, t4, 0.3])))[:3, 3]
    a3, a4, a5, d2, d5 = 0.1, 0.25, 0.09, 0.35, 0.255
    along = a3 + a4 * np.cos(t3) + a5 * np.cos(t3 + t4) - d5 * np.sin(t3 + t4)
    assert abs(np.cos(t2) * p[0] + np.sin(t2) * (slide - p[2]) - along) <= 1e-15
    assert abs(p[1] - d2 - (-a4 * np.sin(t3) - a5 * np.sin(t3 + t4) - d5 * np.cos(t3 + t4))) <= 1e-15
    assert np.allclose(robot.world_T_base[:3, :3] @ [0, 0, 1], (1, 0, 0)) and np.allclose(
        robot.world_T_base[:3, 1], (0, 0, 1, 0)[:3]
    )


@pytest.mark.parametrize("path", sorted(models_folder().glob("*.toml")), ids=lambda p: p.stem)
def test_each_number_has_an_origin(path):
    model = tomllib.loads(path.read_text())
    tables = [*model["joint"], *model.get("shape", []), *(model[k] for k in ("tool", "mount") if k in model)]
    drives = [joint["drive"] for joint in model["joint"] if "drive" in joint]
    for table in (*tables, *drives, *(drive["friction"] for drive in drives)):
        named, origin = {k for k, v in table.items() if isinstance(v, int | float | list)}, table.get("origin", {})
        each = origin if isinstance(origin, dict) else dict.fromkeys(named, origin)
        assert named == set(each) and set(each.values()) <= set(ORIGINS)


def test_the_page_lists_each():
    page = (Path(__file__).parents[2] / "docs/models.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \|[^|]*\| (\d+) \|", page, re.M))
    assert set(rows) == {path.stem for path in models_folder().glob("*.toml")}
    assert all(jaxik.load(name).num_joints == int(joints) for name, joints in rows.items())

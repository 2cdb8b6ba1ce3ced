"""Robots to files and back: TOML to the last bit; a URDF of spheres that hold the collision model."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from robot_files import write
from robots import FOLDER, ROBOTS

import jaxik
from jaxik.files.robot_files import _covering
from jaxik.kinematics.named import Group, State
from jaxik.kinematics.shapes import Volume

SHIPPED = ("p6r", "crops_v2", "chembuly9", "pendulum4", "planar2")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_robot_is_read_as_it_was_written(tmp_path, name):
    robot = (
        jaxik.load(name).with_spheres(64).mounted(np.array([[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 1 / 3], [0, 0, 0, 1]]))
    )
    assert jaxik.save(robot, tmp_path / "robot.toml") == 0.0
    assert jaxik.load(tmp_path / "robot.toml") == robot


@pytest.mark.filterwarnings("ignore:panda. its meshes touch with all joints at 0")  # `test_fit` holds that it is said
def test_a_fitted_model_is_read_as_it_was_written(tmp_path):
    file, tip = ROBOTS["panda"]
    left = ["panda_link0", ("panda_link2", 'a "table"')]
    robot = jaxik.load(FOLDER / file, tip=tip, meshes=True, fit=jaxik.FitOptions(accuracy=0.1, most=2), ignore=left, posture={})
    assert robot.ignored == ((robot.link_names.index("panda_link0"), "*"), (robot.link_names.index("panda_link2"), 'a "table"'))
    jaxik.save(robot, tmp_path / "panda.toml")
    again = jaxik.load(tmp_path / "panda.toml")
    assert again == robot and again.volumes and again.self_pairs == robot.self_pairs and again.ignored == robot.ignored
    a, b = (robot.link_names[i] for i in robot.self_pairs[0])
    fewer = jaxik.load(tmp_path / "panda.toml", ignore=[(b, a)])
    assert fewer.self_pairs == robot.self_pairs[1:]
    part = robot.part(1, 7)
    assert part.ignored == ((part.link_names.index("panda_link2"), 'a "table"'),) and "panda_link0" not in part.link_names
    unread = jaxik.load(FOLDER / file, tip=tip)
    jaxik.save(unread, tmp_path / "unread.toml")
    assert jaxik.load(tmp_path / "unread.toml") == unread
    with pytest.raises(ValueError, match=r"panda_link0.* are not read"):
        jaxik.save(unread, tmp_path / "unread.urdf")


def test_what_is_attached_stays_ignored(tmp_path):
    """An object's name that is a link's by now still means the object, and entries keep their order."""
    arm = jaxik.load("planar2", ignore=[("link2", "spheres_1"), "link1", ("link2", "table")])
    scene = jaxik.make_scene(spheres=[[1.2, 0.3, 0.0, 0.05]])
    held = jaxik.collision.attach(arm, scene, "spheres_1", np.zeros(2)).robot
    jaxik.save(held, tmp_path / "held.toml")
    again = jaxik.load(tmp_path / "held.toml")
    assert again.ignored == held.ignored != () and again == held


def mixed():
    """A triangle and a capsule on a robot with a slide, and boxes."""
    robot = jaxik.load("p6r")
    more = [Volume(np.array([[0.0, 0.1, 0.0], [0.1, 0.1, 0.1], [-0.1, 0.2, 0.1]]), np.asarray(0.02), robot.boxes[-1].link)]
    more.append(Volume(np.array([[0.0, 0.1, 0.0], [0.1, 0.1, 0.1]]), np.asarray(0.03), robot.boxes[0].link))
    return dataclasses.replace(robot, volumes=(*robot.volumes, *more))


def test_spheres_hold_the_model(tmp_path):
    """Spheres in a URDF that stands and moves as the robot does hold the model, and reach no further than is told."""
    robot = mixed()
    told = jaxik.save(robot, tmp_path / "spheres.urdf", beyond=0.004)
    assert 0.0 < told <= 0.004 and f"at most {1e3 * told:.1f} mm" in (tmp_path / "spheres.urdf").read_text()
    other = jaxik.load(tmp_path / "spheres.urdf", tip="tool")
    assert {len(v.corners) for v in other.volumes} == {1} and not other.boxes
    q = np.random.default_rng(0).uniform(*robot.finite_limits)
    pose = jaxik.forward_kinematics(robot.mounted(np.eye(4)), q)
    np.testing.assert_allclose(jaxik.forward_kinematics(other, q), pose, atol=2e-6)
    rng = np.random.default_rng(1)
    frames = {name: np.eye(4) if o is None else o for name, o in zip(robot.link_names, robot.link_offset, strict=True)}
    for volume in robot.volumes:
        name = robot.link_names[volume.link]
        back = other.link_offset[other.link_names.index(name)] @ np.linalg.inv(frames[name])
        mine = [v for v in other.volumes if other.link_names[v.link] == name]
        inside = rng.dirichlet(np.ones(len(volume.corners)), 300) @ np.asarray(volume.corners)
        outward = rng.normal(size=(300, 3))
        skin = inside + float(volume.radius) * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        skin = skin @ back[:3, :3].T + back[:3, 3]
        gaps = [np.linalg.norm(skin - v.corners[0], axis=1) - float(v.radius) for v in mine]
        assert np.min(gaps, axis=0).max() < 1e-9


def test_frames_take_names_that_are_free(tmp_path):
    """A link that stands beside its joint, called as the joint's frame would be, keeps its place and its spheres."""
    robot = jaxik.load("planar2")
    names = tuple("q1_frame" if name == "link1" else name for name in robot.link_names)
    beside = np.array(robot.link_offset)
    beside[:, 0, 3] += 0.01
    robot = dataclasses.replace(robot, link_names=names, link_offset=beside)
    jaxik.save(robot, tmp_path / "named.urdf")
    other = jaxik.load(tmp_path / "named.urdf", tip="tool")
    for link, name in enumerate(names):
        np.testing.assert_allclose(other.link_offset[other.link_names.index(name)], robot.link_offset[link], atol=1e-12)
    assert {other.link_names[v.link] for v in other.volumes} == {names[v.link] for v in robot.volumes}
    q, scene = np.array([0.3, -0.4]), jaxik.make_scene(spheres=[[1.2, 0.9, 0.0, 0.05]])
    assert 0.0 <= jaxik.clearance(robot, scene, q) - jaxik.clearance(other, scene, q) <= 0.005


def test_pairs_that_are_not_checked_are_written_beside(tmp_path):
    """An SRDF tells them to other programs, in the form that they read; no file of somebody else's is written over."""
    robot = mixed()
    robot = dataclasses.replace(robot, self_pairs=robot.self_pairs[2:])
    jaxik.save(robot, tmp_path / "spheres.urdf", beyond=0.02)
    assert "the .srdf beside it names the pairs" in (tmp_path / "spheres.urdf").read_text()
    other = jaxik.load(tmp_path / "spheres.urdf", tip="tool", srdf=tmp_path / "spheres.srdf")
    named = lambda robot: {frozenset(robot.link_names[i] for i in pair) for pair in robot.self_pairs}
    assert named(other) == named(robot)
    jaxik.save(robot, tmp_path / "spheres.urdf", beyond=0.02)
    mine = write(tmp_path, "other.srdf", "<robot name='mine'/>")
    with pytest.raises(ValueError, match=r"other\.srdf is there, and is none of jaxik's; "):
        jaxik.save(robot, tmp_path / "other.urdf")
    assert mine.read_text() == "<robot name='mine'/>" and not (tmp_path / "other.urdf").exists()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_cover_reaches_as_far_as_is_told(count):
    rng = np.random.default_rng(count)
    for _ in range(20):
        corners, radius, beyond = 0.1 * rng.normal(size=(count, 3)), rng.uniform(0.01, 0.1), rng.uniform(0.002, 0.02)
        centres, reach = _covering(corners, radius, beyond)
        assert reach <= beyond + 1e-12
        # corners, edges and the inside, each with what is around it
        inside = np.concatenate([corners, *(rng.dirichlet(np.full(count, a), 400) @ corners for a in (0.05, 0.5))])
        outward = rng.normal(size=inside.shape)
        skin = inside + radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        gaps = np.linalg.norm(skin[:, None] - centres, axis=2).min(axis=1) - radius - reach
        assert gaps.max() <= 1e-9


def test_room_for_what_is_held_is_in_no_file(tmp_path):
    with pytest.raises(ValueError, match="p6r has room for what it holds; save the robot that it was before with_room"):
        jaxik.save(jaxik.collision.with_room(jaxik.load("p6r"), spheres=2), tmp_path / "robot.toml")


def test_bad_files_are_one_line(tmp_path):
    robot = jaxik.load("planar2")
    jaxik.save(robot, tmp_path / "robot.toml")
    text = (tmp_path / "robot.toml").read_text()
    for count in ("inf", "8.5"):
        path = write(tmp_path, "bad.toml", text.replace("spheres_per_box = 8", f"spheres_per_box = {count}"))
        with pytest.raises(jaxik.LoadError, match=f"spheres_per_box = {count}; write a whole number of at least 1"):
            jaxik.load(path)
    bad = {
        "pairs = []": ('pairs = [["link1"]]', "pairs holds"),
        'type = "revolute"': ('type = "fixed"', "type = 'fixed'"),
        "spheres_per_box = 8": ("spheres_per_box = 9", "spheres_per_box = 9"),
        "joint = 1": ("joint = 7", "joint = 7"),
        "radius = 0.05": ("radius = -0.05", "'radius' is out of range"),
        'link = "link1"': ('link = "hand"', "link = 'hand'"),
        "ignored_objects = []": ('ignored_objects = [["hand", "table"]]', "ignored_objects holds ['hand', 'table']"),
        "velocity =": ("speed =", "'velocity' is missing"),
        "axis = [0.0, 0.0, 1.0]": ("axis = [0.0, 0.0, 2.0]", "the axis has length 2, not 1"),
        "lower = -": ("lower = 9", "> upper 3.14159"),
        "tip = [[1.0,": ("tip = [[2.0,", "'tip' is no rigid frame"),
    }
    for old, (new, words) in bad.items():
        assert old in text, old
        path = write(tmp_path, "bad.toml", text.replace(old, new))
        with pytest.raises(jaxik.LoadError) as caught:
            jaxik.load(path)
        assert words in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(jaxik.LoadError, match="fixed in a saved robot"):
        jaxik.load(tmp_path / "robot.toml", tip="link1")
    with pytest.raises(ValueError, match=r"ending '.yaml'; allowed: .toml, .urdf"):
        jaxik.save(robot, tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    "entries, words",
    [
        ([("hand", "table")], "no such link 'hand'; links: base, q1_axis, link1"),
        ("link1", "is no list"),
        ([("link1", "link2", "table")], "is no link and no pair"),
        ([3], "is no link and no pair"),
        ([("link1", "lnk2")], "did you mean 'link2'"),
        ([("link1", "Link2")], "did you mean 'link2'"),
    ],
)
def test_bad_ignores_are_one_line(entries, words):
    with pytest.raises(jaxik.LoadError) as caught:
        jaxik.load("planar2", ignore=entries)
    assert words.split(";")[0] in str(caught.value) and words.split("; ")[-1] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_urdf_has_the_numbers_that_its_readers_want(tmp_path):
    """Pinocchio's reader refuses a limit without a velocity; a slide without ends would come back locked."""
    robot = dataclasses.replace(jaxik.load("p6r"), velocity=np.full(7, np.inf))
    jaxik.save(robot, tmp_path / "robot.urdf")
    assert pin.buildModelFromUrdf(str(tmp_path / "robot.urdf")).nq == 7
    assert np.isinf(jaxik.load(tmp_path / "robot.urdf", tip="tool").velocity).all()
    moving = jaxik.load(tmp_path / "robot.urdf", tip="tool", base="planar")
    with pytest.raises(ValueError, match="save: 'base_x' has no limits, which a URDF wants"):
        jaxik.save(moving, tmp_path / "moving.urdf")


def test_states_of_joints_with_other_signs_are_read_again(tmp_path):
    robot = jaxik.load("planar2")
    named = dataclasses.replace(robot, joint_names=("arm/j1", "j.2"), groups=(Group("arm", ("arm/j1", "j.2")),))
    named = dataclasses.replace(named, states=(State("home", "arm", (("arm/j1", 0.1), ("j.2", 0.2))),))
    jaxik.save(named, tmp_path / "robot.toml")
    assert jaxik.load(tmp_path / "robot.toml").state("home").tolist() == [0.1, 0.2]

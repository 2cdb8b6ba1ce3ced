"""The reader of MotionBenchMaker's problems: where shapes stand, whose joints a goal names, and what it refuses."""

import io
import tarfile

import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
import yaml
from setups import motionbenchmaker

import jaxik

WORLD = """
fixed_frame_transforms: {frames}
world:
  collision_objects:
    - id: shelf
      {pose}
      primitives:
        - {{type: box, dimensions: [0.1, 0.2, 0.3]}}
        - {{type: 3, dimensions: [0.4, 0.05]}}
        - {{type: sphere, dimensions: [0.06]}}
      primitive_poses:
        - {{position: [0.1, 0.0, 0.0], orientation: [0.0, 0.0, 0.0, 1.0]}}
        - {{position: {{x: 0.0, y: 0.2, z: 0.0}}, orientation: {{x: 3.0, y: 0.0, z: 0.0, w: 3.0}}}}
        - {{position: [0.0, 0.0, 0.3], orientation: [0.0, 0.0, 0.0, 0.0]}}
"""
PLACE, TURN = [1.0, -2.0, 0.5], [0.1, -0.2, 0.3, 0.9273618495495704]  # a unit quaternion, xyzw
STANDS = pin.XYZQUATToSE3(np.array([0.0, 0.0, 0.7, 0.0, 0.0, 1.0, 0.0]))  # of the frame "table"
FRAMES = "[{child_frame_id: table, transform: {translation: [0, 0, 0.7], rotation: [0, 0, 1, 0]}}]"


@pytest.mark.parametrize("frame", ["", "header: {frame_id: table}", "header: {frame_id: /world}"])
@pytest.mark.parametrize("pose", ["", f"pose: {{position: {PLACE}, orientation: {TURN}}}"])
def test_an_object_carries_its_shapes(pose, frame):
    scene = motionbenchmaker.scene_of(yaml.safe_load(WORLD.format(pose=f"{pose}\n      {frame}", frames=FRAMES)))
    placed = (STANDS if "table" in frame else pin.SE3.Identity()) * (
        pin.XYZQUATToSE3(np.array([*PLACE, *TURN])) if pose else pin.SE3.Identity()
    )
    lying = pin.XYZQUATToSE3(np.array([0.0, 0.2, 0.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    box = placed * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(scene.boxes.world_T_box[0], box.homogeneous, atol=1e-12)
    np.testing.assert_allclose(scene.cylinders.world_T_cylinder[0], (placed * lying).homogeneous, atol=1e-12)
    np.testing.assert_allclose(scene.spheres.center[0], placed.act(np.array([0.0, 0.0, 0.3])), atol=1e-12)
    np.testing.assert_allclose(scene.boxes.half[0], [0.05, 0.1, 0.15])
    assert scene.cylinders.radius[0] == 0.05 and scene.cylinders.half[0] == 0.2 and scene.spheres.radius[0] == 0.06


def test_a_shape_without_a_pose_stands_at_its_object():
    ball = {"id": "ball", "pose": {"position": PLACE}, "primitives": [{"type": "sphere", "dimensions": [0.1]}]}
    scene = motionbenchmaker.scene_of({"world": {"collision_objects": [ball, {"id": "nothing", "meshes": []}]}})
    np.testing.assert_allclose(scene.spheres.center, [PLACE])
    assert scene.object_names == ("ball",)  # what has no shape is no obstacle


BALL = {"type": "sphere", "dimensions": [0.1]}


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"meshes": [{"vertices": []}]}, "object 'x' has meshes"),
        ({"planes": [{"coef": [0, 0, 1, 0]}], "meshes": [{}]}, "object 'x' has meshes and planes"),
        ({"primitives": [{"type": "cone", "dimensions": [1, 1]}]}, "is a cone"),
        ({"primitives": [{"type": 4, "dimensions": [1, 1]}]}, "is a cone"),
        ({"primitives": [{"type": "box", "dimensions": [1, 1]}]}, "2 dimensions of a box; allowed: 3"),
        ({"primitives": [BALL], "primitive_poses": [{}, {}]}, "1 primitives and 2 primitive_poses"),
        ({"primitives": [BALL], "primitive_poses": [{"position": [0, 0]}]}, "a pose of 2 and 4 numbers"),
        ({"primitives": [BALL], "primitive_poses": [{"position": [0, 0, np.nan]}]}, "nan"),
        ({"primitives": [{"type": "box", "dimensions": [1, 1, 1]}], "pose": {"orientation": [0, np.nan, 0, 1]}}, "frame"),
        ({"header": {"frame_id": "gripper"}, "primitives": [BALL]}, "frame 'gripper', which fixed_frame_transforms"),
        ({"operation": "remove"}, "operation remove; known: add"),
    ],
)
def test_what_is_not_known_is_refused_in_one_line(what, said):
    with pytest.raises(ValueError) as refused:
        motionbenchmaker.scene_of({"world": {"collision_objects": [{"id": "x"} | what]}})
    assert said in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"world": {"octomap": {"octomap": {"data": "78da"}}}}, "octomap"),
        ({"robot_state": {"attached_collision_objects": [{}]}}, "attached_collision_objects"),
    ],
)
def test_a_scene_with_more_than_objects_is_refused(message, said):
    with pytest.raises(ValueError, match=said):
        motionbenchmaker.scene_of(message)


URDF = """<robot name="two">
  <link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="arm"/>
  <link name="hand"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="other"><collision><origin xyz="0 0 1"/><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="arm"/><child link="hand"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="left" type="revolute"><parent link="base"/><child link="other"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>"""
SRDF = '<robot name="two">{}<disable_collisions link1="base" link2="hand"/></robot>'
END = '<end_effector name="{0}_eef" parent_link="{0}" group="g"/>'


def _constraints(**joints):
    return {"joint_constraints": [{"joint_name": name, "position": x} for name, x in joints.items()]}


def _folder(place, ends=("hand",), request=None, **others):
    """A robot's folder with one problem in an archive."""
    (place / "two_spherized.urdf").write_text(URDF)
    (place / "two.urdf").write_text("not read")
    (place / "two.srdf").write_text(SRDF.format("".join(map(END.format, ends))))
    start = {"joint_state": {"name": ["left", "shoulder"], "position": [0.5, 0.25]}}
    request = request or {"start_state": start, "goal_constraints": [_constraints(elbow=0.2, left=0.3, shoulder=0.1)]}
    files = {"shelf_two/request0001.yaml": request, "shelf_two/scene0001.yaml": {"world": None}} | others
    with tarfile.open(place / "problems.tar.bz2", "w:bz2") as archive:
        for name, content in files.items():
            text = yaml.safe_dump(content).encode()
            member = tarfile.TarInfo(f"problems/{name}")
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
    return place


def test_a_folder_says_robot_tip_and_goals(tmp_path):
    folder = _folder(tmp_path, **{"shelf_two/scene_sensed0001.yaml": "not read", "shelf_two/path0001.yaml": "neither"})
    robot = motionbenchmaker.load_robot(folder)
    assert robot.joint_names == ("shoulder", "elbow") and robot.self_pairs == ((2, 3),) and len(robot.volumes) == 3
    (goal,) = motionbenchmaker.goals(folder, robot)
    assert goal.name == "shelf_two/request0001.yaml" and goal.elsewhere == ()
    np.testing.assert_array_equal(goal.q, [0.1, 0.2])
    np.testing.assert_array_equal(goal.start, [0.25, np.nan])
    assert isinstance(goal.scene, jaxik.Scene) and not any(goal.scene.counts.values())


def test_problems_may_lie_unpacked_with_several_goals_each(tmp_path):
    folder = _folder(tmp_path)
    (folder / "problems.tar.bz2").unlink()
    goals = [_constraints(shoulder=0.1, elbow=0.2), _constraints(shoulder=-0.1, elbow=-0.2)]
    (folder / "cage").mkdir()
    (folder / "cage" / "request0007.yaml").write_text(yaml.safe_dump({"goal_constraints": goals}))
    (folder / "cage" / "scene0007.yaml").write_text(yaml.safe_dump({"world": {"collision_objects": []}}))
    found = list(motionbenchmaker.goals(folder, motionbenchmaker.load_robot(folder)))
    assert [goal.name for goal in found] == ["cage/request0007.yaml", "cage/request0007.yaml#2"]
    np.testing.assert_array_equal(found[1].q, [-0.1, -0.2])


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (_constraints(shoulder=0.1), "the goal says nothing of elbow; it moves shoulder"),
        ({"position_constraints": [{"link_name": "hand"}]}, "a goal by position_constraints; known: joint_constraints"),
        ({"joint_constraints": [{"joint_name": "elbow"}]}, "'position' is missing"),
    ],
)
def test_a_goal_that_is_not_known_names_its_file(tmp_path, goal, said):
    folder = _folder(tmp_path, request={"goal_constraints": [goal]})
    with pytest.raises(ValueError) as refused:
        list(motionbenchmaker.goals(folder, motionbenchmaker.load_robot(folder)))
    assert said in str(refused.value) and "shelf_two/request0001.yaml" in str(refused.value)


def test_what_a_folder_lacks_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"holds no \*_spherized.urdf and no \*.urdf"):
        motionbenchmaker.load_robot(tmp_path)
    folder = _folder(tmp_path, ends=("hand", "other"))
    with pytest.raises(ValueError, match="end effectors on hand, other; say which arm by tip="):
        motionbenchmaker.load_robot(folder)
    robot = motionbenchmaker.load_robot(folder, tip="hand")
    (folder / "problems.tar.bz2").unlink()
    with pytest.raises(ValueError, match=r"no requestNNNN.yaml"):
        list(motionbenchmaker.goals(folder, robot))
    (folder / "request0001.yaml").write_text("{}")
    with pytest.raises(ValueError, match=r"request0001\.yaml: no scene0001\.yaml beside it"):
        list(motionbenchmaker.goals(folder, robot))
    (folder / "scene0001.yaml").write_text("[1, 2")
    with pytest.raises(ValueError, match=r"request0001\.yaml or its scene: while parsing"):
        list(motionbenchmaker.goals(folder, robot))


def test_joints_beside_the_robot_stand_where_the_problem_has_them(tmp_path):
    """The other arm stands at 0.5, as at the start, not at its goal; a problem that has it elsewhere says so."""
    start = {"joint_state": {"name": ["left", "nothing"], "position": [0.7, 1.0]}}
    other = {"start_state": start, "goal_constraints": [_constraints(shoulder=0.1, elbow=0.2)]}
    others = {"shelf_two/request0002.yaml": other, "shelf_two/scene0002.yaml": {"world": None}}
    folder = _folder(tmp_path, **others)
    robot = motionbenchmaker.load_robot(folder)
    assert motionbenchmaker.posture(folder, robot) == {"left": 0.5}
    centers, _ = jaxik.collision.robot_spheres(robot, jnp.zeros(2))
    np.testing.assert_allclose(sorted(centers.tolist())[-1], [np.sin(0.5), 0.0, np.cos(0.5)], atol=1e-6)
    assert [goal.elsewhere for goal in motionbenchmaker.goals(folder, robot)] == [(), ("left",)]

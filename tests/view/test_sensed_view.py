"""Slices of fields, clouds and unseen space, as the page shows them; and the log of a replanner."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxik
from jaxik import fields
from jaxik.cli.view import ViewArguments
from jaxik.replanning import load_log
from jaxik.view import Page
from jaxik.view.drawing import NOT_SEEN
from jaxik.view.field_slices import coloured, field_names, field_slice

BALL, RADIUS = np.array([0.5, 0.1, 0.4]), 0.15
FIELD = fields.scene_field(
    jaxik.make_scene(spheres=[[*BALL, RADIUS]]), [0.2, -0.2, 0.1], [0.8, 0.45, 0.6], spacing=0.05, world_T_grid=np.eye(4)
)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_has_the_distances_of_its_places(axis):
    turned = FIELD.moved(jaxik.pose([0.1, 0.2, 0.3], rpy=[0.3, -0.2, 0.7]))
    scene = jaxik.make_scene(points=[[1.0, 1.0, 1.0]]).with_field(turned, name="ball")
    assert field_names(scene) == ("ball",)
    values, (wide, high), frame = field_slice(scene, 0, axis, 0.3)
    rows, columns = values.shape
    x, y = (np.arange(columns) + 0.5) * wide / columns - wide / 2.0, (np.arange(rows) + 0.5) * high / rows - high / 2.0
    local = np.stack(np.broadcast_arrays(x, y[:, None], 0.0, 1.0), axis=-1)
    places = local @ (frame @ np.eye(4)).T
    middle = jaxik.pose([0.1, 0.2, 0.3], rpy=[0.3, -0.2, 0.7]) @ [*BALL, 1.0]
    np.testing.assert_allclose(values, np.linalg.norm((places - middle)[..., :3], axis=-1) - RADIUS, atol=1e-6)
    assert np.linalg.det(frame[:3, :3]) == pytest.approx(1.0)
    red, _, blue = np.moveaxis(coloured(np.array([-0.1, 0.1]), 0.1), -1, 0).astype(int)
    assert red[0] > blue[0] and red[1] < blue[1]


def test_the_page_has_clouds_fields_and_what_was_not_seen(tmp_path):
    np.save(tmp_path / "cloud.npy", np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32))
    FIELD.save(tmp_path / "ball.npz")
    around = ViewArguments(cloud=tmp_path / "cloud.npy", field=tmp_path / "ball.npz").around()
    assert around.object_names == ("cloud", "field")
    page = Page(jaxik.load("planar2"), scene=around.with_field(FIELD, name=NOT_SEEN), port=0)
    assert "points of clouds" in page.legend.content and "not seen" in page.legend.content
    assert page.slices.image is None
    page.slices.shown.value = True
    assert page.slices.image is not None and "Distances" in page.slices.said.content
    page.slices.shown.value = False
    assert page.slices.image is None
    page.close()


def test_a_log_is_played(tmp_path):
    robot = jaxik.load("planar2")
    scene = jaxik.make_scene(spheres=[[5.0, 0.0, 0.0, 0.1]]).with_room(spheres=16)
    limits = {"velocity": [2.0, 2.0], "acceleration": [5.0, 5.0]}
    replanner = jaxik.Replanner(robot, [0.0, 0.3], scene=scene, log=tmp_path / "run.jsonl", **limits)
    replanner.go([1.0, 0.3])
    for number in range(60):
        scene = scene.with_("late", spheres=[[-1.5, 0.0, 0.0, 0.1]]) if number == 5 else scene
        if replanner.update(number / 30.0, scene).event == "arrived":
            break
    log = load_log(tmp_path / "run.jsonl")
    page = Page(log.robot, scene=log.scene, log=log, port=0)
    assert "late" not in page.around.object_names and np.array_equal(page.q, [0.0, 0.3])
    page.log.show(5.5 / 30.0)
    assert "late" in page.around.object_names and "kept" in page.log.said.content
    np.testing.assert_allclose(page.q, log.records[5].command.at(5.5 / 30.0).q)
    page.log.show(page.log.duration)
    assert "arrived" in page.log.said.content
    np.testing.assert_allclose(page.q, [1.0, 0.3], atol=1e-9)
    page.log.show(0.0)
    assert "late" not in page.around.object_names
    page.close()


def test_what_is_taken_up_and_put_down_is_drawn_when_a_log_is_played(tmp_path):
    robot = jaxik.collision.with_room(jaxik.load("planar2"), spheres=1)
    q, limits = np.array([0.0, 0.3]), {"velocity": [2.0, 2.0], "acceleration": [5.0, 5.0]}
    x, y, z = np.asarray(jaxik.forward_kinematics(robot, q))[:3, 3]
    scene = jaxik.make_scene(spheres=[[5.0, 0.0, 0.0, 0.1]]).with_("cup", spheres=[[x, y, z + 0.4, 0.1]]).with_room(spheres=4)
    held = jaxik.collision.attach(robot, scene, "cup", q)
    replanner = jaxik.Replanner(robot, q, scene=scene, log=tmp_path / "run.jsonl", **limits)
    for number, told in enumerate([{}, {"scene": held.scene, "robot": held.robot}, {"scene": scene, "robot": robot}]):
        replanner.update(number / 30.0, **told)
    log = load_log(tmp_path / "run.jsonl")
    page = Page(log.robot, scene=log.scene, log=log, port=0)
    room = robot.link_names.index("held")
    drawn = lambda: [part for link, part in page.drawing.parts if link == room]
    for t, count in ((0.0, 0), (1.0 / 30.0, 2), (2.0 / 30.0, 0), (1.0 / 30.0, 2)):
        page.log.show(t)
        assert len(drawn()) == count
    page.log.show(1.0 / 30.0)
    shape = next(part for part in drawn() if part.name.startswith("/shape"))
    places = Rotation.from_quat(np.roll(shape.wxyz, -1)).apply(shape.vertices) + shape.position
    np.testing.assert_allclose(places.mean(axis=0), [x, y, z + 0.4], atol=1e-3)
    page.close()

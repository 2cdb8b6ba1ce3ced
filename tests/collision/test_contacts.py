"""The names of what stands in the way: pairs against coal, the first pair against the clearance."""

import dataclasses

import coal
import jax
import numpy as np
import pytest

import jaxik
from jaxik.cli.results import offenders
from jaxik.reasons import Reason

ARM = jaxik.load("pendulum4")
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def scene():
    box = np.eye(4)
    box[:3, :3], box[:3, 3] = TURN, [1.5, 0.4, 0.1]
    builder = jaxik.collision.SceneBuilder("yard")
    builder.add("crate", boxes=[(box, (0.8, 0.4, 0.5))])
    builder.add("ball", spheres=[[-1.0, 1.2, 0.0, 0.3]])
    builder.add("bar", capsules=[[-2.0, -1.5, 0.3, 2.0, -1.0, 0.3, 0.05]])
    return builder.scene()


def shape_of(robot, link, q):
    """The capsule of a link, by jaxik's own frames, which other tests hold."""
    (volume,) = [v for v in robot.volumes if robot.link_names[v.link] == link]
    frame = robot.world_T_base @ np.asarray(jaxik.kinematics.link_frames(robot, q))[volume.link]
    a, b = volume.corners @ frame[:3, :3].T + frame[:3, 3]
    return coal.Capsule(float(volume.radius), float(np.linalg.norm(b - a))), a, b


def placed(a, b):
    axis = (b - a) / np.linalg.norm(b - a)
    other = np.linalg.svd(axis[None])[2][1:]
    turn = np.column_stack([*other, axis])
    turn[:, 0] *= np.linalg.det(turn)
    return coal.Transform3s(turn, (a + b) / 2.0)


def test_pairs_are_coals(scene):
    obstacles = {
        "crate": (coal.Box(0.8, 0.4, 0.5), coal.Transform3s(TURN, np.array([1.5, 0.4, 0.1]))),
        "ball": (coal.Sphere(0.3), coal.Transform3s(np.eye(3), np.array([-1.0, 1.2, 0.0]))),
        "bar": (coal.Capsule(0.05, float(np.hypot(4.0, 0.5))), placed(np.array([-2.0, -1.5, 0.3]), np.array([2.0, -1.0, 0.3]))),
    }
    compared = 0
    for q in np.random.default_rng(0).uniform(-2.0, 2.0, (6, 4)):
        found = jaxik.explain(ARM, scene, q, count=30)
        assert found.contacts[0].distance == pytest.approx(float(jaxik.clearance(ARM, scene, q)), abs=1e-9)
        assert [c.distance for c in found.contacts] == sorted(c.distance for c in found.contacts)
        assert len({(c.link, c.other) for c in found.contacts}) == len(found.contacts)
        for contact in found.contacts:
            if contact.other in obstacles and contact.distance > 0.01:
                shape, a, b = shape_of(ARM, contact.link, q)
                result = coal.DistanceResult()
                coal.distance(shape, placed(a, b), *obstacles[contact.other], coal.DistanceRequest(), result)
                assert contact.distance == pytest.approx(result.min_distance, abs=1e-6)
                theirs = result.getNearestPoint1(), result.getNearestPoint2()
                for ours, point in zip((contact.point, contact.other_point), theirs, strict=True):
                    assert np.linalg.norm(ours - point) < 1e-3
                compared += 1
    assert compared > 20


def test_it_reads_as_sentences(scene):
    q = np.array([3.0, 0.0, 0.0, 0.0])
    found = jaxik.explain(ARM, scene, q, count=3)
    lines = str(found).splitlines()
    assert len(lines) == len(found.contacts) + len(found.limits) and all(" mm at (" in line for line in lines[:3])
    assert all(line.endswith("side its limits") or "beyond" in line for line in lines[3:])
    assert found.colliding == tuple(c for c in found.contacts if c.distance < 0.0)


def test_blocks_change_nothing(scene, monkeypatch):
    """A few distances at a time, so that memory does not grow with the scene: blocks of one obstacle, of two, which overlap."""
    builder = jaxik.collision.SceneBuilder("cloud", point_radius=0.01)
    for i in range(4):
        builder.add(f"leaf_{i}", points=np.random.default_rng(i).uniform(-3.0, 3.0, (6, 3)))
    asked = [(around, q) for around in (scene, builder.scene()) for q in np.random.default_rng(2).uniform(-2.0, 2.0, (2, 4))]
    whole = [str(jaxik.explain(ARM, around, q, count=99)) for around, q in asked]
    for block in (1, 9, 50):
        monkeypatch.setattr("jaxik.collision.contact_report.BLOCK", block)
        assert [str(jaxik.explain(ARM, around, q, count=99)) for around, q in asked] == whole


def test_without_a_scene_and_bad_use(scene):
    panda = jaxik.load("p6r")
    middle = np.add(*panda.finite_limits) / 2.0
    found = jaxik.explain(panda, None, middle)
    assert {c.other for c in found.contacts} <= set(panda.link_names)
    assert found.contacts[0].distance == pytest.approx(float(jaxik.clearance(panda, None, middle)), abs=1e-9)
    for wrong in (
        lambda: jaxik.explain(panda, scene, middle[:3]),
        lambda: jaxik.explain(panda, scene, middle, count=0),
        lambda: jaxik.explain(panda, scene, middle, below=np.nan),
        lambda: jaxik.explain(panda, scene, middle * np.nan),
        lambda: jax.jit(lambda around: jaxik.explain(panda, around, middle).contacts[0].distance)(scene),
    ):
        with pytest.raises(ValueError) as told:
            wrong()
        assert "\n" not in str(told.value)


def ended(scene, postures, reasons, margin=0.0):
    """A result of these postures."""
    columns = dict.fromkeys((f.name for f in dataclasses.fields(jaxik.ik.IKResult)), np.zeros(len(postures)))
    given = {
        "q": postures,
        "solutions": postures[:, None],
        "reason": np.array(reasons),
        "solved_in": (ARM, scene, margin),
        "tasks": (),
    }
    return jaxik.ik.IKResult(**columns | given)


def test_a_result_names_offenders(scene):
    postures = np.random.default_rng(1).uniform(-2.0, 2.0, (7, 4))
    result = ended(scene, postures, [Reason.COLLISION] * 6 + [Reason.SOLVED], 0.2)
    assert len(result.offenders) == 7 and result.offenders[6] == () == result[6].offenders
    for q, each, row in zip(postures[:6], result.offenders, result, strict=False):
        everything = jaxik.explain(ARM, scene, q, count=99).contacts
        near = [str(c) for c in everything if c.distance < 0.2] or [str(everything[0])]
        assert [str(c) for c in each] == [str(c) for c in row.offenders] == near
    assert result.offenders is result.offenders  # looked up once
    assert str(result.offenders).splitlines()[1] == f"target 1: {'; '.join(map(str, result.offenders[1]))}"
    assert [len(o) for o in result[2:4].offenders] == [len(o) for o in result.offenders[2:4]]
    assert ended(None, postures, [Reason.COLLISION] * 7)[0].offenders  # the arm alone
    assert not dataclasses.replace(result, solved_in=None).offenders[0]


def test_the_command_names_offenders(scene):
    """The most frequent pair first."""
    postures = np.random.default_rng(1).uniform(-2.0, 2.0, (7, 4))
    nearest = [jaxik.explain(ARM, scene, q).contacts[0] for q in postures]
    said = offenders(ended(scene, postures, [Reason.COLLISION] * 7)).removeprefix("of 7 that collide: ")
    counts = [int(part.split()[0]) for part in said.split(", ")]
    assert sum(counts) == 7 and counts == sorted(counts, reverse=True)
    assert all(f"by {c.link} and {c.other}" in said for c in nearest)

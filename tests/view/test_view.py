"""The page without a browser, the pictures, and their colours. `view_page.py` looks at the page in one."""

import dataclasses
import itertools

import numpy as np
import pytest

import jaxik
from jaxik.view import Page
from jaxik.view.palette import CHOSEN, COLOURS, LEFT_OUT, PARTLY, rgb
from jaxik.view.solids import Solid, box_solids, scene_points, scene_solids, volume_solids
from jaxik.view.sweep_picture import categories, plot_sweep, variant_map

STUDY = {
    "robot": "p6r",
    "slides": 11,
    "chunk": 100,
    "audited": 0,
    "base": {"z": [0.0, 0.1]},
    "targets": {"kind": "grid", "x": [0.0, 1.0, 3], "y": [0.4, 0.7, 3], "z": [0.2, 0.6, 3], "directions": [[0, 1, 0]]},
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    done = jaxik.sweep(STUDY, tmp_path_factory.mktemp("view") / "row.zarr")
    assert done.counts()["solved"]
    return done.path


def test_a_store_of_another_robot_is_refused(store):
    p6r = jaxik.load("p6r")
    for robot, words in (
        (jaxik.load("planar2"), "row.zarr: holds p6r, not planar2"),
        (dataclasses.replace(p6r, joint_names=tuple("abcdefg")), "row.zarr: holds another p6r"),
        (p6r.with_tool(np.diag([1.0, -1.0, -1.0, 1.0])), "row.zarr: holds another p6r"),
    ):
        with pytest.raises(ValueError, match=words) as error:
            Page(robot, store=store)
        assert "\n" not in str(error.value)


def test_the_same_robot_is_shown_with_and_without_its_shapes(store):
    """Where the study did not read the meshes that the page shows, the robots differ and the robot does not."""
    for robot in (jaxik.load("p6r"), dataclasses.replace(jaxik.load("p6r"), boxes=())):
        page = Page(robot, store=store, port=0)
        assert page.url.startswith("http://127.0.0.1:")
        assert list(page.map.indices) == ["base z=0", "base z=0.1"] and "reachable (" in page.map.legend.content
        page.map.colour.value = "limit margin"
        assert "limit margin" in page.map.legend.content
        page.map.cuts[0].value = (0.9, 0.95)
        assert "Nothing is reachable here" in page.map.legend.content
        page.close()


def test_a_cell_without_a_fruit_is_shown(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(
        'name = "cell"\n[[object]]\nname = "a"\nboxes = [[0.5, 0, 0, 1, 1, 1]]\ncapsules = [[0, 0, 0, 1, 0, 0, 0.1]]\n'
        '[[object]]\nname = "sheet"\npolygons = [[[1.5, -1, 0], [1.5, 1, 0], [1.6, 1, 0], [1.6, -1, 0]]]\n'
    )
    page = Page(jaxik.load("planar2"), scene=jaxik.load_scene(path), port=0)
    assert "sheet" in page.near.content and "sheet" in page.drawing.hit
    page.close()


# Linear RGB as eyes without green or without red cones see it: Machado, Oliveira, Fernandes 2009, table 1, severity 1.
DEUTERANOPIA = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
PROTANOPIA = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]


def lab(colour, eyes):
    """CIE L*a*b* of a colour as it is seen."""
    share = np.array(rgb(colour)) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    x, y, z = np.cbrt(XYZ @ np.clip(eyes @ linear, 0.0, 1.0) / [0.95047, 1.0, 1.08883])
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("eyes", [np.eye(3), DEUTERANOPIA, PROTANOPIA], ids=["all", "no green", "no red"])
def test_reasons_are_told_apart(eyes):
    """Reasons differ in colour, and by their lightness alone, as a grey print has it."""
    for a, b in itertools.combinations([*COLOURS.values(), PARTLY], 2):
        assert np.linalg.norm(lab(a, eyes) - lab(b, eyes)) > 15.0, (a, b)
        assert eyes is not np.eye(3) or abs(lab(a, eyes)[0] - lab(b, eyes)[0]) > 9.0, (a, b)


def test_outlines_hold_what_they_outline(tmp_path):
    """A capsule's, a box's and a ball's."""
    capsule = Solid("a", np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 0.1)
    assert np.allclose([capsule.outline(0, 2).min(axis=0), capsule.outline(0, 2).max(axis=0)], [[-0.1, -0.1], [0.1, 1.1]])
    assert np.allclose(capsule.span, [[-0.1, -0.1, -0.1], [0.1, 0.1, 1.1]])
    path = tmp_path / "cell.toml"
    objects = {
        "box": "boxes = [[0.5, 0.0, 0.0, 1.0, 0.4, 0.2]]",
        "ball": "spheres = [[0.0, 0.0, 0.0, 0.3]]",
        "pole": "cylinders = [[0.0, 0.0, 0.5, 0.1, 1.0]]",
        "leaf": "points = [[0.0, 1.0, 0.0], [0.0, 1.0, 0.1]]",
        "sheet": "triangles = [[0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0]]",
    }
    path.write_text('name = "cell"\n' + "".join(f'[[object]]\nname = "{name}"\n{shapes}\n' for name, shapes in objects.items()))
    scene = jaxik.load_scene(path)
    solids = {solid.owner: solid for solid in scene_solids(scene.padded().without("ball"))}
    assert set(solids) == {"box", "pole", "sheet"} and np.ptp(solids["sheet"].outline(0, 1), axis=0).tolist() == [2.0, 1.0]
    assert np.allclose(np.ptp(solids["box"].outline(0, 1), axis=0), [1.0, 0.4])
    assert np.allclose(solids["pole"].span[:, 2], [0.0, 1.0])
    points, owners = scene_points(scene)
    assert points.shape == (2, 3) and set(owners) == {"leaf"}


def test_a_place_has_its_best_direction(store, tmp_path):
    """All, some, or the reason that is nearest to an answer; and the picture is drawn with what stands there."""
    from jaxik.view.sweep_picture import open_store

    shown = variant_map(open_store(store), (0,))
    found, kinds = categories(shown)
    assert np.array_equal(found == 0, shown.share == 1.0)
    assert {kinds[k][0] for k in np.unique(found)} <= {"reachable", "out of reach", "a joint would pass its limit"}
    turned = shown._replace(reason=np.tile([jaxik.Reason.OUT_OF_REACH, jaxik.Reason.COLLISION], len(found)), share=0.0 * found)
    turned.reason[0], turned.share[0], turned.reason[-2:] = jaxik.Reason.SOLVED, 0.5, -1
    found, kinds = categories(turned)
    words = [kinds[k][0] for k in found[:-1]]
    assert words[0] == "reachable from some directions" and set(words[1:]) == {"would hit something"} and found[-1] == -1
    plot_sweep(store, tmp_path / "row.png", scene=jaxik.load_scene("cucumber_row"))
    assert (tmp_path / "row.png").read_bytes()[:4] == b"\x89PNG"


@pytest.fixture(scope="module")
def page():
    page = Page(jaxik.load("p6r"), scene=jaxik.load_scene("cucumber_row"), port=0)
    yield page
    page.close()


def test_the_page_names_what_collides(page):
    page.move(np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1]))
    assert "Collides:</b> gripper and fruit_2, by 9.0 mm" in page.near.content
    red = rgb(COLOURS[jaxik.Reason.COLLISION])
    struck = {page.robot.link_names[link] for link, part in page.drawing.parts if tuple(part.color) == red}
    assert struck == {"gripper"} and page.drawing.hit == {"gripper", "fruit_2"}
    page.move(np.zeros(7))
    assert "Clear:" in page.near.content and not page.drawing.hit


def test_the_robot_follows_a_target_or_says_why_not(page):
    q = np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1])
    page.move(q)
    world_T_tip = np.asarray(page.robot.world_T_base) @ np.asarray(jaxik.forward_kinematics(page.robot, q))
    assert np.allclose(page.gizmo.position, world_T_tip[:3, 3])
    world_T_tip[2, 3] += 0.02
    assert page.reach(world_T_tip) == jaxik.Reason.SOLVED and "reached" in page.said.content
    there = np.asarray(page.robot.world_T_base) @ np.asarray(jaxik.forward_kinematics(page.robot, page.q))
    assert np.allclose(there, world_T_tip, atol=1e-5) and np.max(np.abs(page.q - q)) < 0.5
    q = page.q
    world_T_tip[0, 3] += 9.0
    assert page.reach(world_T_tip) == jaxik.Reason.OUT_OF_REACH and "out of reach" in page.said.content
    assert np.array_equal(page.q, q)


def test_a_posture_is_exact_and_its_sliders_are_rounded(page):
    """A slider that is not touched does not move its joint."""
    q = np.array([0.12345678, 0.1, -0.5, -0.4, 0.3, 0.5, 0.1])
    page.move(q)
    assert page.sliders.each[0].value == 0.123 and page.sliders.each[1].value == 5.7 and np.array_equal(page.q, q)
    panda_like = dataclasses.replace(page.home, lower=np.radians([0.0, -117.97201, -117.97201, -90.0, -90.0, -90.0, -90.0]))
    other = Page(panda_like, port=0)
    assert other.sliders.each[1].min == -118.0 and other.sliders.limits[0, 1] == panda_like.lower[1]
    other.close()


def test_a_robot_without_shapes_has_its_joints():
    """The unknown clearance is said, and a target is followed all the same."""
    robot = dataclasses.replace(jaxik.load("p6r"), boxes=())
    page = Page(robot, scene=jaxik.load_scene("cucumber_row"), port=0)
    assert "Clearance unknown. p6r: has no collision geometry" in page.near.content and not page.drawing.parts
    q = np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1])
    world_T_tip = np.asarray(robot.world_T_base) @ np.asarray(jaxik.forward_kinematics(robot, q))
    assert page.reach(world_T_tip) == jaxik.Reason.SOLVED
    page.close()


BOX = '<collision><geometry><box size="{0}"/></geometry></collision>'
BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
ENDS = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/><axis xyz="0 0 1"/>'
JOINT = ENDS + '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
SHAPES = {"base": BOX, "arm": BOX, "hand": BOX, "tip": BALL}


@pytest.fixture(scope="module")
def bars(tmp_path_factory):
    """Three bars in one place, which always touch, and a ball that never touches the first two."""
    links = "".join(f'<link name="{n}">{shape.format("0.1 0.1 0.4")}</link>' for n, shape in SHAPES.items())
    rows = (("turn", "base", "arm", "0 0 0"), ("bend", "arm", "hand", "0 0 0"), ("roll", "hand", "tip", "0 0 0.5"))
    path = tmp_path_factory.mktemp("bars") / "bars.urdf"
    path.write_text(f'<robot name="bars">{links}{"".join(JOINT.format(*row) for row in rows)}</robot>')
    return path


def colours(page, links, kind):
    """The colours of the meshes of some links, of their own shapes or of their volumes."""
    parts = [(page.robot.link_names[link], part) for link, part in page.drawing.parts if part.name.startswith(f"/{kind}/")]
    return {tuple(part.color) for name, part in parts if name in links}


@pytest.mark.parametrize("exact", [False, True], ids=["capsules", "exact"])
def test_a_model_is_drawn_with_its_shapes(bars, exact):
    """Both half transparent, or one alone; and the links that touch and are not checked, and are no neighbours, in a colour."""
    with pytest.warns(UserWarning, match="base and hand in 100%"):
        robot = jaxik.load(bars, meshes=True, exact=exact)
    page = Page(robot, port=0, meshes=() if exact else jaxik.files.link_meshes(bars))
    own, volumes = ({link: p for link, p in page.drawing.parts if p.name.startswith(f"/{k}/")} for k in ("shape", "volumes"))
    assert set(own) == set(volumes) == {0, 1, 2, 3}
    for link in (0, 1, 2):  # the bars' corners, and what holds them
        assert np.allclose(np.abs(own[link].vertices), [0.05, 0.05, 0.2])
        assert np.all(np.max(np.abs(volumes[link].vertices), axis=0) >= [0.05, 0.05, 0.2])
    assert np.allclose(np.linalg.norm(own[3].vertices, axis=1), 0.0495)
    assert page.drawing.shape.value and page.drawing.volumes.value and own[0].opacity < 1.0
    page.drawing.volumes.value = False
    assert own[0].opacity is None and [root.visible for root in page.drawing.roots.values()] == [True, False]
    page.drawing.volumes.value, page.drawing.shape.value = True, False
    assert volumes[0].opacity < 1.0 and [root.visible for root in page.drawing.roots.values()] == [False, True]
    assert "touch, and not checked" in page.legend.content and "volumes kept clear" in page.legend.content
    for kind in ("shape", "volumes"):
        assert colours(page, {"base", "hand"}, kind) == {rgb(LEFT_OUT)} and rgb(LEFT_OUT) not in colours(
            page, {"arm", "tip"}, kind
        )
    page.close()


def test_pairs_that_are_not_checked_are_listed(bars):
    """With the reason, the share and the depth; a row shows its two links, and none again."""
    with pytest.warns(UserWarning, match="base and hand in 100%"):
        robot = jaxik.load(bars, meshes=True, ignore=[("arm", "tip")])
    page = Page(robot, port=0)
    listed, rows = page.unchecked.list.content, page.unchecked.rows
    assert {row.links for row in rows} == {each.links for each in robot.unchecked} and rows[0].links == ("base", "hand")
    for words in (
        "their surfaces mostly touch (1)",
        "neighbours whose surfaces mostly touch (2)",
        "named: by you",
        "never touch",
    ):
        assert words in listed
    assert listed.count("data-pair='") == len(rows) and "100%" in listed and f"{1e3 * rows[0].depth:.1f} mm" in listed
    page.unchecked.choose(1)
    assert (
        colours(page, rows[1].links, "volumes") == {rgb(CHOSEN)} and " and ".join(rows[1].links) in page.unchecked.field.value
    )
    page.move(np.full(3, 0.1))  # it stays
    assert colours(page, rows[1].links, "volumes") == {rgb(CHOSEN)}
    for word in ("pair: 99", "pair: ?", "pair: none", "pair: \u00b2"):  # what a browser may send
        page.unchecked.choose(0)
        page.unchecked.field.value = word
        page.unchecked._told()
        assert page.unchecked.field.value == "pair: none" and not page.drawing.chosen
    page.close()


def test_names_of_a_file_are_no_html(bars):
    with pytest.warns(UserWarning):
        robot = jaxik.load(bars, meshes=True)
    names = tuple(f"<img src=x onerror=alert(1)>{name}" for name in robot.link_names)
    bad = dict(zip(robot.link_names, names, strict=True))
    left = tuple(dataclasses.replace(u, links=tuple(bad[n] for n in u.links)) for u in robot.unchecked)
    page = Page(dataclasses.replace(robot, link_names=names, unchecked=left), port=0)
    assert "<img" not in page.unchecked.list.content and "&lt;img" in page.unchecked.list.content
    page.close()


@pytest.mark.parametrize("name, drawn", [("iiwa7", False), ("ur10e_rail", True), ("p6r", True)])
def test_a_robot_without_meshes_is_its_volumes(name, drawn):
    """Volumes are drawn once; beside boxes they can be shown; the pairs of its file have no reason."""
    page = Page(robot := jaxik.load(name), port=0)
    assert page.drawing.volumes.visible == drawn and not page.drawing.volumes.value and page.drawing.shape.value
    assert "volumes kept clear" not in page.legend.content
    page.drawing.volumes.value = drawn
    assert ("volumes kept clear" in page.legend.content) == drawn
    solid = {link for link, part in page.drawing.parts if part.name.startswith("/shape/")}
    assert len(page.unchecked.rows) + len(robot.self_pairs) == len(solid) * (len(solid) - 1) // 2
    assert "by the robot's file" in page.unchecked.list.content
    page.close()


def test_room_for_what_is_held_is_not_drawn_until_something_is():
    robot, scene = jaxik.load("panda"), jaxik.make_scene(spheres=[[0.5, 0.0, 0.4, 0.03]])
    arm = jaxik.collision.with_room(robot, spheres=8, capsules=1, triangles=2)
    held = jaxik.collision.attach(arm, scene, "spheres_1", np.zeros(7)).robot
    for solids in (box_solids, volume_solids):
        drawn = len(solids(robot))
        assert [len(solids(each)) for each in (arm, held)] == [drawn, drawn + 1]
        assert solids(held)[-1][1].span.shape == (2, 3)

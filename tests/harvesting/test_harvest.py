"""The harvest of a generated row: what it calls solved is solved, and what it says must go is enough and least."""

import dataclasses
import itertools
from functools import partial
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxik
from jaxik.files.scene import save_scene
from jaxik.harvesting.blocking_objects import Touched, unblocked
from jaxik.reasons import Reason
from jaxik.view.pictures import fate, in_the_way, posture


@pytest.fixture(scope="module")
def harvest():
    return jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"), margin=0.005)


def test_it_prints_as_a_line_a_fruit(harvest):
    lines = str(harvest).splitlines()
    assert len(lines) == 1 + len(harvest) == 13 and lines[0].startswith("Harvest of cucumber_row") and "mm" in lines[1]


def test_rows_are_results(harvest):
    """A row has its own truth and numbers; the whole has none, and says of each what would help."""
    solved, blocked = harvest[0], harvest[3]
    assert solved and not blocked and len(harvest) == 12 == len(list(harvest)) and harvest.q.shape == (12, 7)
    assert solved.fruit == "fruit_1" and solved.q.shape == (7,) and solved.found_by == "grid" and np.isnan(blocked.q).all()
    assert harvest.why[3] == blocked.why == "collision: take away leaf_4_1"
    assert harvest.counts() == {
        "solved": 10,
        "collision": 2,
    }
    assert harvest[harvest.success].fruit == tuple(row.fruit for row in harvest if row)
    with pytest.raises(ValueError, match="the truth of 12 fruits is not one answer"):
        bool(harvest)
    far = dataclasses.replace(blocked, blockers=None, reason=Reason.OUT_OF_REACH)
    assert far.why == "out of reach; bring the base nearer to it"


def test_progress_counts_fruits():
    scene, seen = jaxik.load_scene("cucumber_row"), []
    jaxik.harvest(jaxik.load("p6r"), scene, angles=4, slides=2, progress=lambda *done: seen.append(done))
    assert seen == [(i + 1, 12) for i in range(12)]


def test_solved_is_solved(harvest):
    robot, scene = harvest.robot, harvest.scene
    assert harvest.success.sum() >= 8
    for row in (r for r in harvest if r.success):
        own = scene.object_names.index(row.fruit)
        assert np.all((row.q >= robot.lower - 1e-6) & (row.q <= robot.upper + 1e-6))
        assert row.position_error <= 2e-6 and row.rotation_error <= 2e-5
        assert jaxik.clearance(robot, scene.without([own]), row.q) >= 0.005 - 1e-5


def _contacts(robot, scene, q):
    return jaxik.collision.object_clearances(robot, scene, q), jaxik.clearance(robot, None, q)


def _opened_by_brute_force(harvest, row):
    """A function of a set of objects: whether a posture of a fruit's table is free without them."""
    own = harvest.scene.object_names.index(row.fruit)
    each = jax.jit(jax.vmap(partial(_contacts, harvest.robot, harvest.scene.without([own]))))
    distance, to_itself = (np.asarray(x) for x in each(row.scan.table.q))
    margin = harvest.options.margin
    return lambda gone: bool(np.any((np.delete(distance, gone, axis=1).min(axis=1) >= margin) & (to_itself >= margin)))


def test_what_has_to_go_opens_a_posture_and_nothing_cheaper_does(harvest):
    """Fewer leaves do not, with all fruits picked that can be; nor do as many with fewer fruits."""
    numbers = lambda names: [harvest.scene.object_names.index(name) for name in names]
    pickable = numbers(row.fruit for row in harvest if row.success)
    leaves = [i for i, removable in enumerate(harvest.scene.removable) if removable]
    blocked = [row for row in harvest if row.reason == Reason.COLLISION]
    assert blocked
    for row in blocked:
        opened = _opened_by_brute_force(harvest, row)
        picked, removed = (numbers(names) for names in (row.blockers.pick_first, row.blockers.removal))
        assert opened([*picked, *removed]) and set(picked) <= set(pickable) and set(removed) <= set(leaves)
        for few in itertools.combinations(leaves, max(len(removed) - 1, 0)) if removed else ():
            assert not opened([*pickable, *few])
        for n in range(len(picked)):
            for some, few in itertools.product(
                itertools.combinations(pickable, n), itertools.combinations(leaves, len(removed))
            ):
                assert not opened([*some, *few])


def test_a_neighbour_is_picked_before_a_leaf_is_taken_away(harvest):
    """Either opens fruit_12 of the shipped row; nothing but a leaf opens fruit_4."""
    rows = {row.fruit: row for row in harvest}
    names, twelve = harvest.scene.object_names, rows["fruit_12"]
    assert twelve.blockers.pick_first == ("fruit_7",) and twelve.blockers.removal == () and rows["fruit_7"].success
    assert _opened_by_brute_force(harvest, twelve)([names.index("leaf_2_3")])
    assert twelve.why == "collision: pick fruit_7" and rows["fruit_4"].why == "collision: take away leaf_4_1"
    assert "fruit_12: collision: pick fruit_7" in str(harvest) and rows["fruit_7"].why == "solved"
    arrays = harvest.arrays()
    assert arrays["pick_first"][11] == "fruit_7" and arrays["remove"][11] == "" and arrays["remove"][3] == "leaf_4_1"
    alone = twelve.scan.blockers()  # nobody says what can be picked
    assert alone.pick_first == () and alone.removal == ("leaf_2_3",)
    with pytest.raises(ValueError, match=r"blockers: pickable: no fruit 'fruit_77'"):
        twelve.scan.blockers(pickable=["fruit_77"])


@pytest.mark.parametrize("gate, mend", [("fruit", "pick gate"), ("leaf", "take away gate"), ("stem", "")])
def test_what_stands_in_the_only_way(gate, mend):
    """Posts that may not go stand all around a fruit, but where the gate is."""
    builder = jaxik.collision.SceneBuilder("cage", point_radius=0.01)
    builder.add_mark("inner", (0.5, 0.66, 0.6), length=0.1, radius=0.02)
    ring = [(0.5 + 0.11 * np.sin(a), 0.66 - 0.11 * np.cos(a), z) for a in np.linspace(0.9, 5.4, 15) for z in (0.5, 0.6, 0.7)]
    builder.add("posts", removable=False, points=ring)
    if gate == "fruit":
        builder.add_mark("gate", (0.5, 0.53, 0.62), length=0.2, radius=0.03)
    else:
        builder.add("gate", removable=gate == "leaf", capsules=[[0.5, 0.53, 0.62, 0.5, 0.53, 0.42, 0.03]])
    harvest = jaxik.harvest(jaxik.load("p6r"), builder.scene(), angles=24, slides=11, margin=0.005)
    inner = harvest[0]
    assert inner.reason == Reason.COLLISION and inner.blockers.mend == mend
    opened, gone = _opened_by_brute_force(harvest, inner), harvest.scene.object_names.index("gate")
    assert opened([gone]) and not opened([])
    assert fate(inner) == (f"blocked; first {mend}" if mend else f"hidden behind {', '.join(inner.blockers.names)}")
    if gate == "fruit":
        assert harvest[1].success


def _touched(*sets):
    names = ("leaf_1", "leaf_2", "a", "b", "c", "d")
    scene = SimpleNamespace(object_names=names, removable=(True, True, False, False, False, False))
    hit = np.array([[name in each for name in names] for each in sets])
    return Touched(scene, hit.mean(axis=0), hit, np.arange(len(sets)), np.zeros(len(sets)))


def test_fruits_that_others_open_are_picked_first_in_turn():
    """b after a, c after b, though a leaf would do; d only with a leaf, which then opens e. Two that wait for each other do."""
    touched = {"b": _touched({"a"}, {"leaf_1"}), "c": _touched({"leaf_2"}, {"a", "b"}, {"b"}), "d": _touched({"a", "leaf_1"})}
    found = unblocked(touched | {"e": _touched({"d", "a"})}, ["a"])
    assert {name: each.mend for name, each in found.items()} == {
        "b": "pick a",
        "c": "pick b",
        "d": "pick a, take away leaf_1",
        "e": "pick a and d",
    }
    waiting = unblocked({"c": _touched({"d"}), "d": _touched({"c"})}, ["a", "b"])
    assert {name: each.words for name, each in waiting.items()} == {"c": "behind d", "d": "behind c"}
    assert unblocked({"c": _touched({"leaf_1", "leaf_2"}, {"d"})}, [])["c"].mend == "take away leaf_1 and leaf_2"
    assert unblocked({}, ["a"]) == {}


def test_the_shipped_row_is_the_generators(tmp_path):
    path = tmp_path / "row.toml"
    save_scene(jaxik.harvesting.make_row(seed=0), path)
    shipped, made = jaxik.load_scene("cucumber_row"), jaxik.load_scene(path)
    assert shipped.object_names == made.object_names
    assert np.array_equal(shipped.points.center, made.points.center)


@pytest.mark.parametrize(
    "text, words",
    [
        ('name = "s"\n', "neither an object nor a mark"),
        ('name = "s"\n[[mark]]\nname = "f"\nposition = [0, nan, 0]\n', "NaN"),
        ('name = "s"\n[[mark]]\nname = "f"\nposition = [0, 700, 0]\n', "over 100 m"),
        ('name = "s"\n[[mark]]\nname = "f"\nposition = [0, 1, 0]\n[[mark]]\nname = "f"\nposition = [0, 1, 0]\n', "twice"),
        ('name = "s"\n[[mark]]\nname = "f"\nposition = [0, 1, 0]\ncolour = 1\n', "unknown key"),
        ("[broken", "malformed TOML"),
    ],
)
def test_a_bad_scene_is_one_line(tmp_path, text, words):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(jaxik.LoadError, match=words) as error:
        jaxik.load_scene(path)
    assert "\n" not in str(error.value) and "scene.toml" in str(error.value)


def test_the_picture_says_what_became_of_each_fruit(harvest):
    """The words; and, for a blocked fruit, the posture that would be free without what is in the way."""
    clear = jax.jit(jaxik.clearance, static_argnums=0)
    for row in harvest:
        if row.success:
            assert fate(row) == f"{1000 * row.clearance:.0f} mm clear" and in_the_way(row) == ()
            assert np.array_equal(posture(row), row.q)
        else:
            scene = harvest.scene.without(row.fruit)
            assert fate(row) == f"blocked; first {row.blockers.mend}" and row.blockers.in_the_way == in_the_way(row) != ()
            opened = clear(harvest.robot, scene.without(in_the_way(row)).padded(), posture(row))
            assert opened >= 0.005 - 1e-5 > clear(harvest.robot, scene.padded(), posture(row))
    hidden = harvest[3]
    names = dataclasses.replace(hidden, blockers=hidden.blockers._replace(removal=None, names=("stem_1", "wire"), row=None))
    assert fate(names) == "hidden behind stem_1, wire" and posture(names) is None
    assert fate(dataclasses.replace(names, blockers=names.blockers._replace(names=()))) == "the arm would hit itself"
    assert fate(dataclasses.replace(hidden, blockers=None, reason=Reason.OUT_OF_REACH)) == "out of reach"

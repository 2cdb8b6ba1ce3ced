"""The harvest of a generated row: what it calls solved is solved, and what it says must go is enough and least."""

import itertools
from functools import partial

import jax
import numpy as np
import pytest

import jaxik
from jaxik.files.scene import save_scene
from jaxik.harvesting.crop import cucumber_row
from jaxik.reasons import Reason
from jaxik.view.harvest_picture import fate, in_the_way, posture


@pytest.fixture(scope="module")
def harvest():
    return jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"))


def test_it_prints_as_a_line_a_fruit(harvest):
    lines = str(harvest).splitlines()
    assert len(lines) == 1 + len(harvest.rows) and lines[0].startswith("Harvest of cucumber_row") and "mm" in lines[1]


def test_solved_is_solved(harvest):
    chain, scene = harvest.chain, harvest.scene
    assert harvest.success.sum() >= 8
    for row in (r for r in harvest.rows if r.success):
        own = scene.object_names.index(row.fruit)
        assert np.all((row.q >= chain.lower - 1e-6) & (row.q <= chain.upper + 1e-6))
        assert row.position_error <= 2e-6 and row.rotation_error <= 2e-5
        assert jaxik.clearance(chain, scene.without([own]), row.q) >= 0.005 - 1e-5


def _contacts(chain, scene, q):
    return jaxik.collision.object_clearances(chain, scene, q), jaxik.collision.self_clearance(chain, q)


def test_removal_opens_a_posture_and_no_smaller_set_does(harvest):
    chain, scene = harvest.chain, harvest.scene
    blocked = [row for row in harvest.rows if row.reason == Reason.COLLISION]
    assert blocked
    for row in blocked:
        own = scene.object_names.index(row.fruit)
        each = jax.jit(jax.vmap(partial(_contacts, chain, scene.without([own]))))
        distance, to_itself = (np.asarray(x) for x in each(row.scan.table.q))
        removal = row.blockers.removal
        assert removal is not None
        leaves = [i for i, r in enumerate(scene.removable) if r]
        sets = [s for n in range(len(removal)) for s in itertools.combinations(leaves, n)]
        for gone in [*sets, tuple(scene.object_names.index(n) for n in removal)]:
            kept = np.delete(distance, gone, axis=1).min(axis=1)
            opened = bool(np.any((kept >= 0.005) & (to_itself >= 0.005)))
            assert opened == (len(gone) == len(removal))


def test_the_shipped_row_is_the_generators(tmp_path):
    path = tmp_path / "row.toml"
    save_scene(cucumber_row(0), path)
    shipped, made = jaxik.load_scene("cucumber_row"), jaxik.load_scene(path)
    assert shipped.object_names == made.object_names
    assert np.array_equal(shipped.points.center, made.points.center)


@pytest.mark.parametrize(
    "text, words",
    [
        ('name = "s"\n', "neither an object nor a fruit"),
        ('name = "s"\n[[fruit]]\nname = "f"\nposition = [0, nan, 0]\n', "NaN"),
        ('name = "s"\n[[fruit]]\nname = "f"\nposition = [0, 700, 0]\n', "over 100 m"),
        ('name = "s"\n[[fruit]]\nname = "f"\nposition = [0, 1, 0]\n[[fruit]]\nname = "f"\nposition = [0, 1, 0]\n', "twice"),
        ('name = "s"\n[[fruit]]\nname = "f"\nposition = [0, 1, 0]\ncolour = 1\n', "unknown key"),
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
    """In words; and of a fruit that is blocked it shows the posture that would be free without what is in the way."""
    clear = jax.jit(jaxik.clearance, static_argnums=0)
    for row in harvest.rows:
        if row.success:
            assert fate(row) == f"{1000 * row.clearance:.0f} mm clear" and in_the_way(row) == () and posture(row) is row.q
        else:
            scene = harvest.scene.without(row.fruit)
            assert fate(row) == f"blocked; take away {', '.join(in_the_way(row))}"
            opened = clear(harvest.chain, scene.without(in_the_way(row)).padded(), posture(row))
            assert opened >= 0.005 - 1e-5 > clear(harvest.chain, scene.padded(), posture(row))
    hidden = harvest.rows[3]
    names = hidden._replace(blockers=hidden.blockers._replace(removal=None, names=("stem_1", "wire"), row=None))
    assert fate(names) == "hidden behind stem_1, wire" and posture(names) is None
    assert fate(hidden._replace(blockers=names.blockers._replace(names=()))) == "the arm would hit itself"
    assert fate(hidden._replace(blockers=None, reason=Reason.OUT_OF_REACH)) == "out of reach"

"""Random inputs: the documented answer, or one line that says what is wrong; never a crash, never another question answered."""

import dataclasses

import jax
import jaxtyping
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import jaxik

ARM, P6R = jaxik.load("planar2"), jaxik.load("p6r")
SCENE = jaxik.make_scene(spheres=[[3.0, 0.0, 0.0, 0.1]])
ODD = st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e300, -1.0, 0.0, 0.5])
SCALARS = st.one_of(
    ODD,
    st.integers(-3, 600),
    st.booleans(),
    st.none(),
    st.text(max_size=3),
    st.builds(np.int64, st.integers(-3, 9)),
    st.complex_numbers(),
)
DTYPES = ("f8", "f4", "i8", "i4", "u1", "?", "c16", "O", "U3")


@st.composite
def arrays(draw):
    """Of any shape up to three axes (an axis may be empty) and of many dtypes; as arrays and as nested lists."""
    shape = draw(st.lists(st.sampled_from([0, 1, 2, 3, 4, 6, 7]), max_size=3))
    values = (
        np.full(shape, draw(ODD)) if draw(st.booleans()) else np.random.default_rng(draw(st.integers(0, 9))).normal(size=shape)
    )
    with np.errstate(all="ignore"):
        made = values.astype(draw(st.sampled_from(DTYPES)))
    return draw(st.sampled_from([lambda x: x, lambda x: x.tolist()]))(made)


@pytest.fixture(autouse=True, scope="module")
def _without_the_tests_own_types():
    """What users have: the library without the hook that checks its annotations."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


ANYTHING = st.one_of(SCALARS, arrays(), st.just([[1.0], [1.0, 2.0]]), st.just({}), st.just(object()))
cheap = settings(max_examples=60, deadline=None, derandomize=True)


def answer(function, *given):
    """What comes, or None where it is refused in one line that does not end in a data dump."""
    try:
        with np.errstate(all="ignore"), jax.enable_x64(True):
            return function(*given)
    except (ValueError, TypeError) as error:
        assert "\n" not in str(error) and 0 < len(str(error)) < 400, str(error)
        return None


def plain(value, *shape):
    """Whether it is an array of real numbers of that shape."""
    try:
        array = np.asarray(value)
    except ValueError:
        return False
    return array.dtype.kind in "iuf" and array.shape == shape


@cheap
@given(ANYTHING)
def test_configurations(q):
    assume(not plain(q, 2))  # those are what every other test is about
    for function in (jaxik.forward_kinematics, jaxik.jacobian, lambda chain, q: jaxik.clearance(chain, SCENE, q)):
        assert answer(function, ARM, q) is None


@pytest.mark.parametrize(
    "q", [[0, 1], np.array([0, 1], np.int64), np.array([0, 1], np.float32), (0.0, 1.0), np.array([0, 1], np.uint8)]
)
def test_configurations_of_whole_numbers_and_lists(q):
    expected = jaxik.forward_kinematics(ARM, np.array([0.0, 1.0]))
    assert np.allclose(jaxik.forward_kinematics(ARM, q), expected, atol=1e-6)


@cheap
@given(ANYTHING)
def test_closed_forms(value):
    if not plain(value, 4, 4):
        assert answer(jaxik.closed_form, P6R, value, 0.3) is None
    if not plain(value) and not plain(value, 1):
        assert answer(jaxik.closed_form, P6R, np.eye(4), value) is None


@cheap
@given(ANYTHING, ANYTHING)
def test_tasks(bound, axes):
    task = answer(lambda: jaxik.Task(bound, axes))
    assert task is None or (len(task.bound) == 6 and axes in ("tool", "base"))
    task = answer(lambda: jaxik.Task(bound))
    if task is not None:
        assert np.array_equal(np.asarray(bound, bool), task.bound) and hash(task) == hash(jaxik.Task(tuple(map(bool, bound))))


@cheap
@given(ANYTHING)
def test_spheres_a_box(count):
    chain = answer(ARM.with_spheres, count)
    assert chain is None or (chain.spheres_per_box == count and type(chain.spheres_per_box) is int)


COUNTS, NUMBERS = ("max_seeds", "solutions", "cost_iterations"), ("margin", "distinct", "activation", "penalty")
WORDS = ("seeds", "choice", "collision", "norm", "task", "locked")


@cheap
@given(st.sampled_from((*COUNTS, *NUMBERS, *WORDS)), ANYTHING)
def test_options(name, value):
    options = answer(lambda: jaxik.IKOptions(**{name: value}))
    if options is None or name in WORDS:
        assert options is None or value == {}
        return
    assert plain(value) and np.isfinite(value) and getattr(options, name) == value
    assert value >= 1 and float(value).is_integer() if name in COUNTS else name == "margin" or value >= 0.0


def test_options_that_are_numpy_s():
    options = jaxik.IKOptions(max_seeds=np.int64(3), margin=np.float32(0.5), task=jaxik.Task([True] * 3 + [0] * 3))
    assert dataclasses.replace(options, max_seeds=3).max_seeds == 3 and options.task.bound == (True,) * 3 + (False,) * 3

"""Random inputs: the documented answer, or one line that says what is wrong; never a crash, never another question answered."""

import dataclasses

import equinox as eqx
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
    """Arrays of any shape up to three axes (an axis may be empty) and of many dtypes; as arrays and as nested lists."""
    shape = draw(st.lists(st.sampled_from([0, 1, 2, 3, 4, 6, 7]), max_size=3))
    values = (
        np.full(shape, draw(ODD)) if draw(st.booleans()) else np.random.default_rng(draw(st.integers(0, 9))).normal(size=shape)
    )
    with np.errstate(all="ignore"):
        made = values.astype(draw(st.sampled_from(DTYPES)))
    return draw(st.sampled_from([lambda x: x, lambda x: x.tolist()]))(made)


@pytest.fixture(autouse=True, scope="module")
def _without_the_tests_own_types():
    """The library as users have it, without the hook that checks its annotations."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


ANYTHING = st.one_of(SCALARS, arrays(), st.just([[1.0], [1.0, 2.0]]), st.just({}), st.just(object()))
cheap = settings(max_examples=60, deadline=None, derandomize=True)


def answer(function, *given):
    """Returns the answer, or None where it is refused in one line that does not end in a data dump."""
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
    for function in (jaxik.forward_kinematics, jaxik.jacobian, lambda robot, q: jaxik.clearance(robot, SCENE, q)):
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
    robot = answer(ARM.with_spheres, count)
    assert robot is None or (robot.spheres_per_box == count and type(robot.spheres_per_box) is int)


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


XY = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
LINE = jaxik.motions.Line(np.eye(4), np.eye(4))
MIRRORED, SCALED = np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([2.0, 2.0, 2.0, 1.0])
HORIZON = jaxik.motions.PredictOptions(dt=0.1, count=2, task=XY)
COST = jaxik.costs.quadratic_cost()
NOW = LINE.at(0.5, 1.0)
ZEROS = np.zeros(2)


def refused(words, function, *given, **options):
    """Checks that the call is refused in one line that says so."""
    with jax.enable_x64(True), pytest.raises(ValueError, match=words) as error:
        function(*given, **options)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


@pytest.mark.parametrize("made", [jaxik.motions.FollowOptions, jaxik.motions.PredictOptions])
@pytest.mark.parametrize("weights", [(1.0, -1.0), (1.0, 0.0), (1.0, np.nan), (1.0, np.inf), 2.0, (), [[1.0, 1.0]], "12"])
def test_weights_are_above_zero(made, weights):
    refused("weights", made, weights=weights)


def test_weights_and_accelerations_are_one_a_joint():
    """Numbers for joints that a robot does not have are refused; they were left out without a word."""
    for weights in ((1.0,), (1.0, 2.0, 3.0)):
        follow = jaxik.motions.FollowOptions(dt=0.1, task=XY, weights=weights)
        refused(r"weights .* planar2 .*; allowed: \(2,\)", jaxik.follow, ARM, LINE, 1.0, ZEROS, options=follow)
        horizon = dataclasses.replace(HORIZON, weights=weights)
        refused(r"weights .* planar2 .*; allowed: \(2,\)", jaxik.predict, ARM, LINE, 1.0, ZEROS, COST, options=horizon)
        hasty = jaxik.motions.FollowOptions(dt=0.1, task=XY, acceleration=weights)
        refused("one for each of the 2 joints", jaxik.follow, ARM, LINE, 1.0, ZEROS, options=hasty)
    for each in ((1.0, -1.0), (1.0, np.nan), 0.0, ()):
        refused("acceleration", jaxik.motions.FollowOptions, acceleration=each)
    lists = jaxik.motions.FollowOptions(weights=[1, 2], acceleration=np.array([1.0, np.inf]))  # programs are kept by it
    assert hash(lists) == hash(jaxik.motions.FollowOptions(weights=(1.0, 2.0), acceleration=(1.0, np.inf)))


@pytest.mark.parametrize("frame", [MIRRORED, SCALED, np.full((4, 4), np.nan)])
def test_a_path_of_no_rigid_frame(frame):
    """The path is refused; where it is traced, or got there behind the constructor, it has a reason."""
    refused("line: end is no rigid frame", jaxik.motions.Line, np.eye(4), frame)
    refused("arc: start is no rigid frame", jaxik.motions.Arc, frame, np.zeros(3), np.ones(3), 1.0)
    line = eqx.tree_at(lambda path: path.end, LINE, frame)
    refused("line: end", line.at, 0.5, 1.0)
    moved = jaxik.follow(ARM, line, 0.2, ZEROS + 0.1, dt=0.1, task=XY)
    assert moved.reason == jaxik.Reason.INVALID
    traced = jax.jit(lambda path: path.at(1.0, 1.0).pose)
    assert not np.isfinite(traced(line)).any(axis=1)[:3].any()
    assert np.array_equal(traced(LINE), np.eye(4))


@pytest.mark.parametrize("entry", [1e300, np.inf, np.nan, -1.0])
def test_a_curve_through_no_pose(entry):
    """The curve is refused; for one that held infinity the search for the nearest rotation did not end."""
    poses = np.stack([np.eye(4)] * 2)
    poses[1, :2, :2], poses[1, :3, 3] = [[0.8, -0.6], [0.6, 0.8]], 1.0
    poses[1, 0, 0] = entry
    refused("curve: pose 1 is no pose", jaxik.motions.Curve, poses)


def test_an_arc_about_no_axis():
    for axis in (np.zeros(3), [np.nan, 0.0, 1.0]):
        refused("arc: axis", jaxik.motions.Arc(np.eye(4), np.zeros(3), axis, 1.0).at, 0.5, 1.0)


@cheap
@given(
    st.sampled_from(
        (
            jaxik.motions.FollowOptions,
            jaxik.motions.PredictOptions,
            jaxik.optimise.DescentOptions,
            jaxik.reach.PostureOptions,
            jaxik.harvesting.Grasp,
        )
    ),
    st.data(),
)
def test_options_of_motions_and_scans(made, data):
    """None is a truth value where a number stands, not a number, or a task that is none."""
    field = data.draw(st.sampled_from([f for f in dataclasses.fields(made) if f.name != "limits"]))
    value = data.draw(ANYTHING)
    options = answer(lambda: made(**{field.name: value}))
    if options is not None:
        hash(options)  # programs are kept by it
        assert not isinstance(value, bool) and (value is None or not np.isnan(np.asarray(value, float)).any())


@cheap
@given(st.sampled_from(("q", "qdot", "u", "weights", "pose", "velocity", "gain")), ANYTHING)
def test_resolved_rates(name, value):
    """An array that is too long is refused; its rest was left out."""
    shapes = {"pose": (4, 4), "velocity": (6,), "gain": ()}
    if plain(value, *shapes.get(name, (2,))) or (name in ("qdot", "u", "weights") and value is None):
        return
    moved = NOW._replace(**{name: value}) if name in ("pose", "velocity") else NOW
    given = {"q": ZEROS, "motion": moved, "u": ZEROS, "task": XY} | ({} if moved is not NOW else {name: value})
    assert answer(lambda: jaxik.motions.resolve(ARM, **given)) is None


@cheap
@given(ANYTHING)
def test_other_arrays_and_counts(value):
    poses = np.tile(np.eye(4), (2, 1, 1))
    calls = {
        (2,): [
            lambda: jaxik.kinematics.turns(ARM, value),
            lambda: jaxik.motions.PredictiveController(ARM, COST, options=HORIZON).init(value),
        ],
        (2, 7): [lambda: jaxik.reach.reach_score(P6R, None, poses, value)],
        (4, 4): [lambda: jaxik.implicit_ik(ARM, value, ZEROS, task=XY)],
    }
    for shape, each in calls.items():
        assert plain(value, *shape) or [answer(call) for call in each] == [None] * len(each)
    if not plain(value) or np.asarray(value).dtype.kind not in "iu" or value < 1:
        counts = [
            lambda: jaxik.motions.PredictiveController(ARM, COST, options=HORIZON, iterations=value),
        ]
        counts += [lambda: jaxik.predict(ARM, LINE, 1.0, ZEROS, COST, options=HORIZON, starts=value)]
        assert [answer(call) for call in counts] == [None] * len(counts)
    if not isinstance(value, int) or not 0 <= value <= 7:
        assert answer(P6R.part, value, 7) is None or isinstance(value, np.integer)


def test_what_is_of_another_kind():
    fruit = jaxik.load_scene("cucumber_row").marks[0]
    for kind in ("options", "grasp"):
        refused(f"{kind} is False; write a jaxik", jaxik.harvesting.scan, P6R, SCENE, fruit, **{kind: False})
    refused("margin is nan", jaxik.harvesting.scan, P6R, SCENE, fruit, margin=np.nan)
    refused("fruit is 3", jaxik.harvesting.scan, P6R, SCENE, 3)
    refused("scene is 3", jaxik.harvest, P6R, 3)
    refused("robot is 3", jaxik.harvest, 3, SCENE)
    refused("study is 3; write a TOML file's name", jaxik.sweeps.Study.of, 3)
    for call in (jaxik.reach.reach_score, jaxik.reach.likely_postures):
        rest = (np.eye(4)[None], *[np.zeros((1, 7))] * (call is jaxik.reach.reach_score))
        refused(f"{call.__name__}: scene is 3; write a jaxik.Scene", call, P6R, 3, *rest)
        refused(f"{call.__name__}: robot is 3; write a jaxik.Robot", call, 3, None, *rest)
    refused("implicit_ik: scene is 3; write a jaxik.Scene", jaxik.implicit_ik, P6R, np.eye(4), np.zeros(7), scene=3)
    for shape in ((3, 3), (2, 4, 4)):  # the first was taken for a pose
        refused(r"target has the shape .*; allowed: \(4, 4\)", jaxik.ik.descend_ik, P6R, np.ones(shape), np.zeros(7))
    for count, words in {"plants": "plants is 0", "fruits": "fruits is -1", "seed": "seed is -1"}.items():
        refused(words, jaxik.harvesting.make_row, **{count: int(words[-2:])})
    refused("robot is 3", jaxik.forward_kinematics, 3, ZEROS)
    refused("robot is 3", jaxik.kinematics.turns, 3, ZEROS)
    refused("robot is 3", jaxik.analytic.redundancy, 3)
    refused("scene is 3", jaxik.clearance, ARM, 3, ZEROS)
    refused(r"weights has the shape \(\)", jaxik.solve_ik, ARM, np.eye(4), task=XY, weights=44)
    refused("path: str", jaxik.follow, ARM, dataclasses.replace(LINE, start="here"), 1.0, ZEROS)
    refused("path is 3", jaxik.follow, ARM, 3, 1.0, ZEROS)
    refused("duration", jaxik.follow, ARM, LINE, [1.0, 1.0], ZEROS)
    refused("up", jaxik.harvesting.Grasp, up=(0.0, 0.0, 2.0))
    refused("margin", jaxik.IKOptions, margin=10**400)
    refused("no such shipped", jaxik.load, "x" * 300)


def test_one_line_says_what_reads_a_file():
    refused(
        r"margin 0.1 with collision=False, which looks at nothing", jaxik.solve_ik, P6R, np.eye(4), margin=0.1, collision=False
    )
    refused(r"write a jaxik.Scene, e.g. jaxik.load_scene\('c.toml'\)", jaxik.solve_ik, P6R, np.eye(4), scene="c.toml")
    refused("write a jaxik.Scene", jaxik.solve_ik, P6R, np.eye(4), scene=[SCENE, "c.toml"])
    refused("2 scenes for 3 targets", jaxik.solve_ik, P6R, np.tile(np.eye(4), (3, 1, 1)), scene=[SCENE] * 2)
    refused(r"write a jaxik.Robot, e.g. jaxik.load\('xarm.toml'\)", jaxik.solve_ik, "xarm.toml", np.eye(4))
    refused(r"accuracy is 10; allowed: .* at most 0.2 m", jaxik.FitOptions, accuracy=10)
    refused("save: /nonexist/a.toml: .*No such file.*name a file in", jaxik.save, P6R, "/nonexist/a.toml")
    refused(
        r"cost.*\(q, qdot, input, t\).*quadratic_cost\(position=",
        jaxik.motions.predict,
        ARM,
        LINE,
        1.0,
        ZEROS,
        lambda q: q @ q,
        options=HORIZON,
    )


def test_a_tensor_of_torch_is_an_array_of_numbers():
    """A tensor is taken as lists are, here and in what they call, whatever its width."""
    import torch

    q = np.array([0.3, -0.4])
    asked = [lambda q, f=f, s=s: f(ARM, s, q) for f in (jaxik.clearance, jaxik.collides) for s in (SCENE, None)]
    asked += [lambda q: jaxik.collision.object_clearances(ARM, SCENE, q), lambda q: jaxik.clearance(ARM, None, q)]
    for ask in asked:
        for wide in (torch.float32, torch.float64):
            np.testing.assert_allclose(np.asarray(ask(torch.tensor(q, dtype=wide))), np.asarray(ask(q)), atol=1e-6)

"""Lanes that work together on one row, and arrays that a loop keeps in memory: as `vmap` and XLA have them."""

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from numpy.testing import assert_allclose, assert_array_equal

from jaxik import spmd
from jaxik.spmd import TEAM, HostKernel, call, kernel, team
from jaxik.spmd.trace import trace

RNG = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def by_a_kernel():
    """A warning of a function that goes to XLA fails here."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def alike(function, *args, in_axes=0, rtol=1e-6):
    """The kernel's results over a batch, which are those of XLA's operations."""
    ours = jax.jit(jax.vmap(kernel(function), in_axes))(*args)
    theirs = jax.jit(jax.vmap(function, in_axes))(*args)
    jax.tree_util.tree_map(lambda a, b: assert_allclose(a, b, rtol=rtol, atol=1e-6), ours, theirs)
    return ours


def test_collectives_speak_to_all_lanes():
    """Sums, least and largest of floats, integers and truths, of what varies and of what all lanes have in common."""

    def lane(x):
        me = lax.axis_index(TEAM)
        y = jnp.sin(x + me)
        ints, truths = (3 * me) % 7 - 2, me == 11
        all_of = lambda what: (lax.psum(what, TEAM), lax.pmax(what, TEAM), lax.pmin(what, TEAM))
        return all_of(y), all_of(ints), all_of(x), lax.pmax(truths, TEAM), lax.pmin(truths, TEAM), lax.pmax(y > 2.0, TEAM)

    x = RNG.normal(size=33).astype(np.float32)
    found = alike(team(lane), x)
    values = np.sin(x[:, None] + np.arange(16))
    assert_allclose(found[0][0], values.sum(1), rtol=1e-5)
    assert_allclose(found[0][1], values.max(1), rtol=1e-6)
    assert_array_equal(found[3], True)
    assert_array_equal(found[4], False)


def test_collectives_of_what_is_known():
    def lane(x):
        of = lambda known: (lax.psum(known, TEAM), lax.pmax(known, TEAM), lax.pmin(known, TEAM))
        return of(jnp.int32(3) + 0 * x.astype(jnp.int32)), of(jnp.where(False, x, 2.5)), of(jnp.where(x == x, 4, 5))

    alike(lambda x: team(lane)(x), jnp.arange(5.0))


def test_nan_is_the_least_and_the_largest():
    lane = lambda x: (lax.pmax(x * lax.axis_index(TEAM), TEAM), lax.pmin(x / lax.axis_index(TEAM), TEAM))
    found = alike(team(lane), np.array([1.0, np.nan, np.inf, 0.0], np.float32))
    assert np.isnan(found[0]).tolist() == [False, True, True, False]


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
@pytest.mark.parametrize("double", [False, True])
def test_nearest_of_many_points(double):
    """Each lane takes every sixteenth point; a kernel's rows have a team each, in both widths, by JAX and without it."""

    def lane(points, x):
        me = lax.axis_index(TEAM)
        apart = jnp.linalg.norm(points[:, me] - x, axis=1)
        least = lax.pmin(jnp.min(apart), TEAM)
        return least, lax.pmin(jnp.where(jnp.min(apart) == least, jnp.argmin(apart) * 16 + me, 999), TEAM)

    with jax.enable_x64(double):
        points, x = RNG.normal(size=(9, 16, 3)), RNG.normal(size=(21, 3))
        if not double:
            points, x = points.astype(np.float32), x.astype(np.float32)
        least, at = alike(team(lane), points, x, in_axes=(None, 0))
        apart = np.linalg.norm(points.reshape(-1, 3) - x[:, None], axis=2)
        assert_allclose(least, apart.min(1), rtol=1e-6)
        assert_array_equal(at, apart.argmin(1))
        host = HostKernel(lambda x, points: team(lane)(points, x), 1).run(x, points, double=double)
        assert_array_equal(host[0], least)
        assert_array_equal(host[1], at)


def test_loops_and_branches_by_lanes_and_by_all():
    """Lanes may part in loops and branches, so long as none speaks there."""

    def lane(x):
        me = lax.axis_index(TEAM)
        turns, y = lax.while_loop(lambda c: c[1] < me, lambda c: (c[0] + 1, c[1] * 1.5 + x), (0, x))
        y = lax.cond(me % 3 == 0, lambda: jnp.sin(y) * jnp.cos(y) + jnp.exp(-y), lambda: jnp.sqrt(jnp.abs(y)))
        again = lambda c: (c[0] + lax.pmax(y, TEAM) * 0.1, c[1] + 1)
        return lax.while_loop(lambda c: c[0] < 3.0, again, (x, 0)), lax.psum(turns, TEAM)

    alike(team(lane), np.linspace(0.3, 2.0, 19, dtype=np.float32), rtol=1e-5)


def test_nested_loops_that_all_lanes_share(monkeypatch):
    """The outer loop carries what the inner one gives, in one number for all lanes. LLVM's good code lost it where the
    text had a `bitcast` between equal types; there is none."""
    monkeypatch.setattr(call, "QUICK", 30_000)  # as users have it

    def nested(n, x, numbers):
        y = jnp.clip(numbers[22], -3, 3)
        inner = lambda x: lax.while_loop(lambda s: s[0] < n % 4, lambda s: (s[0] + 1, y), (0, x))[1]
        return lax.while_loop(lambda s: s[0] < 3 + n % 3, lambda s: (s[0] + 1, inner(s[1])), (0, x))[1]

    n, x, numbers = np.arange(40), np.ones(40, np.float32), np.linspace(-2.0, 2.0, 300, dtype=np.float32)
    found = alike(team(nested), n, x, numbers, in_axes=(0, 0, None))
    assert_allclose(found, np.where(n % 4 == 0, 1.0, numbers[22]))
    alike(lambda n, x, numbers, z: (nested(n, x, numbers), z), np.int32(5), x[0], numbers, x, in_axes=(None, None, None, 0))


def test_no_instruction_gives_a_value_its_own_type():
    def every(n, x, table):
        bits = lax.bitcast_convert_type(n, jnp.uint32).astype(jnp.int32)  # one that LLVM has for both
        best = jnp.maximum(x, 2.0) + table[n] + table[lax.axis_index(TEAM)]
        return lax.fori_loop(0, 99, lambda i, s: jnp.sin(s + lax.pmax(best, TEAM)), x) + bits

    traced = trace(team(every), [np.int32(3), np.float32(1.0), np.ones(300, np.float32)])[0]
    text = call.plan(traced, (False, False, True), "every").text
    casts = re.findall(r"bitcast (<[^>]*>|\S+) \S+ to (<[^>]*>|\S+)", text)
    assert casts
    assert [(a, b) for a, b in casts if a == b] == []


@pytest.mark.kernels(reason="without any, each is refused for that alone")
def test_a_collective_where_lanes_part_goes_to_xla():
    def lane(x):
        me = lax.axis_index(TEAM)
        speak = lambda: lax.pmax(jnp.sin(x * me) + jnp.cos(x) * jnp.exp(x * me) / (1.0 + x**2) + jnp.tanh(x), TEAM)
        return lax.pmin(lax.cond(me > 3, lambda: jnp.sin(speak()) * jnp.cos(speak() * me), lambda: x), TEAM)

    assert "where its lanes part" in spmd.describe(team(lane), 1.0).refused


@pytest.mark.kernels(reason="without any, each is refused for that alone")
def test_a_result_of_one_lane_is_refused():
    assert "not the same in all lanes" in spmd.describe(team(lambda x: x + lax.axis_index(TEAM)), 1.0).refused
    with pytest.raises(ValueError, match="out_axes"):
        jax.vmap(team(lambda x: x + lax.axis_index(TEAM)))(np.ones(3))


# --------------------------------------------------------------------------------------------------------------------
# Arrays that are kept in memory


def test_a_table_is_written_in_place():
    """Writes at computed places, by lanes that end at different turns; also added to, by branches, and at none."""

    def walked(n):
        def turn(state):
            i, table = state
            table = table.at[(i * 7) % 400].add(i.astype(jnp.float32))
            table = table.at[(i * 3) % 400].set(table[(i * 5) % 400] + 1.0)
            table = table.at[jnp.where(i % 4 == 0, 1000, 3)].set(-1.0, mode="drop")
            change = lambda t: t.at[i % 300].set(jnp.sin(i * 1.0) + t[5]).at[2].multiply(0.5)
            return i + 1, lax.cond(i % 3 == 0, change, lambda t: t.at[(i + 1) % 300].add(2.0), table)

        return lax.while_loop(lambda state: state[0] < n, turn, (0, jnp.arange(400.0)))[1]

    alike(walked, 5 * np.arange(37), rtol=1e-5)


def test_lanes_that_take_no_part_do_not_turn_loops_for_ever():
    """A loop ends by what it writes; lanes write nothing in a branch that they do not take, or once an outer loop is done, and
    what they would compute there need not end: 5, 3, 1, -1, ... never is 0."""

    def filled(table, n):
        return lax.while_loop(lambda s: s[n] < 3.0, lambda s: s.at[n].add(1.0), table)

    def in_a_branch(n):
        turn = lambda i, s: lax.cond((i + n) % 3 == 0, filled, lambda s, n: s.at[2].set(jnp.sin(1.0 * i)), s, n)
        return lax.fori_loop(0, 5, turn, jnp.zeros(300))

    def in_a_loop(n):
        again = lambda s: (s[0] + 1, filled(s[1].at[n].set(0.0), n))
        return lax.while_loop(lambda s: s[0] < n, again, (0, jnp.ones(300)))[1]

    def without_memory(n):
        halves = lambda: lax.while_loop(lambda s: s[0] != 0, lambda s: (s[0] - 2, s[1] + jnp.sin(0.1 * s[0])), (n, 0.0))[1]
        return lax.cond(n % 2 == 0, halves, lambda: 0.5)

    for function in (in_a_branch, in_a_loop):
        alike(function, np.arange(20))
    found = jax.jit(jax.vmap(kernel(without_memory)))(np.arange(20))  # XLA itself computes both sides, and goes on for ever
    assert_allclose(found, [0.5 if n % 2 else np.sin(0.1 * np.arange(n, 0, -2)).sum() for n in range(20)], rtol=1e-5)


def test_loops_in_loops_write_to_one_table():
    def filled(n, x):
        row = lambda i, table: lax.fori_loop(0, 20, lambda j, t: t.at[i, j].set(x * i + t[i, (j + 19) % 20]), table)
        table = lax.fori_loop(0, n, row, jnp.ones((16, 20)))
        return table[3], table.sum(), table

    alike(filled, np.arange(1, 15), np.linspace(-1.0, 1.0, 14, dtype=np.float32), rtol=1e-5)


def test_a_teams_table_is_one_for_all_lanes():
    """A tree that grows: each new node is made of what all lanes find among the others."""

    def lane(x, n):
        me = lax.axis_index(TEAM)

        def turn(state):
            i, nodes, parent = state
            mine = nodes[:, :, me]
            apart = jnp.sum((mine - jnp.sin(x * (i + 1.0))[:, None]) ** 2, axis=0)
            number = jnp.arange(20) * 16 + me
            apart = jnp.where(number < i, apart, jnp.inf)
            least = lax.pmin(jnp.min(apart), TEAM)
            best = lax.pmin(jnp.where(jnp.min(apart) == least, number[jnp.argmin(apart)], 999), TEAM)
            new = 0.5 * (nodes[:, best // 16, best % 16] + jnp.sin(x * (i + 1.0)))
            return i + 1, nodes.at[:, i // 16, i % 16].set(new), parent.at[i].set(best)

        begin = jnp.int32(1), jnp.zeros((3, 20, 16)), jnp.full(320, -1)
        _, nodes, parent = lax.while_loop(lambda state: state[0] < n, turn, begin)
        return nodes, parent

    alike(team(lane), RNG.normal(size=(9, 3)).astype(np.float32), 40 * np.arange(9), rtol=1e-4)


@pytest.mark.kernels(reason="without any, each is refused for that alone")
def test_what_is_read_as_it_was_is_refused():
    def walked(n):
        turn = lambda i, state: (state[0].at[i].set(2.0), state[1] + state[0][7])
        late = lambda i, state: turn(i, (state[0], state[1] + state[0].at[i + 1].set(3.0)[i + 1]))
        return lax.fori_loop(0, n, late, (jnp.ones(300), 0.0))

    assert "read as it was before" in spmd.describe(walked, 3).refused


def test_an_array_that_is_made_anew_each_turn_flows():
    """Each number is a value, as before, where more than 256 of them are not written in place."""
    walked = lambda x, n: lax.fori_loop(0, n, lambda i, t: jnp.where(t[0] > 1.0, 0.5 * t, t[::-1] + x), jnp.ones(300))
    alike(walked, np.linspace(0.0, 1.0, 9, dtype=np.float32), np.arange(9))


@pytest.mark.kernels(reason="without any, each is refused for that alone")
def test_a_table_that_a_loop_does_not_carry_is_not_written_to():
    """A turn that writes to it, or a test that does, would change what the next one finds."""

    def whatif(n):
        table = lax.fori_loop(0, n, lambda i, t: t.at[i].set(1.0 * i), jnp.ones(300))
        return lax.fori_loop(0, 20, lambda j, total: total + table.at[j].set(5.0)[(j * 7) % 20], 0.0)

    def tested(n):
        goes_on = lambda state: (state[0] < n) & (state[1].at[state[0] + 7].set(5.0)[3] < 1e6)
        return lax.while_loop(goes_on, lambda state: (state[0] + 1, state[1].at[state[0]].add(2.0)), (0, jnp.ones(300)))[1]

    assert all("that it does not carry" in spmd.describe(each, 3).refused for each in (whatif, tested))


@pytest.mark.kernels(reason="without any, each is refused for that alone")
def test_a_team_inside_a_team_goes_to_xla():
    inner = team(lambda y: lax.psum(y * lax.axis_index(TEAM), TEAM))
    outer = team(lambda x: lax.pmax(inner(x * lax.axis_index(TEAM)), TEAM))
    assert spmd.describe(outer, 1.0).refused == "a team inside a team" and float(outer(1.0)) == 1800.0


def test_a_team_has_derivatives():
    slope = jax.grad(team(lambda x: lax.psum(jnp.sin(x * lax.axis_index(TEAM)), TEAM)))(1.0)
    assert_allclose(slope, np.sum(np.arange(16) * np.cos(np.arange(16))), rtol=1e-5)

"""A Panda beside a table, and coal, which judges it."""

import pytest
from panda_at_table import LIMITS, MARGIN, START


@pytest.fixture(scope="package")
def panda():
    import jaxik

    return jaxik.load("panda")


@pytest.fixture(scope="package")
def judge(panda):
    from peers.collision_peers import CoalOfVolumes

    return CoalOfVolumes(panda, broad=True)


@pytest.fixture(scope="package")
def table():
    import jaxik

    return jaxik.make_scene(boxes=[[0.6, 0.0, -0.06, 0.8, 1.6, 0.1]]).with_room(boxes=8, spheres=4)


@pytest.fixture
def make(panda, table):
    import jaxik

    return lambda **changes: jaxik.Replanner(panda, START, scene=table, margin=MARGIN, **LIMITS, **changes)

"""A flat arm of three joints, the last endless, among poles; and coal, which judges it."""

import pytest

LINK = """<link name="{0}"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.04"/></geometry></collision>
  <collision><origin xyz="0.25 0 0"/><geometry><sphere radius="0.04"/></geometry></collision></link>"""
JOINT = """<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><origin xyz="{4} 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2.8" upper="2.8" effort="1" velocity="2"/></joint>"""
URDF = "\n".join(
    [
        '<robot name="flat"><link name="base"/>',
        *map(LINK.format, "abc"),
        '<link name="tip"/>',
        JOINT.format("one", "base", "a", "revolute", 0.0),
        JOINT.format("two", "a", "b", "revolute", 0.3),
        JOINT.format("three", "b", "c", "continuous", 0.3),
        JOINT.format("end", "c", "tip", "fixed", 0.3),
        "</robot>",
    ]
)


@pytest.fixture(scope="package")
def arm(tmp_path_factory):
    from peers.collision_peers import Coal

    import jaxik

    file = tmp_path_factory.mktemp("flat") / "flat.urdf"
    file.write_text(URDF)
    return jaxik.load(file, tip="tip"), Coal(jaxik.load(file, tip="tip"), file, None)


@pytest.fixture
def arm_urdf():
    return URDF

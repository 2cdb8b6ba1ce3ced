"""Files of robots that several tests write, and how they are refused."""

import pytest

import jaxik

URDF = """<robot name="arm"><link name="base"/><link name="upper"/><link name="tool"/>
<joint name="shoulder" type="revolute"><origin xyz="0 0 0.1"/><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="2" effort="1"/></joint>
<joint name="wrist" type="continuous"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="tool"/><axis xyz="0 1 0"/>
</joint>
</robot>"""
ARM = """<robot name="arm">
<link name="base"><collision><geometry><cylinder radius="0.1" length="0.1"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="hub"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3"/></joint>
<link name="hub"/>
<joint name="lift" type="revolute"><parent link="hub"/><child link="arm"/><origin xyz="0 0 0.12"/><axis xyz="0 1 0"/>
<limit lower="-2.4" upper="2.4"/></joint>
<link name="arm"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.06 0.06 0.4"/></geometry></collision></link>
<joint name="twist" type="revolute"><parent link="arm"/><child link="tip"/><origin xyz="0 0 0.45"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3"/></joint>
<link name="tip"><collision><geometry><sphere radius="0.03"/></geometry></collision></link>
</robot>"""
POST = """<robot name="post">
  <link name="foot"><collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.12"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz="0.3 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="foot"/><child link="arm"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
</robot>"""

LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="40"/>'
INERTIAL = """<inertial><origin xyz="0.1 0.02 0.03"/><mass value="{}"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0"/></inertial>"""


def link(name, mass=1.0):
    shape = '<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.04"/></geometry></collision>'
    return f'<link name="{name}">{INERTIAL.format(mass)}{shape}</link>'


def tree_of_balls(name, links, joints, radius, along):
    """A URDF whose links are balls of a `radius`, so far along x of their frames [m]; joints are (name, type, parent, child,
    place, axis, mimic)."""
    shape = f'<collision><origin xyz="{along} 0 0"/><geometry><sphere radius="{radius}"/></geometry></collision>'
    limit = lambda kind: 0.3 if kind == "prismatic" else 2.5
    placed = "".join(
        f'<joint name="{own}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="0.1 0.2 -0.1"/><axis xyz="{axis}"/>'
        f'<limit lower="-{limit(kind)}" upper="{limit(kind)}" velocity="3" effort="40"/>{mimic}</joint>'
        for own, kind, parent, child, xyz, axis, mimic in joints
    )
    return f'<robot name="{name}">{"".join(f"""<link name="{link}">{shape}</link>""" for link in links)}{placed}</robot>'


def joint(name, parent, child, kind="revolute", xyz="0.3 0 0", axis="0 0 1", more=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="0.2 -0.1 0.3"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{LIMIT}{more}</joint>'


# a torso, two arms, of which the left has a hand whose thumb leads two other joints, one by way of the other
PARTS = {
    "torso": joint("turn", "base", "torso", xyz="0 0 0.5"),
    "left": joint("left_shoulder", "torso", "left", xyz="0 0.2 0", axis="0 1 0"),
    "left_hand": joint("left_wrist", "left", "left_hand", axis="1 0 0"),
    "right": joint("right_shoulder", "torso", "right", "prismatic", "0 -0.2 0", "0 0.6 0.8"),
    "right_hand": joint("right_wrist", "right", "right_hand", axis="0 1 0"),
    "thumb": joint("flex", "left_hand", "thumb", xyz="0.1 0 0"),
    "finger": joint(
        "grip", "left_hand", "finger", "prismatic", "0.1 0.05 0", "0 1 0", '<mimic joint="flex" multiplier="-0.5"/>'
    ),
    "nail": joint(
        "curl", "finger", "nail", xyz="0.1 0 0", axis="0 1 0", more='<mimic joint="grip" multiplier="3" offset="0.1"/>'
    ),
}
TWO = f"""<robot name="two">{link("base", 5.0)}{"".join(link(name) for name in PARTS)}{"".join(PARTS.values())}</robot>"""
HANDS = ["left_hand", "right_hand"]


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, *words, reader=jaxik.load, **options):
    with pytest.raises(jaxik.LoadError) as error:
        reader(path, **options)
    line = str(error.value)
    assert "\n" not in line and path.name in line and all(w in line for w in words), line

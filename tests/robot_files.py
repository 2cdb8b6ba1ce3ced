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


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, *words, reader=jaxik.load, **options):
    with pytest.raises(jaxik.LoadError) as error:
        reader(path, **options)
    line = str(error.value)
    assert "\n" not in line and path.name in line and all(w in line for w in words), line

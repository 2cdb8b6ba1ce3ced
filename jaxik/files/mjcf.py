"""MJCF to a robot. MuJoCo itself compiles the file, so every default, class and include means what MuJoCo means by it.

Bodies are looked at together for loops that equalities close, and for geoms that touch each other. MuJoCo lets two geoms touch
where a `<pair>` says so; else where a bit of one's contype meets the other's conaffinity, and their bodies are in no
`<exclude>` [https://mujoco.readthedocs.io/en/stable/computation/index.html#collision].
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.polynomial import Polynomial

from jaxik.checks.options import among, optional, shown
from jaxik.dynamics.recursions import GRAVITY
from jaxik.files.documents import parse
from jaxik.files.held_joints import Posture
from jaxik.files.mesh import Meshes, add_box, add_capsule, add_cylinder, home, resolve
from jaxik.files.robot_builder import (
    MOVING_BASES,
    Joint,
    Link,
    Notes,
    Tip,
    all_driven,
    assemble_tree,
    displacement,
    listed,
    moving_base,
    rubbing,
)
from jaxik.files.tree_ways import AskedTips, Ways, ways_of
from jaxik.fitting.links import Shape
from jaxik.kinematics.robot import Robot
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame, from_wxyz

FOLDERS = ("meshdir", "texturedir", "assetdir")
MOST_FILES = 100
COPYING = ("replicate", "composite", "flexcomp")  # elements that make as many of others as their count= says
MOST_COPIES = 20_000
PLANE = 0  # of MuJoCo's types of geoms
LIGHT = 1e-12  # [kg, kg m2] the least that a body gets whose mass was its mesh's
FREE = 0  # of MuJoCo's joint types


def load_mjcf(
    path: Path, tip: AskedTips, base: str | None, tool: np.ndarray | None, meshes: Meshes, held: Posture, notes: Notes
) -> Robot:
    """The tree from body `base` (the world) to bodies or sites `tip` (the only leaf), and what it carries, `held` in a posture;
    bodies that fly freely, or are led by hand (mocap), are no part of it, but for the one that a base moves."""
    model, unread = _compiled(path, meshes, notes)
    names = [model.body(i).name or f"body{i}" for i in range(model.nbody)]
    notes.links = tuple(names)
    above = {names[i]: names[model.body_parentid[i]] for i in range(1, model.nbody)}
    moves = base if base in MOVING_BASES and base not in names else None
    tips = _tips(path, model, names, tip)
    bodies = None if tip.names is None else tuple(dict.fromkeys(each.link for each in tips))
    fingers = _fingers(model, names) if bodies is None else ()
    ways = ways_of(path, names, above, AskedTips(bodies), None if moves else base, "body", fingers)
    if moves:
        ways, root_T = _below_world(path, model, names, ways, moves)
    start, run = names.index(ways.root), [names.index(name) for name in ways.below]
    aside = _aside(model, {start, *run})
    joints = [pair for i in run for pair in _pairs(path, model, i, names)]
    _note_forces(model, run, names, notes)
    pairs = held.settle(path, joints, [pair for i in aside for pair in _pairs(path, model, i, names, beside=True)], tip.several)
    kept = [start, *run, *aside]
    moved = _moved(names, kept, pairs)
    check_loops(path, model, names, moved, notes)
    note_contacts(model, names, moved, notes)
    solid = solid_geoms(model)
    if meshes.read and not solid[np.isin(model.geom_bodyid, kept)].any():
        notes.add("none of its geoms touches anything, by their contype and conaffinity: give them bits that meet")
    planes = np.flatnonzero(solid & (model.geom_type == PLANE) & np.isin(model.geom_bodyid, kept))
    if len(planes):
        told = "a plane is left out, for the robot's shapes have an end; put a floor into the scene"
        notes.add(told, *(model.geom(i).name or f"geom{i}" for i in planes))
    links = {names[i]: _link(model, i, names[i], meshes, solid) for i in kept}
    for name in {*unread} & {*links}:
        links[name].meshes += unread[name]
    first = names[start]
    if moves:
        pairs = [*moving_base(moves, first, (*names, *(_label(model, i) for i in range(model.njnt))), root_T), *pairs]
        first = pairs[0][0]
    all_driven(joint for _, joint in pairs)
    notes.above = {joint.child: (joint.name, parent) for parent, joint in pairs}
    tips = tips or [Tip(name, name, np.eye(4)) for name in ways.tips]
    tips = [each._replace(link_T_tip=each.link_T_tip if tool is None else each.link_T_tip @ tool) for each in tips]
    return assemble_tree(path, path.stem, first, pairs, links, tips if tip.several else tips[0])


def _note_forces(model: Any, run: list[int], names: list[str], notes: Notes) -> None:
    """Tell of what acts on the chain in MuJoCo, and is in no torque here."""
    joints = [i for i in range(model.njnt) if model.jnt_bodyid[i] in run]
    dof = model.jnt_dofadr[joints]
    springs = (model.jnt_stiffness[joints] != 0.0) | model.jnt_stiffnesspoly[joints].any(axis=1)
    for told, of in (("stiffness", springs), ("damping beyond its linear term", model.dof_dampingpoly[dof].any(axis=1))):
        if of.any():
            notes.add(
                f"the {told} is in no torque here", *(_label(model, i) for i, there in zip(joints, of, strict=True) if there)
            )
    if floating := [names[i] for i in run if model.body_gravcomp[i]]:
        notes.add("gravcomp is not read: gravity pulls at the whole mass", *floating)
    if not np.array_equal(model.opt.gravity, GRAVITY):
        given = " ".join(f"{g:g}" for g in model.opt.gravity)
        notes.add(f"gravity is {given} in its file, which no function reads; pass gravity= (--gravity)")


def _compiled(path: Path, meshes: Meshes, notes: Notes) -> tuple[Any, dict[str, list[str]]]:
    """MuJoCo's model; and the meshes of each body that are not there, which a robot without meshes does without."""
    mujoco = optional(f"{path}: MJCF", "mujoco", "mjcf")
    _check_files(path, path, set())
    try:
        return mujoco.MjModel.from_xml_path(str(path)), {}
    except (ValueError, mujoco.FatalError) as error:
        refused = LoadError(path, "document", f"MuJoCo refuses it ({error})", "mend what it names")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        files = [*((spec.meshdir, mesh.file) for mesh in spec.meshes), *((spec.texturedir, t.file) for t in spec.textures)]
        absent = [file for folder, file in files if file and not os.path.isfile(Path(spec.modelfiledir, folder, file))]
        if absent and not meshes.read:
            unread = _without_meshes(spec, notes)
            return spec.compile(), unread
    except (ValueError, mujoco.FatalError):
        pass
    raise refused from None


def _without_meshes(spec: Any, notes: Notes) -> dict[str, list[str]]:
    """Take a model's meshes away, and what is painted. Their names, by the body that they were on."""
    found: dict[str, list[str]] = {}
    named = {mesh.name or Path(mesh.file).stem for mesh in spec.meshes}
    for geom in [*spec.geoms]:
        geom.material = ""
        if geom.meshname in named:
            found.setdefault(body := geom.parent.name, []).append(geom.meshname)
            if not geom.parent.explicitinertial:
                notes.add("a mesh is missing, and the mass that it would give the body", body)
            spec.delete(geom)
    for part in (*spec.meshes, *spec.materials, *spec.textures):
        spec.delete(part)
    spec.compiler.boundmass = spec.compiler.boundinertia = LIGHT  # else bodies without a mass of their own are refused
    return found


def _aside(model: Any, robot: set[int]) -> list[int]:
    """The bodies that hang on a robot, none of them by a free joint or by hand (mocap); parents before children, as MuJoCo
    numbers them."""
    reached = dict.fromkeys(robot)
    for body in range(1, model.nbody):
        if body not in robot and model.body_parentid[body] in reached and not _loose(model, body):
            reached[body] = None
    return [body for body in reached if body not in robot]


def _pairs(path: Path, model: Any, body: int, names: list[str], beside: bool = False) -> list[tuple[str, Joint]]:
    """The joints of a body, each with the link before it."""
    run = _body_joints(path, model, body, names[body], beside)
    return [*zip((names[int(model.body_parentid[body])], *(j.child for j in run)), run, strict=False)]


def _tips(path: Path, model: Any, names: list[str], asked: AskedTips) -> list[Tip]:
    """The bodies, and the sites on them, that are asked for; none where nobody asks."""
    sites = {model.site(i).name: model.site(i) for i in range(model.nsite)}
    tips = []
    for own in asked.names or ():
        name = asked.link(own, (*names, *sites))
        if name not in (*names, *sites):
            raise LoadError(path, f"tip '{shown(name)}'", "no such body or site", among(name, names, "bodies"))
        site = None if name in names else sites[name]
        place = np.eye(4) if site is None else frame(site.pos, from_wxyz(site.quat))
        tips.append(Tip(own, name if site is None else names[site.bodyid[0]], place))
    return tips


def _fingers(model: Any, names: list[str]) -> set[str]:
    """The bodies behind joints that an equality couples to others: a hand's, which nobody means by a tip."""
    coupled = _coupled(model)
    joints = {*coupled, *(int(model.eq_obj2id[row]) for row in coupled.values())} - {-1}
    found = {int(model.jnt_bodyid[joint]) for joint in joints}
    for body in range(1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return {names[body] for body in found}


def _below_world(path: Path, model: Any, names: list[str], ways: Ways, moves: str) -> tuple[Ways, np.ndarray]:
    """The ways from the body that stands in the world, which a base is to move, and how it stands where that is at 0: as in its
    file. Where it is free there, a plane keeps its height and turn, six joints nothing: they are its pose."""
    trunk = names.index(ways.below[0])
    first, count = int(model.body_jntadr[trunk]), int(model.body_jntnum[trunk])
    if any(model.jnt_type[i] != FREE for i in range(first, first + count)):
        mend = f"leave base= out: {', '.join(_label(model, i) for i in range(first, first + count))} move it"
        raise LoadError(path, f"base '{moves}'", f"body '{names[trunk]}' has joints of its own in the world", mend)
    stands = frame(model.body_pos[trunk], from_wxyz(model.body_quat[trunk]))
    if count:
        stands = (
            np.eye(4) if moves == "floating" else frame([0.0, 0.0, model.body_pos[trunk][2]]) @ frame(rotation=stands[:3, :3])
        )
    return ways._replace(root=ways.below[0], below=ways.below[1:]), stands


Moved = Mapping[int, tuple[str, ...]]  # the joints that move each body, from the base on


def _moved(names: list[str], kept: Sequence[int], pairs: Sequence[tuple[str, Joint]]) -> Moved:
    """The joints that move each of the bodies that are `kept`, the first of which is the base."""
    found: dict[str, tuple[str, ...]] = {names[kept[0]]: ()}
    for parent, joint in pairs:
        found[joint.child] = found[parent] if joint.type == "fixed" else (*found[parent], joint.name)
    return {body: found[names[body]] for body in kept}


def _between(a: tuple[str, ...], b: tuple[str, ...]) -> int:
    """How many joints are between two bodies."""
    return len({*a} ^ {*b})


def _check_files(path: Path, model: Path, seen: set[Path], below: Path | None = None, copies: float = 1.0) -> None:
    """Every file that `model` names in its part `path`, in includes and attached models too, lies `below` a folder; and what is
    copied, this part itself `copies` times, becomes no more than MuJoCo can build."""
    seen.add(path)
    if len(seen) > MOST_FILES:
        raise LoadError(model, "document", f"is made of more than {MOST_FILES} files", "write it in fewer")
    document = parse(path, "mujoco" if len(seen) == 1 else None)  # what is included is stripped of its root
    parts = _copied(model, document, copies)
    attached = max((count for part, count in parts.items() if part.tag == "attach"), default=1.0)
    below = below or home(path)
    folders = ["", *(c.get(key, "") for c in document.iter("compiler") for key in FOLDERS)]
    for element in document.iter():
        for key in (k for k in element.attrib if k.startswith("file") or k in FOLDERS):  # a cube's texture has six
            name, part = element.get(key, ""), element.tag in ("include", "model") and key == "file"
            where = f"<{element.tag} {key}='{name}'>"
            for folder in ("",) if part or key in FOLDERS else folders:
                target = resolve(model, where, str(Path(folder) / name), below)
            if part and target is not None and target not in seen:
                whose = target if element.tag == "model" else model
                _check_files(target, whose, seen, below, parts.get(element, attached))


def _copied(model: Path, document: Element, copies: float) -> dict[Element, float]:
    """How often each `<include>` and `<attach>` of a document is copied, itself `copies` times. Refuse too many copies."""
    parts, made, left = {}, 0.0, [(document, copies)]
    while left:
        element, count = left.pop()
        if element.tag in COPYING:
            with contextlib.suppress(ValueError):  # what is no number MuJoCo refuses
                count *= math.prod(max(float(word), 1.0) for word in element.get("count", "1").split())
        if element.tag in ("include", "attach"):
            parts[element] = count
        made += count if count > 1.0 else 0.0
        left += [(child, count) for child in element]
    if not made <= MOST_COPIES:
        mend = f"at most {MOST_COPIES} are built: lower count= of {', '.join(f'<{tag}>' for tag in COPYING)}"
        raise LoadError(model, "document", f"makes {made:.3g} elements by copying", mend)
    return parts


def _body_joints(path: Path, model: Any, body: int, name: str, beside: bool = False) -> list[Joint]:
    """A body's joints as a run; a hinge turns about its anchor, so the body's own frame is offset from it. A ball among those
    beside the robot stays as it is."""
    kinds = {2: "prismatic", 3: "revolute"}
    coupled = _coupled(model)
    pending = frame(model.body_pos[body], from_wxyz(model.body_quat[body]))
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    run = []
    for i in range(first, first + count):
        joint, label = model.joint(i), _label(model, i)
        kind = kinds.get(int(joint.type[0]))
        if kind is None and beside:
            run.append(Joint(label, "fixed", pending, f"{name}/{label}", stands="ball"))
            pending = np.eye(4)
            continue
        if kind is None:
            mend = 'allowed: hinge, slide; pass base= (--base) to start below it, or base="floating"'
            raise LoadError(path, f"joint '{label}'", "a free or ball joint on the chain", mend)
        limited, anchor, axis = bool(joint.limited[0]), frame(joint.pos), np.asarray(joint.axis, dtype=np.float64)
        lower, upper = (float(x) for x in joint.range) if limited else (-np.inf, np.inf)
        kind = "continuous" if kind == "revolute" and not limited else kind
        reference = float(joint.qpos0[0])  # MuJoCo moves a joint by qpos - qpos0
        back = displacement(kind, axis, -reference) if reference else np.eye(4)
        run.append(Joint(label, kind, pending @ anchor @ back, f"{name}/{label}", axis, lower, upper, default=reference))
        run[-1].armature = float(model.dof_armature[joint.dofadr[0]])
        if not beside:
            rubbing(path, run[-1], float(model.dof_frictionloss[joint.dofadr[0]]), float(model.dof_damping[joint.dofadr[0]]))
        run[-1].effort = _effort(model, i)
        run[-1].mimic = _law(model, coupled[i]) if i in coupled else None
        pending = np.linalg.inv(anchor)
    return [*run, Joint(f"{name}/fixed", "fixed", pending, name)]


def _effort(model: Any, joint: int) -> float:
    """The most that a joint's actuators give it in either direction [Nm, N]: the least of its own range and theirs together;
    infinite where one of them has none. What pulls in one direction alone is no limit of both."""
    import mujoco

    least = lambda ends: float(np.abs(ends).min()) or np.inf
    kinds = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    own = least(model.jnt_actfrcrange[joint]) if model.jnt_actfrclimited[joint] else np.inf
    together = 0.0
    for i in range(model.nu):
        if model.actuator_trntype[i] in kinds and model.actuator_trnid[i, 0] == joint:
            force = least(model.actuator_forcerange[i]) if model.actuator_forcelimited[i] else np.inf
            if model.actuator_ctrllimited[i] and _is_motor(model, i):
                force = min(force, abs(float(model.actuator_gainprm[i, 0])) * least(model.actuator_ctrlrange[i]))
            together += abs(float(model.actuator_gear[i, 0])) * force
    return min(own, together or np.inf)


def _is_motor(model: Any, actuator: int) -> bool:
    """Whether an actuator's force is its control, times a constant."""
    import mujoco

    plain = mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
    kinds = model.actuator_dyntype[actuator], model.actuator_gaintype[actuator], model.actuator_biastype[actuator]
    return all(int(kind) == int(one) for kind, one in zip(kinds, plain, strict=True))


def _label(model: Any, joint: int) -> str:
    return model.joint(joint).name or f"joint{joint}"


def _coupled(model: Any) -> dict[int, int]:
    """Joints that an active equality makes a function of another, or fixes; and its row."""
    import mujoco

    rows = range(model.neq)
    return {int(model.eq_obj1id[i]): i for i in rows if model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[i]}


def _law(model: Any, row: int) -> tuple[str, Polynomial]:
    """The joint that an equality names second ("" where it fixes the first), and the polynomial by which the first follows."""
    first, second = int(model.eq_obj1id[row]), int(model.eq_obj2id[row])
    rest = lambda joint: float(model.qpos0[model.jnt_qposadr[joint]]) if joint >= 0 else 0.0
    law = Polynomial(model.eq_data[row][:5])(Polynomial([-rest(second), 1.0])) + rest(first)
    return _label(model, second) if second >= 0 else "", law


def _link(model: Any, body: int, name: str, meshes: Meshes, solid: np.ndarray) -> Link:
    import mujoco

    turn, kinds = from_wxyz(model.body_iquat[body]), mujoco.mjtGeom
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    link = Link(float(model.body_mass[body]), np.array(model.body_ipos[body]), inertia)
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for i in range(first, first + count):
        geom = model.geom(i)
        kind, size = geom.type[0], geom.size.tolist()
        if not solid[i] or kind == PLANE:
            continue  # drawn only, or without end
        body_T_geom = frame(geom.pos, from_wxyz(geom.quat))
        if kind == kinds.mjGEOM_SPHERE:
            link.volumes.append((body_T_geom[None, :3, 3], size[0]))
        elif kind == kinds.mjGEOM_CAPSULE:
            add_capsule(link, body_T_geom, *size[:2])
        elif kind == kinds.mjGEOM_CYLINDER:
            add_cylinder(meshes, name, link, body_T_geom, *size[:2])
        elif kind == kinds.mjGEOM_MESH and meshes.read:
            mesh = model.mesh(int(geom.dataid[0]))
            corner, face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
            points = np.array(model.mesh_vert[corner : corner + int(mesh.vertnum[0])], np.float64)
            faces = np.array(model.mesh_face[face : face + int(mesh.facenum[0])])
            meshes.mesh(name, link, body_T_geom, Shape(0, mesh.name, points, faces))
        else:
            centre, half = np.split(np.array(model.geom_aabb[i]), 2)
            add_box(meshes, name, link, body_T_geom @ frame(centre), half)
    return link


# --------------------------------------------------------------------------------------------------------------------
# Loops, and what touches


def check_loops(path: Path, model: Any, names: Sequence[str], moved: Moved, notes: Notes) -> None:
    """Refuse an active equality between what different joints of the robot move (`moved`: which are before a body).

    What flies freely, or is led by hand (mocap), follows the robot; that it is tied to it is told.
    """
    import mujoco

    kinds = {int(kind): kind.name[5:].lower() for kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)}
    tendons = int(mujoco.mjtEq.mjEQ_TENDON)
    for row in np.flatnonzero(model.eq_active0):
        kind, ends = int(model.eq_type[row]), (int(model.eq_obj1id[row]), int(model.eq_obj2id[row]))
        if kind == tendons:
            for bodies in (_tied(model, end) for end in ends if end >= 0):
                _refuse_loop(path, "tendon", [names[i] for i in bodies], {moved.get(i, ()) for i in bodies})
        elif kind in kinds:
            sites = model.eq_objtype[row] == mujoco.mjtObj.mjOBJ_SITE
            bodies = [int(model.site_bodyid[end]) if sites else end for end in ends]
            loose = [i for i in bodies if _flies(model, i)]
            if loose and not {*bodies}.isdisjoint(moved):
                notes.add(f"a {kinds[kind]} ties the body to the robot; it flies freely, and is left out", names[loose[0]])
            elif not loose:
                _refuse_loop(path, kinds[kind], [names[i] for i in bodies], {moved.get(i, ()) for i in bodies})


def _refuse_loop(path: Path, kind: str, bodies: Sequence[str], moved: set[tuple[str, ...]]) -> None:
    if len(moved) > 1:
        between = " and ".join(f"'{name}'" for name in dict.fromkeys((bodies[0], bodies[-1])))
        mend = "cut it: remove it, or pass base=, tip= (--base, --tip) of a robot that is open"
        raise LoadError(path, f"equality of {between}", f"a {kind} closes a loop on the chain", mend)


def _tied(model: Any, tendon: int) -> list[int]:
    """The bodies that decide how long a tendon is; of a joint that it follows, those before and behind it."""
    import mujoco

    wrap, found = mujoco.mjtWrap, []
    first = int(model.tendon_adr[tendon])
    for i in range(first, first + int(model.tendon_num[tendon])):
        kind, of = model.wrap_type[i], int(model.wrap_objid[i])
        if kind == wrap.mjWRAP_JOINT:
            body = int(model.jnt_bodyid[of])
            found += [int(model.body_parentid[body]), body]
        elif kind == wrap.mjWRAP_SITE:
            found.append(int(model.site_bodyid[of]))
        elif kind in (wrap.mjWRAP_SPHERE, wrap.mjWRAP_CYLINDER):
            found.append(int(model.geom_bodyid[of]))
    return found


def _loose(model: Any, body: int) -> bool:
    """Whether a free joint, or somebody's hand (mocap), moves a body in the world."""
    first = int(model.body_jntadr[body])
    return bool(model.body_mocapid[body] >= 0 or (first >= 0 and model.jnt_type[first] == FREE))


def _flies(model: Any, body: int) -> bool:
    """Whether a body is loose, or hangs on one that is."""
    while body and not _loose(model, body):
        body = int(model.body_parentid[body])
    return body > 0


def solid_geoms(model: Any) -> np.ndarray:
    """Whether anything may touch each geom (g,): by its bits, or in a `<pair>`."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    solid[[*model.pair_geom1, *model.pair_geom2]] = True
    return np.asarray(solid)


def note_contacts(model: Any, names: Sequence[str], moved: Moved, notes: Notes) -> None:
    """Note the pairs of bodies that MuJoCo never checks, of those that `moved` has; and tell of those whose bits do not meet,
    for bits are also given to make a simulation fast."""
    paired = {frozenset(model.geom_bodyid[[i, j]].tolist()) for i, j in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    excluded = {frozenset((int(code) >> 16, int(code) & 0xFFFF)) for code in model.exclude_signature}
    unmet = {frozenset(pair) for pair in _unmet(model, [*moved])} - paired - excluded
    notes.apart |= {frozenset(names[i] for i in pair) for pair in (excluded - paired) | unmet}
    # neighbours are checked in no robot
    lost = [" and ".join(names[i] for i in (a, b)) for a, b in sorted(map(sorted, unmet)) if _between(moved[a], moved[b]) > 1]
    if lost:
        told = f"links are not checked against each other, as contype and conaffinity say: {listed(lost, 1)}"
        notes.add(f"{told}; give their geoms bits that meet where this is not meant")


def _unmet(model: Any, kept: Sequence[int]) -> Iterator[tuple[int, int]]:
    """The pairs of bodies with geoms none of which may touch one of the other, by their bits."""
    solid, bits = solid_geoms(model), np.stack([model.geom_contype, model.geom_conaffinity], axis=1)
    of = {i: frozenset(map(tuple, bits[(model.geom_bodyid == i) & solid].tolist())) for i in kept}
    meet = lambda a, b: any(s & v or u & t for (s, t), (u, v) in itertools.product(a, b))
    classes = {*of.values()} - {frozenset()}
    apart = {(a, b) for a, b in itertools.product(classes, classes) if not meet(a, b)}
    if apart:
        solid_bodies = [i for i in kept if of[i]]
        yield from ((i, j) for i, j in itertools.combinations(solid_bodies, 2) if (of[i], of[j]) in apart)

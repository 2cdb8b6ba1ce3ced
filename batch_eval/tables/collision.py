"""Tables of distances, collision models and motions that are proven free."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration, ratio

VAMP = (  # Thomason, Kingston and Kavraki 2024: C++ generated for each robot; its planner runs in planners_benchmark.py
    "VAMP plans a whole motion of the Panda among the same scenes in 35 us on one core of an AMD Ryzen 9 7950X, in "
    "104 iterations (medians; its resources/README.md)",
    "its point trees answer for a sphere in under 10 ns among thousands of points (its README)",
)


def collision_markdown(result: dict[str, Any]) -> str:
    """A row for each contender of each work, in nanoseconds a configuration; what the judges say; what VAMP states."""
    lines = ["| clearance and collision | ns a configuration | jaxik is faster by |", "| --- | --- | --- |"]
    one = {row["work"]: 1e9 / row["per_second"] for row in result["one_core"]}
    for row in result["rows"]:
        ours = row["who"] == "jaxik"
        alone = f" (one core: {one[row['work']]:,.0f})" if ours else ""
        faster = "-" if ours else ratio(row["jaxik_is_faster_by"])
        lines.append(f"| {row['work']}: {row['who']} | {1e9 / row['per_second']:,.0f}{alone} | {faster} |")
    told, coal, mujoco = (result["agreement"], *(result["agreement"][who] for who in ("coal", "mujoco")))
    return "\n".join(
        [
            *lines,
            "",
            *(f"- Published: {line}." for line in VAMP),
            "",
            f"Of {told['configurations']:,} configurations ({100 * told['free']:.0f} % free) coal calls {coal['other_sign']} "
            f"otherwise, and is {coal['apart_m']:.0e} m off at most where nothing touches;",
            f"MuJoCo's depths are {mujoco['inside_m']:.0e} m off at most.",
        ]
    )


def model_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: its collision model's size, what it says falsely, and what it costs; beside it where the meshes
    decide, and hulls."""
    lines = [
        "| robot | parts of meshes | volumes | out of meshes, most, mean | free | false | missed | by hulls: false |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    share = lambda row, key: f"{100 * row[key]:.1f} %"
    for row, hulls in zip(result["default"]["rows"], result["hulls"]["rows"], strict=True):
        reach = f"{row['protrusion max [mm]']:.0f} mm, {row['protrusion mean [mm]']:.0f} mm"
        told = f"{row['parts']} of {row['meshes']} | {row['volumes']} | {reach} | {share(row, 'free')} | {share(row, 'false')}"
        lines.append(f"| {row['robot']} | {told} | {row['missed']} | {share(hulls, 'false')} |")
    lines += ["", "| exact | false | missed | off coal's distance, at most | collides: hulls, default, exact | clearance |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for row, exact, hulls in zip(*(result[each]["rows"] for each in ("default", "exact", "hulls")), strict=True):
        times = [
            ", ".join(duration(each[key]) for each in (hulls, row, exact)) for key in ("collides [us]", "self-clearance [us]")
        ]
        off = "{:.0e} m".format(exact["off coal's at most [m]"])
        lines.append(f"| {row['robot']} | {100 * exact['false']:.2f} % | {exact['missed']} | {off} | {' | '.join(times)} |")
    return "\n".join(lines)


def scenes_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: what its model says falsely of random scenes, and misses, beside where the meshes decide."""
    lines = ["| robot | free | false | missed | exact: false | missed |", "| --- | --- | --- | --- | --- | --- |"]
    for row in result["rows"]:
        told = [f"{100 * row['free']:.1f} %"]
        for kind in ("default", "exact"):
            told += [f"{100 * row[f'{kind} false']:.2f} %", str(row[f"{kind} missed"])]
        lines.append(f"| {row['robot']} | {' | '.join(told)} |")
    return "\n".join(lines)


def plans_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: motions that are found and their samples that collide, and how often links keep 5 mm apart."""
    lines = [
        f"| robot | of {result['plans']} plans: default, exact | samples that collide | keep 5 mm: coal, default, exact |",
        "| --- | --- | --- | --- |",
    ]
    kinds = "default", "exact"
    for row in result["rows"]:
        found = ", ".join(str(row[f"{kind} plans"]) for kind in kinds)
        hits = ", ".join(str(row[f"{kind} samples that collide"]) for kind in kinds)
        kept = ", ".join(f"{100 * x:.1f} %" for x in (row["keep 5 mm"], *(row[f"{kind} keep 5 mm"] for kind in kinds)))
        lines.append(f"| {row['robot']} | {found} | {hits} | {kept} |")
    return "\n".join(lines)


def scaling_markdown(result: dict[str, Any]) -> str:
    """A row for each kind and number: the times of both questions, on one core and on two."""
    rows = {(row["what"], row["count"], row["work"], row["cores"]): row["ns"] / 1e3 for row in result["rows"]}
    lines = ["| P6R | clearance, one core | two | collides, one core | two |", "| --- | --- | --- | --- | --- |"]
    told = [("points", 10), ("points", 1000), ("points", 10_000), ("capsules", 10), ("capsules", 1000), ("capsules", 10_000)]
    for what, count in told + [("spheres", each) for each in (7, 56, 448, 3584)]:
        where = f"its 56 spheres, {count:,} {what}" if what != "spheres" else f"its {count:,} spheres, 150 points and itself"
        times = [f"{rows[what, count, work, cores]:.2f} us" for work in ("clearance", "collides") for cores in (1, 2)]
        lines.append(f"| {where} | {' | '.join(times)} |")
    return "\n".join(lines)


def mesh_markdown(result: dict[str, Any]) -> str:
    """A row for each size of mesh and question, jaxik beside coal; how they agree; and the paper's test."""
    lines = ["| among one mesh | jaxik, a configuration | coal | |", "| --- | --- | --- | --- |"]
    for row in result["meshes"]:
        for what, told in row["us"].items():
            ours, theirs = told["jaxik"], told["coal, Python loop"]
            who = f"{what}, {result['robot']}, {row['triangles']:,} triangles"
            lines.append(f"| {who} | {duration(ours)} | {duration(theirs)} | {theirs / ours:.0f}x |")
    for row in result["surfaces"]:
        lines.append(f"| {row['who']}: {row['surfaces']:,} against {row['against']:,} | {duration(row['us'])} | - | - |")
    total = lambda key: sum(row[key] for row in result["meshes"])
    motions, off = result["motions"], max(row["off_m"] for row in result["meshes"])
    told = f"Of {total('configurations'):,} configurations coal has {total('collide')} in collision; jaxik says otherwise of "
    told += f"{total('other answers')}, and is {off:.0e} m off at most where nothing touches. Of {motions['motions']} motions "
    told += f"{motions['free']} are proven free; samples hit in {motions['free that hit']} of them."
    lines += ["", *textwrap.wrap(told, 130)]
    return "\n".join(lines)


def motions_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: what the dense sampling says, and how far the bound is below it."""
    lines = [
        "| random motions | hit | called free, though hit | bound below the least: mean, most | measured: mean, 95 % |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, row in result["robots"].items():
        slack, looked = row["slack_mm"], row["evaluations"]
        wrong = row["free, but the dense sampling hits"] + row["does not collide, but the dense sampling hits"]
        lines.append(
            f"| {name}: {row['motions']:,} | {row['dense sampling hits']:,} | {wrong} | "
            f"{slack['mean']:.2f}, {slack['most']:.2f} mm | {looked['mean']:.0f}, {looked['95 %']:.0f} |"
        )
    return "\n".join(lines)

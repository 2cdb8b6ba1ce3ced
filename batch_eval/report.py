"""The tables of `docs/benchmarks.md` and the README, from the JSON files beside this one (`docs/benchmarks.py`)."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PUBLISHED = (  # by their authors, on their machines
    "PyRoki, batches on an RTX 4090: 15 us a pose",
    "TRAC-IK, one thread, at most 5 ms, 1e-5, 10,000 random poses (its README): Panda 370 us, 99.88 %; "
    "iiwa 14 280 us, 99.92 %; UR5 420 us, 99.55 %",
    "mink-warp, Panda, single steps of differential inverse kinematics, of which a pose takes many (its "
    "benchmarks/RESULTS.md): 16 million/s on an RTX 4070 Ti SUPER, 195,000/s on a laptop's CPU",
)

VAMP = (  # Thomason, Kingston and Kavraki 2024: C++ generated for each robot, which does not build here
    "VAMP plans a whole motion of the Panda among the same scenes in 35 us on one core of an AMD Ryzen 9 7950X, in "
    "104 iterations (medians; its resources/README.md)",
    "its point trees answer for a sphere in under 10 ns among thousands of points (its README)",
)


def markdown(result: dict[str, Any]) -> str:
    """A row for each work: jaxik's rate, and by how much it is faster than each peer."""
    works = dict.fromkeys(row["work"] for row in result["rows"])
    lines = ["| work | jaxik, million/s | how much faster than |", "| --- | --- | --- |"]
    for work in works:
        rows = [row for row in result["rows"] if row["work"] == work]
        peers = "; ".join(f"{row['who']}: {_times(row['jaxik_is_faster_by'])}" for row in rows[1:])
        rate = rows[0]["per_second"] / 1e6
        lines.append(f"| {work} | {rate:.{0 if rate >= 10 else 1}f} | {peers or '-'} |")
    if "one_configuration" in result:
        lines += ["", "| one configuration, warm | who | 50 % | 95 % |", "| --- | --- | --- | --- |"]
        for row in result["one_configuration"]:
            lines.append(f"| {row['work']} | {row['who']} | {row['p50_us']:.1f} us | {row['p95_us']:.1f} us |")
        share = f"{100 * result['two_threads_of_two_processes']:.0f} %"
        lines += [
            "",
            f"Two threads do {share} of the forward kinematics that two processes of one thread each do together.",
            f"The first pose of a process, eager, takes {result['first_call_s']:.2f} s, and {result['second_process_s']:.2f} s "
            "with its kernel on disk.",
        ]
    memory = result["scan_memory"]
    lines += [
        "",
        f"`jaxik harvest` with its picture takes {result['harvest_cold_s']:.0f} s the first time, when it compiles, and "
        f"{result['harvest_warm_cache_s']:.0f} s after that.",
        f"Pose, Jacobian and clearance of P6R compile in {result['compile_fk_jacobian_clearance_s']:.1f} s; a scan of "
        f"{memory['candidates'] / 1e6:.1f} million candidates",
        f"needs {memory['peak_bytes'] / 2**30:.2f} GiB with everything in the process.",
    ]
    return "\n".join(lines)


def ik_markdown(result: dict[str, Any]) -> str:
    """A row for each contender and each robot, and a line on the collision-free goals."""
    lines = ["| random reachable poses | targets a call | time each | solved |", "| --- | --- | --- | --- |"]
    for row in (*result["panda"], *result["robots"][1:]):
        lines.append(f"| {row['who']} | {row['targets']:,} | {_each(row)} | {100 * row['success']:.2f} % |")
    goals = result["goals"]
    lines += [
        "",
        *(f"- Published: {line}." for line in PUBLISHED),
        "",
        f"Of the {goals['goals']} Panda goals of MotionBenchMaker, among its obstacles, "
        f"{round(goals['goals'] * goals['solved'])} are solved without a collision,",
        f"one call each, warm: {goals['p50_ms']:.1f} ms (median), {goals['p95_ms']:.1f} ms (95 %). The first call of a "
        "process, without a scene, takes",
        f"{result['cold_s']:.1f} s, and {result['second_process_s']:.1f} s with its kernels on disk.",
    ]
    if "batch" in goals:
        batch, begun = goals["batch"], goals["fresh"]
        cold, kept = (begun[name] for name in ("compiling", "kernels_on_disk"))
        lines += [
            f"{goals['own_free_solved']} of the {goals['own_free']} whose own configuration is free, by coal. In batches of "
            f"{batch['each']} targets about a goal: {batch['mean_ms']:.2f} ms a target ({100 * batch['solved']:.2f} % solved).",
            f"A new process' first goal takes {cold['first_s']:.1f} s, the slowest later one {cold['slowest_later_s']:.1f} s; "
            f"{kept['first_s']:.1f} s and {kept['slowest_later_s']:.1f} s with the kernels on disk.",
        ]
    return "\n".join(lines)


def collision_markdown(result: dict[str, Any]) -> str:
    """A row for each contender of each work, in nanoseconds a configuration; what the judges say; what VAMP states."""
    lines = ["| clearance and collision | ns a configuration | jaxik is faster by |", "| --- | --- | --- |"]
    one = {row["work"]: 1e9 / row["per_second"] for row in result["one_core"]}
    for row in result["rows"]:
        ours = row["who"] == "jaxik"
        alone = f" (one core: {one[row['work']]:,.0f})" if ours else ""
        ratio = "-" if ours else _times(row["jaxik_is_faster_by"])
        lines.append(f"| {row['work']}: {row['who']} | {1e9 / row['per_second']:,.0f}{alone} | {ratio} |")
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


def nine_dof_markdown(result: dict[str, Any]) -> str:
    """A row for each target of the nine-joint paper, beside what that states."""
    lines = [
        "| crop, target [cm] | position error [m] | clearance [mm] | inside the limits | time | paper: 1e-9 m, 54 s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for i, row in enumerate(result["ours"]):
        broken = result["paper"][i]["limits_broken"] if i < len(result["paper"]) else None
        theirs = "-" if broken is None else f"outside: {', '.join(broken)}" if broken else "inside the limits"
        place = f"{row['crop'].replace('_', ' ')}, {', '.join(f'{x:g}' for x in row['target_cm'])}"
        ours = (
            f"{row['error_m']:.1g} | {1e3 * row['clearance_m']:.1f} | {'yes' if row['limits_kept'] else 'no'}"
            if row["reason"] == "solved"
            else f"{row['reason']} | - | -"
        )
        lines.append(f"| {place} | {ours} | {row['ms']:.1f} ms | {theirs} |")
    return "\n".join(lines)


def predictive_markdown(result: dict[str, Any]) -> str:
    """A row for each horizon, and before them the instantaneous motion."""
    lines = [
        "| nine joints | one sample: p50, p99 | CasADi: p50, p99 | peak speed [1/s2] | clearance | beyond limits |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    motion = lambda row: f"{row['peak_speed']:.1f} | {1e3 * row['clearance_m']:.0f} mm | {row['beyond_limits']:.3f} |"
    for row in result["instantaneous"]:
        lines.append(f"| instantaneous, gradient x {row['alpha']:g} | - | - | {motion(row)}")
    for row in result["real_time"]:
        lines.append(
            f"| horizon {row['horizon_s']:g} s | {row['p50_ms']:.1f}, {row['p99_ms']:.1f} ms | "
            f"{row['casadi_p50_ms']:.1f}, {row['casadi_p99_ms']:.1f} ms | {motion(row)}"
        )
    pendulum, best = result["pendulum"], result["pendulum"]["best_of_1000"]
    many = next(row for row in result["scenarios"] if row["what"] == "10 iterations")
    lines += [
        "",
        f"CasADi's gradient and jaxik's agree to {result['casadi_differs_by']['gradient']:.0e}. The first call of a process",
        f"takes {result['first_call_s']:.1f} s.",
        f"256 pendulums at once (`predict`, 10 iterations) take {many['many_ms']:.0f} ms on two cores, one alone "
        f"{many['one_ms']:.1f} ms.",
        "",
        f"The pendulum of table 5.1 costs {best['speed']:.1f} + {best['collision']:.2f} by the thesis' count and at its gain",
        "of 1/s, by which the tip drifts 3 cm,",
        f"where the thesis finds 46 + 2.7; {100 * pendulum['share_within_1_percent']:.0f} % of 1,000 random first inputs end",
        "within 1 % of it in all. At samples of 1 ms quasi-Newton steps,",
        f"conjugate gradients, iLQR and the boundary value problem agree on it to {pendulum['spread']:.0e}.",
    ]
    return "\n".join(lines)


def statistics_markdown(result: dict[str, Any]) -> str:
    """Success and time of each direction (rows) and search (columns), and of the others."""
    rows = {row["who"]: row for row in result["rows"]}
    cell = lambda row: f"{100 * row['success']:.1f} %, {row['ms_alone']:.1f} ms"
    pairs = [who.split(", ") for who in rows if who.count(",") == 1 and not who.startswith("lbfgs")]
    directions, searches = (list(dict.fromkeys(pair[i] for pair in pairs)) for i in (0, 1))
    searches.append("polynomial, restarts")
    lines = [f"| direction | {' | '.join(searches)} |", "| --- " * (1 + len(searches)) + "|"]
    for direction in directions:
        found = [rows.get(f"{direction}, {search}") for search in searches]
        lines.append(f"| {direction.replace('_', ' ')} | {' | '.join(cell(row) if row else '-' for row in found)} |")
    others = (
        f"L-BFGS: {cell(rows['lbfgs, backtracking'])}. Boundary value problem: {cell(rows['tpbvp'])}; the thesis: 84 %, 1.14 s."
    )
    mean = 100 * result["improvement_of_best"]
    best = f"The best improves the instantaneous motion by {mean:.1f} % on average; the thesis: 16 %."
    return "\n".join([*lines, "", others, best])


def sweep_markdown(result: dict[str, Any]) -> str:
    """A row for each kind of sweep, and lines on its scaling and its kills."""
    lines = ["| sweep | targets | targets/s | false negatives, in 95 % at most |", "| --- | --- | --- | --- |"]
    eaik, kills, scaling = result["eaik"], result["kills"]["killed"], result["scaling"]
    wall, cpu = scaling["wall"], scaling["cpu"]
    grid, proof = (eaik[f"jaxik_refine_{refine}"] for refine in (0, 5))
    most = lambda row: f"{100 * row['false_negative_rate']:.2f} %, {100 * row['false_negative_bound_95']:.2f} %"
    rows = [
        (f"p6r, limits, {eaik['slides']} positions of the slide", eaik["targets"], grid, "-"),
        ("the same, and between them", eaik["targets"], proof, f"0, but for {proof['undecided']:,} undecided"),
        ("p6r in the shipped crop, with its spheres", result["crop"]["targets"], result["crop"], most(result["crop"])),
        *((f"{name}, by multistart", row["targets"], row, most(row)) for name, row in result["search"].items()),
    ]
    lines += [f"| {name} | {count:,} | {row['per_second']:,.0f} | {missed} |" for name, count, row, missed in rows]
    times = [f"{row['times_eaik']:.0f} and {row['times_eaik_with_limits']:.0f}" for row in (grid, proof)]
    span = lambda what: (result["scene"][what][0], result["scene"][what][-1])
    ends = lambda what: " to ".join(f"{count:,} ({rate:,.0f}/s)" for count, rate in span(what)) + f" {what}"
    least, largest = min(scaling["targets"]), max(scaling["targets"])
    off = [f"{100 * max(map(abs, row['deviation'])):.0f} %" for row in (wall, cpu)]
    lines += [
        "",
        f"EAIK, two threads, in a loop over the same positions: {eaik['eaik_us']:.0f} us a target for its solutions alone,",
        f"{eaik['eaik_with_limits_us']:.0f} us with the limits looked at by NumPy. The first row is {times[0]} times",
        f"faster, the second {times[1]} times. From {least:,} to {largest:,} targets the time is",
        f"{wall['first_seconds']:.2f} s and {wall['us_per_target']:.1f} us a target, within {off[0]} (CPU time: {off[1]}), in",
        f"{scaling['resident_gib']:.1f} GiB. Two processes do {result['processes']['ratio']:.2f} times the work of one.",
        f"Killed {kills} times at random moments, a store ends with the same bits. With {ends('obstacles')};",
        f"with {ends('spheres')}.",
    ]
    return "\n".join(lines)


def base_markdown(result: dict[str, Any]) -> str:
    """What grids of bases pick, and what ascents do."""
    here, *corners = result["ascents"]
    lines = ["| where to stand | fruits picked | time |", "| --- | --- | --- |"]
    lines.append(f"| where it stands | {result['where_it_stands']} of {result['fruits']} | - |")
    lines += [f"| best of a grid of {g['bases']} bases | {g['picked']} | {g['seconds']:.1f} s |" for g in result["grids"]]
    lines.append(f"| ascent from where it stands | {here['picked']} | {here['seconds']:.1f} s |")
    found, longest = sorted((c["picked"] for c in corners), reverse=True), max(c["seconds"] for c in corners)
    lines.append(f"| ascents from {len(corners)} corners of a box | {', '.join(map(str, found))} | {longest:.1f} s at most |")
    return "\n".join(lines)


def narrow_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: goals with little room, and with more."""
    low, high = (1000 * x for x in result["narrow_m"])
    lines = [f"| goals among obstacles | {low:g} to {high:g} mm of room | more |", "| --- | --- | --- |"]
    for name, rows in result["robots"].items():
        both = [f"{row['solved']:,} of {row['goals']:,}" if (row := rows.get(kind)) else "-" for kind in ("narrow", "easy")]
        lines.append(f"| {name} | {both[0]} | {both[1]} |")
    return "\n".join(lines)


def astar_markdown(result: dict[str, Any]) -> str:
    """Nodes that A* expands, by its direction."""
    plane, six, paper = result["figure_7"], result["six_joints"], result["paper"]
    lines = [
        f"| A* | two joints, 5 degrees, one by one | 256 at once | the paper's row | six joints, {six['degrees']:g} degrees |",
        "| --- | --- | --- | --- | --- |",
    ]
    for direction in ("forward", "backward", "both"):
        each, batch = (plane[f"{direction}, {how}"] for how in ("one by one", "in batches"))
        plain, many = (f"{row['expanded']} nodes, {row['ms']:.0f} ms" for row in (each, batch))
        large = f"{six[direction]['expanded']:,} nodes, {six[direction]['s']:.1f} s"
        lines.append(f"| {direction} | {plain} | {many} | {paper.get(direction, '-')} | {large} |")
    longest = max(abs(row["length"] - plane["dijkstra"]) for row in plane.values() if isinstance(row, dict))
    return "\n".join([*lines, "", f"Every way on the plane is as long as Dijkstra's, to {longest:.0e} rad."])


def planning_markdown(result: dict[str, Any]) -> str:
    """MotionBenchMaker's problems, and paths that are timed."""
    problems, timing = result["problems"], result["timing"]
    rows = [
        ("solved", f"{problems['solved']} of {problems['problems']}"),
        ("of these free by coal, every millimetre", f"{problems['free']}"),
        ("of these inside the limits of position", f"{problems['inside']}"),
        ("velocity, acceleration, at most of their limits", f"{problems['velocity']:.9f}, {problems['acceleration']:.9f}"),
        (
            "one call, warm: median, 95 %, slowest",
            ", ".join(f"{problems[k]:.0f} ms" for k in ("p50_ms", "p95_ms", "slowest_ms")),
        ),
        ("a process' first call, its slowest later one", _both(problems["fresh"]["compiling"])),
        ("the same, with the kernels on disk", _both(problems["fresh"]["kernels_on_disk"])),
        ("motion, median; if it stopped at its corners", f"{problems['duration_s']:.2f} s, {problems['stopping_s']:.2f} s"),
    ]
    lines = [f"| {problems['robot']}, from start to goal | |", "| --- | --- |", *(f"| {a} | {b} |" for a, b in rows)]
    places = timing["places"]
    return "\n".join(
        [
            *lines,
            "",
            f"| {timing['paths']:,} random splines of {timing['joints']} joints | one | motion |",
            "| --- | --- | --- |",
            f"| jaxik, {places['jaxik']} places, together | {_duration(timing['us_each'])} | "
            f"{100 * timing['longer_mean']:.1f} % longer (at most {100 * timing['longer_most']:.1f} %) |",
            f"| toppra, {places['toppra']} places, alone | {_duration(timing['toppra_us_each'])} | limits kept there alone |",
        ]
    )


def peppers_markdown(result: dict[str, Any]) -> str:
    """Table 6.2 beside what is printed, and the same programme by IPOPT."""
    paper, best = result["paper"], result["best"]
    both = lambda pair, digits: f"{pair[0]:.{digits}f} ({pair[1]:.{digits}f})"
    lines = [
        "| median (mean) | converged and free | remaining dynamic cost | iterations | time |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in ("heuristic", "straight"):
        row = result["printed"][name]
        count, time = f"{row['converged_and_free']} of 79", f"{both(row['s'], 2)} s"
        lines.append(f"| {name} guess | {count} | {both(row['remaining'], 2)} | {both(row['iterations'], 0)} | {time} |")
        iterations, seconds = both(paper[name][:2], 0), both(paper[name][2:], 2)
        cost = both(paper["remaining"], 2) if name == "heuristic" else "-"
        lines.append(f"| the thesis' | 94 % | {cost} | {iterations} | {seconds} s |")
    free = f"{best['free']} of 79, all proven"
    time = f"{both(best['alone_s'], 2)} s; all 79 together {best['together_s']:.1f} s"
    lines.append(
        f"| several postures, and a margin | {free} | {both(best['remaining'], 2)} | {both(best['iterations'], 0)} | {time} |"
    )
    pairs = [row for row in result["ipopt"] if row["ipopt"]["converged"] and row["ipopt_from_ours"]["converged"]]
    same = [abs(row["cost"] / row["ipopt_from_ours"]["cost"] - 1.0) for row in pairs]
    alike = [row for row in pairs if abs(row["cost"] / row["ipopt"]["cost"] - 1.0) <= 1e-3]
    faster = sorted(row["ipopt"]["s"] / row["s"] for row in pairs)[len(pairs) // 2]
    lines += [
        "",
        f"IPOPT, from where jaxik ended, finds the same cost to {max(same):.0e} ({len(pairs)} of "
        f"{len(result['ipopt'])} fruits, where it converges); from the same heuristic guess it ends in the same optimum for "
        f"{len(alike)}, and takes {faster:.0f} times as long (median).",
    ]
    return "\n".join(lines)


def harvest_motions_markdown(result: dict[str, Any]) -> str:
    """A row for each set-up: the whole row in each order; then what the leaves change, and what the check says."""
    plans = next(iter(result["setups"].values()))
    heads = ["a fruit is let go into", *plans, "shorter by", "planned in"]
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    for setup, row in result["setups"].items():
        times = [f"{each['total_s']:.1f} s ({each['cycle_s']:.2f} s a fruit)" for each in row.values()]
        first, last = next(iter(row.values())), row["shortest"]
        shorter = f"{100 * (1 - last['total_s'] / first['total_s']):.0f} %"
        lines.append(f"| {setup} | {' | '.join(times)} | {shorter} | {last['planning_s']:.1f} s |")
    avoid = plans["shortest"]
    lines += ["", "| leaves (hose or tray) | picked | motions | touched |", "| --- | --- | --- | --- |"]
    for leaves, row in {"avoid": avoid, **result["leaves"]}.items():
        picked = f"{row['picked']} of {result['fruits']}"
        lines.append(f"| `{leaves}` | {picked} | {row['total_s']:.1f} s ({row['cycle_s']:.2f} s a fruit) | {row['leaves']} |")
    checks = [row["shortest"]["checked"] for row in result["setups"].values()]
    reasons = "; ".join(f"{fruit}: {why}" for fruit, why in avoid["fruits"].items() if isinstance(why, str))
    looked, nearest = sum(each["samples"] for each in checks), 1e3 * min(each["clearance"] for each in checks)
    said = [
        f"{result['postures']} of the {result['fruits']} fruits have a posture. Without motions: {reasons}.",
        f"Of {looked:,} configurations of the shortest, none more than a millimetre from the one before, the nearest to "
        f"anything is {nearest:.1f} mm away; 2 mm are asked for.",
    ]
    return "\n".join([*lines, "", *said])


def _both(fresh: dict[str, float]) -> str:
    return f"{fresh['first_s']:.1f} s, {fresh['slowest_later_s']:.1f} s"


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


def model_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: its collision model's size and what it says falsely, in two settings."""
    fit = result["finer"]["fit"]
    lines = [
        f"| robot | volumes | protrusion, most, mean | free by hulls | false | missed | finer ({1e3 * fit['accuracy']:.0f} mm, "
        f"{fit['most']} a mesh): volumes | false | missed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row, finer in zip(result["default"]["rows"], result["finer"]["rows"], strict=True):
        reach = f"{row['protrusion max [mm]']:.0f} mm, {row['protrusion mean [mm]']:.0f} mm"
        shares = f"{100 * row['free by hulls']:.1f} % | {100 * row['false']:.1f} % | {row['missed']}"
        more = f"{finer['volumes']} | {100 * finer['false']:.1f} % | {finer['missed']}"
        lines.append(f"| {row['robot']} | {row['volumes']} | {reach} | {shares} | {more} |")
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
            lines.append(f"| {who} | {_duration(ours)} | {_duration(theirs)} | {theirs / ours:.0f}x |")
    for row in result["surfaces"]:
        lines.append(f"| {row['who']}: {row['surfaces']:,} against {row['against']:,} | {_duration(row['us'])} | - | - |")
    total = lambda key: sum(row[key] for row in result["meshes"])
    motions, off = result["motions"], max(row["off_m"] for row in result["meshes"])
    told = f"Of {total('configurations'):,} configurations coal has {total('collide')} in collision; jaxik says otherwise of "
    told += f"{total('other answers')}, and is {off:.0e} m off at most where nothing touches. Of {motions['motions']} motions "
    told += f"{motions['free']} are proven free; samples hit in {motions['free that hit']} of them."
    lines += ["", *textwrap.wrap(told, 130)]
    return "\n".join(lines)


def torque_markdown(result: dict[str, Any]) -> str:
    """Errors of external torque by joint, relative to nominal torque; table 3.10 beside the thesis'; the time of a step."""
    nominal, rms, swept = result["nominal_torque"], result["rmse"], result["sweep"]
    lines = ["| mean error / nominal torque, joint | 2 | 3 | 4 | 5 | 6 | 7 | 8 |", "| --- |" + " --- |" * 7]
    lines.append("| nominal torque [Nm], a stand-in | " + " | ".join(f"{x:g}" for x in nominal) + " |")
    for name, rows in rms.items():
        columns = [[x for x in column if x == x] for column in zip(*rows, strict=True)]
        mean = [100.0 * sum(column) / len(column) / most for column, most in zip(columns, nominal, strict=True)]
        lines.append(f"| {name} | {' | '.join(f'{x:.1f} %' for x in mean)} |")
    lines.append("| the thesis, external torque | < 5 % | < 5 % | < 5 % | < 5 % | < 5 % | 8 % | < 5 % |")
    detection = result["detection"]
    lines += [
        "",
        "| joint, lever | tactile sensor, 2 N | the thesis, by currents | thresholds here | least push always found | delay |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in detection["rows"]:
        low, high = min(row["threshold_nm"]), max(row["threshold_nm"])
        push = f"{row['least_torque_found_nm']:.1f} Nm ({row['least_force_found_n']:g} N)"
        lines.append(
            f"| {row['joint']}, {row['lever_m']:g} m | {row['tactile_nm']:.2f} Nm | {row['thesis_nm']:.1f} Nm | "
            f"{low:.1f} to {high:.1f} Nm | {push} | {1e3 * row['delay_s']:.0f} ms |"
        )
    alarms = sum(row["false_alarms"] for row in detection["rows"])
    steps = "; ".join(f"{name}: {row['p50_us']:.0f} us ({row['p99_us']:.0f} us)" for name, row in result["step"].items())
    best, current, torsion = (swept[k][5] for k in ("best", "by_current_alone", "by_torsion_alone"))
    lines += [
        "",
        f"{result['arms']} arms; {alarms} false alarms in {detection['free_s']:.0f} s of other motions without contact.",
        f"At joint 6 the best of {swept['filters']} pairs of covariances errs by {best:.2f} Nm, the current alone by "
        f"{current:.2f} Nm, the torsion alone by {torsion:.2f} Nm.",
        f"A step of the control loop, median (99 %): {steps}.",
    ]
    return "\n".join(lines)


def identification_markdown(result: dict[str, Any]) -> str:
    """A row a robot: what can be known of it, how much of that the log tells, and the currents that it foretells."""
    head = "| robot | base parameters, of all | told to 1 % | within two standard errors | currents off: before, after | time |"
    lines = [head, "| --- | --- | --- | --- | --- | --- |"]
    for row in result["rows"]:
        known = f"{row['base']} of {row['base'] + row['unseen']}"
        told = f"{row['told']:.0f}, off by {100 * row['told_off']:.1f} % at most"
        off = f"{100 * row['current_before']:.0f} %, {100 * row['current_after']:.1f} %"
        within = f"{100 * row['within_two_std']:.0f} %"
        lines.append(f"| {row['robot']} | {known} | {told} | {within} | {off} | {row['identify_s']:.1f} s |")
    robots = sum(row["robots"] for row in result["rows"])
    physical, solved = (sum(row[key] for row in result["rows"]) for key in ("physical", "solved"))
    numbers = ", ".join(f"{row['robot']} {row['condition']:.0f}" for row in result["rows"])
    lines += [
        "",
        f"{solved} of {robots} are solved, and in {physical} all bodies can be. Condition numbers: {numbers}.",
    ]
    return "\n".join(lines)


def dynamics_markdown(result: dict[str, Any]) -> str:
    """A row for each contender of each work, in nanoseconds a configuration; how far jaxik is from Pinocchio."""
    heads = "dynamics of a Panda, float32", "a configuration", "jaxik is faster by", "batch", "compile"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for row in result["rows"]:
        work, ours = row["work"].partition(",")[0], row["who"] == "jaxik"
        ratio = "-" if ours else _times(row["jaxik_is_faster_by"])
        each = _duration(1e6 / row["per_second"])
        compiled = f"{row['compile_s']:.1f} s" if row["compile_s"] else "-"
        lines.append(f"| {work}: {row['who']} | {each} | {ratio} | {row['count']:,} | {compiled} |")
    judged = result["agreement"]
    worst = {name: max(row[name] for row in judged.values()) for name in next(iter(judged.values()))}
    slopes = max(value for name, value in worst.items() if name.startswith("derivatives"))
    rest = max(value for name, value in worst.items() if not name.startswith("derivatives"))
    told = f"In float64, of {len(judged) // 2} robots as they are and with rotors on a base that leans, jaxik's torques, "
    told += (
        f"matrices, accelerations, energies and regressors are at most {rest:.0e} from Pinocchio's, relative to the largest "
    )
    told += f"entry; derivatives {slopes:.0e}."
    lines += ["", *textwrap.wrap(told, 130)]
    return "\n".join(lines)


TABLES = {
    "astar.json": astar_markdown,
    "base_placement.json": base_markdown,
    "benchmark.json": markdown,
    "collision_benchmark.json": collision_markdown,
    "collision_models.json": model_markdown,
    "collision_scaling.json": scaling_markdown,
    "dynamics_benchmark.json": dynamics_markdown,
    "harvest_motions.json": harvest_motions_markdown,
    "identification.json": identification_markdown,
    "ik_benchmark.json": ik_markdown,
    "mesh_benchmark.json": mesh_markdown,
    "motions.json": motions_markdown,
    "narrow_goals.json": narrow_markdown,
    "nine_dof.json": nine_dof_markdown,
    "peppers.json": peppers_markdown,
    "planning_benchmark.json": planning_markdown,
    "predictive_benchmark.json": predictive_markdown,
    "predictive_statistics.json": statistics_markdown,
    "sweep_benchmark.json": sweep_markdown,
    "torque_estimation.json": torque_markdown,
}


def table(name: str) -> str:
    """That of a benchmark's JSON file, or the "overview" of them all."""
    return overview() if name == "overview" else TABLES[name](_result(name))


def tables() -> list[str]:
    """One a benchmark."""
    return [table(name) for name in TABLES]


def overview() -> str:
    """A row for each kind of work: how long one takes in a batch, and what the nearest others take."""
    names = ("", "dynamics_", "ik_", "collision_", "planning_", "sweep_", "predictive_")
    work, forces, ik, collision, planning, sweep, ahead = (_result(f"{name}benchmark.json") for name in names)
    alone = next(row for row in ik["panda"] if row["who"] == "Panda: jaxik" and row["targets"] == 1)
    fastest = lambda rows: min((row for row in rows if "jaxik" not in row["who"]), key=lambda row: row["us_each"])
    other, horizon, goals = fastest(ik["panda"]), ahead["real_time"][1], ik["goals"]
    motions, timing = planning["problems"], planning["timing"]
    rows = [
        _ours(work, "forward kinematics, Panda, float32", "forward kinematics of a Panda", "PyRoki", "Pinocchio, Python loop"),
        _ours(
            forces, "inverse dynamics, Panda, float32", "inverse dynamics of a Panda", "Pinocchio, Python loop", "frax, vmap"
        ),
        _ours(work, "closed form, P6R, all 8 branches, float32", "closed form, all 8 branches", "EAIK, 2 threads"),
        _ours(
            collision,
            "clearance, panda, 59 spheres, 700 scenes",
            "clearance of a Panda among obstacles",
            "coal and Pinocchio, Python loop",
            "PyRoki, vmap, cylinders as capsules",
        ),
        (
            "inverse kinematics of a Panda, 2,000 poses",
            f"{_duration(ik['panda'][0]['us_each'])}, {100 * ik['panda'][0]['success']:.0f} % solved",
            f"{other['who'].removeprefix('Panda: ')}: {_duration(other['us_each'])}, {100 * other['success']:.0f} %",
        ),
        ("the same, one pose a call", _duration(alone["us_each"]), "-"),
        (
            "a Panda's goal among obstacles, one a call",
            f"{goals['p50_ms']:.1f} ms, {round(goals['goals'] * goals['solved'])} of {goals['goals']} solved",
            "-",
        ),
        (
            "the same, a motion that is proven free and timed",
            f"{motions['p50_ms']:.0f} ms, {motions['solved']} of {motions['problems']} solved",
            "-",
        ),
        (
            "the fastest timing of a path of seven joints",
            _duration(timing["us_each"]),
            f"TOPP-RA: {_duration(timing['toppra_us_each'])}",
        ),
        (
            "a target of a reach map over a slide, with proof",
            _duration(1e6 / sweep["eaik"]["jaxik_refine_5"]["per_second"]),
            f"EAIK in a loop, no proof: {_duration(sweep['eaik']['eaik_with_limits_us'])}",
        ),
        (
            f"a control sample, nine joints, {horizon['horizon_s']:g} s ahead",
            f"{horizon['p50_ms']:.1f} ms",
            f"CasADi's generated C: {horizon['casadi_p50_ms']:.1f} ms",
        ),
    ]
    return "\n".join(["| work | jaxik | others |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in rows)])


def _ours(result: dict[str, Any], work: str, name: str, *others: str) -> tuple[str, str, str]:
    """The time of one in jaxik's batch, and in that of the `others`."""
    each = {row["who"]: _duration(1e6 / row["per_second"]) for row in result["rows"] if row["work"] == work}
    return name, each["jaxik"], "; ".join(f"{who}: {each[who]}" for who in others)


def _result(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((HERE / name).read_text())
    return found


def _each(row: dict[str, Any]) -> str:
    late = f", 95 %: {_duration(row['p95_us_each'])}" if "p95_us_each" in row else ""
    return _duration(row["us_each"]) + late


def _duration(us: float) -> str:
    """Of a time [us]."""
    if us < 1.0:
        return f"{1000.0 * us:.0f} ns" if us >= 0.01 else f"{1000.0 * us:.1f} ns"
    return f"{us:.0f} us" if us < 1000.0 else f"{us / 1000.0:.1f} ms"


def _times(ratio: float) -> str:
    return f"{ratio:.1f}x" if ratio < 10 else f"{ratio:,.0f}x"


if __name__ == "__main__":
    print("\n\n".join(tables()))

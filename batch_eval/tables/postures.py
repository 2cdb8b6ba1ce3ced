"""Tables of kinematics, inverse kinematics and reach."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration, ratio, time_each

PUBLISHED = (  # by their authors, on their machines
    "PyRoki, batches on an RTX 4090: 15 us a pose",
    "TRAC-IK, one thread, at most 5 ms, 1e-5, 10,000 random poses (its README): Panda 370 us, 99.88 %; "
    "iiwa 14 280 us, 99.92 %; UR5 420 us, 99.55 %",
    "mink-warp, Panda, single steps of differential inverse kinematics, of which a pose takes many (its "
    "benchmarks/RESULTS.md): 16 million/s on an RTX 4070 Ti SUPER, 195,000/s on a laptop's CPU",
)


def kinematics_markdown(result: dict[str, Any]) -> str:
    """A row for each work: jaxik's rate, and by how much it is faster than each peer."""
    works = dict.fromkeys(row["work"] for row in result["rows"])
    lines = ["| work | jaxik, million/s | how much faster than |", "| --- | --- | --- |"]
    for work in works:
        rows = [row for row in result["rows"] if row["work"] == work]
        peers = "; ".join(f"{row['who']}: {ratio(row['jaxik_is_faster_by'])}" for row in rows[1:])
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


def closed_forms_markdown(result: dict[str, Any]) -> str:
    """A row for each speed, and one for each arm."""
    lines = ["| work | who | each | jaxik is faster by | compile |", "| --- | --- | --- | --- | --- |"]
    for row in result["rows"]:
        faster = "-" if row["who"] == "jaxik" else ratio(row["jaxik_is_faster_by"])
        compiled = f"{row['compile_s']:.1f} s" if row["compile_s"] else "-"
        lines.append(f"| {row['work']} | {row['who']} | {duration(1e6 / row['per_second'])} | {faster} | {compiled} |")
    heads = (
        "arm",
        "family",
        "given",
        "poses",
        "without a branch",
        "own branch lost",
        "error",
        "EAIK's branches missing, of it more",
    )
    lines += ["", f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for row in result["arms"]:
        beside = "not known to it" if row["missing"] is None else f"{row['missing']}, {row['more']} ({row['eaik']})"
        given = ", ".join(row["given"]) or "-"
        judged = f"{row['poses']:,} | {row['unsolved']} | {row['lost']} | {row['error']:.0e} | {beside}"
        lines.append(f"| {row['arm']} | {row['family']} | {given} | {judged} |")
    return "\n".join(lines)


def ik_markdown(result: dict[str, Any]) -> str:
    """A row for each contender and each robot, and a line on the collision-free goals."""
    lines = ["| random reachable poses | targets a call | time each | solved |", "| --- | --- | --- | --- |"]
    for row in (*result["panda"], *result["robots"][1:]):
        lines.append(f"| {row['who']} | {row['targets']:,} | {time_each(row)} | {100 * row['success']:.2f} % |")
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
    moves, joints = result["moves"], result["figure_18"]
    lines += [
        "",
        "| move | legs | joints move | least clearance of samples [mm] | a leg is planned in |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, move in moves.items():
        legs = [leg for leg in move["legs"] if leg["reason"] == "solved"]
        moved, near = sum(leg["duration_s"] for leg in legs), min(leg["least_clearance_of_samples_m"] for leg in legs)
        slowest = max(leg["plan_ms"] for leg in legs)
        count = f"{len(legs)} of {len(move['legs'])} solved"
        what = f"{name.replace('_', ' ')}, {move['crop'].replace('_', ' ')}"
        lines.append(f"| {what} | {count} | {moved:.1f} s | {1e3 * near:.1f} | {slowest:.0f} ms at most |")
    words = (
        f"Figure 18, from zero to row 1 of table 4 in the printed {joints['printed_s']:g} s: "
        f"{max(joints['mean_velocity_rad_s']):.0f} rad/s in the mean, "
        f"{joints['as_the_text_reads']['velocity_peak_rad_s']:.0f} at most as the text reads; within 1 rad/s and "
        f"0.1 m/s (ours) {joints['printed_posture']['duration_s']:.1f} s, to our posture for the same place "
        f"{joints['our_posture']['duration_s']:.1f} s, "
        f"as a planned motion at the limits {joints['our_posture']['planned_s']:.1f} s."
    )
    lines += ["", textwrap.fill(words, 128)]
    return "\n".join(lines)


def narrow_markdown(result: dict[str, Any]) -> str:
    """A row for each robot: goals with little room, and with more."""
    low, high = (1000 * x for x in result["narrow_m"])
    lines = [f"| goals among obstacles | {low:g} to {high:g} mm of room | more |", "| --- | --- | --- |"]
    for name, rows in result["robots"].items():
        both = [f"{row['solved']:,} of {row['goals']:,}" if (row := rows.get(kind)) else "-" for kind in ("narrow", "easy")]
        lines.append(f"| {name} | {both[0]} | {both[1]} |")
    return "\n".join(lines)


def general_markdown(result: dict[str, Any]) -> str:
    """A row for each kind of arm and of target, and a line on times."""
    lines = ["| arms of six joints | arms | targets | postures | found by multistart | of these lost | false |"]
    lines.append("| --- | --- | --- | --- | --- | --- | --- |")
    for name, each in result["arms"].items():
        for kind, row in each["targets"].items():
            counts = [row[what] for what in ("targets", "postures", "multistart", "lost", "false")]
            lines.append(f"| {name}; {kind} | {each['arms']:,} | " + " | ".join(f"{x:,}" for x in counts) + " |")
    numbers: dict[int, int] = {}
    for each in result["arms"].values():
        for number, arms in each["solutions_of_a_line"].items():
            numbers[int(number)] = numbers.get(int(number), 0) + arms
    arms = ", ".join(f"{numbers[number]:,} with {number}" for number in sorted(numbers, reverse=True))
    unsure = sum(row["incomplete"] for each in result["arms"].values() for row in each["targets"].values())
    worst = max(each["worst_round_trip"] for each in result["arms"].values())
    once = duration(1e6 * max(each["once_for_an_arm_cpu_s"] for each in result["arms"].values()))
    lines += [
        "",
        f"Solutions in complex angles: {arms}. The worst round trip is {worst:.0e} m or rad.",
        f"Of {unsure} targets it says itself that it may not have all (`complete`).",
        f"All postures of a target take {duration(result['us_each_of_4096'])} of one core in a batch and "
        f"{duration(result['us_of_one'])} alone, an arm {once} once.",
        f"The first call of a process takes {result['first_call_cpu_s']:.1f} s for any arm, with its kernels on disk "
        f"{result['second_process_cpu_s']:.1f} s.",
    ]
    return "\n".join(lines)


def _between_rows(result: dict[str, Any]) -> list[str]:
    """The rows of what several arms have between the positions of a grid, and of what a denser one finds."""
    lines = [
        "",
        f"Random poses all around, on one {result['cpu']}:",
        "",
        "| arm | over | targets | on the grid | between | out of reach | undecided (8 halvings) | proof | 100 times denser |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, row in result["arms"].items():
        over = f"{', '.join(row['given'])}: {row['positions']} positions"
        counts = " | ".join(f"{row[what]:,}" for what in ("targets", "on_the_grid", "between", "out_of_reach"))
        undecided = f"{row['undecided']:,} ({row['undecided_once_more']:,})"
        dense = f"{row['dense']:,} more, {row['dense_called_out_of_reach']} of them called out of reach"
        proof = duration(1e6 * row["seconds"])
        lines.append(f"| {name} | {over} | {counts} | {undecided} | {proof} | {dense} |")
    return lines


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
    lines += _between_rows(result["between"]) + _motion_rows(result["motions"])
    return "\n".join(lines)


def _motion_rows(found: dict[str, Any]) -> list[str]:
    """The rows of sweeps of motions, beside the planner alone."""
    where = f"{found['machine']['cores']} core(s) of an {found['machine']['cpu']}; CPU time:"
    lines = ["", f"Motions of a Panda in a generated cell, {where}", ""]
    lines.append("| motions | searched for | solved | an hour | each | `plan_motion` alone | bytes stored |")
    lines.append("| --- | --- | --- | --- | --- | --- | --- |")
    for name, row in found["studies"].items():
        counts = f"{row['motions']:,} {name} | {row['searched']:,} | {row['counts']['solved']:,} | {row['an_hour']:,.0f}"
        times = f"{row['cpu_ms_each']:.2f} ms | {row['alone_cpu_ms_each']:.2f} ms"
        lines.append(f"| {counts} | {times} | {row['bytes_each']:,.0f} |")
    return lines


def base_markdown(result: dict[str, Any]) -> str:
    """The table of the fruits that grids of bases pick, and ascents."""
    here, *corners = result["ascents"]
    lines = ["| where to stand | fruits picked | time |", "| --- | --- | --- |"]
    lines.append(f"| where it stands | {result['where_it_stands']} of {result['fruits']} | - |")
    lines += [f"| best of a grid of {g['bases']} bases | {g['picked']} | {g['seconds']:.1f} s |" for g in result["grids"]]
    lines.append(f"| ascent from where it stands | {here['picked']} | {here['seconds']:.1f} s |")
    found, longest = sorted((c["picked"] for c in corners), reverse=True), max(c["seconds"] for c in corners)
    lines.append(f"| ascents from {len(corners)} corners of a box | {', '.join(map(str, found))} | {longest:.1f} s at most |")
    return "\n".join(lines)

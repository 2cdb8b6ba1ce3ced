"""Tables of null-space motion, planning and trajectories that are optimal."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration, first_calls

KINDS = "solved", "no way", "not converged"


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
    rows, printed = {row["who"]: row for row in result["rows"]}, result["printed"]
    cell = lambda row: f"{100 * row['success']:.1f} %, {row['ms_alone']:.1f} ms"
    pairs = [who.split(", ") for who in rows if who.count(",") == 1 and not who.startswith("lbfgs")]
    directions, searches = (list(dict.fromkeys(pair[i] for pair in pairs)) for i in (0, 1))
    searches.append("polynomial, restarts")
    lines = [f"| direction | {' | '.join(searches)} |", "| --- " * (1 + len(searches)) + "|"]
    for direction in directions:
        found = [rows.get(f"{direction}, {search}") for search in searches]
        lines.append(f"| {direction.replace('_', ' ')} | {' | '.join(cell(row) if row else '-' for row in found)} |")
    others = (
        f"L-BFGS: {cell(rows['lbfgs, backtracking'])}. Boundary value problem: {cell(rows['tpbvp'])}; the thesis: "
        f"{100 * printed['success_of_tpbvp']:.0f} %, {printed['tpbvp_median_s']} s."
    )
    like = 100 * rows["tpbvp"]["improvement"]
    best = (
        f"Where it succeeds the boundary value problem improves the instantaneous motion by {like:.1f} % on average; the "
        "thesis: "
        f"{100 * printed['improvement_of_tpbvp']:.0f} %. The best of all methods improves it by "
        f"{100 * result['improvement_of_best']:.1f} %."
    )
    later = ", ".join(f"{100 * share:.1f} %" for share in result["secant_with_first_step_0.05"].values())
    secant = (
        "A secant search begins with the fixed step, 0.01, as printed, after which the direction of Hestenes and Stiefel is so "
        f"nearly the last one that it ends at once; with 0.05 the directions succeed in {later}."
    )
    return "\n".join([*lines, "", others, best, secant])


def ends_markdown(result: dict[str, Any]) -> str:
    """Turns, poses, ways out of collision, and proofs that there is no way."""
    seam, poses, escapes, cells = (result[part] for part in ("seam", "poses", "escapes", "cells"))
    share, cpu = seam["share_of_the_straight_time_without_turns"][0], poses["more_cpu_ms"]
    counts = cells["counts"]
    rows = [
        ("an arm with three endless joints, goals across the seam, solved", f"{seam['solved']} of {seam['problems']}"),
        ("of these every joint the short way", f"{seam['short_way_each_joint']}"),
        ("motion time, of the straight line to the goal as it was given, p50", f"{100 * share:.0f} %"),
        ("goals as poses of the tip, as postures, solved", f"{poses['poses_solved']}, {poses['postures_solved']}"),
        ("processor's time more than to a posture, p50, p95", f"{cpu[0]:.1f} ms, {cpu[1]:.1f} ms"),
        ("starts in collision led out of it", f"{escapes['solved']} of {escapes['starts']}"),
        ("of these with a clearance that rises throughout", f"{escapes['rise_throughout']}"),
        ("three joints among balls: solved, proven to have no way, neither", ", ".join(str(counts.get(k, 0)) for k in KINDS)),
        ("a proof that there is no way, p50, slowest", ", ".join(f"{cells['ms']['no way'][k]:.0f} ms" for k in (0, 2))),
    ]
    return "\n".join(["| where motions begin and end | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)])


def planning_markdown(result: dict[str, Any]) -> str:
    """MotionBenchMaker's problems, and paths that are timed."""
    problems, timing = result["problems"], result["timing"]
    seeds, many, scenes = problems["seeds"], problems["many"], problems["scenes"]
    rows = [
        ("solved", f"{problems['solved']} of {problems['problems']}"),
        ("of these free by coal, 5,000 samples a motion, at least every millimetre", f"{problems['free']}"),
        ("of these inside the limits of position", f"{problems['inside']}"),
        ("velocity, acceleration, at most of their limits", f"{problems['velocity']:.9f}, {problems['acceleration']:.9f}"),
        (
            "one call, warm: median, 95 %, slowest",
            ", ".join(f"{problems[k]:.0f} ms" for k in ("p50_ms", "p95_ms", "slowest_ms")),
        ),
        ("every tenth one with five seeds", f"{seeds['solved']:,} of {seeds['asked']:,} solved"),
        (
            f"{many['motions']:,} random motions in one scene, {many['straight']:,} of them straight",
            f"{many['solved']:,} solved; {many['ms_each']:.2f} ms each in one call, {many['alone_ms_each']:.1f} ms alone",
        ),
        (
            "all of them in one call, each in its own scene",
            f"{scenes['solved']:,} solved, {scenes['ms_each']:.2f} ms each",
        ),
        (
            f"length of the way after 0.1 s, 1 s more (`improve`), {problems['improved']['motions']} motions",
            ", ".join(f"{100 * problems['improved'][k]['length']:.0f} %" for k in ("after_0.1_s", "after_1_s")),
        ),
        *_sooner(problems),
        ("a process' first call, its slowest later one", first_calls(problems["fresh"]["compiling"])),
        ("the same, with the kernels on disk", first_calls(problems["fresh"]["kernels_on_disk"])),
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
            f"| jaxik, {places['jaxik']} places, together | {duration(timing['us_each'])} | "
            f"{100 * timing['longer_mean']:.1f} % longer (at most {100 * timing['longer_most']:.1f} %) |",
            f"| toppra, {places['toppra']} places, alone | {duration(timing['toppra_us_each'])} | limits kept there alone |",
        ]
    )


def roadmap_markdown(result: dict[str, Any]) -> str:
    """A roadmap: what it takes to make, to ask, and to keep true as a box moves."""
    made, asked = result["roadmap"], result["asked"]

    def answers(name: str) -> str:
        rows = [asked[f"{ends}_{name}"] for ends in ("nodes", "postures")]
        times = [", ".join(duration(1e3 * row[k]) for k in ("p50_ms", "p95_ms")) for row in rows]
        lasts = [f", {row['duration_s']:.2f} s" if "duration_s" in row else "" for row in rows]
        return " | ".join(f"{time}; {row['length_m']:.2f} m{s}" for time, row, s in zip(times, rows, lasts, strict=True))

    size = f"{made['nodes']:,} nodes, {made['lines']:,} lines, {made['free']:,} of them free"
    lines = [
        f"| {size} | between nodes: median, 95 %; length | between other postures |",
        "| --- | --- | --- |",
        *(f"| {words} | {answers(name)} |" for name, words in (("ways", "`way`"), ("plans", "`plan`, timed"))),
        f"| `plan_motion`, timed | {answers('plan_motion')} |",
        "",
        *textwrap.wrap(_of_changes(made, result["others"], result["moved"]), 118),
    ]
    return "\n".join(lines)


def _of_changes(made: dict[str, Any], others: dict[str, Any], parts: list[dict[str, Any]]) -> str:
    """A roadmap from a file, as a box moves, and in other cells."""
    moves = sum(part["moves"] for part in parts)
    mean = lambda of: sum(part["moves"] * of(part) for part in parts) / moves
    judged, hit = (sum(sum(part[name].values()) for part in parts) for name in ("judged", "hit"))
    looked, changed = mean(lambda part: part["looked_at_mean"]), mean(lambda part: part["changed_mean"])
    typical, slowest = mean(lambda part: part["update"]["p50_ms"]), max(part["update"]["most_ms"] for part in parts)
    places, kept = sum(part["samples"] for part in parts), 1e3 * made["load_s"]
    told = f"Made in {made['build_s']:.0f} s; read from a file of {made['file_MB']:.0f} MB in {kept:.0f} ms. A box was put "
    told += f"elsewhere {moves:,} times: {looked:,.0f} lines are looked at on average, and {changed:,.0f} change, in "
    told += f"{typical:.0f} ms (median; at most {slowest / 1e3:.1f} s). Of {judged:,} ways and lines that coal judged, at "
    told += f"{places:,} places, {hit} hit. In {others['problems']} other cells, in which all things stand elsewhere, "
    told += f"{100 * others['looked_at']:.0f} % of the lines are looked at, and {others['without_search']} problems are solved "
    return told + f"without a search, {others['solved']} with one; `plan_motion` solves {others['plan_motion_solved']}."


def _sooner(problems: dict[str, Any]) -> list[tuple[str, str]]:
    """The times of motions that had more time to become sooner, where they were measured."""
    if "sooner" not in problems:
        return []
    words = 'time of the motion after 0.1 s, 1 s more (`improves="time"`)'
    return [(words, ", ".join(f"{100 * problems['sooner'][k]['duration']:.0f} %" for k in ("after_0.1_s", "after_1_s")))]


def jerk_markdown(result: dict[str, Any]) -> str:
    """Motions with a limit of the jerk, a row for each."""
    lines = [
        "| limits of the jerk | solved, free | velocity, acceleration, jerk, at most of their limits | to the motion without | "
        "through the waypoints, to Ruckig | its timing; the call; without jerk |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, row in result.items():
        if not isinstance(row, dict) or "problems" not in row:
            continue
        used = ", ".join(f"{row[f'share_of_{kind}']:.5f}" for kind in ("velocity", "acceleration", "jerk"))
        lines.append(
            f"| {name} | {row['solved']}, {row['free']} of {row['problems']} | {used} | "
            f"{row['to_without_jerk_mean']:.3f} (at most {row['to_without_jerk_most']:.2f}) | "
            f"at most {row['lines_to_ruckig_most']:.3f}; {row['lines_to_ruckig_on_lines_most']:.3f} where it stays on the "
            f"lines, {row['ruckig_on_lines']} of {row['solved']} | "
            f"{row['ms_timing_p50']:.0f} ms; {row['ms_p50']:.0f} ms; {row['ms_without_p50']:.0f} ms{_in_one_call(row)} |"
        )
    return "\n".join(lines)


def _in_one_call(row: dict[str, Any]) -> str:
    """The times of motions that are asked for together, where they were measured."""
    if "ms_batch" not in row:
        return ""
    return f"; in one call {row['ms_batch']:.1f} ms each, without jerk {row['ms_batch_without']:.1f}"


def trajectory_markdown(result: dict[str, Any]) -> str:
    """Optimised motions beside planned ones."""
    verbs = {name: result[name] for name in ("plan_motion", "optimise_trajectory")}
    beside, spread = result["beside"], ("p50_ms", "mean_ms", "p95_ms", "slowest_ms")
    rows = [
        ("solved", lambda of: f"{of['solved']} of {result['problems']}"),
        ("of these free by coal, every millimetre", lambda of: f"{of['free']}"),
        ("one call, warm: median, mean, 95 %, slowest", lambda of: ", ".join(f"{of[k]:.0f} ms" for k in spread)),
        ("motion, median", lambda of: f"{of['duration_s']:.2f} s"),
    ]
    lines = [f"| {result['robot']}, from start to goal | {' | '.join(verbs)} |", "| --- | --- | --- |"]
    lines += [f"| {words} | {' | '.join(told(of) for of in verbs.values())} |" for words, told in rows]
    ratios = f"{beside['time_ratio_mean']:.2f} (from {beside['time_ratio_least']:.2f} to {beside['time_ratio_most']:.2f})"
    return "\n".join([*lines, f"| time of motion, mean of its share of the planner's | 1 | {ratios} |"])


def _is_way(row: Any) -> bool:
    return isinstance(row, dict) and "length" in row


def astar_markdown(result: dict[str, Any]) -> str:
    """Nodes that A* takes, by its rule, its direction and its ties; and what surfaces cost in its collision test."""
    plane, near, printed, six = result["figure_7"], result["found"], result["printed"], result["six_joints"]
    lines = [
        "| A* | printed | found scene, printed rule | stems every 40 cm, printed rule | judged when expanded | 256 at once | "
        f"six joints, {six['degrees']:g} degrees |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for direction in ("forward", "backward", "both"):
        theirs = printed.get(f"{direction}_iterations", "-")
        by_ties = ["-", "-"]
        if direction != "both":
            names = [f"{direction}, as printed{ties}" for ties in ("", ", farthest of ties")]
            by_ties = [" to ".join(str(scene[name]["expanded"]) for name in names) for scene in (near, plane)]
        rows = (plane[f"{direction}, {how}"] for how in ("judged when expanded", "in batches"))
        late, many = (f"{row['expanded']} nodes, {row['ms']:.0f} ms" for row in rows)
        large = f"{six[direction]['expanded']:,} nodes, {six[direction]['s']:.1f} s"
        lines.append(f"| {direction} | {theirs} | {by_ties[0]} | {by_ties[1]} | {late} | {many} | {large} |")
    longest = max(abs(row["length"] - each["dijkstra"]) for each in (plane, near) for row in each.values() if _is_way(row))
    found, cost, figure = result["search"], result["surfaces"], result["figure_8"]
    fine, boxes = cost["rows"]["triangles"], cost["rows"]["boxes"]
    seven = figure["seven"]["forward"]
    words = [
        f"Every way on the plane is as long as Dijkstra's, to {longest:.0e} rad. Of two numbers in a cell the first takes, "
        "among equals, the node nearest to the goal, the second the farthest. The found scene is the nearest to the printed "
        f"counts of {found['looked_at']:,} that fit the paper's words ({found['drawn']:,} draws at random, then steps beside "
        f"the best); of those at random backward saves {100 * found['reduction_quartiles'][1]:.0f} % in the median. The P6R "
        f"between stems alone (fig. 8): six joints {figure['six']['forward']['s']:.1f} s, seven {seven['s']:.1f} s "
        f"({figure['seven']['degrees']:g} degrees and {100 * figure['seven']['slide_m']:g} cm).",
        f"Edges against surfaces, the P6R's six links among five stems: {fine['surfaces']} triangles {duration(fine['us'])}, "
        f"{boxes['surfaces']} rectangles {duration(boxes['us'])}, factor {cost['factor']:.1f}; in a loop of an interpreter "
        f"{cost['factor_in_a_loop']:.1f}; there are {cost['fewer_surfaces']:.1f} times fewer surfaces (printed: "
        f"{printed['surfaces_factor']:g}).",
    ]
    for each in words:
        lines += ["", textwrap.fill(each, 128)]
    return "\n".join(lines)


def peppers_markdown(result: dict[str, Any]) -> str:
    """Table 6.2 beside what is printed, by jaxik and by the thesis' solver; then where they differ, and the typical fruit."""
    paper, count = result["printed"], result["fruits"]
    both = lambda row, digits: f"{row['median']:.{digits}f} ({row['mean']:.{digits}f})"
    lines = [
        "| median (mean) | converged and free | remaining dynamic cost | iterations | time |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in ("heuristic", "straight"):
        for who, label in (("jaxik", "jaxik"), ("ipopt", "IPOPT, L-BFGS")):
            row = result[name][who]
            cells = f"{row['converged_and_free']} of {count}", both(row["remaining"], 2), both(row["iterations"], 0)
            lines.append(f"| {name} guess, {label} | {' | '.join(cells)} | {both(row['s'], 2)} s |")
        cost = both(paper["remaining"], 2) if name == "heuristic" else "-"
        cells = f"{100 * paper['converged_share']:.0f} %", cost, both(paper["iterations"][name], 0)
        lines.append(f"| {name} guess, the thesis | {' | '.join(cells)} | {both(paper['s'][name], 2)} s |")
    best = result["several_postures_and_a_margin"]
    cells = f"{best['free']} of {count}, all proven", both(best["remaining"], 2), both(best["iterations"], 0)
    lines.append(
        f"| no guess: several postures, and a margin | {' | '.join(cells)} | all together {best['together_s']:.1f} s |"
    )
    guess = {name: result[name]["guess"] for name in ("heuristic", "straight")}
    reach = " and ".join(f"{row['reaches']} ({row['free']} of {count} free)" for row in guess.values())
    apart, one = result["apart"], result["typical"]
    lines += [
        "",
        f"Heuristic and straight guesses that reach their fruit: {reach}. Failed by collision, and not converged: "
        + "; ".join(f"{name}, {who} {_failed(result[name][who])}" for name in guess for who in ("jaxik", "ipopt"))
        + f". From the same guess both solvers end in the same optimum {apart['same']} times of {apart['of']}, jaxik in a "
        f"cheaper one {apart['jaxik_less']} times, IPOPT {apart['ipopt_less']} times.",
    ]
    printed = paper["typical"]
    typical = [
        f"{name}: {one['jaxik'][name]['iterations']} iterations by jaxik, {one['ipopt'][name]['iterations']} by IPOPT, "
        f"{printed['iterations'][name]} printed"
        for name in guess
    ]
    saved = [f"{100 * one[who]['heuristic']['saved']:.1f} %" for who in ("jaxik", "ipopt")]
    words = f"saved {saved[0]} and {saved[1]} ({100 * printed['saved']:.1f} % printed)"
    return "\n".join([*lines, "", f"The typical fruit: {'; '.join(typical)}; {words}."])


def _failed(row: dict[str, Any]) -> str:
    return f"{row['failed']['collision']} and {row['failed']['not_converged']}"


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


def slit_markdown(result: dict[str, Any]) -> str:
    """A row for each tip and plate, over all turns of the slot."""
    many, most = result["seeds"], result["within_s"]
    lines = [f"| tip, plate | solved within {most:g} s | of these free | p50 | slowest |", "| --- | --- | --- | --- | --- |"]
    for case in result["cases"]:
        slots = case["slots"].values()
        within, free = (sum(slot[what] for slot in slots) for what in ("within", "free"))
        times = sorted(row["s"] for slot in slots for row in slot["motions"])
        name = f"{1e3 * case['tip_m']:g} mm, {1e3 * case['thick_m']:g} mm thick"
        half, last = (duration(1e6 * x) for x in (times[len(times) // 2], times[-1]))
        lines.append(f"| {name} | {within} of {many * len(slots)} | {free} | {half} | {last} |")
    return "\n".join(lines)


def furniture_markdown(result: dict[str, Any]) -> str:
    """A row for each robot."""
    head = "| robot, joints | problems | solved | proven to have no way | free by coal | p50, p95, slowest |"
    lines = [head, "| --- | --- | --- | --- | --- | --- |"]
    for name, row in result["robots"].items():
        times = ", ".join(f"{row[key]:.0f} ms" for key in ("p50_ms", "p95_ms", "slowest_ms"))
        solved = " | ".join(str(row[key]) for key in ("problems", "solved", "no_way", "free"))
        lines.append(f"| {name}, {row['joints']} | {solved} | {times} |")
    return "\n".join(lines)

"""Tables of dynamics, identification and external torque."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration, ratio


def dynamics_markdown(result: dict[str, Any]) -> str:
    """A row for each contender of each work, in nanoseconds a configuration; how far jaxik is from Pinocchio."""
    heads = "dynamics of a Panda, float32", "a configuration", "jaxik is faster by", "batch", "compile"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for row in result["rows"]:
        work, ours = row["work"].partition(",")[0], row["who"] == "jaxik"
        faster = "-" if ours else ratio(row["jaxik_is_faster_by"])
        each = duration(1e6 / row["per_second"])
        compiled = f"{row['compile_s']:.1f} s" if row["compile_s"] else "-"
        lines.append(f"| {work}: {row['who']} | {each} | {faster} | {row['count']:,} | {compiled} |")
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
        "| joint, lever | tactile sensor, 2 N | the thesis, by currents | mean error here | thresholds here "
        "| the thesis' torque found on | least push found on every arm | delay |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in detection["rows"]:
        low, high = min(row["threshold_nm"]), max(row["threshold_nm"])
        worse = "worse" if row["least_torque_found_nm"] > row["thesis_nm"] else "better"
        push = f"{row['least_torque_found_nm']:.1f} Nm ({row['least_force_found_n']:g} N), {worse}"
        lines.append(
            f"| {row['joint']}, {row['lever_m']:g} m | {row['tactile_nm']:.2f} Nm | {row['thesis_nm']:.1f} Nm | "
            f"{row['error_nm']:.1f} Nm | {low:.1f} to {high:.1f} Nm | {100 * row['found_at_thesis_nm']:.0f} % of arms "
            f"| {push} | {1e3 * row['delay_s']:.0f} ms |"
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


def touch_markdown(result: dict[str, Any]) -> str:
    """The thesis' text on figures 4.6 to 4.8 beside the numbers here; contacts anywhere; the analytic course."""
    of = {(row["scene"], row["scheme"]): row for row in result["experiments"]}
    near, far = ({scheme: row for (scene, scheme), row in of.items() if scene == kind} for kind in ("avoidable", "inevitable"))
    span = lambda row: f"{row['falls_from_n']:.2f}, {row['falls_to_n']:.2f}, then {row['peak_n']:.1f} N"
    rates = lambda one, other: f"rates to {near[one]['peak_rate']:.2f} and {near[other]['peak_rate']:.2f} /s"
    whole, never = near["feedback, whole force"], near["feedback, whole force, nothing forgotten"]
    courses = (("the excess of the force", near["feedback"]), ("all of it", whole), ("nothing forgotten", never))
    falls = "; ".join(f"{what}: {row['dip_after_n']:.2f} N, shown {row['felt_dip_after_n']:.2f} N" for what, row in courses)
    ends = "; ".join(f"{what}: {row['end_n']:.2f} N" for what, row in courses)
    said = [
        ("4.6", "without a reaction the force comes to more than 9 N", f"{near['baseline']['peak_n']:.1f} N (so chosen)"),
        (
            "4.6",
            "RMRC reduces it faster than RAC, with higher rates",
            f"peaks {near['rmrc']['peak_n']:.1f} and {near['rac']['peak_n']:.1f} N, at the end {near['rmrc']['end_n']:.1f} and "
            f"{near['rac']['end_n']:.1f} N, {rates('rmrc', 'rac')}",
        ),
        (
            "4.6",
            "the same, with (4.16) to the letter: gradients times 1 ms",
            f"RAC at the end {near['rac, gradients times dt']['end_n']:.1f} N, without a reaction "
            f"{near['baseline']['end_n']:.1f} N",
        ),
        (
            "4.7",
            "feedback linearisation is faster than RMRC, with higher rates",
            f"below 2 N after {near['feedback']['below_2_n_after_s']:.2f} and {near['rmrc']['below_2_n_after_s']:.2f} s, "
            f"{rates('feedback', 'rmrc')}",
        ),
        ("4.7", "at the beginning fast to about 0 (measured force), counting", falls),
        ("4.7", "it controls the force to the threshold, 1.3 N, counting", ends),
        ("4.7", "RMRC does not reach the threshold", f"{near['rmrc']['end_n']:.2f} N after 15 s, from above"),
        ("4.8", "in the null space alone it falls at first, and rises again: feedback", span(far["feedback"])),
        ("4.8", "the same: RMRC", span(far["rmrc"])),
        (
            "4.8",
            "multi-space acts as feedback until 5 N, and then leaves the path and reduces it",
            f"{far['multi']['peak_n']:.1f} N at most, {far['multi']['end_n']:.2f} N at the end, "
            f"{far['multi']['task_error_mm']:.0f} mm from the path",
        ),
    ]
    lines = ["| figure | the thesis' text | here |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in said)]
    random = result["random"]
    head = f"{random['pushed']:,} of {random['contacts']:,} contacts that come above 5 N"
    lines += [
        "",
        f"| {head} | never above 5 N | at the end not | peak: 50 %, 95 % | time above | off the path: 50 %, 95 % |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in random["rows"]:
        shares = f"{100 * row['kept_below_5_n']:.0f} % | {100 * row['ends_below_5_n']:.1f} %"
        peaks = f"{row['peak_50_n']:.1f}, {row['peak_95_n']:.0f} N | {row['above_5_n_s']:.2f} s"
        errors = f"{row['error_50_mm']:.2f}, {row['error_95_mm']:.1f} mm"
        lines.append(f"| {row['scheme']} | {shares} | {peaks} | {errors} |")
    found, least = result["search"], min(row["clearance_m"] for row in result["experiments"])
    off, step, seconds = result["analytic"], result["step"], sum(row["seconds"] for row in random["rows"])
    shares = "; ".join(f"{name}: {100 * share:.2g} %" for name, share in off.items())
    return "\n".join(
        [
            *lines,
            "",
            f"Furthest from F'' + 2 F' + 4 F = 0, of the first force, by what is known of the stiffness: {shares}.",
            f"Of {found['scenes']:,} scenes drawn at random, RMRC's force falls before it rises on in {found['rmrc_falls']}; "
            f"in {found['all_told']} of these",
            "it also comes below 2 N on the first line, and feedback alone above 5 N on the second.",
            f"The arm stays {least:.3f} m or more from itself; the self-collision term begins at 0.05 m.",
            f"A sample of the control loop takes {step['p50_us']:.0f} us (99 %: {step['p99_us']:.0f} us); "
            f"{len(random['rows'])} times {random['contacts']:,} simulations of {random['seconds_each']:g} s each "
            f"{seconds:.0f} s in all.",
        ]
    )

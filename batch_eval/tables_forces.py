"""Tables of dynamics, identification and external torque."""

from __future__ import annotations

import textwrap
from typing import Any

from tables_words import duration, ratio


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

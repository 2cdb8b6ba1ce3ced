"""Figures 6.2 to 6.9 of Schuetz 2017 from what `peppers.py` found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

GRAY, BLUE, GREEN, RED = "0.5", "tab:blue", "tab:green", "tab:red"
COLOURS = {"heuristic": BLUE, "straight": GREEN}
LABELS = {"jaxik": "jaxik", "ipopt": "IPOPT, L-BFGS"}


def draw(result: dict[str, Any], file: Path) -> None:
    """Writes the pictures beside a JSON file."""
    draw_statistics(result, file.with_suffix(".png"))
    draw_setup(result, file.with_name(f"{file.stem}_setup.png"))
    if result["typical"]:
        draw_typical(result, file.with_name(f"{file.stem}_typical.png"))


def boxes(axis: Any, rows: list[tuple[str, Any, str]]) -> None:
    """Tukey's boxes, one below the other, with whiskers of 1.5 interquartile ranges and the mean."""
    drawn = axis.boxplot(
        [values for _, values, _ in rows], orientation="horizontal", whis=1.5, showmeans=True, patch_artist=True, widths=0.6
    )
    for box, (_, _, colour) in zip(drawn["boxes"], rows, strict=True):
        box.set(facecolor=colour, alpha=0.4)
    for median in drawn["medians"]:
        median.set_color("black")
    axis.set_yticks(range(1, len(rows) + 1), [label for label, _, _ in rows])
    axis.invert_yaxis()


def draw_statistics(result: dict[str, Any], file: Path) -> None:
    """Figures 6.8 and 6.9: absolute dynamic costs; iterations and time."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.8), layout="constrained")
    fruits, printed = result["each_fruit"], result["printed"]
    good = [np.array(fruits["heuristic"][who]["good"], bool) & np.array(fruits["heuristic"]["reaches"], bool) for who in LABELS]
    own = np.array(fruits["heuristic"]["guess_dynamic_cost"])
    rows = [("guess", own[good[1]], GRAY)]
    rows += [
        (LABELS[who], np.array(fruits["heuristic"][who]["dynamic_cost"])[g], BLUE) for who, g in zip(LABELS, good, strict=True)
    ]
    boxes(axes[0], rows)
    share = printed["remaining"]
    axes[0].axvline(
        share["median"] * np.median(own[good[1]]), color=RED, linestyle="--", label="printed: 36 % of the guess' median"
    )
    axes[0].set(title="Fig. 6.8: heuristic guess, before and after", xlabel=r"dynamic cost [rad$^2$/s]", xscale="log")
    below(axes[0])
    for axis, what, words in zip(axes[1:], ("iterations", "s"), ("iterations", "time [s]"), strict=True):
        boxes(axis, [(f"{LABELS[who]}\n{name}", fruits[name][who][what], COLOURS[name]) for who in LABELS for name in COLOURS])
        for name, colour in COLOURS.items():
            median = printed[what][name]["median"]
            axis.axvline(median, color=colour, linestyle="--", label=f"printed median, {name}: {median:g}")
        axis.set(title=f"Fig. 6.9: {words.split(' ')[0]}", xlabel=words, xscale="log")
        below(axis)
    figure.suptitle(
        f"Schütz 2017, ch. 6: {result['fruits']} sweet peppers; triangles are means, whiskers 1.5 interquartile ranges"
    )
    save(figure, file)


def below(axis: Any) -> None:
    """Puts the legend where it covers nothing."""
    axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.18))


def draw_setup(result: dict[str, Any], file: Path) -> None:
    """Figures 6.2 to 6.4: the weight, the constraints' Jacobian, and the fruits."""
    figure = plt.figure(figsize=(13, 4.6), layout="constrained")
    axes = [figure.add_subplot(1, 3, 1), figure.add_subplot(1, 3, 2), figure.add_subplot(1, 3, 3, projection="3d")]
    k = np.arange(101)
    axes[0].plot(k, 0.5 + 0.5 * (k / 100) ** 2, color=BLUE)
    axes[0].set(title=r"Fig. 6.2: weight of dynamic costs", xlabel="k", ylabel=r"$\zeta_k$", ylim=(0, 1.1))
    rows, columns, shape = (np.array(result["sparsity"][key]) for key in ("rows", "columns", "shape"))
    last = rows >= shape[0] - result["sparsity"]["workspace_rows"]
    for these, colour, label in ((~last, BLUE, "trapezoidal rule, start, end"), (last, GREEN, "workspace")):
        axes[1].plot(columns[these], rows[these], ".", color=colour, markersize=3, label=label)
    axes[1].invert_yaxis()
    axes[1].set(title="Fig. 6.3: Jacobian of the constraints, N = 6, n = 9, m = 6", xlabel="unknown (q, then rates)")
    axes[1].set(ylabel="constraint")
    below(axes[1])
    stem_and_fruits(axes[2], result)
    axes[2].set_title(f"Fig. 6.4: {result['fruits']} fruits (by rule)")
    save(figure, file)


def stem_and_fruits(axis: Any, result: dict[str, Any]) -> None:
    fruits = np.array(result["positions_m"])
    axis.plot([0.241, 0.241], [0.81, 0.81], [0.7, 1.7], color="darkgreen", linewidth=4, label="stem")
    axis.scatter(*fruits.T, color="gold", s=12, label="fruits")
    axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axis.set(xticks=[0.15, 0.25, 0.35], yticks=[0.7, 0.8, 0.9])
    axis.set_box_aspect((1, 1, 2), zoom=0.85)


def draw_typical(result: dict[str, Any], file: Path) -> None:
    """Figures 6.5 and 6.7 of one fruit, its cost over iterations, and its joints' velocities."""
    figure, axes = plt.subplots(2, 3, figsize=(14, 8), layout="constrained")
    one, printed = result["typical"], result["printed"]["typical"]
    top_view(axes[0, 0], one)
    time = np.linspace(0.0, 10.0, 101)
    axis = axes[0, 1]
    axis.plot(time, one["guess"]["heuristic"]["density"], color=GRAY, label="heuristic guess")
    for who, style in (("ipopt", "-"), ("jaxik", "--")):
        row = one[who]["heuristic"]
        axis.plot(time, row["density"], style, color=BLUE, label=f"{LABELS[who]}: {100 * row['saved']:.1f} % saved")
    axis.set(title=f"Fig. 6.7: dynamic cost (printed: {100 * printed['saved']:.1f} % saved)", xlabel="time [s]")
    axis.set_ylabel(r"$\zeta^k l_{dyn}^k$ [rad$^2$/s$^2$]")
    axis.legend(fontsize=8)
    for column, who in ((2, "ipopt"), (1, "jaxik")):
        costs_over_iterations(axes[0 if who == "ipopt" else 1, 2], one[who], who, printed)
        axes[1, column - 1].plot(time, one[who]["heuristic"]["velocity"], label=one["joint_names"])
        axes[1, column - 1].set(title=f"joint velocities, {LABELS[who]}", xlabel="time [s]", ylabel="rad/s (joint1: m/s)")
    axes[1, 0].legend(fontsize=7, ncols=2)
    figure.suptitle(f"Fruit {one['fruit']}, picked by the share saved alone among {one['candidates']} behind the stem")
    save(figure, file)


def top_view(axis: Any, one: dict[str, Any]) -> None:
    """The tip's paths around the stem, from above."""
    axis.add_patch(plt.Circle((0.241, 0.81), 0.015, color="darkgreen"))
    for tip, colour, label in (
        (one["guess"]["heuristic"]["tip_m"], RED, "heuristic guess"),
        (one["guess"]["straight"]["tip_m"], GRAY, "straight guess"),
        (one["jaxik"]["heuristic"]["tip_m"], GREEN, "optimum"),
    ):
        axis.plot(*np.array(tip)[:, :2].T, color=colour, label=label)
    axis.plot(*one["position_m"][:2], "o", color="gold", label="fruit")
    axis.set(title="Fig. 6.5: the tip from above", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axis.legend(fontsize=8)


def costs_over_iterations(axis: Any, rows: dict[str, Any], who: str, printed: dict[str, Any]) -> None:
    for name, colour in COLOURS.items():
        row, count = rows[name], printed["iterations"][name]
        label = f"{name} guess: {row['iterations']} (printed {count})"
        axis.plot(row["cost_at"], row["cost_course"], color=colour, label=label)
    axis.set(title=f"cost over iterations, {LABELS[who]}", xlabel="iteration", ylabel="cost", yscale="log")
    axis.legend(fontsize=8)


def save(figure: Any, file: Path) -> None:
    figure.savefig(file, dpi=110)
    plt.close(figure)

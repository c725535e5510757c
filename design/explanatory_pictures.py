"""Pictures of pages that explain something, from the tables in docs/data or drawn.

Run: python design/explanatory_pictures.py PICTURES.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

DATA = Path(__file__).resolve().parents[1] / "docs" / "data"

COLOURS = ("#0b62a4", "#d1510a", "#2a8a3e", "#8a6d00")
GREY = "0.45"


def main(pictures: Path) -> None:
    """Write all pictures as SVG."""
    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "explanatory"
    pictures.mkdir(parents=True, exist_ok=True)
    for name, draw in (
        ("frames", _frames), ("interval", _interval), ("accuracy", _accuracy), ("robustness", _robustness),
        ("methods", _methods), ("arm", _arm), ("static", _static),
        ("tray", _tray),
    ):  # fmt: skip
        draw().savefig(pictures / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")


def _rows(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _axes(height: float = 3.2) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, height), layout="constrained")
    return figure, figure.subplots()


# Drawn


def _arrow(
    ax: Axes, at: tuple[float, float], by: tuple[float, float], text: str, colour: str, *, away: float = 0.12
) -> None:
    ax.annotate("", (at[0] + by[0], at[1] + by[1]), at, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8})
    long = np.hypot(*by)
    ax.text(
        at[0] + by[0] * (1 + away / long),
        at[1] + by[1] * (1 + away / long),
        text,
        color=colour,
        ha="center",
        va="center",
    )


def _frames() -> Figure:
    """Return the frames of the model: the robot's base r, the tool b, and the device with its three accelerometers."""
    figure, ax = _axes(3.4)
    base, b = (0.0, 0.0), (3.6, 1.6)
    ax.plot([0.0, 0.9, 2.9, 3.6], [0.0, 2.0, 2.1, 1.6], color="0.82", lw=12, solid_capstyle="round", zorder=0)
    for at, name, turn in ((base, "r", 0.0), (b, "b", 0.5)):
        for angle, axis, colour in ((0.0, "x", COLOURS[0]), (np.pi / 2, "z", COLOURS[2])):
            _arrow(ax, at, (0.8 * np.cos(angle + turn), 0.8 * np.sin(angle + turn)), f"${axis}_{name}$", colour)
        ax.text(at[0] - 0.3, at[1] - 0.25, f"${name}$", size=14)
    ax.add_patch(matplotlib.patches.Rectangle((3.55, -0.3), 1.9, 1.05, fill=False, ec="0.3", lw=1.4))
    ax.text(5.6, 0.6, "IMU", color="0.3")
    for (x, y), name, colour in (
        ((3.9, 0.1), "x", COLOURS[0]),
        ((4.6, -0.05), "y", COLOURS[1]),
        ((5.2, 0.3), "z", COLOURS[2]),
    ):
        ax.annotate("", (x, y), b, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.1, "ls": "--"})
        ax.plot(x, y, "s", color=colour, ms=7)
        ax.text(x + 0.12, y - 0.05, f"$r_{name}$", color=colour)
    _arrow(ax, (6.4, 2.4), (0.0, -0.9), "$g^r$", "0.2")
    ax.annotate("", b, base, arrowprops={"arrowstyle": "-|>", "color": GREY, "lw": 1.1, "ls": ":"})
    ax.text(1.0, 0.1, "$p,\\ q_{rb}$: the reported pose", color=GREY)
    ax.set(xlim=(-0.6, 7.0), ylim=(-0.6, 2.9), aspect="equal")
    ax.axis("off")
    return figure


def _interval() -> Figure:
    """Return one interval between updates: IMU samples, sigma points that spread, an update that narrows them."""
    figure, ax = _axes(2.6)
    t = np.linspace(0.0, 1.0, 60)
    for start in (0.0, 1.0):
        for k, spread in enumerate(np.linspace(-1.0, 1.0, 7)):
            path = 0.35 * np.sin(2.4 * (t + start)) + spread * (0.05 + 0.22 * t**1.5)
            ax.plot(t + start, path, color=COLOURS[0], lw=1.6 if k == 3 else 0.8, alpha=1.0 if k == 3 else 0.5)
    for at in (0.0, 1.0, 2.0):
        value = 0.35 * np.sin(2.4 * at) if at < 2.0 else 0.35 * np.sin(4.8)
        ax.errorbar(at, value + 0.03, yerr=0.09, fmt="o", color=COLOURS[1], capsize=3, zorder=3)
    ax.plot(np.linspace(0.0, 2.0, 81), np.full(81, -0.72), "|", color=GREY, ms=5)
    ax.text(2.06, -0.72, "IMU samples", color=GREY, va="center")
    ax.text(2.06, 0.35 * np.sin(4.8), "pose: update", color=COLOURS[1], va="center")
    ax.text(2.06, 0.12, "sigma points", color=COLOURS[0], va="center")
    ax.set(xlim=(-0.1, 2.75), ylim=(-0.85, 0.75), xlabel="time", ylabel="position", xticks=[], yticks=[])
    return figure


# From tables


def _accuracy() -> Figure:
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    rows = [row for row in _rows("accuracy.csv") if row["reference"] == "arm with joint angles"]
    columns = (
        ("gyro scale, ppm", "gyro scale (ppm)"),
        ("accel. bias, mg", "accelerometer bias (mg)"),
        ("gyro non-orth., mrad", "gyro non-orthogonality (mrad)"),
    )
    for ax, (column, title) in zip(figure.subplots(1, 3), columns, strict=True):
        for device, colour in zip(dict.fromkeys(row["device"] for row in rows), COLOURS, strict=False):
            own = [row for row in rows if row["device"] == device and row[column]]
            ax.loglog(
                [float(row["duration, s"]) for row in own],
                [float(row[column]) for row in own],
                "o-",
                color=colour,
                label=device,
            )
        ax.set(xlabel="Duration (s)", title=title)
        ax.title.set_size("small")
        ax.set_xticks([60, 180, 600], ["60", "180", "600"], minor=False)
        ax.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    figure.axes[0].legend(fontsize="small")
    return figure


def _tray() -> Figure:
    """Return deviations of a unit over the number of units on its tray, in shares of those of a unit alone."""
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    rows = _rows("tray-deviations.csv")
    columns = [name for name in rows[0] if name not in ("arm", "units")]
    for ax, arm in zip(figure.subplots(1, 2, sharey=True), dict.fromkeys(row["arm"] for row in rows), strict=True):
        own = [row for row in rows if row["arm"] == arm]
        for k, column in enumerate(columns):
            values = np.array([float(row[column]) for row in own])
            colour = (*COLOURS, GREY)[k]
            ax.plot(
                [int(row["units"]) for row in own], values / values[0], "o-", color=colour, label=column.split(" (")[0]
            )
        ax.set_xscale("log", base=2)
        ax.set_xticks([1, 2, 4, 8, 16], ["1", "2", "4", "8", "16"])
        ax.set(xlabel="Units on the tray", title=f"Arm: {arm}", ylim=(0.0, 1.3))
        ax.title.set_size("small")
    figure.axes[0].set_ylabel("Deviation, over that of a unit alone")
    figure.axes[0].legend(fontsize="x-small", loc="lower left")
    return figure


def _robustness() -> Figure:
    """Return what becomes of runs with errors outside the model, as shares."""
    runs = [
        ("errors on the list", _rows("robustness.csv")[:1]),
        ("drawn at random", _rows("random.csv")[:1]),
        ("users' own kinds of data", _rows("foreign.csv")[:1]),
        ("without a reference", _rows("static.csv")),
    ]
    figure, ax = _axes(2.6)
    for i, (_, own) in enumerate(runs):
        total, accepted, wrong = (sum(int(one[name]) for one in own) for name in ("runs", "accepted", "wrong"))
        parts = ((accepted - wrong, COLOURS[2], "accepted and right"), (wrong, "#b3261e", "accepted and wrong"),
                 (total - accepted, "0.7", "rejected or refused"))  # fmt: skip
        left = 0.0
        for value, colour, label in parts:
            ax.barh(i, 100.0 * value / total, left=left, color=colour, label=label if i == 0 else None)
            left += 100.0 * value / total
        ax.text(101, i, f"{wrong} of {accepted} wrong", va="center", size="small")
    ax.set_yticks(range(len(runs)), [name for name, _ in runs])
    ax.invert_yaxis()
    ax.set(xlabel="Share of runs (%)", xlim=(0, 134))
    ax.set_xticks(range(0, 101, 20))
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize="small")
    return figure


def _methods() -> Figure:
    """Return consistency and cost of the estimators, for rich and weak motion."""
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = [row for row in _rows("methods.csv") if row["first errors"].startswith("10")]
    names = list(dict.fromkeys(row["estimator"] for row in rows))
    for k, (motion, colour) in enumerate((("rich", COLOURS[0]), ("weak", COLOURS[1]))):
        own = {row["estimator"]: row for row in rows if row["motion"] == motion}
        at = np.arange(len(names)) + 0.36 * (k - 0.5)
        left.bar(at, [float(own[name]["error / sd"]) for name in names], 0.34, color=colour, label=f"{motion} motion")
        right.bar(at, [float(own[name]["time, s"]) for name in names], 0.34, color=colour)
    left.axhline(1.0, color=GREY, lw=0.8)
    left.set(title="error over deviation", ylim=(0.0, 1.35))
    right.set(title="time of a fit (s)", yscale="log")
    for ax in (left, right):
        ax.set_xticks(range(len(names)), names, rotation=60)
        ax.title.set_size("small")
    left.legend(fontsize="small", loc="upper left", ncols=2)
    return figure


def _arm() -> Figure:
    """Return the pose errors of arms before and after their calibration by the IMU."""
    figure = Figure(figsize=(6.4, 2.8), layout="constrained")
    rows = _rows("arm.csv")
    for ax, unit in zip(figure.subplots(1, 2), ("mm", "mrad"), strict=True):
        for k, (word, colour) in enumerate((("before", COLOURS[1]), ("after", COLOURS[0]))):
            at = np.arange(len(rows)) + 0.36 * (k - 0.5)
            ax.bar(at, [float(row[f"{unit} {word}"]) for row in rows], 0.34, color=colour, label=word)
        ax.set(yscale="log", ylabel=f"Pose error ({unit})")
        ax.set_xticks(
            range(len(rows)),
            [row["cell"].replace(", ", "\n").replace(" recordings", "").replace("zeros of", "zeros") for row in rows],
            size="x-small",
        )
    figure.axes[0].legend(fontsize="small")
    return figure


def _static() -> Figure:
    """Return error over deviation of calibrations without a reference, situation by situation."""
    rows = [row for row in _rows("static.csv") if row["worst accepted"]]
    figure, ax = _axes(3.0)
    worst = [float(row["worst accepted"]) for row in rows]
    order = np.argsort(worst)
    ax.plot(np.arange(len(rows)), np.array(worst)[order], "o", color=COLOURS[0], ms=4)
    ax.axhline(4.0, color="#b3261e", lw=0.8, ls="--")
    ax.text(0, 4.05, "wrong beyond here", color="#b3261e", size="small", va="bottom")
    ax.set(
        ylabel="Worst error of the accepted,\nin deviations",
        xlabel=f"{len(rows)} situations, in this order",
        ylim=(0.0, 5.0),
    )
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Draws ``pages/picture.svg``, the picture at the top of README, from recordings in ``bags/``: ``python docs/picture.py``.

The arm calibrates itself on its empty-hand runs; then the same push (elbow, -300 mA for 0.6 s, from the same pose) is shown with
an empty hand, with 20 g and with 50 g in it. Dots were measured, lines are simulated at the identified mass.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle

from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.robot import load_robot

BAGS = Path(__file__).resolve().parents[1] / "bags"
INK, MUTED, LINE, PUSH = "#1b2430", "#7d8896", "#e4e8ee", "#d18f00"
LOADS = (  # what the hand holds, bag, what is true [g], colour
    ("empty hand", "realistic_s00_empty_00_joint3", 0.0, "#7d8896"),
    ("20 g", "realistic_s00_fixed_light_ball_20g_joint3", 20.0, "#2a7f9e"),
    ("50 g", "realistic_s00_fixed_heavy_ball_50g_joint3", 50.0, "#d1495b"),
)
STYLE = {
    "font.size": 10,
    "font.family": "DejaVu Sans",
    "svg.fonttype": "path",  # looks the same wherever it is shown
    "svg.hashsalt": "proprio_ros",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
}


def weigh() -> list[Any]:
    """The three estimates, each with its run as measured and as simulated."""
    with tempfile.TemporaryDirectory() as folder:
        calibration = Path(folder) / "my_arm.yaml"
        empty = [str(path / "bag_mcap") for path in sorted(BAGS.glob("realistic_s00_empty_*"))]
        calibrate_from_bags(empty, {}, Options(), str(calibration))
        options = Options(probe="payload", calibration=str(calibration))
        return [replay([str(BAGS / bag / "bag_mcap")], options) for _, bag, _, _ in LOADS]


def draw_arm(axes: Any, elbow_end: float) -> None:
    """The arm from the side, before the push and (pale) after it."""
    robot = load_robot("open_manipulator_x")
    start = {"joint1": 0.0, "joint2": -1.4, "joint3": 0.6, "joint4": 0.0, "gripper_left_joint": 0.0}
    frames = ("link2", "link3", "link4", "link5", "end_effector_link")
    for pose, alpha in (({**start, "joint3": elbow_end}, 0.22), (start, 1.0)):
        x, z = np.array([robot.model.frame_transform(frame, pose)[[0, 2], 3] for frame in frames]).T
        axes.plot(
            x[:-1],
            z[:-1],
            color=INK,
            lw=11,
            alpha=alpha,
            solid_capstyle="round",
            solid_joinstyle="round",
        )
        along = np.array([x[-1] - x[-2], z[-1] - z[-2]]) / np.hypot(x[-1] - x[-2], z[-1] - z[-2])
        across = np.array([-along[1], along[0]])
        palm = np.array([x[-2], z[-2]]) + 0.066 * along
        axes.plot(
            *np.transpose([(x[-2], z[-2]), palm]),
            color=INK,
            lw=11,
            alpha=alpha,
            solid_capstyle="butt",
        )
        for side in (-1, 1):
            finger = np.array(
                [palm, palm + side * 0.024 * across, palm + side * 0.024 * across + 0.072 * along]
            )
            axes.plot(
                *finger.T,
                color=INK,
                lw=4.5,
                alpha=alpha,
                solid_capstyle="round",
                solid_joinstyle="round",
            )
        axes.add_patch(
            Circle((x[-1], z[-1]), 0.0195, color=LOADS[1][3], alpha=alpha, zorder=5, lw=0)
        )
        for joint in range(1, 4):
            driven = joint == 2
            axes.add_patch(
                Circle(
                    (x[joint], z[joint]),
                    0.0095,
                    color=PUSH if driven else "white",
                    alpha=alpha,
                    zorder=6,
                    lw=0,
                )
            )
    axes.add_patch(Rectangle((-0.03, -0.005), 0.085, 0.022, color=INK))
    axes.plot([-0.22, 0.11], [-0.005, -0.005], color=MUTED, lw=1.5)
    # from where the forearm pointed to where it points after the push
    degrees = (52.0, 83.0)
    radius = 0.155
    axes.add_patch(
        Arc(
            (x[2], z[2]),
            2 * radius,
            2 * radius,
            theta1=degrees[0],
            theta2=degrees[1] - 3,
            color=PUSH,
            lw=2.4,
        )
    )
    ends = [
        np.array([x[2], z[2]]) + radius * np.array([np.cos(a), np.sin(a)])
        for a in np.radians((degrees[1] - 6, degrees[1]))
    ]
    axes.add_patch(
        FancyArrowPatch(
            *ends, color=PUSH, arrowstyle="-|>", mutation_scale=17, shrinkA=0, shrinkB=0
        )
    )
    axes.annotate(
        "300 mA push the elbow\nfor 0.6 s",
        (x[2] - 0.045, 0.052),
        color="#a87300",
        ha="center",
        va="center",
    )
    axes.annotate(
        "what is in\nthe hand?",
        (x[-1] + 0.032, z[-1] - 0.062),
        color=LOADS[1][3],
        ha="center",
        va="top",
    )
    axes.set_aspect("equal")
    axes.set(xlim=(-0.245, 0.125), ylim=(-0.012, 0.41))
    axes.set_axis_off()


def main() -> None:
    estimates = weigh()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 4.7), facecolor="white")
        arm = figure.add_axes((0.005, 0.03, 0.36, 0.90))
        current = figure.add_axes((0.45, 0.735, 0.245, 0.175))
        angle = figure.add_axes((0.45, 0.125, 0.245, 0.475))
        mass = figure.add_axes((0.765, 0.125, 0.215, 0.785))

        draw_arm(arm, float(estimates[1].run_fits[0].measured[-1]))

        current.plot([-0.05, 0, 0, 0.6, 0.6, 0.72], [0, 0, -300, -300, 0, 0], color=PUSH, lw=2.2)
        current.set(
            xlim=(-0.05, 0.74), ylim=(-345, 45), yticks=[0, -300], title="motor current, mA"
        )
        current.tick_params(labelbottom=False)

        for (name, _, _, colour), estimate in zip(LOADS, estimates, strict=True):
            run = estimate.run_fits[0]
            angle.plot(run.times_s, run.simulated, color=colour, lw=1.6)
            angle.plot(run.times_s, run.measured, "o", color=colour, ms=3.6, mew=0)
            angle.plot(
                run.left_out_times_s, run.left_out, "o", color=colour, ms=3.6, mew=0, alpha=0.4
            )
            end = [(*run.times_s, *run.left_out_times_s)[-1], (*run.measured, *run.left_out)[-1]]
            angle.annotate(
                name.replace(" hand", "\nhand"), end, xytext=(7, 0), textcoords="offset points", color=colour,
                va="bottom" if name == "empty hand" else "center", annotation_clip=False,
            )  # fmt: skip
        angle.set(
            xlim=(-0.05, 0.74),
            xlabel="time since the current came on, s",
            title="elbow's encoder, rad",
        )
        angle.plot([], [], "o", color=INK, ms=3.6, mew=0, label="measured")
        angle.plot([], [], color=INK, lw=1.6, label="simulated")
        angle.legend(
            loc="lower left", frameon=False, fontsize=9, handlelength=1.3, borderaxespad=0.1
        )

        for row, ((_, _, truth, colour), estimate) in enumerate(
            list(zip(LOADS, estimates, strict=True))[1:]
        ):
            value = next(value for value in estimate.values if value.name == "payload_mass")
            low, high = (1e3 * end for end in value.ci95)
            height = 1 - row
            mass.plot(
                [low, high],
                [height, height],
                color=colour,
                lw=7,
                alpha=0.35,
                solid_capstyle="round",
            )
            mass.plot(1e3 * value.value, height, "o", color=colour, ms=9, mew=0)
            mass.plot(truth, height - 0.14, "^", color=INK, ms=6, mew=0)
            mass.annotate(
                f"{1e3 * value.value:.1f} g", (1e3 * value.value, height + 0.13), color=colour, ha="center", fontsize=15,
                weight="bold",
            )  # fmt: skip
            mass.annotate(
                f"95 % interval {low:.1f} .. {high:.1f} g\n$\\blacktriangle$ true: {truth:.0f} g",
                (35, height - 0.22), color=MUTED, ha="center", va="top", fontsize=9, linespacing=1.5,
            )  # fmt: skip
        mass.set(
            xlim=(8, 62),
            ylim=(-0.52, 1.42),
            yticks=[],
            xlabel="mass in the hand, g",
            title="identified",
        )
        mass.spines["left"].set_visible(False)
        for axes in (current, angle, mass):
            axes.grid(axis="x" if axes is mass else "both", color=LINE)
        figure.savefig(
            Path(__file__).parent / "pages" / "picture.svg",
            metadata={"Date": None, "Creator": None},
        )


if __name__ == "__main__":
    main()

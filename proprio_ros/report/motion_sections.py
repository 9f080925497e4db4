"""What the page of a motion has: arm and payload, torque of each joint measured and explained, and what told the mass."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from proprio_ros.identification.estimate import HeldView, JointFit
from proprio_ros.quantity import Z95, spec_for
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import breakable, framed, percent
from proprio_ros.report.pictures import ArmPicture

HINT = (
    "Rest the pointer on a curve for its values; drag to look closer, double-click for all of it."
)
_INERTIA = {
    "identified": "Ellipsoid: the homogeneous one of that mass and inertia, both identified.",
    "stated": "Ellipsoid: the homogeneous one of that mass, with inertia as stated.",
    "assumed": "Ellipsoid: the homogeneous one of that mass; its inertia is assumed, this motion does not determine it.",
}


def arm_and_payload(views: Sequence[HeldView]) -> list[str]:
    """The arm with what it held, and closer."""
    if not views:
        return []
    about = "Strong: the arm where the hand is farthest out, with a ring where the object is attached; faint: at other instants."
    pictures = "".join(
        framed(held_figure(view, len(views) == 1), view.side.capitalize()) for view in views
    )
    if views[0].centre is not None:
        interval = "" if views[0].within is None else "; dashed: its 95 % interval"
        about += f" Cross: the payload's centre of mass{interval}. {_INERTIA.get(views[0].inertia_is, '')}"
        pictures += "".join(
            framed(held_figure(view, closer=True), f"{view.side.capitalize()}, closer")
            for view in views
        )
    return [
        "<h2>Arm and payload</h2>",
        f"<div class=views>{pictures}</div>",
        f"<p class=small>{escape(about)}</p>",
    ]


def held_figure(view: HeldView, alone: bool = False, closer: bool = False) -> str:
    """Arm and payload in one plane.

    Args:
        view: Arm and payload, as they were.
        alone: Whether only what moves of the arm is drawn.
        closer: Whether only what is near the hand is.
    """
    outlines = [
        view.hand[None],
        *(each for each in (view.within, view.body) if each is not None),
    ]
    travel = np.ptp(view.arm, axis=0).max(axis=(1, 2))
    moves = travel > (0.0 if alone else -1.0)
    arm = [] if closer else [view.arm[:, moves].reshape(-1, 2)]
    picture = ArmPicture.around(
        np.concatenate([*arm, *outlines]),
        closer or alone,
    )
    if not (alone or closer or view.side == "from above"):
        picture.ground()
    for links in view.arm[: 0 if closer else -1]:
        picture.links(links, "faintly")
    picture.links(view.arm[-1], "end", view.hand)
    if view.body is not None:
        picture.outline(view.body, "body")
    if view.within is not None:
        picture.outline(view.within, "within")
    if view.centre is not None:
        picture.cross(view.centre)
    return picture.svg(f"Arm and payload {view.side}{', closer' * closer}")


def what_told(fits: Sequence[JointFit]) -> list[str]:
    """Which joints and seconds told the mass."""
    if not fits:
        return []
    about = (
        "Shares of what is known of the mass, the stronger the more: the square of the torque that a kilogram makes there, over "
        "that of what stays unexplained of the joint's torque."
    )
    most = max(float(fit.told.max(initial=0.0)) for fit in fits) or 1.0
    parts = [
        "<h2>Which joints and which seconds told the mass</h2>",
        f"<p class=small>{escape(about)}</p>",
    ]
    for name in dict.fromkeys(fit.name for fit in fits):
        mine = [fit for fit in fits if fit.name == name]
        rows = "".join(
            f"<tr><td>{breakable(fit.joint)}</td><td>{_strip(fit.told / most)}</td>"
            f"<td class=number>{percent(float(fit.told.sum()))}</td></tr>"
            for fit in sorted(mine, key=lambda fit: -float(fit.told.sum()))
        )
        end_s = len(mine[0].told) * mine[0].part_s
        ends = "".join(
            f"<span>{share * end_s:.{0 if end_s > 10.0 else 1}f} s</span>"
            for share in (0.0, 0.5, 1.0)
        )
        parts.append(
            f"<h3>{escape(name)}</h3><table class='bars strips'><tbody>{rows}<tr><td></td><td><div class=ends>{ends}</div></td><td>"
            "</td></tr></tbody></table>"
        )
    return parts


def _strip(shares: np.ndarray) -> str:
    """A cell for each part of a recording, as dark as its share of the most, 0 to 1."""
    cells = "".join(
        f'<rect x="{place}" width="1" height="1" opacity="{share:.2f}"/>'
        for place, share in enumerate(shares)
        if share >= 0.005
    )
    return (
        f'<svg class="strip" role="img" aria-label="Share over time" viewBox="0 0 {len(shares)} 1" '
        f'preserveAspectRatio="none" shape-rendering="crispEdges">{cells}</svg>'
    )


def torques(
    fits: Sequence[JointFit],
    weighed: bool,
    learnt: bool = False,
) -> list[str]:
    """Measured and explained torque of each joint.

    Args:
        fits: Of each joint.
        weighed: Whether a payload has a part of it.
        learnt: Whether the arm was learnt from these.
    """
    if not fits:
        return []
    by = "the arm, its friction and the payload"
    where = " where the load is known"
    if learnt:
        by = "the arm and its friction"
        where = " over all motions"
    about = (
        f"Means over windows of half a second. Explained: by {by} as they were identified. "
        f"Band: two standard deviations of what stays unexplained{where}."
    )
    parts = ["<h2>Measured against explained</h2>", f"<p class=small>{escape(about)}</p>"]
    parts.append(f"<p class='small hint'>{HINT}</p>")
    several = len({fit.name for fit in fits}) > 1
    if not learnt:  # what told most comes first
        by_share = sorted(fits, key=lambda fit: -float(fit.told.sum()))
        told = [fit.joint for fit in by_share]
        fits = sorted(
            fits,
            key=lambda fit: (fit.name, told.index(fit.joint)),
        )
    for fit in fits:
        title = f"{fit.name}: {fit.joint}" if several else fit.joint
        left_over, known = (
            f"{rms:{spec_for('', rms / Z95, kept=True)}} N m" for rms in (fit.left_over, fit.usual)
        )
        usual = f", {known}{where}" if fit.usual > 0.0 and (several or not learnt) else ""
        told_mass = (
            f"Told {percent(float(fit.told.sum()))} of the mass; "
            if len(fits) > 1 and not learnt
            else ""
        )
        words = f"{told_mass}{left_over} stay unexplained (rms){usual}."
        figure = framed(torque_figure(fit, weighed))
        parts.append(f"<h3>{escape(title)}</h3><p class=small>{escape(words)}</p>{figure}")
    return parts


def torque_figure(fit: JointFit, with_payload: bool) -> str:
    """Torque over time, what explains it, and what is left over; ``with_payload``: also without what the payload makes of it."""
    small = float(np.abs(fit.measured).max(initial=0.0)) < 1.0
    factor, unit = (1e3, "mN m") if small else (1.0, "N m")
    times = fit.times_s
    explained = factor * fit.explained
    traces = [
        Series("measured", times, factor * fit.measured, "measured"),
        Series("explained", times, explained, "simulated"),
    ]
    if with_payload:
        traces.insert(
            0, Series("without the payload", times, explained - factor * fit.payload, "left-out")
        )
    off = Series(
        "explained less measured",
        times,
        explained - factor * fit.measured,
        "simulated",
        listed=False,
    )
    band = None
    if fit.usual > 0.0:
        width = np.full(len(times), 2.0 * factor * fit.usual)
        band = (times, -width, width)
    panels = [
        Panel(f"torque ({unit})", unit, traces, 120.0),
        Panel(f"residual ({unit})", unit, [off], 70.0, band, rules=[0.0]),
    ]
    return chart(
        panels,
        Axis("time (s)", "s"),
        f"{fit.joint}: measured and explained torque and residual over time",
    )

"""Draws ``pages/moving.svg``, the arm in motion at the top of README, from ``bags/``: ``python docs/moving_picture.py``.

The same push of the elbow with an empty hand, 20 g and 50 g, side by side and slowed: forearms turn as the encoder measured. The
picture moves by itself (SMIL), where it is an image, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from picture import INK, LOADS, MUTED, PUSH, weigh

from proprio_ros.robot import load_robot

PAGE = Path(__file__).parent / "pages" / "moving.svg"
START = {"joint1": 0.0, "joint2": -1.4, "joint3": 0.6, "joint4": 0.0, "gripper_left_joint": 0.0}
FRAMES = ("link2", "link3", "link4", "link5", "end_effector_link")
ELBOW = 2  # of these, the driven one
WIDTH, HEIGHT = 300, 330  # of one arm [px]
PX_PER_M = 580.0
ORIGIN = (185.0, 268.0)  # of the base in it [px]
SLOWED = 3.0
REST_S = 0.6  # before the push
WHOLE_S = 4.4  # of all of it, the same of each arm
BACK_S = 0.8  # of its end, on the way back
SAMPLES = 40  # of a push that are shown
ROUND = 'fill="none" stroke-linecap="round" stroke-linejoin="round"'


def main() -> None:
    parts = []
    for number, ((name, _, _, colour), estimate) in enumerate(zip(LOADS, weigh(), strict=True)):
        parts.append(f'<g transform="translate({number * WIDTH},0)">')
        parts += [*_arm(estimate, name, colour), *_words(estimate, name, colour), "</g>"]
    size = f'width="{3 * WIDTH}" height="{HEIGHT}" viewBox="0 0 {3 * WIDTH} {HEIGHT}"'
    style = "text{font-family:DejaVu Sans,Verdana,sans-serif;text-anchor:middle}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{style}</style>'
    ground = f'<rect width="100%" height="100%" fill="#fff"/><path d="M10 {ORIGIN[1] + 4} H{3 * WIDTH - 10}" stroke="{MUTED}"/>'
    PAGE.write_text("\n".join([head, ground, *parts, "</svg>"]) + "\n", encoding="utf-8")


def _points(elbow_rad: float) -> np.ndarray:
    """Where the joints and the hand are on the picture, seen from the side, shape (5, 2)."""
    model = load_robot("open_manipulator_x").model
    pose = {**START, "joint3": elbow_rad}
    places = np.array([model.frame_transform(frame, pose)[[0, 2], 3] for frame in FRAMES])
    return np.array(ORIGIN) + PX_PER_M * places * (1.0, -1.0)


def _arm(estimate: Any, name: str, colour: str) -> Iterator[str]:
    """Upper arm, and a forearm that turns about the elbow as it was measured."""
    run = estimate.run_fits[0]
    measured = np.concatenate([run.measured, run.left_out])
    times_s = np.concatenate([run.times_s, run.left_out_times_s])
    shown = np.unique(np.linspace(0, len(times_s) - 1, SAMPLES).astype(int))
    points = _points(float(measured[0]))
    x, y = points[ELBOW]
    degrees = [_turned(points, float(elbow)) for elbow in measured[shown]]
    yield f'<path d="{_line(points[: ELBOW + 1])}" stroke="{INK}" stroke-width="15" {ROUND}/>'
    yield "<g>"
    yield _turning(degrees, times_s[shown], (float(x), float(y)))
    palm = points[3] + 0.55 * (points[4] - points[3])
    yield f'<path d="{_line([points[ELBOW], points[3], palm])}" stroke="{INK}" stroke-width="15" {ROUND}/>'
    along = (points[4] - points[3]) / np.linalg.norm(points[4] - points[3])
    across = np.array([-along[1], along[0]])
    for side in (-1.0, 1.0):
        finger = [palm, palm + side * 17 * across, palm + side * 17 * across + 46 * along]
        yield f'<path d="{_line(finger)}" stroke="{INK}" stroke-width="6" {ROUND}/>'
    if name != LOADS[0][0]:
        yield f'<circle cx="{points[4][0]:.1f}" cy="{points[4][1]:.1f}" r="13" fill="{colour}"/>'
    yield "</g>"
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="{PUSH}"/>'


def _turned(points: np.ndarray, elbow_rad: float) -> float:
    """By how much the forearm has turned on the picture [degree], clockwise."""
    before, after = (where[3] - where[ELBOW] for where in (points, _points(elbow_rad)))
    cross = before[0] * after[1] - before[1] * after[0]
    return float(np.degrees(np.arctan2(cross, before @ after)))


def _turning(degrees: Sequence[float], times_s: np.ndarray, about: tuple[float, float]) -> str:
    """Rest, the push, a pause at its end, and the way back, again and again."""
    pushed = REST_S + SLOWED * (times_s - times_s[0])
    instants = [0.0, *pushed, WHOLE_S - BACK_S, WHOLE_S]
    angles = [degrees[0], *degrees, degrees[-1], degrees[0]]
    values = ";".join(f"{angle:.2f} {about[0]:.1f} {about[1]:.1f}" for angle in angles)
    keys = ";".join(f"{instant / WHOLE_S:.4f}" for instant in instants)
    return (
        f'<animateTransform attributeName="transform" type="rotate" dur="{WHOLE_S}s" repeatCount="indefinite" '
        f'values="{values}" keyTimes="{keys}"/>'
    )


def _line(points: Any) -> str:
    return "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _words(estimate: Any, name: str, colour: str) -> Iterator[str]:
    """What it holds, and what was identified."""
    value = estimate.values[0]
    low, high = (1e3 * end for end in value.ci95)
    middle = WIDTH / 2
    found = f"{1e3 * value.value:.1f} g, {low:.1f} to {high:.1f} g"
    yield f'<text x="{middle}" y="20" font-size="15" font-weight="bold" fill="{colour}">{name}</text>'
    yield f'<text x="{middle}" y="298" font-size="14" fill="{INK}">identified: {found}</text>'
    yield f'<text x="{middle}" y="318" font-size="11" fill="{MUTED}">300 mA at the elbow, {SLOWED:g} times slower</text>'


if __name__ == "__main__":
    main()

"""Draws two pictures of the page of a motion, ``pages/motion_*.svg``: ``PYTHONPATH=test python docs/motion_picture.py``.

An arm of six joints in MuJoCo, whose links, friction, rotors and torque constants are not those of its robot file, moves with a box
of 2 kg in its hand, and with an empty hand before. What is drawn is what ``--report`` draws: the arm with the payload, and the
joint that determined most of the mass.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from paper_results import alone
from support.arm_in_motion import SIX, Twin, write_robot
from support.fleet import write_bag

from proprio_ros import weigh
from proprio_ros.report.motion_sections import held_figure, torque_figure

PAGES = Path(__file__).resolve().parent / "pages"
BOX_KG = 2.0
CENTRE_M = (0.12, 0.06, -0.04)
MOMENTS = (0.03, 0.05, 0.06)
DRAWN = r"svg text|\.(arm|chart)|\.(measured|simulated|left-out)\b"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        twin = Twin(11)
        box = twin.record("box", 20.0, (BOX_KG, np.array(CENTRE_M)), MOMENTS)
        bags = [
            write_bag(folder / motion.name, motion, constants=SIX.constants)
            for motion in (box, twin.record("empty", 20.0))
        ]
        found = weigh(
            bags[0], baseline=bags[1], robot=write_robot(folder), effort_unit="N.m"
        ).estimate
    most = max(found.joint_fits, key=lambda fit: float(fit.told.sum()))
    for name, svg in (
        ("arm", held_figure(found.held_views[0])),
        ("torque", torque_figure(most, True)),
    ):
        (PAGES / f"motion_{name}.svg").write_text(alone(svg, DRAWN), encoding="utf-8")


if __name__ == "__main__":
    main()

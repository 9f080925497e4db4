"""A recording as the paper (Chen et al. 2025, arXiv:2410.03920) published its own.

Positions of one joint as text, and the setting in which they were fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from proprio_ros.recordings.text import TextRecording
from proprio_ros.records import Run
from proprio_ros.robot import Robot

FRAME_S = 1.0 / 60.0  # the paper's frame
PROBE_FRAMES = 36
"""The paper's elbow probe lasts 0.6 s: 36 frames. Its recording goes on for longer, without saying what the motor did then."""


def published_robot(robot: Robot, text: TextRecording) -> Robot:
    """The robot with what the recording's own setting states: armature, and the torque that the current stands for."""
    stated = {}
    drive = robot.drive_trains.get(text.joint)
    if drive is not None:
        nominal = abs(float(text.setting["torque_N_m"]) / _current(text))
        stated["torque_constant_N_m_per_A"] = {"value": nominal, "std": drive.torque_constant.std}
        if "armature_kg_m2" in text.setting:
            stated["armature_kg_m2"] = {
                "value": float(text.setting["armature_kg_m2"]),
                "std": drive.armature.std,
            }
    robot = robot.with_overrides(
        {f"joints.{text.joint}.drive_train.{key}": entry for key, entry in stated.items()}
    )
    if "gravity_m_s2" in text.setting:
        robot = replace(
            robot,
            gravity=np.array([0.0, 0.0, -float(text.setting["gravity_m_s2"])]),
        )
    return robot


def published_run(
    robot: Robot,
    text: TextRecording,
    held: Mapping[str, float],
) -> Run:
    """The run, in the pose that its setting states.

    Args:
        robot: As of `published_robot`.
        text: The recording.
        held: Positions of other joints that overrule the setting [rad or m].

    Returns:
        The run, as long as the paper's probe.
    """
    pose = {name: float(value) for name, value in text.setting["start_pose_rad"].items()}
    start = pose.pop(text.joint)
    gripper = {
        name: 0.0
        for name in robot.model.independent_joints
        if name != text.joint and name not in pose
    }
    others = {**gripper, **pose, **held}
    used = text.times_s <= PROBE_FRAMES * FRAME_S + 1e-6
    return Run(
        name=text.name,
        joint=text.joint,
        onset_ns=0,
        times_s=text.times_s[used],
        position=start + text.relative_position[used],
        before_times_s=np.zeros(0),
        before_position=np.zeros(0),
        held=others,
        held_span=dict.fromkeys(others, 0.0),
        input_times_s=np.zeros(1),
        input_current_A=np.array([_current(text)]),
        duration_s=float(text.times_s[used][-1]),
        source="the torque in setting.json",
        notes=(
            *(f"{name} is not in the recording and was taken as 0" for name in gripper),
            *(
                [f"{(~used).sum()} samples after the probe of {PROBE_FRAMES} frames were left out"]
                * (not used.all())
            ),
        ),
    )


def _current(text: TextRecording) -> float:
    """Current whose sign is the torque's [A]."""
    stated = float(text.setting.get("current_A_by_the_paper", 0.0)) or 1.0
    return float(
        np.copysign(
            stated,
            float(text.setting["torque_N_m"]),
        )
    )

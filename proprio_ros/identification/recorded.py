"""What was recorded of each run, for those who want to see it before any fit."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from proprio_ros.errors import RobotError
from proprio_ros.identification.estimate import RecordedRun
from proprio_ros.identification.prepared_runs import at_the_shaft
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import side_view

BEFORE_SHARE = 0.3  # so much of a run's duration is shown of what came before it


def recorded_run(robot: Robot, run: Run, baseline: bool = False) -> RecordedRun:
    """A run as a page shows it; ``baseline`` is one made without what is to be identified."""
    shown = run.before_times_s >= -BEFORE_SHARE * run.duration_s
    position = np.concatenate([run.before_position[shown], run.position])
    seen = at_the_shaft(robot, run)
    slides = seen is run and robot.model.joint(run.joint).kind == "prismatic"
    arm, driven = np.zeros((2, 0, 2, 2)), np.zeros((2, 2))
    if len(position):
        poses = [{**run.held, run.joint: float(position[row])} for row in (0, -1)]
        with suppress(RobotError):  # locked joints that nobody recorded: the fit asks for those that matter to it
            arm, driven = side_view(robot, run.joint, poses)
    return RecordedRun(
        run.name,
        run.joint,
        run.source,
        "m" if slides else "rad",
        np.concatenate([run.before_times_s[shown], run.times_s]),
        np.concatenate([seen.before_position[shown], seen.position]),
        run.input_times_s,
        run.input_current_A,
        run.duration_s,
        arm,
        driven,
        baseline,
    )

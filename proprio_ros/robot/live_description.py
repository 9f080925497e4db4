"""A robot's description as a topic brings it: the first that can be used is kept as a file, and later ones are compared with it.

From there on it is a URDF file like any other, so what is live and what is replayed later read the same robot. No ROS here.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from proprio_ros.errors import ProprioError, RobotError
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.robot.description import check_masses
from proprio_ros.robot.tree import RobotModel

USUAL = "robot_description"


def is_topic(robot: str) -> bool:
    """Whether a robot is stated by the topic of its description, in whatever namespace."""
    return robot.rsplit("/", 1)[-1] == USUAL


def topic_of(robot: str) -> str:
    """That topic, and the usual one where the robot is stated otherwise."""
    return robot if is_topic(robot) else USUAL


class LiveDescription:
    """What was heard on a topic; descriptions are kept below a folder.

    Attributes:
        path: Of the URDF file that counts; None: none was heard that can be used.
        problem: Why the robot can't be relied on now, in a sentence; empty: it can.
    """

    def __init__(self, topic: str, folder: Path) -> None:
        self._topic = topic
        self._folder = folder
        self._fingerprint = ""
        self.path: Path | None = None
        self.problem = (
            f"waits for {topic} (std_msgs/String, latched), as robot_state_publisher publishes it"
        )

    def hear(self, text: str) -> tuple[str, str]:
        """Takes the text of a URDF; returns ``info`` or ``warning``, and what there is to say; empty: nothing is new."""
        try:
            model = _usable(text, self._topic)
            if self.path is None:
                self.path = self._kept(text, model)
                self._fingerprint = model.fingerprint()
        except ProprioError as error:
            if self.path is not None:
                return "warning", f"{error}; goes on with the one from before"
            return self.refuse(str(error))
        before = self.problem
        self.problem = ""
        if model.fingerprint() != self._fingerprint:
            self.problem = (
                f"{self._topic} has changed: {model.name} of now ({model.fingerprint()[:12]}..) is another model than that which "
                f"this node began with ({self._fingerprint[:12]}..): configure this node again, or restart it"
            )
            return "warning", "" if before == self.problem else self.problem
        return "info", f"the robot is that of {self._topic}: {self.path}" if before else ""

    def refuse(self, why: str) -> tuple[str, str]:
        """What was heard cannot be used after all; returns what there is to say."""
        self.path = None
        self.problem = f"cannot be used: {why}; waits for another description on {self._topic}"
        return "warning", self.problem

    def _kept(self, text: str, model: RobotModel) -> Path:
        """The file: named after the model, so that its calibration is found again, in a folder of this very text.

        Limits are no part of a fingerprint, but wide defaults go by them: a recording must find the text it was identified with.
        """
        # what is decoded already must not be decoded by what it says of itself
        document = re.sub(r"\A\s*<\?xml[^>]*\?>", "", text)
        name = re.sub(r"[^A-Za-z0-9_-]+", "_", model.name)[:60]
        folder = (
            self._folder.resolve()
            / "descriptions"
            / hashlib.sha256(document.encode()).hexdigest()[:12]
        )
        path = folder / f"{name}_{model.fingerprint()[:12]}.urdf"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RobotError(
                f"{path.parent} cannot be written ({error.strerror}): name another data_directory"
            ) from error
        write_in_one_step(path, document, "the description")
        return path


def _usable(text: str, source: str) -> RobotModel:
    """The model of a description; refuses one that is no URDF, or lacks something."""
    model = RobotModel.from_urdf_string(text, source)
    check_masses(model, source)
    if all(model.joint(name).kind == "prismatic" for name in model.independent_joints):
        raise RobotError(
            f"{source}: no joint of {model.name} turns, so nothing can be weighed with it"
        )
    return model

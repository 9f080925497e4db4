"""What live jobs go by: the robot and its calibration, what is stated about the object, and the folder where all of it is kept.

No ROS here. Beside the recordings a link to the calibration of the robot, and one to the newest baseline of each probe, say what
holds until something else is made. A calibration that knows fewer joints under current than the one in use, as one of free swings
does, does not take its place.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.live.session import as_parameters, live_request, settings_for
from proprio_ros.pipeline.request import Options, Request, robot_of
from proprio_ros.probes.base import Probe
from proprio_ros.recordings.sources import open_recording
from proprio_ros.robot import Robot

# age of a baseline that is worth a warning: nobody remembers what was changed since
OLD_S = 86400.0


@dataclass
class Workspace:
    """What holds of one robot until something else is made."""

    data: Path  # the folder
    robot: str  # its name or file
    # what a replay must be told to take the same ones
    topics: Mapping[str, Any] = field(default_factory=dict)
    calibration: Path | None = None  # that is used

    def options(self) -> Options:
        """With which a recording is replayed, but for what is in the hand."""
        robot = None if self.calibration else self.robot
        return Options(
            robot=robot,
            calibration=self.calibration,
            **self.topics,
        )

    def request(
        self,
        probe: Probe[Any],
        settings: Mapping[str, Any],
        baseline: Path | None,
    ) -> Request:
        """What a job is about, read once; raises as `request_of` does.

        Args:
            probe: What is identified.
            settings: What is stated about the object.
            baseline: Recording of the hand without it; None: none.
        """
        empty = () if baseline is None else (baseline,)
        stated = settings_for(probe, settings)
        return live_request(
            replace(
                self.options(),
                probe=probe.name,
                settings=stated,
                baseline=empty,
            )
        )

    def configured(self, settings: Mapping[str, Any]) -> Robot:
        """The robot, as calibrated and with what the settings say of it; raises as `robot_of` does."""
        return robot_of(replace(self.options(), settings=settings))

    @property
    def newest_calibration(self) -> Path:
        """A link to it."""
        return self.data / f"{Path(self.robot).stem}_calibration.yaml"

    def find_calibration(self, stated: str) -> str:
        """Take the calibration that is stated by its path; empty: the one last taken of this robot; ``none``: none.

        Returns: Why the newest is not taken, or an empty string.

        Raises `RobotError`: The stated one cannot be used.
        """
        self.calibration = None
        if stated == "none":
            return ""
        # the file behind the link stays what it is, so that a result can be had again
        path = (Path(stated).expanduser() if stated else self.newest_calibration).resolve()
        if not stated and not path.exists():
            return ""
        try:
            robot_of(Options(robot=self.robot, calibration=path))
        except RobotError as error:
            if stated:
                raise RobotError(as_parameters(str(error))) from error
            return f"goes on without calibration: {as_parameters(str(error))}"
        self.calibration = path
        return ""

    def keep_calibration(self, path: Path) -> str:
        """Take a new one from now on, unless the one in use knows all that it knows of joints under current, and of more joints.

        Returns: Why it is not taken, or an empty string.

        Raises `ConfigurationError`: The link to it cannot be written.
        """
        known = self._driven(path)
        used = self._driven(self.calibration)
        if known < used:
            lost = f"the new one does not know what a current does to {', '.join(sorted(used - known))}"
            remedy = "name the new one in the parameter calibration to take it all the same"
            return f"{self.calibration} stays in use, since {lost}: {remedy}"
        self.calibration = path
        _point(self.newest_calibration, path)
        return ""

    def _driven(self, path: Path | None) -> set[str]:
        """Joints of which a calibration knows what a current does; none where it cannot be used any more."""
        if path is None:
            return set()
        try:
            learnt = robot_of(Options(robot=self.robot, calibration=path)).calibration
        except RobotError:
            return set()
        return set() if learnt is None else set(learnt.driven)

    @property
    def used(self) -> str:
        """With which calibration, as part of an answer."""
        return (
            f"; calibration: {self.calibration}" if self.calibration else " (robot not calibrated)"
        )

    def newest_baseline(self, probe: Probe[Any]) -> Path:
        """A link to it."""
        return self.data / f"{Path(self.robot).stem}_{probe.name}_baseline"

    def find_baseline(self, probe: Probe[Any], stated: str) -> Path | None:
        """The recording without what is to be identified: a stated bag; empty: the newest, if there is one; ``none``: none.

        Raises `ConfigurationError`: One was named that is not there, or is none.
        """
        if stated == "none":
            return None
        path = Path(stated).expanduser() if stated else self.newest_baseline(probe)
        if path.is_dir() or path.is_file():
            # whoever names something else hears so now, and not after the arm has moved
            with open_recording(path):
                return path.resolve()
        if stated:
            is_there = "that is no recording" if path.exists() else "there is no such recording"
            remedy = f"{is_there}; name a bag, or leave it empty"
            raise ConfigurationError(f"{probe.name}_baseline {path}: {remedy}")
        return None

    def keep_baseline(self, probe: Probe[Any], bag: Path) -> None:
        """Take a new one from now on. Raises `ConfigurationError`: The link to it cannot be written."""
        _point(self.newest_baseline(probe), bag)

    def about_baseline(self, bag: Path) -> str:
        """How old a baseline is, and whether that is a reason to record it again."""
        made_s = bag.stat().st_mtime
        age_s = max(time.time() - made_s, 0.0)
        age = f"baseline {_duration(age_s)} old: {bag}"
        if self.calibration is not None and self.calibration.stat().st_mtime > made_s:
            return f"{age} (older than the robot's calibration: record it again if the arm has changed between)"
        return f"{age} (record it again if anything has changed since)" if age_s > OLD_S else age


def _point(link: Path, target: Path) -> None:
    """Have the link point to the target, in one step."""
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        fresh.symlink_to(target)
        fresh.replace(link)
    except OSError as error:
        unwritten = f"{link} cannot be written ({error.strerror})"
        raise ConfigurationError(f"{unwritten}; what it should point to is {target}") from error


def _duration(seconds: float) -> str:
    """In the largest unit of which there are two or more."""
    for unit, size_s in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size_s:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds:.0f} s"

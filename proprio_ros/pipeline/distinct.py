"""All recordings that were given, each once: a run that counts twice would narrow the interval without a reason."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.reading import path_problem
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import Run
from proprio_ros.whole_files import real_path


class Distinct:
    """Recordings that must differ from each other.

    Raises `ConfigurationError`: Two of the paths lead to the same place.
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        places: dict[Path, str | Path] = {}
        for path in paths:
            problem = path_problem(path)
            if problem:
                raise ConfigurationError(f"{problem}", path)
            place = real_path(path)
            if place in places:
                raise ConfigurationError(_twice(places[place], path))
            places[place] = path
        self._paths: dict[tuple[object, ...], str | Path] = {}

    def motion(self, path: str | Path, motion: Motion) -> Motion:
        """The motion of one path.

        Raises `ConfigurationError`: Another path held it: the same samples at the same times, and the same currents.
        """
        joints = " ".join(motion.joints)
        self._check(path, joints, motion.times_s, motion.position, motion.current_A)
        return motion

    def runs(self, path: str | Path, runs: Sequence[Run]) -> Sequence[Run]:
        """The runs of one path. Raises `ConfigurationError`: Another path held one of them."""
        for run in runs:
            self._check(path, run.joint, run.times_s, run.position, run.input_current_A)
        return runs

    def _check(self, path: str | Path, joint: str, *arrays: np.ndarray) -> None:
        key: tuple[object, ...] = (
            joint,
            *(array.tobytes() for array in arrays),
        )
        if self._paths.setdefault(key, path) != path:
            raise ConfigurationError(_twice(self._paths[key], path))


def _twice(one: str | Path, other: str | Path) -> str:
    if str(one) == str(other):
        return f"{one} was given twice: name each recording once"
    return f"{one} and {other} are the same recording: name it once"

"""All recordings that were given, each once: a run that counts twice would narrow the interval without a reason."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.reading import path_problem
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import Run
from proprio_ros.whole_files import real_path

_Found = TypeVar("_Found", Motion, Sequence[Run])


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

    def checked(self, path: str | Path, found: _Found) -> _Found:
        """The runs or the motion of one path.

        Raises `ConfigurationError`: Another path held one of them: the same samples at the same times, and the same current.
        """
        if isinstance(found, Motion):
            self._check(
                path, " ".join(found.joints), found.times_s, found.position, found.current_A
            )
        else:
            for run in found:
                self._check(
                    path,
                    run.joint,
                    run.times_s,
                    run.position,
                    run.input_current_A,
                )
        return found

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

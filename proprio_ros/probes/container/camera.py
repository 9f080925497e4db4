"""What a camera saw of the sphere while a run was recorded."""

from __future__ import annotations

from pathlib import Path

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.reading import path_problem
from proprio_ros.probes.container.problem import SphereTrack
from proprio_ros.recordings.contents import read_points
from proprio_ros.recordings.text import read_point_file
from proprio_ros.records import Run

MOST_PLACES = 2000
"""Places of the sphere in one run: two seconds at 1 kHz."""


def track_of(run: Run, source: Path, camera: str | None, std: float) -> SphereTrack | None:
    """Places of the sphere during a run; None without a camera.

    Args:
        run: to be seen.
        source: the bag of the run.
        camera: a topic, which starts with a slash (unless there is such a file), or a CSV file.
        std: of each coordinate [m].

    Raises:
        ConfigurationError: it saw nothing during the run.
    """
    if camera is None:
        return None
    topic = camera.startswith("/") and (path_problem(camera) or not Path(camera).is_file())
    track = read_points(source, camera, "sphere.camera") if topic else read_point_file(camera)
    times_s, position = track.of_run(run)
    if not len(times_s):
        raise ConfigurationError(
            f"sphere.camera={camera}: saw nothing while {run.name} was recorded: its stamps must be on the clock of the joint "
            "states"
        )
    if len(times_s) > MOST_PLACES:
        raise ConfigurationError(
            f"sphere.camera={camera}: saw {len(times_s)} places while {run.name} was recorded, and {MOST_PLACES} are the most that "
            "are fitted: leave some out"
        )
    return SphereTrack(times_s, position, std)

"""Size and place of a container and the sphere in it: from the user's settings and the probe's file, and as a camera saw it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.inputs.forms import Choice, Form, Number, Numbers, Perhaps, Text, Truth
from proprio_ros.inputs.reading import path_problem
from proprio_ros.inputs.settings import Settings, read
from proprio_ros.probes.container.problem import ContainerFacts, SphereTrack
from proprio_ros.quantity import Quantity
from proprio_ros.recordings.contents import read_points
from proprio_ros.recordings.text import read_point_file
from proprio_ros.records import Run
from proprio_ros.robot import rotation_from_rpy
from proprio_ros.sim.sphere import LAWS, Enclosure

MOST_PLACES = 2000  # places of the sphere in one run: two seconds at 1 kHz
DECIDING = ("container.inner_size", "container.centre", "sphere.radius")
"""Facts without a safe default: those of the probe file are the sample recordings'."""
_PLACE = "[x, y, z] in m"
_NEAR_HAND = Number(
    unit="m", lowest=-1.0, highest=1.0, hint="over 1 m away from the hand: lengths are in m"
)
_ANGLE = Number(unit="rad", lowest=-7.0, highest=7.0)
_RATIO = Number(lowest=0.0, highest=10.0)
_INNER = Number(
    unit="m", lowest=0.0, highest=1.0, open=True, hint="lengths are in m, so 60 mm is 0.06"
)
FORMS: dict[str, Form] = {
    "container.shape": Choice("cylinder: its axis along z", ("box", "cylinder", "sphere")),
    "container.centre": Numbers(
        "of the container in `payload.frame`", _NEAR_HAND, 3, example=_PLACE
    ),
    "container.rpy": Numbers(
        "how it is turned against that frame", _ANGLE, 3, example="three angles in rad"
    ),
    "container.mass": Perhaps(
        "of the empty container; null: not known, so `--baseline` is needed",
        Number(unit="kg", lowest=0.0, highest=10.0, hint="masses are in kg"),
    ),
    "container.mass_std": Number(
        "of the scales; counts only where the mass is stated", "kg", 0.0, 10.0
    ),
    "sphere.radius": Number("", "m", 0.0, 0.5, open=True, hint="lengths are in m"),
    "sphere.hollow": Truth("a thin shell rolls with more inertia than a solid ball"),
    "sphere.settled": Truth(
        "it lay still in the lowest place before the current came on; false: anywhere"
    ),
    "sphere.start": Perhaps(
        "of its centre from the container's, where that is known",
        Numbers(
            "",
            Number(unit="m", lowest=-1.0, highest=1.0),
            3,
            example=_PLACE,
        ),
    ),
    "sphere.start_std": Number("how well", "m", 0.0, 1.0),
    "sphere.camera": Perhaps(
        "where a camera saw its centre", Text(what="a topic or a CSV file", longest=4095)
    ),
    "sphere.camera_std": Number("of each coordinate", "m", 0.0, 1.0, open=True),
    "contact.law": Choice("ramped, or the paper's, whose damping sets in at once", LAWS),
    "contact.frequency": Number("of the sphere on a wall", "rad/s", 50.0, 5000.0),
    "contact.damping_ratio": replace(
        _RATIO, meaning="0 bounces for ever, 1 not at all; fitted, within"
    ),
    "contact.damping_ratio_std": _RATIO,
    "contact.friction": replace(_RATIO, meaning="between sphere and walls; fitted, within"),
    "contact.friction_std": _RATIO,
    "contact.traction": Number("how fast slip is lost while it rolls", "1/s", 10.0, 5000.0),
    "contact.k_e": Number("law paper only, instead of frequency", "N/m", 0.0, 1e7, open=True),
    "contact.k_d": Number("law paper only, instead of damping_ratio", "N s/m", 0.0, 1e6),
    "contact.k_f": Number("law paper only, instead of traction", "N s/m", 0.0, 1e6),
}
"""What may be stated about a container and its sphere; `container.inner_size` has the form that its shape needs."""


def container_facts(settings: Settings, defaults: Mapping[str, Any]) -> ContainerFacts:
    """Size and place of the container and the sphere, the user's words before those sections of the probe's file.

    Raises:
        ConfigurationError: A value of the wrong form or unit, or a sphere that does not fit.
    """

    def take(key: str) -> Any:
        section, name = key.split(".")
        return settings.take(key, defaults[section].get(name), FORMS[key])

    def within(name: str) -> Quantity:
        return Quantity(take(f"contact.{name}"), take(f"contact.{name}_std"))

    shape = take("container.shape")
    size = settings.take("container.inner_size", defaults["container"].get("inner_size"))
    enclosure = _enclosure(
        shape, _inner_size(shape, size), take("sphere.radius"), take("sphere.hollow")
    )
    mass = take("container.mass")
    mass_std = take("container.mass_std")
    if mass is None:
        mass = 0.03
        mass_std = np.inf
    facts = ContainerFacts(
        enclosure,
        centre=np.array(take("container.centre")),
        rotation=rotation_from_rpy(take("container.rpy")),
        mass=mass,
        mass_std=mass_std,
        settled=take("sphere.settled"),
        start=_start(take("sphere.start"), enclosure),
        start_std=take("sphere.start_std"),
        contact_frequency=take("contact.frequency"),
        damping_ratio=within("damping_ratio"),
        friction=within("friction"),
        traction=take("contact.traction"),
        law=take("contact.law"),
        k_e=take("contact.k_e"),
        k_d=take("contact.k_d"),
        k_f=take("contact.k_f"),
    )
    guessed = tuple(key for key in DECIDING if key not in settings.taken)
    return replace(facts, guessed=guessed)


def _inner_size(shape: str, size: Any) -> np.ndarray:
    """All three edges of the inside, as its shape may be stated with fewer [m], (3,)."""
    edges = size
    if shape == "cylinder" and isinstance(size, list) and len(size) == 2:
        edges = [size[0], size[0], size[1]]
    elif shape == "sphere" and isinstance(size, (int, float)):
        edges = [size, size, size]
    form = Numbers("", _INNER, 3, example=_PLACE)
    inner_size = np.array(read("container.inner_size", edges, form))
    alike = {"cylinder": 2, "sphere": 3}.get(shape, 1)
    if np.ptp(inner_size[:alike]) > 0.0:
        right = "[diameter, length]" if shape == "cylinder" else "one diameter"
        raise ConfigurationError(
            f"container.inner_size={list(edges)} does not fit a {shape}: give {right} in m"
        )
    return inner_size


def _enclosure(shape: str, inner_size: np.ndarray, radius: float, hollow: bool) -> Enclosure:
    try:
        return Enclosure(shape, inner_size, radius, 2.0 / 3.0 if hollow else 0.4)
    except SimulationError as error:
        raise ConfigurationError(
            f"{error}: check container.inner_size and sphere.radius"
        ) from error


def _start(stated: Any, enclosure: Enclosure) -> np.ndarray | None:
    """Where the sphere's centre is said to have been [m], (3,)."""
    if stated is None:
        return None
    place = np.array(stated)
    if np.any(np.abs(place) > enclosure.room + 1e-3):
        raise ConfigurationError(
            f"sphere.start={place.tolist()} is outside the container: the sphere's centre can only go "
            f"{(1e3 * enclosure.room).tolist()} mm from the middle"
        )
    return place


def track_of(
    run: Run,
    source: Path,
    camera: str | None,
    std: float,
) -> SphereTrack | None:
    """Places of the sphere during a run of a bag; None without a camera.

    Args:
        run: Of that bag.
        source: The bag.
        camera: A topic, which starts with a slash (unless there is such a file), or a CSV file.
        std: Of each coordinate [m].

    Raises:
        ConfigurationError: It saw nothing during the run, or too much.
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

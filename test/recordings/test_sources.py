"""Whatever was recorded is a source: opened once, read piece by piece, and closed."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.small_bags import CONSTANTS, JOINTS, commands, states, write_bag

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.sources import (
    Attempt,
    BagSource,
    EpisodeSource,
    TextSource,
    open_recording,
    open_source,
)

OPTIONS = ReadOptions(Effort(None, CONSTANTS), JOINTS)


def test_a_path_says_what_it_is(tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.mkdir()
    for name in ("setting.json", "trajectory.csv"):
        (text / name).touch()
    assert isinstance(open_source(text), TextSource)
    assert isinstance(open_source(Path(f"{tmp_path}/set#3")), EpisodeSource)
    assert isinstance(open_source(tmp_path / "bag"), BagSource)
    assert isinstance(open_recording(text), BagSource)  # of a text there is no recording


def test_a_bag_is_read_piece_by_piece_and_no_piece_says_anything_of_another(tmp_path: Path) -> None:
    """A part that is cut out leaves the others whole, and each piece has its own notes."""
    bag = write_bag(
        tmp_path / "folder" / "bag",
        [*states(), *commands()],
    )
    with BagSource(bag) as source:
        whole = source.recording(OPTIONS)
        half_ns = int(whole.joints.times_ns[-1] - whole.joints.times_ns[0]) // 2
        part = source.recording(
            ReadOptions(Effort(None, CONSTANTS), JOINTS, span=(0, half_ns)),
        )
        again = source.recording(OPTIONS)
        contents = source.contents(OPTIONS)
        assert source.motors(None) == {} and source.temperatures(None) == {}
    assert len(part.joints.times_ns) < len(whole.joints.times_ns) == len(again.joints.times_ns)
    assert whole.notes == again.notes
    assert source.name == "folder/bag"
    assert contents.states == "/joint_states" and contents.inputs == "/current_command"


def test_what_goes_wrong_while_a_bag_is_open_is_not_said_of_the_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", states())
    with pytest.raises(ZeroDivisionError), BagSource(bag):
        1 / 0  # noqa: B018
    with (
        BagSource(bag) as source,
        pytest.raises(
            RecordingError,
            match="no /robot_description",
        ),
    ):
        source.description()


def test_a_reading_that_fails_matters_only_to_whoever_needs_it() -> None:
    def fail() -> int:
        raise RecordingError("damaged", "bag")

    attempt = Attempt.to(fail)
    with pytest.raises(RecordingError, match="bag: damaged") as caught:
        attempt.get()
    assert caught.value.about("bag") == "damaged" and caught.value.about("other") == "bag: damaged"
    assert Attempt.to(lambda: 3).get() == 3

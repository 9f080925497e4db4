"""The few types of messages that are kept here are ROS's own."""

from __future__ import annotations

from rosbags.typesys import Stores, get_typestore


def test_message_definitions_are_jazzys() -> None:
    """The few definitions kept here hash to the same type as the distribution's own."""
    from proprio_ros.recordings import messages

    jazzy = get_typestore(Stores.ROS2_JAZZY)
    for name in messages._DEFINITIONS:
        assert messages.message_types().hash_rihs01(name) == jazzy.hash_rihs01(name), name

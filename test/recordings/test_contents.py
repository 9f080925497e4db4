"""Parts of a bag cover it."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.small_bags import STORAGES, commands, read, refused, states, write_bag

from proprio_ros.recordings.contents import parts_of


@pytest.mark.parametrize("storage", [*STORAGES, "two files"])
def test_parts_cover_a_recording(tmp_path: Path, storage: str) -> None:
    """Each once, none larger than asked, whatever the files; two of one bag overlap."""
    messages = states() + commands()
    path = write_bag(tmp_path / "bag", messages, "mcap" if storage == "two files" else storage)
    if storage == "two files":
        shutil.rmtree(path)
        path.mkdir()
        for part, half in enumerate((messages[1::2], messages[::2])):
            shutil.copy(write_bag(tmp_path / f"part{part}", half) / f"part{part}.mcap", path)
    whole = read(path)
    most = len(whole.joints.times_ns) // 3
    spans = parts_of(path, most)
    assert len(spans) > 2
    assert all(end == begin for (_, end), (begin, _) in pairwise(spans))
    parts = [read(path, span=span, states_only=True).joints for span in spans]
    assert max(len(part.times_ns) for part in parts) <= most
    assert np.array_equal(np.concatenate([part.times_ns for part in parts]), whole.joints.times_ns)
    assert np.array_equal(np.concatenate([part.position for part in parts]), whole.joints.position)
    with refused("no joint states between 1e\\+06 s and 2e\\+06 s"):
        read(path, span=(10**15, 2 * 10**15))

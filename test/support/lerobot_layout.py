"""LeRobot data sets as the layout has them, versions 2.1 and 3, written without lerobot.

Layout of huggingface/lerobot, ``src/lerobot/datasets`` (``utils.py``, ``feature_utils.py``, ``dataset_writer.py``): one row group
per episode, float32 vectors, ``timestamp`` from 0 in each episode. What the package itself wrote is in ``lerobot_0_4_4``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.motions import Motion

PER_CHUNK = 1000


class _FilePerEpisode:
    """Version 2.1."""

    NAMED = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.rows: list[dict[str, Any]] = []

    def write(self, table: Any, first: int) -> None:
        import pyarrow.parquet as pq

        del first
        index = len(self.rows)
        place = self.NAMED.format(episode_chunk=index // PER_CHUNK, episode_index=index)
        path = self._folder / place
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path)
        self.rows.append({"episode_index": index, "tasks": ["weigh"], "length": len(table)})

    def close(self) -> None:
        """Nothing is open."""


class _SharedFiles:
    """Version 3: several episodes in a file, a row group each."""

    NAMED = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

    def __init__(self, folder: Path, per_file: int) -> None:
        self._folder = folder
        self._per_file = per_file
        self._number = -1
        self._writer: Any = None
        self.rows: list[dict[str, Any]] = []

    def write(self, table: Any, first: int) -> None:
        """The next episode, whose first frame is so many after the data set's."""
        index = len(self.rows)
        number = index // self._per_file
        chunk = number // PER_CHUNK
        file = number % PER_CHUNK
        if number != self._number:
            self._open(self.NAMED.format(chunk_index=chunk, file_index=file), table.schema)
            self._number = number
        self._writer.write_table(table)
        self.rows.append(
            {
                "episode_index": index,
                "tasks": ["weigh"],
                "length": len(table),
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": first,
                "dataset_to_index": first + len(table),
            }
        )

    def _open(self, place: str, schema: Any) -> None:
        import pyarrow.parquet as pq

        self.close()
        path = self._folder / place
        path.parent.mkdir(parents=True, exist_ok=True)
        self._writer = pq.ParquetWriter(path, schema)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


def _frames(
    motion: Motion,
    constants: Sequence[float],
    index: int,
    first: int,
    numbers: Mapping[str, float],
) -> Any:
    """Table of an episode's frames.

    Args:
        motion: The episode.
        constants: Torque constants [N m/A].
        index: Of the episode.
        first: Of its frames, in the data set.
        numbers: The same in all its frames, by column.
    """
    import pyarrow as pa

    frames = len(motion.times_s)
    vectors = {
        "observation.state": motion.position,
        "observation.effort": motion.current_A * np.asarray(constants),
        "action": motion.position,
    }
    columns: dict[str, Any] = {}
    for name, values in vectors.items():
        flat = pa.array(values.astype(np.float32).ravel())
        columns[name] = pa.FixedSizeListArray.from_arrays(flat, len(motion.joints))
    for name, number in numbers.items():
        columns[name] = pa.array(np.full(frames, number), pa.float32())
    columns["timestamp"] = pa.array(motion.times_s, pa.float32())
    columns["frame_index"] = pa.array(np.arange(frames))
    columns["episode_index"] = pa.array(np.full(frames, index))
    columns["index"] = pa.array(np.arange(first, first + frames))
    columns["task_index"] = pa.array(np.zeros(frames, np.int64))
    return pa.table(columns)


def _features(joints: Sequence[str], extra: Sequence[str]) -> dict[str, Any]:
    vector = {"dtype": "float32", "shape": [len(joints)], "names": list(joints)}
    features = dict.fromkeys(("observation.state", "observation.effort", "action"), vector)
    for name in (*extra, "timestamp"):
        features[name] = {"dtype": "float32", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    return features


def write_data_set(
    folder: Path,
    motions: Iterable[Motion],
    constants: Sequence[float],
    *,
    version: str = "v3.0",
    rate_hz: float = 100.0,
    per_file: int = 1000,
    extra: dict[str, Sequence[float]] | None = None,
) -> Path:
    """A data set with positions in rad and effort in N m.

    Args:
        folder: To be made.
        motions: One per episode.
        constants: Torque constants that make efforts of currents [N m/A].
        version: ``v3.0`` or ``v2.1``.
        rate_hz: As it states it; the timestamps are the motions' own.
        per_file: Episodes per file of version 3.
        extra: Columns with one number per episode, the same in all its frames.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "meta").mkdir(parents=True)
    columns = extra or {}
    files: _FilePerEpisode | _SharedFiles = (
        _FilePerEpisode(folder) if version == "v2.1" else _SharedFiles(folder, per_file)
    )
    total = 0
    names: Sequence[str] = ()
    for index, motion in enumerate(motions):
        names = motion.joints
        numbers = {name: values[index] for name, values in columns.items()}
        files.write(_frames(motion, constants, index, total, numbers), total)
        total = total + len(motion.times_s)
    files.close()
    info = {
        "codebase_version": version,
        "robot_type": "twin",
        "total_episodes": len(files.rows),
        "total_frames": total,
        "total_tasks": 1,
        "chunks_size": PER_CHUNK,
        "fps": rate_hz,
        "splits": {"train": f"0:{len(files.rows)}"},
        "data_path": files.NAMED,
        "video_path": None,
        "features": _features(names, tuple(columns)),
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info, indent=4))
    if version == "v2.1":
        lines = [json.dumps(row) + "\n" for row in files.rows]
        (folder / "meta" / "episodes.jsonl").write_text("".join(lines))
    else:
        path = folder / "meta/episodes/chunk-000/file-000.parquet"
        path.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(files.rows), path)
    return folder

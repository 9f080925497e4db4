"""LeRobot data sets as the layout has them, versions 2.1 and 3, written without lerobot.

Layout of huggingface/lerobot, ``src/lerobot/datasets`` (``utils.py``, ``feature_utils.py``, ``dataset_writer.py``): one row group
per episode, float32 vectors, ``timestamp`` from 0 in each episode. What the package itself wrote is in ``lerobot_0_4_4``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.motions import Motion

PER_CHUNK = 1000


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
    total = 0
    count = 0
    rows = []
    writer = None
    at = None
    names: Sequence[str] = ()
    for index, motion in enumerate(motions):
        names = motion.joints
        frames = len(motion.times_s)
        vectors = {
            "observation.state": motion.position,
            "observation.effort": motion.current_A * np.asarray(constants),
            "action": motion.position,
        }
        columns: dict[str, Any] = {
            name: pa.FixedSizeListArray.from_arrays(
                pa.array(values.astype(np.float32).ravel()), len(names)
            )
            for name, values in vectors.items()
        }
        for name, values in (extra or {}).items():
            columns[name] = pa.array(
                np.full(frames, values[index]),
                pa.float32(),
            )
        columns["timestamp"] = pa.array(
            motion.times_s,
            pa.float32(),
        )
        columns["frame_index"] = pa.array(np.arange(frames))
        columns["episode_index"] = pa.array(np.full(frames, index))
        columns["index"] = pa.array(np.arange(total, total + frames))
        columns["task_index"] = pa.array(np.zeros(frames, np.int64))
        table = pa.table(columns)
        if version == "v2.1":
            path = folder / f"data/chunk-{index // PER_CHUNK:03d}/episode_{index:06d}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(table, path)
            rows.append(
                {
                    "episode_index": index,
                    "tasks": ["weigh"],
                    "length": frames,
                }
            )
        else:
            number = index // per_file
            if at != number:
                if writer is not None:
                    writer.close()
                path = (
                    folder
                    / f"data/chunk-{number // PER_CHUNK:03d}/file-{number % PER_CHUNK:03d}.parquet"
                )
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(path, table.schema)
                at = number
            writer.write_table(table)
            rows.append(
                {
                    "episode_index": index,
                    "tasks": ["weigh"],
                    "length": frames,
                    "data/chunk_index": number // PER_CHUNK,
                    "data/file_index": number % PER_CHUNK,
                    "dataset_from_index": total,
                    "dataset_to_index": total + frames,
                }
            )
        total = total + frames
        count = count + 1
    if writer is not None:
        writer.close()
    vector = {
        "dtype": "float32",
        "shape": [len(names)],
        "names": list(names),
    }
    features = dict.fromkeys(("observation.state", "observation.effort", "action"), vector)
    for name in (*(extra or {}), "timestamp"):
        features[name] = {"dtype": "float32", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    info = {
        "codebase_version": version,
        "robot_type": "twin",
        "total_episodes": count,
        "total_frames": total,
        "total_tasks": 1,
        "chunks_size": PER_CHUNK,
        "fps": rate_hz,
        "splits": {"train": f"0:{count}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        if version == "v2.1"
        else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info, indent=4))
    if version == "v2.1":
        (folder / "meta" / "episodes.jsonl").write_text(
            "".join(json.dumps(row) + "\n" for row in rows)
        )
    else:
        path = folder / "meta/episodes/chunk-000/file-000.parquet"
        path.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(rows), path)
    return folder

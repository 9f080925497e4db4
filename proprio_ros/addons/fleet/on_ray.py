"""The engine for many machines: Ray Data reads the list of episodes, places the work by cores, tries again, and writes the rows.

Every machine of the cluster needs this package and must see the recordings and the output folder under the same paths.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from proprio_ros.addons.fleet.episodes import Episode
from proprio_ros.addons.fleet.local import CHUNK, chunk_size
from proprio_ros.addons.fleet.rows import Job, lasting, rows_of_all
from proprio_ros.addons.fleet.store import PARTITION, Store, schema, table_of
from proprio_ros.errors import ConfigurationError
from proprio_ros.version import to_install


def ray_or_refuse() -> Any:
    """The module ray; ConfigurationError: it is not installed."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise ConfigurationError(
            f"--engine ray: {error.name} is missing: {to_install('batch,ray')}, or leave --engine out"
        ) from error
    return ray


def run_ray(
    episodes: Sequence[Episode],
    job: Job,
    store: Store,
    address: str | None,
    tell: Callable[[str], Any],
    most: int = CHUNK,
    quiet: bool = True,
) -> None:
    """Answer episodes on a Ray cluster, at most so many per file.

    Its ``address`` is as for ``ray.init``; None: the one that runs here, else a new one on this machine. ``quiet`` leaves Ray's own
    progress bars out.

    Args:
        episodes: What is to be answered.
        job: What is asked of each.
        store: Takes the rows.
        address: As for ``ray.init``; None: the cluster that runs here, else a new one on this machine.
        tell: Hears how far it is.
        most: Episodes per file at most.
        quiet: Whether Ray's own progress bars are left out.

    Raises `ConfigurationError`: Ray is missing, or its cluster cannot be reached.
    """
    ray = ray_or_refuse()
    if not ray.is_initialized():
        try:
            ray.init(address=address, log_to_driver=False, logging_level="warning")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ConfigurationError(
                f"--address {address}: no Ray cluster answers ({error}); start one with `ray start --head`"
            ) from error
    cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
    size = chunk_size(len(episodes), cores, most)
    tell(f"Ray: {cores} cores, {-(-len(episodes) // size)} tasks of {size} episodes")
    ray.data.DataContext.get_current().enable_progress_bars = not quiet
    listed = [asdict(episode) for episode in episodes]

    def answered(batch: Any) -> Any:
        episodes = [Episode(**each) for each in batch.to_pylist()]
        return table_of(lasting(rows_of_all(episodes, job)))

    # the same needs for both, so that one task answers and writes; Ray tries a task again whose worker or machine dies
    blocks = ray.data.from_items(
        listed,
        override_num_blocks=-(-len(listed) // size),
    )
    rows = blocks.map_batches(answered, batch_format="pyarrow", batch_size=None)
    rows.write_parquet(
        str(store.rows),
        partition_cols=[PARTITION],
        schema=schema(),
    )

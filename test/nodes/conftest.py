"""Tests of processes in real time share two cores with whatever else runs there: one that fails is tried again, twice at most.

How often that is needed is shown at the end of a run ("rerun").
"""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.pluginmanager.hasplugin("rerunfailures"):
        for item in items:
            if Path(__file__).parent in item.path.parents:
                item.add_marker(pytest.mark.flaky(reruns=2))

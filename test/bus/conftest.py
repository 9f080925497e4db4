"""Servos do not wait: what is tested here runs as in its node. Where that is not permitted, work beside it disturbs the tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from proprio_ros.clock import run_in_real_time, run_like_others


@pytest.fixture(autouse=True)
def real_time() -> Iterator[None]:
    granted = run_in_real_time()
    yield
    if granted:
        run_like_others()

"""What tests of the pendant in a browser share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.browser import BROWSER
from support.tab import Browser, browser


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if BROWSER is None:
        pytest.skip("needs Chromium")
    with browser(tmp_path_factory.mktemp("window")) as window:
        yield window

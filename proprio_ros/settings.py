"""The user's KEY=VALUE settings, of the command line's ``--set`` and of the identifier's parameter ``settings``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from proprio_ros.errors import ConfigurationError


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Settings by dotted key; values are JSON, or bare words.

    Raises:
        ConfigurationError: a pair is not of that form.
    """
    settings: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key:
            raise ConfigurationError(f"--set {pair}: write KEY=VALUE, e.g. --set payload.size=0.03")
        try:
            settings[key] = json.loads(text)
        except ValueError:
            if text[:1] in '[{"' or not text:
                raise ConfigurationError(f"--set {pair}: {text!r} is not JSON, e.g. [0,0,0.01] or 0.03") from None
            settings[key] = text  # a bare word such as cube
    return settings

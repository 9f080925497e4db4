"""What every JSON object of this package says about itself; the schema is ``config/schema/output.json``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from proprio_ros.version import __version__


def header(kind: str) -> dict[str, str]:
    """The first keys of an object, such as an ``estimate`` or an ``error``; within a number of the schema, keys are only added."""
    return {"schema": f"proprio_ros/{kind}/1", "version": __version__}


def error(sentence: str, exit_code: int) -> dict[str, Any]:
    """What is printed instead of a result."""
    return {
        **header("error"),
        "error": " ".join(sentence.split()),
        "exit_code": exit_code,
    }


def calibration_used(path: Path) -> dict[str, str]:
    """Name of a calibration file, and the SHA-256 of its bytes, as ``sha256sum`` prints it."""
    return {
        "name": path.name,
        "fingerprint": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def reason_codes(reasons: Sequence[str]) -> list[str]:
    """The codes of reasons, in their order; ``other`` where a sentence has none."""
    return [getattr(reason, "code", "other") for reason in reasons]

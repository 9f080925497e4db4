"""An excitation sequence of one push, as text, for tests that ask a node for it."""

from __future__ import annotations

AWAY = ", start: {joint2: -0.2, joint3: 0.8, joint4: 0.0}"
"""A way to go first, from where the virtual arm is parked."""


def one_push(
    current_A: float,
    duration_s: float,
    start: str = "",
    joint: str = "joint3",
) -> str:
    """A push of ``joint``; ``start`` may be `AWAY`."""
    run = (
        f"joint: {joint}, current_A: {current_A}, duration_s: {duration_s}, max_travel: 1.5{start}"
    )
    return f"""
excitation:
  hand: any
  settle_s: 0.3
  brake_s: 0.2
  approach_velocity: 1.5
  runs:
    - {{{run}}}
"""

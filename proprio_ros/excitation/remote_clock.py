"""The clock of another computer, or of a simulation, as the stamps of its messages say it."""

from __future__ import annotations

DRIFT = 1e-4  # two clocks may run apart by so much
CLOCK_SET_S = 0.5  # a clock that is off by more has been set


class RemoteClock:
    """Another clock's time, from stamps that come late, each by something else: those that come earliest say it."""

    def __init__(self) -> None:
        self._ahead_ns: int | None = None
        self._heard_ns = 0

    def hear(self, stamp_ns: int, now_ns: int) -> None:
        """A stamp of the other clock has come at an instant of ours."""
        ahead_ns = stamp_ns - now_ns
        if self._ahead_ns is None or abs(ahead_ns - self._ahead_ns) > CLOCK_SET_S * 1e9:
            self._ahead_ns = ahead_ns
        else:
            self._ahead_ns = max(
                ahead_ns, self._ahead_ns - round(DRIFT * (now_ns - self._heard_ns))
            )
        self._heard_ns = now_ns

    def at(self, now_ns: int) -> int:
        """What the other clock says at an instant of ours [ns]."""
        return now_ns + (self._ahead_ns or 0)

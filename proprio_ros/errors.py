"""The errors that a user can meet, as one tree.

Every message is one line that says what is wrong, which choices are valid, and what to do::

    ProprioError
    +-- RobotError          a URDF or robot file: massless moving link, unknown joint, two roots
    +-- RecordingError      a bag or a record: no joint states, NaN, truncated file, unknown effort unit
    +-- ConfigurationError  an option, a --set or a probe file: unknown key, wrong unit, wrong shape
    +-- SimulationError     a rollout that cannot be trusted: it diverged, or the step count overflows
    +-- BusError            a serial port or a servo: no port, no answer, another model, a hardware error
    |   +-- PortLostError   the port itself is gone: unplugged, or taken away while open
    +-- ExcitationError     a probe that cannot start, or must not: busy, out of limits, no free way
"""

from __future__ import annotations


class ProprioError(Exception):
    """Base of everything this package raises on purpose; the command line prints it and exits with 2."""


class RobotError(ProprioError, ValueError):
    """The robot's description is missing something, or describes no physical robot."""


class RecordingError(ProprioError, ValueError):
    """The recording cannot be read, or does not hold what the probe needs."""


class ConfigurationError(ProprioError, ValueError):
    """An option or a configuration file is wrong."""


class SimulationError(ProprioError, RuntimeError):
    """The simulation left the range in which its numbers mean something."""


class BusError(ProprioError, RuntimeError):
    """A servo does not answer, answers wrongly, or reports a fault."""


class PortLostError(BusError):
    """The serial port cannot be opened, or is gone."""


class ExcitationError(ProprioError, RuntimeError):
    """A probe that cannot start from here, or must not."""

"""All that the nodes of an arm say to the pendant, as messages, without an arm.

The joints rest and move in turn, pushes are made, estimates come and are final, something is taken and let go.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
ESTIMATES = 2
STATUSES = 10
"""So many joint states come for each of them, as the pendant takes them twenty times a second."""
PUSH = 40
"""Joint states of a push, and of the rest before it."""
PUSHES = 16
"""And then as long a rest of all joints."""
CYCLE = 20 * PUSH


def status(name: str, message: str, **values: str) -> DiagnosticStatus:
    """A sentence with keys and values."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=b"\0", name=name, message=message, values=pairs)


class TalkingArm:
    """What is said on each topic; joint states count the time."""

    def __init__(self) -> None:
        self._number = 0
        self._says: dict[str, tuple[int, Callable[[], Any]]] = {
            "joint_states": (1, self._states),
            "estimate": (ESTIMATES, self._estimate),
            "diagnostics": (STATUSES, self._diagnostics),
            "driver/status": (STATUSES, lambda: status("driver", "5 servos, held")),
            "excitation/status": (STATUSES, self._excitation),
            "identifier/status": (STATUSES, lambda: status("identifier", f"{self._run}: weighs")),
            "capability": (STATUSES, self._capability),
            "holding": (STATUSES, lambda: Bool(data=self._holds)),
            "payload": (STATUSES, self._payload),
        }

    def newest(self, topic: str) -> Any:
        """A message; None: there is none that was not taken before."""
        name = next(name for name in self._says if topic.endswith(name))
        self._number += name == "joint_states"
        each, say = self._says[name]
        return say() if self._number % each == 0 else None

    @property
    def _pushes(self) -> bool:
        phase = self._number // PUSH
        return phase % 2 == 1 and phase // (2 * PUSHES) % 2 == 0

    @property
    def _holds(self) -> bool:
        return self._number % (2 * CYCLE) > CYCLE // 4

    @property
    def _run(self) -> str:
        return f"run {self._number // (2 * PUSH) % PUSHES + 1} of {PUSHES}"

    def _states(self) -> JointState:
        angle = 0.4 * math.sin(2.0 * math.pi * self._number / PUSH) * self._pushes
        positions = [0.0, -0.6, angle, 0.3, 0.01]
        efforts = [0.0, 0.4, 0.2 + 0.1 * angle, 0.05, 0.0]
        return JointState(name=list(JOINTS), position=positions, effort=efforts)

    def _estimate(self) -> DiagnosticArray:
        mass = 0.05 + 0.001 * math.sin(0.1 * self._number)
        final = self._number % CYCLE > CYCLE - 2 * PUSH
        values = {
            "payload_mass": repr(mass),
            "payload_mass.unit": "kg",
            "payload_mass.ci95": json.dumps([mass - 0.004, mass + 0.004]),
            "payload_com.ci95": "[[-0.002, 0.002], [-0.003, 0.003], [0.01, 0.03]]",
            "final": str(final).lower(),
            "running": str(not final).lower(),
        }
        message = DiagnosticArray(status=[status("payload", "payload_mass", **values)])
        message.header.stamp = Time(sec=int(time.time()))
        return message

    def _excitation(self) -> DiagnosticStatus:
        phase = "probe" if self._pushes else "settle"
        return status("excitation", self._run, phase=phase, busy="true")

    def _capability(self) -> DiagnosticStatus:
        return status("capability", "it can", most="[0.5]", can_carry="true")

    def _diagnostics(self) -> DiagnosticArray:
        warm = {"temperature [C]": "31.0"}
        servos = [status(f"driver: {name}", "held", **warm) for name in JOINTS]
        return DiagnosticArray(status=[status("driver: servo bus", "well"), *servos])

    def _payload(self) -> InertiaStamped:
        message = InertiaStamped()
        message.inertia.m = 0.05 if self._holds else 0.0
        message.inertia.com.z = 0.02
        return message

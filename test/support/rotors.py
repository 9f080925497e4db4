"""Plant for the tests: every servo turns a rotor of its own, with viscous friction and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

from proprio_ros.virtual.servo import CONTROL_PERIOD_S, VirtualServo

TORQUE_CONSTANT_NM_A = 1.783
INERTIA_KG_M2 = 0.02
FRICTION_NM_S = 0.02


class Rotors:
    """Rotors in steps of the servos' control period; the first step ends at `time_s` + one period."""

    def __init__(
        self,
        servos: Sequence[VirtualServo],
        time_s: float = 0.0,
    ) -> None:
        self.servos = servos
        self.start_s = time_s
        self.steps = 0
        self.angle_rad = [0.0] * len(servos)
        self.velocity_rad_s = [0.0] * len(servos)
        self.current_A = [0.0] * len(servos)
        self.blocked = False

    @property
    def time_s(self) -> float:
        return self.start_s + self.steps * CONTROL_PERIOD_S

    def advance(self, now_s: float) -> None:
        while self.start_s + (self.steps + 1) * CONTROL_PERIOD_S <= now_s + 1e-9:
            self.steps += 1
            for index, servo in enumerate(self.servos):
                torque_Nm = (
                    TORQUE_CONSTANT_NM_A * self.current_A[index]
                    - FRICTION_NM_S * self.velocity_rad_s[index]
                )
                if not self.blocked:
                    self.velocity_rad_s[index] += torque_Nm / INERTIA_KG_M2 * CONTROL_PERIOD_S
                    self.angle_rad[index] += self.velocity_rad_s[index] * CONTROL_PERIOD_S
                self.current_A[index] = servo.control(
                    self.time_s, self.angle_rad[index], self.velocity_rad_s[index]
                )

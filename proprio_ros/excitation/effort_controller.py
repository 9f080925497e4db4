"""Pushes and holds an arm by an effort controller of somebody else's driver. No clock, no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.controllers import Controller, Move
from proprio_ros.excitation.hold import LONGEST_WAIT_S, SLOWEST_HZ, Hold, HoldGains
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot

if TYPE_CHECKING:
    from typing_extensions import Self

BRISK_RAD_S = 15.0  # a hold as stiff as this follows as fast as a sequence says
NUDGING_PACE = 0.1  # while the arm is asked for its delay
UNITS = ("N.m", "A")
"""What the drive takes an effort for: torque (N of a slide), or the motor's current."""


class EffortController(Controller):
    """Efforts: a pushed joint has the effort of its current, and everything else is held by `Hold`.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order.
        unit: Of its efforts, one of `UNITS`. A torque is current x nominal torque constant of the robot file.
        gains: How joints are held.

    Attributes:
        pushed_A: Currents of the joints that are pushed now.
    """

    kind = "effort"
    about = "an effort controller of ros2_control, which this node then has hold the arm"
    commanded = "efforts in `effort_unit`"
    usual_topic = "/forward_effort_controller/commands"
    announced = "efforts go to {topic}; this node alone holds the arm then"
    beside = "keep a hand near the emergency stop"
    falls_unheard = True
    without = ", and nobody could hold it"
    recorded_as = "effort"
    recorded_on = "applied_effort"
    can_let_go = True
    let_go = "the efforts are zero: nobody holds the arm until a controller does"

    def __init__(
        self, robot: Robot, joints: Sequence[str], unit: str, gains: HoldGains | None = None
    ) -> None:
        super().__init__(
            robot,
            joints,
            (gains or HoldGains()).jump_rad,
        )
        if unit not in UNITS:
            raise ConfigurationError(f"effort_unit={unit!r}: choose one of {', '.join(UNITS)}")
        self.pushed_A: dict[str, float] = {}
        self._hold = Hold(robot, self.joints, gains)
        self._effort_per_A = {
            name: drive.nominal_effort_per_current for name, drive in robot.drive_trains.items()
        }
        self._per_unit = dict.fromkeys(self.joints, 1.0)
        if unit == "A":
            self._per_unit = {name: self._effort_per_A[name] for name in self.joints}

    @classmethod
    def of_parameters(cls, robot: Robot, values: Mapping[str, Any]) -> Self:
        gains = HoldGains(
            values["hold_frequency"],
            jump_rad=values["max_jump"],
            max_velocity_rad_s=values["max_velocity"],
        )
        return cls(robot, values["controller_joints"], values["effort_unit"], gains)

    @property
    def lost(self) -> str:
        return self._hold.lost

    @property
    def pace(self) -> float:
        if self._hold.nudging:
            return NUDGING_PACE
        return min(1.0, self._hold.frequency_rad_s / BRISK_RAD_S) or 1.0

    @property
    def late_s(self) -> float:
        period_s = 1.0 / self._hold.rate_hz if self._hold.rate_hz else 0.0
        return max((self._hold.delay.delay_s or 0.0) - period_s, 0.0)

    @property
    def held_kg(self) -> float:
        return self._hold.held_kg if self.holding else 0.0

    @property
    def record(self) -> dict[str, float]:
        """As this package's driver would: the efforts of currents that push, zero for what is held [N m or N]."""
        scales = self._effort_per_A.items()
        return {name: self.pushed_A.get(name, 0.0) * scale for name, scale in scales}

    def check(self, sequence: ExcitationSequence) -> None:
        super().check(sequence)
        if any(run.goal_step for run in sequence.runs):
            words = "pushes by steps of goals, which an effort controller does not take"
            raise ExcitationError(f"{sequence.name} {words}: choose a sequence with currents")
        if not self._hold.knows or self._hold.rate_hz < SLOWEST_HZ:
            often = f"{self._hold.rate_hz:.0f} times a second"
            remedy = (
                "raise the update rate of controller_manager and of its joint_state_broadcaster"
            )
            raise ExcitationError(
                f"joint states come {often}: efforts hold an arm with {SLOWEST_HZ:g} or more; {remedy}"
            )
        if self._hold.wait_s > LONGEST_WAIT_S:
            apart = f"{1e3 * self._hold.wait_s:.0f} ms apart as an instant sees it"
            most = f"efforts hold an arm with {1e3 * LONGEST_WAIT_S:.0f} ms at most"
            remedy = "keep this computer free, or run this node beside controller_manager"
            raise ExcitationError(f"joint states come in bursts ({apart}; {most}): {remedy}")

    def begin(self) -> None:
        if not self.holding or self.lost:
            self._hold.begin()
        self.pushed_A = {}
        self.holding = True

    def take(self, command: Command) -> None:
        if self.holding:
            self.pushed_A = {
                name: current for name, current in command.current_A.items() if name in self.joints
            }
            self._hold.aim(command.position)

    def take_here(self) -> None:
        self.pushed_A = {}
        self._hold.here()

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> Mapping[str, Move]:
        """Take a reading, of which the hold hears, too.

        Args:
            time_s: When the reading was taken, on a clock of its own [s].
            position: By joint; what is no number is passed over [rad or m].
            heard_s: When it came; None: when it was taken [s].

        Returns:
            How far joints that were read have moved since their last reading.
        """
        self._hold.observe(time_s, position, heard_s)
        return super().observe(time_s, position, heard_s)

    def commands(self) -> list[float]:
        """An effort for each joint, in the controller's order and unit; zeros once the joints are lost."""
        pushed = {
            name: current * self._effort_per_A[name] for name, current in self.pushed_A.items()
        }
        efforts = self._hold.efforts(pushed)
        if self.lost:
            self.pushed_A = {}
        return self._listed(efforts)

    def holding_command(self) -> list[float]:
        return self._listed(self._hold.steady())

    def steady(self) -> list[float]:
        self.pushed_A = {}
        efforts = self._hold.steady()
        if not self.lost:
            self._hold.sent(efforts)
        return self._listed(efforts)

    def release(self) -> list[float]:
        """Let go: zeros."""
        self.holding = False
        self.pushed_A = {}
        return [0.0] * len(self.joints)

    def _listed(self, efforts: Mapping[str, float]) -> list[float]:
        return [efforts[name] / self._per_unit[name] for name in self.joints]

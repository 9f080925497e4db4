"""A whole robot without hardware: emulated servos on a port, and the simulated arm that their currents move, in real time."""

from __future__ import annotations

from pathlib import Path

from proprio_ros.bus.control_table import BAUD_RATES, servo_model
from proprio_ros.errors import ConfigurationError
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.bus import Faults, VirtualBus
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.port import PtyPort
from proprio_ros.virtual.servo import CONTROL_PERIOD_S, VirtualServo
from proprio_ros.virtual.truth import Truth

LONGEST_PAUSE_S = 0.5  # when this process was not run for longer, the world stood still meanwhile
LATE_S = 0.03  # the port moves the world on every 2 ms; more means that this process was not run
PARKED = {"joint2": -1.0, "joint3": 0.6, "joint4": 0.4}
"""Where an OpenManipulator-X is parked: away from all limits, high above the table [rad]."""
OVERHEATED_C = 90.0


def parked(robot: Robot) -> dict[str, float]:
    """Positions of those of its joints that are parked [rad]."""
    known = robot.model.independent_joints
    return {name: value for name, value in PARKED.items() if name in known}


class VirtualRobot:
    """Servos and arm, by ids and models of the robot file's motors; `port`, to which ``link`` points, is what a driver opens.

    Until torque is switched on for the first time somebody holds the arm, as a person would.

    Raises:
        ConfigurationError: MuJoCo is missing, or the robot cannot be simulated.
        RobotError: A motor's model is not known.
    """

    control_period_s = CONTROL_PERIOD_S  # of each servo

    def __init__(
        self,
        robot: Robot,
        truth: Truth,
        *,
        link: Path | None = None,
        seed: int = 0,
    ) -> None:
        self.arm = VirtualArm(
            robot, truth, position=parked(robot), seed=seed, control_period_s=self.control_period_s
        )
        self.faults = Faults(seed=seed)
        self.servos: dict[str, VirtualServo] = {}
        for name in self.arm.joints:
            motor = robot.motors[name]
            drive = robot.drive_trains[name]
            if motor.id is None:
                raise ConfigurationError(
                    f"{robot.name}: joints.{name}.motor has no id; a virtual servo needs one, too"
                )
            servo = VirtualServo(
                servo_model(motor.model),
                motor.id,
                supply_voltage_V=drive.supply_voltage_V or 12.0,
                back_emf_V_s_per_rad=drive.back_emf_V_s_per_rad,
                resistance_ohm=drive.resistance_ohm or 5.0,
                latency_s=truth.latency_s,
                control_period_s=self.control_period_s,
            )
            servo["baud_rate"] = list(BAUD_RATES.values()).index(1_000_000)
            self.servos[name] = servo
        self._all = tuple(self.servos.values())
        self._shift = [0.0] * len(self._all)
        self._heated: set[str] = set()
        self._current = [0.0] * len(self._all)
        self._time_s: float | None = None
        self._supported = True
        self.bus = VirtualBus(
            self._all,
            self.advance,
            faults=self.faults,
        )
        self.port = PtyPort(self.bus, link)

    def advance(self, now_s: float) -> None:
        """Move servos and arm on to an instant of the monotonic clock; called by the bus."""
        if self._time_s is None or now_s - self._time_s > LONGEST_PAUSE_S:
            self._time_s = now_s - self.control_period_s
        if now_s - self._time_s > LATE_S:
            # this process was not run; what waits on the wire came meanwhile, so no watchdog may count that as silence
            for servo in self._all:
                servo.heard(now_s)
        arm = self.arm
        servos = self._all
        period_s = self.control_period_s
        while self._time_s + period_s <= now_s:
            time_s = self._time_s = self._time_s + period_s
            seen = zip(servos, self._shift, *arm.sensed(), strict=True)
            current = self._current = [
                servo.control(time_s, angle + shift, velocity)
                for servo, shift, angle, velocity in seen
            ]
            if self._supported:
                self._supported = not any(servo["torque_enable"] for servo in servos)
            else:
                arm.step(current)

    def truth(self) -> tuple[dict[str, float], dict[str, float]]:
        """True joint positions [rad or m] and the currents that flow in the motors [A], by joint."""
        with self.port.lock:
            return self.arm.position(), dict(zip(self.servos, self._current, strict=True))

    def hold(self, thing: HandObject | None) -> None:
        """Put something into the hand, or take it out."""
        with self.port.lock:
            if thing != self.arm.object:
                self.arm.hold(thing)

    def park(self) -> None:
        """Bring the arm to its first pose, and hold it there until torque comes on, as a person does; torque must be off."""
        with self.port.lock:
            self.arm.set_position({**zero_pose(self.arm.robot), **parked(self.arm.robot)})
            self._supported = True

    def set_fault(self, text: str) -> None:
        """Make something go wrong, or right again.

        Args:
            text: Comma-separated: ``drop=P``, ``corrupt=P``, ``corrupt_requests=P`` (probabilities), ``delay=S``, ``hang=JOINT``,
                ``overheat=JOINT``, ``jump=JOINT`` (its encoder slips by 0.6 rad), ``unplug``; empty: nothing is wrong any more.

        Raises `ConfigurationError`: A word is not known; it lists those that are.
        """
        faults = dict.fromkeys(("drop", "corrupt", "corrupt_requests", "delay"), 0.0)
        joints: dict[str, list[str]] = {
            "hang": [],
            "overheat": [],
            "jump": [],
        }
        words = [part.strip() for part in text.split(",") if part.strip()]
        for word in words:
            key, _, value = word.partition("=")
            if key in joints and value in self.servos:
                joints[key].append(value)
            elif key in faults and _is_number(value):
                faults[key] = float(value)
            elif word != "unplug":
                raise ConfigurationError(
                    f"fault {word!r}: choose from {', '.join(f'{k}=NUMBER' for k in faults)}, "
                    f"{', '.join(f'{k}=JOINT' for k in joints)}, unplug; joints: {', '.join(self.servos)}"
                )
        with self.port.lock:
            self.faults.drop = faults["drop"]
            self.faults.corrupt = faults["corrupt"]
            self.faults.corrupt_requests = faults["corrupt_requests"]
            self.faults.delay_s = faults["delay"]
            self.faults.hang = {self.servos[name].id for name in joints["hang"]}
            for row, (name, servo) in enumerate(self.servos.items()):
                if name in joints["overheat"]:
                    servo.temperature_C = OVERHEATED_C
                elif name in self._heated:  # however far it has cooled down since
                    servo.temperature_C = min(servo.temperature_C, 40.0)
                self._shift[row] = 0.6 if name in joints["jump"] else 0.0
            self._heated = set(joints["overheat"])
        (self.port.unplug if "unplug" in words else self.port.plug)()

    def close(self) -> None:
        """Stop the world and close the port."""
        self.port.close()


def _is_number(text: str) -> bool:
    try:
        return float(text) >= 0.0
    except ValueError:
        return False

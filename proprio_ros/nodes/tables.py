"""The parameters of every node as data, without ROS: name, default, unit, range, and what each is for.

`parameters` declares them to rclpy; the programs' ``--help``, the launch file and `proprio live` read them here.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from proprio_ros.bus.driver import DriverSettings
from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.controller_kinds import CONTROLLER_KINDS
from proprio_ros.excitation.effort_controller import UNITS
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.hold import HoldGains
from proprio_ros.probes import all_probes, virtual_objects
from proprio_ros.probes.base import Guards as GuardsObject
from proprio_ros.probes.base import HasBaseline, Probe
from proprio_ros.quantity import EFFORTS, unit_called
from proprio_ros.recordings.effort import EFFORT_UNITS

INPUT_TOPICS = {name: controller.usual_topic for name, controller in CONTROLLER_KINDS.items()}
"""Where controllers of others usually listen."""
CONTROLLERS = {f"{kind}_controller": topic for kind, topic in INPUT_TOPICS.items()}
"""What may drive the virtual arm instead of the servo bus, and where it listens."""
COMMANDED = ("driver", *INPUT_TOPICS)
"""What takes the commands: this package's driver, or a controller of somebody else's."""
_USUAL_TOPICS = " or ".join(INPUT_TOPICS.values())
_KINDS = "; ".join(f"{name}: {controller.about}" for name, controller in CONTROLLER_KINDS.items())
DEFAULT_LINK = str(Path(tempfile.gettempdir()) / "proprio_virtual")
DEFAULT_PROBE = "payload"
ENDS = ("hold", "zero")
_D = DriverSettings()
_G = Guards()
_H = HoldGains()


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node."""

    name: str
    default: Any  # its value where nobody states one; gives the type, too. A list is one of strings
    description: str  # for `ros2 param describe`, with the unit
    # lowest, highest: range of a number, ends included
    lowest: float | None = None
    highest: float | None = None
    dynamic: bool = False  # whether it may be changed while the node runs
    loose: bool = False  # a text that may look like a number: ``-p object:=0.05`` comes as one
    choices: tuple[str, ...] = ()  # all values that there are, beside the default; empty: any

    def as_known(self, value: Any) -> Any:
        """The value; of a unit of effort the name by which it is known, however it was written."""
        units = bool(self.choices) and set(self.choices) <= set(EFFORTS)
        return unit_called(value, EFFORTS) if units and isinstance(value, str) else value

    def check(self, value: Any) -> None:
        """Raises: ConfigurationError: The value is none of the choices."""
        if self.choices and value not in (self.default, *self.choices):
            raise ConfigurationError(
                f"parameter {self.name}={value!r}: choose one of {', '.join(self.choices)}"
            )


def fields_stated(
    kind: type,
    values: Mapping[str, Any],
) -> dict[str, Any]:
    """Fields of a data class that are parameters, whose names have no unit: ``max_jump`` is ``max_jump_rad``."""
    return {
        field.name: value
        for field in fields(kind)
        for name, value in values.items()
        if re.fullmatch(f"{name}(_m|_s|_C|_rad|_rad_s)?", field.name)
    }


_ABOUT_AUTOSTART = "Configure and activate at once; false leaves that to a lifecycle manager or `ros2 lifecycle set`."
AUTOSTART = Parameter("autostart", True, _ABOUT_AUTOSTART)
"""Of every node."""
_ABOUT_REAL_TIME = "Whether the cycle that keeps the arm up takes a real-time class; false: a higher priority, as other nodes."
REAL_TIME = Parameter("real_time", True, _ABOUT_REAL_TIME)
ROBOT = Parameter(
    "robot", "open_manipulator_x", "Robot of config/robots, or the path of a robot file."
)

DRIVER = (
    ROBOT,
    REAL_TIME,
    Parameter("port", "/dev/ttyUSB0", "Serial port of the servo bus."),
    Parameter("baud_rate", 1_000_000, "Bits per second; the servos must be set to the same."),
    Parameter(
        "rate",
        100.0,
        "Cycles per second [Hz]: 40 as in the paper, 100 or more where the bus allows.",
        1.0,
        1000.0,
    ),
    Parameter(
        "joints", [], "Order of the joints in commands without labels; empty: the robot file's."
    ),
    Parameter(
        "command_timeout",
        _D.command_timeout_s,
        "`on_timeout` after so long without a current command [s].",
        0.01,
        5.0,
    ),
    Parameter(
        "on_timeout",
        _D.on_timeout,
        "hold: a driven joint is held where it is; zero: it is left without current.",
        choices=ENDS,
    ),
    Parameter(
        "on_shutdown",
        "zero",
        "zero: current zero and torque off at the end; hold: the servos keep their position.",
        choices=ENDS,
    ),
    Parameter(
        "watchdog",
        _D.watchdog_s,
        "The servo of a driven joint stops after so much silence on the bus [s]; 0: never.",
        0.0,
        2.54,
    ),
    Parameter(
        "hold_watchdog",
        _D.hold_watchdog_s,
        "The servo of a locked joint stops after so much silence [s]; 0: never.",
        0.0,
        2.54,
    ),
    Parameter(
        "limit_margin",
        _D.limit_margin_rad,
        "A joint is not driven nearer to its limit [rad].",
        0.0,
        0.5,
    ),
    Parameter(
        "min_clearance",
        _D.min_clearance_m,
        "Nothing that can be lowered is brought nearer to the base's plane, the "
        "table [m]; -10 where the arm hangs below its base.",
        -10.0,
        1.0,
    ),
    Parameter(
        "max_velocity",
        _D.max_velocity_rad_s,
        "A driven joint that turns faster is braked [rad/s].",
        0.1,
        20.0,
    ),
    Parameter(
        "max_goal_velocity",
        _D.max_goal_velocity_rad_s,
        "Goal positions are followed no faster [rad/s].",
        0.01,
        5.0,
    ),
    Parameter(
        "max_temperature",
        _D.max_temperature_C,
        "No currents above this temperature of the motor [deg C].",
        20.0,
        80.0,
    ),
    Parameter(
        "max_jump",
        _D.max_jump_rad,
        "A position that jumps further is an encoder fault [rad].",
        0.05,
        3.0,
    ),
    Parameter(
        "position_d_gain", _D.position_d_gain, "Register value that damps locked joints.", 0, 16383
    ),
    Parameter("reply_timeout", 0.02, "How long a servo may take to answer [s].", 0.001, 0.2),
    Parameter(
        "fast_sync_read",
        True,
        "Read all servos in one packet where their firmware (45 or newer) knows it.",
    ),
    Parameter(
        "reconnect_period", _D.reconnect_s, "A lost bus is tried again so often [s].", 0.05, 60.0
    ),
)

EXCITATION = (
    ROBOT,
    replace(
        REAL_TIME,
        description="Whether efforts hold an arm (command_interface effort) in a real-time class; else: a higher priority.",
    ),
    Parameter(
        "probe",
        DEFAULT_PROBE,
        "Sequence that ~/run makes: a name of config/probes, or a file.",
        dynamic=True,
    ),
    Parameter(
        "limit_margin",
        _G.limit_margin_rad,
        "Room left before a joint's limit during a run [rad].",
        0.0,
        0.5,
    ),
    Parameter(
        "max_velocity",
        _G.max_velocity_rad_s,
        "A run ends when a joint is faster [rad/s].",
        0.1,
        20.0,
    ),
    Parameter(
        "stale_after",
        _G.stale_after_s,
        "Joint states further apart end the sequence [s].",
        0.02,
        5.0,
    ),
    Parameter(
        "follow_error",
        _G.follow_error_rad,
        "A joint may be off its goal by so much [rad].",
        0.01,
        1.0,
    ),
    Parameter(
        "held_joint_error",
        _G.held_joint_error_rad,
        "A locked joint may give way by so much [rad].",
        0.01,
        1.0,
    ),
    Parameter(
        "max_jump",
        _G.max_jump_rad,
        "A position that jumps further ends the sequence [rad].",
        0.05,
        3.0,
    ),
    Parameter(
        "command_interface",
        "driver",
        f"What takes the commands. driver: this package's; {_KINDS}.",
        choices=COMMANDED,
    ),
    Parameter(
        "input_topic",
        "",
        f"Where that controller listens; empty: {_USUAL_TOPICS}.",
    ),
    Parameter("controller_joints", [], "That controller's `joints`, in its order."),
    Parameter(
        "controller_manager",
        "",
        "Name of the controller_manager that switches to that controller for each sequence, and back; empty: nobody "
        "switches.",
    ),
    Parameter("activate_controller", "", "That controller; empty: as input_topic names it."),
    Parameter(
        "deactivate_controllers",
        [],
        "Controllers that have the joints else; active again after each sequence.",
    ),
    Parameter(
        "effort_unit",
        "N.m",
        "What the drive takes an effort for: N.m (current x nominal torque constant), or A.",
        choices=UNITS,
    ),
    Parameter(
        "hold_frequency",
        _H.frequency_rad_s,
        "How stiffly efforts hold a joint: frequency of spring and inertia [rad/s], at most a tenth of the joint states' "
        "rate.",
        3.0,
        25.0,
    ),
    Parameter(
        "on_end",
        "hold",
        "Last efforts when the node ends, which the controller keeps. hold: what held the arm; zero: it comes down. "
        "Goals always hold.",
        choices=ENDS,
    ),
)


def _parameters_of(probe: Probe[Any]) -> list[Parameter]:
    """What can be said to the node about a probe."""
    called = f"calibrate_{probe.name}"
    baseline = f"record_{probe.name}_baseline"
    if isinstance(probe, HasBaseline):
        called += f" and {baseline}"
    parameters = [
        Parameter(
            f"{probe.name}_sequence",
            probe.default_sequence,
            f"Probe sequence of {called}.",
            dynamic=True,
        )
    ]
    if isinstance(probe, HasBaseline):
        words = (
            f"Bag of the {probe.baseline.noun}; empty: what {baseline} kept last; none: without."
        )
        parameters.append(Parameter(f"{probe.name}_baseline", "", words, dynamic=True))
    limits = probe.limits if isinstance(probe, GuardsObject) else ()
    stated = (
        (each.name, each.default, each.description, each.lowest, each.highest) for each in limits
    )
    parameters += [Parameter(*limit, dynamic=True) for limit in stated]
    asked = [(each.parameter, "", each.about) for each in probe.asked]
    return parameters + [Parameter(*each, dynamic=True, loose=True) for each in asked]


IDENTIFIER = (
    replace(
        ROBOT,
        description="Robot of config/robots, the path of a robot file or a URDF, or robot_description: the URDF on that topic.",
    ),
    Parameter(
        "calibration",
        "",
        "Calibration file; empty: the one last taken of this robot in data_directory; none: without.",
    ),
    Parameter(
        "data_directory",
        "~/.ros/proprio_ros",
        "Where recordings, results and calibrations are kept; those of a namespace in a folder of its name.",
    ),
    Parameter(
        "settings",
        [],
        "What is known about the object, as with --set: payload.size=0.03, sphere.radius=0.01.",
        dynamic=True,
    ),
    Parameter("robot_sequence", "empty_hand", "Probe sequence of calibrate_robot.", dynamic=True),
    *(parameter for probe in all_probes() for parameter in _parameters_of(probe)),
    Parameter(
        "reference_sequence",
        "reference",
        "Probe sequence of calibrate_robot with the reference object.",
        dynamic=True,
    ),
    Parameter(
        "reference_mass",
        0.0,
        "Mass of a weighed object for calibrate_robot [kg]; 0: none.",
        0.0,
        5.0,
        dynamic=True,
    ),
    Parameter("reference_settings", [], "The same about the reference object.", dynamic=True),
    Parameter(
        "reference_wait",
        10.0,
        "Time to put the reference object into the hand [s].",
        0.0,
        600.0,
        dynamic=True,
    ),
    Parameter("excitation_node", "excitation", "Name of the excitation node."),
    Parameter(
        "driver",
        "",
        "Which driver publishes, as with --driver: a profile of config/drivers, or a file; the next four win over it.",
    ),
    Parameter(
        "state_topic", "", "Topic of the joint states, as with --state-topic; empty: joint_states."
    ),
    Parameter(
        "command_topic",
        "",
        "Topic of what drives the joints, as with --command-topic; empty: applied_effort, else current_command.",
    ),
    Parameter(
        "effort_unit",
        "",
        "What effort of the joint states means where nothing else says what drives the joints: N.m, A, mA or raw.",
        choices=EFFORT_UNITS,
    ),
    Parameter(
        "effort_sign",
        "",
        "Which way effort of the joint states counts, as with --effort-sign: -1, or JOINT=-1,JOINT=-1; empty: as the robot "
        "file or the driver's profile says.",
        loose=True,
    ),
    Parameter(
        "frame_prefix",
        "",
        "Before the frame of payload and markers, as robot_state_publisher's: arm1/.",
    ),
    Parameter("report", True, "Write the result and an HTML report beside every recording."),
    Parameter("weigh_seconds", 15.0, "How much of the latest motion weigh takes [s].", 5.0, 120.0),
    Parameter(
        "running",
        False,
        "Estimate the mass in the hand all the time, whatever moves the arm, and publish it ten times a second. Off by "
        "default, since it takes a tenth of a processor core and replaces what a service published.",
    ),
    Parameter(
        "holding_from",
        0.05,
        "Mass of the lightest object that ~/holding tells from an empty hand [kg].",
        0.001,
        100.0,
    ),
    Parameter(
        "gravity_effort_rate",
        0.0,
        "How often ~/gravity_effort says which efforts carry arm and payload in the present pose [Hz], and ~/capability what "
        "the arm can carry, where it is known what the hand holds; 0: not.",
        0.0,
        200.0,
    ),
    Parameter(
        "hand_on",
        "none",
        "Controller that ~/apply hands an accepted load on to: none, ur, franka or xarm.",
    ),
    Parameter(
        "hand_on_service", "", "Service of that controller; empty: the usual one of its driver."
    ),
    Parameter(
        "hand_on_link",
        "",
        "Link in whose frame the controller takes the load; empty: the flange by its usual name.",
    ),
    Parameter(
        "hand_on_tool",
        "",
        "The empty gripper, for controllers that want all that hangs at the flange: mass [kg] and centre of mass [m] in "
        "that link's frame, such as 0.9, 0.0, 0.0, 0.06; 0, 0, 0, 0: none.",
        loose=True,
    ),
    Parameter(
        "live_period",
        0.03,
        "Pause between estimates while a run is under way [s]; 0 turns them off.",
        0.0,
        10.0,
    ),
)

VIRTUAL = (
    ROBOT,
    Parameter(
        "real_time",
        False,
        "Whether the arm and its servos take a real-time class, since hardware waits for no program: for one arm, not for ten.",
    ),
    Parameter("link", DEFAULT_LINK, "Path under which the servo bus appears; the driver's `port`."),
    Parameter(
        "interface",
        "bus",
        "What drives the arm. bus: the servo bus; effort_controller: efforts on a topic, as ros2_control takes them, "
        "the last of which stays; position_controller: likewise goals, for position servos.",
        choices=("bus", *CONTROLLERS),
    ),
    Parameter(
        "input_topic",
        "",
        f"Of the controller; empty: {_USUAL_TOPICS}.",
    ),
    Parameter("controller_joints", [], "Of the controller, in its order; empty: the robot file's."),
    Parameter(
        "state_rate", 500.0, "Of the joint states that come with a controller [Hz].", 20.0, 1000.0
    ),
    Parameter(
        "effort_unit",
        "N.m",
        "What an effort is: N.m (current x nominal torque constant), or A.",
        choices=UNITS,
    ),
    Parameter(
        "object",
        "none",
        ", ".join(
            [
                "What the hand holds in a probe: 0.05 (kg)",
                *(f"{each.kind}:.." for each in virtual_objects()),
            ]
        ),
        dynamic=True,
        loose=True,
    ),
    Parameter("reference", 0.1, "Mass of the reference object [kg].", 0.001, 2.0, dynamic=True),
    Parameter(
        "seed",
        1,
        "Draws the arm's hidden numbers from what its file leaves open; -1: the file's.",
        -1,
        2**31 - 1,
    ),
    Parameter("links", False, "Whether the links, too, differ from the URDF."),
    Parameter("truth", "", "File with the hidden numbers, instead of seed and links."),
    Parameter(
        "fault",
        "",
        "drop=P, corrupt=P, hang=JOINT, overheat=JOINT, jump=JOINT or unplug.",
        dynamic=True,
    ),
)

NODES: dict[str, tuple[Parameter, ...]] = {
    "driver": DRIVER,
    "excitation": EXCITATION,
    "identifier": IDENTIFIER,
    "virtual": VIRTUAL,
}
"""By node; beside these each has `AUTOSTART`."""

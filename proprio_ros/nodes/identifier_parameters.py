"""Services and parameters of the identifier node; those of the probes come from the registry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from proprio_ros.live.job import REFRESH, WEIGH
from proprio_ros.live.job import ROBOT as ROBOT_JOB
from proprio_ros.nodes.parameters import ROBOT, Parameter
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import Guards, HasBaseline, Probe
from proprio_ros.recordings.effort import EFFORT_UNITS


def services() -> dict[str, str]:
    """Kind of job and its service: the robot's, and of each probe one to identify and one to record its baseline."""
    found = {ROBOT_JOB: "calibrate_robot", REFRESH: "refresh_robot", WEIGH: "weigh"}
    for probe in all_probes():
        found[probe.name] = f"calibrate_{probe.name}"
        if isinstance(probe, HasBaseline):
            found[f"{probe.name}_baseline"] = f"record_{probe.name}_baseline"
    return found


def _parameters_of(probe: Probe[Any]) -> list[Parameter]:
    """What can be said to the node about a probe."""
    called, baseline = f"calibrate_{probe.name}", f"record_{probe.name}_baseline"
    if isinstance(probe, HasBaseline):
        called += f" and {baseline}"
    parameters = [
        Parameter(f"{probe.name}_sequence", probe.default_sequence, f"Probe sequence of {called}.", dynamic=True)
    ]
    if isinstance(probe, HasBaseline):
        words = f"Bag of the {probe.baseline.noun}; empty: what {baseline} kept last; none: without."
        parameters.append(Parameter(f"{probe.name}_baseline", "", words, dynamic=True))
    limits = probe.limits if isinstance(probe, Guards) else ()
    stated = ((each.name, each.default, each.description, each.lowest, each.highest) for each in limits)
    return parameters + [Parameter(*limit, dynamic=True) for limit in stated]


PARAMETERS = (
    replace(
        ROBOT,
        description="Robot of config/robots, the path of a robot file or a URDF, or robot_description: the URDF on that topic.",
    ),
    Parameter("calibration", "", "Calibration file; empty: the one last taken of this robot in data_directory; none: without."),
    Parameter("data_directory", "~/.ros/proprio_ros",
              "Where recordings, results and calibrations are kept; those of a namespace in a folder of its name."),
    Parameter("settings", [], "What is known about the object, as with --set: payload.size=0.03, sphere.radius=0.01.",
              dynamic=True),
    Parameter("robot_sequence", "empty_hand", "Probe sequence of calibrate_robot."),
    *(parameter for probe in all_probes() for parameter in _parameters_of(probe)),
    Parameter("reference_sequence", "reference", "Probe sequence of calibrate_robot with the reference object."),
    Parameter("reference_mass", 0.0, "Mass of a weighed object for calibrate_robot [kg]; 0: none.", 0.0, 5.0, dynamic=True),
    Parameter("reference_settings", [], "The same about the reference object.", dynamic=True),
    Parameter("reference_wait", 10.0, "Time to put the reference object into the hand [s].", 0.0, 600.0, dynamic=True),
    Parameter("excitation_node", "excitation", "Name of the excitation node."),
    Parameter("driver", "",
              "Which driver publishes, as with --driver: a profile of config/drivers, or a file; the next three win over it."),
    Parameter("state_topic", "", "Topic of the joint states, as with --state-topic; empty: joint_states."),
    Parameter("command_topic", "",
              "Topic of what drives the joints, as with --command-topic; empty: applied_effort, else current_command."),
    Parameter("effort_unit", "",
              "What effort of the joint states means where nothing else says what drives the joints: N.m, A, mA or raw.",
              choices=EFFORT_UNITS),
    Parameter("frame_prefix", "", "Before the frame of payload and markers, as robot_state_publisher's: arm1/."),
    Parameter("report", True, "Write the result and an HTML report beside every recording."),
    Parameter("weigh_seconds", 15.0, "How much of the latest motion weigh takes [s].", 5.0, 120.0),
    Parameter("running", False,
              "Estimate the mass in the hand all the time, whatever moves the arm, and publish it ten times a second. Off by "
              "default, since it takes a tenth of a processor core and replaces what a service published."),
    Parameter("hand_on", "none",
              "Controller that ~/apply hands an accepted load on to: none, ur, franka or xarm."),
    Parameter("hand_on_service", "", "Service of that controller; empty: the usual one of its driver."),
    Parameter("hand_on_link", "", "Link in whose frame the controller takes the load; empty: the flange by its usual name."),
    Parameter("hand_on_tool", "",
              "The empty gripper, for controllers that want all that hangs at the flange: mass [kg] and centre of mass [m] in "
              "that link's frame, such as 0.9, 0.0, 0.0, 0.06; 0, 0, 0, 0: none.", loose=True),
    Parameter("live_period", 0.03, "Pause between estimates while a run is under way [s]; 0 turns them off.", 0.0, 10.0),
)  # fmt: skip

"""Topics and services of every node in words, without ROS: for the programs' ``--help``, `proprio call`, and the documentation."""

from __future__ import annotations

from dataclasses import dataclass

from proprio_ros.excitation.controller_kinds import CONTROLLER_KINDS
from proprio_ros.live.job import REFRESH, WEIGH
from proprio_ros.live.job import ROBOT as ROBOT_JOB
from proprio_ros.nodes.tables import INPUT_TOPICS
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import HasBaseline


@dataclass(frozen=True)
class Interface:
    """What one node is for, and the names by which others talk to it, without a namespace."""

    about: str
    publishes: tuple[str, ...]
    takes: tuple[str, ...]
    services: tuple[str, ...] = ()


def jobs() -> dict[str, str]:
    """Kind of job and its service: the robot's, and of each probe one to identify and one to record its baseline."""
    found = {ROBOT_JOB: "calibrate_robot", REFRESH: "refresh_robot", WEIGH: "weigh"}
    for probe in all_probes():
        found[probe.name] = f"calibrate_{probe.name}"
        if isinstance(probe, HasBaseline):
            found[f"{probe.name}_baseline"] = f"record_{probe.name}_baseline"
    return found


def interface_of(node: str) -> Interface:
    """That of a node, of which a probe may bring services and numbers."""
    return _identifier() if node == "identifier" else _OTHERS[node]


def about(name: str) -> str:
    """What a topic or a service is for; empty where it is not known, as for numbers that probes bring from outside."""
    return ABOUT.get(name) or _of_probes().get(name, "")


def _of_probes() -> dict[str, str]:
    """Their services, in words."""
    words: dict[str, str] = {}
    for probe in all_probes():
        sequence = f"make the sequence named by `{probe.name}_sequence`"
        words[f"/identifier/calibrate_{probe.name}"] = f"{sequence}, and identify"
        if isinstance(probe, HasBaseline):
            baseline = f"/identifier/record_{probe.name}_baseline"
            words[baseline] = f"{sequence} with the {probe.baseline.noun}, and keep the recording"
    return words


def services() -> dict[str, str]:
    """Node of each service by the service's own name, which no two nodes share."""
    every = {
        node: interface_of(node).services
        for node in ("identifier", "excitation", "driver", "virtual")
    }
    return {name.rpartition("/")[2]: node for node, names in every.items() for name in names}


def _identifier() -> Interface:
    numbers = dict.fromkeys(topic for probe in all_probes() for topic in probe.numbers)
    return Interface(
        "Asks for sequences of excitations, listens, keeps the recording, and publishes what it identifies.",
        (
            *("/identifier/status", "/identifier/estimate", "/identifier/payload", "/identifier/holding"),
            *(f"/identifier/{name}" for name in numbers),
            *(f"/identifier/{name}" for name in ("gravity_effort", "gravity_effort_std", "capability")),
            *(f"/identifier/{name}" for name in ("markers", "next_push")),
            "/excitation/lease",
        ),
        (
            *("/joint_states", "/applied_effort", "/applied_current", "/current_command", "/battery_state", "/joint_command"),
            *("/motors", "/motor_temperatures", "/torque_enabled", "/robot_description", "/excitation/status"),
            "/identifier/carry_to",
        ),
        tuple(f"/identifier/{name}" for name in (*jobs().values(), "cancel", "apply")),
    )  # fmt: skip


_OTHERS = {
    "driver": Interface(
        "Publishes what the servos report, and passes commands on to them, inside the limits.",
        (
            *("/joint_states", "/applied_effort", "/applied_current", "/torque_enabled", "/driver/status", "/diagnostics"),
            *("/motors", "/motor_temperatures"),
        ),
        ("/current_command", "/position_command"),
        ("/driver/stop", "/driver/torque"),
    ),
    "excitation": Interface(
        "Makes sequences of excitations: joint states in, current and position commands out.",
        (
            *("/current_command", "/position_command", "/excitation/status"),
            *(f"/{each.recorded_on}" for each in CONTROLLER_KINDS.values()),
            *INPUT_TOPICS.values(),
        ),
        ("/joint_states", "/applied_effort", "/torque_enabled", "/driver/status", "/excitation/lease"),
        ("/excitation/run", "/excitation/abort", "/excitation/release"),
    ),
    "virtual": Interface(
        "A virtual arm: servos on a pseudo-terminal with MuJoCo behind them, or an arm with a controller as in `ros2_control`.",
        ("/virtual/status", "/virtual/motors", "/joint_states"),
        ("/excitation/status", "/identifier/status", *INPUT_TOPICS.values()),
        ("/virtual/recover",),
    ),
}  # fmt: skip
ABOUT = {
    "/joint_states": "positions [rad, m], velocities [rad/s, m/s], effort [N m, N]: present current x nominal torque constant",
    "/robot_description": "URDF, as `robot_state_publisher` publishes it; only where `robot` is the name of this topic",
    "/applied_effort": "same stamps: commanded current x nominal torque constant [N m, N]",
    "/applied_current": "commanded current [A], `layout.dim` labelled by joint, to plot",
    "/torque_enabled": "false while a joint is without torque: all of them, or one that a lease drives with a current of zero",
    "/diagnostics": "bus, servos, late cycles, left-out samples; once a second, and at once when the driver's state changes",
    "/current_command": "currents [A], in the order of `joints`, or of the labels in `layout.dim`; one publisher at a time, and a "
    "zero lets go of a joint only after a push",
    **{
        each.usual_topic: f"where `command_interface` is {kind}: {each.commanded}, in the order of `controller_joints`"
        for kind, each in CONTROLLER_KINDS.items()
    },
    "/joint_command": "with a position controller: the goals that were sent [rad, m], by name; the identifier records them where "
    "the robot file says that servos follow goals",
    "/battery_state": "supply voltage, where voltages drive the motors",
    "/position_command": "goal positions [rad, m], labelled likewise; above the table, one publisher at a time",
    "/driver/status": "`state`: running, stopped, released, disconnected, inactive; at once when it changes",
    "/motor_temperatures": "how warm each motor is, labelled by joint [deg C]; a calibration ages by it",
    "/motors": "what each servo keeps without power, as JSON by joint: whose arm it is; a calibration is refused on another",
    "/excitation/status": "what the sequence is doing",
    "/excitation/lease": "true, again and again: the sequence is wanted, and ends after 1.5 s of silence; false: no more",
    "/excitation/run": "make the sequence named by the parameter `probe`",
    "/excitation/abort": "end it; the driven joint is braked and held",
    "/excitation/release": "let go of an arm that efforts hold: they are zero, and it comes down; servos stay at their last "
    "goals, the driver's arm as it is, and where controllers are switched the arm is handed back",
    "/driver/stop": "all currents to zero, at once, until `~/torque` is called",
    "/driver/torque": "torque on or off",
    "/identifier/estimate": "every value with unit, standard deviation, 95 % interval, verdict, reasons, calibration used; of "
    "a payload also while the probe is under way, and with `running` all the time "
    "([when it is late](weigh_at_work.md#how-old-it-is))",
    "/identifier/payload": "mass, centre of mass and inertia, in the frame of the link that holds it; `inertia` of `~/estimate` "
    "says whether that tensor is identified, stated, or assumed: that of the ball in `config/probes/payload.yaml`; with "
    "`running` stamped as `~/estimate`, and NaN when it is withdrawn",
    "/identifier/holding": "whether something is in the hand, published when that changes: at a probability of 0.99, and back at "
    "0.01; in between it keeps its value",
    "/identifier/gravity_effort": "with `gravity_effort_rate`, while it is known what the hand holds: efforts that carry arm and "
    "payload in the pose of this stamp, without friction [N m]",
    "/identifier/gravity_effort_std": "their standard deviations, with the same stamp and joints [N m]",
    "/identifier/capability": "whether the arm can carry what it holds, here or to the goal on `~/carry_to`: `can_carry`, the "
    "`joint` that decides, its `margin` of the limit, `most`, the heaviest load [kg], and `stamp` [s] of the newest joint state "
    "that what it holds rests on",
    "/identifier/carry_to": "positions of some joints [rad]: can what is held be carried there on the straight way of the joints?",
    "/identifier/mass": "kg, to plot, of the payload or of the sphere; NaN as soon as something else is asked for",
    "/identifier/sphere_mass": "kg, to plot",
    "/identifier/fill": "m, how high a liquid stands, to plot",
    "/identifier/liquid_inside": "probability of a liquid, to plot",
    "/identifier/youngs_modulus": "Pa, to plot",
    "/identifier/lame_mu": "Pa, to plot",
    "/identifier/lame_lambda": "Pa, to plot",
    "/identifier/markers": "for RViz",
    "/identifier/status": "progress, and what the hand should hold now",
    "/identifier/calibrate_robot": "empty hand: calibrate the robot; once, and when something has changed",
    "/identifier/next_push": "what is known after a push, in words, and the way of the hand in the push that comes next, in RViz",
    "/identifier/refresh_robot": "empty hand: some chosen pushes that bring its calibration up to date; now and then",
    "/identifier/weigh": "what the hand held in the last `weigh_seconds` of whatever motion",
    "/identifier/apply": "export the accepted load to the arm's own controller (`hand_on`)",
    "/identifier/cancel": "end the job; what was recorded is kept",
    "/virtual/recover": "bring an arm that has fallen back to its first pose, and hold it",
    "/virtual/status": "what the virtual hand holds",
    "/virtual/motors": "what is really going on: true positions [rad, m], and as effort the current in each motor [A]",
}  # fmt: skip

"""What the joints carry now, for controllers that take a feed-forward, and whether the arm can carry its load, here or there."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from proprio_ros.errors import ProprioError
from proprio_ros.live.carrying import Carrier, Load, capability_entries, way
from proprio_ros.nodes import messages
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.qos import COMMANDS, LATCHED
from proprio_ros.nodes.results import Results
from proprio_ros.robot import Robot

EVERY = 10  # `~/capability` comes with each so many of `~/gravity_effort`


class Carrying:
    """Publishes while it is known what the hand holds; a pose that is asked for is answered once."""

    def __init__(self, node: ManagedNode, inputs: Inputs, results: Results) -> None:
        self._node = node
        self._inputs = inputs
        self._results = results
        self._robot: Robot | None = None
        self._carrier: Carrier | None = None
        self._pose: dict[str, float] = {}
        self._seen = b""
        self._count = 0
        self._standing = False
        self._effort = node.create_publisher(JointState, "~/gravity_effort", COMMANDS)
        self._std = node.create_publisher(JointState, "~/gravity_effort_std", COMMANDS)
        self._capability = node.create_publisher(DiagnosticStatus, "~/capability", LATCHED)
        node.create_subscription(JointState, "~/carry_to", self._on_goal, COMMANDS)
        rate_Hz = float(node.values["gravity_effort_rate"])
        if rate_Hz:
            node.every(1.0 / rate_Hz, self._publish)

    def use(self, robot: Robot) -> None:
        """Whose joints they are."""
        self._robot = robot
        self._carrier = None

    def _stands(self) -> bool:
        """Whether all joints have been heard, and the newest joint state just now; takes it up."""
        data = self._inputs.newest_state
        if self._robot is None or not data or not self._inputs.has_states:
            return False
        if self._carrier is None:
            try:
                self._carrier = Carrier(self._robot)
            except ProprioError as error:
                self._node.say("warning", f"no ~/gravity_effort: {error}")
                self._robot = None
                return False
        if data is not self._seen:
            self._seen = data
            message = deserialize_message(data, JointState)
            heard = zip(
                self._inputs.conventions.renamed(message.name), message.position, strict=False
            )
            self._pose |= {name: at for name, at in heard if math.isfinite(at)}
        return all(name in self._pose for name in self._carrier.joints)

    def _publish(self) -> None:
        load = self._results.held
        if load is None or not self._stands() or self._carrier is None:
            self._withdraw()
            return
        names = list(self._carrier.joints)
        now_ns = messages.first_stamp_ns(self._seen) or 0
        efforts, stds = self._carrier.efforts(self._pose, load)
        self._effort.publish(
            messages.joint_state(
                now_ns, names, [self._pose[name] for name in names], effort=efforts.tolist()
            )
        )
        self._std.publish(
            messages.joint_state(
                now_ns,
                names,
                effort=stds.tolist(),
            )
        )
        self._count += 1
        if self._count % EVERY == 1:
            self._say(load, [self._pose], "here")

    def _on_goal(self, message: JointState) -> None:
        goal = dict(zip(message.name, message.position, strict=False))
        load = self._results.held
        carrier = self._carrier
        wrong = [] if carrier is None else [name for name in goal if name not in carrier.joints]
        if load is None or carrier is None or not self._stands():
            reason = (
                "what the hand holds is not known; weigh it"
                if self._stands()
                else "no joint states of the arm are coming"
            )
        elif wrong or not goal or not all(map(math.isfinite, goal.values())):
            reason = f"the goal must name joints of {', '.join(carrier.joints)}, each with a position in rad"
        else:
            return self._say(load, way(self._pose, goal), "to the goal")
        self._say_unknown(reason, "to the goal")

    def _withdraw(self) -> None:
        """What was said last stands no longer."""
        if self._standing:
            self._say_unknown("what the hand holds now is not known", "here")

    def _say_unknown(self, why: str, where: str) -> None:
        self._standing = False
        entries = {"where": where, "can_carry": "unknown"}
        self._capability.publish(messages.status("warning", "capability", why, entries))

    def _say(
        self,
        load: Load,
        poses: list[dict[str, float]],
        where: str,
    ) -> None:
        assert self._carrier is not None
        found = self._carrier.capability(poses, load)
        left = f"{found.joint} has {100.0 * found.margin:.0f} % left"
        words = (
            f"{'can' if found.can else 'cannot'} carry {1e3 * load.mass_kg:.0f} g {where}: {left}"
        )
        late = self._results.late
        level = "ok" if found.can and not late else "warning"
        entries = {"where": where, **capability_entries(found, load)}
        entries["stamp"] = 1e-9 * self._results.held_ns
        sentence = "; ".join(filter(None, (words, late)))
        self._standing = True
        self._capability.publish(messages.status(level, "capability", sentence, entries))

"""A process between the package's driver, in the namespace `hardware`, and the topics of a driver that knows little.

    python test/nodes/bridge.py [--obey]

Positions best effort, velocities NaN, no applied effort, and wheels on the same topic; with ``--obey`` commands are passed on. A
process of its own in real time, as a driver is: what relays commands late lets the arm run into its limits.
"""

from __future__ import annotations

import math
import sys

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from proprio_ros.clock import run_in_real_time
from proprio_ros.nodes.messages import joint_state

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def main() -> None:
    """Until it is interrupted."""
    rclpy.init()
    node = rclpy.create_node("bridge")
    states = node.create_publisher(JointState, "/joint_states", BEST_EFFORT)
    other = node.create_publisher(JointState, "/joint_states", 10)
    turns = 0

    def on_state(message: JointState) -> None:
        nonlocal turns
        turns += 1
        stamp_ns = 10**9 * message.header.stamp.sec + message.header.stamp.nanosec
        states.publish(
            joint_state(stamp_ns, message.name, message.position, [math.nan] * len(message.name))
        )
        other.publish(
            joint_state(
                stamp_ns + 3_000_000,
                ["wheel"],
                [0.1 * turns],
                [math.nan],
            )
        )

    node.create_subscription(JointState, "/hardware/joint_states", on_state, 100)
    if "--obey" in sys.argv[1:]:
        for topic in ("current_command", "position_command"):
            onward = node.create_publisher(Float64MultiArray, f"/hardware/{topic}", 10)
            node.create_subscription(Float64MultiArray, f"/{topic}", onward.publish, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    run_in_real_time()
    executor.spin()


if __name__ == "__main__":
    main()

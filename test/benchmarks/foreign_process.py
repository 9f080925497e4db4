"""`support.foreign_arm` as a process of its own, over DDS and in real time: what probes are tried with by hand.

python test/benchmarks/foreign_process.py --seed 1 [--goals --rate 30]
"""

from __future__ import annotations

import math
from typing import Any

from support.foreign_arm import BROADCAST, ForeignArm


def asked() -> Any:
    """The command line's words: which arm, whether it takes goals, and how often it tells its state [Hz]."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--goals", action="store_true")
    parser.add_argument("--rate", type=float, default=500.0)
    return parser.parse_args()


def main() -> None:
    """Commands and joint states over DDS, each in a thread of its own, in real time."""
    import threading
    import time

    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64, Float64MultiArray

    from proprio_ros.clock import run_in_real_time
    from proprio_ros.nodes.middleware import leave_shared_memory

    given = asked()
    leave_shared_memory()
    rclpy.init()
    node, arm, lock = (
        rclpy.create_node("foreign_arm"),
        ForeignArm(given.seed, given.goals),
        threading.Lock(),
    )
    best = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    states = node.create_publisher(JointState, "/joint_states", best)
    topic = (
        "/position_controller/commands" if given.goals else "/forward_effort_controller/commands"
    )

    def take(message: Float64MultiArray) -> None:
        time.sleep(max(0.0, arm.stalled(time.monotonic(), "commands") - time.monotonic()))
        with lock:
            arm.command(time.monotonic(), list(message.data))

    def say() -> None:
        next_s = time.monotonic()
        while rclpy.ok():
            next_s = max(
                next_s + 1.0 / given.rate,
                time.monotonic() - 1.0 / given.rate,
            )
            time.sleep(max(0.0, next_s - time.monotonic()))
            time.sleep(max(0.0, arm.stalled(time.monotonic(), "states") - time.monotonic()))
            with lock:
                # both are of one instant, as `update` of a controller has them
                now_s = time.monotonic()
                stamp = node.get_clock().now().to_msg()
                arm.advance(now_s)
                places = arm.positions()
            nothing = [math.nan] * len(places)
            message = JointState(
                name=list(BROADCAST), position=places, velocity=nothing, effort=nothing
            )
            message.header.stamp = stamp
            states.publish(message)

    node.create_subscription(Float64MultiArray, topic, take, 1)
    node.create_subscription(
        Float64,
        "/hand",
        lambda message: arm.hold(message.data),
        1,
    )
    run_in_real_time()  # as ros2_control's update loop
    threading.Thread(target=say, daemon=True).start()
    rclpy.spin(node)


if __name__ == "__main__":
    main()

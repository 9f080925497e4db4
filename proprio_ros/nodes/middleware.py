"""What the environment says to the middleware before a node begins: who may find it, and how it talks to others."""

from __future__ import annotations

import logging
import os
import re
import sys

import rclpy

from proprio_ros.errors import one_line
from proprio_ros.inputs.resources import share_directory

DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FAST_DDS_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
RANGE_SET_BY = (
    DISCOVERY,
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "CYCLONEDDS_URI",
    *FAST_DDS_PROFILES,
)
"""Where one of these is set, the user has said who may find the nodes."""


def prepare() -> None:
    """To be called before `rclpy.init`."""
    warn_about_mixed_installations()
    stay_on_this_machine()
    if os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp") == "rmw_fastrtps_cpp":
        leave_shared_memory()


def stay_on_this_machine() -> None:
    """Be found by programs on this computer only, unless the user has said who else may find us.

    ROS 2 lets everybody on the network command every node, and these move an arm.
    """
    if not any(name in os.environ for name in RANGE_SET_BY):
        os.environ[DISCOVERY] = "LOCALHOST"


def leave_shared_memory() -> None:
    """Have Fast DDS send through sockets only.

    Processes on one computer talk through shared memory by default, behind locks that know no priority: one in real time stood
    still for up to 0.7 s in `publish`, with Python's own lock, because an ordinary one was not run while it held them (Fast DDS
    2.14, three busy programs on two cores). Those that keep shared memory still hear us. What the user has set counts.
    """
    if any(name in os.environ for name in FAST_DDS_PROFILES):
        return
    localhost = os.environ.get(DISCOVERY) == "LOCALHOST"
    if localhost and "ROS_STATIC_PEERS" in os.environ:
        return  # the peers count with this range only
    # here rmw_fastrtps insists on shared memory
    if localhost or os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        profile = share_directory() / "config/dds/localhost_udp.xml"
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
        os.environ[DISCOVERY] = "SYSTEM_DEFAULT"
        os.environ.pop("ROS_LOCALHOST_ONLY", None)
    else:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")


def warn_about_mixed_installations() -> None:
    """Wheels of ROS beside an installed ROS load each other's libraries."""
    here = getattr(rclpy, "__file__", "") or ""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes = [path for path in sourced if path.startswith("/opt/ros")]
    if prefixes and here.startswith(sys.prefix) and not here.startswith("/opt/ros"):
        words = "rclpy comes from %s although %s is sourced: use one of the two, not both (README)"
        logging.getLogger("proprio_ros").warning(
            words,
            sys.prefix,
            prefixes[0],
        )


def said_by_rcl(error: Exception) -> str:
    """What rcl or the middleware refuses, in a line, without the places in rcl's own source."""
    words = re.sub(r", at /\S+", "", str(error))
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown words after --ros-args: {words}; write -p NAME:=VALUE, --params-file FILE or -r __ns:=/NAME"
    if "security libraries" in words:
        return (
            "ROS_SECURITY_ENABLE is set, and this Fast DDS is built without security, as that of the wheels is: use ROS 2 from "
            "apt, or unset it"
        )
    return one_line(words.removeprefix("failed to initialize rcl: "))

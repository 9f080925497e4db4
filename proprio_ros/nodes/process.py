"""A node's life as a process: signals, one line for every error, and an orderly end."""

from __future__ import annotations

import contextlib
import logging
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from proprio_ros import clock
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.nodes import middleware, printing
from proprio_ros.nodes.managed_node import ManagedNode

SWITCH_INTERVAL_S = 0.0005
"""No thread may keep the others from the interpreter for long: at the default of 5 ms a flood of commands has the bus miss cycles,
and 300 messages in a second do not come through beside a solver, whose many short calls hand the lock over."""
CALLED_S = 0.1
"""For so long after a call a node at rest pauses less: where many call at once, each would wait for its pauses."""
CALLED_PAUSE_S = 0.005
"""Between two callbacks then. Without any, a caller that keeps ten answers, as rclpy's do, would lose some."""
CANNOT_START = 2  # exit code


def run_node(make: type[ManagedNode], arguments: Sequence[str] | None = None) -> int:
    """Run one node until it is asked to end (SIGINT, SIGTERM), and end it in order; returns the exit code as `live` does.

    rclpy's own handlers shut the context down first, after which nothing can be published any more; ours let the node
    leave everything safe before.
    """
    with printing.without_waiting() if make.urgent else contextlib.nullcontext():
        return _run_node(make, arguments)


def _run_node(make: type[ManagedNode], arguments: Sequence[str] | None) -> int:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    ended = clock.event()
    middleware.prepare()
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # words after --ros-args that rcl does not understand, or a file that it cannot read
        logging.getLogger("proprio_ros").error("not started: %s", middleware.said_by_rcl(error))
        return CANNOT_START
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    try:
        return live(make, ended)
    finally:
        rclpy.try_shutdown()


def _made(make: Callable[[], ManagedNode]) -> ManagedNode:
    """The node. Raises `ConfigurationError`: The middleware refuses one."""
    try:
        with warnings.catch_warnings():
            # what a node that was refused could not tidy up, which is nobody's business
            warnings.simplefilter("ignore", RuntimeWarning)
            return make()
    except (ProprioError, ParameterException):
        raise
    except RuntimeError as error:
        raise ConfigurationError(f"not started: {middleware.said_by_rcl(error)}") from error


def live(make: Callable[[], ManagedNode], ended: clock.Event) -> int:
    """A node's life: made, configured, activated, spun, and ended in order; returns 0, or 2 when it could not be configured."""
    node: ManagedNode | None = None
    spinner = SingleThreadedExecutor()
    code = 0
    try:
        before = clock.threads()
        node = _made(make)
        node.hearing = clock.threads() - before | {threading.get_native_id()}
        spinner.add_node(node)
        if node.values["autostart"] and not _started(node):
            code = CANNOT_START
            ended.set()
        while not ended.is_set():
            _turn(node, spinner)
            _pause(node)
    except (ProprioError, ParameterException) as error:
        logging.getLogger("proprio_ros").error("%s", " ".join(str(error).split()))
        code = CANNOT_START
    finally:
        if node is not None:
            node.finish()
        spinner.shutdown(timeout_sec=1.0)
        if node is not None:
            node.destroy_node()
    return code


def _started(node: ManagedNode) -> bool:
    """Configure and activate a node; returns whether both succeeded."""
    done = TransitionCallbackReturn.SUCCESS
    if node.trigger_configure() != done:
        return False
    return node.trigger_activate() == done


def _turn(node: ManagedNode, spinner: SingleThreadedExecutor) -> None:
    """One callback. A defect in it costs its answer, not the node: whoever holds the arm goes on holding it."""
    node.turns.begin()
    try:
        spinner.spin_once(timeout_sec=0.1)
    except (ExternalShutdownException, ShutdownException):
        raise
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        node.get_logger().error(
            f"a defect in a callback ({what[:200]}); the node goes on", throttle_duration_sec=1.0
        )


def _pause(node: ManagedNode) -> None:
    """Leave room for other programs, unless messages wait."""
    if node.pause_s <= 0.0 or node.turns.more_waits:
        return
    called = clock.now() - node.called_s < CALLED_S
    clock.sleep(min(node.pause_s, CALLED_PAUSE_S) if called else node.pause_s)

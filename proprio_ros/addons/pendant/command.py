"""``proprio pendant``: what may be written, and what it does."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
from collections.abc import Callable, Sequence

from proprio_ros.cli.parser import Parser
from proprio_ros.cli.terminal import EXIT_OK, say
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.arguments import checked_namespace
from proprio_ros.version import to_install

PORT = 8690
LAST_PORT = 65535
LEAST_OPEN = 1024


def add_parser(add: Callable[..., Parser]) -> None:
    """Add the command to those of ``proprio``; ``add`` is ``add_parser`` of them."""
    it = add(
        "pendant",
        command=pendant,
        help="weigh, squeeze and look, in a browser",
        description="Show the arm, and call its services, in a browser (extra pendant). Who has the address, with its token, may "
        "move the arm.",
        epilog="Exit code: 0 ended by Ctrl-C or SIGTERM, 2 could not run. The arm is held.",
    )
    it.add_argument(
        "--virtual", action="store_true", help="start a virtual arm, as `proprio live --virtual`"
    )
    it.add_argument("--object", metavar="OBJECT", help="in the virtual hand, as for `live`")
    it.add_argument(
        "--read-only",
        action="store_true",
        help="look only; STOP stops all the same",
    )
    it.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="to be found at (default 127.0.0.1, from this computer only; 0.0.0.0: from the network, unencrypted)",
    )
    port = f"of the page (default {PORT}; 0: a free one)"
    it.add_argument("--port", type=int, default=PORT, metavar="N", help=port)
    it.add_argument("--namespace", default="", metavar="NAME", help="of the nodes, as for `live`")


def pendant(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio pendant``: pages, until somebody ends them; returns the exit code."""
    if options.port and not LEAST_OPEN <= options.port <= LAST_PORT:
        raise ConfigurationError(f"--port {options.port}: choose {LEAST_OPEN} to {LAST_PORT}, or 0")
    if options.object is not None and not options.virtual:
        raise ConfigurationError("--object goes with --virtual: add that, or leave it out")
    namespace = checked_namespace(options.namespace)
    if importlib.util.find_spec("nicegui") is None:
        raise ConfigurationError(f"nicegui is missing: {to_install('pendant')}")
    from proprio_ros.addons.pendant.pendant import Pendant
    from proprio_ros.addons.pendant.server import serve

    started: list[subprocess.Popen[bytes]] = []

    def begin() -> None:
        if options.virtual:
            started.append(_virtual(namespace, options.object))

    shown = Pendant(namespace, say, options.read_only)
    try:
        serve(shown, options.host, options.port, begin)
    except KeyboardInterrupt:
        pass  # asked for
    finally:
        for process in started:
            process.terminate()
            process.wait()
    return EXIT_OK


def _virtual(namespace: str, held: str | None) -> subprocess.Popen[bytes]:
    """A virtual arm with its nodes, which end with this process."""
    from proprio_ros.nodes.graph import end_with_parent

    words = [sys.executable, "-m", "proprio_ros.cli", "live", "--virtual"]
    if namespace:
        words += ["--namespace", namespace]
    if held is not None:
        words += ["--object", held]
    return subprocess.Popen(
        words, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=end_with_parent
    )

"""What all tests share: where recordings lie, and ROS settings that keep parallel test sessions apart."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

from support.domains import free_domain, given_back

# rclpy reads these when it is first imported. Without the field check, a wrong scalar type is published as garbage.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
# which inherits that of who started it
if "ROS_DOMAIN_ID" not in os.environ or "PYTEST_XDIST_WORKER" in os.environ:
    os.environ["ROS_DOMAIN_ID"] = free_domain()

# a shell without job control starts what it puts behind it with Ctrl-C ignored, and whoever is started by that inherits it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# as the command line does: threads for matrices of a hundred unknowns only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import pytest
from support.browser import look  # noqa: F401

REPOSITORY = Path(__file__).resolve().parents[1]
LONG = pytest.StashKey[int]()
BORROWS = {
    "paper": (
        "experiment_design/test_until.py",
        "probes/test_container_until.py",
        "report/test_browser.py",
        "sim/test_squeeze.py",
    ),
    "contents": ("benchmarks/test_filled_arm.py",),
}
"""Tests of the core that borrow an arm, a law or a page of an add-on, which may have been deleted."""
collect_ignore = [
    file
    for addon, files in BORROWS.items()
    if not (REPOSITORY / "proprio_ros" / "addons" / addon).exists()
    for file in files
]


@pytest.fixture(autouse=True)
def _own_domains() -> Iterator[None]:
    with given_back():
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    """Long tests; and real servos for test/bus/conformance: without a port those tests skip."""
    parser.addoption(
        "--long",
        action="store_true",
        help="also run what takes long: populations, and all live tests",
    )
    group = parser.getgroup("hardware", "real servos (test/bus/conformance)")
    group.addoption(
        "--hardware-port",
        metavar="PATH",
        help="serial port, such as /dev/ttyUSB0: support the arm, it goes limp",
    )
    group.addoption(
        "--hardware-ids",
        default="11",
        metavar="IDS",
        help="servos on it, comma-separated; default 11",
    )
    group.addoption(
        "--hardware-baud",
        type=int,
        default=1_000_000,
        metavar="BITS",
        help="bits per second; default 1000000",
    )
    group.addoption(
        "--hardware-moves",
        action="store_true",
        help="also run what turns the first servo: clamp it free of load",
    )


def pytest_collection_modifyitems(
    config: pytest.Config,
    items: list[pytest.Item],
) -> None:
    """Long tests run with --long, or when asked for by name."""
    if config.getoption("--long") or any("::" in argument for argument in config.args):
        return
    deselected = [item for item in items if item.get_closest_marker("long")]
    if deselected:
        config.hook.pytest_deselected(items=deselected)
        items[:] = [item for item in items if not item.get_closest_marker("long")]
        config.stash[LONG] = len(deselected)


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """That not everything has run must not be overlooked."""
    if LONG in config.stash:
        terminalreporter.write_line(f"{config.stash[LONG]} long tests deselected; run with --long")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder beside the repository with material that is not part of it; tests that need it skip without."""
    path = REPOSITORY.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"needs {path}")
    return path


@pytest.fixture(scope="session")
def recordings(shared: Path) -> Path:
    """Recordings of simulated robots, with the truth beside each."""
    path = shared / "recordings"
    if not path.is_dir():
        pytest.skip(f"needs {path}")
    return path


@pytest.fixture(scope="session")
def bags() -> Path:
    """The repository's own small recordings."""
    return REPOSITORY / "bags"
